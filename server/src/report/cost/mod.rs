//! What accuracy costs in time: every technique, over a grid of its settings, against a reference.
//!
//! Each picture is drawn twice with numbers of its own, t₁ and t₂ after equal times. With the reference r the mean of
//! (t₁ − r)(t₂ − r) has the square of the systematic error as its expectation, that of (t₁ − t₂)² / 2 the variance: of samples, and
//! of what was learnt by chance. `target.rs` finds or draws references, `curves.rs` draws and compares, `prices.rs` tells what
//! follows; what effects take is here.

mod curves;
mod prices;
mod target;

use std::time::Duration;

use lumicast_engine::{
    effects::{EffectChoice, EffectChoices},
    film::PictureSize,
    render::{IlluminationSettings, Indirect, RenderSettings},
};
use serde::Serialize;

use self::target::Target;
use super::{
    Cost, ReportError,
    drawing::Drawing,
    notebook::Notebook,
    peers,
    subject::{Prepared, Subject},
    table::{Cell, Column, Table},
};

/// Names of tables.
pub(super) const CURVES: &str = "curves";
pub(super) const FRONT: &str = "front";
/// What stands for the backend of another renderer.
pub(super) const PEER: &str = "peer";
/// Pictures are looked at after so many seconds, and after twice as many again and again.
const FIRST_SECONDS: f64 = 0.25;

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
         reference, and empty where it may be chance. Noise: what they differ by, of samples and of light that was learnt by \
         chance. As it is shown live: what the program measures by itself, with its 95 % interval.",
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
            curves::curve(notebook, (target, &mut prepared), &way, cost)?;
        }
        for series in peers.iter().filter(|series| series.scene == target.subject.name) {
            curves::peer_curve(notebook, target, series)?;
        }
        prices::doubt_reference(notebook, &target.subject.name, target.own_noise_percent());
        prices::tell_what_cannot_be_told(notebook, &target.subject.name, 100.0 * target.least_told());
    }
    prices::front(notebook, subjects)?;
    prices::prices(notebook, subjects)?;
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
