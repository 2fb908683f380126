//! Density estimates of a light octree: its gathers' searches and surfaces on the card, all that follows on the CPU; and all on the CPU.

use std::{
    error::Error,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use lumicast_engine::{
    gpu::Gpu,
    technique::{
        FoundPhotons, Gather, MAPPED, PhotonMaps, Products, Step, Technique,
        octree::{AskedGather, GatherOnCard, OctreeBuilding, OctreeGather, OctreeSettings},
        photons::{PhotonSettings, PhotonTracing},
    },
};
use rayon::prelude::*;

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
    subject::Subject,
};

/// Photons that lights send out.
const PHOTONS: u32 = 100_000;
/// Halvings of the octree.
const DEPTH: u32 = 5;
/// Card and CPU may differ by so much of all irradiance: few gathers are decided by rounding.
const DIFFERENCE_MAX: f64 = 1e-3;

/// Milliseconds of either for the indirect light of all cells, maps at hand; and of bringing maps and surfaces to the card.
pub(crate) fn measure(
    subject: &Subject,
    gpu: &Gpu,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let Some((products, gathers)) = gathers(subject) else { return Ok(()) };
    let Some(photons) = &products.photons else { return Ok(()) };
    let (maps, class) = (&photons.maps, MAPPED[0]);
    let card = GatherOnCard::new(&gpu.session()?)?;
    let asked: Vec<_> =
        gathers.iter().map(|of| AskedGather { sides: &of.sides, bounds: of.bounds }).collect();
    let (mut of_upload, mut of_card, mut of_cpu) = (Vec::new(), Vec::new(), Vec::new());
    // The first round warms up.
    for round in 0..=rounds {
        let start = Instant::now();
        let Some(on_card) = card.upload(maps, class)? else { return Ok(()) };
        let upload = start.elapsed();
        let start = Instant::now();
        let found = card.find(&on_card, &asked)?;
        let by_card = irradiances(maps, &gathers, Some(&found));
        let taken = start.elapsed();
        let start = Instant::now();
        let by_cpu = irradiances(maps, &gathers, None);
        let cpu = start.elapsed();
        check(&by_card, &by_cpu)?;
        if round > 0 {
            of_upload.push(1e3 * upload.as_secs_f64());
            of_card.push(1e3 * taken.as_secs_f64());
            of_cpu.push(1e3 * cpu.as_secs_f64());
        } else {
            let left = found.iter().filter(|found| found.is_none()).count();
            let count = maps.photon_count(class);
            eprintln!("{} gathers of {count} photons, {left} of them left to the CPU", gathers.len());
        }
    }
    let name = "photon maps and surfaces: pack and upload";
    figures.push(Figure::new(name, Unit::Milliseconds, median(of_upload)));
    let name =
        "density estimates of an octree of 32 cells a side (card: searches and areas, the rest by the CPU)";
    figures
        .push(Figure { cpu: Some(median(of_cpu)), ..Figure::new(name, Unit::Milliseconds, median(of_card)) });
    Ok(())
}

/// Photons, and what an octree gathers of them.
fn gathers(subject: &Subject) -> Option<(Products, Vec<OctreeGather>)> {
    let world = &subject.world;
    let mut photons =
        PhotonTracing::new(PhotonSettings { emitted_count: PHOTONS, ..PhotonSettings::default() });
    let settings = OctreeSettings {
        depth_first: DEPTH,
        depth: DEPTH,
        photon_count: PHOTONS,
        ..OctreeSettings::default()
    };
    let mut octree = OctreeBuilding::new(settings);
    let (mut products, never) = (Products::default(), AtomicBool::new(false));
    let techniques: [&mut dyn Technique; 2] = [&mut photons, &mut octree];
    for technique in techniques {
        let mut is_complete = false;
        while !is_complete {
            let mut step = Step { world, products: &mut products, canvas: None, cancel: &never };
            is_complete = technique.step(&mut step).complete;
        }
    }
    let gathers = Arc::clone(octree.octree()?).gathers(world);
    Some((products, gathers))
}

/// Luminances of the irradiance of all, W/m².
///
/// - `found`: by a card; the CPU searches where that is missing
fn irradiances(
    maps: &PhotonMaps,
    gathers: &[OctreeGather],
    found: Option<&[Option<FoundPhotons>]>,
) -> Vec<f32> {
    let irradiance = |gather: &mut Gather, (index, of): (usize, &OctreeGather)| {
        let (class, sides, bounds) = (MAPPED[0], &of.sides, &of.bounds);
        let found = found.and_then(|found| found[index].as_ref());
        let is_gathered =
            found.is_some_and(|found| maps.gather_found(class, sides, bounds, found, gather).is_ok());
        if !is_gathered {
            maps.gather(class, sides, bounds, gather);
        }
        gather.irradiance().luminance()
    };
    gathers.par_iter().enumerate().map_init(Gather::default, irradiance).collect()
}

fn check(by_card: &[f32], by_cpu: &[f32]) -> Result<(), Box<dyn Error>> {
    let apart: f64 = by_card.iter().zip(by_cpu).map(|(a, b)| f64::from((a - b).abs())).sum();
    let all: f64 = by_cpu.iter().map(|irradiance| f64::from(*irradiance)).sum();
    if by_card.len() == by_cpu.len() && apart <= DIFFERENCE_MAX * all {
        return Ok(());
    }
    Err(format!("irradiances of gathers differ by {apart} where all are {all} W/m²").into())
}
