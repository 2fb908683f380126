//! A viewer without a window: a blocking WebSocket that speaks `lumicast.v1`.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use lumicast_protocol::{
    Accuracy, CameraPose, CameraRequest, ClientHello, ClientMessage, FrameHeader, Id, Quality, SUBPROTOCOL,
    SceneDescription, ServerHello, ServerMessage, View,
};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::http::header::SEC_WEBSOCKET_PROTOCOL;
use tungstenite::{Message, WebSocket};

use crate::PATIENCE;

/// What a viewer hears.
#[derive(Debug)]
pub enum Event {
    /// A control message.
    Message(ServerMessage),
    /// A picture and its payload. It has not been acknowledged.
    Frame(FrameHeader, Vec<u8>),
}

/// A connection that has said hello.
#[derive(Debug)]
pub struct Viewer {
    socket: WebSocket<TcpStream>,
    /// The server's hello.
    pub hello: ServerHello,
    /// The scene as last told.
    pub scene: SceneDescription,
    stamp: u64,
}

impl Viewer {
    /// Connects to the scene, says hello and hears the server's hello and scene.
    ///
    /// # Panics
    /// When the server does anything else than the protocol says; so do all functions here.
    pub fn connect(address: SocketAddr, scene: &str) -> Viewer {
        let url = format!("ws://{address}/v1/scenes/{scene}/ws");
        let mut request = url.as_str().into_client_request().expect("a WebSocket address");
        request.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(SUBPROTOCOL));
        let stream = TcpStream::connect(address).expect("the server listens");
        stream.set_nodelay(true).expect("TCP without delay");
        stream.set_read_timeout(Some(PATIENCE)).expect("a deadline");
        stream.set_write_timeout(Some(PATIENCE)).expect("a deadline");
        let (mut socket, answer) =
            tungstenite::client(request, stream).unwrap_or_else(|error| panic!("{url}: {error}"));
        assert_eq!(
            answer.headers().get(SEC_WEBSOCKET_PROTOCOL).map(HeaderValue::as_bytes),
            Some(SUBPROTOCOL.as_bytes())
        );
        let hello =
            ClientHello { client: "lumicast-tests".into(), version: env!("CARGO_PKG_VERSION").into() };
        say(&mut socket, ClientMessage::Hello(hello).to_json());
        let deadline = Instant::now() + PATIENCE;
        let Some(Event::Message(ServerMessage::Hello(hello))) = next(&mut socket, deadline) else {
            panic!("the first message is not hello");
        };
        let Some(Event::Message(ServerMessage::Scene { scene })) = next(&mut socket, deadline) else {
            panic!("the second message is not the scene");
        };
        Viewer { socket, hello, scene: *scene, stamp: 0 }
    }

    /// Says something.
    pub fn say(&mut self, message: &ClientMessage) {
        say(&mut self.socket, message.to_json());
    }

    /// Says something that may be wrong.
    pub fn say_text(&mut self, text: impl Into<String>) {
        say(&mut self.socket, text.into());
    }

    /// Asks for pictures through a camera of the scene; returns the stamp.
    pub fn watch(&mut self, camera: &str, size: [u16; 2]) -> u64 {
        self.ask(View::Camera(Id::new(camera).expect("an id")), size)
    }

    /// Asks for pictures from a pose; returns the stamp.
    pub fn watch_from(&mut self, pose: CameraPose, size: [u16; 2]) -> u64 {
        self.ask(View::Pose(pose), size)
    }

    fn ask(&mut self, view: View, size: [u16; 2]) -> u64 {
        self.stamp += 1;
        self.say(&ClientMessage::Camera(CameraRequest { stamp: self.stamp, size, view }));
        self.stamp
    }

    /// Asks for this codec and such.
    pub fn set_quality(&mut self, quality: Quality) {
        self.say(&ClientMessage::Quality(quality));
    }

    /// Asks for this accuracy.
    pub fn set_accuracy(&mut self, accuracy: Accuracy) {
        self.say(&ClientMessage::Accuracy(accuracy));
    }

    /// Acknowledges the frame of this number.
    pub fn acknowledge(&mut self, frame: u64) {
        self.say(&ClientMessage::Ack { frame });
    }

    /// What comes next; `None` when nothing does until the deadline.
    pub fn next(&mut self, deadline: Instant) -> Option<Event> {
        let event = next(&mut self.socket, deadline);
        if let Some(Event::Message(ServerMessage::Scene { scene })) = &event {
            self.scene = scene.as_ref().clone();
        }
        event
    }

    /// The next picture, acknowledged; `None` when none comes until the deadline. Other messages are passed over, but
    /// an error is a panic.
    pub fn next_frame(&mut self, deadline: Instant) -> Option<(FrameHeader, Vec<u8>)> {
        loop {
            match self.next(deadline)? {
                Event::Frame(header, payload) => {
                    self.acknowledge(header.frame);
                    return Some((header, payload));
                }
                Event::Message(ServerMessage::Error { problem, .. }) => panic!("the server says {problem:?}"),
                Event::Message(_) => {}
            }
        }
    }

    /// Says good-bye.
    pub fn close(mut self) {
        // The server may have gone first.
        let _ = self.socket.close(None);
        let _ = self.socket.flush();
    }
}

fn say(socket: &mut WebSocket<TcpStream>, text: String) {
    socket
        .send(Message::Text(text.into()))
        .unwrap_or_else(|error| panic!("the connection was lost: {error}"));
}

fn next(socket: &mut WebSocket<TcpStream>, deadline: Instant) -> Option<Event> {
    loop {
        // A time-out of zero would mean none.
        let wait = deadline.saturating_duration_since(Instant::now()).max(Duration::from_micros(100));
        socket.get_ref().set_read_timeout(Some(wait)).expect("a deadline");
        match socket.read() {
            Ok(Message::Text(text)) => {
                let message = ServerMessage::from_json(text.as_str());
                return Some(Event::Message(message.unwrap_or_else(|error| panic!("{error} in {text}"))));
            }
            Ok(Message::Binary(bytes)) => {
                let (header, payload) =
                    FrameHeader::decode(&bytes).unwrap_or_else(|error| panic!("a frame: {error}"));
                return Some(Event::Frame(header, payload.to_vec()));
            }
            Ok(Message::Close(frame)) => panic!("the server closed the connection: {frame:?}"),
            Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => {}
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
            {
                if Instant::now() >= deadline {
                    return None;
                }
            }
            Err(error) => panic!("the connection was lost: {error}"),
        }
    }
}
