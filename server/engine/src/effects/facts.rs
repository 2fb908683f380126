//! Numbers about a scene that decide which effects it can show.

use crate::{
    scene::{Material, TextureSlot},
    transport::bsdf::SMOOTH_ALPHA,
};

/// What the placed objects of a scene are made of and lit by. Counts of materials are counts of placed ones.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SceneFacts {
    /// Triangles over all instances.
    pub triangles: u64,
    /// Triangles over all instances that send out light.
    pub emissive_triangles: u64,
    /// Point, spot and directional lights that are not black.
    pub punctual_lights: usize,
    /// Light arrives from around the scene.
    pub environment_is_lit: bool,
    /// Materials on placed triangles.
    pub materials: usize,
    /// Materials with a diffuse lobe that reflects anything.
    pub diffuse: usize,
    /// Materials with a specular lobe that has a width.
    pub glossy: usize,
    /// Materials with a specular lobe without width, glass apart.
    pub mirror: usize,
    /// Materials that light passes through.
    pub glass: usize,
    /// Materials that colour the light inside them.
    pub absorbing: usize,
    /// Materials with any texture.
    pub textured: usize,
    /// Materials with a normal map.
    pub normal_mapped: usize,
    /// Materials with an alpha mask.
    pub masked: usize,
}

impl SceneFacts {
    /// Calls `step` with every number that a placed material counts for.
    pub(super) fn count(&mut self, material: &Material, mut step: impl FnMut(&mut usize)) {
        let mut add = |number: &mut usize, is_so: bool| {
            if is_so {
                step(number);
            }
        };
        add(&mut self.materials, true);
        add(&mut self.masked, material.alpha_cutoff.is_some_and(|cutoff| cutoff > 0.0));
        add(&mut self.textured, material.textures.iter().any(Option::is_some));
        if material.unlit {
            return;
        }
        add(&mut self.normal_mapped, material.texture(TextureSlot::Normal).is_some());
        add(&mut self.diffuse, has_diffuse_lobe(material));
        // Where metallic is 1 nothing passes, and where transmission is 0 the coat shows: textures only lower both.
        let is_glass = material.transmission > 0.0
            && (material.metallic < 1.0 || material.texture(TextureSlot::MetallicRoughness).is_some());
        let is_glass_all_over = material.transmission > 0.0
            && material.metallic < 1.0
            && material.texture(TextureSlot::Transmission).is_none();
        add(&mut self.glass, is_glass);
        let is_coloured = material.attenuation_color.to_array() != [1.0; 3];
        add(&mut self.absorbing, is_glass && is_coloured && material.attenuation_distance_m.is_finite());
        let is_specular = !is_glass_all_over && has_specular_lobe(material);
        let can_be_smooth = material.roughness * material.roughness < SMOOTH_ALPHA
            || material.texture(TextureSlot::MetallicRoughness).is_some();
        let can_be_rough = material.roughness * material.roughness >= SMOOTH_ALPHA;
        add(&mut self.mirror, is_specular && can_be_smooth);
        add(&mut self.glossy, is_specular && can_be_rough);
    }

    /// Something sends out light.
    pub fn is_lit(&self) -> bool {
        self.emissive_triangles > 0 || self.punctual_lights > 0 || self.environment_is_lit
    }

    /// Some light may take ways that a path from the eye cannot find: from a light without size by a mirror or clear glass. Of a sun behind panes
    /// it finds what comes straight.
    pub fn hides_light(&self) -> bool {
        self.punctual_lights > 0 && (self.mirror > 0 || self.glass > 0)
    }

    /// Some placed material has a specular lobe of any kind.
    pub fn is_specular(&self) -> bool {
        self.glossy > 0 || self.mirror > 0 || self.glass > 0
    }
}

/// Textures only lower metallic and transmission, so these two may say yes too often, never too rarely.
fn has_diffuse_lobe(material: &Material) -> bool {
    let has_metal_texture = material.texture(TextureSlot::MetallicRoughness).is_some();
    let is_all_metal = material.metallic >= 1.0 && !has_metal_texture;
    let is_all_glass = material.transmission >= 1.0 && material.texture(TextureSlot::Transmission).is_none();
    !material.base_color.is_black() && !is_all_metal && !is_all_glass
}

fn has_specular_lobe(material: &Material) -> bool {
    // Metal of black base colour still reflects white at grazing angles, and counts.
    material.metallic > 0.0 || material.specular > 0.0
}
