//! A matt base under a coat as light that arrives from many sides asks for it: what is the same for all of them is known beforehand.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec3, Vec4};

use super::LobeValue;
use crate::math::{Rgb, warp};

/// Schlick's term: by how much a coat reflects more of light from `cos` than of light from straight ahead, 0 to 1.
#[inline]
pub fn schlick_rise(cos: f32) -> f32 {
    (1.0 - cos.clamp(0.0, 1.0)).powi(5)
}

/// Mean of [`schlick_rise`] over light from all around, 2 ∫ (1 − μ)⁵ μ dμ.
pub const EVEN_RISE: f32 = 1.0 / 21.0;

/// The diffuse lobe towards one direction, f = scale · (1 − rise · (1 − cos θᵢ)⁵), 1/sr: Lambert's, or one under a coat that lets through
/// what it does not reflect by Schlick's term.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoatedBase {
    /// What it sends on of light from straight ahead, 1/sr.
    pub scale: Rgb,
    /// Share of it that light along the surface loses in the coat, 0 to 1.
    pub rise: f32,
}

impl CoatedBase {
    /// Without a coat.
    pub(super) fn lambert(albedo: Rgb) -> CoatedBase {
        CoatedBase { scale: albedo * FRAC_1_PI, rise: 0.0 }
    }

    /// For light from `wi` (frame coordinates), when the lobe is taken with probability `chance`.
    pub(super) fn value(&self, wi: Vec3, chance: f32) -> LobeValue {
        let cos = wi.z.abs();
        LobeValue {
            f_cos: self.scale * (self.passing(cos) * cos),
            pdf_solid_angle: warp::cosine_hemisphere_pdf(cos) * chance,
        }
    }

    /// The share that light from `cos` has of light from straight ahead.
    #[inline]
    pub fn passing(&self, cos: f32) -> f32 {
        if self.rise == 0.0 { 1.0 } else { 1.0 - self.rise * schlick_rise(cos) }
    }

    /// The same of light from around `cos`.
    ///
    /// - `more`: by how much [`schlick_rise`] is more on average than at `cos`
    #[inline]
    pub fn passing_around(&self, cos: f32, more: f32) -> f32 {
        (self.passing(cos) - self.rise * more).max(0.0)
    }

    /// The same of four.
    #[inline]
    pub fn four_passing_around(&self, cos: Vec4, more: f32) -> Vec4 {
        let rest = Vec4::ONE - cos.clamp(Vec4::ZERO, Vec4::ONE);
        let square = rest * rest;
        (Vec4::ONE - (square * square * rest + more) * self.rise).max(Vec4::ZERO)
    }
}
