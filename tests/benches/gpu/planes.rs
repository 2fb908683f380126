//! What a camera and what planes before many points see: drawn on the card, brought back and met, beside rays on the CPU.

use std::{error::Error, sync::Arc, time::Instant};

use lumicast_engine::{
    accel::{Hit, TriangleId},
    film::PictureSize,
    gpu::Gpu,
    technique::{Lookout, View, irradiance::HemiPlane, path::GpuScene},
};
use rayon::prelude::*;

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
    subject::Subject,
};

/// Points with a plane before them, across a grid over the picture, and pixels of a plane.
const POINTS: [u32; 2] = [8, 8];
const SIDE: u32 = 32;
/// Share of the pixels that may see another triangle: small ones have many edges near pixels' middles.
const DIFFERING_MAX: f64 = 0.02;

/// Milliseconds of either.
pub(crate) fn measure(
    subject: &Subject,
    gpu: &Arc<Gpu>,
    size: PictureSize,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let scene = GpuScene::new(Arc::clone(gpu), Arc::clone(&subject.world));
    let view = View::new(&subject.world, &subject.view, size);
    let camera = vec![Lookout { view, left: TriangleId::NONE }];
    let planes = planes(subject)?;
    let name =
        format!("{} planes of {SIDE}x{SIDE} before what is seen, rasterised (CPU: rays)", planes.len());
    for (pass, lookouts) in
        [("primary visibility, rasterised (CPU: rays)".to_string(), camera), (name, planes)]
    {
        let (mut of_card, mut of_cpu) = (Vec::new(), Vec::new());
        for round in 0..=rounds {
            let start = Instant::now();
            let drawn = scene.visible(&lookouts)?;
            let card = start.elapsed();
            let start = Instant::now();
            let met = along_rays(subject, &lookouts);
            let cpu = start.elapsed();
            let triangle = |hit: &Option<Hit>| hit.map(|hit| hit.triangle_id());
            let differing = drawn.iter().zip(&met).filter(|(a, b)| triangle(a) != triangle(b)).count();
            if differing as f64 > DIFFERING_MAX * met.len() as f64 {
                return Err(
                    format!("{pass}: {differing} of {} pixels see another triangle", met.len()).into()
                );
            }
            // The first round brings the scene there, compiles, and warms up.
            if round > 0 {
                of_card.push(1e3 * card.as_secs_f64());
                of_cpu.push(1e3 * cpu.as_secs_f64());
            }
        }
        figures.push(Figure {
            cpu: Some(median(of_cpu)),
            ..Figure::new(pass, Unit::Milliseconds, median(of_card))
        });
    }
    Ok(())
}

fn along_rays(subject: &Subject, lookouts: &[Lookout]) -> Vec<Option<Hit>> {
    let rays: Vec<_> = lookouts.iter().flat_map(Lookout::rays).collect();
    let mut met = vec![None; rays.len()];
    let chunk = (SIDE * SIDE) as usize;
    rays.par_chunks(chunk)
        .zip(met.par_chunks_mut(chunk))
        .for_each(|(rays, met)| subject.world.closest_hits(rays, met));
    met
}

/// Planes before what a grid of pixels sees.
fn planes(subject: &Subject) -> Result<Vec<Lookout>, Box<dyn Error>> {
    let [columns, rows] = POINTS;
    let view = View::new(&subject.world, &subject.view, PictureSize::new(columns, rows)?);
    let of_plane = PictureSize::new(SIDE, SIDE)?;
    let pixels = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
    let planes = pixels.filter_map(|(x, y)| {
        let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5);
        Lookout::before_what_is_met(&subject.world, &ray, HemiPlane::HALF_SIDE as f32, of_plane)
    });
    Ok(planes.collect())
}
