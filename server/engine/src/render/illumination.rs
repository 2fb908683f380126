//! What a scene knows of its light, whoever looks at it.

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::RenderSettings;
use crate::{
    technique::{
        Counts, Edit, MAPPED, PhotonCarrier, Products, SecondaryLight, Step, Technique,
        irradiance::IrradianceSettings,
        octree::{OctreeBuilding, OctreeSettings},
        photons::{EditCounts, PhotonSettings, PhotonTracing, ProbeCounts},
    },
    transport::World,
};

/// Rounds from a rough answer to the last, each with more photons than all before together: what came first costs little.
const ROUNDS: [Round; 3] = [
    Round { photon_divisor: 32, depth_first: 4, depth: 4 },
    Round { photon_divisor: 4, depth_first: 5, depth: 6 },
    Round { photon_divisor: 1, depth_first: 6, depth: OctreeSettings::DEPTH_MAX },
];
/// Rounds that something is gathered from which takes the mean over hundreds of places, as records of irradiance do.
const ROUNDS_GATHERED_FROM: usize = 2;
/// Share of the paths that an edit may touch before the rounds begin again: beyond, a rough answer soon is worth more than
/// the right one later.
const TOUCHED_SHARE_MAX: f64 = 0.2;

/// Photons in maps for each that the settings ask for.
const MAPPED_SHARE: f64 = 1.2;
/// Surfaces at which photons are kept for each that the settings ask for, about, at most: bright rooms and mirrors keep each at
/// tens of them, and fewer are sent out.
const KEPT_SHARE_MAX: f64 = 8.0;
/// Photons for each that the settings ask for, as powers of two: at least, and at most where none is thinned out.
const EMISSION_EXPONENTS: [f64; 2] = [-5.0, 4.0];
/// Photons sent out for each that the settings ask for, about, at most.
const SENT_SHARE_MAX: f64 = 4.0;

/// Photons of the first round for each that it asks for, as a power of two, at most: more are sent out where most leave the scene or
/// fall on what is lit by lamps alone, to half of what later rounds bring for each that they ask for. In Sponza 5,300 of 20,000 end up in maps:
/// with four times as many its roughest octree lacks 5 % of the light instead of 11, and is ready sooner, since gathers reach less far.
const FIRST_EXPONENT_MAX: i32 = 2;

/// Share of the time it may take that the next round is to fill at most.
const FILLED_SHARE: f64 = 0.9;
/// Time that a photon takes over that of one of the first round, which meets cold memory.
const WARM_PACE: f64 = 0.6;

/// Photons that take as long as gathering the light of a cell: 20 to 62 in five scenes. With 30, 0.6 to 1.3 times what octrees take is
/// foreseen in seven.
const PHOTONS_OF_A_CELL: f64 = 30.0;

/// Share of a round's photons after which they say how long the rest will take.
const TELLING_SHARE: f64 = 0.2;

/// Photons of a gather at least in rounds before the last, which something is gathered from, or that are shown for a moment: fewer
/// than at the end blur less, and what must look less far is ready sooner (Sponza's first octree 0.18 s for 0.31). By `auto` pictures of
/// six views after 3 and 5 s have 11 and 6 % less error than with as many as at the end, and 6 and 3 % less than with 48.
const NEIGHBOURS_FIRST: NonZeroUsize = NonZeroUsize::new(32).unwrap();

/// One round.
#[derive(Clone, Copy, Debug)]
struct Round {
    /// All photons over those of this round.
    photon_divisor: u32,
    /// First and last depth of its octrees, as far as the settings go.
    depth_first: u32,
    depth: u32,
}

/// What a round took: seconds of tracing photons and of making octrees.
#[derive(Clone, Copy, Debug, Default)]
struct RoundSeconds {
    photons: f64,
    octrees: f64,
}

/// What making an octree took.
#[derive(Clone, Copy, Debug, Default)]
struct OctreeMade {
    seconds: f64,
    cells: f64,
    /// Seconds of all octrees when it was ready.
    ready: f64,
}

/// Parameters of photons and octree, and of records gathered from them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IlluminationSettings {
    /// Photons.
    pub photons: PhotonSettings,
    /// Octree.
    pub octree: OctreeSettings,
    /// Records of irradiance.
    pub irradiance: IrradianceSettings,
}

impl IlluminationSettings {
    /// For pictures with these settings.
    pub fn of(settings: &RenderSettings) -> IlluminationSettings {
        // A surface shows what reached it by one scattering less than the picture asks for.
        let photons = PhotonSettings {
            bounces_max: settings.bounces_max,
            seed: settings.seed,
            ..PhotonSettings::default()
        };
        let octree = OctreeSettings { photon_count: photons.emitted_count, ..OctreeSettings::default() };
        let irradiance = IrradianceSettings { seed: settings.seed, ..IrradianceSettings::default() };
        IlluminationSettings { photons, octree, irradiance }
    }
}

/// How far it has got.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Nothing known yet.
    Nothing,
    /// A rough first answer.
    Rough,
    /// As good as the settings ask for.
    Complete,
}

/// What it took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IlluminationReport {
    /// Seconds of tracing photons.
    pub photon_seconds: f64,
    /// Seconds of making octrees.
    pub octree_seconds: f64,
    /// Rays of photons.
    pub counts: Counts,
    /// Photons emitted by lights.
    pub photons_emitted: u64,
    /// Surfaces reached by photons, each kept.
    pub photons_stored: u64,
    /// Cells of the octree.
    pub voxels: u64,
    /// Lights in its cells.
    pub vdls: u64,
    /// Bytes of photon paths and maps.
    pub photon_bytes: usize,
    /// Bytes of the octree.
    pub octree_bytes: usize,
}

/// Photons and octree of one scene, improved step by step and kept through edits.
#[derive(Debug)]
pub struct Illumination {
    settings: IlluminationSettings,
    /// The first of [`ROUNDS`], so many of them.
    round_count: usize,
    photons: PhotonTracing,
    /// What carries them, if not the CPU.
    carrier: Option<Arc<dyn PhotonCarrier>>,
    octree: OctreeBuilding,
    /// The round, by its place in [`ROUNDS`].
    round: usize,
    /// All photons over those of this round: it may be smaller than [`ROUNDS`] has it, to end in time.
    photon_divisor: u32,
    /// What this round is expected to take, by what the one before took; `None` for the first.
    expected: Option<RoundSeconds>,
    /// What all before it took.
    begun: RoundSeconds,
    /// The newest octree.
    newest: OctreeMade,
    /// Seconds that it may still take, and that the smallest of further rounds may.
    allowed_seconds: Option<[f64; 2]>,
    /// A round is over and the next not begun: what is drawn in between takes of the time there is.
    is_between: bool,
    /// No further round would end in time, or the one under way would not.
    is_cut: bool,
    /// See [`Illumination::emission_exponent`].
    exponent: i32,
    /// Of the first round, once its photons say; see [`FIRST_EXPONENT_MAX`].
    first_exponent: Option<i32>,
    products: Products,
    report: IlluminationReport,
    generation: u64,
    /// Of the last edit that made the rounds begin again.
    edit_counts: EditCounts,
}

impl Illumination {
    /// Nothing known yet.
    pub fn new(settings: IlluminationSettings) -> Illumination {
        Self::of_rounds(ROUNDS.len(), settings)
    }

    /// Nothing known yet, and less to be known in the end: what records of irradiance are gathered from.
    pub fn to_gather_from(settings: IlluminationSettings) -> Illumination {
        Self::of_rounds(ROUNDS_GATHERED_FROM, settings)
    }

    fn of_rounds(round_count: usize, settings: IlluminationSettings) -> Illumination {
        let (photons, octree) = settings_of(&settings, ROUNDS[0], 0);
        let (photons, octree) = (PhotonTracing::new(photons), OctreeBuilding::new(octree));
        Illumination {
            settings,
            round_count,
            photons,
            carrier: None,
            octree,
            round: 0,
            photon_divisor: ROUNDS[0].photon_divisor,
            expected: None,
            begun: RoundSeconds::default(),
            newest: OctreeMade::default(),
            allowed_seconds: None,
            is_between: false,
            is_cut: false,
            exponent: 0,
            first_exponent: None,
            products: Products::default(),
            report: IlluminationReport::default(),
            generation: 0,
            edit_counts: EditCounts::default(),
        }
    }

    /// Photons are carried from now on, as long as that is done.
    pub fn carry_by(&mut self, carrier: Arc<dyn PhotonCarrier>) {
        self.photons.carry_by(Arc::clone(&carrier));
        self.carrier = Some(carrier);
    }

    /// One bounded piece of work on the rayon pool it is called in; true when [`Illumination::known`] has become better.
    pub fn step(&mut self, world: &World, cancel: &AtomicBool) -> bool {
        if self.stage() == Stage::Complete {
            return false;
        }
        let start = Instant::now();
        if std::mem::take(&mut self.is_between) {
            match self.divisor_of_next() {
                Some(divisor) => self.begin_round(self.round + 1, divisor),
                None => {
                    self.is_cut = true;
                    return false;
                }
            }
        }
        let before = self.products.secondary.clone();
        if !self.photons.is_complete() {
            let mut step = Step { world, products: &mut self.products, canvas: None, cancel };
            let progress = self.photons.step(&mut step);
            self.report.counts += progress.counts;
            self.report.photon_seconds += start.elapsed().as_secs_f64();
            return false;
        }
        if self.first_exponent.is_none() && self.fills_first() {
            return false;
        }
        let mut step = Step { world, products: &mut self.products, canvas: None, cancel };
        let progress = self.octree.step(&mut step);
        self.report.octree_seconds += start.elapsed().as_secs_f64();
        let is_new = match (&before, &self.products.secondary) {
            (Some(before), Some(now)) => !Arc::ptr_eq(before, now),
            (before, now) => before.is_some() != now.is_some(),
        };
        if let Some(octree) = self.octree.octree().filter(|_| is_new) {
            self.report.voxels = octree.leaf_count() as u64;
            self.report.vdls = octree.vdl_count() as u64;
            self.report.octree_bytes = octree.bytes();
            let ready = self.report.octree_seconds;
            // One that took light over after an edit says little of those that do not.
            if octree.counts().kept == 0 {
                let (seconds, cells) = (ready - self.newest.ready, octree.leaf_count() as f64);
                self.newest = OctreeMade { seconds, cells, ready };
            }
            self.newest.ready = ready;
        }
        self.generation += u64::from(is_new);
        self.is_between = progress.complete && self.is_before_last_round();
        is_new
    }

    /// It may take so many seconds from now on: rounds that would not end by then are not begun, or are smaller.
    ///
    /// - `for_the_smallest`: that the smallest may take where none has room
    pub(super) fn allow(&mut self, seconds: f64, for_the_smallest: f64) {
        self.allowed_seconds = Some([seconds, for_the_smallest]);
    }

    /// Ends the round that is under way, if anything is known: it would not end in time.
    pub(super) fn abandon_round(&mut self) {
        self.is_cut = self.products.secondary.is_some();
    }

    /// A round is over and the next not begun.
    pub(super) fn is_between_rounds(&self) -> bool {
        self.is_between
    }

    /// What the round that comes next will take; `None` where one is under way or there is no time for another.
    pub(super) fn seconds_of_next_round(&self) -> Option<f64> {
        let divisor = self.is_between.then(|| self.divisor_of_next())??;
        let RoundSeconds { photons, octrees } = self.expected_of_next(divisor);
        Some(photons + octrees)
    }

    /// There was no time for all rounds.
    pub(super) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// What is under way are rounds, and this is not the last.
    pub(super) fn is_before_last_round(&self) -> bool {
        !self.is_cut && self.round + 1 < self.round_count
    }

    /// Seconds that the round will still take, by what the one before took; `None` in the first, and where none is under way.
    pub(super) fn seconds_left_of_round(&self) -> Option<f64> {
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

    /// What this round took so far.
    fn spent(&self) -> RoundSeconds {
        RoundSeconds {
            photons: self.report.photon_seconds - self.begun.photons,
            octrees: self.report.octree_seconds - self.begun.octrees,
        }
    }

    /// What the next round would take, by its photons.
    fn expected_of_next(&self, divisor: u32) -> RoundSeconds {
        let spent = self.spent();
        let growth = f64::from(self.photon_divisor) / f64::from(divisor);
        // The first round does not know yet how many must be sent out for as many to be kept.
        let (sent, pace) = match self.round {
            0 => (f64::from(self.emission_exponent() - self.first_exponent.unwrap_or(0)).exp2(), WARM_PACE),
            _ => (1.0, 1.0),
        };
        let there = self.photons.paths().path_count() as f64;
        let per_photon = spent.photons / (there - self.photons.taken_over_count() as f64).max(1.0);
        let wanted = there * growth * sent;
        // Those that are there are not traced again, unless there are more than are wanted: then none is taken over.
        let traced = if wanted >= there { wanted - there } else { wanted };
        RoundSeconds {
            photons: pace * per_photon * traced,
            octrees: self.expected_of_octrees(divisor, per_photon),
        }
    }

    /// What the octrees of the next round would take: each as long as the newest, and longer by the cells that it has more. Following
    /// surfaces, which is most of the first in scenes of many triangles, takes about as long whatever the size of the cells.
    fn expected_of_octrees(&self, divisor: u32, per_photon: f64) -> f64 {
        let Some(octree) = self.octree.octree() else { return 0.0 };
        let round = Round { photon_divisor: divisor, ..ROUNDS[self.round + 1] };
        let (_, of_next) = settings_of(&self.settings, round, self.exponent);
        let OctreeMade { seconds, cells: before, .. } = self.newest;
        let per_cell = match self.carrier {
            None => PHOTONS_OF_A_CELL * per_photon,
            // What carries photons does not gather them.
            Some(_) => seconds / before.max(1.0),
        };
        let more = |cells: &f64| per_cell * (cells - before).max(0.0);
        octree.cells_by(&of_next).iter().map(|cells| seconds + more(cells)).sum()
    }

    /// All photons over those of the next round: the fewest halvings with which it will end in time; `None` if it would bring no
    /// more photons than this one.
    fn divisor_of_next(&self) -> Option<u32> {
        let wanted = ROUNDS[self.round + 1].photon_divisor;
        let fits = |divisor: u32, allowed: f64| {
            let RoundSeconds { photons, octrees } = self.expected_of_next(divisor);
            photons + octrees <= FILLED_SHARE * allowed
        };
        let divisors = std::iter::successors(Some(wanted), |divisor| divisor.checked_mul(2))
            .take_while(|divisor| *divisor < self.photon_divisor);
        let Some([allowed, for_the_smallest]) = self.allowed_seconds else { return divisors.min() };
        let smallest = divisors.clone().last().filter(|divisor| fits(*divisor, for_the_smallest));
        divisors.into_iter().find(|divisor| fits(*divisor, allowed)).or(smallest)
    }

    /// How many photons more or less than asked for must be sent out for about as many to end up in maps: more where most leave
    /// the scene or fall on what is lit by lamps alone, less where each is kept many times, and memory would have no bound. Found
    /// in the first round, as a power of two so that small edits leave it.
    fn emission_exponent(&self) -> i32 {
        let maps = &self.photons.product().maps;
        let mapped = MAPPED.iter().map(|class| maps.photon_count(*class)).sum::<usize>().max(1);
        let emitted = self.photons.paths().full_count() as f64;
        let sent = self.photons.paths().path_count().max(1) as f64;
        let kept = self.photons.paths().hit_count().max(1) as f64;
        let wanted = (MAPPED_SHARE * emitted / mapped as f64).log2().round().max(0.0);
        let allowed = (KEPT_SHARE_MAX * emitted / kept).log2().round();
        let allowed = allowed.min((SENT_SHARE_MAX * emitted / sent).log2().round());
        let [least, most] = EMISSION_EXPONENTS;
        wanted.min(allowed).clamp(least, most) as i32
    }

    /// Begins a round; what is known stays known until it knows better.
    fn begin_round(&mut self, round: usize, photon_divisor: u32) {
        self.expected = (round > 0).then(|| self.expected_of_next(photon_divisor));
        self.begun =
            RoundSeconds { photons: self.report.photon_seconds, octrees: self.report.octree_seconds };
        self.newest.ready = self.begun.octrees;
        (self.round, self.photon_divisor) = (round, photon_divisor);
        (self.is_between, self.is_cut) = (false, false);
        if round == 1 {
            self.exponent = self.emission_exponent();
        }
        let is_first = round == 0;
        self.first_exponent = self.first_exponent.filter(|_| !is_first);
        let exponent = if is_first { 0 } else { self.exponent };
        let round = Round { photon_divisor, ..ROUNDS[round] };
        let (photons, octree) = settings_of(&self.settings, round, exponent);
        if is_first {
            self.photons = PhotonTracing::new(photons);
        }
        self.send_out(photons);
        self.octree = OctreeBuilding::new(octree);
    }

    /// Sends out so many photons: the same as before, and more, through the same scene.
    fn send_out(&mut self, photons: PhotonSettings) {
        let nothing = PhotonTracing::new(photons);
        self.photons = PhotonTracing::adding_to(std::mem::replace(&mut self.photons, nothing), photons);
        self.carrier.iter().for_each(|carrier| self.photons.carry_by(Arc::clone(carrier)));
        self.products.photons = None;
    }

    /// Decides how many photons the first round takes, by those that it began with; true if more are to be sent out.
    fn fills_first(&mut self) -> bool {
        let exponent = (self.emission_exponent() - 1).clamp(0, FIRST_EXPONENT_MAX);
        self.first_exponent = Some(exponent);
        if exponent == 0 {
            return false;
        }
        let (photons, _) = settings_of(&self.settings, ROUNDS[0], exponent);
        self.send_out(photons);
        true
    }

    /// How far it has got.
    pub fn stage(&self) -> Stage {
        let is_over = self.photons.is_complete() && self.octree.is_complete(self.photons.product());
        if self.is_cut || is_over && !self.is_before_last_round() {
            Stage::Complete
        } else if self.products.secondary.is_some() {
            Stage::Rough
        } else {
            Stage::Nothing
        }
    }

    /// Withdraws what an edit made stale; call before the next [`Illumination::step`]. Where it concerns a great part of
    /// the photons, the rounds begin again: returns whether they do.
    pub fn apply(&mut self, edit: &Edit<'_>) -> bool {
        self.photons.apply(edit);
        self.octree.apply(edit);
        // What follows is decided by the scene as it is now.
        (self.is_between, self.is_cut) = (false, false);
        if edit.before.accel().origin_in_world() != edit.after.accel().origin_in_world() {
            // What is known lies around another origin.
            self.products.secondary = None;
            self.generation += 1;
            self.begin_round(0, ROUNDS[0].photon_divisor);
            return true;
        }
        let paths = self.photons.paths().path_count();
        let begins_again =
            self.round > 0 && self.photons.pending_count() as f64 > TOUCHED_SHARE_MAX * paths as f64;
        if begins_again {
            self.edit_counts = self.photons.edit_counts();
            self.begin_round(0, ROUNDS[0].photon_divisor);
        }
        begins_again
    }

    /// Looks for changes that nobody announced: one photon of every group is traced again.
    pub fn probe(&mut self, world: &World) -> ProbeCounts {
        self.photons.probe(world)
    }

    /// What is known of the light by now.
    pub fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.products.secondary.as_ref()
    }

    /// Counts up whenever [`Illumination::known`] becomes another.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Rays traced so far.
    pub fn counts(&self) -> Counts {
        self.report.counts
    }

    /// The photons.
    pub fn photons(&self) -> &PhotonTracing {
        &self.photons
    }

    /// The octree.
    pub fn octree(&self) -> &OctreeBuilding {
        &self.octree
    }

    /// What the last edit cost.
    pub fn edit_counts(&self) -> EditCounts {
        if self.photons.is_begun() { self.photons.edit_counts() } else { self.edit_counts }
    }

    /// What it took and holds.
    pub fn report(&self) -> IlluminationReport {
        let paths = self.photons.paths();
        IlluminationReport {
            photons_emitted: paths.path_count(),
            photons_stored: paths.hit_count(),
            photon_bytes: paths.bytes() + self.photons.product().maps.bytes(),
            ..self.report
        }
    }
}

/// Photons and octree of a round.
fn settings_of(
    settings: &IlluminationSettings,
    round: Round,
    exponent: i32,
) -> (PhotonSettings, OctreeSettings) {
    let asked_for = (settings.photons.emitted_count / round.photon_divisor).max(1);
    let times = 1 << exponent.unsigned_abs();
    let emitted_count =
        if exponent < 0 { (asked_for / times).max(1) } else { asked_for.saturating_mul(times) };
    let photons = PhotonSettings { emitted_count, ..settings.photons };
    let octree = OctreeSettings {
        depth_first: round.depth_first.min(settings.octree.depth),
        depth: round.depth.min(settings.octree.depth),
        // What a gather may expect to find is what ends up in maps.
        photon_count: asked_for,
        neighbours_min: if round.photon_divisor > 1 {
            settings.octree.neighbours_min.min(NEIGHBOURS_FIRST)
        } else {
            settings.octree.neighbours_min
        },
        ..settings.octree
    };
    (photons, octree)
}
