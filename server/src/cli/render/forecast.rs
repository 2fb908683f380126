//! How good the picture is while it is made, and when it will be how good: for the progress bar and `--stats`.

use lumicast_engine::{
    film::MeasuredError,
    render::{Expected, Forecasts, Rendering, ToLearn, When},
};
use lumicast_protocol::{Forecast, ForecastRecord, Preset};

use super::stop::StopRule;
use crate::convert::{forecast, forecast_record};

/// Between two looks at the film: measuring its error costs a few milliseconds on large pictures.
const PAUSE_SECONDS: f64 = 0.2;
/// And this share of the time so far.
const PAUSE_SHARE: f64 = 0.1;

/// What was last seen of the picture, and what is expected of it.
#[derive(Debug)]
pub(super) struct Outlook {
    forecasts: Forecasts,
    /// The error asked for.
    target: Option<f64>,
    samples_max: Option<u32>,
    next_seconds: f64,
    measured: Option<MeasuredError>,
    expected: Vec<Expected>,
}

impl Outlook {
    /// For the presets and the error asked for.
    pub(super) fn new(rule: &StopRule) -> Outlook {
        Outlook {
            forecasts: Forecasts::new(&Preset::errors_with(rule.error)),
            target: rule.error,
            samples_max: rule.samples,
            next_seconds: 0.0,
            measured: None,
            expected: Vec::new(),
        }
    }

    /// Looks at the picture again if it is time.
    pub(super) fn look_if_due(&mut self, rendering: &Rendering, seconds: f64) {
        if seconds >= self.next_seconds && rendering.passes() > 0 {
            self.look(rendering, seconds);
        }
    }

    /// Looks at the picture again.
    fn look(&mut self, rendering: &Rendering, seconds: f64) {
        self.next_seconds = seconds + PAUSE_SECONDS.max(PAUSE_SHARE * seconds);
        self.measured = rendering.measured_error();
        self.expected =
            self.forecasts.look(seconds, rendering, self.measured, ToLearn::Nothing, self.samples_max);
    }

    /// Looks at the finished picture; what should have come by now and has not was foretold wrongly.
    pub(super) fn end(&mut self, rendering: &Rendering, seconds: f64) {
        self.look(rendering, seconds);
        self.forecasts.resume(seconds);
    }

    /// Its error, last time.
    pub(super) fn measured(&self) -> Option<MeasuredError> {
        self.measured
    }

    /// What is expected of the error asked for, in words, or else of the next preset that is not reached yet.
    pub(super) fn words(&self) -> Option<String> {
        let is_meant = |expected: &&Expected| match self.target {
            Some(target) => (expected.target - target).abs() < 1e-6,
            None => matches!(expected.when, When::In { .. }),
        };
        let expected = self.expected.iter().find(is_meant)?;
        let percent = 100.0 * (expected.target * 1e6).round() / 1e6;
        let seems_there = self.measured.is_some_and(|measured| measured.error() <= expected.target);
        match expected.when {
            When::Reached { .. } | When::Unknown => None,
            // Told beside an error that is no larger, when it will be there would look wrong.
            When::In { .. } if seems_there => Some(format!("surely {percent} % {}", forecast(expected))),
            _ => Some(format!("{percent} % {}", forecast(expected))),
        }
    }

    /// For `--stats`.
    pub(super) fn facts(&self) -> Vec<Forecast> {
        self.expected.iter().map(forecast).collect()
    }

    /// How many forecasts came true.
    pub(super) fn record(&self) -> ForecastRecord {
        forecast_record(self.forecasts.record())
    }
}
