//! The error of a picture, measured without knowing the truth.

use super::{PictureSize, error::trimmed_mean};

/// Error of the picture shown, estimated from its two independent halves.
///
/// The squared error of each pixel's mean is estimated without bias (`Pixel::squared_error_of_mean`) and weighted as
/// in the contract: relMSE ≈ mean over pixels and channels of e² / (r² + 0.01·m̄²). The unknown reference r is
/// estimated by the mean of the 5 × 5 pixels around, **without the pixel itself**: its own displayed value is large just
/// when its error is, and would hide it (a Cornell box with glass at 59 samples: 2.2 % instead of 22.9 % relMSE; the
/// neighbours say 23.7 %). It sees noise, not bias: right for unbiased techniques.
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

/// Error of a picture of the given means, `[h × w × 3]`, and estimated squared errors, likewise; `None` when all is black.
pub(super) fn measure(size: PictureSize, means: &[[f64; 3]], squared: &[[f64; 3]]) -> Option<MeasuredError> {
    let mean = means.iter().flatten().sum::<f64>() / (3 * means.len()) as f64;
    if mean <= 0.0 {
        return None;
    }
    let floor = 0.01 * mean * mean;
    let around = means_around(size, means);
    let mut errors: Vec<f64> = squared
        .iter()
        .zip(&around)
        .map(|(squared, around)| {
            squared.iter().zip(around).map(|(e, r)| e / (r * r + floor)).sum::<f64>() / 3.0
        })
        .collect();
    let (rel_mse, standard_error) = mean_and_standard_error(&errors);
    Some(MeasuredError {
        rel_mse,
        interval_95: interval_95(rel_mse, standard_error),
        trimmed: trimmed_mean(&mut errors),
    })
}

/// Pixels to each side whose mean stands for a pixel's true value. Two: wide enough that a firefly's neighbours outvote
/// it, narrow enough to follow edges (of 3, 5, 7 and 11 pixels side length, 5 came nearest on nine scenes).
const REACH: usize = 2;

/// For every pixel the mean of the pixels around it, itself left out; its own value where it is alone.
fn means_around(size: PictureSize, means: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let (width, height) = (size.width() as usize, size.height() as usize);
    let window = |at: usize, end: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(end);
    let sum = |values: &mut dyn Iterator<Item = [f64; 3]>| {
        values.fold([0.0; 3], |sum, value| std::array::from_fn(|channel| sum[channel] + value[channel]))
    };
    let rows: Vec<[f64; 3]> = (0..means.len())
        .map(|index| {
            let (x, y) = (index % width, index / width);
            sum(&mut window(x, width).map(|x| means[y * width + x]))
        })
        .collect();
    (0..means.len())
        .map(|index| {
            let (x, y) = (index % width, index / width);
            let total = sum(&mut window(y, height).map(|y| rows[y * width + x]));
            let others = window(x, width).len() * window(y, height).len() - 1;
            match others {
                0 => means[index],
                _ => std::array::from_fn(|c| ((total[c] - means[index][c]) / others as f64).max(0.0)),
            }
        })
        .collect()
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
