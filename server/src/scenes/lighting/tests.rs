//! Laws of what is kept of a scene's light, and for whom.

use super::*;
use crate::config::Config;
use glam::{DAffine3, DVec3};
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::{Id, Material, Scene, SceneBuilder, SceneLimits, samples};

fn change_of(name: &str) -> SceneChange {
    SceneChange { lights: [Id::new(name).unwrap()].into_iter().collect(), ..SceneChange::default() }
}

/// Changes are taken once, up to the revision asked for, and none is lost when more wait than are kept apart.
#[test]
fn changes_are_taken_once_and_never_lost() {
    let mut changes = LightChanges::default();
    changes.push(2, change_of("a"));
    changes.push(3, SceneChange::default());
    changes.push(4, change_of("b"));
    assert_eq!(changes.take_until(3).lights.len(), 1);
    assert_eq!(changes.take_until(4).lights.len(), 1);
    assert!(changes.take_until(9).leaves_light_alone());
    for revision in 10..300 {
        changes.push(revision, change_of(&format!("light {revision}")));
    }
    assert!(changes.waiting.len() <= WAITING_MAX);
    // In the middle of what was joined: all that led there, and perhaps more.
    assert!(changes.take_until(200).lights.len() >= 191);
    assert!(changes.take_until(299).lights.len() >= 99);
    assert!(changes.take_until(300).leaves_light_alone());
}

/// Whoever edits without a pause, faster than any edit can be followed, sees the light follow none the less, and in the end that of
/// the last edit; what the edits that wait change of the lights counts at once.
#[test]
fn light_follows_edits_that_do_not_end() {
    let workshop = Workshop::open(Config { photons: 64_000, ..Config::default() }).unwrap();
    let mut world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
    let key = LightKey { learnt: Learnt::Octree, bounces_max: None };
    let mut lit = Lit::begin(key, &world, 0.0, &workshop);
    let never = AtomicBool::new(false);
    let step = |lit: &mut Lit| workshop.drawing_pool.install(|| lit.learner.step(&lit.world, &never));
    while !lit.is_complete() {
        step(&mut lit);
    }
    let edited = |world: &Arc<World>, strength: f32| {
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        let lamp = Material::emitter(Rgb::splat(strength));
        builder.set_material(Id::new("lamp").unwrap(), lamp).unwrap();
        let (scene, change) = builder.finish();
        (Arc::new(world.update(Arc::new(scene), &change)), change)
    };
    let (epoch, mut steps) = (lit.learner.epoch(), 0);
    while lit.learner.epoch() < epoch + 4 {
        steps += 1;
        assert!(steps < 5_000, "light of before for ever");
        let (next, change) = edited(&world, 10.0 + (steps % 2) as f32);
        world = next;
        lit.follow_edit(&world, &change, &workshop);
        assert!(!lit.is_complete());
        step(&mut lit);
    }
    // It is at an edit before: not behind by much, until one comes that changes much.
    let (next, change) = edited(&world, 10.4);
    world = next;
    lit.follow_edit(&world, &change, &workshop);
    step(&mut lit);
    assert!(!lit.learner.knows_other_lights() && lit.learner.is_catching_up());
    let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    builder.set_material(Id::new("red").unwrap(), Material::emitter(Rgb::WHITE)).unwrap();
    let (scene, change) = builder.finish();
    let next = Arc::new(world.update(Arc::new(scene), &change));
    lit.follow_edit(&next, &change, &workshop);
    assert!(lit.learner.knows_other_lights() && !Arc::ptr_eq(&lit.world, &next));
    // Pictures do without it, whatever technique they are by.
    assert!(lit.learner.known_by_now().is_some() && lit.known().is_none());
    let until_complete = |lit: &mut Lit, world: &Arc<World>| {
        for _ in 0..100_000 {
            if lit.is_complete() {
                return;
            }
            step(lit);
            lit.follow_edit(world, &SceneChange::default(), &workshop);
        }
        panic!("no end of it");
    };
    until_complete(&mut lit, &next);
    assert!(Arc::ptr_eq(&lit.world, &next) && !lit.learner.knows_other_lights() && lit.known().is_some());
    // What is dragged is followed by known light, however far it has come by then; what jumps as far is not.
    let turned = |world: &Arc<World>, blue: f32| {
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        let lamp = Material::emitter(Rgb::new(10.8, 10.8, 10.8 * blue));
        builder.set_material(Id::new("lamp").unwrap(), lamp).unwrap();
        let (scene, change) = builder.finish();
        (Arc::new(world.update(Arc::new(scene), &change)), change)
    };
    let (mut next, change) = turned(&next, 0.9);
    lit.follow_edit(&next, &change, &workshop);
    for blue in [0.5, 0.25, 0.125, 0.0625] {
        let (later, change) = turned(&next, blue);
        lit.follow_edit(&later, &change, &workshop);
        assert!(!Arc::ptr_eq(&lit.world, &later) && lit.known().is_some(), "{blue}");
        next = later;
    }
    // Whatever came between, what is as it was is lit as it was.
    for (blue, is_known) in [(1.0, true), (0.02, false), (0.9, true), (0.02, false)] {
        let (later, change) = turned(&next, blue);
        lit.follow_edit(&later, &change, &workshop);
        assert!(!Arc::ptr_eq(&lit.world, &later));
        assert_eq!(lit.known().is_some(), is_known, "{blue}");
        next = later;
    }
    until_complete(&mut lit, &next);
    // Around another origin nothing waits.
    let (first, change) = edited(&next, 10.4);
    lit.follow_edit(&first, &change, &workshop);
    assert!(lit.learner.is_catching_up());
    let mut builder = SceneBuilder::from_scene(first.scene(), SceneLimits::default());
    let far = DAffine3::from_translation(DVec3::splat(1e6));
    builder.set_transform("glass ball", far).unwrap();
    let (scene, change) = builder.finish();
    let second = Arc::new(first.update(Arc::new(scene), &change));
    assert_ne!(first.accel().origin_in_world(), second.accel().origin_in_world());
    lit.follow_edit(&second, &change, &workshop);
    assert!(Arc::ptr_eq(&lit.world, &second));
    until_complete(&mut lit, &second);
}

/// What somebody learnt for himself alone is kept as if he had looked with it where it is better than what is there, and given to who looks
/// and knows nothing yet; who looks and knows anything keeps that.
#[test]
fn what_others_learnt_is_kept_for_others() {
    let workshop = Arc::new(Workshop::open(Config { photons: 64_000, ..Config::default() }).unwrap());
    let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
    let key = LightKey { learnt: Learnt::Octree, bounces_max: None };
    let learnt = || {
        let mut lit = Lit::begin(key, &world, 0.0, &workshop);
        while !lit.learner.knows_light_of_now() {
            workshop.drawing_pool.install(|| lit.learner.step(&world, &AtomicBool::new(false)));
        }
        (lit.learner, world.clone())
    };
    let mut lighting = Lighting::default();
    assert!(lighting.take_over(key, (learner_of(key, &workshop), world.clone()), &workshop).is_some());
    assert!(lighting.lit.is_empty() && lighting.expires_at().is_none());
    assert!(lighting.take_over(key, learnt(), &workshop).is_none());
    assert!(lighting.generation(key) > 0);
    assert!(lighting.expires_at().is_some_and(|at| at > Instant::now()));
    let first = lighting.known(key).unwrap();
    assert!(lighting.take_over(key, learnt(), &workshop).is_some(), "no better");
    assert!(Arc::ptr_eq(&first, &lighting.known(key).unwrap()));
    // Nobody gets it whose light is another, nor while somebody looks with it.
    assert!(lighting.hand_over(LightKey { bounces_max: Some(3), ..key }, &workshop).is_none());
    let left = lighting.lit.get_mut(&key).unwrap().left.take();
    assert!(left.is_some() && lighting.hand_over(key, &workshop).is_none());
    let kept = lighting.lit.get_mut(&key).unwrap();
    (kept.left, kept.ahead) = (left, change_of("lamp"));
    assert!(lighting.hand_over(key, &workshop).is_none(), "an edit is yet to be followed");
    lighting.lit.get_mut(&key).unwrap().ahead = SceneChange::default();
    lighting.lit.get_mut(&key).unwrap().learner.set_accuracy(0.9);
    let handed = lighting.hand_over(key, &workshop).unwrap();
    assert!(handed.known().is_some_and(|known| Arc::ptr_eq(known, &first)) && lighting.lit.is_empty());
    assert_eq!(handed.accuracy(), learner_of(key, &workshop).accuracy());
    // Whoever looks and knows nothing yet goes on with it; whoever knows anything goes on with that, after an edit too.
    let mut lit = Lit::begin(key, &world, 0.0, &workshop);
    lighting.lit.insert(key, lit);
    assert!(
        lighting.take_over(key, (handed, world.clone()), &workshop).is_some_and(|of| of.known().is_none())
    );
    let lit_now = &lighting.lit[&key];
    assert!(lit_now.left.is_none() && lit_now.knows_light_of_now());
    let generation = lighting.generation(key);
    let (mut better, _) = learnt();
    while better.stage() != Stage::Complete {
        workshop.drawing_pool.install(|| better.step(&world, &AtomicBool::new(false)));
    }
    let refused = lighting.take_over(key, (better, world.clone()), &workshop).unwrap();
    assert!(refused.stage() == Stage::Complete && lighting.generation(key) == generation);
    lighting.lit.get_mut(&key).unwrap().ahead = change_of("lamp");
    let better = lighting.take_over(key, (refused, world.clone()), &workshop).unwrap();
    assert!(better.stage() == Stage::Complete && lighting.generation(key) == generation);
    // Of what is kept the better stays.
    let looked_with = lighting.lit.get_mut(&key).unwrap();
    (looked_with.ahead, looked_with.left) = (SceneChange::default(), Some(Instant::now()));
    let rough = lighting.take_over(key, (better, world.clone()), &workshop).unwrap();
    assert!(lighting.lit[&key].is_complete() && lighting.generation(key) > generation);
    assert!(
        lighting
            .take_over(key, (rough, world.clone()), &workshop)
            .is_some_and(|of| of.stage() != Stage::Complete)
    );
    // What is kept and of before an edit is no better than nothing.
    lit = Lit {
        left: Some(Instant::now()),
        ahead: change_of("lamp"),
        ..Lit::begin(key, &world, 0.0, &workshop)
    };
    lit.learner = learnt().0;
    lighting.lit.insert(key, lit);
    assert!(lighting.take_over(key, learnt(), &workshop).is_some());
    assert!(lighting.lit[&key].knows_light_of_now());
    // An edit is not followed at all where nobody looks.
    let (none, now) = (HashMap::new(), Instant::now());
    lighting.retain(&none, &change_of("lamp"), (now, Duration::from_secs(60)));
    assert!(lighting.lit.is_empty() && lighting.expires_at().is_none());
}

/// What nobody looks with is kept for a while, the last of it alone, through edits that leave the light as it is, and is wanted again
/// as it was, behind those who stayed; who looks keeps his whatever happens.
#[test]
fn light_is_kept_for_a_while() {
    const KEPT: Duration = Duration::from_secs(60);
    let workshop = Workshop::open(Config::default()).unwrap();
    let world = Arc::new(World::prepare(Arc::new(Scene::default())));
    let keys = [1, 2, 3, 4, 5].map(|bounces| LightKey { learnt: Learnt::Octree, bounces_max: Some(bounces) });
    let looked_at = || {
        let mut lighting = Lighting::default();
        for (key, seconds) in keys.into_iter().zip([100.0, 20.0, 30.0, 40.0, 50.0]) {
            lighting.lit.insert(key, Lit::begin(key, &world, seconds, &workshop));
        }
        lighting
    };
    let wanted = |keys: &[LightKey]| keys.iter().map(|key| (*key, Vec::new())).collect::<HashMap<_, _>>();
    let (none, start) = (SceneChange::default(), Instant::now());
    let second = Duration::from_secs(1);

    let mut lighting = looked_at();
    for (away, moment) in (1..=4).zip([1, 2, 3, 4]) {
        let here = 5 - away;
        lighting.retain(&wanted(&keys[..here]), &none, (start + moment * second, KEPT));
        assert!(keys[..here].iter().all(|key| lighting.lit[key].left.is_none()));
        assert_eq!(lighting.lit.len() - here, KEPT_MAX.min(away));
        assert!(lighting.lit.contains_key(&keys[here]), "the last that was looked with");
    }
    assert_eq!(lighting.expires_at(), Some(start + 3 * second + KEPT));
    lighting.retain(&wanted(&keys[..2]), &none, (start + 5 * second, KEPT));
    assert!(lighting.lit[&keys[1]].left.is_none() && lighting.lit.len() == 3);
    assert_eq!(lighting.lit[&keys[1]].seconds, 100.0, "before those who stayed");
    lighting.retain(&wanted(&keys[..2]), &none, (start + 3 * second + KEPT, KEPT));
    assert_eq!((lighting.lit.len(), lighting.expires_at()), (2, None));

    // All at once, through an edit, and where nothing is kept.
    let mut lighting = looked_at();
    lighting.retain(&wanted(&keys[..1]), &none, (start, KEPT));
    assert_eq!(lighting.lit.len(), 1 + KEPT_MAX);
    lighting.retain(&wanted(&keys[..1]), &change_of("lamp"), (start, KEPT));
    assert_eq!(lighting.lit.len(), 1);
    let mut lighting = looked_at();
    lighting.retain(&wanted(&keys[..1]), &none, (start, Duration::ZERO));
    assert_eq!((lighting.lit.len(), lighting.expires_at()), (1, None));
}

/// What is kept counts in a gauge while it is kept, and no longer; beyond the bound on all scenes together the one that comes last keeps
/// nothing more, and of its own the last that was left.
#[test]
fn kept_light_is_bounded_over_scenes() {
    let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
    let keys = [Some(2), None].map(|bounces_max| LightKey { learnt: Learnt::Octree, bounces_max });
    let learnt = |key: LightKey, workshop: &Arc<Workshop>| {
        let mut lit = Lit::begin(key, &world, 0.0, workshop);
        while !lit.learner.knows_light_of_now() {
            workshop.drawing_pool.install(|| lit.learner.step(&world, &AtomicBool::new(false)));
        }
        (lit.learner, world.clone())
    };
    let opened = |kept_light_bytes| {
        Arc::new(Workshop::open(Config { photons: 64_000, kept_light_bytes, ..Config::default() }).unwrap())
    };
    let one = {
        let workshop = opened(u64::MAX);
        let kept = || workshop.metrics.kept_light_bytes.value();
        let mut lighting = Lighting::default();
        assert!(lighting.take_over(keys[0], learnt(keys[0], &workshop), &workshop).is_none());
        let one = kept();
        assert_eq!(one, lighting.lit[&keys[0]].learner.bytes() as i64);
        assert!(one > 100_000, "{one} bytes of some thousand photons");
        assert!(lighting.take_over(keys[1], learnt(keys[1], &workshop), &workshop).is_none());
        assert!(kept() > one);
        // Whoever goes on with it has it, and who looks with it looks.
        assert!(lighting.hand_over(keys[1], &workshop).is_some() && kept() == one);
        let wanted = HashMap::from([(keys[0], Vec::new())]);
        lighting.retain(&wanted, &SceneChange::default(), (Instant::now(), Duration::from_secs(60)));
        assert!(kept() == 0 && lighting.lit.len() == 1);
        one as u64
    };
    let workshop = opened(one + one / 2);
    let kept = || workshop.metrics.kept_light_bytes.value() as u64;
    let [mut first, mut second] = [Lighting::default(), Lighting::default()];
    assert!(first.take_over(keys[0], learnt(keys[0], &workshop), &workshop).is_none());
    second.take_over(keys[0], learnt(keys[0], &workshop), &workshop);
    assert!(first.lit.len() == 1 && second.lit.is_empty() && second.expires_at().is_none());
    assert!(kept() <= one + one / 2);
    // Its own older light makes room.
    first.take_over(keys[1], learnt(keys[1], &workshop), &workshop);
    assert!(first.lit.len() == 1 && first.lit.contains_key(&keys[1]) && first.expires_at().is_some());
    drop(first);
    assert_eq!(kept(), 0);
}
