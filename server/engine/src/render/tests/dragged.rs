//! Laws of light that follows what is dragged: edits that come faster than an octree is made.

use super::*;

/// A box with a small block of mirror in it, 2 cm wide, so far aside.
fn room() -> World {
    let world = world_of(samples::cornell_box().unwrap());
    dragged(&world, 0.0).0
}

fn dragged(world: &World, aside_m: f64) -> (World, SceneChange) {
    let place = DVec3::new(0.8 + aside_m, 0.2, 0.8);
    let at = DAffine3::from_scale_rotation_translation(DVec3::splat(0.02), DQuat::IDENTITY, place);
    edited(world, |builder| builder.set_transform("mirror block", at).unwrap())
}

/// What edits leave alone is taken over from an octree that they left behind, of however many edits it knows nothing: of three it leaves nearly
/// as much as of one, and a fresh build in the end.
#[test]
fn light_is_taken_over_from_before_several_edits() {
    let mut settings = settings(100_000, 5);
    settings.octree.neighbours_min = NonZeroUsize::new(8).unwrap();
    let kept_share = |edits: u32| {
        let mut world = room();
        let mut caches = Caches::complete(settings, &world);
        for number in 1..=edits {
            let (next, change) = dragged(&world, 0.005 * f64::from(number));
            caches.apply(&Edit { before: &world, after: &next, change: &change });
            world = next;
            // Maps are made, and of the octree a part.
            let generation = caches.photons.product().generation;
            while caches.photons.product().generation == generation {
                caches.step(&world);
            }
            caches.step(&world);
            assert!(!caches.is_complete());
        }
        caches.step_until_complete(&world);
        let fresh = Caches::complete(settings, &World::prepare(world.scene().clone()));
        assert_same(&caches, &fresh, &format!("{edits} edits"));
        let octree = caches.octree.octree().unwrap();
        assert_eq!(octree.depth(), 5);
        let counts = octree.counts();
        counts.kept as f64 / (counts.kept + counts.gathered) as f64
    };
    let [one, three] = [1, 3].map(kept_share);
    assert!(three > 0.8 * one && one > 0.3, "{one} of it after one edit, {three} after three");
}

/// Who drags something small sees its light follow, though the next edit is there before the octree of the one before is made: each waits for
/// it, but for no more than that.
#[test]
fn light_follows_what_is_dragged() {
    let rendering = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let never = AtomicBool::new(false);
    let mut learner = Learner::new(Learnt::Octree, &rendering, settings(60_000, 5));
    let mut world = room();
    while learner.stage() != Stage::Complete {
        learner.step(&world, &never);
    }
    let (epoch, mut edits, mut steps) = (learner.epoch(), 0, 0);
    while learner.epoch() < epoch + 5 {
        assert!(steps < 2_000, "light of before for ever: {edits} edits");
        if !learner.is_catching_up() {
            edits += 1;
            let (next, change) = dragged(&world, 0.002 * f64::from(edits % 20));
            learner.apply(&Edit { before: &world, after: &next, change: &change });
            world = next;
            assert!(!learner.illumination().unwrap().is_in_first_round() && !learner.knows_light_of_now());
        }
        learner.step(&world, &never);
        steps += 1;
    }
    // Edits that come while photons are traced are followed together.
    assert!(edits < steps / 2, "{edits} edits in {steps} steps");
}
