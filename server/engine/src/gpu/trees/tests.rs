//! The walk on the device meets what the CPU's walk meets.

use std::{sync::Arc, time::Instant};

use glam::{DAffine3, DQuat, DVec3, Vec3};
use lumicast_shaders::{CLOSEST, OCCLUDED, TREE};
use rayon::prelude::*;

use super::*;
use crate::accel::{
    Accel, GpuInstance, GpuNode, GpuPart, GpuTriangle,
    tests::{Numbers, stage_with_grey},
    upload_tests::{Agreement, agreement, crowd, rays, slivers, soups},
    upload_twin as twin,
};
use crate::gpu::{
    Part, Step,
    tests::{assert_same_layout, layout, open},
};
use crate::scene::samples;

/// WGSL's division may be off by 2.5 units of t where IEEE's is by half of one. A tolerance of the twin's is 3 units of
/// (reach + t Σ|dₐ|) / |n·d|, the largest component of n being 1, so that |n·d| ≤ Σ|dₐ|: no less than 3 units of t. Two of
/// them have room for both, and for products that are fused, which round less often.
const TOLERANCES: f64 = 2.0;

/// A session, and a scene's trees on it.
struct Walker {
    session: Arc<Session>,
    trees: GpuTrees,
    buffers: AccelBuffers,
}

impl Walker {
    fn new(session: &Arc<Session>, buffers: &AccelBuffers) -> Walker {
        let trees = GpuTrees::new(session, buffers).unwrap();
        Walker { session: Arc::clone(session), trees, buffers: buffers.clone() }
    }

    /// What a step writes for each of `inputs`, and the seconds that it took on the device.
    fn run<I: Pod, O: Pod>(&self, step: &'static Step, inputs: &[I]) -> (Vec<O>, f64) {
        self.run_with(step, Masks::None, inputs)
    }

    fn run_with<I: Pod, O: Pod>(&self, step: &'static Step, masks: Masks, inputs: &[I]) -> (Vec<O>, f64) {
        let session = &self.session;
        let of_trees = GpuTrees::layout(session).unwrap();
        let of_rays = session.layout(&[Binding::Read, Binding::Write]).unwrap();
        let constants = GpuTrees::constants(&self.buffers, masks);
        let pipeline = session.pipeline(step, &constants, &[&of_trees, &of_rays]).unwrap();
        let input = session.buffer("rays", bytemuck::cast_slice(inputs)).unwrap();
        let byte_count = inputs.len().max(1) * size_of::<O>();
        let output = session.buffer_zeroed("hits", byte_count as u64).unwrap();
        let groups = [self.trees.bind(session).unwrap(), session.bind(&of_rays, &[&input, &output]).unwrap()];
        let mut batch = session.timed_batch(step.name).unwrap();
        batch.dispatch(&pipeline, &groups.each_ref(), pipeline.workgroups(inputs.len() as u64)).unwrap();
        let read = batch.read_back(&output, 0..output.byte_count()).unwrap();
        let seconds = batch.submit().unwrap().gpu_seconds().unwrap();
        (bytemuck::pod_collect_to_vec(&read.collect().unwrap()), seconds.unwrap_or(0.0))
    }

    fn closest(&self, rays: &[Ray]) -> Vec<GpuHit> {
        let rays: Vec<GpuRay> = rays.iter().map(GpuRay::new).collect();
        self.run(&CLOSEST, &rays).0
    }

    fn occluded(&self, rays: &[(Ray, TriangleId)]) -> Vec<bool> {
        let rays: Vec<_> = rays.iter().map(|(ray, light)| GpuShadowRay::new(ray, *light)).collect();
        self.run::<_, u32>(&OCCLUDED, &rays).0.into_iter().map(|flag| flag == 1).collect()
    }
}

/// Compares all answers for these rays with the CPU's.
fn compare(session: &Arc<Session>, accel: &Accel, rays: &[Ray]) -> Agreement {
    let buffers = accel.upload();
    let walker = Walker::new(session, &buffers);
    let hits: Vec<Option<Hit>> = walker.closest(rays).iter().map(GpuHit::hit).collect();
    let found = agreement(accel, &buffers, rays.iter().copied().zip(hits.iter().copied()));
    eprintln!("{found:?}");
    check_twin(&buffers, rays, &hits);
    for (ray, hit) in rays.iter().zip(&hits) {
        let Some(hit) = hit else { continue };
        assert!(hit.t > 0.0 && hit.t <= ray.t_max && hit.triangle_id() != ray.left, "{ray:?} {hit:?}");
        check_weights(accel, ray, hit);
    }
    check_shadows(&walker, accel, rays, &hits);
    found
}

/// The twin meets the same triangles: the device rounds otherwise at most, which turns a few ties. Rays that leave a triangle
/// are left out, as the twin does not know of it.
fn check_twin(buffers: &AccelBuffers, rays: &[Ray], hits: &[Option<Hit>]) {
    let asked = rays.iter().zip(hits).filter(|(ray, _)| ray.left == TriangleId::NONE);
    let (mut count, mut same, mut same_bits) = (0, 0, 0);
    for (ray, hit) in asked {
        let twin = twin::closest_hit::<false>(buffers, ray);
        count += 1;
        same += usize::from(twin.map(|hit| hit.triangle_id()) == hit.map(|hit| hit.triangle_id()));
        same_bits += usize::from(twin.map(|hit| hit.t) == hit.map(|hit| hit.t));
    }
    eprintln!("of {count} rays the twin meets the same triangle on {same}, at the same bits on {same_bits}");
    assert!(count - same <= 3, "the twin meets another triangle on {} of {count}", count - same);
}

/// Weights name a point of the triangle that the ray passes through, as far as f32 can tell: sheared corners are off by
/// some roundings of their distance, edge functions by some of the sides' products, which moves the point by as much times
/// a side over the area.
fn check_weights(accel: &Accel, ray: &Ray, hit: &Hit) {
    assert!(hit.b1 >= 0.0 && hit.b2 >= 0.0 && hit.b1 + hit.b2 <= 1.0 + f32::EPSILON, "{hit:?}");
    let instance = &accel.instances()[hit.instance as usize];
    let local = instance.ray_in_mesh(ray);
    let (origin, direction) = (local.origin.as_dvec3(), local.direction.as_dvec3());
    let mesh = instance.mesh();
    let corners = mesh.triangles()[hit.triangle as usize].map(|v| mesh.positions()[v as usize].as_dvec3());
    let along = direction / direction.abs().max_element();
    let z = direction.abs().max_position();
    let [a, b, c] = corners.map(|corner| (corner - origin) - along * ((corner - origin)[z] / along[z]));
    let (b1, b2) = (f64::from(hit.b1), f64::from(hit.b2));
    let off_m = (a * (1.0 - b1 - b2) + b * b1 + c * b2).length();
    let side_m = (b - a).length().max((c - b).length()).max((a - c).length());
    let area = (b - a).cross(c - a).length();
    let reach_m = corners.map(|corner| (corner - origin).abs().max_element()).into_iter().fold(0.0, f64::max);
    let rounding = 8.0 * f64::from(f32::EPSILON);
    // A triangle seen on edge has no area: then its sides are all there is to say.
    let room_m = (rounding * (reach_m + side_m * side_m * side_m / area)).min(2.0 * side_m);
    assert!(off_m <= room_m || area == 0.0, "{off_m} of {room_m} m: {ray:?} {hit:?}");
}

/// The same rays as shadow rays: whole, cut off before and behind what they meet, and with that as their light.
fn check_shadows(walker: &Walker, accel: &Accel, rays: &[Ray], hits: &[Option<Hit>]) {
    let cases: Vec<(Ray, TriangleId)> = rays
        .iter()
        .zip(hits)
        .enumerate()
        .map(|(number, (ray, hit))| match (hit, number % 4) {
            (Some(hit), 1) => (Ray { t_max: hit.t * 0.99, ..*ray }, TriangleId::NONE),
            (Some(hit), 2) => (Ray { t_max: hit.t * 1.01, ..*ray }, TriangleId::NONE),
            (Some(hit), 3) => (Ray { t_max: hit.t * 1.01, ..*ray }, hit.triangle_id()),
            _ => (*ray, TriangleId::NONE),
        })
        .collect();
    let ours = cases.iter().map(|(ray, light)| accel.is_occluded(ray, |hit| hit.triangle_id() != *light));
    let differing = ours.zip(walker.occluded(&cases)).filter(|(ours, theirs)| ours != theirs).count();
    eprintln!("{differing} of {} shadow rays differ", cases.len());
    // Not none: distances differ by roundings, and on slivers a hundredth of t may be less than that.
    assert!(differing * 5000 <= cases.len(), "{differing} of {} shadow rays differ", cases.len());
}

/// Structs of the walk lie in memory as Rust packs them.
#[test]
fn structs_of_the_walk_have_one_layout() {
    let source = CLOSEST.source(lumicast_shaders::PROOF_CONSTANTS);
    assert_same_layout!(&source, "GpuPart", GpuPart { instance, start });
    assert_same_layout!(
        &source,
        "GpuInstance",
        GpuInstance {
            mesh_from_render_x,
            node_base,
            mesh_from_render_y,
            triangle_base,
            mesh_from_render_z,
            flags,
            centre_in_render,
            mesh_reach
        }
    );
    assert_same_layout!(&source, "AccelHeader", AccelHeader { top_reach, padding_0, padding_1, padding_2 });
    assert_same_layout!(&source, "Ray", GpuRay { origin, t_max, direction, left_instance, left_triangle });
    assert_same_layout!(&source, "Hit", GpuHit { t, instance, triangle, b1, b2 });
    let shadows = OCCLUDED.source(lumicast_shaders::PROOF_CONSTANTS);
    assert_same_layout!(
        &shadows,
        "ShadowRay",
        GpuShadowRay { ray, light_instance, light_triangle, padding_0, padding_1 }
    );
    // WGSL reads both of these as whole vectors: what Rust names must be where their components are.
    let vectors_of = |name: &str| {
        let (fields, byte_count) = layout(&source, name);
        (fields.into_iter().map(|field| (field.name, field.offset)).collect::<Vec<_>>(), byte_count)
    };
    let named = |fields: [(&str, u32); 3]| fields.map(|(name, offset)| (name.to_string(), offset)).to_vec();
    assert_eq!(vectors_of("GpuNode"), (named([("corner", 0), ("links", 16), ("planes", 32)]), 80));
    let of_rust = [
        std::mem::offset_of!(GpuNode, origin),
        std::mem::offset_of!(GpuNode, exponents),
        std::mem::offset_of!(GpuNode, inner),
        std::mem::offset_of!(GpuNode, child_base),
        std::mem::offset_of!(GpuNode, member_base),
        std::mem::offset_of!(GpuNode, member_ends),
        std::mem::offset_of!(GpuNode, planes),
    ];
    assert_eq!((of_rust, size_of::<GpuNode>()), ([0, 12, 15, 16, 20, 24, 32], 80));
    assert_eq!(vectors_of("GpuTriangle"), (named([("a", 0), ("b", 16), ("c", 32)]), 48));
    let of_rust = [
        std::mem::offset_of!(GpuTriangle, a),
        std::mem::offset_of!(GpuTriangle, number),
        std::mem::offset_of!(GpuTriangle, b),
        std::mem::offset_of!(GpuTriangle, slope_0),
        std::mem::offset_of!(GpuTriangle, c),
        std::mem::offset_of!(GpuTriangle, slope_1),
    ];
    assert_eq!((of_rust, size_of::<GpuTriangle>()), ([0, 12, 16, 28, 32, 44], 48));
}

/// The numbers that both sides name are the same.
#[test]
fn constants_of_the_walk_are_those_of_the_packing() {
    use crate::accel::{INSTANCE_IS_ONLY_MOVED, START_COUNT_SHIFT, START_IS_LEAF, TRIANGLE_AXIS_SHIFT};
    for line in [
        format!("const INSTANCE_IS_ONLY_MOVED: u32 = {INSTANCE_IS_ONLY_MOVED}u;"),
        format!("const START_IS_LEAF: u32 = {START_IS_LEAF:#x}u;"),
        format!("const START_COUNT_SHIFT: u32 = {START_COUNT_SHIFT}u;"),
        format!("const TRIANGLE_AXIS_SHIFT: u32 = {TRIANGLE_AXIS_SHIFT}u;"),
    ] {
        assert!(TREE.source.contains(&line), "{line}");
    }
}

/// The same triangles of soup with slivers, through turned, scaled and mirrored instances.
#[test]
fn the_device_meets_the_same_triangles_of_soup() {
    let Some(gpu) = open() else { return };
    let rays: Vec<Ray> = rays(31, 4.0, 20_000).collect();
    let found = compare(&gpu.session().unwrap(), &Accel::build(&soups()), &rays);
    assert!(found.hits > 5_000 && found.disagreements == 0 && found.ties <= 2, "{found:?}");
    assert!(found.worst <= TOLERANCES, "{found:?}");
}

/// Rays at edges and vertices of triangles that have no neighbours: rounding alone decides whether they pass, and a device
/// may fuse products and sums on a ray's way into its mesh. What is met is still where it is said to be. llvmpipe decides
/// otherwise than the CPU on 199 of 12,000; three times as many are allowed, as a device may round every other time.
#[test]
fn edges_are_met_or_missed_and_nothing_in_between() {
    let Some(gpu) = open() else { return };
    let accel = Accel::build(&soups());
    let buffers = accel.upload();
    let mut numbers = Numbers(73);
    let rays: Vec<Ray> = (0..12_000)
        .map(|number| {
            let instance = &accel.instances()[number % accel.instances().len()];
            let triangles = instance.mesh().triangles();
            let corner = |k: usize| instance.vertex_in_render(triangles[number % triangles.len()][k]);
            let share = if number % 4 == 0 { 0.0 } else { numbers.next() as f32 };
            let origin = numbers.point(4.0).as_vec3();
            Ray::new(origin, corner(0).lerp(corner(1), share) - origin)
        })
        .collect();
    let hits = Walker::new(&gpu.session().unwrap(), &buffers).closest(&rays);
    let hits: Vec<Option<Hit>> = hits.iter().map(GpuHit::hit).collect();
    let found = agreement(&accel, &buffers, rays.iter().copied().zip(hits.iter().copied()));
    eprintln!("{found:?}");
    assert!(found.hits > 6_000 && found.worst <= TOLERANCES, "{found:?}");
    assert!(found.disagreements <= rays.len() / 20, "{found:?}");
    for (ray, hit) in rays.iter().zip(&hits) {
        hit.iter().for_each(|hit| check_weights(&accel, ray, hit));
    }
}

/// … of slivers, where f32 loses the normal.
#[test]
fn the_device_meets_slivers_where_they_are() {
    let Some(gpu) = open() else { return };
    let rays: Vec<Ray> = rays(31, 6.0, 20_000).collect();
    let found = compare(&gpu.session().unwrap(), &Accel::build(&slivers()), &rays);
    assert!(found.hits > 500 && found.disagreements == 0 && found.ties <= 2, "{found:?}");
    assert!(found.worst <= TOLERANCES, "{found:?}");
}

/// Rays that leave what `rays` meet, in all directions, naming the triangle that they leave.
fn bounced(accel: &Accel, rays: impl Iterator<Item = Ray>, numbers: &mut Numbers) -> Vec<Ray> {
    rays.filter_map(|ray| {
        let hit = accel.closest_hit(&ray, |_| true)?;
        let direction = numbers.direction();
        let point = accel.instances()[hit.instance as usize].point_of(&hit);
        let origin = point.origin_towards(direction);
        Some(Ray { left: hit.triangle_id(), ..Ray::new(origin, direction) })
    })
    .collect()
}

/// … of a closed room: from its middle, off its walls, and along the axes, where directions have zeros of both signs.
#[test]
fn the_device_meets_the_same_triangles_of_the_cornell_box() {
    let Some(gpu) = open() else { return };
    let accel = Accel::build(&samples::cornell_box().unwrap());
    let mut numbers = Numbers(37);
    let mut all = bounced(&accel, rays(41, 0.9, 20_000), &mut numbers);
    all.extend(rays(43, 0.9, 20_000));
    all.extend(rays(61, 0.9, 6_000).enumerate().map(|(number, ray)| {
        let zero = if number % 12 < 6 { 0.0 } else { -0.0 };
        let mut direction = Vec3::splat(zero);
        direction[number % 3] = if number % 6 < 3 { 1.0 } else { -1.0 };
        Ray { direction, ..ray }
    }));
    let found = compare(&gpu.session().unwrap(), &accel, &all);
    assert!(found.rays > 40_000 && found.disagreements == 0 && found.ties <= 5, "{found:?}");
    assert!(found.worst <= TOLERANCES, "{found:?}");
}

/// … of a crowd of instances whose parts start anywhere, at every scale.
#[test]
fn the_device_meets_the_same_triangles_of_a_crowd() {
    let Some(gpu) = open() else { return };
    for (scale, offset_m) in [(1.0, 0.0), (1e-4, 1e-3), (1e4, 1e5)] {
        let accel = Accel::build(&crowd(scale, offset_m).finish().0);
        let middle = accel.to_render(DVec3::splat(offset_m));
        let around = rays(47, 4.0 * scale, 10_000).map(|ray| Ray { origin: ray.origin + middle, ..ray });
        let found = compare(&gpu.session().unwrap(), &accel, &around.collect::<Vec<_>>());
        assert!(found.hits > 3_000 && found.disagreements == 0 && found.ties <= 3, "{found:?}");
        assert!(found.worst <= TOLERANCES, "{found:?}");
    }
}

/// Nothing escapes from a closed mesh that is turned and mirrored, at vertices and edges either.
#[test]
fn no_ray_leaks_from_a_closed_mesh_on_the_device() {
    let Some(gpu) = open() else { return };
    let mut numbers = Numbers(53);
    let (mut stage, grey) = stage_with_grey();
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.9);
    let size = DVec3::new(-1.0, 1.3, 0.9);
    let placed = DAffine3::from_scale_rotation_translation(size, turn, DVec3::splat(0.2));
    stage.place("ball", samples::sphere(DVec3::ZERO, 1.0, 24, &grey), placed).unwrap();
    let accel = Accel::build(&stage.finish());
    let buffers = accel.upload();
    let centre = Vec3::from(buffers.instances[0].centre_in_render);
    let instance = &accel.instances()[0];
    let triangles = instance.mesh().triangles();
    let rays: Vec<Ray> = (0..100_000)
        .map(|ray| {
            let origin = numbers.point(0.4).as_vec3() + centre;
            let corner = |k: usize| instance.vertex_in_render(triangles[ray % triangles.len()][k]);
            // Every third ray aims at a vertex, every third at a point of an edge.
            let direction = match ray % 3 {
                0 => numbers.direction(),
                1 => corner(0) - origin,
                _ => corner(1).lerp(corner(2), numbers.next() as f32) - origin,
            };
            Ray::new(origin, direction)
        })
        .collect();
    let hits = Walker::new(&gpu.session().unwrap(), &buffers).closest(&rays);
    assert_eq!(hits.iter().filter(|hit| hit.hit().is_none()).count(), 0);
}

/// A step that cuts out every other triangle, and of the others what lies near the first vertex.
static MASKED: Step = Step {
    name: "tests/masked",
    entry_point: "closest",
    parts: &[
        &TREE,
        &Part {
            name: "tests/mask",
            source: "
fn is_present(instance: u32, triangle: u32, b1: f32, b2: f32) -> bool {
    return (triangle & 1u) == 0u && b1 + b2 > 0.5;
}",
        },
        CLOSEST.parts[2],
    ],
    workgroup_size: [64, 1, 1],
};

/// What a mask cuts out is not met, and what lies behind is: the CPU's answers, but where weights are too close to call.
#[test]
fn masks_cut_holes_on_the_device() {
    let Some(gpu) = open() else { return };
    let accel = Accel::build(&soups());
    let rays: Vec<Ray> = rays(71, 4.0, 20_000).collect();
    let packed: Vec<GpuRay> = rays.iter().map(GpuRay::new).collect();
    let walker = Walker::new(&gpu.session().unwrap(), &accel.upload());
    let (hits, _) = walker.run_with::<_, GpuHit>(&MASKED, Masks::Asked, &packed);
    let is_present = |hit: &Hit| hit.triangle & 1 == 0 && hit.b1 + hit.b2 > 0.5;
    let expected = rays.iter().map(|ray| accel.closest_hit(ray, is_present).map(|hit| hit.triangle_id()));
    let found = hits.iter().map(|hit| hit.hit().map(|hit| hit.triangle_id()));
    let differing = expected.zip(found).filter(|(expected, found)| expected != found).count();
    assert!(hits.iter().filter(|hit| hit.hit().is_some()).count() > 2_000);
    assert!(differing <= 4, "{differing} rays differ");
}

/// In a scene that shows nothing no ray meets anything, and buffers of nothing can be bound.
#[test]
fn an_empty_scene_is_met_by_no_ray_on_the_device() {
    let Some(gpu) = open() else { return };
    let buffers = Accel::build(&stage_with_grey().0.finish()).upload();
    let walker = Walker::new(&gpu.session().unwrap(), &buffers);
    let rays: Vec<Ray> = rays(61, 1.0, 100).collect();
    assert!(walker.closest(&rays).iter().all(|hit| hit.hit().is_none() && hit.t == f32::MAX));
}

/// Prints million rays a second beside the CPU's; asserts nothing, as the adapter may be any.
#[test]
fn rays_of_the_cornell_box_are_timed() {
    let Some(gpu) = open() else { return };
    let accel = Accel::build(&samples::cornell_box().unwrap());
    let walker = Walker::new(&gpu.session().unwrap(), &accel.upload());
    let size = 256;
    // From the open front, as the camera sees it; in rows of pixels, so that neighbours go the same way.
    let primary: Vec<Ray> = (0..size * size)
        .map(|pixel| {
            let [x, y] = [pixel % size, pixel / size].map(|p| (p as f32 + 0.5) / size as f32 * 2.0 - 1.0);
            Ray::new(accel.to_render(DVec3::new(0.0, 1.0, 3.4)), Vec3::new(x * 0.36, -y * 0.36, -1.0))
        })
        .collect();
    let diffuse = bounced(&accel, primary.iter().copied(), &mut Numbers(67));
    for (kind, rays) in [("primary", primary), ("diffuse", diffuse)] {
        let packed: Vec<GpuRay> = rays.iter().map(GpuRay::new).collect();
        walker.run::<_, GpuHit>(&CLOSEST, &packed);
        let (hits, seconds) = walker.run::<_, GpuHit>(&CLOSEST, &packed);
        let met = hits.iter().filter(|hit| hit.hit().is_some()).count();
        let started = Instant::now();
        let on_cpu: usize = rays
            .par_chunks(1024)
            .map(|rays| {
                let mut hits = vec![None; rays.len()];
                accel.closest_hits(rays, &mut hits, |_| true);
                hits.iter().flatten().count()
            })
            .sum();
        let cpu_seconds = started.elapsed().as_secs_f64();
        let rate = |seconds: f64| rays.len() as f64 * 1e-6 / seconds;
        eprintln!(
            "{kind}: {:.2} M rays/s on {}, {:.2} on the CPU with {} threads; {met} and {on_cpu} of {} hit",
            rate(seconds),
            gpu.report().name,
            rate(cpu_seconds),
            rayon::current_num_threads(),
            rays.len()
        );
    }
}
