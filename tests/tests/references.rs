//! Our path tracer against pictures of an independent renderer, the shared references: the difference is noise.
//!
//! Every picture is rendered twice with different seeds, and the two halves tell how noisy their mean is without any
//! assumption. Both it and the reference are averaged over blocks of 8×8 pixels, which lowers noise and keeps bias.
//! By default two cheap cameras with a few seconds each; `LUMICAST_NIGHTLY=1` takes every shared reference with
//! `LUMICAST_REFERENCE_SECONDS` (20) each, `LUMICAST_REFERENCE=sponza-nave` that one. Skipped, with a word, where there is no shared folder.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use lumicast::assets::{AssetLimits, load_scene};
use lumicast::images::decode_exr;
use lumicast_engine::film::{PictureSize, compare};
use lumicast_engine::math::Rgb;
use lumicast_engine::render::{RenderSettings, Rendering};
use lumicast_engine::transport::World;
use lumicast_tests::shared_folder;

/// Side of the blocks that are compared, pixels.
const BLOCK: usize = 8;

/// Difference of the means that is allowed beside noise: the figure.
const BIAS_MAX: f64 = 0.01;

/// Deviation of a block that is allowed beside noise: the references are half floats (relative steps of 2⁻¹¹, at most
/// 0.05 %), and differ from us in how the eye ray meets edges of triangles; 0.5 % per block is half of the bias.
const SYSTEMATIC_RELMSE: f64 = 0.005 * 0.005;

#[test]
fn pictures_differ_from_the_references_by_noise_only() {
    let Some(shared) = shared_folder().filter(|folder| folder.join("references/noise.json").is_file()) else {
        println!("SKIPPED references: no ../shared beside the project");
        return;
    };
    let is_nightly = std::env::var("LUMICAST_NIGHTLY").is_ok_and(|value| value == "1");
    let seconds = std::env::var("LUMICAST_REFERENCE_SECONDS")
        .map_or(if is_nightly { 20.0 } else { 4.0 }, |text| {
            text.parse().expect("LUMICAST_REFERENCE_SECONDS")
        });
    let mut subjects = subjects(&shared);
    if let Ok(name) = std::env::var("LUMICAST_REFERENCE") {
        subjects.retain(|subject| subject.name == name);
    } else if !is_nightly {
        subjects.retain(|subject| ["cornell-box-main", "two-rooms-roomA"].contains(&subject.name.as_str()));
    }
    assert!(!subjects.is_empty(), "no scene for any reference in {}", shared.display());
    println!(
        "{seconds} s each; √relMSE of blocks of 8×8, in %: found, expected from our noise and the reference's, most"
    );
    println!(
        "{:<26} {:>7} {:>18} {:>7} {:>8} {:>7}",
        "scene-camera", "samples", "bias %", "found", "expected", "most"
    );
    let failures: Vec<String> = subjects.iter().filter_map(|subject| judge(subject, seconds).err()).collect();
    assert!(failures.is_empty(), "{failures:#?}");
}

/// A reference and what to render for it.
struct Subject {
    name: String,
    scene: PathBuf,
    camera: String,
    reference: PathBuf,
    size: PictureSize,
    /// relMSE of the reference itself, per pixel.
    noise: f64,
}

/// The full pictures of `noise.json`; direct light alone is a layer, which `film` tests.
fn subjects(shared: &Path) -> Vec<Subject> {
    let noise = std::fs::read(shared.join("references/noise.json")).expect("noise.json");
    let noise: serde_json::Value = serde_json::from_slice(&noise).expect("noise.json is JSON");
    let entries = noise.as_object().expect("an object").iter().filter(|(name, _)| !name.ends_with("-direct"));
    entries
        .map(|(name, facts)| {
            let (scene, camera) = name.rsplit_once('-').expect("SCENE-CAMERA");
            let number = |field: &str| facts[field].as_f64().unwrap_or_else(|| panic!("{name}: no {field}"));
            Subject {
                name: name.clone(),
                scene: shared.join(format!("scenes/{scene}.glb")),
                camera: camera.into(),
                reference: shared.join(format!("references/{name}.exr")),
                size: PictureSize::new(number("w") as u32, number("h") as u32).expect("a size"),
                noise: number("noise_relMSE"),
            }
        })
        .collect()
}

/// Renders, prints a line of the table, and says what is wrong.
fn judge(subject: &Subject, seconds: f64) -> Result<(), String> {
    let reference = reference_of(&subject.reference, subject.size);
    let (halves, samples) = two_halves(subject, seconds);
    let verdict = Verdict::of(subject, &halves, &reference);
    println!(
        "{:<26} {samples:>7} {:>8.2} ± {:>5.2} {:>9.2} {:>8.2} {:>7.2}",
        subject.name,
        100.0 * verdict.bias,
        100.0 * verdict.bias_error,
        100.0 * verdict.found.sqrt(),
        100.0 * verdict.expected.sqrt(),
        100.0 * verdict.most.sqrt(),
    );
    let name = &subject.name;
    let bias_max = BIAS_MAX + 3.0 * verdict.bias_error;
    let (is_biased, is_far) = (verdict.bias.abs() > bias_max, verdict.found > verdict.most);
    if verdict.bias.is_nan() || verdict.found.is_nan() || is_biased || is_far {
        return Err(format!(
            "{name}: bias {:.4}, at most {bias_max:.4}; relMSE of blocks {:.3e}, at most {:.3e}; worst blocks: {}",
            verdict.bias, verdict.found, verdict.most, verdict.worst
        ));
    }
    Ok(())
}

/// The picture twice, with different seeds, pass by pass in turn, and the samples per pixel of each.
fn two_halves(subject: &Subject, seconds: f64) -> ([Vec<Rgb>; 2], u32) {
    let scene = load_scene(&subject.scene, &AssetLimits::default()).unwrap_or_else(|error| panic!("{error}"));
    let view =
        scene.camera_view(Some(&subject.camera)).unwrap_or_else(|| panic!("{}: no camera", subject.name));
    let world = Arc::new(World::prepare(Arc::new(scene)));
    let mut halves = [1, 2].map(|seed| {
        let settings = RenderSettings { seed, ..RenderSettings::default() };
        Rendering::new(world.clone(), view, subject.size, settings)
    });
    let end = Instant::now() + Duration::from_secs_f64(seconds);
    // Two passes at least, however slow the machine.
    while Instant::now() < end || halves[0].passes() < 2 {
        for half in &mut halves {
            half.step(&AtomicBool::new(false));
        }
    }
    for half in &halves {
        assert_eq!(half.film().dropped_samples(), 0, "{}: samples that are no numbers", subject.name);
    }
    let samples = halves[0].passes();
    (halves.map(|half| half.film().radiance()), samples)
}

struct Verdict {
    bias: f64,
    /// Standard error of `bias`.
    bias_error: f64,
    /// relMSE of the blocks.
    found: f64,
    /// The same as our noise and the reference's predict it.
    expected: f64,
    /// Bound on `found`.
    most: f64,
    /// The blocks that contribute most to `found`, for people.
    worst: String,
}

impl Verdict {
    fn of(subject: &Subject, halves: &[Vec<Rgb>; 2], reference: &[Rgb]) -> Verdict {
        let [a, b] = [0, 1].map(|half| blocks(&halves[half], subject.size));
        let reference = blocks(reference, subject.size);
        let mean: Vec<Rgb> = a.iter().zip(&b).map(|(a, b)| (*a + *b) * 0.5).collect();
        let error = compare(&mean, &reference).expect("pictures of one size, and the reference is not black");
        let reference_mean =
            reference.iter().map(|rgb| channels_mean(*rgb)).sum::<f64>() / reference.len() as f64;
        let floor = 0.01 * reference_mean * reference_mean;
        // Var(mean of halves) = E[(a − b)²] / 4, whatever the distribution.
        let squared = |a: f32, b: f32| (f64::from(a) - f64::from(b)).powi(2) / 4.0;
        let ours: Vec<f64> = (0..a.len())
            .map(|block| {
                let relative = |c: usize| {
                    squared(a[block][c], b[block][c]) / (f64::from(reference[block][c]).powi(2) + floor)
                };
                (0..3).map(relative).sum::<f64>() / 3.0
            })
            .collect();
        let count = ours.len() as f64;
        let deviation = |block: usize| {
            let relative = |c: usize| {
                let (found, wanted) = (f64::from(mean[block][c]), f64::from(reference[block][c]));
                (found - wanted).powi(2) / (wanted * wanted + floor)
            };
            (0..3).map(relative).sum::<f64>() / 3.0
        };
        let mut order: Vec<usize> = (0..a.len()).collect();
        order.sort_by(|a, b| deviation(*b).total_cmp(&deviation(*a)));
        let columns = subject.size.width() as usize / BLOCK;
        let worst = order.iter().take(3).map(|block| {
            let (x, y) = (BLOCK * (block % columns), BLOCK * (block / columns));
            format!("at ({x}, {y}) {:?} and {:?}, reference {:?}", a[*block], b[*block], reference[*block])
        });
        let worst = worst.collect::<Vec<String>>().join("; ");
        let expected_ours = ours.iter().sum::<f64>() / count;
        // A single difference of halves is a χ²₁ times its variance: the mean over blocks knows how far it scatters.
        let scatter =
            (ours.iter().map(|value| (value - expected_ours).powi(2)).sum::<f64>() / count / count).sqrt();
        // Pixels of the reference are independent: averaging 64 divides the noise by 64.
        let expected_reference = subject.noise / (BLOCK * BLOCK) as f64;
        let bias_variance_ours = (0..a.len())
            .map(|block| (channels_mean(a[block]) - channels_mean(b[block])).powi(2) / 4.0)
            .sum::<f64>()
            / (count * count);
        let bias_variance_reference = expected_reference
            * reference.iter().map(|rgb| channels_mean(*rgb).powi(2) + floor).sum::<f64>()
            / (count * count);
        Verdict {
            bias: error.bias,
            bias_error: (bias_variance_ours + bias_variance_reference).sqrt() / reference_mean,
            found: error.rel_mse,
            expected: expected_ours + expected_reference,
            // Twice the reference's own noise, as its README says; ours with its scatter (of the prediction, and of
            // what is found, which scatters alike: 3·√2 standard deviations).
            most: expected_ours + 4.3 * scatter + 2.0 * expected_reference + SYSTEMATIC_RELMSE,
            worst,
        }
    }
}

fn channels_mean(rgb: Rgb) -> f64 {
    (0..3).map(|channel| f64::from(rgb[channel])).sum::<f64>() / 3.0
}

/// Means of whole blocks, rows top to bottom; what does not fill a block is left out, as `compare.py --down 8` does.
fn blocks(picture: &[Rgb], size: PictureSize) -> Vec<Rgb> {
    let (width, height) = (size.width() as usize, size.height() as usize);
    let block_at = |row: usize, column: usize| {
        let pixels = (0..BLOCK * BLOCK)
            .map(|index| picture[(row * BLOCK + index / BLOCK) * width + column * BLOCK + index % BLOCK]);
        pixels.fold(Rgb::BLACK, |sum, pixel| sum + pixel) * (1.0 / (BLOCK * BLOCK) as f32)
    };
    (0..height / BLOCK).flat_map(|row| (0..width / BLOCK).map(move |column| block_at(row, column))).collect()
}

fn reference_of(path: &Path, size: PictureSize) -> Vec<Rgb> {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let (found, pixels) = decode_exr(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(found, size, "{}", path.display());
    pixels
}

/// The law itself, on pictures made up: noise passes, a bias and a wrong corner do not.
#[test]
fn the_judgement_can_fail() {
    let size = PictureSize::new(64, 64).unwrap();
    let mut random = lumicast_tests::Random::new(1);
    let mut noisy = |level: f32, wrong_pixels: usize| -> Vec<Rgb> {
        (0..size.pixel_count())
            .map(|index| {
                let value = level * random.between(0.5, 1.5) as f32;
                Rgb::splat(if index < wrong_pixels { 1.5 * value } else { value })
            })
            .collect()
    };
    let reference = vec![Rgb::splat(1.0); size.pixel_count()];
    let subject = Subject {
        name: "made up".into(),
        scene: PathBuf::new(),
        camera: String::new(),
        reference: PathBuf::new(),
        size,
        noise: 1e-6,
    };
    let mut verdict =
        |level, wrong| Verdict::of(&subject, &[noisy(level, wrong), noisy(level, wrong)], &reference);
    let (good, biased, wrong) = (verdict(1.0, 0), verdict(1.1, 0), verdict(1.0, 512));
    assert!(good.bias.abs() < BIAS_MAX + 3.0 * good.bias_error && good.found < good.most);
    assert!(biased.bias.abs() > BIAS_MAX + 3.0 * biased.bias_error);
    assert!(wrong.found > wrong.most);
}
