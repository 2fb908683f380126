//! Caustics by photons of their own: what a frame of them costs, looked up in maps and filtered on the screen, and how soon
//! pictures with them are right, beside the path tracer. Larsen 2004, chapter 12, gives frames a second alone.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

use glam::Vec3;
use lumicast_engine::{
    accel::Hit,
    film::PictureSize,
    render::Indirect,
    technique::{
        FocusedLight, Products, Step, Technique, View,
        caustics::{CausticReport, CausticSettings, CausticSketch, Caustics},
    },
    transport::{Surface, World},
};
use rayon::prelude::*;

use super::{
    Effort, ReportError, accuracy,
    drawing::Drawing,
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Cell, Cells, Column, Table},
};

/// Scenes with mirrors and glass.
pub(super) const SCENES: [&str; 2] = ["cornell-glass", "cornell-glossy"];

/// Photons of a frame: the paper's, and more.
const PHOTONS: [u32; 3] = [10_000, 40_000, 160_000];
/// Side of the frame, pixels.
const SIDE: u32 = 512;
/// Frames whose mean is taken.
const FRAMES: u32 = 8;

const SCENE: Column = Column::given("scene", "scene");
const PHOTON_COUNT: Column = Column::given("photons", "photons a frame");
const STORED: Column = Column::here("stored", "on diffuse surfaces", "");
const PREPARE_MS: Column = Column::here("prepare_ms", "photons and map", "ms");
const LOOK_UP_MS: Column = Column::here("look_up_ms", "a look-up in every pixel, all threads at it", "ms");
const SKETCH_MS: Column = Column::here("sketch_ms", "photons for the screen", "ms");
const SCREEN_MS: Column = Column::here("screen_ms", "drawn and filtered there", "ms");
const BYTES: Column = Column::here("bytes", "memory", "kB");
const TECHNIQUE: Column = Column::given("technique", "technique");
const ELAPSED: Column = Column::given("elapsed", "after, s");
/// The curve of a row in plots.
pub(super) const CURVE: &str = "curve";
const PASSES: Column = Column::here("passes", "samples per pixel", "");
const ERROR: Column = Column::here("error_percent", "error", "%");
const TRIMMED: Column = Column::here("error_trimmed_percent", "trimmed", "%");
const BIAS: Column = Column::here("bias_percent", "bias", "%");

/// Measures both.
pub(super) fn measure(
    notebook: &mut Notebook,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    for subject in subjects {
        accuracy::explain(notebook, subject, &subject.prepare()?);
    }
    frames(notebook, subjects, effort)?;
    over_time(notebook, subjects, effort)
}

fn frames(notebook: &mut Notebook, subjects: &[Subject], effort: Effort) -> Result<(), ReportError> {
    let about = format!(
        "A frame of caustics at {SIDE} × {SIDE}: photons aimed at mirrors and glass, followed and laid out in a map, and one \
         look-up for what every pixel sees; and as many photons followed once for all cameras, drawn into a picture's pixels \
         and filtered there, as first pictures have them; means of {FRAMES} frames. The paper draws 35 frames/s of 512 × 512 on a GPU of \
         2004, all light included, with 10,000 photons of caustics followed over 8 frames and filtered on the screen."
    );
    let columns = [SCENE, PHOTON_COUNT, STORED, PREPARE_MS, LOOK_UP_MS, BYTES, SKETCH_MS, SCREEN_MS];
    notebook.begin(Table::new("caustic-frames", "Caustics frame by frame", about, &columns));
    for subject in subjects {
        for photons in PHOTONS.map(|count| effort.photons(count)) {
            notebook.row(&format!("{} {photons}", subject.name), || frame(subject, photons))?;
        }
    }
    Ok(())
}

/// As many photons as asked for, whatever the solid angle of what they are aimed at.
fn frame(subject: &Subject, photons: u32) -> Result<Cells, ReportError> {
    let prepared = subject.prepare()?;
    let size = PictureSize::new(SIDE, SIDE)
        .map_err(|error| ReportError::Text { what: "a picture", reason: error.to_string() })?;
    let of = CausticSettings::of(size.pixel_count(), None, 0);
    let of = CausticSettings { photons_per_pass: u32::MAX, photons_max: photons, ..of };
    let mut caustics = Caustics::new(of);
    let empty = || ReportError::Empty { name: subject.name.clone(), missing: "light on mirrors or glass" };
    // The first also finds how far photons are to be blurred.
    next(&mut caustics, &prepared).ok_or_else(empty)?;
    let before = caustics.report();
    let (mut seconds, mut look_up) = (Duration::ZERO, Duration::ZERO);
    let seen = Seen::of(&prepared, size);
    for _ in 0..FRAMES {
        let start = Instant::now();
        let map = next(&mut caustics, &prepared).ok_or_else(empty)?;
        seconds += start.elapsed();
        look_up += seen.look_up(&prepared.world, &*map);
    }
    let CausticReport { photons_stored, bytes, .. } = caustics.report();
    let (mut sketching, mut filtering) = (Duration::ZERO, Some(Duration::ZERO));
    for _ in 0..FRAMES {
        let start = Instant::now();
        let sketch = CausticSketch::of(&prepared.world, &of);
        sketching += start.elapsed();
        let start = Instant::now();
        let screen = sketch.seen_by(&seen.view);
        let drawn = start.elapsed();
        let filtered = screen.map(|screen| drawn + seen.look_up(&prepared.world, &*screen));
        filtering = filtering.zip(filtered).map(|(sum, filtered)| sum + filtered);
    }
    let frames = f64::from(FRAMES);
    Ok([
        (SCENE, Cell::from(subject.name.as_str())),
        (PHOTON_COUNT, f64::from(photons).into()),
        (STORED, ((photons_stored - before.photons_stored) as f64 / frames).into()),
        (PREPARE_MS, (1e3 * seconds.as_secs_f64() / frames).into()),
        (LOOK_UP_MS, (1e3 * look_up.as_secs_f64() / frames).into()),
        (BYTES, (bytes as f64 * 1e-3).into()),
        (SKETCH_MS, (1e3 * sketching.as_secs_f64() / frames).into()),
        // Where few photons show from near they are not used.
        (SCREEN_MS, filtering.map(|sum| 1e3 * sum.as_secs_f64() / frames).into()),
    ]
    .map(|(column, cell)| (column.key.to_string(), cell))
    .into())
}

fn next(caustics: &mut Caustics, prepared: &Prepared) -> Option<Arc<dyn FocusedLight>> {
    let never = AtomicBool::new(false);
    let mut products = Products::default();
    let world = &prepared.world;
    caustics.step(&mut Step { world, products: &mut products, canvas: None, cancel: &never });
    products.caustics
}

/// What every pixel's middle sees, and the unit direction from the eye.
struct Seen {
    view: View,
    hits: Vec<(Hit, Vec3)>,
}

/// Surfaces that are looked up at one go: they stay in the cache, as the one surface does that a path has met.
const SURFACES: usize = 64;

impl Seen {
    fn of(prepared: &Prepared, size: PictureSize) -> Seen {
        let view = View::new(&prepared.world, &prepared.view, size);
        let pixels = (0..size.height()).flat_map(|y| (0..size.width()).map(move |x| (x, y)));
        let seen = pixels.filter_map(|(x, y)| {
            let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5);
            Some((prepared.world.closest_hit(&ray)?, ray.direction))
        });
        Seen { view, hits: seen.collect() }
    }

    /// Looks caustics up there; returns how long that took, were all threads at it all the time.
    fn look_up(&self, world: &World, map: &dyn FocusedLight) -> Duration {
        let of_some = |hits: &[(Hit, Vec3)]| {
            let surface_of = |(hit, direction): &(Hit, Vec3)| (world.surface(hit, *direction), -*direction);
            let surfaces: Vec<(Surface, Vec3)> = hits.iter().map(surface_of).collect();
            let start = Instant::now();
            for (surface, wo) in &surfaces {
                std::hint::black_box(map.scattered(surface, *wo, u32::MAX));
            }
            start.elapsed()
        };
        self.hits.par_chunks(SURFACES).map(of_some).sum::<Duration>() / rayon::current_num_threads() as u32
    }
}

fn over_time(notebook: &mut Notebook, subjects: &[Subject], effort: Effort) -> Result<(), ReportError> {
    let about = "Error of whole pictures against the reference over time: light looked up in records with caustics by photons, \
                 and the path tracer, which gets eight times as long.";
    let columns = [SCENE, TECHNIQUE, ELAPSED, PASSES, ERROR, TRIMMED, BIAS];
    notebook.begin(Table::new("caustic-error", "Error over time", about.into(), &columns));
    for subject in subjects {
        for (name, indirect, steps) in [
            ("photons", Indirect::Irradiance, effort.fill_steps),
            ("path", Indirect::Path, effort.fill_steps + 3),
        ] {
            let mut drawing: Option<Drawing> = None;
            for step in 0..steps {
                let elapsed = 0.25 * f64::from(1 << step);
                notebook.row(&format!("{} {name} after {elapsed} s", subject.name), || {
                    let drawing = match &mut drawing {
                        Some(drawing) => drawing,
                        None => drawing.insert(Drawing::begin(subject.prepare()?, indirect)),
                    };
                    drawing.advance(Duration::from_secs_f64(elapsed));
                    cells(drawing, subject, name, elapsed)
                })?;
            }
        }
    }
    Ok(())
}

fn cells(drawing: &Drawing, subject: &Subject, name: &str, elapsed: f64) -> Result<Cells, ReportError> {
    let error = drawing.error(subject)?;
    let percent = |of: Option<f64>| Cell::from(of.map(|share| 100.0 * share));
    Ok([
        (SCENE, Cell::from(subject.name.as_str())),
        (TECHNIQUE, name.into()),
        (ELAPSED, elapsed.into()),
        (PASSES, f64::from(drawing.rendering.passes()).into()),
        (ERROR, percent(error.as_ref().map(|error| error.error()))),
        (TRIMMED, percent(error.as_ref().map(|error| error.trimmed.sqrt()))),
        (BIAS, percent(error.as_ref().map(|error| error.bias))),
    ]
    .map(|(column, cell)| (column.key.to_string(), cell))
    .into_iter()
    .chain([(CURVE.into(), format!("{}, {name}", subject.name).as_str().into())])
    .collect())
}
