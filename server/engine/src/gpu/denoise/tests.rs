//! What a card makes of a film is what the CPU makes of it.

mod bounds;

use glam::Vec3;
use lumicast_shaders::PROOF_CONSTANTS;

use self::bounds::{Known, Twin, number};
use super::*;
use crate::{
    film::{Picture, PictureSize, PixelSample},
    gpu::{
        AdapterChoice, Gpu, GpuOptions,
        tests::{assert_same_layout, open, open_with},
    },
    math::{Rgb, sobol::PixelSampler},
    transport::PathClass,
};

fn card() -> Option<(Gpu, DenoiseOnCard)> {
    let gpu = open()?;
    let card = DenoiseOnCard::new(&gpu.session().unwrap()).unwrap();
    Some((gpu, card))
}

/// A film of that size.
///
/// - `sample`: by column, row and a number from 0 to 2
fn film_of(
    [width, height]: [u32; 2],
    passes: u32,
    mut sample: impl FnMut(u32, u32, f32) -> PixelSample,
) -> Film {
    let mut film = Film::new(PictureSize::new(width, height).unwrap());
    for pass in 0..passes {
        for tile in film.tiles_mut() {
            tile.add_pass(|x, y| {
                let [u, ..] = PixelSampler::new(7, pass, y * width + x, 0).four(0);
                sample(x, y, 2.0 * u)
            });
        }
    }
    film
}

/// A grey sheet, faced straight.
fn sheet(radiance: f32) -> PixelSample {
    let mut sample =
        PixelSample { albedo: Rgb::splat(0.5), normal: Vec3::Z, depth_m: 2.0, ..PixelSample::BLACK };
    sample.radiance[PathClass::Direct as usize] = Rgb::splat(0.4 * radiance);
    sample.radiance[PathClass::Indirect as usize] = Rgb::new(0.6, 0.5, 0.7) * radiance;
    sample
}

/// A corner of three walls, leaning, in textures and shadows, with grains of caustics and a lamp.
fn room(x: u32, y: u32, noise: f32) -> PixelSample {
    let wall = usize::from(x > y) + usize::from(x + y > 70);
    let mut sample =
        sheet(noise * [1.0, 0.3, 0.7][wall] * if (x / 9 + y / 7).is_multiple_of(3) { 0.2 } else { 1.0 });
    sample.normal = [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.2, 0.9, 0.1).normalize()][wall];
    sample.depth_m = [2.0, 1.0, 3.0][wall] + 0.02 * x as f32 + 0.005 * (y * wall as u32) as f32;
    sample.albedo = Rgb::new(0.5, 0.1, 0.9) * [1.0, 0.5][((x / 4 + y / 4) % 2) as usize];
    if noise > 1.9 {
        sample.radiance[PathClass::Caustic as usize] = Rgb::new(40.0, 10.0, 0.0) * noise;
    }
    if x > 50 && y < 10 {
        sample.is_shining = true;
        sample.radiance[PathClass::Emitted as usize] = Rgb::splat(100.0);
    }
    sample
}

/// A film's filtering on the card and on the CPU, held against what both may be off by.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    numbers: usize,
    /// How far card and CPU are apart, as a share of what rounding allows.
    allowed_max: f64,
    /// The same of the brightest light, or of its square for variances …
    share_max: f64,
    /// … and what rounding allows, at most and in sum.
    tolerance_max: f64,
    tolerance_sum: f64,
}

/// Asserts that card and CPU are as near to what is true of a film as their rounding allows, each.
fn agree(card: &DenoiseOnCard, film: &Film, tally: &mut Tally) {
    let mut seconds = Some(0.0);
    let mut light_known = Vec::new();
    let denoising = Denoising::found(film, |unjoined| {
        let (of_card, took) = card.joined(unjoined, Session::batch)?;
        seconds = took;
        let of_cpu = unjoined.joined::<ALONE>();
        let known = Twin::of(unjoined).joined();
        let light = known.iter().flat_map(|of| of[..3].iter().map(|light| light.value));
        // Scaled, what shows anything is near one.
        let brightest = light.fold(1e-3, f64::max);
        for plane in 0..ALONE {
            let scale = if plane < 3 { brightest } else { brightest.powi(2) };
            for (pixel, known) in known.iter().enumerate() {
                let known = known[plane];
                let [card, cpu] = [&of_card, &of_cpu].map(|planes| number(planes, pixel, plane));
                for (who, value) in [("card", card), ("CPU", cpu)] {
                    let off = (value - known.value).abs();
                    assert!(off <= known.off, "{who}, pixel {pixel}, plane {plane}: {value} for {known:?}");
                }
                tally.numbers += 1;
                tally.allowed_max = tally.allowed_max.max((card - cpu).abs() / known.off);
                tally.share_max = tally.share_max.max((card - cpu).abs() / scale);
                tally.tolerance_max = tally.tolerance_max.max(known.off / scale);
                tally.tolerance_sum += known.off / scale;
            }
        }
        light_known = known;
        Ok::<_, GpuError>(of_card)
    });
    let (of_card, of_cpu) = (denoising.unwrap(), Denoising::default());
    assert_eq!(seconds, None, "nobody asked for the time");
    let [card, cpu] = [&of_card, &of_cpu].map(|denoising| Picture::of(film).denoised(denoising));
    // The rest is the same code on what was held against its bounds above.
    let brightest = film.radiance().iter().map(|colour| colour.max_component()).fold(0.0, f32::max);
    for (card, cpu) in card.radiance().iter().zip(cpu.radiance()) {
        let off = (*card + cpu * -1.0).map(f32::abs).max_component();
        assert!(off <= 1e-3 * brightest, "{card:?} {cpu:?}");
    }
    // It grows with the variance of every pixel: with all of them as small, and as large, as rounding allows. Where there is no noise it is
    // all rounding.
    let [least, most] = [-1.0, 1.0].map(|side| {
        let denoising = Denoising::found(film, |unjoined| {
            let at = |_: usize, known: &[Known; ALONE]| {
                let [red, green, blue, variance] = *known;
                let moved = (variance.value + side * variance.off).max(0.0);
                [red.value, green.value, blue.value, moved].map(|value| value as f32)
            };
            Ok::<_, GpuError>(Planes::of(unjoined.light.width(), &light_known, 0.0, at))
        });
        Picture::of(film).denoised(&denoising.unwrap()).noise_left()
    });
    for (who, left) in [("card", card.noise_left()), ("CPU", cpu.noise_left())] {
        assert!((least - 1e-6..=most + 1e-6).contains(&left), "{who}: {left} of {least} to {most}");
    }
}

/// Rounding shows nowhere: in all that is compared the card is within a code of a picture of the brightest light (an H200 within 2.2e-3 of it,
/// lavapipe within none). What is allowed is less than that in
/// the mean, so that little else than rounding passes for it; the most is allowed where there is no noise, and a variance of few samples is
/// all rounding, whose root decides.
fn assert_near(tally: Tally) {
    eprintln!("{tally:?}, {:.1e} allowed in the mean", tally.tolerance_sum / tally.numbers as f64);
    assert!(tally.share_max < 1.0 / 255.0 && tally.tolerance_sum < 5e-4 * tally.numbers as f64, "{tally:?}");
}

/// Surfaces and light of all kinds, with few samples and many.
#[test]
fn a_card_joins_what_the_cpu_joins() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    for passes in [1, 2, 3, 4, 16] {
        agree(&card, &film_of([67, 48], passes, room), &mut tally);
        agree(&card, &film_of([67, 48], passes, |_, _, noise| sheet(noise)), &mut tally);
        // Without noise weights hang on the last places of variances, and change nothing.
        agree(&card, &film_of([67, 48], passes, |x, y, _| room(x, y, 1.0)), &mut tally);
        agree(&card, &film_of([67, 48], passes, |_, _, _| sheet(1.0)), &mut tally);
    }
    assert_near(tally);
}

/// Pictures smaller than what is joined, and films without a pass.
#[test]
fn small_pictures_and_empty_films_agree() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    for size in [[1, 1], [2, 1], [1, 5], [3, 2], [9, 1], [17, 16], [8, 40], [16, 33]] {
        for passes in [0, 1, 4] {
            agree(&card, &film_of(size, passes, room), &mut tally);
        }
    }
    assert_near(tally);
}

/// Pictures in bands are the whole picture, to the last bit, however few rows are wanted of each.
#[test]
fn bands_change_nothing() {
    let Some((_gpu, mut card)) = card() else { return };
    for passes in [0, 1, 8] {
        let film = film_of([67, 131], passes, room);
        let shown = |card: &DenoiseOnCard| {
            let denoising = card.denoise(&film).unwrap();
            let picture = Picture::of(&film).denoised(&denoising);
            (picture.radiance(), picture.variance(), picture.noise_left())
        };
        let whole = shown(&card);
        for rows_at_once in [1, 41, 48, 70, 131] {
            card.pixels_at_once = rows_at_once * 88;
            assert!(shown(&card) == whole, "{passes} passes, {rows_at_once} rows");
        }
        card.pixels_at_once = PIXELS_AT_ONCE;
    }
}

/// Numbers at their edges in a film: what is hit at no distance, or where nothing is; albedo of zero, of nearly all that a float holds, and
/// more in sum; a spike.
#[test]
fn hostile_films_agree_and_stay_finite() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    let depths = [0.0, 1e-40, f32::MIN_POSITIVE, 1.0, 1e30, f32::MAX];
    for (spike, passes) in [(1e37, 1), (1e37, 4), (1e-37, 3), (1e-42, 2)] {
        let film = film_of([40, 33], passes, |x, y, noise| {
            let mut sample = sheet(noise * spike * 1e-3);
            sample.depth_m = depths[(x % 6) as usize];
            sample.albedo = Rgb::splat([0.0, 1.0, 1e20, f32::MAX][(y % 4) as usize]);
            if x == 20 && noise > 1.0 {
                sample.radiance[PathClass::Caustic as usize] = Rgb::splat(spike);
            }
            sample
        });
        agree(&card, &film, &mut tally);
        let picture_of = |denoising: &Denoising| Picture::of(&film).denoised(denoising).radiance();
        for denoising in [card.denoise(&film).unwrap(), Denoising::default()] {
            assert!(
                picture_of(&denoising).iter().all(|colour| colour.is_finite() && colour.is_non_negative())
            );
            let picture = Picture::of(&film).denoised(&denoising);
            assert!(picture.variance().iter().all(|variance| variance.is_finite() && *variance >= 0.0));
        }
    }
    assert_near(tally);
}

/// What no film holds, NaN, infinities, the largest and smallest numbers, in any plane: nothing of it comes out, and pixels beyond reach
/// are as they would be without, to the last bit.
#[test]
fn what_is_no_number_never_comes_out() {
    /// 1, and at four levels 1, 2, 4 and 8 and one for the variance around.
    const REACH: i64 = 20;
    let Some((_gpu, card)) = card() else { return };
    let odd = [
        f32::NAN,
        f32::from_bits(0xffc0_0001),
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        f32::MIN_POSITIVE,
        f32::from_bits(1),
        -f32::from_bits(1),
        -0.0,
    ];
    let (width, rows, middle) = (50usize, 45usize, 22 * 50 + 25);
    let of = |film: &Film, odd: Option<(usize, f32)>, is_believed: bool| {
        let mut joined = None;
        let _ = Denoising::found(film, |unjoined| {
            let all = |planes: &Planes| -> Vec<Vec<f32>> {
                (0..width * rows)
                    .map(|pixel| (0..planes.count()).map(|plane| planes.place(pixel).at(plane)).collect())
                    .collect()
            };
            let [mut surfaces, mut light] = [unjoined.surfaces, unjoined.light].map(all);
            if let Some((plane, value)) = odd {
                match plane.checked_sub(surfaces[0].len()) {
                    None => surfaces[middle][plane] = value,
                    Some(plane) => light[middle][plane] = value,
                }
            }
            let to_array = |_: usize, numbers: &Vec<f32>| numbers.clone().try_into().unwrap();
            let surfaces = Planes::of::<_, 10>(width, &surfaces, 1e10, to_array);
            let to_array = |_: usize, numbers: &Vec<f32>| numbers.clone().try_into().unwrap();
            let light = Planes::of::<_, ALONE>(width, &light, 0.0, to_array);
            let odd = Unjoined { surfaces: &surfaces, light: &light, is_believed, ..*unjoined };
            let (planes, _) = card.joined(&odd, Session::batch)?;
            joined = Some(all(&planes));
            Ok::<_, GpuError>(planes)
        });
        joined.unwrap()
    };
    let film = film_of([width as u32, rows as u32], 3, room);
    for is_believed in [false, true] {
        let without = of(&film, None, is_believed);
        for plane in 0..10 + ALONE {
            for value in odd {
                let with = of(&film, Some((plane, value)), is_believed);
                for (pixel, (with, without)) in with.iter().zip(&without).enumerate() {
                    assert!(
                        with.iter().all(|number| number.is_finite() && *number >= 0.0),
                        "plane {plane}, {value}: {with:?} in pixel {pixel}"
                    );
                    let [dy, dx] = [pixel / width, pixel % width]
                        .map(|at| at as i64)
                        .into_iter()
                        .zip([22, 25])
                        .fold([0; 2], |[_, last], (at, middle)| [last, (at - middle).abs()]);
                    assert!(dy.max(dx) <= REACH || with == without, "plane {plane}, {value}: pixel {pixel}");
                }
            }
        }
    }
}

/// A device that is lost is an error, and the next session goes on; what has no room is refused, and memory is given back.
#[test]
fn lost_devices_and_too_little_room_are_errors() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 500_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let card = DenoiseOnCard::new(&session).unwrap();
    let [small, large] = [[40, 30], [200, 100]].map(|size| film_of(size, 2, room));
    let refused = card.denoise(&large).unwrap_err();
    assert!(matches!(refused, GpuError::OutOfMemory { .. }), "{refused}");
    let shown = |denoising: &Denoising| Picture::of(&small).denoised(denoising).radiance();
    let before = shown(&card.denoise(&small).unwrap());
    assert_eq!(session.bytes_held(), 0);
    let timed = card.denoise_timed(&small).unwrap();
    assert!(shown(&timed.denoising) == before && timed.step_seconds.is_none_or(|seconds| seconds > 0.0));
    session.lose_for_test();
    assert_eq!(card.denoise(&small).unwrap_err(), GpuError::Lost);
    let next = DenoiseOnCard::new(&gpu.session().unwrap()).unwrap();
    assert!(shown(&next.denoise(&small).unwrap()) == before);
}

/// Numbers of a band lie in WGSL as in Rust.
#[test]
fn bands_lie_alike_in_rust_and_wgsl() {
    assert_same_layout!(
        &FILM_JOINED.source(PROOF_CONSTANTS),
        "Band",
        GpuBand { width, rows, stride, step, is_believed }
    );
}
