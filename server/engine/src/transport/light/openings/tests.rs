//! What is told of where the sky shows takes noise and nothing else.

use std::{f64::consts::PI, sync::Arc};

use glam::{DAffine3, DVec3, Vec2};

use super::*;
use crate::{
    accel::{SurfacePoint, TriangleId},
    math::{Frame, Rgb, RunningStatistics, sobol::point, warp},
    scene::{
        Environment, Id, Material, Texels, Texture,
        samples::{Stage, cuboid, glazed_room, room_on_ground},
    },
    transport::ShadowRay,
};

/// A point that is faced, in the void just off a surface.
fn receiver(world: &World, p_in_world: DVec3, n: Vec3) -> SurfacePoint {
    let position = world.accel().to_render(p_in_world);
    SurfacePoint { position, n_geo: n, error_m: 0.0, on: TriangleId::NONE }
}

/// Irradiance of the sky, green channel, by light sampling.
fn irradiance(world: &World, at: &SurfacePoint, opening: Option<&Opening>, count: u32) -> RunningStatistics {
    let mut statistics = RunningStatistics::default();
    for number in 0..count {
        let [a, b, c, _] = point(u64::from(number) + 1, 0);
        let sample = world.lights().sample(world.accel(), at.position, at.n_geo, || opening, [a, b, c]);
        let arriving = sample.filter(|sample| !sample.is_delta).and_then(|sample| {
            let (radiance, shadow) = world.towards_light(at, &sample)?;
            let cos = sample.wi.dot(at.n_geo).max(0.0);
            (!world.is_occluded(&shadow)).then(|| f64::from(radiance.g * cos / sample.pdf))
        });
        statistics.add(arriving.unwrap_or(0.0));
    }
    statistics
}

/// The same by rays to the middles of many parts of the hemisphere.
fn even_irradiance(world: &World, at: &SurfacePoint) -> f64 {
    const FINE: u32 = 600;
    let frame = Frame::around(at.n_geo);
    let arriving = |number: u32| {
        let middle = Vec2::new((number % FINE) as f32 + 0.5, (number / FINE) as f32 + 0.5) / FINE as f32;
        let wi = frame.to_world(warp::cosine_hemisphere(middle.to_array()));
        let shadow = ShadowRay { ray: at.ray_towards(wi), light: None };
        if world.is_occluded(&shadow) { 0.0 } else { f64::from(world.environment_radiance(wi).g) }
    };
    (0..FINE * FINE).map(arriving).sum::<f64>() * PI / f64::from(FINE * FINE)
}

fn world_of(scene: Scene) -> World {
    World::prepare(Arc::new(scene))
}

/// A shed of 4 × 3 × 4 m, open above where the roof has a hole of 0.8 m.
fn shed(environment: impl FnOnce(&mut Stage) -> Environment) -> World {
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(Rgb::splat(0.5))).unwrap();
    let v = DVec3::new;
    let put = |stage: &mut Stage, name: &str, min: DVec3, max: DVec3| {
        stage.place(name, cuboid(min, max, &wall), DAffine3::IDENTITY).unwrap();
    };
    put(&mut stage, "floor", v(-2.1, -0.1, -2.1), v(2.1, 0.0, 2.1));
    for (name, side) in [("low", -1.0), ("high", 1.0)] {
        let across =
            |near: f64, far: f64| (f64::min(side * near, side * far), f64::max(side * near, side * far));
        let (from, to) = across(2.0, 2.1);
        put(&mut stage, &format!("x {name}"), v(from, 0.0, -2.1), v(to, 3.0, 2.1));
        put(&mut stage, &format!("z {name}"), v(-2.0, 0.0, from), v(2.0, 3.0, to));
        let (from, to) = across(0.4, 2.1);
        put(&mut stage, &format!("roof x {name}"), v(from, 3.0, -2.1), v(to, 3.1, 2.1));
        put(&mut stage, &format!("roof z {name}"), v(-0.4, 3.0, from), v(0.4, 3.1, to));
    }
    let environment = environment(&mut stage);
    stage.builder().set_environment(environment).unwrap();
    world_of(stage.finish())
}

/// A sky of `width` × `width / 2` texels that is brighter the higher it is, with a sun nearly above the shed that fills one of them and is
/// so many times as bright.
fn sky_with_sun(width: u32, times: f32) -> impl FnOnce(&mut Stage) -> Environment {
    move |stage| {
        let height = width / 2;
        let sun = (width * 19 / 64, height * 3 / 32);
        let radiance =
            |x: u32, y: u32| if (x, y) == sun { times } else { 1.0 - 0.8 * y as f32 / height as f32 };
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let texels = places.map(|(x, y)| {
            let radiance = radiance(x, y);
            [0.9 * radiance, radiance, 1.1 * radiance, 1.0]
        });
        let id = Id::new("sky").unwrap();
        let texture = Texture { width, height, texels: Texels::Rgba32F(texels.collect()) };
        stage.builder().add_texture(id.clone(), texture).unwrap();
        Environment::Image { texture: id, scale: Rgb::WHITE, rotation_rad: 0.3 }
    }
}

/// In a room with a window: the light is the same as evenly sent rays bring, with a fifth of the variance and less.
#[test]
fn windows_are_found_and_nothing_is_lost() {
    let world = world_of(room_on_ground().unwrap());
    for (p, n) in [
        (DVec3::new(-1.5, 1e-3, 1.0), Vec3::Y),
        (DVec3::new(0.8, 1e-3, -1.2), Vec3::Y),
        (DVec3::new(-1.999, 1.2, -0.4), Vec3::X),
        (DVec3::new(-0.4, 0.4, -1.999), Vec3::Z),
    ] {
        let at = receiver(&world, p, n);
        let opening = world.opening_at(at.position, n, Through::Holes).expect("a window shows");
        let through = irradiance(&world, &at, Some(opening), 40_000);
        let exact = even_irradiance(&world, &at);
        let off = (through.mean() - exact).abs();
        assert!(off < 4.0 * through.standard_error() + 2e-3 * exact, "{p}: {} for {exact}", through.mean());
        let without = irradiance(&world, &at, None, 40_000);
        assert!(through.variance() < 0.2 * without.variance(), "{p}: {through:?}, {without:?}");
    }
}

/// The same under a picture of a sky with a sun, which parts of the hemisphere are too large for: where it shines in, on the floor and across
/// the edge of its light, it gets no more noise than of a quarter of the samples.
#[test]
fn a_sun_in_the_sky_stays_as_bright() {
    for (width, times) in [(32, 20.0), (512, 2e3), (512, 1e5)] {
        let world = shed(sky_with_sun(width, times));
        let mut told = 0;
        // The sun stands 17° from straight above, in x: its light ends at -0.5 m.
        for x in [-0.9, -0.7, -0.55, -0.45, -0.3, 0.4] {
            let at = receiver(&world, DVec3::new(x, 1e-3, 0.1), Vec3::Y);
            let opening = world.opening_at(at.position, Vec3::Y, Through::Holes);
            told += usize::from(opening.is_some());
            let through = irradiance(&world, &at, opening, 100_000);
            let without = irradiance(&world, &at, None, 100_000);
            let off = (through.mean() - without.mean()).abs();
            let error = through.standard_error().hypot(without.standard_error());
            assert!(off < 4.0 * error, "{times} at {x}: {through:?} {without:?}");
            let most = 5.0 * without.variance() + 1e-6;
            assert!(through.variance() < most, "{times} at {x}: {through:?}, {without:?}");
        }
        assert!(told > 1, "the hole shows where the sun does not: {told} of 6");
    }
}

/// Densities are those of the draws: over each part of the hemisphere, and all together.
#[test]
fn densities_are_those_of_draws() {
    let world = world_of(room_on_ground().unwrap());
    let n = Vec3::X;
    let at = receiver(&world, DVec3::new(-1.999, 1.2, -0.4), n);
    let opening = world.opening_at(at.position, n, Through::Holes).unwrap();
    const COLUMNS: usize = 24;
    let bin_of = |wi: Vec3| {
        // Seen from the wall: across, and up.
        let local = Vec2::new(wi.z, wi.y) * 0.5 + 0.5;
        let [x, y] = (local * COLUMNS as f32).to_array().map(|at| (at as usize).min(COLUMNS - 1));
        y * COLUMNS + x
    };
    const DRAWS: u32 = 200_000;
    let mut drawn = vec![0.0f64; COLUMNS * COLUMNS];
    for number in 0..DRAWS {
        let [u, v, ..] = point(7, number);
        let wi = opening.draw([u, v]);
        assert!(wi.is_normalized() && opening.pdf(wi) > 0.0, "{wi}");
        drawn[bin_of(wi)] += 1.0 / f64::from(DRAWS);
    }
    let mut told = vec![0.0f64; COLUMNS * COLUMNS];
    const FINE: u32 = 1000;
    for number in 0..FINE * FINE {
        let square = [number % FINE, number / FINE].map(|at| (at as f32 + 0.5) / FINE as f32);
        let local = warp::cosine_hemisphere(square);
        let wi = Frame::around(n).to_world(local);
        let by_cosine = warp::cosine_hemisphere_pdf(local.z);
        told[bin_of(wi)] += f64::from(opening.pdf(wi) / by_cosine) / f64::from(FINE * FINE);
    }
    let all: f64 = told.iter().sum();
    assert!((all - 1.0).abs() < 2e-3, "{all}");
    for (drawn, told) in drawn.iter().zip(&told) {
        assert!((drawn - told).abs() < 6.0 * (told / f64::from(DRAWS)).sqrt() + 1e-4, "{drawn} for {told}");
    }
    assert_eq!(opening.pdf(Vec3::NEG_X), 0.0, "behind the wall");
}

/// Under an open sky, in a closed room, far from all surfaces and without a sky there is nothing to know.
#[test]
fn nothing_is_told_where_it_would_not_help() {
    let world = world_of(room_on_ground().unwrap());
    let asked = |p: DVec3, n: Vec3| world.opening_at(world.accel().to_render(p), n, Through::Holes).is_some();
    assert!(!asked(DVec3::new(20.0, -0.199, 5.0), Vec3::Y), "the meadow");
    assert!(!asked(DVec3::new(0.0, 2.701, 0.0), Vec3::Y), "the roof");
    assert!(!asked(DVec3::new(0.0, 500.0, 0.0), Vec3::Y), "above the scene");
    assert!(!asked(DVec3::NAN, Vec3::Y));
    let dark = shed(|_| Environment::None);
    assert!(dark.opening_at(Vec3::ZERO, Vec3::Y, Through::Holes).is_none());
    let mut closed = Stage::default();
    let wall = closed.material("wall", Material::lambert(Rgb::splat(0.5))).unwrap();
    closed.place("box", cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &wall), DAffine3::IDENTITY).unwrap();
    closed.builder().set_environment(Environment::Constant(Rgb::WHITE)).unwrap();
    let closed = world_of(closed.finish());
    assert!(closed.opening_at(Vec3::new(0.3, -2.0, 0.1), Vec3::Y, Through::Holes).is_none());
}

/// What is told of a place does not depend on who asked for what before; what is held is counted.
#[test]
fn whoever_asks_first_is_told_the_same() {
    let places: Vec<(DVec3, Vec3)> = (0..200)
        .map(|number| {
            let [x, z, ..] = point(11, number);
            let at = |u: f32| f64::from(u) * 3.8 - 1.9;
            (DVec3::new(at(x), 1e-3, at(z)), Vec3::Y)
        })
        .collect();
    let told = |world: &World, (p, n): &(DVec3, Vec3)| {
        world
            .opening_at(world.accel().to_render(*p), *n, Through::Holes)
            .map(|opening| opening.draw([0.4, 0.6]))
    };
    let [one, other] = [(); 2].map(|()| world_of(room_on_ground().unwrap()));
    let before = one.report().light_bytes;
    let first: Vec<_> = places.iter().map(|place| told(&one, place)).collect();
    let backwards: Vec<_> = places.iter().rev().map(|place| told(&other, place)).collect();
    assert!(first.iter().filter(|told| told.is_some()).count() > 150, "{first:?}");
    assert!(first.iter().eq(backwards.iter().rev()));
    assert!(one.report().light_bytes > before + 10 * size_of::<Opening>());
    assert_eq!(one.report().light_bytes, other.report().light_bytes);
}

/// Whatever number is drawn, the choice is one that is not empty, and within it.
#[test]
fn empty_parts_are_never_drawn() {
    let sizes = [0u8, 0, 3, 0, 255, 0, 1, 0];
    let sum = 259.0;
    for u in [0.0, 1e-30, 0.01, 3.0 / 259.0, 0.5, 0.99, 1.0 - f32::EPSILON / 2.0, 1.0] {
        let (index, within) = opening::choose(&sizes, sum, u);
        assert!(sizes[index] > 0 && (0.0..=1.0).contains(&within), "{u}: {index} {within}");
    }
}

/// Behind a pane the sky shows to who samples it there, in the same directions as through the window without it, and to nobody else.
#[test]
fn a_window_with_a_pane_shows_the_sky_through_glass_alone() {
    let [open, glazed] = [room_on_ground(), glazed_room()].map(|scene| world_of(scene.unwrap()));
    // On the floor, and on the wall that faces the window.
    for (p, n) in [(DVec3::new(0.5, 0.0, 0.3), Vec3::Y), (DVec3::new(-2.0, 1.2, 0.2), Vec3::X)] {
        let seen = |world: &World, through: Through| {
            let opening = world.opening_at(world.accel().to_render(p), n, through)?;
            let drawn = (0..400).map(|number| opening.draw([point(61, number)[0], point(61, number)[1]]));
            Some(drawn.sum::<Vec3>().normalize())
        };
        assert!(seen(&glazed, Through::Holes).is_none(), "{p}");
        let [before, behind] =
            [seen(&open, Through::Holes), seen(&glazed, Through::HolesAndPanes)].map(Option::unwrap);
        assert!(before.dot(behind) > 0.99, "{before} and {behind} from {p}");
    }
}
