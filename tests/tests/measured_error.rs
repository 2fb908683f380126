//! Measured errors against true ones: how often the 95 % interval of a picture holds its true error, bias included.
//!
//! Every picture is judged by the error it shows, and by what it would show had other pixels been measured, as many times as
//! `LUMICAST_COVERAGE_AGAIN` says (4).
//!
//! By default the built-in room of boxes against a long run of the path tracer, with every technique that looks light up, a few
//! seeds each; nothing depends on a clock. `LUMICAST_NIGHTLY=1` takes every shared reference, too, with
//! `LUMICAST_COVERAGE_SEEDS` (10) pictures a technique with `LUMICAST_COVERAGE_RAYS` (200) a pixel, and prints a table;
//! `LUMICAST_COVERAGE_VIEWS` takes only those whose name (SCENE-CAMERA) holds it, `LUMICAST_COVERAGE_TECHNIQUE` one technique, and
//! `LUMICAST_COVERAGE_LIST=1` prints every interval. A reference has noise of its own: the interval holds
//! the true error if it holds anything between the distance to the reference and what is left of it without that noise.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use lumicast::assets::{AssetLimits, load_scene};
use lumicast::images::decode_exr;
use lumicast_engine::film::{MeasuredError, PictureSize, compare};
use lumicast_engine::math::Rgb;
use lumicast_engine::render::{Indirect, Learning, RenderSettings, Rendering};
use lumicast_engine::scene::{CameraView, samples};
use lumicast_engine::transport::World;
use lumicast_tests::shared_folder;

const TECHNIQUES: [Indirect; 3] = [Indirect::Octree, Indirect::Irradiance, Indirect::Auto];

/// A view with its reference.
struct Subject {
    name: String,
    world: Arc<World>,
    view: CameraView,
    size: PictureSize,
    reference: Vec<Rgb>,
    /// relMSE of the reference itself.
    noise: f64,
}

impl Subject {
    /// The room of boxes, path-traced with so many samples.
    fn boxes(samples: u32) -> Subject {
        let world = Arc::new(World::prepare(Arc::new(samples::boxes().expect("a scene"))));
        let view = world.scene().camera_view(None).expect("a camera");
        let size = PictureSize::new(64, 36).expect("a size");
        let settings = RenderSettings { seed: 1_000_000, ..RenderSettings::default() };
        let mut rendering = Rendering::new(world.clone(), view, size, settings);
        while rendering.passes() < samples {
            rendering.step(&AtomicBool::new(false));
        }
        let noise = rendering.measured_error().expect("samples").rel_mse;
        let reference = rendering.picture().radiance();
        Subject { name: "boxes".into(), world, view, size, reference, noise }
    }

    fn shared(shared: &Path, name: &str, facts: &serde_json::Value) -> Subject {
        let (scene, camera) = name.rsplit_once('-').expect("SCENE-CAMERA");
        let scene = load_scene(&shared.join(format!("scenes/{scene}.glb")), &AssetLimits::default())
            .unwrap_or_else(|error| panic!("{error}"));
        let view = scene.camera_view(Some(camera)).unwrap_or_else(|| panic!("{name}: no camera"));
        let bytes = std::fs::read(shared.join(format!("references/{name}.exr"))).expect("a reference");
        let (size, reference) = decode_exr(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        let noise = facts["noise_relMSE"].as_f64().expect("noise_relMSE");
        let world = Arc::new(World::prepare(Arc::new(scene)));
        Subject { name: name.into(), world, view, size, reference, noise }
    }

    /// A picture with so many rays a pixel: whether the interval that it shows holds the true error, and those that it would have shown with
    /// other pixels measured, so many times.
    fn judge(&self, indirect: Indirect, seed: u64, rays_a_pixel: u64, again: u64) -> Vec<Judgement> {
        let settings =
            RenderSettings { indirect, seed, learning: Learning::InStep, ..RenderSettings::default() };
        let mut rendering = Rendering::new(self.world.clone(), self.view, self.size, settings);
        let rays_max = rays_a_pixel * self.size.pixel_count() as u64;
        let is_enough = |rendering: &Rendering| {
            let counts = rendering.counts();
            rendering.passes() >= 4 && counts.all_rays() >= rays_max
        };
        while !is_enough(&rendering) {
            rendering.step(&AtomicBool::new(false));
        }
        let found = compare(&rendering.picture().radiance(), &self.reference).expect("one size, not black");
        let left = (found.rel_mse - self.noise).max(0.0);
        let judge = |measured: MeasuredError| {
            let [low, high] = measured.interval_95;
            Judgement {
                is_held: low <= found.rel_mse && high >= left,
                truth: left.sqrt(),
                measured: measured.error(),
                low: low.sqrt(),
                high: high.sqrt(),
            }
        };
        let shown = rendering.measured_error();
        let afresh = (1..=again).map(|number| rendering.measured_afresh((number << 32) + seed));
        std::iter::once(shown).chain(afresh).map(|error| judge(error.expect("enough is known"))).collect()
    }
}

struct Judgement {
    is_held: bool,
    truth: f64,
    measured: f64,
    low: f64,
    high: f64,
}

/// A number that the environment names.
fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().unwrap_or_else(|error| panic!("{name}: {error}")))
}

/// Judges so many pictures, prints a line of the table, and returns how many intervals hold the truth, and of how many.
fn judge_all(subject: &Subject, indirect: Indirect, seeds: u64, rays_a_pixel: u64) -> [u64; 2] {
    let again = number("LUMICAST_COVERAGE_AGAIN").unwrap_or(4);
    let all: Vec<Judgement> =
        (0..seeds).flat_map(|seed| subject.judge(indirect, seed, rays_a_pixel, again)).collect();
    if std::env::var("LUMICAST_COVERAGE_LIST").is_ok_and(|value| value == "1") {
        for judgement in &all {
            let Judgement { truth, measured, low, high, is_held } = judgement;
            let [truth, measured, low, high] = [truth, measured, low, high].map(|share| 100.0 * share);
            println!("    {truth:.2} is held {is_held}: {measured:.2} ({low:.2} to {high:.2})");
        }
    }
    let count = all.len() as u64;
    let mean = |of: fn(&Judgement) -> f64| all.iter().map(of).sum::<f64>() / count as f64;
    let percent = |of| 100.0 * mean(of);
    let scatter = mean(|judgement| (judgement.measured / judgement.truth).ln().powi(2)).sqrt().exp();
    let held = all.iter().filter(|judgement| judgement.is_held).count() as u64;
    println!(
        "{:<24} {:<12} {rays_a_pixel:>6} {:>8.2} {:>9.2} {:>8.2} {:>8.2} {scatter:>8.2} {held:>5} of {count}",
        subject.name,
        format!("{indirect:?}").to_lowercase(),
        percent(|judgement| judgement.truth),
        percent(|judgement| judgement.measured),
        percent(|judgement| judgement.low),
        percent(|judgement| judgement.high),
    );
    [held, count]
}

#[test]
fn intervals_hold_the_true_error() {
    let is_nightly = std::env::var("LUMICAST_NIGHTLY").is_ok_and(|value| value == "1");
    let seeds = number("LUMICAST_COVERAGE_SEEDS").unwrap_or(if is_nightly { 10 } else { 4 });
    println!(
        "means of √relMSE in %; low and high are the ends of the interval of 95 %; scatter is the factor by which what is measured is off\n{:<24} {:<12} {:>6} {:>8} {:>9} {:>8} {:>8} {:>8} held",
        "scene-camera", "technique", "rays", "true", "measured", "low", "high", "scatter"
    );
    let boxes = Subject::boxes(if is_nightly { 16_384 } else { 1_024 });
    let (mut held, mut count) = (0, 0);
    for indirect in TECHNIQUES {
        for rays_a_pixel in [300, 1200] {
            let [of_these, judged] = judge_all(&boxes, indirect, seeds, rays_a_pixel);
            held += of_these;
            count += judged;
        }
    }
    // 95 %, less what a normal distribution does not know of rare pixels, and less chance.
    assert!(held * 10 >= count * 9, "{held} of {count} intervals hold the true error");
    let shared =
        shared_folder().filter(|folder| is_nightly && folder.join("references/noise.json").is_file());
    let Some(shared) = shared else {
        println!("SKIPPED shared references: LUMICAST_NIGHTLY=1 and ../shared beside the project are needed");
        return;
    };
    let noise = std::fs::read(shared.join("references/noise.json")).expect("noise.json");
    let noise: serde_json::Value = serde_json::from_slice(&noise).expect("noise.json is JSON");
    let entries = noise.as_object().expect("an object").iter().filter(|(name, _)| !name.ends_with("-direct"));
    let views = std::env::var("LUMICAST_COVERAGE_VIEWS").unwrap_or_default();
    let technique = std::env::var("LUMICAST_COVERAGE_TECHNIQUE").unwrap_or_default();
    let is_asked = |indirect: &Indirect| format!("{indirect:?}").to_lowercase().contains(&technique);
    let rays_a_pixel = number("LUMICAST_COVERAGE_RAYS").unwrap_or(200);
    for (name, facts) in entries.filter(|(name, _)| name.contains(&views)) {
        let subject = Subject::shared(&shared, name, facts);
        for indirect in TECHNIQUES.into_iter().filter(is_asked) {
            // A table for people: through glass and in dark corners some hundred pixels see too little, and the README says so.
            judge_all(&subject, indirect, seeds, rays_a_pixel);
        }
    }
}
