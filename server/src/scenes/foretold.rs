//! What one viewer is told of when its picture will be how good, and how often that came true.

use super::viewer_film::Layer;
use crate::convert;
use lumicast_engine::film::MeasuredError;
use lumicast_engine::render::{Expected, ForecastRecord, Forecasts, ToLearn};
use lumicast_protocol::{self as wire, Preset};

/// Forecasts of one viewer's pictures.
#[derive(Debug)]
pub(super) struct Foretold {
    forecasts: Forecasts,
    /// By the last picture; empty while that is smaller than asked for.
    expected: Vec<Expected>,
    /// What was judged when it was last asked.
    told: ForecastRecord,
}

/// A picture that is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look<'a> {
    pub(super) layer: &'a Layer,
    pub(super) measured: Option<MeasuredError>,
    /// Seconds since its film restarted.
    pub(super) seconds: f64,
    /// What is still to be learnt of its light.
    pub(super) to_learn: ToLearn,
    /// It rests at so many samples.
    pub(super) samples_max: u32,
    /// The viewer's own target, √relMSE; 0: none.
    pub(super) target: f64,
}

impl Default for Foretold {
    fn default() -> Foretold {
        Foretold { forecasts: Forecasts::new(&[]), expected: Vec::new(), told: ForecastRecord::default() }
    }
}

impl Foretold {
    /// Another picture is begun.
    pub(super) fn restart(&mut self) {
        self.forecasts.restart();
        self.expected.clear();
    }

    /// The picture goes on after a rest, so many seconds after it was begun.
    pub(super) fn wake(&mut self, seconds: f64) {
        self.forecasts.resume(seconds);
    }

    /// The picture is smaller than asked for: nothing is said.
    pub(super) fn pause(&mut self) {
        self.expected.clear();
    }

    /// Says anew when the picture will be how good; returns what was judged since the last time of what was said before.
    pub(super) fn look(&mut self, look: Look<'_>) -> ForecastRecord {
        self.forecasts.aim(&Preset::errors_with((look.target > 0.0).then_some(look.target)));
        let rendering = &look.layer.rendering;
        self.expected = self.forecasts.look(
            look.seconds,
            rendering,
            look.measured,
            look.to_learn,
            Some(look.samples_max),
        );
        let record = self.forecasts.record();
        record.since(std::mem::replace(&mut self.told, record))
    }

    /// For the viewer's statistics.
    pub(super) fn facts(&self) -> Vec<wire::Forecast> {
        self.expected.iter().map(convert::forecast).collect()
    }

    /// For the viewer's statistics.
    pub(super) fn record(&self) -> wire::ForecastRecord {
        convert::forecast_record(self.forecasts.record())
    }
}
