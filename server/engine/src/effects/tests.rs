//! Laws of the plan: each effect follows its fact, and what is not placed decides nothing.

use super::{EffectChoice, EffectChoices, EffectKind, EffectPlan, Inventory};
use crate::math::Rgb;
use crate::scene::{
    Environment, Id, Light, LightKind, Material, Node, Scene, SceneBuilder, SceneLimits, Texels, Texture,
    TextureRef, TextureSlot,
    samples::{self, Stage, quad},
};
use glam::{DAffine3, DVec3};

const ALL: [EffectKind; 13] = [
    EffectKind::Diffuse,
    EffectKind::Glossy,
    EffectKind::Mirror,
    EffectKind::Glass,
    EffectKind::Absorption,
    EffectKind::Textures,
    EffectKind::NormalMaps,
    EffectKind::AlphaMask,
    EffectKind::AreaLights,
    EffectKind::PunctualLights,
    EffectKind::Environment,
    EffectKind::Caustics,
    EffectKind::Indirect,
];

fn on(scene: &Scene) -> Vec<&'static str> {
    let plan = EffectPlan::of(scene);
    plan.effects.iter().filter(|effect| effect.is_on).map(|effect| effect.kind.name()).collect()
}

/// A quad of each material under a lamp.
fn lit_scene(materials: &[Material]) -> Scene {
    let mut stage = Stage::default();
    let at = |height: f64| {
        [DVec3::new(0., height, 0.), DVec3::new(0., height, 1.), DVec3::new(1., height, 1.), DVec3::X]
    };
    let lamp = stage.material("lamp", Material::emitter(Rgb::WHITE)).unwrap();
    stage.place("lamp", quad(at(2.0), &lamp), DAffine3::IDENTITY).unwrap();
    for (index, material) in materials.iter().enumerate() {
        let id = stage.material(&format!("m{index}"), material.clone()).unwrap();
        stage.place(&format!("q{index}"), quad(at(1.0), &id), DAffine3::IDENTITY).unwrap();
    }
    stage.finish()
}

/// The same of one material with a grey texture in `slot`.
fn lit_with_texture(mut material: Material, slot: TextureSlot) -> Scene {
    let mut builder = SceneBuilder::from_scene(&lit_scene(&[Material::default()]), SceneLimits::default());
    let grey = Texture { width: 1, height: 1, texels: Texels::Rgba8(vec![[128; 4]]) };
    builder.add_texture(Id::sanitised("grey", "grey"), grey).unwrap();
    material.textures[slot as usize] = Some(TextureRef::new(Id::sanitised("grey", "grey")));
    builder.set_material(Id::sanitised("m0", "m0"), material).unwrap();
    builder.finish().0
}

/// Every plan names every effect once, in order, with a reason.
#[test]
fn a_plan_names_every_effect_once_with_a_reason() {
    for scene in [Scene::default(), samples::cornell_box().unwrap(), samples::furnace(0.5, 1.0).unwrap()] {
        let plan = EffectPlan::of(&scene);
        assert_eq!(plan.effects.iter().map(|effect| effect.kind).collect::<Vec<_>>(), ALL);
        assert!(plan.effects.iter().all(|effect| !effect.reason.is_empty()));
    }
}

/// An empty scene runs nothing.
#[test]
fn an_empty_scene_turns_everything_off() {
    assert_eq!(on(&Scene::default()), [""; 0]);
}

/// Matt walls around a lamp: no specular effect, no caustics.
#[test]
fn a_diffuse_scene_has_indirect_light_and_no_caustics() {
    let scene = lit_scene(&[Material::lambert(Rgb::splat(0.5))]);
    assert_eq!(on(&scene), ["diffuse", "area_lights", "indirect"]);
}

/// Each material turns on what it needs.
#[test]
fn materials_turn_on_their_effects() {
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    assert_eq!(on(&lit_scene(&[mirror])), ["mirror", "area_lights"]);
    let brushed = Material { metallic: 1.0, roughness: 0.3, ..Material::default() };
    assert_eq!(on(&lit_scene(&[brushed])), ["glossy", "area_lights"]);
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    let matt = Material::lambert(Rgb::splat(0.5));
    assert_eq!(
        on(&lit_scene(&[glass.clone(), matt])),
        ["diffuse", "glass", "area_lights", "caustics", "indirect"]
    );
    let glass_or_metal = glass.clone();
    let tea = Material { attenuation_color: Rgb::new(0.8, 0.4, 0.1), attenuation_distance_m: 0.1, ..glass };
    assert_eq!(on(&lit_scene(&[tea])), ["glass", "absorption", "area_lights"]);
    // Metal does not let light through, whatever its transmission says; a texture may leave glass and coat side by side.
    let metal = Material { metallic: 1.0, ..glass_or_metal.clone() };
    assert_eq!(on(&lit_scene(&[metal])), ["mirror", "area_lights"]);
    assert_eq!(
        on(&lit_with_texture(glass_or_metal.clone(), TextureSlot::Transmission)),
        ["diffuse", "mirror", "glass", "textures", "area_lights", "caustics", "indirect"]
    );
    let metal = Material { metallic: 1.0, ..glass_or_metal };
    assert_eq!(
        on(&lit_with_texture(metal, TextureSlot::MetallicRoughness)),
        ["mirror", "glass", "textures", "area_lights"]
    );
    let plastic = Material { roughness: 0.4, base_color: Rgb::splat(0.5), ..Material::default() };
    assert_eq!(on(&lit_scene(&[plastic])), ["diffuse", "glossy", "area_lights", "caustics", "indirect"]);
    let cut = Material { alpha_cutoff: Some(0.5), ..Material::lambert(Rgb::BLACK) };
    assert_eq!(on(&lit_scene(&[cut])), ["alpha_mask", "area_lights"]);
    let sign = Material { unlit: true, ..Material::default() };
    assert_eq!(on(&lit_scene(&[sign])), ["area_lights"]);
}

/// Lights count when they are not black; materials when something shows them.
#[test]
fn black_lights_and_unplaced_materials_decide_nothing() {
    let mut stage = Stage::default();
    stage
        .material("unused mirror", Material { metallic: 1.0, roughness: 0.0, ..Material::default() })
        .unwrap();
    let light = |intensity| Light {
        parent: None,
        position: DVec3::ZERO,
        direction: DVec3::NEG_Z,
        kind: LightKind::Point { intensity },
    };
    stage.light("black", light(Rgb::BLACK)).unwrap();
    stage.builder().set_environment(Environment::Constant(Rgb::BLACK)).unwrap();
    assert_eq!(on(&stage.finish()), [""; 0]);
    let mut stage = Stage::default();
    stage.light("lit", light(Rgb::WHITE)).unwrap();
    stage.builder().set_environment(Environment::Constant(Rgb::WHITE)).unwrap();
    assert_eq!(on(&stage.finish()), ["punctual_lights", "environment"]);
}

/// The built-in box shows what it was made for.
#[test]
fn the_built_in_box_has_glass_mirror_and_caustics() {
    let scene = samples::cornell_box().unwrap();
    assert_eq!(on(&scene), ["diffuse", "mirror", "glass", "area_lights", "caustics", "indirect"]);
    let facts = EffectPlan::of(&scene).facts;
    assert_eq!((facts.emissive_triangles, facts.triangles), (2, scene.instanced_triangle_count()));
}

/// What is chosen wins and says so; what the plan says anyway keeps its reason, and nothing else changes.
#[test]
fn choices_win_over_the_plan() {
    let scene = samples::boxes().unwrap();
    let plan = EffectPlan::of(&scene);
    assert!(plan.is_on(EffectKind::Indirect) && !plan.is_on(EffectKind::Caustics));
    for kind in EffectChoices::KINDS {
        for choice in [EffectChoice::Plan, EffectChoice::On, EffectChoice::Off] {
            let mut choices = EffectChoices::default();
            *choices.choice_mut(kind).unwrap() = choice;
            let chosen = plan.clone().chosen(choices);
            for (before, after) in plan.effects.iter().zip(&chosen.effects) {
                let expected = match choice {
                    EffectChoice::On if before.kind == kind => true,
                    EffectChoice::Off if before.kind == kind => false,
                    _ => before.is_on,
                };
                assert_eq!(after.is_on, expected, "{kind:?} {choice:?} {:?}", before.kind);
                assert_eq!(after.reason == before.reason, after.is_on == before.is_on);
            }
        }
    }
}

/// After any edits the plan is that of the scene they made, reasons and all.
#[test]
fn a_plan_that_follows_edits_is_that_of_the_scene() {
    let materials = [
        Material::lambert(Rgb::splat(0.5)),
        Material { metallic: 1.0, roughness: 0.0, ..Material::default() },
        Material { transmission: 1.0, roughness: 0.0, ..Material::default() },
        Material::emitter(Rgb::WHITE),
        Material { roughness: 0.4, ..Material::default() },
    ];
    let mut scene = lit_scene(&materials);
    let mut inventory = Inventory::of(&scene);
    let mut plans = std::collections::BTreeSet::new();
    for batch in 0..150u32 {
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        for edit in 0..1 + batch % 4 {
            let [what, which, other, _] =
                crate::math::sobol::point(crate::math::sobol::mix(u64::from(batch * 4 + edit)), 0);
            let id = |name: &str| Id::sanitised(name, name);
            let pick = |count: usize, at: f32| (at * count as f32) as usize;
            let (node, mesh) = (id(&format!("n{}", pick(6, which))), id(&format!("q{}", pick(5, other))));
            // Some of these are refused: then nothing changes.
            let _ = match pick(6, what) {
                0 => builder.remove_node(node.as_str()),
                1 => builder.add_node(
                    node,
                    Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Some(mesh) },
                ),
                2 => builder.remove_node(mesh.as_str()),
                3 => builder
                    .set_material(id(&format!("m{}", pick(5, which))), materials[pick(5, other)].clone()),
                4 => builder.add_light(
                    id("l"),
                    Light {
                        parent: None,
                        position: DVec3::ZERO,
                        direction: DVec3::NEG_Z,
                        kind: LightKind::Point {
                            intensity: if which < 0.5 { Rgb::BLACK } else { Rgb::WHITE },
                        },
                    },
                ),
                _ if which < 0.5 => builder.remove_light("l"),
                _ => builder.set_environment(if other < 0.5 {
                    Environment::None
                } else {
                    Environment::Constant(Rgb::WHITE)
                }),
            };
        }
        let (next, change) = builder.finish();
        inventory.follow(&scene, &next, &change);
        // There, back, and there again.
        inventory.follow(&next, &scene, &change);
        assert_eq!(inventory.plan(), EffectPlan::of(&scene), "before batch {batch}");
        inventory.follow(&scene, &next, &change);
        scene = next;
        assert_eq!(inventory.plan(), EffectPlan::of(&scene), "after batch {batch}");
        plans.insert(on(&scene));
    }
    assert!(plans.len() > 8, "{} plans", plans.len());
}
