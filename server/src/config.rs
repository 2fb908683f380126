//! Settings of the server: one flat list of keys, each with its default, its unit and its reason.
//!
//! Four layers, later ones win: defaults < `--config FILE.toml` < environment `LUMICAST_KEY` < flags (`--listen` and its
//! like, or `--set key=value` for any key). `deploy/lumicast.toml` is this list as a file; a test keeps them equal.

use crate::assets::AssetLimits;
use lumicast_engine::gpu::{AdapterChoice, GpuOptions};
use lumicast_engine::render::MeasuringShare;
use lumicast_engine::scene::SceneLimits;
use lumicast_protocol::Limits;
use serde::{Deserialize, Serialize};
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::time::Duration;

/// Why settings were refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("config file {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no TOML.
    #[error("config file {path}: {reason}")]
    Syntax {
        /// The file.
        path: String,
        /// Line and reason.
        reason: String,
    },
    /// A key that does not exist.
    #[error("{origin}: there is no setting {key:?}; `lumicast serve --print-config` lists all")]
    UnknownKey {
        /// File, environment variable or flag.
        origin: String,
        /// The key as given.
        key: String,
    },
    /// A value of another type.
    #[error("{origin}: setting {key:?} is {value}, but must be {expected}")]
    WrongType {
        /// File, environment variable or flag.
        origin: String,
        /// The key.
        key: String,
        /// The value as given.
        value: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A value out of range.
    #[error("setting {key:?} is {value}, but must be {expected}")]
    OutOfRange {
        /// The key.
        key: &'static str,
        /// The value.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
}

macro_rules! settings {
    ($( $(#[doc = $doc:literal])+ $key:ident : $type:ty = $default:expr; )+) => {
        /// Every setting; see the module's head for where values come from.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Config { $( $(#[doc = $doc])+ pub $key: $type, )+ }

        impl Default for Config {
            fn default() -> Config {
                Config { $( $key: $default, )+ }
            }
        }

        /// Key and description lines of every setting, in order.
        const DESCRIPTIONS: &[(&str, &[&str])] = &[$( (stringify!($key), &[$($doc),+]), )+];
    };
}

settings! {
    /// Address and port to listen on. Port 0 takes a free one. There is no password: beyond this machine, put a proxy
    /// in front or listen inside a private network.
    listen: String = "127.0.0.1:7171".into();
    /// Folder of the durable scene store; empty: scenes live in memory and are gone when the server stops.
    data: String = String::new();
    /// What draws pictures: cpu; gpu, a graphics card or what stands for one; auto: a graphics card where there is one. Light is
    /// learnt on the CPU in any case.
    backend: String = "auto".into();
    /// Bytes that all scenes together may take on the graphics card: up to 125 MB each for paths on their way, about 150 a
    /// triangle, 400 to 1,500 a record of irradiance, 100 a photon of caustics. A scene for which no room is left is drawn on
    /// the CPU, and so are pictures of looked-up light for which none is left beside their scene.
    gpu_bytes: u64 = 2 << 30;
    /// Bytes of those that maps of a scene's shadows may take, so that a graphics card need not trace shadow rays to these lights for the first
    /// picture after a camera was moved: 16 MiB of a directional light, 4 of a spot, 14 of a point light or a spot with an outer angle
    /// beyond 60°; the strongest lights come first. Later pictures trace all rays, and with 0 every picture does.
    gpu_shadow_map_bytes: u64 = 64 << 20;
    /// Seconds that a graphics card may take for a piece of work of some milliseconds before it counts as hanging.
    gpu_seconds_max: u64 = 60;
    /// Rendering threads, shared by all scenes; 0: one per core.
    threads: u64 = 0;
    /// Seed of all random numbers: the same seed, scene and camera give the same picture.
    seed: u64 = 0;
    /// Web pages of other origins that may use this server from a browser (CORS and WebSocket), such as
    /// `https://viewer.example.org`; `*`: any. Empty: only the server's own page.
    allow_origins: Vec<String> = Vec::new();
    /// Log format: text, or json for one object per line.
    log_format: String = "text".into();
    /// What is logged, in the syntax of tracing's EnvFilter.
    log: String = "info".into();

    /// Bytes of one WebSocket message from a client. Larger edits go over HTTP.
    message_bytes: u64 = Limits::default().message_bytes;
    /// Bytes of an HTTP body: edits, and files for new scenes.
    body_bytes: u64 = Limits::default().body_bytes;
    /// Bytes of all HTTP bodies being taken at once; beyond it: 503 with Retry-After. At least body_bytes.
    bodies_bytes: u64 = 1 << 30;
    /// Edits in one batch.
    edits_per_batch: u32 = Limits::default().edits_per_batch;
    /// Messages a client may send in a second, acks and pings not counted; the excess is refused, and who goes on
    /// for ten seconds' worth of messages is disconnected.
    messages_per_second: u32 = Limits::default().messages_per_second;
    /// Frames sent to a viewer and not acknowledged: one on its way and one being shown.
    frames_in_flight: u32 = Limits::default().frames_in_flight;
    /// Frames a second to one viewer, whatever it asks for.
    frames_per_second: f32 = Limits::default().frames_per_second;
    /// Pixels across a picture, streamed or asked for by HTTP.
    picture_width: u16 = Limits::default().picture_width;
    /// Pixels down a picture.
    picture_height: u16 = Limits::default().picture_height;
    /// Bytes of all films together (about 184 a pixel, twice that for pictures by `auto`, 28 more with mirrors or glass, and 130 to 260 for
    /// caustics, five times where lamps without size light by way of them); who would exceed it gets pictures of a smaller scale.
    film_bytes: u64 = 4 << 30;
    /// Surface hits along a path that a client may ask for.
    bounces: u32 = Limits::default().bounces;
    /// Viewers of one scene at once.
    viewers_per_scene: u32 = Limits::default().viewers_per_scene;
    /// Scenes at once.
    scenes: u32 = Limits::default().scenes;
    /// Vertices in a scene, each mesh counted once.
    scene_vertices: u64 = Limits::default().scene_vertices;
    /// Triangles in a scene, each mesh counted once.
    scene_triangles: u64 = Limits::default().scene_triangles;
    /// Texels in a scene's textures and environment.
    scene_texels: u64 = Limits::default().scene_texels;
    /// Triangles of a scene that emit light, each instance counted: each becomes a light, and those with an uneven picture together up to 65,536 more.
    scene_emissive_triangles: u64 = SceneLimits::default().emissive_triangles_max;
    /// Nodes in a scene.
    scene_nodes: u64 = Limits::default().scene_nodes;
    /// Nodes from the world down to the deepest.
    hierarchy_depth: u32 = Limits::default().hierarchy_depth;
    /// Materials in a scene, and as many lights, and as many cameras.
    scene_objects: u64 = Limits::default().scene_objects;

    /// Bytes of a scene's file itself.
    file_bytes: u64 = AssetLimits::default().file_bytes_max;
    /// Bytes of all that a scene's file refers to, together: files beside it and decoded data URIs.
    file_side_bytes: u64 = AssetLimits::default().buffers_bytes_max;
    /// Bytes of a glTF file's JSON, data URIs among them.
    file_json_bytes: u64 = AssetLimits::default().json_bytes_max;
    /// Values in a glTF file's JSON, up to some 100 bytes of memory each.
    file_json_values: u64 = AssetLimits::default().json_values_max;
    /// Texels of one image of a file, known from its header.
    image_texels: u64 = AssetLimits::default().image_pixels_max;
    /// Elements of one glTF accessor.
    accessor_elements: u64 = AssetLimits::default().accessor_elements_max;

    /// Connections at once, HTTP and WebSocket together; further ones wait to be accepted.
    connections: u32 = 1024;
    /// Seconds a client may take to send a request's head.
    head_seconds: u32 = 10;
    /// Bytes of a request's head.
    head_bytes: u32 = 32 << 10;
    /// Seconds a client may take to send a request's body.
    body_seconds: u32 = 120;
    /// Seconds a new WebSocket may take to say hello.
    hello_seconds: u32 = Limits::default().hello_seconds;
    /// Seconds without a word from a WebSocket client (a pong counts) until it is closed.
    idle_seconds: u32 = Limits::default().idle_seconds;
    /// Seconds that a stopping server waits for its clients to leave.
    shutdown_seconds: u32 = 3;

    /// Batches that wait for one scene's edit thread; beyond it: 503 with Retry-After.
    edit_queue: u32 = 64;
    /// Batches of one WebSocket connection that wait for their answer; beyond it they are refused.
    edits_in_flight: u32 = 32;
    /// Batches of one scene kept in memory for `GET edits?since=`; older revisions are told as a gap.
    event_log: u32 = 1000;
    /// Bytes of those batches.
    event_log_bytes: u64 = 64 << 20;
    /// Idempotency keys remembered per scene.
    idempotency_keys: u32 = 4096;
    /// Listeners of one scene's server-sent events.
    event_listeners: u32 = 64;
    /// Bytes a scene's log on disk may reach before it is folded into a new base.
    log_bytes: u64 = 64 << 20;

    /// Pictures asked for by `GET frame` at once, per scene; beyond it: 503 with Retry-After.
    frame_requests: u32 = 8;
    /// Longest time that `GET frame` renders, whatever it asks for.
    frame_seconds_max: f64 = 120.0;
    /// How long `GET frame` renders when it names neither error nor time.
    frame_seconds: f64 = 2.0;
    /// Samples per pixel at which a picture rests even when its error is not reached.
    samples_max: u32 = 65_536;
    /// Percent of the time that measuring the error of pictures may take, 1 to 50; at least 20 where a viewer's target may soon
    /// be reached, and where only doubt is left of it, as much as drawing takes.
    measuring_percent: u8 = 5;
    /// Noise stays in pictures of looked-up light, instead of each pixel being joined with pixels around that show the same surface
    /// and differ by no more than their noise.
    keep_noise: bool = false;
    /// Photons that the lights of a scene send out for its light octree, about 120 bytes each with all that is kept of
    /// them; at most 100 million. Up to four times as many where most of them leave the scene; fewer where each is kept at
    /// more than some ten surfaces, since each of these takes about 50 bytes.
    photons: u32 = 1_000_000;
    /// Halvings of the scene's cube down to the cells of its light octree, 4 to 10: each doubles the detail and about
    /// quadruples memory and time.
    octree_depth: u32 = 8;
    /// Irradiance records that a scene keeps for each bound on bounces that somebody looks with, 1,000 to 10 million; about
    /// 600 bytes each with their places, index and the copy that is shown. When no more fit and somebody looks elsewhere, those
    /// for what is looked at then are made anew.
    irradiance_records: u32 = 500_000;
    /// How long a scene keeps what it knows of its light when the last who looked has gone, or the last single picture is drawn, s, 0 to
    /// 86400: whoever comes back, reloads a page or asks for the next picture begins with that. Edits of the light drop it. It takes the memory of
    /// photons, octree and records above, twice at most for each scene: for the last two techniques, or bounds on bounces, that somebody
    /// looked with. Single pictures that are drawn at once take it once more together.
    kept_light_s: f64 = 60.0;
    /// Bytes of all light that scenes keep so; a scene that would exceed it keeps less of its own, what was left longest first.
    kept_light_bytes: u64 = 2 << 30;
    /// Longest that a picture may take while the camera moves, ms: its pass, showing and packing it; it shrinks until it fits. 40 ms leave room
    /// for 20 frames a second beside sending and what is learnt of the light. After a change that comes alone it may take up to three times as long.
    moving_pass_ms: f64 = 40.0;
}

impl Config {
    /// Settings from a file (`None`: no file), environment variables and `key=value` flags.
    ///
    /// - `environment`: name and value of every variable; only `LUMICAST_` + upper-case key is looked at
    /// - `flags`: key, value and the flag as it was written
    pub fn load(
        file: Option<&Path>,
        environment: impl Iterator<Item = (OsString, OsString)>,
        flags: &[(String, String, String)],
    ) -> Result<Config, ConfigError> {
        let mut table = table_of(&Config::default());
        if let Some(path) = file {
            overlay_file(&mut table, path)?;
        }
        for (name, value) in environment {
            // Other programs' LUMICAST_ variables (LUMICAST_GPU of the tests) are none of our business.
            if let Some((name, key)) = setting_of(&name).filter(|(_, key)| table.contains_key(key)) {
                let origin = format!("environment variable {name}");
                match value.to_str() {
                    Some(text) => overlay_text(&mut table, &key, text, origin)?,
                    None => {
                        let value = value.to_string_lossy().into_owned();
                        return Err(ConfigError::WrongType { origin, key, value, expected: "UTF-8" });
                    }
                }
            }
        }
        for (key, value, flag) in flags {
            overlay_text(&mut table, key, value, flag.clone())?;
        }
        Config::from_table(table)
    }

    fn from_table(table: toml::Table) -> Result<Config, ConfigError> {
        let config: Config = table.clone().try_into().map_err(|error| too_large(&table, &error))?;
        config.check()?;
        Ok(config)
    }

    /// This configuration as TOML, with every description.
    pub fn to_toml(&self) -> String {
        let mut out = String::from(
            "# Settings of `lumicast serve`: `lumicast serve --config FILE`. The values here are the defaults.\n\
             # Each can also be given as environment variable LUMICAST_KEY or as flag --set key=value.\n",
        );
        let table = table_of(self);
        for (key, lines) in DESCRIPTIONS {
            let Some(value) = table.get(*key) else { continue };
            out.push('\n');
            for line in *lines {
                out.push_str(&format!("#{line}\n"));
            }
            out.push_str(&format!("{key} = {value}\n"));
        }
        out
    }

    /// What the protocol calls limits.
    pub fn limits(&self) -> Limits {
        Limits {
            message_bytes: self.message_bytes,
            body_bytes: self.body_bytes,
            edits_per_batch: self.edits_per_batch,
            messages_per_second: self.messages_per_second,
            frames_in_flight: self.frames_in_flight,
            frames_per_second: self.frames_per_second,
            picture_width: self.picture_width,
            picture_height: self.picture_height,
            bounces: self.bounces,
            viewers_per_scene: self.viewers_per_scene,
            scenes: self.scenes,
            scene_vertices: self.scene_vertices,
            scene_triangles: self.scene_triangles,
            scene_texels: self.scene_texels,
            scene_nodes: self.scene_nodes,
            hierarchy_depth: self.hierarchy_depth,
            scene_objects: self.scene_objects,
            hello_seconds: self.hello_seconds,
            idle_seconds: self.idle_seconds,
        }
    }

    /// What the engine checks scenes against.
    pub fn scene_limits(&self) -> SceneLimits {
        let count = |value: u64| usize::try_from(value).unwrap_or(usize::MAX);
        SceneLimits {
            vertices_max: self.scene_vertices,
            triangles_max: self.scene_triangles,
            emissive_triangles_max: self.scene_emissive_triangles,
            texels_max: self.scene_texels,
            nodes_max: count(self.scene_nodes),
            node_depth_max: self.hierarchy_depth as usize,
            materials_max: count(self.scene_objects),
            lights_max: count(self.scene_objects),
            cameras_max: count(self.scene_objects),
            ..SceneLimits::default()
        }
    }

    /// What files are checked against.
    pub fn asset_limits(&self) -> AssetLimits {
        AssetLimits {
            file_bytes_max: self.file_bytes,
            buffers_bytes_max: self.file_side_bytes,
            json_bytes_max: self.file_json_bytes,
            json_values_max: self.file_json_values,
            image_pixels_max: self.image_texels,
            accessor_elements_max: self.accessor_elements,
            scene: self.scene_limits(),
        }
    }

    /// Threads to render with.
    pub fn thread_count(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads as usize,
        }
    }

    /// What opening a graphics card is to heed.
    pub(crate) fn gpu_options(&self, adapter: AdapterChoice) -> GpuOptions {
        GpuOptions {
            adapter,
            bytes_max: self.gpu_bytes,
            shadow_map_bytes_max: self.gpu_shadow_map_bytes,
            seconds_max: self.gpu_seconds_max as f64,
        }
    }

    /// Share of the time that measuring the error of pictures may take.
    pub fn measuring(&self) -> MeasuringShare {
        // The number was checked when it was read.
        MeasuringShare::of_percent(self.measuring_percent).unwrap_or_default()
    }

    /// How long what is known of light is kept when nobody looks any more.
    pub fn kept_light(&self) -> Duration {
        Duration::from_secs_f64(self.kept_light_s)
    }

    fn check(&self) -> Result<(), ConfigError> {
        let bad = |key, value: &dyn std::fmt::Display, expected| {
            Err(ConfigError::OutOfRange { key, value: value.to_string(), expected })
        };
        if !["auto", "cpu", "gpu"].contains(&self.backend.as_str()) {
            return bad("backend", &self.backend, "auto, cpu or gpu");
        }
        if self.gpu_seconds_max == 0 {
            return bad("gpu_seconds_max", &self.gpu_seconds_max, "at least 1");
        }
        if !["text", "json"].contains(&self.log_format.as_str()) {
            return bad("log_format", &self.log_format, "text or json");
        }
        if self.threads > 1024 {
            return bad("threads", &self.threads, "0 (one per core) to 1024");
        }
        let counts = [
            ("edits_per_batch", self.edits_per_batch),
            ("messages_per_second", self.messages_per_second),
            ("frames_in_flight", self.frames_in_flight),
            ("viewers_per_scene", self.viewers_per_scene),
            ("scenes", self.scenes),
            ("connections", self.connections),
            ("head_seconds", self.head_seconds),
            ("body_seconds", self.body_seconds),
            ("hello_seconds", self.hello_seconds),
            ("idle_seconds", self.idle_seconds),
            ("edit_queue", self.edit_queue),
            ("edits_in_flight", self.edits_in_flight),
            ("event_log", self.event_log),
            ("event_listeners", self.event_listeners),
            ("frame_requests", self.frame_requests),
            ("samples_max", self.samples_max),
            ("picture_width", self.picture_width.into()),
            ("picture_height", self.picture_height.into()),
        ];
        if let Some((key, value)) = counts.into_iter().find(|(_, value)| *value == 0) {
            return bad(key, &value, "at least 1");
        }
        if !(1..=100_000_000).contains(&self.photons) {
            return bad("photons", &self.photons, "1 to 100000000");
        }
        if !MeasuringShare::PERCENTS.contains(&self.measuring_percent) {
            return bad("measuring_percent", &self.measuring_percent, "1 to 50");
        }
        if !(4..=10).contains(&self.octree_depth) {
            return bad("octree_depth", &self.octree_depth, "4 to 10");
        }
        if !(1_000..=10_000_000).contains(&self.irradiance_records) {
            return bad("irradiance_records", &self.irradiance_records, "1000 to 10000000");
        }
        if self.bodies_bytes < self.body_bytes {
            return bad("bodies_bytes", &self.bodies_bytes, "at least body_bytes");
        }
        if self.head_bytes < 8192 {
            return bad(
                "head_bytes",
                &self.head_bytes,
                "at least 8192, the smallest that the HTTP reader takes",
            );
        }
        if self.frames_in_flight > 16 {
            return bad(
                "frames_in_flight",
                &self.frames_in_flight,
                "1 to 16: more only makes pictures older",
            );
        }
        let durations =
            [("frame_seconds_max", self.frame_seconds_max), ("frame_seconds", self.frame_seconds)];
        for (key, value) in durations {
            if !(value > 0.0 && value <= 86_400.0) {
                return bad(key, &value, "above 0 and at most 86400");
            }
        }
        if !(self.frames_per_second > 0.0 && self.frames_per_second <= 1000.0) {
            return bad("frames_per_second", &self.frames_per_second, "above 0 and at most 1000");
        }
        if !(0.0..=86_400.0).contains(&self.kept_light_s) {
            return bad("kept_light_s", &self.kept_light_s, "0 to 86400");
        }
        if !(1.0..=10_000.0).contains(&self.moving_pass_ms) {
            return bad("moving_pass_ms", &self.moving_pass_ms, "1 to 10000");
        }
        Ok(())
    }
}

/// The types have been seen to; what is left is a number that its field cannot hold. The reader of TOML does not say
/// which, so each is tried alone among the defaults.
fn too_large(table: &toml::Table, error: &toml::de::Error) -> ConfigError {
    let refused = |(key, value): &(&String, &toml::Value)| {
        let mut alone = table_of(&Config::default());
        alone.insert((*key).clone(), (*value).clone());
        alone.try_into::<Config>().is_err()
    };
    let culprit = table.iter().find(refused);
    let (key, value) = culprit.map_or_else(Default::default, |(key, value)| (key.clone(), value.to_string()));
    ConfigError::Syntax { path: "settings".into(), reason: format!("{key} = {value}: {}", error.message()) }
}

/// The settings as a table; every field of [`Config`] is plain data, so this cannot fail.
fn table_of(config: &Config) -> toml::Table {
    toml::Table::try_from(config).unwrap_or_default()
}

fn overlay_file(table: &mut toml::Table, path: &Path) -> Result<(), ConfigError> {
    let name = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: name.clone(), source })?;
    let given: toml::Table = text.parse().map_err(|error: toml::de::Error| ConfigError::Syntax {
        path: name.clone(),
        reason: error.to_string(),
    })?;
    for (key, value) in given {
        overlay(table, &key, value, format!("config file {name}"))?;
    }
    Ok(())
}

/// Puts a value in place of the one of that key, if it has its type. An integer will do for a float.
fn overlay(
    table: &mut toml::Table,
    key: &str,
    value: toml::Value,
    origin: String,
) -> Result<(), ConfigError> {
    use toml::Value::{Array, Boolean, Float, Integer, String};
    let Some(place) = table.get_mut(key) else {
        return Err(ConfigError::UnknownKey { origin, key: key.into() });
    };
    let wrong = |value: toml::Value, expected| ConfigError::WrongType {
        origin: origin.clone(),
        key: key.into(),
        value: value.to_string(),
        expected,
    };
    *place = match (&*place, value) {
        (Float(_), Integer(value)) => Float(value as f64),
        (Float(_), value @ Float(_)) | (String(_), value @ String(_)) => value,
        (Integer(_), Integer(value)) if value >= 0 => Integer(value),
        (Boolean(_), value @ Boolean(_)) => value,
        (Array(_), Array(values)) if values.iter().all(toml::Value::is_str) => Array(values),
        (Float(_), value) => return Err(wrong(value, "a number")),
        (String(_), value) => return Err(wrong(value, "a text in quotes")),
        (Array(_), value) => return Err(wrong(value, "a list of texts")),
        (Boolean(_), value) => return Err(wrong(value, "true or false")),
        (_, value) => return Err(wrong(value, "a whole number, at least 0")),
    };
    Ok(())
}

/// Name of an environment variable, and key of the setting that it would be; `None` if it is none of ours.
fn setting_of(name: &OsStr) -> Option<(&str, String)> {
    let name = name.to_str()?;
    Some((name, name.strip_prefix("LUMICAST_")?.to_lowercase()))
}

/// The same from a text, read as the type that the setting has.
fn overlay_text(table: &mut toml::Table, key: &str, text: &str, origin: String) -> Result<(), ConfigError> {
    use toml::Value::{Array, Boolean, Float, Integer, String};
    let as_text = || String(text.into());
    let value = match table.get(key) {
        Some(Integer(_)) => text.trim().parse().map_or_else(|_| as_text(), Integer),
        Some(Float(_)) => text.trim().parse().map_or_else(|_| as_text(), Float),
        Some(Boolean(_)) => text.trim().parse().map_or_else(|_| as_text(), Boolean),
        Some(Array(_)) => {
            let parts = text.split(',').map(str::trim).filter(|part| !part.is_empty());
            Array(parts.map(|part| String(part.into())).collect())
        }
        _ => as_text(),
    };
    overlay(table, key, value, origin)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(toml: &str, environment: &[(&str, &str)], flags: &[(&str, &str)]) -> Result<Config, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), toml).unwrap();
        let environment = environment.iter().map(|(k, v)| (k.into(), v.into()));
        let flags: Vec<_> =
            flags.iter().map(|(k, v)| (k.to_string(), v.to_string(), format!("--set {k}"))).collect();
        Config::load(Some(file.path()), environment, &flags).map_err(|e| e.to_string())
    }

    #[test]
    fn flags_win_over_environment_over_file_over_defaults() {
        let toml = "threads = 1\nseed = 1\nmessage_bytes = 1";
        let config =
            load(toml, &[("LUMICAST_THREADS", "2"), ("LUMICAST_SEED", "2")], &[("seed", "3")]).unwrap();
        assert_eq!((config.seed, config.threads, config.message_bytes), (3, 2, 1));
        assert_eq!(config.body_bytes, Config::default().body_bytes);
        let origins =
            load("", &[("LUMICAST_ALLOW_ORIGINS", "http://a, http://b")], &[]).unwrap().allow_origins;
        assert_eq!(origins, ["http://a", "http://b"]);
        assert!(load("keep_noise = true", &[], &[]).unwrap().keep_noise);
        assert!(!load("keep_noise = true", &[("LUMICAST_KEEP_NOISE", "false")], &[]).unwrap().keep_noise);
        // A whole number will do where a fraction is expected.
        assert_eq!(load("frame_seconds = 3", &[], &[]).unwrap().frame_seconds, 3.0);
    }

    /// Variables that are no text are others' business; one that would be a setting is told by name.
    #[cfg(unix)]
    #[test]
    fn variables_that_are_no_text_do_no_harm() {
        use std::os::unix::ffi::OsStringExt;
        let odd = || OsString::from_vec(vec![b'x', 0xff]);
        let load = |name: OsString| Config::load(None, std::iter::once((name, odd())), &[]);
        assert_eq!(load(odd()).unwrap(), Config::default());
        assert_eq!(load("HOME".into()).unwrap(), Config::default());
        assert!(load("LUMICAST_DATA".into()).unwrap_err().to_string().contains("LUMICAST_DATA"));
    }

    /// What messages about scene files advise to raise can be raised.
    #[test]
    fn limits_of_files_are_settings() {
        fn sources(folder: &Path, found: &mut String) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                match path.is_dir() {
                    true => sources(&path, found),
                    false => found.push_str(&std::fs::read_to_string(&path).unwrap()),
                }
            }
        }
        let mut text = String::new();
        sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/assets"), &mut text);
        let named: Vec<&str> =
            text.split("setting: \"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert!(named.len() >= 12, "{named:?}");
        let table = table_of(&Config::default());
        for name in named {
            assert!(table.contains_key(name), "{name} is no setting");
        }
    }

    #[test]
    fn unknown_keys_and_bad_values_are_refused_by_name() {
        for (toml, named) in [
            ("viewers = 3", "viewers"),
            ("threads = \"many\"", "threads"),
            ("threads = -1", "threads"),
            ("threads = 100000", "threads"),
            ("picture_width = 70000", "picture_width"),
            ("backend = \"abacus\"", "backend"),
            ("scenes = 0", "scenes"),
            ("keep_noise = 1", "true or false"),
            ("frame_seconds = nan", "frame_seconds"),
            ("[http]\nport = 1", "http"),
            ("threads", "config file"),
        ] {
            let error = load(toml, &[], &[]).unwrap_err();
            assert!(error.contains(named), "{toml}: {error}");
        }
        assert!(load("", &[("LUMICAST_THREADS", "x")], &[]).unwrap_err().contains("LUMICAST_THREADS"));
        assert!(load("", &[], &[("nothing", "1")]).unwrap_err().contains("nothing"));
        assert_eq!(load("", &[("LUMICAST_NOTHING", "x")], &[]).unwrap(), Config::default());
    }

    #[test]
    fn the_example_in_deploy_is_the_defaults() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/lumicast.toml");
        let expected = Config::default().to_toml();
        if std::env::var_os("LUMICAST_BLESS").is_some() {
            std::fs::write(path, &expected).unwrap();
        }
        assert_eq!(std::fs::read_to_string(path).unwrap(), expected, "LUMICAST_BLESS=1 rewrites it");
        assert_eq!(Config::load(Some(Path::new(path)), std::iter::empty(), &[]).unwrap(), Config::default());
    }

    #[test]
    fn limits_of_the_protocol_are_the_configured_ones() {
        assert_eq!(Config::default().limits(), Limits::default());
    }
}
