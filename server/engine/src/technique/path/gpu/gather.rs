//! Light gathered along rays on a graphics card: the twin of [`ArrivingLight`] for [`PathTracer`], many rays at once.
//!
//! Rays come from records of irradiance, with the keys of their random numbers; the paths that begin with them go through the same
//! steps as those of pixels, ask the light octree, and look past what is near as on the CPU. Radiance and distance come
//! back, ray by ray: sums and decisions stay with whoever gathers.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::{
    BOUNCES_END, GpuPassHeader, GpuScene, PathSettings, PathTracer, View, focus_of, handed,
    known::{LightBeside, undimmed},
    primary_ray,
    slices::Slices,
    tracing::{PathStart, RAY_SAMPLE_BYTES},
};
use crate::{
    accel::{Hit, Ray},
    film::PictureSize,
    gpu::GpuError,
    math::{Frame, Rgb, sobol::PixelSampler, warp},
    technique::{
        Arrived, ArrivingLight, Counts, GatherRay, Guide,
        path::cpu::{Near, Tracer},
    },
    transport::{PathClass, World},
};

/// Numbers of rays over a picture: what it sees, where they go, what they meet.
const SEEN_SEQUENCE: u32 = 0;
const DIRECTION_SEQUENCE: u32 = 1;
const GATHERED_SEQUENCE: u32 = 2;
/// Rays of a thread at a time where the CPU takes over.
const RAYS_AT_ONCE_ON_CPU: usize = 256;

/// Rays over the hemispheres of what the pixels of a picture see, as records send them, so many from each: for trying and measuring
/// gathering.
pub fn rays_over_a_picture(
    world: &World,
    view: &View,
    size: PictureSize,
    rays_per_pixel: u32,
) -> Vec<GatherRay> {
    let width = size.width();
    let rays_at = |pixel: u32| {
        let sampler = PixelSampler::new(0, SEEN_SEQUENCE, pixel, 0);
        let seen_along = primary_ray(view, pixel % width, pixel / width, &sampler);
        let hit = world.closest_hit(&seen_along);
        let surface = hit.map(|hit| world.surface(&hit, seen_along.direction));
        surface.into_iter().flat_map(move |surface| {
            let n = surface.frame.n;
            let frame = Frame::around(if seen_along.direction.dot(n) > 0.0 { -n } else { n });
            (0..rays_per_pixel).map(move |number| {
                let [u, v, ..] = PixelSampler::new(0, DIRECTION_SEQUENCE, pixel, number).four(0);
                let direction = frame.to_world(warp::cosine_hemisphere([u, v])).normalize();
                let sampler = PixelSampler::new(0, GATHERED_SEQUENCE, pixel, number);
                GatherRay { ray: surface.point.ray_towards(direction), sampler }
            })
        })
    };
    (0..size.pixel_count() as u32).into_par_iter().flat_map_iter(rays_at).collect()
}

/// `GatherRay` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuGatherRay {
    pub(super) origin: [f32; 3],
    pub(super) left_instance: u32,
    pub(super) direction: [f32; 3],
    pub(super) left_triangle: u32,
    pub(super) key: [u32; 2],
    pub(super) index: u32,
    pub(super) padding_0: u32,
}

impl GpuGatherRay {
    fn new(GatherRay { ray, sampler }: &GatherRay) -> GpuGatherRay {
        let (key, index) = sampler.name();
        GpuGatherRay {
            origin: ray.origin.into(),
            left_instance: ray.left.instance,
            direction: ray.direction.into(),
            left_triangle: ray.left.triangle,
            key: [key as u32, (key >> 32) as u32],
            index,
            padding_0: 0,
        }
    }
}

/// `RaySample` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuRaySample {
    pub(super) radiance: [f32; 3],
    pub(super) distance_m: f32,
    pub(super) index: u32,
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
    pub(super) padding_2: u32,
}

impl GpuRaySample {
    fn arrived(&self) -> Arrived {
        let distance_m = (self.distance_m >= 0.0).then_some(self.distance_m);
        Arrived { radiance: Rgb::from(self.radiance), distance_m }
    }
}

/// Why a card brought nothing.
enum Nothing {
    Cancelled,
    /// It gathers no more.
    Over,
}

/// What gathers on a card, for whoever asks; it goes on after lost devices, and after an error it gathers no more and says why.
#[derive(Debug)]
pub struct GpuGatherer {
    scene: Arc<GpuScene>,
    slices: Slices,
}

impl GpuGatherer {
    /// On the card that a scene is on.
    pub fn new(scene: Arc<GpuScene>) -> GpuGatherer {
        GpuGatherer { scene, slices: Slices::new(PathStart::Rays) }
    }

    /// Leaves everything to the CPU from now on.
    pub fn stop(&self) {
        self.slices.stop();
    }

    /// Why it gathers no more.
    pub fn failure(&self) -> Option<GpuError> {
        self.slices.failure()
    }

    /// Rays along which it has gathered.
    pub fn ray_count(&self) -> u64 {
        self.slices.path_count()
    }

    /// How many are best asked for together; 1 where the card does nothing.
    fn rays_at_once(&self) -> usize {
        self.slices.at_once().unwrap_or(1)
    }

    /// A slice.
    fn slice(&self, tracer: &PathTracer, rays: &[GatherRay]) -> Result<(Vec<Arrived>, Counts), GpuError> {
        let rays: Vec<GpuGatherRay> = rays.par_iter().map(GpuGatherRay::new).collect();
        let settings = &tracer.settings;
        let brought = settings.shown.beyond_diffuse();
        let (known, dimmed) = undimmed(tracer.secondary.as_ref());
        let header = GpuPassHeader {
            path_count: rays.len() as u32,
            traced: settings.traced.bits(),
            brought: brought.bits(),
            bounces_end: settings.bounces_max.unwrap_or(BOUNCES_END),
            dimmed: dimmed.to_array(),
            focus: focus_of(settings, None),
            ..GpuPassHeader::zeroed()
        };
        // In powers of two, so that a few more rays than before do not need other places.
        let room = rays.len().next_power_of_two();
        let light = LightBeside { known, ..LightBeside::default() };
        // Not with a lock held: a thread that waits here for others may begin to gather for other points.
        let arrived = |bytes: &[u8]| -> Vec<Arrived> {
            let samples = bytes.par_chunks_exact(RAY_SAMPLE_BYTES as usize);
            samples.map(|sample| bytemuck::pod_read_unaligned::<GpuRaySample>(sample).arrived()).collect()
        };
        let (mut arrived, slice) =
            self.scene.slice_of(PathStart::Rays, &rays, &header, room, light, arrived)?;
        self.slices.answered(&self.scene, header.path_count, slice.first_seconds);
        self.slices.count(u64::from(header.path_count));
        let mut counts = slice.counts;
        let on_cpu = Tracer {
            secondary: tracer.secondary.as_deref(),
            near: Near::LookedPast,
            // As cards sample.
            ..Tracer::of(self.scene.world(), PathSettings { knows_openings: false, ..tracer.settings })
        };
        for followed in handed::follow(&on_cpu, &slice.handed, |slot| Some(rays.get(slot)?.index)) {
            counts += followed.counts;
            let of_class = |class: &PathClass| {
                brought.contains(*class).then(|| followed.sample.radiance[*class as usize])
            };
            let more =
                PathClass::ALL.iter().filter_map(of_class).fold(Rgb::BLACK, |sum, of_class| sum + of_class);
            if let Some(arrived) = arrived.get_mut(followed.slot) {
                arrived.radiance += more;
            }
        }
        Ok((arrived, counts))
    }

    fn along(
        &self,
        tracer: &PathTracer,
        rays: &[GatherRay],
        cancel: &AtomicBool,
        counts: &mut Counts,
    ) -> Result<Vec<Arrived>, Nothing> {
        let mut arrived = Vec::with_capacity(rays.len());
        while arrived.len() < rays.len() {
            let Some(slice) = self.slices.next() else { return Err(Nothing::Over) };
            if cancel.load(Ordering::Relaxed) {
                return Err(Nothing::Cancelled);
            }
            let rest = &rays[arrived.len()..];
            match self.slice(tracer, &rest[..rest.len().min(slice)]) {
                Ok((of_slice, counts_of_slice)) => {
                    arrived.extend(of_slice);
                    *counts += counts_of_slice;
                }
                Err(error) => self.slices.fail(error),
            }
        }
        Ok(arrived)
    }
}

/// What arrives along rays as a [`PathTracer`] says, found on a card; by the CPU after a failure and in worlds that are not on the
/// card. A card's answers are the CPU's but for rounding.
#[derive(Debug)]
pub struct ArrivingByGpu {
    tracer: PathTracer,
    gatherer: Arc<GpuGatherer>,
}

impl ArrivingByGpu {
    /// What `tracer` answers.
    pub fn new(tracer: PathTracer, gatherer: Arc<GpuGatherer>) -> ArrivingByGpu {
        ArrivingByGpu { tracer, gatherer }
    }
}

impl ArrivingLight for ArrivingByGpu {
    fn radiance(
        &self,
        world: &World,
        ray: &Ray,
        met: Option<Hit>,
        sampler: &PixelSampler,
        counts: &mut Counts,
    ) -> Rgb {
        self.tracer.radiance(world, ray, met, sampler, counts)
    }

    fn guide(&self) -> Option<&Guide> {
        self.tracer.guide()
    }

    fn rays_at_once(&self) -> usize {
        self.gatherer.rays_at_once()
    }

    fn along(
        &self,
        world: &World,
        rays: &[GatherRay],
        cancel: &AtomicBool,
        counts: &mut Counts,
    ) -> Option<Vec<Arrived>> {
        if std::ptr::eq(world, &**self.gatherer.scene.world()) {
            let mut on_card = Counts::default();
            match self.gatherer.along(&self.tracer, rays, cancel, &mut on_card) {
                Ok(arrived) => {
                    *counts += on_card;
                    return Some(arrived);
                }
                Err(Nothing::Cancelled) => return None,
                Err(Nothing::Over) => {}
            }
        }
        let parts: Option<Vec<(Vec<Arrived>, Counts)>> = rays
            .par_chunks(RAYS_AT_ONCE_ON_CPU)
            .map(|rays| {
                let mut counts = Counts::default();
                let arrived = self.tracer.along(world, rays, cancel, &mut counts)?;
                Some((arrived, counts))
            })
            .collect();
        let (arrived, of_parts): (Vec<_>, Vec<_>) = parts?.into_iter().unzip();
        *counts += of_parts.into_iter().sum();
        Some(arrived.concat())
    }
}
