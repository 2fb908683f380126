//! How much work is left until a picture has an error, by what is known of its films (`chain.rs`) and of its light.

use super::{
    accuracy::DOUBTED,
    chain::{Outlook, Shortfall},
};
use crate::film::MeasuredError;

/// Samples of a picture are counted in steps of this share of those it has.
const STEP_SHARE: f64 = 0.05;
/// Work beyond which nothing is foretold, in shares of the work done so far.
const WORK_MAX: f64 = 1e6;

/// What is left to do for a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Remaining {
    /// Nothing: it is as good as asked for.
    Nothing,
    /// So many rays, and samples of every pixel.
    Work {
        /// Rays of all kinds, those of learning and measuring included.
        rays: f64,
        /// Samples of every pixel, further ones.
        passes: f64,
    },
    /// No work will do: the technique's own error is this much, √relMSE.
    OutOfReach {
        /// As far as it is known by now.
        error: f64,
    },
}

/// What is still to be learnt of a picture's light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToLearn {
    /// Nothing.
    Nothing,
    /// Records, one by one: the error falls steadily, at first about as noise does.
    Records,
    /// Rounds of photons: with each the error falls at once, nobody knows how far. Of forecasts from before the last round, for nine
    /// views, one of five came true.
    Rounds,
}

/// How fast the squared error of samples falls with their number, over some doublings: theirs are low-discrepancy points, and of
/// eleven views it fell with the 1.05th to 1.2th power from 8 to 128. Nothing is known of many more: there it is taken to fall as
/// one over their number.
const NOISE_POWER: f64 = 1.1;
/// So many times as many samples at most.
const NOISE_KNOWN: f64 = 16.0;

/// How many times smaller so many times as many samples make the noise.
pub(super) fn noise_gain(times: f64) -> f64 {
    times * times.clamp(1.0, NOISE_KNOWN).powf(NOISE_POWER - 1.0)
}

/// How many times as much work makes the noise so many times smaller.
fn work_for(gain: f64) -> f64 {
    let known = NOISE_KNOWN.powf(NOISE_POWER);
    if gain <= known { gain.max(1.0).powf(1.0 / NOISE_POWER) } else { NOISE_KNOWN * gain / known }
}

/// What is left for a picture whose error falls as noise with the work done.
///
/// - `rays`, `passes`: done so far
pub(super) fn as_noise(measured: &MeasuredError, target: f64, rays: f64, passes: f64) -> Option<Remaining> {
    // By the time it is small enough it is known so much better.
    let growth = work_for(measured.rel_mse / (target * target));
    let more = work_for(measured.rel_mse / allowed(measured, target, growth)) - 1.0;
    (more < WORK_MAX && passes > 0.0).then_some(Remaining::Work { rays: more * rays, passes: more * passes })
}

/// How much larger than it may be the upper end of a measure's interval is in the mean when it first is small enough: pictures are looked
/// at again and again, and the first look that says so is a lucky one. Of 448 forecasts for twelve views 37 % came true within a quarter
/// of the time without, most others named too late a time; 43 % so, 41 % with 1.18.
/// What is not there yet takes work all the same: luck comes with looks.
const LUCK: f64 = 1.09;

/// relMSE at which a picture counts as good enough: with an error that is known badly the estimate has to be lower, so that the
/// upper end of its interval is low enough as well.
///
/// - `growth`: work on measuring by then over that so far, of which chance takes off as much (`measuring.rs`)
fn allowed(measured: &MeasuredError, target: f64, growth: f64) -> f64 {
    let [_, high] = measured.interval_95;
    let doubt = (high / measured.rel_mse.max(f64::MIN_POSITIVE)).max(1.0);
    let doubt = 1.0 + (doubt - 1.0) / growth;
    let luck = 1.0 + (LUCK - 1.0) * (1.0 - 1.0 / growth);
    let surely = (luck * MeasuredError::SURENESS * target).powi(2) / doubt;
    surely.min(target * target)
}

/// A picture of looked-up light on its way to an error.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way<'a> {
    pub(super) outlook: &'a Outlook,
    pub(super) measured: &'a MeasuredError,
    pub(super) target: f64,
    /// Rays done so far, and share of them that measuring had.
    pub(super) rays: f64,
    pub(super) measuring_share: f64,
    /// Measuring takes as much work as drawing once only doubt is left.
    pub(super) is_aimed_at: bool,
    /// Rays until it is found out that the error is there, once it seems so.
    pub(super) to_agree: f64,
    /// Path tracing may join.
    pub(super) traces: bool,
    /// Rays that had been spent when what is still learnt of its light began to be, all that were where that is not known or does not matter;
    /// `None` where nothing is.
    pub(super) learnt_since: Option<f64>,
}

/// Share that learning leaves at the least of the squared error that only it takes off, as it was when records began. From the first forecasts on,
/// errors as they are told fell by 1 to 2.3 times on eleven views and by 3.5 in a room with spots; then learning ended, and what was foretold of
/// finer errors as if all fell like noise for ever went from half a minute to half an hour. Of some 270 forecasts for eleven views by `auto`
/// within 30 s, made while records were, 89 were for a time that went by without it where this counted from each forecast on, and 77 where it counts
/// from when records began.
const UNLEARNABLE: f64 = 0.1;

impl Way<'_> {
    /// What is left of it.
    pub(super) fn remaining(&self) -> Option<Remaining> {
        let Way { outlook, target, traces, learnt_since, .. } = *self;
        let learns = learnt_since.is_some();
        let mut films = outlook.films();
        // As it was measured last, which may be better known than what the films were weighed by.
        let scale = (self.measured.rel_mse / films.error(outlook, 1.0)).clamp(0.1, 10.0);
        let rays = self.rays.max(1.0);
        let least_unlearnt = learnt_since.map_or(1.0, |since| (UNLEARNABLE * rays / since.max(1.0)).min(1.0));
        let (begun, mut more, mut growth) = (films.passes(), 0.0, 1.0);
        loop {
            // What is learnt takes off as much as work adds, as noise falls.
            let unlearnt = (rays / (rays + more)).max(least_unlearnt);
            let is_learning = unlearnt > least_unlearnt;
            let error = scale * films.error(outlook, unlearnt);
            if error <= allowed(self.measured, target, growth) {
                let drawn = films.passes() - begun;
                let passes = drawn + films.passes() * self.to_agree / (rays + more);
                return Some(Remaining::Work { rays: more + self.to_agree, passes });
            }
            let Shortfall { floor, sure_floor, .. } = outlook.shortfall();
            if !traces && !is_learning && scale * unlearnt * floor >= target * target {
                // Its own error may also only seem too large, as long as it is known badly.
                let is_sure = !learns && sure_floor >= target * target;
                return is_sure.then(|| Remaining::OutOfReach { error: (scale * floor).sqrt() });
            }
            if !(more <= WORK_MAX * rays) {
                return None;
            }
            let spent = if is_learning {
                films.go_on(STEP_SHARE);
                STEP_SHARE * (rays + more)
            } else {
                films.advance(outlook, STEP_SHARE, traces, unlearnt)
            };
            growth += spent / rays;
            more += spent;
            // Not before all is known of the light.
            if self.is_aimed_at && !learns && error <= (DOUBTED * target).powi(2) {
                growth += spent / (rays * self.measuring_share);
                more += spent;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Learning brings an error near what there is sooner than path tracing would, and path tracing one far below later than if all fell
    /// like noise; by looked-up light alone nothing is said of that.
    #[test]
    fn learning_brings_what_is_near() {
        let outlook = Outlook::after_64_passes(1e-4, 3e-3, 1.0);
        let measured = MeasuredError { rel_mse: 3.1e-3, interval_95: [3.09e-3, 3.11e-3], trimmed: None };
        let rays = 1e7;
        let way = Way {
            outlook: &outlook,
            measured: &measured,
            target: 0.01,
            rays,
            measuring_share: 0.05,
            is_aimed_at: false,
            to_agree: 0.0,
            traces: true,
            learnt_since: None,
        };
        let remaining = |target, learns: bool, traces| {
            Way { target, traces, learnt_since: learns.then_some(rays), ..way }.remaining()
        };
        let more = |remaining: Option<Remaining>| match remaining {
            Some(Remaining::Work { rays, .. }) => rays,
            other => panic!("{other:?}"),
        };
        let [near, near_traced] = [true, false].map(|learns| more(remaining(0.03, learns, true)));
        assert!(near > 1.5 * rays && near < 0.5 * near_traced, "{near:e} {near_traced:e}");
        let [far, far_traced] = [true, false].map(|learns| more(remaining(0.01, learns, true)));
        let as_noise = more(as_noise(&measured, 0.01, rays, 64.0));
        assert!(far > 2.0 * as_noise && far < far_traced, "{far:e} {as_noise:e} {far_traced:e}");
        assert_eq!(remaining(0.01, true, false), None);
        assert!(matches!(remaining(0.01, false, false), Some(Remaining::OutOfReach { .. })));
        assert!((more(remaining(0.03, true, false)) / near - 1.0).abs() < 1e-9);
        // What has long been learnt is near its end.
        let [long_learnt, hardly_learnt] =
            [0.05, 0.5].map(|share| more(Way { learnt_since: Some(share * rays), ..way }.remaining()));
        assert!(
            long_learnt > 1.05 * hardly_learnt && hardly_learnt > 1.05 * far,
            "{long_learnt:e} {hardly_learnt:e} {far:e}"
        );
        assert!(long_learnt < 1.1 * far_traced);
    }

    /// What does not count as reached has work left, however lucky the first look will be that finds it.
    #[test]
    fn what_is_not_reached_takes_work() {
        for doubt in [1.0, 1.2, 1.3, 1.43, 2.0, 5.0] {
            for rel_mse in [0.3, 0.7, 1.0, 1.001, 1.3] {
                let rel_mse = rel_mse * 4e-4;
                let measured = MeasuredError { rel_mse, interval_95: [0.0, doubt * rel_mse], trimmed: None };
                let Some(Remaining::Work { rays, .. }) = as_noise(&measured, 0.02, 1e6, 16.0) else {
                    panic!()
                };
                assert_eq!(rays == 0.0, measured.reaches(0.02), "{rel_mse:e}, {doubt}: {rays}");
            }
        }
    }

    /// The work for a gain is what has that gain.
    #[test]
    fn noise_falls_as_fast_as_is_said() {
        for gain in [1.0, 1.5, 4.0, 21.0, 22.0, 1e6] {
            assert!((noise_gain(work_for(gain)) / gain - 1.0).abs() < 1e-9, "{gain}");
        }
        assert_eq!(work_for(0.2), 1.0);
        assert!((work_for(10.0) - 8.11).abs() < 0.01 && (work_for(1e4) / work_for(1e3) - 10.0).abs() < 1e-9);
    }
}
