//! Photons and octrees, built by the clock.

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use glam::Vec3;
use lumicast_engine::{
    film::PictureSize,
    technique::{
        MAPPED, PhotonProduct, Products, SecondaryLight, Step, Technique,
        octree::{LightOctree, OctreeBuilding, OctreeSettings},
        path::View,
        photons::{PhotonSettings, PhotonTracing},
    },
    transport::{Surface, World},
};
use rayon::prelude::*;

use super::subject::Prepared;

/// Photons of the pilot run: enough to know the share that maps keep to a percent.
const PILOT_COUNT: u32 = 50_000;

/// Emitted photons per kept one at most: where fewer are kept, a scene hides its lights, and memory has an end.
const EMITTED_PER_KEPT_MAX: f64 = 64.0;

/// Traced photons in their maps.
pub(super) struct Photons {
    /// The photons as they are kept, with what made them.
    pub(super) tracing: PhotonTracing,
    /// Asked of the lights.
    pub(super) asked_count: u32,
    /// Photons in the maps of all classes.
    pub(super) kept_count: usize,
    /// Tracing and mapping, wall clock.
    pub(super) seconds: f64,
}

impl Photons {
    /// About `kept_count` photons in the maps of `world`; lights emit what a pilot run says it takes.
    pub(super) fn about(world: &World, kept_count: u32) -> Photons {
        let pilot = Photons::emitted(world, PILOT_COUNT.min(kept_count).max(1));
        let share = pilot.kept_count as f64 / pilot.tracing.paths().path_count().max(1) as f64;
        let emitted = f64::from(kept_count) / share.max(1.0 / EMITTED_PER_KEPT_MAX);
        Photons::emitted(world, emitted.round().min(f64::from(u32::MAX)) as u32)
    }

    fn emitted(world: &World, asked_count: u32) -> Photons {
        let settings = PhotonSettings { emitted_count: asked_count, ..PhotonSettings::default() };
        let start = Instant::now();
        let mut tracing = PhotonTracing::new(settings);
        let (mut products, never) = (Products::default(), AtomicBool::new(false));
        while !tracing.is_complete() {
            tracing.step(&mut Step { world, products: &mut products, canvas: None, cancel: &never });
        }
        let seconds = start.elapsed().as_secs_f64();
        let maps = &tracing.product().maps;
        let kept_count = MAPPED.into_iter().map(|class| maps.photon_count(class)).sum();
        Photons { kept_count, tracing, asked_count, seconds }
    }

    /// The maps.
    pub(super) fn product(&self) -> &Arc<PhotonProduct> {
        self.tracing.product()
    }
}

/// What an octree is built with, as the paper varies it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// Halvings of the scene's cube.
    pub(super) depth: u32,
    /// Photons to gather.
    pub(super) neighbour_count: u32,
    /// Lights kept of them.
    pub(super) vdl_count: u32,
}

/// An octree and what it took.
pub(super) struct Built {
    /// The octree.
    pub(super) octree: Arc<LightOctree>,
    /// Finding the cells, wall clock.
    pub(super) voxel_seconds: f64,
    /// Gathering and clustering, wall clock.
    pub(super) build_seconds: f64,
}

/// The octree of `photons`, built `times` times, the fastest build: other work on the machine can only slow a build down.
/// `None` for a scene without surface.
pub(super) fn build(world: &World, photons: &Photons, shape: Shape, times: usize) -> Option<Built> {
    let built = (0..times).filter_map(|_| build_once(world, photons, shape));
    built.min_by(|a, b| a.build_seconds.total_cmp(&b.build_seconds))
}

fn build_once(world: &World, photons: &Photons, shape: Shape) -> Option<Built> {
    let count = |value: u32| NonZeroUsize::new(value as usize).unwrap_or(NonZeroUsize::MIN);
    let settings = OctreeSettings {
        depth_first: shape.depth,
        depth: shape.depth,
        vdl_count: count(shape.vdl_count),
        photon_count: photons.asked_count,
        ..OctreeSettings::default()
    }
    .gathering(count(shape.neighbour_count));
    let start = Instant::now();
    let mut building = OctreeBuilding::new(settings);
    let mut products = Products { photons: Some(photons.product().clone()), ..Products::default() };
    let never = AtomicBool::new(false);
    let mut step = Step { world, products: &mut products, canvas: None, cancel: &never };
    while !building.step(&mut step).complete {}
    let octree = building.octree()?.clone();
    let voxel_seconds = octree.counts().voxel_seconds;
    Some(Built { voxel_seconds, build_seconds: start.elapsed().as_secs_f64() - voxel_seconds, octree })
}

/// Shortest measurement of look-ups: long against the clock's grain and against starting threads.
const LOOK_UP_SECONDS: f64 = 0.4;

/// Look-ups of `light` per second, all threads together, at the surfaces that the camera sees.
pub(super) fn look_ups_per_second(prepared: &Prepared, light: &dyn SecondaryLight) -> Option<f64> {
    let seen = seen_surfaces(prepared);
    if seen.is_empty() {
        return None;
    }
    let start = Instant::now();
    let mut count = 0usize;
    while start.elapsed().as_secs_f64() < LOOK_UP_SECONDS {
        // Pieces as large as a tile of a picture: the cost of sharing them out is lost in them.
        seen.par_chunks(1024).for_each(|surfaces| {
            for (surface, wo) in surfaces {
                std::hint::black_box(light.scattered(surface, *wo, None));
            }
        });
        count += seen.len();
    }
    Some(count as f64 / start.elapsed().as_secs_f64())
}

/// The surface with a diffuse lobe behind every pixel's middle, with the direction to the eye.
fn seen_surfaces(prepared: &Prepared) -> Vec<(Surface, Vec3)> {
    let (world, size): (&World, PictureSize) = (&prepared.world, prepared.size);
    let view = View::new(world, &prepared.view, size);
    let pixels = (0..size.height()).flat_map(|y| (0..size.width()).map(move |x| (x, y)));
    let surfaces = pixels.filter_map(|(x, y)| {
        let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5);
        let surface = world.surface(&world.closest_hit(&ray)?, ray.direction);
        surface.bsdf.has_diffuse().then_some((surface, -ray.direction))
    });
    surfaces.collect()
}
