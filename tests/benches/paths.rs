//! How fast paths are, as ratios within one run: path tracing against replaying its own rays.
//!
//! `cargo bench -p lumicast-tests --bench paths [-- SCENE.glb[:CAMERA] …]`; without arguments the built-in box and,
//! where they are found, the shared scenes.

use std::{
    hint::black_box,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::{
    film::PictureSize,
    render::{RenderSettings, Rendering},
    scene::{Scene, samples},
    technique::path::{PathSettings, Query, View, rays_of_a_pass},
    transport::World,
};
use rayon::prelude::*;

fn main() {
    let mut subjects: Vec<(String, Scene, Option<String>)> = Vec::new();
    match samples::cornell_box() {
        Ok(scene) => subjects.push(("built-in box".into(), scene, None)),
        Err(error) => eprintln!("built-in box: {error}"),
    }
    let named: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let named = if named.is_empty() { shared_subjects() } else { named };
    for name in named {
        let (file, camera) = match name.rsplit_once(':') {
            Some((file, camera)) => (file.to_string(), Some(camera.to_string())),
            None => (name.clone(), None),
        };
        match load_scene(&PathBuf::from(&file), &AssetLimits::default()) {
            Ok(scene) => subjects.push((name, scene, camera)),
            Err(error) => eprintln!("{error}"),
        }
    }
    println!("{} threads", rayon::current_num_threads());
    println!(
        "{:<44} {:>11} {:>11} {:>9} {:>12} {:>10}",
        "scene", "tracing s", "replay s", "ratio", "M rays/s", "rays/path"
    );
    for (name, scene, camera) in subjects {
        measure(&name, scene, camera.as_deref());
    }
}

fn shared_subjects() -> Vec<String> {
    let Some(folder) = lumicast_tests::shared_folder() else {
        println!("SKIPPED the shared scenes: no ../shared beside the project");
        return Vec::new();
    };
    [
        "cornell-box.glb:main",
        "cornell-glass.glb:main",
        "two-rooms.glb:roomB",
        "sponza.glb:nave",
        "modern-hall.glb:main",
    ]
    .iter()
    .map(|name| folder.join("scenes").join(name).display().to_string())
    .collect()
}

fn measure(name: &str, scene: Scene, camera: Option<&str>) {
    let Some(view) = scene.camera_view(camera) else {
        eprintln!("{name}: no such camera");
        return;
    };
    let world = Arc::new(World::prepare(Arc::new(scene)));
    let Ok(size) = PictureSize::new(640, 360) else { return };
    let settings = PathSettings::all(None, 0);
    let queries = rays_of_a_pass(&world, &View::new(&world, &view, size), size, settings);
    let ray_count: usize = queries.iter().map(Vec::len).sum();

    // Interleaved, best of five each: the machine may be shared.
    let (mut tracing, mut replay) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..5 {
        let mut rendering = Rendering::new(world.clone(), view, size, RenderSettings::default());
        let start = Instant::now();
        rendering.step(&AtomicBool::new(false));
        tracing = f64::min(tracing, start.elapsed().as_secs_f64());
        let start = Instant::now();
        queries.par_iter().for_each(|tile| {
            for query in tile {
                match query {
                    Query::Closest(ray) => drop(black_box(world.closest_hit(ray))),
                    Query::Occluded(ray) => drop(black_box(world.is_occluded(ray))),
                }
            }
        });
        replay = f64::min(replay, start.elapsed().as_secs_f64());
    }
    let short = name.rsplit('/').next().unwrap_or(name);
    println!(
        "{short:<44} {tracing:>11.3} {replay:>11.3} {:>8.1}% {:>12.2} {:>10.2}",
        100.0 * replay / tracing,
        ray_count as f64 / replay / 1e6,
        ray_count as f64 / size.pixel_count() as f64,
    );
}
