//! HTTP: one file per resource, each handler with its OpenAPI entry above it; `listen.rs` accepts connections.
//!
//! Handlers translate and nothing else: they find the scene, call it, and turn what comes back into a response.
//! Whatever is refused is a problem (`problem.rs`), unknown routes and methods included. What blocks goes to tokio's
//! blocking threads or to the scene's own; nothing here draws or waits for a disk.

mod body;
mod convergence;
mod edits;
mod effects;
mod events;
mod export;
mod frame;
mod health;
mod listen;
mod metrics;
mod openapi;
mod origin;
mod page;
mod problem;
mod scenes;
mod ws;

use crate::scenes::{Scene, Scenes};
use crate::shutdown::Stopping;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::{Router, middleware};
use lumicast_protocol::{Problem, ProblemKind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use tokio::sync::Semaphore;
use tower_http::cors::{AllowOrigin, Any, CorsLayer};

pub use listen::serve;
pub use openapi::document;
pub use problem::HttpProblem;
pub use scenes::id_of_name;

/// What every handler gets.
#[derive(Debug, Clone)]
pub struct Service {
    /// The scenes.
    pub scenes: Arc<Scenes>,
    /// Set when the server stops.
    pub stopping: Stopping,
    /// Set once the scenes of the command line and the store are loaded.
    pub ready: Arc<AtomicBool>,
    /// Bytes that bodies may still take.
    bodies: Arc<Semaphore>,
}

impl Service {
    /// A service that is not ready yet.
    pub fn new(scenes: Arc<Scenes>, stopping: Stopping) -> Service {
        let bodies = body::budget(&scenes.workshop().config);
        Service { scenes, stopping, ready: Arc::default(), bodies }
    }

    /// The scene of that id, or the problem that there is none.
    fn scene(&self, id: &str) -> Result<Arc<Scene>, HttpProblem> {
        let found = self.scenes.get(id);
        found.ok_or_else(|| match self.ready.load(SeqCst) {
            true => {
                let name: String = id.chars().take(80).collect();
                let detail = format!("there is no scene {name:?}; GET /v1/scenes lists all");
                HttpProblem(Problem::new(ProblemKind::NotFound, detail))
            }
            false => HttpProblem(Problem::new(ProblemKind::Unavailable, "scenes are still being loaded")),
        })
    }
}

/// All routes.
pub fn router(service: Service) -> Router {
    let config = &service.scenes.workshop().config;
    let cors = cors_for(&config.allow_origins);
    let (routes, document) = openapi::routes().split_for_parts();
    let text = openapi::text_of(&document);
    let router = routes
        .route("/openapi.json", axum::routing::get(move || openapi::answer(text.clone())))
        .fallback(unknown_route)
        .method_not_allowed_fallback(unknown_method)
        .with_state(service.clone());
    let router = match cors {
        Some(cors) => router.layer(cors),
        None => router,
    };
    router.layer(middleware::from_fn_with_state(service, around))
}

/// Browsers on other origins may do here what the configured list allows; by default nothing.
fn cors_for(origins: &[String]) -> Option<CorsLayer> {
    let allowed = match origins {
        [] => return None,
        _ if origins.iter().any(|origin| origin == "*") => AllowOrigin::any(),
        _ => AllowOrigin::list(origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok())),
    };
    Some(
        CorsLayer::new()
            .allow_origin(allowed)
            .allow_methods([Method::GET, Method::POST, Method::DELETE])
            .allow_headers(Any)
            .expose_headers([header::ETAG, header::LOCATION]),
    )
}

/// Counts every request and gives every response the headers that browsers should see.
async fn around(State(service): State<Service>, request: Request, next: Next) -> Response {
    let metrics = &service.scenes.workshop().metrics;
    metrics.http_requests.one();
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let changes = !matches!(method, Method::GET | Method::HEAD | Method::OPTIONS);
    let allowed = &service.scenes.workshop().config.allow_origins;
    let mut response = if changes && !origin::is_allowed(request.headers(), allowed) {
        // A page may send a plain POST anywhere without asking first: it must not edit scenes on its visitor's machine.
        HttpProblem::new(
            ProblemKind::Malformed,
            "pages of this origin may not use this server; setting \"allow_origins\" names those that may",
        )
        .into_response()
    } else {
        next.run(request).await
    };
    let status = response.status();
    // What the framework refuses before a handler sees it (a path that is no UTF-8, a query it cannot read).
    let is_refusal = status.is_client_error() || status.is_server_error();
    if is_refusal && response.extensions().get::<Problem>().is_none() {
        let problem = Problem {
            kind: "about:blank".into(),
            title: status.canonical_reason().unwrap_or("Refused").into(),
            status: status.as_u16(),
            ..Problem::new(
                ProblemKind::Malformed,
                "path or query cannot be read; /openapi.json tells what is taken",
            )
        };
        response = HttpProblem(problem).into_response();
    }
    if is_refusal {
        metrics.http_problems.one();
        // Logged once, here; the client has the same words in its problem.
        match response.extensions().get::<Problem>() {
            // 503 is said while starting, stopping and under load; whose fault it is logs it where it happens.
            Some(problem) if status == StatusCode::INTERNAL_SERVER_ERROR => {
                tracing::warn!(%method, path, status = status.as_u16(), detail = problem.detail, "refused");
            }
            _ => tracing::debug!(%method, path, status = status.as_u16(), "refused"),
        }
    }
    let headers = response.headers_mut();
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

async fn unknown_route(request: Request) -> HttpProblem {
    let path: String = request.uri().path().chars().take(120).collect();
    HttpProblem(Problem::new(
        ProblemKind::NotFound,
        format!("there is nothing at {path:?}; /openapi.json tells what there is"),
    ))
}

async fn unknown_method(request: Request) -> Response {
    let path: String = request.uri().path().chars().take(120).collect();
    let detail = format!("{path:?} does not take {}; /openapi.json tells what it takes", request.method());
    // The protocol has no kind for this one: RFC 9457's own "about:blank" then stands for the status itself.
    let problem = Problem {
        kind: "about:blank".into(),
        title: "Method Not Allowed".into(),
        status: StatusCode::METHOD_NOT_ALLOWED.as_u16(),
        ..Problem::new(ProblemKind::NotFound, detail)
    };
    HttpProblem(problem).into_response()
}
