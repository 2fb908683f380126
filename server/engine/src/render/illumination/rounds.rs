//! The rounds in which a scene's light is learnt: how many photons each takes, and how long it will take.

use std::{f64::consts::SQRT_2, num::NonZeroUsize};

use super::{Illumination, IlluminationSettings, Stage};
use crate::technique::{
    MAPPED,
    octree::{OctreeSettings, OctreeUnderWay},
    photons::{PhotonSettings, ThinnedOut},
};

/// Rounds from a rough answer to the last, each with more photons than all before together: what came first costs little.
pub(super) const ROUNDS: [Round; 3] = [
    Round { photon_divisor: 32, depth_first: 4, depth: 4 },
    Round { photon_divisor: 4, depth_first: 5, depth: 6 },
    Round { photon_divisor: 1, depth_first: 6, depth: OctreeSettings::DEPTH_MAX },
];
/// Rounds that something is gathered from which takes the mean over hundreds of places, as records of irradiance do.
pub(super) const ROUNDS_GATHERED_FROM: usize = 2;

/// Photons in maps for each that the settings ask for.
const MAPPED_SHARE: f64 = 1.2;
/// Surfaces at which photons are kept for each that the settings ask for, about, at most: bright rooms and mirrors keep each at
/// tens of them, and fewer are sent out.
const KEPT_SHARE_MAX: f64 = 8.0;
/// Photons for each that the settings ask for, as powers of two: at least, and at most where none is thinned out.
const EMISSION_EXPONENTS: [i32; 2] = [-5, 4];
/// Photons sent out for each that the settings ask for, with strata thinned out, about, at most: with twice as many Sponza's nave is 17 %
/// off by the octree for 12, for want of samples …
const SENT_SHARE_MAX: f64 = 2.0;
/// … and where they are aimed at things on wide ground: of those of the sky a thousandth comes in at a window. With a quarter as many a
/// room behind one is 14.4 % off by the octree for 11.9, and 6.3 by records for 4.1, for once eleven.
const SENT_SHARE_AIMED: f64 = 8.0;

/// Photons of the first round for each that it asks for, as a power of two, at most: more are sent out where most leave the scene or
/// fall on what is lit by lamps alone, to half of what later rounds bring for each that they ask for. Of 20,000 in Sponza 5,300 end up in
/// maps; with four times as many, and [`NEIGHBOURS_FEW`], its roughest octree lacks 7 % of the nave's light instead of 11.
const FIRST_EXPONENT_MAX: i32 = 2;

/// Share of the time it may take that the next round is to fill at most …
const FILLED_SHARE: f64 = 0.9;
/// … and what its larger choices are to fill where octrees are looked at: what shows them must be drawn. With half the photons Sponza's nave
/// after 5 s is as right and has twice as many samples.
const FILLED_SHARE_SHOWN: f64 = 0.75;
/// Time that a photon takes over that of one of the first round, which meets cold memory.
const WARM_PACE: f64 = 0.6;

/// Photons that take as long as gathering the light of a cell: 20 to 62 in five scenes. With 30, 0.6 to 1.3 times what octrees take is
/// foreseen in seven.
const PHOTONS_OF_A_CELL: f64 = 30.0;

/// With what power of the number of their cells octrees take longer, at least and at most. Octrees of the last round took 2.4, 2.1 and 2.0 times
/// as long in Sponza, Sibenik and dragon-room for 4.9, 4.5 and 4.0 times as many cells, whose groups are fewer and look less far, powers of 0.49 to
/// 0.55, where the first two differed by 0.3 only, most of the first being to follow surfaces; in a house with a table, of few groups, 4.1 for
/// 4.3, and 0.98 by the first two.
const GROWTH_POWERS: [f64; 2] = [0.55, 1.0];
/// So many times as many cells say what more of them take, at least.
const TELLING_GROWTH: f64 = 2.0;

/// Share of a round's photons, and of an octree's cells, after which they say how long the rest will take.
const TELLING_SHARE: f64 = 0.2;

/// Photons of a gather at least in the first round, and in all that records are gathered from: fewer blur less, and what must look less
/// far is ready sooner (Sponza's first octree after 0.18 s for 0.31). By `auto` pictures of six views after 3 and 5 s have 11 and 6 % less
/// error than with as many as octrees have that are looked at, and 6 and 3 % less than with 48. Looked at, the octrees of the second round
/// are noisier by a fifth.
const NEIGHBOURS_FEW: NonZeroUsize = NonZeroUsize::new(32).unwrap();

/// One round.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// All photons over those of this round.
    pub(super) photon_divisor: u32,
    /// First and last depth of its octrees, as far as the settings go.
    depth_first: u32,
    depth: u32,
}

/// What a round took: seconds of tracing photons and of making octrees.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RoundSeconds {
    pub(super) photons: f64,
    pub(super) octrees: f64,
}

/// What making an octree took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OctreeMade {
    pub(super) seconds: f64,
    pub(super) cells: f64,
    /// That its gathers found, at least.
    pub(super) neighbours: f64,
    /// Seconds of all octrees when it was ready.
    pub(super) ready: f64,
}

/// Seconds that the other cells of an octree will take. Cells next to each other are alike, and few say little of the others: as far as they
/// are made they count, and what was expected for the rest.
///
/// - `share`: of cells that are made
/// - `spent`: what these took
/// - `expected`: what all were to take
fn left_of_octree(share: f64, spent: f64, expected: f64) -> f64 {
    (1.0 - share) * (spent + (1.0 - share) * expected)
}

impl OctreeMade {
    /// With which power of their number cells take longer, by an octree that was made before; `None` if none was that had far fewer.
    fn growth_since(&self, before: &OctreeMade) -> Option<f64> {
        let is_known =
            before.seconds > 0.0 && before.neighbours > 0.0 && self.cells > TELLING_GROWTH * before.cells;
        let looks_farther = (self.neighbours / before.neighbours).sqrt();
        let power =
            || (self.seconds / (before.seconds * looks_farther)).ln() / (self.cells / before.cells).ln();
        is_known.then(|| power().clamp(GROWTH_POWERS[0], GROWTH_POWERS[1]))
    }

    /// What it would take to find more neighbours: that looks farther.
    fn seconds_to_find(&self, neighbours: usize) -> f64 {
        self.seconds * (neighbours as f64 / self.neighbours.max(1.0)).sqrt()
    }

    /// What one of so many cells takes, by a power of their number.
    fn seconds_for(&self, cells: f64, neighbours: usize, power: f64) -> f64 {
        self.seconds_to_find(neighbours) * (cells / self.cells.max(1.0)).powf(power)
    }
}

impl Illumination {
    /// What the round that comes next will take; `None` where one is under way or there is no time for another.
    pub(in crate::render) fn seconds_of_next_round(&self) -> Option<f64> {
        let divisor = self.is_between.then(|| self.divisor_of_next())??;
        let RoundSeconds { photons, octrees } = self.expected_of_next(divisor);
        Some(photons + octrees)
    }

    /// Seconds that the round will still take, by what the one before took; `None` in the first, and where none is under way.
    pub(in crate::render) fn seconds_left_of_round(&self) -> Option<f64> {
        let is_under_way = !self.is_between && self.stage() != Stage::Complete;
        let expected = self.expected.filter(|_| is_under_way)?;
        let spent = self.spent();
        let photons = if self.photons.is_complete() {
            0.0
        } else {
            let all = self.photons.paths().path_count().saturating_sub(self.photons.taken_over_count());
            let left = if self.photons.is_begun() { self.photons.pending_count() } else { all };
            let [all, left] = [all, left].map(|paths| paths as f64);
            let traced = all - left;
            let at_this_pace = if traced > TELLING_SHARE * all { spent.photons * left / traced } else { 0.0 };
            // Paths are put into maps after the last is traced.
            at_this_pace.max(expected.photons - spent.photons)
        };
        Some(photons + (expected.octrees - spent.octrees).max(0.0))
    }

    /// Seconds that the octree which is being made will still take, as its cells tell; `None` before they do, and where too few octrees were
    /// made before to know what is to be expected.
    pub(in crate::render) fn seconds_left_of_octree(&self) -> Option<f64> {
        if !self.photons.is_complete() {
            return None;
        }
        let OctreeUnderWay { cells, share, voxel_seconds } =
            self.octree.under_way(self.photons.product()).filter(|octree| octree.share > TELLING_SHARE)?;
        let power = self.newest.growth_since(&self.newest_but_one)?;
        let neighbours = self.octree.neighbours_min();
        let expected = self.newest.seconds_for(cells, neighbours, power) - voxel_seconds;
        let spent = self.report.octree_seconds - self.newest.ready - voxel_seconds;
        Some(left_of_octree(share, spent.max(0.0), expected.max(0.0)))
    }

    /// What this round took so far.
    pub(super) fn spent(&self) -> RoundSeconds {
        RoundSeconds {
            photons: self.report.photon_seconds - self.begun.photons,
            octrees: self.report.octree_seconds - self.begun.octrees,
        }
    }

    /// What the next round would take, by its photons.
    pub(super) fn expected_of_next(&self, divisor: u32) -> RoundSeconds {
        let spent = self.spent();
        let growth = f64::from(self.photon_divisor) / f64::from(divisor);
        // The first round does not know yet how many must be sent out for as many to be kept.
        let (sent, pace) = match self.round {
            0 => (f64::from(self.emission_exponent() - self.first_exponent.unwrap_or(0)).exp2(), WARM_PACE),
            _ => (1.0, 1.0),
        };
        let paths = self.photons.paths();
        let there = paths.path_count() as f64;
        // The first took over what it began with.
        let of_before = if self.round == 0 { 0 } else { self.photons.taken_over_count() };
        let per_photon = spent.photons / (there - of_before as f64).max(1.0);
        let wanted = paths.thinned_out(growth * sent).sent;
        // Those that are there are not traced again, unless there are more than are wanted: then none is taken over.
        let traced = if wanted >= there { wanted - there } else { wanted };
        RoundSeconds {
            photons: pace * per_photon * traced,
            octrees: self.expected_of_octrees(divisor, per_photon),
        }
    }

    /// What the octrees of the next round would take: each by what the two newest took; where there is but one, as long as that, and longer by
    /// the cells that it has more. Following surfaces, which is most of the first in scenes of many triangles, takes about as long whatever
    /// the size of the cells.
    fn expected_of_octrees(&self, divisor: u32, per_photon: f64) -> f64 {
        let Some(octree) = self.octree.octree() else { return 0.0 };
        let (_, of_next) = self.settings_of_round(self.next_round(), divisor, self.exponent);
        let neighbours = of_next.neighbours_min.get();
        let newest = &self.newest;
        let growth = newest.growth_since(&self.newest_but_one);
        let of_cells = |cells: &f64| match (growth, &self.carrier) {
            (Some(power), _) => newest.seconds_for(*cells, neighbours, power),
            (None, None) => {
                let more = (cells - newest.cells).max(0.0);
                newest.seconds_to_find(neighbours) + PHOTONS_OF_A_CELL * per_photon * more
            }
            // What carries photons does not gather them.
            (None, Some(_)) => newest.seconds_for(cells.max(newest.cells), neighbours, 1.0),
        };
        octree.cells_by(&of_next).iter().map(of_cells).sum()
    }

    /// All photons over those of the next round: the fewest halvings with which it will end in time, with some of that left to draw what it
    /// brings where its octrees are looked at; `None` if it would bring no more photons than this one.
    pub(super) fn divisor_of_next(&self) -> Option<u32> {
        let wanted = ROUNDS[self.next_round()].photon_divisor;
        let fits = |divisor: u32, seconds: f64| {
            let RoundSeconds { photons, octrees } = self.expected_of_next(divisor);
            photons + octrees <= seconds
        };
        let divisors = std::iter::successors(Some(wanted), |divisor| divisor.checked_mul(2))
            .take_while(|divisor| *divisor < self.photon_divisor);
        let Some([allowed, for_the_smallest]) = self.allowed_seconds else { return divisors.min() };
        let is_shown = self.round_count > ROUNDS_GATHERED_FROM;
        let filled_share = if is_shown { FILLED_SHARE_SHOWN } else { FILLED_SHARE };
        let smallest = divisors.clone().last();
        divisors
            .into_iter()
            .find(|divisor| fits(*divisor, filled_share * allowed))
            .or(smallest.filter(|divisor| fits(*divisor, FILLED_SHARE * for_the_smallest)))
    }

    /// How many photons more or less than asked for must be sent out for about as many to end up in maps: more where most leave
    /// the scene or fall on what is lit by lamps alone, less where each is kept many times, and memory would have no bound. Found
    /// in the first round, as a power of two so that small edits leave it.
    pub(super) fn emission_exponent(&self) -> i32 {
        let maps = &self.photons.product().maps;
        let mapped = MAPPED.iter().map(|class| maps.photon_count(*class)).sum::<usize>().max(1);
        let emitted = self.photons.paths().full_count() as f64;
        let wanted = (MAPPED_SHARE * emitted / mapped as f64).log2().round().max(0.0);
        let paths = self.photons.paths();
        let sent_max = if paths.is_aimed() { SENT_SHARE_AIMED } else { SENT_SHARE_MAX };
        let asked_for = f64::from((self.settings.photons.emitted_count / ROUNDS[1].photon_divisor).max(1));
        // To half a power of two, as `wanted` is.
        let is_allowed = |exponent: &i32| {
            let ThinnedOut { sent, kept } =
                paths.thinned_out(asked_for * f64::from(*exponent).exp2() / emitted.max(1.0));
            sent < SQRT_2 * sent_max * asked_for && kept < SQRT_2 * KEPT_SHARE_MAX * asked_for
        };
        let [least, most] = EMISSION_EXPONENTS;
        let allowed = (least..=most).rev().find(is_allowed).unwrap_or(least);
        (wanted as i32).min(allowed).max(least)
    }

    /// How many photons more, as a power of two, the first round sends out, by those that it began with; see [`FIRST_EXPONENT_MAX`]. None
    /// where no photon ends up in maps: under an open sky over black ground no number would do.
    pub(super) fn exponent_of_first(&self) -> i32 {
        let maps = &self.photons.product().maps;
        match MAPPED.iter().any(|class| maps.photon_count(*class) > 0) {
            true => (self.emission_exponent() - 1).clamp(0, FIRST_EXPONENT_MAX),
            false => 0,
        }
    }

    /// Photons and octree of a round by its place in [`ROUNDS`].
    pub(super) fn settings_of_round(
        &self,
        place: usize,
        photon_divisor: u32,
        exponent: i32,
    ) -> (PhotonSettings, OctreeSettings) {
        settings_of(&self.settings, self.round_count, (place, photon_divisor), exponent)
    }
}

/// Photons and octree of a round.
///
/// - `round_count`: of [`ROUNDS`] there are
/// - `place`, `photon_divisor`: which of them, and all photons over its
/// - `exponent`: see [`Illumination::emission_exponent`]
pub(super) fn settings_of(
    settings: &IlluminationSettings,
    round_count: usize,
    (place, photon_divisor): (usize, u32),
    exponent: i32,
) -> (PhotonSettings, OctreeSettings) {
    let round = ROUNDS[place];
    let gathers_few = place == 0 || round_count <= ROUNDS_GATHERED_FROM;
    let neighbours_min = match settings.octree.neighbours_min {
        many if gathers_few => many.min(NEIGHBOURS_FEW),
        many => many,
    };
    let asked_for = (settings.photons.emitted_count / photon_divisor).max(1);
    let times = 1 << exponent.unsigned_abs();
    let emitted_count =
        if exponent < 0 { (asked_for / times).max(1) } else { asked_for.saturating_mul(times) };
    let photons = PhotonSettings { emitted_count, ..settings.photons };
    let octree = OctreeSettings {
        depth_first: round.depth_first.min(settings.octree.depth),
        depth: round.depth.min(settings.octree.depth),
        // What a gather may expect to find is what ends up in maps.
        photon_count: asked_for,
        neighbours_min,
        ..settings.octree
    };
    (photons, octree)
}

#[cfg(test)]
mod tests {
    use std::{sync::Arc, sync::atomic::AtomicBool};

    use super::*;
    use crate::{scene::samples, transport::World};

    /// Between its first rounds, in a small box of light.
    fn between_rounds(of: fn(IlluminationSettings) -> Illumination) -> Illumination {
        let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
        let mut settings = IlluminationSettings::default();
        (settings.photons.emitted_count, settings.octree.photon_count, settings.octree.depth) =
            (64_000, 64_000, 6);
        let mut illumination = of(settings);
        while !illumination.is_between_rounds() {
            illumination.step(&world, &AtomicBool::new(false));
        }
        illumination
    }

    /// Rounds whose octrees are looked at leave time to draw them, with fewer photons if need be; but where none would leave so much, the
    /// smallest is made that ends in time.
    #[test]
    fn what_is_looked_at_leaves_time_to_draw() {
        for (of, filled_share) in [
            (Illumination::new as fn(_) -> _, FILLED_SHARE_SHOWN),
            (Illumination::to_gather_from, FILLED_SHARE),
        ] {
            let mut illumination = between_rounds(of);
            let seconds_of = |illumination: &Illumination, divisor| {
                let RoundSeconds { photons, octrees } = illumination.expected_of_next(divisor);
                photons + octrees
            };
            let wanted = ROUNDS[1].photon_divisor;
            let smallest = ROUNDS[0].photon_divisor / 2;
            for divisor in [wanted, 2 * wanted] {
                let allowed = seconds_of(&illumination, divisor) / filled_share;
                illumination.allow(1.001 * allowed, 0.0);
                assert_eq!(illumination.divisor_of_next(), Some(divisor));
                illumination.allow(0.999 * allowed, 0.0);
                assert!(illumination.divisor_of_next().is_none_or(|chosen| chosen > divisor));
            }
            let least = seconds_of(&illumination, smallest) / FILLED_SHARE;
            illumination.allow(0.0, 1.001 * least);
            assert_eq!(illumination.divisor_of_next(), Some(smallest));
            illumination.allow(0.0, 0.999 * least);
            assert_eq!(illumination.divisor_of_next(), None);
        }
    }

    /// Cells of the next octree take longer as those of the newest did over the one before, within bounds; one that is not twice as large says
    /// nothing.
    #[test]
    fn octrees_take_longer_as_they_did() {
        let made = |seconds, cells, neighbours| OctreeMade { seconds, cells, neighbours, ready: 0.0 };
        let house = made(0.066, 1294.0, 96.0).growth_since(&made(0.0097, 322.0, 32.0)).unwrap();
        assert!((house - 0.984).abs() < 0.01, "{house}");
        let sponza = made(0.63, 4696.0, 96.0).growth_since(&made(0.22, 829.0, 32.0));
        assert_eq!(sponza, Some(GROWTH_POWERS[0]));
        assert_eq!(made(9.0, 1294.0, 96.0).growth_since(&made(0.1, 322.0, 96.0)), Some(GROWTH_POWERS[1]));
        for before in [made(0.22, 4696.0, 32.0), made(0.22, 2400.0, 32.0), OctreeMade::default()] {
            assert_eq!(made(0.63, 4696.0, 96.0).growth_since(&before), None);
        }
    }

    /// What is left of an octree is nearer the truth the more of it is made, whether it takes half or twice what was expected, and tells in time
    /// that it takes too long: for twice as long as expected more than was expected is left once a third is made.
    #[test]
    fn an_octree_tells_what_is_left_of_it() {
        for truth in [0.5, 1.0, 2.0] {
            let off = |share: f64| left_of_octree(share, share * truth, 1.0) - (1.0 - share) * truth;
            let shares = [0.2, 0.4, 0.6, 0.8, 1.0];
            let offs = shares.map(|share| off(share).abs());
            assert!(offs.is_sorted_by(|a, b| a >= b) && offs[4] == 0.0, "{truth}: {offs:?}");
            assert!(offs[1] <= 0.36 * truth.max(1.0), "{truth}: {offs:?}");
        }
        let told = left_of_octree(1.0 / 3.0, 2.0 / 3.0, 1.0);
        assert!(told > 1.3 * (1.0 - 1.0 / 3.0), "{told}");
    }

    /// Nothing is told before there were two octrees and a fifth of the next is made of the photons that there are; then it is, until that is made.
    #[test]
    fn octrees_tell_in_the_last_round() {
        let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
        let mut illumination = between_rounds(Illumination::new);
        assert_eq!(illumination.seconds_left_of_octree(), None);
        let (mut told, mut untold) = (0, 0);
        while illumination.stage() != Stage::Complete {
            illumination.step(&world, &AtomicBool::new(false));
            let left = illumination.seconds_left_of_octree();
            assert!(left.is_none_or(|left| left.is_finite() && left >= 0.0), "{left:?}");
            assert!(left.is_none() || illumination.photons.is_complete());
            assert!(left.is_none() || illumination.round > 0, "one octree tells nothing of the next");
            (told, untold) = (told + u32::from(left.is_some()), untold + u32::from(left.is_none()));
        }
        assert!(told > 4 && untold > 4, "{told}, {untold}");
    }
}
