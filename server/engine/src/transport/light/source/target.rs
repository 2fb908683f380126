//! What light from infinitely far is aimed at: the scene, and most of it where things stand closely.
//!
//! A house on a meadow, or a room with a window in it, fills a thousandth of what the scene covers as the sky sees it. Were photons spread
//! evenly over that, the room would be lit by a handful. So boxes are nested between the scene's bounds and those of all that is not as
//! large as the scene itself, each smaller than the one around it by the same factor, and an equal share of photons is spread over what each
//! covers. The density of all together decides what a photon carries, so that the flux stays the same in the mean everywhere (balance
//! heuristic, [Veach1997, 9.2]): up to four times as much far away, as little as a thousandth at the things. The density falls about as one over the
//! squared distance from these, and so does what a meadow sends to them.

use glam::{Vec2, Vec3};

use crate::{
    math::Frame,
    scene::{Aabb, NestedBounds},
    transport::World,
};

/// A power of two: of light that goes one way, the shares are cells of [`super::EmissionNumbers`].
const BOXES: usize = NestedBounds::COUNT;
const _: () = assert!(BOXES.is_power_of_two());

/// The boxes that light from infinitely far is aimed at, in render space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Target {
    /// Each within the one before; the first holds the scene. All the same where nothing is aimed at but the scene.
    boxes: [Bounds; BOXES],
}

/// A box around its middle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bounds {
    middle: Vec3,
    half: Vec3,
}

impl Target {
    /// Of a scene; `None` where nothing has surface.
    pub(super) fn of(world: &World) -> Option<Target> {
        let whole = world.scene().bounds()?;
        let to_bounds = |bounds: &Aabb| {
            let [min, max] = [bounds.min, bounds.max].map(|corner| world.accel().to_render(corner));
            // Room for the rounding of corners: photons may miss the scene by a hair, never the other way round.
            let half = (max - min) * 0.5 * (1.0 + 1e-5) + min.abs().max(max.abs()) * 4.0 * f32::EPSILON;
            Bounds { middle: (min + max) * 0.5, half }
        };
        let boxes = match world.nested_bounds() {
            Some(nested) => nested.boxes.map(|of| to_bounds(&of)),
            None => [to_bounds(&whole); BOXES],
        };
        Some(Target { boxes })
    }

    /// Some of it gets more photons than the rest.
    pub(super) fn is_uneven(&self) -> bool {
        self.boxes[0] != self.boxes[BOXES - 1]
    }

    /// As seen by light that travels along `direction`.
    pub(super) fn across(&self, direction: Vec3) -> Across {
        let frame = Frame::around(direction);
        let whole = &self.boxes[0];
        // Half the extent of a box along an axis of the frame.
        let reach = |of: &Bounds, axis: Vec3| axis.abs().dot(of.half);
        let rectangle_of = |of: Bounds| {
            let half = Vec2::new(reach(&of, frame.t), reach(&of, frame.b));
            let away = of.middle - whole.middle;
            Rectangle { corner: Vec2::new(frame.t.dot(away), frame.b.dot(away)) - half, size: half * 2.0 }
        };
        let is_uneven = self.is_uneven();
        let rectangles =
            if is_uneven { self.boxes.map(rectangle_of) } else { [rectangle_of(self.boxes[0]); BOXES] };
        // Before the box, also where the box is flat and seen face on.
        let distance_m = 1.1 * reach(whole, direction) + 0.1 * whole.half.length();
        Across { frame, origin: whole.middle - direction * distance_m, rectangles, is_uneven }
    }
}

/// A rectangle across the light, m, from where the middle of the scene's bounds is.
#[derive(Clone, Copy, Debug)]
struct Rectangle {
    corner: Vec2,
    size: Vec2,
}

impl Rectangle {
    fn area_m2(&self) -> f32 {
        self.size.x * self.size.y
    }

    fn holds(&self, place: Vec2) -> bool {
        place.cmpge(self.corner).all() && place.cmple(self.corner + self.size).all()
    }
}

/// What boxes look like from one direction: rectangles that cover them.
pub(super) struct Across {
    pub(super) frame: Frame,
    /// A point of the plane that photons start from.
    pub(super) origin: Vec3,
    rectangles: [Rectangle; BOXES],
    is_uneven: bool,
}

impl Across {
    /// Of the whole scene.
    pub(super) fn area_m2(&self) -> f32 {
        self.rectangles[0].area_m2()
    }

    /// Where a photon of these numbers starts, and the area over which as many would be spread, m²: one over the density of photons there.
    pub(super) fn start(&self, [u, v]: [f32; 2]) -> (Vec3, f32) {
        let place_in = |of: &Rectangle, u: [f32; 2]| of.corner + Vec2::from(u) * of.size;
        let in_space = |place: Vec2| self.origin + self.frame.t * place.x + self.frame.b * place.y;
        let whole = &self.rectangles[0];
        if !self.is_uneven {
            return (in_space(place_in(whole, [u, v])), whole.area_m2());
        }
        let scaled = u * BOXES as f32;
        let index = (scaled as usize).min(BOXES - 1);
        let place = place_in(&self.rectangles[index], [scaled - index as f32, v]);
        let holds = |(other, of): &(usize, &Rectangle)| *other == index || of.holds(place);
        let density: f32 = self
            .rectangles
            .iter()
            .enumerate()
            .filter(holds)
            .map(|(_, of)| 1.0 / (BOXES as f32 * of.area_m2()))
            .sum();
        (in_space(place), 1.0 / density)
    }
}
