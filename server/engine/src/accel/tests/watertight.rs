//! Nothing escapes from closed meshes: not at random, not through vertices, along edges, or along the axes.

use super::*;

/// Rays over all bodies and places.
fn ray_count() -> usize {
    if is_nightly() { 100_000_000 } else { 1_000_000 }
}

/// A box whose faces are grids of `n × n` squares, vertices shared, edges along the axes.
fn divided_cuboid(n: u32, half_size: DVec3, material: &Id) -> MeshSource {
    let mut positions = Vec::new();
    let mut known = std::collections::HashMap::new();
    let mut triangles = Vec::new();
    let mut vertex = |p: [u32; 3]| {
        *known.entry(p).or_insert_with(|| {
            positions.push((DVec3::from_array(p.map(f64::from)) * (2.0 / f64::from(n)) - 1.0) * half_size);
            positions.len() as u32 - 1
        })
    };
    for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, n)]) {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let mut corner = |di: u32, dj: u32| {
                let mut p = [side; 3];
                (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (i + di, j + dj);
                vertex(p)
            };
            let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            let squares = if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            triangles.extend(squares);
        }
    }
    mesh_of(positions, triangles, material)
}

/// A sphere whose vertices are pulled out at random: dents, spikes, slivers; all of it is seen from within `0.3`.
fn crumpled_ball(material: &Id) -> MeshSource {
    let mut numbers = Numbers(109);
    let mut ball = samples::sphere(DVec3::ZERO, 1.0, 16, material);
    ball.normals.clear();
    // Vertices in one place, at the seam and the poles, must stay in one place.
    let mut pulled = std::collections::HashMap::new();
    for position in &mut ball.positions {
        let key = position.to_array().map(|x| (x * 1e9).round() as i64);
        let pull = *pulled.entry(key).or_insert_with(|| numbers.between(0.5, 3.0));
        // Exactly alike: computed from the key.
        *position = DVec3::from_array(key.map(|x| x as f64 * 1e-9)) * pull;
    }
    ball
}

fn bodies() -> Vec<(&'static str, MeshSource)> {
    let (_, grey) = stage_with_grey();
    let mut turned = divided_cuboid(5, DVec3::new(1.0, 1.3, 0.8), &grey);
    let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7));
    turned.positions.iter_mut().for_each(|position| *position = turn * *position);
    vec![
        ("cuboid", divided_cuboid(1, DVec3::ONE, &grey)),
        ("divided cuboid", divided_cuboid(7, DVec3::new(1.0, 1.3, 0.8), &grey)),
        ("turned cuboid", turned),
        ("ball", samples::sphere(DVec3::ZERO, 1.0, 24, &grey)),
        ("crumpled ball", crumpled_ball(&grey)),
    ]
}

fn places() -> Vec<(&'static str, DAffine3)> {
    let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(-2.0, 1.0, 0.5).normalize(), 2.1));
    let stretch = DMat3::from_diagonal(DVec3::new(0.5, 3.0, -1.7));
    let far = DVec3::new(1e5, -1e5, 3e4);
    vec![
        ("at the origin", DAffine3::IDENTITY),
        ("moved", DAffine3::from_translation(DVec3::new(0.3, 7.1, -2.9))),
        ("turned and stretched", DAffine3::from_mat3_translation(turn * stretch, DVec3::new(1.0, -2.0, 0.3))),
        ("sheared", DAffine3::from_mat3_translation(turn * stretch * turn, DVec3::new(1.0, -2.0, 0.3))),
        ("100 km away", DAffine3::from_mat3_translation(turn, far)),
        ("100 km away and tiny", DAffine3::from_mat3_translation(turn * 1e-2, far)),
        ("tiny", DAffine3::from_scale(DVec3::splat(1e-4))),
        ("huge", DAffine3::from_mat3_translation(turn * 1e4, DVec3::new(5e3, 0.0, 0.0))),
    ]
}

/// A direction from `origin`: at random, at a vertex, at a point of an edge, or along an axis, of the scene or the mesh.
fn direction_from(origin: Vec3, instance: &Instance, numbers: &mut Numbers) -> Vec3 {
    let triangles = instance.mesh().triangles();
    let [a, b, _] = triangles[numbers.index(triangles.len())].map(|vertex| instance.vertex_in_render(vertex));
    match numbers.index(8) {
        0 | 1 => numbers.direction(),
        2 | 3 => a - origin,
        4 | 5 => a + (b - a) * numbers.next() as f32 - origin,
        kind => {
            let mut axis = [[0.0, -0.0][numbers.index(2)]; 3];
            axis[numbers.index(3)] = [1.0, -1.0][numbers.index(2)];
            let axis = Vec3::from_array(axis);
            if kind == 6 { axis } else { instance.vector_to_render(axis) }
        }
    }
}

/// No ray from inside a closed mesh escapes.
#[test]
fn no_ray_escapes_from_closed_meshes() {
    let (bodies, places) = (bodies(), places());
    let rays = ray_count() / (bodies.len() * places.len());
    for (body, mesh) in &bodies {
        for (place, transform) in &places {
            let accel = Accel::build(&placed(|_| mesh.clone(), *transform));
            let instance = &accel.instances()[0];
            (0..64u64).into_par_iter().for_each(|stream| {
                let mut numbers = Numbers(113 + stream);
                for i in 0..rays / 64 {
                    // Every sixteenth starts in the middle, from where many directions are exact.
                    let inside = if i % 16 == 0 { DVec3::ZERO } else { numbers.point(0.28) };
                    let origin = accel.to_render(transform.transform_point3(inside));
                    let ray = Ray::new(origin, direction_from(origin, instance, &mut numbers));
                    let hit = accel.closest_hit(&ray, |_| true);
                    assert!(hit.is_some(), "{ray:?} escapes from the {body} {place}");
                    assert!(accel.is_occluded(&ray, |_| true), "{ray:?} escapes from the {body} {place}");
                }
            });
        }
    }
}

/// A surface cut into strips as thin as single precision can tell apart has no gaps.
#[test]
fn a_square_of_thin_strips_has_no_gaps() {
    let mut numbers = Numbers(127);
    for turn in [DMat3::IDENTITY, numbers.turn()] {
        let mut cuts = |count: usize| {
            let mut cuts = vec![-1.0, 1.0];
            while cuts.len() < count {
                // Clusters: the next cut is up to a ten-millionth away.
                let near = cuts[numbers.index(cuts.len())];
                let step =
                    10f64.powf(numbers.between(-7.2, 0.0)) * if numbers.next() < 0.5 { -1.0 } else { 1.0 };
                cuts.push((near + step).clamp(-1.0, 1.0));
            }
            cuts.sort_by(f64::total_cmp);
            cuts.dedup_by(|a, b| *a as f32 == *b as f32);
            cuts
        };
        let (low, high) = (cuts(400), cuts(400));
        let positions: Vec<DVec3> = (low.iter().map(|x| turn * DVec3::new(*x, -1.0, 0.0)))
            .chain(high.iter().map(|x| turn * DVec3::new(*x, 1.0, 0.0)))
            .collect();
        let (mut i, mut j, mut triangles) = (0, 0, Vec::new());
        while i + 1 < low.len() || j + 1 < high.len() {
            let [a, b] = [i as u32, (low.len() + j) as u32];
            let lower_next = j + 1 >= high.len() || (i + 1 < low.len() && low[i + 1] < high[j + 1]);
            triangles.push(if lower_next { [a, a + 1, b] } else { [a, b + 1, b] });
            if lower_next { i += 1 } else { j += 1 }
        }
        let scene = scene_of(|grey| mesh_of(positions.clone(), triangles.clone(), grey));
        assert!(scene.warnings().is_empty(), "no strip may be left out: {:?}", scene.warnings());
        let accel = Accel::build(&scene);
        for i in 0..200_000 {
            let inside = |numbers: &mut Numbers| numbers.between(-0.99, 0.99);
            let mut target = DVec3::new(inside(&mut numbers), inside(&mut numbers), 0.0);
            if i % 2 == 0 {
                // On a line from a cut below to one above, an edge or nearly one.
                let (x0, x1) = (low[numbers.index(low.len())], high[numbers.index(high.len())]);
                target.x = (x0 + (x1 - x0) * (target.y + 1.0) / 2.0).clamp(-0.99, 0.99);
            }
            let side = if i % 4 < 2 { 1.0 } else { -1.0 };
            let origin = target + DVec3::new(numbers.between(-1.0, 1.0), numbers.between(-1.0, 1.0), side);
            let (origin, target) = ((turn * origin).as_vec3(), (turn * target).as_vec3());
            let ray = Ray::new(origin, target - origin);
            assert!(accel.closest_hit(&ray, |_| true).is_some(), "{ray:?} falls through");
            assert!(accel.is_occluded(&ray, |_| true), "{ray:?} falls through");
        }
    }
}

/// Rays that leave a wall as paths do, and run along it, meet the wall they run towards, though single precision cannot
/// tell on which side of the edge between both they arrive. Nearer to the wall than paths start they may escape: they
/// cannot tell on which side of the wall they are.
#[test]
fn rays_that_graze_a_wall_do_not_escape_through_its_edge() {
    let (_, grey) = stage_with_grey();
    let rays = if is_nightly() { 100_000_000 } else { 1_000_000 };
    for n in [1, 4] {
        let mut body = divided_cuboid(n, DVec3::new(1.0, 1.3, 0.8), &grey);
        let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7));
        body.positions.iter_mut().for_each(|position| *position = turn * *position);
        let accel = Accel::build(&placed(|_| body, DAffine3::IDENTITY));
        let instance = &accel.instances()[0];
        let triangles = instance.mesh().triangles();
        (0..64u64).into_par_iter().for_each(|stream| {
            let mut numbers = Numbers(131 + stream);
            for _ in 0..rays / 128 {
                let triangle = numbers.index(triangles.len());
                let (b1, b2) = numbers.barycentric();
                let point = instance.surface_point(triangle as u32, b1, b2);
                let [a, b, c] = triangles[triangle].map(|vertex| instance.vertex_in_render(vertex));
                let (a, b) = [(a, b), (b, c), (c, a)][numbers.index(3)];
                let off = numbers.between(-1.0, 1.0) * 10f64.powf(numbers.between(-8.0, -5.0));
                let target = a + (b - a) * numbers.next() as f32 + point.n_geo * off as f32;
                // The front is outside or inside: the middle of the body tells.
                let inward = point.n_geo * -point.n_geo.dot(point.position).signum();
                let origin = point.origin_towards(inward);
                let ray = Ray::new(origin, target - origin);
                assert!(accel.closest_hit(&ray, |_| true).is_some(), "{ray:?} escapes from {n}");
            }
        });
    }
}
