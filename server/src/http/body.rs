//! Request bodies: read whole, within the limits of bytes and time.

use super::HttpProblem;
use crate::config::Config;
use axum::body::Body;
use axum::http::{HeaderMap, header};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use lumicast_protocol::ProblemKind;
use std::time::Duration;

/// The body, or why it was not taken.
pub(super) async fn read(body: Body, headers: &HeaderMap, config: &Config) -> Result<Vec<u8>, HttpProblem> {
    let limit = config.body_bytes;
    let too_large = |bytes: &dyn std::fmt::Display| {
        HttpProblem::new(
            ProblemKind::TooLarge,
            format!("the body has {bytes} bytes; at most {limit} are taken"),
        )
    };
    let announced =
        headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    if let Some(bytes) = announced.filter(|bytes| *bytes > limit) {
        return Err(too_large(&bytes));
    }
    let limited = Limited::new(body, usize::try_from(limit).unwrap_or(usize::MAX));
    let seconds = config.body_seconds;
    let collected = tokio::time::timeout(Duration::from_secs(seconds.into()), limited.collect()).await;
    match collected {
        Err(_) => Err(HttpProblem::new(
            ProblemKind::Malformed,
            format!("the body did not arrive within {seconds} s"),
        )),
        Ok(Err(error)) if error.is::<LengthLimitError>() => Err(too_large(&"more")),
        Ok(Err(error)) => {
            Err(HttpProblem::new(ProblemKind::Malformed, format!("the body could not be read: {error}")))
        }
        Ok(Ok(collected)) => Ok(collected.to_bytes().into()),
    }
}

/// Whether the body is said to be of this media type, or nothing is said.
pub(super) fn is_type(headers: &HeaderMap, accepted: &[&str]) -> bool {
    let Some(value) = headers.get(header::CONTENT_TYPE) else { return true };
    let essence = value.to_str().unwrap_or_default().split(';').next().unwrap_or_default().trim();
    accepted.iter().any(|accepted| essence.eq_ignore_ascii_case(accepted))
}
