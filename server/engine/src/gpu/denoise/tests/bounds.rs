//! What pixels that are joined come to in double precision, and how far off whoever computes in floats may be by rounding.
//!
//! Every operation of floats is off by a unit of its result at most, a quotient in WGSL by 5, a root by 9. What two pixels differ by is
//! therefore known to lie between two numbers, hence their weight, which only falls; and a mean r of values vᵢ by weights wᵢ that are off by
//! δᵢ is off by |Σ δᵢ (vᵢ − r) + Σ wᵢ εᵢ| / Σ wᵢ, where the εᵢ are what values were off by before. Weights that rounding decides belong to
//! pixels of nearly one brightness, or to none: nothing grows much from level to level.

use crate::film::denoise::{ALONE, Planes, Unjoined};

/// What one operation may be off by, as a share of its result.
const UNIT: f64 = f32::EPSILON as f64 / 2.0;
/// What lies below counts as zero on some cards.
const TINY: f64 = f32::MIN_POSITIVE as f64;
/// Terms of a sum over a pixel and the eight around it: each may be off by so many units, with its product.
const OF_SUM: f64 = 10.0 * UNIT;
const OF_QUOTIENT: f64 = 5.0 * UNIT;
const OF_ROOT: f64 = 9.0 * UNIT;

/// A number, and what computing it in floats may be off by.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Known {
    pub(super) value: f64,
    pub(super) off: f64,
}

/// A number that lies between two others.
#[derive(Clone, Copy, Debug)]
struct Between {
    least: f64,
    value: f64,
    most: f64,
}

impl Between {
    fn of(value: f64, off: f64) -> Between {
        Between { least: value - off, value, most: value + off }
    }
}

/// Light and variance of each pixel, row by row.
pub(super) type Pixels = Vec<[Known; ALONE]>;

/// The others around a pixel: rows and columns on, and weight.
fn others() -> impl Iterator<Item = (isize, isize, f64)> {
    (0..9isize).filter(|other| *other != 4).map(|other| {
        let (down, across) = (other / 3 - 1, other % 3 - 1);
        (down, across, if down == 0 || across == 0 { 0.125 } else { 0.0625 })
    })
}

/// Numbers as the kernel has them, and the picture's size.
pub(super) struct Twin<'a> {
    unjoined: &'a Unjoined<'a>,
    number: Box<dyn Fn(&str) -> f64>,
}

impl<'a> Twin<'a> {
    pub(super) fn of(unjoined: &'a Unjoined<'a>) -> Twin<'a> {
        let number = |name: &str| {
            let (_, value) = crate::film::denoise::NUMBERS.iter().find(|(known, _)| *known == name).unwrap();
            f64::from(*value)
        };
        Twin { unjoined, number: Box::new(number) }
    }

    pub(super) fn joined(&self) -> Pixels {
        let mut pixels = self.known_better();
        for level in 0..self.unjoined.levels {
            pixels = self.join(&pixels, 1 << level);
        }
        pixels
    }

    fn width(&self) -> usize {
        self.unjoined.light.width()
    }

    fn count(&self) -> usize {
        self.width() * self.unjoined.light.rows()
    }

    /// The pixel so many steps on, where there is one.
    fn beside(&self, index: usize, down: isize, across: isize, step: usize) -> Option<usize> {
        let row = (index / self.width()).checked_add_signed(down * step as isize)?;
        let column = (index % self.width()).checked_add_signed(across * step as isize)?;
        let is_there = row < self.unjoined.light.rows() && column < self.width();
        is_there.then_some(row * self.width() + column)
    }

    /// How far two surfaces differ.
    fn apart(&self, own: usize, there: usize, down: isize, across: isize, step: usize) -> Between {
        let of = |pixel: usize, plane: usize| number(self.unjoined.surfaces, pixel, plane);
        let expected = (self.number)("SLOPE")
            * step as f64
            * (of(own, 8) * across.unsigned_abs() as f64 + of(own, 9) * down.unsigned_abs() as f64);
        let between = (of(own, 6) - of(there, 6)).abs();
        let farther = (between - expected).max(0.0);
        // Differences are off by a unit each and the slopes' part by three.
        let depth = farther * of(own, 7);
        let depth_off = (2.0 * UNIT * between + 4.0 * UNIT * expected + TINY) * of(own, 7);
        let squares = |first: usize| -> f64 {
            (first..first + 3).map(|plane| (of(own, plane) - of(there, plane)).powi(2)).sum()
        };
        let rest = squares(0) * (self.number)("PER_NORMAL") + squares(3) * (self.number)("PER_ALBEDO");
        Between::of(depth + rest, depth_off + 8.0 * UNIT * (depth + rest) + TINY)
    }

    fn luminance_of(&self, [r, g, b]: [f64; 3]) -> f64 {
        let number = &self.number;
        r * number("DIFFERENCE_RED") + g * number("DIFFERENCE_GREEN") + b * number("DIFFERENCE_BLUE")
    }

    fn known_better(&self) -> Pixels {
        let light = |pixel: usize, plane: usize| number(self.unjoined.light, pixel, plane);
        let luminance = |pixel: usize| self.luminance_of([0, 1, 2].map(|plane| light(pixel, plane)));
        let of_pixel = |own: usize| {
            let mut around = vec![(own, Known { value: 1.0, off: 0.0 })];
            for (down, across, _) in others() {
                if let Some(there) = self.beside(own, down, across, 1) {
                    around.push((there, weight_of(self.apart(own, there, down, across, 1))));
                }
            }
            let mean = |value: &dyn Fn(usize) -> f64, units: f64| {
                let known = |there: usize| Known { value: value(there), off: units * UNIT * value(there) };
                mean_of(&around.iter().map(|(there, weight)| (*weight, known(*there))).collect::<Vec<_>>())
            };
            let own_variance = mean(&|there| light(there, 3), 0.0);
            let mut variance = own_variance;
            if !self.unjoined.is_believed {
                let first = mean(&luminance, 5.0);
                let second = mean(&|there| luminance(there).powi(2), 12.0);
                let value = second.value - first.value.powi(2);
                let off = second.off
                    + 2.0 * first.value * first.off
                    + first.off.powi(2)
                    + 3.0 * UNIT * (second.value + first.value.powi(2));
                variance.value = own_variance.value.max(value);
                variance.off = own_variance.off.max(off);
            }
            variance.off += TINY;
            let exact = |plane: usize| Known { value: light(own, plane), off: TINY };
            [exact(0), exact(1), exact(2), variance]
        };
        (0..self.count()).map(of_pixel).collect()
    }

    /// What differences of light are multiplied by.
    fn per_difference(&self, pixels: &Pixels, own: usize) -> Between {
        let mut sum = Known { value: 0.25 * pixels[own][3].value, off: 0.25 * pixels[own][3].off };
        for (down, across, weight) in others() {
            if let Some(there) = self.beside(own, down, across, 1) {
                sum.value += weight * pixels[there][3].value;
                sum.off += weight * pixels[there][3].off;
            }
        }
        sum.off += OF_SUM * sum.value + TINY;
        let least = 1.0 / (self.number)("WITHOUT_BOUND");
        let per = |variance: f64, off: f64| {
            (1.0 + off) / ((self.number)("DEVIATIONS") * variance.max(0.0).sqrt()).max(least)
        };
        let off = OF_ROOT + OF_QUOTIENT + 3.0 * UNIT;
        Between {
            least: per(sum.value + sum.off, -off),
            value: per(sum.value, 0.0),
            most: per(sum.value - sum.off, off),
        }
    }

    fn join(&self, pixels: &Pixels, step: usize) -> Pixels {
        let per_differences: Vec<Between> =
            (0..self.count()).map(|pixel| self.per_difference(pixels, pixel)).collect();
        let of_pixel = |own: usize| {
            let own_weight = Known { value: (self.number)("OWN_WEIGHT"), off: 0.0 };
            let mut around = vec![(own_weight, &pixels[own])];
            for (down, across, first_weight) in others() {
                let Some(there) = self.beside(own, down, across, step) else { continue };
                let difference = self.difference(&pixels[own], &pixels[there]);
                let surface = self.apart(own, there, down, across, step);
                let [per_own, per_there] = [&per_differences[own], &per_differences[there]];
                let per = Between {
                    least: per_own.least.max(per_there.least),
                    value: per_own.value.max(per_there.value),
                    most: per_own.most.max(per_there.most),
                };
                let apart = Between {
                    least: surface.least + (difference.value - difference.off).max(0.0) * per.least,
                    value: surface.value + difference.value * per.value,
                    most: surface.most + (difference.value + difference.off) * per.most,
                };
                let weight = weight_of(apart);
                let weight = Known { value: weight.value * first_weight, off: weight.off * first_weight };
                around.push((weight, &pixels[there]));
            }
            let plane = |plane: usize| {
                mean_of(&around.iter().map(|(weight, there)| (*weight, there[plane])).collect::<Vec<_>>())
            };
            [plane(0), plane(1), plane(2), variance_of(&around)]
        };
        (0..self.count()).map(of_pixel).collect()
    }

    /// How far light differs.
    fn difference(&self, own: &[Known; ALONE], there: &[Known; ALONE]) -> Known {
        let of = |part: &dyn Fn(Known, Known) -> f64| {
            self.luminance_of([0, 1, 2].map(|plane| part(own[plane], there[plane])))
        };
        let value = of(&|own, there| (own.value - there.value).abs());
        let off = of(&|own, there| own.off + there.off);
        Known { value, off: off + 5.0 * UNIT * (value + off) + TINY }
    }
}

pub(super) fn number(planes: &Planes, pixel: usize, plane: usize) -> f64 {
    f64::from(planes.place(pixel).at(plane))
}

/// The weight of what differs so much: it falls, and its three squares are off by seven units.
fn weight_of(apart: Between) -> Known {
    let of = |apart: f64| (1.0 - apart / 8.0).max(0.0).powi(8);
    // The difference from one is off by two units of one, which is as much as 16 of what differs.
    let most = of(apart.least.max(0.0) - 16.0 * UNIT).min(1.0) * (1.0 + 8.0 * UNIT) + TINY;
    let least = (of(apart.most + 16.0 * UNIT) * (1.0 - 8.0 * UNIT) - TINY).max(0.0);
    let value = of(apart.value);
    Known { value, off: (most - value).max(value - least) }
}

fn mean_of(around: &[(Known, Known)]) -> Known {
    let weights: f64 = around.iter().map(|(weight, _)| weight.value).sum();
    let least: f64 = around.iter().map(|(weight, _)| (weight.value - weight.off).max(0.0)).sum();
    let value = around.iter().map(|(weight, of)| weight.value * of.value).sum::<f64>() / weights;
    let off: f64 = around
        .iter()
        .map(|(weight, of)| weight.off * (of.value - value).abs() + (weight.value + weight.off) * of.off)
        .sum();
    // Every product may have counted as zero.
    let flushed = around.len() as f64 * TINY;
    Known { value, off: (off + flushed) / least + (2.0 * OF_SUM + OF_QUOTIENT) * value + TINY }
}

/// Variance of a mean by such weights.
fn variance_of(around: &[(Known, &[Known; ALONE])]) -> Known {
    let sums = |part: &dyn Fn(Known) -> f64| -> [f64; 2] {
        around.iter().fold([0.0; 2], |[weights, sum], (weight, of)| {
            [weights + part(*weight), sum + part(*weight).powi(2) * of[3].value]
        })
    };
    let of_values: f64 =
        around.iter().map(|(weight, of)| (weight.value + weight.off).powi(2) * of[3].off).sum();
    let [weights, sum] = sums(&|weight| weight.value);
    let [weights_least, sum_least] = sums(&|weight| (weight.value - weight.off).max(0.0));
    let [weights_most, sum_most] = sums(&|weight| weight.value + weight.off);
    let value = sum / weights.powi(2);
    let most = (sum_most + of_values) / weights_least.powi(2);
    let least = ((sum_least - of_values) / weights_most.powi(2)).max(0.0);
    let flushed = around.len() as f64 * TINY / weights_least.powi(2);
    let rounding = (4.0 * OF_SUM + OF_QUOTIENT) * most + flushed + TINY;
    Known { value, off: (most - value).max(value - least) + rounding }
}
