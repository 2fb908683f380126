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
    assert!(edits < steps / 2, "none waited: {edits} edits in {steps} steps");
}
