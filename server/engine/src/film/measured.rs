//! The error of a picture, measured without knowing the truth.

use rayon::prelude::*;

use super::{Film, PictureSize, error::trimmed_mean, pixel::Pixel};
use crate::math::{
    Rgb,
    statistics::{cut_normal_mean, cut_normal_quantile},
};

/// Error of the picture shown, estimated without knowing the truth.
///
/// The squared error e² of each pixel is estimated without bias, for noise from two independent halves of a film
/// (`Pixel::squared_error_of_mean`), for all error from two independent estimates of the truth ([`GaugedPixel`]), and
/// weighted as in the contract: relMSE ≈ mean over pixels and channels of e² / (m² + 0.01·m̄²), with m in the
/// place of the unknown reference.
///
/// m is the mean displayed value of the 5 × 5 pixels around, without the pixel itself. Its own value will not do:
/// it is large whenever its error is, so that at 16 samples the picture of a glass sphere with a true error of
/// 92 % read 17 % (64 samples: 47 % read 15 %); with its neighbours 98 % and 47 %. What remains is the
/// picture's own detail, which neighbours blur: on six scenes at 16 and 64 samples the figure was between 5 % of
/// itself too small and 8 % too large.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredError {
    /// Estimate of relMSE.
    pub rel_mse: f64,
    /// 95 % confidence interval of `rel_mse`: chance (the spread over the pixels) and the uncertain weights.
    pub interval_95: [f64; 2],
    /// `rel_mse` without the worst 0.1 % of pixels; `None` where too few pixels were looked at to say.
    pub trimmed: Option<f64>,
}

/// What path tracing says of one pixel, twice and independently of the picture and of each other: with d the value shown and
/// x₁, x₂ the two, (d − x₁)(d − x₂) has the expectation (d − truth)², bias included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugedPixel {
    /// Place in the picture, row by row.
    pub index: usize,
    /// Pixels of the picture that it stands for, over those that each would stand for if all stood for as many.
    pub weight: f64,
    /// x₁ and x₂, W/(m² sr).
    pub halves: [[f64; 3]; 2],
    /// Variance of their mean, (W/(m² sr))², as far as its samples tell.
    pub variance: [f64; 3],
}

impl MeasuredError {
    /// What people are shown: √relMSE, a share (0.01 = 1 %).
    pub fn error(&self) -> f64 {
        self.rel_mse.sqrt()
    }

    /// A picture that is exactly right.
    pub const NONE: MeasuredError = MeasuredError { rel_mse: 0.0, interval_95: [0.0; 2], trimmed: Some(0.0) };

    /// How far above the error asked for the true one may be.
    pub const SURENESS: f64 = 1.1;

    /// Whether a picture with this measure is as good as `target` (√relMSE): by the estimate, and surely not a tenth worse.
    pub fn reaches(&self, target: f64) -> bool {
        let [_, high] = self.error_interval_95();
        self.error() <= target && high <= Self::SURENESS * target
    }

    /// The less doubtful of two measures of one picture.
    pub fn surer(self, other: MeasuredError) -> MeasuredError {
        let doubt = |error: &MeasuredError| {
            let [low, high] = error.interval_95;
            (high - low) / error.rel_mse.max(f64::MIN_POSITIVE)
        };
        if doubt(&other) < doubt(&self) { other } else { self }
    }

    /// Interval of [`MeasuredError::error`].
    pub fn error_interval_95(&self) -> [f64; 2] {
        self.interval_95.map(f64::sqrt)
    }
}

/// Passes after which a picture that is black all over counts as truly black, error 0: before, light may just not have
/// been found yet.
pub const BLACK_PASSES: u32 = 64;

/// The noise of a film. `None` when the halves of a tile hold fewer than two passes, or all is black and they hold fewer than
/// [`BLACK_PASSES`].
pub(super) fn measure(film: &Film) -> Option<MeasuredError> {
    let passes = film.halves_passes_min();
    if passes < 2 {
        return None;
    }
    let shown = film.image([0.0; 3], Pixel::total_mean);
    let squared = film.image([0.0; 3], Pixel::squared_error_of_mean);
    let mean = shown.iter().flatten().sum::<f64>() / (3 * shown.len()) as f64;
    if mean <= 0.0 {
        return (passes >= BLACK_PASSES).then_some(MeasuredError::NONE);
    }
    let around = neighbourhood_mean(&shown, film.size().width() as usize);
    // Sums are taken in one order, one after the other: the figure does not depend on the threads.
    let mut errors: Vec<f64> =
        squared.par_iter().zip(&around).map(|(squared, around)| relative(*squared, *around, mean)).collect();
    let (rel_mse, standard_error) = mean_and_standard_error(&errors);
    Some(MeasuredError {
        rel_mse,
        interval_95: interval_95(rel_mse, standard_error.hypot(WEIGHT_DEVIATION * rel_mse)),
        trimmed: Some(trimmed_mean(&mut errors)),
    })
}

/// Squared error of a pixel over what stands for the square of the truth there, mean over the channels.
///
/// - `around`: mean radiance around the pixel
/// - `mean`: that of the picture, more than zero
pub(super) fn relative(squared: [f64; 3], around: [f64; 3], mean: f64) -> f64 {
    let floor = 0.01 * mean * mean;
    squared.iter().zip(around).map(|(e, m)| e / (m * m + floor)).sum::<f64>() / 3.0
}

/// The error of a picture from the relative squared errors of some or all of its pixels.
///
/// Errors are skewed to the right: mean and deviation are taken for those of a lognormal distribution. The mean of estimates
/// that need not be positive may also be next to nothing, or less, by chance. What is then known is that the error is not
/// negative: the mean and the quantile of the normal distribution of the mean, cut off at zero, are told.
pub(super) fn of_pixels(errors: &[f64]) -> MeasuredError {
    let (mean, standard_error) = mean_and_standard_error(errors);
    let deviation = standard_error.hypot(WEIGHT_DEVIATION * mean);
    if deviation <= 0.0 {
        return MeasuredError { rel_mse: mean.max(0.0), interval_95: [mean.max(0.0); 2], trimmed: None };
    }
    let z = mean / deviation;
    if z >= RESOLVED {
        let variance = (1.0 / (z * z)).ln_1p();
        let (median, factor) = (mean * (-variance / 2.0).exp(), (Z * variance.sqrt()).exp());
        return MeasuredError {
            rel_mse: mean,
            interval_95: [median / factor, median * factor],
            trimmed: None,
        };
    }
    // Farther below zero than this no normal distribution comes by chance.
    let z = z.max(-3.0);
    let [rel_mse, high] = [cut_normal_mean(z), cut_normal_quantile(z, 0.975)].map(|value| value * deviation);
    MeasuredError { rel_mse, interval_95: [0.0, high], trimmed: None }
}

/// Relative squared errors of some pixels, estimated, with their weights.
struct AtPixels {
    errors: Vec<f64>,
    /// Variance of each by what path tracing does not know of its pixel.
    noises: Vec<f64>,
}

impl AtPixels {
    /// `None` below two pixels and for pictures that are black all over.
    fn of(image: &[Rgb], size: PictureSize, pixels: &[GaugedPixel]) -> Option<AtPixels> {
        let sum =
            |total: f64, colour: &Rgb| total + colour.to_array().into_iter().map(f64::from).sum::<f64>();
        let mean = image.iter().fold(0.0, sum) / (3 * image.len()) as f64;
        if mean <= 0.0 || pixels.len() < 2 {
            return None;
        }
        let floor = 0.01 * mean * mean;
        let typical: [f64; 3] = std::array::from_fn(|c| {
            let relative = |pixel: &GaugedPixel| pixel.variance[c] / (pixel.mean(c).powi(2) + floor);
            pixels.iter().map(relative).sum::<f64>() / pixels.len() as f64
        });
        let of_pixel = |pixel: &GaugedPixel| {
            let shown = image[pixel.index].to_array().map(f64::from);
            let [a, b] = &pixel.halves;
            let squared: [f64; 3] = std::array::from_fn(|c| (shown[c] - a[c]) * (shown[c] - b[c]));
            // Of a product of two numbers with the mean e and twice the variance v of their mean: 2 e² · 2v + (2v)².
            let noise: [f64; 3] = std::array::from_fn(|c| {
                let v = pixel.variance[c];
                (4.0 * v * (squared[c].max(0.0) + v)).sqrt()
            });
            let around = mean_around(image, size, pixel.index);
            let truth = std::array::from_fn(|c| pixel.brightness(around[c], c, typical[c]));
            let of = |squares| pixel.weight * relative(squares, truth, mean);
            (of(squared), of(noise).powi(2))
        };
        let (errors, noises) = pixels.iter().map(of_pixel).unzip();
        Some(AtPixels { errors, noises })
    }
}

/// The error of `image` (`[h × w]`, W/(m² sr)), bias included, by what is known of the truth at some of its pixels; `None`
/// below two of them and for pictures that are black all over.
pub fn measure_at(image: &[Rgb], size: PictureSize, pixels: &[GaugedPixel]) -> Option<MeasuredError> {
    Some(of_pixels(&AtPixels::of(image, size, pixels)?.errors))
}

/// Whether more pixels would make such a measure surer than more samples for these: their errors differ by more than by what is
/// not known of each.
pub fn wants_more_pixels(image: &[Rgb], size: PictureSize, pixels: &[GaugedPixel]) -> bool {
    let Some(AtPixels { errors, noises }) = AtPixels::of(image, size, pixels) else { return false };
    let count = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let spread = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>();
    spread > 2.0 * noises.iter().sum::<f64>()
}

impl GaugedPixel {
    /// Mean of all of its samples in channel `c`.
    fn mean(&self, c: usize) -> f64 {
        0.5 * (self.halves[0][c] + self.halves[1][c])
    }

    /// What stands for the truth where an error is weighed by it: what the picture shows around the pixel, and, as far as that is
    /// surely wrong, what was found in its place. A room that is drawn ten times too bright would else be measured by its own
    /// brightness: 14 % were shown for 74. Where the two agree within chance nothing that was found counts: its noise would
    /// weigh itself.
    ///
    /// - `around`: the picture's mean around the pixel, in channel `c`
    /// - `typical`: relative variance of other pixels' means: few samples of one pixel may have found no light at all, and agree
    ///   on that
    fn brightness(&self, around: f64, c: usize, typical: f64) -> f64 {
        let off = self.mean(c) - around;
        let chance = SURELY * SURELY * self.variance[c].max(typical * around * around);
        if off * off > chance { around + off * (1.0 - chance / (off * off)) } else { around }
    }
}

/// The mean that [`neighbourhood_mean`] has for one pixel.
fn mean_around(image: &[Rgb], size: PictureSize, index: usize) -> [f64; 3] {
    let (width, height) = (size.width() as usize, size.height() as usize);
    let (x, y) = (index % width, index / width);
    let places = span(y, height).flat_map(|y| span(x, width).map(move |x| y * width + x));
    let others: Vec<usize> = places.filter(|place| *place != index).collect();
    let colour = |place: usize| image[place].to_array().map(f64::from);
    if others.is_empty() {
        return colour(index);
    }
    let sum = others.iter().fold([0.0; 3], |sum, place| added(sum, &colour(*place)));
    sum.map(|channel| channel / others.len() as f64)
}

/// Places at most [`REACH`] from `at`, of 0 … `end` − 1.
fn span(at: usize, end: usize) -> std::ops::Range<usize> {
    at.saturating_sub(REACH)..(at + REACH + 1).min(end)
}

fn added(sum: [f64; 3], value: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|channel| sum[channel] + value[channel])
}

/// Standard deviation of the estimate by its weights, relative: that of the twelve measurements above (3.4 % of the
/// error is 7 % of its square).
const WEIGHT_DEVIATION: f64 = 0.07;
/// A mean so many times its deviation above zero is not there by chance alone.
const RESOLVED: f64 = 1.25;
/// What differs by so many times its standard deviation does not by chance.
const SURELY: f64 = 3.0;
/// 97.5 % quantile of the normal distribution.
const Z: f64 = 1.959_964;
/// Pixels to either side that count as neighbours. With 1 the weights are still noisy (the glass sphere at 16 samples
/// reads 103 %); more than 2 blurs detail (of 3, 5, 7 and 11 pixels side length, 5 came nearest on nine scenes).
const REACH: usize = 2;

/// Mean of the pixels at most [`REACH`] away, without the pixel itself; itself where it has no neighbour.
/// `image`: `[h × width]`.
pub(super) fn neighbourhood_mean(image: &[[f64; 3]], width: usize) -> Vec<[f64; 3]> {
    let height = image.len() / width;
    // First along rows, then along columns: ten additions a pixel instead of 24.
    let across: Vec<[f64; 3]> = (0..image.len())
        .into_par_iter()
        .map(|index| {
            let row = index - index % width;
            image[row..][span(index % width, width)].iter().fold([0.0; 3], added)
        })
        .collect();
    let around = |index: usize| {
        let (x, y) = (index % width, index / width);
        let count = span(x, width).len() * span(y, height).len() - 1;
        if count == 0 {
            return image[index];
        }
        let sum = span(y, height).map(|row| &across[row * width + x]).fold([0.0; 3], added);
        // Rounding may leave less than nothing of black neighbours around a bright pixel.
        std::array::from_fn(|channel| ((sum[channel] - image[index][channel]) / count as f64).max(0.0))
    };
    (0..image.len()).into_par_iter().map(around).collect()
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
    if mean <= 0.0 {
        return [0.0, 0.0];
    }
    let factor = (Z * standard_error / mean).exp();
    [mean / factor, mean * factor]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fast mean is the plain one, borders and single pixels included.
    #[test]
    fn neighbourhood_mean_is_the_mean_of_the_neighbours() {
        for (width, height) in [(1, 1), (2, 1), (1, 7), (4, 3), (9, 8)] {
            let value = |x: usize, y: usize| [(x * x + 3 * y) as f64, y as f64, 1.0];
            let image: Vec<[f64; 3]> =
                (0..width * height).map(|index| value(index % width, index / width)).collect();
            let fast = neighbourhood_mean(&image, width);
            for (index, fast) in fast.iter().enumerate() {
                let (x, y) = (index % width, index / width);
                let near = |a: usize, b: usize| a.abs_diff(b) <= REACH;
                let others = (0..image.len())
                    .filter(|other| *other != index && near(other % width, x) && near(other / width, y));
                let others: Vec<[f64; 3]> = others.map(|other| image[other]).collect();
                for channel in 0..3 {
                    let sum: f64 = others.iter().map(|value| value[channel]).sum();
                    let plain =
                        if others.is_empty() { image[index][channel] } else { sum / others.len() as f64 };
                    assert!((fast[channel] - plain).abs() < 1e-9, "{width}×{height} {index}");
                }
            }
        }
    }

    /// The interval is the textbook one on a logarithmic scale.
    #[test]
    fn interval_of_chance_is_symmetric_in_the_logarithm() {
        let (mean, standard_error) = mean_and_standard_error(&[1.0, 2.0, 3.0, 6.0]);
        assert_eq!(mean, 3.0);
        assert!((standard_error - (14.0f64 / 3.0 / 4.0).sqrt()).abs() < 1e-12);
        let [low, high] = interval_95(3.0, 0.3);
        assert!((low * high - 9.0).abs() < 1e-9 && ((high / 3.0).ln() - 0.195_996_4).abs() < 1e-6);
        assert_eq!(interval_95(0.0, 0.0), [0.0, 0.0]);
    }
}
