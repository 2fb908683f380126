//! Lines of a form: a label to the left, fields to the right, names for screen readers (and tests) on every field.

use crate::theme;
use egui::{DragValue, Grid, Response, RichText, Slider, Ui};
use std::ops::RangeInclusive;

/// Room for labels, so that the fields of all forms stand in one line.
const LABEL_WIDTH: f32 = 92.0;
/// A third of what is left in a panel of usual width.
const AXIS_WIDTH: f32 = 54.0;
/// Dragging a pixel changes a light's strength by this share of itself: 100 pixels are a factor of 2.7.
const STRENGTH_SPEED: f64 = 0.01;

/// Lines of a form.
pub fn form(ui: &mut Ui, salt: &str, lines: impl FnOnce(&mut Ui)) {
    Grid::new(salt).num_columns(2).min_col_width(LABEL_WIDTH).spacing([8.0, 5.0]).show(ui, lines);
}

/// Lines that only show: closer together than fields, which need room for a pointer.
pub fn facts(ui: &mut Ui, salt: &str, lines: impl FnOnce(&mut Ui)) {
    let grid = Grid::new(salt).num_columns(2).min_col_width(LABEL_WIDTH).min_row_height(16.0);
    grid.spacing([8.0, 3.0]).show(ui, lines);
}

/// One line. `hint` explains the field under the pointer.
pub fn line(ui: &mut Ui, label: &str, hint: &str, field: impl FnOnce(&mut Ui) -> Response) -> bool {
    let text = ui.label(RichText::new(label).color(theme::WEAK)).on_hover_text(hint);
    let response = ui.horizontal(|ui| field(ui).labelled_by(text.id)).inner;
    ui.end_row();
    response.changed()
}

/// A line that only shows.
pub fn fact(ui: &mut Ui, label: &str, hint: &str, value: impl Into<RichText>) {
    ui.label(RichText::new(label).color(theme::WEAK)).on_hover_text(hint);
    ui.label(value.into());
    ui.end_row();
}

/// A number between two ends.
pub fn slider(ui: &mut Ui, label: &str, hint: &str, value: &mut f32, range: RangeInclusive<f32>) -> bool {
    line(ui, label, hint, |ui| {
        ui.spacing_mut().slider_width = 92.0;
        ui.add(Slider::new(value, range).max_decimals(3))
    })
}

/// A number without an upper end.
pub fn number(
    ui: &mut Ui,
    label: &str,
    hint: &str,
    value: &mut f32,
    range: RangeInclusive<f32>,
    suffix: &str,
) -> bool {
    line(ui, label, hint, |ui| {
        let speed = (f64::from(value.abs()) * STRENGTH_SPEED).max(1e-3);
        ui.add(DragValue::new(value).range(range).speed(speed).max_decimals(4).suffix(suffix.to_owned()))
    })
}

/// A tick.
pub fn tick(ui: &mut Ui, label: &str, hint: &str, value: &mut bool) -> bool {
    line(ui, label, hint, |ui| ui.checkbox(value, ""))
}

/// A colour whose channels lie between 0 and 1.
pub fn colour(ui: &mut Ui, label: &str, hint: &str, value: &mut [f32; 3]) -> bool {
    line(ui, label, hint, |ui| {
        let button = ui.color_edit_button_rgb(value);
        let [r, g, b] = *value;
        ui.label(RichText::new(format!("{r:.3}  {g:.3}  {b:.3}")).small().color(theme::WEAK));
        button
    })
}

/// Light of any strength: a colour, and the strength of its strongest channel.
pub fn light(ui: &mut Ui, label: &str, hint: &str, value: &mut [f32; 3], unit: &str) -> bool {
    let strength = value.iter().copied().fold(0.0, f32::max);
    // At strength 0 the colour would be lost, so the last one is remembered.
    let memory = ui.scope_id().with((label, "colour"));
    let mut hue = match strength {
        s if s > 0.0 => value.map(|channel| channel / s),
        _ => ui.data(|data| data.get_temp(memory)).unwrap_or([1.0; 3]),
    };
    let mut wanted = strength;
    let mut changed = line(ui, label, hint, |ui| {
        let speed = (f64::from(strength) * STRENGTH_SPEED).max(1e-3);
        // The largest the protocol can say is an f32; 1e12 leaves room for anything that shines.
        ui.add(
            DragValue::new(&mut wanted)
                .range(0.0..=1e12)
                .speed(speed)
                .max_decimals(4)
                .suffix(format!(" {unit}")),
        )
    });
    changed |= line(ui, "  colour", hint, |ui| ui.color_edit_button_rgb(&mut hue));
    if changed {
        let strongest = hue.iter().copied().fold(0.0, f32::max);
        if strongest > 0.0 {
            hue = hue.map(|channel| channel / strongest);
            ui.data_mut(|data| data.insert_temp(memory, hue));
        }
        *value = hue.map(|channel| channel * wanted);
    }
    changed
}

/// Three numbers.
pub fn vector(ui: &mut Ui, label: &str, hint: &str, value: &mut [f64; 3], speed: f64) -> bool {
    ui.label(RichText::new(label).color(theme::WEAK)).on_hover_text(hint);
    let changed = ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        ui.spacing_mut().interact_size.x = AXIS_WIDTH;
        let mut changed = false;
        for (number, axis) in value.iter_mut().zip(["x", "y", "z"]) {
            let field = ui.add(DragValue::new(number).speed(speed).max_decimals(3));
            field.widget_info(|| {
                egui::WidgetInfo::labeled(egui::Role::SpinButton, true, format!("{label} {axis}"))
            });
            changed |= field.changed();
        }
        changed
    });
    ui.end_row();
    changed.inner
}
