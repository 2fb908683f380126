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

/// Balls in a square of 16 × 16, and the same scene with `count` of them, but none at a corner, in each other's places: the
/// bounds stay, the old tree's boxes grow.
fn ordered_and_shuffled(count: usize) -> (Scene, Scene, SceneChange) {
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
    for _ in 0..count {
        to.swap(1 + numbers.index(254), 1 + numbers.index(254));
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

/// The least shuffling that wears the tree, but not out.
fn worn() -> (Accel, Scene, Scene, SceneChange) {
    (1..200)
        .find_map(|count| {
            let (ordered, shuffled, change) = ordered_and_shuffled(count);
            let worn = Accel::build(&ordered).updated(&shuffled, &change);
            let is_worn = (1.3..2.0).contains(&worn.report().top_growth);
            is_worn.then_some((worn, ordered, shuffled, change))
        })
        .expect("some shuffling wears a tree")
}

fn wait_until_restored(accel: &Accel) {
    let start = Instant::now();
    while !accel.top.is_restored() {
        assert!(start.elapsed() < PATIENCE, "the worn tree was not restored");
        std::thread::yield_now();
    }
}

/// The restored tree costs what a fresh one does, and gives the worn one's answers.
#[test]
fn a_worn_tree_is_restored_and_answers_as_before() {
    let (worn, _, shuffled, _) = worn();
    let rays = rays();
    let before = answers(&worn, &rays);
    wait_until_restored(&worn);
    let hits = before.iter().flatten().count();
    assert!(hits > 300, "balls must be hit to test anything: {hits}");
    assert_eq!(answers(&worn, &rays), before);
    let fresh = Accel::build(&shuffled);
    assert_eq!(answers(&fresh, &rays), before);
    assert_eq!(worn.report().top_sah_cost, fresh.report().top_sah_cost);
}

/// An edit that ruins the tree has it built again at once: edits that come faster than trees are restored cannot make it
/// worse without end.
#[test]
fn a_tree_that_is_worn_out_is_built_at_once() {
    let (ordered, shuffled, change) = ordered_and_shuffled(2000);
    let updated = Accel::build(&ordered).updated(&shuffled, &change);
    assert!(updated.report().top_growth > 2.0, "{}", updated.report().top_growth);
    assert_eq!(updated.report().top_sah_cost, Accel::build(&shuffled).report().top_sah_cost);
}

/// Rays on their way while the better tree takes the old one's place get the same answers as all others.
#[test]
fn rays_on_their_way_do_not_notice() {
    let (_, ordered, shuffled, change) = worn();
    let rays = rays();
    let expected = answers(&Accel::build(&shuffled), &rays);
    let worn = Accel::build(&ordered).updated(&shuffled, &change);
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

/// Edits go on from a restored tree as from any other, and none leaves a ruined one.
#[test]
fn edits_go_on_while_trees_are_restored() {
    let (ordered, shuffled, change) = ordered_and_shuffled(2000);
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
    super::edits::assert_as_built(&accel, &scene, &mut numbers, 300, "the last");
    assert!(
        accel.report().top_growth < 2.0
            || accel.report().top_sah_cost < 2.0 * Accel::build(&scene).report().top_sah_cost
    );
}
