//! What is drawn where the first of what is learnt takes a great part of the time there is.
//!
//! Mostly that is known within some hundredths of a second, and nothing is drawn before. Among thousands of leaves or seats it takes a second:
//! of a picture that is due after one or three, path tracing may have shown more by then. A few pixels, traced before, tell what it would come to.
//! Only pictures that learn for themselves alone: what others go on with is learnt first.

use std::{
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};

use super::{Indirect, Learning, Rendering, Stage, all_paths};
use crate::{
    math::sobol,
    technique::path::{Gauge, PathSettings},
};

/// Share of the time there is after which it counts as long in coming: before, a look at what path tracing would come to costs more than it
/// brings.
const LONG_SHARE: f64 = 0.05;
/// relMSE that pictures have in the end where it does, about: trees, seats and halls are off by 10 to 20 % as long as little else is known …
const LEARNT_ERROR: f64 = 0.02;
/// … and by more the less time is left to show it: twice as much where it comes after this share of the time.
const LATE_SHARE: f64 = 0.25;
/// Times the time there is that is waited for it where path tracing will not do better: with a sample or two of it seats and a library are off by a
/// fifth to two fifths of what they are without.
const WAITED_MOST: f64 = 2.0;
/// Share of the work that path tracing may have meanwhile, at least where it will do better, and at most: the later it gets, the less comes of
/// the rest.
const TRACED_SHARES: [f64; 2] = [0.5, 0.95];
/// Passes of it that there must be time for, all in all, and from which on they tell what they come to: a few say nothing.
const PASSES_TELLING: u32 = 8;

/// Looks at a set of pixels each, at most. The one that finds most noise counts, since the others may have missed what is rare.
const LOOKS_MAX: u32 = 4;
/// Pixels of the picture for each.
const PIXELS_A_LOOK: usize = 10_000;
/// Share of the time there is that they may take.
const LOOKS_SHARE: f64 = 0.03;
/// Names their random numbers.
const AHEAD_SEED: u64 = 0x6168_6561_6400;

/// What path tracing would come to, as a look at some pixels told, and its passes since then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Foreseen {
    /// relMSE of a pass; infinite where only black was found.
    pub(super) variance: f64,
    /// What a pass takes.
    pub(super) pass_seconds: f64,
    /// Passes that told so; none where few pixels did: they miss what is rare.
    pub(super) passes: u32,
}

impl Foreseen {
    /// Share of the work that goes into path tracing while nothing is known of the light.
    ///
    /// - `seconds`: that there are for the picture, and of them those that are over
    fn traced_share(self, [seconds, over]: [f64; 2]) -> f64 {
        let passes = seconds / self.pass_seconds.max(f64::MIN_POSITIVE);
        let left = self.variance / passes;
        let learnt = LEARNT_ERROR * (1.0 + (over / seconds / LATE_SHARE).powi(2));
        if passes < f64::from(PASSES_TELLING) || !(left < learnt) {
            return 0.0;
        }
        let [least, most] = TRACED_SHARES;
        let most = if self.passes < PASSES_TELLING { least } else { most };
        (learnt / (learnt + left)).clamp(least, most)
    }

    /// Passes tell it anew when there are twice as many.
    ///
    /// - `rel_mse`: their noise
    /// - `pass_seconds`: of each
    fn told_by(self, rel_mse: f64, passes: u32, pass_seconds: f64) -> Foreseen {
        let variance = rel_mse * f64::from(passes);
        let variance = if passes < PASSES_TELLING { variance.max(self.variance) } else { variance };
        Foreseen { variance, pass_seconds, passes }
    }
}

/// Looks at some pixels, a set in each step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LookAhead {
    looks: u32,
    /// Of the noisiest.
    variance: f64,
    took: Duration,
}

/// How it is with a picture that awaits its light.
#[derive(Debug, Default)]
pub(super) struct Awaiting {
    /// Nobody else goes on with what it learns.
    pub(super) is_alone: bool,
    since: Option<Instant>,
    look: LookAhead,
    /// Once that was looked at.
    pub(super) foreseen: Option<Foreseen>,
    /// Passes go into the path-traced film.
    traces: bool,
}

impl Rendering {
    /// Nothing is known of the light of a picture that is due at a moment, and is to be the best that there is then. From that moment on nothing
    /// more is learnt.
    fn awaits_light_until(&self) -> Option<Instant> {
        let Learning::Alongside { until: Some(until) } = self.settings.learning else { return None };
        let is_awaited = self.course.awaiting.is_alone
            && self.settings.indirect == Indirect::Auto
            && self.settings.traces_unknown()
            && !self.looks_up()
            && self.learner.as_ref().is_some_and(|learner| learner.stage() == Stage::Nothing);
        is_awaited.then_some(until)
    }

    /// A pass is due though nothing is known of the light: it did not come in time, or takes long to come and path tracing will do better.
    pub(super) fn draws_meanwhile(&mut self, cancel: &AtomicBool) -> bool {
        let Some(until) = self.awaits_light_until() else { return false };
        let since = *self.course.awaiting.since.get_or_insert_with(Instant::now);
        let seconds = until.saturating_duration_since(since).as_secs_f64();
        let is_over = Instant::now() >= until;
        if self.done.all >= LONG_SHARE * seconds && !is_over && self.is_foreseeable() {
            self.look_ahead(seconds, cancel);
        }
        let foreseen = self.foreseen();
        let share = foreseen.map_or(0.0, |foreseen| foreseen.traced_share([seconds, self.done.all]));
        self.course.awaiting.traces = share > 0.0;
        if is_over {
            return share > 0.0 || since.elapsed().as_secs_f64() >= WAITED_MOST * seconds;
        }
        self.done.looked_up + self.done.traced < share * self.done.all
    }

    /// Passes that are drawn while nothing is known go into the film that stays.
    pub(super) fn traces_meanwhile(&self) -> bool {
        self.course.awaiting.traces && self.awaits_light_until().is_some()
    }

    /// Some pixels tell what path tracing would come to: not of what a card draws, nor where photons bring what paths do not find.
    fn is_foreseeable(&self) -> bool {
        #[cfg(feature = "gpu")]
        let is_by_cpu = self.gpu.is_none();
        #[cfg(not(feature = "gpu"))]
        let is_by_cpu = true;
        is_by_cpu && self.hidden.iter().all(Option::is_none)
    }

    /// What path tracing would come to, as far as that is known by now.
    fn foreseen(&mut self) -> Option<Foreseen> {
        let foreseen = self.course.awaiting.foreseen.as_mut()?;
        if let Some(film) =
            self.traced.as_ref().filter(|film| film.passes_min() >= 2 * foreseen.passes.max(1))
            && let Some((noise, passes)) = film.noise()
        {
            let pass_seconds = self.done.traced / f64::from(passes);
            *foreseen = foreseen.told_by(noise.rel_mse, passes, pass_seconds);
        }
        Some(*foreseen)
    }

    /// Looks at some more pixels, until that was done often enough.
    ///
    /// - `seconds`: that there are for the picture
    fn look_ahead(&mut self, seconds: f64, cancel: &AtomicBool) {
        if self.course.awaiting.foreseen.is_some() {
            return;
        }
        let begun = self.begin();
        let size = self.film.size();
        let mut look = self.course.awaiting.look;
        let settings = all_paths(&self.settings);
        let seed = sobol::mix(settings.seed ^ (AHEAD_SEED + u64::from(look.looks)));
        let mut gauge = Gauge::new(PathSettings { seed, ..settings }, size);
        let of = (&*self.world, &self.view);
        // The first samples wait for pixels to be chosen, which says nothing of what a pass takes.
        let counts = gauge.step(of, 1, &[], [None, None], None, cancel);
        let chosen = Instant::now();
        let more = gauge.step(of, u32::MAX, &[], [None, None], None, cancel);
        let sample_seconds = chosen.elapsed().as_secs_f64() / more.paths.max(1) as f64;
        self.counts += counts + more;
        self.done.all += self.work_since(&begun);
        if more.paths == 0 {
            // Cut short.
            return;
        }
        look.looks += 1;
        look.variance = look.variance.max(gauge.cost().map_or(f64::INFINITY, |cost| cost.variance));
        look.took += begun.start.elapsed();
        self.course.awaiting.look = look;
        let looks = (size.pixel_count() / PIXELS_A_LOOK).clamp(1, LOOKS_MAX as usize) as u32;
        if look.looks >= looks || look.took.as_secs_f64() >= LOOKS_SHARE * seconds {
            let pass_seconds = sample_seconds * size.pixel_count() as f64;
            let foreseen = Foreseen { variance: look.variance, pass_seconds, passes: 0 };
            self.course.awaiting.foreseen = Some(foreseen);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Path tracing has a share of the work where it will do better than what is learnt, the more the better and the later that comes, and none
    /// where it will not, where there is no time for more than a few passes, and where nothing but black was found.
    #[test]
    fn path_tracing_has_a_share_where_it_will_do_better() {
        let told = Foreseen { variance: 1.0, pass_seconds: 0.01, passes: PASSES_TELLING };
        let share = |variance, times| Foreseen { variance, ..told }.traced_share(times);
        let [least, most] = TRACED_SHARES;
        assert_eq!(share(2.1, [1.0, 0.0]), 0.0);
        assert_eq!(share(1.9, [1.0, 0.0]), 0.02 / 0.039);
        assert!((share(1.0, [1.0, 0.0]) - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(share(1e-3, [1.0, 0.0]), most);
        assert_eq!(share(1e-3, [0.07, 0.0]), 0.0);
        assert_eq!(Foreseen { passes: PASSES_TELLING - 1, ..told }.traced_share([1.0, 0.0]), least);
        // After a quarter of the time twice as much error is expected.
        assert_eq!(share(2.1, [1.0, 0.25]), 0.04 / 0.061);
        assert_eq!(share(4.1, [1.0, 0.25]), 0.0);
        for unknown in [f64::INFINITY, f64::NAN] {
            assert_eq!(share(unknown, [1.0, 0.5]), 0.0);
        }
        for none in [Foreseen { pass_seconds: 0.0, ..told }, Foreseen { variance: 0.0, ..told }] {
            assert_eq!(none.traced_share([1.0, 0.1]), most);
            assert_eq!(none.traced_share([0.0, 0.1]), 0.0, "no time at all");
        }
    }

    /// A few passes make it worse at most; then they alone tell.
    #[test]
    fn passes_tell_better_than_few_pixels() {
        let looked = Foreseen { variance: 0.5, pass_seconds: 0.01, passes: 0 };
        assert_eq!(looked.told_by(0.1, 2, 0.01).variance, 0.5);
        let told = looked.told_by(1.0, 2, 0.02);
        assert_eq!(told, Foreseen { variance: 2.0, pass_seconds: 0.02, passes: 2 });
        assert_eq!(told.told_by(0.025, 8, 0.03), Foreseen { variance: 0.2, pass_seconds: 0.03, passes: 8 });
    }
}
