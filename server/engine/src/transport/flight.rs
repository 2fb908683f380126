//! Flux on its way from a light: what the media it crosses and the surfaces it meets do to it.

use super::{Absorption, Bsdf, BsdfSample, Scatter, Surface, World};
use crate::{
    accel::{Hit, Ray},
    math::{Frame, Rgb, warp},
};

/// Cosine between a surface and its bent normal from which on it is not bent.
pub(crate) const STRAIGHT_COS: f32 = 1.0 - 1e-5;

/// A photon between two surfaces.
#[derive(Clone, Copy, Debug)]
pub struct Flight {
    /// Where it goes.
    pub ray: Ray,
    /// What it carries: flux, in whatever unit it began with.
    pub weight: Rgb,
    /// What it crosses; `None` in air and clear glass.
    medium: Option<Absorption>,
}

impl Flight {
    /// Surfaces after which it ends whatever it carries: light trapped by total reflection in lossless glass never would.
    pub const BOUNCES_END: u32 = 4096;

    /// From a light.
    pub fn begin(ray: Ray, weight: Rgb) -> Flight {
        Flight { ray, weight, medium: None }
    }

    /// The surface it meets. Takes off what the medium on the way there absorbs.
    pub fn arrive(&mut self, world: &World, hit: &Hit) -> Surface {
        let direction = self.ray.direction;
        let surface = world.surface(hit, direction);
        // Glass met from inside says what the ray came through; every other surface is met in what was entered last.
        if matches!(surface.bsdf, Bsdf::Glass(_)) && direction.dot(surface.frame.n) > 0.0 {
            self.medium = surface.inside;
        }
        if let Some(medium) = &self.medium {
            self.weight *= medium.transmittance(hit.t);
        }
        surface
    }

    /// Draws where it goes on from a surface with the numbers `u` (lobe, two for the direction); `None`: it is absorbed.
    ///
    /// Directions of a diffuse lobe are drawn by the cosine that counts for flux, that with the surface and not with its bent
    /// normal: of bent normals some photons would carry any multiple of the flux of others. Sponza's, up to 70° off, made one
    /// photon as good as four.
    pub fn draw(&self, surface: &Surface, u: [f32; 3]) -> Option<BsdfSample> {
        let wo_local = surface.frame.to_local(-self.ray.direction);
        let drawn = surface.bsdf.sample(wo_local, u)?;
        let n_geo = surface.point.n_geo;
        if drawn.scatter != Scatter::Diffuse || surface.frame.n.dot(n_geo).abs() >= STRAIGHT_COS {
            return Some(drawn);
        }
        // Of a direction and its opposite one is on the side, by the bent normal, to which the lobe scatters.
        let wi = surface.frame.to_local(Frame::around(n_geo).to_world(warp::cosine_hemisphere([u[1], u[2]])));
        let wi = if wi.z * drawn.wi.z < 0.0 { -wi } else { wi };
        let value = surface.bsdf.eval_diffuse(wo_local, wi);
        let chance = value.pdf_solid_angle / warp::cosine_hemisphere_pdf(wi.z.abs());
        let pdf = chance * warp::cosine_hemisphere_pdf(surface.frame.to_world(wi).dot(n_geo).abs());
        (pdf > 0.0).then(|| BsdfSample {
            wi,
            weight: value.f_cos * (1.0 / pdf),
            pdf_solid_angle: Some(pdf),
            ..drawn
        })
    }

    /// How it goes on from a surface in the direction drawn there; `None` if it carries nothing.
    pub fn scattered(&self, surface: &Surface, drawn: &BsdfSample) -> Option<Flight> {
        let wo = -self.ray.direction;
        let wo_local = surface.frame.to_local(wo);
        let wi = surface.frame.to_world(drawn.wi);
        // The weight is that of radiance on its way to the eye; flux is not scaled where it enters a denser medium.
        let mut weight = self.weight * drawn.weight * drawn.eta_squared;
        // And the cosine that counts for flux is that of the surface, not of its bent normal [Veach1997, 5.3.2].
        let n_geo = surface.point.n_geo;
        let bent = (wo.dot(n_geo) * drawn.wi.z).abs();
        if bent > 0.0 {
            weight *= (wo_local.z * wi.dot(n_geo)).abs() / bent;
        }
        if !weight.is_finite() || !(weight.luminance() > 0.0) {
            return None;
        }
        let medium = match wo_local.z * drawn.wi.z < 0.0 {
            true if drawn.wi.z < 0.0 => surface.inside,
            true => None,
            false => self.medium,
        };
        Some(Flight { ray: surface.point.ray_towards(wi), weight, medium })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3, Vec3};

    use super::*;
    use crate::{
        math::sobol,
        scene::{
            Material,
            samples::{self, Stage},
        },
        transport::bsdf::Gltf,
    };

    /// A floor met from above at an angle, its normal bent by 60°.
    fn bent(bsdf: Bsdf) -> (Flight, Surface) {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::WHITE)).unwrap();
        let v = DVec3::new;
        let corners = [v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)];
        stage.place("floor", samples::quad(corners, &white), DAffine3::IDENTITY).unwrap();
        let world = World::prepare(Arc::new(stage.finish()));
        let ray = Ray::new(Vec3::new(0.9, 0.3, 0.1), Vec3::new(-0.9, -0.3, 0.0).normalize());
        let mut flight = Flight::begin(ray, Rgb::WHITE);
        let surface = flight.arrive(&world, &world.closest_hit(&ray).unwrap());
        let frame = Frame::around(Vec3::new(0.75f32.sqrt(), 0.5, 0.0));
        (flight, Surface { frame, bsdf, ..surface })
    }

    /// What goes on into any part of the directions is what the Bsdf says, with the cosine of the surface [Veach1997, 5.3.2];
    /// of a diffuse surface every photon carries the same.
    #[test]
    fn flux_from_bent_normals_goes_where_the_bsdf_says() {
        let rough = Gltf::new(Rgb::splat(0.6), 0.0, 0.7, 1.5, 1.0, Rgb::WHITE);
        for bsdf in [Bsdf::Lambert { albedo: Rgb::splat(0.7) }, Bsdf::Gltf(rough)] {
            let (flight, surface) = bent(bsdf);
            let n_geo = surface.point.n_geo;
            let wo = -flight.ray.direction;
            let wo_local = surface.frame.to_local(wo);
            let parts =
                |d: Vec3| [1.0, f64::from(d.x > 0.0), f64::from(d.dot(n_geo) > 0.0), f64::from(d.z > 0.5)];
            const COUNT: u32 = 1 << 17;
            let (mut drawn, mut expected, mut weights) = ([0.0; 4], [0.0; 4], [f32::MAX, 0.0f32]);
            for i in 0..COUNT {
                let [lobe, u, v, _] = sobol::point(7, i);
                if let Some(sample) =
                    flight.draw(&surface, [lobe, u, v]).filter(|s| s.scatter == Scatter::Diffuse)
                {
                    let next = flight.scattered(&surface, &sample).unwrap();
                    weights = [weights[0].min(next.weight.g), weights[1].max(next.weight.g)];
                    let of = parts(next.ray.direction).map(|part| part * f64::from(next.weight.g));
                    drawn.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / f64::from(COUNT));
                }
                // The same by even directions.
                let wi = surface.frame.to_world(warp::sphere([u, v]));
                let local = surface.frame.to_local(wi);
                let f = f64::from(surface.bsdf.eval(wo_local, local).diffuse.f_cos.g / local.z.abs());
                let cosines = f64::from(wi.dot(n_geo).abs() * wo_local.z / wo.dot(n_geo).abs());
                let of = parts(wi).map(|part| part * f * cosines * 4.0 * std::f64::consts::PI);
                expected.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / f64::from(COUNT));
            }
            for (drawn, expected) in drawn.into_iter().zip(expected) {
                assert!((drawn / expected - 1.0).abs() < 0.01, "{bsdf:?}: {drawn} for {expected}");
            }
            let [least, most] = weights;
            assert!(most < 1.001 * least || matches!(bsdf, Bsdf::Gltf(_)), "{least} … {most}");
        }
    }
}
