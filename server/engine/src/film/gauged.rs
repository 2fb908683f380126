//! The error of a picture, measured at some pixels that are path-traced several times.

use rayon::prelude::*;

use super::{
    MeasuredError, PictureSize,
    measured::{Around, Beside, of_pixels},
    standing::Found,
    weights::Weights,
};
use crate::math::Rgb;

/// Groups of a gauged pixel's samples, independent of each other and of every picture. An error that is found with two of them is
/// weighed by what the other six found.
pub const GAUGED_GROUPS: usize = 8;

/// Errors that are in the mean below so many standard deviations of what is not known of them are hidden by that.
const HIDDEN: f64 = 2.0;

/// What path tracing says of one pixel, several times and independently of the picture and of each other: with d the value shown
/// and x₁, x₂ any two, (d − x₁)(d − x₂) has the expectation (d − truth)², bias included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaugedPixel {
    /// Place in the picture, row by row.
    pub index: usize,
    /// Pixels of the picture that it stands for, over those that each would stand for if all stood for as many.
    pub weight: f64,
    /// Its samples, over those of the pixels of its set that have the fewest.
    pub times: f64,
    /// Means of groups of as many samples, W/(m² sr).
    pub groups: [[f64; 3]; GAUGED_GROUPS],
    /// The first half of the groups have something in common, and so have the others: no error is found within a half.
    pub halves: bool,
    /// Variance of the mean of all, (W/(m² sr))², as far as their samples tell.
    pub variance: [f64; 3],
}

/// What a picture shows at a gauged pixel and around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shown {
    pub(super) at: [f64; 3],
    pub(super) around: Around,
}

/// Relative squared errors of some pixels, estimated, with their weights.
struct AtPixels {
    errors: Vec<f64>,
    /// Variance of each by what path tracing does not know of its pixel.
    noises: Vec<f64>,
    /// Standard deviation of the mean of the errors by what is not known of what they are relative to.
    doubt: f64,
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
        let shown_at = |pixel: &GaugedPixel| Shown {
            at: image[pixel.index].to_array().map(f64::from),
            around: Around::of(image, size, pixel.index),
        };
        let shown: Vec<Shown> = pixels.par_iter().map(shown_at).collect();
        let weights = Weights::of(pixels, &shown, size.width() as usize, mean);
        let (errors, noises) = (0..pixels.len())
            .into_par_iter()
            .map(|place| {
                let (pixel, shown) = (&pixels[place], shown[place].at);
                let of = |errors: [f64; 3]| pixel.weight * errors.into_iter().sum::<f64>() / 3.0;
                (of(pixel.errors(shown, &weights, place)), of(pixel.noises(shown, &weights, place)).powi(2))
            })
            .unzip();
        Some(AtPixels { errors, noises, doubt: weights.doubt(pixels, &shown) })
    }
}

/// The error of `image` (`[h × w]`, W/(m² sr)), bias included, by what is known of the truth at some of its pixels; `None`
/// below two of them and for pictures that are black all over.
///
/// - `least`: relMSE that the picture surely has, as that of its noise
pub fn measure_at(
    image: &[Rgb],
    size: PictureSize,
    pixels: &[GaugedPixel],
    least: f64,
) -> Option<MeasuredError> {
    let AtPixels { errors, noises, doubt } = AtPixels::of(image, size, pixels)?;
    let noise = noises.iter().sum::<f64>().sqrt() / noises.len() as f64;
    Some(of_pixels(&errors, Beside { noise, doubt, least }))
}

/// What would make a measure surer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lacking {
    /// Samples for its pixels: what is not known of each hides their error.
    Samples,
    /// Pixels: their errors differ by more than by what is not known of each.
    Pixels,
    /// Either.
    Both,
}

/// What such a measure lacks most.
pub fn lacking(image: &[Rgb], size: PictureSize, pixels: &[GaugedPixel]) -> Lacking {
    let Some(AtPixels { errors, noises, .. }) = AtPixels::of(image, size, pixels) else {
        return Lacking::Both;
    };
    let count = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let spread = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>();
    let noise = noises.iter().sum::<f64>();
    if spread > 2.0 * noise {
        Lacking::Pixels
    } else if mean < HIDDEN * noise.sqrt() / count {
        Lacking::Samples
    } else {
        Lacking::Both
    }
}

impl GaugedPixel {
    /// Pairs of groups that errors are found with.
    fn pairs(&self) -> impl Iterator<Item = [usize; 2]> + Clone + use<> {
        let halves = self.halves;
        let half = GAUGED_GROUPS / 2;
        let all = (0..GAUGED_GROUPS).flat_map(|i| (i + 1..GAUGED_GROUPS).map(move |j| [i, j]));
        all.filter(move |[i, j]| !halves || *i < half && *j >= half)
    }

    /// Σ of the groups' means.
    fn sum(&self, c: usize) -> f64 {
        self.groups.iter().map(|group| group[c]).sum()
    }

    /// What all of its samples say of channel `c`.
    pub(super) fn found(&self, c: usize) -> Found {
        Found { mean: self.sum(c) / GAUGED_GROUPS as f64, variance: self.variance[c], samples_share: 1.0 }
    }

    /// Mean of (d − x₁)(d − x₂) over the pairs, by channel, not weighed.
    pub(super) fn squared_errors(&self, shown: [f64; 3]) -> [f64; 3] {
        self.mean_over_pairs(shown, |_, _| 1.0)
    }

    /// The same, each pair weighed by what all the other groups found: a weight that knew of the same samples would be small where
    /// they are bright and large where they are dark, so that their noise would count as error. (Of the variance and of the ratios in
    /// `weights.rs` they are a part still, so little that a right picture reads as right: a test.)
    fn errors(&self, shown: [f64; 3], weights: &Weights, place: usize) -> [f64; 3] {
        let others = (GAUGED_GROUPS - 2) as f64;
        let share = others / GAUGED_GROUPS as f64;
        let sums: [f64; 3] = std::array::from_fn(|c| self.sum(c));
        self.mean_over_pairs(shown, |c, [i, j]| {
            let found = Found {
                mean: (sums[c] - self.groups[i][c] - self.groups[j][c]) / others,
                variance: self.variance[c] / share,
                samples_share: share,
            };
            weights.at(place, c).weight(Some(found))
        })
    }

    /// Mean of (d − x₁)(d − x₂), weighed, over the pairs, by channel.
    ///
    /// - `weight`: of a channel and a pair
    fn mean_over_pairs(&self, shown: [f64; 3], weight: impl Fn(usize, [usize; 2]) -> f64) -> [f64; 3] {
        let (pairs, count) = (self.pairs(), self.pairs().count() as f64);
        std::array::from_fn(|c| {
            let off = |group: usize| shown[c] - self.groups[group][c];
            let of_pair = |[i, j]: [usize; 2]| off(i) * off(j) * weight(c, [i, j]);
            pairs.clone().map(of_pair).sum::<f64>() / count
        })
    }

    /// Standard deviations of the errors. With e the error and v the variance of the mean of all k groups, the mean of the products of
    /// all pairs has the variance 4 e² v + 2 v² k / (k − 1); of those across halves only, 4 e² v + 4 v².
    fn noises(&self, shown: [f64; 3], weights: &Weights, place: usize) -> [f64; 3] {
        let squared = self.squared_errors(shown);
        let groups = GAUGED_GROUPS as f64;
        let pairing = if self.halves { 1.0 } else { 0.5 * groups / (groups - 1.0) };
        std::array::from_fn(|c| {
            let v = self.variance[c];
            let noise = (4.0 * v * (squared[c].max(0.0) + pairing * v)).sqrt();
            noise * weights.at(place, c).weight(Some(self.found(c)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        film::compare,
        math::{sobol::PixelSampler, statistics::RunningStatistics},
    };

    fn size() -> PictureSize {
        PictureSize::new(64, 48).unwrap()
    }

    /// A truth with waves from pixel to pixel and over the picture, bright and dark by a factor of twelve.
    fn truth() -> Vec<Rgb> {
        let of = |index: usize| {
            let (x, y) = ((index % 64) as f32, (index / 64) as f32);
            let wide = (0.11 * x).sin() * (0.17 * y + 1.0).cos();
            let fine = 1.0 + 0.15 * (2.1 * x + 1.3 * y).sin();
            let grey = fine * (1.2 * wide).exp();
            Rgb::new(grey, 0.7 * grey, 0.4 * grey * (1.5 + wide))
        };
        (0..size().pixel_count()).map(of).collect()
    }

    /// What a picture shows of the truth: times `factor` of a pixel's column, and blotches over tiles of 8 × 8 pixels.
    fn shown(truth: &[Rgb], factor: impl Fn(usize) -> f32, blotches: f32) -> Vec<Rgb> {
        let of = |(index, truth): (usize, &Rgb)| {
            let (x, y) = (index % 64, index / 64);
            let [u, ..] = PixelSampler::new(5, 0, (y / 8 * 8 + x / 8) as u32, 0).four(0);
            *truth * (factor(x) * (blotches * (2.0 * u - 1.0)).exp())
        };
        truth.iter().enumerate().map(of).collect()
    }

    /// A pixel gauged with samples of which four of five are black and the others exponentially distributed: each has nine times as
    /// much variance as the square of the mean.
    fn gauged(truth: Rgb, index: usize, seed: u64, samples: u32) -> GaugedPixel {
        gauged_by(truth, index, seed, samples, 0.2)
    }

    /// The same, with so large a share of samples that are not black.
    fn gauged_by(truth: Rgb, index: usize, seed: u64, samples: u32, lit: f32) -> GaugedPixel {
        let sample = |group: usize, number: u32| {
            let [u, v, ..] = PixelSampler::new(8 * seed + group as u64, 0, index as u32, number).four(0);
            let bright = if u < lit { -f64::from(1.0 - v).ln() / f64::from(lit) } else { 0.0 };
            truth.to_array().map(|channel| f64::from(channel) * bright)
        };
        let mut groups = [[0.0; 3]; GAUGED_GROUPS];
        let mut variance = [0.0; 3];
        let (count, in_group) = (f64::from(samples), f64::from(samples / 4));
        for (first, number) in (0..4).flat_map(|first| (0..samples / 4).map(move |number| (first, number))) {
            let of_halves = [first, first + 4];
            let both = of_halves.map(|group| sample(group, number));
            for c in 0..3 {
                (0..2).for_each(|half| groups[of_halves[half]][c] += both[half][c] / in_group);
                variance[c] += (both[0][c] - both[1][c]).powi(2) / (4.0 * count * count);
            }
        }
        GaugedPixel { index, weight: 1.0, times: 1.0, groups, halves: false, variance }
    }

    /// How a picture is measured, often.
    struct Judgement {
        /// Mean of √relMSE, over what it is.
        ratio: f64,
        /// Share of intervals that hold it.
        held: f64,
    }

    /// Measures a picture with so many pixels, one of each of as many runs of pixels, and so many samples of either half of each.
    fn judge(name: &str, image: &[Rgb], truth: &[Rgb], [count, samples]: [usize; 2]) -> Judgement {
        const ROUNDS: u64 = 200;
        let expected = compare(image, truth).unwrap().rel_mse;
        let (mut measured, mut held, mut widths) = (RunningStatistics::default(), 0, 0.0);
        for round in 0..ROUNDS {
            let run = truth.len() / count;
            let gauge = |place: usize| {
                let [u, ..] = PixelSampler::new(round, 1, place as u32, 0).four(0);
                let index = place * run + (u * run as f32) as usize;
                gauged(truth[index], index, round, samples as u32)
            };
            let pixels: Vec<GaugedPixel> = (0..count).map(gauge).collect();
            let error = measure_at(image, size(), &pixels, 0.0).unwrap();
            let [low, high] = error.interval_95;
            held += u32::from(low <= expected && expected <= high);
            measured.add(error.rel_mse);
            widths += (high / expected).sqrt() / ROUNDS as f64;
        }
        let ratio = (measured.mean() / expected).sqrt();
        let held = f64::from(held) / ROUNDS as f64;
        println!(
            "{name:<20} {count:>4} pixels: true {:>6.1} %, measured over true {ratio:.3}, upper end {widths:.2}, held {held:.3}",
            100.0 * expected.sqrt(),
        );
        Judgement { ratio, held }
    }

    /// Pictures that are three and ten times too bright and too dark, all over or in one half, and blotchy, are measured by how
    /// bright the truth is from noisy samples, and intervals hold their error. By what is shown their √relMSE would read 0.1 to 10
    /// times what it is.
    #[test]
    fn pictures_that_are_too_bright_or_too_dark_are_weighed_by_the_truth() {
        let truth = truth();
        for factor in [10.0, 3.0, 1.0 / 3.0, 0.1] {
            for (part, columns, counts) in [("all", 64, [64, 256]), ("half", 32, [256, 512])] {
                let image = shown(&truth, |x| if x < columns { factor } else { 1.0 }, 0.3);
                for count in counts {
                    let found = judge(&format!("{part} × {factor:.2}"), &image, &truth, [count, 16]);
                    assert!((found.ratio - 1.0).abs() < 0.15, "{part} × {factor}: {}", found.ratio);
                    assert!(found.held >= 0.9, "{part} × {factor}: held {}", found.held);
                }
            }
        }
    }

    /// What is hidden by noise lacks samples, what differs from pixel to pixel lacks pixels, and what is alike everywhere either.
    #[test]
    fn what_a_measure_lacks_is_told() {
        let truth = truth();
        let of = |factor: f32, blotches: f32, samples: u32| {
            let image = shown(&truth, |_| factor, blotches);
            let gauge = |place: usize| gauged(truth[place * 48 + 7], place * 48 + 7, 3, samples);
            lacking(&image, size(), &(0..64).map(gauge).collect::<Vec<_>>())
        };
        assert_eq!(of(1.0, 0.02, 64), Lacking::Samples);
        assert_eq!(of(1.0, 1.5, 4096), Lacking::Pixels);
        assert_eq!(of(1.3, 0.0, 1024), Lacking::Both);
        assert_eq!(lacking(&vec![Rgb::BLACK; truth.len()], size(), &[]), Lacking::Both);
    }

    /// A right picture has no error in the mean of many measures, of few samples that mostly find nothing too.
    #[test]
    fn noise_of_what_weighs_is_no_error() {
        let truth = truth();
        for samples in [16, 32] {
            let mut found = RunningStatistics::default();
            for round in 0..400 {
                let pixels: Vec<GaugedPixel> = (0..64)
                    .map(|place| gauged(truth[place * 48 + 7], place * 48 + 7, round, samples))
                    .collect();
                let errors = AtPixels::of(&truth, size(), &pixels).unwrap().errors;
                found.add(errors.iter().sum::<f64>() / errors.len() as f64);
            }
            let allowed = 0.01 + 3.0 * found.standard_error();
            assert!(found.mean().abs() < allowed, "{samples}: {} for {allowed}", found.mean());
        }
    }

    /// What the groups of a half have in common, as a map of photons that both looked into, is no error where it is told of, and is one
    /// where it is not. The right picture's errors then scatter as their noises say.
    #[test]
    fn what_halves_have_in_common_is_no_error() {
        let image = vec![Rgb::splat(1.0); size().pixel_count()];
        let [mut across, mut all] = [RunningStatistics::default(); 2];
        let mut scatter = RunningStatistics::default();
        for round in 0..200u64 {
            let gauge = |place: usize, halves: bool| {
                let half = |half: u64| {
                    let [u, ..] = PixelSampler::new(2 * round + half, 2, place as u32, 0).four(0);
                    0.8 + 0.4 * f64::from(u)
                };
                let common = [half(0), half(1)];
                let groups = std::array::from_fn(|group| [common[2 * group / GAUGED_GROUPS]; 3]);
                // Of the mean of two numbers from 0.8 to 1.2.
                let variance = [0.4 * 0.4 / 24.0; 3];
                GaugedPixel { index: place * 12, weight: 1.0, times: 1.0, groups, halves, variance }
            };
            for (halves, found) in [(true, &mut across), (false, &mut all)] {
                let pixels: Vec<GaugedPixel> = (0..256).map(|place| gauge(place, halves)).collect();
                let AtPixels { errors, noises, .. } = AtPixels::of(&image, size(), &pixels).unwrap();
                found.add(errors.iter().sum::<f64>() / 256.0);
                if halves {
                    let spread = errors.iter().map(|error| error * error).sum::<f64>();
                    scatter.add(spread / noises.iter().sum::<f64>());
                }
            }
        }
        // Of either half, a twelfth of 0.4²: three of seven pairs lie within one.
        let common = 3.0 / 7.0 * 0.4 * 0.4 / 12.0;
        assert!(across.mean().abs() < 0.02 * common + 3.0 * across.standard_error(), "{}", across.mean());
        assert!((all.mean() / common - 1.0).abs() < 0.1, "{} for {common}", all.mean());
        // The square of what was found stands for the error's own, and is taken for none where negative: up to a quarter and a half too
        // much noise.
        assert!((0.5..1.1).contains(&scatter.mean()), "{}", scatter.mean());
    }

    /// Where samples found no light at all, or at one pixel alone, what is measured is a number, and so is its interval.
    #[test]
    fn gauges_that_found_nothing_are_measures() {
        let truth = truth();
        for lit in [None, Some(3)] {
            let gauge = |place: usize| {
                let brightness = if lit == Some(place) { 1.0 } else { 0.0 };
                GaugedPixel {
                    index: place * 40,
                    weight: 1.0,
                    times: 1.0,
                    groups: [[brightness; 3]; GAUGED_GROUPS],
                    halves: false,
                    variance: [brightness; 3],
                }
            };
            let pixels: Vec<GaugedPixel> = (0..64).map(gauge).collect();
            let mut image = truth.clone();
            // One shows nothing either.
            image[0] = Rgb::BLACK;
            let error = measure_at(&image, size(), &pixels, 0.0).unwrap();
            let [low, high] = error.interval_95;
            assert!(error.rel_mse.is_finite() && low.is_finite() && high.is_finite(), "{lit:?}: {error:?}");
            assert!(error.rel_mse > 0.3, "it may be ten times too bright, for all that is known: {error:?}");
        }
    }

    /// What is too bright in scattered shadows is weighed by how dark they are, which their own samples know well, though those of one
    /// pixel in eleven elsewhere know next to nothing. By the mean of what all know, that would read a seventh too low.
    #[test]
    fn a_few_noisy_pixels_do_not_hide_what_the_others_know() {
        // Anywhere, so that no group of pixels is told by it.
        let is_shadow = |index: usize| (index as u32).wrapping_mul(0x9E37_79B9) >> 29 == 0;
        let of = |index: usize, shadow: f32| Rgb::splat(if is_shadow(index) { shadow } else { 1.0 });
        let truth: Vec<Rgb> = (0..size().pixel_count()).map(|index| of(index, 0.3)).collect();
        let image: Vec<Rgb> = (0..size().pixel_count()).map(|index| of(index, 0.4)).collect();
        let expected = compare(&image, &truth).unwrap().rel_mse;
        let mut measured = RunningStatistics::default();
        for round in 0..50 {
            let gauge = |place: usize| {
                let index = place * 11 / 2;
                let lit = if index.is_multiple_of(11) && !is_shadow(index) { 0.025 } else { 1.0 };
                gauged_by(truth[index], index, round, 256, lit)
            };
            let pixels: Vec<GaugedPixel> = (0..512).map(gauge).collect();
            measured.add(measure_at(&image, size(), &pixels, 0.0).unwrap().rel_mse);
        }
        let ratio = (measured.mean() / expected).sqrt();
        assert!((ratio - 1.0).abs() < 0.08, "{ratio} of {}", expected.sqrt());
    }

    /// What lies dark between the bright squares of a screen is weighed by itself, though its few samples know it to a third only. By what
    /// is around, 18 % would be told as 12.
    #[test]
    fn detail_is_weighed_by_itself() {
        let square = |index: usize| (index % 64 / 2, index / 64 / 2);
        let is_lit = |index: usize| {
            let (x, y) = square(index);
            ((32 * y + x) as u32).wrapping_mul(0x9E37_79B9) >> 30 == 0
        };
        let of = |index: usize, dark: f32| Rgb::splat(if is_lit(index) { 20.0 } else { dark });
        let truth: Vec<Rgb> = (0..size().pixel_count()).map(|index| of(index, 0.4)).collect();
        // Half of what is dark a half too bright.
        let wrong = |index: usize| if index.is_multiple_of(2) { 0.6 } else { 0.4 };
        let image: Vec<Rgb> = (0..size().pixel_count()).map(|index| of(index, wrong(index))).collect();
        for samples in [64, 256] {
            let found = judge("screen", &image, &truth, [256, samples]);
            assert!((found.ratio - 1.0).abs() < 0.2, "{samples}: {}", found.ratio);
            assert!(found.held >= 0.85, "{samples}: held {}", found.held);
        }
    }

    /// What is measured of a picture that is nearly right is not distorted by what noisy samples say of its weights.
    #[test]
    fn nearly_right_pictures_are_measured_as_before() {
        let truth = truth();
        for (blotches, samples, count) in [(0.1, 256, 64), (0.1, 256, 256), (0.02, 1024, 64)] {
            let image = shown(&truth, |_| 1.0, blotches);
            let found = judge(&format!("blotches {blotches}"), &image, &truth, [count, samples]);
            assert!((found.ratio - 1.0).abs() < 0.06, "{blotches} {samples}: {}", found.ratio);
            assert!(found.held >= 0.9, "{blotches} {samples}: held {}", found.held);
        }
    }
}
