//! The light of a hemisphere, cell by cell: where it is uneven, more rays are sent.
//!
//! Two rays go through each cell (`strata.rs`), one of each half of the samples. How much a half differs from cell to cell says
//! where the *other* half needs more rays, which then share their cells' means: since no half decides over itself, the mean of both
//! stays unbiased, as that of samples which decide over themselves is not [Kirk1991]. Edges of bright patches, where nearly
//! all noise of a gather comes from, are thus looked at many times over; and so is what photons say is bright (`hints.rs`), which
//! few rays or none of a half may have met.

use std::{ops::Range, sync::atomic::AtomicBool};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{
    IrradianceSettings, Strata,
    hints::Hints,
    horizon::{Horizon, LowHits},
    overhang::overhang_m,
    record::Gradient,
    sight::Sight,
    walk::Seen,
};
use crate::{
    accel::SurfacePoint,
    math::{Frame, Rgb, sobol},
    technique::{Arrived, ArrivingLight, Counts, GatherRay, Guide},
    transport::{EVEN_RISE, World},
};

/// Distances below this share of the scene's radius count as it.
const NEAREST: f32 = 1e-6;
/// More rays than any setting sends: keeps shares of them finite where no noise is allowed.
const RAYS_WANTED_MAX: f32 = 1e9;
/// What hangs over a surface is looked for as far as records count, or over so many pixels where that is more: of eight that the roughest count over by
/// pixels, steep light takes none away from there on. No round's own number: how far a record counts is not to depend on when it was made.
const OVERHANG_PIXELS: f32 = 14.0;
/// Apart from those of the eye's paths.
const GATHER_SEQUENCE: u32 = 0x6761;

/// The light of a hemisphere.
pub(super) struct Hemisphere {
    frame: Frame,
    strata: Strata,
    /// Mean radiance of each cell, ring by ring.
    radiance: Vec<Rgb>,
    /// Mean of 1 / distance in each cell, 1/m; of rays that set out behind the triangle nothing.
    nearness: Vec<f32>,
    /// Share of the hemisphere that lies before the triangle.
    before_share: f32,
    /// How far all of them went.
    sight: Sight,
    /// What the lowest of them met.
    horizon: Horizon,
    /// The way over which light may be gone because something hangs over the surface, m.
    overhang_m: f32,
    deviation: f32,
}

/// Samples of one half, cell by cell.
#[derive(Clone)]
struct Half {
    radiance_sum: Vec<Rgb>,
    nearness_sum: Vec<f32>,
    /// Weights of rays that set out before the triangle, and of all.
    before_sum: Vec<f32>,
    weight_sum: Vec<f32>,
    counts: Vec<u32>,
}

impl Half {
    fn of(cells: usize) -> Half {
        let [nearness_sum, before_sum, weight_sum] = [(); 3].map(|()| vec![0.0; cells]);
        let (radiance_sum, counts) = (vec![Rgb::BLACK; cells], vec![0; cells]);
        Half { radiance_sum, nearness_sum, before_sum, weight_sum, counts }
    }

    /// - `weight`: of the ray; `radiance` has it already
    /// - `nearness`: nothing of rays that set out behind the triangle
    fn add(&mut self, cell: usize, radiance: Rgb, weight: f32, nearness: Option<f32>) {
        self.radiance_sum[cell] += radiance;
        self.nearness_sum[cell] += weight * nearness.unwrap_or(0.0);
        self.before_sum[cell] += if nearness.is_some() { weight } else { 0.0 };
        self.weight_sum[cell] += weight;
        self.counts[cell] += 1;
    }

    fn radiance(&self, cell: usize) -> Rgb {
        self.radiance_sum[cell] * (1.0 / self.counts[cell] as f32)
    }
}

/// A hemisphere that is being sampled, in two rounds: through every cell, and where that shows uneven light.
struct Gathering<'a> {
    point: &'a SurfacePoint,
    /// Width of a pixel where it is seen, m.
    pixel_m: f32,
    /// Of the triangle, on the side that receives.
    plane: Frame,
    frame: Frame,
    strata: Strata,
    /// What is known of its light before.
    hints: Option<Hints>,
    /// Names its random numbers.
    key: u64,
    /// Nothing counts as nearer than this, m.
    nearest_m: f32,
    sent: u32,
    sight: Sight,
    low_hits: LowHits,
    halves: [Half; 2],
    /// Where the next rays of each half go.
    due: [Vec<Aim>; 2],
}

/// Where a ray goes.
#[derive(Clone, Copy, Debug)]
struct Aim {
    cell: usize,
    /// Unit, in the hemisphere's frame.
    direction: Vec3,
    /// For how much it counts: less where it is likelier to go than elsewhere in its cell.
    weight: f32,
}

impl<'a> Gathering<'a> {
    /// - `visit`: how often the point was gathered at before: names other rays
    fn new(
        world: &World,
        seen: &'a Seen,
        settings: &IrradianceSettings,
        visit: u32,
        guide: Option<&Guide>,
    ) -> Gathering<'a> {
        let Seen { point, facing, pixel_m } = seen;
        let (strata, frame) = (settings.strata(), Frame::around(facing.normal));
        // A record depends on its place and on what is known of the light alone, not on when it was made.
        let place = point.position.to_array().map(f32::to_bits).into_iter().chain([visit]);
        let key = place.fold(settings.seed, |key, bits| sobol::mix(key ^ u64::from(bits)));
        let cells: Vec<usize> = (0..strata.count()).collect();
        let mut gathering = Gathering {
            point,
            pixel_m: *pixel_m,
            plane: Frame::around(facing.n_geo),
            frame,
            strata,
            hints: guide.and_then(|guide| {
                Hints::of(guide.flights_at(point.position, frame.n), point.position, &frame, strata)
            }),
            key,
            nearest_m: (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE),
            sent: 0,
            sight: Sight::NONE,
            low_hits: LowHits::NONE,
            halves: [Half::of(cells.len()), Half::of(cells.len())],
            due: [Vec::new(), Vec::new()],
        };
        gathering.due = [0, 1].map(|half| gathering.aims(half, &cells));
        gathering
    }

    /// Where rays of a half go through some cells, of which each may be named several times in a row.
    fn aims(&self, half: usize, cells: &[usize]) -> Vec<Aim> {
        let mut counts = self.halves[half].counts.clone();
        let aim = |cell: &usize| {
            let cell = *cell;
            let number = counts[cell];
            counts[cell] += 1;
            // The first rays of all cells are spread over their cells together, those that follow over their own.
            let [x, y, ..] = match number.checked_sub(1) {
                None => sobol::point(self.key, (half * self.strata.count() + cell) as u32),
                Some(again) => sobol::point(sobol::mix(self.key ^ (1 + 2 * cell + half) as u64), again),
            };
            let even = Vec2::new(x, y);
            let (place, weight) = match &self.hints {
                Some(hints) => hints.place(cell, even),
                None => (even, 1.0),
            };
            Aim { cell, direction: self.strata.direction(cell, place), weight }
        };
        cells.iter().map(aim).collect()
    }

    /// The rays that are due, half by half.
    fn rays(&self) -> impl Iterator<Item = GatherRay> {
        (self.sent..).zip(self.due.iter().flatten()).map(|(number, aim)| GatherRay {
            ray: self.point.ray_towards(self.frame.to_world(aim.direction).normalize()),
            sampler: sobol::PixelSampler::new(self.key, GATHER_SEQUENCE, (self.key >> 32) as u32, number),
        })
    }

    /// Takes in what the rays that were due have brought.
    fn take(&mut self, rays: &[GatherRay], arrived: &[Arrived]) {
        self.sent += rays.len() as u32;
        let mut brought = rays.iter().zip(arrived);
        for (half, due) in self.halves.iter_mut().zip(&mut self.due) {
            for (aim, (GatherRay { ray, .. }, arrived)) in std::mem::take(due).into_iter().zip(&mut brought) {
                self.sight.add(self.frame.to_local(ray.direction), arrived.distance_m);
                // Where a shading normal leans off its triangle some rays set out behind it. What they meet there, the
                // triangle beside from within at no distance, says nothing of how light changes along the surface.
                let is_before = ray.direction.dot(self.plane.n) > 0.0;
                let nearness =
                    arrived.distance_m.map_or(0.0, |distance_m| 1.0 / distance_m.max(self.nearest_m));
                self.low_hits.add(self.plane.to_local(ray.direction), arrived.distance_m);
                let radiance = arrived.radiance * aim.weight;
                let radiance = if radiance.is_finite() { radiance } else { Rgb::BLACK };
                half.add(aim.cell, radiance, aim.weight, is_before.then_some(nearness));
            }
        }
    }

    /// Looks again where light is uneven, each half where the other says so.
    fn look_again(&mut self, settings: &IrradianceSettings) {
        // Each of two independent halves may be off by √2 as much as their mean.
        let noise = std::f32::consts::SQRT_2 * settings.noise;
        let cells = self.strata.count();
        let [of_first, of_second] = self.halves.each_ref().map(|half| self.uneven(half, noise, cells));
        self.due = [self.aims(0, &of_second), self.aims(1, &of_first)];
    }

    /// The hemisphere, and the rays that it took to find what hangs over the surface.
    ///
    /// - `visit`: only the first asks for that
    fn end(self, world: &World, visit: u32) -> (Hemisphere, u64) {
        let [first, second] = &self.halves;
        let cells = 0..self.strata.count();
        let radiance =
            cells.clone().map(|cell| (first.radiance(cell) + second.radiance(cell)) * 0.5).collect();
        // Means of what rays met, which no weight takes beyond what any of them did.
        let mean_of = |sums: fn(&Half) -> &Vec<f32>, cell: usize| {
            (sums(first)[cell] + sums(second)[cell]) / (first.weight_sum[cell] + second.weight_sum[cell])
        };
        let irradiance_of = |half: &Half| {
            let sum: f32 = cells.clone().map(|cell| half.radiance(cell).mean()).sum();
            std::f32::consts::PI * sum / cells.len() as f32
        };
        let deviation = 0.5 * (irradiance_of(first) - irradiance_of(second)).abs();
        let nearness = cells.clone().map(|cell| mean_of(|half| &half.nearness_sum, cell)).collect();
        let before: f32 = cells.clone().map(|cell| mean_of(|half| &half.before_sum, cell)).sum();
        let mut hemisphere = Hemisphere {
            frame: self.frame,
            strata: self.strata,
            radiance,
            nearness,
            before_share: before / cells.len() as f32,
            sight: self.sight,
            horizon: self.low_hits.horizon(),
            overhang_m: f32::INFINITY,
            deviation,
        };
        if visit > 0 {
            return (hemisphere, 0);
        }
        let farthest_m = OVERHANG_PIXELS * self.pixel_m;
        let limit_m = hemisphere.harmonic_mean_m(world.accel().radius()).max(farthest_m);
        let on = (self.point, &self.plane);
        let (found_m, rays) = overhang_m(world, on, self.low_hits.places(), limit_m);
        hemisphere.overhang_m = found_m.max(self.nearest_m);
        (hemisphere, rays)
    }

    /// Cells that the other half is to look at again, each as often as it takes, at most so many rays: those that most differ
    /// from their neighbours, by what this half met or photons say, until the irradiance is known to `noise` of itself.
    fn uneven(&self, half: &Half, noise: f32, count_max: usize) -> Vec<usize> {
        let strata = self.strata;
        let luminance: Vec<f32> = (0..strata.count()).map(|cell| half.radiance(cell).mean()).collect();
        let met: f32 = luminance.iter().sum();
        // Where it met nothing photons alone say where light is.
        let all = if met > 0.0 { met } else { 1.0 };
        let spread_of = |light: &dyn Fn(usize) -> f32, cell: usize| {
            let off = |other: usize| (light(other) - light(cell)).abs();
            // A cell that is half one and half the other has this spread.
            0.5 * strata.beside(cell).map(off).fold(0.0, f32::max)
        };
        let spread: Vec<f32> = (0..strata.count())
            .map(|cell| {
                let met = spread_of(&|cell| luminance[cell], cell);
                let told = self.hints.as_ref().map(|hints| all * spread_of(&|cell| hints.share(cell), cell));
                met.max(told.unwrap_or(0.0))
            })
            .collect();
        let spreads: f32 = spread.iter().sum();
        if !(spreads > 0.0) {
            return Vec::new();
        }
        // Shared out by spread, n rays know the sum to Σ spread / √n [Neyman1934].
        let wanted = (spreads / (noise * all)).powi(2).min(RAYS_WANTED_MAX);
        let rays_per_spread = wanted / spreads;
        let more = |spread: &f32| (rays_per_spread * spread - 1.0).max(0.0);
        let asked: f32 = spread.iter().map(more).sum();
        let share = (count_max as f32 / asked).min(1.0);
        let mut cells = Vec::with_capacity(count_max);
        let mut due = 0.5;
        for (cell, spread) in spread.iter().enumerate() {
            due += share * more(spread);
            while due >= 1.0 && cells.len() < count_max {
                cells.push(cell);
                due -= 1.0;
            }
        }
        cells
    }
}

/// Rays of one hemisphere that are asked for together.
pub(super) fn rays_of_a_round(settings: &IrradianceSettings) -> usize {
    2 * settings.strata().count()
}

impl Hemisphere {
    /// The hemispheres above some points, whose rays are asked for together; `None` if that was cancelled.
    ///
    /// - `visit`: how often the points were gathered at before: names other rays
    pub(super) fn sample(
        world: &World,
        points: &[Seen],
        settings: &IrradianceSettings,
        visit: u32,
        arriving: &dyn ArrivingLight,
        cancel: &AtomicBool,
        counts: &mut Counts,
    ) -> Option<Vec<Hemisphere>> {
        // Asked for once, before threads share the points out: the first that asks may have to wait for it.
        let guide = arriving.guide();
        let mut all: Vec<Gathering<'_>> =
            points.par_iter().map(|seen| Gathering::new(world, seen, settings, visit, guide)).collect();
        for is_last in [false, true] {
            let mut end = 0;
            let own: Vec<Range<usize>> = all
                .iter()
                .map(|gathering| {
                    let first = end;
                    end += gathering.due.iter().map(Vec::len).sum::<usize>();
                    first..end
                })
                .collect();
            let rays: Vec<GatherRay> = all.par_iter().flat_map_iter(Gathering::rays).collect();
            let arrived = arriving.along(world, &rays, cancel, counts)?;
            all.par_iter_mut().zip(own).for_each(|(gathering, own)| {
                gathering.take(&rays[own.clone()], &arrived[own]);
                if !is_last {
                    gathering.look_again(settings);
                }
            });
        }
        let ended: Vec<(Hemisphere, u64)> =
            all.into_par_iter().map(|gathering| gathering.end(world, visit)).collect();
        counts.rays += ended.iter().map(|(_, rays)| rays).sum::<u64>();
        Some(ended.into_iter().map(|(hemisphere, _)| hemisphere).collect())
    }

    /// Directions in the surface's plane: of an angle in sectors, and across it.
    fn in_plane(&self, sectors: f32) -> [Vec3; 2] {
        let phi = std::f32::consts::TAU * sectors / self.strata.sectors as f32;
        let (sin, cos) = phi.sin_cos();
        [self.frame.to_world(Vec3::new(cos, sin, 0.0)), self.frame.to_world(Vec3::new(-sin, cos, 0.0))]
    }

    pub(super) fn sight(&self) -> Sight {
        self.sight
    }

    pub(super) fn horizon(&self) -> Horizon {
        self.horizon
    }

    /// The way over which light may be gone because something hangs over the surface, m; infinite where nothing does, or was asked.
    pub(super) fn overhang_m(&self) -> f32 {
        self.overhang_m
    }

    /// Standard deviation of the mean irradiance of the channels, as its two halves tell it, W/m²; its square is as good as right in the
    /// mean (each half has more rays where the other is uneven, which makes the two a little alike: up to a half too small).
    pub(super) fn deviation(&self) -> f32 {
        self.deviation
    }

    pub(super) fn irradiance(&self) -> Rgb {
        let sum = self.radiance.iter().fold(Rgb::BLACK, |sum, radiance| sum + *radiance);
        sum * (std::f32::consts::PI / self.radiance.len() as f32)
    }

    /// Mean of [`schlick_rise`](crate::transport::schlick_rise) over the irradiance.
    pub(super) fn coat_rise(&self) -> f32 {
        // 2 ∫ (1 − μ)⁵ μ dμ from the pole.
        let from_pole = |ring: usize| {
            let low = 1.0 - (1.0 - ring as f32 / self.strata.rings as f32).sqrt();
            low.powi(6) * (1.0 / 3.0 - low * (2.0 / 7.0))
        };
        let [mut risen, mut all] = [0f64; 2];
        for ring in 0..self.strata.rings {
            let rise = (from_pole(ring + 1) - from_pole(ring)) * self.strata.rings as f32;
            for sector in 0..self.strata.sectors {
                let radiance = f64::from(self.radiance[self.strata.at(ring, sector)].mean());
                risen += radiance * f64::from(rise);
                all += radiance;
            }
        }
        if all > 0.0 && all.is_finite() { (risen / all) as f32 } else { EVEN_RISE }
    }

    /// Harmonic mean of the distances before the triangle, m; of `farthest_m` at most, and none where all rays set out behind it.
    pub(super) fn harmonic_mean_m(&self, farthest_m: f32) -> f32 {
        let inverse: f32 = self.nearness.iter().sum();
        let count = self.before_share * self.radiance.len() as f32;
        if count > 0.0 { (count / inverse).min(farthest_m) } else { 0.0 }
    }

    /// The rotational gradient [Ward1992, eq. 1], with the mean tangent of each ring, so that even light has none.
    pub(super) fn turning(&self) -> Gradient {
        let mut gradient = [Vec3::ZERO; 3];
        // ∫ tan θ d(sin² θ) from the pole.
        let from_pole = |ring: usize| {
            let sin2 = ring as f32 / self.strata.rings as f32;
            sin2.sqrt().asin() - (sin2 * (1.0 - sin2)).sqrt()
        };
        let tangent = |ring: usize| (from_pole(ring + 1) - from_pole(ring)) * self.strata.rings as f32;
        for sector in 0..self.strata.sectors {
            let [_, across] = self.in_plane(sector as f32 + 0.5);
            let mut sum = Rgb::BLACK;
            for ring in 0..self.strata.rings {
                sum += self.radiance[self.strata.at(ring, sector)] * tangent(ring);
            }
            add(&mut gradient, across, sum * (std::f32::consts::PI / self.radiance.len() as f32));
        }
        gradient
    }

    /// The translational gradient [Ward1992, eq. 2]: what comes into view and goes out of it where neighbouring samples
    /// differ, the faster the nearer the nearer one is.
    pub(super) fn moving(&self) -> Gradient {
        let mut gradient = [Vec3::ZERO; 3];
        let inverse = |a: usize, b: usize| self.nearness[a].max(self.nearness[b]);
        let sin_below = |ring: usize| (ring as f32 / self.strata.rings as f32).sqrt();
        for sector in 0..self.strata.sectors {
            let [along, _] = self.in_plane(sector as f32 + 0.5);
            let mut outwards = Rgb::BLACK;
            for ring in 1..self.strata.rings {
                let (outer, inner) = (self.strata.at(ring, sector), self.strata.at(ring - 1, sector));
                let sin = sin_below(ring);
                let rate = sin * (1.0 - sin * sin) * inverse(outer, inner);
                outwards += (self.radiance[outer] - self.radiance[inner]) * rate;
            }
            add(&mut gradient, along, outwards * (std::f32::consts::TAU / self.strata.sectors as f32));
            let [_, across] = self.in_plane(sector as f32);
            let mut sideways = Rgb::BLACK;
            for ring in 0..self.strata.rings {
                let (here, before) =
                    (self.strata.at(ring, sector), self.strata.at(ring, sector + self.strata.sectors - 1));
                let rate = (sin_below(ring + 1) - sin_below(ring)) * inverse(here, before);
                sideways += (self.radiance[here] - self.radiance[before]) * rate;
            }
            add(&mut gradient, across, sideways);
        }
        gradient
    }
}

fn add(gradient: &mut Gradient, direction: Vec3, amount: Rgb) {
    for (sum, amount) in gradient.iter_mut().zip(amount.to_array()) {
        *sum += direction * amount;
    }
}
