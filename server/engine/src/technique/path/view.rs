//! Camera rays.

use glam::{DVec3, Vec3};

use crate::{
    accel::Ray,
    film::PictureSize,
    scene::{CameraView, Projection},
    transport::World,
};

/// A camera with a picture size, in render space.
#[derive(Clone, Copy, Debug)]
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
