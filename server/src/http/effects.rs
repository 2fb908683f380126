//! `/v1/scenes/{id}/effects`.

use super::{HttpProblem, Service};
use axum::Json;
use axum::extract::{Path, State};
use lumicast_protocol::Effects;

/// Tells which parts of the renderer the scene needs, and why.
#[utoipa::path(get, path = "/v1/scenes/{id}/effects", tag = "pictures",
    params(("id" = String, Path, description = "Scene")),
    responses(
        (status = 200, description = "In the order they run", body = ref("#/components/schemas/Effects")),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
) -> Result<Json<Effects>, HttpProblem> {
    Ok(Json(service.scene(&id)?.effects()))
}
