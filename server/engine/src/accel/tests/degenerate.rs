//! Scenes and rays at the end of what is possible: no panic, no endless walk, no hit where nothing is.

use super::*;

/// Rays without a direction or with numbers that are none hit nothing.
#[test]
fn rays_that_are_none_hit_nothing() {
    let mut numbers = Numbers(61);
    let mut scenes = vec![samples::cornell_box().unwrap()];
    for count in [1, 5, 300] {
        scenes.push(scene_of(|grey| soup(&mut numbers, count, 1.0, 0.5, grey)));
    }
    let odd = [0.0, -0.0, 1.0, f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    for accel in scenes.iter().map(Accel::build) {
        for code in 0..odd.len().pow(3) {
            let direction = Vec3::new(odd[code % 7], odd[code / 7 % 7], odd[code / 49]);
            if direction.is_finite() && direction != Vec3::ZERO {
                continue;
            }
            for corner in 0..9 {
                let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
                let origin = if corner == 8 { Vec3::ZERO } else { Vec3::new(sign(0), sign(1), sign(2)) };
                let ray = Ray::new(origin, direction);
                assert_eq!(accel.closest_hit(&ray, |_| true), None, "{ray:?}");
                assert!(!accel.is_occluded(&ray, |_| true), "{ray:?}");
            }
        }
        for origin in [Vec3::NAN, Vec3::INFINITY, Vec3::NEG_INFINITY, Vec3::new(0.0, f32::NAN, 0.0)] {
            let ray = Ray::new(origin, numbers.direction());
            assert_eq!(accel.closest_hit(&ray, |_| true), None, "{ray:?}");
        }
        for t_max in [f32::NAN, -1.0, -0.0, 0.0, f32::NEG_INFINITY] {
            let ray = Ray { t_max, ..Ray::new(Vec3::new(0.0, 0.1, 0.0), numbers.direction()) };
            assert_eq!(accel.closest_hit(&ray, |_| true), None, "{ray:?}");
        }
    }
}

/// Directions of any length, however short or long, meet the same surfaces.
#[test]
fn the_length_of_a_direction_does_not_matter() {
    let mut numbers = Numbers(67);
    let accel = Accel::build(&scene_of(|grey| soup(&mut numbers, 500, 1.0, 0.5, grey)));
    for ray in random_rays(&mut numbers, 2000, 1.5) {
        let expected = accel.closest_hit(&ray, |_| true);
        for exponent in [-60, -30, 30, 60] {
            // Powers of two: nothing is rounded, so that only `t` may change.
            let scale = 2f32.powi(exponent);
            let found = accel.closest_hit(&Ray::new(ray.origin, ray.direction * scale), |_| true);
            assert_eq!(found.map(|hit| Hit { t: hit.t * scale, ..hit }), expected, "{ray:?} by {scale}");
        }
    }
}

/// Nothing to hit, nothing hit.
#[test]
fn an_empty_scene_is_never_hit() {
    let mut numbers = Numbers(71);
    let accel = Accel::build(&Scene::default());
    assert_eq!((accel.radius(), accel.instances().len()), (0.0, 0));
    for ray in random_rays(&mut numbers, 100, 1.0) {
        assert_eq!(accel.closest_hit(&ray, |_| true), None);
        assert!(!accel.is_occluded(&ray, |_| true));
    }
}

/// Packets and nodes that are not full, just full, and just over: every triangle is found, and none twice.
#[test]
fn meshes_of_few_triangles_are_hit_as_a_loop_hits_them() {
    let mut numbers = Numbers(73);
    for count in [1, 2, 7, 8, 9, 15, 16, 17, 63, 64, 65, 73] {
        let accel = Accel::build(&scene_of(|grey| soup(&mut numbers, count, 0.6, 0.8, grey)));
        let hits = assert_as_a_loop(&accel, &random_rays(&mut numbers, 1000, 1.5), |_| true);
        assert!(hits > 10, "{count} triangles must be hit to test anything: {hits}");
    }
}

/// A thousand triangles in one place make a deep tree; the first is hit, and refusing some lets the next count.
#[test]
fn a_thousand_triangles_in_one_place_are_hit_in_order() {
    let corners = [DVec3::new(-1.0, -1.0, 0.0), DVec3::new(1.0, -1.0, 0.2), DVec3::new(0.0, 1.0, -0.2)];
    let mut numbers = Numbers(79);
    let accel = Accel::build(&scene_of(|grey| loose([corners; 1000], grey)));
    for _ in 0..300 {
        let origin = numbers.point(2.0).as_vec3();
        let target = DVec3::new(numbers.between(-0.2, 0.2), numbers.between(-0.6, 0.0), 0.0).as_vec3();
        let ray = Ray::new(origin, target - origin);
        let first = numbers.index(1000) as u32;
        let found = accel.closest_hit(&ray, |hit| hit.triangle >= first);
        assert!(found.is_none_or(|hit| hit.triangle == first), "{found:?} instead of {first}");
    }
    let hits = assert_as_a_loop(&accel, &random_rays(&mut numbers, 500, 1.0), |_| true);
    assert!(hits > 50, "the triangle must be hit to test anything: {hits}");
}

/// Two thousand instances of one body in one place: a deep tree over instances, whose order decides.
#[test]
fn many_instances_in_one_place_are_hit_in_order() {
    let (mut stage, grey) = stage_with_grey();
    stage.place("0", samples::cuboid(DVec3::NEG_ONE, DVec3::ONE, &grey), DAffine3::IDENTITY).unwrap();
    for i in 1..2000 {
        let node =
            crate::scene::Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Id::new("0") };
        stage.builder().add_node(Id::sanitised(&i.to_string(), "node"), node).unwrap();
    }
    let accel = Accel::build(&stage.finish());
    let mut numbers = Numbers(83);
    for ray in random_rays(&mut numbers, 200, 0.9) {
        let first = numbers.index(2000) as u32;
        assert_eq!(accel.closest_hit(&ray, |_| true).unwrap().instance, 0);
        assert_eq!(accel.closest_hit(&ray, |hit| hit.instance >= first).unwrap().instance, first);
    }
}

/// Triangles that are all alike, in one place or in a row, make a tree and not a list: building it takes time in proportion
/// to their number, and walking it needs little room.
#[test]
fn triangles_that_are_alike_make_no_list() {
    const COUNT: usize = 4000;
    for step in [0.0, 1.0] {
        let scene = scene_of(|grey| {
            let at = |index: usize| DVec3::X * step * index as f64;
            let corners = (0..COUNT)
                .map(|index| [DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, 1.0)].map(|p| at(index) + p));
            loose(corners, grey)
        });
        let bottom = BottomTree::build(scene.meshes().values().next().unwrap());
        // 4000 triangles fill five levels of eight at worst half full; a list had some hundreds.
        let need = bottom.tree().stack_need();
        assert!(need < 150, "step {step}: {need} entries");
    }
}
