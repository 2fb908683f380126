//! The error of a picture, measured without knowing the truth.

use rayon::prelude::*;

use super::{
    Film, PictureSize,
    error::trimmed_mean,
    pixel::Pixel,
    standing::{self, relative, standing, weighed},
};
use crate::math::{
    Rgb,
    statistics::{cut_normal_quantile, mean_of_squared},
};

/// Error of the picture shown, estimated without knowing the truth.
///
/// The squared error e² of each pixel is estimated without bias, for noise from two independent halves of a film
/// (`Pixel::squared_error_of_mean`), for all error from pairs of independent estimates of the truth ([`super::GaugedPixel`]), and
/// weighted as in the contract: relMSE ≈ mean over pixels and channels of e² / (m² + 0.01·m̄²), with m in the
/// place of the unknown reference.
///
/// m is the mean displayed value of the 5 × 5 pixels around, without the pixel itself, and where those differ by more than their noise
/// what the pixel itself shows, as far as that is known (`standing.rs`); where the truth is known of some pixels the mean is corrected by
/// that (`weights.rs`). The pixel's own value alone will not do: it is large whenever its error is, so that at 16 samples the picture of a
/// glass sphere with a true error of 92 % read 17 % (64 samples: 47 % read 15 %); with its neighbours 98 % and 47 %. Neighbours alone blur
/// what detail there is: the noise of small rooms in section read 0.80 to 0.84 of itself by them, so 0.87 to 0.99 (16 to 512 samples).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredError {
    /// Estimate of relMSE.
    pub rel_mse: f64,
    /// 95 % confidence interval of `rel_mse`: chance (the spread over the pixels) and the uncertain weights.
    pub interval_95: [f64; 2],
    /// `rel_mse` without the worst 0.1 % of pixels; `None` where too few pixels were looked at to say.
    pub trimmed: Option<f64>,
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
    measure_with(film, |seen| {
        let variance = film.image(0.0, Pixel::variance_of_mean);
        let width = film.size().width() as usize;
        let weights =
            standing::weights((&seen.shown, &variance), |index| seen.halves(index), width, seen.mean);
        seen.squared.par_iter().zip(weights).map(|(squared, weights)| weighed(*squared, weights)).collect()
    })
}

/// The same in a third of the time, for what is decided by it again and again and never told: pixels count by what is around, whatever detail
/// there is. (With [`measure`] in its place pictures by `auto` had 6 % fewer rays after 5 s.)
pub(super) fn measure_roughly(film: &Film) -> Option<MeasuredError> {
    measure_with(film, |seen| {
        let around = neighbourhood_mean(&seen.shown, film.size().width() as usize);
        let of_pixel = |index: usize| {
            relative(seen.squared[index], standing(around[index], seen.halves(index)), seen.mean)
        };
        (0..seen.shown.len()).into_par_iter().map(of_pixel).collect()
    })
}

/// What a film shows, by pixel.
struct SeenFilm {
    shown: Vec<[f64; 3]>,
    /// Squared error of that, by its halves.
    squared: Vec<[f64; 3]>,
    /// Over pixels and channels, more than zero.
    mean: f64,
}

impl SeenFilm {
    /// What the halves say: half of their difference is the root of the error.
    fn halves(&self, index: usize) -> [[f64; 3]; 2] {
        let (shown, squared) = (self.shown[index], self.squared[index]);
        [-1.0, 1.0].map(|way: f64| std::array::from_fn(|c| shown[c] + way * squared[c].sqrt()))
    }
}

/// - `errors`: relative squared errors of the pixels
fn measure_with(film: &Film, errors: impl FnOnce(&SeenFilm) -> Vec<f64>) -> Option<MeasuredError> {
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
    // Sums are taken in one order, one after the other: the figure does not depend on the threads.
    let mut errors = errors(&SeenFilm { shown, squared, mean });
    let (rel_mse, standard_error) = mean_and_standard_error(&errors);
    Some(MeasuredError {
        rel_mse,
        interval_95: interval_95(rel_mse, standard_error.hypot(WEIGHT_DEVIATION * rel_mse)),
        trimmed: Some(trimmed_mean(&mut errors)),
    })
}

/// What is known of the relative squared errors of pixels beside how they spread.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Beside {
    /// Standard deviation of their mean by noise of each, which lifts and lowers it alike: a part of how they spread.
    pub(super) noise: f64,
    /// Standard deviation of their mean that they do not show: it widens the interval. Whether the mean is more than chance, and
    /// where it is cut, is decided without it: it grows with the errors, and a mean that is lifted by what is not known of its
    /// weights would read too high wherever that is much.
    pub(super) doubt: f64,
    /// Their mean is at least this, unless they surely say less.
    pub(super) least: f64,
}

/// The error of a picture from the relative squared errors of some or all of its pixels.
///
/// Errors are skewed to the right: mean and deviation are taken for those of a lognormal distribution, but for what is noise, below the
/// mean. (As if all was skewed, a mean of 1.5 deviations of noise would have its lower end well above zero: in two-rooms B a
/// fifth of the intervals lay above the truth.)
///
/// The mean of estimates that need not be positive may also be hardly more than the least it can be, or below, by chance. Told are
/// then the mean of what it may be if before any root of what is above the least was as likely, and the quantile of the
/// normal distribution cut off there. (If any square was as likely, which expects large errors, two-rooms B read 13 where 5 % are
/// true.)
pub(super) fn of_pixels(errors: &[f64], beside: Beside) -> MeasuredError {
    let Beside { noise, doubt, least } = beside;
    let (mean, standard_error) = mean_and_standard_error(errors);
    let deviation = standard_error.hypot(WEIGHT_DEVIATION * mean);
    // What was measured may contradict it: it is relative to what is shown, which may be far from the truth.
    let least = if mean + Z * deviation.hypot(doubt) < least { 0.0 } else { least };
    if deviation.hypot(doubt) <= 0.0 {
        // All are zero.
        return MeasuredError { rel_mse: 0.0, interval_95: [0.0; 2], trimmed: None };
    }
    let above = mean - least;
    if above > 0.0 && above >= RESOLVED * deviation {
        let bounds = |deviation: f64| {
            let variance = (deviation / mean).powi(2).ln_1p();
            let (median, factor) = (mean * (-variance / 2.0).exp(), (Z * variance.sqrt()).exp());
            [median / factor, median * factor]
        };
        let noise = noise.min(standard_error);
        let skewed = (deviation * deviation - noise * noise).max(0.0).sqrt();
        let [low, _] = bounds(skewed.hypot(doubt));
        let low = mean - (mean - low).hypot(Z * noise);
        // A lognormal distribution of one mean has its quantile fall again as its deviation grows beyond all bounds.
        let [_, high] = bounds(deviation);
        let high = mean + (high - mean).hypot(Z * doubt);
        return MeasuredError { rel_mse: mean, interval_95: [low.max(least), high], trimmed: None };
    }
    // Farther below than this no normal distribution comes by chance.
    let z = if deviation > 0.0 { (above / deviation).max(-3.0) } else { 0.0 };
    let [rel_mse, high] =
        [mean_of_squared(z), cut_normal_quantile(z, 0.975)].map(|value| least + value * deviation);
    let high = rel_mse + (high - rel_mse).hypot(Z * doubt);
    MeasuredError { rel_mse, interval_95: [least, high], trimmed: None }
}

/// What a picture shows of the pixels around one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Around {
    /// The mean that [`neighbourhood_mean`] has for the pixel.
    pub(super) mean: [f64; 3],
    /// How far they are apart: their variance, but for the brightest of each channel, which may be a single sample.
    pub(super) variance: [f64; 3],
}

impl Around {
    pub(super) fn of(image: &[Rgb], size: PictureSize, index: usize) -> Around {
        let (width, height) = (size.width() as usize, size.height() as usize);
        let (x, y) = (index % width, index / width);
        let places = span(y, height).flat_map(|y| span(x, width).map(move |x| y * width + x));
        let colour = |place: usize| image[place].to_array().map(f64::from);
        let others: Vec<[f64; 3]> = places.filter(|place| *place != index).map(colour).collect();
        if others.is_empty() {
            return Around { mean: colour(index), variance: [0.0; 3] };
        }
        let sum = others.iter().fold([0.0; 3], added);
        let variance = |c: usize| {
            let brightest = others.iter().map(|other| other[c]).fold(0.0, f64::max);
            let count = (others.len() - 1).max(1) as f64;
            let mean = (sum[c] - brightest) / count;
            let squares: f64 = others.iter().map(|other| (other[c] - mean).powi(2)).sum();
            ((squares - (brightest - mean).powi(2)) / count).max(0.0)
        };
        Around {
            mean: sum.map(|channel| channel / others.len() as f64),
            variance: std::array::from_fn(variance),
        }
    }
}

/// Places at most [`REACH`] from `at`, of 0 … `end` − 1.
fn span(at: usize, end: usize) -> std::ops::Range<usize> {
    at.saturating_sub(REACH)..(at + REACH + 1).min(end)
}

fn added<const N: usize>(sum: [f64; N], value: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|channel| sum[channel] + value[channel])
}

/// Standard deviation of the estimate by its weights, relative: that of the twelve measurements above (3.4 % of the
/// error is 7 % of its square).
const WEIGHT_DEVIATION: f64 = 0.07;
/// A mean so many times its deviation above zero is not there by chance alone.
const RESOLVED: f64 = 1.25;
/// 97.5 % quantile of the normal distribution.
const Z: f64 = 1.959_964;
/// Pixels to either side that count as neighbours. With 1 the weights are still noisy (the glass sphere at 16 samples
/// reads 103 %); more than 2 blurs detail (of 3, 5, 7 and 11 pixels side length, 5 came nearest on nine scenes).
const REACH: usize = 2;

/// Mean of the pixels at most [`REACH`] away, without the pixel itself; itself where it has no neighbour.
/// `image`: `[h × width]`.
pub(super) fn neighbourhood_mean<const N: usize>(image: &[[f64; N]], width: usize) -> Vec<[f64; N]> {
    let height = image.len() / width;
    // First along rows, then along columns: ten additions a pixel instead of 24.
    let across: Vec<[f64; N]> = (0..image.len())
        .into_par_iter()
        .map(|index| {
            let row = index - index % width;
            image[row..][span(index % width, width)].iter().fold([0.0; N], added)
        })
        .collect();
    let around = |index: usize| {
        let (x, y) = (index % width, index / width);
        let count = span(x, width).len() * span(y, height).len() - 1;
        if count == 0 {
            return image[index];
        }
        let sum = span(y, height).map(|row| &across[row * width + x]).fold([0.0; N], added);
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
    use crate::{film::PixelSample, math::sobol::PixelSampler, transport::PathClass};

    /// Whatever is measured and known beside it, what is told lies in its interval, and all of it is a number from zero on.
    #[test]
    fn what_is_told_lies_in_its_interval() {
        for mean in [-1.0, -1e-3, 0.0, 1e-6, 0.01, 1.0, 1e9] {
            for spread in [0.0, 1e-4, 0.1, 10.0] {
                for (noise, doubt) in [(0.0, 0.0), (1e-3, 0.0), (1e9, 1e-3), (0.0, 1e12)] {
                    for least in [0.0, 1e-3, 0.02, 5.0] {
                        let errors: Vec<f64> =
                            (0..64).map(|i| mean + spread * (f64::from(i % 8) - 3.5)).collect();
                        let found = of_pixels(&errors, Beside { noise, doubt, least });
                        let [low, high] = found.interval_95;
                        let is_ordered = 0.0 <= low && low <= found.rel_mse && found.rel_mse <= high;
                        assert!(is_ordered, "{mean} ± {spread}, {noise}, {doubt}, {least}: {found:?}");
                        assert!(high.is_finite());
                    }
                }
            }
        }
    }

    /// The interval of a mean that may be noise reaches down to nothing; that of as large a mean of errors that differ from pixel to
    /// pixel does not. What a picture surely has lifts what is told, unless it was measured to be wrong.
    #[test]
    fn noise_and_errors_are_told_apart() {
        let errors: Vec<f64> = (0..64).map(|i| 1.5 + 8.0 * f64::from(2 * (i % 2) - 1)).collect();
        let of = |noise: f64, least: f64| of_pixels(&errors, Beside { noise, least, doubt: 0.0 });
        assert_eq!(of(10.0, 0.0).interval_95[0], 0.0);
        assert!(of(0.0, 0.0).interval_95[0] > 0.2);
        let lifted = of(10.0, 1.2);
        assert!(lifted.interval_95[0] == 1.2 && lifted.rel_mse > 1.2);
        assert_eq!(of(10.0, 9.0), of(10.0, 0.0));
        // No error at any pixel is told as that, which callers take for knowing nothing.
        assert_eq!(of_pixels(&[0.0; 64], Beside { least: 1.0, ..Beside::default() }).interval_95, [0.0; 2]);
    }

    /// The edges of small lamps in the dark are measured by their own light: as a sheet of such pixels is.
    #[test]
    fn small_lamps_are_not_measured_by_the_dark() {
        const PASSES: u32 = 64;
        let size = PictureSize::new(48, 48).unwrap();
        // One pixel in 16 is covered by half a lamp, in the mean 5.
        let is_edge = |x: u32, y: u32| x % 4 == 1 && y % 4 == 2;
        let mut film = Film::new(size);
        for pass in 0..PASSES {
            film.tiles_mut().iter_mut().for_each(|tile| {
                tile.add_pass(|x, y| {
                    let [u, ..] = PixelSampler::new(3, pass, y * 48 + x, 0).four(0);
                    let light = if !is_edge(x, y) { 0.1 } else { 10.0 * f32::from(u8::from(u < 0.5)) };
                    let mut sample = PixelSample::BLACK;
                    sample.radiance[PathClass::Emitted as usize] = Rgb::splat(light);
                    sample
                });
            });
        }
        // Of a lamp's pixel the samples have the variance 25.
        let mean = (15.0 * 0.1 + 5.0) / 16.0;
        let expected = 25.0 / f64::from(PASSES) / (25.0 + 0.01 * mean * mean) / 16.0;
        let found = measure(&film).unwrap().rel_mse;
        assert!((found / expected - 1.0).abs() < 0.4, "{found} for {expected}");
    }

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
