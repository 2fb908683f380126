//! Records splatted onto what a camera sees, and the pixels that lack one: by either way on the card, beside rays, tiles and splats on the CPU.

use std::{error::Error, sync::Arc, time::Instant};

use lumicast_engine::{
    accel::{Hit, Ray},
    film::{Film, Tile},
    gpu::GpuError,
    technique::{
        FirstSight, SecondaryLight, View,
        path::{GpuScene, SplatBy, Splatted},
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

/// Ways that records get onto pixels on a card, and what figures call them.
const WAYS: [(SplatBy, &str); 2] = [(SplatBy::Quads, "by quads"), (SplatBy::Tiles, "by tiles")];

/// Milliseconds of what was measured round by round, with what is seen and without.
#[derive(Default)]
struct Times {
    all: Vec<f64>,
    splats: Vec<f64>,
}

impl Times {
    fn median(self) -> Option<[f64; 2]> {
        (!self.all.is_empty()).then(|| [self.all, self.splats].map(median))
    }
}

/// What a way takes: by the clock on the wall, with what is seen, and by the device's.
#[derive(Default)]
struct OfCard {
    wall: Vec<f64>,
    device: Times,
}

/// Milliseconds of all, with what is seen, and, of the CPU and by the device's clock, without.
pub(crate) fn measure(
    scene: &GpuScene,
    view: &View,
    records: &Arc<dyn SecondaryLight>,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let (mut of_cpu, mut of_card) = (Times::default(), WAYS.map(|_| OfCard::default()));
    // The first round brings records there, compiles, and warms up.
    for round in 0..=rounds {
        let start = Instant::now();
        let sights = sights(scene.world(), view);
        let seen = start.elapsed();
        let Some(answered) = splat(view, records, &sights) else { return Ok(()) };
        let cpu = start.elapsed();
        if round > 0 {
            of_cpu.all.push(1e3 * cpu.as_secs_f64());
            of_cpu.splats.push(1e3 * (cpu - seen).as_secs_f64());
        }
        for ((by, way), of_way) in WAYS.into_iter().zip(&mut of_card) {
            let missing = match measure_way(scene, view, records, by, answered, of_way) {
                // Not every card adds floats up.
                Err(error) if is_insufficient(&*error) => continue,
                measured => measured?,
            };
            if round == 0 {
                *of_way = OfCard::default();
                let count = records.places().len();
                eprintln!("{count} records {way}, {answered} pixels with one, {missing} without");
            }
        }
    }
    let of_cpu = of_cpu.median();
    for ((_, way), OfCard { wall, device }) in WAYS.into_iter().zip(of_card) {
        if wall.is_empty() {
            continue;
        }
        let device = device.median();
        let seen = format!("what is seen, and 4,000 records splatted onto it {way} (CPU: rays, splats)");
        let figure = Figure::new(seen, Unit::Milliseconds, median(wall));
        let [all, splats] = [0, 1].map(|part| (device.map(|of| of[part]), of_cpu.map(|of| of[part])));
        figures.push(Figure { gpu_device: all.0, cpu: all.1, ..figure });
        let alone = format!("4,000 records splatted onto what was seen {way}");
        let figure = Figure::new(alone, Unit::Milliseconds, f64::NAN);
        figures.push(Figure { gpu_device: splats.0, gpu_wall: None, cpu: splats.1, ..figure });
    }
    Ok(())
}

/// One round of a way; returns how many pixels lack a record.
fn measure_way(
    scene: &GpuScene,
    view: &View,
    records: &Arc<dyn SecondaryLight>,
    by: SplatBy,
    answered: usize,
    of_way: &mut OfCard,
) -> Result<usize, Box<dyn Error>> {
    let (splatted, missing, wall) = warmed(scene.gpu(), || {
        let start = Instant::now();
        let splatted = scene.splatted_by(view, records, by)?;
        let missing = splatted.missing()?.len();
        Ok((splatted, missing, start.elapsed()))
    })?;
    check(&splatted, answered)?;
    of_way.wall.push(1e3 * wall.as_secs_f64());
    let timed = warmed(scene.gpu(), || Ok(scene.splatted_timed(view, records, by)?.seconds()))?;
    if let Some(seconds) = timed {
        of_way.device.all.push(1e3 * (seconds.seen + seconds.splats));
        of_way.device.splats.push(1e3 * seconds.splats);
    }
    Ok(missing)
}

fn is_insufficient(error: &(dyn Error + 'static)) -> bool {
    matches!(error.downcast_ref(), Some(GpuError::Insufficient { .. }))
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
