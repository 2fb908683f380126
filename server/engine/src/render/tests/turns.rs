//! Who draws next where light is looked up and path-traced beside each other.

use super::*;
use crate::{
    film::Outdated,
    render::chain::{Outlook, Turn},
};

/// However much better path tracing was, light that is better known is drawn with before it goes on: a pass of it that was under way finds the
/// film as it was.
#[test]
fn light_that_is_better_known_is_drawn_with() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let settings =
        RenderSettings { indirect: Indirect::Auto, learning: Learning::First, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world, view, PictureSize::new(16, 16).unwrap(), settings);
    let never = AtomicBool::new(false);
    while rendering.film.passes_min() < 4 {
        rendering.step(&never);
    }
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

/// What path tracing is due while light is learnt it gets at once, and learning does not go on for it: nothing is learnt until it has had it.
#[test]
fn tracing_waits_for_no_learning() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let settings =
        RenderSettings { indirect: Indirect::Auto, learning: Learning::InStep, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world, view, PictureSize::new(16, 16).unwrap(), settings);
    let never = AtomicBool::new(false);
    while rendering.film.passes_min() < 4 {
        rendering.step(&never);
    }
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
    // Nine in ten of the work are too much for the little that it is ahead by.
    rendering.done.traced = 0.9 * rendering.done.all;
    rendering.outlook = Some(Outlook::after_64_passes(1e-9, 1e-12, 1e-3));
    while known(&rendering) == before {
        rendering.step(&never);
    }
    assert_eq!(traced(&rendering), 3);
}
