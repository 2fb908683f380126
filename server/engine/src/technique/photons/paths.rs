//! Photon paths as they are kept: every surface that a photon reached, so that it can be withdrawn with all its hits.
//!
//! Photons lie light by light, stratum by stratum, block by block, number by number: the order, and with it every byte,
//! depends on nothing but the scene. A hit takes 36 bytes, a path 28.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    passed::CoarseGrid,
    sequence::{STRATA, Sequence, name_key},
    trace::FluxTally,
};
use crate::{
    accel::Hit,
    math::{Rgb, octahedral},
    technique::{
        FallenPhoton, Flight, KeptPhoton, MAPPED, PHOTON_MARK_BITS, PHOTON_MARK_DIFFUSE, PHOTON_MARK_FRONT,
        TriangleSide,
    },
    transport::{PathClass, Source, SourceName, Surface, World},
};

/// Photons of a block, the piece that is traced, kept and changed as one.
pub(super) const BLOCK: u32 = 64;

/// A photon where it fell on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct PhotonHit {
    /// Where, in render space.
    pub position: Vec3,
    /// Flux in shares of the source's flux per photon; of luminance about 1, but for light that is aimed, see [`Source::is_aimed`].
    pub weight: Rgb,
    /// Index of the triangle.
    pub triangle: u32,
    /// Where it came from, octahedral.
    direction: u32,
    /// Index of the instance above four bits: two for the class, one for the front, one for a diffuse lobe.
    place: u32,
}

const MARK_CLASS: u32 = 3;
/// The instance of hits on what is gone.
const GONE: u32 = u32::MAX >> PHOTON_MARK_BITS;

impl PhotonHit {
    pub(super) fn new(
        surface: &Surface,
        hit: &Hit,
        towards_light: Vec3,
        weight: Rgb,
        class: PathClass,
    ) -> PhotonHit {
        let mut marks = class as u32;
        if towards_light.dot(surface.point.n_geo) > 0.0 {
            marks |= PHOTON_MARK_FRONT;
        }
        if surface.bsdf.has_diffuse() {
            marks |= PHOTON_MARK_DIFFUSE;
        }
        PhotonHit {
            position: surface.point.position,
            weight,
            triangle: hit.triangle,
            direction: octahedral::encode(towards_light),
            place: hit.instance << PHOTON_MARK_BITS | marks,
        }
    }

    /// Of what a carrier kept.
    ///
    /// - `place`: index of the instance and marks, as here
    pub(super) fn kept(world: &World, kept: &KeptPhoton, place: u32) -> PhotonHit {
        let [b1, b2] = kept.barycentric;
        let placed = &world.accel().instances()[(place >> PHOTON_MARK_BITS) as usize];
        PhotonHit {
            position: placed.surface_point(kept.triangle, b1, b2).position,
            weight: kept.weight,
            triangle: kept.triangle,
            direction: octahedral::encode(-kept.direction),
            place,
        }
    }

    /// Index of the instance; `None` for one that is gone.
    pub fn instance(&self) -> Option<u32> {
        let instance = self.place >> PHOTON_MARK_BITS;
        (instance != GONE).then_some(instance)
    }

    /// Gives the instance another number, or none.
    pub(super) fn rename_instance(&mut self, instance: Option<u32>) {
        self.place =
            instance.unwrap_or(GONE) << PHOTON_MARK_BITS | self.place & ((1 << PHOTON_MARK_BITS) - 1);
    }

    /// Unit direction to where it came from.
    pub fn direction(&self) -> Vec3 {
        octahedral::decode(self.direction)
    }

    /// Path class of what a diffuse lobe here sends to the eye of it.
    pub fn class(&self) -> PathClass {
        PathClass::ALL[(self.place & MARK_CLASS) as usize]
    }

    /// It fell on the triangle's front.
    pub fn is_on_front(&self) -> bool {
        self.place & PHOTON_MARK_FRONT != 0
    }

    /// What it fell on; `None` for what is gone.
    pub fn side(&self) -> Option<TriangleSide> {
        let instance = self.instance()?;
        Some(TriangleSide { instance, triangle: self.triangle, is_front: self.is_on_front() })
    }

    /// The surface has a diffuse lobe that can show it.
    pub fn is_on_diffuse(&self) -> bool {
        self.place & PHOTON_MARK_DIFFUSE != 0
    }
}

/// The way of one photon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotonPath {
    /// Where it left its light, in render space.
    pub start: Vec3,
    /// Where it went when it left the scene, from its last hit on, octahedral; `ABSORBED` when it was absorbed.
    pub(super) escape: u32,
    /// Its first hit in the block; the next path's first hit is where its hits end.
    pub first_hit: u32,
}

/// No packed direction: both coordinates at their lowest, which none encodes to.
const ABSORBED: u32 = 0x8000_8000;

impl PhotonPath {
    /// One that has not gone anywhere yet.
    pub(super) fn from(start: Vec3, first_hit: u32) -> PhotonPath {
        PhotonPath { start, escape: ABSORBED, first_hit }
    }

    pub(super) fn escape_towards(&mut self, direction: Vec3) {
        self.escape = octahedral::encode(direction);
    }

    /// Where it went when it left the scene, from its last hit on, to 0.004°; `None` when it was absorbed.
    pub fn escape(&self) -> Option<Vec3> {
        (self.escape != ABSORBED).then(|| octahedral::decode(self.escape))
    }
}

/// Some photons of one stratum, in order of their numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Block {
    pub(super) paths: Vec<PhotonPath>,
    pub(super) hits: Vec<PhotonHit>,
    /// `[paths]`: cells of [`PhotonPaths::grid`] that each passed.
    pub(super) passed: Vec<u64>,
}

impl Block {
    /// The hits of path `index` of the block.
    pub(super) fn hits_of(&self, index: usize) -> &[PhotonHit] {
        let first = self.paths[index].first_hit as usize;
        let end = self.paths.get(index + 1).map_or(self.hits.len(), |next| next.first_hit as usize);
        &self.hits[first..end]
    }

    /// The same; none of a path that it does not have.
    pub(super) fn hits_of_any(&self, index: usize) -> &[PhotonHit] {
        if index < self.paths.len() { self.hits_of(index) } else { &[] }
    }

    /// Keeps its first paths.
    fn shorten(&mut self, count: usize) {
        if let Some(gone) = self.paths.get(count) {
            self.hits.truncate(gone.first_hit as usize);
            self.paths.truncate(count);
            self.passed.truncate(count);
        }
    }

    /// The last flight of each photon of a class that maps hold, in order: where it began, and where it ended.
    fn flights_of(&self, class: PathClass) -> impl Iterator<Item = (&PhotonHit, &PhotonHit)> {
        let ways = (0..self.paths.len()).flat_map(|index| self.hits_of(index).windows(2));
        let is_of = move |(_, hit): &(_, &PhotonHit)| hit.is_on_diffuse() && hit.class() == class;
        ways.map(|way| (&way[0], &way[1])).filter(is_of)
    }

    /// Every stretch that its photons flew, from where and by how much; those that left the scene by one metre.
    pub(super) fn ways(&self) -> impl Iterator<Item = (Vec3, Vec3)> {
        (0..self.paths.len()).flat_map(|index| {
            let (hits, path) = (self.hits_of(index), &self.paths[index]);
            let ends = hits.iter().map(|hit| hit.position);
            let starts = std::iter::once(path.start).chain(ends.clone());
            let last = hits.last().map_or(path.start, |hit| hit.position);
            let ways = starts.zip(ends).map(|(from, to)| (from, to - from));
            ways.chain(path.escape().map(|direction| (last, direction)))
        })
    }

    fn bytes(&self) -> usize {
        self.paths.capacity() * size_of::<PhotonPath>()
            + self.hits.capacity() * size_of::<PhotonHit>()
            + self.passed.capacity() * size_of::<u64>()
    }
}

/// Where a block stands. In the order of tracing: the first block of every stratum says how many photons the others are to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct BlockName {
    pub(super) source: u32,
    /// Place among the blocks of the stratum.
    pub(super) place: u32,
    pub(super) stratum: u32,
}

/// Strata of a light of so many photons.
pub(super) fn strata_of(count: u32) -> u32 {
    STRATA.iter().rev().find(|(_, from)| count >= *from).map_or(1, |(strata, _)| *strata)
}

/// All photons of one light.
#[derive(Clone, Debug)]
pub(super) struct SourcePhotons {
    pub(super) source: Source,
    pub(super) sequence: Sequence,
    /// Photons emitted if no stratum is thinned out.
    pub(super) count: u32,
    /// How often the photons of a stratum are halved, `[strata]`.
    halvings: Vec<u32>,
    /// Where the flux of what was traced went, of pilots and others, in shares of a photon's, `[strata]`.
    pub(super) tallies: Vec<[FluxTally; 2]>,
    /// `[strata][blocks]`.
    pub(super) strata: Vec<Vec<Block>>,
}

impl SourcePhotons {
    /// None traced yet.
    pub(super) fn new(source: Source, seed: u64, count: u32) -> SourcePhotons {
        let key = match source.name() {
            SourceName::Punctual(id) => name_key(id.as_str(), 0),
            SourceName::Surface(node, primitive) => name_key(node.as_str(), 2 + u64::from(*primitive)),
            SourceName::Environment => name_key("", 1),
        };
        let sequence = Sequence::new(seed, key, source.is_one_way());
        let strata = strata_of(count) as usize;
        let (halvings, tallies) = (vec![0; strata], vec![[FluxTally::default(); 2]; strata]);
        let mut photons =
            SourcePhotons { source, sequence, count, halvings, tallies, strata: vec![Vec::new(); strata] };
        (0..strata).for_each(|stratum| photons.lay_out(stratum as u32));
        photons
    }

    /// Flux of a photon of weight 1, W. Pilots carry as much as if none were thinned out, and the others of their stratum together
    /// as much as they all would: a stratum whose pilots met little by chance would else count what they met for more than a
    /// stratum whose pilots were lucky, and light would be lost.
    pub(super) fn flux_w(&self, stratum: u32, is_pilot: bool) -> f32 {
        let full_w = self.source.power_w() / f64::from(self.count.max(1));
        let others = |count: u32| f64::from(count.saturating_sub(BLOCK).max(1));
        let thinned = others(self.full_count_in(stratum)) / others(self.count_in(stratum));
        (if is_pilot { full_w } else { full_w * thinned }) as f32
    }

    /// Photons emitted.
    pub(super) fn path_count(&self) -> u64 {
        (0..self.strata.len() as u32).map(|stratum| u64::from(self.count_in(stratum))).sum()
    }

    /// Photons of a stratum that is not thinned out.
    pub(super) fn full_count_in(&self, stratum: u32) -> u32 {
        self.count.saturating_sub(stratum).div_ceil(self.strata.len() as u32)
    }

    /// The pilots, which tell how many others there are, and these.
    fn count_in(&self, stratum: u32) -> u32 {
        let full = self.full_count_in(stratum);
        let pilots = full.min(BLOCK);
        pilots + ((full - pilots) >> self.halvings[stratum as usize])
    }

    /// How often the photons of a stratum are halved.
    pub(super) fn halvings(&self, stratum: u32) -> u32 {
        self.halvings[stratum as usize]
    }

    /// Halves the photons of a stratum so many times: what is left are the first of them.
    pub(super) fn thin_out(&mut self, stratum: u32, halvings: u32) {
        self.halvings[stratum as usize] = halvings;
        self.lay_out(stratum);
    }

    /// Makes room for the photons of a stratum; those that are known stay.
    fn lay_out(&mut self, stratum: u32) {
        let count = self.count_in(stratum);
        let blocks = &mut self.strata[stratum as usize];
        blocks.resize_with(count.div_ceil(BLOCK) as usize, Block::default);
        if let (Some(last), rest @ 1..) = (blocks.last_mut(), count % BLOCK) {
            last.shorten(rest as usize);
        }
    }

    /// The paths of fewer photons of the same light, sent out with the same seed.
    pub(super) fn take_over(&mut self, fewer: SourcePhotons) {
        let is_same = self.source.name() == fewer.source.name() && self.source.emits_like(&fewer.source);
        if !is_same || fewer.count > self.count || fewer.strata.len() != self.strata.len() {
            return;
        }
        for (blocks, known) in self.strata.iter_mut().zip(fewer.strata) {
            blocks.iter_mut().zip(known).for_each(|(block, known)| *block = known);
        }
    }

    /// A block, and a bit for each of its photons.
    pub(super) fn all_of(&self, name: BlockName) -> (BlockName, u64) {
        let count = self.numbers(name).count() as u32;
        (name, u64::MAX.checked_shr(BLOCK - count).unwrap_or(0))
    }

    /// A block, and a bit for each of its photons that has no path yet.
    pub(super) fn unknown_of(&self, name: BlockName) -> (BlockName, u64) {
        let known = self.strata[name.stratum as usize][name.place as usize].paths.len() as u32;
        let (name, all) = self.all_of(name);
        (name, all & u64::MAX.checked_shl(known).unwrap_or(0))
    }

    /// Every block with the flux of a photon of weight 1, W, in order.
    fn each_block(&self) -> impl Iterator<Item = (f32, &Block)> {
        (0..).zip(&self.strata).flat_map(move |(stratum, blocks)| {
            let of_place = move |place| self.flux_w(stratum, place == 0);
            (0..).zip(blocks).map(move |(place, block)| (of_place(place), block))
        })
    }

    /// Numbers of the photons of a block.
    pub(super) fn numbers(&self, name: BlockName) -> impl Iterator<Item = u32> + use<> {
        let strata = self.strata.len() as u32;
        let first = name.place * BLOCK;
        let end = (first + BLOCK).min(self.count_in(name.stratum));
        (first..end).map(move |rank| rank * strata + name.stratum)
    }
}

/// All photons of a scene.
#[derive(Clone, Debug, Default)]
pub struct PhotonPaths {
    pub(super) sources: Vec<SourcePhotons>,
    /// Of the scene that was looked at first.
    pub(super) grid: CoarseGrid,
}

impl PhotonPaths {
    /// Names of all blocks, in order.
    pub(super) fn blocks(&self) -> Vec<BlockName> {
        let mut names = Vec::new();
        for (source, photons) in (0..).zip(&self.sources) {
            for (stratum, blocks) in (0..).zip(&photons.strata) {
                names.extend((0..blocks.len() as u32).map(|place| BlockName { source, stratum, place }));
            }
        }
        names
    }

    pub(super) fn block(&self, name: BlockName) -> &Block {
        &self.sources[name.source as usize].strata[name.stratum as usize][name.place as usize]
    }

    pub(super) fn block_mut(&mut self, name: BlockName) -> &mut Block {
        &mut self.sources[name.source as usize].strata[name.stratum as usize][name.place as usize]
    }

    /// Photons of some light are aimed at things on wide ground.
    pub fn is_aimed(&self) -> bool {
        self.sources.iter().any(|photons| photons.source.is_aimed())
    }

    /// Lights that photons come from.
    pub fn sources_count(&self) -> usize {
        self.sources.len()
    }

    /// Photons emitted.
    pub fn path_count(&self) -> u64 {
        self.sources.iter().map(SourcePhotons::path_count).sum()
    }

    /// Photons that would have been emitted if no light were [thinned out](super::PhotonTracing).
    pub fn full_count(&self) -> u64 {
        self.sources.iter().map(|photons| u64::from(photons.count)).sum()
    }

    /// Every photon's path and what it reached, in order.
    pub fn each(&self) -> impl Iterator<Item = (&PhotonPath, &[PhotonHit])> {
        let of_block = |(_, block): (f32, _)| {
            let block: &Block = block;
            (0..block.paths.len()).map(move |index| (&block.paths[index], block.hits_of(index)))
        };
        self.each_block().flat_map(of_block)
    }

    /// Hits kept.
    pub fn hit_count(&self) -> u64 {
        self.each_block().map(|(_, block)| block.hits.len() as u64).sum()
    }

    /// Memory of paths and hits.
    pub fn bytes(&self) -> usize {
        self.each_block().map(|(_, block)| block.bytes() + size_of::<Block>()).sum()
    }

    /// Every block with the flux of a photon of weight 1, W, in order.
    pub(super) fn each_block(&self) -> impl Iterator<Item = (f32, &Block)> {
        self.sources.iter().flat_map(SourcePhotons::each_block)
    }

    /// Every stretch that photons flew, from where and by how much, in order; those that left the scene by one metre.
    pub fn segments(&self) -> impl Iterator<Item = (Vec3, Vec3)> {
        self.each_block().flat_map(|(_, block)| block.ways())
    }

    /// Every hit that maps hold, in order.
    pub(super) fn mapped(&self) -> impl ParallelIterator<Item = (PathClass, TriangleSide, FallenPhoton)> {
        let blocks: Vec<(f32, &Block)> = self.each_block().collect();
        blocks.into_par_iter().flat_map_iter(|(flux_w, block)| {
            let is_mapped = |hit: &&PhotonHit| hit.is_on_diffuse() && MAPPED.contains(&hit.class());
            block.hits.iter().filter(is_mapped).filter_map(move |hit| {
                let (position, flux, direction) = (hit.position, hit.weight * flux_w, hit.direction);
                Some((hit.class(), hit.side()?, FallenPhoton { position, flux, direction }))
            })
        })
    }

    /// The last flights of some photons of one class that maps hold, in order; see [`Flight::is_asked`]. Each has the flux of those that it
    /// stands for.
    ///
    /// Of light that only mirrors and glass sent on, those of lights with a size: of lights without, no path finds what is perfectly smooth
    /// sent on. (What rough metal sends on of such lights paths do find, by light sampling there; nothing leads them to it.)
    ///
    /// - `count`: that maps hold of the class
    /// - `normal_of`: unit normal of a triangle on a side of it
    pub fn flights(
        &self,
        (class, count): (PathClass, usize),
        normal_of: impl Fn(TriangleSide) -> Vec3 + Sync,
    ) -> Vec<Flight> {
        let is_focused = class == PathClass::Caustic;
        let is_met = |photons: &&SourcePhotons| !(is_focused && photons.source.is_delta());
        let sources = self.sources.iter().filter(|_| count > 0).filter(is_met);
        let blocks: Vec<(f32, &Block)> = sources.flat_map(SourcePhotons::each_block).collect();
        // Which of them are asked hangs on their numbers, and those on how many go before a block's.
        let counts: Vec<usize> =
            blocks.par_iter().map(|(_, block)| block.flights_of(class).count()).collect();
        let mut next = 0;
        let firsts = counts.into_iter().map(|count| {
            next += count as u64;
            next - count as u64
        });
        let blocks: Vec<(u64, (f32, &Block))> = firsts.zip(blocks).collect();
        let flux_share = Flight::asked_share(count) as f32;
        let of_block = |(first, (flux_w, block)): (u64, (f32, &Block))| -> Vec<Flight> {
            let asked =
                (first..).zip(block.flights_of(class)).filter(|(number, _)| Flight::is_asked(*number, count));
            let flights = asked.filter_map(|(_, (before, hit))| {
                let (from, to, normal) = (before.position, hit.position, normal_of(hit.side()?));
                Some(Flight { from, to, normal, flux_w: hit.weight.mean() * flux_w / flux_share, is_focused })
            });
            flights.collect()
        };
        blocks.into_par_iter().flat_map_iter(of_block).collect()
    }

    /// Every hit with its flux, W, in order.
    pub fn hits(&self) -> impl Iterator<Item = (&PhotonHit, Rgb)> {
        self.each_block()
            .flat_map(|(flux_w, block)| block.hits.iter().map(move |hit| (hit, hit.weight * flux_w)))
    }
}
