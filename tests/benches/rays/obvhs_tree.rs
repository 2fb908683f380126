//! obvhs's own eight-wide compressed tree and its own traversal and triangle test.

use std::time::{Duration, Instant};

use lumicast_engine::accel;
use obvhs::{
    BvhBuildParams,
    cwbvh::{CwBvh, builder::build_cwbvh_from_tris, node::CwBvhNode},
    ray::{Ray, RayHit},
    triangle::Triangle,
};
use rayon::ThreadPool;

use crate::{answer::Answer, ours::RenderMesh, ray_set::Kind};

/// The tree, with its triangles in the order of its leaves as obvhs's examples do it.
pub(crate) struct ObvhsTree {
    bvh: CwBvh,
    triangles: Vec<Triangle>,
    pub(crate) build_seconds: f64,
}

impl ObvhsTree {
    pub(crate) fn build(mesh: &RenderMesh, pool: &ThreadPool) -> ObvhsTree {
        let corner = |vertex: u32| mesh.positions[vertex as usize].into();
        let source: Vec<Triangle> = mesh
            .triangles
            .iter()
            .map(|[a, b, c]| Triangle { v0: corner(*a), v1: corner(*b), v2: corner(*c) })
            .collect();
        pool.install(|| {
            let start = Instant::now();
            let preset = BvhBuildParams::medium_build();
            let bvh = build_cwbvh_from_tris(&source, preset, &mut Duration::default());
            let triangles = bvh.primitive_indices.iter().map(|index| source[*index as usize]).collect();
            ObvhsTree { bvh, triangles, build_seconds: start.elapsed().as_secs_f64() }
        })
    }

    /// Nodes, triangles and their names.
    pub(crate) fn bytes(&self) -> f64 {
        let nodes = self.bvh.nodes.len() * size_of::<CwBvhNode>();
        (nodes + self.triangles.len() * (size_of::<Triangle>() + size_of::<u32>())) as f64
    }

    pub(crate) fn answer(&self, kind: Kind, rays: &[accel::Ray]) -> Answer {
        let of_ray = |ray: &accel::Ray| {
            let ray = Ray::new(ray.origin.into(), ray.direction.into(), 0.0, ray.t_max);
            let test = |ray: &Ray, index: usize| self.triangles[index].intersect(ray);
            match kind {
                Kind::Primary | Kind::Diffuse => {
                    let mut hit = RayHit::none();
                    self.bvh.ray_traverse(ray, &mut hit, test).then_some(hit.t)
                }
                Kind::Shadow => (!self.bvh.ray_traverse_miss(ray, test)).then_some(0.0),
            }
        };
        rays.iter().map(of_ray).collect()
    }
}
