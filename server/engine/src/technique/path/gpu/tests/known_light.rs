//! Light that is looked up in the octree and in records of irradiance, on both.

use std::num::{NonZeroU32, NonZeroUsize};

use super::*;
use crate::{
    render::{Illumination, IlluminationSettings, RenderSettings},
    scene::samples,
    technique::{
        Dimmed,
        irradiance::{IrradianceCaching, IrradianceSettings, Visits},
    },
};

/// Both look up the same packed lights: only sums of theirs round differently.
pub(super) const LOOKED_UP_OFF_MAX: f32 = 1e-3;

pub(super) fn with_known(scene: Scene, bounces_max: Option<u32>) -> Shot {
    let world = Arc::new(World::prepare(Arc::new(scene.clone())));
    let mut settings = IlluminationSettings::of(&RenderSettings { bounces_max, ..RenderSettings::default() });
    settings.photons.emitted_count = 40_000;
    settings.octree.photon_count = 40_000;
    settings.octree.depth = 5;
    let mut light = Illumination::new(settings);
    for _ in 0..10_000 {
        if light.step(&world, &AtomicBool::new(false)) {
            break;
        }
    }
    let known = light.known().cloned().expect("photons fell somewhere");
    assert!(known.packed().is_some());
    let settings = PathSettings::all(bounces_max, 4).asking();
    Shot { world, settings, known: Some(known), size: size(64, 48), ..shot(scene) }
}

/// A pass whose known light is shadowed by what lies near, unless scatterings are bounded.
pub(super) const SHADOWED_PASS: u32 = 2 * BLURRED_SAMPLES;

/// Diffuse and glossy balls, and one that light passes.
fn balls() -> Stage {
    let mut stage = room();
    let plastic = Material { roughness: 0.4, base_color: Rgb::new(0.2, 0.6, 0.9), ..Material::default() };
    let plastic = stage.material("plastic", plastic).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::ZERO, 0.8, 16, &plastic));
    let half_glass = Material { transmission: 0.5, roughness: 0.0, ..Material::default() };
    let half_glass = stage.material("half glass", half_glass).unwrap();
    placed(&mut stage, "small ball", samples::sphere(DVec3::new(0.9, -0.6, 0.7), 0.35, 12, &half_glass));
    stage
}

/// Pixels that show light which is looked up, and that are other ones than without its shadows.
pub(super) struct Looked {
    pub(super) looked_up: usize,
    pub(super) hidden: usize,
}

/// Asserts that passes bring the same, pixel by pixel, of light that is looked up.
pub(super) fn looked_up_alike(name: &str, cpu: &Pass, card: &Pass, unshadowed: &Pass) -> Looked {
    let (mut others, mut largest, mut looked_up, mut hidden) = (0, 0.0f32, 0, 0);
    for ((a, b), unshadowed) in cpu.samples.iter().zip(&card.samples).zip(&unshadowed.samples) {
        assert!(b.is_sound(), "{b:?}");
        let secondary = |sample: &PixelSample| sample.radiance[2] + sample.radiance[3];
        let a_known = secondary(a);
        looked_up += usize::from(!a_known.is_black());
        // Class by class: what is indirect on the one is not a caustic on the other.
        let of_class = |class: usize| (a.radiance[class] - b.radiance[class]).map(f32::abs).max_component();
        let difference = of_class(2).max(of_class(3));
        hidden += usize::from(a != unshadowed);
        // What is hidden is taken from all that is known.
        let of = a_known.max_component().max(secondary(unshadowed).max_component());
        let off = if difference == 0.0 { 0.0 } else { difference / of };
        let sampled_off = [0, 1, 4]
            .map(|class| off_rgb(a.radiance[class], b.radiance[class], 1e-3))
            .into_iter()
            .fold(0.0, f32::max);
        if sampled_off > OFF_MAX || !(off <= LOOKED_UP_OFF_MAX) {
            others += 1;
            continue;
        }
        largest = largest.max(off);
    }
    eprintln!(
        "{name}: {others} of {} took another decision, the others are off by {largest} at most; {hidden} near something",
        cpu.samples.len()
    );
    assert!(others <= cpu.samples.len() / 200, "{name}: {others}");
    Looked { looked_up, hidden }
}

/// Look-ups bring the same, pixel by pixel, at diffuse surfaces and through glass and mirrors, and the
/// same is hidden and seen near them.
#[test]
fn the_octree_answers_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    // A ball that came when the octree was made already.
    let late = {
        let mut stage = balls();
        let matt = stage.material("matt", Material::lambert(Rgb::new(0.8, 0.5, 0.3))).unwrap();
        placed(&mut stage, "late ball", samples::sphere(DVec3::new(-0.9, 0.1, 0.9), 0.45, 16, &matt));
        let world = Arc::new(World::prepare(Arc::new(stage.finish())));
        Shot { world, ..with_known(balls().finish(), None) }
    };
    for (name, shot) in [
        ("boxes", with_known(samples::boxes().unwrap(), None)),
        ("cornell box", with_known(samples::cornell_box().unwrap(), None)),
        ("plastic and half glass", with_known(balls().finish(), None)),
        // Groups beside the wall belong to one room or the other.
        ("parted rooms", with_known(samples::parted_rooms([300.0, 3.0]).unwrap(), None)),
        // Cells differ in size.
        ("room on wide ground", with_known(samples::room_on_ground().unwrap(), None)),
        // By way of mirrors and glass a scattering is used up.
        ("two bounces", with_known(samples::cornell_box().unwrap(), Some(2))),
        ("ball that came later", late),
    ] {
        let bounces_max = shot.settings.bounces_max;
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let blurred = shot.on_cpu_as(SHADOWED_PASS, Near::Blurred);
        let (cpu, card) = (shot.on_cpu(SHADOWED_PASS), shot.on_card(&scene, SHADOWED_PASS));
        let is_shadowed =
            cpu.counts.shadow_rays > blurred.counts.shadow_rays + shot.size.pixel_count() as u64 / 3;
        assert_eq!(is_shadowed, bounces_max.is_none(), "{name}: {:?} {:?}", cpu.counts, blurred.counts);
        let of_card = card.counts.shadow_rays as f64 / cpu.counts.shadow_rays as f64;
        assert!((of_card - 1.0).abs() < 0.005, "{name}: {:?} {:?}", card.counts, cpu.counts);
        let Looked { looked_up, hidden } = looked_up_alike(name, &cpu, &card, &blurred);
        assert!(looked_up > cpu.samples.len() / 3, "{looked_up} looked up");
        assert_eq!(hidden > 50, bounces_max.is_none(), "{name}: {hidden}");
    }
}

/// The same picture with nobody to ask, then somebody, then nobody.
#[test]
fn asking_begins_and_ends_on_a_card() {
    let Some(gpu) = shared() else { return };
    let asking = with_known(samples::boxes().unwrap(), None);
    let alone = Shot { known: None, settings: PathSettings::all(None, 4), ..asking.clone() };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&asking.world)));
    let first = alone.on_card(&scene, 0).samples;
    let asked = asking.on_card(&scene, 0).samples;
    assert!(first != asked);
    assert!(alone.on_card(&scene, 0).samples == first);
    let tracer = PathTracer::with_secondary(asking.settings, asking.known.clone().unwrap());
    let mut on_card = GpuPathTracer::new(scene, PathSettings::all(None, 0));
    on_card.draw_as(&tracer);
    let film = film_by(&mut on_card, &asking, 1);
    let indirect: Vec<Rgb> =
        asked.iter().map(|sample| sample.radiance[PathClass::Indirect as usize]).collect();
    assert_eq!(film.layer(PathClass::Indirect), indirect);
}

/// A card shows light dimmed as the CPU does, of cells and of records.
#[test]
fn dimmed_light_is_shown_alike_on_a_card() {
    let Some(gpu) = shared() else { return };
    // Twice, as what is dimmed already may be.
    let (once, by) = (Rgb::new(0.5, 3.0, 2.0), Rgb::new(0.5, 1.0, 0.0));
    for (name, asking) in [
        ("balls", with_known(balls().finish(), None)),
        ("records", with_records(samples::boxes().unwrap(), SOME_STEPS, true)),
    ] {
        let dimmed = Shot {
            known: asking.known.clone().map(|known| Dimmed::by(by, Dimmed::by(once, known))),
            ..asking.clone()
        };
        let scene = Arc::new(GpuScene::new(gpu.clone(), Arc::clone(&asking.world)));
        let card = dimmed.on_card(&scene, SHADOWED_PASS);
        let (cpu, blurred) = (dimmed.on_cpu(SHADOWED_PASS), dimmed.on_cpu_as(SHADOWED_PASS, Near::Blurred));
        assert!(looked_up_alike(name, &cpu, &card, &blurred).looked_up > cpu.samples.len() / 3);
        let bright = asking.on_card(&scene, SHADOWED_PASS);
        let sum = |pass: &Pass| {
            pass.samples
                .iter()
                .fold(Rgb::BLACK, |sum, sample| sum + sample.radiance[PathClass::Indirect as usize])
        };
        let (is, was) = (sum(&card), sum(&bright));
        assert!(is.r < 0.5 * was.r && is.g > 2.0 * was.g && is.b < 0.5 * was.b, "{name}: {is:?} of {was:?}");
    }
}

/// Records of what the shot's camera sees, all or as many as come of `steps`.
///
/// - `has_base`: the octree answers where none counts
pub(super) fn with_records(scene: Scene, steps: usize, has_base: bool) -> Shot {
    let (shot, caching) = gathered(scene, steps, has_base);
    Shot { known: Some(caching.snapshot()), ..shot }
}

/// The same, as they were gathered.
pub(super) fn gathered(scene: Scene, steps: usize, has_base: bool) -> (Shot, IrradianceCaching) {
    let shot = with_known(scene, None);
    let octree = shot.known.clone().unwrap();
    let settings = IrradianceSettings {
        ray_count: NonZeroUsize::new(60).unwrap(),
        visits: Visits::exactly(NonZeroU32::MIN),
        is_paced: false,
        ..IrradianceSettings::default()
    };
    let arriving = PathTracer::with_secondary(PathSettings::all(None, 0), Arc::clone(&octree));
    let mut caching = IrradianceCaching::new(settings, Arc::new(arriving), has_base.then_some(octree));
    caching.look(0, &shot.camera, shot.size);
    let never = AtomicBool::new(false);
    for _ in 0..steps {
        let mut step =
            Step { world: &shot.world, products: &mut Products::default(), canvas: None, cancel: &never };
        caching.step(&mut step);
    }
    assert!(caching.is_complete() || steps < ALL_STEPS);
    assert!(!caching.cache().records().is_empty());
    (shot, caching)
}

pub(super) const ALL_STEPS: usize = 3_000;
/// Steps after which records of several rounds answer one after the other.
pub(super) const SOME_STEPS: usize = 12;

/// Records bring the same, pixel by pixel: those of one cache and of several, at walls, in glosses and mirrors, and the octree where
/// none counts.
#[test]
fn records_answer_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    let boxes = |steps, has_base| with_records(samples::boxes().unwrap(), steps, has_base);
    let from = |eye: DVec3, at: DVec3, shot: Shot| {
        let camera = CameraView::look_at(eye, at, DVec3::Y, 1.2);
        Shot { camera, ..shot }
    };
    let from_elsewhere = |shot| from(DVec3::new(-1.5, 1.2, -1.0), DVec3::new(0.6, -0.2, 0.4), shot);
    let parted = |has_base| with_records(samples::parted_rooms([300.0, 3.0]).unwrap(), ALL_STEPS, has_base);
    let beyond = |shot| from(DVec3::new(-1.8, 1.2, 0.3), DVec3::new(0.0, 0.3, -0.1), shot);
    for (name, shot, looked_up_min) in [
        ("boxes", boxes(ALL_STEPS, true), 1_000),
        ("boxes, half covered", boxes(SOME_STEPS, true), 1_000),
        // What is seen from elsewhere has no records behind what hid it.
        ("boxes from elsewhere", from_elsewhere(boxes(ALL_STEPS, true)), 1_000),
        ("boxes from elsewhere, records alone", from_elsewhere(boxes(ALL_STEPS, false)), 500),
        ("cornell box", with_records(samples::cornell_box().unwrap(), ALL_STEPS, true), 1_000),
        ("plastic and half glass", with_records(balls().finish(), ALL_STEPS, true), 1_000),
        ("parted rooms", parted(true), 1_000),
        // Beyond the wall nothing counts but through it, which is better than nothing.
        ("parted rooms from beyond", beyond(parted(true)), 1_000),
        ("parted rooms from beyond, records alone", beyond(parted(false)), 100),
    ] {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let blurred = shot.on_cpu_as(SHADOWED_PASS, Near::Blurred);
        let (cpu, card) = (shot.on_cpu(SHADOWED_PASS), shot.on_card(&scene, SHADOWED_PASS));
        let Looked { looked_up, .. } = looked_up_alike(name, &cpu, &card, &blurred);
        assert!(looked_up >= looked_up_min, "{name}: {looked_up} looked up");
        let of_card = card.counts.all_rays() as f64 / cpu.counts.all_rays() as f64;
        assert!((of_card - 1.0).abs() < 0.005, "{name}: {:?} {:?}", card.counts, cpu.counts);
    }
}
