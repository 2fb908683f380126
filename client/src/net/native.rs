//! The native line: tokio on one thread of its own, tokio-tungstenite for the WebSocket, ureq for HTTP.

use super::{
    ANSWER_BYTES_MAX, INCOMING_MAX, MESSAGE_BYTES_MAX, Network, OUTGOING_MAX, Wake, Wire, WireEvent, refusal,
};
use futures_util::{SinkExt, StreamExt};
use lumicast_protocol::SUBPROTOCOL;
use std::sync::mpsc::Receiver;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::{HeaderValue, header::SEC_WEBSOCKET_PROTOCOL};
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message};

/// An HTTP request that takes longer has failed.
const GET_MAX: Duration = Duration::from_secs(10);

/// Sockets of the operating system.
#[derive(Debug, Default, Clone, Copy)]
pub struct Native;

struct NativeWire {
    incoming: mpsc::Receiver<WireEvent>,
    outgoing: mpsc::Sender<String>,
}

impl Wire for NativeWire {
    fn poll(&mut self) -> Option<WireEvent> {
        self.incoming.try_recv().ok()
    }

    fn has_room(&self) -> bool {
        self.outgoing.capacity() > 0
    }

    fn send(&mut self, text: String) {
        // Full or closed: the first was asked about, the second is told by `poll`.
        let _ = self.outgoing.try_send(text);
    }
}

impl Network for Native {
    fn open(&self, url: &str, wake: Wake) -> Box<dyn Wire> {
        let (events, incoming) = mpsc::channel(INCOMING_MAX);
        let (outgoing, texts) = mpsc::channel(OUTGOING_MAX);
        let url = url.to_owned();
        let line = Line { events, texts, wake };
        let failed = line.events.clone();
        let thread = std::thread::Builder::new().name("lumicast-line".into()).spawn(move || line.run(&url));
        if let Err(error) = thread {
            let reason = format!("no thread for the connection: {error}");
            let _ = failed.try_send(WireEvent::Closed { reason, is_final: false });
        }
        Box::new(NativeWire { incoming, outgoing })
    }

    fn get(&self, url: &str, wake: Wake) -> Receiver<Result<String, String>> {
        let (answer, receiver) = std::sync::mpsc::sync_channel(1);
        let url = url.to_owned();
        let work = move || {
            // The asker may have gone.
            let _ = answer.send(get(&url));
            wake();
        };
        // Without a thread the sender is dropped, which the receiver sees.
        let _ = std::thread::Builder::new().name("lumicast-get".into()).spawn(work);
        receiver
    }
}

fn get(url: &str) -> Result<String, String> {
    let config = ureq::Agent::config_builder().timeout_global(Some(GET_MAX)).http_status_as_error(false);
    let agent: ureq::Agent = config.build().into();
    let mut answer = agent.get(url).call().map_err(|error| error.to_string())?;
    let status = answer.status().as_u16();
    let body = answer.body_mut().with_config().limit(ANSWER_BYTES_MAX).read_to_vec();
    let body = body.map_err(|error| error.to_string())?;
    if !(200..300).contains(&status) {
        return Err(refusal(status, &body));
    }
    String::from_utf8(body).map_err(|_| "the answer is not UTF-8".into())
}

/// One connection, from the thread that serves it.
struct Line {
    events: mpsc::Sender<WireEvent>,
    texts: mpsc::Receiver<String>,
    wake: Wake,
}

/// Why a connection ended, and whether trying again is useless.
struct End {
    reason: String,
    is_final: bool,
}

impl End {
    fn again(reason: impl ToString) -> Self {
        Self { reason: reason.to_string(), is_final: false }
    }

    fn for_good(reason: impl ToString) -> Self {
        Self { reason: reason.to_string(), is_final: true }
    }
}

impl Line {
    fn run(mut self, url: &str) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
        let end = match runtime {
            Ok(runtime) => runtime.block_on(self.talk(url)),
            Err(error) => Err(End::again(error)),
        };
        if let Err(End { reason, is_final }) = end {
            // Blocking, but not for ever: when the window has dropped the wire this fails at once.
            let _ = self.events.blocking_send(WireEvent::Closed { reason, is_final });
            (self.wake)();
        }
    }

    /// Returns when the window has dropped the wire; an error when the line broke.
    async fn talk(&mut self, url: &str) -> Result<(), End> {
        let mut request = url.into_client_request().map_err(End::for_good)?;
        request.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(SUBPROTOCOL));
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_BYTES_MAX))
            .max_frame_size(Some(MESSAGE_BYTES_MAX));
        // No Nagle: a camera message must not wait for the one before to be acknowledged.
        let opening = tokio_tungstenite::connect_async_with_config(request, Some(config), true);
        let (mut socket, _) = opening.await.map_err(why_not_opened)?;
        self.tell(WireEvent::Opened).await?;
        loop {
            tokio::select! {
                text = self.texts.recv() => match text {
                    Some(text) => socket.send(Message::text(text)).await.map_err(End::again)?,
                    None => {
                        // Goodbye is a courtesy: a server that is gone need not hear it.
                        let _ = tokio::time::timeout(Duration::from_millis(200), socket.close(None)).await;
                        return Ok(());
                    }
                },
                message = socket.next() => match message {
                    Some(Ok(Message::Text(text))) => self.tell(WireEvent::Text(text.to_string())).await?,
                    Some(Ok(Message::Binary(bytes))) => self.tell(WireEvent::from_binary(&bytes)).await?,
                    Some(Ok(Message::Close(frame))) => return Err(End::again(why_closed(frame))),
                    // tungstenite answers pings by itself.
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Err(End::again(error)),
                    None => return Err(End::again("the server closed the connection")),
                },
            }
        }
    }

    async fn tell(&self, event: WireEvent) -> Result<(), End> {
        // Where the window is gone, `texts` ends in the next turn.
        let _ = self.events.send(event).await;
        (self.wake)();
        Ok(())
    }
}

fn why_not_opened(error: Error) -> End {
    match error {
        Error::Http(answer) => {
            let status = answer.status().as_u16();
            let reason = refusal(status, answer.body().as_deref().unwrap_or_default());
            // The scene is not there, and by itself it will not come. Too many viewers, or starting: it may.
            if status == 404 { End::for_good(reason) } else { End::again(reason) }
        }
        Error::Url(error) => End::for_good(error),
        // The handshake's own check of the subprotocol.
        Error::Protocol(error) if error.to_string().to_lowercase().contains("subprotocol") => {
            End::for_good(format!("the server does not speak {SUBPROTOCOL}"))
        }
        other => End::again(other),
    }
}

fn why_closed(frame: Option<CloseFrame>) -> String {
    let Some(frame) = frame else { return "the server closed the connection".into() };
    let code = u16::from(frame.code);
    let meaning = match code {
        1001 => "the server stops, or the scene was deleted",
        1008 => "the server found this viewer at fault",
        1009 => "a message was too large for the server",
        1011 => "the server failed",
        _ => "the server closed the connection",
    };
    if frame.reason.is_empty() {
        format!("{meaning} ({code})")
    } else {
        format!("{meaning} ({code}): {}", frame.reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::{TcpListener, TcpStream};
    use std::sync::Arc;
    use std::sync::mpsc::{Sender, channel};

    /// A server of one connection, on a port of its own, that does what it is told.
    fn server(serve: impl FnOnce(TcpStream) + Send + 'static) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || serve(listener.accept().unwrap().0));
        address.to_string()
    }

    fn wake() -> (Wake, Receiver<()>) {
        let (sender, receiver): (Sender<()>, _) = channel();
        (Arc::new(move || sender.send(()).unwrap_or_default()), receiver)
    }

    /// The next event, by waiting for its wake-up.
    fn next(wire: &mut dyn Wire, woken: &Receiver<()>) -> WireEvent {
        loop {
            if let Some(event) = wire.poll() {
                return event;
            }
            woken.recv_timeout(Duration::from_secs(20)).expect("nothing came");
        }
    }

    #[allow(clippy::result_large_err, reason = "the signature is tungstenite's")]
    fn accept(stream: TcpStream, subprotocol: &'static str) -> tungstenite::WebSocket<TcpStream> {
        use tungstenite::handshake::server::{Request, Response};
        tungstenite::accept_hdr(stream, |request: &Request, mut response: Response| {
            assert_eq!(request.headers()[SEC_WEBSOCKET_PROTOCOL], SUBPROTOCOL);
            response.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(subprotocol));
            Ok(response)
        })
        .unwrap()
    }
    use tokio_tungstenite::tungstenite;

    fn closed(event: WireEvent) -> (String, bool) {
        match event {
            WireEvent::Closed { reason, is_final } => (reason, is_final),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn texts_go_both_ways_pictures_come_and_the_end_is_told() {
        let address = server(|stream| {
            let mut socket = accept(stream, SUBPROTOCOL);
            let said = socket.read().unwrap();
            socket.send(said).unwrap();
            socket.send(Message::binary(b"no picture".to_vec())).unwrap();
            socket.close(None).unwrap();
            while socket.read().is_ok() {}
        });
        let (wake, woken) = wake();
        let mut wire = Native.open(&format!("ws://{address}/v1/scenes/a/ws"), wake);
        assert!(matches!(next(&mut *wire, &woken), WireEvent::Opened));
        assert!(wire.has_room());
        wire.send("häh?".into());
        assert!(matches!(next(&mut *wire, &woken), WireEvent::Text(text) if text == "häh?"));
        match next(&mut *wire, &woken) {
            WireEvent::Picture { picture, frame } => assert!(picture.is_err() && frame.is_none()),
            other => panic!("{other:?}"),
        }
        assert!(!closed(next(&mut *wire, &woken)).1);
    }

    #[test]
    fn an_unknown_scene_is_final_and_a_server_that_is_down_is_not() {
        let address = server(|mut stream| {
            let _ = stream.read(&mut [0; 4096]);
            let body = r#"{"type":"urn:lumicast:problem:not-found","title":"There is no such thing","status":404,"detail":"no scene \"a\""}"#;
            let head = "HTTP/1.1 404 Not Found\r\nContent-Type: application/problem+json\r\n";
            let answer = format!("{head}Content-Length: {}\r\n\r\n{body}", body.len());
            // In one write, as servers do: tungstenite's handshake keeps of a body only what came with the head.
            stream.write_all(answer.as_bytes()).unwrap();
        });
        let (wake, woken) = wake();
        let mut wire = Native.open(&format!("ws://{address}/"), wake.clone());
        let (reason, is_final) = closed(next(&mut *wire, &woken));
        assert!(is_final && reason.contains("no scene \"a\""), "{reason}");
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut wire = Native.open(&format!("ws://{free}/"), wake);
        assert!(!closed(next(&mut *wire, &woken)).1);
    }

    #[test]
    fn a_server_of_another_subprotocol_is_refused() {
        let address = server(|stream| {
            let mut socket = accept(stream, "other.v1");
            while socket.read().is_ok() {}
        });
        let (wake, woken) = wake();
        let mut wire = Native.open(&format!("ws://{address}/"), wake);
        let (reason, is_final) = closed(next(&mut *wire, &woken));
        assert!(is_final, "{reason}");
    }

    #[test]
    fn a_window_that_does_not_look_stops_the_reading() {
        let (count_sender, counted) = channel();
        let address = server(move |stream| {
            stream.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
            let mut socket = accept(stream, SUBPROTOCOL);
            let mut sent = 0;
            // 1 MiB each: more than the buffers of two sockets and 32 waiting messages hold is never taken.
            while sent < 200 && socket.send(Message::text("x".repeat(1 << 20))).is_ok() {
                sent += 1;
            }
            count_sender.send(sent).unwrap();
        });
        let (wake, _woken) = wake();
        let wire = Native.open(&format!("ws://{address}/"), wake);
        let sent = counted.recv_timeout(Duration::from_secs(60)).unwrap();
        assert!(sent < 100, "{sent} messages were taken from a server that nobody listens to");
        drop(wire);
    }

    #[test]
    fn http_answers_and_refusals_come_back_in_words() {
        let answer = |status: &'static str, body: &'static str| {
            server(move |mut stream| {
                let _ = stream.read(&mut [0; 4096]);
                write!(stream, "HTTP/1.1 {status}\r\nContent-Length: {}\r\n\r\n{body}", body.len()).unwrap();
            })
        };
        let ask = |address: String| {
            let (wake, _woken) = wake();
            Native
                .get(&format!("http://{address}/v1/scenes"), wake)
                .recv_timeout(Duration::from_secs(20))
                .unwrap()
        };
        assert_eq!(ask(answer("200 OK", r#"{"scenes":[]}"#)), Ok(r#"{"scenes":[]}"#.into()));
        assert!(ask(answer("500 No", "oops")).unwrap_err().contains("500"));
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        assert!(ask(free.to_string()).is_err());
    }
}
