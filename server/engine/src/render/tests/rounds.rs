//! Laws of the rounds in which light is learnt, and of what is known between them.

use super::*;
use crate::{accel::Ray, transport::change_of_lights};
use std::time::{Duration, Instant};

/// The rounds of a scene's illumination begin again where an edit changes much and go on where it changes little; what is
/// known in between is never nothing, and in the end it is what a fresh one knows.
#[test]
fn rounds_end_in_the_same_light() {
    let complete = |illumination: &mut Illumination, world: &World| {
        let never = AtomicBool::new(false);
        let was_known = illumination.known().is_some();
        for _ in 0..100_000 {
            if illumination.stage() == Stage::Complete {
                return;
            }
            illumination.step(world, &never);
            assert!(!was_known || illumination.known().is_some());
        }
        panic!("no end of it");
    };
    let settings = settings(30_000, 5);
    let world = world_of(samples::cornell_box().unwrap());
    let mut kept = Illumination::new(settings);
    complete(&mut kept, &world);
    let small = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.02),
        DQuat::IDENTITY,
        DVec3::new(0.8, 0.2, 0.8),
    );
    type Change = Box<dyn Fn(&mut SceneBuilder)>;
    let edits: [(&str, Change); 2] = [
        ("small", Box::new(move |builder| builder.set_transform("mirror block", small).unwrap())),
        (
            "large",
            Box::new(|builder| {
                let lamp = Material::emitter(Rgb::new(3.0, 5.0, 9.0));
                builder.set_material(id("lamp".into()), lamp).unwrap();
            }),
        ),
    ];
    let mut world = world;
    for (name, edit) in edits {
        let (next, change) = edited(&world, edit);
        kept.apply(&Edit { before: &world, after: &next, change: &change });
        world = next;
        let counts = kept.edit_counts();
        assert_eq!(name == "large", counts.traced > counts.paths / 5, "{name}: {counts:?}");
        complete(&mut kept, &world);
        let mut fresh = Illumination::new(settings);
        complete(&mut fresh, &world);
        let same = fresh.octree().octree().unwrap().holds_the_same(kept.octree().octree().unwrap());
        assert!(same, "after a {name} edit");
    }
}

/// Without time for more than a first answer that is all there is, and with it the rounds are those without a bound.
#[test]
fn rounds_keep_to_the_time_there_is() {
    let world = world_of(samples::cornell_box().unwrap());
    let never = AtomicBool::new(false);
    let emitted_in = |seconds: Option<f64>| {
        let mut illumination = Illumination::new(settings(30_000, 5));
        let (mut foreseen, mut steps) = (0, 0);
        while illumination.stage() != Stage::Complete {
            steps += 1;
            assert!(steps < 100_000, "no end of it");
            seconds.into_iter().for_each(|seconds| illumination.allow(seconds, seconds));
            illumination.step(&world, &never);
            let left = illumination.seconds_left_of_round();
            assert!(left.is_none_or(|left| left.is_finite() && left >= 0.0), "{left:?}");
            foreseen += u32::from(left.is_some());
        }
        assert!(illumination.known().is_some());
        (illumination.report().photons_emitted, foreseen > 0)
    };
    let (all, is_foreseen) = emitted_in(None);
    assert!(is_foreseen);
    assert_eq!(emitted_in(Some(1e6)).0, all);
    let (few, is_foreseen) = emitted_in(Some(0.0));
    assert!(!is_foreseen && few * 8 < all, "{few} of {all}");
}

/// Where no round has room but the smallest, that one is made.
#[test]
fn the_smallest_round_may_take_longer() {
    let world = world_of(samples::cornell_box().unwrap());
    let emitted_in = |seconds: [f64; 2]| {
        let mut illumination = Illumination::to_gather_from(settings(64_000, 5));
        while illumination.stage() != Stage::Complete {
            illumination.allow(seconds[0], seconds[1]);
            illumination.step(&world, &AtomicBool::new(false));
        }
        illumination.report().photons_emitted
    };
    let [none, smallest, all] = [[0.0, 0.0], [0.0, 1e6], [1e6, 1e6]].map(emitted_in);
    // Of 1/32, 1/16 and 1/4 of all.
    assert!(none < smallest && 3 * smallest < all, "{none}, {smallest}, {all}");
}

/// Whatever was left out to end in time, rounds cut short, not begun or made smaller, is made up for once there is time: the end is what is
/// known where there was time from the start.
#[test]
fn what_was_cut_is_made_up_for() {
    let world = world_of(samples::cornell_box().unwrap());
    let never = AtomicBool::new(false);
    let of: [fn(IlluminationSettings) -> Illumination; 2] = [Illumination::new, Illumination::to_gather_from];
    for (of, is_last) in of.into_iter().zip([2, 1]) {
        let begin = || of(settings(32_000, 4));
        let complete = |illumination: &mut Illumination, allowed: Option<[f64; 2]>| {
            for _ in 0..100_000 {
                if illumination.stage() == Stage::Complete {
                    return illumination.octree().octree().cloned();
                }
                allowed.into_iter().for_each(|[seconds, smallest]| illumination.allow(seconds, smallest));
                illumination.step(&world, &never);
            }
            panic!("no end of it");
        };
        let whole = complete(&mut begin(), None).unwrap();
        let is_whole =
            |cut: &mut Illumination| complete(cut, None).is_some_and(|octree| octree.holds_the_same(&whole));
        let mut seen = 0;
        let mut goes_on = |mut cut: Illumination, how: &str| {
            assert!(!is_whole(&mut cut), "{how}: nothing is left out");
            cut.take_its_time();
            assert!(is_whole(&mut cut), "{how}, rounds to {is_last}");
            seen += 1;
        };
        for allowed in [[0.0, 0.0], [0.0, 1e6]] {
            let mut cut = begin();
            complete(&mut cut, Some(allowed));
            goes_on(cut, "not begun, or smaller");
        }
        // In the middle of a round, of photons as of octrees.
        let mut all = begin();
        let steps = (1..).take_while(|_| {
            all.step(&world, &never);
            all.stage() != Stage::Complete
        });
        let steps = steps.count();
        for tenth in 1..10 {
            let mut cut = begin();
            (0..steps * tenth / 10).for_each(|_| {
                cut.step(&world, &never);
            });
            cut.abandon_round();
            // Before anything is known it goes on.
            if cut.is_cut() {
                goes_on(cut, "abandoned");
            }
        }
        assert!(seen > 4, "{seen}");
    }
}

/// Whoever learns on after others, in whatever time these had, has in the end what he would have learnt by himself: after edits too, which
/// times of before have no say in.
#[test]
fn who_goes_on_after_others_learns_as_much() {
    // Enough for a step of learning, and for no second round.
    const SHORT: Option<Duration> = Some(Duration::from_millis(30));
    const LONG: Option<Duration> = Some(Duration::from_secs(100_000));
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let size = PictureSize::new(4, 4).unwrap();
    let view = world.scene().camera_view(None).unwrap();
    let plan = EffectPlan::of(world.scene());
    // A picture that is drawn to the end of learning, or has a few passes.
    let draw = |world: &Arc<World>, learner: Option<Learner>, time: Option<Duration>, to_the_end: bool| {
        let until = time.map(|time| Instant::now() + time);
        let learning = Learning::Alongside { until };
        // Without path tracing, which draws so small a picture better than what is learnt and takes its share of the time.
        let of = RenderSettings { indirect: Indirect::Irradiance, learning, ..RenderSettings::default() };
        let mut rendering = match learner {
            Some(learner) => {
                Rendering::learning_on((Arc::clone(world), &plan), (learner, 0), (view, size), of)
            }
            None => Rendering::learning_by((Arc::clone(world), settings(16_000, 3)), view, size, of),
        };
        for _ in 0..100_000 {
            if rendering.passes() >= 3 && (!to_the_end || rendering.knows_its_light()) {
                return rendering.give_learner().unwrap();
            }
            rendering.step(&AtomicBool::new(false));
        }
        panic!("no end of it");
    };
    let octree_of = |learner: &Learner| learner.illumination().unwrap().octree().octree().unwrap().clone();
    let (edited, change) = edited(&world, |builder| {
        let lamp = Material::emitter(Rgb::new(3.0, 5.0, 9.0));
        builder.set_material(id("lamp".into()), lamp).unwrap();
    });
    let edited = Arc::new(edited);
    let fresh = [&world, &edited].map(|world| octree_of(&draw(world, None, None, true)));
    for before in [&[SHORT][..], &[None], &[None, SHORT], &[SHORT, SHORT], &[LONG, SHORT]] {
        for last in [None, LONG] {
            for is_first_whole in [false, true] {
                if is_first_whole && before[0] == SHORT {
                    continue;
                }
                let mut learner = None;
                for (number, time) in before.iter().enumerate() {
                    learner = Some(draw(&world, learner, *time, is_first_whole && number == 0));
                }
                let mut learner = draw(&world, learner, last, true);
                let how = format!("{before:?}, then {last:?}, {is_first_whole}");
                assert!(octree_of(&learner).holds_the_same(&fresh[0]), "{how}");
                assert!(learner.knows_light_of_now(), "{how}");
                if last.is_some() {
                    continue;
                }
                // Whoever comes then, and edits.
                learner = draw(&world, Some(learner), SHORT, false);
                learner.go_on_for(Learning::Alongside { until: None });
                learner.apply(&Edit { before: &world, after: &edited, change: &change });
                let learner = draw(&edited, Some(learner), None, true);
                assert!(octree_of(&learner).holds_the_same(&fresh[1]), "{how}, edited");
            }
        }
    }
}

/// Pictures that learn with one learner in turn show whatever became known in the turns of others, but for those whose time is over: these
/// keep the samples that they have of what was known then. And what is begun ends in the time of the last.
#[test]
fn pictures_learn_in_turn() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let plan = EffectPlan::of(world.scene());
    let seen = (world.scene().camera_view(None).unwrap(), PictureSize::new(4, 4).unwrap());
    let now = Instant::now();
    let [over, later] = [now, now + Duration::from_secs(100_000)];
    // Without path tracing, as above.
    let settings = |until| RenderSettings {
        indirect: Indirect::Irradiance,
        learning: Learning::Alongside { until: Some(until) },
        ..RenderSettings::default()
    };
    let learner = Learner::new(Learnt::Records, &settings(later), self::settings(16_000, 3));
    let mut first = Rendering::learning_on((world.clone(), &plan), (learner, 1), seen, settings(over));
    first.learn_beside(Some(later));
    let never = AtomicBool::new(false);
    for _ in 0..100_000 {
        if first.passes() >= 3 {
            break;
        }
        first.step(&never);
    }
    let shown = |rendering: &Rendering| rendering.technique.secondary().cloned();
    let shown_by_first = shown(&first).unwrap();
    let mut second =
        Rendering::learning_with((world, &plan), (first.lend_learner().unwrap(), 2), seen, settings(later));
    assert!(second.known().is_some_and(|known| Arc::ptr_eq(known, &shown_by_first)));
    for _ in 0..100_000 {
        if second.knows_its_light() {
            break;
        }
        second.step(&never);
    }
    assert!(second.knows_its_light() && second.records().count > 0);
    let shown_by_second = shown(&second).unwrap();
    assert!(!Arc::ptr_eq(&shown_by_first, &shown_by_second));
    let passes = first.passes();
    first.go_on_with(second.lend_learner().unwrap());
    assert!(Arc::ptr_eq(&shown(&first).unwrap(), &shown_by_first) && first.passes() == passes);
    let third = settings(later);
    let mut third =
        Rendering::with((first.world.clone(), &plan), seen.0, seen.1, third, Some(shown_by_first));
    third.go_on_with(first.lend_learner().unwrap());
    assert!(Arc::ptr_eq(&shown(&third).unwrap(), &shown_by_second));
}

/// A box under a point light, or around it: above, most photons leave; within, hardly any.
fn box_under_lamp(height_m: f64, albedo: f32) -> World {
    let mut stage = Building::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(albedo))).unwrap();
    let walls = samples::cuboid(DVec3::new(-1.0, 0.0, -1.0), DVec3::ONE, &white);
    stage.place("box", walls, DAffine3::IDENTITY).unwrap();
    let (position, kind) = (height_m * DVec3::Y, LightKind::Point { intensity: Rgb::WHITE });
    stage.light("lamp", Light { parent: None, position, direction: DVec3::NEG_Y, kind }).unwrap();
    // Something that light from the box falls on.
    let floor = samples::cuboid(DVec3::new(-3.0, -0.1, -3.0), DVec3::new(3.0, 0.0, 3.0), &white);
    stage.place("floor", floor, DAffine3::IDENTITY).unwrap();
    world_of(stage.finish())
}

/// The first round sends out four times as many photons where hardly any stay, no more where most do, and no more where none does; an
/// edit that changes which it is, either way, has it decided again.
#[test]
fn the_first_round_takes_more_photons_where_few_stay() {
    const ASKED_FOR: u32 = 640_000;
    let never = AtomicBool::new(false);
    let until_known = |illumination: &mut Illumination, world: &World| {
        let generation = illumination.generation();
        for _ in 0..100_000 {
            if illumination.generation() != generation {
                let sent = illumination.photons().paths().full_count() as f64;
                return (sent / f64::from(ASKED_FOR / 32)).round();
            }
            illumination.step(world, &never);
        }
        panic!("no end of it");
    };
    let worlds = [box_under_lamp(3.0, 0.5), box_under_lamp(0.5, 0.5)];
    for from in [0, 1] {
        let [before, after] = [&worlds[from], &worlds[1 - from]];
        let mut illumination = Illumination::new(settings(ASKED_FOR, 5));
        assert_eq!(until_known(&mut illumination, before), [4.0, 1.0][from]);
        let lights = [id("lamp".into())].into_iter().collect();
        let change = SceneChange { lights, ..SceneChange::default() };
        illumination.apply(&Edit { before, after, change: &change });
        assert_eq!(until_known(&mut illumination, after), [1.0, 4.0][from]);
    }
    assert_eq!(until_known(&mut Illumination::new(settings(ASKED_FOR, 5)), &box_under_lamp(3.0, 0.0)), 1.0);
}

/// Whenever an edit comes in the first round, before or after it has decided how many photons it takes, the end is a fresh build.
#[test]
fn an_edit_in_the_first_round_leaves_a_fresh_build() {
    let never = AtomicBool::new(false);
    let settings = settings(160_000, 4);
    let start = box_under_lamp(3.0, 0.5);
    let aside = DAffine3::from_translation(DVec3::new(0.3, 0.0, 0.0));
    let (end, change) = edited(&start, |builder| builder.set_transform("box", aside).unwrap());
    let complete = |illumination: &mut Illumination| {
        for _ in 0..100_000 {
            if illumination.stage() == Stage::Complete {
                return illumination.octree().octree().unwrap().clone();
            }
            illumination.step(&end, &never);
        }
        panic!("no end of it");
    };
    let fresh = complete(&mut Illumination::new(settings));
    let mut steps = 0;
    loop {
        let mut edited = Illumination::new(settings);
        (0..steps).for_each(|_| {
            edited.step(&start, &never);
        });
        let is_over = edited.known().is_some();
        edited.apply(&Edit { before: &start, after: &end, change: &change });
        assert!(complete(&mut edited).holds_the_same(&fresh), "edited after {steps} steps");
        if is_over {
            break;
        }
        steps += 1;
    }
    assert!(steps > 3, "nothing in between: {steps}");
}

/// The octrees of the next round are as many as foreseen, of about as many cells.
#[test]
fn octrees_are_foreseen() {
    for scene in [samples::cornell_box(), samples::boxes(), samples::parted_rooms([1.0, 2.0])] {
        let world = world_of(scene.unwrap());
        let coarse = Caches::complete(settings(20_000, 4), &world);
        let of_next = OctreeSettings { depth_first: 5, ..settings(200_000, 7).octree };
        let foreseen = coarse.octree.octree().unwrap().cells_by(&of_next);
        let mut fine = Caches::new(IlluminationSettings { octree: of_next, ..settings(200_000, 7) });
        let mut made: Vec<f64> = Vec::new();
        while !fine.is_complete() {
            fine.step(&world);
            made.extend(fine.octree.octree().map(|octree| octree.leaf_count() as f64));
            made.dedup();
        }
        assert_eq!(made.len(), foreseen.len(), "{made:?} for {foreseen:?}");
        for (made, foreseen) in made.iter().zip(&foreseen) {
            assert!((0.5..2.0).contains(&(made / foreseen)), "{made} for {foreseen}");
        }
    }
}

/// Light of before is told from light of now by how much otherwise any one edit made the lights shine, however many there were of less; and
/// where all have changed alike it is shown as much brighter or darker, which is right.
#[test]
fn light_of_before_counts_as_long_as_lights_shine_about_the_same() {
    let start = Arc::new(box_under_lamp(0.5, 0.5));
    let never = AtomicBool::new(false);
    let rendering = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let mut learner = Learner::new(Learnt::Octree, &rendering, settings(20_000, 5));
    let until_known = |learner: &mut Learner, world: &World| {
        let generation = learner.generation();
        for _ in 0..100_000 {
            if learner.generation() != generation {
                break;
            }
            learner.step(world, &never);
        }
        assert!(!learner.knows_other_lights() && learner.generation() != generation);
        let [known, now] = [learner.known().unwrap(), &learner.known_by_now().unwrap()];
        assert!(Arc::ptr_eq(known, now), "nothing to dim");
    };
    let mut world = start.clone();
    let mut lamp = |learner: &mut Learner, aside_m: f64, intensity: Rgb| {
        let (position, kind) = (DVec3::new(aside_m, 0.5, 0.0), LightKind::Point { intensity });
        let light = Light { parent: None, position, direction: DVec3::NEG_Y, kind };
        let (next, change) = edited(&world, |builder| builder.set_light("lamp", light.clone()).unwrap());
        learner.apply(&Edit { before: &world, after: &next, change: &change });
        world = Arc::new(next);
        assert!(learner.known().is_some());
        (learner.knows_other_lights(), world.clone())
    };
    until_known(&mut learner, &start);
    // Dimmed as much as anybody likes, step by step and to black, it is the same light.
    let down = Ray::new(Vec3::new(0.4, 0.6, 0.4), Vec3::NEG_Y);
    let surface = start.surface(&start.closest_hit(&down).unwrap(), down.direction);
    let lit = |learner: &Learner| learner.known_by_now().unwrap().scattered(&surface, Vec3::Y, None).indirect;
    let (bright, dim) = (lit(&learner), Rgb::new(0.5, 0.25, 0.01));
    assert!((0..3).all(|k| bright[k] > 0.0), "{bright:?}");
    for times in [dim, dim * dim] {
        assert!(!lamp(&mut learner, 0.0, times).0);
        let (is, should) = (lit(&learner), bright * times);
        (0..3).for_each(|k| assert!((is[k] / should[k] - 1.0).abs() < 1e-2, "{is:?} for {should:?}"));
    }
    let (is_other, _) = lamp(&mut learner, 0.0, Rgb::BLACK);
    assert!(!is_other);
    assert_eq!(lit(&learner), Rgb::BLACK);
    // On again before that is known, it is other light, and shown as it was.
    assert!(lamp(&mut learner, 0.0, Rgb::WHITE).0);
    assert_eq!(lit(&learner), bright);
    let (_, black_again) = lamp(&mut learner, 0.0, Rgb::BLACK);
    until_known(&mut learner, &black_again);
    // Out of black it is other light.
    let (is_other, now) = lamp(&mut learner, 0.0, Rgb::WHITE);
    assert!(is_other);
    until_known(&mut learner, &now);
    // A little aside each time, to and fro, and then out of the room.
    let mut last = now;
    let mut share = 0.0;
    for aside_m in [0.1, 0.2, 0.3, 0.2, 0.1, 0.0, -0.1, -0.2, -0.3, -0.2, -0.1, 0.0] {
        let (is_other, next) = lamp(&mut learner, aside_m, Rgb::WHITE);
        assert!(!is_other);
        share += change_of_lights(&last, &next).share;
        last = next;
    }
    assert!(share > 1.0, "{share}: nothing that would ever add up");
    assert!(lamp(&mut learner, 20.0, Rgb::WHITE).0);
    assert!(lamp(&mut learner, 20.1, Rgb::WHITE).0, "until it is known");
}

/// An edit between two rounds leaves nothing of the scene before: neither light nor how many photons are sent out.
#[test]
fn an_edit_between_rounds_leaves_a_fresh_build() {
    let never = AtomicBool::new(false);
    let settings = settings(30_000, 5);
    let world = world_of(samples::cornell_box().unwrap());
    let mut kept = Illumination::new(settings);
    // The step that makes the first octree ends the first round.
    while kept.known().is_none() {
        kept.step(&world, &never);
    }
    let (next, change) = edited(&world, |builder| {
        builder.set_material(id("white".into()), Material::lambert(Rgb::new(0.98, 0.98, 0.98))).unwrap();
    });
    kept.apply(&Edit { before: &world, after: &next, change: &change });
    let mut fresh = Illumination::new(settings);
    for illumination in [&mut kept, &mut fresh] {
        for _ in 0..100_000 {
            illumination.step(&next, &never);
        }
        assert_eq!(illumination.stage(), Stage::Complete);
    }
    assert!(fresh.octree().octree().unwrap().holds_the_same(kept.octree().octree().unwrap()));
}
