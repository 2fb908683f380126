//! Irradiance cache: light that changes slowly is computed at few places and interpolated between them.
//!
//! A record holds what a point receives by way of other surfaces, gathered by stratified rays over its hemisphere, with
//! gradients for turning and moving [Ward1988; Ward1992; Gautron2008, 8] (`record.rs`). Each ray brings the light that falls
//! straight on the surface it meets and what is known of the rest there (photons, by way of the light octree), so that all
//! bounces are there. A walk over the picture finds where no record counts (`walk.rs`); records are valid for every camera. They are
//! splatted onto what a camera sees straight (`splat.rs`); the rest looks them up, as graphics cards do everywhere (`upload.rs`).
//! What they show is what they surely know better than the octree (`steadied.rs`).
//!
//! **Biased**: interpolated over a · R. Consistent as a shrinks and rays and photons grow.

mod caching;
mod hemi_plane;
mod hemisphere;
mod hints;
mod horizon;
mod index;
mod overhang;
mod record;
mod sight;
mod splat;
mod steadied;
mod strata;
#[cfg(test)]
mod tests;
mod upload;
mod visits;
mod walk;

use std::{
    num::{NonZeroU32, NonZeroUsize},
    sync::Arc,
};

use glam::Vec3;

pub use self::{
    caching::IrradianceCaching,
    hemi_plane::{HemiPlane, PastPlane},
    record::{Facing, Gradient, Record, Weighing},
    visits::Visits,
};

use self::{
    index::Index,
    record::{WeighedLight, WeighedSum},
    splat::Splats,
    strata::Strata,
};
use super::{
    ArrivingLight, Bias, Card, Counts, Guide, PackedRecords, ScatteredLight, ScreenLight, SecondaryLight,
    View,
};
use crate::{
    math::Rgb,
    transport::{PathClass, Surface},
};

/// Parameters of the irradiance cache.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IrradianceSettings {
    /// How records are weighed.
    pub weighing: Weighing,
    /// Rays of a record, about; half as many where the light is even enough.
    pub ray_count: NonZeroUsize,
    /// Noise of a record's irradiance from which on more rays are not worth their time, a share of it.
    pub noise: f32,
    /// How often light is gathered for a record: once for all, then again for all.
    pub visits: Visits,
    /// Records that are found missing together at most: of neighbours among them only one is made.
    pub records_per_batch: NonZeroUsize,
    /// Records kept at most; where there are more, the light falls back on what they are gathered from.
    pub records_max: usize,
    /// Radii grow from record to record no faster than the distance between them, so that no corner is overlooked
    /// [Krivanek2006].
    pub clamps_neighbours: bool,
    /// A record counts over so many pixels of its first sight at least, or down to a quarter of them where its light changes much.
    pub pixels_min: f32,
    /// Steps are cut to some 10 ms by the clock, so that whoever waits is not kept waiting; else to a fixed number of records.
    /// What records become does not depend on it.
    pub is_paced: bool,
    /// Names the random numbers.
    pub seed: u64,
}

/// Rougher records reach over so many times as many pixels at most, however much farther they count by what they see: over
/// more, what is small is smoothed away (the dragon at 2 s: 6.0 % with four times, 5.2 % with two).
const PIXELS_GROWTH_MAX: f32 = 2.0;
/// What was first seen from far is covered no more for who looks at it from so many times nearer: with less, the near and the far end of
/// one floor would ask for records of their own all over.
const PIXELS_COARSER_MAX: f32 = 2.0;
/// Pixels make a record count no farther than this share of the way over which its gradient would take all of its light away: between
/// the slats of a blind, three pixels apart, records of four pixels were off by 55 % however long they were gathered for.
const STEEP_SHARE: f32 = 0.6;
/// Of so many times fewer pixels at the finest: by default one, in the last round. What is finer than a pixel is not seen, and its records
/// would be missing elsewhere meanwhile.
const STEEP_FINER_MAX: f32 = 4.0;
const RAY_COUNT: NonZeroUsize = NonZeroUsize::new(400).unwrap();
/// By 32 visits three narrow spots by `auto` are off by half of what they were by four after 30 s; more would keep a picture of few samples
/// waiting for longer yet.
const VISITS: Visits =
    Visits { least: NonZeroU32::new(4).unwrap(), most: NonZeroU32::new(32).unwrap(), noise: 0.03 };
const RECORDS_PER_BATCH: NonZeroUsize = NonZeroUsize::new(100).unwrap();

impl Default for IrradianceSettings {
    fn default() -> IrradianceSettings {
        IrradianceSettings {
            weighing: Weighing { accuracy: 0.15, is_smooth: true, has_gradients: true },
            ray_count: RAY_COUNT,
            noise: 0.03,
            visits: VISITS,
            records_per_batch: RECORDS_PER_BATCH,
            records_max: 500_000,
            clamps_neighbours: true,
            pixels_min: 4.0,
            is_paced: true,
            seed: 0,
        }
    }
}

impl IrradianceSettings {
    /// With records that count so many times as far.
    fn rougher(self, by: f32) -> IrradianceSettings {
        let accuracy = self.weighing.accuracy * by;
        let pixels_min = self.pixels_min * by.min(PIXELS_GROWTH_MAX);
        IrradianceSettings { weighing: Weighing { accuracy, ..self.weighing }, pixels_min, ..self }
    }

    /// How far a record counts at least, m.
    ///
    /// - `pixel_m`: width of a pixel where it is seen
    /// - `all_gone_m`: the way over which all of its light may be gone; infinite where it is even
    fn reach_min_m(&self, pixel_m: f32, all_gone_m: f32) -> f32 {
        let whole_m = self.pixels_min * pixel_m;
        whole_m.min((STEEP_SHARE * all_gone_m).max(whole_m / STEEP_FINER_MAX))
    }

    /// Rings and sectors of a hemisphere: cells about as wide as high [Ward1992], with four rays each at most in the mean.
    fn strata(&self) -> Strata {
        let rings =
            (self.ray_count.get() as f32 / (4.0 * std::f32::consts::PI)).sqrt().round().max(2.0) as usize;
        Strata { rings, sectors: (std::f32::consts::PI * rings as f32).round() as usize }
    }
}

/// Records and where they are; what is known where there are none.
#[derive(Clone, Debug)]
pub struct IrradianceCache {
    settings: IrradianceSettings,
    records: Vec<Record>,
    index: Index,
    /// What answers where no record counts, and for caustics.
    base: Option<Arc<dyn SecondaryLight>>,
    /// Answers before that: records that count farther.
    rougher: Option<Arc<IrradianceCache>>,
    /// How often a neighbour has made a record count less far.
    shrunk_count: u64,
    /// relMSE of what records hold by chance, of those of which that is known.
    noise: f64,
}

static CARD: Card =
    Card { name: "irradiance", classes: &[PathClass::Indirect, PathClass::Caustic], bias: Bias::Biased };

impl IrradianceCache {
    /// No records yet.
    pub fn new(settings: IrradianceSettings, base: Option<Arc<dyn SecondaryLight>>) -> IrradianceCache {
        IrradianceCache {
            settings,
            records: Vec::new(),
            index: Index::default(),
            base,
            rougher: None,
            shrunk_count: 0,
            noise: 0.0,
        }
    }

    /// The same with rougher records that answer after these.
    #[cfg(test)]
    pub(crate) fn before(self, rougher: IrradianceCache) -> IrradianceCache {
        IrradianceCache { rougher: Some(Arc::new(rougher)), ..self }
    }

    /// These and rougher ones, in the order in which they answer.
    #[cfg(test)]
    pub(crate) fn in_order(&self) -> Vec<&IrradianceCache> {
        std::iter::successors(Some(self), |cache| cache.rougher.as_deref()).collect()
    }

    /// How its records are weighed.
    #[cfg(test)]
    pub(crate) fn weighing(&self) -> &Weighing {
        &self.settings.weighing
    }

    /// Light where records count, these or rougher ones.
    fn any_light(&self, p: Vec3, facing: &Facing) -> Option<WeighedLight> {
        self.weighed_light(p, facing, Record::weight).or_else(|| self.rougher.as_ref()?.any_light(p, facing))
    }

    /// Records count at a point and are fine enough for who looks at it from where a pixel is so wide there, m; or one is so near that
    /// another beside it would show in less than a pixel: else the leaves of a tree would each ask for their own.
    fn covers(&self, p: Vec3, facing: &Facing, pixel_m: f32) -> bool {
        let weighing = &self.settings.weighing;
        let widest_m = PIXELS_COARSER_MAX * self.settings.reach_min_m(pixel_m, f32::INFINITY);
        self.index.around(p).any(|place| {
            let record = &self.records[place as usize];
            let reach_min_m = record.reach_min_m.min(widest_m);
            let record = Record { reach_min_m, ..*record };
            let is_near = || record.position.distance_squared(p) < pixel_m * pixel_m;
            let counts_if_near = record.weight_through_walls(p, facing, weighing) > 0.0 && is_near();
            counts_if_near || record.weight(p, facing, weighing) > 0.0
        })
    }

    /// The records, oldest first.
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// Irradiance at a point [eq. 8.1], W/m²; `None` where no record counts.
    pub fn irradiance(&self, p: Vec3, facing: &Facing) -> Option<Rgb> {
        self.weighed_light(p, facing, Record::weight).map(|light| light.irradiance)
    }

    /// Light where nothing else is known: what counts but for walls, these records or rougher ones.
    fn light_through_walls(&self, p: Vec3, facing: &Facing) -> Option<WeighedLight> {
        self.weighed_light(p, facing, Record::weight_through_walls)
            .or_else(|| self.rougher.as_ref()?.light_through_walls(p, facing))
    }

    fn weighed_light(
        &self,
        p: Vec3,
        facing: &Facing,
        weight: impl Fn(&Record, Vec3, &Facing, &Weighing) -> f32,
    ) -> Option<WeighedLight> {
        let weighing = &self.settings.weighing;
        let mut sum = WeighedSum::default();
        for place in self.index.around(p) {
            let record = &self.records[place as usize];
            let weight = weight(record, p, facing, weighing);
            if weight > 0.0 {
                sum.add(record, record.irradiance_at(p, facing.normal, weighing), weight);
            }
        }
        sum.light()
    }

    /// Takes a record in, and clamps how far it and its neighbours count to each other.
    pub fn insert(&mut self, mut record: Record) {
        if self.settings.clamps_neighbours {
            let accuracy = self.settings.weighing.accuracy;
            let is_beside = |other: &Record| other.normal.dot(record.normal) > 0.0;
            let near = self.index.around(record.position);
            let near: Vec<u32> = near.filter(|place| is_beside(&self.records[*place as usize])).collect();
            for place in &near {
                let other = &self.records[*place as usize];
                record.clamp_to(other, accuracy);
                record.clamp_to_nearer_sight(other);
            }
            for place in near {
                // Its entries in the index reach as far as before, which is too far and does no harm.
                let other = &mut self.records[place as usize];
                let before_m = other.reach_m(accuracy);
                other.clamp_to(&record, accuracy);
                other.clamp_to_nearer_sight(&record);
                self.shrunk_count += u64::from(other.reach_m(accuracy) < before_m);
            }
        }
        self.index.insert(
            self.records.len() as u32,
            record.position,
            record.reach_m(self.settings.weighing.accuracy),
        );
        self.records.push(record);
    }

    /// Leaves out records, by their places.
    fn retain(&mut self, is_kept: &[bool]) {
        let mut kept = is_kept.iter();
        self.records.retain(|_| kept.next().is_some_and(|is_kept| *is_kept));
        let accuracy = self.settings.weighing.accuracy;
        self.index = Index::default();
        for (place, record) in (0..).zip(&self.records) {
            self.index.insert(place, record.position, record.reach_m(accuracy));
        }
    }

    /// Memory that showing records takes for each pixel of a picture, at most, without that of the records.
    pub const BYTES_PER_PIXEL: usize = Splats::BYTES_PER_PIXEL;

    /// Memory of records and their index.
    pub fn bytes(&self) -> usize {
        let rougher = self.rougher.as_ref().map_or(0, |rougher| rougher.bytes());
        self.records.len() * size_of::<Record>() + self.index.bytes() + rougher
    }
}

impl SecondaryLight for IrradianceCache {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn places(&self) -> Vec<Vec3> {
        self.records.iter().map(|record| record.position).collect()
    }

    fn laid_out_for(self: Arc<Self>, view: &View) -> Option<Arc<dyn ScreenLight>> {
        Some(Arc::new(Splats::of(self, view)?))
    }

    fn has_caustics(&self) -> bool {
        self.base.as_ref().is_some_and(|base| base.has_caustics())
    }

    fn packed_records(&self) -> Option<PackedRecords> {
        Some(self.pack_records())
    }

    fn guide(&self) -> Option<&Guide> {
        self.base.as_ref()?.guide()
    }

    fn has_records(&self) -> bool {
        true
    }

    fn noise(&self) -> f64 {
        self.noise
    }

    fn base(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.base.as_ref()
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        let scattered = self.scattered_but_caustics(surface, wo, draw);
        match &self.base {
            Some(base) if base.has_caustics() => {
                ScatteredLight { caustic: base.scattered(surface, wo, None).caustic, ..scattered }
            }
            _ => scattered,
        }
    }

    fn scattered_but_caustics(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        let (p, facing) = (surface.point.position, Facing::of(surface, wo));
        let light = self.any_light(p, &facing);
        if let (None, Some(base)) = (light, &self.base) {
            return base.scattered(surface, wo, draw);
        }
        // Where records count they say more than how far each reaches.
        let light = light.or_else(|| self.light_through_walls(p, &facing));
        light.map_or_else(ScatteredLight::default, |light| ScatteredLight {
            indirect: light.scattered(surface, wo),
            ..ScatteredLight::default()
        })
    }
}
