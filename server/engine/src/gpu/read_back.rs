//! Bytes on their way back from the device.

use std::{
    ops::Range,
    sync::{
        Arc, OnceLock,
        mpsc::{Receiver, TryRecvError, channel},
    },
};

use super::{Buffer, GpuError, Session};

/// Where bytes wait to be read.
#[derive(Debug)]
pub(super) struct Staging {
    pub(super) session: Arc<Session>,
    /// Of what they are, in errors.
    pub(super) name: String,
    pub(super) byte_count: u64,
    /// Has room for so many or more.
    pub(super) buffer: Buffer,
    /// Set when the batch that copies them is handed over.
    pub(super) submitted: Arc<OnceLock<wgpu::SubmissionIndex>>,
}

impl Staging {
    /// What is mapped for them: whole words, and one where there are none.
    fn mapped_bytes(&self) -> Range<u64> {
        0..self.byte_count.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT).max(wgpu::COPY_BUFFER_ALIGNMENT)
    }
}

/// Bytes that a batch copies to where they can be read.
#[derive(Debug)]
pub struct ReadBack {
    staging: Staging,
    /// What became of mapping the memory, once that was asked for.
    mapped: Option<Receiver<Result<(), wgpu::BufferAsyncError>>>,
}

impl ReadBack {
    pub(super) fn new(staging: Staging) -> ReadBack {
        ReadBack { staging, mapped: None }
    }

    /// Waits for the bytes.
    ///
    /// Errors: [`GpuError::TimedOut`] after the options' `seconds_max`, [`GpuError::Lost`], [`GpuError::Failed`], also
    /// where the batch was not submitted.
    pub fn collect(self) -> Result<Vec<u8>, GpuError> {
        self.read(<[u8]>::to_vec)
    }

    /// Waits for the bytes and hands them over where they are, uncopied. The memory is kept for later reads.
    ///
    /// Errors: as [`ReadBack::collect`].
    pub fn read<T>(mut self, take: impl FnOnce(&[u8]) -> T) -> Result<T, GpuError> {
        let index = self.map()?;
        let Staging { session, name, .. } = &self.staging;
        session.wait_for(&index, name)?;
        let received = self.mapped.take().and_then(|mapped| mapped.recv_timeout(session.wait_max).ok());
        let taken = self.taken(received.unwrap_or(Err(wgpu::BufferAsyncError)), take)?;
        // The batch is done and none other knows the buffer. One that is not whole any more is let go, and nobody misses it.
        let Staging { session, name, buffer, .. } = self.staging;
        let failed = |error| GpuError::Failed { what: format!("{name}: {error}") };
        if session.checked(|| buffer.buffer.unmap(), failed).is_ok() {
            session.keep(buffer);
        }
        Ok(taken)
    }

    /// The bytes when they are there, `None` when they are not yet; once they were taken there are no more.
    ///
    /// Errors: as [`ReadBack::collect`], but it never waits, unless the device refuses what it is asked for: then for what it has left to do.
    pub fn try_collect(&mut self) -> Result<Option<Vec<u8>>, GpuError> {
        self.map()?;
        self.staging.session.poll(wgpu::PollType::Poll)?;
        let Some(mapped) = &self.mapped else { return Ok(None) };
        match mapped.try_recv() {
            Err(TryRecvError::Empty) => self.staging.session.check().map(|()| None),
            Err(TryRecvError::Disconnected) => {
                self.taken(Err(wgpu::BufferAsyncError), <[u8]>::to_vec).map(Some)
            }
            Ok(result) => self.taken(result, <[u8]>::to_vec).map(Some),
        }
    }

    /// Asks for the memory to be mapped, once. Not before the batch is handed over: commands may not touch it then.
    fn map(&mut self) -> Result<wgpu::SubmissionIndex, GpuError> {
        let Staging { session, name, buffer, submitted, .. } = &self.staging;
        session.check()?;
        let Some(index) = submitted.get() else {
            return Err(GpuError::Failed { what: format!("{name}: its batch was not submitted") });
        };
        if self.mapped.is_none() {
            let (sender, receiver) = channel();
            session.checked(
                || {
                    // Nobody listens any more where the read-back was dropped.
                    let tell = move |result| drop(sender.send(result));
                    buffer.buffer.map_async(wgpu::MapMode::Read, self.staging.mapped_bytes(), tell);
                },
                |error| GpuError::Failed { what: format!("{name}: {error}") },
            )?;
            self.mapped = Some(receiver);
        }
        Ok(index.clone())
    }

    fn taken<T>(
        &self,
        mapped: Result<(), wgpu::BufferAsyncError>,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, GpuError> {
        let Staging { session, name, byte_count, buffer, .. } = &self.staging;
        session.check()?;
        // A device that goes in this moment takes its buffers along before the news of it are here.
        let failed = |what: String| session.loss_or(GpuError::Failed { what: format!("{name}: {what}") });
        mapped.map_err(|error| failed(error.to_string()))?;
        let view = buffer.buffer.get_mapped_range(self.staging.mapped_bytes());
        let view = view.map_err(|error| failed(error.to_string()))?;
        Ok(take(&view[..*byte_count as usize]))
    }
}

impl Session {
    /// Bytes of a buffer, after everything that was submitted; `bytes` are multiples of 4.
    ///
    /// Errors: as [`ReadBack::collect`].
    pub fn read(self: &Arc<Session>, buffer: &Buffer, bytes: Range<u64>) -> Result<Vec<u8>, GpuError> {
        self.fetch(buffer, bytes)?.collect()
    }

    /// The same, not waited for: they are as they were when this was asked, whatever is submitted afterwards.
    ///
    /// Errors: as [`Batch::read_back`](super::Batch::read_back) and [`Batch::submit`](super::Batch::submit).
    pub fn fetch(self: &Arc<Session>, buffer: &Buffer, bytes: Range<u64>) -> Result<ReadBack, GpuError> {
        let mut batch = self.batch("read")?;
        let read_back = batch.read_back(buffer, bytes)?;
        batch.submit()?;
        Ok(read_back)
    }

    /// Waits until a submission is done, no longer than the options allow.
    pub(super) fn wait_for(&self, index: &wgpu::SubmissionIndex, what: &str) -> Result<(), GpuError> {
        self.check()?;
        let submission_index = Some(index.clone());
        let is_done = self.poll(wgpu::PollType::Wait { submission_index, timeout: Some(self.wait_max) })?;
        self.check()?;
        if is_done {
            Ok(())
        } else {
            Err(GpuError::TimedOut { what: what.to_string(), seconds_max: self.wait_max.as_secs_f64() })
        }
    }
}
