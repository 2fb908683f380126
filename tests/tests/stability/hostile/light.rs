//! Hostile light: none, far too much, from no area, into one point, through a pinhole.

use glam::DVec3;
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::samples::{quad, sphere};
use lumicast_engine::scene::{Environment, LightKind, Material};

use super::case::Case;
use super::geometry::soup;
use super::hostility::Hostility;
use super::rooms::somewhere;
use crate::draft::{glass, matt, v};

pub(super) const ALL: [Hostility; 20] = [
    Hostility::mild("no light", |case, _| no_light(case)),
    Hostility::mild("a lamp of no area", |case, random| {
        let (a, b) = (somewhere(random), somewhere(random));
        let lamp = Material::emitter(Rgb::splat(100.0));
        case.draft.thing("degenerate", lamp, |id| soup(vec![a, a, b, a, b, (a + b) / 2.0], id));
    }),
    Hostility::mild("a lamp of hardly any area", |case, random| {
        let (at, side) = (somewhere(random), 10f64.powf(random.between(-9.0, -4.0)));
        let lamp = Material::emitter(Rgb::splat(5.0));
        let corners = [v(0., 0., 0.), v(side, 0., 0.), v(side, 0., side), v(0., 0., side)].map(|p| at + p);
        case.draft.thing("spark", lamp, |id| quad(corners, id));
    }),
    Hostility::mild("lights of no power", |case, random| {
        for kind in [
            LightKind::Point { intensity: Rgb::BLACK },
            LightKind::Spot { intensity: Rgb::BLACK, inner_angle_rad: 0.1, outer_angle_rad: 0.5 },
            LightKind::Directional { irradiance: Rgb::BLACK },
        ] {
            case.draft.light("dark", somewhere(random), DVec3::NEG_Y, kind);
        }
    }),
    Hostility::harsh("a billion times as bright", |case, random| {
        let kind = LightKind::Point { intensity: Rgb::new(1e9, 1e9, 1e-9) };
        case.draft.light("glare", somewhere(random), DVec3::NEG_Y, kind);
    }),
    Hostility::harsh("a lamp a billion times as bright", |case, random| {
        let at = somewhere(random);
        case.draft.thing("glare", Material::emitter(Rgb::splat(1e10)), |id| sphere(at, 0.05, 6, id));
    }),
    Hostility::harsh("as bright as may be", |case, random| {
        no_light(case);
        let kind = LightKind::Point { intensity: Rgb::splat(1e20) };
        case.draft.light("glare", somewhere(random), DVec3::NEG_Y, kind);
    }),
    Hostility::mild("lamps as bright as may be", |case, _| {
        let brightest =
            case.draft.things.iter().map(|thing| thing.material.emission.max_component()).fold(0.0, f32::max);
        let factor = if brightest > 0.0 { 1e20 / brightest } else { 1.0 };
        for thing in &mut case.draft.things {
            thing.material.emission = (thing.material.emission * factor).map(|c| c.min(1e20));
        }
        // Others would be lost beside them.
        case.draft.lights.clear();
    }),
    Hostility::mild("hardly any light", |case, random| {
        let factor = 10f32.powf(random.between(-30.0, -6.0) as f32);
        case.draft = case.draft.clone().brighter(factor);
    }),
    Hostility::mild("light of one colour", |case, _| {
        for thing in &mut case.draft.things {
            thing.material.emission *= Rgb::new(0.0, 0.0, 1.0);
        }
    }),
    Hostility::harsh("only lights", |case, random| {
        case.draft.things.clear();
        let kind = LightKind::Point { intensity: Rgb::splat(5.0) };
        case.draft.light("point", somewhere(random), DVec3::NEG_Y, kind);
    }),
    Hostility::mild("only a lamp", |case, _| {
        case.draft.things.retain(|thing| thing.material.is_emissive());
        case.draft.things.truncate(1);
    }),
    Hostility::mild("only surroundings", |case, _| {
        case.draft.things.clear();
        case.draft.lights.clear();
        case.draft.environment = Environment::Constant(Rgb::splat(0.8));
    }),
    Hostility::mild("surroundings", |case, random| {
        case.draft.environment = Environment::Constant(Rgb::splat(random.between(0.1, 3.0) as f32));
    }),
    // All photons land in one point.
    Hostility::harsh("a needle of light", |case, random| {
        no_light(case);
        let outer_angle_rad = 10f32.powf(random.between(-6.0, -2.0) as f32);
        let kind = LightKind::Spot { intensity: Rgb::splat(1e4), inner_angle_rad: 0.0, outer_angle_rad };
        case.draft.light("needle", somewhere(random), v(0.1, -1.0, 0.2), kind);
    }),
    Hostility::harsh("a light in a wall", |case, random| {
        let at = v(random.between(-1.5, 1.5), 0.0, random.between(-1.5, 0.5));
        case.draft.light("point", at, DVec3::NEG_Y, LightKind::Point { intensity: Rgb::splat(5.0) });
    }),
    Hostility::harsh("a light in glass", |case, random| {
        let at = somewhere(random);
        case.draft.thing("bulb", glass(1.5), |id| sphere(at, 0.2, 12, id));
        case.draft.light("point", at, DVec3::NEG_Y, LightKind::Point { intensity: Rgb::splat(5.0) });
    }),
    Hostility::mild("a hundred lights", |case, random| {
        for _ in 0..100 {
            let intensity = Rgb::splat(10f32.powf(random.between(-6.0, 0.0) as f32));
            case.draft.light("point", somewhere(random), DVec3::NEG_Y, LightKind::Point { intensity });
        }
    }),
    Hostility::harsh("a pinhole", |case, random| {
        let hole = 10f64.powf(random.between(-5.0, -2.0));
        let z = 0.8;
        for (name, low, high) in [
            ("left", v(-2., 0., z), v(-hole, 2.5, z)),
            ("right", v(hole, 0., z), v(2., 2.5, z)),
            ("below", v(-hole, 0., z), v(hole, 1.2 - hole, z)),
            ("above", v(-hole, 1.2 + hole, z), v(hole, 2.5, z)),
        ] {
            let corners = [low, v(high.x, low.y, z), high, v(low.x, high.y, z)];
            case.draft.thing(name, matt(0.5), |id| quad(corners, id));
        }
    }),
    Hostility::mild("a lamp in the plane of the ceiling", |case, _| {
        let lamp = Material::emitter(Rgb::splat(5.0));
        let corners = [v(0.9, 2.5, -0.6), v(1.5, 2.5, -0.6), v(1.5, 2.5, 0.0), v(0.9, 2.5, 0.0)];
        case.draft.thing("panel", lamp, |id| quad(corners, id));
    }),
];

fn no_light(case: &mut Case) {
    case.draft.lights.clear();
    case.draft.environment = Environment::None;
    case.draft.things.iter_mut().for_each(|thing| thing.material.emission = Rgb::BLACK);
}
