//! Sketches of caustics, counted in pixels and looked up there, on both.

use super::{
    super::sketch::{CELL_WORDS, GpuWindows, PLACE_WORDS, SketchOnCard},
    gathering::cabinet,
    known_light::{Looked, SHADOWED_PASS, looked_up_alike, with_known},
    *,
};
use crate::{
    gpu::Session,
    scene::{Projection, samples},
    technique::{
        PackedFocused, PackedSketch, SHOWN_NOWHERE,
        caustics::{CausticPhoton, CausticSettings, CausticSketch},
    },
};

/// Half of what a rounding may change.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;

fn packed(sketch: &Arc<CausticSketch>, view: &View) -> PackedSketch {
    match sketch.for_card(view).expect("a card takes it").packed() {
        Some(PackedFocused::Sketch(packed)) => *packed,
        other => panic!("{other:?}"),
    }
}

/// What a card counted, read back.
struct OnCard {
    /// Pixels around the picture where photons show as well.
    margin: i32,
    places: Vec<Option<[i32; 2]>>,
    cells: Vec<Vec<Vec<u32>>>,
    counted: SketchOnCard,
}

impl OnCard {
    fn of(session: &Arc<Session>, packed: &PackedSketch) -> OnCard {
        let counted = SketchOnCard::new(session, packed).unwrap();
        let [_, words, header] = &counted.buffers;
        let header = session.read(header, 0..header.byte_count()).unwrap();
        let header: super::super::sketch::GpuSketch = bytemuck::pod_read_unaligned(&header);
        let words = session.read(words, 0..words.byte_count()).unwrap();
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&words);
        let place_of = |(photon, width): (usize, &u32)| {
            let at = header.places_at as usize + PLACE_WORDS as usize * photon;
            (*width != SHOWN_NOWHERE).then(|| [words[at] as i32, words[at + 1] as i32])
        };
        let places = counted.chosen.iter().enumerate().map(place_of).collect();
        let cells_of = |windows: &GpuWindows| {
            let rows = ((header.height - 1) >> windows.cell_log2) as usize + 1;
            let cell = |cell: usize| {
                let at = windows.cells_at as usize + CELL_WORDS as usize * cell;
                let [count, end] = [words[at] as usize, words[at + 1] as usize];
                words[end - count..end].to_vec()
            };
            (0..rows * windows.columns as usize).map(cell).collect()
        };
        let cells = header.windows.iter().map(cells_of).collect();
        OnCard { margin: header.margin, places, cells, counted }
    }
}

/// Asserts that photons show in the same pixels on both, but where their places lie within what rounding may do to them: then each shows in a
/// pixel, along each axis by itself, that rounding allows. Returns how many do not.
fn assert_same_places(
    view: &View,
    photons: &[CausticPhoton],
    cpu: &[Option<[i32; 2]>],
    card: &OnCard,
) -> usize {
    let dot = |offset: Vec3, axis: Vec3| {
        let each = (offset.as_dvec3() * axis.as_dvec3()).to_array();
        // A subtraction, a product, two sums, on either side.
        (each.iter().sum::<f64>(), 8.0 * ROUNDING * each.iter().map(|part| part.abs()).sum::<f64>())
    };
    let mut others = 0;
    let margin = card.margin;
    for ((photon, cpu), card) in photons.iter().zip(cpu).zip(&card.places) {
        if cpu == card {
            continue;
        }
        others += 1;
        let offset = photon.position - view.origin;
        let (depth_m, depth_off) = dot(offset, -view.back);
        let size = [view.size().width(), view.size().height()];
        // First and last pixel that rounding allows along an axis.
        let allowed = [(0, view.right), (1, -view.up)].map(|(axis, along)| {
            let (along, along_off) = dot(offset, along);
            let (half, half_off) = match view.is_perspective {
                true => (f64::from(view.half_size[axis]) * depth_m, depth_off / depth_m),
                false => (f64::from(view.half_size[axis]), 0.0),
            };
            let from_middle = along / half;
            // A product before and a quotient, of which a card may be off by 2.5 units of the last place.
            let middle_off = along_off / half + from_middle.abs() * (half_off + 14.0 * ROUNDING);
            let at = 0.5 * (1.0 + from_middle) * f64::from(size[axis]);
            let at_off =
                0.5 * f64::from(size[axis]) * (middle_off + 8.0 * ROUNDING * (1.0 + from_middle.abs()));
            [(at - at_off).floor(), (at + at_off).floor()]
        });
        for place in [cpu, card] {
            let is_allowed = match place {
                Some(pixel) => {
                    let within =
                        |(at, [first, last]): (&i32, [f64; 2])| (first..=last).contains(&f64::from(*at));
                    pixel.iter().zip(allowed).all(within)
                }
                // Beyond the margin along one axis.
                None => size.iter().zip(allowed).any(|(size, [first, last])| {
                    first < -f64::from(margin) || last >= f64::from(*size) + f64::from(margin)
                }),
            };
            assert!(is_allowed, "{photon:?} shows in {cpu:?} and {card:?}, allowed {allowed:?}");
        }
    }
    others
}

/// Counts on both and asserts that all but roundings of places is the same. Returns the card's places.
fn counted_alike(gpu: &Gpu, name: &str, sketch: &Arc<CausticSketch>, view: &View) -> Vec<Option<[i32; 2]>> {
    let card = OnCard::of(&gpu.session().unwrap(), &packed(sketch, view));
    let cpu = sketch.places(view);
    let others = assert_same_places(view, sketch.photons(), &cpu, &card);
    let expected = sketch.counted(&card.places, view);
    assert!(card.counted.chosen == expected.chosen, "{name}: windows");
    assert_eq!(card.counted.is_fit, expected.is_fit, "{name}");
    assert!(card.cells == expected.cells, "{name}: cells");
    let shown = card.places.iter().flatten().count();
    let entries: usize = card.cells.iter().flatten().map(Vec::len).sum();
    eprintln!("{name}: {others} of {shown} photons show in another pixel; {entries} entries");
    card.places
}

fn looking(world: &World, camera: &CameraView, projection: Option<Projection>, side: [u32; 2]) -> View {
    let projection = projection.unwrap_or(camera.projection);
    View::new(world, &CameraView { projection, ..*camera }, size(side[0], side[1]))
}

/// A card counts the CPU's photons in the CPU's cells, in the CPU's order, whatever picture they are counted in.
#[test]
fn sketches_are_counted_alike_on_a_card() {
    let Some(gpu) = shared() else { return };
    for (name, scene) in [("cornell box", samples::cornell_box().unwrap()), ("cabinet", cabinet())] {
        let camera = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
        let world = World::prepare(Arc::new(scene));
        let sketch = Arc::new(CausticSketch::of(&world, &CausticSettings::for_sketch(None, 3)));
        assert!(sketch.report().photons_stored > 1_000, "{:?}", sketch.report());
        let flat = Projection::Orthographic { half_height_m: 1.0 };
        let narrow = Projection::Perspective { yfov_rad: 0.2 };
        for (projection, side) in [
            (None, [256, 192]),
            (None, [641, 359]),
            (None, [7, 7]),
            (None, [1, 1]),
            (None, [1, 300]),
            (Some(flat), [300, 200]),
            // Most photons lie beyond its borders.
            (Some(narrow), [128, 96]),
        ] {
            let view = looking(&world, &camera, projection, side);
            counted_alike(&gpu, &format!("{name} at {side:?}"), &sketch, &view);
        }
    }
}

fn sketched(shot: &Shot, gpu: &Gpu, name: &str) -> [Shot; 2] {
    let settings = CausticSettings::for_sketch(shot.settings.bounces_max, 3);
    let sketch = Arc::new(CausticSketch::of(&shot.world, &settings));
    let view = View::new(&shot.world, &shot.camera, shot.size);
    let places = counted_alike(gpu, name, &sketch, &view);
    let seen = [sketch.seen_in(&places, &view), sketch.for_card(&view).unwrap()];
    seen.map(|seen| Shot { focused: Some(seen), ..shot.clone() })
}

/// From half a metre beside a photon, under a cosine of 0.02.
fn along_a_surface(shot: Shot) -> Shot {
    let sketch = CausticSketch::of(&shot.world, &CausticSettings::for_sketch(None, 3));
    let photons = sketch.photons();
    let CausticPhoton { position, normal, .. } = photons[photons.len() / 2];
    // Render space is the world's, moved.
    let to_world = |p: Vec3| p.as_dvec3() - shot.world.accel().to_render(DVec3::ZERO).as_dvec3();
    let eye = position + 0.5 * normal.any_orthonormal_vector() + 0.01 * normal;
    let camera = CameraView::look_at(to_world(eye), to_world(position), normal.as_dvec3(), 0.1);
    Shot { camera, ..shot }
}

/// Photons in pixels bring the same on a card, sample by sample, on what is matt and what is glossy, straight and by way of mirrors; and
/// nothing where they are not asked for.
#[test]
fn sketches_bring_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    let cornell = || samples::cornell_box().unwrap();
    for (name, shot) in [
        ("cornell box", with_known(cornell(), None)),
        ("brushed metal", with_known(focused::brushed().finish(), None)),
        ("cabinet", with_known(cabinet(), None)),
        ("cabinet, two bounces", with_known(cabinet(), Some(2))),
        ("seen along a surface", along_a_surface(with_known(cornell(), None))),
    ] {
        let [by_cpu, by_card] = sketched(&shot, &gpu, name);
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let (cpu, card) = (by_cpu.on_cpu(SHADOWED_PASS), by_card.on_card(&scene, SHADOWED_PASS));
        let without = shot.on_cpu(SHADOWED_PASS);
        let Looked { looked_up, hidden: focused } = looked_up_alike(name, &cpu, &card, &without);
        assert!(looked_up > 1_000 && focused > 300, "{name}: {looked_up} looked up, {focused} focused");
        let again = shot.on_card(&scene, SHADOWED_PASS);
        looked_up_alike(name, &without, &again, &without);
    }
}

/// Photons at the eye, behind it, far away and out of sight, as many as a card takes in one pixel, in a row over the borders, or none at all:
/// the same, and numbers. What lies so far away that no floats are left for it is dropped before.
#[test]
fn hostile_sketches_are_counted_alike_on_a_card() {
    let Some(gpu) = shared() else { return };
    let shot = with_known(samples::cornell_box().unwrap(), None);
    let view = View::new(&shot.world, &shot.camera, shot.size);
    let of_scene = CausticSketch::of(&shot.world, &CausticSettings::for_sketch(None, 3));
    let first = of_scene.photons()[0];
    let at = |position: Vec3| CausticPhoton { position, ..first };
    let ahead = |right: f32, up: f32, ahead_m: f32| {
        at(view.origin + view.right * right + view.up * up - view.back * ahead_m)
    };
    let half = view.half_size;
    let eye = vec![
        at(view.origin),
        ahead(0.0, 0.0, -1.0),
        ahead(1.0, 1.0, -1e-30),
        ahead(0.0, 0.0, 1e-30),
        ahead(1.0, -1.0, 1e-30),
        ahead(1.0, 1.0, 1e-6),
        ahead(0.0, 0.0, 1e11),
        ahead(1e11, 1e11, 1.0),
        ahead(-1e11, 0.0, 1e-10),
    ];
    let too_far = [
        ahead(0.0, 0.0, 1e30),
        ahead(1e30, 1e30, 1.0),
        at(Vec3::splat(f32::MAX)),
        at(Vec3::splat(-f32::MAX)),
        at(Vec3::new(f32::INFINITY, 0.0, 0.0)),
        at(Vec3::new(0.0, f32::NAN, 0.0)),
    ];
    let near = CausticSketch::of_photons([&eye[..], &too_far[..]].concat());
    assert!(near.photons() == eye);
    // From twice the picture's width on the left to as far on the right, and down likewise.
    let over_borders = (0..4_000u32).map(|i| {
        let along = (i as f32 / 2_000.0 - 1.0) * 2.0;
        if i % 2 == 0 {
            ahead(along * half[0], half[1] * 0.9, 1.0)
        } else {
            ahead(-half[0], along * half[1], 1.0)
        }
    });
    let lit =
        shot.world.closest_hit(&view.ray(20.5, 30.5)).map(|hit| view.ray(20.5, 30.5).at(hit.t)).unwrap();
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
    for (name, photons) in [
        ("none", Vec::new()),
        ("at the eye", eye),
        ("all in one pixel", vec![at(lit); 1 << 15]),
        ("over the borders", over_borders.collect()),
    ] {
        let sketch = Arc::new(CausticSketch::of_photons(photons));
        counted_alike(&gpu, name, &sketch, &view);
        let seen = Shot { focused: sketch.for_card(&view), ..shot.clone() };
        let samples = seen.on_card(&scene, 0).samples;
        assert!(samples.iter().all(PixelSample::is_sound), "{name}");
        // By the CPU, as after a card has failed: one that says nothing is as good as none.
        let by_cpu = seen.on_cpu(0).samples;
        let is_lit = |samples: &[PixelSample]| {
            let plain = shot.on_cpu(0).samples;
            samples.iter().zip(&plain).any(|(a, b)| {
                (a.radiance[2] - b.radiance[2]).max_component() > 1e-3 * first.flux_w.max_component()
            })
        };
        assert_eq!(is_lit(&samples), is_lit(&by_cpu), "{name}");
    }
    let many = Arc::new(CausticSketch::of_photons(vec![at(lit); (1 << 15) + 1]));
    assert!(many.for_card(&view).is_none(), "more than loops of all drivers go round");
    let sketch = Arc::new(of_scene);
    let [mut away, mut wide] = [view; 2];
    away.origin = Vec3::splat(1e13);
    wide.half_size[0] = 1e13;
    assert!(sketch.for_card(&view).is_some());
    assert!([away, wide].iter().all(|view| sketch.for_card(view).is_none()), "no floats are left for these");
}
