//! Laws of the builder: limits hold whatever the order of changes, and odd input neither grows nor blurs a scene.

use glam::{DAffine3, DVec3, Vec3};

use super::{
    Id, Material, MeshSource, Node, Primitive, SceneBuilder, SceneLimits,
};
use crate::math::Rgb;

fn id(name: &str) -> Id {
    Id::new(name).unwrap()
}

/// A strip of `count` triangles of one material.
fn strip(count: u32, material: &Id) -> MeshSource {
    let positions = (0..count + 2).map(|i| DVec3::new(f64::from(i), f64::from(i % 2), 0.0)).collect();
    let triangles = (0..count).map(|i| [i, i + 1, i + 2]).collect();
    let primitives = vec![Primitive { first_triangle: 0, triangle_count: count, material: material.clone() }];
    MeshSource { positions, triangles, primitives, ..MeshSource::default() }
}

fn node(mesh: Option<&str>, parent: Option<&str>) -> Node {
    Node { parent: parent.map(id), parent_from_node: DAffine3::IDENTITY, mesh: mesh.map(id) }
}

/// A builder with a lamp of 4 triangles and a wall of 3, not yet placed, in a scene that may hold 8 emissive ones.
fn with_lamp_and_wall() -> SceneBuilder {
    let limits = SceneLimits { emissive_triangles_max: 8, ..SceneLimits::default() };
    let mut builder = SceneBuilder::new(limits);
    builder.set_material(id("light"), Material::emitter(Rgb::WHITE)).unwrap();
    builder.set_material(id("matt"), Material::lambert(Rgb::WHITE)).unwrap();
    builder.add_mesh(id("lamp"), strip(4, &id("light"))).unwrap();
    builder.add_mesh(id("wall"), strip(3, &id("matt"))).unwrap();
    builder
}

/// Zero vectors among normals are the documented way to ask for flat ones, and no news.
#[test]
fn zeros_among_normals_are_taken_as_told() {
    let mut builder = with_lamp_and_wall();
    let normals = vec![Vec3::Z, Vec3::ZERO, Vec3::ZERO, Vec3::Z, Vec3::new(0.0, 3e-42, 0.0)];
    builder.add_mesh(id("flat"), MeshSource { normals, ..strip(3, &id("matt")) }).unwrap();
    let scene = builder.finish().0;
    assert_eq!(scene.warnings(), []);
    assert_eq!(scene.meshes()["flat"].normals()[1], Vec3::ZERO);
    assert_eq!(scene.meshes()["flat"].normals()[4], Vec3::Y);
}

/// A vertex that no triangle uses costs the others no digit and the scene's bounds no metre.
#[test]
fn unused_vertices_do_not_blur_a_mesh() {
    let mut builder = with_lamp_and_wall();
    let mut source = strip(3, &id("matt"));
    source.positions.push(DVec3::new(1e8, 0.0, 0.0));
    source.positions[1] = DVec3::new(1.000_1, 1.0, 0.0);
    builder.add_mesh(id("stray"), source).unwrap();
    builder.add_node(id("stray"), node(Some("stray"), None)).unwrap();
    let scene = builder.finish().0;
    assert_eq!(scene.bounds().unwrap().max.x, 4.0);
    let mesh = &scene.meshes()["stray"];
    let x = f64::from(mesh.positions()[1].x) + mesh.centre().x;
    assert!((x - 1.000_1).abs() < 1e-6, "{x}");
}
