//! Whatever bytes come in, out comes a valid scene or an error: no panic, no hang, no memory by the file's word.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use lumicast_engine::scene::{SceneBuilder, SceneLimits};
use serde_json::{Value, json};

use super::{
    OnDisk,
    glb::{F32, Glb, U8, U32, data_uri, png, with_json},
    load,
};
use crate::assets::{AssetLimits, GltfPlacement, load_gltf_bytes, load_scene};

/// Small bounds, so that a claim that slips through shows as time or memory.
fn tight() -> AssetLimits {
    let scene = SceneLimits {
        vertices_max: 10_000,
        triangles_max: 10_000,
        texels_max: 100_000,
        ..SceneLimits::default()
    };
    AssetLimits {
        file_bytes_max: 1 << 20,
        buffers_bytes_max: 1 << 20,
        json_bytes_max: 1 << 20,
        json_values_max: 100_000,
        image_pixels_max: 65_536,
        accessor_elements_max: 30_000,
        scene,
    }
}

/// Loads bytes as they would come over the network; only the absence of a panic counts.
fn survive(bytes: &[u8]) -> bool {
    let limits = tight();
    let mut builder = SceneBuilder::new(limits.scene);
    load_gltf_bytes(bytes, &mut builder, GltfPlacement::default(), &limits).is_ok()
}

/// A file that holds some of everything.
fn rich() -> Glb {
    let mut glb = Glb::textured(&png(2, 1, &[[9, 8, 7, 255], [1, 2, 3, 4]]));
    let normals = glb.floats(&[[0.0, 0.0, 1.0]; 4]);
    let colors = glb.accessor(&[200; 16], U8, "VEC4", 4);
    glb.root["accessors"][colors]["normalized"] = json!(true);
    glb.attribute("NORMAL", normals);
    glb.attribute("COLOR_0", colors);
    let places = glb.view(&[2]);
    let values = glb.view(&[0; 12]);
    glb.root["accessors"][normals]["sparse"] = json!({
        "count": 1, "indices": { "bufferView": places, "componentType": U8 }, "values": { "bufferView": values },
    });
    glb.root["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } }]);
    glb.root["extensions"] = json!({ "KHR_lights_punctual": { "lights": [{ "type": "spot", "spot": {} }] } });
    glb.root["materials"][0]["extensions"] = json!({
        "KHR_materials_transmission": { "transmissionFactor": 1.0 }, "KHR_materials_ior": { "ior": 1.3 },
    });
    glb.root["nodes"] = json!([
        { "mesh": 0, "children": [1, 2], "rotation": [0, 0, 0, 1] },
        { "camera": 0, "translation": [1, 2, 3] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
    ]);
    glb
}

fn samples() -> Vec<Vec<u8>> {
    let rich = rich();
    vec![
        Glb::square().bytes(),
        rich.bytes(),
        rich.gltf(&data_uri(&rich.bin)),
        Glb::square().gltf(&data_uri(&Glb::square().bin)),
    ]
}

/// A generator of our own, so that a failure comes back (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}

/// The samples are good before they are spoilt.
#[test]
fn samples_load() {
    assert!(samples().iter().all(|bytes| survive(bytes)));
}

/// A file cut anywhere is refused, not read beyond its end.
#[test]
fn cut_files_are_refused() {
    for bytes in samples() {
        for length in (0..bytes.len()).step_by(97).chain(bytes.len().saturating_sub(9)..bytes.len()) {
            assert!(!survive(&bytes[..length]), "cut to {length} of {} bytes", bytes.len());
        }
    }
    let Some(folder) = super::shared::scenes_folder() else {
        println!("SKIPPED: shared scenes, there are none");
        return;
    };
    let bytes = std::fs::read(folder.join("cornell-box.glb")).expect("cornell-box");
    assert!((0..bytes.len()).step_by(97).all(|length| !survive(&bytes[..length])));
}

/// Changed bytes end in an error or in a scene.
#[test]
fn flipped_bytes_do_no_harm() {
    let mut random = Random(1);
    let start = Instant::now();
    let (mut loaded, mut refused) = (0, 0);
    for bytes in samples() {
        for _ in 0..1500 {
            let mut spoilt = bytes.clone();
            for _ in 0..1 + random.below(4) {
                let at = random.below(spoilt.len());
                spoilt[at] = match random.below(3) {
                    0 => random.next() as u8,
                    1 => spoilt[at] ^ 1 << random.below(8),
                    // Digits and brackets keep JSON readable more often.
                    _ => b"0123456789[]{},\"-.e"[random.below(19)],
                };
            }
            if survive(&spoilt) { loaded += 1 } else { refused += 1 }
        }
    }
    println!("6000 spoilt files: {loaded} loaded, {refused} refused in {:?}", start.elapsed());
    assert!(loaded > 0 && refused > 0);
}

/// Every number of a file's JSON, replaced by what a hostile author would write, ends in an error or a scene.
#[test]
fn hostile_numbers_do_no_harm() {
    fn paths(value: &Value, path: &mut Vec<String>, found: &mut Vec<String>) {
        match value {
            Value::Object(map) => map.iter().for_each(|(key, value)| {
                path.push(key.clone());
                paths(value, path, found);
                path.pop();
            }),
            Value::Array(list) => list.iter().enumerate().for_each(|(index, value)| {
                path.push(index.to_string());
                paths(value, path, found);
                path.pop();
            }),
            _ => found.push(format!("/{}", path.join("/"))),
        }
    }
    let values = [
        json!(-1),
        json!(0),
        json!(1),
        json!(255),
        json!(65_536),
        json!(u32::MAX),
        json!(u64::from(u32::MAX) + 1),
        json!(u64::MAX),
        json!(i64::MIN),
        json!(1e38),
        json!(-1e300),
        json!(1e-300),
        json!(0.5),
        json!(null),
        json!(""),
        json!("data:,"),
        json!("../x"),
        json!([]),
        json!({}),
        json!(true),
        json!([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
    ];
    let glb = rich();
    let mut root = glb.root.clone();
    root["buffers"] = json!([{ "byteLength": glb.bin.len() }]);
    let mut found = Vec::new();
    paths(&root, &mut Vec::new(), &mut found);
    let mut loaded = 0;
    for path in &found {
        for value in &values {
            let mut root = root.clone();
            *root.pointer_mut(path).expect(path) = value.clone();
            loaded += u32::from(survive(&with_json(&serde_json::to_vec(&root).expect("JSON"), &glb.bin)));
        }
    }
    println!("{} numbers × {} values: {loaded} loaded", found.len(), values.len());
    assert!(loaded > 100);
}

/// A count is believed only as far as bytes and limits go.
#[test]
fn huge_counts_are_refused_before_memory_is_taken() {
    let start = Instant::now();
    for count in [5u64, 1 << 31, u64::from(u32::MAX), u64::MAX / 12, u64::MAX] {
        let mut glb = Glb::square();
        glb.root["accessors"][0]["count"] = json!(count);
        glb.refused(&["accessor 0"]);
        let mut glb = Glb::square();
        glb.root["accessors"][1]["count"] = json!(count.saturating_mul(2));
        glb.refused(&["accessor 1"]);
        let mut glb = Glb::square();
        glb.root["bufferViews"][0]["byteLength"] = json!(count.saturating_mul(1000));
        glb.refused(&["bufferView 0"]);
        let mut glb = Glb::square();
        glb.root["accessors"][0]["byteOffset"] = json!(count);
        glb.refused(&["accessor 0"]);
    }
    // Zeros need no bytes, so only the limits stand in their way.
    let mut glb = Glb::square();
    let sparse = json!({ "count": 0, "indices": { "bufferView": 0, "componentType": U8 }, "values": { "bufferView": 0 } });
    glb.root["accessors"][0] =
        json!({ "componentType": F32, "type": "VEC3", "count": 50_000_000, "sparse": sparse });
    glb.refused(&["mesh 0 \"square\"", "50000000 vertices", "scene_vertices"]);
    glb.root["accessors"][0]["count"] = json!(5_000_000_000u64);
    glb.refused(&["accessor 0", "accessor_elements"]);
    assert!(start.elapsed() < Duration::from_secs(5));
}

/// Indices that lead nowhere are named with who uses them.
#[test]
fn indices_out_of_range_are_named() {
    let broken = |path: &str, value: Value, parts: &[&str]| {
        let mut glb = rich();
        *glb.root.pointer_mut(path).expect(path) = value;
        glb.refused(parts);
    };
    broken(
        "/meshes/0/primitives/0/attributes/POSITION",
        json!(99),
        &["mesh 0 \"square\"", "POSITION", "is 99"],
    );
    broken("/meshes/0/primitives/0/indices", json!(99), &["mesh 0 \"square\"", "indices", "is 99"]);
    broken("/meshes/0/primitives/0/material", json!(99), &["mesh 0 \"square\"", "material", "is 99"]);
    broken("/nodes/0/mesh", json!(99), &["node 0", "mesh", "is 99"]);
    broken("/nodes/1/camera", json!(99), &["node 1", "camera", "is 99"]);
    broken("/nodes/0/children/0", json!(99), &["node \"node 0\"", "children", "is 99"]);
    broken("/accessors/0/bufferView", json!(99), &["accessor 0", "bufferView", "is 99"]);
    broken("/bufferViews/0/buffer", json!(99), &["bufferView 0", "buffer", "is 99"]);
    broken("/textures/0/source", json!(99), &["texture 0", "source", "is 99"]);
    broken("/scenes/0/nodes/0", json!(99), &["scene", "is 99"]);
    let mut glb = Glb::square();
    let indices = glb.accessor(&[0, 1, 4, 0, 2, 3], U8, "SCALAR", 6);
    glb.root["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    glb.refused(&["accessor 2", "vertex 4 at place 2", "has 4"]);
    let wide: Vec<u8> = [0u32, 1, u32::MAX].iter().flat_map(|index| index.to_le_bytes()).collect();
    let indices = glb.accessor(&wide, U32, "SCALAR", 3);
    glb.root["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    glb.refused(&["vertex 4294967295"]);
}

/// Positions, normals and the rest must be numbers.
#[test]
fn numbers_that_are_none_are_refused() {
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30] {
        let mut glb = Glb::square();
        let positions = glb.floats(&[[0.0, value, 0.0]; 4]);
        glb.attribute("POSITION", positions);
        glb.refused(&["mesh \"square\"", "positions", "vertex 0"]);
    }
    let mut glb = Glb::square();
    let texcoords = glb.floats(&[[0.0, f32::NAN]; 4]);
    glb.attribute("TEXCOORD_0", texcoords);
    glb.refused(&["texcoords", "NaN"]);
    let mut glb = Glb::square();
    glb.root["nodes"][0]["translation"] = json!([1e300, 0, 0]);
    glb.refused(&["node \"here\"", "transform"]);
    glb.root["nodes"][0] =
        json!({ "mesh": 0, "scale": [1e308, 1e308, 1e308], "rotation": [1e308, 1e308, 0, 1] });
    assert!(glb.scene().nodes().is_empty());
}

/// Node graphs must be trees.
#[test]
fn nodes_in_circles_and_with_two_parents_are_refused() {
    for nodes in [
        json!([{ "children": [0] }]),
        json!([{ "children": [1] }, { "children": [0] }]),
        json!([{ "children": [1, 2] }, { "children": [3] }, { "children": [3] }, {}]),
        json!([{ "children": [1, 1] }, {}]),
    ] {
        let mut glb = Glb::new();
        glb.root["nodes"] = nodes;
        glb.root["scenes"] = json!([{ "nodes": [0] }]);
        glb.refused(&["children", "one parent"]);
    }
    let mut glb = Glb::new();
    glb.root["nodes"] = json!([{}]);
    glb.root["scenes"] = json!([{ "nodes": [0, 0] }]);
    glb.refused(&["one parent"]);
}

/// A hierarchy of any depth ends at the limit, not at the end of the stack.
#[test]
fn deep_hierarchies_end_at_the_limit() {
    let mut glb = Glb::new();
    let count = 100_000;
    glb.root["nodes"] = (1..=count)
        .map(|child| if child < count { json!({ "children": [child] }) } else { json!({}) })
        .collect();
    glb.root["scenes"] = json!([{ "nodes": [0] }]);
    glb.refused(&["levels of nodes", "64"]);
    let brackets = |open: &str| {
        [br#"{"asset":{"version":"2.0"},"extras":"#.as_slice(), open.repeat(100_000).as_bytes()].concat()
    };
    assert!(!survive(&brackets("[")) && !survive(&brackets("{\"a\":")));
}

/// Too many nodes, values, bytes: each ends at its own limit.
#[test]
fn sizes_end_at_their_limits() {
    let many = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{}{{}}]}}"#, "{},".repeat(3_000_000));
    let error = load("test.gltf", many.as_bytes()).expect_err("too many values").to_string();
    assert!(error.contains("file_json_values"), "{error}");
    // Below that bound, but of what takes the most memory.
    for (list, setting) in [("nodes", "scene_nodes"), ("materials", "scene_objects")] {
        let many = format!(r#"{{"asset":{{"version":"2.0"}},"{list}":[{}{{}}]}}"#, "{},".repeat(1_500_000));
        let error = load("test.gltf", many.as_bytes()).expect_err(list).to_string();
        assert!(error.contains(setting), "{error}");
    }
    let glb = Glb::square();
    let refused = |limits: AssetLimits, setting: &str| {
        let file = OnDisk::new("test.gltf", &glb.gltf(&data_uri(&glb.bin)));
        let error = load_scene(&file.path, &limits).expect_err(setting).to_string();
        assert!(error.contains(setting) && error.contains("test.gltf"), "{error}");
    };
    let roomy = AssetLimits::default();
    refused(AssetLimits { file_bytes_max: 50, ..roomy }, "file_bytes");
    refused(AssetLimits { json_bytes_max: 50, ..roomy }, "file_json_bytes");
    refused(AssetLimits { buffers_bytes_max: 40, ..roomy }, "file_side_bytes");
    refused(AssetLimits { accessor_elements_max: 3, ..roomy }, "accessor_elements");
    refused(
        AssetLimits { scene: SceneLimits { triangles_max: 1, ..roomy.scene }, ..roomy },
        "scene_triangles",
    );
}

/// A picture's size is believed from its header only to refuse it.
#[test]
fn giant_pictures_are_refused_by_their_header() {
    let mut giant = png(1, 1, &[[0; 4]]);
    // Width and height of IHDR, then its checksum.
    giant[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
    let checksum = crc(&giant[12..29]);
    giant[29..33].copy_from_slice(&checksum.to_be_bytes());
    Glb::textured(&giant).refused(&["image 0 \"picture\"", "4294967296 texels", "image_texels"]);
    let mut limits = AssetLimits::default();
    limits.scene.texels_max = 3;
    let file = OnDisk::new("test.glb", &Glb::textured(&png(2, 2, &[[0; 4]; 4])).bytes());
    let error = load_scene(&file.path, &limits).expect_err("texels").to_string();
    assert!(error.contains("scene_texels"), "{error}");
}

/// CRC-32 of PNG, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 },
        )
    })
}

/// No address leads out of the scene's folder.
#[test]
fn addresses_stay_in_the_scenes_folder() {
    let glb = Glb::square();
    let outside = OnDisk::new("secret.bin", &glb.bin);
    let secret = outside.path.display().to_string();
    let relative =
        format!("../{}/secret.bin", outside.folder.path().file_name().expect("name").to_string_lossy());
    let uris = [
        relative.as_str(),
        secret.as_str(),
        &secret.replace('/', "%2F"),
        &relative.replace("..", "%2e%2E"),
        "file:///etc/passwd",
        "http://localhost/x",
        "C:/x",
        "C:\\x",
        "\\\\host\\x",
        "a/../../x",
        "a\\..\\..\\x",
        "",
        "x\u{0}",
    ];
    for uri in uris {
        let error = load("test.gltf", &glb.gltf(uri)).expect_err(uri).to_string();
        assert!(error.contains("buffer 0: uri") && error.contains("test.gltf"), "{uri:?}: {error}");
        assert!(!error.contains("cannot be read"), "{uri:?} was looked for: {error}");
    }
    // A folder and a file that never ends are no files.
    for uri in [".", "./"] {
        assert!(load("test.gltf", &glb.gltf(uri)).is_err());
    }
    assert!(load_scene(Path::new("/dev/zero"), &AssetLimits::default()).is_err());
}

/// A link that leads out is refused; one that stays inside is followed.
#[cfg(unix)]
#[test]
fn links_out_of_the_folder_are_refused() {
    let glb = Glb::square();
    let outside = OnDisk::new("secret.bin", &glb.bin);
    let file = OnDisk::new("test.gltf", &glb.gltf("link.bin")).with("inside.bin", &glb.bin);
    let link = file.folder.path().join("link.bin");
    std::os::unix::fs::symlink(&outside.path, &link).expect("link");
    let error = file.load().expect_err("link out").to_string();
    assert!(error.contains("link.bin") && error.contains("leads out"), "{error}");
    std::fs::remove_file(&link).expect("remove");
    std::os::unix::fs::symlink("inside.bin", &link).expect("link");
    assert!(file.load().is_ok());
}

/// Things that are no scenes are refused as such.
#[test]
fn other_files_are_refused() {
    for (name, bytes) in
        [("a.txt", b"hello".as_slice()), ("b.glb", b""), ("c.png", b"\x89PNG"), ("d", b"\xff\xfe")]
    {
        let error = load(name, bytes).expect_err(name).to_string();
        assert!(error.contains("not a scene file") && error.contains(name), "{error}");
    }
    for json in [
        "{}",
        "{",
        "{\"asset\":{\"version\":\"1.0\"}}",
        "{\"asset\":{\"version\":\"2.1\",\"minVersion\":\"2.1\"}}",
    ] {
        assert!(load("e.gltf", json.as_bytes()).is_err(), "{json}");
    }
    assert!(load_scene(Path::new("/nowhere/x.glb"), &AssetLimits::default()).is_err());
    assert!(load("marked.gltf", b"\xEF\xBB\xBF {\"asset\":{\"version\":\"2.0\"}}").is_ok());
}
