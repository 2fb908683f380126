//! Triangles drawn: a vertex and a fragment shader compiled, what they draw on, and draws recorded.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use lumicast_shaders::{Constant, Raster};

use super::{
    Batch, BindGroup, Binding, GpuError, Layout, ReadBack, Session,
    buffer::{Held, Stages},
};

/// Words of a pixel.
const WORDS: u32 = 4;
const WORD_BYTES: u32 = WORDS * 4;
/// Of a pixel's nearness, beside its words.
const NEARNESS_BYTES: u64 = 4;

/// Compiled shaders that draw.
#[derive(Debug)]
pub struct RasterPipeline {
    pipeline: wgpu::RenderPipeline,
    generation: u64,
}

/// A picture of four words a pixel, in which what is nearest shows.
#[derive(Debug)]
pub struct Target {
    name: String,
    words: wgpu::Texture,
    words_view: wgpu::TextureView,
    nearness_view: wgpu::TextureView,
    size: [u32; 2],
    generation: u64,
    _held: Held,
}

impl Target {
    /// Columns come in multiples of this: copies take whole rows of so many bytes alone.
    pub const WIDTH_STEP: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT / WORD_BYTES;

    fn byte_count(&self) -> u64 {
        u64::from(self.size[0]) * u64::from(self.size[1]) * u64::from(WORD_BYTES)
    }
}

/// Triangles drawn onto a part of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw {
    /// First column and row of the part.
    pub corner: [u32; 2],
    /// Its columns and rows.
    pub size: [u32; 2],
    /// Vertices, three a triangle.
    pub vertex_count: u32,
    /// What the vertex shader knows the draw by.
    pub number: u32,
}

impl Session {
    /// Shaders compiled with these constants for these groups, which are of [`Session::raster_layout`].
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn raster_pipeline(
        &self,
        raster: &Raster,
        constants: &[(&str, Constant)],
        layouts: &[&Layout],
    ) -> Result<RasterPipeline, GpuError> {
        self.check()?;
        for layout in layouts {
            self.own(layout.generation)?;
        }
        let started = Instant::now();
        let compiled = self.compile_raster(raster, constants, layouts);
        self.shader_nanoseconds.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
        Ok(RasterPipeline { pipeline: compiled?, generation: self.generation() })
    }

    fn compile_raster(
        &self,
        raster: &Raster,
        constants: &[(&str, Constant)],
        layouts: &[&Layout],
    ) -> Result<wgpu::RenderPipeline, GpuError> {
        let source = raster.source(constants);
        self.checked(
            || {
                let (module, layout) = self.module_and_layout(raster.name, source, layouts);
                self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                    label: Some(raster.name),
                    layout: Some(&layout),
                    vertex: wgpu::VertexState {
                        module: &module,
                        entry_point: Some(raster.vertex),
                        compilation_options: wgpu::PipelineCompilationOptions::default(),
                        buffers: &[],
                    },
                    // Both sides show, as rays see them.
                    primitive: wgpu::PrimitiveState::default(),
                    depth_stencil: Some(wgpu::DepthStencilState {
                        format: wgpu::TextureFormat::Depth32Float,
                        depth_write_enabled: Some(true),
                        depth_compare: Some(wgpu::CompareFunction::Greater),
                        stencil: wgpu::StencilState::default(),
                        bias: wgpu::DepthBiasState::default(),
                    }),
                    multisample: wgpu::MultisampleState::default(),
                    fragment: Some(wgpu::FragmentState {
                        module: &module,
                        entry_point: Some(raster.fragment),
                        compilation_options: wgpu::PipelineCompilationOptions::default(),
                        targets: &[Some(wgpu::TextureFormat::Rgba32Uint.into())],
                    }),
                    multiview_mask: None,
                    cache: None,
                })
            },
            |error| GpuError::Shader { step: raster.name.to_string(), what: error.to_string() },
        )
    }

    /// [`Session::layout`] for what is drawn; nothing of it is written.
    ///
    /// Errors: as [`Session::layout`].
    pub fn raster_layout(&self, bindings: &[Binding]) -> Result<Arc<Layout>, GpuError> {
        self.layout_for(Stages::Raster, bindings)
    }

    /// A target of so many columns, a multiple of [`Target::WIDTH_STEP`], and rows.
    ///
    /// Errors: [`GpuError::OutOfMemory`], also where the adapter knows no pictures as large; [`GpuError::Lost`],
    /// [`GpuError::Failed`].
    pub fn target(&self, name: &str, size: [u32; 2]) -> Result<Target, GpuError> {
        let [width, height] = size;
        let bytes_of = |width: u32, height: u32| {
            u64::from(width) * u64::from(height) * (u64::from(WORD_BYTES) + NEARNESS_BYTES)
        };
        let byte_count = bytes_of(width, height);
        let refused = |bytes_allowed: u64, limit: &'static str| GpuError::OutOfMemory {
            name: name.to_string(),
            byte_count,
            bytes_allowed,
            limit,
        };
        let side_max = self.limits.max_texture_dimension_2d;
        if width.max(height) > side_max {
            let bytes_allowed = bytes_of(width.min(side_max), height.min(side_max));
            return Err(refused(bytes_allowed, "the longest side of the adapter's pictures"));
        }
        let held = self
            .budget
            .take(byte_count)
            .map_err(|left| refused(left, "what is left of the bytes it may take"))?;
        let texture = |format: wgpu::TextureFormat, usage: wgpu::TextureUsages| {
            self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(name),
                size: extent_of(size),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: usage | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            })
        };
        let [words, nearness] = self.checked(
            || {
                [
                    texture(wgpu::TextureFormat::Rgba32Uint, wgpu::TextureUsages::COPY_SRC),
                    texture(wgpu::TextureFormat::Depth32Float, wgpu::TextureUsages::empty()),
                ]
            },
            |error| match error {
                wgpu::Error::OutOfMemory { .. } => refused(0, "the adapter's memory"),
                error => GpuError::Failed { what: format!("target {name:?}: {error}") },
            },
        )?;
        let [words_view, nearness_view] =
            [&words, &nearness].map(|texture| texture.create_view(&wgpu::TextureViewDescriptor::default()));
        let generation = self.generation();
        Ok(Target { name: name.into(), words, words_view, nearness_view, size, generation, _held: held })
    }
}

fn extent_of([width, height]: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}

impl Batch {
    /// Draws onto a target that shows nothing but what is drawn now: where that is nothing, all bits of its words are set.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn draw(
        &mut self,
        pipeline: &RasterPipeline,
        groups: &[&BindGroup],
        target: &Target,
        draws: &[Draw],
    ) -> Result<(), GpuError> {
        let session = self.session();
        session.own(pipeline.generation)?;
        session.own(target.generation)?;
        for group in groups {
            session.own(group.generation)?;
        }
        let encoder = self.encoder();
        let nothing = f64::from(u32::MAX);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(&target.name),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &target.words_view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color { r: nothing, g: nothing, b: nothing, a: nothing }),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &target.nearness_view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&pipeline.pipeline);
        for (index, group) in (0..).zip(groups) {
            pass.set_bind_group(index, &group.group, &[]);
        }
        for Draw { corner: [left, top], size: [width, height], vertex_count, number } in draws.iter().copied()
        {
            pass.set_viewport(left as f32, top as f32, width as f32, height as f32, 0.0, 1.0);
            pass.set_scissor_rect(left, top, width, height);
            pass.draw(0..vertex_count, number..number + 1);
        }
        Ok(())
    }

    /// Copies a target's words, row by row, to where they can be read once the batch is done.
    ///
    /// Errors: as [`Batch::read_back`].
    pub fn read_back_target(&mut self, target: &Target) -> Result<ReadBack, GpuError> {
        let byte_count = target.byte_count();
        self.session().own(target.generation)?;
        self.stage_by(&target.name, byte_count, |encoder, staged| {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(target.size[0] * WORD_BYTES),
                rows_per_image: None,
            };
            let to = wgpu::TexelCopyBufferInfo { buffer: staged, layout };
            encoder.copy_texture_to_buffer(target.words.as_image_copy(), to, extent_of(target.size));
        })
    }
}
