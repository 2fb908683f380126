//! Flux on its way from a light: what the media it crosses and the surfaces it meets do to it.

use super::{Absorption, Bsdf, BsdfSample, Scatter, Surface, World};
use crate::{
    accel::{Hit, Ray},
    math::{Frame, Rgb, warp},
};

/// Cosine between a surface and its bent normal from which on it is not bent.
pub(crate) const STRAIGHT_COS: f32 = 1.0 - 1e-5;

/// By how much flux may grow at a bent normal. What grazes the surface and not its bent normal grows without bound, and such a photon is seen as a
/// spot where it falls, and at every surface it goes on to. What is lost is (1 − cos) / (2 · this) of even light: 3 % where the normal is bent by 60°.
pub(crate) const BENT_MAX: f32 = 8.0;

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

    /// Draws where it goes on from a surface with the numbers `u` (lobe, two for the direction); `None`: it is absorbed. The surface's
    /// frame is the one that the direction is in: that of who looks from there.
    ///
    /// Directions of a diffuse lobe are drawn by the cosine that counts for flux, that with the surface and not with its bent
    /// normal: of bent normals some photons would carry any multiple of the flux of others. Sponza's, up to 70° off, made one
    /// photon as good as four.
    pub fn draw(&self, surface: &mut Surface, u: [f32; 3]) -> Option<BsdfSample> {
        let wo = -self.ray.direction;
        let drawn = surface.bsdf.sample(surface.frame.to_local(wo), u)?;
        let (n_geo, normals) = (surface.point.n_geo, surface.normals);
        if drawn.scatter != Scatter::Diffuse {
            let wi = surface.frame.to_world(drawn.wi);
            let goes_on = surface.reflects_photons_of(wo) && surface.may_scatter(wo, wi);
            return goes_on.then_some(drawn);
        }
        if normals.face_alike(wo) && normals.mapped.dot(n_geo).abs() >= STRAIGHT_COS {
            return Some(drawn);
        }
        // Of a direction and its opposite one is on the side to which the lobe scatters.
        let wi = Frame::around(n_geo).to_world(warp::cosine_hemisphere([u[1], u[2]]));
        let wi = if wi.dot(normals.side) * wo.dot(normals.side) < 0.0 { -wi } else { wi };
        let chance = drawn.pdf_solid_angle? / warp::cosine_hemisphere_pdf(drawn.wi.z.abs());
        surface.frame = Frame::around(normals.seen_from(wi));
        let [wo, local] = [wo, wi].map(|w| surface.frame.to_local(w));
        let pdf = chance * warp::cosine_hemisphere_pdf(wi.dot(n_geo).abs());
        (pdf > 0.0).then(|| BsdfSample {
            wi: local,
            weight: surface.bsdf.eval_diffuse(wo, local).f_cos * (1.0 / pdf),
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
        if wo.dot(n_geo) * drawn.wi.z != 0.0 {
            let arriving = (wo_local.z / wo.dot(n_geo)).abs();
            let leaving = (wi.dot(n_geo) / drawn.wi.z).abs();
            // Of a diffuse lobe the way it was drawn makes up for how it leaves.
            weight *= match drawn.scatter {
                Scatter::Diffuse => arriving.min(BENT_MAX) * leaving,
                Scatter::Specular => (arriving * leaving).min(BENT_MAX),
            };
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
        transport::{Normals, bsdf::Gltf},
    };

    /// A floor met from above, its normal interpolated or mapped to one that leans by 60°.
    ///
    /// - `toward`: where the photon comes from
    fn bent(bsdf: Bsdf, side: Vec3, toward: Vec3) -> (Flight, Surface) {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::WHITE)).unwrap();
        let v = DVec3::new;
        let corners = [v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)];
        stage.place("floor", samples::quad(corners, &white), DAffine3::IDENTITY).unwrap();
        let world = World::prepare(Arc::new(stage.finish()));
        let ray = Ray::new(toward + Vec3::new(0.0, 0.0, 0.1), -toward.normalize());
        let mut flight = Flight::begin(ray, Rgb::WHITE);
        let surface = flight.arrive(&world, &world.closest_hit(&ray).unwrap());
        let normals = Normals { side, mapped: LEANING };
        let frame = Frame::around(normals.seen_from(-ray.direction));
        (flight, Surface { frame, normals, bsdf, ..surface })
    }

    const LEANING: Vec3 = Vec3::new(0.866_025_4, 0.5, 0.0);
    const FROM_FRONT: Vec3 = Vec3::new(0.9, 0.3, 0.0);
    /// From where nothing falls on a surface that leans so, and from where little does.
    const FROM_BEHIND: Vec3 = Vec3::new(-0.9, 0.3, 0.2);
    const FROM_ASIDE: Vec3 = Vec3::new(-0.1, 0.3, 0.9);

    /// What goes on into any part of the directions is what whoever looks from there sees, by the Bsdf with the cosine of the surface
    /// [Veach1997, 5.3.2]; of a diffuse surface that is not mapped every photon carries the same.
    #[test]
    fn flux_from_bent_normals_goes_where_the_bsdf_says() {
        let rough = Bsdf::Gltf(Gltf::new(Rgb::splat(0.6), 0.0, 0.7, 1.5, 1.0, Rgb::WHITE));
        let matt = Bsdf::Lambert { albedo: Rgb::splat(0.7) };
        for (bsdf, side, toward) in [
            (matt, LEANING, FROM_FRONT),
            (rough, LEANING, FROM_FRONT),
            (matt, Vec3::Y, FROM_FRONT),
            (rough, Vec3::Y, FROM_FRONT),
            (matt, Vec3::Y, FROM_ASIDE),
            (rough, Vec3::Y, FROM_ASIDE),
            (matt, Vec3::Y, FROM_BEHIND),
            (rough, Vec3::Y, FROM_BEHIND),
        ] {
            let (flight, surface) = bent(bsdf, side, toward);
            let n_geo = surface.point.n_geo;
            let wo = -flight.ray.direction;
            let parts =
                |d: Vec3| [1.0, f64::from(d.x > 0.0), f64::from(d.dot(LEANING) > 0.0), f64::from(d.z > 0.5)];
            const COUNT: u32 = 1 << 17;
            let (mut drawn, mut expected, mut weights) = ([0.0; 4], [0.0; 4], [f32::MAX, 0.0f32]);
            for i in 0..COUNT {
                let [lobe, u, v, _] = sobol::point(7, i);
                let mut met = surface;
                if let Some(next) = flight
                    .draw(&mut met, [lobe, u, v])
                    .filter(|sample| sample.scatter == Scatter::Diffuse)
                    .and_then(|sample| flight.scattered(&met, &sample))
                {
                    weights = [weights[0].min(next.weight.g), weights[1].max(next.weight.g)];
                    let of = parts(next.ray.direction).map(|part| part * f64::from(next.weight.g));
                    drawn.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / f64::from(COUNT));
                }
                // The same by even directions, from each of which someone looks.
                let eye = warp::sphere([u, v]);
                if eye.dot(side) < 0.0 {
                    continue;
                }
                let frame = Frame::around(surface.normals.seen_from(eye));
                let f_cos = surface.bsdf.eval(frame.to_local(eye), frame.to_local(wo)).diffuse.f_cos;
                let cosines = (eye.dot(n_geo) / wo.dot(n_geo)).abs();
                let flux = f64::from(f_cos.g * cosines) * 4.0 * std::f64::consts::PI;
                let of = parts(eye).map(|part| part * flux);
                expected.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / f64::from(COUNT));
            }
            for (drawn, expected) in drawn.into_iter().zip(expected) {
                let off = (drawn - expected).abs();
                assert!(
                    off < 0.01 * expected + 1e-4,
                    "{bsdf:?} {side} from {toward}: {drawn} for {expected}"
                );
            }
            let [least, most] = weights;
            let is_even = matches!(bsdf, Bsdf::Lambert { .. }) && side == LEANING;
            assert!(most < 1.001 * least || !is_even, "{least} … {most}");
        }
    }

    /// A photon that grazes the surface and not its bent normal carries on a bounded multiple of what it carried.
    #[test]
    fn no_photon_outgrows_others_without_bound_at_a_bent_normal() {
        for height in [1e-2, 1e-3, 1e-5, 1e-7] {
            let toward = Vec3::new(0.9, height, 0.0);
            let (flight, mut surface) = bent(Bsdf::Lambert { albedo: Rgb::splat(0.7) }, LEANING, toward);
            let drawn = flight.draw(&mut surface, [0.5; 3]).unwrap();
            let next = flight.scattered(&surface, &drawn).unwrap();
            let most = BENT_MAX * 0.7 * 1.001;
            assert!(next.weight.g > 0.9 * most && next.weight.g <= most, "{height}: {}", next.weight.g);
        }
    }
}
