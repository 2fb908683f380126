//! Problems as HTTP responses.

use axum::extract::rejection::QueryRejection;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use lumicast_protocol::{Problem, ProblemKind};

/// A problem, answered as `application/problem+json`.
#[derive(Debug)]
pub struct HttpProblem(pub Problem);

impl HttpProblem {
    /// A problem of this kind.
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> HttpProblem {
        HttpProblem(Problem::new(kind, detail))
    }

    /// Of what stands behind the question mark of an address.
    pub fn of_query(rejection: QueryRejection) -> HttpProblem {
        let text = rejection.body_text();
        let what = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
        HttpProblem::new(ProblemKind::Malformed, format!("query: {what}"))
    }

    /// The same, with the field that caused it.
    pub fn at_field(self, field: impl Into<String>) -> HttpProblem {
        HttpProblem(self.0.at_field(field))
    }
}

impl From<Problem> for HttpProblem {
    fn from(problem: Problem) -> HttpProblem {
        HttpProblem(problem)
    }
}

impl IntoResponse for HttpProblem {
    fn into_response(self) -> Response {
        let HttpProblem(problem) = self;
        let status = StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let json = serde_json::to_string(&problem).unwrap_or_default();
        let mut response =
            (status, [(header::CONTENT_TYPE, "application/problem+json")], json).into_response();
        if matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE) {
            // One second: queues here empty in less, and a starting server is looked at often.
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
        }
        response.extensions_mut().insert(problem);
        response
    }
}
