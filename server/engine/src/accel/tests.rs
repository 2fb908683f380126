//! Laws of ray casting.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::{leaf::Leaves, *};
use crate::math::Rgb;
use crate::scene::{
    Material,
    samples::{self, Stage},
};

/// A small, well-known stream of numbers in [0, 1) [Steele2014, SplitMix64].
pub(super) struct Numbers(pub(super) u64);

impl Numbers {
    pub(super) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn direction(&mut self) -> Vec3 {
        let (z, phi) = (1.0 - 2.0 * self.next(), self.next() * std::f64::consts::TAU);
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32)
    }

    pub(super) fn point(&mut self, half_size: f64) -> DVec3 {
        DVec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5) * 2.0 * half_size
    }
}

pub(super) fn stage_with_grey() -> (Stage, crate::scene::Id) {
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
    (stage, grey)
}

/// The tree finds what a loop over all triangles finds, on soup with slivers, through turned, scaled and mirrored
/// instances.
#[test]
fn closest_hits_equal_a_loop_over_all_triangles() {
    let mut numbers = Numbers(7);
    let (mut stage, grey) = stage_with_grey();
    for object in 0..6 {
        let mut source = crate::scene::MeshSource::default();
        for triangle in 0..300u32 {
            let at = numbers.point(2.0);
            let size = if triangle % 7 == 0 { DVec3::new(2.0, 1e-5, 1e-3) } else { DVec3::splat(0.4) };
            source.positions.extend([0; 3].map(|_| at + numbers.point(1.0) * size));
            source.triangles.push([triangle * 3, triangle * 3 + 1, triangle * 3 + 2]);
        }
        source.primitives =
            vec![crate::scene::Primitive { first_triangle: 0, triangle_count: 300, material: grey.clone() }];
        let turn =
            DQuat::from_axis_angle(numbers.direction().as_dvec3().normalize(), 1.0 + f64::from(object));
        let scale = DVec3::new(1.0, 0.5 + numbers.next(), if object % 2 == 0 { -1.0 } else { 1.5 });
        let placed = DAffine3::from_scale_rotation_translation(scale, turn, numbers.point(1.0));
        stage.place(&format!("soup {object}"), source, placed).unwrap();
    }
    let accel = Accel::build(&stage.finish());
    let mut hits = 0;
    for _ in 0..4000 {
        let ray = Ray::new(numbers.point(4.0).as_vec3(), numbers.direction());
        let mut expected: Option<Hit> = None;
        for (index, instance) in accel.instances().iter().enumerate() {
            let shear = Shear::new(&instance.ray_in_mesh(&ray));
            for triangle in 0..instance.mesh().triangles().len() as u32 {
                let mut alone = Leaves::with_capacity(1);
                let leaf = alone.push(instance.mesh(), &[triangle]);
                alone.finish();
                let simd = fearless_simd::Level::baseline();
                let mut t_max = f32::INFINITY;
                dispatch!(simd, simd => alone.packet(leaf).intersect(simd, &shear, &mut t_max, |h, _| {
                    let hit = Hit { t: h.t, instance: index as u32, triangle: h.triangle, b1: h.b1, b2: h.b2 };
                    if expected.as_ref().is_none_or(|best| hit.is_before(best)) {
                        expected = Some(hit);
                    }
                    false
                }));
            }
        }
        let found = accel.closest_hit(&ray, |_| true);
        assert_eq!(found, expected);
        assert_eq!(accel.is_occluded(&ray, |_| true), expected.is_some());
        hits += usize::from(found.is_some());
    }
    assert!(hits > 1000, "the soup must be hit often to test anything: {hits}");
}

/// Rays that leave a surface never meet the surface they left, from a millimetre to 100 km from the origin of the
/// world and at scene sizes from 0.1 mm to 10 km: from inside a convex body the next hit is another triangle's plane.
#[test]
fn rays_that_leave_a_surface_do_not_meet_it_at_any_scale_or_place() {
    let mut numbers = Numbers(11);
    for (scale, offset_m) in
        [(1.0, 0.0), (1e-4, 0.0), (1e-4, 1e-3), (1.0, 1e5), (1e-3, 1e5), (1e4, 0.0), (1e4, 1e5)]
    {
        let (mut stage, grey) = stage_with_grey();
        let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7));
        let placed =
            DAffine3::from_mat3_translation(turn * scale, DVec3::new(offset_m, -offset_m, offset_m * 0.5));
        stage
            .place("cuboid", samples::cuboid(DVec3::NEG_ONE, DVec3::new(1.0, 2.0, 0.1), &grey), placed)
            .unwrap();
        let accel = Accel::build(&stage.finish());
        let instance = &accel.instances()[0];
        for _ in 0..20_000 {
            let (mut b1, mut b2) = (numbers.next() as f32, numbers.next() as f32);
            if b1 + b2 > 1.0 {
                (b1, b2) = (1.0 - b1, 1.0 - b2);
            }
            let triangle = (numbers.next() * 12.0) as u32;
            let point = instance.surface_point(triangle, b1, b2);
            let direction = numbers.direction();
            let outward = direction.dot(point.n_geo) > 0.0;
            let hit = accel.closest_hit(&Ray::new(point.origin_towards(direction), direction), |_| true);
            match hit {
                Some(hit) => {
                    let other = instance.point_of(&hit);
                    assert!(
                        !outward,
                        "a convex body met itself from outside: scale {scale} offset {offset_m}"
                    );
                    assert!(
                        other.n_geo.dot(point.n_geo) < 0.99,
                        "met its own face: scale {scale} offset {offset_m}"
                    );
                }
                None => assert!(outward, "escaped from a closed body: scale {scale} offset {offset_m}"),
            }
        }
    }
}

/// Nothing escapes from a closed sphere, not through vertices, edges or cracks between triangles.
#[test]
fn no_ray_escapes_from_a_closed_mesh() {
    let mut numbers = Numbers(3);
    let (mut stage, grey) = stage_with_grey();
    stage.place("ball", samples::sphere(DVec3::ZERO, 1.0, 24, &grey), DAffine3::IDENTITY).unwrap();
    let scene = stage.finish();
    let accel = Accel::build(&scene);
    let vertices = scene.meshes()["ball"].positions();
    for i in 0..200_000 {
        let origin = numbers.point(0.4).as_vec3();
        // Every third ray aims at a vertex, every third at an edge's middle.
        let direction = match i % 3 {
            0 => numbers.direction(),
            1 => vertices[i % vertices.len()] - origin,
            _ => (vertices[i % vertices.len()] + vertices[(i + 1) % vertices.len()]) * 0.5 - origin,
        };
        assert!(accel.is_occluded(&Ray::new(origin, direction), |_| true), "ray {i} escaped");
    }
}

/// After an edit the trees of meshes that stayed are taken over, and the answers are those of a fresh build.
#[test]
fn unchanged_meshes_keep_their_trees() {
    let scene = samples::cornell_box().unwrap();
    let first = Accel::build(&scene);
    let mut builder = crate::scene::SceneBuilder::from_scene(&scene, Default::default());
    builder.set_transform("tall block", DAffine3::from_translation(DVec3::new(0.3, 0.0, 0.0))).unwrap();
    let (moved, change) = builder.finish();
    let updated = first.updated(&moved, &change);
    let fresh = Accel::build(&moved);
    assert_eq!(updated.report().trees_built, 0);
    let mut numbers = Numbers(5);
    for _ in 0..10_000 {
        let ray = Ray::new(numbers.point(1.0).as_vec3(), numbers.direction());
        assert_eq!(updated.closest_hit(&ray, |_| true), fresh.closest_hit(&ray, |_| true));
    }
}

/// Transforms that shear lose digits on the way into mesh space and back: a ray still starts on the side it leaves to.
#[test]
fn rays_start_on_their_side_of_sheared_surfaces() {
    let mut numbers = Numbers(13);
    for case in 0..40 {
        let squash = [1.0, 1e-2, 1e-4, 1e-5][case % 4];
        let (mut stage, grey) = stage_with_grey();
        let mut turn = || {
            DMat3::from_quat(DQuat::from_axis_angle(
                numbers.direction().as_dvec3().normalize(),
                6.0 * numbers.next(),
            ))
        };
        let sheared = turn() * DMat3::from_diagonal(DVec3::new(1.0, squash, 1.0)) * turn();
        let body = samples::cuboid(DVec3::NEG_ONE, DVec3::new(1.0, 2.0, 0.1), &grey);
        stage.place("body", body, DAffine3::from_mat3_translation(sheared, DVec3::ZERO)).unwrap();
        let accel = Accel::build(&stage.finish());
        let instance = &accel.instances()[0];
        for _ in 0..2000 {
            let (mut b1, mut b2) = (numbers.next() as f32, numbers.next() as f32);
            if b1 + b2 > 1.0 {
                (b1, b2) = (1.0 - b1, 1.0 - b2);
            }
            let triangle = (numbers.next() * 12.0) as u32;
            let point = instance.surface_point(triangle, b1, b2);
            let direction = numbers.direction();
            let start =
                instance.ray_in_mesh(&Ray::new(point.origin_towards(direction), direction)).origin.as_dvec3();
            let corners = instance.mesh().triangles()[triangle as usize];
            let [a, b, c] = corners.map(|vertex| instance.mesh().positions()[vertex as usize].as_dvec3());
            let above = (b - a).cross(c - a).dot(start - a);
            assert!(above * f64::from(direction.dot(point.n_geo)) > 0.0, "squash {squash} case {case}");
        }
    }
}

/// Of two surfaces in one place the one of the earlier instance is met, everywhere and from everywhere.
#[test]
fn coincident_surfaces_have_one_winner() {
    let mut numbers = Numbers(17);
    let (mut stage, grey) = stage_with_grey();
    let placed = DAffine3::from_scale_rotation_translation(
        DVec3::new(1.0, 2.0, 0.7),
        DQuat::from_axis_angle(DVec3::new(1.0, -1.0, 0.4).normalize(), 0.8),
        DVec3::new(0.3, 0.1, -0.7),
    );
    for name in ["a", "b", "c"] {
        stage.place(name, samples::sphere(DVec3::ZERO, 1.0, 24, &grey), placed).unwrap();
    }
    let accel = Accel::build(&stage.finish());
    let mut hits = 0;
    for _ in 0..20_000 {
        let ray = Ray::new(numbers.point(3.0).as_vec3(), numbers.direction());
        if let Some(hit) = accel.closest_hit(&ray, |_| true) {
            assert_eq!(hit.instance, 0);
            hits += 1;
        }
    }
    assert!(hits > 1000, "the balls must be hit often to test anything: {hits}");
}
