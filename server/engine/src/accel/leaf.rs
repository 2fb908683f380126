//! Triangles in packets of up to eight, and the watertight test of a packet against a ray [Woop2013].
//!
//! *Whether* a triangle is hit is decided in single precision, eight at a time, by edge functions in the ray's sheared
//! space. Those of two triangles that share an edge are exact negatives of each other, so a ray through the edge hits
//! at least one of them; those that are exactly zero are computed again in double precision.
//!
//! *Where* it is hit is computed in double precision from the corners as they are, for the few triangles that are hit:
//! distances interpolated from sheared corners are off by up to 10⁻⁴ m on a sliver of 10 m × 2 cm, which made surfaces
//! shadow themselves.
//!
//! No fused multiply-add is used here, and every operation is one that IEEE 754 defines: all instruction sets report
//! the same hits to the last bit.

use fearless_simd::{Bytes, Simd, SimdBase, SimdMask, f32x8, i32x8};
use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

use super::{Ray, layout::LeafOrder, node::WIDTH};
use crate::scene::Mesh;

/// Most triangles of a leaf: one test takes as long for eight as for one.
pub(super) const LEAF_MAX: usize = WIDTH;

/// Rows of a packet: three corners of three coordinates, and the triangle's number.
const ROWS: usize = 10;

/// Leaves that a thread packs at a time: some thousand triangles, so that small meshes are one thread's.
const LEAVES_AT_ONCE: usize = 1024;

/// The triangles of a mesh, leaf by leaf.
///
/// A packet of n triangles is ten rows of n numbers each, without padding: reading eight numbers from the start of a row
/// reads into the next, and the test lets only the first n count. 40 bytes a triangle, whatever the leaves hold.
#[derive(Debug)]
pub(super) struct Leaves {
    rows: Vec<f32>,
}

/// A triangle of a mesh that was hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleHit {
    pub(super) t: f32,
    pub(super) triangle: u32,
    pub(super) b1: f32,
    pub(super) b2: f32,
}

/// A ray made ready for triangle tests: axes permuted so that z is the longest, and the shear that turns
/// the direction into +z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shear {
    origin: Vec3,
    direction: Vec3,
    axes: [usize; 3],
    /// The origin along the permuted axes.
    permuted: [f32; 3],
    /// Slopes of the permuted x and y over z.
    slope: [f32; 2],
    /// The triangle of the mesh that the ray leaves.
    left: u32,
}

impl Shear {
    /// Of no ray.
    pub(super) const NONE: Shear = Shear {
        origin: Vec3::ZERO,
        direction: Vec3::ZERO,
        axes: [0, 1, 2],
        permuted: [0.0; 3],
        slope: [0.0; 2],
        left: u32::MAX,
    };

    /// `inverse` is [`super::node::inverse_of`] the direction: exact for its longest axis.
    #[inline(always)]
    pub(super) fn new(ray: &Ray, inverse: Vec3A) -> Shear {
        let Ray { origin, direction, .. } = *ray;
        let axes = permuted_axes(direction);
        let [x, y, _] = permuted(direction, axes);
        let [_, _, inverse] = permuted(inverse.into(), axes);
        Shear {
            origin,
            direction,
            axes,
            permuted: permuted(origin, axes),
            slope: [x * inverse, y * inverse],
            left: u32::MAX,
        }
    }

    /// The same ray, against the meshes of `instance`.
    #[inline(always)]
    pub(super) fn within(mut self, instance: u32, ray: &Ray) -> Shear {
        self.left = if ray.left.instance == instance { ray.left.triangle } else { u32::MAX };
        self
    }
}

/// The axes of space that x, y and z are for a ray, z the longest, without changing hands.
#[inline(always)]
pub(super) fn permuted_axes(direction: Vec3) -> [usize; 3] {
    let size = direction.abs();
    if size.x > size.y && size.x > size.z {
        [1, 2, 0]
    } else if size.y > size.z {
        [2, 0, 1]
    } else {
        [0, 1, 2]
    }
}

/// A vector along the permuted axes. Read from memory: glam's own index is a branch for each axis, and which way rays go
/// is not to be guessed.
#[inline(always)]
fn permuted(vector: Vec3, [x, y, z]: [usize; 3]) -> [f32; 3] {
    let along = [vector.x, vector.y, vector.z, 0.0];
    [along[x & 3], along[y & 3], along[z & 3]]
}

/// A packet: its rows start at `rows[0]`.
#[derive(Clone, Copy)]
pub(super) struct Packet<'a> {
    rows: &'a [f32; (ROWS + 1) * WIDTH],
    count: usize,
}

impl Leaves {
    /// Packs the triangles of a mesh in the order of a tree's leaves, whose names say where.
    pub(super) fn pack(mesh: &Mesh, order: &LeafOrder) -> Leaves {
        let used = order.members.len() * ROWS;
        // Reading the last packet's rows must not leave the allocation.
        let mut rows = vec![0.0; used + (ROWS + 1) * WIDTH];
        let mut jobs = Vec::with_capacity(order.counts.len() / LEAVES_AT_ONCE + 1);
        let (mut members, mut rest) = (order.members.as_slice(), &mut rows[..used]);
        for counts in order.counts.chunks(LEAVES_AT_ONCE) {
            let triangle_count = counts.iter().map(|count| usize::from(*count)).sum();
            let (triangles, packets);
            (triangles, members) = members.split_at(triangle_count);
            (packets, rest) = rest.split_at_mut(triangle_count * ROWS);
            jobs.push((counts, triangles, packets));
        }
        jobs.into_par_iter().for_each(|(counts, mut triangles, mut packets)| {
            for count in counts.iter().map(|count| usize::from(*count)) {
                let (leaf, packet);
                (leaf, triangles) = triangles.split_at(count);
                (packet, packets) = packets.split_at_mut(count * ROWS);
                pack_leaf(mesh, leaf, packet);
            }
        });
        Leaves { rows }
    }

    pub(super) fn bytes(&self) -> usize {
        self.rows.len() * size_of::<f32>()
    }

    /// The packet of a leaf.
    #[inline(always)]
    pub(super) fn packet(&self, leaf: u32) -> Packet<'_> {
        let (first, count) = LeafOrder::range_of(leaf);
        // The rows after the last packet make this slice exist for every leaf.
        let rows = self.rows[first * ROWS..].first_chunk().unwrap_or(&[0.0; (ROWS + 1) * WIDTH]);
        Packet { rows, count }
    }
}

/// Writes the rows of one packet.
fn pack_leaf(mesh: &Mesh, triangles: &[u32], packet: &mut [f32]) {
    let count = triangles.len();
    for (lane, triangle) in triangles.iter().enumerate() {
        let corners = mesh.triangles()[*triangle as usize];
        let coordinates = corners.iter().flat_map(|corner| mesh.positions()[*corner as usize].to_array());
        for (row, coordinate) in coordinates.enumerate() {
            packet[row * count + lane] = coordinate;
        }
        packet[(ROWS - 1) * count + lane] = f32::from_bits(*triangle);
    }
}

impl<'a> Packet<'a> {
    /// The triangles' numbers in the mesh.
    pub(super) fn triangles(self) -> impl Iterator<Item = u32> + 'a {
        (0..self.count).map(move |lane| self.triangle(lane))
    }
}

impl Packet<'_> {
    #[inline(always)]
    pub(super) fn row<S: Simd>(&self, simd: S, row: usize) -> f32x8<S> {
        let start = row * self.count;
        f32x8::from_slice(simd, &self.rows[start..start + WIDTH])
    }

    #[inline(always)]
    fn triangle(&self, lane: usize) -> u32 {
        self.rows[(ROWS - 1) * self.count + lane].to_bits()
    }

    /// One corner of every triangle, seen from the ray: relative to its origin, its direction turned into +z.
    #[inline(always)]
    fn sheared<S: Simd>(&self, simd: S, ray: &Shear, corner: usize) -> [f32x8<S>; 2] {
        let x = self.row(simd, 3 * corner + (ray.axes[0] & 3)) - f32x8::splat(simd, ray.permuted[0]);
        let y = self.row(simd, 3 * corner + (ray.axes[1] & 3)) - f32x8::splat(simd, ray.permuted[1]);
        let z = self.row(simd, 3 * corner + (ray.axes[2] & 3)) - f32x8::splat(simd, ray.permuted[2]);
        [x - z * f32x8::splat(simd, ray.slope[0]), y - z * f32x8::splat(simd, ray.slope[1])]
    }

    /// Calls `found` for every triangle hit at 0 < t ≤ `t_max`; it may lower `t_max` and ends by true.
    #[inline(always)]
    pub(super) fn intersect<S: Simd>(
        &self,
        simd: S,
        ray: &Shear,
        t_max: &mut f32,
        mut found: impl FnMut(TriangleHit, &mut f32) -> bool,
    ) -> bool {
        let [a, b, c] = [self.sheared(simd, ray, 0), self.sheared(simd, ray, 1), self.sheared(simd, ray, 2)];
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        // Rays that leave a surface pass its triangle by the thousand: better kept out here than met and refused.
        let left =
            self.row(simd, ROWS - 1).bitcast::<i32x8<S>>().simd_eq(i32x8::splat(simd, ray.left as i32));
        let valid = self.lanes() & !(left.to_bitmask() as u32);
        let zero = f32x8::splat(simd, 0.0);
        let on_edge = u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero);
        let mut on_edge = on_edge.to_bitmask() as u32 & valid;
        let mut lanes = same_sign(u, v, w) & valid & !on_edge;
        while on_edge != 0 {
            let lane = on_edge.trailing_zeros() as usize;
            on_edge &= on_edge - 1;
            let corner = |p: &[f32x8<S>; 2]| [p[0][lane], p[1][lane]];
            let edges = [u[lane], v[lane], w[lane]];
            lanes |= u32::from(is_inside_on_edge([corner(&a), corner(&b), corner(&c)], edges)) << lane;
        }
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let Some(hit) = self.meet(lane, ray) else { continue };
            if hit.t <= *t_max && found(hit, t_max) {
                return true;
            }
        }
        false
    }

    /// Where the ray meets a triangle that it is known to hit, in double precision [Moller1997]. `None` when that is not
    /// ahead of the ray.
    #[inline(always)]
    fn meet(&self, lane: usize, ray: &Shear) -> Option<TriangleHit> {
        let [a, b, c] = self.corners(lane);
        let direction = ray.direction.as_dvec3();
        let (ab, ac, from_a) = (b - a, c - a, ray.origin.as_dvec3() - a);
        let p = direction.cross(ac);
        let q = from_a.cross(ab);
        let inverse = 1.0 / ab.dot(p);
        self.hit(lane, || *ray, [ac.dot(q) * inverse, from_a.dot(p) * inverse, direction.dot(q) * inverse])
    }

    /// The hit at `t` with these weights of the second and third corner, when it is one.
    #[inline(always)]
    pub(super) fn hit(
        &self,
        lane: usize,
        ray: impl FnOnce() -> Shear,
        [t, b1, b2]: [f64; 3],
    ) -> Option<TriangleHit> {
        let hit = TriangleHit { t: t as f32, triangle: self.triangle(lane), b1: b1 as f32, b2: b2 as f32 };
        if b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 {
            (hit.t > 0.0).then_some(hit)
        } else {
            on_the_rim(&ray(), self.corners(lane), hit)
        }
    }

    #[inline(always)]
    fn corners(&self, lane: usize) -> [DVec3; 3] {
        let [a, b, c] = [self.corner(lane, 0), self.corner(lane, 1), self.corner(lane, 2)];
        [a, b, c].map(|[x, y, z]| DVec3::new(f64::from(x), f64::from(y), f64::from(z)))
    }

    /// A corner of one of its triangles.
    #[inline(always)]
    pub(super) fn corner(&self, lane: usize, corner: usize) -> [f32; 3] {
        let at = |axis: usize| self.rows[(3 * corner + axis) * self.count + lane];
        [at(0), at(1), at(2)]
    }

    /// Bit mask of the lanes that hold triangles.
    #[inline(always)]
    pub(super) fn lanes(&self) -> u32 {
        (1 << self.count) - 1
    }
}

/// A hit that rounding let in although the ray passes beside the triangle. Where the ray meets the plane far off, or behind
/// itself, because it nearly lies in it, the hit is moved to where the ray first passes the rim. `None` where the ray
/// passes farther from the rim than rounding explains, because the triangle is thinner than rounding.
#[cold]
#[inline(never)]
fn on_the_rim(ray: &Shear, corners: [DVec3; 3], hit: TriangleHit) -> Option<TriangleHit> {
    let [x, y, z] = ray.axes;
    let from_origin = corners.map(|corner| corner - ray.origin.as_dvec3());
    let direction = ray.direction.as_dvec3();
    let seen = from_origin.map(|corner| {
        let t = corner[z] / direction[z];
        DVec3::new(corner[x] - t * direction[x], corner[y] - t * direction[y], t)
    });
    // Corners are off by the rounding of their shear, which grows with their distance. Boxes leave more room than this.
    let reach = from_origin.map(|corner| corner.abs().max_element()).into_iter().fold(0.0, f64::max);
    let room = 8.0 * f64::from(f32::EPSILON) * reach;
    let passing = [0, 1, 2].map(|from| {
        let (p, q) = (seen[from], seen[(from + 1) % 3]);
        let edge = q - p;
        let share = -p.truncate().dot(edge.truncate()) / edge.truncate().length_squared();
        // Not a number where the ray runs along the edge: one of its points is as good as another.
        let share = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) };
        let point = p + edge * share;
        let [b1, b2] = [[share, 0.0], [1.0 - share, share], [0.0, 1.0 - share]][from].map(|b| b as f32);
        let is_near = point.truncate().length_squared() <= room * room;
        is_near.then_some(TriangleHit { t: point.z as f32, b1, b2, ..hit })
    });
    let passing = passing.into_iter().flatten();
    let [a, b, c] = from_origin;
    let on_plane = direction * f64::from(hit.t);
    let is_in_box = (a.min(b).min(c) - room).cmple(on_plane) & on_plane.cmple(a.max(b).max(c) + room);
    let found = if hit.t > 0.0 && is_in_box.all() {
        passing.map(|_| hit).next()
    } else {
        passing.filter(|hit| hit.t > 0.0).min_by(|a, b| a.t.total_cmp(&b.t))
    }?;
    let b1 = found.b1.clamp(0.0, 1.0);
    Some(TriangleHit { b1, b2: found.b2.clamp(0.0, 1.0 - b1), ..found })
}

/// Bit mask of the lanes whose three numbers, none of them zero, have one sign.
#[inline(always)]
pub(super) fn same_sign<S: Simd>(u: f32x8<S>, v: f32x8<S>, w: f32x8<S>) -> u32 {
    let (u, v, w) = (u.bitcast::<i32x8<S>>(), v.bitcast::<i32x8<S>>(), w.bitcast::<i32x8<S>>());
    let differ = (u ^ v) | (v ^ w);
    !differ.simd_lt(i32x8::splat(u.simd, 0)).to_bitmask() as u32
}

/// True when the ray, at (0, 0), hits a sheared triangle some of whose edge functions are zero in single precision.
///
/// Those, and no others, are computed again in double precision, where products of two f32 are exact: the triangle on
/// the edge's other side does the same with the same numbers, and so agrees. What is zero then belongs to both.
#[cold]
#[inline(never)]
pub(super) fn is_inside_on_edge([a, b, c]: [[f32; 2]; 3], [u, v, w]: [f32; 3]) -> bool {
    let edge = |single: f32, p: [f32; 2], q: [f32; 2]| {
        let exact = || f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0]);
        if single == 0.0 { exact() } else { f64::from(single) }
    };
    let edges = [edge(u, c, b), edge(v, a, c), edge(w, b, a)];
    let any = |test: fn(&f64) -> bool| edges.iter().any(test);
    // All three zero: seen on edge, the triangle hides nothing.
    any(|edge| *edge != 0.0) && !(any(|edge| *edge < 0.0) && any(|edge| *edge > 0.0))
}
