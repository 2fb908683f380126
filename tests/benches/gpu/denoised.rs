//! Noise taken off a film of looked-up light, on the card and on the CPU.

use std::{error::Error, time::Instant};

use lumicast_engine::{
    film::{Denoising, Film, Picture, PictureSize, PixelSample},
    gpu::{DenoiseOnCard, Gpu},
    math::{Rgb, sobol::PixelSampler},
    transport::PathClass,
};

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
};

/// Passes of the film: as many as leave each pixel's variance unbelieved, which takes longest.
const PASSES: u32 = 3;
/// Card and CPU may differ by so much of the brightest light: what rounding may decide.
const DIFFERENCE_MAX: f32 = 1e-3;

/// Milliseconds of either, from the film's sums to what is taken off: all of it, which both begin and end on the CPU; the steps alone on the
/// card's clock. What is shown is not of the scene: all films take as long.
pub(crate) fn measure(
    gpu: &Gpu,
    size: PictureSize,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let film = film(size);
    let card = DenoiseOnCard::new(&gpu.session()?)?;
    let (mut of_card, mut of_steps, mut of_cpu) = (Vec::new(), Vec::new(), Vec::new());
    // The first round warms up.
    for round in 0..=rounds {
        let start = Instant::now();
        let denoising = card.denoise(&film)?;
        let whole = start.elapsed();
        let step_seconds = card.denoise_timed(&film)?.step_seconds;
        let here = Denoising::default();
        let start = Instant::now();
        // Nothing but what is taken off is found for that.
        Picture::of(&film).denoised(&here).noise_left();
        let cpu = start.elapsed();
        check(&film, &denoising, &here)?;
        if round > 0 {
            of_card.push(1e3 * whole.as_secs_f64());
            of_steps.extend(step_seconds.filter(|seconds| *seconds > 0.0).map(|seconds| 1e3 * seconds));
            of_cpu.push(1e3 * cpu.as_secs_f64());
        }
    }
    let name =
        "noise taken off looked-up light: with what the CPU does before and after, upload and read-back";
    figures
        .push(Figure { cpu: Some(median(of_cpu)), ..Figure::new(name, Unit::Milliseconds, median(of_card)) });
    let steps = Figure::new("… the steps alone", Unit::Milliseconds, f64::NAN);
    let of_steps = (!of_steps.is_empty()).then(|| median(of_steps));
    figures.push(Figure { gpu_device: of_steps, gpu_wall: None, ..steps });
    Ok(())
}

fn check(film: &Film, card: &Denoising, here: &Denoising) -> Result<(), Box<dyn Error>> {
    let [card, here] = [card, here].map(|denoising| Picture::of(film).denoised(denoising).radiance());
    let brightest = here.iter().map(|colour| colour.max_component()).fold(0.0, f32::max);
    let apart = |(a, b): (&Rgb, &Rgb)| (*a + *b * -1.0).map(f32::abs).max_component();
    let most = card.iter().zip(&here).map(apart).fold(0.0, f32::max);
    if card.len() == here.len() && most <= DIFFERENCE_MAX * brightest {
        return Ok(());
    }
    Err(format!("pictures without noise differ by {most} where {brightest} is the brightest").into())
}

/// Tiles of two depths, normals and albedos, noisy and with shadows.
fn film(size: PictureSize) -> Film {
    let mut film = Film::new(size);
    for pass in 0..PASSES {
        for tile in film.tiles_mut() {
            tile.add_pass(|x, y| {
                let [u, ..] = PixelSampler::new(3, pass, y * size.width() + x, 0).four(0);
                let is_other = (x / 40 + y / 40).is_multiple_of(2);
                let value = 2.0 * u * if x % 60 < y % 60 { 1.0 } else { 0.4 };
                let mut sample = PixelSample { albedo: Rgb::splat(0.5), depth_m: 2.0, ..PixelSample::BLACK };
                sample.normal = if is_other { glam::Vec3::Z } else { glam::Vec3::X };
                sample.radiance[PathClass::Indirect as usize] = [value, 0.6 * value, 0.3 * value].into();
                sample
            });
        }
    }
    film
}
