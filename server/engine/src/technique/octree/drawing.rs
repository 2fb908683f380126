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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// Lights are drawn as often as they send on, in whatever order they come, and nothing is drawn of no light.
    #[test]
    fn lights_are_drawn_by_what_they_send_on() {
        let weights = [0.0, 3e-30, 5e-30, 0.0, 1e-30, f32::NAN, 7e-30];
        let mut counts = [0u32; 7];
        let count = 1 << 14;
        for index in 0..count {
            let [choice, u, v, _] = point(1, index);
            let mut drawn = DrawnLight::new([choice, u, v]);
            for (place, weight) in weights.into_iter().enumerate() {
                drawn.offer(weight, place, Vec3::Y);
            }
            assert!((0.0..=1.0).contains(&drawn.choice));
            counts[drawn.place.unwrap()] += 1;
        }
        for (drawn, weight) in counts.into_iter().zip(weights) {
            let share = if weight > 0.0 { weight / 16e-30 } else { 0.0 };
            assert!((drawn as f32 / count as f32 - share).abs() < 0.002, "{drawn} for {share}");
        }
        let mut nothing = DrawnLight::new([0.5; 3]);
        nothing.offer(0.0, 3, Vec3::X);
        assert_eq!(nothing.place, None);
    }

    /// Directions lie around the light as far as its photons' share says, and never below the horizon.
    #[test]
    fn directions_lie_around_their_light() {
        let n = Vec3::new(0.6, 0.0, 0.8);
        for (light, chord_rms) in [(n, 0.2f32), (Vec3::new(0.8, 0.0, -0.6), 0.5), (Vec3::Y, 0.0), (-n, 1.4)] {
            let mut squared = 0.0;
            for index in 0..4096 {
                let [_, u, v, _] = point(2, index);
                let mut drawn = DrawnLight::new([0.5, u, v]);
                drawn.offer(1.0, 0, light);
                let direction = drawn.direction(chord_rms, n);
                assert!((direction.length() - 1.0).abs() < 1e-5 && direction.dot(n) > -1e-6, "{direction}");
                squared += (direction - light).length_squared() / 4096.0;
            }
            let expected = SPREAD_DRAWN * chord_rms;
            if light == n {
                // Distances on the plane are bent onto the sphere.
                assert!((squared.sqrt() / expected - 1.0).abs() < 0.02, "{} for {expected}", squared.sqrt());
            } else if chord_rms == 0.0 {
                assert!(squared < 1e-10, "{squared}");
            }
        }
    }
}
