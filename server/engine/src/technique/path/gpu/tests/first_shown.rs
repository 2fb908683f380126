//! First passes that a card shows by itself: what the CPU shows of a film that has them.

use super::{
    super::first_shown::ShownAs,
    known_light::{ALL_STEPS, with_records},
    *,
};
use crate::{
    film::{Denoising, Display, Picture, ToneMap},
    gpu::{AdapterChoice, FrameOnCard, GpuOptions, Session, tests::open_with},
    scene::samples,
    technique::caustics::{CausticLight, CausticSettings, CausticSketch},
};

/// Codes that rounding may decide otherwise, as a share, and by how much: the filter's weights are e to what is rounded.
const OTHERS_MAX: f64 = 0.01;
const CODES_OFF_MAX: u8 = 2;

fn by_cpu(film: &Film, display: &Display, denoises: bool) -> Vec<u8> {
    let picture = Picture::of(film);
    let picture = if denoises { picture.denoised(&Denoising::default()) } else { picture };
    display.show_all(&picture.radiance())
}

fn assert_like(card: &[u8], cpu: &[u8], name: &str) {
    assert_eq!(card.len(), cpu.len(), "{name}");
    let off = |(a, b): (&u8, &u8)| a.abs_diff(*b);
    let most = card.iter().zip(cpu).map(off).max().unwrap();
    let others = card.iter().zip(cpu).filter(|pair| off(*pair) > 0).count();
    eprintln!("{name}: {others} of {} codes are others, by {most} at most", card.len());
    assert!(most <= CODES_OFF_MAX, "{name}: by {most}");
    assert!(others as f64 <= 1.0 + OTHERS_MAX * card.len() as f64, "{name}: {others} of {}", card.len());
}

/// What the card shows of samples, noise off, which is what the CPU shows of a film of them.
fn shown_alike(
    (session, frame): (&Session, &FrameOnCard),
    size: PictureSize,
    (samples, display): (&[GpuPixelSample], &Display),
    name: &str,
) -> Vec<u8> {
    session.write(frame.samples(), 0, bytemuck::cast_slice(samples)).unwrap();
    let shown = frame.show(size, PathClasses::ALL.bits(), (display, true), Session::batch);
    let shown = shown.unwrap().collect().unwrap();
    let mut film = Film::new(size);
    for tile in film.tiles_mut() {
        tile.add_pass(|x, y| samples[(y * size.width() + x) as usize].unpacked());
    }
    assert_like(&shown, &by_cpu(&film, display, true), name);
    shown
}

/// Pictures of rooms, with and without their noise, of sizes that fill no workgroup, with classes that are not shown, of looked-up light and with
/// paths that the CPU ends.
#[test]
fn first_passes_are_shown_as_by_the_cpu() {
    let Some(gpu) = shared() else { return };
    let by_records = with_records(samples::cornell_box().unwrap(), ALL_STEPS, true);
    let sketch = Arc::new(CausticSketch::of(&by_records.world, &CausticSettings::for_sketch(None, 3)));
    let focused = by_records.clone().focused(CausticLight::All);
    let of_sketch = Shot { size: size(60, 45), ..by_records.clone() };
    let seen = sketch.for_card(&View::new(&of_sketch.world, &of_sketch.camera, of_sketch.size));
    let hidden = PathSettings { shown: PathClasses::SEEN_AND_DIRECT, ..by_records.settings };
    let shots = [
        ("room", shot(room().finish())),
        ("box", Shot { size: size(97, 71), ..shot(samples::cornell_box().unwrap()) }),
        ("row", Shot { size: size(70, 1), ..shot(room().finish()) }),
        ("column", Shot { size: size(1, 33), ..shot(room().finish()) }),
        ("records and photons", focused),
        ("records and a sketch", Shot { focused: seen, ..of_sketch }),
        ("two classes", Shot { settings: hidden, ..by_records }),
    ];
    for (tone_map, exposure_ev) in [(ToneMap::AgX, 0.0), (ToneMap::Linear, 2.5)] {
        let display = Arc::new(Display::new(tone_map, exposure_ev));
        for (name, shot) in &shots {
            let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
            for denoises in [true, false] {
                let mut tracer = shot.tracer(&scene);
                // Of several slices.
                tracer.slice = 1000;
                tracer.show_first_as(Some(ShownAs { display: Arc::clone(&display), denoises }));
                let mut film = Film::new(shot.size);
                assert!(step(&mut tracer, shot, &mut film, false).complete);
                let shown = tracer.take_shown().expect("the first pass is shown");
                assert_like(&shown, &by_cpu(&film, &display, denoises), name);
                assert!(tracer.take_shown().is_none(), "once");
                assert!(step(&mut tracer, shot, &mut film, false).complete);
                assert!(tracer.take_shown().is_none(), "the second is not");
            }
        }
    }
}

/// Sets something in a sample.
type Set = fn(&mut GpuPixelSample, f32);

fn beyond(sample: &mut GpuPixelSample, albedo: [f32; 3], [x, y, z]: [i8; 3]) {
    (sample.beyond_albedo, sample.beyond_normal) = (albedo, [x, y, z, i8::MAX]);
}

/// Samples that no film takes count as black, also for their neighbours; the largest and smallest that it takes do not end in infinities.
#[test]
fn hostile_samples_are_shown_as_by_the_cpu() {
    let Some(gpu) = shared() else { return };
    let session = gpu.session().unwrap();
    let size = size(24, 8);
    let frame = FrameOnCard::new(&session, size).unwrap();
    let display = Display::new(ToneMap::AgX, 0.0);
    let plain = GpuPixelSample {
        direct: [0.4, 0.3, 0.2],
        indirect: [0.1, 0.2, 0.3],
        albedo_red: 0.5,
        albedo_green: 0.6,
        albedo_blue: 0.7,
        normal: [0.0, 0.6, 0.8],
        depth_m: 3.0,
        ..GpuPixelSample::zeroed()
    };
    let set: [(&str, Set); 7] = [
        ("light", |sample, value| sample.indirect[1] = value),
        ("emitted", |sample, value| (sample.emitted, sample.is_shining) = ([value; 3], 1)),
        ("specular", |sample, value| (sample.specular, sample.is_shining) = ([value; 3], 1)),
        ("albedo", |sample, value| sample.albedo_blue = value),
        ("normal", |sample, value| sample.normal = [value, 0.0, 0.0]),
        ("depth", |sample, value| sample.depth_m = value),
        ("beyond", |sample, value| beyond(sample, [0.5, value, 0.4], [0, 0, 127])),
    ];
    let values =
        [0.0, -0.0, -1.0, 1e-42, f32::MIN_POSITIVE, 1e-20, 1e20, 5e37, f32::MAX, f32::INFINITY, f32::NAN];
    for (name, set) in set {
        for value in values {
            let mut samples = vec![plain; size.pixel_count()];
            for pixel in (0..size.pixel_count()).filter(|pixel| pixel % 17 == 3) {
                set(&mut samples[pixel], value);
            }
            shown_alike((&session, &frame), size, (&samples, &display), &format!("{name} of {value}"));
        }
    }
}

/// Every number by which surfaces are told apart is taken for itself: stripes that differ in one alone, under noisy light.
#[test]
fn each_number_of_a_surface_tells_it_apart() {
    let Some(gpu) = shared() else { return };
    let session = gpu.session().unwrap();
    let size = size(37, 21);
    let frame = FrameOnCard::new(&session, size).unwrap();
    let display = Display::new(ToneMap::Linear, 1.0);
    let set: [(&str, Set); 13] = [
        ("red", |sample, value| sample.albedo_red = value),
        ("green", |sample, value| sample.albedo_green = value),
        ("blue", |sample, value| sample.albedo_blue = value),
        ("x", |sample, value| sample.normal[0] = 0.5 * value - 0.25),
        ("y", |sample, value| sample.normal[1] = 0.5 * value - 0.25),
        ("z", |sample, value| sample.normal[2] = 0.5 * value - 0.25),
        ("depth", |sample, value| sample.depth_m = 3.0 * value),
        ("red beyond", |sample, value| beyond(sample, [value, 0.4, 0.3], [60; 3])),
        ("green beyond", |sample, value| beyond(sample, [0.4, value, 0.3], [60; 3])),
        ("blue beyond", |sample, value| beyond(sample, [0.4, 0.3, value], [60; 3])),
        ("x beyond", |sample, value| beyond(sample, [0.4; 3], [(60.0 * value) as i8, 90, 30])),
        ("y beyond", |sample, value| beyond(sample, [0.4; 3], [20, (-60.0 * value) as i8, 90])),
        ("z beyond", |sample, value| beyond(sample, [0.4; 3], [-90, 10, (60.0 * value) as i8])),
    ];
    let mut pictures: Vec<Vec<u8>> = Vec::new();
    for (name, set) in set {
        let sample = |pixel: usize| {
            let [r, g, b, _] = PixelSampler::new(5, 0, pixel as u32, 0).four(0);
            let mut sample = GpuPixelSample {
                indirect: [r, g, b],
                albedo_red: 0.5,
                albedo_green: 0.5,
                albedo_blue: 0.5,
                normal: [0.2, 0.35, 0.5],
                depth_m: 3.0,
                ..GpuPixelSample::zeroed()
            };
            set(&mut sample, if (pixel % 37) % 6 < 3 { 0.3 } else { 0.7 });
            sample
        };
        let samples: Vec<_> = (0..size.pixel_count()).map(sample).collect();
        let shown = shown_alike((&session, &frame), size, (&samples, &display), name);
        assert!(!pictures.contains(&shown), "{name} shows as another");
        pictures.push(shown);
    }
}

/// What was begun before, has no room or comes from another device is left to the CPU, and the film is what it is without.
#[test]
fn what_cannot_be_shown_is_left_to_the_cpu() {
    let shot = Shot { size: size(48, 40), ..shot(samples::cornell_box().unwrap()) };
    let display = Arc::new(Display::new(ToneMap::AgX, 0.0));
    let shown_as = || Some(ShownAs { display: Arc::clone(&display), denoises: true });
    let on = |bytes_max| {
        let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
        let gpu = open_with(&options).map(Arc::new)?;
        Some((Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world))), gpu))
    };
    let Some((scene, gpu)) = on(u64::MAX) else { return };
    let expected = film_by(&mut shot.tracer(&scene), &shot, 1);
    let alone = scene.bytes();
    // Cut before its first slice it is begun, and nothing of it is missing; after that something is.
    let mut tracer = shot.tracer(&scene);
    tracer.show_first_as(shown_as());
    let mut film = Film::new(shot.size);
    assert!(!step(&mut tracer, &shot, &mut film, true).complete);
    let mut running = Running::new(tracer.begun.take().unwrap());
    tracer.slice = 500;
    tracer.trace_slice(&mut running, shot.size.pixel_count(), None).unwrap();
    tracer.take_rest(&mut running).unwrap();
    tracer.begun = Some(running.begun);
    assert!(step(&mut tracer, &shot, &mut film, false).complete);
    assert!(tracer.take_shown().is_none());
    assert_same_bits(&expected, &film);
    // Of a device that is gone nothing is shown, and of the next everything.
    let mut tracer = shot.tracer(&scene);
    tracer.show_first_as(shown_as());
    film_by(&mut tracer, &shot, 1);
    assert!(tracer.take_shown().is_some());
    // It goes when nobody was shown anything for a while, and comes back.
    let with_frame = scene.bytes();
    assert!(with_frame > alone);
    film_by(&mut tracer, &shot, 16);
    assert_eq!(scene.bytes(), with_frame);
    film_by(&mut tracer, &shot, 1);
    assert!(tracer.take_shown().is_some());
    film_by(&mut tracer, &shot, 20);
    assert!(scene.bytes() < with_frame, "{} of {with_frame}", scene.bytes());
    film_by(&mut tracer, &shot, 1);
    assert!(tracer.take_shown().is_some() && scene.bytes() == with_frame);
    gpu.session().unwrap().lose_for_test();
    film_by(&mut tracer, &shot, 1);
    assert!(tracer.take_shown().is_some());
    scene.withdraw();
    assert_eq!(scene.bytes(), 0);
    assert_eq!(gpu.session().unwrap().bytes_held(), 0, "what shows pictures leaves the card with the scene");
    // No room.
    let room = shot.size.pixel_count() as u64 * SAMPLE_BYTES + 200_000;
    let (scene, _gpu) = on(alone + room).unwrap();
    let mut tracer = shot.tracer(&scene);
    tracer.show_first_as(shown_as());
    let film = film_by(&mut tracer, &shot, 1);
    assert!(tracer.take_shown().is_none() && tracer.failure().is_none());
    assert_same_bits(&expected, &film);
}
