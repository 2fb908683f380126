//! One viewer's film: what it depends on, where it stands, and what it asks for next.
//!
//! Decides and counts; whoever owns it draws. `painter.rs` holds one for every viewer.

use super::Snapshot;
use super::foretold::Foretold;
use super::frames::Packer;
use super::ladder::{QuickRung, Size, Speed};
use super::lighting::LightKey;
use super::memory::CountedMemory;
use super::viewer::Wish;
use lumicast_engine::effects::EffectChoices;
use lumicast_engine::film::MeasuredError;
use lumicast_engine::render::{Indirect, Learnt, Rendering};
use lumicast_engine::scene::CameraView;
use lumicast_protocol::{ConvergencePoint, Stats};
use std::time::{Duration, Instant};

/// Passes before a measured error is believed: four in each of the two halves.
const PASSES_BELIEVED: u32 = 8;
/// Passes that show better light before a picture rests with it.
const PASSES_RELIT: u32 = 8;
/// A picture still black all over after so many passes is taken as black: its error cannot be measured.
const PASSES_BLACK: u32 = 256;
/// Passes after which a picture rests whose error is not noise: more would change nothing that is seen.
const PASSES_BIASED: u32 = 256;
/// A refined picture is sent when it has this share of passes more than the last one: the eye sees no smaller step.
const PASSES_GROWTH: f64 = 0.25;
/// Or when so much time has gone by, so that a viewer sees that something goes on.
const SENT_SECONDS_MAX: f64 = 1.0;
/// Between refined pictures at least: more than 20 a second of a resting view would only cost bytes.
const REFINED_SECONDS_MIN: f64 = 0.05;

/// Everything that a film depends on; while it stays, samples add up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FilmKey {
    pub(super) view: CameraView,
    pub(super) full: Size,
    pub(super) indirect: Indirect,
    pub(super) bounces_max: Option<u32>,
    pub(super) effects: EffectChoices,
    /// What is known of the scene's light that it shows, if any.
    pub(super) light: Option<LightKey>,
    pub(super) light_revision: u64,
}

/// A film at one rung of the ladder.
#[derive(Debug)]
pub(super) struct Layer {
    pub(super) rendering: Rendering,
    pub(super) divisor: u32,
    pub(super) size: Size,
    pub(super) _memory: CountedMemory,
}

/// What the viewer was offered last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    pub(super) camera_count: u64,
    pub(super) quality_count: u64,
    pub(super) revision: u64,
    pub(super) converged: bool,
    pub(super) at: Instant,
}

/// What a viewer wants a picture to be like before it rests.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Aim {
    /// √relMSE; 0: none.
    pub(super) error: f64,
    /// Of records of irradiance.
    pub(super) irradiance_accuracy: f32,
}

/// One viewer's film and where it stands.
#[derive(Debug)]
pub(super) struct ViewerFilm {
    pub(super) key: FilmKey,
    pub(super) started: Instant,
    /// What is shown and refined; `None` until the first quick pass.
    pub(super) layer: Option<Layer>,
    /// The next rung, until its first pass is whole.
    pub(super) climb: Option<Layer>,
    /// The finest divisor that memory allows.
    pub(super) divisor_min: u32,
    /// Quick passes in a row that took too long.
    pub(super) overruns: u32,
    /// Rung of its quick passes.
    pub(super) quick_rung: QuickRung,
    pub(super) shown: Option<Shown>,
    pub(super) offer_at_passes: u32,
    /// What was known of the light for its last pass.
    pub(super) light_generation: u64,
    /// Of which scene that is.
    pub(super) light_epoch: u64,
    /// Passes that it had then: some more are to show it before it rests.
    pub(super) relit_at_passes: u32,
    /// With so many passes at most it shows some pixels by the light of before an edit, and others by that of now: no picture.
    pub(super) mixed_until_passes: Option<u32>,
    /// It has converged to this with what was known of the light: what others make known by looking elsewhere does not
    /// wake it.
    pub(super) rests_at: Option<Aim>,
    pub(super) measured: Option<MeasuredError>,
    /// Its error was told in the middle of a pass, with this light.
    pub(super) told_early: bool,
    pub(super) foretold: Foretold,
    pub(super) packer: Packer,
    pub(super) speed: Speed,
    pub(super) rays_per_second: f64,
}

/// What is to be done for a viewer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Task {
    Nothing,
    /// Something, but not before.
    Later(Instant),
    /// A quick first pass.
    Start,
    /// The picture is good, but shows an old stamp, revision, exposure or no "converged" yet.
    Resend,
    Refine,
}

/// When a picture rests.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rest {
    /// At so many samples in any case …
    pub(super) samples_max: u32,
    /// … but not before all is known of its light.
    pub(super) is_lit: bool,
}

/// Passes at which a picture is worth sending after one of so many was sent.
pub(super) fn next_offer_after(passes: u32) -> u32 {
    passes + ((f64::from(passes) * PASSES_GROWTH) as u32).max(1)
}

impl ViewerFilm {
    pub(super) fn new(key: FilmKey, speed: Speed) -> ViewerFilm {
        ViewerFilm {
            key,
            started: Instant::now(),
            layer: None,
            climb: None,
            divisor_min: 1,
            overruns: 0,
            quick_rung: QuickRung::default(),
            shown: None,
            offer_at_passes: 0,
            light_generation: 0,
            light_epoch: 0,
            relit_at_passes: 0,
            mixed_until_passes: None,
            rests_at: None,
            measured: None,
            told_early: false,
            foretold: Foretold::default(),
            packer: Packer::default(),
            speed,
            rays_per_second: 0.0,
        }
    }

    /// Begins anew; the tables and the memory of what was shown stay.
    pub(super) fn restart(&mut self, key: FilmKey) {
        self.key = key;
        self.started = Instant::now();
        self.layer = None;
        self.climb = None;
        self.offer_at_passes = 0;
        self.measured = None;
        self.told_early = false;
        self.rests_at = None;
        (self.relit_at_passes, self.mixed_until_passes) = (0, None);
        self.foretold.restart();
    }

    /// Samples at which its picture rests in any case.
    pub(super) fn samples_max(&self, layer: &Layer, rest: Rest) -> u32 {
        let is_biased = layer.rendering.is_looked_up() && self.key.indirect != Indirect::Auto;
        if is_biased { rest.samples_max.min(PASSES_BIASED) } else { rest.samples_max }
    }

    /// It shows what is known of the scene's light, for all viewers alike.
    pub(super) fn is_lit_by_the_scene(&self) -> bool {
        self.key.light.is_some()
    }

    /// Its picture is smaller than it may be.
    pub(super) fn climbs(&self) -> bool {
        self.layer.as_ref().is_none_or(|layer| layer.divisor > self.divisor_min)
    }

    /// What comes next for a film whose key still holds.
    pub(super) fn next(&self, layer: &Layer, wish: &Wish, snapshot: &Snapshot, rest: Rest) -> Task {
        let converged = self.has_converged(layer, wish, rest);
        let is_news = |shown: &Shown| {
            shown.camera_count != wish.camera_count
                || shown.quality_count != wish.quality_count
                || shown.revision != snapshot.revision
                || shown.converged != converged
        };
        match (&self.shown, converged) {
            (None, _) => Task::Resend,
            (Some(shown), _) if is_news(shown) && !self.is_mixed(layer) => Task::Resend,
            (_, true) => Task::Nothing,
            (_, false) => Task::Refine,
        }
    }

    /// Somebody who looks with records wants them more or less accurate: what rested does no more.
    pub(super) fn wake_for(&mut self, wish: &Wish) {
        let shows_records = self.key.light.is_some_and(|light| light.learnt == Learnt::Records);
        let is_other = |aim: &mut Aim| shows_records && aim.irradiance_accuracy != wish.irradiance_accuracy;
        self.rests_at.take_if(is_other);
    }

    pub(super) fn has_converged(&self, layer: &Layer, wish: &Wish, rest: Rest) -> bool {
        let passes = layer.rendering.passes();
        let reached = match self.measured {
            Some(measured) if passes >= PASSES_BELIEVED && measured.reaches(wish.target_error) => {
                layer.rendering.confirms(wish.target_error) || passes >= self.samples_max(layer, rest)
            }
            Some(_) => passes >= self.samples_max(layer, rest),
            None => passes >= PASSES_BLACK,
        };
        self.rests_at.is_some_and(|aim| wish.target_error >= aim.error)
            || !self.climbs()
                && rest.is_lit
                && passes >= self.relit_at_passes + PASSES_RELIT
                && (reached || passes >= rest.samples_max)
    }

    /// So long ago was the last picture shown, or none was.
    pub(super) fn may_show(&self, interval: Duration) -> bool {
        self.shown.is_none_or(|shown| shown.at.elapsed() >= interval)
    }

    /// Whether a refined picture is worth sending.
    ///
    /// - `complete`: all its pixels have as many samples
    pub(super) fn is_due(&self, layer: &Layer, complete: bool) -> bool {
        let since = self.shown.map_or(f64::INFINITY, |shown| shown.at.elapsed().as_secs_f64());
        let grown = layer.rendering.passes() >= self.offer_at_passes;
        // Samples of a large picture take long: how good it is, is said as soon as it is known.
        let is_first_told = !self.told_early
            && self.measured.is_none()
            && layer.rendering.is_measured()
            // A picture that is half of the light before an edit has no error to tell.
            && layer.rendering.passes() > self.relit_at_passes;
        let is_news = complete && grown || is_first_told;
        !self.is_mixed(layer)
            && (is_news && since >= REFINED_SECONDS_MIN || complete && since >= SENT_SECONDS_MAX)
    }

    fn is_mixed(&self, layer: &Layer) -> bool {
        self.mixed_until_passes.is_some_and(|until| layer.rendering.lit_passes()[0] <= until)
    }

    fn interval(&self) -> Option<[f32; 2]> {
        let interval = self.measured?.error_interval_95().map(|bound| bound as f32);
        interval.iter().all(|bound| bound.is_finite()).then_some(interval)
    }

    pub(super) fn stats(&self, layer: &Layer, wish: &Wish, revision: u64) -> Stats {
        Stats {
            revision,
            camera_stamp: wish.camera.stamp,
            samples: layer.rendering.passes().into(),
            error: self.measured.map(|measured| measured.error() as f32).filter(|e| e.is_finite()),
            error_ci: self.interval(),
            seconds: self.started.elapsed().as_secs_f64(),
            rays_per_second: self.rays_per_second,
            samples_per_second: self.speed.samples_per_second(),
            frames_sent: 0,
            frames_skipped: 0,
            in_flight: 0,
            technique: wish.technique,
            film_size: layer.size,
            scale: f32::from(layer.size[0]) / f32::from(self.key.full[0]),
            forecast: self.foretold.facts(),
            forecast_record: self.foretold.record(),
        }
    }

    pub(super) fn point(&self, layer: &Layer, wish: &Wish, revision: u64) -> ConvergencePoint {
        ConvergencePoint {
            seconds: self.started.elapsed().as_secs_f64(),
            samples: layer.rendering.passes().into(),
            error: self.measured.map(|measured| measured.error() as f32).filter(|e| e.is_finite()),
            error_ci: self.interval(),
            revision,
            technique: wish.technique,
        }
    }
}
