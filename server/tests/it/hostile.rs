//! Whatever is sent, the answer is a problem and the server goes on.

use crate::harness::{BOX, Heard, Server, harmless, in_time};
use futures_util::SinkExt;
use lumicast_protocol::ServerMessage;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::protocol::Message;

/// A fixed xorshift: the same bodies on every machine.
struct Dice(u64);

impl Dice {
    fn next(&mut self, below: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 33) as usize % below
    }
}

/// A good batch with something broken in it: a value of another type, a huge number, a byte flipped, a cut.
fn mutated(dice: &mut Dice) -> Vec<u8> {
    let batches = [
        json!([{"op": "set_transform", "node": "lamp", "transform": {"translation": [0, 1, 2]}}]),
        json!([{"op": "set_material", "material": "white", "base_color": [0.5, 0.5, 0.5], "roughness": 0.3}]),
        json!({"edits": [{"op": "add_light", "light": "l", "kind": "spot", "intensity": [1, 1, 1], "inner_angle_rad": 0.1}]}),
        json!([{"op": "add_mesh", "mesh": "m", "positions": [[0,0,0],[1,0,0],[0,1,0]], "triangles": [[0,1,2]], "material": "white"}]),
        json!([{"op": "set_camera", "camera": "c", "look_at": {"position": [0,0,0], "target": [0,0,1]}}]),
    ];
    let mut batch = batches[dice.next(batches.len())].clone();
    if dice.next(2) == 0 {
        let wrong = [
            json!(null),
            json!(1e308),
            json!(-1),
            json!("x"),
            json!([]),
            json!({}),
            json!(true),
            json!(18446744073709551615_u64),
            json!([[[[]]]]),
            json!("\u{0}"),
            json!("é".repeat(300)),
        ];
        replace_one(&mut batch, &wrong[dice.next(wrong.len())], dice);
    }
    let mut bytes = batch.to_string().into_bytes();
    match dice.next(4) {
        0 => {
            let at = dice.next(bytes.len());
            bytes[at] = dice.next(256) as u8;
        }
        1 => bytes.truncate(dice.next(bytes.len())),
        2 => bytes.insert(dice.next(bytes.len()), b"[{\"0.e-,}]"[dice.next(10)]),
        _ => {}
    }
    bytes
}

fn replace_one(value: &mut Value, with: &Value, dice: &mut Dice) {
    let stop = dice.next(3) == 0;
    match value {
        Value::Array(items) if !items.is_empty() && !stop => {
            let at = dice.next(items.len());
            replace_one(&mut items[at], with, dice);
        }
        Value::Object(fields) if !fields.is_empty() && !stop => {
            let at = dice.next(fields.len());
            replace_one(fields.values_mut().nth(at).unwrap(), with, dice);
        }
        _ => *value = with.clone(),
    }
}

/// Two thousand broken bodies: each is an edit or a problem, never a fault; the scene stays whole.
#[tokio::test]
async fn broken_batches_are_problems() {
    let server = Server::start(|_| {}).await;
    let mut dice = Dice(0x9e37_79b9_7f4a_7c15);
    let mut counts = [0; 2];
    for _ in 0..2000 {
        let body = mutated(&mut dice);
        let reply = server.post(&format!("{BOX}/edits"), body.clone()).await;
        match reply.status.as_u16() {
            200 => counts[0] += 1,
            status @ (400 | 422) => {
                reply.problem(status);
                counts[1] += 1;
            }
            other => panic!("{other} for {:?}", String::from_utf8_lossy(&body)),
        }
    }
    assert!(counts[0] > 50 && counts[1] > 500, "{counts:?}");
    let revision = server.edit(harmless(0.1)).await.revision();
    let mut viewer = server.viewer().await;
    viewer.camera("main", [32, 32]).await;
    viewer.frame_where(|header| header.revision == revision).await;
    server.stop().await;
}

/// Nesting, size and type of the body have their bounds and their answers.
#[tokio::test]
async fn extreme_bodies_are_problems() {
    let server = Server::start(|config| config.body_bytes = 1 << 20).await;
    let edits = format!("{BOX}/edits");
    for (body, status) in [
        ("[".repeat(100_000), 400),
        ("{\"a\":".repeat(100_000), 400),
        (
            format!(
                "[{}]",
                "{\"op\":\"remove_light\",\"light\":\"x\"},".repeat(20_000).trim_end_matches(',')
            ),
            422,
        ),
        (format!("[{{\"op\":\"remove_light\",\"light\":\"{}\"}}]", "x".repeat(500_000)), 422),
        ("9".repeat(1 << 20), 400),
        ("\u{0}".into(), 400),
        (" ".repeat((1 << 20) + 1), 413),
    ] {
        server.post(&edits, body).await.problem(status);
    }
    server.post(&edits, vec![0xff; 1000]).await.problem(400);
    let text = [("content-type", "text/plain")];
    server.request("POST", &edits, &text, harmless(0.1).to_string()).await.problem(415);
    assert_eq!(server.get(BOX).await.json()["revision"], 1);
    server.stop().await;
}

/// Heads too long, heads that never end and plain garbage do not disturb others.
#[tokio::test]
async fn bad_http_is_cut_off() {
    let server = Server::start(|config| config.head_seconds = 1).await;
    let answer = async |bytes: Vec<u8>| {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        // The server may close while we still write.
        let _ = stream.write_all(&bytes).await;
        let mut answer = Vec::new();
        let _ = in_time(stream.read_to_end(&mut answer)).await;
        String::from_utf8_lossy(&answer).into_owned()
    };
    let long = format!("GET / HTTP/1.1\r\nhost: x\r\nx: {}\r\n\r\n", "y".repeat(100_000));
    assert!(answer(long.into_bytes()).await.starts_with("HTTP/1.1 431"));
    assert!(answer(b"\x16\x03\x01 hello\r\n\r\n".to_vec()).await.starts_with("HTTP/1.1 400"));
    // Ends by the time limit.
    answer(b"GET / HTTP/1.1\r\nhost: x\r\n".to_vec()).await;
    assert_eq!(server.get("/healthz").await.status, 200);
    server.stop().await;
}

/// Broken messages on a WebSocket are answered with errors; the connection and its pictures go on.
#[tokio::test]
async fn broken_messages_are_errors() {
    let server = Server::start(|config| config.messages_per_second = 100_000).await;
    let mut viewer = server.viewer().await;
    viewer.camera("main", [32, 32]).await;
    let mut dice = Dice(0x2545_f491_4f6c_dd1d);
    let mut errors = 0;
    for round in 0..500 {
        let text = match dice.next(3) {
            0 => format!(
                "{{\"type\":\"edit\",\"request\":{round},\"edits\":{}",
                String::from_utf8_lossy(&mutated(&mut dice))
            ),
            1 => format!(
                "{{\"type\":\"edit\",\"request\":{round},\"edits\":{}}}",
                String::from_utf8_lossy(&mutated(&mut dice))
            ),
            _ => String::from_utf8_lossy(&mutated(&mut dice)).into_owned(),
        };
        viewer.socket.send(Message::text(text)).await.unwrap();
        viewer.say(json!({"type": "ping", "stamp": round})).await;
        loop {
            match viewer.hear().await {
                Heard::Message(ServerMessage::Pong { stamp }) if stamp == round => break,
                Heard::Message(ServerMessage::Error { .. }) => errors += 1,
                Heard::Frame(header, _) => viewer.acknowledge(header.frame).await,
                Heard::Closed(frame) => panic!("closed: {frame:?}"),
                Heard::Message(_) => {}
            }
        }
    }
    assert!(errors > 300, "{errors}");
    viewer.frame().await;
    server.stop().await;
}
