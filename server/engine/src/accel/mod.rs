//! Rays against the scene: a two-level bounding volume hierarchy, one bottom tree per mesh, instances on top.
//!
//! Trees are built by `obvhs` (PLOC, reinsertion) and collapsed to four children a node; the traversal and
//! the watertight triangle test are ours. Rays live in *render space*: the world moved so that the middle
//! of the scene is its origin, in single precision. Transforms are composed in double precision, so a
//! scene 100 km from the world's origin is as exact as one at it.
//!
//! Imports `math` and `scene`.

mod bottom;
mod instance;
mod leaf;
mod node;
mod ray;
mod restore;
mod top;
mod tree;
mod update;
mod upload;

use std::{collections::HashMap, sync::Arc};

use fearless_simd::{Level, Simd, dispatch};
use glam::{DVec3, Vec3};

pub use instance::{Instance, SurfacePoint};
pub use ray::{Hit, Ray};
pub use upload::{
    AccelBuffers, GpuInstance, GpuNode, GpuPart, GpuTriangle, INSTANCE_IS_MIRRORED, INSTANCE_IS_ONLY_MOVED,
    MeshRange, START_COUNT_SHIFT, START_IS_LEAF, TRIANGLE_AXIS_SHIFT,
};

use crate::scene::{Id, Mesh};
use bottom::BottomTree;
use leaf::Shear;
use node::{Slab, inverse_of};
use restore::{Restorer, Top};
use tree::Entry;

/// Room for entries on the processor's stack; deeper trees take it from the heap, ray by ray.
const STACK_INLINE: usize = 96;

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
}

/// The whole scene as rays see it. Immutable: an edit makes a new one that shares what stayed.
#[derive(Clone, Debug)]
pub struct Accel {
    origin_in_world: DVec3,
    bottoms: Arc<HashMap<Id, (Arc<Mesh>, Arc<BottomTree>)>>,
    instances: Vec<Arc<Instance>>,
    /// Number of the instance of each node that shows something.
    numbers: Arc<HashMap<Id, u32>>,
    top: Arc<Top>,
    restorer: Arc<Restorer>,
    /// The instruction sets this machine has.
    level: Level,
    /// Entries that a walk through the deepest mesh may have waiting at once.
    bottom_stack_need: usize,
    radius: f32,
    report: AccelReport,
}

impl Accel {
    /// The world position of render space's origin.
    pub fn origin_in_world(&self) -> DVec3 {
        self.origin_in_world
    }

    /// Instances by the index that a [`Hit`] carries.
    pub fn instances(&self) -> &[Arc<Instance>] {
        &self.instances
    }

    /// What building took and holds.
    pub fn report(&self) -> AccelReport {
        self.report
    }

    /// The nearest surface along `ray` that `accept` lets count.
    ///
    /// Of surfaces at the same distance the one with the smallest (instance, triangle) wins, so that the
    /// answer does not depend on the tree's shape.
    pub fn closest_hit(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut closest: Option<Hit> = None;
        self.visit::<true>(ray, |hit, t_max| {
            let nearer = closest.as_ref().is_none_or(|best| hit.is_before(best));
            if nearer && accept(&hit) {
                *t_max = hit.t;
                closest = Some(hit);
            }
            false
        });
        closest
    }

    /// True when any surface that `accept` lets count lies on `ray`.
    pub fn is_occluded(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> bool {
        self.visit::<false>(ray, |hit, _| accept(&hit))
    }

    /// Calls `found` with every triangle hit up to `t_max`; `found` may lower it, and ends the walk by true.
    #[inline(always)]
    fn visit<const NEAREST_FIRST: bool>(&self, ray: &Ray, found: impl FnMut(Hit, &mut f32) -> bool) -> bool {
        dispatch!(self.level, simd => self.visit_with::<_, NEAREST_FIRST>(simd, ray, found))
    }

    #[inline(always)]
    fn visit_with<S: Simd, const NEAREST_FIRST: bool>(
        &self,
        simd: S,
        ray: &Ray,
        mut found: impl FnMut(Hit, &mut f32) -> bool,
    ) -> bool {
        let top = self.top.tree();
        let need = top.tree().stack_need() + self.bottom_stack_need;
        let mut inline = [Entry::default(); STACK_INLINE];
        let mut heap;
        let stack: &mut [Entry] = if need <= inline.len() {
            &mut inline
        } else {
            heap = vec![Entry::default(); need];
            &mut heap
        };
        let inverse = inverse_of(ray.direction);
        let slab_in_render = Slab::new(ray.origin, inverse, top.tree().bounds());
        let shear_in_render = Shear::new(ray);
        // Parts of one instance often come one after the other: the ray goes into its space once.
        let mut entered = u32::MAX;
        let (mut slab, mut shear) = (slab_in_render, shear_in_render);
        let mut t_max = ray.t_max;
        top.tree().walk::<S, NEAREST_FIRST>(
            simd,
            0,
            &slab_in_render,
            &mut t_max,
            stack,
            |part, t_max, stack| {
                let part = top.part(part);
                let instance = &*self.instances[part.instance as usize];
                let bottom = instance.bottom();
                if part.instance != entered {
                    entered = part.instance;
                    let local = instance.ray_in_mesh(ray);
                    if instance.is_only_moved() {
                        slab = Slab::new(local.origin, inverse, bottom.tree().bounds());
                        shear = shear_in_render.from(local.origin);
                    } else {
                        slab = Slab::new(local.origin, inverse_of(local.direction), bottom.tree().bounds());
                        shear = Shear::new(&local);
                    }
                }
                bottom.visit::<S, NEAREST_FIRST>(
                    simd,
                    part.child,
                    (&slab, &shear),
                    t_max,
                    stack,
                    |met, t_max| {
                        let hit = Hit {
                            t: met.t,
                            instance: part.instance,
                            triangle: met.triangle,
                            b1: met.b1,
                            b2: met.b2,
                        };
                        found(hit, t_max)
                    },
                )
            },
        )
    }

    /// Turns a world position into render space.
    pub fn to_render(&self, p_in_world: DVec3) -> Vec3 {
        (p_in_world - self.origin_in_world).as_vec3()
    }

    /// Radius of the sphere around render space's origin that holds the scene; zero for an empty scene.
    pub fn radius(&self) -> f32 {
        self.radius
    }
}

#[cfg(test)]
mod tests;
