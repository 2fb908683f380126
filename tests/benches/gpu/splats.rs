//! Records splatted onto what a camera sees, and the pixels that lack one: drawn on the card, beside rays, tiles and splats on the CPU.

use std::{error::Error, sync::Arc, time::Instant};

use lumicast_engine::{
    accel::{Hit, Ray},
    film::{Film, Tile},
    technique::{
        FirstSight, SecondaryLight, View,
        path::{GpuScene, Splatted},
    },
    transport::World,
};
use rayon::prelude::*;

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median, warmed,
};

/// Share of the pixels with a record that either may have more of: borders of what is seen, and of where records count.
const DIFFERING_MAX: f64 = 0.01;

/// Milliseconds of either: with what is seen, and, of the CPU alone, without.
pub(crate) fn measure(
    scene: &GpuScene,
    view: &View,
    records: &Arc<dyn SecondaryLight>,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let (mut of_card, mut of_cpu, mut of_splats) = (Vec::new(), Vec::new(), Vec::new());
    let mut by_clock = [Vec::new(), Vec::new()];
    // The first round brings records there, compiles, and warms up.
    for round in 0..=rounds {
        let (splatted, missing, card) = warmed(scene.gpu(), || {
            let start = Instant::now();
            let splatted = scene.splatted(view, records)?;
            let missing = splatted.missing()?.len();
            Ok((splatted, missing, start.elapsed()))
        })?;
        let start = Instant::now();
        let sights = sights(scene.world(), view);
        let seen = start.elapsed();
        let Some(answered) = splat(view, records, &sights) else { return Ok(()) };
        let cpu = start.elapsed();
        check(&splatted, answered)?;
        if round > 0 {
            of_card.push(1e3 * card.as_secs_f64());
            of_cpu.push(1e3 * cpu.as_secs_f64());
            of_splats.push(1e3 * (cpu - seen).as_secs_f64());
            let timed = warmed(scene.gpu(), || Ok(scene.splatted_timed(view, records)?.seconds()))?;
            if let Some(seconds) = timed {
                by_clock[0].push(1e3 * (seconds.seen + seconds.splats));
                by_clock[1].push(1e3 * seconds.splats);
            }
        } else {
            eprintln!("{} records, {answered} pixels with one, {missing} without", records.places().len());
        }
    }
    let seen = "what is seen, and 4,000 records splatted onto it (CPU: rays, splats)";
    let [all, alone] = by_clock.map(|seconds| (!seconds.is_empty()).then(|| median(seconds)));
    let figure = Figure::new(seen, Unit::Milliseconds, median(of_card));
    figures.push(Figure { gpu_device: all, cpu: Some(median(of_cpu)), ..figure });
    let splats = Figure::new("4,000 records splatted onto what was seen", Unit::Milliseconds, f64::NAN);
    figures.push(Figure { gpu_device: alone, gpu_wall: None, cpu: Some(median(of_splats)), ..splats });
    Ok(())
}

fn check(splatted: &Splatted, answered: usize) -> Result<(), Box<dyn Error>> {
    let on_card = splatted.irradiances()?.iter().flatten().count();
    if on_card.abs_diff(answered) as f64 > DIFFERING_MAX * answered as f64 {
        return Err(format!("records count in {on_card} pixels on the card, in {answered} on the CPU").into());
    }
    Ok(())
}

/// What the middles of pixels see that scatters diffusely, tile by tile.
fn sights(world: &World, view: &View) -> Vec<Vec<Option<FirstSight>>> {
    let of_tile = |tile: &Tile| {
        let (origin, size) = (tile.origin(), tile.size());
        let pixels = (0..size.y).flat_map(|y| (0..size.x).map(move |x| (origin.x + x, origin.y + y)));
        let rays: Vec<_> = pixels.map(|(x, y)| view.ray(x as f32 + 0.5, y as f32 + 0.5)).collect();
        let mut met = vec![None; rays.len()];
        world.closest_hits(&rays, &mut met);
        let sight = |(ray, hit): (&Ray, &Option<Hit>)| {
            let surface = world.surface(hit.as_ref()?, ray.direction);
            surface.bsdf.has_diffuse().then_some(FirstSight { surface, wo: -ray.direction })
        };
        rays.iter().zip(&met).map(sight).collect()
    };
    Film::new(view.size()).tiles().par_iter().map(of_tile).collect()
}

/// Pixels in which records count; `None` where records are looked up instead.
fn splat(
    view: &View,
    records: &Arc<dyn SecondaryLight>,
    sights: &[Vec<Option<FirstSight>>],
) -> Option<usize> {
    let laid_out = Arc::clone(records).laid_out_for(view)?;
    let film = Film::new(view.size());
    let answered = film.tiles().par_iter().zip(sights).map(|(tile, seen)| {
        laid_out.scattered_over(tile.origin(), tile.size(), seen).iter().flatten().count()
    });
    Some(answered.sum())
}
