//! Every size and rate that comes from outside has its limit here: the server's config starts from these, the message
//! `hello` tells them, and `README.md` lists them.

use crate::{
    Accuracy, CameraRequest, ClientHello, ClientMessage, EditRequest, Problem, ProblemKind, Projection,
    Quality, View,
};
use serde::{Deserialize, Deserializer, Serialize, de::Error};

/// Largest stamp, request number or revision in JSON: 2⁵³ − 1, the last integer that a double holds exactly.
pub const SAFE_INTEGER_MAX: u64 = (1 << 53) - 1;
/// Longest idempotency key and longest name or version in `hello`, in bytes. Fixed, like the length of ids.
pub const LABEL_BYTES_MAX: usize = 128;

/// What a server accepts; each is configurable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Limits {
    /// Bytes of one WebSocket message from a client. Larger edits go over HTTP.
    pub message_bytes: u64,
    /// Bytes of an HTTP body: edits, and files for new scenes.
    pub body_bytes: u64,
    /// Edits in one batch.
    pub edits_per_batch: u32,
    /// Messages a client may send in a second, acks and pings not counted.
    pub messages_per_second: u32,
    /// Frames sent to a viewer and not acknowledged.
    pub frames_in_flight: u32,
    /// Frames a second to one viewer, whatever it asks for.
    pub frames_per_second: f32,
    /// Pixels across a picture.
    pub picture_width: u16,
    /// Pixels down a picture.
    pub picture_height: u16,
    /// Surface hits along a path that a client may ask for.
    pub bounces: u32,
    /// Viewers of one scene at once.
    pub viewers_per_scene: u32,
    /// Scenes at once.
    pub scenes: u32,
    /// Vertices in a scene, each mesh counted once.
    pub scene_vertices: u64,
    /// Triangles in a scene, each mesh counted once.
    pub scene_triangles: u64,
    /// Texels in a scene's textures and environment.
    pub scene_texels: u64,
    /// Nodes in a scene.
    pub scene_nodes: u64,
    /// Nodes from the world down to the deepest.
    pub hierarchy_depth: u32,
    /// Materials in a scene, and as many lights, and as many cameras.
    pub scene_objects: u64,
    /// Seconds a new connection may take to say hello.
    pub hello_seconds: u32,
    /// Seconds without a word from a client (a WebSocket pong counts) until the server closes.
    pub idle_seconds: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            // A mesh of some 200 k triangles as JSON text, or a 24 MiB .glb in base64.
            message_bytes: 32 << 20,
            // The largest test scenes are under 100 MiB; base64 adds a third.
            body_bytes: 256 << 20,
            edits_per_batch: 10_000,
            // A mouse reports up to 125 times a second; twice that leaves room for edits.
            messages_per_second: 250,
            // One on its way and one being shown: fewer would idle the line, more would age the picture.
            frames_in_flight: 2,
            frames_per_second: 60.0,
            // 4096² × 12 bytes of radiance = 192 MiB for one viewer's float frame: as far as it goes.
            picture_width: 4096,
            picture_height: 4096,
            bounces: 1024,
            viewers_per_scene: 64,
            scenes: 64,
            // At about 100 bytes a vertex and 120 a triangle with its BVH, some 3 GB for a full scene.
            scene_vertices: 16_000_000,
            scene_triangles: 16_000_000,
            // Sixteen 4096² textures.
            scene_texels: 1 << 28,
            scene_nodes: 1_000_000,
            // Deeper hierarchies are made by generators gone wrong; real rigs stay under 100.
            hierarchy_depth: 256,
            scene_objects: 100_000,
            hello_seconds: 10,
            idle_seconds: 60,
        }
    }
}

/// A message asks for more than the limits, or a value outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("field `{field}`: {reason}")]
pub struct LimitError {
    /// The field as a path.
    pub field: &'static str,
    /// Its value and what is allowed.
    pub reason: String,
}

impl From<LimitError> for Problem {
    fn from(error: LimitError) -> Self {
        Problem::new(ProblemKind::ValueRefused, error.to_string()).at_field(error.field)
    }
}

impl Limits {
    /// Checks a client's message against these limits and the ranges of its values; edits only by their number (what
    /// they say is the engine's to judge).
    pub fn check(&self, message: &ClientMessage) -> Result<(), LimitError> {
        match message {
            ClientMessage::Hello(hello) => check_hello(hello),
            ClientMessage::Camera(camera) => self.check_camera(camera),
            ClientMessage::Quality(quality) => check_quality(quality),
            ClientMessage::Accuracy(accuracy) => self.check_accuracy(accuracy),
            ClientMessage::Edit(edit) => self.check_edit(edit),
            ClientMessage::Ack { .. } | ClientMessage::Ping { .. } => Ok(()),
        }
    }

    fn check_camera(&self, camera: &CameraRequest) -> Result<(), LimitError> {
        let [width, height] = camera.size;
        let [width_max, height_max] = [self.picture_width, self.picture_height];
        require((1..=width_max).contains(&width) && (1..=height_max).contains(&height), "size", || {
            format!("{width}×{height} pixels; from 1×1 to {width_max}×{height_max} are allowed")
        })?;
        let View::Pose(pose) = &camera.view else { return Ok(()) };
        require(pose.world_from_camera.iter().all(|m| m.is_finite()), "pose.matrix", || "not finite".into())?;
        match pose.projection {
            Projection::Perspective { yfov_rad } => {
                require(yfov_rad > 0.0 && yfov_rad < std::f32::consts::PI, "pose.yfov_rad", || {
                    format!("{yfov_rad}; between 0 and π, both excluded")
                })
            }
            Projection::Orthographic { half_height_m } => {
                require(half_height_m > 0.0 && half_height_m.is_finite(), "pose.half_height_m", || {
                    format!("{half_height_m}; above 0 and finite")
                })
            }
        }
    }

    fn check_accuracy(&self, accuracy: &Accuracy) -> Result<(), LimitError> {
        let error = accuracy.target_error;
        require((Accuracy::TARGET_MIN..1.0).contains(&error), "target_error", || {
            format!("{error}; a fraction, from {} on and below 1; 0.01 means 1 %", Accuracy::TARGET_MIN)
        })?;
        let [least, most] = Accuracy::IRRADIANCE_RANGE;
        let of_records = accuracy.irradiance_accuracy;
        require((least..=most).contains(&of_records), "irradiance_accuracy", || {
            format!("{of_records}; from {least} to {most}")
        })?;
        let bounces = accuracy.bounces.unwrap_or(0);
        require(bounces <= self.bounces, "bounces", || format!("{bounces}; at most {}", self.bounces))
    }

    fn check_edit(&self, edit: &EditRequest) -> Result<(), LimitError> {
        let count = edit.edits.len();
        require(count <= self.edits_per_batch as usize, "edits", || {
            format!("{count} edits in one batch; at most {} are allowed", self.edits_per_batch)
        })?;
        edit.idempotency_key.as_ref().map_or(Ok(()), |key| check_label("idempotency_key", key))
    }
}

fn check_hello(hello: &ClientHello) -> Result<(), LimitError> {
    check_label("client", &hello.client)?;
    check_label("version", &hello.version)
}

fn check_quality(quality: &Quality) -> Result<(), LimitError> {
    require((1..=100).contains(&quality.jpeg_quality), "jpeg_quality", || {
        format!("{}; from 1 to 100", quality.jpeg_quality)
    })?;
    // 2^±32 spans more than the 1e9 between starlight and the sun.
    require(quality.exposure_ev.abs() <= 32.0, "exposure_ev", || {
        format!("{}; from −32 to 32", quality.exposure_ev)
    })?;
    let rate = quality.frames_per_second_max;
    require(rate > 0.0 && rate.is_finite(), "frames_per_second_max", || format!("{rate}; above 0 and finite"))
}

/// Labels go into logs: short, and no line breaks that would forge a second line.
fn check_label(field: &'static str, label: &str) -> Result<(), LimitError> {
    require(label.len() <= LABEL_BYTES_MAX, field, || {
        format!("{} bytes; at most {LABEL_BYTES_MAX}", label.len())
    })?;
    require(!label.chars().any(char::is_control), field, || "holds a control character".into())
}

fn require(holds: bool, field: &'static str, reason: impl FnOnce() -> String) -> Result<(), LimitError> {
    if holds { Ok(()) } else { Err(LimitError { field, reason: reason() }) }
}

/// Reads an integer that JavaScript can hold.
pub(crate) fn safe_integer<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    let number = u64::deserialize(deserializer)?;
    if number > SAFE_INTEGER_MAX {
        return Err(D::Error::custom(format!(
            "{number} is above 2^53 − 1, the largest integer JSON carries safely"
        )));
    }
    Ok(number)
}

/// The same where it may be absent.
pub(crate) fn safe_integer_option<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<u64>, D::Error> {
    #[derive(Deserialize)]
    struct Safe(#[serde(deserialize_with = "safe_integer")] u64);
    Ok(Option::<Safe>::deserialize(deserializer)?.map(|Safe(number)| number))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused_with_their_field() {
        let limits = Limits::default();
        for (json, field) in [
            (r#"{"type":"camera","stamp":1,"size":[0,360],"camera":"c"}"#, "size"),
            (r#"{"type":"camera","stamp":1,"size":[4097,360],"camera":"c"}"#, "size"),
            (
                r#"{"type":"camera","stamp":1,"size":[2,2],"pose":{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"yfov_rad":0}}"#,
                "pose.yfov_rad",
            ),
            (r#"{"type":"quality","jpeg_quality":0}"#, "jpeg_quality"),
            (r#"{"type":"quality","exposure_ev":1e39}"#, "exposure_ev"),
            (r#"{"type":"quality","frames_per_second_max":0}"#, "frames_per_second_max"),
            (r#"{"type":"accuracy","target_error":0}"#, "target_error"),
            (r#"{"type":"accuracy","target_error":1}"#, "target_error"),
            (r#"{"type":"accuracy","bounces":4000000000}"#, "bounces"),
            (r#"{"type":"accuracy","irradiance_accuracy":0}"#, "irradiance_accuracy"),
            (r#"{"type":"accuracy","irradiance_accuracy":1.5}"#, "irradiance_accuracy"),
            (r#"{"type":"hello","client":"a\nb","version":"1"}"#, "client"),
        ] {
            let message = ClientMessage::from_json(json).unwrap();
            assert_eq!(limits.check(&message).unwrap_err().field, field, "{json}");
        }
        for json in
            [r#"{"type":"quality"}"#, r#"{"type":"accuracy"}"#, r#"{"type":"edit","request":1,"edits":[]}"#]
        {
            assert_eq!(limits.check(&ClientMessage::from_json(json).unwrap()), Ok(()));
        }
    }

    #[test]
    fn integers_that_a_double_cannot_hold_are_refused() {
        let last = format!(r#"{{"type":"ping","stamp":{SAFE_INTEGER_MAX}}}"#);
        assert!(ClientMessage::from_json(&last).is_ok());
        for json in [
            r#"{"type":"ping","stamp":9007199254740992}"#,
            r#"{"type":"ack","frame":9007199254740992}"#,
            r#"{"type":"ping","stamp":-1}"#,
            r#"{"type":"camera","stamp":9007199254740992,"size":[1,1],"camera":"c"}"#,
            r#"{"type":"edit","request":9007199254740992,"edits":[]}"#,
            r#"{"type":"edit","request":1,"if_match":9007199254740992,"edits":[]}"#,
        ] {
            assert!(ClientMessage::from_json(json).is_err(), "{json}");
        }
    }
}
