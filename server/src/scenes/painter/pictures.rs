//! Single pictures among what a scene's painter draws: which of them is drawn when, and what becomes of the light that they learn.

use super::{Cut, Painter};
use crate::scenes::request::Drawing;
use crate::scenes::{Snapshot, lock};
use std::time::{Duration, Instant};

impl Painter {
    /// What is done, and what nobody waits for.
    pub(super) fn settle_drawings(&mut self) -> Vec<Drawing> {
        let is_settled = |drawing: &mut Drawing| drawing.is_given_up() || drawing.is_done();
        self.drawings.extract_if(.., is_settled).collect()
    }

    /// Answers it, and keeps what it learnt of the light.
    pub(super) fn answer(&mut self, settled: Vec<Drawing>, snapshot: &Snapshot) {
        for mut drawing in settled {
            drawing.leave(&mut self.drawings);
            let learnt = drawing.give_light(snapshot);
            let refused = learnt
                .and_then(|(light, learnt)| self.lighting.take_over(light, learnt, &self.scene.workshop));
            lock(&self.scene.board).requests_open -= 1;
            self.scene.workshop.drawing_pool.spawn(move || {
                if !drawing.is_given_up() {
                    drawing.finish();
                }
                // Giving so much memory back takes time, which nobody waits for.
                drop(refused);
            });
        }
    }

    /// Begins what was asked for, with what is kept of the scene's light.
    pub(super) fn begin_drawings(&mut self, snapshot: &Snapshot) {
        for job in self.jobs.drain(..) {
            self.drawing_count += 1;
            let light = (&mut self.lighting, snapshot);
            let others = (self.drawings.as_mut_slice(), self.drawing_count);
            let drawing = Drawing::begin(job, light, others, &self.scene.workshop);
            self.drawings.push(drawing);
        }
    }

    /// Who is drawn when it is the turn of `index`: every other time who is due much sooner, if anybody is.
    pub(super) fn drawing_of_turn(&mut self, index: usize) -> usize {
        self.is_first_due_next = !self.is_first_due_next;
        if self.is_first_due_next {
            return index;
        }
        let now = Instant::now();
        let left = self.drawings.iter().map(|drawing| drawing.is_due_at().saturating_duration_since(now));
        much_sooner(&left.collect::<Vec<_>>(), index)
    }

    /// A slice of one of them, to its time at the latest.
    pub(super) fn draw(&mut self, index: usize, cut: Cut) {
        if index >= self.drawings.len() {
            return;
        }
        let mut drawing = self.drawings.remove(index);
        drawing.take_turn(&mut self.drawings);
        let left = drawing.deadline().map(|at| at.saturating_duration_since(Instant::now()));
        let after = match (cut.after, left) {
            (Some(after), Some(left)) => Some(after.min(left)),
            (after, left) => after.or(left),
        };
        self.step(&mut drawing.rendering, Cut { after, ..cut });
        self.drawings.insert(index, drawing);
    }
}

/// Who has the least time left, where that is less than half of what `index` has; else `index`. By turns alone a picture of half a second among
/// four of five has an eighth of a second for itself; among pictures of about the same time nobody goes first.
fn much_sooner(left: &[Duration], index: usize) -> usize {
    let Some(own) = left.get(index) else { return index };
    let first = (0..left.len()).min_by_key(|other| left[*other]);
    first.filter(|first| 2 * left[*first] < *own).unwrap_or(index)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Who is due much sooner goes first, and among those who have about as long nobody does.
    #[test]
    fn who_is_due_much_sooner_goes_first() {
        let of = |seconds: [f64; 3], index| much_sooner(&seconds.map(Duration::from_secs_f64), index);
        assert_eq!([0, 1, 2].map(|index| of([5.0, 0.5, 5.0], index)), [1, 1, 1]);
        assert_eq!([0, 1, 2].map(|index| of([4.1, 4.0, 2.1], index)), [0, 1, 2]);
        assert_eq!([0, 1, 2].map(|index| of([0.0, 0.0, 1.0], index)), [0, 1, 0]);
        assert_eq!(of([1.0, 2.0, 3.0], 3), 3, "gone meanwhile");
    }
}
