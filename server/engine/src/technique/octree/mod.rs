//! Light octree: photons summed up per cell as a few directional lights, for look-ups at the speed of shading.
//!
//! The scene's cube is halved `depth` times where there is surface (`voxels.rs`), evenly in places that lie closer where things stand on
//! wide ground (`cube.rs`). In every cell each group of surfaces that
//! face about one way gathers its nearest photons and keeps them as at most eight virtual directional lights
//! (`build.rs`, `cluster.rs`). A look-up blends the eight cells around a point, of each only the group that faces like the
//! surface and whose plane is nearest, renormalised over those that have one [Vivanloc2007]; groups off the surface's plane
//! count less, and next to nothing where a wall keeps their light off (`parting.rs`). Normal maps bend the answer: every light is
//! weighed by its cosine with the shading normal over that with the group's, both softened by how far the light's photons spread
//! (`lights.rs`). A direction can be drawn of the lights there (`drawing.rs`), so
//! that whoever asks can see what lies too near to show in the blur.
//!
//! **Biased**: light is blurred over the gather and over a cell, and what hides a light near by is taken to hide all of it;
//! consistent as photons and depth grow. Shows coarse cells first; after an edit only cells are built again whose photons or
//! surfaces changed or near which something moved, those first of whose photons many did (`reused.rs`), which leaves exactly what a fresh
//! build would.

mod build;
mod cluster;
mod cube;
mod drawing;
mod gathers;
#[cfg(feature = "gpu")]
mod gpu;
mod harmonics;
mod lights;
mod look_up;
mod pack;
mod parting;
mod pieces;
mod reused;
mod tree;
mod upload;
mod voxels;

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::Ordering},
};

use glam::Vec4;

pub(crate) use self::build::OctreeUnderWay;
pub use self::{build::BuildCounts, cluster::Vdl, harmonics::Harmonics, pack::PackedVdl};
#[cfg(feature = "gpu")]
pub use self::{
    gathers::OctreeGather,
    gpu::{AskedGather, GatherOnCard, MapsOnCard},
};

use self::{
    build::Building,
    cluster::Spread,
    lights::{LightBlock, RiseOfSpread, Softness},
    parting::{NearWalls, Parting},
    tree::Nodes,
    voxels::Voxels,
};
use super::{Bias, Card, Counts, Edit, PhotonProduct, Progress, Step, Surfaces, Technique};
use crate::transport::{PathClass, World};

/// What a cell keeps of the light on its surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeafKind {
    /// Virtual directional lights.
    #[default]
    Vdls,
    /// Spherical harmonics of order 2, as many bytes as four and a half lights: smooth in every direction, and blind to
    /// sharp ones [Vivanloc2007, 6].
    Harmonics,
}

/// Parameters of the light octree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OctreeSettings {
    /// Halvings of the cube for the picture that is shown first.
    pub depth_first: u32,
    /// Halvings of the cube in the end, at most [`OctreeSettings::DEPTH_MAX`].
    pub depth: u32,
    /// Radius of a gather in sides of a cell. Smaller shows more detail and more noise.
    pub radius_cells: f32,
    /// Photons of a gather at least, as far as they can be found: where there are fewer within its radius, the radius grows.
    pub neighbours_min: NonZeroUsize,
    /// Photons of a gather at most: the radius shrinks to the nearest of them.
    pub neighbours_max: NonZeroUsize,
    /// Photons of a gather at least where light changes within its radius, which shrinks then.
    pub neighbours_narrow: NonZeroUsize,
    /// What is kept of them.
    pub leaf: LeafKind,
    /// Lights kept of them, at most [`OctreeSettings::VDLS_MAX`].
    pub vdl_count: NonZeroUsize,
    /// Photons that lights send out: says how far a gather may have to look.
    pub photon_count: u32,
}

impl OctreeSettings {
    /// Deepest octree: 1024 cells along a side.
    pub const DEPTH_MAX: u32 = 10;
    /// Pieces of surface in all cells at most, about 100 bytes each: beyond, cells stay larger.
    pub const PIECES_MAX: u32 = 8_000_000;
    /// Most lights of a group.
    pub const VDLS_MAX: usize = 8;
}

/// How many times as far a gather looks as it would find its fewest photons if all lay evenly on all surfaces.
const RADIUS_MAX_EVEN: f32 = 3.0;
const NEIGHBOURS_MIN: NonZeroUsize = NonZeroUsize::new(96).unwrap();
const NEIGHBOURS_MAX: NonZeroUsize = NonZeroUsize::new(400).unwrap();
const NEIGHBOURS_NARROW: NonZeroUsize = NonZeroUsize::new(16).unwrap();
const VDL_COUNT: NonZeroUsize = NonZeroUsize::new(4).unwrap();

impl OctreeSettings {
    /// Cells of a side are as small as the photons allow, where a gather looks `radius_max_m` far at most: at twice the
    /// radius at which the fewest photons lie in even light. Half the cells would show the photons' noise, not more light.
    fn is_enough(&self, cell_m: f32, radius_max_m: f32) -> bool {
        self.radius_cells * cell_m <= radius_max_m / RADIUS_MAX_EVEN * 2.0
    }

    /// Always the nearest `count` photons, however far, as the paper gathers [Vivanloc2007, 3.1.1].
    pub fn gathering(self, count: NonZeroUsize) -> OctreeSettings {
        OctreeSettings {
            radius_cells: f32::INFINITY,
            neighbours_min: count,
            neighbours_max: count,
            neighbours_narrow: count,
            ..self
        }
    }
}

impl Default for OctreeSettings {
    fn default() -> OctreeSettings {
        OctreeSettings {
            depth_first: 4,
            depth: 8,
            radius_cells: 1.25,
            neighbours_min: NEIGHBOURS_MIN,
            neighbours_max: NEIGHBOURS_MAX,
            neighbours_narrow: NEIGHBOURS_NARROW,
            leaf: LeafKind::Vdls,
            vdl_count: VDL_COUNT,
            photon_count: 1_000_000,
        }
    }
}

/// A finished octree; see the module's head.
#[derive(Debug)]
pub struct LightOctree {
    settings: OctreeSettings,
    photons: Arc<PhotonProduct>,
    voxels: Arc<Voxels>,
    /// Where cells are all as large; as many times that as they are larger or smaller.
    radius_max_m: f32,
    /// Over the squared distance from a group's plane at which it counts half, where cells are all as large, 1/m².
    per_sheet_m2: f32,
    nodes: Nodes,
    sets: Vec<LeafSet>,
    /// Of each group.
    gathers: Vec<LeafGather>,
    /// Of each group and class, photons that came or went since and were not looked at, see [`LightOctree::owes`].
    owed: Vec<[u16; 2]>,
    /// Any is owed: whoever asks whether all is known asks that before every pass.
    owes: bool,
    /// Walls around groups, in their order, of those that have any.
    walls: Vec<NearWalls>,
    vdls: Vec<Vdl>,
    /// `vdls` as shading asks for them.
    shaded: Vec<LightBlock>,
    /// By group, then by class; empty unless that is what is kept.
    harmonics: Vec<[Harmonics; 2]>,
    counts: BuildCounts,
    has_caustics: bool,
}

/// The light of the surfaces of a cell that face about one way: a line of the processor's cache, since look-ups go to many at random.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
struct LeafSet {
    /// Its mean plane: unit normal, and how far along it from the origin the plane lies, m.
    sheet: Vec4,
    /// Where the lights of each class start.
    first_vdl: [u32; 2],
    end_vdl: u32,
    /// Where its lights start among those for shading.
    first_block: u32,
    /// By class.
    softness: [Softness; 2],
    /// How far away the photons of indirect light lie, m.
    blur_m: f32,
    /// It is one flat sheet with nothing around it: its light needs no shadows.
    is_alone: bool,
    /// By class.
    spread: [RiseOfSpread; 2],
    /// Keeps it from groups with other light: beyond it counts for next to nothing.
    wall: Parting,
}

const _: () = assert!(size_of::<LeafSet>() == 64);

/// How the light of a group came to be.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LeafGather {
    /// By class: photons of it, as many as can be told.
    found: [u16; 2],
    /// By class: how far away its photons lie, m.
    radius_m: [f32; 2],
    /// By class: nothing farther away had any influence, m.
    reach_m: [f32; 2],
    /// By class.
    chord_rms: [f32; 2],
    /// By class, see [`Spread::rise`].
    rise: [f32; 2],
    /// Place of the walls around it in [`LightOctree::walls`].
    walls: Option<u32>,
}

/// Distance from a group's mean plane at which it counts half, in sides of a cell: farther off it is another sheet.
const SHEET_CELLS: f32 = 0.25;
impl LightOctree {
    /// Halvings of the cube.
    pub fn depth(&self) -> u32 {
        self.voxels.cube.depth
    }

    /// Photons of its gathers, at least; see [`OctreeSettings::neighbours_min`].
    pub(crate) fn neighbours_min(&self) -> usize {
        self.settings.neighbours_min.get()
    }

    /// Cells that hold surface.
    pub fn leaf_count(&self) -> usize {
        self.voxels.codes.len()
    }

    /// Smaller cells would gather no fewer photons than these: they would show the same light in more places.
    pub(crate) fn shows_all_its_photons_can(&self) -> bool {
        self.settings.is_enough(self.voxels.cube.cell_m(), self.radius_max_m)
    }

    /// It holds groups whose photons are not all of now: of those few came or went, and what gets much other light after an edit is shown first.
    pub(crate) fn owes(&self) -> bool {
        self.owes
    }

    /// Lights in all cells.
    pub fn vdl_count(&self) -> usize {
        self.vdls.len()
    }

    /// Memory of nodes, cells, pieces of surface and lights.
    pub fn bytes(&self) -> usize {
        self.nodes.bytes()
            + self.sets.len() * (size_of::<LeafSet>() + size_of::<LeafGather>() + size_of::<[u16; 2]>())
            + self.walls.len() * size_of::<NearWalls>()
            + self.vdls.len() * size_of::<Vdl>()
            + self.shaded.len() * size_of::<LightBlock>()
            + self.harmonics.len() * size_of::<[Harmonics; 2]>()
            + self.voxels.bytes()
    }

    /// True when both hold the same cells with the same light, to the last bit.
    pub fn holds_the_same(&self, other: &LightOctree) -> bool {
        self.voxels.cube == other.voxels.cube
            && self.nodes == other.nodes
            && self.voxels.codes == other.voxels.codes
            && self.voxels.first_set == other.voxels.first_set
            && self.sets == other.sets
            && self.gathers == other.gathers
            && self.owed == other.owed
            && self.walls == other.walls
            && self.vdls == other.vdls
            && self.harmonics == other.harmonics
    }

    /// What building it took.
    pub fn counts(&self) -> BuildCounts {
        self.counts
    }

    /// Angle between photons and the direction of their light, degrees: root mean square over groups that have any.
    pub fn spread_degrees(&self) -> f32 {
        let lit = self.sets.iter().zip(&self.gathers).filter(|(set, _)| set.first_vdl[1] > set.first_vdl[0]);
        let (count, sum) = lit.fold((0u32, 0.0f64), |(count, sum), (_, gather)| {
            (count + 1, sum + f64::from(gather.chord_rms[0]).powi(2))
        });
        let chord_rms = (sum / f64::from(count.max(1))).sqrt() as f32;
        Spread { chord_rms, ..Spread::default() }.degrees()
    }

    fn vdls_of(&self, set: &LeafSet, class: usize) -> &[Vdl] {
        let end = if class == 0 { set.first_vdl[1] } else { set.end_vdl };
        &self.vdls[set.first_vdl[class] as usize..end as usize]
    }
}

/// Pieces that the surfaces of a scene are about cut into at a depth: a square cell's worth of wall reaches into two.
fn pieces_at(world: &World, surfaces: &Surfaces, depth: u32) -> f64 {
    let Some(cube) = cube::Cube::around(world, depth) else { return 0.0 };
    let accel = world.accel();
    let of_instance = |index: usize| {
        let end = if index + 1 < accel.instances().len() {
            surfaces.first_surface(index as u32 + 1)
        } else {
            surfaces.count()
        };
        let of_these = surfaces.first_surface(index as u32)..end;
        let area_m2 = of_these.map(|surface| f64::from(surfaces.area_m2(surface))).sum::<f64>();
        let bounds = accel.instances()[index].bounds_in_world();
        cube.area_in_cells(area_m2, [bounds.min, bounds.max].map(|corner| accel.to_render(corner)))
    };
    let cells = match cube.nested {
        None => {
            let area_m2 =
                (0..surfaces.count()).map(|surface| f64::from(surfaces.area_m2(surface))).sum::<f64>();
            area_m2 / f64::from(cube.cell_m()).powi(2)
        }
        Some(_) => (0..accel.instances().len()).map(of_instance).sum(),
    };
    let triangles = world.scene().instanced_triangle_count() as f64;
    2.0 * cells + triangles
}

/// Building the octree on the CPU, on the rayon pool it is called in.
#[derive(Debug)]
pub struct OctreeBuilding {
    settings: OctreeSettings,
    building: Option<Building>,
    /// The newest octree and what it was built of.
    octree: Option<Arc<LightOctree>>,
    /// Photons of a scene without surface, which has no octree.
    nothing_of: Option<u64>,
    /// Deeper ones would hold more pieces of surface than [`OctreeSettings::PIECES_MAX`], or show nothing more.
    is_deepest: bool,
}

static CARD: Card =
    Card { name: "octree", classes: &[PathClass::Indirect, PathClass::Caustic], bias: Bias::Biased };

impl OctreeBuilding {
    /// Nothing built yet.
    pub fn new(settings: OctreeSettings) -> OctreeBuilding {
        let depth = settings.depth.clamp(1, OctreeSettings::DEPTH_MAX);
        let depth_first = settings.depth_first.clamp(1, depth);
        // What a gather finds must not depend on photons beyond its radius.
        let neighbours_max = settings.neighbours_max.max(settings.neighbours_min);
        let vdl_count =
            settings.vdl_count.min(NonZeroUsize::new(OctreeSettings::VDLS_MAX).unwrap_or(NonZeroUsize::MIN));
        OctreeBuilding {
            settings: OctreeSettings { depth, depth_first, vdl_count, neighbours_max, ..settings },
            building: None,
            octree: None,
            nothing_of: None,
            is_deepest: false,
        }
    }

    /// The newest octree.
    pub fn octree(&self) -> Option<&Arc<LightOctree>> {
        self.octree.as_ref()
    }

    /// Photons of its gathers, at least; see [`OctreeSettings::neighbours_min`].
    pub(crate) fn neighbours_min(&self) -> usize {
        self.settings.neighbours_min.get()
    }

    /// The next one, if it is begun of these photons.
    pub(crate) fn under_way(&self, photons: &PhotonProduct) -> Option<OctreeUnderWay> {
        self.building.as_ref().filter(|building| building.is_of(photons)).map(Building::under_way)
    }

    /// True when the newest octree is of these photons and as deep as it gets.
    pub fn is_complete(&self, photons: &PhotonProduct) -> bool {
        let is_done = |octree: &Arc<LightOctree>| {
            !octree.owes()
                && (octree.depth() >= self.settings.depth
                    || self.is_deepest
                    || octree.shows_all_its_photons_can())
        };
        self.nothing_of == Some(photons.generation)
            || self
                .octree
                .as_ref()
                .filter(|o| o.photons.generation == photons.generation)
                .is_some_and(is_done)
    }

    /// Begins what is to be built next; `None` for a scene without surface, or when deeper would be too large or show nothing more.
    fn begin(&mut self, world: &World, photons: &Arc<PhotonProduct>) -> Option<Building> {
        let settings = self.settings;
        let mut depth = self.depth_next(photons);
        let fits =
            |depth| pieces_at(world, photons.maps.surfaces(), depth) <= OctreeSettings::PIECES_MAX as f64;
        let is_of_these = |octree: &Arc<LightOctree>| octree.photons.generation == photons.generation;
        let is_deepening = self.octree.as_ref().is_some_and(|octree| is_of_these(octree) && !octree.owes());
        self.is_deepest = is_deepening && !fits(depth);
        if self.is_deepest {
            return None;
        }
        while depth > 1 && !fits(depth) {
            depth -= 1;
        }
        let building = Building::begin(world, photons, settings, depth, self.octree.as_ref())?;
        if depth > settings.depth_first && building.is_deeper_than_needed() {
            if is_deepening {
                // By the area that lies in cells, which is not known to the last bit, and where cells differ not nearly: the one that is there
                // seems to show less than its photons can, and the next more. To begin again would find the same, for ever.
                self.is_deepest = true;
                return None;
            }
            // An edit made the scene larger or took photons away: from the start, as for a fresh one.
            return Building::begin(world, photons, settings, settings.depth_first, None);
        }
        Some(building)
    }

    /// The depth to be built next: coarse first, then level by level. After an edit at once as deep as before, if it is
    /// known what changed, and again for what is [owed](LightOctree::owes); else coarse again.
    fn depth_next(&self, photons: &PhotonProduct) -> u32 {
        match &self.octree {
            Some(octree) if octree.photons.generation == photons.generation => {
                octree.depth() + u32::from(!octree.owes())
            }
            Some(octree)
                if octree.photons.generation + 1 == photons.generation && photons.changed.is_some() =>
            {
                octree.depth()
            }
            _ => self.settings.depth_first,
        }
    }
}

impl Technique for OctreeBuilding {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        let done = Progress { complete: true, ..Progress::default() };
        let Some(photons) = step.products.photons.clone() else { return done };
        if self.is_complete(&photons) {
            return done;
        }
        if step.cancel.load(Ordering::Relaxed) {
            return Progress::default();
        }
        let building = match self.building.take().filter(|building| building.is_of(&photons)) {
            Some(building) => Some(building),
            None => self.begin(step.world, &photons),
        };
        let Some(mut building) = building else {
            if !self.is_deepest {
                // A scene without surface.
                self.nothing_of = Some(photons.generation);
                self.octree = None;
                step.products.secondary = None;
            }
            return done;
        };
        if !building.advance(step.world) {
            self.building = Some(building);
            return Progress { counts: Counts::default(), complete: false };
        }
        let octree = Arc::new(building.finish(step.world));
        self.octree = Some(octree.clone());
        step.products.secondary = Some(octree);
        Progress { counts: Counts::default(), complete: self.is_complete(&photons) }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // What is out of date shows in the photons that come next.
    }
}
