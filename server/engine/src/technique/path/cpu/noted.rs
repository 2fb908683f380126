//! What a sample notes of the surfaces that it meets, for layers and for taking noise off: it says nothing of their light.

use glam::Vec3;

use super::{Path, Tracer};
use crate::{
    film::{Beyond, PixelSample},
    math::Rgb,
    transport::Surface,
};

impl Tracer<'_> {
    /// Notes the surface that is met first, and the first that is no mirror and no clear glass where that is another.
    pub(super) fn note_surface(&self, path: &Path<'_>, surface: &Surface, sample: &mut PixelSample) {
        let albedo = || surface.bsdf.albedo() + surface.unlit;
        if path.bounce == 0 {
            sample.albedo = albedo();
            sample.normal = surface.frame.n;
            sample.is_shining = !(surface.emitted + surface.unlit).is_black();
            sample.depth_m = self.view.map_or(0.0, |view| view.depth_m(surface.point.position));
        } else if path.is_clear && !surface.bsdf.is_clear() {
            path.note_beyond(albedo(), surface.frame.n, sample);
        }
    }
}

impl Path<'_> {
    /// Notes that nothing is met: what is around the scene is seen.
    pub(super) fn note_miss(&self, sample: &mut PixelSample) {
        if self.bounce == 0 {
            sample.is_shining = true;
        } else if self.is_clear {
            self.note_beyond(Rgb::WHITE, -self.ray.direction, sample);
        }
    }

    fn note_beyond(&self, albedo: Rgb, normal: Vec3, sample: &mut PixelSample) {
        sample.beyond = Some(Beyond { albedo: self.throughput * albedo, normal });
    }
}
