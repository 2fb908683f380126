//! Eight rays at once: for rays that start close together and go the same way, such as those of neighbouring pixels.
//!
//! Nodes are tested against the whole bundle, all eight children at once, by the same test as for one ray with wider
//! constants. Of a packet, first the triangles that the bundle may hit at all are found, eight at once, then each of
//! those is tested against the eight rays. Every ray is decided by the same operations as if it were alone, so the
//! answers are the same to the last bit.

use fearless_simd::{Simd, SimdBase, SimdCombine, SimdMask, SimdWiden, f32x8, f64x8};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;

use super::{
    Ray,
    leaf::{Packet, Shear, TriangleHit, is_inside_on_edge, permuted_axes, same_sign},
    node::{FLATTEST, ROOM, Slab},
};

/// Rays of a bundle.
pub(super) const RAYS: usize = 8;

/// How far directions may differ, by component, relative to the longest: beyond, most of a bundle's work is in vain.
const SPREAD_MAX: f32 = 0.125;

/// Eight rays made ready for box and triangle tests.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bundle {
    slab: Slab,
    axes: [usize; 3],
    /// Axis by axis, ray by ray.
    origin: [[f32; RAYS]; 3],
    direction: [[f32; RAYS]; 3],
    /// Slopes of the permuted x and y over z.
    slope: [[f32; RAYS]; 2],
    middle: Middle,
}

/// A line that the rays stay close to, along the permuted axes: x and y where z is that of the first ray's origin, and
/// slopes; and by how much the rays may be off it, there and for each unit of z from there.
#[derive(Clone, Copy, Debug)]
struct Middle {
    at: [f32; 3],
    slope: [f32; 2],
    width: [f32; 2],
    widening: [f32; 2],
}

impl Bundle {
    /// `None` for rays that go too far apart, on any axis the other way, or along different axes.
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, rays: &[Ray; RAYS], bounds: &Aabb) -> Option<Bundle> {
        let mut origin = [[0.0; RAYS]; 3];
        let mut direction = [[0.0; RAYS]; 3];
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        let (mut origin_low, mut origin_high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        // Stays zero unless something is infinite or not a number, which minima and maxima may forget.
        let mut odd = Vec3A::ZERO;
        for (index, ray) in rays.iter().enumerate() {
            let (o, d) = (Vec3A::from(ray.origin), Vec3A::from(ray.direction));
            odd += o * 0.0 + d * 0.0;
            (low, high) = (low.min(d), high.max(d));
            (origin_low, origin_high) = (origin_low.min(o), origin_high.max(o));
            for axis in 0..3 {
                origin[axis][index] = ray.origin[axis];
                direction[axis][index] = ray.direction[axis];
            }
        }
        let longest = low.abs().max(high.abs()).max_element();
        if odd != Vec3A::ZERO || rays.iter().any(|ray| ray.t_max.is_nan()) {
            return None;
        }
        if !((high - low).max_element() <= SPREAD_MAX * longest) {
            return None;
        }
        let backwards = high.cmple(Vec3A::ZERO) & low.cmplt(Vec3A::ZERO);
        if !(backwards | low.cmpge(Vec3A::ZERO)).all() {
            return None;
        }
        let axes = permuted_axes(rays[0].direction);
        let load = |row: &[f32; RAYS]| f32x8::load_array_ref(simd, row);
        if !all_go_along(
            axes[2],
            [load(&direction[0]).abs(), load(&direction[1]).abs(), load(&direction[2]).abs()],
        ) {
            return None;
        }
        // The flattest that any of the rays' own reciprocals is, and flatter.
        let flattest = Vec3A::splat((1.0 - SPREAD_MAX) * longest * FLATTEST);
        let (shortest, longest) =
            (low.abs().min(high.abs()).max(flattest), low.abs().max(high.abs()).max(flattest));
        let sign = Vec3A::select(backwards, Vec3A::NEG_ONE, Vec3A::ONE);
        let slab = Slab::between(origin_low, origin_high, sign / longest, sign / shortest, bounds);
        let mut bundle =
            Bundle { slab, axes, origin, direction, slope: [[0.0; RAYS]; 2], middle: Middle::ZERO };
        let inverse = f32x8::splat(simd, 1.0) / load(&direction[axes[2] % 3]);
        (load(&direction[axes[0] % 3]) * inverse).store_array(&mut bundle.slope[0]);
        (load(&direction[axes[1] % 3]) * inverse).store_array(&mut bundle.slope[1]);
        bundle.find_middle(simd);
        Some(bundle)
    }

    /// The same rays in the space of an instance that stands at `place`, neither turned nor scaled.
    #[inline(always)]
    pub(super) fn seen_from<S: Simd>(&self, simd: S, place: Vec3) -> Bundle {
        let mut seen = Bundle { slab: self.slab.seen_from(place), ..*self };
        for axis in 0..3 {
            let origin = f32x8::load_array_ref(simd, &self.origin[axis]) - f32x8::splat(simd, place[axis]);
            origin.store_array(&mut seen.origin[axis]);
            seen.middle.at[axis] -= place[self.axes[axis] % 3];
        }
        seen
    }

    #[inline(always)]
    fn find_middle<S: Simd>(&mut self, simd: S) {
        let origin = |axis: usize| f32x8::load_array_ref(simd, &self.origin[self.axes[axis] % 3]);
        let start = [origin(0)[0], origin(1)[0], origin(2)[0]];
        let dz = origin(2) - f32x8::splat(simd, start[2]);
        let mut middle = Middle::ZERO;
        middle.at[2] = start[2];
        // What rounding may move corners and rays by; generous, as it costs no more than a few triangles tested in vain.
        let room = 2.0 * self.slab.room();
        for axis in 0..2 {
            let slope = f32x8::load_array_ref(simd, &self.slope[axis]);
            let there = origin(axis) - slope * dz;
            let (low, high) = (there.reduce_min(), there.reduce_max());
            let (flat, steep) = (slope.reduce_min(), slope.reduce_max());
            middle.at[axis] = (low + high) * 0.5;
            middle.slope[axis] = (flat + steep) * 0.5;
            middle.width[axis] = (high - low) * 0.5 + room;
            middle.widening[axis] = (steep - flat) * 0.5 + ROOM;
        }
        self.middle = middle;
    }

    #[inline(always)]
    pub(super) fn slab(&self) -> &Slab {
        &self.slab
    }

    /// Calls `found` with the number of every ray that hits a triangle of the packet up to its own `t_max`, which `found`
    /// may lower.
    #[inline(always)]
    pub(super) fn intersect<S: Simd>(
        &self,
        simd: S,
        packet: &Packet<'_>,
        t_max: &mut [f32; RAYS],
        mut found: impl FnMut(usize, TriangleHit, &mut f32),
    ) {
        let mut triangles = self.may_hit(simd, packet);
        while triangles != 0 {
            let triangle = triangles.trailing_zeros() as usize;
            triangles &= triangles - 1;
            let a = self.sheared(simd, packet.corner(triangle, 0));
            let b = self.sheared(simd, packet.corner(triangle, 1));
            let c = self.sheared(simd, packet.corner(triangle, 2));
            let u = c[0] * b[1] - c[1] * b[0];
            let v = a[0] * c[1] - a[1] * c[0];
            let w = b[0] * a[1] - b[1] * a[0];
            let zero = f32x8::splat(simd, 0.0);
            let on_edge = u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero);
            let mut on_edge = on_edge.to_bitmask() as u32;
            let mut lanes = same_sign(u, v, w) & 0xff & !on_edge;
            while on_edge != 0 {
                let ray = on_edge.trailing_zeros() as usize;
                on_edge &= on_edge - 1;
                let corners = [[a[0][ray], a[1][ray]], [b[0][ray], b[1][ray]], [c[0][ray], c[1][ray]]];
                lanes |= u32::from(is_inside_on_edge(corners, [u[ray], v[ray], w[ray]])) << ray;
            }
            if lanes == 0 {
                continue;
            }
            let [t, b1, b2] = self.meet(simd, packet, triangle);
            while lanes != 0 {
                let ray = lanes.trailing_zeros() as usize;
                lanes &= lanes - 1;
                let hit = packet.hit(triangle, || self.shear(ray), [t[ray], b1[ray], b2[ray]]);
                if let Some(hit) = hit.filter(|hit| hit.t <= t_max[ray]) {
                    found(ray, hit, &mut t_max[ray]);
                }
            }
        }
    }

    /// Bit mask of the triangles that some ray may hit: those for which no edge, moved out by as far as the rays are off
    /// the middle, leaves the middle outside.
    #[inline(always)]
    fn may_hit<S: Simd>(&self, simd: S, packet: &Packet<'_>) -> u32 {
        let splat = |value: f32| f32x8::splat(simd, value);
        let Middle { at, slope, width, widening } = &self.middle;
        let z = |corner: usize| packet.row(simd, 3 * corner + (self.axes[2] & 3)) - splat(at[2]);
        let from_middle = |corner: usize, axis: usize, z: f32x8<S>| {
            packet.row(simd, 3 * corner + (self.axes[axis] & 3)) - splat(at[axis]) - z * splat(slope[axis])
        };
        let (za, zb, zc) = (z(0), z(1), z(2));
        let a = [from_middle(0, 0, za), from_middle(0, 1, za)];
        let b = [from_middle(1, 0, zb), from_middle(1, 1, zb)];
        let c = [from_middle(2, 0, zc), from_middle(2, 1, zc)];
        let depth = za.abs().max(zb.abs()).max(zc.abs());
        let (wide, high) =
            (splat(width[0]) + depth * splat(widening[0]), splat(width[1]) + depth * splat(widening[1]));
        let (u, du) = edge_within(c, b, wide, high);
        let (v, dv) = edge_within(a, c, wide, high);
        let (w, dw) = edge_within(b, a, wide, high);
        let zero = splat(0.0);
        let counter_clockwise = (u + du).min(v + dv).min(w + dw).simd_ge(zero);
        let clockwise = (u - du).max(v - dv).max(w - dw).simd_le(zero);
        (counter_clockwise | clockwise).to_bitmask() as u32 & packet.lanes()
    }

    /// One corner seen from every ray; see [`Packet`].
    #[inline(always)]
    fn sheared<S: Simd>(&self, simd: S, corner: [f32; 3]) -> [f32x8<S>; 2] {
        let [kx, ky, kz] = self.axes;
        let x = f32x8::splat(simd, corner[kx % 3]) - f32x8::load_array_ref(simd, &self.origin[kx % 3]);
        let y = f32x8::splat(simd, corner[ky % 3]) - f32x8::load_array_ref(simd, &self.origin[ky % 3]);
        let z = f32x8::splat(simd, corner[kz % 3]) - f32x8::load_array_ref(simd, &self.origin[kz % 3]);
        [
            x - z * f32x8::load_array_ref(simd, &self.slope[0]),
            y - z * f32x8::load_array_ref(simd, &self.slope[1]),
        ]
    }

    /// `t` and the weights of the second and third corner for every ray: [`Packet::meet`], eight at a time.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, packet: &Packet<'_>, triangle: usize) -> [f64x8<S>; 3] {
        let (a, b, c) = (packet.corner(triangle, 0), packet.corner(triangle, 1), packet.corner(triangle, 2));
        let side = |from: [f32; 3], to: [f32; 3], axis: usize| {
            f64x8::splat(simd, f64::from(to[axis]) - f64::from(from[axis]))
        };
        let ab = [side(a, b, 0), side(a, b, 1), side(a, b, 2)];
        let ac = [side(a, c, 0), side(a, c, 1), side(a, c, 2)];
        let wide = |row: &[f32; RAYS]| {
            let (low, high) = f32x8::load_array_ref(simd, row).widen();
            low.combine(high)
        };
        let from_a = |axis: usize| wide(&self.origin[axis]) - f64x8::splat(simd, f64::from(a[axis]));
        let from_a = [from_a(0), from_a(1), from_a(2)];
        let d = [wide(&self.direction[0]), wide(&self.direction[1]), wide(&self.direction[2])];
        let p = cross(d, ac);
        let q = cross(from_a, ab);
        let inverse = f64x8::splat(simd, 1.0) / dot(ab, p);
        [dot(ac, q) * inverse, dot(from_a, p) * inverse, dot(d, q) * inverse]
    }

    /// One of the rays alone.
    #[cold]
    fn shear(&self, ray: usize) -> Shear {
        let pick = |rows: &[[f32; RAYS]; 3]| Vec3::new(rows[0][ray], rows[1][ray], rows[2][ray]);
        let ray = Ray::new(pick(&self.origin), pick(&self.direction));
        Shear::new(&ray, super::node::inverse_of(ray.direction))
    }
}

/// True when `axis` is the longest for every ray, by [`permuted_axes`]'s rule for those as long.
#[inline(always)]
fn all_go_along<S: Simd>(axis: usize, [x, y, z]: [f32x8<S>; 3]) -> bool {
    let along_x = (x.simd_gt(y) & x.simd_gt(z)).to_bitmask();
    let along_y = y.simd_gt(z).to_bitmask() & !along_x;
    match axis {
        0 => along_x == 0xff,
        1 => along_y == 0xff,
        _ => along_x | along_y == 0,
    }
}

impl Middle {
    const ZERO: Middle = Middle { at: [0.0; 3], slope: [0.0; 2], width: [0.0; 2], widening: [0.0; 2] };
}

/// The edge function of p and q at the middle, and by how much it may differ within a rectangle around it.
#[inline(always)]
fn edge_within<S: Simd>(
    p: [f32x8<S>; 2],
    q: [f32x8<S>; 2],
    wide: f32x8<S>,
    high: f32x8<S>,
) -> (f32x8<S>, f32x8<S>) {
    let (px_qy, py_qx) = (p[0] * q[1], p[1] * q[0]);
    // The products round; what they may be off by together is far less than this.
    let rounding = (px_qy.abs() + py_qx.abs()) * f32x8::splat(wide.simd, 4.0 * f32::EPSILON);
    let differ = (p[1] - q[1]).abs() * wide + (p[0] - q[0]).abs() * high;
    (px_qy - py_qx, differ + rounding)
}

#[inline(always)]
fn cross<S: Simd>(a: [f64x8<S>; 3], b: [f64x8<S>; 3]) -> [f64x8<S>; 3] {
    [a[1] * b[2] - b[1] * a[2], a[2] * b[0] - b[2] * a[0], a[0] * b[1] - b[0] * a[1]]
}

#[inline(always)]
fn dot<S: Simd>(a: [f64x8<S>; 3], b: [f64x8<S>; 3]) -> f64x8<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
