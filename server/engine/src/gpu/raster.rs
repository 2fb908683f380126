//! Triangles drawn: a vertex and a fragment shader compiled, what they draw on, and draws recorded.
//!
//! A pixel shows the nearest triangle, the sum of all, or only how near the nearest is: [`Overlap`] of a [`Raster`] and of its [`Target`]
//! say which.

use std::{
    ops::Range,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use lumicast_shaders::{Constant, Overlap, Raster};

use super::{
    Batch, BindGroup, Binding, Buffer, GpuError, Layout, ReadBack, Session,
    buffer::{Held, Stages},
};

/// Bytes of a pixel's four words, or floats.
const WORDS_BYTES: u32 = 4 * 4;
/// What all bits of a word are where nothing is drawn.
const NOTHING: f64 = u32::MAX as f64;
/// Of two triangles.
const QUAD_VERTICES: u32 = 6;
/// Of a pixel's nearness.
const NEARNESS_BYTES: u32 = 4;

/// How the words of a pixel are held; `None`: it has none.
fn words_format(overlap: Overlap) -> Option<wgpu::TextureFormat> {
    match overlap {
        Overlap::Nearest => Some(wgpu::TextureFormat::Rgba32Uint),
        // Halves would lose what few records say beside many.
        Overlap::Sum => Some(wgpu::TextureFormat::Rgba32Float),
        Overlap::Nearness => None,
    }
}

/// Triangles that are nearer hide others.
fn has_nearness(overlap: Overlap) -> bool {
    overlap != Overlap::Sum
}

/// Bytes of a pixel that are copied.
const fn copied_bytes(overlap: Overlap) -> u32 {
    match overlap {
        Overlap::Nearness => NEARNESS_BYTES,
        Overlap::Nearest | Overlap::Sum => WORDS_BYTES,
    }
}

/// What is drawn onto a target that shows sums.
const ADDED: wgpu::BlendComponent = wgpu::BlendComponent {
    src_factor: wgpu::BlendFactor::One,
    dst_factor: wgpu::BlendFactor::One,
    operation: wgpu::BlendOperation::Add,
};

/// Compiled shaders that draw.
#[derive(Debug)]
pub struct RasterPipeline {
    pipeline: wgpu::RenderPipeline,
    generation: u64,
}

/// A picture of four words a pixel, in which what is nearest shows, of four floats, in which all that is drawn adds up, or of one float, of how
/// near what is nearest is.
#[derive(Debug)]
pub struct Target {
    name: String,
    overlap: Overlap,
    /// What is copied of it.
    copied: wgpu::Texture,
    words_view: Option<wgpu::TextureView>,
    nearness_view: Option<wgpu::TextureView>,
    size: [u32; 2],
    generation: u64,
    _held: Held,
}

impl Target {
    /// Columns come in multiples of this: copies take whole rows of so many bytes alone.
    pub const fn width_step(overlap: Overlap) -> u32 {
        wgpu::COPY_BYTES_PER_ROW_ALIGNMENT / copied_bytes(overlap)
    }

    /// Columns and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Bytes of all its pixels, row by row, as they are copied.
    pub fn byte_count(&self) -> u64 {
        u64::from(self.size[0]) * u64::from(self.size[1]) * u64::from(copied_bytes(self.overlap))
    }

    fn copied_to<'a>(&self, buffer: &'a wgpu::Buffer, at: u64) -> wgpu::TexelCopyBufferInfo<'a> {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: at,
            bytes_per_row: Some(self.size[0] * copied_bytes(self.overlap)),
            rows_per_image: None,
        };
        wgpu::TexelCopyBufferInfo { buffer, layout }
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

/// Quads that add to a target's sums.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Quads {
    /// Columns and rows that they lie on, from the target's first on.
    pub size: [u32; 2],
    /// What the vertex shader knows each by, six vertices a quad.
    pub numbers: Range<u32>,
    /// Whether the sums begin anew.
    pub begins: SumsBegin,
}

/// What is there before something is added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SumsBegin {
    /// Nothing.
    AtZero,
    /// What was added before.
    AsTheyAre,
}

impl Session {
    /// Shaders compiled with these constants for these groups, which are of [`Session::raster_layout`].
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`]; [`GpuError::Insufficient`] where it is sums that are drawn
    /// and the adapter cannot add up floats of 32 bits.
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
        if raster.overlap == Overlap::Sum {
            check_sums(&self.report().name, self.device.features())?;
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
        let is_sum = raster.overlap == Overlap::Sum;
        let nearest = wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        };
        let shown = words_format(raster.overlap).map(|format| wgpu::ColorTargetState {
            format,
            blend: is_sum.then_some(wgpu::BlendState { color: ADDED, alpha: ADDED }),
            write_mask: wgpu::ColorWrites::ALL,
        });
        let shown: Vec<_> = shown.into_iter().map(Some).collect();
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
                    depth_stencil: has_nearness(raster.overlap).then_some(nearest),
                    multisample: wgpu::MultisampleState::default(),
                    fragment: Some(wgpu::FragmentState {
                        module: &module,
                        entry_point: Some(raster.fragment),
                        compilation_options: wgpu::PipelineCompilationOptions::default(),
                        targets: &shown,
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

    /// A target of so many columns, a multiple of [`Target::width_step`], and rows, for rasters that overlap so.
    ///
    /// Errors: [`GpuError::OutOfMemory`], also where the adapter knows no pictures as large; [`GpuError::Lost`],
    /// [`GpuError::Failed`].
    pub fn target(&self, name: &str, size: [u32; 2], overlap: Overlap) -> Result<Target, GpuError> {
        self.making_way(|| self.target_beside_spare(name, size, overlap))
    }

    /// The same where memory that is kept for later reads stays.
    fn target_beside_spare(&self, name: &str, size: [u32; 2], overlap: Overlap) -> Result<Target, GpuError> {
        let [width, height] = size;
        let words_bytes = words_format(overlap).map_or(0, |_| WORDS_BYTES);
        let pixel_bytes = words_bytes + if has_nearness(overlap) { NEARNESS_BYTES } else { 0 };
        let bytes_of =
            |width: u32, height: u32| u64::from(width) * u64::from(height) * u64::from(pixel_bytes);
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
        let (words, nearness) = self.checked(
            || {
                let words = words_format(overlap);
                let of_nearness = if words.is_some() {
                    wgpu::TextureUsages::empty()
                } else {
                    wgpu::TextureUsages::COPY_SRC
                };
                let nearness = || texture(wgpu::TextureFormat::Depth32Float, of_nearness);
                (
                    words.map(|format| texture(format, wgpu::TextureUsages::COPY_SRC)),
                    has_nearness(overlap).then(nearness),
                )
            },
            |error| match error {
                wgpu::Error::OutOfMemory { .. } => refused(0, "the adapter's memory"),
                error => GpuError::Failed { what: format!("target {name:?}: {error}") },
            },
        )?;
        let view_of = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let [words_view, nearness_view] = [&words, &nearness].map(|texture| texture.as_ref().map(view_of));
        let nothing = || GpuError::Failed { what: format!("target {name:?} shows nothing") };
        let copied = words.or(nearness).ok_or_else(nothing)?;
        let generation = self.generation();
        Ok(Target {
            name: name.into(),
            overlap,
            copied,
            words_view,
            nearness_view,
            size,
            generation,
            _held: held,
        })
    }
}

/// Errors where floats of 32 bits are not added up by an adapter with these features.
fn check_sums(adapter: &str, features: wgpu::Features) -> Result<(), GpuError> {
    if features.contains(wgpu::Features::FLOAT32_BLENDABLE) {
        return Ok(());
    }
    let limit = "kinds of pictures whose floats of 32 bits add up";
    Err(GpuError::Insufficient { adapter: adapter.to_string(), limit, found: 0, needed: 1 })
}

fn extent_of([width, height]: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}

impl Batch {
    /// Draws onto a target that shows nothing but what is drawn now: where that is nothing, all bits of its words are set, or its nearness is 0.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn draw(
        &mut self,
        pipeline: &RasterPipeline,
        groups: &[&BindGroup],
        target: &Target,
        draws: &[Draw],
    ) -> Result<(), GpuError> {
        self.own_all(pipeline, groups, target)?;
        let load = wgpu::LoadOp::Clear(wgpu::Color { r: NOTHING, g: NOTHING, b: NOTHING, a: NOTHING });
        let mut pass = self.raster_pass(pipeline, groups, target, load);
        for Draw { corner: [left, top], size: [width, height], vertex_count, number } in draws.iter().copied()
        {
            pass.set_viewport(left as f32, top as f32, width as f32, height as f32, 0.0, 1.0);
            pass.set_scissor_rect(left, top, width, height);
            pass.draw(0..vertex_count, number..number + 1);
        }
        Ok(())
    }

    /// Adds quads to a target's sums.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn add(
        &mut self,
        pipeline: &RasterPipeline,
        groups: &[&BindGroup],
        target: &Target,
        Quads { size: [width, height], numbers, begins }: Quads,
    ) -> Result<(), GpuError> {
        self.own_all(pipeline, groups, target)?;
        let load = match begins {
            SumsBegin::AtZero => wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            SumsBegin::AsTheyAre => wgpu::LoadOp::Load,
        };
        let mut pass = self.raster_pass(pipeline, groups, target, load);
        pass.set_viewport(0.0, 0.0, width as f32, height as f32, 0.0, 1.0);
        pass.set_scissor_rect(0, 0, width, height);
        pass.draw(0..QUAD_VERTICES, numbers);
        Ok(())
    }

    fn own_all(
        &self,
        pipeline: &RasterPipeline,
        groups: &[&BindGroup],
        target: &Target,
    ) -> Result<(), GpuError> {
        let session = self.session();
        session.own(pipeline.generation)?;
        session.own(target.generation)?;
        groups.iter().try_for_each(|group| session.own(group.generation))
    }

    fn raster_pass(
        &mut self,
        pipeline: &RasterPipeline,
        groups: &[&BindGroup],
        target: &Target,
        load: wgpu::LoadOp<wgpu::Color>,
    ) -> wgpu::RenderPass<'_> {
        let nearness = target.nearness_view.as_ref().map(|view| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(0.0),
                store: match target.overlap {
                    Overlap::Nearness => wgpu::StoreOp::Store,
                    Overlap::Nearest | Overlap::Sum => wgpu::StoreOp::Discard,
                },
            }),
            stencil_ops: None,
        });
        let words = target.words_view.as_ref().map(|view| wgpu::RenderPassColorAttachment {
            view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
        });
        let words: Vec<_> = words.into_iter().map(Some).collect();
        let mut pass = self.encoder().begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(&target.name),
            color_attachments: &words,
            depth_stencil_attachment: nearness,
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&pipeline.pipeline);
        for (index, group) in (0..).zip(groups) {
            pass.set_bind_group(index, &group.group, &[]);
        }
        pass
    }

    /// Copies a target's words, or its nearness, row by row to a buffer from byte `at` on.
    ///
    /// Errors: as [`Batch::dispatch`].
    pub fn copy_target(&mut self, target: &Target, to: &Buffer, at: u64) -> Result<(), GpuError> {
        self.session().own(target.generation)?;
        self.session().own(to.generation())?;
        let copied_to = target.copied_to(&to.buffer, at);
        let size = extent_of(target.size);
        self.encoder().copy_texture_to_buffer(target.copied.as_image_copy(), copied_to, size);
        Ok(())
    }

    /// Copies a target's words, row by row, to where they can be read once the batch is done.
    ///
    /// Errors: as [`Batch::read_back`].
    pub fn read_back_target(&mut self, target: &Target) -> Result<ReadBack, GpuError> {
        let byte_count = target.byte_count();
        self.session().own(target.generation)?;
        self.stage_by(&target.name, byte_count, |encoder, staged| {
            let to = target.copied_to(staged, 0);
            encoder.copy_texture_to_buffer(target.copied.as_image_copy(), to, extent_of(target.size));
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where an adapter cannot add up floats, what is drawn so says so, and names the adapter.
    #[test]
    fn adapters_without_sums_are_refused_by_name() {
        assert_eq!(check_sums("any", wgpu::Features::FLOAT32_BLENDABLE), Ok(()));
        let refused = check_sums("old card", wgpu::Features::empty()).unwrap_err().to_string();
        assert!(refused.contains("\"old card\" has 0 kinds of pictures"), "{refused}");
    }
}
