//! Laws of the builder: limits hold whatever the order of changes, and odd input neither grows nor blurs a scene.

use glam::{DAffine3, DVec3, Vec3};

use super::{
    Environment, Id, Light, LightKind, Material, MeshSource, Node, Primitive, Scene, SceneBuilder,
    SceneChange, SceneError, SceneLimits,
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

fn is_over_emissive_limit(result: Result<(), SceneError>, count: u64) -> bool {
    matches!(result, Err(SceneError::OverLimit { what: "emissive triangles", value, limit: 8, .. }) if value == count)
}

/// Emissive triangles are counted over instances, through every way that makes or ends one.
#[test]
fn emissive_triangles_of_all_instances_stay_within_the_limit() {
    let mut builder = with_lamp_and_wall();
    builder.add_node(id("a"), node(Some("lamp"), None)).unwrap();
    builder.add_node(id("b"), node(Some("lamp"), Some("a"))).unwrap();
    assert!(is_over_emissive_limit(builder.add_node(id("c"), node(Some("lamp"), None)), 12));
    builder.add_node(id("w"), node(Some("wall"), None)).unwrap();
    // Light on the wall would be three more; a lamp that goes out makes room, a changed colour takes none.
    assert!(is_over_emissive_limit(builder.set_material(id("matt"), Material::emitter(Rgb::WHITE)), 11));
    builder.set_material(id("light"), Material::emitter(Rgb::new(2.0, 0.0, 0.0))).unwrap();
    builder.remove_node("b").unwrap();
    builder.set_material(id("matt"), Material::emitter(Rgb::WHITE)).unwrap();
    // A builder that starts from this scene counts what is there: 4 + 3.
    let (scene, _) = builder.finish();
    let limits = SceneLimits { emissive_triangles_max: 8, ..SceneLimits::default() };
    let mut builder = SceneBuilder::from_scene(&scene, limits);
    assert!(is_over_emissive_limit(builder.add_node(id("c"), node(Some("lamp"), None)), 11));
    builder.set_material(id("light"), Material::lambert(Rgb::BLACK)).unwrap();
    builder.add_node(id("c"), node(Some("wall"), None)).unwrap();
    assert!(is_over_emissive_limit(builder.add_node(id("d"), node(Some("wall"), None)), 9));
    builder.remove_node("w").unwrap();
    builder.add_node(id("d"), node(Some("wall"), None)).unwrap();
}

/// A limit is told with the field of the edit that goes beyond it, or with what names the one too many.
#[test]
fn limits_name_the_field_at_fault() {
    let limits = SceneLimits {
        vertices_max: 12,
        triangles_max: 6,
        emissive_triangles_max: 4,
        nodes_max: 2,
        node_depth_max: 1,
        materials_max: 2,
        lights_max: 0,
        ..SceneLimits::default()
    };
    let mut builder = SceneBuilder::new(limits);
    builder.set_material(id("light"), Material::emitter(Rgb::WHITE)).unwrap();
    builder.set_material(id("matt"), Material::lambert(Rgb::WHITE)).unwrap();
    builder.add_mesh(id("lamp"), strip(3, &id("light"))).unwrap();
    builder.add_mesh(id("wall"), strip(2, &id("matt"))).unwrap();
    builder.add_node(id("a"), node(Some("lamp"), None)).unwrap();
    let field = |result: Result<(), SceneError>| result.unwrap_err().field();
    assert_eq!(field(builder.add_mesh(id("m"), strip(30, &id("matt")))), Some("positions"));
    let [a, b, c] = [[0, 1, 2], [1, 2, 3], [2, 3, 0]];
    let crossed = MeshSource { triangles: vec![a, b, c], ..strip(2, &id("matt")) };
    let crossed = MeshSource { primitives: strip(3, &id("matt")).primitives, ..crossed };
    let roomier = SceneLimits { triangles_max: 6, ..SceneLimits::default() };
    let mut roomier = SceneBuilder::from_scene(builder.scene(), roomier);
    assert_eq!(field(roomier.add_mesh(id("m"), crossed)), Some("triangles"));
    assert_eq!(field(builder.add_node(id("b"), node(Some("lamp"), None))), Some("mesh"));
    assert_eq!(field(builder.add_node(id("b"), node(None, Some("a")))), Some("parent"));
    builder.add_node(id("w"), node(Some("wall"), None)).unwrap();
    assert_eq!(field(builder.add_node(id("c"), node(None, None))), Some("node"));
    let glowing = Material::emitter(Rgb::WHITE);
    assert_eq!(field(builder.set_material(id("matt"), glowing)), Some("emission"));
    assert_eq!(field(builder.set_material(id("third"), Material::default())), Some("material"));
    let kind = LightKind::Point { intensity: Rgb::WHITE };
    let lamp = Light { parent: None, position: DVec3::ZERO, direction: DVec3::Z, kind };
    assert_eq!(field(builder.add_light(id("l"), lamp)), Some("light"));
}

/// A refused change leaves the scene and its counts as they were.
#[test]
fn refused_lamps_leave_no_trace() {
    let mut builder = with_lamp_and_wall();
    builder.add_node(id("a"), node(Some("lamp"), None)).unwrap();
    for _ in 0..5 {
        let far = DAffine3::from_translation(DVec3::splat(1e12));
        assert!(
            builder.add_node(id("b"), Node { parent_from_node: far, ..node(Some("lamp"), None) }).is_err()
        );
    }
    builder.add_node(id("b"), node(Some("lamp"), None)).unwrap();
    assert_eq!(builder.scene().nodes().len(), 2);
}

/// Whoever sets what is set already changes nothing: light that is known stays known. The least that is otherwise does change it.
#[test]
fn what_is_set_again_changes_nothing() {
    let light = Light {
        parent: None,
        position: DVec3::Y,
        direction: DVec3::new(0.0, -3.0, 4.0),
        kind: LightKind::Directional { irradiance: Rgb::WHITE },
    };
    let set = |builder: &mut SceneBuilder, light: &Light, albedo: f32, x: f64, sky: f32| {
        builder.set_material(id("wall"), Material::lambert(Rgb::splat(albedo))).unwrap();
        builder.set_transform("room", DAffine3::from_translation(x * DVec3::X)).unwrap();
        builder.set_light("sun", light.clone()).unwrap();
        builder.set_environment(Environment::Constant(Rgb::splat(sky))).unwrap();
    };
    let mut builder = SceneBuilder::new(SceneLimits::default());
    builder.add_node(id("room"), node(None, None)).unwrap();
    builder.add_light(id("sun"), light.clone()).unwrap();
    set(&mut builder, &light, 0.5, 1.0, 0.3);
    let (scene, _) = builder.finish();
    let change_by = |light: &Light, albedo: f32, x: f64, sky: f32| {
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        set(&mut builder, light, albedo, x, sky);
        builder.finish().1
    };
    assert_eq!(change_by(&light, 0.5, 1.0, 0.3), SceneChange::default());
    // Whoever leaves the direction out sets the one that there is.
    for number in 1..100 {
        let direction = DVec3::new(f64::from(number).sin(), f64::from(7 * number).cos(), 0.1);
        let mut builder = SceneBuilder::new(SceneLimits::default());
        builder.add_light(id("sun"), Light { direction, ..light.clone() }).unwrap();
        let (scene, _) = builder.finish();
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        builder.set_light("sun", scene.lights()["sun"].clone()).unwrap();
        assert_eq!(builder.finish().1, SceneChange::default(), "{direction}");
    }
    let dimmer = Light { kind: LightKind::Directional { irradiance: Rgb::splat(0.999) }, ..light.clone() };
    assert_eq!(change_by(&dimmer, 0.5, 1.0, 0.3).lights.len(), 1);
    assert_eq!(change_by(&light, 0.501, 1.0, 0.3).materials.len(), 1);
    assert_eq!(change_by(&light, 0.5, 1.001, 0.3).nodes.len(), 1);
    assert!(change_by(&light, 0.5, 1.0, 0.301).environment);
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

/// Warnings beyond the limit are counted in one last line, over any number of batches of edits.
#[test]
fn warnings_stay_within_their_limit_over_many_batches() {
    let limits = SceneLimits { warnings_max: 3, ..SceneLimits::default() };
    let mut scene = Scene::default();
    for batch in 0..10 {
        let mut builder = SceneBuilder::from_scene(&scene, limits);
        builder.warn("file", format!("first of batch {batch}"));
        builder.warn("file", format!("second of batch {batch}"));
        scene = builder.finish().0;
    }
    let messages: Vec<&str> = scene.warnings().iter().map(|warning| warning.message.as_str()).collect();
    let expected =
        ["first of batch 0", "second of batch 0", "first of batch 1", "17 more warnings were left out"];
    assert_eq!(messages, expected);
}

/// Lights stay within reach of single precision, wherever their node carries them.
#[test]
fn lights_out_of_reach_are_refused() {
    let mut builder = SceneBuilder::new(SceneLimits::default());
    let large = Node { parent_from_node: DAffine3::from_scale(DVec3::splat(1e9)), ..node(None, None) };
    builder.add_node(id("large"), large).unwrap();
    builder.add_node(id("plain"), node(None, None)).unwrap();
    let light = |parent: &str| Light {
        parent: Some(id(parent)),
        position: DVec3::new(0.0, 1e6, 0.0),
        direction: DVec3::NEG_Y,
        kind: LightKind::Point { intensity: Rgb::WHITE },
    };
    let refused = builder.add_light(id("far"), light("large")).unwrap_err();
    assert_eq!(refused.field(), Some("position"));
    builder.add_light(id("near"), light("plain")).unwrap();
    assert!(builder.set_transform("plain", DAffine3::from_scale(DVec3::splat(1e9))).is_err());
    assert_eq!(builder.scene().nodes()["plain"].parent_from_node, DAffine3::IDENTITY);
    // A sun has no place.
    let sun = Light { kind: LightKind::Directional { irradiance: Rgb::WHITE }, ..light("large") };
    builder.add_light(id("sun"), sun).unwrap();
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

/// A tree of a hundred thousand nodes goes in one edit, in about the time of a walk over it.
#[test]
fn removing_a_large_tree_removes_all_of_it() {
    let mut builder = with_lamp_and_wall();
    builder.add_node(id("kept"), node(Some("wall"), None)).unwrap();
    builder.add_node(id("root"), node(None, None)).unwrap();
    for i in 0..90_000 {
        if i % 100 == 0 {
            builder.add_mesh(id(&format!("mesh {i}")), strip(1, &id("matt"))).unwrap();
        }
        let mesh = format!("mesh {}", i / 100 * 100);
        builder.add_node(id(&format!("leaf {i}")), node(Some(&mesh), Some("root"))).unwrap();
    }
    let start = std::time::Instant::now();
    builder.remove_node("root").unwrap();
    println!("removed in {:?}", start.elapsed());
    let (scene, change) = builder.finish();
    assert!(scene.nodes().keys().eq([id("kept")].iter()));
    assert_eq!(change.nodes.len(), 90_002);
    assert!(scene.meshes().keys().eq(["lamp", "wall"].map(id).iter()));
}
