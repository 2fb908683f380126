//! Paths that a card hands over and the CPU follows to their ends.

use super::{
    super::handed::{GpuHandedPath, HANDED_MAX},
    known_light::{ALL_STEPS, with_records},
    *,
};
use crate::{
    math::Rgb,
    scene::{CameraView, samples},
    technique::caustics::CausticLight,
};

/// A pass in one slice, with the paths of it that have not ended.
fn pass(shot: &Shot, scene: &Arc<GpuScene>, hands_over: bool) -> (GpuPathTracer, Handed) {
    let mut tracer = shot.tracer(scene);
    let pixel_count = shot.size.pixel_count();
    let Running { begun, .. } = shot.begin(&mut tracer, 0);
    let light = LightBeside { known: shot.known.as_ref(), focused: shot.focused.as_ref() };
    let traced = scene.trace_with(PathStart::Pixels, pixel_count, light, |tracing| {
        let capacity = tracing.capacity();
        let header = GpuPassHeader { path_count: pixel_count as u32, capacity, ..begun.header };
        let mut slice = tracing.trace_all(&header, hands_over)?;
        let paths = std::mem::take(&mut slice.handed);
        Ok((tracing.bring(&slice)?, paths))
    });
    let (brought, paths) = traced.unwrap();
    brought.read(|bytes| copy_samples(bytes, &mut tracer.samples)).unwrap();
    (tracer, Handed { first_pixel: 0, paths })
}

/// A closed room of one material with a lamp under the ceiling and a ball, seen from inside.
fn closed_room(walls: Material, ball: Material) -> Scene {
    let mut stage = Stage::default();
    let walls = stage.material("walls", walls).unwrap();
    let ball = stage.material("ball", ball).unwrap();
    let lamp = stage.material("lamp", Material::emitter(Rgb::new(9.0, 8.0, 7.0))).unwrap();
    placed(&mut stage, "room", samples::cuboid(DVec3::splat(-1.0), DVec3::splat(1.0), &walls));
    placed(&mut stage, "ball", samples::sphere(DVec3::new(0.2, -0.4, -0.2), 0.4, 24, &ball));
    let corners = SQUARE.map(|c| DVec3::new(0.3 * c.x, 0.95, 0.3 * c.y));
    placed(&mut stage, "lamp", quad(corners, &lamp));
    let view = CameraView::look_at(DVec3::new(-0.3, 0.1, 0.9), DVec3::new(0.1, -0.2, 0.0), DVec3::Y, 1.2);
    stage.camera("main", view, 4.0 / 3.0).unwrap();
    stage.finish()
}

/// Paths that go on by the CPU bring what they would have brought on the card, and all others the same bits: by matt walls, mirrors, in
/// glass that absorbs, and where light is looked up and photons are.
#[test]
fn paths_that_are_handed_over_bring_the_same() {
    let Some(gpu) = shared() else { return };
    let matt = Material::lambert(Rgb::new(0.95, 0.9, 0.85));
    let mirror = |color| Material { base_color: color, metallic: 1.0, roughness: 0.0, ..Material::default() };
    let glass = Material {
        transmission: 1.0,
        roughness: 0.0,
        attenuation_color: Rgb::new(0.95, 0.9, 0.7),
        attenuation_distance_m: 2.0,
        ..Material::default()
    };
    let mirrors = || closed_room(mirror(Rgb::new(0.97, 0.95, 0.93)), matt.clone());
    for (name, shot) in [
        ("matt walls", shot(closed_room(matt.clone(), mirror(Rgb::splat(0.9))))),
        ("mirrors", shot(mirrors())),
        ("mirrors, records and photons", with_records(mirrors(), ALL_STEPS, true).focused(CausticLight::All)),
        ("glass", shot(closed_room(matt.clone(), glass))),
    ] {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let (by_card, none) = pass(&shot, &scene, false);
        assert!(none.paths.is_empty(), "{name}");
        let (mut by_both, handed) = pass(&shot, &scene, true);
        let count = handed.paths.len();
        assert!((1..=HANDED_MAX as usize).contains(&count), "{name}: {count}");
        let is_handed = |slot: usize| handed.paths.iter().any(|path| path.slot as usize == slot);
        for slot in (0..shot.size.pixel_count()).filter(|slot| !is_handed(*slot)) {
            assert_eq!(by_card.samples[slot], by_both.samples[slot], "{name}, slot {slot}");
        }
        let index = shot.begin(&mut by_both, 0).begun.header.index;
        let followed = by_both.follow(&handed, index, shot.focused.as_deref());
        assert_eq!(followed.len(), count, "{name}");
        let before: Vec<GpuPixelSample> = by_both.samples.clone();
        let counts = by_both.add_followed(&handed, &followed);
        assert!(counts.rays as usize >= count && counts.paths == 0, "{name}: {counts:?}");
        let (mut others, mut brought) = (0, 0);
        for GpuHandedPath { slot, .. } in &handed.paths {
            let [card, both, begun] = [&by_card.samples, &by_both.samples, &before]
                .map(|samples| sample_of(&samples[*slot as usize]).total());
            others += usize::from(off_rgb(card, both, 1e-4) > OFF_MAX);
            brought += usize::from(off_rgb(begun, both, 1e-4) > OFF_MAX);
        }
        eprintln!("{name}: {count} paths handed over, {brought} bring more, {others} other than on the card");
        // Balls spread what rounding moves, from scattering to scattering.
        assert!(others <= 1 + count / 10, "{name}: {others} of {count}");
        assert!(brought > others, "{name}: {brought} of {count} bring anything");
    }
}

/// More paths than there is room for go on by the card: none is handed over in part.
#[test]
fn more_paths_than_have_room_stay() {
    let Some(gpu) = shared() else { return };
    let white = Material::lambert(Rgb::splat(0.999));
    let shot = Shot { size: size(64, 48), ..shot(closed_room(white.clone(), white)) };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let (by_both, handed) = pass(&shot, &scene, true);
    let (by_card, _) = pass(&shot, &scene, false);
    let count = handed.paths.len();
    assert!(count <= HANDED_MAX as usize, "{count}");
    let differing = by_card.samples.iter().zip(&by_both.samples).filter(|(a, b)| a != b).count();
    assert!(differing <= count, "{differing} samples lack something, {count} were handed over");
    let longest = handed.paths.iter().map(|path| path.path.bounce).max();
    assert!(longest.is_none_or(|bounce| bounce > 16), "{longest:?}: all were there after 16 scatterings");
}

/// What is no path is followed nowhere: words that no step of ours writes.
#[test]
fn hostile_paths_are_not_followed() {
    let shot = shot(closed_room(Material::lambert(Rgb::splat(0.5)), Material::default()));
    let tracer = Tracer::of(&shot.world, shot.settings);
    let hostile = |class_of_path: u32, word: u32| {
        let mut path: GpuHandedPath = bytemuck::cast([word; 32]);
        path.path.class_so_far = class_of_path;
        path
    };
    for word in [0, 1, u32::MAX, f32::INFINITY.to_bits(), f32::NAN.to_bits(), 1.0_f32.to_bits()] {
        assert_eq!(super::super::handed::follow(&tracer, &[hostile(4, word)], |_| 0).len(), 0);
        for followed in super::super::handed::follow(&tracer, &[hostile(3, word)], |_| 0) {
            assert_eq!(followed.slot, word as usize);
        }
    }
}
