//! A scene on a card that follows edits: what stays of it stays there. Who drags a lamp changes little of it, and with every picture.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering},
};

use super::{
    scene::{GpuScene, Ready},
    world::{GpuWorld, PackedScene},
};
use crate::{
    gpu::{GpuError, locked},
    transport::{AppearanceBuffers, GpuLight, World},
};

/// What is to be brought of a scene that has changed.
enum Changed {
    /// What surfaces look like, and lights.
    Appearance(AppearanceBuffers),
    /// All.
    Scene(Box<PackedScene>),
}

impl Changed {
    fn lights(&self) -> &[GpuLight] {
        match self {
            Changed::Appearance(packed) => &packed.lights,
            Changed::Scene(packed) => packed.lights(),
        }
    }
}

impl Ready {
    /// Holds the scene as it is now. Maps of shadows, if there were to be any, and what else was drawn of it are drawn again once they are
    /// asked for. False, and all stays as it is, where steps would have to be compiled anew.
    fn follow(
        &mut self,
        world: &World,
        changed: &Changed,
        shadow_map_bytes_max: u64,
    ) -> Result<bool, GpuError> {
        self.session.check()?;
        match changed {
            Changed::Appearance(packed) => self.world.take_on(&self.session, packed)?,
            Changed::Scene(packed) => {
                let next = GpuWorld::new(&self.session, packed)?;
                if next.constants != self.world.constants {
                    return Ok(false);
                }
                self.world = next;
            }
        }
        // Where there were to be none what draws them is not compiled, or there was no room.
        if self.shadowing.take().is_some() {
            let lit = (world, changed.lights());
            self.shadowing = Ready::shadowing(&self.session, lit, shadow_map_bytes_max);
        }
        (self.lookouts, self.splatting) = (None, None);
        Ok(true)
    }
}

impl GpuScene {
    /// The scene as it is now, with all that is on the card of this one, which is withdrawn: places for paths, light that is known, compiled
    /// steps. Where lights and materials alone differ ([`World::appearance_after`]) they are brought, else surfaces and trees as well. `None`,
    /// and all stays as it is, where that would take long, other steps, or where nothing is there.
    ///
    /// - `seconds_max`: that bringing all may take, by what it took last
    ///
    /// Errors: what the card does not do; then this one is withdrawn.
    pub fn followed(&self, world: &Arc<World>, seconds_max: f64) -> Result<Option<GpuScene>, GpuError> {
        let is_soon = || {
            let held = locked(&self.ready);
            held.as_ref().is_some_and(|ready| ready.world.brought_seconds <= seconds_max)
        };
        let changed = match world.appearance_after(&self.world) {
            Some(appearance) => Changed::Appearance(appearance),
            None if is_soon() => Changed::Scene(Box::new(PackedScene::of(world))),
            None => return Ok(None),
        };
        let frame = locked(&self.frame).take();
        let mut held = locked(&self.ready).take();
        let followed = match &mut held {
            Some(ready) => ready.follow(world, &changed, self.gpu.options().shadow_map_bytes_max),
            None => Ok(false),
        };
        match followed {
            Ok(true) => {}
            Ok(false) => {
                (*locked(&self.frame), *locked(&self.ready)) = (frame, held);
                return Ok(None);
            }
            Err(error) => {
                self.let_go(&mut held);
                self.withdraw();
                return Err(error);
            }
        }
        let next = GpuScene {
            frame: Mutex::new(frame),
            frames_refused_from: AtomicUsize::new(self.frames_refused_from.load(Ordering::Relaxed)),
            has_lost_by_maps: AtomicBool::new(self.has_lost_by_maps.load(Ordering::Relaxed)),
            pixels_at_once: AtomicU32::new(self.pixels_at_once.load(Ordering::Relaxed)),
            losses: AtomicU32::new(self.losses.load(Ordering::Relaxed)),
            gone_shader_seconds: Mutex::new(*locked(&self.gone_shader_seconds)),
            ready: Mutex::new(held),
            ..GpuScene::new(Arc::clone(&self.gpu), Arc::clone(world))
        };
        self.withdraw();
        Ok(Some(next))
    }
}
