//! Boxes from around a scene to around what stands on its ground: a house on a meadow, a room with a window in it, fill a thousandth of
//! the scene.

use glam::DVec3;

use super::{Aabb, Environment, Light, LightKind, Scene};
use crate::math::Rgb;

/// A scene lies flat if its least side is at most this share of its largest …
const FLAT: f64 = 0.25;
/// … and this share of the one between at most: a corridor is long, not flat.
const FLAT_ACROSS: f64 = 0.5;
/// Things are smaller than the scene if their largest side is no larger than this share of its largest.
const SMALLER: f64 = 0.5;
/// The surface of the scene's bounds over that of the smaller things' at least: with less, they fill the scene.
const SURFACE_RATIO_MIN: f64 = 4.0;
/// Room around the smaller things, in shares of their largest side, beside what rounding up leaves: from the ground around a house comes
/// most of the light that falls in at its windows from below.
const AROUND: f64 = 0.3;
/// Sides of the inner box over the scene's largest, at least: with less, what photons carry and how large cells are would change by more than
/// four and sixteen times from one box to the next, and cells of the deepest octree would end below single precision.
const LEAST_SHARE: f64 = 1.0 / 64.0;
/// Sides of the inner box are so many to an octave, and its middle lies on a grid of this share of them, so that most edits leave it, and all
/// photons of sun and sky with it …
const STEPS_AN_OCTAVE: f64 = 4.0;
const GRID_OF_SIDE: f64 = 0.125;
/// … which does not begin at a round share of the scene, where things tend to stand.
const GRID_OFF: f64 = 0.0371;

/// Boxes, each within the one before and smaller by the same factor, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NestedBounds {
    /// The first is around the scene, the last around all nodes that are smaller than it and some of the ground around them.
    pub boxes: [Aabb; NestedBounds::COUNT],
}

impl NestedBounds {
    /// How many boxes there are.
    pub const COUNT: usize = 4;

    /// - `whole`: bounds of the scene
    /// - `of_nodes`: bounds of each of its nodes
    ///
    /// `None` where the scene does not lie flat, as ground does, or the smaller nodes fill about as much as it, or there is none.
    fn of(whole: &Aabb, of_nodes: impl Iterator<Item = Aabb>) -> Option<NestedBounds> {
        let size = whole.max - whole.min;
        let mut sides = size.to_array();
        sides.sort_by(f64::total_cmp);
        let [least, between_them, largest] = sides;
        if !(least <= FLAT * largest && least <= FLAT_ACROSS * between_them) {
            return None;
        }
        let largest_m = SMALLER * largest;
        let is_smaller = |bounds: &Aabb| (bounds.max - bounds.min).max_element() <= largest_m;
        let things = of_nodes.filter(is_smaller).reduce(|all, bounds| all.union(&bounds))?;
        let room = AROUND * (things.max - things.min).max_element();
        let along = |axis: usize| {
            let (low, side) = (whole.min[axis], size[axis]);
            let (from, to) = (things.min[axis] - room - low, things.max[axis] + room - low);
            let least = (to - from).max(LEAST_SHARE * largest);
            let Some(inner) = side_of_inner(least, side) else { return (low, low + side) };
            let grid = GRID_OF_SIDE * inner;
            let middle = (((from + to) * 0.5 / grid - GRID_OFF).round() + GRID_OFF) * grid;
            let at = |offset: f64| low + (middle + offset).clamp(0.0, side);
            (at(-0.5 * inner), at(0.5 * inner))
        };
        let [x, y, z] = [0, 1, 2].map(along);
        let inner = Aabb { min: DVec3::new(x.0, y.0, z.0), max: DVec3::new(x.1, y.1, z.1) };
        let surface_m2 = |bounds: &Aabb| {
            let size = bounds.max - bounds.min;
            size.x * size.y + size.y * size.z + size.z * size.x
        };
        let is_smaller = (inner.max - inner.min).max_element() < largest;
        let is_within = is_smaller && surface_m2(whole) > SURFACE_RATIO_MIN * surface_m2(&inner);
        is_within.then(|| NestedBounds { boxes: std::array::from_fn(|index| between(whole, &inner, index)) })
    }
}

/// Side of the inner box around things of that extent, which holds them wherever on its grid its middle is; `None` where it is no smaller than
/// the scene.
fn side_of_inner(extent: f64, side_of_scene: f64) -> Option<f64> {
    let least = extent / (1.0 - GRID_OF_SIDE);
    let steps = (least / side_of_scene).log2() * STEPS_AN_OCTAVE;
    let inner = side_of_scene * (steps.ceil() / STEPS_AN_OCTAVE).exp2();
    // Not of things or scenes without extent.
    (inner > 0.0 && inner < side_of_scene).then_some(inner)
}

/// Box `index` of those from the outer to the inner one.
fn between(outer: &Aabb, inner: &Aabb, index: usize) -> Aabb {
    let [outer_m, inner_m] = [outer, inner].map(|of| (of.max - of.min).max_element());
    let size_m = outer_m * (inner_m / outer_m).powf(index as f64 / (NestedBounds::COUNT - 1) as f64);
    let share = ((outer_m - size_m) / (outer_m - inner_m)).clamp(0.0, 1.0);
    Aabb { min: outer.min.lerp(inner.min, share), max: outer.max.lerp(inner.max, share) }
}

impl Scene {
    /// Boxes from around a scene that lies flat to around its smaller nodes; `None` of others, where these nodes fill it, and where no
    /// light comes from infinitely far: the photons of lamps are not aimed at things.
    pub fn nested_bounds(&self) -> Option<NestedBounds> {
        if !self.is_lit_from_afar() {
            return None;
        }
        NestedBounds::of(&self.bounds()?, self.node_bounds())
    }

    /// It has a sun or a sky that is not black.
    fn is_lit_from_afar(&self) -> bool {
        let is_lit = |colour: &Rgb| colour.max_component() > 0.0;
        let is_sun = |light: &Light| matches!(&light.kind, LightKind::Directional { irradiance } if is_lit(irradiance));
        let is_sky = match &self.environment {
            Environment::None => false,
            Environment::Constant(radiance) => is_lit(radiance),
            Environment::Image { scale, .. } => is_lit(scale),
        };
        is_sky || self.lights.values().any(is_sun)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(middle: DVec3, half_m: f64) -> Aabb {
        Aabb { min: middle - half_m, max: middle + half_m }
    }

    fn nested(nodes: &[Aabb]) -> Option<NestedBounds> {
        let whole = nodes.iter().fold(Aabb::EMPTY, |all, bounds| all.union(bounds));
        NestedBounds::of(&whole, nodes.iter().copied())
    }

    const GROUND: Aabb = Aabb { min: DVec3::new(-300.0, 0.0, -300.0), max: DVec3::new(300.0, 0.0, 300.0) };

    #[test]
    fn boxes_shrink_from_the_scene_to_its_things() {
        let things = [cube(DVec3::new(40.0, 2.0, -290.0), 2.0), cube(DVec3::new(46.0, 1.0, -290.0), 1.0)];
        let found = nested(&[GROUND, things[0], things[1]]).expect("much ground around");
        let [outer, .., inner] = found.boxes;
        assert_eq!(outer, Aabb { min: GROUND.min, max: GROUND.max.with_y(4.0) });
        for thing in things {
            assert!(thing.min.cmpge(inner.min).all() && thing.max.cmple(inner.max).all(), "{inner:?}");
        }
        let sizes = found.boxes.map(|of| (of.max - of.min).max_element());
        for (pair, factors) in found.boxes.windows(2).zip(sizes.windows(3)) {
            let [outer, inner] = pair else { unreachable!() };
            assert!(inner.min.cmpge(outer.min).all() && inner.max.cmple(outer.max).all(), "{pair:?}");
            let [a, b, c] = factors else { unreachable!() };
            assert!((a / b / (b / c) - 1.0).abs() < 1e-9, "{sizes:?}");
        }
        assert!(sizes[3] < 40.0, "{sizes:?}");
        // Of a vase some ground as well.
        let vase =
            nested(&[GROUND, cube(DVec3::new(3.0, 0.1, 5.0), 0.1)]).expect("much ground around").boxes[3];
        assert!((vase.max - vase.min).max_element() >= 600.0 / 64.0, "{vase:?}");
    }

    /// Of a hundred steps of 4 cm at most five change the boxes of a house of 4 m, and the house is in the inner one all the way.
    #[test]
    fn most_moves_leave_them() {
        let at = |x: f64| {
            let thing = cube(DVec3::new(x, 2.0, 1.0), 2.0);
            let boxes = nested(&[GROUND, thing]).expect("much ground around").boxes;
            assert!(thing.min.cmpge(boxes[3].min).all() && thing.max.cmple(boxes[3].max).all(), "{boxes:?}");
            boxes
        };
        let changes =
            (0..400).filter(|step| at(0.04 * f64::from(*step)) != at(0.04 * f64::from(step + 1))).count();
        assert!((1..=20).contains(&changes), "{changes}");
        let house = [cube(DVec3::new(0.0, 3.0, 0.0), 4.0), cube(DVec3::new(7.0, 3.0, 1.0), 4.0)];
        let with = |x: f64| nested(&[GROUND, house[0], house[1], cube(DVec3::new(x, 1.0, 1.0), 0.5)]);
        let changes =
            (0..400).filter(|step| with(0.02 * f64::from(*step)) != with(0.02 * f64::from(step + 1))).count();
        assert!(changes == 0, "{changes}");
    }

    #[test]
    fn things_that_fill_the_scene_have_none() {
        let room = Aabb { min: DVec3::ZERO, max: DVec3::new(6.0, 3.0, 5.0) };
        assert_eq!(nested(&[room]), None);
        let corners = [cube(DVec3::new(0.5, 0.5, 0.5), 0.5), cube(DVec3::new(5.5, 0.5, 4.5), 0.5)];
        assert_eq!(nested(&[room, corners[0], corners[1]]), None);
        // Something small in a high room, and in a corridor.
        let hall = Aabb { min: DVec3::ZERO, max: DVec3::splat(20.0) };
        assert_eq!(nested(&[hall, cube(DVec3::new(10.0, 1.0, 10.0), 1.0)]), None);
        let corridor = Aabb { min: DVec3::ZERO, max: DVec3::new(60.0, 3.0, 3.0) };
        assert_eq!(nested(&[corridor, cube(DVec3::new(30.0, 1.0, 1.5), 1.0)]), None);
        // No mesh that is a thing.
        assert_eq!(nested(&[GROUND, hall.union(&GROUND)]), None);
        // All of it flat, and a point.
        assert_eq!(nested(&[Aabb { min: GROUND.min, max: GROUND.max }]), None);
        assert_eq!(nested(&[cube(DVec3::ONE, 0.0)]), None);
    }
}
