//! Scenes and rays at the end of what is possible: no panic, no endless walk, no hit where nothing is.

use super::*;
use crate::accel::{node::WIDTH, top::TopTree};

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
                assert_hits_nothing(&accel, &ray);
            }
        }
        for (origin, t_max) in odd_starts_and_ends() {
            assert_hits_nothing(&accel, &Ray { t_max, ..Ray::new(origin, numbers.direction()) });
        }
    }
}

/// Origins and ends of rays that hit nothing: one of the two is odd, or both are.
fn odd_starts_and_ends() -> Vec<(Vec3, f32)> {
    let odd = [0.0, f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let origins =
        (1..odd.len().pow(3)).map(|code| Vec3::new(odd[code % 5], odd[code / 5 % 5], odd[code / 25]));
    let ends = [f32::NAN, -f32::NAN, -1.0, -0.0, 0.0, f32::NEG_INFINITY];
    let mut cases: Vec<(Vec3, f32)> = ends.map(|t_max| (Vec3::new(0.0, 0.1, 0.0), t_max)).to_vec();
    cases.extend(origins.flat_map(|origin| {
        let ends = ends.into_iter().chain([1.0, f32::INFINITY]);
        ends.map(move |t_max| (origin, t_max))
    }));
    cases
}

fn assert_hits_nothing(accel: &Accel, ray: &Ray) {
    assert_eq!(accel.closest_hit(ray, |_| true), None, "{ray:?}");
    assert!(!accel.is_occluded(ray, |_| true), "{ray:?}");
}

/// Odd rays come to an end, with nothing hit and no stack overrun, in a deep tree over instances whose nodes have been
/// emptied by edits; other rays hit what is left.
#[test]
fn odd_rays_hit_nothing_in_a_tree_of_emptied_nodes() {
    let mut numbers = Numbers(89);
    let mut accel = Accel::build(&piled_up(&mut numbers, 600));
    // Two instances, and the rest put in one by one: a chain of nodes, each in the first slot of the one above.
    let mut top = TopTree::build(&accel.instances[..2]);
    for index in 2..600 {
        top.insert(index, &accel.instances[index as usize]);
    }
    let is_left = |index: u32| index % 50 == 7;
    (0..600).filter(|index| !is_left(*index)).for_each(|index| top.remove(index));
    top.finish();
    accel.top = std::sync::Arc::new(Top::new(top));
    for (origin, t_max) in odd_starts_and_ends() {
        for _ in 0..4 {
            assert_hits_nothing(&accel, &Ray { t_max, ..Ray::new(origin, numbers.direction()) });
        }
    }
    let rays = random_rays(&mut numbers, 1000, 0.8);
    let hits = assert_as_a_loop(&accel, &rays, |hit| is_left(hit.instance));
    assert!(hits > 50, "what is left must be hit to test anything: {hits}");
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

/// Triangles that are all alike, in one place or in a row, make a tree and not a list, however small they are.
///
/// That takes building it no longer than other trees; triangles that grow steadily along a row do (see "Known limits" in
/// the engine's README).
#[test]
fn triangles_that_are_alike_make_no_list() {
    const COUNT: usize = 4000;
    // 4000 take 4 levels where leaves and nodes are full. The trees have 5 to 10, as boxes that are all alike leave the
    // builder nothing to go by; half as many again are let pass. Lists had hundreds.
    const LEVELS_MAX: usize = 15;
    for (step, size) in [0.0, 1.0].into_iter().flat_map(|step| [1.0, 1e-12, 1e-24].map(|size| (step, size))) {
        let scene = scene_of(|grey| {
            let at = |index: usize| DVec3::X * step * index as f64;
            let corners = (0..COUNT).map(|index| {
                [DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, 1.0)].map(|p| (at(index) + p) * size)
            });
            loose(corners, grey)
        });
        let bottom = BottomTree::build(scene.meshes().values().next().unwrap());
        let levels = bottom.tree().stack_need() / WIDTH - 1;
        assert!(levels <= LEVELS_MAX, "step {step}, size {size}: {levels} levels");
    }
}
