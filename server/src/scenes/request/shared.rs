//! Pictures that are drawn at once, such as those of all cameras of a scene: they learn of its light together, each with views of its own for
//! records. Who learns with them is one, and goes from picture to picture with whose turn it is.

#[cfg(test)]
mod tests;

use super::Drawing;
use crate::scenes::lighting::LightKey;
use lumicast_engine::render::Learner;
use std::time::{Duration, Instant};

/// Pictures learn together where neither has so many times as long to go as the other: what does not end by the end of one is begun by
/// nobody.
const TIMES_ALIKE: f64 = 2.0;

/// What a drawing learns with, and with whom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Learns {
    pub(super) light: LightKey,
    /// Of the scene that it draws: others have other light.
    pub(super) light_revision: u64,
    /// Until then.
    pub(super) until: Instant,
    /// Name of the learner among those of one render thread.
    pub(super) learner: u64,
    /// What the learner knows its view by.
    pub(super) gaze: u64,
}

impl Learns {
    fn may_join(&self, other: &Learns, now: Instant) -> bool {
        let [own, others] = [self.until, other.until].map(|until| until.saturating_duration_since(now));
        let is_alike = |long: Duration, short: Duration| long <= short.mul_f64(TIMES_ALIKE);
        let is_same = self.light == other.light && self.light_revision == other.light_revision;
        is_same && is_alike(own, others) && is_alike(others, own)
    }
}

impl Drawing {
    /// Takes what another drawing learns with, to go on with it under the same name, if there is one that this may join.
    pub(super) fn learner_of_others(
        learns: &mut Learns,
        others: &mut [Drawing],
        now: Instant,
    ) -> Option<Learner> {
        let may_join = |other: &&mut Drawing| other.learns.is_some_and(|other| learns.may_join(&other, now));
        let mut joined = others.iter_mut().filter(may_join);
        let (name, learner) =
            joined.find_map(|other| Some((other.learns?.learner, other.rendering.lend_learner()?)))?;
        learns.learner = name;
        Some(learner)
    }

    /// Its turn has come: it goes on with what the last of those had who learn with it.
    pub(in crate::scenes) fn take_turn(&mut self, others: &mut [Drawing]) {
        if let Some(learner) = self.lent_by(others) {
            self.rendering.go_on_with(learner);
        }
    }

    /// It is drawn: those who learn with it go on without it, if there are any; else it keeps what it knows.
    pub(in crate::scenes) fn leave(&mut self, others: &mut [Drawing]) {
        let Some(learns) = self.learns else { return };
        let is_joined = |other: &Drawing| other.learns.is_some_and(|other| other.learner == learns.learner);
        let stay: Vec<u64> = others
            .iter()
            .filter(|other| is_joined(other))
            .filter_map(|other| Some(other.learns?.gaze))
            .collect();
        let learner = self.rendering.lend_learner().or_else(|| self.lent_by(others));
        let next = others.iter_mut().find(|other| is_joined(other));
        match (next, learner) {
            (Some(next), Some(mut learner)) => {
                learner.look_away(|gaze| stay.contains(&gaze));
                next.rendering.go_on_with(learner);
            }
            (None, Some(learner)) => self.rendering.go_on_with(learner),
            (_, None) => {}
        }
    }

    /// What another of those holds who learn with this one.
    fn lent_by(&self, others: &mut [Drawing]) -> Option<Learner> {
        let learner = self.learns?.learner;
        let mut joined =
            others.iter_mut().filter(|other| other.learns.is_some_and(|other| other.learner == learner));
        joined.find_map(|other| other.rendering.lend_learner())
    }
}
