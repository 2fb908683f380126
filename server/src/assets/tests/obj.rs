//! Wavefront OBJ and MTL.

use glam::{DVec3, Vec2, Vec3};
use lumicast_engine::{
    math::Rgb,
    scene::{Id, Material, TextureSlot},
};

use super::{OnDisk, glb::png, load, warns};

const BOX: &str = "mtllib box.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
o wall
usemtl red
f 1/1/1 2/2/1 3/3/1
usemtl lamp
f 1/1/1 3/3/1 -1/1/1
o floor
usemtl red
f 1 2 3 4
";

const MTL: &str = "newmtl red
Kd 0.5 0.25 0.125
map_Kd red.png
newmtl lamp
Kd 0
Ke 4 3 2
newmtl mirror
illum 3
Ks 0.9 0.8 0.7
newmtl glass
illum 7
Ni 1.25
Tf 1 1 1
";

/// Objects become meshes with nodes of their names; changes of material become runs; polygons become triangles.
#[test]
fn objects_become_meshes_with_runs_per_material() {
    let file = OnDisk::new("box.obj", BOX.as_bytes())
        .with("box.mtl", MTL.as_bytes())
        .with("red.png", &png(1, 1, &[[255; 4]]));
    let scene = file.load().expect("box");
    assert!(scene.warnings().is_empty(), "{:?}", scene.warnings());
    assert_eq!(scene.nodes().keys().map(Id::as_str).collect::<Vec<_>>(), ["wall", "floor"]);
    let wall = &scene.meshes()["wall"];
    let runs: Vec<_> =
        wall.primitives().iter().map(|run| (run.triangle_count, run.material.as_str())).collect();
    assert_eq!(runs, [(1, "red"), (1, "lamp")]);
    assert_eq!(wall.normals(), [Vec3::Z; 6]);
    // v = 0 is the bottom row in OBJ, the top row here.
    assert_eq!(wall.texcoords(0)[..3], [Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0)]);
    let floor = &scene.meshes()["floor"];
    assert_eq!((floor.triangles().len(), floor.normals().len(), floor.texcoords(0).len()), (2, 0, 0));
    assert_eq!(floor.bounds().max, DVec3::new(1.0, 1.0, 0.0));
}

/// The table in `obj/materials.rs` holds.
#[test]
fn materials_follow_the_table() {
    let file = OnDisk::new("box.obj", BOX.as_bytes())
        .with("box.mtl", MTL.as_bytes())
        .with("red.png", &png(1, 1, &[[255; 4]]));
    let scene = file.load().expect("box");
    let red = &scene.materials()["red"];
    assert!(red.texture(TextureSlot::BaseColor).is_some());
    assert_eq!(
        Material { textures: Default::default(), ..Material::clone(red) },
        Material::lambert(Rgb::new(0.5, 0.25, 0.125))
    );
    assert_eq!(*scene.materials()["lamp"], Material::emitter(Rgb::new(4.0, 3.0, 2.0)));
    let mirror = &scene.materials()["mirror"];
    assert_eq!((mirror.metallic, mirror.roughness, mirror.base_color), (1.0, 0.0, Rgb::new(0.9, 0.8, 0.7)));
    let glass = &scene.materials()["glass"];
    assert_eq!((glass.transmission, glass.roughness, glass.ior), (1.0, 0.0, 1.25));
}

/// What is missing is shown grey and told; what is hostile is refused.
#[test]
fn missing_libraries_are_grey_and_hostile_ones_refused() {
    let scene = load("box.obj", BOX.as_bytes()).expect("grey box");
    assert_eq!(scene.warnings().len(), 3, "{:?}", scene.warnings());
    assert_eq!(*scene.materials()["default"], Material::lambert(Rgb::splat(0.5)));
    let no_picture =
        OnDisk::new("box.obj", BOX.as_bytes()).with("box.mtl", MTL.as_bytes()).load().expect("no picture");
    warns(&no_picture, &["material \"red\"", "red.png", "shown without"]);
    for line in ["mtllib ../box.mtl", "mtllib /etc/passwd", "mtllib ..\\box.mtl", "mtllib C:\\box.mtl"] {
        let error = load("box.obj", line.as_bytes()).expect_err(line).to_string();
        assert!(error.contains("uri") && error.contains("box.obj"), "{error}");
    }
    let evil = MTL.replace("red.png", "../../../../etc/passwd");
    assert!(OnDisk::new("box.obj", BOX.as_bytes()).with("box.mtl", evil.as_bytes()).load().is_err());
}

/// Double precision survives from the text to the mesh's centre.
#[test]
fn surveyed_coordinates_keep_their_digits() {
    let text =
        "v 500000.123 4000000.456 7\nv 500001.123 4000000.456 7\nv 500000.123 4000001.456 7\nf 1 2 3\n";
    let scene = load("site.obj", text.as_bytes()).expect("site");
    assert!(
        (scene.meshes()["site"].bounds().min - DVec3::new(500_000.123, 4_000_000.456, 7.0)).length() < 1e-6
    );
}

/// Lines, odd indices and torn text end in a scene or an error; `tobj` is never let near what it panics on.
#[test]
fn hostile_text_does_no_harm() {
    let polyline = "v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\nf 1 2 3\n";
    let scene = load("a.obj", polyline.as_bytes()).expect("line");
    warns(&scene, &["1 points and lines"]);
    assert_eq!(scene.instanced_triangle_count(), 1);
    let head = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n";
    for face in [
        "f 1 2 9",
        "f 1 2 -9",
        "f 0 1 2",
        "f 1/9/9 2/9/9 3/9/9",
        "f 1/-9 2/-9 3/-9",
        "f",
        "f 1 2 x",
        "f 1/9223372036854775807 2 3",
        "f -9223372036854775808 1 2",
        "f 1/2/3/4 1 2",
        "v nan 0 0\nf 1 2 4",
        "v 1 2 3 0",
        "usemtl",
    ] {
        assert!(load("a.obj", format!("{head}{face}\n").as_bytes()).is_err(), "{face}");
    }
    for mtl in ["newmtl a\nKd\n", "newmtl a\nKd 1\n", "newmtl a\nKd 1 1\n", "newmtl a\nKs\nKe 1 1\nKa"] {
        let text = "mtllib a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
        assert!(OnDisk::new("a.obj", text.as_bytes()).with("a.mtl", mtl.as_bytes()).load().is_ok(), "{mtl}");
    }
    for mtl in [
        "newmtl a\nKd nan 0 0\n",
        "newmtl a\nKe inf 0 0\n",
        "newmtl a\nNs\n",
        "newmtl\n",
        "newmtl a\nillum 7\nNi nan\n",
    ] {
        let text = "mtllib a.mtl\n";
        assert!(OnDisk::new("a.obj", text.as_bytes()).with("a.mtl", mtl.as_bytes()).load().is_err(), "{mtl}");
    }
    let mut state = 7u64;
    let mut loaded = 0;
    for _ in 0..600 {
        let mut spoilt = BOX.as_bytes().to_vec();
        let mut materials = MTL.as_bytes().to_vec();
        for bytes in [&mut spoilt, &mut materials] {
            for _ in 0..3 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let at = (state >> 33) as usize % bytes.len();
                bytes[at] = b"0123456789-/ \nfvKdel."[(state >> 11) as usize % 21];
            }
        }
        let file = OnDisk::new("box.obj", &spoilt).with("box.mtl", &materials);
        loaded += u32::from(file.load().is_ok());
    }
    println!("600 spoilt OBJ files: {loaded} loaded");
    assert!(loaded > 0);
}
