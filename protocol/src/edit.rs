//! Edits: everything that can change a scene, as HTTP and the WebSocket carry it and as the log keeps it.
//!
//! One JSON object per edit, `"op"` names it; unknown ops and fields are refused. A batch is atomic and makes one
//! revision. Colours are linear Rec.709, lengths metres, angles radians.

use crate::{AddLight, Id, MaterialProperties, SetCamera, SetLight, Transform, base64_bytes};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;

/// One change to a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case")]
#[allow(missing_docs, reason = "each variant is documented at its struct")]
pub enum Edit {
    AddMesh(AddMesh),
    AddNode(AddNode),
    RemoveNode(RemoveNode),
    SetTransform(SetTransform),
    SetMaterial(Box<SetMaterial>),
    AddLight(AddLight),
    SetLight(SetLight),
    RemoveLight(RemoveLight),
    SetCamera(SetCamera),
    RemoveCamera(RemoveCamera),
    SetEnvironment(SetEnvironment),
    LoadGltf(LoadGltf),
}

impl Edit {
    /// Every op, as in JSON.
    pub const OPS: [&'static str; 12] = [
        "add_mesh",
        "add_node",
        "remove_node",
        "set_transform",
        "set_material",
        "add_light",
        "set_light",
        "remove_light",
        "set_camera",
        "remove_camera",
        "set_environment",
        "load_gltf",
    ];

    /// The op, as in JSON.
    pub fn op_name(&self) -> &'static str {
        match self {
            Self::AddMesh(_) => "add_mesh",
            Self::AddNode(_) => "add_node",
            Self::RemoveNode(_) => "remove_node",
            Self::SetTransform(_) => "set_transform",
            Self::SetMaterial(_) => "set_material",
            Self::AddLight(_) => "add_light",
            Self::SetLight(_) => "set_light",
            Self::RemoveLight(_) => "remove_light",
            Self::SetCamera(_) => "set_camera",
            Self::RemoveCamera(_) => "remove_camera",
            Self::SetEnvironment(_) => "set_environment",
            Self::LoadGltf(_) => "load_gltf",
        }
    }
}

/// Edits that happen together or not at all. JSON `{"edits":[…]}`; a bare array is read as well.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct EditBatch {
    /// In the order they are applied; a later one may use what an earlier one made.
    pub edits: Vec<Edit>,
}

impl<'de> Deserialize<'de> for EditBatch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Object {
            edits: Vec<Edit>,
        }
        struct Both;
        impl<'de> de::Visitor<'de> for Both {
            type Value = EditBatch;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("{\"edits\":[…]} or an array of edits")
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<EditBatch, A::Error> {
                let edits = Vec::deserialize(de::value::SeqAccessDeserializer::new(seq))?;
                Ok(EditBatch { edits })
            }
            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<EditBatch, A::Error> {
                let object = Object::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(EditBatch { edits: object.edits })
            }
        }
        deserializer.deserialize_any(Both)
    }
}

/// What an edit does to a property for which "none" is a value too: absent, `null` or a value in JSON.
/// Used with `#[serde(default, skip_serializing_if = "Change::is_keep")]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Change<T> {
    /// Absent: stays as it is.
    #[default]
    Keep,
    /// `null`: becomes none.
    Clear,
    /// Becomes this.
    Set(T),
}

impl<T> Change<T> {
    /// Whether the property stays as it is.
    pub fn is_keep(&self) -> bool {
        matches!(self, Self::Keep)
    }

    /// The property after the change.
    pub fn applied_to(self, before: Option<T>) -> Option<T> {
        match self {
            Self::Keep => before,
            Self::Clear => None,
            Self::Set(value) => Some(value),
        }
    }
}

impl<T: Serialize> Serialize for Change<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Set(value) => value.serialize(serializer),
            Self::Keep | Self::Clear => serializer.serialize_none(),
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Change<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Option::deserialize(deserializer)?.map_or(Self::Clear, Self::Set))
    }
}

/// Edit `add_mesh`: a new triangle mesh of one material. It is seen once a node carries it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AddMesh {
    /// Id of the new mesh.
    pub mesh: Id,
    /// `[vertices]`, metres in the mesh's own space.
    pub positions: Vec<[f32; 3]>,
    /// Corner indices into `positions`; counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// `[vertices]`, unit length; absent: flat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normals: Option<Vec<[f32; 3]>>,
    /// `[vertices]`, u to the right and v down as in glTF.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texcoords: Option<Vec<[f32; 2]>>,
    /// `[vertices]`, linear RGBA that multiplies the base colour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colors: Option<Vec<[f32; 4]>>,
    /// An existing material.
    pub material: Id,
}

/// Edit `add_node`: a new node in the hierarchy, with or without a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AddNode {
    /// Id of the new node.
    pub node: Id,
    /// The node above; absent: the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Id>,
    /// The mesh seen here; several nodes may carry one mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<Id>,
    /// `parent_from_node`; absent: identity.
    #[serde(default, skip_serializing_if = "Transform::is_identity")]
    pub transform: Transform,
}

/// Edit `remove_node`: with every node, light and camera below it. A mesh goes with its last node, a
/// material with its last mesh, a texture with its last material; what was never used stays until it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoveNode {
    /// Which node.
    pub node: Id,
}

/// Edit `set_transform`: replaces a node's transform as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetTransform {
    /// Which node.
    pub node: Id,
    /// `parent_from_node`.
    pub transform: Transform,
}

/// Edit `set_material`: changes the properties it names and keeps the others. Meanings, units and what a new material
/// starts from: [`MaterialProperties`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the properties are documented at MaterialProperties")]
pub struct SetMaterial {
    pub material: Id,
    /// Whether an unknown id makes a new material; otherwise it refuses the batch.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub create: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_color: Option<[f32; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metallic: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ior: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular_color: Option<[f32; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transmission: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attenuation_color: Option<[f32; 3]>,
    /// `null` = infinite.
    #[serde(default, skip_serializing_if = "Change::is_keep")]
    pub attenuation_distance_m: Change<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emission: Option<[f32; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub double_sided: Option<bool>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unlit: Option<bool>,
    /// `null` = opaque.
    #[serde(default, skip_serializing_if = "Change::is_keep")]
    pub alpha_cutoff: Change<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal_scale: Option<f32>,
}

impl SetMaterial {
    /// An edit of this material that changes nothing yet.
    pub fn of(material: Id) -> Self {
        Self {
            material,
            create: false,
            base_color: None,
            metallic: None,
            roughness: None,
            ior: None,
            specular: None,
            specular_color: None,
            transmission: None,
            attenuation_color: None,
            attenuation_distance_m: Change::Keep,
            emission: None,
            double_sided: None,
            unlit: None,
            alpha_cutoff: Change::Keep,
            normal_scale: None,
        }
    }

    /// The properties after this edit.
    pub fn applied_to(&self, before: &MaterialProperties) -> MaterialProperties {
        MaterialProperties {
            base_color: self.base_color.unwrap_or(before.base_color),
            metallic: self.metallic.unwrap_or(before.metallic),
            roughness: self.roughness.unwrap_or(before.roughness),
            ior: self.ior.unwrap_or(before.ior),
            specular: self.specular.unwrap_or(before.specular),
            specular_color: self.specular_color.unwrap_or(before.specular_color),
            transmission: self.transmission.unwrap_or(before.transmission),
            attenuation_color: self.attenuation_color.unwrap_or(before.attenuation_color),
            attenuation_distance_m: self.attenuation_distance_m.applied_to(before.attenuation_distance_m),
            emission: self.emission.unwrap_or(before.emission),
            double_sided: self.double_sided.unwrap_or(before.double_sided),
            unlit: self.unlit.unwrap_or(before.unlit),
            alpha_cutoff: self.alpha_cutoff.applied_to(before.alpha_cutoff),
            normal_scale: self.normal_scale.unwrap_or(before.normal_scale),
        }
    }
}

/// Edit `remove_light`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoveLight {
    /// Which light.
    pub light: Id,
}

/// Edit `remove_camera`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoveCamera {
    /// Which camera.
    pub camera: Id,
}

/// Edit `set_environment`: what is seen where no surface is; `"kind"` says which.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", try_from = "SetEnvironmentFields")]
pub enum SetEnvironment {
    /// Darkness.
    None {},
    /// The same radiance from everywhere.
    Constant {
        /// W/(m² sr).
        radiance: [f32; 3],
    },
    /// A picture of all directions.
    Image {
        /// The picture.
        image: EnvironmentImage,
        /// Factor on its radiance; 1 where absent from JSON.
        scale: f32,
        /// Turn about +Y, counter-clockwise seen from above; 0 where absent from JSON.
        rotation_rad: f32,
    },
}

/// The JSON of an environment as it is read. Apart from [`SetEnvironment`] because serde's tagged enums lose the path to
/// the field that they refuse.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SetEnvironmentFields {
    kind: EnvironmentKind,
    #[serde(default, deserialize_with = "present")]
    radiance: Option<[f32; 3]>,
    #[serde(default, deserialize_with = "present")]
    image: Option<EnvironmentImage>,
    #[serde(default, deserialize_with = "present")]
    scale: Option<f32>,
    #[serde(default, deserialize_with = "present")]
    rotation_rad: Option<f32>,
}

/// A field that is there is there: `null`, as JavaScript writes NaN, is refused and not taken for absent.
fn present<'de, T: Deserialize<'de>, D: serde::Deserializer<'de>>(of: D) -> Result<Option<T>, D::Error> {
    T::deserialize(of).map(Some)
}

/// Which environment it is.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum EnvironmentKind {
    None,
    Constant,
    Image,
}

impl EnvironmentKind {
    /// As in JSON.
    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Constant => "constant",
            Self::Image => "image",
        }
    }

    /// The fields beside `kind` that it may have.
    fn fields(self) -> &'static [&'static str] {
        match self {
            Self::None => &[],
            Self::Constant => &["radiance"],
            Self::Image => &["image", "scale", "rotation_rad"],
        }
    }
}

impl TryFrom<SetEnvironmentFields> for SetEnvironment {
    type Error = String;
    fn try_from(fields: SetEnvironmentFields) -> Result<Self, String> {
        let SetEnvironmentFields { kind, radiance, image, scale, rotation_rad } = fields;
        let given = [
            ("radiance", radiance.is_some()),
            ("image", image.is_some()),
            ("scale", scale.is_some()),
            ("rotation_rad", rotation_rad.is_some()),
        ];
        // A field that means nothing for this kind is refused rather than dropped: the sender meant something by it.
        if let Some((field, _)) =
            given.iter().find(|(field, is_given)| *is_given && !kind.fields().contains(field))
        {
            return Err(format!("an environment of kind {} has no `{field}`", kind.name()));
        }
        let missing = |field: &str| format!("an environment of kind {} needs `{field}`", kind.name());
        Ok(match kind {
            EnvironmentKind::None => Self::None {},
            EnvironmentKind::Constant => {
                Self::Constant { radiance: radiance.ok_or_else(|| missing("radiance"))? }
            }
            EnvironmentKind::Image => Self::Image {
                image: image.ok_or_else(|| missing("image"))?,
                scale: scale.unwrap_or(1.0),
                rotation_rad: rotation_rad.unwrap_or(0.0),
            },
        })
    }
}

/// An equirectangular picture of radiance.
///
/// Row 0 looks up (+Y), the last row down; the middle column looks down −Z, columns run on to the right (+X at three
/// quarters of the width), as one sees it from inside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentImage {
    /// Columns, all the way round.
    pub width: u32,
    /// Rows, from up to down.
    pub height: u32,
    /// `[height × width × 3]` f32 little-endian, radiance in W/(m² sr); base64 in JSON.
    #[serde(with = "base64_bytes")]
    pub texels: Vec<u8>,
}

impl EnvironmentImage {
    /// The texels as numbers, `[height × width]`, rows from up to down; `None` where the number of bytes is not
    /// width × height × 12.
    pub fn radiance(&self) -> Option<Vec<[f32; 3]>> {
        // In 128 bits, because the largest width × height × 12 overflows 64.
        let expected_bytes = u128::from(self.width) * u128::from(self.height) * 12;
        if self.texels.len() as u128 != expected_bytes {
            return None;
        }
        let (numbers, _) = self.texels.as_chunks::<4>();
        let (texels, _) = numbers.as_chunks::<3>();
        Some(texels.iter().map(|rgb| rgb.map(f32::from_le_bytes)).collect())
    }
}

/// Edit `load_gltf`: everything in a `.glb` file joins the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadGltf {
    /// A whole `.glb`, buffers and pictures inside; base64 in JSON.
    #[serde(with = "base64_bytes")]
    pub data: Vec<u8>,
    /// The node its roots hang under; absent: the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Id>,
    /// Stands before every id that the file brings, so that two copies can live side by side.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub prefix: String,
}
