//! A whole frame for somebody who moves: the first pass of a picture of looked-up light, its noise taken off, shown and packed as JPEG; by the
//! card up to the bytes that are packed, with shadows told by rays and by maps, and by the CPU alone.

use std::{
    error::Error,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

use lumicast::images::{JpegQuality, jpeg};
use lumicast_engine::{
    film::{Denoising, Display, Film, Picture, ToneMap},
    technique::{
        Canvas, Products, SecondaryLight, Step, Technique, View,
        path::{GpuPathTracer, GpuScene, PathSettings, PathTracer, Shadows, ShownAs},
    },
};

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median, warmed,
};

/// What viewers ask for if they say nothing.
const QUALITY: u8 = 85;
/// Codes may be so far off the CPU's, and as many may be: what rounding decides.
const CODES_OFF_MAX: u8 = 3;
const DIFFERING_MAX: f64 = 0.02;

/// Milliseconds of either, from the camera to the packed bytes; of showing alone, on the card's clock; and of packing.
pub(crate) fn measure(
    scene: &Arc<GpuScene>,
    view: &View,
    known: &Arc<dyn SecondaryLight>,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let size = view.size();
    let display = Arc::new(Display::new(ToneMap::AgX, 0.0));
    let shown_as = ShownAs { display: Arc::clone(&display), denoises: true };
    let mut tracer = PathTracer::with_secondary(PathSettings::all(None, 0), Arc::clone(known));
    let mut card = GpuPathTracer::new(Arc::clone(scene), PathSettings::all(None, 0));
    card.draw_as(&tracer);
    card.show_first_as(Some(shown_as));
    let (mut of_card, mut by_maps, mut of_cpu, mut of_packing, mut of_showing) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for round in 0..=rounds {
        let (shown, packing, by_card) = frame(scene, view, &mut card, Shadows::ByRays)?;
        let (_, _, mapped) = frame(scene, view, &mut card, Shadows::ByMaps)?;
        let showing = warmed(scene.gpu(), || Ok(card.show_seconds(size)?))?;
        let start = Instant::now();
        let film = draw(scene, view, &mut tracer);
        let here = display.show_all(&Picture::of(&film).denoised(&Denoising::default()).radiance());
        jpeg(&here, size, JpegQuality::clamped(QUALITY))?;
        let by_cpu = start.elapsed();
        check(&shown, &here)?;
        if round > 0 {
            of_card.push(1e3 * by_card.as_secs_f64());
            by_maps.push(1e3 * mapped.as_secs_f64());
            of_cpu.push(1e3 * by_cpu.as_secs_f64());
            of_packing.push(1e3 * packing.as_secs_f64());
            of_showing.extend(showing.map(|seconds| 1e3 * seconds));
        }
    }
    let frame = Figure::new("frame for who moves, packed as JPEG", Unit::Milliseconds, median(of_card));
    figures.push(Figure { cpu: Some(median(of_cpu)), ..frame });
    let mapped = Figure::new("… with shadows by maps", Unit::Milliseconds, median(by_maps));
    figures.push(Figure { cpu: None, ..mapped });
    let showing =
        Figure::new("… showing it: noise off, exposed, mapped, encoded", Unit::Milliseconds, f64::NAN);
    let of_showing = (!of_showing.is_empty()).then(|| median(of_showing));
    figures.push(Figure { gpu_device: of_showing, gpu_wall: None, ..showing });
    let packing = Figure::new("… packing it, by one thread", Unit::Milliseconds, f64::NAN);
    figures.push(Figure { gpu_wall: None, cpu: Some(median(of_packing)), ..packing });
    Ok(())
}

/// What the card shows, what packing it takes, and all.
fn frame(
    scene: &GpuScene,
    view: &View,
    card: &mut GpuPathTracer,
    shadows: Shadows,
) -> Result<(Vec<u8>, Duration, Duration), Box<dyn Error>> {
    card.tell_first_shadows(shadows);
    warmed(scene.gpu(), || {
        let start = Instant::now();
        draw(scene, view, card);
        let shown = card.take_shown().ok_or("the card does not show such pictures")?;
        let packing = Instant::now();
        jpeg(&shown, view.size(), JpegQuality::clamped(QUALITY))?;
        Ok((shown, packing.elapsed(), start.elapsed()))
    })
}

fn draw(scene: &GpuScene, view: &View, technique: &mut dyn Technique) -> Film {
    let mut film = Film::new(view.size());
    let canvas = Some(Canvas { view, film: &mut film });
    let (products, cancel) = (&mut Products::default(), &AtomicBool::new(false));
    technique.step(&mut Step { world: scene.world(), products, canvas, cancel });
    film
}

fn check(shown: &[u8], here: &[u8]) -> Result<(), Box<dyn Error>> {
    let off = |(a, b): (&u8, &u8)| a.abs_diff(*b);
    let differing = shown.iter().zip(here).filter(|pair| off(*pair) > 0).count();
    // Of samples that took another decision all may differ.
    let far = shown.iter().zip(here).filter(|pair| off(*pair) > CODES_OFF_MAX).count();
    let is_like = differing as f64 <= DIFFERING_MAX * here.len() as f64
        && far as f64 <= 0.1 * DIFFERING_MAX * here.len() as f64;
    if shown.len() == here.len() && is_like {
        return Ok(());
    }
    Err(format!("{differing} of {} codes are others on the card, {far} far off", here.len()).into())
}
