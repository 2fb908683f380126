//! Photon maps: one per side of every crease surface and class of light, and what is read from them.
//!
//! Density estimate E = Σ Φⱼ / A over the photons within the distance r of the k-th nearest, where A is the area of their
//! own surfaces within that distance [Jensen1996; Larsen2004, 8.1]: exact at borders and in corners, where a disc πr² would
//! hang off the surface. Distances along the normal count more, so that the sphere is a flat ellipsoid. The k-th photon
//! defines r and does not count itself, which makes the estimate unbiased for even light. **Biased**: blurs over r.
//! Consistent as photons grow and r shrinks.

use std::{num::NonZeroUsize, sync::Arc};

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use super::surfaces::{SideId, Surfaces, TriangleSide};
use crate::{
    math::{Rgb, octahedral},
    transport::PathClass,
};

/// Classes of light that maps are made for: what falls straight from lights is computed better without photons.
pub const MAPPED: [PathClass; 2] = [PathClass::Indirect, PathClass::Caustic];

/// The photons of one class on one side of a surface.
pub struct SideMap {
    tree: ImmutableKdTree<f32, 3>,
    photons: Vec<MapPhoton>,
}

impl std::fmt::Debug for SideMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SideMap").field("photons", &self.photons.len()).finish()
    }
}

/// A photon on its way into a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FallenPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// Flux, W.
    pub flux: Rgb,
    /// Where it came from, octahedral.
    pub direction: u32,
}

/// A photon in a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPhoton {
    /// Where, in render space.
    pub position: Vec3,
    /// Flux, W.
    pub flux: Rgb,
    /// Where it came from, octahedral.
    pub direction: u32,
    /// Normal of the surface on the side it fell on, octahedral.
    pub normal: u32,
}

/// The photon maps of a scene, by class and side.
#[derive(Clone, Debug, Default)]
pub struct PhotonMaps {
    surfaces: Arc<Surfaces>,
    /// `[class][side]`.
    sides: [Vec<Option<Arc<SideMap>>>; 2],
}

/// A photon as a gather sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatheredPhoton {
    /// Unit direction to where it came from.
    pub direction: Vec3,
    /// Its share of the irradiance, W/m².
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
    /// Radius they lie within, m: nothing further out had any influence.
    pub radius_m: f32,
    /// Area of the surfaces within that radius, m².
    pub area_m2: f32,
    near: Vec<Near>,
    /// Within reach, by place in the list of sides.
    areas: Vec<f32>,
    /// Sides that do not count, ascending.
    dark: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Near {
    distance2: f32,
    side: u32,
    item: u32,
    /// Its surface faces the gather's normal.
    faces: bool,
}

/// Cosine of the angle from the gather's normal within which surfaces count: what faces another way gets other light.
pub const FACING_COS: f32 = 0.5;

/// Photons of a gather that must face its normal; with fewer all count.
const FACING_MIN: usize = 8;

/// A side counts as dark if it has at most this share of the photons that it would have if all sides were lit alike …
const DARK_SHARE: f32 = 1.0 / 16.0;
/// … and would have at least these.
const DARK_EXPECTED_MIN: f32 = 8.0;

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
}

impl GatherBounds {
    /// From the middle to a point in the space in which the ellipsoid of the gather is a sphere, m.
    pub(super) fn flattened_from(&self, p: Vec3) -> Vec3 {
        let from = p - self.centre;
        from + self.normal * ((FLATNESS - 1.0) * self.normal.dot(from))
    }
}

impl PhotonMaps {
    /// Maps of all photons; `kept(class, side)` gives those that are as they were.
    ///
    /// - `all`: every photon with its class and place; those of classes without maps are left out
    /// - `normal_of`: unit normal of a triangle on a side of it
    pub(in crate::technique) fn of(
        all: Vec<(PathClass, TriangleSide, FallenPhoton)>,
        surfaces: Arc<Surfaces>,
        normal_of: impl Fn(TriangleSide) -> Vec3,
        kept: impl Fn(usize, SideId) -> Option<Option<Arc<SideMap>>>,
    ) -> PhotonMaps {
        let side_count = 2 * surfaces.count() as usize;
        let mut sides: [Vec<Option<Arc<SideMap>>>; 2] = std::array::from_fn(|_| vec![None; side_count]);
        let mut is_open = [vec![true; side_count], vec![true; side_count]];
        for class in 0..MAPPED.len() {
            for side in 0..side_count {
                if let Some(map) = kept(class, SideId::at(side)) {
                    sides[class][side] = map;
                    is_open[class][side] = false;
                }
            }
        }
        let mut photons: [Vec<Vec<MapPhoton>>; 2] = std::array::from_fn(|_| vec![Vec::new(); side_count]);
        for (class, place, photon) in all {
            let Some(class) = MAPPED.iter().position(|mapped| *mapped == class) else { continue };
            let side = surfaces.side(place).index();
            if is_open[class][side] {
                let FallenPhoton { position, flux, direction } = photon;
                let normal = octahedral::encode(normal_of(place));
                photons[class][side].push(MapPhoton { position, flux, direction, normal });
            }
        }
        for (maps, photons) in sides.iter_mut().zip(photons) {
            maps.par_iter_mut().zip(photons).filter(|(_, photons)| !photons.is_empty()).for_each(
                |(map, photons)| {
                    *map = SideMap::of(photons).map(Arc::new);
                },
            );
        }
        PhotonMaps { surfaces, sides }
    }

    /// The surfaces they lie on.
    pub fn surfaces(&self) -> &Arc<Surfaces> {
        &self.surfaces
    }

    /// The map of a side, by class as in [`MAPPED`].
    pub fn side_map(&self, class: usize, side: SideId) -> &Option<Arc<SideMap>> {
        &self.sides[class][side.index()]
    }

    /// Photons in all maps of a class.
    pub fn photon_count(&self, class: PathClass) -> usize {
        let Some(index) = MAPPED.iter().position(|mapped| *mapped == class) else { return 0 };
        self.sides[index].iter().flatten().map(|map| map.photons.len()).sum()
    }

    /// Sides that photons of a class lie on.
    pub fn map_count(&self, class: PathClass) -> usize {
        let Some(index) = MAPPED.iter().position(|mapped| *mapped == class) else { return 0 };
        self.sides[index].iter().flatten().count()
    }

    /// Memory of photons and trees.
    pub fn bytes(&self) -> usize {
        let photons: usize = self.sides.iter().flatten().flatten().map(|map| map.photons.len()).sum();
        // kiddo keeps a position and a number for each.
        photons * (size_of::<MapPhoton>() + 16)
            + self.surfaces.bytes()
            + self.sides.iter().map(|sides| sides.len() * size_of::<Option<Arc<SideMap>>>()).sum::<usize>()
    }

    /// The photons of a class around a point on some sides of surfaces, as far as those face its normal, with their shares
    /// of the irradiance there. Sides that a gather of indirect light found dark stay dark for what follows with the same
    /// `gather`: that no caustic falls on a side does not make it an inside.
    ///
    /// - `sides`: `[n]`, each once, ascending
    pub fn gather(&self, class: PathClass, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        gather.photons.clear();
        gather.near.clear();
        gather.area_m2 = 0.0;
        gather.radius_m = 0.0;
        let Some(class) = MAPPED.iter().position(|mapped| *mapped == class) else { return };
        if class == 0 {
            gather.dark.clear();
        }
        if !(bounds.radius_max_m > 0.0) {
            return;
        }
        let maps = &self.sides[class];
        self.search(class, sides, bounds, gather);
        // In the order of the maps, whatever the shape of their trees: what is made of the photons must not depend on others
        // far away.
        gather.near.sort_unstable_by_key(|near| u64::from(near.side) << 32 | u64::from(near.item));
        let photon_of =
            |near: &Near| maps[near.side as usize].as_ref().map(|map| map.photons[near.item as usize]);
        let faces = |photon: &MapPhoton| octahedral::decode(photon.normal).dot(bounds.normal) >= FACING_COS;
        for near in &mut gather.near {
            near.faces = photon_of(near).as_ref().is_some_and(faces);
        }
        // In a fold only a few may face the right way: one of them on a triangle the size of a pinhead would outshine
        // everything. Then all count, and so does all the area.
        let facing_count = gather.near.iter().filter(|near| near.faces).count();
        let is_oriented = facing_count >= FACING_MIN || facing_count == gather.near.len();
        let facing_cos = if is_oriented { FACING_COS } else { -2.0 };
        if is_oriented {
            gather.near.retain(|near| near.faces);
        }
        if gather.near.is_empty() {
            return;
        }
        self.measure_sides(class, sides, bounds, Reach { radius_m: gather.radius_m, facing_cos }, gather);
        if !(gather.area_m2 > 0.0) {
            return;
        }
        let per_area = 1.0 / gather.area_m2;
        let counting = gather.near.iter().filter(|near| gather.dark.binary_search(&near.side).is_err());
        gather.photons.extend(counting.filter_map(photon_of).map(|photon| GatheredPhoton {
            direction: octahedral::decode(photon.direction),
            irradiance: photon.flux * per_area,
        }));
    }

    /// Looks for the photons of a gather. Everything within a radius, too large by a little, is found several times faster
    /// than the nearest of some number.
    fn search(&self, class: usize, sides: &[SideId], bounds: &GatherBounds, gather: &mut Gather) {
        let maps = &self.sides[class];
        let is_content = bounds.radius_m > 0.0 && bounds.radius_m < bounds.radius_max_m;
        gather.radius_m = if is_content { bounds.radius_m } else { bounds.radius_max_m * FIRST_GUESS };
        let mut count_max = if is_content { bounds.count_max } else { bounds.count_min }.get();
        loop {
            gather.near.clear();
            for side in sides {
                if let Some(map) = &maps[side.index()] {
                    gather.add_within(*side, map, bounds);
                }
            }
            let found = gather.near.len();
            if found >= bounds.count_min.get() || gather.radius_m >= bounds.radius_max_m {
                break;
            }
            // Photons lie on surfaces: there are as many more as the square of the radius is larger.
            let missing = bounds.count_min.get() as f32 / (found as f32 + 1.0);
            let farthest = if found < TELLING { GROWTH_BLIND } else { GROWTH_MAX };
            let growth = (AMPLE * missing).sqrt().clamp(GROWTH_MIN, farthest);
            gather.radius_m = (gather.radius_m * growth).min(bounds.radius_max_m);
            count_max = bounds.count_min.get();
        }
        gather.close_in(count_max);
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
        gather.areas.clear();
        gather.areas.extend(sides.iter().map(|side| self.surfaces.area_within(*side, bounds, reach)));
        let per_m2 = gather.near.len() as f32 / gather.areas.iter().sum::<f32>();
        for (side, area_m2) in sides.iter().zip(&gather.areas) {
            let side = side.index() as u32;
            if class == 0 {
                let expected = per_m2 * area_m2;
                let first = gather.near.partition_point(|near| near.side < side);
                let count = gather.near[first..].partition_point(|near| near.side == side);
                if expected >= DARK_EXPECTED_MIN && count as f32 <= expected * DARK_SHARE {
                    gather.dark.push(side);
                }
            }
            if gather.dark.binary_search(&side).is_err() {
                gather.area_m2 += area_m2;
            }
        }
    }
}

impl Gather {
    /// Adds what lies within `self.radius_m` on a side.
    fn add_within(&mut self, side: SideId, map: &SideMap, bounds: &GatherBounds) {
        let radius2 = self.radius_m * self.radius_m;
        let centre = bounds.centre.to_array();
        let within = map.tree.query(&centre).within::<SquaredEuclidean<f32>>(radius2);
        let side = side.index() as u32;
        let near = within.unsorted().execute().into_iter().map(|near| Near {
            distance2: bounds.flattened_from(map.photons[near.item as usize].position).length_squared(),
            side,
            item: near.item,
            faces: false,
        });
        self.near.extend(near.filter(|near| near.distance2 <= radius2));
    }

    /// Keeps those nearer than the k-th and sets the radius to its distance; keeps all when there are fewer.
    fn close_in(&mut self, count: usize) {
        if self.near.len() < count {
            return;
        }
        // Those at the same distance are told apart by name, so that the answer does not depend on any order.
        let order = |near: &Near| (near.distance2, near.side, near.item);
        let last = count - 1;
        self.near.select_nth_unstable_by(last, |a, b| {
            order(a).partial_cmp(&order(b)).unwrap_or(std::cmp::Ordering::Equal)
        });
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

impl SideMap {
    fn of(mut photons: Vec<MapPhoton>) -> Option<SideMap> {
        // Neighbours in space become neighbours in memory: gathers then take half the time.
        photons.par_sort_by_cached_key(|photon| place_on_a_curve(photon.position));
        let positions: Vec<[f32; 3]> = photons.iter().map(|photon| photon.position.to_array()).collect();
        // Only more photons than u32 can count are refused, and none at all.
        let tree =
            NonZeroUsize::new(positions.len()).and_then(|_| ImmutableKdTree::new_from_slice(&positions).ok());
        Some(SideMap { tree: tree?, photons })
    }
}

/// Where a point comes on a curve that visits near points soon after each other. Depends on nothing but the point: the order
/// of some photons must not depend on others.
fn place_on_a_curve(p: Vec3) -> u64 {
    // Upper bits of numbers whose order is that of the floats.
    let ordered = |x: f32| {
        let bits = x.to_bits();
        u64::from((if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }) >> 11)
    };
    // To every third bit.
    let spread = |mut x: u64| {
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(ordered(p.x)) | spread(ordered(p.y)) << 1 | spread(ordered(p.z)) << 2
}
