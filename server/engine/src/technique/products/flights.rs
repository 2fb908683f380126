//! Where light comes from that falls on surfaces: the last flights of photons, by where they ended.
//!
//! Whoever looks around from a point learns from the photons that fell nearby which places send much light there
//! [Jensen1995]. They are hints and no measure: what follows them must be right whatever they say.

use std::num::NonZeroUsize;

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::math::sobol::mix;

/// Flights kept at most, drawn evenly of more.
const FLIGHTS_MAX: usize = 1 << 15;

/// The last flight of a photon that another surface sent on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    /// Where it began, in render space.
    pub from: Vec3,
    /// Where it ended, in render space.
    pub to: Vec3,
    /// Mean flux of the channels, W.
    pub flux_w: f32,
}

/// Some flights of photons, found by where they ended.
pub struct Flights {
    tree: ImmutableKdTree<f32, 3>,
    begun: Vec<(Vec3, f32)>,
}

impl std::fmt::Debug for Flights {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Flights").field("count", &self.begun.len()).finish()
    }
}

impl Flights {
    /// `None` where there is none.
    ///
    /// - `count`: of all
    pub fn of(all: impl Iterator<Item = Flight>, count: usize) -> Option<Flights> {
        // Not every so-many-th, which might be the first of every path.
        let share = (FLIGHTS_MAX as f64 / count.max(1) as f64 * 2f64.powi(64)) as u64;
        let some = (0..).zip(all).filter(|(number, _)| mix(*number) <= share).take(FLIGHTS_MAX);
        let mut begun = Vec::with_capacity(count.min(FLIGHTS_MAX));
        let mut ends = Vec::with_capacity(count.min(FLIGHTS_MAX));
        for (_, Flight { from, to, flux_w }) in some {
            begun.push((from, flux_w));
            ends.push(to.to_array());
        }
        NonZeroUsize::new(ends.len())?;
        let tree = ImmutableKdTree::new_from_slice(&ends).ok()?;
        Some(Flights { tree, begun })
    }

    /// Memory.
    pub fn bytes(&self) -> usize {
        // kiddo keeps a position and a number for each.
        self.begun.len() * (size_of::<(Vec3, f32)>() + 16)
    }

    /// Where those began that ended nearest to `p`, and their flux, W.
    pub fn ended_near(&self, p: Vec3, count: NonZeroUsize) -> impl Iterator<Item = (Vec3, f32)> {
        let near = self.tree.query(&p.to_array()).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        near.into_iter().map(|near| self.begun[near.item as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(count: u32) -> impl Iterator<Item = Flight> {
        (0..count).map(|number| {
            let to = Vec3::new(number as f32, 0.0, 0.0);
            Flight { from: to + Vec3::Y, to, flux_w: 1.0 }
        })
    }

    /// The nearest are found; of too many a part is kept that is spread evenly over all, first and second flights alike.
    #[test]
    fn the_nearest_are_found_among_those_kept() {
        let flights = Flights::of(row(1000), 1000).unwrap();
        let near: Vec<f32> = flights
            .ended_near(Vec3::new(500.2, 3.0, 0.0), NonZeroUsize::new(3).unwrap())
            .map(|(p, _)| p.x)
            .collect();
        assert_eq!(near, [500.0, 501.0, 499.0]);
        const MANY: u32 = 200_000;
        let flights = Flights::of(row(MANY), MANY as usize).unwrap();
        let kept: Vec<u32> = flights.begun.iter().map(|(from, _)| from.x as u32).collect();
        assert!(kept.len() <= FLIGHTS_MAX && kept.len() > FLIGHTS_MAX * 49 / 50, "{}", kept.len());
        for part in 0..10 {
            let odd = |number: &&u32| *number / (MANY / 10) == part && *number % 2 == 1;
            let share = kept.iter().filter(odd).count() as f32 / kept.len() as f32;
            assert!((share - 0.05).abs() < 0.005, "{part}: {share}");
        }
        assert!(Flights::of(row(0), 0).is_none());
    }
}
