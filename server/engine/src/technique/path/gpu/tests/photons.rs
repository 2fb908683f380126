//! Photons carried from surface to surface, on both.

use super::{gathering::cabinet, *};
use crate::{
    gpu::{AdapterChoice, GpuOptions, tests::open_with},
    render::{IlluminationSettings, Indirect, Learning, RenderSettings, Rendering},
    scene::samples,
    technique::photons::{PhotonHit, PhotonSettings, PhotonTracing},
};

/// Share of photons that may go another way: those whose numbers fall within a rounding of a decision, on every surface anew.
const OTHER_WAYS_MAX: f64 = 4e-3;
/// By how much weights may differ, as shares of the larger one, and places, as shares of the scene's radius: roundings of all surfaces
/// before add up, and grow where light is bent or grazes.
const WEIGHT_OFF_MAX: f32 = 2e-3;
const PLACE_OFF_MAX: f32 = 2e-3;

fn traced(world: &World, settings: PhotonSettings, carrier: Option<&Arc<GpuPhotons>>) -> PhotonTracing {
    let mut tracing = PhotonTracing::new(settings);
    carrier.iter().for_each(|carrier| tracing.carry_by(Arc::clone(carrier) as _));
    let mut counts = Counts::default();
    while !tracing.is_complete() {
        let (products, cancel) = (&mut Products::default(), &AtomicBool::new(false));
        counts += tracing.step(&mut Step { world, products, canvas: None, cancel }).counts;
    }
    assert_eq!(counts.rays > 0, settings.bounces_max != Some(0));
    tracing
}

fn on_card(gpu: &Arc<Gpu>, world: &Arc<World>) -> Arc<GpuPhotons> {
    Arc::new(GpuPhotons::new(Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(world)))))
}

fn is_same(a: &PhotonHit, b: &PhotonHit, radius_m: f32) -> bool {
    let weights = a.weight.to_array().into_iter().zip(b.weight.to_array());
    a.side() == b.side()
        && (a.class(), a.is_on_diffuse()) == (b.class(), b.is_on_diffuse())
        && a.position.distance(b.position) <= PLACE_OFF_MAX * radius_m
        && a.direction().distance(b.direction()) <= PLACE_OFF_MAX
        && weights.into_iter().all(|(a, b)| (a - b).abs() <= WEIGHT_OFF_MAX * a.max(b))
}

/// A bulb in a box of coloured glass in a room.
fn stained() -> Scene {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.7))).unwrap();
    let glass = Material {
        transmission: 1.0,
        roughness: 0.0,
        attenuation_color: Rgb::new(0.9, 0.4, 0.1),
        attenuation_distance_m: 0.2,
        ..Material::default()
    };
    let glass = stage.material("stained", glass).unwrap();
    placed(&mut stage, "room", samples::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &white));
    placed(&mut stage, "ball", samples::sphere(DVec3::ZERO, 0.8, 20, &glass));
    let bulb = LightKind::Point { intensity: Rgb::splat(2.0) };
    lit_by(&mut stage, "bulb", DVec3::new(0.1, 0.2, 1.4), DVec3::NEG_Y, bulb);
    stage.finish()
}

/// Photon for photon the same surfaces, weights and classes, but for those that rounding sends elsewhere; and the same flux goes the
/// same ways: from lamps of all kinds, through mirrors and coloured glass, off bent normals, and where photons meet so many surfaces
/// that a slice has to be sent again in parts.
#[test]
fn photons_go_the_same_ways_on_a_card() {
    let Some(gpu) = shared() else { return };
    let (mut all, mut others) = (0, 0);
    for (name, scene, bounces_max) in [
        ("boxes", samples::boxes().unwrap(), None),
        ("cornell box", samples::cornell_box().unwrap(), None),
        ("cabinet", cabinet(), None),
        ("cabinet, two surfaces", cabinet(), Some(2)),
        ("boxes, one surface", samples::boxes().unwrap(), Some(1)),
        ("cabinet, none", cabinet(), Some(0)),
        ("stained glass", stained(), None),
        ("furnace", samples::furnace(0.95, 1.0).unwrap(), None),
    ] {
        let world = Arc::new(World::prepare(Arc::new(scene)));
        let settings =
            PhotonSettings { emitted_count: 20_000, bounces_max, seed: 3, ..PhotonSettings::default() };
        let card = on_card(&gpu, &world);
        let [by_cpu, by_card] = [None, Some(&card)].map(|carrier| traced(&world, settings, carrier));
        assert_eq!(card.failure(), None, "{name}");
        // Some numbers ask for light that is not there.
        let (sent, paths) = (card.photon_count(), by_card.paths().path_count());
        assert!(sent > paths * 3 / 4 && sent <= paths || bounces_max == Some(0), "{name}: {sent} of {paths}");
        let radius_m = world.accel().radius();
        let (mut count, mut different) = (0, 0);
        for ((path, hits), (path_on_card, hits_on_card)) in by_cpu.paths().each().zip(by_card.paths().each())
        {
            let is_alike = hits.len() == hits_on_card.len()
                && path.start == path_on_card.start
                && path.escape().is_some() == path_on_card.escape().is_some()
                && hits.iter().zip(hits_on_card).all(|(a, b)| is_same(a, b, radius_m));
            count += 1;
            different += u32::from(!is_alike);
        }
        assert_eq!(by_cpu.paths().path_count(), by_card.paths().path_count(), "{name}");
        // Photons that meet twenty surfaces have as many chances to be sent elsewhere.
        let surfaces = (by_cpu.paths().hit_count() as f64 / f64::from(count)).max(1.0);
        let share = f64::from(different) / f64::from(count) / surfaces;
        println!("{name}: {different} of {count} differ, {surfaces:.1} surfaces each");
        assert!(share < OTHER_WAYS_MAX, "{name}: {different} of {count}");
        let [cpu, on_card] = [&by_cpu, &by_card].map(|tracing| tracing.flux());
        let flows = [
            (cpu.emitted, on_card.emitted),
            (cpu.absorbed, on_card.absorbed),
            (cpu.absorbed_on_the_way, on_card.absorbed_on_the_way),
            (cpu.escaped, on_card.escaped),
            (cpu.cut_off, on_card.cut_off),
        ];
        for (cpu_w, on_card_w) in flows {
            assert!((cpu_w - on_card_w).abs() < 5e-3 * cpu.emitted, "{name}: {cpu:?} {on_card:?}");
        }
        assert_eq!(name == "stained glass", on_card.absorbed_on_the_way > 0.05 * on_card.emitted, "{name}");
        let gone = on_card.absorbed + on_card.absorbed_on_the_way + on_card.escaped + on_card.cut_off;
        assert!((gone - on_card.emitted).abs() < 1e-6 * on_card.emitted, "{name}: {on_card:?}");
        (all, others) = (all + count, others + different);
    }
    println!("{others} of {all} photons differ");
}

/// The same photons come back as the same bytes, however many are sent together and whatever came before; devices that are lost on the
/// way change nothing.
#[test]
fn carried_photons_are_the_same_every_time() {
    let Some(gpu) = open().map(Arc::new) else { return };
    let world = Arc::new(World::prepare(Arc::new(cabinet())));
    let settings = PhotonSettings { emitted_count: 30_000, ..PhotonSettings::default() };
    let fresh = on_card(&gpu, &world);
    let first = traced(&world, settings, Some(&fresh));
    // Slices have grown by now.
    let again = traced(&world, settings, Some(&fresh));
    let lossy = on_card(&gpu, &world);
    let mut tracing = PhotonTracing::new(settings);
    tracing.carry_by(Arc::clone(&lossy) as _);
    while !tracing.is_complete() {
        gpu.session().unwrap().lose_for_test();
        let (products, cancel) = (&mut Products::default(), &AtomicBool::new(false));
        tracing.step(&mut Step { world: &world, products, canvas: None, cancel });
    }
    assert_eq!(lossy.failure(), None);
    for other in [&again, &tracing] {
        assert!(first.paths().each().eq(other.paths().each()));
        assert_eq!(first.flux().emitted, other.flux().emitted);
    }
}

/// A picture that learns on a card is the CPU's but for the few photons that go another way: they change what cells near them hold by
/// some percent, and the whole by next to nothing.
#[test]
fn pictures_that_learn_on_a_card_are_the_cpus() {
    let Some(gpu) = shared() else { return };
    let shot = Shot { size: size(40, 32), ..shot(samples::cornell_box().unwrap()) };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let settings =
        RenderSettings { indirect: Indirect::Octree, learning: Learning::First, ..RenderSettings::default() };
    let [cpu, card] = [false, true].map(|learns_on_card| {
        let mut illumination = IlluminationSettings::of(&settings);
        (illumination.photons.emitted_count, illumination.octree.photon_count) = (40_000, 40_000);
        let mut rendering =
            Rendering::learning_by((Arc::clone(&shot.world), illumination), shot.camera, shot.size, settings);
        if learns_on_card {
            rendering.draw_and_learn_on(Arc::clone(&scene));
        }
        while rendering.passes() < 2 {
            rendering.step(&AtomicBool::new(false));
        }
        rendering
    });
    assert_eq!((cpu.gpu_carried_photons(), card.gpu_failure()), (0, None));
    let photons = card.illumination().unwrap().photons().paths().path_count();
    let carried = card.gpu_carried_photons();
    assert!(carried > photons / 2 && carried <= 2 * photons, "{carried} of {photons}");
    let layers = [&cpu, &card].map(|drawn| drawn.film().layer(PathClass::Indirect));
    let sums = layers.each_ref().map(|layer| layer.iter().map(|rgb| f64::from(rgb.mean())).sum::<f64>());
    assert!(sums[0] > 0.0 && (sums[1] / sums[0] - 1.0).abs() < 2e-3, "{sums:?}");
}

/// Where a card cannot hold the scene, and in other worlds, photons are the CPU's, to the last bit.
#[test]
fn photons_are_the_cpus_where_the_card_fails() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 200_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options).map(Arc::new) else { return };
    let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
    let settings = PhotonSettings { emitted_count: 20_000, ..PhotonSettings::default() };
    let expected = traced(&world, settings, None);
    let card = on_card(&gpu, &world);
    let by_both = traced(&world, settings, Some(&card));
    assert!(matches!(card.failure(), Some(GpuError::OutOfMemory { .. })), "{:?}", card.failure());
    assert!(expected.paths().each().eq(by_both.paths().each()));
    let other = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
    let card = on_card(&gpu, &other);
    let elsewhere = traced(&world, settings, Some(&card));
    assert_eq!((card.failure(), card.photon_count()), (None, 0));
    assert!(expected.paths().each().eq(elsewhere.paths().each()));
}
