//! What edits leave of records of irradiance [techniques.md, irradiance cache].

use super::*;
use crate::{
    accel::{Hit, Ray},
    math::sobol::PixelSampler,
    scene::CameraView,
    technique::{
        ArrivingLight, Counts,
        irradiance::{IrradianceCache, IrradianceCaching, IrradianceSettings, Record, Visits},
    },
};

/// Surfaces that shine by where they are, whose they are and what they are made of, and by nothing else.
#[derive(Debug)]
struct Motley;

impl ArrivingLight for Motley {
    fn radiance(
        &self,
        world: &World,
        ray: &Ray,
        met: Option<Hit>,
        _sampler: &PixelSampler,
        _counts: &mut Counts,
    ) -> Rgb {
        let Some(hit) = met else { return Rgb::WHITE };
        let instance = &world.accel().instances()[hit.instance as usize];
        let name = instance.node_id().as_str().bytes().fold(0, |key, byte| sobol::mix(key ^ u64::from(byte)));
        let [r, g, b, _] = sobol::point(name, 1);
        let surface = world.surface(&hit, ray.direction);
        let place = surface.point.position.to_array().map(|coordinate| (3.0 * coordinate).sin() + 1.1);
        surface.bsdf.diffuse_of_even_light(Vec3::Z) * Rgb::new(r, g, b) * Rgb::from(place)
            + Rgb::new(r, g, b) * 0.1
    }
}

fn gathering(visits: u32) -> IrradianceSettings {
    IrradianceSettings {
        ray_count: NonZeroUsize::new(100).unwrap(),
        visits: Visits::exactly(visits.try_into().unwrap()),
        is_paced: false,
        ..IrradianceSettings::default()
    }
}

fn step(caching: &mut IrradianceCaching, world: &World) -> bool {
    let never = AtomicBool::new(false);
    let mut products = Products::default();
    caching.step(&mut Step { world, products: &mut products, canvas: None, cancel: &never }).complete
}

fn finish(caching: &mut IrradianceCaching, world: &World) {
    for _ in 0..100_000 {
        if step(caching, world) {
            return;
        }
    }
    panic!("no end of records");
}

/// The triangles that records say they lie on are there: rays from them leave that triangle out.
fn assert_on_what_they_name(caching: &IrradianceCaching, world: &World) {
    for point in caching.points() {
        let instance = &world.accel().instances()[point.on.instance as usize];
        let corners = instance.mesh().triangles()[point.on.triangle as usize];
        let [a, b, c] = corners.map(|corner| instance.vertex_in_render(corner));
        let off_m = (point.position - a).dot((b - a).cross(c - a).normalize()).abs();
        assert!(off_m < 1e-4, "{point:?} lies {off_m} m off its triangle");
        let inside = [(a, b), (b, c), (c, a)]
            .map(|(from, to)| (to - from).cross(point.position - from).dot(point.n_geo));
        assert!(
            inside.iter().all(|side| *side > -1e-4) || inside.iter().all(|side| *side < 1e-4),
            "{point:?}"
        );
    }
}

/// The light of a record, without how far it counts.
fn light(record: &Record) -> (Vec3, Vec3, Rgb, [Vec3; 3], [Vec3; 3]) {
    (record.position, record.normal, record.irradiance, record.turning, record.moving)
}

/// Where records lack that `camera` sees: pixels of a picture of some size.
fn uncovered(cache: &IrradianceCache, world: &World, size: PictureSize) -> usize {
    let camera = world.scene().camera_view(None).unwrap();
    let view = crate::technique::View::new(world, &camera, size);
    let pixels = (0..size.height()).flat_map(|y| (0..size.width()).map(move |x| (x, y)));
    let lacks = |(x, y): &(u32, u32)| {
        let ray = view.ray(*x as f32 + 0.5, *y as f32 + 0.5);
        let Some(hit) = world.closest_hit(&ray) else { return false };
        let surface = world.surface(&hit, ray.direction);
        let facing = crate::technique::irradiance::Facing::of(&surface, -ray.direction);
        surface.bsdf.has_diffuse() && cache.irradiance(surface.point.position, &facing).is_none()
    };
    pixels.filter(lacks).count()
}

/// A record whose rays met what an edit changed is dropped, and of those that are, most did: others met only the box around it. Those
/// that stay are to the last bit what would be gathered at their places in the scene after it, before and after that is done, and no
/// pixel is left without one.
#[test]
fn edits_drop_the_records_that_saw_them() {
    let size = PictureSize::new(32, 24).unwrap();
    let (mut stayed, mut dropped, mut dropped_in_vain, mut kept_edits) = (0, 0, 0, 0);
    let seeds: u32 = if std::env::var_os("LUMICAST_NIGHTLY").is_some() { 3 } else { 1 };
    for seed in 0..seeds {
        let mut dice = Dice { key: sobol::mix(u64::from(seed) ^ 0x5265), thrown: 0 };
        let mut world = world_of(samples::cornell_box().unwrap());
        let mut caching = IrradianceCaching::new(gathering(2), Arc::new(Motley), None);
        caching.look(0, &world.scene().camera_view(None).unwrap(), size);
        finish(&mut caching, &world);
        let mut has_pause = false;
        for number in 0..100 {
            let (scene, change) = random_edit(world.scene(), &mut dice, number);
            let next = world.update(Arc::new(scene), &change);
            let edit = Edit { before: &world, after: &next, change: &change };
            let (before, leaves_lights) = (caching.cache().records().to_vec(), edit.leaves_lights());
            let saw_it: Vec<bool> = before
                .iter()
                .zip(caching.afresh(&next).0.records())
                .map(|(before, after)| light(before) != light(after))
                .collect();
            caching.apply(&edit);
            let kept: std::collections::HashSet<[u32; 3]> =
                caching.cache().records().iter().map(|r| r.position.to_array().map(f32::to_bits)).collect();
            for (before, saw_it) in before.iter().zip(saw_it) {
                let is_kept = kept.contains(&before.position.to_array().map(f32::to_bits));
                assert!(!(is_kept && saw_it), "seed {seed}, edit {number}: {before:?} saw it and stayed");
                if leaves_lights {
                    (stayed, dropped) = (stayed + u32::from(is_kept), dropped + u32::from(!is_kept));
                    dropped_in_vain += u32::from(!is_kept && !saw_it);
                }
            }
            kept_edits += u32::from(!kept.is_empty());
            world = next;
            assert_on_what_they_name(&caching, &world);
            if dice.throw()[0] < 0.3 {
                // The next edit comes in the middle of the work.
                for _ in 0..dice.below(60) {
                    step(&mut caching, &world);
                }
                has_pause = true;
                continue;
            }
            finish(&mut caching, &world);
            let (afresh, variances) = caching.afresh(&world);
            assert!(caching.variances() == variances, "seed {seed}, edit {number}");
            for (record, afresh) in caching.cache().records().iter().zip(afresh.records()) {
                assert_eq!(light(record), light(afresh), "seed {seed}, edit {number}");
                // Those of the first rounds hand radii on from round to round, and an edit that changes nothing leaves them.
                let are_of_rounds = kept.is_empty() || has_pause || change.leaves_light_alone();
                assert!(are_of_rounds || record == afresh, "seed {seed}, edit {number}");
            }
            has_pause = false;
            assert_eq!(uncovered(caching.cache(), &world, size), 0, "seed {seed}, edit {number}");
        }
    }
    println!("{stayed} stayed, {dropped} dropped, {dropped_in_vain} in vain, {kept_edits} edits left any");
    assert!(kept_edits > 20 * seeds, "{kept_edits}");
    assert!(
        stayed > 0 && 5 * dropped_in_vain < 2 * dropped,
        "{dropped_in_vain} of {dropped}; {stayed} stayed"
    );
}

/// With photons and octree beneath them: after any edits records hold what would be gathered at their places from what is known now,
/// whether or not rough ones were made of less before.
#[test]
fn records_are_of_the_light_of_now() {
    for learning in [Learning::First, Learning::InStep] {
        let settings = RenderSettings { learning, ..RenderSettings::default() };
        let of = IlluminationSettings { irradiance: gathering(2), ..super::settings(3_000, 4) };
        let size = PictureSize::new(24, 18).unwrap();
        let mut dice = Dice { key: sobol::mix(77), thrown: 0 };
        let mut world = world_of(samples::cornell_box().unwrap());
        let mut learner = Learner::new(Learnt::Records, &settings, of);
        learner.look(0, &world.scene().camera_view(None).unwrap(), size);
        let never = AtomicBool::new(false);
        let mut kept_count = 0;
        for number in 0..24 {
            let (scene, change) = random_edit(world.scene(), &mut dice, number);
            let next = world.update(Arc::new(scene), &change);
            learner.apply(&Edit { before: &world, after: &next, change: &change });
            world = next;
            kept_count += u32::from(learner.records().count > 0);
            if dice.throw()[0] < 0.3 {
                (0..dice.below(40)).for_each(|_| {
                    learner.step(&world, &never);
                });
                continue;
            }
            let mut steps = 0;
            while learner.stage() != Stage::Complete {
                learner.step(&world, &never);
                steps += 1;
                assert!(steps < 100_000, "no end of it");
            }
            let caching = learner.caching().unwrap();
            let (afresh, variances) = caching.afresh(&world);
            assert!(caching.variances() == variances, "{learning:?}, edit {number}");
            for (record, afresh) in caching.cache().records().iter().zip(afresh.records()) {
                assert_eq!(light(record), light(afresh), "{learning:?}, edit {number}");
            }
            assert_eq!(uncovered(caching.cache(), &world, size), 0, "{learning:?}, edit {number}");
        }
        assert!(kept_count > 4, "{learning:?}: {kept_count} edits left records");
    }
}

/// Rough records are shown before the second round of photons, light is gathered for them anew after it, and somebody who looks
/// elsewhere all the time does not keep that round from coming.
#[test]
fn rough_records_come_before_the_second_round_of_photons() {
    let settings = RenderSettings { learning: Learning::InStep, ..RenderSettings::default() };
    let of = IlluminationSettings { irradiance: gathering(1), ..super::settings(30_000, 5) };
    let size = PictureSize::new(24, 18).unwrap();
    let world = world_of(samples::cornell_box().unwrap());
    let camera = world.scene().camera_view(None).unwrap();
    let never = AtomicBool::new(false);
    let photons = |learner: &Learner| learner.illumination().unwrap().report().photons_emitted;
    let shows_records =
        |learner: &Learner| learner.known().is_some_and(|known| known.card().name == "irradiance");

    let mut learner = Learner::new(Learnt::Records, &settings, of);
    learner.look(0, &camera, size);
    while !shows_records(&learner) {
        learner.step(&world, &never);
    }
    let (first, rough) = (photons(&learner), learner.caching().unwrap().cache().records().to_vec());
    assert!(learner.illumination().unwrap().stage() == Stage::Rough && !rough.is_empty());
    while learner.stage() != Stage::Complete {
        learner.step(&world, &never);
    }
    assert!(photons(&learner) > 4 * first, "{} photons after {first}", photons(&learner));
    let caching = learner.caching().unwrap();
    let now = &caching.cache().records()[..rough.len()];
    assert!(
        rough
            .iter()
            .zip(now)
            .all(|(before, now)| before.position == now.position && light(before) != light(now))
    );
    for (record, afresh) in caching.cache().records().iter().zip(caching.afresh(&world).0.records()) {
        assert_eq!(light(record), light(afresh));
    }

    let mut learner = Learner::new(Learnt::Records, &settings, of);
    let mut looks = 0;
    while learner.illumination().unwrap().stage() != Stage::Complete {
        let aside = DAffine3::from_translation(0.001 * f64::from(looks) * DVec3::X);
        let world_from_camera = camera.world_from_camera * aside;
        learner.look(0, &CameraView { world_from_camera, ..camera }, size);
        learner.step(&world, &never);
        looks += 1;
        assert!(looks < 2_000, "rough records for ever");
    }
    // And somebody who edits all the time does neither.
    let mut learner = Learner::new(Learnt::Records, &settings, of);
    learner.look(0, &camera, size);
    let (mut world, mut steps, mut pauses) = (world, 0, 0);
    while learner.illumination().unwrap().is_before_last_round() {
        learner.step(&world, &never);
        steps += 1;
        // Nearly as soon as an edit is followed the next comes; between faster ones there is no second round.
        pauses += u32::from(!learner.is_catching_up());
        if pauses == 4 {
            pauses = 0;
            let moved = DAffine3::from_translation(DVec3::X * 0.01 * f64::from(steps % 2));
            let (next, change) =
                edited(&world, |builder| builder.set_transform("glass ball", moved).unwrap());
            learner.apply(&Edit { before: &world, after: &next, change: &change });
            world = next;
        }
        assert!(steps < 4_000, "rough records for ever");
    }
}

/// What is shown after an edit counts as of the scene after it only when no light of before is in it: then pictures begin anew.
#[test]
fn light_of_before_is_told_from_that_of_now() {
    let settings = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let of = IlluminationSettings { irradiance: gathering(1), ..super::settings(30_000, 5) };
    let world = world_of(samples::cornell_box().unwrap());
    let mut learner = Learner::new(Learnt::Records, &settings, of);
    learner.look(0, &world.scene().camera_view(None).unwrap(), PictureSize::new(24, 18).unwrap());
    let never = AtomicBool::new(false);
    let small = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.02),
        DQuat::IDENTITY,
        DVec3::new(0.8, 0.2, 0.8),
    );
    let complete = |learner: &mut Learner, world: &World| {
        while learner.stage() != Stage::Complete {
            learner.step(world, &never);
        }
    };
    let (world, _) = edited(&world, |builder| builder.set_transform("mirror block", small).unwrap());
    complete(&mut learner, &world);
    let moved = DAffine3::from_translation(DVec3::new(0.0, 0.02, 0.0)) * small;
    let (after, change) = edited(&world, |builder| builder.set_transform("mirror block", moved).unwrap());
    let (epoch, generation) = (learner.epoch(), learner.generation());
    learner.apply(&Edit { before: &world, after: &after, change: &change });
    assert!(learner.records().count > 0 && learner.generation() > generation);
    let mut steps = 0;
    while learner.epoch() == epoch {
        assert!(learner.caching().unwrap().is_relighting(), "light of now, and not told");
        learner.step(&after, &never);
        steps += 1;
        assert!(steps < 100_000, "light of before for ever");
    }
    let caching = learner.caching().unwrap();
    assert!(!caching.is_relighting());
    for (record, afresh) in caching.cache().records().iter().zip(caching.afresh(&after).0.records()) {
        assert_eq!(record, afresh);
    }
    // A second edit before the first is answered drops them all, and what answers then is told to be of now.
    learner.apply(&Edit { before: &after, after: &world, change: &change });
    assert!(learner.records().count > 0);
    learner.apply(&Edit { before: &world, after: &after, change: &change });
    assert_eq!(learner.records().count, 0);
    let epoch = learner.epoch();
    complete(&mut learner, &after);
    assert!(learner.epoch() > epoch);
}

/// A full cache that an edit left records of makes room for what is looked at, as one that never saw the edit would.
#[test]
fn a_full_cache_makes_room_after_edits() {
    let size = PictureSize::new(32, 24).unwrap();
    let world = world_of(samples::cornell_box().unwrap());
    let small = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.05),
        DQuat::IDENTITY,
        DVec3::new(0.9, 0.1, 0.9),
    );
    let (after, change) = edited(&world, |builder| builder.set_transform("mirror block", small).unwrap());
    let camera = world.scene().camera_view(None).unwrap();
    let of = |records_max: usize, first: &World| {
        let settings = IrradianceSettings { records_max, ..gathering(1) };
        let mut caching = IrradianceCaching::new(settings, Arc::new(Motley), None);
        caching.look(0, &camera, size);
        finish(&mut caching, first);
        caching
    };
    let needed = of(100_000, &after).cache().records().len();
    for records_max in [needed, needed / 2] {
        let mut caching = of(records_max, &world);
        caching.apply(&Edit { before: &world, after: &after, change: &change });
        finish(&mut caching, &after);
        let fresh = uncovered(of(records_max, &after).cache(), &after, size);
        let left = uncovered(caching.cache(), &after, size);
        assert!(
            left <= fresh + 8,
            "{left} pixels without a record, {fresh} of a fresh cache of {records_max}"
        );
    }
}
