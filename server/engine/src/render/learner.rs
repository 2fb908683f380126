//! What is learnt of the light of a scene, for one picture or for all who look at it, before and while they are drawn.

mod edited;

#[cfg(feature = "gpu")]
use std::num::NonZeroUsize;
use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

use super::{
    Illumination, IlluminationSettings, Learning, Learnt, RenderSettings, Stage, ToLearn,
    learning::RoundUnderWay,
};
#[cfg(feature = "gpu")]
use crate::technique::{
    ArrivingLight, PhotonCarrier,
    path::{ArrivingByGpu, GpuGatherer},
};
use crate::{
    film::PictureSize,
    math::Rgb,
    scene::CameraView,
    technique::{
        Counts, Dimmed, Products, SecondaryLight, Step, Technique,
        irradiance::IrradianceCaching,
        path::{PathSettings, PathTracer},
    },
    transport::{LightsChange, World},
};

/// Share of the time there is that a round may take of what records of irradiance are gathered from: the rest is for them.
const GATHERED_FROM_SHARE: f64 = 0.2;
/// … or the smallest round that there is, where no other has room: with the roughest octree alone records are not worth much (Sponza's
/// nave by `auto` after 4 s 14.2 % without and 11.2 so, its gallery 24.0 and 18.2).
const GATHERED_FROM_SHARE_AT_LEAST: f64 = 0.3;
/// … and that such a round may take with passes that are drawn beside it; else it goes first. With a fifth, pictures at half
/// a second of five showed a few samples of the roughest light while the round went on: cornell-box 17.9 % for 10.8.
const GATHERED_BESIDE_SHARE: f64 = 0.5;

/// Rough records that are made before the next round of photons begins, at most, whoever looks where meanwhile …
const ROUGH_RECORDS_MAX: u64 = 300;
/// … and for each second that this round is expected to take, where a clock may decide: in Sponza they take many times as long as in a
/// box, and show no more than the octree that they are gathered from.
const ROUGH_RECORDS_SHARE: f64 = 0.4;
/// … and steps of making them, also where they find none missing because somebody looks elsewhere before each of them.
const ROUGH_STEPS_MAX: u32 = 300;

/// Records that are found missing together where a card gathers for them: a few keep no card busy.
#[cfg(feature = "gpu")]
const RECORDS_TOGETHER_ON_CARD: NonZeroUsize = NonZeroUsize::new(1_000).unwrap();

/// Light of before an edit is shown where that makes lights shine so much otherwise at most, beside what all have changed alike: it is off by less
/// than a first picture that is path-traced, small and of one sample a pixel, and for no longer than a first octree takes. Beyond, a light
/// came or went, or falls nowhere near where it fell. See [`crate::transport::change_of_lights`]. Edits count one by one: a lamp that is dragged is
/// seen by light of a moment ago for as long as that takes, and a picture that goes to and fro between that and path tracing looks worse than either.
const LIGHTS_CHANGE_MAX: f32 = 0.9;

/// Where something is known already, more photons are sent out in times as much time as there was for it.
const MUCH_MORE_TIME: f64 = 2.0;

/// Records are shown when light was gathered so many times as often for them, since somebody began to look at something else:
/// whatever is shown anew loses most of the samples it had.
const MORE: f64 = 1.4;
/// And for so many more of all records there are at least: all are copied to be shown.
const COPIED_SHARE: f64 = 0.02;

/// How much otherwise edits make the lights shine that are yet to be followed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ahead {
    /// All of them together: what is switched off and on again, or dimmed to nothing and back, is as it was.
    at_once: LightsChange,
    /// By the one that changes most: what is dragged has come far by small steps.
    step_by_step: LightsChange,
}

impl Ahead {
    /// What tells more of the light that is known.
    fn change(self) -> LightsChange {
        if self.at_once.share <= LIGHTS_CHANGE_MAX { self.at_once } else { self.step_by_step }
    }
}

/// Records that an edit left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OldRecords {
    /// None, or they hold light of now.
    None,
    /// They hold light of before, until photons and octree are those of now.
    Waiting,
    /// Light of now is being gathered for them.
    Relighting,
}

/// Photons and octree, and what is gathered from them for those who look, improved step by step and kept through edits.
#[derive(Debug)]
pub struct Learner {
    learnt: Learnt,
    settings: RenderSettings,
    of: IlluminationSettings,
    /// That there was for it; `None`: as long as it takes.
    time: Option<Duration>,
    /// `None` where no bounce is asked for that it, or records, would bring.
    illumination: Option<Illumination>,
    records: Option<IrradianceCaching>,
    /// Of the illumination that their light is gathered from.
    gathered_from: u64,
    /// Where records stand that an edit left.
    old_records: OldRecords,
    /// Who looks at what.
    gazes: HashMap<u64, (CameraView, PictureSize)>,
    known: Option<Arc<dyn SecondaryLight>>,
    generation: u64,
    /// Edits whose light is known.
    epoch: u64,
    /// What is known is of the scene before an edit, or nothing yet.
    is_stale: bool,
    /// How much otherwise the lights shine by now than those that it is of, by the edit that changed most; see [`crate::transport::change_of_lights`].
    lights_change: LightsChange,
    /// And by edits that it has yet to follow, if any.
    lights_change_ahead: Option<Ahead>,
    /// Photons and octree were not yet brought to the scene after the last edit, not even roughly.
    is_catching_up: bool,
    /// How often light was gathered for what is shown.
    shown_count: u64,
    /// Records of what is shown.
    shown_records: usize,
    /// How often light was gathered when the last gaze began.
    gaze_count: u64,
    record_seconds: f64,
    /// Of them, those of rough records between rounds of photons.
    rough_seconds: f64,
    rough_steps: u32,
    record_counts: Counts,
    /// What gathers light for records on a card.
    #[cfg(feature = "gpu")]
    gatherer: Option<Arc<GpuGatherer>>,
}

impl Learner {
    /// Nothing known yet.
    ///
    /// - `of`: photons and octree where light is looked up in the octree; records of irradiance are gathered from fewer
    pub fn new(learnt: Learnt, settings: &RenderSettings, of: IlluminationSettings) -> Learner {
        let mut of = of;
        of.irradiance.is_paced = matches!(settings.learning, Learning::Alongside { .. });
        let illumination = match learnt {
            Learnt::Octree => Some(Illumination::new(of)),
            Learnt::Records if settings.bounces_max.is_some_and(|bounces| bounces <= 1) => None,
            Learnt::Records => Some(Illumination::to_gather_from(of)),
        };
        Learner {
            learnt,
            settings: *settings,
            of,
            time: time_of(settings.learning),
            illumination,
            records: None,
            gathered_from: 0,
            old_records: OldRecords::None,
            gazes: HashMap::new(),
            known: None,
            generation: 0,
            epoch: 0,
            is_stale: true,
            lights_change: LightsChange::NONE,
            lights_change_ahead: None,
            is_catching_up: true,
            shown_count: 0,
            shown_records: 0,
            gaze_count: 0,
            record_seconds: 0.0,
            rough_seconds: 0.0,
            rough_steps: 0,
            record_counts: Counts::default(),
            #[cfg(feature = "gpu")]
            gatherer: None,
        }
    }

    /// Photons are carried from now on. Call it before the first [`Learner::step`].
    #[cfg(feature = "gpu")]
    pub(super) fn carry_by(&mut self, carrier: Arc<dyn PhotonCarrier>) {
        self.illumination.iter_mut().for_each(|of| of.carry_by(Arc::clone(&carrier)));
    }

    /// Gathers the light of records to come on a card, and more of them together. Call it before the first [`Learner::step`].
    #[cfg(feature = "gpu")]
    pub(super) fn gather_on(&mut self, gatherer: Arc<GpuGatherer>) {
        let together = &mut self.of.irradiance.records_per_batch;
        *together = (*together).max(RECORDS_TOGETHER_ON_CARD);
        self.gatherer = Some(gatherer);
    }

    /// It may take so many seconds from now on: what would not be known by then is not begun.
    pub(super) fn allow(&mut self, seconds: f64) {
        let shares = match self.learnt {
            Learnt::Octree => [1.0, 1.0],
            Learnt::Records => [GATHERED_FROM_SHARE, GATHERED_FROM_SHARE_AT_LEAST],
        };
        let [allowed, for_the_smallest] = shares.map(|share| share * seconds);
        self.illumination.iter_mut().for_each(|illumination| illumination.allow(allowed, for_the_smallest));
    }

    /// Goes on for others than those it learnt for before, in the time that they have. What it left out to end in time is made up for where
    /// they have much more of it; else they would have the same once more, and what is gathered from it would be gathered anew.
    pub fn go_on_for(&mut self, learning: Learning) {
        self.settings.learning = learning;
        let time = time_of(learning);
        let has_more = match (time, self.time) {
            (Some(time), Some(before)) => time > before.mul_f64(MUCH_MORE_TIME),
            (Some(_), None) => false,
            // Also of what those before were allowed who came after all was known.
            (None, _) => true,
        };
        let Some(illumination) = &mut self.illumination else { return };
        if has_more {
            illumination.take_its_time();
        }
        if has_more || illumination.stage() != Stage::Complete {
            self.time = time;
        }
    }

    /// Photons that what is known was made of, and records: of two learners of one scene the one with more, in this order, knows better.
    pub fn knowledge(&self) -> [u64; 2] {
        let photons = self.illumination.as_ref().map_or(0, Illumination::known_photons);
        [photons, self.shown_records as u64]
    }

    /// Share of the time there is by whose end photons and octree must be known, with what is drawn beside them.
    pub(super) fn time_share(&self) -> f64 {
        match self.learnt {
            Learnt::Octree => 1.0,
            Learnt::Records => GATHERED_BESIDE_SHARE,
        }
    }

    /// The round of photons that is under way, if it is to be foreseen when it ends.
    pub(super) fn round(&self) -> Option<RoundUnderWay> {
        let illumination = self.illumination.as_ref()?;
        let seconds_left = illumination.seconds_left_of_round()?;
        let is_followed = illumination.is_before_last_round();
        // Records are gathered from octrees long before the time is over, and are worth little without.
        let is_shown = self.learnt == Learnt::Octree;
        let seconds_left_of_octree = is_shown.then(|| illumination.seconds_left_of_octree()).flatten();
        let name = illumination.round_name();
        Some(RoundUnderWay { name, seconds_left, seconds_left_of_octree, is_followed })
    }

    /// A round of photons is over, and the next not begun.
    pub(super) fn is_between_rounds(&self) -> bool {
        self.illumination.as_ref().is_some_and(Illumination::is_between_rounds)
            && !self.gathers_between_rounds()
    }

    /// Rough records are due before the next round of photons: they take the mean over hundreds of places, and mostly show what a rough
    /// octree knows better than it does. Where all is learnt first nobody would see them, and where a picture is wanted at a moment they
    /// take from it (at 2 of 5 s two-rooms B had 7.8 % with them for 4.7; at half a second 15 for 24).
    fn gathers_between_rounds(&self) -> bool {
        let shows_them =
            matches!(self.settings.learning, Learning::InStep | Learning::Alongside { until: None });
        if self.learnt != Learnt::Records || !shows_them {
            return false;
        }
        let Some(seconds) = self.illumination.as_ref().and_then(Illumination::seconds_of_next_round) else {
            return false;
        };
        let has_time = !self.of.irradiance.is_paced || self.rough_seconds < ROUGH_RECORDS_SHARE * seconds;
        has_time
            && self.rough_steps < ROUGH_STEPS_MAX
            && self.records.as_ref().is_none_or(|records| records.lacks_rough(ROUGH_RECORDS_MAX))
    }

    /// Ends the round that is under way: what is known by now is all that there will be.
    pub(super) fn abandon_round(&mut self) {
        self.illumination.iter_mut().for_each(Illumination::abandon_round);
    }

    /// More would be known with more time.
    pub(super) fn is_cut(&self) -> bool {
        self.illumination.as_ref().is_some_and(Illumination::is_cut)
    }

    /// Somebody looks at something, in place of what was looked at by this name before.
    pub fn look(&mut self, key: u64, camera: &CameraView, size: PictureSize) {
        self.gazes.insert(key, (*camera, size));
        let Some(records) = &mut self.records else { return };
        if records.look(key, camera, size) {
            self.gaze_count = records.gathered_count();
        }
    }

    /// Forgets who looks no more.
    pub fn look_away(&mut self, is_kept: impl Fn(u64) -> bool) {
        self.gazes.retain(|key, _| is_kept(*key));
        if let Some(records) = &mut self.records {
            records.look_away(is_kept);
        }
    }

    /// Of records of irradiance.
    pub fn accuracy(&self) -> f32 {
        self.of.irradiance.weighing.accuracy
    }

    /// Records of irradiance count as far as this accuracy says from now on; see [`IrradianceCaching::set_accuracy`].
    pub fn set_accuracy(&mut self, accuracy: f32) {
        let of = &mut self.of.irradiance.weighing.accuracy;
        if std::mem::replace(of, accuracy) == accuracy {
            return;
        }
        let Some(records) = &mut self.records else { return };
        records.set_accuracy(accuracy);
        if self.shown_records > 0 {
            self.show_records();
            self.gaze_count = self.shown_count;
        }
    }

    /// How far it has got, for all who look.
    pub fn stage(&self) -> Stage {
        let Some(illumination) = &self.illumination else { return Stage::Complete };
        if self.learnt != Learnt::Records || illumination.stage() != Stage::Complete {
            return illumination.stage();
        }
        match &self.records {
            Some(records) if records.is_complete() => Stage::Complete,
            _ => Stage::Rough,
        }
    }

    /// What is still to be learnt, for all who look.
    pub fn to_learn(&self) -> ToLearn {
        match &self.illumination {
            Some(illumination) if illumination.stage() != Stage::Complete => ToLearn::Rounds,
            _ if self.stage() != Stage::Complete => ToLearn::Records,
            _ => ToLearn::Nothing,
        }
    }

    /// One bounded piece of work on the rayon pool it is called in; true when [`Learner::known`] has become better.
    pub fn step(&mut self, world: &World, cancel: &AtomicBool) -> bool {
        if self.stage() == Stage::Complete {
            return false;
        }
        let gathers = self.gathers_between_rounds();
        if let Some(illumination) =
            self.illumination.as_mut().filter(|base| base.stage() != Stage::Complete && !gathers)
        {
            let is_better = illumination.step(world, cancel);
            if is_better {
                let known = illumination.known().cloned();
                match &mut self.records {
                    Some(records) => {
                        records.stand_on(known);
                        self.show_records();
                    }
                    None => {
                        self.known = known;
                        self.generation += 1;
                    }
                }
                // With old records among it what is known is of both scenes.
                if self.old_records == OldRecords::None {
                    self.epoch += u64::from(std::mem::take(&mut self.is_stale));
                }
                self.lights_change = LightsChange::NONE;
                self.is_catching_up = false;
            }
            return is_better;
        }
        let start = Instant::now();
        self.light_records();
        let Some(records) = &mut self.records else { return false };
        let mut step = Step { world, products: &mut Products::default(), canvas: None, cancel };
        let progress = records.step(&mut step);
        self.record_counts += progress.counts;
        let seconds = start.elapsed().as_secs_f64();
        self.record_seconds += seconds;
        if gathers {
            self.rough_seconds += seconds;
            self.rough_steps += 1;
        }
        if records.is_relighting() {
            return false;
        }
        if self.old_records != OldRecords::None {
            self.old_records = OldRecords::None;
            self.epoch += u64::from(std::mem::take(&mut self.is_stale));
            return self.shows_all();
        }
        let fresh = (records.gathered_count() - self.shown_count) as f64;
        let for_gaze = self.shown_count.saturating_sub(self.gaze_count) as f64;
        let count = records.cache().records().len();
        // A copy of all for a few is not worth its time, and few in place of many not worth showing.
        let has_many = fresh >= (MORE - 1.0) * for_gaze
            && fresh >= COPIED_SHARE * count as f64
            && 2 * count >= self.shown_records;
        // Nothing comes of the records until the next round is over.
        let is_last_for_now = gathers && !self.gathers_between_rounds();
        (progress.complete || has_many || is_last_for_now) && self.shows_all()
    }

    /// Begins records, or has light gathered anew for those that an edit left, or that were gathered from a rougher octree.
    fn light_records(&mut self) {
        let Some(illumination) = &self.illumination else { return };
        let is_rough = illumination.stage() != Stage::Complete;
        let waits = self.old_records == OldRecords::Waiting;
        // With a bound on scatterings nothing of it is in records.
        let is_better =
            illumination.generation() != self.gathered_from && self.settings.bounces_max.is_none();
        if let Some(records) = self.records.as_mut().filter(|_| is_rough || !(waits || is_better)) {
            if !is_rough {
                records.settle();
            }
            return;
        }
        self.gathered_from = illumination.generation();
        let known = illumination.known().cloned();
        let (tracer, base) = tracer_of_records(&self.settings, known);
        let tracer = tracer.guided_by(base.clone());
        #[cfg(feature = "gpu")]
        let arriving: Arc<dyn ArrivingLight> = match &self.gatherer {
            Some(gatherer) => Arc::new(ArrivingByGpu::new(tracer, Arc::clone(gatherer))),
            None => Arc::new(tracer),
        };
        #[cfg(not(feature = "gpu"))]
        let arriving = Arc::new(tracer);
        if let Some(records) = &mut self.records {
            if waits {
                records.relight(arriving, base);
                self.old_records = OldRecords::Relighting;
            } else {
                records.gather_better(arriving, base);
            }
            return;
        }
        let mut records = IrradianceCaching::new(self.of.irradiance, arriving, base);
        if is_rough {
            records.expect_better();
        }
        // In an order that does not depend on the map.
        let mut gazes: Vec<_> = self.gazes.iter().collect();
        gazes.sort_unstable_by_key(|(key, _)| **key);
        gazes.into_iter().for_each(|(key, (camera, size))| {
            records.look(*key, camera, *size);
        });
        self.records = Some(records);
    }

    /// Lets [`Learner::known`] hold all records made so far; true when it is more than it had.
    pub(super) fn shows_all(&mut self) -> bool {
        let is_more =
            self.records.as_ref().is_some_and(|records| records.gathered_count() > self.shown_count);
        if is_more {
            self.show_records();
        }
        is_more
    }

    /// Lets [`Learner::known`] hold the records as they are.
    fn show_records(&mut self) {
        let Some(records) = &self.records else { return };
        self.known = Some(records.snapshot());
        self.generation += 1;
        (self.shown_count, self.shown_records) = (records.gathered_count(), records.cache().records().len());
    }

    /// What is known of the light by now.
    pub fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.known.as_ref()
    }

    /// What is known is of a scene before an edit whose lights shone much otherwise: all of it is wrong, not only what is near the
    /// edit. That of a lamp that was moved or dimmed a little is nearly right.
    pub fn knows_other_lights(&self) -> bool {
        self.lights_change_by_now().share > LIGHTS_CHANGE_MAX
    }

    /// With edits that it has yet to follow.
    fn lights_change_by_now(&self) -> LightsChange {
        self.lights_change_ahead.map_or(self.lights_change, |ahead| self.lights_change.then(ahead.change()))
    }

    /// What is known of the light, as far as that goes of the scene with all its edits: where all its lights have changed alike, times as
    /// much, which is right; as it was where they are others, such as one that went and came again.
    pub fn known_by_now(&self) -> Option<Arc<dyn SecondaryLight>> {
        let dimmed = match self.knows_other_lights() {
            true => Rgb::WHITE,
            false => self.lights_change_by_now().dimmed,
        };
        self.known.clone().map(|known| Dimmed::by(dimmed, known))
    }

    /// What is known is of the scene after the last edit that it was told of.
    pub fn knows_light_of_now(&self) -> bool {
        self.known.is_some() && !self.is_stale
    }

    /// Counts up whenever [`Learner::known`] becomes another.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Counts up when [`Learner::known`] becomes that of another scene, some time after an edit.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Photons and octree.
    pub fn illumination(&self) -> Option<&Illumination> {
        self.illumination.as_ref()
    }

    /// Rays traced so far.
    pub fn counts(&self) -> Counts {
        self.illumination.as_ref().map(Illumination::counts).unwrap_or_default() + self.record_counts
    }

    /// What makes records, once it has begun.
    #[cfg(test)]
    pub(super) fn caching(&self) -> Option<&IrradianceCaching> {
        self.records.as_ref()
    }

    /// Memory of photons, octree and records, with those that are shown.
    pub fn bytes(&self) -> usize {
        let illumination = self.illumination.as_ref().map(Illumination::report).unwrap_or_default();
        let records = self.records.as_ref().map_or(0, |records| records.bytes() + records.cache().bytes());
        illumination.photon_bytes + illumination.octree_bytes + records
    }

    /// What records took and hold.
    pub fn records(&self) -> RecordReport {
        let records = self.records.as_ref();
        RecordReport {
            seconds: self.record_seconds,
            count: records.map_or(0, |records| records.cache().records().len() as u64),
            bytes: records.map_or(0, IrradianceCaching::bytes),
        }
    }
}

/// Time from now on for learning so; `None`: as long as it takes.
fn time_of(learning: Learning) -> Option<Duration> {
    match learning {
        Learning::Alongside { until } => until.map(|moment| moment.saturating_duration_since(Instant::now())),
        Learning::First | Learning::InStep => None,
    }
}

/// What records of irradiance took and hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecordReport {
    /// Seconds of finding where they are missing and of gathering them.
    pub seconds: f64,
    /// How many there are.
    pub count: u64,
    /// Bytes of records, their index and what edits ask of them.
    pub bytes: usize,
}

/// What answers for the rays of records: direct light and what is known of the rest. With a bound on scatterings they are traced
/// to the end instead: photons know only what reaches a surface by all of the scatterings asked for, one more than is left there.
pub(super) fn tracer_of_records(
    settings: &RenderSettings,
    base: Option<Arc<dyn SecondaryLight>>,
) -> (PathTracer, Option<Arc<dyn SecondaryLight>>) {
    let bounces_max = settings.bounces_max.map(|bounces| bounces.saturating_sub(1));
    let path = PathSettings { knows_openings: true, ..PathSettings::all(bounces_max, settings.seed) };
    let tracer = match base.clone().filter(|_| bounces_max.is_none()) {
        Some(base) => PathTracer::with_secondary(path, base),
        None => PathTracer::new(path),
    };
    (tracer, base)
}
