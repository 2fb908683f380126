//! What the filter makes of eight pixels and those around them.

use fearless_simd::{Simd, SimdBase, SimdFloat, f32x8};

use super::planes::{MARGIN, OfEight, Planes};

/// Standard deviations, of the better known of two pixels, at which light differs by as much as surfaces do below. At 2, 12 % of the noise on
/// an even sheet is left; at 2.9 more light goes into shadows.
const DEVIATIONS: f32 = 2.25;
/// Differences of unit normals, of depths as a share, and of albedos, at which surfaces count as others: weights are e times less.
const NORMAL: f32 = 0.2;
pub(crate) const DEPTH: f32 = 0.02;
const ALBEDO: f32 = 0.1;
/// How many times as far off as its slope says a depth may be.
const SLOPE: f32 = 1.5;
/// Stands for one over nothing: whatever is compared by it differs beyond all bounds or not at all.
pub(super) const WITHOUT_BOUND: f32 = 1e30;
/// (1 − x/8)⁸ stands for e⁻ˣ: three squarings, and nothing from 8 on.
const PER_APART: f32 = 0.125;
/// Luminance of the size of a difference in each channel [Rec.709]: two colours of one luminance differ as well.
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Planes of what tells surfaces apart.
const NORMAL_PLANES: [usize; 3] = [0, 1, 2];
const ALBEDO_PLANES: [usize; 3] = [3, 4, 5];
const DEPTH_PLANE: usize = 6;
/// 1 / (depth at which surfaces differ).
const PER_DEPTH_PLANE: usize = 7;
/// Change of the depth from column to column, and from row to row.
const SLOPE_PLANES: [usize; 2] = [8, 9];
pub(crate) const SURFACE_PLANES: usize = 10;

/// Weight of a pixel itself in what is joined; with those around it is one.
const OWN_WEIGHT: f32 = 0.25;

/// Weights of others before surfaces or light are looked at: of those diagonally off, and of those beside.
const CORNER_WEIGHT: f32 = 0.0625;
const SIDE_WEIGHT: f32 = 0.125;

/// The numbers above by name, for shaders that compute the same.
#[cfg(feature = "gpu")]
pub(crate) const NUMBERS: [(&str, f32); 12] = [
    ("DEVIATIONS", DEVIATIONS),
    ("PER_NORMAL", 1.0 / (NORMAL * NORMAL)),
    ("PER_ALBEDO", 1.0 / (ALBEDO * ALBEDO)),
    ("SLOPE", SLOPE),
    ("DIFFERENCE_RED", LUMINANCE[0]),
    ("DIFFERENCE_GREEN", LUMINANCE[1]),
    ("DIFFERENCE_BLUE", LUMINANCE[2]),
    ("WITHOUT_BOUND", WITHOUT_BOUND),
    ("PER_APART", PER_APART),
    ("OWN_WEIGHT", OWN_WEIGHT),
    ("SIDE_WEIGHT", SIDE_WEIGHT),
    ("CORNER_WEIGHT", CORNER_WEIGHT),
];

/// The planes above by name: of three numbers or two the first.
#[cfg(feature = "gpu")]
pub(crate) const PLANES: [(&str, usize); 6] = [
    ("NORMAL_PLANE", NORMAL_PLANES[0]),
    ("ALBEDO_PLANE", ALBEDO_PLANES[0]),
    ("DEPTH_PLANE", DEPTH_PLANE),
    ("PER_DEPTH_PLANE", PER_DEPTH_PLANE),
    ("SLOPE_PLANE", SLOPE_PLANES[0]),
    ("SURFACE_PLANES", SURFACE_PLANES),
];

/// Others around each pixel of a row.
struct Beside {
    /// Their row.
    row: usize,
    /// Column of those around the eight pixels that begin at column 0, as [`Planes::eight`] has it.
    column: usize,
    /// How far they are, in pixels.
    across: f32,
    down: f32,
    /// Before surfaces or light are looked at.
    weight: f32,
}

/// The eight others around a pixel: by row and column before, here and after, with their weights.
const OTHERS: [([usize; 2], f32); 8] = [
    ([0, 0], CORNER_WEIGHT),
    ([0, 1], SIDE_WEIGHT),
    ([0, 2], CORNER_WEIGHT),
    ([1, 0], SIDE_WEIGHT),
    ([1, 2], SIDE_WEIGHT),
    ([2, 0], CORNER_WEIGHT),
    ([2, 1], SIDE_WEIGHT),
    ([2, 2], CORNER_WEIGHT),
];

impl Beside {
    /// `None` where their row is not there.
    #[inline(always)]
    fn at(
        ([vertical, horizontal], weight): ([usize; 2], f32),
        [rows, y, step]: [usize; 3],
    ) -> Option<Beside> {
        let row = y + vertical * step;
        if row < step || row - step >= rows {
            return None;
        }
        let across = if horizontal == 1 { 0.0 } else { step as f32 };
        let down = if vertical == 1 { 0.0 } else { step as f32 };
        Some(Beside { row: row - step, column: MARGIN + horizontal * step - step, across, down, weight })
    }
}

/// e to the minus what pixels differ by, nearly: nothing from 8 on.
#[inline(always)]
fn weight_of<S: Simd>(apart: f32x8<S>) -> f32x8<S> {
    let simd = apart.simd;
    let base = (f32x8::splat(simd, 1.0) - apart * f32x8::splat(simd, PER_APART)).max(f32x8::splat(simd, 0.0));
    let fourth = (base * base) * (base * base);
    fourth * fourth
}

#[inline(always)]
fn luminance_of<S: Simd>(simd: S, [r, g, b]: [f32x8<S>; 3]) -> f32x8<S> {
    let [of_r, of_g, of_b] = LUMINANCE;
    r * f32x8::splat(simd, of_r) + g * f32x8::splat(simd, of_g) + b * f32x8::splat(simd, of_b)
}

/// Some planes of eight pixels from the first on. A loop, as others here: what is passed to functions of the standard library is not
/// compiled for the instructions that it is dispatched to.
#[inline(always)]
fn planes_at<S: Simd, const COUNT: usize>(
    simd: S,
    planes: &Planes,
    y: usize,
    column: usize,
) -> [f32x8<S>; COUNT] {
    let mut eights = [f32x8::splat(simd, 0.0); COUNT];
    for (plane, eight) in eights.iter_mut().enumerate() {
        *eight = planes.eight(simd, y, plane, column);
    }
    eights
}

/// The surfaces of eight pixels.
struct Own<S: Simd> {
    planes: [f32x8<S>; SURFACE_PLANES],
}

impl<S: Simd> Own<S> {
    #[inline(always)]
    fn of(simd: S, surfaces: &Planes, y: usize, x: usize) -> Own<S> {
        Own { planes: planes_at(simd, surfaces, y, MARGIN + x) }
    }

    /// How far they differ from those of others.
    #[inline(always)]
    fn apart_from(&self, simd: S, surfaces: &Planes, beside: &Beside, x: usize) -> f32x8<S> {
        let Beside { row, column, across, down, .. } = *beside;
        let there: [f32x8<S>; DEPTH_PLANE + 1] = planes_at(simd, surfaces, row, column + x);
        let [across, down] = [f32x8::splat(simd, SLOPE * across), f32x8::splat(simd, SLOPE * down)];
        let expected = self.planes[SLOPE_PLANES[0]] * across + self.planes[SLOPE_PLANES[1]] * down;
        let farther = (self.planes[DEPTH_PLANE] - there[DEPTH_PLANE]).abs() - expected;
        let mut apart = farther.max(f32x8::splat(simd, 0.0)) * self.planes[PER_DEPTH_PLANE];
        for (planes, scale) in [(NORMAL_PLANES, NORMAL), (ALBEDO_PLANES, ALBEDO)] {
            let mut squares = f32x8::splat(simd, 0.0);
            for plane in planes {
                let off = self.planes[plane] - there[plane];
                squares += off * off;
            }
            apart += squares * f32x8::splat(simd, 1.0 / (scale * scale));
        }
        apart
    }
}

/// Light with the variance that the first level goes by: that of few samples is hardly known and is joined with what lies around; of
/// fewer it is how light differs there, if that is more.
pub(super) struct KnownBetter<'a> {
    pub(super) surfaces: &'a Planes,
    pub(super) light: &'a Planes,
    /// Of its own the variance is believed.
    pub(super) is_believed: bool,
}

impl<const PLANES: usize> OfEight<PLANES> for KnownBetter<'_> {
    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, y: usize, x: usize) -> [f32x8<S>; PLANES] {
        let KnownBetter { surfaces, light, is_believed } = *self;
        let last = PLANES - 1;
        let surface = Own::of(simd, surfaces, y, x);
        let mut known: [f32x8<S>; PLANES] = planes_at(simd, light, y, MARGIN + x);
        let own = luminance_of(simd, planes_at(simd, light, y, MARGIN + x));
        let mut sums = if is_believed { f32x8::splat(simd, 0.0) } else { own };
        let mut squares = sums * sums;
        let mut weights = f32x8::splat(simd, 1.0);
        for other in OTHERS {
            let Some(beside) = Beside::at(other, [light.rows(), y, 1]) else { continue };
            let of_others = weight_of(surface.apart_from(simd, surfaces, &beside, x));
            known[last] += of_others * light.eight(simd, beside.row, last, beside.column + x);
            weights += of_others;
            if !is_believed {
                let there = luminance_of(simd, planes_at(simd, light, beside.row, beside.column + x));
                sums += of_others * there;
                squares += of_others * there * there;
            }
        }
        let mean = sums / weights;
        known[last] = (known[last] / weights).max(squares / weights - mean * mean);
        known
    }
}

/// What differences of light are multiplied by at a level: one over the deviations at which they count, by the variance around.
pub(super) struct PerDifference<'a> {
    pub(super) light: &'a Planes,
}

impl OfEight<1> for PerDifference<'_> {
    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, y: usize, x: usize) -> [f32x8<S>; 1] {
        let last = self.light.count() - 1;
        let mut variance = self.light.eight(simd, y, last, MARGIN + x) * f32x8::splat(simd, OWN_WEIGHT);
        for other in OTHERS {
            let place = [self.light.rows(), y, 1];
            let Some(Beside { row, column, weight, .. }) = Beside::at(other, place) else { continue };
            variance += self.light.eight(simd, row, last, column + x) * f32x8::splat(simd, weight);
        }
        let deviations = f32x8::splat(simd, DEVIATIONS) * variance.sqrt();
        [f32x8::splat(simd, 1.0) / deviations.max(f32x8::splat(simd, 1.0 / WITHOUT_BOUND))]
    }
}

/// One level: pixels so many apart are joined. How far light may differ is one for both of two: what the better known of them allows. By its
/// own deviations alone a pixel that found rare light took in those around that found none, and they nothing of it: light was lost.
pub(super) struct Joined<'a> {
    pub(super) surfaces: &'a Planes,
    pub(super) light: &'a Planes,
    pub(super) per_difference: &'a Planes,
    pub(super) step: usize,
}

impl<const PLANES: usize> OfEight<PLANES> for Joined<'_> {
    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, y: usize, x: usize) -> [f32x8<S>; PLANES] {
        let Joined { surfaces, light, per_difference: per_differences, step } = *self;
        let last = PLANES - 1;
        let surface = Own::of(simd, surfaces, y, x);
        let own: [f32x8<S>; PLANES] = planes_at(simd, light, y, MARGIN + x);
        let per_own = per_differences.eight(simd, y, 0, MARGIN + x);
        let own_weight = f32x8::splat(simd, OWN_WEIGHT);
        let mut sums = own;
        for sums in &mut sums {
            *sums *= own_weight;
        }
        sums[last] *= own_weight;
        let mut weights = own_weight;
        for other in OTHERS {
            let Some(beside) = Beside::at(other, [light.rows(), y, step]) else { continue };
            let there: [f32x8<S>; PLANES] = planes_at(simd, light, beside.row, beside.column + x);
            let differences =
                [(own[0] - there[0]).abs(), (own[1] - there[1]).abs(), (own[2] - there[2]).abs()];
            let per_there = per_differences.eight(simd, beside.row, 0, beside.column + x);
            let apart = surface.apart_from(simd, surfaces, &beside, x)
                + luminance_of(simd, differences) * per_own.max(per_there);
            let of_others = weight_of(apart) * f32x8::splat(simd, beside.weight);
            for (sums, there) in sums[..last].iter_mut().zip(there) {
                *sums += of_others * there;
            }
            sums[last] += of_others * of_others * there[last];
            weights += of_others;
        }
        for sums in &mut sums[..last] {
            *sums /= weights;
        }
        sums[last] /= weights * weights;
        sums
    }
}
