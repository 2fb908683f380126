//! A viewer on a thread of its own that acknowledges every picture and writes down when it came.

use std::net::SocketAddr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lumicast_protocol::{FrameHeader, Problem, Quality, ServerMessage};
use lumicast_tests::{Event, PATIENCE, Viewer};

/// How long an order (an edit to send) may wait while nothing arrives. Short beside the time of a frame.
const ORDER_PERIOD: Duration = Duration::from_millis(2);

/// A picture that came.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen {
    pub(crate) at: Instant,
    pub(crate) number: u64,
    pub(crate) revision: u64,
    pub(crate) samples: u32,
}

/// What became of an edit over the WebSocket.
#[derive(Debug)]
pub(crate) enum Answer {
    Edited(u64),
    Refused(Problem),
}

enum Order {
    Say(String),
    /// Reads nothing until the channel says so, or is closed.
    Stall(mpsc::Receiver<()>),
    End,
}

#[derive(Debug, Default)]
struct Notes {
    /// The first picture of every revision that was seen, in order.
    first_of_revision: Vec<Seen>,
    frame_count: u64,
    answers: Vec<(u64, Answer)>,
    errors: Vec<String>,
    has_ended: bool,
}

#[derive(Debug, Default)]
struct Notebook {
    notes: Mutex<Notes>,
    news: Condvar,
}

impl Notebook {
    fn notes(&self) -> MutexGuard<'_, Notes> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, change: impl FnOnce(&mut Notes)) {
        change(&mut self.notes());
        self.news.notify_all();
    }

    /// Waits until `found` finds something, the viewer has ended or the time is up.
    fn wait_for<T>(&self, patience: Duration, mut found: impl FnMut(&mut Notes) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + patience;
        let mut notes = self.notes();
        loop {
            if let Some(what) = found(&mut notes) {
                return Some(what);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if notes.has_ended || left.is_zero() {
                return None;
            }
            notes = self.news.wait_timeout(notes, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// The other end of the thread.
pub(crate) struct Watcher {
    orders: mpsc::Sender<Order>,
    notebook: Arc<Notebook>,
    wake: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watcher {
    pub(crate) fn start(server: SocketAddr, camera: &str, size: [u16; 2], quality: Quality) -> Watcher {
        let mut viewer = Viewer::connect(server, "cornell-box");
        viewer.set_quality(quality);
        viewer.watch(camera, size);
        let (orders, taken) = mpsc::channel();
        let notebook = Arc::new(Notebook::default());
        let thread = std::thread::spawn({
            let notebook = notebook.clone();
            move || {
                let _end = Ending(&notebook);
                watch(viewer, &taken, &notebook, size);
            }
        });
        Watcher { orders, notebook, wake: None, thread: Some(thread) }
    }

    /// Sends an edit and waits for its answer.
    pub(crate) fn edit(&self, request: u64, message: String) -> Answer {
        self.orders.send(Order::Say(message)).expect("the viewer lives");
        let answer = self.notebook.wait_for(PATIENCE, |notes| {
            let index = notes.answers.iter().position(|(known, _)| *known == request)?;
            Some(notes.answers.swap_remove(index).1)
        });
        answer.unwrap_or_else(|| panic!("no answer to request {request}: {}", self.summary()))
    }

    /// Stops reading, as a viewer on a broken network does.
    pub(crate) fn stall(&mut self) {
        let (wake, woken) = mpsc::channel();
        self.wake = Some(wake);
        self.orders.send(Order::Stall(woken)).expect("the viewer lives");
    }

    pub(crate) fn resume(&mut self) {
        self.wake = None;
    }

    pub(crate) fn is_stalled(&self) -> bool {
        self.wake.is_some()
    }

    /// The first picture that shows this revision or a later one.
    pub(crate) fn frame_of(&self, revision: u64, patience: Duration) -> Option<Seen> {
        self.notebook.wait_for(patience, |notes| {
            // Searched from the end: that is where it is.
            let later = notes.first_of_revision.iter().rev().take_while(|seen| seen.revision >= revision);
            later.last().copied()
        })
    }

    pub(crate) fn frame_count(&self) -> u64 {
        self.notebook.notes().frame_count
    }

    /// Whatever a viewer must never see.
    pub(crate) fn errors(&self) -> Vec<String> {
        self.notebook.notes().errors.clone()
    }

    pub(crate) fn summary(&self) -> String {
        let notes = self.notebook.notes();
        let last = notes.first_of_revision.last();
        format!("{} frames, errors {:?}, last new revision in {last:?}", notes.frame_count, notes.errors)
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.wake = None;
        // The thread may have ended by a panic, which the test has noticed as an error or a missing picture.
        let _ = self.orders.send(Order::End);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Says that the viewer has ended, be it by a panic.
struct Ending<'a>(&'a Notebook);

impl Drop for Ending<'_> {
    fn drop(&mut self) {
        self.0.write(|notes| {
            notes.has_ended = true;
            if std::thread::panicking() {
                notes.errors.push("the viewer's thread panicked".into());
            }
        });
    }
}

fn watch(mut viewer: Viewer, orders: &mpsc::Receiver<Order>, notebook: &Notebook, size: [u16; 2]) {
    loop {
        match orders.try_recv() {
            Ok(Order::Say(text)) => viewer.say_text(text),
            // Ends when the other end is dropped.
            Ok(Order::Stall(woken)) => drop(woken.recv()),
            Ok(Order::End) | Err(mpsc::TryRecvError::Disconnected) => return viewer.close(),
            Err(mpsc::TryRecvError::Empty) => {}
        }
        match viewer.next(Instant::now() + ORDER_PERIOD) {
            Some(Event::Frame(header, _)) => {
                let at = Instant::now();
                viewer.acknowledge(header.frame);
                notebook.write(|notes| note(notes, &header, at, size));
            }
            Some(Event::Message(ServerMessage::Edited { request, revision })) => {
                notebook.write(|notes| notes.answers.push((request, Answer::Edited(revision))));
            }
            Some(Event::Message(ServerMessage::Error { problem, request: Some(request) })) => {
                notebook.write(|notes| notes.answers.push((request, Answer::Refused(problem))));
            }
            Some(Event::Message(ServerMessage::Error { problem, request: None })) => {
                notebook.write(|notes| notes.errors.push(format!("{problem:?}")));
            }
            Some(Event::Message(_)) | None => {}
        }
    }
}

fn note(notes: &mut Notes, header: &FrameHeader, at: Instant, size: [u16; 2]) {
    notes.frame_count += 1;
    let last = notes.first_of_revision.last().map_or(0, |seen| seen.revision);
    if header.frame != notes.frame_count {
        notes.errors.push(format!("frame {} came as the {}th", header.frame, notes.frame_count));
    }
    if header.full_size != size {
        notes
            .errors
            .push(format!("frame {} is for {:?}, asked for {size:?}", header.frame, header.full_size));
    }
    if header.revision < last {
        notes
            .errors
            .push(format!("frame {} goes back from revision {last} to {}", header.frame, header.revision));
    }
    if header.revision > last {
        let (number, revision, samples) = (header.frame, header.revision, header.samples);
        notes.first_of_revision.push(Seen { at, number, revision, samples });
    }
}
