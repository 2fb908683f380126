//! Camera rays.

#[cfg(test)]
mod tests;

use glam::{DVec3, Vec3};

use crate::{
    accel::{Ray, SurfacePoint, TriangleId},
    film::PictureSize,
    scene::{CameraView, Projection},
    transport::World,
};

/// Added around the pixels of spheres, px: far more than rounding takes a point out of its pixel.
pub(super) const SPHERE_SLACK_PX: f32 = 0.05;

/// A camera with a picture size, in render space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    pub(super) origin: Vec3,
    pub(super) right: Vec3,
    pub(super) up: Vec3,
    pub(super) back: Vec3,
    /// Half the picture's width and height: at distance 1 (perspective) or in metres (orthographic).
    pub(super) half_size: [f32; 2],
    pub(super) is_perspective: bool,
    size: PictureSize,
}

impl View {
    /// Its eye lies nearer than so far from the origin along each axis of render space, and at distance 1 (perspective) or at any it sees
    /// less than that, m.
    pub(crate) fn is_within(&self, far_m: f32) -> bool {
        let mut along = self.origin.to_array().into_iter().chain(self.half_size);
        along.all(|along| along.abs() < far_m)
    }

    /// The camera as `world` sees it. The vertical field of view is kept, the width follows from the picture's aspect.
    pub fn new(world: &World, view: &CameraView, size: PictureSize) -> View {
        let axes = view.world_from_camera.matrix3;
        // Cameras may hang below scaled nodes: only the axes' directions count.
        let back = axes.z_axis.normalize_or(DVec3::Z);
        let up = (axes.y_axis - back * back.dot(axes.y_axis)).normalize_or(back.any_orthonormal_vector());
        let right = up.cross(back);
        // A mirroring transform keeps its mirrored right.
        let right = if right.dot(axes.x_axis) < 0.0 { -right } else { right };
        let (half_height, is_perspective) = match view.projection {
            Projection::Perspective { yfov_rad } => ((yfov_rad * 0.5).tan(), true),
            Projection::Orthographic { half_height_m } => (half_height_m, false),
        };
        View {
            origin: world.accel().to_render(view.world_from_camera.translation),
            right: right.as_vec3(),
            up: up.as_vec3(),
            back: back.as_vec3(),
            half_size: [(half_height * size.aspect()) as f32, half_height as f32],
            is_perspective,
            size,
        }
    }

    /// The ray through the point (`x`, `y`) of the picture, in pixels from the top left corner.
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let across = (2.0 * x / self.size.width() as f32 - 1.0) * self.half_size[0];
        let upwards = (1.0 - 2.0 * y / self.size.height() as f32) * self.half_size[1];
        let offset = self.right * across + self.up * upwards;
        if self.is_perspective {
            Ray::new(self.origin, (offset - self.back).normalize())
        } else {
            Ray::new(self.origin + offset, -self.back)
        }
    }

    /// Distance of a point of render space along the camera's axis, metres; never negative.
    pub fn depth_m(&self, p: Vec3) -> f32 {
        // What a ray has met lies in front, but for a camera on that very surface rounding may put it behind.
        (self.origin - p).dot(self.back).max(0.0)
    }

    /// Where a point of render space shows, px from the top left corner; `None` at the eye and behind it.
    pub fn project(&self, p: Vec3) -> Option<[f32; 2]> {
        let offset = p - self.origin;
        let depth_m = -offset.dot(self.back);
        if !(depth_m > 0.0) {
            return None;
        }
        let across = offset.dot(self.right) / self.per_half(depth_m, 0);
        let upwards = offset.dot(self.up) / self.per_half(depth_m, 1);
        let [width, height] = [self.size.width(), self.size.height()].map(|count| count as f32);
        Some([0.5 * (1.0 + across) * width, 0.5 * (1.0 - upwards) * height])
    }

    /// Whether a place that [`View::project`] tells lies in the picture.
    pub(crate) fn holds(&self, [x, y]: [f32; 2]) -> bool {
        let [width, height] = [self.size.width(), self.size.height()].map(|count| count as f32);
        (0.0..width).contains(&x) && (0.0..height).contains(&y)
    }

    /// First and last pixel of the rectangle in which a sphere shows, cut off at the borders of the picture; `None` where it does not.
    /// Nothing of it shows outside [Mara2013]; all of the picture where the eye is inside it.
    pub fn pixels_of_sphere(&self, centre: Vec3, radius_m: f32) -> Option<[[u32; 2]; 2]> {
        let offset = centre - self.origin;
        let depth_m = -offset.dot(self.back);
        let across = self.extent_of_sphere([offset.dot(self.right), depth_m], radius_m)?;
        let upwards = self.extent_of_sphere([offset.dot(self.up), depth_m], radius_m)?;
        let [width, height] = [self.size.width(), self.size.height()].map(|count| count as f32);
        let pixels = |[least, most]: [f32; 2], half: f32, count: f32| {
            let [least, most] = [least, most].map(|at| 0.5 * (1.0 + at / half) * count);
            // Rounding of where a ray meets a surface must not take it out of its pixel.
            let [first, last] = [least - SPHERE_SLACK_PX, most + SPHERE_SLACK_PX].map(f32::floor);
            (last >= 0.0 && first < count)
                .then(|| [first.max(0.0), last.min(count - 1.0)].map(|at| at as u32))
        };
        let [left, right] = pixels(across, self.half_size[0], width)?;
        let [top, bottom] = pixels([-upwards[1], -upwards[0]], self.half_size[1], height)?;
        Some([[left, top], [right, bottom]])
    }

    /// Least and most that a sphere takes up along an axis of the picture, at distance 1 (perspective) or in metres (orthographic);
    /// `None` where all of it lies behind the eye.
    ///
    /// - `centre`: along that axis and the camera's, m
    fn extent_of_sphere(&self, [along, depth_m]: [f32; 2], radius_m: f32) -> Option<[f32; 2]> {
        if !(depth_m + radius_m > 0.0) {
            return None;
        }
        if !self.is_perspective {
            return Some([along - radius_m, along + radius_m]);
        }
        let tangent_m2 = along * along + depth_m * depth_m - radius_m * radius_m;
        if !(tangent_m2 > 0.0) {
            return Some([f32::NEG_INFINITY, f32::INFINITY]);
        }
        // Two lines from the eye touch the circle; their directions are those to its centre turned by asin(r / distance) either way,
        // whose sine and cosine are, but for a common factor, as follows. A line that goes backwards bounds nothing in front.
        let tangent_m = tangent_m2.sqrt();
        let bound = |radius_m: f32| {
            let (across, ahead) =
                (along * tangent_m + depth_m * radius_m, depth_m * tangent_m - along * radius_m);
            (ahead > 0.0).then(|| across / ahead)
        };
        let (least, most) = (bound(-radius_m), bound(radius_m));
        // From behind the eye it reaches into the picture on the side that it lies on, if at all.
        if depth_m < 0.0 && (if along < 0.0 { most } else { least }).is_none() {
            return None;
        }
        Some([least.unwrap_or(f32::NEG_INFINITY), most.unwrap_or(f32::INFINITY)])
    }

    /// Unit direction from a point of render space to the eye, and the area that a pixel covers there of what faces it, m².
    pub fn pixel_at(&self, p: Vec3) -> (Vec3, f32) {
        let depth_m = self.depth_m(p);
        let pixel_of = |axis: usize, count: u32| 2.0 * self.per_half(depth_m, axis) / count as f32;
        let across_axis_m2 = pixel_of(0, self.size.width()) * pixel_of(1, self.size.height());
        if !self.is_perspective {
            return (self.back, across_axis_m2);
        }
        let towards = (self.origin - p).normalize_or(self.back);
        (towards, across_axis_m2 * towards.dot(self.back).max(0.0))
    }

    /// Half the width (0) or height (1) of what is seen at some depth, m.
    fn per_half(&self, depth_m: f32, axis: usize) -> f32 {
        self.half_size[axis] * if self.is_perspective { depth_m } else { 1.0 }
    }

    /// Size of the picture.
    pub fn size(&self) -> PictureSize {
        self.size
    }
}

/// A view from a place, which may lie on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lookout {
    /// What is seen from there.
    pub view: View,
    /// The triangle that it lies on, which it does not see; [`TriangleId::NONE`] for others.
    pub left: TriangleId,
}

impl Lookout {
    /// What lies before a point of a surface, on the plane at distance 1 that reaches `half_side` up and down, and to the sides as the
    /// picture's aspect has it.
    ///
    /// - `n`: unit, the way to look; whatever turns the plane around it serves
    pub fn before(point: &SurfacePoint, n: Vec3, half_side: f32, size: PictureSize) -> Lookout {
        let (right, up) = n.any_orthonormal_pair();
        let Ray { origin, left, .. } = point.ray_towards(n);
        // Right-handed: right × up looks back.
        let right = if right.cross(up).dot(n) > 0.0 { -right } else { right };
        let half_size = [half_side * size.aspect() as f32, half_side];
        let view = View { origin, right, up, back: -n, half_size, is_perspective: true, size };
        Lookout { view, left }
    }

    /// [`Lookout::before`] what a ray meets, on the side that it is seen from; `None` where that is nothing.
    pub fn before_what_is_met(
        world: &World,
        ray: &Ray,
        half_side: f32,
        size: PictureSize,
    ) -> Option<Lookout> {
        let surface = world.surface(&world.closest_hit(ray)?, ray.direction);
        let n = surface.frame.n;
        let n = if ray.direction.dot(n) > 0.0 { -n } else { n };
        Some(Lookout::before(&surface.point, n, half_side, size))
    }

    /// [`View::ray`] from there.
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        Ray { left: self.left, ..self.view.ray(x, y) }
    }

    /// The rays through the middles of all pixels, row by row.
    pub fn rays(&self) -> impl Iterator<Item = Ray> {
        let size = self.view.size();
        let pixels = (0..size.height()).flat_map(move |y| (0..size.width()).map(move |x| (x, y)));
        pixels.map(|(x, y)| self.ray(x as f32 + 0.5, y as f32 + 0.5))
    }
}
