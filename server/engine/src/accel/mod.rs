//! Rays against the scene: a two-level bounding volume hierarchy, one bottom tree per mesh, instances on top.
//!
//! Trees are built by `obvhs` (PLOC, reinsertion) and collapsed to four children a node; the traversal and
//! the watertight triangle test are ours. Rays live in *render space*: the world moved so that the middle
//! of the scene is its origin, in single precision. Transforms are composed in double precision, so a
//! scene 100 km from the world's origin is as exact as one at it.
//!
//! Imports `math` and `scene`.

mod bvh;
mod instance;
mod ray;
mod triangle;

use std::{collections::HashMap, sync::Arc, time::Instant};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub use instance::{Instance, SurfacePoint};
pub use ray::{Hit, Ray};

use crate::scene::{Id, Mesh, Scene};
use bvh::{Bvh, Entry, SlabRay, stack_of};
use triangle::{ShearRay, TrianglePacket};

/// The tree over one mesh's triangles, in mesh space relative to the mesh's centre.
#[derive(Debug)]
struct BottomTree {
    bvh: Bvh,
    packets: Vec<TrianglePacket>,
}

/// What building took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AccelReport {
    /// Seconds spent on bottom and top trees.
    pub build_seconds: f64,
    /// Bottom trees built (the rest were taken over).
    pub trees_built: usize,
    /// Bytes of nodes and triangle packets.
    pub bytes: usize,
}

/// The whole scene as rays see it.
#[derive(Debug)]
pub struct Accel {
    origin_in_world: DVec3,
    bottoms: HashMap<Id, (Arc<Mesh>, Arc<BottomTree>)>,
    instances: Vec<Instance>,
    trees: Vec<Arc<BottomTree>>,
    top: Bvh,
    stack_need: usize,
    report: AccelReport,
}

impl Accel {
    /// Builds the trees of `scene`; those of meshes that `previous` holds already are taken over.
    pub fn build(scene: &Scene, previous: Option<&Accel>) -> Accel {
        let start = Instant::now();
        let origin_in_world = scene.bounds().map_or(DVec3::ZERO, |bounds| bounds.centre());
        let shown: Vec<(&Id, &Id, &Arc<Mesh>)> = scene
            .nodes()
            .iter()
            .filter_map(|(node_id, node)| {
                let (mesh_id, mesh) = scene.meshes().get_key_value(node.mesh.as_ref()?)?;
                (!mesh.triangles().is_empty()).then_some((node_id, mesh_id, mesh))
            })
            .collect();

        let mut wanted: Vec<(&Id, &Arc<Mesh>)> = shown.iter().map(|(_, id, mesh)| (*id, *mesh)).collect();
        wanted.sort_unstable_by_key(|(id, _)| *id);
        wanted.dedup_by_key(|(id, _)| *id);
        let built: Vec<(bool, Arc<BottomTree>)> = wanted
            .par_iter()
            .map(|(id, mesh)| match previous.and_then(|previous| previous.bottoms.get(*id)) {
                Some((same, tree)) if Arc::ptr_eq(same, mesh) => (false, tree.clone()),
                _ => (true, Arc::new(BottomTree::build(mesh))),
            })
            .collect();
        let trees_built = built.iter().filter(|(new, _)| *new).count();
        let bottoms: HashMap<Id, (Arc<Mesh>, Arc<BottomTree>)> = wanted
            .iter()
            .zip(built)
            .map(|((id, mesh), (_, tree))| ((*id).clone(), ((*mesh).clone(), tree)))
            .collect();

        let instances: Vec<Instance> = shown
            .iter()
            .map(|(node_id, mesh_id, mesh)| {
                let world_from_mesh = scene.world_from_node(Some(node_id));
                Instance::new(
                    (*node_id).clone(),
                    (*mesh_id).clone(),
                    (*mesh).clone(),
                    world_from_mesh,
                    origin_in_world,
                )
            })
            .collect();
        let trees: Vec<Arc<BottomTree>> =
            instances.iter().map(|instance| bottoms[instance.mesh_id()].1.clone()).collect();
        let bounds: Vec<obvhs::aabb::Aabb> = instances.iter().map(Instance::bounds_in_render).collect();
        let top = Bvh::build(&bounds, 1, |members| members[0]);
        let deepest_bottom = trees.iter().map(|tree| tree.bvh.stack_need()).max().unwrap_or(0);
        let stack_need = top.stack_need() + deepest_bottom;
        let bytes = bottoms.values().map(|(_, tree)| tree.bytes()).sum::<usize>() + top.bytes();
        let report = AccelReport { build_seconds: start.elapsed().as_secs_f64(), trees_built, bytes };
        Accel { origin_in_world, bottoms, instances, trees, top, stack_need, report }
    }

    /// The world position of render space's origin.
    pub fn origin_in_world(&self) -> DVec3 {
        self.origin_in_world
    }

    /// Instances by the index that a [`Hit`] carries.
    pub fn instances(&self) -> &[Instance] {
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
        self.visit(ray, |hit, t_max| {
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
        self.visit(ray, |hit, _| accept(&hit))
    }

    /// Calls `found` with every triangle hit up to `t_max`; `found` may lower it, and ends the walk by true.
    #[inline]
    fn visit(&self, ray: &Ray, mut found: impl FnMut(Hit, &mut f32) -> bool) -> bool {
        let mut inline = [Entry::default(); 96];
        let mut heap;
        let stack: &mut [Entry] = if self.stack_need <= inline.len() {
            &mut inline
        } else {
            heap = stack_of(self.stack_need);
            &mut heap
        };
        let slab = SlabRay::new(ray.origin, ray.direction);
        let shear = ShearRay::new(ray.origin, ray.direction);
        let mut t_max = ray.t_max;
        self.top.traverse(&slab, &mut t_max, stack, |instance_index, t_max, stack| {
            let instance = &self.instances[instance_index as usize];
            let tree = &self.trees[instance_index as usize];
            let origin = instance.origin_in_mesh(ray);
            let (slab, shear) = if instance.is_only_moved() {
                (slab.from(origin), shear.from(origin))
            } else {
                let direction = instance.direction_in_mesh(ray);
                (SlabRay::new(origin, direction), ShearRay::new(origin, direction))
            };
            tree.bvh.traverse(&slab, t_max, stack, |packet, t_max, _| {
                tree.packets[packet as usize].intersect(&shear, t_max, |triangle_hit, t_max| {
                    let hit = Hit {
                        t: triangle_hit.t,
                        instance: instance_index,
                        triangle: triangle_hit.triangle,
                        b1: triangle_hit.b1,
                        b2: triangle_hit.b2,
                    };
                    found(hit, t_max)
                })
            })
        })
    }

    /// Turns a world position into render space.
    pub fn to_render(&self, p_in_world: DVec3) -> Vec3 {
        (p_in_world - self.origin_in_world).as_vec3()
    }

    /// Radius of the sphere around render space's origin that holds the scene; zero for an empty scene.
    pub fn radius(&self) -> f32 {
        let reach = |instance: &Instance| {
            let bounds = instance.bounds_in_render();
            Vec3::from(bounds.min.abs().max(bounds.max.abs())).length()
        };
        self.instances.iter().map(reach).fold(0.0, f32::max)
    }
}

impl BottomTree {
    fn build(mesh: &Mesh) -> BottomTree {
        let bounds: Vec<obvhs::aabb::Aabb> = mesh
            .triangles()
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.map(|vertex| mesh.positions()[vertex as usize].into());
                obvhs::aabb::Aabb::from_points(&[a, b, c])
            })
            .collect();
        let mut packets = Vec::with_capacity(bounds.len() / 2);
        let bvh = Bvh::build(&bounds, TrianglePacket::WIDTH as u32, |triangles| {
            packets.push(TrianglePacket::new(mesh, triangles));
            packets.len() as u32 - 1
        });
        BottomTree { bvh, packets }
    }

    fn bytes(&self) -> usize {
        self.bvh.bytes() + self.packets.len() * size_of::<TrianglePacket>()
    }
}

#[cfg(test)]
mod tests;
