//! What goes over the wire between the server and everything that talks to it.
//!
//! Types, their JSON, the binary frame header and the limits; no sockets, files, clocks or threads, so that the same
//! crate serves the server, the native viewer and the viewer in a browser. It imports serde and nothing of Lumicast.
//! Values are *shaped* here (right fields, right types, known names); whether a number makes sense in a scene is for
//! the engine to say. `README.md` beside this crate is the same protocol in prose; a test parses its examples.

pub mod camera;
pub mod edit;
pub mod forecast;
pub mod frame;
pub mod id;
pub mod light;
pub mod limits;
pub mod material;
pub mod message;
pub mod parse;
pub mod problem;
pub mod scene;
pub mod transform;

mod base64_bytes;

pub use camera::{CameraPose, DEFAULT_YFOV_RAD, LookAt, Placement, Projection, SetCamera};
pub use edit::{
    AddMesh, AddNode, Change, Edit, EditBatch, EnvironmentImage, LoadGltf, RemoveCamera, RemoveLight,
    RemoveNode, SetEnvironment, SetMaterial, SetTransform,
};
pub use forecast::{Forecast, ForecastRecord, ForecastWhen, Preset};
pub use frame::{FrameError, FrameHeader, PayloadCodec, PayloadKind};
pub use id::{Id, IdError, SceneId};
pub use light::{AddLight, LightKind, LightSource, SetLight};
pub use limits::{LimitError, Limits, SAFE_INTEGER_MAX};
pub use material::{MaterialProperties, TextureSlot};
pub use message::{
    Accuracy, CameraRequest, ClientHello, ClientMessage, Codec, EditRequest, EffectChoice, EffectChoices,
    Quality, ServerHello, ServerMessage, Stats, Technique, ToneMap, View,
};
pub use parse::{ParseError, request_of};
pub use problem::{Problem, ProblemKind};
pub use scene::{
    CameraDescription, Convergence, ConvergencePoint, Counts, EditReply, Effect, Effects,
    EnvironmentDescription, EventEntry, EventLog, LightDescription, MaterialDescription, MeshDescription,
    NodeDescription, SceneDescription, SceneList, SceneSummary, Warning,
};
pub use transform::Transform;

/// The WebSocket subprotocol a client asks for and the server confirms; a breaking change takes a new number.
pub const SUBPROTOCOL: &str = "lumicast.v1";
