//! Rust and WGSL mean the same bytes and the same numbers.

use lumicast_shaders::{PATH_SHADE, PROOF_CONSTANTS};

use super::{
    super::map::{COS_RATIO_MIN, FACING_COS, FLATNESS},
    *,
};
use crate::gpu::tests::{assert_same_layout, numbers_of};

#[test]
fn photons_lie_alike_in_rust_and_wgsl() {
    let source = PATH_SHADE.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &source,
        "Photon",
        GpuPhoton { position, r2, flux_w, scatterings, direction, padding_0, normal, padding_1 }
    );
    let numbers = numbers_of(&source);
    let expected = [
        ("GRIDS_AT", GRIDS_AT as f64),
        ("GRID_WORDS", GRID_WORDS as f64),
        ("FLATNESS", f64::from(FLATNESS)),
        ("FACING_COS", f64::from(FACING_COS)),
        ("COS_RATIO_MIN", f64::from(COS_RATIO_MIN)),
    ];
    for (name, value) in expected {
        assert_eq!(numbers[name], value, "{name}");
    }
}
