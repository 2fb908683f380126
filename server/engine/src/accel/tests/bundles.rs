//! Rays that are asked for together get the answers they get alone.

use super::*;

/// Groups of eight rays from about one place in about one direction.
fn neighbours(numbers: &mut Numbers, groups: usize, half_size: f64, spread: f64) -> Vec<Ray> {
    (0..groups)
        .flat_map(|_| {
            let (origin, direction) = (numbers.point(half_size), numbers.direction().as_dvec3());
            let share = if numbers.index(2) == 0 { 0.0 } else { 0.01 * half_size };
            (0..RAYS)
                .map(|_| {
                    let origin = (origin + numbers.point(share)).as_vec3();
                    Ray::new(origin, (direction + numbers.point(spread)).as_vec3())
                })
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Returns how many groups of eight were walked as one.
fn assert_together_as_alone(name: &str, accel: &Accel, rays: &[Ray], accept: impl Fn(&Hit) -> bool) -> usize {
    for instructions in [Instructions::Baseline, Instructions::Avx2] {
        let accel = accel.limited_to(instructions);
        let mut together = vec![None; rays.len()];
        accel.closest_hits(rays, &mut together, &accept);
        let mut hits = 0;
        for (ray, together) in rays.iter().zip(&together) {
            let alone = accel.closest_hit(ray, &accept);
            assert_eq!(*together, alone, "{name}: {ray:?}");
            hits += usize::from(alone.is_some());
        }
        assert!(hits > rays.len() / 20, "{name} must be hit often to test anything: {hits}");
    }
    let bounds = accel.top.tree().tree().bounds();
    let (eights, _) = rays.as_chunks::<RAYS>();
    let level = Instructions::Avx2.level();
    eights
        .iter()
        .filter(|eight| vectorized!(level, simd => Bundle::new(simd, eight, bounds)).is_some())
        .count()
}

/// On soup and slivers, at every spread, with a rest that makes no eight.
#[test]
fn rays_of_soup_and_slivers_are_answered_together_as_alone() {
    let mut numbers = Numbers(71);
    for spread in [0.0, 1e-6, 1e-3, 0.02, 0.2] {
        let scene = scene_of(|grey| soup(&mut numbers, 5000, 2.0, 0.2, grey));
        let rays = neighbours(&mut numbers, 600, 3.0, spread);
        let bundles = assert_together_as_alone("soup", &Accel::build(&scene), &rays[3..], |_| true);
        // Shifted by three the groups are torn apart; as they are, most make bundles unless they spread far.
        assert!(bundles < 60, "{bundles}");
        let bundles = assert_together_as_alone("soup", &Accel::build(&scene), &rays, |_| true);
        assert!(spread > 0.1 || bundles > 300, "spread {spread}: {bundles} of 600");
        let scene = scene_of(|grey| slivers(&mut numbers, 3000, 2.0, grey));
        assert_together_as_alone("slivers", &Accel::build(&scene), &rays, |_| true);
    }
}

/// Through moved, turned, scaled and mirrored instances that overlap, with triangles that do not count, far from the
/// world's origin, and from the triangles that rays leave.
#[test]
fn rays_of_instances_are_answered_together_as_alone() {
    let mut numbers = Numbers(73);
    let (mut stage, grey) = stage_with_grey();
    for index in 0..12 {
        let at = numbers.point(1.5) + 1e5;
        let turn = if index % 3 == 0 { DMat3::IDENTITY } else { numbers.turn() };
        let scale = if index % 3 == 2 { DVec3::new(-0.5, 1.0, 2.0) } else { DVec3::ONE };
        let placed = DAffine3::from_mat3_translation(turn * DMat3::from_diagonal(scale), at);
        let mesh = soup(&mut numbers, 400, 1.0, 0.3, &grey);
        stage.place(&format!("soup {index}"), mesh, placed).unwrap();
    }
    let accel = Accel::build(&stage.finish());
    let middle = accel.to_render(DVec3::splat(1e5));
    let rays: Vec<Ray> = neighbours(&mut numbers, 1500, 3.0, 0.01)
        .into_iter()
        .map(|ray| Ray { origin: ray.origin + middle, ..ray })
        .collect();
    assert_together_as_alone("all", &accel, &rays, |_| true);
    assert_together_as_alone("every other", &accel, &rays, |hit| hit.triangle % 2 == 0);
    let onwards: Vec<Ray> = rays
        .iter()
        .filter_map(|ray| {
            let hit = accel.closest_hit(ray, |_| true)?;
            Some(accel.instances()[hit.instance as usize].point_of(&hit).ray_towards(ray.direction))
        })
        .collect();
    for ray in &onwards {
        let hit = accel.closest_hit(ray, |_| true);
        assert!(hit.is_none_or(|hit| hit.triangle_id() != ray.left));
    }
    assert_together_as_alone("onwards", &accel, &onwards, |_| true);
}

/// Seen from inside a closed mesh, towards vertices and edges, eight at a time nothing escapes either.
#[test]
fn no_bundle_escapes_from_a_closed_mesh() {
    let mut numbers = Numbers(79);
    let scene = scene_of(|grey| samples::sphere(DVec3::ZERO, 1.0, 24, grey));
    let accel = Accel::build(&scene);
    let vertices = scene.meshes()["mesh"].positions();
    let groups = if is_nightly() { 1_000_000 } else { 20_000 };
    for _ in 0..groups {
        let origin = numbers.point(0.4).as_vec3();
        let first = vertices[numbers.index(vertices.len())] - origin;
        let eight: [Ray; RAYS] = std::array::from_fn(|index| match index {
            0 => Ray::new(origin, first),
            _ => Ray::new(origin, first + numbers.point(0.03).as_vec3()),
        });
        let mut hits = [None; RAYS];
        accel.closest_hits(&eight, &mut hits, |_| true);
        assert!(hits.iter().all(Option::is_some), "{eight:?}");
    }
}

/// A ray that is none changes nothing for the seven it comes with, whichever of the eight it is.
#[test]
fn odd_rays_leave_their_neighbours_alone() {
    let mut numbers = Numbers(83);
    let scene = scene_of(|grey| samples::sphere(DVec3::ZERO, 1.0, 16, grey));
    let accel = Accel::build(&scene);
    let good = Ray::new(Vec3::new(0.1, 0.2, 0.3), numbers.direction());
    let odd = [
        Ray { origin: Vec3::new(f32::NAN, 0.0, 0.0), ..good },
        Ray { origin: Vec3::new(0.0, f32::INFINITY, 0.0), ..good },
        Ray { direction: Vec3::new(0.0, f32::NAN, 1.0), ..good },
        Ray { direction: Vec3::ZERO, ..good },
        Ray { direction: Vec3::splat(f32::INFINITY), ..good },
        Ray { t_max: f32::NAN, ..good },
        Ray { t_max: -1.0, ..good },
        Ray { t_max: 0.5, ..good },
    ];
    for odd in odd {
        for at in 0..RAYS {
            let mut eight = [good; RAYS];
            eight[at] = odd;
            let mut hits = [None; RAYS];
            accel.closest_hits(&eight, &mut hits, |_| true);
            for (index, (ray, hit)) in eight.iter().zip(hits).enumerate() {
                assert_eq!(hit, accel.closest_hit(ray, |_| true), "{odd:?} at {at}: ray {index}");
                assert_eq!(hit.is_some(), index != at);
            }
        }
    }
}
