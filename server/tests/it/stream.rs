use crate::harness::{BOX, Heard, PATIENCE, Server, Viewer, harmless, in_time};
use futures_util::{SinkExt, StreamExt};
use lumicast_protocol::{FrameHeader, PayloadCodec, PayloadKind, ServerMessage};
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::Message;

const SMALL: [u16; 2] = [64, 48];

/// Hello, scene, and then pictures once there is a camera.
#[tokio::test]
async fn a_viewer_is_greeted_and_gets_the_picture_it_asks_for() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    let ServerMessage::Hello(hello) = viewer.message().await else { panic!("no hello") };
    assert_eq!((hello.protocol.as_str(), hello.revision), ("lumicast.v1", 1));
    let ServerMessage::Scene { scene } = viewer.message().await else { panic!("no scene") };
    assert_eq!(scene.cameras.len(), 2);
    let stamp = viewer.camera("main", SMALL).await;
    let (header, payload) = viewer.frame().await;
    assert_eq!((header.kind, header.codec), (PayloadKind::Frame, PayloadCodec::Jpeg));
    assert_eq!((header.camera_stamp, header.frame, header.full_size), (stamp, 1, SMALL));
    assert!(header.first_from_stamp && !header.converged && header.samples >= 1);
    let picture = image::load_from_memory(&payload).unwrap();
    assert_eq!((picture.width(), picture.height()), (header.size[0].into(), header.size[1].into()));
    // Only the first frame of a stamp says that it is.
    assert!(!viewer.frame().await.0.first_from_stamp);
    viewer.say(json!({"type": "ping", "stamp": 77})).await;
    viewer.message_where(|message| matches!(message, ServerMessage::Pong { stamp: 77 }).then_some(())).await;
    viewer.message_where(|message| matches!(message, ServerMessage::Stats(_)).then_some(())).await;
    server.stop().await;
}

/// The first picture is there long before anybody loses patience. The figure is printed, not judged.
#[tokio::test]
async fn the_first_picture_comes_quickly() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    let started = Instant::now();
    viewer.camera("main", [640, 360]).await;
    let (header, _) = viewer.frame().await;
    println!("first picture after {:?}, {:?} of {:?}", started.elapsed(), header.size, header.full_size);
    // It climbs to full size by itself.
    viewer.frame_where(|header| header.size == [640, 360]).await;
    server.stop().await;
}

/// Once the error is reached there is one lossless picture with the flag, and then silence and no work.
#[tokio::test]
async fn a_converged_picture_is_lossless_and_then_all_is_quiet() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "accuracy", "target_error": 0.5})).await;
    let stamp = viewer.camera("main", SMALL).await;
    let (header, payload) = viewer.frame_where(|header| header.converged).await;
    assert_eq!((header.codec, header.size, header.camera_stamp), (PayloadCodec::Png, SMALL, stamp));
    assert!(header.error.is_some_and(|error| error <= 0.5));
    assert!(payload.starts_with(b"\x89PNG"));
    // A ping's answer comes after everything that was on its way: no picture is among it.
    let passes = server.scenes.workshop().metrics.passes.value();
    for stamp in 0..20 {
        viewer.say(json!({"type": "ping", "stamp": stamp})).await;
        loop {
            match viewer.hear().await {
                Heard::Message(ServerMessage::Pong { stamp: back }) if back == stamp => break,
                Heard::Message(_) => {}
                other => panic!("{other:?} after the converged picture"),
            }
        }
    }
    assert_eq!(server.scenes.workshop().metrics.passes.value(), passes);
    // Another exposure is a new picture of the same film: sent again, lossless, without a new pass.
    viewer.say(json!({"type": "quality", "exposure_ev": 2})).await;
    let (again, brighter) = viewer.frame().await;
    assert!(again.converged && again.samples == header.samples);
    assert_ne!(brighter, payload);
    assert_eq!(server.scenes.workshop().metrics.passes.value(), passes);
    // A lower target takes up where the film was.
    let target = header.error.unwrap() / 1.5;
    viewer.say(json!({"type": "accuracy", "target_error": target})).await;
    let (better, _) = viewer.frame_where(|better| better.converged && better.samples > header.samples).await;
    assert!(better.error.unwrap() <= target);
    server.stop().await;
}

/// No more pictures a second than asked for, also while one is refined: load can only make them fewer.
#[tokio::test]
async fn pictures_keep_to_the_rate_asked_for() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "frames_per_second_max": 4})).await;
    viewer.say(json!({"type": "accuracy", "target_error": 0})).await;
    viewer.camera("main", SMALL).await;
    viewer.frame().await;
    let started = Instant::now();
    for _ in 0..6 {
        viewer.frame().await;
    }
    // Six pauses, but for what the first picture waited on its way.
    assert!(started.elapsed().as_secs_f64() > 5.0 / 4.0, "{:?}", started.elapsed());
    server.stop().await;
}

/// Float pictures are radiance, PNG ones are PNG, as asked for.
#[tokio::test]
async fn the_codec_is_the_one_asked_for() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "codec": "float"})).await;
    viewer.camera("main", SMALL).await;
    let (header, payload) = viewer.frame_where(|header| header.codec == PayloadCodec::Float).await;
    assert_eq!(payload.len(), usize::from(header.size[0]) * usize::from(header.size[1]) * 12);
    assert!(payload.as_chunks::<4>().0.iter().all(|bytes| f32::from_le_bytes(*bytes).is_finite()));
    viewer.say(json!({"type": "quality", "codec": "png"})).await;
    let (_, payload) = viewer.frame_where(|header| header.codec == PayloadCodec::Png).await;
    assert!(payload.starts_with(b"\x89PNG"));
    server.stop().await;
}

/// An edit's revision shows in the pictures, and in a new scene message, for every viewer.
#[tokio::test]
async fn an_edit_is_seen_in_the_pictures_of_all_viewers() {
    let server = Server::start(|_| {}).await;
    let mut near = server.viewer().await;
    let mut far = server.viewer().await;
    near.camera("main", SMALL).await;
    far.camera("corner", [48, 64]).await;
    near.frame().await;
    far.frame().await;
    for expected in 2..6 {
        let revision = server.edit(harmless(f64::from(expected))).await.revision();
        assert_eq!(revision, u64::from(expected as u32));
        for viewer in [&mut near, &mut far] {
            let (header, _) = viewer.frame_where(|header| header.revision >= revision).await;
            assert_eq!(header.revision, revision);
        }
    }
    // The description follows; quick changes may be told by one message.
    server.edit(harmless(0.3)).await.revision();
    near.message_where(|message| match message {
        ServerMessage::Scene { scene } if scene.revision == 6 => Some(()),
        _ => None,
    })
    .await;
    // An edit of a camera alone keeps the light, and is told all the same.
    let edit = json!([{"op": "set_camera", "camera": "other", "yfov_rad": 1}]);
    let revision = server.edit(edit).await.revision();
    near.frame_where(|header| header.revision == revision).await;
    server.stop().await;
}

/// The picture is of the new scene, not only labelled so: a black scene becomes bright.
#[tokio::test]
async fn the_pixels_change_with_the_edit() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "codec": "png", "tone_map": "linear"})).await;
    viewer.camera("main", SMALL).await;
    let off = json!([{"op": "set_material", "material": "lamp", "emission": [0, 0, 0]}]);
    let on = json!([{"op": "set_material", "material": "lamp", "emission": [300, 0, 0]}]);
    for (edit, is_red) in [(off.clone(), false), (on, true), (off, false)] {
        let revision = server.edit(edit).await.revision();
        let (_, payload) = viewer.frame_where(|header| header.revision == revision).await;
        let picture = image::load_from_memory(&payload).unwrap().into_rgb8();
        let red: u64 = picture.pixels().map(|pixel| u64::from(pixel.0[0])).sum();
        let blue: u64 = picture.pixels().map(|pixel| u64::from(pixel.0[2])).sum();
        assert_eq!((red > 100_000, blue), (is_red, 0), "red {red}");
    }
    server.stop().await;
}

/// Edits over the WebSocket are the edits of HTTP: same answers, same problems, same order.
#[tokio::test]
async fn edits_over_the_socket_are_edits() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "edit", "request": 1, "edits": harmless(0.1)})).await;
    assert_eq!(viewer.answer(1).await, Ok(2));
    viewer.say(json!({"type": "edit", "request": 2, "if_match": 1, "edits": harmless(0.1)})).await;
    let problem = viewer.answer(2).await.unwrap_err();
    assert_eq!((problem.status, problem.revision), (412, Some(2)));
    let bad = json!([{"op": "set_light", "light": "nobody"}]);
    viewer.say(json!({"type": "edit", "request": 3, "edits": bad})).await;
    let problem = viewer.answer(3).await.unwrap_err();
    assert_eq!((problem.status, problem.op.as_deref(), problem.op_index), (422, Some("set_light"), Some(0)));
    viewer.say(json!({"type": "edit", "request": 4, "edits": [{"op": "fly"}]})).await;
    assert_eq!(viewer.answer(4).await.unwrap_err().field.as_deref(), Some("op"));
    for request in 5..=6 {
        let key = "the same";
        viewer
            .say(json!({"type": "edit", "request": request, "idempotency_key": key, "edits": harmless(0.2)}))
            .await;
        assert_eq!(viewer.answer(request).await, Ok(3));
    }
    // Sent at once, answered in order.
    for request in 10..20 {
        viewer.say(json!({"type": "edit", "request": request, "edits": harmless(0.2)})).await;
    }
    for request in 10..20 {
        assert_eq!(viewer.answer(request).await, Ok(request - 6));
    }
    server.stop().await;
}

/// A thousand camera messages at once: the newest is drawn, the others need not be.
#[tokio::test]
async fn a_storm_of_cameras_is_answered_with_the_newest() {
    let server = Server::start(|config| config.messages_per_second = 10_000).await;
    let mut viewer = server.viewer().await;
    let mut last = 0;
    for n in 0..1000 {
        last = viewer.pose(f64::from(n) * 1e-3, SMALL).await;
    }
    let mut drawn = 0;
    loop {
        let (header, _) = viewer.frame().await;
        drawn += usize::from(header.first_from_stamp);
        if header.camera_stamp == last {
            assert!(header.first_from_stamp);
            break;
        }
    }
    assert!(drawn < 500, "{drawn} of 1000 cameras were drawn");
    server.stop().await;
}

/// Who looks on while another moves without a pause gets his picture in full size and more samples of it: none starves.
#[tokio::test]
async fn who_looks_on_is_drawn_for_while_another_moves() {
    let server = Server::start(|config| config.messages_per_second = 10_000).await;
    let mut mover = server.viewer().await;
    let mut onlooker = server.viewer().await;
    let is_over = Arc::new(AtomicBool::new(false));
    let moving = tokio::spawn({
        let is_over = Arc::clone(&is_over);
        async move {
            let mut frames = 0;
            for n in 0_u32.. {
                if is_over.load(Ordering::Relaxed) {
                    break;
                }
                mover.pose(0.1 * (f64::from(n) * 0.02).sin(), [320, 180]).await;
                while let Ok(heard) = tokio::time::timeout(Duration::from_millis(8), mover.hear()).await {
                    if let Heard::Frame(header, _) = heard {
                        frames += 1;
                        mover.acknowledge(header.frame).await;
                        break;
                    }
                }
            }
            frames
        }
    });
    let full = [160, 120];
    onlooker.camera("corner", full).await;
    onlooker.frame_where(|header| header.size == full && header.samples >= 4).await;
    is_over.store(true, Ordering::Relaxed);
    let frames = in_time(moving).await.unwrap();
    assert!(frames > 3, "the other goes on: {frames} pictures");
    server.stop().await;
}

/// Stamps come back growing, and a frame answers all stamps up to its own.
#[tokio::test]
async fn stamps_come_back_in_order() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    let mut seen = 0;
    for n in 0..20 {
        let stamp = viewer.pose(f64::from(n) * 0.01, SMALL).await;
        let (header, _) = viewer.frame_where(|header| header.camera_stamp >= stamp).await;
        assert!(header.camera_stamp > seen && header.first_from_stamp);
        seen = header.camera_stamp;
    }
    // The same pose under a new stamp is answered too.
    let again = viewer.pose(0.19, SMALL).await;
    viewer.frame_where(|header| header.camera_stamp == again && header.first_from_stamp).await;
    server.stop().await;
}

/// Who acknowledges nothing gets two pictures and no more; others do not notice, and an acknowledgement brings the
/// newest.
#[tokio::test]
async fn a_stalled_viewer_gets_two_pictures_and_slows_nobody() {
    let server = Server::start(|_| {}).await;
    let mut stalled = server.viewer().await;
    let mut lively = server.viewer().await;
    stalled.camera("main", SMALL).await;
    let mut frames = Vec::new();
    while frames.len() < 2 {
        if let Heard::Frame(header, _) = stalled.hear().await {
            frames.push(header.frame);
        }
    }
    lively.camera("main", SMALL).await;
    lively.frame().await;
    for n in 0..10 {
        let revision = server.edit(harmless(f64::from(n))).await.revision();
        lively.frame_where(|header| header.revision == revision).await;
        stalled.say(json!({"type": "ping", "stamp": n})).await;
        loop {
            match stalled.hear().await {
                Heard::Message(ServerMessage::Pong { stamp }) if stamp == n as u64 => break,
                Heard::Message(_) => {}
                other => panic!("{other:?} without room in flight"),
            }
        }
    }
    stalled.acknowledge(2).await;
    let (header, _) = stalled.frame_where(|header| header.revision == 11).await;
    assert!(header.frame <= 6, "old pictures were queued: {header:?}");
    server.stop().await;
}

/// A client that reads nothing at all stops nobody, not even with a picture stuck in its socket.
#[tokio::test]
async fn a_client_that_reads_nothing_stops_nobody() {
    let server = Server::start(|_| {}).await;
    let mut deaf = server.viewer().await;
    deaf.say(json!({"type": "quality", "codec": "float"})).await;
    deaf.camera("main", [1024, 1024]).await;
    let mut lively = server.viewer().await;
    lively.camera("corner", SMALL).await;
    for n in 0..5 {
        let revision = server.edit(harmless(f64::from(n))).await.revision();
        lively.frame_where(|header| header.revision == revision).await;
    }
    drop(deaf);
    in_time(async {
        while server.scenes.get("cornell-box").unwrap().viewer_count() > 1 {
            tokio::task::yield_now().await
        }
    })
    .await;
    server.stop().await;
}

/// What breaks the order of the protocol ends the connection with the documented code.
#[tokio::test]
async fn a_connection_ends_with_the_documented_code() {
    let server = Server::start(|config| {
        config.hello_seconds = 1;
        config.message_bytes = 10_000;
    })
    .await;
    let code = async |viewer: &mut Viewer| viewer.closed().await.map(|frame| u16::from(frame.code));
    let mut silent = Viewer::connect(server.address, "cornell-box").await;
    assert_eq!(code(&mut silent).await, Some(1008));
    let mut rude = Viewer::connect(server.address, "cornell-box").await;
    rude.camera("main", SMALL).await;
    assert_eq!(code(&mut rude).await, Some(1008));
    let mut loud = server.viewer().await;
    loud.socket.send(Message::text("x".repeat(20_000))).await.unwrap();
    assert_eq!(code(&mut loud).await, Some(1009));
    let mut deleted = server.viewer().await;
    deleted.camera("main", SMALL).await;
    deleted.frame().await;
    assert_eq!(server.request("DELETE", BOX, &[], "").await.status, 204);
    assert_eq!(code(&mut deleted).await, Some(1001));
    server.stop().await;
}

/// A flood is refused, then disconnected.
#[tokio::test]
async fn a_flood_is_refused_then_disconnected() {
    let server = Server::start(|config| config.messages_per_second = 20).await;
    let mut viewer = server.viewer().await;
    let mut refused = false;
    for n in 0..2000 {
        let quality = json!({"type": "quality", "exposure_ev": f64::from(n % 10)});
        // The server may have ended it already.
        if viewer.socket.send(Message::text(quality.to_string())).await.is_err() {
            break;
        }
    }
    let closed = loop {
        match viewer.hear().await {
            Heard::Message(ServerMessage::Error { problem, .. }) => refused |= problem.status == 429,
            Heard::Closed(frame) => break frame,
            _ => {}
        }
    };
    assert!(refused);
    assert!(closed.is_none_or(|frame| u16::from(frame.code) == 1008));
    server.stop().await;
}

/// Who looks through the octree, and through irradiance records with and without a bound on bounces, at one scene at once: all
/// get pictures that converge, an edit reaches them, and of the light before it nothing is left.
#[tokio::test]
async fn viewers_look_through_what_the_scene_learns() {
    let server = Server::start(|config| config.photons = 20_000).await;
    let mut viewers = Vec::new();
    for (technique, bounces) in [
        ("octree", json!(null)),
        ("irradiance", json!(null)),
        ("irradiance", json!(3)),
        ("irradiance", json!(1)),
    ] {
        let mut viewer = server.viewer().await;
        viewer.say(json!({"type": "quality", "codec": "png", "tone_map": "linear"})).await;
        viewer.say(json!({"type": "accuracy", "technique": technique, "bounces": bounces})).await;
        viewer.say(json!({"type": "camera", "stamp": 7, "size": SMALL, "camera": "main"})).await;
        viewers.push(viewer);
    }
    for viewer in &mut viewers {
        let (header, _) = viewer.frame_where(|header| header.camera_stamp == 7 && header.converged).await;
        assert!(header.error.is_some_and(|error| error > 0.0), "{:?}", header.error);
    }
    for (emission, is_lit) in [([300, 300, 0], true), ([0, 0, 0], false)] {
        let edit = json!([{"op": "set_material", "material": "lamp", "emission": emission}]);
        let revision = server.edit(edit).await.revision();
        for viewer in &mut viewers {
            let fits = |header: &FrameHeader| header.revision == revision && header.converged;
            let (_, payload) = viewer.frame_where(fits).await;
            let picture = image::load_from_memory(&payload).unwrap().into_rgb8();
            let sum = |channel: usize| picture.pixels().map(|p| u64::from(p.0[channel])).sum::<u64>();
            // The lamp was white at first: blue is of before the first edit, red of before the second.
            assert_eq!((sum(0) > 100_000, sum(2)), (is_lit, 0));
            assert!(is_lit || sum(0) == 0, "{}", sum(0));
        }
    }
    server.stop().await;
}

/// Effects are chosen by each viewer for itself: what one turned off is missing from its pictures alone, and comes back.
#[tokio::test]
async fn effects_are_chosen_by_each_viewer() {
    let server = Server::start(|config| config.photons = 20_000).await;
    let mut viewers = Vec::new();
    let off = json!({"caustics": "off", "indirect": "off"});
    let choices = [json!({}), off.clone(), json!({"indirect": "off"}), json!({"caustics": "on"})];
    for effects in &choices {
        let mut viewer = server.viewer().await;
        viewer.say(json!({"type": "quality", "codec": "png", "tone_map": "linear"})).await;
        viewer.say(asking_for(effects)).await;
        viewer.say(json!({"type": "camera", "stamp": 7, "size": SMALL, "camera": "main"})).await;
        viewers.push(viewer);
    }
    let mut sums = Vec::new();
    for viewer in &mut viewers {
        sums.push(brightness_at(viewer, 7).await);
    }
    let [all, none, focused, forced] = sums[..] else { panic!("four viewers") };
    assert!(none < 0.95 * focused && focused < 0.95 * all, "{sums:?}");
    assert!((forced / all - 1.0).abs() < 0.03, "{sums:?}");
    let [first, second, ..] = &mut viewers[..] else { panic!("four viewers") };
    for (viewer, effects, expected) in [(first, off, none), (second, json!({}), all)] {
        viewer.say(asking_for(&effects)).await;
        viewer.say(json!({"type": "camera", "stamp": 8, "size": SMALL, "camera": "main"})).await;
        let sum = brightness_at(viewer, 8).await;
        assert!((sum / expected - 1.0).abs() < 0.03, "{sum} for {expected}");
    }
    server.stop().await;
}

fn asking_for(effects: &serde_json::Value) -> serde_json::Value {
    json!({"type": "accuracy", "target_error": 0.1, "technique": "irradiance", "effects": effects})
}

/// Sum over a converged picture drawn for this stamp.
async fn brightness_at(viewer: &mut Viewer, stamp: u64) -> f64 {
    let (_, payload) = viewer.frame_where(|header| header.camera_stamp == stamp && header.converged).await;
    let picture = image::load_from_memory(&payload).unwrap().into_rgb8();
    picture.pixels().flat_map(|pixel| pixel.0).map(f64::from).sum()
}

/// Refusals that keep the connection: unknown camera, bad pose, a frame never sent, a technique not there yet.
#[tokio::test]
async fn a_refused_message_changes_nothing() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    let zero = json!([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
    for (message, status, field) in [
        (json!({"type": "camera", "stamp": 1, "size": SMALL, "camera": "nobody"}), 404, "camera"),
        (
            json!({"type": "camera", "stamp": 1, "size": SMALL, "pose": {"matrix": zero, "yfov_rad": 1}}),
            422,
            "pose.matrix",
        ),
        (json!({"type": "camera", "stamp": 1, "size": [0, 1], "camera": "main"}), 422, "size"),
        (json!({"type": "ack", "frame": 9}), 422, "frame"),
        (json!({"type": "accuracy", "technique": "lightmap"}), 422, "technique"),
        (json!({"type": "accuracy", "effects": {"glass": "off"}}), 400, "effects.glass"),
        (json!({"type": "quality", "jpeg_quality": 0}), 422, "jpeg_quality"),
        (json!({"type": "hello", "client": "again", "version": "1"}), 400, ""),
        (json!({"type": "dance"}), 400, ""),
    ] {
        viewer.say(message.clone()).await;
        let problem = viewer
            .message_where(|message| match message {
                ServerMessage::Error { problem, .. } => Some(problem),
                _ => None,
            })
            .await;
        assert_eq!(
            (problem.status, problem.field.unwrap_or_default()),
            (status, field.to_string()),
            "{message}"
        );
    }
    viewer.socket.send(Message::text("not JSON")).await.unwrap();
    viewer.socket.send(Message::binary(vec![1, 2, 3])).await.unwrap();
    viewer.camera("main", SMALL).await;
    viewer.frame().await;
    server.stop().await;
}

/// Who watches through a camera of the scene follows it when it is edited, and keeps the last pose when it goes.
#[tokio::test]
async fn a_viewer_follows_its_camera() {
    let server = Server::start(|config| config.samples_max = 4).await;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "quality", "codec": "png"})).await;
    viewer.say(json!({"type": "accuracy", "technique": "path", "preset": "converged"})).await;
    viewer.camera("main", SMALL).await;
    let (_, before) = viewer.frame_where(|header| header.converged).await;
    let look = json!({"position": [0, 1, 2], "target": [1, 1, 0]});
    let revision = server
        .edit(json!([{"op": "set_camera", "camera": "main", "look_at": look, "yfov_rad": 1}]))
        .await
        .revision();
    let (_, moved) = viewer.frame_where(|header| header.converged && header.revision == revision).await;
    assert_ne!(before, moved);
    let revision = server.edit(json!([{"op": "remove_camera", "camera": "main"}])).await.revision();
    let (_, kept) = viewer.frame_where(|header| header.converged && header.revision == revision).await;
    assert_eq!(kept, moved);
    server.stop().await;
}

/// Without the subprotocol, from a strange origin, on no scene, into a full one: no upgrade, but a problem.
#[tokio::test]
async fn an_upgrade_is_refused_with_a_problem() {
    let server = Server::start(|config| config.viewers_per_scene = 1).await;
    let attempt = async |scene: &str, headers: &[(&'static str, &str)]| {
        let url = format!("ws://{}/v1/scenes/{scene}/ws", server.address);
        let mut request = url.into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, value.parse().unwrap());
        }
        match in_time(tokio_tungstenite::connect_async(request)).await {
            Err(tokio_tungstenite::tungstenite::Error::Http(response)) => response.status().as_u16(),
            other => panic!("{:?}", other.map(|_| "connected")),
        }
    };
    let ours = ("sec-websocket-protocol", "lumicast.v1");
    assert_eq!(attempt("cornell-box", &[]).await, 400);
    assert_eq!(attempt("cornell-box", &[("sec-websocket-protocol", "chat")]).await, 400);
    assert_eq!(attempt("cornell-box", &[ours, ("origin", "http://evil.example")]).await, 400);
    assert_eq!(attempt("nowhere", &[ours]).await, 404);
    let viewer = server.viewer().await;
    assert_eq!(attempt("cornell-box", &[ours]).await, 429);
    drop(viewer);
    server.get(&format!("{BOX}/ws")).await.problem(400);
    server.stop().await;
}

/// Stopping tells the viewers, answers what was asked and ends in time.
#[tokio::test]
async fn stopping_says_goodbye() {
    let server = Server::start(|_| {}).await;
    let mut viewer = server.viewer().await;
    viewer.camera("main", [640, 360]).await;
    viewer.frame().await;
    let started = Instant::now();
    server.stopper.stop();
    let frame = viewer.closed().await.expect("no close frame");
    assert_eq!(u16::from(frame.code), 1001);
    server.stop().await;
    assert!(started.elapsed() < PATIENCE / 4);
    assert!(viewer.socket.next().await.is_none_or(|end| end.is_err()));
}

/// Two viewers at different cameras share the scene, each with its own film, size and stamps; the curve is told.
#[tokio::test]
async fn two_viewers_share_the_scene() {
    let server = Server::start(|_| {}).await;
    let mut a = server.viewer().await;
    let mut b = server.viewer().await;
    a.say(json!({"type": "accuracy", "target_error": 0.8})).await;
    b.say(json!({"type": "accuracy", "target_error": 0.8})).await;
    a.camera("main", SMALL).await;
    b.camera("corner", [48, 32]).await;
    let (of_a, picture_a) = a.frame_where(|header| header.converged).await;
    let (of_b, picture_b) = b.frame_where(|header| header.converged).await;
    assert_eq!((of_a.full_size, of_b.full_size), (SMALL, [48, 32]));
    assert_ne!(picture_a, picture_b);
    let curve = server.get(&format!("{BOX}/convergence")).await.json();
    let points = curve["points"].as_array().unwrap();
    assert!(points.len() >= 2 && points.last().unwrap()["error"].as_f64().unwrap() <= 0.8, "{curve}");
    server.get(&format!("{BOX}/convergence?viewer=999")).await.problem(404);
    server.stop().await;
}
