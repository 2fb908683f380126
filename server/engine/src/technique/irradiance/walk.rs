//! Where records are missing: a walk over the picture from a coarse lattice of pixels to all of them.
//!
//! Each pixel is visited once. Those that no record covers get one; of neighbours that are found in the same batch, and would
//! mostly cover each other, all but one wait for the next.

use std::collections::VecDeque;

use glam::{UVec2, Vec3};
use rayon::prelude::*;

use super::{Facing, IrradianceCache, View};
use crate::{
    accel::{Hit, SurfacePoint},
    film::PictureSize,
    transport::World,
};

/// Pixels between the first that are visited.
const STRIDE_FIRST: u32 = 32;
/// Mirrors and glass passed on the way to a diffuse surface at most.
const SPECULAR_MAX: u32 = 6;
/// Pixels visited at once, and how many times in one batch at most.
const CHUNK: usize = 1024;
const CHUNKS_MAX: usize = 8;
/// Pixels of a batch lie at least so many strides apart.
const APART_STRIDES: u32 = 3;

/// Share of the scene's radius that a pixel is taken to be wide at most: the last records then count over a tenth of it, rough ones over a
/// fifth.
const PIXEL_MAX: f32 = 0.025;

/// Records are made so much of a pixel nearer to the middle of their triangle than pixels see it.
const INWARDS_PIXELS: f32 = 0.01;

/// A surface that a pixel sees, where it may need a record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) point: SurfacePoint,
    pub(super) facing: Facing,
    /// Width of a pixel there, or less where it is a great share of the scene, m.
    pub(super) pixel_m: f32,
}

/// See the module's head.
#[derive(Debug)]
pub(super) struct Walk {
    size: PictureSize,
    stride: u32,
    stride_first: u32,
    /// Number of the next pixel on the lattice.
    next: u32,
    waiting: VecDeque<UVec2>,
}

impl Walk {
    pub(super) fn over(size: PictureSize) -> Walk {
        Walk { size, stride: STRIDE_FIRST, stride_first: STRIDE_FIRST, next: 0, waiting: VecDeque::new() }
    }

    /// Over every pixel, row by row.
    pub(super) fn over_all(size: PictureSize) -> Walk {
        Walk { stride: 1, stride_first: 1, ..Walk::over(size) }
    }

    /// All pixels were visited.
    pub(super) fn is_complete(&self) -> bool {
        self.stride == 0 && self.waiting.is_empty()
    }

    /// Goes on until so many points without a record are found, or the batch or the walk ends.
    pub(super) fn missing(
        &mut self,
        world: &World,
        view: &View,
        cache: &IrradianceCache,
        count_max: usize,
    ) -> Vec<Seen> {
        let mut found: Vec<(UVec2, Seen)> = Vec::new();
        let mut later = VecDeque::new();
        for _ in 0..CHUNKS_MAX {
            let chunk: Vec<UVec2> =
                std::iter::from_fn(|| self.waiting.pop_front().or_else(|| self.advance()))
                    .take(CHUNK)
                    .collect();
            let is_covered = |seen: &Seen| cache.covers(seen.point.position, &seen.facing, seen.pixel_m);
            let missing: Vec<Option<Seen>> = chunk
                .par_iter()
                .with_min_len(64)
                .map(|pixel| {
                    let (seen, hit, direction) = seen_through(world, view, *pixel)?;
                    (!is_covered(&seen)).then(|| off_the_edge(world, &seen, &hit, direction))
                })
                .collect();
            let apart = APART_STRIDES * self.stride.max(1);
            for (pixel, seen) in chunk.iter().zip(missing) {
                let Some(seen) = seen else { continue };
                let is_near = |(other, _): &(UVec2, Seen)| {
                    other.as_ivec2().chebyshev_distance(pixel.as_ivec2()) < apart
                };
                if found.len() == count_max || found.iter().any(is_near) {
                    later.push_back(*pixel);
                } else {
                    found.push((*pixel, seen));
                }
            }
            if found.len() == count_max || chunk.is_empty() {
                break;
            }
        }
        // What was put off comes first next time.
        later.append(&mut self.waiting);
        self.waiting = later;
        found.into_iter().map(|(_, seen)| seen).collect()
    }

    /// The next pixel of the lattice that was on no coarser one.
    fn advance(&mut self) -> Option<UVec2> {
        while self.stride > 0 {
            let columns = self.size.width().div_ceil(self.stride);
            let rows = self.size.height().div_ceil(self.stride);
            while self.next < columns * rows {
                let at = UVec2::new(self.next % columns, self.next / columns);
                self.next += 1;
                if self.stride == self.stride_first || at.x % 2 == 1 || at.y % 2 == 1 {
                    return Some(at * self.stride);
                }
            }
            self.next = 0;
            self.stride /= 2;
        }
        None
    }
}

/// The first diffuse surface that the middle of a pixel sees, straight or by mirrors and glass; where, and the way of the ray that met it.
fn seen_through(world: &World, view: &View, pixel: UVec2) -> Option<(Seen, Hit, Vec3)> {
    let at = pixel.as_vec2() + 0.5;
    let mut ray = view.ray(at.x, at.y);
    let beside = view.ray(at.x + 1.0, at.y);
    let mut length_m = 0.0;
    for _ in 0..=SPECULAR_MAX {
        let hit = world.closest_hit(&ray)?;
        let surface = world.surface(&hit, ray.direction);
        length_m += hit.t;
        if surface.bsdf.has_diffuse() {
            let turned = beside.direction.distance(view.ray(at.x, at.y).direction);
            let moved_m = beside.origin.distance(view.ray(at.x, at.y).origin);
            let facing = Facing::of(&surface, -ray.direction);
            let pixel_m = (length_m * turned + moved_m).min(PIXEL_MAX * world.accel().radius());
            return Some((Seen { point: surface.point, facing, pixel_m }, hit, ray.direction));
        }
        let wo = surface.frame.to_local(-ray.direction);
        let drawn = surface.bsdf.sample(wo, [0.5, 0.5, 0.5])?;
        ray = surface.point.ray_towards(surface.frame.to_world(drawn.wi));
    }
    None
}

/// The same, a little nearer to the middle of its triangle. Cameras that look along axes at things of round sizes see edges in the very
/// middles of pixels: half of what is looked at from there lies behind the other surface, and records took in half of the light.
fn off_the_edge(world: &World, seen: &Seen, hit: &Hit, direction: Vec3) -> Seen {
    const THIRD: f32 = 1.0 / 3.0;
    let at = |b1: f32, b2: f32| world.surface(&Hit { b1, b2, ..*hit }, direction);
    let to_middle_m = at(THIRD, THIRD).point.position.distance(seen.point.position);
    let share = INWARDS_PIXELS * seen.pixel_m / to_middle_m;
    // In the middle of a triangle smaller than that there is no way to go.
    let share = if share < 1.0 { share } else { 1.0 };
    let [b1, b2] = [hit.b1, hit.b2].map(|b| b + share * (THIRD - b));
    let surface = at(b1, b2);
    Seen { point: surface.point, facing: Facing::of(&surface, -direction), ..*seen }
}
