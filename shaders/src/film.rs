//! Pictures as a screen shows them.

use crate::{Part, Step};

static SHOW_ENTRY: Part = Part { name: "film/show", source: include_str!("../film/show.wgsl") };

/// One film, or two blended, exposed, tone-mapped and encoded to 8 bits.
pub static FILM_SHOW: Step =
    Step { name: "film/show", entry_point: "show", parts: &[&SHOW_ENTRY], workgroup_size: [64, 1, 1] };
