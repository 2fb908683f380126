//! `/healthz` and `/readyz`, for supervisors and load balancers.

use super::{HttpProblem, Service};
use axum::extract::State;
use lumicast_protocol::ProblemKind;
use std::sync::atomic::Ordering::SeqCst;

/// Answers as long as the process works.
#[utoipa::path(get, path = "/healthz", tag = "operation",
    responses((status = 200, description = "It lives", body = String, content_type = "text/plain")))]
pub(super) async fn health() -> &'static str {
    "ok\n"
}

/// Answers 200 once all scenes are loaded and until the server stops.
#[utoipa::path(get, path = "/readyz", tag = "operation",
    responses(
        (status = 200, description = "Send clients here", body = String, content_type = "text/plain"),
        (status = 503, description = "Starting or stopping", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn ready(State(service): State<Service>) -> Result<&'static str, HttpProblem> {
    if service.stopping.is_set() {
        return Err(HttpProblem::new(ProblemKind::Unavailable, "the server is stopping"));
    }
    match service.ready.load(SeqCst) {
        true => Ok("ready\n"),
        false => Err(HttpProblem::new(ProblemKind::Unavailable, "scenes are still being loaded")),
    }
}
