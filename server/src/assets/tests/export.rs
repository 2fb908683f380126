//! Export → import gives the same scene.

use glam::{Affine2, DAffine3, DQuat, DVec3, Vec2, Vec3, Vec4};
use lumicast_engine::{
    math::Rgb,
    scene::{
        Camera, Environment, Filter, Id, Light, LightKind, Material, MeshSource, Node, Primitive, Projection,
        Scene, SceneBuilder, SceneLimits, Texels, Texture, TextureRef, TextureSlot, Wrap,
        samples::{cornell_box, quad},
    },
};

use super::{load, shared::scenes_folder};
use crate::assets::{AssetLimits, export_glb, load_scene};

fn id(name: &str) -> Id {
    Id::new(name).expect("a valid name")
}

fn exported(scene: &Scene) -> Scene {
    let bytes = export_glb(scene).expect("export");
    load("test.glb", &bytes).unwrap_or_else(|error| panic!("{error}"))
}

/// Equal up to a few roundings of single precision at the size of the numbers.
#[track_caller]
fn close(a: &[f64], b: &[f64], scale: f64, what: &str) {
    assert_eq!(a.len(), b.len(), "{what}");
    let difference = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // 2⁻²²: two roundings to 24 bits, one when written, one when centred again.
    assert!(difference <= scale * 2f64.powi(-22), "{what}: {difference:e} at scale {scale:e}\n{a:?}\n{b:?}");
}

/// What of a mesh a picture depends on: material and vertex values corner by corner.
fn mesh_corners(scene: &Scene, name: &str) -> (Vec<Id>, Vec<f64>, Vec<f64>) {
    let mesh = &scene.meshes()[name];
    let (mut materials, mut positions, mut rest) = (Vec::new(), Vec::new(), Vec::new());
    for run in mesh.primitives() {
        let first = run.first_triangle as usize;
        for vertex in mesh.triangles()[first..first + run.triangle_count as usize].as_flattened() {
            let vertex = *vertex as usize;
            materials.push(run.material.clone());
            positions.extend((mesh.centre() + mesh.positions()[vertex].as_dvec3()).to_array());
            let normal = mesh.normals().get(vertex).copied().unwrap_or_default().to_array();
            let texcoords =
                [0, 1].map(|set| mesh.texcoords(set).get(vertex).copied().unwrap_or_default().to_array());
            let color = mesh.colors().get(vertex).copied().unwrap_or(Vec4::ONE).to_array();
            let tangent = mesh.tangents().get(vertex).copied().unwrap_or_default().to_array();
            let floats = [normal.as_slice(), texcoords.as_flattened(), &color, &tangent].concat();
            rest.extend(floats.into_iter().map(f64::from));
        }
    }
    (materials, positions, rest)
}

/// Everything of both scenes that has a meaning agrees.
#[track_caller]
fn same(a: &Scene, b: &Scene) {
    let affine = |a: &DAffine3, b: &DAffine3, what: &str| {
        close(
            &a.to_cols_array(),
            &b.to_cols_array(),
            a.to_cols_array().iter().fold(1.0, |m, v| f64::max(m, v.abs())),
            what,
        )
    };
    assert_eq!(a.nodes().keys().collect::<Vec<_>>(), b.nodes().keys().collect::<Vec<_>>());
    for (name, node) in a.nodes() {
        let other = &b.nodes()[name];
        assert_eq!((&node.parent, &node.mesh), (&other.parent, &other.mesh), "node {name}");
        affine(&node.parent_from_node, &other.parent_from_node, "node transform");
    }
    assert_eq!(a.meshes().len(), b.meshes().len());
    for (name, mesh) in a.meshes() {
        let (materials, positions, rest) = mesh_corners(a, name.as_str());
        let (materials_b, positions_b, rest_b) = mesh_corners(b, name.as_str());
        assert_eq!(materials, materials_b, "mesh {name}");
        let size = mesh.bounds().min.abs().max(mesh.bounds().max.abs()).max_element();
        close(&positions, &positions_b, size, "positions");
        close(&rest, &rest_b, 2.0, "vertex values");
    }
    assert_eq!(a.textures(), b.textures());
    assert_eq!(a.materials().keys().collect::<Vec<_>>(), b.materials().keys().collect::<Vec<_>>());
    for (name, material) in a.materials() {
        let other = &b.materials()[name];
        let mut plain = [Material::clone(material), Material::clone(other)];
        for slot in 0..plain[0].textures.len() {
            let [first, second] = plain.each_mut().map(|material| material.textures[slot].as_mut());
            assert_eq!(first.is_some(), second.is_some(), "material {name} slot {slot}");
            if let (Some(first), Some(second)) = (first, second) {
                let columns = |reference: &TextureRef| reference.uv_transform.to_cols_array().map(f64::from);
                close(&columns(first), &columns(second), 4.0, "texture transform");
                (first.uv_transform, second.uv_transform) = (Affine2::IDENTITY, Affine2::IDENTITY);
            }
        }
        assert_eq!(plain[0], plain[1], "material {name}");
    }
    assert_eq!(a.lights().len(), b.lights().len());
    for (name, light) in a.lights() {
        let other = &b.lights()[name];
        assert_eq!((&light.parent, light.kind), (&other.parent, other.kind), "light {name}");
        close(&light.position.to_array(), &other.position.to_array(), 1.0, "light position");
        close(&light.direction.to_array(), &other.direction.to_array(), 1.0, "light direction");
    }
    assert_eq!(a.cameras().keys().collect::<Vec<_>>(), b.cameras().keys().collect::<Vec<_>>());
    for (name, camera) in a.cameras() {
        let other = &b.cameras()[name];
        assert_eq!((&camera.parent, camera.projection), (&other.parent, other.projection), "camera {name}");
        affine(&camera.parent_from_camera, &other.parent_from_camera, "camera transform");
        close(
            &camera.aspect.into_iter().collect::<Vec<_>>(),
            &other.aspect.into_iter().collect::<Vec<_>>(),
            1.0,
            "aspect",
        );
    }
    assert_eq!(a.environment(), b.environment());
}

/// A scene with every kind of object and every field away from its default.
fn everything() -> Scene {
    let mut builder = SceneBuilder::new(SceneLimits::default());
    let texels = (0..16u8).map(|i| [i * 16, 255 - i, i, 128 + i]).collect();
    builder
        .add_texture(id("checks"), Texture { width: 4, height: 4, texels: Texels::Rgba8(texels) })
        .expect("texture");
    let sky = vec![[1e4, 0.125, 3.0, 1.0], [0.0, 1e-6, 0.7, 1.0]];
    builder
        .add_texture(id("sky"), Texture { width: 2, height: 1, texels: Texels::Rgba32F(sky) })
        .expect("sky");
    let mut all = Material {
        base_color: Rgb::new(0.1, 0.2, 0.3),
        alpha: 0.4,
        metallic: 0.6,
        roughness: 0.7,
        ior: 1.7,
        specular: 0.3,
        specular_color: Rgb::new(0.1, 2.0, 0.3),
        attenuation_color: Rgb::new(0.3, 0.6, 0.9),
        attenuation_distance_m: 0.3,
        emission: Rgb::new(17.3, 12.1, 7.7),
        double_sided: true,
        alpha_cutoff: Some(0.3),
        normal_scale: 0.8,
        ..Material::default()
    };
    for (index, slot) in TextureSlot::ALL.into_iter().enumerate() {
        all.textures[slot as usize] = Some(TextureRef {
            texcoord_set: (index % 2) as u8,
            uv_transform: Affine2::from_scale_angle_translation(
                Vec2::new(1.5, -0.5),
                index as f32,
                Vec2::new(0.25, 2.0),
            ),
            wrap_u: [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror][index % 3],
            wrap_v: [Wrap::Mirror, Wrap::Repeat][index % 2],
            filter: [Filter::Bilinear, Filter::Nearest][index % 2],
            ..TextureRef::new(id("checks"))
        });
    }
    builder.set_material(id("all"), all).expect("material");
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    builder.set_material(id("glass"), glass).expect("material");
    builder.set_material(id("flat"), Material { unlit: true, ..Material::default() }).expect("material");

    let v = DVec3::new;
    let mut square = quad([v(0., 0., 0.), v(1., 0., 0.), v(1., 1., 0.), v(0., 1., 0.1)], &id("all"));
    square.normals = vec![Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::Z, Vec3::Z];
    square.tangents = vec![Vec4::new(1.0, 0.0, 0.0, -1.0); 4];
    square.texcoords = [vec![Vec2::new(0.1, 0.9); 4], vec![Vec2::new(3.0, -2.0); 4]];
    square.colors = vec![Vec4::new(0.1, 0.2, 0.3, 0.4); 4];
    builder.add_mesh(id("square"), square).expect("mesh");
    // Two runs, of which the second has no normals of its own.
    let mixed = MeshSource {
        positions: vec![
            v(0., 0., 0.),
            v(1., 0., 0.),
            v(0., 1., 0.),
            v(5., 0., 0.),
            v(6., 0., 0.),
            v(5., 1., 0.),
        ],
        normals: vec![Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO],
        triangles: vec![[0, 1, 2], [3, 4, 5]],
        primitives: vec![
            Primitive { first_triangle: 0, triangle_count: 1, material: id("glass") },
            Primitive { first_triangle: 1, triangle_count: 1, material: id("flat") },
        ],
        ..MeshSource::default()
    };
    builder.add_mesh(id("mixed"), mixed).expect("mesh");

    let turned = DAffine3::from_scale_rotation_translation(
        v(1.0, -2.0, 0.5),
        DQuat::from_rotation_y(0.3),
        v(1e5, 0.1, -3.0),
    );
    let mut node = |name: &str, parent: Option<&str>, parent_from_node, mesh: Option<&str>| {
        builder
            .add_node(id(name), Node { parent: parent.map(id), parent_from_node, mesh: mesh.map(id) })
            .expect(name);
    };
    node("root", None, turned, None);
    node("left", Some("root"), DAffine3::from_translation(v(0.1, 0.2, 0.3)), Some("square"));
    node("right", Some("root"), DAffine3::IDENTITY, Some("square"));
    node("main", Some("right"), turned, None);
    node("other", None, DAffine3::IDENTITY, Some("mixed"));

    let light = |parent: Option<&str>, position, direction: DVec3, kind| Light {
        parent: parent.map(id),
        position,
        direction: direction.normalize(),
        kind,
    };
    let spot =
        LightKind::Spot { intensity: Rgb::new(3.3, 0.0, 1e-3), inner_angle_rad: 0.2, outer_angle_rad: 0.9 };
    let sun = LightKind::Directional { irradiance: Rgb::new(1e5, 0.9e5, 7.0) };
    let bulb = LightKind::Point { intensity: Rgb::splat(0.3) };
    builder.add_light(id("plain"), light(Some("left"), DVec3::ZERO, DVec3::NEG_Z, spot)).expect("light");
    builder.add_light(id("second"), light(Some("left"), DVec3::ZERO, DVec3::NEG_Z, bulb)).expect("light");
    builder.add_light(id("sun"), light(None, DVec3::ZERO, v(1.0, -2.0, 3.0), sun)).expect("light");
    builder.add_light(id("up"), light(Some("right"), v(1.0, 2.0, 3.0), DVec3::Z, spot)).expect("light");

    let camera = |parent: Option<&str>, parent_from_camera, projection, aspect| Camera {
        parent: parent.map(id),
        parent_from_camera,
        projection,
        aspect,
    };
    let perspective = Projection::Perspective { yfov_rad: 0.7 };
    builder
        .set_camera(id("main"), camera(Some("main"), DAffine3::IDENTITY, perspective, Some(1.5)))
        .expect("camera");
    builder.set_camera(id("free"), camera(None, turned, perspective, None)).expect("camera");
    let parallel = Projection::Orthographic { half_height_m: 2.5 };
    builder.set_camera(id("plan"), camera(Some("left"), turned, parallel, Some(1.25))).expect("camera");
    let sky = Environment::Image { texture: id("sky"), scale: Rgb::new(0.5, 1.0, 2.0), rotation_rad: 0.75 };
    builder.set_environment(sky).expect("environment");
    builder.finish().0
}

/// Whatever a scene may hold comes back: ids, hierarchy, instances, materials, textures, lights, cameras, sky.
#[test]
fn a_scene_with_everything_comes_back() {
    let scene = everything();
    let back = exported(&scene);
    // Nor is the run without normals news on its way back.
    assert_eq!((scene.warnings(), back.warnings()), (&[][..], &[][..]));
    same(&scene, &back);
    let again = exported(&back);
    same(&back, &again);
}

/// The built-in scene, the empty one and one with nothing but a sky come back.
#[test]
fn built_in_and_empty_scenes_come_back() {
    same(&cornell_box().expect("built in"), &exported(&cornell_box().expect("built in")));
    same(&Scene::default(), &exported(&Scene::default()));
    let mut builder = SceneBuilder::new(SceneLimits::default());
    builder.set_environment(Environment::Constant(Rgb::new(0.1, 1e4, 0.0))).expect("environment");
    let sky = builder.finish().0;
    same(&sky, &exported(&sky));
}

/// A float texture on a material keeps 8 bits of itself, its brightness, and says what it lost.
#[test]
fn float_textures_of_materials_are_told() {
    let mut builder = SceneBuilder::new(SceneLimits::default());
    let texels = Texels::Rgba32F(vec![[40.0, 20.0, 0.0, 1.0], [10.0, 0.0, 0.0, 1.0]]);
    builder.add_texture(id("glow"), Texture { width: 2, height: 1, texels }).expect("texture");
    let mut lamp = Material::emitter(Rgb::splat(0.5));
    lamp.textures[TextureSlot::Emission as usize] = Some(TextureRef::new(id("glow")));
    builder.set_material(id("lamp"), lamp).expect("material");
    let back = exported(&builder.finish().0);
    super::warns(&back, &["texture \"glow\"", "8 bits"]);
    assert_eq!(back.materials()["lamp"].emission, Rgb::splat(20.0));
    let texture = &back.textures()["glow"];
    let first = texture.texel(0, 0, lumicast_engine::scene::Encoding::Srgb);
    assert!((first - Vec4::new(1.0, 0.5, 0.0, 1.0)).abs().max_element() < 0.005, "{first}");
}

/// Real scenes come back.
#[test]
fn shared_scenes_come_back() {
    let Some(folder) = scenes_folder() else {
        println!("SKIPPED: no shared/scenes above this crate and no LUMICAST_SHARED");
        return;
    };
    for name in ["sponza", "modern-hall", "cornell-glass", "two-rooms"] {
        let scene = load_scene(&folder.join(format!("{name}.glb")), &AssetLimits::default()).expect(name);
        let bytes = export_glb(&scene).expect(name);
        println!("{name}: {} bytes", bytes.len());
        same(&scene, &load("test.glb", &bytes).expect(name));
    }
}
