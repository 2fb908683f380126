//! Memory that the operator sees and that has a bound, counted while it is held.

use super::Workshop;
use crate::telemetry::{Gauge, Metrics};
use std::sync::Arc;

/// Bytes that count in a gauge of all scenes for as long as this lives.
#[derive(Debug)]
pub(super) struct CountedMemory {
    workshop: Arc<Workshop>,
    of: fn(&Metrics) -> &Gauge,
    bytes: i64,
}

impl CountedMemory {
    /// Of a film.
    pub(super) fn of_film(workshop: &Arc<Workshop>, bytes: usize) -> CountedMemory {
        CountedMemory::count(workshop, |metrics| &metrics.film_bytes, bytes)
    }

    /// Of light that nobody looks with.
    pub(super) fn of_kept_light(workshop: &Arc<Workshop>, bytes: usize) -> CountedMemory {
        CountedMemory::count(workshop, |metrics| &metrics.kept_light_bytes, bytes)
    }

    fn count(workshop: &Arc<Workshop>, of: fn(&Metrics) -> &Gauge, bytes: usize) -> CountedMemory {
        let bytes = i64::try_from(bytes).unwrap_or(i64::MAX);
        of(&workshop.metrics).add(bytes);
        CountedMemory { workshop: workshop.clone(), of, bytes }
    }
}

impl Drop for CountedMemory {
    fn drop(&mut self) {
        (self.of)(&self.workshop.metrics).add(-self.bytes);
    }
}
