//! Editing what is selected. Every change goes to the model as a draft; the server's answer stands below.

mod light;
mod material;
mod transform;

use super::form::{fact, form, light as light_field, line};
use super::numbers;
use crate::model::edits::{Edits, Target, Value};
use crate::model::{Model, Selected, tree};
use crate::theme;
use egui::{ComboBox, RichText, ScrollArea, Ui};
use lumicast_protocol::{
    AddLight, Edit, EnvironmentDescription, Id, Projection, RemoveCamera, RemoveLight, SceneDescription,
};

/// The whole panel.
pub fn show(ui: &mut Ui, model: &mut Model, now_s: f64) {
    let (Some(scene), Some(selected)) = (model.scene.clone(), model.selected.clone()) else {
        ui.label(RichText::new("Select something above to edit it.").color(theme::WEAK));
        return;
    };
    let scene = scene.description;
    heading(ui, model, &scene, &selected);
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        match &selected {
            Selected::Mesh(id) => mesh(ui, model, &scene, id),
            Selected::Camera(id) => camera(ui, &scene, id),
            Selected::Node(id) => node(ui, model, &scene, id),
            Selected::Material(_) | Selected::Light(_) | Selected::Environment => {}
        }
        if let Some(target) = selected.target() {
            editor(ui, model, &scene, &target, now_s);
        }
    });
}

fn heading(ui: &mut Ui, model: &mut Model, scene: &SceneDescription, selected: &Selected) {
    let kind = match selected {
        Selected::Node(_) => "node",
        Selected::Mesh(_) => "mesh",
        Selected::Material(_) => "material",
        Selected::Light(_) => "light",
        Selected::Camera(_) => "camera",
        Selected::Environment => "scene",
    };
    ui.horizontal(|ui| {
        ui.label(RichText::new(tree::label(selected)).strong().size(14.0));
        ui.label(RichText::new(kind).color(theme::WEAK));
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| match selected {
            Selected::Light(id) if ui.button("Remove").clicked() => remove_light(&mut model.edits, scene, id),
            Selected::Camera(id) if ui.button("Remove").clicked() => {
                model.edits.command(Edit::RemoveCamera(RemoveCamera { camera: id.clone() }), None);
            }
            _ => {}
        });
    });
    ui.add_space(2.0);
}

fn remove_light(edits: &mut Edits, scene: &SceneDescription, id: &Id) {
    let Some(light) = scene.lights.iter().find(|light| light.id == *id) else { return };
    let back = AddLight { light: id.clone(), parent: light.parent.clone(), source: light.source };
    edits.command(Edit::RemoveLight(RemoveLight { light: id.clone() }), Some(Edit::AddLight(back)));
}

fn editor(ui: &mut Ui, model: &mut Model, scene: &SceneDescription, target: &Target, now_s: f64) {
    let Some(mut value) = model.edits.value(scene, target) else { return };
    let problem = model.edits.problem(target).cloned();
    let changed = ui.push_id(target, |ui| match &mut value {
        Value::Transform(transform) => transform::show(ui, transform),
        Value::Material(material) => material::show(ui, material, textures(scene, target)),
        Value::Light(source) => light::show(ui, source),
        Value::Environment(description) => environment(ui, description),
    });
    if changed.inner {
        model.edits.change(scene, target, value, now_s);
    }
    ui.add_space(4.0);
    if let Some(problem) = problem {
        let field = problem.field.as_deref().unwrap_or("value");
        ui.label(RichText::new(format!("Refused: {field}")).color(theme::ERROR));
        ui.label(RichText::new(&problem.detail).small().color(theme::ERROR));
    } else if model.edits.is_pending(target) {
        ui.label(RichText::new("sending …").small().color(theme::WEAK));
    } else if let Some(confirmed) = model.edits.confirmed() {
        let text = format!("last edit made revision {}", confirmed.revision);
        ui.label(RichText::new(text).small().color(theme::WEAK));
    }
}

fn textures(scene: &SceneDescription, target: &Target) -> Vec<&'static str> {
    use lumicast_protocol::TextureSlot;
    let Target::Material(id) = target else { return vec![] };
    let found = scene.materials.iter().find(|material| material.id == *id);
    let name = |slot: &TextureSlot| match slot {
        TextureSlot::BaseColor => "base colour",
        TextureSlot::MetallicRoughness => "metallic, roughness",
        TextureSlot::Normal => "normal",
        TextureSlot::Emission => "emission",
        TextureSlot::Specular => "specular",
        TextureSlot::SpecularColor => "specular colour",
        TextureSlot::Transmission => "transmission",
    };
    found.map(|material| material.textures.iter().map(name).collect()).unwrap_or_default()
}

fn environment(ui: &mut Ui, value: &mut EnvironmentDescription) -> bool {
    let before = *value;
    form(ui, "environment", |ui| {
        line(ui, "Kind", "What is seen where no surface is", |ui| {
            let name = match value {
                EnvironmentDescription::None => "Darkness",
                EnvironmentDescription::Constant { .. } => "Constant",
                EnvironmentDescription::Image { .. } => "Picture",
            };
            let combo = ComboBox::from_id_salt("kind").selected_text(name).show_ui(ui, |ui| {
                ui.selectable_value(value, EnvironmentDescription::None, "Darkness");
                let constant = matches!(value, EnvironmentDescription::Constant { .. });
                if ui.selectable_label(constant, "Constant").clicked() && !constant {
                    *value = EnvironmentDescription::Constant { radiance: mean_radiance(value) };
                }
            });
            combo.response
        });
        match value {
            EnvironmentDescription::None => {}
            EnvironmentDescription::Constant { radiance } => {
                light_field(ui, "Radiance", "The same from everywhere", radiance, "W/(m² sr)");
            }
            EnvironmentDescription::Image { width, height, mean_radiance, .. } => {
                fact(ui, "Picture", "Equirectangular", format!("{width} × {height}"));
                let [r, g, b] = mean_radiance;
                fact(ui, "Mean", "Over the sphere, W/(m² sr)", format!("{r:.3}  {g:.3}  {b:.3}"));
            }
        }
    });
    if matches!(before, EnvironmentDescription::Image { .. }) {
        let text = "Replacing the picture cannot be undone from here: the viewer does not have it.";
        ui.label(RichText::new(text).small().color(theme::WEAK));
    }
    *value != before
}

fn mean_radiance(environment: &EnvironmentDescription) -> [f32; 3] {
    match environment {
        EnvironmentDescription::None => [0.1; 3],
        EnvironmentDescription::Constant { radiance } => *radiance,
        EnvironmentDescription::Image { mean_radiance, .. } => *mean_radiance,
    }
}

fn node(ui: &mut Ui, model: &mut Model, scene: &SceneDescription, id: &Id) {
    let Some(node) = scene.nodes.iter().find(|node| node.id == *id) else { return };
    if let Some(mesh) = &node.mesh {
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new("Mesh").color(theme::WEAK));
            if ui.link(mesh.as_str()).clicked() {
                model.selected = Some(Selected::Mesh(mesh.clone()));
            }
        });
        materials_of(ui, model, scene, mesh);
    }
}

fn materials_of(ui: &mut Ui, model: &mut Model, scene: &SceneDescription, mesh: &Id) {
    let Some(mesh) = scene.meshes.iter().find(|other| other.id == *mesh) else { return };
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new("Materials").color(theme::WEAK));
        // A mesh of hundreds of materials is a list nobody reads; the tree has a search.
        for material in mesh.materials.iter().take(24) {
            if ui.link(material.as_str()).clicked() {
                model.selected = Some(Selected::Material(material.clone()));
            }
        }
    });
}

fn mesh(ui: &mut Ui, model: &mut Model, scene: &SceneDescription, id: &Id) {
    let Some(mesh) = scene.meshes.iter().find(|mesh| mesh.id == *id) else { return };
    form(ui, "mesh", |ui| {
        fact(
            ui,
            "Triangles",
            "Stored once, however many nodes carry it",
            numbers::count(mesh.triangles as f64),
        );
        fact(ui, "Vertices", "Stored once", numbers::count(mesh.vertices as f64));
    });
    materials_of(ui, model, scene, id);
}

fn camera(ui: &mut Ui, scene: &SceneDescription, id: &Id) {
    let Some(camera) = scene.cameras.iter().find(|camera| camera.id == *id) else { return };
    form(ui, "camera", |ui| {
        let projection = match camera.projection {
            Projection::Perspective { yfov_rad } => format!("{:.1}° high", yfov_rad.to_degrees()),
            Projection::Orthographic { half_height_m } => {
                format!("parallel, {:.2} m high", 2.0 * half_height_m)
            }
        };
        fact(ui, "Field of view", "Kept while you move", projection);
        let [.., x, y, z, _] = camera.world_from_camera;
        fact(ui, "Position", "In the world, metres", format!("{x:.2}  {y:.2}  {z:.2}"));
        fact(ui, "Moves with", "The node it hangs on", camera.parent.as_deref().unwrap_or("the world"));
    });
}
