//! What an edit costs: a scene of a thousand instances of one mesh, and one of them moved, added, removed.

use std::time::Instant;

use glam::{DAffine3, DVec3};
use lumicast_engine::{
    accel::Accel,
    scene::{
        Id, Material, Node, Scene, SceneBuilder, SceneChange, SceneError, SceneLimits,
        samples::{Stage, sphere},
    },
};

use crate::{answer::Pools, table};

/// Instances on each axis of a cube: a thousand in all.
const SIDE: u32 = 10;
/// Edits take tens of microseconds, so more rounds than for rays cost nothing.
const ROUNDS: usize = 25;

/// The one place that knows how a tree follows its scene.
fn updated(accel: &Accel, scene: &Scene, change: &SceneChange) -> Accel {
    accel.updated(scene, change)
}

/// Prints the milliseconds for the trees alone; what the scene's own builder takes is not counted.
pub(crate) fn measure(pools: &Pools) {
    let (scene, mesh) = balls().expect("a scene of our own making is valid");
    println!(
        "\n### updates: {} instances of one mesh of {} triangles\n",
        SIDE.pow(3),
        mesh_triangles(&scene)
    );
    let edits = edits(&scene, &mesh).expect("edits of our own making are valid");
    let best_ms = |work: &dyn Fn() -> Accel| {
        let once = |_| {
            let start = Instant::now();
            let accel = work();
            let seconds = start.elapsed().as_secs_f64();
            drop(accel);
            1e3 * seconds
        };
        (0..ROUNDS).map(once).fold(f64::INFINITY, f64::min)
    };
    let row = |name: &str, work: &(dyn Fn() -> Accel + Sync)| {
        let times = pools.of.each_ref().map(|pool| pool.install(|| best_ms(&work)));
        vec![name.to_string(), format!("{:.3}", times[0]), format!("{:.3}", times[1])]
    };
    let accel = Accel::build(&scene);
    let mut rows = vec![row("build", &|| Accel::build(&scene))];
    for (name, (edited, change)) in &edits {
        rows.push(row(name, &|| updated(&accel, edited, change)));
    }
    table::print_markdown(&["ms", "ours 1T", "ours 2T"], &rows);
}

/// A thousand balls on a lattice, a metre apart.
fn balls() -> Result<(Scene, Id), SceneError> {
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::default())?;
    // 8 rings: 224 triangles, about those of a chair in a hall full of chairs.
    let ball = sphere(DVec3::ZERO, 0.3, 8, &grey);
    stage.place("ball", ball, DAffine3::from_translation(DVec3::splat(-1.0)))?;
    let mesh = Id::sanitised("ball", "ball");
    for index in 0..SIDE.pow(3) - 1 {
        let cell = [index % SIDE, index / SIDE % SIDE, index / SIDE.pow(2)].map(f64::from);
        stage.builder().add_node(ball_id(index), placed(&mesh, DVec3::from_array(cell)))?;
    }
    Ok((stage.finish(), mesh))
}

fn ball_id(index: u32) -> Id {
    Id::sanitised(&format!("ball {index}"), "ball")
}

fn placed(mesh: &Id, position: DVec3) -> Node {
    Node { parent: None, parent_from_node: DAffine3::from_translation(position), mesh: Some(mesh.clone()) }
}

fn mesh_triangles(scene: &Scene) -> usize {
    scene.meshes().values().map(|mesh| mesh.triangles().len()).sum()
}

type Edit = (&'static str, (Scene, SceneChange));

/// Edits within the bounds of the scene, as most are: then render space stays where it was.
fn edits(scene: &Scene, mesh: &Id) -> Result<[Edit; 3], SceneError> {
    let builder = || SceneBuilder::from_scene(scene, SceneLimits::default());
    let middle = ball_id(SIDE.pow(3) / 2 + SIDE.pow(2) / 2 + SIDE / 2);
    let mut moving = builder();
    moving.set_transform(middle.as_str(), DAffine3::from_translation(DVec3::new(4.5, 4.5, 4.6)))?;
    let mut adding = builder();
    adding.add_node(ball_id(SIDE.pow(3)), placed(mesh, DVec3::splat(4.5)))?;
    let mut removing = builder();
    removing.remove_node(middle.as_str())?;
    Ok([("move one", moving.finish()), ("add one", adding.finish()), ("remove one", removing.finish())])
}
