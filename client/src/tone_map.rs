//! Exposure, tone map and sRGB curve for float pictures, with the names and formulas the server has for its own.
//!
//! Pure; imports the protocol's names only. Radiance × 2^exposure → tone map → sRGB → 8 bits. ACES is Stephen Hill's fit
//! of RRT and ODT; AgX is the base look with Benjamin Wrensch's sixth-degree fit of its curve.

use lumicast_protocol::ToneMap;

/// Entries of the table of the last curve. 12.92 × 255 / 16,384 = 0.2 codes per entry at the steepest part of the sRGB
/// curve, so a code is off by one for at most a fifth of the values next to a step.
const INTERVALS: usize = 16_384;

/// AgX's display is a pure power, not the sRGB curve.
const AGX_GAMMA: f32 = 2.2;

/// Exposure and tone map, prepared for whole pictures.
#[derive(Debug, Clone)]
pub struct Display {
    tone_map: ToneMap,
    factor: f32,
    codes: Vec<u8>,
}

impl Display {
    /// Shows radiance × 2^`exposure_ev` through `tone_map`.
    pub fn new(tone_map: ToneMap, exposure_ev: f32) -> Self {
        let gamma = if tone_map == ToneMap::Agx { AGX_GAMMA } else { 1.0 };
        // The middle of each interval stands for all of it.
        let code = |i: usize| srgb_code(((i as f32 + 0.5) / INTERVALS as f32).powf(gamma));
        Self { tone_map, factor: exposure_ev.exp2(), codes: (0..INTERVALS).map(code).collect() }
    }

    /// sRGB codes of one colour. NaN and negative radiance are black.
    pub fn show(&self, radiance: [f32; 3]) -> [u8; 3] {
        // Every map is white to half a code well below 1e9, and squares of it stay finite.
        let bounded = radiance.map(|v| {
            let exposed = v * self.factor;
            // NaN fails the comparison; `clamp` would keep it.
            if exposed > 0.0 { exposed.min(1e9) } else { 0.0 }
        });
        let mapped = match self.tone_map {
            ToneMap::Linear => bounded,
            ToneMap::Reinhard => {
                let luminance = 0.2126 * bounded[0] + 0.7152 * bounded[1] + 0.0722 * bounded[2];
                bounded.map(|v| v / (1.0 + luminance))
            }
            ToneMap::Aces => aces(bounded),
            ToneMap::Agx => agx(bounded),
        };
        mapped.map(|v| self.codes[((v.clamp(0.0, 1.0) * INTERVALS as f32) as usize).min(INTERVALS - 1)])
    }
}

fn srgb_code(linear: f32) -> u8 {
    let srgb = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (srgb * 255.0).round() as u8
}

fn mul(rows: [[f32; 3]; 3], [x, y, z]: [f32; 3]) -> [f32; 3] {
    rows.map(|[a, b, c]| a * x + b * y + c * z)
}

/// sRGB → AP1 with the red modifier, a rational fit of RRT and ODT, and back.
fn aces(radiance: [f32; 3]) -> [f32; 3] {
    const INTO: [[f32; 3]; 3] =
        [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]];
    const OUT_OF: [[f32; 3]; 3] =
        [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];
    let curve =
        |v: f32| (v * (v + 0.024_578_6) - 0.000_090_537) / (v * (0.983_729 * v + 0.432_951) + 0.238_081);
    mul(OUT_OF, mul(INTO, radiance).map(curve))
}

/// Inset, log2 over 16.5 stops, contrast curve, outset; encoded with [`AGX_GAMMA`].
fn agx(radiance: [f32; 3]) -> [f32; 3] {
    const INSET: [[f32; 3]; 3] = [
        [0.842_479_06, 0.078_433_6, 0.079_223_745],
        [0.042_328_242, 0.878_468_64, 0.079_166_13],
        [0.042_375_655, 0.078_433_6, 0.879_143],
    ];
    const OUTSET: [[f32; 3]; 3] = [
        [1.196_879, -0.098_020_88, -0.099_029_74],
        [-0.052_896_85, 1.151_903_1, -0.098_961_18],
        [-0.052_971_635, -0.098_043_45, 1.151_073_7],
    ];
    const STOPS_MIN: f32 = -12.473_93;
    const STOPS_MAX: f32 = 4.026_069;
    let curve = |value: f32| {
        // log2 of zero is −∞, which the clamp takes.
        let x = (value.log2().clamp(STOPS_MIN, STOPS_MAX) - STOPS_MIN) / (STOPS_MAX - STOPS_MIN);
        let polynomial = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];
        polynomial.into_iter().fold(0.0, |sum: f32, factor| sum * x + factor)
    };
    mul(OUTSET, mul(INSET, radiance).map(curve))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_is_black_bright_is_white_and_brighter_is_never_darker() {
        for tone_map in ToneMap::ALL {
            let display = Display::new(tone_map, 0.0);
            assert_eq!(display.show([0.0; 3]), [0; 3], "{tone_map:?}");
            // AgX's fit ends one code below white.
            assert!(display.show([1e6; 3]).iter().all(|c| *c >= 254), "{tone_map:?}");
            let mut before = 0;
            for step in 0..400 {
                let code = display.show([2f32.powf(step as f32 * 0.05 - 15.0); 3])[1];
                assert!(code >= before, "{tone_map:?}");
                before = code;
            }
        }
    }

    #[test]
    fn linear_is_the_srgb_curve_and_a_stop_doubles() {
        // 0.5 → 188, 0.25 → 137: the curve of IEC 61966-2-1.
        assert_eq!(Display::new(ToneMap::Linear, 0.0).show([0.5, 0.25, 1.0]), [188, 137, 255]);
        assert_eq!(Display::new(ToneMap::Linear, 1.0).show([0.25, 0.125, 0.5]), [188, 137, 255]);
    }

    #[test]
    fn grey_stays_grey_and_nonsense_becomes_a_colour() {
        for tone_map in ToneMap::ALL {
            for exposure_ev in [-200.0, 0.0, 200.0] {
                let display = Display::new(tone_map, exposure_ev);
                for value in [f32::NAN, f32::INFINITY, -1.0, 1e-30, f32::MAX] {
                    let [r, g, b] = display.show([value; 3]);
                    // The published matrices' rows sum to 1 only to about 1e-4, less than a code and a half.
                    assert!(r.abs_diff(g) <= 2 && g.abs_diff(b) <= 2, "{tone_map:?} {value}: {r} {g} {b}");
                }
            }
        }
    }
}
