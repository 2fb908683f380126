//! Rays and hits.

use glam::Vec3;

use super::leaf::TriangleHit;

/// A half line in render space.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, metres.
    pub origin: Vec3,
    /// Direction; `t` counts in its length.
    pub direction: Vec3,
    /// Surfaces beyond this `t` do not count. The start itself (t ≤ 0) never counts: rays that leave a
    /// surface start off it by its error bound.
    pub t_max: f32,
    /// The triangle it starts on, which is flat and so never met again; [`TriangleId::NONE`] for others.
    pub left: TriangleId,
}

/// A triangle of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriangleId {
    /// Index into [`super::Accel::instances`].
    pub instance: u32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
}

impl TriangleId {
    /// No triangle at all.
    pub const NONE: TriangleId = TriangleId { instance: u32::MAX, triangle: u32::MAX };
}

impl Ray {
    /// A ray without end, from anywhere.
    pub fn new(origin: Vec3, direction: Vec3) -> Ray {
        Ray { origin, direction, t_max: f32::INFINITY, left: TriangleId::NONE }
    }

    /// Where the ray is at `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// A point on a triangle of an instance, met by a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the ray's direction, above 0.
    pub t: f32,
    /// Index into [`super::Accel::instances`].
    pub instance: u32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Barycentric weight of the triangle's second vertex.
    pub b1: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub b2: f32,
}

impl Hit {
    /// The triangle that was met.
    pub fn triangle_id(&self) -> TriangleId {
        TriangleId { instance: self.instance, triangle: self.triangle }
    }

    /// After every hit there is.
    pub(super) const NONE: Hit =
        Hit { t: f32::INFINITY, instance: u32::MAX, triangle: u32::MAX, b1: 0.0, b2: 0.0 };

    #[inline(always)]
    pub(super) fn new(instance: u32, met: &TriangleHit) -> Hit {
        Hit { t: met.t, instance, triangle: met.triangle, b1: met.b1, b2: met.b2 }
    }

    /// `None` for [`Hit::NONE`].
    #[inline(always)]
    pub(super) fn some(self) -> Option<Hit> {
        (self.instance != u32::MAX).then_some(self)
    }

    /// Nearer, or as near with a smaller name: a total order, so that ties break the same way on every tree.
    #[inline(always)]
    pub(super) fn is_before(&self, other: &Hit) -> bool {
        (self.t, self.instance, self.triangle) < (other.t, other.instance, other.triangle)
    }
}
