//! How good the picture is to become, by a word, and when it will be how good: the dial of time and error.

use super::form::{fact, line};
use crate::theme;
use egui::{RichText, Ui};
use lumicast_protocol::{Accuracy, ForecastRecord, ForecastWhen, Preset, Stats};

/// One button for each preset; none is pressed where the target is a number of its own.
pub fn show_presets(ui: &mut Ui, accuracy: &mut Accuracy) {
    let chosen = Preset::ALL.into_iter().find(|preset| match accuracy.preset {
        Some(chosen) => *preset == chosen,
        None => preset.error().is_some_and(|error| (error - accuracy.target_error).abs() < 1e-6),
    });
    line(ui, "Preset", "How good the picture is to become before it rests", |ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        let buttons = Preset::ALL.map(|preset| {
            let response = ui.selectable_label(chosen == Some(preset), words(preset));
            if response.clicked() {
                accuracy.preset = Some(preset);
                if let Some(error) = preset.error() {
                    accuracy.target_error = error;
                }
            }
            response
        });
        buttons.into_iter().reduce(|all, button| all | button).unwrap_or_else(|| ui.label(""))
    });
}

fn words(preset: Preset) -> &'static str {
    match preset {
        Preset::Ten => "10 %",
        Preset::Five => "5 %",
        Preset::Two => "2 %",
        Preset::One => "1 %",
        Preset::Converged => "best",
    }
}

/// Lines of when the picture had or will have each error, and how often that was said rightly.
pub fn show(ui: &mut Ui, stats: &Stats) {
    for forecast in &stats.forecast {
        let label = percent(forecast.error);
        let hint = "When the picture has this error, by what is known of it now";
        let text = RichText::new(forecast.to_string());
        let text = match forecast.when {
            ForecastWhen::Reached => text.color(theme::GOOD),
            ForecastWhen::In => text,
            _ => text.color(theme::WEAK),
        };
        fact(ui, &label, hint, text);
    }
    let ForecastRecord { judged, right, decided, held } = stats.forecast_record;
    if decided > 0 {
        let hint = "Forecasts for which it came between the times that were told, or within a quarter where none were";
        fact(ui, "Came true", hint, format!("{held} of {decided}"));
    }
    if judged > 0 {
        let hint = "Forecasts that named the time within a quarter of it, of those whose error was reached since or whose \
                    time went by";
        fact(ui, "To a quarter", hint, format!("{right} of {judged}"));
    }
}

/// Whole percents as people write them.
fn percent(fraction: f32) -> String {
    let percent = (f64::from(fraction) * 1e4).round() / 100.0;
    format!("{percent} %")
}
