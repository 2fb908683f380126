//! The octree packed for the GPU.

use super::{
    LightOctree, PackedVdl, Vdl,
    cube::INNER,
    look_up::LOST_BLURS,
    parting::{BEHIND_SHARE, WITHIN_SHARE},
};
use crate::technique::{GpuLightSet, GpuOctreeHeader, PackedLight};

impl LightOctree {
    /// The octree as look-ups on a graphics card read it; `None` of one that keeps harmonics.
    pub(super) fn packed_light(&self) -> Option<PackedLight> {
        if !self.harmonics.is_empty() {
            return None;
        }
        let cube = &self.voxels.cube;
        let inner = cube.nested.as_ref().map(|nested| nested.inner);
        let mut words: Vec<u32> = self.nodes.children.as_flattened().to_vec();
        let first_sets_at = words.len() as u32;
        words.extend(&self.voxels.first_set);
        let sets = self.sets.iter().enumerate().map(|(place, set)| GpuLightSet {
            normal: set.sheet.truncate().into(),
            plane_m: set.sheet.w,
            first_vdl: set.first_vdl[0],
            first_caustic_vdl: set.first_vdl[1],
            end_vdl: set.end_vdl,
            reach: set.softness[0].reach,
            caustic_reach: set.softness[1].reach,
            blur_m: set.blur_m,
            evenness: self.evenness_of(place),
            flags: u32::from_le_bytes([u8::from(set.is_alone), set.spread[0].0, set.spread[1].0, 0]),
            wall: set.wall.0.into(),
        });
        let places = (0..self.sets.len()).flat_map(|set| [(set, 0), (set, 1)]);
        let lights = places.flat_map(|(set, class)| self.lights_of(set, class).iter());
        let packed = lights.map(|vdl| {
            let packed = PackedVdl::pack(&Vdl { direction: vdl.direction, irradiance: vdl.scaled });
            [packed.direction, packed.irradiance]
        });
        Some(PackedLight {
            header: GpuOctreeHeader {
                low: cube.low.into(),
                cell_m: cube.cell_m(),
                cells: cube.cells(),
                depth: if self.nodes.children.is_empty() { 0 } else { cube.depth },
                per_sheet_m2: self.per_sheet_m2,
                first_sets_at,
                blur_max_m: self.radius_max_m,
                lost_blurs: LOST_BLURS,
                lost_max_m: self.lost_max_m(),
                behind_share: BEHIND_SHARE,
                within_share: WITHIN_SHARE,
                is_nested: u32::from(inner.is_some()),
                padding_0: 0,
                padding_1: 0,
                inner: inner
                    .map_or([[0.0; 4]; INNER], |cubes| cubes.map(|(low, side_m)| low.extend(side_m).into())),
            },
            words,
            sets: sets.collect(),
            vdls: packed.collect(),
        })
    }
}
