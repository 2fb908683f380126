//! Lights and their tree packed for the GPU.

use std::sync::Arc;

use bytemuck::Zeroable;

use super::{EmissiveRun, EnvironmentLight, Lights, LocalLight};
use crate::{
    math::Rgb,
    scene::Texture,
    transport::upload::{GpuLight, GpuLightNode, GpuSceneHeader, PlacedTextures, kind_flag},
};

/// What [`Lights::upload`] packs beside the tables.
pub(in crate::transport) struct PackedLights {
    pub(in crate::transport) header: GpuSceneHeader,
    pub(in crate::transport) lights: Vec<GpuLight>,
    pub(in crate::transport) light_nodes: Vec<GpuLightNode>,
}

impl Lights {
    /// First triangle, triangles, first light and level of the cut of each run of an instance's triangles that emit.
    pub(in crate::transport) fn emissive_runs(&self, instance: usize) -> Vec<[u32; 4]> {
        let runs = self.runs.get(instance).map_or(&[][..], Vec::as_slice);
        let words =
            |run: &EmissiveRun| [run.first_triangle, run.triangle_count, run.first_light, run.cut.level];
        runs.iter().map(words).collect()
    }

    /// The same triangles of an instance emit, and are the same lights by number.
    pub(in crate::transport) fn emits_like(&self, other: &Lights, instance: usize) -> bool {
        self.emissive_runs(instance) == other.emissive_runs(instance)
    }

    /// Of an environment that is a picture.
    pub(in crate::transport) fn environment_texture(&self) -> Option<&Arc<Texture>> {
        match &self.environment {
            Some(EnvironmentLight::Image(image)) => Some(&image.texture),
            _ => None,
        }
    }

    /// Lights and their tree; ways to the lights and sums of the environment go to the end of `tables`.
    pub(in crate::transport) fn upload(
        &self,
        tables: &mut Vec<u32>,
        textures: &PlacedTextures,
    ) -> PackedLights {
        let mut header = GpuSceneHeader {
            directional_count: self.directional.len() as u32,
            light_node_count: self.tree.nodes.len() as u32,
            trails_at: tables.len() as u32,
            directional_at: self.local.len() as u32,
            ..GpuSceneHeader::zeroed()
        };
        tables.extend(self.tree.trails.iter().flat_map(|trail| [*trail as u32, (*trail >> 32) as u32]));
        header.environment_sums_at = tables.len() as u32;
        match &self.environment {
            None => {}
            Some(EnvironmentLight::Constant(radiance)) => {
                header.environment_kind = 1;
                header.environment_radiance = radiance.to_array();
            }
            Some(EnvironmentLight::Image(image)) => {
                header.environment_kind = 2;
                header.environment_radiance = image.scale.to_array();
                header.environment_rotation_rad = image.rotation_rad;
                header.environment_at = textures.place(&image.texture);
                header.environment_width = image.texture.width;
                header.environment_height = image.texture.height;
                header.environment_flags = kind_flag(&image.texture);
                tables.extend(image.rows.iter().chain(&image.columns).map(|sum| sum.to_bits()));
            }
        }
        let directional = self.directional.iter().map(|light| GpuLight {
            position: light.direction.into(),
            kind: GpuLight::DIRECTIONAL,
            intensity: light.irradiance.to_array(),
            ..GpuLight::zeroed()
        });
        let light_nodes = self.tree.nodes.iter().map(|node| {
            let two_sided = if node.bounds.two_sided { 2 } else { 0 };
            GpuLightNode {
                low: node.bounds.min.into(),
                next: node.next,
                high: node.bounds.max.into(),
                flags: u32::from(node.is_leaf) | two_sided,
                axis: node.bounds.axis.into(),
                // Sums may leave the range, and WGSL may assume that no number is infinite.
                intensity: node.bounds.intensity.min(f32::MAX),
                cos_normals: node.bounds.cos_normals,
                cos_emission: node.bounds.cos_emission,
                end: node.end,
                padding: 0,
            }
        });
        PackedLights {
            header,
            lights: self.local.iter().map(packed).chain(directional).collect(),
            light_nodes: light_nodes.collect(),
        }
    }
}

fn packed(light: &LocalLight) -> GpuLight {
    let standing = |kind: u32, position: glam::Vec3, intensity: Rgb| GpuLight {
        position: position.into(),
        kind,
        intensity: intensity.to_array(),
        ..GpuLight::zeroed()
    };
    match light {
        LocalLight::Triangle { instance, triangle, part, area_m2, two_sided, .. } => GpuLight {
            position: [part.corner[0], part.corner[1], part.scale],
            instance: *instance,
            triangle: *triangle,
            area_m2: *area_m2,
            is_two_sided: u32::from(*two_sided),
            ..GpuLight::zeroed()
        },
        LocalLight::Point { position, intensity } => standing(GpuLight::POINT, *position, *intensity),
        LocalLight::Spot { position, axis, intensity, cos_inner, cos_outer } => GpuLight {
            axis: (*axis).into(),
            cos_inner: *cos_inner,
            cos_outer: *cos_outer,
            ..standing(GpuLight::SPOT, *position, *intensity)
        },
    }
}
