//! Look-ups in the light octree: the groups around a point, and what a surface there sends to the eye of their lights;
//! `shaders/octree/look_up.wgsl` is its twin.

use std::f32::consts::FRAC_1_PI;

use glam::{IVec3, Vec3};

use super::{
    CARD, Harmonics, LeafSet, LightOctree, PackedVdl, RADIUS_MAX_EVEN, Vdl,
    drawing::{DrawnLight, direction_of, evenness_of},
};
use crate::{
    math::Rgb,
    technique::{Card, LIKE_COS, LitFrom, PackedLight, ScatteredLight, SecondaryLight},
    transport::{Bsdf, Surface},
};

/// A light made ready for shading.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShadedVdl {
    pub(super) direction: Vec3,
    /// Irradiance over the softened cosine with its group: see [`Softness`].
    pub(super) scaled: Rgb,
}

impl ShadedVdl {
    pub(super) fn of(vdl: &Vdl, n_set: Vec3, softness: Softness) -> ShadedVdl {
        // Photons are counted on surfaces that lean to either side of the group's normal.
        let cos = softness.cos(n_set.dot(vdl.direction)).max(GRAZING);
        // As a card unpacks it: a light drawn of thirty by their weights would else often be another one there.
        let scaled = Vdl { direction: vdl.direction, irradiance: vdl.irradiance * (1.0 / cos) };
        let Vdl { direction, irradiance } = PackedVdl::pack(&scaled).unpack();
        ShadedVdl { direction, scaled: irradiance }
    }
}

/// How gently the cosine with a light ends below the horizon: a light stands for photons from around its direction, some of
/// which still reach a surface that has turned away from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Softness {
    pub(super) reach: f32,
}

impl Softness {
    /// Where photons lie `chord_rms` around their light: with a deviation of σ = chord / √2 to either side, a normal
    /// distribution has a mean cosine of σ / √(2π) at the horizon, and next to none 1.6 σ below it.
    pub(super) fn of(chord_rms: f32) -> Softness {
        let reach = 2.0 * chord_rms / std::f32::consts::PI.sqrt();
        Softness { reach: reach.clamp(SOFTNESS_MIN, 1.0) }
    }

    /// The mean of max(cos, 0) over the light's photons, about.
    #[inline]
    fn cos(self, cos: f32) -> f32 {
        let above = (cos + self.reach).max(0.0);
        if cos > self.reach { cos } else { above * above * (0.25 / self.reach) }
    }
}

/// Softens lights of a single direction.
const SOFTNESS_MIN: f32 = 4.0 * GRAZING;
/// Least soft cosine of a light with its group: that on the horizon.
const GRAZING: f32 = 0.1;

/// The groups around a point that face like its surface, with their weights, which sum to 1 unless there is none.
#[derive(Clone, Copy, Debug)]
struct Around {
    sets: [(f32, usize); 8],
    count: usize,
}

impl Around {
    fn sets(&self) -> &[(f32, usize)] {
        &self.sets[..self.count]
    }
}

impl LightOctree {
    /// What lies nearer than this is lost where light is blurred so far, m. A coarse octree's blur is larger than what the photons
    /// will show in the end; to trace all that is lost in it would be path tracing.
    fn lost_m(&self, blur_m: f32) -> f32 {
        (LOST_BLURS * blur_m).min(self.lost_max_m())
    }

    /// [`LightOctree::lost_m`] at most: half the radius at which the fewest photons of a gather lie in even light, m.
    pub(super) fn lost_max_m(&self) -> f32 {
        LOST_BLURS * self.radius_max_m / RADIUS_MAX_EVEN
    }

    /// Of the photons of a group's indirect light around its lights.
    pub(super) fn evenness_of(&self, set: usize) -> f32 {
        evenness_of(self.gathers[set].chord_rms[0], self.lights_of(&self.sets[set]).len())
    }

    /// Lights of indirect light as shading asks for them.
    fn lights_of(&self, set: &LeafSet) -> &[ShadedVdl] {
        &self.shaded[set.first_vdl[0] as usize..set.first_vdl[1] as usize]
    }

    /// The groups around `p` that face like `n`.
    #[inline]
    fn around(&self, p: Vec3, n: Vec3) -> Around {
        let mut around = Around { sets: [(0.0, 0); 8], count: 0 };
        let cube = &self.voxels.cube;
        let cells = cube.cells() as i32;
        // Far outside is as good as outside.
        let at =
            ((p - cube.low) / cube.cell_m() - 0.5).clamp(Vec3::splat(-4.0), Vec3::splat(cells as f32 + 4.0));
        let base = at.floor();
        let fraction = at - base;
        let base = base.as_ivec3();
        let inside = |cell: IVec3| cell.clamp(IVec3::ZERO, IVec3::splat(cells - 1)).as_uvec3();
        let Some(place) = self.nodes.common(inside(base), inside(base + 1)) else { return around };
        let mut total = 0.0;
        for corner in 0..8 {
            let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let share = Vec3::select(offset.cmpeq(IVec3::ONE), fraction, 1.0 - fraction);
            let weight = share.x * share.y * share.z;
            let cell = base + offset;
            if weight <= 0.0 || cell.cmplt(IVec3::ZERO).any() || cell.cmpge(IVec3::splat(cells)).any() {
                continue;
            }
            let Some(leaf) = self.nodes.leaf(place, cell.as_uvec3()) else { continue };
            let Some((set, share)) = self.set_like(leaf, p, n) else { continue };
            // Of a group whose light is kept off by a wall only where there is no other.
            let weight = weight * share * self.sets[set].wall.share_at(p);
            around.sets[around.count] = (weight, set);
            around.count += 1;
            total += weight;
        }
        if total > 0.0 {
            let scale = 1.0 / total;
            around.sets[..around.count].iter_mut().for_each(|(weight, _)| *weight *= scale);
        } else {
            around.count = 0;
        }
        around
    }

    /// The group of a cell that faces most like `n` and whose plane is nearest to `p`, if any faces about like it, and how
    /// much it is to count, in (0, 1].
    #[inline]
    fn set_like(&self, leaf: usize, p: Vec3, n: Vec3) -> Option<(usize, f32)> {
        let range = self.voxels.places_of(leaf);
        let mut best = None;
        let mut best_score = f32::NEG_INFINITY;
        for (place, set) in range.clone().zip(&self.sets[range]) {
            let cos = set.normal.dot(n);
            if cos > LIKE_COS {
                let off_m = set.normal.dot(p) - set.plane_m;
                let squared = off_m * off_m * self.per_sheet_m2;
                if cos - squared > best_score {
                    best_score = cos - squared;
                    best = Some((place, squared));
                }
            }
        }
        best.map(|(place, squared)| (place, 1.0 / (1.0 + squared * squared)))
    }

    /// Irradiance by class, in the order of [`super::MAPPED`], at `p`, W/m²: of the groups there that face like `n`, along their own
    /// normals.
    pub fn irradiance(&self, p: Vec3, n: Vec3) -> [Rgb; 2] {
        let mut irradiance = [Rgb::BLACK; 2];
        for (weight, set) in self.around(p, n).sets() {
            for (class, sum) in irradiance.iter_mut().enumerate() {
                for vdl in self.vdls_of(&self.sets[*set], class) {
                    *sum += vdl.irradiance * *weight;
                }
            }
        }
        irradiance
    }
}

impl SecondaryLight for LightOctree {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn has_caustics(&self) -> bool {
        self.has_caustics
    }

    fn packed(&self) -> Option<PackedLight> {
        self.packed_light()
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        let n_geo = surface.point.n_geo;
        let n_facing = if wo.dot(n_geo) < 0.0 { -n_geo } else { n_geo };
        let n_shade = if wo.dot(surface.frame.n) < 0.0 { -surface.frame.n } else { surface.frame.n };
        let shading = Shading { surface, wo_local: surface.frame.to_local(wo), n_shade };
        let around = self.around(surface.point.position, n_facing);
        let mut sums = [Rgb::BLACK; 2];
        let mut blur_m = 0.0;
        let mut is_alone = true;
        for &(weight, place) in around.sets() {
            let set = &self.sets[place];
            blur_m += set.blur_m * weight;
            if let Some(of_class) = self.harmonics.get(place) {
                for (sum, harmonics) in sums.iter_mut().zip(of_class) {
                    *sum += shading.response_to(harmonics) * weight;
                }
                continue;
            }
            is_alone &= set.is_alone;
            sums[0] += shading.response(self.lights_of(set), set.softness[0]) * weight;
            let caustic = &self.shaded[set.first_vdl[1] as usize..set.end_vdl as usize];
            if !caustic.is_empty() {
                sums[1] += shading.response(caustic, set.softness[1]) * weight;
            }
        }
        let blur_m = if around.count > 0 { blur_m } else { self.radius_max_m };
        let from = draw
            .filter(|_| !is_alone)
            .and_then(|draw| self.drawn(&around, &shading, n_facing, self.lost_m(blur_m), draw));
        ScatteredLight { indirect: sums[0], caustic: sums[1], blur_m, from }
    }
}

impl LightOctree {
    /// Where some of the light of the groups around comes from.
    fn drawn(
        &self,
        around: &Around,
        shading: &Shading<'_>,
        n_facing: Vec3,
        lost_m: f32,
        [choice, u, v]: [f32; 3],
    ) -> Option<LitFrom> {
        let mut drawing = DrawnLight::new(choice);
        for &(weight, place) in around.sets() {
            let set = &self.sets[place];
            for (light, vdl) in self.lights_of(set).iter().enumerate() {
                let cos = set.softness[0].cos(shading.n_shade.dot(vdl.direction));
                drawing.offer(vdl.scaled.max_component() * cos * weight, place, light);
            }
        }
        let drawn = drawing.drawn()?;
        let set = &self.sets[drawn.set];
        let lights = self.lights_of(set);
        let light = lights[drawn.light];
        let evenness = self.evenness_of(drawn.set);
        let directions = lights.iter().map(|vdl| vdl.direction);
        let direction = direction_of(directions, light.direction, evenness, n_facing, [u, v]);
        let cos = set.softness[0].cos(shading.n_shade.dot(light.direction));
        let per_chance = (drawn.sum / (light.scaled.max_component() * cos)).min(PER_CHANCE_MAX);
        let share = shading.response(&[light], set.softness[0]) * per_chance;
        Some(LitFrom { direction, share, lost_m })
    }
}

/// What lies nearer than so many blurs is lost in them. With directions close around their lights, Sponza's nave was 8.4, 8.1 and
/// 8.1 % systematic with 0.35, 0.5 and 0.7, its gallery 13.9, 12.9 and 12.2; but there is more noise the farther one looks.
pub(super) const LOST_BLURS: f32 = 0.5;
/// Keeps what is drawn with next to no chance finite.
pub(super) const PER_CHANCE_MAX: f32 = 1e30;

/// A surface and the eye.
struct Shading<'a> {
    surface: &'a Surface,
    wo_local: Vec3,
    n_shade: Vec3,
}

impl Shading<'_> {
    /// What the diffuse lobe sends to the eye of light from all around: as if it came from the shading normal's side.
    fn response_to(&self, harmonics: &Harmonics) -> Rgb {
        let irradiance = harmonics.irradiance(self.n_shade);
        self.surface.bsdf.diffuse_of_even_light(self.wo_local) * irradiance
    }

    /// What the diffuse lobe sends to the eye of some lights. They are known by what they bring to their group's normal; a
    /// surface that leans towards a light more than the group gets more of it.
    #[inline]
    fn response(&self, vdls: &[ShadedVdl], softness: Softness) -> Rgb {
        match &self.surface.bsdf {
            Bsdf::Lambert { albedo } => {
                let mut sum = Rgb::BLACK;
                for vdl in vdls {
                    sum += vdl.scaled * softness.cos(self.n_shade.dot(vdl.direction));
                }
                *albedo * sum * FRAC_1_PI
            }
            bsdf => {
                let mut sum = Rgb::BLACK;
                for vdl in vdls {
                    let cos = softness.cos(self.n_shade.dot(vdl.direction));
                    if !(cos > 0.0) {
                        continue;
                    }
                    // From where the light's photons that do arrive come on average: never below the horizon.
                    let wi = self.surface.frame.to_local(vdl.direction);
                    let wi = wi.truncate().extend(cos.copysign(self.wo_local.z)).normalize();
                    let f_cos = bsdf.eval(self.wo_local, wi).diffuse.f_cos;
                    sum += f_cos * vdl.scaled * (cos / wi.z.abs());
                }
                sum
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// The soft cosine is what photons spread around a light send to a surface on average, wherever the surface turns.
    #[test]
    fn softness_is_the_mean_over_a_lights_photons() {
        for sigma in [0.25f32, 0.4, 0.6] {
            let photons: Vec<Vec3> = (0..4096)
                .map(|index| {
                    let [u, v, ..] = point(7, index);
                    // Normal deviates by Box and Muller.
                    let (r, turn) = ((-2.0 * (1.0 - u).ln()).sqrt() * sigma, std::f32::consts::TAU * v);
                    Vec3::new(r * turn.cos(), r * turn.sin(), 1.0).normalize()
                })
                .collect();
            let squared = photons.iter().map(|photon| (*photon - Vec3::Z).length_squared()).sum::<f32>();
            let softness = Softness::of((squared / 4096.0).sqrt());
            // Wide lights are shortened by their spread, which stands in the light's flux already.
            let shortened = photons.iter().map(|photon| photon.z).sum::<f32>() / 4096.0;
            for degrees in (0..=180).step_by(10) {
                let angle = (degrees as f32).to_radians();
                let n = Vec3::new(angle.sin(), 0.0, angle.cos());
                let mean = photons.iter().map(|photon| photon.dot(n).max(0.0)).sum::<f32>() / 4096.0;
                let soft = softness.cos(n.z);
                let expected = soft * shortened;
                assert!((expected - mean).abs() < 0.035, "σ {sigma}, {degrees}°: {expected} for {mean}");
            }
            assert!(softness.cos(0.0) > 0.0 && softness.cos(-1.0) == 0.0);
        }
    }
}
