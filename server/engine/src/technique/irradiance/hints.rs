//! Where much of a hemisphere's light is known to come from before any ray is sent.
//!
//! Photons that fell near a record say which places send light there [Jensen1995]. Cells of the hemisphere that many of them came
//! through get more rays, and these go where in the cell they came from; each counts for as much less as it is likelier. So a spot
//! of light that few of a few hundred even rays meet is looked at many times, and what is found stays unbiased whatever the photons
//! say.

use glam::{Vec2, Vec3};

use super::Strata;
use crate::math::Frame;

/// Photons of a cell that say where in it light comes from: of even light one hemisphere in twenty-five has a cell with as many where 192 are
/// asked, one in four with the most.
const TELLING: u32 = 8;
/// Parts of a cell along either side.
const PARTS: usize = 4;

/// What is known of the light of each cell.
#[derive(Clone, Debug)]
pub(super) struct Hints {
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    /// Of the flux of all photons.
    share: f32,
    /// Photons by parts of the cell, `[outwards][around]`; beyond a byte more make no difference.
    parts: [[u8; PARTS]; PARTS],
    count: u32,
}

impl Hints {
    /// By photons that fell about `p`; `None` where there are none.
    ///
    /// - `flights`: where they came from, and their flux, W; see [`crate::technique::Guide::flights_at`]
    /// - `frame`: of the hemisphere
    pub(super) fn of(flights: &[(Vec3, f32)], p: Vec3, frame: &Frame, strata: Strata) -> Option<Hints> {
        if flights.is_empty() {
            return None;
        }
        let mut cells = vec![Cell::default(); strata.count()];
        let mut all = 0.0;
        for (from, flux_w) in flights {
            let direction = frame.to_local(*from - p).normalize_or_zero();
            if direction.z <= 0.0 {
                continue;
            }
            let (cell, place) = strata.cell_of(direction);
            let cell = &mut cells[cell];
            let [row, column] = (place * PARTS as f32).to_array().map(|at| (at as usize).min(PARTS - 1));
            cell.parts[row][column] = cell.parts[row][column].saturating_add(1);
            cell.count += 1;
            cell.share += flux_w;
            all += flux_w;
        }
        cells.iter_mut().for_each(|cell| cell.share /= f32::max(all, f32::MIN_POSITIVE));
        Some(Hints { cells })
    }

    /// Share of all light that surely comes through a cell: by two standard deviations of how many photons did less than they say.
    pub(super) fn share(&self, cell: usize) -> f32 {
        let Cell { share, count, .. } = self.cells[cell];
        share * (1.0 - 2.0 / (count.max(1) as f32).sqrt()).max(0.0)
    }

    /// Where in a cell a ray goes, and for how much it counts, for even numbers from 0 to 1.
    pub(super) fn place(&self, cell: usize, even: Vec2) -> (Vec2, f32) {
        let Cell { parts, count, .. } = &self.cells[cell];
        if *count < TELLING {
            return (even, 1.0);
        }
        // One photon more in each part than there are: none is left out.
        let sums = parts.map(|row| row.iter().map(|count| f32::from(*count) + 1.0).sum::<f32>());
        let (row, x) = draw(sums, even.x);
        let in_row = parts[row].map(|count| f32::from(count) + 1.0);
        let (column, y) = draw(in_row, even.y);
        let even_share = sums.iter().sum::<f32>() / (PARTS * PARTS) as f32;
        (Vec2::new(row as f32 + x, column as f32 + y) / PARTS as f32, even_share / in_row[column])
    }
}

/// One of some, as likely as they are large, and where in it, from 0 to 1.
fn draw(sizes: [f32; PARTS], even: f32) -> (usize, f32) {
    let mut left = even * sizes.iter().sum::<f32>();
    for (index, size) in sizes.iter().enumerate() {
        if left < *size {
            return (index, left / size);
        }
        left -= size;
    }
    (PARTS - 1, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::technique::samples_of_guides::guide_of;

    /// Weights of rays through a cell have the mean of one, over each part of it as over the whole, wherever photons came from.
    #[test]
    fn what_is_likelier_counts_for_as_much_less() {
        let strata = Strata { rings: 6, sectors: 19 };
        let frame = Frame { t: Vec3::X, b: Vec3::Y, n: Vec3::Z };
        let through = strata.direction(40, Vec2::new(0.9, 0.1));
        let photon = |number: usize| {
            let elsewhere = strata.direction(41 + number % 7, Vec2::splat(0.5));
            let from = if number.is_multiple_of(3) { elsewhere } else { through };
            (Vec3::new(1e-3 * number as f32, 0.0, 0.0), from)
        };
        let guide = guide_of(Vec3::Z, (0..96).map(photon));
        let flights = guide.flights_at(Vec3::ZERO, Vec3::Z);
        let hints = Hints::of(flights, Vec3::ZERO, &frame, strata).unwrap();
        // 64 of 96, less a quarter for chance.
        assert!((hints.share(40) - 0.5).abs() < 1e-6 && hints.share(70) == 0.0);
        for cell in [40, 42, 70] {
            let mut parts = [[0.0; PARTS]; PARTS];
            const SIDE: usize = 400;
            for (x, y) in (0..SIDE).flat_map(|x| (0..SIDE).map(move |y| (x, y))) {
                let even = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / SIDE as f32;
                let (place, weight) = hints.place(cell, even);
                assert!(place.cmpge(Vec2::ZERO).all() && place.cmple(Vec2::ONE).all());
                let [row, column] = place.to_array().map(|at| ((4.0 * at) as usize).min(3));
                parts[row][column] += f64::from(weight) / (SIDE * SIDE) as f64;
            }
            for share in parts.as_flattened() {
                assert!((share * 16.0 - 1.0).abs() < 0.03, "{cell}: {parts:?}");
            }
        }
    }
}
