//! The numbers of photon i of a light: shifted Halton points for where it starts, Sobol points for its bounces.
//!
//! Halton's bases make strata by residue [Larsen2004, 6.2, 9.1]: photons whose numbers are equal modulo 2ᵃ · 3ᵇ start
//! into one of 2ᵃ × 3ᵇ cells of directions. A shift of every digit keeps that, and makes lights and seeds independent.

use super::paths::BLOCK;
use crate::{
    math::sobol::{mix, point},
    transport::EmissionNumbers,
};

/// Cells of the directions of a light, 2³ × 3² or 2⁵ × 3³, and the number of its photons from which on it has as many: cells
/// hold a block of photons, or two.
pub(super) const STRATA: [(u32, u32); 2] = [(72, 72 * BLOCK), (864, 2 * 864 * BLOCK)];

/// Digits that fill single precision.
const DIGITS: [(u32, usize); 4] = [(2, 24), (3, 15), (5, 10), (7, 9)];
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The numbers of all photons of one light.
#[derive(Clone, Debug)]
pub(super) struct Sequence {
    key: u64,
    bases: [Base; 4],
    /// All of the light goes one way: cells are those of where it starts.
    is_one_way: bool,
}

/// A shifted radical inverse.
#[derive(Clone, Debug)]
struct Base {
    base: u32,
    /// What digit d at place p adds, turned by that place's shift, `[place × base]`.
    addends: Vec<f32>,
    /// What the digits from place p on add when the number has none there.
    rests: Vec<f32>,
}

impl Base {
    fn new(base: u32, digits: usize, key: u64) -> Base {
        let shifts: Vec<u8> =
            (0..digits).map(|place| (mix(key ^ (place as u64 + 1)) % u64::from(base)) as u8).collect();
        let mut addends = Vec::with_capacity(digits * base as usize);
        let mut scale = 1.0f64;
        for shift in &shifts {
            scale /= f64::from(base);
            addends.extend(
                (0..base).map(|digit| (f64::from((digit + u32::from(*shift)) % base) * scale) as f32),
            );
        }
        let mut rests = vec![0.0f32; digits + 1];
        for place in (0..digits).rev() {
            rests[place] = rests[place + 1] + addends[place * base as usize];
        }
        Base { base, addends, rests }
    }

    /// A constant base turns divisions into multiplications: half of what emitting a photon costs.
    fn number(&self, index: u32) -> f32 {
        match self.base {
            2 => self.number_in::<2>(index),
            3 => self.number_in::<3>(index),
            5 => self.number_in::<5>(index),
            _ => self.number_in::<7>(index),
        }
    }

    fn number_in<const BASE: u32>(&self, mut index: u32) -> f32 {
        let mut sum = 0.0;
        let mut place = 0;
        for addends in self.addends.chunks_exact(BASE as usize) {
            if index == 0 {
                break;
            }
            sum += addends[(index % BASE) as usize];
            index /= BASE;
            place += 1;
        }
        (sum + self.rests[place]).min(1.0 - f32::EPSILON)
    }
}

impl Sequence {
    /// Of the light that `name_key` names.
    pub(super) fn new(seed: u64, name_key: u64, is_one_way: bool) -> Sequence {
        let key = mix(mix(seed.wrapping_add(GOLDEN)) ^ name_key);
        let bases = [0, 1, 2, 3].map(|i| {
            Base::new(DIGITS[i].0, DIGITS[i].1, key.wrapping_add(GOLDEN.wrapping_mul(i as u64 + 1)))
        });
        Sequence { key, bases, is_one_way }
    }

    /// Where photon `number` starts.
    pub(super) fn emission(&self, number: u32) -> EmissionNumbers {
        let [side, ..] = self.four(0, number);
        let [first, second] =
            [[0, 1], [2, 3]].map(|pair| pair.map(|base: usize| self.bases[base].number(number)));
        let (direction, position) = if self.is_one_way { (second, first) } else { (first, second) };
        EmissionNumbers { direction, position, side }
    }

    /// What the numbers of its scatterings depend on beside: for twins of [`Sequence::four`].
    pub(super) fn key(&self) -> u64 {
        self.key
    }

    /// Numbers of photon `number` at its scattering `bounce` ≥ 1.
    pub(super) fn four(&self, bounce: u32, number: u32) -> [f32; 4] {
        point(self.key.wrapping_add(u64::from(bounce + 1).wrapping_mul(GOLDEN)), number)
    }
}

/// A number for a name: FNV-1a, then mixed.
pub(super) fn name_key(name: &str, part: u64) -> u64 {
    let hash = name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    mix(hash ^ mix(part.wrapping_add(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photons of one residue start into one cell of directions, and every cell gets its share.
    #[test]
    fn residues_are_cells_of_directions() {
        for ((strata, _), [rows, columns]) in STRATA.into_iter().zip([[8.0, 9.0], [32.0, 27.0]]) {
            assert_eq!(rows * columns, strata as f32);
            for seed in 0..20 {
                // Of a light that goes one way cells of where it starts.
                let is_one_way = seed % 2 == 1;
                let sequence = Sequence::new(seed, 7, is_one_way);
                let cell = |number: u32| {
                    let numbers = sequence.emission(number);
                    let [u, v] = if is_one_way { numbers.position } else { numbers.direction };
                    ((u * rows).floor() * columns + (v * columns).floor()) as u32
                };
                let mut seen = vec![false; strata as usize];
                for residue in 0..strata {
                    let first = cell(residue);
                    let is_known = std::mem::replace(&mut seen[first as usize], true);
                    assert!(!is_known, "two residues in cell {first}");
                    for rank in 1..200 {
                        let cell = cell(residue + rank * strata);
                        assert_eq!(cell, first, "seed {seed} residue {residue} rank {rank}");
                    }
                }
            }
        }
    }

    /// Every coordinate of the first bᵐ photons falls once into each of bᵐ intervals.
    #[test]
    fn coordinates_are_stratified() {
        let sequence = Sequence::new(3, 9, false);
        for (dimension, (base, count)) in
            [(2u32, 256u32), (3, 243), (5, 125), (7, 343)].into_iter().enumerate()
        {
            let mut seen = vec![false; count as usize];
            for number in 0..count {
                let numbers = sequence.emission(number);
                let all =
                    [numbers.direction[0], numbers.direction[1], numbers.position[0], numbers.position[1]];
                seen[(all[dimension] * count as f32) as usize] = true;
            }
            assert!(seen.iter().all(|seen| *seen), "base {base}");
        }
    }
}
