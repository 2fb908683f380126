//! Rust and WGSL mean the same numbers.

use std::f32::consts::SQRT_2;

use lumicast_shaders::{CAUSTICS_CHOOSE, PATH_SHADE, PROOF_CONSTANTS};

use super::super::{ACROSS_MIN_M, COS_MIN, ENOUGH};
use crate::{gpu::tests::numbers_of, technique::SHOWN_NOWHERE};

#[test]
fn numbers_of_sketches_are_the_same_in_rust_and_wgsl() {
    let of_look_up = numbers_of(&PATH_SHADE.source(PROOF_CONSTANTS));
    let floats = [("COS_MIN", COS_MIN), ("ACROSS_MIN_M", ACROSS_MIN_M), ("CORNER_TO_CORNER", SQRT_2)];
    for (name, value) in floats {
        assert_eq!(of_look_up[name], f64::from(value), "{name}");
    }
    let of_counting = numbers_of(&CAUSTICS_CHOOSE.source(PROOF_CONSTANTS));
    for (name, value) in [("ENOUGH", ENOUGH), ("NOWHERE", SHOWN_NOWHERE)] {
        assert_eq!(of_counting[name], f64::from(value), "{name}");
    }
}
