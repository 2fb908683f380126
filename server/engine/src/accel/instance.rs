//! A mesh where it stands, and points on it with bounds on their rounding error.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Mat3, Vec3, Vec3A};
use obvhs::aabb::Aabb;

use super::{Hit, Ray, TriangleId, bottom::BottomTree};
use crate::scene::{self, Id, Mesh};

/// γₙ = nε/(1 − nε): relative error of n roundings [Higham2002, 3.1].
const fn gamma(n: f32) -> f32 {
    let e = n * f32::EPSILON * 0.5;
    e / (1.0 - e)
}

/// γ₅.
pub const GAMMA_5: f32 = gamma(5.0);
/// γ₁₉.
pub const GAMMA_19: f32 = gamma(19.0);

/// A mesh placed by a node.
#[derive(Debug)]
pub struct Instance {
    node_id: Id,
    mesh_id: Id,
    mesh: Arc<Mesh>,
    bottom: Arc<BottomTree>,
    render_from_mesh: Mat3,
    mesh_from_render: Mat3,
    /// The mesh's centre in render space.
    centre_in_render: Vec3,
    normal_from_mesh: Mat3,
    bounds_in_world: scene::Aabb,
    /// What rounding may move a ray by on its way into mesh space, in render space.
    slack: f32,
    /// By how much the way there and back magnifies rounding; 1 for an instance that is only moved.
    condition: f32,
    handedness: f32,
    /// The mesh is moved, but neither turned nor scaled: directions stay as they are.
    is_only_moved: bool,
    /// Absolute values of `render_from_mesh`, for error bounds.
    absolute: Mat3,
}

/// A point on a surface, with what rays need to leave it.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position in render space.
    pub position: Vec3,
    /// Unit normal of the triangle on its front: the side from which its vertices run counter-clockwise in the mesh.
    pub n_geo: Vec3,
    /// Largest distance along `n_geo` by which `position` may be off the surface.
    pub error_m: f32,
    /// The triangle it is on, for points that were met.
    pub on: TriangleId,
}

impl Instance {
    pub(super) fn new(
        node_id: Id,
        mesh_id: Id,
        (mesh, bottom): (Arc<Mesh>, Arc<BottomTree>),
        world_from_mesh: DAffine3,
        origin_in_world: DVec3,
    ) -> Instance {
        let linear = world_from_mesh.matrix3;
        let inverse = linear.inverse();
        let centre = world_from_mesh.transform_point3(mesh.centre()) - origin_in_world;
        // Normals turn with the inverse transpose, and keep to their side of the surface: where a transform
        // mirrors, glTF turns the winding that counts as front round with it.
        let normal_from_mesh = inverse.transpose();
        // The normal matrix is used for directions only: its size is normalised to stay within f32.
        let normal_from_mesh = normal_from_mesh
            * (1.0 / normal_from_mesh.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max));
        let bounds_in_world = mesh.bounds().transformed(&world_from_mesh);
        // Boxes are of exact numbers, rays are not: their way into mesh space rounds 8 times, and a transform that
        // shears magnifies that by its condition.
        let absolute = |m: DMat3| DMat3::from_cols_array(&m.to_cols_array().map(f64::abs));
        let condition = (absolute(linear) * absolute(inverse) * DVec3::ONE).max_element();
        let [min, max] = [bounds_in_world.min, bounds_in_world.max].map(|corner| corner - origin_in_world);
        let slack = min.abs().max(max.abs()).max_element() * condition * f64::from(8.0 * f32::EPSILON);
        Instance {
            node_id,
            mesh_id,
            mesh,
            bottom,
            render_from_mesh: linear.as_mat3(),
            mesh_from_render: inverse.as_mat3(),
            centre_in_render: centre.as_vec3(),
            normal_from_mesh: normal_from_mesh.as_mat3(),
            bounds_in_world,
            slack: slack as f32,
            condition: condition as f32,
            is_only_moved: linear == DMat3::IDENTITY,
            absolute: absolute(linear).as_mat3(),
            handedness: if linear.determinant() < 0.0 { -1.0 } else { 1.0 },
        }
    }

    /// What rounding may move a ray by on its way into mesh space, m: rays may be stopped so far outside the bounds.
    pub fn slack_m(&self) -> f32 {
        self.slack
    }

    /// The node.
    pub fn node_id(&self) -> &Id {
        &self.node_id
    }

    /// The mesh's name.
    pub fn mesh_id(&self) -> &Id {
        &self.mesh_id
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    pub(super) fn bottom(&self) -> &BottomTree {
        &self.bottom
    }

    pub(super) fn mesh_from_render(&self) -> Mat3 {
        self.mesh_from_render
    }

    pub(crate) fn centre_in_render(&self) -> Vec3 {
        self.centre_in_render
    }

    /// Bounds in the world.
    pub fn bounds_in_world(&self) -> &scene::Aabb {
        &self.bounds_in_world
    }

    pub(super) fn condition(&self) -> f32 {
        self.condition
    }

    /// Box around a box of mesh space, with room for the rounding of rays.
    pub(super) fn box_in_render(&self, local: &Aabb) -> Aabb {
        let centre = (local.min + local.max) * 0.5;
        let half = (local.max - local.min) * 0.5;
        let centre = Vec3A::from(self.render_from_mesh * Vec3::from(centre) + self.centre_in_render);
        let half = Vec3A::from(self.absolute * Vec3::from(half));
        let rounding =
            (centre.abs() + half + Vec3A::from(self.centre_in_render.abs())) * (8.0 * f32::EPSILON);
        let half = half + rounding + Vec3A::splat(self.slack);
        Aabb { min: centre - half, max: centre + half }
    }

    /// Directions of rays are the same in mesh space as in render space.
    #[inline(always)]
    pub(crate) fn is_only_moved(&self) -> bool {
        self.is_only_moved
    }

    /// The ray in mesh space, relative to the mesh's centre; `t` keeps its meaning.
    #[inline(always)]
    pub(crate) fn ray_in_mesh(&self, ray: &Ray) -> Ray {
        let from_centre = ray.origin - self.centre_in_render;
        if self.is_only_moved {
            Ray { origin: from_centre, ..*ray }
        } else {
            Ray {
                origin: self.mesh_from_render * from_centre,
                direction: self.mesh_from_render * ray.direction,
                ..*ray
            }
        }
    }

    /// −1 when the transform mirrors, 1 otherwise.
    pub fn handedness(&self) -> f32 {
        self.handedness
    }

    /// A direction of mesh space in render space (not normalised).
    pub fn vector_to_render(&self, v: Vec3) -> Vec3 {
        self.render_from_mesh * v
    }

    /// A normal of mesh space in render space (not normalised).
    pub fn normal_to_render(&self, n: Vec3) -> Vec3 {
        self.normal_from_mesh * n
    }

    /// What takes points of mesh space, seen from the mesh's centre, to render space, less [`Instance::centre_in_render`].
    pub(crate) fn render_from_mesh(&self) -> Mat3 {
        self.render_from_mesh
    }

    /// What [`Instance::normal_to_render`] multiplies by.
    pub(crate) fn normal_from_mesh(&self) -> Mat3 {
        self.normal_from_mesh
    }

    /// Unit normal of a triangle, in mesh space.
    pub(crate) fn face_normal(&self, triangle: u32) -> Vec3 {
        let [v0, v1, v2] =
            self.mesh.triangles()[triangle as usize].map(|v| self.mesh.positions()[v as usize]);
        triangle_normal(v0, v1, v2)
    }

    /// A vertex in render space.
    pub fn vertex_in_render(&self, vertex: u32) -> Vec3 {
        self.render_from_mesh * self.mesh.positions()[vertex as usize] + self.centre_in_render
    }

    /// The point of triangle `triangle` with weights 1 − b1 − b2, b1, b2.
    pub fn surface_point(&self, triangle: u32, b1: f32, b2: f32) -> SurfacePoint {
        let [v0, v1, v2] =
            self.mesh.triangles()[triangle as usize].map(|v| self.mesh.positions()[v as usize]);
        let p_in_mesh = v0 * (1.0 - b1 - b2) + v1 * b1 + v2 * b2;
        let position = self.turned_to_render(p_in_mesh) + self.centre_in_render;
        let n_in_mesh = triangle_normal(v0, v1, v2);
        let n_geo = if self.is_only_moved {
            n_in_mesh
        } else {
            (self.normal_from_mesh * n_in_mesh).normalize_or(Vec3::Z)
        };
        // Weighted vertices: 7 roundings on |v|; the transform: 4 more on |M||p| and |centre|; the ray that will start here
        // goes through the inverse transform, which costs as much again [Pharr2016, 3.9.4]; and the triangle test itself
        // rounds by 8 on the triangle's extent. The start is rounded once more when it is moved off.
        let extent = v0.abs().max(v1.abs()).max(v2.abs());
        let bound =
            self.absolute * (extent * GAMMA_19) + (self.centre_in_render.abs() + position.abs()) * GAMMA_5;
        SurfacePoint { position, n_geo, error_m: bound.dot(n_geo.abs()), on: TriangleId::NONE }
    }

    /// A vector of mesh space in render space.
    #[inline]
    fn turned_to_render(&self, v: Vec3) -> Vec3 {
        if self.is_only_moved { v } else { self.render_from_mesh * v }
    }

    /// [`Instance::surface_point`] of a hit.
    pub fn point_of(&self, hit: &Hit) -> SurfacePoint {
        SurfacePoint { on: hit.triangle_id(), ..self.surface_point(hit.triangle, hit.b1, hit.b2) }
    }
}

/// Unit normal of a triangle.
fn triangle_normal(v0: Vec3, v1: Vec3, v2: Vec3) -> Vec3 {
    let (e1, e2) = (v1 - v0, v2 - v0);
    let n = e1.cross(e2);
    let area2 = n.length_squared();
    // Unless the triangle is a sliver (sine below a hundredth) or its squares leave f32's range, the cross product
    // keeps five digits. Slivers are done again in double precision.
    if area2 > 1e-4 * e1.length_squared() * e2.length_squared() && area2 > 1e-30 && area2 < 1e30 {
        return n * (1.0 / area2.sqrt());
    }
    let edge = |v: Vec3| v.as_dvec3() - v0.as_dvec3();
    edge(v1).cross(edge(v2)).normalize_or(DVec3::Z).as_vec3()
}

impl SurfacePoint {
    /// A ray without end that leaves the surface.
    #[inline]
    pub fn ray_towards(&self, direction: Vec3) -> Ray {
        Ray { left: self.on, ..Ray::new(self.origin_towards(direction), direction) }
    }

    /// Start for a ray towards `direction`: off the surface, on the side the ray leaves to, by the error bound.
    #[inline]
    pub fn origin_towards(&self, direction: Vec3) -> Vec3 {
        self.position + self.n_geo * self.error_m.copysign(direction.dot(self.n_geo))
    }
}
