//! A node's transform: translation, rotation as three angles, scale.

use crate::panels::form::{form, vector};
use crate::theme;
use egui::{RichText, Ui};
use glam::{DMat4, DQuat, EulerRot};
use lumicast_protocol::Transform;

/// A matrix of the scene equals its parts when no element differs by more than this share of the largest.
const SHEAR_TOLERANCE: f64 = 1e-6;
/// Two quaternions nearer than this are one rotation; the angles shown are kept.
const SAME_ROTATION: f64 = 1e-9;

/// The editor; whether something changed.
pub(super) fn show(ui: &mut Ui, transform: &mut Transform) -> bool {
    let Some((mut translation, rotation, mut scale)) = parts(transform) else {
        ui.label(
            RichText::new("This node's matrix is sheared: only its position can be edited here.")
                .color(theme::WEAK),
        );
        return sheared(ui, transform);
    };
    let mut degrees = remembered_degrees(ui, rotation);
    let mut changed = false;
    let mut turned = false;
    form(ui, "transform", |ui| {
        // A centimetre, half a degree, a percent for each pixel.
        changed |= vector(ui, "Translation", "Metres, in the parent's space", &mut translation, 0.01);
        turned = vector(ui, "Rotation", "Degrees about x, y, z; y first, then x, then z", &mut degrees, 0.5);
        changed |= vector(ui, "Scale", "Factor along each axis", &mut scale, 0.01);
    });
    let rotation = if turned { rotation_of(degrees) } else { rotation };
    ui.data_mut(|data| data.insert_temp(memory(ui), (rotation.to_array(), degrees)));
    if changed || turned {
        // A scale of nothing is singular; the server would refuse it while the field passes zero.
        let scale = scale.map(|s| if s.abs() < 1e-4 { 1e-4 } else { s });
        *transform = Transform::Parts { translation, rotation: rotation.to_array(), scale };
    }
    changed || turned
}

fn sheared(ui: &mut Ui, transform: &mut Transform) -> bool {
    let mut matrix = transform.matrix();
    let mut translation = [matrix[12], matrix[13], matrix[14]];
    let mut changed = false;
    form(ui, "transform", |ui| {
        changed = vector(ui, "Translation", "Metres, in the parent's space", &mut translation, 0.01);
    });
    if changed {
        matrix[12..15].copy_from_slice(&translation);
        *transform = Transform::Matrix(matrix);
    }
    changed
}

type Parts = ([f64; 3], DQuat, [f64; 3]);

/// Translation, rotation, scale; `None` where a matrix is more than that.
fn parts(transform: &Transform) -> Option<Parts> {
    if let Transform::Parts { translation, rotation, scale } = *transform {
        return Some((translation, DQuat::from_array(rotation), scale));
    }
    let matrix = DMat4::from_cols_array(&transform.matrix());
    let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
    let again = DMat4::from_scale_rotation_translation(scale, rotation, translation);
    let largest = matrix.to_cols_array().iter().fold(0.0f64, |largest, e| largest.max(e.abs()));
    let same = again.abs_diff_eq(matrix, largest * SHEAR_TOLERANCE);
    same.then(|| (translation.to_array(), rotation, scale.to_array()))
}

/// The angles last typed, as long as they still mean this rotation: three angles of one rotation are many, and they
/// would jump under the hand.
fn remembered_degrees(ui: &Ui, rotation: DQuat) -> [f64; 3] {
    let remembered: Option<([f64; 4], [f64; 3])> = ui.data(|data| data.get_temp(memory(ui)));
    match remembered {
        Some((of, degrees)) if DQuat::from_array(of).dot(rotation).abs() > 1.0 - SAME_ROTATION => degrees,
        _ => degrees_of(rotation),
    }
}

fn memory(ui: &Ui) -> egui::Id {
    ui.scope_id().with("angles")
}

fn degrees_of(rotation: DQuat) -> [f64; 3] {
    let (y, x, z) = rotation.to_euler(EulerRot::YXZ);
    [x, y, z].map(|angle| {
        let degrees = angle.to_degrees();
        // Rounding leaves 1e-14 where 0 is meant, which reads as −0.
        if degrees.abs() < 1e-9 { 0.0 } else { degrees }
    })
}

fn rotation_of([x, y, z]: [f64; 3]) -> DQuat {
    let [x, y, z] = [x, y, z].map(f64::to_radians);
    DQuat::from_euler(EulerRot::YXZ, y, x, z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn angles_and_rotation_are_two_spellings_of_one_thing() {
        for degrees in [[0.0, 0.0, 0.0], [30.0, -45.0, 120.0], [-80.0, 170.0, 5.0]] {
            let again = degrees_of(rotation_of(degrees));
            for (a, b) in degrees.iter().zip(again) {
                assert!((a - b).abs() < 1e-9, "{degrees:?} {again:?}");
            }
        }
    }

    #[test]
    fn a_plain_matrix_has_parts_and_a_sheared_one_has_none() {
        let plain = DMat4::from_scale_rotation_translation(
            DVec3::new(2.0, 3.0, 4.0),
            rotation_of([10.0, 20.0, 30.0]),
            DVec3::new(1e5, 0.0, -1.0),
        );
        let (translation, rotation, scale) = parts(&Transform::Matrix(plain.to_cols_array())).unwrap();
        assert_eq!(translation, [1e5, 0.0, -1.0]);
        assert!(rotation.dot(rotation_of([10.0, 20.0, 30.0])).abs() > 1.0 - 1e-12);
        assert!((DVec3::from(scale) - DVec3::new(2.0, 3.0, 4.0)).length() < 1e-9);
        let mut sheared = DMat4::IDENTITY.to_cols_array();
        sheared[4] = 0.5;
        assert!(parts(&Transform::Matrix(sheared)).is_none());
    }
}
