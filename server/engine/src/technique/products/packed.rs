//! What is known of a scene's light, packed for look-ups on a graphics card: plain data in the order in which
//! the folders `octree`, `irradiance` and `caustics` of the shaders read it.

use bytemuck::{Pod, Zeroable};

use crate::{math::Rgb, technique::View};

/// Cosine of the angle between a surface and a group from which on they are lit alike.
pub const LIKE_COS: f32 = 0.3;

/// `OctreeHeader` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuOctreeHeader {
    /// Low corner of the cube, render space.
    pub low: [f32; 3],
    /// Side of a cell where all are as large, m.
    pub cell_m: f32,
    /// Cells along a side of the cube.
    pub cells: u32,
    /// Halvings; 0: nothing is known.
    pub depth: u32,
    /// Over the squared distance from a group's plane at which it counts half, where cells are all as large, 1/m².
    pub per_sheet_m2: f32,
    /// First word of the cells' first groups, behind the nodes.
    pub first_sets_at: u32,
    /// How far indirect light is blurred where nothing is known and cells are all as large, m.
    pub blur_max_m: f32,
    /// What lies nearer than so many blurs is lost in them, but no farther than `lost_max_m`.
    pub lost_blurs: f32,
    /// See there; where cells are all as large, m.
    pub lost_max_m: f32,
    /// Share of a group beyond its wall.
    pub behind_share: f32,
    /// Share of a group within a wall.
    pub within_share: f32,
    /// 1: cells are smaller in `inner`.
    pub is_nested: u32,
    /// Nothing.
    pub padding_0: u32,
    /// Nothing.
    pub padding_1: u32,
    /// Cubes within the cube: low corner, side, m.
    pub inner: [[f32; 4]; 3],
}

/// The light of the surfaces of a cell that face about one way; `LightSet` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLightSet {
    /// Mean normal.
    pub normal: [f32; 3],
    /// Distance of the mean plane from the origin along it, m.
    pub plane_m: f32,
    /// First light of indirect light.
    pub first_vdl: u32,
    /// First light of caustics, where those of indirect light end.
    pub first_caustic_vdl: u32,
    /// Where those end.
    pub end_vdl: u32,
    /// How gently the lights' cosine ends below the horizon.
    pub reach: f32,
    /// The same of caustics.
    pub caustic_reach: f32,
    /// How far indirect light is blurred, m.
    pub blur_m: f32,
    /// How widely photons of indirect light lie around their lights, of even light.
    pub evenness: f32,
    /// Bit 0: nothing stands near that could hide its light. The second and third byte: what a coat reflects by the spread of photons
    /// around their lights, of indirect light and of caustics, in 255ths.
    pub flags: u32,
    /// A plane, beyond which it counts for next to nothing: direction, distance of the plane from the origin along it, m.
    pub wall: [f32; 4],
}

/// Light in cells, ready to be copied into buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedLight {
    /// What says how the rest is read.
    pub header: GpuOctreeHeader,
    /// Eight words a node, then `[cells + 1]` the first group of each cell.
    pub words: Vec<u32>,
    /// Groups of surfaces.
    pub sets: Vec<GpuLightSet>,
    /// A light in two words: direction; what it brings over its softened cosine with its group. Off by 0.4 % of the largest
    /// channel and 0.0037° at most.
    pub vdls: Vec<[u32; 2]>,
}

/// A record of irradiance; `Record` in WGSL. Open ways and rises of its horizon lie where vectors leave room.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuRecord {
    /// Render space.
    pub position: [f32; 3],
    /// It does not count beyond, m.
    pub reach_m: f32,
    /// The side that receives.
    pub normal: [f32; 3],
    /// How much of a way its gradients count for.
    pub way_share: f32,
    /// Normal of the triangle on that side.
    pub n_geo: [f32; 3],
    /// Nothing nearer is hidden from it, m.
    pub nearest_m: f32,
    /// W/m².
    pub irradiance: [f32; 3],
    /// Mean of Schlick's (1 − cos)⁵ over it.
    pub coat_rise: f32,
    /// Change with turning, W/m².
    pub turning_red: [f32; 3],
    /// Open ways in four directions each.
    pub ways_0: u32,
    /// See there.
    pub turning_green: [f32; 3],
    /// See there.
    pub ways_1: u32,
    /// See there.
    pub turning_blue: [f32; 3],
    /// See there.
    pub ways_2: u32,
    /// Change with moving, W/m³.
    pub moving_red: [f32; 3],
    /// Rises in four directions each.
    pub rises_0: u32,
    /// See there.
    pub moving_green: [f32; 3],
    /// See there.
    pub rises_1: u32,
    /// See there.
    pub moving_blue: [f32; 3],
    /// See there.
    pub rises_2: u32,
}

/// Records of irradiance, ready to be copied into buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedRecords {
    /// Of the finest cache, then of rougher ones.
    pub records: Vec<GpuRecord>,
    /// How many of each cache.
    pub counts: Vec<u32>,
    /// How many caches there are; what answers after them; what says where the records of each cache are, and those words.
    pub words: Vec<u32>,
}

/// A photon of light that only mirrors and glass sent on, where it fell; `Photon` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuPhoton {
    /// Render space.
    pub position: [f32; 3],
    /// Square of how far it is blurred, m².
    pub r2: f32,
    /// W.
    pub flux_w: [f32; 3],
    /// Before it fell there.
    pub scatterings: u32,
    /// Where it came from.
    pub direction: [f32; 3],
    /// Nothing.
    pub padding_0: u32,
    /// Of the surface on the side it fell on.
    pub normal: [f32; 3],
    /// Nothing.
    pub padding_1: u32,
}

/// Focused light of one pass, ready to be copied into buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedPhotons {
    /// Grid by grid.
    pub photons: Vec<GpuPhoton>,
    /// How many grids there are, what each is, and what their cells name.
    pub words: Vec<u32>,
}

/// Light that mirrors and glass focus, ready for a card.
#[derive(Clone, Debug, PartialEq)]
pub enum PackedFocused {
    /// Of one pass, in grids over the scene.
    Grids(PackedPhotons),
    /// Photons that the card is to count in the pixels of a picture.
    Sketch(Box<PackedSketch>),
}

/// How many widths of windows a [`PackedSketch`] has.
pub const SKETCH_WIDTHS: usize = 5;
/// [`PackedSketch::is_fit`] says this of photons that show nowhere.
pub const SHOWN_NOWHERE: u32 = u32::MAX;

/// Photons of a scene's caustics, and how a camera is to see them.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedSketch {
    /// In their order, without blurs.
    pub photons: Vec<GpuPhoton>,
    /// Who sees them.
    pub view: View,
    /// The narrowest first.
    pub windows: [SketchWindows; SKETCH_WIDTHS],
    /// Share of the flux in windows that hold few photons, from which on they say too little.
    pub sparse_share: f32,
}

/// Windows of one width.
#[derive(Clone, Debug, PartialEq)]
pub struct SketchWindows {
    /// Pixels on each side of the middle one.
    pub half_px: u32,
    /// Binary logarithm of the width of the cells that photons are kept in, px.
    pub cell_log2: u32,
    /// What a photon counts in pixels so many rows and columns away, `[half + 1, half + 1]`, relative to the mean over its window.
    pub weights: Vec<f32>,
}

impl PackedSketch {
    /// Whether photons on the screen are a fit estimate.
    ///
    /// - `chosen`: by photon, the place of its window among the widths; [`SKETCH_WIDTHS`] where even the widest holds few others,
    ///   [`SHOWN_NOWHERE`] where it shows neither in the picture nor near it
    pub fn is_fit(&self, chosen: &[u32]) -> bool {
        let (mut flux_w, mut sparse_w) = (0.0, 0.0);
        for (photon, width) in self.photons.iter().zip(chosen).filter(|(_, width)| **width != SHOWN_NOWHERE) {
            let luminance_w = Rgb::from(photon.flux_w).luminance();
            flux_w += luminance_w;
            sparse_w += if *width as usize >= SKETCH_WIDTHS { luminance_w } else { 0.0 };
        }
        !(sparse_w > self.sparse_share * flux_w)
    }
}
