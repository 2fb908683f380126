//! The error of a picture, measured without knowing the truth.

use super::{Tile, error::trimmed_mean};

/// Error of the picture shown, estimated from its two independent halves.
///
/// The squared error of each pixel's mean is estimated without bias (`Pixel::squared_error_of_mean`) and
/// weighted as in the contract, with the displayed value m in the place of the unknown reference:
/// relMSE ≈ mean over pixels and channels of e² / (m² + 0.01·m̄²).
/// It sees noise, not bias: right for unbiased techniques. Where a pixel is mostly noise its m is too large
/// whenever its error is, so that above about 50 % error the figure is too small.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredError {
    /// Estimate of relMSE.
    pub rel_mse: f64,
    /// 95 % confidence interval of `rel_mse`.
    pub interval_95: [f64; 2],
    /// `rel_mse` without the worst 0.1 % of pixels.
    pub trimmed: f64,
}

impl MeasuredError {
    /// What people are shown: √relMSE, a share (0.01 = 1 %).
    pub fn error(&self) -> f64 {
        self.rel_mse.sqrt()
    }

    /// Interval of [`MeasuredError::error`].
    pub fn error_interval_95(&self) -> [f64; 2] {
        self.interval_95.map(f64::sqrt)
    }
}

/// `None` when a tile has fewer than two passes or all is black.
pub(super) fn measure(tiles: &[Tile]) -> Option<MeasuredError> {
    if tiles.iter().any(|tile| tile.passes() < 2) {
        return None;
    }
    let pixel_count = tiles.iter().map(|tile| tile.pixels.len()).sum::<usize>();
    let pixels = || tiles.iter().flat_map(|tile| tile.pixels.iter().map(|pixel| (pixel, tile.passes())));
    let channel_sum = pixels().flat_map(|(pixel, passes)| pixel.total_mean(passes)).sum::<f64>();
    let mean = channel_sum / (3 * pixel_count) as f64;
    if mean <= 0.0 {
        return None;
    }
    let floor = 0.01 * mean * mean;
    let mut errors: Vec<f64> = pixels()
        .map(|(pixel, passes)| {
            let squared = pixel.squared_error_of_mean(passes);
            let shown = pixel.total_mean(passes);
            squared.iter().zip(shown).map(|(e, m)| e / (m * m + floor)).sum::<f64>() / 3.0
        })
        .collect();
    let (rel_mse, standard_error) = mean_and_standard_error(&errors);
    Some(MeasuredError {
        rel_mse,
        interval_95: interval_95(rel_mse, standard_error),
        trimmed: trimmed_mean(&mut errors),
    })
}

/// Mean, and its standard error from the spread over the pixels, whose samples are independent.
/// (The three channels of a pixel are not: they are averaged first.)
fn mean_and_standard_error(errors: &[f64]) -> (f64, f64) {
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let spread = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>();
    (mean, if errors.len() < 2 { mean } else { (spread / (n - 1.0) / n).sqrt() })
}

/// Symmetric in the logarithm: the errors are squares, skewed to the right, and never below zero.
/// By the delta method the logarithm of the mean has the standard error s/mean.
fn interval_95(mean: f64, standard_error: f64) -> [f64; 2] {
    // 97.5 % quantile of the normal distribution.
    const Z: f64 = 1.959_964;
    if mean <= 0.0 {
        return [0.0, 0.0];
    }
    let factor = (Z * standard_error / mean).exp();
    [mean / factor, mean * factor]
}
