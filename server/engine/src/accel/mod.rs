//! Rays against the scene: a two-level bounding volume hierarchy, one bottom tree per mesh, instances on top.
//!
//! obvhs builds binary trees (PLOC, reinsertion); they are collapsed to eight children a node at the least expected cost
//! and walked by our own code, eight boxes or triangles at once with the vector instructions that the machine turns out
//! to have. Answers depend on nothing but the scene and the ray: not on the trees' shapes, nor on the instruction set,
//! nor on whether a ray was asked for alone or with others.
//!
//! Rays live in *render space*: the world moved so that its origin is near the middle of the scene, in single precision.
//! Transforms are composed in double precision, and instances are met in their own space, so a scene 100 km from the
//! world's origin is as exact as one at it. Where a ray meets a triangle is computed in double precision.
//!
//! Imports `scene`.

mod bottom;
mod bundle;
mod collapse;
mod instance;
mod instructions;
mod layout;
mod leaf;
mod node;
mod query;
mod ray;
mod restore;
mod stack;
mod top;
mod tree;
mod update;
mod upload;

use std::{collections::HashMap, sync::Arc};

use fearless_simd::Level;
use glam::{DVec3, Vec3};

pub use instance::{GAMMA_5, GAMMA_19, Instance, SurfacePoint};
pub use instructions::Instructions;
pub use ray::{Hit, Ray, TriangleId};
pub use upload::{
    AccelBuffers, GpuInstance, GpuNode, GpuPart, GpuTriangle, INSTANCE_IS_MIRRORED, INSTANCE_IS_ONLY_MOVED,
    MeshRange, START_COUNT_SHIFT, START_IS_LEAF, TRIANGLE_AXIS_SHIFT,
};

use crate::scene::{Aabb, Id, Mesh};
use bottom::BottomTree;
use restore::{Restorer, Top};

/// See [`Accel::cube_around`].
const CUBE_LARGER: f32 = 1.03;
const CUBE_LOW_OF_SIDE: f32 = 0.5071;

/// The trees of meshes by the meshes' ids, with the mesh that each was built for.
type Bottoms = HashMap<Id, (Arc<Mesh>, Arc<BottomTree>)>;

/// What building took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AccelReport {
    /// Seconds spent on bottom and top trees.
    pub build_seconds: f64,
    /// Bottom trees built (the rest were taken over).
    pub trees_built: usize,
    /// Bytes of nodes, triangle packets and the lists over instances.
    pub bytes: usize,
    /// Nodes and leaves of the top tree that a ray through the scene visits in the mean, by the surface area heuristic.
    pub top_sah_cost: f32,
    /// That cost after the last edit relative to when the tree was built: at 1.3 it is restored in the background, at 2 it
    /// is built again at once.
    pub top_growth: f32,
}

/// The whole scene as rays see it. Immutable: an edit makes a new one that shares what stayed.
#[derive(Clone, Debug)]
pub struct Accel {
    origin_in_world: DVec3,
    bottoms: Arc<Bottoms>,
    instances: Vec<Arc<Instance>>,
    /// Number of the instance of each node that shows something.
    numbers: Arc<HashMap<Id, u32>>,
    top: Arc<Top>,
    restorer: Arc<Restorer>,
    /// The instruction sets this machine has.
    level: Level,
    /// Entries that a walk through the deepest mesh may have waiting at once.
    bottom_stack_need: usize,
    /// Rounding on the way into the space of the most sheared instance, relative to the ray's origin.
    shear_rounding: f32,
    radius: f32,
    report: AccelReport,
}

impl Accel {
    /// The same trees walked with no more than these instructions, for comparing them: the answers are the same.
    pub fn limited_to(&self, instructions: Instructions) -> Accel {
        Accel { level: instructions.level(), ..self.clone() }
    }

    /// The world position of render space's origin.
    pub fn origin_in_world(&self) -> DVec3 {
        self.origin_in_world
    }

    /// Instances by the index that a [`Hit`] carries.
    pub fn instances(&self) -> &[Arc<Instance>] {
        &self.instances
    }

    /// The same meshes stand in the same places, by the same numbers.
    pub fn is_like(&self, other: &Accel) -> bool {
        let pairs = self.instances.iter().zip(&other.instances);
        self.origin_in_world == other.origin_in_world
            && self.instances.len() == other.instances.len()
            && pairs.into_iter().all(|(a, b)| Arc::ptr_eq(a, b))
    }

    /// What building took and holds.
    pub fn report(&self) -> AccelReport {
        let bottoms = self.bottoms.values().map(|(_, bottom)| bottom.bytes());
        AccelReport {
            bytes: bottoms.sum::<usize>() + self.top.bytes(),
            top_sah_cost: self.top.tree().tree().sah_cost(),
            ..self.report
        }
    }

    /// Turns a world position into render space.
    pub fn to_render(&self, p_in_world: DVec3) -> Vec3 {
        (p_in_world - self.origin_in_world).as_vec3()
    }

    /// Low corner and side, in render space, m, of a cube around some bounds: a little larger and off their middle. Walls at round shares of it
    /// then stand within parts of it, not between two, where rounding would decide.
    pub fn cube_around(&self, bounds: &Aabb) -> (Vec3, f32) {
        let [min, max] = [bounds.min, bounds.max].map(|corner| self.to_render(corner));
        let side_m = (max - min).max_element() * CUBE_LARGER;
        ((min + max) * 0.5 - Vec3::splat(side_m * CUBE_LOW_OF_SIDE), side_m)
    }

    /// Radius of the sphere around render space's origin that holds the scene; zero for an empty scene.
    pub fn radius(&self) -> f32 {
        self.radius
    }
}

#[cfg(all(test, feature = "gpu"))]
pub(crate) use upload::{tests as upload_tests, twin as upload_twin};
#[cfg(test)]
pub(crate) mod tests;
