//! What is shown: a film, or the blend of two films of one view.
//!
//! A film drawn with looked-up light has little noise and an error that stays; one that is path-traced has noise that falls
//! for ever. With e² the squared error of the first and v the variance of the second, independent of it, the blend with the
//! weight w = e² / (e² + v) on the second has the least squared error there is, below that of either. Neither is known, but
//! the squared difference of the two has the expectation e² + v, and the second film's halves measure v: so
//! w = 1 − v̂ / (difference)², at least 0, from sums over some hundred pixels (the positive-part estimator of
//! [JamesStein1961]), less what chance may have added. While path tracing is noisy it hardly counts; as it converges it takes
//! over without a step that an eye could see.

use rayon::prelude::*;

use super::{
    Film, MeasuredError, PictureSize, TILE_SIDE,
    denoise::{Denoised, Denoising, PIXELS_TOGETHER},
    measured::{Beside, neighbourhood_mean, of_pixels},
    pixel::Pixel,
    standing::{self, relative, standing, weighed},
};
use crate::{math::Rgb, transport::PathClass};
use glam::Vec3;

/// Passes of a path-traced film below which it does not count.
const PASSES_COUNTED: u32 = 4;
/// Passes below which what it says of errors is not believed: paths that are rarely met are still missing from both halves.
const PASSES_BELIEVED: u32 = 16;

/// A picture to be shown or written. Every image that it returns is `[h × w]`, rows top to bottom.
#[derive(Clone, Debug)]
pub struct Picture<'a> {
    film: &'a Film,
    /// Where noise is taken off the film.
    denoising: Option<Denoising>,
    blend: Option<Blend<'a>>,
}

#[derive(Clone, Debug)]
struct Blend<'a> {
    traced: &'a Film,
    weights: Weights,
}

/// Weight of the traced film at the middle of every tile, in row order.
#[derive(Clone, Debug)]
pub(crate) struct Weights {
    pub(crate) values: Vec<f64>,
    pub(crate) columns: usize,
}

/// What a picture is mixed of, for whoever mixes it elsewhere: [`PictureParts::mixed`] is what comes out.
#[derive(Clone, Debug)]
pub struct PictureParts {
    pub(crate) size: PictureSize,
    /// The film, noise taken off, row by row.
    pub(crate) own: Vec<Rgb>,
    pub(crate) traced: Option<TracedPart>,
}

/// The path-traced film of a blend.
#[derive(Clone, Debug)]
pub(crate) struct TracedPart {
    /// Row by row.
    pub(crate) radiance: Vec<Rgb>,
    pub(crate) weights: Weights,
}

impl PictureParts {
    /// Size of the picture.
    pub fn size(&self) -> PictureSize {
        self.size
    }

    /// The picture, rows top to bottom: the film alone, or with the path-traced one at its weights.
    pub fn mixed(self) -> Vec<Rgb> {
        let mut image = self.own;
        if let Some(TracedPart { radiance: traced, weights }) = &self.traced {
            weights.for_all(self.size, &mut image, |index, weight, shown| {
                let weight = weight as f32;
                *shown = *shown * (1.0 - weight) + traced[index] * weight;
            });
        }
        image
    }
}

impl<'a> Picture<'a> {
    /// A film as it is.
    pub fn of(film: &'a Film) -> Picture<'a> {
        Picture { film, denoising: None, blend: None }
    }

    /// The same with noise taken off the film (`denoise.rs`), which makes it biased; before it is blended. Takes some 0.1 µs a pixel when
    /// it is first asked for what it shows.
    ///
    /// - `denoising`: of the film as it is
    pub fn denoised(self, denoising: &Denoising) -> Picture<'a> {
        Picture { denoising: Some(denoising.clone()), ..self }
    }

    /// The same blended with the path-traced film of the same view, whose samples must be independent of the first one's. While
    /// that has less than four passes it does not count. Takes some 0.2 µs a pixel.
    pub fn blended(self, traced: &'a Film) -> Picture<'a> {
        Picture { blend: Blend::of(&self, traced), ..self }
    }

    fn noise_taken_off(&self) -> Option<&Denoised> {
        Some(self.denoising.as_ref()?.of(self.film))
    }

    /// Share of the film's noise, as relMSE, that the picture has of it before it is blended: all, unless it is taken off.
    pub fn noise_left(&self) -> f64 {
        self.noise_taken_off().map_or(1.0, |denoised| denoised.noise_left)
    }

    /// The film without the path-traced one.
    fn own_radiance(&self) -> Vec<Rgb> {
        let mut image = self.film.radiance();
        if let Some(denoised) = self.noise_taken_off() {
            change(&mut image, &denoised.change);
        }
        image
    }

    /// The film that it shows, or shows beside the path-traced one.
    pub fn film(&self) -> &'a Film {
        self.film
    }

    /// Size of the picture.
    pub fn size(&self) -> PictureSize {
        self.film.size()
    }

    /// Weight of the path-traced film, mean over the picture; 0 without one.
    pub fn traced_share(&self) -> f64 {
        let Some(blend) = &self.blend else { return 0.0 };
        blend.weights.values.iter().sum::<f64>() / blend.weights.values.len() as f64
    }

    /// The error of the blend, bias included, measured with the samples of its path-traced film; `None` while it has few. Takes some
    /// 0.5 µs a pixel.
    pub fn measured_error(&self) -> Option<MeasuredError> {
        self.measured(|weight, own, noise| (1.0 - weight).powi(2) * own + weight.powi(2) * noise)
    }

    /// The error of the film without the path-traced one, measured with that; as [`Picture::measured_error`].
    pub fn measured_error_of_film(&self) -> Option<MeasuredError> {
        self.measured(|_, own, _| own)
    }

    /// - `of`: error of a pixel by the traced film's weight in it, the squared error of the other film and the noise of the traced one
    fn measured(&self, of: impl Fn(f64, f64, f64) -> f64 + Sync) -> Option<MeasuredError> {
        let blend = self.blend.as_ref()?;
        // What it has not met yet its noise does not know of.
        if blend.traced.passes_min() < PASSES_BELIEVED {
            return None;
        }
        let image = |image: Vec<Rgb>| -> Vec<[f64; 3]> {
            image.into_iter().map(|colour| colour.to_array().map(f64::from)).collect()
        };
        // Relative to the blend, which is nearer to the truth than either film.
        let blended = image(self.radiance());
        let mean = blended.iter().flatten().sum::<f64>() / (3 * blended.len()) as f64;
        if mean <= 0.0 {
            return None;
        }
        let variance: Vec<f64> = self.variance().into_iter().map(f64::from).collect();
        let own = image(self.own_radiance());
        let traced = blend.traced.image([0.0; 3], Pixel::total_mean);
        let both = |index: usize| [own[index], traced[index]];
        let weights = standing::weights((&blended, &variance), both, self.size().width() as usize, mean);
        let noise = blend.traced.image([0.0; 3], Pixel::squared_error_of_mean);
        let mut errors = vec![0.0; own.len()];
        blend.weights.for_all(self.size(), &mut errors, |index, weight, error| {
            let apart = std::array::from_fn(|channel| (own[index][channel] - traced[index][channel]).powi(2));
            let noise = weighed(noise[index], weights[index]);
            *error = of(weight, weighed(apart, weights[index]) - noise, noise);
        });
        Some(of_pixels(&errors, Beside::default()))
    }

    /// Radiance of all path classes together, W/(m² sr); black where no pass has run.
    pub fn radiance(&self) -> Vec<Rgb> {
        self.parts().mixed()
    }

    /// What [`Picture::radiance`] is mixed of.
    pub fn parts(&self) -> PictureParts {
        self.parts_of(self.own_radiance(), Film::radiance)
    }

    /// Radiance of one path class, W/(m² sr). The layers add up to [`Picture::radiance`].
    pub fn layer(&self, class: PathClass) -> Vec<Rgb> {
        let mut image = self.film.layer(class);
        if self.denoising.is_some() {
            change(&mut image, &Denoised::change_of(self.film, class));
        }
        self.parts_of(image, |film| film.layer(class)).mixed()
    }

    /// Mean albedo of the first hit; samples that hit nothing count as black.
    pub fn albedo(&self) -> Vec<Rgb> {
        self.film.albedo()
    }

    /// Mean direction of the first hits' normals in the world, unit length; zero where nothing was hit.
    pub fn normal(&self) -> Vec<Vec3> {
        self.film.normal()
    }

    /// Mean depth of the samples that hit, metres along the camera's axis; 0 where none did.
    pub fn depth(&self) -> Vec<f32> {
        self.film.depth()
    }

    /// Variance of each pixel's luminance, (W/(m² sr))²; see [`Film::variance`]. Where noise was taken off, what is left of it.
    pub fn variance(&self) -> Vec<f32> {
        let mut image = match self.noise_taken_off() {
            Some(denoised) => denoised.variance.clone(),
            None => self.film.variance(),
        };
        if let Some(blend) = &self.blend {
            let traced = blend.traced.variance();
            blend.weights.for_all(self.size(), &mut image, |index, weight, shown| {
                let weight = weight as f32;
                *shown = (1.0 - weight).powi(2) * *shown + weight.powi(2) * traced[index];
            });
        }
        image
    }

    fn parts_of(&self, own: Vec<Rgb>, image_of: impl Fn(&Film) -> Vec<Rgb>) -> PictureParts {
        let part_of =
            |blend: &Blend| TracedPart { radiance: image_of(blend.traced), weights: blend.weights.clone() };
        PictureParts { size: self.size(), own, traced: self.blend.as_ref().map(part_of) }
    }
}

/// Adds to every pixel; what rounding leaves below zero is black.
fn change(image: &mut [Rgb], by: &[Rgb]) {
    image.par_iter_mut().zip(by).with_min_len(PIXELS_TOGETHER).for_each(|(shown, change)| {
        *shown = (*shown + *change).map(|channel| channel.max(0.0));
    });
}

impl<'a> Blend<'a> {
    /// `None` where nothing can be said: too few passes of `traced`, or all black.
    fn of(picture: &Picture<'_>, traced: &'a Film) -> Option<Blend<'a>> {
        let (film, size) = (picture.film, picture.size());
        if traced.passes_min() < PASSES_COUNTED || traced.size() != size {
            return None;
        }
        let shown: Vec<[f64; 3]> = match picture.denoising {
            Some(_) => picture.own_radiance().iter().map(|colour| colour.to_array().map(f64::from)).collect(),
            None => film.image([0.0; 3], Pixel::total_mean),
        };
        let other = traced.image([0.0; 3], Pixel::total_mean);
        let noise = traced.image([0.0; 3], Pixel::squared_error_of_mean);
        let mean_of = |image: &[[f64; 3]]| image.iter().flatten().sum::<f64>() / (3 * image.len()) as f64;
        let mean = mean_of(&shown).max(mean_of(&other));
        if mean <= 0.0 {
            return None;
        }
        let around = neighbourhood_mean(&shown, size.width() as usize);
        // Squared difference of the two, and the noise of the second, for every pixel.
        let (differences, noises): (Vec<f64>, Vec<f64>) = (0..shown.len())
            .into_par_iter()
            .map(|index| {
                let (a, b) = (shown[index], other[index]);
                let squared = std::array::from_fn(|channel| (a[channel] - b[channel]).powi(2));
                let around = standing(around[index], [a, b]);
                (relative(squared, around, mean), relative(noise[index], around, mean))
            })
            .unzip();
        let columns = size.width().div_ceil(TILE_SIDE) as usize;
        let sums: Vec<Sums> = film
            .tiles()
            .iter()
            .map(|tile| {
                let (origin, extent) = (tile.origin(), tile.size());
                let rows = origin.y..origin.y + extent.y;
                let places = rows.flat_map(|y| (0..extent.x).map(move |x| (y, origin.x + x)));
                places.fold(Sums::default(), |sums, (y, x)| {
                    let index = (y * size.width() + x) as usize;
                    sums.with(Sums::of(differences[index], noises[index]))
                })
            })
            .collect();
        Some(Blend { traced, weights: Weights::of(&sums, columns) })
    }
}

/// Sums over some pixels.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Of the squared difference of the two films.
    difference: f64,
    /// Of what is left of it without the noise of the traced one: the squared error of the other, in the mean; and of its
    /// square.
    own: f64,
    own_squared: f64,
    count: f64,
}

impl Sums {
    fn of(difference: f64, noise: f64) -> Sums {
        let own = difference - noise;
        Sums { difference, own, own_squared: own * own, count: 1.0 }
    }

    fn with(self, o: Sums) -> Sums {
        Sums {
            difference: self.difference + o.difference,
            own: self.own + o.own,
            own_squared: self.own_squared + o.own_squared,
            count: self.count + o.count,
        }
    }

    /// Weight of the traced film. A standard error of the other's squared error is taken off: too little weight costs nothing worth
    /// speaking of where too much would show noise. Off what is held against the noise, not off its share alone: of a film that is off
    /// by far more than the noise of the traced one, and known by few pixels, a third would stay in the picture.
    fn weight(self) -> f64 {
        let variance = (self.own_squared - self.own * self.own / self.count).max(0.0);
        let own = (self.own - variance.sqrt()).max(0.0);
        let noise = (self.difference - self.own).max(0.0);
        // Where both films say the same it makes no difference.
        if own > 0.0 { own / (own + noise) } else { 0.0 }
    }
}

impl Weights {
    /// From the sums of squared differences and of noise over each tile and its neighbours.
    fn of(sums: &[Sums], columns: usize) -> Weights {
        let rows = sums.len() / columns;
        let span = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let values = (0..sums.len())
            .map(|index| {
                let (column, row) = (index % columns, index / columns);
                let near =
                    span(row, rows).flat_map(|row| span(column, columns).map(move |x| row * columns + x));
                near.fold(Sums::default(), |all, at| all.with(sums[at])).weight()
            })
            .collect();
        Weights { values, columns }
    }

    /// Does something with every pixel of an image, told its place and the weight of the traced film there, which goes over
    /// from tile to tile without a step.
    fn for_all<T: Send>(&self, size: PictureSize, image: &mut [T], act: impl Fn(usize, f64, &mut T) + Sync) {
        let width = size.width() as usize;
        let rows = self.values.len() / self.columns;
        image.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let (top, bottom, down) = between(y, rows);
            for (x, value) in row.iter_mut().enumerate() {
                let (left, right, across) = between(x, self.columns);
                let at = |row: usize| {
                    let weight = |column: usize| self.values[row * self.columns + column];
                    weight(left) * (1.0 - across) + weight(right) * across
                };
                act(y * width + x, at(top) * (1.0 - down) + at(bottom) * down, value);
            }
        });
    }
}

/// The two tiles in whose middles' midst a pixel lies, along one axis, and how far it is from the first to the second, in
/// [0, 1].
fn between(pixel: usize, count: usize) -> (usize, usize, f64) {
    let at = ((pixel as f64 + 0.5) / f64::from(TILE_SIDE) - 0.5).clamp(0.0, (count - 1) as f64);
    let first = at as usize;
    (first, (first + 1).min(count - 1), at.fract())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        film::{GAUGED_GROUPS, GaugedPixel, PixelSample, measure_at},
        math::{RunningStatistics, sobol::PixelSampler},
    };

    /// Samples 1 ± 1, evenly, in two classes; by (seed, pixel, pass).
    fn noisy(seed: u64, passes: u32) -> Film {
        film_of(passes, |x, y, pass| {
            let [u, ..] = PixelSampler::new(seed, pass, y * 64 + x, 0).four(0);
            2.0 * u
        })
    }

    fn film_of(passes: u32, value: impl Fn(u32, u32, u32) -> f32) -> Film {
        let mut film = Film::new(PictureSize::new(64, 48).unwrap());
        for pass in 0..passes {
            film.tiles_mut().iter_mut().for_each(|tile| {
                tile.add_pass(|x, y| {
                    let mut sample = PixelSample::BLACK;
                    sample.radiance[PathClass::Direct as usize] = Rgb::splat(0.25 * value(x, y, pass));
                    sample.radiance[PathClass::Indirect as usize] = Rgb::splat(0.75 * value(x, y, pass));
                    sample
                });
            });
        }
        film
    }

    fn squared_error(image: &[Rgb]) -> f64 {
        image.iter().map(|colour| f64::from(colour.g - 1.0).powi(2)).sum::<f64>() / image.len() as f64
    }

    /// The blend's squared error is as small as that of the best weight, 1 / (1/e² + 1/v), and what is measured of it and of
    /// the film alone is right, wherever the errors of the two lie to each other.
    #[test]
    fn the_blend_is_better_than_either_and_knows_how_good_it_is() {
        for bias in [0.0, 0.03, 0.1, 0.3] {
            let mut figures = [RunningStatistics::default(); 3];
            let film = film_of(1, |_, _, _| 1.0 + bias);
            for seed in 0..40 {
                let traced = noisy(seed, 33);
                let picture = Picture::of(&film).blended(&traced);
                figures[0].add(squared_error(&picture.radiance()));
                figures[1].add(picture.measured_error().unwrap().rel_mse);
                figures[2].add(picture.measured_error_of_film().unwrap().rel_mse);
            }
            let (own, noise) = (f64::from(bias).powi(2), 1.0 / 3.0 / 33.0);
            let best = own * noise / (own + noise);
            let [blend, measured, measured_film] = figures.map(|figure| figure.mean());
            // Weights are found from a thousand pixels: a few percent of the noise are lost.
            assert!(blend < 1.05 * best + 0.02 * noise, "bias {bias}: {blend} for {best}");
            // The weights of the measure hold 1 + 0.01 and what is left of the film's bias.
            let left = f64::from(bias) * noise / (own + noise);
            let scale = (1.0 + left).powi(2) * 1.01;
            assert!(
                (measured * scale - blend).abs() < 0.05 * blend + 0.03 * noise,
                "{bias}: {measured} {blend}"
            );
            let expected = own / scale;
            assert!((measured_film - expected).abs() < 0.05 * expected + 0.05 * noise, "{measured_film}");
        }
    }

    /// A film that is right but for few pixels, which are far off, is hardly to be seen beside a traced one that knows better: however badly
    /// the few tell how far off the film is in the mean.
    #[test]
    fn what_is_far_off_is_not_shown() {
        let wrong = |x, y| u32::is_multiple_of(x * 7 + y * 13, 29);
        let film = film_of(4, |x, y, _| if wrong(x, y) { 12.0 } else { 1.0 });
        let own = squared_error(&film.radiance());
        let mut blends = RunningStatistics::default();
        for seed in 0..10 {
            blends.add(squared_error(&Picture::of(&film).blended(&noisy(seed, 40)).radiance()));
        }
        let noise = 1.0 / 3.0 / 40.0;
        assert!(own > 400.0 * noise);
        assert!(blends.mean() < 1.1 * noise, "{:e} for {noise:e}", blends.mean());
    }

    /// Where nothing is known of the traced film's noise, it does not count; a single enormous sample does not show; and
    /// layers add up to the whole.
    #[test]
    fn noise_does_not_show_before_it_is_known() {
        let film = film_of(4, |x, _, _| 1.0 + 0.1 * (x % 3) as f32);
        let single = noisy(1, PASSES_COUNTED - 1);
        assert_eq!(Picture::of(&film).blended(&single).radiance(), film.radiance());
        let struck = |x, y, pass| if (x, y, pass) == (20, 20, 5) { 1e6 } else { 1.0 };
        let firefly = film_of(16, struck);
        let picture = Picture::of(&film).blended(&firefly);
        let at = 20 * 64 + 20;
        assert!((picture.radiance()[at].g / film.radiance()[at].g - 1.0).abs() < 0.05);
        let traced = noisy(2, 50);
        let picture = Picture::of(&film).blended(&traced);
        assert!(picture.traced_share() > 0.05 && picture.traced_share() < 1.0);
        let mut sum = vec![Rgb::BLACK; film.size().pixel_count()];
        for class in PathClass::ALL {
            sum.iter_mut().zip(picture.layer(class)).for_each(|(sum, layer)| *sum += layer);
        }
        for (sum, whole) in sum.iter().zip(picture.radiance()) {
            assert!((sum.g - whole.g).abs() < 1e-5);
        }
        let black = film_of(2, |_, _, _| 0.0);
        assert!(Picture::of(&black).blended(&black).radiance().iter().all(|colour| colour.is_black()));
    }

    /// What two independent estimates of some pixels say of a picture is its squared error in the mean, noise and bias, though
    /// each estimate is far noisier than the picture; weights count.
    #[test]
    fn gauged_pixels_measure_bias_and_noise() {
        let size = PictureSize::new(64, 48).unwrap();
        let mut measured = RunningStatistics::default();
        let image = vec![Rgb::splat(1.1); size.pixel_count()];
        let estimate = |seed: u64, pixel: u32| {
            PixelSampler::new(seed, 0, pixel, 7).four(0).map(|u| [f64::from(2.0 * u); 3])
        };
        let mut held = 0;
        for round in 0..200u64 {
            // Fewer let every pixel's noise into its own weight, which lifts the mean: groups of what weighs (`weights.rs`) have
            // a sixty-fourth of them, at least eight, and of eight it reads a sixth too much.
            let pixels: Vec<GaugedPixel> = (0..1024)
                .map(|pixel| GaugedPixel {
                    // Of the mean of eight numbers from 0 to 2.
                    variance: [1.0 / 24.0; 3],
                    index: 3 * pixel as usize,
                    weight: if pixel % 2 == 0 { 0.5 } else { 1.5 },
                    times: 1.0,
                    groups: groups([2 * round, 2 * round + 1].map(|seed| estimate(seed, pixel))),
                    halves: false,
                })
                .collect();
            let error = measure_at(&image, size, &pixels, 0.0).unwrap();
            let [low, high] = error.interval_95;
            held += u32::from(low <= TRUTH && TRUTH <= high);
            assert!(error.rel_mse >= 0.0 && error.trimmed.is_none());
            measured.add(error.rel_mse);
        }
        // 0.1² over the square of the truth, one, and 1 % of it.
        const TRUTH: f64 = 0.01 / 1.01;
        assert!((measured.mean() - TRUTH).abs() < 4.0 * measured.standard_error() + 0.03 * TRUTH);
        // 95 % of 200, less three deviations of a binomial.
        assert!(held >= 180, "{held}");
        assert!(measure_at(&image, size, &[], 0.0).is_none());
    }

    fn groups(halves: [[[f64; 3]; 4]; 2]) -> [[f64; 3]; GAUGED_GROUPS] {
        std::array::from_fn(|group| halves[group / 4][group % 4])
    }

    /// A picture of which a half is drawn twenty times too bright is measured by how dark that half is, not by how bright it is
    /// drawn.
    #[test]
    fn what_is_drawn_far_too_bright_is_weighed_by_the_truth() {
        let size = PictureSize::new(64, 48).unwrap();
        let image = vec![Rgb::splat(1.0); size.pixel_count()];
        let truth = |index: usize| if index % 64 < 32 { 1.0 } else { 0.05 };
        let mut measured = RunningStatistics::default();
        for round in 0..100u64 {
            let of = |index: usize| {
                let half = |seed: u64| {
                    let numbers = PixelSampler::new(seed, 0, index as u32, 7).four(0);
                    numbers.map(|u| [truth(index) * f64::from(0.8 + 0.4 * u); 3])
                };
                let variance = [truth(index).powi(2) * 0.04 / 24.0; 3];
                let groups = groups([half(2 * round), half(2 * round + 1)]);
                GaugedPixel { index, weight: 1.0, times: 1.0, groups, halves: false, variance }
            };
            let pixels: Vec<GaugedPixel> = (0..256).map(|at| of((at * 12) % size.pixel_count())).collect();
            measured.add(measure_at(&image, size, &pixels, 0.0).unwrap().rel_mse);
        }
        let mean = 0.5 * (1.0 + 0.05);
        let expected = 0.5 * 0.95f64.powi(2) / (0.05f64.powi(2) + 0.01 * mean * mean);
        assert!((measured.mean() / expected - 1.0).abs() < 0.1, "{} for {expected}", measured.mean());
    }
}
