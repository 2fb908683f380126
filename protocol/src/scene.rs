//! What a scene looks like from outside: the answers of `GET /v1/scenes…` and the message `scene`.
//!
//! Enough for a scene tree and editors, never the geometry itself. Readers ignore fields they do not know.

use crate::{
    Edit, Id, LightSource, MaterialProperties, Projection, SceneId, Technique, TextureSlot, Transform,
};
use serde::{Deserialize, Serialize};

/// Answer of `GET /v1/scenes`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneList {
    /// By id.
    pub scenes: Vec<SceneSummary>,
}

/// One line of the list of scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneSummary {
    /// Stands in URLs.
    pub id: SceneId,
    /// For people.
    pub name: String,
    /// 1, 2, 3 …
    pub revision: u64,
    /// Whether edits survive a restart of the server.
    pub durable: bool,
    /// Triangles as seen: a mesh on two nodes counts twice.
    pub triangles: u64,
    /// Viewers connected now.
    pub viewers: u32,
}

/// Answer of `GET /v1/scenes/{id}`, and the message `scene`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneDescription {
    /// Stands in URLs.
    pub id: SceneId,
    /// For people.
    pub name: String,
    /// The revision all of this describes.
    pub revision: u64,
    /// Whether edits survive a restart of the server.
    pub durable: bool,
    /// How much there is.
    pub counts: Counts,
    /// Smallest box around everything seen, `[min, max]` in world metres; `None` in an empty scene.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// What was odd but usable on the way in.
    pub warnings: Vec<Warning>,
    /// Parents stand before their children.
    pub nodes: Vec<NodeDescription>,
    /// By id.
    pub meshes: Vec<MeshDescription>,
    /// By id.
    pub materials: Vec<MaterialDescription>,
    /// By id.
    pub lights: Vec<LightDescription>,
    /// In the scene's order; the first is the default view.
    pub cameras: Vec<CameraDescription>,
    /// What is seen where no surface is.
    pub environment: EnvironmentDescription,
}

/// How much there is in a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Nodes of the hierarchy.
    pub nodes: u64,
    /// Meshes, each counted once.
    pub meshes: u64,
    /// Triangles stored: each mesh once.
    pub triangles: u64,
    /// Triangles as seen: a mesh on two nodes counts twice.
    pub instanced_triangles: u64,
    /// Vertices stored.
    pub vertices: u64,
    /// Materials.
    pub materials: u64,
    /// Pictures used as textures.
    pub textures: u64,
    /// Their texels, and those of the environment.
    pub texels: u64,
    /// Lights without area.
    pub lights: u64,
    /// Triangles that emit, as seen.
    pub emissive_triangles: u64,
    /// Cameras.
    pub cameras: u64,
}

/// Something odd that the server could live with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Which thing, e.g. `mesh "floor"`.
    pub object: String,
    /// What was found and what was done about it.
    pub message: String,
}

/// A node of the hierarchy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeDescription {
    /// The node.
    pub id: Id,
    /// The node above; `None` = the world.
    pub parent: Option<Id>,
    /// `parent_from_node`, in the form it was given.
    pub transform: Transform,
    /// The mesh it carries.
    pub mesh: Option<Id>,
}

/// A mesh, without its geometry.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshDescription {
    /// The mesh.
    pub id: Id,
    /// How many.
    pub triangles: u64,
    /// How many.
    pub vertices: u64,
    /// Those its triangles use.
    pub materials: Vec<Id>,
}

/// A material in full. The properties are flat in JSON, beside `id`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MaterialDescription {
    /// The material.
    pub id: Id,
    /// Its values.
    #[serde(flatten)]
    pub properties: MaterialProperties,
    /// Where textures stand, which the values multiply.
    pub textures: Vec<TextureSlot>,
}

/// A light without area. `kind` and the fields of that kind are flat in JSON, beside `id`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LightDescription {
    /// The light.
    pub id: Id,
    /// The node it moves with; `None` = the world.
    pub parent: Option<Id>,
    /// In the parent's space, as `set_light` takes it.
    #[serde(flatten)]
    pub source: LightSource,
}

/// A camera of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraDescription {
    /// The camera.
    pub id: Id,
    /// The node it moves with; `None` = the world.
    pub parent: Option<Id>,
    /// `[16]` column-major, metres; looks down −Z. Already through the parents.
    pub world_from_camera: [f64; 16],
    /// Flat in JSON: `yfov_rad` or `half_height_m`.
    #[serde(flatten)]
    pub projection: Projection,
    /// Width ÷ height it was composed for.
    pub aspect: Option<f32>,
}

/// The environment, without its texels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum EnvironmentDescription {
    /// Darkness.
    None,
    /// The same radiance from everywhere.
    Constant {
        /// W/(m² sr).
        radiance: [f32; 3],
    },
    /// An equirectangular picture.
    Image {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Factor on its radiance.
        scale: f32,
        /// Turn about +Y.
        rotation_rad: f32,
        /// Mean over the sphere, scale included, W/(m² sr).
        mean_radiance: [f32; 3],
    },
}

/// Answer of `GET /v1/scenes/{id}/effects`: which parts of the renderer this scene needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effects {
    /// The revision this was decided for.
    pub revision: u64,
    /// In the order they run.
    pub effects: Vec<Effect>,
}

/// One part of the renderer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Its name, e.g. `caustics`.
    pub effect: String,
    /// Whether it runs.
    pub on: bool,
    /// The facts of the scene that decide it.
    pub reason: String,
}

/// Answer of `GET /v1/scenes/{id}/convergence`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// In the order of measuring; the oldest are thinned out once there are many.
    pub points: Vec<ConvergencePoint>,
}

/// The error at one moment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConvergencePoint {
    /// Since the film restarted.
    pub seconds: f64,
    /// Per pixel.
    pub samples: u64,
    /// √relMSE as a fraction: 0.01 = 1 %. `None` = not measured yet.
    pub error: Option<f32>,
    /// 95 % confidence interval of `error`, `[low, high]`.
    pub error_ci: Option<[f32; 2]>,
    /// Revision of the picture.
    pub revision: u64,
    /// What it is rendered with.
    pub technique: Technique,
}

/// Answer of `GET /v1/scenes/{id}/edits?since=REV`: what happened after that revision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventLog {
    /// The scene's revision now.
    pub revision: u64,
    /// By revision, each one more than the last.
    pub entries: Vec<EventEntry>,
}

/// One batch in a scene's log; also the data of each server-sent event of `GET /v1/scenes/{id}/events`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventEntry {
    /// The revision it made.
    pub revision: u64,
    /// When it was on disk: seconds since 1970-01-01 UTC.
    pub seconds_since_epoch: f64,
    /// As they were sent.
    pub edits: Vec<Edit>,
}

/// Answer of `POST /v1/scenes/{id}/edits`, sent once the batch is on disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EditReply {
    /// The revision the batch made.
    pub revision: u64,
}
