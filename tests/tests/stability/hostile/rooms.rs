//! Rooms that hostilities are done to: each some metres wide, with an eye at (0.3, 1.4, 1.9) that looks towards −Z.

use glam::{DAffine3, DVec3};
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::samples::{cuboid, quad, sphere};
use lumicast_engine::scene::{Environment, LightKind, Material};
use lumicast_tests::Random;

use crate::draft::{Draft, glass, matt, metal, v};

type Room = (&'static str, fn(&mut Random) -> Draft);

pub(super) const ROOMS: [Room; 5] = [
    ("closed room", closed),
    ("open floor", open),
    ("room of glass and mirrors", shining),
    ("furnace", furnace),
    ("two rooms", two_rooms),
];

/// Somewhere in a room, off its walls.
pub(super) fn somewhere(random: &mut Random) -> DVec3 {
    v(random.between(-1.7, 1.7), random.between(0.2, 2.2), random.between(-1.7, 0.5))
}

fn seen() -> Draft {
    Draft::seen_from(v(0.3, 1.4, 1.9), v(-0.05, 0.8, -0.5), 1.2)
}

fn walls_and_lamp(random: &mut Random) -> Draft {
    let mut room = seen();
    let albedo = random.between(0.3, 0.8) as f32;
    room.thing("walls", matt(albedo), |id| cuboid(v(-2., 0., -2.), v(2., 2.5, 2.), id));
    let half = random.between(0.3, 0.8);
    room.thing("lamp", Material::emitter(Rgb::new(12.0, 10.0, 8.0)), |id| {
        quad([v(-half, 2.4, -half), v(half, 2.4, -half), v(half, 2.4, half), v(-half, 2.4, half)], id)
    });
    room
}

/// Matt, with two blocks.
fn closed(random: &mut Random) -> Draft {
    let mut room = walls_and_lamp(random);
    for (name, x) in [("tall block", -0.9), ("low block", 0.7)] {
        let height = random.between(0.4, 1.5);
        let thing = room.thing(name, matt(0.6), |id| cuboid(v(-0.3, 0., -0.3), v(0.3, height, 0.3), id));
        thing.world_from_mesh =
            DAffine3::from_translation(v(x, 0.0, -0.7)) * DAffine3::from_rotation_y(random.between(0.0, 3.0));
    }
    room
}

/// A floor with a ball under an even sky and a sun.
fn open(random: &mut Random) -> Draft {
    let mut room = seen();
    room.thing("floor", matt(0.5), |id| {
        quad([v(-3., 0., 3.), v(3., 0., 3.), v(3., 0., -3.), v(-3., 0., -3.)], id)
    });
    let coated = Material { base_color: Rgb::splat(0.5), roughness: 0.4, ..Material::default() };
    room.thing("ball", coated, |id| sphere(v(0.2, 0.6, -0.6), 0.6, 16, id));
    room.environment = Environment::Constant(Rgb::new(0.4, 0.5, 0.7));
    if random.below(2) == 0 {
        let kind = LightKind::Directional { irradiance: Rgb::splat(2.0) };
        room.light("sun", DVec3::ZERO, v(0.3, -1.0, -0.4), kind);
    }
    room
}

/// With a glass ball, a mirror, and something glossy; in half of the rooms a light without size.
fn shining(random: &mut Random) -> Draft {
    let mut room = walls_and_lamp(random);
    room.thing("glass ball", glass(1.5), |id| sphere(v(0.6, 0.5, -0.4), 0.4, 16, id));
    room.thing("mirror", metal(0.9, 0.0), |id| {
        quad([v(-1.9, 0.3, -1.), v(-1.9, 0.3, 1.), v(-1.5, 1.8, 1.), v(-1.5, 1.8, -1.)], id)
    });
    let roughness = random.between(0.2, 0.7) as f32;
    room.thing("brushed block", metal(0.8, roughness), |id| {
        cuboid(v(-0.8, 0., -1.2), v(-0.2, 0.7, -0.6), id)
    });
    if random.below(2) == 0 {
        let kind = LightKind::Point { intensity: Rgb::new(2.0, 1.5, 1.0) };
        room.light("point", v(-0.5, 1.8, 0.6), DVec3::NEG_Y, kind);
    }
    room
}

/// Every surface emits and reflects the same.
fn furnace(random: &mut Random) -> Draft {
    let mut room = seen();
    let albedo = random.between(0.1, 0.9) as f32;
    let wall = Material { emission: Rgb::splat(0.5), double_sided: true, ..matt(albedo) };
    room.thing("walls", wall.clone(), |id| cuboid(v(-2., 0., -2.), v(2., 2.5, 2.), id));
    room.thing("block", wall, |id| cuboid(v(-0.5, 0., -1.), v(0.3, 0.8, -0.3), id));
    room
}

/// The lamp is behind a wall with a door in it.
fn two_rooms(random: &mut Random) -> Draft {
    let mut room = walls_and_lamp(random);
    room.things[1].world_from_mesh = DAffine3::from_translation(v(0.0, 0.0, -1.2));
    let door = random.between(0.2, 0.6);
    for (name, from, to) in [("left of the door", -2.0, -door), ("right of the door", door, 2.0)] {
        room.thing(name, matt(0.6), |id| {
            quad([v(from, 0., -0.3), v(to, 0., -0.3), v(to, 2.5, -0.3), v(from, 2.5, -0.3)], id)
        });
    }
    room
}
