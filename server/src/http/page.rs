//! `/`: a page that shows the scenes in any browser. One file, nothing loaded from elsewhere.

use axum::http::header;
use axum::response::IntoResponse;

const PAGE: &str = include_str!("page.html");

/// Shows the scenes in a browser.
#[utoipa::path(get, path = "/", tag = "pictures",
    responses((status = 200, description = "A page with a small viewer", body = String, content_type = "text/html")))]
pub(super) async fn get() -> impl IntoResponse {
    // Only what is in the page itself and this server's own socket; a scene's names can inject nothing.
    let policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src blob: data:; \
                  connect-src 'self' ws: wss:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    ([(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, policy)], PAGE)
}
