//! The last paths of a slice, which go on by the CPU.
//!
//! A scattering of a few paths takes a card as long as one of thousands: what it waits for is one ray after the other to go through the
//! trees. Light that is caught in glass comes out after hundreds of scatterings, so that slices of half a million paths spent most of their
//! time on the last ten. After [`HANDED_AFTER`] scatterings paths come back as they are, if no more than [`HANDED_MAX`] are left, and the
//! CPU takes them to their ends by the same numbers ([`Tracer::follow`]) while the card traces the next slice.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use lumicast_shaders::PATH_HAND_OVER;
use rayon::prelude::*;

use super::tracing::PATH_BYTES;
use crate::{
    accel::{Ray, TriangleId},
    film::PixelSample,
    gpu::{Batch, BindGroup, Binding, Buffer, GpuError, Layout, Pipeline, ReadBack, Session},
    math::sobol::PixelSampler,
    technique::{
        Counts,
        path::cpu::{Sightline, Tracer, Underway},
    },
    transport::{PathClass, World},
};

use std::sync::Arc;

/// Paths that are handed over, at most: those that lose next to nothing go on for 50 scatterings in the mean, and 16 threads follow a thousand
/// of them in some 5 ms, about as long as a card takes for a slice.
pub(super) const HANDED_MAX: u32 = 1024;
/// And at most one of so many of a slice: the next is as large, and the card is not to wait for the CPU.
const HANDED_SHARE: u32 = 16;
/// Scatterings before any are: of most scenes none is left by then.
pub(super) const HANDED_AFTER: u32 = 16;
/// `Path::passing` in WGSL.
pub(super) const IS_NEAR: u32 = 1;
pub(super) const IS_BY_MIRRORS: u32 = 2;
/// Some surface was neither a mirror nor clear glass, or the path went where glass shows less from; a fresh path's word is nothing.
pub(super) const IS_CLOUDED: u32 = 4;
/// Some surface was glass.
pub(super) const IS_BY_GLASS: u32 = 8;
pub(super) const NEAR_COUNT_SHIFT: u32 = 4;

/// `Path` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPath {
    pub(super) origin: [f32; 3],
    pub(super) medium: u32,
    pub(super) direction: [f32; 3],
    pub(super) class_so_far: u32,
    pub(super) throughput: [f32; 3],
    pub(super) bounce: u32,
    pub(super) last_position: [f32; 3],
    pub(super) last_pdf: f32,
    pub(super) last_n: [f32; 3],
    pub(super) eta_squared: f32,
    pub(super) left_instance: u32,
    pub(super) left_triangle: u32,
    pub(super) key: [u32; 2],
    pub(super) lost_m: f32,
    pub(super) passing: u32,
    pub(super) since_gathered: u32,
    pub(super) padding_0: u32,
}

const _: () = assert!(size_of::<GpuPath>() as u64 == PATH_BYTES);

/// `HandedPath` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuHandedPath {
    pub(super) path: GpuPath,
    pub(super) slot: u32,
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
    pub(super) padding_2: u32,
}

impl GpuHandedPath {
    /// `None` for what no shader of ours hands over: what a driver makes of it is not ours.
    ///
    /// - `index`: of its sampler
    pub(super) fn underway(&self, world: &World, index: u32) -> Option<Underway> {
        let path = &self.path;
        let left = TriangleId { instance: path.left_instance, triangle: path.left_triangle };
        let key = u64::from(path.key[1]) << 32 | u64::from(path.key[0]);
        let medium = path.medium.checked_sub(1);
        Some(Underway {
            ray: Ray { origin: path.origin.into(), direction: path.direction.into(), t_max: f32::MAX, left },
            throughput: path.throughput.into(),
            class: *PathClass::ALL.get(path.class_so_far as usize)?,
            bounce: path.bounce,
            eta_squared: path.eta_squared,
            last: (path.last_pdf >= 0.0).then(|| {
                let [position, n] = [path.last_position, path.last_n].map(Vec3::from);
                (position, n, path.last_pdf)
            }),
            medium: medium.and_then(|material| world.absorption_in(material as usize)),
            lost_m: path.lost_m,
            is_near: path.passing & IS_NEAR != 0,
            near_count: path.passing >> NEAR_COUNT_SHIFT,
            is_by_mirrors: path.passing & IS_BY_MIRRORS != 0,
            since_gathered: path.since_gathered,
            sightline: match path.passing {
                passing if passing & IS_CLOUDED != 0 => Sightline::Clouded,
                passing if passing & IS_BY_GLASS != 0 => Sightline::Glass,
                _ => Sightline::Straight,
            },
            sampler: PixelSampler::named(key, index),
        })
    }
}

/// What else a path has brought.
#[derive(Clone, Copy, Debug)]
pub(super) struct Followed {
    /// Of its slice.
    pub(super) slot: usize,
    /// Light, and what is seen by way of mirrors and glass, if that was not found before.
    pub(super) sample: PixelSample,
    pub(super) counts: Counts,
}

/// How many of a slice of so many are handed over, at most.
pub(super) fn handed_max(path_count: u32) -> u32 {
    path_count.div_ceil(HANDED_SHARE).min(HANDED_MAX)
}

/// Takes paths to their ends, on the rayon pool that it is called in: nothing of the card is to be held. In the order in which they came.
///
/// - `index`: of the sampler of a slot's path; `None` for slots that the slice has not
pub(super) fn follow(
    tracer: &Tracer<'_>,
    handed: &[GpuHandedPath],
    index: impl Fn(usize) -> Option<u32> + Sync,
) -> Vec<Followed> {
    let followed = |handed: &GpuHandedPath| {
        let slot = handed.slot as usize;
        let mut counts = Counts::default();
        let underway = handed.underway(tracer.world, index(slot)?)?;
        let sample = tracer.follow(&underway, &mut counts);
        Some(Followed { slot, sample, counts })
    };
    handed.par_iter().with_max_len(1).filter_map(followed).collect()
}

/// What hands paths over.
#[derive(Debug)]
pub(super) struct HandOver {
    pipeline: Arc<Pipeline>,
    handed: Buffer,
    group: BindGroup,
}

impl HandOver {
    /// - `layouts`, `constants`: of paths' steps
    pub(super) fn new(
        session: &Session,
        layouts: [&Layout; 3],
        constants: &[(&'static str, lumicast_shaders::Constant)],
    ) -> Result<HandOver, GpuError> {
        let bytes = u64::from(HANDED_MAX) * size_of::<GpuHandedPath>() as u64;
        let handed = session.buffer_zeroed("paths handed over", bytes)?;
        let layout = session.layout(&[Binding::Write])?;
        let group = session.bind(&layout, &[&handed])?;
        let [trees, world, places] = layouts;
        let pipeline = session.pipeline(&PATH_HAND_OVER, constants, &[trees, world, places, &*layout])?;
        Ok(HandOver { pipeline, handed, group })
    }

    /// Paths that are left after a batch, as far as there is room for all of them.
    ///
    /// - `groups`: of trees, world and places
    pub(super) fn record(&self, batch: &mut Batch, groups: [&BindGroup; 3]) -> Result<ReadBack, GpuError> {
        let [trees, world, places] = groups;
        let workgroups = self.pipeline.workgroups(u64::from(HANDED_MAX));
        batch.dispatch(&self.pipeline, &[trees, world, places, &self.group], workgroups)?;
        batch.read_back(&self.handed, 0..self.handed.byte_count())
    }
}
