//! Composition, exposure and tone map: what takes two films of a picture to what a screen shows, on the card and on the CPU.

use std::{error::Error, time::Instant};

use lumicast_engine::{
    film::{Display, Film, Picture, PictureSize, PixelSample, ToneMap},
    gpu::{Gpu, ShowOnCard},
    math::sobol::PixelSampler,
    transport::PathClass,
};

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
};

/// Passes of the path-traced film: enough for it to count.
const PASSES: u32 = 8;
/// Share of the codes that rounding may decide otherwise, by one.
const DIFFERING_MAX: f64 = 1e-3;

/// Milliseconds of either, radiance at hand: with upload and read-back; the step alone on the card's clock. What is shown is not of the
/// scene: all radiance takes as long.
pub(crate) fn measure(
    gpu: &Gpu,
    size: PictureSize,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let films = [film(size, 1, 1, 1.2), film(size, 2, PASSES, 1.0)];
    let parts = Picture::of(&films[0]).blended(&films[1]).parts();
    let display = Display::new(ToneMap::AgX, 0.0);
    let card = ShowOnCard::new(&gpu.session()?)?;
    let (mut of_card, mut of_step, mut of_cpu) = (Vec::new(), Vec::new(), Vec::new());
    // The first round warms up.
    for round in 0..=rounds {
        let start = Instant::now();
        let codes = card.show(&display, &parts)?;
        let whole = start.elapsed();
        let step_seconds = card.show_timed(&display, &parts)?.step_seconds;
        // Mixing takes what it mixes.
        let taken = parts.clone();
        let start = Instant::now();
        let expected = display.show_all(&taken.mixed());
        let cpu = start.elapsed();
        check(&codes, &expected)?;
        if round > 0 {
            of_card.push(1e3 * whole.as_secs_f64());
            of_step.extend(step_seconds.filter(|seconds| *seconds > 0.0).map(|seconds| 1e3 * seconds));
            of_cpu.push(1e3 * cpu.as_secs_f64());
        }
    }
    let name = "two films blended, exposed, mapped by AgX, encoded: with upload and read-back";
    figures
        .push(Figure { cpu: Some(median(of_cpu)), ..Figure::new(name, Unit::Milliseconds, median(of_card)) });
    let step = Figure::new("… the step alone", Unit::Milliseconds, f64::NAN);
    let of_step = (!of_step.is_empty()).then(|| median(of_step));
    figures.push(Figure { gpu_device: of_step, gpu_wall: None, ..step });
    Ok(())
}

fn check(codes: &[u8], expected: &[u8]) -> Result<(), Box<dyn Error>> {
    let differing = codes.iter().zip(expected).filter(|(a, b)| a != b).count();
    let is_near = codes.iter().zip(expected).all(|(a, b)| a.abs_diff(*b) <= 1);
    if codes.len() != expected.len() || !is_near || differing as f64 > DIFFERING_MAX * codes.len() as f64 {
        return Err(format!("{differing} of {} codes are others on the card", expected.len()).into());
    }
    Ok(())
}

/// A ramp with noise, of the passes' number.
fn film(size: PictureSize, seed: u64, passes: u32, brightness: f32) -> Film {
    let mut film = Film::new(size);
    for pass in 0..passes {
        for tile in film.tiles_mut() {
            tile.add_pass(|x, y| {
                let [u, ..] = PixelSampler::new(seed, pass, y * size.width() + x, 0).four(0);
                let value = brightness * (x as f32 + 1.0) / size.width() as f32 * (0.75 + 0.5 * u);
                let mut sample = PixelSample::BLACK;
                sample.radiance[PathClass::Direct as usize] = [value, 0.6 * value, 0.3 * value].into();
                sample
            });
        }
    }
    film
}
