//! `/v1/scenes/{id}/ws`: from HTTP to a viewer's session.

use super::{HttpProblem, Service, origin};
use crate::stream;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, header};
use axum::response::Response;
use lumicast_protocol::{ProblemKind, SUBPROTOCOL};

/// Opens a viewer's WebSocket; the protocol document describes what is said on it.
#[utoipa::path(get, path = "/v1/scenes/{id}/ws", tag = "pictures",
    params(
        ("id" = String, Path, description = "Scene"),
        ("Sec-WebSocket-Protocol" = String, Header, description = "lumicast.v1")),
    responses(
        (status = 101, description = "Say hello"),
        (status = 400, description = "No WebSocket, or not the subprotocol lumicast.v1", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 404, description = "No such scene", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 429, description = "Too many viewers", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json")))]
pub(super) async fn get(
    State(service): State<Service>,
    Path(id): Path<String>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, HttpProblem> {
    let scene = service.scene(&id)?;
    let config = &service.scenes.workshop().config;
    let malformed = |detail: String| HttpProblem::new(ProblemKind::Malformed, detail);
    if !origin::is_allowed(&headers, &config.allow_origins) {
        return Err(malformed(
            "pages of this origin may not use this server; setting \"allow_origins\" names those that may"
                .into(),
        ));
    }
    let upgrade = upgrade.map_err(|error| malformed(error.body_text()))?;
    let offered = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).iter();
    let offered = offered.filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(','));
    if !offered.map(str::trim).any(|protocol| protocol == SUBPROTOCOL) {
        return Err(malformed(format!("ask for the WebSocket subprotocol {SUBPROTOCOL}")));
    }
    let viewer = scene.join()?;
    let message_bytes = usize::try_from(config.message_bytes).unwrap_or(usize::MAX);
    let session =
        stream::Session::new(scene, viewer, service.scenes.workshop().clone(), service.stopping.clone());
    Ok(upgrade
        .protocols([SUBPROTOCOL])
        .max_message_size(message_bytes)
        .max_frame_size(message_bytes)
        .on_upgrade(move |socket| session.run(socket)))
}
