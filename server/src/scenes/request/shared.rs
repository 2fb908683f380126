//! Pictures that are drawn at once, such as those of all cameras of a scene: they learn of its light together, each with records for what it
//! sees. They have one learner among them, which goes from picture to picture with whose turn it is.

#[cfg(test)]
mod tests;

use super::Drawing;
use crate::scenes::lighting::LightKey;
use lumicast_engine::render::Learner;
use std::time::Instant;

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
}

impl Learns {
    /// What one learns the other shows.
    fn are_of_one_light(&self, other: &Learns) -> bool {
        self.light == other.light && self.light_revision == other.light_revision
    }
}

impl Drawing {
    /// Takes what others learn of the same light with, if there are any, to go on with it under the same name: for however long each has, what
    /// is begun ends in the time of the last ([`lumicast_engine::render::Rendering::learn_beside`]).
    pub(super) fn learner_of_others(learns: &mut Learns, others: &mut [Drawing]) -> Option<Learner> {
        let known = others.iter().filter_map(|other| other.learns);
        let name = known.filter(|other| learns.are_of_one_light(other)).map(|other| other.learner).next()?;
        let learner = lent_by(others, name)?;
        learns.learner = name;
        Some(learner)
    }

    /// Its turn has come: it goes on with what the last of those had who learn with it.
    pub(in crate::scenes) fn take_turn(&mut self, others: &mut [Drawing]) {
        let Some(learns) = self.learns else { return };
        let joined =
            others.iter().filter_map(|other| other.learns).filter(|other| other.learner == learns.learner);
        self.rendering.learn_beside(joined.map(|other| other.until).max());
        if let Some(learner) = lent_by(others, learns.learner) {
            self.rendering.go_on_with(learner);
        }
    }

    /// It is drawn: those who learn with it go on without it, if there are any; else it keeps what it knows.
    pub(in crate::scenes) fn leave(&mut self, others: &mut [Drawing]) {
        let Some(learns) = self.learns else { return };
        let name = learns.learner;
        let stay: Vec<u64> =
            others.iter().filter(|other| other.learns_with(name)).map(|other| other.number).collect();
        let Some(next) = others.iter().position(|other| other.learns_with(name)) else { return };
        let lent = self.rendering.lend_learner().or_else(|| lent_by(others, name));
        if let Some(mut learner) = lent {
            learner.look_away(|gaze| stay.contains(&gaze));
            others[next].rendering.go_on_with(learner);
        }
    }

    fn learns_with(&self, name: u64) -> bool {
        self.learns.is_some_and(|learns| learns.learner == name)
    }
}

/// What one of those holds who learn with a learner of this name.
fn lent_by(drawings: &mut [Drawing], name: u64) -> Option<Learner> {
    let mut joined = drawings.iter_mut().filter(|drawing| drawing.learns_with(name));
    joined.find_map(|drawing| drawing.rendering.lend_learner())
}
