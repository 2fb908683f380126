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
use lumicast_shaders::{PLANES, Raster};
use rayon::prelude::*;

use super::{
    BATCH_SECONDS, LOSSES_MAX, SOFTWARE_BATCH_SECONDS,
    scene::{GpuScene, Ready},
    world::GpuWorld,
};
use crate::{
    accel::{Hit, Ray, TriangleId},
    gpu::{
        Batch, BindGroup, Binding, Buffer, Draw, GpuError, GpuTrees, Layout, Overlap, RasterPipeline,
        Session, Target,
    },
    technique::{Lookout, View},
    transport::World,
};

/// Columns of a target, about: smaller pictures stand side by side.
const TARGET_WIDTH: u32 = 1024;
/// Pixels of a target at most, where one picture has no more.
const TARGET_PIXELS_MAX: usize = 1 << 22;
/// Nothing nearer than this share of the scene's radius is seen: less than what rounding makes of where surfaces are.
pub(super) const NEAREST: f32 = 1e-7;

/// Share of the scene's radius by which something has to lie behind an eye to be left out.
pub(super) const BEHIND_ROOM: f32 = 1e-4;

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

/// What draws a scene's triangles onto planes.
#[derive(Debug)]
pub(super) struct SceneRaster {
    pub(super) pipeline: RasterPipeline,
    pub(super) trees: BindGroup,
    pub(super) scene: BindGroup,
    /// Of planes and draws.
    pub(super) layout: Arc<Layout>,
}

impl SceneRaster {
    pub(super) fn new(
        session: &Session,
        world: &GpuWorld,
        raster: &'static Raster,
    ) -> Result<SceneRaster, GpuError> {
        let [trees, scene, layout] = SceneRaster::layouts(session)?;
        let pipeline = session.raster_pipeline(raster, &world.constants, &[&trees, &scene, &layout])?;
        SceneRaster::bound(session, world, pipeline)
    }

    /// The same steps for a scene that has changed.
    pub(super) fn of_changed(self, session: &Session, world: &GpuWorld) -> Result<SceneRaster, GpuError> {
        SceneRaster::bound(session, world, self.pipeline)
    }

    fn bound(session: &Session, world: &GpuWorld, pipeline: RasterPipeline) -> Result<SceneRaster, GpuError> {
        let [trees, scene, layout] = SceneRaster::layouts(session)?;
        Ok(SceneRaster {
            pipeline,
            trees: session.bind(&trees, &world.trees.buffers())?,
            scene: session.bind(&scene, &world.buffers.each_ref())?,
            layout,
        })
    }

    /// Of trees, scene, planes and draws.
    fn layouts(session: &Session) -> Result<[Arc<Layout>; 3], GpuError> {
        Ok([
            session.raster_layout(&GpuTrees::BINDINGS)?,
            session.raster_layout(&GpuWorld::BINDINGS)?,
            session.raster_layout(&[Binding::Read, Binding::Read])?,
        ])
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
        let width = (self.columns * self.size[0]).next_multiple_of(Target::width_step(Overlap::Nearest));
        [width, (count as u32).div_ceil(self.columns) * self.size[1]]
    }
}

/// A lookout, and what of the scene is drawn for it.
struct Look<'a> {
    lookout: &'a Lookout,
    /// Instances that do not lie behind it.
    shown: Vec<usize>,
    /// Pixels, and triangles of those.
    work: usize,
}

impl<'a> Look<'a> {
    fn of(world: &World, lookout: &'a Lookout) -> Look<'a> {
        let instances = world.accel().instances();
        let shown: Vec<usize> =
            (0..instances.len()).filter(|instance| !is_behind(world, *instance, lookout)).collect();
        let triangles = shown.iter().map(|instance| instances[*instance].mesh().triangles().len());
        Look { lookout, work: lookout.view.size().pixel_count() + triangles.sum::<usize>(), shown }
    }
}

/// Corners of an instance's bounds, render space.
pub(super) fn corners_of_instance(world: &World, instance: usize) -> [Vec3; 8] {
    let bounds = world.accel().instances()[instance].bounds_in_world();
    std::array::from_fn(|corner| {
        let is_high = BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
        world.accel().to_render(DVec3::select(is_high, bounds.max, bounds.min))
    })
}

/// All of an instance lies behind the eye.
fn is_behind(world: &World, instance: usize, Lookout { view, .. }: &Lookout) -> bool {
    // Nothing is left out by rounding that lies before it.
    let room_m = BEHIND_ROOM * world.accel().radius();
    corners_of_instance(world, instance).iter().all(|corner| (*corner - view.origin).dot(view.back) > room_m)
}

/// What is drawn together: one, and as many more as take no more than `work_max` with it; `most` at most.
fn batch_of<'a>(looks: impl Iterator<Item = Look<'a>>, work_max: usize, most: usize) -> Vec<Look<'a>> {
    let mut work = 0;
    let fits = |look: &Look<'_>| {
        let is_first = work == 0;
        work += look.work;
        is_first || work <= work_max
    };
    looks.take(most).take_while(fits).collect()
}

/// What a batch of lookouts brought.
struct Drawn {
    /// Of the target's pixels, row by row.
    words: Vec<u8>,
    columns: u32,
    seconds: f64,
}

impl Ready {
    /// Draws them. For one alone all light goes where there is no room.
    fn draw(&mut self, world: &World, looks: &[Look<'_>], sheet: Sheet) -> Result<Drawn, GpuError> {
        match self.draw_in_room(world, looks, sheet) {
            Err(GpuError::OutOfMemory { .. }) if looks.len() == 1 => {
                self.known.forget(&self.session)?;
                self.draw_in_room(world, looks, sheet)
            }
            drawn => drawn,
        }
    }

    fn draw_in_room(&mut self, world: &World, looks: &[Look<'_>], sheet: Sheet) -> Result<Drawn, GpuError> {
        let target = self.target_of(looks.len(), sheet)?;
        let start = Instant::now();
        let mut batch = self.session.batch("what places see")?;
        let _named = self.record(world, looks, sheet, &target, &mut batch)?;
        let words = batch.read_back_target(&target)?;
        batch.submit()?;
        let columns = target.size()[0];
        Ok(Drawn { words: words.collect()?, columns, seconds: start.elapsed().as_secs_f64() })
    }

    fn target_of(&self, count: usize, sheet: Sheet) -> Result<Target, GpuError> {
        self.session.target("what places see", sheet.target_size(count), Overlap::Nearest)
    }

    /// Records in a batch what draws them onto a target; returns what has to live until the batch is done.
    fn record(
        &mut self,
        world: &World,
        looks: &[Look<'_>],
        sheet: Sheet,
        target: &Target,
        batch: &mut Batch,
    ) -> Result<[Buffer; 2], GpuError> {
        let session = &self.session;
        let compiled = session.shader_seconds();
        let drawing = match &mut self.lookouts {
            Some(drawing) => drawing,
            nothing => nothing.insert(SceneRaster::new(session, &self.world, &PLANES)?),
        };
        self.shader_seconds += session.shader_seconds() - compiled;
        let nearest_m = (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE);
        let planes: Vec<GpuPlane> = looks.iter().map(|look| GpuPlane::new(look.lookout, nearest_m)).collect();
        let (mut names, mut draws): (Vec<[u32; 2]>, Vec<Draw>) = Default::default();
        for (plane, look) in looks.iter().enumerate() {
            for instance in &look.shown {
                let (corner, number) = (sheet.corner(plane), names.len() as u32);
                names.push([plane as u32, *instance as u32]);
                let vertex_count = 3 * self.world.triangle_counts[*instance];
                draws.push(Draw { corner, size: sheet.size, vertex_count, number });
            }
        }
        let planes = session.buffer_of("planes", &planes)?;
        let names = session.buffer_of("draws", &names)?;
        let group = session.bind(&drawing.layout, &[&planes, &names])?;
        batch.draw(&drawing.pipeline, &[&drawing.trees, &drawing.scene, &group], target, &draws)?;
        Ok([planes, names])
    }

    /// Records in a batch what draws a picture, by itself on a target; returns that, and what has to live until the batch is done.
    pub(super) fn record_picture(
        &mut self,
        world: &World,
        view: &View,
        batch: &mut Batch,
    ) -> Result<(Target, [Buffer; 2]), GpuError> {
        let lookout = Lookout { view: *view, left: TriangleId::NONE };
        let sheet = Sheet::of([view.size().width(), view.size().height()], 1);
        let target = self.target_of(1, sheet)?;
        let named = self.record(world, &[Look::of(world, &lookout)], sheet, &target, batch)?;
        Ok((target, named))
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
        let world = self.world();
        let seconds_max = if self.is_software { SOFTWARE_BATCH_SECONDS } else { BATCH_SECONDS };
        let mut most = (TARGET_PIXELS_MAX / size.pixel_count()).max(1);
        // One is drawn first.
        let mut work_max = 0;
        let mut done = 0;
        let mut hits = Vec::with_capacity(lookouts.len() * size.pixel_count());
        while done < lookouts.len() {
            let rest = lookouts[done..].iter().map(|lookout| Look::of(world, lookout));
            let now = batch_of(rest, work_max, most);
            let sheet = Sheet::of([size.width(), size.height()], now.len());
            let drawn = self.ready().and_then(|mut held| {
                self.run(&mut held, |ready| match ready.draw(world, &now, sheet) {
                    // Nothing is half done then: what is on the card may stay.
                    Err(error @ GpuError::OutOfMemory { .. }) => Ok(Err(error)),
                    drawn => drawn.map(Ok),
                })
            });
            let drawn = match drawn.flatten() {
                Ok(drawn) => drawn,
                Err(GpuError::Lost) if self.losses.fetch_add(1, Ordering::Relaxed) < LOSSES_MAX => continue,
                Err(GpuError::OutOfMemory { .. }) if self.let_frame_go() => continue,
                // Fewer may have room.
                Err(GpuError::OutOfMemory { .. }) if now.len() > 1 => {
                    most = now.len() / 2;
                    continue;
                }
                Err(error) => return Err(error),
            };
            self.losses.store(0, Ordering::Relaxed);
            let work: usize = now.iter().map(|look| look.work).sum();
            if drawn.seconds > seconds_max {
                work_max = work / 2;
            } else if drawn.seconds < seconds_max / 3.0 {
                work_max = work_max.max(2 * work);
            }
            let of_lookout = |(number, look): (usize, &Look<'_>)| {
                let [left, top] = sheet.corner(number);
                let width = size.width();
                let hit = |(pixel, ray)| {
                    let (x, y) = (left + pixel % width, top + pixel / width);
                    let at = 16 * (y as usize * drawn.columns as usize + x as usize);
                    hit_of(world, bytemuck::pod_read_unaligned(&drawn.words[at..at + 16]), &ray)
                };
                (0..).zip(look.lookout.rays()).map(hit).collect::<Vec<_>>()
            };
            let of_batch: Vec<Vec<Option<Hit>>> = now.par_iter().enumerate().map(of_lookout).collect();
            hits.extend(of_batch.into_iter().flatten());
            done += now.len();
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
    let met = meet(ray, corners).filter(|[t, ..]| *t > 0.0).unwrap_or_else(|| {
        let [b1, b2] = [b1, b2].map(f32::from_bits);
        let t = (placed.surface_point(triangle, b1, b2).position - ray.origin).dot(ray.direction);
        [t, b1, b2]
    });
    let [t, b1, b2] = met;
    (t > 0.0).then_some(Hit { t, instance, triangle, b1, b2 })
}

/// Beside the walk's `accel/leaf.rs`, which knows that a ray hits and leaves out what rounding let in: the card has said that this pixel
/// sees the triangle, so that its ray meets it, be it at the edge.
///
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{film::PictureSize, scene::samples};
    use std::sync::Arc;

    /// A batch takes no more than it may, but for one alone; cheap ones before dear ones do not make it grow.
    #[test]
    fn batches_are_as_large_as_their_work_allows() {
        let world = World::prepare(Arc::new(samples::boxes().unwrap()));
        let size = PictureSize::new(4, 4).unwrap();
        let view = View::new(&world, &world.scene().camera_view(None).unwrap(), size);
        let ahead = Lookout { view, left: TriangleId::NONE };
        // Far behind all there is, looking away from it.
        let mut away = view;
        away.origin += 1e3 * view.back;
        (away.right, away.back) = (-view.right, -view.back);
        let away = Lookout { view: away, left: TriangleId::NONE };
        let [dear, cheap] = [ahead, away].map(|lookout| Look::of(&world, &lookout).work);
        assert!(cheap == 16 && dear > cheap, "{cheap} {dear}");
        let lookouts = [away, away, ahead, away, ahead];
        let count = |first: usize, work_max: usize, most: usize| {
            batch_of(lookouts[first..].iter().map(|of| Look::of(&world, of)), work_max, most).len()
        };
        assert_eq!([count(0, 0, 9), count(2, 0, 9), count(0, 2 * cheap, 9)], [1, 1, 2]);
        assert_eq!([count(0, 2 * cheap + dear, 9), count(0, 2 * cheap + dear - 1, 9)], [3, 2]);
        assert_eq!([count(0, usize::MAX, 4), count(0, usize::MAX, 9)], [4, 5]);
    }
}
