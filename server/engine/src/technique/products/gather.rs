//! What is read from photon maps: the photons around a point, with their shares of the irradiance there.
//!
//! Density estimate E = Σ Φⱼ cos⁺(ωⱼ, n) / Σᵢ Aᵢ cos⁺(ωⱼ, nᵢ) over the photons within the distance r of the k-th nearest,
//! where the sum over i is of their own surfaces within that distance, Φⱼ over the area that the light of photon j saw. On a
//! flat surface, for what does not graze it, this is Σ Φⱼ / A [Jensen1996; Larsen2004, 8.1], exact at borders and in corners, where a disc πr² would hang
//! off the surface; on a column, whose sides get light from different directions, each shows the light it faces, not the mean
//! of all. Distances along the normal count more, so that the sphere is a flat ellipsoid. The k-th photon
//! defines r and does not count itself, which makes the estimate unbiased for even light. **Biased**: blurs over r.
//! Consistent as photons grow and r shrinks.
//!
//! Where light changes within r, r is narrowed [Lepski1991]: estimates over a third of the photons, a ninth and so on blur
//! less and are noisier by a known amount, and the widest counts that agrees with all narrower ones within their noise. That
//! keeps the spot of light beside a dark wall off the wall, where few photons would draw the radius into the spot. Nothing counts
//! beyond walls that the caller names (`walls.rs`).

mod arrivals;
#[cfg(feature = "gpu")]
mod found;

use std::{num::NonZeroUsize, sync::Arc};

use glam::Vec3;
use kiddo::SquaredEuclidean;

use self::arrivals::{Arrivals, Seen};
#[cfg(feature = "gpu")]
pub(in crate::technique) use self::found::{COUNTS, FAR_M, NEAR_M, NUMBERS};
#[cfg(feature = "gpu")]
pub use self::found::{FoundPhotons, OtherMaps};
use super::{
    extent::Facets,
    map::{MAPPED, MapPhoton, PhotonMaps, SideMap},
    surfaces::SideId,
    walls::Walls,
};
use crate::{
    math::{Rgb, octahedral},
    transport::PathClass,
};

/// A photon as a gather sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatheredPhoton {
    /// Unit direction to where it came from.
    pub direction: Vec3,
    /// Its share of the irradiance of what faces the gather's normal, W/m².
    pub irradiance: Rgb,
}

/// How far from 1 the length of a direction may be. Rotations and packing leave 10⁻⁶; and it must be well below
/// [`CHORD_NEGLIGIBLE`], so that a photon which is alone in its cluster is not taken for one off its centre.
const UNIT_TOLERANCE: f32 = 1e-4;

impl GatheredPhoton {
    /// True for a unit direction and an irradiance that is finite and nowhere negative.
    pub fn is_sound(&self) -> bool {
        // Comparisons with NaN are false. All are made, since one branch on their product is cheaper than many.
        let is_unit = (self.direction.length_squared() - 1.0).abs() < 2.0 * UNIT_TOLERANCE;
        let [r, g, b] = self.irradiance.to_array().map(|channel| (0.0..=f32::MAX).contains(&channel));
        is_unit & r & g & b
    }
}

/// How far surfaces count around the middle of a gather.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reach {
    pub(super) radius_m: f32,
    /// Least cosine of their normals with the gather's.
    pub(super) facing_cos: f32,
}

/// What a gather found; kept by the caller so that its memory is used again.
#[derive(Clone, Debug, Default)]
pub struct Gather {
    /// The photons.
    pub photons: Vec<GatheredPhoton>,
    /// Radius they lie within, m.
    pub radius_m: f32,
    /// Nothing further out than this had any influence, m.
    pub reach_m: f32,
    /// The surfaces within that radius.
    facets: Facets,
    /// Where photons fell behind the walls only: the area before them that caught none, m².
    pub dark_m2: Option<f32>,
    near: Vec<Near>,
    /// Of `near`, as last taken.
    arrivals: Arrivals,
    /// How many photons walls kept out of the last search.
    behind_count: usize,
    /// Photons on what faces further away from the gather's normal were left out, and so is its area.
    facing_cos: f32,
    /// Within reach, by place in the list of sides.
    of_sides: Vec<Facets>,
    /// Photons found, by place in the list of sides.
    counts_of_sides: Vec<u32>,
    /// Sides that do not count, ascending.
    dark: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Near {
    distance2: f32,
    side: u32,
    item: u32,
    /// Cosine of its surface's normal with the gather's.
    facing_cos: f32,
}

/// Cosine of the angle from the gather's normal within which surfaces count: what faces another way gets other light.
const FACING_COS: f32 = 0.5;
/// The same where enough photons lie on such surfaces: the sides of eight-sided columns are 45° apart.
const ALIKE_COS: f32 = 0.79;
/// Cosine that all have.
const ANY_COS: f32 = -2.0;
/// Photons of a gather that must face its normal; with fewer all count.
const FACING_MIN: usize = 8;

/// Share of the radius that a gather is content with below which it is not narrowed: what is found there stands for a whole cell.
const NARROWEST: f32 = 0.4;
/// How many times as many photons count in each wider estimate when a gather is narrowed.
const WIDER: usize = 3;
/// Two estimates agree where they are no further apart than so many standard deviations of both: more keep blur, fewer take noise
/// for change.
const AGREES_SIGMA: f64 = 2.0;

/// A side counts as dark if it has at most this share of the photons that it would have if all sides were lit alike …
const DARK_SHARE: f32 = 1.0 / 16.0;
/// … and would have at least these. Of sides that are lit alike, and would have just so many, one in 55 gets none, and its area is left
/// out; with eight, what lies hidden in walls takes more of the light of rough octrees (Sibenik's nave at 0.3 s: 8.1 % of all
/// light missing, 6.9 with four; √relMSE 25 and 24 %; Sponza's at 1.2 s 3.2 and 2.9 %, of the error 21.1 and 20.7).
const DARK_EXPECTED_MIN: f32 = 4.0;

/// How many times distances along the gather's normal count: photons lie within an ellipsoid as flat as that.
pub(super) const FLATNESS: f32 = 2.5;
/// A search that found too few looks as far next as should find so many times what is asked for …
const AMPLE: f32 = 1.25;
/// … within these multiples of its radius, the last while fewer than [`TELLING`] photons say how they lie.
const GROWTH_MIN: f32 = 1.1;
const GROWTH_MAX: f32 = 4.0;
const GROWTH_BLIND: f32 = 2.0;
const TELLING: usize = 8;
/// Share of the farthest radius at which a search for some number begins: where photons lie a hundred times as close as
/// on average it finds no more than that.
const FIRST_GUESS: f32 = 0.05;

/// Where and how far to gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatherBounds {
    /// Middle, render space.
    pub centre: Vec3,
    /// Where the surfaces face, unit. Distances along it count more: what lies above or below is another
    /// sheet.
    pub normal: Vec3,
    /// Radius to be content with, m, if that many photons lie within it; one that is not less than `radius_max_m` says that
    /// just the nearest `count_min` are asked for …
    pub radius_m: f32,
    /// … as these.
    pub count_min: NonZeroUsize,
    /// Of more photons than these only the nearest count.
    pub count_max: NonZeroUsize,
    /// Where fewer than `count_min` lie within `radius_m`, the nearest of them count that lie within this radius, m.
    pub radius_max_m: f32,
    /// Where light changes within the radius fewer photons count, but not fewer than these.
    pub count_narrow: NonZeroUsize,
    /// Nothing beyond these counts.
    pub walls: Walls,
}

impl GatherBounds {
    /// Without walls, for what asks no more of a gather than where it is.
    #[cfg(test)]
    pub(super) fn at(centre: Vec3, normal: Vec3) -> GatherBounds {
        let count = NonZeroUsize::MIN;
        GatherBounds {
            centre,
            normal,
            radius_m: 1.0,
            count_min: count,
            count_max: count,
            radius_max_m: 1.0,
            count_narrow: count,
            walls: Walls::default(),
        }
    }

    /// A radius is asked for, not a number of photons.
    fn is_content(&self) -> bool {
        self.radius_m > 0.0 && self.radius_m < self.radius_max_m
    }

    /// From the middle to a point in the space in which the ellipsoid of the gather is a sphere, m.
    pub(in crate::technique) fn flattened_from(&self, p: Vec3) -> Vec3 {
        let from = p - self.centre;
        from + self.normal * ((FLATNESS - 1.0) * self.normal.dot(from))
    }
}

impl PhotonMaps {
    /// The photons of a class around a point on some sides of surfaces, as far as those face its normal, with their shares
    /// of the irradiance there. Sides that a gather of indirect light found dark stay dark for what follows with the same
    /// `gather`: that no caustic falls on a side does not make it an inside.
    ///
    /// - `sides`: `[n]`, each once, ascending
    pub fn gather(&self, class: PathClass, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        let Some(class) = gather.begin(class) else { return };
        if !(bounds.radius_max_m > 0.0) {
            return;
        }
        self.search(class, sides, bounds, gather);
        self.estimate(class, sides, bounds, gather);
    }

    /// What the photons say that a search found.
    fn estimate(&self, class: usize, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        let maps = &self.sides[class];
        let reach = Reach { radius_m: gather.radius_m, facing_cos: gather.facing_cos };
        if gather.near.is_empty() {
            if gather.behind_count > 0 {
                self.look_at_sides(sides, bounds, reach, gather);
                gather.dark_m2 = Some(gather.of_sides.iter().map(|facets| facets.area_m2).sum());
            }
            return;
        }
        self.measure_sides(class, sides, bounds, reach, gather);
        if !(gather.facets.area_m2 > 0.0) {
            return;
        }
        let Gather { near, dark, .. } = gather;
        near.retain(|near| dark.binary_search(&near.side).is_err());
        self.narrow(class, sides, bounds, gather);
        // In the order of the maps, whatever the shape of their trees: what is made of the photons must not depend on others
        // far away.
        gather.near.sort_unstable_by_key(Near::name);
        let seen = Seen { facets: gather.facets, normal: bounds.normal };
        let Gather { near, arrivals, photons, .. } = gather;
        arrivals.take(near, maps);
        photons.extend(arrivals.weighed_by(&seen, near.len()).map(|(arrival, per_watt)| GatheredPhoton {
            direction: arrival.direction,
            irradiance: arrival.flux * per_watt,
        }));
    }

    /// Looks for the photons of a gather. Everything within a radius, too large by a little, is found several times faster
    /// than the nearest of some number.
    fn search(&self, class: usize, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        let maps = &self.sides[class];
        let is_content = bounds.is_content();
        gather.radius_m = if is_content { bounds.radius_m } else { bounds.radius_max_m * FIRST_GUESS };
        let mut count_max = if is_content { bounds.count_max } else { bounds.count_min }.get();
        loop {
            gather.near.clear();
            gather.behind_count = 0;
            for side in sides {
                if let Some(map) = &maps[side.index()]
                    && self.surfaces.may_reach(*side, bounds.centre, gather.radius_m)
                {
                    gather.add_within(*side, map, bounds);
                }
            }
            gather.orient(bounds.count_min.get());
            // A wall that takes half of them leaves enough.
            let found = gather.near.len() + gather.near.len().min(gather.behind_count);
            if found >= bounds.count_min.get() || gather.radius_m >= bounds.radius_max_m {
                break;
            }
            // Photons lie on surfaces: there are as many more as the square of the radius is larger.
            let missing = bounds.count_min.get() as f32 / (found as f32 + 1.0);
            let farthest = if found < TELLING { GROWTH_BLIND } else { GROWTH_MAX };
            let growth = (AMPLE * missing).sqrt().clamp(GROWTH_MIN, farthest);
            let next_m = (gather.radius_m * growth).min(bounds.radius_max_m);
            // What is next to nothing rounds back to itself, for ever.
            gather.radius_m = if next_m > gather.radius_m { next_m } else { bounds.radius_max_m };
            count_max = bounds.count_min.get();
        }
        gather.reach_m = gather.radius_m;
        // Where it ended with fewer than asked for because there were enough, the last one defines the radius here as well: what ends
        // by how many it found finds too many.
        let count = gather.near.len();
        let is_early = (2..bounds.count_min.get()).contains(&count) && gather.radius_m < bounds.radius_max_m;
        gather.close_in(if is_early { count } else { count_max });
    }

    /// What of some sides lies within reach, unless that was found with the photons.
    fn look_at_sides(&self, sides: &[SideId], bounds: &GatherBounds, reach: Reach, gather: &mut Gather) {
        if gather.of_sides.is_empty() {
            gather.of_sides.extend(sides.iter().map(|side| self.surfaces.within(*side, bounds, reach)));
        }
    }

    /// Area of the surfaces of some sides within reach, of both sides of a surface where both are asked for, since the
    /// photons of both count; but of none that next to no photon falls on where many would if all were lit alike. Such are
    /// mostly the insides of walls, shells and vaults, which nobody sees, and which would take their share of the light.
    /// **Bias**: a side that is seen and that dark shows the light of the others in its cell.
    fn measure_sides(
        &self,
        class: usize,
        sides: &[SideId],
        bounds: &GatherBounds,
        reach: Reach,
        gather: &mut Gather,
    ) {
        self.look_at_sides(sides, bounds, reach, gather);
        if class == 0 {
            gather.find_dark(sides);
        }
        for (place, id) in sides.iter().enumerate() {
            if !gather.is_dark(*id) {
                let facets = gather.of_sides[place];
                gather.facets += facets;
            }
        }
    }

    /// Narrows a gather to the widest estimate that agrees with all narrower ones within their noise [Lepski1991].
    fn narrow(&self, class: usize, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        let all = gather.near.len();
        let mut count = bounds.count_narrow.get();
        if count > all / 2 {
            return;
        }
        gather.near.sort_unstable_by_key(Near::by_distance);
        gather.arrivals.take(&gather.near, &self.sides[class]);
        let narrowest_m = if bounds.is_content() { NARROWEST * bounds.radius_m } else { 0.0 };
        let widest = Estimate { count: all, radius_m: gather.radius_m, facets: gather.facets };
        let mut summed = 0;
        let mut agreement = Agreement::ANY;
        let mut chosen = None;
        while summed < all {
            // The last is of all, and no two are of about the same photons.
            let estimate = if count > all / 2 {
                widest
            } else {
                let radius_m = gather.near[count].distance2.sqrt();
                let reach = Reach { radius_m, facing_cos: gather.facing_cos };
                let lit = sides.iter().filter(|side| !gather.is_dark(**side));
                let facets = lit.map(|side| self.surfaces.within(*side, bounds, reach)).sum();
                Estimate { count, radius_m, facets }
            };
            // Each estimate is what a gather of its photons alone would find, by the surfaces that they lie on.
            let seen = Seen { facets: estimate.facets, normal: bounds.normal };
            let mut sums = LightSums::default();
            for (arrival, per_watt) in gather.arrivals.weighed_by(&seen, estimate.count) {
                sums.add(arrival.luminance * per_watt);
            }
            summed = estimate.count;
            // Photons at one point have no area around them.
            if estimate.radius_m > narrowest_m && estimate.facets.area_m2 > 0.0 {
                if !agreement.admits(&sums) {
                    break;
                }
                chosen = Some(estimate);
            }
            count = count.saturating_mul(WIDER);
        }
        let chosen = chosen.unwrap_or(widest);
        gather.near.truncate(chosen.count);
        (gather.radius_m, gather.facets) = (chosen.radius_m, chosen.facets);
    }
}

/// A gather of the nearest of some photons.
#[derive(Clone, Copy, Debug)]
struct Estimate {
    count: usize,
    radius_m: f32,
    facets: Facets,
}

/// What some photons bring, in luminance: the sum, and the sum of the squares.
#[derive(Clone, Copy, Debug, Default)]
struct LightSums {
    sum: f64,
    squares: f64,
}

impl LightSums {
    fn add(&mut self, luminance: f32) {
        let luminance = f64::from(luminance);
        self.sum += luminance;
        self.squares += luminance * luminance;
    }
}

/// Irradiances that agree with all estimates so far, W/m².
#[derive(Clone, Copy, Debug)]
struct Agreement {
    least: f64,
    most: f64,
}

impl Agreement {
    const ANY: Agreement = Agreement { least: 0.0, most: f64::INFINITY };

    /// Some irradiance agrees with one more estimate as well. Photons fall by chance, each by itself, so that the variance of
    /// their sum is about the sum of their squares.
    fn admits(&mut self, sums: &LightSums) -> bool {
        let irradiance = sums.sum;
        let slack = AGREES_SIGMA * sums.squares.sqrt();
        self.least = self.least.max(irradiance - slack);
        self.most = self.most.min(irradiance + slack);
        self.least <= self.most
    }
}

impl Near {
    /// In the order of the maps.
    fn name(&self) -> u64 {
        u64::from(self.side) << 32 | u64::from(self.item)
    }

    /// Ascends with the distance; those at the same distance are told apart by name, so that the answer does not depend on any
    /// order. One number is compared several times faster than two, one after the other.
    fn by_distance(&self) -> u128 {
        // What is not negative ascends as its bits do; NaN, which only a broken normal makes, comes last.
        u128::from(self.distance2.to_bits()) << 64 | u128::from(self.name())
    }

    fn of(&self, maps: &[Option<Arc<SideMap>>]) -> Option<MapPhoton> {
        maps[self.side as usize].as_ref().map(|map| map.photons[self.item as usize])
    }
}

impl Gather {
    /// Forgets what was gathered before; `None` for classes without maps.
    fn begin(&mut self, class: PathClass) -> Option<usize> {
        self.photons.clear();
        self.near.clear();
        self.of_sides.clear();
        self.behind_count = 0;
        self.dark_m2 = None;
        self.facets = Facets::default();
        self.radius_m = 0.0;
        self.reach_m = 0.0;
        let class = MAPPED.iter().position(|mapped| *mapped == class)?;
        if class == 0 {
            self.dark.clear();
        }
        Some(class)
    }

    /// Leaves out what faces another way. In a fold only a few may face the right way: one of them on a triangle the size of a
    /// pinhead would outshine everything. Then all count, and so does all the area.
    ///
    /// - `enough`: photons on what faces nearly the same way that make up for the others
    fn orient(&mut self, enough: usize) {
        let facing = |cos: f32| self.near.iter().filter(|near| near.facing_cos >= cos).count();
        let count = facing(FACING_COS);
        self.facing_cos = if facing(ALIKE_COS) >= enough {
            ALIKE_COS
        } else if count >= FACING_MIN || count == self.near.len() {
            FACING_COS
        } else {
            ANY_COS
        };
        self.near.retain(|near| near.facing_cos >= self.facing_cos);
    }

    /// Notes the sides that next to no photon fell on where many would if all were lit alike.
    ///
    /// - `sides`: `[n]`, each once, ascending
    fn find_dark(&mut self, sides: &[SideId]) {
        // Of one side alone all fell on it.
        if sides.len() < 2 {
            return;
        }
        self.counts_of_sides.clear();
        self.counts_of_sides.resize(sides.len(), 0);
        for near in &self.near {
            if let Ok(place) = sides.binary_search_by_key(&near.side, |side| side.index() as u32) {
                self.counts_of_sides[place] += 1;
            }
        }
        let all_m2 = self.of_sides.iter().map(|facets| facets.area_m2).sum::<f32>();
        let per_m2 = self.near.len() as f32 / all_m2;
        for ((side, facets), count) in sides.iter().zip(&self.of_sides).zip(&self.counts_of_sides) {
            let expected = per_m2 * facets.area_m2;
            if expected >= DARK_EXPECTED_MIN && *count as f32 <= expected * DARK_SHARE {
                self.dark.push(side.index() as u32);
            }
        }
    }

    fn is_dark(&self, side: SideId) -> bool {
        self.dark.binary_search(&(side.index() as u32)).is_ok()
    }

    /// Adds what lies within `self.radius_m` on a side.
    fn add_within(&mut self, side: SideId, map: &SideMap, bounds: &GatherBounds) {
        let radius2 = self.radius_m * self.radius_m;
        let centre = bounds.centre.to_array();
        let within = map.tree.query(&centre).within::<SquaredEuclidean<f32>>(radius2);
        let side = side.index() as u32;
        // Neighbours mostly lie on one plane.
        let (mut normal, mut facing_cos) = (None, 0.0);
        for near in within.unsorted().execute() {
            let photon = &map.photons[near.item as usize];
            let distance2 = bounds.flattened_from(photon.position).length_squared();
            if distance2 > radius2 {
                continue;
            }
            if bounds.walls.behind_m(photon.position - bounds.centre) > 0.0 {
                self.behind_count += 1;
                continue;
            }
            if normal != Some(photon.normal) {
                normal = Some(photon.normal);
                facing_cos = octahedral::decode(photon.normal).dot(bounds.normal);
            }
            self.near.push(Near { distance2, side, item: near.item, facing_cos });
        }
    }

    /// Keeps those nearer than the k-th and sets the radius to its distance; keeps all when there are fewer.
    fn close_in(&mut self, count: usize) {
        if self.near.len() < count {
            return;
        }
        let last = count - 1;
        self.near.select_nth_unstable_by_key(last, Near::by_distance);
        let radius_m = self.near[last].distance2.sqrt();
        if radius_m > 0.0 {
            self.radius_m = radius_m;
            self.near.truncate(last);
        }
    }

    /// Irradiance of all photons together, W/m².
    pub fn irradiance(&self) -> Rgb {
        self.photons.iter().fold(Rgb::BLACK, |sum, photon| sum + photon.irradiance)
    }
}

#[cfg(test)]
mod tests;
