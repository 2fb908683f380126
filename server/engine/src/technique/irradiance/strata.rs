//! Cells of a hemisphere: rings from the pole to the horizon, each with as many sectors, all of the same cosine-weighted solid
//! angle [Ward1992].

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

/// How a hemisphere is cut into cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Strata {
    pub(super) rings: usize,
    pub(super) sectors: usize,
}

impl Strata {
    /// Of all cells.
    pub(super) fn count(self) -> usize {
        self.rings * self.sectors
    }

    /// Number of a cell, whatever turns its sector has gone beyond one.
    pub(super) fn at(self, ring: usize, sector: usize) -> usize {
        ring * self.sectors + sector % self.sectors
    }

    /// Unit direction above the xy plane through a place in a cell, from 0 to 1 outwards and around.
    pub(super) fn direction(self, cell: usize, place: Vec2) -> Vec3 {
        let (ring, sector) = (cell / self.sectors, cell % self.sectors);
        let sin2 = (ring as f32 + place.x) / self.rings as f32;
        let phi = TAU * (sector as f32 + place.y) / self.sectors as f32;
        let (sin, cos) = (sin2.sqrt(), (1.0 - sin2).max(0.0).sqrt());
        Vec3::new(sin * phi.cos(), sin * phi.sin(), cos)
    }

    /// The cell that a unit direction above the xy plane goes through, and where.
    pub(super) fn cell_of(self, direction: Vec3) -> (usize, Vec2) {
        let split = |at: f32, count: usize| {
            let index = (at as usize).min(count - 1);
            (index, (at - index as f32).clamp(0.0, 1.0))
        };
        let sin2 = direction.x * direction.x + direction.y * direction.y;
        let turns = direction.y.atan2(direction.x) / TAU;
        let (ring, outwards) = split(sin2 * self.rings as f32, self.rings);
        let (sector, around) = split((turns - turns.floor()) * self.sectors as f32, self.sectors);
        (self.at(ring, sector), Vec2::new(outwards, around))
    }

    /// The cells beside one: around, inwards and outwards as far as there are any.
    pub(super) fn beside(self, cell: usize) -> impl Iterator<Item = usize> {
        let (ring, sector) = (cell / self.sectors, cell % self.sectors);
        let around = [self.at(ring, sector + 1), self.at(ring, sector + self.sectors - 1)];
        let inwards = ring.checked_sub(1).map(|_| cell - self.sectors);
        let outwards = (ring + 1 < self.rings).then(|| cell + self.sectors);
        around.into_iter().chain(inwards).chain(outwards)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// A direction through a place in a cell goes through that cell there, and neighbours know of each other.
    #[test]
    fn directions_and_cells_agree() {
        let strata = Strata { rings: 6, sectors: 19 };
        for number in 0..10_000 {
            let [x, y, which, _] = point(3, number);
            let cell = (which * strata.count() as f32) as usize;
            let place = Vec2::new(0.01 + 0.98 * x, 0.01 + 0.98 * y);
            let (found, at) = strata.cell_of(strata.direction(cell, place));
            assert!(found == cell && at.abs_diff_eq(place, 1e-3), "{cell} {place}: {found} {at}");
        }
        for cell in 0..strata.count() {
            assert!(strata.beside(cell).all(|other| strata.beside(other).any(|back| back == cell)));
        }
        // The pole, the horizon and the seam where turns begin.
        for direction in [Vec3::Z, Vec3::X, Vec3::NEG_X, -Vec3::Y, Vec3::new(1.0, -1e-12, 0.0)] {
            let (cell, place) = strata.cell_of(direction);
            assert!(cell < strata.count() && place.cmpge(Vec2::ZERO).all() && place.cmple(Vec2::ONE).all());
        }
    }
}
