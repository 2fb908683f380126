//! What hostile scenes have found and what was mended, each by the name of what it was.

use crate::hostile::{Case, check, on_threads};

/// Holds a case against all that is demanded of hostile scenes.
fn holds(case: &Case) {
    if let Err(error) = on_threads(1, || check(case)) {
        panic!("{}\n    {error}", case.described());
    }
}

/// Nothing at all to see or to trace.
#[test]
fn an_empty_scene_is_black() {
    holds(&Case::named("closed room", &["nothing"], 0));
}
