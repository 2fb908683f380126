//! Every instruction set answers with the same bits.

use super::*;

fn assert_same_on_every_level(name: &str, scene: &Scene, rays: &[Ray]) {
    let accel = Accel::build(scene);
    let bits = |hit: Hit| (hit.t.to_bits(), hit.instance, hit.triangle, hit.b1.to_bits(), hit.b2.to_bits());
    let answers = |instructions: Instructions| -> Vec<_> {
        let accel = accel.limited_to(instructions);
        let near = |ray: &Ray| Ray { t_max: accel.radius() * 0.3, ..*ray };
        rays.par_iter()
            .map(|ray| (accel.closest_hit(ray, |_| true).map(bits), accel.is_occluded(&near(ray), |_| true)))
            .collect()
    };
    let expected = answers(Instructions::Baseline);
    let hits = expected.iter().filter(|(hit, _)| hit.is_some()).count();
    assert!(hits > rays.len() / 20, "{name} must be hit often to test anything: {hits}");
    let kind = |instructions: Instructions| std::mem::discriminant(&instructions.level());
    if kind(Instructions::Avx2) == kind(Instructions::Baseline) {
        println!("SKIPPED {name}: this machine has no more than the baseline's instructions");
        return;
    }
    for (ray, (found, expected)) in rays.iter().zip(answers(Instructions::Avx2).iter().zip(&expected)) {
        assert_eq!(found, expected, "{name}: {ray:?}");
    }
}

/// Soup, a room and slivers give the same hits to the last bit on all instruction sets.
#[test]
fn all_instruction_sets_report_the_same_bits() {
    let mut numbers = Numbers(53);
    let scene = scene_of(|grey| soup(&mut numbers, 20_000, 2.0, 0.1, grey));
    assert_same_on_every_level("soup", &scene, &random_rays(&mut numbers, 20_000, 3.0));
    let room = samples::cornell_box().unwrap();
    assert_same_on_every_level("room", &room, &random_rays(&mut numbers, 20_000, 1.2));
    let scene = scene_of(|grey| slivers(&mut numbers, 5000, 2.0, grey));
    let aimed: Vec<Ray> = {
        let accel = Accel::build(&scene);
        let vertices = accel.instances()[0].mesh().positions().len();
        (0..20_000)
            .map(|_| {
                let origin = numbers.point(3.0).as_vec3();
                let at = |numbers: &mut Numbers| {
                    accel.instances()[0].vertex_in_render(numbers.index(vertices) as u32)
                };
                let target = at(&mut numbers);
                Ray::new(origin, target - origin)
            })
            .collect()
    };
    assert_same_on_every_level("slivers", &scene, &aimed);
}

/// Rays that meet vertices, edges and box sides exactly are where rounding would show first.
#[test]
fn all_instruction_sets_agree_on_edges() {
    let mut numbers = Numbers(59);
    let (mut stage, grey) = stage_with_grey();
    for i in 0..8 {
        let at = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 1.25;
        let cube = samples::cuboid(DVec3::ZERO, DVec3::ONE, &grey);
        stage.place(&format!("cube {i}"), cube, DAffine3::from_translation(at)).unwrap();
    }
    let quarter =
        |numbers: &mut Numbers| Vec3::from_array([0; 3].map(|_| numbers.index(21) as f32 * 0.25 - 2.5));
    let rays: Vec<Ray> = (0..20_000)
        .map(|i| {
            let mut direction = quarter(&mut numbers);
            if i % 2 == 0 || direction == Vec3::ZERO {
                direction = Vec3::ZERO;
                direction[i / 2 % 3] = if i % 4 == 0 { 1.0 } else { -1.0 };
            }
            Ray::new(quarter(&mut numbers), direction)
        })
        .collect();
    assert_same_on_every_level("cubes", &stage.finish(), &rays);
}
