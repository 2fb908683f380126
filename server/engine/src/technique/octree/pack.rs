//! A virtual directional light in eight bytes.
//!
//! The direction is octahedral, 16 + 16 bits. The irradiance shares one exponent among its channels [Ward1991]. The
//! usual 9 + 9 + 9 + 5 bits span 32 octaves, but 70 lie between 10⁻¹² W/m² and 10⁹ W/m², which leaves of one scene
//! may hold. Seven bits of exponent span 128 octaves and leave 25 bits of fractions: 8 for red and
//! blue, 9 for green, which the eye sees best.

use bytemuck::{Pod, Zeroable};

use super::cluster::Vdl;
use crate::math::{Rgb, octahedral, sobol::mix};

/// Exponents are stored as themselves plus this: 2⁻⁶⁴ to 2⁶³ around 1 W/m².
const EXPONENT_BIAS: i32 = 64;
/// The least and the largest exponent.
const EXPONENT_RANGE: (i32, i32) = (-EXPONENT_BIAS, 127 - EXPONENT_BIAS);
/// Codes of a channel's fraction: 8, 9 and 8 bits.
const CODE_COUNT: [u32; 3] = [256, 512, 256];
/// Codes from which on a channel is rounded to nearest.
const WEAK: f32 = 8.0;
/// Where the channels begin in the word, and behind them the exponent.
const SHIFT: [u32; 4] = [0, 8, 17, 25];

/// A light in eight bytes; zero bytes are a light of no irradiance from +z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct PackedVdl {
    /// Octahedral code, turned by 0.0037° at most.
    pub direction: u32,
    /// From bit 0 up: 8 bits of red, 9 of green, 8 of blue, each a fraction of 2^(exponent − 64) W/m²; 7 of exponent.
    pub irradiance: u32,
}

impl PackedVdl {
    /// The nearest light of eight bytes.
    ///
    /// Between 3 · 10⁻²⁰ and 9 · 10¹⁸ W/m² no channel changes by more than 0.4 % of the largest channel, and green by
    /// half of that; twice as much where it is weaker than a thirty-second of that, about. Rounding is to nearest, or of weak channels up and down by
    /// chance, so that sums of lights keep their mean. Channels above the range become its largest number; below it the absolute error stays
    /// under 2⁻⁷² W/m².
    pub fn pack(vdl: &Vdl) -> PackedVdl {
        let direction = octahedral::encode(vdl.direction);
        PackedVdl { direction, irradiance: encode(vdl.irradiance, direction) }
    }

    /// The light, its direction a unit vector.
    pub fn unpack(self) -> Vdl {
        Vdl { direction: octahedral::decode(self.direction), irradiance: decode(self.irradiance) }
    }
}

/// - `key`: names the chances by which weak channels are rounded
fn encode(irradiance: Rgb, key: u32) -> u32 {
    let (least, largest) = EXPONENT_RANGE;
    let exponent = exponent_above(irradiance.max_component()).clamp(least, largest);
    let rounded = codes(irradiance, exponent, key);
    if rounded.iter().zip(CODE_COUNT).any(|(code, count)| *code >= count) && exponent < largest {
        // Rounded up to the next power of two: 0.999 is 1.00 of this exponent, hence 0.50 of the next.
        return word(codes(irradiance, exponent + 1, key), exponent + 1);
    }
    word(std::array::from_fn(|k| rounded[k].min(CODE_COUNT[k] - 1)), exponent)
}

fn word([r, g, b]: [u32; 3], exponent: i32) -> u32 {
    r << SHIFT[0] | g << SHIFT[1] | b << SHIFT[2] | ((exponent + EXPONENT_BIAS) as u32) << SHIFT[3]
}

fn decode(word: u32) -> Rgb {
    let step = power_of_two((word >> SHIFT[3]) as i32 - EXPONENT_BIAS);
    let channel = |k: usize| (word >> SHIFT[k] & (CODE_COUNT[k] - 1)) as f32 / CODE_COUNT[k] as f32 * step;
    Rgb::new(channel(0), channel(1), channel(2))
}

/// The channels as fractions of 2^`exponent`, rounded to codes. Casts turn NaN and negative numbers into 0.
///
/// To nearest all lights of one colour are rounded alike, as long as their exponents are: under a red lamp with a thousandth of blue, a quarter of
/// a code, the blue of all was lost. Weak channels go up and down by chance.
fn codes(irradiance: Rgb, exponent: i32, key: u32) -> [u32; 3] {
    let fraction = irradiance / power_of_two(exponent);
    // Of lights from one direction each has its own, which is the same for twice the light.
    let bits = (0..3).map(|k| u64::from(fraction[k].to_bits()).rotate_left(20 * k as u32));
    let numbers = mix(bits.fold(u64::from(key), |key, bits| key ^ bits));
    std::array::from_fn(|k| {
        let code = fraction[k] * CODE_COUNT[k] as f32;
        let chance = (numbers >> (20 * k) & 0xf_ffff) as f32 * (1.0 / 1_048_576.0);
        (code + if code < WEAK { chance } else { 0.5 }).floor() as u32
    })
}

/// The least exponent whose power of two is above a positive normal number.
fn exponent_above(value: f32) -> i32 {
    (value.to_bits() >> 23 & 0xff) as i32 - 126
}

/// 2^`exponent` for the exponents of normal numbers.
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127) as u32) << 23)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::{CODE_COUNT, PackedVdl, Vdl, WEAK, encode, exponent_above, power_of_two};
    use crate::math::Rgb;
    use crate::math::octahedral::DIRECTION_ERROR_MAX_DEGREES;
    use crate::math::sobol::{mix, point};

    /// Half a code of 256 against the least largest channel, 255.5 / 256 of a power of two (which rounds up).
    const COLOR_ERROR_MAX: f32 = 1.0 / 255.5;

    fn of_color(irradiance: Rgb) -> Vdl {
        Vdl { direction: Vec3::Z, irradiance }
    }

    fn there_and_back(irradiance: Rgb) -> Rgb {
        PackedVdl::pack(&of_color(irradiance)).unpack().irradiance
    }

    /// No channel is off by more than 0.4 % of the largest, nor green by 0.2 %, over 37 decades, and weak ones by no more than twice as much.
    #[test]
    fn colours_come_back_within_the_stated_error() {
        let mut worst = [0f32; 3];
        let mut worst_weak = [0f32; 3];
        for index in 0..1 << 18 {
            let [r, g, b, s] = point(1, index);
            let color = Rgb::new(r, g, b) * (10f32.powf(-19.5 + 38.0 * s) / r.max(g).max(b).max(0.1));
            let back = there_and_back(color);
            for k in 0..3 {
                let share = color[k] / color.max_component();
                let is_weak = share < 2.0 * WEAK / CODE_COUNT[k] as f32;
                let worst = if is_weak { &mut worst_weak[k] } else { &mut worst[k] };
                *worst = worst.max((back[k] - color[k]).abs() / color.max_component());
            }
        }
        println!("largest errors: {worst:?}, of weak channels {worst_weak:?}");
        assert!(worst_weak[0].max(worst_weak[2]) <= 2.0 * COLOR_ERROR_MAX + 1e-6, "{worst_weak:?}");
        assert!(worst_weak[1] <= COLOR_ERROR_MAX + 1e-6, "{worst_weak:?}");
        // Rounding of the comparison itself is 2⁻²³.
        assert!(worst[0].max(worst[2]) <= COLOR_ERROR_MAX + 1e-6, "{worst:?}");
        assert!(worst[1] <= 0.5 * COLOR_ERROR_MAX + 1e-6, "{worst:?}");
        assert!(worst[0] > 0.9 * COLOR_ERROR_MAX, "the bound is not idle: {worst:?}");
    }

    /// Powers of two and their neighbours, where exponents change, come back as well as others.
    #[test]
    fn rounding_up_to_the_next_exponent_is_no_overflow() {
        for exponent in -63..62 {
            let at = power_of_two(exponent);
            for value in [at, at.next_down(), at.next_up(), 0.998 * at, 0.9985 * at] {
                for color in [Rgb::splat(value), Rgb::new(value, 0.0, 0.0), Rgb::new(0.0, value, 0.5 * value)]
                {
                    let back = there_and_back(color);
                    for k in 0..3 {
                        assert!((back[k] - color[k]).abs() <= COLOR_ERROR_MAX * value * 1.0001, "{color:?}");
                    }
                }
            }
            assert_eq!(there_and_back(Rgb::splat(at)), Rgb::splat(at), "powers of two are exact");
        }
    }

    /// Directions turn by no more than the octahedral code's bound.
    #[test]
    fn directions_come_back_within_the_stated_angle() {
        for index in 0..1 << 14 {
            let [x, y, z, _] = point(2, index).map(|u| u - 0.5);
            let direction = Vec3::new(x, y, z).normalize();
            let back = PackedVdl::pack(&Vdl { direction, irradiance: Rgb::WHITE }).unpack().direction;
            let degrees = 2.0 * (0.5 * back.distance(direction)).asin().to_degrees();
            assert!(degrees < DIRECTION_ERROR_MAX_DEGREES + 1e-5, "{direction}: {degrees}");
        }
    }

    /// Rounding is to nearest and hence fair: the mean over many lights stays.
    #[test]
    fn the_mean_of_many_lights_is_kept() {
        let count = 1 << 16;
        let mut sums = [[0f64; 3]; 2];
        for index in 0..count {
            let [r, g, b, _] = point(3, index);
            let color = Rgb::new(r, g, b);
            for (sum, color) in sums.iter_mut().zip([color, there_and_back(color)]) {
                (0..3).for_each(|k| sum[k] += f64::from(color[k]));
            }
        }
        for (before, after) in sums[0].into_iter().zip(sums[1]) {
            // Errors are uniform within ±1/512 at most, deviation 1/512/√3: 5 sigma of the mean of 2¹⁶.
            let sigma = 1.0 / 512.0 / 3f64.sqrt() / f64::from(count).sqrt();
            assert!((before - after).abs() / f64::from(count) < 5.0 * sigma, "{before} {after}");
        }
    }

    /// So it does of lights that are all of one colour, however weak a channel of it is.
    #[test]
    fn weak_channels_of_many_lights_are_kept() {
        const COUNT: u32 = 1 << 16;
        for color in [Rgb::new(1.0, 0.001, 0.0001), Rgb::new(0.03, 0.9, 0.01), Rgb::new(0.004, 0.012, 0.7)] {
            let mut sum = [0f64; 3];
            for index in 0..COUNT {
                let [x, y, z, _] = point(4, index).map(|u| u - 0.5);
                let light = Vdl { direction: Vec3::new(x, y, z).normalize(), irradiance: color };
                let back = PackedVdl::pack(&light).unpack().irradiance;
                (0..3).for_each(|k| sum[k] += f64::from(back[k]));
            }
            for k in 0..3 {
                let (mean, code) = (sum[k] / f64::from(COUNT), 1.0 / f64::from(CODE_COUNT[k]));
                let color = f64::from(color[k]);
                // Strong channels are off by half a code at most, weak ones by chance: 5 sigma of n codes that are one or none.
                let chance = code * 5.0 * (color / code).min(0.25).sqrt() / f64::from(COUNT).sqrt();
                let allowed = if color < 0.02 { chance } else { 0.5 * code };
                assert!((mean - color).abs() <= allowed, "{color}: {mean}");
            }
        }
    }

    /// Beyond the range: dark becomes black, bright the brightest, and what is no number nothing.
    #[test]
    fn numbers_beyond_the_range_stay_numbers() {
        assert_eq!(there_and_back(Rgb::BLACK), Rgb::BLACK);
        assert_eq!(PackedVdl::pack(&of_color(Rgb::BLACK)), PackedVdl::default());
        assert_eq!(there_and_back(Rgb::splat(1e-30)), Rgb::BLACK);
        for bright in [1e19, f32::MAX, f32::INFINITY] {
            let back = there_and_back(Rgb::new(bright, 0.0, bright));
            assert_eq!(back, Rgb::new(255.0, 0.0, 255.0) * (power_of_two(63) / 256.0));
        }
        assert!(there_and_back(Rgb::splat(f32::NAN)).is_finite());
        assert_eq!(there_and_back(Rgb::new(-1.0, 1.0, 0.0)), Rgb::new(0.0, 1.0, 0.0));
        // 3 · 10⁻²⁰ and 9 · 10¹⁸ are the documented ends.
        for end in [3e-20f32, 9e18] {
            let back = there_and_back(Rgb::splat(end));
            assert!((back.r / end - 1.0).abs() <= COLOR_ERROR_MAX, "{end}: {back:?}");
        }
    }

    /// Every word is a finite colour, and what came back once comes back the same for ever.
    #[test]
    fn every_word_is_a_colour_and_stays_it() {
        for word in (0..1 << 16).map(|k| mix(k) as u32).chain([0, u32::MAX]) {
            let color = PackedVdl { direction: 0, irradiance: word }.unpack().irradiance;
            assert!(color.is_finite() && color.is_non_negative(), "{word:#x}");
            assert_eq!(there_and_back(color), color, "{word:#x} {:#x}", encode(color, 0));
        }
    }

    /// The layout is two words.
    #[test]
    fn a_light_is_eight_bytes() {
        assert_eq!(size_of::<PackedVdl>(), 8);
        let packed = PackedVdl::pack(&Vdl { direction: Vec3::X, irradiance: Rgb::new(1.0, 0.5, 0.25) });
        // 1 is ½ · 2¹: exponent 1 + 64, fractions ½, ¼, ⅛ of 256, 512 and 256 codes.
        assert_eq!(packed.irradiance, 65 << 25 | 32 << 17 | 128 << 8 | 128);
        assert_eq!(bytemuck::bytes_of(&packed)[..4], 0x0000_7fffu32.to_le_bytes());
        assert_eq!(exponent_above(1.0), 1);
    }
}
