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
