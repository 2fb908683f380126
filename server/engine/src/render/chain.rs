//! Who draws next, and how far the picture is from the truth, where what is drawn is looked up in what was learnt.
//!
//! A [`Gauge`] measures the picture by a share of the work. It also finds what a path-traced sample costs and how noisy it is,
//! which with the noise of the looked-up film says what one more sample of either kind would take off the error of the blend
//! ([`Picture`]): with e² the squared error of the looked-up film and v / n that of n path-traced samples, the blend's
//! inverse is 1/e² + n/v.

use std::sync::atomic::AtomicBool;

use super::hidden::HiddenHalves;
use crate::{
    film::{BLACK_PASSES, Film, MeasuredError, Picture, PictureSize, measure_at},
    technique::{
        Counts, View,
        path::{Gauge, PathSettings},
    },
    transport::{PathClass, World},
};

/// Share of all rays that measuring takes: some 5 % of the time, since its rays go farther than most.
const GAUGE_SHARE: f64 = 0.03;
/// Samples of each half of a gauge's pixels before it is believed.
const SAMPLES_BELIEVED: u32 = 16;
/// The next decision falls due when the picture has this share of samples more than at the last: deciding looks at all pixels.
const DECIDED_GROWTH: f64 = 0.125;
/// More pixels instead of more samples for those there are, once these are as well known as the picture is, and with so many
/// samples in any case: at equal cost that leaves the least doubt of the mean.
const SAMPLES_ENOUGH: [f64; 2] = [32.0, 16_384.0];
/// Share of its noise in the error of a picture below which more samples of it change nothing.
const NOISE_NEGLIGIBLE: f64 = 0.02;

/// Measures one picture.
#[derive(Debug)]
pub(super) struct Measuring {
    gauge: Gauge,
    rays: u64,
    samples_enough: f64,
    /// Where error is expected, and the film's passes when it was found.
    expected: (u32, Vec<f32>),
    /// What path tracing cannot find.
    pub(super) hidden: Option<HiddenHalves>,
}

impl Measuring {
    pub(super) fn new(settings: PathSettings, size: PictureSize, hidden: Option<HiddenHalves>) -> Measuring {
        Measuring {
            gauge: Gauge::new(settings, size),
            rays: 0,
            samples_enough: SAMPLES_ENOUGH[0],
            expected: (0, Vec::new()),
            hidden,
        }
    }

    /// Measures until its share of `rays_spent` is used up.
    ///
    /// - `film`: of looked-up light
    pub(super) fn keep_up(
        &mut self,
        (world, view): (&World, &View),
        film: &Film,
        rays_spent: u64,
        cancel: &AtomicBool,
    ) -> Counts {
        let mut all = Counts::default();
        let is_due = |rays: u64| (rays as f64) < GAUGE_SHARE * rays_spent as f64;
        while is_due(self.rays) {
            if let Some(hidden) = self.hidden.as_mut().filter(|hidden| hidden.is_due()) {
                let progress = hidden.renew(world, cancel);
                self.rays += progress.counts.all_rays();
                all += progress.counts;
                if !progress.complete {
                    return all;
                }
                continue;
            }
            // Looked for anew when the film has twice the passes: it takes a look at every pixel.
            if film.passes_min() >= 2 * self.expected.0.max(1) {
                self.expected = (film.passes_min(), expected_error(film));
            }
            let maps = self.hidden.as_ref().map_or([None, None], HiddenHalves::maps);
            let expected = &self.expected.1;
            let counts = self.gauge.step((world, view), self.samples_enough, expected, maps, cancel);
            if counts == Counts::default() {
                return all;
            }
            if let Some(hidden) = &mut self.hidden {
                hidden.measured(counts.all_rays());
            }
            self.rays += counts.all_rays();
            all += counts;
        }
        all
    }

    /// The error of a picture of the view; `None` while too little is known.
    ///
    /// - `film`: the looked-up film in it
    pub(super) fn error_of(&self, picture: &Picture<'_>, film: &Film) -> Option<MeasuredError> {
        if self.gauge.samples() < SAMPLES_BELIEVED {
            return None;
        }
        let radiance = picture.radiance();
        // Nothing is seen, and nothing found where there might be something.
        if radiance.iter().all(|colour| colour.is_black()) {
            let is_black = self.gauge.is_black() && film.passes_min() >= BLACK_PASSES;
            return is_black.then_some(MeasuredError::NONE);
        }
        let error = measure_at(&radiance, picture.size(), &self.gauge.pixels())?;
        // No difference at any of the pixels says nothing of the others, unless none of them has any noise.
        let says_nothing = error.interval_95 == [0.0; 2] && film.noise().is_none_or(|(noise, _)| noise > 0.0);
        (!says_nothing).then_some(error)
    }
}

/// Where a film of looked-up light may be wrong: where its samples differ, as at edges and in reflections, and where there
/// are caustics, whose shapes are blurred. Relative to what is shown there, as the error is.
fn expected_error(film: &Film) -> Vec<f32> {
    let shown = film.radiance();
    let mean = shown.iter().map(|colour| colour.luminance()).sum::<f32>() / shown.len() as f32;
    let caustics = film.layer(PathClass::Caustic);
    let variance = film.variance();
    let passes = film.passes_min().max(1) as f32;
    (0..shown.len())
        .map(|index| {
            let scale = shown[index].luminance().powi(2) + 0.01 * mean * mean;
            let wrong = caustics[index].luminance().powi(2) + passes * variance[index];
            if scale > 0.0 { (wrong / scale).min(f32::MAX / shown.len() as f32) } else { 0.0 }
        })
        .collect()
}

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// The film drawn with what was learnt.
    LookedUp,
    /// The path-traced film.
    Traced,
}

/// Passes of one film, and rays spent on them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spent {
    pub(super) passes: u32,
    pub(super) rays: u64,
}

impl Spent {
    fn rays_a_pass(self) -> f64 {
        self.rays as f64 / f64::from(self.passes.max(1))
    }
}

/// What was last found of the films.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlook {
    /// Samples a pixel of both when it was found.
    samples: u32,
    /// relMSE of the looked-up film, as far as it is its noise; and over how many passes; and the rest, which no sample lowers.
    noise: f64,
    passes: u32,
    floor: f64,
    /// relMSE of a single path-traced pass.
    variance: f64,
    /// Rays of a pass of either film.
    looked_up_rays: f64,
    traced_rays: f64,
}

impl Outlook {
    /// `None` while too little is known.
    ///
    /// - `film`, `traced`: of looked-up light, and path-traced
    pub(super) fn of(
        (film, spent): (&Film, Spent),
        traced: Option<(&Film, Spent)>,
        measuring: &mut Measuring,
    ) -> Option<Outlook> {
        let cost = measuring.gauge.cost()?;
        let (noise, passes) = film.noise()?;
        let by_gauge = measuring.error_of(&Picture::of(film), film)?;
        let by_tracing =
            traced.and_then(|(traced, _)| Picture::blended(film, traced).measured_error_of_film());
        let error = by_tracing.map_or(by_gauge, |error| by_gauge.surer(error)).rel_mse;
        let pixel_count = film.size().pixel_count() as f64;
        // Passes are spread better over what there is to see than samples drawn one by one: their own noise is known best.
        let known = traced.and_then(|(film, spent)| Some((film.noise()?, spent)));
        let (variance, traced_rays) = match known {
            Some(((noise, passes), spent)) => (noise * f64::from(passes), spent.rays_a_pass()),
            None => (cost.variance, cost.rays * pixel_count),
        };
        let [least, most] = SAMPLES_ENOUGH;
        measuring.samples_enough = (cost.variance / error.max(1e-12)).clamp(least, most);
        Some(Outlook {
            samples: spent.passes + traced.map_or(0, |(_, spent)| spent.passes),
            noise,
            passes,
            floor: (error - noise).max(0.0),
            variance,
            looked_up_rays: spent.rays_a_pass(),
            traced_rays,
        })
    }

    /// It is old.
    pub(super) fn is_due(&self, samples: u32) -> bool {
        f64::from(samples) > (1.0 + DECIDED_GROWTH) * f64::from(self.samples)
    }

    /// Further samples of the looked-up film would change next to nothing.
    pub(super) fn is_at_its_floor(&self) -> bool {
        self.noise < NOISE_NEGLIGIBLE * (self.noise + self.floor)
    }

    /// Whose next pass takes more off the error of the blend for each ray.
    pub(super) fn turn(&self) -> Turn {
        let error = (self.noise + self.floor).max(f64::MIN_POSITIVE);
        let looked_up = self.noise / f64::from(self.passes) / error / error / self.looked_up_rays.max(1.0);
        let traced = 1.0 / (self.variance * self.traced_rays).max(f64::MIN_POSITIVE);
        if looked_up > traced { Turn::LookedUp } else { Turn::Traced }
    }

    /// Path tracing for all the rays spent so far would have left less error than what is learnt so far leaves however long it
    /// is sampled.
    pub(super) fn tracing_would_have_done(&self, rays_spent: u64) -> bool {
        let passes = rays_spent as f64 / self.traced_rays.max(1.0);
        self.variance / passes.max(1e-9) < self.floor
    }
}
