//! Cameras: where from, which way, how wide.

use glam::{DAffine3, DMat3, DVec3};

use super::{Aabb, Id};

/// How directions or positions spread over the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole.
    Perspective {
        /// Vertical field of view in radians, in (0, π).
        yfov_rad: f64,
    },
    /// Parallel rays.
    Orthographic {
        /// Half of the picture's height in metres.
        half_height_m: f64,
    },
}

/// A camera of the scene. It looks down −Z, +Y is up.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// The node it is mounted on; the world for `None`.
    pub parent: Option<Id>,
    /// From the camera's space to its parent's; axes may be scaled, only their directions count.
    pub parent_from_camera: DAffine3,
    /// Projection.
    pub projection: Projection,
    /// Width / height the author had in mind.
    pub aspect: Option<f64>,
}

/// What one picture is taken with: a pose in the world and a projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraView {
    /// From the camera's space to the world.
    pub world_from_camera: DAffine3,
    /// Projection.
    pub projection: Projection,
}

impl CameraView {
    /// A view from `position` to `target` with `up` upwards; any up that is not along the view will do.
    pub fn look_at(position: DVec3, target: DVec3, up: DVec3, yfov_rad: f64) -> CameraView {
        let back = (position - target).try_normalize().unwrap_or(DVec3::Z);
        let right = up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
        let rotation = DMat3::from_cols(right, back.cross(right), back);
        CameraView {
            world_from_camera: DAffine3::from_mat3_translation(rotation, position),
            projection: Projection::Perspective { yfov_rad },
        }
    }

    /// A view that holds all of `bounds`, from +Z, slightly above.
    pub fn framing(bounds: &Aabb) -> CameraView {
        let yfov_rad = 45f64.to_radians();
        let distance = bounds.radius().max(1e-6) / (yfov_rad / 2.0).sin();
        let position = bounds.centre() + DVec3::new(0.0, 0.25, 1.0).normalize() * distance;
        CameraView::look_at(position, bounds.centre(), DVec3::Y, yfov_rad)
    }
}
