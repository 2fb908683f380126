//! The photon maps of one class of light, packed for gathers on a graphics card: a tree of boxes over the photons of every side, and the
//! trees of the surfaces that they lie on.
//!
//! Maps keep their photons along a curve through space, so that neighbours in a map are neighbours in space: a tree whose leaves are some of
//! them one after the other needs no sorting, and a walk through it meets photons in the order of the map, which is the order that ties are
//! settled by.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::{
    extent::PackedExtents,
    map::{MapPhoton, PhotonMaps, SideMap},
};
use crate::math::octahedral;

/// Photons of a leaf at most: what four bits count.
const LEAF_COUNT: usize = 8;
const _: () = assert!(LEAF_COUNT < 16);

/// Photons that follow each other in a map; those behind it in depth-first order, up to `end`, are its parts. `PhotonNode` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct GpuPhotonNode {
    pub(crate) low: [f32; 3],
    /// Where those behind that are no parts of it begin.
    pub(crate) end: u32,
    pub(crate) high: [f32; 3],
    /// Its first photon, sixteen times, and how many; none of what has parts.
    pub(crate) photons: u32,
}

/// Where a photon lies; `MapPhoton` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct GpuMapPhoton {
    pub(crate) position: [f32; 3],
    /// Its place in its map.
    pub(crate) item: u32,
    /// Of the surface on the side it fell on, unit.
    pub(crate) normal: [f32; 3],
    pub(crate) padding: u32,
}

/// Maps and surfaces; see the module's head.
#[derive(Debug, Default)]
pub(crate) struct PackedMaps {
    /// `[side]`: its first node, and the one behind its last.
    pub(crate) roots: Vec<[u32; 2]>,
    pub(crate) nodes: Vec<GpuPhotonNode>,
    pub(crate) photons: Vec<GpuMapPhoton>,
    pub(crate) extents: PackedExtents,
}

impl PhotonMaps {
    /// - `class`: as in [`super::MAPPED`]
    pub(in crate::technique) fn packed(&self, class: usize) -> PackedMaps {
        let mut packed = PackedMaps { extents: self.surfaces.packed(), ..PackedMaps::default() };
        for map in &self.sides[class] {
            packed.add(map.as_deref());
        }
        packed
    }
}

impl PackedMaps {
    fn add(&mut self, map: Option<&SideMap>) {
        let first = self.nodes.len() as u32;
        let first_photon = self.photons.len();
        let photons = (0..).zip(map.map_or(&[][..], |map| &map.photons));
        // What lies nowhere is near nothing.
        let sound = photons.filter(|(_, photon)| photon.position.is_finite());
        self.photons.extend(sound.map(|(item, photon)| GpuMapPhoton::of(item, photon)));
        if self.photons.len() > first_photon {
            self.divide(first_photon, self.photons.len());
        }
        self.roots.push([first, self.nodes.len() as u32]);
    }

    /// Adds the node of some photons and all its parts.
    fn divide(&mut self, first: usize, end: usize) {
        let place = self.nodes.len();
        let around = self.photons[first..end].iter().map(|photon| Vec3::from(photon.position));
        let [low, high] = around
            .fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)])
            .map(|corner| corner.to_array());
        let is_leaf = end - first <= LEAF_COUNT;
        let photons = if is_leaf { (first as u32) << 4 | (end - first) as u32 } else { 0 };
        self.nodes.push(GpuPhotonNode { low, end: 0, high, photons });
        if !is_leaf {
            let half = first + (end - first) / 2;
            self.divide(first, half);
            self.divide(half, end);
        }
        self.nodes[place].end = self.nodes.len() as u32;
    }
}

impl GpuMapPhoton {
    fn of(item: u32, photon: &MapPhoton) -> GpuMapPhoton {
        let normal = octahedral::decode(photon.normal).to_array();
        GpuMapPhoton { position: photon.position.to_array(), item, normal, padding: 0 }
    }
}
