//! Taking noise off a film of looked-up light: each pixel's light is joined with that of pixels around that show the same
//! surface and differ by no more than their noise.
//!
//! An à-trous filter [Dammertz2010], guided by the variance of the samples [Schied2017]: levels of 3 × 3 pixels, twice as far
//! apart from level to level. What is filtered is light over albedo, so that textures stay; light seen straight from emitters is left
//! alone. Two pixels count as one by normal, depth beyond the slope of the surface, albedo, and by how far their light differs, in
//! standard deviations of what is left of the noise at that level. **Biased**: it blurs light that changes by less than its
//! noise. Consistent: with the samples the deviations fall, and what differs is left apart. The error that is measured of a
//! picture ([`super::measure_at`]) has that bias in it.
//!
//! Of a film of one pass nothing is known but how light differs around; there it reaches less far, since that is also how
//! reflections differ. Every pixel is computed by itself in one order: the same bytes on any number of threads. Twice the
//! light is twice the picture.

#[cfg(test)]
mod tests;

use std::{
    ops::Range,
    sync::{Arc, OnceLock},
};

use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    Film,
    pixel::{Held, Pixel},
};
use crate::{math::Rgb, transport::PathClass};

/// Levels: the last joins pixels that are 8 apart.
const LEVELS: usize = 4;
/// … of a film of one pass.
const LEVELS_OF_ONE_PASS: usize = 2;
/// Standard deviations at which light differs by as much as surfaces do below.
const DEVIATIONS: f32 = 2.0;
/// Differences of unit normals, of depths as a share, and of albedos, at which surfaces count as others: weights are e times less.
const NORMAL: f32 = 0.2;
const DEPTH: f32 = 0.02;
const ALBEDO: f32 = 0.1;
/// How many times as far off as its slope says a depth may be.
const SLOPE: f32 = 1.5;
/// Added to albedos that light is divided by: black surfaces show none.
const ALBEDO_LEAST: f32 = 0.01;
/// Stands for one over nothing: whatever is compared by it differs beyond all bounds or not at all.
const WITHOUT_BOUND: f32 = 1e30;
/// Luminance of the size of a difference in each channel [Rec.709]: two colours of one luminance differ as well.
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Share of a pixel's variance that stays beside what its weights say: they are told by the noise itself, and a pixel that is far off by
/// chance keeps to itself. On an evenly lit sheet 9 to 11 % are left, of 2 to 64 samples, where fixed weights would leave 1 or 2.
const KEPT: f64 = 0.08;

/// Light that is filtered: all but what emitters send straight to the camera.
const FILTERED: [PathClass; 3] = [PathClass::Direct, PathClass::Caustic, PathClass::Indirect];

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
    /// Memory of a pixel while it is found, and of what is kept of it.
    pub const BYTES_PER_PIXEL: usize =
        size_of::<Seen>() + 4 * (SURFACE_PLANES + 3 * 4) + size_of::<(Rgb, f32)>();

    pub(super) fn of(&self, film: &Film) -> &Denoised {
        self.0.get_or_init(|| Denoised::of(film))
    }
}

impl Denoised {
    /// Of all light of a film.
    fn of(film: &Film) -> Denoised {
        Filter::of(film, None).run()
    }

    /// What it adds to one class of a film's light: all classes together have what all light has.
    pub(super) fn change_of(film: &Film, class: PathClass) -> Vec<Rgb> {
        if FILTERED.contains(&class) {
            Filter::of(film, Some(class)).run().change
        } else {
            vec![Rgb::BLACK; film.size().pixel_count()]
        }
    }
}

/// Numbers of every pixel: rows top to bottom, in each one plane after the other, in each of them the pixels of the row.
#[derive(Clone)]
struct Planes {
    width: usize,
    count: usize,
    numbers: Vec<f32>,
}

impl Planes {
    fn of<const COUNT: usize>(
        width: usize,
        seen: &[Seen],
        at: impl Fn(usize, &Seen) -> [f32; COUNT] + Sync,
    ) -> Planes {
        let mut numbers = vec![0.0; seen.len() * COUNT];
        numbers.par_chunks_mut(COUNT * width).enumerate().for_each(|(row, numbers)| {
            for (column, seen) in seen[row * width..][..width].iter().enumerate() {
                for (plane, number) in at(row * width + column, seen).into_iter().enumerate() {
                    numbers[plane * width + column] = number;
                }
            }
        });
        Planes { width, count: COUNT, numbers }
    }

    /// The part of a row in one plane.
    #[inline(always)]
    fn row(&self, y: usize, plane: usize) -> &[f32] {
        &self.numbers[(y * self.count + plane) * self.width..][..self.width]
    }

    fn at(&self, index: usize, plane: usize) -> f32 {
        self.row(index / self.width, plane)[index % self.width]
    }

    fn rows(&self) -> usize {
        self.numbers.len() / (self.count * self.width)
    }

    /// Others of as many numbers each, row by row in parallel.
    ///
    /// - `fill`: told a row and its numbers, all zero
    fn made(&self, count: usize, fill: impl Fn(usize, &mut [f32]) + Sync) -> Planes {
        let mut numbers = vec![0.0; self.rows() * count * self.width];
        let level = Level::new();
        // The same source for all instructions, and none of them fuses: the same bytes.
        numbers
            .par_chunks_mut(count * self.width)
            .enumerate()
            .for_each(|(y, row)| dispatch!(level, _simd => fill(y, row)));
        Planes { width: self.width, count, numbers }
    }
}

/// Planes of what tells surfaces apart.
const NORMAL_PLANES: [usize; 3] = [0, 1, 2];
const ALBEDO_PLANES: [usize; 3] = [3, 4, 5];
const DEPTH_PLANE: usize = 6;
/// 1 / (depth at which surfaces differ).
const PER_DEPTH_PLANE: usize = 7;
/// Change of the depth from column to column, and from row to row.
const SLOPE_PLANES: [usize; 2] = [8, 9];
const SURFACE_PLANES: usize = 10;

/// Pixels of a row beside others that are as far from each.
struct Beside {
    /// Row of the others.
    row: usize,
    /// Columns, and those of the others.
    columns: Range<usize>,
    others: Range<usize>,
    /// How far the others are, in pixels.
    across: f32,
    down: f32,
    /// Before surfaces or light are looked at; all together weigh one.
    weight: f32,
}

/// Where others are along an axis.
#[derive(Clone, Copy)]
enum Side {
    Here,
    Before,
    After,
}

/// The pixels of a row themselves and the eight around each at a distance, as far as there are any.
#[inline(always)]
fn beside(planes: &Planes, y: usize, step: usize) -> impl Iterator<Item = Beside> {
    const SIDES: [(Side, f32, f32); 3] =
        [(Side::Here, 0.0, 0.5), (Side::Before, 1.0, 0.25), (Side::After, 1.0, 0.25)];
    let (width, rows) = (planes.width, planes.rows());
    let cut = step.min(width);
    SIDES.into_iter().flat_map(move |(vertical, down, weight_down)| {
        SIDES.into_iter().filter_map(move |(horizontal, across, weight_across)| {
            let row = match vertical {
                Side::Here => y,
                Side::Before => y.checked_sub(step)?,
                Side::After => Some(y + step).filter(|row| *row < rows)?,
            };
            let (columns, others) = match horizontal {
                Side::Here => (0..width, 0..width),
                Side::Before => (cut..width, 0..width - cut),
                Side::After => (0..width - cut, cut..width),
            };
            let [across, down] = [across, down].map(|side| side * step as f32);
            Some(Beside { row, columns, others, across, down, weight: weight_down * weight_across })
        })
    })
}

/// e to the minus what two pixels differ by, nearly: nothing from 8 on, without a function that no eight pixels take at once.
#[inline(always)]
fn weight_of(apart: f32) -> f32 {
    let base = (1.0 - 0.125 * apart).max(0.0);
    let fourth = (base * base) * (base * base);
    fourth * fourth
}

/// What is seen in a pixel.
#[derive(Clone, Copy)]
struct Seen {
    /// Of the classes that are filtered, W/(m² sr).
    light: Rgb,
    /// Of the class whose change is told.
    carried: Rgb,
    /// Of the mean luminance, (W/(m² sr))².
    variance: f64,
    albedo: Rgb,
    normal: Vec3,
    depth_m: f32,
}

impl Seen {
    const NOTHING: Seen = Seen {
        light: Rgb::BLACK,
        carried: Rgb::BLACK,
        variance: 0.0,
        albedo: Rgb::BLACK,
        normal: Vec3::ZERO,
        depth_m: 0.0,
    };

    fn of(pixel: &Pixel, held: Held, class: Option<PathClass>) -> Seen {
        let sum = |classes: &[PathClass]| -> Rgb {
            let mut sum = [0.0; 3];
            for class in classes {
                sum.iter_mut().zip(pixel.class_mean(*class, held)).for_each(|(sum, value)| *sum += value);
            }
            sum.map(|value| value as f32).into()
        };
        Seen {
            light: sum(&FILTERED),
            carried: class.map_or(Rgb::BLACK, |class| sum(&[class])),
            variance: pixel.variance_of_mean(held.passes),
            albedo: pixel.albedo_sum / held.passes as f32,
            normal: pixel.normal_sum.normalize_or_zero(),
            depth_m: pixel.depth_mean_m(),
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

struct Filter {
    seen: Vec<Seen>,
    surfaces: Planes,
    /// A power of two that brings light near one: products neither overflow nor vanish, and nothing is rounded.
    scale: f64,
    passes: u32,
    carries: bool,
}

impl Filter {
    /// - `class`: whose light is carried along by the weights that all light has, and whose change is told
    fn of(film: &Film, class: Option<PathClass>) -> Filter {
        let seen = film.image(Seen::NOTHING, |pixel, held| Seen::of(pixel, held, class));
        let brightest = seen.iter().map(|seen| seen.light.max_component()).fold(0.0, f32::max);
        let scale = (-f64::from(brightest.max(f32::MIN_POSITIVE)).log2().ceil()).exp2();
        let surfaces = surfaces(&seen, film.size().width() as usize);
        Filter { seen, surfaces, scale, passes: film.passes_min(), carries: class.is_some() }
    }

    fn run(&self) -> Denoised {
        let told = if self.carries { 3 } else { 0 };
        let before = self.light();
        let mut light = self.known_better(&before);
        let levels = match self.passes {
            0 => 0,
            1 => LEVELS_OF_ONE_PASS,
            _ => LEVELS,
        };
        for level in 0..levels {
            light = self.level(&light, 1 << level);
        }
        let change = self.seen.iter().enumerate().map(|(index, seen)| {
            let channel = |c: usize| {
                let change = light.at(index, told + c) - before.at(index, told + c);
                (f64::from(change) * f64::from(seen.divisor()[c]) / self.scale) as f32
            };
            Rgb::new(channel(0), channel(1), channel(2))
        });
        let change = change.collect();
        let (variance, noise_left) = self.noise_left(&light);
        Denoised { change, variance, noise_left }
    }

    /// Planes of light over albedo by channel, of that which is carried likewise, or none, and last of the variance of the first's
    /// luminance.
    fn light(&self) -> Planes {
        let scaled = |light: Rgb, seen: &Seen| -> [f32; 3] {
            std::array::from_fn(|c| (f64::from(light[c]) * self.scale) as f32 / seen.divisor()[c])
        };
        let variance = |seen: &Seen| (seen.variance * self.scale.powi(2) / seen.divisor_squared()) as f32;
        let width = self.surfaces.width;
        if self.carries {
            Planes::of(width, &self.seen, |_, seen| {
                let ([r, g, b], [cr, cg, cb]) = (scaled(seen.light, seen), scaled(seen.carried, seen));
                [r, g, b, cr, cg, cb, variance(seen)]
            })
        } else {
            Planes::of(width, &self.seen, |_, seen| {
                let [r, g, b] = scaled(seen.light, seen);
                [r, g, b, variance(seen)]
            })
        }
    }

    /// The same light with the variance that the first level goes by: that of few samples is hardly known and is joined with what lies
    /// around; of a single one it is how light differs there.
    fn known_better(&self, light: &Planes) -> Planes {
        let (width, last) = (light.width, light.count - 1);
        light.made(
            light.count,
            #[inline(always)]
            |y, row| {
                let (mut sums, mut squares) = (vec![0.0; width], vec![0.0; width]);
                let (mut weights, mut apart) = (vec![0.0; width], vec![0.0; width]);
                for beside in beside(light, y, 1) {
                    self.apart(y, &beside, &mut apart);
                    for ((x, other), apart) in beside.columns.zip(beside.others).zip(&apart) {
                        let value = if self.passes < 2 {
                            (0..3).map(|c| LUMINANCE[c] * light.row(beside.row, c)[other]).sum()
                        } else {
                            light.row(beside.row, last)[other]
                        };
                        let weight = weight_of(*apart);
                        sums[x] += weight * value;
                        squares[x] += weight * value * value;
                        weights[x] += weight;
                    }
                }
                for plane in 0..last {
                    row[plane * width..][..width].copy_from_slice(light.row(y, plane));
                }
                for (x, variance) in row[last * width..].iter_mut().enumerate() {
                    let mean = sums[x] / weights[x];
                    let spread = (squares[x] / weights[x] - mean * mean).max(0.0);
                    *variance = if self.passes < 2 { spread } else { mean };
                }
            },
        )
    }

    /// One level: pixels so many apart are joined.
    fn level(&self, light: &Planes, step: usize) -> Planes {
        let (width, last) = (light.width, light.count - 1);
        let per_difference = light.made(
            1,
            #[inline(always)]
            |y, row| {
                for Beside { row: other, columns, others, weight, .. } in beside(light, y, 1) {
                    add(&mut row[columns], &light.row(other, last)[others], |variance| weight * variance);
                }
                for value in row {
                    let deviations = DEVIATIONS * value.sqrt();
                    *value = if deviations > 1.0 / WITHOUT_BOUND { 1.0 / deviations } else { WITHOUT_BOUND };
                }
            },
        );
        light.made(
            light.count,
            #[inline(always)]
            |y, row| {
                let (mut weights, mut all_apart) = (vec![0.0; width], vec![0.0; width]);
                for beside in beside(light, y, step) {
                    self.apart(y, &beside, &mut all_apart);
                    let Beside { row: other, columns, others, .. } = beside;
                    let apart = &mut all_apart[..columns.len()];
                    let per_difference = &per_difference.row(y, 0)[columns.clone()];
                    let [r, g, b] = [0, 1, 2].map(|c| {
                        let there = &light.row(other, c)[others.clone()];
                        light.row(y, c)[columns.clone()].iter().zip(there)
                    });
                    // From here on weights.
                    for ((((apart, per), r), g), b) in
                        apart.iter_mut().zip(per_difference).zip(r).zip(g).zip(b)
                    {
                        let size = |(own, there): (&f32, &f32)| (own - there).abs();
                        let [r, g, b] =
                            [LUMINANCE[0] * size(r), LUMINANCE[1] * size(g), LUMINANCE[2] * size(b)];
                        *apart = beside.weight * weight_of(*apart + (r + g + b) * per);
                    }
                    for plane in 0..last {
                        let sums = &mut row[plane * width..][columns.clone()];
                        let there = &light.row(other, plane)[others.clone()];
                        for ((sum, weight), there) in sums.iter_mut().zip(&*apart).zip(there) {
                            *sum += weight * there;
                        }
                    }
                    let variances = &mut row[last * width..][columns.clone()];
                    for ((sum, weight), there) in
                        variances.iter_mut().zip(&*apart).zip(&light.row(other, last)[others])
                    {
                        *sum += weight * weight * there;
                    }
                    add(&mut weights[columns], apart, |weight| weight);
                }
                for (plane, sums) in row.chunks_exact_mut(width).enumerate() {
                    for (sum, weight) in sums.iter_mut().zip(&weights) {
                        // Each is its own neighbour: there is weight.
                        *sum /= if plane == last { weight * weight } else { *weight };
                    }
                }
            },
        )
    }

    /// How far the surfaces of pixels in row `y` differ from those beside them.
    #[inline(always)]
    fn apart(&self, y: usize, beside: &Beside, apart: &mut [f32]) {
        let Beside { row, columns, others, across, down, .. } = beside;
        let own = |plane: usize| &self.surfaces.row(y, plane)[columns.clone()];
        let there = |plane: usize| &self.surfaces.row(*row, plane)[others.clone()];
        let apart = &mut apart[..columns.len()];
        let [slope_across, slope_down] = SLOPE_PLANES.map(own);
        let slopes = slope_across.iter().zip(slope_down);
        let depths = own(DEPTH_PLANE).iter().zip(there(DEPTH_PLANE)).zip(own(PER_DEPTH_PLANE));
        for ((apart, (slope_across, slope_down)), ((depth, there), per_depth)) in
            apart.iter_mut().zip(slopes).zip(depths)
        {
            let expected = SLOPE * (slope_across * across + slope_down * down);
            *apart = ((depth - there).abs() - expected).max(0.0) * per_depth;
        }
        for (planes, scale) in [(NORMAL_PLANES, NORMAL), (ALBEDO_PLANES, ALBEDO)] {
            let per_square = 1.0 / (scale * scale);
            let [x, y, z] = planes.map(|plane| own(plane).iter().zip(there(plane)));
            for (((apart, x), y), z) in apart.iter_mut().zip(x).zip(y).zip(z) {
                let square = |(own, there): (&f32, &f32)| (own - there) * (own - there);
                *apart += (square(x) + square(y) + square(z)) * per_square;
            }
        }
    }

    /// Variance of each pixel that is left, and the share of all of it relative to what is shown.
    fn noise_left(&self, light: &Planes) -> (Vec<f32>, f64) {
        if self.passes < 2 {
            return (vec![0.0; self.seen.len()], 1.0);
        }
        let squared = self.scale.powi(2);
        let luminance = |seen: &Seen| f64::from(seen.light.luminance()) * self.scale;
        let mean = self.seen.iter().map(luminance).sum::<f64>() / self.seen.len() as f64;
        let floor = (0.01 * mean * mean).max(f64::MIN_POSITIVE);
        let (mut all, mut rest) = (0.0, 0.0);
        let mut variance = Vec::with_capacity(self.seen.len());
        for (index, seen) in self.seen.iter().enumerate() {
            let before = seen.variance * squared;
            // No pixel is known less for having noisier neighbours.
            let left = (f64::from(light.at(index, light.count - 1)) * seen.divisor_squared()).min(before);
            let left = left + KEPT * (before - left);
            let weight = 1.0 / (luminance(seen).powi(2) + floor);
            all += before * weight;
            rest += left * weight;
            variance.push((left / squared).min(f64::from(f32::MAX)) as f32);
        }
        (variance, if all > 0.0 && all.is_finite() { rest / all } else { 1.0 })
    }
}

#[inline(always)]
fn add(sums: &mut [f32], values: &[f32], of: impl Fn(f32) -> f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += of(*value));
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
    Planes::of::<SURFACE_PLANES>(width, seen, |index, Seen { albedo, normal, depth_m, .. }| {
        // What is not hit has no depth.
        let per_depth = (1.0 / (DEPTH * depth_m)).min(WITHOUT_BOUND);
        let slope_across = slope(index, index % width, width, 1);
        let slope_down = slope(index, index / width, rows, width);
        let ([x, y, z], [r, g, b]) = (normal.to_array(), albedo.to_array());
        [x, y, z, r, g, b, *depth_m, per_depth, slope_across, slope_down]
    })
}
