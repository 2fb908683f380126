//! Where photons came or went, generation by generation of their maps.

use std::{
    collections::{HashMap, VecDeque},
    sync::Arc,
};

use glam::Vec3;

use super::SideId;

/// Places of photons that came or went, by class as in [`MAPPED`](super::MAPPED), and by the side they lie on.
pub type ChangedPhotons = [HashMap<SideId, Vec<Vec3>>; 2];

/// Where photons came or went in the last generations of their maps: an edit may come while what was made of the maps before the one before
/// it is still being brought up to date.
#[derive(Clone, Debug, Default)]
pub struct PhotonChanges {
    /// By generation, the newest last and none left out between.
    generations: VecDeque<(u64, Arc<ChangedPhotons>)>,
}

/// Generations that are remembered at most, …
const GENERATIONS_MAX: usize = 64;
/// … and places in all of them, 12 bytes each; of the newest generation in any case.
const PLACES_MAX: usize = 1_000_000;

impl PhotonChanges {
    /// Takes note of where they did in the newest generation; `None`: anywhere, so that nothing is known of those before.
    pub(in crate::technique) fn note(&mut self, generation: u64, changed: Option<ChangedPhotons>) {
        let Some(changed) = changed else { return self.generations.clear() };
        self.generations.push_back((generation, Arc::new(changed)));
        let place_count = |(_, changed): &(u64, Arc<ChangedPhotons>)| -> usize {
            changed.iter().flat_map(HashMap::values).map(Vec::len).sum()
        };
        let mut places: usize = self.generations.iter().map(place_count).sum();
        while self.generations.len() > 1 && (self.generations.len() > GENERATIONS_MAX || places > PLACES_MAX)
        {
            places -= self.generations.pop_front().as_ref().map_or(0, place_count);
        }
    }

    /// Gives sides the numbers that they have by now; what lay on sides that are gone is forgotten.
    ///
    /// - `renamed`: for every side, its number by now
    pub(in crate::technique) fn rename(&mut self, renamed: &[Option<SideId>]) {
        let stays = |(index, side): (usize, &Option<SideId>)| side.is_some_and(|side| side.index() == index);
        if renamed.iter().enumerate().all(stays) {
            return;
        }
        for (_, changed) in &mut self.generations {
            rename(Arc::make_mut(changed), renamed);
        }
    }

    /// All places since a generation; `None`: anywhere, as far as is known.
    ///
    /// - `[before, now]`: generations; `now` is the newest that was noted, or of maps of which nothing was
    pub(in crate::technique) fn between(&self, [before, now]: [u64; 2]) -> Option<Vec<&ChangedPhotons>> {
        let known = self.generations.iter().filter(|(generation, _)| *generation > before);
        let since: Vec<&ChangedPhotons> = known.map(|(_, changed)| changed.as_ref()).collect();
        (now.checked_sub(before)? == since.len() as u64).then_some(since)
    }
}

/// Gives sides the numbers that they have by now; what lay on sides that are gone is forgotten.
pub(in crate::technique) fn rename(changed: &mut ChangedPhotons, renamed: &[Option<SideId>]) {
    for of_class in changed {
        let kept = std::mem::take(of_class).into_iter();
        *of_class = kept.filter_map(|(side, places)| Some((renamed[side.index()]?, places))).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(sides: &[(u32, f32)]) -> ChangedPhotons {
        let places = sides.iter().map(|(side, x)| (SideId::of(*side, true), vec![Vec3::splat(*x)]));
        [places.collect(), HashMap::new()]
    }

    fn places(changes: &PhotonChanges, before: u64, now: u64) -> Option<Vec<f32>> {
        let since = changes.between([before, now])?;
        Some(since.iter().flat_map(|changed| changed[0].values().flatten()).map(|place| place.x).collect())
    }

    /// What is known is of all generations since, or nothing is.
    #[test]
    fn changes_are_known_without_gaps() {
        let mut changes = PhotonChanges::default();
        assert_eq!(places(&changes, 7, 7), Some(vec![]));
        assert_eq!(places(&changes, 6, 7), None);
        for generation in 3..6 {
            changes.note(generation, Some(at(&[(0, generation as f32)])));
        }
        assert_eq!(places(&changes, 5, 5), Some(vec![]));
        assert_eq!(places(&changes, 4, 5), Some(vec![5.0]));
        assert_eq!(places(&changes, 2, 5), Some(vec![3.0, 4.0, 5.0]));
        assert_eq!([places(&changes, 1, 5), places(&changes, 6, 5)], [None, None]);
        changes.note(6, None);
        assert_eq!([places(&changes, 5, 6), places(&changes, 6, 6)], [None, Some(vec![])]);
        changes.note(7, Some(at(&[(0, 7.0)])));
        assert_eq!([places(&changes, 5, 7), places(&changes, 6, 7)], [None, Some(vec![7.0])]);
    }

    /// Sides are called by their numbers of now, in all generations.
    #[test]
    fn sides_that_are_renamed_keep_their_places() {
        let mut changes = PhotonChanges::default();
        changes.note(1, Some(at(&[(0, 1.0), (1, 2.0)])));
        changes.note(2, Some(at(&[(1, 3.0)])));
        let [first, second] = [0, 1].map(|side| Some(SideId::of(side, true)));
        changes.rename(&[first, None, second, None]);
        assert_eq!(places(&changes, 1, 2), Some(vec![3.0]));
        changes.rename(&[None, None, first, None]);
        assert_eq!(places(&changes, 0, 2), Some(vec![2.0, 3.0]));
        let of = changes.between([1, 2]).unwrap();
        assert_eq!(of[0][0].keys().copied().collect::<Vec<_>>(), [SideId::of(0, true)]);
    }

    /// However long edits go on, what is remembered stays bounded.
    #[test]
    fn old_changes_are_forgotten() {
        let mut changes = PhotonChanges::default();
        for generation in 1..=3 * GENERATIONS_MAX as u64 {
            changes.note(generation, Some(at(&[(0, 0.0)])));
        }
        let now = 3 * GENERATIONS_MAX as u64;
        assert_eq!(changes.generations.len(), GENERATIONS_MAX);
        assert!(places(&changes, now - GENERATIONS_MAX as u64, now).is_some());
        assert!(places(&changes, now - GENERATIONS_MAX as u64 - 1, now).is_none());
        let many: ChangedPhotons =
            [HashMap::from([(SideId::of(0, true), vec![Vec3::ZERO; PLACES_MAX])]), HashMap::new()];
        changes.note(now + 1, Some(many));
        assert_eq!(changes.generations.len(), 1);
        changes.note(now + 2, Some(at(&[(0, 1.0)])));
        assert_eq!(places(&changes, now + 1, now + 2), Some(vec![1.0]));
    }
}
