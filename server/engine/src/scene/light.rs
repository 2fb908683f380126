//! Punctual lights and what surrounds the scene. Area lights are meshes whose material emits.

use glam::DVec3;

use super::Id;
use crate::math::Rgb;

/// What a punctual light sends out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// The same in all directions.
    Point {
        /// W/sr.
        intensity: Rgb,
    },
    /// Inside a cone around `direction`, full inside `inner`, fading to zero at `outer`.
    Spot {
        /// W/sr on the axis.
        intensity: Rgb,
        /// Half angle of full intensity, radians, in [0, outer).
        inner_angle_rad: f32,
        /// Half angle where it reaches zero, radians, in (0, π/2].
        outer_angle_rad: f32,
    },
    /// From infinitely far, along `direction`.
    Directional {
        /// W/m² on a surface that faces the light.
        irradiance: Rgb,
    },
}

/// A punctual light.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// The node it is mounted on; the world for `None`.
    pub parent: Option<Id>,
    /// Position in the parent's space, metres; without meaning for a directional light.
    pub position: DVec3,
    /// Direction the light travels on its axis, in the parent's space, unit length; without meaning for a point light.
    pub direction: DVec3,
    /// Kind and strength.
    pub kind: LightKind,
}

/// Radiance that arrives from outside the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Environment {
    /// Black.
    #[default]
    None,
    /// The same from everywhere, W/(m² sr).
    Constant(Rgb),
    /// An equirectangular picture: u runs from −Z over +X … once around +Y, v from +Y (top row) to −Y.
    Image {
        /// A texture with `Rgba32F` texels: radiance W/(m² sr).
        texture: Id,
        /// Factor on the texels.
        scale: Rgb,
        /// Turn around +Y, radians, right-handed.
        rotation_rad: f32,
    },
}
