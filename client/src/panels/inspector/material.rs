//! All properties of a material.

use crate::panels::form::{colour, form, light, number, slider, tick};
use crate::theme;
use egui::{RichText, Ui};
use lumicast_protocol::MaterialProperties;

/// What a first tick sets: a decimetre of coloured glass, holes at half cover.
const ATTENUATION_FIRST_M: f32 = 0.1;
const CUTOFF_FIRST: f32 = 0.5;

/// The editor; whether something changed.
pub(super) fn show(ui: &mut Ui, material: &mut MaterialProperties, textures: Vec<&'static str>) -> bool {
    let before = *material;
    form(ui, "surface", |ui| surface(ui, material));
    section(ui, "Inside");
    form(ui, "inside", |ui| inside(ui, material));
    section(ui, "Emission");
    form(ui, "emission", |ui| {
        light(
            ui,
            "Radiance",
            "Emitted; from the front, or both sides if double-sided",
            &mut material.emission,
            "W/(m² sr)",
        );
    });
    section(ui, "Faces");
    form(ui, "faces", |ui| faces(ui, material));
    if !textures.is_empty() {
        let text = format!("Textures multiply: {}", textures.join(", "));
        ui.label(RichText::new(text).small().color(theme::WEAK));
    }
    *material != before
}

fn section(ui: &mut Ui, title: &str) {
    ui.add_space(4.0);
    ui.label(RichText::new(title).small().color(theme::WEAK));
}

fn surface(ui: &mut Ui, material: &mut MaterialProperties) {
    colour(ui, "Base colour", "Albedo, or reflectance of a metal", &mut material.base_color);
    slider(ui, "Metallic", "0 dielectric, 1 metal", &mut material.metallic, 0.0..=1.0);
    slider(ui, "Roughness", "0 smooth, 1 rough; GGX α = roughness²", &mut material.roughness, 0.0..=1.0);
    slider(ui, "Specular", "Strength of the dielectric's reflection", &mut material.specular, 0.0..=1.0);
    colour(ui, "Specular tint", "Its colour", &mut material.specular_color);
    slider(
        ui,
        "IOR",
        "Index of refraction: water 1.33, glass 1.5, diamond 2.42",
        &mut material.ior,
        1.0..=3.0,
    );
}

fn inside(ui: &mut Ui, material: &mut MaterialProperties) {
    slider(ui, "Transmission", "Share of light that is refracted", &mut material.transmission, 0.0..=1.0);
    let mut absorbs = material.attenuation_distance_m.is_some();
    if tick(ui, "Absorbs", "Light loses colour inside", &mut absorbs) {
        material.attenuation_distance_m = absorbs.then_some(ATTENUATION_FIRST_M);
    }
    if let Some(distance_m) = &mut material.attenuation_distance_m {
        number(
            ui,
            "After",
            "The depth at which white has become the colour below",
            distance_m,
            1e-4..=1e6,
            " m",
        );
        colour(ui, "Remaining", "What is left of white light there", &mut material.attenuation_color);
    }
}

fn faces(ui: &mut Ui, material: &mut MaterialProperties) {
    tick(ui, "Double-sided", "Shades and emits on both sides", &mut material.double_sided);
    tick(ui, "Unlit", "Shows its base colour, takes part in no light", &mut material.unlit);
    let mut holes = material.alpha_cutoff.is_some();
    if tick(ui, "Holes", "Where the texture's alpha is low", &mut holes) {
        material.alpha_cutoff = holes.then_some(CUTOFF_FIRST);
    }
    if let Some(cutoff) = &mut material.alpha_cutoff {
        slider(ui, "Cut-off", "Alpha below it is a hole", cutoff, 0.0..=1.0);
    }
    slider(ui, "Normal map", "Factor on its slope", &mut material.normal_scale, 0.0..=2.0);
}
