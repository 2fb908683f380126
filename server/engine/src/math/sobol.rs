//! Owen-scrambled Sobol points, four dimensions at a time, addressed by (key, index).
//!
//! Every set of four dimensions is the same four-dimensional Sobol sequence, shuffled and scrambled by hashes of
//! its key ([Burley2020], with the hash of [Vegdahl2021]). Within a set, any power-of-two run of indices is
//! stratified; sets of different keys are independent. No table is read that depends on anything but constants, so
//! the same key and index give the same numbers on every machine.

/// Direction numbers of the first four dimensions [JoeKuo2008]: primitive polynomials of degree 0, 1, 2, 3.
const DIRECTIONS: [[u32; 32]; 4] =
    [van_der_corput(), directions(1, 0, [1, 0, 0]), directions(2, 1, [1, 3, 0]), directions(3, 1, [1, 3, 1])];

/// What the bytes of a mirrored index add to each dimension, mirrored as well: `[byte position][byte value][dimension]`,
/// 16 KiB. Mirrored means that bit 0 is the first digit, which is how the scrambling hash wants its numbers.
static BYTE_SUMS: [[[u32; 4]; 256]; 4] = byte_sums();

const fn van_der_corput() -> [u32; 32] {
    let mut v = [0; 32];
    let mut bit = 0;
    while bit < 32 {
        v[bit] = 1 << (31 - bit);
        bit += 1;
    }
    v
}

/// The recurrence of Sobol's direction numbers for a polynomial of `degree` with inner coefficients `a`.
const fn directions(degree: usize, a: u32, m: [u32; 3]) -> [u32; 32] {
    let mut v = [0u32; 32];
    let mut i = 0;
    while i < 32 {
        if i < degree {
            v[i] = m[i] << (31 - i);
        } else {
            let mut value = v[i - degree] ^ (v[i - degree] >> degree);
            let mut k = 1;
            while k < degree {
                if a >> (degree - 1 - k) & 1 == 1 {
                    value ^= v[i - k];
                }
                k += 1;
            }
            v[i] = value;
        }
        i += 1;
    }
    v
}

const fn byte_sums() -> [[[u32; 4]; 256]; 4] {
    let mut sums = [[[0; 4]; 256]; 4];
    let mut position = 0;
    while position < 4 {
        let mut byte = 0;
        while byte < 256 {
            let mut dimension = 0;
            while dimension < 4 {
                let mut sum = 0;
                let mut bit = 0;
                while bit < 8 {
                    if byte >> bit & 1 == 1 {
                        sum ^= DIRECTIONS[dimension][31 - (position * 8 + bit)].reverse_bits();
                    }
                    bit += 1;
                }
                sums[position][byte][dimension] = sum;
                dimension += 1;
            }
            byte += 1;
        }
        position += 1;
    }
    sums
}

/// What twins of [`point`] add up: `[byte position][byte value][dimension]`, for mirrored indices.
pub fn mirrored_byte_sums() -> &'static [[[u32; 4]; 256]; 4] {
    &BYTE_SUMS
}

/// The point of a mirrored index, mirrored.
fn mirrored_sobol(mirrored_index: u32) -> [u32; 4] {
    let bytes = mirrored_index.to_le_bytes();
    let sums = [0, 1, 2, 3].map(|position| &BYTE_SUMS[position][bytes[position] as usize]);
    std::array::from_fn(|dimension| sums.iter().fold(0, |x, sum| x ^ sum[dimension]))
}

/// Owen scrambling of a mirrored number: each digit is flipped or not by a hash of the digits before it.
fn scramble_mirrored(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Mixes 64 bits so that every input bit moves every output bit [Steele2014].
pub fn mix(mut key: u64) -> u64 {
    key = (key ^ key >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    key = (key ^ key >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    key ^ key >> 31
}

/// A number in [0, 1): the upper 24 bits, so that rounding never reaches 1.
fn unit(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The point `index` of the four-dimensional sequence named by `key`, each in [0, 1).
pub fn point(key: u64, index: u32) -> [f32; 4] {
    let seeds = mix(key);
    // Index and digits are scrambled by different hashes of the key.
    // Scrambling the index maps aligned power-of-two runs onto such runs, which keeps them stratified.
    let digits = mirrored_sobol(scramble_mirrored(index.reverse_bits(), seeds as u32));
    let (low, high) = (mix(seeds ^ 0x9e37_79b9_7f4a_7c15), mix(seeds ^ 0xd1b5_4a32_d192_ed03));
    let seeds = [low as u32, (low >> 32) as u32, high as u32, (high >> 32) as u32];
    std::array::from_fn(|dimension| {
        unit(scramble_mirrored(digits[dimension], seeds[dimension]).reverse_bits())
    })
}

/// Random numbers of one sample of one pixel: sets of four, named by their place in the path.
#[derive(Clone, Copy, Debug)]
pub struct PixelSampler {
    key: u64,
    index: u32,
}

impl PixelSampler {
    /// The numbers of sample `index` of the sequence that (`seed`, `sequence`, `pixel`) names.
    pub fn new(seed: u64, sequence: u32, pixel_index: u32, index: u32) -> PixelSampler {
        let pixel = u64::from(pixel_index) << 32 | u64::from(sequence);
        PixelSampler { key: mix(PixelSampler::seed_key(seed) ^ pixel), index }
    }

    /// The key of (`seed`, `sequence`, pixel) before the sequence and the pixel go into it, and how they do:
    /// `mix(seed_key(seed) ^ (pixel << 32 | sequence))`. For twins of [`PixelSampler::new`].
    pub fn seed_key(seed: u64) -> u64 {
        mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15))
    }

    /// The numbers that [`PixelSampler::name`] names.
    pub fn named(key: u64, index: u32) -> PixelSampler {
        PixelSampler { key, index }
    }

    /// What its numbers depend on: a key and an index. For twins of [`PixelSampler::four`].
    pub fn name(&self) -> (u64, u32) {
        (self.key, self.index)
    }

    /// Four numbers in [0, 1) of dimension set `set`.
    pub fn four(&self, set: u32) -> [f32; 4] {
        point(self.key.wrapping_add(u64::from(set).wrapping_mul(0x9e37_79b9_7f4a_7c15)), self.index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every dimension of every aligned power-of-two run has one point in each elementary interval.
    #[test]
    fn runs_of_powers_of_two_are_stratified_in_each_dimension() {
        for key in 0..50 {
            for (first, count) in [(0, 16), (16, 16), (64, 64), (1024, 256)] {
                for dimension in 0..4 {
                    let mut seen = vec![false; count];
                    for i in 0..count {
                        seen[(point(key, (first + i) as u32)[dimension] * count as f32) as usize] = true;
                    }
                    assert!(
                        seen.iter().all(|seen| *seen),
                        "key {key} run {first}+{count} dimension {dimension}"
                    );
                }
            }
        }
    }

    /// The first two dimensions form a (0, 2)-sequence: each 2^a × 2^b box of volume 1/16 holds one point of 16.
    #[test]
    fn the_first_two_dimensions_fill_every_elementary_box() {
        for key in 0..50 {
            for a in 0..=4u32 {
                let (columns, rows) = (1 << a, 16 >> a);
                let mut seen = [false; 16];
                for i in 0..16 {
                    let p = point(key, i);
                    seen[(p[0] * columns as f32) as usize * rows + (p[1] * rows as f32) as usize] = true;
                }
                assert!(seen.iter().all(|seen| *seen), "key {key}, {columns} columns");
            }
        }
    }

    /// Sets, pixels, sequences and seeds are independent: no correlation beyond chance.
    #[test]
    fn different_names_give_uncorrelated_numbers() {
        let count = 4096;
        let streams: [Box<dyn Fn(u32) -> f32>; 5] = [
            Box::new(|i| PixelSampler::new(1, 0, i, 0).four(0)[0]),
            Box::new(|i| PixelSampler::new(1, 0, i, 0).four(1)[0]),
            Box::new(|i| PixelSampler::new(1, 1, i, 0).four(0)[0]),
            Box::new(|i| PixelSampler::new(2, 0, i, 0).four(0)[0]),
            Box::new(|i| PixelSampler::new(1, 0, i + 1, 0).four(0)[0]),
        ];
        for a in 0..streams.len() {
            for b in 0..a {
                let covariance: f64 =
                    (0..count).map(|i| f64::from(streams[a](i) - 0.5) * f64::from(streams[b](i) - 0.5)).sum();
                // The sum of n products of variance 1/144 has standard deviation √n / 12; 5 sigma over 10 pairs.
                assert!(
                    covariance.abs() < 5.0 * (f64::from(count)).sqrt() / 12.0,
                    "streams {a} and {b}: {covariance}"
                );
            }
        }
    }
}
