//! The scene as a tree: cameras, lights, nodes, materials, meshes; search; making lights and cameras.

use crate::model::edits::Edits;
use crate::model::tree::{Branch, Folding, Row, rows};
use crate::model::{Model, Scene, Selected};
use crate::theme;
use egui::{
    Align2, Color32, FontId, Painter, Pos2, Rect, Role, ScrollArea, Sense, Stroke, TextEdit, Ui, Vec2,
    WidgetInfo, pos2,
};
use lumicast_protocol::{
    AddLight, Edit, Id, LightKind, LightSource, Placement, RemoveCamera, RemoveLight, SceneDescription,
    SetCamera, Transform,
};

const ROW_HEIGHT: f32 = 20.0;
const INDENT: f32 = 14.0;
/// A new light: about a 100 W bulb's worth of W/sr in a room of a few metres.
const NEW_INTENSITY: [f32; 3] = [10.0; 3];

/// The panel's state.
#[derive(Default)]
pub struct TreePanel {
    folding: Folding,
    search: String,
    /// The lines, and what they were made from.
    rows: Vec<Row>,
    made_from: Option<(u64, Folding, String)>,
    /// What was selected in the frame before: a selection made elsewhere is scrolled to.
    selected: Option<Selected>,
    rows_in_sight: std::ops::Range<usize>,
}

impl TreePanel {
    /// The whole panel.
    pub fn show(&mut self, ui: &mut Ui, model: &mut Model) {
        let Some(scene) = model.scene.clone() else {
            ui.label(egui::RichText::new("No scene yet.").color(theme::WEAK));
            return;
        };
        ui.horizontal(|ui| {
            let search = TextEdit::singleline(&mut self.search).hint_text("Search");
            ui.add_sized([ui.available_width() - 52.0, 20.0], search);
            ui.menu_button("Add", |ui| add_menu(ui, model, &scene.description));
        });
        ui.add_space(2.0);
        self.refresh(&scene);
        let mut toggled = None;
        ui.spacing_mut().item_spacing.y = 0.0;
        let mut area = ScrollArea::vertical().auto_shrink([false, false]);
        if self.selected != model.selected {
            let chosen =
                self.rows.iter().position(|row| row.selects.is_some() && row.selects == model.selected);
            let height = ui.available_height();
            if let Some(index) = chosen.filter(|index| !self.rows_in_sight.contains(index)) {
                area = area.vertical_scroll_offset((index as f32 * ROW_HEIGHT - height * 0.5).max(0.0));
            }
            self.selected.clone_from(&model.selected);
        }
        let mut in_sight = 0..0;
        area.show_rows(ui, ROW_HEIGHT, self.rows.len(), |ui, range| {
            in_sight = range.clone();
            for row in self.rows.get(range).unwrap_or_default() {
                if let Some(branch) = draw_row(ui, row, model, &scene.description) {
                    toggled = Some(branch);
                }
            }
        });
        self.rows_in_sight = in_sight;
        if let Some(branch) = toggled {
            self.folding.toggle(branch);
        }
    }

    fn refresh(&mut self, scene: &Scene) {
        let made_from = (scene.version, &self.folding, &self.search);
        let same = self
            .made_from
            .as_ref()
            .is_some_and(|(version, folding, search)| (*version, folding, search) == made_from);
        if !same {
            self.rows = rows(&scene.description, &self.folding, &self.search);
            self.made_from = Some((scene.version, self.folding.clone(), self.search.clone()));
        }
    }
}

/// One line. Returns the branch whose arrow was clicked.
fn draw_row(ui: &mut Ui, row: &Row, model: &mut Model, scene: &SceneDescription) -> Option<Branch> {
    let (rect, response) =
        ui.allocate_exact_size(Vec2::new(ui.available_width(), ROW_HEIGHT), Sense::click());
    let selected = row.selects.is_some() && row.selects == model.selected;
    response.widget_info(|| WidgetInfo::selected(Role::TreeItem, true, selected, &row.label));
    let painter = ui.painter();
    if selected {
        painter.rect_filled(rect, 3.0, ui.visuals().selection.bg_fill);
    } else if response.hovered() {
        painter.rect_filled(rect, 3.0, ui.visuals().faint_bg_color);
    }
    let mut x = rect.left() + 4.0 + row.depth as f32 * INDENT;
    let arrow = Rect::from_center_size(pos2(x, rect.center().y), Vec2::splat(ROW_HEIGHT));
    if let Some((_, open)) = &row.branch {
        draw_arrow(painter, arrow.center(), *open);
    }
    x += 11.0;
    if let Some(thing) = &row.selects {
        draw_icon(painter, pos2(x + 5.0, rect.center().y), thing, scene, &model.edits);
        x += 17.0;
    }
    let colour = if row.selects.is_none() { theme::WEAK } else { theme::TEXT };
    let clipped = painter.with_clip_rect(rect.intersect(painter.clip_rect()));
    clipped.text(
        pos2(x, rect.center().y),
        Align2::LEFT_CENTER,
        &row.label,
        FontId::proportional(13.0),
        colour,
    );
    if !response.clicked() {
        return None;
    }
    let on_arrow = response.interact_pointer_pos().is_some_and(|pointer| arrow.contains(pointer));
    if let (Some((branch, _)), true) = (&row.branch, on_arrow || row.selects.is_none()) {
        return Some(branch.clone());
    }
    if let Some(Selected::Camera(id)) = &row.selects {
        model.go_to_camera(id);
    }
    model.selected = row.selects.clone();
    None
}

fn draw_arrow(painter: &Painter, at: Pos2, open: bool) {
    let corners =
        if open { [(-3.5, -2.0), (3.5, -2.0), (0.0, 3.0)] } else { [(-2.0, -3.5), (-2.0, 3.5), (3.0, 0.0)] };
    let corners = corners.map(|(x, y)| at + Vec2::new(x, y)).to_vec();
    painter.add(egui::Shape::convex_polygon(corners, theme::WEAK, Stroke::NONE));
}

/// A small drawn sign for each kind of thing: no font has them all.
fn draw_icon(painter: &Painter, at: Pos2, thing: &Selected, scene: &SceneDescription, edits: &Edits) {
    let line = Stroke::new(1.2, theme::WEAK);
    let square = |half: f32| Rect::from_center_size(at, Vec2::splat(2.0 * half));
    match thing {
        Selected::Camera(_) => {
            painter.rect_stroke(
                Rect::from_center_size(at - Vec2::new(1.5, 0.0), Vec2::new(7.0, 6.0)),
                1.0,
                Stroke::new(1.2, theme::INFO),
                egui::StrokeKind::Middle,
            );
            painter.line_segment(
                [at + Vec2::new(2.5, 0.0), at + Vec2::new(5.5, -3.0)],
                Stroke::new(1.2, theme::INFO),
            );
            painter.line_segment(
                [at + Vec2::new(2.5, 0.0), at + Vec2::new(5.5, 3.0)],
                Stroke::new(1.2, theme::INFO),
            );
        }
        Selected::Light(_) => draw_sun(painter, at, 3.0, theme::ACCENT),
        Selected::Environment => drop(painter.circle_stroke(at, 4.5, Stroke::new(1.2, theme::ACCENT))),
        Selected::Node(id) => {
            let carries = scene
                .nodes
                .iter()
                .take(10_000)
                .find(|node| node.id == *id)
                .is_some_and(|node| node.mesh.is_some());
            if carries {
                painter.rect_filled(square(3.5), 1.0, theme::WEAK);
            } else {
                painter.rect_stroke(square(3.5), 1.0, line, egui::StrokeKind::Middle);
            }
        }
        Selected::Material(id) => drop(painter.circle(at, 4.5, material_colour(id, scene, edits), line)),
        Selected::Mesh(_) => {
            let corners = [(-4.0, 3.5), (4.0, 3.5), (0.0, -4.0)].map(|(x, y)| at + Vec2::new(x, y));
            painter.add(egui::Shape::closed_line(corners.to_vec(), line));
        }
    }
}

/// A disc with rays.
pub fn draw_sun(painter: &Painter, at: Pos2, radius: f32, colour: Color32) {
    painter.circle_filled(at, radius * 0.8, colour);
    for eighth in 0..8 {
        let direction = Vec2::angled(eighth as f32 * std::f32::consts::FRAC_PI_4);
        painter.line_segment(
            [at + direction * radius * 1.25, at + direction * radius * 1.8],
            Stroke::new(1.0, colour),
        );
    }
}

fn material_colour(id: &Id, scene: &SceneDescription, edits: &Edits) -> Color32 {
    use crate::model::edits::{Target, Value};
    match edits.value(scene, &Target::Material(id.clone())) {
        Some(Value::Material(material)) => {
            let emits = material.emission.iter().any(|channel| *channel > 0.0);
            let [r, g, b] = if emits { normalized(material.emission) } else { material.base_color };
            egui::Rgba::from_rgb(r, g, b).into()
        }
        _ => theme::WEAK,
    }
}

fn normalized(colour: [f32; 3]) -> [f32; 3] {
    let strongest = colour.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    colour.map(|channel| channel / strongest)
}

fn add_menu(ui: &mut Ui, model: &mut Model, scene: &SceneDescription) {
    for (label, kind) in [
        ("Point light", LightKind::Point),
        ("Spot light", LightKind::Spot),
        ("Directional light", LightKind::Directional),
    ] {
        if ui.button(label).on_hover_text("Between the eye and what it looks at").clicked() {
            add_light(model, scene, kind);
            ui.close();
        }
    }
    if ui.button("Camera from this view").clicked() {
        add_camera(model, scene);
        ui.close();
    }
}

fn add_light(model: &mut Model, scene: &SceneDescription, kind: LightKind) {
    let Some(camera) = model.viewpoint().map(|viewpoint| viewpoint.camera) else { return };
    let Some(id) = free_id(kind.name(), |id| scene.lights.iter().any(|light| light.id == *id)) else {
        return;
    };
    let position = camera.position.lerp(camera.focus(), 0.5).to_array();
    let direction = camera.forward().to_array();
    let source = match kind {
        LightKind::Point => LightSource::Point { intensity: NEW_INTENSITY, position },
        LightKind::Spot => LightSource::Spot {
            intensity: NEW_INTENSITY,
            position,
            direction,
            inner_angle_rad: 0.3,
            outer_angle_rad: 0.5,
        },
        LightKind::Directional => LightSource::Directional { irradiance: [1.0; 3], direction },
    };
    let forth = Edit::AddLight(AddLight { light: id.clone(), parent: None, source });
    model.edits.command(forth, Some(Edit::RemoveLight(RemoveLight { light: id.clone() })));
    model.select_when_there(Selected::Light(id));
}

fn add_camera(model: &mut Model, scene: &SceneDescription) {
    let Some(camera) = model.viewpoint().map(|viewpoint| viewpoint.camera) else { return };
    let Some(id) = free_id("view", |id| scene.cameras.iter().any(|camera| camera.id == *id)) else { return };
    let forth = Edit::SetCamera(SetCamera {
        camera: id.clone(),
        parent: None,
        placement: Placement::Transform(Transform::Parts {
            translation: camera.position.to_array(),
            rotation: camera.orientation.to_array(),
            scale: [1.0; 3],
        }),
        projection: camera.projection,
        aspect: None,
    });
    model.edits.command(forth, Some(Edit::RemoveCamera(RemoveCamera { camera: id.clone() })));
    model.select_when_there(Selected::Camera(id));
}

/// `name-1`, `name-2` … whichever is free.
fn free_id(name: &str, is_taken: impl Fn(&Id) -> bool) -> Option<Id> {
    // The protocol allows 100,000 of a kind.
    (1..=100_001).filter_map(|number| Id::new(format!("{name}-{number}")).ok()).find(|id| !is_taken(id))
}
