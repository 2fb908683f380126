//! Names of objects in a scene.

use std::{borrow::Borrow, fmt, sync::Arc};

/// Name of an object, unique among its kind; 1 to 128 bytes without control characters.
///
/// Cheap to clone. Names come from files and from edits and stay what people called things.
#[derive(Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id(Arc<str>);

impl Id {
    /// Longest name in bytes: longer ones are mistakes, and names are kept per object.
    pub const BYTES_MAX: usize = 128;

    /// Checks a name. `None` when it is empty, too long or holds control characters.
    pub fn new(name: &str) -> Option<Id> {
        let valid = !name.is_empty() && name.len() <= Self::BYTES_MAX && !name.chars().any(char::is_control);
        valid.then(|| Id(name.into()))
    }

    /// Makes a valid name of any text: control characters become `_`, long ones are cut, empty ones become `fallback`.
    pub fn sanitised(name: &str, fallback: &str) -> Id {
        let mut text: String = name.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
        // Room is left for the ` #123` that makes a name unique.
        text.truncate(text.floor_char_boundary(Self::BYTES_MAX - 16));
        Id(if text.is_empty() { fallback.into() } else { text.into() })
    }

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Borrow<str> for Id {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", &self.0)
    }
}
