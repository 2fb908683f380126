//! When a picture will be as good as asked for, and how often it was said rightly.
//!
//! What is known of the films (`chain.rs`) says how much work is left; how fast work went lately says when it will be done.
//! Whatever was foretold is held against what came true: a forecast is worth what its record says.

use super::{Rendering, chain::Outlook};
use crate::film::MeasuredError;

/// A forecast is right if the time it names is off by no more than this share of the true one.
const RIGHT_WITHIN: f64 = 0.25;
/// Forecasts are judged from this share of the time on: before, next to nothing is known.
const JUDGED_FROM: f64 = 0.1;
/// Forecasts kept for one target until it is reached; beyond, every second one goes.
const OPEN_MAX: usize = 256;
/// Samples of a picture are counted in steps of this share of those it has.
const STEP_SHARE: f64 = 0.05;
/// Work beyond which nobody waits for a picture, in shares of the work done so far.
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

/// When a picture will have an error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// It has.
    Reached {
        /// Since when, in seconds of its making.
        at_s: f64,
    },
    /// In so many seconds.
    In {
        /// From now on.
        seconds: f64,
    },
    /// Never: the technique's own error is this much, √relMSE.
    OutOfReach {
        /// As far as it is known by now.
        error: f64,
    },
    /// Not before the picture ends by its bound on samples.
    BeyondSamples {
        /// How many it would take.
        samples: f64,
    },
    /// Too little is known to say.
    Unknown,
}

/// A target and when it will be reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// √relMSE, a share (0.01 = 1 %).
    pub target: f64,
    /// When.
    pub when: When,
}

/// How many forecasts came true.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ForecastRecord {
    /// Forecasts whose target was reached since, made after a tenth of the time that took.
    pub judged: u64,
    /// Those that named the time within a quarter of it.
    pub right: u64,
}

/// Forecasts for one picture, with their record.
#[derive(Clone, Debug)]
pub struct Forecasts {
    goals: Vec<Goal>,
    pace: Pace,
    record: ForecastRecord,
}

/// A target, and what was said of it.
#[derive(Clone, Debug)]
struct Goal {
    target: f64,
    reached_s: Option<f64>,
    /// When it was said, and for when.
    open: Vec<[f64; 2]>,
}

impl Forecasts {
    /// For these targets (√relMSE).
    pub fn new(targets: &[f64]) -> Forecasts {
        let goal = |target: &f64| Goal { target: *target, reached_s: None, open: Vec::new() };
        Forecasts {
            goals: targets.iter().map(goal).collect(),
            pace: Pace::default(),
            record: ForecastRecord::default(),
        }
    }

    /// For these targets from now on; what was said of those that stay is kept.
    pub fn aim(&mut self, targets: &[f64]) {
        if targets.iter().copied().eq(self.targets()) {
            return;
        }
        let mut goals = std::mem::take(&mut self.goals);
        self.goals = targets
            .iter()
            .map(|target| match goals.iter().position(|goal| goal.target == *target) {
                Some(index) => goals.swap_remove(index),
                None => Goal { target: *target, reached_s: None, open: Vec::new() },
            })
            .collect();
    }

    /// √relMSE of each.
    pub fn targets(&self) -> impl Iterator<Item = f64> {
        self.goals.iter().map(|goal| goal.target)
    }

    /// Forgets what was said, not how often it was right: another picture is begun.
    pub fn restart(&mut self) {
        self.pace = Pace::default();
        self.goals.iter_mut().for_each(|goal| (goal.reached_s, goal.open) = (None, Vec::new()));
    }

    /// Looks at the picture as it is now, and says when it will be how good.
    ///
    /// - `now_s`: seconds since it was begun
    /// - `measured`: its error
    /// - `learns`: more is being learnt of its light, by itself or by others
    /// - `samples_max`: it ends at so many samples of every pixel
    pub fn look(
        &mut self,
        now_s: f64,
        rendering: &Rendering,
        measured: Option<MeasuredError>,
        learns: bool,
        samples_max: Option<u32>,
    ) -> Vec<Expected> {
        self.pace.note(now_s, rendering.counts().all_rays() as f64);
        let rate = self.pace.rays_a_second();
        let passes = f64::from(rendering.passes());
        let mut record = self.record;
        let expected = self.goals.iter_mut().map(|goal| {
            if let Some(at_s) = goal.reached_s {
                return Expected { target: goal.target, when: When::Reached { at_s } };
            }
            let remaining = measured.and_then(|measured| rendering.remaining(&measured, goal.target, learns));
            let when = match (remaining, rate) {
                (Some(Remaining::Nothing), _) => {
                    record.judge(&goal.open, now_s);
                    goal.reached_s = Some(now_s);
                    When::Reached { at_s: now_s }
                }
                (Some(Remaining::OutOfReach { error }), _) => When::OutOfReach { error },
                (Some(Remaining::Work { passes: more, .. }), _)
                    if samples_max.is_some_and(|most| passes + more > f64::from(most)) =>
                {
                    When::BeyondSamples { samples: passes + more }
                }
                (Some(Remaining::Work { rays, .. }), Some(rate)) => {
                    goal.say([now_s, now_s + rays / rate]);
                    When::In { seconds: rays / rate }
                }
                _ => When::Unknown,
            };
            Expected { target: goal.target, when }
        });
        let expected = expected.collect();
        self.record = record;
        expected
    }

    /// How many came true so far.
    pub fn record(&self) -> ForecastRecord {
        self.record
    }
}

impl Goal {
    fn say(&mut self, forecast: [f64; 2]) {
        if self.open.len() >= OPEN_MAX {
            let mut index = 0;
            self.open.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
        self.open.push(forecast);
    }
}

impl ForecastRecord {
    /// Of one target that was reached at that time.
    fn judge(&mut self, open: &[[f64; 2]], reached_s: f64) {
        for [_, foretold_s] in open.iter().filter(|[said_s, _]| *said_s >= JUDGED_FROM * reached_s) {
            self.judged += 1;
            self.right += u64::from((foretold_s - reached_s).abs() <= RIGHT_WITHIN * reached_s);
        }
    }

    /// What came to it since it was `before`.
    pub fn since(self, before: ForecastRecord) -> ForecastRecord {
        ForecastRecord { judged: self.judged - before.judged, right: self.right - before.right }
    }
}

/// How fast work went in the last half of the time or more.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    /// Two marks and the last look, each a time and the work done by then.
    marks: [[f64; 2]; 2],
    last: [f64; 2],
}

impl Pace {
    fn note(&mut self, seconds: f64, rays: f64) {
        if rays < self.last[1] {
            // Another film was begun at another size.
            *self = Pace { marks: [[seconds, rays]; 2], last: [seconds, rays] };
            return;
        }
        self.last = [seconds, rays];
        if seconds > 2.0 * self.marks[1][0] {
            self.marks = [self.marks[1], self.last];
        }
    }

    fn rays_a_second(&self) -> Option<f64> {
        let ([from_s, from], [to_s, to]) = (self.marks[0], self.last);
        (to_s > from_s && to > from).then(|| (to - from) / (to_s - from_s))
    }
}

/// What is left for a picture whose error falls as one over the work done.
///
/// - `rays`, `passes`: done so far
/// - `allowed`: relMSE that it may have
pub(super) fn as_noise(measured: &MeasuredError, target: f64, rays: f64, passes: f64) -> Remaining {
    let allowed = allowed(measured, target, 1.0);
    let more = (measured.rel_mse / allowed - 1.0).max(0.0);
    Remaining::Work { rays: more * rays, passes: more * passes }
}

/// relMSE at which a picture counts as good enough: with an error that is known badly the estimate has to be lower, so that the
/// upper end of its interval is low enough as well.
///
/// - `growth`: work by then over that so far; the more, the better it is known
fn allowed(measured: &MeasuredError, target: f64, growth: f64) -> f64 {
    let [_, high] = measured.interval_95;
    let doubt = (high / measured.rel_mse.max(f64::MIN_POSITIVE)).max(1.0);
    let doubt = 1.0 + (doubt - 1.0) / growth.sqrt();
    let surely = (MeasuredError::SURENESS * target).powi(2) / doubt;
    surely.min(target * target)
}

/// What is left for a picture of looked-up light, if path tracing may join or not.
///
/// - `rays`: done so far
pub(super) fn of_films(
    outlook: &Outlook,
    measured: &MeasuredError,
    target: f64,
    rays: f64,
    traces: bool,
) -> Remaining {
    let mut films = outlook.films();
    // As it was measured last, which may be better known than what the films were weighed by.
    let scale = (measured.rel_mse / films.error(outlook)).clamp(0.1, 10.0);
    let (begun, mut more) = (films.passes(), 0.0);
    while scale * films.error(outlook) > allowed(measured, target, 1.0 + more / rays.max(1.0)) {
        let own = scale * outlook.own_error();
        if !traces && own >= target * target {
            return Remaining::OutOfReach { error: own.sqrt() };
        }
        if more > WORK_MAX * rays.max(1.0) {
            break;
        }
        more += films.advance(outlook, STEP_SHARE, traces);
    }
    Remaining::Work { rays: more, passes: films.passes() - begun }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, atomic::AtomicBool};

    use super::*;
    use crate::{
        film::PictureSize,
        render::{Indirect, Learning, RenderSettings},
        scene::samples,
        transport::World,
    };

    fn boxes(settings: RenderSettings) -> Rendering {
        let world = Arc::new(World::prepare(Arc::new(samples::boxes().unwrap())));
        let view = world.scene().camera_view(None).unwrap();
        Rendering::new(world, view, PictureSize::new(48, 32).unwrap(), settings)
    }

    /// Looks at a picture after every step until it has so many samples, with rays for a clock.
    fn watch(rendering: &mut Rendering, targets: &[f64], passes: u32) -> (Forecasts, Vec<Expected>) {
        let mut forecasts = Forecasts::new(targets);
        let mut expected = Vec::new();
        while rendering.passes() < passes || !rendering.knows_its_light() {
            rendering.step(&AtomicBool::new(false));
            if rendering.passes() >= 2 && rendering.is_whole() {
                let now_s = rendering.counts().all_rays() as f64 * 1e-6;
                expected = forecasts.look(now_s, rendering, rendering.measured_error(), false, None);
            }
        }
        (forecasts, expected)
    }

    /// Forecasts of path tracing come true: four of five at least.
    #[test]
    fn what_is_foretold_of_path_tracing_comes_true() {
        let mut rendering = boxes(RenderSettings { indirect: Indirect::Path, seed: 5, ..Default::default() });
        let (forecasts, expected) = watch(&mut rendering, &[0.4, 0.2, 0.1, 1e-5], 300);
        let ForecastRecord { judged, right } = forecasts.record();
        assert!(judged >= 25 && 5 * right >= 4 * judged, "{right} of {judged}: {expected:?}");
        let reached = |expected: &Expected| matches!(expected.when, When::Reached { .. });
        assert_eq!(expected.iter().filter(|expected| reached(expected)).count(), 3, "{expected:?}");
        let When::In { seconds } = expected[3].when else { panic!("{expected:?}") };
        // 10⁻⁵ is a ten thousandth of some 5 %: its square in work.
        assert!(seconds > 1e5 * rendering.counts().all_rays() as f64 * 1e-6 * 0.1, "{seconds}");
    }

    /// What a coarse octree cannot reach is not promised once all is known of the light; path tracing may join in `auto`.
    #[test]
    fn what_is_out_of_reach_is_not_promised() {
        let of = |indirect| {
            let settings =
                RenderSettings { indirect, seed: 2, learning: Learning::InStep, ..Default::default() };
            let mut rendering = boxes(settings);
            watch(&mut rendering, &[0.001], 64);
            // Some more, by what is known in the end.
            let passes = rendering.passes() + 16;
            watch(&mut rendering, &[0.001], passes).1[0].when
        };
        let octree = of(Indirect::Octree);
        assert!(matches!(octree, When::OutOfReach { error } if error > 0.001), "{octree:?}");
        assert!(matches!(of(Indirect::Auto), When::In { .. }), "auto");
    }

    /// A forecast counts from a tenth of the time on, and is right within a quarter of it.
    #[test]
    fn forecasts_are_judged_by_when_it_came() {
        let mut record = ForecastRecord::default();
        let open = [[0.9, 10.0], [1.0, 8.0], [2.0, 12.5], [3.0, 12.6], [9.0, 7.4]];
        record.judge(&open, 10.0);
        assert_eq!(record, ForecastRecord { judged: 4, right: 2 });
        assert_eq!(record.since(ForecastRecord { judged: 1, right: 1 }).judged, 3);
    }

    /// The pace is that of the last half of the time at least, and of the film at hand.
    #[test]
    fn the_pace_is_that_of_late() {
        let mut pace = Pace::default();
        assert_eq!(pace.rays_a_second(), None);
        (1..=100)
            .for_each(|tick| pace.note(f64::from(tick), f64::from(tick.min(40) + 9 * (tick - 40).max(0))));
        let rate = pace.rays_a_second().unwrap();
        assert!(rate > 4.0 && rate <= 9.0, "{rate}");
        pace.note(101.0, 5.0);
        assert_eq!(pace.rays_a_second(), None);
        pace.note(102.0, 7.0);
        assert_eq!(pace.rays_a_second(), Some(2.0));
    }

    /// Targets that stay keep what was said of them; forecasts kept are bounded.
    #[test]
    fn targets_may_change() {
        let mut forecasts = Forecasts::new(&[0.1, 0.02]);
        (0..1000).for_each(|second| forecasts.goals[1].say([f64::from(second), 2000.0]));
        assert!(forecasts.goals[1].open.len() <= OPEN_MAX);
        forecasts.aim(&[0.05, 0.02]);
        assert!(forecasts.goals[0].open.is_empty() && !forecasts.goals[1].open.is_empty());
        forecasts.restart();
        assert!(forecasts.goals[1].open.is_empty());
    }
}
