//! A scene on a card that follows edits: what stays of it stays there. Who drags a lamp changes little of it, and with every picture.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering},
};

use super::{
    scene::{GpuScene, Ready},
    world::{GpuWorld, PackedScene, constants_of},
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

/// Appearances of fewer bytes are brought whatever that takes: a few milliseconds.
const APPEARANCE_BYTES_MAX: usize = 4 << 20;

/// First passes shown after an edit before maps of shadows are drawn anew: whoever drags a lamp would have them drawn for a picture or two.
const MAPS_FROM: u32 = 8;

impl Ready {
    /// Steps that are compiled do for the scene as it is now.
    fn does_for(&self, changed: &Changed) -> bool {
        match changed {
            Changed::Appearance(packed) => self.world.does_for_appearance(packed),
            Changed::Scene(packed) => self.world.does_for(&constants_of(packed)),
        }
    }

    /// Holds the scene as it is now. Maps of shadows, if there were to be any, and what else was drawn of it are drawn again once they are
    /// asked for.
    fn follow(
        &mut self,
        world: &World,
        changed: &Changed,
        shadow_map_bytes_max: u64,
    ) -> Result<(), GpuError> {
        self.session.check()?;
        // Before there are two scenes for a moment.
        (self.shadowing, self.lookouts, self.splatting) = (None, None, None);
        match changed {
            Changed::Appearance(packed) => self.world.take_on(&self.session, packed)?,
            Changed::Scene(packed) => {
                let next = GpuWorld::new(&self.session, packed)?;
                let constants = std::mem::take(&mut self.world.constants);
                // What it takes on a busy machine is more than it takes.
                let seconds_per_byte = next.seconds_per_byte.min(self.world.seconds_per_byte);
                self.world = GpuWorld { constants, seconds_per_byte, ..next };
            }
        }
        if let Some(raster) = self.map_raster.take() {
            self.map_raster = Some(raster.of_changed(&self.session, &self.world)?);
        }
        if self.draws_maps {
            let lit = (world, changed.lights());
            self.shadowing = Ready::shadowing(&self.session, lit, shadow_map_bytes_max);
        }
        Ok(())
    }
}

impl GpuScene {
    /// The scene as it is now, with all that is on the card of this one, which is withdrawn: places for paths, light that is known, compiled
    /// steps. Where lights and materials alone differ ([`World::appearance_after`]) they are brought, else surfaces and trees as well, for which
    /// there must be room beside those that are there. `None`, and all stays as it is, where that would take long, other steps, or where nothing
    /// is there.
    ///
    /// - `seconds_max`: that bringing much may take, by what it took before
    ///
    /// Errors: what the card does not do; then this one is withdrawn.
    pub fn followed(&self, world: &Arc<World>, seconds_max: f64) -> Result<Option<GpuScene>, GpuError> {
        let Some(seconds_per_byte) = locked(&self.ready).as_ref().map(|ready| ready.world.seconds_per_byte)
        else {
            return Ok(None);
        };
        let is_soon = |bytes: usize| seconds_per_byte * bytes as f64 <= seconds_max;
        let appearance_bytes = world.appearance_bytes();
        let is_appearance_soon = appearance_bytes <= APPEARANCE_BYTES_MAX || is_soon(appearance_bytes);
        let appearance = is_appearance_soon.then(|| world.appearance_after(&self.world)).flatten();
        let changed = match appearance {
            Some(appearance) => Changed::Appearance(appearance),
            None if is_soon(world.surface_bytes() + appearance_bytes) => {
                Changed::Scene(Box::new(PackedScene::of(world)))
            }
            None => return Ok(None),
        };
        let frame = locked(&self.frame).take();
        let mut held = locked(&self.ready).take();
        let Some(ready) = held.as_mut().filter(|ready| ready.does_for(&changed)) else {
            (*locked(&self.frame), *locked(&self.ready)) = (frame, held);
            return Ok(None);
        };
        if let Err(error) = ready.follow(world, &changed, self.gpu.options().shadow_map_bytes_max) {
            self.let_go(&mut held);
            self.withdraw();
            return Err(error);
        }
        let next = GpuScene {
            frame: Mutex::new(frame),
            frames_refused_from: AtomicUsize::new(self.frames_refused_from.load(Ordering::Relaxed)),
            has_lost_by_maps: AtomicBool::new(self.has_lost_by_maps.load(Ordering::Relaxed)),
            pixels_at_once: AtomicU32::new(self.pixels_at_once.load(Ordering::Relaxed)),
            losses: AtomicU32::new(self.losses.load(Ordering::Relaxed)),
            gone_shader_seconds: Mutex::new(*locked(&self.gone_shader_seconds)),
            ready: Mutex::new(held),
            maps_from: MAPS_FROM,
            ..GpuScene::new(Arc::clone(&self.gpu), Arc::clone(world))
        };
        self.withdraw();
        Ok(Some(next))
    }
}
