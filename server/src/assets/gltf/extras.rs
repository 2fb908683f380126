//! What our own exporter notes in `extras`, because glTF has no word for it.
//!
//! - a node with `{"lumicast": {"carrier": true}}` only carries a light or a camera, which hangs on its parent
//! - the scene's `{"lumicast": {"environment": …}}` is what surrounds it
//! - the asset's `{"lumicast": {"warnings": […]}}` says what the export could not keep

use ::gltf::json::{Extras, deserialize};
use lumicast_engine::{
    math::Rgb,
    scene::{Environment, Id, SceneBuilder, Texels, Texture},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::buffers::Buffers;
use crate::assets::{
    error::{AssetError, Bound, bad},
    names::Names,
};

#[derive(Debug, Deserialize, Serialize)]
pub(in crate::assets) struct Ours<T> {
    pub(in crate::assets) lumicast: T,
}

#[derive(Debug, Deserialize, Serialize)]
pub(in crate::assets) struct NodeExtras {
    pub(in crate::assets) carrier: bool,
}

#[derive(Debug, Deserialize, Serialize)]
pub(in crate::assets) struct AssetExtras {
    pub(in crate::assets) warnings: Vec<String>,
}

#[derive(Debug, Deserialize, Serialize)]
pub(in crate::assets) struct SceneExtras {
    pub(in crate::assets) environment: EnvironmentExtras,
}

/// What surrounds the scene; radiance W/(m² sr), linear Rec.709.
#[derive(Debug, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::assets) enum EnvironmentExtras {
    Constant([f32; 3]),
    Image(EnvironmentImage),
}

/// `view` holds `height × width` texels of four little-endian floats.
#[derive(Debug, Deserialize, Serialize)]
pub(in crate::assets) struct EnvironmentImage {
    pub(in crate::assets) name: String,
    pub(in crate::assets) buffer_view: usize,
    pub(in crate::assets) width: u32,
    pub(in crate::assets) height: u32,
    pub(in crate::assets) scale: [f32; 3],
    pub(in crate::assets) rotation_rad: f32,
}

/// Our note in an `extras`; someone else's are none of our business, whatever they hold.
pub(super) fn ours<T: DeserializeOwned>(extras: &Extras) -> Option<T> {
    let extras = extras.as_ref()?;
    deserialize::from_str::<Ours<T>>(extras.get()).ok().map(|ours| ours.lumicast)
}

/// Adds the noted environment's picture to the scene and returns the environment for the caller to set.
pub(super) fn environment(
    extras: &Extras,
    buffers: &Buffers<'_>,
    builder: &mut SceneBuilder,
    names: &mut Names,
) -> Result<Option<Environment>, AssetError> {
    let image = match ours::<SceneExtras>(extras).map(|extras| extras.environment) {
        None => return Ok(None),
        Some(EnvironmentExtras::Constant(radiance)) => {
            return Ok(Some(Environment::Constant(radiance.into())));
        }
        Some(EnvironmentExtras::Image(image)) => image,
    };
    let texels = u64::from(image.width) * u64::from(image.height);
    let bound = Bound { what: "texels", limit: builder.limits().texels_max, setting: "scene_texels" };
    bound.check("environment", texels)?;
    let bytes = buffers.view(image.buffer_view, "environment")?.bytes;
    let (whole, rest) = bytes.as_chunks::<16>();
    if !rest.is_empty() || whole.len() as u64 != texels {
        let problem = format!("{} bytes for {} × {} texels of 16", bytes.len(), image.width, image.height);
        return Err(bad("environment", "buffer_view", problem));
    }
    let float = |bytes: &[u8; 16], at: usize| {
        f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
    };
    let texels = whole.iter().map(|bytes| [0, 4, 8, 12].map(|at| float(bytes, at))).collect();
    let id: Id =
        names.unique(&[Some(&image.name)], "environment", |id| builder.scene().textures().contains_key(id));
    let texture = Texture { width: image.width, height: image.height, texels: Texels::Rgba32F(texels) };
    builder.add_texture(id.clone(), texture)?;
    let scale: Rgb = image.scale.into();
    Ok(Some(Environment::Image { texture: id, scale, rotation_rad: image.rotation_rad }))
}
