//! Suns behind panes, which no path meets and light sampling finds.

use super::*;
use crate::{
    effects::{EffectChoice, EffectChoices},
    scene::samples::cuboid,
};

/// Share that passes a boundary of index 1.5 at 60° by Fresnel's equations.
const PASSES: f64 = 0.910_81;

/// A square that looks up at a sun 60° from straight above, and a camera that looks down at it, with so many panes in the sun's way.
fn under_panes(material: Material, panes: usize) -> Scene {
    let mut stage = Stage::default();
    let material = stage.material("square", material).unwrap();
    let v = DVec3::new;
    let square = [v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)];
    stage.place("square", samples::quad(square, &material), DAffine3::IDENTITY).unwrap();
    let clear = Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ..Material::default() };
    let clear = stage.material("clear", clear).unwrap();
    for number in 0..panes {
        let y = 2.0 + 0.1 * number as f64;
        let pane = cuboid(v(1.8, y, -1.3), v(6., y + 0.02, 1.3), &clear);
        stage.place(&format!("pane {number}"), pane, DAffine3::IDENTITY).unwrap();
    }
    let kind = LightKind::Directional { irradiance: Rgb::new(3.0, 2.0, 1.0) };
    let direction = v(-60f64.to_radians().sin(), -0.5, 0.0);
    stage.light("sun", Light { parent: None, position: DVec3::ZERO, direction, kind }).unwrap();
    // About where the sun's mirror image is.
    let view = CameraView::look_at(v(-1.4, 1.0, 0.1), DVec3::ZERO, DVec3::Y, 0.4);
    stage.camera("main", view, 1.0).unwrap();
    stage.finish()
}

/// Two passes of a picture that learns of its light first.
fn learnt(scene: &Scene, side: u32, settings: RenderSettings) -> Film {
    let world = Arc::new(World::prepare(Arc::new(scene.clone())));
    let view = scene.camera_view(None).unwrap();
    let mut rendering = Rendering::new(world, view, PictureSize::new(side, side).unwrap(), settings);
    while rendering.film().passes_min() < 2 {
        rendering.step(&AtomicBool::new(false));
    }
    rendering.film().clone()
}

/// Mean of what does not come by way of the square itself, which panes mirror.
fn straight(film: &Film) -> f64 {
    mean(&film.radiance()) - mean(&film.layer(PathClass::Indirect))
}

/// Matt, narrow and broad surfaces show as much less of a sun as panes reflect, by path tracing without any noise, and where light is looked
/// up; not where fewer scatterings are asked for than that takes.
#[test]
fn suns_shine_through_panes_on_every_lobe() {
    let metal = |roughness| Material { metallic: 1.0, roughness, ..Material::lambert(Rgb::splat(0.8)) };
    for (name, material) in [
        ("matt", Material::lambert(Rgb::splat(0.5))),
        ("narrow", metal(0.25)),
        ("broad", metal(0.6)),
        (
            "coat",
            Material { roughness: 0.2, ..Material { base_color: Rgb::splat(0.3), ..Material::default() } },
        ),
    ] {
        let by = |panes, settings: RenderSettings| {
            straight(&render(&under_panes(material.clone(), panes), 16, 4, settings))
        };
        let open = by(0, seeded(1));
        assert!(open > 0.01, "{name}: {open}");
        for panes in [1, 2] {
            let passes = PASSES.powi(2 * panes as i32);
            let least = 2 * panes as u32 + 1;
            for (bounces_max, expected) in [(None, passes), (Some(least), passes), (Some(least - 1), 0.0)] {
                let share = by(panes, RenderSettings { bounces_max, ..seeded(1) }) / open;
                assert!((share - expected).abs() < 1e-3, "{name}, {bounces_max:?}: {share} for {expected}");
            }
        }
        let known = RenderSettings { indirect: Indirect::Octree, ..seeded(1) };
        let share = straight(&learnt(&under_panes(material.clone(), 1), 16, known)) / open;
        // With what panes reflect twice, by few photons.
        assert!((share - PASSES.powi(2)).abs() < 0.02, "{name}, octree: {share}");
    }
}

/// What is turned off is not shown: light through panes goes with the caustics.
#[test]
fn suns_behind_panes_go_with_the_caustics() {
    let scene = under_panes(Material::lambert(Rgb::splat(0.5)), 1);
    let film = render(&scene, 8, 1, seeded(1));
    let (caustic, all) = (mean(&film.layer(PathClass::Caustic)), straight(&film));
    assert!(all > 0.0 && (caustic / all - 1.0).abs() < 1e-6, "{caustic} of {all}");
    let effects = EffectChoices { caustics: EffectChoice::Off, ..EffectChoices::default() };
    let without = render(&scene, 8, 1, RenderSettings { effects, ..seeded(1) });
    assert_eq!(straight(&without), 0.0);
}
