//! `--stats`: what a rendering took, did and reached.

use std::{collections::BTreeMap, time::Duration};

use lumicast_engine::{
    effects::{EffectKind, EffectPlan},
    film::MeasuredError,
    render::Indirect,
};
use lumicast_protocol::{Forecast, ForecastRecord};
use serde::Serialize;

use super::stop::StopReason;

/// The file of `--stats` and the output of `--json`. Keys of parts that did not run are 0 and named in `not_run`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Statistics {
    /// Version of the program.
    pub(super) version: &'static str,
    /// The scene as it was named.
    pub(super) scene: String,
    /// The camera; nothing for a view of the whole scene.
    pub(super) camera: Option<String>,
    /// Width and height in pixels.
    pub(super) size: [u32; 2],
    /// The picture that was written.
    pub(super) out: String,
    /// Technique of indirect light as it was asked for.
    pub(super) indirect: &'static str,
    /// Technique of the light in the picture.
    pub(super) technique: &'static str,
    /// Share of the path-traced picture in what is seen, beside one that is looked up, mean over the pixels; 1 where all light is path-traced.
    pub(super) path_traced: f64,
    /// Where light was computed.
    pub(super) backend: &'static str,
    /// Graphics adapter; nothing on the CPU.
    pub(super) adapter: Option<String>,
    /// Threads that rendered.
    pub(super) threads: usize,
    /// Seed of the random numbers.
    pub(super) seed: u64,
    /// Samples that every pixel has.
    pub(super) samples_per_pixel: u32,
    /// What ended it: samples, time, error, best (the technique cannot reach the error) or signal.
    pub(super) stopped_by: &'static str,
    /// Measured error, √relMSE, as a share.
    pub(super) error: Option<f64>,
    /// 95 % confidence interval of `error`.
    pub(super) error_ci: Option<[f64; 2]>,
    /// `error` without the worst 0.1 % of pixels; nothing for looked-up light, of which a few hundred pixels are measured.
    pub(super) error_trimmed: Option<f64>,
    /// When errors were or would be reached.
    pub(super) forecast: Vec<Forecast>,
    /// How often such forecasts were right on the way.
    pub(super) forecast_record: ForecastRecord,
    /// Seconds.
    pub(super) seconds: Seconds,
    /// How many.
    pub(super) counts: Counts,
    /// Memory of each structure.
    pub(super) bytes: Bytes,
    /// Each effect and why it ran or did not.
    pub(super) effects: BTreeMap<&'static str, EffectState>,
    /// Keys above that are 0 because their part does not exist yet or was not asked for.
    pub(super) not_run: Vec<&'static str>,
}

/// Seconds by part.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Seconds {
    /// Reading, decoding and checking the scene.
    pub(super) load: f64,
    /// Trees and lights.
    pub(super) bvh: f64,
    /// Photon maps.
    pub(super) photons: f64,
    /// Light octree.
    pub(super) octree: f64,
    /// Finding where irradiance records are missing, and gathering them.
    pub(super) gather: f64,
    /// Photons of caustics, and their maps.
    pub(super) caustics: f64,
    /// Splatting irradiance records onto the picture.
    pub(super) splat: f64,
    /// Sampling the picture, without that.
    pub(super) frame: f64,
    /// Compiling shaders.
    pub(super) shaders: f64,
    /// Everything from the start of the command, `load` and `shaders` included, to the finished picture in memory.
    pub(super) total: f64,
}

impl Seconds {
    /// Of everything that traces rays.
    fn of_rays(&self) -> f64 {
        self.photons + self.octree + self.gather + self.caustics + self.splat + self.frame
    }
}

/// How many of each.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Counts {
    /// Rays of both kinds.
    pub(super) rays: u64,
    /// Of these, rays towards lights.
    pub(super) shadow_rays: u64,
    /// Paths begun at the eye.
    pub(super) paths: u64,
    /// Samples that were not finite or negative and count as black.
    pub(super) dropped_samples: u64,
    /// Photons kept.
    pub(super) photons_stored: u64,
    /// Cells of the light octree.
    pub(super) voxels: u64,
    /// Virtual directional lights in them.
    pub(super) vdls: u64,
    /// Irradiance records.
    pub(super) records: u64,
    /// Photons sent towards mirrors and glass.
    pub(super) caustic_photons: u64,
    /// Of those, and of what they became, what fell on surfaces that show it.
    pub(super) caustic_photons_stored: u64,
    /// Light-map texels.
    pub(super) texels: u64,
}

/// Memory by structure.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Bytes {
    /// Vertices and triangles.
    pub(super) meshes: usize,
    /// Texels of the scene's textures.
    pub(super) textures: usize,
    /// Trees.
    pub(super) bvh: usize,
    /// Lights and their tree.
    pub(super) lights: usize,
    /// Photon paths and maps.
    pub(super) photons: usize,
    /// Light octree.
    pub(super) octree: usize,
    /// Irradiance records and their index.
    pub(super) records: usize,
    /// The newest map of caustics, and what says how far its photons are blurred.
    pub(super) caustics: usize,
    /// Sums of samples.
    pub(super) film: usize,
    /// All that is on the graphics card.
    pub(super) gpu: u64,
}

/// One effect in the statistics.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct EffectState {
    /// It ran.
    pub(super) on: bool,
    /// Why, or why not.
    pub(super) reason: String,
}

/// Keys whose parts no technique of today runs.
const NOT_BUILT: [&str; 1] = ["counts.texels"];
/// Keys of the irradiance cache.
const OF_RECORDS: [&str; 3] = ["seconds.gather", "counts.records", "bytes.records"];
/// Keys of records that the CPU lays out over the picture.
const OF_SPLATS: [&str; 1] = ["seconds.splat"];
/// Keys of caustics.
const OF_CAUSTICS: [&str; 4] =
    ["seconds.caustics", "counts.caustic_photons", "counts.caustic_photons_stored", "bytes.caustics"];
/// Keys of graphics cards.
const OF_THE_GPU: [&str; 2] = ["seconds.shaders", "bytes.gpu"];
/// Keys of the octree and its photons.
const OF_THE_OCTREE: [&str; 7] = [
    "seconds.photons",
    "seconds.octree",
    "counts.photons_stored",
    "counts.voxels",
    "counts.vdls",
    "bytes.photons",
    "bytes.octree",
];

/// Keys that are 0 because nothing of theirs ran.
pub(super) fn not_run(
    has_photons: bool,
    has_records: bool,
    has_splats: bool,
    has_caustics: bool,
    has_gpu: bool,
) -> Vec<&'static str> {
    let octree: &[&str] = if has_photons { &[] } else { &OF_THE_OCTREE };
    let records: &[&str] = if has_records { &[] } else { &OF_RECORDS };
    let splats: &[&str] = if has_splats { &[] } else { &OF_SPLATS };
    let caustics: &[&str] = if has_caustics { &[] } else { &OF_CAUSTICS };
    let gpu: &[&str] = if has_gpu { &[] } else { &OF_THE_GPU };
    NOT_BUILT.iter().chain(octree).chain(records).chain(splats).chain(caustics).chain(gpu).copied().collect()
}

/// The scene's plan as the options left it.
pub(super) fn effects(
    plan: &EffectPlan,
    indirect: Indirect,
    bounces: Option<u32>,
) -> BTreeMap<&'static str, EffectState> {
    let ruled_out = |kind: EffectKind| match kind {
        EffectKind::Caustics | EffectKind::Indirect if indirect == Indirect::None => Some("--indirect none"),
        // The path to a caustic or to indirect light scatters twice at least.
        EffectKind::Caustics | EffectKind::Indirect if bounces.is_some_and(|bounces| bounces < 2) => {
            Some("--bounces below 2")
        }
        _ => None,
    };
    plan.effects
        .iter()
        .map(|effect| {
            let state = match ruled_out(effect.kind).filter(|_| effect.is_on) {
                Some(option) => EffectState { on: false, reason: format!("turned off by {option}") },
                None if effect.kind == EffectKind::Caustics && effect.is_on && indirect == Indirect::Path => {
                    EffectState { on: true, reason: "path-traced with all other light: no photons".into() }
                }
                None => EffectState { on: effect.is_on, reason: effect.reason.clone() },
            };
            (effect.kind.name(), state)
        })
        .collect()
}

/// Error, interval and trimmed error as people are shown them.
pub(super) fn shown_errors(measured: Option<MeasuredError>) -> (Option<f64>, Option<[f64; 2]>, Option<f64>) {
    let error = measured.map(|measured| measured.error());
    let interval = measured.map(|measured| measured.error_interval_95());
    (error, interval, measured.and_then(|measured| measured.trimmed).map(f64::sqrt))
}

/// What to say of a picture that time or samples ended before it had the error asked for.
///
/// - `is_confirmed`: pixels that were taken since it seemed to have it say so too
pub(super) fn missed(
    ended: StopReason,
    target: Option<f64>,
    measured: Option<MeasuredError>,
    is_confirmed: bool,
) -> Option<String> {
    let target = target.filter(|_| matches!(ended, StopReason::Time | StopReason::Samples))?;
    let percent = (100.0 * target) as f32;
    let before = match measured {
        Some(measured) if measured.reaches(target) => {
            if is_confirmed {
                return None;
            }
            format!("further pixels confirmed {percent} %: it seems to be {:.2} %", 100.0 * measured.error())
        }
        Some(measured) if measured.error() <= target => {
            let [is, may_be] = [measured.error(), measured.error_interval_95()[1]].map(|error| 100.0 * error);
            format!("{percent} % was sure: it seems to be {is:.2} %, and may still be {may_be:.2} %")
        }
        Some(measured) => format!("it came to {percent} %: it is {:.2} %", 100.0 * measured.error()),
        None => format!("its error was known: {percent} % was asked for"),
    };
    Some(format!("--{} ended it before {before}", ended.name()))
}

/// What to say of a picture that took longer than the time it was given: it is whole after its first samples at the earliest.
///
/// - `taken_s`: of the time that the bound is on
pub(super) fn overran(bound: Option<Duration>, taken_s: f64, samples: u32) -> Option<String> {
    let bound_s = bound.filter(|_| samples == 1)?.as_secs_f64();
    (taken_s > OVERRUN_TOLD * bound_s + OVERRUN_LEAST_S).then(|| {
        format!(
            "--time {bound_s} s was over before every pixel had its first sample, which took {taken_s:.2} s"
        )
    })
}

/// Longer than it should have been by so much a picture is not without a word.
const OVERRUN_TOLD: f64 = 1.1;
const OVERRUN_LEAST_S: f64 = 0.02;

impl Statistics {
    /// One line for people.
    pub(super) fn summary(&self) -> String {
        let percent = |share: f64| share * 100.0;
        let error = match (self.error, self.error_ci) {
            (Some(error), Some([low, high])) => {
                format!("error {:.2} % ({:.2}–{:.2} %)", percent(error), percent(low), percent(high))
            }
            _ => "error unknown (not measured for long enough)".into(),
        };
        let shaders = match self.seconds.shaders {
            0.0 => String::new(),
            seconds => format!(", {seconds:.2} s to compile shaders"),
        };
        format!(
            "{}: {}×{} by {}, {} samples per pixel, {error}, {:.2} s (and {:.2} s to load{shaders}), {:.2} M rays/s, stopped by {}",
            self.out,
            self.size[0],
            self.size[1],
            self.made_by(),
            self.samples_per_pixel,
            self.seconds.total - self.seconds.load - self.seconds.shaders,
            self.seconds.load,
            self.counts.rays as f64 / self.seconds.of_rays().max(1e-9) / 1e6,
            self.stopped_by,
        )
    }

    /// The technique, and how much of a blend is path-traced.
    fn made_by(&self) -> String {
        let is_blend = self.technique.contains('+');
        let share = is_blend.then(|| format!(" ({:.0} % path-traced)", self.path_traced * 100.0));
        format!("{}{}", self.technique, share.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::scene::samples;

    /// Whoever waits longer than he asked for is told why.
    #[test]
    fn a_time_that_was_overrun_is_told() {
        let tenth = Some(Duration::from_millis(100));
        assert_eq!(overran(tenth, 0.125, 1), None);
        assert_eq!(overran(None, 100.0, 1), None);
        assert_eq!(overran(tenth, 0.456, 2), None);
        let told = overran(tenth, 0.456, 1).unwrap_or_default();
        assert!(told.starts_with("--time 0.1 s was over") && told.ends_with("took 0.46 s"), "{told}");
    }

    /// Whoever asks for an error and does not get it is told; nobody else is.
    #[test]
    fn an_error_that_was_missed_is_told() {
        let measured = |errors: [f64; 3]| {
            let [low, rel_mse, high] = errors.map(|error| error * error);
            Some(MeasuredError { rel_mse, interval_95: [low, high], ..MeasuredError::NONE })
        };
        let told = |ended, target, found| missed(ended, target, found, true).unwrap_or_default();
        let lucky = missed(StopReason::Time, Some(0.05), measured([0.01, 0.031, 0.049]), false);
        assert!(lucky.unwrap_or_default().ends_with("further pixels confirmed 5 %: it seems to be 3.10 %"));
        let wrong = measured([0.04, 0.05, 0.07]);
        let known = "--time ended it before it came to 2 %: it is 5.00 %";
        assert_eq!(told(StopReason::Time, Some(0.02), wrong), known);
        assert!(told(StopReason::Time, Some(1e-6), wrong).contains("to 0.0001 %:"));
        let doubtful = told(StopReason::Samples, Some(0.02), measured([0.0, 0.018, 0.03]));
        let is_told = doubtful.ends_with("2 % was sure: it seems to be 1.80 %, and may still be 3.00 %");
        assert!(doubtful.starts_with("--samples") && is_told, "{doubtful}");
        assert!(told(StopReason::Time, Some(0.02), None).ends_with("its error was known: 2 % was asked for"));
        assert_eq!(told(StopReason::Samples, Some(0.02), measured([0.01, 0.018, 0.0219])), "");
        assert_eq!(told(StopReason::Time, None, wrong), "");
        assert_eq!(told(StopReason::Error, Some(0.02), measured([0.01, 0.019, 0.02])), "");
        assert_eq!(told(StopReason::Best, Some(0.02), wrong), "");
    }

    /// Options turn effects off and say so; what the scene turned off keeps its own reason.
    #[test]
    fn options_turn_effects_off_by_name() {
        let plan = EffectPlan::of(&samples::cornell_box().unwrap());
        let all = effects(&plan, Indirect::Auto, None);
        assert!(all["indirect"].on && all["caustics"].on && !all["absorption"].on);
        for run in [effects(&plan, Indirect::None, None), effects(&plan, Indirect::Auto, Some(1))] {
            assert!(!run["indirect"].on && run["indirect"].reason.contains("--"));
            assert_eq!(run["absorption"], all["absorption"]);
        }
    }
}
