//! A walk over the packed trees as the shader shall do it, statement by statement, in f32 and u32 only.
//!
//! WGSL may fuse a product and a sum where it likes, and flush subnormal numbers. `FUSED` does the former to every
//! triangle test, so that tests can show that nothing is lost by it; boxes have room for both.

use glam::{Mat3, Vec3};

use super::*;
use crate::accel::{Hit, Ray};

/// Directions whose components differ by more are tilted by as much, as on the CPU.
const FLATTEST: f32 = 1e-12;
/// Room around boxes relative to the tree's reach from the ray's origin: of it 8 units are what triangles' shears take, 3 what planes do.
const ROOM: f32 = 16.0 * f32::EPSILON;
/// Room for the rounding of the origin times the scale.
const ROOM_OF_ORIGIN: f32 = 2.0 * f32::EPSILON;
/// Room for the reciprocal and the last rounding: twice the CPU's, as WGSL's division may be off by 2.5 units.
const ROOM_OF_SCALE: f32 = 4.0 * f32::EPSILON;
/// Edge functions below this times their products have no certain sign: 1 unit, where rounding fused, reordered or
/// neither moves them by no more than 1 of the products' sum, which is up to 2 of the larger.
const UNSURE: f32 = 2.0 * f32::EPSILON;
/// … nor have those so small that the products may have been flushed to zero.
const UNSURE_AT_ALL: f32 = 8.0 * f32::MIN_POSITIVE;

/// What is still to be visited below one node: its children, or parts of a node of the top tree.
#[derive(Clone, Copy, Default)]
struct Group {
    /// `child_base` or `member_base`.
    base: u32,
    /// `inner`, or the slots that hold a part.
    filled: u32,
    are_parts: bool,
    /// Bit p: the slot `p ^ octant`.
    left: u32,
}

impl Group {
    /// A tree's root, as if it were the child in slot 0 of a node above.
    fn of_root(start: u32, slab: &Slab) -> Group {
        Group { base: start, filled: 1, are_parts: false, left: 1 << slab.octant }
    }
}

/// A ray ready for the boxes of one space.
struct Slab {
    near_scale: Vec3,
    near_shift: Vec3,
    far_scale: Vec3,
    far_shift: Vec3,
    /// Bit a: the direction is negative on axis a.
    octant: u32,
}

impl Slab {
    fn new(origin: Vec3, direction: Vec3, tree_reach: f32) -> Slab {
        let size = direction.abs();
        let inverse = Vec3::ONE / size.max(Vec3::splat(size.max_element() * FLATTEST)).copysign(direction);
        let room = (origin.abs().max_element() + tree_reach) * ROOM + origin.abs() * ROOM_OF_ORIGIN;
        let octant = inverse.cmplt(Vec3::ZERO).bitmask();
        // Towards the ray's direction: planes are met earlier from an origin that is farther along.
        let ahead = room.copysign(inverse);
        let near_scale = inverse * (1.0 - ROOM_OF_SCALE);
        let far_scale = inverse * (1.0 + ROOM_OF_SCALE);
        Slab {
            near_scale,
            near_shift: (origin + ahead) * near_scale,
            far_scale,
            far_shift: (origin - ahead) * far_scale,
            octant,
        }
    }

    /// The slots of a node that the ray enters: bit p for slot `p ^ octant`. Planes are met at `q · (step · scale)` after the node's corner,
    /// one product and one sum each.
    fn entered(&self, node: &GpuNode, t_max: f32) -> u32 {
        let mut entered = 0;
        for position in 0..8 {
            let slot = position ^ self.octant;
            if node.inner >> slot & 1 == 0 && members_of(node, slot).is_empty() {
                continue;
            }
            let (mut t_near, mut t_far) = (0.0f32, t_max);
            for axis in 0..3 {
                let step = f32::from_bits(u32::from(node.exponents[axis]) << 23);
                let backwards = (self.octant >> axis & 1) as usize;
                let met = |side: usize, scale: f32, shift: f32| {
                    let start = node.origin[axis] * scale - shift;
                    f32::from(node.planes[axis][side][slot as usize]) * (step * scale) + start
                };
                t_near = t_near.max(met(backwards, self.near_scale[axis], self.near_shift[axis]));
                t_far = t_far.min(met(1 - backwards, self.far_scale[axis], self.far_shift[axis]));
            }
            entered |= u32::from(t_near <= t_far) << position;
        }
        entered
    }
}

fn members_of(node: &GpuNode, slot: u32) -> std::ops::Range<u32> {
    let end = |slot: u32| u32::from(node.member_ends[slot as usize]);
    let start = if slot == 0 { 0 } else { end(slot - 1) };
    node.member_base + start..node.member_base + end(slot)
}

/// A ray ready for the triangles of one mesh.
struct Shear {
    origin: Vec3,
    direction: Vec3,
    axes: [usize; 3],
    inverse_z: f32,
    slope: [f32; 2],
}

impl Shear {
    fn new(origin: Vec3, direction: Vec3) -> Shear {
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let inverse_z = 1.0 / direction[z];
        let slope = [direction[axes[0]] * inverse_z, direction[axes[1]] * inverse_z];
        Shear { origin, direction, axes, inverse_z, slope }
    }

    /// A corner relative to the ray's origin, the direction turned into +z.
    fn sheared<const FUSED: bool>(&self, corner: Vec3) -> [f32; 2] {
        let [x, y, z] = self.axes.map(|axis| corner[axis] - self.origin[axis]);
        if FUSED {
            [(-z).mul_add(self.slope[0], x), (-z).mul_add(self.slope[1], y)]
        } else {
            [x - z * self.slope[0], y - z * self.slope[1]]
        }
    }

    /// Where the ray meets a triangle; `None` when it passes by or meets it behind its start.
    fn meet<const FUSED: bool>(&self, triangle: &GpuTriangle) -> Option<f32> {
        let corners = [triangle.a, triangle.b, triangle.c].map(Vec3::from);
        let axis = (triangle.number >> TRIANGLE_AXIS_SHIFT) as usize;
        if axis == 3 {
            return None;
        }
        let [a, b, c] = corners.map(|corner| self.sheared::<FUSED>(corner));
        let signs = [edge_sign::<FUSED>(c, b), edge_sign::<FUSED>(a, c), edge_sign::<FUSED>(b, a)];
        // One zero and two of a sign: on an edge, which belongs to both its triangles. Three zeros: seen on edge.
        if signs.contains(&-1) == signs.contains(&1) {
            return None;
        }
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let p = corners[0] - self.origin;
        let height = p[axis] + triangle.slope_0 * p[i] + triangle.slope_1 * p[j];
        let approach = self.direction[axis]
            + triangle.slope_0 * self.direction[i]
            + triangle.slope_1 * self.direction[j];
        let z = self.axes[2];
        let [ta, tb, tc] = corners.map(|corner| (corner[z] - self.origin[z]) * self.inverse_z);
        let (low, high) = (ta.min(tb).min(tc), ta.max(tb).max(tc));
        // Asked before the division, which must not overflow where the ray runs along the plane.
        let t = if height.abs() >= approach.abs() * low.abs().max(high.abs()) {
            if (height < 0.0) == (approach < 0.0) { high } else { low }
        } else {
            (height / approach).max(low).min(high)
        };
        (t > 0.0).then_some(t)
    }
}

/// Sign of p₀q₁ − p₁q₀: exact for the numbers it is given, whatever the compiler makes of the expression.
fn edge_sign<const FUSED: bool>(p: [f32; 2], q: [f32; 2]) -> i32 {
    let (left, right) = (p[0] * q[1], p[1] * q[0]);
    let edge = if FUSED { p[0].mul_add(q[1], -right) } else { left - right };
    if edge.abs() <= left.abs().max(right.abs()) * UNSURE + UNSURE_AT_ALL {
        return compare_products([p[0], q[1]], [p[1], q[0]]);
    }
    if edge > 0.0 { 1 } else { -1 }
}

/// Sign of a₀a₁ − b₀b₁ by integer arithmetic.
pub(super) fn compare_products(a: [f32; 2], b: [f32; 2]) -> i32 {
    let (a, b) = (product(a), product(b));
    if a.sign != b.sign {
        return if a.sign > b.sign { 1 } else { -1 };
    }
    let ordering = (a.exponent, a.high, a.low).cmp(&(b.exponent, b.high, b.low));
    a.sign * ordering as i32
}

/// sign · (high · 2²⁴ + low) · 2^exponent, the highest bit of 48 set; all zero for zero.
struct Product {
    sign: i32,
    exponent: i32,
    high: u32,
    low: u32,
}

fn product([x, y]: [f32; 2]) -> Product {
    let ([m, n], [e, f]) = ([mantissa(x), mantissa(y)], [exponent(x), exponent(y)]);
    if m == 0 || n == 0 {
        return Product { sign: 0, exponent: 0, high: 0, low: 0 };
    }
    // 24 × 24 bits, in halves of 12 so that no product leaves 32.
    let middle = (m >> 12) * (n & 0xfff) + (m & 0xfff) * (n >> 12);
    let low = (m & 0xfff) * (n & 0xfff) + ((middle & 0xfff) << 12);
    let high = (m >> 12) * (n >> 12) + (middle >> 12) + (low >> 24);
    let low = low & 0xff_ffff;
    let sign = if (x.to_bits() ^ y.to_bits()) >> 31 == 0 { 1 } else { -1 };
    if high >> 23 != 0 {
        Product { sign, exponent: e + f, high, low }
    } else {
        Product { sign, exponent: e + f - 1, high: high << 1 | low >> 23, low: low << 1 & 0xff_ffff }
    }
}

/// 24 bits, the highest set; zero for zero. Subnormal numbers are moved up.
fn mantissa(x: f32) -> u32 {
    let (bits, biased) = (x.to_bits() & 0x7f_ffff, x.to_bits() >> 23 & 0xff);
    match (biased, bits) {
        (0, 0) => 0,
        (0, _) => bits << (bits.leading_zeros() - 8),
        _ => bits | 0x80_0000,
    }
}

/// The exponent that goes with [`mantissa`].
fn exponent(x: f32) -> i32 {
    let (bits, biased) = (x.to_bits() & 0x7f_ffff, (x.to_bits() >> 23 & 0xff) as i32);
    if biased == 0 { 9 - bits.leading_zeros() as i32 } else { biased }
}

/// A mesh that is walked.
struct InMesh<'a> {
    part: GpuPart,
    instance: &'a GpuInstance,
    shear: Shear,
    slab: Slab,
    /// Entries of the stack that wait for its end.
    floor: usize,
}

/// The nearest so far, and how far the walk looks.
struct Search {
    closest: Option<Hit>,
    t_max: f32,
}

impl InMesh<'_> {
    fn enter<'a>(buffers: &'a AccelBuffers, part: GpuPart, ray: &Ray, floor: usize) -> InMesh<'a> {
        let instance = &buffers.instances[part.instance as usize];
        let from_centre = ray.origin - Vec3::from(instance.centre_in_render);
        let (origin, direction) = if instance.flags & INSTANCE_IS_ONLY_MOVED != 0 {
            (from_centre, ray.direction)
        } else {
            let mesh_from_render = Mat3::from_cols(
                instance.mesh_from_render_x.into(),
                instance.mesh_from_render_y.into(),
                instance.mesh_from_render_z.into(),
            );
            (mesh_from_render * from_centre, mesh_from_render * ray.direction)
        };
        let slab = Slab::new(origin, direction, instance.mesh_reach);
        InMesh { part, instance, shear: Shear::new(origin, direction), slab, floor }
    }

    /// Triangles, from the mesh's first.
    fn test<const FUSED: bool>(
        &self,
        buffers: &AccelBuffers,
        triangles: std::ops::Range<u32>,
        search: &mut Search,
    ) {
        for index in triangles {
            let triangle = &buffers.triangles[(self.instance.triangle_base + index) as usize];
            let Some(t) = self.shear.meet::<FUSED>(triangle) else { continue };
            let number = triangle.number & ((1 << TRIANGLE_AXIS_SHIFT) - 1);
            let hit = Hit { t, instance: self.part.instance, triangle: number, b1: 0.0, b2: 0.0 };
            if t <= search.t_max && search.closest.as_ref().is_none_or(|best| hit.is_before(best)) {
                search.t_max = t;
                search.closest = Some(hit);
            }
        }
    }
}

/// A hit as [`Accel::closest_hit`] reports it, without weights: the shader finds those from the point, if at all.
pub(crate) fn closest_hit<const FUSED: bool>(buffers: &AccelBuffers, ray: &Ray) -> Option<Hit> {
    let mut search = Search { closest: None, t_max: ray.t_max.min(f32::MAX) };
    let mut stack = Vec::with_capacity(buffers.stack_need);
    let mut peak = 0;
    let top_slab = Slab::new(ray.origin, ray.direction, buffers.top_reach);
    let mut within: Option<InMesh<'_>> = None;
    let mut group = Group::of_root(0, &top_slab);
    loop {
        if group.left == 0 {
            if within.as_ref().is_some_and(|mesh| stack.len() == mesh.floor) {
                within = None;
            }
            let Some(waiting) = stack.pop() else { break };
            group = waiting;
        }
        let slab = within.as_ref().map_or(&top_slab, |mesh| &mesh.slab);
        let slot = group.left.trailing_zeros() ^ slab.octant;
        group.left &= group.left - 1;
        let index = group.base + (group.filled & ((1 << slot) - 1)).count_ones();
        if group.left != 0 {
            stack.push(group);
        }
        if group.are_parts {
            let part = buffers.parts[index as usize];
            let mesh = InMesh::enter(buffers, part, ray, stack.len());
            if part.start & START_IS_LEAF != 0 {
                let first = part.start & ((1 << START_COUNT_SHIFT) - 1);
                let count = (part.start >> START_COUNT_SHIFT & 7) + 1;
                mesh.test::<FUSED>(buffers, first..first + count, &mut search);
                group.left = 0;
            } else {
                group = Group::of_root(part.start, &mesh.slab);
            }
            within = Some(mesh);
            peak = peak.max(stack.len());
            continue;
        }
        let node = match &within {
            None => &buffers.top_nodes[index as usize],
            Some(mesh) => &buffers.nodes[(mesh.instance.node_base + index) as usize],
        };
        let entered = slab.entered(node, search.t_max);
        let is_inner = |position: &u32| u32::from(node.inner) >> (position ^ slab.octant) & 1 == 1;
        let (inner, with_members): (Vec<u32>, Vec<u32>) =
            (0..8).filter(|position| entered >> position & 1 == 1).partition(is_inner);
        let bits = |positions: &[u32]| positions.iter().fold(0, |bits, position| bits | 1 << position);
        group = Group {
            base: node.child_base,
            filled: u32::from(node.inner),
            are_parts: false,
            left: bits(&inner),
        };
        if let Some(mesh) = &within {
            for position in with_members {
                mesh.test::<FUSED>(buffers, members_of(node, position ^ slab.octant), &mut search);
            }
        } else if !with_members.is_empty() {
            // Parts come before the nodes beside them, so that those of one node wait at most.
            if group.left != 0 {
                stack.push(group);
            }
            let holds_part = |slot: &u32| !members_of(node, *slot).is_empty();
            let filled = bits(&(0..8).filter(holds_part).collect::<Vec<_>>());
            group = Group { base: node.member_base, filled, are_parts: true, left: bits(&with_members) };
        }
        peak = peak.max(stack.len());
    }
    assert!(peak <= buffers.stack_need, "{peak} entries wait where {} may", buffers.stack_need);
    search.closest
}
