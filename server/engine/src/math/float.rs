//! Neighbouring floats, for bounds that must not be too small by a rounding.

/// The next representable value above `x` (finite `x`).
pub fn next_float_up(x: f32) -> f32 {
    x.next_up()
}

/// The next representable value below `x` (finite `x`).
pub fn next_float_down(x: f32) -> f32 {
    x.next_down()
}
