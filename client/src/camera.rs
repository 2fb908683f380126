//! The viewer's own camera: orbit, pan, dolly, fly, and what they do to `world_from_camera`.
//!
//! Pure mathematics in f64 (a scene may lie 100 km from the origin); no egui, no I/O. Metres, right-handed, +Y up, the
//! camera looks down −Z. Angles in radians, screen distances in fractions of the picture's height.

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};
use lumicast_protocol::{CameraPose, Projection};

/// Closest that a dolly brings the eye to its focus: nearer, the next step would vanish in rounding.
const FOCUS_DISTANCE_MIN_M: f64 = 1e-4;
/// Farthest: beyond it scenes of this planet are one pixel.
const FOCUS_DISTANCE_MAX_M: f64 = 1e8;
/// Orbiting stops this far from looking straight up or down, where "right" would flip.
const POLE_MARGIN_RAD: f64 = 0.01;
/// What is framed keeps this much room around it.
const FRAME_MARGIN: f64 = 1.08;

/// A camera that a person moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewCamera {
    /// The eye, in the world.
    pub position: DVec3,
    /// `world_from_camera` without the translation; unit length.
    pub orientation: DQuat,
    /// Metres from the eye to the point that orbiting turns about, along the view.
    pub focus_distance_m: f64,
    /// Kept as the scene's camera had it; only dollying a parallel projection changes its height.
    pub projection: Projection,
}

/// Directions to fly in, each −1, 0 or 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FlyDirection {
    /// D − A.
    pub right: f64,
    /// E − Q, along the world's +Y.
    pub up: f64,
    /// W − S.
    pub forward: f64,
}

/// An axis-aligned box in the world, `[min, max]`, metres.
pub type Bounds = [[f64; 3]; 2];

impl ViewCamera {
    /// A camera looking down −Z from the origin, before anything is known.
    pub fn new() -> Self {
        Self {
            position: DVec3::ZERO,
            orientation: DQuat::IDENTITY,
            focus_distance_m: 1.0,
            projection: Projection::default(),
        }
    }

    /// Takes over a camera of the scene. The focus is put where the view passes closest to the middle of `bounds`, so
    /// that orbiting keeps the scene in sight.
    pub fn from_pose(world_from_camera: &[f64; 16], projection: Projection, bounds: Option<Bounds>) -> Self {
        let matrix = DMat4::from_cols_array(world_from_camera);
        let position = matrix.w_axis.truncate();
        let position = if position.is_finite() { position } else { DVec3::ZERO };
        let mut camera =
            Self { position, orientation: rotation_of(&matrix), focus_distance_m: 1.0, projection };
        if let Some((centre, radius_m)) = bounds.and_then(sphere_around) {
            let along = (centre - position).dot(camera.forward());
            camera.focus_distance_m = clamp_focus(along.max(radius_m * 0.1));
        }
        camera
    }

    /// What is sent to the server.
    pub fn pose(&self) -> CameraPose {
        CameraPose { world_from_camera: self.world_from_camera(), projection: self.projection }
    }

    /// `[16]`, column-major, rigid.
    pub fn world_from_camera(&self) -> [f64; 16] {
        DMat4::from_rotation_translation(self.orientation, self.position).to_cols_array()
    }

    /// Unit vector, into the picture.
    pub fn forward(&self) -> DVec3 {
        self.orientation * DVec3::NEG_Z
    }

    /// Unit vector, to the right in the picture.
    pub fn right(&self) -> DVec3 {
        self.orientation * DVec3::X
    }

    /// Unit vector, up in the picture.
    pub fn up(&self) -> DVec3 {
        self.orientation * DVec3::Y
    }

    /// The point that orbiting turns about.
    pub fn focus(&self) -> DVec3 {
        self.position + self.forward() * self.focus_distance_m
    }

    /// Turns about the focus: `yaw_rad` about the world's up, `pitch_rad` about the camera's right. Positive yaw moves
    /// the eye to the left (the scene follows a drag to the right); positive pitch moves it up.
    pub fn orbit(&mut self, yaw_rad: f64, pitch_rad: f64) {
        let focus = self.focus();
        self.turn(-yaw_rad, -pitch_rad);
        self.position = focus - self.forward() * self.focus_distance_m;
    }

    /// Turns the head where it is: positive yaw looks to the left, positive pitch up.
    pub fn look(&mut self, yaw_rad: f64, pitch_rad: f64) {
        self.turn(yaw_rad, pitch_rad);
    }

    fn turn(&mut self, yaw_rad: f64, pitch_rad: f64) {
        // Angle of the view above the horizon; asin's argument is clamped because rounding may carry it past 1.
        let elevation_rad = self.forward().y.clamp(-1.0, 1.0).asin();
        let limit_rad = std::f64::consts::FRAC_PI_2 - POLE_MARGIN_RAD;
        // A scene's camera may start beyond the limit (a plan view): it may then only turn away from the pole.
        let highest_rad = limit_rad.max(elevation_rad);
        let lowest_rad = (-limit_rad).min(elevation_rad);
        let pitch_rad = (elevation_rad + pitch_rad).clamp(lowest_rad, highest_rad) - elevation_rad;
        let yaw = DQuat::from_rotation_y(yaw_rad);
        let pitch = DQuat::from_axis_angle(self.right(), pitch_rad);
        self.orientation = (yaw * pitch * self.orientation).normalize();
    }

    /// Moves the picture under the pointer: `drag` in fractions of the picture's height, x right, y down. The point at
    /// the focus stays under the pointer.
    pub fn pan(&mut self, drag: DVec2) {
        let height_m = self.height_at_focus_m();
        self.position += (self.right() * -drag.x + self.up() * drag.y) * height_m;
    }

    /// Metres that the picture's height covers at the focus.
    pub fn height_at_focus_m(&self) -> f64 {
        match self.projection {
            Projection::Perspective { yfov_rad } => {
                2.0 * self.focus_distance_m * (f64::from(yfov_rad) * 0.5).tan()
            }
            Projection::Orthographic { half_height_m } => 2.0 * f64::from(half_height_m),
        }
    }

    /// Comes closer to the focus by a factor: below 1 in, above 1 out. A parallel projection changes its height.
    pub fn dolly(&mut self, factor: f64) {
        let focus = self.focus();
        if let Projection::Orthographic { half_height_m } = &mut self.projection {
            let height_m = f64::from(*half_height_m) * factor;
            *half_height_m = height_m.clamp(FOCUS_DISTANCE_MIN_M, FOCUS_DISTANCE_MAX_M) as f32;
            return;
        }
        self.focus_distance_m = clamp_focus(self.focus_distance_m * factor);
        self.position = focus - self.forward() * self.focus_distance_m;
    }

    /// Moves freely; the focus moves along.
    pub fn fly(&mut self, direction: FlyDirection, distance_m: f64) {
        let wanted =
            self.right() * direction.right + DVec3::Y * direction.up + self.forward() * direction.forward;
        self.position += wanted.normalize_or_zero() * distance_m;
    }

    /// Shows all of a box, from the direction it is seen now. `aspect` = width ÷ height of the picture.
    pub fn frame(&mut self, bounds: Bounds, aspect: f64) {
        let Some((centre, radius_m)) = sphere_around(bounds) else { return };
        self.frame_sphere(centre, radius_m, aspect);
    }

    /// Shows all of a sphere, from the direction it is seen now.
    pub fn frame_sphere(&mut self, centre: DVec3, radius_m: f64, aspect: f64) {
        let radius_m = radius_m.max(FOCUS_DISTANCE_MIN_M) * FRAME_MARGIN;
        // The narrower side decides.
        let narrow = aspect.clamp(0.05, 20.0).min(1.0);
        match &mut self.projection {
            Projection::Perspective { yfov_rad } => {
                let half_rad = ((f64::from(*yfov_rad) * 0.5).tan() * narrow).atan();
                // A sphere touches the cone of half angle a when its centre is r / sin a away.
                self.focus_distance_m = clamp_focus(radius_m / half_rad.sin());
            }
            Projection::Orthographic { half_height_m } => {
                *half_height_m = (radius_m / narrow) as f32;
                self.focus_distance_m = clamp_focus(radius_m * 2.0);
            }
        }
        self.position = centre - self.forward() * self.focus_distance_m;
    }

    /// Turns about another point from now on, and looks at it from at most `distance_m`.
    pub fn look_from_here_at(&mut self, point: DVec3, distance_m: f64) {
        self.focus_distance_m = clamp_focus(distance_m);
        self.position = point - self.forward() * self.focus_distance_m;
    }

    /// Where a point of the world stands in the picture: x right and y down in fractions of width and height from the
    /// upper left corner; `None` behind the eye.
    pub fn project(&self, point: DVec3, aspect: f64) -> Option<DVec2> {
        let p_in_camera = self.orientation.inverse() * (point - self.position);
        let depth_m = -p_in_camera.z;
        let half_height_m = match self.projection {
            _ if depth_m <= 0.0 => return None,
            Projection::Perspective { yfov_rad } => depth_m * (f64::from(yfov_rad) * 0.5).tan(),
            Projection::Orthographic { half_height_m } => f64::from(half_height_m),
        };
        let x = p_in_camera.x / (half_height_m * aspect);
        let y = p_in_camera.y / half_height_m;
        Some(DVec2::new(0.5 + 0.5 * x, 0.5 - 0.5 * y))
    }
}

impl Default for ViewCamera {
    fn default() -> Self {
        Self::new()
    }
}

/// Middle and radius of the sphere around a box; `None` for a box that is not finite or inside out.
pub fn sphere_around([min, max]: Bounds) -> Option<(DVec3, f64)> {
    let (min, max) = (DVec3::from(min), DVec3::from(max));
    let usable = min.is_finite() && max.is_finite() && min.cmple(max).all();
    usable.then(|| ((min + max) * 0.5, (max - min).length() * 0.5))
}

fn clamp_focus(distance_m: f64) -> f64 {
    // NaN (of a scene that sends nonsense) becomes the least distance; `clamp` would keep it.
    if distance_m > FOCUS_DISTANCE_MIN_M {
        distance_m.min(FOCUS_DISTANCE_MAX_M)
    } else {
        FOCUS_DISTANCE_MIN_M
    }
}

/// The rotation of a matrix that is expected to be rigid; scale is divided out, nonsense becomes identity.
fn rotation_of(matrix: &DMat4) -> DQuat {
    let axes = DMat3::from_mat4(*matrix);
    let z = axes.z_axis.normalize_or(DVec3::Z);
    let y = (axes.y_axis - z * axes.y_axis.dot(z)).normalize_or(z.any_orthonormal_vector());
    let rotation = DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).normalize();
    if rotation.is_finite() { rotation } else { DQuat::IDENTITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: Bounds = [[-1.0, 0.0, -2.0], [1.0, 2.0, 1.0]];

    fn at(position: DVec3, target: DVec3) -> ViewCamera {
        let z = (position - target).normalize();
        let x = DVec3::Y.cross(z).normalize();
        let orientation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
        let projection = Projection::Perspective { yfov_rad: 0.8 };
        ViewCamera { position, orientation, focus_distance_m: position.distance(target), projection }
    }

    /// Seeded numbers in [−1, 1): a 64-bit LCG is random enough to vary the cases.
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }
    }

    #[test]
    fn orbiting_keeps_the_focus_its_distance_and_a_level_horizon() {
        for seed in 0..50 {
            let mut next = numbers(seed);
            // Up to 100 km out: f64 leaves about 1e-11 of that.
            let target = DVec3::new(next(), next(), next()) * 1e5;
            let mut camera = at(target + DVec3::new(next() * 3.0, next() * 3.0, 4.0), target);
            let distance_m = camera.focus_distance_m;
            for _ in 0..100 {
                camera.orbit(next(), next());
                assert!(camera.focus().distance(target) < 1e-6);
                assert!((camera.position.distance(target) - distance_m).abs() < 1e-6);
                assert!(camera.right().y.abs() < 1e-9, "the horizon tilts by {}", camera.right().y);
                assert!(camera.up().y > 0.0, "the picture stands on its head");
            }
        }
    }

    #[test]
    fn dragging_right_moves_the_scene_right() {
        // A point nearer than the focus lies on the side of the orbit that faces the viewer.
        let mut camera = at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO);
        let near = DVec3::new(0.0, 0.0, 1.0);
        camera.orbit(0.1, 0.0);
        assert!(camera.project(near, 1.0).unwrap().x > 0.5);
        camera.orbit(-0.1, 0.1);
        assert!(camera.project(near, 1.0).unwrap().y > 0.5, "dragging down raises the eye");
    }

    #[test]
    fn panning_keeps_the_point_at_the_focus_under_the_pointer() {
        for projection in
            [Projection::Perspective { yfov_rad: 0.8 }, Projection::Orthographic { half_height_m: 2.0 }]
        {
            let mut camera = at(DVec3::new(3.0, 2.0, 5.0), DVec3::new(0.0, 1.0, 0.0));
            camera.projection = projection;
            let point = camera.focus();
            camera.pan(DVec2::new(0.25, -0.125));
            let seen = camera.project(point, 2.0).unwrap();
            // The drag is in heights; at aspect 2 a quarter of the height is an eighth of the width.
            assert!((seen - DVec2::new(0.625, 0.375)).length() < 1e-9, "{seen}");
        }
    }

    #[test]
    fn dollying_in_and_out_comes_back_and_never_passes_the_focus() {
        let mut camera = at(DVec3::new(0.0, 1.0, 5.0), DVec3::new(0.0, 1.0, 0.0));
        let before = camera;
        camera.dolly(0.8);
        camera.dolly(1.0 / 0.8);
        assert!(camera.position.distance(before.position) < 1e-9);
        for _ in 0..1000 {
            camera.dolly(0.5);
        }
        assert!(camera.position.z > 0.0 && camera.position.is_finite());
    }

    #[test]
    fn framing_shows_every_corner_and_wastes_little() {
        for aspect in [0.5, 1.0, 1.78] {
            for projection in
                [Projection::Perspective { yfov_rad: 0.8 }, Projection::Orthographic { half_height_m: 9.0 }]
            {
                let mut camera = at(DVec3::new(30.0, 20.0, 50.0), DVec3::ZERO);
                camera.projection = projection;
                camera.frame(BOX, aspect);
                let mut extent: f64 = 0.0;
                for corner in 0..8 {
                    let pick = |axis: usize| BOX[(corner >> axis) & 1][axis];
                    let seen = camera.project(DVec3::new(pick(0), pick(1), pick(2)), aspect).unwrap();
                    assert!(seen.min_element() >= 0.0 && seen.max_element() <= 1.0, "{seen} at {aspect}");
                    extent = extent.max((seen - 0.5).abs().max_element() * 2.0);
                }
                assert!(extent > 0.5, "the box fills only {extent} of the picture");
            }
        }
    }

    #[test]
    fn flying_goes_where_the_keys_say_at_the_same_speed_in_every_direction() {
        let mut camera = at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO);
        camera.fly(FlyDirection { right: 1.0, up: 0.0, forward: 1.0 }, 2.0);
        let moved = camera.position - DVec3::new(0.0, 0.0, 5.0);
        assert!((moved.length() - 2.0).abs() < 1e-12);
        assert!(moved.x > 0.0 && moved.z < 0.0);
        let before = camera.position;
        camera.fly(FlyDirection::default(), 2.0);
        assert_eq!(camera.position, before);
    }

    #[test]
    fn a_camera_of_the_scene_is_taken_over_exactly() {
        for seed in 0..50 {
            let mut next = numbers(seed);
            let rotation = DQuat::from_xyzw(next(), next(), next(), next()).normalize();
            let position = DVec3::new(next(), next(), next()) * 1e5;
            let matrix = DMat4::from_rotation_translation(rotation, position);
            let camera = ViewCamera::from_pose(&matrix.to_cols_array(), Projection::default(), Some(BOX));
            for (a, b) in camera.world_from_camera().iter().zip(matrix.to_cols_array()) {
                assert!((a - b).abs() < 1e-12, "{a} {b}");
            }
            assert!(camera.focus_distance_m > 0.0);
        }
    }

    #[test]
    fn a_plan_view_can_be_left_and_a_level_view_never_reaches_the_pole() {
        let down = DMat4::from_rotation_x(-std::f64::consts::FRAC_PI_2).to_cols_array();
        let mut plan = ViewCamera::from_pose(&down, Projection::default(), None);
        plan.orbit(0.0, -0.5);
        assert!(plan.forward().y > -0.95);
        let mut level = at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO);
        for _ in 0..100 {
            level.orbit(0.3, 0.3);
        }
        assert!(level.up().y > 0.0);
    }

    #[test]
    fn nonsense_from_a_server_gives_a_finite_camera() {
        for bad in [[0.0; 16], [f64::NAN; 16], [f64::INFINITY; 16], [1.0; 16]] {
            let camera = ViewCamera::from_pose(&bad, Projection::default(), Some([[f64::NAN; 3]; 2]));
            assert!(camera.orientation.is_finite(), "{bad:?}");
            assert!(camera.focus_distance_m.is_finite());
        }
    }
}
