//! `/v1/scenes/{id}/edits`.

use super::{HttpProblem, Service, body};
use axum::Json;
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use lumicast_protocol::{EditBatch, EventLog, Problem, ProblemKind, limits::LABEL_BYTES_MAX};
use serde::Deserialize;

/// Applies a batch of edits: all of it, as one revision, or nothing.
#[utoipa::path(post, path = "/v1/scenes/{id}/edits", tag = "edits",
    params(
        ("id" = String, Path, description = "Scene"),
        ("If-Match" = Option<String>, Header, description = "Revision in quotes; refuses with 412 when the scene has moved on"),
        ("Idempotency-Key" = Option<String>, Header, description = "1 to 128 bytes; the same batch under the same key makes no second revision")),
    request_body(content = ref("#/components/schemas/EditBatch"), content_type = "application/json"),
    responses(
        (status = 200, description = "On disk; pictures of it follow", body = ref("#/components/schemas/EditReply"),
            headers(("ETag" = String, description = "The new revision in quotes"))),
        (status = 400, description = "No JSON, or no batch", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 409, description = "The key belongs to another batch", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 412, description = "The scene has moved on", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 413, description = "Too many bytes", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 415, description = "Not JSON", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 422, description = "An edit was refused: op, op_index and field say which; nothing changed", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 503, description = "Too many batches wait, or the disk refused", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn apply(
    State(service): State<Service>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, HttpProblem> {
    let scene = service.scene(&id)?;
    let if_match = if_match(&headers)?;
    let key = idempotency_key(&headers)?;
    if !body::is_type(&headers, &["application/json"]) {
        return Err(HttpProblem::new(ProblemKind::UnsupportedFormat, "send edits as application/json"));
    }
    let body::Taken { bytes, share: _share } = body::read(body, &headers, &service).await?;
    // Large meshes take a while to read; a small batch does not, and blocking threads cost more than it.
    let batch = match bytes.len() {
        0..=65_536 => EditBatch::from_json(&bytes),
        _ => tokio::task::spawn_blocking(move || EditBatch::from_json(&bytes))
            .await
            .map_err(|error| HttpProblem::new(ProblemKind::Internal, error.to_string()))?,
    };
    let batch = batch.map_err(|error| HttpProblem(Problem::from(error)))?;
    let reply = scene.edit(batch.edits, if_match, key).await?;
    Ok(([(header::ETAG, format!("\"{}\"", reply.revision))], Json(reply)).into_response())
}

/// The revision that `If-Match` names; `*` matches any.
fn if_match(headers: &HeaderMap) -> Result<Option<u64>, HttpProblem> {
    let Some(value) = headers.get(header::IF_MATCH) else { return Ok(None) };
    let text = value.to_str().unwrap_or_default().trim();
    if text == "*" {
        return Ok(None);
    }
    let number = text.trim_start_matches("W/").trim_matches('"').parse::<u64>();
    number.map(Some).map_err(|_| {
        HttpProblem::new(
            ProblemKind::Malformed,
            "If-Match is no revision: send a number in quotes, as the ETag of the scene has it",
        )
        .at_field("If-Match")
    })
}

fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, HttpProblem> {
    let Some(value) = headers.get("idempotency-key") else { return Ok(None) };
    match value.to_str() {
        Ok(key) if (1..=LABEL_BYTES_MAX).contains(&key.len()) => Ok(Some(key.into())),
        _ => Err(HttpProblem::new(
            ProblemKind::Malformed,
            format!("Idempotency-Key: 1 to {LABEL_BYTES_MAX} printable ASCII characters"),
        )
        .at_field("Idempotency-Key")),
    }
}

/// Parameters of the log.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LogQuery {
    #[serde(default)]
    since: u64,
}

/// Tells the batches after a revision.
#[utoipa::path(get, path = "/v1/scenes/{id}/edits", tag = "edits",
    params(
        ("id" = String, Path, description = "Scene"),
        ("since" = Option<u64>, Query, description = "Only what came after this revision; default 0")),
    responses(
        (status = 200, description = "The batches, oldest first", body = ref("#/components/schemas/EventLog")),
        (status = 400, description = "`since` is no revision", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 404, description = "No such scene, or batches so old are no longer kept", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn log(
    State(service): State<Service>,
    Path(id): Path<String>,
    query: Result<Query<LogQuery>, axum::extract::rejection::QueryRejection>,
) -> Result<Json<EventLog>, HttpProblem> {
    let Query(LogQuery { since }) = query.map_err(HttpProblem::of_query)?;
    // What came before revision 1 is the scene's base, not a batch.
    Ok(Json(service.scene(&id)?.edits_since(since.max(1))?))
}
