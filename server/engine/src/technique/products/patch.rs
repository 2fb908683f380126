//! Exact areas of parts of triangles: inside a sphere (what a photon's neighbourhood truly covers) and inside a box
//! (what a leaf of an octree truly holds).
//!
//! Pure geometry on vectors. Everything is computed in double precision from single-precision corners, because the
//! signed contributions below cancel: a thin triangle is the difference of two large sectors.

use glam::{DVec2, DVec3, Vec3};

/// Corners of a triangle cut by six planes: each adds one at most.
const CORNER_COUNT_MAX: usize = 9;

/// A flat piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Area, square metres.
    pub area_m2: f32,
    /// Mean point.
    pub centroid: Vec3,
}

impl Patch {
    /// All of a triangle; `None` of one without area.
    fn whole(triangle: [Vec3; 3]) -> Option<Patch> {
        let [a, b, c] = triangle.map(|corner| corner.as_dvec3());
        let area_m2 = (0.5 * (b - a).cross(c - a).length()) as f32;
        let [low, high] =
            [triangle[0].min(triangle[1]).min(triangle[2]), triangle[0].max(triangle[1]).max(triangle[2])];
        // Rounding to single precision may step out of it.
        let centroid = ((a + b + c) / 3.0).as_vec3().clamp(low, high);
        (area_m2 > 0.0).then_some(Patch { area_m2, centroid })
    }
}

/// Area of the part of `triangle` inside a sphere, m².
///
/// The sphere meets the triangle's plane in a disc of radius √(r² − d²), and the part of a polygon inside a disc is
/// the sum over its edges of what the triangle (disc's centre, edge) has inside the disc, signed by its orientation:
/// a plain triangle where the edge runs inside the disc, a sector where it runs outside.
///
/// - returns a number in [0, min(area of the triangle, π (r² − d²))]; exactly zero when they do not meet
pub(super) fn area_in_sphere(triangle: [Vec3; 3], centre: Vec3, radius: f32) -> f32 {
    let corners = triangle.map(|corner| corner.as_dvec3() - centre.as_dvec3());
    let [a, b, c] = corners;
    let (ab, bc, ca) = (b - a, c - b, a - c);
    let area_vector = 0.5 * ab.cross(-ca);
    let area = area_vector.length();
    let radius_squared = f64::from(radius) * f64::from(radius);
    if !(area > 0.0 && radius > 0.0) {
        return 0.0;
    }
    if corners.iter().all(|corner| corner.length_squared() <= radius_squared) {
        return area as f32;
    }
    let normal = area_vector / area;
    let height = normal.dot(a);
    let disc_squared = radius_squared - height * height;
    if !(disc_squared > 0.0) {
        return 0.0;
    }
    // Edges as seen along the normal from the disc's centre. Taking (b − a) from the corners, not from the flattened
    // points, keeps the orientation of a short edge far from the centre to its last bits.
    let foot = normal * height;
    let edges = [(a, ab), (b, bc), (c, ca)].map(|(from, along)| Edge::new(from - foot, along, normal));
    let bound = area.min(std::f64::consts::PI * disc_squared);
    if edges.iter().all(|edge| edge.run_in_disc(disc_squared).is_none()) {
        let holds_disc = edges.iter().all(|edge| edge.turn >= 0.0);
        return if holds_disc { bound as f32 } else { 0.0 };
    }
    let sum: f64 = edges.iter().map(|edge| edge.area_in_disc(disc_squared)).sum();
    sum.clamp(0.0, bound) as f32
}

/// An edge in the plane of a disc, relative to the disc's centre.
struct Edge {
    from: DVec3,
    along: DVec3,
    /// Twice the signed area of the triangle (centre, edge).
    turn: f64,
}

impl Edge {
    fn new(from: DVec3, along: DVec3, normal: DVec3) -> Edge {
        Edge { from, along, turn: from.cross(along).dot(normal) }
    }

    /// Where the edge enters and leaves the disc, as fractions of its length; none when it stays outside.
    fn run_in_disc(&self, disc_squared: f64) -> Option<DVec2> {
        let length_squared = self.along.length_squared();
        let middle = -self.from.dot(self.along) / length_squared;
        // The line's distance to the centre is |turn| / length: no difference of large squares as in the quadratic.
        let half_squared = (disc_squared - self.turn * self.turn / length_squared) / length_squared;
        let half = half_squared.max(0.0).sqrt();
        let run = DVec2::new((middle - half).max(0.0), (middle + half).min(1.0));
        (run.x < run.y).then_some(run)
    }

    /// Signed area that the triangle (centre, edge) has in the disc.
    fn area_in_disc(&self, disc_squared: f64) -> f64 {
        match self.run_in_disc(disc_squared) {
            None => self.sector(DVec2::new(0.0, 1.0), disc_squared),
            Some(run) => {
                let before = self.sector(DVec2::new(0.0, run.x), disc_squared);
                let after = self.sector(DVec2::new(run.y, 1.0), disc_squared);
                before + 0.5 * self.turn * (run.y - run.x) + after
            }
        }
    }

    /// Signed area of the disc's sector that a run of the edge is seen under.
    fn sector(&self, run: DVec2, disc_squared: f64) -> f64 {
        if run.x == run.y {
            return 0.0;
        }
        let (p, q) = (self.from + self.along * run.x, self.from + self.along * run.y);
        0.5 * disc_squared * (self.turn * (run.y - run.x)).atan2(p.dot(q))
    }
}

/// The part of `triangle` inside the box `min` ≤ p < `max`, or none when that has no area.
///
/// Clips by one plane after another [SutherlandHodgman1974]. The box is half-open: a triangle that lies in the plane
/// between two boxes belongs to the upper one only, and over any grid of boxes whose faces are the same numbers the
/// areas sum to the triangle's own. The grid must reach beyond the triangle: what lies in its last plane is in no box.
///
/// - returns the patch, its centroid in the closed box
pub fn clip_to_box(triangle: [Vec3; 3], min: Vec3, max: Vec3) -> Option<Patch> {
    let [a, b, c] = triangle;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    if high.cmplt(min).any() || low.cmpge(max).any() {
        return None;
    }
    if low.cmpge(min).all() && high.cmplt(max).all() {
        return Patch::whole(triangle);
    }
    let mut polygon = Polygon::of(triangle);
    for axis in 0..3 {
        // A triangle in the plane of a face has passed the half-open test above and is not cut by this axis.
        if low[axis] < min[axis] {
            polygon = polygon.cut(axis, 1.0, f64::from(min[axis]));
        }
        if high[axis] > max[axis] {
            polygon = polygon.cut(axis, -1.0, f64::from(max[axis]));
        }
    }
    let mut patch = polygon.patch()?;
    // Rounding to single precision may step over a face.
    patch.centroid = patch.centroid.clamp(min.max(low), max.min(high));
    Some(patch)
}

/// A convex polygon in space.
struct Polygon {
    corners: [DVec3; CORNER_COUNT_MAX],
    corner_count: usize,
}

impl Polygon {
    const EMPTY: Polygon = Polygon { corners: [DVec3::ZERO; CORNER_COUNT_MAX], corner_count: 0 };

    fn of(triangle: [Vec3; 3]) -> Polygon {
        let mut polygon = Polygon::EMPTY;
        triangle.into_iter().for_each(|corner| polygon.push(corner.as_dvec3()));
        polygon
    }

    fn push(&mut self, corner: DVec3) {
        // Rounding may make a sliver look concave to a plane, which then finds a corner more than there can be;
        // such a corner bounds no area worth keeping.
        if self.corner_count < CORNER_COUNT_MAX {
            self.corners[self.corner_count] = corner;
            self.corner_count += 1;
        }
    }

    /// What lies on the side of the plane p[axis] = `at` that `sign` points to.
    fn cut(&self, axis: usize, sign: f64, at: f64) -> Polygon {
        let mut kept = Polygon::EMPTY;
        let corners = &self.corners[..self.corner_count];
        for (k, from) in corners.iter().enumerate() {
            let to = corners[(k + 1) % corners.len()];
            let [inside_from, inside_to] = [sign * (from[axis] - at), sign * (to[axis] - at)];
            if inside_from >= 0.0 {
                kept.push(*from);
            }
            // Corners in the plane are kept as they are, so only strict crossings make new ones.
            if inside_from * inside_to < 0.0 {
                let mut crossing = from.lerp(to, inside_from / (inside_from - inside_to));
                crossing[axis] = at;
                kept.push(crossing);
            }
        }
        kept
    }

    /// Area and centroid, as a fan from the first corner.
    fn patch(&self) -> Option<Patch> {
        let apex = self.corners[0];
        let spokes = self.corners.map(|corner| corner - apex);
        let blades = 1..self.corner_count.saturating_sub(1);
        let area_vectors = blades.clone().map(|k| 0.5 * spokes[k].cross(spokes[k + 1]));
        let normal = area_vectors.clone().sum::<DVec3>().normalize_or_zero();
        let areas = area_vectors.map(|vector| vector.dot(normal));
        let area: f64 = areas.clone().sum();
        if !(area as f32 > 0.0) {
            return None;
        }
        let moment: DVec3 = areas.zip(blades).map(|(area, k)| area * (spokes[k] + spokes[k + 1]) / 3.0).sum();
        Some(Patch { area_m2: area as f32, centroid: (apex + moment / area).as_vec3() })
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use glam::{Mat3, Quat, Vec3};

    use super::{Patch, area_in_sphere, clip_to_box};
    use crate::math::sobol::point;

    /// A point in [−1, 1]³ of a named sequence.
    fn in_cube(key: u64, index: u32) -> Vec3 {
        let [x, y, z, _] = point(key, index);
        2.0 * Vec3::new(x, y, z) - 1.0
    }

    fn random_triangle(index: u32) -> [Vec3; 3] {
        [1, 2, 3].map(|key| in_cube(key, index))
    }

    fn random_turn(index: u32) -> Mat3 {
        let [x, y, z, w] = point(77, index).map(|u| u - 0.5);
        Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize())
    }

    fn area(triangle: [Vec3; 3]) -> f32 {
        let [a, b, c] = triangle.map(Vec3::as_dvec3);
        (0.5 * (b - a).cross(c - a).length()) as f32
    }

    fn mean([a, b, c]: [Vec3; 3]) -> Vec3 {
        (a + b + c) / 3.0
    }

    /// Fraction of the triangle where `holds`, by 2¹⁴ stratified points, and its standard deviation if they were
    /// independent (they do better).
    fn fraction([a, b, c]: [Vec3; 3], key: u64, holds: impl Fn(Vec3) -> bool) -> (f32, f32) {
        let count = 1 << 14;
        let hits = (0..count).filter(|index| {
            let [u, v, ..] = point(key, *index);
            let (s, t) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            holds(a + (b - a) * s + (c - a) * t)
        });
        let fraction = hits.count() as f32 / count as f32;
        // At least the deviation that a single hit among all would have.
        let sigma = (fraction * (1.0 - fraction)).max(1.0 / count as f32).sqrt() / (count as f32).sqrt();
        (fraction, sigma)
    }

    /// `found` is `expected` to within `relative` of it.
    fn assert_near(found: f32, expected: f32, relative: f32, what: &str) {
        assert!((found - expected).abs() <= relative * expected.abs(), "{what}: {found}, not {expected}");
    }

    /// The area in a sphere is the share of points in it, for random triangles and spheres.
    #[test]
    fn area_in_sphere_agrees_with_counting_points() {
        for index in 0..300 {
            let triangle = random_triangle(index);
            let (centre, radius) = (in_cube(4, index), 0.1 + 1.5 * point(5, index)[0]);
            let (expected, sigma) =
                fraction(triangle, u64::from(index), |p| p.distance_squared(centre) < radius * radius);
            let found = area_in_sphere(triangle, centre, radius) / area(triangle);
            assert!((found - expected).abs() < 5.0 * sigma, "{index}: {found}, not {expected} ± {sigma}");
        }
    }

    /// Where the disc meets the triangle simply, its area is known: whole, half, quarter, sector, segment.
    #[test]
    fn discs_at_edges_and_corners_have_their_textbook_areas() {
        // Corners far enough away that a disc of radius 1 at the origin meets only what is named.
        let whole = [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]];
        let half = [[-9.0, 0.0], [9.0, 0.0], [0.0, 9.0]];
        let quarter = [[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]];
        let eighth = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]];
        let segment = [[-9.0, 0.5], [9.0, 0.5], [0.0, 9.0]];
        let outside = [[-9.0, 1.5], [9.0, 1.5], [0.0, 9.0]];
        let beside = [[1.01, 0.0], [9.0, -1.0], [9.0, 1.0]];
        let segment_area = 0.5f32.acos() - 0.5 * 0.75f32.sqrt();
        let cases = [
            (whole, PI),
            (half, PI / 2.0),
            (quarter, PI / 4.0),
            (eighth, PI / 8.0),
            (segment, segment_area),
            (outside, 0.0),
            (beside, 0.0),
        ];
        for (index, (flat, expected)) in cases.into_iter().enumerate() {
            for turn in 0..20 {
                let (turn, shift) = (random_turn(turn), 3.0 * in_cube(9, turn));
                for height in [0.0, 0.6f32] {
                    let triangle = flat.map(|[x, y]| turn * Vec3::new(x, y, height) + shift);
                    // The sphere that cuts the plane in a disc of radius 1.
                    let radius = (1.0 + height * height).sqrt();
                    let found = area_in_sphere(triangle, shift, radius);
                    // Corners of size 12 are rounded by 10⁻⁶, and move a chord of length 2 by it.
                    assert!((found - expected).abs() < 1e-5, "case {index}: {found}, not {expected}");
                }
            }
        }
    }

    /// A sphere around all corners holds the whole triangle to the last bit; one that misses the plane holds nothing.
    #[test]
    fn all_or_nothing_is_exact() {
        for index in 0..100 {
            let triangle = random_triangle(index);
            let [a, b, c] = triangle;
            let normal = (b - a).cross(c - a).normalize();
            assert_eq!(area_in_sphere(triangle, Vec3::ZERO, 2.0), area(triangle));
            assert_eq!(area_in_sphere(triangle, mean(triangle) + 0.5 * normal, 0.499), 0.0);
            // Beside a corner, in the plane: no edge shields the corner, and yet nothing is left by rounding.
            let away = -((b - a).normalize() + (c - a).normalize()).normalize();
            let beside = area_in_sphere(triangle, a + 0.5 * away, 0.499);
            assert_eq!(beside, 0.0, "{index}");
        }
    }

    /// Both windings and all three first corners give one area, and no area leaves its bounds.
    #[test]
    fn corner_order_does_not_matter_and_bounds_hold() {
        for index in 0..2000 {
            let triangle = random_triangle(index);
            let [a, b, c] = triangle;
            let (centre, radius) = (in_cube(4, index), 1.5 * point(5, index)[0]);
            let found = area_in_sphere(triangle, centre, radius);
            assert!(found >= 0.0 && found <= area(triangle) && found <= PI * radius * radius, "{index}");
            for other in [[b, c, a], [c, b, a]] {
                let other = area_in_sphere(other, centre, radius);
                assert!((found - other).abs() <= 1e-6 * found.max(1e-6), "{index}: {found} {other}");
            }
        }
    }

    /// The parts of a triangle add up: splitting it at a point inside changes nothing.
    #[test]
    fn areas_of_parts_sum_to_the_whole() {
        for index in 0..500 {
            let triangle = random_triangle(index);
            let [a, b, c] = triangle;
            let inside = a * 0.2 + b * 0.5 + c * 0.3;
            let (centre, radius) = (in_cube(4, index), 0.1 + point(5, index)[0]);
            let parts = [[a, b, inside], [b, c, inside], [c, a, inside]];
            let sum: f32 = parts.map(|part| area_in_sphere(part, centre, radius)).iter().sum();
            let whole = area_in_sphere(triangle, centre, radius);
            // The point inside is rounded by 10⁻⁷ off the plane and the sum by as much.
            assert!((sum - whole).abs() < 2e-6, "{index}: {sum}, not {whole}");
        }
    }

    /// Area goes with the square of scale, from atoms to galaxies.
    #[test]
    fn area_scales_with_the_square_of_length() {
        for scale in [1e-15f32, 1e-6, 1e6, 1e15] {
            for index in 0..50 {
                let triangle = random_triangle(index);
                let (centre, radius) = (in_cube(4, index), 0.2 + point(5, index)[0]);
                let one = area_in_sphere(triangle, centre, radius);
                let scaled = area_in_sphere(triangle.map(|p| p * scale), centre * scale, radius * scale);
                // Rounding of scaled corners is 10⁻⁷ of coordinates near 1.
                assert!((scaled / (scale * scale) - one).abs() < 2e-6, "{scale} {index}: {scaled} {one}");
            }
        }
    }

    /// A needle through a sphere keeps its width: ∫ width over the chord, where sectors cancel to one part in 10⁷.
    #[test]
    fn slivers_keep_their_area() {
        for half_width in [1e-3f32, 1e-6, 1e-9, 1e-20] {
            let needle = [
                Vec3::new(-8.0, -half_width, 0.0),
                Vec3::new(8.0, 0.0, 0.0),
                Vec3::new(-8.0, half_width, 0.0),
            ];
            // Width at x is 2w (8 − x) / 16; over −1 to 1 that is 2w, but for the chord's sagitta of order w².
            let found = area_in_sphere(needle, Vec3::ZERO, 1.0);
            assert_near(found, 2.0 * half_width, 1e-5, "needle");
        }
    }

    /// Tiny triangles at the rim of a large sphere lose no digits: the rim is a straight line to them.
    #[test]
    fn tiny_triangles_are_halved_by_the_rim_of_a_large_sphere() {
        for size in [1e-2f32, 1e-4, 1e-6] {
            // Symmetric about the rim x = 0 of a sphere of radius 1 around (−1, 0, 0).
            let triangle = [Vec3::new(0.0, size, 0.0), Vec3::new(-size, 0.0, 0.0), Vec3::new(size, 0.0, 0.0)];
            let found = area_in_sphere(triangle, -Vec3::X, 1.0);
            // The rim bends away by y² / 2, at most half a size of its own.
            assert_near(found, 0.5 * size * size, size.max(1e-5), "half");
        }
    }

    /// Nothing has no area: points, lines, empty spheres, and numbers that are none.
    #[test]
    fn degenerate_input_has_no_area() {
        let [o, x, y] = [Vec3::ZERO, Vec3::X, Vec3::Y];
        assert_eq!(area_in_sphere([o, o, o], o, 1.0), 0.0);
        assert_eq!(area_in_sphere([o, x, x * 2.0], o, 1.0), 0.0);
        assert_eq!(area_in_sphere([o, x, y], o, 0.0), 0.0);
        assert_eq!(area_in_sphere([o, x, y], o, -1.0), 0.0);
        assert_eq!(area_in_sphere([o, x, Vec3::NAN], o, 1.0), 0.0);
        assert_eq!(area_in_sphere([o, x, y], o, f32::NAN), 0.0);
        for (low, high) in [(-Vec3::ONE, Vec3::ONE), (Vec3::ONE, -Vec3::ONE)] {
            assert_eq!(clip_to_box([o, o, o], low, high), None);
            assert_eq!(clip_to_box([o, x, x * 2.0], low, high), None);
            assert_eq!(clip_to_box([o, x, Vec3::NAN], low, high), None);
        }
    }

    /// The part in a box has the share of points in it, for random triangles and boxes.
    #[test]
    fn clipped_area_agrees_with_counting_points() {
        for index in 0..300 {
            let triangle = random_triangle(index);
            let (p, q) = (in_cube(4, index), in_cube(6, index));
            let (min, max) = (p.min(q), p.max(q));
            let inside = |p: Vec3| p.cmpge(min).all() && p.cmplt(max).all();
            let (expected, sigma) = fraction(triangle, u64::from(index), inside);
            let patch = clip_to_box(triangle, min, max);
            let found = patch.map_or(0.0, |patch| patch.area_m2) / area(triangle);
            assert!((found - expected).abs() < 5.0 * sigma, "{index}: {found}, not {expected} ± {sigma}");
            let centroid = patch.map_or(min, |patch| patch.centroid);
            assert!(centroid.cmpge(min).all() && centroid.cmple(max).all(), "{index}: {centroid}");
        }
    }

    /// A triangle inside the box is itself, and a square corner cut off by a face is a known trapezoid.
    #[test]
    fn simple_clips_have_their_textbook_area_and_centroid() {
        for index in 0..100 {
            let triangle = random_triangle(index);
            let patch = clip_to_box(triangle, -Vec3::ONE, Vec3::ONE).expect("all of it");
            assert_near(patch.area_m2, area(triangle), 1e-6, "whole");
            assert!(patch.centroid.distance(mean(triangle)) < 1e-6);
            assert_eq!(clip_to_box(triangle, Vec3::ONE, 2.0 * Vec3::ONE), None);
        }
        let triangle = [Vec3::ZERO, 2.0 * Vec3::X, 2.0 * Vec3::Y];
        let patch = clip_to_box(triangle, Vec3::new(0.0, 0.0, -1.0), Vec3::new(1.0, 9.0, 1.0));
        // Between x = 0 and 1 under y = 2 − x: area 3/2, ∫ x y = 2/3, ∫ y² / 2 = 7/6.
        let patch = patch.expect("a trapezoid");
        assert_near(patch.area_m2, 1.5, 1e-6, "trapezoid");
        assert!(patch.centroid.distance(Vec3::new(4.0 / 9.0, 7.0 / 9.0, 0.0)) < 1e-6);
    }

    /// The cells of a grid, n along each axis, from −1 to 1; shared faces are the same numbers.
    fn cells(n: u32) -> impl Iterator<Item = (Vec3, Vec3)> {
        let at = move |i: u32| (2.0 * i as f32 - n as f32) / n as f32;
        let corner = move |i: u32, j: u32, k: u32| Vec3::new(at(i), at(j), at(k));
        (0..n * n * n).map(move |cell| {
            let (i, j, k) = (cell % n, cell / n % n, cell / n / n);
            (corner(i, j, k), corner(i + 1, j + 1, k + 1))
        })
    }

    /// Area and first moment of all patches of a grid, times a scale.
    fn patches(triangle: [Vec3; 3], n: u32, scale: f32) -> Vec<Patch> {
        cells(n).filter_map(|(min, max)| clip_to_box(triangle, min * scale, max * scale)).collect()
    }

    /// Areas and first moments over a grid sum to the triangle's own, at every scale.
    #[test]
    fn patches_of_a_grid_sum_to_the_triangle() {
        for scale in [1e-12f32, 1.0, 1e12] {
            for index in 0..100 {
                let triangle = random_triangle(index).map(|p| p * scale);
                let parts = patches(triangle, 1 + index % 7, scale);
                let sum: f32 = parts.iter().map(|patch| patch.area_m2).sum();
                assert_near(sum, area(triangle), 1e-5, "area");
                let moment: Vec3 = parts.iter().map(|patch| patch.centroid * (patch.area_m2 / sum)).sum();
                assert!(moment.distance(mean(triangle)) < 1e-5 * scale, "{index}: {moment}");
            }
        }
    }

    /// Needles a million times longer than wide lose nothing to a grid.
    #[test]
    fn slivers_of_a_grid_sum_to_the_sliver() {
        for index in 0..50 {
            let [a, b, _] = random_triangle(index);
            let triangle = [a, b, a.lerp(b, 0.7) + 1e-6 * in_cube(8, index)];
            let sum: f32 = patches(triangle, 5, 1.0).iter().map(|patch| patch.area_m2).sum();
            assert_near(sum, area(triangle), 1e-5, "sliver");
        }
    }

    /// A triangle in the plane between cells belongs to exactly one of them, on every axis.
    #[test]
    fn a_triangle_between_two_cells_belongs_to_one() {
        for axis in 0..3 {
            for plane in [-0.5, 0.0, 0.5] {
                let mut triangle = random_triangle(axis as u32);
                triangle.iter_mut().for_each(|corner| corner[axis] = plane);
                let in_cell = |(min, max): (Vec3, Vec3)| Some((min[axis], clip_to_box(triangle, min, max)?));
                let parts: Vec<(f32, Patch)> = cells(4).filter_map(in_cell).collect();
                assert!(parts.iter().all(|(low, _)| *low == plane), "the upper cell's");
                let sum: f32 = parts.iter().map(|(_, patch)| patch.area_m2).sum();
                assert_near(sum, area(triangle), 1e-5, "once");
            }
        }
    }

    /// A triangle that only touches a cell, by an edge or by a corner, has no part in it.
    #[test]
    fn touching_is_not_entering() {
        let triangle = [Vec3::ZERO, Vec3::new(-1.0, 0.0, 0.3), Vec3::new(0.0, 1.0, 0.0)];
        assert_eq!(clip_to_box(triangle, Vec3::new(0.0, 0.0, -1.0), Vec3::ONE), None);
        assert_eq!(clip_to_box(triangle, Vec3::new(-1.0, -1.0, -1.0), Vec3::new(1.0, 0.0, 1.0)), None);
        assert_eq!(clip_to_box(triangle, Vec3::new(0.0, -1.0, -1.0), Vec3::new(1.0, 0.0, 1.0)), None);
    }
}
