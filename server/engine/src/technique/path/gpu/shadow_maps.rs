//! Maps of shadows: what lights without extent see, drawn once for a scene and asked by pictures of who moves [Williams1978].
//!
//! A picture of one sample shows shadows' edges by where that lies in its pixel, whatever tells them; rays for it are
//! 15 % of a path-traced pass of Sponza on a card. Maps tell where all around is lit or hidden alike, and the edges where texels are about as small as pixels; rays tell the rest
//! (`shadow_maps/planes.rs`). What they told is not kept: the next pass of a film that has only such a one replaces its light.

pub(super) mod planes;

use std::{
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use glam::Vec3;
use lumicast_shaders::Constant;

#[cfg(test)]
pub(super) use self::planes::GpuShadowPlane;
pub(super) use self::planes::{MapSides, ShadowPlanes};
use super::{
    lookouts::{BEHIND_ROOM, SceneRaster, corners_of_instance},
    scene::{GpuScene, Ready},
};
use crate::{
    gpu::{BindGroup, Binding, Buffer, Draw, GpuError, Layout, Overlap, Session, Target},
    transport::{GpuLight, World},
};

/// Who tells which lights without extent are hidden.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shadows {
    /// A ray each.
    #[default]
    ByRays,
    /// Maps, as far as they do.
    ByMaps,
}

/// Maps of a scene's lights on a card.
#[derive(Debug)]
pub(super) struct ShadowMaps {
    pub(super) group: BindGroup,
    /// Of all texels.
    pub(super) nearnesses: Buffer,
    _planes: Buffer,
    _of_lights: Buffer,
}

/// How steps see them.
pub(super) fn layout_of_maps(session: &Session) -> Result<Arc<Layout>, GpuError> {
    session.layout(&[Binding::Read, Binding::Read, Binding::Read])
}

/// Numbers that those who ask them go by.
pub(super) fn constants_of_maps() -> [(&'static str, Constant); 5] {
    [
        ("SHADOW_COS_LEAST", Constant::F32(planes::COS_LEAST)),
        ("SHADOW_TEXEL_SMOOTH", Constant::F32(planes::TEXEL_SMOOTH)),
        ("SHADOW_TEXEL_MOST", Constant::F32(planes::TEXEL_MOST)),
        ("SHADOW_ROOM_TEXELS", Constant::F32(planes::ROOM_TEXELS)),
        ("SHADOW_SURE", Constant::F32(planes::SURE)),
    ]
}

impl ShadowMaps {
    /// Draws them, one plane after the other.
    fn drawn(
        (session, drawing): (&Arc<Session>, &SceneRaster),
        world: &World,
        triangle_counts: &[u32],
        maps: &ShadowPlanes,
    ) -> Result<ShadowMaps, GpuError> {
        let texel_bytes = size_of::<f32>() as u64;
        let nearnesses = session.buffer_zeroed("shadow maps", u64::from(maps.texel_count) * texel_bytes)?;
        let planes = session.buffer_of("shadow planes", &maps.planes)?;
        let of_lights = session.buffer_of("shadow planes of lights", &maps.of_lights)?;
        let room_m = BEHIND_ROOM * world.accel().radius();
        let bounds: Vec<[Vec3; 8]> =
            (0..triangle_counts.len()).map(|instance| corners_of_instance(world, instance)).collect();
        let mut target: Option<Target> = None;
        for (number, plane) in maps.planes.iter().enumerate() {
            let target = match &mut target {
                Some(target) if target.size() == [plane.side; 2] => target,
                other => {
                    // Not both at once.
                    *other = None;
                    other.insert(session.target("shadow map", [plane.side; 2], Overlap::Nearness)?)
                }
            };
            let shown = (0..bounds.len()).filter(|instance| !plane.is_before(&bounds[*instance], room_m));
            let (names, draws): (Vec<[u32; 2]>, Vec<Draw>) = shown
                .enumerate()
                .map(|(draw, instance)| {
                    let vertex_count = 3 * triangle_counts[instance];
                    let drawn =
                        Draw { corner: [0, 0], size: [plane.side; 2], vertex_count, number: draw as u32 };
                    ([number as u32, instance as u32], drawn)
                })
                .unzip();
            let names = session.buffer_of("draws", &names)?;
            let group = session.bind(&drawing.layout, &[&planes, &names])?;
            let mut batch = session.batch("shadow map")?;
            batch.draw(&drawing.pipeline, &[&drawing.trees, &drawing.scene, &group], target, &draws)?;
            batch.copy_target(target, &nearnesses, u64::from(plane.first_texel) * texel_bytes)?;
            // One at a time, so that what keeps a card busy is short and nobody else's pass waits for all.
            batch.submit()?.wait()?;
        }
        let group = session.bind(&*layout_of_maps(session)?, &[&planes, &of_lights, &nearnesses])?;
        Ok(ShadowMaps { group, nearnesses, _planes: planes, _of_lights: of_lights })
    }
}

/// Maps of a scene, as far as there are any.
#[derive(Debug)]
pub(super) struct Shadowing {
    pub(super) planes: ShadowPlanes,
    /// Once somebody asked for them.
    maps: Option<ShadowMaps>,
}

impl Shadowing {
    /// `None` where no light has a map.
    pub(super) fn of(
        world: &World,
        lights: &[GpuLight],
        sides: MapSides,
        bytes_max: u64,
    ) -> Option<Shadowing> {
        let planes = ShadowPlanes::of(world, lights, sides, bytes_max)?;
        Some(Shadowing { planes, maps: None })
    }

    /// Has them drawn.
    pub(super) fn draw(
        &mut self,
        (session, drawing): (&Arc<Session>, &SceneRaster),
        world: &World,
        triangle_counts: &[u32],
    ) -> Result<(), GpuError> {
        if self.maps.is_none() {
            self.maps = Some(ShadowMaps::drawn((session, drawing), world, triangle_counts, &self.planes)?);
        }
        Ok(())
    }

    pub(super) fn maps(&self) -> Option<&ShadowMaps> {
        self.maps.as_ref()
    }
}

/// Maps of shadows of one scene, drawn by a card and by rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapsCompared {
    /// Of all maps.
    pub texels: usize,
    /// What drawing took the card, until it was done.
    pub card_seconds: f64,
    /// What rays took the CPU, by all threads.
    pub ray_seconds: f64,
    /// Texels that see something else than their ray.
    pub differing: usize,
}

impl GpuScene {
    /// Who tells shadows of first pictures that are shown, where nobody says. An adapter that is the CPU itself traces a ray in the time that
    /// asking takes: Sponza's pictures came after 1.70 s by rays and 1.83 by maps.
    pub(super) fn first_shadows(&self) -> Shadows {
        if self.is_software { Shadows::ByRays } else { Shadows::ByMaps }
    }

    /// The same of the one that begins: maps from the second on, of a scene that has followed an edit from the ninth on, since one that is
    /// edited from picture to picture would have them drawn for one alone.
    pub(super) fn shadows_of_first(&self) -> Shadows {
        let is_asked = self.first_shown.load(Ordering::Relaxed) >= self.maps_from;
        if is_asked && !self.has_lost_by_maps.load(Ordering::Relaxed) {
            Shadows::ByMaps
        } else {
            Shadows::ByRays
        }
    }

    /// Has maps of shadows, where there are to be any and they have room. Whatever else fails at them leaves shadows to rays.
    ///
    /// Errors: [`GpuError::Lost`].
    pub(super) fn draw_maps(&self, ready: &mut Ready) -> Result<(), GpuError> {
        match ready.draw_maps(&self.world) {
            Err(GpuError::Lost) => {
                self.has_lost_by_maps.store(true, Ordering::Relaxed);
                Err(GpuError::Lost)
            }
            Err(_) => {
                ready.let_maps_go();
                Ok(())
            }
            Ok(()) => Ok(()),
        }
    }

    /// Compiles what draws maps and asks them, where there are to be any. A card that cannot leaves shadows to rays.
    ///
    /// Errors: [`GpuError::Lost`].
    pub(super) fn make_ready_to_map(&self) -> Result<(), GpuError> {
        self.run(&mut *self.ready()?, |ready| match ready.be_able_to_map() {
            Err(GpuError::Lost) => Err(GpuError::Lost),
            Err(_) => {
                ready.let_maps_go();
                Ok(())
            }
            Ok(()) => Ok(()),
        })
    }

    /// Draws the maps of shadows once more, on the card and by rays on the CPU; `None` where no light has any.
    ///
    /// Errors: what the card does not do.
    pub fn compare_shadow_maps(&self) -> Result<Option<MapsCompared>, GpuError> {
        self.make_ready_to_map()?;
        let drawn = self.run(&mut *self.ready()?, |ready| {
            let Some(shadowing) = &mut ready.shadowing else { return Ok(None) };
            // Not both at once.
            shadowing.maps = None;
            let start = Instant::now();
            ready.draw_maps(&self.world)?;
            let Some((shadowing, maps)) =
                ready.shadowing.as_ref().and_then(|shadowing| Some((shadowing, shadowing.maps()?)))
            else {
                return Ok(None);
            };
            // A word is there once all of it is.
            ready.session.read(&maps.nearnesses, 0..size_of::<f32>() as u64)?;
            let card_seconds = start.elapsed().as_secs_f64();
            let bytes = ready.session.read(&maps.nearnesses, 0..maps.nearnesses.byte_count())?;
            Ok(Some((
                shadowing.planes.clone(),
                card_seconds,
                bytemuck::pod_collect_to_vec::<u8, f32>(&bytes),
            )))
        })?;
        Ok(drawn.map(|(planes, card_seconds, by_card)| {
            let start = Instant::now();
            let by_rays = planes.by_rays(&self.world);
            MapsCompared {
                texels: by_rays.len(),
                card_seconds,
                ray_seconds: start.elapsed().as_secs_f64(),
                differing: planes.differing(&by_card, &by_rays),
            }
        }))
    }
}
