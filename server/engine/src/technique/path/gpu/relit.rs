//! A scene on a card that takes on another light: who drags a lamp changes little of it, and with every picture.

use std::sync::{
    Arc, Mutex,
    atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering},
};

use super::scene::{GpuScene, Ready};
use crate::{
    gpu::{GpuError, locked},
    transport::{AppearanceBuffers, World},
};

impl Ready {
    /// Shows what surfaces look like now, and lights. Maps of shadows and what else was drawn of the scene are drawn again once they are
    /// asked for.
    fn take_on(
        &mut self,
        world: &World,
        packed: &AppearanceBuffers,
        shadow_map_bytes_max: u64,
    ) -> Result<(), GpuError> {
        self.session.check()?;
        (self.shadowing, self.lookouts, self.splatting) = (None, None, None);
        self.world.take_on(&self.session, packed)?;
        self.shadowing = Ready::shadowing(&self.session, (world, &packed.lights), shadow_map_bytes_max);
        Ok(())
    }
}

impl GpuScene {
    /// The scene as it is now, with all that is on the card of this one, which is withdrawn, where lights and materials alone differ
    /// ([`World::appearance_after`]): they are uploaded, and nothing else is. `None`, and all stays as it is, where more differs or nothing
    /// is there.
    ///
    /// Errors: what the card does not do; then this one is withdrawn.
    pub fn relit(&self, world: &Arc<World>) -> Result<Option<GpuScene>, GpuError> {
        let Some(packed) = world.appearance_after(&self.world) else { return Ok(None) };
        let frame = locked(&self.frame).take();
        let Some(mut ready) = locked(&self.ready).take() else {
            *locked(&self.frame) = frame;
            return Ok(None);
        };
        if let Err(error) = ready.take_on(world, &packed, self.gpu.options().shadow_map_bytes_max) {
            self.let_go(&mut Some(ready));
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
            ready: Mutex::new(Some(ready)),
            ..GpuScene::new(Arc::clone(&self.gpu), Arc::clone(world))
        };
        self.withdraw();
        Ok(Some(next))
    }
}
