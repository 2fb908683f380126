//! What making pictures of films costs: as they are, with noise taken off, and blended.
//!
//! `cargo bench -p lumicast-tests --bench pictures`: the built-in box with four samples a pixel, in four sizes; the best of
//! some rounds in turns.

use std::{
    hint::black_box,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use lumicast_engine::{
    film::{Denoising, Film, Picture, PictureSize},
    math::Rgb,
    render::{Indirect, RenderSettings, Rendering},
    scene::samples,
    transport::World,
};

const ROUNDS: usize = 5;
const PASSES: u32 = 4;

fn main() {
    let scene = match samples::cornell_box() {
        Ok(scene) => Arc::new(scene),
        Err(error) => return eprintln!("{error}"),
    };
    println!("{} threads; milliseconds\n", rayon::current_num_threads());
    println!("| size | a pass | as it is | without noise | without noise, blended |");
    println!("| --- | ---: | ---: | ---: | ---: |");
    for (width, height) in [(128, 128), (320, 180), (512, 512), (1920, 1080)] {
        let size = PictureSize::new(width, height).expect("a size");
        let (traced, seconds) = draw(&scene, size, 1);
        let (film, _) = draw(&scene, size, 0);
        let plain = || Picture::of(&film);
        let denoised = || plain().denoised(&Denoising::default());
        let blended = || denoised().blended(&traced);
        let radiances: [&dyn Fn() -> Vec<Rgb>; 3] =
            [&|| plain().radiance(), &|| denoised().radiance(), &|| blended().radiance()];
        let mut best = [f64::INFINITY; 3];
        for _ in 0..ROUNDS {
            for (best, radiance) in best.iter_mut().zip(radiances) {
                let start = Instant::now();
                black_box(radiance());
                *best = best.min(start.elapsed().as_secs_f64());
            }
        }
        let [plain, denoised, blended] = best.map(|seconds| 1e3 * seconds);
        let pass = 1e3 * seconds / f64::from(PASSES);
        println!("| {width} × {height} | {pass:.1} | {plain:.1} | {denoised:.1} | {blended:.1} |");
    }
}

/// A film, and how long it took.
fn draw(scene: &Arc<lumicast_engine::scene::Scene>, size: PictureSize, seed: u64) -> (Film, f64) {
    let world = Arc::new(World::prepare(Arc::clone(scene)));
    let camera = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
    let settings = RenderSettings { indirect: Indirect::Path, seed, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world, camera, size, settings);
    let (never, start) = (AtomicBool::new(false), Instant::now());
    while rendering.passes() < PASSES {
        rendering.step(&never);
    }
    (rendering.film().clone(), start.elapsed().as_secs_f64())
}
