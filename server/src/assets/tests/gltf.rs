//! Geometry, hierarchy, lights, cameras and addresses of glTF.

use glam::{DVec3, Vec3, Vec4};
use lumicast_engine::{
    math::Rgb,
    scene::{Id, LightKind, Mesh, Projection, Scene, SceneBuilder, SceneLimits},
};
use serde_json::json;

use super::{
    OnDisk,
    glb::{F32, Glb, I8, U8, U16, U32, bytes_of, data_uri},
    load, warns,
};
use crate::assets::{AssetLimits, GltfPlacement, load_gltf_bytes};

fn only_mesh(scene: &Scene) -> &Mesh {
    assert_eq!(scene.meshes().len(), 1);
    &scene.meshes()[0]
}

/// Absolute positions of each triangle's corners.
fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    let at = |vertex: u32| (mesh.centre() + mesh.positions()[vertex as usize].as_dvec3()).as_vec3();
    mesh.triangles().iter().map(|triangle| triangle.map(at)).collect()
}

fn id(name: &str) -> Id {
    Id::sanitised(name, "x")
}

/// Triangles do not depend on how wide their indices are, or on whether there are any.
#[test]
fn all_index_types_give_the_same_triangles() {
    let expected = corners(only_mesh(&Glb::square().scene()));
    assert_eq!(expected.len(), 2);
    let indices = [0u32, 1, 2, 0, 2, 3];
    let wide = |size: usize| -> Vec<u8> {
        indices.iter().flat_map(|index| index.to_le_bytes()[..size].to_vec()).collect()
    };
    for (component, size) in [(U8, 1), (U16, 2), (U32, 4)] {
        let mut glb = Glb::square();
        let accessor = glb.accessor(&wide(size), component, "SCALAR", 6);
        glb.root["meshes"][0]["primitives"][0]["indices"] = json!(accessor);
        assert_eq!(corners(only_mesh(&glb.scene())), expected);
    }
    let mut glb = Glb::square();
    let unrolled: Vec<[f32; 3]> = expected.iter().flatten().map(|corner| corner.to_array()).collect();
    let positions = glb.floats(&unrolled);
    glb.root["meshes"][0]["primitives"] = json!([{ "attributes": { "POSITION": positions } }]);
    assert_eq!(corners(only_mesh(&glb.scene())), expected);
}

/// Strips and fans turn the same way as lists: all normals of a flat shape agree.
#[test]
fn strips_and_fans_keep_their_orientation() {
    for (mode, order) in [(4, vec![0u8, 1, 2, 0, 2, 3]), (5, vec![0, 1, 3, 2]), (6, vec![0, 1, 2, 3])] {
        let mut glb = Glb::square();
        let indices = glb.accessor(&order, U8, "SCALAR", order.len());
        glb.root["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        glb.root["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let scene = glb.scene();
        let triangles = corners(only_mesh(&scene));
        assert_eq!(triangles.len(), 2, "mode {mode}");
        for [a, b, c] in triangles {
            assert_eq!((b - a).cross(c - a), Vec3::Z, "mode {mode}");
        }
        assert!(scene.warnings().is_empty());
    }
}

/// Points and lines have no surface: they are left out with a warning, and so are corners that make no triangle.
#[test]
fn points_lines_and_left_over_corners_are_left_out() {
    for mode in 0..4 {
        let mut glb = Glb::square();
        glb.root["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let scene = glb.scene();
        warns(&scene, &["square", "points or lines"]);
        assert_eq!((scene.meshes().len(), scene.nodes().len()), (0, 1));
    }
    let mut glb = Glb::square();
    glb.root["accessors"][1]["count"] = json!(5);
    let scene = glb.scene();
    warns(&scene, &["square", "last 2 of 5"]);
    assert_eq!(scene.instanced_triangle_count(), 1);
}

/// Integer attributes mean what glTF says: shares where normalised, numbers where not.
#[test]
fn integer_attributes_are_shares_or_numbers() {
    let mut glb = Glb::square();
    let texcoords: Vec<u8> = [[0u16, 65535], [65535, 0], [0, 0], [32768, 1]]
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let texcoords = glb.accessor(&texcoords, U16, "VEC2", 4);
    glb.root["accessors"][texcoords]["normalized"] = json!(true);
    glb.attribute("TEXCOORD_0", texcoords);
    let normals: Vec<u8> = [[0i8, 0, 127, 0]; 4].as_flattened().iter().map(|v| *v as u8).collect();
    let view = glb.view(&normals);
    glb.root["bufferViews"][view]["byteStride"] = json!(4);
    let count = glb.root["accessors"].as_array().expect("accessors").len();
    let accessors = glb.root["accessors"].as_array_mut().expect("accessors");
    accessors.push(
        json!({ "bufferView": view, "componentType": I8, "type": "VEC3", "count": 4, "normalized": true }),
    );
    glb.attribute("NORMAL", count);
    let positions: Vec<u8> = [[0u16, 0, 0], [3, 0, 0], [3, 2, 0], [0, 2, 0]]
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let positions = glb.accessor(&positions, U16, "VEC3", 4);
    glb.attribute("POSITION", positions);
    glb.root["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    glb.root["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let scene = glb.scene();
    let mesh = only_mesh(&scene);
    assert!(scene.warnings().is_empty());
    assert_eq!(mesh.normals(), [Vec3::Z; 4]);
    assert_eq!(mesh.bounds().max, DVec3::new(3.0, 2.0, 0.0));
    assert_eq!(mesh.texcoords(0)[0].to_array(), [0.0, 1.0]);
    assert!((mesh.texcoords(0)[3].x - 32768.0 / 65535.0).abs() < 1e-7);
}

/// Vertex colours are linear factors; three channels get an alpha of 1; outside [0, 1] they are clamped and told.
#[test]
fn vertex_colours_of_three_and_four_channels() {
    let mut glb = Glb::square();
    let colors = glb.floats(&[[0.25, 0.5, 1.0]; 4]);
    glb.attribute("COLOR_0", colors);
    assert_eq!(only_mesh(&glb.scene()).colors(), [Vec4::new(0.25, 0.5, 1.0, 1.0); 4]);
    let colors = glb.accessor(&[255, 0, 51, 102].repeat(4), U8, "VEC4", 4);
    glb.root["accessors"][colors]["normalized"] = json!(true);
    glb.attribute("COLOR_0", colors);
    assert_eq!(only_mesh(&glb.scene()).colors(), [Vec4::new(1.0, 0.0, 0.2, 0.4); 4]);
    let colors = glb.floats(&[[2.0, 0.5, -1.0]; 4]);
    glb.attribute("COLOR_0", colors);
    let scene = glb.scene();
    assert_eq!(only_mesh(&scene).colors(), [Vec4::new(1.0, 0.5, 0.0, 1.0); 4]);
    warns(&scene, &["4 vertex colours", "clamped"]);
    let colors = glb.floats(&[[f32::NAN, 0.5, 0.0]; 4]);
    glb.attribute("COLOR_0", colors);
    glb.refused(&["square", "colors", "NaN"]);
}

/// Sparse accessors replace elements of a view, or of zeros where there is no view.
#[test]
fn sparse_accessors_replace_elements() {
    let mut glb = Glb::square();
    let places = glb.view(&[2, 0]);
    let values = glb.view(&bytes_of(&[[5.0, 1.0, 0.0]]));
    let sparse = json!({
        "count": 1,
        "indices": { "bufferView": places, "componentType": U16 },
        "values": { "bufferView": values },
    });
    glb.root["accessors"][0]["sparse"] = sparse;
    assert_eq!(only_mesh(&glb.scene()).bounds().max, DVec3::new(5.0, 1.0, 0.0));

    let places = glb.view(&[1, 2]);
    let values = glb.view(&bytes_of(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]));
    glb.root["accessors"][0] = json!({
        "componentType": F32, "type": "VEC3", "count": 4,
        "sparse": {
            "count": 2,
            "indices": { "bufferView": places, "componentType": U8 },
            "values": { "bufferView": values },
        },
    });
    let scene = glb.scene();
    assert_eq!(corners(only_mesh(&scene)), [[Vec3::ZERO, Vec3::X, Vec3::Y]]);
    warns(&scene, &["1 of 2 triangles have no area"]);
}

/// Interleaved attributes are read at their stride, the last element to its own end.
#[test]
fn interleaved_attributes_are_read_at_their_stride() {
    let mut glb = Glb::square();
    let rows =
        [[0.0, 0.0, 0.0, 9.0, 0.0, 0.5], [2.0, 0.0, 0.0, 9.0, 1.0, 0.5], [0.0, 2.0, 0.0, 9.0, 0.0, 1.5]];
    let mut bytes = bytes_of(&rows);
    let view = glb.view(&bytes);
    glb.root["bufferViews"][view]["byteStride"] = json!(24);
    glb.root["accessors"][0] =
        json!({ "bufferView": view, "componentType": F32, "type": "VEC3", "count": 3 });
    glb.root["accessors"][1] =
        json!({ "bufferView": view, "byteOffset": 16, "componentType": F32, "type": "VEC2", "count": 3 });
    glb.root["meshes"][0]["primitives"] = json!([{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 } }]);
    let scene = glb.scene();
    assert_eq!(corners(only_mesh(&scene)), [[Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 2.0]]);
    assert_eq!(only_mesh(&scene).texcoords(0)[2].to_array(), [0.0, 1.5]);
    bytes.clear();
    glb.root["accessors"][1]["byteOffset"] = json!(20);
    glb.refused(&["accessor 1", "count", "do not fit"]);
}

/// Primitives that share their attributes share vertices; one that lacks normals gets zeros, which stand for flat.
#[test]
fn primitives_become_runs_of_one_mesh() {
    let mut glb = Glb::square();
    let normals = glb.floats(&[[0.0, 0.0, 1.0]; 4]);
    let half = |glb: &mut Glb, order: [u8; 3]| glb.accessor(&order, U8, "SCALAR", 3);
    let (first, second) = (half(&mut glb, [0, 1, 2]), half(&mut glb, [0, 2, 3]));
    glb.root["materials"] = json!([{ "name": "a" }, { "name": "b" }]);
    glb.root["meshes"][0]["primitives"] = json!([
        { "attributes": { "POSITION": 0, "NORMAL": normals }, "indices": first, "material": 1 },
        { "attributes": { "POSITION": 0, "NORMAL": normals }, "indices": second, "material": 0 },
        { "attributes": { "POSITION": 0 }, "indices": second, "material": 0 },
    ]);
    let scene = glb.scene();
    let mesh = only_mesh(&scene);
    let runs: Vec<_> =
        mesh.primitives().iter().map(|run| (run.first_triangle, run.material.as_str())).collect();
    assert_eq!(runs, [(0, "b"), (1, "a"), (2, "a")]);
    assert_eq!(mesh.triangles(), [[0, 1, 2], [0, 2, 3], [4, 6, 7]]);
    assert_eq!(mesh.normals(), [[Vec3::Z; 4], [Vec3::ZERO; 4]].as_flattened());
    assert_eq!(scene.warnings(), []);
}

/// Normals of no length in the file itself are told, with the mesh that has them.
#[test]
fn zero_normals_of_the_file_are_told() {
    let mut glb = Glb::square();
    let normals = glb.floats(&[[0.0, 0.0, 1.0], [0.0; 3], [0.0; 3], [0.0, 0.0, 1.0]]);
    glb.attribute("NORMAL", normals);
    super::warns(&glb.scene(), &["mesh", "2 normals of zero length"]);
}

/// A mesh without normals stays without, and one without material gets glTF's: a rough white metal.
#[test]
fn what_the_file_leaves_out_gets_gltfs_meaning() {
    let scene = Glb::square().scene();
    assert!(only_mesh(&scene).normals().is_empty());
    let material = &scene.materials()[&id("default")];
    assert_eq!((material.metallic, material.roughness, material.base_color), (1.0, 1.0, Rgb::WHITE));
    assert!(scene.warnings().is_empty());
}

/// Matrices and TRS say the same, chains multiply, and doubles stay doubles.
#[test]
fn transforms_compose_in_double_precision() {
    let mut glb = Glb::square();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    glb.root["nodes"] = json!([
        { "name": "root", "translation": [1e6, 0.125, 1e-3], "children": [1, 2] },
        { "name": "trs", "translation": [1.0, 2.0, 3.0], "rotation": [0.0, half, 0.0, half], "scale": [2.0, 3.0, 4.0], "mesh": 0 },
        { "name": "matrix", "matrix": [0, 0, -2, 0, 0, 3, 0, 0, 4, 0, 0, 0, 1, 2, 3, 1], "mesh": 0 },
    ]);
    let scene = glb.scene();
    let [trs, matrix] = ["trs", "matrix"].map(|name| scene.world_from_node(Some(&id(name))));
    let difference = trs
        .to_cols_array()
        .iter()
        .zip(matrix.to_cols_array())
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(difference < 1e-12, "{difference}");
    assert_eq!(trs.translation, DVec3::new(1_000_001.0, 2.125, 3.001));
    assert_eq!((scene.meshes().len(), scene.instanced_triangle_count()), (1, 4));
}

/// A node without extent is left out with all below it; its brothers stay.
#[test]
fn flattened_nodes_are_left_out_with_a_warning() {
    for flat in [
        json!({ "scale": [0.0, 0.0, 0.0] }),
        json!({ "scale": [1.0, 0.0, 1.0] }),
        json!({ "matrix": vec![0; 16] }),
    ] {
        let mut glb = Glb::square();
        let mut flat = flat;
        flat["name"] = json!("flat");
        flat["children"] = json!([1]);
        if let Some(matrix) = flat.get_mut("matrix") {
            matrix[15] = json!(1);
        }
        glb.root["nodes"] = json!([flat, { "mesh": 0 }, { "name": "good", "mesh": 0 }]);
        glb.root["scenes"][0]["nodes"] = json!([0, 2]);
        let scene = glb.scene();
        warns(&scene, &["node \"flat\"", "flattened"]);
        assert_eq!(scene.nodes().keys().map(Id::as_str).collect::<Vec<_>>(), ["good"]);
    }
}

/// The default scene is read, the others are not; without scenes all roots are.
#[test]
fn the_default_scene_is_read() {
    let mut glb = Glb::square();
    glb.root["nodes"] =
        json!([{ "name": "a", "mesh": 0 }, { "name": "b", "children": [2] }, { "name": "c" }]);
    glb.root["scenes"] = json!([{ "nodes": [0] }, { "nodes": [1] }]);
    let names = |glb: &Glb| glb.scene().nodes().keys().map(ToString::to_string).collect::<Vec<_>>();
    assert_eq!(names(&glb), ["a"]);
    glb.root["scene"] = json!(1);
    assert_eq!(names(&glb), ["b", "c"]);
    glb.root["scene"] = json!(2);
    glb.refused(&["scene", "is 2"]);
    glb.root.as_object_mut().expect("object").retain(|key, _| key != "scene" && key != "scenes");
    assert_eq!(names(&glb), ["a", "b", "c"]);
}

/// Each use of a light is one engine light on its node, along −Z, in W/sr or W/m² without a constant.
#[test]
fn lights_hang_on_their_nodes() {
    let mut glb = Glb::new();
    let light = |index: usize| json!({ "KHR_lights_punctual": { "light": index } });
    glb.root["nodes"] = json!([
        { "name": "up", "rotation": [1.0, 0.0, 0.0, 0.0], "extensions": light(0) },
        { "name": "lamp 1", "translation": [0.0, 2.0, 0.0], "extensions": light(1) },
        { "name": "lamp 2", "extensions": light(1) },
        { "name": "beam", "extensions": light(2) },
    ]);
    glb.root["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    glb.root["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "name": "sun", "type": "directional", "color": [1.0, 0.5, 0.25], "intensity": 8.0 },
        { "name": "bulb", "type": "point", "intensity": 3.0, "range": 5.0 },
        { "type": "spot", "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } },
    ]}});
    let scene = glb.scene();
    assert_eq!(scene.lights().keys().map(Id::as_str).collect::<Vec<_>>(), ["sun", "bulb", "bulb #2", "beam"]);
    let kinds: Vec<_> = scene.lights().values().map(|light| light.kind).collect();
    assert_eq!(kinds[0], LightKind::Directional { irradiance: Rgb::new(8.0, 4.0, 2.0) });
    assert_eq!(kinds[2], LightKind::Point { intensity: Rgb::splat(3.0) });
    let beam = LightKind::Spot { intensity: Rgb::WHITE, inner_angle_rad: 0.25, outer_angle_rad: 0.5 };
    assert_eq!(kinds[3], beam);
    let sun = &scene.lights()[0];
    let direction = scene.world_from_node(sun.parent.as_ref()).transform_vector3(sun.direction);
    assert!((direction - DVec3::Z).length() < 1e-12);
    assert_eq!(scene.lights()[1].parent, Some(id("lamp 1")));
    assert_eq!(scene.warnings().len(), 2, "{:?}", scene.warnings());

    glb.root["extensions"]["KHR_lights_punctual"]["lights"][2]["spot"] =
        json!({ "innerConeAngle": 0.5, "outerConeAngle": 0.5 });
    let LightKind::Spot { inner_angle_rad, outer_angle_rad, .. } = glb.scene().lights()[3].kind else {
        panic!("no spot")
    };
    assert!(inner_angle_rad < outer_angle_rad && inner_angle_rad > 0.499_999);
    glb.root["nodes"][3]["extensions"] = light(7);
    glb.refused(&["node 3 \"beam\"", "KHR_lights_punctual.light", "is 7"]);
}

/// Cameras are called by their node, then by themselves, and keep their numbers.
#[test]
fn cameras_take_their_nodes_names() {
    let mut glb = Glb::new();
    glb.root["cameras"] = json!([
        { "name": "lens", "type": "perspective", "perspective": { "yfov": 0.7, "aspectRatio": 1.5, "znear": 0.1 } },
        { "type": "orthographic", "orthographic": { "xmag": 4.0, "ymag": 2.0, "znear": 0.0, "zfar": 9.0 } },
    ]);
    glb.root["nodes"] =
        json!([{ "name": "main", "camera": 0 }, { "camera": 0 }, { "name": "main", "camera": 1 }]);
    let scene = glb.scene();
    assert_eq!(scene.cameras().keys().map(Id::as_str).collect::<Vec<_>>(), ["main", "lens", "main #2"]);
    let camera = &scene.cameras()[0];
    assert_eq!((camera.projection, camera.aspect), (Projection::Perspective { yfov_rad: 0.7 }, Some(1.5)));
    assert_eq!(camera.parent, Some(id("main")));
    let camera = &scene.cameras()[2];
    assert_eq!(
        (camera.projection, camera.aspect),
        (Projection::Orthographic { half_height_m: 2.0 }, Some(2.0))
    );
    assert_eq!(camera.parent, Some(id("main #2")));
    glb.root["cameras"][0]["perspective"]["yfov"] = json!(0.0);
    glb.refused(&["main", "yfov", "0"]);
}

/// An optional extension that is not read is told; a required one refuses the file and is named.
#[test]
fn unread_extensions_are_told_or_refused() {
    let mut glb = Glb::square();
    glb.root["extensionsUsed"] = json!(["EXT_of_tomorrow", "KHR_materials_ior"]);
    warns(&glb.scene(), &["EXT_of_tomorrow", "not read"]);
    glb.root["extensionsRequired"] = json!(["EXT_of_tomorrow"]);
    glb.refused(&["extensionsRequired", "EXT_of_tomorrow"]);
}

/// Buffers come as data URIs of either encoding or as files beside the scene, with the same result.
#[test]
fn buffers_come_from_data_uris_and_files() {
    let glb = Glb::square();
    let expected = corners(only_mesh(&glb.scene()));
    let percent: String = glb.bin.iter().map(|byte| format!("%{byte:02x}")).collect();
    for uri in
        [data_uri(&glb.bin), format!("data:,{percent}"), data_uri(&glb.bin).trim_end_matches('=').to_string()]
    {
        let scene = load("test.gltf", &glb.gltf(&uri)).expect("a data URI");
        assert_eq!(corners(only_mesh(&scene)), expected);
    }
    let beside = OnDisk::new("test.gltf", &glb.gltf("my%20data.bin")).with("my data.bin", &glb.bin);
    assert_eq!(corners(only_mesh(&beside.load().expect("a file beside"))), expected);
    let missing = OnDisk::new("test.gltf", &glb.gltf("gone.bin")).load().expect_err("missing").to_string();
    assert!(["test.gltf", "buffer 0", "gone.bin"].iter().all(|part| missing.contains(part)), "{missing}");
    let cut = OnDisk::new("test.gltf", &glb.gltf("cut.bin")).with("cut.bin", &glb.bin[1..]).load();
    assert!(cut.expect_err("cut off").to_string().contains("byteLength"));
}

/// Into an existing scene: under the given node, with the given prefix, and beside objects of the same names.
#[test]
fn a_file_joins_a_scene_under_names_of_its_own() {
    let mut glb = Glb::square();
    glb.root["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } }]);
    glb.root["nodes"][0]["camera"] = json!(0);
    let scene = Glb::square().scene();
    let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
    let limits = AssetLimits::default();
    let at_home = GltfPlacement { parent: Some(id("here")), prefix: None };
    load_gltf_bytes(&glb.bytes(), &mut builder, at_home, &limits).expect("first");
    let prefixed = GltfPlacement { parent: None, prefix: Some("b/".into()) };
    load_gltf_bytes(&glb.gltf(&data_uri(&glb.bin)), &mut builder, prefixed, &limits).expect("second");
    let names = |keys: Vec<&Id>| keys.into_iter().map(ToString::to_string).collect::<Vec<_>>();
    let (joined, change) = builder.finish();
    assert_eq!(names(joined.nodes().keys().collect()), ["here", "here #2", "b/here"]);
    assert_eq!(names(joined.meshes().keys().collect()), ["square", "square #2", "b/square"]);
    assert_eq!(names(joined.materials().keys().collect()), ["default", "default #2", "b/default"]);
    assert_eq!(names(joined.cameras().keys().collect()), ["here", "b/here"]);
    assert_eq!(joined.nodes()[1].parent, Some(id("here")));
    assert_eq!(change.nodes.len(), 2);

    let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
    let nowhere = GltfPlacement { parent: Some(id("nowhere")), prefix: None };
    let error = load_gltf_bytes(&glb.bytes(), &mut builder, nowhere, &limits).expect_err("no such parent");
    assert_eq!(error.field(), Some("parent"));
    let beside = glb.gltf("data.bin");
    let error =
        load_gltf_bytes(&beside, &mut builder, GltfPlacement::default(), &limits).expect_err("no folder");
    assert!(error.to_string().contains("without a folder"), "{error}");
}

/// Equal and missing names become different ids in linear time.
#[test]
fn thirty_thousand_equal_names_become_different_ids() {
    let mut glb = Glb::new();
    let count = 30_000;
    glb.root["nodes"] = (0..count).map(|_| json!({ "name": "twin" })).collect();
    glb.root["scenes"] = json!([{ "nodes": (0..count).collect::<Vec<_>>() }]);
    let scene = glb.scene();
    assert_eq!(scene.nodes().len(), count);
    assert!(scene.nodes().contains_key("twin") && scene.nodes().contains_key("twin #30000"));
}
