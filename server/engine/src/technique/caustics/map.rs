//! The photons of one pass where they fell, each blurred over a disc of its own.
//!
//! A photon of flux Φ and radius r adds Φ · 2/(πr²) · (1 − d²/r²) to the irradiance at the distance d on a surface that faces
//! its way [Silverman1986, 4.2]: all of its flux, on a plane. Photons of about one radius lie in one grid.

use std::f32::consts::FRAC_2_PI;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::Sheet;
use crate::{
    math::{Rgb, octahedral},
    technique::{FACING_COS, FocusedLight, FocusedScatter},
    transport::Surface,
};

/// How many times distances along the normal count: what lies above or below is another sheet.
pub(super) const FLATNESS: f32 = 2.5;
/// Least cosine of the true normal over that of the shading normal: below, the few photons that still arrive would outshine
/// everything.
const COS_RATIO_MIN: f32 = 0.02;

/// A photon where it fell on a diffuse surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CausticPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// How far it is blurred, m.
    pub radius_m: f32,
    /// Flux, W.
    pub flux_w: Rgb,
    /// Where it came from, octahedral.
    pub direction: u32,
    /// Normal of the surface on the side it fell on, octahedral.
    pub normal: u32,
    /// What it fell on.
    pub sheet: Sheet,
    /// Scatterings before.
    pub scatterings: u16,
    /// The triangle it fell on faces the other way.
    pub is_on_back: bool,
}

/// The caustics of one pass.
#[derive(Debug)]
pub struct CausticMap {
    grids: Vec<Grid>,
}

/// Photons of about one radius, by the cell they lie in.
#[derive(Debug)]
struct Grid {
    /// The largest radius.
    radius_m: f32,
    min: Vec3,
    max: Vec3,
    /// Where the photons of a bucket begin; one more than there are buckets.
    starts: Vec<u32>,
    photons: Vec<CausticPhoton>,
}

impl CausticMap {
    /// Of photons whose radii are known; those without any are left out.
    pub(super) fn of(mut photons: Vec<CausticPhoton>) -> CausticMap {
        photons.retain(|photon| photon.radius_m > 0.0);
        let radius_max_m = photons.iter().fold(0.0, |most: f32, photon| most.max(photon.radius_m));
        let octave = |photon: &CausticPhoton| (radius_max_m / photon.radius_m).log2() as usize;
        let mut octaves: Vec<Vec<CausticPhoton>> = Vec::new();
        for photon in photons {
            let octave = octave(&photon);
            if octaves.len() <= octave {
                octaves.resize(octave + 1, Vec::new());
            }
            octaves[octave].push(photon);
        }
        octaves.retain(|photons| !photons.is_empty());
        CausticMap { grids: octaves.into_par_iter().map(Grid::of).collect() }
    }

    /// Memory of photons and grids.
    pub fn bytes(&self) -> usize {
        let of_grid = |grid: &Grid| grid.photons.len() * size_of::<CausticPhoton>() + grid.starts.len() * 4;
        self.grids.iter().map(of_grid).sum()
    }
}

impl Grid {
    fn of(photons: Vec<CausticPhoton>) -> Grid {
        let radius_m = photons.iter().fold(0.0, |radius: f32, photon| radius.max(photon.radius_m));
        let min = photons.iter().fold(Vec3::INFINITY, |min, photon| min.min(photon.position));
        let max = photons.iter().fold(Vec3::NEG_INFINITY, |max, photon| max.max(photon.position));
        let buckets = (2 * photons.len()).next_power_of_two();
        let mut grid = Grid {
            radius_m,
            min: min - radius_m,
            max: max + radius_m,
            starts: vec![0; buckets + 1],
            photons,
        };
        let bucket_of: Vec<u32> =
            grid.photons.iter().map(|photon| grid.bucket(Grid::parts(grid.cell(photon.position)))).collect();
        for bucket in &bucket_of {
            grid.starts[*bucket as usize + 1] += 1;
        }
        for bucket in 0..buckets {
            grid.starts[bucket + 1] += grid.starts[bucket];
        }
        let mut next = grid.starts.clone();
        let mut sorted = grid.photons.clone();
        for (photon, bucket) in grid.photons.iter().zip(bucket_of) {
            let place = &mut next[bucket as usize];
            sorted[*place as usize] = *photon;
            *place += 1;
        }
        grid.photons = sorted;
        grid
    }

    /// Cells are as wide as two radii: what is near lies in eight of them.
    fn cell(&self, p: Vec3) -> IVec3 {
        ((p - self.min) / (2.0 * self.radius_m)).floor().as_ivec3()
    }

    /// A number for a cell: parts for its three indices, so that those of neighbours are shared [Teschner2003].
    fn parts(cell: IVec3) -> [u32; 3] {
        let [x, y, z] = cell.to_array().map(|index| index as u32);
        [x.wrapping_mul(73_856_093), y.wrapping_mul(19_349_663), z.wrapping_mul(83_492_791)]
    }

    fn bucket(&self, [x, y, z]: [u32; 3]) -> u32 {
        (x ^ y ^ z) & (self.starts.len() as u32 - 2)
    }

    /// Calls `visit` with every photon that may reach `p`.
    fn near(&self, p: Vec3, mut visit: impl FnMut(&CausticPhoton)) {
        if p.cmplt(self.min).any() || p.cmpgt(self.max).any() {
            return;
        }
        let first = self.cell(p - self.radius_m);
        let [low, high] = [first, first + 1].map(Grid::parts);
        let mut seen = [u32::MAX; 8];
        for corner in 0..8 {
            let part = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
            let bucket = self.bucket([part(0), part(1), part(2)]);
            let [start, end] = [bucket, bucket + 1].map(|bucket| self.starts[bucket as usize] as usize);
            // Two cells may share a bucket.
            if start == end || seen[..corner].contains(&bucket) {
                continue;
            }
            seen[corner] = bucket;
            self.photons[start..end].iter().for_each(&mut visit);
        }
    }
}

impl FocusedLight for CausticMap {
    fn scattered(&self, surface: &Surface, wo: Vec3, scatterings_max: u32) -> FocusedScatter {
        let p = surface.point.position;
        let n_geo = surface.point.n_geo;
        let n = if wo.dot(n_geo) > 0.0 { n_geo } else { -n_geo };
        let wo_local = surface.frame.to_local(wo);
        let is_broad = surface.bsdf.has_broad_gloss();
        let mut sum = FocusedScatter::default();
        for grid in &self.grids {
            grid.near(p, |photon| {
                let away = p - photon.position;
                let r2 = photon.radius_m * photon.radius_m;
                if away.length_squared() >= r2 || u32::from(photon.scatterings) > scatterings_max {
                    return;
                }
                let normal = octahedral::decode(photon.normal);
                let above = away.dot(normal);
                let d2 = away.length_squared() + (FLATNESS * FLATNESS - 1.0) * above * above;
                if d2 >= r2 || normal.dot(n) < FACING_COS {
                    return;
                }
                let wi = octahedral::decode(photon.direction);
                let wi_local = surface.frame.to_local(wi);
                let value = surface.bsdf.eval(wo_local, wi_local);
                let per_m2 = FRAC_2_PI / r2 * (1.0 - d2 / r2);
                // Irradiance is flux on the surface as it is: the cosine of the shading normal comes for that of the true one.
                let cos = wi.dot(normal).max(COS_RATIO_MIN * wi_local.z.abs());
                if !(cos > 0.0) {
                    return;
                }
                let irradiance = photon.flux_w * (per_m2 / cos);
                sum.diffuse += value.diffuse.f_cos * irradiance;
                if is_broad {
                    sum.glossy += value.glossy.f_cos * irradiance;
                }
            });
        }
        sum
    }
}
