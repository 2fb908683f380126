use crate::harness::{BOX, Server, harmless, in_time};
use base64::Engine;
use http_body_util::BodyExt;
use hyper::body::Bytes;
use hyper_util::rt::TokioIo;
use lumicast_protocol::SceneId;
use serde_json::json;
use tokio::net::TcpStream;

/// Everything that is no resource is a problem, not a bare status.
#[tokio::test]
async fn unknown_routes_methods_and_scenes_are_problems() {
    let server = Server::start(|_| {}).await;
    for path in
        ["/nothing", "/v1", "/v1/scenes/", "/v1/scenes/none", "/v1/scenes/none/frame", "/v1/scenes/%00"]
    {
        server.get(path).await.problem(404);
    }
    server.get("/v1/scenes/%ff").await.problem(400);
    server.post("/v1/scenes?colour=red", "{}").await.problem(400);
    for (method, path) in [("PUT", "/v1/scenes"), ("PATCH", BOX), ("DELETE", "/healthz"), ("POST", "/")] {
        let reply = server.request(method, path, &[], "").await;
        reply.problem(405);
        assert!(!reply.header("allow").is_empty());
    }
    server.stop().await;
}

/// The small resources answer.
#[tokio::test]
async fn health_metrics_page_and_document_answer() {
    let server = Server::start(|_| {}).await;
    assert_eq!(server.get("/healthz").await.text(), "ok\n");
    assert_eq!(server.get("/readyz").await.text(), "ready\n");
    let metrics = server.get("/metrics").await;
    assert!(metrics.header("content-type").starts_with("text/plain; version=0.0.4"));
    assert!(metrics.text().contains("lumicast_scene_revision{scene=\"cornell-box\"} 1"));
    let page = server.get("/").await;
    assert!(page.header("content-type").starts_with("text/html"));
    // Self-contained: nothing is loaded from elsewhere.
    let text = page.text();
    assert!(!text.contains("http://") && !text.contains("https://") && !text.contains(" src="));
    assert!(page.header("content-security-policy").contains("default-src 'none'"));
    assert_eq!(server.get("/openapi.json").await.json()["info"]["title"], "Lumicast");
    server.stop().await;
}

/// A scene is made of a file or a built-in one, listed, told, and deleted.
#[tokio::test]
async fn scenes_come_and_go() {
    let server = Server::start(|config| config.scenes = 3).await;
    let glb = server.get(&format!("{BOX}/export.glb")).await.body;
    let headers = [("content-type", "model/gltf-binary")];
    let made = server.request("POST", "/v1/scenes?name=My%20Room", &headers, glb.clone()).await;
    assert_eq!((made.status.as_u16(), made.header("location")), (201, "/v1/scenes/My-Room"));
    assert_eq!(made.json()["name"], "My Room");
    server.request("POST", "/v1/scenes?name=My%20Room", &headers, glb.clone()).await.problem(409);
    let data = base64::engine::general_purpose::STANDARD.encode(&glb);
    let made = server.post("/v1/scenes", json!({"name": "x", "id": "y", "data": data}).to_string()).await;
    assert_eq!(made.header("location"), "/v1/scenes/y");
    server.post("/v1/scenes", json!({"builtin": "cornell-box", "id": "z"}).to_string()).await.problem(429);
    let triangles = |scene: &serde_json::Value| scene["triangles"].clone();
    let list = server.get("/v1/scenes").await.json();
    let scenes = list["scenes"].as_array().unwrap();
    assert_eq!(scenes.len(), 3);
    assert!(scenes.iter().all(|scene| triangles(scene) == triangles(&scenes[0])), "{list}");
    assert_eq!(server.request("DELETE", "/v1/scenes/y", &[], "").await.status, 204);
    server.request("DELETE", "/v1/scenes/y", &[], "").await.problem(404);
    server.get("/v1/scenes/y").await.problem(404);
    let made = server.post("/v1/scenes", json!({"builtin": "cornell-box", "id": "z"}).to_string()).await;
    assert_eq!(made.status, 201);
    server.stop().await;
}

/// Whatever is sent as a scene, the answer is a problem and the server goes on.
#[tokio::test]
async fn a_bad_scene_is_refused_with_its_reason() {
    let server = Server::start(|config| config.body_bytes = 100_000).await;
    let long = "x".repeat(200);
    for (body, status) in [
        ("".to_string(), 400),
        ("{}".to_string(), 400),
        (json!({"builtin": "castle"}).to_string(), 404),
        (json!({"builtin": "cornell-box", "data": ""}).to_string(), 400),
        (json!({"data": "***"}).to_string(), 400),
        (json!({"data": "AAAA"}).to_string(), 422),
        (json!({"builtin": "cornell-box", "id": "../x"}).to_string(), 422),
        (json!({"builtin": "cornell-box", "id": "x", "name": long}).to_string(), 422),
        (json!({"builtin": "cornell-box", "colour": "red"}).to_string(), 400),
        ("glTF but not really".to_string(), 422),
        ("[".repeat(100_001), 413),
        ("[".repeat(50_000), 400),
    ] {
        server.post("/v1/scenes", body).await.problem(status);
    }
    server.request("POST", "/v1/scenes", &[("content-type", "text/plain")], "hello").await.problem(415);
    assert_eq!(server.get("/v1/scenes").await.json()["scenes"].as_array().unwrap().len(), 1);
    server.stop().await;
}

/// One picture in each format, of the size asked for, of the newest revision.
#[tokio::test]
async fn a_picture_can_be_asked_for() {
    let server = Server::start(|_| {}).await;
    let revision = server.edit(harmless(0.5)).await.revision();
    for (format, content_type, magic) in [
        ("png", "image/png", &b"\x89PNG"[..]),
        ("jpeg", "image/jpeg", &b"\xff\xd8\xff"[..]),
        ("exr", "image/x-exr", &b"\x76\x2f\x31\x01"[..]),
    ] {
        let picture = server.get(&format!("{BOX}/frame?size=64x48&format={format}&error=0.9")).await;
        assert_eq!((picture.status.as_u16(), picture.header("content-type")), (200, content_type));
        assert!(picture.body.starts_with(magic));
        assert_eq!(picture.header("etag"), format!("\"{revision}\""));
        assert!(picture.header("lumicast-samples").parse::<u32>().unwrap() >= 1);
        if format != "exr" {
            let decoded = image::load_from_memory(&picture.body).unwrap();
            assert_eq!((decoded.width(), decoded.height()), (64, 48));
        }
    }
    let timed = server.get(&format!("{BOX}/frame?camera=corner&time=50ms&size=32x32")).await;
    assert_eq!(timed.status, 200);
    for (query, done_by) in [
        ("error=converged&time=50ms", "time"),
        ("error=0.0001&time=50ms", "time"),
        ("error=90%25", "error"),
        ("error=0.9&time=60", "error"),
        ("error=0.9&time=1m", "error"),
        ("time=5e-2", "time"),
    ] {
        let reply = server.get(&format!("{BOX}/frame?camera=corner&size=32x32&{query}")).await;
        assert_eq!((reply.status.as_u16(), reply.header("lumicast-done-by")), (200, done_by), "{query}");
        if done_by == "error" {
            let numbers = |name: &str| -> Vec<f64> {
                reply.header(name).split(", ").map(|number| number.parse().unwrap()).collect()
            };
            let (error, interval) = (numbers("lumicast-error"), numbers("lumicast-error-interval"));
            assert!(interval[0] <= error[0] && error[0] <= interval[1], "{error:?} {interval:?}");
        }
    }
    for bad in [
        "camera=nobody",
        "size=0x5",
        "size=99999x1",
        "size=big",
        "format=bmp",
        "error=0",
        "error=nan",
        "time=-1",
        "time=1e9",
        "time=1000h",
        "time=10d",
        "error=nan%25",
        "error=-1%25",
        "error=%25",
        "error=1e-9",
        "error=5",
        "error=inf",
        "tone_map=vivid",
        "exposure_ev=99",
        "exposure_ev=x",
        "speed=9",
    ] {
        let reply = server.get(&format!("{BOX}/frame?{bad}")).await;
        assert!([400, 404, 422].contains(&reply.status.as_u16()), "{bad}: {}", reply.status);
        reply.problem(reply.status.as_u16());
    }
    for (bad, told) in [
        ("size=0x8", "parameter `size` is \"0x8\": WxH from 1x1 to"),
        ("tone_map=filmic", "parameter `tone_map` is \"filmic\": linear, reinhard, aces, agx"),
        ("error=5", "did you mean 5%25?"),
        (
            "technique=fast",
            "parameter `technique` is \"fast\": auto, octree, irradiance, lightmap, path, none",
        ),
        ("technique=lightmap", "not yet lightmap"),
        ("tim=5", "query: tim: unknown field `tim`, expected one of"),
    ] {
        let reply = server.get(&format!("{BOX}/frame?{bad}")).await;
        let problem = reply.problem(reply.status.as_u16());
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains(told), "{bad}: {detail}");
    }
    server.stop().await;
}

/// The light between surfaces comes by whichever technique is named, and alike; by none it is missing.
#[tokio::test]
async fn a_picture_is_by_the_technique_that_is_named() {
    let server = Server::start(|_| {}).await;
    let mean = async |technique: &str| {
        let path = format!("{BOX}/frame?size=64x48&format=png&time=1&tone_map=linear&technique={technique}");
        let picture = server.get(&path).await;
        assert_eq!(picture.status, 200, "{technique}");
        let shown = image::load_from_memory(&picture.body).unwrap().to_rgb8();
        shown.iter().map(|value| f64::from(*value)).sum::<f64>() / shown.len() as f64
    };
    let auto = mean("auto").await;
    for technique in ["octree", "irradiance", "path"] {
        let by = mean(technique).await;
        assert!((by / auto - 1.0).abs() < 0.03, "{technique}: {by} for {auto}");
    }
    let none = mean("none").await;
    assert!(none < 0.9 * auto, "{none} for {auto}");
    server.stop().await;
}

/// What one picture learns of the light the next begins with, through another camera too, until an edit changes the light.
#[tokio::test]
async fn pictures_share_the_light_of_their_scene() {
    let server = Server::start(|_| {}).await;
    let lit = async || {
        let metrics = &server.scenes.workshop().metrics;
        let before = (metrics.pictures.value(), metrics.pictures_lit.value());
        for camera in ["main", "corner"] {
            let path = format!("{BOX}/frame?camera={camera}&size=48x48&time=0.4");
            let picture = server.get(&path).await;
            assert_eq!((picture.status.as_u16(), picture.header("lumicast-done-by")), (200, "time"));
        }
        assert_eq!(metrics.pictures.value(), before.0 + 2);
        metrics.pictures_lit.value() - before.1
    };
    assert_eq!(lit().await, 1);
    assert_eq!(lit().await, 2);
    // Another light.
    server
        .edit(json!([{"op": "set_material", "material": "lamp", "emission": [3.0, 3.0, 9.0]}]))
        .await
        .revision();
    assert_eq!(lit().await, 1);
    server.stop().await;

    let server = Server::start(|config| config.kept_light_s = 0.0).await;
    let metrics = &server.scenes.workshop().metrics;
    let path = format!("{BOX}/frame?size=48x48&time=0.4");
    for _ in 0..2 {
        assert_eq!(server.get(&path).await.status, 200);
    }
    assert_eq!((metrics.pictures.value(), metrics.pictures_lit.value()), (2, 0), "nothing is kept");
    server.stop().await;

    // Who looks keeps his light to himself, and leaves it when he goes.
    let server = Server::start(|_| {}).await;
    let metrics = &server.scenes.workshop().metrics;
    let mut viewer = server.viewer().await;
    viewer.say(json!({"type": "accuracy", "technique": "auto"})).await;
    viewer.say(json!({"type": "camera", "stamp": 7, "size": [64, 48], "camera": "main"})).await;
    let _ = viewer.frame_where(|header| header.camera_stamp == 7 && header.samples > 8).await;
    assert_eq!(server.get(&path).await.status, 200);
    assert_eq!(metrics.pictures_lit.value(), 0);
    drop(viewer);
    in_time(async {
        while metrics.pictures_lit.value() == 0 {
            assert_eq!(server.get(&path).await.status, 200);
        }
    })
    .await;
    server.stop().await;
}

/// Pictures that are asked for at once learn of the light together; each is done in its time, also when one of them is given up, and what
/// they know in the end is kept.
#[tokio::test]
async fn pictures_at_once_learn_together() {
    let server = Server::start(|_| {}).await;
    let metrics = &server.scenes.workshop().metrics;
    let [main, corner] =
        ["main", "corner"].map(|camera| format!("{BOX}/frame?camera={camera}&size=48x48&time=3"));
    let until_all_are_drawn = async {
        while metrics.pictures.value() < 4 {
            tokio::task::yield_now().await
        }
    };
    let given_up = async {
        tokio::select! {
            _ = server.get(&corner) => panic!("done before the others began"),
            () = until_all_are_drawn => {}
        }
    };
    let (first, second, third, ()) =
        tokio::join!(server.get(&main), server.get(&corner), server.get(&main), given_up);
    for picture in [first, second, third] {
        assert_eq!((picture.status.as_u16(), picture.header("lumicast-done-by")), (200, "time"));
    }
    assert_eq!((metrics.pictures.value(), metrics.pictures_joined.value()), (4, 3));
    assert_eq!(metrics.pictures_lit.value(), 0);
    assert_eq!(server.get(&corner.replace("time=3", "time=0.4")).await.status, 200);
    assert_eq!(metrics.pictures_lit.value(), 1);
    server.stop().await;
}

/// Pictures asked for are bounded in number; one given up makes room.
#[tokio::test]
async fn too_many_pictures_at_once_are_refused() {
    let server = Server::start(|config| config.frame_requests = 1).await;
    let path = format!("{BOX}/frame?size=64x64&time=100");
    let stream = TcpStream::connect(server.address).await.unwrap();
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await.unwrap();
    let connection = tokio::spawn(connection);
    let request = hyper::Request::get(&path).header("host", "x").body(http_body_util::Empty::<Bytes>::new());
    let first = tokio::spawn(async move { sender.send_request(request.unwrap()).await.map(|_| ()) });
    // It is being drawn once a second one is refused.
    let short = format!("{BOX}/frame?size=8x8&time=1ms");
    in_time(async {
        loop {
            let reply = server.get(&short).await;
            if reply.status == 503 {
                assert_eq!(reply.header("retry-after"), "1");
                break;
            }
        }
    })
    .await;
    first.abort();
    connection.abort();
    in_time(async { while server.get(&short).await.status != 200 {} }).await;
    server.stop().await;
}

/// The events tell each revision as it comes, after saying where the scene is.
#[tokio::test]
async fn events_follow_the_edits() {
    let server = Server::start(|config| config.event_listeners = 1).await;
    let stream = TcpStream::connect(server.address).await.unwrap();
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await.unwrap();
    tokio::spawn(connection);
    let request = hyper::Request::get(format!("{BOX}/events")).header("host", "x");
    let response =
        sender.send_request(request.body(http_body_util::Empty::<Bytes>::new()).unwrap()).await.unwrap();
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    server.get(&format!("{BOX}/events")).await.problem(429);
    let mut body = response.into_body();
    let mut heard = String::new();
    let mut hear_until = async |what: &str| {
        while !heard.contains(what) {
            let frame = in_time(body.frame()).await.expect("the stream ended").unwrap();
            heard.push_str(std::str::from_utf8(frame.data_ref().unwrap_or(&Bytes::new())).unwrap());
        }
        heard.clone()
    };
    hear_until("event: revision\nid: 1\n").await;
    server.edit(harmless(0.1)).await.revision();
    let heard = hear_until("event: edit\nid: 2\n").await;
    assert!(heard.contains("\"op\":\"set_environment\""), "{heard}");
    server.request("DELETE", BOX, &[], "").await;
    hear_until("event: closed").await;
    server.stop().await;
}

/// Before the scenes are loaded the server says so; while it stops, too.
#[tokio::test]
async fn readiness_is_told() {
    let server = Server::without_scenes(|_| {}).await;
    assert_eq!(server.get("/v1/scenes").await.json(), json!({"scenes": []}));
    server.get(BOX).await.problem(404);
    assert_eq!(server.get("/readyz").await.status, 200);
    server.stop().await;
}

/// Pages of other origins get no permission unless configured.
#[tokio::test]
async fn other_origins_are_allowed_only_by_configuration() {
    let asked = [("origin", "http://viewer.example")];
    let server = Server::start(|_| {}).await;
    let reply = server.request("GET", "/v1/scenes", &asked, "").await;
    assert_eq!(reply.header("access-control-allow-origin"), "");
    server.stop().await;
    let server = Server::start(|config| config.allow_origins = vec!["http://viewer.example".into()]).await;
    let reply = server.request("GET", "/v1/scenes", &asked, "").await;
    assert_eq!(reply.header("access-control-allow-origin"), "http://viewer.example");
    server.stop().await;
}

/// Ids are made of names, and never anything but an id.
#[test]
fn any_name_becomes_an_id() {
    let id = |name: &str| lumicast::http::id_of_name(name).to_string();
    assert_eq!(id("sponza"), "sponza");
    assert_eq!(id("My Room (2)"), "My-Room--2-");
    assert_eq!(id("../../etc"), "etc");
    for name in ["", "...", "日本", &"x".repeat(500)] {
        assert!(SceneId::new(id(name)).is_ok());
    }
}

/// A page of another origin cannot edit: a plain POST needs no leave from the browser, so the server refuses it.
#[tokio::test]
async fn pages_of_other_origins_change_nothing() {
    let server = Server::start(|_| {}).await;
    let body = r#"[{"op":"set_environment","kind":"constant","radiance":[1,1,1]}]"#;
    let edits = format!("{BOX}/edits");
    for (method, path) in [("POST", edits.as_str()), ("POST", "/v1/scenes"), ("DELETE", BOX)] {
        let reply = server.request(method, path, &[("origin", "http://evil.example")], body).await;
        reply.problem(400);
    }
    assert_eq!(server.get(BOX).await.json()["revision"], 1);
    server.stop().await;
}
