//! What a scene knows of its light, whoever looks at it.

mod rounds;

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use super::{RenderSettings, learning::RoundName};
use crate::{
    technique::{
        Counts, Edit, PhotonCarrier, Products, SecondaryLight, Step, Technique,
        irradiance::IrradianceSettings,
        octree::{OctreeBuilding, OctreeSettings},
        photons::{EditCounts, PhotonSettings, PhotonTracing, ProbeCounts},
    },
    transport::World,
};
use rounds::{OctreeMade, ROUNDS, ROUNDS_GATHERED_FROM, RoundSeconds, settings_of};

/// Share of the paths that an edit may touch before the rounds begin again: beyond, a rough answer soon is worth more than
/// the right one later.
const TOUCHED_SHARE_MAX: f64 = 0.2;

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
    /// The one before.
    newest_but_one: OctreeMade,
    /// Photons that it was made of.
    known_photons: u64,
    /// Seconds that it may still take, and that the smallest of further rounds may.
    allowed_seconds: Option<[f64; 2]>,
    /// A round is over and the next not begun: what is drawn in between takes of the time there is.
    is_between: bool,
    /// No further round would end in time, or the one under way would not.
    is_cut: bool,
    /// A round that was made smaller to end in time comes once more, larger.
    enlarges_round: bool,
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
        let (photons, octree) = settings_of(&settings, round_count, (0, ROUNDS[0].photon_divisor), 0);
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
            newest_but_one: OctreeMade::default(),
            known_photons: 0,
            allowed_seconds: None,
            is_between: false,
            is_cut: false,
            enlarges_round: false,
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
                Some(divisor) => self.begin_round(self.next_round(), divisor),
                None => {
                    (self.is_cut, self.enlarges_round) = (true, false);
                    return false;
                }
            }
        }
        let before = self.products.secondary.clone();
        if self.first_exponent.is_none() && self.photons.is_complete() {
            self.fill_first();
        }
        // Whatever was sent out is begun in the same step: what is not begun yet takes note of no edit.
        if !self.photons.is_complete() {
            let mut step = Step { world, products: &mut self.products, canvas: None, cancel };
            let progress = self.photons.step(&mut step);
            self.report.counts += progress.counts;
            self.report.photon_seconds += start.elapsed().as_secs_f64();
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
                let neighbours = octree.neighbours_min() as f64;
                let newest = OctreeMade { seconds, cells, neighbours, ready };
                self.newest_but_one = std::mem::replace(&mut self.newest, newest);
            }
            self.newest.ready = ready;
            self.known_photons = self.photons.paths().path_count();
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

    /// It may take as long as it takes, or as it is [allowed](Illumination::allow) from now on: what was cut goes on, and a round that was made
    /// smaller to end in time is made whole, or larger at least.
    pub(super) fn take_its_time(&mut self) {
        self.allowed_seconds = None;
        self.is_cut = false;
        self.enlarges_round = true;
        self.is_between = self.is_round_over() && self.is_before_last_round();
    }

    /// Ends the round that is under way, if anything is known: it would not end in time.
    pub(super) fn abandon_round(&mut self) {
        self.is_cut = self.products.secondary.is_some();
    }

    /// A round is over and the next not begun.
    pub(super) fn is_between_rounds(&self) -> bool {
        self.is_between
    }

    /// There was no time for all rounds.
    pub(super) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// The first of the rounds is under way, and nothing is known of what it brings.
    pub(super) fn is_in_first_round(&self) -> bool {
        self.round == 0 && !self.is_between && self.stage() != Stage::Complete
    }

    /// What is under way is not far from its next octree: no more photons are to be traced than a small edit may touch. Where that leaves most
    /// groups alone the octree is soon made.
    pub(super) fn is_near_an_octree(&self) -> bool {
        !self.is_between
            && self.stage() != Stage::Complete
            && self.photons.is_begun()
            && self.pending_share() <= TOUCHED_SHARE_MAX
    }

    /// Share of the photons that are to be traced.
    fn pending_share(&self) -> f64 {
        self.photons.pending_count() as f64 / self.photons.paths().path_count().max(1) as f64
    }

    /// What is under way are rounds, and this is not the last.
    pub(super) fn is_before_last_round(&self) -> bool {
        !self.is_cut && self.next_round() < self.round_count
    }

    /// Place of the round that comes next in [`ROUNDS`]: the same once more where it was made smaller than it is to be now.
    pub(super) fn next_round(&self) -> usize {
        let is_smaller = self.photon_divisor > ROUNDS[self.round].photon_divisor;
        if is_smaller && self.enlarges_round { self.round } else { self.round + 1 }
    }

    /// What tells the round that is under way from others.
    pub(super) fn round_name(&self) -> RoundName {
        (self.round, self.photon_divisor)
    }

    /// All that this round brings is known.
    fn is_round_over(&self) -> bool {
        self.photons.is_complete() && self.octree.is_complete(self.photons.product())
    }

    /// Begins a round; what is known stays known until it knows better.
    fn begin_round(&mut self, round: usize, photon_divisor: u32) {
        self.expected = (round > 0).then(|| self.expected_of_next(photon_divisor));
        self.begun =
            RoundSeconds { photons: self.report.photon_seconds, octrees: self.report.octree_seconds };
        if round == 0 {
            // Octrees of before the rounds began again say nothing of what theirs take.
            self.newest = OctreeMade::default();
        }
        self.newest.ready = self.begun.octrees;
        let is_second = round == 1 && self.round == 0;
        (self.round, self.photon_divisor) = (round, photon_divisor);
        (self.is_between, self.is_cut, self.enlarges_round) = (false, false, false);
        if is_second {
            self.exponent = self.emission_exponent();
        }
        let is_first = round == 0;
        self.first_exponent = self.first_exponent.filter(|_| !is_first);
        let exponent = if is_first { 0 } else { self.exponent };
        let (photons, octree) = self.settings_of_round(round, photon_divisor, exponent);
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

    /// Decides how many photons the first round takes, by those that it began with, and sends out what is missing.
    fn fill_first(&mut self) {
        let exponent = self.exponent_of_first();
        self.first_exponent = Some(exponent);
        if exponent > 0 {
            let (photons, _) = self.settings_of_round(0, self.photon_divisor, exponent);
            self.send_out(photons);
        }
    }

    /// How far it has got.
    pub fn stage(&self) -> Stage {
        if self.is_cut || self.is_round_over() && !self.is_before_last_round() {
            Stage::Complete
        } else if self.products.secondary.is_some() {
            Stage::Rough
        } else {
            Stage::Nothing
        }
    }

    /// Withdraws what an edit made stale; call before the next [`Illumination::step`]. Where it concerns a great part of
    /// the photons, the rounds begin again: returns whether they do so from a later one, or around another origin. The first decides
    /// again how many photons it takes then; a small edit leaves that, as it does in later rounds.
    pub fn apply(&mut self, edit: &Edit<'_>) -> bool {
        self.photons.apply(edit);
        self.octree.apply(edit);
        // What was made of an octree up to now is not of the one that will be.
        self.newest.ready = self.report.octree_seconds;
        // What follows is decided by the scene as it is now.
        (self.is_between, self.is_cut) = (false, false);
        if edit.before.accel().origin_in_world() != edit.after.accel().origin_in_world() {
            // What is known lies around another origin.
            self.products.secondary = None;
            self.generation += 1;
            self.photons = PhotonTracing::new(self.settings.photons);
            self.begin_round(0, ROUNDS[0].photon_divisor);
            return true;
        }
        let is_first = self.round == 0;
        let touches_much = self.pending_share() > TOUCHED_SHARE_MAX;
        if touches_much && (!is_first || self.first_exponent.is_some()) {
            self.edit_counts = self.photons.edit_counts();
            self.begin_round(0, ROUNDS[0].photon_divisor);
        }
        touches_much && !is_first
    }

    /// Looks for changes that nobody announced: one photon of every group is traced again.
    pub fn probe(&mut self, world: &World) -> ProbeCounts {
        self.photons.probe(world)
    }

    /// What is known of the light by now.
    pub fn known(&self) -> Option<&Arc<dyn SecondaryLight>> {
        self.products.secondary.as_ref()
    }

    /// Photons that what is known was made of.
    pub(super) fn known_photons(&self) -> u64 {
        self.known_photons
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
            photon_bytes: paths.bytes() + self.photons.product().bytes(),
            ..self.report
        }
    }
}
