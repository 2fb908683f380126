//! What a picture learns of its light by itself, and how that shares the work with drawing.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{
    Illumination, Learner, Learning, RecordReport, Rendering, Stage, chain::Turn, meanwhile::Awaiting, tracer,
};
use crate::{
    film::{Denoising, Outdated},
    technique::{Progress, SecondaryLight},
    transport::PathClass,
};

/// Work on learning for each that goes into drawing while there is more to learn: before it is measured what the picture is
/// short of, and at least and at most afterwards.
const LEARNING_SHARE: f64 = 1.0;
const LEARNING_SHARES: [f64; 2] = [0.25, 5.0];

/// Share of the time there is for learning within which a round comes soon: the sooner it ends, the larger the next may be.
const SOON_SHARE: f64 = 0.5;

/// What a round may take for each second that it is expected to take, before it counts as one that would not end in time.
const DOUBT: f64 = 1.1;
/// Passes that may be drawn before it is looked at again whether a round ends in time: one, and another that takes longer.
const PASSES_BETWEEN: f64 = 2.0;

/// How learning goes on beside drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// By what the picture is short of.
    Shared,
    /// Before anything more is drawn: it, or what follows, would not end in time otherwise.
    Now,
    /// Not for this picture: it would not end in time, but does for others that learn with it.
    ByOthers,
    /// Not at all: it would end in nobody's time.
    Never,
}

/// Where learning stands beside drawing.
#[derive(Debug, Default)]
pub(super) struct Course {
    /// Work on learning ahead of the share of it that was due when passes were drawn with what is known, as [`Work`](super::chain::Work)
    /// counts it.
    pub(super) lead: f64,
    /// This round of photons goes before drawing.
    pub(super) hurries: Option<RoundName>,
    /// Others learn with the same learner, the last of them until then.
    others_until: Option<Instant>,
    /// All that was known when its time was over is shown, and nothing more will be.
    is_settled: bool,
    /// Nothing is known yet.
    pub(super) awaiting: Awaiting,
    /// No pass was drawn since the first became known, though one was before.
    is_unseen: bool,
}

/// The state of things when some work began.
#[derive(Clone, Copy, Debug)]
pub(super) struct Begun {
    pub(super) start: Instant,
    /// [`Rendering::spent_rays`].
    pub(super) spent_rays: u64,
    /// Seconds that a card has taken to compile shaders.
    pub(super) shader_seconds: f64,
}

/// What tells rounds of photons apart: which one it is, and which part of the photons it takes.
pub(super) type RoundName = (usize, u32);

/// A round of photons that is under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoundUnderWay {
    pub(super) name: RoundName,
    /// Until it makes a better octree.
    pub(super) seconds_left: f64,
    /// Of the octree that it makes, once the cells of that tell, where it is looked at.
    pub(super) seconds_left_of_octree: Option<f64>,
    /// Another follows.
    pub(super) is_followed: bool,
}

impl RoundUnderWay {
    /// How it is to go on.
    ///
    /// - `seconds`: there are for learning, for this picture and for whoever learns with it longest
    /// - `share`: of work on learning for each on drawing
    /// - `pass_seconds`: of a pass
    fn pace(self, [seconds, longest]: [f64; 2], share: f64, pass_seconds: f64) -> Pace {
        let left = self.seconds_left;
        if left > seconds.max(longest) {
            Pace::Never
        } else if left > seconds {
            Pace::ByOthers
        } else if left * (DOUBT + 1.0 / share) + PASSES_BETWEEN * pass_seconds > seconds
            || self.is_followed && left <= SOON_SHARE * seconds
        {
            Pace::Now
        } else {
            Pace::Shared
        }
    }

    /// The same of one that once had to go first: it does so to its end, however long that takes, unless its octree tells that this comes too
    /// late.
    fn pace_of_hurried(self, [seconds, longest]: [f64; 2]) -> Pace {
        match self.seconds_left_of_octree {
            Some(left) if left > seconds.max(longest) => Pace::Never,
            Some(left) if left > seconds => Pace::ByOthers,
            _ => Pace::Now,
        }
    }
}

impl Rendering {
    /// Learns of the scene's light; `None` when a pass is due. The first pass is drawn with the first rough answer, unless that
    /// [takes long](Rendering::draws_meanwhile); then both go on beside each other until all is known. What is sampled of direct light is kept throughout.
    pub(super) fn learn(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let draws_meanwhile = self.draws_meanwhile(cancel);
        let (begun, is_late) = (self.begin(), self.is_late());
        let (until, pace) = (self.all_learn_until(), self.pace());
        let learner = self.learner.as_mut()?;
        if pace == Pace::Never {
            learner.abandon_round();
        }
        let is_pass_due = match learner.stage() {
            Stage::Nothing => draws_meanwhile,
            Stage::Rough if self.settings.learning == Learning::First => false,
            Stage::Rough if self.film.passes_min() == 0 || self.course.is_unseen || is_late => true,
            Stage::Rough if pace == Pace::ByOthers => true,
            Stage::Rough => pace != Pace::Now && self.course.lead > 0.0,
            Stage::Complete => true,
        };
        if is_pass_due {
            // Once: others that learn with it go on, and each time it showed that it would lose the samples that it has.
            if is_late && !std::mem::replace(&mut self.course.is_settled, true) && learner.shows_all() {
                let known = learner.known().cloned();
                self.relight_better(known);
            }
            return None;
        }
        if let Some(moment) = until {
            learner.allow(moment.saturating_duration_since(begun.start).as_secs_f64());
        }
        let is_first = learner.stage() == Stage::Nothing;
        let before = learner.counts();
        let is_better = learner.step(&self.world, cancel);
        let counts = learner.counts() - before;
        let known = learner.known().cloned();
        if is_better {
            self.relight_better(known);
        }
        self.counts += counts;
        #[cfg(feature = "gpu")]
        self.note_learning(counts.all_rays(), &begun);
        let work = self.work_since(&begun);
        self.done.all += work;
        if !is_first {
            self.course.lead += work;
        }
        Some(Progress { counts, complete: false })
    }

    /// Path tracing is due while more is learnt, and no round of photons has to go first to end in time: that was begun for so much time, and
    /// ends unless path tracing is far ahead. The next one waits, smaller for it.
    pub(super) fn traces_before_learning(&mut self) -> bool {
        if !self.is_learning() || !self.looks_up() || self.turn() != Turn::Traced {
            return false;
        }
        let is_far_behind = self.outlook.is_some_and(|outlook| outlook.is_far_behind(&self.done));
        let is_between_rounds = self.learner.as_ref().is_some_and(|learner| learner.is_between_rounds());
        is_far_behind || is_between_rounds || self.pace() != Pace::Now
    }

    /// How learning is to go on with the time there is for it: what is not known by its end was learnt for nothing. A round that
    /// once had to go first does so to its end, unless that would come too late.
    fn pace(&mut self) -> Pace {
        let (Some(own), Some(longest), Some(learner)) =
            (self.learns_until(), self.all_learn_until(), &self.learner)
        else {
            return Pace::Shared;
        };
        if learner.is_between_rounds() {
            // The sooner the next begins, the larger it may be.
            return Pace::Now;
        }
        let Some(round) = learner.round() else { return Pace::Shared };
        let now = Instant::now();
        let seconds = [own, longest]
            .map(|moment| learner.time_share() * moment.saturating_duration_since(now).as_secs_f64());
        if self.course.hurries == Some(round.name) {
            return round.pace_of_hurried(seconds);
        }
        let pace = round.pace(seconds, self.learning_share(), self.pass_seconds);
        if pace == Pace::Now {
            self.course.hurries = Some(round.name);
        }
        pace
    }

    /// From when on nothing more is learnt for it, nor for others that learn with it.
    fn all_learn_until(&self) -> Option<Instant> {
        self.learns_until().map(|own| self.course.others_until.map_or(own, |others| own.max(others)))
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
        self.share_found.unwrap_or(LEARNING_SHARE).clamp(least, most)
    }

    /// Begins some work.
    pub(super) fn begin(&self) -> Begun {
        Begun {
            start: Instant::now(),
            spent_rays: self.spent_rays(),
            shader_seconds: self.shader_seconds().unwrap_or(0.0),
        }
    }

    /// What was done since then, as [`Work`](super::chain::Work) counts it.
    pub(super) fn work_since(&self, begun: &Begun) -> f64 {
        match self.settings.learning {
            Learning::Alongside { .. } => {
                // A card that failed meanwhile tells no more of its shaders.
                let of_shaders = self.shader_seconds().map_or(0.0, |seconds| seconds - begun.shader_seconds);
                (begun.start.elapsed().as_secs_f64() - of_shaders).max(0.0)
            }
            Learning::First | Learning::InStep => self.spent_rays().saturating_sub(begun.spent_rays) as f64,
        }
    }

    /// That the card that it is drawn on took to compile shaders.
    fn shader_seconds(&self) -> Option<f64> {
        #[cfg(feature = "gpu")]
        return self.gpu.as_ref().map(|gpu| gpu.shader_seconds());
        #[cfg(not(feature = "gpu"))]
        return None;
    }

    /// More is learnt of its light, and there is time for it.
    pub(super) fn is_learning(&self) -> bool {
        !self.knows_its_light() && !self.is_late()
    }

    pub(super) fn is_late(&self) -> bool {
        self.learns_until().is_some_and(|moment| Instant::now() >= moment)
    }

    /// Goes on with what is known better by now. What was path-traced while nothing was known may have bright dots, and is not kept beside it.
    fn relight_better(&mut self, known: Option<Arc<dyn SecondaryLight>>) {
        let is_first = !self.looks_up();
        self.course.is_unseen = is_first && known.is_some();
        self.relight(known, if is_first { Outdated::Wrong } else { Outdated::Rough });
    }

    /// A pass was drawn with what is known.
    ///
    /// - `work`: that it was, or the part of it that was drawn
    pub(super) fn note_looked_up(&mut self, work: f64) {
        if self.looks_up() {
            self.course.lead -= self.learning_share() * work;
            self.course.is_unseen &= !self.is_whole();
        }
    }

    /// Goes on with what is known of the light by now; what was sampled of direct light stays.
    pub fn relight(&mut self, known: Option<Arc<dyn SecondaryLight>>, outdated: Outdated) {
        self.splat_seconds += self.technique.splat_seconds();
        let asked = self.technique.asks();
        self.technique = tracer(&self.settings, self.looked_up, self.learnt, known);
        // Caustics of their own do not depend on what is known, but on the scene; path-traced ones are far noisier.
        let has_own_caustics = self.caustics.is_some() && asked && self.technique.asks();
        let classes: &[PathClass] = match outdated {
            Outdated::Rough if has_own_caustics => &[PathClass::Indirect],
            _ => &[PathClass::Indirect, PathClass::Caustic],
        };
        self.film.outdate(classes, outdated);
        self.denoising = Denoising::default();
        // Found of the light before.
        (self.outlook, self.is_confirmed) = (None, false);
        self.relit_at = self.film.passes_min();
    }

    /// It shows what is known of the light.
    pub fn looks_up(&self) -> bool {
        self.technique.secondary().is_some()
    }

    /// All that is to be known of the light is known: the film is what further passes add to.
    pub fn knows_its_light(&self) -> bool {
        self.learner.as_ref().is_none_or(|learner| learner.stage() == Stage::Complete)
    }

    /// Gives away what it learns its light with, to go on for others; the picture stays as it is.
    pub fn give_learner(&mut self) -> Option<Learner> {
        let mut learner = *self.learner.take()?;
        learner.look_away(|_| false);
        Some(learner)
    }

    /// Others learn with the same learner, the last of them until then; `None`: nobody else does. What does not end in the time of one may
    /// end in that of another.
    pub fn learn_beside(&mut self, others_until: Option<Instant>) {
        self.course.others_until = others_until;
    }

    /// Gives away what it learns its light with while others have their turn. Until [`Rendering::go_on_with`] it looks as if somebody else
    /// learnt: what is known of its learning, such as [`Rendering::knows_its_light`] and [`Rendering::records`], is not that of the learner.
    pub fn lend_learner(&mut self) -> Option<Learner> {
        self.learner.take().map(|learner| *learner)
    }

    /// Goes on with what it learns its light with, and shows what became known meanwhile, as long as there is time to draw with it.
    pub fn go_on_with(&mut self, learner: Learner) {
        let shown = self.technique.secondary();
        let is_shown = match (learner.known(), shown) {
            (Some(known), Some(shown)) => Arc::ptr_eq(known, shown),
            (known, _) => known.is_none(),
        };
        let keeps_what_it_shows = self.course.is_settled && shown.is_some();
        if !is_shown && !keeps_what_it_shows {
            self.relight_better(learner.known().cloned());
        }
        self.learner = Some(Box::new(learner));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The last round, which will still take so long.
    fn under_way(seconds_left: f64) -> RoundUnderWay {
        let name = RoundName::default();
        RoundUnderWay { name, seconds_left, seconds_left_of_octree: None, is_followed: false }
    }

    /// What does not end in the time of one, and does in that of another who learns with it, goes on for that one.
    #[test]
    fn rounds_end_for_who_has_time() {
        let round = under_way(2.0);
        let pace = |seconds: [f64; 2]| round.pace(seconds, 1.0, 0.1);
        assert_eq!(pace([1.0, 3.0]), Pace::ByOthers);
        assert_eq!(pace([1.0, 1.0]), Pace::Never);
        assert_eq!(pace([3.0, 1.0]), pace([3.0, 3.0]));
        assert_eq!(pace([30.0, 1.0]), Pace::Shared);
    }

    /// A round that goes first ends, however wrong it was foreseen, unless its octree tells that this comes too late: then what is left of the
    /// time is for drawing what is known, or the round goes on for others.
    #[test]
    fn rounds_that_come_too_late_are_given_up() {
        let pace = |of_octree, seconds| {
            let round = under_way(2.0);
            RoundUnderWay { seconds_left_of_octree: of_octree, ..round }.pace_of_hurried(seconds)
        };
        assert_eq!(pace(None, [1.0, 1.0]), Pace::Now);
        assert_eq!(pace(Some(0.9), [1.0, 1.0]), Pace::Now);
        assert_eq!(pace(Some(1.1), [1.0, 1.0]), Pace::Never);
        assert_eq!(pace(Some(1.1), [1.0, 3.0]), Pace::ByOthers);
    }

    /// A round whose length is known, beside passes of a length, ends by the end of the time wherever that is possible at all.
    #[test]
    fn rounds_that_fit_end_in_time() {
        for share in [0.25, 1.0, 5.0] {
            for pass_seconds in [0.01, 0.1, 0.4] {
                for percent in (5..=120).step_by(5) {
                    let (time, round) = (9.0, 9.0 * f64::from(percent) / 100.0);
                    let (mut now, mut done, mut lead, mut hurries) = (0.0, 0.0, 0.0, false);
                    while now < time && done < round {
                        let round = under_way(round - done);
                        let pace = if hurries {
                            round.pace_of_hurried([time - now; 2])
                        } else {
                            round.pace([time - now; 2], share, pass_seconds)
                        };
                        hurries = pace == Pace::Now;
                        match pace {
                            Pace::Never | Pace::ByOthers => break,
                            Pace::Shared if lead > 0.0 => {
                                (now, lead) = (now + pass_seconds, lead - share * pass_seconds);
                            }
                            _ => (now, done, lead) = (now + 0.01, done + 0.01, lead + 0.01),
                        }
                    }
                    let is_done = done >= round;
                    assert_eq!(is_done, percent <= 100, "{percent} % at {share}, passes of {pass_seconds} s");
                    assert!(is_done || done == 0.0, "learnt for nothing: {done} of {round} s");
                }
            }
        }
    }
}
