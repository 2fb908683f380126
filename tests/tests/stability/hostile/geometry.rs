//! Hostile surfaces: too small, too large, too thin, twice in one place, with holes, with normals that are wrong.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use lumicast_engine::scene::samples::{cuboid, quad, sphere};
use lumicast_engine::scene::{Id, MeshSource, Primitive};
use lumicast_tests::Random;

use super::case::Case;
use super::hostility::Hostility;
use super::rooms::somewhere;
use crate::draft::{matt, v};

pub(super) const ALL: [Hostility; 24] = [
    Hostility::mild("any size", |case, random| {
        case.draft.placed.scale *= 10f64.powf(random.between(-4.0, 4.0));
    }),
    Hostility::mild("far away", |case, random| {
        let mut far = || 1e5 * random.between(-1.0, 1.0);
        case.draft.placed.offset = v(far(), far(), far());
    }),
    Hostility::mild("turned", |case, random| {
        let axis = v(random.between(-1., 1.), random.between(-1., 1.), 1.5).normalize();
        case.draft.placed.turn = DQuat::from_axis_angle(axis, random.between(0.0, 6.0));
    }),
    Hostility::mild("slivers", |case, random| {
        let width = 10f64.powf(random.between(-8.0, -3.0));
        let corners = (0..20).flat_map(|_| {
            let (a, b) = (somewhere(random), somewhere(random));
            [a, b, b + (b - a).any_orthonormal_vector() * width]
        });
        let corners = corners.collect();
        case.draft.thing("slivers", matt(0.5), |id| soup(corners, id));
    }),
    Hostility::mild("degenerate triangles", |case, random| {
        let (a, b, c) = (somewhere(random), somewhere(random), somewhere(random));
        let corners = vec![a, a, a, a, b, b, a, b, (a + b) / 2.0, a, b, c];
        case.draft.thing("degenerate", matt(0.5), |id| soup(corners, id));
    }),
    Hostility::mild("nothing but degenerate triangles", |case, random| {
        let (a, b) = (somewhere(random), somewhere(random));
        case.draft.thing("degenerate", matt(0.5), |id| soup(vec![a, a, a, a, b, b], id));
    }),
    Hostility::mild("a mesh without triangles", |case, _| {
        case.draft.thing("degenerate", matt(0.5), |id| soup(Vec::new(), id));
    }),
    Hostility::mild("a thing twice", |case, random| {
        let Some(thing) = random.pick(&case.draft.things).cloned() else { return };
        case.draft.again(&thing);
    }),
    Hostility::mild("everything twice", |case, _| {
        case.draft.things.clone().iter().for_each(|thing| case.draft.again(thing));
    }),
    Hostility::mild("another floor in one plane", |case, random| {
        let half = random.between(0.5, 3.0);
        let corners = [v(-half, 0., half), v(half, 0., half), v(half, 0., -half), v(-half, 0., -half)];
        case.draft.thing("carpet", matt(0.2), |id| quad(corners, id));
    }),
    Hostility::mild("normals of no length", |case, _| with_normals(case, |_, _| Vec3::ZERO)),
    Hostility::mild("normals of any length", |case, random| {
        let exponent = random.between(-30.0, 30.0) as f32;
        with_normals(case, |n, _| n * 10f32.powf(exponent));
    }),
    Hostility::harsh("normals that point inside", |case, _| with_normals(case, |n, _| -n)),
    Hostility::harsh("normals that point anywhere", |case, random| {
        let mut random = random.clone();
        with_normals(case, |_, _| {
            let mut any = || random.between(-1.0, 1.0) as f32;
            Vec3::new(any(), any(), any())
        });
    }),
    Hostility::harsh("normals along the surface", |case, _| {
        with_normals(case, |n, _| n.any_orthogonal_vector() + n * 1e-6);
    }),
    Hostility::mild("holes", |case, random| {
        for thing in &mut case.draft.things {
            let kept = thing.mesh.triangles.iter().filter(|_| random.below(3) > 0);
            thing.mesh.triangles = kept.copied().collect();
            thing.mesh.primitives[0].triangle_count = thing.mesh.triangles.len() as u32;
        }
    }),
    Hostility::mild("a single triangle", |case, random| {
        let Some(mut thing) = random.pick(&case.draft.things).cloned() else { return };
        thing.mesh.triangles.truncate(1);
        thing.mesh.primitives[0].triangle_count = thing.mesh.triangles.len() as u32;
        case.draft.things = vec![thing];
    }),
    Hostility::mild("a fan of needles", |case, random| {
        let (tip, end) = (somewhere(random), somewhere(random));
        let step = (end - tip).any_orthonormal_vector() * 1e-4;
        let corners = (0..200).flat_map(|i| [tip, end + step * f64::from(i), end + step * f64::from(i + 1)]);
        let corners = corners.collect();
        case.draft.thing("fan", matt(0.7), |id| soup(corners, id));
    }),
    Hostility::mild("a thing pressed flat", |case, random| {
        let flat = 10f64.powf(random.between(-5.0, -2.0));
        if let Some(at) = any_thing(case, random) {
            let thing = &mut case.draft.things[at];
            thing.world_from_mesh *= DAffine3::from_scale(v(1.0, flat, 1.0));
        }
    }),
    Hostility::mild("a thing turned inside out", |case, random| {
        if let Some(at) = any_thing(case, random) {
            let thing = &mut case.draft.things[at];
            thing.world_from_mesh *= DAffine3::from_scale(v(-1.0, 1.0, 1.0));
        }
    }),
    Hostility::mild("a speck", |case, random| {
        let (at, size) = (somewhere(random), 10f64.powf(random.between(-9.0, -4.0)));
        case.draft.thing("speck", matt(0.8), |id| sphere(at, size, 6, id));
    }),
    // The room is a speck in it.
    Hostility::harsh("an endless floor", |case, random| {
        let half = 10f64.powf(random.between(3.0, 6.0));
        let y = random.between(-1.0, -1e-3);
        let corners = [v(-half, y, half), v(half, y, half), v(half, y, -half), v(-half, y, -half)];
        case.draft.thing("plain", matt(0.4), |id| quad(corners, id));
    }),
    Hostility::mild("a wall hardly off a wall", |case, random| {
        let off = 10f64.powf(random.between(-9.0, -3.0));
        case.draft.thing("panel", matt(0.3), |id| {
            cuboid(v(-1.0, 0.5, -2.0 + off), v(1.0, 2.0, -2.0 + 2.0 * off), id)
        });
    }),
    Hostility::harsh("nothing", |case, _| case.draft.things.clear()),
];

fn any_thing(case: &Case, random: &mut Random) -> Option<usize> {
    (!case.draft.things.is_empty()).then(|| random.below(case.draft.things.len()))
}

/// Triangles that share no corners.
pub(super) fn soup(corners: Vec<DVec3>, material: &Id) -> MeshSource {
    let triangle_count = corners.len() as u32 / 3;
    let triangles = (0..triangle_count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let primitives = vec![Primitive { first_triangle: 0, triangle_count, material: material.clone() }];
    MeshSource { positions: corners, triangles, primitives, ..MeshSource::default() }
}

/// Gives every corner of every mesh another normal for the one that it has, or that its place off the middle would give it.
fn with_normals(case: &mut Case, mut normal: impl FnMut(Vec3, usize) -> Vec3) {
    for thing in &mut case.draft.things {
        let mesh = &mut thing.mesh;
        let middle = mesh.positions.iter().sum::<DVec3>() / mesh.positions.len().max(1) as f64;
        let before: Vec<Vec3> = match mesh.normals.len() {
            0 => mesh.positions.iter().map(|p| (*p - middle).normalize_or(DVec3::Y).as_vec3()).collect(),
            _ => mesh.normals.clone(),
        };
        mesh.normals = before.into_iter().enumerate().map(|(at, n)| normal(n, at)).collect();
    }
}
