//! The JSON messages of the WebSocket, one per text frame, `"type"` names it. Order and examples: `README.md`.
//!
//! Clients must know their fields (unknown ones are refused); servers may grow theirs, clients ignore what they do not
//! know. Stamps, requests and revisions stay below 2⁵³, so that JavaScript can hold them; larger ones are refused.

use crate::forecast::{Forecast, ForecastRecord, Preset};
use crate::limits::{safe_integer, safe_integer_option};
use crate::{CameraPose, Edit, Id, Limits, Problem, SceneDescription, SceneId};
use serde::{Deserialize, Serialize};

/// What a client says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientMessage {
    /// First of all.
    Hello(ClientHello),
    /// Which picture to draw from now on.
    Camera(CameraRequest),
    /// How pictures are to be sent.
    Quality(Quality),
    /// How exact they are to become.
    Accuracy(Accuracy),
    /// A batch of edits; answered by `edited` or `error`.
    Edit(EditRequest),
    /// A binary message has been received and used, and so has every one before it.
    Ack {
        /// Its frame number.
        #[serde(deserialize_with = "safe_integer")]
        frame: u64,
    },
    /// Answered by `pong` at once.
    Ping {
        /// Comes back unchanged.
        #[serde(deserialize_with = "safe_integer")]
        stamp: u64,
    },
}

/// Who is calling.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClientHello {
    /// The program's name, for the server's log.
    pub client: String,
    /// The program's version.
    pub version: String,
}

/// Which picture to draw; replaces the one before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "CameraFields", into = "CameraFields")]
pub struct CameraRequest {
    /// The client's own number, growing; it comes back in the header of every frame drawn from this message.
    pub stamp: u64,
    /// Width and height in pixels.
    pub size: [u16; 2],
    /// Flat in JSON: `camera` or `pose`.
    pub view: View,
}

/// From where the picture is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum View {
    /// A camera of the scene; follows it when it is edited.
    Camera(Id),
    /// The client's own.
    Pose(CameraPose),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFields {
    #[serde(deserialize_with = "safe_integer")]
    stamp: u64,
    size: [u16; 2],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera: Option<Id>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pose: Option<CameraPose>,
}

impl TryFrom<CameraFields> for CameraRequest {
    type Error = &'static str;
    fn try_from(fields: CameraFields) -> Result<Self, Self::Error> {
        let view = match (fields.camera, fields.pose) {
            (Some(id), None) => View::Camera(id),
            (None, Some(pose)) => View::Pose(pose),
            _ => return Err("give either `camera` (a camera of the scene) or `pose`"),
        };
        Ok(Self { stamp: fields.stamp, size: fields.size, view })
    }
}

impl From<CameraRequest> for CameraFields {
    fn from(request: CameraRequest) -> Self {
        let (camera, pose) = match request.view {
            View::Camera(id) => (Some(id), None),
            View::Pose(pose) => (None, Some(pose)),
        };
        Self { stamp: request.stamp, size: request.size, camera, pose }
    }
}

/// How pictures are sent. A message replaces the one before as a whole: an absent field takes its default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Quality {
    /// Default `auto`.
    pub codec: Codec,
    /// 1 to 100; default 85. Where the codec is JPEG.
    pub jpeg_quality: u8,
    /// Radiance is multiplied by 2^exposure_ev; −32 to 32, default 0.
    pub exposure_ev: f32,
    /// Default `aces`.
    pub tone_map: ToneMap,
    /// Above 0; default 60. The server has a limit of its own.
    pub frames_per_second_max: f32,
    /// Dots where irradiance records stand that the camera sees straight. Not in float pictures. Default false.
    pub show_records: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            codec: Codec::Auto,
            // Above about 85 a JPEG grows faster than its visible error falls.
            jpeg_quality: 85,
            exposure_ev: 0.0,
            tone_map: ToneMap::Aces,
            frames_per_second_max: 60.0,
            show_records: false,
        }
    }
}

/// What a client wants pictures packed as; what a frame is packed as says its header.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Codec {
    /// JPEG while converging, PNG once converged.
    #[default]
    Auto,
    /// Always JPEG.
    Jpeg,
    /// Always PNG, 8 bits.
    Png,
    /// Raw linear radiance, f32; exposure and tone map are then the client's business.
    Float,
}

/// From radiance to display, by name. The server multiplies by 2^exposure_ev, applies this curve, then the sRGB
/// transfer function; JPEG and PNG only, never to float pictures or EXR.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToneMap {
    /// Cut at 1.
    Linear,
    /// x / (1 + x) on luminance.
    Reinhard,
    /// Fit of the ACES reference curve.
    #[default]
    Aces,
    /// AgX, base look: keeps hue towards white.
    Agx,
}

impl ToneMap {
    /// Every one, for menus.
    pub const ALL: [Self; 4] = [Self::Linear, Self::Reinhard, Self::Aces, Self::Agx];

    /// As in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Reinhard => "reinhard",
            Self::Aces => "aces",
            Self::Agx => "agx",
        }
    }
}

/// How exact pictures are to become. A message replaces the one before as a whole: an absent field takes its default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Accuracy {
    /// √relMSE as a fraction: the picture counts as converged and rests once it is reached. Default 0.01 (1 %).
    pub target_error: f32,
    /// In place of `target_error`; default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<Preset>,
    /// Default `auto`.
    pub technique: Technique,
    /// Longest path in surface hits; absent = unlimited (Russian roulette ends paths without bias).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounces: Option<u32>,
    /// The largest error that interpolating between irradiance records may make, about: Ward's a, from
    /// [`Accuracy::IRRADIANCE_RANGE`]. Smaller takes more records, about as one over its square. Viewers of a scene share its records:
    /// the smallest that one of them asks for counts. Default 0.15.
    pub irradiance_accuracy: f32,
    /// Effects chosen in place of the scene's plan; default: none.
    #[serde(skip_serializing_if = "EffectChoices::is_plan")]
    pub effects: EffectChoices,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self {
            target_error: 0.01,
            preset: None,
            technique: Technique::Auto,
            bounces: None,
            irradiance_accuracy: 0.15,
            effects: EffectChoices::default(),
        }
    }
}

impl Accuracy {
    /// Least `target_error`: a millionth. No picture in single precision is better.
    pub const TARGET_MIN: f32 = 1e-6;

    /// Least and greatest `irradiance_accuracy`: below, single pixels have records of their own, and above, records count over
    /// half of a room.
    pub const IRRADIANCE_RANGE: [f32; 2] = [0.02, 1.0];

    /// The error that people write as a share or in percent: 0.02, 2% or 2 %; nothing for what is no number from
    /// [`Accuracy::TARGET_MIN`] on and below 1.
    pub fn read_target(text: &str) -> Option<f64> {
        let (number, factor) = match text.trim().strip_suffix('%') {
            Some(number) => (number.trim_end(), 0.01),
            None => (text.trim(), 1.0),
        };
        let error = number.parse::<f64>().ok()? * factor;
        (f64::from(Self::TARGET_MIN)..1.0).contains(&error).then_some(error)
    }

    /// Whole percents that a number without their sign may stand for, as "5%" for 5; nothing for what cannot be meant so.
    pub fn percent_meant(text: &str) -> Option<String> {
        let percent = text.trim().parse::<f64>().ok().filter(|number| (1.0..100.0).contains(number))?;
        Some(format!("{percent}%"))
    }

    /// √relMSE at which the picture rests; nothing if only the server's bound on samples ends it.
    pub fn target(&self) -> Option<f32> {
        self.preset.map_or(Some(self.target_error), Preset::error)
    }
}

/// Whether an effect runs for this viewer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EffectChoice {
    /// As the scene calls for.
    #[default]
    Auto,
    /// Though the scene does not call for it: costs time, and changes nothing that is seen.
    On,
    /// Though the scene may call for it: its light is missing from the pictures.
    Off,
}

impl EffectChoice {
    /// Every one, for menus.
    pub const ALL: [Self; 3] = [Self::Auto, Self::On, Self::Off];
}

/// Choices of the effects that are computed by themselves; an absent one is `auto`. With the techniques `path` and `none`, `on`
/// changes nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(
    default,
    deny_unknown_fields,
    expecting = "an object with `caustics` and `indirect`, each `auto`, `on` or `off`"
)]
pub struct EffectChoices {
    /// Light that mirrors, glosses and glass send on to diffuse surfaces.
    pub caustics: EffectChoice,
    /// Light between diffuse surfaces.
    pub indirect: EffectChoice,
}

impl EffectChoices {
    /// All is as the scene calls for.
    pub fn is_plan(&self) -> bool {
        *self == Self::default()
    }

    /// The choice of an effect by its name in [`crate::Effects`]; `None` for those that cannot be chosen.
    pub fn choice_mut(&mut self, effect: &str) -> Option<&mut EffectChoice> {
        match effect {
            "caustics" => Some(&mut self.caustics),
            "indirect" => Some(&mut self.indirect),
            _ => None,
        }
    }
}

/// Where indirect light comes from, as `--indirect` on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Technique {
    /// The best chain that exists so far.
    #[default]
    Auto,
    /// Virtual directional lights clustered in an octree of photons.
    Octree,
    /// Irradiance records, gathered from direct light and photons.
    Irradiance,
    /// Light map in texture space.
    Lightmap,
    /// Path tracing, unbiased.
    Path,
    /// No indirect light.
    None,
}

impl Technique {
    /// Every one, for menus.
    pub const ALL: [Self; 6] =
        [Self::Auto, Self::Octree, Self::Irradiance, Self::Lightmap, Self::Path, Self::None];

    /// As in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Octree => "octree",
            Self::Irradiance => "irradiance",
            Self::Lightmap => "lightmap",
            Self::Path => "path",
            Self::None => "none",
        }
    }
}

/// A batch of edits over the WebSocket; means what `POST /v1/scenes/{id}/edits` means.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditRequest {
    /// The client's own number; comes back in `edited` or `error`.
    #[serde(deserialize_with = "safe_integer")]
    pub request: u64,
    /// Refuse with 412 unless the scene is at this revision.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "safe_integer_option")]
    pub if_match: Option<u64>,
    /// The same key again makes no second revision and is answered with the first one's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idempotency_key: Option<String>,
    /// Together or not at all.
    pub edits: Vec<Edit>,
}

/// What the server says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ServerMessage {
    /// Answer to the client's hello.
    Hello(ServerHello),
    /// The whole scene, after hello and again after it changed; the newest counts.
    Scene {
        /// All of it.
        scene: Box<SceneDescription>,
    },
    /// The batch is on disk and made this revision.
    Edited {
        /// The client's number.
        request: u64,
        /// What it made.
        revision: u64,
    },
    /// Something was refused or went wrong. The connection stays open unless the server closes it.
    Error {
        /// What and why.
        problem: Problem,
        /// The client's number, if an edit caused it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        request: Option<u64>,
    },
    /// How this viewer's picture is doing, a few times a second.
    Stats(Stats),
    /// Answer to ping.
    Pong {
        /// The client's number.
        stamp: u64,
    },
}

/// Who answers, and with what limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServerHello {
    /// [`crate::SUBPROTOCOL`].
    pub protocol: String,
    /// The server's version.
    pub version: String,
    /// The scene of this connection.
    pub scene: SceneId,
    /// Its revision now.
    pub revision: u64,
    /// This connection's number, as in the server's log and metrics.
    pub viewer: u64,
    /// What the server accepts.
    pub limits: Limits,
}

/// How one viewer's picture is doing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stats {
    /// Revision the picture shows.
    pub revision: u64,
    /// Camera message the picture shows.
    pub camera_stamp: u64,
    /// Per pixel.
    pub samples: u64,
    /// √relMSE as a fraction: 0.01 = 1 %. `None` = not measured yet.
    pub error: Option<f32>,
    /// 95 % confidence interval of `error`, `[low, high]`.
    pub error_ci: Option<[f32; 2]>,
    /// Since the film restarted (camera moved, scene edited, size changed).
    pub seconds: f64,
    /// Of this viewer's film, lately.
    pub rays_per_second: f64,
    /// Of this viewer's film, lately: pixel samples.
    pub samples_per_second: f64,
    /// Since connecting.
    pub frames_sent: u64,
    /// Drawn but not sent, because too many were in flight: replaced by a newer one. Since connecting.
    pub frames_skipped: u64,
    /// Sent and not acknowledged.
    pub in_flight: u32,
    /// What the picture is rendered with.
    pub technique: Technique,
    /// Pixels of the film, width and height.
    pub film_size: [u16; 2],
    /// Film size ÷ asked size; below 1 while the camera moves, or edits follow each other, on a slow machine.
    pub scale: f32,
    /// When the picture will be how good: the presets, coarse to fine, and the target if it is another. Empty before the
    /// picture has its full size and an error.
    #[serde(default)]
    pub forecast: Vec<Forecast>,
    /// How often this viewer's forecasts came true, since connecting.
    #[serde(default)]
    pub forecast_record: ForecastRecord,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares and percents are the same errors; what is none, or out of bounds, is nothing.
    #[test]
    fn errors_are_read_as_people_write_them() {
        for text in ["0.02", "2%", "2 %", " 2.0% ", "2e-2"] {
            let error = Accuracy::read_target(text);
            assert!(error.is_some_and(|error| (error - 0.02).abs() < 1e-15), "{text:?}: {error:?}");
        }
        for text in ["", "%", "2%%", "2,5%", "-2%", "0", "1", "100%", "1e-7", "NaN", "inf", "1e400"] {
            assert_eq!(Accuracy::read_target(text), None, "{text:?}");
        }
        assert_eq!(
            ["5", " 2.5 ", "1"].map(|text| Accuracy::percent_meant(text).unwrap()),
            ["5%", "2.5%", "1%"]
        );
        for text in ["0.5", "100", "-3", "5%", "NaN", "five"] {
            assert_eq!(Accuracy::percent_meant(text), None, "{text:?}");
        }
    }
}
