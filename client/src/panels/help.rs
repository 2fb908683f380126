//! What mouse and keys do.

use crate::theme;
use egui::{Grid, RichText};

const LINES: [(&str, &str); 14] = [
    ("Left drag", "orbit about the focus"),
    ("Middle drag, Shift + left drag", "pan"),
    ("Wheel, pinch", "closer, farther"),
    ("Right drag", "look around"),
    ("  + W A S D", "fly"),
    ("  + Q E", "fly down, up"),
    ("  + Shift", "fly four times as fast"),
    ("Click on a light's sign", "select it"),
    ("F", "go to what is selected, else show the whole scene"),
    ("Home", "show the whole scene"),
    ("1 … 9", "the scene's cameras"),
    ("Ctrl + Z, Ctrl + Shift + Z", "undo, redo an edit"),
    ("Tab", "hide or show the panels"),
    ("F1, Esc", "open, close this"),
];

/// The window; `open` becomes false when it is closed.
pub fn show(ctx: &egui::Context, open: &mut bool) {
    let window = egui::Window::new("Mouse and keys").open(open).resizable(false).collapsible(false);
    window.anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0]).show(ctx, |ui| {
        Grid::new("keys").num_columns(2).spacing([24.0, 6.0]).show(ui, |ui| {
            for (keys, does) in LINES {
                ui.label(RichText::new(keys).color(theme::ACCENT));
                ui.label(does);
                ui.end_row();
            }
        });
    });
}
