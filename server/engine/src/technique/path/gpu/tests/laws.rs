//! The numerical laws of `path/tests.rs`, on a card.

use super::*;
use crate::{
    scene::{SceneBuilder, SceneLimits, samples},
    technique::path::{
        closed_forms::id,
        tests::{box_with_lights, in_white_surroundings, mean_and_error},
    },
};

fn film(gpu: &Arc<Gpu>, scene: Scene, side: u32, passes: u32, seed: u64) -> Film {
    let settings = PathSettings::all(None, seed);
    let film = Shot { size: size(side, side), settings, ..shot(scene) }.film_on_card(gpu, passes);
    assert_eq!(film.dropped_samples(), 0);
    assert!(film.radiance().iter().all(|rgb| rgb.is_finite() && rgb.is_non_negative()));
    film
}

/// A closed box that emits E and reflects ρ everywhere holds radiance E / (1 − ρ), whatever ρ.
#[test]
fn closed_furnace_holds_the_geometric_sum() {
    let Some(gpu) = shared() else { return };
    for albedo in [0.0, 0.5, 0.9, 0.98] {
        let film = film(&gpu, samples::furnace(albedo, 0.25).unwrap(), 32, 16, 1);
        let (mean, error) = mean_and_error(&film.radiance());
        let expected = 0.25 / (1.0 - f64::from(albedo));
        // 5 standard errors, and 1e-4 for rounding over the hundreds of bounces of the whitest box.
        assert!(
            (mean - expected).abs() < 5.0 * error + 1e-4 * expected,
            "ρ {albedo}: {mean} ± {error}, not {expected}"
        );
    }
}

/// In a uniform surrounding of radiance 1 whatever loses no light looks like nothing: radiance 1 in every pixel.
#[test]
fn white_furnace_keeps_radiance_one_for_every_lossless_bsdf() {
    let Some(gpu) = shared() else { return };
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    for (name, material) in [
        ("lambert", Material::lambert(Rgb::WHITE)),
        ("mirror", Material { metallic: 1.0, roughness: 0.0, ..Material::default() }),
        ("glass", glass.clone()),
        ("glass of ior 1", Material { ior: 1.0, ..glass.clone() }),
        ("diamond", Material { ior: 2.4, ..glass.clone() }),
        ("half glass", Material { transmission: 0.5, ..glass }),
    ] {
        let film = film(&gpu, in_white_surroundings(material), 24, 32, 2);
        let (mean, error) = mean_and_error(&film.radiance());
        assert!((mean - 1.0).abs() < 5.0 * error + 2e-3, "{name}: {mean} ± {error}");
    }
    // Reciprocal Fresnel coats give up a little where F depends on the half vector: never a gain.
    for roughness in [0.0, 0.1, 0.6, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            let material = Material { metallic, roughness, ..Material::default() };
            let film = film(&gpu, in_white_surroundings(material), 24, 16, 2);
            let (mean, error) = mean_and_error(&film.radiance());
            assert!(
                mean < 1.0 + 5.0 * error + 1e-3,
                "roughness {roughness} metallic {metallic} gains: {mean} ± {error}"
            );
            assert!(mean > 0.4, "roughness {roughness} metallic {metallic} loses more than stated: {mean}");
        }
    }
}

/// A millionth and a million times the light is that share of the picture, and nothing overflows.
#[test]
fn pictures_are_linear_in_light() {
    let Some(gpu) = shared() else { return };
    let once = film(&gpu, box_with_lights(1.0, None), 24, 2, 7).radiance();
    for factor in [1e-6, 2.0, 1e6] {
        let scaled = film(&gpu, box_with_lights(factor, None), 24, 2, 7).radiance();
        let others = once
            .iter()
            .zip(&scaled)
            .filter(|(a, b)| off_rgb(**a * factor, **b, factor * 1e-6) > 2e-4)
            .count();
        // Chances of lights are rounded otherwise by factors that are no powers of two: one path in a hundred, no more.
        assert!(
            others <= if factor == 2.0 { 0 } else { once.len() / 100 },
            "× {factor}: {others} of {}",
            once.len()
        );
    }
}

/// A light a thousand million times another overflows nothing, and both show.
#[test]
fn extreme_light_ratios_stay_finite() {
    let Some(gpu) = shared() else { return };
    for (sun, lamp) in [(1e9, 1.0), (1e-9, 1e9)] {
        let mut builder = SceneBuilder::from_scene(&box_with_lights(lamp, None), SceneLimits::default());
        let kind = LightKind::Directional { irradiance: Rgb::splat(sun) };
        let direction = DVec3::new(0.1, -0.2, -1.0).normalize();
        builder.add_light(id("sun"), Light { parent: None, position: DVec3::ZERO, direction, kind }).unwrap();
        let film = film(&gpu, builder.finish().0, 24, 4, 10);
        assert!(film.layer(PathClass::Direct).iter().any(|radiance| radiance.max_component() > 1e3));
    }
}
