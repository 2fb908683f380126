//! `/v1/scenes/{id}/convergence`.

use super::{HttpProblem, Service};
use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use lumicast_protocol::Convergence;
use serde::Deserialize;

/// Whose picture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Whose {
    viewer: Option<u64>,
}

/// Tells how the error of a viewer's picture fell.
#[utoipa::path(get, path = "/v1/scenes/{id}/convergence", tag = "pictures",
    params(
        ("id" = String, Path, description = "Scene"),
        ("viewer" = Option<u64>, Query, description = "Number of the connection; default: who watches longest, or the last that left")),
    responses(
        (status = 200, description = "Since that picture's film restarted", body = ref("#/components/schemas/Convergence")),
        (status = 400, description = "`viewer` is no number", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 404, description = "No such scene or viewer", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
    query: Result<Query<Whose>, QueryRejection>,
) -> Result<Json<Convergence>, HttpProblem> {
    let Query(Whose { viewer }) = query.map_err(HttpProblem::of_query)?;
    Ok(Json(service.scene(&id)?.convergence(viewer)?))
}
