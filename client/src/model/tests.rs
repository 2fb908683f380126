//! Laws of the state: what each message changes, and what it leaves.

use super::*;
use lumicast_protocol::{
    CameraDescription, Codec, Counts, EnvironmentDescription, LightDescription, LightSource, Limits,
    PayloadCodec, Projection, SceneId,
};

pub(crate) fn scene(revision: u64) -> SceneDescription {
    let id = |text: &str| Id::new(text).unwrap();
    let camera = |name: &str, z: f64| CameraDescription {
        id: id(name),
        parent: None,
        world_from_camera: [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 1., z, 1.],
        projection: Projection::Perspective { yfov_rad: 0.7 },
        aspect: None,
    };
    SceneDescription {
        id: SceneId::new("cornell-box").unwrap(),
        name: "Cornell box".into(),
        revision,
        durable: false,
        counts: Counts::default(),
        bounds: Some([[-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]]),
        warnings: vec![],
        nodes: vec![],
        meshes: vec![],
        materials: vec![],
        lights: vec![LightDescription {
            id: id("lamp"),
            parent: None,
            source: LightSource::Point { intensity: [10.0; 3], position: [0.0, 1.8, 0.0] },
        }],
        cameras: vec![camera("front", 3.5), camera("back", -3.5)],
        environment: EnvironmentDescription::None,
    }
}

pub(crate) fn hello() -> ServerMessage {
    ServerMessage::Hello(ServerHello {
        protocol: SUBPROTOCOL.into(),
        version: "0.1.0".into(),
        scene: SceneId::new("cornell-box").unwrap(),
        revision: 1,
        viewer: 1,
        limits: Limits::default(),
    })
}

fn open(start_camera: Option<&str>) -> Model {
    let mut model = Model::new(7, start_camera.map(str::to_owned));
    model.leave_scene(0.0);
    model.set_size([640.0, 360.0]);
    model.socket_opened(0.0);
    model.apply(hello(), 0.0);
    model.apply(ServerMessage::Scene { scene: Box::new(scene(1)) }, 0.0);
    model
}

fn said(model: &mut Model, now_s: f64) -> Vec<ClientMessage> {
    std::iter::from_fn(|| model.next_message(now_s)).collect()
}

fn camera_of(messages: &[ClientMessage]) -> Option<CameraRequest> {
    messages.iter().find_map(|message| match message {
        ClientMessage::Camera(camera) => Some(camera.clone()),
        _ => None,
    })
}

fn frame(frame: u64, camera_stamp: u64, now_s: f64, model: &mut Model) {
    let header =
        FrameHeader { frame, camera_stamp, ..crate::picture::tests::header([2, 2], PayloadCodec::Png) };
    let pixels = Some(crate::picture::Pixels::Srgb(vec![0; 12]));
    assert!(model.apply_picture(&Ok(Decoded { header, pixels, message_bytes: 100 }), now_s));
}

#[test]
fn hello_comes_first_and_nothing_before_the_server_answered() {
    let mut model = Model::new(7, None);
    model.leave_scene(0.0);
    model.set_size([640.0, 360.0]);
    assert_eq!(said(&mut model, 0.0), []);
    model.socket_opened(0.0);
    let first = said(&mut model, 0.0);
    assert!(matches!(first.as_slice(), [ClientMessage::Hello(_)]), "{first:?}");
    model.apply(hello(), 0.1);
    model.apply(ServerMessage::Scene { scene: Box::new(scene(1)) }, 0.1);
    let second = said(&mut model, 0.1);
    assert!(
        matches!(
            second.as_slice(),
            [ClientMessage::Quality(_), ClientMessage::Accuracy(_), ClientMessage::Camera(_)]
        ),
        "{second:?}"
    );
    assert_eq!(camera_of(&second).unwrap().view, View::Camera(Id::new("front").unwrap()));
}

#[test]
fn every_message_is_within_the_servers_limits() {
    let limits = Limits { picture_width: 300, picture_height: 200, ..Limits::default() };
    let mut model = open(None);
    model.hello.as_mut().unwrap().limits = limits.clone();
    model.set_size([5000.0, 1000.0]);
    model.move_camera(|camera| camera.dolly(0.5));
    model.edits.change(
        &scene(1),
        &Target::Environment,
        edits::Value::Environment(EnvironmentDescription::Constant { radiance: [1.0; 3] }),
        0.0,
    );
    let messages = said(&mut model, 1.0);
    assert_eq!(messages.len(), 5, "{messages:?}");
    for message in &messages {
        limits.check(message).unwrap();
        let json = message.to_json();
        assert_eq!(ClientMessage::from_json(&json).as_ref(), Ok(message), "{json}");
    }
    // The shape is kept: 5000 × 1000 into 300 × 200.
    assert_eq!(camera_of(&messages).unwrap().size, [300, 60]);
}

#[test]
fn of_many_camera_moves_the_newest_is_sent_with_a_rising_stamp() {
    let mut model = open(None);
    let mut stamp = camera_of(&said(&mut model, 0.0)).unwrap().stamp;
    let mut sent = 0;
    for step in 1..=1000 {
        let now_s = f64::from(step) * 0.001;
        model.move_camera(|camera| camera.orbit(0.001, 0.0));
        if let Some(camera) = camera_of(&said(&mut model, now_s)) {
            assert!(camera.stamp > stamp);
            stamp = camera.stamp;
            sent += 1;
            assert_eq!(camera.view, View::Pose(model.viewpoint().unwrap().camera.pose()));
        }
    }
    assert!((50..=60).contains(&sent), "{sent} in a second");
}

#[test]
fn latency_is_from_the_camera_message_to_the_first_frame_of_its_stamp() {
    let mut model = open(None);
    let first = camera_of(&said(&mut model, 0.0)).unwrap().stamp;
    model.move_camera(|camera| camera.dolly(0.9));
    let second = camera_of(&said(&mut model, 1.0)).unwrap().stamp;
    frame(1, second, 1.05, &mut model);
    assert!((model.camera_latencies.last_s().unwrap() - 0.05).abs() < 1e-9);
    // A frame of the older stamp comes late, and one more of the newer: neither is a first.
    frame(2, first, 1.5, &mut model);
    frame(3, second, 1.6, &mut model);
    assert_eq!(model.camera_latencies.count(), 1);
    assert!(said(&mut model, 2.0).contains(&ClientMessage::Ack { frame: 3 }));
}

#[test]
fn a_picture_that_cannot_be_read_is_told_and_the_next_one_is_shown() {
    let mut model = open(None);
    let error = Err(PictureError::TooLarge { size: [65535, 65535] });
    assert!(!model.apply_picture(&error, 0.5));
    assert!(model.notices.newest_error().unwrap().detail.contains("65535"));
    frame(2, 1, 1.0, &mut model);
    assert_eq!(model.frame.unwrap().frame, 2);
}

#[test]
fn broken_json_is_told_and_an_unknown_type_is_ignored() {
    let mut model = open(None);
    model.apply_text(r#"{"type":"fireworks","height_m":100}"#, 1.0);
    assert!(model.notices.newest_error().is_none());
    for broken in ["", "{", "[]", "null", r#"{"type":"edited"}"#, r#"{"type":"scene","scene":{"id":""}}"#] {
        model.apply_text(broken, 1.0);
        assert!(model.notices.newest_error().is_some(), "{broken}");
        model.notices.dismiss_all();
    }
    assert!(model.scene.is_some());
}

#[test]
fn a_new_connection_is_told_everything_again_and_the_view_stays() {
    let mut model = open(None);
    model.move_camera(|camera| camera.orbit(0.3, 0.1));
    let stamp = camera_of(&said(&mut model, 1.0)).unwrap().stamp;
    let view = model.viewpoint().unwrap().clone();
    model.socket_lost("gone", false, 2.0);
    assert!(model.link.is_mending());
    assert_eq!(said(&mut model, 2.0), []);
    assert!(model.take_retry(20.0));
    model.socket_opened(20.1);
    assert!(matches!(said(&mut model, 20.1).as_slice(), [ClientMessage::Hello(_)]));
    model.apply(hello(), 20.2);
    model.apply(ServerMessage::Scene { scene: Box::new(scene(1)) }, 20.2);
    let again = said(&mut model, 20.2);
    let camera = camera_of(&again).unwrap();
    assert_eq!(again.len(), 3, "{again:?}");
    assert!(camera.stamp > stamp);
    assert_eq!(model.viewpoint(), Some(&view));
}

#[test]
fn the_camera_of_the_command_line_is_the_first_view_or_an_error() {
    assert_eq!(open(Some("back")).viewpoint().unwrap().follows.as_deref(), Some("back"));
    let model = open(Some("side"));
    assert_eq!(model.viewpoint().unwrap().follows.as_deref(), Some("front"));
    assert!(model.notices.newest_error().unwrap().title.contains("side"));
}

#[test]
fn a_followed_camera_takes_the_view_along_and_its_end_leaves_it_there() {
    let mut model = open(None);
    let mut moved = scene(2);
    moved.cameras[0].world_from_camera[12] = 5.0;
    model.apply(ServerMessage::Scene { scene: Box::new(moved.clone()) }, 1.0);
    assert_eq!(model.viewpoint().unwrap().camera.position.x, 5.0);
    moved.revision = 3;
    moved.cameras.remove(0);
    model.apply(ServerMessage::Scene { scene: Box::new(moved) }, 2.0);
    assert_eq!(model.viewpoint().unwrap().follows, None);
    assert_eq!(model.viewpoint().unwrap().camera.position.x, 5.0);
}

#[test]
fn a_selection_falls_when_its_thing_is_gone() {
    let mut model = open(None);
    model.selected = Some(Selected::Light(Id::new("lamp").unwrap()));
    let mut dark = scene(2);
    model.apply(ServerMessage::Scene { scene: Box::new(dark.clone()) }, 1.0);
    assert!(model.selected.is_some());
    dark.lights.clear();
    model.apply(ServerMessage::Scene { scene: Box::new(dark) }, 2.0);
    assert_eq!(model.selected, None);
}

#[test]
fn an_edits_latency_is_measured_at_the_first_frame_that_shows_it() {
    let mut model = open(None);
    said(&mut model, 0.0);
    let constant = EnvironmentDescription::Constant { radiance: [1.0; 3] };
    model.edits.change(&scene(1), &Target::Environment, edits::Value::Environment(constant), 1.0);
    let messages = said(&mut model, 1.0);
    let [ClientMessage::Edit(request)] = messages.as_slice() else { panic!("{messages:?}") };
    model.apply(ServerMessage::Edited { request: request.request, revision: 2 }, 1.1);
    frame(1, 1, 1.15, &mut model);
    assert_eq!(model.edit_latencies.count(), 0, "still revision 1");
    let header = FrameHeader { revision: 2, ..model.frame.unwrap() };
    model.apply_header(&header, 1.25);
    assert!((model.edit_latencies.last_s().unwrap() - 0.25).abs() < 1e-9);
}

#[test]
fn settings_are_sent_newest_only_and_not_with_every_step_of_a_drag() {
    let mut model = open(None);
    said(&mut model, 0.0);
    let mut sent = vec![];
    for step in 1..=100 {
        let quality = Quality { exposure_ev: step as f32, codec: Codec::Jpeg, ..Quality::default() };
        model.set_quality(quality);
        sent.extend(said(&mut model, f64::from(step) * 0.01).into_iter().filter_map(|message| {
            if let ClientMessage::Quality(quality) = message { Some(quality.exposure_ev) } else { None }
        }));
    }
    assert!((8..=11).contains(&sent.len()), "{sent:?}");
    assert!(sent.is_sorted());
}

#[test]
fn a_server_that_speaks_another_protocol_is_not_asked_again() {
    let mut model = open(None);
    let ServerMessage::Hello(mut other) = hello() else { unreachable!() };
    other.protocol = "lumicast.v9".into();
    model.apply(ServerMessage::Hello(other), 1.0);
    assert!(matches!(model.link.state(), link::LinkState::Refused { .. }));
    assert!(!model.take_retry(1000.0));
}
