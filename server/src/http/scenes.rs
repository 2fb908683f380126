//! `/v1/scenes` and `/v1/scenes/{id}`.

use super::{HttpProblem, Service, body};
use crate::scenes::Origin;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use lumicast_protocol::{ProblemKind, SceneId, SceneList};
use serde::Deserialize;

/// Lists the scenes.
#[utoipa::path(get, path = "/v1/scenes", tag = "scenes",
    responses((status = 200, description = "All scenes, by id", body = ref("#/components/schemas/SceneList"))))]
pub(super) async fn list(State(service): State<Service>) -> Json<SceneList> {
    Json(service.scenes.list())
}

/// Parameters of a scene sent as a bare file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NewSceneQuery {
    name: Option<String>,
    id: Option<String>,
}

/// A scene sent as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NewScene {
    name: Option<String>,
    id: Option<String>,
    builtin: Option<String>,
    data: Option<String>,
}

/// Makes a scene from a `.glb` (as the body, or base64 in JSON) or a built-in one.
#[utoipa::path(post, path = "/v1/scenes", tag = "scenes",
    params(
        ("name" = Option<String>, Query, description = "For people; with a bare .glb as the body"),
        ("id" = Option<String>, Query, description = "Stands in URLs; made of the name where absent")),
    request_body(description = "A whole .glb, or JSON", content(
        (Vec<u8> = "model/gltf-binary"),
        (ref("#/components/schemas/NewScene") = "application/json"))),
    responses(
        (status = 201, description = "Made, at revision 1", body = ref("#/components/schemas/SceneSummary"),
            headers(("Location" = String, description = "Path of the scene"))),
        (status = 400, description = "The body cannot be read", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 409, description = "The id is taken", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 413, description = "Too many bytes", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 415, description = "Neither .glb nor JSON", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 422, description = "The file is no usable scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 429, description = "Too many scenes", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 503, description = "The store cannot keep it", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn create(
    State(service): State<Service>,
    query: Result<Query<NewSceneQuery>, QueryRejection>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, HttpProblem> {
    let Query(query) = query.map_err(HttpProblem::of_query)?;
    if !body::is_type(&headers, &["model/gltf-binary", "application/octet-stream", "application/json"]) {
        return Err(HttpProblem::new(
            ProblemKind::UnsupportedFormat,
            "send a .glb as model/gltf-binary, or application/json",
        ));
    }
    let body::Taken { bytes, share } = body::read(body, &headers, &service).await?;
    let (name, id, origin) = match bytes.starts_with(b"glTF") {
        true => (query.name, query.id, Origin::Glb(bytes)),
        false => from_json(&bytes)?,
    };
    let name = name.unwrap_or_else(|| id.clone().unwrap_or_else(|| "scene".into()));
    if name.len() > lumicast_protocol::limits::LABEL_BYTES_MAX || name.chars().any(char::is_control) {
        let detail = "field `name`: at most 128 bytes without control characters";
        return Err(HttpProblem::new(ProblemKind::ValueRefused, detail).at_field("name"));
    }
    let id = match id {
        Some(id) => SceneId::new(id)
            .map_err(|error| HttpProblem::new(ProblemKind::ValueRefused, error.to_string()).at_field("id"))?,
        None => id_of_name(&name),
    };
    let scenes = service.scenes.clone();
    // Loading takes seconds of CPU: never on the threads that serve everybody.
    let made = tokio::task::spawn_blocking(move || {
        let _share = share;
        scenes.create(id, &name, origin)
    })
    .await;
    match made {
        Ok(Ok(scene)) => {
            tracing::info!(scene = %scene.id(), "made");
            let location = format!("/v1/scenes/{}", scene.id());
            Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(scene.summary())).into_response())
        }
        Ok(Err(error)) => Err(HttpProblem(error.problem())),
        Err(error) => Err(HttpProblem::new(ProblemKind::Internal, format!("loading failed: {error}"))),
    }
}

fn from_json(bytes: &[u8]) -> Result<(Option<String>, Option<String>, Origin), HttpProblem> {
    let malformed = |detail: String| HttpProblem::new(ProblemKind::Malformed, detail);
    let NewScene { name, id, builtin, data } = serde_json::from_slice(bytes).map_err(|error| {
        malformed(format!("the body is neither a .glb nor the JSON of a new scene: {error}"))
    })?;
    match (builtin, data) {
        (Some(builtin), None) => Ok((name.or_else(|| Some(builtin.clone())), id, Origin::Builtin(builtin))),
        (None, Some(data)) => {
            let decoded = base64::engine::general_purpose::STANDARD.decode(data.as_bytes());
            let glb = decoded.map_err(|error| {
                malformed(format!("field `data`: not standard base64 with padding: {error}")).at_field("data")
            })?;
            Ok((name, id, Origin::Glb(glb)))
        }
        _ => Err(malformed("give either `builtin` or `data`".into())),
    }
}

/// The nearest id to a name: what may not stand in an id becomes `-`.
pub fn id_of_name(name: &str) -> SceneId {
    let mut text: String = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' })
        .take(lumicast_protocol::id::SCENE_ID_BYTES_MAX)
        .collect();
    while text.starts_with(['.', '-']) {
        text.remove(0);
    }
    // Made of allowed characters and short enough; only nothing at all is left to replace.
    SceneId::new(text).or_else(|_| SceneId::new("scene")).unwrap_or_else(|_| unreachable!())
}

/// Tells the whole scene but geometry and texels.
#[utoipa::path(get, path = "/v1/scenes/{id}", tag = "scenes",
    params(("id" = String, Path, description = "Scene")),
    responses(
        (status = 200, description = "The scene; ETag is its revision", body = ref("#/components/schemas/SceneDescription"),
            headers(("ETag" = String, description = "Revision in quotes, for If-Match"))),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
) -> Result<Response, HttpProblem> {
    let scene = service.scene(&id)?;
    // A scene of a hundred thousand nodes takes tens of milliseconds to tell.
    let described = tokio::task::spawn_blocking(move || {
        let description = scene.description();
        (description.revision, serde_json::to_string(&*description))
    });
    match described.await {
        Ok((revision, Ok(json))) => Ok((
            [(header::ETAG, format!("\"{revision}\"")), (header::CONTENT_TYPE, "application/json".into())],
            json,
        )
            .into_response()),
        Ok((_, Err(error))) => Err(HttpProblem::new(ProblemKind::Internal, error.to_string())),
        Err(error) => Err(HttpProblem::new(ProblemKind::Internal, error.to_string())),
    }
}

/// Deletes a scene, from the store too; its viewers are disconnected.
#[utoipa::path(delete, path = "/v1/scenes/{id}", tag = "scenes",
    params(("id" = String, Path, description = "Scene")),
    responses(
        (status = 204, description = "Gone"),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 503, description = "The store cannot forget it", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn delete(
    State(service): State<Service>,
    Path(id): Path<String>,
) -> Result<StatusCode, HttpProblem> {
    let scene = service.scene(&id)?;
    let (scenes, id) = (service.scenes.clone(), scene.id().clone());
    drop(scene);
    match tokio::task::spawn_blocking(move || scenes.remove(&id)).await {
        Ok(Ok(true)) => Ok(StatusCode::NO_CONTENT),
        Ok(Ok(false)) => {
            Err(HttpProblem::new(ProblemKind::NotFound, "the scene was deleted in the meantime"))
        }
        Ok(Err(error)) => Err(HttpProblem::new(ProblemKind::Unavailable, error.to_string())),
        Err(error) => Err(HttpProblem::new(ProblemKind::Internal, error.to_string())),
    }
}
