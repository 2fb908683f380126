//! Where a node stands relative to its parent: a matrix, or translation, rotation and scale, as in glTF 2.0.

use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

/// The transform `parent_from_node`: one of the two forms of glTF.
///
/// JSON `{"matrix":[16 numbers]}` or `{"translation":[x,y,z],"rotation":[x,y,z,w],"scale":[x,y,z]}`, each of the three
/// optional. Metres; f64, so that a scene may lie far from the origin. Not checked here: finite, not singular.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Fields", into = "Fields")]
pub enum Transform {
    /// `[16]`, column-major: the translation is in elements 12, 13, 14.
    Matrix([f64; 16]),
    /// Scale first, then rotation, then translation.
    Parts {
        /// Metres.
        translation: [f64; 3],
        /// Unit quaternion x, y, z, w.
        rotation: [f64; 4],
        /// Factor per axis.
        scale: [f64; 3],
    },
}

const NO_TRANSLATION: [f64; 3] = [0.0; 3];
const NO_ROTATION: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const NO_SCALE: [f64; 3] = [1.0; 3];

impl Transform {
    /// The node stands where its parent stands.
    pub const IDENTITY: Self =
        Self::Parts { translation: NO_TRANSLATION, rotation: NO_ROTATION, scale: NO_SCALE };

    /// A move alone, in metres.
    pub fn from_translation(translation: [f64; 3]) -> Self {
        Self::Parts { translation, rotation: NO_ROTATION, scale: NO_SCALE }
    }

    /// The matrix `parent_from_node`, `[16]` column-major. The quaternion is taken as it is: who needs it to be of unit
    /// length checks that before.
    pub fn matrix(&self) -> [f64; 16] {
        match *self {
            Self::Matrix(matrix) => matrix,
            Self::Parts { translation: t, rotation: [x, y, z, w], scale: [sx, sy, sz] } => [
                (1.0 - 2.0 * (y * y + z * z)) * sx,
                2.0 * (x * y + z * w) * sx,
                2.0 * (x * z - y * w) * sx,
                0.0,
                2.0 * (x * y - z * w) * sy,
                (1.0 - 2.0 * (x * x + z * z)) * sy,
                2.0 * (y * z + x * w) * sy,
                0.0,
                2.0 * (x * z + y * w) * sz,
                2.0 * (y * z - x * w) * sz,
                (1.0 - 2.0 * (x * x + y * y)) * sz,
                0.0,
                t[0],
                t[1],
                t[2],
                1.0,
            ],
        }
    }

    pub(crate) fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// The JSON of a transform. Apart from [`Transform`] because serde's untagged enums name no field when they refuse.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    matrix: Option<[f64; 16]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    translation: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "quaternion")]
    rotation: Option<[f64; 4]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scale: Option<[f64; 3]>,
}

/// Says what a rotation is where it is something else: three numbers are angles to many.
fn quaternion<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 4]>, D::Error> {
    let Some(numbers) = Option::<Vec<f64>>::deserialize(deserializer)? else { return Ok(None) };
    let four = numbers.try_into().map_err(|numbers: Vec<f64>| {
        let count = numbers.len();
        D::Error::custom(format!("a rotation is a unit quaternion [x, y, z, w] of 4 numbers, not {count}"))
    })?;
    Ok(Some(four))
}

impl TryFrom<Fields> for Transform {
    type Error = &'static str;
    fn try_from(fields: Fields) -> Result<Self, Self::Error> {
        let parts = fields.translation.is_some() || fields.rotation.is_some() || fields.scale.is_some();
        match fields.matrix {
            Some(_) if parts => {
                Err("a transform is either `matrix` or `translation`, `rotation`, `scale`, not both")
            }
            Some(matrix) => Ok(Self::Matrix(matrix)),
            None => Ok(Self::Parts {
                translation: fields.translation.unwrap_or(NO_TRANSLATION),
                rotation: fields.rotation.unwrap_or(NO_ROTATION),
                scale: fields.scale.unwrap_or(NO_SCALE),
            }),
        }
    }
}

impl From<Transform> for Fields {
    fn from(transform: Transform) -> Self {
        match transform {
            Transform::Matrix(matrix) => {
                Self { matrix: Some(matrix), translation: None, rotation: None, scale: None }
            }
            Transform::Parts { translation, rotation, scale } => Self {
                matrix: None,
                translation: Some(translation),
                rotation: Some(rotation),
                scale: Some(scale),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_that_are_none_are_told_what_they_are() {
        let of = |rotation: &str| serde_json::from_str::<Transform>(&format!(r#"{{"rotation":{rotation}}}"#));
        assert_eq!(of("[0,0,0,1]").unwrap(), Transform::IDENTITY);
        assert_eq!(of("null").unwrap(), Transform::IDENTITY);
        for wrong in ["[0,90,0]", "[]", "[0,0,0,1,0]"] {
            let told = of(wrong).unwrap_err().to_string();
            assert!(told.contains("unit quaternion [x, y, z, w] of 4 numbers, not "), "{told}");
        }
        assert!(of("[0,0,\"up\",1]").is_err() && of("1").is_err());
    }

    #[test]
    fn parts_and_matrix_are_two_spellings_of_one_transform() {
        // A quarter turn about +Y takes +X to −Z; the scale acts before it.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let m = Transform::Parts {
            translation: [1.0, 2.0, 3.0],
            rotation: [0.0, half, 0.0, half],
            scale: [2.0, 3.0, 4.0],
        }
        .matrix();
        let expected = [0.0, 0.0, -2.0, 0.0, 0.0, 3.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 1.0];
        // 1e-12: a handful of roundings of numbers near 4.
        assert!(m.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{m:?}");
    }

    #[test]
    fn a_transform_has_one_form_and_no_other_field() {
        let parse = serde_json::from_str::<Transform>;
        assert_eq!(parse("{}").unwrap(), Transform::IDENTITY);
        assert!(parse(r#"{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"scale":[1,1,1]}"#).is_err());
        assert!(parse(r#"{"matrix":[1,0,0]}"#).is_err());
        assert!(parse(r#"{"translate":[1,0,0]}"#).unwrap_err().to_string().contains("translate"));
    }
}
