//! A tree over lights that finds, for a shaded point, a light in proportion to what it may contribute.
//!
//! Each node bounds its lights' positions, emission cone and intensity; the walk goes down by the ratio of the children's importance,
//! intensity · cosines / distance² [ContyEstevez2018; pbrt4, 12.6.3], until few lights are left. Those are compared one by one, by a power
//! below one of their importance, which knows no shadows. Intensity is what a light sends into its own directions, not its power, since by
//! that narrow spots are chosen too seldom, as many times as their cone is smaller than a lamp's (three lights and a panel: 9.9 % error of
//! direct light with 64 samples by power, 4.3 by intensity). The distance is floored by the node's own radius (not by a length, as in pbrt),
//! so that scaling a scene changes nothing.

use glam::Vec3;

use super::bounds::LightBounds;
use crate::accel::Ray;

#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub(super) bounds: LightBounds,
    /// Inner: index of the second child (the first follows at once). Leaf: index of the light.
    pub(super) next: u32,
    /// One past the last node below this one: all of them follow it at once.
    pub(super) end: u32,
    pub(super) is_leaf: bool,
}

/// The tree. Light indices are the caller's.
#[derive(Debug, Default)]
pub(super) struct LightTree {
    pub(super) nodes: Vec<Node>,
    /// Way to each light from the root: bit k is the turn at depth k, 1 = second child.
    pub(super) trails: Vec<u64>,
}

/// Depth below which splits halve the lights: 2⁻²⁴ of two billion lights leaves fewer than 40 levels more.
const MEDIAN_DEPTH: u32 = 24;
const BUCKETS: usize = 12;
/// Nodes that a ray is asked of before it is traced anyway.
const VISITS_MAX: usize = 64;
/// Second children that wait while a ray goes through the first ones, at most.
const STACK: usize = 64;
/// Share of a box by which it is widened, …
const WIDER_BOX: f32 = 1e-4;
/// … and share of how far from the middle of the scene it or the ray lies.
const WIDER_PLACE: f32 = 1e-6;

/// As many lights below a node, or fewer, are compared one by one: bounds around lights that face apart tell little, and a box lamp has
/// twelve triangles.
pub(crate) const FEW: usize = 16;

/// Lights of one place with the weights that a point chooses among them by.
struct Few {
    weights: [(u32, f32); FEW],
    count: usize,
    sum: f32,
}

impl LightTree {
    /// A tree over `(light index, bounds)`; lights that send nothing are not part of it.
    pub(super) fn build(mut lights: Vec<(u32, LightBounds)>) -> LightTree {
        lights.retain(|(_, bounds)| bounds.intensity > 0.0);
        let light_count = lights.iter().map(|(index, _)| *index as usize + 1).max().unwrap_or(0);
        let mut tree = LightTree { nodes: Vec::new(), trails: vec![0; light_count] };
        if !lights.is_empty() {
            tree.build_node(&mut lights, 0, 0);
        }
        tree
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    pub(super) fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.trails.len() * 8
    }

    fn build_node(&mut self, lights: &mut [(u32, LightBounds)], trail: u64, depth: u32) -> LightBounds {
        let at = self.nodes.len();
        if let [(light, bounds)] = lights {
            self.trails[*light as usize] = trail;
            self.nodes.push(Node { bounds: *bounds, next: *light, end: at as u32 + 1, is_leaf: true });
            return *bounds;
        }
        let middle = split(lights, depth);
        // A place is held for the parent, whose first child follows at once.
        self.nodes.push(Node { bounds: lights[0].1, next: 0, end: 0, is_leaf: false });
        let (first, second) = lights.split_at_mut(middle);
        let left = self.build_node(first, trail, depth + 1);
        let next = self.nodes.len() as u32;
        let right = self.build_node(second, trail | 1 << depth, depth + 1);
        let bounds = left.union(&right);
        self.nodes[at] = Node { bounds, next, end: self.nodes.len() as u32, is_leaf: false };
        bounds
    }

    /// A light for the point `p` facing `n`, and its probability. `None`: no light can reach it.
    pub(super) fn sample(&self, p: Vec3, n: Vec3, mut u: f32) -> Option<(u32, f32)> {
        let mut at = 0;
        let mut probability = 1.0;
        while !self.is_few(self.nodes.get(at)?, at) {
            let [first, second] = self.child_chances(at, p, n)?;
            if u < first {
                u = (u / first).min(1.0 - f32::EPSILON);
                probability *= first;
                at += 1;
            } else {
                u = ((u - first) / second).min(1.0 - f32::EPSILON);
                probability *= second;
                at = self.nodes[at].next as usize;
            }
        }
        let few = self.few(at, p, n);
        let mut left = u * few.sum;
        let mut chosen = None;
        for (light, weight) in few.weights.into_iter().take(few.count).filter(|(_, weight)| *weight > 0.0) {
            // Rounding may leave something over after the last.
            chosen = Some((light, weight));
            if left < weight {
                break;
            }
            left -= weight;
        }
        let (light, weight) = chosen?;
        let probability = probability * (weight / few.sum);
        (probability > 0.0).then_some((light, probability))
    }

    /// True where so few lights lie below a node that all are compared.
    fn is_few(&self, node: &Node, at: usize) -> bool {
        (node.end as usize - at) < 2 * FEW
    }

    /// The few lights below a node, compared.
    ///
    /// Importance says nothing of shadows: where the light that is most important stands behind something, those that are weaker by it have
    /// all the light and few of the samples. A power below one takes some from the first for them (a spot, a lamp and a panel: 4.2 % error of
    /// direct light with 64 samples, 6.4 by importance itself). It is taken of ratios, so that twice the light is chosen by the same numbers.
    fn few(&self, at: usize, p: Vec3, n: Vec3) -> Few {
        let mut few = Few { weights: [(0, 0.0); FEW], count: 0, sum: 0.0 };
        let mut largest = 0f32;
        let leaves = self.nodes[at..self.nodes[at].end as usize].iter().filter(|node| node.is_leaf);
        for (place, leaf) in few.weights.iter_mut().zip(leaves) {
            let importance = leaf.bounds.importance(p, n);
            *place = (leaf.next, importance);
            largest = largest.max(importance);
            few.count += 1;
        }
        if largest > 0.0 {
            for (_, weight) in &mut few.weights[..few.count] {
                let root = (*weight / largest).sqrt();
                *weight = root * root.sqrt();
                few.sum += *weight;
            }
        }
        few
    }

    /// False when the ray passes by the boxes of all lights.
    ///
    /// - `slack_m`: by what transforms may move hits; boxes are widened by that and by more than rounding does
    pub(super) fn may_meet(&self, ray: &Ray, slack_m: f32) -> bool {
        let inverse = ray.direction.recip();
        let passes_by = |bounds: &LightBounds| {
            let room = slack_m
                + WIDER_BOX * (bounds.max - bounds.min).max_element()
                + WIDER_PLACE * bounds.min.abs().max(bounds.max.abs()).max(ray.origin.abs()).max_element();
            let [t0, t1] =
                [bounds.min - room, bounds.max + room].map(|corner| (corner - ray.origin) * inverse);
            // Room keeps the ray off the planes of faces, where 0 · ∞ would be no number.
            let (near, far) = (t0.min(t1).max_element(), t0.max(t1).min_element());
            near > far || far < 0.0
        };
        let mut waiting = [0u32; STACK];
        let mut count = 0;
        let mut at = 0;
        for _ in 0..VISITS_MAX {
            let Some(node) = self.nodes.get(at) else { return false };
            if !passes_by(&node.bounds) {
                // Deeper than any tree of so many lights: better a ray too many.
                if node.is_leaf || count == STACK {
                    return true;
                }
                waiting[count] = node.next;
                count += 1;
                at += 1;
                continue;
            }
            if count == 0 {
                return false;
            }
            count -= 1;
            at = waiting[count] as usize;
        }
        // Among so many lights the ray itself is cheaper.
        true
    }

    /// Probability with which [`LightTree::sample`] returns `light`.
    pub(super) fn probability(&self, p: Vec3, n: Vec3, light: u32) -> f32 {
        let Some(mut trail) = self.trails.get(light as usize).copied() else { return 0.0 };
        let mut at = 0;
        let mut probability = 1.0;
        while self.nodes.get(at).is_some_and(|node| !self.is_few(node, at)) {
            let Some(chances) = self.child_chances(at, p, n) else { return 0.0 };
            let turn = (trail & 1) as usize;
            probability *= chances[turn];
            at = if turn == 0 { at + 1 } else { self.nodes[at].next as usize };
            trail >>= 1;
        }
        let few = self.few(at, p, n);
        let own = few.weights[..few.count].iter().find(|(other, _)| *other == light);
        own.filter(|(_, weight)| *weight > 0.0).map_or(0.0, |(_, weight)| probability * (weight / few.sum))
    }

    fn child_chances(&self, at: usize, p: Vec3, n: Vec3) -> Option<[f32; 2]> {
        let first = self.nodes[at + 1].bounds.importance(p, n);
        let second = self.nodes[self.nodes[at].next as usize].bounds.importance(p, n);
        let sum = first + second;
        if !(sum > 0.0) {
            return None;
        }
        Some([first / sum, second / sum])
    }
}

/// Reorders `lights` and returns where to cut: the cheapest of twelve cuts along each axis.
fn split(lights: &mut [(u32, LightBounds)], depth: u32) -> usize {
    let (low, high) = lights.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), (_, bounds)| {
        (low.min(bounds.centre()), high.max(bounds.centre()))
    });
    let extent = high - low;
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in 0..3 {
        if !(extent[axis] > 0.0) || depth >= MEDIAN_DEPTH {
            continue;
        }
        let mut buckets: [Option<LightBounds>; BUCKETS] = [None; BUCKETS];
        for (_, bounds) in lights.iter() {
            let bucket = &mut buckets[bucket_of(bounds, axis, low, extent)];
            *bucket = Some(bucket.map_or(*bounds, |sum| sum.union(bounds)));
        }
        let stretch = extent.max_element() / extent[axis];
        let left_cost = costs_so_far(buckets.iter(), stretch);
        let right_cost = costs_so_far(buckets.iter().rev(), stretch);
        for cut in 1..BUCKETS {
            let (Some(left), Some(right)) = (left_cost[cut - 1], right_cost[BUCKETS - 1 - cut]) else {
                continue;
            };
            let cost = left + right;
            if best.is_none_or(|(lowest, ..)| cost < lowest) {
                best = Some((cost, axis, cut));
            }
        }
    }
    match best {
        Some((_, axis, cut)) => {
            // A stable order keeps the tree the same on every machine.
            lights.sort_by_key(|(_, bounds)| bucket_of(bounds, axis, low, extent) >= cut);
            lights.partition_point(|(_, bounds)| bucket_of(bounds, axis, low, extent) < cut)
        }
        None => lights.len() / 2,
    }
}

/// Cost of the lights of the first 1, 2, 3 … buckets together; `None` while there are none.
fn costs_so_far<'a>(
    buckets: impl Iterator<Item = &'a Option<LightBounds>>,
    stretch: f32,
) -> [Option<f32>; BUCKETS] {
    let mut costs = [None; BUCKETS];
    let mut so_far: Option<(LightBounds, f32)> = None;
    for (cost, bucket) in costs.iter_mut().zip(buckets) {
        if let Some(bucket) = bucket {
            let sum = so_far.map_or(*bucket, |(sum, _)| sum.union(bucket));
            so_far = Some((sum, sum.cost(stretch)));
        }
        *cost = so_far.map(|(_, cost)| cost);
    }
    costs
}

fn bucket_of(bounds: &LightBounds, axis: usize, low: Vec3, extent: Vec3) -> usize {
    let along = (bounds.centre()[axis] - low[axis]) / extent[axis];
    ((along * BUCKETS as f32) as usize).min(BUCKETS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    fn lamps(count: u32) -> LightTree {
        let lights = (0..count).map(|i| {
            let [x, y, z, w] = point(5, i);
            let position = Vec3::new(x, y, z) * 10.0;
            let axis = Vec3::new(y - 0.5, z - 0.5, w - 0.45).normalize();
            let bounds = LightBounds {
                min: position,
                max: position + Vec3::splat(0.1 * w),
                axis,
                cos_normals: 1.0,
                cos_emission: 0.0,
                intensity: 10f32.powf(w * 4.0),
                two_sided: i % 3 == 0,
            };
            (i, bounds)
        });
        LightTree::build(lights.collect())
    }

    /// A ray at a light is never said to pass all of them by, and most rays are said to.
    #[test]
    fn rays_at_lights_may_meet_them() {
        let tree = lamps(200);
        let mut passed = 0;
        for i in 0..4000 {
            let [x, y, z, w] = point(13, i);
            let origin = Vec3::new(x, y, z) * 14.0 - 2.0;
            let leaf = tree.nodes.iter().filter(|node| node.is_leaf).nth((w * 200.0) as usize).unwrap();
            let [u, v, ..] = point(14, i);
            let at = leaf.bounds.min.lerp(leaf.bounds.max, u);
            for direction in [at - origin, (at - origin).normalize(), (at - origin) * 1e-4] {
                assert!(tree.may_meet(&Ray::new(origin, direction), 0.0), "{i}");
            }
            // Along an axis, in the plane of a face.
            let beside = Vec3::new(leaf.bounds.min.x, at.y, -5.0);
            assert!(tree.may_meet(&Ray::new(beside, Vec3::Z), 0.0));
            passed += u32::from(!tree.may_meet(&Ray::new(origin, crate::math::warp::sphere([u, v])), 0.0));
        }
        assert!(passed > 3000, "{passed}");
        assert!(!LightTree::default().may_meet(&Ray::new(Vec3::ZERO, Vec3::X), 0.0));
    }

    /// Probabilities of all lights add up to one at every point that any light can reach, and are those of sampling.
    #[test]
    fn probabilities_add_up_and_match_the_sampled_ones() {
        let tree = lamps(200);
        for i in 0..200 {
            let [x, y, z, w] = point(9, i);
            let p = Vec3::new(x, y, z) * 14.0 - 2.0;
            let n = if i % 5 == 0 { Vec3::ZERO } else { Vec3::new(w - 0.5, x - 0.5, y - 0.5).normalize() };
            let sum: f32 = (0..200).map(|light| tree.probability(p, n, light)).sum();
            // A walk may end where every light below a node turns away: that share of the numbers finds no light.
            assert!(sum <= 1.0 + 1e-4, "sum {sum}");
            for k in 0..64 {
                let u = (k as f32 + 0.5) / 64.0;
                if let Some((light, probability)) = tree.sample(p, n, u) {
                    assert!(probability > 0.0);
                    assert!((tree.probability(p, n, light) - probability).abs() <= 1e-5 * probability);
                }
            }
        }
    }

    /// Lights are chosen by what they send to the point, however narrow their cone is and from however many sides they shine; sixteen times the
    /// light has eight times the chance, whatever all of them are multiplied by.
    #[test]
    fn lights_are_chosen_by_what_they_send_to_the_point() {
        let spot = LightBounds {
            min: 2.0 * Vec3::Y,
            max: 2.0 * Vec3::Y,
            axis: Vec3::NEG_Y,
            cos_normals: 0.99,
            cos_emission: 1.0 - 1e-6,
            intensity: 1.0,
            two_sided: false,
        };
        let point = LightBounds { cos_normals: -1.0, cos_emission: 0.0, ..spot };
        let lamp = LightBounds { cos_normals: 1.0, cos_emission: 0.0, ..spot };
        for other in [point, lamp, LightBounds { two_sided: true, ..lamp }] {
            let chances = [1.0, 2f32.powi(100), 2f32.powi(-100)].map(|scale| {
                let lights = [spot, other].map(|light| LightBounds { intensity: scale, ..light });
                let brighter = LightBounds { intensity: 16.0 * scale, ..lights[1] };
                let tree = LightTree::build(vec![(0, lights[0]), (1, brighter)]);
                [0, 1].map(|light| tree.probability(Vec3::ZERO, Vec3::Y, light))
            });
            let [[first, second], ..] = chances;
            assert!((first - 1.0 / 9.0).abs() < 1e-6 && (second - 8.0 / 9.0).abs() < 1e-6, "{chances:?}");
            assert!(chances == [chances[0]; 3], "{chances:?}");
        }
    }

    /// A panel close to a wall lights the wall by its edges, which are chosen there; its front, whose back the wall sees, and its back, which
    /// is all but level, are not. On its other side the front is.
    #[test]
    fn faces_of_a_panel_on_a_wall_are_told_apart() {
        let (low, high) = (Vec3::new(-0.5, -0.5, 0.02), Vec3::new(0.5, 0.5, 0.1));
        let face = |min: Vec3, max: Vec3, axis: Vec3| {
            let size = max - min;
            let intensity = size.x * size.y + size.y * size.z + size.z * size.x;
            LightBounds { min, max, axis, cos_normals: 1.0, cos_emission: 0.0, intensity, two_sided: false }
        };
        let on = |axis: Vec3| {
            let (min, max) = (
                Vec3::select(axis.cmpgt(Vec3::ZERO), high, low),
                Vec3::select(axis.cmplt(Vec3::ZERO), low, high),
            );
            face(min, max, axis)
        };
        let axes = [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y];
        let tree = LightTree::build((0..6).map(|i| (i, on(axes[i as usize]))).collect());
        let chances = |p: Vec3, n: Vec3| [0, 1, 2, 3, 4, 5].map(|face| tree.probability(p, n, face));
        let beside = chances(Vec3::new(1.0, 0.0, 0.0), Vec3::Z);
        assert!(beside[0] == 0.0 && beside[3] == 0.0 && beside[2] > 0.5 && beside[1] < 0.2, "{beside:?}");
        let before = chances(Vec3::new(0.0, 0.0, 2.0), Vec3::NEG_Z);
        assert!(before[0] > 0.9 && before[1] == 0.0, "{before:?}");
        // In the plane of a face it is kept, with little weight, whichever way its numbers are rounded.
        let level = chances(Vec3::new(1.0, 0.0, 0.1), Vec3::NEG_Z);
        assert!(level[0] > 0.0 && level[0] < 0.1, "{level:?}");
    }

    /// Lights that a point sees, at any place of theirs, are found, among however many; few that are found at all share all chances.
    #[test]
    fn every_light_that_faces_the_point_can_be_found() {
        for count in [1, 2, 16, 17, 200] {
            let tree = lamps(count);
            let mut found = 0;
            for i in 0..400 {
                let [x, y, z, w] = point(13, i);
                let p = Vec3::new(x, y, z) * 10.0;
                let n = if i % 5 == 0 { Vec3::ZERO } else { crate::math::warp::sphere([w, x]) };
                for node in tree.nodes.iter().filter(|node| node.is_leaf) {
                    let [u, v, t, _] = point(14, i);
                    let bounds = &node.bounds;
                    let at = bounds.min + (bounds.max - bounds.min) * Vec3::new(u, v, t);
                    let to_light = (at - p).normalize();
                    let cos = -bounds.axis.dot(to_light);
                    let cos = if bounds.two_sided { cos.abs() } else { cos };
                    if cos > 1e-3 && (n == Vec3::ZERO || n.dot(to_light) > 1e-3) {
                        assert!(tree.probability(p, n, node.next) > 0.0, "{count} lights, {i}");
                        found += 1;
                    }
                }
                if count <= 16 {
                    let sum: f32 = (0..count).map(|light| tree.probability(p, n, light)).sum();
                    let is_found = tree.sample(p, n, 0.5).is_some();
                    assert!((sum - f32::from(u8::from(is_found))).abs() < 1e-5, "{count} lights, {i}: {sum}");
                }
            }
            assert!(found > 60 * count, "{count}: {found}");
        }
    }
}
