//! A server in this process, an HTTP client and a WebSocket viewer.

use futures_util::{SinkExt, StreamExt};
use http_body_util::{BodyExt, Full};
use hyper::body::Bytes;
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use lumicast::config::Config;
use lumicast::http::{Service, serve};
use lumicast::scenes::{CreateError, Origin, Scenes, Workshop};
use lumicast::shutdown::{Stopper, stop_signal};
use lumicast::store::StoreError;
use lumicast_protocol::{FrameHeader, SceneId, ServerMessage};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::{Duration, Instant};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::MaybeTlsStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, Message};

/// Longest wait for anything: far above what a busy machine takes, so that only a hang meets it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) const BOX: &str = "/v1/scenes/cornell-box";

pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    pub(crate) scenes: Arc<Scenes>,
    pub(crate) stopper: Stopper,
    pub(crate) task: tokio::task::JoinHandle<()>,
}

/// Opens what scenes share. A program that another test starts at this moment holds the lock of a folder that was just left, from
/// its fork until its exec: that is waited for.
async fn open(config: Config) -> Workshop {
    for _ in 0..100 {
        match Workshop::open(config.clone()) {
            Err(CreateError::Store(StoreError::InUse { .. })) => {
                tokio::time::sleep(Duration::from_millis(20)).await
            }
            opened => return opened.unwrap(),
        }
    }
    panic!("the folder stays in use");
}

impl Server {
    /// A server with the built-in scene.
    pub(crate) async fn start(change: impl FnOnce(&mut Config)) -> Server {
        let server = Server::without_scenes(change).await;
        let scenes = server.scenes.clone();
        tokio::task::spawn_blocking(move || {
            scenes.restore().unwrap();
            if scenes.all().is_empty() {
                let id = SceneId::new("cornell-box").unwrap();
                scenes.create(id, "Cornell box", Origin::Builtin("cornell-box".into())).unwrap();
            }
        })
        .await
        .unwrap();
        server
    }

    pub(crate) async fn without_scenes(change: impl FnOnce(&mut Config)) -> Server {
        // Fewer photons than users have: most of the time of these tests would go into learning light.
        let mut config = Config { threads: 2, photons: 64_000, ..Config::default() };
        change(&mut config);
        let workshop = Arc::new(open(config).await);
        let scenes = Arc::new(Scenes::new(workshop));
        let (stopper, stopping) = stop_signal();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let service = Service::new(scenes.clone(), stopping);
        service.ready.store(true, SeqCst);
        let task = tokio::spawn(serve(listener, service));
        Server { address, scenes, stopper, task }
    }

    /// Stops as the program does, and waits for it.
    pub(crate) async fn stop(self) {
        self.stopper.stop();
        let scenes = self.scenes;
        tokio::task::spawn_blocking(move || scenes.stop()).await.unwrap();
        in_time(self.task).await.unwrap();
    }

    pub(crate) async fn get(&self, path: &str) -> Reply {
        self.request("GET", path, &[], "").await
    }

    pub(crate) async fn post(&self, path: &str, body: impl Into<Bytes>) -> Reply {
        self.request("POST", path, &[("content-type", "application/json")], body).await
    }

    pub(crate) async fn edit(&self, edits: Value) -> Reply {
        self.post(&format!("{BOX}/edits"), edits.to_string()).await
    }

    pub(crate) async fn request(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: impl Into<Bytes>,
    ) -> Reply {
        request(self.address, method, path, headers, body).await
    }

    pub(crate) async fn viewer(&self) -> Viewer {
        self.viewer_of("cornell-box").await
    }

    pub(crate) async fn viewer_of(&self, scene: &str) -> Viewer {
        let mut viewer = Viewer::connect(self.address, scene).await;
        viewer.say(json!({"type": "hello", "client": "test", "version": "1"})).await;
        viewer
    }
}

pub(crate) async fn request(
    address: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: impl Into<Bytes>,
) -> Reply {
    let stream = TcpStream::connect(address).await.unwrap();
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream)).await.unwrap();
    tokio::spawn(connection);
    let mut request = Request::builder().method(method).uri(path).header("host", address.to_string());
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let request = request.body(Full::new(body.into())).unwrap();
    let response = in_time(sender.send_request(request)).await.unwrap();
    let (parts, body) = response.into_parts();
    let body = in_time(body.collect()).await.unwrap().to_bytes();
    Reply { status: parts.status, headers: parts.headers, body }
}

#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: StatusCode,
    pub(crate) headers: hyper::HeaderMap,
    pub(crate) body: Bytes,
}

impl Reply {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error} in {:?}", String::from_utf8_lossy(&self.body)))
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.body.to_vec()).unwrap()
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    /// Asserts a problem of this status and returns it.
    pub(crate) fn problem(&self, status: u16) -> Value {
        assert_eq!(self.status.as_u16(), status, "{:?}", String::from_utf8_lossy(&self.body));
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], status);
        assert!(problem["type"].as_str().is_some_and(|kind| kind.contains(':')), "{problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()), "{problem}");
        problem
    }

    /// Asserts success and returns the revision of an edit.
    pub(crate) fn revision(&self) -> u64 {
        assert_eq!(self.status, 200, "{:?}", String::from_utf8_lossy(&self.body));
        self.json()["revision"].as_u64().unwrap()
    }
}

pub(crate) async fn in_time<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future).await.expect("nothing happened in time")
}

type Socket = tokio_tungstenite::WebSocketStream<MaybeTlsStream<TcpStream>>;

/// A viewer; it acknowledges what it receives through [`Viewer::frame`].
pub(crate) struct Viewer {
    pub(crate) socket: Socket,
    stamp: u64,
}

/// What came from the server.
#[derive(Debug)]
pub(crate) enum Heard {
    Message(ServerMessage),
    Frame(FrameHeader, Vec<u8>),
    Closed(Option<CloseFrame>),
}

impl Viewer {
    pub(crate) async fn connect(address: SocketAddr, scene: &str) -> Viewer {
        let url = format!("ws://{address}/v1/scenes/{scene}/ws");
        let mut request = url.into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", "lumicast.v1".parse().unwrap());
        let (socket, response) = in_time(tokio_tungstenite::connect_async(request)).await.unwrap();
        assert_eq!(response.headers()["sec-websocket-protocol"], "lumicast.v1");
        Viewer { socket, stamp: 0 }
    }

    pub(crate) async fn say(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).await.unwrap();
    }

    /// Asks for a camera of the scene; returns the stamp.
    pub(crate) async fn camera(&mut self, name: &str, size: [u16; 2]) -> u64 {
        self.stamp += 1;
        let stamp = self.stamp;
        self.say(json!({"type": "camera", "stamp": stamp, "size": size, "camera": name})).await;
        stamp
    }

    /// Asks for a pose `x` metres to the right of the box's front; returns the stamp.
    pub(crate) async fn pose(&mut self, x: f64, size: [u16; 2]) -> u64 {
        self.stamp += 1;
        let stamp = self.stamp;
        let matrix = [1.0, 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., x, 1.0, 4.2, 1.0];
        let pose = json!({"matrix": matrix, "yfov_rad": 0.7});
        self.say(json!({"type": "camera", "stamp": stamp, "size": size, "pose": pose})).await;
        stamp
    }

    pub(crate) async fn acknowledge(&mut self, frame: u64) {
        self.say(json!({"type": "ack", "frame": frame})).await;
    }

    /// The next thing said, without acknowledging.
    pub(crate) async fn hear(&mut self) -> Heard {
        loop {
            match in_time(self.socket.next()).await {
                Some(Ok(Message::Text(text))) => {
                    return Heard::Message(ServerMessage::from_json(&text).unwrap());
                }
                Some(Ok(Message::Binary(bytes))) => {
                    let (header, payload) = FrameHeader::decode(&bytes).unwrap();
                    return Heard::Frame(header, payload.to_vec());
                }
                Some(Ok(Message::Close(frame))) => return Heard::Closed(frame),
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return Heard::Closed(None),
            }
        }
    }

    /// The next picture, acknowledged; other messages are passed over.
    pub(crate) async fn frame(&mut self) -> (FrameHeader, Vec<u8>) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "no picture came");
            match self.hear().await {
                Heard::Frame(header, payload) => {
                    self.acknowledge(header.frame).await;
                    return (header, payload);
                }
                Heard::Closed(frame) => panic!("closed: {frame:?}"),
                Heard::Message(_) => {}
            }
        }
    }

    /// The first picture that fits, acknowledged; so are those before it.
    pub(crate) async fn frame_where(
        &mut self,
        fits: impl Fn(&FrameHeader) -> bool,
    ) -> (FrameHeader, Vec<u8>) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let (header, payload) = self.frame().await;
            if fits(&header) {
                return (header, payload);
            }
            assert!(Instant::now() < deadline, "no such picture came; the last was {header:?}");
        }
    }

    /// The next message; pictures are acknowledged and passed over.
    pub(crate) async fn message(&mut self) -> ServerMessage {
        loop {
            match self.hear().await {
                Heard::Message(message) => return message,
                Heard::Frame(header, _) => self.acknowledge(header.frame).await,
                Heard::Closed(frame) => panic!("closed: {frame:?}"),
            }
        }
    }

    /// The first message for which `pick` has something; pictures are acknowledged and passed over.
    pub(crate) async fn message_where<T>(&mut self, pick: impl Fn(ServerMessage) -> Option<T>) -> T {
        loop {
            if let Some(picked) = pick(self.message().await) {
                return picked;
            }
        }
    }

    /// The answer to an edit: its revision, or the problem.
    pub(crate) async fn answer(&mut self, number: u64) -> Result<u64, lumicast_protocol::Problem> {
        self.message_where(|message| match message {
            ServerMessage::Edited { request, revision } if request == number => Some(Ok(revision)),
            ServerMessage::Error { problem, request: Some(request) } if request == number => {
                Some(Err(problem))
            }
            _ => None,
        })
        .await
    }

    /// The close frame, after whatever else is said.
    pub(crate) async fn closed(&mut self) -> Option<CloseFrame> {
        loop {
            if let Heard::Closed(frame) = self.hear().await {
                return frame;
            }
        }
    }
}

/// An edit that always works and leaves the scene about the same.
pub(crate) fn harmless(radiance: f64) -> Value {
    json!([{"op": "set_environment", "kind": "constant", "radiance": [radiance, radiance, radiance]}])
}
