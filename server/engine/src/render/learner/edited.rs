//! What becomes of what was learnt when the scene changes, by edits or by what nobody announced.

use super::{Ahead, Illumination, Learner, OldRecords, Stage};
use crate::{
    technique::{Edit, Technique, photons::ProbeCounts},
    transport::{LightsChange, World, change_of_lights},
};

impl Learner {
    /// Withdraws what an edit made stale; call before the next [`Learner::step`]. Records that saw nothing of it stay, with light of
    /// before until it is gathered anew; where much of the light changed, and where there are no records, the octree answers.
    pub fn apply(&mut self, edit: &Edit<'_>) {
        let Some(illumination) = &mut self.illumination else { return };
        if edit.change.leaves_light_alone() {
            return;
        }
        let before = illumination.generation();
        let begins_again = illumination.apply(edit);
        if begins_again {
            // Else edits that follow each other closely would put the next round off for ever.
            (self.rough_seconds, self.rough_steps) = (0.0, 0);
        }
        if illumination.generation() != before {
            self.known = illumination.known().cloned();
            self.generation += 1;
        }
        let is_unknown = illumination.stage() != Stage::Complete;
        self.is_stale |= is_unknown;
        self.is_catching_up = is_unknown;
        let ahead = self.lights_change_ahead.take();
        if !is_unknown {
            self.lights_change = LightsChange::NONE;
        } else if !self.knows_other_lights() {
            let change = ahead.map_or_else(|| change_of_lights(edit.before, edit.after), Ahead::change);
            self.lights_change = self.lights_change.then(change);
        }
        if let Some(records) = self.records.as_mut().filter(|_| !begins_again) {
            records.apply(edit);
            if !records.cache().records().is_empty() {
                return self.keep_records();
            }
        }
        self.forget_records();
        if !is_unknown {
            self.epoch += u64::from(std::mem::take(&mut self.is_stale));
        }
    }

    /// Nothing came yet of the last edit that [`Learner::apply`] was told of, but the rounds began again for it, or next to all that is left to be
    /// made is the octree: what comes next is to wait. Else edits that follow each other faster than that takes would show light of before for as
    /// long as they go on; so they are followed as fast as possible, and the last of them after twice that time at most. What makes the lights
    /// others waits for no octree of a small edit, since nothing that is known is shown meanwhile.
    pub fn is_catching_up(&self) -> bool {
        let is_worth_it = |of: &Illumination| of.is_near_an_octree() && !self.knows_other_lights();
        let is_under_way = |of: &Illumination| of.is_in_first_round() || is_worth_it(of);
        self.is_catching_up && self.illumination.as_ref().is_some_and(is_under_way)
    }

    /// What is known falls behind by an edit that [`Learner::apply`] is told of later together with others: each of them is told here, one
    /// after the other.
    ///
    /// - `followed`: the scene after the last edit that was followed
    /// - `before`, `after`: that edit
    pub fn fall_behind(&mut self, followed: &World, (before, after): (&World, &World)) {
        let step = change_of_lights(before, after);
        let step_by_step = self.lights_change_ahead.map_or(step, |ahead| ahead.step_by_step.then(step));
        self.lights_change_ahead = Some(Ahead { at_once: change_of_lights(followed, after), step_by_step });
    }

    /// Shows the records that an edit left.
    fn keep_records(&mut self) {
        self.old_records = OldRecords::Waiting;
        self.is_stale = true;
        self.show_records();
        self.gaze_count = self.shown_count;
    }

    fn forget_records(&mut self) {
        (self.shown_count, self.shown_records, self.gaze_count) = (0, 0, 0);
        self.old_records = OldRecords::None;
        if self.records.take().is_some() {
            self.known = self.illumination.as_ref().and_then(Illumination::known).cloned();
            self.generation += 1;
        }
    }

    /// Looks for changes that nobody announced: one photon of every group is traced again.
    pub fn probe(&mut self, world: &World) -> ProbeCounts {
        let Some(illumination) = &mut self.illumination else { return ProbeCounts::default() };
        let counts = illumination.probe(world);
        if counts.diverged > 0 {
            self.is_stale = true;
            self.forget_records();
        }
        counts
    }
}
