//! A direction that light comes from, drawn of the lights around a surface in one go over them.

use glam::Vec3;

use crate::math::Frame;

/// Share of the photons' spread around a light that directions drawn of it have. All of it, normally distributed, reaches below
/// the horizon and into other lights' directions: of 0 to 1, this leaves the least error.
pub(super) const SPREAD_DRAWN: f32 = 0.42;

/// One light of those around a surface, drawn by what it sends on.
pub(super) struct DrawnLight {
    /// Uniform still, whatever was drawn.
    choice: f32,
    turn: [f32; 2],
    sum: f32,
    /// Its group; `None`: no light yet.
    pub(super) place: Option<usize>,
    direction: Vec3,
}

impl DrawnLight {
    pub(super) fn new([choice, u, v]: [f32; 3]) -> DrawnLight {
        DrawnLight { choice, turn: [u, v], sum: 0.0, place: None, direction: Vec3::ZERO }
    }

    /// - `weight`: what it sends on, in any unit
    /// - `place`: its group
    #[inline]
    pub(super) fn offer(&mut self, weight: f32, place: usize, direction: Vec3) {
        if !(weight > 0.0) {
            return;
        }
        self.sum += weight;
        let share = weight / self.sum;
        if self.choice < share {
            self.choice /= share;
            (self.place, self.direction) = (Some(place), direction);
        } else {
            self.choice = (self.choice - share) / (1.0 - share);
        }
    }

    /// A direction around the light's, normally distributed to either side, above the horizon.
    ///
    /// - `chord_rms`: how far the light's photons come from around it: root mean square of unit vectors
    pub(super) fn direction(&self, chord_rms: f32, n_facing: Vec3) -> Vec3 {
        let [u, v] = self.turn;
        let radius = SPREAD_DRAWN * chord_rms * (-(1.0 - u).ln()).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
        let frame = Frame::around(self.direction);
        let direction = frame.to_world(Vec3::new(radius * cos, radius * sin, 1.0)).normalize();
        let below = direction.dot(n_facing).min(0.0);
        direction - 2.0 * below * n_facing
    }
}
