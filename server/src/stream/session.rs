//! The session of one viewer, from hello to close.

use super::rate::{Rate, Verdict};
use crate::scenes::{Scene, Viewer, Workshop};
use crate::shutdown::Stopping;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, close_code};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use lumicast_protocol::{
    ClientMessage, EditRequest, Limits, Problem, ProblemKind, SUBPROTOCOL, ServerHello, ServerMessage,
    request_of,
};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc};

/// Answers on their way to a client that does not read them. Small: the reader waits when it is full.
const ANSWERS_MAX: usize = 64;
/// Between two `stats`.
const STATS_PERIOD: Duration = Duration::from_millis(250);
/// How long a close may take to reach the client.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// One viewer's session.
#[derive(Debug)]
pub struct Session {
    scene: Arc<Scene>,
    viewer: Arc<Viewer>,
    workshop: Arc<Workshop>,
    stopping: Stopping,
    limits: Limits,
}

/// A viewer leaves its scene whatever ends the session, a panic or an upgrade that never came included.
impl Drop for Session {
    fn drop(&mut self) {
        self.scene.leave(&self.viewer);
    }
}

/// Why a session ends: close code and words for the client.
type Ending = (u16, &'static str);

/// What the writer is told, in order.
#[derive(Debug)]
enum Answer {
    Message(ServerMessage),
    Close(Ending),
}

impl Session {
    /// A session of a viewer that has joined.
    pub fn new(
        scene: Arc<Scene>,
        viewer: Arc<Viewer>,
        workshop: Arc<Workshop>,
        stopping: Stopping,
    ) -> Session {
        let limits = workshop.config.limits();
        Session { scene, viewer, workshop, stopping, limits }
    }

    /// Runs until either side ends it.
    pub async fn run(self, socket: WebSocket) {
        let (sink, stream) = socket.split();
        let (answers, queue) = mpsc::channel(ANSWERS_MAX);
        tracing::debug!(scene = %self.scene.id(), viewer = self.viewer.id(), "connected");
        let writer = self.write(sink, queue);
        let reader = async {
            let ending = self.read(stream, &answers).await;
            if let Some(ending) = ending {
                // The writer may be gone already.
                let _ = answers.send(Answer::Close(ending)).await;
            }
            drop(answers);
        };
        // The reader's end lets the writer finish its answers; the writer's end means a dead socket.
        let mut reader = std::pin::pin!(reader);
        let mut writer = std::pin::pin!(writer);
        tokio::select! {
            () = &mut writer => {}
            () = &mut reader => {
                // A client that reads nothing must not keep the session.
                let _ = tokio::time::timeout(CLOSE_TIMEOUT, writer).await;
            }
        }
        tracing::debug!(scene = %self.scene.id(), viewer = self.viewer.id(), "disconnected");
    }

    /// Takes messages until the end; `None` where the client closed or the socket died.
    async fn read(
        &self,
        mut stream: SplitStream<WebSocket>,
        answers: &mpsc::Sender<Answer>,
    ) -> Option<Ending> {
        let mut stopping = self.stopping.clone();
        let mut closed = self.scene.watch_closed();
        let mut rate = Rate::new(self.limits.messages_per_second, Instant::now());
        let edits = Arc::new(Semaphore::new(self.workshop.config.edits_in_flight as usize));
        let hello_by = Instant::now() + Duration::from_secs(self.limits.hello_seconds.into());
        let mut greeted = false;
        loop {
            let idle = Duration::from_secs(self.limits.idle_seconds.into());
            let wait = if greeted { idle } else { hello_by.saturating_duration_since(Instant::now()) };
            let received = tokio::select! {
                () = stopping.wait() => return Some((close_code::AWAY, "the server stops")),
                _ = closed.wait_for(|closed| *closed) => {
                    return Some((close_code::AWAY, "the scene was deleted or the server stops"));
                }
                received = tokio::time::timeout(wait, stream.next()) => received,
            };
            let message = match received {
                Err(_) if greeted => return Some((close_code::POLICY, "silence")),
                Err(_) => return Some((close_code::POLICY, "no hello in time")),
                Ok(None) => return None,
                Ok(Some(Err(error))) => {
                    tracing::debug!(viewer = self.viewer.id(), %error, "the socket failed");
                    return failure_of(&error);
                }
                Ok(Some(Ok(message))) => message,
            };
            match message {
                Message::Text(text) => {
                    if let Some(ending) = self.take(&text, &mut rate, &mut greeted, answers, &edits).await {
                        return Some(ending);
                    }
                }
                Message::Binary(_) => {
                    self.refuse(answers, None, malformed("clients send text messages only")).await;
                }
                // axum answers pings by itself.
                Message::Ping(_) | Message::Pong(_) => {}
                Message::Close(_) => return None,
            }
        }
    }

    async fn take(
        &self,
        text: &str,
        rate: &mut Rate,
        greeted: &mut bool,
        answers: &mpsc::Sender<Answer>,
        edits: &Arc<Semaphore>,
    ) -> Option<Ending> {
        self.workshop.metrics.messages_received.one();
        let message = match ClientMessage::from_json(text) {
            Ok(message) => message,
            Err(_) if !*greeted => return Some((close_code::POLICY, "say hello first")),
            Err(error) => {
                let counted = rate.one_more(Instant::now());
                let request = request_of(text);
                self.refuse(answers, request, Problem::from(error)).await;
                return disconnected(counted);
            }
        };
        let counted = match message {
            ClientMessage::Ack { .. } | ClientMessage::Ping { .. } => Verdict::Take,
            _ => rate.one_more(Instant::now()),
        };
        if counted != Verdict::Take {
            let detail = format!("more than {} messages a second", self.limits.messages_per_second);
            let request = match &message {
                ClientMessage::Edit(edit) => Some(edit.request),
                _ => None,
            };
            self.refuse(answers, request, Problem::new(ProblemKind::TooMany, detail)).await;
            return disconnected(counted);
        }
        if let Err(error) = self.limits.check(&message) {
            let request = match &message {
                ClientMessage::Edit(edit) => Some(edit.request),
                _ => None,
            };
            self.refuse(answers, request, error.into()).await;
            return None;
        }
        match (message, *greeted) {
            (ClientMessage::Hello(hello), false) => {
                *greeted = true;
                tracing::info!(
                    scene = %self.scene.id(), viewer = self.viewer.id(), client = hello.client,
                    version = hello.version, "viewer"
                );
                self.greet(answers).await;
            }
            (_, false) => return Some((close_code::POLICY, "say hello first")),
            (ClientMessage::Hello(_), true) => {
                self.refuse(answers, None, malformed("a second hello")).await;
            }
            (ClientMessage::Camera(camera), true) => {
                self.done_or_refuse(answers, self.scene.set_camera(&self.viewer, camera)).await;
            }
            (ClientMessage::Quality(quality), true) => self.scene.set_quality(&self.viewer, quality),
            (ClientMessage::Accuracy(accuracy), true) => {
                self.done_or_refuse(answers, self.scene.set_accuracy(&self.viewer, accuracy)).await;
            }
            (ClientMessage::Edit(edit), true) => self.edit(edit, answers, edits).await,
            (ClientMessage::Ack { frame }, true) => {
                self.done_or_refuse(answers, self.scene.acknowledge(&self.viewer, frame)).await;
            }
            (ClientMessage::Ping { stamp }, true) => {
                let _ = answers.send(Answer::Message(ServerMessage::Pong { stamp })).await;
            }
        }
        None
    }

    // A failed `send` below means that the writer has ended, and then the session does too.

    async fn greet(&self, answers: &mpsc::Sender<Answer>) {
        let hello = ServerHello {
            protocol: SUBPROTOCOL.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            scene: self.scene.id().clone(),
            revision: self.scene.revision(),
            viewer: self.viewer.id(),
            limits: self.limits.clone(),
        };
        let _ = answers.send(Answer::Message(ServerMessage::Hello(hello))).await;
    }

    async fn done_or_refuse(&self, answers: &mpsc::Sender<Answer>, done: Result<(), Problem>) {
        if let Err(problem) = done {
            self.refuse(answers, None, problem).await;
        }
    }

    async fn refuse(&self, answers: &mpsc::Sender<Answer>, request: Option<u64>, problem: Problem) {
        self.workshop.metrics.messages_refused.one();
        let _ = answers.send(Answer::Message(ServerMessage::Error { problem, request })).await;
    }

    /// Queues a batch in the order of the messages; its answer comes when it comes, cameras go on meanwhile.
    async fn edit(&self, edit: EditRequest, answers: &mpsc::Sender<Answer>, edits: &Arc<Semaphore>) {
        let EditRequest { request, if_match, idempotency_key, edits: batch } = edit;
        let Ok(permit) = edits.clone().try_acquire_owned() else {
            let most = self.workshop.config.edits_in_flight;
            let detail =
                format!("{most} batches of this connection wait for their answer (`edits_in_flight`)");
            self.refuse(answers, Some(request), Problem::new(ProblemKind::TooMany, detail)).await;
            return;
        };
        let answer = match self.scene.submit(batch, if_match, idempotency_key) {
            Ok(answer) => answer,
            Err(problem) => return self.refuse(answers, Some(request), problem).await,
        };
        let (answers, scene) = (answers.downgrade(), self.scene.clone());
        let workshop = self.workshop.clone();
        tokio::spawn(async move {
            let _permit = permit;
            let message = match answer.await.unwrap_or_else(|_| Err(scene.gone())) {
                Ok(reply) => ServerMessage::Edited { request, revision: reply.revision },
                Err(problem) => {
                    workshop.metrics.messages_refused.one();
                    ServerMessage::Error { problem, request: Some(request) }
                }
            };
            if let Some(answers) = answers.upgrade() {
                let _ = answers.send(Answer::Message(message)).await;
            }
        });
    }

    /// Sends answers and pictures until the queue ends or the socket dies.
    async fn write(&self, mut sink: SplitSink<WebSocket, Message>, mut queue: mpsc::Receiver<Answer>) {
        let mut revision = self.scene.watch_revision();
        let mut ticks = tokio::time::interval(STATS_PERIOD);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut last_stats = None;
        let mut last_ping = Instant::now();
        // Three pings fit into the time after which silence ends a session.
        let ping_period = Duration::from_secs(self.limits.idle_seconds.into()) / 3;
        let mut greeted = false;
        loop {
            let sent = tokio::select! {
                biased;
                answer = queue.recv() => match answer {
                    Some(Answer::Message(message)) => {
                        let sent = send(&mut sink, &message).await;
                        match message {
                            ServerMessage::Hello(_) if sent.is_ok() => {
                                greeted = true;
                                revision.mark_unchanged();
                                self.send_scene(&mut sink).await
                            }
                            _ => sent,
                        }
                    }
                    Some(Answer::Close((code, reason))) => {
                        let frame = CloseFrame { code, reason: Utf8Bytes::from_static(reason) };
                        let _ = send_within(&mut sink, Message::Close(Some(frame))).await;
                        return;
                    }
                    None => {
                        let _ = sink.close().await;
                        return;
                    }
                },
                Ok(()) = revision.changed(), if greeted => self.send_scene(&mut sink).await,
                () = self.viewer.news() => self.send_news(&mut sink).await,
                _ = ticks.tick() => {
                    let stats = self.viewer.stats();
                    if last_ping.elapsed() >= ping_period {
                        last_ping = Instant::now();
                        send_within(&mut sink, Message::Ping(Vec::new().into())).await
                    } else if let Some(fresh) = stats.filter(|fresh| Some(fresh) != last_stats.as_ref()) {
                        let sent = send(&mut sink, &ServerMessage::Stats(fresh.clone())).await;
                        last_stats = Some(fresh);
                        sent
                    } else {
                        Ok(())
                    }
                }
            };
            if sent.is_err() {
                return;
            }
        }
    }

    async fn send_scene(&self, sink: &mut SplitSink<WebSocket, Message>) -> Result<(), axum::Error> {
        let scene = self.scene.clone();
        // Telling a large scene takes a while; all viewers share the one of a revision.
        let described = tokio::task::spawn_blocking(move || {
            let scene = Box::new(scene.description().as_ref().clone());
            ServerMessage::Scene { scene }.to_json()
        });
        match described.await {
            Ok(json) => send_within(sink, Message::Text(json.into())).await,
            Err(error) => {
                tracing::error!(%error, "a scene could not be told");
                Ok(())
            }
        }
    }

    async fn send_news(&self, sink: &mut SplitSink<WebSocket, Message>) -> Result<(), axum::Error> {
        if let Some(problem) = self.viewer.take_problem() {
            send(sink, &ServerMessage::Error { problem, request: None }).await?;
        }
        while let Some(outgoing) = self.viewer.take_picture() {
            let metrics = &self.workshop.metrics;
            metrics.frames_sent.one();
            metrics.frame_bytes_sent.add(outgoing.message.len() as u64);
            if let Some(latency) = outgoing.first_from_camera {
                metrics.frame_latency.record(latency);
            }
            send_within(sink, Message::Binary(outgoing.message.into())).await?;
        }
        Ok(())
    }
}

async fn send(sink: &mut SplitSink<WebSocket, Message>, message: &ServerMessage) -> Result<(), axum::Error> {
    send_within(sink, Message::Text(message.to_json().into())).await
}

/// How long a message may wait for a client that does not read. The session then ends: while its writer waits, nobody
/// would see that it idles, that its scene is gone, or that the server stops.
const SEND_SECONDS_MAX: u64 = 60;

async fn send_within(sink: &mut SplitSink<WebSocket, Message>, message: Message) -> Result<(), axum::Error> {
    match tokio::time::timeout(Duration::from_secs(SEND_SECONDS_MAX), sink.send(message)).await {
        Ok(sent) => sent,
        Err(elapsed) => Err(axum::Error::new(elapsed)),
    }
}

fn malformed(detail: &str) -> Problem {
    Problem::new(ProblemKind::Malformed, detail)
}

fn disconnected(verdict: Verdict) -> Option<Ending> {
    (verdict == Verdict::Disconnect).then_some((close_code::POLICY, "far too many messages"))
}

/// The close code for a socket error that the client can do something about.
fn failure_of(error: &axum::Error) -> Option<Ending> {
    let text = error.to_string();
    // axum hides tungstenite's types; the texts are pinned by a test.
    if text.contains("too long") || text.contains("too big") {
        Some((close_code::SIZE, "a message above message_bytes: send it over HTTP"))
    } else if text.contains("UTF-8") || text.contains("utf-8") {
        Some((close_code::INVALID, "text that is not UTF-8"))
    } else if text.contains("protocol") {
        Some((close_code::PROTOCOL, "not the WebSocket protocol"))
    } else {
        None
    }
}
