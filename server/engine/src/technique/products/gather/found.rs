//! Gathers whose search something else than this machine's CPU makes: what is asked of it, what it found, and what becomes of that.

use super::{
    ALIKE_COS, AMPLE, ANY_COS, FACING_COS, FACING_MIN, FIRST_GUESS, FLATNESS, GROWTH_BLIND, GROWTH_MAX,
    GROWTH_MIN, Gather, GatherBounds, MAPPED, Near, TELLING,
};
use crate::{
    math::octahedral,
    technique::{
        PhotonMaps, SideId,
        products::extent::{Facets, SMALL},
    },
    transport::PathClass,
};

/// Farthest that is looked on a card, and farthest from the origin that anything lies: squares stay in the range of floats.
pub(in crate::technique) const FAR_M: f32 = 1e15;
/// The same of what is nearest.
pub(in crate::technique) const NEAR_M: f32 = 1.0 / FAR_M;

/// The numbers of searches by name, for shaders that make the same.
pub(in crate::technique) const NUMBERS: [(&str, f32); 9] = [
    ("GATHER_FLATNESS", FLATNESS),
    ("GATHER_FACING_COS", FACING_COS),
    ("GATHER_ALIKE_COS", ALIKE_COS),
    ("GATHER_ANY_COS", ANY_COS),
    ("GATHER_AMPLE", AMPLE),
    ("GATHER_GROWTH_MIN", GROWTH_MIN),
    ("GATHER_GROWTH_MAX", GROWTH_MAX),
    ("GATHER_GROWTH_BLIND", GROWTH_BLIND),
    ("GATHER_SMALL", SMALL),
];

/// The counts among them.
pub(in crate::technique) const COUNTS: [(&str, usize); 2] =
    [("GATHER_FACING_MIN", FACING_MIN), ("GATHER_TELLING", TELLING)];

/// What the search of a gather found, and how much surface lies within its reach.
#[derive(Clone, Debug, Default)]
pub struct FoundPhotons {
    pub(in crate::technique) radius_m: f32,
    pub(in crate::technique) reach_m: f32,
    pub(in crate::technique) facing_cos: f32,
    pub(in crate::technique) behind_count: usize,
    /// By side and place in its map, in that order.
    pub(in crate::technique) near: Vec<[u32; 2]>,
    /// Of the sides that were asked for, in their order.
    pub(in crate::technique) of_sides: Vec<Facets>,
}

/// What a search found is of other maps or other sides than those that it is handed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("gathering of photons that a search found: it searched other maps, or other sides")]
pub struct OtherMaps;

impl FoundPhotons {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.near.len()
    }
}

impl GatherBounds {
    /// Where a search begins: how far it looks, and how many it keeps if that is enough.
    pub(in crate::technique) fn first_look(&self) -> (f32, usize) {
        if self.is_content() {
            (self.radius_m, self.count_max.get())
        } else {
            (self.radius_max_m * FIRST_GUESS, self.count_min.get())
        }
    }

    /// Numbers that can be computed with.
    pub(in crate::technique) fn is_sound(&self) -> bool {
        self.centre.abs().max_element() <= FAR_M
            && self.normal.is_normalized()
            && (NEAR_M..=FAR_M).contains(&self.radius_max_m)
            && (NEAR_M..=FAR_M).contains(&self.first_look().0)
            && !self.radius_m.is_nan()
            && self
                .walls
                .nearest_first()
                .all(|(away, distance_m)| away.is_finite() && distance_m.abs() <= FAR_M)
    }
}

impl PhotonMaps {
    /// [`PhotonMaps::gather`] from its search on.
    ///
    /// - `found`: by a search with the same bounds, of the same sides
    ///
    /// Errors: [`OtherMaps`] where that cannot be; nothing is gathered then.
    pub fn gather_found(
        &self,
        class: PathClass,
        sides: &[SideId],
        bounds: &GatherBounds,
        found: &FoundPhotons,
        gather: &mut Gather,
    ) -> Result<(), OtherMaps> {
        let Some(class) = gather.begin(class) else { return Ok(()) };
        let maps = &self.sides[class];
        let is_ours = sides.iter().all(|side| side.index() < maps.len())
            && (found.of_sides.is_empty() || found.of_sides.len() == sides.len());
        if !is_ours {
            return Err(OtherMaps);
        }
        let near_of = |[side, item]: [u32; 2]| {
            sides.binary_search_by_key(&(side as usize), |side| side.index()).ok()?;
            let photon = maps[side as usize].as_ref()?.photons.get(item as usize)?;
            let distance2 = bounds.flattened_from(photon.position).length_squared();
            let facing_cos = octahedral::decode(photon.normal).dot(bounds.normal);
            Some(Near { distance2, side, item, facing_cos })
        };
        for name in &found.near {
            let Some(near) = near_of(*name) else {
                gather.near.clear();
                return Err(OtherMaps);
            };
            gather.near.push(near);
        }
        gather.radius_m = found.radius_m;
        gather.reach_m = found.reach_m;
        gather.facing_cos = found.facing_cos;
        gather.behind_count = found.behind_count;
        gather.of_sides.extend(&found.of_sides);
        self.estimate(class, sides, bounds, gather);
        Ok(())
    }

    /// What the CPU's search finds.
    #[cfg(test)]
    pub(in crate::technique) fn found(
        &self,
        class: PathClass,
        sides: &[SideId],
        bounds: &GatherBounds,
    ) -> FoundPhotons {
        let mut gather = Gather::default();
        let class = gather.begin(class).unwrap();
        self.search(class, sides, bounds, &mut gather);
        gather.near.sort_unstable_by_key(Near::name);
        let reach = super::Reach { radius_m: gather.radius_m, facing_cos: gather.facing_cos };
        if gather.near.len() + gather.behind_count > 0 {
            self.look_at_sides(sides, bounds, reach, &mut gather);
        }
        FoundPhotons {
            radius_m: gather.radius_m,
            reach_m: gather.reach_m,
            facing_cos: gather.facing_cos,
            behind_count: gather.behind_count,
            near: gather.near.iter().map(|near| [near.side, near.item]).collect(),
            of_sides: gather.of_sides,
        }
    }

    /// Where a photon lies, and cosine of its surface's normal with another.
    #[cfg(test)]
    pub(in crate::technique) fn lies(
        &self,
        class: usize,
        [side, item]: [u32; 2],
        normal: glam::Vec3,
    ) -> (glam::Vec3, f32) {
        let photon = self.sides[class][side as usize].as_ref().unwrap().photons[item as usize];
        (photon.position, octahedral::decode(photon.normal).dot(normal))
    }

    /// The place of a class in [`MAPPED`].
    pub(in crate::technique) fn class_of(class: PathClass) -> Option<usize> {
        MAPPED.iter().position(|mapped| *mapped == class)
    }
}
