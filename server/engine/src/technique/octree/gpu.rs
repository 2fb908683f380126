//! Density estimates on a card: for many groups of surfaces at once the nearest photons, and how much surface holds them.
//!
//! What a gather of the CPU does first and longest (`products/gather.rs`): it looks for photons within a flat ellipsoid, farther until there are
//! enough, leaves out what faces away and what lies behind walls, keeps those nearer than the k-th, and cuts the surfaces that they lie
//! on by the ellipsoid and the walls, so that the density is right at borders. The card does so for each gather by one invocation of each of two
//! steps (`shaders/octree/search.wgsl`, `within.wgsl`), by the same rules and operations, with the CPU's numbers. What follows is little and
//! stays there ([`PhotonMaps::gather_found`]): which sides are dark, where light changes, and the clustering.
//!
//! Photons are walked in trees of boxes over the maps as they are sorted (`products/packed_maps.rs`), surfaces in the CPU's own trees. Distances and
//! counts are those of the CPU but where products are added at once; areas are cut in floats where the CPU has doubles.
//!
//! **Watchdogs**: some thousand gathers at once, a few milliseconds of a card. A gather that floats cannot hold, whose photons all lie at one
//! point, that takes more than [`WORK_MAX`] steps or a list beyond [`BYTES_AT_ONCE`], or whose loops a driver cuts short (Mesa's on the CPU
//! do after 65,535 rounds) is the CPU's.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{Constant, OCTREE_SEARCH, OCTREE_WITHIN};

use crate::{
    gpu::{Binding, Buffer, GpuError, Layout, Pipeline, Session},
    technique::{
        FAR_M, Facets, FoundPhotons, GATHER_COUNTS, GATHER_NUMBERS, GatherBounds, NEAR_M, PackedMaps,
        PhotonMaps, SideId, WALLS_MAX,
    },
    transport::PathClass,
};

/// Gathers at once: half a second on two cores that stand for a card, which hide no wait for memory.
const GATHERS_AT_ONCE: usize = 4096;
/// Bytes of a buffer of theirs: more gathers wait for the next slice.
const BYTES_AT_ONCE: u64 = 64 << 20;
/// Nodes, photons and triangles that an invocation of a step looks at: at a microsecond for each, which is slow, a tenth of a second.
const WORK_MAX: u32 = 1 << 17;
/// How often a search looks farther: by a ninth each time, the least that it grows, a million times as far.
const GROWTHS_MAX: u32 = 128;
/// Photons of a gather that a list takes, unless gathers ask for more.
const LIST_MIN: usize = 16;

/// `Asked` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuAsked {
    centre: [f32; 3],
    radius_m: f32,
    normal: [f32; 3],
    radius_max_m: f32,
    walls: [[f32; 4]; WALLS_MAX],
    first_side: u32,
    end_side: u32,
    count_min: u32,
    count_max: u32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
    padding_3: u32,
}

/// `Found` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuFound {
    radius_m: f32,
    reach_m: f32,
    facing_cos: f32,
    count: u32,
    behind_count: u32,
}

/// `Gathers` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuGathers {
    count: u32,
    list_length: u32,
}

/// `Facets` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuFacets {
    facing_m2: [f32; 3],
    area_m2: f32,
    squares_m2: [f32; 3],
    padding_0: f32,
    products_m2: [f32; 3],
    padding_1: f32,
}

/// A gather that is asked for.
#[derive(Clone, Copy, Debug)]
pub struct AskedGather<'a> {
    /// `[n]`, each once, ascending.
    pub sides: &'a [SideId],
    /// Where and how far.
    pub bounds: GatherBounds,
}

/// The photon maps of one class of light on a card, with the surfaces of the scene.
#[derive(Debug)]
pub struct MapsOnCard {
    side_count: usize,
    roots: Buffer,
    nodes: Buffer,
    photons: Buffer,
    surfaces: Buffer,
    extents: Buffer,
    faces: Buffer,
}

/// Searches for gathers on a card. Kept by whoever gathers; the next [`Session`] needs another.
#[derive(Debug)]
pub struct GatherOnCard {
    session: Arc<Session>,
    search: Arc<Pipeline>,
    within: Arc<Pipeline>,
    layout_search: Arc<Layout>,
    layout_within: Arc<Layout>,
    gathers_at_once: usize,
    bytes_at_once: u64,
}

impl GatherOnCard {
    /// What the steps are compiled with.
    pub(crate) fn constants() -> Vec<(&'static str, Constant)> {
        let numbers = GATHER_NUMBERS.map(|(name, value)| (name, Constant::F32(value)));
        let counts = GATHER_COUNTS.map(|(name, count)| (name, Constant::U32(count as u32)));
        let ours = [
            ("WORKGROUP", Constant::U32(OCTREE_SEARCH.workgroup_size[0])),
            ("WALLS_MAX", Constant::U32(WALLS_MAX as u32)),
            ("FAR_M", Constant::F32(FAR_M)),
            ("WORK_MAX", Constant::U32(WORK_MAX)),
            ("GROWTHS_MAX", Constant::U32(GROWTHS_MAX)),
        ];
        numbers.into_iter().chain(counts).chain(ours).collect()
    }

    /// Compiles the steps, which a session does once.
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn new(session: &Arc<Session>) -> Result<GatherOnCard, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let layout_search = session.layout(&[uniform, read, read, read, read, read, write, write])?;
        let layout_within = session.layout(&[uniform, read, read, read, read, read, read, write])?;
        let constants = GatherOnCard::constants();
        Ok(GatherOnCard {
            session: Arc::clone(session),
            search: session.pipeline(&OCTREE_SEARCH, &constants, &[&layout_search])?,
            within: session.pipeline(&OCTREE_WITHIN, &constants, &[&layout_within])?,
            layout_search,
            layout_within,
            gathers_at_once: GATHERS_AT_ONCE,
            bytes_at_once: BYTES_AT_ONCE.min(session.limits.max_storage_buffer_binding_size),
        })
    }

    /// Brings the maps of a class to the card, with the surfaces: about 45 bytes a photon and 150 a triangle.
    ///
    /// - returns `None` for classes without maps
    ///
    /// Errors: [`GpuError::OutOfMemory`] where they have no room, [`GpuError::Lost`], [`GpuError::Failed`].
    pub fn upload(&self, maps: &PhotonMaps, class: PathClass) -> Result<Option<MapsOnCard>, GpuError> {
        let Some(class) = PhotonMaps::class_of(class) else { return Ok(None) };
        self.upload_packed(&maps.packed(class)).map(Some)
    }

    fn upload_packed(&self, packed: &PackedMaps) -> Result<MapsOnCard, GpuError> {
        let session = &self.session;
        Ok(MapsOnCard {
            side_count: packed.roots.len(),
            roots: session.buffer_of("sides of photon maps", &packed.roots)?,
            nodes: session.buffer_of("trees of photons", &packed.nodes)?,
            photons: session.buffer_of("photons", &packed.photons)?,
            surfaces: session.buffer_of("surfaces", &packed.extents.roots)?,
            extents: session.buffer_of("trees of surfaces", &packed.extents.nodes)?,
            faces: session.buffer_of("triangles of surfaces", &packed.extents.faces)?,
        })
    }

    /// What searches for these gathers find, in their order: what [`PhotonMaps::gather`] finds but for rounding, to be handed to
    /// [`PhotonMaps::gather_found`]. `None` for those that the CPU is to make.
    ///
    /// Errors: [`GpuError::OutOfMemory`], [`GpuError::Lost`], [`GpuError::TimedOut`], [`GpuError::Failed`].
    pub fn find(
        &self,
        maps: &MapsOnCard,
        asked: &[AskedGather<'_>],
    ) -> Result<Vec<Option<FoundPhotons>>, GpuError> {
        let mut found = Vec::with_capacity(asked.len());
        let mut rest = asked;
        while !rest.is_empty() {
            let slice = Slice::first_of(rest, self, maps);
            rest = &rest[slice.taken..];
            found.extend(slice.found(self, maps)?);
        }
        Ok(found)
    }
}

/// Gathers that are made at once.
struct Slice {
    /// Of those that were asked for, from the first on.
    taken: usize,
    /// Those that a card can make, by place among them.
    places: Vec<usize>,
    gathers: Vec<GpuAsked>,
    sides: Vec<u32>,
    list_length: usize,
}

impl Slice {
    const EMPTY: Slice =
        Slice { taken: 0, places: Vec::new(), gathers: Vec::new(), sides: Vec::new(), list_length: LIST_MIN };

    /// As many as have room.
    fn first_of(asked: &[AskedGather<'_>], card: &GatherOnCard, maps: &MapsOnCard) -> Slice {
        let mut slice = Slice::EMPTY;
        for gather in asked.iter().take(card.gathers_at_once.max(1)) {
            let are_known = gather.sides.iter().all(|side| side.index() < maps.side_count);
            let has_room = Slice::EMPTY.bytes_with(gather) <= card.bytes_at_once;
            if are_known && has_room && gather.bounds.is_sound() {
                if slice.bytes_with(gather) > card.bytes_at_once {
                    break;
                }
                slice.add(slice.taken, gather);
            }
            slice.taken += 1;
        }
        slice
    }

    /// Fewer than these are listed, unless they lie at one point.
    fn list_length_with(&self, gather: &AskedGather<'_>) -> usize {
        let (_, count_max) = gather.bounds.first_look();
        self.list_length.max(count_max).max(gather.bounds.count_min.get())
    }

    /// Its largest buffer with one more gather.
    fn bytes_with(&self, gather: &AskedGather<'_>) -> u64 {
        let bytes = |count: usize, each: usize| (count as u64).saturating_mul(each as u64);
        let count = self.gathers.len() + 1;
        let list = self.list_length_with(gather).saturating_mul(size_of::<[u32; 2]>());
        let sides = bytes(self.sides.len() + gather.sides.len(), size_of::<GpuFacets>());
        bytes(count, list).max(bytes(count, size_of::<GpuAsked>())).max(sides)
    }

    fn add(&mut self, place: usize, gather: &AskedGather<'_>) {
        let bounds = &gather.bounds;
        let (radius_m, count_max) = bounds.first_look();
        let mut walls = [[0.0, 0.0, 0.0, FAR_M]; WALLS_MAX];
        for (wall, (away, distance_m)) in walls.iter_mut().zip(bounds.walls.nearest_first()) {
            *wall = away.extend(distance_m).to_array();
        }
        let first_side = self.sides.len() as u32;
        self.sides.extend(gather.sides.iter().map(|side| side.index() as u32));
        self.list_length = self.list_length_with(gather);
        self.places.push(place);
        self.gathers.push(GpuAsked {
            centre: bounds.centre.to_array(),
            radius_m,
            normal: bounds.normal.to_array(),
            radius_max_m: bounds.radius_max_m,
            walls,
            first_side,
            end_side: self.sides.len() as u32,
            count_min: bounds.count_min.get() as u32,
            count_max: count_max as u32,
            padding_0: 0,
            padding_1: 0,
            padding_2: 0,
            padding_3: 0,
        });
    }

    fn found(self, card: &GatherOnCard, maps: &MapsOnCard) -> Result<Vec<Option<FoundPhotons>>, GpuError> {
        let mut all = vec![None; self.taken];
        if self.gathers.is_empty() {
            return Ok(all);
        }
        let session = &card.session;
        let count = self.gathers.len();
        let header = GpuGathers { count: count as u32, list_length: self.list_length as u32 };
        let header = session.buffer_of("gathers", &[header])?;
        let asked = session.buffer_of("gathers that are asked for", &self.gathers)?;
        let sides = session.buffer_of("their sides", &self.sides)?;
        let found = session.buffer_zeroed("what gathers found", (count * size_of::<GpuFound>()) as u64)?;
        let lists = (count * self.list_length * size_of::<[u32; 2]>()) as u64;
        let lists = session.buffer_zeroed("photons of gathers", lists)?;
        let areas = (self.sides.len().max(1) * size_of::<GpuFacets>()) as u64;
        let areas = session.buffer_zeroed("surfaces of gathers", areas)?;
        let MapsOnCard { roots, nodes, photons, surfaces, extents, faces, .. } = maps;
        let of_search = [&header, &asked, &sides, roots, nodes, photons, &found, &lists];
        let of_search = session.bind(&card.layout_search, &of_search)?;
        let of_within = [&header, &asked, &sides, &found, surfaces, extents, faces, &areas];
        let of_within = session.bind(&card.layout_within, &of_within)?;
        let mut batch = session.batch("photons of gathers")?;
        batch.dispatch(&card.search, &[&of_search], card.search.workgroups(count as u64))?;
        batch.submit()?;
        let mut batch = session.batch("surfaces of gathers")?;
        batch.dispatch(&card.within, &[&of_within], card.within.workgroups(count as u64))?;
        let [found, lists, areas] =
            [&found, &lists, &areas].map(|buffer| batch.read_back(buffer, 0..buffer.byte_count()));
        let (found, lists, areas) = (found?, lists?, areas?);
        batch.submit()?;
        let found: Vec<GpuFound> = bytemuck::pod_collect_to_vec(&found.collect()?);
        let lists: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(&lists.collect()?);
        let areas: Vec<GpuFacets> = bytemuck::pod_collect_to_vec(&areas.collect()?);
        for ((index, found), place) in found.iter().enumerate().zip(&self.places) {
            let list = &lists[index * self.list_length..][..self.list_length];
            let gather = &self.gathers[index];
            let areas = &areas[gather.first_side as usize..gather.end_side as usize];
            all[*place] = answer(found, list, areas);
        }
        Ok(all)
    }
}

/// `None` where a list was too short, a loop was, or a number is none.
fn answer(found: &GpuFound, list: &[[u32; 2]], areas: &[GpuFacets]) -> Option<FoundPhotons> {
    let near = list.get(..found.count as usize)?.to_vec();
    let of_sides = areas.iter().map(|facets| {
        Facets::of_sums(facets.area_m2, [facets.facing_m2, facets.squares_m2, facets.products_m2])
    });
    let of_sides: Vec<Facets> = of_sides.collect();
    let is_whole = areas.iter().all(|facets| facets.area_m2 >= 0.0);
    let is_sound = is_whole && found.radius_m >= NEAR_M && found.reach_m.is_finite();
    (is_sound && of_sides.iter().all(Facets::is_finite)).then_some(FoundPhotons {
        radius_m: found.radius_m,
        reach_m: found.reach_m,
        facing_cos: found.facing_cos,
        behind_count: found.behind_count as usize,
        near,
        of_sides,
    })
}
