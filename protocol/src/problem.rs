//! Errors as both sides read them: RFC 9457 problem details, over HTTP (`application/problem+json`) and in the message
//! `error`.

use crate::ParseError;
use serde::{Deserialize, Serialize};

/// What went wrong, in the form of RFC 9457 with extension members for edits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    /// URI that names the kind, JSON `type`: one of [`ProblemKind::uri`], for programs to compare.
    #[serde(rename = "type")]
    pub kind: String,
    /// The kind in words, always the same for one kind.
    pub title: String,
    /// The HTTP status, over the WebSocket too.
    pub status: u16,
    /// What happened this time, to which thing, and what to do.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
    /// Of a refused batch: the op of the edit that refused it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub op: Option<String>,
    /// Of a refused batch: the place of that edit in the batch, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub op_index: Option<u32>,
    /// The offending field, as a path: `transform.translation[0]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// The scene's revision now, where it matters (`revision-moved`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revision: Option<u64>,
}

/// The kinds of problem there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ProblemKind {
    /// Not JSON, not UTF-8, or a message of unknown shape.
    Malformed,
    /// No such scene, camera or resource.
    NotFound,
    /// The scene id is taken, or an idempotency key was used for another batch.
    Conflict,
    /// `If-Match` named another revision than the present one.
    RevisionMoved,
    /// More bytes than the limit.
    TooLarge,
    /// A body or picture in a format the server does not read or write.
    UnsupportedFormat,
    /// An edit cannot be applied; nothing of its batch was.
    EditRefused,
    /// A value outside its range in something that is no edit.
    ValueRefused,
    /// Too many messages a second, or too many viewers or scenes.
    TooMany,
    /// A fault of the server.
    Internal,
    /// Not now: starting, stopping, disk full.
    Unavailable,
}

impl ProblemKind {
    /// HTTP status, last part of the URI, title.
    fn row(self) -> (u16, &'static str, &'static str) {
        match self {
            Self::Malformed => (400, "urn:lumicast:problem:malformed", "The request cannot be read"),
            Self::NotFound => (404, "urn:lumicast:problem:not-found", "There is no such thing"),
            Self::Conflict => (409, "urn:lumicast:problem:conflict", "The name is taken"),
            Self::RevisionMoved => (412, "urn:lumicast:problem:revision-moved", "The scene has moved on"),
            Self::TooLarge => (413, "urn:lumicast:problem:too-large", "A size is over its limit"),
            Self::UnsupportedFormat => {
                (415, "urn:lumicast:problem:unsupported-format", "The format is not supported")
            }
            Self::EditRefused => (422, "urn:lumicast:problem:edit-refused", "An edit was refused"),
            Self::ValueRefused => (422, "urn:lumicast:problem:value-refused", "A value is out of range"),
            Self::TooMany => (429, "urn:lumicast:problem:too-many", "Too many at once"),
            Self::Internal => (500, "urn:lumicast:problem:internal", "The server failed"),
            Self::Unavailable => (503, "urn:lumicast:problem:unavailable", "The server cannot do this now"),
        }
    }

    /// Every kind, for documents and tests.
    pub const ALL: [Self; 11] = [
        Self::Malformed,
        Self::NotFound,
        Self::Conflict,
        Self::RevisionMoved,
        Self::TooLarge,
        Self::UnsupportedFormat,
        Self::EditRefused,
        Self::ValueRefused,
        Self::TooMany,
        Self::Internal,
        Self::Unavailable,
    ];

    /// The HTTP status that goes with it.
    pub fn status(self) -> u16 {
        self.row().0
    }

    /// The problem's `type`.
    pub fn uri(self) -> &'static str {
        self.row().1
    }

    /// The problem's `title`.
    pub fn title(self) -> &'static str {
        self.row().2
    }
}

impl Problem {
    /// A problem of this kind.
    ///
    /// - `detail`: what happened to which thing, and what to do about it
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        Self {
            kind: kind.uri().into(),
            title: kind.title().into(),
            status: kind.status(),
            detail: detail.into(),
            op: None,
            op_index: None,
            field: None,
            revision: None,
        }
    }

    /// The same, with the edit that caused it.
    pub fn at_op(mut self, op_index: usize, op: impl Into<String>) -> Self {
        // A batch never holds 2³² edits (the limit on bytes is far below); if it did, the last index is as good.
        self.op_index = Some(u32::try_from(op_index).unwrap_or(u32::MAX));
        self.op = Some(op.into());
        self
    }

    /// The same, with the field that caused it.
    pub fn at_field(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// The same, with the scene's revision now.
    pub fn at_revision(mut self, revision: u64) -> Self {
        self.revision = Some(revision);
        self
    }

    /// Whether it is of this kind.
    pub fn is(&self, kind: ProblemKind) -> bool {
        self.kind == kind.uri()
    }
}

impl From<ParseError> for Problem {
    fn from(error: ParseError) -> Self {
        let kind = if error.op_index.is_some() { ProblemKind::EditRefused } else { ProblemKind::Malformed };
        Self {
            op: error.op.clone(),
            op_index: error.op_index.map(|index| u32::try_from(index).unwrap_or(u32::MAX)),
            field: error.field.clone(),
            ..Self::new(kind, error.to_string())
        }
    }
}
