//! Axis-aligned bounds in double precision, for scene-sized questions. Ray traversal has its own in `accel`.

use glam::{DAffine3, DVec3};

/// Axis-aligned box, metres, world or mesh space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest corner.
    pub min: DVec3,
    /// Largest corner.
    pub max: DVec3,
}

impl Aabb {
    /// Holds nothing: the neutral element of `union`.
    pub const EMPTY: Aabb = Aabb { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };
    /// The cube from −1 to 1.
    pub const UNIT: Aabb = Aabb { min: DVec3::NEG_ONE, max: DVec3::ONE };

    /// True when it holds no point.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Smallest box around both.
    pub fn union(&self, other: &Aabb) -> Aabb {
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Smallest box around `self` and `point`.
    pub fn including(&self, point: DVec3) -> Aabb {
        Aabb { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Middle of the box.
    pub fn centre(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// Half of the diagonal: the radius of the sphere around the box.
    pub fn radius(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() * 0.5 }
    }

    /// Box around the eight transformed corners.
    pub fn transformed(&self, transform: &DAffine3) -> Aabb {
        if self.is_empty() {
            return Aabb::EMPTY;
        }
        (0..8).fold(Aabb::EMPTY, |bounds, corner_index| {
            let pick =
                |bit: usize, low: f64, high: f64| if corner_index >> bit & 1 == 0 { low } else { high };
            let corner = DVec3::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            );
            bounds.including(transform.transform_point3(corner))
        })
    }
}
