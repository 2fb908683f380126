//! What a scene knows of its light, kept for all its viewers while one of them looks through it, and for a while after: single pictures go
//! on with it then, and leave what they know.
//!
//! Lives on the render thread. Edits are followed by what they changed, so that light that no edit touched is not computed
//! again. A scene that nobody looks at, or by path tracing alone, learns nothing and follows no edit.

#[cfg(test)]
mod tests;

use super::memory::CountedMemory;
use super::{Snapshot, Workshop};
use lumicast_engine::film::PictureSize;
use lumicast_engine::render::{
    IlluminationSettings, Indirect, Learner, Learning, Learnt, RenderSettings, Stage, ToLearn,
};
use lumicast_engine::scene::{CameraView, SceneChange};
use lumicast_engine::technique::{Edit, SecondaryLight};
use lumicast_engine::transport::World;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Changes of one scene's light that wait for its render thread. More are joined: together they say the same.
const WAITING_MAX: usize = 64;

/// Time between two looks for changes of the light that no edit told of, while pictures are drawn with it: one photon of
/// every group is traced again.
const PROBE_PERIOD: Duration = Duration::from_secs(1);

/// Between two changes of the accuracy of one scene's records, at least, and so many times as long as the last one took: all records are
/// weighed anew and shown, and whoever drags a slider, or means harm, is not to keep others waiting.
const WEIGHING_PAUSE: Duration = Duration::from_millis(100);
const WEIGHING_PAUSES: u32 = 9;

/// What edits changed, from the oldest the render thread has not seen.
#[derive(Debug, Default)]
pub(super) struct LightChanges {
    /// By the revisions they led to, ascending.
    waiting: Vec<Waiting>,
}

#[derive(Debug)]
struct Waiting {
    /// The revisions that it led to, one or some joined.
    first: u64,
    last: u64,
    change: SceneChange,
}

impl LightChanges {
    /// Takes note of the change that leads to `revision`.
    pub(super) fn push(&mut self, revision: u64, change: SceneChange) {
        if change.leaves_light_alone() {
            return;
        }
        let is_full = self.waiting.len() >= WAITING_MAX;
        match self.waiting.last_mut().filter(|_| is_full) {
            Some(joined) => {
                joined.change.join(&change);
                joined.last = revision;
            }
            None => self.waiting.push(Waiting { first: revision, last: revision, change }),
        }
    }

    /// Puts later ones behind.
    pub(super) fn append(&mut self, later: LightChanges) {
        self.waiting.extend(later.waiting);
    }

    /// All that led to `revision`. What is joined with later changes stays for those as well: taking light back twice only
    /// costs time.
    fn take_until(&mut self, revision: u64) -> SceneChange {
        let mut all = SceneChange::default();
        let led_here = self.waiting.iter().filter(|waiting| waiting.first <= revision);
        led_here.for_each(|waiting| all.join(&waiting.change));
        self.waiting.retain(|waiting| waiting.last > revision);
        all
    }
}

/// What pictures that show the same light have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct LightKey {
    pub(super) learnt: Learnt,
    pub(super) bounces_max: Option<u32>,
}

/// What somebody looks at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gaze {
    pub(super) viewer: u64,
    pub(super) camera: CameraView,
    pub(super) size: PictureSize,
    /// Of records of irradiance.
    pub(super) irradiance_accuracy: f32,
}

/// What is kept of light that nobody looks with any more, at most: more ways to look than these are asked for by nobody who only
/// comes back.
const KEPT_MAX: usize = 2;

/// What is learnt of one scene's light, for each technique and bound on bounces that somebody looks with, or did a moment ago.
#[derive(Debug, Default)]
pub(super) struct Lighting {
    lit: HashMap<LightKey, Lit>,
    /// Counts up with everything that becomes known of any.
    generation: u64,
    /// Records wait until then to be weighed otherwise.
    weighs_at: Option<Instant>,
    /// What nobody looks with is kept until then.
    expires_at: Option<Instant>,
}

#[derive(Debug)]
struct Lit {
    learner: Learner,
    /// The scene that it knows.
    world: Arc<World>,
    /// What was edited since then …
    ahead: SceneChange,
    /// … and led to this scene.
    newest: Arc<World>,
    /// Of all that became known of any, when this became known; and what the learner calls it.
    generation: u64,
    learner_generation: u64,
    /// Time spent on it, beginning with that of the others that were there: the least goes first.
    seconds: f64,
    probed: Instant,
    /// Its records are weighed otherwise from then on at the earliest.
    may_weigh_at: Instant,
    /// When the last who looked with it went; `None` while somebody looks.
    left: Option<Instant>,
    /// And what it takes then.
    memory: Option<CountedMemory>,
}

impl Lit {
    /// Nothing known yet.
    fn begin(key: LightKey, world: &Arc<World>, seconds: f64, workshop: &Workshop) -> Lit {
        Lit {
            learner: learner_of(key, workshop),
            world: world.clone(),
            ahead: SceneChange::default(),
            newest: world.clone(),
            generation: 0,
            learner_generation: 0,
            seconds,
            probed: Instant::now(),
            may_weigh_at: Instant::now(),
            left: None,
            memory: None,
        }
    }

    /// Brings it to a later scene, when the edit before is followed; see [`Learner::is_catching_up`].
    ///
    /// - `change`: since the scene that it was to be brought to before
    fn follow_edit(&mut self, world: &Arc<World>, change: &SceneChange, workshop: &Workshop) {
        let has_waiting = !self.ahead.leaves_light_alone();
        self.ahead.join(change);
        let before = std::mem::replace(&mut self.newest, world.clone());
        if !self.ahead.leaves_light_alone() {
            // Around another origin nothing that is known is of use.
            let is_here = self.world.accel().origin_in_world() == world.accel().origin_in_world();
            let waits = is_here && self.learner.is_catching_up();
            if (waits || has_waiting) && !change.leaves_light_alone() {
                workshop.drawing_pool.install(|| self.learner.fall_behind(&self.world, (&before, world)));
            }
            if waits {
                return;
            }
            let edit = Edit { before: &self.world, after: world, change: &self.ahead };
            workshop.drawing_pool.install(|| self.learner.apply(&edit));
        }
        self.ahead = SceneChange::default();
        self.world = world.clone();
    }

    /// What is known is of the scene that it was to be brought to last.
    fn knows_light_of_now(&self) -> bool {
        self.ahead.leaves_light_alone() && self.learner.knows_light_of_now()
    }

    /// A later scene waits, and no longer for anything.
    fn may_go_on(&self) -> bool {
        !self.ahead.leaves_light_alone() && !self.learner.is_catching_up()
    }

    /// What is known by now, unless it is of other lights.
    fn known(&self) -> Option<Arc<dyn SecondaryLight>> {
        if self.learner.knows_other_lights() { None } else { self.learner.known_by_now() }
    }

    /// All that is to be known is known.
    fn is_complete(&self) -> bool {
        self.ahead.leaves_light_alone() && self.learner.stage() == Stage::Complete
    }

    /// Takes note of what became known.
    fn follow(&mut self, generation: &mut u64) {
        if self.learner.generation() != self.learner_generation {
            self.learner_generation = self.learner.generation();
            *generation += 1;
            self.generation = *generation;
        }
    }

    /// Weighs records by another accuracy; or says when, if that was done a moment ago.
    fn weigh(&mut self, accuracy: f32, workshop: &Workshop) -> Option<Instant> {
        let start = Instant::now();
        if start < self.may_weigh_at {
            return Some(self.may_weigh_at);
        }
        workshop.drawing_pool.install(|| self.learner.set_accuracy(accuracy));
        self.may_weigh_at = Instant::now() + (WEIGHING_PAUSES * start.elapsed()).max(WEIGHING_PAUSE);
        None
    }

    /// Looks for changes that no edit told of, now and then; what went another way is traced again next.
    fn probe(&mut self, workshop: &Workshop) {
        if self.probed.elapsed() < PROBE_PERIOD {
            return;
        }
        let counts = workshop.drawing_pool.install(|| self.learner.probe(&self.world));
        workshop.metrics.photons_probed.add(counts.probed);
        workshop.metrics.photon_groups_diverged.add(counts.diverged);
        if counts.diverged > 0 {
            tracing::warn!(
                groups = counts.diverged,
                "light changed without an edit; its photons are traced again"
            );
        }
        self.probed = Instant::now();
    }
}

impl Lighting {
    /// Brings it to the scene of `snapshot`, for what is wanted by those who look; drops the rest.
    pub(super) fn follow(
        &mut self,
        snapshot: &Snapshot,
        changes: &mut LightChanges,
        wanted: &HashMap<LightKey, Vec<Gaze>>,
        workshop: &Arc<Workshop>,
    ) {
        let change = changes.take_until(snapshot.revision);
        self.retain(wanted, &change, (Instant::now(), workshop.config.kept_light()));
        self.count_kept(workshop);
        self.weighs_at = None;
        for lit in self.lit.values_mut() {
            lit.follow_edit(&snapshot.world, &change, workshop);
            lit.follow(&mut self.generation);
        }
        for (key, gazes) in wanted {
            if !self.lit.contains_key(key) {
                let seconds = self.least_seconds().unwrap_or(0.0);
                self.lit.insert(*key, Lit::begin(*key, &snapshot.world, seconds, workshop));
            }
            let Some(lit) = self.lit.get_mut(key) else { continue };
            // Records are shared: who asks for less gets more.
            let accuracy = gazes.iter().map(|gaze| gaze.irradiance_accuracy).reduce(f32::min);
            if let Some(accuracy) = accuracy.filter(|accuracy| *accuracy != lit.learner.accuracy()) {
                let waits_until = lit.weigh(accuracy, workshop);
                self.weighs_at = self.weighs_at.into_iter().chain(waits_until).min();
                lit.follow(&mut self.generation);
            }
            lit.learner.look_away(|viewer| gazes.iter().any(|gaze| gaze.viewer == viewer));
            gazes.iter().for_each(|gaze| lit.learner.look(gaze.viewer, &gaze.camera, gaze.size));
        }
    }

    /// Goes on with what somebody learnt for himself alone, of the scene that [`Lighting::follow`] was told of last: for those who look and
    /// know nothing yet, or kept as if he had looked with it where nothing better is. Returns what is not needed. Who looks and knows
    /// anything goes on with that: after an edit too, of which most may be right and is being brought to the scene as it is.
    pub(super) fn take_over(
        &mut self,
        key: LightKey,
        (learner, world): (Learner, Arc<World>),
        workshop: &Arc<Workshop>,
    ) -> Option<Learner> {
        let is_better = |lit: &Lit| match lit.left {
            None => lit.learner.known().is_none(),
            Some(_) => !lit.knows_light_of_now() || lit.learner.knowledge() < learner.knowledge(),
        };
        if !learner.knows_light_of_now() || !self.lit.get(&key).is_none_or(is_better) {
            return Some(learner);
        }
        let now = Instant::now();
        let kept = workshop.config.kept_light();
        let refused = match self.lit.get_mut(&key) {
            Some(lit) => {
                (lit.world, lit.newest, lit.ahead) = (world.clone(), world, SceneChange::default());
                let refused = std::mem::replace(&mut lit.learner, learner);
                match lit.left {
                    // Whoever looks looks with it from the next round on.
                    None => lit.learner.go_on_for(Learning::Alongside { until: None }),
                    Some(_) => (lit.left, lit.memory) = (Some(now), None),
                }
                // Whatever its own count says.
                lit.learner_generation = u64::MAX;
                Some(refused)
            }
            None => {
                let seconds = self.least_seconds().unwrap_or(0.0);
                let lit = Lit { learner, left: Some(now), ..Lit::begin(key, &world, seconds, workshop) };
                self.lit.insert(key, lit);
                None
            }
        };
        if let Some(lit) = self.lit.get_mut(&key) {
            lit.follow(&mut self.generation);
        }
        self.drop_expired(&SceneChange::default(), (now, kept));
        self.count_kept(workshop);
        refused
    }

    /// What is kept and nobody looks with, for somebody who goes on with it for himself alone, with records as the settings have them; of
    /// the scene that [`Lighting::follow`] was told of last.
    pub(super) fn hand_over(&mut self, key: LightKey, workshop: &Workshop) -> Option<Learner> {
        self.lit.get(&key).filter(|lit| lit.left.is_some() && lit.knows_light_of_now())?;
        let mut learner = self.lit.remove(&key)?.learner;
        let accuracy = illumination_of(&RenderSettings::default(), workshop).irradiance.weighing.accuracy;
        workshop.drawing_pool.install(|| learner.set_accuracy(accuracy));
        Some(learner)
    }

    /// Keeps what is wanted, and for a while what was: who reloads a page, or tries another technique, is shown what was known. Through
    /// edits of the light nothing is kept that nobody looks at, since following them costs time.
    ///
    /// - `now`, `kept`: and for how long
    fn retain(
        &mut self,
        wanted: &HashMap<LightKey, Vec<Gaze>>,
        change: &SceneChange,
        (now, kept): (Instant, Duration),
    ) {
        let least = self.least_seconds();
        for (key, lit) in &mut self.lit {
            if !wanted.contains_key(key) {
                lit.left = lit.left.or(Some(now));
            } else if lit.left.take().is_some() {
                lit.memory = None;
                // Who comes back stands in line as who is new does, and has time, other than whoever may have learnt it.
                lit.seconds = least.map_or(lit.seconds, |least| lit.seconds.max(least));
                lit.learner.go_on_for(Learning::Alongside { until: None });
            }
        }
        self.drop_expired(change, (now, kept));
    }

    /// Drops what was kept for long enough, or is too much, or of other light.
    fn drop_expired(&mut self, change: &SceneChange, (now, kept): (Instant, Duration)) {
        let mut left: Vec<(Instant, LightKey)> =
            self.lit.iter().filter_map(|(key, lit)| Some((lit.left?, *key))).collect();
        left.sort_by_key(|(at, _)| std::cmp::Reverse(*at));
        let is_kept = |at: Instant| change.leaves_light_alone() && now.saturating_duration_since(at) < kept;
        let dropped = left.iter().enumerate().filter(|(place, (at, _))| *place >= KEPT_MAX || !is_kept(*at));
        dropped.for_each(|(_, (_, key))| {
            self.lit.remove(key);
        });
        self.expires_at = self.lit.values().filter_map(|lit| lit.left).min().map(|at| at + kept);
    }

    /// Counts what is kept. Where all scenes together would keep too much, this one drops what was left longest, in the end what was left
    /// last. Nobody learns anything with it meanwhile: it stays as large as it is.
    fn count_kept(&mut self, workshop: &Arc<Workshop>) {
        let mut left: Vec<(Instant, LightKey)> =
            self.lit.iter().filter_map(|(key, lit)| Some((lit.left?, *key))).collect();
        left.sort_by_key(|(at, _)| *at);
        let mut longest = left.iter().map(|(_, key)| *key);
        for (_, key) in left.iter().rev() {
            while let Some(lit) = self.lit.get_mut(key).filter(|lit| lit.memory.is_none()) {
                let bytes = lit.learner.bytes();
                lit.memory = CountedMemory::of_kept_light(workshop, bytes);
                if lit.memory.is_none()
                    && let Some(dropped) = longest.next()
                {
                    let kept = workshop.metrics.kept_light_bytes.value();
                    tracing::info!(
                        bytes,
                        kept,
                        "too much light to keep with nobody looking: see kept_light_bytes"
                    );
                    self.lit.remove(&dropped);
                }
            }
        }
        self.expires_at = self.expires_at.filter(|_| self.lit.values().any(|lit| lit.left.is_some()));
    }

    /// Time spent on what took least, of what somebody looks with.
    fn least_seconds(&self) -> Option<f64> {
        let wanted = self.lit.values().filter(|lit| lit.left.is_none());
        wanted.map(|lit| lit.seconds).reduce(f64::min)
    }

    /// When some of what is kept is dropped, unless somebody comes back.
    pub(super) fn expires_at(&self) -> Option<Instant> {
        self.expires_at
    }

    /// Learns for about so long, or until there is news; true when it did anything.
    pub(super) fn learn(
        &mut self,
        budget: Duration,
        workshop: &Workshop,
        is_news: impl Fn() -> bool,
    ) -> bool {
        let end = Instant::now() + budget;
        let mut has_learnt = false;
        // Steps of tracing and gathering are some 10 ms; sorting photons into maps and cutting up geometry take longer in
        // large scenes, and none is cut short.
        let never = AtomicBool::new(false);
        let mut wanted: Vec<&mut Lit> = self.lit.values_mut().filter(|lit| lit.left.is_none()).collect();
        for lit in wanted.iter_mut().filter(|lit| lit.learner.stage() == Stage::Complete) {
            lit.probe(workshop);
            lit.follow(&mut self.generation);
        }
        loop {
            let open = wanted.iter_mut().filter(|lit| lit.learner.stage() != Stage::Complete);
            let Some(lit) = open.min_by(|a, b| a.seconds.total_cmp(&b.seconds)) else { return has_learnt };
            let (before, start) = (lit.learner.counts(), Instant::now());
            workshop.drawing_pool.install(|| lit.learner.step(&lit.world, &never));
            lit.seconds += start.elapsed().as_secs_f64();
            let counts = lit.learner.counts() - before;
            workshop.metrics.rays.add(counts.all_rays());
            lit.follow(&mut self.generation);
            has_learnt = true;
            if Instant::now() >= end || lit.may_go_on() || is_news() {
                return true;
            }
        }
    }

    /// When records are to be weighed as somebody asked for in the meantime.
    pub(super) fn weighs_at(&self) -> Option<Instant> {
        self.weighs_at
    }

    /// All that is to be known is known.
    pub(super) fn is_complete(&self, key: LightKey) -> bool {
        self.lit.get(&key).is_some_and(Lit::is_complete)
    }

    /// What is still to be learnt.
    pub(super) fn to_learn(&self, key: LightKey) -> ToLearn {
        self.lit
            .get(&key)
            .filter(|lit| lit.ahead.leaves_light_alone())
            .map_or(ToLearn::Rounds, |lit| lit.learner.to_learn())
    }

    /// What is known by now, unless it is of other lights: pictures are path-traced until these are known.
    pub(super) fn known(&self, key: LightKey) -> Option<Arc<dyn SecondaryLight>> {
        self.lit.get(&key)?.known()
    }

    /// Counts up when what is known becomes that of another scene.
    pub(super) fn epoch(&self, key: LightKey) -> u64 {
        self.lit.get(&key).map_or(0, |lit| lit.learner.epoch())
    }

    /// Counts up with everything that becomes known.
    pub(super) fn generation(&self, key: LightKey) -> u64 {
        self.lit.get(&key).map_or(0, |lit| lit.generation)
    }
}

fn learner_of(key: LightKey, workshop: &Workshop) -> Learner {
    let LightKey { learnt, bounces_max } = key;
    let indirect = match learnt {
        Learnt::Octree => Indirect::Octree,
        Learnt::Records => Indirect::Irradiance,
    };
    let learning = Learning::Alongside { until: None };
    let seed = workshop.config.seed;
    let settings = RenderSettings { indirect, bounces_max, seed, learning, ..RenderSettings::default() };
    Learner::new(learnt, &settings, illumination_of(&settings, workshop))
}

/// What light is learnt with for such pictures.
pub(super) fn illumination_of(settings: &RenderSettings, workshop: &Workshop) -> IlluminationSettings {
    let mut of = IlluminationSettings::of(settings);
    of.photons.emitted_count = workshop.config.photons;
    of.octree.depth = workshop.config.octree_depth;
    of.irradiance.records_max = workshop.config.irradiance_records as usize;
    of
}
