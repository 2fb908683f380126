use crate::harness::{BOX, PATIENCE, Server, harmless, in_time};
use base64::Engine;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Instant;

/// Each op changes what it says, and the description shows it.
#[tokio::test]
async fn every_op_of_the_contract_works_and_shows() {
    let server = Server::start(|_| {}).await;
    let texels = base64::engine::general_purpose::STANDARD.encode([0_u8; 24]);
    let steps: [(Value, &str, Value); 13] = [
        (
            json!({"op": "set_material", "material": "blue", "create": true, "base_color": [0.1, 0.2, 0.9]}),
            "/counts/materials",
            json!(7),
        ),
        (
            json!({"op": "add_mesh", "mesh": "tile", "positions": [[0,0,0],[1,0,0],[1,0,-1]], "triangles": [[0,1,2]], "material": "blue"}),
            "/counts/meshes",
            json!(10),
        ),
        (
            json!({"op": "add_node", "node": "tile", "mesh": "tile", "transform": {"translation": [0, 0.5, 0]}}),
            "/counts/nodes",
            json!(10),
        ),
        (
            json!({"op": "set_transform", "node": "tile", "transform": {"translation": [0, 0.75, 0]}}),
            "/nodes/9/transform/matrix/13",
            json!(0.75),
        ),
        (
            json!({"op": "add_light", "light": "l", "kind": "point", "intensity": [1, 2, 3], "position": [0, 1, 0]}),
            "/lights/0/intensity/2",
            json!(3.0),
        ),
        (
            json!({"op": "set_light", "light": "l", "intensity": [4, 5, 6]}),
            "/lights/0/intensity/2",
            json!(6.0),
        ),
        (json!({"op": "set_light", "light": "l", "parent": "tile"}), "/lights/0/parent", json!("tile")),
        (
            json!({"op": "set_camera", "camera": "c", "look_at": {"position": [0,1,3], "target": [0,1,0]}, "yfov_rad": 0.5}),
            "/cameras/2/yfov_rad",
            json!(0.5),
        ),
        (json!({"op": "remove_camera", "camera": "c"}), "/counts/cameras", json!(2)),
        (
            json!({"op": "set_environment", "kind": "constant", "radiance": [1, 1, 1]}),
            "/environment/kind",
            json!("constant"),
        ),
        (
            json!({"op": "set_environment", "kind": "image", "image": {"width": 2, "height": 1, "texels": texels}, "scale": 2}),
            "/environment/scale",
            json!(2.0),
        ),
        (json!({"op": "remove_light", "light": "l"}), "/counts/lights", json!(0)),
        (json!({"op": "remove_node", "node": "tile"}), "/counts/nodes", json!(9)),
    ];
    for (index, (edit, pointer, expected)) in steps.into_iter().enumerate() {
        let revision = server.edit(json!([edit])).await.revision();
        assert_eq!(revision, index as u64 + 2);
        let scene = server.get(BOX).await;
        assert_eq!(scene.header("etag"), format!("\"{revision}\""));
        assert_eq!(scene.json().pointer(pointer), Some(&expected), "{edit}");
    }
    server.stop().await;
}

/// A file joins the scene as an edit.
#[tokio::test]
async fn a_glb_can_be_loaded_into_a_scene() {
    let server = Server::start(|_| {}).await;
    let glb = server.get(&format!("{BOX}/export.glb")).await;
    assert_eq!((glb.status.as_u16(), glb.header("content-type")), (200, "model/gltf-binary"));
    let data = base64::engine::general_purpose::STANDARD.encode(&glb.body);
    let edit = json!([{"op": "load_gltf", "data": data, "prefix": "copy/"}]);
    server.edit(edit).await.revision();
    let scene = server.get(BOX).await.json();
    assert_eq!(scene["counts"]["nodes"], 18);
    let names: BTreeSet<&str> =
        scene["nodes"].as_array().unwrap().iter().map(|node| node["id"].as_str().unwrap()).collect();
    assert!(names.contains("copy/floor"), "{names:?}");
    server.stop().await;
}

/// A bad value refuses the whole batch, names op and field, and changes nothing.
#[tokio::test]
async fn a_refused_batch_names_op_and_field_and_changes_nothing() {
    let server = Server::start(|config| config.edits_per_batch = 50).await;
    let before = server.get(BOX).await.body;
    let good = json!({"op": "set_environment", "kind": "constant", "radiance": [9, 9, 9]});
    let cases = [
        (
            r#"{"op":"set_transform","node":"lamp","transform":{"scale":[1,0,1]}}"#,
            "set_transform",
            "transform",
        ),
        (
            r#"{"op":"set_transform","node":"lamp","transform":{"scale":[1,1e999,1]}}"#,
            "set_transform",
            "transform.scale[1]",
        ),
        (
            r#"{"op":"set_transform","node":"lamp","transform":{"rotation":[0,0,0,3]}}"#,
            "set_transform",
            "transform",
        ),
        (r#"{"op":"set_transform","node":"nobody","transform":{}}"#, "set_transform", "node"),
        (
            r#"{"op":"set_transform","node":"lamp","transform":{"translation":[1e300,0,0]}}"#,
            "set_transform",
            "transform",
        ),
        (r#"{"op":"set_material","material":"white","roughness":1.5}"#, "set_material", "roughness"),
        (r#"{"op":"set_material","material":"white","emission":[1e39,0,0]}"#, "set_material", "emission"),
        (r#"{"op":"set_material","material":"new"}"#, "set_material", "material"),
        (
            r#"{"op":"add_mesh","mesh":"m","positions":[[0,0,0]],"triangles":[[0,1,2]],"material":"white"}"#,
            "add_mesh",
            "triangles",
        ),
        (
            r#"{"op":"add_mesh","mesh":"m","positions":[[0,1e39,0],[1,0,0],[0,0,1]],"triangles":[[0,1,2]],"material":"white"}"#,
            "add_mesh",
            "positions",
        ),
        (
            r#"{"op":"add_mesh","mesh":"m","positions":[[0,0,0],[1,0,0],[0,0,1]],"triangles":[[0,1,2]],"normals":[[0,1,0]],"material":"white"}"#,
            "add_mesh",
            "normals",
        ),
        (
            r#"{"op":"add_mesh","mesh":"m","positions":[[0,0,0],[1,0,0],[0,0,1]],"triangles":[[0,1,2]],"material":"gold"}"#,
            "add_mesh",
            "material",
        ),
        (r#"{"op":"add_node","node":"lamp"}"#, "add_node", "node"),
        (r#"{"op":"add_node","node":"n","mesh":"nothing"}"#, "add_node", "mesh"),
        (r#"{"op":"add_node","node":"n","parent":"nobody"}"#, "add_node", "parent"),
        (r#"{"op":"remove_node","node":"nobody"}"#, "remove_node", "node"),
        (r#"{"op":"add_light","light":"l","kind":"point","intensity":[-1,0,0]}"#, "add_light", "intensity"),
        (
            r#"{"op":"add_light","light":"l","kind":"spot","intensity":[1,1,1],"outer_angle_rad":4}"#,
            "add_light",
            "outer_angle_rad",
        ),
        (r#"{"op":"set_light","light":"nobody"}"#, "set_light", "light"),
        (r#"{"op":"remove_light","light":"nobody"}"#, "remove_light", "light"),
        (r#"{"op":"set_camera","camera":"c","yfov_rad":4}"#, "set_camera", "yfov_rad"),
        (
            r#"{"op":"set_camera","camera":"c","look_at":{"position":[0,0,0],"target":[0,0,0]}}"#,
            "set_camera",
            "look_at.target",
        ),
        (
            r#"{"op":"set_camera","camera":"c","look_at":{"position":[0,0,0],"target":[0,1,0]}}"#,
            "set_camera",
            "look_at.up",
        ),
        (r#"{"op":"remove_camera","camera":"nobody"}"#, "remove_camera", "camera"),
        (
            r#"{"op":"set_environment","kind":"image","image":{"width":2,"height":2,"texels":"AAAA"}}"#,
            "set_environment",
            "image.texels",
        ),
        (
            r#"{"op":"set_environment","kind":"image","image":{"width":1.5,"height":2,"texels":""}}"#,
            "set_environment",
            "image.width",
        ),
        (
            r#"{"op":"set_environment","kind":"image","image":{"width":2,"height":2,"texels":"%%%"}}"#,
            "set_environment",
            "image.texels",
        ),
        (r#"{"op":"load_gltf","data":"AAAA"}"#, "load_gltf", "data"),
        (r#"{"op":"load_gltf","data":"AAAA","parent":"nobody"}"#, "load_gltf", "parent"),
        (r#"{"op":"explode"}"#, "explode", "op"),
    ];
    for (edit, op, field) in cases {
        let reply = server.post(&format!("{BOX}/edits"), format!("[{good},{edit}]")).await;
        let problem = reply.problem(422);
        assert_eq!(
            (problem["op"].as_str(), problem["op_index"].as_u64(), problem["field"].as_str()),
            (Some(op), Some(1), Some(field)),
            "{edit}: {problem}"
        );
        assert_eq!(server.get(BOX).await.body, before, "{edit}");
    }
    let many: Vec<Value> = (0..51).map(|_| good.clone()).collect();
    assert_eq!(server.edit(json!(many)).await.problem(422)["field"], "edits");
    assert_eq!(server.edit(json!([])).await.problem(422)["field"], "edits");
    assert_eq!(server.get(BOX).await.body, before);
    server.stop().await;
}

/// Later edits of a batch may use what earlier ones made; together they are one revision.
#[tokio::test]
async fn a_batch_is_one_revision() {
    let server = Server::start(|_| {}).await;
    let batch = json!([
        {"op": "set_material", "material": "m", "create": true},
        {"op": "add_mesh", "mesh": "m", "positions": [[0,0,0],[1,0,0],[0,0,1]], "triangles": [[0,1,2]], "material": "m"},
        {"op": "add_node", "node": "a", "mesh": "m"},
        {"op": "add_node", "node": "b", "parent": "a", "mesh": "m", "transform": {"translation": [0, 1, 0]}},
    ]);
    assert_eq!(server.edit(json!({"edits": batch})).await.revision(), 2);
    let log = server.get(&format!("{BOX}/edits?since=1")).await.json();
    assert_eq!(log["revision"], 2);
    assert_eq!(log["entries"][0]["edits"].as_array().unwrap().len(), 4);
    server.stop().await;
}

/// If-Match refuses once the scene has moved on, and says where it is.
#[tokio::test]
async fn if_match_refuses_when_the_scene_has_moved_on() {
    let server = Server::start(|_| {}).await;
    let path = format!("{BOX}/edits");
    let send = async |tag: &str| {
        let headers = [("if-match", tag)];
        server.request("POST", &path, &headers, harmless(0.1).to_string()).await
    };
    assert_eq!(send("\"1\"").await.revision(), 2);
    let problem = send("\"1\"").await.problem(412);
    assert_eq!(
        (problem["revision"].as_u64(), &problem["type"]),
        (Some(2), &json!("urn:lumicast:problem:revision-moved"))
    );
    assert_eq!(send("*").await.revision(), 3);
    assert_eq!(send("3").await.revision(), 4);
    send("\"latest\"").await.problem(400);
    server.stop().await;
}

/// The same batch under the same key makes one revision; another batch under it is a conflict.
#[tokio::test]
async fn an_idempotency_key_makes_a_repetition_harmless() {
    let server = Server::start(|_| {}).await;
    let path = format!("{BOX}/edits");
    let send = async |key: &str, radiance: f64| {
        let headers = [("idempotency-key", key), ("if-match", "\"1\"")];
        server.request("POST", &path, &headers, harmless(radiance).to_string()).await
    };
    assert_eq!(send("k", 0.1).await.revision(), 2);
    // Answered like the first time, though the scene has moved on since.
    assert_eq!(send("k", 0.1).await.revision(), 2);
    send("k", 0.2).await.problem(409);
    send("other", 0.1).await.problem(412);
    send("", 0.1).await.problem(400);
    assert_eq!(server.get(BOX).await.json()["revision"], 2);
    server.stop().await;
}

/// Eight clients at once: every accepted batch has a revision of its own, none is left out, each client sees its own
/// in order, and the log agrees.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn concurrent_edits_get_distinct_ordered_revisions() {
    let server = std::sync::Arc::new(Server::start(|_| {}).await);
    let mut clients = Vec::new();
    for client in 0..8 {
        let server = server.clone();
        clients.push(tokio::spawn(async move {
            let mut own = Vec::new();
            for n in 0..10 {
                own.push(server.edit(harmless(f64::from(client * 10 + n) / 100.0)).await.revision());
            }
            assert!(own.is_sorted());
            own
        }));
    }
    let mut all = BTreeSet::new();
    for client in clients {
        all.extend(in_time(client).await.unwrap());
    }
    assert_eq!(all, (2..=81).collect());
    let log = server.get(&format!("{BOX}/edits?since=40")).await.json();
    let revisions: Vec<u64> =
        log["entries"].as_array().unwrap().iter().map(|entry| entry["revision"].as_u64().unwrap()).collect();
    assert_eq!(revisions, (41..=81).collect::<Vec<u64>>());
}

/// Old batches are forgotten within the bound, and the gap is told.
#[tokio::test]
async fn the_log_is_bounded_and_says_so() {
    let server = Server::start(|config| config.event_log = 3).await;
    for n in 0..5 {
        server.edit(harmless(f64::from(n))).await.revision();
    }
    let problem = server.get(&format!("{BOX}/edits?since=2")).await.problem(404);
    assert_eq!(problem["revision"], 6);
    let log = server.get(&format!("{BOX}/edits?since=3")).await.json();
    assert_eq!(log["entries"].as_array().unwrap().len(), 3);
    let future = server.get(&format!("{BOX}/edits?since=99")).await.json();
    assert_eq!(future["entries"], json!([]));
    server.get(&format!("{BOX}/edits?since=yesterday")).await.problem(400);
    server.stop().await;
}

/// 500 edits that add and remove things leave no more behind than they should.
#[tokio::test]
async fn five_hundred_edits_leave_memory_as_it_was() {
    let server = Server::start(|config| config.photons = 1_000_000).await;
    let before = server.get(BOX).await.json();
    let add = json!([
        {"op": "add_mesh", "mesh": "m", "positions": [[0,0,0],[0.1,0,0],[0,0,0.1]], "triangles": [[0,1,2]], "material": "white"},
        {"op": "add_node", "node": "n", "mesh": "m"},
        {"op": "add_light", "light": "l", "parent": "n", "kind": "point", "intensity": [1, 1, 1]},
    ]);
    let remove = json!([{"op": "remove_node", "node": "n"}]);
    let mut viewer = server.viewer().await;
    viewer.camera("main", [32, 32]).await;
    let mut resident = Vec::new();
    let started = Instant::now();
    for n in 0..250 {
        server.edit(add.clone()).await.revision();
        server.edit(remove.clone()).await.revision();
        if n % 50 == 49 {
            resident.push(resident_bytes());
        }
        assert!(started.elapsed() < PATIENCE * 4);
    }
    viewer.frame_where(|header| header.revision == 501).await;
    let after = server.get(BOX).await.json();
    assert_eq!(after["counts"], before["counts"]);
    assert_eq!(after["revision"], 501);
    // Loosely: allocators keep some, and other tests run beside this one.
    let (first, last) = (resident[0], resident[resident.len() - 1]);
    assert!(last < first + (300 << 20), "{resident:?}");
    server.stop().await;
}

fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: u64 = status.split(' ').nth(1).and_then(|pages| pages.parse().ok()).unwrap_or(0);
    pages * 4096
}
