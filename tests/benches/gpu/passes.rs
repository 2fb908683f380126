//! Whole passes of a picture, one sample a pixel: path tracing alone, and direct light that asks the light octree, records of
//! irradiance or photons of caustics for the rest; photons; and light gathered along rays for records.

use std::{
    error::Error,
    num::NonZeroU32,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use lumicast_engine::{
    film::{Film, PictureSize},
    gpu::Gpu,
    render::{Illumination, IlluminationSettings, Indirect, RenderSettings, Stage},
    technique::{
        ArrivingLight, Canvas, Counts, FocusedLight, Products, SecondaryLight, Step, Technique,
        caustics::{CausticSettings, CausticSketch, Caustics},
        irradiance::{IrradianceCaching, IrradianceSettings, Visits},
        path::{
            ArrivingByGpu, GpuGatherer, GpuPathTracer, GpuPhotons, GpuScene, PathSettings, PathTracer,
            Shadows, View, rays_over_a_picture,
        },
        photons::{PhotonSettings, PhotonTracing},
    },
};

use crate::{
    figures::{Figure, SceneFigures, Unit},
    frame, median, shadow_maps, splats,
    subject::Subject,
    warmed,
};

/// Passes before any counts: the card finds out how much of a picture it takes at a time, doubling it from slice to slice, and the
/// first four passes of looked-up light have no shadows of what lies near.
const WARM_UP_PASSES: usize = 4;

/// Records that are looked up: as many as the issue of splatting counts in.
const RECORDS: usize = 4_000;
/// Photons that all lights send out.
const PHOTONS: u32 = 200_000;

/// What a pass takes.
struct Pass {
    seconds: f64,
    counts: Counts,
}

/// A picture that is drawn again and again.
struct Drawing<'a> {
    subject: &'a Subject,
    view: View,
    size: PictureSize,
}

/// What mirrors and glass focus, of one pass.
type Focused = Option<Arc<dyn FocusedLight>>;

/// Path tracing, its steps, and asking the octree, records and photons. Both techniques are stepped as they are, so that nothing is
/// measured of learning, of following photons, of measuring errors or of choosing between films; caustics are those that the octree
/// knows, but in the last pass.
pub(crate) fn measure(
    subject: &Subject,
    gpu: &Arc<Gpu>,
    size: PictureSize,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let view = View::new(&subject.world, &subject.view, size);
    let drawing = Drawing { subject, view, size };
    let scene = Arc::new(GpuScene::new(gpu.clone(), subject.world.clone()));
    let settings = PathSettings::all(None, 0);
    let tracer = PathTracer::new(settings);
    let mut card = GpuPathTracer::new(Arc::clone(&scene), settings);
    let [on_card, on_cpu] = drawing.compare(&mut card, tracer, &None, rounds)?;
    push_rates(figures, &on_card, &on_cpu);
    drawing.push_steps(&card, "path tracing", Shadows::ByRays, figures)?;
    carry(subject, &scene, rounds, figures)?;
    let (known, learning_seconds) = drawing.learn();
    let mut learning = Figure::new("light octree: learning", Unit::Seconds, f64::NAN);
    (learning.gpu_wall, learning.cpu) = (None, Some(learning_seconds));
    figures.push(learning);
    let Some(known) = known else { return Ok(()) };
    let tracer = PathTracer::with_secondary(settings, Arc::clone(&known));
    card.draw_as(&tracer);
    let [on_card, on_cpu] = drawing.compare(&mut card, tracer, &None, rounds)?;
    push_milliseconds(figures, "pass that asks the octree", &on_card, &on_cpu);
    drawing.push_steps(&card, "asking the octree", Shadows::ByRays, figures)?;
    drawing.push_steps(&card, "asking the octree and maps of shadows", Shadows::ByMaps, figures)?;
    shadow_maps::measure(&scene, rounds, figures)?;
    frame::measure(&scene, &drawing.view, &known, rounds, figures)?;
    let focused = drawing.focus();
    if focused.is_some() {
        let tracer = PathTracer::with_secondary(settings, Arc::clone(&known));
        let [on_card, on_cpu] = drawing.compare(&mut card, tracer, &focused, rounds)?;
        push_milliseconds(figures, "pass that asks the octree, and photons for caustics", &on_card, &on_cpu);
        let tracer = PathTracer::with_secondary(settings, Arc::clone(&known));
        if let Some(sketched) = drawing.sketch(&scene, rounds, figures)? {
            let [on_card, on_cpu] = drawing.compare(&mut card, tracer, &Some(sketched), rounds)?;
            let name = "pass that asks the octree, and a sketch for caustics";
            push_milliseconds(figures, name, &on_card, &on_cpu);
        }
    }
    let records = drawing.records(&known);
    let start = Instant::now();
    let packed = records.packed_records();
    let packing =
        Figure::new("4,000 records: packing", Unit::Milliseconds, 1e3 * start.elapsed().as_secs_f64());
    figures.push(packing);
    let bytes = packed.map_or(0, |packed| size_of_val(&packed.records[..]) + size_of_val(&packed.words[..]));
    figures.push(Figure::new("4,000 records: size", Unit::Bytes, bytes as f64));
    splats::measure(&scene, &drawing.view, &records, rounds, figures)?;
    let tracer = PathTracer::with_secondary(settings, records);
    card.draw_as(&tracer);
    let [on_card, on_cpu] = drawing.compare(&mut card, tracer, &None, rounds)?;
    push_milliseconds(figures, "pass that asks 4,000 records", &on_card, &on_cpu);
    let [on_card, on_cpu] = drawing.gather(&scene, &known, rounds)?;
    let figure = Figure::new("gathering for records", Unit::MillionPathsPerSecond, on_card);
    figures.push(Figure { cpu: Some(on_cpu), ..figure });
    Ok(())
}

/// Photons from their lights to their ends, with all that is kept of them.
fn carry(
    subject: &Subject,
    scene: &Arc<GpuScene>,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let settings = PhotonSettings { emitted_count: PHOTONS, ..PhotonSettings::default() };
    let card = Arc::new(GpuPhotons::new(Arc::clone(scene)));
    let rate = |tracing: &mut PhotonTracing| {
        let seconds = tracing.trace_all(&subject.world);
        tracing.paths().path_count() as f64 * 1e-6 / seconds
    };
    let (mut on_card, mut on_cpu) = (Vec::new(), Vec::new());
    // The first finds out how many go at once.
    for round in 0..=rounds {
        let of_card = warmed(scene.gpu(), || {
            let mut tracing = PhotonTracing::new(settings);
            tracing.carry_by(Arc::clone(&card) as _);
            let rate = rate(&mut tracing);
            card.failure().map_or(Ok(rate), |error| Err(error.into()))
        })?;
        let of_cpu = rate(&mut PhotonTracing::new(settings));
        if round > 0 {
            on_card.push(of_card);
            on_cpu.push(of_cpu);
        }
    }
    let figure = Figure::new("photons", Unit::MillionPathsPerSecond, median(on_card));
    figures.push(Figure { cpu: Some(median(on_cpu)), ..figure });
    Ok(())
}

fn push_rates(figures: &mut SceneFigures<'_>, on_card: &Pass, on_cpu: &Pass) {
    push_milliseconds(figures, "path-traced pass", on_card, on_cpu);
    let paths = |pass: &Pass| pass.counts.paths as f64 * 1e-6 / pass.seconds;
    let rays = |pass: &Pass| pass.counts.all_rays() as f64 * 1e-6 / pass.seconds;
    let figure = Figure::new("path-traced pass", Unit::MillionPathsPerSecond, paths(on_card));
    figures.push(Figure { cpu: Some(paths(on_cpu)), ..figure });
    let figure = Figure::new("path-traced pass", Unit::MillionRaysPerSecond, rays(on_card));
    figures.push(Figure { cpu: Some(rays(on_cpu)), ..figure });
}

fn push_milliseconds(figures: &mut SceneFigures<'_>, name: &str, on_card: &Pass, on_cpu: &Pass) {
    let figure = Figure::new(name, Unit::Milliseconds, 1e3 * on_card.seconds);
    figures.push(Figure { cpu: Some(1e3 * on_cpu.seconds), ..figure });
}

impl Drawing<'_> {
    /// What the card itself is busy with in a pass, step by step.
    fn push_steps(
        &self,
        card: &GpuPathTracer,
        what: &str,
        shadows: Shadows,
        figures: &mut SceneFigures<'_>,
    ) -> Result<(), Box<dyn Error>> {
        // Some drivers compile at first use.
        card.step_seconds(&self.view, self.size, shadows)?;
        let steps = warmed(card.scene().gpu(), || Ok(card.step_seconds(&self.view, self.size, shadows)?))?;
        let Some(steps) = steps else { return Ok(()) };
        let all: f64 = steps.by_name().iter().map(|(_, seconds)| seconds).sum();
        let sum = Figure::new(format!("{what}: steps, one after the other"), Unit::Milliseconds, f64::NAN);
        figures.push(Figure { gpu_device: Some(1e3 * all), gpu_wall: None, ..sum });
        for (name, seconds) in steps.by_name() {
            let share = Figure::new(format!("{what}: share of {name}"), Unit::Percent, f64::NAN);
            figures.push(Figure { gpu_device: Some(100.0 * seconds / all), gpu_wall: None, ..share });
        }
        Ok(())
    }

    /// Medians of the card and of the CPU, which take turns.
    fn compare(
        &self,
        card: &mut GpuPathTracer,
        mut cpu: PathTracer,
        focused: &Focused,
        rounds: usize,
    ) -> Result<[Pass; 2], Box<dyn Error>> {
        let mut films = [Film::new(self.size), Film::new(self.size)];
        let (mut of_card, mut of_cpu) = (Vec::new(), Vec::new());
        for round in 0..WARM_UP_PASSES + rounds {
            let gpu = Arc::clone(card.scene().gpu());
            let on_card = warmed(&gpu, || {
                let pass = self.pass(card, focused, &mut films[0]);
                card.failure().map_or(Ok(pass), |error| Err(error.clone().into()))
            })?;
            let on_cpu = self.pass(&mut cpu, focused, &mut films[1]);
            if round >= WARM_UP_PASSES {
                of_card.push(on_card);
                of_cpu.push(on_cpu);
            }
        }
        Ok([of_card, of_cpu].map(|passes| Pass {
            seconds: median(passes.iter().map(|pass| pass.seconds).collect()),
            counts: passes.first().map_or_else(Counts::default, |pass| pass.counts),
        }))
    }

    fn pass(&self, technique: &mut dyn Technique, focused: &Focused, film: &mut Film) -> Pass {
        let canvas = Some(Canvas { view: &self.view, film });
        let mut products = Products { caustics: focused.clone(), ..Products::default() };
        let (products, cancel) = (&mut products, &AtomicBool::new(false));
        let start = Instant::now();
        let progress = technique.step(&mut Step { world: &self.subject.world, products, canvas, cancel });
        Pass { seconds: start.elapsed().as_secs_f64(), counts: progress.counts }
    }

    /// Million rays a second along which light is gathered for records, direct and from the octree, past what is near: by the card
    /// and by the CPU, which take turns. Medians.
    fn gather(
        &self,
        scene: &Arc<GpuScene>,
        known: &Arc<dyn SecondaryLight>,
        rounds: usize,
    ) -> Result<[f64; 2], Box<dyn Error>> {
        let world = scene.world();
        let rays = rays_over_a_picture(world, &self.view, self.size, 1);
        let on_card = Arc::new(GpuGatherer::new(Arc::clone(scene)));
        let on_cpu = Arc::new(GpuGatherer::new(Arc::clone(scene)));
        on_cpu.stop();
        let mut rates = [Vec::new(), Vec::new()];
        for round in 0..WARM_UP_PASSES + rounds {
            let gather = |gatherer: &Arc<GpuGatherer>| {
                let tracer = PathTracer::with_secondary(PathSettings::all(None, 0), Arc::clone(known));
                let arriving = ArrivingByGpu::new(tracer, Arc::clone(gatherer));
                let start = Instant::now();
                arriving.along(world, &rays, &AtomicBool::new(false), &mut Counts::default());
                let rate = rays.len() as f64 * 1e-6 / start.elapsed().as_secs_f64();
                gatherer.failure().map_or(Ok(rate), |error| Err(error.into()))
            };
            let of_round = [warmed(scene.gpu(), || gather(&on_card))?, gather(&on_cpu)?];
            if round >= WARM_UP_PASSES {
                rates.iter_mut().zip(of_round).for_each(|(rates, rate)| rates.push(rate));
            }
        }
        Ok(rates.map(median))
    }

    /// Photons of a first pass; `None` where nothing focuses light.
    fn focus(&self) -> Focused {
        let mut caustics = Caustics::new(CausticSettings::of(self.size.pixel_count(), None, 0));
        caustics.prepare(&self.subject.world, 0, &AtomicBool::new(false));
        caustics.map()
    }

    /// What the view sees of a sketch of caustics, counted on the card and on the CPU, which take turns; `None` where no card takes it.
    fn sketch(
        &self,
        scene: &Arc<GpuScene>,
        rounds: usize,
        figures: &mut SceneFigures<'_>,
    ) -> Result<Focused, Box<dyn Error>> {
        let sketch = Arc::new(CausticSketch::of(&self.subject.world, &CausticSettings::for_sketch(None, 0)));
        let mut seen = None;
        let (mut on_card, mut on_cpu) = (Vec::new(), Vec::new());
        // The first compiles what counts it.
        for round in 0..=rounds {
            let Some(light) = sketch.for_card(&self.view) else { return Ok(None) };
            let start = Instant::now();
            scene.is_fit(&light)?;
            let of_card = start.elapsed().as_secs_f64();
            let start = Instant::now();
            sketch.seen_by(&self.view);
            if round > 0 {
                on_card.push(1e3 * of_card);
                on_cpu.push(1e3 * start.elapsed().as_secs_f64());
            }
            seen = Some(light);
        }
        let figure = Figure::new("sketch of caustics: counted", Unit::Milliseconds, median(on_card));
        figures.push(Figure { cpu: Some(median(on_cpu)), ..figure });
        Ok(seen)
    }

    /// As many records of what the view sees as [`RECORDS`], about, gathered once each.
    fn records(&self, known: &Arc<dyn SecondaryLight>) -> Arc<dyn SecondaryLight> {
        let settings =
            IrradianceSettings { visits: Visits::exactly(NonZeroU32::MIN), ..IrradianceSettings::default() };
        let arriving = PathTracer::with_secondary(PathSettings::all(None, 0), Arc::clone(known));
        let mut caching = IrradianceCaching::new(settings, Arc::new(arriving), Some(Arc::clone(known)));
        caching.look(0, &self.subject.view, self.size);
        let cancel = AtomicBool::new(false);
        while !caching.is_complete() && caching.cache().records().len() < RECORDS {
            let products = &mut Products::default();
            let world = &*self.subject.world;
            caching.step(&mut Step { world, products, canvas: None, cancel: &cancel });
        }
        caching.snapshot()
    }

    /// What `--indirect octree` knows of the light in the end, and the seconds that took.
    fn learn(&self) -> (Option<Arc<dyn SecondaryLight>>, f64) {
        let start = Instant::now();
        let settings = RenderSettings { indirect: Indirect::Octree, ..RenderSettings::default() };
        let mut illumination = Illumination::new(IlluminationSettings::of(&settings));
        while illumination.stage() != Stage::Complete {
            illumination.step(&self.subject.world, &AtomicBool::new(false));
        }
        (illumination.known().cloned(), start.elapsed().as_secs_f64())
    }
}
