//! The scene: an immutable snapshot, shared by `Arc`, and the one builder that validates every change.
//!
//! What comes from outside (files, edits) enters through [`SceneBuilder`] and is checked there once;
//! every [`Scene`] that exists is valid, and the rooms to the right re-check nothing.
//! Imports `math` only.

mod bounds;
mod builder;
mod camera;
mod change;
mod check;
mod error;
mod glass;
mod id;
mod light;
mod limits;
mod material;
mod mesh;
mod mesh_check;
mod nested;
mod node;
pub mod samples;
#[cfg(test)]
mod tests;
mod texture;

use std::sync::Arc;

use glam::DAffine3;
use indexmap::IndexMap;

pub use bounds::Aabb;
pub use builder::SceneBuilder;
pub use camera::{Camera, CameraView, Projection};
pub use change::SceneChange;
pub use check::is_invertible;
pub use error::SceneError;
pub use id::Id;
pub use light::{Environment, Light, LightKind};
pub use limits::SceneLimits;
pub use material::{Material, TextureSlot};
pub use mesh::{Mesh, MeshSource, Primitive};
pub use nested::NestedBounds;
pub use node::Node;
pub use texture::{Encoding, Filter, Texels, Texture, TextureRef, Wrap, linear_from_srgb};

/// Something odd but usable that was met on the way in, shown by `lumicast info` and the viewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// What it is about, such as `mesh "floor"`.
    pub object: String,
    /// What was odd and what was done about it.
    pub message: String,
}

/// An immutable, valid scene: metres, right-handed, +Y up, linear Rec.709.
///
/// Every map is ordered by insertion, so that walking it is the same on every run.
/// References between objects are ids that exist; cloning shares all heavy data.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub(in crate::scene) meshes: IndexMap<Id, Arc<Mesh>>,
    pub(in crate::scene) textures: IndexMap<Id, Arc<Texture>>,
    pub(in crate::scene) materials: IndexMap<Id, Arc<Material>>,
    pub(in crate::scene) nodes: IndexMap<Id, Node>,
    pub(in crate::scene) lights: IndexMap<Id, Light>,
    pub(in crate::scene) cameras: IndexMap<Id, Camera>,
    pub(in crate::scene) environment: Environment,
    pub(in crate::scene) warnings: Vec<Warning>,
    /// Warnings beyond the limit; the last of `warnings` says so when there are any.
    pub(in crate::scene) warnings_left_out: u64,
}

impl Scene {
    /// Meshes by id.
    pub fn meshes(&self) -> &IndexMap<Id, Arc<Mesh>> {
        &self.meshes
    }

    /// Textures by id.
    pub fn textures(&self) -> &IndexMap<Id, Arc<Texture>> {
        &self.textures
    }

    /// Materials by id.
    pub fn materials(&self) -> &IndexMap<Id, Arc<Material>> {
        &self.materials
    }

    /// Nodes by id.
    pub fn nodes(&self) -> &IndexMap<Id, Node> {
        &self.nodes
    }

    /// Punctual lights by id; area lights are meshes whose material emits.
    pub fn lights(&self) -> &IndexMap<Id, Light> {
        &self.lights
    }

    /// Cameras by id.
    pub fn cameras(&self) -> &IndexMap<Id, Camera> {
        &self.cameras
    }

    /// What surrounds the scene.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// What was odd in the input.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// Transform from `node`'s space (the world for `None`) to the world, composed in double precision.
    pub fn world_from_node(&self, node: Option<&Id>) -> DAffine3 {
        let mut world_from_node = DAffine3::IDENTITY;
        let mut at = node;
        // The builder admits no cycles and bounds the depth, so this ends.
        while let Some(node) = at.and_then(|id| self.nodes.get(id)) {
            world_from_node = node.parent_from_node * world_from_node;
            at = node.parent.as_ref();
        }
        world_from_node
    }

    /// Number of triangles over all instances of all meshes.
    pub fn instanced_triangle_count(&self) -> u64 {
        self.nodes
            .values()
            .filter_map(|node| self.meshes.get(node.mesh.as_ref()?))
            .map(|mesh| mesh.triangles().len() as u64)
            .sum()
    }

    /// Bounds of everything that has surface, in the world; `None` for a scene without surface.
    pub fn bounds(&self) -> Option<Aabb> {
        let bounds = self.node_bounds().fold(Aabb::EMPTY, |all, bounds| all.union(&bounds));
        (!bounds.is_empty()).then_some(bounds)
    }

    /// Bounds of each node that has surface, in the world.
    pub fn node_bounds(&self) -> impl Iterator<Item = Aabb> {
        self.nodes.iter().filter_map(|(id, node)| {
            let mesh = node.mesh.as_ref().and_then(|mesh| self.meshes.get(mesh))?;
            let bounds = mesh.bounds().transformed(&self.world_from_node(Some(id)));
            (!bounds.is_empty()).then_some(bounds)
        })
    }

    /// The view of the camera called `name`, or of the first camera for `None`.
    pub fn camera_view(&self, name: Option<&str>) -> Option<CameraView> {
        let camera = match name {
            Some(name) => self.cameras.get(name)?,
            None => self.cameras.values().next()?,
        };
        let world_from_camera = self.world_from_node(camera.parent.as_ref()) * camera.parent_from_camera;
        Some(CameraView { world_from_camera, projection: camera.projection })
    }

    /// A view that shows the whole scene from its front, for scenes without a camera.
    pub fn default_view(&self) -> CameraView {
        let bounds = self.bounds().unwrap_or(Aabb::UNIT);
        CameraView::framing(&bounds)
    }
}
