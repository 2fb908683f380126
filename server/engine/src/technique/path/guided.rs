//! Scattering where photons say where light comes from.
//!
//! **Unbiased** whatever they say. A diffuse lobe that is taken with the chance c, and drawn by the cosine with c · cos θ / π, is drawn with
//! c · ((1 − s) cos θ / π + s g) where a share s of its directions is drawn by photons with the density g, above the surface's horizon or
//! not; light sampling competes with the same density. Other lobes are drawn as without. The variance is bounded by 1 / (1 − s) of that without
//! at one scattering, not at many in a row that photons mislead.

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
    let [lobe, which, across] = u;
    let Some(guidance) = guidance else { return Some((surface.bsdf.sample(wo, u)?, 1.0)) };
    let is_guided = which < GUIDED_SHARE;
    // As even as the whole, whichever it is.
    let along = if is_guided { which / GUIDED_SHARE } else { (which - GUIDED_SHARE) / (1.0 - GUIDED_SHARE) };
    let drawn = surface.bsdf.sample(wo, [lobe, along, across])?;
    let cosine_pdf = drawn.pdf_solid_angle.filter(|_| drawn.scatter == Scatter::Diffuse);
    let Some(cosine_pdf) = cosine_pdf else { return Some((drawn, 1.0)) };
    if !is_guided {
        let ratio = guidance.ratio(surface.frame.to_world(drawn.wi), drawn.wi.z.abs());
        let (weight, pdf) = (drawn.weight * (1.0 / ratio), cosine_pdf * ratio);
        return Some((BsdfSample { weight, pdf_solid_angle: Some(pdf), ..drawn }, ratio));
    }
    let wi = surface.frame.to_local(guidance.draw(Vec2::new(along, across)));
    // Below the horizon nothing goes on.
    let value = surface.bsdf.eval_diffuse(wo, wi);
    if value.f_cos.is_black() {
        return None;
    }
    let ratio = guidance.ratio(surface.frame.to_world(wi), wi.z.abs());
    let pdf = value.pdf_solid_angle * ratio;
    let weight = value.f_cos * (1.0 / pdf);
    Some((BsdfSample { wi, weight, pdf_solid_angle: Some(pdf), ..drawn }, ratio))
}
