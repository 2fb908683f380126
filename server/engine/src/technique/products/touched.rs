//! Where an edit touched what light can meet: what is held against these boxes and misses them is as it was.

use std::{collections::HashMap, sync::Arc};

use glam::{DVec3, Vec3};

use crate::{
    accel::{Accel, Instance},
    scene::{Aabb, Id},
    technique::Edit,
};

/// How far a packed direction is off, per length: 0.0037° is 6.5 · 10⁻⁵, and some rounding.
const ESCAPE_ERROR: f32 = 1e-4;

/// Boxes that segments are held against at most.
const BOXES_MAX: usize = 64;

/// A box of render space that an edit touched.
#[derive(Clone, Copy, Debug)]
pub struct Touched {
    middle: Vec3,
    half: Vec3,
}

/// The boxes of an edit, and one around them all that most segments miss.
#[derive(Debug)]
pub struct TouchedBoxes {
    all: Option<Touched>,
    boxes: Vec<Touched>,
    /// No box reaches farther from the origin, m.
    reach_m: f32,
}

impl Touched {
    fn around(accel: &Accel, bounds: &Aabb, slack_m: f32) -> Touched {
        // Room for the rounding of hits and of this box.
        let room = Vec3::splat((1e-5 * accel.radius()).max(slack_m).max(f32::MIN_POSITIVE));
        let to_render = |corner: DVec3| accel.to_render(corner);
        Touched::between(to_render(bounds.min) - room, to_render(bounds.max) + room)
    }

    pub(in crate::technique) fn between(min: Vec3, max: Vec3) -> Touched {
        Touched { middle: (min + max) * 0.5, half: (max - min) * 0.5 }
    }

    /// Around both.
    fn union(self, other: Touched) -> Touched {
        let ([low, high], [other_low, other_high]) = (self.corners(), other.corners());
        Touched::between(low.min(other_low), high.max(other_high))
    }

    /// Its lowest and its highest corner.
    pub fn corners(&self) -> [Vec3; 2] {
        [self.middle - self.half, self.middle + self.half]
    }

    /// With so much room around it.
    pub fn grown(self, by_m: f32) -> Touched {
        Touched { half: self.half + by_m, ..self }
    }

    /// The middle of the ball around it, and its radius, m.
    pub fn ball(&self) -> (Vec3, f32) {
        (self.middle, self.half.length())
    }

    /// Distance to its nearest point, m; nothing from within.
    pub fn distance_m(&self, from: Vec3) -> f32 {
        ((from - self.middle).abs() - self.half).max(Vec3::ZERO).length()
    }

    /// True when the segment meets the box, or comes as near as rounding: no axis of the box and no axis at right angles
    /// to both sets them apart [Ericson2005, 5.3.3].
    pub(in crate::technique) fn meets(&self, from: Vec3, to: Vec3) -> bool {
        let middle = (from + to) * 0.5 - self.middle;
        let half_way = (to - from) * 0.5;
        let reach = half_way.abs();
        if middle.abs().cmpgt(self.half + reach).any() {
            return false;
        }
        // Room for parallel segments, whose cross products are all rounding.
        let reach = reach + reach.max_element() * (4.0 * f32::EPSILON);
        let apart = middle.cross(half_way).abs();
        let extent = Vec3::new(
            self.half.y * reach.z + self.half.z * reach.y,
            self.half.x * reach.z + self.half.z * reach.x,
            self.half.x * reach.y + self.half.y * reach.x,
        );
        let rounding = middle.abs().max_element() * reach.max_element() * (8.0 * f32::EPSILON);
        !apart.cmpgt(extent + rounding).any()
    }
}

impl TouchedBoxes {
    /// Where anything that light can meet was or is, if the edit touched it.
    pub fn of(edit: &Edit<'_>) -> TouchedBoxes {
        let boxes = touched_bounds(edit);
        // Of many neighbours in the scene's order a few larger ones: what is withdrawn too much is traced again as it was.
        let joined = boxes.chunks(boxes.len().div_ceil(BOXES_MAX).max(1));
        let boxes: Vec<Touched> =
            joined.filter_map(|some| some.iter().copied().reduce(Touched::union)).collect();
        let reach = |touched: &Touched| (touched.middle.abs() + touched.half).length();
        TouchedBoxes {
            all: boxes.iter().copied().reduce(Touched::union),
            reach_m: boxes.iter().map(reach).fold(0.0, f32::max),
            boxes,
        }
    }

    /// True when a way from `from` without end, whose direction is off by a packed one's error, may meet one of the boxes.
    pub fn meet_escape(&self, from: Vec3, direction: Vec3) -> bool {
        let way_m = 2.0 * (from.length() + self.reach_m);
        let to = from + direction * way_m;
        let meets = |touched: &Touched| touched.grown(way_m * ESCAPE_ERROR).meets(from, to);
        self.all.as_ref().is_some_and(meets) && self.boxes.iter().any(meets)
    }

    /// True when the segment meets one of them, or comes as near as rounding.
    pub fn meet(&self, from: Vec3, to: Vec3) -> bool {
        self.all.is_some_and(|all| all.meets(from, to))
            && self.boxes.iter().any(|touched| touched.meets(from, to))
    }

    /// All of them.
    pub fn boxes(&self) -> &[Touched] {
        &self.boxes
    }
}

/// Where anything that light can meet was or is, if the edit touched it.
fn touched_bounds(edit: &Edit<'_>) -> Vec<Touched> {
    let mut touched = Vec::new();
    for world in [edit.before, edit.after] {
        let accel = world.accel();
        for instance in accel.instances() {
            let materials = || instance.mesh().primitives().iter().map(|primitive| &primitive.material);
            let is_touched = edit.change.nodes.contains(instance.node_id())
                || edit.change.meshes.contains(instance.mesh_id())
                || materials().any(|material| edit.change.materials.contains(material));
            if is_touched {
                touched.push(Touched::around(accel, instance.bounds_in_world(), instance.slack_m()));
            }
        }
    }
    touched
}

/// For every instance before an edit its number after it: numbers move up when nodes are removed. `None` where it is gone, or has
/// another mesh.
pub fn renamed_instances(before: &Accel, after: &Accel) -> Vec<Option<u32>> {
    let numbers: HashMap<&Id, u32> =
        (0..).zip(after.instances()).map(|(index, instance)| (instance.node_id(), index)).collect();
    let number_of = |instance: &Instance| {
        let number = *numbers.get(instance.node_id())?;
        Arc::ptr_eq(after.instances()[number as usize].mesh(), instance.mesh()).then_some(number)
    };
    before.instances().iter().map(|instance| number_of(instance)).collect()
}
