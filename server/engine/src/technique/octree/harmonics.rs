//! A leaf's light as spherical harmonics of order 2, the other way to keep it than virtual directional lights.
//!
//! Nine numbers to a channel light a diffuse surface of any normal with 1 % of error on average under natural light
//! [Ramamoorthi2001], and with 9 % at worst under a single lamp; nothing sharper survives.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::{math::Rgb, technique::GatheredPhoton};

/// Bands 0, 1 and 2 have 1 + 3 + 5 functions.
const COEFFICIENT_COUNT: usize = 9;
/// Least cosine to divide by: a photon at 84° and beyond counts for ten times its irradiance and no more, or else a
/// few grazing photons would drown the leaf in noise. Costs a uniform hemisphere 1.1 % of its irradiance.
pub(super) const COSINE_MIN: f32 = 0.1;

/// Factors of the real spherical harmonics: √(1/4π), √(3/4π), √(15/4π), √(5/16π), √(15/16π).
const BAND_0: f32 = 0.282_094_8;
const BAND_1: f32 = 0.488_602_5;
const BAND_2_MIXED: f32 = 1.092_548_4;
const BAND_2_AXIAL: f32 = 0.315_391_57;
const BAND_2_CROSSED: f32 = 0.546_274_2;

/// What the clamped cosine does to each band: π, 2π/3, π/4 [Ramamoorthi2001]. All bands above 2 together hold
/// less than 1 % of its energy.
const COSINE_BANDS: [f32; 3] =
    [std::f32::consts::PI, 2.0 * std::f32::consts::FRAC_PI_3, std::f32::consts::FRAC_PI_4];

/// Radiance from all around, projected onto the first nine spherical harmonics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Harmonics {
    /// `[9]`, W/m²: ∫ L(ω) Y(ω) dω in the order (0,0); (1,−1), (1,0), (1,1); (2,−2) … (2,2).
    pub coefficients: [Rgb; COEFFICIENT_COUNT],
}

impl Harmonics {
    /// The light field that photons on a surface are a sample of.
    ///
    /// A photon's irradiance is radiance × solid angle × cosine to `n_set`, so that
    /// ∫ L Y dω = Σ E Y / cos. Biased: the division stops at a cosine of 0.1, and bands above 2 are cut off.
    ///
    /// - `photons`: their directions point to where the light comes from; unsound ones are left out
    /// - `n_set`: unit normal of the surface that the irradiance was measured on
    pub(super) fn project(photons: &[GatheredPhoton], n_set: Vec3) -> Harmonics {
        let mut harmonics = Harmonics::default();
        for photon in photons.iter().filter(|photon| photon.is_sound()) {
            let power = photon.irradiance / n_set.dot(photon.direction).max(COSINE_MIN);
            for (coefficient, value) in harmonics.coefficients.iter_mut().zip(basis(photon.direction)) {
                *coefficient += power * value;
            }
        }
        harmonics
    }

    /// Irradiance on a surface of normal `n`, W/m².
    ///
    /// The cut at band 2 rings: light from one direction comes out within 3/32 of its power wherever the normal
    /// points, and a little below zero behind it, which is cut to zero.
    pub fn irradiance(&self, n: Vec3) -> Rgb {
        let weight = |k: usize| COSINE_BANDS[k.isqrt()];
        let terms = self.coefficients.iter().zip(basis(n)).enumerate();
        let sum = terms.fold(Rgb::BLACK, |sum, (k, (c, value))| sum + *c * (value * weight(k)));
        sum.map(|channel| channel.max(0.0))
    }
}

/// The nine functions at a unit direction.
fn basis(d: Vec3) -> [f32; COEFFICIENT_COUNT] {
    [
        BAND_0,
        BAND_1 * d.y,
        BAND_1 * d.z,
        BAND_1 * d.x,
        BAND_2_MIXED * d.x * d.y,
        BAND_2_MIXED * d.y * d.z,
        BAND_2_AXIAL * (3.0 * d.z * d.z - 1.0),
        BAND_2_MIXED * d.x * d.z,
        BAND_2_CROSSED * (d.x * d.x - d.y * d.y),
    ]
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{PI, TAU};

    use glam::{Quat, Vec3};

    use super::{GatheredPhoton, Harmonics, basis};
    use crate::math::Frame;
    use crate::math::Rgb;
    use crate::math::sobol::point;

    fn sphere_point(key: u64, index: u32) -> Vec3 {
        let [u, v, ..] = point(key, index);
        let z = 2.0 * u - 1.0;
        let (sin, cos) = (TAU * v).sin_cos();
        (Vec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + z * Vec3::Z).normalize()
    }

    /// A midpoint grid over the hemisphere around `n`, `rows` × 16 directions of equal solid angle, radiance 1.
    fn hemisphere(n: Vec3, rows: u32) -> Vec<GatheredPhoton> {
        let frame = Frame::around(n);
        let solid_angle = TAU / (16 * rows) as f32;
        let photon = |k: u32| {
            let z = ((k / 16) as f32 + 0.5) / rows as f32;
            let (sin, cos) = (TAU * (k % 16) as f32 / 16.0).sin_cos();
            let direction = frame.to_world((Vec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt()).with_z(z));
            GatheredPhoton { direction: direction.normalize(), irradiance: Rgb::splat(z * solid_angle) }
        };
        (0..16 * rows).map(photon).collect()
    }

    /// A photon that stands for radiance × solid angle of 1, measured on a surface facing it.
    fn beam(direction: Vec3) -> GatheredPhoton {
        GatheredPhoton { direction, irradiance: Rgb::WHITE }
    }

    /// The nine functions are orthonormal: midpoint quadrature over the sphere gives the unit matrix.
    #[test]
    fn functions_are_orthonormal() {
        let both = hemisphere(Vec3::Z, 400).into_iter().chain(hemisphere(-Vec3::Z, 400));
        let mut products = [[0f64; 9]; 9];
        let solid_angle = f64::from(TAU) / 6400.0;
        for photon in both {
            let y = basis(photon.direction).map(f64::from);
            for (i, j) in (0..81).map(|k| (k / 9, k % 9)) {
                products[i][j] += y[i] * y[j] * solid_angle;
            }
        }
        for (i, j) in (0..81).map(|k| (k / 9, k % 9)) {
            let expected = if i == j { 1.0 } else { 0.0 };
            // The midpoint rule is off by h²/24 times a second derivative of some 30: 10⁻⁵.
            assert!((products[i][j] - expected).abs() < 2e-5, "{i} {j}: {}", products[i][j]);
        }
    }

    /// Uniform radiance over a hemisphere lights a tilted surface by π (1 + cos γ) / 2, which order 2 holds without
    /// any error of its own: what is lost is lost to the least cosine, and known.
    #[test]
    fn a_uniform_hemisphere_lights_every_normal_as_it_should() {
        // Moments ∫ min(1, z / 0.1) P_l(z) dz over 0..1 for l = 0, 1, 2; without the bound ½·(2, 1, 0).
        let moments = [0.95, 0.495 + 0.01 / 3.0, 0.024_875];
        for index in 0..40 {
            let n_set = sphere_point(1, index);
            let light = Harmonics::project(&hemisphere(n_set, 2000), n_set);
            for other in 0..20 {
                let n = if other == 0 { n_set } else { sphere_point(2, other) };
                let c = n.dot(n_set);
                let found = light.irradiance(n).g;
                let with_bound = 0.5 * moments[0] + moments[1] * c + 0.625 * moments[2] * (1.5 * c * c - 0.5);
                // 32000 additions in single precision leave some 10⁻⁴.
                assert!((found / PI - with_bound.max(0.0)).abs() < 3e-4, "{c}: {} {with_bound}", found / PI);
                // 3.3 % of π is lost at most, to normals square to the leaf, and 1.1 % where the normal is its own.
                let allowed = if other == 0 { 0.0115 } else { 0.035 };
                assert!((found / PI - 0.5 * (1.0 + c)).abs() < allowed, "{c}: {}", found / PI);
            }
        }
    }

    /// One direction comes out as 1/4 + c/2 + 5/32 (3c² − 1), cut at zero; never farther from max(0, c) than 3/32.
    #[test]
    fn a_single_direction_rings_by_a_known_amount() {
        let mut worst = 0f32;
        for index in 0..2000 {
            let direction = sphere_point(3, index);
            let light = Harmonics::project(&[beam(direction)], direction);
            let n = sphere_point(4, index);
            let c = n.dot(direction);
            let expected = 0.25 + 0.5 * c + 5.0 / 32.0 * (3.0 * c * c - 1.0);
            let found = light.irradiance(n).r;
            assert!((found - expected.max(0.0)).abs() < 2e-6, "{c}: {found}, not {expected}");
            worst = worst.max((found - c.max(0.0)).abs());
        }
        // The worst normals are those square to the light.
        assert!(worst <= 3.0 / 32.0 + 1e-5 && worst > 0.09, "{worst}");
    }

    /// Turning light and surface together changes nothing.
    #[test]
    fn rotations_change_nothing() {
        for index in 0..100 {
            let [x, y, z, w] = point(5, index).map(|u| u - 0.5);
            let turn = Quat::from_xyzw(x, y, z, w).normalize();
            let photons: Vec<GatheredPhoton> =
                (0..20).map(|k| beam(sphere_point(6, k + 20 * index))).collect();
            let turned: Vec<GatheredPhoton> =
                photons.iter().map(|photon| beam(turn * photon.direction)).collect();
            let (n_set, n) = (sphere_point(7, index), sphere_point(8, index));
            let before = Harmonics::project(&photons, n_set).irradiance(n).b;
            let after = Harmonics::project(&turned, turn * n_set).irradiance(turn * n).b;
            // Division by 0.1 raises rounding of the cosines tenfold and more; irradiance is of order 10.
            assert!((before - after).abs() < 1e-4 * before.max(10.0), "{index}: {before} {after}");
        }
    }

    /// Light falling at an angle was thinned by the cosine of the surface it was measured on, and is restored.
    #[test]
    fn slanted_light_is_restored_down_to_the_least_cosine() {
        for cosine in [1.0f32, 0.5, 0.2, 0.11, 0.1, 0.01, 0.0, -0.5] {
            let direction = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            let photon = GatheredPhoton { direction, irradiance: Rgb::splat(cosine.max(0.01)) };
            let found = Harmonics::project(&[photon], Vec3::Z).irradiance(direction).g;
            let power = cosine.max(0.01) / cosine.max(0.1);
            assert!((found - 17.0 / 16.0 * power).abs() < 1e-5, "{cosine}: {found}");
        }
    }

    /// Channels stay apart, powers add, no irradiance is negative, and what makes no sense is left out.
    #[test]
    fn light_adds_channel_by_channel() {
        let red = GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::new(2.0, 0.0, 0.0) };
        let blue = GatheredPhoton { direction: Vec3::X, irradiance: Rgb::new(0.0, 0.0, 3.0) };
        let bad = GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::splat(f32::NAN) };
        let both = Harmonics::project(&[red, bad, blue], Vec3::Z);
        let apart = [red, blue].map(|photon| Harmonics::project(&[photon], Vec3::Z));
        for index in 0..500 {
            let n = sphere_point(9, index);
            let found = both.irradiance(n);
            assert!(found.is_non_negative() && found.g == 0.0);
            assert_eq!((found.r, found.b), (apart[0].irradiance(n).r, apart[1].irradiance(n).b));
        }
        assert_eq!(Harmonics::project(&[], Vec3::Z).irradiance(Vec3::Y), Rgb::BLACK);
    }
}
