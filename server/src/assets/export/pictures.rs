//! Textures → embedded PNGs, and a glTF texture for each pair of picture and sampler in use.

use std::{
    collections::{HashMap, HashSet},
    io::Cursor,
};

use image::{
    ExtendedColorType, ImageEncoder,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};
use lumicast_engine::scene::{Filter, Id, Scene, Texels, Texture, TextureRef, Wrap};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::{Output, failed};
use crate::assets::error::AssetError;

/// Pictures, samplers and textures as written.
#[derive(Debug)]
pub(super) struct Written {
    pub(super) images: Vec<Value>,
    pub(super) samplers: Vec<Value>,
    pub(super) textures: Vec<Value>,
    texture_of: HashMap<(Id, Sampler), usize>,
    /// What a float texture was divided by to fit 8 bits.
    scale_of: HashMap<Id, f32>,
}

type Sampler = (Wrap, Wrap, Filter);

impl Written {
    /// Index of the glTF texture that `reference` looks up.
    pub(super) fn texture_of(&self, reference: &TextureRef) -> Option<usize> {
        self.texture_of.get(&(reference.texture.clone(), sampler(reference))).copied()
    }

    /// Factor that brings the written picture back to the scene's numbers.
    pub(super) fn scale_of(&self, texture: &Id) -> f32 {
        self.scale_of.get(texture).copied().unwrap_or(1.0)
    }
}

fn sampler(reference: &TextureRef) -> Sampler {
    (reference.wrap_u, reference.wrap_v, reference.filter)
}

/// Encodes what materials use, in parallel, in the scene's order.
pub(super) fn write(scene: &Scene, output: &mut Output) -> Result<Written, AssetError> {
    let references: Vec<&TextureRef> =
        scene.materials().values().flat_map(|material| material.textures.iter().flatten()).collect();
    let in_use: HashSet<&Id> = references.iter().map(|reference| &reference.texture).collect();
    let used: Vec<(&Id, &Texture)> = scene
        .textures()
        .iter()
        .filter(|(id, _)| in_use.contains(id))
        .map(|(id, texture)| (id, texture.as_ref()))
        .collect();
    let encoded: Vec<_> = used.par_iter().map(|(id, texture)| encode(id, texture)).collect();
    let mut written = Written {
        images: Vec::new(),
        samplers: Vec::new(),
        textures: Vec::new(),
        texture_of: HashMap::new(),
        scale_of: HashMap::new(),
    };
    let mut image_of = HashMap::new();
    for ((id, _), encoded) in used.into_iter().zip(encoded) {
        let (png, scale) = encoded?;
        if let Some(scale) = scale {
            output.warnings.push(format!("texture {id:?} had float texels, of which 8 bits are left"));
            written.scale_of.insert(id.clone(), scale);
        }
        image_of.insert(id, written.images.len());
        let view = output.binary.view(&png, None);
        written.images.push(json!({ "name": id.as_str(), "bufferView": view, "mimeType": "image/png" }));
    }
    let mut sampler_of: HashMap<Sampler, usize> = HashMap::new();
    for reference in references {
        let key = (reference.texture.clone(), sampler(reference));
        let Some(image) = image_of.get(&reference.texture) else { continue };
        if written.texture_of.contains_key(&key) {
            continue;
        }
        let sampler = *sampler_of.entry(key.1).or_insert_with(|| {
            written.samplers.push(sampler_json(key.1));
            written.samplers.len() - 1
        });
        written.texture_of.insert(key, written.textures.len());
        written.textures.push(json!({ "sampler": sampler, "source": image }));
    }
    Ok(written)
}

/// OpenGL's numbers, which glTF quotes.
fn sampler_json((wrap_u, wrap_v, filter): Sampler) -> Value {
    let wrap = |wrap| match wrap {
        Wrap::Repeat => 10_497,
        Wrap::Mirror => 33_648,
        Wrap::Clamp => 33_071,
    };
    let filter = match filter {
        Filter::Bilinear => 9_729,
        Filter::Nearest => 9_728,
    };
    json!({ "wrapS": wrap(wrap_u), "wrapT": wrap(wrap_v), "magFilter": filter, "minFilter": filter })
}

/// PNG bytes, and for float texels what they were divided by.
fn encode(id: &Id, texture: &Texture) -> Result<(Vec<u8>, Option<f32>), AssetError> {
    let (bytes, scale) = match &texture.texels {
        Texels::Rgba8(texels) => (texels.as_flattened().to_vec(), None),
        Texels::Rgba32F(texels) => {
            let brightest = texels.iter().flat_map(|texel| &texel[..3]).fold(0.0f32, |a, b| a.max(*b));
            let scale = if brightest > 0.0 { brightest } else { 1.0 };
            (texels.iter().flat_map(|texel| srgb_bytes(*texel, scale)).collect(), Some(scale))
        }
    };
    let mut png = Vec::new();
    PngEncoder::new_with_quality(Cursor::new(&mut png), CompressionType::Fast, FilterType::Adaptive)
        .write_image(&bytes, texture.width, texture.height, ExtendedColorType::Rgba8)
        .map_err(|error| failed(format!("texture {id:?}"), error.to_string()))?;
    Ok((png, scale))
}

fn srgb_bytes([r, g, b, a]: [f32; 4], scale: f32) -> [u8; 4] {
    let encoded = |value: f32| {
        let c = (value / scale).clamp(0.0, 1.0);
        let c = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (c * 255.0).round() as u8
    };
    [encoded(r), encoded(g), encoded(b), (a.clamp(0.0, 1.0) * 255.0).round() as u8]
}
