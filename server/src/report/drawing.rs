//! A picture that is drawn for some time and looked at now and then.

use std::{
    sync::atomic::AtomicBool,
    time::{Duration, Instant},
};

use lumicast_engine::{
    film::{ImageError, compare},
    render::{IlluminationSettings, Indirect, Learning, RenderSettings, Rendering},
};

use super::{
    ReportError,
    subject::{Prepared, Subject},
};

/// A picture in the making.
pub(super) struct Drawing {
    pub(super) prepared: Prepared,
    pub(super) rendering: Rendering,
    spent: Duration,
}

impl Drawing {
    /// Nothing drawn yet; what is learnt is learnt on the way.
    pub(super) fn begin(prepared: Prepared, indirect: Indirect) -> Drawing {
        let settings = RenderSettings { indirect, ..RenderSettings::default() };
        Drawing::learning_by(prepared, settings, IlluminationSettings::of(&settings))
    }

    /// The same, with settings of its own.
    pub(super) fn learning_by(
        prepared: Prepared,
        settings: RenderSettings,
        illumination: IlluminationSettings,
    ) -> Drawing {
        let settings = RenderSettings { learning: Learning::Alongside { until: None }, ..settings };
        let scene = (prepared.world.clone(), illumination);
        let rendering = Rendering::learning_by(scene, prepared.view, prepared.size, settings);
        Drawing { prepared, rendering, spent: Duration::ZERO }
    }

    /// Goes on until so much time was spent on it.
    pub(super) fn advance(&mut self, until: Duration) {
        let never = AtomicBool::new(false);
        while self.spent < until || self.rendering.passes() == 0 {
            let start = Instant::now();
            self.rendering.step(&never);
            self.spent += start.elapsed();
        }
    }

    /// Seconds spent on it.
    pub(super) fn seconds(&self) -> f64 {
        self.spent.as_secs_f64()
    }

    /// How far it is from the reference, if there is one.
    pub(super) fn error(&self, subject: &Subject) -> Result<Option<ImageError>, ReportError> {
        let Some(reference) = &self.prepared.reference else { return Ok(None) };
        let error = compare(&self.rendering.picture().radiance(), &reference.full);
        error.map(Some).map_err(|error| ReportError::Text {
            what: "the comparison with a reference",
            reason: format!("{}: {error}", subject.name),
        })
    }
}
