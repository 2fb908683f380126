//! One record: the light that a point receives by way of other surfaces, how it changes around, and how far that is to be
//! trusted.

use glam::Vec3;
use rayon::prelude::*;

use super::IrradianceSettings;
use crate::{
    accel::{Ray, SurfacePoint},
    math::{Frame, Rgb, sobol},
    technique::{ArrivingLight, Counts},
    transport::World,
};

/// A change of colour with place or direction, by channel.
pub type Gradient = [Vec3; 3];

/// Irradiance at a point with its gradients [Ward1988; Ward1992].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Render space.
    pub position: Vec3,
    /// The side that receives, unit.
    pub normal: Vec3,
    /// Of light that another surface scattered, W/m².
    pub irradiance: Rgb,
    /// Harmonic mean distance to what is seen from here, or less where neighbours or gradients ask for it, m.
    pub radius_m: f32,
    /// It counts as far as this at least, m: about a pixel's width where it was first seen.
    pub reach_min_m: f32,
    /// To be multiplied by (this normal × that normal), W/m².
    pub turning: Gradient,
    /// To be multiplied by the way from here, W/m³.
    pub moving: Gradient,
}

/// How records are weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighing {
    /// Largest error that counts, a in [Ward1988].
    pub accuracy: f32,
    /// Weights end at zero instead of at 1/a, so that no circles show [Gautron2008, 8.2].
    pub is_smooth: bool,
    /// Records change around their point by their gradients.
    pub has_gradients: bool,
}

/// Weights end here where a record is asked for at its own place.
const INVERSE_WEIGHT_MIN: f32 = 1e-4;
/// How far behind a record's plane a point may lie, in radii: what is behind sees other things.
const BEHIND: f32 = 0.05;

impl Record {
    /// Farthest distance at which it counts, m.
    pub fn reach_m(&self, accuracy: f32) -> f32 {
        (accuracy * self.radius_m).max(self.reach_min_m)
    }

    /// Its weight at a point that faces `n` [eqs. 8.2, 8.3]; zero where it does not count.
    #[inline]
    pub fn weight(&self, p: Vec3, n: Vec3, weighing: &Weighing) -> f32 {
        let way = p - self.position;
        let radius_m = self.reach_m(weighing.accuracy) / weighing.accuracy;
        let distance = way.length() / radius_m;
        let turned = (1.0 - n.dot(self.normal)).clamp(0.0, 2.0).sqrt();
        let inverse = distance + turned;
        if !(inverse < weighing.accuracy)
            || way.dot(n + self.normal) * 0.5 < -BEHIND * weighing.accuracy * radius_m
        {
            return 0.0;
        }
        let weight = 1.0 / inverse.max(INVERSE_WEIGHT_MIN);
        if weighing.is_smooth { (weight - 1.0 / weighing.accuracy).max(0.0) } else { weight }
    }

    /// What it says of the irradiance at a point that faces `n`, never negative.
    #[inline]
    pub fn irradiance_at(&self, p: Vec3, n: Vec3, weighing: &Weighing) -> Rgb {
        if !weighing.has_gradients {
            return self.irradiance;
        }
        // Where a record reaches farther than its radius allows, its gradients say less by as much [Ward1992].
        let share = (weighing.accuracy * self.radius_m / self.reach_m(weighing.accuracy)).min(1.0);
        let way = (p - self.position) * share;
        let turn = self.normal.cross(n);
        let change = |channel: usize| turn.dot(self.turning[channel]) + way.dot(self.moving[channel]);
        let [r, g, b] = self.irradiance.to_array();
        Rgb::new((r + change(0)).max(0.0), (g + change(1)).max(0.0), (b + change(2)).max(0.0))
    }

    /// Gathers the light of the hemisphere above a point.
    ///
    /// - `n`: unit, the side that receives
    /// - `reach_min_m`: see [`Record::reach_min_m`]
    pub(super) fn gather(
        world: &World,
        point: &SurfacePoint,
        n: Vec3,
        reach_min_m: f32,
        settings: &IrradianceSettings,
        arriving: &dyn ArrivingLight,
        counts: &mut Counts,
    ) -> Record {
        let hemisphere = Hemisphere::sample(world, point, n, settings, arriving, counts);
        let mut record = Record {
            position: point.position,
            normal: n,
            irradiance: hemisphere.irradiance(),
            radius_m: hemisphere.harmonic_mean_m(world.accel().radius()),
            reach_min_m: reach_min_m.min(REACH_MIN_MAX * world.accel().radius()),
            turning: hemisphere.turning(),
            moving: hemisphere.moving(),
        };
        record.limit_by_gradient();
        record
    }

    /// Where the light changes faster than the distances around say, the record counts less far: never so far that its
    /// gradient would take all of it away.
    fn limit_by_gradient(&mut self) {
        let [r, g, b] = self.moving;
        let steepest = Rgb::new(r.length(), g.length(), b.length()).mean();
        let all = self.irradiance.mean();
        if steepest * self.radius_m > all && all > 0.0 {
            self.radius_m = all / steepest;
        }
    }
}

/// The samples of a hemisphere: rings from the pole to the horizon, each with as many sectors.
struct Hemisphere {
    frame: Frame,
    rings: usize,
    sectors: usize,
    /// Row by row; distances may be infinite.
    radiance: Vec<Rgb>,
    distance_m: Vec<f32>,
    /// Nothing counts as nearer than this, m.
    nearest_m: f32,
}

/// Distances below this share of the scene's radius count as it.
const NEAREST: f32 = 1e-6;
/// However far a pixel reaches, records count no farther than this share of the scene's radius for it.
const REACH_MIN_MAX: f32 = 0.1;
/// Sequence of random numbers of gathers.
const GATHER_SEQUENCE: u32 = 0x6761;

impl Hemisphere {
    fn sample(
        world: &World,
        point: &SurfacePoint,
        n: Vec3,
        settings: &IrradianceSettings,
        arriving: &dyn ArrivingLight,
        counts: &mut Counts,
    ) -> Hemisphere {
        let (rings, sectors) = settings.strata();
        let frame = Frame::around(n);
        // A record depends on its place alone, not on when it was made.
        let place = point.position.to_array().map(f32::to_bits);
        let key = place.iter().fold(settings.seed, |key, bits| sobol::mix(key ^ u64::from(*bits)));
        let mut rays = Vec::with_capacity(rings * sectors);
        for ring in 0..rings {
            for sector in 0..sectors {
                let [u, v, ..] = sobol::point(key, (ring * sectors + sector) as u32);
                let sin2 = (ring as f32 + u) / rings as f32;
                let phi = std::f32::consts::TAU * (sector as f32 + v) / sectors as f32;
                let (sin, cos) = (sin2.sqrt(), (1.0 - sin2).max(0.0).sqrt());
                let direction = frame.to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos));
                rays.push(point.ray_towards(direction.normalize()));
            }
        }
        let mut met = vec![None; rays.len()];
        world.closest_hits(&rays, &mut met);
        let distance_m = met.iter().map(|hit| hit.map_or(f32::INFINITY, |hit| hit.t)).collect();
        let radiance = (0u32..)
            .zip(rays.iter().zip(met))
            .map(|(index, (ray, met)): (u32, (&Ray, _))| {
                let sampler = sobol::PixelSampler::new(key, GATHER_SEQUENCE, (key >> 32) as u32, index);
                let radiance = arriving.radiance(world, ray, met, &sampler, counts);
                if radiance.is_finite() { radiance } else { Rgb::BLACK }
            })
            .collect();
        let nearest_m = (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE);
        Hemisphere { frame, rings, sectors, radiance, distance_m, nearest_m }
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

    fn irradiance(&self) -> Rgb {
        let sum = self.radiance.iter().fold(Rgb::BLACK, |sum, radiance| sum + *radiance);
        sum * (std::f32::consts::PI / self.radiance.len() as f32)
    }

    /// Harmonic mean of all distances, m; of `farthest_m` at most.
    fn harmonic_mean_m(&self, farthest_m: f32) -> f32 {
        let inverse: f32 = self.distance_m.iter().map(|distance| 1.0 / distance.max(self.nearest_m)).sum();
        (self.radiance.len() as f32 / inverse).min(farthest_m)
    }

    /// The rotational gradient [Ward1992, eq. 1], with the mean tangent of each ring, so that even light has none.
    fn turning(&self) -> Gradient {
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
    fn moving(&self) -> Gradient {
        let mut gradient = [Vec3::ZERO; 3];
        let inverse =
            |a: usize, b: usize| 1.0 / self.distance_m[a].min(self.distance_m[b]).max(self.nearest_m);
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

/// Gathers at several points at once, in their order.
pub(super) fn gather_all(
    world: &World,
    points: &[super::walk::Seen],
    settings: &IrradianceSettings,
    arriving: &dyn ArrivingLight,
) -> (Vec<Record>, Counts) {
    let gathered: Vec<(Record, Counts)> = points
        .par_iter()
        .with_max_len(1)
        .map(|seen| {
            let mut counts = Counts::default();
            let record = Record::gather(
                world,
                &seen.point,
                seen.normal,
                seen.pixel_m * settings.pixels_min,
                settings,
                arriving,
                &mut counts,
            );
            (record, counts)
        })
        .collect();
    let counts = gathered.iter().map(|(_, counts)| *counts).sum();
    (gathered.into_iter().map(|(record, _)| record).collect(), counts)
}
