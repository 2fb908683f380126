//! Scattering where photons say where light comes from.

use glam::{Vec2, Vec3};

use crate::{
    technique::{GUIDED_SHARE, Guidance},
    transport::{BsdfSample, Scatter, Surface},
};

/// A direction that the path goes on in, and its density over that without guidance.
///
/// - `wo`: to where the path came from, in the surface's frame
/// - `u`: lobe, two for the direction; see [`crate::transport::Bsdf::sample`]
/// - returns `None` where the light is absorbed
pub(super) fn sample(
    surface: &Surface,
    guidance: Option<&Guidance<'_>>,
    wo: Vec3,
    u: [f32; 3],
) -> Option<(BsdfSample, f32)> {
    let drawn = surface.bsdf.sample(wo, u)?;
    let Some(guidance) = guidance.filter(|_| drawn.scatter == Scatter::Diffuse) else {
        return Some((drawn, 1.0));
    };
    let [lobe, which, across] = u;
    let wi = if which < GUIDED_SHARE {
        surface.frame.to_local(guidance.draw(Vec2::new(which / GUIDED_SHARE, across)))
    } else {
        // The same lobe: that is chosen by the first number alone.
        surface.bsdf.sample(wo, [lobe, (which - GUIDED_SHARE) / (1.0 - GUIDED_SHARE), across])?.wi
    };
    // Of directions below the horizon nothing goes on.
    let value = surface.bsdf.eval(wo, wi).diffuse;
    if value.f_cos.is_black() {
        return None;
    }
    let ratio = guidance.ratio(surface.frame.to_world(wi), wi.z.abs());
    let pdf = value.pdf_solid_angle * ratio;
    let weight = value.f_cos * (1.0 / pdf);
    Some((BsdfSample { wi, weight, pdf_solid_angle: Some(pdf), ..drawn }, ratio))
}
