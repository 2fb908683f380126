//! What a rendering tells of itself: its films, what went into them and what its picture is made by.

use std::sync::Arc;

use super::Rendering;
use crate::{
    film::{Film, Picture, PictureSize},
    technique::{Counts, Technique},
    transport::World,
};

/// Share of the path-traced film below which a picture does not show it, and above which it shows nothing else.
const SHARE_SHOWN: f64 = 0.01;

impl Rendering {
    /// The film that is drawn with what is known of the light: all of the picture, but for path tracing beside it.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// Its size.
    pub fn size(&self) -> PictureSize {
        self.film.size()
    }

    /// The world it shows.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Work done so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Work done so far, in rays of the CPU: what cards did counts by the time it took.
    pub fn spent_rays(&self) -> u64 {
        self.counts.all_rays().saturating_add_signed(self.surplus_rays)
    }

    /// Samples that every pixel has.
    pub fn passes(&self) -> u32 {
        self.films().map(Film::passes_min).sum()
    }

    /// Passes with what is known of the light: of every pixel, and of some where one was cut.
    pub fn lit_passes(&self) -> [u32; 2] {
        [self.film.passes_min(), self.film.passes_max()]
    }

    /// Every pixel has as many.
    pub fn is_whole(&self) -> bool {
        self.films().all(|film| film.passes_min() == film.passes_max())
    }

    /// Samples of all pixels together.
    pub fn sample_count(&self) -> u64 {
        self.films().map(Film::sample_count).sum()
    }

    /// Samples that were not finite or negative, and count as black.
    pub fn dropped_samples(&self) -> u64 {
        self.films().map(Film::dropped_samples).sum()
    }

    /// Memory of its films.
    pub fn film_bytes(&self) -> usize {
        self.films().map(Film::bytes).sum()
    }

    fn films(&self) -> impl Iterator<Item = &Film> {
        std::iter::once(&self.film).chain(&self.traced)
    }

    /// Share of the path-traced film in a picture that [`Rendering::picture`] returned, mean over its pixels; 1 where all light is path-traced.
    pub fn path_traced_share(&self, picture: &Picture<'_>) -> f64 {
        let is_path = self.looked_up_name() == "path";
        if is_path { 1.0 } else { picture.traced_share() }
    }

    /// Name of what a picture that [`Rendering::picture`] returned is made by.
    pub fn technique_name(&self, picture: &Picture<'_>) -> &'static str {
        let looked_up = self.looked_up_name();
        match (picture.traced_share(), looked_up) {
            (share, _) if share < SHARE_SHOWN => looked_up,
            (share, _) if share > 1.0 - SHARE_SHOWN => "path",
            (_, "octree") => "octree+path",
            (_, "irradiance") => "irradiance+path",
            (_, "caustics") => "caustics+path",
            (_, _) => "path",
        }
    }

    /// What its first film is made by.
    fn looked_up_name(&self) -> &'static str {
        match &self.caustics {
            Some(_) if self.learnt.is_none() => "caustics",
            _ => self.technique.card().name,
        }
    }
}
