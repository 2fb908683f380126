//! Crease surfaces: which triangles of a mesh form one smooth sheet.
//!
//! Photons of one sheet may be averaged across its triangles, those on the two sides of a crease may not
//! [Larsen2004, 8.1]. Holds only geometry, and imports nothing but vectors and the hash of the sampler.

use std::f64::consts::PI;
use std::ops::Range;

use glam::{DMat3, DVec3, Mat3, Vec3};

use crate::math::sobol::mix;

/// Default crease angle, radians (60°): a cylinder of seven or more flat sides is one surface, a box (90°) is six.
pub const CREASE_ANGLE_RAD: f32 = std::f32::consts::FRAC_PI_3;

/// No vertex of this position has been seen.
const VACANT: u32 = u32::MAX;

/// The crease surfaces of one mesh: a partition of its triangles.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CreaseSurfaces {
    of_triangle: Vec<u32>,
    count: u32,
}

impl CreaseSurfaces {
    /// Joins triangles over the edges they share, where the surface turns by less than `angle_rad`.
    ///
    /// Vertices are the same when their positions are bit-equal (−0 = 0), whatever their indices: seams of texture
    /// coordinates or normals are no creases. An edge joins two triangles only if they run along it in opposite
    /// directions, so that all of a surface has its front on one side; at an edge of three and more triangles every
    /// such pair is looked at. Triangles without area have no normal and stay alone.
    ///
    /// - `positions`: `[n]`, mesh space
    /// - `triangles`: `[m]`, vertex indices, m < 2³¹
    /// - `mesh_to_render`: the linear part of the instance's transform. Angles are those after it, since shear and
    ///   uneven scale change them; a mirror turns all normals round and so changes none
    /// - `angle_rad`: 0 joins nothing, π joins all but triangles folded flat onto each other
    pub(super) fn split(
        positions: &[Vec3],
        triangles: &[[u32; 3]],
        mesh_to_render: Mat3,
        angle_rad: f32,
    ) -> CreaseSurfaces {
        let mesh = Stitched::new(positions, triangles, mesh_to_render);
        let limit = AngleLimit::new(angle_rad);
        let mut sheets = DisjointSets::new(triangles.len());
        let mut meetings = mesh.meetings();
        for vertex in 0..positions.len() {
            let range = meetings.of_vertex(vertex);
            let at_vertex = &mut meetings.sides[range];
            at_vertex.sort_unstable();
            for at_edge in at_vertex.chunk_by(|a, b| a.end() == b.end()) {
                mesh.join_over_edge(vertex, at_edge, limit, &mut sheets);
            }
        }
        sheets.numbered()
    }

    /// The surface that a triangle belongs to, 0 ≤ surface < [`CreaseSurfaces::count`].
    ///
    /// Surfaces are numbered in the order of their first triangles.
    pub(super) fn surface_of(&self, triangle: u32) -> u32 {
        self.of_triangle[triangle as usize]
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        self.of_triangle.len() * size_of::<u32>()
    }

    /// How many surfaces the mesh has.
    pub(super) fn count(&self) -> u32 {
        self.count
    }
}

/// The bound below which triangles join, as an angle and as its cosine.
#[derive(Clone, Copy)]
struct AngleLimit {
    angle_rad: f64,
    cosine: f64,
}

impl AngleLimit {
    fn new(angle_rad: f32) -> AngleLimit {
        let angle_rad = f64::from(angle_rad).clamp(0.0, PI);
        // The product of a unit normal with itself may round to above 1, which must not pass for "below 0".
        let cosine = if angle_rad > 0.0 { angle_rad.cos() } else { f64::INFINITY };
        AngleLimit { angle_rad, cosine }
    }
}

/// One side of a triangle, as seen from the lower of its two welded vertices.
///
/// Packed as (other end, triangle, direction) so that sorting the numbers groups the sides by edge.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side(u64);

impl Side {
    fn new(end: u32, triangle: u32, forward: bool) -> Side {
        Side(u64::from(end) << 32 | u64::from(triangle) << 1 | u64::from(forward))
    }

    /// The welded vertex at the side's other end.
    fn end(self) -> u32 {
        (self.0 >> 32) as u32
    }

    fn triangle(self) -> u32 {
        self.0 as u32 >> 1
    }

    /// True when the triangle runs from the lower vertex to the higher.
    fn is_forward(self) -> bool {
        self.0 & 1 == 1
    }
}

/// All sides of all triangles, those of one lower vertex side by side.
struct Meetings {
    sides: Vec<Side>,
    /// `[n + 1]`: where the sides of each vertex begin.
    first: Vec<usize>,
}

impl Meetings {
    fn of_vertex(&self, vertex: usize) -> Range<usize> {
        self.first[vertex]..self.first[vertex + 1]
    }
}

/// A mesh whose equal vertices are one.
struct Stitched<'a> {
    positions: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    mesh_to_render: DMat3,
    /// `[n]`: for each vertex the first one at its position.
    welded: Vec<u32>,
    /// `[m]`: unit normals after the transform, zero for triangles without area.
    normals: Vec<DVec3>,
}

impl<'a> Stitched<'a> {
    fn new(positions: &'a [Vec3], triangles: &'a [[u32; 3]], mesh_to_render: Mat3) -> Stitched<'a> {
        assert!(triangles.len() < 1 << 31, "triangle indices share 32 bits with a direction");
        let mesh_to_render = mesh_to_render.as_dmat3();
        let normals = render_normals(positions, triangles, mesh_to_render);
        Stitched { positions, triangles, mesh_to_render, welded: weld(positions), normals }
    }

    /// The triangle's sides as (from, to) welded vertices; none where it has no normal.
    fn sides_of(&self, triangle: usize) -> impl Iterator<Item = (u32, u32)> {
        let corners = self.triangles[triangle].map(|vertex| self.welded[vertex as usize]);
        let has_normal = self.normals[triangle] != DVec3::ZERO;
        (0..3).filter(move |_| has_normal).map(move |k| (corners[k], corners[(k + 1) % 3]))
    }

    /// A counting sort of all sides by their lower vertex.
    fn meetings(&self) -> Meetings {
        let mut first = vec![0; self.positions.len() + 1];
        for (from, to) in (0..self.triangles.len()).flat_map(|triangle| self.sides_of(triangle)) {
            first[from.min(to) as usize + 1] += 1;
        }
        for vertex in 1..first.len() {
            first[vertex] += first[vertex - 1];
        }
        let mut next = first.clone();
        let mut sides = vec![Side(0); *first.last().unwrap_or(&0)];
        for triangle in 0..self.triangles.len() {
            for (from, to) in self.sides_of(triangle) {
                let place = &mut next[from.min(to) as usize];
                sides[*place] = Side::new(from.max(to), triangle as u32, from < to);
                *place += 1;
            }
        }
        Meetings { sides, first }
    }

    fn normal_of(&self, side: Side) -> DVec3 {
        self.normals[side.triangle() as usize]
    }

    fn join_over_edge(&self, start: usize, sides: &[Side], limit: AngleLimit, sheets: &mut DisjointSets) {
        match sides {
            [] | [_] => {}
            [a, b] => {
                let turns_little = self.normal_of(*a).dot(self.normal_of(*b)) > limit.cosine;
                if a.is_forward() != b.is_forward() && turns_little {
                    sheets.join(a.triangle(), b.triangle());
                }
            }
            _ => self.join_around_edge(start, sides, limit, sheets),
        }
    }

    /// Joins every pair of opposite sides below the limit, in O(k log k) for the k sides of one edge.
    ///
    /// All normals lie in the plane across the edge, so each side is an angle. In the order of angles it is enough to
    /// join each side with the nearest opposite side before it and after it: between two opposite sides closer than
    /// the limit, all neighbouring runs of equal direction are closer than it as well, hence chained together.
    /// All pairs would take minutes for a million triangles in one edge, which a broken file can hold.
    fn join_around_edge(&self, start: usize, sides: &[Side], limit: AngleLimit, sheets: &mut DisjointSets) {
        let angled = self.sorted_by_angle(start, sides);
        // The second round closes the circle.
        let rounds = [0.0, 2.0 * PI].into_iter();
        let walk = rounds.flat_map(|turn| angled.iter().map(move |(angle, side)| (angle + turn, *side)));
        join_with_last_opposite(walk.clone(), limit, sheets);
        join_with_last_opposite(walk.rev(), limit, sheets);
    }

    /// Sides of one edge by the angle of their normals about it.
    fn sorted_by_angle(&self, start: usize, sides: &[Side]) -> Vec<(f64, Side)> {
        let end = sides[0].end() as usize;
        let along = self.mesh_to_render * (self.positions[end].as_dvec3() - self.positions[start].as_dvec3());
        let zero = self.normal_of(sides[0]);
        let quarter = along.normalize_or_zero().cross(zero);
        let angle_of = |normal: DVec3| normal.dot(quarter).atan2(normal.dot(zero));
        let mut angled: Vec<_> = sides.iter().map(|side| (angle_of(self.normal_of(*side)), *side)).collect();
        angled.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        angled
    }
}

/// Walks over sides in the order of their angles, up or down, and joins each with the last opposite one before it.
fn join_with_last_opposite(
    walk: impl Iterator<Item = (f64, Side)>,
    limit: AngleLimit,
    sheets: &mut DisjointSets,
) {
    // By direction, backward first.
    let mut last: [Option<(f64, u32)>; 2] = [None; 2];
    for (angle_rad, side) in walk {
        if let Some((opposite_rad, opposite)) = last[usize::from(!side.is_forward())]
            && (angle_rad - opposite_rad).abs() < limit.angle_rad
        {
            sheets.join(opposite, side.triangle());
        }
        last[usize::from(side.is_forward())] = Some((angle_rad, side.triangle()));
    }
}

/// Unit normals after the transform: zero where the triangle or the transform has no area to show.
///
/// Single-precision corners make the cross product exact in double precision unless their exponents lie far apart,
/// so that a triangle on a line gives exactly zero. The transform is applied after it: (Mx) × (My) = cof(M) (x × y).
fn render_normals(positions: &[Vec3], triangles: &[[u32; 3]], mesh_to_render: DMat3) -> Vec<DVec3> {
    let DMat3 { x_axis: x, y_axis: y, z_axis: z } = mesh_to_render;
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    let normal = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
        (cofactors * (b - a).cross(c - a)).normalize_or_zero()
    };
    triangles.iter().map(normal).collect()
}

/// `[n]`: for each vertex the index of the first vertex at its position.
///
/// An open-addressing table of indices, at most half full: the standard map's hash would take most of the time.
fn weld(positions: &[Vec3]) -> Vec<u32> {
    // Adding zero turns −0 into +0 and leaves everything else.
    let key_of = |vertex: u32| (positions[vertex as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut table = vec![VACANT; (2 * positions.len()).next_power_of_two()];
    let mask = table.len() - 1;
    let weld_one = |vertex: u32| {
        let key = key_of(vertex);
        let mut slot = slot_of(key) & mask;
        while table[slot] != VACANT && key_of(table[slot]) != key {
            slot = (slot + 1) & mask;
        }
        if table[slot] == VACANT {
            table[slot] = vertex;
        }
        table[slot]
    };
    (0..positions.len() as u32).map(weld_one).collect()
}

fn slot_of([x, y, z]: [u32; 3]) -> usize {
    mix(mix(u64::from(x) << 32 | u64::from(y)) ^ u64::from(z)) as usize
}

/// A partition of 0..n under joining, each set led by its smallest member.
struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    fn new(count: usize) -> DisjointSets {
        DisjointSets { parent: (0..count as u32).collect() }
    }

    /// The smallest member of the set, shortening the way to it for the next call.
    fn leader(&mut self, mut member: u32) -> u32 {
        while self.parent[member as usize] != member {
            let above = self.parent[member as usize];
            self.parent[member as usize] = self.parent[above as usize];
            member = self.parent[member as usize];
        }
        member
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.leader(a), self.leader(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Numbers the sets by their leaders. A parent is never above its child, so one pass upwards is enough.
    fn numbered(self) -> CreaseSurfaces {
        let mut of_triangle = self.parent;
        let mut count = 0;
        for triangle in 0..of_triangle.len() {
            let parent = of_triangle[triangle] as usize;
            if parent == triangle {
                of_triangle[triangle] = count;
                count += 1;
            } else {
                of_triangle[triangle] = of_triangle[parent];
            }
        }
        CreaseSurfaces { of_triangle, count }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Vec3};

    use super::{CREASE_ANGLE_RAD, CreaseSurfaces};
    use crate::math::sobol::{mix, point};

    /// Positions and triangles; every triangle has its own vertices unless said otherwise.
    type Soup = (Vec<Vec3>, Vec<[u32; 3]>);

    fn soup(triangles: impl IntoIterator<Item = [Vec3; 3]>) -> Soup {
        let positions: Vec<Vec3> = triangles.into_iter().flatten().collect();
        let count = positions.len() as u32 / 3;
        (positions, (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    fn split((positions, triangles): &Soup, degrees: f32) -> CreaseSurfaces {
        CreaseSurfaces::split(positions, triangles, Mat3::IDENTITY, degrees.to_radians())
    }

    fn quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> [[Vec3; 3]; 2] {
        [[a, b, c], [a, c, d]]
    }

    /// A unit cube, each face two triangles of its own vertices.
    fn cube() -> Soup {
        let corner = |k: usize| Vec3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32);
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        soup(faces.into_iter().flat_map(|f| quad(corner(f[0]), corner(f[1]), corner(f[2]), corner(f[3]))))
    }

    /// A strip of two triangles over the y axis, the second turned up by `degrees`.
    fn hinge(degrees: f32) -> Soup {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let wing = Vec3::new(cos, 0.0, sin);
        soup([[Vec3::ZERO, Vec3::Y, -Vec3::X], [Vec3::Y, Vec3::ZERO, wing]])
    }

    /// A latitude–longitude sphere with a seam of doubled vertices, `n` columns by `n` rows.
    fn sphere(n: u32) -> Soup {
        let at = |i: u32, j: u32| {
            let theta = std::f32::consts::PI * j as f32 / n as f32;
            let phi = std::f32::consts::TAU * (i % n) as f32 / n as f32;
            let (s, c) = if j == n { (0.0, -1.0) } else { theta.sin_cos() };
            Vec3::new(s * phi.cos(), s * phi.sin(), c)
        };
        let positions = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j))).collect();
        let index = |i, j| j * (n + 1) + i;
        let cell = |k: u32| {
            let (i, j) = (k % n, k / n);
            let [a, b, c, d] = [index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)];
            [[a, b, c], [a, c, d]]
        };
        (positions, (0..n * n).flat_map(cell).collect())
    }

    /// `count` triangles in one edge, turned and wound by chance.
    fn book(count: u32, key: u64) -> Soup {
        soup((0..count).map(|page| {
            let [turn, wound, ..] = point(key, page);
            let (sin, cos) = (turn * std::f32::consts::TAU).sin_cos();
            let [a, b] = if wound < 0.5 { [Vec3::ZERO, Vec3::Y] } else { [Vec3::Y, Vec3::ZERO] };
            [a, b, Vec3::new(cos, 0.5, sin)]
        }))
    }

    fn numbers(surfaces: &CreaseSurfaces) -> Vec<u32> {
        (0..surfaces.of_triangle.len() as u32).map(|t| surfaces.surface_of(t)).collect()
    }

    /// A cube falls apart into its six faces below 90° and is whole above, with vertices shared by nobody.
    #[test]
    fn a_cube_has_six_surfaces_below_a_right_angle_and_one_above() {
        let faces = split(&cube(), 60.0);
        assert_eq!(numbers(&faces), [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]);
        assert_eq!(faces.count(), 6);
        assert_eq!(split(&cube(), 89.9).count(), 6);
        assert_eq!(split(&cube(), 90.1).count(), 1);
    }

    /// Round things are one surface across seams of doubled vertices and poles of flattened triangles.
    #[test]
    fn a_sphere_is_one_surface_but_for_the_triangles_without_area_at_its_poles() {
        let n = 24;
        let surfaces = split(&sphere(n), CREASE_ANGLE_RAD.to_degrees());
        assert_eq!(surfaces.count(), 1 + 2 * n);
        // One triangle of each cell of the first and the last row has two corners in a pole.
        let whole = numbers(&surfaces);
        let most = (0..surfaces.count()).map(|s| whole.iter().filter(|x| **x == s).count()).max();
        assert_eq!(most, Some((2 * n * n - 2 * n) as usize));
    }

    /// The limit is a strict bound on the angle between the normals, whichever way the hinge turns.
    #[test]
    fn a_hinge_joins_exactly_below_the_angle() {
        for degrees in [-170.0f32, -90.0, -60.0, -1.0, 0.0, 0.5, 30.0, 60.0, 120.0, 179.0] {
            // The hinge's own corners are rounded to 2⁻²⁴, some 10⁻⁵ degrees.
            let above = split(&hinge(degrees), degrees.abs() + 1e-3);
            assert_eq!(above.count(), 1, "{degrees}");
            let below = split(&hinge(degrees), degrees.abs() - 1e-3);
            assert_eq!(below.count(), 2, "{degrees}");
        }
        assert_eq!(split(&hinge(0.0), 0.0).count(), 2, "nothing turns by less than nothing");
        let front = [Vec3::ZERO, Vec3::Y, -Vec3::X];
        let [a, b, c] = front;
        assert_eq!(split(&soup([front, [b, a, c]]), 180.0).count(), 2, "a sheet folded flat has two sides");
    }

    /// Triangles that run along their edge in the same direction have fronts on different sides and stay apart.
    #[test]
    fn triangles_wound_against_each_other_do_not_join() {
        let (positions, mut triangles) = hinge(0.0);
        triangles[1].swap(0, 1);
        assert_eq!(split(&(positions, triangles), 179.0).count(), 2);
    }

    /// Angles are those after the transform: shear and uneven scale open and close creases, mirrors do not.
    #[test]
    fn angles_are_measured_after_the_transform() {
        let (positions, triangles) = hinge(50.0);
        let count =
            |transform| CreaseSurfaces::split(&positions, &triangles, transform, CREASE_ANGLE_RAD).count();
        assert_eq!(count(Mat3::IDENTITY), 1);
        // tan 50° doubled is tan 67.2°, halved tan 30.8°.
        assert_eq!(count(Mat3::from_diagonal(Vec3::new(1.0, 1.0, 2.0))), 2);
        assert_eq!(count(Mat3::from_diagonal(Vec3::new(1.0, 1.0, 0.5))), 1);
        // z += x / 2 turns the flat wing by arctan ½ = 26.6° and the other from 50° to 59.4°: 32.8° between them.
        assert_eq!(count(Mat3::from_cols(Vec3::new(1.0, 0.0, 0.5), Vec3::Y, Vec3::Z)), 1);
        // x −= 3z / 2 leaves the flat wing and turns the other to 123.4°.
        assert_eq!(count(Mat3::from_cols(Vec3::X, Vec3::Y, Vec3::new(-1.5, 0.0, 1.0))), 2);
        for mirror in [Vec3::new(-1.0, 1.0, 1.0), Vec3::new(1.0, 1.0, -1.0), Vec3::NEG_ONE] {
            assert_eq!(count(Mat3::from_diagonal(mirror)), 1);
            assert_eq!(count(Mat3::from_diagonal(mirror * Vec3::new(1.0, 1.0, 2.0))), 2);
        }
    }

    /// A transform that flattens the mesh onto a line leaves no area, hence nothing to join.
    #[test]
    fn a_singular_transform_leaves_every_triangle_alone() {
        let (positions, triangles) = cube();
        let line = Mat3::from_diagonal(Vec3::X);
        assert_eq!(CreaseSurfaces::split(&positions, &triangles, line, CREASE_ANGLE_RAD).count(), 12);
    }

    /// Scale does not matter, from atoms to planets.
    #[test]
    fn tiny_and_huge_meshes_split_alike() {
        for scale in [1e-18f32, 1e-6, 1e6, 1e18] {
            let (positions, triangles) = cube();
            let scaled: Vec<Vec3> = positions.iter().map(|p| *p * scale).collect();
            assert_eq!(split(&(scaled, triangles), 60.0).count(), 6, "{scale}");
            let transform = Mat3::from_diagonal(Vec3::splat(scale));
            let (positions, triangles) = cube();
            assert_eq!(CreaseSurfaces::split(&positions, &triangles, transform, 1.0).count(), 6, "{scale}");
        }
    }

    /// The negative zero of a mirrored half meets the positive zero of the other.
    #[test]
    fn negative_zero_is_zero() {
        let left = [Vec3::ZERO, Vec3::Y, -Vec3::X];
        let right = [Vec3::new(-0.0, 1.0, -0.0), Vec3::new(-0.0, -0.0, -0.0), Vec3::X];
        assert_eq!(split(&soup([left, right]), 60.0).count(), 1);
    }

    /// Triangles without area join nothing, neither themselves nor others across them.
    #[test]
    fn triangles_without_area_stay_alone() {
        let [a, b] = [Vec3::ZERO, Vec3::Y];
        let flat = [[a, b, b], [a, a, a], [b, a, Vec3::Y * 0.5], [a, b, Vec3::Y * 2.0]];
        let up = [a, b, -Vec3::X];
        let lifted = [Vec3::Y * 2.0, Vec3::Y, Vec3::X];
        let surfaces = split(&soup(flat.into_iter().chain([up, lifted])), 60.0);
        assert_eq!(numbers(&surfaces), [0, 1, 2, 3, 4, 5]);
        // And a true pair joins in their midst.
        let right = [b, a, Vec3::X];
        let surfaces = split(&soup(flat.into_iter().chain([up, right])), 60.0);
        assert_eq!(numbers(&surfaces), [0, 1, 2, 3, 4, 4]);
    }

    /// Numbers that are no numbers reach no surface: NaN and infinity have no normal.
    #[test]
    fn corners_at_nan_or_infinity_do_no_harm() {
        for bad in [f32::NAN, f32::INFINITY, f32::MAX] {
            let (mut positions, triangles) = hinge(10.0);
            positions[2].x = bad;
            let count = split(&(positions, triangles), 60.0).count();
            assert!(bad == f32::MAX || count == 2, "{bad}: {count}");
        }
    }

    /// A mesh without triangles has no surfaces.
    #[test]
    fn nothing_has_no_surfaces() {
        assert_eq!(split(&(Vec::new(), Vec::new()), 60.0).count(), 0);
        assert_eq!(split(&(vec![Vec3::ZERO], Vec::new()), 60.0).count(), 0);
    }

    /// At an edge of many triangles the walk round it joins what looking at every pair joins.
    #[test]
    fn walking_round_an_edge_equals_looking_at_all_pairs() {
        for key in 0..400 {
            let pages = book(3 + key as u32 % 12, key);
            let degrees = 5.0 + 170.0 * point(1000, key as u32)[0];
            let count = pages.1.len();
            let mut of: Vec<u32> = (0..count as u32).collect();
            for (i, j) in (0..count).flat_map(|i| (0..i).map(move |j| (i, j))) {
                let [a, b] = [i, j].map(|k| &pages.0[3 * k..3 * k + 3]);
                let normal = |t: &[Vec3]| (t[1] - t[0]).cross(t[2] - t[0]);
                if a[0] != b[0] && normal(a).angle_between(normal(b)).to_degrees() < degrees {
                    let (from, to) = (of[i].max(of[j]), of[i].min(of[j]));
                    of.iter_mut().filter(|s| **s == from).for_each(|s| *s = to);
                }
            }
            // From leaders to numbers.
            let leaders: Vec<u32> = (0..count as u32).filter(|t| of[*t as usize] == *t).collect();
            let expected: Vec<u32> =
                of.iter().map(|s| leaders.binary_search(s).expect("a leader leads") as u32).collect();
            assert_eq!(numbers(&split(&pages, degrees)), expected, "key {key}");
        }
    }

    /// A file that hangs all its triangles on one edge costs no more than another (all pairs would take minutes).
    #[test]
    fn a_hundred_thousand_triangles_in_one_edge_are_joined_in_time() {
        assert_eq!(split(&book(100_000, 1), 60.0).count(), 1);
    }

    /// Surfaces are numbered by their first triangles, and the partition does not hang on the order of triangles.
    #[test]
    fn order_of_triangles_changes_numbers_only() {
        let (positions, triangles) = sphere(16);
        let plain = split(&(positions.clone(), triangles.clone()), 2.0);
        assert!(plain.count() > 40, "a limit that splits: {}", plain.count());
        let mut order: Vec<usize> = (0..triangles.len()).collect();
        order.sort_by_key(|t| mix(*t as u64 + 1));
        let shuffled: Vec<[u32; 3]> = order.iter().map(|t| triangles[*t]).collect();
        let other = split(&(positions, shuffled), 2.0);
        assert_eq!(plain.count(), other.count());
        let mut seen = 0;
        let mut name = vec![None; plain.count() as usize];
        for (place, triangle) in order.into_iter().enumerate() {
            let surface = other.surface_of(place as u32);
            assert!(surface <= seen, "numbers come in order");
            seen = seen.max(surface + 1);
            let known = name[plain.surface_of(triangle as u32) as usize].get_or_insert(surface);
            assert_eq!(*known, surface);
        }
    }
}
