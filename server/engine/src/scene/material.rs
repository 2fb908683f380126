//! Surface materials: glTF 2.0 metallic-roughness with the extensions that the contract names.

use super::TextureRef;
use crate::math::Rgb;

/// Which input of a material a texture feeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TextureSlot {
    /// Base colour (sRGB) and alpha.
    BaseColor,
    /// Roughness in G, metallic in B.
    MetallicRoughness,
    /// Tangent-space normal.
    Normal,
    /// Emitted radiance (sRGB), times `emission`.
    Emission,
    /// Specular strength in A.
    Specular,
    /// Specular colour (sRGB).
    SpecularColor,
    /// Transmission in R.
    Transmission,
}

impl TextureSlot {
    /// Every slot, in the order of [`Material::textures`].
    pub const ALL: [TextureSlot; 7] = [
        TextureSlot::BaseColor,
        TextureSlot::MetallicRoughness,
        TextureSlot::Normal,
        TextureSlot::Emission,
        TextureSlot::Specular,
        TextureSlot::SpecularColor,
        TextureSlot::Transmission,
    ];

    /// True when the texture's RGB is sRGB-encoded colour rather than linear data.
    pub fn is_colour(self) -> bool {
        matches!(self, TextureSlot::BaseColor | TextureSlot::Emission | TextureSlot::SpecularColor)
    }
}

/// A surface material. Lambert: metallic 0, roughness 1, specular 0. Mirror: metallic 1, roughness 0.
/// Glass: transmission 1, roughness 0, `ior`.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Reflected (or transmitted) share, linear, each in [0, 1].
    pub base_color: Rgb,
    /// Opacity of the base colour, only compared with `alpha_cutoff`.
    pub alpha: f32,
    /// 0 dielectric … 1 metal.
    pub metallic: f32,
    /// Perceptual roughness in [0, 1]; GGX α = roughness².
    pub roughness: f32,
    /// Index of refraction, at least 1.
    pub ior: f32,
    /// Strength of the dielectric's specular lobe, in [0, 1].
    pub specular: f32,
    /// Colour of the dielectric's specular lobe at normal incidence, each at least 0.
    pub specular_color: Rgb,
    /// Share of the non-reflected light that passes through, in [0, 1].
    pub transmission: f32,
    /// Colour that white light turns into after `attenuation_distance_m` inside, each in [0, 1].
    pub attenuation_color: Rgb,
    /// Distance of `attenuation_color`, metres; infinite = clear.
    pub attenuation_distance_m: f32,
    /// Emitted radiance W/(m² sr), strength included.
    pub emission: Rgb,
    /// Emits from the back face too. (Reflection is two-sided always.)
    pub double_sided: bool,
    /// Shows its base colour as radiance and neither reflects nor lights anything (`KHR_materials_unlit`).
    pub unlit: bool,
    /// Surface counts as absent where alpha × texture alpha is below this.
    pub alpha_cutoff: Option<f32>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// Textures by slot, in the order of [`TextureSlot::ALL`].
    pub textures: [Option<TextureRef>; 7],
}

impl Default for Material {
    /// glTF's defaults, but a dielectric: metallic 0.
    fn default() -> Material {
        Material {
            base_color: Rgb::WHITE,
            alpha: 1.0,
            metallic: 0.0,
            roughness: 1.0,
            ior: 1.5,
            specular: 1.0,
            specular_color: Rgb::WHITE,
            transmission: 0.0,
            attenuation_color: Rgb::WHITE,
            attenuation_distance_m: f32::INFINITY,
            emission: Rgb::BLACK,
            double_sided: false,
            unlit: false,
            alpha_cutoff: None,
            normal_scale: 1.0,
            textures: [const { None }; 7],
        }
    }
}

impl Material {
    /// A Lambertian material of the contract.
    pub fn lambert(albedo: Rgb) -> Material {
        Material { base_color: albedo, specular: 0.0, ..Material::default() }
    }

    /// A black surface that emits `radiance` from its front.
    pub fn emitter(radiance: Rgb) -> Material {
        Material { emission: radiance, ..Material::lambert(Rgb::BLACK) }
    }

    /// The texture of a slot.
    pub fn texture(&self, slot: TextureSlot) -> Option<&TextureRef> {
        self.textures[slot as usize].as_ref()
    }

    /// True when some lobe of it may not be diffuse: it reflects or refracts in a direction. Textures only lower metallic and
    /// transmission, so it may say yes too often, never too rarely.
    pub fn is_specular(&self) -> bool {
        // Metal of black base colour still reflects white at grazing angles, and counts.
        !self.unlit && (self.transmission > 0.0 || self.metallic > 0.0 || self.specular > 0.0)
    }

    /// True when the material sends out light.
    pub fn is_emissive(&self) -> bool {
        !self.unlit && !self.emission.is_black()
    }
}
