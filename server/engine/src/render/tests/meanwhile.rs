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
    assert!(in_an_hour.looks_up() && in_an_hour.course.awaiting.foreseen.is_none());
}

/// Where light is long in coming and path tracing will do better, it has a part of the work in a film of its own, beside one pass that stands for
/// the other; that goes once light is known. Where it will do worse nothing is drawn.
#[test]
fn path_tracing_goes_on_while_light_is_long_in_coming() {
    let never = AtomicBool::new(false);
    // Half of the time is over, in which path tracing had nearly all of the work that it may have: so much is known of it.
    let half_over = |variance| {
        let mut rendering = boxes_to_draw(Indirect::Auto, Instant::now() + 2 * HOUR);
        (rendering.done.all, rendering.done.traced) = (3600.0, 3419.8);
        let foreseen = Foreseen { variance, pass_seconds: 1e-3, passes: 8 };
        rendering.course.awaiting.foreseen = Some(foreseen);
        rendering
    };
    let mut rendering = half_over(1e-3);
    while !rendering.looks_up() {
        let share = (rendering.done.looked_up + rendering.done.traced) / rendering.done.all;
        let before = (rendering.film.passes_min(), traced_passes(&rendering));
        rendering.step(&never);
        let after = (rendering.film.passes_min(), traced_passes(&rendering));
        let drawn = if before.0 == 0 { (1, 0) } else { (before.0, before.1 + 1) };
        assert!(after == before || after == drawn && share < 0.95, "{before:?} {after:?} {share}");
    }
    assert!(traced_passes(&rendering) > 0);
    let told = rendering.course.awaiting.foreseen.unwrap();
    assert!(told.passes == 8 || told.passes <= traced_passes(&rendering));
    // What is known is drawn with at once.
    assert!(!rendering.traces_meanwhile() && rendering.turn() == Turn::LookedUp);
    let passes = rendering.film.passes_min();
    rendering.step(&never);
    assert_eq!(rendering.film.passes_min(), passes + 1);
    let mut waits = half_over(1e6);
    while !waits.looks_up() {
        assert_eq!((waits.passes(), waits.traced.is_none()), (0, true));
        waits.step(&never);
    }
}

/// A look at some pixels tells what a pass will turn out to be, about; one that is cut short says nothing and is taken anew.
#[test]
fn a_look_ahead_tells_of_passes() {
    let never = AtomicBool::new(false);
    let mut rendering = boxes_to_draw(Indirect::Auto, Instant::now() + HOUR);
    rendering.done.all = 1800.0;
    rendering.step(&AtomicBool::new(true));
    assert!(rendering.course.awaiting.foreseen.is_none());
    rendering.step(&never);
    let Foreseen { variance, pass_seconds, passes } = rendering.course.awaiting.foreseen.unwrap();
    let settings = RenderSettings { indirect: Indirect::Path, ..RenderSettings::default() };
    let view = rendering.world.scene().camera_view(None).unwrap();
    let mut traced = Rendering::new(rendering.world.clone(), view, rendering.size(), settings);
    while traced.passes() < 64 {
        traced.step(&never);
    }
    let of_a_pass = 64.0 * traced.film.noise().unwrap().0.rel_mse;
    // Passes are spread better than single samples.
    assert!(variance > 0.5 * of_a_pass && variance < 20.0 * of_a_pass, "{variance} for {of_a_pass}");
    assert!(pass_seconds > 0.0 && passes == 0, "{pass_seconds}");
}

/// Who learns for others learns first: what is known by the end of one picture's time serves the next.
#[test]
fn who_learns_for_others_learns_first() {
    let of_one = boxes_to_draw(Indirect::Auto, Instant::now() + HOUR);
    let (world, settings) = (of_one.world.clone(), of_one.settings);
    let view = world.scene().camera_view(None).unwrap();
    let plan = EffectPlan::of(world.scene());
    let of = IlluminationSettings::of(&settings);
    let learner = Learner::new(settings.learns(&plan).unwrap(), &settings, of);
    let seen = (view, of_one.size());
    let mut rendering = Rendering::learning_on((world, &plan), (learner, 0), seen, settings);
    rendering.done.all = 1800.0;
    while rendering.passes() == 0 {
        rendering.step(&AtomicBool::new(false));
    }
    assert!(rendering.looks_up() && rendering.traced.is_none());
}
