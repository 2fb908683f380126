//! When a rendering is done.

use std::{num::NonZeroU32, time::Duration};

use lumicast_engine::{film::MeasuredError, render::Rendering, technique::irradiance::Visits};

/// Why a rendering ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopReason {
    /// `--samples`.
    Samples,
    /// `--time`.
    Time,
    /// `--error`.
    Error,
    /// `--error` is less than the technique can reach.
    Best,
    /// SIGINT or SIGTERM.
    Signal,
}

impl StopReason {
    /// Word for statistics and messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            StopReason::Samples => "samples",
            StopReason::Time => "time",
            StopReason::Error => "error",
            StopReason::Best => "best",
            StopReason::Signal => "signal",
        }
    }
}

/// Bounds of a rendering; the first that is reached ends it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StopRule {
    /// Samples per pixel.
    pub(super) samples: Option<u32>,
    /// Time since the scene was loaded.
    pub(super) time: Option<Duration>,
    /// Measured error, √relMSE.
    pub(super) error: Option<f64>,
}

/// Before this many samples per pixel the measured error ends nothing: light that one path in ten finds is still
/// missing from a fifth of the pixels (0.9¹⁶), and a pixel that has not found it believes to be done.
const ERROR_SAMPLES_MIN: u32 = 16;
/// Looked-up light is measured by many samples of other pixels: there is nothing to wait for.
const LOOKED_UP_SAMPLES_MIN: u32 = 2;

impl StopRule {
    /// The bounds asked for; 2 % error or 60 seconds when none is.
    pub(super) fn new(samples: Option<u32>, time: Option<Duration>, error: Option<f64>) -> StopRule {
        if samples.is_none() && time.is_none() && error.is_none() {
            StopRule { samples, time: Some(Duration::from_secs(60)), error: Some(0.02) }
        } else {
            StopRule { samples, time, error }
        }
    }

    /// How often light is gathered for records: as often as a number of samples is worth, if nothing else is asked for.
    pub(super) fn visits(&self, usual: Visits) -> Visits {
        let alone = self.samples.filter(|_| self.time.is_none() && self.error.is_none());
        alone.and_then(NonZeroU32::new).map_or(usual, |samples| usual.for_samples(samples))
    }

    /// Whether a picture of whole passes is done. Depends on nothing but its films, so that without a time limit the
    /// stopping point is the same on every machine.
    pub(super) fn is_done_with(&self, rendering: &Rendering) -> Option<StopReason> {
        let passes = rendering.passes();
        if self.samples.is_some_and(|samples| passes >= samples) && rendering.knows_its_light() {
            return Some(StopReason::Samples);
        }
        let mut measured = None;
        let passes_min = if rendering.is_looked_up() { LOOKED_UP_SAMPLES_MIN } else { ERROR_SAMPLES_MIN };
        let by_error = self.by_error(passes, passes_min, || {
            measured = rendering.measured_error();
            measured
        });
        let by_error = by_error.filter(|_| self.error.is_some_and(|target| rendering.confirms(target)));
        let is_out_of_reach = || {
            let (error, target) = (measured?, self.error?);
            (rendering.is_at_its_best() && is_surely_above(&error, target)).then_some(StopReason::Best)
        };
        by_error.or_else(is_out_of_reach)
    }

    /// Whether so many passes are done by their error.
    fn by_error(
        &self,
        passes: u32,
        passes_min: u32,
        measured: impl FnOnce() -> Option<MeasuredError>,
    ) -> Option<StopReason> {
        let target = self.error?;
        if passes < passes_min || !is_check_point(passes) {
            return None;
        }
        match measured() {
            Some(error) if error.reaches(target) => Some(StopReason::Error),
            _ => None,
        }
    }
}

/// Interval of an error, high over low, that is narrow enough to say on which side of another one it lies.
const NARROW: f64 = 1.3;

/// The error is above the target, and not only because little is known of it.
fn is_surely_above(error: &MeasuredError, target: f64) -> bool {
    let [low, high] = error.error_interval_95();
    error.error() > target && (low > target || high < NARROW * low)
}

/// The measured error is looked at about every 6 % of the samples: often enough to waste little, seldom enough that
/// waiting for a lucky value gains nothing. Even counts only: there the halves of a path-traced film are equal.
fn is_check_point(passes: u32) -> bool {
    let step = (passes / 16).next_power_of_two().max(2);
    passes >= LOOKED_UP_SAMPLES_MIN && passes.is_multiple_of(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::{
        film::{Film, PictureSize, PixelSample},
        math::Rgb,
        technique::irradiance::IrradianceSettings,
    };

    fn film_of(passes: u32, radiance: impl Fn(u32) -> f32) -> Film {
        let mut film = Film::new(PictureSize::new(8, 8).unwrap());
        for pass in 0..passes {
            let mut sample = PixelSample::BLACK;
            sample.radiance[0] = Rgb::splat(radiance(pass));
            film.tiles_mut().iter_mut().for_each(|tile| tile.add_pass(|_, _| sample));
        }
        film
    }

    fn is_done(rule: &StopRule, film: &Film) -> Option<StopReason> {
        rule.by_error(film.passes_min(), ERROR_SAMPLES_MIN, || film.measured_error())
    }

    /// Each bound ends the rendering by itself, and nothing ends it before.
    #[test]
    fn each_bound_ends_the_rendering() {
        let error = StopRule::new(None, None, Some(0.1));
        assert_eq!(is_done(&error, &film_of(14, |_| 1.0)), None);
        assert_eq!(is_done(&error, &film_of(16, |_| 1.0)), Some(StopReason::Error));
        // The halves see 0 and 2: 100 % apart at any count.
        assert_eq!(is_done(&error, &film_of(64, |pass| (pass % 2 * 2) as f32)), None);
        assert_eq!(is_done(&error, &film_of(62, |_| 0.0)), None);
        assert_eq!(is_done(&error, &film_of(64, |_| 0.0)), Some(StopReason::Error));
    }

    /// Without a bound there is one.
    #[test]
    fn there_is_always_a_bound() {
        let rule = StopRule::new(None, None, None);
        assert_eq!((rule.time, rule.error), (Some(Duration::from_secs(60)), Some(0.02)));
        assert_eq!(StopRule::new(Some(1), None, None).time, None);
    }

    /// Where a time or an error is asked for, or many samples are, light is learnt as well as ever.
    #[test]
    fn light_is_learnt_for_few_samples_alone() {
        let usual = IrradianceSettings::default().visits;
        let of = |samples, time, error| StopRule::new(samples, time, error).visits(usual);
        let few = of(Some(4), None, None);
        assert!(few == usual.for_samples(4.try_into().unwrap()) && few != usual, "{few:?}");
        assert_eq!(of(Some(64), None, None), usual);
        assert_eq!(of(Some(4), Some(Duration::from_secs(9)), None), usual);
        assert_eq!(of(Some(4), None, Some(0.1)), usual);
        assert_eq!(of(None, None, None), usual);
    }

    /// Checks are at even counts, at most 13 % apart from 16 on.
    #[test]
    fn checks_are_even_and_never_far_apart() {
        let checks: Vec<u32> = (1..100_000).filter(|passes| is_check_point(*passes)).collect();
        assert_eq!(checks[0], LOOKED_UP_SAMPLES_MIN);
        assert!(checks.iter().all(|passes| passes % 2 == 0));
        assert!(checks.windows(2).all(|pair| f64::from(pair[1]) <= (f64::from(pair[0]) * 1.13).max(16.0)));
    }
}
