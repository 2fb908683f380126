//! k-means of the photons of a leaf into a few virtual directional lights [Vivanloc2007, 3.1.2].
//!
//! Directions are clustered by their chord on the unit sphere, weighted by the luminance they bring to a surface that faces
//! them: the mean direction of Σ E ω / cos is the one whose light lights surfaces of any normal like the photons themselves, as
//! long as all lie above the horizon. A centre is the normalised weighted mean of its members: for unit vectors |d − c|² = 2 − 2 d·c, so that this is the unit
//! centre with the least weighted sum of squared chords, and the nearest centre is the one with the largest cosine.
//!
//! This runs for every leaf of the octree and is the hot loop of building it, hence its form: coordinates in arrays
//! of their own, padded to whole blocks, and loops over blocks of a fixed size that the compiler turns into vector instructions.

use glam::Vec3;

use super::harmonics::COSINE_MIN;
use crate::{
    math::{Rgb, sobol::mix},
    technique::GatheredPhoton,
    transport::schlick_rise,
};

/// Most lights of one leaf.
pub(super) const VDL_COUNT_MAX: usize = 8;
/// Most rounds of assigning and averaging. Four lights for 300 photons, half of them from three lamps and half from a
/// diffuse hemisphere: the spread is 3 % above that of endless rounds after 4, 1.5 % after 6, 0.8 % after 8.
const ROUND_COUNT_MAX: usize = 8;
/// Photons to a block: two registers of four numbers, which hides the latency of one behind the other.
const LANE_COUNT: usize = 8;
/// Sums of means kept apart: four additions are under way at a time.
const BANK_COUNT: usize = 4;
/// Chord (root mean square, or of one photon) at which one more light shows nothing: 0.03°, a ninth of the Sun's
/// radius, and as little as a single-precision cosine tells apart (√(2 · 2⁻²⁴) = 3.5 · 10⁻⁴).
const CHORD_NEGLIGIBLE: f32 = 5e-4;
/// Squared diameter of the unit sphere.
const SQUARED_CHORD_MAX: f32 = 4.0;
/// A mean direction shorter than this, relative to its weights, is rounding: hundreds of sums of 2⁻²⁴ each.
const MEAN_LENGTH_MIN: f32 = 1e-4;

type Lanes = [f32; LANE_COUNT];

/// A virtual directional light: what a leaf's surface gets from about one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vdl {
    /// Unit vector towards where the light comes from.
    pub direction: Vec3,
    /// Irradiance on the leaf's surface, W/m².
    pub irradiance: Rgb,
}

/// How well the lights stand for the photons.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Spread {
    /// Root mean square chord between a photon's direction and its light's, 0 to 2; weighted by the luminance that each brings to what
    /// faces it.
    pub(super) chord_rms: f32,
    /// Mean of [`schlick_rise`] over the luminance that photons bring, 0 to 1: what a coat reflects of them.
    pub(super) rise: f32,
    /// Photons left out because their direction is not a unit vector or their irradiance not a finite positive number.
    pub(super) dropped_count: u32,
}

impl Spread {
    /// The angle under which the chord is seen, the angular error of [Vivanloc2007, fig. 17].
    pub(super) fn degrees(self) -> f32 {
        2.0 * (0.5 * self.chord_rms).min(1.0).asin().to_degrees()
    }
}

/// Memory for clustering, to be used for one leaf after another.
#[derive(Clone, Debug, Default)]
pub(super) struct Clustering {
    photons: Photons,
    centres: Centres,
}

impl Clustering {
    /// Appends at most `count_max` lights that stand for `photons`, the same for the same input.
    ///
    /// The irradiances of the lights sum to those of the photons, to single-precision rounding of each light's sum.
    /// Directions are a biased summary: shadows between a photon and its light's direction are lost.
    ///
    /// - `n_set`: unit normal of the surface that the irradiance was measured on
    /// - `count_max`: 1 to [`VDL_COUNT_MAX`]; fewer lights come where fewer directions do, none without irradiance
    /// - `key`: names the random numbers of the first centres
    pub(super) fn cluster(
        &mut self,
        photons: &[GatheredPhoton],
        n_set: Vec3,
        count_max: usize,
        key: u64,
        vdls: &mut Vec<Vdl>,
    ) -> Spread {
        let dropped_count = self.photons.fill(photons, n_set);
        let weight = self.photons.weight();
        if weight == 0.0 {
            return Spread { dropped_count, ..Spread::default() };
        }
        self.seed(count_max.clamp(1, VDL_COUNT_MAX), key, weight);
        self.refine();
        let squared_chords = self.photons.emit(&self.centres, vdls);
        let chord_rms = (squared_chords / f64::from(weight)).sqrt() as f32;
        Spread { chord_rms, rise: self.photons.rise, dropped_count }
    }

    /// The first centres, as k-means++ picks them [Arthur2007]: photons, with a chance in proportion to weight times
    /// squared chord to the nearest centre so far. Labels every photon with the nearest one.
    fn seed(&mut self, count_max: usize, key: u64, weight: f32) {
        self.centres.count = 0;
        let mut chances = SQUARED_CHORD_MAX * weight;
        while self.centres.count < count_max && chances > CHORD_NEGLIGIBLE * CHORD_NEGLIGIBLE * weight {
            // The upper 24 bits are a number in [0, 1) that single precision holds exactly.
            let number = mix(key ^ mix(self.centres.count as u64 + 1)) >> 40;
            let share = number as f32 * (1.0 / 16_777_216.0);
            let direction = self.photons.direction(self.photons.chosen(share * chances));
            chances = self.photons.come_nearer(direction, self.centres.count as u32);
            self.centres.direction[self.centres.count] = direction;
            self.centres.count += 1;
        }
    }

    /// Lloyd's rounds, from labels to centres and back, until the labels stay or the rounds are used up. Either way
    /// the centres are those of the labels at the end.
    fn refine(&mut self) {
        for _ in 1..ROUND_COUNT_MAX {
            self.average();
            if !self.photons.assign(&self.centres) {
                return;
            }
        }
        self.average();
    }

    /// Moves every centre to the mean of its members. A centre without members first takes over the photon that is
    /// farthest from its own centre, if any is off at all; then the means are others, but one centre fewer is empty.
    fn average(&mut self) {
        // One of the centres has members for certain, so the last round finds no empty one that could be filled.
        for _ in 0..VDL_COUNT_MAX {
            let means = self.photons.means();
            self.move_to(&means);
            let Some(empty) = (0..self.centres.count).find(|label| means[*label][3] == 0.0) else { return };
            let Some(index) = self.photons.farthest(&self.centres) else { return };
            self.photons.set_label(index, empty as u32);
        }
    }

    /// Moves the centres of labels that have members.
    fn move_to(&mut self, means: &Means) {
        for (label, [x, y, z, weight]) in means.iter().copied().enumerate() {
            let mean = Vec3::new(x, y, z);
            let length = mean.length();
            if length > MEAN_LENGTH_MIN * weight {
                self.centres.direction[label] = mean / length;
            } else if weight > 0.0 {
                // Members on opposite sides have no mean direction.
                self.centres.direction[label] = self.photons.brightest(label as u32);
            }
        }
    }
}

/// Directions of the lights to be.
#[derive(Clone, Debug, Default)]
struct Centres {
    /// Unit vectors, the first `count` of them in use.
    direction: [Vec3; VDL_COUNT_MAX],
    count: usize,
}

/// By label: the sum of weight times direction, and the sum of weights.
type Means = [[f32; 4]; VDL_COUNT_MAX];

/// Photons side by side. Those that only fill the last block have no direction and no weight.
#[derive(Clone, Copy, Debug)]
struct Block {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    /// Squared chord to the nearest of the first centres.
    squared_chord: Lanes,
    /// Index of the photon's centre.
    label: [u32; LANE_COUNT],
    /// Luminance that a surface gets of it which faces it, relative to the brightest photon.
    weight: Lanes,
    /// Weight times direction, and weight: what a photon adds to its mean, side by side for one addition.
    share: [[f32; 4]; LANE_COUNT],
}

impl Block {
    const EMPTY: Block = Block {
        x: [0.0; LANE_COUNT],
        y: [0.0; LANE_COUNT],
        z: [0.0; LANE_COUNT],
        squared_chord: [SQUARED_CHORD_MAX; LANE_COUNT],
        label: [0; LANE_COUNT],
        weight: [0.0; LANE_COUNT],
        share: [[0.0; 4]; LANE_COUNT],
    };

    /// [`Block::scale`] makes the weight relative.
    fn set(&mut self, lane: usize, direction: Vec3, weight: f32) {
        [self.x[lane], self.y[lane], self.z[lane]] = direction.to_array();
        self.weight[lane] = weight;
    }

    fn scale(&mut self, factor: f32) {
        self.weight = self.weight.map(|weight| weight * factor);
        self.share = std::array::from_fn(|lane| {
            let weight = self.weight[lane];
            [self.x[lane] * weight, self.y[lane] * weight, self.z[lane] * weight, weight]
        });
    }

    fn direction(&self, lane: usize) -> Vec3 {
        Vec3::new(self.x[lane], self.y[lane], self.z[lane])
    }

    /// Chance of each photon to become the next first centre.
    fn chances(&self) -> Lanes {
        std::array::from_fn(|lane| self.weight[lane] * self.squared_chord[lane])
    }
}

/// The photons of one leaf that bring light.
#[derive(Clone, Debug, Default)]
struct Photons {
    blocks: Vec<Block>,
    /// `[n]`, without the filling.
    irradiance: Vec<Rgb>,
    /// See [`Spread::rise`].
    rise: f32,
}

impl Photons {
    /// Takes the photons that bring light, and returns how many made no sense.
    fn fill(&mut self, photons: &[GatheredPhoton], n_set: Vec3) -> u32 {
        self.blocks.clear();
        self.irradiance.clear();
        let (mut dropped_count, mut brightest) = (0, 0f32);
        let [mut rise, mut sum] = [0f64; 2];
        for photon in photons {
            if !photon.is_sound() {
                dropped_count += 1;
                continue;
            }
            let luminance = photon.irradiance.luminance();
            if luminance > 0.0 {
                let cos = n_set.dot(photon.direction);
                let weight = (luminance / cos.max(COSINE_MIN)).min(f32::MAX);
                rise += f64::from(luminance.min(f32::MAX)) * f64::from(schlick_rise(cos));
                sum += f64::from(luminance.min(f32::MAX));
                brightest = brightest.max(weight);
                self.push(photon, weight);
            }
        }
        // Weights of order one neither overflow nor vanish in their sums, whatever the unit of power.
        self.rise = if sum > 0.0 { (rise / sum) as f32 } else { 0.0 };
        let factor = 1.0 / brightest.max(f32::MIN_POSITIVE);
        self.blocks.iter_mut().for_each(|block| block.scale(factor));
        dropped_count
    }

    fn push(&mut self, photon: &GatheredPhoton, weight: f32) {
        let lane = self.irradiance.len() % LANE_COUNT;
        if lane == 0 {
            self.blocks.push(Block::EMPTY);
        }
        if let Some(block) = self.blocks.last_mut() {
            block.set(lane, photon.direction, weight);
        }
        self.irradiance.push(photon.irradiance);
    }

    fn direction(&self, index: usize) -> Vec3 {
        self.blocks[index / LANE_COUNT].direction(index % LANE_COUNT)
    }

    fn set_label(&mut self, index: usize, label: u32) {
        self.blocks[index / LANE_COUNT].label[index % LANE_COUNT] = label;
    }

    /// All photons that are not filling, with the block they are in: (index, block, lane).
    fn each(&self) -> impl Iterator<Item = (usize, &Block, usize)> {
        (0..self.irradiance.len()).map(|index| (index, &self.blocks[index / LANE_COUNT], index % LANE_COUNT))
    }

    /// Sum of all weights.
    fn weight(&self) -> f32 {
        self.blocks.iter().map(|block| lane_sum(block.weight)).sum()
    }

    /// The photon at which the running sum of chances passes `target`; the last with a chance if rounding ate the
    /// rest.
    fn chosen(&self, mut target: f32) -> usize {
        let mut last = 0;
        for (index, block) in self.blocks.iter().enumerate() {
            let chances = block.chances();
            let sum = lane_sum(chances);
            if target >= sum && index + 1 < self.blocks.len() {
                target -= sum;
                continue;
            }
            for (lane, chance) in chances.into_iter().enumerate().filter(|(_, chance)| *chance > 0.0) {
                last = index * LANE_COUNT + lane;
                if target < chance {
                    return last;
                }
                target -= chance;
            }
        }
        last
    }

    /// Labels the photons that are nearer to a new centre than to all before it. Returns the new sum of chances.
    fn come_nearer(&mut self, centre: Vec3, new_label: u32) -> f32 {
        let mut sums = [0.0; LANE_COUNT];
        for block in &mut self.blocks {
            // Copies, since the compiler makes branches of conditional stores and these are not predictable.
            let (mut label, mut nearest) = (block.label, block.squared_chord);
            for lane in 0..LANE_COUNT {
                let [x, y, z] =
                    [block.x[lane] - centre.x, block.y[lane] - centre.y, block.z[lane] - centre.z];
                let squared_chord = x * x + y * y + z * z;
                let is_nearer = squared_chord < nearest[lane];
                label[lane] = if is_nearer { new_label } else { label[lane] };
                nearest[lane] = if is_nearer { squared_chord } else { nearest[lane] };
            }
            (block.label, block.squared_chord) = (label, nearest);
            sums = add(sums, block.chances());
        }
        lane_sum(sums)
    }

    /// Labels every photon with the nearest centre. Returns whether any label changed.
    fn assign(&mut self, centres: &Centres) -> bool {
        let mut changes = [0; LANE_COUNT];
        for block in &mut self.blocks {
            let mut nearest = [f32::MIN; LANE_COUNT];
            let mut label = [0; LANE_COUNT];
            for (centre, number) in centres.direction[..centres.count].iter().zip(0..) {
                for lane in 0..LANE_COUNT {
                    let cosine =
                        block.x[lane] * centre.x + block.y[lane] * centre.y + block.z[lane] * centre.z;
                    let is_nearer = cosine > nearest[lane];
                    label[lane] = if is_nearer { number } else { label[lane] };
                    nearest[lane] = if is_nearer { cosine } else { nearest[lane] };
                }
            }
            for lane in 0..LANE_COUNT {
                changes[lane] |= label[lane] ^ block.label[lane];
            }
            block.label = label;
        }
        changes != [0; LANE_COUNT]
    }

    fn means(&self) -> Means {
        // Neighbours add to sums of their own, so that an addition need not wait for the one before it.
        let mut banks = [Means::default(); BANK_COUNT];
        for block in &self.blocks {
            for lane in 0..LANE_COUNT {
                let sum = &mut banks[lane % BANK_COUNT][block.label[lane] as usize % VDL_COUNT_MAX];
                *sum = std::array::from_fn(|k| sum[k] + block.share[lane][k]);
            }
        }
        let total = |label: usize, k: usize| banks.iter().map(|bank| bank[label][k]).sum();
        std::array::from_fn(|label| std::array::from_fn(|k| total(label, k)))
    }

    /// Direction of the member that brings most light.
    fn brightest(&self, label: u32) -> Vec3 {
        let members = self.each().filter(|(_, block, lane)| block.label[*lane] == label);
        let brightest = members.max_by(|a, b| a.1.weight[a.2].total_cmp(&b.1.weight[b.2]));
        brightest.map_or(Vec3::Z, |(_, block, lane)| block.direction(lane).normalize())
    }

    /// The photon farthest from its centre; none when all are where their centres are.
    fn farthest(&self, centres: &Centres) -> Option<usize> {
        let chords =
            self.each().filter(|(_, block, lane)| block.weight[*lane] > 0.0).map(|(index, block, lane)| {
                let centre = centres.direction[block.label[lane] as usize % VDL_COUNT_MAX];
                (block.direction(lane).distance_squared(centre), index)
            });
        let (squared_chord, index) = chords.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (squared_chord > CHORD_NEGLIGIBLE * CHORD_NEGLIGIBLE).then_some(index)
    }

    /// Appends the lights. Returns the sum of weight times squared chord.
    fn emit(&self, centres: &Centres, vdls: &mut Vec<Vdl>) -> f64 {
        let mut irradiance = [[0f64; 3]; VDL_COUNT_MAX];
        let mut squared_chords = 0.0;
        for (block, members) in self.blocks.iter().zip(self.irradiance.chunks(LANE_COUNT)) {
            for (lane, member) in members.iter().enumerate() {
                let label = block.label[lane] as usize % VDL_COUNT_MAX;
                let chord = block.direction(lane) - centres.direction[label];
                squared_chords += f64::from(block.weight[lane] * chord.length_squared());
                let sum = &mut irradiance[label];
                *sum = [
                    sum[0] + f64::from(member.r),
                    sum[1] + f64::from(member.g),
                    sum[2] + f64::from(member.b),
                ];
            }
        }
        for (direction, sum) in centres.direction.into_iter().zip(irradiance).take(centres.count) {
            let irradiance = Rgb::from(sum.map(|channel| channel as f32));
            if !irradiance.is_black() {
                vdls.push(Vdl { direction, irradiance });
            }
        }
        squared_chords
    }
}

fn add(a: Lanes, b: Lanes) -> Lanes {
    std::array::from_fn(|lane| a[lane] + b[lane])
}

/// Sum over the lanes, by halves: a chain of seven additions would wait for each.
fn lane_sum(lanes: Lanes) -> f32 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[cfg(test)]
mod tests;
