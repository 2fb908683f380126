//! glTF 2.0 metallic-roughness with `KHR_materials_specular` and `_ior` (appendix B of the specification).
//!
//! dielectric = base under a coat + F · GGX,  metal = F · GGX,  material = mix(dielectric, metal, metallic).
//!
//! **Where we leave glTF:** its base is weighed by 1 − F(half vector), which sends back up to a fifth more light than
//! arrives at grazing angles (2.4 % over a ball in a white furnace). Ours is weighed by (1 − F(n·wo)) (1 − F(n·wi)) and
//! normalised [Kulla2017, eq. 9]: reciprocal as well, and base and coat together never exceed 1.

use glam::Vec3;

use super::{BsdfSample, BsdfValue, CoatedBase, EVEN_RISE, LobeValue, SMOOTH_ALPHA, ggx::Ggx, schlick_rise};
use crate::{
    math::{Rgb, warp},
    transport::Scatter,
};

/// Metallic-roughness surface at one point.
#[derive(Clone, Copy, Debug)]
pub struct Gltf {
    /// Albedo of the Lambert base of the dielectric share: base colour · (1 − metallic).
    diffuse: Rgb,
    /// 0 dielectric … 1 metal.
    metallic: f32,
    /// Fresnel reflectance at normal incidence of dielectric and metal.
    dielectric_f0: Rgb,
    dielectric_f90: f32,
    metal_f0: Rgb,
    alpha: f32,
}

impl Gltf {
    /// A surface from the inputs of the material at one point, all in range.
    pub fn new(
        base_color: Rgb,
        metallic: f32,
        roughness: f32,
        ior: f32,
        specular: f32,
        specular_color: Rgb,
    ) -> Gltf {
        let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
        Gltf {
            diffuse: base_color * (1.0 - metallic),
            metallic,
            dielectric_f0: specular_color.map(|c| (c * f0).min(1.0)) * specular,
            dielectric_f90: specular,
            metal_f0: base_color,
            alpha: roughness * roughness,
        }
    }

    pub(super) fn has_density(&self) -> bool {
        !self.is_smooth() || !self.diffuse.is_black()
    }

    /// See [`super::Bsdf::diffuse_of_light`].
    pub(super) fn diffuse_of_light(&self, wo: Vec3, rise: f32) -> Rgb {
        if wo.z > 0.0 {
            let base = self.coated_base(wo);
            base.scale * (1.0 - base.rise * rise)
        } else {
            Rgb::BLACK
        }
    }

    pub(super) fn has_diffuse(&self) -> bool {
        !self.diffuse.is_black()
    }

    pub(super) fn alpha(&self) -> f32 {
        self.alpha
    }

    fn is_smooth(&self) -> bool {
        self.alpha < SMOOTH_ALPHA
    }

    pub(super) fn albedo(&self) -> Rgb {
        self.diffuse * self.passing(1.0) + self.reflected(1.0)
    }

    /// Fresnel reflectance of the dielectric at `cos`.
    fn dielectric(&self, cos: f32) -> Rgb {
        let rise = schlick_rise(cos);
        self.dielectric_f0.map(|f0| f0 + (self.dielectric_f90 - f0).max(0.0) * rise)
    }

    /// Fresnel reflectance of the whole surface at `cos`.
    fn reflected(&self, cos: f32) -> Rgb {
        let rise = schlick_rise(cos);
        let metal = self.metal_f0.map(|f0| f0 + (1.0 - f0) * rise);
        self.dielectric(cos) * (1.0 - self.metallic) + metal * self.metallic
    }

    /// Share that the coat lets through to the base at `cos`: by the channel it reflects best, so that no hue is
    /// gained below a coloured coat.
    fn passing(&self, cos: f32) -> f32 {
        1.0 - self.dielectric(cos).max_component()
    }

    /// Share of evenly arriving light that the coat lets through: 1 − 2 ∫ F μ dμ, for Schlick's F in closed form.
    fn passing_mean(&self) -> f32 {
        let f0 = self.dielectric_f0.max_component();
        (1.0 - f0 - (self.dielectric_f90 - f0).max(0.0) * EVEN_RISE).max(1e-6)
    }

    /// See [`super::Bsdf::coated_base`].
    pub(super) fn coated_base(&self, wo: Vec3) -> CoatedBase {
        let f0 = self.dielectric_f0.max_component();
        let ahead = 1.0 - f0;
        if !(ahead > 0.0) {
            return CoatedBase::default();
        }
        let share = self.passing(wo.z.abs()) * ahead / self.passing_mean();
        let rise = (self.dielectric_f90 - f0).max(0.0) / ahead;
        CoatedBase { scale: self.diffuse * (share * std::f32::consts::FRAC_1_PI), rise }
    }

    /// f · |cos θᵢ| of the base and its density when it is taken with `chance`.
    fn base(&self, wo: Vec3, wi: Vec3, chance: f32) -> LobeValue {
        self.coated_base(wo).value(wi, chance)
    }

    /// Chance of taking the specular lobe, by what each lobe sends back towards `wo`.
    fn specular_chance(&self, wo: Vec3) -> f32 {
        let specular = self.reflected(wo.z.abs()).luminance();
        let diffuse = self.diffuse.luminance() * self.passing(wo.z.abs());
        if diffuse <= 0.0 {
            return 1.0;
        }
        if specular <= 0.0 {
            return 0.0;
        }
        // At least a tenth for either: at grazing half vectors a lobe may be stronger than it looks from `wo`.
        (specular / (specular + diffuse)).clamp(0.1, 0.9)
    }

    /// See [`super::Bsdf::eval_diffuse`].
    pub(super) fn eval_diffuse(&self, wo: Vec3, wi: Vec3) -> LobeValue {
        let [wo, wi] = [wo, wi].map(|w| w.with_z(w.z.abs()));
        self.base(wo, wi, 1.0 - self.specular_chance(wo))
    }

    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> BsdfValue {
        // Both on the upper side: the model is two-sided and symmetric in z.
        let (wo, wi) = (Vec3::new(wo.x, wo.y, wo.z.abs()), Vec3::new(wi.x, wi.y, wi.z.abs()));
        let specular_chance = self.specular_chance(wo);
        let diffuse = self.base(wo, wi, 1.0 - specular_chance);
        let Some(m) = (wo + wi).try_normalize().filter(|_| !self.is_smooth()) else {
            return BsdfValue { diffuse, ..BsdfValue::default() };
        };
        let ggx = Ggx { alpha: self.alpha };
        // f cos θᵢ = F D G₂ / (4 cos θₒ cos θᵢ) · cos θᵢ
        let f_cos = self.reflected(wo.dot(m)) * (ggx.d(m) * ggx.g2(wo, wi) / (4.0 * wo.z));
        // dω_m / dωᵢ = 1 / (4 wo·m)
        let pdf = ggx.visible_pdf(wo, m) / (4.0 * wo.dot(m));
        let glossy = LobeValue { f_cos, pdf_solid_angle: pdf * specular_chance };
        BsdfValue { diffuse, glossy }
    }

    pub(super) fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let side = 1f32.copysign(wo.z);
        let wo = wo * Vec3::new(1.0, 1.0, side);
        if wo.z <= 0.0 {
            return None;
        }
        let specular_chance = self.specular_chance(wo);
        let mut sample = if u[0] < specular_chance {
            self.sample_specular(wo, [u[1], u[2]], specular_chance)?
        } else {
            self.sample_diffuse(wo, [u[1], u[2]], 1.0 - specular_chance)?
        };
        sample.wi.z *= side;
        Some(sample)
    }

    /// A sample of the specular lobe as if there was no other.
    pub(super) fn sample_specular_alone(&self, wo: Vec3, u: [f32; 2]) -> Option<BsdfSample> {
        let side = 1f32.copysign(wo.z);
        let wo = wo * Vec3::new(1.0, 1.0, side);
        if wo.z <= 0.0 {
            return None;
        }
        let mut sample = self.sample_specular(wo, u, 1.0)?;
        sample.wi.z *= side;
        Some(sample)
    }

    fn sample_diffuse(&self, wo: Vec3, u: [f32; 2], chance: f32) -> Option<BsdfSample> {
        let wi = warp::cosine_hemisphere(u);
        let value = self.base(wo, wi, chance);
        (value.pdf_solid_angle > 0.0).then(|| BsdfSample {
            wi,
            weight: value.f_cos * (1.0 / value.pdf_solid_angle),
            pdf_solid_angle: Some(value.pdf_solid_angle),
            scatter: Scatter::Diffuse,
            eta_squared: 1.0,
        })
    }

    fn sample_specular(&self, wo: Vec3, u: [f32; 2], chance: f32) -> Option<BsdfSample> {
        let specular = |wi, weight, pdf_solid_angle| BsdfSample {
            wi,
            weight,
            pdf_solid_angle,
            scatter: Scatter::Specular,
            eta_squared: 1.0,
        };
        if self.is_smooth() {
            let weight = self.reflected(wo.z) * (1.0 / chance);
            return Some(specular(Vec3::new(-wo.x, -wo.y, wo.z), weight, None));
        }
        let ggx = Ggx { alpha: self.alpha };
        let m = ggx.sample_visible(wo, u);
        let wi = m * (2.0 * wo.dot(m)) - wo;
        let pdf = ggx.visible_pdf(wo, m) / (4.0 * wo.dot(m));
        if wi.z <= 0.0 || !(pdf > 0.0) {
            return None;
        }
        // f cos / pdf = F D G₂/(4 cosₒ) · 4 (wo·m) cosₒ / (G₁ (wo·m) D) = F G₂/G₁.
        let weight = self.reflected(wo.dot(m)) * (ggx.g2(wo, wi) / (ggx.g1(wo) * chance));
        Some(specular(wi, weight, Some(pdf * chance)))
    }
}
