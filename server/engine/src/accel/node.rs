//! A node of eight children, and the test of all eight against a ray at once.
//!
//! The test is *conservative*: it never loses a box that holds a triangle which the triangle test would report, however
//! both round [Woop2013, 3.2]. That makes answers independent of the tree's shape and of the instruction set. Room for
//! the rounding is built into the ray's constants once, so that it costs nothing per node.

use fearless_simd::{Bytes, Simd, SimdBase, SimdFloat, SimdMask, f32x8, i32x8};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;

/// Children of a node.
pub(super) const WIDTH: usize = 8;

/// Marks a child that is a leaf rather than a node.
pub(super) const LEAF: u32 = 1 << 31;

/// Where a free slot leads: past the end of every tree, so that even a ray of numbers that are none, which may enter what
/// nothing enters, comes to an end.
pub(super) const FREE: u32 = 1 << 30;

/// Eight children: 4 cache lines.
///
/// The rows are min x, max x, min y, max y, min z, max z of the children's bounds; then where each child leads, as the
/// bits of a `u32` (`LEAF` and the leaf, or the index of a node); then nothing. Eight rows of one type make "the near
/// side on this axis" an index that is always in range. Free slots hold bounds turned inside out, which no ray enters.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct WideNode {
    rows: [[f32; WIDTH]; 8],
}

const CHILD_ROW: usize = 6;

impl WideNode {
    pub(super) const EMPTY: WideNode = {
        let (low, high) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        WideNode { rows: [low, high, low, high, low, high, [f32::from_bits(FREE); WIDTH], [0.0; WIDTH]] }
    };

    /// Puts a child into a slot.
    pub(super) fn set(&mut self, slot: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.rows[2 * axis][slot] = bounds.min[axis];
            self.rows[2 * axis + 1][slot] = bounds.max[axis];
        }
        self.rows[CHILD_ROW][slot] = f32::from_bits(child);
    }

    /// Turns where each used slot leads into what `to` makes of it.
    pub(super) fn lead_to(&mut self, to: impl Fn(u32) -> u32) {
        for slot in 0..WIDTH {
            if !self.is_free(slot) {
                self.rows[CHILD_ROW][slot] = f32::from_bits(to(self.child(slot)));
            }
        }
    }

    /// Empties a slot.
    pub(super) fn clear(&mut self, slot: usize) {
        self.set(slot, &Aabb { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY }, FREE);
    }

    /// Where a slot leads; meaningless for a free one.
    #[inline(always)]
    pub(super) fn child(&self, slot: usize) -> u32 {
        self.rows[CHILD_ROW][slot % WIDTH].to_bits()
    }

    /// True when no child is in the slot.
    pub(super) fn is_free(&self, slot: usize) -> bool {
        self.rows[0][slot] > self.rows[1][slot]
    }

    /// Bounds of the child in a slot.
    pub(super) fn bounds(&self, slot: usize) -> Aabb {
        let side = |side: usize| Vec3A::from_array([0, 1, 2].map(|axis| self.rows[2 * axis + side][slot]));
        Aabb { min: side(0), max: side(1) }
    }

    /// Bounds of all children together.
    pub(super) fn union(&self) -> Aabb {
        let mut union = Aabb { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };
        for slot in self.used() {
            union = union.union(&self.bounds(slot));
        }
        union
    }

    /// The slots that hold children.
    pub(super) fn used(&self) -> impl Iterator<Item = usize> + '_ {
        (0..WIDTH).filter(|slot| !self.is_free(*slot))
    }

    /// Where eight planes of one axis and side are met, as the bits of the numbers.
    #[inline(always)]
    fn plane<S: Simd>(&self, simd: S, row: usize, scale: f32, shift: f32) -> i32x8<S> {
        f32x8::load_array_ref(simd, &self.rows[row & 7])
            .mul_sub(f32x8::splat(simd, scale), f32x8::splat(simd, shift))
            .bitcast()
    }

    /// Bit mask of the children that the ray enters before `t_max`, and the bits of where it enters each.
    ///
    /// Numbers that are not negative order like their bits, and the bits of a negative one are a negative integer: the
    /// largest of some numbers and 0, and whether one of some is negative, is the same asked of the bits. Integers are
    /// compared in one cycle where numbers take four, and this is the longest chain that rays wait for.
    #[inline(always)]
    pub(super) fn enter<S: Simd>(&self, simd: S, slab: &Slab, t_max: f32) -> (u32, i32x8<S>) {
        let [x, y, z] = slab.near_row;
        let near = |row, axis: usize| self.plane(simd, row, slab.near_scale[axis], slab.near_shift[axis]);
        let far = |row, axis: usize| self.plane(simd, row ^ 1, slab.far_scale[axis], slab.far_shift[axis]);
        let t_near = near(x, 0).max(near(y, 1)).max(near(z, 2).max(i32x8::splat(simd, 0)));
        let t_far = far(x, 0).min(far(y, 1)).min(far(z, 2).min(i32x8::splat(simd, t_max.to_bits() as i32)));
        (!t_near.simd_gt(t_far).to_bitmask() as u32 & 0xff, t_near)
    }
}

/// A ray, or a bundle of rays with the same signs of direction, made ready for box tests.
///
/// Where a plane at x is met lies between `x · near_scale − near_shift` and `x · far_scale − far_shift` whatever was
/// rounded on the way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slab {
    near_scale: Vec3A,
    near_shift: Vec3A,
    far_scale: Vec3A,
    far_shift: Vec3A,
    /// Row of the side where a ray enters, by axis; the side where it leaves is the row with the last bit turned.
    near_row: [usize; 3],
    /// Room left around boxes.
    room: f32,
}

/// Directions whose components differ by more are tilted by as much, which moves the ray by far less than `ROOM` over
/// any distance at which something can be met: no reciprocal is infinite.
pub(super) const FLATTEST: f32 = 1e-12;

/// Room around boxes relative to the tree's reach from the ray's origin, 20 · 2⁻²³. The shear of a vertex rounds by up
/// to 3 · 2⁻²³ of its distance, the edge functions by 1.5, `t` by 4 on its way along each axis [Woop2013, 3.2], the way
/// into an instance's space by 2, and the check for slivers lets 8 pass.
pub(super) const ROOM: f32 = 20.0 * f32::EPSILON;
/// Room for the rounding of the origin, and of an instance's place, times the scale.
const ROOM_OF_ORIGIN: f32 = 4.0 * f32::EPSILON;
/// Room for the reciprocal and the last rounding, relative to `t`.
const ROOM_OF_SCALE: f32 = 2.0 * f32::EPSILON;

impl Slab {
    /// Of no ray.
    pub(super) const NONE: Slab = Slab {
        near_scale: Vec3A::ZERO,
        near_shift: Vec3A::ZERO,
        far_scale: Vec3A::ZERO,
        far_shift: Vec3A::ZERO,
        near_row: [0, 2, 4],
        room: 0.0,
    };

    /// Of a ray, by the reciprocal of its direction, against a tree with these bounds.
    #[inline(always)]
    pub(super) fn new(origin: Vec3, inverse: Vec3A, bounds: &Aabb) -> Slab {
        let origin = Vec3A::from(origin);
        Slab::between(origin, origin, inverse, inverse, bounds)
    }

    /// Of all rays with origins between `origin_min` and `origin_max` and reciprocals of their directions (of one sign
    /// per axis) between `slow` and `fast` in size.
    #[inline(always)]
    pub(super) fn between(
        origin_min: Vec3A,
        origin_max: Vec3A,
        slow: Vec3A,
        fast: Vec3A,
        bounds: &Aabb,
    ) -> Slab {
        let reach = (bounds.max - origin_min).abs().max((origin_max - bounds.min).abs());
        let room = Vec3A::splat(reach.max_element() * ROOM)
            + origin_min.abs().max(origin_max.abs()) * ROOM_OF_ORIGIN;
        let backwards = slow.cmplt(Vec3A::ZERO);
        // Going up an axis, planes are met first by the ray that starts highest; going down, lowest.
        let near_origin = Vec3A::select(backwards, origin_min - room, origin_max + room);
        let far_origin = Vec3A::select(backwards, origin_max + room, origin_min - room);
        let near_scale = slow * (1.0 - ROOM_OF_SCALE);
        let far_scale = fast * (1.0 + ROOM_OF_SCALE);
        let row = |axis: usize| 2 * axis + usize::from(backwards.test(axis));
        Slab {
            near_scale,
            near_shift: near_origin * near_scale,
            far_scale,
            far_shift: far_origin * far_scale,
            near_row: [row(0), row(1), row(2)],
            room: room.max_element(),
        }
    }

    /// With more room around boxes.
    #[inline(always)]
    pub(super) fn widened(&self, room: f32) -> Slab {
        Slab {
            near_shift: self.near_shift + self.near_scale.abs() * room,
            far_shift: self.far_shift - self.far_scale.abs() * room,
            room: self.room + room,
            ..*self
        }
    }

    /// Room left around boxes, in the space of the tree.
    #[inline(always)]
    pub(super) fn room(&self) -> f32 {
        self.room
    }

    /// The same rays seen from `place`, a point within the bounds that the slab was made for: the room that was left for
    /// those holds for everything in them.
    #[inline(always)]
    pub(super) fn seen_from(&self, place: Vec3) -> Slab {
        let place = Vec3A::from(place);
        Slab {
            near_shift: self.near_shift - place * self.near_scale,
            far_shift: self.far_shift - place * self.far_scale,
            ..*self
        }
    }
}

/// 1 / direction, by component, without infinities.
#[inline(always)]
pub(super) fn inverse_of(direction: Vec3) -> Vec3A {
    let direction = Vec3A::from(direction);
    let size = direction.abs();
    let smallest = Vec3A::splat((size.max_element() * FLATTEST).max(4.0 * f32::MIN_POSITIVE));
    Vec3A::ONE / size.max(smallest).copysign(direction)
}
