//! The window's widgets, found by their accessible names, against a network of this process. No display, no GPU.

// The helpers of a test file count as code; in a test a panic is the message.
#![allow(clippy::unwrap_used)]

use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use lumicast_protocol::{
    CameraDescription, ClientMessage, Counts, Edit, EffectChoice, EffectChoices, EnvironmentDescription,
    Forecast, ForecastRecord, ForecastWhen, FrameHeader, Id, LightDescription, LightSource, Limits,
    MaterialDescription, MaterialProperties, PayloadCodec, PayloadKind, Problem, ProblemKind, Projection,
    SUBPROTOCOL, SceneDescription, SceneId, ServerHello, ServerMessage, Stats, Technique, View, Warning,
};
use lumicast_viewer::app::{App, Options};
use lumicast_viewer::model::Selected;
use lumicast_viewer::net::{Network, Wake, Wire, WireEvent};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::mpsc::Receiver;

/// A server in this process: what the viewer said, what it is to hear.
#[derive(Clone, Default)]
struct FakeServer {
    said: Rc<RefCell<Vec<ClientMessage>>>,
    to_hear: Rc<RefCell<VecDeque<WireEvent>>>,
    opened: Rc<RefCell<Vec<String>>>,
    scenes: Rc<RefCell<String>>,
    now_s: Rc<Cell<f64>>,
}

struct FakeWire(FakeServer);

impl Wire for FakeWire {
    fn poll(&mut self) -> Option<WireEvent> {
        self.0.to_hear.borrow_mut().pop_front()
    }
    fn has_room(&self) -> bool {
        true
    }
    fn send(&mut self, text: String) {
        let message = ClientMessage::from_json(&text).unwrap();
        Limits::default().check(&message).unwrap();
        self.0.said.borrow_mut().push(message);
    }
}

impl Network for FakeServer {
    fn open(&self, url: &str, _wake: Wake) -> Box<dyn Wire> {
        self.opened.borrow_mut().push(url.to_owned());
        Box::new(FakeWire(self.clone()))
    }
    fn get(&self, url: &str, _wake: Wake) -> Receiver<Result<String, String>> {
        let (sender, receiver) = std::sync::mpsc::channel();
        let answer = match url {
            url if url.ends_with("/v1/scenes") => Ok(self.scenes.borrow().clone()),
            url if url.ends_with("/effects") => Ok(EFFECTS.into()),
            _ => Err("not here".to_owned()),
        };
        sender.send(answer).unwrap();
        receiver
    }
}

const EFFECTS: &str = r#"{"revision": 1, "effects": [
    {"effect": "glass", "on": false, "reason": "no placed material lets light through"},
    {"effect": "caustics", "on": true, "reason": "photons are aimed at mirrors"},
    {"effect": "indirect", "on": true, "reason": "surfaces can light each other"}]}"#;

impl FakeServer {
    fn of_one_scene() -> Self {
        let server = Self::default();
        let list = r#"{"scenes":[{"id":"cornell-box","name":"Cornell box","revision":1,"durable":false,"triangles":36,"viewers":0}]}"#;
        *server.scenes.borrow_mut() = list.into();
        server
    }

    fn window(&self, options: Options) -> Harness<'static, App> {
        let (server, clock) = (self.clone(), self.now_s.clone());
        let mut window =
            Harness::builder().with_size([1400.0, 1000.0]).with_max_steps(30).build_eframe(move |cc| {
                App::new(&cc.egui_ctx, options, Box::new(server), Box::new(move || clock.get()), 42)
            });
        window.run_steps(3);
        window
    }

    /// A window that watches the Cornell box and has a picture of it.
    fn watched(&self) -> Harness<'static, App> {
        let mut window = self.window(Options::default());
        assert_eq!(*self.opened.borrow(), ["ws://127.0.0.1:7171/v1/scenes/cornell-box/ws"]);
        self.hear_hello(&mut window);
        self.hear_event(&mut window, WireEvent::from_binary(&picture(1)));
        window
    }

    fn hear_hello(&self, window: &mut Harness<'_, App>) {
        self.hear_event(window, WireEvent::Opened);
        self.hear(window, &ServerMessage::Hello(hello()));
        self.hear(window, &ServerMessage::Scene { scene: Box::new(scene(1)) });
    }

    fn hear(&self, window: &mut Harness<'_, App>, message: &ServerMessage) {
        self.hear_event(window, WireEvent::Text(message.to_json()));
    }

    fn hear_event(&self, window: &mut Harness<'_, App>, event: WireEvent) {
        self.to_hear.borrow_mut().push_back(event);
        self.step(window);
    }

    /// Some frames later.
    fn step(&self, window: &mut Harness<'_, App>) {
        for _ in 0..4 {
            self.now_s.set(self.now_s.get() + 0.05);
            window.step();
        }
        window.check_accessibility();
    }

    fn edits(&self) -> Vec<(u64, Vec<Edit>)> {
        let said = self.said.borrow();
        said.iter()
            .filter_map(|message| match message {
                ClientMessage::Edit(request) => Some((request.request, request.edits.clone())),
                _ => None,
            })
            .collect()
    }

    fn last_view(&self) -> Option<View> {
        let said = self.said.borrow();
        said.iter().rev().find_map(|message| match message {
            ClientMessage::Camera(camera) => Some(camera.view.clone()),
            _ => None,
        })
    }
}

fn id(text: &str) -> Id {
    Id::new(text).unwrap()
}

fn hello() -> ServerHello {
    ServerHello {
        protocol: SUBPROTOCOL.into(),
        version: "0.1.0".into(),
        scene: SceneId::new("cornell-box").unwrap(),
        revision: 1,
        viewer: 1,
        limits: Limits::default(),
    }
}

fn scene(revision: u64) -> SceneDescription {
    let camera = |name: &str, towards: f64| CameraDescription {
        id: id(name),
        parent: None,
        // Both look at the middle, one from before, one from behind.
        world_from_camera: [
            towards,
            0.,
            0.,
            0.,
            0.,
            1.,
            0.,
            0.,
            0.,
            0.,
            towards,
            0.,
            0.,
            1.,
            3.5 * towards,
            1.,
        ],
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
        warnings: vec![Warning { object: "mesh \"box\"".into(), message: "2 triangles have no area".into() }],
        nodes: vec![lumicast_protocol::NodeDescription {
            id: id("tall block"),
            parent: None,
            transform: lumicast_protocol::Transform::IDENTITY,
            mesh: None,
        }],
        meshes: vec![],
        materials: vec![MaterialDescription {
            id: id("white"),
            properties: MaterialProperties::default(),
            textures: vec![],
        }],
        lights: vec![LightDescription {
            id: id("lamp"),
            parent: None,
            source: LightSource::Point { intensity: [10.0; 3], position: [0.0, 1.8, 0.0] },
        }],
        cameras: vec![camera("front", 1.0), camera("back", -1.0)],
        environment: EnvironmentDescription::None,
    }
}

fn picture(frame: u64) -> Vec<u8> {
    let header = FrameHeader {
        kind: PayloadKind::Frame,
        codec: PayloadCodec::Png,
        converged: false,
        first_from_stamp: true,
        revision: 1,
        frame,
        camera_stamp: 1,
        size: [4, 3],
        full_size: [4, 3],
        offset: [0, 0],
        error: Some(0.25),
        samples: 4,
        age_us: 1000,
    };
    let mut png = std::io::Cursor::new(vec![]);
    image::RgbImage::from_pixel(4, 3, image::Rgb([200, 30, 20]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    header.message(&png.into_inner()).unwrap()
}

#[test]
fn a_server_with_one_scene_is_watched_without_a_question() {
    let server = FakeServer::of_one_scene();
    let window = server.watched();
    window.get_by_label("connected");
    assert!(window.query_by_label("Connect to a Lumicast server").is_none());
    assert!(server.said.borrow().contains(&ClientMessage::Ack { frame: 1 }));
    assert_eq!(server.last_view(), Some(View::Camera(id("front"))));
}

#[test]
fn of_several_scenes_a_person_chooses_one() {
    let server = FakeServer::default();
    let scene = |id: &str| {
        format!(
            r#"{{"id":"{id}","name":"The {id}","revision":1,"durable":true,"triangles":66450,"viewers":0}}"#
        )
    };
    *server.scenes.borrow_mut() = format!(r#"{{"scenes":[{},{}]}}"#, scene("atrium"), scene("cellar"));
    let mut window = server.window(Options::default());
    window.get_by_label("Connect to a Lumicast server");
    assert!(server.opened.borrow().is_empty());
    window.get_by_label_contains("The cellar").click();
    server.step(&mut window);
    assert_eq!(*server.opened.borrow(), ["ws://127.0.0.1:7171/v1/scenes/cellar/ws"]);
    assert!(window.query_by_label("Connect to a Lumicast server").is_none());
}

#[test]
fn a_wrong_address_is_told_in_the_dialog_and_can_be_mended() {
    let server = FakeServer::of_one_scene();
    let mut window = server.window(Options { server: Some("gopher://x".into()), ..Options::default() });
    window.get_by_label_contains("gopher:// is not spoken here");
    let field = window.get_by_role_and_label(egui::accesskit::Role::TextInput, "Address");
    field.focus();
    window.run_steps(2);
    window.key_combination_modifiers(Modifiers::COMMAND, &[Key::A]);
    window.get_by_role_and_label(egui::accesskit::Role::TextInput, "Address").type_text("example.org");
    window.run_steps(2);
    window.get_by_label("Connect").click();
    server.step(&mut window);
    assert_eq!(*server.opened.borrow(), ["ws://example.org:7171/v1/scenes/cornell-box/ws"]);
}

#[test]
fn what_is_no_lumicast_server_is_said_so() {
    let server = FakeServer::default();
    *server.scenes.borrow_mut() = "<html>hello</html>".into();
    let window = server.window(Options::default());
    window.get_by_label_contains("this is no Lumicast server");
}

#[test]
fn editing_a_light_sends_exactly_that_and_shows_the_revision() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("lamp").click();
    server.step(&mut window);
    assert_eq!(window.state().model.selected, Some(Selected::Light(id("lamp"))));
    window.get_by_role_and_label(egui::accesskit::Role::SpinButton, "Intensity").increment_accesskit();
    server.step(&mut window);
    let edits = server.edits();
    let [(request, batch)] = edits.as_slice() else { panic!("{edits:?}") };
    let [Edit::SetLight(edit)] = batch.as_slice() else { panic!("{batch:?}") };
    assert_eq!(edit.light, id("lamp"));
    assert!(edit.intensity.unwrap()[0] > 10.0);
    assert_eq!((edit.position, edit.direction), (None, None), "only what changed");
    window.get_by_label("sending …");
    server.hear(&mut window, &ServerMessage::Edited { request: *request, revision: 2 });
    window.get_by_label("last edit made revision 2");
}

#[test]
fn a_refused_edit_says_why_at_its_editor_and_goes_back() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("lamp").click();
    server.step(&mut window);
    window.get_by_role_and_label(egui::accesskit::Role::SpinButton, "Intensity").increment_accesskit();
    server.step(&mut window);
    let mut problem = Problem::new(ProblemKind::EditRefused, "the lamp is too bright");
    (problem.op, problem.op_index, problem.field) =
        (Some("set_light".into()), Some(0), Some("intensity".into()));
    server.hear(&mut window, &ServerMessage::Error { problem, request: Some(server.edits()[0].0) });
    window.get_by_label("Refused: intensity");
    window.get_by_label("the lamp is too bright");
    let shown = window.get_by_role_and_label(egui::accesskit::Role::SpinButton, "Intensity");
    assert_eq!(shown.accesskit_node().numeric_value(), Some(10.0));
}

#[test]
fn a_material_and_a_transform_are_edited_and_undone() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("white").click();
    server.step(&mut window);
    window.get_by_role_and_label(egui::accesskit::Role::Slider, "Metallic").set_value_accesskit(1.0);
    server.step(&mut window);
    let edits = server.edits();
    let [(request, batch)] = edits.as_slice() else { panic!("{edits:?}") };
    let json = serde_json::to_string(batch).unwrap();
    assert_eq!(json, r#"[{"op":"set_material","material":"white","metallic":1.0}]"#);
    server.hear(&mut window, &ServerMessage::Edited { request: *request, revision: 2 });
    window.get_by_label("Undo").click();
    server.step(&mut window);
    let json = serde_json::to_string(&server.edits()[1].1).unwrap();
    assert_eq!(json, r#"[{"op":"set_material","material":"white","metallic":0.0}]"#);
    server.hear(&mut window, &ServerMessage::Edited { request: server.edits()[1].0, revision: 3 });
    window.get_by_label("tall block").click();
    server.step(&mut window);
    window.get_by_label("Translation y").increment_accesskit();
    server.step(&mut window);
    assert!(matches!(&server.edits()[2].1[..], [Edit::SetTransform(edit)] if edit.node == id("tall block")));
}

#[test]
fn a_click_on_a_camera_goes_there_and_a_drag_makes_the_view_ones_own() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("back").click();
    server.step(&mut window);
    assert_eq!(server.last_view(), Some(View::Camera(id("back"))));
    let middle = window.get_by_label("picture").rect().center();
    window.drag_at(middle);
    server.step(&mut window);
    window.hover_at(middle + egui::vec2(120.0, 0.0));
    server.step(&mut window);
    let Some(View::Pose(pose)) = server.last_view() else { panic!("{:?}", server.last_view()) };
    assert!(pose.world_from_camera[12] > 0.1, "from behind, the eye goes to its own left: +x");
}

#[test]
fn a_new_light_is_sent_and_selected_once_the_server_has_it() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("Add").click();
    server.step(&mut window);
    window.get_by_label("Spot light").click();
    server.step(&mut window);
    let edits = server.edits();
    let [(request, batch)] = edits.as_slice() else { panic!("{edits:?}") };
    let [Edit::AddLight(edit)] = batch.as_slice() else { panic!("{batch:?}") };
    server.hear(&mut window, &ServerMessage::Edited { request: *request, revision: 2 });
    let mut with_spot = scene(2);
    with_spot.lights.push(LightDescription { id: edit.light.clone(), parent: None, source: edit.source });
    server.hear(&mut window, &ServerMessage::Scene { scene: Box::new(with_spot) });
    assert_eq!(window.state().model.selected, Some(Selected::Light(edit.light.clone())));
    window.get_by_label("Outer angle");
}

#[test]
fn a_lost_connection_is_shown_keeps_the_picture_and_comes_back_by_itself() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    let lost = WireEvent::Closed { reason: "the server stops (1001)".into(), is_final: false };
    server.hear_event(&mut window, lost);
    window.get_by_label("Connection lost");
    window.get_by_label_contains("the server stops");
    assert!(window.state().model.frame.is_some());
    server.now_s.set(server.now_s.get() + 1.0);
    server.step(&mut window);
    window.get_by_label("Reconnecting …");
    assert_eq!(server.opened.borrow().len(), 2);
    server.said.borrow_mut().clear();
    server.hear_hello(&mut window);
    assert!(window.query_by_label("Reconnecting …").is_none());
    assert!(matches!(server.said.borrow()[0], ClientMessage::Hello(_)));
    assert_eq!(server.last_view(), Some(View::Camera(id("front"))));
}

#[test]
fn a_scene_that_is_gone_is_not_asked_for_again() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    let gone = WireEvent::Closed {
        reason: "There is no such thing: no scene \"cornell-box\"".into(),
        is_final: true,
    };
    server.hear_event(&mut window, gone);
    window.get_by_label("The server refused the connection");
    server.now_s.set(server.now_s.get() + 100.0);
    server.step(&mut window);
    assert_eq!(server.opened.borrow().len(), 1);
    window.get_by_label("Other scene …").click();
    server.step(&mut window);
    window.get_by_label("Connect to a Lumicast server");
}

#[test]
fn errors_and_hostile_messages_are_a_banner_and_the_viewer_lives() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    let problem = Problem::new(ProblemKind::TooMany, "slow down");
    server.hear(&mut window, &ServerMessage::Error { problem, request: None });
    window.get_by_label("slow down");
    window.get_by_label("Dismiss").click();
    server.step(&mut window);
    assert!(window.query_by_label("Dismiss").is_none());
    let mut broken = picture(2);
    let length = broken.len();
    broken[length - 30..].fill(0xff);
    for hostile in [b"LCF1".to_vec(), vec![0; 64], broken] {
        server.hear_event(&mut window, WireEvent::from_binary(&hostile));
        window.get_by_label("A picture cannot be shown");
        window.get_by_label("Dismiss").click();
        server.step(&mut window);
        // Past the time in which a dismissed banner stays away.
        server.now_s.set(server.now_s.get() + 6.0);
    }
    assert!(
        server.said.borrow().contains(&ClientMessage::Ack { frame: 2 }),
        "what was refused is acknowledged too"
    );
    server.hear_event(&mut window, WireEvent::Text("{".into()));
    window.get_by_label("The server sent a message that cannot be read");
    server.hear_event(&mut window, WireEvent::from_binary(&picture(3)));
    assert_eq!(window.state().model.frame.unwrap().frame, 3);
}

#[test]
fn the_plot_and_the_numbers_show_what_the_server_measured() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    for step in 1..=20 {
        let error = 1.0 / step as f32;
        let stats = Stats {
            revision: 1,
            camera_stamp: 1,
            samples: step * 4,
            error: Some(error),
            error_ci: Some([error * 0.9, error * 1.1]),
            seconds: step as f64 * 0.5,
            rays_per_second: 2.4e6,
            samples_per_second: 4e5,
            frames_sent: step,
            frames_skipped: 2,
            in_flight: 1,
            technique: Technique::Path,
            film_size: [640, 360],
            scale: 0.5,
            forecast: vec![
                Forecast {
                    error: 0.1,
                    when: ForecastWhen::Reached,
                    seconds: Some(2.0),
                    between: None,
                    figure: None,
                },
                Forecast {
                    error: 0.02,
                    when: ForecastWhen::In,
                    seconds: Some(40.0),
                    between: Some([15.0, 90.0]),
                    figure: None,
                },
            ],
            forecast_record: ForecastRecord { judged: 12, right: 9, decided: 11, held: 10 },
        };
        server.hear(&mut window, &ServerMessage::Stats(stats));
    }
    window.get_by_label("error over time, 20 points");
    window.get_by_label("5.00 %  (4.50 – 5.50 %)");
    window.get_by_label("2.40 M/s");
    window.get_by_label("640 × 360  (scaled 50 %)");
    window.get_by_label("20 sent, 2 skipped");
    window.get_by_label("since 2 s");
    window.get_by_label("in about 40 s (15 to 90 s)");
    window.get_by_label("10 of 11");
    window.get_by_label("9 of 12");
}

#[test]
fn warnings_of_the_scene_are_listed() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("Messages (1)").click();
    window.run_steps(20);
    window.get_by_label("2 triangles have no area");
}

#[test]
fn exposure_target_and_search_do_what_they_say() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_role_and_label(egui::accesskit::Role::Slider, "Exposure").set_value_accesskit(2.0);
    window.get_by_role_and_label(egui::accesskit::Role::Slider, "Target error").set_value_accesskit(5.0);
    server.step(&mut window);
    server.step(&mut window);
    let said = server.said.borrow().clone();
    assert!(said.iter().any(|m| matches!(m, ClientMessage::Quality(quality) if quality.exposure_ev == 2.0)));
    let near = |error: f32| (error - 0.05).abs() < 1e-6;
    assert!(
        said.iter().any(|m| matches!(m, ClientMessage::Accuracy(accuracy) if near(accuracy.target_error)))
    );
    window.get_by_role(egui::accesskit::Role::TextInput).focus();
    window.run_steps(2);
    window.get_by_role(egui::accesskit::Role::TextInput).type_text("LAM");
    server.step(&mut window);
    window.get_by_label("lamp");
    assert!(window.query_by_label("white").is_none());
}

/// The effects say why they are on; those that can be chosen are chosen for this viewer.
#[test]
fn effects_explain_themselves_and_can_be_chosen() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.get_by_label("Effects").click();
    server.step(&mut window);
    window.get_by_label("no placed material lets light through");
    let choices = || window.query_all_by_role(egui::accesskit::Role::ComboBox);
    let chosen: Vec<_> =
        choices().filter(|node| node.value().as_deref() == Some("As the scene needs")).collect();
    assert_eq!(chosen.len(), 2, "caustics and indirect can be chosen, glass cannot");
    chosen[0].click();
    server.step(&mut window);
    window.get_by_label("Never").click();
    server.step(&mut window);
    server.step(&mut window);
    let said = server.said.borrow();
    let last = said.iter().rev().find_map(|message| match message {
        ClientMessage::Accuracy(accuracy) => Some(accuracy.effects),
        _ => None,
    });
    assert_eq!(last, Some(EffectChoices { caustics: EffectChoice::Off, ..EffectChoices::default() }));
}

#[test]
fn keys_open_the_help_hide_the_panels_and_show_the_scene() {
    let server = FakeServer::of_one_scene();
    let mut window = server.watched();
    window.key_press(Key::F1);
    server.step(&mut window);
    window.get_by_label("orbit about the focus");
    window.key_press(Key::Escape);
    server.step(&mut window);
    assert!(window.query_by_label("orbit about the focus").is_none());
    window.key_press(Key::Home);
    server.step(&mut window);
    assert!(matches!(server.last_view(), Some(View::Pose(_))));
    window.key_press(Key::Num2);
    server.step(&mut window);
    assert_eq!(server.last_view(), Some(View::Camera(id("back"))));
    window.key_press(Key::Tab);
    server.step(&mut window);
    assert!(window.query_by_label("Show all").is_none());
}
