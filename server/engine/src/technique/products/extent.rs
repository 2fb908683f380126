//! Where the triangles of a crease surface lie: a tree that adds up how much of them lies within a gather.
//!
//! Every node knows the area of its triangles, a sphere around them and a cone around their normals: what lies within the
//! gather and faces its normal as a whole is added as a whole, and only triangles at the rim are cut.

#[cfg(feature = "gpu")]
mod pack;

use glam::Vec3;

#[cfg(feature = "gpu")]
pub(super) use self::pack::PackedExtents;
#[cfg(all(test, feature = "gpu"))]
pub(crate) use self::pack::{GpuExtentNode, GpuFace};
use super::{
    gather::{FLATNESS, GatherBounds, Reach},
    patch,
};

/// Some piece of surface, as light from afar sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::technique) struct Facets {
    /// Its area, m².
    pub(in crate::technique) area_m2: f32,
    /// Sum of its parts' normals times their areas, m².
    pub(super) facing_m2: Vec3,
    /// Sum of the squares of its parts' normals times their areas, by axis, m² …
    squares_m2: Vec3,
    /// … and of their products, xy, yz and zx, m².
    products_m2: Vec3,
}

impl Facets {
    /// The same piece from its other side.
    pub(super) fn turned(self) -> Facets {
        Facets { facing_m2: -self.facing_m2, ..self }
    }

    fn share(self, share: f32) -> Facets {
        Facets {
            area_m2: self.area_m2 * share,
            facing_m2: self.facing_m2 * share,
            squares_m2: self.squares_m2 * share,
            products_m2: self.products_m2 * share,
        }
    }

    /// Mean over the piece of the cosine with which light from the unit direction `wi` meets it, 0 on what faces away from it.
    ///
    /// Cosines are taken to lie evenly around their mean, as far as their variance says. Exact where all face one way and, to
    /// rounding, where all face the light well; within 0.05 for balls, columns and edges, 0.2 for both sides of a sheet together.
    #[inline]
    pub(super) fn mean_cos(&self, wi: Vec3) -> f32 {
        let per_m2 = 1.0 / self.area_m2;
        let mean = wi.dot(self.facing_m2) * per_m2;
        let crossed = Vec3::new(wi.x * wi.y, wi.y * wi.z, wi.z * wi.x);
        let square = ((wi * wi).dot(self.squares_m2) + 2.0 * crossed.dot(self.products_m2)) * per_m2;
        let reach = (3.0 * (square - mean * mean)).max(0.0).sqrt();
        let above = mean + reach;
        // Without branches, so that the compiler asks for four directions at a time.
        let some = above * above / (4.0 * reach);
        let of_some = if above > 0.0 { some } else { 0.0 };
        if mean >= reach { mean } else { of_some }
    }

    /// Area of one normal.
    fn flat(area_m2: f32, n: Vec3) -> Facets {
        Facets {
            area_m2,
            facing_m2: n * area_m2,
            squares_m2: n * n * area_m2,
            products_m2: Vec3::new(n.x * n.y, n.y * n.z, n.z * n.x) * area_m2,
        }
    }
}

impl std::ops::AddAssign for Facets {
    fn add_assign(&mut self, other: Facets) {
        self.area_m2 += other.area_m2;
        self.facing_m2 += other.facing_m2;
        self.squares_m2 += other.squares_m2;
        self.products_m2 += other.products_m2;
    }
}

impl std::iter::Sum for Facets {
    fn sum<I: Iterator<Item = Facets>>(pieces: I) -> Facets {
        let mut sum = Facets::default();
        pieces.for_each(|piece| sum += piece);
        sum
    }
}

/// Triangles of a leaf at most.
const LEAF_COUNT: usize = 4;

/// Pieces of surface that reach at most so far, in radii of the gather, are not cut at its rim: they count by how far in
/// they lie. There are many of them, some too much and some too little.
pub(super) const SMALL: f32 = 0.1;

/// A triangle as its surface sees it, in render space.
#[derive(Clone, Copy, Debug)]
struct Face {
    triangle: u32,
    area_m2: f32,
    /// Of its front, unit.
    normal: Vec3,
    middle: Vec3,
    /// Farthest corner from its middle, m.
    reach_m: f32,
}

/// Some triangles that lie together; those behind it in depth-first order, up to `end`, are its parts.
#[derive(Clone, Copy, Debug)]
struct Node {
    facets: Facets,
    middle: Vec3,
    /// No corner lies farther from the middle, m.
    reach_m: f32,
    /// Axis of the cone that holds all normals.
    axis: Vec3,
    /// Cosine and sine of its half angle.
    cone: [f32; 2],
    end: u32,
    /// Its triangles, in [`Extent::faces`]; none for one that has parts.
    first: u32,
    count: u32,
}

/// The triangles of a surface; see the module's head.
#[derive(Debug)]
pub(super) struct Extent {
    faces: Vec<Face>,
    nodes: Vec<Node>,
}

impl Extent {
    /// Of triangles by number, with their corners: `[n]`; those without area do not count.
    pub(super) fn of(triangles: &[u32], corners: impl Fn(u32) -> [Vec3; 3], handedness: f32) -> Extent {
        let faces: Vec<Face> = triangles
            .iter()
            .map(|triangle| Face::of(*triangle, corners(*triangle), handedness))
            .filter(|face| face.normal != Vec3::ZERO)
            .collect();
        let mut extent = Extent { nodes: Vec::with_capacity(faces.len()), faces };
        if !extent.faces.is_empty() {
            extent.divide(0, extent.faces.len());
        }
        extent
    }

    /// Adds the node of some triangles and all its parts.
    fn divide(&mut self, first: usize, end: usize) {
        let place = self.nodes.len();
        self.nodes.push(Node::around(&self.faces[first..end]));
        if end - first <= LEAF_COUNT {
            self.nodes[place].first = first as u32;
            self.nodes[place].count = (end - first) as u32;
        } else {
            let faces = &mut self.faces[first..end];
            let [low, high] = faces.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], face| {
                [low.min(face.middle), high.max(face.middle)]
            });
            let axis = (high - low).max_position();
            let half = faces.len() / 2;
            faces.select_nth_unstable_by(half, |a, b| {
                a.middle[axis].total_cmp(&b.middle[axis]).then(a.triangle.cmp(&b.triangle))
            });
            self.divide(first, first + half);
            self.divide(first + half, end);
        }
        let end = self.nodes.len();
        self.nodes[place].end = end as u32;
        if self.nodes[place].count == 0 {
            // Part by part: a million small numbers added to a large one would lose a percent.
            let second = self.nodes[place + 1].end as usize;
            self.nodes[place].facets =
                [place + 1, second].map(|part| self.nodes[part].facets).into_iter().sum();
        }
    }

    /// Of all triangles, m².
    pub(super) fn area_m2(&self) -> f32 {
        self.nodes.first().map_or(0.0, |root| root.facets.area_m2)
    }

    /// What faces the gather's normal, within a cosine of it, in the ellipsoid around its middle.
    pub(super) fn within(
        &self,
        bounds: &GatherBounds,
        reach: Reach,
        corners: impl Fn(u32) -> [Vec3; 3],
    ) -> Facets {
        let Reach { radius_m, facing_cos } = reach;
        // Single pieces of a surface of few are cut exactly: photons are counted exactly as well.
        let small_m2 = SMALL * SMALL * self.area_m2();
        let mut sum = Facets::default();
        let mut at = 0;
        while let Some(node) = self.nodes.get(at) {
            let place = at;
            at = node.end as usize;
            // Most are too far away: that is asked first, and what costs more later.
            let from_middle = node.middle - bounds.centre;
            if from_middle.length_squared() >= (radius_m + node.reach_m).powi(2) {
                continue;
            }
            let flattened_m = bounds.flattened_from(node.middle).length();
            // What leans reaches farther in the flattened space, at most so many times.
            let reach_m = FLATNESS * node.reach_m;
            if flattened_m >= radius_m + reach_m {
                continue;
            }
            let facing = node.facing(bounds.normal, facing_cos);
            if facing == Facing::None {
                continue;
            }
            let behind_m = bounds.walls.behind_m(from_middle);
            if behind_m >= node.reach_m {
                continue;
            }
            let is_before_walls = behind_m <= -node.reach_m;
            let is_small = node.reach_m <= SMALL * radius_m && node.facets.area_m2 <= small_m2;
            if is_before_walls && flattened_m + reach_m <= radius_m {
                sum += self.facets_facing(place, bounds.normal, facing_cos);
            } else if is_before_walls && is_small && facing == Facing::All {
                sum += node.facets.share(share_within(radius_m - flattened_m, node.reach_m));
            } else {
                if node.count > 0 {
                    let part = |face: &Face| face.facets_within(bounds, reach, small_m2, &corners);
                    sum += self.faces_of(node).iter().map(part).sum();
                }
                at = place + 1;
            }
        }
        sum
    }

    /// What faces a direction, within a cosine of it, of a node that lies wholly within reach: where its parts lie is not asked.
    fn facets_facing(&self, place: usize, normal: Vec3, facing_cos: f32) -> Facets {
        let mut sum = Facets::default();
        let end = self.nodes[place].end as usize;
        let mut at = place;
        while at < end {
            let node = &self.nodes[at];
            at = match node.facing(normal, facing_cos) {
                Facing::All => {
                    sum += node.facets;
                    node.end as usize
                }
                Facing::None => node.end as usize,
                Facing::Some => {
                    let is_facing = |face: &&Face| face.normal.dot(normal) >= facing_cos;
                    let facing = self.faces_of(node).iter().filter(is_facing);
                    facing.for_each(|face| sum += face.facets(face.area_m2));
                    at + 1
                }
            };
        }
        sum
    }

    /// Its own triangles.
    fn faces_of(&self, node: &Node) -> &[Face] {
        &self.faces[node.first as usize..(node.first + node.count) as usize]
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        self.faces.len() * size_of::<Face>() + self.nodes.len() * size_of::<Node>()
    }
}

/// About how much of a piece lies within that has its middle so far inside the rim, in [0, 1].
fn share_within(inside_m: f32, reach_m: f32) -> f32 {
    (0.5 + 0.5 * inside_m / reach_m.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// Which of the normals of a node face a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Facing {
    None,
    Some,
    All,
}

impl Node {
    fn around(faces: &[Face]) -> Node {
        let count = faces.len() as f32;
        let middle: Vec3 = faces.iter().map(|face| face.middle / count).sum();
        let axis = faces.iter().map(|face| face.normal).sum::<Vec3>().normalize_or(Vec3::Z);
        let cos = faces.iter().map(|face| face.normal.dot(axis)).fold(1.0, f32::min);
        // Rounding may put a normal a little outside.
        let cos = (cos - 1e-5).max(-1.0);
        let reach = |face: &Face| face.middle.distance(middle) + face.reach_m;
        Node {
            facets: faces.iter().map(|face| face.facets(face.area_m2)).sum(),
            middle,
            reach_m: faces.iter().map(reach).fold(0.0, f32::max) * 1.0001,
            axis,
            cone: [cos, (1.0 - cos * cos).max(0.0).sqrt()],
            end: 0,
            first: 0,
            count: 0,
        }
    }

    fn facing(&self, normal: Vec3, facing_cos: f32) -> Facing {
        let [cos, sin] = self.cone;
        let axis_cos = self.axis.dot(normal).clamp(-1.0, 1.0);
        let across = (1.0 - axis_cos * axis_cos).sqrt() * sin;
        if facing_cos <= -1.0 || (axis_cos >= -cos && axis_cos * cos - across >= facing_cos) {
            Facing::All
        } else if axis_cos < cos && axis_cos * cos + across < facing_cos {
            Facing::None
        } else {
            Facing::Some
        }
    }
}

impl Face {
    fn of(triangle: u32, [a, b, c]: [Vec3; 3], handedness: f32) -> Face {
        // A mirroring transform turns the winding round, not the front.
        let n = (b - a).cross(c - a) * handedness;
        let middle = (a + b + c) / 3.0;
        let reach_m = a.distance(middle).max(b.distance(middle)).max(c.distance(middle));
        Face { triangle, area_m2: 0.5 * n.length(), normal: n.normalize_or_zero(), middle, reach_m }
    }

    /// So much of it.
    fn facets(&self, area_m2: f32) -> Facets {
        Facets::flat(area_m2, self.normal)
    }

    /// What of it counts, none of most that are looked at.
    fn facets_within(
        &self,
        bounds: &GatherBounds,
        reach: Reach,
        small_m2: f32,
        corners: &impl Fn(u32) -> [Vec3; 3],
    ) -> Facets {
        let is_far =
            (self.middle - bounds.centre).length_squared() >= (reach.radius_m + self.reach_m).powi(2);
        let cos = self.normal.dot(bounds.normal);
        if is_far || cos < reach.facing_cos {
            return Facets::default();
        }
        let is_small = self.reach_m <= SMALL * reach.radius_m && self.area_m2 <= small_m2;
        self.facets(self.area_within(bounds, reach.radius_m, cos, is_small, corners))
    }

    /// - `cos`: of its normal with the gather's
    fn area_within(
        &self,
        bounds: &GatherBounds,
        radius_m: f32,
        cos: f32,
        is_small: bool,
        corners: &impl Fn(u32) -> [Vec3; 3],
    ) -> f32 {
        // The more a triangle leans, the more flattening makes it reach farther.
        let stretched2 = 1.0 + (FLATNESS * FLATNESS - 1.0) * (1.0 - cos * cos).max(0.0);
        let reach_m = self.reach_m * stretched2.sqrt();
        let distance_m = bounds.flattened_from(self.middle).length();
        let behind_m = bounds.walls.behind_m(self.middle - bounds.centre);
        if distance_m >= radius_m + reach_m || behind_m >= self.reach_m {
            0.0
        } else if behind_m > -self.reach_m {
            if is_small {
                let share = share_within(radius_m - distance_m, self.reach_m);
                self.area_m2 * share * share_within(-behind_m, self.reach_m)
            } else {
                self.area_before_walls(bounds, radius_m, corners)
            }
        } else if distance_m + reach_m <= radius_m {
            self.area_m2
        } else if is_small {
            self.area_m2 * share_within(radius_m - distance_m, self.reach_m)
        } else {
            // Flattening stretches all parts of a triangle alike.
            let flattened = corners(self.triangle).map(|corner| bounds.flattened_from(corner));
            let [a, b, c] = flattened;
            let part_m2 = patch::area_in_sphere(flattened, Vec3::ZERO, radius_m);
            let whole_m2 = 0.5 * (b - a).cross(c - a).length();
            if part_m2 > 0.0 { self.area_m2 * (part_m2 / whole_m2).min(1.0) } else { 0.0 }
        }
    }

    /// Cut by the gather's rim and by its walls.
    fn area_before_walls(
        &self,
        bounds: &GatherBounds,
        radius_m: f32,
        corners: &impl Fn(u32) -> [Vec3; 3],
    ) -> f32 {
        let corners = corners(self.triangle);
        let [a, b, c] = corners.map(|corner| bounds.flattened_from(corner));
        let whole_m2 = 0.5 * (b - a).cross(c - a).length();
        let mut polygon = corners.map(|corner| corner - bounds.centre).to_vec();
        bounds.walls.cut(&mut polygon);
        let flattened: Vec<Vec3> =
            polygon.into_iter().map(|corner| bounds.flattened_from(bounds.centre + corner)).collect();
        let part_m2: f32 = (2..flattened.len())
            .map(|last| {
                let part = [flattened[0], flattened[last - 1], flattened[last]];
                patch::area_in_sphere(part, Vec3::ZERO, radius_m)
            })
            .sum();
        if part_m2 > 0.0 { self.area_m2 * (part_m2 / whole_m2).min(1.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;
    use crate::{math::sobol::point, technique::products::walls::Walls};

    /// A crumpled sheet of 2 × 2 m, in strips of triangles of very different sizes.
    fn crumpled() -> Vec<[Vec3; 3]> {
        let height = |x: f32, z: f32| 0.2 * (5.0 * x).sin() * (3.0 * z).cos();
        let at = |i: usize, n: usize| (i as f32 / n as f32).powi(2) * 2.0 - 1.0;
        let vertex = |i: usize, j: usize| {
            let (x, z) = (at(i, 40), at(j, 25));
            Vec3::new(x, height(x, z), z)
        };
        let quads = (0..40).flat_map(|i| (0..25).map(move |j| (i, j)));
        quads
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1), vertex(i + 1, j)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    fn bounds(centre: Vec3, normal: Vec3) -> GatherBounds {
        let count = NonZeroUsize::MIN;
        GatherBounds {
            centre,
            normal,
            radius_m: 1.0,
            count_min: count,
            count_max: count,
            radius_max_m: 1.0,
            count_narrow: count,
            walls: Walls::default(),
        }
    }

    /// The tree says what going through the triangles one by one says, and that is the share of points that lie within.
    #[test]
    fn areas_are_those_of_all_triangles_and_of_counted_points() {
        let sheet = crumpled();
        let all: Vec<u32> = (0..sheet.len() as u32).collect();
        let corners = |triangle: u32| sheet[triangle as usize];
        let extent = Extent::of(&all, corners, 1.0);
        for index in 0..200 {
            let [x, z, r, turn] = point(3, index);
            let centre = Vec3::new(2.0 * x - 1.0, 0.1, 2.0 * z - 1.0);
            let normal = Vec3::new((6.0 * turn).sin() * r, 1.0, (6.0 * turn).cos() * r).normalize();
            let radius_m = 0.02 + 1.5 * r * r;
            let facing_cos = if index % 3 == 0 { -2.0 } else { 0.5 + 0.4 * turn };
            let bounds = bounds(centre, normal);
            let reach = Reach { radius_m, facing_cos };
            let found = extent.within(&bounds, reach, corners).area_m2;
            let exactly = |face: &Face| {
                let cos = face.normal.dot(normal);
                let area_m2 = || face.area_within(&bounds, radius_m, cos, false, &corners);
                if cos >= facing_cos { area_m2() } else { 0.0 }
            };
            let one_by_one: f32 = extent.faces.iter().map(exactly).sum();
            // Small pieces at the rim may be whole nodes or single triangles.
            assert!(
                (found - one_by_one).abs() <= 0.02 * one_by_one + 2e-3 * radius_m * radius_m,
                "{found} for {one_by_one}"
            );
            if index % 10 == 0 && one_by_one > 0.05 {
                let counted = counted_m2(&extent, &bounds, radius_m, facing_cos, corners);
                assert!((found / counted - 1.0).abs() < 0.03, "{found} for {counted}");
            }
        }
    }

    /// Of a sheet that lies wholly within reach counts what faces the gather, exactly, with its directions.
    #[test]
    fn what_lies_wholly_within_counts_as_far_as_it_faces() {
        let sheet = crumpled();
        let all: Vec<u32> = (0..sheet.len() as u32).collect();
        let corners = |triangle: u32| sheet[triangle as usize];
        let extent = Extent::of(&all, corners, 1.0);
        for index in 0..50 {
            let [x, z, lean, turn] = point(5, index);
            let normal = Vec3::new((6.0 * turn).sin() * lean, 1.0, (6.0 * turn).cos() * lean).normalize();
            for facing_cos in [-2.0, 0.5, 0.79, 0.9] {
                let reach = Reach { radius_m: 12.0, facing_cos };
                let found = extent.within(&bounds(Vec3::new(x, 0.0, z), normal), reach, corners);
                let facing = extent.faces.iter().filter(|face| face.normal.dot(normal) >= facing_cos);
                let expected: Facets = facing.map(|face| face.facets(face.area_m2)).sum();
                assert!((found.area_m2 - expected.area_m2).abs() < 1e-4, "{found:?} for {expected:?}");
                for (found, expected) in [
                    (found.facing_m2, expected.facing_m2),
                    (found.squares_m2, expected.squares_m2),
                    (found.products_m2, expected.products_m2),
                ] {
                    assert!((found - expected).abs().max_element() < 1e-4, "{found} for {expected}");
                }
            }
        }
    }

    /// Before walls lies the share of points that lie there.
    #[test]
    fn walls_part_areas() {
        let sheet = crumpled();
        let all: Vec<u32> = (0..sheet.len() as u32).collect();
        let corners = |triangle: u32| sheet[triangle as usize];
        let extent = Extent::of(&all, corners, 1.0);
        let mut parted = 0;
        for index in 0..100 {
            let [x, z, angle, far] = point(4, index);
            let without = bounds(Vec3::new(x - 0.5, 0.0, z - 0.5), Vec3::Y);
            let (sin, cos) = (std::f32::consts::TAU * angle).sin_cos();
            let [first, second] = [Vec3::new(cos, 0.0, sin), Vec3::new(-sin, 0.0, cos)];
            let walls = Walls::at([(first, 0.6 * far * far), (second, 0.4 + far)]);
            let bounds = GatherBounds { walls, ..without };
            let reach = Reach { radius_m: 0.3 + far, facing_cos: -2.0 };
            let before_m2 = extent.within(&bounds, reach, corners).area_m2;
            let all_m2 = extent.within(&without, reach, corners).area_m2;
            let counted = counted_m2(&extent, &bounds, reach.radius_m, reach.facing_cos, corners);
            assert!((before_m2 - counted).abs() <= 0.03 * all_m2, "{before_m2} for {counted} of {all_m2}");
            parted += u32::from(before_m2 < 0.9 * all_m2);
        }
        assert!(parted > 30, "{parted}");
    }

    fn counted_m2(
        extent: &Extent,
        bounds: &GatherBounds,
        radius_m: f32,
        facing_cos: f32,
        corners: impl Fn(u32) -> [Vec3; 3],
    ) -> f32 {
        let of_face = |face: &Face| {
            let [a, b, c] = corners(face.triangle);
            let is_within = |index: &u32| {
                let [u, v, ..] = point(u64::from(face.triangle), *index);
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let from = a + (b - a) * u + (c - a) * v - bounds.centre;
                let along = bounds.normal.dot(from);
                let across = from - bounds.normal * along;
                let is_before = bounds.walls.behind_m(from) <= 0.0;
                is_before && across.length_squared() + (along * FLATNESS).powi(2) <= radius_m * radius_m
            };
            let share = (0..64).filter(is_within).count() as f32 / 64.0;
            if face.normal.dot(bounds.normal) >= facing_cos { face.area_m2 * share } else { 0.0 }
        };
        extent.faces.iter().map(of_face).sum()
    }

    /// The mean cosine is that of the parts, one by one: of a plane, caps of balls, arcs of columns, edges, whole balls and sheets.
    #[test]
    fn mean_cosines_are_those_of_the_parts() {
        let cap = |angle: f32| -> Vec<Vec3> {
            let normal = |index: u32| {
                let [u, v, ..] = point(7, index);
                let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
                // Evenly over a cap: the height is.
                let y = 1.0 - v * (1.0 - angle.cos());
                let across = (1.0 - y * y).max(0.0).sqrt();
                Vec3::new(across * cos, y, across * sin)
            };
            (0..1024).map(normal).collect()
        };
        let arc = |angle: f32| -> Vec<Vec3> {
            let turns = (0..1024).map(|index| angle * ((2 * index + 1) as f32 / 1024.0 - 1.0));
            turns.map(|turn| Vec3::new(turn.sin(), turn.cos(), 0.0)).collect()
        };
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let edge = vec![Vec3::new(half, half, 0.0), Vec3::new(-half, half, 0.0)];
        let pieces = [
            (cap(0.0), 1e-3),
            (cap(0.3), 0.01),
            (cap(0.7), 0.02),
            (cap(1.0), 0.03),
            (cap(std::f32::consts::PI), 0.01),
            (arc(0.66), 0.03),
            (arc(1.05), 0.04),
            (edge, 0.05),
            (vec![Vec3::Y, -Vec3::Y], 0.2),
        ];
        for (piece, (normals, tolerance)) in pieces.into_iter().enumerate() {
            let facets: Facets = normals.iter().map(|normal| Facets::flat(2.0, *normal)).sum();
            for index in 0..500 {
                let [u, v, ..] = point(8, index);
                let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
                let y = 2.0 * v - 1.0;
                let across = (1.0 - y * y).sqrt();
                let wi = Vec3::new(across * cos, y, across * sin);
                let count = normals.len() as f32;
                let mean = normals.iter().map(|normal| normal.dot(wi).max(0.0)).sum::<f32>() / count;
                let found = facets.mean_cos(wi);
                assert!((found - mean).abs() < tolerance, "{piece}, {wi}: {found}, not {mean}");
            }
        }
    }

    /// A surface far smaller than the gather is cut at its rim like a large one: its photons are counted one by one.
    #[test]
    fn small_surfaces_at_the_rim_are_cut() {
        let at = |angle: f32| Vec3::new(angle.cos(), 0.0, -angle.sin());
        let third = std::f32::consts::TAU / 3.0;
        let sheet = [[at(0.0), at(third), at(2.0 * third)]];
        let corners = |triangle: u32| sheet[triangle as usize];
        let extent = Extent::of(&[0], corners, 1.0);
        for inside_m in [-0.9, -0.5, 0.0, 0.3] {
            let bounds = bounds(Vec3::new(-40.0 + inside_m, 0.0, 0.0), Vec3::Y);
            let found = extent.within(&bounds, Reach { radius_m: 40.0, facing_cos: 0.5 }, corners).area_m2;
            // The rim is next to straight: what lies left of x = inside_m.
            let right: f32 = (1.0 - inside_m).powi(2) / 3f32.sqrt();
            let left = if inside_m <= -0.5 { 0.0 } else { 0.75 * 3f32.sqrt() - right };
            assert!((found - left).abs() < 0.02, "{inside_m}: {found} for {left}");
        }
    }

    /// Triangles without area, and none at all, have none.
    #[test]
    fn nothing_has_no_area() {
        let corners = |_| [Vec3::ONE; 3];
        for triangles in [&[][..], &[0, 1, 2, 3, 4, 5][..]] {
            let extent = Extent::of(triangles, corners, 1.0);
            let reach = Reach { radius_m: 3.0, facing_cos: -2.0 };
            assert_eq!(extent.within(&bounds(Vec3::ZERO, Vec3::Y), reach, corners), Facets::default());
            assert_eq!(extent.area_m2(), 0.0);
        }
    }
}
