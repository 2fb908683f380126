//! Slices, cancelled passes, lost devices, cards that are too small.

use std::time::Duration;

use super::{
    super::handed::HANDED_MAX,
    known_light::{ALL_STEPS, with_records},
    *,
};
use crate::{
    effects::{EffectChoice, EffectChoices, EffectKind},
    gpu::{AdapterChoice, GpuOptions, tests::open_with},
    render::{IlluminationSettings, Indirect, RenderSettings, Rendering},
    scene::samples,
    technique::caustics::{CausticLight, CausticSettings, CausticSketch},
};

fn cornell() -> Shot {
    Shot { size: size(48, 40), ..shot(samples::cornell_box().unwrap()) }
}

/// The same, path-traced alone, and by records and photons.
fn cornells() -> [Shot; 2] {
    let by_records = with_records(samples::cornell_box().unwrap(), ALL_STEPS, true);
    [cornell(), Shot { size: size(48, 40), ..by_records.focused(CausticLight::All) }]
}

/// These, and by records and a sketch.
fn with_sketch() -> [Shot; 3] {
    let [traced, by_records] = cornells();
    let sketch = Arc::new(CausticSketch::of(&by_records.world, &CausticSettings::for_sketch(None, 3)));
    let seen = sketch.for_card(&View::new(&by_records.world, &by_records.camera, by_records.size));
    assert!(seen.is_some());
    let sketched = Shot { focused: seen, ..by_records.clone() };
    [traced, by_records, sketched]
}

/// However a pass is cut into slices, it brings the same bytes.
#[test]
fn slices_of_any_size_bring_the_same_bytes() {
    let Some(gpu) = shared() else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let (whole, counts) = shot.on_card_by(&scene, 1, 1 << 20);
    assert_eq!(counts.paths, 48 * 40);
    for slice in [1900, 640, 65, 64, 47] {
        let (cut, counts_of_cut) = shot.on_card_by(&scene, 1, slice);
        assert!(whole == cut, "slices of {slice}");
        assert_eq!(counts, counts_of_cut, "slices of {slice}");
    }
}

/// A pass that was cancelled goes on where it was: the picture is the undisturbed one, and no path is traced twice.
#[test]
fn a_cancelled_pass_keeps_its_slices_and_goes_on() {
    let Some(gpu) = shared() else { return };
    for shot in with_sketch() {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let undisturbed = film_by(&mut shot.tracer(&scene), &shot, 2);
        let mut tracer = shot.tracer(&scene);
        let mut film = Film::new(shot.size);
        assert!(!step(&mut tracer, &shot, &mut film, true).complete);
        assert_eq!((film.passes_max(), tracer.begun.as_ref().unwrap().taken), (0, 0));
        for kept in [100, 200, 300] {
            let mut running = Running::new(tracer.begun.take().unwrap());
            tracer.slice = 100;
            tracer.trace_slice(&mut running, shot.size.pixel_count(), None).unwrap();
            let cancelled = AtomicBool::new(true);
            let traced =
                tracer.trace_slices(&mut running, shot.size.pixel_count(), None, &cancelled).unwrap();
            assert_eq!((traced.complete, traced.counts.paths), (false, 100));
            assert_eq!((running.begun.taken, running.traced()), (kept, kept));
            tracer.begun = Some(running.begun);
            assert_eq!(step(&mut tracer, &shot, &mut film, true), Progress::default());
            let begun = tracer.begun.as_ref().unwrap();
            assert_eq!((film.passes_max(), begun.taken), (0, kept));
            assert!(known::is_same(begun.focused.as_ref(), shot.focused.as_ref()), "the same light");
        }
        let progress = step(&mut tracer, &shot, &mut film, false);
        assert!(progress.complete && tracer.begun.is_none());
        assert_eq!(progress.counts.paths, shot.size.pixel_count() as u64 - 300);
        assert!(step(&mut tracer, &shot, &mut film, false).complete);
        assert_same_bits(&undisturbed, &film);
    }
}

/// Passes of a picture share the memory that their samples come to; that of another size has its own, and a card that failed none.
#[test]
fn passes_share_memory_for_samples() {
    let Some(gpu) = shared() else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let mut tracer = shot.tracer(&scene);
    film_by(&mut tracer, &shot, 1);
    let samples = tracer.samples.clone();
    tracer.make_room(shot.size.pixel_count()).unwrap();
    assert!(tracer.samples == samples, "the same memory, not cleared");
    assert_eq!(
        tracer.samples.capacity() * size_of::<GpuPixelSample>(),
        48 * 40 * GpuPathTracer::BYTES_PER_PIXEL
    );
    let small = Shot { size: size(20, 10), ..shot.clone() };
    let by_itself = film_by(&mut shot.tracer(&scene), &small, 2);
    assert_same_bits(&by_itself, &film_by(&mut tracer, &small, 2));
    assert_eq!(tracer.samples.capacity(), 20 * 10);
}

/// What was begun of another picture is not taken for this one's.
#[test]
fn slices_of_another_picture_are_thrown_away() {
    let Some(gpu) = shared() else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let corner = shot.world.scene().camera_view(Some("corner")).unwrap();
    let other = Shot { camera: corner, ..shot.clone() };
    let undisturbed = film_by(&mut other.tracer(&scene), &other, 1);
    let mut tracer = shot.tracer(&scene);
    let mut running = shot.begin(&mut tracer, 0);
    tracer.slice = 500;
    tracer.trace_slice(&mut running, shot.size.pixel_count(), None).unwrap();
    tracer.take_rest(&mut running).unwrap();
    tracer.begun = Some(running.begun);
    assert_same_bits(&undisturbed, &film_by(&mut tracer, &other, 1));
}

/// Devices that are lost between two slices, and while one is drawn, change no bit of the picture.
#[test]
fn lost_devices_change_no_bit_of_the_picture() {
    let Some(gpu) = open().map(Arc::new) else { return };
    for shot in with_sketch() {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let undisturbed = film_by(&mut shot.tracer(&scene), &shot, 3);
        let mut tracer = shot.tracer(&scene);
        let mut film = Film::new(shot.size);
        let mut running = shot.begin(&mut tracer, 0);
        tracer.slice = 700;
        tracer.trace_slice(&mut running, shot.size.pixel_count(), None).unwrap();
        tracer.take_rest(&mut running).unwrap();
        tracer.begun = Some(running.begun);
        let before = gpu.session().unwrap().generation();
        gpu.session().unwrap().lose_for_test();
        assert!(step(&mut tracer, &shot, &mut film, false).complete, "slices are kept on this side");
        assert_eq!(gpu.session().unwrap().generation(), before + 1);
        let lost = gpu.session().unwrap();
        std::thread::scope(|scope| {
            // Somewhere in the passes to come: wherever that is, they bring the same.
            scope.spawn(|| {
                std::thread::park_timeout(Duration::from_millis(5));
                lost.lose_for_test();
            });
            for _ in 0..20 {
                if film.passes_min() < 3 {
                    step(&mut tracer, &shot, &mut film, false);
                }
            }
        });
        assert_eq!(tracer.failure(), None);
        assert_same_bits(&undisturbed, &film);
    }
}

/// A device that goes while samples are on their way takes those along and no others; they are traced again.
#[test]
fn samples_on_their_way_go_with_the_device_and_others_stay() {
    let Some(gpu) = open().map(Arc::new) else { return };
    let shot = cornell();
    let pixel_count = shot.size.pixel_count();
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
    let undisturbed = film_by(&mut shot.tracer(&scene), &shot, 1);
    let mut tracer = shot.tracer(&scene);
    let mut film = Film::new(shot.size);
    let mut running = shot.begin(&mut tracer, 0);
    for slices in 1..4 {
        tracer.slice = 100;
        tracer.trace_slice(&mut running, pixel_count, None).unwrap();
        assert_eq!((running.begun.taken, running.traced()), (100 * (slices - 1), 100 * slices));
    }
    gpu.session().unwrap().lose_for_test();
    let traced = tracer.trace_slices(&mut running, pixel_count, None, &AtomicBool::new(false));
    assert_eq!(traced, Err(GpuError::Lost));
    assert_eq!((running.begun.taken, running.traced()), (200, 200));
    tracer.begun = Some(running.begun);
    let progress = step(&mut tracer, &shot, &mut film, false);
    assert!(progress.complete && tracer.failure().is_none());
    assert_eq!(progress.counts.paths, pixel_count as u64 - 200);
    assert_same_bits(&undisturbed, &film);
}

/// However many slices a pass has, those of one are on their way at a time: a card needs room for no more.
#[test]
fn samples_of_one_slice_are_on_their_way_at_a_time() {
    let options = |bytes_max| GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
    let shot = cornell();
    let on = |bytes_max| {
        let gpu = Arc::new(open_with(&options(bytes_max))?);
        let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
        let (samples, _) = shot.on_card_by(&scene, 0, 320);
        Some((samples, scene.bytes()))
    };
    let Some((undisturbed, alone)) = on(u64::MAX) else { return };
    // And for paths that are handed over, and the counters of a batch.
    let handed = u64::from(HANDED_MAX) * size_of::<GpuHandedPath>() as u64;
    let room = 320 * SAMPLE_BYTES + handed + 1000;
    assert!(on(alone + room).is_some_and(|(samples, _)| samples == undisturbed));
}

/// A scene that a card has no room for is an error with its numbers, and the CPU draws the picture, from its first bit on.
#[test]
fn scenes_too_large_for_a_card_are_drawn_on_the_cpu() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 200_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options).map(Arc::new) else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let mut tracer = shot.tracer(&scene);
    let mut film = Film::new(shot.size);
    assert!(!step(&mut tracer, &shot, &mut film, false).complete);
    let failure = tracer.failure().cloned().unwrap();
    assert!(
        matches!(failure, GpuError::OutOfMemory { bytes_allowed, .. } if bytes_allowed <= 200_000),
        "{failure}"
    );
    assert_eq!((film.passes_max(), tracer.samples.capacity()), (0, 0));
    assert_eq!(step(&mut tracer, &shot, &mut film, false), Progress::default(), "and stays so");
    let draw = |scene: Option<&Arc<GpuScene>>| {
        let settings = RenderSettings { seed: 6, ..RenderSettings::default() };
        let mut rendering = Rendering::new(Arc::clone(&shot.world), shot.camera, shot.size, settings);
        if let Some(scene) = scene {
            rendering.draw_on(Arc::clone(scene));
            assert!(rendering.is_on_gpu());
        }
        while rendering.passes() < 2 {
            rendering.step(&AtomicBool::new(false));
        }
        assert!(!rendering.is_on_gpu());
        (rendering.film().clone(), rendering.gpu_failure().cloned())
    };
    let (by_both, found) = draw(Some(&scene));
    assert_eq!(found, Some(failure));
    let (by_cpu, _) = draw(None);
    assert_same_bits(&by_cpu, &by_both);
}

/// Light that a card has no room for beside the scene is an error of its own: the scene stays and draws on, with light that has room too.
#[test]
fn light_too_large_for_a_card_leaves_the_scene_there() {
    let options = |bytes_max| GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
    let [shot, by_records] = cornells();
    let bytes_after = |shot: &Shot, gpu: Gpu| {
        let scene = Arc::new(GpuScene::new(Arc::new(gpu), Arc::clone(&shot.world)));
        shot.on_card(&scene, 0);
        scene.bytes()
    };
    let Some(gpu) = open_with(&options(u64::MAX)) else { return };
    let alone = bytes_after(&shot, gpu);
    let together = bytes_after(&by_records, open_with(&options(u64::MAX)).unwrap());
    // Room for samples on their way back, and not for light as well.
    let room = shot.size.pixel_count() as u64 * SAMPLE_BYTES + 1_000;
    assert!(together > alone + room, "{alone} {together}");
    let gpu = Arc::new(open_with(&options(alone + room)).unwrap());
    let world = Arc::clone(&shot.world);
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&world)));
    let drawn = shot.on_card(&scene, 0).samples;
    // Of the same world, as cards know it.
    let mut tracer = Shot { world, ..by_records.clone() }.tracer(&scene);
    assert!(!step(&mut tracer, &by_records, &mut Film::new(shot.size), false).complete);
    let failure = tracer.failure().cloned().unwrap();
    assert!(matches!(failure, GpuError::LightTooLarge { .. }), "{failure}");
    assert_eq!(scene.bytes(), alone, "the scene is there, and nothing else");
    assert!(shot.on_card(&scene, 0).samples == drawn);
    // Where all has room but photons no light stays either, and next time it fits without those.
    let unfocused = Shot { focused: None, ..by_records.clone() };
    let without = bytes_after(&unfocused, open_with(&options(u64::MAX)).unwrap());
    assert!(together > without + room, "{without} {together}");
    let gpu = Arc::new(open_with(&options(without + room)).unwrap());
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&by_records.world)));
    let mut tracer = by_records.tracer(&scene);
    step(&mut tracer, &by_records, &mut Film::new(shot.size), false);
    let failure = tracer.failure().cloned();
    assert!(matches!(failure, Some(GpuError::LightTooLarge { .. })), "{failure:?}");
    assert!(scene.bytes() < without, "{} {without}", scene.bytes());
    let by_cpu = unfocused.on_cpu(0).samples;
    let by_card = unfocused.on_card(&scene, 0).samples;
    assert!(by_cpu.len() == by_card.len() && scene.bytes() == without, "{} {without}", scene.bytes());
}

/// Where a larger picture needs places that have no room beside light on the card, the light goes for them and comes back.
#[test]
fn light_makes_room_for_places() {
    let options = |bytes_max| GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
    let small = with_records(samples::boxes().unwrap(), ALL_STEPS, true);
    let large = Shot { size: size(200, 150), ..small.clone() };
    let Some(gpu) = open_with(&options(u64::MAX)).map(Arc::new) else { return };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&small.world)));
    let unknown = Shot { known: None, settings: PathSettings::all(None, 4), ..large.clone() };
    unknown.on_card(&scene, 0);
    let with_places = scene.bytes();
    let expected = large.on_card(&scene, 0).samples;
    let light = scene.bytes() - with_places;
    // Places of the small picture are there until those of the large one are.
    let small_places =
        small.size.pixel_count() as u64 * (PATH_BYTES + HIT_BYTES + 2 * SHADOW_BYTES + SAMPLE_BYTES + 4 * 4);
    let slack = 50_000;
    assert!(light > 2 * slack, "{light} bytes of light have room");
    let gpu = Arc::new(open_with(&options(with_places + small_places + slack)).unwrap());
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&small.world)));
    small.on_card(&scene, 0);
    assert!(large.on_card(&scene, 0).samples == expected);
}

/// Of light that several pictures ask in turns each keeps what it asked: nothing is taken for another's, also where one takes the
/// place in memory of another; what nobody has any more leaves the card, and what stays there is bounded.
#[test]
fn lights_take_turns_on_a_card() {
    // A device of its own, whose bytes are this test's.
    let Some(gpu) = open().map(Arc::new) else { return };
    let boxes = |steps| with_records(samples::boxes().unwrap(), steps, true);
    let alone = |shot: &Shot| {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let samples = shot.on_card(&scene, 0).samples;
        scene.withdraw();
        samples
    };
    // Five of which none could pass for another.
    let mut shots = vec![boxes(ALL_STEPS)];
    let mut expected = vec![alone(&shots[0])];
    for steps in 6.. {
        if shots.len() == 5 {
            break;
        }
        assert!(steps < 40, "only {} differ", shots.len());
        let shot = boxes(steps);
        let own = alone(&shot);
        if !expected.contains(&own) {
            shots.push(shot);
            expected.push(own);
        }
    }
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shots[0].world)));
    let mut most = 0;
    for index in [0, 1, 2, 3, 4, 0, 4, 2, 2, 1, 0, 1, 2, 3, 4] {
        assert!(shots[index].on_card(&scene, 0).samples == expected[index], "{index}");
        most = most.max(scene.bytes());
    }
    let unknown = Shot { known: None, settings: PathSettings::all(None, 4), ..shots[0].clone() };
    let drop_all = |shots| {
        drop::<Vec<Shot>>(shots);
        unknown.on_card(&scene, 0);
        scene.bytes()
    };
    let none = drop_all(shots);
    let one = {
        let shot = boxes(ALL_STEPS);
        shot.on_card(&scene, 0);
        scene.bytes() - none
    };
    assert!(most - none < 9 * one / 2, "{none} without, {one} each, {most} at most");
    for steps in [12, 8, 15, 9, 12, 8] {
        let shot = boxes(steps);
        assert!(shot.on_card(&scene, 0).samples == alone(&shot), "{steps}");
    }
}

/// Photons of their own bring caustics to a picture on a card as well, with or without indirect light.
#[test]
fn caustics_by_photons_are_not_lost_on_a_card() {
    let Some(gpu) = shared() else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let mut without_indirect = EffectChoices::default();
    *without_indirect.choice_mut(EffectKind::Indirect).unwrap() = EffectChoice::Off;
    for effects in [EffectChoices::default(), without_indirect] {
        let settings = RenderSettings { indirect: Indirect::Octree, effects, ..RenderSettings::default() };
        let mut light = IlluminationSettings::of(&settings);
        (light.photons.emitted_count, light.octree.photon_count, light.octree.depth) = (20_000, 20_000, 4);
        let [by_cpu, on_card] = [None, Some(&scene)].map(|scene| {
            let world = (Arc::clone(&shot.world), light);
            let mut rendering = Rendering::learning_by(world, shot.camera, shot.size, settings);
            if let Some(scene) = scene {
                rendering.draw_on(Arc::clone(scene));
            }
            while rendering.passes() < 2 {
                rendering.step(&AtomicBool::new(false));
            }
            rendering.film().clone()
        });
        assert!(by_cpu.layer(PathClass::Caustic).iter().any(|radiance| !radiance.is_black()));
        assert_alike(&by_cpu, &on_card);
    }
}
