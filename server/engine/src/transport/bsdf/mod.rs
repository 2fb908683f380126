//! How a surface scatters light: a closed set of models, each a sum of lobes.
//!
//! Directions are in the shading frame (z = the shading normal on the side of `wo`), unit length, and point away
//! from the surface. Every lobe is sampled on its own, so that a path knows which lobe it took and with it its
//! [`Scatter`]; a sample's weight is f · cos / (chance of the lobe · density), which keeps the sum over lobes unbiased.
//!
//! - Lambert: albedo / π.
//! - Gltf: glTF 2.0 metallic-roughness, appendix B: a GGX lobe (height-correlated Smith masking, Schlick
//!   Fresnel) over a Lambert base. **Stated loss**: light that would bounce between microfacets more than once
//!   is lost, as in Mitsuba's and glTF's own model: a white metal in a white furnace loses 0.6 % at roughness
//!   0.2, 6.0 % at 0.4, 19.7 % at 0.6 and 59 % at 1 (checked in `tests.rs`).
//! - Mirror: reflectance = base colour at every angle (no Fresnel rise, as in the contract's references).
//! - Glass: smooth dielectric boundary with exact Fresnel terms and its base colour on what passes; a share of
//!   what enters may be diffuse (`transmission` below 1).
//!
//! GGX with α below 10⁻³ (roughness below 0.032) is treated as a mirror: the lobe is then narrower than any
//! pixel, and single precision can no longer evaluate it.

mod base;
mod ggx;
mod glass;
mod gltf;
#[cfg(test)]
mod tests;

use glam::Vec3;

pub use self::{
    base::{CoatedBase, EVEN_RISE, schlick_rise},
    glass::Glass,
    gltf::Gltf,
};
use super::Scatter;
use crate::math::{Rgb, warp};

/// GGX α below which a lobe counts as a perfect mirror.
pub const SMOOTH_ALPHA: f32 = 1e-3;

/// GGX α from which on photons are gathered for a lobe: some six degrees wide.
pub const BROAD_ALPHA: f32 = 0.1;

/// A scattering model with its parameters at one surface point.
#[derive(Clone, Copy, Debug)]
pub enum Bsdf {
    /// Nothing is scattered.
    Black,
    /// Lambertian reflection.
    Lambert {
        /// Reflected share.
        albedo: Rgb,
    },
    /// glTF metallic-roughness.
    Gltf(Gltf),
    /// Perfect mirror.
    Mirror {
        /// Reflected share.
        reflectance: Rgb,
    },
    /// Smooth dielectric boundary.
    Glass(Glass),
}

/// f · |cos θᵢ| of the lobes that have a density, with the density (chance of the lobe included) of sampling `wi`.
#[derive(Clone, Copy, Debug, Default)]
pub struct BsdfValue {
    /// Diffuse lobe.
    pub diffuse: LobeValue,
    /// Glossy lobe.
    pub glossy: LobeValue,
}

/// One lobe's part of a [`BsdfValue`].
#[derive(Clone, Copy, Debug, Default)]
pub struct LobeValue {
    /// f · |cos θᵢ|, 1/sr.
    pub f_cos: Rgb,
    /// Density of `sample` to take this lobe and this direction, 1/sr.
    pub pdf_solid_angle: f32,
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Sampled direction, shading frame.
    pub wi: Vec3,
    /// f · |cos θᵢ| / pdf of the lobe taken, its chance included.
    pub weight: Rgb,
    /// Density of this lobe and direction, 1/sr; `None` for a mirror or glass direction (a delta).
    pub pdf_solid_angle: Option<f32>,
    /// Diffuse or not.
    pub scatter: Scatter,
    /// Relative index of refraction squared that radiance was scaled by on passing the boundary; 1 for reflection.
    /// Russian roulette undoes it, since the scale returns on the way out.
    pub eta_squared: f32,
}

impl Bsdf {
    /// True when light sampling can reach it: some lobe has a density.
    pub fn has_density(&self) -> bool {
        match self {
            Bsdf::Black | Bsdf::Mirror { .. } => false,
            Bsdf::Lambert { .. } => true,
            Bsdf::Gltf(gltf) => gltf.has_density(),
            Bsdf::Glass(glass) => glass.has_density(),
        }
    }

    /// True when it has a diffuse lobe.
    pub fn has_diffuse(&self) -> bool {
        match self {
            Bsdf::Black | Bsdf::Mirror { .. } => false,
            Bsdf::Lambert { .. } => true,
            Bsdf::Gltf(gltf) => gltf.has_diffuse(),
            Bsdf::Glass(glass) => glass.has_density(),
        }
    }

    /// True when it scatters nothing but what it mirrors and what lies behind it: some light goes on, and no lobe has a density.
    pub fn is_clear(&self) -> bool {
        !matches!(self, Bsdf::Black) && !self.has_density()
    }

    /// True when most of what a [clear](Bsdf::is_clear) surface shows comes from the side of `wi`: what glass reflects or what passes it,
    /// whichever is more.
    pub fn shows_most_from(&self, wo: Vec3, wi: Vec3) -> bool {
        match self {
            Bsdf::Glass(glass) => glass.shows_most_from(wo, wi),
            _ => true,
        }
    }

    /// True when its glossy lobe is so broad that light can be gathered for it from photons nearby.
    pub fn has_broad_gloss(&self) -> bool {
        matches!(self, Bsdf::Gltf(gltf) if gltf.alpha() >= BROAD_ALPHA)
    }

    /// What the diffuse lobe sends to `wo` (frame coordinates) of light from all around, over its irradiance, 1/sr.
    pub fn diffuse_of_even_light(&self, wo: Vec3) -> Rgb {
        self.diffuse_of_light(wo, EVEN_RISE)
    }

    /// The same of other light.
    ///
    /// - `rise`: mean of [`schlick_rise`] over its irradiance, 0 to 1
    pub fn diffuse_of_light(&self, wo: Vec3, rise: f32) -> Rgb {
        match self {
            Bsdf::Black | Bsdf::Mirror { .. } => Rgb::BLACK,
            Bsdf::Lambert { albedo } => *albedo * std::f32::consts::FRAC_1_PI,
            Bsdf::Gltf(gltf) => gltf.diffuse_of_light(wo, rise),
            Bsdf::Glass(glass) => glass.diffuse_of_even_light(wo),
        }
    }

    /// The diffuse lobe towards `wo` (frame coordinates), where it is a Lambert lobe or one under glTF's coat.
    pub fn coated_base(&self, wo: Vec3) -> Option<CoatedBase> {
        match self {
            Bsdf::Lambert { albedo } => Some(CoatedBase::lambert(*albedo)),
            Bsdf::Gltf(gltf) => Some(gltf.coated_base(wo)),
            Bsdf::Black | Bsdf::Mirror { .. } | Bsdf::Glass(_) => None,
        }
    }

    /// Share of light from straight ahead that is scattered, for the albedo layer.
    pub fn albedo(&self) -> Rgb {
        match self {
            Bsdf::Black => Rgb::BLACK,
            Bsdf::Lambert { albedo } => *albedo,
            Bsdf::Gltf(gltf) => gltf.albedo(),
            Bsdf::Mirror { reflectance } => *reflectance,
            Bsdf::Glass(glass) => glass.albedo(),
        }
    }

    /// Values and densities for light from `wi` to `wo`.
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> BsdfValue {
        if wo.z * wi.z <= 0.0 {
            return BsdfValue::default();
        }
        match self {
            Bsdf::Black | Bsdf::Mirror { .. } => BsdfValue::default(),
            Bsdf::Lambert { albedo } => {
                BsdfValue { diffuse: CoatedBase::lambert(*albedo).value(wi, 1.0), ..BsdfValue::default() }
            }
            Bsdf::Gltf(gltf) => gltf.eval(wo, wi),
            Bsdf::Glass(glass) => glass.eval(wo, wi),
        }
    }

    /// The diffuse lobe's part of [`Bsdf::eval`].
    pub fn eval_diffuse(&self, wo: Vec3, wi: Vec3) -> LobeValue {
        match self {
            Bsdf::Gltf(gltf) if wo.z * wi.z > 0.0 => gltf.eval_diffuse(wo, wi),
            _ => self.eval(wo, wi).diffuse,
        }
    }

    /// Draws a direction with the numbers `u` (lobe, two for the direction). `None`: the light is absorbed.
    pub fn sample(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        match self {
            Bsdf::Black => None,
            Bsdf::Lambert { albedo } => sample_lambert(*albedo, wo, [u[1], u[2]], 1.0),
            Bsdf::Gltf(gltf) => gltf.sample(wo, u),
            Bsdf::Mirror { reflectance } => Some(BsdfSample {
                wi: Vec3::new(-wo.x, -wo.y, wo.z),
                weight: *reflectance,
                pdf_solid_angle: None,
                scatter: Scatter::Specular,
                eta_squared: 1.0,
            }),
            Bsdf::Glass(glass) => glass.sample(wo, u),
        }
    }
}

impl Bsdf {
    /// What passes the boundary of glass, all of it; `None` where nothing does. A path along it carries as much as many drawn by
    /// [`Bsdf::sample`] do on average.
    pub fn passing(&self, wo: Vec3) -> Option<BsdfSample> {
        match self {
            Bsdf::Glass(glass) => glass.passing(wo),
            Bsdf::Black | Bsdf::Lambert { .. } | Bsdf::Gltf(_) | Bsdf::Mirror { .. } => None,
        }
    }

    /// Draws a direction as [`Bsdf::sample`] does, but of the lobes that are not diffuse alone: their whole light is in it.
    /// `None`: nothing goes on.
    pub fn sample_specular(&self, wo: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        match self {
            Bsdf::Black | Bsdf::Lambert { .. } => None,
            Bsdf::Gltf(gltf) => gltf.sample_specular_alone(wo, [u[1], u[2]]),
            Bsdf::Mirror { .. } => self.sample(wo, u),
            Bsdf::Glass(glass) => glass.sample_specular(wo, u),
        }
    }
}

fn sample_lambert(albedo: Rgb, wo: Vec3, u: [f32; 2], chance: f32) -> Option<BsdfSample> {
    let mut wi = warp::cosine_hemisphere(u);
    let pdf = warp::cosine_hemisphere_pdf(wi.z) * chance;
    if pdf <= 0.0 || chance <= 0.0 {
        return None;
    }
    wi.z = wi.z.copysign(wo.z);
    // f cos / pdf = (albedo/π · cos) / (cos/π · chance): the cosine cancels.
    Some(BsdfSample {
        wi,
        weight: albedo * (1.0 / chance),
        pdf_solid_angle: Some(pdf),
        scatter: Scatter::Diffuse,
        eta_squared: 1.0,
    })
}
