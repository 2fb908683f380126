//! What the instances of a mesh have in common: its crease surfaces, and where their triangles lie.
//!
//! Surfaces are measured in a space of the shape's own, some units wide, and gathers are taken there: three thousand chairs in a hall
//! are one shape in three thousand places. Places that are turned, mirrored, moved and scaled evenly share one, since angles and shares of
//! areas stay; otherwise each transform has a shape of its own.

use std::sync::Arc;

use glam::{Mat3, Vec3};

#[cfg(feature = "gpu")]
use super::extent::PackedExtents;
use super::{
    crease::CreaseSurfaces,
    extent::{Ball, Extent, Facets, PartVisitor, Whole},
    gather::{GatherBounds, Reach},
};
use crate::{accel::Instance, scene::Mesh};

/// Nodes of a piece of work at most: some 2,000 triangles.
const WORK_NODES: usize = 1024;

/// A mesh as one or many instances have it.
#[derive(Debug)]
pub(super) struct Shape {
    mesh: Arc<Mesh>,
    shape_from_mesh: Mat3,
    /// By what lengths in metres are multiplied to be in its unit.
    per_m: f32,
    crease: CreaseSurfaces,
    /// `[surfaces]`, in the space of the shape.
    surfaces: Vec<Extent>,
}

/// What tells shapes apart, of one crease angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct ShapeName {
    /// Address of the mesh, which whoever keeps the name keeps as well.
    mesh: usize,
    /// Bits of the transform that the shape has taken in.
    own: [u32; 9],
}

impl ShapeName {
    /// Of the shape that an instance has.
    pub(super) fn of(instance: &Instance) -> ShapeName {
        let own = own_linear(instance).to_cols_array().map(f32::to_bits);
        ShapeName { mesh: Arc::as_ptr(instance.mesh()).addr(), own }
    }
}

impl Shape {
    /// Of an instance; the same whichever of those is asked that have it.
    pub(super) fn of(instance: &Instance, angle_rad: f32) -> Shape {
        let mesh = instance.mesh();
        let own = own_linear(instance);
        let per_m = units_per_m(mesh, own);
        let shape_from_mesh = own * per_m;
        let crease = CreaseSurfaces::split(mesh.positions(), mesh.triangles(), own, angle_rad);
        let mut triangles = vec![Vec::new(); crease.count() as usize];
        for triangle in 0..mesh.triangles().len() as u32 {
            triangles[crease.surface_of(triangle) as usize].push(triangle);
        }
        let handedness = if own == Mat3::IDENTITY { 1.0 } else { instance.handedness() };
        let extent_of = |of_one: &Vec<u32>| {
            Extent::of(of_one, |triangle| corners(mesh, shape_from_mesh, triangle), handedness)
        };
        let surfaces = triangles.iter().map(extent_of).collect();
        Shape { mesh: mesh.clone(), shape_from_mesh, per_m, crease, surfaces }
    }

    /// Which triangles belong to which surface.
    pub(super) fn crease(&self) -> &CreaseSurfaces {
        &self.crease
    }

    /// Where an instance has it, one of those that have its name.
    pub(super) fn placed(&self, instance: &Instance) -> Placed {
        let linear = linear_of(instance);
        // Of a transform that the shape has taken in nothing is left but the unit.
        let (turn, scale) = if keeps_angles(linear) {
            let scale = linear.x_axis.length();
            (linear * (1.0 / scale), scale)
        } else {
            (Mat3::IDENTITY, 1.0)
        };
        let metres = scale / self.per_m;
        Placed { turn, shape_from_render: turn.inverse(), metres, middle: instance.centre_in_render() }
    }

    /// Its surfaces in pieces of work: number of the surface, and of the part.
    pub(super) fn pieces_of_work(&self) -> impl Iterator<Item = (u32, usize)> {
        let surfaces = (0..).zip(&self.surfaces);
        surfaces.flat_map(|(surface, extent)| {
            extent.pieces_of_work(WORK_NODES).into_iter().map(move |part| (surface, part))
        })
    }

    /// [`Extent::visit`] of a part of a surface.
    pub(super) fn visit(
        &self,
        placed: &Placed,
        (surface, part): (u32, usize),
        visitor: &mut impl PartVisitor,
    ) {
        self.surfaces[surface as usize].visit(part, placed, visitor);
    }

    /// `[surfaces]`: each as a whole, where the shape is placed.
    pub(super) fn wholes(&self, placed: &Placed) -> impl Iterator<Item = Whole> {
        self.surfaces.iter().map(|surface| surface.whole(placed))
    }

    /// [`Extent::within`] of a surface where the shape is placed.
    pub(super) fn within(
        &self,
        placed: &Placed,
        surface: u32,
        bounds: &GatherBounds,
        reach: Reach,
    ) -> Facets {
        let bounds = placed.bounds_in_shape(bounds);
        let reach = Reach { radius_m: reach.radius_m / placed.metres, ..reach };
        let corners = |triangle| corners(&self.mesh, self.shape_from_mesh, triangle);
        placed.facets_to_render(self.surfaces[surface as usize].within(&bounds, reach, corners))
    }

    /// Adds the surfaces to those that are packed, where the shape is placed.
    #[cfg(feature = "gpu")]
    pub(super) fn pack(&self, placed: &Placed, instance: &Instance, into: &mut PackedExtents) {
        let corners = |triangle: u32| {
            instance.mesh().triangles()[triangle as usize].map(|vertex| instance.vertex_in_render(vertex))
        };
        self.surfaces.iter().for_each(|surface| surface.pack(placed, corners, into));
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        self.crease.bytes() + self.surfaces.iter().map(Extent::bytes).sum::<usize>()
    }
}

/// Where an instance has its shape: turned, scaled, moved, in this order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    /// At right angles and of length one, to what [`keeps_angles`] tolerates; may mirror.
    turn: Mat3,
    /// Back again: what tolerance leaves would move places far from the middle.
    shape_from_render: Mat3,
    /// The shape's unit, m.
    metres: f32,
    /// Of its origin, render space.
    middle: Vec3,
}

impl Placed {
    /// A point of the shape in render space.
    pub(super) fn point_to_render(&self, p: Vec3) -> Vec3 {
        self.turn * (p * self.metres) + self.middle
    }

    /// A unit vector.
    pub(super) fn direction_to_render(&self, direction: Vec3) -> Vec3 {
        self.turn * direction
    }

    /// A length, m.
    pub(super) fn length_to_render(&self, length: f32) -> f32 {
        length * self.metres
    }

    /// An area, m².
    #[cfg(feature = "gpu")]
    pub(super) fn area_to_render(&self, area: f32) -> f32 {
        area * self.metres * self.metres
    }

    /// The sum over some area of places on it, m³.
    pub(super) fn moment_to_render(&self, moment: Vec3, area: f32) -> Vec3 {
        (self.turn * (moment * self.metres) + self.middle * area) * (self.metres * self.metres)
    }

    /// A piece of the shape's surface.
    pub(super) fn facets_to_render(&self, facets: Facets) -> Facets {
        facets.turned_by(self.turn, self.metres * self.metres)
    }

    /// Around what is placed here, with room for what rounding moves in render space: photons fall there.
    pub(super) fn ball_to_render(&self, ball: Ball) -> Ball {
        let middle = self.point_to_render(ball.middle);
        let reach_m = self.length_to_render(ball.reach_m);
        let rounding_m =
            (middle.abs().max(self.middle.abs()).max_element() + reach_m) * (16.0 * f32::EPSILON);
        Ball { middle, reach_m: reach_m * 1.0001 + rounding_m }
    }

    fn bounds_in_shape(&self, bounds: &GatherBounds) -> GatherBounds {
        let per_m = 1.0 / self.metres;
        GatherBounds {
            centre: self.shape_from_render * (bounds.centre - self.middle) * per_m,
            normal: self.turn.transpose() * bounds.normal,
            radius_m: bounds.radius_m * per_m,
            radius_max_m: bounds.radius_max_m * per_m,
            walls: bounds.walls.turned_by(self.turn.transpose(), per_m),
            ..*bounds
        }
    }
}

/// What a shape takes in of the transform of an instance: nothing where that turns, mirrors, moves and scales evenly.
fn own_linear(instance: &Instance) -> Mat3 {
    let linear = linear_of(instance);
    if keeps_angles(linear) { Mat3::IDENTITY } else { linear }
}

/// From mesh to render space, without the move.
fn linear_of(instance: &Instance) -> Mat3 {
    Mat3::from_cols(
        instance.vector_to_render(Vec3::X),
        instance.vector_to_render(Vec3::Y),
        instance.vector_to_render(Vec3::Z),
    )
}

/// Columns at right angles and of one length.
fn keeps_angles(linear: Mat3) -> bool {
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
    let size = x.length_squared();
    let close = |value: f32, target: f32| (value - target).abs() <= 1e-5 * size;
    close(y.length_squared(), size)
        && close(z.length_squared(), size)
        && close(x.dot(y), 0.0)
        && close(y.dot(z), 0.0)
        && close(z.dot(x), 0.0)
}

/// By what lengths are multiplied to be in the shape's unit: a power of two that makes the mesh reach between one and two from its centre, so that
/// squares of areas stay numbers whatever unit the mesh is in.
fn units_per_m(mesh: &Mesh, own: Mat3) -> f32 {
    let farthest = mesh.positions().iter().map(|p| (own * *p).abs().max_element()).fold(0.0, f32::max);
    let power = if farthest > 0.0 { -(farthest.log2().floor()).clamp(-100.0, 100.0) } else { 0.0 };
    2f32.powi(power as i32)
}

fn corners(mesh: &Mesh, shape_from_mesh: Mat3, triangle: u32) -> [Vec3; 3] {
    mesh.triangles()[triangle as usize].map(|vertex| shape_from_mesh * mesh.positions()[vertex as usize])
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DMat3, DQuat, DVec3};

    use super::*;
    use crate::{
        math::{Rgb, sobol::point, warp},
        scene::{
            Id, Material, Node, SceneBuilder, SceneLimits,
            samples::{self, Stage},
        },
        technique::{CREASE_ANGLE_RAD, SideId, Surfaces, products::walls::Walls},
        transport::World,
    };

    /// One ball of a metre, flattened a little so that it has no symmetry, in some places.
    fn balls(rings: u32, places: &[DAffine3]) -> World {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.5))).unwrap();
        let mut ball = samples::sphere(DVec3::new(0.3, 0.1, 0.0), 1.0, rings, &white);
        ball.positions.iter_mut().for_each(|p| *p *= DVec3::new(1.0, 0.8, 0.7));
        // Its own normals are those of a round one.
        ball.normals.clear();
        stage.place("ball", ball, places[0]).unwrap();
        for (place, parent_from_node) in places.iter().enumerate().skip(1) {
            let (id, mesh) = (Id::new(&format!("ball {place}")).unwrap(), Id::new("ball"));
            stage
                .builder()
                .add_node(id, Node { parent: None, parent_from_node: *parent_from_node, mesh })
                .unwrap();
        }
        World::prepare(Arc::new(stage.finish()))
    }

    fn surfaces_of(world: &World, before: &Surfaces) -> Surfaces {
        Surfaces::of(world.accel(), CREASE_ANGLE_RAD, before)
    }

    /// Turned, mirrored, moved far away, made small and large, and sheared.
    fn places() -> [DAffine3; 6] {
        let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 1.2, -0.4));
        let at = |scale: DVec3, middle: DVec3| DAffine3::from_scale_rotation_translation(scale, turn, middle);
        let sheared = DMat3::from_cols(DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.0, -0.2, -0.7));
        [
            DAffine3::IDENTITY,
            at(DVec3::ONE, DVec3::new(5.0, -3.0, 2.0)),
            at(DVec3::new(-1.0, 1.0, 1.0), DVec3::new(-8.0, 1.0, 0.0)),
            at(DVec3::splat(0.02), DVec3::new(0.0, 4.0, 0.0)),
            at(DVec3::splat(30.0), DVec3::new(90.0, 0.0, 0.0)),
            DAffine3 { matrix3: sheared, translation: DVec3::new(0.0, 0.0, -7.0) },
        ]
    }

    /// What lies within a gather is what lies within it of the same triangles in render space, wherever the shape is placed.
    #[test]
    fn areas_are_those_of_the_triangles_where_they_stand() {
        let world = balls(6, &places());
        let surfaces = surfaces_of(&world, &Surfaces::default());
        let mut found_some = 0;
        for (index, instance) in (0..).zip(world.accel().instances()) {
            assert_eq!(surfaces.first_surface(index + 1) - surfaces.first_surface(index), 1);
            let in_render = |triangle: u32| {
                instance.mesh().triangles()[triangle as usize].map(|v| instance.vertex_in_render(v))
            };
            let triangles: Vec<u32> = (0..instance.mesh().triangles().len() as u32).collect();
            let expected = Extent::of(&triangles, in_render, instance.handedness());
            let ball = expected.ball();
            let whole_m2 = expected.area_m2();
            let area_m2 = surfaces.area_m2(index);
            assert!((area_m2 / whole_m2 - 1.0).abs() < 3e-5, "{index}: {area_m2} for {whole_m2}");
            for number in 0..60 {
                let [a, b, c, d] = point(31, number);
                let [e, f, ..] = point(32, number);
                let centre = ball.middle + warp::sphere([a, b]) * (ball.reach_m * c);
                let normal = warp::sphere([d, e]);
                let walls = Walls::at([
                    (warp::sphere([f, a]), 0.3 * ball.reach_m),
                    (warp::sphere([b, f]), ball.reach_m),
                ]);
                let without = GatherBounds::at(centre, normal);
                let bounds = if number % 2 == 0 { GatherBounds { walls, ..without } } else { without };
                let facing_cos = [0.5, 0.79, -2.0][number as usize % 3];
                let reach = Reach { radius_m: ball.reach_m * (0.2 + 1.5 * d), facing_cos };
                let front = expected.within(&bounds, reach, in_render);
                let own = surfaces.within(SideId::of(index, true), &bounds, reach);
                let off_m2 = own.farthest_from(&front);
                assert!(off_m2 < 1e-4 * whole_m2, "{index} {number}: {own:?} for {front:?}");
                found_some += u32::from(front.area_m2 > 0.1 * whole_m2);
                // From the other side the other half of it faces.
                let turned = GatherBounds { normal: -normal, ..bounds };
                let back = expected.within(&turned, reach, in_render).turned();
                let own = surfaces.within(SideId::of(index, false), &bounds, reach);
                assert!(own.farthest_from(&back) < 1e-4 * whole_m2, "{index} {number}: {own:?} for {back:?}");
            }
        }
        assert!(found_some > 100, "{found_some}");
    }

    /// Instances that are only turned, mirrored, moved or scaled have one shape; whoever came first, it is the same, and edits take it over.
    #[test]
    fn instances_share_shapes() {
        let world = balls(8, &places());
        let surfaces = surfaces_of(&world, &Surfaces::default());
        assert_eq!(surfaces.shapes().len(), 2, "one for all, one for what is sheared");
        let after = surfaces_of(&balls(8, &places()[..2]), &surfaces);
        assert_eq!(after.shapes().len(), 1, "what nobody has is let go");
        assert_eq!(surfaces_of(&world, &surfaces).shapes().len(), 2);
        let twice = balls(8, &[places()[4], places()[0]]);
        let [first, second] = [0, 1].map(|instance| {
            let shape = Shape::of(&twice.accel().instances()[instance], CREASE_ANGLE_RAD);
            format!("{:?}", shape.surfaces)
        });
        assert!(first == second, "it does not depend on the instance");
        // One of two is moved.
        let before = surfaces_of(&twice, &Surfaces::default());
        let mut builder = SceneBuilder::from_scene(twice.scene(), SceneLimits::default());
        builder.set_transform("ball 1", places()[1]).unwrap();
        let (scene, change) = builder.finish();
        let moved = surfaces_of(&twice.update(Arc::new(scene), &change), &before);
        assert!(Arc::ptr_eq(&before.shapes()[0], &moved.shapes()[0]), "it is not measured again");
    }

    /// Of what is small beside a gather its ball and cone say what its triangles say; all but those at the rim, and those that face in part, are
    /// not looked at: none of those above the ellipsoid or below.
    #[test]
    fn small_surfaces_are_seldom_looked_into() {
        let world = balls(3, &places());
        let surfaces = surfaces_of(&world, &Surfaces::default());
        let [mut known, mut whole, mut above, mut count] = [0; 4];
        for (index, instance) in (0..).zip(world.accel().instances()) {
            let shape = Shape::of(instance, CREASE_ANGLE_RAD);
            let (placed, extent) = (shape.placed(instance), &shape.surfaces[0]);
            let ball = placed.ball_to_render(extent.ball());
            for number in 0..200 {
                let [a, b, c, d] = point(33, number);
                let radius_m = 20.0 * ball.reach_m;
                let from = warp::sphere([a, b]) * (1.1 * radius_m * c.cbrt());
                let normal = warp::sphere([d, c]);
                let bounds = GatherBounds::at(ball.middle - from, normal);
                let reach = Reach { radius_m, facing_cos: -2.0 };
                let looked_into = shape.within(&placed, 0, &bounds, reach);
                let said = extent.whole(&placed).within(&bounds, reach);
                count += 1;
                known += u32::from(said.is_some());
                if let Some(said) = said {
                    assert!(said.farthest_from(&looked_into) < 1e-4 * surfaces.area_m2(index), "{number}");
                    whole += u32::from(said.area_m2 > 0.0);
                    let is_met = from.length() < radius_m;
                    above +=
                        u32::from(is_met && bounds.flattened_from(ball.middle).length() > 1.2 * radius_m);
                }
            }
        }
        assert!(
            known * 10 > count * 7 && whole * 10 > count * 2 && above * 10 > count * 2,
            "{known} {whole} {above} of {count}"
        );
    }
}
