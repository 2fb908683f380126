//! What surfaces look like and lights send out, packed for the GPU: what edits change most often, and little of a scene.

use std::{collections::HashMap, sync::Arc};

use bytemuck::Zeroable;

use super::{ABSENT, GpuLight, GpuLightNode, GpuMaterial, GpuSceneHeader, GpuTextureUse};
use crate::{
    math::{Rgb, sobol},
    scene::{Filter, Material, Texels, Texture, TextureSlot, Wrap, linear_from_srgb},
    transport::{World, surface::PreparedMaterial},
};

/// [`GpuTextureUse::flags`]: there is a texture.
const TEXTURE_IS_THERE: u32 = 1;
/// … it is looked up by the second set of coordinates.
const TEXTURE_SECOND_SET: u32 = 2;
/// … its nearest texel counts alone.
const TEXTURE_NEAREST: u32 = 4;
/// … its texels are floats.
const TEXTURE_FLOATS: u32 = 8;
/// … its bytes are sRGB.
const TEXTURE_SRGB: u32 = 16;
/// … where the wraps of u and v begin, two bits each.
const TEXTURE_WRAP_SHIFTS: [u32; 2] = [8, 10];

/// What [`GpuTextureUse::flags`] is read by, under the names that steps have for it.
pub const TEXTURE_FLAGS: [(&str, u32); 7] = [
    ("TEXTURE_IS_THERE", TEXTURE_IS_THERE),
    ("TEXTURE_SECOND_SET", TEXTURE_SECOND_SET),
    ("TEXTURE_NEAREST", TEXTURE_NEAREST),
    ("TEXTURE_FLOATS", TEXTURE_FLOATS),
    ("TEXTURE_SRGB", TEXTURE_SRGB),
    ("TEXTURE_WRAP_U_SHIFT", TEXTURE_WRAP_SHIFTS[0]),
    ("TEXTURE_WRAP_V_SHIFT", TEXTURE_WRAP_SHIFTS[1]),
];

/// What a scene calls for: steps are compiled without what it does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct WorldFeatures {
    /// Some surface is cut by an alpha mask.
    pub has_masks: bool,
    /// Some material has a texture.
    pub has_textures: bool,
    /// Some material lets light through.
    pub has_glass: bool,
    /// Some material has a gloss or is part metal.
    pub has_gltf: bool,
    /// The environment is a picture.
    pub has_sky_picture: bool,
}

/// What surfaces look like and lights send out, ready to be copied into buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct AppearanceBuffers {
    /// What says how the rest is read.
    pub header: GpuSceneHeader,
    /// Materials.
    pub materials: Vec<GpuMaterial>,
    /// Sums of Sobol's direction numbers (4,096 words), linear values of sRGB bytes (256), ways to the lights (two each),
    /// running sums of the environment.
    pub tables: Vec<u32>,
    /// Local lights by the index that the tree names, then directional ones.
    pub lights: Vec<GpuLight>,
    /// The tree over local lights.
    pub light_nodes: Vec<GpuLightNode>,
    /// What the scene calls for.
    pub features: WorldFeatures,
}

impl AppearanceBuffers {
    /// Bytes to upload.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.header)
            + size_of_val(&*self.materials)
            + size_of_val(&*self.tables)
            + size_of_val(&*self.lights)
            + size_of_val(&*self.light_nodes)
    }
}

/// Where each texture's words lie, each texture once.
#[derive(Default)]
pub(in crate::transport) struct PlacedTextures {
    textures: Vec<Arc<Texture>>,
    places: HashMap<*const Texture, u32>,
    word_count: usize,
}

impl PlacedTextures {
    /// Those of materials, then that of the environment.
    pub(super) fn of(world: &World) -> PlacedTextures {
        let mut placed = PlacedTextures::default();
        let of_materials = world
            .materials()
            .iter()
            .flat_map(|material| TextureSlot::ALL.into_iter().filter_map(|slot| material.texture(slot)));
        of_materials.chain(world.lights().environment_texture()).for_each(|texture| placed.add(texture));
        placed
    }

    fn add(&mut self, texture: &Arc<Texture>) {
        let words = word_count_of(texture);
        if words > 0 && !self.places.contains_key(&Arc::as_ptr(texture)) {
            self.places.insert(Arc::as_ptr(texture), self.word_count as u32);
            self.textures.push(Arc::clone(texture));
            self.word_count += words;
        }
    }

    /// The texture's first word; [`ABSENT`] for an empty one.
    pub(in crate::transport) fn place(&self, texture: &Arc<Texture>) -> u32 {
        self.places.get(&Arc::as_ptr(texture)).copied().unwrap_or(ABSENT)
    }

    /// All of them, as they were placed.
    pub(super) fn texels(&self) -> Vec<u32> {
        let mut texels = Vec::with_capacity(self.word_count);
        for texture in &self.textures {
            match &texture.texels {
                Texels::Rgba8(bytes) => texels.extend(bytes.iter().map(|texel| u32::from_ne_bytes(*texel))),
                Texels::Rgba32F(floats) => texels.extend(floats.as_flattened().iter().map(|x| x.to_bits())),
            }
        }
        texels
    }

    /// The same textures at the same places.
    fn is_like(&self, other: &PlacedTextures) -> bool {
        let pairs = self.textures.iter().zip(&other.textures);
        self.textures.len() == other.textures.len() && pairs.into_iter().all(|(a, b)| Arc::ptr_eq(a, b))
    }
}

fn word_count_of(texture: &Texture) -> usize {
    match &texture.texels {
        Texels::Rgba8(bytes) => bytes.len(),
        Texels::Rgba32F(floats) => floats.as_flattened().len(),
    }
}

/// Flag of textures whose texels are floats.
pub(in crate::transport) fn kind_flag(texture: &Texture) -> u32 {
    if matches!(texture.texels, Texels::Rgba32F(_)) { TEXTURE_FLOATS } else { 0 }
}

impl WorldFeatures {
    /// What a scene calls for.
    fn of(world: &World) -> WorldFeatures {
        let is_made_of =
            |what: fn(&Material) -> bool| world.materials().iter().any(|material| what(material.material()));
        WorldFeatures {
            has_masks: is_made_of(|material| material.alpha_cutoff.is_some()),
            has_textures: world
                .materials()
                .iter()
                .any(|material| TextureSlot::ALL.iter().any(|slot| material.texture(*slot).is_some())),
            has_glass: is_made_of(|material| material.transmission > 0.0),
            has_gltf: is_made_of(|material| material.is_specular()),
            has_sky_picture: world.lights().environment_texture().is_some(),
        }
    }
}

impl World {
    pub(super) fn appearance(&self, textures: &PlacedTextures) -> AppearanceBuffers {
        let materials = self.materials().iter().map(|material| material_of(material, textures)).collect();
        let mut tables: Vec<u32> = sobol::mirrored_byte_sums().as_flattened().as_flattened().to_vec();
        tables.extend(linear_from_srgb().iter().map(|value| value.to_bits()));
        let packed = self.lights().upload(&mut tables, textures);
        AppearanceBuffers {
            header: packed.header,
            materials,
            tables,
            lights: packed.lights,
            light_nodes: packed.light_nodes,
            features: WorldFeatures::of(self),
        }
    }

    /// Bytes of what surfaces look like and lights send out, about.
    pub fn appearance_bytes(&self) -> usize {
        size_of_val(self.materials()) + self.lights().bytes()
    }

    /// What is to be uploaded in place of the [same](super::WorldBuffers::appearance) of an earlier state of the scene; `None` where more
    /// than that differs: things moved, came or went, another texture is there, or other triangles emit.
    pub fn appearance_after(&self, before: &World) -> Option<AppearanceBuffers> {
        let textures = PlacedTextures::of(self);
        let is_alike = self.accel().is_like(before.accel())
            && self.is_made_like(before)
            && (0..self.accel().instances().len())
                .all(|instance| self.lights().emits_like(before.lights(), instance))
            && textures.is_like(&PlacedTextures::of(before));
        is_alike.then(|| self.appearance(&textures))
    }
}

fn material_of(prepared: &PreparedMaterial, textures: &PlacedTextures) -> GpuMaterial {
    let material = prepared.material();
    let texture = |slot: TextureSlot| {
        let (Some(reference), Some(texture)) = (material.texture(slot), prepared.texture(slot)) else {
            return GpuTextureUse::zeroed();
        };
        let wrap = |wrap: Wrap, shift: u32| match wrap {
            Wrap::Repeat => 0,
            Wrap::Mirror => 1 << shift,
            Wrap::Clamp => 2 << shift,
        };
        let set = if reference.texcoord_set > 0 { TEXTURE_SECOND_SET } else { 0 };
        let nearest = if reference.filter == Filter::Nearest { TEXTURE_NEAREST } else { 0 };
        let srgb = if slot.is_colour() { TEXTURE_SRGB } else { 0 };
        GpuTextureUse {
            uv_x: reference.uv_transform.matrix2.x_axis.into(),
            uv_y: reference.uv_transform.matrix2.y_axis.into(),
            uv_offset: reference.uv_transform.translation.into(),
            texels_at: textures.place(texture),
            width: texture.width,
            height: texture.height,
            flags: TEXTURE_IS_THERE
                | set
                | nearest
                | kind_flag(texture)
                | srgb
                | wrap(reference.wrap_u, TEXTURE_WRAP_SHIFTS[0])
                | wrap(reference.wrap_v, TEXTURE_WRAP_SHIFTS[1]),
            padding_0: 0,
            padding_1: 0,
        }
    };
    let distance_m = material.attenuation_distance_m;
    GpuMaterial {
        base_color: material.base_color.to_array(),
        alpha: material.alpha,
        emission: if material.is_emissive() { material.emission } else { Rgb::BLACK }.to_array(),
        alpha_cutoff: material.alpha_cutoff.unwrap_or(-1.0),
        specular_color: material.specular_color.to_array(),
        specular: material.specular,
        attenuation_color: material.attenuation_color.to_array(),
        attenuation_distance_m: if distance_m.is_finite() { distance_m } else { 0.0 },
        metallic: material.metallic,
        roughness: material.roughness,
        ior: material.ior,
        transmission: material.transmission,
        normal_scale: material.normal_scale,
        flags: u32::from(material.double_sided) | if material.unlit { 2 } else { 0 },
        padding_0: 0,
        padding_1: 0,
        textures: TextureSlot::ALL.map(texture),
    }
}
