//! What photons of a gather bring to what faces its normal: looked up once, and weighed several at a time.

use std::sync::Arc;

use glam::Vec3;

use super::Near;
use crate::{
    math::{Rgb, octahedral},
    technique::products::{extent::Facets, map::SideMap},
};

/// Least mean cosine that light meets the surfaces of a gather with: what grazes more counts as if it grazed so much, and no photon
/// for more than twenty times its flux per area. Costs even light on a plane 0.25 % of its irradiance.
const COS_MIN: f32 = 0.05;

/// The surfaces of a gather, and the direction that its light is asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) facets: Facets,
    pub(super) normal: Vec3,
}

impl Seen {
    /// Irradiance of what faces the normal for each watt that falls on the surfaces from a unit direction, 1/m²: the flux over
    /// the area that the light sees of them is the irradiance of what faces the light.
    #[inline]
    fn irradiance_of(&self, direction: Vec3) -> f32 {
        let cos = self.normal.dot(direction).max(0.0);
        cos / (self.facets.area_m2 * self.facets.mean_cos(direction).max(COS_MIN))
    }
}

/// A photon where it fell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// Unit, to where it came from.
    pub(super) direction: Vec3,
    /// In W.
    pub(super) flux: Rgb,
    /// Of the flux, W.
    pub(super) luminance: f32,
}

/// Some photons; kept so that its memory is used again.
#[derive(Clone, Debug, Default)]
pub(super) struct Arrivals {
    /// `[n]`.
    photons: Vec<Arrival>,
    /// `[xyz][n]`: their directions, each component in a row, so that the compiler weighs four at a time.
    rows: [Vec<f32>; 3],
    /// `[count]` of those weighed last: irradiance for each watt, 1/m².
    per_watt: Vec<f32>,
}

impl Arrivals {
    /// Looks them up, in their order, in place of those before.
    ///
    /// - `maps`: `[side]`
    pub(super) fn take(&mut self, near: &[Near], maps: &[Option<Arc<SideMap>>]) {
        self.photons.clear();
        self.photons.reserve(near.len());
        for photon in near.iter().filter_map(|near| near.of(maps)) {
            let direction = octahedral::decode(photon.direction);
            self.photons.push(Arrival { direction, flux: photon.flux, luminance: photon.flux.luminance() });
        }
        debug_assert_eq!(self.photons.len(), near.len(), "of maps that the search did not know");
        for (axis, row) in self.rows.iter_mut().enumerate() {
            row.clear();
            row.extend(self.photons.iter().map(|arrival| arrival.direction[axis]));
        }
    }

    /// The first `count` of them, each with the irradiance that a watt of it brings to what is seen, 1/m².
    pub(super) fn weighed_by(&mut self, seen: &Seen, count: usize) -> impl Iterator<Item = (&Arrival, f32)> {
        let [x, y, z] = self.rows.each_ref().map(|row| &row[..count]);
        self.per_watt.clear();
        self.per_watt.resize(count, 0.0);
        for (((per_watt, x), y), z) in self.per_watt.iter_mut().zip(x).zip(y).zip(z) {
            *per_watt = seen.irradiance_of(Vec3::new(*x, *y, *z));
        }
        self.photons[..count].iter().zip(self.per_watt.iter().copied())
    }
}
