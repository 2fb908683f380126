//! Pictures that are due before anything is known of the light.

use std::time::{Duration, Instant};

use super::*;
use crate::render::{chain::Turn, meanwhile::Foreseen};

const HOUR: Duration = Duration::from_secs(3600);

/// A small picture of a built-in scene without mirrors, not begun.
fn boxes_to_draw(indirect: Indirect, until: Instant) -> Rendering {
    let world = Arc::new(world_of(samples::boxes().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let learning = Learning::Alongside { until: Some(until) };
    let settings = RenderSettings { indirect, learning, ..RenderSettings::default() };
    Rendering::new(world, view, PictureSize::new(16, 16).unwrap(), settings)
}

fn traced_passes(rendering: &Rendering) -> u32 {
    rendering.traced.as_ref().map_or(0, |film| film.passes_min())
}

/// The best there is when the time is over is what can be path-traced, if nothing is known by then. What is asked for by name is waited for,
/// and so is any light that there is time for.
#[test]
fn a_picture_that_is_due_waits_for_no_light() {
    let never = AtomicBool::new(false);
    let begin = |indirect, until| {
        let mut rendering = boxes_to_draw(indirect, until);
        while rendering.passes() == 0 {
            rendering.step(&never);
        }
        rendering
    };
    let mut due = begin(Indirect::Auto, Instant::now());
    assert!(!due.looks_up() && due.known().is_none());
    // It stays so: what is not known by the end of the time is not learnt.
    for passes in 2..5 {
        due.step(&never);
        assert_eq!(due.passes(), passes);
    }
    assert!(!due.looks_up());
    assert_eq!(due.technique_name(&due.picture()), "path");
    assert!(begin(Indirect::Octree, Instant::now()).looks_up());
    let in_an_hour = begin(Indirect::Auto, Instant::now() + HOUR);
    assert!(in_an_hour.looks_up() && in_an_hour.course.foreseen.is_none());
}

/// Where light is long in coming and path tracing will do better, it has a part of the work in a film of its own, beside one pass that stands for
/// the other; that goes once light is known. Where it will do worse nothing is drawn.
#[test]
fn path_tracing_goes_on_while_light_is_long_in_coming() {
    let never = AtomicBool::new(false);
    let foreseen = |variance| Foreseen { variance, pass_seconds: 1e-3, passes: 0 };
    let half_over = |variance| {
        let mut rendering = boxes_to_draw(Indirect::Auto, Instant::now() + HOUR);
        rendering.course.awaits_since = Instant::now().checked_sub(HOUR);
        rendering.course.foreseen = Some(foreseen(variance));
        rendering
    };
    let mut rendering = half_over(1e-3);
    rendering.step(&never);
    assert!(rendering.passes() == 0 && rendering.done.all > 0.0, "a share of nothing is nothing");
    while !rendering.looks_up() {
        let share = (rendering.done.looked_up + rendering.done.traced) / rendering.done.all;
        let before = (rendering.film.passes_min(), traced_passes(&rendering));
        rendering.step(&never);
        let after = (rendering.film.passes_min(), traced_passes(&rendering));
        let drawn = if before.0 == 0 { (1, 0) } else { (before.0, before.1 + 1) };
        // More than half once its own passes say so.
        assert!(after == drawn || share >= 0.5 && after == before, "{before:?} {after:?} {share}");
        assert!(after == before || share < 0.8, "{before:?} {after:?} {share}");
    }
    assert!(traced_passes(&rendering) > 0);
    assert!(rendering.course.foreseen.is_some_and(|foreseen| foreseen.passes <= traced_passes(&rendering)));
    assert!(!rendering.traces_meanwhile() && rendering.turn() == Turn::LookedUp);
    let mut waits = half_over(1e6);
    while !waits.looks_up() {
        assert_eq!((waits.passes(), waits.traced.is_none()), (0, true));
        waits.step(&never);
    }
}

/// A look at some pixels tells what a pass will turn out to be, about.
#[test]
fn a_look_ahead_tells_of_passes() {
    let never = AtomicBool::new(false);
    let mut rendering = boxes_to_draw(Indirect::Auto, Instant::now() + HOUR);
    rendering.course.awaits_since = Instant::now().checked_sub(HOUR);
    while rendering.course.foreseen.is_none() {
        assert!(rendering.passes() == 0 && !rendering.looks_up());
        rendering.step(&never);
    }
    let Foreseen { variance, pass_seconds, passes } = rendering.course.foreseen.unwrap();
    let settings = RenderSettings { indirect: Indirect::Path, ..RenderSettings::default() };
    let mut traced = Rendering::new(
        rendering.world.clone(),
        rendering.world.scene().camera_view(None).unwrap(),
        rendering.size(),
        settings,
    );
    while traced.passes() < 64 {
        traced.step(&never);
    }
    let of_a_pass = 64.0 * traced.film.noise().unwrap().0.rel_mse;
    // Passes are spread better than single samples.
    assert!(variance > 0.5 * of_a_pass && variance < 20.0 * of_a_pass, "{variance} for {of_a_pass}");
    assert!(pass_seconds > 0.0 && pass_seconds < 10.0 && passes == 0, "{pass_seconds}");
}
