//! What places see, by rasterisation: the twin of rays through the middles of their pixels.
//!
//! Hemispheres of records were sampled so when cards had no other way to look [Gautron2008, 8.4.1]. Every triangle before a plane
//! goes through the card for it, so that a place costs by the triangles of the scene, and pictures of few places and many pixels
//! gain most.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use bytemuck::{Pod, Zeroable};
use glam::{BVec3, DVec3, Vec3};
use lumicast_shaders::PLANES;
use rayon::prelude::*;

use super::{
    BATCH_SECONDS, LOSSES_MAX, SOFTWARE_BATCH_SECONDS,
    scene::{GpuScene, GpuWorld, Ready},
};
use crate::{
    accel::{Hit, Ray},
    gpu::{BindGroup, Binding, Draw, GpuError, GpuTrees, Layout, RasterPipeline, Session, Target},
    technique::Lookout,
    transport::World,
};

/// Columns of a target, about: smaller pictures stand side by side.
const TARGET_WIDTH: u32 = 1024;
/// Pixels of a target at most, where one picture has no more.
const TARGET_PIXELS_MAX: usize = 1 << 22;
/// Nothing nearer than this share of the scene's radius is seen: less than what rounding makes of where surfaces are.
const NEAREST: f32 = 1e-7;

/// `Plane` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPlane {
    pub(super) origin: [f32; 3],
    pub(super) half_width: f32,
    pub(super) right: [f32; 3],
    pub(super) half_height: f32,
    pub(super) up: [f32; 3],
    pub(super) nearest_m: f32,
    pub(super) back: [f32; 3],
    pub(super) left_instance: u32,
    pub(super) left_triangle: u32,
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
    pub(super) padding_2: u32,
}

impl GpuPlane {
    fn new(Lookout { view, left }: &Lookout, nearest_m: f32) -> GpuPlane {
        GpuPlane {
            origin: view.origin.into(),
            half_width: view.half_size[0],
            right: view.right.into(),
            half_height: view.half_size[1],
            up: view.up.into(),
            nearest_m,
            back: view.back.into(),
            left_instance: left.instance,
            left_triangle: left.triangle,
            ..GpuPlane::zeroed()
        }
    }
}

/// What draws.
#[derive(Debug)]
pub(super) struct Lookouts {
    pipeline: RasterPipeline,
    trees: BindGroup,
    scene: BindGroup,
    /// Of planes and draws.
    layout: Arc<Layout>,
    target: Option<Target>,
}

impl Lookouts {
    fn new(session: &Session, world: &GpuWorld) -> Result<Lookouts, GpuError> {
        let trees_layout = session.raster_layout(&GpuTrees::BINDINGS)?;
        let scene_layout = session.raster_layout(&GpuWorld::BINDINGS)?;
        let layout = session.raster_layout(&[Binding::Read, Binding::Read])?;
        let layouts = [&*trees_layout, &*scene_layout, &*layout];
        Ok(Lookouts {
            pipeline: session.raster_pipeline(&PLANES, &world.constants, &layouts)?,
            trees: session.bind(&trees_layout, &world.trees.buffers())?,
            scene: session.bind(&scene_layout, &world.buffers.iter().collect::<Vec<_>>())?,
            layout,
            target: None,
        })
    }
}

/// Where pictures of one size stand on a target.
#[derive(Clone, Copy)]
struct Sheet {
    size: [u32; 2],
    columns: u32,
}

impl Sheet {
    fn of(size: [u32; 2], count: usize) -> Sheet {
        Sheet { size, columns: (TARGET_WIDTH / size[0]).clamp(1, count.max(1) as u32) }
    }

    fn corner(self, number: usize) -> [u32; 2] {
        let number = number as u32;
        [number % self.columns * self.size[0], number / self.columns * self.size[1]]
    }

    fn target_size(self, count: usize) -> [u32; 2] {
        let width = (self.columns * self.size[0]).next_multiple_of(Target::WIDTH_STEP);
        [width, (count as u32).div_ceil(self.columns) * self.size[1]]
    }
}

/// All of an instance lies behind the eye.
fn is_behind(world: &World, instance: usize, Lookout { view, .. }: &Lookout) -> bool {
    let bounds = world.accel().instances()[instance].bounds_in_world();
    (0..8).all(|corner: u32| {
        let is_high = BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
        let p = world.accel().to_render(DVec3::select(is_high, bounds.max, bounds.min));
        // Nothing is left out by rounding that lies before it.
        (p - view.origin).dot(view.back) > 1e-4 * world.accel().radius()
    })
}

impl Ready {
    /// Words of the pixels of all lookouts, with the target's columns, and the seconds they took.
    fn draw(
        &mut self,
        world: &World,
        lookouts: &[Lookout],
        sheet: Sheet,
    ) -> Result<(Vec<u8>, u32, f64), GpuError> {
        let session = &self.session;
        let compiled = session.shader_seconds();
        let drawing = match &mut self.lookouts {
            Some(drawing) => drawing,
            nothing => nothing.insert(Lookouts::new(session, &self.world)?),
        };
        self.shader_seconds += session.shader_seconds() - compiled;
        let size = sheet.target_size(lookouts.len());
        let target = match drawing.target.take() {
            Some(target) if target.size() == size => target,
            _ => session.target("what places see", size)?,
        };
        let target = &*drawing.target.insert(target);
        let start = Instant::now();
        let nearest_m = (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE);
        let planes: Vec<GpuPlane> =
            lookouts.iter().map(|lookout| GpuPlane::new(lookout, nearest_m)).collect();
        let (mut names, mut draws): (Vec<[u32; 2]>, Vec<Draw>) = Default::default();
        for (plane, lookout) in lookouts.iter().enumerate() {
            for (instance, triangle_count) in self.triangle_counts.iter().enumerate() {
                if *triangle_count > 0 && !is_behind(world, instance, lookout) {
                    let (corner, number) = (sheet.corner(plane), names.len() as u32);
                    names.push([plane as u32, instance as u32]);
                    draws.push(Draw { corner, size: sheet.size, vertex_count: 3 * triangle_count, number });
                }
            }
        }
        let planes = session.buffer_of("planes", &planes)?;
        let names = session.buffer_of("draws", &names)?;
        let group = session.bind(&drawing.layout, &[&planes, &names])?;
        let mut batch = session.batch("what places see")?;
        batch.draw(&drawing.pipeline, &[&drawing.trees, &drawing.scene, &group], target, &draws)?;
        let words = batch.read_back_target(target)?;
        batch.submit()?;
        Ok((words.collect()?, size[0], start.elapsed().as_secs_f64()))
    }
}

impl GpuScene {
    /// What the middles of the pixels of all lookouts see, one lookout after the other, row by row: as
    /// [`World::closest_hit`] along [`Lookout::rays`], but for pixels that an edge passes through within rounding.
    ///
    /// - `lookouts`: perspective views of one size
    ///
    /// Errors: what the card does not do.
    pub fn visible(&self, lookouts: &[Lookout]) -> Result<Vec<Option<Hit>>, GpuError> {
        let Some(first) = lookouts.first() else { return Ok(Vec::new()) };
        let size = first.view.size();
        if lookouts.iter().any(|lookout| lookout.view.size() != size || !lookout.view.is_perspective) {
            return Err(GpuError::Failed { what: "only perspective views of one size are drawn".into() });
        }
        let pixel_count = size.pixel_count();
        let mut most = (TARGET_PIXELS_MAX / pixel_count).max(1);
        let seconds_max = if self.is_software { SOFTWARE_BATCH_SECONDS } else { BATCH_SECONDS };
        let mut at_once = 1;
        let mut hits = Vec::with_capacity(lookouts.len() * pixel_count);
        while hits.len() < lookouts.len() * pixel_count {
            let rest = &lookouts[hits.len() / pixel_count..];
            let now = &rest[..rest.len().min(at_once)];
            let sheet = Sheet::of([size.width(), size.height()], now.len());
            let world = self.world();
            let drawn = self.run(&mut *self.ready()?, |ready| ready.draw(world, now, sheet));
            let (words, columns, seconds) = match drawn {
                Ok(drawn) => drawn,
                Err(GpuError::Lost) if self.losses.fetch_add(1, Ordering::Relaxed) < LOSSES_MAX => continue,
                // Fewer may have room.
                Err(GpuError::OutOfMemory { .. }) if now.len() > 1 => {
                    most = now.len() / 2;
                    at_once = most;
                    continue;
                }
                Err(error) => return Err(error),
            };
            self.losses.store(0, Ordering::Relaxed);
            if seconds > seconds_max {
                at_once = (at_once / 2).max(1);
            } else if seconds < seconds_max / 3.0 {
                at_once = (2 * at_once).min(most);
            }
            let of_lookout = |(number, lookout): (usize, &Lookout)| {
                let [left, top] = sheet.corner(number);
                let width = size.width();
                let hit = |(pixel, ray)| {
                    let (x, y) = (left + pixel % width, top + pixel / width);
                    let at = 16 * (y as usize * columns as usize + x as usize);
                    hit_of(world, bytemuck::pod_read_unaligned(&words[at..at + 16]), &ray)
                };
                (0..).zip(lookout.rays()).map(hit).collect::<Vec<_>>()
            };
            let drawn: Vec<Vec<Option<Hit>>> = now.par_iter().enumerate().map(of_lookout).collect();
            hits.extend(drawn.into_iter().flatten());
        }
        Ok(hits)
    }
}

/// Where the ray meets the triangle that its pixel sees. A card moves corners to multiples of 1/256 of a pixel: what it says of where
/// the triangle is seen is off by as much, and far off where that is seen from the side.
///
/// - `words`: instance, triangle, and the weights of its second and third vertex on the card
fn hit_of(world: &World, words: [u32; 4], ray: &Ray) -> Option<Hit> {
    let [instance, triangle, b1, b2] = words;
    let placed = world.accel().instances().get(instance as usize)?;
    let corners = placed.mesh().triangles()[triangle as usize].map(|corner| placed.vertex_in_render(corner));
    let met = meet(ray, corners).unwrap_or_else(|| {
        let [b1, b2] = [b1, b2].map(f32::from_bits);
        let t = (placed.surface_point(triangle, b1, b2).position - ray.origin).dot(ray.direction);
        [t, b1, b2]
    });
    let [t, b1, b2] = met;
    (t > 0.0).then_some(Hit { t, instance, triangle, b1, b2 })
}

/// Distance along a unit direction, and the weights of the second and third corner, where the ray meets the plane of a triangle
/// [Moller1997]; where that is beyond an edge, where the edge is. `None` where the triangle has no area as seen from there.
pub(super) fn meet(ray: &Ray, corners: [Vec3; 3]) -> Option<[f32; 3]> {
    let [a, b, c] = corners.map(|corner| (corner - ray.origin).as_dvec3());
    let (direction, ab, ac) = (ray.direction.as_dvec3(), b - a, c - a);
    let across = direction.cross(ac);
    let volume = ab.dot(across);
    let b1 = -a.dot(across) / volume;
    let b2 = direction.dot(ab.cross(a)) / volume;
    if !(b1.is_finite() && b2.is_finite()) {
        return None;
    }
    let [b1, b2] = [b1, b2].map(|weight| weight.max(0.0));
    let scale = 1.0 / (b1 + b2).max(1.0);
    let [b1, b2] = [b1 * scale, b2 * scale];
    // Not where the plane is met: seen from the side that may be anywhere.
    let t = (a + ab * b1 + ac * b2).dot(direction);
    Some([t, b1, b2].map(|value| value as f32))
}
