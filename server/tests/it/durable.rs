//! What was acknowledged survives: the real program, killed and started again.

use crate::harness::{BOX, PATIENCE, Server, harmless, in_time, request};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

struct Program {
    child: Child,
    address: SocketAddr,
}

impl Program {
    /// Starts the binary on a free port and reads from its greeting where it listens.
    fn start(arguments: &[&str]) -> Program {
        let mut child = Command::new(env!("CARGO_BIN_EXE_lumicast"))
            .args(["serve", "--listen", "127.0.0.1:0", "--threads", "1"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let greeting = lines.next().expect("it ended without a word").unwrap();
        let url = greeting.split("http://").nth(1).unwrap();
        let address = url.trim_end_matches('/').parse().unwrap();
        // The rest of the greeting is read, so that the program never writes into a closed pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Program { child, address }
    }

    async fn edit(&self, edits: &Value, key: Option<&str>) -> Option<u64> {
        let mut headers = vec![("content-type", "application/json")];
        headers.extend(key.map(|key| ("idempotency-key", key)));
        let reply = request(self.address, "POST", &format!("{BOX}/edits"), &headers, edits.to_string()).await;
        (reply.status == 200).then(|| reply.revision())
    }

    async fn scene(&self) -> Value {
        request(self.address, "GET", BOX, &[], "").await.json()
    }

    fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn data(dir: &tempfile::TempDir) -> [&str; 2] {
    ["--data", dir.path().to_str().unwrap()]
}

/// Killed at any moment, the program comes back with every batch it had answered, and knows their keys.
#[tokio::test]
async fn a_kill_loses_nothing_that_was_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let mut last = 1;
    for round in 0..3 {
        let program = Program::start(&data(&dir));
        let scene = program.scene().await;
        let revision = scene["revision"].as_u64().unwrap();
        // One batch may be on disk without its answer having arrived: never fewer, at most one more.
        assert!(revision == last || revision == last + 1, "round {round}: {revision} after {last}");
        assert_eq!(scene["durable"], true);
        if round > 0 {
            let key = format!("round {}", round - 1);
            let again = program.edit(&harmless(f64::from(round - 1)), Some(&key)).await.unwrap();
            assert!(again < revision, "the key was forgotten: {again}");
        }
        last = revision;
        let key = format!("round {round}");
        last = program.edit(&harmless(f64::from(round)), Some(&key)).await.unwrap().max(last);
        for n in 0..20 {
            let edit = json!([{"op": "set_camera", "camera": format!("c{round}-{n}"), "yfov_rad": 1}]);
            last = program.edit(&edit, None).await.unwrap();
        }
        // One more on its way while the program dies.
        let address = program.address;
        let racing = tokio::spawn(async move {
            let body = harmless(0.5).to_string();
            let headers = [("content-type", "application/json")];
            let path = format!("{BOX}/edits");
            tokio::time::timeout(PATIENCE, raw_post(address, &path, &headers, body)).await
        });
        tokio::task::yield_now().await;
        program.kill();
        let _ = in_time(racing).await;
    }
    let program = Program::start(&data(&dir));
    let cameras = program.scene().await["cameras"].as_array().unwrap().len();
    assert_eq!(cameras, 2 + 3 * 20);
}

/// A request whose answer may never come.
async fn raw_post(
    address: SocketAddr,
    path: &str,
    headers: &[(&str, &str)],
    body: String,
) -> std::io::Result<()> {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let mut stream = tokio::net::TcpStream::connect(address).await?;
    let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let head = format!("POST {path} HTTP/1.1\r\nhost: x\r\n{headers}content-length: {}\r\n\r\n", body.len());
    stream.write_all(format!("{head}{body}").as_bytes()).await?;
    let mut answer = [0; 64];
    stream.read(&mut answer).await.map(|_| ())
}

/// A torn write at the end of the log costs nothing that was acknowledged.
#[tokio::test]
async fn a_torn_log_starts_again() {
    let dir = tempfile::tempdir().unwrap();
    let program = Program::start(&data(&dir));
    assert_eq!(program.edit(&harmless(0.5), None).await, Some(2));
    program.kill();
    let log = dir.path().join("scenes/cornell-box/edits-1.log");
    let mut bytes = std::fs::read(&log).unwrap();
    bytes.extend_from_slice(&[200, 0, 0, 0, 1, 2, 3]);
    std::fs::write(&log, bytes).unwrap();
    let program = Program::start(&data(&dir));
    assert_eq!(program.scene().await["revision"], 2);
    assert_eq!(program.edit(&harmless(0.6), None).await, Some(3));
}

/// SIGTERM ends the program with code 0 within seconds.
#[cfg(unix)]
#[tokio::test]
async fn a_term_signal_ends_it_cleanly() {
    let mut program = Program::start(&[]);
    assert_eq!(program.edit(&harmless(0.5), None).await, Some(2));
    let status = Command::new("kill").arg(program.child.id().to_string()).status().unwrap();
    assert!(status.success());
    let started = Instant::now();
    let ended = loop {
        if let Some(status) = program.child.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < PATIENCE, "it does not end");
        tokio::task::yield_now().await;
    };
    assert_eq!(ended.code(), Some(0));
}

/// `lumicast edit` sends, prints the revision, and fails with the reason.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_edit_command_sends_a_batch() {
    let server = Server::start(|_| {}).await;
    let file = tempfile::NamedTempFile::new().unwrap();
    let url = format!("http://{}{BOX}", server.address);
    let run = async |batch: Value, more: &[&str]| {
        std::fs::write(file.path(), batch.to_string()).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_lumicast"));
        command.arg("edit").arg(&url).arg(file.path()).args(more);
        let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (output.status.code(), text(output.stdout), text(output.stderr))
    };
    assert_eq!(run(harmless(0.1), &[]).await, (Some(0), "revision 2\n".into(), String::new()));
    let (code, out, _) = run(harmless(0.1), &["--json", "--if-match", "2"]).await;
    assert_eq!((code, serde_json::from_str::<Value>(&out).unwrap()), (Some(0), json!({"revision": 3})));
    let (code, out, error) = run(harmless(0.1), &["--if-match", "2"]).await;
    assert_eq!((code, out.as_str()), (Some(1), ""));
    assert!(error.contains("revision 3"), "{error}");
    let (code, _, error) = run(json!([{"op": "remove_light", "light": "nobody"}]), &[]).await;
    assert!(code == Some(1) && error.contains("nobody"), "{error}");
    let bad = Command::new(env!("CARGO_BIN_EXE_lumicast")).args(["serve", "--nonsense"]).output().unwrap();
    assert_eq!(bad.status.code(), Some(2));
    server.stop().await;
}

/// A scene made over HTTP is there after a restart, also where no such scene would be accepted by then; one deleted is not.
#[tokio::test]
async fn made_and_deleted_scenes_are_remembered() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().to_str().unwrap().to_string();
    let server = Server::start(|config| config.data = path.clone()).await;
    let glb = server.get(&format!("{BOX}/export.glb")).await.body;
    let headers = [("content-type", "model/gltf-binary")];
    for name in ["a", "b"] {
        let made = server.request("POST", &format!("/v1/scenes?name={name}"), &headers, glb.clone()).await;
        assert_eq!(made.status, 201);
    }
    assert_eq!(server.request("DELETE", "/v1/scenes/a", &[], "").await.status, 204);
    server.post("/v1/scenes/b/edits", harmless(0.5).to_string()).await.revision();
    // Numbers of 17 digits, which a JSON reader that is fast rather than exact gets wrong by a bit now and then.
    let turns: Vec<Value> = (1..200)
        .map(|n| {
            let at = f64::from(n).sqrt() / 3.0;
            json!({"op": "set_transform", "node": "lamp", "transform": {"translation": [at, at.sin(), 1.0 / at]}})
        })
        .collect();
    for turn in turns.chunks(10) {
        server.post("/v1/scenes/b/edits", json!(turn).to_string()).await.revision();
    }
    let before = server.get("/v1/scenes/b").await.text();
    server.stop().await;
    let server = Server::start(|config| {
        config.data = path;
        (config.edits_per_batch, config.scene_vertices, config.scene_triangles) = (1, 1, 1);
        (config.scene_emissive_triangles, config.scene_nodes, config.scene_objects) = (1, 1, 1);
        (config.file_bytes, config.file_json_bytes, config.file_json_values) = (1, 1, 1);
        (config.accessor_elements, config.image_texels, config.file_side_bytes) = (1, 1, 1);
    })
    .await;
    server.get("/v1/scenes/a").await.problem(404);
    assert_eq!(server.get("/v1/scenes/b").await.text(), before, "replayed to the last bit");
    let more = server.request("POST", "/v1/scenes?name=c", &headers, glb).await;
    assert!(more.problem(422)["detail"].as_str().unwrap().contains("--set file_json_bytes="));
    server.stop().await;
}

/// A long log is folded into a new base; revision, scene, keys and what follows stay.
#[tokio::test]
async fn a_long_log_is_folded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().to_str().unwrap().to_string();
    let server = Server::start(|config| {
        config.data = path.clone();
        config.log_bytes = 2000;
    })
    .await;
    for n in 0..40 {
        let key = format!("key {n}");
        let headers = [("idempotency-key", key.as_str())];
        let body = harmless(f64::from(n)).to_string();
        server.request("POST", &format!("{BOX}/edits"), &headers, body).await.revision();
    }
    let before = server.get(BOX).await.json();
    server.stop().await;
    let folder = dir.path().join("scenes/cornell-box");
    assert!(log_bytes(&folder) < 3000, "the log was not folded");
    assert!(!folder.join("edits-1.log").exists());
    let server = Server::start(|config| config.data = path).await;
    let after = server.get(BOX).await.json();
    for part in ["revision", "counts", "materials", "meshes", "environment", "durable"] {
        assert_eq!(after[part], before[part]);
    }
    let headers = [("idempotency-key", "key 3")];
    let again = server.request("POST", &format!("{BOX}/edits"), &headers, harmless(3.0).to_string()).await;
    assert_eq!(again.revision(), 5);
    assert_eq!(server.edit(harmless(0.0)).await.revision(), 42);
    server.stop().await;
}

fn log_bytes(folder: &Path) -> u64 {
    let logs = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    logs.filter(|entry| entry.path().extension().is_some_and(|e| e == "log"))
        .map(|entry| entry.metadata().unwrap().len())
        .sum()
}

/// Numbers too large for single precision are refused with op and field where edits are kept, too: the log's JSON has no
/// infinity, and what comes back from it must not be what is judged.
#[tokio::test]
async fn infinite_numbers_are_refused_before_they_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(|config| config.data = dir.path().display().to_string()).await;
    for (field, value) in [
        ("roughness", "1e39"),
        ("emission", "[1e39,0,0]"),
        ("alpha_cutoff", "1e39"),
        ("base_color", "[1,1e39,1]"),
    ] {
        let edit = format!(r#"[{{"op":"set_material","material":"white","{field}":{value}}}]"#);
        let reply = server.post(&format!("{BOX}/edits"), edit).await;
        let problem = reply.problem(422);
        assert_eq!((problem["op"].as_str(), problem["field"].as_str()), (Some("set_material"), Some(field)));
    }
    assert_eq!(server.get(BOX).await.json()["revision"], 1);
    server.stop().await;
}
