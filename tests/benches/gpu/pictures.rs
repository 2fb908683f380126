//! The same picture from both backends.

use std::{error::Error, path::Path};

use lumicast::images::decode_exr;
use lumicast_engine::math::Rgb;
use serde_json::json;

/// A pixel is off by more than this share of itself or of the picture's mean, whichever is more.
const OFF: f32 = 1e-2;
/// What the means of both may differ by. Both draw the same numbers; rounding sends a few paths in ten thousand elsewhere,
/// each as likely to brighten as to darken.
const MEAN_OFF_MAX: f64 = 5e-3;
/// Share of the pixels that may be off: those that such a path begins in, more the more samples a pixel has.
const OFF_SHARE_MAX: f64 = 0.05;

/// Prints what sets `ours` (the card's) apart from `theirs`, as one line of JSON.
///
/// Errors: what cannot be read, and pictures that differ by more than rounding makes them.
pub(crate) fn compare(name: &str, ours: &Path, theirs: &Path) -> Result<(), Box<dyn Error>> {
    let [ours, theirs] = [read(ours)?, read(theirs)?];
    if ours.len() != theirs.len() || ours.is_empty() {
        return Err(format!("{name}: {} and {} pixels", ours.len(), theirs.len()).into());
    }
    let mean = lumicast_tests::mean(&theirs);
    let mean_ratio = lumicast_tests::mean(&ours) / mean;
    let off_count =
        ours.iter().zip(&theirs).filter(|(ours, theirs)| is_off(**ours, **theirs, mean as f32)).count();
    let off_share = off_count as f64 / ours.len() as f64;
    let is_same = (mean_ratio - 1.0).abs() <= MEAN_OFF_MAX && off_share <= OFF_SHARE_MAX;
    println!("{}", json!({"scene": name, "mean_ratio": mean_ratio, "off_share": off_share, "same": is_same}));
    if is_same {
        return Ok(());
    }
    Err(format!(
        "{name}: {mean_ratio:.5} times as bright on the card, {:.2} % of the pixels off by more than {OFF}",
        100.0 * off_share
    )
    .into())
}

fn is_off(ours: Rgb, theirs: Rgb, mean: f32) -> bool {
    let channels = [(ours.r, theirs.r), (ours.g, theirs.g), (ours.b, theirs.b)];
    // Not a number is off, too.
    channels.into_iter().any(|(a, b)| !((a - b).abs() <= OFF * b.abs().max(mean)))
}

fn read(path: &Path) -> Result<Vec<Rgb>, Box<dyn Error>> {
    let of_file = |error: &dyn Error| format!("{}: {error}", path.display());
    let bytes = std::fs::read(path).map_err(|error| of_file(&error))?;
    let (_, pixels) = decode_exr(&bytes).map_err(|error| of_file(&error))?;
    Ok(pixels)
}
