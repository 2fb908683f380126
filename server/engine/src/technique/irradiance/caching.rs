//! Making records for those who look, on the rayon pool it is called in.
//!
//! Every view that is looked through is walked until all its pixels are covered, first for a rough answer, then for finer
//! ones; then light is gathered again for all records, and again while they are noisy ([`super::Visits`]). An edit drops those
//! whose rays met what it touched (`sight.rs`); light is gathered anew for the others before anything else is done (`relighting.rs`).

mod gaze;
mod relighting;
#[cfg(test)]
pub(super) mod tests;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use self::gaze::Gaze;
use super::{
    ArrivingLight, CARD, Card, Counts, IrradianceCache, IrradianceSettings, Record, SecondaryLight, View,
    Visits,
    record::{Extent, GatherBy, Gathered},
    sight::Sight,
    steadied::steady,
    visits::{Visited, noise_of},
    walk::Seen,
};
use crate::{
    film::PictureSize,
    math::Rgb,
    scene::CameraView,
    technique::{Edit, Progress, Step, Technique},
    transport::World,
};

/// How far records count for the first view, as multiples of what is asked for: a rough picture comes soon, and what is made
/// for it stays. Later views find the last of them.
const ROUNDS: [f32; 3] = [4.0, 2.0, 1.0];

/// Walks over every pixel after the first in the last round, at most.
const WALKS_AGAIN_MAX: u32 = 4;

/// Time of making records in one step, about.
const STEP_SECONDS: f64 = 0.01;
/// Records made in one step where no clock may decide.
const STEP_RECORDS: usize = 32;
/// Records that are found missing together at first, where more may be: twice as many with every batch. Nothing shows of a batch that is
/// not complete, and a slow card takes seconds for a thousand.
const FIRST_BATCH: usize = 100;

/// Making records for views.
#[derive(Debug)]
pub struct IrradianceCaching {
    settings: IrradianceSettings,
    base: Option<Arc<dyn SecondaryLight>>,
    cache: IrradianceCache,
    /// Place in [`ROUNDS`].
    round: usize,
    arriving: Arc<dyn ArrivingLight>,
    gazes: Vec<Gaze>,
    /// Whose turn it is among them.
    turn: usize,
    /// Records of a view that are being made.
    batch: Option<Batch>,
    /// Records of the next batch at most, as far as so many may be found together.
    next_batch: usize,
    /// Where the records are, in their order.
    places: Vec<Place>,
    /// Those that an edit left, with light of now, as far as it is gathered; `None` where all light is of now.
    relit: Option<IrradianceCache>,
    refining: Refining,
    /// The first so many places have the visits that they need, or as many as they may have: what comes later adds none to them, and is not
    /// taken for known because they are.
    settled: usize,
    /// Light is gathered from what will soon be known better: rough records are all that is made.
    is_preliminary: bool,
    gathered_count: u64,
    /// Of the newest.
    seconds_per_record: Option<f64>,
    /// What is looked at has changed since all records were dropped.
    may_drop: bool,
}

/// Where a record is.
#[derive(Debug)]
struct Place {
    seen: Seen,
    /// What its rays may have met.
    sight: Sight,
    /// How far it counts by itself, before neighbours make it count less far.
    extent: Extent,
    visited: Visited,
    /// Of the mean irradiance of the channels as the first of its visits tells it, W/m².
    deviation: f32,
}

impl Place {
    /// Of the mean irradiance of the channels, (W/m²)²: as visits tell it where there were several.
    fn variance(&self) -> f64 {
        if self.visited.count > 1 { self.visited.variance() } else { f64::from(self.deviation).powi(2) }
    }
}

/// Records that are found missing together and taken in together, so that they do not depend on how many are made in one step.
#[derive(Debug)]
struct Batch {
    /// Of whose view.
    key: u64,
    places: Vec<Seen>,
    /// Of the first of them.
    gathered: Vec<Gathered>,
}

/// Records whose light was gathered so many times are gathered for again, from a place on.
#[derive(Clone, Copy, Debug)]
struct Refining {
    visits: u32,
    next: usize,
}

impl Refining {
    const BEGIN: Refining = Refining { visits: 1, next: 0 };
}

impl IrradianceCaching {
    /// No records yet, and nobody who looks.
    ///
    /// - `arriving`: what the rays of a record bring
    /// - `base`: what answers where no record counts, and for caustics
    pub fn new(
        settings: IrradianceSettings,
        arriving: Arc<dyn ArrivingLight>,
        base: Option<Arc<dyn SecondaryLight>>,
    ) -> IrradianceCaching {
        let cache = IrradianceCache::new(settings.rougher(ROUNDS[0]), base.clone());
        IrradianceCaching {
            settings,
            base,
            cache,
            round: 0,
            arriving,
            gazes: Vec::new(),
            turn: 0,
            batch: None,
            next_batch: FIRST_BATCH,
            places: Vec::new(),
            relit: None,
            refining: Refining::BEGIN,
            settled: 0,
            is_preliminary: false,
            gathered_count: 0,
            seconds_per_record: None,
            may_drop: false,
        }
    }

    /// Makes rough records alone, until [`IrradianceCaching::gather_better`] or [`IrradianceCaching::settle`]: what light is gathered
    /// from will be known better soon.
    pub fn expect_better(&mut self) {
        self.is_preliminary = true;
    }

    /// The same light is known better from now on. Records count as far as they did, and show what was gathered for them until it is
    /// gathered anew, record by record, before finer ones are made.
    pub fn gather_better(&mut self, arriving: Arc<dyn ArrivingLight>, base: Option<Arc<dyn SecondaryLight>>) {
        self.arriving = arriving;
        self.stand_on(base);
        self.batch = None;
        self.places.iter_mut().for_each(|place| place.visited = Visited::NEVER);
        self.settled = 0;
        // Their light would stay as it is.
        self.cache.rougher = None;
        self.refining = Refining { visits: 0, next: 0 };
        self.settle();
    }

    /// What light is gathered from is as good as it gets: finer records follow.
    pub fn settle(&mut self) {
        if std::mem::take(&mut self.is_preliminary) {
            self.begin_walks();
        }
    }

    /// Records count as far as this accuracy says from now on, a of [Ward1988]. Light is gathered anew for none: they are weighed
    /// otherwise, and where they reach less far, more are made between them. Until then the same records answer there as far as they
    /// counted, so that no pixel that was covered loses its light, however often accuracy changes; the base does where light is just
    /// being gathered anew after an edit.
    pub fn set_accuracy(&mut self, accuracy: f32) {
        if self.settings.weighing.accuracy == accuracy {
            return;
        }
        self.settings.weighing.accuracy = accuracy;
        let mut rougher = self.as_far_as_ever();
        self.steady(&mut rougher);
        let settings = self.settings.rougher(ROUNDS[self.round]);
        self.relit = self.relit.take().map(|relit| self.weighed(&relit, settings));
        self.cache = self.weighed(&self.cache, settings);
        self.cache.rougher = Some(Arc::new(rougher));
        self.begin_walks();
    }

    /// The records, each with a reach no shorter than it has here or in any of the caches that answer after this one.
    fn as_far_as_ever(&self) -> IrradianceCache {
        let covers_all = self.gazes.iter().all(|gaze| gaze.is_covered);
        let behind = std::iter::successors(self.cache.rougher.as_ref(), |cache| cache.rougher.as_ref());
        let mut settings = IrradianceSettings { clamps_neighbours: false, ..self.cache.settings };
        for behind in behind.filter(|_| !covers_all) {
            settings.weighing.accuracy = settings.weighing.accuracy.max(behind.settings.weighing.accuracy);
            settings.pixels_min = settings.pixels_min.max(behind.settings.pixels_min);
        }
        self.weighed(&self.cache, settings)
    }

    /// The records of a cache as they count by other settings.
    fn weighed(&self, of: &IrradianceCache, settings: IrradianceSettings) -> IrradianceCache {
        let mut cache = IrradianceCache::new(settings, self.base.clone());
        for (record, place) in of.records.iter().zip(&self.places) {
            let reach_min_m = settings.reach_min_m(place.seen.pixel_m, place.extent.all_gone_m);
            cache.insert(Record { radius_m: place.extent.radius_m, reach_min_m, ..*record });
        }
        cache
    }

    /// Rough records are missing for what somebody looks at, and not so many were made yet.
    pub fn lacks_rough(&self, count: u64) -> bool {
        self.is_preliminary && self.gathered_count < count && self.next_gaze().is_some()
    }

    /// Wants records for what `camera` sees, in place of what was looked at by this name before. True if that was another.
    pub fn look(&mut self, key: u64, camera: &CameraView, size: PictureSize) -> bool {
        let shrunk_before = self.cache.shrunk_count;
        match self.gazes.iter_mut().find(|gaze| gaze.key == key) {
            Some(gaze) if gaze.camera == *camera && gaze.size == size => return false,
            Some(gaze) => {
                (gaze.camera, gaze.size) = (*camera, size);
                gaze.begin(shrunk_before);
            }
            None => self.gazes.push(Gaze::new(key, camera, size, shrunk_before)),
        }
        self.may_drop = !self.places.is_empty();
        // What is made for it may take pixels from others as often again.
        self.gazes.iter_mut().for_each(|gaze| gaze.walks_again = 0);
        true
    }

    /// Forgets who looks no more; records stay.
    pub fn look_away(&mut self, is_kept: impl Fn(u64) -> bool) {
        self.gazes.retain(|gaze| is_kept(gaze.key));
    }

    /// What is to be shown: a copy of the records, for others to look things up in, with what they surely know better than what answers where
    /// there are none.
    pub fn snapshot(&self) -> Arc<dyn SecondaryLight> {
        let mut shown = self.cache.clone();
        let shares = self.steady(&mut shown);
        let known = self.visited().zip(shares).filter(|((visited, _), _)| visited.count > 1);
        shown.noise =
            noise_of(known.map(|((visited, irradiance), share)| (visited.shown(share), irradiance)));
        Arc::new(shown)
    }

    /// Lets the records of a cache, which are the first of all, show what they surely know better than what answers where there are none;
    /// returns the share of what was gathered that each shows.
    fn steady(&self, cache: &mut IrradianceCache) -> Vec<f32> {
        let Some(base) = &self.base else { return vec![1.0; cache.records.len()] };
        let accuracy = cache.settings.weighing.accuracy;
        let variances: Vec<f64> = self.places.iter().map(Place::variance).collect();
        steady(&mut cache.records, &variances, accuracy, &**base)
    }

    /// Something else answers where no record counts.
    pub fn stand_on(&mut self, base: Option<Arc<dyn SecondaryLight>>) {
        self.cache.base = base.clone();
        self.relit.iter_mut().for_each(|relit| relit.base = base.clone());
        self.base = base;
    }

    /// The records so far.
    pub fn cache(&self) -> &IrradianceCache {
        &self.cache
    }

    /// Records at the same places of a scene, gathered for as often and taken in one after the other, and the variance of each, (W/m²)².
    #[cfg(test)]
    pub(crate) fn afresh(&self, world: &World) -> (IrradianceCache, Vec<f64>) {
        let never = AtomicBool::new(false);
        let by = self.gather_by(world, &never);
        let afresh = |place: &Place| {
            let points = [place.seen];
            let Gathered { mut record, extent, sight, deviation } = by.gather_all(&points).unwrap().0[0];
            let mut visited = Visited::ONCE;
            for visit in 1..place.visited.count {
                let before = record.irradiance;
                record = by.refine_all((&points, &[record]), visit).unwrap().0[0].record;
                visited = visited.again(before, record.irradiance);
            }
            (record, Place { seen: place.seen, sight, extent, visited, deviation }.variance())
        };
        let mut cache = IrradianceCache::new(self.cache.settings, None);
        let variances = self.places.iter().map(|place| {
            let (record, variance) = afresh(place);
            cache.insert(record);
            variance
        });
        let variances = variances.collect();
        (cache, variances)
    }

    /// Variance of each record, (W/m²)².
    #[cfg(test)]
    pub(crate) fn variances(&self) -> Vec<f64> {
        self.places.iter().map(Place::variance).collect()
    }

    /// The points of the records.
    #[cfg(test)]
    pub(crate) fn points(&self) -> impl Iterator<Item = &crate::accel::SurfacePoint> {
        self.places.iter().map(|place| &place.seen.point)
    }

    /// Memory of records, where they are and what their rays saw.
    pub fn bytes(&self) -> usize {
        self.cache.bytes() + self.places.len() * size_of::<Place>()
    }

    /// How often light was gathered so far, for records that are there and for others.
    pub fn gathered_count(&self) -> u64 {
        self.gathered_count
    }

    /// Every pixel that somebody looks at has records, or no more fit, and all are refined.
    pub fn is_complete(&self) -> bool {
        self.relit.is_none()
            && !self.is_preliminary
            && self.next_gaze().is_none()
            && self.refining.visits >= self.visits_max()
    }

    /// Whose pixels lack records, beginning with whose turn it is.
    fn next_gaze(&self) -> Option<usize> {
        let count = self.gazes.len();
        let mut order = (0..count).map(|offset| (self.turn + offset) % count);
        let has_room = !self.is_full() || self.may_drop;
        order.find(|index| has_room && !self.gazes[*index].is_covered)
    }

    fn is_full(&self) -> bool {
        self.cache.records.len() >= self.settings.records_max
    }

    /// Makes some of the records that a view lacks.
    fn cover_some(&mut self, index: usize, step: &Step<'_>) -> Counts {
        let start = Instant::now();
        let room = self.settings.records_max - self.cache.records.len();
        let count_max = self.settings.records_per_batch.get().min(self.next_batch).min(room.max(1));
        let gaze = &mut self.gazes[index];
        let mut batch = self.batch.take().unwrap_or_else(|| {
            let view = View::new(step.world, &gaze.camera, gaze.size);
            let places = gaze.walk.missing(step.world, &view, &self.cache, count_max);
            Batch { key: gaze.key, places, gathered: Vec::new() }
        });
        if batch.places.len() > room {
            self.drop_all();
            return Counts::default();
        }
        let first = batch.gathered.len();
        let by = self.gather_by(step.world, step.cancel);
        let end = batch.places.len().min(first + self.records_per_step(by));
        let Some((gathered, counts)) = by.gather_all(&batch.places[first..end]) else {
            self.batch = Some(batch);
            return Counts::default();
        };
        self.take_pace(gathered.len(), start);
        batch.gathered.extend(gathered);
        if end < batch.places.len() {
            self.batch = Some(batch);
            return counts;
        }
        if !batch.gathered.is_empty() {
            self.refining = Refining::BEGIN;
        }
        if batch.gathered.len() >= self.next_batch {
            self.next_batch =
                (2 * self.next_batch).min(self.settings.records_per_batch.get().max(FIRST_BATCH));
        }
        self.gathered_count += batch.gathered.len() as u64;
        for (seen, gathered) in batch.places.into_iter().zip(batch.gathered) {
            let Gathered { record, extent, sight, deviation } = gathered;
            self.cache.insert(record);
            self.places.push(Place { seen, sight, extent, visited: Visited::ONCE, deviation });
        }
        // Who looked away, or elsewhere, has no walk that this ends.
        let looking = self.gazes.iter().position(|gaze| gaze.key == batch.key);
        if let Some(index) = looking.filter(|index| self.gazes[*index].walk.is_complete()) {
            self.after_walk(index);
        }
        self.turn = index + 1;
        counts
    }

    fn gather_by<'a>(&'a self, world: &'a World, cancel: &'a AtomicBool) -> GatherBy<'a> {
        GatherBy { world, settings: &self.cache.settings, arriving: &*self.arriving, cancel }
    }

    /// Records made in one step, so that whoever moves gets pictures in between. What they become does not depend on it.
    fn records_per_step(&self, by: GatherBy<'_>) -> usize {
        // Cards take many or are slow, and say themselves how many go in some 10 ms.
        if by.points_at_once() > 1 {
            return by.points_at_once();
        }
        if !self.settings.is_paced {
            return STEP_RECORDS;
        }
        let threads = rayon::current_num_threads();
        let fitting = self.seconds_per_record.map_or(0.0, |seconds| STEP_SECONDS / seconds.max(1e-6));
        (fitting as usize).clamp(threads, 64 * threads)
    }

    /// Takes note of how long some records took.
    fn take_pace(&mut self, count: usize, start: Instant) {
        if count > 0 {
            self.seconds_per_record = Some(start.elapsed().as_secs_f64() / count as f64);
        }
    }

    /// After a walk: another one over every pixel where neighbours took away what pixels were covered by that it had passed,
    /// or the next round.
    fn after_walk(&mut self, index: usize) {
        let gaze = &mut self.gazes[index];
        if self.is_preliminary {
            gaze.is_covered = true;
            return;
        }
        let is_last_round = self.round + 1 == ROUNDS.len();
        let has_lost = self.cache.shrunk_count > gaze.shrunk_before;
        if is_last_round && has_lost && gaze.walks_again < WALKS_AGAIN_MAX {
            gaze.walk_again(self.cache.shrunk_count);
        } else if !is_last_round {
            self.go_finer();
        } else {
            gaze.is_covered = true;
            self.look_again_at_what_shrank();
        }
    }

    /// Others whose pixels were covered look again where the records that were made here count less far now.
    fn look_again_at_what_shrank(&mut self) {
        let shrunk_count = self.cache.shrunk_count;
        let has_lost = |gaze: &&mut Gaze| {
            gaze.is_covered && shrunk_count > gaze.shrunk_before && gaze.walks_again < WALKS_AGAIN_MAX
        };
        for gaze in self.gazes.iter_mut().filter(has_lost) {
            gaze.walk_again(shrunk_count);
        }
    }

    /// Goes on to records that count less far: all stay, and where they do not reach any more the rougher answer still counts.
    fn go_finer(&mut self) {
        self.round += 1;
        let settings = self.settings.rougher(ROUNDS[self.round]);
        let finer = IrradianceCache::new(settings, self.base.clone());
        let mut rougher = std::mem::replace(&mut self.cache, finer);
        for (record, place) in rougher.records.iter().zip(&self.places) {
            let reach_min_m = settings.reach_min_m(place.seen.pixel_m, place.extent.all_gone_m);
            self.cache.insert(Record { reach_min_m, ..*record });
        }
        self.steady(&mut rougher);
        self.cache.rougher = Some(Arc::new(rougher));
        self.begin_walks();
    }

    fn begin_walks(&mut self) {
        self.gazes.iter_mut().for_each(|gaze| gaze.begin(self.cache.shrunk_count));
    }

    /// Makes room for what is looked at now: those records are made anew.
    fn drop_all(&mut self) {
        self.round = 0;
        self.cache = IrradianceCache::new(self.settings.rougher(ROUNDS[0]), self.base.clone());
        (self.batch, self.next_batch) = (None, FIRST_BATCH);
        self.places.clear();
        self.settled = 0;
        self.relit = None;
        self.refining = Refining::BEGIN;
        self.may_drop = false;
        self.begin_walks();
    }

    /// Gathers once more for the next records of those for which it was done least often.
    fn refine_some(&mut self, step: &Step<'_>) -> Counts {
        let start = Instant::now();
        let by = self.gather_by(step.world, step.cancel);
        let (visits, due) = self.due(self.records_per_step(by));
        let points: Vec<Seen> = due.iter().map(|index| self.places[*index].seen).collect();
        let old: Vec<_> = due.iter().map(|index| self.cache.records[*index]).collect();
        let Some((gathered, counts)) = by.refine_all((&points, &old), visits) else {
            return Counts::default();
        };
        for (index, Gathered { record, sight, deviation, .. }) in due.iter().zip(gathered) {
            let place = &mut self.places[*index];
            let before = std::mem::replace(&mut self.cache.records[*index], record).irradiance;
            place.sight = place.sight.union(&sight);
            if visits == 0 {
                (place.visited, place.deviation) = (Visited::ONCE, deviation);
            } else {
                place.visited = place.visited.again(before, record.irradiance);
            }
        }
        self.gathered_count += due.len() as u64;
        self.take_pace(due.len(), start);
        self.refining = match due.last() {
            Some(last) => Refining { visits, next: last + 1 },
            None => Refining { visits, next: 0 },
        };
        if visits >= self.visits_max() {
            self.settled = self.places.len();
        }
        counts
    }

    /// The next records that are to be visited again, at most so many, and how often each of them was.
    fn due(&self, count_max: usize) -> (u32, Vec<usize>) {
        let Refining { visits, mut next } = self.refining;
        // What was gathered from rougher light is gathered anew before anything else.
        let end = if visits == 0 { 1 } else { self.visits_max() };
        for visits in visits..end {
            let is_for_all = visits < self.settings.visits.least.get();
            // Asked before each round alone: what records become does not depend on how many are visited in a step.
            if !is_for_all && next == 0 {
                if noise_of(self.visited().skip(self.settled))
                    <= f64::from(self.settings.visits.noise).powi(2)
                {
                    return (self.visits_max(), Vec::new());
                }
                next = self.settled;
            }
            let is_due = |index: &usize| self.places[*index].visited.count == visits;
            let due: Vec<usize> = (next..self.places.len()).filter(is_due).take(count_max).collect();
            if !due.is_empty() {
                return (visits, due);
            }
            next = 0;
        }
        (end, Vec::new())
    }

    /// What is known of the noise of each record, and its irradiance, W/m².
    fn visited(&self) -> impl Iterator<Item = (Visited, Rgb)> + Clone {
        self.places.iter().zip(&self.cache.records).map(|(place, record)| (place.visited, record.irradiance))
    }

    fn visits_max(&self) -> u32 {
        let Visits { least, most, .. } = self.settings.visits;
        least.max(most).get()
    }
}

impl Technique for IrradianceCaching {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        let mut counts = Counts::default();
        if !self.is_complete() && !step.cancel.load(Ordering::Relaxed) {
            counts = match self.next_gaze() {
                _ if self.relit.is_some() => self.relight_some(step),
                _ if self.refining.visits == 0 => self.refine_some(step),
                Some(index) => self.cover_some(index, step),
                None if self.is_preliminary => counts,
                None => self.refine_some(step),
            };
        }
        Progress { counts, complete: self.is_complete() }
    }

    /// Drops the records whose rays may have met what the edit touched; the rest stay where they are, and light is gathered for them
    /// anew before anything else. Where lights changed all of it is wrong; while records are still rough there are few; and none stays
    /// through two edits with light of before both.
    fn apply(&mut self, edit: &Edit<'_>) {
        if edit.change.leaves_light_alone() {
            return;
        }
        let (before, after) = (edit.before.accel(), edit.after.accel());
        let is_rough = self.round + 1 < ROUNDS.len();
        if is_rough
            || self.relit.is_some()
            || !edit.leaves_lights()
            || before.origin_in_world() != after.origin_in_world()
        {
            self.drop_all();
            return;
        }
        self.drop_touched(edit);
    }
}
