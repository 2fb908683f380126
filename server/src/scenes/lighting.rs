//! What a scene knows of its light, kept for all its viewers while one of them looks through it, and for a while after.
//!
//! Lives on the render thread. Edits are followed by what they changed, so that light that no edit touched is not computed
//! again. A scene that nobody looks at, or by path tracing alone, learns nothing and follows no edit.

use super::{Snapshot, Workshop};
use lumicast_engine::film::PictureSize;
use lumicast_engine::render::{
    Backend, IlluminationSettings, Indirect, Learner, Learning, Learnt, RenderSettings, Stage, ToLearn,
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
    /// What was edited since then.
    ahead: SceneChange,
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
}

impl Lit {
    /// Nothing known yet.
    fn begin(key: LightKey, world: &Arc<World>, seconds: f64, workshop: &Workshop) -> Lit {
        Lit {
            learner: learner_of(key, workshop),
            world: world.clone(),
            ahead: SceneChange::default(),
            generation: 0,
            learner_generation: 0,
            seconds,
            probed: Instant::now(),
            may_weigh_at: Instant::now(),
            left: None,
        }
    }

    /// Brings it to a later scene, when the edit before is followed; see [`Learner::is_catching_up`].
    ///
    /// - `change`: since the scene that it was to be brought to before
    fn follow_edit(&mut self, world: &Arc<World>, change: &SceneChange, workshop: &Workshop) {
        self.ahead.join(change);
        if !self.ahead.leaves_light_alone() {
            // Around another origin nothing that is known is of use.
            let is_here = self.world.accel().origin_in_world() == world.accel().origin_in_world();
            if is_here && self.learner.is_catching_up() {
                if !change.leaves_light_alone() {
                    workshop.drawing_pool.install(|| self.learner.fall_behind(&self.world, world));
                }
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
        workshop: &Workshop,
    ) {
        let change = changes.take_until(snapshot.revision);
        self.retain(wanted, &change, (Instant::now(), workshop.config.kept_light()));
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
        workshop: &Workshop,
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
                (lit.world, lit.ahead) = (world, SceneChange::default());
                let refused = std::mem::replace(&mut lit.learner, learner);
                match lit.left {
                    // Whoever looks looks with it from the next round on.
                    None => lit.learner.go_on_for(Learning::Alongside { until: None }),
                    Some(_) => lit.left = Some(now),
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

    /// What is known by now, for a picture by `indirect`. The best there is does without what is known of other lights: it is
    /// path-traced until these are known.
    pub(super) fn known(
        &self,
        key: LightKey,
        indirect: Indirect,
        backend: Backend,
    ) -> Option<Arc<dyn SecondaryLight>> {
        let learner = &self.lit.get(&key)?.learner;
        let is_wrong = indirect == Indirect::Auto && learner.knows_other_lights();
        match backend {
            _ if is_wrong => None,
            Backend::Cpu => learner.known_by_now(),
            // What a card was given stays there.
            Backend::Gpu => learner.known().cloned(),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use glam::{DAffine3, DVec3};
    use lumicast_engine::math::Rgb;
    use lumicast_engine::scene::{Id, Material, Scene, SceneBuilder, SceneLimits, samples};

    fn change_of(name: &str) -> SceneChange {
        SceneChange { lights: [Id::new(name).unwrap()].into_iter().collect(), ..SceneChange::default() }
    }

    /// Changes are taken once, up to the revision asked for, and none is lost when more wait than are kept apart.
    #[test]
    fn changes_are_taken_once_and_never_lost() {
        let mut changes = LightChanges::default();
        changes.push(2, change_of("a"));
        changes.push(3, SceneChange::default());
        changes.push(4, change_of("b"));
        assert_eq!(changes.take_until(3).lights.len(), 1);
        assert_eq!(changes.take_until(4).lights.len(), 1);
        assert!(changes.take_until(9).leaves_light_alone());
        for revision in 10..300 {
            changes.push(revision, change_of(&format!("light {revision}")));
        }
        assert!(changes.waiting.len() <= WAITING_MAX);
        // In the middle of what was joined: all that led there, and perhaps more.
        assert!(changes.take_until(200).lights.len() >= 191);
        assert!(changes.take_until(299).lights.len() >= 99);
        assert!(changes.take_until(300).leaves_light_alone());
    }

    /// Whoever edits without a pause, faster than any edit can be followed, sees the light follow none the less, and in the end that of
    /// the last edit; what the edits that wait change of the lights counts at once.
    #[test]
    fn light_follows_edits_that_do_not_end() {
        let workshop = Workshop::open(Config { photons: 64_000, ..Config::default() }).unwrap();
        let mut world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
        let key = LightKey { learnt: Learnt::Octree, bounces_max: None };
        let mut lit = Lit::begin(key, &world, 0.0, &workshop);
        let never = AtomicBool::new(false);
        let step = |lit: &mut Lit| workshop.drawing_pool.install(|| lit.learner.step(&lit.world, &never));
        while !lit.is_complete() {
            step(&mut lit);
        }
        let edited = |world: &Arc<World>, strength: f32| {
            let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
            let lamp = Material::emitter(Rgb::splat(strength));
            builder.set_material(Id::new("lamp").unwrap(), lamp).unwrap();
            let (scene, change) = builder.finish();
            (Arc::new(world.update(Arc::new(scene), &change)), change)
        };
        let (epoch, mut steps) = (lit.learner.epoch(), 0);
        while lit.learner.epoch() < epoch + 4 {
            steps += 1;
            assert!(steps < 5_000, "light of before for ever");
            let (next, change) = edited(&world, 10.0 + (steps % 2) as f32);
            world = next;
            lit.follow_edit(&world, &change, &workshop);
            assert!(!lit.is_complete());
            step(&mut lit);
        }
        // It is at an edit before: not behind by much, until one comes that changes much.
        let (next, change) = edited(&world, 10.4);
        world = next;
        lit.follow_edit(&world, &change, &workshop);
        step(&mut lit);
        assert!(!lit.learner.knows_other_lights() && lit.learner.is_catching_up());
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        builder.set_material(Id::new("red").unwrap(), Material::emitter(Rgb::WHITE)).unwrap();
        let (scene, change) = builder.finish();
        let next = Arc::new(world.update(Arc::new(scene), &change));
        lit.follow_edit(&next, &change, &workshop);
        assert!(lit.learner.knows_other_lights() && !Arc::ptr_eq(&lit.world, &next));
        let until_complete = |lit: &mut Lit, world: &Arc<World>| {
            for _ in 0..100_000 {
                if lit.is_complete() {
                    return;
                }
                step(lit);
                lit.follow_edit(world, &SceneChange::default(), &workshop);
            }
            panic!("no end of it");
        };
        until_complete(&mut lit, &next);
        assert!(Arc::ptr_eq(&lit.world, &next) && !lit.learner.knows_other_lights());
        // Around another origin nothing waits.
        let (first, change) = edited(&next, 10.8);
        lit.follow_edit(&first, &change, &workshop);
        assert!(lit.learner.is_catching_up());
        let mut builder = SceneBuilder::from_scene(first.scene(), SceneLimits::default());
        let far = DAffine3::from_translation(DVec3::splat(1e6));
        builder.set_transform("glass ball", far).unwrap();
        let (scene, change) = builder.finish();
        let second = Arc::new(first.update(Arc::new(scene), &change));
        assert_ne!(first.accel().origin_in_world(), second.accel().origin_in_world());
        lit.follow_edit(&second, &change, &workshop);
        assert!(Arc::ptr_eq(&lit.world, &second));
        until_complete(&mut lit, &second);
    }

    /// What somebody learnt for himself alone is kept as if he had looked with it, unless something is known already, or nothing became
    /// known.
    #[test]
    fn what_others_learnt_is_kept_for_others() {
        let workshop = Workshop::open(Config { photons: 64_000, ..Config::default() }).unwrap();
        let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
        let key = LightKey { learnt: Learnt::Octree, bounces_max: None };
        let learnt = || {
            let mut lit = Lit::begin(key, &world, 0.0, &workshop);
            while !lit.learner.knows_light_of_now() {
                workshop.drawing_pool.install(|| lit.learner.step(&world, &AtomicBool::new(false)));
            }
            (lit.learner, world.clone())
        };
        let mut lighting = Lighting::default();
        assert!(lighting.take_over(key, (learner_of(key, &workshop), world.clone()), &workshop).is_some());
        assert!(lighting.lit.is_empty() && lighting.expires_at().is_none());
        assert!(lighting.take_over(key, learnt(), &workshop).is_none());
        assert!(lighting.generation(key) > 0);
        assert!(lighting.expires_at().is_some_and(|at| at > Instant::now()));
        let first = lighting.known(key, Indirect::Auto, Backend::Cpu).unwrap();
        assert!(lighting.take_over(key, learnt(), &workshop).is_some(), "no better");
        assert!(Arc::ptr_eq(&first, &lighting.known(key, Indirect::Auto, Backend::Cpu).unwrap()));
        // Nobody gets it whose light is another, nor while somebody looks with it.
        assert!(lighting.hand_over(LightKey { bounces_max: Some(3), ..key }, &workshop).is_none());
        let left = lighting.lit.get_mut(&key).unwrap().left.take();
        assert!(left.is_some() && lighting.hand_over(key, &workshop).is_none());
        let kept = lighting.lit.get_mut(&key).unwrap();
        (kept.left, kept.ahead) = (left, change_of("lamp"));
        assert!(lighting.hand_over(key, &workshop).is_none(), "an edit is yet to be followed");
        lighting.lit.get_mut(&key).unwrap().ahead = SceneChange::default();
        lighting.lit.get_mut(&key).unwrap().learner.set_accuracy(0.9);
        let handed = lighting.hand_over(key, &workshop).unwrap();
        assert!(handed.known().is_some_and(|known| Arc::ptr_eq(known, &first)) && lighting.lit.is_empty());
        assert_eq!(handed.accuracy(), learner_of(key, &workshop).accuracy());
        // Whoever looks and knows nothing yet goes on with it; whoever knows anything goes on with that, after an edit too.
        let mut lit = Lit::begin(key, &world, 0.0, &workshop);
        lighting.lit.insert(key, lit);
        assert!(
            lighting
                .take_over(key, (handed, world.clone()), &workshop)
                .is_some_and(|of| of.known().is_none())
        );
        let lit_now = &lighting.lit[&key];
        assert!(lit_now.left.is_none() && lit_now.knows_light_of_now());
        let generation = lighting.generation(key);
        let (mut better, _) = learnt();
        while better.stage() != Stage::Complete {
            workshop.drawing_pool.install(|| better.step(&world, &AtomicBool::new(false)));
        }
        let refused = lighting.take_over(key, (better, world.clone()), &workshop).unwrap();
        assert!(refused.stage() == Stage::Complete && lighting.generation(key) == generation);
        lighting.lit.get_mut(&key).unwrap().ahead = change_of("lamp");
        let better = lighting.take_over(key, (refused, world.clone()), &workshop).unwrap();
        assert!(better.stage() == Stage::Complete && lighting.generation(key) == generation);
        // Of what is kept the better stays.
        let looked_with = lighting.lit.get_mut(&key).unwrap();
        (looked_with.ahead, looked_with.left) = (SceneChange::default(), Some(Instant::now()));
        let rough = lighting.take_over(key, (better, world.clone()), &workshop).unwrap();
        assert!(lighting.lit[&key].is_complete() && lighting.generation(key) > generation);
        assert!(
            lighting
                .take_over(key, (rough, world.clone()), &workshop)
                .is_some_and(|of| of.stage() != Stage::Complete)
        );
        // What is kept and of before an edit is no better than nothing.
        lit = Lit {
            left: Some(Instant::now()),
            ahead: change_of("lamp"),
            ..Lit::begin(key, &world, 0.0, &workshop)
        };
        lit.learner = learnt().0;
        lighting.lit.insert(key, lit);
        assert!(lighting.take_over(key, learnt(), &workshop).is_some());
        assert!(lighting.lit[&key].knows_light_of_now());
        // An edit is not followed at all where nobody looks.
        let (none, now) = (HashMap::new(), Instant::now());
        lighting.retain(&none, &change_of("lamp"), (now, Duration::from_secs(60)));
        assert!(lighting.lit.is_empty() && lighting.expires_at().is_none());
    }

    /// What nobody looks with is kept for a while, the last of it alone, through edits that leave the light as it is, and is wanted again
    /// as it was, behind those who stayed; who looks keeps his whatever happens.
    #[test]
    fn light_is_kept_for_a_while() {
        const KEPT: Duration = Duration::from_secs(60);
        let workshop = Workshop::open(Config::default()).unwrap();
        let world = Arc::new(World::prepare(Arc::new(Scene::default())));
        let keys =
            [1, 2, 3, 4, 5].map(|bounces| LightKey { learnt: Learnt::Octree, bounces_max: Some(bounces) });
        let looked_at = || {
            let mut lighting = Lighting::default();
            for (key, seconds) in keys.into_iter().zip([100.0, 20.0, 30.0, 40.0, 50.0]) {
                lighting.lit.insert(key, Lit::begin(key, &world, seconds, &workshop));
            }
            lighting
        };
        let wanted = |keys: &[LightKey]| keys.iter().map(|key| (*key, Vec::new())).collect::<HashMap<_, _>>();
        let (none, start) = (SceneChange::default(), Instant::now());
        let second = Duration::from_secs(1);

        let mut lighting = looked_at();
        for (away, moment) in (1..=4).zip([1, 2, 3, 4]) {
            let here = 5 - away;
            lighting.retain(&wanted(&keys[..here]), &none, (start + moment * second, KEPT));
            assert!(keys[..here].iter().all(|key| lighting.lit[key].left.is_none()));
            assert_eq!(lighting.lit.len() - here, KEPT_MAX.min(away));
            assert!(lighting.lit.contains_key(&keys[here]), "the last that was looked with");
        }
        assert_eq!(lighting.expires_at(), Some(start + 3 * second + KEPT));
        lighting.retain(&wanted(&keys[..2]), &none, (start + 5 * second, KEPT));
        assert!(lighting.lit[&keys[1]].left.is_none() && lighting.lit.len() == 3);
        assert_eq!(lighting.lit[&keys[1]].seconds, 100.0, "before those who stayed");
        lighting.retain(&wanted(&keys[..2]), &none, (start + 3 * second + KEPT, KEPT));
        assert_eq!((lighting.lit.len(), lighting.expires_at()), (2, None));

        // All at once, through an edit, and where nothing is kept.
        let mut lighting = looked_at();
        lighting.retain(&wanted(&keys[..1]), &none, (start, KEPT));
        assert_eq!(lighting.lit.len(), 1 + KEPT_MAX);
        lighting.retain(&wanted(&keys[..1]), &change_of("lamp"), (start, KEPT));
        assert_eq!(lighting.lit.len(), 1);
        let mut lighting = looked_at();
        lighting.retain(&wanted(&keys[..1]), &none, (start, Duration::ZERO));
        assert_eq!((lighting.lit.len(), lighting.expires_at()), (1, None));
    }
}
