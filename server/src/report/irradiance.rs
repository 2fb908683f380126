//! Table 8.2 and figure 8.11 of [Gautron2008], measured again, and what each option of the cache is worth.

use std::{
    num::NonZeroU32,
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

use lumicast_engine::{
    film::{PictureSize, compare},
    math::Rgb,
    render::{
        Illumination, IlluminationReport, IlluminationSettings, Indirect, Learner, RecordReport,
        RenderSettings, Rendering, Stage,
    },
    technique::{
        SecondaryLight,
        irradiance::{IrradianceSettings, Visits},
    },
};

use super::{
    Effort, ReportError, accuracy,
    drawing::Drawing,
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Cell, Cells, Column, Table},
};

/// Scenes of the paper; figure 8.11 is of the last one.
pub(super) const SCENES: [&str; 2] = ["sibenik", "sponza"];

/// Table 8.2 by the name of our scene: accuracy, records, seconds of the paper's cache on its GPU and of Radiance.
const TABLE_8_2: [(&str, [f64; 4]); 2] =
    [("sibenik", [0.15, 4076.0, 14.3, 425.0]), ("sponza", [0.1, 4123.0, 13.7, 645.0])];

/// Accuracies of table 8.2, and of the table of options.
const ACCURACIES_8_2: [f32; 2] = [0.15, 0.1];
const ACCURACIES: [f32; 4] = [0.4, 0.2, 0.15, 0.1];

/// Pixels that records of table 8.2 count over at least: what four are in pictures a quarter as wide.
const TABLE_PIXELS: f32 = 16.0;

/// Side of the blocks of pixels whose means are compared in table 8.2: takes most of the noise from both pictures.
const BLOCK: u32 = 4;

const SCENE: Column = Column::given("scene", "scene");
const ACCURACY: Column = Column::given("accuracy", "a");
const OPTIONS: Column = Column::given("options", "options");
const ELAPSED: Column = Column::given("elapsed", "after, s");
const RECORDS: Column = Column::here("records", "records", "");
const PAPER_RECORDS: Column = Column::paper("paper_records", "paper's records", "");
const RAYS: Column = Column::here("rays", "rays", "10⁶");
const PHOTON_SECONDS: Column = Column::here("photon_seconds", "photons + octree", "s");
const SECONDS: Column = Column::here("seconds", "records", "s");
const PAPER_SECONDS: Column = Column::paper("paper_seconds", "paper's GPU", "s");
const PAPER_RADIANCE: Column = Column::paper("paper_radiance_seconds", "Radiance in the paper", "s");
const ONE_BOUNCE_ERROR: Column = Column::here("one_bounce_error_percent", "error", "%");
const ONE_BOUNCE_BIAS: Column = Column::here("one_bounce_bias_percent", "bias", "%");
const ONE_BOUNCE_NOISE: Column = Column::here("one_bounce_noise_percent", "noise of the reference", "%");
const BYTES: Column = Column::here("bytes_per_record", "bytes a record with index", "");
const PASSES: Column = Column::here("passes", "samples per pixel", "");
const FRAME_RATE: Column = Column::here("frames_per_second", "a pass at 512 × 512", "frames/s");
const ERROR: Column = Column::here("error_percent", "error", "%");

/// Measures both, and the options.
pub(super) fn measure(
    notebook: &mut Notebook,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    let wanted = || ReportError::NoScene { wanted: SCENES.join(".glb, ") + ".glb" };
    let last = subjects.last().ok_or_else(wanted)?;
    for subject in subjects {
        accuracy::explain(notebook, subject, &subject.prepare()?);
    }
    notebook.note(
        "Radiance on this machine is not run here: `rpict` or `rtrace` with one bounce, -aa as the accuracy and -ad 512 on the \
         same scene and size stand beside the seconds of table 8.2.",
    );
    table_8_2(notebook, subjects, effort)?;
    figure_8_11(notebook, last, effort)?;
    options(notebook, subjects, effort)
}

/// Records of a view, all made.
struct Made {
    light: Option<Arc<dyn SecondaryLight>>,
    records: RecordReport,
    photons: IlluminationReport,
    ray_count: u64,
}

fn made(
    prepared: &Prepared,
    size: PictureSize,
    settings: &RenderSettings,
    (of, effort): (IrradianceSettings, Effort),
) -> Made {
    let mut of = IlluminationSettings { irradiance: of, ..IlluminationSettings::of(settings) };
    of.photons.emitted_count = effort.photons(of.photons.emitted_count);
    of.octree.photon_count = effort.photons(of.octree.photon_count);
    of.irradiance.ray_count = effort.record_rays.unwrap_or(of.irradiance.ray_count);
    let Some(learnt) = settings.learns(&prepared.plan) else {
        let (records, photons) = Default::default();
        return Made { light: None, records, photons, ray_count: 0 };
    };
    let mut learner = Learner::new(learnt, settings, of);
    learner.look(0, &prepared.view, size);
    let never = AtomicBool::new(false);
    while learner.stage() != Stage::Complete {
        learner.step(&prepared.world, &never);
    }
    let photons = learner.illumination().map(Illumination::report).unwrap_or_default();
    let counts = learner.counts() - photons.counts;
    Made {
        light: learner.known().cloned(),
        records: learner.records(),
        photons,
        ray_count: counts.all_rays(),
    }
}

impl Made {
    fn cells(&self, subject: &Subject) -> Cells {
        let per_record = self.records.bytes as f64 / self.records.count.max(1) as f64;
        [
            (SCENE, Cell::from(subject.name.as_str())),
            (RECORDS, (self.records.count as f64).into()),
            (RAYS, (self.ray_count as f64 * 1e-6).into()),
            (PHOTON_SECONDS, (self.photons.photon_seconds + self.photons.octree_seconds).into()),
            (SECONDS, self.records.seconds.into()),
            (BYTES, per_record.into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell))
        .into()
    }
}

fn with_accuracy(accuracy: f32) -> IrradianceSettings {
    let mut of =
        IrradianceSettings { visits: Visits::exactly(NonZeroU32::MIN), ..IrradianceSettings::default() };
    of.weighing.accuracy = accuracy;
    of
}

fn table_8_2(notebook: &mut Notebook, subjects: &[Subject], effort: Effort) -> Result<(), ReportError> {
    let side = effort.cache_side;
    let about = format!(
        "Records of one indirect bounce for {side} × {side} pixels, each gathered once, by the accuracy a; each counts {TABLE_PIXELS} \
         pixels far at least, or a quarter of that where light is steep. The paper's \
         records are made by rendering half-planes on its GPU. Error: √relMSE against our path tracer with as many \
         bounces and {} samples per pixel, both in means of {BLOCK} × {BLOCK} pixels.",
        effort.one_bounce_passes
    );
    let columns = [
        SCENE,
        ACCURACY,
        RECORDS,
        PAPER_RECORDS,
        RAYS,
        PHOTON_SECONDS,
        SECONDS,
        PAPER_SECONDS,
        PAPER_RADIANCE,
        ONE_BOUNCE_ERROR,
        ONE_BOUNCE_BIAS,
        ONE_BOUNCE_NOISE,
        BYTES,
    ];
    notebook.begin(Table::new("table-8.2-cache", "Table 8.2: one bounce", about, &columns));
    let mut reference: Option<(String, Prepared, Vec<Rgb>, Option<f64>)> = None;
    for subject in subjects {
        let paper = TABLE_8_2.iter().find(|(name, _)| *name == subject.name).map(|(_, figures)| figures);
        for accuracy in ACCURACIES_8_2 {
            notebook.row(&format!("{} a {accuracy}", subject.name), || {
                let size = PictureSize::new(side, side)
                    .map_err(|error| ReportError::Text { what: "a picture", reason: error.to_string() })?;
                let known = reference.take().filter(|(name, ..)| *name == subject.name);
                let (_, prepared, truth, noise) = &*reference.insert(match known {
                    Some(known) => known,
                    None => {
                        let prepared = subject.prepare()?;
                        let (truth, noise) = one_bounce(&prepared, size, effort.one_bounce_passes);
                        (subject.name.clone(), prepared, truth, noise)
                    }
                });
                let settings = with_one_bounce(Indirect::Irradiance);
                let of = IrradianceSettings { pixels_min: TABLE_PIXELS, ..with_accuracy(accuracy) };
                let made = made(prepared, size, &settings, (of, effort));
                let mut cells = made.cells(subject);
                let picture = drawn(prepared, size, &settings, made.light, effort.cache_passes);
                let error = compare(&blocks(&picture, size), truth).map_err(|error| ReportError::Text {
                    what: "the comparison with the path tracer",
                    reason: format!("{}: {error}", subject.name),
                })?;
                let is_papers = |figures: &&[f64; 4]| (figures[0] - f64::from(accuracy)).abs() < 1e-6;
                let figure = |index: usize| Cell::from(paper.filter(is_papers).map(|figures| figures[index]));
                cells.extend(
                    [
                        (ACCURACY, Cell::from(f64::from(accuracy))),
                        (PAPER_RECORDS, figure(1)),
                        (PAPER_SECONDS, figure(2)),
                        (PAPER_RADIANCE, figure(3)),
                        (ONE_BOUNCE_ERROR, (100.0 * error.error()).into()),
                        (ONE_BOUNCE_BIAS, (100.0 * error.bias).into()),
                        (ONE_BOUNCE_NOISE, noise.map(|noise| 100.0 * noise).into()),
                    ]
                    .map(|(column, cell)| (column.key.to_string(), cell)),
                );
                Ok(cells)
            })?;
        }
    }
    Ok(())
}

fn with_one_bounce(indirect: Indirect) -> RenderSettings {
    RenderSettings { indirect, bounces_max: Some(2), ..RenderSettings::default() }
}

/// A path-traced picture in means of blocks, and its noise.
fn one_bounce(prepared: &Prepared, size: PictureSize, passes: u32) -> (Vec<Rgb>, Option<f64>) {
    // Other numbers than those of the pictures it is compared with.
    let settings = RenderSettings { seed: 1, ..with_one_bounce(Indirect::Path) };
    let mut rendering = Rendering::new(prepared.world.clone(), prepared.view, size, settings);
    let never = AtomicBool::new(false);
    while rendering.passes() < passes {
        rendering.step(&never);
    }
    let noise = rendering.measured_error().map(|measured| measured.error() / f64::from(BLOCK));
    (blocks(&rendering.picture().radiance(), size), noise)
}

fn drawn(
    prepared: &Prepared,
    size: PictureSize,
    settings: &RenderSettings,
    light: Option<Arc<dyn SecondaryLight>>,
    passes: u32,
) -> Vec<Rgb> {
    let scene = (prepared.world.clone(), &prepared.plan);
    let mut rendering = Rendering::with(scene, prepared.view, size, *settings, light);
    let never = AtomicBool::new(false);
    while rendering.passes() < passes {
        rendering.step(&never);
    }
    rendering.picture().radiance()
}

/// Means of whole blocks, row by row.
fn blocks(picture: &[Rgb], size: PictureSize) -> Vec<Rgb> {
    let width = size.width();
    let at = |x: u32, y: u32| picture[(y * width + x) as usize];
    (0..size.height() / BLOCK)
        .flat_map(|row| (0..width / BLOCK).map(move |column| (column * BLOCK, row * BLOCK)))
        .map(|(left, top)| {
            let pixels = (top..top + BLOCK).flat_map(|y| (left..left + BLOCK).map(move |x| (x, y)));
            let sum = pixels.fold(Rgb::BLACK, |sum, (x, y)| sum + at(x, y));
            sum * (1.0 / (BLOCK * BLOCK) as f32)
        })
        .collect()
}

fn figure_8_11(notebook: &mut Notebook, subject: &Subject, effort: Effort) -> Result<(), ReportError> {
    let about = format!(
        "A picture of {} while its records are made, at most 100 found missing together, all bounces. Error over time of the \
         picture as it is shown, at the size of the reference; and how many passes a second of 512 × 512 could be drawn with \
         what is known then. The paper: 5 frames/s while filling, 32 frames/s when full, on its GPU.",
        subject.name
    );
    let columns = [SCENE, ELAPSED, RECORDS, PASSES, FRAME_RATE, ERROR];
    notebook.begin(Table::new("figure-8.11", "Figure 8.11: while the cache fills", about, &columns));
    let mut filling: Option<Filling> = None;
    for step in 0..effort.fill_steps {
        let elapsed = 0.25 * f64::from(1 << step);
        notebook.row(&format!("{} after {elapsed} s", subject.name), || {
            let filling = match &mut filling {
                Some(filling) => filling,
                None => filling.insert(Filling(Drawing::begin(subject.prepare()?, Indirect::Irradiance))),
            };
            filling.0.advance(Duration::from_secs_f64(elapsed));
            filling.cells(subject, elapsed)
        })?;
    }
    Ok(())
}

/// A picture that is drawn while its records are made.
struct Filling(Drawing);

impl Filling {
    fn cells(&self, subject: &Subject, elapsed: f64) -> Result<Cells, ReportError> {
        let error = self.0.error(subject)?.map(|error| 100.0 * error.error());
        Ok([
            (SCENE, Cell::from(subject.name.as_str())),
            (ELAPSED, elapsed.into()),
            (RECORDS, (self.0.rendering.records().count as f64).into()),
            (PASSES, f64::from(self.0.rendering.passes()).into()),
            (FRAME_RATE, self.frame_rate().into()),
            (ERROR, error.into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell))
        .into())
    }

    /// Passes a second of 512 × 512 with what is known by now.
    fn frame_rate(&self) -> Option<f64> {
        let size = PictureSize::new(512, 512).ok()?;
        let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
        let Prepared { world, plan, view, .. } = &self.0.prepared;
        let known = self.0.rendering.known().cloned();
        let mut rendering = Rendering::with((world.clone(), plan), *view, size, settings, known);
        let start = Instant::now();
        rendering.step(&AtomicBool::new(false));
        Some(1.0 / start.elapsed().as_secs_f64())
    }
}

fn options(notebook: &mut Notebook, subjects: &[Subject], effort: Effort) -> Result<(), ReportError> {
    let about = "Records of all bounces for the reference's view and size, by the accuracy a, and what each option is worth at \
                 a = 0.15: without gradients, with the original weight instead of the one that ends smoothly, without \
                 clamping by neighbours, and with light gathered four times for every record.";
    let columns: Vec<Column> = [SCENE, ACCURACY, OPTIONS, RECORDS, RAYS, PHOTON_SECONDS, SECONDS]
        .into_iter()
        .chain(accuracy::COLUMNS)
        .collect();
    notebook.begin(Table::new("cache-options", "Accuracy and options", about.into(), &columns));
    let usual = with_accuracy(0.15);
    let [mut plain, mut original, mut unclamped, mut refined] = [usual; 4];
    plain.weighing.has_gradients = false;
    original.weighing.is_smooth = false;
    unclamped.clamps_neighbours = false;
    refined.visits = Visits::exactly(IrradianceSettings::default().visits.least);
    let by_accuracy = ACCURACIES.map(|accuracy| ("usual", with_accuracy(accuracy)));
    let variants = [
        ("no gradients", plain),
        ("original weight", original),
        ("no clamping", unclamped),
        ("refined", refined),
    ];
    let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
    for subject in subjects {
        let mut prepared: Option<Prepared> = None;
        for (name, of) in by_accuracy.into_iter().chain(variants) {
            let accuracy = of.weighing.accuracy;
            notebook.row(&format!("{} a {accuracy} {name}", subject.name), || {
                let prepared = match &mut prepared {
                    Some(prepared) => prepared,
                    None => prepared.insert(subject.prepare()?),
                };
                let made = made(prepared, prepared.size, &settings, (of, effort));
                let mut cells = made.cells(subject);
                cells.insert(ACCURACY.key.into(), f64::from(accuracy).into());
                cells.insert(OPTIONS.key.into(), name.into());
                if let Some(light) = made.light {
                    accuracy::add(&mut cells, subject, prepared, light, effort.passes)?;
                }
                Ok(cells)
            })?;
        }
    }
    Ok(())
}
