//! Buffers with byte bounds, and how steps see them.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use bytemuck::Pod;

use super::{GpuError, Session, session::locked};

/// Bytes of a buffer that would be empty: bindings must not be, and 16 hold the largest scalar or vector.
const BYTES_MIN: u64 = 16;

/// Bytes that a session's buffers hold, and may hold.
#[derive(Debug)]
pub(super) struct Budget {
    bytes_max: u64,
    held: AtomicU64,
}

impl Budget {
    pub(super) fn new(bytes_max: u64) -> Budget {
        Budget { bytes_max, held: AtomicU64::new(0) }
    }

    pub(super) fn held(&self) -> u64 {
        self.held.load(Ordering::Relaxed)
    }

    /// Takes bytes; the error is what is left.
    pub(super) fn take(self: &Arc<Budget>, byte_count: u64) -> Result<Held, u64> {
        let taken = self.held.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |held| {
            held.checked_add(byte_count).filter(|held| *held <= self.bytes_max)
        });
        match taken {
            Ok(_) => Ok(Held { budget: Arc::clone(self), byte_count }),
            Err(held) => Err(self.bytes_max.saturating_sub(held)),
        }
    }
}

/// Bytes of a budget, given back on drop.
#[derive(Debug)]
pub(super) struct Held {
    budget: Arc<Budget>,
    byte_count: u64,
}

impl Drop for Held {
    fn drop(&mut self) {
        self.budget.held.fetch_sub(self.byte_count, Ordering::Relaxed);
    }
}

/// Memory on the graphics card. Its bytes go back to the session's budget when it is dropped.
#[derive(Debug)]
pub struct Buffer {
    name: String,
    pub(super) buffer: wgpu::Buffer,
    byte_count: u64,
    generation: u64,
    _held: Held,
}

impl Buffer {
    /// What it is called in errors.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Bytes that it was asked to hold; 0 also where a dummy of 16 bytes stands in for nothing.
    pub fn byte_count(&self) -> u64 {
        self.byte_count
    }

    /// [`Session::generation`] of the device that holds it.
    pub fn generation(&self) -> u64 {
        self.generation
    }
}

/// How a step sees one buffer of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Binding {
    /// `var<storage, read>`
    Read,
    /// `var<storage, read_write>`
    Write,
    /// `var<uniform>`
    Uniform,
}

/// Which shaders see a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stages {
    /// Steps.
    Compute,
    /// What is drawn.
    Raster,
}

/// What tells layouts apart: who sees them, and their bindings.
pub(super) type LayoutKey = (Stages, Vec<Binding>);

/// The bindings of a group, 0, 1, 2 …
#[derive(Debug)]
pub struct Layout {
    pub(super) layout: wgpu::BindGroupLayout,
    pub(super) bindings: Vec<Binding>,
    pub(super) generation: u64,
}

/// Buffers bound to a layout.
#[derive(Debug)]
pub struct BindGroup {
    pub(super) group: wgpu::BindGroup,
    pub(super) generation: u64,
}

impl Session {
    /// A buffer that holds `contents`, padded to whole words; 16 zero bytes where there are none.
    ///
    /// Errors: [`GpuError::OutOfMemory`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn buffer(&self, name: &str, contents: &[u8]) -> Result<Buffer, GpuError> {
        let buffer = self.buffer_zeroed(name, contents.len() as u64)?;
        self.write(&buffer, 0, contents)?;
        Ok(buffer)
    }

    /// A buffer that holds items, for an array of them; one of zeros, which nothing reads, where there are none: bindings hold
    /// one at least.
    ///
    /// Errors: as [`Session::buffer`].
    pub fn buffer_of<T: Pod>(&self, name: &str, items: &[T]) -> Result<Buffer, GpuError> {
        if items.is_empty() {
            return self.buffer_zeroed(name, size_of::<T>() as u64);
        }
        self.buffer(name, bytemuck::cast_slice(items))
    }

    /// A buffer of zeros. Steps may read, write and bind it as uniform, and dispatches take their size from it.
    ///
    /// Errors: as [`Session::buffer`].
    pub fn buffer_zeroed(&self, name: &str, byte_count: u64) -> Result<Buffer, GpuError> {
        use wgpu::BufferUsages as Usages;
        let usage =
            Usages::STORAGE | Usages::UNIFORM | Usages::INDIRECT | Usages::COPY_SRC | Usages::COPY_DST;
        self.check_binding(name, byte_count)?;
        self.allocate(name, byte_count, usage)
    }

    /// Bytes that shaders may see at once.
    pub fn binding_bytes_max(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size
    }

    /// Whether shaders may see so many bytes at once.
    ///
    /// Errors: [`GpuError::OutOfMemory`] where they may not.
    pub fn check_binding(&self, name: &str, byte_count: u64) -> Result<(), GpuError> {
        let bytes_allowed = self.binding_bytes_max();
        if byte_count <= bytes_allowed {
            return Ok(());
        }
        let limit = "the adapter's largest binding";
        Err(GpuError::OutOfMemory { name: name.to_string(), byte_count, bytes_allowed, limit })
    }

    /// A buffer for these uses, within all bounds.
    pub(super) fn allocate(
        &self,
        name: &str,
        byte_count: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<Buffer, GpuError> {
        self.making_way(|| self.allocate_beside_spare(name, byte_count, usage))
    }

    /// The same where memory that is kept for later reads stays.
    fn allocate_beside_spare(
        &self,
        name: &str,
        byte_count: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<Buffer, GpuError> {
        let refused = |bytes_allowed: u64, limit: &'static str| GpuError::OutOfMemory {
            name: name.to_string(),
            byte_count,
            bytes_allowed,
            limit,
        };
        if byte_count > self.limits.max_buffer_size {
            return Err(refused(self.limits.max_buffer_size, "the adapter's largest buffer"));
        }
        let size = byte_count.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT).max(BYTES_MIN);
        let held =
            self.budget.take(size).map_err(|left| refused(left, "what is left of the bytes it may take"))?;
        let descriptor = wgpu::BufferDescriptor { label: Some(name), size, usage, mapped_at_creation: false };
        let buffer = self.checked(
            || self.device.create_buffer(&descriptor),
            |error| match error {
                wgpu::Error::OutOfMemory { .. } => refused(0, "the adapter's memory"),
                error => GpuError::Failed { what: format!("buffer {name:?}: {error}") },
            },
        )?;
        Ok(Buffer { name: name.to_string(), buffer, byte_count, generation: self.generation(), _held: held })
    }

    /// Writes bytes into a buffer, before the batches that are submitted afterwards.
    ///
    /// - `offset`: bytes from its start, a multiple of 4
    /// - `contents`: padded by zeros to whole words
    ///
    /// Errors: [`GpuError::Failed`] beyond the buffer's end, [`GpuError::Lost`].
    pub fn write(&self, buffer: &Buffer, offset: u64, contents: &[u8]) -> Result<(), GpuError> {
        self.own(buffer.generation)?;
        let (words, rest) = contents.split_at(contents.len() / 4 * 4);
        let mut last = [0; 4];
        last[..rest.len()].copy_from_slice(rest);
        self.checked(
            || {
                if !words.is_empty() {
                    self.queue.write_buffer(&buffer.buffer, offset, words);
                }
                if !rest.is_empty() {
                    self.queue.write_buffer(&buffer.buffer, offset + words.len() as u64, &last);
                }
            },
            |error| GpuError::Failed { what: format!("writing to buffer {:?}: {error}", buffer.name) },
        )
    }

    /// The layout of a group whose bindings are these; made once.
    ///
    /// Errors: [`GpuError::Failed`], [`GpuError::Lost`].
    pub fn layout(&self, bindings: &[Binding]) -> Result<Arc<Layout>, GpuError> {
        self.layout_for(Stages::Compute, bindings)
    }

    pub(super) fn layout_for(&self, stages: Stages, bindings: &[Binding]) -> Result<Arc<Layout>, GpuError> {
        self.check()?;
        let key = (stages, bindings.to_vec());
        let mut layouts = locked(&self.layouts);
        if let Some(layout) = layouts.get(&key) {
            return Ok(Arc::clone(layout));
        }
        let entries: Vec<_> =
            (0..).zip(bindings).map(|(index, binding)| entry_of(stages, index, *binding)).collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries };
        let layout = self.checked(
            || self.device.create_bind_group_layout(&descriptor),
            |error| GpuError::Failed { what: format!("layout of {bindings:?}: {error}") },
        )?;
        let layout = Arc::new(Layout { layout, bindings: bindings.to_vec(), generation: self.generation() });
        layouts.insert(key, Arc::clone(&layout));
        Ok(layout)
    }

    /// Binds buffers, whole, to a layout's bindings in their order.
    ///
    /// Errors: [`GpuError::Failed`] where their count or size does not fit, [`GpuError::Lost`].
    pub fn bind(&self, layout: &Layout, buffers: &[&Buffer]) -> Result<BindGroup, GpuError> {
        self.own(layout.generation)?;
        for buffer in buffers {
            self.own(buffer.generation)?;
        }
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding,
                resource: buffer.buffer.as_entire_binding(),
            })
            .collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &layout.layout, entries: &entries };
        let group = self.checked(
            || self.device.create_bind_group(&descriptor),
            |error| {
                let names: Vec<&str> = buffers.iter().map(|buffer| buffer.name()).collect();
                GpuError::Failed { what: format!("binding {names:?}: {error}") }
            },
        )?;
        Ok(BindGroup { group, generation: self.generation() })
    }

    /// Errors where something is of a device that was lost.
    pub(super) fn own(&self, generation: u64) -> Result<(), GpuError> {
        if generation == self.generation() { Ok(()) } else { Err(GpuError::Lost) }
    }
}

fn entry_of(stages: Stages, binding: u32, kind: Binding) -> wgpu::BindGroupLayoutEntry {
    let ty = match kind {
        Binding::Read => wgpu::BufferBindingType::Storage { read_only: true },
        Binding::Write => wgpu::BufferBindingType::Storage { read_only: false },
        Binding::Uniform => wgpu::BufferBindingType::Uniform,
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: match stages {
            Stages::Compute => wgpu::ShaderStages::COMPUTE,
            Stages::Raster => wgpu::ShaderStages::VERTEX_FRAGMENT,
        },
        // Sizes are checked at each dispatch: they are the shader's to say.
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}
