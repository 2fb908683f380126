//! A material's properties in full, as descriptions show them; the partial edit is [`crate::SetMaterial`].

use serde::{Deserialize, Serialize};

/// Every property of a material, with the meaning glTF 2.0 and its extensions give it. Where a texture is set, the
/// value here multiplies it. Colours are linear Rec.709.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MaterialProperties {
    /// Albedo of a dielectric, reflectance of a metal; 0 to 1 per channel.
    pub base_color: [f32; 3],
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// 0 smooth to 1 rough; GGX α = roughness².
    pub roughness: f32,
    /// Index of refraction, ≥ 1.
    pub ior: f32,
    /// Strength of the dielectric's Fresnel lobe, 0 to 1 (`KHR_materials_specular`).
    pub specular: f32,
    /// Its tint.
    pub specular_color: [f32; 3],
    /// Share of the light that is refracted rather than scattered, 0 to 1.
    pub transmission: f32,
    /// What remains of white light after `attenuation_distance_m` inside.
    pub attenuation_color: [f32; 3],
    /// Metres; `None` (`null`) = infinite: nothing is absorbed inside.
    pub attenuation_distance_m: Option<f32>,
    /// Emitted radiance in W/(m² sr).
    pub emission: [f32; 3],
    /// Shades (and emits) on both sides.
    pub double_sided: bool,
    /// Shows its base colour and takes part in no light transport.
    pub unlit: bool,
    /// Where alpha is below it there is a hole; `None` (`null`) = opaque.
    pub alpha_cutoff: Option<f32>,
    /// Factor on the normal map's slope.
    pub normal_scale: f32,
}

impl Default for MaterialProperties {
    /// The material that `set_material` with `create` starts from: white, dielectric, fully rough, and without the
    /// Fresnel lobe, so that a bare new material is exactly Lambertian (`specular` 0 differs from glTF's 1).
    fn default() -> Self {
        Self {
            base_color: [1.0; 3],
            metallic: 0.0,
            roughness: 1.0,
            ior: 1.5,
            specular: 0.0,
            specular_color: [1.0; 3],
            transmission: 0.0,
            attenuation_color: [1.0; 3],
            attenuation_distance_m: None,
            emission: [0.0; 3],
            double_sided: false,
            unlit: false,
            alpha_cutoff: None,
            normal_scale: 1.0,
        }
    }
}

/// A place in a material where a texture may stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are glTF's and say it")]
pub enum TextureSlot {
    BaseColor,
    MetallicRoughness,
    Normal,
    Emission,
    Specular,
    SpecularColor,
    Transmission,
}
