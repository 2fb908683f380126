//! The numerical laws of `techniques.md`, each for each technique.
//!
//! A technique is compared with itself in a scene that must look the same, so that its own bias, which does not change, does not
//! count; what may count is said at each law. All is seeded: a law that holds once holds on every run.

mod compare;
mod room;

use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

use glam::{DQuat, DVec3};
use lumicast_engine::render::{Backend, Indirect};
use lumicast_engine::transport::World;

use self::compare::{EFFORT, Pictures, Tolerance};
use self::room::{LitBy, carpeted, exchange, furnace, lit_by, permuted, placed, room, split, twice};
use crate::draft::{Draft, Similarity, v};
use crate::drawing::{Drawn, Effort, TECHNIQUES, Technique, are_short, draw, name, techniques, tried};

/// How many of a law's scenes are taken by default, and how many with `LUMICAST_NIGHTLY=1`.
fn at_night(by_default: usize, nightly: usize) -> usize {
    if std::env::var_os("LUMICAST_NIGHTLY").is_some() { nightly } else { by_default }
}

/// The techniques by which a scene of a law is drawn.
///
/// - `at`: among the law's scenes
/// - `on_card`: the technique by which a card draws the first of them where laws are short; `auto` then draws no other either
fn for_scene(at: usize, on_card: Indirect) -> impl Iterator<Item = Technique> {
    let is_short = are_short();
    techniques().filter(move |Technique { indirect, backend }| match backend {
        _ if !is_short => true,
        Backend::Cpu => at == 0 || *indirect != Indirect::Auto,
        _ => at == 0 && *indirect == on_card,
    })
}

/// The room's pictures, which most laws compare with.
fn original(technique: Technique) -> &'static Pictures {
    static PICTURES: [OnceLock<Pictures>; TECHNIQUES.len()] = [const { OnceLock::new() }; TECHNIQUES.len()];
    let at = TECHNIQUES.iter().position(|other| *other == technique).expect("a technique");
    PICTURES[at].get_or_init(|| Pictures::of(&room(), technique))
}

/// Where only rounding differs and every number is drawn as before, paths and photons do as before but for a few that end on the
/// other side of an edge. Records are named by their places, so that in another scale they draw other numbers: that is noise, and
/// a percent is left to it where it is the same over a block.
fn rounding(technique: Technique) -> Tolerance {
    match technique.indirect {
        Indirect::Path => Tolerance { whole: 0.002, block: 0.01 },
        Indirect::Octree => Tolerance { whole: 0.005, block: 0.02 },
        _ => Tolerance { whole: 0.01, block: 0.04 },
    }
}

/// Where cells of the octree lie elsewhere or lights are sampled otherwise, as well: it blurs light over cells, and the others ask
/// it for light that arrives.
fn resampling(technique: Technique) -> Tolerance {
    match technique.indirect {
        Indirect::Path => Tolerance { whole: 0.005, block: 0.02 },
        Indirect::Octree => Tolerance { whole: 0.015, block: 0.08 },
        _ => Tolerance { whole: 0.015, block: 0.06 },
    }
}

/// Compares the room with scenes that must look like it, by every technique.
///
/// - `on_card`: see [`for_scene`]
fn look_like_the_room(
    (law, on_card): (&str, Indirect),
    scenes: &[(String, Draft)],
    tolerance: fn(Technique) -> Tolerance,
) {
    let mut failures = Vec::new();
    for (at, (what, scene)) in scenes.iter().enumerate() {
        println!("{law}, {what}");
        for technique in for_scene(at, on_card) {
            let found = original(technique).differ(&Pictures::of(scene, technique), tolerance(technique));
            failures.extend(found.map(|found| format!("{what}: {found}")));
        }
    }
    assert!(failures.is_empty(), "{law}\n{}", failures.join("\n"));
}

#[test]
fn law_a_scene_of_any_size_looks_the_same() {
    let sized =
        |scale: f64| (format!("scale {scale:e}"), placed(room(), Similarity { scale, ..Similarity::NONE }));
    let sizes: Vec<_> = [1e-4, 1e4, 1e-2, 1e2].into_iter().take(at_night(2, 4)).map(sized).collect();
    look_like_the_room(("size", Indirect::Irradiance), &sizes, rounding);
}

#[test]
fn law_a_scene_looks_the_same_far_away() {
    let offset = v(1e5, -7e4, 1e5);
    let far = placed(room(), Similarity { offset, ..Similarity::NONE });
    // Small and far at once: a metre-wide room a hundred kilometres away, and what rounding leaves of it.
    let small = placed(room(), Similarity { offset, scale: 0.01, ..Similarity::NONE });
    look_like_the_room(
        ("place", Indirect::Octree),
        &[("far away".into(), far), ("small and far away".into(), small)],
        rounding,
    );
}

#[test]
fn law_a_scene_looks_the_same_turned() {
    let turned = |(name, axis, angle): (&str, DVec3, f64)| {
        let turn = DQuat::from_axis_angle(axis.normalize(), angle);
        (name.to_string(), placed(room(), Similarity { turn, ..Similarity::NONE }))
    };
    let turns = [("some way", v(1.0, -2.0, 0.5), 2.1), ("on its side", DVec3::Z, TAU / 4.0)];
    let turned: Vec<_> = turns.into_iter().take(at_night(1, 2)).map(turned).collect();
    look_like_the_room(("turn", Indirect::Octree), &turned, resampling);
}

#[test]
fn law_the_order_of_triangles_does_not_show() {
    look_like_the_room(("order", Indirect::Path), &[("permuted".into(), permuted(room()))], resampling);
}

#[test]
fn law_split_triangles_do_not_show() {
    look_like_the_room(("split", Indirect::Path), &[("split".into(), split(room()))], resampling);
}

/// Nobody means a thing that is there twice, and everybody has some: what is matt, a mirror or glass looks as if it was there once.
#[test]
fn law_things_in_one_place_look_like_one() {
    let scenes = [
        ("walls twice".into(), twice(|name| name.starts_with("walls"))),
        ("blocks and balls twice".into(), twice(|name| name.contains("block") || name.contains("ball"))),
        ("a floor a tenth of a millimetre over the floor".into(), carpeted(1e-4)),
    ];
    look_like_the_room(("in one place", Indirect::Irradiance), &scenes, resampling);
}

/// Two lamps in the very same place are seen as one and light the room as two: looked at, the nearer one hides the other, which by
/// rounding is either; asked for light, neither hides the other. Whoever meant one lamp gets too much, by every technique alike.
#[test]
fn known_lamps_in_one_place_light_twice() {
    let lit = twice(|name| name.starts_with("lamp"));
    for technique in tried() {
        let share = Pictures::of(&lit, technique).mean().mean() / original(technique).mean().mean();
        println!("lamps in one place: {} {share:.3} times as bright", name(technique));
        // Twice all but what the point light brings and what is seen of the lamp.
        assert!((1.5..1.95).contains(&share), "{}: {share}", name(technique));
    }
}

/// Where two surfaces lie in one plane, photons fall on either by rounding; the octree divides all of them by the area of both,
/// and shows half of the light that comes by way of other surfaces there. Records take some of that over.
#[test]
fn known_floors_in_one_plane_darken_the_octree() {
    let in_one_plane = carpeted(0.0);
    for (technique, range) in [
        (Technique::on_cpu(Indirect::Path), 0.995..1.005),
        (Technique::on_cpu(Indirect::Octree), 0.85..0.95),
        (Technique::on_cpu(Indirect::Irradiance), 0.96..1.0),
        (Technique::on_cpu(Indirect::Auto), 0.96..1.0),
    ] {
        let share = Pictures::of(&in_one_plane, technique).mean().mean() / original(technique).mean().mean();
        println!("floors in one plane: {} {share:.3} times as bright", name(technique));
        assert!(range.contains(&share), "{}: {share}", name(technique));
    }
}

/// To the last bit for powers of two, over eighteen orders of magnitude: no threshold may have a size of its own.
#[test]
fn law_twice_the_light_is_twice_the_picture() {
    let mut failures = Vec::new();
    for (at, exponent) in [-30, 1, 30].into_iter().take(at_night(2, 3)).enumerate() {
        for technique in for_scene(at, Indirect::Octree) {
            let factor = 2f32.powi(exponent);
            let other = Pictures::of(&room().brighter(factor), technique);
            let pairs = original(technique).radiance.iter().flatten().zip(other.radiance.iter().flatten());
            let off = pairs
                .map(|(once, found)| {
                    (*once * factor - *found).map(f32::abs).max_component() / (*once * factor).max_component()
                })
                .fold(0.0f32, f32::max);
            println!("light, 2^{exponent}: {} off by {off:e}", name(technique));
            if off > 0.0 {
                failures.push(format!("2^{exponent}: {} is off by {off:e} at some pixel", name(technique)));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn law_the_light_of_two_lamps_adds() {
    let mut failures = Vec::new();
    println!("light by light");
    for technique in for_scene(0, Indirect::Irradiance) {
        let [lamp, point] =
            [LitBy::Lamp, LitBy::Point].map(|by| Pictures::of(&lit_by(room(), by), technique));
        failures.extend(original(technique).differ(&lamp.plus(&point), resampling(technique)));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// A law that nothing breaks says nothing: five percent more light, or a wall of another colour, are seen by every technique, and so
/// is a thing that is gone, which hardly changes the light of the whole.
#[test]
fn laws_tell_scenes_apart_that_differ_by_a_little() {
    let mut dark = room();
    dark.things[0].material.base_color *= 0.95;
    let mut emptier = room();
    emptier.things.retain(|thing| !thing.name.starts_with("tall block"));
    for technique in tried() {
        for other in [room().brighter(1.05), dark.clone(), emptier.clone()] {
            let other = Pictures::of(&other, technique);
            assert!(original(technique).differ(&other, rounding(technique)).is_some(), "{}", name(technique));
            assert!(
                original(technique).differ(&other, resampling(technique)).is_some(),
                "{}",
                name(technique)
            );
        }
    }
}

#[test]
fn law_white_furnaces_hold_the_geometric_sum() {
    for albedo in [0.9f32, 0.5].into_iter().take(at_night(1, 2)) {
        holds_the_geometric_sum((albedo, Indirect::Octree), &[("as it is", Similarity::NONE)]);
    }
}

/// Where light is reflected most often, what is lost at edges in any size or place shows most. Apart from the others, so that they are drawn
/// beside each other.
#[test]
fn law_furnaces_that_hardly_lose_light_hold_the_geometric_sum() {
    let far = Similarity { offset: v(1e5, 1e5, -1e5), turn: DQuat::from_rotation_x(0.5), scale: 0.01 };
    let places = [
        ("small, turned and far away", far),
        ("as it is", Similarity::NONE),
        ("small", Similarity { scale: 1e-4, ..Similarity::NONE }),
        ("large", Similarity { scale: 1e4, ..Similarity::NONE }),
    ];
    holds_the_geometric_sum((0.98, Indirect::Irradiance), &places[..at_night(2, 4)]);
}

/// A closed room whose every surface emits E and reflects ρ holds E / (1 − ρ), in any size and place.
///
/// Looked-up light may be off by what photons lose at edges and by the noise of 24,000 of them, of which each brings more the
/// whiter the room is: up to fifty times what it carries.
///
/// - `on_card`: see [`for_scene`]
fn holds_the_geometric_sum((albedo, on_card): (f32, Indirect), places: &[(&str, Similarity)]) {
    let mut failures = Vec::new();
    for (at, (what, place)) in places.iter().enumerate() {
        for technique in for_scene(at, on_card) {
            let pictures = Pictures::of(&placed(furnace(albedo, 0.25), *place), technique);
            let (found, expected) = (pictures.mean(), 0.25 / (1.0 - f64::from(albedo)));
            let off = found.mean() / expected - 1.0;
            let chance = 6.0 * found.standard_error() / expected;
            let allowed = if technique.indirect == Indirect::Path { 1e-3 } else { 0.015 };
            let name = name(technique);
            println!("furnace of {albedo}, {what}: {name} off by {off:+.4} (chance {chance:.4})");
            if !(off.abs() <= allowed + chance) {
                failures.push(format!("ρ {albedo}, {what}: {name} is off by {off:+.4} ± {chance:.4}"));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// The flux that a square gets from a lamp elsewhere in the room is what the lamp would get from the square if that sent out the
/// same radiance, by all ways, mirrors and glass among them: one integral over pairs of points on the two. Both reflect alike.
#[test]
fn law_lamp_and_sensor_may_change_places() {
    let effort = Effort { passes: 64, photons: 60_000, ..EFFORT };
    let mut failures = Vec::new();
    for technique in for_scene(0, Indirect::Path) {
        let flux = |is_swapped: bool| {
            let (draft, area_m2) = exchange(is_swapped);
            let scene = draft.build().expect("a scene");
            let world = Arc::new(World::prepare(Arc::new(scene)));
            let mut fluxes = lumicast_engine::math::RunningStatistics::default();
            for seed in 0..3 {
                let rendering =
                    draw(&world, Drawn { technique, seed, bounces_max: None }, &effort).expect("an end");
                technique.assert_drawn_as_named(&rendering);
                fluxes.add(lumicast_tests::mean(&rendering.picture().radiance()) * area_m2);
            }
            fluxes
        };
        let [there, back] = [false, true].map(flux);
        let off = there.mean() / back.mean() - 1.0;
        let chance = 6.0 * there.standard_error().hypot(back.standard_error()) / back.mean();
        println!(
            "exchange: {} {:.5} there, {:.5} back: off by {off:+.4} (chance {chance:.4})",
            name(technique),
            there.mean(),
            back.mean()
        );
        // Looked-up light is blurred over other things on either way.
        let allowed = if technique.indirect == Indirect::Path { 2e-3 } else { 0.03 };
        if !(off.abs() <= allowed + chance) {
            failures.push(format!("{}: off by {off:+.4} ± {chance:.4}", name(technique)));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
