//! The line under the picture: the few numbers one always wants to see.

use super::numbers;
use crate::model::Model;
use crate::theme;
use egui::{Align, Layout, RichText, Ui};

/// The whole line.
pub fn show(ui: &mut Ui, model: &Model, now_s: f64) {
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 14.0;
        let frame = model.frame.as_ref();
        let error = frame.and_then(|frame| frame.error);
        let converged = frame.is_some_and(|frame| frame.converged);
        let colour = if converged { theme::GOOD } else { theme::TEXT };
        let text =
            error.map_or("error –".into(), |error| format!("error {}", numbers::percent(error.into())));
        ui.label(RichText::new(text).color(colour)).on_hover_text("√relMSE of the picture on show");
        if let Some(frame) = frame {
            let plural = if frame.samples == 1 { "" } else { "s" };
            ui.label(format!("{} sample{plural}", numbers::count(frame.samples.into())));
        }
        ui.label(format!("{:.1} frames/s", model.rate.frames_per_second(now_s)));
        if let Some(p50) = model.camera_latencies.percentile_s(0.5) {
            ui.label(format!("latency {}", numbers::duration(p50))).on_hover_text("Camera to frame, median");
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if let Some(scene) = &model.scene {
                ui.label(format!("revision {}", scene.description.revision));
            }
            if let Some(frame) = frame {
                let [width, height] = frame.size;
                ui.label(RichText::new(format!("{width} × {height}")).color(theme::WEAK));
            }
        });
    });
}
