//! What showing irradiance records costs: splatting them onto a picture against looking them up, and changing their accuracy.
//!
//! `cargo bench -p lumicast-tests --bench records [-- SCENE.glb[:CAMERA] …]`; without arguments the built-in box and, where they are
//! found, the shared sibenik and sponza. 640 × 360 pixels, 4,000 records or as many as the view takes; the best of some rounds in turns.

use std::{
    hint::black_box,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::{
    film::{Film, PictureSize},
    render::{IlluminationSettings, Learner, Learning, Learnt, RenderSettings, Stage},
    scene::{Scene, samples},
    technique::{FirstSight, SecondaryLight, View},
    transport::World,
};
use rayon::prelude::*;

/// As many as the paper's figures are of.
const RECORDS: u64 = 4_000;
const ROUNDS: usize = 5;

fn main() {
    println!("{} threads", rayon::current_num_threads());
    let named: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    if named.is_empty() {
        match samples::cornell_box() {
            Ok(scene) => measure("built-in box", scene, None),
            Err(error) => eprintln!("built-in box: {error}"),
        }
    }
    for name in if named.is_empty() { shared_subjects() } else { named } {
        let (file, camera) =
            name.rsplit_once(':').map_or((&*name, None), |(file, camera)| (file, Some(camera)));
        match load_scene(&PathBuf::from(file), &AssetLimits::default()) {
            Ok(scene) => measure(file.rsplit('/').next().unwrap_or(file), scene, camera),
            Err(error) => eprintln!("{error}"),
        }
    }
}

fn shared_subjects() -> Vec<String> {
    let Some(folder) = lumicast_tests::shared_folder() else {
        println!("SKIPPED the shared scenes: no ../shared beside the project");
        return Vec::new();
    };
    let path = |name: &str| folder.join("scenes").join(name).display().to_string();
    ["sibenik.glb:nave", "sponza.glb:nave"].iter().map(|name| path(name)).collect()
}

fn measure(name: &str, scene: Scene, camera: Option<&str>) {
    println!("\n### {name}\n");
    let size = PictureSize::new(640, 360).expect("a size");
    let camera = scene.camera_view(camera).unwrap_or_else(|| scene.default_view());
    let world = World::prepare(Arc::new(scene));
    let settings = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let mut learner = Learner::new(Learnt::Records, &settings, IlluminationSettings::of(&settings));
    learner.look(0, &camera, size);
    let never = AtomicBool::new(false);
    while learner.stage() != Stage::Complete && learner.records().count < RECORDS {
        learner.step(&world, &never);
    }
    let view = View::new(&world, &camera, size);
    // A change of accuracy shows all records there are.
    let start = Instant::now();
    learner.set_accuracy(0.151);
    let changed = start.elapsed().as_secs_f64();
    let Some(known) = learner.known().cloned() else { return };
    show(&world, &view, &known);
    println!("- another accuracy for {} records: {:.1} ms", learner.records().count, 1e3 * changed);
}

/// Splats and looks up in turns what one sample of every pixel sees.
fn show(world: &World, view: &View, known: &Arc<dyn SecondaryLight>) {
    let film = Film::new(view.size());
    let sights: Vec<Vec<Option<FirstSight>>> = film
        .tiles()
        .par_iter()
        .map(|tile| {
            let (origin, size) = (tile.origin(), tile.size());
            let sight = |x: u32, y: u32| {
                let ray = view.ray((origin.x + x) as f32 + 0.5, (origin.y + y) as f32 + 0.5);
                let surface = world.surface(&world.closest_hit(&ray)?, ray.direction);
                surface.bsdf.has_diffuse().then_some(FirstSight { surface, wo: -ray.direction })
            };
            (0..size.y).flat_map(|y| (0..size.x).map(move |x| (x, y))).map(|(x, y)| sight(x, y)).collect()
        })
        .collect();
    let (mut laying, mut splatting, mut looking) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
    let (mut answered, mut seen) = (0, 0);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        let Some(laid_out) = Arc::clone(known).laid_out_for(view) else {
            println!("- not laid out: looking up takes less");
            return;
        };
        laying = laying.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        answered = film
            .tiles()
            .par_iter()
            .zip(&sights)
            .map(|(tile, seen)| {
                let found = laid_out.scattered_over(tile.origin(), tile.size(), seen);
                black_box(found).iter().flatten().count()
            })
            .sum();
        splatting = splatting.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        seen = sights
            .par_iter()
            .map(|sights| {
                let look_up = |sight: &FirstSight| {
                    black_box(known.scattered_but_caustics(&sight.surface, sight.wo, None))
                };
                sights.iter().flatten().filter(|sight| !look_up(sight).indirect.is_black()).count()
            })
            .sum();
        looking = looking.min(start.elapsed().as_secs_f64());
    }
    println!(
        "- {} records: sorted into tiles in {:.1} ms, splatted in {:.1} ms onto {answered} of {seen} pixels; looked up in {:.1} ms",
        known.places().len(),
        1e3 * laying,
        1e3 * splatting,
        1e3 * looking
    );
}
