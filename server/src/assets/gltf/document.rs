//! The JSON of a glTF file: bounded before it is parsed, then `gltf::json` plus the numbers that it narrows.
//!
//! `gltf::json` is used for its types alone. Its validation indexes accessors before it has checked them and
//! refuses files that lack the bounds of positions, so every index and value is checked where it is used.

use std::fmt;

use ::gltf::json::{Root, deserialize};
use lumicast_engine::scene::{SceneBuilder, SceneLimits};
use serde::{
    Deserialize, Deserializer,
    de::{IgnoredAny, SeqAccess, Visitor},
};

use super::container::label;
use crate::assets::{
    AssetLimits,
    error::{AssetError, Bound, bad},
};

/// Extensions that are read.
const READ: [&str; 9] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// A parsed file.
#[derive(Debug)]
pub(super) struct Document {
    pub(super) root: Root,
    pub(super) exact: Exact,
}

/// Lengths of the lists whose elements take much more memory than text, counted without keeping any.
#[derive(Debug, Deserialize)]
struct Outline {
    #[serde(default)]
    nodes: Length,
    #[serde(default)]
    materials: Length,
}

impl Outline {
    fn check(&self, scene: &SceneLimits) -> Result<(), AssetError> {
        let nodes = Bound { what: "nodes", limit: scene.nodes_max as u64, setting: "scene_nodes" };
        nodes.check("JSON", self.nodes.0)?;
        let limit = scene.materials_max as u64;
        Bound { what: "materials", limit, setting: "scene_objects" }.check("JSON", self.materials.0)
    }
}

#[derive(Debug, Default)]
struct Length(u64);

impl<'de> Deserialize<'de> for Length {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Length, D::Error> {
        struct Counter;
        impl<'de> Visitor<'de> for Counter {
            type Value = Length;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Length, A::Error> {
                let mut count = 0;
                while list.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Length(count))
            }
        }
        deserializer.deserialize_seq(Counter)
    }
}

/// The fields that `gltf::json` narrows to single precision, read once more in double precision.
#[derive(Debug, Deserialize)]
pub(super) struct Exact {
    #[serde(default)]
    pub(super) nodes: Vec<ExactNode>,
    #[serde(default)]
    pub(super) cameras: Vec<ExactCamera>,
}

/// A node's transform as written.
#[derive(Debug, Deserialize)]
pub(super) struct ExactNode {
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
}

/// A camera's projection as written.
#[derive(Debug, Deserialize)]
pub(super) struct ExactCamera {
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) perspective: Option<Perspective>,
    pub(super) orthographic: Option<Orthographic>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Perspective {
    pub(super) yfov: f64,
    pub(super) aspect_ratio: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Orthographic {
    pub(super) xmag: f64,
    pub(super) ymag: f64,
}

impl Document {
    /// Parses and checks what concerns the file as a whole. `scene`: the limits of the scene it goes into.
    pub(super) fn parse(
        json: &[u8],
        limits: &AssetLimits,
        scene: &SceneLimits,
    ) -> Result<Document, AssetError> {
        let bytes = Bound { what: "bytes", limit: limits.json_bytes_max, setting: "file_json_bytes" };
        bytes.check("JSON", json.len() as u64)?;
        let values = Bound { what: "values", limit: limits.json_values_max, setting: "file_json_values" };
        values.check("JSON", value_count(json))?;
        let wrong = |error| bad("JSON", "syntax", format!("{error}"));
        deserialize::from_slice::<Outline>(json).map_err(wrong)?.check(scene)?;
        let root: Root = deserialize::from_slice(json).map_err(wrong)?;
        let exact: Exact = deserialize::from_slice(json).map_err(wrong)?;
        check_version(&root)?;
        let unread = root.extensions_required.iter().find(|name| !READ.contains(&name.as_str()));
        if let Some(name) = unread {
            let name = name.chars().take(100).collect();
            return Err(AssetError::RequiredExtension { file: String::new(), name });
        }
        Ok(Document { root, exact })
    }

    /// Says what the file holds that is not read.
    pub(super) fn warn_of_unread(&self, builder: &mut SceneBuilder) {
        for name in self.root.extensions_used.iter().filter(|name| !READ.contains(&name.as_str())) {
            let name: String = name.chars().take(100).collect();
            builder.warn(format!("extension {name}"), "is not read: what it adds is left out");
        }
        if !self.root.animations.is_empty() {
            let message = format!(
                "{} animations are left out: the scene stands as written",
                self.root.animations.len()
            );
            builder.warn("file", message);
        }
        if !self.root.skins.is_empty() {
            builder.warn("file", "skins are left out: meshes stand in their bind pose");
        }
    }
}

fn check_version(root: &Root) -> Result<(), AssetError> {
    let version = root.asset.min_version.as_ref().unwrap_or(&root.asset.version);
    let readable = match &root.asset.min_version {
        Some(least) => least == "2.0",
        None => version.starts_with("2."),
    };
    if readable {
        return Ok(());
    }
    let version: String = version.chars().take(20).collect();
    Err(bad("asset", "version", format!("is {version:?}, but glTF 2.0 is read: export it again")))
}

/// An upper bound on the number of values in JSON text, without parsing: each but the first stands behind
/// an opening bracket or a comma.
fn value_count(json: &[u8]) -> u64 {
    let mut count = 1;
    let (mut in_string, mut escaped) = (false, false);
    for byte in json {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => in_string = !in_string,
            b'[' | b'{' | b',' if !in_string => count += 1,
            _ => {}
        }
    }
    count
}

/// The element `index` of a list of the file, or an error that names who asked.
pub(super) fn at<'a, T>(
    list: &'a [T],
    index: usize,
    user: impl FnOnce() -> String,
    field: &'static str,
) -> Result<&'a T, AssetError> {
    list.get(index).ok_or_else(|| bad(user(), field, format!("is {index}, but the file has {}", list.len())))
}

impl Document {
    /// `mesh 3 "floor"`.
    pub(super) fn mesh_label(&self, index: usize) -> String {
        let name = self.root.meshes.get(index).and_then(|mesh| mesh.name.as_deref());
        label("mesh", index, name).into()
    }
}
