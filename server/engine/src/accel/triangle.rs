//! Watertight ray–triangle test, four triangles at a time [Woop2013].
//!
//! The edge functions of two triangles that share an edge are exact negatives of each other, so a ray
//! through the edge hits at least one of them; where one is exactly zero it is computed again in double
//! precision. A triangle that is degenerate after rounding is never hit.

use glam::{BVec4A, Vec3, Vec4};

use crate::scene::Mesh;

/// Four triangles, vertex by vertex, axis by axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrianglePacket {
    vertices: [[Vec4; 3]; 3],
    triangles: [u32; 4],
}

/// A triangle of a mesh that was hit.
pub(super) struct TriangleHit {
    pub(super) t: f32,
    pub(super) triangle: u32,
    pub(super) b1: f32,
    pub(super) b2: f32,
}

/// A ray made ready for triangle tests: axes permuted so that z is the longest, and the shear that turns
/// the direction into +z.
#[derive(Clone, Copy)]
pub(super) struct ShearRay {
    axes: [usize; 3],
    origin: [Vec4; 3],
    shear: [f32; 3],
}

impl ShearRay {
    pub(super) fn new(origin: Vec3, direction: Vec3) -> ShearRay {
        let length = direction.abs();
        let z = if length.x > length.y && length.x > length.z {
            0
        } else if length.y > length.z {
            1
        } else {
            2
        };
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let axes = [x, y, z];
        let inverse = 1.0 / direction[z];
        ShearRay {
            axes,
            origin: axes.map(|axis| Vec4::splat(origin[axis])),
            shear: [direction[x] * inverse, direction[y] * inverse, inverse],
        }
    }
}

impl ShearRay {
    /// The same direction from another origin.
    pub(super) fn from(&self, origin: Vec3) -> ShearRay {
        ShearRay { origin: self.axes.map(|axis| Vec4::splat(origin[axis])), ..*self }
    }
}

impl TrianglePacket {
    pub(super) const WIDTH: usize = 4;

    /// Packs up to four triangles of a mesh; free lanes hold NaN, which no comparison lets through.
    pub(super) fn new(mesh: &Mesh, triangles: &[u32]) -> TrianglePacket {
        let mut packet = TrianglePacket { vertices: [[Vec4::NAN; 3]; 3], triangles: [u32::MAX; 4] };
        for (lane, triangle) in triangles.iter().take(Self::WIDTH).enumerate() {
            packet.triangles[lane] = *triangle;
            for (corner, vertex) in mesh.triangles()[*triangle as usize].iter().enumerate() {
                let position = mesh.positions()[*vertex as usize];
                for axis in 0..3 {
                    packet.vertices[corner][axis][lane] = position[axis];
                }
            }
        }
        packet
    }

    /// Calls `found` for every triangle hit at 0 < t ≤ `t_max`; it may lower `t_max` and ends by true.
    #[inline]
    pub(super) fn intersect(
        &self,
        ray: &ShearRay,
        t_max: &mut f32,
        mut found: impl FnMut(TriangleHit, &mut f32) -> bool,
    ) -> bool {
        let sheared = self.vertices.map(|vertex| {
            let [x, y, z] = [0, 1, 2].map(|i| vertex[ray.axes[i]] - ray.origin[i]);
            [x - z * ray.shear[0], y - z * ray.shear[1], z * ray.shear[2]]
        });
        let [a, b, c] = sheared;
        let mut u = c[0] * b[1] - c[1] * b[0];
        let mut v = a[0] * c[1] - a[1] * c[0];
        let mut w = b[0] * a[1] - b[1] * a[0];
        let zero = Vec4::ZERO;
        let on_edge = u.cmpeq(zero) | v.cmpeq(zero) | w.cmpeq(zero);
        if on_edge.any() {
            redo_in_double(&sheared, on_edge, [&mut u, &mut v, &mut w]);
        }
        let negative = u.cmplt(zero) | v.cmplt(zero) | w.cmplt(zero);
        let positive = u.cmpgt(zero) | v.cmpgt(zero) | w.cmpgt(zero);
        let determinant = u + v + w;
        let t = (u * a[2] + v * b[2] + w * c[2]) / determinant;
        let inside = !(negative & positive) & determinant.cmpne(zero) & t.cmpgt(zero);
        let mut lanes = (inside & t.cmple(Vec4::splat(*t_max))).bitmask();
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            if t[lane] > *t_max {
                continue;
            }
            let inverse = 1.0 / determinant[lane];
            let hit = TriangleHit {
                t: t[lane],
                triangle: self.triangles[lane],
                b1: v[lane] * inverse,
                b2: w[lane] * inverse,
            };
            if found(hit, t_max) {
                return true;
            }
        }
        false
    }
}

/// Edge functions of the lanes in `which` in double precision: products of two f32 are exact there, so a zero is one.
#[cold]
fn redo_in_double(sheared: &[[Vec4; 3]; 3], which: BVec4A, [u, v, w]: [&mut Vec4; 3]) {
    let [a, b, c] = sheared;
    for lane in 0..4 {
        if which.test(lane) {
            let edge = |p: &[Vec4; 3], q: &[Vec4; 3]| {
                let [px, py, qx, qy] = [p[0][lane], p[1][lane], q[0][lane], q[1][lane]].map(f64::from);
                (px * qy - py * qx) as f32
            };
            u[lane] = edge(c, b);
            v[lane] = edge(a, c);
            w[lane] = edge(b, a);
        }
    }
}
