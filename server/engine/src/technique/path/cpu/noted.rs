//! What a sample notes of the surfaces that it meets, for layers and for taking noise off: it says nothing of their light.

use glam::Vec3;

use super::{Path, Tracer};
use crate::{
    film::{Beyond, PixelSample},
    math::Rgb,
    transport::{Bsdf, Surface},
};

/// By way of what a path goes from the eye, from best to worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::technique::path) enum Sightline {
    /// Of nothing, or of mirrors alone: what it meets is shown as it is, in their colour.
    Straight,
    /// Of clear glass as well, where that shows most from.
    Glass,
    /// Of other surfaces too, or where glass shows less from.
    Clouded,
}

impl Sightline {
    /// After a surface that sent the path, which came from `wo`, to `wi`; both in its frame.
    pub(super) fn after(self, bsdf: &Bsdf, wo: Vec3, wi: Vec3) -> Sightline {
        let by_surface = match bsdf {
            _ if !bsdf.is_clear() || !bsdf.shows_most_from(wo, wi) => Sightline::Clouded,
            Bsdf::Glass(_) => Sightline::Glass,
            _ => Sightline::Straight,
        };
        self.max(by_surface)
    }
}

impl Tracer<'_> {
    /// Notes the surface that is met first, and the first that is no mirror and no clear glass where that is another; and whether what is
    /// met shines, where it is shown as it is.
    pub(super) fn note_surface(&self, path: &Path<'_>, surface: &Surface, sample: &mut PixelSample) {
        let albedo = || surface.bsdf.albedo() + surface.unlit;
        if path.bounce == 0 {
            sample.albedo = albedo();
            sample.normal = surface.frame.n;
            sample.depth_m = self.view.map_or(0.0, |view| view.depth_m(surface.point.position));
        } else if path.sightline != Sightline::Clouded && !surface.bsdf.is_clear() {
            path.note_beyond(albedo(), surface.frame.n, sample);
        }
        sample.is_shining |=
            path.sightline == Sightline::Straight && !(surface.emitted + surface.unlit).is_black();
    }
}

impl Path<'_> {
    /// Notes that nothing is met: what is around the scene is seen.
    pub(super) fn note_miss(&self, sample: &mut PixelSample) {
        sample.is_shining |= self.sightline == Sightline::Straight;
        if self.bounce > 0 && self.sightline != Sightline::Clouded {
            self.note_beyond(Rgb::WHITE, -self.ray.direction, sample);
        }
    }

    fn note_beyond(&self, albedo: Rgb, normal: Vec3, sample: &mut PixelSample) {
        sample.beyond = Some(Beyond { albedo: self.throughput * albedo, normal });
    }
}
