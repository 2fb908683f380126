//! Irradiance cache: light that changes slowly is computed at few places and interpolated between them.
//!
//! A record holds what a point receives by way of other surfaces, gathered by stratified rays over its hemisphere, with
//! gradients for turning and moving [Ward1988; Ward1992; Gautron2008, 8] (`record.rs`). Each ray brings the light that falls
//! straight on the surface it meets and what is known of the rest there (photons, by way of the light octree), so that all
//! bounces are there. A walk over the picture finds where no record counts (`walk.rs`); records are valid for every camera.
//!
//! **Biased**: interpolated over a · R. Consistent as a shrinks and rays and photons grow.

mod hemisphere;
mod index;
mod record;
#[cfg(test)]
mod tests;
mod walk;

use std::{
    num::{NonZeroU32, NonZeroUsize},
    sync::{Arc, atomic::Ordering},
};

use glam::Vec3;

pub use self::record::{Facing, Gradient, Record, Weighing};

use self::{
    index::Index,
    walk::{Seen, Walk},
};
use super::{
    ArrivingLight, Bias, Card, Counts, Edit, Progress, ScatteredLight, SecondaryLight, Step, Technique,
};
use crate::{
    film::PictureSize,
    math::Rgb,
    transport::{PathClass, Surface, World},
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
    /// How often light is gathered for a record, at most: once for all records, then again and again for each, until their
    /// noise is small beside what interpolation leaves.
    pub visits: NonZeroU32,
    /// Records made in one step at most.
    pub records_per_step: NonZeroUsize,
    /// Records kept at most; where there are more, the light falls back on what they are gathered from.
    pub records_max: usize,
    /// Radii grow from record to record no faster than the distance between them, so that no corner is overlooked
    /// [Krivanek2006].
    pub clamps_neighbours: bool,
    /// A record counts over so many pixels of its first sight at least.
    pub pixels_min: f32,
    /// Names the random numbers.
    pub seed: u64,
}

const RAY_COUNT: NonZeroUsize = NonZeroUsize::new(400).unwrap();
const VISITS: NonZeroU32 = NonZeroU32::new(4).unwrap();
const RECORDS_PER_STEP: NonZeroUsize = NonZeroUsize::new(100).unwrap();

impl Default for IrradianceSettings {
    fn default() -> IrradianceSettings {
        IrradianceSettings {
            weighing: Weighing { accuracy: 0.15, is_smooth: true, has_gradients: true },
            ray_count: RAY_COUNT,
            noise: 0.03,
            visits: VISITS,
            records_per_step: RECORDS_PER_STEP,
            records_max: 500_000,
            clamps_neighbours: true,
            pixels_min: 4.0,
            seed: 0,
        }
    }
}

impl IrradianceSettings {
    /// With an accuracy so many times as large.
    fn rougher(self, by: f32) -> IrradianceSettings {
        let accuracy = self.weighing.accuracy * by;
        IrradianceSettings { weighing: Weighing { accuracy, ..self.weighing }, ..self }
    }

    /// Rings and sectors of a hemisphere: cells about as wide as high [Ward1992], with four rays each at most in the mean.
    fn strata(&self) -> (usize, usize) {
        let rings =
            (self.ray_count.get() as f32 / (4.0 * std::f32::consts::PI)).sqrt().round().max(2.0) as usize;
        (rings, (std::f32::consts::PI * rings as f32).round() as usize)
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
    /// Records whose radius a neighbour has made smaller.
    shrunk_count: u64,
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
        }
    }

    /// Irradiance where records count, these or rougher ones.
    fn any_irradiance(&self, p: Vec3, facing: &Facing) -> Option<Rgb> {
        self.irradiance(p, facing).or_else(|| self.rougher.as_ref()?.any_irradiance(p, facing))
    }

    /// The records, oldest first.
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// Irradiance at a point [eq. 8.1], W/m²; `None` where no record counts.
    pub fn irradiance(&self, p: Vec3, facing: &Facing) -> Option<Rgb> {
        let weighing = &self.settings.weighing;
        let mut sum = Rgb::BLACK;
        let mut weights = 0.0;
        for place in self.index.around(p) {
            let record = &self.records[place as usize];
            let weight = record.weight(p, facing, weighing);
            if weight > 0.0 {
                sum += record.irradiance_at(p, facing.normal, weighing) * weight;
                weights += weight;
            }
        }
        (weights > 0.0).then(|| sum * (1.0 / weights))
    }

    /// Takes a record in, and clamps its radius and those of its neighbours to each other.
    pub fn insert(&mut self, mut record: Record) {
        if self.settings.clamps_neighbours {
            let near: Vec<u32> = self.index.around(record.position).collect();
            let accuracy = self.settings.weighing.accuracy;
            let away = |other: &Record| other.position.distance(record.position);
            for place in &near {
                let other = &self.records[*place as usize];
                if other.normal.dot(record.normal) > 0.0 {
                    record.radius_m = record.radius_m.min(other.reach_m(accuracy) / accuracy + away(other));
                }
            }
            for place in near {
                let other = &mut self.records[place as usize];
                if other.normal.dot(record.normal) > 0.0 {
                    // Its entries in the index reach as far as before, which is too far and does no harm.
                    let radius_m = record.reach_m(accuracy) / accuracy + away(other);
                    if radius_m < other.radius_m {
                        other.radius_m = radius_m;
                        self.shrunk_count += 1;
                    }
                }
            }
        }
        self.index.insert(
            self.records.len() as u32,
            record.position,
            record.reach_m(self.settings.weighing.accuracy),
        );
        self.records.push(record);
    }

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

    fn has_caustics(&self) -> bool {
        self.base.as_ref().is_some_and(|base| base.has_caustics())
    }

    fn scattered(&self, surface: &Surface, wo: Vec3) -> ScatteredLight {
        let base =
            || self.base.as_ref().map_or_else(ScatteredLight::default, |base| base.scattered(surface, wo));
        match self.any_irradiance(surface.point.position, &Facing::of(surface, wo)) {
            Some(irradiance) => {
                let indirect = surface.bsdf.diffuse_of_even_light(surface.frame.to_local(wo)) * irradiance;
                let caustic = if self.has_caustics() { base().caustic } else { Rgb::BLACK };
                // Where records count they say more than how far each reaches.
                ScatteredLight { indirect, caustic, blur_m: 0.0 }
            }
            None => base(),
        }
    }
}

/// Accuracies, as multiples of the one asked for, for which the whole view gets its records first: a rough picture comes
/// soon, and what is made for it stays.
const ROUGHER: [f32; 3] = [4.0, 2.0, 1.0];

/// Walks over every pixel after the first at each accuracy, at most.
const WALKS_AGAIN_MAX: u32 = 4;

/// Making records for a view, on the rayon pool it is called in.
#[derive(Debug)]
pub struct IrradianceCaching {
    settings: IrradianceSettings,
    base: Option<Arc<dyn SecondaryLight>>,
    cache: IrradianceCache,
    /// Place in [`ROUGHER`].
    round: usize,
    arriving: Arc<dyn ArrivingLight>,
    walk: Option<Walk>,
    /// What `shrunk_count` was when the walk began.
    shrunk_before: u64,
    walks_again: u32,
    refining: Refining,
}

/// How far records have got after the walks.
#[derive(Clone, Debug, Default)]
struct Refining {
    /// Where they are, in their order.
    points: Vec<Seen>,
    /// All pixels of the view have records.
    is_begun: bool,
    /// Gatherings that every record holds beyond its first, and how many records hold one more.
    visits_again: u32,
    next: usize,
}

impl IrradianceCaching {
    /// No records yet.
    ///
    /// - `arriving`: what the rays of a record bring
    /// - `base`: what answers where no record counts, and for caustics
    pub fn new(
        settings: IrradianceSettings,
        arriving: Arc<dyn ArrivingLight>,
        base: Option<Arc<dyn SecondaryLight>>,
    ) -> IrradianceCaching {
        let cache = IrradianceCache::new(settings.rougher(ROUGHER[0]), base.clone());
        IrradianceCaching {
            settings,
            base,
            cache,
            round: 0,
            arriving,
            walk: None,
            shrunk_before: 0,
            walks_again: 0,
            refining: Refining::default(),
        }
    }

    /// What is to be shown: a copy of the records, for others to look things up in.
    pub fn snapshot(&self) -> Arc<dyn SecondaryLight> {
        Arc::new(self.cache.clone())
    }

    /// The records so far.
    pub fn cache(&self) -> &IrradianceCache {
        &self.cache
    }

    /// How often light was gathered so far.
    pub fn gathered_count(&self) -> u64 {
        let Refining { points, visits_again, next, .. } = &self.refining;
        (points.len() * (1 + *visits_again as usize) + next) as u64
    }

    /// Every pixel of the view was visited, or no more records fit, and all records are refined.
    pub fn is_complete(&self) -> bool {
        self.is_refining()
            && (self.refining.visits_again + 1 >= self.settings.visits.get()
                || self.refining.points.is_empty())
    }

    fn is_refining(&self) -> bool {
        self.is_full() || self.refining.is_begun
    }

    /// Gathers once more for the next records.
    fn refine_some(&mut self, world: &World) -> Counts {
        let Refining { points, visits_again, next, .. } = &mut self.refining;
        let end = points.len().min(*next + self.settings.records_per_step.get());
        let these = (&points[*next..end], &self.cache.records[*next..end]);
        let (records, counts) =
            record::refine_all(world, these, *visits_again + 1, &self.cache.settings, &*self.arriving);
        self.cache.records[*next..end].copy_from_slice(&records);
        *next = end;
        if end == points.len() {
            *next = 0;
            *visits_again += 1;
        }
        counts
    }

    fn begin_walk(&mut self) {
        self.walk = None;
        self.shrunk_before = self.cache.shrunk_count;
        self.walks_again = 0;
    }

    /// After a walk: another one over every pixel where neighbours took away what pixels were covered by that it had passed,
    /// or a finer accuracy.
    fn after_walk(&mut self, size: PictureSize) {
        if self.cache.shrunk_count > self.shrunk_before && self.walks_again < WALKS_AGAIN_MAX {
            self.walk = Some(Walk::over_all(size));
            self.shrunk_before = self.cache.shrunk_count;
            self.walks_again += 1;
        } else if self.round + 1 < ROUGHER.len() {
            self.refine();
        } else {
            self.refining.is_begun = true;
        }
    }

    /// Goes on to a finer accuracy: all records stay, and where they do not reach any more the rougher answer still counts.
    fn refine(&mut self) {
        self.round += 1;
        let settings = self.settings.rougher(ROUGHER[self.round]);
        let finer = IrradianceCache::new(settings, self.base.clone());
        let rougher = Arc::new(std::mem::replace(&mut self.cache, finer));
        rougher.records.iter().for_each(|record| self.cache.insert(*record));
        self.cache.rougher = Some(rougher);
        self.begin_walk();
    }

    fn is_full(&self) -> bool {
        self.cache.records.len() >= self.cache.settings.records_max
    }
}

impl Technique for IrradianceCaching {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        let Some(canvas) = &step.canvas else { return Progress { complete: true, ..Progress::default() } };
        if self.is_complete() {
            return Progress { complete: true, ..Progress::default() };
        }
        if step.cancel.load(Ordering::Relaxed) {
            return Progress::default();
        }
        if self.is_refining() {
            let counts = self.refine_some(step.world);
            return Progress { counts, complete: self.is_complete() };
        }
        let settings = self.cache.settings;
        let walk = self.walk.get_or_insert_with(|| Walk::over(canvas.film.size()));
        let room = settings.records_max - self.cache.records.len();
        let missing =
            walk.missing(step.world, canvas, &self.cache, settings.records_per_step.get().min(room));
        let (records, counts) = record::gather_all(step.world, &missing, &settings, &*self.arriving);
        records.into_iter().for_each(|record| self.cache.insert(record));
        self.refining.points.extend(missing);
        if self.walk.as_ref().is_some_and(Walk::is_complete) {
            self.after_walk(canvas.film.size());
        }
        Progress { counts, complete: self.is_complete() }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // Every record may have seen what changed.
        self.round = 0;
        self.cache = IrradianceCache::new(self.settings.rougher(ROUGHER[0]), self.base.clone());
        self.refining = Refining::default();
        self.begin_walk();
    }
}
