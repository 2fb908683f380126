//! Rays alone, without shading: the same ones on the card and on the CPU.

use std::{
    error::Error,
    sync::Arc,
    time::{Duration, Instant},
};

use bytemuck::Pod;
use lumicast_engine::{
    accel::{Accel, Ray, TriangleId},
    film::PictureSize,
    gpu::{AdapterKind, Binding, Gpu, GpuHit, GpuRay, GpuShadowRay, GpuTrees, Masks, Session, Step},
};
use lumicast_shaders::{CLOSEST, Constant, OCCLUDED};
use rayon::prelude::*;

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
    ray_set::{Kind, RaySet},
    subject::Subject,
    warmed,
};

/// Rays a thread takes at a time, as in benches/rays.
const CHUNK: usize = 1024;
/// Times that a card goes through the rays in one batch: a few are gone in less time than a batch takes to begin.
const CARD_REPEATS: u32 = 8;
/// Share of the rays whose answers may differ: both round, and a ray at an edge may pass on either side.
const DIFFERING_MAX: f64 = 1e-3;

/// What is asked about a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Question {
    /// Which surface is the nearest?
    Closest,
    /// Is there any?
    Any,
}

const ASKED: [(Question, Kind); 5] = [
    (Question::Closest, Kind::Primary),
    (Question::Closest, Kind::Diffuse),
    (Question::Any, Kind::Primary),
    (Question::Any, Kind::Diffuse),
    (Question::Any, Kind::Shadow),
];

/// Seconds to go through all rays once, and how many of them meet something.
#[derive(Clone, Copy, Debug)]
struct Timed {
    device_seconds: Option<f64>,
    wall_seconds: f64,
    met_count: usize,
}

/// Million rays a second, closest and any hit, one of each kind a pixel: with fewer than a card runs at once the slowest would count for
/// all. Every triangle is whole: masks are not asked.
pub(crate) fn measure(
    subject: &Subject,
    gpu: &Arc<Gpu>,
    size: PictureSize,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let accel = subject.world.accel();
    let rays = RaySet::seen_by(&subject.view, [size.width(), size.height()], accel, subject.world.scene());
    let card = Card::new(gpu, accel)?;
    for (question, kind) in ASKED {
        let rays = rays.of(kind);
        let on_card = card.prepare(question, rays)?;
        let (mut of_card, mut of_cpu) = (Vec::new(), Vec::new());
        for round in 0..=rounds {
            let timed = (warmed(gpu, || on_card.run())?, on_cpu(accel, question, kind, rays));
            // The first round warms up.
            if round > 0 {
                of_card.push(timed.0);
                of_cpu.push(timed.1);
            }
        }
        let name = match question {
            Question::Closest => "closest hit",
            Question::Any => "any hit",
        };
        let pass = format!("{name}, {} rays", kind.name());
        agree(&pass, rays.len(), &of_card, &of_cpu)?;
        let rate = |seconds: f64| rays.len() as f64 * 1e-6 / seconds;
        let wall = |timed: &[Timed]| median(timed.iter().map(|timed| timed.wall_seconds).collect());
        let device: Option<Vec<f64>> = of_card.iter().map(|timed| timed.device_seconds).collect();
        figures.push(Figure {
            gpu_device: device.map(|seconds| rate(median(seconds))),
            cpu: Some(rate(wall(&of_cpu))),
            ..Figure::new(pass, Unit::MillionRaysPerSecond, rate(wall(&of_card)))
        });
    }
    Ok(())
}

fn agree(pass: &str, ray_count: usize, card: &[Timed], cpu: &[Timed]) -> Result<(), String> {
    let (Some(card), Some(cpu)) = (card.first(), cpu.first()) else { return Ok(()) };
    let differing = card.met_count.abs_diff(cpu.met_count);
    if differing as f64 <= DIFFERING_MAX * ray_count as f64 {
        return Ok(());
    }
    Err(format!(
        "{pass}: {} of {ray_count} meet something on the card, {} on the CPU",
        card.met_count, cpu.met_count
    ))
}

fn on_cpu(accel: &Accel, question: Question, kind: Kind, rays: &[Ray]) -> Timed {
    let start = Instant::now();
    let met = |rays: &[Ray]| match (question, kind) {
        // Neighbours go together, as the path tracer sends them.
        (Question::Closest, Kind::Primary) => {
            let mut hits = vec![None; rays.len()];
            accel.closest_hits(rays, &mut hits, |_| true);
            hits.iter().flatten().count()
        }
        (Question::Closest, _) => rays.iter().filter_map(|ray| accel.closest_hit(ray, |_| true)).count(),
        (Question::Any, _) => rays.iter().filter(|ray| accel.is_occluded(ray, |_| true)).count(),
    };
    let met_count = rays.par_chunks(CHUNK).with_max_len(1).map(met).sum();
    Timed { device_seconds: None, wall_seconds: start.elapsed().as_secs_f64(), met_count }
}

/// Trees on the card.
struct Card {
    session: Arc<Session>,
    trees: GpuTrees,
    constants: [(&'static str, Constant); 2],
    repeats: u32,
}

impl Card {
    fn new(gpu: &Gpu, accel: &Accel) -> Result<Card, Box<dyn Error>> {
        let session = gpu.session()?;
        let packed = accel.upload();
        let (trees, constants) =
            (GpuTrees::new(&session, &packed)?, GpuTrees::constants(&packed, Masks::None));
        let repeats = if gpu.report().kind == AdapterKind::Software { 1 } else { CARD_REPEATS };
        Ok(Card { session, trees, constants, repeats })
    }

    fn prepare(&self, question: Question, rays: &[Ray]) -> Result<OnCard<'_>, Box<dyn Error>> {
        match question {
            Question::Closest => {
                let rays: Vec<_> = rays.iter().map(GpuRay::new).collect();
                self.prepare_step(&CLOSEST, &rays, size_of::<GpuHit>(), |bytes| {
                    let hits = bytes.chunks_exact(size_of::<GpuHit>()).map(bytemuck::pod_read_unaligned);
                    hits.filter(|hit: &GpuHit| hit.hit().is_some()).count()
                })
            }
            Question::Any => {
                let rays: Vec<_> = rays.iter().map(|ray| GpuShadowRay::new(ray, TriangleId::NONE)).collect();
                self.prepare_step(&OCCLUDED, &rays, size_of::<u32>(), |bytes| {
                    let flags = bytes.chunks_exact(size_of::<u32>()).map(bytemuck::pod_read_unaligned);
                    flags.filter(|flag: &u32| *flag == 1).count()
                })
            }
        }
    }

    fn prepare_step<I: Pod>(
        &self,
        step: &'static Step,
        rays: &[I],
        answer_bytes: usize,
        met_count: fn(&[u8]) -> usize,
    ) -> Result<OnCard<'_>, Box<dyn Error>> {
        let session = &self.session;
        let of_trees = GpuTrees::layout(session)?;
        let of_rays = session.layout(&[Binding::Read, Binding::Write])?;
        let pipeline = session.pipeline(step, &self.constants, &[&of_trees, &of_rays])?;
        let input = session.buffer_of("rays", rays)?;
        let output = session.buffer_zeroed("answers", (rays.len() * answer_bytes) as u64)?;
        let groups = [self.trees.bind(session)?, session.bind(&of_rays, &[&input, &output])?];
        let (ray_count, repeats) = (rays.len() as u64, self.repeats);
        let run = move || {
            let mut batch = session.timed_batch(step.name)?;
            for _ in 0..repeats {
                batch.dispatch(&pipeline, &groups.each_ref(), pipeline.workgroups(ray_count))?;
            }
            let start = Instant::now();
            let device_seconds = batch.submit()?.gpu_seconds()?;
            let wall = start.elapsed();
            let mut batch = session.batch("answers")?;
            let answers = batch.read_back(&output, 0..output.byte_count())?;
            batch.submit()?;
            let _ = &input;
            Ok((device_seconds, wall, met_count(&answers.collect()?)))
        };
        Ok(OnCard { run: Box::new(run), repeats: f64::from(repeats) })
    }
}

type Answered = (Option<f64>, Duration, usize);

/// Rays on the card, to be gone through.
struct OnCard<'a> {
    run: Box<dyn Fn() -> Result<Answered, Box<dyn Error>> + 'a>,
    repeats: f64,
}

impl OnCard<'_> {
    fn run(&self) -> Result<Timed, Box<dyn Error>> {
        let (device_seconds, wall, met_count) = (self.run)()?;
        Ok(Timed {
            // A clock that stood still says nothing.
            device_seconds: device_seconds
                .filter(|seconds| *seconds > 0.0)
                .map(|seconds| seconds / self.repeats),
            wall_seconds: wall.as_secs_f64() / self.repeats,
            met_count,
        })
    }
}
