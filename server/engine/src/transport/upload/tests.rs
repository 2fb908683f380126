//! Scenes packed: the same twice, each texture once, no number that WGSL may take for another.

use glam::{DAffine3, DVec3};

use std::sync::Arc;

use super::*;
use crate::{
    math::Rgb,
    scene::{
        Environment, Light, LightKind, Material, SceneBuilder, SceneLimits, Texels, Texture, TextureRef,
        TextureSlot,
        samples::{self, Stage},
    },
};

fn id(name: &str) -> Id {
    Id::new(name).unwrap()
}

fn upload_of(stage: Stage) -> WorldBuffers {
    World::prepare(Arc::new(stage.finish())).upload()
}

fn ball(stage: &mut Stage, name: &str, material: Material) {
    let material = stage.material(name, material).unwrap();
    stage.place(name, samples::sphere(DVec3::ZERO, 1.0, 4, &material), DAffine3::IDENTITY).unwrap();
}

fn painted(name: &str) -> Material {
    let mut material = Material::lambert(Rgb::WHITE);
    material.textures[TextureSlot::BaseColor as usize] = Some(TextureRef::new(id(name)));
    material
}

fn texture(texel_count: u32) -> Texture {
    Texture { width: texel_count, height: 1, texels: Texels::Rgba8(vec![[9; 4]; texel_count as usize]) }
}

/// The same scene gives the same bytes.
#[test]
fn scenes_are_packed_the_same_twice() {
    let scene = Arc::new(samples::cornell_box().unwrap());
    let [a, b] = [(); 2].map(|()| World::prepare(Arc::clone(&scene)).upload());
    assert!(a == b && a.bytes() > 0);
}

/// A texture that several materials use is packed once.
#[test]
fn textures_are_packed_once() {
    let mut stage = Stage::default();
    for (name, texel_count) in [("small", 3), ("large", 50)] {
        stage.builder().add_texture(id(name), texture(texel_count)).unwrap();
    }
    for (i, name) in ["small", "large", "small", "large", "small"].into_iter().enumerate() {
        ball(&mut stage, &format!("ball {i}"), painted(name));
    }
    let packed = upload_of(stage);
    assert_eq!(packed.texels.len(), 53);
    let at = |i: usize| packed.appearance.materials[i].textures[TextureSlot::BaseColor as usize].texels_at;
    assert_eq!([at(0), at(2), at(4)], [at(0); 3]);
    assert_eq!(at(1), at(3));
    assert_ne!(at(0), at(1));
}

/// Steps are told of what the scene has, and of nothing else.
#[test]
fn features_are_those_that_a_scene_calls_for() {
    let none = WorldFeatures {
        has_masks: false,
        has_textures: false,
        has_glass: false,
        has_gltf: false,
        has_sky_picture: false,
    };
    let matt = Material::lambert(Rgb::WHITE);
    let glass = Material { transmission: 1.0, ..Material::default() };
    for (material, expected) in [
        (matt.clone(), none),
        (Material { alpha_cutoff: Some(0.5), ..matt.clone() }, WorldFeatures { has_masks: true, ..none }),
        (painted("picture"), WorldFeatures { has_textures: true, ..none }),
        (glass, WorldFeatures { has_glass: true, has_gltf: true, ..none }),
        (Material { metallic: 1.0, ..matt }, WorldFeatures { has_gltf: true, ..none }),
    ] {
        let mut stage = Stage::default();
        stage.builder().add_texture(id("picture"), texture(1)).unwrap();
        ball(&mut stage, "ball", material);
        assert_eq!(upload_of(stage).appearance.features, expected);
    }
    let mut stage = Stage::default();
    let texels = Texels::Rgba32F(vec![[1.0; 4]; 2]);
    stage.builder().add_texture(id("sky"), Texture { width: 2, height: 1, texels }).unwrap();
    let sky = Environment::Image { texture: id("sky"), scale: Rgb::WHITE, rotation_rad: 0.0 };
    stage.builder().set_environment(sky).unwrap();
    assert_eq!(upload_of(stage).appearance.features, WorldFeatures { has_sky_picture: true, ..none });
}

/// No number of lights is infinite, however strong they are: WGSL may assume that none is.
#[test]
fn the_strongest_lights_are_packed_as_finite_numbers() {
    let mut stage = Stage::default();
    // As strong and as large as scenes may hold: what two triangles send along their normal is beyond the largest float.
    let lamp = stage.material("lamp", Material::emitter(Rgb::splat(1e20))).unwrap();
    let corners =
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, z)| DVec3::new(x, 0.0, z) * 9.9e8);
    stage.place("lamp", samples::quad(corners, &lamp), DAffine3::IDENTITY).unwrap();
    let kind = LightKind::Point { intensity: Rgb::splat(1e20) };
    stage.light("point", Light { parent: None, position: DVec3::X, direction: DVec3::Y, kind }).unwrap();
    let nodes = upload_of(stage).appearance.light_nodes;
    assert_eq!(nodes[0].intensity, f32::MAX);
    for node in nodes {
        let numbers = [node.low, node.high, node.axis, [node.intensity, node.cos_normals, node.cos_emission]];
        assert!(numbers.as_flattened().iter().all(|number| number.is_finite()), "{node:?}");
    }
}

/// What is to be brought after an edit of lights and materials is what the scene packed anew has of them, and of all else that has it is what
/// was there; of no other edit anything is told.
#[test]
fn edits_of_appearance_change_nothing_else() {
    let mut stage = Stage::default();
    let sky = Texels::Rgba32F(vec![[1.0; 4]; 2]);
    stage.builder().add_texture(id("sky"), Texture { width: 2, height: 1, texels: sky }).unwrap();
    for (name, texel_count) in [("small", 3), ("large", 50)] {
        stage.builder().add_texture(id(name), texture(texel_count)).unwrap();
        ball(&mut stage, name, painted(name));
    }
    ball(&mut stage, "lamp", Material::emitter(Rgb::WHITE));
    let kind = LightKind::Point { intensity: Rgb::WHITE };
    let point = Light { parent: None, position: DVec3::splat(2.0), direction: DVec3::Y, kind };
    stage.light("point", point.clone()).unwrap();
    let under = |turn: f32| Environment::Image { texture: id("sky"), scale: Rgb::WHITE, rotation_rad: turn };
    stage.builder().set_environment(under(0.0)).unwrap();
    let scene = stage.finish();
    let before = World::prepare(Arc::new(scene.clone()));
    let packed_before = before.upload();
    type Edit<'a> = &'a dyn Fn(&mut SceneBuilder);
    let material = |name: &'static str, material: Material| {
        move |builder: &mut SceneBuilder| builder.set_material(id(name), material.clone()).unwrap()
    };
    let moved = DAffine3::from_translation(DVec3::X);
    let edits: [(&str, Edit<'_>, bool); 11] = [
        ("nothing", &|_| (), true),
        ("a lamp", &material("lamp", Material::emitter(Rgb::splat(7.0))), true),
        ("a light goes", &|builder| builder.remove_light("point").unwrap(), true),
        ("a light comes", &|builder| builder.add_light(id("other"), point.clone()).unwrap(), true),
        ("the sky turns", &|builder| builder.set_environment(under(1.0)).unwrap(), true),
        ("the sky goes", &|builder| builder.set_environment(Environment::None).unwrap(), false),
        ("a colour", &material("small", Material { base_color: Rgb::BLACK, ..painted("small") }), true),
        ("another texture", &material("small", painted("large")), false),
        ("a lamp is off", &material("lamp", Material::emitter(Rgb::BLACK)), false),
        ("a gloss", &material("small", Material { metallic: 1.0, ..painted("small") }), true),
        ("a thing moves", &|builder| builder.set_transform("small", moved).unwrap(), false),
    ];
    for (what, edit, is_told) in edits {
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        edit(&mut builder);
        let (scene, change) = builder.finish();
        let after = before.update(Arc::new(scene), &change);
        let packed = after.upload();
        let appearance = after.appearance_after(&before);
        assert_eq!(appearance.is_some(), is_told, "{what}");
        if let Some(appearance) = appearance {
            assert!(appearance == packed.appearance, "{what}");
            assert_eq!(appearance != packed_before.appearance, what != "nothing", "{what}");
            let rest = WorldBuffers { appearance: packed_before.appearance.clone(), ..packed };
            assert!(rest == packed_before && after.accel().upload() == before.accel().upload(), "{what}");
        }
    }
}
