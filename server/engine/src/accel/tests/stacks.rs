//! The stack that a thread keeps from ray to ray is large enough for every walk and belongs to one at a time.

use super::*;

fn assert_as_the_loop_says(accel: &Accel, rays: &[Ray]) {
    let all = Loop::over(accel);
    for ray in rays {
        let expected = all.closest_hit(ray, |_| true);
        assert_eq!(accel.closest_hit(ray, |_| true), expected, "{ray:?}");
        assert_eq!(accel.is_occluded(ray, |_| true), expected.is_some(), "{ray:?}");
    }
}

/// A thread that has walked a shallow tree gets more room for a deep one, and goes back to the shallow one.
#[test]
fn a_thread_may_walk_deeper_trees_after_shallow_ones() {
    let mut numbers = Numbers(97);
    let shallow = Accel::build(&scene_of(|grey| soup(&mut numbers, 3, 0.5, 0.8, grey)));
    let deep = Accel::build(&piled_up(&mut numbers, 300));
    let need = |accel: &Accel| accel.top.tree().tree().stack_need() + accel.bottom_stack_need;
    assert!(need(&deep) > need(&shallow), "{} and {} entries test nothing", need(&deep), need(&shallow));
    let rays = random_rays(&mut numbers, 100, 0.8);
    // A fresh thread has kept nothing yet.
    std::thread::scope(|scope| {
        scope.spawn(|| [&shallow, &deep, &shallow].map(|accel| assert_as_the_loop_says(accel, &rays)));
    });
}

/// Who is asked whether a hit counts may ask for rays in turn: neither walk disturbs the other.
#[test]
fn walks_within_walks_answer_as_walks_alone() {
    let mut numbers = Numbers(101);
    let accel = Accel::build(&scene_of(|grey| soup(&mut numbers, 500, 1.0, 0.5, grey)));
    let rays = random_rays(&mut numbers, 400, 1.5);
    let accept = |hit: &Hit| !hit.triangle.is_multiple_of(3);
    let answer = |ray: &Ray| (accel.closest_hit(ray, accept), accel.is_occluded(ray, accept));
    let alone: Vec<_> = rays.iter().map(answer).collect();
    for (index, (ray, expected)) in rays.iter().zip(&alone).enumerate() {
        let within = (index + 1) % rays.len();
        let accept_asking = |hit: &Hit| {
            assert_eq!(answer(&rays[within]), alone[within], "within {ray:?}");
            accept(hit)
        };
        let found = (accel.closest_hit(ray, accept_asking), accel.is_occluded(ray, accept_asking));
        assert_eq!(found, *expected, "{ray:?}");
        let mut together = [None; RAYS];
        accel.closest_hits(&[*ray; RAYS], &mut together, accept_asking);
        assert_eq!(together, [expected.0; RAYS], "{ray:?}");
    }
    let hits = alone.iter().filter(|(hit, _)| hit.is_some()).count();
    assert!(hits > 100, "rays must hit to test anything: {hits}");
}
