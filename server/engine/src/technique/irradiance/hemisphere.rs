//! The light of a hemisphere, cell by cell: where it is uneven, more rays are sent.
//!
//! Rings from the pole to the horizon, each with as many sectors, all of the same cosine-weighted solid angle [Ward1992]. Two
//! rays go through each cell, one of each half of the samples. How much a half differs from cell to cell says where the
//! *other* half needs more rays, which then share their cells' means: since no half decides over itself, the mean of both
//! stays unbiased, as that of samples which decide over themselves is not [Kirk1991]. Edges of bright patches, where nearly
//! all noise of a gather comes from, are thus looked at many times over.

use std::{ops::Range, sync::atomic::AtomicBool};

use glam::Vec3;
use rayon::prelude::*;

use super::{
    IrradianceSettings,
    horizon::{Horizon, LowHits},
    record::Gradient,
    sight::Sight,
    walk::Seen,
};
use crate::{
    accel::SurfacePoint,
    math::{Frame, Rgb, sobol},
    technique::{Arrived, ArrivingLight, Counts, GatherRay},
    transport::World,
};

/// Distances below this share of the scene's radius count as it.
const NEAREST: f32 = 1e-6;
/// More rays than any setting sends: keeps shares of them finite where no noise is allowed.
const RAYS_WANTED_MAX: f32 = 1e9;
/// Apart from those of the eye's paths.
const GATHER_SEQUENCE: u32 = 0x6761;

/// The light of a hemisphere.
pub(super) struct Hemisphere {
    frame: Frame,
    rings: usize,
    sectors: usize,
    /// Mean radiance of each cell, ring by ring.
    radiance: Vec<Rgb>,
    /// Mean of 1 / distance in each cell, 1/m; of rays that set out behind the triangle nothing.
    nearness: Vec<f32>,
    /// Share of the rays that set out before the triangle.
    before_share: f32,
    /// How far all of them went.
    sight: Sight,
    /// What the lowest of them met.
    horizon: Horizon,
}

/// Samples of one half, cell by cell.
#[derive(Clone)]
struct Half {
    radiance_sum: Vec<Rgb>,
    nearness_sum: Vec<f32>,
    counts: Vec<f32>,
}

impl Half {
    fn of(cells: usize) -> Half {
        Half {
            radiance_sum: vec![Rgb::BLACK; cells],
            nearness_sum: vec![0.0; cells],
            counts: vec![0.0; cells],
        }
    }

    fn add(&mut self, cell: usize, radiance: Rgb, nearness: f32) {
        self.radiance_sum[cell] += radiance;
        self.nearness_sum[cell] += nearness;
        self.counts[cell] += 1.0;
    }

    fn radiance(&self, cell: usize) -> Rgb {
        self.radiance_sum[cell] * (1.0 / self.counts[cell])
    }
}

/// A hemisphere that is being sampled, in two rounds: through every cell, and where that shows uneven light.
struct Gathering<'a> {
    point: &'a SurfacePoint,
    /// Of the triangle, on the side that receives.
    plane: Frame,
    frame: Frame,
    rings: usize,
    sectors: usize,
    /// Names its random numbers.
    key: u64,
    /// Nothing counts as nearer than this, m.
    nearest_m: f32,
    sent: u32,
    /// Of those, the ones that set out before the triangle.
    before_count: u32,
    sight: Sight,
    low_hits: LowHits,
    halves: [Half; 2],
    /// Cells that the next rays of each half go through, which may be named more than once.
    due: [Vec<usize>; 2],
}

impl<'a> Gathering<'a> {
    /// - `visit`: how often the point was gathered at before: names other rays
    fn new(world: &World, seen: &'a Seen, settings: &IrradianceSettings, visit: u32) -> Gathering<'a> {
        let Seen { point, facing, .. } = seen;
        let (rings, sectors) = settings.strata();
        // A record depends on its place alone, not on when it was made.
        let place = point.position.to_array().map(f32::to_bits).into_iter().chain([visit]);
        let key = place.fold(settings.seed, |key, bits| sobol::mix(key ^ u64::from(bits)));
        let cells: Vec<usize> = (0..rings * sectors).collect();
        Gathering {
            point,
            plane: Frame::around(facing.n_geo),
            frame: Frame::around(facing.normal),
            rings,
            sectors,
            key,
            nearest_m: (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE),
            sent: 0,
            before_count: 0,
            sight: Sight::NONE,
            low_hits: LowHits::NONE,
            halves: [Half::of(cells.len()), Half::of(cells.len())],
            due: [cells.clone(), cells],
        }
    }

    /// The rays that are due, half by half.
    fn rays(&self) -> impl Iterator<Item = GatherRay> {
        (self.sent..).zip(self.due.iter().flatten()).map(|(number, cell)| self.ray(number, *cell))
    }

    fn ray(&self, number: u32, cell: usize) -> GatherRay {
        let [u, v, ..] = sobol::point(self.key, number);
        let (ring, sector) = (cell / self.sectors, cell % self.sectors);
        let sin2 = (ring as f32 + u) / self.rings as f32;
        let phi = std::f32::consts::TAU * (sector as f32 + v) / self.sectors as f32;
        let (sin, cos) = (sin2.sqrt(), (1.0 - sin2).max(0.0).sqrt());
        let direction = self.frame.to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos));
        GatherRay {
            ray: self.point.ray_towards(direction.normalize()),
            sampler: sobol::PixelSampler::new(self.key, GATHER_SEQUENCE, (self.key >> 32) as u32, number),
        }
    }

    /// Takes in what the rays that were due have brought.
    fn take(&mut self, rays: &[GatherRay], arrived: &[Arrived]) {
        self.sent += rays.len() as u32;
        let mut brought = rays.iter().zip(arrived);
        for (half, due) in self.halves.iter_mut().zip(&mut self.due) {
            for (cell, (GatherRay { ray, .. }, arrived)) in std::mem::take(due).into_iter().zip(&mut brought)
            {
                let radiance = arrived.radiance;
                self.sight.add(self.frame.to_local(ray.direction), arrived.distance_m);
                // Where a shading normal leans off its triangle some rays set out behind it. What they meet there, the
                // triangle beside from within at no distance, says nothing of how light changes along the surface.
                let is_before = ray.direction.dot(self.plane.n) > 0.0;
                let distance_m = arrived.distance_m.filter(|_| is_before);
                let nearness = distance_m.map_or(0.0, |distance_m| 1.0 / distance_m.max(self.nearest_m));
                self.before_count += u32::from(is_before);
                self.low_hits.add(self.plane.to_local(ray.direction), arrived.distance_m);
                half.add(cell, if radiance.is_finite() { radiance } else { Rgb::BLACK }, nearness);
            }
        }
    }

    /// Looks again where light is uneven, each half where the other says so.
    fn look_again(&mut self, settings: &IrradianceSettings) {
        // Each of two independent halves may be off by √2 as much as their mean.
        let noise = std::f32::consts::SQRT_2 * settings.noise;
        let cells = self.rings * self.sectors;
        let [of_first, of_second] = self.halves.each_ref().map(|half| self.uneven(half, noise, cells));
        self.due = [of_second, of_first];
    }

    fn end(self) -> Hemisphere {
        let [first, second] = &self.halves;
        let cells = 0..self.rings * self.sectors;
        let radiance =
            cells.clone().map(|cell| (first.radiance(cell) + second.radiance(cell)) * 0.5).collect();
        let nearness = cells.map(|cell| {
            (first.nearness_sum[cell] + second.nearness_sum[cell])
                / (first.counts[cell] + second.counts[cell])
        });
        Hemisphere {
            frame: self.frame,
            rings: self.rings,
            sectors: self.sectors,
            radiance,
            nearness: nearness.collect(),
            before_share: self.before_count as f32 / self.sent as f32,
            sight: self.sight,
            horizon: self.low_hits.horizon(),
        }
    }

    /// Cells that the other half is to look at again, each as often as it takes, at most so many rays: those that most differ
    /// from their neighbours, until the irradiance is known to `noise` of itself.
    fn uneven(&self, half: &Half, noise: f32, count_max: usize) -> Vec<usize> {
        let cells = self.rings * self.sectors;
        let luminance: Vec<f32> = (0..cells).map(|cell| half.radiance(cell).mean()).collect();
        let spread: Vec<f32> = (0..cells)
            .map(|cell| {
                let (ring, sector) = (cell / self.sectors, cell % self.sectors);
                let row = ring * self.sectors;
                let beside =
                    [row + (sector + 1) % self.sectors, row + (sector + self.sectors - 1) % self.sectors];
                let inwards = ring.checked_sub(1).map(|_| cell - self.sectors);
                let outwards = (ring + 1 < self.rings).then(|| cell + self.sectors);
                let neighbours = beside.into_iter().chain(inwards).chain(outwards);
                let farthest =
                    neighbours.map(|other| (luminance[other] - luminance[cell]).abs()).fold(0.0, f32::max);
                // A cell that is half one and half the other has this spread.
                0.5 * farthest
            })
            .collect();
        let (all, spreads): (f32, f32) = (luminance.iter().sum(), spread.iter().sum());
        if !(all > 0.0 && spreads > 0.0) {
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
    let (rings, sectors) = settings.strata();
    2 * rings * sectors
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
        let mut all: Vec<Gathering<'_>> =
            points.par_iter().map(|seen| Gathering::new(world, seen, settings, visit)).collect();
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
        Some(all.into_iter().map(Gathering::end).collect())
    }

    fn at(&self, ring: usize, sector: usize) -> usize {
        ring * self.sectors + sector % self.sectors
    }

    /// Directions in the surface's plane: of an angle in sectors, and across it.
    fn in_plane(&self, sectors: f32) -> [Vec3; 2] {
        let phi = std::f32::consts::TAU * sectors / self.sectors as f32;
        let (sin, cos) = phi.sin_cos();
        [self.frame.to_world(Vec3::new(cos, sin, 0.0)), self.frame.to_world(Vec3::new(-sin, cos, 0.0))]
    }

    pub(super) fn sight(&self) -> Sight {
        self.sight
    }

    pub(super) fn horizon(&self) -> Horizon {
        self.horizon
    }

    pub(super) fn irradiance(&self) -> Rgb {
        let sum = self.radiance.iter().fold(Rgb::BLACK, |sum, radiance| sum + *radiance);
        sum * (std::f32::consts::PI / self.radiance.len() as f32)
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
            let sin2 = ring as f32 / self.rings as f32;
            sin2.sqrt().asin() - (sin2 * (1.0 - sin2)).sqrt()
        };
        let tangent = |ring: usize| (from_pole(ring + 1) - from_pole(ring)) * self.rings as f32;
        for sector in 0..self.sectors {
            let [_, across] = self.in_plane(sector as f32 + 0.5);
            let mut sum = Rgb::BLACK;
            for ring in 0..self.rings {
                sum += self.radiance[self.at(ring, sector)] * tangent(ring);
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
        let sin_below = |ring: usize| (ring as f32 / self.rings as f32).sqrt();
        for sector in 0..self.sectors {
            let [along, _] = self.in_plane(sector as f32 + 0.5);
            let mut outwards = Rgb::BLACK;
            for ring in 1..self.rings {
                let (outer, inner) = (self.at(ring, sector), self.at(ring - 1, sector));
                let sin = sin_below(ring);
                let rate = sin * (1.0 - sin * sin) * inverse(outer, inner);
                outwards += (self.radiance[outer] - self.radiance[inner]) * rate;
            }
            add(&mut gradient, along, outwards * (std::f32::consts::TAU / self.sectors as f32));
            let [_, across] = self.in_plane(sector as f32);
            let mut sideways = Rgb::BLACK;
            for ring in 0..self.rings {
                let (here, before) = (self.at(ring, sector), self.at(ring, sector + self.sectors - 1));
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
