//! Pictures as a screen shows them, and noise taken off them.

use crate::{Part, Step};

static SHOW_ENTRY: Part = Part { name: "film/show", source: include_str!("../film/show.wgsl") };

/// One film, or two blended, exposed, tone-mapped and encoded to 8 bits.
pub static FILM_SHOW: Step =
    Step { name: "film/show", entry_point: "show", parts: &[&SHOW_ENTRY], workgroup_size: [64, 1, 1] };

static FIRST: Part = Part { name: "film/first", source: include_str!("../film/first.wgsl") };
static BRIGHTEST_ENTRY: Part =
    Part { name: "film/brightest", source: include_str!("../film/brightest.wgsl") };
static UNJOINED_ENTRY: Part = Part { name: "film/unjoined", source: include_str!("../film/unjoined.wgsl") };
static FIRST_SHOWN_ENTRY: Part =
    Part { name: "film/first_shown", source: include_str!("../film/first_shown.wgsl") };

/// The brightest light of a first pass that noise is taken off.
pub static FILM_BRIGHTEST: Step = Step {
    name: "film/brightest",
    entry_point: "find_brightest",
    parts: &[&FIRST, &BRIGHTEST_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Pixels of a first pass, laid out to be joined.
pub static FILM_UNJOINED: Step = Step {
    name: "film/unjoined",
    entry_point: "lay_out",
    parts: &[&FIRST, &UNJOINED_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Radiance that a picture of one pass shows.
pub static FILM_FIRST_SHOWN: Step = Step {
    name: "film/first_shown",
    entry_point: "add_up",
    parts: &[&FIRST, &FIRST_SHOWN_ENTRY],
    workgroup_size: [64, 1, 1],
};

static AROUND: Part = Part { name: "film/around", source: include_str!("../film/around.wgsl") };
static KNOWN_BETTER_ENTRY: Part =
    Part { name: "film/known_better", source: include_str!("../film/known_better.wgsl") };
static PER_DIFFERENCE_ENTRY: Part =
    Part { name: "film/per_difference", source: include_str!("../film/per_difference.wgsl") };
static JOINED_ENTRY: Part = Part { name: "film/joined", source: include_str!("../film/joined.wgsl") };

/// Light with a variance that is known better than from a pixel's own samples.
pub static FILM_KNOWN_BETTER: Step = Step {
    name: "film/known_better",
    entry_point: "known_better",
    parts: &[&AROUND, &KNOWN_BETTER_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// How much differences of light count in each pixel.
pub static FILM_PER_DIFFERENCE: Step = Step {
    name: "film/per_difference",
    entry_point: "per_difference",
    parts: &[&AROUND, &PER_DIFFERENCE_ENTRY],
    workgroup_size: [64, 1, 1],
};

/// Pixels joined with those around that are their like.
pub static FILM_JOINED: Step = Step {
    name: "film/joined",
    entry_point: "joined",
    parts: &[&AROUND, &JOINED_ENTRY],
    workgroup_size: [64, 1, 1],
};
