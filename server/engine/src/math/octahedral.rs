//! Unit vectors in 32 bits: the sphere folded onto an octahedron, that onto a square [Cigolle2014].
//!
//! Chosen over spherical angles because it needs no trigonometry on either side and spreads its codes evenly.

use glam::{Vec2, Vec3};

/// Steps from the middle of the square to its rim. Odd counts of codes (−32767 to 32767) put codes on the middle
/// and on the rim, which makes the six axes exact.
const STEP_COUNT: f32 = 32767.0;

/// Largest angle between a direction and what comes back of it, degrees.
///
/// Rounding is off by half a step, 1 / 65534, in each coordinate of the square: √2 / 65534 there. Lifting the
/// square onto the octahedron stretches by at most √3, and so does moving the middle of a face (1/√3 from the
/// centre) to the sphere: 3 √2 / 65534 radians.
pub const DIRECTION_ERROR_MAX_DEGREES: f32 = 0.003_71;

/// The code of a direction.
///
/// - `direction`: any length but zero; zero and NaN come back as +z
/// - returns two signed 16-bit coordinates of the square, the first in the low half
pub fn encode(direction: Vec3) -> u32 {
    let on_octahedron = direction / (direction.x.abs() + direction.y.abs() + direction.z.abs());
    let upper = Vec2::new(on_octahedron.x, on_octahedron.y);
    let square = if on_octahedron.z < 0.0 { fold(upper) } else { upper };
    // The casts saturate, and turn NaN into 0.
    let [u, v] = (square * STEP_COUNT).to_array().map(|coordinate| coordinate.round() as i16 as u16);
    u32::from(v) << 16 | u32::from(u)
}

/// The direction of a code: a unit vector, exact for the six axes.
pub fn decode(code: u32) -> Vec3 {
    let [u, v] = [code as u16, (code >> 16) as u16].map(|half| f32::from(half as i16) / STEP_COUNT);
    let square = Vec2::new(u, v);
    let z = 1.0 - u.abs() - v.abs();
    let upper = if z < 0.0 { fold(square) } else { square };
    upper.extend(z).normalize()
}

/// Swaps the square's middle, which holds the upper half of the sphere, with its corners.
fn fold(square: Vec2) -> Vec2 {
    let sign = Vec2::new(1f32.copysign(square.x), 1f32.copysign(square.y));
    (1.0 - Vec2::new(square.y, square.x).abs()) * sign
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::{DIRECTION_ERROR_MAX_DEGREES, decode, encode};
    use crate::math::sobol::{mix, point};

    fn random_direction(index: u32) -> Vec3 {
        let [u, v, ..] = point(11, index);
        let z = 2.0 * u - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
        Vec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + z * Vec3::Z
    }

    /// Angle from the chord: the arc cosine would lose such small ones.
    fn degrees_between(a: Vec3, b: Vec3) -> f32 {
        2.0 * (0.5 * a.distance(b)).asin().to_degrees()
    }

    /// The axes come back to the last bit.
    #[test]
    fn axes_are_exact() {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert_eq!(decode(encode(axis)), axis);
            assert_eq!(decode(encode(axis * 1e20)), axis);
        }
    }

    /// No direction turns by more than the stated angle, nor does rounding of the test's own (10⁻⁵ degrees).
    #[test]
    fn directions_come_back_within_the_stated_angle() {
        let mut worst = 0f32;
        for index in 0..1 << 20 {
            let direction = random_direction(index);
            worst = worst.max(degrees_between(decode(encode(direction)), direction.normalize()));
        }
        println!("largest angle: {worst}°");
        assert!(worst < DIRECTION_ERROR_MAX_DEGREES + 1e-5, "{worst}");
        assert!(worst > 0.5 * DIRECTION_ERROR_MAX_DEGREES, "the bound is not idle: {worst}");
    }

    /// Every code, also those that no direction has, is a unit vector.
    #[test]
    fn every_code_is_a_unit_vector() {
        let corners = [0, 0x7fff_7fff, 0x8000_8000, 0x8000_7fff, 0x7fff_8000, 0x8000_0000, 0x8000, u32::MAX];
        for code in corners.into_iter().chain((0..1 << 18).map(|k| mix(k) as u32)) {
            let length = decode(code).length();
            // Three squares, a root and a division round by half a unit of 2⁻²³ each.
            assert!((length - 1.0).abs() < 4.0 * f32::EPSILON, "{code:#x}: {length}");
        }
    }

    /// What has come back once comes back the same for ever.
    #[test]
    fn coding_again_changes_nothing() {
        for index in 0..1 << 16 {
            let once = decode(encode(random_direction(index)));
            assert_eq!(decode(encode(once)), once);
        }
    }

    /// Vectors without a direction become +z, not NaN.
    #[test]
    fn no_direction_is_up() {
        for nothing in [Vec3::ZERO, Vec3::NAN] {
            assert_eq!(decode(encode(nothing)), Vec3::Z);
        }
    }
}
