//! Images → engine textures, each distinct picture once; texture infos → what a material looks up.

use std::collections::HashMap;

use ::gltf::json::{
    Root,
    extensions::texture::TextureTransform,
    texture::{MagFilter, WrappingMode},
    validation::Checked,
};
use glam::Affine2;
use lumicast_engine::scene::{Filter, Id, SceneBuilder, TextureRef, Wrap};
use rayon::prelude::*;

use super::{buffers::Buffers, container::label, document::at, uris};
use crate::assets::{
    AssetLimits,
    error::{AssetError, Bound, bad},
    folder::Folder,
    names::Names,
    pictures::{self, Size},
};

/// Engine textures by image index; `None` for images that no material uses.
pub(super) type Images = Vec<Option<Id>>;

/// Decodes every image that `used` names and adds it to the scene. Equal bytes become one texture.
pub(super) fn load(
    root: &Root,
    used: &[bool],
    buffers: &Buffers<'_>,
    folder: &mut Folder,
    builder: &mut SceneBuilder,
    names: &mut Names,
    limits: &AssetLimits,
) -> Result<Images, AssetError> {
    let object = |index: usize| String::from(label("image", index, root.images[index].name.as_deref()));
    let mut read = HashMap::new();
    for index in (0..root.images.len()).filter(|index| used[*index]) {
        if let Some(uri) = &root.images[index].uri {
            read.insert(index, uris::read(uri, &object(index), folder)?);
        }
    }
    let mut distinct: HashMap<&[u8], usize> = HashMap::new();
    let mut pictures: Vec<(usize, &[u8], Size)> = Vec::new();
    let mut picture_of_image = vec![None; root.images.len()];
    let mut texels = builder.scene().textures().values().map(|texture| texture.texel_count() as u64).sum();
    for index in (0..root.images.len()).filter(|index| used[*index]) {
        let bytes = match (read.get(&index), root.images[index].buffer_view) {
            (Some(bytes), _) => bytes.as_slice(),
            (None, Some(view)) => buffers.view(view.value(), &object(index))?.bytes,
            (None, None) => {
                return Err(bad(
                    object(index),
                    "uri",
                    "is missing, and so is bufferView: there is no picture",
                ));
            }
        };
        let picture = match distinct.get(bytes) {
            Some(picture) => *picture,
            None => {
                let size = pictures::size(bytes).map_err(|problem| bad(object(index), "header", problem))?;
                check_size(size, &mut texels, &object(index), builder, limits)?;
                pictures.push((index, bytes, size));
                distinct.insert(bytes, pictures.len() - 1);
                pictures.len() - 1
            }
        };
        picture_of_image[index] = Some(picture);
    }
    let decoded: Vec<_> =
        pictures.par_iter().map(|(_, bytes, size)| pictures::decode(bytes, *size)).collect();
    let mut ids = Vec::with_capacity(decoded.len());
    for ((index, ..), picture) in pictures.iter().zip(decoded) {
        let picture = picture.map_err(|problem| bad(object(*index), "picture", problem))?;
        let name = root.images[*index].name.as_deref();
        let id = names
            .unique(&[name], &format!("image {index}"), |id| builder.scene().textures().contains_key(id));
        if picture.was_deeper {
            builder.warn(
                format!("texture {id:?}"),
                "has more than 8 bits a channel: the lower ones are left out",
            );
        }
        builder.add_texture(id.clone(), picture.texture)?;
        ids.push(id);
    }
    Ok(picture_of_image.into_iter().map(|picture| picture.map(|index: usize| ids[index].clone())).collect())
}

/// Refuses a picture by its header: alone, and together with all before it.
fn check_size(
    size: Size,
    texels: &mut u64,
    object: &str,
    builder: &SceneBuilder,
    limits: &AssetLimits,
) -> Result<(), AssetError> {
    let pixels = Bound { what: "texels", limit: limits.image_pixels_max, setting: "image_texels" };
    pixels.check(object, size.pixels())?;
    *texels += size.pixels();
    let all =
        Bound { what: "texels in all textures", limit: builder.limits().texels_max, setting: "scene_texels" };
    all.check(object, *texels)
}

/// What the three kinds of texture info of `gltf::json` have in common.
#[derive(Clone, Debug)]
pub(super) struct Info {
    pub(super) texture: usize,
    pub(super) texcoord_set: u32,
    pub(super) transform: Option<TextureTransform>,
}

/// The image behind a texture; `None` when the file gives it only to an extension that is not read.
pub(super) fn image_of(root: &Root, texture: usize, user: &str) -> Result<Option<usize>, AssetError> {
    let source = at(&root.textures, texture, || user.into(), "texture index")?.source.value();
    // `gltf::json` gives this number to a texture without a source.
    if source == u32::MAX as usize {
        return Ok(None);
    }
    at(&root.images, source, || format!("texture {texture}"), "source")?;
    Ok(Some(source))
}

/// A material's look-up, or why it cannot be had.
pub(super) fn reference(
    root: &Root,
    info: &Info,
    images: &Images,
    user: &str,
) -> Result<Result<TextureRef, &'static str>, AssetError> {
    let Some(image) = image_of(root, info.texture, user)? else {
        return Ok(Err("a texture without a PNG or JPEG picture is left out"));
    };
    let Some(id) = images[image].clone() else {
        return Err(bad(user, "texture index", format!("names image {image}, which was not decoded")));
    };
    let transform = info.transform.clone().unwrap_or_default();
    let texcoord_set = transform.tex_coord.unwrap_or(info.texcoord_set);
    if texcoord_set > 1 {
        return Ok(Err(
            "a texture that asks for a third set of texture coordinates is left out: two are read",
        ));
    }
    let mut reference = TextureRef::new(id);
    reference.texcoord_set = texcoord_set as u8;
    // The extension turns counter-clockwise as seen with v downwards, so the angle counts backwards.
    reference.uv_transform = Affine2::from_scale_angle_translation(
        transform.scale.0.into(),
        -transform.rotation.0,
        transform.offset.0.into(),
    );
    if let Some(sampler) = root.textures[info.texture].sampler {
        let sampler = at(&root.samplers, sampler.value(), || format!("texture {}", info.texture), "sampler")?;
        reference.wrap_u = wrap(sampler.wrap_s);
        reference.wrap_v = wrap(sampler.wrap_t);
        if sampler.mag_filter == Some(Checked::Valid(MagFilter::Nearest)) {
            reference.filter = Filter::Nearest;
        }
    }
    Ok(Ok(reference))
}

/// A mode that glTF does not know is read as its default.
fn wrap(mode: Checked<WrappingMode>) -> Wrap {
    match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
    }
}
