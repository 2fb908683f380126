//! Lights without area (`KHR_lights_punctual`): the edits `add_light` and `set_light`, and how a light is described.
//! Area lights are meshes whose material emits; see [`crate::SetMaterial`].

use crate::{Change, Id};
use serde::{Deserialize, Serialize};
use std::f32::consts::FRAC_PI_4;

/// Which of the three; a light keeps its kind for life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightKind {
    /// Shines from a point in all directions.
    Point,
    /// Shines from a point into a cone.
    Spot,
    /// Shines from infinitely far, everywhere alike.
    Directional,
}

impl LightKind {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Spot => "spot",
            Self::Directional => "directional",
        }
    }
}

/// What a light sends out and from where; flat in JSON beside `"kind"`. Places and directions are in the parent node's
/// space, metres; colours are linear Rec.709.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LightSource {
    /// Shines from a point in all directions.
    Point {
        /// W/sr.
        intensity: [f32; 3],
        /// Where it is.
        position: [f64; 3],
    },
    /// Shines from a point into a cone, full inside the inner angle, nothing outside the outer.
    Spot {
        /// W/sr along the axis.
        intensity: [f32; 3],
        /// Where it is.
        position: [f64; 3],
        /// The way the light travels; any length but 0.
        direction: [f64; 3],
        /// From the axis to the edge of full intensity, 0 ≤ inner < outer.
        inner_angle_rad: f32,
        /// From the axis to the edge of darkness, ≤ π/2.
        outer_angle_rad: f32,
    },
    /// Shines from infinitely far.
    Directional {
        /// W/m² on a surface that faces it.
        irradiance: [f32; 3],
        /// The way the light travels; any length but 0.
        direction: [f64; 3],
    },
}

impl LightSource {
    /// Which of the three.
    pub fn kind(&self) -> LightKind {
        match self {
            Self::Point { .. } => LightKind::Point,
            Self::Spot { .. } => LightKind::Spot,
            Self::Directional { .. } => LightKind::Directional,
        }
    }
}

/// Edit `add_light`. Absent: position the origin, direction −Z, inner angle 0, outer angle π/4 (glTF's defaults).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "AddLightFields", into = "AddLightFields")]
pub struct AddLight {
    /// Id of the new light.
    pub light: Id,
    /// The node it moves with; `None` = the world.
    pub parent: Option<Id>,
    /// Flat in JSON: `kind` and the fields of that kind.
    pub source: LightSource,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AddLightFields {
    light: Id,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    parent: Option<Id>,
    kind: LightKind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    intensity: Option<[f32; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    irradiance: Option<[f32; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    position: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    direction: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    inner_angle_rad: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    outer_angle_rad: Option<f32>,
}

impl TryFrom<AddLightFields> for AddLight {
    type Error = String;
    fn try_from(f: AddLightFields) -> Result<Self, String> {
        let given = Given {
            intensity: f.intensity.is_some(),
            irradiance: f.irradiance.is_some(),
            position: f.position.is_some(),
            direction: f.direction.is_some(),
            angles: f.inner_angle_rad.is_some() || f.outer_angle_rad.is_some(),
        };
        given.suit(f.kind)?;
        let missing =
            |field: &str, unit: &str| format!("a {} light needs `{field}` in {unit}", f.kind.name());
        let intensity = || f.intensity.ok_or_else(|| missing("intensity", "W/sr"));
        let position = f.position.unwrap_or([0.0; 3]);
        let direction = f.direction.unwrap_or([0.0, 0.0, -1.0]);
        let source = match f.kind {
            LightKind::Point => LightSource::Point { intensity: intensity()?, position },
            LightKind::Spot => LightSource::Spot {
                intensity: intensity()?,
                position,
                direction,
                inner_angle_rad: f.inner_angle_rad.unwrap_or(0.0),
                outer_angle_rad: f.outer_angle_rad.unwrap_or(FRAC_PI_4),
            },
            LightKind::Directional => LightSource::Directional {
                irradiance: f.irradiance.ok_or_else(|| missing("irradiance", "W/m²"))?,
                direction,
            },
        };
        Ok(Self { light: f.light, parent: f.parent, source })
    }
}

impl From<AddLight> for AddLightFields {
    fn from(edit: AddLight) -> Self {
        let mut fields = Self {
            light: edit.light,
            parent: edit.parent,
            kind: edit.source.kind(),
            intensity: None,
            irradiance: None,
            position: None,
            direction: None,
            inner_angle_rad: None,
            outer_angle_rad: None,
        };
        match edit.source {
            LightSource::Point { intensity, position } => {
                (fields.intensity, fields.position) = (Some(intensity), Some(position));
            }
            LightSource::Spot { intensity, position, direction, inner_angle_rad, outer_angle_rad } => {
                (fields.intensity, fields.position) = (Some(intensity), Some(position));
                fields.direction = Some(direction);
                (fields.inner_angle_rad, fields.outer_angle_rad) =
                    (Some(inner_angle_rad), Some(outer_angle_rad));
            }
            LightSource::Directional { irradiance, direction } => {
                (fields.irradiance, fields.direction) = (Some(irradiance), Some(direction));
            }
        }
        fields
    }
}

/// Edit `set_light`: changes what is named and keeps the rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetLight {
    /// Which light.
    pub light: Id,
    /// The node it moves with; `null` sets it free into the world.
    #[serde(default, skip_serializing_if = "Change::is_keep")]
    pub parent: Change<Id>,
    /// May be repeated, may not change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<LightKind>,
    /// W/sr; point and spot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intensity: Option<[f32; 3]>,
    /// W/m²; directional.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub irradiance: Option<[f32; 3]>,
    /// Metres in the parent's space; point and spot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// The way the light travels; spot and directional.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Spot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inner_angle_rad: Option<f32>,
    /// Spot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outer_angle_rad: Option<f32>,
}

impl SetLight {
    /// An edit of this light that changes nothing yet.
    pub fn of(light: Id) -> Self {
        Self {
            light,
            parent: Change::Keep,
            kind: None,
            intensity: None,
            irradiance: None,
            position: None,
            direction: None,
            inner_angle_rad: None,
            outer_angle_rad: None,
        }
    }

    /// The light after this edit, or which field does not suit its kind.
    pub fn applied_to(&self, before: &LightSource) -> Result<LightSource, String> {
        let kind = before.kind();
        if self.kind.is_some_and(|asked| asked != kind) {
            return Err(format!(
                "`kind` cannot change: this is a {} light; remove it and add another",
                kind.name()
            ));
        }
        Given {
            intensity: self.intensity.is_some(),
            irradiance: self.irradiance.is_some(),
            position: self.position.is_some(),
            direction: self.direction.is_some(),
            angles: self.inner_angle_rad.is_some() || self.outer_angle_rad.is_some(),
        }
        .suit(kind)?;
        let mut after = *before;
        match &mut after {
            LightSource::Point { intensity, position } => {
                set(intensity, self.intensity);
                set(position, self.position);
            }
            LightSource::Spot { intensity, position, direction, inner_angle_rad, outer_angle_rad } => {
                set(intensity, self.intensity);
                set(position, self.position);
                set(direction, self.direction);
                set(inner_angle_rad, self.inner_angle_rad);
                set(outer_angle_rad, self.outer_angle_rad);
            }
            LightSource::Directional { irradiance, direction } => {
                set(irradiance, self.irradiance);
                set(direction, self.direction);
            }
        }
        Ok(after)
    }
}

fn set<T>(place: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *place = value;
    }
}

/// Which fields of a light an edit names.
struct Given {
    intensity: bool,
    irradiance: bool,
    position: bool,
    direction: bool,
    angles: bool,
}

impl Given {
    /// A field that means nothing for this kind is refused rather than dropped: the sender meant something by it.
    fn suit(&self, kind: LightKind) -> Result<(), String> {
        let directional = kind == LightKind::Directional;
        let refused = [
            (self.intensity && directional, "`intensity`; it is given by `irradiance` in W/m²"),
            (self.irradiance && !directional, "`irradiance`; it is given by `intensity` in W/sr"),
            (self.position && directional, "`position`"),
            (self.direction && kind == LightKind::Point, "`direction`"),
            (self.angles && kind != LightKind::Spot, "`inner_angle_rad` or `outer_angle_rad`"),
        ];
        match refused.iter().find(|(given, _)| *given) {
            Some((_, field)) => Err(format!("a {} light has no {field}", kind.name())),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_light_has_the_fields_of_its_kind_and_no_others() {
        let parse = |s: &str| serde_json::from_str::<AddLight>(s).map_err(|e| e.to_string());
        assert!(parse(r#"{"light":"a","kind":"point","intensity":[1,1,1]}"#).is_ok());
        for (json, named) in [
            (r#"{"light":"a","kind":"point"}"#, "intensity"),
            (r#"{"light":"a","kind":"directional","intensity":[1,1,1]}"#, "irradiance"),
            (r#"{"light":"a","kind":"point","intensity":[1,1,1],"direction":[0,0,1]}"#, "direction"),
            (r#"{"light":"a","kind":"point","intensity":[1,1,1],"outer_angle_rad":1}"#, "outer_angle_rad"),
            (r#"{"light":"a","kind":"area","intensity":[1,1,1]}"#, "area"),
        ] {
            assert!(parse(json).unwrap_err().contains(named), "{json}");
        }
    }

    #[test]
    fn setting_a_light_changes_what_is_named_and_keeps_its_kind() {
        let before = LightSource::Point { intensity: [1.0; 3], position: [1.0, 2.0, 3.0] };
        let id = Id::new("a").unwrap();
        let brighter = SetLight { intensity: Some([2.0; 3]), ..SetLight::of(id.clone()) };
        let after = brighter.applied_to(&before).unwrap();
        assert_eq!(after, LightSource::Point { intensity: [2.0; 3], position: [1.0, 2.0, 3.0] });
        let other = SetLight { kind: Some(LightKind::Spot), ..SetLight::of(id) };
        assert!(other.applied_to(&before).unwrap_err().contains("kind"));
    }
}
