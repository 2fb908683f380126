//! Materials: glTF metallic-roughness with the extensions that the contract names → engine materials.
//!
//! Numbers outside their range are clamped with a warning; numbers that are no numbers are refused.

use ::gltf::json::{
    Material as JsonMaterial, Root, extensions::texture::TextureTransform, material::AlphaMode, texture,
    validation::Checked,
};
use lumicast_engine::{
    math::Rgb,
    scene::{Material, TextureSlot},
};

use super::{
    container::label,
    textures::{self, Images, Info},
};
use crate::assets::error::{AssetError, bad};

/// The material of primitives that name none: glTF's default, a rough white metal.
pub(super) fn default_material() -> Material {
    Material { metallic: 1.0, ..Material::default() }
}

/// The textures that a material feeds from, by slot.
pub(super) fn infos(material: &JsonMaterial) -> Vec<(TextureSlot, Info)> {
    let plain = |info: &texture::Info| Info {
        texture: info.index.value(),
        texcoord_set: info.tex_coord,
        transform: info.extensions.as_ref().and_then(|extensions| extensions.texture_transform.clone()),
    };
    let pbr = &material.pbr_metallic_roughness;
    let extensions = material.extensions.as_ref();
    let specular = extensions.and_then(|extensions| extensions.specular.as_ref());
    let transmission = extensions.and_then(|extensions| extensions.transmission.as_ref());
    let normal = material.normal_texture.as_ref().map(|normal| Info {
        texture: normal.index.value(),
        texcoord_set: normal.tex_coord,
        transform: normal.extensions.as_ref().and_then(|extensions| {
            let transform = extensions.others.get("KHR_texture_transform")?.clone();
            ::gltf::json::deserialize::from_value::<TextureTransform>(transform).ok()
        }),
    });
    let slots = [
        (TextureSlot::BaseColor, pbr.base_color_texture.as_ref().map(plain)),
        (TextureSlot::MetallicRoughness, pbr.metallic_roughness_texture.as_ref().map(plain)),
        (TextureSlot::Normal, normal),
        (TextureSlot::Emission, material.emissive_texture.as_ref().map(plain)),
        (TextureSlot::Specular, specular.and_then(|specular| specular.specular_texture.as_ref()).map(plain)),
        (
            TextureSlot::SpecularColor,
            specular.and_then(|specular| specular.specular_color_texture.as_ref()).map(plain),
        ),
        (
            TextureSlot::Transmission,
            transmission.and_then(|extension| extension.transmission_texture.as_ref()).map(plain),
        ),
    ];
    slots.into_iter().filter_map(|(slot, info)| Some((slot, info?))).collect()
}

/// A material as the engine has it, and what was odd about it.
pub(super) fn load(
    root: &Root,
    index: usize,
    images: &Images,
) -> Result<(Material, Vec<String>), AssetError> {
    let json = &root.materials[index];
    let object = label("material", index, json.name.as_deref());
    let mut read = Reader { object: object.into(), warnings: Vec::new() };
    let mut material = surface(json, &mut read)?;
    for (slot, info) in infos(json) {
        match textures::reference(root, &info, images, &read.object)? {
            Ok(reference) => material.textures[slot as usize] = Some(reference),
            Err(warning) => read.warnings.push(warning.into()),
        }
    }
    if let Some(normal) = &json.normal_texture {
        material.normal_scale = read.finite("normalTexture.scale", normal.scale)?;
    }
    if material.transmission > 0.0 && material.roughness > 0.0 {
        let message = format!("lets light through with roughness {}: it is shown smooth", material.roughness);
        read.warnings.push(message);
    }
    Ok((material, read.warnings))
}

fn surface(json: &JsonMaterial, read: &mut Reader) -> Result<Material, AssetError> {
    let mut material = Material::default();
    let pbr = &json.pbr_metallic_roughness;
    let [r, g, b, alpha] = pbr.base_color_factor.0;
    material.base_color = read.share_rgb("baseColorFactor", [r, g, b])?;
    material.alpha = read.share("baseColorFactor", alpha)?;
    material.metallic = read.share("metallicFactor", pbr.metallic_factor.0)?;
    material.roughness = read.share("roughnessFactor", pbr.roughness_factor.0)?;
    material.double_sided = json.double_sided;
    material.alpha_cutoff = match json.alpha_mode {
        Checked::Valid(AlphaMode::Opaque) => None,
        Checked::Valid(AlphaMode::Mask) => {
            Some(read.at_least(0.0, "alphaCutoff", json.alpha_cutoff.unwrap_or_default().0)?)
        }
        Checked::Valid(AlphaMode::Blend) => {
            read.warnings.push("alphaMode BLEND is shown as a mask at 0.5".into());
            Some(0.5)
        }
        Checked::Invalid => {
            read.warnings.push("an unknown alphaMode is read as OPAQUE".into());
            None
        }
    };
    let emissive_factor = json.emissive_factor.0;
    let mut emissive_strength = 1.0;
    if let Some(extensions) = &json.extensions {
        material.unlit = extensions.unlit.is_some();
        if let Some(strength) = &extensions.emissive_strength {
            emissive_strength = strength.emissive_strength.0;
        }
        if let Some(ior) = &extensions.ior {
            material.ior = read.ior(ior.ior.0)?;
        }
        if let Some(specular) = &extensions.specular {
            material.specular = read.share("specularFactor", specular.specular_factor.0)?;
            let color = Rgb::from(specular.specular_color_factor.0);
            material.specular_color = read.light("specularColorFactor", color)?;
        }
        if let Some(transmission) = &extensions.transmission {
            material.transmission = read.share("transmissionFactor", transmission.transmission_factor.0)?;
        }
        if let Some(volume) = &extensions.volume {
            material.attenuation_color = read.share_rgb("attenuationColor", volume.attenuation_color.0)?;
            material.attenuation_distance_m = read.distance(volume.attenuation_distance.0)?;
        }
    }
    material.emission = read.light("emissiveFactor", Rgb::from(emissive_factor) * emissive_strength)?;
    Ok(material)
}

/// Reads numbers of one material: clamps the odd, refuses the impossible.
struct Reader {
    object: String,
    warnings: Vec<String>,
}

impl Reader {
    fn finite(&self, field: &'static str, value: f32) -> Result<f32, AssetError> {
        if value.is_finite() {
            Ok(value)
        } else {
            Err(bad(&self.object, field, format!("is {value}: must be finite")))
        }
    }

    fn clamped(&mut self, field: &'static str, value: f32, inside: f32, why: &str) -> f32 {
        if value != inside {
            self.warnings.push(format!("{field} {value} is read as {inside}: {why}"));
        }
        inside
    }

    fn share(&mut self, field: &'static str, value: f32) -> Result<f32, AssetError> {
        let value = self.finite(field, value)?;
        Ok(self.clamped(field, value, value.clamp(0.0, 1.0), "a share lies between 0 and 1"))
    }

    fn share_rgb(&mut self, field: &'static str, [r, g, b]: [f32; 3]) -> Result<Rgb, AssetError> {
        Ok(Rgb::new(self.share(field, r)?, self.share(field, g)?, self.share(field, b)?))
    }

    fn at_least(&mut self, least: f32, field: &'static str, value: f32) -> Result<f32, AssetError> {
        let value = self.finite(field, value)?;
        Ok(self.clamped(field, value, value.max(least), "less has no meaning"))
    }

    fn light(&mut self, field: &'static str, value: Rgb) -> Result<Rgb, AssetError> {
        let [r, g, b] = value.to_array();
        Ok(Rgb::new(
            self.at_least(0.0, field, r)?,
            self.at_least(0.0, field, g)?,
            self.at_least(0.0, field, b)?,
        ))
    }

    /// 0 stands for full reflection at every angle [KHR_materials_ior]; 1000 reflects 99.6 %.
    fn ior(&mut self, value: f32) -> Result<f32, AssetError> {
        let value = self.finite("ior", value)?;
        let inside = if value == 0.0 { 1000.0 } else { value.max(1.0) };
        Ok(self.clamped("ior", value, inside, "an index of refraction is at least 1"))
    }

    fn distance(&mut self, value: f32) -> Result<f32, AssetError> {
        if value > 0.0 {
            return Ok(value);
        }
        let value = self.finite("attenuationDistance", value)?;
        Ok(self.clamped("attenuationDistance", value, f32::INFINITY, "a distance is above 0"))
    }
}
