//! Where the triangles of a crease surface lie: a tree that adds up how much of them lies within a gather.
//!
//! Every node knows the area of its triangles, a sphere around them and a cone around their normals: what lies within the
//! gather and faces its normal as a whole is added as a whole, what lies wholly within is asked only where its parts face, and only
//! triangles at the rim are cut. A surface may be in a space of its own (`shape.rs`), in which metres are the unit of that.

mod facets;
#[cfg(feature = "gpu")]
mod pack;
mod whole;

use glam::Vec3;

pub(in crate::technique) use self::facets::Facets;
#[cfg(feature = "gpu")]
pub(super) use self::pack::PackedExtents;
#[cfg(all(test, feature = "gpu"))]
pub(crate) use self::pack::{GpuExtentNode, GpuFace};
pub(super) use self::whole::{Ball, Whole};
use super::{
    gather::{FLATNESS, GatherBounds, Reach},
    patch,
    shape::Placed,
};

/// Triangles of a leaf at most.
const LEAF_COUNT: usize = 4;

/// Pieces of surface that reach at most so far, in radii of the gather, are not cut at its rim: they count by how far in
/// they lie. There are many of them, some too much and some too little.
pub(super) const SMALL: f32 = 0.1;

/// A triangle as its surface sees it, in the space of the surface: lengths are in its unit.
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
    /// Sum of its triangles' middles times their areas, m³.
    moment_m3: Vec3,
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
        let nodes = Vec::with_capacity(faces.len());
        let mut extent = Extent { faces, nodes };
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
            let parts = [place + 1, second].map(|part| self.nodes[part]);
            self.nodes[place].facets = parts.iter().map(|part| part.facets).sum();
            self.nodes[place].moment_m3 = parts.iter().map(|part| part.moment_m3).sum();
        }
    }

    /// Of all triangles, m².
    pub(super) fn area_m2(&self) -> f32 {
        self.nodes.first().map_or(0.0, |root| root.facets.area_m2)
    }

    /// Around all triangles.
    #[cfg(test)]
    pub(super) fn ball(&self) -> Ball {
        self.nodes.first().map_or(Ball::EMPTY, |root| Ball { middle: root.middle, reach_m: root.reach_m })
    }

    /// All triangles where they are placed.
    pub(super) fn whole(&self, placed: &Placed) -> Whole {
        Whole::of(self.nodes.first(), placed)
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

    /// Parts of so many nodes at most that together are all of it, in order: pieces of work.
    pub(super) fn pieces_of_work(&self, node_count_max: usize) -> Vec<usize> {
        let mut found = Vec::new();
        let mut at = 0;
        while let Some(node) = self.nodes.get(at) {
            let is_piece = node.end as usize - at <= node_count_max || node.count > 0;
            found.extend(is_piece.then_some(at));
            at = if is_piece { node.end as usize } else { at + 1 };
        }
        found
    }

    /// Goes through the triangles of a part: of those that the visitor takes together none alone.
    pub(super) fn visit(&self, part: usize, placed: &Placed, visitor: &mut impl PartVisitor) {
        let end = self.nodes[part].end as usize;
        let mut at = part;
        while at < end {
            let node = &self.nodes[at];
            if visitor.takes(&PlacedPart { node, placed }) {
                at = node.end as usize;
                continue;
            }
            self.faces_of(node).iter().for_each(|face| visitor.triangle(face.triangle));
            at += 1;
        }
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

/// Who looks at the triangles of a surface, together where they lie together.
pub(in crate::technique) trait PartVisitor {
    /// True if the part is taken as a whole.
    fn takes(&mut self, part: &PlacedPart<'_>) -> bool;
    /// A triangle of no part that was taken.
    fn triangle(&mut self, triangle: u32);
}

/// Some triangles of a surface that lie together, render space.
#[derive(Clone, Copy)]
pub(in crate::technique) struct PlacedPart<'a> {
    node: &'a Node,
    placed: &'a Placed,
}

impl PlacedPart<'_> {
    /// Middle and reach, m: all of it lies within, whatever rounding does.
    pub(in crate::technique) fn ball(&self) -> (Vec3, f32) {
        let ball = Ball { middle: self.node.middle, reach_m: self.node.reach_m };
        let Ball { middle, reach_m } = self.placed.ball_to_render(ball);
        (middle, reach_m)
    }

    /// A direction, and how far from it a normal of the part may be, by the chord.
    pub(in crate::technique) fn facing(&self) -> (Vec3, f32) {
        let [cos, _] = self.node.cone;
        // |a − b|² = 2 − 2 cos of the angle between unit vectors; a turn is right to 1e-5.
        (self.placed.direction_to_render(self.node.axis), (2.0 - 2.0 * cos).max(0.0).sqrt() + 1e-4)
    }

    /// Its area, m², and the sums of its triangles' middles and of their normals times their areas.
    pub(in crate::technique) fn sums(&self) -> (f32, [Vec3; 2]) {
        let facets = self.placed.facets_to_render(self.node.facets);
        let moment = self.placed.moment_to_render(self.node.moment_m3, self.node.facets.area_m2);
        (facets.area_m2, [moment, facets.facing_m2])
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
            moment_m3: faces.iter().map(|face| face.middle * face.area_m2).sum(),
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
        facing_of(self.axis, self.cone, normal, facing_cos)
    }
}

/// Which normals of a cone face a direction, within a cosine of it.
///
/// - `cos`, `sin`: of its half angle
#[inline]
fn facing_of(axis: Vec3, [cos, sin]: [f32; 2], normal: Vec3, facing_cos: f32) -> Facing {
    let axis_cos = axis.dot(normal).clamp(-1.0, 1.0);
    let across = (1.0 - axis_cos * axis_cos).sqrt() * sin;
    if facing_cos <= -1.0 || (axis_cos >= -cos && axis_cos * cos - across >= facing_cos) {
        Facing::All
    } else if axis_cos < cos && axis_cos * cos + across < facing_cos {
        Facing::None
    } else {
        Facing::Some
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

    /// As much of it as counts in a gather: of most that are looked at nothing.
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

    /// Area of it in the ellipsoid and before the walls, m².
    ///
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
mod tests;
