//! The scene packed for the GPU beside its [trees](crate::accel::AccelBuffers): plain data in the order in which
//! `shaders/transport` reads it.
//!
//! Knows no graphics interface. Every number is what the CPU works with, so that both draw the same surfaces: normals of
//! triangles are those that were found in double precision, bytes are decoded by the same table, lights lie in the same tree.

mod appearance;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::World;
use crate::{
    accel::Instance,
    scene::{Id, Mesh},
};

pub use appearance::{AppearanceBuffers, TEXTURE_FLAGS, WorldFeatures};
pub(in crate::transport) use appearance::{PlacedTextures, kind_flag};

/// [`GpuPlacement`]'s `…_at`: the mesh has none.
pub(in crate::transport) const ABSENT: u32 = u32::MAX;

/// What the steps must know to read the rest; `SceneHeader` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuSceneHeader {
    /// Directional lights.
    pub directional_count: u32,
    /// 0 none, 1 the same from everywhere, 2 a picture.
    pub environment_kind: u32,
    /// Nodes of the lights' tree; 0: no light stands anywhere.
    pub light_node_count: u32,
    /// First word in `tables` of the ways to the lights.
    pub trails_at: u32,
    /// The environment's radiance or its picture's factor, W/(m² sr).
    pub environment_radiance: [f32; 3],
    /// Turn of its picture.
    pub environment_rotation_rad: f32,
    /// Its first texel, in words.
    pub environment_at: u32,
    /// Columns of its picture.
    pub environment_width: u32,
    /// Rows.
    pub environment_height: u32,
    /// First word in `tables` of its running sums.
    pub environment_sums_at: u32,
    /// The first directional light.
    pub directional_at: u32,
    /// As [`GpuTextureUse::flags`].
    pub environment_flags: u32,
    /// Nothing.
    pub padding_0: u32,
    /// Nothing.
    pub padding_1: u32,
}

/// A mesh where it stands; `Placement` in WGSL. `…_at`: words of `geometry`, `u32::MAX` where the mesh has none.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuPlacement {
    /// First column of render from mesh.
    pub render_from_mesh_x: [f32; 3],
    /// Normals of vertices.
    pub normals_at: u32,
    /// Second column.
    pub render_from_mesh_y: [f32; 3],
    /// Tangents with handedness.
    pub tangents_at: u32,
    /// Third column.
    pub render_from_mesh_z: [f32; 3],
    /// First set of texture coordinates.
    pub texcoords_0_at: u32,
    /// First column of what turns normals.
    pub normal_from_mesh_x: [f32; 3],
    /// Second set of texture coordinates.
    pub texcoords_1_at: u32,
    /// Second column.
    pub normal_from_mesh_y: [f32; 3],
    /// Colours of vertices.
    pub colors_at: u32,
    /// Third column.
    pub normal_from_mesh_z: [f32; 3],
    /// Three vertices a triangle.
    pub corners_at: u32,
    /// The mesh's centre, which positions count from.
    pub centre_in_render: [f32; 3],
    /// Positions.
    pub positions_at: u32,
    /// Normals of triangles.
    pub faces_at: u32,
    /// First triangle and material of each primitive.
    pub primitives_at: u32,
    /// How many.
    pub primitive_count: u32,
    /// 1: only moved; 2: mirrored.
    pub flags: u32,
    /// First triangle, triangles and first light of each run of triangles that emit.
    pub runs_at: u32,
    /// How many.
    pub run_count: u32,
    /// Nothing.
    pub padding_0: u32,
    /// Nothing.
    pub padding_1: u32,
}

/// A material's use of a texture; `TextureUse` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTextureUse {
    /// First column of the picture's coordinates from the mesh's.
    pub uv_x: [f32; 2],
    /// Second column.
    pub uv_y: [f32; 2],
    /// Offset.
    pub uv_offset: [f32; 2],
    /// First texel, in words of `texels`.
    pub texels_at: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// See [`TEXTURE_FLAGS`].
    pub flags: u32,
    /// Nothing.
    pub padding_0: u32,
    /// Nothing.
    pub padding_1: u32,
}

/// A material; `Material` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuMaterial {
    /// See [`crate::scene::Material`], as all that follows.
    pub base_color: [f32; 3],
    /// Opacity.
    pub alpha: f32,
    /// W/(m² sr).
    pub emission: [f32; 3],
    /// −1: no mask.
    pub alpha_cutoff: f32,
    /// Colour of the dielectric's gloss.
    pub specular_color: [f32; 3],
    /// Strength of it.
    pub specular: f32,
    /// Colour after the distance.
    pub attenuation_color: [f32; 3],
    /// 0: clear.
    pub attenuation_distance_m: f32,
    /// Metallic.
    pub metallic: f32,
    /// Roughness.
    pub roughness: f32,
    /// Index of refraction.
    pub ior: f32,
    /// Transmission.
    pub transmission: f32,
    /// Scale of the normal map.
    pub normal_scale: f32,
    /// 1: emits from both sides; 2: unlit.
    pub flags: u32,
    /// Nothing.
    pub padding_0: u32,
    /// Nothing.
    pub padding_1: u32,
    /// By slot.
    pub textures: [GpuTextureUse; 7],
}

/// A light; `Light` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLight {
    /// Where; the way the light goes of a directional one; of a triangle the corner and the scale of the part that this is of it.
    pub position: [f32; 3],
    /// [`GpuLight::TRIANGLE`] and those beside it.
    pub kind: u32,
    /// W/sr; W/m² of a directional one.
    pub intensity: [f32; 3],
    /// Of a triangle.
    pub instance: u32,
    /// Of a spot.
    pub axis: [f32; 3],
    /// The triangle.
    pub triangle: u32,
    /// Cosine of a spot's inner angle.
    pub cos_inner: f32,
    /// Of its outer one.
    pub cos_outer: f32,
    /// Of a triangle's part, m².
    pub area_m2: f32,
    /// 1: a triangle that shines from both sides.
    pub is_two_sided: u32,
}

/// Kinds, as WGSL numbers them.
impl GpuLight {
    /// A triangle that emits.
    pub const TRIANGLE: u32 = 0;
    /// Shines all around from one point.
    pub const POINT: u32 = 1;
    /// Shines into a cone.
    pub const SPOT: u32 = 2;
    /// Infinitely far.
    pub const DIRECTIONAL: u32 = 3;
}

/// A node of the lights' tree; `LightNode` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLightNode {
    /// Low corner of the lights' bounds, render space.
    pub low: [f32; 3],
    /// The second child, or a leaf's light.
    pub next: u32,
    /// High corner.
    pub high: [f32; 3],
    /// 1: leaf; 2: shines from both sides.
    pub flags: u32,
    /// Axis of the cone of emission.
    pub axis: [f32; 3],
    /// Largest radiant intensity as a luminance, W/sr.
    pub intensity: f32,
    /// Cosine of the cone's half angle.
    pub cos_normals: f32,
    /// Cosine of the angle beyond an axis at which emission ends.
    pub cos_emission: f32,
    /// One past the last node below this one.
    pub end: u32,
    /// Nothing.
    pub padding: u32,
}

/// A scene's surfaces and lights, ready to be copied into buffers.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldBuffers {
    /// What surfaces look like, and lights.
    pub appearance: AppearanceBuffers,
    /// By the index that a hit carries.
    pub placements: Vec<GpuPlacement>,
    /// Words of vertices and triangles.
    pub geometry: Vec<u32>,
    /// Words of texels: one, or four floats.
    pub texels: Vec<u32>,
}

impl WorldBuffers {
    /// Bytes to upload.
    pub fn bytes(&self) -> usize {
        self.appearance.bytes()
            + size_of_val(&*self.placements)
            + size_of_val(&*self.geometry)
            + size_of_val(&*self.texels)
    }
}

/// Where a mesh's parts lie in `geometry`.
#[derive(Clone, Copy)]
struct MeshPlaces {
    normals_at: u32,
    tangents_at: u32,
    texcoords_at: [u32; 2],
    colors_at: u32,
    corners_at: u32,
    positions_at: u32,
    faces_at: u32,
}

/// Words in the making.
#[derive(Default)]
struct Words(Vec<u32>);

impl Words {
    /// Appends `numbers` and says where they begin; [`ABSENT`] for none.
    fn append<T: Pod>(&mut self, numbers: &[T]) -> u32 {
        if numbers.is_empty() {
            return ABSENT;
        }
        let at = self.0.len() as u32;
        self.0.extend_from_slice(bytemuck::cast_slice(numbers));
        at
    }

    fn append_mesh(&mut self, instance: &Instance) -> MeshPlaces {
        let mesh: &Mesh = instance.mesh();
        let faces: Vec<Vec3> = (0..mesh.triangles().len() as u32).map(|t| instance.face_normal(t)).collect();
        MeshPlaces {
            normals_at: self.append(mesh.normals()),
            tangents_at: self.append(mesh.tangents()),
            texcoords_at: [0, 1].map(|set| self.append(mesh.texcoords(set))),
            colors_at: self.append(mesh.colors()),
            corners_at: self.append(mesh.triangles()),
            positions_at: self.append(mesh.positions()),
            faces_at: self.append(&faces),
        }
    }
}

impl World {
    /// The scene as it is now, packed for the GPU, its trees excepted. The same scene gives the same bytes.
    pub fn upload(&self) -> WorldBuffers {
        let textures = PlacedTextures::of(self);
        let appearance = self.appearance(&textures);
        let mut geometry = Words::default();
        let mut meshes: HashMap<&Id, MeshPlaces> = HashMap::new();
        let placements = self
            .accel()
            .instances()
            .iter()
            .enumerate()
            .map(|(index, instance)| {
                let mesh =
                    *meshes.entry(instance.mesh_id()).or_insert_with(|| geometry.append_mesh(instance));
                self.placement(index, instance, mesh, &mut geometry)
            })
            .collect();
        WorldBuffers { appearance, placements, geometry: geometry.0, texels: textures.texels() }
    }

    fn placement(
        &self,
        index: usize,
        instance: &Instance,
        mesh: MeshPlaces,
        geometry: &mut Words,
    ) -> GpuPlacement {
        let [turn_x, turn_y, turn_z] = instance.render_from_mesh().to_cols_array_2d();
        let [normal_x, normal_y, normal_z] = instance.normal_from_mesh().to_cols_array_2d();
        let primitives: Vec<[u32; 2]> = instance
            .mesh()
            .primitives()
            .iter()
            .zip(self.materials_of(index))
            .map(|(primitive, material)| [primitive.first_triangle, *material])
            .collect();
        let runs = self.lights().emissive_runs(index);
        let only_moved = u32::from(instance.is_only_moved());
        let mirrored = if instance.handedness() < 0.0 { 2 } else { 0 };
        GpuPlacement {
            render_from_mesh_x: turn_x,
            normals_at: mesh.normals_at,
            render_from_mesh_y: turn_y,
            tangents_at: mesh.tangents_at,
            render_from_mesh_z: turn_z,
            texcoords_0_at: mesh.texcoords_at[0],
            normal_from_mesh_x: normal_x,
            texcoords_1_at: mesh.texcoords_at[1],
            normal_from_mesh_y: normal_y,
            colors_at: mesh.colors_at,
            normal_from_mesh_z: normal_z,
            corners_at: mesh.corners_at,
            centre_in_render: instance.centre_in_render().into(),
            positions_at: mesh.positions_at,
            faces_at: mesh.faces_at,
            primitives_at: geometry.append(&primitives),
            primitive_count: primitives.len() as u32,
            flags: only_moved | mirrored,
            runs_at: geometry.append(&runs),
            run_count: runs.len() as u32,
            padding_0: 0,
            padding_1: 0,
        }
    }
}
