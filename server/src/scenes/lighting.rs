//! What a scene knows of its light, kept for all its viewers while one of them looks through it.
//!
//! Lives on the render thread. Edits are followed by what they changed, so that light that no edit touched is not computed
//! again; a scene that nobody looks at through the octree has none, and pays nothing.

use super::{Snapshot, Workshop};
use lumicast_engine::render::{Illumination, IlluminationSettings, Stage};
use lumicast_engine::scene::SceneChange;
use lumicast_engine::technique::{Edit, SecondaryLight};
use lumicast_engine::transport::World;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Changes of one scene's light that wait for its render thread. More are joined: together they say the same.
const WAITING_MAX: usize = 64;

/// Time between two looks for changes of the light that no edit told of, while pictures are drawn with it: one photon of
/// every group is traced again.
const PROBE_PERIOD: Duration = Duration::from_secs(1);

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

/// Photons and octree of one scene, for each bound on bounces that somebody looks with.
#[derive(Debug, Default)]
pub(super) struct Lighting {
    lit: HashMap<Option<u32>, Lit>,
    /// Counts up with everything that becomes known of any.
    generation: u64,
}

#[derive(Debug)]
struct Lit {
    illumination: Illumination,
    /// The scene that it knows.
    world: Arc<World>,
    /// Of all that became known of any, when this became known.
    generation: u64,
    probed: Instant,
}

impl Lit {
    /// Looks for changes that no edit told of, now and then; what went another way is traced again next.
    fn probe(&mut self, workshop: &Workshop) {
        if self.probed.elapsed() < PROBE_PERIOD {
            return;
        }
        let counts = workshop.drawing_pool.install(|| self.illumination.probe(&self.world));
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
    /// Brings it to the scene of `snapshot`, for those bounds on bounces that are wanted; drops the others.
    pub(super) fn follow(
        &mut self,
        snapshot: &Snapshot,
        changes: &mut LightChanges,
        wanted: &HashSet<Option<u32>>,
        workshop: &Workshop,
    ) {
        let change = changes.take_until(snapshot.revision);
        self.lit.retain(|bounces_max, _| wanted.contains(bounces_max));
        for lit in self.lit.values_mut() {
            if !change.leaves_light_alone() {
                let edit = Edit { before: &lit.world, after: &snapshot.world, change: &change };
                let before = lit.illumination.generation();
                workshop.drawing_pool.install(|| lit.illumination.apply(&edit));
                if lit.illumination.generation() != before {
                    self.generation += 1;
                    lit.generation = self.generation;
                }
            }
            lit.world = snapshot.world.clone();
        }
        for bounces_max in wanted {
            self.lit.entry(*bounces_max).or_insert_with(|| {
                let mut settings = IlluminationSettings::default();
                settings.photons.seed = workshop.config.seed;
                settings.photons.bounces_max = *bounces_max;
                settings.photons.emitted_count = workshop.config.photons;
                settings.octree.depth = workshop.config.octree_depth;
                let illumination = Illumination::new(settings);
                Lit { illumination, world: snapshot.world.clone(), generation: 0, probed: Instant::now() }
            });
        }
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
        for lit in self.lit.values_mut() {
            if lit.illumination.stage() == Stage::Complete {
                lit.probe(workshop);
            }
            while lit.illumination.stage() != Stage::Complete {
                let before = lit.illumination.counts();
                let is_better = workshop.drawing_pool.install(|| lit.illumination.step(&lit.world, &never));
                workshop.metrics.rays.add((lit.illumination.counts() - before).rays);
                if is_better {
                    self.generation += 1;
                    lit.generation = self.generation;
                }
                has_learnt = true;
                if Instant::now() >= end || is_news() {
                    return true;
                }
            }
        }
        has_learnt
    }

    /// All that is to be known is known.
    pub(super) fn is_complete(&self, bounces_max: Option<u32>) -> bool {
        self.lit.get(&bounces_max).is_some_and(|lit| lit.illumination.stage() == Stage::Complete)
    }

    /// What is known by now.
    pub(super) fn known(&self, bounces_max: Option<u32>) -> Option<Arc<dyn SecondaryLight>> {
        self.lit.get(&bounces_max)?.illumination.known().cloned()
    }

    /// Counts up with everything that becomes known.
    pub(super) fn generation(&self, bounces_max: Option<u32>) -> u64 {
        self.lit.get(&bounces_max).map_or(0, |lit| lit.generation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::scene::Id;

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
}
