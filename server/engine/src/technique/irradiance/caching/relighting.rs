//! After an edit: the records that may have seen it go, and light is gathered anew for the rest before anything else.

use std::{sync::Arc, time::Instant};

use rayon::prelude::*;

use super::{IrradianceCaching, Place, Refining};
use crate::{
    accel::TriangleId,
    math::Frame,
    technique::{
        ArrivingLight, Counts, Edit, SecondaryLight, Step, TouchedBoxes,
        irradiance::{IrradianceCache, record::Gathered, visits::Visited, walk::Seen},
        renamed_instances,
    },
};

impl IrradianceCaching {
    /// Light arrives otherwise from now on, and something else answers where no record counts. Light is gathered anew for the records
    /// that there are.
    pub fn relight(&mut self, arriving: Arc<dyn ArrivingLight>, base: Option<Arc<dyn SecondaryLight>>) {
        self.arriving = arriving;
        self.stand_on(base);
        self.begin_relighting();
    }

    fn begin_relighting(&mut self) {
        self.batch = None;
        self.settled = 0;
        self.relit = Some(IrradianceCache::new(self.cache.settings, self.base.clone()));
    }

    /// Light of before an edit is what records hold.
    pub fn is_relighting(&self) -> bool {
        self.relit.is_some()
    }

    /// Gathers light of now for the next records that an edit left. All are taken in as if they had just been found, and then what is
    /// missing beside them is made.
    pub(super) fn relight_some(&mut self, step: &Step<'_>) -> Counts {
        let start = Instant::now();
        let Some(mut relit) = self.relit.take() else { return Counts::default() };
        let by = self.gather_by(step.world, step.cancel);
        let first = relit.records.len();
        let end = self.places.len().min(first + self.records_per_step(by));
        let points: Vec<Seen> = self.places[first..end].iter().map(|place| place.seen).collect();
        let Some((gathered, counts)) = by.gather_all(&points) else {
            self.relit = Some(relit);
            return Counts::default();
        };
        self.take_pace(gathered.len(), start);
        self.gathered_count += gathered.len() as u64;
        for (index, Gathered { record, extent, sight, deviation }) in (first..end).zip(gathered) {
            let place = &mut self.places[index];
            (place.sight, place.extent, place.visited) = (sight, extent, Visited::ONCE);
            place.deviation = deviation;
            relit.insert(record);
        }
        if end < self.places.len() {
            self.relit = Some(relit);
        } else {
            self.cache = relit;
            self.refining = Refining::BEGIN;
            self.begin_walks();
        }
        counts
    }

    /// Drops the records whose rays may have met what the edit touched, of places and lights that it left.
    pub(super) fn drop_touched(&mut self, edit: &Edit<'_>) {
        let (before, after) = (edit.before.accel(), edit.after.accel());
        let touched = TouchedBoxes::of(edit);
        let is_kept: Vec<bool> = self
            .places
            .par_iter()
            .map(|Place { seen, sight, .. }| {
                let frame = Frame::around(seen.facing.normal);
                let meets = |touched| sight.meets(seen.point.position, &frame, touched);
                !touched.boxes().iter().any(meets)
            })
            .collect();
        self.cache.retain(&is_kept);
        self.cache.rougher = None;
        let mut kept = is_kept.iter();
        self.places.retain(|_| kept.next().is_some_and(|is_kept| *is_kept));
        if self.places.is_empty() {
            self.drop_all();
            return;
        }
        let renamed = renamed_instances(before, after);
        for place in &mut self.places {
            let on = &mut place.seen.point.on;
            *on = renamed
                .get(on.instance as usize)
                .and_then(|number| *number)
                .map_or(TriangleId::NONE, |instance| TriangleId { instance, ..*on });
        }
        // Where they are too many for what is looked at then, there is room for it.
        self.may_drop = true;
        self.begin_relighting();
    }
}
