//! Scenes that follow edits on a card: pictures are those of a scene that was brought anew.

use super::{
    known_light::{ALL_STEPS, with_records},
    *,
};
use crate::{
    gpu::locked,
    scene::{Environment, SceneBuilder, SceneLimits, Texels, Texture, TextureRef, TextureSlot},
    technique::path::{closed_forms::id, tests::box_with_lights},
};

type Edited = (&'static str, fn(&mut SceneBuilder));

/// A box with a lamp, a point and a spot, one of whose walls has a texture.
fn stage() -> Shot {
    let mut builder = SceneBuilder::from_scene(&box_with_lights(1.0, None), SceneLimits::default());
    for (name, grey) in [("grain", 90), ("other", 160)] {
        let texels = Texels::Rgba8(vec![[255; 4], [grey; 4], [grey; 4], [255; 4]]);
        builder.add_texture(id(name), Texture { width: 2, height: 2, texels }).unwrap();
    }
    paint(&mut builder, "grain");
    Shot { size: size(24, 20), ..shot(builder.finish().0) }
}

fn paint(builder: &mut SceneBuilder, texture: &str) {
    let mut material = Material::lambert(Rgb::new(0.7, 0.6, 0.5));
    material.textures[TextureSlot::BaseColor as usize] = Some(TextureRef::new(id(texture)));
    builder.set_material(id("red"), material).unwrap();
}

fn spot(position: DVec3, intensity: f32) -> Light {
    let kind =
        LightKind::Spot { intensity: Rgb::splat(intensity), inner_angle_rad: 0.2, outer_angle_rad: 0.7 };
    Light { parent: None, position, direction: DVec3::NEG_Y, kind }
}

fn edited(shot: &Shot, edit: fn(&mut SceneBuilder)) -> Shot {
    let mut builder = SceneBuilder::from_scene(shot.world.scene(), SceneLimits::default());
    edit(&mut builder);
    let (scene, change) = builder.finish();
    Shot { world: Arc::new(shot.world.update(Arc::new(scene), &change)), ..shot.clone() }
}

const LIGHT: [Edited; 6] = [
    ("a light moves and is brighter", |builder| {
        builder.set_light("spot", spot(DVec3::new(-0.2, 1.2, 0.3), 20.0)).unwrap();
    }),
    ("a lamp is of another colour", |builder| {
        builder.set_material(id("lamp"), Material::emitter(Rgb::new(1.0, 9.0, 30.0))).unwrap();
    }),
    ("a light goes", |builder| builder.remove_light("point").unwrap()),
    ("three come", |builder| {
        for (number, name) in ["a", "b", "c"].into_iter().enumerate() {
            let position = DVec3::new(0.2 * number as f64, 1.0, 0.4);
            builder.add_light(id(name), spot(position, 1.0 + number as f32)).unwrap();
        }
    }),
    ("it is day", |builder| builder.set_environment(Environment::Constant(Rgb::splat(0.3))).unwrap()),
    ("a wall is of another colour", |builder| {
        builder.set_material(id("green"), Material::lambert(Rgb::new(0.1, 0.2, 0.9))).unwrap();
    }),
];

const THINGS: [Edited; 6] = [
    ("no texture is left", |builder| {
        builder.set_material(id("red"), Material::lambert(Rgb::new(0.6, 0.1, 0.1))).unwrap();
    }),
    ("a thing moves", |builder| {
        let moved = DAffine3::from_translation(DVec3::new(0.2, 0.1, 0.0));
        builder.set_transform("glass ball", moved).unwrap();
    }),
    ("another texture", |builder| paint(builder, "other")),
    ("a wall shines", |builder| {
        builder.set_material(id("green"), Material::emitter(Rgb::WHITE)).unwrap();
    }),
    ("a lamp is turned off", |builder| {
        builder.set_material(id("lamp"), Material::emitter(Rgb::BLACK)).unwrap();
    }),
    ("a thing goes", |builder| builder.remove_node("mirror block").unwrap()),
];

/// Every picture of the scene and its maps of shadows are those of a scene brought anew, and what is on the card goes on from edit to edit,
/// without anything to compile. The scene before holds nothing any more, and can still be drawn.
#[test]
fn edits_are_followed_on_a_card() {
    // Its own, to count what is compiled.
    let Some(gpu) = open().map(Arc::new) else { return };
    let by_records =
        Shot { size: size(24, 20), ..with_records(stage().world.scene().as_ref().clone(), ALL_STEPS, true) };
    assert!(by_records.known.is_some());
    // Things move as well, if that takes no longer than an hour; edits of light take what they take. What is known is of the light before.
    for (edits, seconds_max, stage) in
        [(&LIGHT[..], 0.0, stage()), (&THINGS, 3600.0, stage()), (&LIGHT[..2], 0.0, by_records)]
    {
        let mut before = stage;
        let mut scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&before.world)));
        let mut pass = before.on_card(&scene, 0).samples;
        scene.compare_shadow_maps().unwrap();
        for (what, edit) in edits {
            let shot = edited(&before, *edit);
            let compiled = scene.shader_seconds();
            let next = scene.followed(&shot.world, seconds_max).unwrap();
            let next = Arc::new(next.unwrap_or_else(|| panic!("{what}: nothing stays")));
            assert!(locked(&scene.ready).is_none(), "{what}: there is one");
            let nothing = scene.followed(&shot.world, seconds_max).unwrap();
            assert!(nothing.is_none(), "{what}: there is none to go on with");
            let anew = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
            let followed = shot.on_card(&next, 0).samples;
            assert!(followed == shot.on_card(&anew, 0).samples, "{what}");
            assert!(followed != pass, "{what}: it is seen");
            assert!(before.on_card(&scene, 0).samples == pass, "{what}: the scene before is what it was");
            if *what == edits[0].0 {
                // Millions of rays tell these.
                let [maps, maps_anew] = [&next, &anew].map(|scene| scene.compare_shadow_maps().unwrap());
                let told = |maps: MapsCompared| (maps.texels, maps.differing);
                assert!(maps.is_some());
                assert_eq!(maps.map(told), maps_anew.map(told), "{what}");
            }
            assert_eq!(next.shader_seconds(), compiled, "{what}: nothing is compiled");
            (before, scene, pass) = (shot, next, followed);
        }
    }
}

/// What takes other steps, or long, is not followed: the scene stays as it is.
#[test]
fn other_edits_bring_a_scene_anew() {
    let Some(gpu) = shared() else { return };
    let mask: Edited = ("a mask", |builder| {
        let masked = Material { alpha_cutoff: Some(0.5), ..Material::lambert(Rgb::WHITE) };
        builder.set_material(id("green"), masked).unwrap();
    });
    let shot = stage();
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
    let pass = shot.on_card(&scene, 0).samples;
    let slow = THINGS.iter().map(|edited| (edited, 0.0));
    for ((what, edit), seconds_max) in slow.chain([(&mask, 3600.0)]) {
        assert!(scene.followed(&edited(&shot, *edit).world, seconds_max).unwrap().is_none(), "{what}");
        assert!(locked(&scene.ready).is_some(), "{what}: it stays");
    }
    assert!(shot.on_card(&scene, 0).samples == pass);
}

/// A device that is gone tells so, and the next scene is brought anew.
#[test]
fn lost_devices_follow_nothing() {
    let Some(gpu) = open().map(Arc::new) else { return };
    let shot = stage();
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
    let pass = shot.on_card(&scene, 0).samples;
    gpu.session().unwrap().lose_for_test();
    let brighter: fn(&mut SceneBuilder) = |builder| builder.set_light("spot", spot(DVec3::Y, 9.0)).unwrap();
    let next = edited(&shot, brighter);
    assert_eq!(scene.followed(&next.world, 0.0).unwrap_err(), GpuError::Lost);
    assert!(locked(&scene.ready).is_none());
    assert!(shot.on_card(&scene, 0).samples == pass);
}
