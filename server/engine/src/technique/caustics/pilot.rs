//! How far photons are blurred: the distance to the 16th neighbour in a first map, and more if they carry more than those.
//!
//! Neighbours are those on the same primitive of the same instance that face about the same way: what falls on the lamp says
//! nothing of the wall behind it. Only where these are fewer than sixteen, those on other things that face that way count too.

use std::{collections::BTreeMap, f32::consts::FRAC_1_PI, num::NonZeroUsize};

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use super::CausticPhoton;
use crate::math::sobol;

/// Photons of the first pass that lie within the first radius of one of them.
const NEIGHBOURS: NonZeroUsize = NonZeroUsize::new(16).expect("is not zero");
/// Largest radius over the extent of most photons where these are many, and where they are few; and the smallest over the
/// largest.
const RADIUS_MAX: [f32; 2] = [1.0 / 32.0, 0.5];
const RADIUS_RANGE: f32 = 1.0 / (1 << 20) as f32;
/// Share of their flux that may lie beyond either end of what is taken for photons' extent: strays would blur all others.
const STRAY_SHARE: f64 = 0.05;

/// Names what a photon fell on: a primitive of an instance, where it faces most along some axis one way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sheet(u32);

/// Ways to face.
const WAYS: usize = 6;

impl Sheet {
    /// - `normal`: of the side that the photon fell on
    pub(super) fn of(instance: u32, primitive: usize, normal: Vec3) -> Sheet {
        let axis = normal.abs().max_position();
        let way = 2 * axis + usize::from(normal[axis] < 0.0);
        // Two that share a name by chance merely know of each other's photons.
        let thing = sobol::mix(u64::from(instance) << 32 ^ primitive as u64) as u32;
        Sheet(thing << 3 | way as u32)
    }

    fn way(self) -> usize {
        (self.0 & 7) as usize
    }
}

/// How close photons lay in the first pass: says how far those of all passes are blurred, so that blurs do not depend on
/// the photons they are for.
#[derive(Debug)]
pub(super) struct Pilot {
    /// Of sheets with enough photons.
    of_sheets: BTreeMap<Sheet, Crowds>,
    /// Of all photons by the way they face, for the other sheets.
    of_ways: [Option<Crowds>; WAYS],
    radius_max_m: f32,
}

/// What is known at some places.
#[derive(Debug)]
struct Crowds {
    tree: ImmutableKdTree<f32, 3>,
    crowds: Vec<Crowd>,
}

/// The neighbours of a photon.
#[derive(Clone, Copy, Debug)]
struct Crowd {
    /// Distance of the last one.
    radius_m: f32,
    /// Mean of what they carry, as luminance.
    flux_w: f32,
}

/// A photon for its neighbours: where it lies, and what it carries.
type Placed = ([f32; 3], f32);

impl Pilot {
    /// - `least_m`: extent to be assumed at least
    pub(super) fn of(photons: &[CausticPhoton], least_m: f32) -> Pilot {
        // Spread evenly over a square of that extent, the neighbours would lie within such a share of it.
        let even = (NEIGHBOURS.get() as f32 * FRAC_1_PI / photons.len().max(1) as f32).sqrt();
        let share = even.clamp(RADIUS_MAX[0], RADIUS_MAX[1]);
        let radius_max_m = extent_m(photons).max(least_m) * share;
        let radius_max_m = if radius_max_m.is_finite() { radius_max_m } else { 0.0 };
        let mut by_sheet: BTreeMap<Sheet, Vec<Placed>> = BTreeMap::new();
        for photon in photons.iter().filter(|_| radius_max_m > 0.0) {
            let placed = (photon.position.to_array(), photon.flux_w.luminance());
            by_sheet.entry(photon.sheet).or_default().push(placed);
        }
        let mut of_sheets = BTreeMap::new();
        // Those of sheets with too few photons last: only they look for neighbours on others.
        let mut of_ways: [Vec<Placed>; WAYS] = Default::default();
        let mut known: [Vec<Crowd>; WAYS] = Default::default();
        let (few, many): (Vec<_>, Vec<_>) =
            by_sheet.into_iter().partition(|(_, placed)| placed.len() < NEIGHBOURS.get());
        for (sheet, placed) in many {
            if let Some(crowds) = Crowds::of(&placed, Vec::new(), radius_max_m) {
                of_ways[sheet.way()].extend(placed);
                known[sheet.way()].extend(&crowds.crowds);
                of_sheets.insert(sheet, crowds);
            }
        }
        few.into_iter().for_each(|(sheet, placed)| of_ways[sheet.way()].extend(placed));
        let of_ways = std::array::from_fn(|way| {
            Crowds::of(&of_ways[way], std::mem::take(&mut known[way]), radius_max_m)
        });
        Pilot { of_sheets, of_ways, radius_max_m }
    }

    /// Says of photons how far they are blurred.
    ///
    /// - `shrinking`: area of a blur in shares of that in the first pass
    pub(super) fn blur(&self, photons: &mut [CausticPhoton], shrinking: f32) {
        photons.par_iter_mut().for_each(|photon| photon.radius_m = self.radius_m(photon) * shrinking.sqrt());
    }

    /// How far a photon is blurred in the first pass.
    fn radius_m(&self, photon: &CausticPhoton) -> f32 {
        let known = self.of_sheets.get(&photon.sheet).or(self.of_ways[photon.sheet.way()].as_ref());
        let Some(Crowds { tree, crowds }) = known else { return self.radius_max_m };
        let nearest =
            tree.query(&photon.position.to_array()).nearest_one::<SquaredEuclidean<f32>>().execute();
        let crowd = crowds[nearest.item as usize];
        // Further away than that photon's own neighbours nothing says that as many fall here; and one that carries as much as
        // several of those around would stand out among them.
        let radius_m = crowd.radius_m.max(nearest.distance.sqrt());
        let share = (photon.flux_w.luminance() / crowd.flux_w).max(1.0);
        (radius_m * share.sqrt()).min(self.radius_max_m)
    }

    /// Memory: a radius for each photon, and a position and a number in kiddo's tree.
    pub(super) fn bytes(&self) -> usize {
        let known = self.of_sheets.values().chain(self.of_ways.iter().flatten());
        known.map(|known| known.crowds.len() * (size_of::<Crowd>() + 16)).sum()
    }
}

impl Crowds {
    /// Of photons of which the crowds of the first ones are known. `None` without any.
    fn of(placed: &[Placed], mut known: Vec<Crowd>, radius_max_m: f32) -> Option<Crowds> {
        let places: Vec<[f32; 3]> = placed.iter().map(|(place, _)| *place).collect();
        NonZeroUsize::new(places.len())?;
        // Only more photons than u32 can count are refused, and none at all.
        let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&places).ok()?;
        let crowd_of = |(place, flux_w): &Placed| {
            // Where there are not so many in all, nothing says how close they lie.
            if placed.len() < NEIGHBOURS.get() {
                return Crowd { radius_m: radius_max_m, flux_w: *flux_w };
            }
            let nearest = tree.query(place).nearest_n::<SquaredEuclidean<f32>>(NEIGHBOURS).execute();
            let farthest = nearest.iter().map(|near| near.distance).fold(0.0, f32::max);
            let flux_w: f32 = nearest.iter().map(|near| placed[near.item as usize].1).sum();
            let radius_m = farthest.sqrt().clamp(radius_max_m * RADIUS_RANGE, radius_max_m);
            Crowd { radius_m, flux_w: flux_w / NEIGHBOURS.get() as f32 }
        };
        let rest: Vec<Crowd> = placed[known.len()..].par_iter().map(crowd_of).collect();
        known.extend(rest);
        Some(Crowds { crowds: known, tree })
    }
}

/// Diagonal of the box beyond whose sides lies no more than the strays' share of the flux each, m.
fn extent_m(photons: &[CausticPhoton]) -> f32 {
    let all_w: f64 = photons.iter().map(|photon| f64::from(photon.flux_w.luminance())).sum();
    let along = [0, 1, 2].map(|axis| {
        let mut places: Vec<[f32; 2]> =
            photons.iter().map(|photon| [photon.position[axis], photon.flux_w.luminance()]).collect();
        places.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let ends = [first_within(places.iter(), all_w), first_within(places.iter().rev(), all_w)];
        ends[1] - ends[0]
    });
    Vec3::from_array(along).length()
}

/// The first of some places, each with its flux, before which lies no more than the strays' share of all flux.
fn first_within<'a>(places: impl Iterator<Item = &'a [f32; 2]>, all_w: f64) -> f32 {
    let mut until_w = 0.0;
    let mut within = places.filter(|[_, flux_w]| {
        until_w += f64::from(*flux_w);
        until_w > STRAY_SHARE * all_w
    });
    within.next().map_or(0.0, |[place, _]| *place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;

    /// Photons that lie far off count by the light they bring, not by their number: strays do not, few that bring much of it do.
    #[test]
    fn extent_is_that_of_the_light() {
        let extent_of = |stray_w: f32| {
            let photon = |place: f32, flux_w: f32| CausticPhoton {
                position: Vec3::new(place, 0.0, 0.0),
                radius_m: 0.0,
                flux_w: Rgb::splat(flux_w),
                direction: Vec3::Y,
                normal: Vec3::Y,
                sheet: Sheet::of(0, 0, Vec3::Y),
                scatterings: 1,
                is_on_back: false,
            };
            let near = (0..=1000).map(|number| photon(number as f32 * 1e-3, 1e-3));
            let far = (0..10).map(|_| photon(50.0, stray_w));
            extent_m(&near.chain(far).collect::<Vec<_>>())
        };
        assert!((extent_of(1e-3) - 0.9).abs() < 0.05, "{}", extent_of(1e-3));
        assert!((extent_of(1.0) - 50.0).abs() < 1.0, "{}", extent_of(1.0));
        assert_eq!(extent_m(&[]), 0.0);
    }
}
