//! A light without area: strength, place, direction, cone.

use crate::panels::form;
use crate::panels::form::{form, light, line, vector};
use egui::{DragValue, Ui};
use lumicast_protocol::LightSource;

/// The editor; whether something changed.
pub(super) fn show(ui: &mut Ui, source: &mut LightSource) -> bool {
    let before = *source;
    form(ui, "light", |ui| match source {
        LightSource::Point { intensity, position } => {
            form::fact(ui, "Kind", "A light keeps its kind", "point");
            light(ui, "Intensity", "In every direction", intensity, "W/sr");
            vector(ui, "Position", "Metres, in the parent's space", position, 0.01);
        }
        LightSource::Spot { intensity, position, direction, inner_angle_rad, outer_angle_rad } => {
            form::fact(ui, "Kind", "A light keeps its kind", "spot");
            light(ui, "Intensity", "Along the axis", intensity, "W/sr");
            vector(ui, "Position", "Metres, in the parent's space", position, 0.01);
            direction_lines(ui, direction);
            cone(ui, inner_angle_rad, outer_angle_rad);
        }
        LightSource::Directional { irradiance, direction } => {
            form::fact(ui, "Kind", "A light keeps its kind", "directional");
            light(ui, "Irradiance", "On a surface that faces it", irradiance, "W/m²");
            direction_lines(ui, direction);
        }
    });
    *source != before
}

/// From the axis: full light inside the first angle, none outside the second.
fn cone(ui: &mut Ui, inner_angle_rad: &mut f32, outer_angle_rad: &mut f32) {
    // Inner stays below outer by a tenth of a degree: the protocol wants inner < outer.
    const GAP: f32 = 0.1;
    let (mut inner, mut outer) = (inner_angle_rad.to_degrees(), outer_angle_rad.to_degrees());
    let inner_changed = line(ui, "Inner angle", "Full light inside, from the axis", |ui| {
        ui.add(DragValue::new(&mut inner).range(0.0..=90.0 - GAP).speed(0.25).max_decimals(2).suffix("°"))
    });
    let outer_changed = line(ui, "Outer angle", "No light outside, from the axis", |ui| {
        ui.add(DragValue::new(&mut outer).range(GAP..=90.0).speed(0.25).max_decimals(2).suffix("°"))
    });
    if inner_changed {
        outer = outer.max(inner + GAP);
    }
    if outer_changed {
        inner = inner.min(outer - GAP);
    }
    if inner_changed || outer_changed {
        *inner_angle_rad = inner.max(0.0).to_radians();
        // 90° in f32 lies a hair above π/2.
        *outer_angle_rad = outer.to_radians().min(std::f32::consts::FRAC_PI_2);
    }
}

/// The way the light travels as two angles, which is how one aims.
fn direction_lines(ui: &mut Ui, direction: &mut [f64; 3]) {
    let memory = ui.scope_id().with("aim");
    let now = aim_of(*direction);
    // Straight down has no heading; the last one is kept so that it does not jump.
    let remembered: Option<[f64; 2]> = ui.data(|data| data.get_temp(memory));
    let mut aim = remembered.filter(|aim| same_direction(direction_of(*aim), *direction)).unwrap_or(now);
    let mut changed = line(ui, "Heading", "About +Y: 0° travels towards −Z, 90° towards −X", |ui| {
        ui.add(DragValue::new(&mut aim[0]).speed(0.5).max_decimals(1).suffix("°"))
    });
    changed |= line(ui, "Elevation", "−90° shines straight down", |ui| {
        ui.add(DragValue::new(&mut aim[1]).range(-90.0..=90.0).speed(0.5).max_decimals(1).suffix("°"))
    });
    if changed {
        *direction = direction_of(aim);
        ui.data_mut(|data| data.insert_temp(memory, aim));
    }
}

/// Heading and elevation in degrees.
fn aim_of([x, y, z]: [f64; 3]) -> [f64; 2] {
    let length = (x * x + y * y + z * z).sqrt().max(f64::MIN_POSITIVE);
    let degrees = [(-x).atan2(-z), (y / length).clamp(-1.0, 1.0).asin()].map(f64::to_degrees);
    // Rounding leaves a hair below zero where zero is meant, which reads as −0.
    degrees.map(|angle| if angle.abs() < 1e-9 { 0.0 } else { angle })
}

fn direction_of([heading, elevation]: [f64; 2]) -> [f64; 3] {
    let (heading, elevation) = (heading.to_radians(), elevation.to_radians());
    [-heading.sin() * elevation.cos(), elevation.sin(), -heading.cos() * elevation.cos()]
}

fn same_direction(a: [f64; 3], b: [f64; 3]) -> bool {
    let length = b.iter().map(|e| e * e).sum::<f64>().sqrt();
    a.iter().zip(b).all(|(a, b)| (a * length - b).abs() <= 1e-9 * length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aim_and_direction_are_two_spellings_of_one_thing() {
        for direction in
            [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.3, -1.0, 0.2], [0.0, -2.0, 0.0], [1e3, 1.0, 5.0]]
        {
            assert!(same_direction(direction_of(aim_of(direction)), direction), "{direction:?}");
        }
        assert_eq!(aim_of([-1.0, 0.0, 0.0])[0], 90.0);
    }
}
