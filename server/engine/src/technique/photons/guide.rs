//! Fewer photons where few of them become what maps hold.
//!
//! Most photons of a sun that stands over a courtyard fall on the roofs around it and go on into the sky: they tell nothing but
//! what is lit by the sun, and maps hold only what came from a surface. The first block of every stratum is a pilot. A stratum
//! whose pilots bring few photons into maps for each of their rays gets a half or a quarter of its other photons, each of twice or
//! four times the flux; none gets nothing, so what is stored stays an unbiased sample of the flux. Pilots are stored, withdrawn
//! and traced again like all others, and what follows from them depends on nothing but them: after any edits strata are as
//! far thinned out as in a fresh trace.
//!
//! A stratum whose n photons bring photons of the weights w into maps, y = Σ w² for each that is sent out, adds to the variance of
//! what is read from maps as y/n, and costs c·n for c rays a photon: of all n of the same cost those are best that go with √(y/c).

use super::{
    PhotonTracing,
    paths::{BLOCK, Block, BlockName, PhotonHit, PhotonPath, PhotonPaths, SourcePhotons, strata_of},
};
use crate::technique::MAPPED;

/// Squared weights of photons in maps for each ray from which on a stratum is sent all of its photons, about.
const FULL_YIELD: f64 = 0.25;
/// Strata are thinned out so often at most: pilots may have missed by chance what others meet, and single photons of eight times
/// the flux made a hostile scene of 32,000 photons half as bright again.
const HALVINGS_MAX: u32 = 2;
/// Photons besides the pilots that a thinned out stratum keeps at least.
const OTHERS_MIN: u32 = 64;
/// Pilots by which it is judged what those of a stratum carry.
const AIMED: u32 = 8;
/// Squared weights and rays that are added to those of the pilots: of none that was found some may be there.
const PRIOR: [f64; 2] = [0.5, 2.0];

impl PhotonTracing {
    /// The next blocks to be traced, `count` at most. No block comes along with the pilots that decide whether it is wanted.
    pub(super) fn take_pending(&mut self, count: usize) -> Vec<(BlockName, u64)> {
        let Some(pending) = &mut self.pending else { return Vec::new() };
        let sources = &self.paths.sources;
        let mut piloted = None;
        let goes_along = |(name, _): &(&BlockName, &u64)| {
            let is_pilot = name.place == 0 && sources[name.source as usize].is_thinnable();
            let goes_along = is_pilot || piloted != Some(name.source);
            piloted = if is_pilot { Some(name.source) } else { piloted };
            goes_along
        };
        let some = pending.iter().take(count).take_while(goes_along);
        let some: Vec<(BlockName, u64)> = some.map(|(name, paths)| (*name, *paths)).collect();
        some.iter().for_each(|(name, _)| {
            pending.remove(name);
        });
        some
    }

    /// Thins out the strata of a light as its pilots say, once all of them are traced.
    pub(super) fn guide(&mut self, source: u32) {
        let Some(pending) = &mut self.pending else { return };
        let photons = &mut self.paths.sources[source as usize];
        let name = |stratum, place| BlockName { source, place, stratum };
        if !photons.is_thinnable() || pending.range(name(0, 0)..name(0, 1)).next().is_some() {
            return;
        }
        for stratum in 0..photons.strata.len() as u32 {
            let halvings = photons.halvings_wanted(stratum);
            if halvings == photons.halvings(stratum) {
                continue;
            }
            let blocks = &photons.strata[stratum as usize];
            // All of its photons but the pilots carry another flux.
            blocks
                .iter()
                .skip(1)
                .for_each(|block| self.stale.note(block, &Block::default(), u64::MAX, &self.surfaces));
            let withdrawn = (0..blocks.len() as u32).map(|place| pending.remove(&name(stratum, place)));
            let withdrawn: Vec<u64> = withdrawn.map(Option::unwrap_or_default).collect();
            photons.thin_out(stratum, halvings);
            for place in 0..photons.strata[stratum as usize].len() as u32 {
                let name = name(stratum, place);
                let (_, all) = photons.all_of(name);
                let (_, unknown) = photons.unknown_of(name);
                let paths = unknown | withdrawn.get(place as usize).copied().unwrap_or_default() & all;
                if paths != 0 {
                    pending.insert(name, paths);
                }
            }
        }
    }
}

impl SourcePhotons {
    /// It has strata that may get different numbers of photons.
    fn is_thinnable(&self) -> bool {
        self.strata.len() > 1
    }

    /// Mean of [`crate::transport::Source::share_by_aim`] over a stratum, about; 1 of the sky, whose strata are of directions.
    fn share_by_aim(&self, stratum: u32) -> f32 {
        let strata = self.strata.len() as u32;
        let of = |rank| self.source.share_by_aim(&self.sequence.emission(rank * strata + stratum));
        (0..AIMED).map(of).sum::<f32>() / AIMED as f32
    }

    /// How often the photons of a stratum are to be halved by what its pilots met, as far as there are enough of them.
    fn halvings_wanted(&self, stratum: u32) -> u32 {
        self.halvings_of_many(stratum).min(halvings_possible(self.full_count_in(stratum)))
    }

    /// The same of as many as it takes.
    fn halvings_of_many(&self, stratum: u32) -> u32 {
        let pilots = self.strata[stratum as usize].first().filter(|_| self.is_thinnable());
        let Some(pilots) = pilots else { return 0 };
        let is_mapped = |hit: &&PhotonHit| hit.is_on_diffuse() && MAPPED.contains(&hit.class());
        let square = |hit: &PhotonHit| f64::from(hit.weight.luminance()).powi(2);
        // Where more are aimed at each carries less, and is worth no less to what is there. Those that carry more are not to carry yet more.
        let carried = f64::from(self.share_by_aim(stratum)).min(1.0);
        let squares = pilots.hits.iter().filter(is_mapped).map(square).sum::<f64>();
        let mapped = squares / (carried * carried).max(f64::MIN_POSITIVE);
        let escaped = pilots.paths.iter().filter_map(PhotonPath::escape).count();
        let rays = (pilots.hits.len() + escaped) as f64;
        let found = (mapped + PRIOR[0]) / (rays + PRIOR[1]);
        let halvings = (0.5 * (FULL_YIELD / found).log2()).round().max(0.0) as u32;
        halvings.min(HALVINGS_MAX)
    }
}

/// How often the photons of a stratum can be halved, of so many.
fn halvings_possible(full: u32) -> u32 {
    (full.saturating_sub(BLOCK) / OTHERS_MIN).max(1).ilog2()
}

/// What is left of photons where strata are thinned out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThinnedOut {
    /// How many are sent out.
    pub sent: f64,
    /// At how many surfaces they are kept.
    pub kept: f64,
}

impl PhotonPaths {
    /// Of so many times as many photons, by what pilots of those that are there say. Those of a light that is one stratum say nothing, and
    /// count as if all were to be sent.
    pub fn thinned_out(&self, times: f64) -> ThinnedOut {
        let mut sum = ThinnedOut::default();
        for photons in &self.sources {
            // Casts saturate.
            let count = (f64::from(photons.count) * times) as u32;
            let (strata, strata_then) = (photons.strata.len(), strata_of(count));
            let full = count / strata_then;
            let pilots = full.min(BLOCK);
            let share = f64::from(strata_then) / strata as f64;
            for (stratum, blocks) in (0..).zip(&photons.strata) {
                let halvings = photons.halvings_of_many(stratum).min(halvings_possible(full));
                let sent = share * f64::from(pilots + ((full - pilots) >> halvings));
                let [paths, hits] = blocks.iter().fold([0.0, 0.0], |[paths, hits], block| {
                    [paths + block.paths.len() as f64, hits + block.hits.len() as f64]
                });
                sum.sent += sent;
                sum.kept += sent * hits / f64::max(paths, 1.0);
            }
        }
        sum
    }
}
