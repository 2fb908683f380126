//! Light that mirrors and glass focus, looked up among photons, on both.

use super::{
    gathering::cabinet,
    known_light::{Looked, SHADOWED_PASS, looked_up_alike, with_known, with_records},
    *,
};
use crate::{
    scene::{SceneBuilder, SceneLimits, samples},
    technique::{
        PackedFocused,
        caustics::{CausticLight, CausticSettings, CausticSketch, Caustics},
        path::{closed_forms::id, gpu::tests::known_light::ALL_STEPS},
    },
};

impl Shot {
    /// With a map of photons of its own.
    pub(super) fn focused(self, light: CausticLight) -> Shot {
        let of = CausticSettings::for_sketch(self.settings.bounces_max, 3);
        let mut caustics = Caustics::new(CausticSettings { light, ..of });
        assert!(caustics.prepare(&self.world, SHADOWED_PASS, &AtomicBool::new(false)).complete);
        let focused = caustics.map();
        let Some(PackedFocused::Grids(packed)) = focused.as_ref().and_then(|map| map.packed()) else {
            panic!("photons of a pass lie in grids");
        };
        let count = packed.photons.len();
        assert!(count > 100, "{count} photons");
        Shot { focused, ..self }
    }
}

/// Rough metal before a mirror and under a lamp: a broad gloss that sees the lamp in the mirror.
pub(super) fn brushed() -> Stage {
    let mut stage = room();
    let metal = Material { metallic: 1.0, roughness: 0.5, ..Material::default() };
    let metal = stage.material("brushed", metal).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::new(0.4, -0.3, 0.3), 0.7, 16, &metal));
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    let mirror = stage.material("mirror", mirror).unwrap();
    let corners = SQUARE.map(|c| DVec3::new(-1.4, c.y, c.x));
    placed(&mut stage, "plate", quad(corners, &mirror));
    let varnish = Material { roughness: 0.4, specular: 1.0, ..Material::default() };
    let varnish = stage.material("varnish", varnish).unwrap();
    placed(&mut stage, "small ball", samples::sphere(DVec3::new(-0.6, -0.6, 0.9), 0.4, 16, &varnish));
    stage
}

/// A room with a pane, its floor of a narrow gloss, its walls of a broad one, the sun at their mirror image.
pub(super) fn lacquered() -> Scene {
    let mut room = SceneBuilder::from_scene(&samples::glazed_room().unwrap(), SceneLimits::default());
    for (name, roughness) in [("floor", 0.25), ("wall", 0.5)] {
        let material = Material { metallic: 0.5, roughness, ..Material::lambert(Rgb::splat(0.7)) };
        room.set_material(id(name), material).unwrap();
    }
    room.finish().0
}

/// Suns straight through panes are found the same where all paths are traced, bounded or not, and where light is looked up.
#[test]
fn suns_shine_through_panes_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    for (name, bounces_max) in [("unbounded", None), ("three bounces", Some(3)), ("two bounces", Some(2))] {
        let of = PathSettings::all(bounces_max, 4);
        let shot = Shot { settings: of, size: size(64, 48), ..shot(lacquered()) };
        shot.is_alike(&gpu, &format!("panes, {name}"));
        // And there are any.
        let caustic = |pass: Pass| -> f32 {
            pass.samples.iter().map(|sample| sample.radiance[PathClass::Caustic as usize].mean()).sum()
        };
        let world = |scene| Arc::new(World::prepare(Arc::new(scene)));
        let dark = {
            let mut room = SceneBuilder::from_scene(&lacquered(), SceneLimits::default());
            room.remove_light("sun").unwrap();
            Shot { world: world(room.finish().0), ..shot.clone() }
        };
        let [lit, dark] = [shot, dark].map(|shot| caustic(shot.on_cpu(0)));
        assert_eq!(lit > 1.5 * dark, bounces_max != Some(2), "{name}: {lit} beside {dark}");
    }
    let shot = with_known(lacquered(), None).focused(CausticLight::All);
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let (cpu, card) = (shot.on_cpu(SHADOWED_PASS), shot.on_card(&scene, SHADOWED_PASS));
    let without = Shot { focused: None, ..shot }.on_cpu(SHADOWED_PASS);
    let Looked { hidden: focused, .. } = looked_up_alike("panes, looked up", &cpu, &card, &without);
    assert!(focused > 300, "{focused}");
}

/// Photons bring the same, pixel by pixel, where light is looked up besides and where all else is traced: caustics on what is matt,
/// lamps in a broad gloss by way of mirrors, and what no path from the eye finds.
#[test]
fn photons_bring_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    let traced = |scene: Scene, bounces_max| {
        let settings = PathSettings::all(bounces_max, 4);
        Shot { settings, size: size(64, 48), ..shot(scene) }
    };
    let cornell = || samples::cornell_box().unwrap();
    for (name, shot) in [
        ("cornell box by octree", with_known(cornell(), None).focused(CausticLight::All)),
        ("cornell box by records", with_records(cornell(), ALL_STEPS, true).focused(CausticLight::All)),
        ("brushed metal", with_known(brushed().finish(), None).focused(CausticLight::All)),
        ("cabinet", with_known(cabinet(), None).focused(CausticLight::All)),
        ("cabinet, two bounces", with_known(cabinet(), Some(2)).focused(CausticLight::All)),
        ("room with a pane", with_known(samples::glazed_room().unwrap(), None).focused(CausticLight::All)),
        ("hidden light, all traced", traced(cabinet(), None).focused(CausticLight::Hidden)),
        ("hidden light, four bounces", traced(cabinet(), Some(4)).focused(CausticLight::Hidden)),
    ] {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let (cpu, card) = (shot.on_cpu(SHADOWED_PASS), shot.on_card(&scene, SHADOWED_PASS));
        let unfocused = Shot { focused: None, ..shot.clone() };
        let without = unfocused.on_cpu(SHADOWED_PASS);
        let Looked { looked_up, hidden: focused } = looked_up_alike(name, &cpu, &card, &without);
        assert!(looked_up > 1_000 && focused > 300, "{name}: {looked_up} looked up, {focused} focused");
        let counts = [cpu.counts, card.counts].map(|counts| counts.all_rays() as f64);
        assert!((counts[1] / counts[0] - 1.0).abs() < 0.01, "{name}: {counts:?}");
        // And without any, on the same card.
        let again = unfocused.on_card(&scene, SHADOWED_PASS);
        looked_up_alike(name, &without, &again, &without);
    }
}

/// What a camera sees of a sketch cannot be looked up on a card, which says so instead of leaving it out.
#[test]
fn sketches_are_refused_by_a_card() {
    let Some(gpu) = shared() else { return };
    let shot = with_known(samples::cornell_box().unwrap(), None);
    let sketch = CausticSketch::of(&shot.world, &CausticSettings::for_sketch(None, 0));
    let view = View::new(&shot.world, &shot.camera, shot.size);
    let seen = sketch.seen_by(&view);
    assert!(seen.is_some());
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let mut tracer = shot.tracer(&scene);
    let mut film = Film::new(shot.size);
    let mut products = Products { caustics: seen, ..Products::default() };
    let canvas = Some(Canvas { view: &view, film: &mut film });
    let cancel = &AtomicBool::new(false);
    let progress = tracer.step(&mut Step { world: &shot.world, products: &mut products, canvas, cancel });
    assert!(!progress.complete && film.passes_max() == 0);
    assert!(matches!(tracer.failure(), Some(GpuError::Failed { what }) if what.contains("focused light")));
}
