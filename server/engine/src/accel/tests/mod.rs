//! Laws of ray casting. This file holds what they share: numbers, scenes, rays and a loop over all triangles.

mod bundles;
mod degenerate;
mod edits;
mod hits;
mod levels;
mod precision;
mod reference;
mod restoring;
mod stacks;
mod threads;
mod watertight;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use rayon::prelude::*;

use super::{
    bundle::{Bundle, RAYS},
    instructions::vectorized,
    layout::LeafOrder,
    leaf::{Leaves, Shear},
    node::inverse_of,
    *,
};
use crate::math::Rgb;
use crate::scene::{
    Id, Material, MeshSource, Scene,
    samples::{self, Stage, mesh_of},
};

/// The large counts of rays, minutes instead of seconds.
fn is_nightly() -> bool {
    std::env::var("LUMICAST_NIGHTLY").is_ok_and(|value| value == "1")
}

/// A small, well-known stream of numbers in [0, 1) [Steele2014, SplitMix64].
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub(crate) fn next(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn index(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    pub(crate) fn direction(&mut self) -> Vec3 {
        let (z, phi) = (1.0 - 2.0 * self.next(), self.next() * std::f64::consts::TAU);
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32)
    }

    pub(crate) fn point(&mut self, half_size: f64) -> DVec3 {
        DVec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5) * 2.0 * half_size
    }

    fn turn(&mut self) -> DMat3 {
        let axis = self.direction().as_dvec3().normalize();
        DMat3::from_quat(DQuat::from_axis_angle(axis, self.between(0.0, 6.0)))
    }

    /// Weights of a triangle's second and third corner.
    fn barycentric(&mut self) -> (f32, f32) {
        let (b1, b2) = (self.next() as f32, self.next() as f32);
        if b1 + b2 > 1.0 { (1.0 - b1, 1.0 - b2) } else { (b1, b2) }
    }
}

pub(crate) fn stage_with_grey() -> (Stage, Id) {
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
    (stage, grey)
}

/// Triangles that share no vertices.
fn loose(corners: impl IntoIterator<Item = [DVec3; 3]>, material: &Id) -> MeshSource {
    let positions: Vec<DVec3> = corners.into_iter().flatten().collect();
    let triangles = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    mesh_of(positions, triangles, material)
}

/// Triangles of `size` at random places up to `half_size` from the middle.
fn soup(numbers: &mut Numbers, count: usize, half_size: f64, size: f64, material: &Id) -> MeshSource {
    let corners = (0..count).map(|_| {
        let at = numbers.point(half_size);
        [0; 3].map(|_| at + numbers.point(size))
    });
    let corners: Vec<[DVec3; 3]> = corners.collect();
    loose(corners, material)
}

/// Triangles of 0.1 to 10 m in random directions whose width is a tenth to a ten-millionth of their length.
fn slivers(numbers: &mut Numbers, count: usize, half_size: f64, material: &Id) -> MeshSource {
    let corners = (0..count).map(|_| {
        let length = 10f64.powf(numbers.between(-1.0, 1.0));
        let width = length * 10f64.powf(numbers.between(-7.0, -1.0));
        let at = numbers.point(half_size);
        let (along, aside) =
            (numbers.direction().as_dvec3() * length, numbers.direction().as_dvec3() * width);
        [at, at + along, at + along * numbers.next() + aside]
    });
    let corners: Vec<[DVec3; 3]> = corners.collect();
    loose(corners, material)
}

/// One mesh where its author put it.
fn scene_of(mesh: impl FnOnce(&Id) -> MeshSource) -> Scene {
    placed(mesh, DAffine3::IDENTITY)
}

fn placed(mesh: impl FnOnce(&Id) -> MeshSource, world_from_mesh: DAffine3) -> Scene {
    let (mut stage, grey) = stage_with_grey();
    stage.place("mesh", mesh(&grey), world_from_mesh).unwrap();
    stage.finish()
}

/// Instances of a few triangles, all in one place: the tree over them is deep, as nothing tells them apart.
fn piled_up(numbers: &mut Numbers, count: usize) -> Scene {
    let (mut stage, grey) = stage_with_grey();
    stage.place("0", soup(numbers, 5, 0.5, 0.8, &grey), DAffine3::IDENTITY).unwrap();
    for index in 1..count {
        let node =
            crate::scene::Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Id::new("0") };
        stage.builder().add_node(Id::sanitised(&index.to_string(), "node"), node).unwrap();
    }
    stage.finish()
}

/// A loop over all triangles with the engine's own test of one triangle: what the tree must not change.
struct Loop<'a> {
    accel: &'a Accel,
    /// Per instance the triangles, each alone in its leaf.
    alone: Vec<(Leaves, Vec<u32>)>,
}

impl Loop<'_> {
    fn over(accel: &Accel) -> Loop<'_> {
        let alone = accel.instances().iter().map(|instance| {
            let triangles = 0..instance.mesh().triangles().len() as u32;
            let mut order = LeafOrder::default();
            let one_by_one = triangles.map(|triangle| {
                order.members.push(triangle);
                order.finish_leaf(order.members.len() - 1)
            });
            let numbers = one_by_one.collect();
            (Leaves::pack(instance.mesh(), &order), numbers)
        });
        Loop { accel, alone: alone.collect() }
    }

    fn closest_hit(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut closest: Option<Hit> = None;
        for (index, instance) in self.accel.instances().iter().enumerate() {
            let local = instance.ray_in_mesh(ray);
            let shear = Shear::new(&local, inverse_of(local.direction));
            let (leaves, numbers) = &self.alone[index];
            for leaf in numbers {
                let mut t_max = ray.t_max;
                vectorized!(Level::baseline(), simd => leaves.packet(*leaf).intersect(simd, &shear, &mut t_max, |met, _| {
                    let hit = Hit {
                        t: met.t,
                        instance: index as u32,
                        triangle: met.triangle,
                        b1: met.b1,
                        b2: met.b2,
                    };
                    if closest.as_ref().is_none_or(|best| hit.is_before(best)) && accept(&hit) {
                        closest = Some(hit);
                    }
                    false
                }));
            }
        }
        closest
    }
}

/// The tree answers as the loop does, to the last bit; returns how many rays hit.
fn assert_as_a_loop(accel: &Accel, rays: &[Ray], accept: impl Fn(&Hit) -> bool + Sync) -> usize {
    let all = Loop::over(accel);
    let hit_count = rays.par_iter().map(|ray| {
        let expected = all.closest_hit(ray, &accept);
        assert_eq!(accel.closest_hit(ray, &accept), expected, "{ray:?}");
        assert_eq!(accel.is_occluded(ray, &accept), expected.is_some(), "{ray:?}");
        usize::from(expected.is_some())
    });
    hit_count.sum()
}

/// Rays from random places up to `half_size` from the middle in random directions.
fn random_rays(numbers: &mut Numbers, count: usize, half_size: f64) -> Vec<Ray> {
    (0..count).map(|_| Ray::new(numbers.point(half_size).as_vec3(), numbers.direction())).collect()
}
