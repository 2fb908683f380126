//! Triangle meshes.

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::{Aabb, Id};

/// A mesh as it comes from a file or an edit: raw numbers that the builder checks.
#[derive(Clone, Debug, Default)]
pub struct MeshSource {
    /// `[n]` positions in mesh space, metres.
    pub positions: Vec<DVec3>,
    /// `[n]` unit normals in mesh space or empty; a zero vector stands for "use the triangle's own".
    pub normals: Vec<Vec3>,
    /// `[n]` tangents with handedness in w, or empty: then they follow from the texture coordinates.
    pub tangents: Vec<Vec4>,
    /// Two sets of `[n]` texture coordinates, each may be empty.
    pub texcoords: [Vec<Vec2>; 2],
    /// `[n]` linear RGBA factors on the base colour, or empty.
    pub colors: Vec<Vec4>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Runs of triangles with one material each, in order, covering all triangles.
    pub primitives: Vec<Primitive>,
}

/// A run of triangles with one material.
#[derive(Clone, Debug, PartialEq)]
pub struct Primitive {
    /// Index of the first triangle.
    pub first_triangle: u32,
    /// Number of triangles.
    pub triangle_count: u32,
    /// The material.
    pub material: Id,
}

/// A valid mesh. Positions are kept relative to the middle of its bounds, so that single precision
/// holds them to 2⁻²⁴ of the mesh's own size wherever its author put the origin.
#[derive(Debug)]
pub struct Mesh {
    pub(in crate::scene) centre: DVec3,
    pub(in crate::scene) positions: Vec<Vec3>,
    pub(in crate::scene) normals: Vec<Vec3>,
    pub(in crate::scene) tangents: Vec<Vec4>,
    pub(in crate::scene) texcoords: [Vec<Vec2>; 2],
    pub(in crate::scene) colors: Vec<Vec4>,
    pub(in crate::scene) triangles: Vec<[u32; 3]>,
    pub(in crate::scene) primitives: Vec<Primitive>,
    pub(in crate::scene) bounds: Aabb,
}

impl Mesh {
    /// The point of mesh space that positions are relative to.
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// `[n]` positions relative to [`Mesh::centre`], metres.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// `[n]` unit normals or empty; a zero vector means the triangle's own normal.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// `[n]` tangents (w = handedness) or empty.
    pub fn tangents(&self) -> &[Vec4] {
        &self.tangents
    }

    /// Texture coordinates of set 0 or 1: `[n]` or empty.
    pub fn texcoords(&self, set: usize) -> &[Vec2] {
        self.texcoords.get(set).map_or(&[], Vec::as_slice)
    }

    /// `[n]` linear RGBA factors or empty.
    pub fn colors(&self) -> &[Vec4] {
        &self.colors
    }

    /// Triangles: three vertex indices each, none without area.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Runs of triangles with one material each, covering all triangles in order.
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// Bounds in mesh space (centre included).
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Memory of vertices and triangles.
    pub fn bytes(&self) -> usize {
        self.positions.len() * 12
            + self.normals.len() * 12
            + self.tangents.len() * 16
            + (self.texcoords[0].len() + self.texcoords[1].len()) * 8
            + self.colors.len() * 16
            + self.triangles.len() * 12
    }
}
