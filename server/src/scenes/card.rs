//! The present scene on the graphics card, made ready beside the pictures: until it is there the CPU draws them, so that no
//! viewer waits for shaders or uploads.

use super::{Snapshot, Workshop};
use crate::config::Config;
use crate::graphics;
use lumicast_engine::gpu::{AdapterChoice, Gpu, GpuError};
use lumicast_engine::render::{Backend, Rendering};
use lumicast_engine::technique::path::GpuScene;
use lumicast_engine::transport::World;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex};

/// The card that all scenes are drawn on, if any.
#[derive(Debug, Default)]
pub struct Card {
    gpu: Option<Arc<Gpu>>,
    /// It failed in a way that trying again does not mend.
    is_given_up: AtomicBool,
}

impl Card {
    /// As the settings ask for it.
    ///
    /// Errors: `gpu` is asked for by name, and there is none.
    pub(super) fn open(config: &Config) -> Result<Card, GpuError> {
        let gpu = match config.backend.as_str() {
            "gpu" => Some(Gpu::open(AdapterChoice::Any)?),
            // A driver that computes on the CPU would take the cores from what computes there faster.
            "auto" if graphics::may_have_card() => Gpu::open(AdapterChoice::Hardware)
                .inspect_err(|error| tracing::info!(%error, "no graphics card is used"))
                .ok(),
            _ => None,
        };
        match &gpu {
            Some(gpu) => {
                let report = gpu.report();
                tracing::info!(adapter = report.name, kind = %report.kind, api = report.api, "drawing on a graphics card");
            }
            None => tracing::info!("drawing on the CPU"),
        }
        Ok(Card { gpu: gpu.map(Arc::new), is_given_up: AtomicBool::new(false) })
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

/// One scene on the card.
#[derive(Debug, Default)]
pub(super) struct SceneOnCard {
    /// Of the newest world that was begun with.
    scene: Option<Arc<GpuScene>>,
    /// What became of making it ready.
    outcome: Arc<Mutex<Option<Result<(), GpuError>>>>,
    is_ready: bool,
}

impl SceneOnCard {
    /// Begins to bring the present scene to the card, once what was begun before is done.
    pub(super) fn follow(&mut self, snapshot: &Snapshot, workshop: &Workshop) {
        let Some(gpu) = workshop.card.gpu() else {
            *self = SceneOnCard::default();
            return;
        };
        if self.scene.is_some() && !self.is_ready {
            match super::lock(&self.outcome).take() {
                // On its way.
                None => return,
                Some(Ok(())) => self.is_ready = true,
                Some(Err(error)) => {
                    workshop.card.give_up(&error);
                    return;
                }
            }
        }
        if self.scene.as_ref().is_some_and(|scene| Arc::ptr_eq(scene.world(), &snapshot.world)) {
            return;
        }
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&snapshot.world)));
        let outcome = Arc::new(Mutex::new(None));
        (self.scene, self.outcome, self.is_ready) = (Some(Arc::clone(&scene)), Arc::clone(&outcome), false);
        let make_ready = move || {
            // Most viewers look at light that is looked up.
            let result = scene.make_ready(true);
            *super::lock(&outcome) = Some(result);
        };
        if let Err(error) = std::thread::Builder::new().name("card".into()).spawn(make_ready) {
            tracing::warn!(%error, "no thread for the graphics card");
            *self = SceneOnCard::default();
        }
    }

    /// Lets the card draw a picture from its next pass on, if it has the picture's world ready; takes note where it failed.
    pub(super) fn draw(&self, rendering: &mut Rendering, workshop: &Workshop) {
        if let Some(error) = rendering.gpu_failure() {
            workshop.card.give_up(error);
            return;
        }
        let Some(scene) = self.scene.as_ref().filter(|_| self.is_ready && !rendering.is_on_gpu()) else {
            return;
        };
        let of_world = |world: &Arc<World>| Arc::ptr_eq(scene.world(), world);
        if of_world(rendering.world()) {
            // Pictures by records of irradiance stay on the CPU.
            let _ = rendering.draw_on(Arc::clone(scene));
        }
    }
}
