//! The plan chooses rooms; every class of light that a scene has is in exactly one of them.
//!
//! Scenes of every combination of materials and lights are path-traced, which asks no plan, and drawn by the rooms that the plan
//! chose: a layer is dark in both or in neither, and as bright. Whatever the plan turned off is not there, and costs nothing;
//! forced on, it changes no bit.
//!
//! By default a part of the 256 combinations; `LUMICAST_NIGHTLY=1` takes all of them.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use lumicast_engine::effects::{EffectChoice, EffectChoices, EffectKind, EffectPlan};
use lumicast_engine::math::Rgb;
use lumicast_engine::render::{Indirect, Learning, RenderSettings};
use lumicast_engine::scene::samples::{Stage, quad, sphere};
use lumicast_engine::scene::{CameraView, Environment, Light, LightKind, Material, Scene};
use lumicast_engine::transport::{PathClass, World};
use lumicast_tests::{mean, picture};

const SIDE: u32 = 16;
/// Samples of the path tracer: twice as many as of looked-up light, which has less noise.
const PASSES: u32 = 96;
/// How far layers may be off: noise of some tens of thousands of samples, in shares of the layer and of the whole picture. A
/// layer that is in no room is off by all of it, one in two rooms by as much.
const OFF_MAX: [f64; 2] = [0.4, 0.01];

/// What a scene may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Matt,
    Coated,
    Mirror,
    Brushed,
    Glass,
    Lamp,
    Spot,
    Sky,
}

const PARTS: [Part; 8] =
    [Part::Matt, Part::Coated, Part::Mirror, Part::Brushed, Part::Glass, Part::Lamp, Part::Spot, Part::Sky];

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// A floor and a wall of the first material there is, and a ball of each of the others.
fn scene_of(parts: &[Part]) -> Scene {
    let mut stage = Stage::default();
    let grey = Rgb::splat(0.7);
    let metal = |roughness| Material { base_color: grey, metallic: 1.0, roughness, ..Material::default() };
    let mut is_first = true;
    let mut place = 0.0;
    for part in parts {
        let material = match part {
            Part::Matt => Material::lambert(grey),
            Part::Coated => Material { base_color: grey, roughness: 0.4, ..Material::default() },
            Part::Mirror => metal(0.0),
            Part::Brushed => metal(0.4),
            Part::Glass => Material { transmission: 1.0, roughness: 0.0, ..Material::default() },
            Part::Lamp => {
                let lamp = stage.material("lamp", Material::emitter(Rgb::splat(8.0))).expect("a material");
                let corners = [v(-0.5, 2.5, -0.5), v(0.5, 2.5, -0.5), v(0.5, 2.5, 0.5), v(-0.5, 2.5, 0.5)];
                stage.place("lamp", quad(corners, &lamp), DAffine3::IDENTITY).expect("a lamp");
                continue;
            }
            Part::Spot => {
                let kind = LightKind::Point { intensity: Rgb::splat(6.0) };
                let (position, direction) = (v(0.8, 2.2, 0.5), DVec3::NEG_Y);
                stage.light("point", Light { kind, parent: None, position, direction }).expect("a light");
                continue;
            }
            Part::Sky => {
                stage.builder().set_environment(Environment::Constant(Rgb::splat(0.5))).expect("a sky");
                continue;
            }
        };
        let name = format!("{part:?}");
        let id = stage.material(&name, material).expect("a material");
        if is_first {
            let floor = [v(-2., 0., 2.), v(2., 0., 2.), v(2., 0., -2.), v(-2., 0., -2.)];
            let wall = [v(-2., 0., -2.), v(2., 0., -2.), v(2., 3., -2.), v(-2., 3., -2.)];
            stage.place("floor", quad(floor, &id), DAffine3::IDENTITY).expect("a floor");
            stage.place("wall", quad(wall, &id), DAffine3::IDENTITY).expect("a wall");
        } else {
            let at = DAffine3::from_translation(v(place - 1.2, 0.5, -0.6));
            stage.place(&name, sphere(DVec3::ZERO, 0.4, 24, &id), at).expect("a ball");
            place += 0.9;
        }
        is_first = false;
    }
    let view = CameraView::look_at(v(0.0, 1.4, 3.4), v(0., 0.8, -1.0), DVec3::Y, 0.9);
    stage.camera("main", view, 1.0).expect("a camera");
    stage.finish()
}

/// The combinations of this run.
fn combinations() -> impl Iterator<Item = Vec<Part>> {
    let is_nightly = std::env::var_os("LUMICAST_NIGHTLY").is_some();
    // Of every combination of five parts one of the other three.
    let is_taken = move |bits: &u32| is_nightly || bits >> 5 == (bits & 31).wrapping_mul(5) % 8;
    (0..1u32 << PARTS.len())
        .filter(is_taken)
        .map(|bits| (0..PARTS.len()).filter(|bit| bits >> bit & 1 == 1).map(|bit| PARTS[bit]).collect())
}

fn settings(indirect: Indirect, effects: EffectChoices) -> RenderSettings {
    RenderSettings { indirect, effects, seed: 5, learning: Learning::First, ..RenderSettings::default() }
}

#[test]
fn every_class_of_light_that_a_scene_has_is_in_exactly_one_room() {
    let mut failures = Vec::new();
    let mut seen = [[0; 2]; PathClass::COUNT];
    for parts in combinations() {
        let world = Arc::new(World::prepare(Arc::new(scene_of(&parts))));
        let plan = EffectPlan::of(world.scene());
        let traced = picture(&world, SIDE, settings(Indirect::Path, EffectChoices::default()), PASSES);
        let rooms =
            picture(&world, SIDE, settings(Indirect::Irradiance, EffectChoices::default()), PASSES / 2);
        let layer =
            |rendering: &lumicast_engine::render::Rendering, class| mean(&rendering.film().layer(class));
        let whole: f64 = PathClass::ALL.iter().map(|class| layer(&traced, *class)).sum();
        for class in PathClass::ALL {
            let [expected, found] = [&traced, &rooms].map(|rendering| layer(rendering, class));
            let mut fail = |what: &str| {
                failures.push(format!("{parts:?}, {}: {what}: {found} for {expected}", class.name()))
            };
            let is_planned = match class {
                PathClass::Emitted | PathClass::Specular | PathClass::Direct => true,
                PathClass::Caustic => plan.is_on(EffectKind::Caustics),
                PathClass::Indirect => plan.is_on(EffectKind::Indirect),
            };
            if !is_planned && (expected > 0.0 || found > 0.0) {
                fail("is not planned");
            }
            // No path from the eye finds the light of lamps without size by mirrors and clear glass, in broad glosses either, nor
            // what is sent on of it.
            let is_hidden = plan.facts.hides_light()
                && match class {
                    PathClass::Specular => plan.facts.glossy > 0,
                    PathClass::Emitted | PathClass::Direct => false,
                    PathClass::Caustic | PathClass::Indirect => true,
                };
            let allowed = OFF_MAX[0] * expected + OFF_MAX[1] * whole;
            if found < expected - allowed || (found > expected + allowed && !is_hidden) || found.is_nan() {
                fail("is off");
            }
            seen[class as usize][usize::from(expected > 0.0)] += 1;
        }
        // What is off leaves nothing behind.
        let photons = rooms.caustics();
        if !plan.is_on(EffectKind::Caustics) && (photons.photons_emitted, photons.bytes) != (0, 0) {
            failures.push(format!("{parts:?}: caustics are off and cost {photons:?}"));
        }
        if !plan.is_on(EffectKind::Indirect) && (rooms.illumination().is_some() || rooms.records().count > 0)
        {
            failures.push(format!("{parts:?}: indirect light is off and was learnt"));
        }
    }
    assert!(failures.is_empty(), "{} failures\n{}", failures.len(), failures.join("\n"));
    // There were scenes with and without every class.
    assert!(seen.iter().flatten().all(|count| *count >= 3), "{seen:?}");
}

/// Forced on, an effect that the plan turned off changes no bit of any picture, and neither does choosing what the plan says.
/// But for broad glosses without anything diffuse: photons show them, with noise of their own, what paths find as well.
#[test]
fn what_the_plan_turns_off_would_change_nothing() {
    let mut with_off = 0;
    for parts in combinations() {
        let world = Arc::new(World::prepare(Arc::new(scene_of(&parts))));
        let plan = EffectPlan::of(world.scene());
        if plan.is_on(EffectKind::Caustics) && plan.is_on(EffectKind::Indirect) {
            continue;
        }
        with_off += 1;
        let all_on = EffectChoices { caustics: EffectChoice::On, indirect: EffectChoice::On };
        for indirect in [Indirect::Irradiance, Indirect::Octree] {
            let of = |effects, passes| {
                picture(&world, SIDE, settings(indirect, effects), passes).picture().radiance()
            };
            let [planned, forced] = [EffectChoices::default(), all_on].map(|effects| of(effects, 4));
            if planned == forced {
                continue;
            }
            let facts = &plan.facts;
            assert!(facts.diffuse == 0 && facts.glossy > 0, "{parts:?} {indirect:?}");
            let [planned, forced] = [EffectChoices::default(), all_on].map(|effects| mean(&of(effects, 256)));
            assert!((planned / forced - 1.0).abs() < 0.05, "{parts:?} {indirect:?}: {planned}, {forced}");
        }
    }
    assert!(with_off >= 8, "{with_off}");
}

/// Turned off, an effect takes its class of light with it and no other, whatever draws.
#[test]
fn what_is_turned_off_is_missing_and_nothing_else() {
    let world =
        Arc::new(World::prepare(Arc::new(scene_of(&[Part::Matt, Part::Mirror, Part::Glass, Part::Lamp]))));
    let off = |class| match class {
        PathClass::Caustic => EffectChoices { caustics: EffectChoice::Off, ..EffectChoices::default() },
        _ => EffectChoices { indirect: EffectChoice::Off, ..EffectChoices::default() },
    };
    for indirect in [Indirect::Path, Indirect::Irradiance, Indirect::Octree] {
        let of = |effects| {
            let rendering = picture(&world, 2 * SIDE, settings(indirect, effects), 128);
            PathClass::ALL.map(|class| mean(&rendering.film().layer(class)))
        };
        let all = of(EffectChoices::default());
        for class in [PathClass::Caustic, PathClass::Indirect] {
            let without = of(off(class));
            for other in PathClass::ALL {
                let [before, after] = [&all, &without].map(|layers| layers[other as usize]);
                if other == class {
                    assert!(before > 0.0 && after == 0.0, "{indirect:?} {class:?}: {after} of {before}");
                } else {
                    assert!(
                        (after / before - 1.0).abs() < 0.1,
                        "{indirect:?} {class:?} {other:?}: {after} of {before}"
                    );
                }
            }
        }
    }
}
