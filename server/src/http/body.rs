//! Request bodies: read whole, within the limits of bytes and time.

use super::{HttpProblem, Service};
use crate::config::Config;
use axum::body::Body;
use axum::http::{HeaderMap, header};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use lumicast_protocol::ProblemKind;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Bytes that one permit of the budget stands for.
const PERMIT_BYTES: u64 = 64 << 10;

/// The budget of bytes that all bodies share.
pub(super) fn budget(config: &Config) -> Arc<Semaphore> {
    let permits = usize::try_from(config.bodies_bytes.div_ceil(PERMIT_BYTES)).unwrap_or(usize::MAX);
    Arc::new(Semaphore::new(permits.min(Semaphore::MAX_PERMITS)))
}

/// A body and its share of the budget, which is given back once the body has been dealt with.
pub(super) struct Taken {
    pub(super) bytes: Vec<u8>,
    pub(super) share: OwnedSemaphorePermit,
}

/// The body, or why it was not taken.
pub(super) async fn read(body: Body, headers: &HeaderMap, service: &Service) -> Result<Taken, HttpProblem> {
    let config = &service.scenes.workshop().config;
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
    // Without a length it may become as long as the limit.
    let permits = announced.unwrap_or(limit).div_ceil(PERMIT_BYTES);
    let permits = u32::try_from(permits).unwrap_or(u32::MAX);
    let Ok(share) = service.bodies.clone().try_acquire_many_owned(permits) else {
        return Err(HttpProblem::new(ProblemKind::Unavailable, "too many large bodies at once; try again"));
    };
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
        Ok(Ok(collected)) => Ok(Taken { bytes: collected.to_bytes().into(), share }),
    }
}

/// Whether the body is said to be of this media type, or nothing is said.
pub(super) fn is_type(headers: &HeaderMap, accepted: &[&str]) -> bool {
    let Some(value) = headers.get(header::CONTENT_TYPE) else { return true };
    let essence = value.to_str().unwrap_or_default().split(';').next().unwrap_or_default().trim();
    accepted.iter().any(|accepted| essence.eq_ignore_ascii_case(accepted))
}
