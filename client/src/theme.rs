//! How it looks: dark and neutral, so that the picture is the only thing with colour; amber for what is chosen.

use egui::{
    Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Theme, Vec2, style::WidgetVisuals,
};

/// Behind the picture. Neutral grey: a tint here would shift how the picture is judged.
pub const BACKDROP: Color32 = Color32::from_rgb(17, 17, 18);
/// Panels.
pub const PANEL: Color32 = Color32::from_rgb(28, 29, 31);
/// Fields that hold text or a plot.
pub const SUNKEN: Color32 = Color32::from_rgb(20, 21, 22);
/// Text.
pub const TEXT: Color32 = Color32::from_rgb(214, 214, 212);
/// Labels and what matters less.
pub const WEAK: Color32 = Color32::from_rgb(148, 149, 150);
/// Chosen, in progress, the newest curve.
pub const ACCENT: Color32 = Color32::from_rgb(240, 180, 95);
/// Went wrong.
pub const ERROR: Color32 = Color32::from_rgb(236, 115, 104);
/// Goes well.
pub const GOOD: Color32 = Color32::from_rgb(122, 190, 140);
/// Good to know.
pub const INFO: Color32 = Color32::from_rgb(122, 172, 220);
/// Frames around things.
pub const EDGE: Color32 = Color32::from_rgb(52, 54, 57);

/// Gives a context this look.
pub fn apply(ctx: &egui::Context) {
    ctx.set_theme(Theme::Dark);
    ctx.style_mut_of(Theme::Dark, |style| {
        style.text_styles = [
            (TextStyle::Heading, FontId::new(17.0, FontFamily::Proportional)),
            (TextStyle::Body, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Button, FontId::new(13.0, FontFamily::Proportional)),
            (TextStyle::Small, FontId::new(11.0, FontFamily::Proportional)),
            (TextStyle::Monospace, FontId::new(12.0, FontFamily::Monospace)),
        ]
        .into();
        let spacing = &mut style.spacing;
        spacing.item_spacing = Vec2::new(6.0, 5.0);
        spacing.button_padding = Vec2::new(7.0, 3.0);
        spacing.interact_size = Vec2::new(36.0, 20.0);
        spacing.window_margin = Margin::same(14);
        spacing.scroll.floating = true;
        visuals(&mut style.visuals);
    });
}

fn visuals(visuals: &mut egui::Visuals) {
    visuals.panel_fill = PANEL;
    visuals.window_fill = PANEL;
    visuals.window_stroke = Stroke::new(1.0, EDGE);
    visuals.window_corner_radius = CornerRadius::same(8);
    visuals.menu_corner_radius = CornerRadius::same(6);
    visuals.extreme_bg_color = SUNKEN;
    visuals.faint_bg_color = Color32::from_rgb(33, 34, 36);
    visuals.hyperlink_color = ACCENT;
    visuals.warn_fg_color = ACCENT;
    visuals.error_fg_color = ERROR;
    visuals.selection.bg_fill = Color32::from_rgb(92, 70, 38);
    visuals.selection.stroke = Stroke::new(1.0, ACCENT);
    visuals.slider_trailing_fill = true;
    visuals.weak_text_color = Some(WEAK);
    let widgets = &mut visuals.widgets;
    set(&mut widgets.noninteractive, [PANEL, EDGE, TEXT]);
    set(&mut widgets.inactive, [Color32::from_rgb(46, 48, 51), Color32::TRANSPARENT, TEXT]);
    set(&mut widgets.hovered, [Color32::from_rgb(58, 60, 64), Color32::from_rgb(84, 86, 90), Color32::WHITE]);
    set(&mut widgets.active, [Color32::from_rgb(72, 74, 78), ACCENT, Color32::WHITE]);
    set(&mut widgets.open, [Color32::from_rgb(46, 48, 51), EDGE, TEXT]);
}

fn set(widget: &mut WidgetVisuals, [fill, edge, text]: [Color32; 3]) {
    (widget.bg_fill, widget.weak_bg_fill) = (fill, fill);
    widget.bg_stroke = Stroke::new(1.0, edge);
    widget.fg_stroke = Stroke::new(1.0, text);
    widget.corner_radius = CornerRadius::same(4);
    // Widgets that grow under the pointer move their neighbours' edges out of line.
    widget.expansion = 0.0;
}
