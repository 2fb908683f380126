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
    #[error("there is no {kind} {id:?}: {known}")]
    Unknown {
        /// Kind of object.
        kind: &'static str,
        /// Field that held the id.
        field: &'static str,
        /// The id, cut to 64 characters.
        id: String,
        /// Which there are instead, in words.
        known: String,
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

/// Ids that are named where one is unknown.
const NAMED_MAX: usize = 8;
/// Characters of an id in a message.
const ID_CHARACTERS: usize = 64;

impl SceneError {
    /// An id that names none of `known`.
    pub fn unknown<'a>(
        kind: &'static str,
        field: &'static str,
        id: &str,
        known: impl Iterator<Item = &'a Id>,
    ) -> SceneError {
        let cut = |id: &str| id.chars().take(ID_CHARACTERS).collect::<String>();
        SceneError::Unknown {
            kind,
            field,
            id: cut(id),
            known: list_of(id, known.map(|known| cut(known.as_str()))),
        }
    }

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

/// Some ids in words: those first that begin most like `like`, in capitals or not, else in their order.
fn list_of(like: &str, ids: impl Iterator<Item = String>) -> String {
    let alike = |id: &String| {
        let pairs = id.chars().flat_map(char::to_lowercase).zip(like.chars().flat_map(char::to_lowercase));
        std::cmp::Reverse(pairs.take_while(|(a, b)| a == b).count())
    };
    let mut ids: Vec<String> = ids.collect();
    ids.sort_by_cached_key(alike);
    let others = ids.len().saturating_sub(NAMED_MAX);
    let mut words: Vec<String> = ids.iter().take(NAMED_MAX).map(|id| format!("{id:?}")).collect();
    if others > 0 {
        words.push(format!("{others} more"));
    }
    match words.as_slice() {
        [] => "the scene has none".into(),
        [one] => format!("there is {one}"),
        [first @ .., last] => format!("there are {} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is unknown is told with what there is, the most alike first, and never more than a few.
    #[test]
    fn unknown_ids_name_those_there_are() {
        let told = |id: &str, names: &[&str]| {
            let ids: Vec<Id> = names.iter().map(|name| Id::new(name).unwrap()).collect();
            SceneError::unknown("light", "light", id, ids.iter()).to_string()
        };
        assert_eq!(told("lamp", &[]), "there is no light \"lamp\": the scene has none");
        assert_eq!(told("lamp", &["sun"]), "there is no light \"lamp\": there is \"sun\"");
        assert_eq!(
            told("lamp", &["sun", "Lamp.001", "window"]),
            "there is no light \"lamp\": there are \"Lamp.001\", \"sun\" and \"window\""
        );
        let many: Vec<String> = (0..40).map(|number| format!("{number}{}", "n".repeat(100))).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        let message = told(&"x".repeat(1000), &many);
        assert!(message.ends_with(" and 32 more") && message.len() < 10 * 80, "{message}");
    }
}
