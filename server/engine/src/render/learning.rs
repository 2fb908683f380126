//! What a picture learns of its light by itself, and how that shares the work with drawing.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{Illumination, Learning, RecordReport, Rendering, Stage, tracer};
use crate::{
    film::Outdated,
    technique::{Progress, SecondaryLight},
    transport::PathClass,
};

/// Work on learning for each that goes into drawing while there is more to learn: before it is measured what the picture is
/// short of, and at least and at most afterwards.
const LEARNING_SHARE: f64 = 1.0;
const LEARNING_SHARES: [f64; 2] = [0.25, 5.0];

/// Share of the time there is for learning within which a round comes soon: the sooner it ends, the larger the next may be.
const SOON_SHARE: f64 = 1.0 / 3.0;

/// How learning goes on beside drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// By what the picture is short of.
    Shared,
    /// Before anything more is drawn: it, or what follows, would not end in time otherwise.
    Now,
    /// Not at all: it would not end in time.
    Never,
}

impl Rendering {
    /// Learns of the scene's light; `None` when a pass is due. The first pass is drawn with the first rough answer; then
    /// both go on beside each other until all is known. What is sampled of direct light is kept throughout.
    pub(super) fn learn(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let (is_late, spent_before) = (self.is_late(), self.spent_rays());
        let (until, pace) = (self.learns_until(), self.pace());
        let learner = self.learner.as_mut()?;
        let is_pass_due = match learner.stage() {
            Stage::Nothing => false,
            Stage::Rough if self.settings.learning == Learning::First => false,
            Stage::Rough if self.film.passes_min() == 0 || is_late => true,
            Stage::Rough => match pace {
                Pace::Shared => self.lead > 0.0,
                Pace::Now => false,
                Pace::Never => true,
            },
            Stage::Complete => true,
        };
        if is_pass_due {
            if is_late && learner.shows_all() {
                let known = learner.known().cloned();
                self.relight(known, Outdated::Rough);
            }
            return None;
        }
        let start = Instant::now();
        if let Some(moment) = until {
            learner.allow(moment.saturating_duration_since(start).as_secs_f64());
        }
        let is_first = learner.stage() == Stage::Nothing;
        let before = learner.counts();
        let is_better = learner.step(&self.world, cancel);
        let counts = learner.counts() - before;
        let known = learner.known().cloned();
        if is_better {
            self.relight(known, Outdated::Rough);
        }
        self.counts += counts;
        #[cfg(feature = "gpu")]
        self.note_cpu_work(counts.all_rays(), start);
        if !is_first {
            self.lead += self.work(start, spent_before);
        }
        Some(Progress { counts, complete: false })
    }

    /// How learning is to go on with the time there is for it: what is not known by its end was learnt for nothing.
    fn pace(&self) -> Pace {
        let (Some(moment), Some(learner)) = (self.learns_until(), &self.learner) else { return Pace::Shared };
        let Some((left, is_followed)) = learner.seconds_left_of_round() else { return Pace::Shared };
        let time = moment.saturating_duration_since(Instant::now()).as_secs_f64();
        if left > time {
            Pace::Never
        } else if left * (1.0 + 1.0 / self.learning_share()) > time
            || is_followed && left <= SOON_SHARE * time
        {
            Pace::Now
        } else {
            Pace::Shared
        }
    }

    /// From when on nothing more is learnt.
    fn learns_until(&self) -> Option<Instant> {
        match self.settings.learning {
            Learning::Alongside { until } => until,
            Learning::First | Learning::InStep => None,
        }
    }

    /// Work on learning for each on drawing, by what the picture is short of.
    pub(super) fn learning_share(&self) -> f64 {
        let [least, most] = LEARNING_SHARES;
        self.shortfall.map_or(LEARNING_SHARE, |found| found.learning_share()).clamp(least, most)
    }

    /// What was done since then, in seconds, or in rays where no clock may decide.
    ///
    /// - `spent_before`: [`Rendering::spent_rays`] then
    pub(super) fn work(&self, start: Instant, spent_before: u64) -> f64 {
        match self.settings.learning {
            Learning::Alongside { .. } => start.elapsed().as_secs_f64(),
            Learning::First | Learning::InStep => self.spent_rays().saturating_sub(spent_before) as f64,
        }
    }

    pub(super) fn is_late(&self) -> bool {
        self.learns_until().is_some_and(|moment| Instant::now() >= moment)
    }

    /// Goes on with what is known of the light by now; what was sampled of direct light stays.
    pub fn relight(&mut self, known: Option<Arc<dyn SecondaryLight>>, outdated: Outdated) {
        self.technique = tracer(&self.settings, self.looked_up, self.learnt, known);
        // Caustics of their own do not depend on what is known, but on the scene.
        let classes: &[PathClass] = match (&self.caustics, outdated) {
            (Some(_), Outdated::Rough) => &[PathClass::Indirect],
            _ => &[PathClass::Indirect, PathClass::Caustic],
        };
        self.film.outdate(classes, outdated);
        // Found of the light before.
        self.outlook = None;
    }

    /// All that is to be known of the light is known: the film is what further passes add to.
    pub fn knows_its_light(&self) -> bool {
        self.learner.as_ref().is_none_or(|learner| learner.stage() == Stage::Complete)
    }

    /// What its light was learnt with, where it learns by itself.
    pub fn illumination(&self) -> Option<&Illumination> {
        self.learner.as_ref()?.illumination()
    }

    /// What it knows of its light by now, where it learns by itself.
    pub fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.learner.as_ref()?.known()
    }

    /// What its records of irradiance took, where it makes any.
    pub fn records(&self) -> RecordReport {
        self.learner.as_ref().map(|learner| learner.records()).unwrap_or_default()
    }
}
