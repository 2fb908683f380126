//! Why a change to a scene was refused.

use super::Id;

/// A refused change: names the object, the field and the bound that was broken.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// An id that is empty, too long or holds control characters.
    #[error("{kind} id {name:?}: ids are 1 to 128 bytes without control characters")]
    BadId {
        /// Kind of object.
        kind: &'static str,
        /// The id as given, cut to 64 characters.
        name: String,
    },
    /// An id that names nothing.
    #[error("there is no {kind} {id:?}")]
    Unknown {
        /// Kind of object.
        kind: &'static str,
        /// Field that held the id.
        field: &'static str,
        /// The id.
        id: String,
    },
    /// An id that is taken.
    #[error("there is a {kind} {id:?} already: choose another id or remove it first")]
    Duplicate {
        /// Kind of object.
        kind: &'static str,
        /// The id.
        id: Id,
    },
    /// A number outside what the field may hold.
    #[error("{kind} {id:?}: {field} is {value}, but must be {expected}")]
    BadValue {
        /// Kind of object.
        kind: &'static str,
        /// The object.
        id: String,
        /// The field.
        field: &'static str,
        /// The value as text.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// An object that is still referred to.
    #[error("{kind} {id:?} is still used by {user}")]
    InUse {
        /// Kind of object.
        kind: &'static str,
        /// The object.
        id: Id,
        /// Who uses it.
        user: String,
    },
    /// A limit of [`super::SceneLimits`].
    #[error("{kind} {id:?}: the scene would hold {value} {what}, the limit is {limit}")]
    OverLimit {
        /// Kind of object.
        kind: &'static str,
        /// The object that would break the limit.
        id: String,
        /// What is counted.
        what: &'static str,
        /// How many there would be.
        value: u64,
        /// The limit.
        limit: u64,
    },
}

impl SceneError {
    /// The field at fault, in the words of the edit protocol, when one is.
    pub fn field(&self) -> Option<&'static str> {
        match self {
            SceneError::BadId { kind, .. } => Some(kind),
            SceneError::Unknown { field, .. } | SceneError::BadValue { field, .. } => Some(field),
            SceneError::Duplicate { kind, .. } | SceneError::InUse { kind, .. } => Some(kind),
            SceneError::OverLimit { kind, what, .. } => Some(match (*kind, *what) {
                ("mesh", "vertices") => "positions",
                ("node", "emissive triangles") => "mesh",
                ("node", "levels of nodes") => "parent",
                ("material", "emissive triangles") => "emission",
                ("mesh", what) => what,
                // One too many of its kind: nothing but the op itself is at fault, which its id names.
                (kind, _) => kind,
            }),
        }
    }
}
