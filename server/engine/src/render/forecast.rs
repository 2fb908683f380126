//! When a picture will be as good as asked for, and how often it was said rightly.
//!
//! How much work is left (`remaining.rs`) and how fast it went lately say when it will be done.
//! Whatever was foretold is held against what came true: a forecast is worth what its record says.

use super::{Remaining, Rendering, ToLearn};
use crate::film::MeasuredError;

/// A forecast is right if the time it names is off by no more than this share of the true one.
const RIGHT_WITHIN: f64 = 0.25;
/// How many times too early or too late what is known badly may be. Of forecasts for twelve views 65 % came within twice the time, of another
/// run's 96 % within three times.
const OFF_BY_MOST: f64 = 3.0;
/// Forecasts are judged from this share of the time on: before, next to nothing is known.
const JUDGED_FROM: f64 = 0.1;
/// Forecasts kept for one target until it is reached; beyond, every second one goes.
const OPEN_MAX: usize = 256;
/// What is said is the middle of what was found in this last share of the time: errors are measured at few pixels, and what one look
/// finds may be off by twice.
const LATELY: f64 = 0.25;
/// … but no less is left than this share of what the last look found.
const LEAST_OF_LAST: f64 = 0.1;

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
        /// Four of five times at least between these, seconds from now on; `None` where the time in all is known to a quarter.
        between: Option<[f64; 2]>,
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
    /// Forecasts whose target was reached since, made after a tenth of the time that took, and those whose time went by long ago.
    pub judged: u64,
    /// Those that named the time within a quarter of it.
    pub right: u64,
    /// Those of all judged of which it is known whether it came between the times that were told, or within a quarter where none were.
    pub decided: u64,
    /// Those of them for which it did.
    pub held: u64,
}

/// Forecasts for one picture, with their record.
#[derive(Clone, Debug)]
pub struct Forecasts {
    goals: Vec<Goal>,
    pace: Pace,
    record: ForecastRecord,
    /// When work began, or went on after a rest, and the last look.
    begun_s: f64,
    last_s: f64,
}

/// A target, and what was said of it.
#[derive(Clone, Debug)]
struct Goal {
    target: f64,
    reached_s: Option<f64>,
    /// What was said.
    open: Vec<Said>,
    /// When it was found, and for when, of what was found lately, from when work began; never: infinite. What is said is made of it.
    lately: Vec<[f64; 2]>,
}

/// A forecast, in seconds from when work began.
#[derive(Clone, Copy, Debug)]
struct Said {
    /// When it was said.
    said_s: f64,
    /// When it is to come; never: infinite.
    at_s: f64,
    /// Between when.
    between_s: Option<[f64; 2]>,
}

impl Forecasts {
    /// For these targets (√relMSE), coarse to fine.
    pub fn new(targets: &[f64]) -> Forecasts {
        Forecasts {
            goals: targets.iter().copied().map(Goal::new).collect(),
            pace: Pace::default(),
            record: ForecastRecord::default(),
            begun_s: 0.0,
            last_s: 0.0,
        }
    }

    /// For these targets from now on; what was said of those that stay is kept.
    pub fn aim(&mut self, targets: &[f64]) {
        if targets.iter().copied().eq(self.targets()) {
            return;
        }
        let mut goals = std::mem::take(&mut self.goals);
        let worked_s = self.last_s - self.begun_s;
        self.goals = targets
            .iter()
            .map(|target| match goals.iter().position(|goal| goal.target == *target) {
                Some(index) => goals.swap_remove(index),
                None => Goal::new(*target),
            })
            .collect();
        goals.iter().for_each(|goal| self.record.give_up(&goal.open, worked_s));
    }

    /// √relMSE of each.
    pub fn targets(&self) -> impl Iterator<Item = f64> {
        self.goals.iter().map(|goal| goal.target)
    }

    /// Forgets what was said, not how often it was right: another picture is begun.
    pub fn restart(&mut self) {
        self.resume(0.0);
        self.goals.iter_mut().for_each(|goal| goal.reached_s = None);
    }

    /// The picture goes on after a rest: what was said before is judged, and time counts from now on.
    ///
    /// - `begun_s`: seconds since the picture was begun
    pub fn resume(&mut self, begun_s: f64) {
        let worked_s = self.last_s - self.begun_s;
        for goal in &mut self.goals {
            self.record.give_up(&std::mem::take(&mut goal.open), worked_s);
            goal.lately.clear();
        }
        (self.pace, self.begun_s, self.last_s) = (Pace::default(), begun_s, begun_s);
    }

    /// Looks at the picture as it is now, and says when it will be how good.
    ///
    /// - `now_s`: seconds since it was begun
    /// - `measured`: its error
    /// - `to_learn`: what others still learn of its light
    /// - `samples_max`: it ends at so many samples of every pixel
    pub fn look(
        &mut self,
        now_s: f64,
        rendering: &Rendering,
        measured: Option<MeasuredError>,
        to_learn: ToLearn,
        samples_max: Option<u32>,
    ) -> Vec<Expected> {
        let has_worked = self.pace.note(now_s - self.begun_s, rendering.spent_rays() as f64);
        if has_worked {
            self.last_s = now_s;
        }
        // A picture at rest comes no nearer to anything.
        let worked_s = self.last_s - self.begun_s;
        let rate = self.pace.rays_a_second();
        let passes = f64::from(rendering.passes());
        let off_by = off_by(measured, rendering.still_to_learn(to_learn));
        // What was done before a rest is as uncertain as what is to come.
        let rested_s = rate.map_or(0.0, |rate| (rendering.spent_rays() as f64 / rate - worked_s).max(0.0));
        let soon = |at_s: f64| soon([worked_s, at_s], rested_s, off_by);
        let mut record = self.record;
        let mut coarser = When::Unknown;
        let expected = self.goals.iter_mut().map(|goal| {
            if let Some(at_s) = goal.reached_s {
                return Expected { target: goal.target, when: When::Reached { at_s } };
            }
            let remaining =
                measured.and_then(|measured| rendering.remaining(&measured, goal.target, to_learn));
            let found = match (remaining, rate) {
                (Some(Remaining::Nothing), _) => {
                    // Once and for all: who gives up a target later gives up nothing that came true.
                    record.judge(&std::mem::take(&mut goal.open), worked_s);
                    goal.reached_s = Some(now_s);
                    return Expected { target: goal.target, when: When::Reached { at_s: now_s } };
                }
                (Some(Remaining::OutOfReach { error }), _) => {
                    let at_s = goal.lately_at_s([worked_s, f64::INFINITY], has_worked);
                    match at_s.is_finite() {
                        true => soon(at_s),
                        false => When::OutOfReach { error },
                    }
                }
                (Some(Remaining::Work { passes: more, .. }), _)
                    if samples_max.is_some_and(|most| passes + more > f64::from(most)) =>
                {
                    When::BeyondSamples { samples: passes + more }
                }
                (Some(Remaining::Work { rays, .. }), Some(rate)) => {
                    soon(goal.lately_at_s([worked_s, worked_s + rays / rate], has_worked))
                }
                _ => When::Unknown,
            };
            let when = found.no_sooner_than(coarser);
            coarser = if when == When::Unknown { coarser } else { when };
            if has_worked {
                goal.keep(worked_s, when);
            }
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

/// How many times too early or too late a time named by this may be, counted from when work began, four of five times: as the interval of
/// the measure says where nothing is learnt, since work falls as the squared error.
fn off_by(measured: Option<MeasuredError>, to_learn: ToLearn) -> f64 {
    let Some(measured) = measured.filter(|_| to_learn == ToLearn::Nothing) else { return OFF_BY_MOST };
    let [_, high] = measured.interval_95;
    (high / measured.rel_mse.max(f64::MIN_POSITIVE)).clamp(1.0, OFF_BY_MOST)
}

/// That it comes at a time.
///
/// - `times`: now, and when, seconds from when work began or went on
/// - `rested_s`: how long the work before that would have taken
fn soon([worked_s, at_s]: [f64; 2], rested_s: f64, off_by: f64) -> When {
    let all_s = rested_s + at_s;
    let from_now = |all_s: f64| (all_s - rested_s - worked_s).max(0.0);
    let between = [all_s / off_by, all_s * off_by].map(from_now);
    When::In { seconds: at_s - worked_s, between: (off_by > 1.0 + RIGHT_WITHIN).then_some(between) }
}

impl When {
    /// No finer error comes before a coarser one, whatever single looks found.
    fn no_sooner_than(self, coarser: When) -> When {
        match (coarser, self) {
            (When::In { seconds: before, between: around }, When::In { seconds, between }) => {
                let of = |between: Option<[f64; 2]>, seconds| between.unwrap_or([seconds; 2]);
                let ([least, most], [own_least, own_most]) = (of(around, before), of(between, seconds));
                let is_known = around.is_none() && between.is_none();
                When::In {
                    seconds: seconds.max(before),
                    between: (!is_known).then(|| [least.max(own_least), most.max(own_most)]),
                }
            }
            (When::OutOfReach { error }, When::In { .. } | When::BeyondSamples { .. } | When::Unknown) => {
                When::OutOfReach { error }
            }
            (_, own) => own,
        }
    }
}

impl Goal {
    fn new(target: f64) -> Goal {
        Goal { target, reached_s: None, open: Vec::new(), lately: Vec::new() }
    }

    /// When it is reached by what was found lately, from when work began.
    ///
    /// - `found`: when, and for when; never: infinite
    /// - `is_new`: something was done since the last time
    fn lately_at_s(&mut self, found: [f64; 2], is_new: bool) -> f64 {
        let [now_s, at_s] = found;
        if is_new {
            self.lately.retain(|[found_s, _]| *found_s >= (1.0 - LATELY) * now_s);
            push_bounded(&mut self.lately, found);
        }
        let mut lately: Vec<f64> = self.lately.iter().map(|[_, at_s]| *at_s).collect();
        lately.sort_unstable_by(f64::total_cmp);
        let middle_s = lately.get(lately.len() / 2).copied().unwrap_or(at_s);
        // What should have come by now did not: then the last look counts.
        if middle_s <= now_s || middle_s == f64::INFINITY {
            return at_s;
        }
        // Where that is all but over and the last look finds more to do, it is not.
        let least_s = now_s + LEAST_OF_LAST * (at_s - now_s);
        if at_s.is_finite() { middle_s.max(least_s) } else { middle_s }
    }

    /// Keeps what is said, to be judged by.
    fn keep(&mut self, now_s: f64, when: When) {
        let (at_s, between_s) = match when {
            When::In { seconds, between } => {
                (now_s + seconds, between.map(|between| between.map(|seconds| now_s + seconds)))
            }
            When::OutOfReach { .. } => (f64::INFINITY, None),
            When::Reached { .. } | When::BeyondSamples { .. } | When::Unknown => return,
        };
        push_bounded(&mut self.open, Said { said_s: now_s, at_s, between_s });
    }
}

/// Adds one; of too many every second one goes.
fn push_bounded<T>(forecasts: &mut Vec<T>, forecast: T) {
    if forecasts.len() >= OPEN_MAX {
        let mut index = 0;
        forecasts.retain(|_| {
            index += 1;
            index % 2 == 1
        });
    }
    forecasts.push(forecast);
}

impl ForecastRecord {
    /// Of one target that was reached at that time.
    fn judge(&mut self, open: &[Said], reached_s: f64) {
        for said in open.iter().filter(|said| said.said_s >= JUDGED_FROM * reached_s) {
            let is_right = (said.at_s - reached_s).abs() <= RIGHT_WITHIN * reached_s;
            let is_between = |[least_s, most_s]: [f64; 2]| (least_s..=most_s).contains(&reached_s);
            self.judged += 1;
            self.right += u64::from(is_right);
            self.decided += 1;
            self.held += u64::from(is_right || said.between_s.is_some_and(is_between));
        }
    }

    /// Of one target that was not reached in so many seconds and is no longer waited for: what was foretold for long before was
    /// wrong.
    fn give_up(&mut self, open: &[Said], worked_s: f64) {
        for said in open.iter().filter(|said| said.at_s * (1.0 + RIGHT_WITHIN) < worked_s) {
            self.judged += 1;
            // Between two times it may still have come.
            self.decided += u64::from(said.between_s.is_none_or(|[_, most_s]| most_s < worked_s));
        }
    }

    /// What came to it since it was `before`.
    pub fn since(self, before: ForecastRecord) -> ForecastRecord {
        ForecastRecord {
            judged: self.judged - before.judged,
            right: self.right - before.right,
            decided: self.decided - before.decided,
            held: self.held - before.held,
        }
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
    /// False if nothing was done since the last time: a picture rests.
    fn note(&mut self, seconds: f64, rays: f64) -> bool {
        if rays == self.last[1] {
            return false;
        }
        // Another film was begun at another size, or the first look is at one that has rested.
        if rays < self.last[1] || self.last == [0.0; 2] {
            *self = Pace { marks: [[seconds, rays]; 2], last: [seconds, rays] };
            return true;
        }
        self.last = [seconds, rays];
        if seconds > 2.0 * self.marks[1][0] {
            self.marks = [self.marks[1], self.last];
        }
        true
    }

    fn rays_a_second(&self) -> Option<f64> {
        let ([from_s, from], [to_s, to]) = (self.marks[0], self.last);
        (to_s > from_s && to > from).then(|| (to - from) / (to_s - from_s))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, atomic::AtomicBool};

    use super::*;
    use crate::{
        film::PictureSize,
        render::{IlluminationSettings, Indirect, Learning, RenderSettings},
        scene::samples,
        transport::World,
    };

    /// Its octree is made of few photons and coarse.
    fn boxes(settings: RenderSettings) -> Rendering {
        let world = Arc::new(World::prepare(Arc::new(samples::boxes().unwrap())));
        let view = world.scene().camera_view(None).unwrap();
        let mut light = IlluminationSettings::of(&settings);
        (light.photons.emitted_count, light.octree.photon_count, light.octree.depth) = (20_000, 20_000, 4);
        Rendering::learning_by((world, light), view, PictureSize::new(48, 32).unwrap(), settings)
    }

    /// Looks at a picture after every step until it has so many samples, with rays for a clock.
    fn watch(rendering: &mut Rendering, targets: &[f64], passes: u32) -> (Forecasts, Vec<Expected>) {
        let mut forecasts = Forecasts::new(targets);
        let mut expected = Vec::new();
        while rendering.passes() < passes || !rendering.knows_its_light() {
            rendering.step(&AtomicBool::new(false));
            if rendering.passes() >= 2 && rendering.is_whole() {
                let now_s = rendering.counts().all_rays() as f64 * 1e-6;
                expected =
                    forecasts.look(now_s, rendering, rendering.measured_error(), ToLearn::Nothing, None);
            }
        }
        (forecasts, expected)
    }

    /// Forecasts of path tracing come true: four of five at least.
    #[test]
    fn what_is_foretold_of_path_tracing_comes_true() {
        let mut rendering = boxes(RenderSettings { indirect: Indirect::Path, seed: 5, ..Default::default() });
        let (forecasts, expected) = watch(&mut rendering, &[0.3, 0.15, 0.06, 1e-4], 300);
        let ForecastRecord { judged, right, decided, held } = forecasts.record();
        assert!(judged >= 25 && 5 * right >= 4 * judged, "{right} of {judged}: {expected:?}");
        assert!(decided >= 25 && 5 * held >= 4 * decided, "{held} of {decided}: {expected:?}");
        let reached = |expected: &Expected| matches!(expected.when, When::Reached { .. });
        assert_eq!(expected.iter().filter(|expected| reached(expected)).count(), 3, "{expected:?}");
        let When::In { seconds, .. } = expected[3].when else { panic!("{expected:?}") };
        // 10⁻⁴ is a five hundredth of some 5 %: its square in work.
        assert!(seconds > 1e5 * rendering.counts().all_rays() as f64 * 1e-6 * 0.1, "{seconds}");
    }

    /// What a coarse octree cannot reach is not promised once all is known of the light; path tracing may join in `auto`.
    #[test]
    fn what_is_out_of_reach_is_not_promised() {
        let of = |indirect, seed| {
            let settings =
                RenderSettings { indirect, seed, learning: Learning::InStep, ..Default::default() };
            let mut rendering = boxes(settings);
            watch(&mut rendering, &[0.001], 64);
            // Some more, by what is known in the end.
            let passes = rendering.passes() + 250;
            watch(&mut rendering, &[0.001], passes).1[0].when
        };
        let octree = [1, 2, 3].map(|seed| of(Indirect::Octree, seed));
        // By few pixels it may not be known yet how far it is off.
        let is_known = |when: &When| matches!(when, When::OutOfReach { error } if *error > 0.001);
        let promises = |when: &When| matches!(when, When::In { .. } | When::Reached { .. });
        let count = octree.iter().filter(|when| is_known(when)).count();
        assert!(count >= 2 && !octree.iter().any(promises), "{octree:?}");
        assert!(matches!(of(Indirect::Auto, 2), When::In { .. }), "auto");
    }

    /// What is finer takes no less, and is out of reach where what is coarser is.
    #[test]
    fn finer_errors_come_no_sooner() {
        let soon = |seconds: f64| When::In { seconds, between: Some([0.5 * seconds, 2.0 * seconds]) };
        let never = When::OutOfReach { error: 0.03 };
        let many = When::BeyondSamples { samples: 300.0 };
        let cases = [
            (When::Unknown, soon(5.0), soon(5.0)),
            (soon(5.0), soon(3.0), soon(5.0)),
            (soon(3.0), soon(5.0), soon(5.0)),
            (soon(5.0), When::Unknown, When::Unknown),
            (soon(5.0), never, never),
            (never, soon(9.0), never),
            (never, many, never),
            (many, soon(9.0), soon(9.0)),
        ];
        for (coarser, own, said) in cases {
            assert_eq!(own.no_sooner_than(coarser), said, "{own:?} after {coarser:?}");
        }
        let between = |between| When::In { seconds: 5.0, between };
        let cases = [
            (Some([1.0, 20.0]), Some([4.0, 6.0]), Some([4.0, 20.0])),
            (None, Some([4.0, 6.0]), Some([5.0, 6.0])),
            (Some([1.0, 4.0]), None, Some([5.0, 5.0])),
            (None, None, None),
        ];
        for (coarser, own, said) in cases {
            assert_eq!(
                between(own).no_sooner_than(between(coarser)),
                between(said),
                "{own:?} after {coarser:?}"
            );
        }
    }

    /// Between when it comes is told of all the time, that before a rest as well, where it is not known to a quarter.
    #[test]
    fn what_is_known_badly_is_told_between_two_times() {
        let measured =
            |high| Some(MeasuredError { rel_mse: 1e-4, interval_95: [0.0, high * 1e-4], trimmed: None });
        assert_eq!(off_by(measured(1.5), ToLearn::Nothing), 1.5);
        assert_eq!(off_by(measured(9.0), ToLearn::Nothing), OFF_BY_MOST);
        assert_eq!(off_by(measured(1.1), ToLearn::Records), OFF_BY_MOST);
        assert_eq!(off_by(None, ToLearn::Nothing), OFF_BY_MOST);
        assert_eq!(off_by(Some(MeasuredError::NONE), ToLearn::Nothing), 1.0);
        let told = |seconds, between| When::In { seconds, between };
        assert_eq!(soon([4.0, 10.0], 0.0, 1.25), told(6.0, None));
        assert_eq!(soon([4.0, 10.0], 0.0, 2.0), told(6.0, Some([1.0, 16.0])));
        assert_eq!(soon([8.0, 10.0], 0.0, 2.0), told(2.0, Some([0.0, 12.0])));
        assert_eq!(soon([4.0, 10.0], 20.0, 1.5), told(6.0, Some([0.0, 21.0])));
    }

    /// A forecast counts from a tenth of the time on, and is right within a quarter of it.
    #[test]
    fn forecasts_are_judged_by_when_it_came() {
        let mut record = ForecastRecord::default();
        let said =
            |[said_s, at_s]: [f64; 2]| Said { said_s, at_s, between_s: Some([at_s / 1.3, at_s * 1.3]) };
        let open = [[0.9, 10.0], [1.0, 8.0], [2.0, 12.5], [3.0, 12.6], [9.0, 7.4]].map(said);
        record.judge(&open, 10.0);
        assert_eq!(record, ForecastRecord { judged: 4, right: 2, decided: 4, held: 3 });
        assert_eq!(record.since(ForecastRecord { judged: 1, ..record }).judged, 3);
        // What was to come by 7.4 did not in 9.5 s and may until 9.62; what was to come by 12.6 may well.
        record = ForecastRecord::default();
        record.give_up(&open, 9.5);
        assert_eq!(record, ForecastRecord { judged: 1, right: 0, decided: 0, held: 0 });
        record.give_up(&open, 9.63);
        assert_eq!(record, ForecastRecord { judged: 2, right: 0, decided: 1, held: 0 });
        // Without two times a quarter is what holds.
        record = ForecastRecord::default();
        record.judge(&open.map(|said| Said { between_s: None, ..said }), 10.0);
        assert_eq!(record, ForecastRecord { judged: 4, right: 2, decided: 4, held: 2 });
    }

    /// The pace is that of the last half of the time at least, and of the film at hand.
    #[test]
    fn the_pace_is_that_of_late() {
        let mut pace = Pace::default();
        assert_eq!(pace.rays_a_second(), None);
        let rays = |tick: i32| f64::from(tick.min(40) + 9 * (tick - 40).max(0));
        assert!((1..=100).all(|tick| pace.note(f64::from(tick), rays(tick))));
        let rate = pace.rays_a_second().unwrap();
        assert!(rate > 4.0 && rate <= 9.0, "{rate}");
        assert!(!pace.note(100.5, 580.0), "{pace:?}");
        pace.note(101.0, 5.0);
        assert_eq!(pace.rays_a_second(), None);
        pace.note(102.0, 7.0);
        assert_eq!(pace.rays_a_second(), Some(2.0));
    }

    /// What came true is judged once: a restart, a rest or other targets later make nothing of it wrong.
    #[test]
    fn what_came_true_stays_true() {
        let mut rendering = boxes(RenderSettings { indirect: Indirect::Path, seed: 5, ..Default::default() });
        let (forecasts, _) = watch(&mut rendering, &[0.3, 0.15], 60);
        let record = forecasts.record();
        assert!(record.judged > 0);
        type Later = fn(&mut Forecasts);
        let later: [Later; 3] = [
            |forecasts| forecasts.restart(),
            |forecasts| forecasts.resume(1e6),
            |forecasts| forecasts.aim(&[0.01]),
        ];
        for later in later {
            let mut forecasts = forecasts.clone();
            forecasts.last_s = 1e6;
            later(&mut forecasts);
            assert_eq!(forecasts.record(), record);
        }
    }

    /// One look that finds something else does not change what is said; many do, and what should have come by now does.
    #[test]
    fn a_single_look_says_little() {
        let mut goal = Goal::new(0.02);
        for tick in 0..40 {
            let now_s = 10.0 + 0.1 * f64::from(tick);
            let at_s = if tick % 5 == 3 { 60.0 } else { 20.0 };
            assert_eq!(goal.lately_at_s([now_s, at_s], true), 20.0, "{tick}");
        }
        let never = f64::INFINITY;
        assert_eq!(goal.lately_at_s([14.0, never], true), 20.0);
        // Nothing new while it rests; nearly there, and then far from it.
        assert_eq!(goal.lately_at_s([14.0, 20.0], false), 20.0);
        (0..10).for_each(|tick| _ = goal.lately_at_s([18.0 + 0.1 * f64::from(tick), 20.0], true));
        assert!((goal.lately_at_s([19.9, 80.0], true) - 25.91).abs() < 1e-9);
        assert_eq!(goal.lately_at_s([21.0, 25.0], true), 25.0);
        (0..40).for_each(|tick| _ = goal.lately_at_s([25.0 + 0.1 * f64::from(tick), never], true));
        assert_eq!(goal.lately_at_s([30.0, never], true), never);
        assert!(goal.lately.len() < 60, "{}", goal.lately.len());
    }

    /// Targets that stay keep what was said of them; forecasts kept are bounded.
    #[test]
    fn targets_may_change() {
        let mut forecasts = Forecasts::new(&[0.1, 0.02]);
        (0..1000).for_each(|second| {
            let now_s = f64::from(second);
            forecasts.goals[1]
                .keep(now_s, When::In { seconds: 2000.0 - now_s, between: Some([0.0, 2500.0 - now_s]) });
        });
        assert!(forecasts.goals[1].open.len() <= OPEN_MAX);
        forecasts.aim(&[0.05, 0.02]);
        assert!(forecasts.goals[0].open.is_empty() && !forecasts.goals[1].open.is_empty());
        forecasts.last_s = 3000.0;
        forecasts.resume(3100.0);
        assert!(forecasts.goals[1].open.is_empty());
        // What was said for 2000 s did not come in 3000.
        assert!(forecasts.record().judged > 100 && forecasts.record().right == 0);
        assert_eq!(forecasts.record().held, 0);
    }
}
