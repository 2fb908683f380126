//! `/v1/scenes/{id}/events`: accepted batches as server-sent events.

use super::{HttpProblem, Service};
use crate::scenes::Scene;
use crate::shutdown::Stopping;
use axum::extract::{Path, State};
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{self, Stream};
use lumicast_protocol::EventEntry;
use std::convert::Infallible;
use std::sync::Arc;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::sync::watch;

/// Follows the scene: where it is, then one event per revision. A listener that falls too far behind is told so (`event: lagged`) and
/// dropped; `GET edits?since=` has what it missed.
#[utoipa::path(get, path = "/v1/scenes/{id}/events", tag = "edits",
    params(("id" = String, Path, description = "Scene")),
    responses(
        (status = 200, description = "First `event: revision`, data `{\"revision\": N}`: where the scene is; then for every batch `event: edit`, id: the revision, data: an EventEntry; at the end `event: lagged`, data `{\"missed\": N}`, for a listener that fell behind, or `event: closed`, data `{}`, when the scene or the server goes", body = ref("#/components/schemas/EventEntry"), content_type = "text/event-stream"),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 429, description = "Too many listeners", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, HttpProblem> {
    let scene = service.scene(&id)?;
    let follower = Follower {
        events: scene.events()?,
        closed: scene.watch_closed(),
        stopping: service.stopping.clone(),
        hello: Some(scene),
        done: false,
    };
    let stream = stream::unfold(follower, |mut follower| async move {
        let event = follower.next().await?;
        Some((Ok(event), follower))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::default()))
}

struct Follower {
    events: Receiver<Arc<EventEntry>>,
    closed: watch::Receiver<bool>,
    stopping: Stopping,
    /// For the first event, which tells where the scene is: who follows then knows that nothing is missing.
    hello: Option<Arc<Scene>>,
    done: bool,
}

impl Follower {
    async fn next(&mut self) -> Option<Event> {
        if self.done {
            return None;
        }
        if let Some(scene) = self.hello.take() {
            let revision = scene.revision();
            let data = format!("{{\"revision\":{revision}}}");
            return Some(Event::default().event("revision").id(revision.to_string()).data(data));
        }
        let received = tokio::select! {
            received = self.events.recv() => received,
            _ = self.closed.wait_for(|closed| *closed) => Err(RecvError::Closed),
            () = self.stopping.wait() => Err(RecvError::Closed),
        };
        match received {
            Ok(entry) => {
                let data = serde_json::to_string(&*entry).unwrap_or_default();
                Some(Event::default().event("edit").id(entry.revision.to_string()).data(data))
            }
            Err(RecvError::Lagged(missed)) => {
                self.done = true;
                Some(Event::default().event("lagged").data(format!("{{\"missed\":{missed}}}")))
            }
            Err(RecvError::Closed) => {
                self.done = true;
                Some(Event::default().event("closed").data("{}"))
            }
        }
    }
}
