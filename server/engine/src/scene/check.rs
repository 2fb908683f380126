//! Checks of single values on their way into a scene: numbers, directions, colours, counts. `mesh_check.rs` does meshes.

use glam::DAffine3;
use indexmap::IndexMap;

use super::{Id, Light, LightKind, Material, SceneError};
use crate::math::Rgb;

pub(super) fn refuse_duplicate<T>(
    kind: &'static str,
    map: &IndexMap<Id, T>,
    id: &Id,
) -> Result<(), SceneError> {
    if map.contains_key(id) { Err(SceneError::Duplicate { kind, id: id.clone() }) } else { Ok(()) }
}

pub(super) fn bad(
    kind: &'static str,
    id: impl ToString,
    field: &'static str,
    value: String,
    expected: &'static str,
) -> SceneError {
    SceneError::BadValue { kind, id: id.to_string(), field, value, expected }
}

pub(super) fn over_limit(
    kind: &'static str,
    id: &Id,
    what: &'static str,
    value: u64,
    limit: u64,
) -> Result<(), SceneError> {
    if value <= limit {
        Ok(())
    } else {
        Err(SceneError::OverLimit { kind, id: id.to_string(), what, value, limit })
    }
}

/// Finite, invertible, and of a size whose inverse single precision still holds.
pub(super) fn check_transform(kind: &'static str, id: &Id, transform: &DAffine3) -> Result<(), SceneError> {
    let value = || format!("{:?}", transform.to_cols_array());
    if !transform.is_finite() {
        return Err(bad(kind, id, "transform", value(), "finite"));
    }
    if is_invertible(transform) {
        return Ok(());
    }
    // The bounds of `is_invertible`.
    Err(bad(
        kind,
        id,
        "transform",
        value(),
        "invertible (axes from 1e-12 to 1e12 long, no two of them alike)",
    ))
}

/// True when the builder takes `transform` for a node: its inverse exists and single precision holds it.
pub fn is_invertible(transform: &DAffine3) -> bool {
    let columns = transform.matrix3;
    let lengths = [columns.x_axis.length(), columns.y_axis.length(), columns.z_axis.length()];
    let volume = columns.determinant().abs() / (lengths[0] * lengths[1] * lengths[2]);
    // 1e-6: axes closer than a thousandth of a degree have no inverse that f32 could use.
    lengths.iter().all(|length| (1e-12..=1e12).contains(length)) && volume > 1e-6
}

pub(super) fn check_light_colour(
    kind: &'static str,
    id: impl ToString,
    field: &'static str,
    colour: Rgb,
) -> Result<(), SceneError> {
    // 1e20 W keeps every product with areas and distances inside f32.
    if colour.is_finite() && colour.is_non_negative() && colour.max_component() <= 1e20 {
        return Ok(());
    }
    Err(bad(kind, id, field, format!("{:?}", colour.to_array()), "finite, not negative and at most 1e20"))
}

pub(super) fn check_light(id: &Id, light: &Light, coordinate_max_m: f64) -> Result<(), SceneError> {
    // `max_element` passes over NaN, so finiteness is asked for by itself.
    if !(light.position.is_finite() && light.position.abs().max_element() <= coordinate_max_m) {
        return Err(bad("light", id, "position", light.position.to_string(), "within the coordinate limit"));
    }
    if !(light.direction.is_finite() && light.direction.length() > 1e-12) {
        return Err(bad("light", id, "direction", light.direction.to_string(), "finite and not zero"));
    }
    match light.kind {
        LightKind::Point { intensity } => check_light_colour("light", id, "intensity", intensity),
        LightKind::Directional { irradiance } => check_light_colour("light", id, "irradiance", irradiance),
        LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad } => {
            check_light_colour("light", id, "intensity", intensity)?;
            if !(outer_angle_rad > 0.0 && outer_angle_rad <= std::f32::consts::FRAC_PI_2 + 1e-6) {
                let value = outer_angle_rad.to_string();
                return Err(bad("light", id, "outer_angle_rad", value, "above 0 and at most π/2"));
            }
            if !(inner_angle_rad >= 0.0 && inner_angle_rad < outer_angle_rad) {
                let value = inner_angle_rad.to_string();
                return Err(bad(
                    "light",
                    id,
                    "inner_angle_rad",
                    value,
                    "at least 0 and below outer_angle_rad",
                ));
            }
            Ok(())
        }
    }
}

pub(super) fn check_material(id: &Id, material: &Material) -> Result<(), SceneError> {
    let share = |field, value: f32| match (0.0..=1.0).contains(&value) {
        true => Ok(()),
        false => Err(bad("material", id, field, value.to_string(), "between 0 and 1")),
    };
    let shares = |field, value: Rgb| value.to_array().into_iter().try_for_each(|value| share(field, value));
    let at_least = |field, value: f32, least: f32, expected| match value >= least && value.is_finite() {
        true => Ok(()),
        false => Err(bad("material", id, field, value.to_string(), expected)),
    };
    shares("base_color", material.base_color)?;
    share("alpha", material.alpha)?;
    share("metallic", material.metallic)?;
    share("roughness", material.roughness)?;
    share("specular", material.specular)?;
    share("transmission", material.transmission)?;
    shares("attenuation_color", material.attenuation_color)?;
    at_least("ior", material.ior, 1.0, "at least 1 and finite")?;
    for value in material.specular_color.to_array() {
        at_least("specular_color", value, 0.0, "finite and not negative")?;
    }
    if material.attenuation_distance_m.is_nan() || material.attenuation_distance_m <= 0.0 {
        let value = material.attenuation_distance_m.to_string();
        return Err(bad("material", id, "attenuation_distance_m", value, "above 0 (infinite = clear)"));
    }
    check_light_colour("material", id, "emission", material.emission)?;
    if let Some(cutoff) = material.alpha_cutoff {
        at_least("alpha_cutoff", cutoff, 0.0, "finite and not negative")?;
    }
    at_least("normal_scale", material.normal_scale.abs(), 0.0, "finite")?;
    for texture in material.textures.iter().flatten() {
        if texture.texcoord_set > 1 {
            let value = texture.texcoord_set.to_string();
            return Err(bad("material", id, "texcoord", value, "0 or 1: two sets are read"));
        }
        if !texture.uv_transform.is_finite() {
            return Err(bad(
                "material",
                id,
                "texture transform",
                format!("{}", texture.uv_transform),
                "finite",
            ));
        }
    }
    Ok(())
}
