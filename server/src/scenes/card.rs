//! The present scene on the graphics card, made ready beside the pictures: until it is there the CPU draws them, so that no
//! viewer waits for shaders or uploads.
//!
//! A card is given up for good where it cannot run our steps at all. A scene that does not fit stays on the CPU by itself, and a
//! device that was lost is looked for again after a while.

#[cfg(test)]
mod tests;

use super::{Snapshot, Workshop, lock};
use crate::config::Config;
use crate::graphics;
use lumicast_engine::effects::EffectKind;
use lumicast_engine::gpu::{AdapterChoice, AdapterKind, Gpu, GpuError};
use lumicast_engine::render::{Backend, Rendering};
use lumicast_engine::technique::path::{GpuScene, Shading};
use lumicast_engine::transport::World;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

/// The first pass after an edit may wait for so many seconds for a scene to be brought to the card once more; one that is to take longer, by
/// what it took before …
const FOLLOWED_SECONDS: f64 = 0.05;
/// … is brought once it was left alone for so long, unless lights and materials alone change: who drags a thing changes it with every picture.
const SETTLED: Duration = Duration::from_millis(300);
/// A device that is gone is looked for again so much later.
const RETRY: Duration = Duration::from_secs(5);

/// The card that all scenes are drawn on, if any.
#[derive(Debug, Default)]
pub struct Card {
    gpu: Option<Arc<Gpu>>,
    /// It cannot run our steps.
    is_given_up: AtomicBool,
    /// Commands that it refused, of which nobody knows why: drivers that are going say many things before they are gone.
    refusals: AtomicU32,
    /// Some scene is being brought to it: one at a time.
    is_busy: Arc<AtomicBool>,
}

impl Card {
    /// As the settings ask for it.
    ///
    /// Errors: `gpu` is asked for by name, and there is none.
    pub(super) fn open(config: &Config) -> Result<Card, GpuError> {
        let gpu = match config.backend.as_str() {
            "gpu" => Some(Gpu::open_with(&config.gpu_options(AdapterChoice::Any))?),
            // A driver that computes on the CPU would take the cores from what computes there faster.
            "auto" if graphics::may_have_card() => {
                Gpu::open_with(&config.gpu_options(AdapterChoice::Hardware))
                    .inspect_err(|error| tracing::info!(%error, "no graphics card is used"))
                    .ok()
            }
            _ => None,
        };
        match &gpu {
            Some(gpu) => {
                let report = gpu.report();
                let on = match report.kind {
                    AdapterKind::Software => "drawing by a graphics driver that computes on the CPU",
                    _ => "drawing on a graphics card",
                };
                tracing::info!(adapter = report.name, kind = %report.kind, api = report.api, "{on}");
            }
            None => tracing::info!("drawing on the CPU"),
        }
        Ok(Card { gpu: gpu.map(Arc::new), ..Card::default() })
    }

    /// The card, unless it was given up.
    pub fn gpu(&self) -> Option<&Arc<Gpu>> {
        self.gpu.as_ref().filter(|_| !self.is_given_up.load(SeqCst))
    }

    /// Where pictures are drawn.
    pub(super) fn backend(&self) -> Backend {
        if self.gpu().is_some() { Backend::Gpu } else { Backend::Cpu }
    }

    fn give_up(&self, error: &GpuError) {
        if !self.is_given_up.swap(true, SeqCst) {
            tracing::warn!(%error, "the graphics card is given up; drawing on the CPU");
        }
    }
}

/// What became of bringing a scene to the card.
type Outcome = Arc<Mutex<Option<Result<(), GpuError>>>>;

/// How far a scene has got.
#[derive(Debug, Default)]
enum Stage {
    /// Not begun.
    #[default]
    Nothing,
    /// On its way, on a thread of its own.
    Coming(Outcome),
    /// Pictures can be drawn.
    Ready,
    /// It does not fit.
    Refused,
    /// Not before then.
    Later(Instant),
}

/// Refused commands after which a card is given up.
const REFUSALS_MAX: u32 = 8;

/// One scene on the card.
#[derive(Debug)]
pub(super) struct SceneOnCard {
    /// See [`FOLLOWED_SECONDS`].
    followed_seconds: f64,
    scene: Option<Arc<GpuScene>>,
    stage: Stage,
    /// Worlds that the scene is of: edits that leave light alone make others of the same light.
    worlds: Vec<Weak<World>>,
    light_revision: u64,
    /// When the present light was first seen.
    since: Option<Instant>,
    /// What is known of it has no room beside the scene.
    refuses_light: bool,
    /// Steps for caustics are compiled as well.
    has_focused: bool,
}

impl Default for SceneOnCard {
    fn default() -> SceneOnCard {
        SceneOnCard {
            followed_seconds: FOLLOWED_SECONDS,
            scene: None,
            stage: Stage::Nothing,
            worlds: Vec::new(),
            light_revision: 0,
            since: None,
            refuses_light: false,
            has_focused: false,
        }
    }
}

impl SceneOnCard {
    /// Begins to bring the present scene to the card, and takes note of how that goes.
    ///
    /// - `is_looked_at`: somebody looks at it; what nobody looks at leaves the card
    pub(super) fn follow(&mut self, snapshot: &Snapshot, workshop: &Workshop, is_looked_at: bool) {
        self.note_outcome(workshop);
        if matches!(self.stage, Stage::Coming(..)) {
            // Whatever has changed since is looked at once it has come.
            return;
        }
        if workshop.card.gpu().is_none() || !is_looked_at {
            self.leave();
            return;
        }
        if (self.since.is_none() || self.light_revision != snapshot.light_revision)
            && !self.go_on(snapshot, workshop)
        {
            // While the first scene is awaited there is nothing to settle.
            let settled = if self.since.is_none() { Instant::now().checked_sub(SETTLED) } else { None };
            self.leave();
            self.light_revision = snapshot.light_revision;
            self.since = settled.or_else(|| Some(Instant::now()));
        }
        if !self.is_of(&snapshot.world) {
            self.worlds.retain(|world| world.strong_count() > 0);
            self.worlds.push(Arc::downgrade(&snapshot.world));
        }
        let is_settled = self.since.is_some_and(|since| since.elapsed() >= SETTLED);
        let is_due = match &self.stage {
            Stage::Nothing => is_settled,
            Stage::Later(at) => Instant::now() >= *at,
            _ => false,
        };
        if is_due {
            self.begin(snapshot, workshop);
        }
    }

    /// Lets the card draw a picture from its next pass on, if it has the picture's world ready, and only then.
    pub(super) fn draw(&self, rendering: &mut Rendering, workshop: &Workshop) {
        let is_ready = matches!(self.stage, Stage::Ready) && workshop.card.gpu().is_some();
        let has_room = !(self.refuses_light && rendering.looks_light_up());
        let own = self.scene.as_ref().filter(|_| is_ready && has_room && self.is_of(rendering.world()));
        if let Some(on) = rendering.gpu_scene() {
            if !own.is_some_and(|own| Arc::ptr_eq(own, on)) {
                // It would bring back by itself what was taken off the card.
                rendering.leave_gpu();
            }
        } else if let Some(own) = own {
            rendering.draw_on(Arc::clone(own));
        }
    }

    /// Takes note where a pass failed on the card; at once, as the picture may be thrown away.
    pub(super) fn note(&mut self, rendering: &mut Rendering, workshop: &Workshop) {
        let failure = rendering.take_gpu_failure();
        if let Some(error) = failure.filter(|_| matches!(self.stage, Stage::Ready)) {
            self.note_failure(&error, workshop);
        }
    }

    /// It is on its way: whether it still is to be there is to be asked again.
    pub(super) fn is_coming(&self) -> bool {
        matches!(self.stage, Stage::Coming(..))
    }

    fn is_of(&self, world: &Arc<World>) -> bool {
        self.worlds.iter().any(|own| std::ptr::eq(own.as_ptr(), Arc::as_ptr(world)))
    }

    /// Gives back what it holds of the card, also where a stalled viewer's picture still names it.
    fn leave(&mut self) {
        let stage = std::mem::take(&mut self.stage);
        if let Some(scene) = self.scene.take()
            // What is on its way goes with its thread, for which nobody waits.
            && !matches!(stage, Stage::Coming(_))
        {
            scene.withdraw();
        }
        (self.worlds, self.since, self.refuses_light) = (Vec::new(), None, false);
    }

    /// Goes on with what is on the card, where that has not to be compiled anew and takes no longer than a pass may wait.
    fn go_on(&mut self, snapshot: &Snapshot, workshop: &Workshop) -> bool {
        // What had no room is not tried again with every picture.
        let goes_on = matches!(self.stage, Stage::Ready)
            && !self.refuses_light
            && (self.has_focused || !snapshot.plan.is_on(EffectKind::Caustics));
        let Some(scene) = self.scene.as_ref().filter(|_| goes_on) else { return false };
        let seconds_max = self.followed_seconds;
        let followed = workshop.drawing_pool.install(|| scene.followed(&snapshot.world, seconds_max));
        match followed {
            Ok(Some(next)) => self.scene = Some(Arc::new(next)),
            // By itself it may have room.
            Ok(None) | Err(GpuError::OutOfMemory { .. }) => return false,
            Err(error) => self.note_failure(&error, workshop),
        }
        self.worlds = vec![Arc::downgrade(&snapshot.world)];
        (self.light_revision, self.since) = (snapshot.light_revision, Some(Instant::now()));
        true
    }

    fn begin(&mut self, snapshot: &Snapshot, workshop: &Workshop) {
        let Some(gpu) = workshop.card.gpu() else { return };
        if workshop.card.is_busy.swap(true, SeqCst) {
            return;
        }
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&snapshot.world)));
        let outcome = Outcome::default();
        let has_focused = snapshot.plan.is_on(EffectKind::Caustics);
        let make_ready = {
            let (scene, outcome) = (Arc::clone(&scene), Arc::clone(&outcome));
            let is_busy = Arc::clone(&workshop.card.is_busy);
            move || {
                // Drivers may panic in wgpu: that is a failure like others.
                let made = catch_unwind(AssertUnwindSafe(|| {
                    Shading::all(has_focused).try_for_each(|shading| scene.make_ready(shading))?;
                    scene.make_ready_to_show()?;
                    if has_focused { scene.make_ready_to_sketch() } else { Ok(()) }
                }));
                let failed =
                    |_| Err(GpuError::Failed { what: "bringing the scene to the card panicked".into() });
                *lock(&outcome) = Some(made.unwrap_or_else(failed));
                is_busy.store(false, SeqCst);
            }
        };
        match std::thread::Builder::new().name("card".into()).spawn(make_ready) {
            Ok(_) => {
                (self.scene, self.stage) = (Some(scene), Stage::Coming(outcome));
                self.has_focused = has_focused;
            }
            Err(error) => {
                workshop.card.is_busy.store(false, SeqCst);
                tracing::warn!(%error, "no thread for the graphics card");
                self.stage = Stage::Later(Instant::now() + RETRY);
            }
        }
    }

    fn note_outcome(&mut self, workshop: &Workshop) {
        let Stage::Coming(outcome) = &self.stage else { return };
        let Some(result) = lock(outcome).take() else { return };
        match result {
            Ok(()) => self.stage = Stage::Ready,
            Err(error) => self.note_failure(&error, workshop),
        }
    }

    fn note_failure(&mut self, error: &GpuError, workshop: &Workshop) {
        self.stage = match error {
            GpuError::LightTooLarge { .. } => {
                // The scene stays, for pictures that look nothing up.
                tracing::warn!(%error, "pictures of looked-up light are drawn on the CPU until the scene's light changes");
                self.refuses_light = true;
                return;
            }
            GpuError::OutOfMemory { .. } => {
                tracing::warn!(%error, "the scene is drawn on the CPU");
                Stage::Refused
            }
            GpuError::Lost | GpuError::NoDevice { .. } | GpuError::NoAdapter { .. } => {
                tracing::warn!(%error, "drawing on the CPU until the graphics card is back");
                Stage::Later(Instant::now() + RETRY)
            }
            GpuError::Failed { .. } if workshop.card.refusals.fetch_add(1, SeqCst) < REFUSALS_MAX => {
                tracing::warn!(%error, "drawing on the CPU for a while");
                Stage::Later(Instant::now() + RETRY)
            }
            GpuError::Insufficient { .. }
            | GpuError::Shader { .. }
            | GpuError::TimedOut { .. }
            | GpuError::Failed { .. } => {
                workshop.card.give_up(error);
                Stage::Refused
            }
        };
        if let Some(scene) = &self.scene {
            scene.withdraw();
        }
    }
}

impl Drop for SceneOnCard {
    fn drop(&mut self) {
        self.leave();
    }
}
