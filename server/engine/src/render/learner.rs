//! What a picture that is drawn by itself learns of the light before and while it is drawn.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{Illumination, IlluminationSettings, Indirect, RenderSettings, Stage};
use crate::{
    technique::{
        Canvas, Counts, Products, SecondaryLight, Step, Technique,
        irradiance::{IrradianceCaching, IrradianceSettings},
        path::{PathClasses, PathSettings, PathTracer},
    },
    transport::World,
};

/// Photons of other techniques for each that records of irradiance are gathered from: a record takes the mean over hundreds
/// of places.
const PHOTON_DIVISOR: u32 = 4;

/// Records are shown when light was gathered so many times as often for them: whatever is shown anew loses most of the samples
/// it had.
const MORE: f64 = 1.4;

/// Photons and octree, and what is gathered from them.
#[derive(Debug)]
pub(super) struct Learner {
    settings: RenderSettings,
    /// `None` where no bounce is asked for that it, or records, would bring.
    illumination: Option<Illumination>,
    records: Option<IrradianceCaching>,
    known: Option<Arc<dyn SecondaryLight>>,
    /// How often light was gathered for what is shown.
    shown_count: u64,
    record_seconds: f64,
    record_counts: Counts,
}

impl Learner {
    /// `None` for techniques that learn nothing.
    pub(super) fn new(settings: &RenderSettings) -> Option<Learner> {
        let illumination = match settings.indirect {
            Indirect::Octree => Some(IlluminationSettings::of(settings)),
            Indirect::Irradiance if settings.bounces_max.is_some_and(|bounces| bounces <= 1) => None,
            Indirect::Irradiance => {
                let mut of = IlluminationSettings::of(settings);
                of.photons.emitted_count /= PHOTON_DIVISOR;
                of.octree.photon_count /= PHOTON_DIVISOR;
                Some(of)
            }
            Indirect::Auto | Indirect::Path | Indirect::None => return None,
        };
        Some(Learner {
            settings: *settings,
            illumination: illumination.map(Illumination::new),
            records: None,
            known: None,
            shown_count: 0,
            record_seconds: 0.0,
            record_counts: Counts::default(),
        })
    }

    pub(super) fn stage(&self) -> Stage {
        let Some(illumination) = &self.illumination else { return Stage::Complete };
        if self.settings.indirect != Indirect::Irradiance || illumination.stage() != Stage::Complete {
            return illumination.stage();
        }
        match &self.records {
            Some(records) if records.is_complete() => Stage::Complete,
            _ => Stage::Rough,
        }
    }

    /// One bounded piece of work on the rayon pool it is called in; true when [`Learner::known`] has become better.
    pub(super) fn step(&mut self, world: &World, canvas: Canvas<'_>, cancel: &AtomicBool) -> bool {
        if let Some(illumination) = self.illumination.as_mut().filter(|base| base.stage() != Stage::Complete)
        {
            let is_better = illumination.step(world, cancel);
            self.known = illumination.known().cloned();
            return is_better;
        }
        let start = Instant::now();
        let records = self.records.get_or_insert_with(|| records_over(&self.settings, self.known.clone()));
        let mut step = Step { world, products: &mut Products::default(), canvas: Some(canvas), cancel };
        let progress = records.step(&mut step);
        self.record_counts += progress.counts;
        self.record_seconds += start.elapsed().as_secs_f64();
        let has_many = records.gathered_count() as f64 >= MORE * self.shown_count.max(1) as f64;
        (progress.complete || has_many) && self.shows_all()
    }

    /// Lets [`Learner::known`] hold all records made so far; true when it is more than it had.
    pub(super) fn shows_all(&mut self) -> bool {
        let Some(records) = &self.records else { return false };
        let count = records.gathered_count();
        let is_more = count > self.shown_count;
        if is_more {
            self.known = Some(records.snapshot());
            self.shown_count = count;
        }
        is_more
    }

    pub(super) fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.known.as_ref()
    }

    pub(super) fn illumination(&self) -> Option<&Illumination> {
        self.illumination.as_ref()
    }

    pub(super) fn counts(&self) -> Counts {
        self.illumination.as_ref().map(Illumination::counts).unwrap_or_default() + self.record_counts
    }

    pub(super) fn records(&self) -> RecordReport {
        let cache = self.records.as_ref().map(IrradianceCaching::cache);
        RecordReport {
            seconds: self.record_seconds,
            count: cache.map_or(0, |cache| cache.records().len() as u64),
            bytes: cache.map_or(0, |cache| cache.bytes()),
        }
    }
}

/// What records of irradiance took and hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordReport {
    /// Seconds of finding where they are missing and of gathering them.
    pub seconds: f64,
    /// How many there are.
    pub count: u64,
    /// Bytes of records and their index.
    pub bytes: usize,
}

/// Records gathered from direct light and what is known of the rest. With a bound on scatterings their rays are traced to the
/// end instead: photons know only what reaches a surface by all of the scatterings asked for, one more than is left there.
fn records_over(settings: &RenderSettings, base: Option<Arc<dyn SecondaryLight>>) -> IrradianceCaching {
    let bounces_max = settings.bounces_max.map(|bounces| bounces - 1);
    let path = PathSettings { classes: PathClasses::All, bounces_max, seed: settings.seed };
    let arriving = match base.clone().filter(|_| bounces_max.is_none()) {
        Some(base) => PathTracer::with_secondary(path, base),
        None => PathTracer::new(path),
    };
    let of = IrradianceSettings { seed: settings.seed, ..IrradianceSettings::default() };
    IrradianceCaching::new(of, Arc::new(arriving), base)
}
