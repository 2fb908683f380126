//! Look-ups in the light octree: the groups around a point, and what a surface there sends to the eye of their lights;
//! `shaders/octree/look_up.wgsl` is its twin.

use glam::{IVec3, Vec3};

use super::{
    CARD, Harmonics, LeafSet, LightOctree, OctreeSettings, RADIUS_MAX_EVEN,
    drawing::{DrawnLight, direction_of, evenness_of},
    lights::{Irradiance, Lights, ShadedVdl, arriving_cos, blocks_of},
    voxels::across_m,
};
use crate::{
    math::Rgb,
    technique::{Card, Guide, LIKE_COS, LitFrom, PackedLight, ScatteredLight, SecondaryLight},
    transport::{CoatedBase, Surface},
};

/// The groups around a point that face like its surface, with their weights, which sum to 1 unless there is none.
#[derive(Clone, Copy, Debug)]
struct Around {
    sets: [(f32, usize); 8],
    count: usize,
    /// The largest side of the cell there over that of cells that are all as large.
    scale: f32,
}

impl Around {
    fn sets(&self) -> &[(f32, usize)] {
        &self.sets[..self.count]
    }
}

impl LightOctree {
    /// What lies nearer than this is lost where light is blurred so far, m. A coarse octree's blur is larger than what the photons
    /// will show in the end; to trace all that is lost in it would be path tracing.
    fn lost_m(&self, blur_m: f32, scale: f32) -> f32 {
        (LOST_BLURS * blur_m).min(self.lost_max_m() * scale)
    }

    /// [`LightOctree::lost_m`] at most where cells are all as large: half the radius at which the fewest photons of a gather lie in even
    /// light, m.
    pub(super) fn lost_max_m(&self) -> f32 {
        LOST_BLURS * self.radius_max_m / RADIUS_MAX_EVEN
    }

    /// Of the photons of a group's indirect light around its lights.
    pub(super) fn evenness_of(&self, set: usize) -> f32 {
        evenness_of(self.gathers[set].chord_rms[0], self.lights_of(set, 0).count)
    }

    /// Lights of a group by class, as shading asks for them.
    #[inline]
    pub(super) fn lights_of(&self, set: usize, class: usize) -> Lights<'_> {
        let set = &self.sets[set];
        let counts = [set.first_vdl[1] - set.first_vdl[0], set.end_vdl - set.first_vdl[1]];
        let first = set.first_block + if class == 0 { 0 } else { blocks_of(counts[0]) };
        let blocks = &self.shaded[first as usize..(first + blocks_of(counts[class])) as usize];
        Lights {
            blocks,
            count: counts[class] as usize,
            softness: set.softness[class],
            spread: set.spread[class],
        }
    }

    /// The groups around `p` that face like `n`.
    #[inline]
    fn around(&self, p: Vec3, n: Vec3) -> Around {
        let cube = &self.voxels.cube;
        let mut around = Around { sets: [(0.0, 0); 8], count: 0, scale: 1.0 };
        let mut per_sheet_m2 = self.per_sheet_m2;
        if cube.nested.is_some() {
            let scale = cube.scale_at(p);
            around.scale = scale.max_element();
            per_sheet_m2 /= across_m(scale, n).powi(2);
        }
        let cells = cube.cells() as i32;
        // Far outside is as good as outside.
        let at = (cube.place_of(p) - 0.5).clamp(Vec3::splat(-4.0), Vec3::splat(cells as f32 + 4.0));
        // Rounds down without the call that it is where the processor has no instruction for it.
        let cut = at.as_ivec3();
        let base = cut - IVec3::select(at.cmplt(cut.as_vec3()), IVec3::ONE, IVec3::ZERO);
        let fraction = at - base.as_vec3();
        let shares = [1.0 - fraction, fraction];
        let inside = |cell: IVec3| cell.clamp(IVec3::ZERO, IVec3::splat(cells - 1)).as_uvec3();
        let is_inside = base.cmpge(IVec3::ZERO).all() && base.cmplt(IVec3::splat(cells - 1)).all();
        let Some(place) = self.nodes.common(inside(base), inside(base + 1)) else { return around };
        // First where to look, then what is there: a look-up waits for memory, and so it waits for all at once.
        let mut leaves = [(0.0, 0); 8];
        let mut leaf_count = 0;
        for corner in 0..8 {
            let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let [x, y, z] = offset.to_array().map(|side| shares[side as usize]);
            let weight = x.x * y.y * z.z;
            let cell = base + offset;
            let is_out =
                || !is_inside && (cell.cmplt(IVec3::ZERO).any() || cell.cmpge(IVec3::splat(cells)).any());
            if weight <= 0.0 || is_out() {
                continue;
            }
            if let Some(leaf) = self.nodes.leaf(place, cell.as_uvec3()) {
                leaves[leaf_count] = (weight, leaf);
                leaf_count += 1;
            }
        }
        let mut total = 0.0;
        for &(weight, leaf) in &leaves[..leaf_count] {
            let Some((set, share)) = self.set_like(leaf, p, n, per_sheet_m2) else { continue };
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
    fn set_like(&self, leaf: usize, p: Vec3, n: Vec3, per_sheet_m2: f32) -> Option<(usize, f32)> {
        let range = self.voxels.places_of(leaf);
        let mut best = None;
        let mut best_score = f32::NEG_INFINITY;
        for (place, LeafSet { sheet, .. }) in range.clone().zip(&self.sets[range]) {
            let cos = sheet.dot(n.extend(0.0));
            if cos > LIKE_COS {
                let off_m = sheet.dot(p.extend(-1.0));
                let squared = off_m * off_m * per_sheet_m2;
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

    fn even_irradiance(&self, p: Vec3, n_geo: Vec3, n: Vec3) -> Option<Rgb> {
        let around = self.around(p, n_geo);
        if around.count == 0 || !self.harmonics.is_empty() {
            return None;
        }
        let mut irradiance = Irradiance::default();
        for (weight, place) in around.sets() {
            self.lights_of(*place, 0).add_irradiance(n, *weight, &mut irradiance);
        }
        Some(irradiance.total())
    }

    fn has_caustics(&self) -> bool {
        self.has_caustics
    }

    fn guide(&self) -> Option<&Guide> {
        self.photons.guide()
    }

    fn packed(&self) -> Option<PackedLight> {
        self.packed_light()
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        let n_geo = surface.point.n_geo;
        let n_facing = if wo.dot(n_geo) < 0.0 { -n_geo } else { n_geo };
        let n_shade = if wo.dot(surface.frame.n) < 0.0 { -surface.frame.n } else { surface.frame.n };
        let wo_local = surface.frame.to_local(wo);
        let shading = Shading { surface, wo_local, n_shade, base: surface.bsdf.coated_base(wo_local) };
        let around = self.around(surface.point.position, n_facing);
        let mut sums = [Rgb::BLACK; 2];
        let mut irradiance = [Irradiance::default(); 2];
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
            for class in 0..1 + usize::from(set.end_vdl > set.first_vdl[1]) {
                let lights = self.lights_of(place, class);
                match &shading.base {
                    Some(base) => lights.add_passing(base, n_shade, weight, &mut irradiance[class]),
                    None => sums[class] += shading.response(lights) * weight,
                }
            }
        }
        if let Some(base) = &shading.base {
            for (sum, irradiance) in sums.iter_mut().zip(irradiance) {
                *sum += base.scale * irradiance.total();
            }
        }
        let blur_m = if around.count > 0 { blur_m } else { self.radius_max_m * around.scale };
        let is_missing = around.count == 0 && !self.sets.is_empty();
        let from = draw.filter(|_| !is_alone).and_then(|draw| {
            self.drawn(&around, &shading, n_facing, self.lost_m(blur_m, around.scale), draw)
        });
        ScatteredLight { indirect: sums[0], caustic: sums[1], blur_m, from, is_missing }
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
            let lights = self.lights_of(place, 0);
            for (light, brightness) in lights.brightness(shading.n_shade).enumerate() {
                drawing.offer(brightness * weight, place, light);
            }
        }
        let drawn = drawing.drawn()?;
        let lights = self.lights_of(drawn.set, 0);
        let light = lights.get(drawn.light);
        let evenness = self.evenness_of(drawn.set);
        // Gone over again and again.
        let mut directions = [Vec3::ZERO; OctreeSettings::VDLS_MAX];
        directions.iter_mut().zip(lights.iter()).for_each(|(direction, vdl)| *direction = vdl.direction);
        let directions = directions[..lights.count].iter().copied();
        let direction = direction_of(directions, light.direction, evenness, n_facing, [u, v]);
        let cos = lights.softness.cos(shading.n_shade.dot(light.direction));
        let per_chance = (drawn.sum / (light.scaled.max_component() * cos)).min(PER_CHANCE_MAX);
        let share = shading.response_of(&light, &lights) * per_chance;
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
    /// Of lobes that are not asked light by light.
    base: Option<CoatedBase>,
}

impl Shading<'_> {
    /// What the diffuse lobe sends to the eye of light from all around: as if it came from the shading normal's side.
    fn response_to(&self, harmonics: &Harmonics) -> Rgb {
        let irradiance = harmonics.irradiance(self.n_shade);
        self.surface.bsdf.diffuse_of_even_light(self.wo_local) * irradiance
    }

    /// What the diffuse lobe sends to the eye of some lights. They are known by what they bring to their group's normal; a
    /// surface that leans towards a light more than the group gets more of it.
    fn response(&self, lights: Lights<'_>) -> Rgb {
        lights.iter().fold(Rgb::BLACK, |sum, vdl| sum + self.response_of(&vdl, &lights))
    }

    /// The same of one of them.
    fn response_of(&self, vdl: &ShadedVdl, Lights { softness, spread, .. }: &Lights<'_>) -> Rgb {
        let cos_light = self.n_shade.dot(vdl.direction);
        let cos = softness.cos(cos_light);
        if let Some(base) = &self.base {
            let passing = base.passing_around(arriving_cos(cos_light, cos), spread.get());
            return base.scale * vdl.scaled * (cos * passing);
        }
        if !(cos > 0.0) {
            return Rgb::BLACK;
        }
        // See `arriving_cos`.
        let wi = self.surface.frame.to_local(vdl.direction);
        let wi = wi.truncate().extend(cos.copysign(self.wo_local.z)).normalize();
        let f_cos = self.surface.bsdf.eval_diffuse(self.wo_local, wi).f_cos;
        f_cos * vdl.scaled * (cos / wi.z.abs())
    }
}
