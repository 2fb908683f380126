//! What path tracing says of a few pixels of a view, with many samples each: a measure of any picture of it.
//!
//! Pixels are taken in sets, each spread over the picture and drawn more often where error is expected, and traced in
//! groups of samples with numbers of their own, so that their means are independent of each other and of every film.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{Counts, FocusedLight, Guide, PathSettings, Tracer, View, cpu::primary_ray};
use crate::{
    film::{GAUGED_GROUPS, GaugedPixel, PictureSize, PixelSample},
    math::sobol::{self, PixelSampler},
    transport::World,
};

/// Pixels of a set, about: enough for an interval.
const SET_PIXELS: u32 = 64;
/// Never more in a set: rounding the grid of its cells to whole numbers adds a row at most.
const SET_POINTS_MAX: u32 = 2 * SET_PIXELS;
/// Samples that one step adds to either half of each pixel of a set.
const STEP_SAMPLES: u32 = 8;
/// Groups of a half.
const HALF_GROUPS: u32 = GAUGED_GROUPS as u32 / 2;
/// Sets of a gauge at most: 16,384 pixels.
const SETS_MAX: usize = 256;
/// A set counts beside the first once it has this share of its samples.
const COUNTED_SHARE: f64 = 0.5;
/// Share of the pixels of a set that are drawn evenly, wherever error is expected: none then stands for more than four times as many
/// as it would without. With half of them the relative variance of the mean was a third larger on three scenes.
const EVEN_SHARE: f64 = 0.25;

/// What samples cost and how they spread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleCost {
    /// Rays of all kinds, for one sample.
    pub rays: f64,
    /// Variance of one sample, relative as in the definition of the error, mean over pixels: divided by a number of samples
    /// it is the relMSE that their noise makes.
    pub variance: f64,
}

/// Truth at some pixels of one view.
#[derive(Debug)]
pub struct Gauge {
    settings: PathSettings,
    size: PictureSize,
    sets: Vec<Set>,
    rays: u64,
    samples: u64,
}

#[derive(Debug)]
struct Set {
    points: Vec<Point>,
    /// Samples of either half.
    samples: u32,
    /// Its halves were traced with hidden light of their own.
    halves: bool,
}

#[derive(Clone, Debug)]
struct Point {
    x: u32,
    y: u32,
    /// Pixels that it stands for, over those that each would stand for if all stood for as many.
    weight: f64,
    /// Σ of the samples of each group; the first half of them are those of one half.
    groups: [[f64; 3]; GAUGED_GROUPS],
    /// Σ (a − b)² / 2 over pairs of samples, one of either half: each expects the variance of a sample.
    spread: [f64; 3],
}

impl Gauge {
    /// Nothing traced yet.
    ///
    /// - `settings`: the path tracer's; its numbers are others than those of pictures with the same seed
    pub fn new(settings: PathSettings, size: PictureSize) -> Gauge {
        let seed = sobol::mix(settings.seed ^ 0x6761_7567_6500);
        let settings = PathSettings { seed, ..settings };
        Gauge { settings, size, sets: Vec::new(), rays: 0, samples: 0 }
    }

    /// Adds samples to the set that has the fewest, or takes a new set once all have so many in either half.
    ///
    /// - `expected`: where pixels of a new set are drawn most: for each pixel, row by row, a measure of the error expected, or
    ///   nothing. Whatever it says, the measure stays unbiased.
    /// - `hidden`: what path tracing cannot find, for either half
    /// - `guide`: what photons say of where light comes from, right or wrong
    pub fn step(
        &mut self,
        (world, view): (&World, &View),
        samples_enough: u32,
        expected: &[f32],
        hidden: [Option<&dyn FocusedLight>; 2],
        guide: Option<&Guide>,
        cancel: &AtomicBool,
    ) -> Counts {
        if cancel.load(Ordering::Relaxed) {
            return Counts::default();
        }
        let fewest = (0..self.sets.len()).min_by_key(|index| self.sets[*index].samples);
        let index = match fewest {
            Some(index) if self.sets[index].samples < samples_enough => index,
            Some(index) if self.sets.len() >= SETS_MAX => index,
            _ => {
                let number = self.sets.len() as u32;
                self.sets.push(Set::nth(number, self.size, self.settings.seed, expected));
                self.sets.len() - 1
            }
        };
        let tracers = hidden.map(|caustics| Tracer {
            view: Some(view),
            caustics,
            guide,
            ..Tracer::of(world, self.settings)
        });
        let width = self.size.width();
        let set = &mut self.sets[index];
        set.halves |= hidden.iter().any(Option::is_some);
        let numbers = set.samples / HALF_GROUPS..(set.samples + STEP_SAMPLES) / HALF_GROUPS;
        let first = index as u32 * SET_POINTS_MAX;
        let trace = |(place, point): (usize, &mut Point)| {
            // A pixel that is drawn again, in this set or another, is traced with other numbers.
            let sequence = GAUGED_GROUPS as u32 * (first + place as u32);
            let mut counts = Counts::default();
            numbers.clone().for_each(|number| {
                point.add(&tracers, (view, width), sequence, number, &mut counts);
            });
            counts
        };
        // In order: sums do not depend on the threads.
        let counts: Vec<Counts> = set.points.par_iter_mut().enumerate().with_max_len(1).map(trace).collect();
        set.samples += STEP_SAMPLES;
        let counts: Counts = counts.into_iter().sum();
        self.rays += counts.all_rays();
        self.samples += counts.paths;
        counts
    }

    /// Samples of either half that every counted pixel has, at least.
    pub fn samples(&self) -> u32 {
        self.counted().map(|(_, set)| set.samples).min().unwrap_or(0)
    }

    /// Samples of either half that the best known set has.
    pub fn samples_max(&self) -> u32 {
        self.sets.iter().map(|set| set.samples).max().unwrap_or(0)
    }

    /// No sample of any pixel brought light.
    pub fn is_black(&self) -> bool {
        let is_black = |point: &Point| point.groups.as_flattened().iter().all(|sum| *sum == 0.0);
        self.sets.iter().flat_map(|set| &set.points).all(is_black)
    }

    /// With their numbers.
    fn counted(&self) -> impl Iterator<Item = (usize, &Set)> {
        let most = self.sets.iter().map(|set| set.samples).max().unwrap_or(0);
        self.sets
            .iter()
            .enumerate()
            .filter(move |(_, set)| f64::from(set.samples) >= COUNTED_SHARE * f64::from(most))
    }

    /// The pixels and what is known of them.
    pub fn pixels(&self) -> Vec<GaugedPixel> {
        self.pixels_since(0)
    }

    /// Sets begun so far.
    pub fn set_count(&self) -> usize {
        self.sets.len()
    }

    /// No further set will be begun.
    pub fn is_full(&self) -> bool {
        self.sets.len() >= SETS_MAX
    }

    /// Of those, the ones of set number `first` and of later ones.
    pub fn pixels_since(&self, first: usize) -> Vec<GaugedPixel> {
        let width = self.size.width();
        let of_set = |set: &Set| {
            let (count, in_group) = (f64::from(set.samples), f64::from(set.samples / HALF_GROUPS));
            let of_point = move |point: &Point| GaugedPixel {
                index: (point.y * width + point.x) as usize,
                weight: point.weight,
                groups: point.groups.map(|group| group.map(|sum| sum / in_group)),
                halves: set.halves,
                variance: point.spread.map(|sum| sum / count / (2.0 * count)),
            };
            set.points.iter().map(of_point).collect::<Vec<_>>()
        };
        self.counted().filter(|(number, _)| *number >= first).flat_map(|(_, set)| of_set(set)).collect()
    }

    /// Cost and noise of a path-traced sample; `None` before the first step, and while all is black.
    pub fn cost(&self) -> Option<SampleCost> {
        let points =
            || self.sets.iter().flat_map(|set| set.points.iter().map(move |point| (set.samples, point)));
        let mean_of = |(samples, point): (u32, &Point)| -> [f64; 3] {
            let sum = |c: usize| point.groups.iter().map(|group| group[c]).sum::<f64>();
            std::array::from_fn(|c| sum(c) / (2.0 * f64::from(samples)))
        };
        let weights = points().map(|(_, point)| point.weight).sum::<f64>();
        let sum = points().map(|of| of.1.weight * mean_of(of).iter().sum::<f64>()).sum::<f64>();
        let mean = sum / (3.0 * weights);
        if self.sets.is_empty() || mean <= 0.0 {
            return None;
        }
        let floor = 0.01 * mean * mean;
        let of_point = |(samples, point): (u32, &Point)| {
            let mean = mean_of((samples, point));
            let relative = |c: usize| point.spread[c] / f64::from(samples) / (mean[c] * mean[c] + floor);
            point.weight * (0..3).map(relative).sum::<f64>() / 3.0
        };
        let variance = points().map(of_point).sum::<f64>() / weights;
        Some(SampleCost { rays: self.rays as f64 / self.samples.max(1) as f64, variance })
    }
}

impl Set {
    /// The pixels of set `number`: the picture is cut into as many strata as the set has pixels, of equal chance and each in one piece as
    /// far as that goes, and one pixel drawn of each.
    fn nth(number: u32, size: PictureSize, seed: u64, expected: &[f32]) -> Set {
        let columns = (f64::from(SET_PIXELS) * size.aspect()).sqrt().round() as u32;
        let columns = columns.clamp(1, SET_PIXELS).min(size.width());
        let rows = SET_PIXELS.div_ceil(columns).min(size.height());
        let (count, pixel_count) = (f64::from(rows * columns), size.pixel_count() as f64);
        let wanted = |x: u32, y: u32| {
            let wanted = expected.get((y * size.width() + x) as usize).map_or(0.0, |e| f64::from(*e));
            if wanted.is_finite() { wanted.max(0.0) } else { 0.0 }
        };
        let places = || walk(size, columns, rows);
        let sum: f64 = places().map(|(x, y)| wanted(x, y)).sum();
        // Where nothing is expected anywhere, all have the same chance.
        let even = if sum > 0.0 { EVEN_SHARE } else { 1.0 };
        let chance = |x: u32, y: u32| {
            let by_error = if sum > 0.0 { (1.0 - even) * wanted(x, y) / sum } else { 0.0 };
            even / pixel_count + by_error
        };
        let next = |stratum: usize| {
            let [u, ..] = PixelSampler::new(seed, number, stratum as u32, 0).four(u32::MAX);
            (stratum as f64 + f64::from(u)) / count
        };
        let mut points: Vec<Point> = Vec::with_capacity(count as usize);
        let (mut before, mut last, mut wanted_next) = (0.0, (0, 0), next(0));
        for (x, y) in places() {
            let chance = chance(x, y);
            before += chance;
            while (points.len() as f64) < count && wanted_next < before {
                points.push(Point::new((x, y), chance * pixel_count));
                wanted_next = next(points.len());
            }
            last = (x, y);
        }
        // Rounding may leave the sum of all chances below one.
        while (points.len() as f64) < count {
            points.push(Point::new(last, chance(last.0, last.1) * pixel_count));
        }
        Set { points, samples: 0, halves: false }
    }
}

/// All pixels, cell by cell of a grid of nearly square ones, to the right and back by turns, so that what follows each other lies
/// together.
fn walk(size: PictureSize, columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    let edge =
        |cell: u32, count: u32, side: u32| (u64::from(cell) * u64::from(side) / u64::from(count)) as u32;
    let cells = (0..rows).flat_map(move |row| {
        (0..columns).map(move |place| (if row % 2 == 0 { place } else { columns - 1 - place }, row))
    });
    cells.flat_map(move |(column, row)| {
        let across = edge(column, columns, size.width())..edge(column + 1, columns, size.width());
        let down = edge(row, rows, size.height())..edge(row + 1, rows, size.height());
        down.flat_map(move |y| across.clone().map(move |x| (x, y)))
    })
}

impl Point {
    /// - `chance`: of it to be drawn, over that if all had the same
    fn new((x, y): (u32, u32), chance: f64) -> Point {
        Point { x, y, weight: 1.0 / chance, groups: [[0.0; 3]; GAUGED_GROUPS], spread: [0.0; 3] }
    }

    /// One sample to each group.
    ///
    /// - `tracers`: for either half
    /// - `sequence`: of the first group's numbers; those of the others follow
    fn add(
        &mut self,
        tracers: &[Tracer<'_>; 2],
        (view, width): (&View, u32),
        sequence: u32,
        number: u32,
        counts: &mut Counts,
    ) {
        let pixel = self.y * width + self.x;
        let mut sample = |tracer: &Tracer<'_>, sequence: u32| {
            let sampler = PixelSampler::new(tracer.settings.seed, sequence, pixel, number);
            let ray = primary_ray(view, self.x, self.y, &sampler);
            let sample = tracer.sample_pixel(&ray, tracer.world.closest_hit(&ray), &sampler, counts);
            // What a film would not take counts as black, as there.
            let sample = if sample.is_sound() { sample } else { PixelSample::BLACK };
            sample.total().to_array().map(f64::from)
        };
        for group in 0..HALF_GROUPS {
            let of_halves = [group, group + HALF_GROUPS];
            let [a, b]: [[f64; 3]; 2] = [0, 1].map(|half| sample(&tracers[half], sequence + of_halves[half]));
            for (group, sample) in of_halves.into_iter().zip([a, b]) {
                self.groups[group as usize].iter_mut().zip(sample).for_each(|(sum, value)| *sum += value);
            }
            let pairs = a.into_iter().zip(b);
            self.spread.iter_mut().zip(pairs).for_each(|(sum, (a, b))| *sum += (a - b).powi(2) / 2.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::samples;
    use std::sync::Arc;

    /// Whatever error is expected where, every picture's size has pixels in it, and weighed they stand for all of its pixels:
    /// the weighted mean of any image is its mean.
    #[test]
    fn sets_stand_for_the_whole_picture() {
        for (width, height) in [(1, 1), (3, 500), (64, 48), (640, 3)] {
            let size = PictureSize::new(width, height).unwrap();
            let image = |x: u32, y: u32| 1.0 + f64::from(x * x + 3 * y);
            let mean = (0..height).flat_map(|y| (0..width).map(move |x| image(x, y))).sum::<f64>()
                / size.pixel_count() as f64;
            let mut expected: Vec<f32> = (0..size.pixel_count()).map(|i| (i % 7) as f32).collect();
            expected[0] = f32::INFINITY;
            for expected in [vec![], vec![0.0; size.pixel_count()], expected] {
                let sets: Vec<Set> = (0..400).map(|number| Set::nth(number, size, 1, &expected)).collect();
                let points = || sets.iter().flat_map(|set| &set.points);
                let count = points().count() as f64;
                let sum = points().map(|point| point.weight * image(point.x, point.y)).sum::<f64>();
                assert!((sum / count / mean - 1.0).abs() < 0.02, "{width}×{height}: {}", sum / count / mean);
                assert!(points().all(|point| point.weight <= 1.001 / EVEN_SHARE), "{width}×{height}");
                assert!(sets.iter().all(|set| set.points.len() <= SET_POINTS_MAX as usize));
            }
        }
    }

    /// Where error is expected in a hundredth of the picture, that has most of the pixels of every set.
    #[test]
    fn error_in_a_corner_is_met() {
        let size = PictureSize::new(80, 60).unwrap();
        let is_corner = |x: u32, y: u32| x < 8 && y < 6;
        let at = |index: u32| if is_corner(index % 80, index / 80) { 1.0 } else { 0.0 };
        let expected: Vec<f32> = (0..80 * 60).map(at).collect();
        for number in 0..8 {
            let set = Set::nth(number, size, 3, &expected);
            let met = set.points.iter().filter(|point| is_corner(point.x, point.y)).count();
            assert!(3 * met >= 2 * set.points.len(), "{met} of {}", set.points.len());
        }
    }

    /// Pixels that come again are traced with other numbers, and new sets begin once there are samples enough.
    #[test]
    fn what_comes_again_is_traced_anew() {
        let world = World::prepare(Arc::new(samples::boxes().unwrap()));
        let size = PictureSize::new(1, 1).unwrap();
        let view = View::new(&world, &world.scene().camera_view(None).unwrap(), size);
        let mut gauge = Gauge::new(PathSettings::all(None, 0), size);
        let never = AtomicBool::new(false);
        (0..8).for_each(|_| {
            gauge.step((&world, &view), 16, &[], [None, None], None, &never);
        });
        let pixels = gauge.pixels();
        assert_eq!((gauge.samples(), pixels.len(), gauge.is_black()), (16, 4, false));
        assert!(pixels.windows(2).all(|pair| pair[0].groups != pair[1].groups));
        assert!(gauge.cost().unwrap().variance > 0.0);
    }
}
