//! The photons of one pass where they fell, each blurred over a disc of its own.
//!
//! A photon of flux Φ and radius r adds Φ · 2/(πr²) · (1 − d²/r²) to the irradiance at the distance d on a surface that faces
//! its way [Silverman1986, 4.2]: all of its flux, on a plane. Photons of about one radius lie in one grid, in every cell that
//! their blurs reach: a look-up asks one cell of each. What a surface sends on of a photon (`Lit`) is the same on the screen.

use std::f32::consts::{FRAC_1_PI, FRAC_2_PI};

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::{CausticLight, Sheet};
use crate::{
    math::Rgb,
    technique::{FocusedLight, FocusedScatter, LeftToSampling, PackedFocused},
    transport::{Bsdf, Surface},
};

/// How many times distances along the normal count: what lies above or below is another sheet.
pub(super) const FLATNESS: f32 = 2.5;
/// Cosine of the angle within which what a photon fell on and what is shown face one way: what faces another way gets other light.
pub(super) const FACING_COS: f32 = 0.5;
/// Least cosine of the true normal over that of the shading normal: below, the few photons that still arrive would outshine
/// everything.
pub(super) const COS_RATIO_MIN: f32 = 0.02;

/// A photon where it fell on a diffuse surface or a broad gloss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CausticPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// How far it is blurred, m.
    pub radius_m: f32,
    /// Flux, W.
    pub flux_w: Rgb,
    /// Where it came from.
    pub direction: Vec3,
    /// Normal of the surface on the side it fell on.
    pub normal: Vec3,
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
    pub(super) grids: Vec<Grid>,
    /// Of what photons there may be.
    light: CausticLight,
}

/// Photons of about one radius, by the cells that their blurs reach.
#[derive(Debug)]
pub(super) struct Grid {
    /// Width of a cell: the largest radius.
    pub(super) cell_m: f32,
    /// Where blurs reach.
    pub(super) min: Vec3,
    pub(super) max: Vec3,
    /// Where the entries of a bucket begin; one more than there are buckets.
    pub(super) starts: Vec<u32>,
    /// Numbers of photons, each once in every bucket of a cell that its blur reaches.
    pub(super) entries: Vec<u32>,
    /// Place and squared radius of every photon, which is all that most are asked for.
    places: Vec<[f32; 4]>,
    pub(super) photons: Vec<CausticPhoton>,
}

impl CausticMap {
    /// Of photons whose radii are known; those without any are left out.
    pub(super) fn of(mut photons: Vec<CausticPhoton>, light: CausticLight) -> CausticMap {
        photons.retain(|photon| photon.radius_m > 0.0);
        CausticMap { grids: grids_of(photons), light }
    }

    /// Memory of photons and grids.
    pub fn bytes(&self) -> usize {
        let of_grid = |grid: &Grid| {
            let of_photon = size_of::<CausticPhoton>() + size_of::<[f32; 4]>();
            grid.photons.len() * of_photon + (grid.starts.len() + grid.entries.len()) * size_of::<u32>()
        };
        self.grids.iter().map(of_grid).sum()
    }
}

/// Each of photons of about one radius.
fn grids_of(photons: Vec<CausticPhoton>) -> Vec<Grid> {
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
    octaves.into_par_iter().map(Grid::of).collect()
}

impl Grid {
    fn of(mut photons: Vec<CausticPhoton>) -> Grid {
        let cell_m = photons.iter().fold(0.0, |radius: f32, photon| radius.max(photon.radius_m));
        let min = photons.iter().fold(Vec3::INFINITY, |min, photon| min.min(photon.position)) - cell_m;
        let max = photons.iter().fold(Vec3::NEG_INFINITY, |max, photon| max.max(photon.position)) + cell_m;
        let count = (2 * photons.len()).next_power_of_two();
        let mut grid = Grid {
            cell_m,
            min,
            max,
            starts: vec![0; count + 1],
            entries: vec![],
            places: vec![],
            photons: vec![],
        };
        // Photons of one cell lie together: they are asked for together.
        photons.sort_by_cached_key(|photon| grid.bucket(grid.cell(photon.position)));
        for photon in &photons {
            let reached = grid.reached_by(photon);
            reached.iter().for_each(|bucket| grid.starts[bucket + 1] += 1);
        }
        for bucket in 0..count {
            grid.starts[bucket + 1] += grid.starts[bucket];
        }
        let mut next = grid.starts.clone();
        grid.entries = vec![0; next[count] as usize];
        for (number, photon) in photons.iter().enumerate() {
            for bucket in grid.reached_by(photon).iter() {
                grid.entries[next[bucket] as usize] = number as u32;
                next[bucket] += 1;
            }
        }
        let place_of = |photon: &CausticPhoton| {
            let [x, y, z] = photon.position.to_array();
            [x, y, z, photon.radius_m * photon.radius_m]
        };
        grid.places = photons.iter().map(place_of).collect();
        grid.photons = photons;
        grid
    }

    fn cell(&self, p: Vec3) -> IVec3 {
        ((p - self.min) / self.cell_m).floor().as_ivec3()
    }

    /// [Teschner2003]
    fn bucket(&self, cell: IVec3) -> u32 {
        let [x, y, z] = cell.to_array().map(|index| index as u32);
        let hash = x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
        hash & (self.starts.len() as u32 - 2)
    }

    /// The buckets of all cells that a blur reaches, each once.
    fn reached_by(&self, photon: &CausticPhoton) -> Buckets {
        let normal = photon.normal;
        // Of the flat spheroid that a blur is.
        let flat = 1.0 - 1.0 / (FLATNESS * FLATNESS);
        let along = |n: f32| photon.radius_m * (1.0 - n * n * flat).max(0.0).sqrt();
        let extent = Vec3::new(along(normal.x), along(normal.y), along(normal.z));
        let [low, high] = [photon.position - extent, photon.position + extent].map(|p| self.cell(p));
        // No more for rounding: two radii lie in three cells of one.
        let high = high.min(low.saturating_add(IVec3::splat(2)));
        let mut buckets = Buckets::default();
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    buckets.add(self.bucket(IVec3::new(x, y, z)));
                }
            }
        }
        buckets
    }

    /// Calls `visit` with every photon that reaches `p`, were its blur a ball.
    fn near(&self, p: Vec3, mut visit: impl FnMut(&CausticPhoton)) {
        if p.cmplt(self.min).any() || p.cmpgt(self.max).any() {
            return;
        }
        let bucket = self.bucket(self.cell(p)) as usize;
        for entry in &self.entries[self.starts[bucket] as usize..self.starts[bucket + 1] as usize] {
            let [x, y, z, r2] = self.places[*entry as usize];
            if (p - Vec3::new(x, y, z)).length_squared() < r2 {
                visit(&self.photons[*entry as usize]);
            }
        }
    }
}

/// Some buckets, each once: of as many cells as a blur can reach.
#[derive(Clone, Copy, Default)]
struct Buckets {
    count: usize,
    buckets: [u32; 27],
}

impl Buckets {
    fn add(&mut self, bucket: u32) {
        if !self.buckets[..self.count].contains(&bucket) {
            self.buckets[self.count] = bucket;
            self.count += 1;
        }
    }

    fn iter(&self) -> impl Iterator<Item = usize> {
        self.buckets[..self.count].iter().map(|bucket| *bucket as usize)
    }
}

impl FocusedLight for CausticMap {
    fn scattered(&self, surface: &Surface, wo: Vec3, scatterings_max: u32) -> FocusedScatter {
        let mut lit = Lit::new(surface, wo, scatterings_max);
        let p = surface.point.position;
        for grid in &self.grids {
            grid.near(p, |photon| {
                let away = p - photon.position;
                let r2 = photon.radius_m * photon.radius_m;
                let above = away.dot(photon.normal);
                let d2 = away.length_squared() + (FLATNESS * FLATNESS - 1.0) * above * above;
                if d2 < r2 {
                    lit.add(photon, FRAC_2_PI / r2 * (1.0 - d2 / r2));
                }
            });
        }
        lit.scatter()
    }

    fn leaves(&self) -> LeftToSampling {
        self.light.left()
    }

    fn packed(&self) -> Option<PackedFocused> {
        Some(PackedFocused::Grids(self.pack_photons()))
    }
}

/// What a surface sends to the eye of the photons that light it.
pub(super) struct Lit<'a> {
    surface: &'a Surface,
    wo_local: Vec3,
    /// True normal on the side of the eye.
    n: Vec3,
    scatterings_max: u32,
    is_broad: bool,
    /// What most surfaces are: the same for light from everywhere.
    lambert: Option<Rgb>,
    on_lambert: Rgb,
    sum: FocusedScatter,
}

impl<'a> Lit<'a> {
    /// - `scatterings_max`: most scatterings before, of photons that count
    pub(super) fn new(surface: &'a Surface, wo: Vec3, scatterings_max: u32) -> Lit<'a> {
        let n_geo = surface.point.n_geo;
        Lit {
            surface,
            wo_local: surface.frame.to_local(wo),
            n: if wo.dot(n_geo) > 0.0 { n_geo } else { -n_geo },
            scatterings_max,
            is_broad: surface.bsdf.has_broad_gloss(),
            lambert: match surface.bsdf {
                Bsdf::Lambert { albedo } => Some(albedo * FRAC_1_PI),
                _ => None,
            },
            on_lambert: Rgb::BLACK,
            sum: FocusedScatter::default(),
        }
    }

    /// Adds a photon if it fell on a surface that faces the same way.
    ///
    /// - `per_m2`: the share of its flux that falls on every square metre there
    pub(super) fn add(&mut self, photon: &CausticPhoton, per_m2: f32) {
        let normal = photon.normal;
        if u32::from(photon.scatterings) > self.scatterings_max || normal.dot(self.n) < FACING_COS {
            return;
        }
        let wi = photon.direction;
        // Irradiance is flux on the surface as it is: the cosine of the shading normal comes for that of the true one.
        let shading_cos = wi.dot(self.surface.frame.n);
        let cos = wi.dot(normal).max(COS_RATIO_MIN * shading_cos.abs());
        if !(cos > 0.0) {
            return;
        }
        let irradiance = photon.flux_w * (per_m2 / cos);
        if self.lambert.is_some() {
            if shading_cos * self.wo_local.z > 0.0 {
                self.on_lambert += irradiance * shading_cos.abs();
            }
            return;
        }
        let wi_local = self.surface.frame.to_local(wi);
        if !self.is_broad {
            self.sum.diffuse += self.surface.bsdf.eval_diffuse(self.wo_local, wi_local).f_cos * irradiance;
            return;
        }
        let value = self.surface.bsdf.eval(self.wo_local, wi_local);
        self.sum.diffuse += value.diffuse.f_cos * irradiance;
        self.sum.glossy += value.glossy.f_cos * irradiance;
    }

    /// What all of them make.
    pub(super) fn scatter(mut self) -> FocusedScatter {
        if let Some(per_irradiance) = self.lambert {
            self.sum.diffuse = per_irradiance * self.on_lambert;
        }
        self.sum
    }
}
