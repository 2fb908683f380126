//! Names of things: ids inside a scene, and ids of scenes (which also stand in URLs and in the store).
//!
//! Checked where they come in, so that nothing behind this crate meets an empty, endless or unprintable name.

use serde::{Deserialize, Serialize};
use std::{borrow::Borrow, fmt, ops::Deref, str::FromStr};

/// Longest [`Id`], in bytes of UTF-8. Part of the protocol, not configurable: stored scenes rely on it.
pub const ID_BYTES_MAX: usize = 128;
/// Longest [`SceneId`], in bytes. It becomes a file name and a metrics label, so it is kept short.
pub const SCENE_ID_BYTES_MAX: usize = 64;

/// Why a text is no id.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IdError {
    /// Nothing to call the thing by.
    #[error("an id is empty; give it 1 to {max} bytes")]
    Empty {
        /// Longest allowed, in bytes.
        max: usize,
    },
    /// Longer than the limit.
    #[error("an id of {bytes} bytes begins with {start:?}; the limit is {max}")]
    TooLong {
        /// Its length in bytes.
        bytes: usize,
        /// Its first characters.
        start: String,
        /// Longest allowed, in bytes.
        max: usize,
    },
    /// A character that may not stand there.
    #[error("id {id:?} holds the character {character:?}; {allowed}")]
    Character {
        /// The id.
        id: String,
        /// The first character refused.
        character: char,
        /// What may stand in such an id.
        allowed: &'static str,
    },
}

/// Id of a mesh, node, material, light or camera: 1 to [`ID_BYTES_MAX`] bytes of UTF-8 without control characters.
/// Unique within its kind: a mesh and a node may both be `floor`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Id(String);

/// Id of a scene: 1 to [`SCENE_ID_BYTES_MAX`] of `A–Z a–z 0–9 - _ .`, not beginning with a dot, so that it can stand in
/// a URL and name a file as it is.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SceneId(String);

impl Id {
    /// Checks a text that is to be an id.
    pub fn new(text: impl Into<String>) -> Result<Self, IdError> {
        let text = within(text.into(), ID_BYTES_MAX)?;
        match text.chars().find(|c| c.is_control()) {
            Some(character) => {
                Err(IdError::Character { id: text, character, allowed: "control characters are refused" })
            }
            None => Ok(Self(text)),
        }
    }

    /// The nearest id to a name from a file: control characters become `_`, what is too long is cut at a character
    /// boundary, an empty name becomes `unnamed`. Two names may meet in one id; who asks makes them unique.
    pub fn from_name(name: &str) -> Self {
        let mut text = String::new();
        for character in name.chars() {
            if text.len() + character.len_utf8() > ID_BYTES_MAX {
                break;
            }
            text.push(if character.is_control() { '_' } else { character });
        }
        if text.is_empty() { Self("unnamed".into()) } else { Self(text) }
    }
}

impl SceneId {
    /// Checks a text that is to be a scene's id.
    pub fn new(text: impl Into<String>) -> Result<Self, IdError> {
        const ALLOWED: &str =
            "a scene's id is made of A-Z a-z 0-9 - _ and dots, and does not begin with a dot";
        let text = within(text.into(), SCENE_ID_BYTES_MAX)?;
        let refused = |(at, c): &(usize, char)| {
            !(c.is_ascii_alphanumeric() || *c == '-' || *c == '_' || (*c == '.' && *at > 0))
        };
        match text.char_indices().find(refused) {
            Some((_, character)) => Err(IdError::Character { id: text, character, allowed: ALLOWED }),
            None => Ok(Self(text)),
        }
    }
}

/// The length rule that both kinds share.
fn within(text: String, max: usize) -> Result<String, IdError> {
    match text.len() {
        0 => Err(IdError::Empty { max }),
        bytes if bytes > max => Err(IdError::TooLong { bytes, start: text.chars().take(24).collect(), max }),
        _ => Ok(text),
    }
}

/// What every checked text can do; written once for both.
macro_rules! text_like {
    ($Type:ident) => {
        impl $Type {
            /// The text itself.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }
        impl TryFrom<String> for $Type {
            type Error = IdError;
            fn try_from(text: String) -> Result<Self, IdError> {
                Self::new(text)
            }
        }
        impl FromStr for $Type {
            type Err = IdError;
            fn from_str(text: &str) -> Result<Self, IdError> {
                Self::new(text)
            }
        }
        impl From<$Type> for String {
            fn from(id: $Type) -> String {
                id.0
            }
        }
        impl Deref for $Type {
            type Target = str;
            fn deref(&self) -> &str {
                &self.0
            }
        }
        impl AsRef<str> for $Type {
            fn as_ref(&self) -> &str {
                &self.0
            }
        }
        impl Borrow<str> for $Type {
            fn borrow(&self) -> &str {
                &self.0
            }
        }
        impl PartialEq<str> for $Type {
            fn eq(&self, other: &str) -> bool {
                self.0 == other
            }
        }
        impl PartialEq<&str> for $Type {
            fn eq(&self, other: &&str) -> bool {
                self.0 == *other
            }
        }
        impl fmt::Display for $Type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
    };
}
text_like!(Id);
text_like!(SceneId);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_one_to_128_bytes_without_control_characters() {
        assert!(Id::new("Säule 3 / ⊙").is_ok());
        assert!(Id::new("x".repeat(128)).is_ok());
        assert!(matches!(Id::new(""), Err(IdError::Empty { .. })));
        assert!(matches!(Id::new("x".repeat(129)), Err(IdError::TooLong { bytes: 129, .. })));
        assert!(matches!(Id::new("a\nb"), Err(IdError::Character { character: '\n', .. })));
        assert!(serde_json::from_str::<Id>("\"a\\u0000\"").is_err());
    }

    #[test]
    fn every_name_from_a_file_becomes_an_id() {
        for name in ["", "floor", "a\u{0}b", &"é".repeat(100)] {
            let id = Id::from_name(name);
            assert_eq!(Id::new(id.as_str()), Ok(id.clone()), "{name:?}");
        }
        assert_eq!(Id::from_name("a\tb"), "a_b");
    }

    #[test]
    fn a_scene_id_cannot_leave_its_folder_or_its_url() {
        assert!(SceneId::new("cornell-box_2.v1").is_ok());
        for bad in ["", "..", ".hidden", "a/b", "a\\b", "a b", "a?b", "ü", &"x".repeat(65)] {
            assert!(SceneId::new(bad).is_err(), "{bad:?}");
        }
    }
}
