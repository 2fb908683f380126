//! From text to edits and messages, with errors that name op and field.
//!
//! serde alone says "invalid type" somewhere in a tagged enum. So: parse at once, and only a text that was refused is
//! looked at again, edit by edit, to find the culprit. The contract's 422 "names op and field" comes from here.

use crate::{
    Accuracy, AddLight, AddMesh, AddNode, CameraRequest, ClientHello, ClientMessage, Edit, EditBatch,
    EditRequest, LoadGltf, Quality, RemoveCamera, RemoveLight, RemoveNode, ServerMessage, SetCamera,
    SetEnvironment, SetLight, SetMaterial, SetTransform,
};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::fmt;

/// Why a text is no batch of edits or no message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct ParseError {
    /// Place of the offending edit in its batch, from 0; `None` where the text as a whole is at fault.
    pub op_index: Option<usize>,
    /// Its op, if it names one.
    pub op: Option<String>,
    /// The offending field as a path, `transform.translation[0]`, where it is known.
    pub field: Option<String>,
    /// What is wrong with it.
    pub reason: String,
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place: Vec<String> = [
            self.op_index.map(|index| format!("edits[{index}]")),
            self.op.as_ref().map(|op| format!("({op})")),
            self.field.as_ref().map(|field| format!("field `{field}`")),
        ]
        .into_iter()
        .flatten()
        .collect();
        let separator = if place.is_empty() { "" } else { ": " };
        write!(f, "{}{separator}{}", place.join(" "), self.reason)
    }
}

impl ParseError {
    fn of_text(error: &serde_json::Error) -> Self {
        Self { op_index: None, op: None, field: None, reason: error.to_string() }
    }
}

impl EditBatch {
    /// Reads the body of `POST /v1/scenes/{id}/edits`: `{"edits":[…]}` or a bare array.
    pub fn from_json(json: &[u8]) -> Result<Self, ParseError> {
        serde_json::from_slice(json)
            .map_err(|error| culprit_among_edits(json).unwrap_or_else(|| ParseError::of_text(&error)))
    }
}

impl ClientMessage {
    /// Reads a text frame from a client.
    pub fn from_json(json: &str) -> Result<Self, ParseError> {
        serde_json::from_str(json).map_err(|error| {
            culprit_among_edits(json.as_bytes())
                .or_else(|| culprit_of_message(json))
                .unwrap_or_else(|| ParseError::of_text(&error))
        })
    }

    /// The text frame that says this.
    pub fn to_json(&self) -> String {
        json_of(self)
    }
}

impl ServerMessage {
    /// Reads a text frame from the server.
    pub fn from_json(json: &str) -> Result<Self, ParseError> {
        serde_json::from_str(json).map_err(|error| ParseError::of_text(&error))
    }

    /// The text frame that says this.
    pub fn to_json(&self) -> String {
        json_of(self)
    }
}

/// JSON of a message. serde_json fails on maps whose keys are no strings and on failing `Serialize` impls; these types
/// have neither (every message is written in a test), so a failure is a bug.
fn json_of<T: serde::Serialize>(message: &T) -> String {
    serde_json::to_string(message)
        .unwrap_or_else(|error| panic!("a message cannot be written as JSON: {error}"))
}

/// The first edit in a refused text that is to blame, if an edit is.
fn culprit_among_edits(json: &[u8]) -> Option<ParseError> {
    let edits = match whole_of(std::str::from_utf8(json).ok()?)? {
        Value::Array(edits) => edits,
        Value::Object(mut object) => match object.remove("edits") {
            Some(Value::Array(edits)) => edits,
            None => return object.remove("op").map(|op| edit_alone(&op)),
            Some(_) => return None,
        },
        _ => return None,
    };
    edits.into_iter().enumerate().find_map(|(index, edit)| {
        let (op, field, reason) = fault_of_edit(edit)?;
        Some(ParseError { op_index: Some(index), op, field, reason })
    })
}

/// An edit where a batch of them belongs.
fn edit_alone(op: &Value) -> ParseError {
    let reason = format!("an edit ({op}) alone is no batch: put it in a list, {{\"edits\": [{{…}}]}}");
    ParseError { op_index: None, op: None, field: None, reason }
}

/// The number of a refused edit, so that its sender learns which one it was; also where the text is no JSON for a number that is none.
pub fn request_of(text: &str) -> Option<u64> {
    whole_of(text)?.get("request")?.as_u64()
}

/// All of a refused text, where it is JSON but for numbers that are none.
fn whole_of(text: &str) -> Option<Value> {
    serde_json::from_str(text).or_else(|_| serde_json::from_str(&with_non_numbers_quoted(text))).ok()
}

/// The field that is to blame in a refused message about what is looked at and how.
fn culprit_of_message(json: &str) -> Option<ParseError> {
    let Value::Object(mut fields) = whole_of(json)? else { return None };
    let Value::String(kind) = fields.remove("type")? else { return None };
    let fields = Value::Object(fields);
    let (field, reason) = match kind.as_str() {
        "hello" => fault_of::<ClientHello>(fields),
        "camera" => fault_of::<CameraRequest>(fields),
        "quality" => fault_of::<Quality>(fields),
        "accuracy" => fault_of::<Accuracy>(fields),
        // Its edits are good: they were looked at before.
        "edit" => fault_of::<EditRequest>(fields),
        _ => None,
    }?;
    Some(ParseError { op_index: None, op: None, field, reason })
}

/// Op, field and reason of an edit that has the wrong shape; `None` for a good one.
fn fault_of_edit(edit: Value) -> Option<(Option<String>, Option<String>, String)> {
    let Value::Object(mut fields) = edit else {
        return Some((None, None, "an edit is an object with a field `op`".into()));
    };
    let op = match fields.remove("op") {
        Some(Value::String(op)) => op,
        Some(_) => return Some((None, Some("op".into()), "an op is named by a string".into())),
        None => return Some((None, Some("op".into()), "missing; it says what the edit does".into())),
    };
    let fields = Value::Object(fields);
    let fault = match op.as_str() {
        "add_mesh" => fault_of::<AddMesh>(fields),
        "add_node" => fault_of::<AddNode>(fields),
        "remove_node" => fault_of::<RemoveNode>(fields),
        "set_transform" => fault_of::<SetTransform>(fields),
        "set_material" => fault_of::<SetMaterial>(fields),
        "add_light" => fault_of::<AddLight>(fields),
        "set_light" => fault_of::<SetLight>(fields),
        "remove_light" => fault_of::<RemoveLight>(fields),
        "set_camera" => fault_of::<SetCamera>(fields),
        "remove_camera" => fault_of::<RemoveCamera>(fields),
        "set_environment" => fault_of::<SetEnvironment>(fields),
        "load_gltf" => fault_of::<LoadGltf>(fields),
        _ => Some((Some("op".into()), format!("no such op; there are {}", Edit::OPS.join(", ")))),
    };
    fault.map(|(field, reason)| (Some(op), field, reason))
}

/// Path and reason of what is wrong with a value that should be a `T`; `None` for a good one.
fn fault_of<T: DeserializeOwned>(value: Value) -> Option<(Option<String>, String)> {
    let error = serde_path_to_error::deserialize::<_, T>(value).err()?;
    let path = error.path().to_string();
    let reason = error.into_inner().to_string();
    // A whole object is at fault where a field is missing or where fields do not go together; the path ends at that object.
    let field = if path == "." {
        field_named_in(&reason)
    } else if reason.starts_with("missing field ") {
        field_named_in(&reason).map(|field| format!("{path}.{field}"))
    } else {
        Some(path)
    };
    Some((field, with_number_named(reason)))
}

/// The field that a reason blames: serde and the types of this crate put its name between the first backticks.
fn field_named_in(reason: &str) -> Option<String> {
    // There serde puts the value between them, as in "invalid type: floating point `1.5`".
    let blames_a_value = reason.starts_with("invalid ") || reason.starts_with("unknown variant ");
    reason.split('`').nth(1).filter(|_| !blames_a_value).map(String::from)
}

/// The reason, where a number is none in JSON: [`with_non_numbers_quoted`] made it a string, of which who sent it knows
/// nothing.
fn with_number_named(reason: String) -> String {
    let told = reason.strip_prefix("invalid type: string \"").and_then(|rest| {
        let (token, expected) = rest.split_once("\", expected ")?;
        let wants_number = matches!(expected, "f32" | "f64" | "u8" | "u16" | "u32" | "u64");
        (wants_number && is_meant_as_number(token))
            .then(|| format!("{token} is out of range or no number of JSON, expected {expected}"))
    });
    told.unwrap_or(reason)
}

/// The text with every token that is no JSON number but meant as one (`NaN`, `-Infinity`, `1e999`) put between quotes,
/// so that the second look finds the field it stands in. Some languages write these without being asked; the contract
/// answers them as a bad value of that field (422), not as a broken text.
fn with_non_numbers_quoted(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 16);
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let token_bytes = match first {
            '"' => string_bytes(rest),
            c if is_word(c) => rest.find(|c| !is_word(c)).unwrap_or(rest.len()),
            c => c.len_utf8(),
        };
        let (token, after) = rest.split_at(token_bytes);
        if is_meant_as_number(token) {
            out.extend(["\"", token, "\""]);
        } else {
            out.push_str(token);
        }
        rest = after;
    }
    out
}

/// Whether a token is meant as a number that JSON cannot hold.
fn is_meant_as_number(token: &str) -> bool {
    token.parse::<f64>().is_ok_and(|number| !number.is_finite())
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.')
}

/// Bytes of the JSON string that `text` begins with, quotes included; all of `text` where it is never closed.
fn string_bytes(text: &str) -> usize {
    let mut escaped = false;
    for (at, byte) in text.bytes().enumerate().skip(1) {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = true,
            b'"' => return at + 1,
            _ => {}
        }
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Problem, ProblemKind};

    fn refused(json: &str) -> ParseError {
        EditBatch::from_json(json.as_bytes()).unwrap_err()
    }

    #[test]
    fn an_edit_alone_is_told_where_it_belongs() {
        let error = refused(r#"{"op":"remove_node","node":"a"}"#);
        let told = r#"an edit ("remove_node") alone is no batch: put it in a list, {"edits": [{…}]}"#;
        assert_eq!(error.to_string(), told);
        assert!(refused(r#"{"op":7}"#).to_string().contains("no batch"));
        assert!(!refused(r#"{"node":"a"}"#).to_string().contains("no batch"));
    }

    #[test]
    fn a_refused_edit_is_named_by_place_op_and_field() {
        let good = r#"{"op":"remove_node","node":"a"}"#;
        for (edit, op, field) in [
            (
                r#"{"op":"set_transform","node":"a","transform":{"translation":["x",0,0]}}"#,
                "set_transform",
                "transform.translation[0]",
            ),
            (
                r#"{"op":"set_transform","node":"a","transform":{"translation":[NaN,0,0]}}"#,
                "set_transform",
                "transform.translation[0]",
            ),
            (
                r#"{"op":"set_transform","node":"a","transform":{"translation":[0,-Infinity,0]}}"#,
                "set_transform",
                "transform.translation[1]",
            ),
            (
                r#"{"op":"set_transform","node":"a","transform":{"scale":[1,1,1e999]}}"#,
                "set_transform",
                "transform.scale[2]",
            ),
            (r#"{"op":"set_material","material":"m","roughness":"high"}"#, "set_material", "roughness"),
            (r#"{"op":"set_material","material":"m","shine":1}"#, "set_material", "shine"),
            (r#"{"op":"set_transform","node":"a"}"#, "set_transform", "transform"),
            (r#"{"op":"set_transform","node":"","transform":{}}"#, "set_transform", "node"),
            (
                r#"{"op":"add_mesh","mesh":"a","material":"m","positions":[[0,0,0]],"triangles":[[0,-1,0]]}"#,
                "add_mesh",
                "triangles[0][1]",
            ),
            (r#"{"op":"add_light","light":"l","kind":"point"}"#, "add_light", "intensity"),
            (r#"{"op":"set_camera","camera":"c","yfov_rad":1,"half_height_m":1}"#, "set_camera", "yfov_rad"),
            (r#"{"op":"add_light","light":"l","kind":"laser"}"#, "add_light", "kind"),
            (
                r#"{"op":"set_camera","camera":"c","look_at":{"position":[0,0,0]}}"#,
                "set_camera",
                "look_at.target",
            ),
            (r#"{"op":"set_environment"}"#, "set_environment", "kind"),
            (r#"{"op":"set_environment","kind":"fog"}"#, "set_environment", "kind"),
            (r#"{"op":"set_environment","kind":"none","radiance":[1,1,1]}"#, "set_environment", "radiance"),
            (r#"{"op":"set_environment","kind":"constant"}"#, "set_environment", "radiance"),
            (
                r#"{"op":"set_environment","kind":"constant","radiance":["x",0,0]}"#,
                "set_environment",
                "radiance[0]",
            ),
            (r#"{"op":"set_environment","kind":"image"}"#, "set_environment", "image"),
            (r#"{"op":"set_environment","kind":"none","radiance":null}"#, "set_environment", "radiance"),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":1,"height":1,"texels":""},"scale":null}"#,
                "set_environment",
                "scale",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":1.5,"height":2,"texels":""}}"#,
                "set_environment",
                "image.width",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":1e20,"height":2,"texels":""}}"#,
                "set_environment",
                "image.width",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":"x","height":2,"texels":""}}"#,
                "set_environment",
                "image.width",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":2,"texels":""}}"#,
                "set_environment",
                "image.height",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":2,"height":1,"depth":1,"texels":""}}"#,
                "set_environment",
                "image.depth",
            ),
            (
                r#"{"op":"set_environment","kind":"image","image":{"width":2,"height":2,"texels":"%%%"}}"#,
                "set_environment",
                "image.texels",
            ),
            (r#"{"op":"load_gltf","data":"***"}"#, "load_gltf", "data"),
            (r#"{"op":"explode","node":"a"}"#, "explode", "op"),
        ] {
            for batch in [format!("[{good},{edit}]"), format!(r#"{{"edits":[{good},{edit}]}}"#)] {
                let error = refused(&batch);
                assert_eq!(error.op_index, Some(1), "{edit}: {error}");
                assert_eq!(error.op.as_deref(), Some(op), "{edit}: {error}");
                assert_eq!(error.field.as_deref(), Some(field), "{edit}: {error}");
                let problem = Problem::from(error);
                assert!(problem.is(ProblemKind::EditRefused) && problem.status == 422);
            }
            let message = format!(r#"{{"type":"edit","request":1,"edits":[{edit}]}}"#);
            assert_eq!(ClientMessage::from_json(&message).unwrap_err().field.as_deref(), Some(field));
        }
    }

    /// A message that is refused names its field, also where a number is none.
    #[test]
    fn refused_messages_name_their_field() {
        for (message, field) in [
            (r#"{"type":"hello","client":1,"version":"1"}"#, "client"),
            (r#"{"type":"camera","stamp":1,"size":[4,"x"],"camera":"main"}"#, "size[1]"),
            (r#"{"type":"camera","stamp":-1,"size":[4,4],"camera":"main"}"#, "stamp"),
            (r#"{"type":"quality","jpeg_quality":"high"}"#, "jpeg_quality"),
            (r#"{"type":"accuracy","irradiance_accuracy":"fine"}"#, "irradiance_accuracy"),
            (r#"{"type":"accuracy","irradiance_accuracy":NaN}"#, "irradiance_accuracy"),
            (r#"{"type":"accuracy","exactness":1}"#, "exactness"),
            (r#"{"type":"edit","edits":[]}"#, "request"),
            (r#"{"type":"edit","request":1,"edits":5}"#, "edits"),
            (r#"{"type":"edit","request":1,"if_match":"x","edits":[]}"#, "if_match"),
        ] {
            let error = ClientMessage::from_json(message).unwrap_err();
            assert_eq!(error.field.as_deref(), Some(field), "{message}: {error}");
            let told = error.to_string();
            assert!(
                error.op_index.is_none() && told.starts_with(&format!("field `{field}`: ")),
                "{message}: {told}"
            );
        }
        for message in [r#"{"type":"other"}"#, r#"{"client":"a"}"#, "[1]", r#"{"type":"#] {
            assert_eq!(ClientMessage::from_json(message).unwrap_err().field, None, "{message}");
        }
    }

    /// Who wrote a number that JSON cannot hold reads of a number, and who wrote a word of a string.
    #[test]
    fn numbers_that_json_cannot_hold_are_told_as_such() {
        let told = |value: &str| {
            let transform = format!(r#"{{"translation":[0,{value},0]}}"#);
            refused(&format!(r#"[{{"op":"set_transform","node":"a","transform":{transform}}}]"#)).to_string()
        };
        let place = "edits[0] (set_transform) field `transform.translation[1]`: ";
        for number in ["1e999", "-1e999", "NaN", "-Infinity"] {
            let expected = format!("{place}{number} is out of range or no number of JSON, expected f64");
            assert_eq!(told(number), expected);
        }
        assert_eq!(told("\"high\""), format!("{place}invalid type: string \"high\", expected f64"));
        let stamp = r#"{"type":"camera","stamp":NaN,"size":[4,4],"camera":"main"}"#;
        let expected = "field `stamp`: NaN is out of range or no number of JSON, expected u64";
        assert_eq!(ClientMessage::from_json(stamp).unwrap_err().to_string(), expected);
    }

    /// serde puts values between backticks as well as names: only names are fields.
    #[test]
    fn a_value_is_never_taken_for_a_field() {
        for (reason, field) in [
            ("missing field `width`", Some("width")),
            ("unknown field `glow`, expected `a` or `b`", Some("glow")),
            ("a point light needs `intensity` in W/sr", Some("intensity")),
            ("invalid type: floating point `1.5`, expected u32", None),
            ("invalid value: integer `-1`, expected u32", None),
            ("unknown variant `fog`, expected `none` or `constant`", None),
            ("no name at all", None),
        ] {
            assert_eq!(field_named_in(reason).as_deref(), field, "{reason}");
        }
    }

    /// A refused edit is told which one it was, whatever is wrong beside its number.
    #[test]
    fn refused_edits_are_known_by_their_number() {
        for (text, request) in [
            (r#"{"type":"edit","request":7,"edits":[{"op":"explode"}]}"#, Some(7)),
            (r#"{"type":"edit","edits":[{"op":"set_material","emission":[NaN,1,1]}],"request":7}"#, Some(7)),
            (r#"{"type":"edit","request":1e999,"edits":[]}"#, None),
            (r#"{"type":"edit","request":-1,"edits":[]}"#, None),
            (r#"{"type":"edit","edits":[]}"#, None),
            (r#"{"type":"edit","request":7,"#, None),
        ] {
            assert_eq!(request_of(text), request, "{text}");
        }
    }

    #[test]
    fn a_text_that_is_no_batch_is_malformed_and_blames_no_edit() {
        for json in ["", "{", "null", "{}", r#"{"edits":1}"#, r#"{"edits":[],"more":1}"#, "[{]", "\u{0}"] {
            let error = refused(json);
            assert_eq!(error.op_index, None, "{json}");
            assert_eq!(Problem::from(error).status, 400, "{json}");
        }
        assert_eq!(EditBatch::from_json(b"\xff[]").unwrap_err().op_index, None);
    }

    #[test]
    fn only_tokens_meant_as_numbers_are_quoted() {
        let text = r#"{"NaN \" Infinity":[NaN,-1e999,1e3,true,null,"1e999"],"é":-Infinity}"#;
        let expected = r#"{"NaN \" Infinity":["NaN","-1e999",1e3,true,null,"1e999"],"é":"-Infinity"}"#;
        assert_eq!(with_non_numbers_quoted(text), expected);
        assert_eq!(with_non_numbers_quoted("\"open"), "\"open");
    }
}
