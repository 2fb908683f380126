//! `/metrics`, for Prometheus.

use super::Service;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;

/// Numbers in Prometheus' text format.
#[utoipa::path(get, path = "/metrics", tag = "operation",
    responses((status = 200, description = "Text format 0.0.4", body = String, content_type = "text/plain; version=0.0.4")))]
pub(super) async fn get(State(service): State<Service>) -> impl IntoResponse {
    let text = service.scenes.workshop().metrics.to_prometheus(&service.scenes.figures());
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text)
}
