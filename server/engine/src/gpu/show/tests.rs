//! What a card shows is what the CPU shows.

use lumicast_shaders::PROOF_CONSTANTS;

use super::*;
use crate::{
    film::{Film, Picture, PictureSize, PixelSample, TracedPart, Weights},
    gpu::{
        AdapterChoice, Gpu, GpuOptions,
        tests::{assert_same_layout, open, open_with},
    },
    math::sobol::PixelSampler,
    transport::PathClass,
};

/// Half the distance from 1 to the next float, as a share: what one operation may be off by.
const UNIT: f32 = f32::EPSILON / 2.0;
const EXPOSURES: [f32; 3] = [-8.0, 0.0, 3.5];

fn parts(width: u32, own: Vec<Rgb>) -> PictureParts {
    let size = PictureSize::new(width, own.len() as u32 / width).unwrap();
    assert_eq!(own.len(), size.pixel_count());
    PictureParts { size, own, traced: None }
}

/// - `weight`: by the number of the tile
fn blended(width: u32, own: Vec<Rgb>, radiance: Vec<Rgb>, weight: impl Fn(usize) -> f64) -> PictureParts {
    let alone = parts(width, own);
    let [columns, rows] =
        [alone.size.width(), alone.size.height()].map(|side| side.div_ceil(TILE_SIDE) as usize);
    let weights = Weights { values: (0..columns * rows).map(weight).collect(), columns };
    PictureParts { traced: Some(TracedPart { radiance, weights }), ..alone }
}

/// Greys, single channels and saturated colours from 1e-6 to 1e9, as many as fill the rows.
fn colours(count: usize) -> Vec<Rgb> {
    let tints = [
        [1.0, 1.0, 1.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.02, 0.3],
        [0.001, 0.7, 1.0],
    ];
    let colour = |index: usize| {
        let decades = 15.0 * (index as f32 + 0.5) / count as f32;
        Rgb::from(tints[index % tints.len()]) * 10f32.powf(decades - 6.0)
    };
    (0..count).map(colour).collect()
}

/// Colours of no order, from 1e-6 to 1e9.
fn scattered(count: usize, seed: u64) -> Vec<Rgb> {
    let colour = |index: usize| {
        let [u, r, g, b] = PixelSampler::new(seed, 0, index as u32, 0).four(0);
        Rgb::new(r, g, b) * 10f32.powf(15.0 * u - 6.0)
    };
    (0..count).map(colour).collect()
}

/// How far the card's encoded value may be from the CPU's by rounding alone, for what comes in off by `share` of itself.
///
/// Both sides round, so that everything counts twice. Sums of |row| of the matrices after curves are 2.21 (ACES) and 1.40 (AgX); the
/// matrices before have no negative numbers, and three products are off by 4 units at most.
///
/// - Linear: only what comes in.
/// - Reinhard: v / (1 + L) has at most twice the share; 5 units of L, 1 of the sum, 2.5 of the last place (5 units) of a quotient in WGSL,
///   1 of the product.
/// - ACES: v f'(v) ≤ 0.37; 4 units of the matrix, and (8 + 5) of numerator, denominator and quotient, whose size with b apart is at most
///   1.02; 4 more of the last matrix.
/// - AgX: logarithms in WGSL are off by 3 in the last place, of numbers below 16 by 2.9e-6, and 1 more for the CPU's; the subtraction by 1e-6;
///   of 16.5 stops that is 3e-7, with the quotient 6e-7; the polynomial's slope is at most 2.1, and its own rounding in Horner's order
///   6e-6 (the bound of running errors, at its worst x).
fn tolerance(tone_map: ToneMap, share: f32) -> f32 {
    match tone_map {
        ToneMap::Linear => share,
        ToneMap::Reinhard => 2.0 * share + 2.0 * 12.0 * UNIT,
        ToneMap::Aces => 2.21 * (0.37 * (share + 8.0 * UNIT) + 2.0 * 17.0 * UNIT),
        ToneMap::AgX => {
            let stops = (share + 8.0 * UNIT) * std::f32::consts::LOG2_E + 5e-6;
            1.40 * (2.1 * (stops / 16.5 + 6e-7) + 2.0 * 6e-6 + 2.0 * 4.0 * UNIT)
        }
    }
}

/// Channels compared, and how many are a code apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tally {
    channels: usize,
    apart: usize,
}

/// Asserts that the card shows what the CPU shows, but for what rounding decides.
fn agree(card: &ShowOnCard, tone_map: ToneMap, exposure_ev: f32, parts: &PictureParts, tally: &mut Tally) {
    let display = Display::new(tone_map, exposure_ev);
    let codes = card.show(&display, parts).unwrap();
    let mixed = parts.clone().mixed();
    let expected = display.show_all(&mixed);
    assert_eq!(codes.len(), expected.len());
    for (index, (codes, expected)) in codes.chunks(3).zip(expected.chunks(3)).enumerate() {
        tally.channels += 3;
        if codes == expected {
            continue;
        }
        let encoded = display.encoded(mixed[index]);
        let tolerance = tolerance(tone_map, share_of(parts, index, mixed[index]));
        for channel in 0..3 {
            let (code, expected, value) = (codes[channel], expected[channel], encoded[channel]);
            let what = || {
                format!("{tone_map} {exposure_ev} pixel {index} {:?}: {code} for {expected}", mixed[index])
            };
            assert!(code.abs_diff(expected) <= 1, "{}", what());
            if code != expected {
                let off = (value - display.thresholds()[usize::from(code.max(expected))]).abs();
                assert!(
                    off <= tolerance,
                    "{} where {value} is {off} from the threshold, more than {tolerance}",
                    what()
                );
                tally.apart += 1;
            }
        }
    }
}

/// What a pixel's radiance may be off by before the tone map, as a share of its channel that is the farthest off: one rounding alone; of
/// blends, whose weights are off by 7 units (their own, two products and a sum along x, the same along y) and whose products and sum add
/// 3, of either film.
fn share_of(parts: &PictureParts, index: usize, mixed: Rgb) -> f32 {
    let Some(traced) = &parts.traced else { return 2.0 * UNIT };
    let sizes = parts.own[index] + traced.radiance[index];
    let share = |channel: usize| {
        if mixed[channel] > 0.0 { 2.0 * 10.0 * UNIT * sizes[channel] / mixed[channel] } else { 0.0 }
    };
    (0..3).map(share).fold(2.0 * UNIT, f32::max)
}

fn card() -> Option<(Gpu, ShowOnCard)> {
    let gpu = open()?;
    let card = ShowOnCard::new(&gpu.session().unwrap()).unwrap();
    Some((gpu, card))
}

/// Rounding decides few of all codes: tolerances are some hundredth of one.
fn assert_few(tally: Tally) {
    eprintln!("{} of {} channels are one code apart", tally.apart, tally.channels);
    assert!(tally.apart * 1000 < tally.channels, "{tally:?}");
}

/// Every tone map, exposure and size of radiance.
#[test]
fn a_card_shows_what_the_cpu_shows() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    let picture = parts(250, [colours(40_000), scattered(20_000, 1)].concat());
    for tone_map in ToneMap::ALL {
        for exposure_ev in EXPOSURES {
            agree(&card, tone_map, exposure_ev, &picture, &mut tally);
        }
    }
    assert_few(tally);
}

/// Two films, at weights of all kinds, which go over from tile to tile.
#[test]
fn a_card_blends_as_the_cpu_does() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    let all: [&dyn Fn(usize) -> f64; 4] =
        [&|_| 0.0, &|_| 1.0, &|tile| (0.381_966 * tile as f64).fract(), &|tile| {
            f64::from(u8::from(tile % 3 == 0))
        }];
    for weight in all {
        for tone_map in ToneMap::ALL {
            let picture = blended(250, scattered(20_000, 2), scattered(20_000, 3), weight);
            agree(&card, tone_map, -1.0, &picture, &mut tally);
            // Films of one picture are much alike.
            let near = scattered(20_000, 2)
                .iter()
                .zip(scattered(20_000, 4))
                .map(|(own, noise)| *own + noise * 1e-3)
                .collect();
            let picture = blended(250, scattered(20_000, 2), near, weight);
            agree(&card, tone_map, -1.0, &picture, &mut tally);
        }
    }
    assert_few(tally);
}

/// A display's thresholds are the card's: every code begins where the CPU begins it, to the last bit.
#[test]
fn codes_begin_at_the_same_float() {
    let Some((_gpu, card)) = card() else { return };
    let display = Display::new(ToneMap::Linear, 0.0);
    let values = display.thresholds()[1..]
        .iter()
        .flat_map(|threshold| [threshold.next_down(), *threshold, threshold.next_up()]);
    let greys: Vec<Rgb> = values.map(Rgb::splat).collect();
    let expected: Vec<u8> =
        (1..=255u8).flat_map(|code| [code - 1, code, code]).flat_map(|code| [code; 3]).collect();
    let codes = card.show(&display, &parts(45, greys)).unwrap();
    assert_eq!(codes, expected);
}

/// What is no radiance is shown as the CPU shows it, alone and blended, and so are the ends of the range of floats.
#[test]
fn what_is_no_radiance_is_shown_as_on_the_cpu() {
    let Some((_gpu, card)) = card() else { return };
    let odd = [
        f32::NAN,
        f32::from_bits(0xffc0_0001),
        f32::from_bits(0x7f80_0001),
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        f32::MIN_POSITIVE,
        f32::from_bits(1),
        -f32::from_bits(1),
        f32::from_bits(0x007f_ffff),
        -0.0,
        0.0,
        -1.0,
        -1e-20,
        0.3,
        2e9,
    ];
    let pairs = || odd.iter().flat_map(|a| odd.iter().map(move |b| (*a, *b)));
    let own: Vec<Rgb> = pairs().map(|(a, b)| Rgb::new(a, 0.2, b)).collect();
    // Rows of one pair each, three tiles wide: every pair meets every weight.
    let wide = |side: fn((f32, f32)) -> f32| -> Vec<Rgb> {
        pairs()
            .flat_map(|pair| std::iter::repeat_n(Rgb::new(side(pair), 0.4, 0.7 * side(pair)), 48))
            .collect()
    };
    let weights: [&dyn Fn(usize) -> f64; 3] = [&|_| 0.0, &|_| 1.0, &|tile| [0.0, 0.5, 1.0][tile % 3]];
    for tone_map in ToneMap::ALL {
        for exposure_ev in [EXPOSURES[0], EXPOSURES[1], EXPOSURES[2], -64.0, 64.0] {
            let display = Display::new(tone_map, exposure_ev);
            let alone = parts(17, own.clone());
            let blends = weights.map(|weight| blended(48, wide(|pair| pair.0), wide(|pair| pair.1), weight));
            for parts in [alone].iter().chain(&blends) {
                let codes = card.show(&display, parts).unwrap();
                let mixed = parts.clone().mixed();
                let values = parts.traced.as_ref().map_or(&[][..], |traced| &traced.weights.values);
                // Between the middles of tiles the sums of 0.3 and 0.4 may lie anywhere, also at a threshold.
                let off_max = u8::from(values.contains(&0.5));
                for (index, (codes, expected)) in
                    codes.chunks(3).zip(display.show_all(&mixed).chunks(3)).enumerate()
                {
                    let off = codes.iter().zip(expected).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
                    let of = parts.traced.as_ref().map(|traced| traced.radiance[index]);
                    assert!(
                        off <= off_max,
                        "{tone_map} {exposure_ev} {:?} {of:?}: {codes:?} for {expected:?}",
                        parts.own[index]
                    );
                }
            }
        }
    }
}

/// Bytes are packed at every size, in one piece or in rows, and the last pixel is there.
#[test]
fn every_size_is_shown_whole() {
    let Some((_gpu, mut card)) = card() else { return };
    let mut tally = Tally::default();
    for [width, height] in [[1, 1], [2, 1], [3, 1], [1, 5], [67, 48], [16, 16], [17, 33], [640, 360]] {
        let count = (width * height) as usize;
        let weight = |tile: usize| (0.618_034 * tile as f64).fract();
        let both = blended(width, scattered(count, 5), scattered(count, 6), weight);
        for pixels_at_once in [PIXELS_AT_ONCE, 1, 1000] {
            // Rows of one pixel each take a batch each.
            if count > 10_000 && pixels_at_once == 1 {
                continue;
            }
            card.pixels_at_once = pixels_at_once;
            agree(&card, ToneMap::Reinhard, 0.0, &parts(width, scattered(count, 7)), &mut tally);
            agree(&card, ToneMap::AgX, -2.0, &both, &mut tally);
        }
    }
    assert_few(tally);
}

/// Films go through the card as through the CPU.
#[test]
fn pictures_of_films_are_shown() {
    let Some((_gpu, card)) = card() else { return };
    let size = PictureSize::new(67, 48).unwrap();
    let film_of = |seed: u64, passes: u32, noise: f32, bias: f32| {
        let mut film = Film::new(size);
        for pass in 0..passes {
            for tile in film.tiles_mut() {
                tile.add_pass(|x, y| {
                    let [u, ..] = PixelSampler::new(seed, pass, y * 67 + x, 0).four(0);
                    let mut sample = PixelSample::BLACK;
                    let value = (bias * x as f32 / 67.0 + 0.5) * (1.0 + noise * (u - 0.5));
                    sample.radiance[PathClass::Direct as usize] = Rgb::new(value, 0.5 * value, 0.1);
                    sample
                });
            }
        }
        film
    };
    let (looked_up, traced) = (film_of(1, 2, 0.01, 1.2), film_of(2, 16, 0.5, 1.0));
    let picture = Picture::of(&looked_up).blended(&traced);
    assert!((0.05..0.95).contains(&picture.traced_share()), "{}", picture.traced_share());
    let parts = picture.parts();
    assert_eq!(parts.clone().mixed(), picture.radiance());
    let mut tally = Tally::default();
    for tone_map in ToneMap::ALL {
        agree(&card, tone_map, 0.0, &parts, &mut tally);
    }
    eprintln!("{tally:?}, {:.2} of it path-traced", picture.traced_share());
}

/// A device that is lost is an error, and the next session shows the same.
#[test]
fn a_lost_device_is_an_error_and_the_next_session_shows() {
    let Some((gpu, card)) = card() else { return };
    let (display, picture) = (Display::new(ToneMap::AgX, 0.0), parts(10, colours(100)));
    let before = card.show(&display, &picture).unwrap();
    card.session.lose_for_test();
    assert_eq!(card.show(&display, &picture), Err(GpuError::Lost));
    let next = ShowOnCard::new(&gpu.session().unwrap()).unwrap();
    assert_eq!(next.show(&display, &picture).unwrap(), before);
}

/// What does not fit is refused, and what does goes on; the memory is given back.
#[test]
fn what_has_no_room_and_exposures_without_sense_are_refused() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 100_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let card = ShowOnCard::new(&session).unwrap();
    let display = Display::new(ToneMap::Aces, 0.0);
    let refused = card.show(&display, &parts(100, colours(10_000))).unwrap_err();
    assert!(matches!(refused, GpuError::OutOfMemory { .. }), "{refused}");
    for exposure_ev in [64.5, -64.5, f32::INFINITY, f32::NAN] {
        let refused =
            card.show(&Display::new(ToneMap::Aces, exposure_ev), &parts(10, colours(100))).unwrap_err();
        assert!(matches!(refused, GpuError::Failed { .. }), "{exposure_ev}: {refused}");
    }
    agree(&card, ToneMap::Aces, 0.0, &parts(10, colours(100)), &mut Tally::default());
    assert_eq!(session.bytes_held(), 0);
}

/// Numbers of a picture that is shown lie in WGSL as in Rust.
#[test]
fn what_is_shown_lies_alike_in_rust_and_wgsl() {
    assert_same_layout!(
        &FILM_SHOW.source(PROOF_CONSTANTS),
        "Showing",
        GpuShowing {
            into,
            out_of,
            curve,
            factor,
            bright,
            tone_map,
            width,
            row_first,
            pixel_count,
            tile_columns,
            tile_rows,
        }
    );
}
