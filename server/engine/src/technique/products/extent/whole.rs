//! A whole surface where it is placed: what most gathers need to know of it, before they ask where its triangles lie.

use glam::Vec3;

use super::{
    super::{
        gather::{FLATNESS, GatherBounds, Reach},
        shape::Placed,
    },
    Facets, Facing, Node, facing_of,
};

/// Everything of a piece lies in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::technique::products) struct Ball {
    pub(in crate::technique::products) middle: Vec3,
    pub(in crate::technique::products) reach_m: f32,
}

impl Ball {
    /// Of nothing.
    pub(super) const EMPTY: Ball = Ball { middle: Vec3::ZERO, reach_m: f32::NEG_INFINITY };

    /// Something of it may lie within a radius of a point.
    pub(in crate::technique::products) fn meets(&self, centre: Vec3, radius_m: f32) -> bool {
        let least_m = radius_m + self.reach_m;
        least_m > 0.0 && self.middle.distance_squared(centre) < least_m * least_m
    }
}

/// A whole surface where it is placed, render space: what most gathers need to know of it.
#[derive(Clone, Copy, Debug)]
pub(in crate::technique::products) struct Whole {
    ball: Ball,
    /// Axis of a cone that holds all normals, whatever rounding does, and cosine and sine of its half angle.
    axis: Vec3,
    cone: [f32; 2],
    facets: Facets,
}

/// By how much the cosine of the cone around a placed surface is less than in its own space, where transforms are even to 1e-5.
const CONE_SLACK: f32 = 1e-4;

impl Whole {
    /// - `root`: of all its triangles, in its own space; `None` where it has none
    pub(super) fn of(root: Option<&Node>, placed: &Placed) -> Whole {
        let Some(root) = root else {
            return Whole { ball: Ball::EMPTY, axis: Vec3::Z, cone: [-1.0, 0.0], facets: Facets::default() };
        };
        let cos = (root.cone[0] - CONE_SLACK).max(-1.0);
        Whole {
            ball: placed.ball_to_render(Ball { middle: root.middle, reach_m: root.reach_m }),
            axis: placed.direction_to_render(root.axis),
            cone: [cos, (1.0 - cos * cos).max(0.0).sqrt()],
            facets: placed.facets_to_render(root.facets),
        }
    }

    /// Something of it may lie within a radius of a point.
    pub(in crate::technique::products) fn meets(&self, centre: Vec3, radius_m: f32) -> bool {
        self.ball.meets(centre, radius_m)
    }

    pub(in crate::technique::products) fn area_m2(&self) -> f32 {
        self.facets.area_m2
    }

    /// What [`super::Extent::within`] would say, where all of it counts or nothing; `None` where it must be looked at.
    pub(in crate::technique::products) fn within(
        &self,
        bounds: &GatherBounds,
        reach: Reach,
    ) -> Option<Facets> {
        let Ball { middle, reach_m } = self.ball;
        if !self.meets(bounds.centre, reach.radius_m) {
            return Some(Facets::default());
        }
        let facing = facing_of(self.axis, self.cone, bounds.normal, reach.facing_cos);
        // The ellipsoid fills two fifths of the ball around it: most that is met lies above it or below.
        let flattened_m = bounds.flattened_from(middle).length();
        let flattened_reach_m = FLATNESS * reach_m;
        if facing == Facing::None || flattened_m >= reach.radius_m + flattened_reach_m {
            return Some(Facets::default());
        }
        let is_whole = facing == Facing::All
            && flattened_m + flattened_reach_m <= reach.radius_m
            && bounds.walls.behind_m(middle - bounds.centre) <= -reach_m;
        is_whole.then_some(self.facets)
    }
}
