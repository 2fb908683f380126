//! The numbers of photon i of a light: shifted Halton points for where it starts, Sobol points for its bounces.
//!
//! Halton's bases make strata by residue [Larsen2004, 6.2, 9.1]: photons whose numbers are equal modulo 2ᵃ · 3ᵇ start
//! into one of 2ᵃ × 3ᵇ cells of directions. A shift of every digit keeps that, and makes lights and seeds independent.

use crate::{
    math::sobol::{mix, point},
    transport::EmissionNumbers,
};

/// Cells of the directions of a light: 2³ × 3².
pub(super) const STRATA: u32 = 72;
/// Photons of a light below which it is one stratum: cells would hold less than a block.
pub(super) const STRATIFIED_FROM: u32 = 4608;

/// Digits that fill single precision.
const DIGITS: [(u32, usize); 4] = [(2, 24), (3, 15), (5, 10), (7, 9)];
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The numbers of all photons of one light.
#[derive(Clone, Debug)]
pub(super) struct Sequence {
    key: u64,
    bases: [Base; 4],
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
    pub(super) fn new(seed: u64, name_key: u64) -> Sequence {
        let key = mix(mix(seed.wrapping_add(GOLDEN)) ^ name_key);
        let bases = [0, 1, 2, 3].map(|i| {
            Base::new(DIGITS[i].0, DIGITS[i].1, key.wrapping_add(GOLDEN.wrapping_mul(i as u64 + 1)))
        });
        Sequence { key, bases }
    }

    /// Where photon `number` starts.
    pub(super) fn emission(&self, number: u32) -> EmissionNumbers {
        let [side, ..] = self.four(0, number);
        EmissionNumbers {
            direction: [self.bases[0].number(number), self.bases[1].number(number)],
            position: [self.bases[2].number(number), self.bases[3].number(number)],
            side,
        }
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
        for seed in 0..20 {
            let sequence = Sequence::new(seed, 7);
            let cell = |number: u32| {
                let [u, v] = sequence.emission(number).direction;
                (u * 8.0) as u32 * 9 + (v * 9.0) as u32
            };
            let mut seen = vec![false; STRATA as usize];
            for residue in 0..STRATA {
                let first = cell(residue);
                assert!(!std::mem::replace(&mut seen[first as usize], true), "two residues in cell {first}");
                for rank in 1..200 {
                    assert_eq!(
                        cell(residue + rank * STRATA),
                        first,
                        "seed {seed} residue {residue} rank {rank}"
                    );
                }
            }
        }
    }

    /// Every coordinate of the first bᵐ photons falls once into each of bᵐ intervals.
    #[test]
    fn coordinates_are_stratified() {
        let sequence = Sequence::new(3, 9);
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
