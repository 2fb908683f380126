//! Selective emission [Larsen2004, 9]: after an edit only what it may have changed is traced again.
//!
//! A photon's path can have changed only if one of its stored segments meets the old bounds of what was edited (it may have
//! hit it) or the new ones (it may be stopped now), or if its light changed. Those are withdrawn and traced again from the
//! same numbers, which leaves exactly the photons of a fresh trace. Larsen's probing (one photon of each group a round,
//! the whole group redone when its path differs) finds changes that nobody announced, and checks the first.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use rayon::prelude::*;

use super::{
    PhotonTracing, counts_of,
    paths::{BLOCK, Block, BlockName, PhotonHit, PhotonPaths, SourcePhotons},
    trace::{PhotonTracer, TraceTally},
};
use crate::{
    accel::Accel,
    technique::{
        ChangedPhotons, Edit, MAPPED, PhotonMaps, SideId, SideMap, Surfaces, TouchedBoxes, renamed_instances,
    },
    transport::{SourceName, World},
};

/// What an edit cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EditCounts {
    /// Paths there are.
    pub paths: u64,
    /// Paths whose segments were held against the edit's bounds: those that passed near them.
    pub tested: u64,
    /// Paths taken back because a segment met them.
    pub withdrawn: u64,
    /// Paths to be traced: those, and all of lights that changed.
    pub traced: u64,
}

/// What a round of probing found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProbeCounts {
    /// Photons traced again.
    pub probed: u64,
    /// Groups to be redone because one did not go its old way.
    pub diverged: u64,
}

/// Where the next round of probing goes on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Probe {
    round: u32,
}

/// What of the maps is out of date.
#[derive(Clone, Debug)]
pub(super) struct Stale {
    /// Where photons came or went; `None`: anywhere.
    changed: Option<ChangedPhotons>,
    /// For every side of the present surfaces, the same side in the maps made last.
    before: Option<Vec<Option<SideId>>>,
    /// Something changed at all.
    dirty: bool,
}

impl Stale {
    pub(super) fn everything() -> Stale {
        Stale { changed: None, before: None, dirty: true }
    }

    pub(super) fn is_clean(&self) -> bool {
        !self.dirty
    }

    /// Takes note of what a block lost and won.
    ///
    /// - `traced`: a bit for each path that was traced; the others stayed
    pub(super) fn note(&mut self, before: &Block, after: &Block, traced: u64, surfaces: &Surfaces) {
        self.dirty = true;
        let Some(changed) = &mut self.changed else { return };
        let mut note = |hits: &[PhotonHit]| {
            for hit in hits {
                let Some(class) = MAPPED.iter().position(|class| *class == hit.class()) else { continue };
                // Hits on what is gone lie on no side, and need none: its maps are gone with it.
                if let Some(side) = hit.side().filter(|side| surfaces.holds(*side)) {
                    changed[class].entry(surfaces.side(side)).or_default().push(hit.position);
                }
            }
        };
        let all = 0..before.paths.len().max(after.paths.len());
        for path in all.filter(|path| traced >> path & 1 == 1 || *path >= before.paths.len()) {
            let [lost, won] = [before, after].map(|block| block.hits_of_any(path));
            // Up to its first difference a path that was traced again went its old way: those hits are in the maps as they were.
            let same = lost.iter().zip(won).take_while(|(lost, won)| lost == won).count();
            note(&lost[same..]);
            note(&won[same..]);
        }
    }

    /// The map of a side made last is the map of now.
    pub(super) fn keeps(&self, class: usize, side: SideId) -> bool {
        let Some(changed) = &self.changed else { return false };
        let known = match &self.before {
            Some(before) => before[side.index()].is_some(),
            None => true,
        };
        known && !changed[class].contains_key(&side)
    }

    pub(super) fn map_before(&self, maps: &PhotonMaps, class: usize, side: SideId) -> Option<Arc<SideMap>> {
        let side = match &self.before {
            Some(before) => before[side.index()]?,
            None => side,
        };
        maps.side_map(class, side).clone()
    }

    /// Starts afresh and returns where photons came or went.
    pub(super) fn take_changed(&mut self) -> Option<ChangedPhotons> {
        let changed = self.changed.take();
        *self = Stale { changed: Some(ChangedPhotons::default()), before: None, dirty: false };
        changed
    }
}

impl PhotonTracing {
    /// Withdraws what the edit may have changed and marks it to be traced.
    pub(super) fn withdraw(&mut self, edit: &Edit<'_>) {
        if self.pending.is_none() || edit.change.leaves_light_alone() {
            return;
        }
        let (before, after) = (edit.before.accel(), edit.after.accel());
        if before.origin_in_world() != after.origin_in_world() {
            // All positions are relative to it.
            self.surfaces = Arc::default();
            self.paths = PhotonPaths::default();
            self.begin(edit.after);
            self.edit_counts = EditCounts { paths: self.paths.path_count(), ..EditCounts::default() };
            self.edit_counts.traced = self.edit_counts.paths;
            return;
        }
        let touched = TouchedBoxes::of(edit);
        let mut counts = self.take_over(edit.after);
        self.rename_instances(before, after);
        self.renew_surfaces(after);
        counts.paths = self.paths.path_count();
        let cells = self.paths.grid.touched(&touched);
        let met: Vec<(BlockName, u64, u64)> = self
            .paths
            .blocks()
            .par_iter()
            .map(|name| {
                let block = self.paths.block(*name);
                let near = paths_passing(block, cells);
                (*name, near, paths_meeting(block, near, &touched))
            })
            .filter(|(_, near, _)| *near != 0)
            .collect();
        if let Some(pending) = &mut self.pending {
            for (name, near, paths) in met {
                counts.tested += u64::from(near.count_ones());
                if paths == 0 {
                    continue;
                }
                let known = pending.entry(name).or_default();
                counts.withdrawn += u64::from((paths & !*known).count_ones());
                *known |= paths;
            }
        }
        counts.traced += counts.withdrawn;
        self.edit_counts = counts;
        self.stale.dirty = true;
    }

    /// Brings the lights up to date: those that send out what they sent keep their photons.
    fn take_over(&mut self, world: &World) -> EditCounts {
        let sources = world.sources();
        let shares = counts_of(&sources, self.settings.emitted_count);
        let mut old: HashMap<SourceName, (u32, SourcePhotons)> = std::mem::take(&mut self.paths.sources)
            .into_iter()
            .enumerate()
            .map(|(index, photons)| (photons.source.name().clone(), (index as u32, photons)))
            .collect();
        let old_pending = self.pending.take().unwrap_or_default();
        let mut pending = BTreeMap::new();
        let mut counts = EditCounts::default();
        let mut kept_all = true;
        // Photons lie light by light: lights that changed places change the order of all photons.
        let mut last_kept = None;
        for (index, (source, count)) in (0u32..).zip(sources.into_iter().zip(shares)) {
            let kept = old
                .remove(source.name())
                .filter(|(_, before)| before.source.emits_like(&source) && before.count == count);
            match kept {
                Some((old_index, mut kept)) => {
                    kept_all &= last_kept.replace(old_index) < Some(old_index);
                    let first = BlockName { source: old_index, stratum: 0, place: 0 };
                    let next = BlockName { source: old_index + 1, ..first };
                    pending.extend(
                        old_pending
                            .range(first..next)
                            .map(|(name, paths)| (BlockName { source: index, ..*name }, *paths)),
                    );
                    kept.source = source;
                    self.paths.sources.push(kept);
                }
                None => {
                    let fresh = SourcePhotons::new(source, self.settings.seed, count);
                    kept_all = false;
                    counts.traced += fresh.path_count();
                    for (stratum, blocks) in (0..).zip(&fresh.strata) {
                        let places = 0..blocks.len() as u32;
                        pending.extend(
                            places.map(|place| fresh.all_of(BlockName { source: index, stratum, place })),
                        );
                    }
                    self.paths.sources.push(fresh);
                }
            }
        }
        self.pending = Some(pending);
        if !kept_all || !old.is_empty() {
            // Its photons lie on every surface.
            self.stale.changed = None;
        }
        counts
    }

    /// Hits name instances by number, and numbers move up when nodes are removed.
    fn rename_instances(&mut self, before: &Accel, after: &Accel) {
        // A hit on a mesh that is gone is about to be withdrawn; its triangle means nothing any more.
        let renamed = renamed_instances(before, after);
        if (0..).zip(&renamed).all(|(old, new)| Some(old) == *new) {
            return;
        }
        let blocks = self.paths.sources.iter_mut().flat_map(|photons| photons.strata.iter_mut().flatten());
        for hit in blocks.flat_map(|block| &mut block.hits) {
            if let Some(instance) = hit.instance() {
                hit.rename_instance(renamed[instance as usize]);
            }
        }
    }

    /// Finds the surfaces of now, and which of the maps made last are theirs.
    fn renew_surfaces(&mut self, after: &Accel) {
        let old = self.surfaces.clone();
        self.surfaces = self.surfaces_of(after);
        // Two edits before the maps are made: back to the sides of the maps.
        let mapped = |side: SideId| match &self.stale.before {
            Some(before) => before[side.index()],
            None => Some(side),
        };
        let before = self.surfaces.sides_in(&old).into_iter().map(|side| side.and_then(mapped)).collect();
        if let Some(changed) = &mut self.stale.changed {
            // What changed before this edit keeps its place under new numbers.
            let renamed = old.sides_in(&self.surfaces);
            for of_class in changed.iter_mut() {
                let kept = std::mem::take(of_class).into_iter();
                *of_class =
                    kept.filter_map(|(side, places)| Some((renamed[side.index()]?, places))).collect();
            }
        }
        self.stale.before = Some(before);
    }

    /// Traces one photon of every group again and marks the groups whose photon went another way.
    pub fn probe(&mut self, world: &World) -> ProbeCounts {
        let Some(pending) = &mut self.pending else { return ProbeCounts::default() };
        let round = self.probe.round;
        self.probe.round = round.wrapping_add(1);
        let paths = &self.paths;
        let groups: Vec<(u32, u32)> = (0u32..)
            .zip(&paths.sources)
            .flat_map(|(source, photons)| (0..photons.strata.len() as u32).map(move |s| (source, s)))
            .collect();
        let tracer = PhotonTracer { world, grid: &paths.grid, bounces_max: self.settings.bounces_max };
        let probed: Vec<((u32, u32), bool)> = groups
            .into_par_iter()
            .filter_map(|(source, stratum)| {
                let goes_on = goes_its_way(&tracer, paths, source, stratum, round)?;
                Some(((source, stratum), goes_on))
            })
            .collect();
        let mut counts = ProbeCounts { probed: probed.len() as u64, ..ProbeCounts::default() };
        for ((source, stratum), goes_its_way) in probed {
            if goes_its_way {
                continue;
            }
            counts.diverged += 1;
            self.stale.dirty = true;
            let places = 0..paths.sources[source as usize].strata[stratum as usize].len() as u32;
            let photons = &paths.sources[source as usize];
            pending.extend(places.map(|place| photons.all_of(BlockName { source, stratum, place })));
        }
        if counts.diverged > 0 {
            self.renew_surfaces(world.accel());
        }
        counts
    }
}

/// Whether this round's photon of a group still goes the way that is kept; `None` for an empty group.
fn goes_its_way(
    tracer: &PhotonTracer<'_>,
    paths: &PhotonPaths,
    source: u32,
    stratum: u32,
    round: u32,
) -> Option<bool> {
    let photons = &paths.sources[source as usize];
    let blocks = &photons.strata[stratum as usize];
    let count: usize = blocks.iter().map(|block| block.paths.len()).sum();
    let rank = (round as usize).checked_rem(count)?;
    let name = BlockName { source, stratum, place: rank as u32 / BLOCK };
    let index = rank % BLOCK as usize;
    let number = photons.numbers(name).nth(index)?;
    let mut hits = Vec::new();
    tracer.trace(&photons.source, &photons.sequence, number, &mut hits, &mut TraceTally::default());
    let block = &blocks[name.place as usize];
    (index < block.paths.len()).then(|| block.hits_of(index) == hits.as_slice())
}

/// A bit for every path of the block that passed one of some cells.
fn paths_passing(block: &Block, cells: u64) -> u64 {
    (0..)
        .zip(&block.passed)
        .fold(0, |passing, (index, passed)| passing | u64::from(passed & cells != 0) << index)
}

/// A bit for every path of some of the block that has a segment in one of the boxes.
///
/// - `near`: a bit for each that is to be looked at
fn paths_meeting(block: &Block, near: u64, touched: &TouchedBoxes) -> u64 {
    let mut met = 0;
    let paths = block.paths.iter().enumerate().filter(|(index, _)| near >> index & 1 == 1);
    for (index, path) in paths {
        let mut from = path.start;
        let mut is_met = false;
        for hit in block.hits_of(index) {
            is_met = is_met || touched.meet(from, hit.position);
            from = hit.position;
        }
        if let Some(direction) = path.escape() {
            is_met = is_met || touched.meet_escape(from, direction);
        }
        met |= u64::from(is_met) << index;
    }
    met
}
