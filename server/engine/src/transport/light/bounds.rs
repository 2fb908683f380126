//! What a light, or a group of them, may send to a point: the measure that the tree of lights goes by.

use glam::Vec3;

/// What a light, or a group of lights, can do to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct LightBounds {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
    /// Axis of the cone that holds all emission axes, unit length.
    pub(super) axis: Vec3,
    /// Cosine of that cone's half angle.
    pub(super) cos_normals: f32,
    /// Cosine of the angle beyond an axis at which emission ends.
    pub(super) cos_emission: f32,
    /// Largest radiant intensity as a luminance, W/sr; above 0.
    pub(super) intensity: f32,
    pub(super) two_sided: bool,
}

/// Largest number that importances are told apart by: sums of a few stay floats.
pub(crate) const IMPORTANCE_MAX: f32 = 1e37;
/// Lights count as reaching at least this share of the way to them beyond a plane, and are ruled out by it only as far behind it: of what has
/// extent and lies in one plane, as lamps in a ceiling do, rounding decides nothing.
pub(crate) const LEVEL: f32 = 1e-3;

/// cos(max(0, a − b)) from the angles' sines and cosines.
fn cos_of_difference(sin_a: f32, cos_a: f32, sin_b: f32, cos_b: f32) -> f32 {
    if cos_a > cos_b { 1.0 } else { cos_a * cos_b + sin_a * sin_b }
}

fn sin_of(cos: f32) -> f32 {
    (1.0 - cos * cos).max(0.0).sqrt()
}

impl LightBounds {
    /// Middle of the box.
    pub(super) fn centre(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    /// About what arrives at most at point `p` whose surface faces `n` (zero vector: faces anywhere): cosines are bounds, the distance is that
    /// of the box's middle.
    ///
    /// Cosines are bounded by the sphere around the box and by how far the box reaches beyond the planes: the sphere of what is flat and
    /// close by reaches everywhere, and the back of a panel on a wall took nearly all samples from its edges, which light that wall.
    pub(super) fn importance(&self, p: Vec3, n: Vec3) -> f32 {
        let half = (self.max - self.min) * 0.5;
        let from_centre = p - self.centre();
        let (distance_m, radius_m) = (from_centre.length(), half.length());
        let least_m = LEVEL * (distance_m + radius_m);
        let lit_m = n.abs().dot(half) - n.dot(from_centre);
        let ahead_m = self.axis.dot(from_centre);
        let shining_m = if self.two_sided { ahead_m.abs() } else { ahead_m } + self.axis.abs().dot(half);
        let faces_one_way = self.cos_normals >= 1.0;
        if lit_m < -least_m || faces_one_way && shining_m < -least_m {
            return 0.0;
        }
        let nearest_m = (from_centre.abs() - half).max(Vec3::ZERO).length();
        let at_most = |cos: f32, reach_m: f32| {
            if nearest_m > 0.0 { cos.min(reach_m.max(least_m) / nearest_m) } else { cos }
        };
        let to_point = if distance_m > 0.0 { from_centre / distance_m } else { self.axis };
        let (sin_b, cos_b) = if distance_m > radius_m {
            (radius_m / distance_m, sin_of(radius_m / distance_m))
        } else {
            (0.0, -1.0)
        };
        let mut cos_w = self.axis.dot(to_point);
        if self.two_sided {
            cos_w = cos_w.abs();
        }
        if !faces_one_way {
            cos_w = cos_of_difference(sin_of(cos_w), cos_w, sin_of(self.cos_normals), self.cos_normals);
        }
        let mut cos_emitted = cos_of_difference(sin_of(cos_w), cos_w, sin_b, cos_b);
        if cos_emitted <= self.cos_emission {
            return 0.0;
        }
        if faces_one_way {
            cos_emitted = at_most(cos_emitted, shining_m);
        }
        let cos_received = if n == Vec3::ZERO {
            1.0
        } else {
            let cos_i = -to_point.dot(n);
            at_most(cos_of_difference(sin_of(cos_i), cos_i, sin_b, cos_b), lit_m)
        };
        if cos_emitted <= 0.0 || cos_received <= 0.0 {
            return 0.0;
        }
        let floored = distance_m.max(radius_m).powi(2).max(f32::MIN_POSITIVE);
        (self.intensity * cos_emitted * cos_received / floored).min(IMPORTANCE_MAX)
    }

    /// Bounds of both.
    pub(super) fn union(&self, other: &LightBounds) -> LightBounds {
        let (axis, cos_normals) = cone_union((self.axis, self.cos_normals), (other.axis, other.cos_normals));
        LightBounds {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            axis,
            cos_normals,
            cos_emission: self.cos_emission.min(other.cos_emission),
            intensity: self.intensity + other.intensity,
            two_sided: self.two_sided || other.two_sided,
        }
    }

    /// Cost of a node in the build: intensity × solid angle of emission × surface.
    pub(super) fn cost(&self, stretch: f32) -> f32 {
        let theta_o = self.cos_normals.clamp(-1.0, 1.0).acos();
        let theta_w = (theta_o + self.cos_emission.clamp(-1.0, 1.0).acos()).min(std::f32::consts::PI);
        let sin_o = theta_o.sin();
        let solid_angle = std::f32::consts::TAU * (1.0 - self.cos_normals)
            + std::f32::consts::FRAC_PI_2
                * (2.0 * theta_w * sin_o - (theta_o - 2.0 * theta_w).cos() - 2.0 * theta_o * sin_o
                    + self.cos_normals);
        let d = self.max - self.min;
        let area = d.x * d.y + d.y * d.z + d.z * d.x;
        // Lights on one line have no surface but still a size.
        self.intensity * solid_angle.max(1e-4) * stretch * area.max(d.max_element() * d.max_element() * 1e-6)
    }
}

/// Angle within which two axes count as opposite.
const OPPOSITE: f32 = 2e-3;

/// Smallest cone (axis, cosine of half angle) around two cones, or the whole sphere.
fn cone_union(a: (Vec3, f32), b: (Vec3, f32)) -> (Vec3, f32) {
    let whole = (a.0, -1.0);
    let (theta_a, theta_b) = (a.1.clamp(-1.0, 1.0).acos(), b.1.clamp(-1.0, 1.0).acos());
    // By the chord: the cosine of what is one axis to rounding may be 5e-4 away from it.
    let between = 2.0 * ((a.0 - b.0).length() * 0.5).min(1.0).asin();
    if (between + theta_b).min(std::f32::consts::PI) <= theta_a {
        return a;
    }
    if (between + theta_a).min(std::f32::consts::PI) <= theta_b {
        return b;
    }
    let theta = (theta_a + between + theta_b) * 0.5;
    // Between opposite axes rounding says about what to turn.
    if theta >= std::f32::consts::PI || between > std::f32::consts::PI - OPPOSITE {
        return whole;
    }
    let turn_axis = a.0.cross(b.0);
    match turn_axis.try_normalize() {
        Some(turn_axis) => (
            glam::Quat::from_axis_angle(turn_axis, theta - theta_a).mul_vec3(a.0).normalize_or(a.0),
            theta.cos(),
        ),
        None => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{sobol::point, warp};

    /// The cone around two holds both, whether their axes are opposite, equal to rounding or neither, and that of equal ones has no width.
    #[test]
    fn the_cone_around_two_holds_both() {
        for i in 0..2000 {
            let [x, y, z, w] = point(21, i);
            let a = warp::sphere([x, y]);
            let cos = [1.0, 0.999, 0.2][i as usize % 3];
            let apart = [1.2e-7, 1e-4, 3e-3, 1.0][i as usize % 4] * warp::sphere([z, w]);
            for b in [(a + apart).normalize(), (apart - a).normalize(), a] {
                let (axis, cos_half) = cone_union((a, cos), (b, cos));
                let half = cos_half.clamp(-1.0, 1.0).acos();
                for inner in [a, b] {
                    let farthest =
                        axis.as_dvec3().dot(inner.as_dvec3()).clamp(-1.0, 1.0).acos() as f32 + cos.acos();
                    assert!(
                        half >= farthest.min(std::f32::consts::PI) - 2e-3,
                        "{i}: {a} {b}: {half} {farthest}"
                    );
                }
            }
            assert_eq!(cone_union((a, cos), (a, cos)), (a, cos));
        }
    }
}
