//! A worn tree over instances is restored in the background, and nobody can tell from the answers.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use super::*;
use crate::scene::{Node, SceneBuilder, SceneChange, SceneLimits};

/// Longest wait for a tree of a few hundred instances, which takes milliseconds to build: long enough for a machine
/// that does much else.
const PATIENCE: Duration = Duration::from_secs(60);

/// Balls in a square of 16 × 16, and the same scene with all but those at its corners in each other's places: the
/// bounds stay, the old tree's boxes all grow to the whole.
fn ordered_and_shuffled() -> (Scene, Scene, SceneChange) {
    let mut numbers = Numbers(149);
    let (mut stage, grey) = stage_with_grey();
    let at = |i: usize| DAffine3::from_translation(DVec3::new((i % 16) as f64, (i / 16) as f64, 0.0));
    stage.place("0", samples::sphere(DVec3::ZERO, 0.4, 8, &grey), at(0)).unwrap();
    for i in 1..256 {
        let node = Node { parent: None, parent_from_node: at(i), mesh: Id::new("0") };
        stage.builder().add_node(Id::sanitised(&i.to_string(), "node"), node).unwrap();
    }
    let ordered = stage.finish();
    let mut to: Vec<usize> = (0..256).collect();
    for i in (1..255).rev() {
        to.swap(i, 1 + numbers.index(i));
    }
    let mut builder = SceneBuilder::from_scene(&ordered, SceneLimits::default());
    for (i, to) in to.iter().enumerate() {
        builder.set_transform(&i.to_string(), at(*to)).unwrap();
    }
    let (shuffled, change) = builder.finish();
    (ordered, shuffled, change)
}

fn rays() -> Vec<Ray> {
    let mut numbers = Numbers(151);
    random_rays(&mut numbers, 3000, 9.0)
}

fn answers(accel: &Accel, rays: &[Ray]) -> Vec<Option<Hit>> {
    rays.iter().map(|ray| accel.closest_hit(ray, |_| true)).collect()
}

fn wait_until_restored(accel: &Accel) {
    let start = Instant::now();
    while accel.top.tree().is_worn() {
        assert!(start.elapsed() < PATIENCE, "the worn tree was not restored");
        std::thread::yield_now();
    }
}

/// The pool's only thread makes the edit and asks the worn tree; only then has it time to restore it.
#[test]
fn a_worn_tree_is_restored_and_answers_as_before() {
    let (ordered, shuffled, change) = ordered_and_shuffled();
    let first = Accel::build(&ordered);
    let rays = rays();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (worn, before) = pool.install(|| {
        let worn = first.updated(&shuffled, &change);
        assert!(worn.top.tree().is_worn(), "the edit must wear the tree out to test anything");
        let before = answers(&worn, &rays);
        (worn, before)
    });
    wait_until_restored(&worn);
    let hits = before.iter().flatten().count();
    assert!(hits > 300, "balls must be hit to test anything: {hits}");
    assert_eq!(answers(&worn, &rays), before);
    assert_eq!(answers(&Accel::build(&shuffled), &rays), before);
}

/// Rays on their way while the better tree takes the old one's place get the same answers as all others.
#[test]
fn rays_on_their_way_do_not_notice() {
    let (ordered, shuffled, change) = ordered_and_shuffled();
    let first = Accel::build(&ordered);
    let rays = rays();
    let expected = answers(&Accel::build(&shuffled), &rays);
    let worn = first.updated(&shuffled, &change);
    let is_restored = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                // Once more after the exchange, so that both trees were asked.
                loop {
                    let last = is_restored.load(Ordering::Acquire);
                    assert_eq!(answers(&worn, &rays), expected);
                    if last {
                        break;
                    }
                }
            });
        }
        wait_until_restored(&worn);
        is_restored.store(true, Ordering::Release);
    });
}

/// Of many edits in a row the last one's tree is restored, and edits go on from a restored tree as from any other.
#[test]
fn edits_go_on_while_trees_are_restored() {
    let (ordered, shuffled, change) = ordered_and_shuffled();
    let mut numbers = Numbers(157);
    let mut scene = ordered.clone();
    let mut accel = Accel::build(&scene);
    for round in 0..30 {
        let (next, change) = if round % 10 == 0 {
            (shuffled.clone(), change.clone())
        } else {
            let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
            for _ in 0..8 {
                let id = (1 + numbers.index(254)).to_string();
                let at = DVec3::new(numbers.between(0.0, 15.0), numbers.between(0.0, 15.0), 0.0);
                builder.set_transform(&id, DAffine3::from_translation(at)).unwrap();
            }
            builder.finish()
        };
        accel = accel.updated(&next, &change);
        scene = next;
        if round % 3 == 0 {
            super::edits::assert_as_built(&accel, &scene, &mut numbers, 300, &format!("round {round}"));
        }
    }
    wait_until_restored(&accel);
    super::edits::assert_as_built(&accel, &scene, &mut numbers, 300, "the last restoration");
}
