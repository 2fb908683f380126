//! Techniques: ways to compute light, behind one interface.
//!
//! A technique works one bounded step at a time, on a film or on the [`Products`] that others read, and is told of every
//! change of the scene. Siblings never import each other: what they share lies here. The `path` technique is the reference
//! and the last stage of convergence.

pub mod caustics;
pub mod irradiance;
pub mod octree;
pub mod path;
pub mod photons;
mod products;

use std::{
    iter::Sum,
    ops::{Add, AddAssign, Sub},
    sync::atomic::AtomicBool,
};

pub use path::{Lookout, View};
pub use products::*;

use crate::{
    film::Film,
    scene::SceneChange,
    transport::{PathClass, Source, World},
};

/// How an estimate relates to the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bias {
    /// Right on average at every sample count.
    Unbiased,
    /// Right in the limit.
    Consistent,
    /// Keeps an error that no sampling removes.
    Biased,
}

/// What a technique says of itself.
#[derive(Clone, Copy, Debug)]
pub struct Card {
    /// Name in command lines, messages and statistics.
    pub name: &'static str,
    /// Path classes it estimates.
    pub classes: &'static [PathClass],
    /// Relation to the truth.
    pub bias: Bias,
}

/// Work done, for statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Rays that looked for the nearest surface.
    pub rays: u64,
    /// Rays that asked whether a light is hidden.
    pub shadow_rays: u64,
    /// Paths begun at the eye.
    pub paths: u64,
}

impl Counts {
    /// Rays of both kinds.
    pub fn all_rays(&self) -> u64 {
        self.rays + self.shadow_rays
    }
}

impl Add for Counts {
    type Output = Counts;
    fn add(self, o: Counts) -> Counts {
        Counts {
            rays: self.rays + o.rays,
            shadow_rays: self.shadow_rays + o.shadow_rays,
            paths: self.paths + o.paths,
        }
    }
}

impl Sub for Counts {
    type Output = Counts;
    fn sub(self, o: Counts) -> Counts {
        Counts {
            rays: self.rays - o.rays,
            shadow_rays: self.shadow_rays - o.shadow_rays,
            paths: self.paths - o.paths,
        }
    }
}

impl AddAssign for Counts {
    fn add_assign(&mut self, o: Counts) {
        *self = *self + o;
    }
}

impl Sum for Counts {
    fn sum<I: Iterator<Item = Counts>>(counts: I) -> Counts {
        counts.fold(Counts::default(), Add::add)
    }
}

/// What one step may use.
pub struct Step<'a> {
    /// The scene.
    pub world: &'a World,
    /// What techniques make for each other.
    pub products: &'a mut Products,
    /// What to draw on; `None` while only products are made.
    pub canvas: Option<Canvas<'a>>,
    /// Turns true when the answer is no longer wanted; checked between tiles.
    pub cancel: &'a AtomicBool,
}

/// A camera and its film.
pub struct Canvas<'a> {
    /// The camera.
    pub view: &'a View,
    /// The film to add to.
    pub film: &'a mut Film,
}

/// A change of the scene.
#[derive(Clone, Copy, Debug)]
pub struct Edit<'a> {
    /// The scene as it was.
    pub before: &'a World,
    /// The scene as it is.
    pub after: &'a World,
    /// What differs.
    pub change: &'a SceneChange,
}

impl Edit<'_> {
    /// The lights send out the same before and after it.
    pub fn leaves_lights(&self) -> bool {
        let [before, after] = [self.before.sources(), self.after.sources()];
        let is_same = |(a, b): (&Source, &Source)| a.name() == b.name() && a.emits_like(b);
        before.len() == after.len() && before.iter().zip(&after).all(is_same)
    }
}

/// What one step achieved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Work done.
    pub counts: Counts,
    /// The piece of work is done: every tile got its sample, every product is made.
    pub complete: bool,
}

/// One way to compute light.
pub trait Technique: Send {
    /// What it is.
    fn card(&self) -> &'static Card;

    /// Does one bounded piece of work: for techniques that sample the picture, one sample for every pixel.
    fn step(&mut self, step: &mut Step<'_>) -> Progress;

    /// Withdraws exactly what the edit made stale.
    fn apply(&mut self, edit: &Edit<'_>);
}
