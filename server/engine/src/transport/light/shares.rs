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

/// Parts of a primitive at most, as far as it is cut at all; a tree of so many lights is built in some milliseconds.
const PARTS_MAX: u32 = 1 << 12;
/// The same of all primitives in all places.
const PARTS_OF_ALL_MAX: u32 = 1 << 16;
const LEVEL_MAX: u32 = 5;
/// Triangles are cut as coarsely as has the light of the parts uneven, by its second moment, but for this factor as much as any cut has.
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
        let count = primitive.triangle_count.saturating_mul(finest.count());
        let points = POINTS / u32::try_from(places).unwrap_or(u32::MAX).max(1) / count.max(1);
        let point = |number: u32| {
            let [u, v, ..] = sobol::point(0, number);
            warp::triangle([u, v])
        };
        let points: Vec<[f32; 2]> = (0..points.clamp(POINTS_MIN, POINTS_MAX)).map(point).collect();
        let moments = |number: u32| {
            let triangle = primitive.first_triangle + number / finest.count();
            let part = parts[(number % finest.count()) as usize];
            let sums = points.iter().fold([0.0; 2], |[sum, squares], own| {
                let share = material.emission_share(instance, triangle, part.at(*own));
                [sum + share, squares + share * share]
            });
            sums.map(|sum| sum / points.len() as f32)
        };
        let of_finest: Vec<[f32; 2]> = (0..count).into_par_iter().map(moments).collect();
        let by_level: Vec<Asked> = (0..=finest.level)
            .map(|level| Asked::merged(&of_finest, finest, Cut { level }, points.len()))
            .collect();
        let most = by_level.iter().map(Asked::unevenness).fold(1.0, f64::max);
        let asked = by_level.iter().find(|asked| asked.unevenness() * UNEVEN_LEFT >= most)?;
        let shares = asked.shares();
        shares
            .iter()
            .all(|share| share.is_finite())
            .then(|| Shares { cut: asked.cut, of_parts: shares.into() })
    }
}

/// What some points of each part told of the picture.
struct Asked {
    cut: Cut,
    /// Points of a part.
    count: f64,
    /// `[triangles × parts]`: means of their shares, and of the squares.
    moments: Vec<[f32; 2]>,
}

impl Asked {
    /// - `count`: points of a part of the finest cut
    fn merged(of_finest: &[[f32; 2]], finest: Cut, cut: Cut, count: usize) -> Asked {
        let parts = cut.count() as usize;
        let each = parts as f32 / finest.count() as f32;
        let homes: Vec<u32> = finest.parts().map(|part| cut.part_of(part.at([1.0 / 3.0; 2]))).collect();
        let mut moments = vec![[0.0; 2]; of_finest.len() / homes.len() * parts];
        for (triangle, found) in of_finest.chunks_exact(homes.len()).enumerate() {
            for (found, home) in found.iter().zip(&homes) {
                let merged = &mut moments[triangle * parts + *home as usize];
                merged.iter_mut().zip(found).for_each(|(sum, moment)| *sum += moment * each);
            }
        }
        Asked { cut, count: count as f64 / f64::from(each), moments }
    }

    /// Mean of all parts; of the squares of the parts' own means, without what chance among the points adds; and of how the light varies within
    /// a part.
    fn spread(&self) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for [mean, squares] in &self.moments {
            let mean = f64::from(*mean);
            let within = (f64::from(*squares) - mean * mean).max(0.0) * self.count / (self.count - 1.0);
            let of_part = [mean, mean * mean - within / self.count, within];
            sums.iter_mut().zip(of_part).for_each(|(sum, of_part)| *sum += of_part);
        }
        sums.map(|sum| sum / self.moments.len().max(1) as f64)
    }

    /// Second moment of the parts' light over the square of its mean; 1 where all is alike or dark.
    fn unevenness(&self) -> f64 {
        let [mean, second, _] = self.spread();
        if mean > 0.0 { (second / (mean * mean)).max(1.0) } else { 1.0 }
    }

    /// Shares of the parts: what is known of each, and of all together where that is known better [James1961], but none below the least. Of a sky
    /// of small stars each part would otherwise count by the stars that its few points happened to meet.
    fn shares(&self) -> Vec<f32> {
        let [mean, second, within] = self.spread();
        let between = (second - mean * mean).max(0.0) * self.count;
        let own = if between + within > 0.0 { between / (between + within) } else { 1.0 };
        // Of few large dark ones beside many small bright ones as well.
        let least = f64::from(LEAST) * if mean > 0.0 { mean.min(1.0) } else { 1.0 };
        let share = |[of_part, _]: &[f32; 2]| mean + (f64::from(*of_part) - mean) * own;
        self.moments.iter().map(|moments| share(moments).max(least) as f32).collect()
    }
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
        let moments: Vec<[f32; 2]> =
            (0..2 * finest.count()).map(|i| (i % 7) as f32).map(|share| [share, share * share]).collect();
        let mean =
            |moments: &[[f32; 2]]| moments.iter().map(|[mean, _]| mean).sum::<f32>() / moments.len() as f32;
        for level in 0..=3 {
            let coarse = Asked::merged(&moments, finest, Cut { level }, 16);
            assert_eq!(coarse.moments.len(), 2 << (2 * level));
            assert!((coarse.count - f64::from(16 << (2 * (3 - level)))).abs() < 1e-9);
            assert!((mean(&coarse.moments) / mean(&moments) - 1.0).abs() < 1e-5);
            let half = coarse.moments.len() / 2;
            assert!((mean(&coarse.moments[..half]) / mean(&moments[..64]) - 1.0).abs() < 1e-5);
        }
        assert_eq!(Asked::merged(&moments, finest, finest, 16).moments, moments);
    }

    /// Points that meet something by chance say nothing of a part; ones that agree do.
    #[test]
    fn chance_among_points_is_not_taken_for_a_picture() {
        let cut = Cut { level: 4 };
        let chance = |i: u32| (i.wrapping_mul(0x9e37_79b9) >> 16) as f32 / 65_536.0;
        // A fiftieth of the points meets a star of fifty, whatever part they are of.
        let starry = |part: u32| {
            let met = (0..32).filter(|point| chance(part * 32 + point) < 0.02).count() as f32;
            [met * 50.0 / 32.0, met * 2500.0 / 32.0]
        };
        let moments: Vec<[f32; 2]> = (0..2 * cut.count()).map(starry).collect();
        let sky = Asked { cut, count: 32.0, moments };
        assert!(sky.unevenness() < 1.2, "{}", sky.unevenness());
        let shares = sky.shares();
        let most = shares.iter().copied().fold(0.0, f32::max);
        assert!(shares.iter().all(|share| *share > 0.5) && most < 3.0, "{most}");
        let moments = (0..512).map(|part| if part < 8 { [64.0, 4096.0] } else { [0.0; 2] }).collect();
        let window = Asked { cut, count: 32.0, moments };
        assert!((window.unevenness() - 64.0).abs() < 1e-3 && window.shares()[0] == 64.0);
        assert!(window.shares()[8..].iter().all(|share| *share == LEAST));
    }
}
