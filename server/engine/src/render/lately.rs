//! The error of a picture while records of its light are made, steadied by what was measured of it lately.

use super::{ToLearn, forecast::push_bounded};
use crate::film::MeasuredError;

/// What was measured in this last share of all work counts. Of eleven views by `auto` for 50 s, forecasts made while records were, 27 % came
/// true within a quarter of the time by single measures, and 38, 40 and 37 % by those of the last 0.25, 0.4 and 0.6 of the work.
const LATELY: f64 = 0.4;

/// What was measured lately, while records are made.
#[derive(Clone, Debug, Default)]
pub(super) struct MeasuredLately {
    /// Rays that had been spent when the first were.
    since_rays: Option<f64>,
    looks: Vec<Look>,
}

/// What was measured once.
#[derive(Clone, Copy, Debug)]
struct Look {
    rays: f64,
    /// Its logarithm, and how far above it the upper end of its interval is.
    ln_rel_mse: f64,
    ln_doubt: f64,
}

impl MeasuredLately {
    /// Takes in what is measured now.
    ///
    /// - `rays`: spent so far, fewer than the last time where another film was begun
    pub(super) fn note(&mut self, rays: f64, measured: Option<&MeasuredError>, to_learn: ToLearn) {
        // Another film was begun at another size.
        let is_another = self.looks.last().is_some_and(|look| rays < look.rays);
        if to_learn != ToLearn::Records || is_another {
            *self = MeasuredLately::default();
        }
        let Some(measured) =
            measured.filter(|measured| to_learn == ToLearn::Records && measured.rel_mse > 0.0)
        else {
            return;
        };
        self.since_rays.get_or_insert(rays);
        self.looks.retain(|look| look.rays >= (1.0 - LATELY) * rays);
        let [_, high] = measured.interval_95;
        let ln_rel_mse = measured.rel_mse.ln();
        let ln_doubt = (high / measured.rel_mse).max(1.0).ln();
        push_bounded(&mut self.looks, Look { rays, ln_rel_mse, ln_doubt });
    }

    /// Rays that had been spent when the first records were looked at; `None` unless records are made.
    pub(super) fn since_rays(&self) -> Option<f64> {
        self.since_rays
    }

    /// The error now by all that was measured lately, taken to fall as one over the work meanwhile; the last measure where that is all there is.
    pub(super) fn error(&self, last: MeasuredError) -> MeasuredError {
        let Some(Look { rays, .. }) = self.looks.last() else { return last };
        let count = self.looks.len() as f64;
        let now = |look: &Look| look.ln_rel_mse + (look.rays / rays).ln();
        let rel_mse = (self.looks.iter().map(now).sum::<f64>() / count).exp();
        let doubt = (self.looks.iter().map(|look| look.ln_doubt).sum::<f64>() / count).exp();
        let [low, _] = last.interval_95;
        MeasuredError { rel_mse, interval_95: [low.min(rel_mse), doubt * rel_mse], trimmed: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(rel_mse: f64) -> MeasuredError {
        MeasuredError { rel_mse, interval_95: [0.5 * rel_mse, 2.0 * rel_mse], trimmed: None }
    }

    /// Measures that are off by twice either way leave an error that is right, and what was long ago has no say.
    #[test]
    fn errors_are_steadied_while_records_are_made() {
        let mut lately = MeasuredLately::default();
        let true_error = |rays: f64| 1e-2 / rays;
        lately.note(1.0, Some(&measured(1e6)), ToLearn::Records);
        for look in 2..=40 {
            let rays = f64::from(look);
            let off = if look % 2 == 0 { 2.0 } else { 0.5 };
            lately.note(rays, Some(&measured(off * true_error(rays))), ToLearn::Records);
            assert_eq!(lately.since_rays(), Some(1.0));
        }
        let now = lately.error(measured(2.0 * true_error(40.0)));
        assert!((now.rel_mse / true_error(40.0)).ln().abs() < 0.05, "{now:?}");
        assert!((now.interval_95[1] / now.rel_mse - 2.0).abs() < 1e-9);
        assert!(now.interval_95[0] <= now.rel_mse);
    }

    /// While photons are sent out, when all is known, and once a film is begun anew the last measure stands as it is.
    #[test]
    fn errors_are_steadied_by_records_alone() {
        let of_records = || {
            let mut lately = MeasuredLately::default();
            lately.note(5.0, Some(&measured(1.0)), ToLearn::Records);
            lately
        };
        for to_learn in [ToLearn::Rounds, ToLearn::Nothing] {
            let mut lately = of_records();
            lately.note(6.0, Some(&measured(1e-3)), to_learn);
            assert_eq!((lately.since_rays(), lately.error(measured(1e-3))), (None, measured(1e-3)));
        }
        let mut lately = of_records();
        lately.note(50.0, Some(&measured(1e-2)), ToLearn::Records);
        lately.note(8.0, Some(&measured(1e-3)), ToLearn::Records);
        assert_eq!(lately.since_rays(), Some(8.0));
        assert!((lately.error(measured(1e-3)).rel_mse - 1e-3).abs() < 1e-9);
        // Nothing measured, or nothing wrong.
        let mut lately = of_records();
        lately.note(6.0, None, ToLearn::Records);
        lately.note(7.0, Some(&MeasuredError::NONE), ToLearn::Records);
        assert_eq!(lately.looks.len(), 1);
    }
}
