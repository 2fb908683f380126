//! What stands for the truth in a pixel, where its error is relative to that.
//!
//! The truth is not known, and neither of the two that might stand for it will do by itself. A pixel's own value is large whenever its error
//! is; what is around it is another light where the picture has detail. So a pixel counts as far as it is known: what is around is what was
//! expected of it, with the variance that it has among those pixels beyond their noise, and its own samples are the evidence. Screens,
//! shelves and small rooms in section are weighed by their own light then, and specks by what is around.

use rayon::prelude::*;

use super::{measured::neighbourhood_mean, pixel::luminance};

/// Square of that from which on what a single pixel found is believed at all: its noise would weigh itself. At 2, and in shares, a
/// picture that was right read 25 % with 16 samples of which one in five found light.
const PIXELS_CHANCE: f64 = 9.0;

/// A pixel's find is known by its own samples once its mean is as many times its deviation as the root of this: by some that found
/// light, not by one or none. Before, its noise is taken for that of all pixels: at a hundredth of the light's pixels, each finding
/// light with one sample in fifty, a right picture would read 100 % and more.
const EVIDENT: f64 = 16.0;

/// Where the picture shows detail, a pixel may be off the mean around it by so many times the variance of that, as they are themselves, and
/// what it found is no surprise …
const DETAIL: f64 = 4.0;
/// … and known by its own samples from a lower multiple on: what is around says little there. (A screen of small bright squares on black, by
/// octree and `auto` for 3 s: with the bounds above, what lies between read so much too little that of 10 to 12 % errors of 8 to 9
/// were told.)
const EVIDENT_IN_DETAIL: f64 = 4.0;

/// One channel of a pixel and what its error is to be weighed by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    /// What the picture shows around, corrected where more is known of that.
    pub(super) around: f64,
    /// Variance of what it shows around, over the square of its mean.
    pub(super) contrast: f64,
    /// What it shows in the pixel itself.
    pub(super) at: f64,
    /// Relative variance of what a pixel finds, as usual: few samples of one may have found no light at all, and agree on that.
    pub(super) usual: f64,
    /// The same of the mean over all, which counts where its own samples say little.
    pub(super) typical: f64,
    /// 0.01·m̄², m̄ the mean of the truth.
    pub(super) floor: f64,
}

/// What some samples of a pixel say of one channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub(super) mean: f64,
    /// Of the mean.
    pub(super) variance: f64,
    /// Their share in the pixel's samples.
    pub(super) samples_share: f64,
}

impl Standing {
    /// One over what stands for the square of the truth, R² + 0.01·m̄²: R is what the picture shows around, corrected, and, as far
    /// as that is surely wrong or the picture shows as much detail there, what was `found` in its place.
    pub(super) fn weight(&self, found: Option<Found>) -> f64 {
        let Some(found) = found else { return 1.0 / (self.around * self.around + self.floor) };
        // What seldom finds light may agree with itself by chance alone.
        let is_evident = found.variance * EVIDENT <= found.mean * found.mean;
        let least = if is_evident { self.usual } else { self.typical.max(self.usual) } / found.samples_share;
        let off = found.mean - self.around;
        let noise = found.variance.max(least * self.around * self.around);
        let chance = PIXELS_CHANCE * noise;
        let by_pixel =
            if off * off > chance { self.around + off * (1.0 - chance / (off * off)) } else { self.around };
        // Where the picture agrees with the pixel's samples that it is another light than around, and not by chance, these count.
        let is_agreed = is_evident && is_another(self.around, [self.at, found.mean]);
        if is_agreed {
            return 1.0 / (found.mean * found.mean + self.floor);
        }
        let detail = self.contrast * self.around * self.around;
        if off * off >= DETAIL * detail {
            return 1.0 / (by_pixel * by_pixel + self.floor);
        }
        // Light and dark lie side by side: what is around does not say which it is.
        let is_known = found.mean > 0.0 && found.variance * EVIDENT_IN_DETAIL <= found.mean * found.mean;
        let own = found.variance.max(self.usual / found.samples_share * found.mean * found.mean);
        let noise = if is_known { own } else { noise };
        let share = detail / (detail + noise);
        let truth = self.around + share * off;
        // Of a number x with the variance v, here share² · noise, 1 / (x² + 3 v) has the mean that 1 / x² has without, to the first order.
        1.0 / (truth * truth + 3.0 * share * (1.0 - share) * detail + self.floor)
    }
}

/// Of every pixel and channel of an image, one over what stands for the square of the truth there, R² + 0.01·m̄².
///
/// - `image`: what is shown, `[h × width]`, W/(m² sr)
/// - `variance`: of each pixel's luminance, by its samples, (W/(m² sr))²
/// - `known`: two that know a pixel, independent of each other; where they agree that there is another light than around, the pixel counts
/// - `mean`: of the picture, over pixels and channels, more than zero
pub(super) fn weights(
    (image, variance): (&[[f64; 3]], &[f64]),
    known: impl Fn(usize) -> [[f64; 3]; 2] + Sync,
    width: usize,
    mean: f64,
) -> Vec<[f64; 3]> {
    let seen: Vec<[f64; 5]> = image
        .par_iter()
        .zip(variance)
        .map(|(&[r, g, b], variance)| [r, g, b, luminance([r, g, b]).powi(2), *variance])
        .collect();
    let around = neighbourhood_mean(&seen, width);
    // Relative variance of a pixel; samples that found nothing agree, and know of none.
    let relative = |index: usize| match seen[index] {
        [.., squared, variance] if squared > 0.0 => variance / squared,
        _ => f64::INFINITY,
    };
    let is_lit = |index: &usize| seen[*index][3] > 0.0 || around[*index][3] > 0.0;
    let usual = median((0..seen.len()).filter(is_lit).map(relative).collect());
    let [squares, variances] =
        seen.iter().fold([0.0; 2], |[squares, variances], [.., s, v]| [squares + s, variances + v]);
    let typical = if squares > 0.0 { variances / squares } else { 0.0 };
    let floor = 0.01 * mean * mean;
    let of_pixel = |index: usize| {
        let [r, g, b, squared, noise] = around[index];
        let brightness = luminance([r, g, b]).powi(2);
        // Noise is no detail. A speck has as much of it as of that.
        let detail = (squared - brightness - noise).max(0.0);
        let contrast = if brightness > 0.0 { detail / brightness } else { 0.0 };
        let variance = if seen[index][3] > 0.0 { relative(index) } else { 0.0 };
        let known = known(index);
        std::array::from_fn(|c| {
            let (around, mean) = ([r, g, b][c], image[index][c]);
            if is_another(around, known.map(|known| known[c])) {
                return 1.0 / (mean * mean + floor);
            }
            // Beside those two nobody's word counts.
            let standing = Standing { around, contrast, at: around, usual, typical, floor };
            standing.weight(Some(Found { mean, variance: variance * mean * mean, samples_share: 1.0 }))
        })
    };
    (0..image.len()).into_par_iter().map(of_pixel).collect()
}

/// The value in the midst; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Squared error of a pixel, weighed, mean over the channels.
///
/// - `weights`: one over what the square of each channel's error is relative to
pub(super) fn weighed(squared: [f64; 3], weights: [f64; 3]) -> f64 {
    squared.iter().zip(weights).map(|(squared, weight)| squared * weight).sum::<f64>() / 3.0
}

/// What stands for the truth in a pixel: the mean around, unless two that know the pixel itself, independent of each other, agree that
/// there is another light than around; then their mean. A small lamp in the dark, and its edges, would else be measured by the dark, and
/// what is dark beside light by that. (A room with sixty small lamps in its ceiling, path-traced for 4 s, has 9.5 %, and read 15.4 for
/// 10.4 so.) Not the one that says less so: the farther the two are apart, the larger their error, and the smaller what it is relative to.
pub(super) fn standing(around: [f64; 3], known: [[f64; 3]; 2]) -> [f64; 3] {
    std::array::from_fn(|c| {
        let known = known.map(|known| known[c]);
        if is_another(around[c], known) { (0.5 * (known[0] + known[1])).max(0.0) } else { around[c] }
    })
}

/// Both are more than twice as bright as around, or both less than half so.
pub(super) fn is_another(around: f64, known: [f64; 2]) -> bool {
    let [less, more] = [known[0].min(known[1]), known[0].max(known[1])];
    less > OTHERWISE * around || OTHERWISE * more < around
}

/// So many times as bright as around, or as dark, is another light than there.
const OTHERWISE: f64 = 2.0;

/// Squared error of a pixel over what stands for the square of the truth there, mean over the channels.
///
/// - `around`: mean radiance around the pixel
/// - `mean`: that of the picture, more than zero
pub(super) fn relative(squared: [f64; 3], around: [f64; 3], mean: f64) -> f64 {
    let floor = 0.01 * mean * mean;
    squared.iter().zip(around).map(|(e, m)| e / (m * m + floor)).sum::<f64>() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        film::{Film, Picture, PictureSize, PixelSample},
        math::{Rgb, sobol::PixelSampler},
        transport::PathClass,
    };

    const SIDE: u32 = 48;

    /// A film of light that is so bright by pixel, seed and pass.
    fn film(passes: u32, light: impl Fn(u32, u32, u32) -> f32 + Sync) -> Film {
        let mut film = Film::new(PictureSize::new(SIDE, SIDE).unwrap());
        for pass in 0..passes {
            for tile in film.tiles_mut() {
                tile.add_pass(|x, y| {
                    let mut sample = PixelSample::BLACK;
                    sample.radiance[PathClass::Direct as usize] = Rgb::splat(light(x, y, pass));
                    sample
                });
            }
        }
        film
    }

    /// Bright lines between dark cells of two by two pixels.
    fn lattice(x: u32, y: u32) -> f32 {
        if x.is_multiple_of(3) || y.is_multiple_of(3) { 10.0 } else { 1.0 }
    }

    /// A sample of it: what it is times 1 ± 1, by a uniform number, whose variance is a third.
    fn sampled(seed: u64, x: u32, y: u32, pass: u32) -> f32 {
        // The halves of a film are independent sequences.
        let [u, ..] = PixelSampler::new(seed, pass & 1, y * SIDE + x, pass >> 1).four(0);
        lattice(x, y) * 2.0 * u
    }

    /// relMSE of a lattice whose every pixel has the same relative squared error, over that.
    fn share_of_lattice() -> f64 {
        let pixels = || (0..SIDE * SIDE).map(|at| f64::from(lattice(at % SIDE, at / SIDE)));
        let count = f64::from(SIDE * SIDE);
        let floor = 0.01 * (pixels().sum::<f64>() / count).powi(2);
        pixels().map(|truth| truth * truth / (truth * truth + floor)).sum::<f64>() / count
    }

    /// Where light and dark lie side by side each is measured by itself: the noise of a film, and the error of one beside a path-traced one,
    /// are the true ones, though a mean of what is around would make the dark ones' next to nothing.
    #[test]
    fn detail_is_weighed_by_itself() {
        let truth = share_of_lattice();
        for seed in 0..4 {
            let noisy = |seed, passes| film(passes, move |x, y, pass| sampled(seed, x, y, pass));
            for passes in [16, 64, 256] {
                // Evenly spread samples have less noise than as many that know nothing of each other: what this film is off by.
                let film = noisy(seed, passes);
                let off = |(at, shown): (usize, Rgb)| {
                    (shown.g / lattice(at as u32 % SIDE, at as u32 / SIDE) - 1.0).powi(2)
                };
                let squared = film.radiance().into_iter().enumerate().map(off).sum::<f32>();
                let expected = truth * f64::from(squared) / f64::from(SIDE * SIDE);
                let found = film.measured_error().unwrap().rel_mse;
                assert!((found / expected - 1.0).abs() < 0.2, "{passes} passes: {found} for {expected}");
            }
            // Of few passes and of many: a film that is a tenth too bright.
            let known = film(2, |x, y, _| 1.1 * lattice(x, y));
            for passes in [64, 256] {
                let traced = noisy(seed + 10, passes);
                let picture = Picture::of(&known).blended(&traced);
                let found = picture.measured_error_of_film().unwrap().rel_mse;
                let expected = 0.01 * truth;
                assert!((found / expected - 1.0).abs() < 0.25, "{passes} passes: {found} for {expected}");
            }
        }
    }

    /// Whatever is shown and known, weights are numbers above zero, and at most one over the floor.
    #[test]
    fn weights_are_numbers() {
        let values = [0.0, 1e-30, 1e-6, 1.0, 3.0, 1e6, 1e30, f64::from(f32::MAX)];
        for width in [1, 2, 5, 8] {
            for shift in 0..values.len() {
                let value = |at: usize| values[(at * 5 + shift + at / 7) % values.len()];
                let image: Vec<[f64; 3]> =
                    (0..40).map(|at| [value(at), value(at + 1), value(3 * at)]).collect();
                let variance: Vec<f64> = (0..40).map(|at| value(2 * at + 1).min(1e38)).collect();
                let mean = image.iter().flatten().sum::<f64>() / 120.0;
                let known = |at: usize| [image[at], image[(at * 7) % 40]];
                for weight in weights((&image, &variance), known, width, mean).into_iter().flatten() {
                    assert!(weight > 0.0 && weight <= 1.0001 / (0.01 * mean * mean), "{weight}, {mean}");
                }
            }
        }
        // A single pixel, and a picture that has found nothing.
        let single = weights((&[[2.0; 3]], &[0.1]), |_| [[2.0; 3]; 2], 1, 2.0);
        assert!(single.len() == 1 && single[0].iter().all(|weight| (4.04 * weight - 1.0).abs() < 1e-12));
        let black = weights((&[[0.0; 3]; 9], &[0.0; 9]), |_| [[0.0; 3]; 2], 3, 1.0);
        assert!(black.into_iter().flatten().all(|weight| weight == 100.0));
    }

    /// What two agree on counts; what one of them alone says does not.
    #[test]
    fn only_what_two_agree_on_is_another_light_than_around() {
        let cases = [
            (1.0, [5.0, 3.0], 4.0),
            (1.0, [5.0, 1.9], 1.0),
            (1.0, [0.1, 0.3], 0.2),
            (1.0, [0.1, 0.6], 1.0),
            (1.0, [-0.2, 0.0], 0.0),
            (0.0, [2.0, 1.0], 1.5),
            (1.0, [1e9, 0.0], 1.0),
        ];
        for (around, known, expected) in cases {
            let found = standing([around; 3], known.map(|known| [known; 3]));
            assert!(
                found.iter().all(|found| (found - expected).abs() < 1e-12),
                "{around} {known:?}: {found:?}"
            );
        }
    }
}
