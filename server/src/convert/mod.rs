//! Between the wire and the engine: the only room that knows both the protocol's types and the scene's.
//!
//! [`apply`] puts a batch of edits through the engine's builder, [`describe`] tells a scene back. Numbers are judged by
//! the builder; here only shapes are changed and the engine's refusals become problems that name op and field.

mod describe;
mod edits;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use lumicast_engine::{effects, film, render, scene};
use lumicast_protocol as wire;

pub use describe::{describe, effects};
pub use edits::{Applied, EditLimits, apply};

/// A value that has no meaning in the engine: which field, and why.
#[derive(Debug, PartialEq)]
struct BadField {
    field: &'static str,
    reason: String,
}

fn refuse<T>(field: &'static str, reason: impl Into<String>) -> Result<T, BadField> {
    Err(BadField { field, reason: reason.into() })
}

fn id(id: &wire::Id) -> scene::Id {
    // Both kinds of id follow one rule (a test compares them), so nothing is ever changed here.
    scene::Id::new(id.as_str()).unwrap_or_else(|| scene::Id::sanitised(id.as_str(), "unnamed"))
}

fn wire_id(id: &scene::Id) -> wire::Id {
    wire::Id::from_name(id.as_str())
}

fn affine(transform: &wire::Transform, field: &'static str) -> Result<DAffine3, BadField> {
    match transform {
        wire::Transform::Matrix(matrix) => {
            let matrix = DMat4::from_cols_array(matrix);
            // 1e-9: rounding of a product of a few matrices, not a projection.
            if !matrix.row(3).abs_diff_eq(glam::DVec4::W, 1e-9) {
                return refuse(
                    field,
                    "the last row of the matrix (elements 3, 7, 11, 15) must be 0, 0, 0, 1; is it row-major?",
                );
            }
            Ok(DAffine3::from_mat4(matrix))
        }
        wire::Transform::Parts { translation, rotation, scale } => {
            let rotation = DQuat::from_array(*rotation);
            let length = rotation.length();
            // One part in a thousand: what survives of a unit quaternion written with four digits.
            if !((length - 1.0).abs() <= 1e-3) {
                return refuse(
                    field,
                    format!("the rotation has length {length}, but must be a unit quaternion"),
                );
            }
            Ok(DAffine3::from_scale_rotation_translation(
                DVec3::from(*scale),
                rotation.normalize(),
                DVec3::from(*translation),
            ))
        }
    }
}

fn projection(projection: wire::Projection) -> scene::Projection {
    match projection {
        wire::Projection::Perspective { yfov_rad } => {
            scene::Projection::Perspective { yfov_rad: yfov_rad.into() }
        }
        wire::Projection::Orthographic { half_height_m } => {
            scene::Projection::Orthographic { half_height_m: half_height_m.into() }
        }
    }
}

fn wire_projection(projection: scene::Projection) -> wire::Projection {
    match projection {
        scene::Projection::Perspective { yfov_rad } => {
            wire::Projection::Perspective { yfov_rad: yfov_rad as f32 }
        }
        scene::Projection::Orthographic { half_height_m } => {
            wire::Projection::Orthographic { half_height_m: half_height_m as f32 }
        }
    }
}

/// A viewer's own camera. Its numbers are finite ([`wire::Limits::check`]); here it must have three axes and stand
/// where the engine's single precision still has a meaning.
pub fn view_of_pose(pose: &wire::CameraPose) -> Result<scene::CameraView, wire::Problem> {
    let matrix = wire::Transform::Matrix(pose.world_from_camera);
    let bad = |reason: String| {
        wire::Problem::new(wire::ProblemKind::ValueRefused, format!("field `pose.matrix`: {reason}"))
            .at_field("pose.matrix")
    };
    let world_from_camera = affine(&matrix, "pose.matrix").map_err(|error| bad(error.reason))?;
    let axes = world_from_camera.matrix3;
    let sound =
        [axes.x_axis, axes.y_axis, axes.z_axis].iter().all(|axis| (1e-6..=1e6).contains(&axis.length()));
    let volume =
        axes.determinant().abs() / (axes.x_axis.length() * axes.y_axis.length() * axes.z_axis.length());
    if !(sound && volume > 1e-6) {
        return Err(bad("singular, or scaled beyond reason: a camera's axes have length 1".into()));
    }
    let reach = world_from_camera.translation.abs().max_element();
    let reach_max = scene::SceneLimits::default().coordinate_max_m;
    if reach > reach_max {
        return Err(bad(format!("{reach:e} m from the origin; at most {reach_max:e}")));
    }
    Ok(scene::CameraView { world_from_camera, projection: projection(pose.projection) })
}

/// The engine's name of a tone map.
pub fn tone_map(tone_map: wire::ToneMap) -> film::ToneMap {
    match tone_map {
        wire::ToneMap::Linear => film::ToneMap::Linear,
        wire::ToneMap::Reinhard => film::ToneMap::Reinhard,
        wire::ToneMap::Aces => film::ToneMap::Aces,
        wire::ToneMap::Agx => film::ToneMap::AgX,
    }
}

/// When a picture will have an error, for the wire.
pub fn forecast(expected: &render::Expected) -> wire::Forecast {
    let (when, seconds, figure) = match expected.when {
        render::When::Reached { at_s } => (wire::ForecastWhen::Reached, Some(at_s), None),
        render::When::In { seconds, .. } => (wire::ForecastWhen::In, Some(seconds), None),
        render::When::OutOfReach { error } => (wire::ForecastWhen::OutOfReach, None, Some(error)),
        render::When::BeyondSamples { samples } => (wire::ForecastWhen::BeyondSamples, None, Some(samples)),
        render::When::Unknown => (wire::ForecastWhen::Unknown, None, None),
    };
    let between = match expected.when {
        render::When::In { between, .. } => between,
        _ => None,
    };
    wire::Forecast { error: expected.target as f32, when, seconds, between, figure }
}

/// How many forecasts came true, for the wire.
pub fn forecast_record(record: render::ForecastRecord) -> wire::ForecastRecord {
    let render::ForecastRecord { judged, right, decided, held } = record;
    wire::ForecastRecord { judged, right, decided, held }
}

/// Effects that a viewer chooses in place of the scene's plan.
pub fn effect_choices(choices: wire::EffectChoices) -> effects::EffectChoices {
    let choice = |choice| match choice {
        wire::EffectChoice::Auto => effects::EffectChoice::Plan,
        wire::EffectChoice::On => effects::EffectChoice::On,
        wire::EffectChoice::Off => effects::EffectChoice::Off,
    };
    effects::EffectChoices { caustics: choice(choices.caustics), indirect: choice(choices.indirect) }
}

/// What the engine renders a technique with, and what that is called; a technique that this version lacks is told so.
pub fn indirect(technique: wire::Technique) -> Result<(render::Indirect, wire::Technique), wire::Problem> {
    use wire::Technique::{Auto, Irradiance, Lightmap, None, Octree, Path};
    match technique {
        Auto => Ok((render::Indirect::Auto, Auto)),
        Octree => Ok((render::Indirect::Octree, Octree)),
        Irradiance => Ok((render::Indirect::Irradiance, Irradiance)),
        Path => Ok((render::Indirect::Path, Path)),
        None => Ok((render::Indirect::None, None)),
        Lightmap => Err(wire::Problem::new(
            wire::ProblemKind::ValueRefused,
            "field `technique`: this server has auto, octree, irradiance, path and none, not yet lightmap",
        )
        .at_field("technique")),
    }
}

#[cfg(test)]
mod tests;
