//! What path tracing says of a few pixels of a view, with many samples each: a measure of any picture of it.
//!
//! Pixels are taken in sets, each spread over the picture and drawn more often where error is expected, and traced in
//! groups of samples with numbers of their own, so that their means are independent of each other and of every film.
//!
//! Where noise hides the error, a set of pixels is taken again with more samples for those that are noisier. With a the weight times the
//! relative variance of a sample, n samples of a pixel leave the variance Σ (a/n)² in the sum of squared errors: of all with as many
//! samples in all that is least where n goes as a to the power 2/3. What the set was first traced with says how noisy they are, and has no
//! part in the means that follow: a pixel that is traced on because of what was found would be taken for darker or brighter than it is.

#[cfg(test)]
mod tests;

use std::{
    ops::RangeInclusive,
    sync::atomic::{AtomicBool, Ordering},
};

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
/// Sets of a gauge at most, without those that are taken again: 16,384 pixels.
const SETS_MAX: usize = 256;
/// A set counts beside the first once it has this share of its samples.
const COUNTED_SHARE: f64 = 0.5;
/// Share of the pixels of a set that are drawn evenly, wherever error is expected: none then stands for more than four times as many
/// as it would without. With half of them the relative variance of the mean was a third larger on three scenes.
const EVEN_SHARE: f64 = 0.25;

/// Samples of either half of a pixel that say how noisy it is: fewer say too little, more are not thrown away for that.
const PILOT_SAMPLES: RangeInclusive<u32> = 64..=256;
/// A noisy pixel gets so many times as many samples as one in the quieter half, at most; and where halves have maps of hidden light in
/// common, of which it sees no more than others.
const TIMES_MAX: [f64; 2] = [16.0, 4.0];
/// A set is taken again only where that leaves less than this share of the variance of its sum of squared errors with as many samples.
const WORTH_WHILE: f64 = 0.6;

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
    /// Sets before this one wait.
    traced_from: usize,
    /// Of pixels that are all traced as often.
    rays: u64,
    samples: u64,
}

#[derive(Debug)]
struct Set {
    points: Vec<Point>,
    /// Samples of either half that all its pixels have, those that are traced more often a multiple.
    samples: u32,
    /// Its halves were traced with hidden light of their own.
    halves: bool,
    /// The set whose pixels these are, which said how noisy each is.
    pilot: Option<usize>,
    /// The set that it is the pilot of.
    successor: Option<usize>,
}

#[derive(Clone, Debug)]
struct Point {
    x: u32,
    y: u32,
    /// Pixels that it stands for, over those that each would stand for if all stood for as many.
    weight: f64,
    /// How often it is traced when its set is.
    times: u32,
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
        Gauge { settings, size, sets: Vec::new(), traced_from: 0, rays: 0, samples: 0 }
    }

    /// See [`PathSettings::knows_openings`].
    #[cfg(feature = "gpu")]
    pub fn go_without_openings(&mut self) {
        self.settings.knows_openings = false;
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
        let waits = |index: &usize| {
            let set = &self.sets[*index];
            set.successor.is_some() || set.pilot.unwrap_or(*index) < self.traced_from
        };
        let in_use = (0..self.sets.len()).filter(|index| !waits(index));
        let fewest = in_use.min_by_key(|index| self.sets[*index].samples);
        let index = match fewest {
            Some(index) if self.sets[index].samples < samples_enough => index,
            Some(index) if self.is_full() => index,
            None if self.is_full() => return Counts::default(),
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
        // What is traced more often takes smaller steps, so that nobody waits for it.
        let step_samples = if set.pilot.is_some() { HALF_GROUPS } else { STEP_SAMPLES };
        let numbers = set.samples / HALF_GROUPS..(set.samples + step_samples) / HALF_GROUPS;
        let first = index as u32 * SET_POINTS_MAX;
        let trace = |(place, point): (usize, &mut Point)| {
            // A pixel that is drawn again, in this set or another, is traced with other numbers.
            let sequence = GAUGED_GROUPS as u32 * (first + place as u32);
            let mut counts = Counts::default();
            let times = point.times;
            (numbers.start * times..numbers.end * times).for_each(|number| {
                point.add(&tracers, (view, width), sequence, number, &mut counts);
            });
            counts
        };
        // In order: sums do not depend on the threads.
        let counts: Vec<Counts> = set.points.par_iter_mut().enumerate().with_max_len(1).map(trace).collect();
        set.samples += step_samples;
        let counts: Counts = counts.into_iter().sum();
        if set.pilot.is_none() {
            self.rays += counts.all_rays();
            self.samples += counts.paths;
        }
        counts
    }

    /// Sets before this one wait from now on: 0 for none.
    pub fn trace_from(&mut self, set: usize) {
        self.traced_from = set;
    }

    /// Takes sets again whose pixels are known well enough for that, with more samples for noisy ones.
    ///
    /// - `floor`: what is added to the square of a pixel's radiance to tell how much its noise counts, (W/(m² sr))²
    pub fn concentrate(&mut self, floor: f64) {
        for index in 0..self.sets.len() {
            let set = &self.sets[index];
            let is_first = set.pilot.is_none() && set.successor.is_none();
            if !is_first || !PILOT_SAMPLES.contains(&set.samples) {
                continue;
            }
            if let Some(again) = set.again(index, floor) {
                self.sets[index].successor = Some(self.sets.len());
                self.sets.push(again);
            }
        }
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

    /// With their numbers. For the pixels of a set that is taken again the pilot stands until as much is known of what follows it as is
    /// asked of any that counts.
    fn counted(&self) -> impl Iterator<Item = (usize, &Set)> {
        let most = self.samples_max();
        let is_enough = move |set: &Set| f64::from(set.samples) >= COUNTED_SHARE * f64::from(most);
        let stands =
            move |set: &Set| is_enough(set) && set.successor.is_none_or(|next| !is_enough(&self.sets[next]));
        self.sets.iter().enumerate().filter(move |(_, set)| stands(set))
    }

    /// The pixels and what is known of them.
    pub fn pixels(&self) -> Vec<GaugedPixel> {
        self.pixels_since(0)
    }

    /// Sets begun so far.
    pub fn set_count(&self) -> usize {
        self.sets.len()
    }

    /// No further pixels will be taken.
    pub fn is_full(&self) -> bool {
        self.sets.iter().filter(|set| set.pilot.is_none()).count() >= SETS_MAX
    }

    /// Of those, the ones that were first taken with set number `first` or later.
    pub fn pixels_since(&self, first: usize) -> Vec<GaugedPixel> {
        let width = self.size.width();
        let of_set = |set: &Set| {
            let of_point = move |point: &Point| {
                let samples = set.samples * point.times;
                let (count, in_group) = (f64::from(samples), f64::from(samples / HALF_GROUPS));
                GaugedPixel {
                    index: (point.y * width + point.x) as usize,
                    weight: point.weight,
                    times: f64::from(point.times),
                    groups: point.groups.map(|group| group.map(|sum| sum / in_group)),
                    halves: set.halves,
                    variance: point.spread.map(|sum| sum / count / (2.0 * count)),
                }
            };
            set.points.iter().map(of_point).collect::<Vec<_>>()
        };
        let taken = |(number, set): &(usize, &Set)| set.pilot.unwrap_or(*number) >= first;
        self.counted().filter(taken).flat_map(|(_, set)| of_set(set)).collect()
    }

    /// Cost and noise of a path-traced sample; `None` before the first step, and while all is black.
    pub fn cost(&self) -> Option<SampleCost> {
        let traced = || self.sets.iter().filter(|set| set.samples > 0);
        let points = || traced().flat_map(|set| set.points.iter().map(move |point| (set.samples, point)));
        let weights = points().map(|(_, point)| point.weight).sum::<f64>();
        let mean_of = |(samples, point): (u32, &Point)| point.mean(samples).iter().sum::<f64>() / 3.0;
        let mean = points().map(|of| of.1.weight * mean_of(of)).sum::<f64>() / weights;
        if weights <= 0.0 || mean <= 0.0 {
            return None;
        }
        let floor = 0.01 * mean * mean;
        let of_point = |(samples, point): (u32, &Point)| point.weight * point.variance(samples, floor);
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
        Set { points, samples: 0, halves: false, pilot: None, successor: None }
    }

    /// Its pixels with no sample yet, those that it found noisy to be traced more often; `None` where that is of little use.
    fn again(&self, index: usize, floor: f64) -> Option<Set> {
        let noises: Vec<f64> =
            self.points.iter().map(|point| point.weight * point.variance(self.samples, floor)).collect();
        let mut known: Vec<f64> = noises.iter().copied().filter(|noise| *noise > 0.0).collect();
        known.sort_unstable_by(f64::total_cmp);
        let middle = *known.get(known.len() / 2)?;
        let most = TIMES_MAX[usize::from(self.halves)];
        let times: Vec<f64> =
            noises.iter().map(|noise| (noise / middle).powf(2.0 / 3.0).round().clamp(1.0, most)).collect();
        let mean = times.iter().sum::<f64>() / times.len() as f64;
        let squares = |of: &dyn Fn(usize) -> f64| (0..noises.len()).map(|i| of(i).powi(2)).sum::<f64>();
        let share = squares(&|i| mean * noises[i] / times[i]) / squares(&|i| noises[i]);
        let again = |(point, times): (&Point, &f64)| Point {
            weight: point.weight,
            times: *times as u32,
            ..Point::new((point.x, point.y), 1.0)
        };
        (share < WORTH_WHILE).then(|| Set {
            points: self.points.iter().zip(&times).map(again).collect(),
            samples: 0,
            halves: false,
            pilot: Some(index),
            successor: None,
        })
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
        let groups = [[0.0; 3]; GAUGED_GROUPS];
        Point { x, y, weight: 1.0 / chance, times: 1, groups, spread: [0.0; 3] }
    }

    /// Mean of all samples.
    ///
    /// - `samples`: of either half of its set, more than none
    fn mean(&self, samples: u32) -> [f64; 3] {
        let count = 2.0 * f64::from(samples * self.times);
        std::array::from_fn(|c| self.groups.iter().map(|group| group[c]).sum::<f64>() / count)
    }

    /// Variance of a sample over the square of the radiance, mean over the channels.
    ///
    /// - `samples`: of either half of its set, more than none
    /// - `floor`: added to the square
    fn variance(&self, samples: u32, floor: f64) -> f64 {
        let (mean, count) = (self.mean(samples), f64::from(samples * self.times));
        let relative = |c: usize| self.spread[c] / count / (mean[c] * mean[c] + floor);
        (0..3).map(relative).sum::<f64>() / 3.0
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
