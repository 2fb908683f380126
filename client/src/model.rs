//! Everything the viewer knows: a pure state machine between the server's messages and the person's wishes.
//!
//! `apply` takes what the server said, `next_message` gives what is to be said next. There is no queue of messages: for
//! each kind the newest state is kept and sent when there is room, so nothing grows behind a slow line. No egui, no
//! sockets, no clock: times are seconds that the caller passes in.

pub mod edits;
pub mod history;
pub mod link;
pub mod notices;
pub mod tree;

use crate::camera::{Bounds, ViewCamera};
use crate::picture::{Decoded, PictureError, SIDE_MAX};
use edits::{Edits, Target};
use glam::DVec3;
use history::{ErrorHistory, Latencies, Rate};
use link::Link;
use lumicast_protocol::{
    Accuracy, CameraRequest, ClientHello, ClientMessage, FrameHeader, Id, PayloadKind, Problem, Quality,
    SUBPROTOCOL, SceneDescription, ServerHello, ServerMessage, Stats, View,
};
use notices::{Notices, Severity};
use std::collections::VecDeque;
use std::sync::Arc;

/// Camera messages at most this often: the protocol's figure, more than screens show.
const CAMERA_INTERVAL_S: f64 = 1.0 / 60.0;
/// Quality and accuracy while a slider is dragged: each restarts the server's film.
const SETTINGS_INTERVAL_S: f64 = 0.1;
/// Stamps whose frames may still come. Older ones are forgotten: their frames were never drawn.
const STAMPS_MAX: usize = 512;

/// What a person has picked in the tree.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs, reason = "one per kind of thing in a scene")]
pub enum Selected {
    Node(Id),
    Mesh(Id),
    Material(Id),
    Light(Id),
    Camera(Id),
    Environment,
}

impl Selected {
    /// The thing that its editor changes; meshes have none, cameras are set as a whole.
    pub fn target(&self) -> Option<Target> {
        match self {
            Self::Node(id) => Some(Target::Node(id.clone())),
            Self::Material(id) => Some(Target::Material(id.clone())),
            Self::Light(id) => Some(Target::Light(id.clone())),
            Self::Environment => Some(Target::Environment),
            Self::Mesh(_) | Self::Camera(_) => None,
        }
    }

    fn is_in(&self, scene: &SceneDescription) -> bool {
        match self {
            Self::Node(id) => scene.nodes.iter().any(|node| node.id == *id),
            Self::Mesh(id) => scene.meshes.iter().any(|mesh| mesh.id == *id),
            Self::Material(id) => scene.materials.iter().any(|material| material.id == *id),
            Self::Light(id) => scene.lights.iter().any(|light| light.id == *id),
            Self::Camera(id) => scene.cameras.iter().any(|camera| camera.id == *id),
            Self::Environment => true,
        }
    }
}

/// The scene with what is looked up in it often.
#[derive(Debug, Clone)]
pub struct Scene {
    /// As the server told it.
    pub description: Arc<SceneDescription>,
    /// Counts up whenever another description comes, so that what was derived from it can be kept until then.
    pub version: u64,
}

/// Which picture is wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Viewpoint {
    /// Where it is seen from.
    pub camera: ViewCamera,
    /// The camera of the scene that it still is, unmoved.
    pub follows: Option<Id>,
}

/// Settings with what the server has of them.
#[derive(Debug, Clone)]
struct Setting<T> {
    wanted: T,
    sent: Option<T>,
    sent_s: f64,
}

impl<T: PartialEq + Copy> Setting<T> {
    fn new(wanted: T) -> Self {
        Self { wanted, sent: None, sent_s: f64::NEG_INFINITY }
    }

    fn due_s(&self) -> Option<f64> {
        (self.sent != Some(self.wanted)).then_some(self.sent_s + SETTINGS_INTERVAL_S)
    }

    fn take(&mut self, now_s: f64) -> Option<T> {
        self.due_s().filter(|due_s| now_s >= *due_s)?;
        (self.sent, self.sent_s) = (Some(self.wanted), now_s);
        Some(self.wanted)
    }
}

/// The state of a viewer of one scene.
#[derive(Debug, Clone)]
pub struct Model {
    /// The connection.
    pub link: Link,
    /// What the server said of itself.
    pub hello: Option<ServerHello>,
    /// The scene, once told.
    pub scene: Option<Scene>,
    /// What is picked.
    pub selected: Option<Selected>,
    /// Editing.
    pub edits: Edits,
    /// News and errors.
    pub notices: Notices,
    /// What the server says of the picture.
    pub stats: Option<Stats>,
    /// Header of the picture on show.
    pub frame: Option<FrameHeader>,
    /// Frames and bytes lately.
    pub rate: Rate,
    /// From a camera message to the first frame drawn from it, on screen.
    pub camera_latencies: Latencies,
    /// From an edit to the first frame that shows it, on screen.
    pub edit_latencies: Latencies,
    /// From ping to pong, in seconds.
    pub round_trip_s: Option<f64>,
    /// How the error fell.
    pub errors: ErrorHistory,
    viewpoint: Option<Viewpoint>,
    start_camera: Option<String>,
    /// Made by this viewer; selected once the scene has it.
    select_later: Option<Selected>,
    size: [u16; 2],
    quality: Setting<Quality>,
    accuracy: Setting<Accuracy>,
    hello_due: bool,
    camera_due: bool,
    camera_sent_s: f64,
    stamp: u64,
    stamps: VecDeque<(u64, f64)>,
    ack_due: Option<u64>,
    /// Of the edit whose first frame is awaited: revision, when it was sent.
    edit_awaited: Option<(u64, f64)>,
    random: u64,
}

impl Model {
    /// A viewer that is connected to nothing. `session`: a random number; `start_camera`: where to look first.
    pub fn new(session: u64, start_camera: Option<String>) -> Self {
        Self {
            link: Link::default(),
            hello: None,
            scene: None,
            selected: None,
            edits: Edits::new(session),
            notices: Notices::default(),
            stats: None,
            frame: None,
            rate: Rate::default(),
            camera_latencies: Latencies::default(),
            edit_latencies: Latencies::default(),
            round_trip_s: None,
            errors: ErrorHistory::default(),
            viewpoint: None,
            start_camera,
            select_later: None,
            size: [0, 0],
            quality: Setting::new(Quality::default()),
            accuracy: Setting::new(Accuracy::default()),
            hello_due: false,
            camera_due: false,
            camera_sent_s: f64::NEG_INFINITY,
            stamp: 0,
            stamps: VecDeque::new(),
            ack_due: None,
            edit_awaited: None,
            random: session | 1,
        }
    }

    /// Forgets the scene; settings stay.
    pub fn leave_scene(&mut self, now_s: f64) {
        let session = self.next_random();
        // Taken when the first scene comes, so a later scene starts with its own first camera.
        let mut fresh = Self::new(session, self.start_camera.take());
        (fresh.quality.wanted, fresh.accuracy.wanted) = (self.quality.wanted, self.accuracy.wanted);
        (fresh.size, fresh.stamp) = (self.size, self.stamp);
        fresh.notices = std::mem::take(&mut self.notices);
        fresh.notices.dismiss_all();
        fresh.link.start(now_s);
        *self = fresh;
    }

    fn next_random(&mut self) -> u64 {
        // An xorshift spreads the session's randomness over later needs: jitter, later sessions.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }

    // ---- what the socket does

    /// The socket is open: everything is to be said anew, a connection has no memory.
    pub fn socket_opened(&mut self, now_s: f64) {
        self.link.heard(now_s);
        self.hello_due = true;
        (self.quality.sent, self.accuracy.sent) = (None, None);
        (self.ack_due, self.edit_awaited) = (None, None);
        self.stamps.clear();
        self.edits.reconnected();
    }

    /// The socket is gone. Status 404 (and a wrong subprotocol) will not heal by trying again.
    pub fn socket_lost(&mut self, reason: &str, is_final: bool, now_s: f64) {
        self.hello_due = false;
        if is_final {
            self.link.refused(reason.to_owned());
        } else {
            let random = (self.next_random() >> 11) as f64 / (1u64 << 53) as f64;
            self.link.lost(reason.to_owned(), now_s, random);
        }
    }

    /// Whether to open a socket now.
    pub fn take_retry(&mut self, now_s: f64) -> bool {
        self.link.take_retry(now_s)
    }

    /// A person does not want to wait.
    pub fn retry_now(&mut self, now_s: f64) {
        self.link.retry_now(now_s);
    }

    /// Why the socket is to be given up although it looks open.
    pub fn silence(&self, now_s: f64) -> Option<String> {
        self.link.silence(now_s)
    }

    // ---- what the server says

    /// A text frame.
    pub fn apply_text(&mut self, text: &str, now_s: f64) {
        self.link.heard(now_s);
        match ServerMessage::from_json(text) {
            Ok(message) => self.apply(message, now_s),
            // A later server may say more: a type that is unknown is ignored, what is broken is told.
            Err(_) if is_unknown_type(text) => {}
            Err(error) => self.notices.add(
                Severity::Error,
                "The server sent a message that cannot be read",
                &error.to_string(),
                now_s,
            ),
        }
    }

    /// A message.
    pub fn apply(&mut self, message: ServerMessage, now_s: f64) {
        match message {
            ServerMessage::Hello(hello) => self.apply_hello(hello, now_s),
            ServerMessage::Scene { scene } => self.apply_scene(*scene, now_s),
            ServerMessage::Edited { request, revision } => {
                let scene_revision = self.scene.as_ref().map_or(0, |scene| scene.description.revision);
                if let Some(sent_s) = self.edits.edited(request, revision, scene_revision) {
                    self.edit_awaited.get_or_insert((revision, sent_s));
                }
            }
            ServerMessage::Error { problem, request } => self.apply_error(&problem, request, now_s),
            ServerMessage::Stats(stats) => {
                self.errors.add(&stats);
                self.stats = Some(stats);
            }
            ServerMessage::Pong { stamp } => {
                self.round_trip_s = Some((now_s - stamp as f64 / 1e6).max(0.0));
            }
        }
    }

    fn apply_hello(&mut self, hello: ServerHello, now_s: f64) {
        if hello.protocol != SUBPROTOCOL {
            let reason = format!("the server speaks {:?}, this viewer {SUBPROTOCOL}", hello.protocol);
            self.link.refused(reason);
            return;
        }
        self.link.opened(now_s);
        self.hello = Some(hello);
        self.camera_due = true;
    }

    fn apply_scene(&mut self, scene: SceneDescription, now_s: f64) {
        let is_first = self.scene.is_none();
        let version = self.scene.as_ref().map_or(0, |scene| scene.version) + 1;
        self.edits.scene_arrived(scene.revision);
        self.selected.take_if(|selected| !selected.is_in(&scene));
        if let Some(made) = self.select_later.take_if(|made| made.is_in(&scene)) {
            self.selected = Some(made);
        }
        self.scene = Some(Scene { description: Arc::new(scene), version });
        if is_first {
            self.look_first(now_s);
        } else {
            self.follow_camera();
        }
    }

    /// The camera that was asked for, else the first, else all of the scene.
    fn look_first(&mut self, now_s: f64) {
        let Some(scene) = self.scene.as_ref().map(|scene| scene.description.clone()) else { return };
        let wanted = self.start_camera.take();
        let named =
            wanted.as_ref().and_then(|name| scene.cameras.iter().find(|camera| camera.id == name.as_str()));
        if let (Some(name), None) = (&wanted, named) {
            let known: Vec<&str> = scene.cameras.iter().take(20).map(|camera| camera.id.as_str()).collect();
            let detail = format!("this scene has: {}", known.join(", "));
            self.notices.add(Severity::Error, &format!("There is no camera {name:?}"), &detail, now_s);
        }
        match named.or(scene.cameras.first()) {
            Some(camera) => self.go_to_camera(&camera.id.clone()),
            None => {
                let mut camera = ViewCamera::new();
                camera.orbit(0.6, 0.35);
                self.viewpoint = Some(Viewpoint { camera, follows: None });
                self.frame_all();
            }
        }
        self.camera_due = true;
    }

    /// A camera of the scene that was edited takes this viewer along.
    fn follow_camera(&mut self) {
        let Some(id) = self.viewpoint.as_ref().and_then(|view| view.follows.clone()) else { return };
        let focus_distance_m = self.viewpoint.as_ref().map(|view| view.camera.focus_distance_m);
        let pose = self.scene_camera(&id);
        if let (Some(viewpoint), None) = (&mut self.viewpoint, &pose) {
            // Removed: the view stays as a pose of its own.
            viewpoint.follows = None;
            self.camera_due = true;
        }
        if let (Some(mut camera), Some(focus_distance_m)) = (pose, focus_distance_m) {
            camera.focus_distance_m = focus_distance_m;
            self.viewpoint = Some(Viewpoint { camera, follows: Some(id) });
        }
    }

    fn scene_camera(&self, id: &Id) -> Option<ViewCamera> {
        let scene = &self.scene.as_ref()?.description;
        let camera = scene.cameras.iter().find(|camera| camera.id == *id)?;
        Some(ViewCamera::from_pose(&camera.world_from_camera, camera.projection, scene.bounds))
    }

    fn apply_error(&mut self, problem: &Problem, request: Option<u64>, now_s: f64) {
        let at_editor = request.is_some_and(|request| self.edits.refused(request, problem));
        if !at_editor {
            self.notices.add(Severity::Error, &problem.title, &problem.detail, now_s);
        }
    }

    /// A binary message, decoded. Returns whether there is a picture to show.
    pub fn apply_picture(&mut self, picture: &Result<Decoded, PictureError>, now_s: f64) -> bool {
        self.link.heard(now_s);
        match picture {
            Ok(decoded) => {
                self.rate.add(now_s, decoded.message_bytes);
                self.ack(decoded.header.frame);
                decoded.pixels.is_some() && self.apply_header(&decoded.header, now_s)
            }
            Err(error) => {
                self.notices.add(Severity::Error, "A picture cannot be shown", &error.to_string(), now_s);
                false
            }
        }
    }

    /// A binary message has been used, or is of no use.
    pub fn ack(&mut self, frame: u64) {
        self.ack_due = Some(self.ack_due.map_or(frame, |due| due.max(frame)));
    }

    fn apply_header(&mut self, header: &FrameHeader, now_s: f64) -> bool {
        if header.kind == PayloadKind::LightMapDelta {
            return false;
        }
        if header.first_from_stamp {
            let sent = self.stamps.iter().rev().find(|(stamp, _)| *stamp == header.camera_stamp);
            if let Some((_, sent_s)) = sent {
                self.camera_latencies.add(now_s - sent_s);
            }
        }
        while self.stamps.front().is_some_and(|(stamp, _)| *stamp <= header.camera_stamp) {
            self.stamps.pop_front();
        }
        if let Some((_, sent_s)) = self.edit_awaited.take_if(|(revision, _)| header.revision >= *revision) {
            self.edit_latencies.add(now_s - sent_s);
        }
        self.frame = Some(*header);
        true
    }

    // ---- what the person does

    /// Where the picture is seen from, once there is a scene.
    pub fn viewpoint(&self) -> Option<&Viewpoint> {
        self.viewpoint.as_ref()
    }

    /// Moves the camera; it is a pose of its own from then on.
    pub fn move_camera(&mut self, change: impl FnOnce(&mut ViewCamera)) {
        let Some(viewpoint) = &mut self.viewpoint else { return };
        let before = viewpoint.camera;
        change(&mut viewpoint.camera);
        if viewpoint.camera != before {
            viewpoint.follows = None;
            self.camera_due = true;
        }
    }

    /// Looks through a camera of the scene.
    pub fn go_to_camera(&mut self, id: &Id) {
        if let Some(camera) = self.scene_camera(id) {
            self.viewpoint = Some(Viewpoint { camera, follows: Some(id.clone()) });
            self.camera_due = true;
        }
    }

    /// Something on this side went wrong.
    pub fn tell_error(&mut self, title: &str, detail: &str) {
        // The time of the last message is near enough for a notice.
        let now_s = self.link.heard_s();
        self.notices.add(Severity::Error, title, detail, now_s);
    }

    /// Selects what was just made, as soon as the server tells of it.
    pub fn select_when_there(&mut self, made: Selected) {
        self.select_later = Some(made);
    }

    /// Box around the scene.
    pub fn bounds(&self) -> Option<Bounds> {
        self.scene.as_ref()?.description.bounds
    }

    /// Radius of the scene in metres; 1 where it is unknown.
    pub fn scene_radius_m(&self) -> f64 {
        self.bounds().and_then(crate::camera::sphere_around).map_or(1.0, |(_, radius_m)| radius_m.max(1e-3))
    }

    /// Shows the whole scene.
    pub fn frame_all(&mut self) {
        if let Some(bounds) = self.bounds() {
            let aspect = self.aspect();
            self.move_camera(|camera| camera.frame(bounds, aspect));
        }
    }

    /// Brings what is selected into the middle; the whole scene where nothing with a place is.
    pub fn frame_selected(&mut self) {
        let Some(place) = self.selected_place() else { return self.frame_all() };
        // How big it is the server does not say: a fifth of the scene is a view in which a thing can be found.
        let distance_m = self.scene_radius_m() * 0.6;
        self.move_camera(|camera| {
            camera.look_from_here_at(place, camera.focus_distance_m.min(distance_m));
        });
    }

    /// Where the selected thing is, in the world.
    fn selected_place(&self) -> Option<DVec3> {
        let scene = &self.scene.as_ref()?.description;
        match self.selected.as_ref()? {
            Selected::Node(id) => tree::node_place(scene, id),
            Selected::Light(id) => tree::light_place(scene, id),
            _ => None,
        }
    }

    /// Width ÷ height of the picture.
    pub fn aspect(&self) -> f64 {
        if self.size[1] == 0 { 1.0 } else { f64::from(self.size[0]) / f64::from(self.size[1]) }
    }

    /// Asks for pictures of this many pixels, as far as server and viewer allow; keeps the shape.
    pub fn set_size(&mut self, size: [f64; 2]) {
        let largest = self.hello.as_ref().map_or([SIDE_MAX; 2], |hello| {
            [hello.limits.picture_width.min(SIDE_MAX), hello.limits.picture_height.min(SIDE_MAX)]
        });
        let scale = (0..2).map(|axis| f64::from(largest[axis]) / size[axis].max(1.0)).fold(1.0, f64::min);
        let size = [0, 1].map(|axis| ((size[axis] * scale).floor() as u16).clamp(1, largest[axis].max(1)));
        if size != self.size {
            self.size = size;
            self.camera_due = true;
        }
    }

    /// How pictures are wanted.
    pub fn quality(&self) -> Quality {
        self.quality.wanted
    }

    /// Changes it.
    pub fn set_quality(&mut self, quality: Quality) {
        self.quality.wanted = quality;
    }

    /// How exact they are wanted.
    pub fn accuracy(&self) -> Accuracy {
        self.accuracy.wanted
    }

    /// Changes it.
    pub fn set_accuracy(&mut self, accuracy: Accuracy) {
        self.accuracy.wanted = accuracy;
    }

    // ---- what is to be said

    /// The next message for the server, most urgent first; to be called while the socket has room.
    pub fn next_message(&mut self, now_s: f64) -> Option<ClientMessage> {
        if std::mem::take(&mut self.hello_due) {
            return Some(ClientMessage::Hello(ClientHello {
                client: env!("CARGO_PKG_NAME").into(),
                version: env!("CARGO_PKG_VERSION").into(),
            }));
        }
        if !self.link.is_open() {
            return None;
        }
        if let Some(frame) = self.ack_due.take() {
            return Some(ClientMessage::Ack { frame });
        }
        if let Some(quality) = self.quality.take(now_s) {
            return Some(ClientMessage::Quality(quality));
        }
        if let Some(accuracy) = self.accuracy.take(now_s) {
            return Some(ClientMessage::Accuracy(accuracy));
        }
        if let Some(camera) = self.take_camera(now_s) {
            return Some(ClientMessage::Camera(camera));
        }
        if let Some(scene) = self.scene.as_ref().map(|scene| scene.description.clone())
            && let Some(request) = self.edits.next_request(&scene, now_s)
        {
            return Some(ClientMessage::Edit(request));
        }
        // Microseconds, so that the stamp is all the memory that a ping needs.
        self.link.take_ping(now_s).then_some(ClientMessage::Ping { stamp: (now_s * 1e6) as u64 })
    }

    fn take_camera(&mut self, now_s: f64) -> Option<CameraRequest> {
        let ready = self.camera_due && now_s - self.camera_sent_s >= CAMERA_INTERVAL_S && self.size[0] > 0;
        let viewpoint = self.viewpoint.as_ref().filter(|_| ready)?;
        let view = match &viewpoint.follows {
            Some(id) => View::Camera(id.clone()),
            None => View::Pose(viewpoint.camera.pose()),
        };
        (self.camera_due, self.camera_sent_s) = (false, now_s);
        self.stamp += 1;
        self.stamps.push_back((self.stamp, now_s));
        if self.stamps.len() > STAMPS_MAX {
            self.stamps.pop_front();
        }
        Some(CameraRequest { stamp: self.stamp, size: self.size, view })
    }

    /// When `next_message`, `take_retry` or `silence` will have something to say, if nothing happens until then.
    pub fn due_s(&self) -> Option<f64> {
        let mut due: Vec<f64> = self.link.due_s().into_iter().collect();
        if self.link.is_open() {
            due.extend(self.camera_due.then_some(self.camera_sent_s + CAMERA_INTERVAL_S));
            due.extend(self.quality.due_s());
            due.extend(self.accuracy.due_s());
            due.extend(self.edits.due_s());
        }
        due.into_iter().reduce(f64::min)
    }
}

/// Whether a text is a message of a kind that this viewer does not know, rather than a broken one.
fn is_unknown_type(text: &str) -> bool {
    const KNOWN: [&str; 6] = ["hello", "scene", "edited", "error", "stats", "pong"];
    let value: Result<serde_json::Value, _> = serde_json::from_str(text);
    let kind = value.ok().and_then(|value| value.get("type")?.as_str().map(str::to_owned));
    kind.is_some_and(|kind| !KNOWN.contains(&kind.as_str()))
}

#[cfg(test)]
pub(crate) mod tests;
