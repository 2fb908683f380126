//! Tone maps: from radiance without bound to what a screen shows.
//!
//! Radiance × 2^exposure → tone map → sRGB curve → 8 bits. EXR files take none of these steps.

use std::{fmt, str::FromStr};

use rayon::prelude::*;

use crate::math::Rgb;

/// How radiance from 0 to ∞ is brought into [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ToneMap {
    /// Cut off above 1: what can be shown is shown as it is.
    Linear,
    /// L/(1+L) on the luminance, hue kept [Reinhard2002, eq. 3].
    Reinhard,
    /// The fit of ACES' reference rendering and output transforms by Stephen Hill [Hill2016]: contrast of
    /// film, bright colours fade to white.
    Aces,
    /// AgX's base look, log encoding and sixth-degree fit of its curve [Sobotka2022, Wrensch2023]: softer
    /// than ACES, hues stay true up to white.
    #[default]
    AgX,
}

/// A tone map name that is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no tone map {0:?}: choose linear, reinhard, aces or agx")]
pub struct UnknownToneMap(pub String);

impl ToneMap {
    /// Every tone map.
    pub const ALL: [ToneMap; 4] = [ToneMap::Linear, ToneMap::Reinhard, ToneMap::Aces, ToneMap::AgX];

    /// The name in commands, protocol and files.
    pub fn name(self) -> &'static str {
        match self {
            ToneMap::Linear => "linear",
            ToneMap::Reinhard => "reinhard",
            ToneMap::Aces => "aces",
            ToneMap::AgX => "agx",
        }
    }

    /// Linear display value in [0, 1] of linear radiance. Never NaN: NaN counts as black.
    pub fn apply(self, radiance: Rgb) -> Rgb {
        self.encoded(radiance).map(|value| if self == ToneMap::AgX { value.powf(AGX_GAMMA) } else { value })
    }

    /// The same before AgX's last step, a power per channel, which the table of [`Display`] takes in.
    fn encoded(self, radiance: Rgb) -> Rgb {
        let bounded = radiance.map(|value| if value > 0.0 { value.min(RADIANCE_MAX) } else { 0.0 });
        let mapped = match self {
            ToneMap::Linear => bounded,
            ToneMap::Reinhard => bounded * (1.0 / (1.0 + bounded.luminance())),
            ToneMap::Aces => aces(bounded),
            ToneMap::AgX => agx(bounded),
        };
        mapped.map(|value| value.clamp(0.0, 1.0))
    }
}

impl fmt::Display for ToneMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ToneMap {
    type Err = UnknownToneMap;

    fn from_str(name: &str) -> Result<ToneMap, UnknownToneMap> {
        let found = ToneMap::ALL.into_iter().find(|tone_map| tone_map.name() == name);
        found.ok_or_else(|| UnknownToneMap(name.chars().take(64).collect()))
    }
}

/// Radiance above counts as this much: all maps are white to half a code well below, and squares stay finite.
pub(crate) const RADIANCE_MAX: f32 = 1e9;

/// The numbers of a tone map that is a curve per channel between two matrices, or weighs channels, for whoever computes it elsewhere.
#[cfg(feature = "gpu")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Fit {
    /// Before the curve, by rows.
    pub(crate) into: [[f32; 3]; 3],
    /// ACES: its fraction. AgX: the range in stops, then the polynomial. Reinhard: what channels add to the luminance. Zeros after.
    pub(crate) curve: [f32; 9],
    /// After the curve, by rows.
    pub(crate) out_of: [[f32; 3]; 3],
}

#[cfg(feature = "gpu")]
impl Fit {
    /// Of a tone map; zeros where it is none.
    pub(crate) fn of(tone_map: ToneMap) -> Fit {
        let mut curve = [0.0; 9];
        match tone_map {
            ToneMap::Linear => Fit::default(),
            ToneMap::Reinhard => {
                curve[..3].copy_from_slice(&Rgb::LUMINANCE.to_array());
                Fit { curve, ..Fit::default() }
            }
            ToneMap::Aces => {
                curve[..5].copy_from_slice(&ACES_CURVE);
                Fit { into: ACES_INTO, curve, out_of: ACES_OUT_OF }
            }
            ToneMap::AgX => {
                curve[..2].copy_from_slice(&AGX_STOPS);
                curve[2..].copy_from_slice(&AGX_CURVE);
                Fit { into: AGX_INSET, curve, out_of: AGX_OUTSET }
            }
        }
    }
}

fn mul(rows: [[f32; 3]; 3], v: Rgb) -> Rgb {
    rows.map(|[r, g, b]| r * v.r + g * v.g + b * v.b).into()
}

const ACES_INTO: [[f32; 3]; 3] =
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]];
const ACES_OUT_OF: [[f32; 3]; 3] =
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];
/// a, b, c, d, e of (v (v + a) − b) / (v (c v + d) + e).
const ACES_CURVE: [f32; 5] = [0.024_578_6, 0.000_090_537, 0.983_729, 0.432_951, 0.238_081];

/// sRGB → AP1 with the red modifier, a rational fit of RRT and ODT, and back [Hill2016].
fn aces(radiance: Rgb) -> Rgb {
    let [a, b, c, d, e] = ACES_CURVE;
    let curve = |v: f32| (v * (v + a) - b) / (v * (c * v + d) + e);
    mul(ACES_OUT_OF, mul(ACES_INTO, radiance).map(curve))
}

/// The display of AgX is a pure power, not the sRGB curve.
const AGX_GAMMA: f32 = 2.2;

const AGX_INSET: [[f32; 3]; 3] = [
    [0.842_479_06, 0.078_433_6, 0.079_223_745],
    [0.042_328_242, 0.878_468_64, 0.079_166_13],
    [0.042_375_655, 0.078_433_6, 0.879_143],
];
const AGX_OUTSET: [[f32; 3]; 3] = [
    [1.196_879, -0.098_020_88, -0.099_029_74],
    [-0.052_896_85, 1.151_903_1, -0.098_961_18],
    [-0.052_971_635, -0.098_043_45, 1.151_073_7],
];
/// The range of the log encoding: black, white.
const AGX_STOPS: [f32; 2] = [-12.473_93, 4.026_069];
/// The contrast curve over that range as [0, 1], highest power first.
const AGX_CURVE: [f32; 7] = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];

/// Inset, log2 over 16.5 stops, contrast curve, outset [Wrensch2023]; encoded with `AGX_GAMMA`.
fn agx(radiance: Rgb) -> Rgb {
    let [black, white] = AGX_STOPS;
    let curve = |value: f32| {
        // log2 of zero is −∞, which the clamp takes.
        let x = (value.log2().clamp(black, white) - black) / (white - black);
        AGX_CURVE.into_iter().fold(0.0, |sum: f32, factor| sum * x + factor)
    };
    mul(AGX_OUTSET, mul(AGX_INSET, radiance).map(curve))
}

/// sRGB curve of a linear value in [0, 1] [IEC 61966-2-1].
fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

fn linear_from_srgb(srgb: f64) -> f64 {
    if srgb <= 0.040_449_936 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// Exposure and tone map, prepared for whole pictures.
///
/// The last step, curve and rounding to 8 bits, is a table look-up with the exact result:
/// the table says the code at the lower end of each of 16,384 equal intervals, and as the steepest
/// part of the curve (12.92 × 255 codes per unit) spans 0.2 codes in one, at most one more compare is due.
#[derive(Clone, Debug)]
pub struct Display {
    tone_map: ToneMap,
    factor: f32,
    code_at: Vec<u8>,
    /// `threshold[c]`: smallest encoded value that rounds to code c.
    threshold: [f32; 257],
}

const INTERVALS: usize = 16_384;

impl Display {
    /// A display that shows radiance × 2^`exposure_ev` through `tone_map`.
    pub fn new(tone_map: ToneMap, exposure_ev: f32) -> Display {
        let gamma = if tone_map == ToneMap::AgX { f64::from(AGX_GAMMA) } else { 1.0 };
        let mut threshold = [f32::INFINITY; 257];
        for (code, threshold) in threshold.iter_mut().enumerate().take(256) {
            let half_code = (code as f64 - 0.5).max(0.0) / 255.0;
            *threshold = linear_from_srgb(half_code).powf(1.0 / gamma) as f32;
        }
        let code_at = (0..=INTERVALS)
            .map(|index| {
                let srgb = srgb_from_linear((index as f64 / INTERVALS as f64).powf(gamma));
                (srgb * 255.0).round() as u8
            })
            .collect();
        Display { tone_map, factor: exposure_ev.exp2(), code_at, threshold }
    }

    /// The tone map.
    #[cfg(feature = "gpu")]
    pub(crate) fn tone_map(&self) -> ToneMap {
        self.tone_map
    }

    /// What radiance is multiplied by.
    #[cfg(feature = "gpu")]
    pub(crate) fn factor(&self) -> f32 {
        self.factor
    }

    /// The smallest values that round to codes 0, 1 … 255, of what the tone map gives before AgX's last step.
    #[cfg(feature = "gpu")]
    pub(crate) fn thresholds(&self) -> &[f32] {
        &self.threshold[..256]
    }

    /// What [`Display::thresholds`] are compared with.
    #[cfg(all(test, feature = "gpu"))]
    pub(crate) fn encoded(&self, radiance: Rgb) -> Rgb {
        self.tone_map.encoded(radiance * self.factor)
    }

    /// sRGB codes of one colour.
    pub fn show(&self, radiance: Rgb) -> [u8; 3] {
        // Zero times an infinite exposure is black, not NaN; `encoded` sees to it.
        self.tone_map.encoded(radiance * self.factor).to_array().map(|value| self.code(value))
    }

    /// `[h × w × 3]` sRGB bytes of a picture, on the current rayon pool.
    pub fn show_all(&self, radiance: &[Rgb]) -> Vec<u8> {
        let mut bytes = vec![0; radiance.len() * 3];
        // 4096 pixels: some 100 µs of work, far more than handing it to a thread costs.
        let pieces = bytes.par_chunks_mut(4096 * 3).zip(radiance.par_chunks(4096));
        pieces.for_each(|(bytes, radiance)| {
            for (to, colour) in bytes.as_chunks_mut::<3>().0.iter_mut().zip(radiance) {
                *to = self.show(*colour);
            }
        });
        bytes
    }

    fn code(&self, encoded: f32) -> u8 {
        let low = self.code_at[(encoded * INTERVALS as f32) as usize];
        low + u8::from(encoded >= self.threshold[usize::from(low) + 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTREMES: [f32; 9] = [0.0, 1e-38, 1e-20, 1e-5, 0.18, 1.0, 1e9, 1e20, f32::MAX];

    /// Whatever the radiance, a display value is a number in [0, 1].
    #[test]
    fn display_values_are_finite_from_zero_to_the_largest_float() {
        for tone_map in ToneMap::ALL {
            for r in EXTREMES {
                for b in EXTREMES {
                    let shown = tone_map.apply(Rgb::new(r, 0.0, b));
                    assert!(shown.to_array().iter().all(|v| (0.0..=1.0).contains(v)), "{tone_map} {r} {b}");
                }
            }
            for broken in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0] {
                let shown = tone_map.apply(Rgb::splat(broken));
                assert!(shown.to_array().iter().all(|v| (0.0..=1.0).contains(v)), "{tone_map} {broken}");
            }
            for exposure_ev in [-200.0, 0.0, 200.0] {
                let display = Display::new(tone_map, exposure_ev);
                EXTREMES.iter().for_each(|value| {
                    display.show(Rgb::splat(*value));
                });
            }
        }
    }

    /// Black is shown black, the brightest grey white (AgX's fit ends one code below).
    #[test]
    fn black_is_black_and_bright_is_white() {
        for tone_map in ToneMap::ALL {
            let display = Display::new(tone_map, 0.0);
            assert_eq!(display.show(Rgb::BLACK), [0, 0, 0], "{tone_map}");
            assert!(display.show(Rgb::splat(1e20)).iter().all(|code| *code >= 254), "{tone_map}");
        }
    }

    /// Brighter greys are never shown darker.
    #[test]
    fn greys_are_shown_in_order() {
        for tone_map in ToneMap::ALL {
            let greys: Vec<Rgb> = (0..4000).map(|i| Rgb::splat((-14.0 + 0.01 * i as f32).exp2())).collect();
            for pair in greys.windows(2) {
                let [dark, bright] = [tone_map.apply(pair[0]), tone_map.apply(pair[1])];
                for channel in 0..3 {
                    // 1e-6: rounding of f32 through matrix and curve.
                    assert!(bright[channel] >= dark[channel] - 1e-6, "{tone_map} {pair:?}");
                }
            }
        }
    }

    /// Greys stay grey.
    #[test]
    fn greys_keep_their_hue() {
        for tone_map in ToneMap::ALL {
            for value in [0.01, 0.18, 0.7, 3.0] {
                let [r, g, b] = Display::new(tone_map, 0.0).show(Rgb::splat(value));
                assert!(r.abs_diff(g) <= 1 && g.abs_diff(b) <= 1, "{tone_map} {value}: {r} {g} {b}");
            }
        }
    }

    /// The table gives the code that the formula rounds to.
    #[test]
    fn table_codes_are_the_rounded_srgb_values() {
        for tone_map in ToneMap::ALL {
            let display = Display::new(tone_map, 0.0);
            let gamma = if tone_map == ToneMap::AgX { f64::from(AGX_GAMMA) } else { 1.0 };
            for i in 0..=100_000 {
                let encoded = i as f32 / 100_000.0;
                let exact = srgb_from_linear(f64::from(encoded).powf(gamma)) * 255.0;
                // Half a code, plus the rounding of the thresholds to f32.
                let off = (f64::from(display.code(encoded)) - exact).abs();
                assert!(off <= 0.5 + 1e-4, "{tone_map} {encoded}: {} for {exact}", display.code(encoded));
            }
        }
    }

    /// One stop doubles the light, and a whole picture is its pixels one by one.
    #[test]
    fn exposure_counts_in_stops_and_pictures_are_shown_pixel_by_pixel() {
        let picture: Vec<Rgb> = (0..9001).map(|i| Rgb::new(i as f32, 300.0, 0.5 * i as f32) * 1e-4).collect();
        for tone_map in ToneMap::ALL {
            let bytes = Display::new(tone_map, 1.0).show_all(&picture);
            let doubled = Display::new(tone_map, 0.0);
            for (shown, colour) in bytes.chunks(3).zip(&picture) {
                assert_eq!(shown, doubled.show(*colour * 2.0), "{tone_map} {colour:?}");
            }
        }
    }

    /// Middle grey of each map, from the published formulas: a changed constant shows here.
    #[test]
    fn middle_grey_is_where_the_sources_put_it() {
        let shown = ToneMap::ALL.map(|tone_map| tone_map.apply(Rgb::splat(0.18)).g);
        // Reinhard: 0.18/1.18. ACES: 0.18·0.2045786−9.05e-5 over 0.18·(0.177+0.433)+0.238.
        assert!((shown[0] - 0.18).abs() < 1e-6);
        assert!((shown[1] - 0.152_542).abs() < 1e-5);
        assert!((shown[2] - 0.105_598).abs() < 1e-4, "{}", shown[2]);
        // AgX's curve turns about middle grey at 0.5, encoded: 0.5^2.2. The fit passes there at 0.497.
        assert!((shown[3] - 0.5f32.powf(2.2)).abs() < 0.004, "{}", shown[3]);
    }

    /// Names are the ones of the command line.
    #[test]
    fn every_tone_map_is_found_by_its_name() {
        for tone_map in ToneMap::ALL {
            assert_eq!(tone_map.name().parse(), Ok(tone_map));
        }
        assert_eq!("filmic".parse::<ToneMap>(), Err(UnknownToneMap("filmic".into())));
    }
}
