//! The path tracer: every path class, from the eye, with light sampling and multiple importance sampling.
//!
//! Unbiased for every class it is asked for [Kajiya1986; Veach1997, 10]. Each lobe of a surface is sampled on its own,
//! and light samples are weighed lobe by lobe with the power heuristic (β = 2), so every contribution
//! knows its exact [`PathClass`]. Numbers come from Owen-scrambled Sobol points by (seed, pass, pixel, dimension).
//! The interpolated normal alone says which side a direction is on, as in the references: asking the true normal as well
//! drops light wherever the two disagree (2 % of a Sponza gallery, a third of single bumps of a rough floor), at the
//! price that a thin sheet with badly bent normals may let light through.
//! Paths end by Russian roulette once their throughput is small; nothing is clamped.
//! Where photons tell where light comes from, half of the diffuse directions are drawn by that ([`super::Guide`]).
//!
//! With a [`SecondaryLight`] it samples light seen directly and direct light alone and asks that for the rest. Some samples on,
//! what lies so near that it is lost in the blur shadows what that knows, and is asked in turn for what it sends there instead
//! (the far field known, the near one traced [Arikan2005]). The same tracer answers for the rays that others gather light along
//! ([`ArrivingLight`]).
//!
//! What it cannot find: light from point, spot and directional lights by way of mirrors and glass (a density zero path
//! for any eye path), as in every path tracer, but for that of suns straight through panes ([`World::through_panes`]). The caustics room brings it, where [`super::Products::caustics`] holds that
//! alone; the picture is then consistent, no more unbiased.

#[cfg(test)]
mod closed_forms;
mod cpu;
mod gauge;
#[cfg(feature = "gpu")]
mod gpu;
mod guided;
#[cfg(test)]
mod tests;
mod view;

use std::sync::{Arc, atomic::Ordering};

use glam::UVec2;
use rayon::prelude::*;

pub use gauge::{Gauge, SampleCost};
#[cfg(feature = "gpu")]
pub use gpu::{
    ArrivingByGpu, Asked, GpuGatherer, GpuPathTracer, GpuPhotons, GpuScene, MapsCompared, Shading, Shadows,
    ShownAs, SplatBy, SplatSeconds, Splatted, StepSeconds, rays_over_a_picture,
};
pub use view::{Lookout, View};

use super::{
    ArrivingLight, Bias, Card, Counts, Edit, FirstSight, FocusedLight, Guidance, Guide, LeftToSampling,
    Progress, ScatteredLight, ScreenLight, SecondaryLight, Step, Technique,
};
use crate::{
    accel::{Hit, Ray},
    film::{Film, PictureSize, Tile},
    math::{Rgb, sobol::PixelSampler},
    transport::{PathClass, PathClasses, ShadowRay, World},
};
use cpu::{BLURRED_SAMPLES, BOUNCES_END, Near, Seen, Tracer, primary_ray};

/// Parameters of the path tracer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathSettings {
    /// Paths that are shown.
    pub shown: PathClasses,
    /// Paths that are traced.
    pub traced: PathClasses,
    /// What else falls on the first diffuse surface is asked of [`PathTracer::with_secondary`] and of
    /// [`super::Products::caustics`], if there are any; these then hold all of it.
    pub asks: bool,
    /// Most scatterings of a path; 1 = light by one scattering only. `None`: Russian roulette alone ends paths.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// A sky is drawn from where it shows ([`World::opening_at`]), where all paths are traced by way of panes as well
    /// ([`World::through_panes`]): less noise in rooms, and no other light. Paths on a card do without, and so does who goes on with one.
    pub knows_openings: bool,
}

impl PathSettings {
    /// All paths.
    pub fn all(bounces_max: Option<u32>, seed: u64) -> PathSettings {
        PathSettings {
            shown: PathClasses::ALL,
            traced: PathClasses::ALL,
            asks: false,
            bounces_max,
            seed,
            knows_openings: false,
        }
    }

    /// Light through panes that is for light sampling alone to find: what is known of focused light leaves it. Where nothing is known, no path
    /// meets a sun; where all is asked for at the first diffuse surface, that is known there.
    fn left_to_sampling(&self, known: Option<&dyn FocusedLight>) -> LeftToSampling {
        match known {
            Some(known) => known.leaves(),
            None if self.asks => LeftToSampling::Nothing,
            None => LeftToSampling::Suns,
        }
    }

    /// The first sample of each half of a pixel's for which what lies near shadows known light. Never where scatterings are bounded:
    /// what is known of what lies near has as many behind it as what is known of the surface that it lies near to, not one less.
    fn shadowed_from(&self) -> u32 {
        if self.bounces_max.is_some() { u32::MAX } else { BLURRED_SAMPLES }
    }

    /// Paths go on where nothing is known. Never where scatterings are bounded, for the same reason.
    fn passes_missing(&self) -> bool {
        self.bounces_max.is_none_or(|bounces| bounces >= BOUNCES_END)
    }

    /// Light seen directly and direct light; the rest is asked for.
    pub fn asking(self) -> PathSettings {
        PathSettings { traced: PathClasses::SEEN_AND_DIRECT, asks: true, ..self }
    }
}

/// Path tracing on the CPU, on the rayon pool it is called in. Keeps nothing between steps but the film, and known
/// light as it lies on the view that was last drawn.
#[derive(Debug)]
pub struct PathTracer {
    settings: PathSettings,
    secondary: Option<Arc<dyn SecondaryLight>>,
    /// The same for the view that was last drawn, where it can be laid out for it.
    screen: Option<(View, Option<Arc<dyn ScreenLight>>)>,
    /// What knows where light comes from, for those that it does not ask.
    guided_by: Option<Arc<dyn SecondaryLight>>,
}

static CARD: Card = Card { name: "path", classes: &PathClass::ALL, bias: Bias::Unbiased };

impl PathTracer {
    /// A path tracer.
    pub fn new(settings: PathSettings) -> PathTracer {
        PathTracer { settings, secondary: None, screen: None, guided_by: None }
    }

    /// A tracer of light seen directly and direct light that asks `secondary` for the rest at the first diffuse surface.
    pub fn with_secondary(settings: PathSettings, secondary: Arc<dyn SecondaryLight>) -> PathTracer {
        PathTracer { secondary: Some(secondary), ..PathTracer::new(settings.asking()) }
    }

    /// Lets those photons say where light comes from that `known` was made of: less noise, and no other light. Else those of what it asks
    /// do, as far as it asks.
    pub fn guided_by(self, known: Option<Arc<dyn SecondaryLight>>) -> PathTracer {
        PathTracer { guided_by: known, ..self }
    }

    /// It asks others for light that comes by way of other surfaces.
    pub fn asks(&self) -> bool {
        self.settings.asks
    }

    /// What answers where it asks.
    pub fn secondary(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.secondary.as_ref()
    }

    /// What is known of where light comes from.
    pub fn guide(&self) -> Option<&Guide> {
        self.guided_by.as_ref().or(self.secondary.as_ref())?.guide()
    }

    /// The same for its own paths: where others are asked for what comes by way of other surfaces, light sampling finds the rest.
    fn guide_of_paths(&self) -> Option<&Guide> {
        if self.settings.asks { None } else { self.guide() }
    }

    /// Seconds that laying known light out over pictures took so far, of all threads.
    pub fn splat_seconds(&self) -> f64 {
        self.screen.iter().filter_map(|(_, light)| light.as_ref()).map(|light| light.thread_seconds()).sum()
    }

    /// What is known of light, laid out for a view. It lacks caustics, which something else must bring where there are any.
    fn lay_out_for(&mut self, view: &View, has_caustics_apart: bool) {
        let Some(secondary) = &self.secondary else { return };
        let shows_caustics = self.settings.shown.contains(PathClass::Caustic);
        if shows_caustics && !has_caustics_apart && secondary.has_caustics() {
            self.screen = None;
        } else if self.screen.as_ref().is_none_or(|(of, _)| of != view) {
            self.screen = Some((*view, Arc::clone(secondary).laid_out_for(view)));
        }
    }
}

impl Technique for PathTracer {
    fn card(&self) -> &'static Card {
        self.secondary.as_ref().map_or(&CARD, |secondary| secondary.card())
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        let Some(canvas) = &mut step.canvas else {
            return Progress { complete: true, ..Progress::default() };
        };
        let view = canvas.view;
        self.lay_out_for(view, step.products.caustics.is_some());
        let tracer = Tracer {
            view: Some(view),
            secondary: self.secondary.as_deref(),
            screen: self.screen.as_ref().and_then(|(_, light)| light.as_deref()),
            caustics: step.products.caustics.as_deref(),
            near: Near::Shadowed,
            guide: self.guide_of_paths(),
            ..Tracer::of(step.world, self.settings)
        };
        let film = &mut *canvas.film;
        let width = film.size().width();
        // After a cancelled step the tiles it did not reach come first: steps that are all cut short still make progress
        // over the whole picture, and together they are the same pass.
        let [least, most] = [film.passes_min(), film.passes_max()];
        let done: Vec<Option<Counts>> = film
            .tiles_mut()
            .par_iter_mut()
            // Tile by tile: left alone, threads take halves of the picture, and the one with the easy half waits.
            .with_max_len(1)
            .filter(|tile| least == most || tile.passes() < most)
            .map(|tile| {
                let mut counts = Counts::default();
                (!step.cancel.load(Ordering::Relaxed)).then(|| {
                    trace_tile(&tracer, view, tile, width, &mut counts);
                    counts
                })
            })
            .collect();
        Progress { complete: done.iter().all(Option::is_some), counts: done.into_iter().flatten().sum() }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // Nothing is kept of the scene between steps: known light is of the scene that whoever made this tracer knows.
    }
}

impl ArrivingLight for PathTracer {
    fn radiance(
        &self,
        world: &World,
        ray: &Ray,
        met: Option<Hit>,
        sampler: &PixelSampler,
        counts: &mut Counts,
    ) -> Rgb {
        let secondary = self.secondary.as_deref();
        let tracer = Tracer {
            secondary,
            near: Near::LookedPast,
            guide: self.guide_of_paths(),
            ..Tracer::of(world, self.settings)
        };
        let sample = tracer.sample_pixel(ray, met, sampler, counts);
        let scattered = PathClass::ALL.iter().filter(|class| class.meets_diffuse());
        scattered.fold(Rgb::BLACK, |sum, class| sum + sample.radiance[*class as usize])
    }

    fn guide(&self) -> Option<&Guide> {
        PathTracer::guide(self)
    }
}

/// Who is told of the rays of a path.
trait Tally {
    fn path(&mut self);
    fn ray(&mut self, ray: &Ray);
    fn shadow_ray(&mut self, ray: &ShadowRay);
}

impl Tally for Counts {
    fn path(&mut self) {
        self.paths += 1;
    }

    fn ray(&mut self, _ray: &Ray) {
        self.rays += 1;
    }

    fn shadow_ray(&mut self, _ray: &ShadowRay) {
        self.shadow_rays += 1;
    }
}

/// A question that path tracing asked of the trees.
#[derive(Clone, Copy, Debug)]
pub enum Query {
    /// What is nearest?
    Closest(Ray),
    /// Is anything in the way?
    Occluded(ShadowRay),
}

impl Tally for Vec<Query> {
    fn path(&mut self) {}

    fn ray(&mut self, ray: &Ray) {
        self.push(Query::Closest(*ray));
    }

    fn shadow_ray(&mut self, ray: &ShadowRay) {
        self.push(Query::Occluded(*ray));
    }
}

/// The rays of one pass in the order they are traced, tile by tile, for measuring the bare ray rate.
pub fn rays_of_a_pass(
    world: &World,
    view: &View,
    size: PictureSize,
    settings: PathSettings,
) -> Vec<Vec<Query>> {
    let tracer = Tracer { view: Some(view), ..Tracer::of(world, settings) };
    let record = |tile: &mut Tile| {
        let mut queries = Vec::new();
        trace_tile(&tracer, view, tile, size.width(), &mut queries);
        queries
    };
    Film::new(size).tiles_mut().par_iter_mut().map(record).collect()
}

/// One sample for every pixel of the tile.
fn trace_tile(tracer: &Tracer<'_>, view: &View, tile: &mut Tile, width: u32, tally: &mut impl Tally) {
    // Even and odd passes draw from sequences of their own: the two halves of the film must be independent.
    let (sequence, index) = (tile.passes() & 1, tile.passes() >> 1);
    let (origin, size) = (tile.origin(), tile.size());
    let pixels = pixels_in_blocks(size);
    let samplers: Vec<PixelSampler> = pixels
        .iter()
        .map(|pixel| {
            let pixel = *pixel + origin;
            PixelSampler::new(tracer.settings.seed, sequence, pixel.y * width + pixel.x, index)
        })
        .collect();
    // The first rays of neighbouring pixels go almost the same way: asked for together, they take half the time.
    let rays: Vec<Ray> = pixels
        .iter()
        .zip(&samplers)
        .map(|(pixel, sampler)| primary_ray(view, pixel.x + origin.x, pixel.y + origin.y, sampler))
        .collect();
    let mut met = vec![None; rays.len()];
    tracer.world.closest_hits(&rays, &mut met);
    let mut place = vec![0; pixels.len()];
    for (at, pixel) in pixels.iter().enumerate() {
        place[(pixel.y * size.x + pixel.x) as usize] = at;
    }
    let seen = tracer.screen.map(|screen| {
        let sight = |at: &usize| {
            let (hit, way) = (met[*at]?, rays[*at].direction);
            Some(FirstSight { surface: tracer.world.surface(&hit, way), wo: -way })
        };
        let sights: Vec<Option<FirstSight>> = place.iter().map(sight).collect();
        let indirect = screen.scattered_over(origin, size, &sights);
        (sights, indirect)
    });
    tile.add_pass(|x, y| {
        let pixel = ((y - origin.y) * size.x + x - origin.x) as usize;
        let at = place[pixel];
        let seen = seen.as_ref().and_then(|(sights, indirect)| {
            Some(Seen { sight: sights[pixel].as_ref()?, indirect: indirect[pixel] })
        });
        tracer.sample_seen(&rays[at], (met[at], seen), &samplers[at], tally)
    });
}

/// The pixels of a tile, eight that lie together after eight that lie together.
fn pixels_in_blocks(size: UVec2) -> Vec<UVec2> {
    const BLOCK: UVec2 = UVec2::new(4, 2);
    let mut pixels = Vec::with_capacity((size.x * size.y) as usize);
    for top in (0..size.y).step_by(BLOCK.y as usize) {
        for left in (0..size.x).step_by(BLOCK.x as usize) {
            let end = (UVec2::new(left, top) + BLOCK).min(size);
            pixels.extend((top..end.y).flat_map(|y| (left..end.x).map(move |x| UVec2::new(x, y))));
        }
    }
    pixels
}
