//! What rays are shot at: two scenes of the shared folder and a large one of our own making.

use glam::{DAffine3, DVec3};
use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::scene::{
    CameraView, Material, MeshSource, Primitive, Scene, SceneError,
    samples::{Stage, cuboid, sphere},
};

/// What can be asked for by name.
pub(crate) const NAMES: [&str; 3] = ["sponza", "dragon", "boulder"];

/// A scene to shoot rays at.
pub(crate) struct Subject {
    pub(crate) name: &'static str,
    /// All triangles as one mesh in the world, so that one Embree geometry and one tree of ours hold the same.
    pub(crate) flat: Scene,
    /// The scene as it came, to see what instances cost.
    pub(crate) instanced: Option<Scene>,
    pub(crate) view: CameraView,
}

impl Subject {
    /// `None`, having said why, where it cannot be had.
    pub(crate) fn named(name: &'static str) -> Option<Subject> {
        match name {
            "sponza" => {
                let (scene, view) = shared("sponza.glb", "nave")?;
                Some(Subject { name, flat: flattened(&scene), instanced: Some(scene), view })
            }
            "dragon" => {
                let (scene, view) = shared("dragon-room.glb", "main")?;
                Some(Subject { name, flat: flattened(&scene), instanced: None, view })
            }
            _ => {
                let (scene, view) = boulder().expect("a scene of our own making is valid");
                Some(Subject { name, flat: flattened(&scene), instanced: None, view })
            }
        }
    }
}

fn shared(file: &str, camera: &str) -> Option<(Scene, CameraView)> {
    let Some(folder) = lumicast_tests::shared_folder() else {
        println!("\nSKIPPED {file}: no ../shared beside the project");
        return None;
    };
    match load_scene(&folder.join("scenes").join(file), &AssetLimits::default()) {
        Ok(scene) => {
            let view = scene.camera_view(Some(camera));
            let view = view.unwrap_or_else(|| panic!("{file} has a camera {camera}"));
            Some((scene, view))
        }
        Err(error) => panic!("{file}: {error}"),
    }
}

/// Every instance's triangles, moved to the world in double precision, as one mesh on one node at the origin.
fn flattened(scene: &Scene) -> Scene {
    let mut all = MeshSource::default();
    for (node_id, node) in scene.nodes() {
        let Some(mesh) = node.mesh.as_ref().and_then(|mesh| scene.meshes().get(mesh)) else { continue };
        let world_from_mesh = scene.world_from_node(Some(node_id));
        let first = all.positions.len() as u32;
        let in_world =
            mesh.positions().iter().map(|p| world_from_mesh.transform_point3(p.as_dvec3() + mesh.centre()));
        all.positions.extend(in_world);
        let triangles = mesh.triangles().iter();
        all.triangles.extend(triangles.map(|triangle| triangle.map(|vertex| first + vertex)));
    }
    one_mesh(all).expect("what was a valid scene stays one")
}

fn one_mesh(mut mesh: MeshSource) -> Result<Scene, SceneError> {
    let mut stage = Stage::default();
    let material = stage.material("grey", Material::default())?;
    let triangle_count = mesh.triangles.len() as u32;
    mesh.primitives = vec![Primitive { first_triangle: 0, triangle_count, material }];
    stage.place("all", mesh, DAffine3::IDENTITY)?;
    Ok(stage.finish())
}

/// A rough boulder over dunes in a room: a million triangles of much the same size, and twelve large ones around.
fn boulder() -> Result<(Scene, CameraView), SceneError> {
    // 4 · 400² triangles and 2 · 424², about 640,000 and 360,000.
    const RINGS: u32 = 400;
    const DUNE_CELLS: u32 = 424;
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::default())?;
    let room = cuboid(DVec3::new(-6.0, -1.0, -6.0), DVec3::new(6.0, 6.0, 6.0), &grey);
    stage.place("room", room, DAffine3::IDENTITY)?;

    let mut boulder = sphere(DVec3::ZERO, 1.0, RINGS, &grey);
    boulder.normals.clear();
    for position in &mut boulder.positions {
        // A function of the place alone, so that vertices that met still meet.
        *position *= 1.6 + 0.25 * roughness(*position * 2.0);
    }
    stage.place("boulder", boulder, DAffine3::from_translation(DVec3::new(0.0, 1.6, 0.0)))?;
    stage.place("dunes", dunes(DUNE_CELLS, 11.9, &grey), DAffine3::IDENTITY)?;
    let eye = DVec3::new(3.9, 2.6, 4.4);
    let view = CameraView::look_at(eye, DVec3::new(0.0, 1.3, 0.0), DVec3::Y, 55f64.to_radians());
    Ok((stage.finish(), view))
}

/// A square of `cells`² quads and of side `side_m` around the origin, raised by [`roughness`].
fn dunes(cells: u32, side_m: f64, material: &lumicast_engine::scene::Id) -> MeshSource {
    let mut mesh = MeshSource::default();
    for (row, column) in (0..=cells).flat_map(|row| (0..=cells).map(move |column| (row, column))) {
        let along = |index: u32| side_m * (f64::from(index) / f64::from(cells) - 0.5);
        let foot = DVec3::new(along(column), 0.0, along(row));
        mesh.positions.push(foot.with_y(0.3 * roughness(foot)));
        if row < cells && column < cells {
            let a = row * (cells + 1) + column;
            let b = a + cells + 1;
            mesh.triangles.extend([[a, b, a + 1], [a + 1, b, b + 1]]);
        }
    }
    let triangle_count = mesh.triangles.len() as u32;
    mesh.primitives = vec![Primitive { first_triangle: 0, triangle_count, material: material.clone() }];
    mesh
}

/// Waves of ever shorter length and height, between about −1 and 1: rough at every scale, as scanned things are.
fn roughness(p: DVec3) -> f64 {
    // Frequencies without a common factor and turned axes keep the waves from lining up.
    let wave = |octave: i32| {
        let frequency = 1.3 * 1.93f64.powi(octave);
        let q = p * frequency + DVec3::splat(1.7 * f64::from(octave));
        let turned = DVec3::new(q.x + 0.6 * q.y, q.y - 0.5 * q.z, q.z + 0.4 * q.x);
        0.55f64.powi(octave) * turned.x.sin() * turned.y.cos() * turned.z.sin()
    };
    (0..7).map(wave).sum()
}
