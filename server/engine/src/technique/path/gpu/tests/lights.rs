//! Lights: those of every kind, alone and many, near, far, in the sky, or none.

use super::*;
use crate::{
    math::sobol,
    scene::{Environment, Texels, Texture, samples},
    technique::path::{
        closed_forms::id,
        tests::{box_with_lights, in_white_surroundings, transformed},
    },
};

fn with_ball(mut stage: Stage) -> Shot {
    let matt = stage.material("matt", Material { roughness: 0.4, ..Material::default() }).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::ZERO, 0.7, 12, &matt));
    shot(stage.finish())
}

/// A lamp, a point and a spot in a box of glass and mirrors: together, and each alone.
#[test]
fn lights_of_each_kind_shine_the_same() {
    let Some(gpu) = shared() else { return };
    for only in [None, Some("lamp"), Some("point"), Some("spot")] {
        shot(box_with_lights(1.0, only)).is_alike(&gpu, &format!("lights: {only:?}"));
    }
}

/// The tree over many lights takes the same ways: lamps of one and two sides, points, spots, and suns beside it.
#[test]
fn many_lights_are_chosen_the_same() {
    let Some(gpu) = shared() else { return };
    let mut stage = room();
    for i in 0..40 {
        let [x, y, z, w] = sobol::point(5, i);
        let [r, g, b, _] = sobol::point(6, i);
        let at = DVec3::new(f64::from(x) * 3.0 - 1.5, f64::from(y) * 2.5 - 0.8, f64::from(z) * 3.0 - 1.5);
        let towards = DVec3::new(f64::from(r) - 0.5, f64::from(g) - 0.7, f64::from(b) - 0.5);
        let (color, name) = (Rgb::new(r, g, b) * (0.1 + w), format!("light {i}"));
        match i % 4 {
            0 | 1 => {
                let lamp = Material { double_sided: i % 4 == 1, ..Material::emitter(color * 9.0) };
                let lamp = stage.material(&name, lamp).unwrap();
                let turn = DAffine3::from_rotation_y(f64::from(w) * 6.0)
                    * DAffine3::from_rotation_x(f64::from(x) * 6.0);
                let place = DAffine3::from_translation(at) * turn;
                stage.place(&name, quad(SQUARE.map(|c| 0.08 * c), &lamp), place).unwrap();
            }
            2 => lit_by(&mut stage, &name, at, towards, LightKind::Point { intensity: color }),
            _ => {
                let (inner_angle_rad, outer_angle_rad) = (0.2 + 0.5 * w, 0.75 + 0.5 * x);
                let kind = LightKind::Spot { intensity: color * 3.0, inner_angle_rad, outer_angle_rad };
                lit_by(&mut stage, &name, at, towards, kind);
            }
        }
    }
    for (i, towards) in [DVec3::new(0.3, -1.0, -0.5), DVec3::new(-0.6, -0.4, -0.7)].into_iter().enumerate() {
        let kind = LightKind::Directional { irradiance: Rgb::new(0.3, 0.4, 0.2 * i as f32) };
        lit_by(&mut stage, &format!("sun {i}"), DVec3::ZERO, towards, kind);
    }
    stage.builder().set_environment(Environment::Constant(Rgb::new(0.05, 0.1, 0.2))).unwrap();
    with_ball(stage).is_alike(&gpu, "many lights");
}

/// A sky that is a picture is seen and sampled the same, however it is turned.
#[test]
fn skies_are_seen_and_sampled_the_same() {
    let Some(gpu) = shared() else { return };
    let texel = |i: u32| {
        let [r, g, b, w] = sobol::point(3, i);
        // A few texels outshine all others, and some rows are black.
        let scale = if i / 12 == 2 {
            0.0
        } else if w > 0.95 {
            60.0
        } else {
            1.0
        };
        [r * scale, g * scale, b * scale, 1.0]
    };
    let texels = Texels::Rgba32F((0..84).map(texel).collect());
    let picture = Texture { width: 12, height: 7, texels };
    for rotation_rad in [0.0, 1.1, -4.0] {
        let mut stage = room();
        stage.builder().add_texture(id("sky"), picture.clone()).unwrap();
        let scale = Rgb::new(0.5, 0.4, 0.3);
        stage
            .builder()
            .set_environment(Environment::Image { texture: id("sky"), scale, rotation_rad })
            .unwrap();
        with_ball(stage).is_alike(&gpu, &format!("sky turned by {rotation_rad}"));
    }
    let alone = in_white_surroundings(Material { metallic: 1.0, roughness: 0.3, ..Material::default() });
    shot(alone).is_alike(&gpu, "nothing but sky");
}

/// Scenes without lights, without surfaces, without either.
#[test]
fn what_is_missing_is_missing_on_both() {
    let Some(gpu) = shared() else { return };
    let dark = || {
        let mut stage = Stage::default();
        let matt = stage.material("matt", Material::lambert(Rgb::splat(0.7))).unwrap();
        placed(&mut stage, "ball", samples::sphere(DVec3::ZERO, 1.0, 6, &matt));
        stage
    };
    let sky = |mut stage: Stage| {
        stage.builder().set_environment(Environment::Constant(Rgb::new(0.3, 0.2, 0.1))).unwrap();
        stage.finish()
    };
    let sunny = |mut stage: Stage| {
        lit_by(
            &mut stage,
            "sun",
            DVec3::ZERO,
            DVec3::NEG_Y,
            LightKind::Directional { irradiance: Rgb::WHITE },
        );
        stage.finish()
    };
    for (name, scene) in [
        ("no light", dark().finish()),
        ("sky alone", sky(dark())),
        ("sun alone", sunny(dark())),
        ("no surface", sky(Stage::default())),
        ("no surface but a sun", sunny(Stage::default())),
        ("nothing", Stage::default().finish()),
    ] {
        Shot { size: size(16, 16), ..shot(scene) }.is_alike(&gpu, name);
    }
}

/// Scenes of a tenth of a millimetre and of ten kilometres, and a hundred kilometres away.
#[test]
fn size_and_place_change_nothing_on_either() {
    let Some(gpu) = shared() else { return };
    let scene = box_with_lights(1.0, None);
    for (scale, offset) in [
        (1e-4, DVec3::ZERO),
        (1e4, DVec3::ZERO),
        (1.0, DVec3::new(1e5, -1e5, 7e4)),
        (1e-3, DVec3::new(4e3, 3.0, -5e3)),
    ] {
        let place =
            DAffine3::from_scale_rotation_translation(DVec3::splat(scale), glam::DQuat::IDENTITY, offset);
        let shot = Shot { size: size(32, 32), ..shot(transformed(&scene, place, scale)) };
        shot.is_alike(&gpu, &format!("scale {scale} at {offset}"));
    }
}

/// Rooms that stand kilometres apart, so that one of them is far from the origin that rays count from.
#[test]
fn surfaces_far_from_the_origin_of_rays_are_the_same() {
    let Some(gpu) = shared() else { return };
    let mut stage = room();
    let far = stage.material("far", Material::emitter(Rgb::splat(50.0))).unwrap();
    let place =
        DAffine3::from_translation(DVec3::new(9000.0, 4000.0, 7000.0)) * DAffine3::from_rotation_y(0.8);
    stage.place("far lamp", quad(SQUARE.map(|c| 2000.0 * c), &far), place).unwrap();
    with_ball(stage).is_alike(&gpu, "kilometres apart");
}
