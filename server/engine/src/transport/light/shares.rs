//! How much of what an emissive primitive sends out each of its triangles does, where a picture says so; triangles that it lights unevenly are cut
//! into parts, each a light of its own, so that few large ones are sampled by what shines as well as many small ones.

use std::sync::Arc;

use rayon::prelude::*;

use crate::{
    accel::Instance,
    math::{sobol, warp},
    scene::Primitive,
    transport::surface::PreparedMaterial,
};

/// Points of a primitive at which it is asked how much it emits, and of each of its parts: few milliseconds where lamps are of thousands.
const POINTS: u32 = 1 << 16;
const POINTS_MIN: u32 = 4;
const POINTS_MAX: u32 = 1 << 9;
/// A part of which no point shines is taken to emit so much of the mean of all: dark ones then get few samples, however many they are, and what
/// shines between the points is not left to chance.
const LEAST: f32 = 0.05;

/// Parts of a primitive at most, as far as it is cut at all, and of all that are; a tree of so many lights is built in some milliseconds.
const PARTS_MAX: u32 = 1 << 12;
const PARTS_OF_ALL_MAX: u32 = 1 << 16;
const LEVEL_MAX: u32 = 5;
/// Triangles are cut into as few parts as leave the light within parts so much less even than within the smallest, by its second moment.
const UNEVEN_LEFT: f64 = 1.25;

/// How triangles are cut: every edge into 2^level pieces, which makes 4^level parts of the same shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Cut {
    pub(super) level: u32,
}

/// A part of a triangle: barycentric coordinates are `corner` + `scale` · the part's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Weights of the triangle's second and third corner.
    pub(super) corner: [f32; 2],
    /// Below zero where the part is turned half round.
    pub(super) scale: f32,
}

impl Cut {
    /// Parts of a triangle.
    pub(super) fn count(self) -> u32 {
        1 << (2 * self.level)
    }

    /// Pieces of an edge.
    fn pieces(self) -> u32 {
        1 << self.level
    }

    /// The parts of a triangle, by number.
    pub(super) fn parts(self) -> impl Iterator<Item = Part> {
        let pieces = self.pieces();
        let scale = 1.0 / pieces as f32;
        (0..pieces).flat_map(move |row| {
            (0..2 * (pieces - row) - 1).map(move |number| {
                let (column, turned) = (number / 2, number % 2);
                let corner = [row + turned, column + turned].map(|at| at as f32 * scale);
                Part { corner, scale: if turned == 1 { -scale } else { scale } }
            })
        })
    }

    /// Number of the part that a point lies in.
    ///
    /// - `barycentric`: weights of the triangle's second and third corner
    pub(super) fn part_of(self, barycentric: [f32; 2]) -> u32 {
        let pieces = self.pieces();
        let [x, y] = barycentric.map(|weight| (weight * pieces as f32).max(0.0));
        // Rounding may reach beyond the far edge.
        let row = (x as u32).min(pieces - 1);
        let column = (y as u32).min(pieces - 1 - row);
        let is_turned = (x - row as f32) + (y - column as f32) > 1.0 && column + 1 < pieces - row;
        row * (2 * pieces - row) + 2 * column + u32::from(is_turned)
    }
}

impl Part {
    /// A whole triangle.
    #[cfg(test)]
    pub(super) const WHOLE: Part = Part { corner: [0.0; 2], scale: 1.0 };

    /// Where in the triangle a point of the part lies; weights of the second and third corner.
    pub(super) fn at(self, own: [f32; 2]) -> [f32; 2] {
        [self.corner[0] + self.scale * own[0], self.corner[1] + self.scale * own[1]]
    }
}

/// Shares of the parts of a primitive's triangles.
#[derive(Clone, Debug)]
pub(in crate::transport) struct Shares {
    pub(super) cut: Cut,
    /// `[triangles × parts]`: about how much more of the light each emits than the mean, above 0.
    pub(super) of_parts: Arc<[f32]>,
}

impl Shares {
    /// By the picture of what a primitive emits, `None` where there is none. They steer sampling only: where none of some points shines,
    /// another may.
    ///
    /// - `places`: primitives of instances with such a picture in the scene, this one included
    pub(in crate::transport) fn of(
        material: &PreparedMaterial,
        instance: &Instance,
        primitive: &Primitive,
        places: usize,
    ) -> Option<Shares> {
        if !material.emits_a_picture() {
            return None;
        }
        let parts_max = (u64::from(PARTS_OF_ALL_MAX) / places.max(1) as u64).min(PARTS_MAX.into());
        let level = (0..=LEVEL_MAX)
            .rev()
            .find(|level| u64::from(primitive.triangle_count) << (2 * level) <= parts_max);
        let finest = Cut { level: level.unwrap_or(0) };
        let parts: Vec<Part> = finest.parts().collect();
        let count = primitive.triangle_count.max(1).saturating_mul(finest.count());
        let points = (POINTS / count).clamp(POINTS_MIN, POINTS_MAX);
        let point = |number: u32| {
            let [u, v, ..] = sobol::point(0, number);
            warp::triangle([u, v])
        };
        let points: Vec<[f32; 2]> = (0..points).map(point).collect();
        let share = |triangle: u32, part: &Part| {
            let of_point = |own: &[f32; 2]| material.emission_share(instance, triangle, part.at(*own));
            points.iter().map(of_point).sum::<f32>() / points.len() as f32
        };
        let triangles =
            primitive.first_triangle..primitive.first_triangle.saturating_add(primitive.triangle_count);
        let of_finest: Vec<f32> = triangles
            .into_par_iter()
            .flat_map_iter(|triangle| parts.iter().map(move |part| share(triangle, part)))
            .collect();
        if !of_finest.iter().all(|share| share.is_finite()) {
            return None;
        }
        let most = unevenness(&of_finest);
        let mut shares = Shares { cut: finest, of_parts: of_finest.clone().into() };
        for level in 0..finest.level {
            let of_parts = merged(&of_finest, finest, Cut { level });
            if unevenness(&of_parts) * UNEVEN_LEFT >= most {
                shares = Shares { cut: Cut { level }, of_parts: of_parts.into() };
                break;
            }
        }
        Some(shares.floored())
    }

    /// None below the least.
    fn floored(mut self) -> Shares {
        let mean = self.of_parts.iter().sum::<f32>() / self.of_parts.len() as f32;
        // Of few large dark ones beside many small bright ones as well.
        let least = LEAST * if mean > 0.0 { mean.min(1.0) } else { 1.0 };
        self.of_parts = self.of_parts.iter().map(|share| share.max(least)).collect();
        self
    }
}

/// Means of the parts of a coarser cut.
fn merged(of_finest: &[f32], finest: Cut, cut: Cut) -> Vec<f32> {
    let count = cut.count() as usize;
    let each = (count as f32) / finest.count() as f32;
    let homes: Vec<u32> = finest.parts().map(|part| cut.part_of(part.at([1.0 / 3.0; 2]))).collect();
    let mut means = vec![0.0; of_finest.len() / homes.len() * count];
    for (triangle, shares) in of_finest.chunks_exact(homes.len()).enumerate() {
        for (share, home) in shares.iter().zip(&homes) {
            means[triangle * count + *home as usize] += share * each;
        }
    }
    means
}

/// Mean of the squares over the square of the mean; 1 where all is alike or dark.
fn unevenness(shares: &[f32]) -> f64 {
    let [sum, squares] = shares.iter().fold([0.0, 0.0], |[sum, squares], share| {
        let share = f64::from(*share);
        [sum + share, squares + share * share]
    });
    if sum > 0.0 { squares * shares.len() as f64 / (sum * sum) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts cover a triangle once: every point lies in the part that says so, and parts are drawn alike by even points.
    #[test]
    fn parts_cover_a_triangle_once() {
        assert_eq!(Cut::default().parts().collect::<Vec<_>>(), [Part::WHOLE]);
        for level in 0..=LEVEL_MAX {
            let cut = Cut { level };
            let parts: Vec<Part> = cut.parts().collect();
            assert_eq!(parts.len(), cut.count() as usize);
            for (number, part) in (0u32..).zip(&parts) {
                for own in [[0.01, 0.01], [0.97, 0.01], [0.01, 0.97], [0.3, 0.4]] {
                    let [b1, b2] = part.at(own);
                    assert!(b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0);
                    assert_eq!(cut.part_of([b1, b2]), number, "{own:?} of {level}");
                }
            }
            let mut counts = vec![0u32; parts.len()];
            for i in 0..1 << 16 {
                let [u, v, ..] = sobol::point(3, i);
                counts[cut.part_of(warp::triangle([u, v])) as usize] += 1;
            }
            let expected = (1 << 16) / cut.count();
            assert!(counts.iter().all(|count| count.abs_diff(expected) < expected / 4 + 8), "{counts:?}");
        }
        // Corners, and what rounding leaves beyond the edges.
        for point in
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.500_000_1, 0.5], [-1e-8, 1.0], [1.000_000_1, 0.0]]
        {
            assert!(Cut { level: LEVEL_MAX }.part_of(point) < Cut { level: LEVEL_MAX }.count());
        }
    }

    /// Coarser cuts keep the sum of the light, and the whole triangle has all of it.
    #[test]
    fn coarser_cuts_keep_the_light() {
        let finest = Cut { level: 3 };
        let shares: Vec<f32> = (0..2 * finest.count()).map(|i| (i % 7) as f32).collect();
        for level in 0..=3 {
            let coarse = merged(&shares, finest, Cut { level });
            assert_eq!(coarse.len(), 2 << (2 * level));
            let mean = |shares: &[f32]| shares.iter().sum::<f32>() / shares.len() as f32;
            assert!((mean(&coarse) / mean(&shares) - 1.0).abs() < 1e-5);
            let half = coarse.len() / 2;
            assert!((mean(&coarse[..half]) / mean(&shares[..64]) - 1.0).abs() < 1e-5);
        }
        assert_eq!(merged(&shares, finest, finest), shares);
    }
}
