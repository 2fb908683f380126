//! Taking noise off a film of looked-up light: each pixel's light is joined with that of pixels around that show the same
//! surface and differ by no more than their noise. Of mirrors and clear glass it is the surface that is seen in them or through them.
//!
//! An à-trous filter [Dammertz2010], guided by the variance of the samples [Schied2017]: levels of 3 × 3 pixels, twice as far
//! apart from level to level. What is filtered is light over albedo, so that textures stay; light of emitters that is seen straight or in
//! mirrors is left alone, but not their images in glass and glosses. Two pixels count as one by normal, depth beyond the slope of the
//! surface, albedo, and by how far their light differs, in standard deviations of what is left of the noise at that level, of the
//! better known of them.
//! **Biased**: it blurs light that changes by less than its noise. Consistent: with the samples the deviations fall, and what
//! differs is left apart. The error that is measured of a picture ([`super::measure_at`]) has that bias in it.
//!
//! Of the first passes little is known but how light differs around, which is also how reflections differ: those are soft at
//! first. Every pixel is computed by itself in one order: the same bytes on any number of threads. Twice the
//! light is twice the picture.

mod kernel;
mod planes;
#[cfg(test)]
mod tests;

use std::sync::{Arc, OnceLock};

use glam::Vec3;
use rayon::prelude::*;

pub(crate) use self::kernel::SURFACE_PLANES;
use self::kernel::{DEPTH, Joined, KnownBetter, PerDifference, WITHOUT_BOUND};
pub(crate) use self::planes::Planes;
#[cfg(feature = "gpu")]
pub(crate) use self::{
    kernel::{DEPTH as DEPTH_APART, NUMBERS, PLANES},
    planes::{MARGIN, stride_of},
};
use super::{
    Beyond, Film, Tile,
    pixel::{Held, Pixel},
};
use crate::{math::Rgb, transport::PathClass};

/// Levels: the last joins pixels that are 8 apart.
pub(crate) const LEVELS: usize = 4;
/// Pixels that a thread takes at least.
pub(super) const PIXELS_TOGETHER: usize = 1024;
/// Samples below which their own variance is not believed: it is at least how light differs around.
const BELIEVED: u32 = 4;
/// Added to albedos that light is divided by: black surfaces show none.
pub(crate) const ALBEDO_LEAST: f32 = 0.01;
/// Largest number that tells surfaces apart, far beyond any albedo or depth in metres: sums of single samples that are sound may leave the
/// range of floats, and what is compared or multiplied must not be infinite.
pub(crate) const SURFACE_MAX: f32 = 1e30;
/// Share of a pixel's variance that stays beside what its weights say: they are told by the noise itself, and a pixel that is far off by
/// chance keeps to itself. On an evenly lit sheet 8 to 9 % are left, of 4 to 64 samples, where fixed weights would leave 1; of 2, whose
/// variance is taken for more, 5 to 6 %.
const KEPT: f64 = 0.074;

/// What the filter makes of a film.
#[derive(Clone, Debug)]
pub(super) struct Denoised {
    /// What it adds to each pixel, W/(m² sr).
    pub(super) change: Vec<Rgb>,
    /// Variance of each pixel's luminance that is left, (W/(m² sr))²; zero after a single pass.
    pub(super) variance: Vec<f32>,
    /// Share of the noise, as relMSE, that is left.
    pub(super) noise_left: f64,
}

/// What taking noise off a film brings, found once somebody asks. It is of the film as it is: whoever changes that begins another.
#[derive(Clone, Debug, Default)]
pub struct Denoising(Arc<OnceLock<Denoised>>);

impl Denoising {
    /// Memory of a pixel while it is found, and of what is kept of it. Of a layer, light is held as it was, at one level and at the next, with
    /// what its differences count.
    pub const BYTES_PER_PIXEL: usize = size_of::<Seen>()
        + size_of::<f32>() * (SURFACE_PLANES + 3 * WITH_CARRIED + 1)
        + 2 * size_of::<(Rgb, f32)>();

    pub(super) fn of(&self, film: &Film) -> &Denoised {
        self.0.get_or_init(|| Denoised::of(film))
    }

    /// What something else than this machine's CPU finds of a film.
    ///
    /// - `join`: what [`Unjoined::joined`] does
    #[cfg(feature = "gpu")]
    pub(crate) fn found<E>(
        film: &Film,
        join: impl FnOnce(&Unjoined<'_>) -> Result<Planes, E>,
    ) -> Result<Denoising, E> {
        let filter = Filter::of(film, None);
        let light = filter.light();
        let joined = join(&filter.unjoined(&light))?;
        Ok(Denoising(Arc::new(OnceLock::from(filter.denoised(&light, &joined)))))
    }
}

/// Pixels before they are joined with those around.
pub(crate) struct Unjoined<'a> {
    /// What tells surfaces apart.
    pub(crate) surfaces: &'a Planes,
    /// Light over albedo by channel, as bright as one at most, or a hundred where it is black; last the variance of its luminance.
    pub(crate) light: &'a Planes,
    /// Its own variance is believed.
    pub(crate) is_believed: bool,
    /// Levels that pixels are joined at: at each those twice as far apart.
    pub(crate) levels: usize,
}

impl Unjoined<'_> {
    /// What is left when every pixel is joined with those around that are its like: light, and the variance of its luminance.
    pub(crate) fn joined<const PLANES: usize>(&self) -> Planes {
        let Unjoined { surfaces, light, is_believed, levels } = *self;
        let mut light: Planes = light.made::<PLANES>(&KnownBetter { surfaces, light, is_believed });
        // In turns, since fresh memory costs more than what is written to it.
        let (mut next, mut per_difference) = (None, None);
        for level in 0..levels {
            let weighed = light.made_in(per_difference.take(), &PerDifference { light: &light });
            let joined = Joined { surfaces, light: &light, per_difference: &weighed, step: 1 << level };
            let made = light.made_in::<PLANES>(next.take(), &joined);
            next = Some(std::mem::replace(&mut light, made));
            per_difference = Some(weighed);
        }
        light
    }
}

impl Denoised {
    /// Of all light of a film.
    fn of(film: &Film) -> Denoised {
        Filter::of(film, None).run()
    }

    /// What it adds to one class of a film's light: all classes together have what all light has.
    pub(super) fn change_of(film: &Film, class: PathClass) -> Vec<Rgb> {
        Filter::of(film, Some(class)).run().change
    }
}

/// What planes of surfaces hold beside the picture: no normal is as long.
const NO_SURFACE: f32 = 1e10;

/// Colours of light, and planes of it with its variance, alone and with carried light.
const CHANNELS: usize = 3;
pub(crate) const ALONE: usize = CHANNELS + 1;
const WITH_CARRIED: usize = 2 * CHANNELS + 1;

/// What is seen in a pixel.
#[derive(Clone, Copy)]
struct Seen {
    /// Of the classes that are filtered, W/(m² sr).
    light: Rgb,
    /// Of the class whose change is told.
    carried: Rgb,
    /// Luminance of all classes, filtered or not, W/(m² sr).
    shown: f32,
    /// Of the mean luminance, (W/(m² sr))².
    variance: f64,
    /// Emitters are seen straight or in mirrors, if only in a part of the pixel.
    is_shining: bool,
    /// Of the first surface, or of what is seen beyond a mirror or glass.
    albedo: Rgb,
    normal: Vec3,
    /// Of the first surface.
    depth_m: f32,
}

impl Seen {
    const NOTHING: Seen = Seen {
        light: Rgb::BLACK,
        carried: Rgb::BLACK,
        shown: 0.0,
        variance: 0.0,
        is_shining: false,
        albedo: Rgb::BLACK,
        normal: Vec3::ZERO,
        depth_m: 0.0,
    };

    /// - `has_caustics`: the film shows some, which may spread by far more than themselves
    fn of(tile: &Tile, pixel_index: usize, class: Option<PathClass>, has_caustics: bool) -> Seen {
        let (pixel, held): (&Pixel, Held) = (&tile.pixels[pixel_index], tile.held());
        let sum = |classes: &[PathClass]| -> Rgb {
            let mut sum = [0.0; 3];
            for class in classes {
                sum.iter_mut().zip(pixel.class_mean(*class, held)).for_each(|(sum, value)| *sum += value);
            }
            sum.map(|value| value as f32).into()
        };
        // What is sampled of emitters is not filtered, and its noise is not told from that of the rest: none of it counts as taken off.
        let is_shining = pixel.is_shining() && !sum(&PathClass::SEEN).is_black();
        let filtered = |class: PathClass| !is_shining || class.meets_diffuse();
        let light: Vec<PathClass> = PathClass::ALL.into_iter().filter(|class| filtered(*class)).collect();
        // Light that was replaced has fewer samples than the rest. How much of the noise is its own nobody has noted: half at most, and
        // what is looked up hardly spreads by more than itself. What shadows' edges spread by is not its own: holes of leaves in
        // sunlight on the ground blurred, 5.5 % for 3.6 after 4 s.
        let [passes, fewest] = [held.spread(), held.fewest()].map(|count| f64::from(count.max(1)));
        let spread = pixel.variance_of_mean(held) * passes;
        let looked_up = f64::from(sum(&[PathClass::Indirect]).luminance());
        // Of a single sample, which may have found nothing, that is not known.
        let is_known = !has_caustics && held.fewest() >= 2;
        let own = (0.5 * spread).min(if is_known { looked_up.powi(2) } else { f64::INFINITY });
        let surface = tile.beyond(pixel_index).unwrap_or_else(|| Beyond {
            albedo: pixel.albedo_sum / held.passes as f32,
            normal: pixel.normal_sum.normalize_or_zero(),
        });
        Seen {
            light: sum(&light),
            carried: class.filter(|class| filtered(*class)).map_or(Rgb::BLACK, |class| sum(&[class])),
            shown: sum(&PathClass::ALL).luminance(),
            variance: (spread - own) / passes + own / fewest,
            is_shining,
            albedo: surface.albedo.map(|channel| channel.min(SURFACE_MAX)),
            normal: surface.normal,
            depth_m: pixel.depth_mean_m().min(SURFACE_MAX),
        }
    }

    /// What light is divided by.
    fn divisor(&self) -> Rgb {
        self.albedo.map(|channel| channel + ALBEDO_LEAST)
    }

    fn divisor_squared(&self) -> f64 {
        f64::from(self.divisor().luminance()).powi(2)
    }
}

/// The filter of one film.
struct Filter {
    width: usize,
    seen: Vec<Seen>,
    surfaces: Planes,
    /// A power of two that brings light near one: products neither overflow nor vanish, and nothing is rounded.
    scale: f64,
    /// That tell how much samples spread.
    passes: u32,
    carries: bool,
}

impl Filter {
    /// - `class`: whose light is carried along by the weights that all light has, and whose change is told
    fn of(film: &Film, class: Option<PathClass>) -> Filter {
        let has_caustics = film.has_any(|pixel, held| {
            pixel.class_mean(PathClass::Caustic, held).iter().any(|light| *light != 0.0)
        });
        let seen =
            film.image_by_tiles(Seen::NOTHING, |tile, index| Seen::of(tile, index, class, has_caustics));
        let lights = seen.par_iter().with_min_len(PIXELS_TOGETHER).map(|seen| seen.light.max_component());
        let brightest = lights.reduce(|| 0.0, f32::max);
        let scale = (-f64::from(brightest.max(f32::MIN_POSITIVE)).log2().ceil()).exp2();
        let width = film.size().width() as usize;
        let surfaces = surfaces(&seen, width);
        Filter { width, seen, surfaces, scale, passes: film.spread_passes_min(), carries: class.is_some() }
    }

    fn run(&self) -> Denoised {
        if self.carries {
            let before = self.light_and_carried();
            self.denoised(&before, &self.unjoined(&before).joined::<WITH_CARRIED>())
        } else {
            let before = self.light();
            self.denoised(&before, &self.unjoined(&before).joined::<ALONE>())
        }
    }

    fn unjoined<'a>(&'a self, light: &'a Planes) -> Unjoined<'a> {
        Unjoined {
            surfaces: &self.surfaces,
            light,
            is_believed: self.passes >= BELIEVED,
            levels: if self.passes > 0 { LEVELS } else { 0 },
        }
    }

    /// What joining light brings.
    fn denoised(&self, before: &Planes, after: &Planes) -> Denoised {
        let told = if self.carries { CHANNELS } else { 0 };
        let change = self.seen.par_iter().enumerate().with_min_len(PIXELS_TOGETHER).map(|(index, seen)| {
            let (after, before, divisor) = (after.place(index), before.place(index), seen.divisor());
            let channel = |c: usize| {
                let change = after.at(told + c) - before.at(told + c);
                (f64::from(change) * f64::from(divisor[c]) / self.scale) as f32
            };
            Rgb::new(channel(0), channel(1), channel(2))
        });
        let change = change.collect();
        let (variance, noise_left) = self.noise_left(after);
        Denoised { change, variance, noise_left }
    }

    /// Light over albedo by channel, and last the variance of its luminance.
    fn light(&self) -> Planes {
        Planes::of(self.width, &self.seen, 0.0, |_, seen| {
            let [r, g, b] = self.scaled(seen.light, seen);
            [r, g, b, self.scaled_variance(seen)]
        })
    }

    /// The same, with the light that is carried along before the variance.
    fn light_and_carried(&self) -> Planes {
        Planes::of(self.width, &self.seen, 0.0, |_, seen| {
            let ([r, g, b], [cr, cg, cb]) = (self.scaled(seen.light, seen), self.scaled(seen.carried, seen));
            [r, g, b, cr, cg, cb, self.scaled_variance(seen)]
        })
    }

    fn scaled(&self, light: Rgb, seen: &Seen) -> [f32; CHANNELS] {
        std::array::from_fn(|c| (f64::from(light[c]) * self.scale) as f32 / seen.divisor()[c])
    }

    fn scaled_variance(&self, seen: &Seen) -> f32 {
        (seen.variance * self.scale.powi(2) / seen.divisor_squared()) as f32
    }

    /// Variance of each pixel that is left, and the share of all of it relative to what is shown.
    fn noise_left(&self, light: &Planes) -> (Vec<f32>, f64) {
        if self.passes < 2 {
            return (vec![0.0; self.seen.len()], 1.0);
        }
        let squared = self.scale.powi(2);
        let shown = |seen: &Seen| f64::from(seen.shown) * self.scale;
        let lights: Vec<f64> = sums_of(&self.seen, |seen| [shown(seen)]).into_iter().flatten().collect();
        let mean = lights.iter().sum::<f64>() / self.seen.len() as f64;
        let floor = (0.01 * mean * mean).max(f64::MIN_POSITIVE);
        let last = light.count() - 1;
        let known = self.seen.par_iter().enumerate().with_min_len(PIXELS_TOGETHER).map(|(index, seen)| {
            let before = seen.variance * squared;
            // No pixel is known less for having noisier neighbours.
            let left = (f64::from(light.place(index).at(last)) * seen.divisor_squared()).min(before);
            let left = if seen.is_shining { before } else { left + KEPT * (before - left) };
            let weight = 1.0 / (shown(seen).powi(2) + floor);
            ([before * weight, left * weight], (left / squared).min(f64::from(f32::MAX)) as f32)
        });
        let (relative, variance): (Vec<[f64; 2]>, Vec<f32>) = known.unzip();
        let sums = sums_of(&relative, |of_pixel| *of_pixel);
        let [all, rest] = sums.into_iter().fold([0.0; 2], |[all, rest], [a, b]| [all + a, rest + b]);
        (variance, if all > 0.0 && all.is_finite() { rest / all } else { 1.0 })
    }
}

/// Sums of what each of some pixels has, [`PIXELS_TOGETHER`] at a time: in one order, whatever the threads.
fn sums_of<T: Sync, const COUNT: usize>(
    pixels: &[T],
    of: impl Fn(&T) -> [f64; COUNT] + Sync,
) -> Vec<[f64; COUNT]> {
    let sum = |pixels: &[T]| {
        let mut sums = [0.0; COUNT];
        for pixel in pixels {
            sums.iter_mut().zip(of(pixel)).for_each(|(sum, more)| *sum += more);
        }
        sums
    };
    pixels.par_chunks(PIXELS_TOGETHER).map(sum).collect()
}

/// What tells the surfaces of pixels apart.
fn surfaces(seen: &[Seen], width: usize) -> Planes {
    let rows = seen.len() / width;
    // At edges the slope is that of the side which goes on.
    let slope = |index: usize, place: usize, count: usize, step: usize| {
        let to = |other: usize| (seen[other].depth_m - seen[index].depth_m).abs();
        let before = if place > 0 { to(index - step) } else { f32::INFINITY };
        let after = if place + 1 < count { to(index + step) } else { f32::INFINITY };
        let least = before.min(after);
        if least.is_finite() { least } else { 0.0 }
    };
    Planes::of::<_, SURFACE_PLANES>(width, seen, NO_SURFACE, |index, Seen { albedo, normal, depth_m, .. }| {
        // What is not hit has no depth.
        let per_depth = (1.0 / (DEPTH * depth_m)).min(WITHOUT_BOUND);
        let slope_across = slope(index, index % width, width, 1);
        let slope_down = slope(index, index / width, rows, width);
        let ([x, y, z], [r, g, b]) = (normal.to_array(), albedo.to_array());
        [x, y, z, r, g, b, *depth_m, per_depth, slope_across, slope_down]
    })
}
