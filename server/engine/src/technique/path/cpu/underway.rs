//! Paths that were begun elsewhere, by a card, and go on here.

use glam::Vec3;

use super::{LastVertex, Path, Sightline, Tracer};
use crate::{
    accel::Ray,
    film::PixelSample,
    math::{Rgb, sobol::PixelSampler},
    technique::path::Tally,
    transport::{Absorption, Passed, PathClass},
};

/// A path on its way from a surface: what it carries to the next. The fields are those of the path as the tracer has it.
#[derive(Clone, Copy, Debug)]
pub(in crate::technique::path) struct Underway {
    pub(in crate::technique::path) ray: Ray,
    pub(in crate::technique::path) throughput: Rgb,
    pub(in crate::technique::path) class: PathClass,
    /// Scatterings before.
    pub(in crate::technique::path) bounce: u32,
    pub(in crate::technique::path) eta_squared: f32,
    /// Position and normal where it was scattered last, and the density of its direction; `None`: light sampling does not compete with it.
    pub(in crate::technique::path) last: Option<(Vec3, Vec3, f32)>,
    pub(in crate::technique::path) medium: Option<Absorption>,
    pub(in crate::technique::path) lost_m: f32,
    pub(in crate::technique::path) is_near: bool,
    pub(in crate::technique::path) near_count: u32,
    pub(in crate::technique::path) is_by_mirrors: bool,
    pub(in crate::technique::path) since_gathered: u32,
    pub(in crate::technique::path) sightline: Sightline,
    /// Whose numbers it goes on by.
    pub(in crate::technique::path) sampler: PixelSampler,
}

impl Tracer<'_> {
    /// What a path brings from its next surface on: light, also of classes that are not shown, and what is seen by way of mirrors and
    /// glass if that is found there. Nothing of the first hit.
    ///
    /// The tracer is to do as whoever began the path: where that had no guide and knew no openings, it has none either, since what is seen
    /// at the next surface is weighed by what its last one could have sampled.
    pub(in crate::technique::path) fn follow(
        &self,
        underway: &Underway,
        tally: &mut impl Tally,
    ) -> PixelSample {
        let last = underway.last.map(|(position, n, pdf_solid_angle)| LastVertex {
            position,
            n,
            way: underway.ray.direction,
            pdf_solid_angle,
            passed: Passed::nothing(underway.ray.direction),
        });
        let mut path = Path {
            ray: underway.ray,
            throughput: underway.throughput,
            class: underway.class,
            bounce: underway.bounce,
            eta_squared: underway.eta_squared,
            guided: 1.0,
            last,
            medium: underway.medium,
            lost_m: underway.lost_m,
            is_near: underway.is_near,
            near_count: underway.near_count,
            is_by_mirrors: underway.is_by_mirrors,
            since_gathered: underway.since_gathered,
            sightline: underway.sightline,
            seen: None,
            sampler: &underway.sampler,
        };
        let mut sample = PixelSample::BLACK;
        while let Some(met) = self.goes_to(&path, tally) {
            if !self.advance(&mut path, met, &mut sample, tally) {
                break;
            }
        }
        sample
    }
}
