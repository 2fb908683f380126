//! `/openapi.json`: made of the entries above the handlers and of `schemas.json`.
//!
//! Routes and entries are registered by one macro, so neither can exist without the other. The schemas of the
//! protocol's types stand in `schemas.json`, because several of them read more than one JSON form and no derive says
//! that; tests hold examples of every type against them.

use super::{Service, convergence, edits, effects, events, export, frame, health, metrics, page, scenes, ws};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use utoipa::openapi::{ComponentsBuilder, InfoBuilder, OpenApi, OpenApiBuilder, RefOr, Schema, Server};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

const SCHEMAS: &str = include_str!("schemas.json");

/// Every route with its entry.
pub(super) fn routes() -> OpenApiRouter<Service> {
    OpenApiRouter::with_openapi(frame_of_document())
        .routes(routes!(page::get))
        .routes(routes!(scenes::list, scenes::create))
        .routes(routes!(scenes::get, scenes::delete))
        .routes(routes!(edits::apply, edits::log))
        .routes(routes!(events::get))
        .routes(routes!(export::get))
        .routes(routes!(frame::get))
        .routes(routes!(effects::get))
        .routes(routes!(convergence::get))
        .routes(routes!(ws::get))
        .routes(routes!(health::health))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::get))
}

fn frame_of_document() -> OpenApi {
    let info = InfoBuilder::new()
        .title("Lumicast")
        .version(env!("CARGO_PKG_VERSION"))
        .description(Some(
            "Holds shared 3D scenes, keeps their global illumination converging and streams it. The WebSocket is \
             described in the protocol document. Metres, right-handed, +Y up; linear Rec.709 radiance.",
        ))
        .build();
    // The file is part of the program and read by every test of it.
    let schemas: std::collections::BTreeMap<String, RefOr<Schema>> =
        serde_json::from_str(SCHEMAS).unwrap_or_else(|error| panic!("schemas.json: {error}"));
    let components = ComponentsBuilder::new().schemas_from_iter(schemas).build();
    OpenApiBuilder::new().info(info).servers(Some([Server::new("/")])).components(Some(components)).build()
}

/// The whole document.
pub fn document() -> OpenApi {
    routes().split_for_parts().1
}

/// The document as it is served and committed.
pub(super) fn text_of(document: &OpenApi) -> String {
    document.to_pretty_json().unwrap_or_else(|error| panic!("the OpenAPI document: {error}"))
}

/// Answers the document.
pub(super) async fn answer(text: String) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], text).into_response()
}
