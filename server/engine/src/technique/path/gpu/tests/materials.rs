//! Surfaces: every model of scattering, in and out of glass.

use super::*;
use crate::{
    scene::{Environment, samples},
    technique::path::closed_forms::straight_on,
};

fn ball_of(material: Material) -> Shot {
    let mut stage = room();
    let subject = stage.material("subject", material).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::ZERO, 0.9, 16, &subject));
    let intensity = Rgb::new(1.0, 2.0, 3.0);
    lit_by(&mut stage, "point", DVec3::new(1.5, 1.0, 2.0), DVec3::Y, LightKind::Point { intensity });
    stage.builder().set_environment(Environment::Constant(Rgb::new(0.2, 0.3, 0.4))).unwrap();
    Shot { size: size(24, 18), ..shot(stage.finish()) }
}

/// The built-in scenes are the same sample for sample: mirrors, glass and diffuse light between walls.
#[test]
fn built_in_scenes_are_the_same_sample_for_sample() {
    let Some(gpu) = shared() else { return };
    let cornell = samples::cornell_box().unwrap();
    let corner = cornell.camera_view(Some("corner")).unwrap();
    for (name, shot) in [
        ("cornell box", Shot { size: size(64, 64), ..shot(cornell.clone()) }),
        ("its corner", Shot { camera: corner, size: size(64, 36), ..shot(cornell) }),
        ("boxes", Shot { size: size(64, 36), ..shot(samples::boxes().unwrap()) }),
        ("furnace", shot(samples::furnace(0.5, 0.25).unwrap())),
    ] {
        shot.is_alike(&gpu, name);
    }
}

/// Metal, plastic and what is between, from mirrors to chalk.
#[test]
fn glossy_surfaces_are_the_same_sample_for_sample() {
    let Some(gpu) = shared() else { return };
    for roughness in [0.0, 0.02, 0.04, 0.1, 0.5, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            let material =
                Material { base_color: Rgb::new(0.9, 0.6, 0.3), metallic, roughness, ..Material::default() };
            ball_of(material).is_alike(&gpu, &format!("roughness {roughness} metallic {metallic}"));
        }
    }
    for (name, material) in [
        (
            "coloured gloss",
            Material { specular_color: Rgb::new(1.0, 0.3, 2.0), roughness: 0.3, ..Material::default() },
        ),
        ("faint gloss", Material { specular: 0.2, roughness: 0.3, ior: 2.0, ..Material::default() }),
        ("gloss over black", Material { base_color: Rgb::BLACK, roughness: 0.2, ..Material::default() }),
        (
            "smooth gloss over black",
            Material { base_color: Rgb::BLACK, roughness: 0.0, ..Material::default() },
        ),
        ("black", Material::lambert(Rgb::BLACK)),
        ("unlit", Material { unlit: true, ..Material::lambert(Rgb::new(0.1, 0.7, 0.3)) }),
    ] {
        ball_of(material).is_alike(&gpu, name);
    }
}

fn absorbing(transmission: f32) -> Material {
    Material {
        transmission,
        roughness: 0.0,
        base_color: Rgb::new(0.9, 0.95, 1.0),
        attenuation_color: Rgb::new(0.9, 0.5, 0.1),
        attenuation_distance_m: 0.5,
        ..Material::default()
    }
}

/// Glass of all kinds, seen from outside.
#[test]
fn glass_is_the_same_sample_for_sample() {
    let Some(gpu) = shared() else { return };
    let clear = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    for (name, material) in [
        ("glass", clear.clone()),
        ("glass of ior 1", Material { ior: 1.0, ..clear.clone() }),
        ("diamond", Material { ior: 2.4, ..clear.clone() }),
        ("half glass", Material { transmission: 0.5, ..clear }),
        ("absorbing glass", absorbing(1.0)),
        ("absorbing half glass", absorbing(0.5)),
        (
            "glass that blackens a channel",
            Material { attenuation_color: Rgb::new(1.0, 0.5, 0.0), ..absorbing(1.0) },
        ),
        ("part metal", Material { metallic: 0.5, ..absorbing(0.5) }),
    ] {
        ball_of(material).is_alike(&gpu, name);
    }
}

/// A camera that stands in absorbing glass sees a ball in it, lit through glass, and the world outside.
#[test]
fn cameras_in_glass_see_the_same_sample_for_sample() {
    let Some(gpu) = shared() else { return };
    let mut stage = room();
    let glass = stage.material("glass", absorbing(1.0)).unwrap();
    placed(
        &mut stage,
        "block",
        samples::cuboid(DVec3::new(-1.0, -0.9, -1.0), DVec3::new(1.0, 1.0, 1.5), &glass),
    );
    let matt = stage.material("matt", Material::lambert(Rgb::new(0.2, 0.8, 0.6))).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::new(-0.3, -0.3, -0.2), 0.3, 12, &matt));
    let kind = LightKind::Point { intensity: Rgb::splat(0.5) };
    lit_by(&mut stage, "point", DVec3::new(0.5, 0.6, 0.9), DVec3::Y, kind);
    let inside = CameraView::look_at(DVec3::new(0.2, 0.2, 1.2), DVec3::new(-0.1, -0.2, 0.0), DVec3::Y, 1.3);
    Shot { camera: inside, ..shot(stage.finish()) }.is_alike(&gpu, "in glass");
}

/// Light sent out on one side or both, seen from both.
#[test]
fn emission_knows_its_sides_on_both() {
    let Some(gpu) = shared() else { return };
    for double_sided in [false, true] {
        let mut stage = room();
        let lamp = Material {
            double_sided,
            base_color: Rgb::splat(0.4),
            ..Material::emitter(Rgb::new(2.0, 1.0, 0.5))
        };
        let lamp = stage.material("lamp", Material { specular: 1.0, roughness: 0.4, ..lamp }).unwrap();
        for (name, turn) in [("towards", 0.4), ("away", 2.9)] {
            let place =
                DAffine3::from_translation(DVec3::X * (turn - 1.6) * 0.5) * DAffine3::from_rotation_y(turn);
            stage.place(name, quad(SQUARE.map(|c| 0.5 * c), &lamp), place).unwrap();
        }
        shot(stage.finish()).is_alike(&gpu, &format!("double-sided {double_sided}"));
    }
}

/// Flat pictures whose every sample is known show the same to the last digits: the tolerance hides no error.
#[test]
fn what_a_parallel_camera_sees_of_a_sunlit_square_is_its_albedo() {
    let Some(gpu) = shared() else { return };
    let mut stage = Stage::default();
    let matt = stage.material("matt", Material::lambert(Rgb::new(0.8, 0.6, 0.4))).unwrap();
    placed(&mut stage, "square", quad(SQUARE, &matt));
    stage.light("sun", crate::technique::path::closed_forms::sun()).unwrap();
    let shot = Shot { camera: straight_on(), size: size(9, 9), ..shot(stage.finish()) };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    for sample in shot.on_card(&scene, 3).samples {
        let expected = Rgb::new(0.8, 0.6, 0.4);
        assert!(off_rgb(sample.radiance[PathClass::Direct as usize], expected, 1.0) < 1e-6, "{sample:?}");
        assert!(off_rgb(sample.albedo, expected, 1.0) < 1e-7 && off(sample.depth_m, 5.0, 1.0) < 1e-6);
        assert!(sample.normal.distance(glam::Vec3::Z) < 1e-6);
    }
}
