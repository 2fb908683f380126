//! The progressive loop: a view of a world, a film, and the technique that fills it.
//!
//! Imports every room to its left; the server talks to this one.

use std::sync::{Arc, atomic::AtomicBool};

use crate::{
    film::{Film, PictureSize},
    scene::CameraView,
    technique::{
        Card, Counts, Progress, Step, Technique,
        path::{PathClasses, PathSettings, PathTracer, View},
    },
    transport::World,
};

/// What computes indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Indirect {
    /// The best chain that exists so far: the path tracer.
    #[default]
    Auto,
    /// The path tracer.
    Path,
    /// Nothing: only light seen directly and direct light are shown.
    None,
}

/// How a picture is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderSettings {
    /// Technique of indirect light.
    pub indirect: Indirect,
    /// Most scatterings of a path (1: emission and direct light); `None`: no bound.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
}

/// A picture in the making.
pub struct Rendering {
    world: Arc<World>,
    view: View,
    film: Film,
    technique: Box<dyn Technique>,
    counts: Counts,
}

impl std::fmt::Debug for Rendering {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rendering")
            .field("technique", &self.card().name)
            .field("counts", &self.counts)
            .finish()
    }
}

impl Rendering {
    /// An empty film of `view`.
    pub fn new(
        world: Arc<World>,
        view: CameraView,
        size: PictureSize,
        settings: RenderSettings,
    ) -> Rendering {
        let classes = match settings.indirect {
            Indirect::Auto | Indirect::Path => PathClasses::All,
            Indirect::None => PathClasses::EmittedAndDirect,
        };
        let settings = PathSettings { classes, bounces_max: settings.bounces_max, seed: settings.seed };
        Rendering {
            view: View::new(&world, &view, size),
            world,
            film: Film::new(size),
            technique: Box::new(PathTracer::new(settings)),
            counts: Counts::default(),
        }
    }

    /// One step of the technique on the rayon pool it is called in; ends early, between tiles, once `cancel` is true.
    /// The film is valid after every step, cancelled or not.
    pub fn step(&mut self, cancel: &AtomicBool) -> Progress {
        let mut step = Step { world: &self.world, view: &self.view, film: &mut self.film, cancel };
        let progress = self.technique.step(&mut step);
        self.counts += progress.counts;
        progress
    }

    /// The picture so far.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// The world it shows.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Work done so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Samples that every pixel has.
    pub fn passes(&self) -> u32 {
        self.film.passes_min()
    }

    /// The technique at work.
    pub fn card(&self) -> &'static Card {
        self.technique.card()
    }
}
