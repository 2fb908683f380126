//! Our trees, and every way to ask them.

use std::time::Instant;

use glam::Vec3;
use lumicast_engine::{
    accel::{Accel, Ray},
    scene::{CameraView, Scene},
};

use crate::{
    answer::Answer,
    ray_set::{Kind, RaySet, SIZE},
};

/// A way to ask our tree a run of rays.
pub(crate) struct Variant {
    /// What the row is called after its kind of ray; empty for single rays.
    pub(crate) name: &'static str,
    pub(crate) kinds: &'static [Kind],
    pub(crate) answer: fn(&Accel, Kind, &[Ray]) -> Answer,
}

/// All of them: a further one is one line here, and a row in every table.
pub(crate) const VARIANTS: [Variant; 2] = [
    Variant { name: "", kinds: &Kind::ALL, answer: one_by_one },
    Variant { name: "eight at a time", kinds: &[Kind::Primary], answer: eight_at_a_time },
];

fn eight_at_a_time(accel: &Accel, _: Kind, rays: &[Ray]) -> Answer {
    let mut hits = vec![None; rays.len()];
    accel.closest_hits(rays, &mut hits, |_| true);
    hits.into_iter().map(|hit| hit.map(|hit| hit.t)).collect()
}

fn one_by_one(accel: &Accel, kind: Kind, rays: &[Ray]) -> Answer {
    match kind {
        Kind::Primary | Kind::Diffuse => {
            rays.iter().map(|ray| accel.closest_hit(ray, |_| true).map(|hit| hit.t)).collect()
        }
        Kind::Shadow => rays.iter().map(|ray| accel.is_occluded(ray, |_| true).then_some(0.0)).collect(),
    }
}

/// The triangles of a scene as its rays see them.
pub(crate) struct RenderMesh {
    pub(crate) positions: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// A tree of ours with the rays that are asked of it.
pub(crate) struct Tree<'a> {
    /// What sets it apart from the first; empty for that one.
    pub(crate) name: &'static str,
    scene: &'a Scene,
    pub(crate) accel: Accel,
    pub(crate) rays: RaySet,
}

impl<'a> Tree<'a> {
    pub(crate) fn new(name: &'static str, scene: &'a Scene, view: CameraView) -> Tree<'a> {
        let accel = Accel::build(scene);
        let rays = RaySet::seen_by(&view, SIZE, &accel, scene);
        Tree { name, scene, accel, rays }
    }

    /// Builds the tree once more, with the threads of the pool this runs in.
    pub(crate) fn build_seconds(&self) -> f64 {
        let start = Instant::now();
        let accel = Accel::build(self.scene);
        let seconds = start.elapsed().as_secs_f64();
        drop(accel);
        seconds
    }

    pub(crate) fn bytes(&self) -> usize {
        self.accel.report().bytes
    }

    /// Every triangle in render space, where rays live, so that others can be asked the very same rays.
    pub(crate) fn mesh_in_render(&self) -> RenderMesh {
        let mut all = RenderMesh { positions: Vec::new(), triangles: Vec::new() };
        for instance in self.accel.instances() {
            let first = all.positions.len() as u32;
            let vertices = 0..instance.mesh().positions().len() as u32;
            all.positions.extend(vertices.map(|vertex| instance.vertex_in_render(vertex)));
            let triangles = instance.mesh().triangles().iter();
            all.triangles.extend(triangles.map(|triangle| triangle.map(|vertex| first + vertex)));
        }
        all
    }
}
