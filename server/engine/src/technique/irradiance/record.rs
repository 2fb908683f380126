//! One record: the light that a point receives by way of other surfaces, how it changes around, and how far that is to be
//! trusted.

use std::sync::atomic::AtomicBool;

use glam::Vec3;
use rayon::prelude::*;

use super::{
    IrradianceSettings, PIXELS_COARSER_MAX,
    hemisphere::{self, Hemisphere},
    horizon::Horizon,
    sight::Sight,
    walk::Seen,
};
use crate::{
    math::{Frame, Rgb},
    technique::{ArrivingLight, Counts},
    transport::{Surface, World},
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
    /// Normal of the triangle on that side, unit.
    pub n_geo: Vec3,
    /// Of light that another surface scattered, W/m².
    pub irradiance: Rgb,
    /// See [`Record::coat_rise`], in 65,535ths.
    pub(super) coat_rise: u16,
    /// Harmonic mean distance to what is seen from here, or less where neighbours, gradients or what hangs over it ask for it, m.
    pub radius_m: f32,
    /// It counts as far as this at least, m: over some pixels of where it was first seen, or fewer where neighbours were seen from nearer, or
    /// its light changes much over them.
    pub reach_min_m: f32,
    /// To be multiplied by (this normal × that normal), W/m².
    pub turning: Gradient,
    /// To be multiplied by the way from here, W/m³.
    pub moving: Gradient,
    /// What stands up around it: it does not count beyond.
    pub(super) horizon: Horizon,
}

/// Which way a point faces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facing {
    /// Shading normal on the side that is seen, unit.
    pub normal: Vec3,
    /// Normal of the triangle on the side that is seen, unit.
    pub n_geo: Vec3,
}

impl Facing {
    /// Of a surface seen from `wo`.
    pub fn of(surface: &Surface, wo: Vec3) -> Facing {
        let towards = |n: Vec3| if wo.dot(n) < 0.0 { -n } else { n };
        Facing { normal: towards(surface.frame.n), n_geo: towards(surface.point.n_geo) }
    }

    /// Of a flat surface.
    pub fn flat(n: Vec3) -> Facing {
        Facing { normal: n, n_geo: n }
    }
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
pub(super) const INVERSE_WEIGHT_MIN: f32 = 1e-4;
/// Cosine of the angle between triangles up to which they count as one surface. Shading normals may agree around an edge where
/// the triangles face apart; then one sees the room and the other looks into the wall.
pub(super) const SAME_SURFACE_COS: f32 = 0.5;
/// How far behind a record's plane a point may lie, in radii: what is behind sees other things.
pub(super) const BEHIND: f32 = 0.05;

/// Parts of [`Record::coat_rise`].
const PARTS: f32 = 65_535.0;

fn parts_of(share: f32) -> u16 {
    // Casts saturate.
    (share * PARTS + 0.5) as u16
}

impl Record {
    /// On a surface that nothing stands up around, and that receives nothing.
    #[cfg(test)]
    pub(crate) fn dark_in_the_open(
        position: Vec3,
        Facing { normal, n_geo }: Facing,
        radius_m: f32,
    ) -> Record {
        Record {
            position,
            normal,
            n_geo,
            irradiance: Rgb::BLACK,
            coat_rise: parts_of(crate::transport::EVEN_RISE),
            radius_m,
            reach_min_m: 0.0,
            turning: [Vec3::ZERO; 3],
            moving: [Vec3::ZERO; 3],
            horizon: Horizon::OPEN,
        }
    }

    /// Mean of [`schlick_rise`](crate::transport::schlick_rise) over its irradiance, 0 to 1: what a coat reflects of it.
    #[inline]
    pub fn coat_rise(&self) -> f32 {
        f32::from(self.coat_rise) * (1.0 / PARTS)
    }

    /// Farthest distance at which it counts, m.
    pub fn reach_m(&self, accuracy: f32) -> f32 {
        (accuracy * self.radius_m).max(self.reach_min_m)
    }

    /// Its weight at a point [eqs. 8.2, 8.3]; zero where it does not count.
    #[inline]
    pub fn weight(&self, p: Vec3, facing: &Facing, weighing: &Weighing) -> f32 {
        let weight = self.weight_through_walls(p, facing, weighing);
        if weight > 0.0 && self.is_hidden(p) { 0.0 } else { weight }
    }

    /// The same, whatever stands in between.
    #[inline]
    pub(super) fn weight_through_walls(&self, p: Vec3, facing: &Facing, weighing: &Weighing) -> f32 {
        let n = facing.normal;
        let way = p - self.position;
        let radius_m = self.reach_m(weighing.accuracy) / weighing.accuracy;
        let distance = way.length() / radius_m;
        let turned = (1.0 - n.dot(self.normal)).clamp(0.0, 2.0).sqrt();
        let inverse = distance + turned;
        if !(inverse < weighing.accuracy)
            || self.n_geo.dot(facing.n_geo) < SAME_SURFACE_COS
            || way.dot(n + self.normal) * 0.5 < -BEHIND * weighing.accuracy * radius_m
        {
            return 0.0;
        }
        let weight = 1.0 / inverse.max(INVERSE_WEIGHT_MIN);
        if weighing.is_smooth { (weight - 1.0 / weighing.accuracy).max(0.0) } else { weight }
    }

    /// Something stands between it and a point.
    #[inline]
    fn is_hidden(&self, p: Vec3) -> bool {
        let way = p - self.position;
        way.length_squared() > self.horizon.nearest_m().powi(2)
            && self.horizon.hides(Frame::around(self.n_geo).to_local(way))
    }

    /// Makes it count no farther than a neighbour lets it: its radius grows from that one's no faster than the way between them
    /// [Krivanek2006].
    pub(super) fn clamp_to(&mut self, neighbour: &Record, accuracy: f32) {
        let away_m = self.position.distance(neighbour.position);
        self.radius_m = self.radius_m.min(neighbour.reach_m(accuracy) / accuracy + away_m);
    }

    /// Makes it count no farther, by the pixels of its first sight, than a neighbour that was seen from nearer, or whose light is steep,
    /// lets it: over twice that one's pixels, and the way between them.
    pub(super) fn clamp_to_nearer_sight(&mut self, neighbour: &Record) {
        let away_m = self.position.distance(neighbour.position);
        self.reach_min_m = self.reach_min_m.min(PIXELS_COARSER_MAX * neighbour.reach_min_m + away_m);
    }

    /// How much of a way its gradients count for: where it reaches farther than its radius allows, they say less by as much [Ward1992].
    #[inline]
    pub(super) fn way_share(&self, accuracy: f32) -> f32 {
        (accuracy * self.radius_m / self.reach_m(accuracy)).min(1.0)
    }

    /// What it says of the irradiance at a point that faces `n`, never negative.
    #[inline]
    pub fn irradiance_at(&self, p: Vec3, n: Vec3, weighing: &Weighing) -> Rgb {
        if !weighing.has_gradients {
            return self.irradiance;
        }
        let way = (p - self.position) * self.way_share(weighing.accuracy);
        let turn = self.normal.cross(n);
        let change = |channel: usize| turn.dot(self.turning[channel]) + way.dot(self.moving[channel]);
        let [r, g, b] = self.irradiance.to_array();
        Rgb::new((r + change(0)).max(0.0), (g + change(1)).max(0.0), (b + change(2)).max(0.0))
    }

    /// Of the hemisphere above a point, and how far it counts. Where the light changes faster than the distances around say, it counts
    /// less far: never so far that its gradient would take all of its light away, or in under what hangs over the surface.
    fn of(
        world: &World,
        seen: &Seen,
        hemisphere: &Hemisphere,
        settings: &IrradianceSettings,
    ) -> (Record, Extent) {
        let mut record = Record {
            position: seen.point.position,
            normal: seen.facing.normal,
            n_geo: seen.facing.n_geo,
            irradiance: hemisphere.irradiance(),
            coat_rise: parts_of(hemisphere.coat_rise()),
            radius_m: hemisphere.harmonic_mean_m(world.accel().radius()),
            reach_min_m: 0.0,
            turning: hemisphere.turning(),
            moving: hemisphere.moving(),
            horizon: hemisphere.horizon(),
        };
        let all_gone_m = record.all_gone_m().min(hemisphere.overhang_m());
        record.radius_m = record.radius_m.min(all_gone_m);
        record.reach_min_m = settings.reach_min_m(seen.pixel_m, all_gone_m);
        let extent = Extent { radius_m: record.radius_m, all_gone_m };
        (record, extent)
    }

    /// Takes in another gathering at the same point, after so many `visits`; after none it takes the place of what was known. How far
    /// it counts stays.
    fn refine(&mut self, visits: u32, newest: &Record) {
        if visits == 0 {
            let Record { radius_m, reach_min_m, horizon, .. } = *self;
            *self = Record { radius_m, reach_min_m, horizon, ..*newest };
            return;
        }
        let share = 1.0 / (visits as f32 + 1.0);
        let of_newest = (newest.irradiance * share).mean();
        self.irradiance = self.irradiance * (1.0 - share) + newest.irradiance * share;
        let all = self.irradiance.mean();
        // Of light that is none, or beyond what numbers hold, it says nothing.
        let of_newest = if all > 0.0 { (of_newest / all).clamp(0.0, 1.0) } else { 0.0 };
        let [own, other] = [self.coat_rise(), newest.coat_rise()];
        self.coat_rise = parts_of(own + (other - own) * of_newest);
        let towards = |gradient: &mut Gradient, newest: Gradient| {
            gradient.iter_mut().zip(newest).for_each(|(mean, newest)| *mean += (newest - *mean) * share);
        };
        towards(&mut self.turning, newest.turning);
        towards(&mut self.moving, newest.moving);
    }

    /// The way over which its gradient would take all of its light away, m; infinite where it is even or dark.
    fn all_gone_m(&self) -> f32 {
        let [r, g, b] = self.moving;
        let steepest = Rgb::new(r.length(), g.length(), b.length()).mean();
        let all = self.irradiance.mean();
        let way_m = all / steepest;
        // Not where both are beyond what numbers hold: that is no way.
        if all > 0.0 && way_m >= 0.0 { way_m } else { f32::INFINITY }
    }
}

/// What records say falls on a point, in the making [eq. 8.1].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WeighedSum {
    irradiance: Rgb,
    coat_rise: f32,
    weights: f32,
}

impl WeighedSum {
    /// - `irradiance`: of the record at the point
    #[inline]
    pub(super) fn add(&mut self, record: &Record, irradiance: Rgb, weight: f32) {
        self.irradiance += irradiance * weight;
        self.coat_rise += record.coat_rise() * weight;
        self.weights += weight;
    }

    /// `None` where no record counts.
    pub(super) fn light(&self) -> Option<WeighedLight> {
        (self.weights > 0.0).then(|| WeighedLight {
            irradiance: self.irradiance * (1.0 / self.weights),
            coat_rise: self.coat_rise * (1.0 / self.weights),
        })
    }
}

/// What records say falls on a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct WeighedLight {
    /// W/m².
    pub(super) irradiance: Rgb,
    /// See [`Record::coat_rise`].
    coat_rise: f32,
}

impl WeighedLight {
    /// What the diffuse lobe of `surface` sends to `wo` of it, W/(m² sr).
    pub(super) fn scattered(&self, surface: &Surface, wo: Vec3) -> Rgb {
        surface.bsdf.diffuse_of_light(surface.frame.to_local(wo), self.coat_rise) * self.irradiance
    }
}

/// How far a record counts by itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    /// Harmonic mean distance to what is seen, or less where its gradient or what hangs over it asks for it, m.
    pub(super) radius_m: f32,
    /// The way over which its gradient, or what hangs over it, would take all of its light away, m; infinite where it is even.
    pub(super) all_gone_m: f32,
}

/// A record as it was just gathered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gathered {
    pub(super) record: Record,
    pub(super) extent: Extent,
    /// How far its rays went.
    pub(super) sight: Sight,
    /// Of the mean irradiance of the channels, as the halves of this gathering tell it, W/m².
    pub(super) deviation: f32,
}

/// What light is gathered with.
#[derive(Clone, Copy)]
pub(super) struct GatherBy<'a> {
    pub(super) world: &'a World,
    pub(super) settings: &'a IrradianceSettings,
    pub(super) arriving: &'a dyn ArrivingLight,
    /// Turns true when the answer is no longer wanted.
    pub(super) cancel: &'a AtomicBool,
}

impl GatherBy<'_> {
    /// Gathers at several points at once, in their order; `None` if that was cancelled.
    pub(super) fn gather_all(self, points: &[Seen]) -> Option<(Vec<Gathered>, Counts)> {
        self.gather(points, 0)
    }

    fn gather(self, points: &[Seen], visit: u32) -> Option<(Vec<Gathered>, Counts)> {
        let (hemispheres, counts) = self.hemispheres(points, visit)?;
        let gathered = |(seen, hemisphere): (_, &Hemisphere)| {
            let (record, extent) = Record::of(self.world, seen, hemisphere, self.settings);
            Gathered { record, extent, sight: hemisphere.sight(), deviation: hemisphere.deviation() }
        };
        Some((points.iter().zip(&hemispheres).map(gathered).collect(), counts))
    }

    /// Gathers once more for records that were gathered for at these points so many times; `None` if that was cancelled.
    pub(super) fn refine_all(
        self,
        (points, records): (&[Seen], &[Record]),
        visits: u32,
    ) -> Option<(Vec<Gathered>, Counts)> {
        let (mut gathered, counts) = self.gather(points, visits)?;
        for (newest, known) in gathered.iter_mut().zip(records) {
            let mut record = *known;
            record.refine(visits, &newest.record);
            newest.record = record;
        }
        Some((gathered, counts))
    }

    /// Points at which light is gathered together.
    pub(super) fn points_at_once(self) -> usize {
        (self.arriving.rays_at_once() / hemisphere::rays_of_a_round(self.settings)).max(1)
    }

    fn hemispheres(self, points: &[Seen], visit: u32) -> Option<(Vec<Hemisphere>, Counts)> {
        let GatherBy { world, settings, arriving, cancel } = self;
        let gathered: Option<Vec<(Vec<Hemisphere>, Counts)>> = points
            .par_chunks(self.points_at_once())
            .with_max_len(1)
            .map(|points| {
                let mut counts = Counts::default();
                let found =
                    Hemisphere::sample(world, points, settings, visit, arriving, cancel, &mut counts)?;
                Some((found, counts))
            })
            .collect();
        let gathered = gathered?;
        let counts = gathered.iter().map(|(_, counts)| *counts).sum();
        Some((gathered.into_iter().flat_map(|(hemispheres, _)| hemispheres).collect(), counts))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a coat reflects is a mean over light, however much of it each gathering brought.
    #[test]
    fn gatherings_count_by_their_light() {
        let of = |irradiance: f32, coat_rise: f32| Record {
            irradiance: Rgb::splat(irradiance),
            coat_rise: parts_of(coat_rise),
            ..Record::dark_in_the_open(Vec3::ZERO, Facing::flat(Vec3::Y), 1.0)
        };
        for (first, newest, rise) in [
            (of(1.0, 0.2), of(3.0, 0.6), 0.5),
            (of(0.0, 0.2), of(3.0, 0.6), 0.6),
            (of(3.0, 0.2), of(0.0, 0.6), 0.2),
            (of(0.0, 0.2), of(0.0, 0.6), 0.2),
        ] {
            let mut record = first;
            record.refine(1, &newest);
            assert!((record.coat_rise() - rise).abs() < 2e-5, "{record:?}");
            record.refine(0, &newest);
            assert_eq!(record.coat_rise, newest.coat_rise);
        }
    }
}
