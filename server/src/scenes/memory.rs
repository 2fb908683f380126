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
        let bytes = i64::try_from(bytes).unwrap_or(i64::MAX);
        workshop.metrics.film_bytes.add(bytes);
        CountedMemory { workshop: workshop.clone(), of: |metrics| &metrics.film_bytes, bytes }
    }

    /// Of light that nobody looks with; `None` where all scenes together would keep more than they may.
    pub(super) fn of_kept_light(workshop: &Arc<Workshop>, bytes: usize) -> Option<CountedMemory> {
        let [bytes, limit] = [bytes as u64, workshop.config.kept_light_bytes]
            .map(|bytes| i64::try_from(bytes).unwrap_or(i64::MAX));
        let fits = workshop.metrics.kept_light_bytes.add_within(bytes, limit);
        fits.then(|| CountedMemory {
            workshop: workshop.clone(),
            of: |metrics| &metrics.kept_light_bytes,
            bytes,
        })
    }
}

impl Drop for CountedMemory {
    fn drop(&mut self) {
        (self.of)(&self.workshop.metrics).add(-self.bytes);
    }
}
