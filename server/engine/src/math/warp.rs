//! Unit squares turned into directions and points, each with the density it makes.

use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, FRAC_PI_4, TAU};

use glam::{Vec2, Vec3};

/// Uniform on the unit disc, area-preserving and continuous [Shirley1997].
pub fn disc(u: [f32; 2]) -> Vec2 {
    let offset = Vec2::new(2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if offset == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, angle) = if offset.x.abs() > offset.y.abs() {
        (offset.x, FRAC_PI_4 * (offset.y / offset.x))
    } else {
        (offset.y, FRAC_PI_2 - FRAC_PI_4 * (offset.x / offset.y))
    };
    Vec2::new(angle.cos(), angle.sin()) * radius
}

/// Cosine-weighted on the hemisphere around +z; density cos θ / π.
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let d = disc(u);
    Vec3::new(d.x, d.y, (1.0 - d.length_squared()).max(0.0).sqrt())
}

/// The point of the unit square that [`cosine_hemisphere`] takes to a unit vector above the xy plane.
pub fn square_of_hemisphere(direction: Vec3) -> Vec2 {
    let d = direction.truncate();
    let radius = d.length().min(1.0);
    let swaps = d.y.abs() > d.x.abs();
    // Within an eighth of a turn of the longer axis, by that axis.
    let (long, short) = if swaps { (d.y, d.x) } else { (d.x, d.y) };
    let along = radius.copysign(long);
    let across = if long == 0.0 { 0.0 } else { along * (short / long).atan() / FRAC_PI_4 };
    let offset = if swaps { Vec2::new(across, along) } else { Vec2::new(along, across) };
    0.5 * offset + 0.5
}

/// Density of [`cosine_hemisphere`], 1/sr.
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Uniform on the sphere; density 1/(4π).
pub fn sphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u[0];
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (TAU * u[1]).sin_cos();
    Vec3::new(r * cos, r * sin, z)
}

/// Uniform on a triangle: weights of its second and third vertex [Heitz2019].
pub fn triangle(u: [f32; 2]) -> [f32; 2] {
    let [u0, u1] = u;
    if u0 < u1 {
        let b0 = u0 * 0.5;
        [u1 - b0, 1.0 - b0 - (u1 - b0)]
    } else {
        let b1 = u1 * 0.5;
        [b1, 1.0 - (u0 - b1) - b1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// Hemisphere and square are mapped to each other and back, to the rims and the middle.
    #[test]
    fn squares_and_hemispheres_agree() {
        for number in 0..10_000 {
            let [u, v, ..] = point(7, number);
            let back = square_of_hemisphere(cosine_hemisphere([u, v]));
            assert!(back.abs_diff_eq(Vec2::new(u, v), 1e-5), "{u} {v}: {back}");
        }
        for u in
            [[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [1.0, 0.5], [0.5, 1.0], [0.5, 0.5], [1.0, 1.0], [1.0, 0.0]]
        {
            let back = square_of_hemisphere(cosine_hemisphere(u));
            assert!(back.abs_diff_eq(Vec2::from(u), 1e-5), "{u:?}: {back}");
        }
        // Longer than one by rounding.
        let back = square_of_hemisphere(Vec3::new(-1.0000001, 0.0, 0.0));
        assert!(back.cmpge(Vec2::ZERO).all() && back.cmple(Vec2::ONE).all());
    }
}
