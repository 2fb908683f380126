//! Materials → metallic-roughness with the extensions that they need.

use lumicast_engine::{
    math::Rgb,
    scene::{Id, Material, Scene, TextureRef, TextureSlot},
};
use serde_json::{Map, Value, json};

use super::{Output, factor_and_strength, pictures::Written};

/// All materials, in the scene's order, at the same indices.
pub(super) fn write(scene: &Scene, pictures: &Written, output: &mut Output) -> Vec<Value> {
    scene.materials().iter().map(|(id, material)| Writer { id, material, pictures, output }.write()).collect()
}

struct Writer<'a> {
    id: &'a Id,
    material: &'a Material,
    pictures: &'a Written,
    output: &'a mut Output,
}

impl Writer<'_> {
    fn write(mut self) -> Value {
        let material = self.material;
        let [r, g, b] = material.base_color.to_array();
        let mut pbr = json!({
            "baseColorFactor": [r, g, b, material.alpha],
            "metallicFactor": material.metallic,
            "roughnessFactor": material.roughness,
        });
        self.texture(TextureSlot::BaseColor, &mut pbr, "baseColorTexture");
        self.texture(TextureSlot::MetallicRoughness, &mut pbr, "metallicRoughnessTexture");
        let mut json = json!({ "name": self.id.as_str(), "pbrMetallicRoughness": pbr });
        if material.double_sided {
            json["doubleSided"] = json!(true);
        }
        if let Some(cutoff) = material.alpha_cutoff {
            json["alphaMode"] = json!("MASK");
            json["alphaCutoff"] = json!(cutoff);
        }
        self.texture(TextureSlot::Normal, &mut json, "normalTexture");
        if json.get("normalTexture").is_some() {
            json["normalTexture"]["scale"] = json!(material.normal_scale);
        }
        let baked = material
            .texture(TextureSlot::Emission)
            .map_or(1.0, |texture| self.pictures.scale_of(&texture.texture));
        let (factor, strength) = factor_and_strength(material.emission * baked);
        json["emissiveFactor"] = json!(factor);
        self.texture(TextureSlot::Emission, &mut json, "emissiveTexture");
        let extensions = self.extensions(strength);
        if !extensions.is_empty() {
            json["extensions"] = Value::Object(extensions);
        }
        json
    }

    fn extensions(&mut self, emissive_strength: f32) -> Map<String, Value> {
        let material = self.material;
        let mut extensions = Map::new();
        let mut add = |name: &'static str, value: Value| extensions.insert(name.into(), value);
        if emissive_strength != 1.0 {
            add("KHR_materials_emissive_strength", json!({ "emissiveStrength": emissive_strength }));
        }
        if material.ior != 1.5 {
            add("KHR_materials_ior", json!({ "ior": material.ior }));
        }
        let mut specular = json!({
            "specularFactor": material.specular,
            "specularColorFactor": material.specular_color.to_array(),
        });
        self.texture(TextureSlot::Specular, &mut specular, "specularTexture");
        self.texture(TextureSlot::SpecularColor, &mut specular, "specularColorTexture");
        let is_default = material.specular == 1.0 && material.specular_color == Rgb::WHITE;
        if !is_default || specular.as_object().is_some_and(|specular| specular.len() > 2) {
            add("KHR_materials_specular", specular);
        }
        let mut transmission = json!({ "transmissionFactor": material.transmission });
        self.texture(TextureSlot::Transmission, &mut transmission, "transmissionTexture");
        if material.transmission > 0.0 || transmission.get("transmissionTexture").is_some() {
            add("KHR_materials_transmission", transmission);
        }
        let is_coloured =
            material.attenuation_color != Rgb::WHITE || material.attenuation_distance_m.is_finite();
        if material.transmission > 0.0 || is_coloured {
            // Any thickness above 0 says "boundary of a solid", which glass always is here.
            let mut volume =
                json!({ "thicknessFactor": 1.0, "attenuationColor": material.attenuation_color.to_array() });
            if material.attenuation_distance_m.is_finite() {
                volume["attenuationDistance"] = json!(material.attenuation_distance_m);
            }
            add("KHR_materials_volume", volume);
        }
        if material.unlit {
            add("KHR_materials_unlit", json!({}));
        }
        const NAMES: [&str; 6] = [
            "KHR_materials_emissive_strength",
            "KHR_materials_ior",
            "KHR_materials_specular",
            "KHR_materials_transmission",
            "KHR_materials_volume",
            "KHR_materials_unlit",
        ];
        self.output.extensions.extend(NAMES.into_iter().filter(|name| extensions.contains_key(*name)));
        extensions
    }

    /// Adds the texture of a slot to `json` under `field`.
    fn texture(&mut self, slot: TextureSlot, json: &mut Value, field: &str) {
        let Some(reference) = self.material.texture(slot) else { return };
        let Some(index) = self.pictures.texture_of(reference) else { return };
        let mut info = json!({ "index": index, "texCoord": reference.texcoord_set });
        if let Some(transform) = self.transform(reference) {
            info["extensions"] = json!({ "KHR_texture_transform": transform });
            self.output.extensions.insert("KHR_texture_transform");
        }
        json[field] = info;
    }

    /// Offset, rotation and scale of a look-up: `A = R(−rotation) · S`, so the first column is
    /// (cos, −sin) · s_x, and s_y follows from the determinant. A shear is lost, and said so.
    fn transform(&mut self, reference: &TextureRef) -> Option<Value> {
        let transform = reference.uv_transform;
        if transform == glam::Affine2::IDENTITY {
            return None;
        }
        let (x, y) = (transform.matrix2.x_axis, transform.matrix2.y_axis);
        // Without a first column the second one tells the angle: it is (sin, cos) · s_y.
        let rotation = if x.length() > 0.0 { (-x.y).atan2(x.x) } else { y.x.atan2(y.y) };
        let (sin, cos) = rotation.sin_cos();
        let (scale_u, scale_v) = (x.dot(glam::Vec2::new(cos, -sin)), y.dot(glam::Vec2::new(sin, cos)));
        // 1e-4: a hundred times the rounding of the lines above.
        if y.dot(glam::Vec2::new(cos, -sin)).abs() > 1e-4 * y.length() {
            let message = format!("material {:?}: the shear of a texture transform is lost", self.id);
            self.output.warnings.push(message);
        }
        Some(
            json!({ "offset": transform.translation.to_array(), "rotation": rotation, "scale": [scale_u, scale_v] }),
        )
    }
}
