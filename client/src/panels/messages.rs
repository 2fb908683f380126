//! What the server found odd in the scene, and what went wrong so far.

use crate::model::Model;
use crate::model::notices::Severity;
use crate::theme;
use egui::{RichText, Ui};

/// Warnings drawn; a file may have thousands, of which the first tell the story.
const WARNINGS_SHOWN: usize = 100;

/// How many lines [`show`] has.
pub fn count(model: &Model) -> usize {
    let warnings = model.scene.as_ref().map_or(0, |scene| scene.description.warnings.len());
    warnings + model.notices.iter().count()
}

/// The whole panel.
pub fn show(ui: &mut Ui, model: &Model) {
    if count(model) == 0 {
        ui.label(RichText::new("Nothing to report.").color(theme::WEAK));
        return;
    }
    for notice in model.notices.iter().rev() {
        let colour = match notice.severity {
            Severity::Error => theme::ERROR,
            Severity::Info => theme::INFO,
        };
        let times = if notice.count > 1 { format!("  ×{}", notice.count) } else { String::new() };
        ui.label(RichText::new(format!("{}{times}", notice.title)).color(colour));
        if !notice.detail.is_empty() {
            ui.label(RichText::new(&notice.detail).small().color(theme::WEAK));
        }
    }
    let Some(scene) = &model.scene else { return };
    let warnings = &scene.description.warnings;
    for warning in warnings.iter().take(WARNINGS_SHOWN) {
        ui.label(RichText::new(&warning.object).color(theme::ACCENT));
        ui.label(RichText::new(&warning.message).small().color(theme::WEAK));
    }
    if warnings.len() > WARNINGS_SHOWN {
        ui.label(RichText::new(format!("… and {} more", warnings.len() - WARNINGS_SHOWN)).color(theme::WEAK));
    }
}
