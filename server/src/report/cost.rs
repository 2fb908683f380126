//! What accuracy costs in time: every technique, over a grid of its settings, against a reference.
//!
//! Each picture is drawn twice with numbers of its own, t₁ and t₂ after equal times. With the reference r the mean of
//! (t₁ − r)(t₂ − r) has the square of the systematic error as its expectation, that of (t₁ − t₂)² / 2 the variance: of samples, and
//! of what was learnt by chance.

use std::{path::Path, time::Duration};

use lumicast_engine::{
    effects::{EffectChoice, EffectChoices, EffectKind},
    film::{PictureSize, compare},
    math::Rgb,
    render::{Illumination, IlluminationSettings, Indirect, RenderSettings},
};
use serde::Serialize;

use super::{
    Cost, ReportError,
    drawing::Drawing,
    notebook::Notebook,
    peers, pictures,
    subject::{FullReference, Prepared, Subject, read},
    table::{Cell, Cells, Column, Row, Table},
};
use crate::images::{ExrLayers, PictureFacts, encode_exr, write_file};

/// Names of tables.
pub(super) const CURVES: &str = "curves";
pub(super) const FRONT: &str = "front";
/// What stands for the backend of another renderer.
pub(super) const PEER: &str = "peer";
/// Pictures are looked at after so many seconds, and after twice as many again and again.
const FIRST_SECONDS: f64 = 0.25;
/// A reference of our own is drawn so many times as long as a picture.
const REFERENCE_TIMES: f64 = 8.0;
/// Seeds of the two pictures, and of a reference of our own.
const SEEDS: [u64; 2] = [1, 2];
const REFERENCE_SEED: u64 = 0x7265_6665;
/// Errors whose price is said, percent.
const TARGETS_PERCENT: [f64; 5] = [20.0, 10.0, 5.0, 2.0, 1.0];

const SCENE: Column = Column::given("scene", "scene");
const TECHNIQUE: Column = Column::given("technique", "technique");
const SETTINGS: Column = Column::given("settings", "settings");
pub(super) const BACKEND: Column = Column::given("backend", "backend");
const ELAPSED: Column = Column::given("elapsed", "after, s");
const SAMPLES: Column = Column::here("samples", "samples per pixel", "");
const ERROR: Column = Column::here("error_percent", "error", "%");
/// What front and prices are of.
const CLEAN: Column = Column::here("clean_error_percent", "without the reference's noise", "%");
const TRIMMED: Column = Column::here("error_trimmed_percent", "trimmed", "%");
const BIAS: Column = Column::here("bias_percent", "bias", "%");
const SYSTEMATIC: Column = Column::here("systematic_percent", "systematic", "%");
const NOISE: Column = Column::here("noise_percent", "noise", "%");
const MEASURED: Column = Column::here("measured_percent", "as it is shown live", "%");
const LOW: Column = Column::here("measured_low_percent", "from", "%");
const HIGH: Column = Column::here("measured_high_percent", "to", "%");
const MEMORY: Column = Column::here("megabytes", "memory", "MB");
const CURVE: &str = "curve";
const REFERENCE: Column = Column::given("reference", "reference");
const SIZE: Column = Column::given("size", "size");
const REFERENCE_NOISE: Column = Column::here("reference_noise_percent", "its noise", "%");
const PREPARE: Column = Column::here("prepare_seconds", "trees and lights", "s");
const TARGET: Column = Column::given("target_percent", "error, %");
const SECONDS: Column = Column::here("seconds", "after", "s");
const EFFECT: Column = Column::given("effect", "effect");
const WITH: Column = Column::here("samples_with", "samples with it", "");
const WITHOUT: Column = Column::here("samples_without", "samples without", "");
const SHARE: Column = Column::here("share_percent", "share of the time", "%");

/// What figures depend on beside version and machine.
#[derive(Debug, Serialize)]
pub(super) struct Settings<'a> {
    ways: Vec<String>,
    seconds: f64,
    subjects: &'a [Subject],
}

impl<'a> Settings<'a> {
    pub(super) fn of(cost: &Cost, subjects: &'a [Subject]) -> Settings<'a> {
        Settings {
            ways: ways(cost).iter().map(|way| format!("{way:?}")).collect(),
            seconds: cost.time.as_secs_f64(),
            subjects,
        }
    }
}

fn name_of(technique: Indirect) -> &'static str {
    match technique {
        Indirect::Auto => "auto",
        Indirect::Octree => "octree",
        Indirect::Irradiance => "irradiance",
        Indirect::Path => "path",
        Indirect::None => "none",
    }
}

/// A technique with settings.
#[derive(Debug)]
struct Way {
    technique: Indirect,
    settings: &'static str,
    /// Of files.
    suffix: &'static str,
    illumination: IlluminationSettings,
}

/// The grid: what is usual, and what is faster and coarser.
fn ways(cost: &Cost) -> Vec<Way> {
    let usual = IlluminationSettings::of(&RenderSettings::default());
    let mut few = usual;
    (few.photons.emitted_count, few.octree.photon_count, few.octree.depth) = (125_000, 125_000, 6);
    let mut coarse = usual;
    coarse.irradiance.weighing.accuracy = 0.3;
    let of = |technique: &Indirect| {
        let grid = match technique {
            Indirect::Octree => vec![("usual", "", usual), ("125 k photons, depth 6", "-few", few)],
            Indirect::Irradiance => vec![("usual", "", usual), ("a = 0.3", "-coarse", coarse)],
            Indirect::Auto | Indirect::Path | Indirect::None => vec![("usual", "", usual)],
        };
        let technique = *technique;
        grid.into_iter().map(move |(settings, suffix, illumination)| Way {
            technique,
            settings,
            suffix,
            illumination,
        })
    };
    cost.techniques.iter().flat_map(of).collect()
}

/// Seconds at which pictures are looked at, the last one included.
fn times(cost: &Cost) -> Vec<f64> {
    let end = cost.time.as_secs_f64();
    let steps = (0..).map(|step| FIRST_SECONDS * f64::from(2u32.saturating_pow(step)));
    steps.take_while(|seconds| *seconds < 0.99 * end).chain([end]).collect()
}

/// A scene with what its pictures are compared with.
struct Target<'a> {
    subject: &'a Subject,
    reference: FullReference,
    mean: f64,
}

/// Measures curves, and what follows from them.
pub(super) fn measure(notebook: &mut Notebook, subjects: &[Subject], cost: &Cost) -> Result<(), ReportError> {
    explain(notebook);
    let peers = cost.peers.iter().map(|path| peers::read(path)).collect::<Result<Vec<_>, _>>()?.concat();
    let about = "What pictures are compared with: another renderer's picture where there is one, else one that was \
                 drawn here for eight times as long, by the path tracer where it finds all light.";
    let columns = [SCENE, REFERENCE, SIZE, REFERENCE_NOISE, PREPARE];
    notebook.begin(Table::new("references", "References", about.into(), &columns));
    let mut targets = Vec::new();
    for subject in subjects {
        match Target::of(notebook, subject, cost)? {
            Some(target) => targets.push(target),
            None => notebook.note(format!("{} is black: there is no error relative to that", subject.name)),
        }
    }
    for series in &peers {
        if !targets.iter().any(|target| target.subject.name == series.scene) {
            notebook.note(format!(
                "no scene is called {}: pictures of {} are left out",
                series.scene, series.peer
            ));
        }
    }
    let about = format!(
        "Each picture was drawn twice, {} s each time, and looked at on the way. Error: √relMSE against the reference. \
         Systematic: what both have in common, which no other seed would remove; less the noise of the \
         reference, and empty where it may be chance. Noise: \
         what they differ by, of samples and of light that was learnt by chance. As it is shown live: what the program measures by itself, with its 95 % interval.",
        cost.time.as_secs_f64()
    );
    let columns = [
        SCENE, TECHNIQUE, SETTINGS, BACKEND, ELAPSED, SAMPLES, ERROR, CLEAN, TRIMMED, BIAS, SYSTEMATIC,
        NOISE, MEASURED, LOW, HIGH, MEMORY,
    ];
    notebook.begin(Table::new(CURVES, "Error over time", about, &columns));
    for target in &targets {
        let mut prepared = None;
        for way in ways(cost) {
            curve(notebook, (target, &mut prepared), &way, cost)?;
        }
        for series in peers.iter().filter(|series| series.scene == target.subject.name) {
            peer_curve(notebook, target, series)?;
        }
    }
    front(notebook, subjects)?;
    prices(notebook, subjects)?;
    effects(notebook, &targets, cost)
}

fn explain(notebook: &mut Notebook) {
    notebook.note(
        "Error: √relMSE in percent, relMSE = mean over pixels and channels of (t − r)² / (r² + 0.01 m²), r the reference, m its \
         mean. Trimmed: the same without the worst 0.1 % of pixels. Bias: (mean t − mean r) / mean r. The noise of the reference \
         is part of it: where that is known its relMSE is taken off for the column without it, for systematic errors, the front and \
         prices; no less than a third of that noise is told.",
    );
    notebook.note(
        "Seconds are of learning and drawing, and of measuring the error on the way, on all threads; reading the scene and \
         building its trees comes before and stands in the table of references.",
    );
    notebook.note("Difference maps: black is no error, white as much as the brightness, or a tenth of the mean where it is darker.");
    notebook.note(
        "Memory: of films, photons, octree, records and caustics; the scene and its trees come beside.",
    );
}

impl<'a> Target<'a> {
    /// The reference of a scene, drawn now if there is none.
    fn of(
        notebook: &mut Notebook,
        subject: &'a Subject,
        cost: &Cost,
    ) -> Result<Option<Target<'a>>, ReportError> {
        let own = notebook.folder().join(format!("{}-reference.exr", file_name(&subject.name)));
        let start = std::time::Instant::now();
        let prepared = subject.prepare()?;
        let seconds = start.elapsed().as_secs_f64();
        let given = match &prepared.camera {
            Some(camera) => subject.full_reference(camera)?,
            None => None,
        };
        let camera = prepared.camera.clone();
        let mut size = prepared.size;
        if let Some(given) = &given {
            size = given.size;
        }
        if given.is_none() && !own.is_file() {
            notebook.forget(&subject.name);
        }
        let hides = hides_light(&prepared);
        if given.is_none() && hides {
            notebook.note(format!(
                "{}: no path finds its light of lamps without size by way of mirrors and clear glass. Its reference is drawn by \
                 auto, which blurs that a little; `path` lacks it.",
                subject.name
            ));
        }
        notebook.row(&subject.name, || {
            let (name, noise) = match (&given, camera) {
                (Some(given), Some(camera)) => (format!("{}-{camera}.exr", subject.name), given.noise),
                _ => draw_reference(prepared, cost, &own)?,
            };
            Ok([
                (SCENE, Cell::from(subject.name.as_str())),
                (REFERENCE, name.as_str().into()),
                (SIZE, shown_size(size).as_str().into()),
                (REFERENCE_NOISE, percent(noise)),
                (PREPARE, seconds.into()),
            ]
            .map(|(column, cell)| (column.key.to_string(), cell))
            .into())
        })?;
        let reference = match given {
            Some(given) => given,
            None => {
                let (size, picture) = read(&own)?;
                FullReference {
                    size,
                    picture,
                    noise: notebook.last(REFERENCE_NOISE).map(|noise| 0.01 * noise),
                }
            }
        };
        let pixels = &reference.picture;
        let mean = pixels.iter().map(|pixel| f64::from(pixel.mean())).sum::<f64>() / pixels.len() as f64;
        Ok((mean > 0.0 && mean.is_finite()).then_some(Target { subject, reference, mean }))
    }

    /// relMSE of the reference's own noise; nothing where nobody has measured it.
    fn noise(&self) -> f64 {
        self.reference.noise.unwrap_or(0.0).powi(2)
    }

    /// A relMSE less that of the reference's own noise, which it holds, and no less than can be told beside that.
    fn clean(&self, rel_mse: f64) -> f64 {
        (rel_mse - self.noise()).max(TOLD_APART * self.noise())
    }

    /// The same of what two pictures have in common; `None` where that is no more than the noise of the reference.
    fn clean_systematic(&self, systematic: Option<f64>) -> Option<f64> {
        systematic
            .map(|systematic| systematic - self.noise())
            .filter(|left| *left > TOLD_APART * self.noise())
    }
}

/// No path from the eye finds all of its light.
fn hides_light(prepared: &Prepared) -> bool {
    prepared.plan.is_on(EffectKind::Caustics) && prepared.plan.facts.hides_light()
}

/// What of a relMSE must be left beside that of the reference's noise to be told apart from it, a share of that noise.
const TOLD_APART: f64 = 0.1;

/// Draws a reference and keeps it; returns what it is and how noisy.
fn draw_reference(
    prepared: Prepared,
    cost: &Cost,
    path: &Path,
) -> Result<(String, Option<f64>), ReportError> {
    // What no path finds is brought by photons.
    let indirect = if hides_light(&prepared) { Indirect::Auto } else { Indirect::Path };
    let settings = RenderSettings { indirect, seed: REFERENCE_SEED, ..RenderSettings::default() };
    let mut drawing = Drawing::learning_by(prepared, settings, IlluminationSettings::of(&settings));
    drawing.advance(cost.time.mul_f64(REFERENCE_TIMES));
    let rendering = &drawing.rendering;
    let picture = rendering.picture();
    let noise = rendering.measured_error_of(&picture).map(|measured| measured.error());
    let facts = PictureFacts {
        revision: 1,
        seed: REFERENCE_SEED,
        samples_per_pixel: rendering.passes(),
        technique: name_of(indirect),
        error: noise,
        error_ci: None,
        seconds: Some(cost.time.as_secs_f64() * REFERENCE_TIMES),
    };
    let exr = encode_exr(&picture, ExrLayers::Plain, &facts)
        .map_err(|error| ReportError::Text { what: "a reference", reason: error.to_string() })?;
    write_file(path, &exr)?;
    Ok((format!("ours, {}, {} samples", name_of(indirect), rendering.passes()), noise))
}

fn percent(share: Option<f64>) -> Cell {
    Cell::from(share.map(|share| 100.0 * share))
}

fn shown_size(size: PictureSize) -> String {
    format!("{} × {}", size.width(), size.height())
}

/// A name of letters, digits and dashes, another one for each: what does not fit is spelt in numbers.
fn file_name(name: &str) -> String {
    let spelt = |letter: char| {
        let fits = letter.is_ascii_alphanumeric() || letter == '-';
        if fits { letter.to_string() } else { format!("_{:x}", u32::from(letter)) }
    };
    name.chars().map(spelt).collect()
}

/// Draws a picture twice and looks at both on the way.
///
/// - `prepared`: its scene, once it is read
fn curve(
    notebook: &mut Notebook,
    (target, prepared): (&Target<'_>, &mut Option<Prepared>),
    way: &Way,
    cost: &Cost,
) -> Result<(), ReportError> {
    let (scene, technique) = (target.subject.name.as_str(), name_of(way.technique));
    let mut pair: Option<[Drawing; 2]> = None;
    for seconds in times(cost) {
        notebook.row(&format!("{scene} {technique} {} after {seconds} s", way.settings), || {
            let pair = match &mut pair {
                Some(pair) => pair,
                None => pair.insert(begin(target, once(prepared, target)?, way)),
            };
            pair.iter_mut().for_each(|drawing| drawing.advance(Duration::from_secs_f64(seconds)));
            cells(target, way, pair)
        })?;
    }
    let name = format!("{}-{technique}{}", file_name(scene), way.suffix);
    let [picture, difference] = [format!("{name}.jpg"), format!("{name}-difference.jpg")];
    if let Some([drawing, _]) = &pair {
        let radiance = drawing.rendering.picture().radiance();
        let reference: &[Rgb] = &target.reference.picture;
        let path = |file: &str| notebook.folder().join(file);
        pictures::write_picture(&path(&picture), target.reference.size, &radiance, target.mean)?;
        let both = [&radiance, reference];
        pictures::write_difference(&path(&difference), target.reference.size, both, target.mean)?;
    }
    let end = cost.time.as_secs_f64();
    notebook.show(format!("{scene}, {technique}, {}, after {end} s", way.settings), picture);
    notebook.show(format!("{scene}, {technique}, {}: difference", way.settings), difference);
    Ok(())
}

/// The scene, read when it is first asked for.
fn once<'a>(prepared: &'a mut Option<Prepared>, target: &Target<'_>) -> Result<&'a Prepared, ReportError> {
    Ok(match prepared {
        Some(prepared) => prepared,
        None => prepared.insert(target.subject.prepare()?),
    })
}

fn begin(target: &Target<'_>, prepared: &Prepared, way: &Way) -> [Drawing; 2] {
    SEEDS.map(|seed| {
        let settings = RenderSettings { indirect: way.technique, seed, ..RenderSettings::default() };
        let mut illumination = way.illumination;
        (illumination.photons.seed, illumination.irradiance.seed) = (seed, seed);
        Drawing::learning_by(prepared.again(target.reference.size), settings, illumination)
    })
}

fn cells(target: &Target<'_>, way: &Way, pair: &[Drawing; 2]) -> Result<Cells, ReportError> {
    let reference = &target.reference.picture;
    let pictures = pair.each_ref().map(|drawing| drawing.rendering.picture());
    let radiances = pictures.each_ref().map(|picture| picture.radiance());
    let [first, second] = radiances.each_ref().map(|radiance| compare(radiance, reference));
    let fail = |error: lumicast_engine::film::CompareError| ReportError::Text {
        what: "the comparison with a reference",
        reason: format!("{}: {error}", target.subject.name),
    };
    let (first, second) = (first.map_err(fail)?, second.map_err(fail)?);
    let mean = |a: f64, b: f64| 0.5 * (a + b);
    let (systematic, noise) = split(&radiances, reference, target.mean);
    let rendering = &pair[0].rendering;
    let measured = rendering.measured_error_of(&pictures[0]);
    let interval = measured.map(|measured| measured.error_interval_95());
    let light = rendering.illumination().map(Illumination::report).unwrap_or_default();
    let bytes = rendering.film_bytes()
        + rendering.records().bytes
        + rendering.caustics().bytes
        + light.photon_bytes
        + light.octree_bytes;
    let mut cells = names(target, name_of(way.technique), way.settings, "cpu");
    cells.extend(
        [
            (ELAPSED, Cell::from(mean(pair[0].seconds(), pair[1].seconds()))),
            (SAMPLES, f64::from(rendering.passes()).into()),
            (ERROR, percent(Some(mean(first.rel_mse, second.rel_mse).sqrt()))),
            (CLEAN, percent(Some(target.clean(mean(first.rel_mse, second.rel_mse)).sqrt()))),
            (TRIMMED, percent(Some(mean(first.trimmed, second.trimmed).sqrt()))),
            (BIAS, percent(Some(mean(first.bias, second.bias)))),
            (SYSTEMATIC, percent(target.clean_systematic(systematic).map(f64::sqrt))),
            (NOISE, percent(Some(noise.sqrt()))),
            (MEASURED, percent(measured.map(|measured| measured.error()))),
            (LOW, percent(interval.map(|interval| interval[0]))),
            (HIGH, percent(interval.map(|interval| interval[1]))),
            (MEMORY, (bytes as f64 * 1e-6).into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell)),
    );
    Ok(cells)
}

fn names(target: &Target<'_>, technique: &str, settings: &str, backend: &str) -> Cells {
    let scene = target.subject.name.as_str();
    let curve = match settings {
        "" => format!("{scene}, {technique} (not ours)"),
        "usual" => format!("{scene}, {technique}"),
        _ => format!("{scene}, {technique}, {settings}"),
    };
    let names =
        [(SCENE.key, scene), (TECHNIQUE.key, technique), (SETTINGS.key, settings), (BACKEND.key, backend)];
    let names = names.into_iter().chain([(CURVE, curve.as_str())]);
    names.map(|(key, name)| (key.to_string(), Cell::from(name))).collect()
}

/// relMSE of what two pictures have in common, `None` where that may be chance, and of what they do not.
fn split([first, second]: &[Vec<Rgb>; 2], reference: &[Rgb], mean: f64) -> (Option<f64>, f64) {
    let floor = 0.01 * mean * mean;
    let count = reference.len().max(1) as f64;
    let (mut common, mut squares, mut noise) = (0.0, 0.0, 0.0);
    for ((a, b), r) in first.iter().zip(second).zip(reference) {
        let mut of_pixel = 0.0;
        for at in 0..3 {
            let [a, b, r] = [a[at], b[at], r[at]].map(f64::from);
            let scale = 1.0 / (3.0 * (r * r + floor));
            of_pixel += (a - r) * (b - r) * scale;
            noise += 0.5 * (a - b) * (a - b) * scale;
        }
        common += of_pixel;
        squares += of_pixel * of_pixel;
    }
    let common = common / count;
    let deviation = ((squares / count - common * common).max(0.0) / count).sqrt();
    ((common > 2.0 * deviation).then_some(common), noise / count)
}

/// What another renderer drew, compared with the same reference.
fn peer_curve(
    notebook: &mut Notebook,
    target: &Target<'_>,
    series: &peers::Series,
) -> Result<(), ReportError> {
    for point in &series.points {
        let broken = |reason: String| ReportError::Peer { path: point.exr.clone(), reason };
        let (size, picture) = read(&point.exr)?;
        if size != target.reference.size {
            let [size, wanted] = [size, target.reference.size].map(shown_size);
            return Err(broken(format!("it has {size} pixels, the reference {wanted}")));
        }
        let error =
            compare(&picture, &target.reference.picture).map_err(|error| broken(error.to_string()))?;
        let mut cells = names(target, &series.peer, "", PEER);
        cells.extend(
            [
                (ELAPSED, Cell::from(point.seconds)),
                (ERROR, percent(Some(error.error()))),
                (CLEAN, percent(Some(target.clean(error.rel_mse).sqrt()))),
                (TRIMMED, percent(Some(error.trimmed.sqrt()))),
                (BIAS, percent(Some(error.bias))),
            ]
            .map(|(column, cell)| (column.key.to_string(), cell)),
        );
        notebook.derive(&format!("{} {} after {} s", series.scene, series.peer, point.seconds), cells)?;
    }
    Ok(())
}

/// Rows of our own curves of a scene.
fn rows_of<'a>(notebook: &'a Notebook, scene: &str) -> Vec<&'a Row> {
    let is_ours = |row: &&Row| row.cells.get(BACKEND.key) != Some(&Cell::from(PEER));
    let is_of = |row: &&Row| row.cells.get(SCENE.key) == Some(&Cell::from(scene));
    notebook.table(CURVES).iter().flat_map(|table| &table.rows).filter(is_of).filter(is_ours).collect()
}

fn number(row: &Row, column: Column) -> f64 {
    row.cells.get(column.key).and_then(Cell::value).unwrap_or(f64::INFINITY)
}

fn copied(row: &Row, columns: &[Column]) -> Cells {
    let of = |column: &Column| Some((column.key.to_string(), row.cells.get(column.key)?.clone()));
    columns.iter().filter_map(of).collect()
}

/// Of every scene what has the least error for its time: no other is as good as soon.
fn front(notebook: &mut Notebook, subjects: &[Subject]) -> Result<(), ReportError> {
    let columns = [SCENE, ELAPSED, TECHNIQUE, SETTINGS, CLEAN];
    let about = "The Pareto front: nothing else had as little error as soon.";
    let rows: Vec<Cells> = subjects
        .iter()
        .flat_map(|subject| {
            let mut rows = rows_of(notebook, &subject.name);
            rows.sort_by(|a, b| {
                let by = |row: &Row| (number(row, ELAPSED), number(row, CLEAN));
                by(a).0.total_cmp(&by(b).0).then(by(a).1.total_cmp(&by(b).1))
            });
            let mut least = f64::INFINITY;
            rows.retain(|row| {
                let is_better = number(row, CLEAN) < least;
                least = least.min(number(row, CLEAN));
                is_better
            });
            rows.into_iter().map(|row| copied(row, &columns)).collect::<Vec<_>>()
        })
        .collect();
    notebook.begin(Table::new(FRONT, "The least error for a time", about.into(), &columns));
    for cells in rows {
        let key = format!("{} after {}", shown(&cells, SCENE), shown(&cells, ELAPSED));
        notebook.derive(&key, cells)?;
    }
    Ok(())
}

fn shown(cells: &Cells, column: Column) -> String {
    cells.get(column.key).unwrap_or(&Cell::Empty).shown()
}

/// Of every scene what each error costs, by the way that gets there first.
fn prices(notebook: &mut Notebook, subjects: &[Subject]) -> Result<(), ReportError> {
    let columns = [SCENE, TARGET, TECHNIQUE, SETTINGS, SECONDS];
    let about = "What first had so little error, and when; empty where nothing had within the time. Between two looks times are \
                 interpolated along the curve; what is there at the first look may have been there before.";
    let mut all = Vec::new();
    for subject in subjects {
        let rows = rows_of(notebook, &subject.name);
        for target in TARGETS_PERCENT {
            let reached = first_below(&rows, target);
            let mut cells: Cells =
                reached.map(|(_, row)| copied(row, &[TECHNIQUE, SETTINGS])).unwrap_or_default();
            cells.extend([
                (SCENE.key.to_string(), Cell::from(subject.name.as_str())),
                (TARGET.key.to_string(), target.into()),
                (SECONDS.key.to_string(), reached.map(|(seconds, _)| seconds).into()),
            ]);
            all.push((format!("{} {target} %", subject.name), cells));
        }
    }
    notebook.begin(Table::new("prices", "What an error costs", about.into(), &columns));
    all.into_iter().try_for_each(|(key, cells)| notebook.derive(&key, cells))
}

/// When the first of some curves came down to an error, and the row where it had.
fn first_below<'a>(rows: &[&'a Row], target: f64) -> Option<(f64, &'a Row)> {
    let mut first: Option<(f64, &Row)> = None;
    for (index, row) in rows.iter().enumerate() {
        if number(row, CLEAN) > target {
            continue;
        }
        // The row before is of the same curve, or this is its first.
        let before = index.checked_sub(1).map(|before| rows[before]);
        let before = before.filter(|before| before.cells.get(CURVE) == row.cells.get(CURVE));
        let seconds = match before {
            Some(before) if number(before, CLEAN) > target => {
                let [x0, x1] = [before, row].map(|row| number(row, ELAPSED).ln());
                let [y0, y1] = [before, row].map(|row| number(row, CLEAN).max(1e-9).ln());
                (x0 + (x1 - x0) * (target.ln() - y0) / (y1 - y0)).exp()
            }
            // Below already: an earlier row says when.
            Some(_) => continue,
            None => number(row, ELAPSED),
        };
        if first.is_none_or(|(least, _)| seconds < least) {
            first = Some((seconds, row));
        }
    }
    first
}

/// What each effect that can be turned off takes of the time.
fn effects(notebook: &mut Notebook, targets: &[Target<'_>], cost: &Cost) -> Result<(), ReportError> {
    let seconds = 0.5 * cost.time.as_secs_f64();
    let about = format!(
        "Samples per pixel that records of irradiance draw in {seconds} s, with everything that a scene calls for and without \
         one effect."
    );
    let columns = [SCENE, EFFECT, WITH, WITHOUT, SHARE];
    notebook.begin(Table::new("effects", "What effects take", about, &columns));
    for target in targets {
        let prepared = target.subject.prepare()?;
        let mut with = None;
        for kind in EffectChoices::KINDS.into_iter().filter(|kind| prepared.plan.is_on(*kind)) {
            notebook.row(&format!("{} {}", target.subject.name, kind.name()), || {
                let with = match with {
                    Some(with) => with,
                    None => *with.insert(samples(target, &prepared, EffectChoices::default(), seconds)),
                };
                let mut choices = EffectChoices::default();
                if let Some(choice) = choices.choice_mut(kind) {
                    *choice = EffectChoice::Off;
                }
                let without = samples(target, &prepared, choices, seconds);
                Ok([
                    (SCENE, Cell::from(target.subject.name.as_str())),
                    (EFFECT, kind.name().into()),
                    (WITH, with.into()),
                    (WITHOUT, without.into()),
                    (SHARE, percent(Some(1.0 - with / without))),
                ]
                .map(|(column, cell)| (column.key.to_string(), cell))
                .into())
            })?;
        }
    }
    Ok(())
}

/// Samples per pixel for each of so many seconds.
fn samples(target: &Target<'_>, prepared: &Prepared, effects: EffectChoices, seconds: f64) -> f64 {
    let settings = RenderSettings { indirect: Indirect::Irradiance, effects, ..RenderSettings::default() };
    let size = target.reference.size;
    let mut drawing =
        Drawing::learning_by(prepared.again(size), settings, IlluminationSettings::of(&settings));
    drawing.advance(Duration::from_secs_f64(seconds));
    let samples = drawing.rendering.sample_count() as f64 / size.pixel_count() as f64;
    samples * seconds / drawing.seconds()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(curve: &str, elapsed: f64, error: f64) -> Row {
        let cells = [(CURVE, Cell::from(curve)), (ELAPSED.key, elapsed.into()), (CLEAN.key, error.into())];
        Row { key: String::new(), cells: cells.map(|(key, cell)| (key.to_string(), cell)).into() }
    }

    /// A price is where a curve first comes down to the error, along the curve, and the least of all curves.
    #[test]
    fn prices_are_of_the_first_curve_to_get_there() {
        let rows = [
            row("a", 1.0, 40.0),
            row("a", 4.0, 10.0),
            row("a", 16.0, 2.5),
            row("b", 1.0, 16.0),
            row("b", 9.0, 15.0),
        ];
        let rows: Vec<&Row> = rows.iter().collect();
        let seconds = |target: f64| first_below(&rows, target).map(|(seconds, _)| seconds);
        assert_eq!(seconds(20.0), Some(1.0));
        assert!(seconds(5.0).is_some_and(|seconds| (seconds - 8.0).abs() < 1e-9), "{:?}", seconds(5.0));
        assert_eq!(seconds(1.0), None);
    }

    /// What two pictures share is systematic, what they differ by is noise; together they are the error.
    #[test]
    fn errors_are_split_into_what_stays_and_what_goes() {
        let reference = vec![Rgb::splat(1.0); 2];
        let pictures = [vec![Rgb::splat(1.3), Rgb::splat(1.1)], vec![Rgb::splat(1.1), Rgb::splat(1.3)]];
        let (systematic, noise) = split(&pictures, &reference, 1.0);
        let systematic = systematic.unwrap();
        assert!((systematic * 1.01 - 0.03).abs() < 1e-6 && (noise * 1.01 - 0.02).abs() < 1e-6);
        let error = compare(&pictures[0], &reference).unwrap().rel_mse;
        assert!((systematic + noise - error).abs() < 1e-6);
        // What may be chance is not told.
        let pictures = [vec![Rgb::splat(1.3), Rgb::splat(0.7)], vec![Rgb::splat(1.1), Rgb::splat(1.3)]];
        assert_eq!(split(&pictures, &reference, 1.0).0, None);
    }

    /// Names of files are as different as what they are of.
    #[test]
    fn file_names_tell_scenes_apart() {
        let names = ["my room", "my-room", "my--room", "my/room", "房間", "間房", "room_2d"].map(file_name);
        assert!(names.iter().all(|name| name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c))));
        let distinct: std::collections::HashSet<&String> = names.iter().collect();
        assert_eq!(distinct.len(), names.len(), "{names:?}");
    }

    /// Looks double until the end, which is always one.
    #[test]
    fn times_double_until_the_end() {
        let of = |seconds| {
            times(&Cost { techniques: vec![], time: Duration::from_secs_f64(seconds), peers: vec![] })
        };
        assert_eq!(of(3.0), [0.25, 0.5, 1.0, 2.0, 3.0]);
        assert_eq!(of(0.25), [0.25]);
        assert_eq!(of(0.01), [0.01]);
    }
}
