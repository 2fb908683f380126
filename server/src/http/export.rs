//! `/v1/scenes/{id}/export.glb`.

use super::{HttpProblem, Service};
use crate::assets;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use lumicast_protocol::ProblemKind;

/// The scene as it is now, as a `.glb`.
#[utoipa::path(get, path = "/v1/scenes/{id}/export.glb", tag = "scenes",
    params(("id" = String, Path, description = "Scene")),
    responses(
        (status = 200, description = "ETag is the revision", body = Vec<u8>, content_type = "model/gltf-binary"),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 500, description = "It cannot be written as .glb", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
) -> Result<Response, HttpProblem> {
    let snapshot = service.scene(&id)?.snapshot();
    let revision = snapshot.revision;
    let written = tokio::task::spawn_blocking(move || assets::export_glb(snapshot.world.scene())).await;
    match written {
        Ok(Ok(glb)) => {
            let name = format!("attachment; filename=\"{id}-{revision}.glb\"");
            let headers = [
                (header::CONTENT_TYPE, "model/gltf-binary".to_string()),
                (header::ETAG, format!("\"{revision}\"")),
                (header::CONTENT_DISPOSITION, name),
            ];
            Ok((headers, glb).into_response())
        }
        Ok(Err(error)) => Err(HttpProblem::new(ProblemKind::Internal, error.to_string())),
        Err(error) => Err(HttpProblem::new(ProblemKind::Internal, error.to_string())),
    }
}
