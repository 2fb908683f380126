//! Photons: light traced from its sources and kept where it falls, the material of every cache.
//!
//! Every photon is named by its light and number and starts from the same numbers on every run (`sequence.rs`), so a scene
//! has one set of photons, whatever the threads and the edits that led to it. Lights get photons in proportion to their
//! power, fewer and heavier ones where few of them become what maps hold (`guide.rs`), and each ends by Russian roulette with
//! nearly the flux it began with (`trace.rs`). Paths are kept whole
//! (`paths.rs`); an edit withdraws exactly those it may have changed (`selective.rs`). Hits are found again through the maps
//! of [`super::PhotonMaps`] [Jensen1996; Larsen2004, 4, 6, 8, 9].
//!
//! **Unbiased** as flux: hits are samples of the flux that arrives at surfaces. What is read from them by density estimates
//! is biased, see there.

mod carrier;
mod guide;
mod passed;
mod paths;
mod selective;
mod sequence;
#[cfg(test)]
mod tests;
mod trace;

use std::{
    collections::BTreeMap,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use rayon::prelude::*;

pub use self::{
    guide::ThinnedOut,
    paths::{PhotonHit, PhotonPath, PhotonPaths},
    selective::{EditCounts, ProbeCounts},
    trace::FluxTally,
};

use self::{
    carrier::Sent,
    passed::CoarseGrid,
    paths::{BLOCK, Block, BlockName, SourcePhotons},
    trace::{PhotonTracer, TraceTally},
};
use super::{
    Bias, CREASE_ANGLE_RAD, Card, Counts, Edit, MAPPED, PhotonCarrier, PhotonMaps, PhotonProduct, Progress,
    SentPhoton, Step, Surfaces, Technique, TriangleSide,
};
use crate::{
    accel::Accel,
    transport::{Source, World},
};

/// Parameters of photon tracing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotonSettings {
    /// Photons that all lights together emit, to a fifth: the flux of a photon goes in steps, so that small edits do not
    /// change it. Fewer are sent where few of them become what maps hold, down to a quarter.
    pub emitted_count: u32,
    /// Most surfaces that a photon reaches; `None`: until absorbed.
    pub bounces_max: Option<u32>,
    /// Names the random numbers.
    pub seed: u64,
    /// Angle between neighbouring triangles from which on they are surfaces of their own, radians.
    pub crease_angle_rad: f32,
}

impl Default for PhotonSettings {
    fn default() -> PhotonSettings {
        PhotonSettings {
            emitted_count: 1_000_000,
            bounces_max: None,
            seed: 0,
            crease_angle_rad: CREASE_ANGLE_RAD,
        }
    }
}

/// Blocks traced in one step: 16,384 photons, some 10 ms on two threads.
const STEP_BLOCKS: usize = 256;
/// The same at most where they are carried: what is cancelled waits for the end of a step.
const CARRIED_BLOCKS: usize = 2048;

/// Photon tracing, on the rayon pool it is called in; by a [`PhotonCarrier`] from surface to surface where there is one.
#[derive(Debug)]
pub struct PhotonTracing {
    settings: PhotonSettings,
    paths: PhotonPaths,
    /// Paths to be traced, by block, a bit each. `None` before the first step.
    pending: Option<BTreeMap<BlockName, u64>>,
    /// Paths that were taken over and not traced.
    taken_over: u64,
    surfaces: Arc<Surfaces>,
    product: Arc<PhotonProduct>,
    /// What changed since the last product.
    stale: selective::Stale,
    edit_counts: EditCounts,
    probe: selective::Probe,
    carrier: Option<Arc<dyn PhotonCarrier>>,
}

static CARD: Card = Card { name: "photons", classes: &[], bias: Bias::Unbiased };

impl PhotonTracing {
    /// No photons yet.
    pub fn new(settings: PhotonSettings) -> PhotonTracing {
        PhotonTracing {
            settings,
            paths: PhotonPaths::default(),
            pending: None,
            taken_over: 0,
            surfaces: Arc::default(),
            product: Arc::default(),
            stale: selective::Stale::everything(),
            edit_counts: EditCounts::default(),
            probe: selective::Probe::default(),
            carrier: None,
        }
    }

    /// Photons are carried from now on, as long as that is done; for scenes that do not change, see [`PhotonCarrier`].
    pub fn carry_by(&mut self, carrier: Arc<dyn PhotonCarrier>) {
        self.carrier = Some(carrier);
    }

    /// Nothing traced yet but what `fewer` has traced: photons of the same name are the same however many there are.
    ///
    /// - `fewer`: of the scene that the first step will be given. Nothing of it is taken over while it is not complete, nor where
    ///   the settings differ by more than the number of photons
    pub fn adding_to(fewer: PhotonTracing, settings: PhotonSettings) -> PhotonTracing {
        let fewer_settings = PhotonSettings { emitted_count: settings.emitted_count, ..fewer.settings };
        let is_known = fewer.is_complete() && fewer_settings == settings;
        let paths = if is_known { fewer.paths } else { PhotonPaths::default() };
        PhotonTracing { paths, surfaces: fewer.surfaces, ..PhotonTracing::new(settings) }
    }

    /// The photons as they are kept.
    pub fn paths(&self) -> &PhotonPaths {
        &self.paths
    }

    /// The newest maps; empty before there are any.
    pub fn product(&self) -> &Arc<PhotonProduct> {
        &self.product
    }

    /// Where the flux of all photons went that were traced so far, without those that were taken over; after edits about, where
    /// strata are thinned out otherwise than before.
    pub fn flux(&self) -> FluxTally {
        let sources = self.paths.sources.iter();
        let strata = sources.flat_map(|photons| (0..).zip(&photons.tallies).map(move |of| (photons, of)));
        strata.fold(FluxTally::default(), |mut sum, (photons, (stratum, [pilots, others]))| {
            sum += pilots.in_watts(f64::from(photons.flux_w(stratum, true)));
            sum += others.in_watts(f64::from(photons.flux_w(stratum, false)));
            sum
        })
    }

    /// What the last edit cost.
    pub fn edit_counts(&self) -> EditCounts {
        self.edit_counts
    }

    /// It has looked at a scene.
    pub fn is_begun(&self) -> bool {
        self.pending.is_some()
    }

    /// Paths that were [taken over](PhotonTracing::adding_to), once it has looked at a scene.
    pub fn taken_over_count(&self) -> u64 {
        self.taken_over
    }

    /// Paths to be traced.
    pub fn pending_count(&self) -> u64 {
        self.pending.iter().flatten().map(|(_, paths)| u64::from(paths.count_ones())).sum()
    }

    /// Every photon is traced and mapped.
    pub fn is_complete(&self) -> bool {
        self.pending.as_ref().is_some_and(BTreeMap::is_empty) && self.stale.is_clean()
    }

    /// Traces all that is pending, without maps, and returns the seconds that took: for measuring.
    pub fn trace_all(&mut self, world: &World) -> f64 {
        let start = Instant::now();
        if self.pending.is_none() {
            self.begin(world);
        }
        while self.pending.as_ref().is_some_and(|pending| !pending.is_empty()) {
            self.trace_some(world);
        }
        start.elapsed().as_secs_f64()
    }

    /// Lays out the photons of every light of `world`, all to be traced that are not known.
    fn begin(&mut self, world: &World) {
        let sources = world.sources();
        let counts = counts_of(&sources, self.settings.emitted_count);
        let known = std::mem::take(&mut self.paths);
        let grid = if known.sources.is_empty() { CoarseGrid::over(world.accel()) } else { known.grid };
        let mut known = known.sources.into_iter();
        let photons = sources.into_iter().zip(counts).map(|(source, count)| {
            let mut photons = SourcePhotons::new(source, self.settings.seed, count);
            known.by_ref().take(1).for_each(|fewer| photons.take_over(fewer));
            photons
        });
        self.paths = PhotonPaths { sources: photons.collect(), grid };
        let unknown_of = |name: BlockName| self.paths.sources[name.source as usize].unknown_of(name);
        let blocks = self.paths.blocks().into_iter();
        self.pending = Some(blocks.map(unknown_of).filter(|(_, unknown)| *unknown != 0).collect());
        self.surfaces = self.surfaces_of(world.accel());
        self.stale = selective::Stale::everything();
        (0..self.paths.sources.len() as u32).for_each(|source| self.guide(source));
        self.taken_over = self.paths.path_count() - self.pending_count();
    }

    fn surfaces_of(&self, accel: &Accel) -> Arc<Surfaces> {
        Arc::new(Surfaces::of(accel, self.settings.crease_angle_rad, &self.surfaces))
    }

    /// Traces some of what is pending.
    fn trace_some(&mut self, world: &World) -> Counts {
        let at_once = self.carrier.as_ref().and_then(|carrier| carrier.photons_at_once());
        let blocks =
            at_once.map_or(STEP_BLOCKS, |photons| (photons / BLOCK as usize).clamp(1, CARRIED_BLOCKS));
        let some = self.take_pending(blocks);
        let sent = at_once.and_then(|_| self.send(world, &some));
        let paths = &self.paths;
        let tracer = PhotonTracer { world, grid: &paths.grid, bounces_max: self.settings.bounces_max };
        let of_block = |index: usize, (name, which): (BlockName, u64)| match &sent {
            None => trace_block(paths, (name, which), |photons, number, hits, tally| {
                tracer.trace(&photons.source, &photons.sequence, number, hits, tally)
            }),
            Some(sent) => {
                let mut own = sent.of_block(index);
                trace_block(paths, (name, which), |_, _, hits, tally| match own.next().flatten() {
                    Some((emitted, kept)) => tracer.follow(emitted, kept, hits, tally),
                    None => PhotonTracer::nothing(hits),
                })
            }
        };
        let traced: Vec<(BlockName, u64, Block, TraceTally)> = some
            .par_iter()
            .enumerate()
            .map(|(index, (name, which))| {
                let (block, tally) = of_block(index, (*name, *which));
                (*name, *which, block, tally)
            })
            .collect();
        let (mut rays, mut piloted) = (0, Vec::new());
        for (name, which, block, tally) in traced {
            let before = std::mem::replace(self.paths.block_mut(name), block);
            self.stale.note(&before, self.paths.block(name), which, &self.surfaces);
            let tallies = &mut self.paths.sources[name.source as usize].tallies[name.stratum as usize];
            tallies[usize::from(name.place > 0)] += tally.flux;
            rays += tally.rays;
            piloted.extend((name.place == 0).then_some(name.source));
        }
        piloted.dedup();
        piloted.into_iter().for_each(|source| self.guide(source));
        Counts { rays, ..Counts::default() }
    }

    /// Has the photons carried that blocks name; `None` where that is not done.
    fn send(&self, world: &World, some: &[(BlockName, u64)]) -> Option<Sent> {
        let emitted_by = |(name, which): &(BlockName, u64)| {
            let photons = &self.paths.sources[name.source as usize];
            let named = photons.numbers(*name).enumerate().filter(|(index, _)| which >> index & 1 != 0);
            let emit = |(_, number)| {
                let emitted = world.emit(&photons.source, &photons.sequence.emission(number))?;
                Some(SentPhoton { emitted, key: photons.sequence.key(), number })
            };
            named.map(emit).collect::<Vec<_>>()
        };
        let emitted: Vec<Vec<Option<SentPhoton>>> = some.par_iter().map(emitted_by).collect();
        let sent: Vec<SentPhoton> = emitted.iter().flatten().flatten().copied().collect();
        let carried = self.carrier.as_ref()?.carry(world, &sent, self.settings.bounces_max)?;
        Some(Sent::new(emitted, carried))
    }

    /// Makes maps of what is traced.
    fn map(&mut self, accel: &Accel) {
        let before = self.product.clone();
        let normal_of = |place: TriangleSide| {
            let placed = &accel.instances()[place.instance as usize];
            let n_geo = placed.surface_point(place.triangle, 1.0 / 3.0, 1.0 / 3.0).n_geo;
            if place.is_front { n_geo } else { -n_geo }
        };
        let maps = {
            let stale = &self.stale;
            PhotonMaps::of(self.paths.mapped(), self.surfaces.clone(), normal_of, |class, side| {
                stale.keeps(class, side).then(|| stale.map_before(&before.maps, class, side))
            })
        };
        let changed = self.stale.take_changed();
        let flights_of = |class| self.paths.flights((class, maps.photon_count(class)), normal_of);
        let flights = MAPPED.into_iter().flat_map(flights_of).collect();
        self.product = Arc::new(PhotonProduct::new(maps, before.generation + 1, changed, flights));
    }
}

/// Traces the paths of a block that `which` names, in order, and takes over the others.
fn trace_block(
    paths: &PhotonPaths,
    (name, which): (BlockName, u64),
    mut trace: impl FnMut(&SourcePhotons, u32, &mut Vec<PhotonHit>, &mut TraceTally) -> (PhotonPath, u64),
) -> (Block, TraceTally) {
    let photons = &paths.sources[name.source as usize];
    let before = paths.block(name);
    let mut tally = TraceTally::default();
    let mut block = Block {
        paths: Vec::with_capacity(photons.numbers(name).count()),
        hits: Vec::with_capacity(before.hits.len()),
        passed: Vec::with_capacity(photons.numbers(name).count()),
    };
    for (index, number) in photons.numbers(name).enumerate() {
        let (path, passed) = match before.paths.get(index) {
            Some(path) if which >> index & 1 == 0 => {
                let first_hit = block.hits.len() as u32;
                block.hits.extend_from_slice(before.hits_of(index));
                (PhotonPath { first_hit, ..*path }, before.passed[index])
            }
            _ => trace(photons, number, &mut block.hits, &mut tally),
        };
        block.paths.push(path);
        block.passed.push(passed);
    }
    block.hits.shrink_to_fit();
    (block, tally)
}

/// Photons of every source: its power over the flux of one photon, which goes in steps of 2^¼ so that an edit of one
/// light mostly leaves the others' photons alone.
fn counts_of(sources: &[Source], emitted_count: u32) -> Vec<u32> {
    let total_w: f64 = sources.iter().map(Source::power_w).sum();
    let flux_w = (4.0 * (total_w / f64::from(emitted_count.max(1))).log2()).round() / 4.0;
    let flux_w = flux_w.exp2();
    let most = f64::from(emitted_count) * 1.25 + 1.0;
    sources.iter().map(|source| (source.power_w() / flux_w).round().clamp(1.0, most) as u32).collect()
}

impl Technique for PhotonTracing {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        if self.pending.is_none() {
            self.begin(step.world);
        }
        if step.cancel.load(Ordering::Relaxed) {
            return Progress::default();
        }
        let counts = self.trace_some(step.world);
        if self.pending.as_ref().is_some_and(BTreeMap::is_empty) && !self.stale.is_clean() {
            self.map(step.world.accel());
            step.products.photons = Some(self.product.clone());
        }
        Progress { counts, complete: self.is_complete() }
    }

    fn apply(&mut self, edit: &Edit<'_>) {
        self.withdraw(edit);
    }
}
