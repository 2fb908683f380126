//! Cameras: where they stand, how they project. Used by the edit `set_camera`, the message `camera` and descriptions.

use crate::{Id, Transform};
use serde::{Deserialize, Serialize};

/// Vertical field of view of a camera that names none: 45°, in radians.
pub const DEFAULT_YFOV_RAD: f32 = std::f32::consts::FRAC_PI_4;

/// How a camera maps directions to the picture; flat in JSON: `"yfov_rad": 0.8` or `"half_height_m": 2.5`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Projection {
    /// Perspective.
    Perspective {
        /// Vertical field of view in radians, between 0 and π.
        yfov_rad: f32,
    },
    /// Parallel projection.
    Orthographic {
        /// Half the height of what is seen, in metres.
        half_height_m: f32,
    },
}

impl Default for Projection {
    fn default() -> Self {
        Self::Perspective { yfov_rad: DEFAULT_YFOV_RAD }
    }
}

impl Projection {
    fn from_fields(yfov_rad: Option<f32>, half_height_m: Option<f32>) -> Result<Option<Self>, &'static str> {
        match (yfov_rad, half_height_m) {
            (Some(_), Some(_)) => {
                Err("a camera has `yfov_rad` (perspective) or `half_height_m` (orthographic), not both")
            }
            (Some(yfov_rad), None) => Ok(Some(Self::Perspective { yfov_rad })),
            (None, Some(half_height_m)) => Ok(Some(Self::Orthographic { half_height_m })),
            (None, None) => Ok(None),
        }
    }

    fn into_fields(self) -> (Option<f32>, Option<f32>) {
        match self {
            Self::Perspective { yfov_rad } => (Some(yfov_rad), None),
            Self::Orthographic { half_height_m } => (None, Some(half_height_m)),
        }
    }
}

/// Where a camera stands in its parent's space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Placement {
    /// `parent_from_camera`; the camera looks down −Z with +Y up.
    Transform(Transform),
    /// From a point towards a point.
    LookAt(LookAt),
}

impl Default for Placement {
    fn default() -> Self {
        Self::Transform(Transform::IDENTITY)
    }
}

/// A camera given by two points in its parent's space, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LookAt {
    /// Where the camera stands.
    pub position: [f64; 3],
    /// What stands in the middle of the picture.
    pub target: [f64; 3],
    /// What is up in the picture, not parallel to the view; +Y where absent.
    #[serde(default = "plus_y")]
    pub up: [f64; 3],
}

fn plus_y() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

/// Edit `set_camera`: makes a camera, or replaces the one of that id as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SetCameraFields", into = "SetCameraFields")]
pub struct SetCamera {
    /// The camera's id.
    pub camera: Id,
    /// The node it moves with; `None` = the world.
    pub parent: Option<Id>,
    /// JSON `transform` or `look_at`; identity where neither stands.
    pub placement: Placement,
    /// JSON `yfov_rad` or `half_height_m`; [`DEFAULT_YFOV_RAD`] where neither stands.
    pub projection: Projection,
    /// Width ÷ height the camera was composed for; `None` = that of the picture asked for.
    pub aspect: Option<f32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SetCameraFields {
    camera: Id,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    parent: Option<Id>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    transform: Option<Transform>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    look_at: Option<LookAt>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    yfov_rad: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    half_height_m: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    aspect: Option<f32>,
}

impl TryFrom<SetCameraFields> for SetCamera {
    type Error = &'static str;
    fn try_from(fields: SetCameraFields) -> Result<Self, Self::Error> {
        let placement = match (fields.transform, fields.look_at) {
            (Some(_), Some(_)) => return Err("a camera is placed by `transform` or by `look_at`, not both"),
            (Some(transform), None) => Placement::Transform(transform),
            (None, Some(look_at)) => Placement::LookAt(look_at),
            (None, None) => Placement::default(),
        };
        let projection = Projection::from_fields(fields.yfov_rad, fields.half_height_m)?.unwrap_or_default();
        Ok(Self {
            camera: fields.camera,
            parent: fields.parent,
            placement,
            projection,
            aspect: fields.aspect,
        })
    }
}

impl From<SetCamera> for SetCameraFields {
    fn from(edit: SetCamera) -> Self {
        let (yfov_rad, half_height_m) = edit.projection.into_fields();
        let (transform, look_at) = match edit.placement {
            Placement::Transform(transform) => (Some(transform), None),
            Placement::LookAt(look_at) => (None, Some(look_at)),
        };
        let SetCamera { camera, parent, aspect, .. } = edit;
        Self { camera, parent, transform, look_at, yfov_rad, half_height_m, aspect }
    }
}

/// A viewer's own camera, which stands in no scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PoseFields", into = "PoseFields")]
pub struct CameraPose {
    /// JSON `matrix`: `world_from_camera`, `[16]` column-major, metres; looks down −Z. Expected rigid (no scale).
    pub world_from_camera: [f64; 16],
    /// JSON `yfov_rad` or `half_height_m`, one of them.
    pub projection: Projection,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFields {
    matrix: [f64; 16],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    yfov_rad: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    half_height_m: Option<f32>,
}

impl TryFrom<PoseFields> for CameraPose {
    type Error = &'static str;
    fn try_from(fields: PoseFields) -> Result<Self, Self::Error> {
        let projection = Projection::from_fields(fields.yfov_rad, fields.half_height_m)?
            .ok_or("a pose needs `yfov_rad` (perspective) or `half_height_m` (orthographic)")?;
        Ok(Self { world_from_camera: fields.matrix, projection })
    }
}

impl From<CameraPose> for PoseFields {
    fn from(pose: CameraPose) -> Self {
        let (yfov_rad, half_height_m) = pose.projection.into_fields();
        Self { matrix: pose.world_from_camera, yfov_rad, half_height_m }
    }
}
