//! What stands for the truth where the errors of gauged pixels are relative to it.
//!
//! What the picture shows will not do where it is wrong: a room that is drawn ten times too bright would be measured by its own
//! brightness, and 14 % be shown for 74. Nor will what few samples of one pixel found: their noise would weigh itself. So
//! what is shown is corrected as far as it differs from the truth by more than chance, from the whole to its parts: by all
//! gauged pixels together, then by the two groups of them, darker and brighter, left and right or upper and lower, whose
//! ratios of truth to what is shown differ most surely, and so on (a regression tree [Breiman1984] over what is shown and
//! where, with what is uncertain shrunk), and last by the pixel alone.
//!
//! Pixels have a say in their own groups. Without, a group that lost its one bright sample would look too dark to that pixel
//! alone, whose error it would weigh, and pictures that are too dark would read worse than they are.

use super::{
    gauged::{GaugedPixel, Shown},
    measured::Around,
    standing::Standing,
};

/// Fewest pixels of a group.
const GROUP_LEAST: usize = 8;
/// Most groups at the end: more say little more and take time.
const GROUPS_MOST: usize = 64;
/// Square of the number of standard deviations at which half of a group's difference is believed.
const CHANCE: f64 = 4.0;
/// Share of a group's difference that is believed, as more than chance: with z in standard deviations z⁴ / (z⁴ + 4²).
fn belief(difference: f64, variance: f64) -> f64 {
    let (signal, noise) = (difference.powi(4), (CHANCE * variance).powi(2));
    if signal > 0.0 { signal / (signal + noise) } else { 0.0 }
}

/// Standings of all gauged pixels.
#[derive(Debug)]
pub(super) struct Weights {
    standings: Vec<[Standing; 3]>,
    /// Relative standard deviation of what each shows around, by that of the correction.
    doubts: Vec<[f64; 3]>,
    /// Group of each pixel.
    groups: Vec<usize>,
    group_count: usize,
    /// Relative standard deviation of m̄.
    mean_doubt: f64,
}

impl Weights {
    /// - `width`: of the picture, pixels
    /// - `mean`: of the picture shown, more than zero
    pub(super) fn of(pixels: &[GaugedPixel], shown: &[Shown], width: usize, mean: f64) -> Weights {
        let sight = |(place, pixel): (usize, &GaugedPixel)| {
            let around = shown[place].around.mean;
            Sighting {
                place,
                position: [around.iter().sum(), (pixel.index % width) as f64, (pixel.index / width) as f64],
                weight: [pixel.weight; 3],
                found: std::array::from_fn(|c| pixel.found(c).mean),
                variance: pixel.variance,
                shown: around,
                doubt: [0.0; 3],
                group: 0,
            }
        };
        let mut sightings: Vec<Sighting> = pixels.iter().enumerate().map(sight).collect();
        let (typical, usual) = (typical(pixels), usual(pixels, shown));
        let (factor, mean_doubt) = mean_correction(&sightings, shown, typical);
        let floor = 0.01 * (factor * mean).powi(2);
        // Noise is about as large as what is seen: so weighed every pixel says as much of its group's ratio. Else one beside a
        // lamp, bright around and dark itself, would make all of them dark.
        for one in &mut sightings {
            let shown = one.shown;
            (0..3).for_each(|c| one.weight[c] *= shown[c] / (shown[c] * shown[c] + floor));
        }
        let least = GROUP_LEAST.max(pixels.len() / GROUPS_MOST);
        let mut group_count = 0;
        correct(&mut sightings, typical, least, &mut group_count);
        sightings.sort_unstable_by_key(|one| one.place);
        let standing = |one: &Sighting| {
            std::array::from_fn(|c| Standing {
                around: one.shown[c],
                contrast: contrast_of(&shown[one.place].around, c),
                at: shown[one.place].at[c],
                usual: usual[c] / pixels[one.place].times,
                typical: typical[c] / pixels[one.place].times,
                floor,
            })
        };
        Weights {
            standings: sightings.iter().map(standing).collect(),
            doubts: sightings.iter().map(|one| one.doubt).collect(),
            groups: sightings.iter().map(|one| one.group).collect(),
            group_count,
            mean_doubt,
        }
    }

    /// Channel `c` of a pixel, by its place among the gauged ones.
    pub(super) fn at(&self, place: usize, c: usize) -> &Standing {
        &self.standings[place][c]
    }

    /// Standard deviation of the mean of the errors, by that of the groups' ratios and of the mean: what they change when each
    /// is moved by as much.
    pub(super) fn doubt(&self, pixels: &[GaugedPixel], shown: &[Shown]) -> f64 {
        let mut by_group = vec![0.0; self.group_count];
        let mut by_mean = 0.0;
        for (place, pixel) in pixels.iter().enumerate() {
            let squared = pixel.squared_errors(shown[place].at);
            for (c, squared) in squared.into_iter().enumerate() {
                let (standing, found) = (self.at(place, c), Some(pixel.found(c)));
                let times = |around: f64, mean: f64| {
                    let floor = standing.floor * mean * mean;
                    Standing { around: standing.around * around, floor, ..*standing }.weight(found)
                };
                let moved = |factor: f64| 0.5 * (times(1.0 / factor, 1.0) - times(factor, 1.0));
                let share = pixel.weight * squared / 3.0;
                // Channels of one pixel are of the same light: a group is right or wrong in all of them.
                by_group[self.groups[place]] += share * moved(1.0 + self.doubts[place][c]);
                let factor = 1.0 + self.mean_doubt;
                by_mean += share * 0.5 * (times(1.0, 1.0 / factor) - times(1.0, factor));
            }
        }
        let squares = by_group.iter().map(|change| change * change).sum::<f64>() + by_mean * by_mean;
        squares.sqrt() / pixels.len() as f64
    }
}

/// What the picture shows of the pixels around, with their variance over the square of their mean.
fn contrast_of(around: &Around, c: usize) -> f64 {
    let square = around.mean[c] * around.mean[c];
    if square > 0.0 { around.variance[c] / square } else { 0.0 }
}

/// Relative variance of what one pixel finds with the fewest samples, by what all found: that of their mean times their number. A mean
/// over pixels would not do: those that found nothing know of no variance.
fn typical(pixels: &[GaugedPixel]) -> [f64; 3] {
    std::array::from_fn(|c| {
        let [mut weights, mut found, mut variance] = [0.0; 3];
        for pixel in pixels {
            weights += pixel.weight;
            found += pixel.weight * pixel.found(c).mean;
            variance += pixel.weight * pixel.times * pixel.variance[c];
        }
        if found > 0.0 { weights * variance / (found * found) } else { 0.0 }
    })
}

/// Relative variance of what one pixel finds with the fewest samples, the median: half of the picture is known at least so well. Not the
/// mean, in which a few noisy pixels are all: on bunny-room and dragon-room that was a deviation of 29 and 48 %, of 5 and 6 % at most pixels,
/// so that nothing they found was believed and what lies in shadow weighed by the light around it, a fifth too little.
fn usual(pixels: &[GaugedPixel], shown: &[Shown]) -> [f64; 3] {
    std::array::from_fn(|c| {
        let of = |(pixel, shown): (&GaugedPixel, &Shown)| {
            let mean = pixel.found(c).mean;
            let variance = pixel.times * pixel.variance[c];
            let relative = if mean > 0.0 { variance / (mean * mean) } else { f64::INFINITY };
            // Where nothing is shown and nothing found there is nothing to be weighed.
            (mean > 0.0 || shown.around.mean[c] > 0.0).then_some((relative, pixel.weight))
        };
        let mut known: Vec<(f64, f64)> = pixels.iter().zip(shown).filter_map(of).collect();
        known.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut left = 0.5 * known.iter().map(|(_, weight)| weight).sum::<f64>();
        let median = known.iter().find(|(_, weight)| {
            left -= weight;
            left <= 0.0
        });
        median.map_or(0.0, |(relative, _)| *relative)
    })
}

/// Factor on the picture's mean by what all pixels show and found, and its relative standard deviation.
fn mean_correction(sightings: &[Sighting], shown: &[Shown], typical: [f64; 3]) -> (f64, f64) {
    let grey = |one: &Sighting| {
        // Channels of one pixel err together.
        let deviation: f64 = one.variance.iter().map(|variance| variance.sqrt()).sum();
        Sighting {
            found: [one.found.iter().sum(); 3],
            shown: [shown[one.place].at.iter().sum(); 3],
            variance: [deviation * deviation; 3],
            ..*one
        }
    };
    let sightings: Vec<Sighting> = sightings.iter().map(grey).collect();
    Pool::of(&sightings, 0, typical.into_iter().fold(0.0, f64::max)).correction()
}

/// One pixel as it counts in a group.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    /// Among the gauged ones.
    place: usize,
    /// How bright the picture is around it, column and row.
    position: [f64; 3],
    /// In the sums of its groups.
    weight: [f64; 3],
    found: [f64; 3],
    variance: [f64; 3],
    /// What the picture shows around it, corrected by the groups looked at so far.
    shown: [f64; 3],
    /// Relative standard deviation of the last correction.
    doubt: [f64; 3],
    group: usize,
}

/// Sums over the pixels of a group, of one channel.
#[derive(Clone, Copy, Debug, Default)]
struct Pool {
    found: f64,
    shown: f64,
    /// Of squared differences of what was found from what the group's ratio foretells.
    spread: f64,
    count: usize,
}

impl Pool {
    /// - `typical`: relative variance of what is found
    fn of(group: &[Sighting], c: usize, typical: f64) -> Pool {
        let (found, shown) = group.iter().fold((0.0, 0.0), |(found, shown), one| {
            (found + one.weight[c] * one.found[c], shown + one.weight[c] * one.shown[c])
        });
        let pool = Pool { found, shown, spread: 0.0, count: group.len() };
        let spread = group.iter().map(|one| pool.spread_of(one, c, typical)).sum();
        Pool { spread, ..pool }
    }

    fn ratio(&self) -> f64 {
        if self.shown > 0.0 { self.found / self.shown } else { 1.0 }
    }

    /// What a pixel adds to the spread. Samples that have found nothing agree: it is at least what is usual.
    fn spread_of(&self, one: &Sighting, c: usize, typical: f64) -> f64 {
        let off = one.found[c] - self.ratio() * one.shown[c];
        let least = one.variance[c].max(typical * one.shown[c] * one.shown[c]);
        one.weight[c] * one.weight[c] * (off * off).max(least)
    }

    /// Variance of the ratio.
    fn variance(&self) -> f64 {
        if self.count < 2 || self.shown <= 0.0 {
            return 0.0;
        }
        let count = self.count as f64;
        self.spread.max(0.0) * count / (count - 1.0) / (self.shown * self.shown)
    }

    /// Factor on what is shown, and the relative standard deviation of it.
    fn correction(&self) -> (f64, f64) {
        if self.count < 2 || self.shown <= 0.0 {
            return (1.0, 0.0);
        }
        if self.found <= 0.0 {
            // Light that was not found may be there: nothing is known of how bright the truth is.
            return (1.0, 1.0);
        }
        let (off, variance) = (self.ratio() - 1.0, self.variance());
        let factor = 1.0 + belief(off, variance) * off;
        (factor, variance.sqrt() / factor.max(f64::MIN_POSITIVE))
    }
}

/// Corrects what is shown in a group, and then in its parts.
///
/// - `least`: pixels of a part
/// - `group_count`: of groups that are not parted any more
fn correct(group: &mut [Sighting], typical: [f64; 3], least: usize, group_count: &mut usize) {
    // Twice: what is usual is the less the darker the truth, which the first time is not known.
    for _ in 0..2 {
        let corrections = [0, 1, 2].map(|c| Pool::of(group, c, typical[c]).correction());
        for one in &mut *group {
            for (c, (factor, doubt)) in corrections.into_iter().enumerate() {
                one.shown[c] *= factor;
                one.doubt[c] = doubt;
            }
        }
    }
    if group.len() < 2 * least {
        group.iter_mut().for_each(|one| one.group = *group_count);
        *group_count += 1;
        return;
    }
    let mut best = (-1.0, 0, group.len() / 2);
    for axis in 0..3 {
        for cut in cuts(group.len(), least) {
            split(group, axis, cut);
            let contrast = contrast(&group[..cut], &group[cut..], typical);
            if contrast > best.0 {
                best = (contrast, axis, cut);
            }
        }
    }
    let (_, axis, cut) = best;
    split(group, axis, cut);
    let (low, high) = group.split_at_mut(cut);
    correct(low, typical, least, group_count);
    correct(high, typical, least, group_count);
}

/// Sizes of the first part: a half, a quarter and three quarters, as far as either part has enough pixels.
fn cuts(count: usize, least: usize) -> impl Iterator<Item = usize> {
    [2, 1, 3]
        .into_iter()
        .map(move |quarters| count * quarters / 4)
        .filter(move |cut| *cut >= least && count - cut >= least)
}

/// So many of the pixels by brightness, column or row first.
fn split(group: &mut [Sighting], axis: usize, cut: usize) {
    let order = |a: &Sighting, b: &Sighting| {
        a.position[axis].total_cmp(&b.position[axis]).then_with(|| a.place.cmp(&b.place))
    };
    group.select_nth_unstable_by(cut, order);
}

/// Squared difference of two groups' ratios over its variance, the largest of the channels.
fn contrast(low: &[Sighting], high: &[Sighting], typical: [f64; 3]) -> f64 {
    let of_channel = |c: usize| {
        let [low, high] = [low, high].map(|group| Pool::of(group, c, typical[c]));
        let variance = low.variance() + high.variance();
        if variance > 0.0 { (low.ratio() - high.ratio()).powi(2) / variance } else { 0.0 }
    };
    (0..3).map(of_channel).fold(0.0, f64::max)
}
