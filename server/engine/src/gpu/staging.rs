//! Memory that bytes come back through, kept from one read to the next.
//!
//! Such memory costs more to get than to use: the driver pins it and the system hands out its pages one by one. What was read
//! through is kept for later reads, up to a bound; it counts in the session's budget, and makes way for whatever else wants its
//! bytes.

use std::collections::VecDeque;

use super::{Buffer, GpuError, Session, session::locked};

/// Bytes that are kept at most: the largest slices of paths and of photons, 48 and some 50 MiB, come back in turns.
const SPARE_BYTES_MAX: u64 = 112 << 20;
/// Buffers that are kept at most, so that finding one stays quick.
const SPARE_COUNT_MAX: usize = 32;
/// Least bytes of a buffer, so that all small reads share.
const STAGING_BYTES_MIN: u64 = 256;
/// No buffer is lent for less than this share of it: reads of a few bytes leave the large ones to those who need them.
const SHARE_MIN: u64 = 2;

/// Buffers that bytes were read through and nothing uses now; those that were used longest ago come first.
#[derive(Debug, Default)]
pub(super) struct Spare(VecDeque<Buffer>);

impl Spare {
    pub(super) fn bytes(&self) -> u64 {
        self.0.iter().map(|buffer| buffer.buffer.size()).sum()
    }

    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.0.len()
    }

    /// The smallest that so many bytes fit in without leaving most of it empty.
    fn take(&mut self, byte_count: u64) -> Option<Buffer> {
        let fitting = byte_count..=byte_count.saturating_mul(SHARE_MIN);
        let sizes = self.0.iter().map(|buffer| buffer.buffer.size()).enumerate();
        let (index, _) = sizes.filter(|(_, size)| fitting.contains(size)).min_by_key(|(_, size)| *size)?;
        self.0.remove(index)
    }

    fn put(&mut self, buffer: Buffer) {
        // What alone is too large drives nothing else out.
        if buffer.buffer.size() > SPARE_BYTES_MAX {
            return;
        }
        self.0.push_back(buffer);
        while self.0.len() > SPARE_COUNT_MAX || self.bytes() > SPARE_BYTES_MAX {
            self.0.pop_front();
        }
    }
}

impl Session {
    /// Room for bytes on their way back, of at least so many.
    ///
    /// Errors: as [`Session::buffer`].
    pub(super) fn staging(&self, name: &str, byte_count: u64) -> Result<Buffer, GpuError> {
        let byte_count = byte_count.max(STAGING_BYTES_MIN);
        let spare = locked(&self.spare).take(byte_count);
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        spare.map_or_else(|| self.allocate(name, byte_count, usage), Ok)
    }

    /// Keeps a buffer of [`Session::staging`] for later reads. Nothing that is recorded or on its way may still write there.
    pub(super) fn keep(&self, buffer: Buffer) {
        locked(&self.spare).put(buffer);
    }

    /// Gets memory of any kind. Where it is refused, what is kept goes, and it is asked for once more.
    pub(super) fn making_way<T>(&self, get: impl Fn() -> Result<T, GpuError>) -> Result<T, GpuError> {
        match get() {
            Err(GpuError::OutOfMemory { .. }) if self.let_spare_go() => get(),
            got => got,
        }
    }

    /// Lets go of all that is kept. True if there was any.
    fn let_spare_go(&self) -> bool {
        !std::mem::take(&mut *locked(&self.spare)).0.is_empty()
    }
}
