//! The two-level tree on the device, and rays for it: the Rust side of `accel/tree.wgsl`.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::Constant;

use super::{BindGroup, Binding, Buffer, GpuError, Layout, Session};
use crate::accel::{AccelBuffers, Hit, Ray, TriangleId};

/// The stack's size is rounded up to a multiple of this many entries: each size is a shader to compile, and an edit that
/// makes a tree one level deeper should not need another.
const STACK_STEP: usize = 8;

/// What the walk knows of the trees as a whole; `AccelHeader` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct AccelHeader {
    /// [`AccelBuffers::top_reach`].
    top_reach: f32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

/// A ray as steps read it; `Ray` in WGSL, which pads it to 48 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuRay {
    /// Start in render space.
    pub origin: [f32; 3],
    /// Surfaces beyond do not count. Never infinite: WGSL may assume that nothing is.
    pub t_max: f32,
    /// Direction; `t` counts in its length.
    pub direction: [f32; 3],
    /// Instance of the triangle it starts on, `u32::MAX` for none.
    pub left_instance: u32,
    /// The triangle it starts on, `u32::MAX` for none.
    pub left_triangle: u32,
    /// Zeros.
    pub padding: [u32; 3],
}

impl GpuRay {
    /// The same ray.
    pub fn new(ray: &Ray) -> GpuRay {
        GpuRay {
            origin: ray.origin.into(),
            // `min` also takes the place of NaN, and what is below 0 meets nothing.
            t_max: ray.t_max.min(f32::MAX),
            direction: ray.direction.into(),
            left_instance: ray.left.instance,
            left_triangle: ray.left.triangle,
            padding: [0; 3],
        }
    }
}

/// A ray to a light; `ShadowRay` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuShadowRay {
    /// The ray, which ends at the light.
    pub ray: GpuRay,
    /// Instance of the light's own triangle, which hides nothing; `u32::MAX` for none.
    pub light_instance: u32,
    /// The light's own triangle, `u32::MAX` for none.
    pub light_triangle: u32,
    /// Zero.
    pub padding_0: u32,
    /// Zero.
    pub padding_1: u32,
}

impl GpuShadowRay {
    /// A ray to a light whose triangle is `light`; [`TriangleId::NONE`] for lights that are no triangles.
    pub fn new(ray: &Ray, light: TriangleId) -> GpuShadowRay {
        GpuShadowRay {
            ray: GpuRay::new(ray),
            light_instance: light.instance,
            light_triangle: light.triangle,
            padding_0: 0,
            padding_1: 0,
        }
    }
}

/// A hit as steps write it; `Hit` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuHit {
    /// Distance in lengths of the ray's direction; the ray's `t_max` where nothing was met.
    pub t: f32,
    /// Index into [`crate::accel::Accel::instances`]; `u32::MAX` where nothing was met.
    pub instance: u32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Weight of the triangle's second vertex.
    pub b1: f32,
    /// Weight of the triangle's third vertex.
    pub b2: f32,
}

impl GpuHit {
    /// The same hit; `None` where nothing was met.
    pub fn hit(&self) -> Option<Hit> {
        let GpuHit { t, instance, triangle, b1, b2 } = *self;
        (instance != u32::MAX).then_some(Hit { t, instance, triangle, b1, b2 })
    }
}

/// A scene's trees on the device: group 0, bindings 0 to 5, of every step that casts rays.
#[derive(Debug)]
pub struct GpuTrees {
    top_nodes: Buffer,
    nodes: Buffer,
    parts: Buffer,
    instances: Buffer,
    triangles: Buffer,
    header: Buffer,
}

impl GpuTrees {
    /// How steps see them, from binding 0. Steps that bind more to group 0 go on from 6.
    pub const BINDINGS: [Binding; 6] =
        [Binding::Read, Binding::Read, Binding::Read, Binding::Read, Binding::Read, Binding::Uniform];

    /// Copies trees to the device.
    ///
    /// Errors: [`GpuError::OutOfMemory`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn new(session: &Session, trees: &AccelBuffers) -> Result<GpuTrees, GpuError> {
        let header = AccelHeader { top_reach: trees.top_reach, padding_0: 0, padding_1: 0, padding_2: 0 };
        Ok(GpuTrees {
            top_nodes: session.buffer_of("top nodes", &trees.top_nodes)?,
            nodes: session.buffer_of("nodes", &trees.nodes)?,
            parts: session.buffer_of("parts", &trees.parts)?,
            instances: session.buffer_of("instances", &trees.instances)?,
            triangles: session.buffer_of("triangles", &trees.triangles)?,
            header: session.buffer_of("header of the trees", &[header])?,
        })
    }

    /// The buffers of [`GpuTrees::BINDINGS`], in their order.
    pub fn buffers(&self) -> [&Buffer; 6] {
        [&self.top_nodes, &self.nodes, &self.parts, &self.instances, &self.triangles, &self.header]
    }

    /// The constants that `accel/tree.wgsl` wants: `STACK_SIZE`, and `HAS_MASKS` as the scene has masks.
    pub fn constants(trees: &AccelBuffers, masks: Masks) -> [(&'static str, Constant); 2] {
        let stack_size = stack_size_of(trees.stack_need);
        [("STACK_SIZE", Constant::U32(stack_size)), ("HAS_MASKS", Constant::Bool(masks == Masks::Asked))]
    }

    /// The layout of a group that holds the trees and no more.
    ///
    /// Errors: as [`Session::layout`].
    pub fn layout(session: &Session) -> Result<Arc<Layout>, GpuError> {
        session.layout(&GpuTrees::BINDINGS)
    }

    /// The group that holds the trees and no more.
    ///
    /// Errors: as [`Session::bind`].
    pub fn bind(&self, session: &Session) -> Result<BindGroup, GpuError> {
        session.bind(&*GpuTrees::layout(session)?, &self.buffers())
    }
}

/// Whether hits are asked for by a step's `is_present`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Masks {
    /// Every triangle is whole.
    None,
    /// Masks may cut holes.
    Asked,
}

fn stack_size_of(stack_need: usize) -> u32 {
    stack_need.max(1).next_multiple_of(STACK_STEP) as u32
}
