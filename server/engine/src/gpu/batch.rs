//! Work recorded, then handed over at once.

use std::{
    ops::Range,
    sync::{Arc, OnceLock},
};

use super::{BindGroup, Buffer, GpuError, Pipeline, ReadBack, Session, read_back::Staging};

/// Bytes of a tick.
const TICK_BYTES: u64 = size_of::<u64>() as u64;
/// Ticks of a batch at most: as many as every device with a clock can note at once.
const TICKS_MAX: u32 = 4096;

/// Commands for the device, in order: each sees what those before it wrote. Nothing runs before [`Batch::submit`].
#[derive(Debug)]
pub struct Batch {
    name: String,
    session: Arc<Session>,
    // Ended before anything else is recorded, and before the encoder is dropped.
    pass: Option<wgpu::ComputePass<'static>>,
    encoder: wgpu::CommandEncoder,
    clock: Option<Clock>,
    submitted: Arc<OnceLock<wgpu::SubmissionIndex>>,
}

/// How a batch begins: with a clock or without.
pub(crate) type Begin = fn(&Arc<Session>, &str) -> Result<Batch, GpuError>;

/// Readings of the device's clock.
#[derive(Debug)]
struct Clock {
    queries: wgpu::QuerySet,
    /// Readings so far, and at most.
    count: u32,
    max: u32,
}

impl Session {
    /// An empty batch.
    ///
    /// Errors: [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn batch(self: &Arc<Session>, name: &str) -> Result<Batch, GpuError> {
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some(name) };
        let encoder = self.checked(
            || self.device.create_command_encoder(&descriptor),
            |error| GpuError::Failed { what: format!("batch {name}: {error}") },
        )?;
        Ok(Batch {
            name: name.to_string(),
            session: Arc::clone(self),
            pass: None,
            encoder,
            clock: None,
            submitted: Arc::default(),
        })
    }

    /// An empty batch that takes the time on the device's clock; without such a clock it is [`Session::batch`].
    ///
    /// Errors: as [`Session::batch`].
    pub fn timed_batch(self: &Arc<Session>, name: &str) -> Result<Batch, GpuError> {
        self.batch_of_steps(name, 1)
    }

    /// The same, which takes the time of so many steps by themselves: [`Batch::end_step`] ends each, and handing it over one that was not.
    ///
    /// Errors: as [`Session::batch`]; [`GpuError::Failed`] for more than 4095.
    pub(crate) fn batch_of_steps(self: &Arc<Session>, name: &str, step_max: u32) -> Result<Batch, GpuError> {
        let mut batch = self.batch(name)?;
        if self.nanoseconds_per_tick.is_none() {
            return Ok(batch);
        }
        let max = step_max.saturating_add(1);
        if max > TICKS_MAX {
            let what = format!("batch {name}: {step_max} steps are more than a clock takes");
            return Err(GpuError::Failed { what });
        }
        let descriptor = wgpu::QuerySetDescriptor { label: None, ty: wgpu::QueryType::Timestamp, count: max };
        let queries = self.checked(
            || self.device.create_query_set(&descriptor),
            |error| GpuError::Failed { what: format!("clock of batch {name}: {error}") },
        )?;
        batch.clock = Some(Clock { queries, count: 0, max });
        batch.tick();
        Ok(batch)
    }
}

impl Batch {
    /// Runs a step in `workgroups` along x, y, z with these groups, the first being group 0.
    ///
    /// Errors: [`GpuError::Lost`] where a part is of another device. What the device refuses shows at
    /// [`Batch::submit`].
    pub fn dispatch(
        &mut self,
        pipeline: &Pipeline,
        groups: &[&BindGroup],
        workgroups: [u32; 3],
    ) -> Result<(), GpuError> {
        let [x, y, z] = workgroups;
        self.prepare(pipeline, groups)?.dispatch_workgroups(x, y, z);
        Ok(())
    }

    /// Runs a step in as many workgroups as three u32 in `sizes`, `offset` bytes from its start, say then.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn dispatch_indirect(
        &mut self,
        pipeline: &Pipeline,
        groups: &[&BindGroup],
        sizes: &Buffer,
        offset: u64,
    ) -> Result<(), GpuError> {
        self.session.own(sizes.generation())?;
        self.prepare(pipeline, groups)?.dispatch_workgroups_indirect(&sizes.buffer, offset);
        Ok(())
    }

    /// The pass that dispatches follow each other in, ready for one.
    fn prepare(
        &mut self,
        pipeline: &Pipeline,
        groups: &[&BindGroup],
    ) -> Result<&mut wgpu::ComputePass<'static>, GpuError> {
        self.session.own(pipeline.generation)?;
        for group in groups {
            self.session.own(group.generation)?;
        }
        let encoder = &mut self.encoder;
        let pass = self.pass.get_or_insert_with(|| {
            let descriptor = wgpu::ComputePassDescriptor { label: Some(&self.name), timestamp_writes: None };
            encoder.begin_compute_pass(&descriptor).forget_lifetime()
        });
        pass.set_pipeline(&pipeline.pipeline);
        for (index, group) in (0..).zip(groups) {
            pass.set_bind_group(index, &group.group, &[]);
        }
        Ok(pass)
    }

    /// Ends a step of [`Session::batch_of_steps`]: nothing in batches without a clock, and once as many were ended as that takes.
    pub(crate) fn end_step(&mut self) {
        if self.clock.as_ref().is_some_and(|clock| clock.count < clock.max) {
            self.tick();
        }
    }

    /// Notes the time after all that was recorded. Only passes note it on every device, so this is one without work.
    fn tick(&mut self) {
        self.pass = None;
        let Some(Clock { queries, count, .. }) = &mut self.clock else { return };
        let (first, last) = if *count == 0 { (Some(*count), None) } else { (None, Some(*count)) };
        self.encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: queries,
                beginning_of_pass_write_index: first,
                end_of_pass_write_index: last,
            }),
        });
        *count += 1;
    }

    /// Copies `bytes` of a buffer to `offset` of another. All are multiples of 4.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn copy(
        &mut self,
        from: &Buffer,
        bytes: Range<u64>,
        to: &Buffer,
        offset: u64,
    ) -> Result<(), GpuError> {
        self.session.own(from.generation())?;
        self.session.own(to.generation())?;
        let byte_count = bytes.end.saturating_sub(bytes.start);
        self.encoder().copy_buffer_to_buffer(&from.buffer, bytes.start, &to.buffer, offset, byte_count);
        Ok(())
    }

    /// Fills a buffer with zeros.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn clear(&mut self, buffer: &Buffer) -> Result<(), GpuError> {
        self.session.own(buffer.generation())?;
        self.encoder().clear_buffer(&buffer.buffer, 0, None);
        Ok(())
    }

    /// Copies `bytes` of a buffer, multiples of 4, to where they can be read once the batch is done.
    ///
    /// Errors: as [`Batch::dispatch`]; [`GpuError::OutOfMemory`], [`GpuError::Failed`] beyond the buffer's end.
    pub fn read_back(&mut self, buffer: &Buffer, bytes: Range<u64>) -> Result<ReadBack, GpuError> {
        self.session.own(buffer.generation())?;
        if bytes.start > bytes.end || bytes.end > buffer.byte_count().next_multiple_of(4) {
            let what =
                format!("bytes {bytes:?} of buffer {:?}, which has {}", buffer.name(), buffer.byte_count());
            return Err(GpuError::Failed { what });
        }
        self.stage(&buffer.buffer, buffer.name(), bytes)
    }

    fn stage(&mut self, buffer: &wgpu::Buffer, name: &str, bytes: Range<u64>) -> Result<ReadBack, GpuError> {
        let byte_count = bytes.end - bytes.start;
        self.stage_by(name, byte_count, |encoder, staged| {
            if byte_count > 0 {
                encoder.copy_buffer_to_buffer(buffer, bytes.start, staged, 0, byte_count);
            }
        })
    }

    /// - `copy`: to the beginning of the buffer that can be read
    pub(super) fn stage_by(
        &mut self,
        name: &str,
        byte_count: u64,
        copy: impl FnOnce(&mut wgpu::CommandEncoder, &wgpu::Buffer),
    ) -> Result<ReadBack, GpuError> {
        let name = format!("{name}, read back");
        let buffer = self.session.staging(&name, byte_count)?;
        copy(self.encoder(), &buffer.buffer);
        Ok(ReadBack::new(Staging {
            session: Arc::clone(&self.session),
            name,
            byte_count,
            buffer,
            submitted: Arc::clone(&self.submitted),
        }))
    }

    /// What commands that are no dispatches are recorded with.
    pub(super) fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        self.pass = None;
        &mut self.encoder
    }

    pub(super) fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// Hands the work over and returns at once.
    ///
    /// Errors: [`GpuError::Failed`] with what the device refuses (nothing of the batch runs then), [`GpuError::Lost`].
    pub fn submit(mut self) -> Result<Submission, GpuError> {
        self.pass = None;
        self.end_step();
        let mut ticks = None;
        if let Some(Clock { queries, count, .. }) = self.clock.take() {
            let bytes = 0..u64::from(count) * TICK_BYTES;
            let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
            let resolved = self.session.allocate("clock", bytes.end, usage)?;
            self.encoder.resolve_query_set(&queries, 0..count, &resolved.buffer, 0);
            ticks = Some(self.stage(&resolved.buffer, "clock", bytes)?);
        }
        let Batch { name, session, encoder, submitted, .. } = self;
        let index = session.checked(
            || session.queue.submit([encoder.finish()]),
            |error| GpuError::Failed { what: format!("batch {name}: {error}") },
        )?;
        // Set once: this batch is gone with it.
        let _ = submitted.set(index.clone());
        Ok(Submission { name, session, index, ticks })
    }
}

/// Work that the device has.
#[derive(Debug)]
pub struct Submission {
    name: String,
    session: Arc<Session>,
    index: wgpu::SubmissionIndex,
    ticks: Option<ReadBack>,
}

impl Submission {
    /// Waits until it is done.
    ///
    /// Errors: [`GpuError::TimedOut`] after the options' `seconds_max`, [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn wait(&self) -> Result<(), GpuError> {
        self.session.wait_for(&self.index, &self.name)
    }

    /// [`Submission::gpu_seconds`], for which only what is timed is waited for.
    ///
    /// Errors: as [`Submission::wait`].
    pub(super) fn gpu_seconds_if_timed(self) -> Result<Option<f64>, GpuError> {
        if self.ticks.is_none() { Ok(None) } else { self.gpu_seconds() }
    }

    /// Waits until it is done, and returns the seconds it took on the device's clock; `None` for batches that are not
    /// timed and devices without one.
    ///
    /// Errors: as [`Submission::wait`].
    pub fn gpu_seconds(self) -> Result<Option<f64>, GpuError> {
        Ok(self.step_seconds()?.map(|steps| steps.iter().sum()))
    }

    /// Waits until it is done, and returns the seconds that each of its steps took, in their order; `None` as
    /// [`Submission::gpu_seconds`].
    ///
    /// Errors: as [`Submission::wait`].
    pub(crate) fn step_seconds(mut self) -> Result<Option<Vec<f64>>, GpuError> {
        self.wait()?;
        let (Some(ticks), Some(nanoseconds)) = (self.ticks.take(), self.session.nanoseconds_per_tick) else {
            return Ok(None);
        };
        let ticks: Vec<u64> = ticks.read(bytemuck::pod_collect_to_vec)?;
        // A clock that was set back in between says nothing.
        let seconds = |pair: &[u64]| {
            let ticks = pair[1].checked_sub(pair[0])?;
            Some(ticks as f64 * f64::from(nanoseconds) * 1e-9)
        };
        Ok(ticks.windows(2).map(seconds).collect())
    }
}
