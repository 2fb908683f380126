//! Where light comes from that falls on surfaces: the last flights of photons, by where they ended.
//!
//! Whoever looks around from a point learns from the photons that fell nearby which places send much light there
//! [Jensen1995]. They are hints and no measure: what follows them must be right whatever they say.

use std::num::NonZeroUsize;

use glam::Vec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

/// Flights kept at most; of more every second is left out, and so on.
const FLIGHTS_MAX: u64 = 1 << 15;

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
    /// - `count`: so many at most
    pub fn of(all: impl Iterator<Item = Flight>, count: u64) -> Option<Flights> {
        let stride = count.div_ceil(FLIGHTS_MAX).max(1) as usize;
        let (ends, begun): (Vec<[f32; 3]>, Vec<(Vec3, f32)>) =
            all.step_by(stride).map(|flight| (flight.to.to_array(), (flight.from, flight.flux_w))).unzip();
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
