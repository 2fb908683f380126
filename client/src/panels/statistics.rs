//! How picture and line are doing: the error with its curve, frames, latencies, bytes.

use super::form::{fact, facts};
use super::{forecast, numbers, plot};
use crate::model::Model;
use crate::model::history::Latencies;
use crate::theme;
use egui::{RichText, Ui};

/// The whole panel.
pub fn show(ui: &mut Ui, model: &Model, now_s: f64) {
    plot::show(ui, &model.errors, model.accuracy().target().map(f64::from));
    ui.add_space(4.0);
    facts(ui, "statistics", |ui| {
        if let Some(stats) = &model.stats {
            forecast::show(ui, stats);
        }
        picture(ui, model);
        ui.end_row();
        line(ui, model, now_s);
    });
}

fn picture(ui: &mut Ui, model: &Model) {
    let stats = model.stats.as_ref();
    let error = stats.and_then(|stats| stats.error);
    let interval = stats.and_then(|stats| stats.error_ci);
    let text = match (error, interval) {
        (Some(error), Some([low, high])) => format!(
            "{}  ({} – {})",
            numbers::percent(error.into()),
            numbers::percent(low.into()).trim_end_matches(" %"),
            numbers::percent(high.into())
        ),
        (Some(error), None) => numbers::percent(error.into()),
        _ => "not measured yet".into(),
    };
    fact(ui, "Error", "√relMSE of the picture, with its 95 % interval", RichText::new(text).strong());
    let converged = model.frame.is_some_and(|frame| frame.converged);
    let state = if converged {
        RichText::new("converged, resting").color(theme::GOOD)
    } else {
        RichText::new("converging")
    };
    fact(ui, "State", "A converged picture rests until something changes", state);
    let Some(stats) = stats else { return };
    fact(ui, "Samples", "Per pixel, since the film restarted", numbers::count(stats.samples as f64));
    fact(ui, "Time", "Since the camera moved or the scene was edited", numbers::duration(stats.seconds));
    fact(ui, "Technique", "What the indirect light comes from", stats.technique.name());
    fact(ui, "Rays", "Traced for this viewer's film", format!("{}/s", numbers::count(stats.rays_per_second)));
    let [width, height] = stats.film_size;
    let scale = if stats.scale < 0.999 {
        format!("{width} × {height}  (scaled {:.0} %)", stats.scale * 100.0)
    } else {
        format!("{width} × {height}")
    };
    fact(
        ui,
        "Film",
        "Pixels rendered; smaller than the window while the camera moves, or edits follow each other, on a slow machine",
        scale,
    );
}

fn line(ui: &mut Ui, model: &Model, now_s: f64) {
    fact(ui, "Frames", "Shown, a second", format!("{:.1} /s", model.rate.frames_per_second(now_s)));
    let hint = "From moving the camera to the first picture of it on screen: last, median, 95th percentile";
    fact(ui, "Camera to frame", hint, latencies(&model.camera_latencies));
    let hint = "From an edit to the first picture that shows it: last, median, 95th percentile";
    fact(ui, "Edit to frame", hint, latencies(&model.edit_latencies));
    let round_trip = model.round_trip_s.map_or("–".into(), numbers::duration);
    fact(ui, "Round trip", "Ping to pong, through this program's and the server's queues", round_trip);
    fact(ui, "Received", "Pictures, a second", numbers::byte_rate(model.rate.bytes_per_second(now_s)));
    if let Some(stats) = &model.stats {
        let text = format!("{} sent, {} skipped", stats.frames_sent, stats.frames_skipped);
        fact(
            ui,
            "Frames so far",
            "Skipped ones were replaced by a newer one before they could be sent",
            text,
        );
    }
}

fn latencies(latencies: &Latencies) -> String {
    let all = [latencies.last_s(), latencies.percentile_s(0.5), latencies.percentile_s(0.95)];
    match all {
        [Some(last), Some(p50), Some(p95)] => {
            let ms = |seconds: f64| format!("{:.0}", seconds * 1e3);
            format!("{} · {} · {} ms", ms(last), ms(p50), ms(p95))
        }
        _ => "–".into(),
    }
}
