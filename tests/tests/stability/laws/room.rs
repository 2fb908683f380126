//! The room that laws are tried in, and other ways to write the same room down.

use glam::{DAffine3, DVec3};
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::samples::{cuboid, quad, sphere};
use lumicast_engine::scene::{LightKind, Material, MeshSource};

use crate::draft::{Draft, Similarity, glass, matt, metal, v};

/// A closed room, 4 m wide, with a lamp and a light without size; a matt and a glossy block, a mirror and a glass ball in it.
pub(super) fn room() -> Draft {
    let mut room = Draft::seen_from(v(0.3, 1.4, 1.9), v(-0.05, 0.8, -0.5), 1.2);
    room.thing("walls", coloured(0.7, 0.6, 0.5), |id| cuboid(v(-2., 0., -2.), v(2., 2.5, 2.), id));
    room.thing("lamp", Material::emitter(Rgb::new(12.0, 10.0, 8.0)), |id| {
        quad([v(-0.5, 2.48, -0.6), v(0.5, 2.48, -0.6), v(0.5, 2.48, 0.4), v(-0.5, 2.48, 0.4)], id)
    });
    room.thing("tall block", coloured(0.6, 0.3, 0.2), |id| {
        cuboid(v(-1.4, 0., -1.3), v(-0.7, 1.4, -0.6), id)
    })
    .world_from_mesh = DAffine3::from_rotation_y(0.2);
    let coated = Material { base_color: Rgb::new(0.3, 0.5, 0.7), roughness: 0.5, ..Material::default() };
    room.thing("coated block", coated, |id| cuboid(v(-0.1, 0., -1.2), v(0.5, 0.6, -0.6), id))
        .world_from_mesh = DAffine3::from_rotation_y(-0.15);
    room.thing("mirror ball", metal(0.9, 0.0), |id| sphere(v(1.2, 0.5, -0.6), 0.4, 24, id));
    room.thing("glass ball", glass(1.5), |id| sphere(v(-0.3, 0.4, 0.2), 0.25, 24, id));
    let kind = LightKind::Point { intensity: Rgb::new(1.0, 1.4, 2.0) };
    room.light("point", v(1.3, 1.9, 0.9), DVec3::NEG_Y, kind);
    room
}

fn coloured(r: f32, g: f32, b: f32) -> Material {
    Material::lambert(Rgb::new(r, g, b))
}

/// In another size, turn and place.
pub(super) fn placed(mut draft: Draft, placed: Similarity) -> Draft {
    draft.placed = placed;
    draft
}

/// With the triangles of every mesh, and their corners, in another order; and the meshes, too.
pub(super) fn permuted(mut draft: Draft) -> Draft {
    draft.things.reverse();
    for thing in &mut draft.things {
        thing.mesh.triangles.reverse();
        thing.mesh.triangles.iter_mut().for_each(|triangle| triangle.rotate_left(1));
    }
    draft
}

/// With every flat triangle cut into three of uneven size. A smooth mesh would bend between other corners.
pub(super) fn split(mut draft: Draft) -> Draft {
    for thing in draft.things.iter_mut().filter(|thing| thing.mesh.normals.is_empty()) {
        split_mesh(&mut thing.mesh);
    }
    draft
}

fn split_mesh(mesh: &mut MeshSource) {
    let mut triangles = Vec::new();
    for [a, b, c] in std::mem::take(&mut mesh.triangles) {
        let weights = [(a, 0.5), (b, 0.2), (c, 0.3)];
        let inner: DVec3 = weights.iter().map(|(corner, w)| mesh.positions[*corner as usize] * *w).sum();
        let d = mesh.positions.len() as u32;
        mesh.positions.push(inner);
        triangles.extend([[a, b, d], [b, c, d], [c, a, d]]);
    }
    mesh.primitives[0].triangle_count = triangles.len() as u32;
    mesh.triangles = triangles;
}

/// With its lamp alone, or without.
pub(super) fn lit_by(mut draft: Draft, by: LitBy) -> Draft {
    match by {
        LitBy::Lamp => draft.lights.clear(),
        LitBy::Point => {
            let lamps = draft.things.iter_mut().filter(|thing| thing.material.is_emissive());
            lamps.for_each(|lamp| lamp.material.emission = Rgb::BLACK);
        }
    }
    draft
}

/// One of the room's lights.
#[derive(Clone, Copy, Debug)]
pub(super) enum LitBy {
    Lamp,
    Point,
}

/// A closed box whose every face emits and reflects, with another such box in it: radiance `emission` / (1 − `albedo`)
/// everywhere, at edges, between the two, and inside the inner one.
pub(super) fn furnace(albedo: f32, emission: f32) -> Draft {
    let mut furnace = Draft::seen_from(v(0.7, 0.4, 0.8), v(-0.6, -0.7, -0.5), 1.2);
    let wall = Material { emission: Rgb::splat(emission), double_sided: true, ..matt(albedo) };
    furnace.thing("walls", wall.clone(), |id| cuboid(DVec3::splat(-1.0), DVec3::ONE, id));
    furnace.thing("box", wall, |id| cuboid(v(-0.6, -1.0, -0.5), v(-0.1, -0.4, 0.0), id)).world_from_mesh =
        DAffine3::from_rotation_y(0.3);
    furnace
}

/// Two squares in the room, one over the floor and one before a wall: one emits, the other is looked at, all of it and nothing
/// else. They stand off what is behind them: at their edges the octree takes what lies under a thin thing for as lit as the rest.
///
/// - returns also the area of the square that is looked at, m²
pub(super) fn exchange(is_swapped: bool) -> (Draft, f64) {
    let mut room = lit_by(room(), LitBy::Point);
    room.lights.clear();
    let sides = [0.3, 0.7];
    let [lamp, sensor] = if is_swapped { [1, 0] } else { [0, 1] };
    let emission = |at: usize| if at == lamp { Rgb::splat(200.0) } else { Rgb::BLACK };
    let centres = [v(0.8, 0.3, 0.7), v(-1.7, 1.3, 0.4)];
    let ups = [DVec3::Y, DVec3::X];
    for at in [0, 1] {
        let (centre, half) = (centres[at], sides[at] / 2.0);
        let across = [DVec3::X, DVec3::Y][at] * half;
        let along = ups[at].cross(across);
        let corners = [
            centre - across - along,
            centre + across - along,
            centre + across + along,
            centre - across + along,
        ];
        let material = Material { emission: emission(at), ..matt(0.5) };
        room.thing("square", material, |id| quad(corners, id));
    }
    let (centre, up) = (centres[sensor], ups[sensor]);
    room.view = lumicast_engine::scene::CameraView {
        projection: lumicast_engine::scene::Projection::Orthographic { half_height_m: sides[sensor] / 2.0 },
        ..lumicast_engine::scene::CameraView::look_at(
            centre + up * 0.3,
            centre,
            [DVec3::Z, DVec3::Y][sensor],
            1.0,
        )
    };
    (room, sides[sensor] * sides[sensor])
}

/// With some of its things twice in the very same place.
pub(super) fn twice(is_twice: fn(&str) -> bool) -> Draft {
    let mut twice = room();
    let again: Vec<_> = twice.things.iter().filter(|thing| is_twice(&thing.name)).cloned().collect();
    again.iter().for_each(|thing| twice.again(thing));
    twice
}

/// With another floor of the walls' colour, so high over the floor, cut into other triangles.
pub(super) fn carpeted(y: f64) -> Draft {
    let mut carpeted = room();
    let material = carpeted.things[0].material.clone();
    carpeted.thing("carpet", material, |id| {
        quad([v(-1.9, y, 1.9), v(1.9, y, 1.9), v(1.9, y, -1.9), v(-1.9, y, -1.9)], id)
    });
    carpeted
}
