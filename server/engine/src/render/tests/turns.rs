//! Who draws next where light is looked up and path-traced beside each other.

use std::time::{Duration, Instant};

use super::*;
use crate::{
    film::Outdated,
    render::chain::{Outlook, Turn},
};

/// The built-in box by the best there is, with four passes at least.
fn box_drawn(learning: Learning) -> Rendering {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let settings = RenderSettings { indirect: Indirect::Auto, learning, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world, view, PictureSize::new(16, 16).unwrap(), settings);
    while rendering.film.passes_min() < 4 {
        rendering.step(&AtomicBool::new(false));
    }
    rendering
}

/// However much better path tracing was, light that is better known is drawn with before it goes on: a pass of it that was under way finds the
/// film as it was.
#[test]
fn light_that_is_better_known_is_drawn_with() {
    let mut rendering = box_drawn(Learning::First);
    let never = AtomicBool::new(false);
    assert!(rendering.knows_its_light());
    let better_traced = Some(Outlook::after_64_passes(1e-9, 10.0, 1e-3));
    rendering.outlook = better_traced;
    assert_eq!(rendering.turn(), Turn::Traced);
    let known = rendering.known().cloned();
    rendering.relight(known, Outdated::Rough);
    for _ in 0..2 {
        rendering.outlook = better_traced;
        assert_eq!(rendering.turn(), Turn::LookedUp);
        let passes = rendering.film.passes_min();
        while rendering.film.passes_min() == passes {
            rendering.step(&never);
        }
    }
    rendering.outlook = better_traced;
    assert_eq!(rendering.turn(), Turn::Traced);
}

/// What learning may still take off counts from when records began: known from the first measure of them until they are done.
#[test]
fn records_are_learnt_since_they_began() {
    let mut rendering = box_drawn(Learning::InStep);
    let never = AtomicBool::new(false);
    let mut since = None;
    while !rendering.knows_its_light() {
        let spent = rendering.spent_rays();
        rendering.step(&never);
        match (since, rendering.records_since) {
            (None, Some(now)) => assert!((spent..=rendering.spent_rays()).contains(&now), "{spent} {now}"),
            (before, now) => assert_eq!(before, now.or(before.filter(|_| rendering.knows_its_light()))),
        }
        since = rendering.records_since.or(since);
    }
    assert!(since.is_some());
    let passes = rendering.passes();
    while rendering.passes() == passes {
        rendering.step(&never);
    }
    assert_eq!(rendering.records_since, None);
}

/// What path tracing is due while light is learnt it gets at once, and learning does not go on for it: nothing is learnt until it has had it.
#[test]
fn tracing_waits_for_no_learning() {
    let mut rendering = box_drawn(Learning::InStep);
    let never = AtomicBool::new(false);
    assert!(rendering.is_learning());
    let known = |rendering: &Rendering| rendering.learner.as_ref().map(|learner| learner.counts());
    let (before, lead) = (known(&rendering), rendering.course.lead);
    let traced = |rendering: &Rendering| rendering.traced.as_ref().map_or(0, |film| film.passes_min());
    for passes in 1..4 {
        rendering.outlook = Some(Outlook::after_64_passes(1e-9, 10.0, 1e-3));
        rendering.step(&never);
        assert_eq!(traced(&rendering), passes);
    }
    assert_eq!((known(&rendering), rendering.course.lead), (before, lead));
    // It has had more than it may have.
    rendering.done.traced = 0.95 * rendering.done.all;
    rendering.outlook = Some(Outlook::after_64_passes(1e-9, 10.0, 1e-3));
    assert!(rendering.turn() == Turn::LookedUp && !rendering.traces_before_learning());
}

/// A round of photons that has to go first to end in time does, unless path tracing is far ahead.
#[test]
fn tracing_waits_for_a_round_that_must_end() {
    let until = Some(Instant::now() + Duration::from_secs(100_000));
    let mut rendering = box_drawn(Learning::Alongside { until });
    let never = AtomicBool::new(false);
    let round = |rendering: &Rendering| rendering.learner.as_ref().unwrap().round();
    while round(&rendering).is_none() {
        assert!(rendering.is_learning());
        rendering.step(&never);
    }
    let name = round(&rendering).unwrap().name;
    (rendering.done.all, rendering.done.traced) = (1e9, 0.0);
    // Ten thousand passes of 10⁵ would have left about 10⁻³ / 13,000.
    let mut traces = |floor, hurries| {
        rendering.outlook = Some(Outlook::after_64_passes(1e-12, floor, 1e-3));
        assert_eq!(rendering.turn(), Turn::Traced);
        rendering.course.hurries = hurries;
        rendering.traces_before_learning()
    };
    assert!(traces(1.1e-7, None) && traces(1.0, None));
    assert!(!traces(1.1e-7, Some(name)));
    assert!(traces(1.0, Some(name)));
}
