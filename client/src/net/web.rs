//! The browser's line: its WebSocket and fetch. One thread, so pictures are decoded where they come in.

use super::{ANSWER_BYTES_MAX, INCOMING_MAX, Network, Wake, Wire, WireEvent};
use lumicast_protocol::SUBPROTOCOL;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::mpsc::Receiver;
use wasm_bindgen::prelude::*;
use web_sys::{BinaryType, CloseEvent, MessageEvent, WebSocket};

/// What a browser may hold of what is to go; beyond it there is no room.
const BUFFERED_BYTES_MAX: u32 = 1 << 20;

/// Sockets of the browser.
#[derive(Debug, Default, Clone, Copy)]
pub struct Web;

#[derive(Clone)]
struct Inbox {
    events: Rc<RefCell<VecDeque<WireEvent>>>,
    wake: Wake,
}

impl Inbox {
    fn put(&self, event: WireEvent) {
        self.events.borrow_mut().push_back(event);
        (self.wake)();
    }

    /// A browser reads on whatever happens, so a server that floods can only be left.
    fn is_full(&self) -> bool {
        self.events.borrow().len() >= INCOMING_MAX
    }
}

struct WebWire {
    socket: Option<WebSocket>,
    inbox: Inbox,
    /// Kept alive as long as the socket may call them.
    _on_open: Option<Closure<dyn FnMut()>>,
    _on_message: Option<Closure<dyn FnMut(MessageEvent)>>,
    _on_close: Option<Closure<dyn FnMut(CloseEvent)>>,
}

impl Wire for WebWire {
    fn poll(&mut self) -> Option<WireEvent> {
        self.inbox.events.borrow_mut().pop_front()
    }

    fn has_room(&self) -> bool {
        self.socket.as_ref().is_some_and(|socket| {
            socket.ready_state() == WebSocket::OPEN && socket.buffered_amount() < BUFFERED_BYTES_MAX
        })
    }

    fn send(&mut self, text: String) {
        if let Some(socket) = &self.socket {
            // A socket that has just closed says so by itself.
            let _ = socket.send_with_str(&text);
        }
    }
}

impl Drop for WebWire {
    fn drop(&mut self) {
        if let Some(socket) = &self.socket {
            socket.set_onopen(None);
            socket.set_onmessage(None);
            socket.set_onclose(None);
            let _ = socket.close();
        }
    }
}

impl Network for Web {
    fn open(&self, url: &str, wake: Wake) -> Box<dyn Wire> {
        let inbox = Inbox { events: Rc::default(), wake };
        let socket = match WebSocket::new_with_str(url, SUBPROTOCOL) {
            Ok(socket) => socket,
            Err(error) => {
                inbox.put(WireEvent::Closed { reason: format!("{url}: {error:?}"), is_final: true });
                return Box::new(WebWire {
                    socket: None,
                    inbox,
                    _on_open: None,
                    _on_message: None,
                    _on_close: None,
                });
            }
        };
        socket.set_binary_type(BinaryType::Arraybuffer);
        let on_open = opened(&inbox);
        let on_message = received(&inbox, &socket);
        let on_close = closed(&inbox);
        socket.set_onopen(Some(on_open.as_ref().unchecked_ref()));
        socket.set_onmessage(Some(on_message.as_ref().unchecked_ref()));
        socket.set_onclose(Some(on_close.as_ref().unchecked_ref()));
        Box::new(WebWire {
            socket: Some(socket),
            inbox,
            _on_open: Some(on_open),
            _on_message: Some(on_message),
            _on_close: Some(on_close),
        })
    }

    fn get(&self, url: &str, wake: Wake) -> Receiver<Result<String, String>> {
        let (answer, receiver) = std::sync::mpsc::sync_channel(1);
        ehttp::fetch(ehttp::Request::get(url), move |result| {
            let body = result.and_then(|response| match response.text() {
                _ if !response.ok => Err(super::refusal(response.status, &response.bytes)),
                Some(text) if (text.len() as u64) <= ANSWER_BYTES_MAX => Ok(text.to_owned()),
                _ => Err("the answer is too long or not UTF-8".into()),
            });
            // The asker may have gone.
            let _ = answer.send(body);
            wake();
        });
        receiver
    }
}

fn opened(inbox: &Inbox) -> Closure<dyn FnMut()> {
    let inbox = inbox.clone();
    Closure::new(move || inbox.put(WireEvent::Opened))
}

fn received(inbox: &Inbox, socket: &WebSocket) -> Closure<dyn FnMut(MessageEvent)> {
    let (inbox, socket) = (inbox.clone(), socket.clone());
    Closure::new(move |message: MessageEvent| {
        if inbox.is_full() {
            let _ = socket.close();
            return;
        }
        let data = message.data();
        match (data.as_string(), data.dyn_into::<js_sys::ArrayBuffer>()) {
            (Some(text), _) => inbox.put(WireEvent::Text(text)),
            (None, Ok(bytes)) => inbox.put(WireEvent::from_binary(&js_sys::Uint8Array::new(&bytes).to_vec())),
            (None, Err(_)) => {}
        }
    })
}

fn closed(inbox: &Inbox) -> Closure<dyn FnMut(CloseEvent)> {
    let inbox = inbox.clone();
    Closure::new(move |event: CloseEvent| {
        // A browser does not tell a page why a socket could not be opened (1006).
        let reason = match event.code() {
            1006 => "no connection to the server".to_owned(),
            code => format!("the server closed the connection ({code}) {}", event.reason()),
        };
        inbox.put(WireEvent::Closed { reason, is_final: false });
    })
}
