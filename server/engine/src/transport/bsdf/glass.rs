//! A smooth boundary between air and a dielectric, exact Fresnel terms.
//!
//! `wo.z` tells the side: above 0 outside, below 0 inside. What passes carries the base colour; of what enters, the
//! share `1 − transmission` is scattered by a matt base instead (glTF's mix), on the side it came from. That base sees light
//! through the boundary twice, so it is weighed by (1 − F) for both directions and normalised [Kulla2017, eq. 9]:
//! reciprocal, and what enters comes out again. (A plain Lambert base loses what is trapped by total reflection.)

use glam::Vec3;

use super::{BsdfSample, BsdfValue, CoatedBase, LobeValue};
use crate::{
    math::{Rgb, warp},
    transport::Scatter,
};

/// Glass at one point.
#[derive(Clone, Copy, Debug)]
pub struct Glass {
    /// Index of refraction of the inside over that of the outside.
    pub eta: f32,
    /// Share of passing light that gets through, by channel.
    pub tint: Rgb,
    /// Share of the non-reflected light that passes; the rest meets the Lambert base.
    pub transmission: f32,
}

/// Share of unpolarised light that a smooth boundary reflects, and the cosine on the other side (0 when reflection is
/// total). `cos_i` ≥ 0 is the cosine on the incoming side, `eta` the index beyond over the index here.
pub(super) fn fresnel_dielectric(cos_i: f32, eta: f32) -> (f32, f32) {
    let cos_i = cos_i.clamp(0.0, 1.0);
    if eta == 1.0 {
        // Nothing changes at such a boundary, at grazing incidence either, where the terms below are 0/0.
        return (0.0, cos_i);
    }
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    // At grazing incidence with eta = 1 both are 0/0: nothing changes at such a boundary, nothing reflects.
    (0.5 * (parallel * parallel + perpendicular * perpendicular), cos_t)
}

impl Glass {
    pub(super) fn has_density(&self) -> bool {
        self.transmission < 1.0 && !self.tint.is_black()
    }

    pub(super) fn albedo(&self) -> Rgb {
        let (reflected, _) = fresnel_dielectric(1.0, self.eta);
        Rgb::splat(reflected) + self.tint * (1.0 - reflected)
    }

    /// See [`super::Bsdf::shows_most_from`].
    pub(super) fn shows_most_from(&self, wo: Vec3, wi: Vec3) -> bool {
        let (reflected, _) = fresnel_dielectric(wo.z.abs(), self.eta_from(wo));
        let passes_through = wo.z * wi.z < 0.0;
        passes_through == (reflected <= 0.5)
    }

    /// Index beyond the boundary over the index on `wo`'s side.
    fn eta_from(&self, wo: Vec3) -> f32 {
        if wo.z > 0.0 { self.eta } else { 1.0 / self.eta }
    }

    /// Chances of reflection, transmission and the base.
    fn chances(&self, reflected: f32) -> [f32; 3] {
        [reflected, (1.0 - reflected) * self.transmission, (1.0 - reflected) * (1.0 - self.transmission)]
    }

    /// f · |cos θᵢ| of the base and the density of drawing `wi` for it, its `chance` included.
    fn base(&self, reflected: f32, wi: Vec3, eta: f32, chance: f32) -> LobeValue {
        let (reflected_in, _) = fresnel_dielectric(wi.z.abs(), eta);
        let share = (1.0 - reflected) * (1.0 - self.transmission) * (1.0 - reflected_in) / passing_mean(eta);
        CoatedBase::lambert(self.tint * share).value(wi, chance)
    }

    /// See [`super::Bsdf::diffuse_of_light`]: what enters is normalised by its mean over even light, and any light is taken for even.
    pub(super) fn diffuse_of_even_light(&self, wo: Vec3) -> Rgb {
        let (reflected, _) = fresnel_dielectric(wo.z.abs(), self.eta_from(wo));
        self.tint * (self.chances(reflected)[2] * std::f32::consts::FRAC_1_PI)
    }

    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> BsdfValue {
        let eta = self.eta_from(wo);
        let (reflected, _) = fresnel_dielectric(wo.z.abs(), eta);
        let diffuse = self.base(reflected, wi, eta, self.chances(reflected)[2]);
        BsdfValue { diffuse, ..BsdfValue::default() }
    }

    /// A sample of reflection or transmission as if there was no base.
    pub(super) fn sample_specular(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let (reflected, _) = fresnel_dielectric(wo.z.abs(), self.eta_from(wo));
        let [reflection, transmission, _] = self.chances(reflected);
        let specular = reflection + transmission;
        let drawn = self.sample(wo, [u[0] * specular, u[1], u[2]])?;
        // Rounding may have drawn the base after all.
        (drawn.scatter == Scatter::Specular).then(|| BsdfSample { weight: drawn.weight * specular, ..drawn })
    }

    /// See [`super::Bsdf::passing`].
    pub(super) fn passing(&self, wo: Vec3) -> Option<BsdfSample> {
        let eta = self.eta_from(wo);
        let (reflected, cos_t) = fresnel_dielectric(wo.z.abs(), eta);
        let [_, transmission, _] = self.chances(reflected);
        (transmission > 0.0).then(|| {
            let drawn = self.passed(wo, eta, cos_t);
            BsdfSample { weight: drawn.weight * transmission, ..drawn }
        })
    }

    /// A sample of what passes.
    fn passed(&self, wo: Vec3, eta: f32, cos_t: f32) -> BsdfSample {
        let wi = Vec3::new(-wo.x / eta, -wo.y / eta, -cos_t.copysign(wo.z));
        BsdfSample {
            wi: wi.normalize_or(-wo),
            // Radiance gathers into a narrower cone in the denser medium: towards the eye it scales by 1/η²
            // [Veach1997, 5.2].
            weight: self.tint * (1.0 / (eta * eta)),
            pdf_solid_angle: None,
            scatter: Scatter::Specular,
            eta_squared: eta * eta,
        }
    }

    pub(super) fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let eta = self.eta_from(wo);
        let (reflected, cos_t) = fresnel_dielectric(wo.z.abs(), eta);
        let [reflection, transmission, base] = self.chances(reflected);
        if u[0] < reflection {
            return Some(BsdfSample {
                wi: Vec3::new(-wo.x, -wo.y, wo.z),
                weight: Rgb::WHITE,
                pdf_solid_angle: None,
                scatter: Scatter::Specular,
                eta_squared: 1.0,
            });
        }
        if u[0] < reflection + transmission {
            return Some(self.passed(wo, eta, cos_t));
        }
        let local = warp::cosine_hemisphere([u[1], u[2]]);
        let wi = local.with_z(local.z.copysign(wo.z));
        let value = self.base(reflected, wi, eta, base);
        (value.pdf_solid_angle > 0.0).then(|| BsdfSample {
            wi,
            weight: value.f_cos * (1.0 / value.pdf_solid_angle),
            pdf_solid_angle: Some(value.pdf_solid_angle),
            scatter: Scatter::Diffuse,
            eta_squared: 1.0,
        })
    }
}

/// Share of evenly arriving light that passes a smooth boundary: 2 ∫ (1 − F(μ)) μ dμ.
fn passing_mean(eta: f32) -> f32 {
    // Midpoints in μ², in which the weight is even; towards the thinner side only the cone inside the critical angle
    // passes, so the points are laid there. 32 points: within 10⁻³ of the integral for η from 1 to 3.
    const POINTS: u32 = 32;
    let first = (1.0 - eta * eta).max(0.0);
    let sum: f32 = (0..POINTS)
        .map(|i| {
            let mu2 = first + (1.0 - first) * (i as f32 + 0.5) / POINTS as f32;
            1.0 - fresnel_dielectric(mu2.sqrt(), eta).0
        })
        .sum();
    (sum / POINTS as f32 * (1.0 - first)).max(1e-6)
}
