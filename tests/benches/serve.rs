//! How fast serving is: first picture, camera to picture while moving, and a real scene's start and memory.
//!
//! `cargo build --release -p lumicast --bins && cargo bench -p lumicast-tests --bench serve [-- [--size WxH] [--rest SECONDS]]`; the issue's
//! targets stand beside the figures. The viewer is a process of its own on the same machine, so it takes some of its time too. Pictures of who
//! moves are as large as there is time for: their width stands beside as a share. `LUMICAST_BACKEND=gpu` has a card draw; it compiles for
//! some seconds, during which the viewer may rest.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::transport::World;
use lumicast_protocol::{CameraPose, Projection};
use lumicast_tests::{Event, PATIENCE, Server, Viewer, percentile, shared_folder};

/// What the issue asks for.
const SIZE: [u16; 2] = [640, 360];

/// What is asked for on the command line.
struct Options {
    size: [u16; 2],
    /// Before the camera moves.
    rest: Duration,
}

impl Options {
    fn read(mut arguments: impl Iterator<Item = String>) -> Result<Options, String> {
        let mut options = Options { size: SIZE, rest: Duration::ZERO };
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument}: a value is missing"));
            match argument.as_str() {
                "--size" => {
                    let text = value()?;
                    let sides =
                        text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
                    options.size = sides.ok_or_else(|| format!("--size {text}: write it as 1280x720"))?;
                }
                "--rest" => {
                    let text = value()?;
                    let seconds =
                        text.parse().ok().and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
                    options.rest = seconds.ok_or_else(|| format!("--rest {text}: write seconds"))?;
                }
                // Cargo says so to every bench.
                "--bench" => {}
                _ => return Err(format!("{argument}: no such option")),
            }
        }
        Ok(options)
    }
}
/// How long the camera moves.
const MOVING: Duration = Duration::from_secs(10);
/// Between two camera messages: the protocol's "at most about 60 a second".
const CAMERA_PERIOD: Duration = Duration::from_micros(16_667);

fn main() {
    let options = match Options::read(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(error) => {
            eprintln!("error: {error}");
            std::process::exit(2);
        }
    };
    let shared = shared_folder().map(|folder| folder.join("scenes"));
    if shared.is_none() {
        println!("SKIPPED the shared scenes: no ../shared beside the project");
    }
    let file = |name: &str| shared.as_ref().map(|folder| folder.join(name));
    let [width, height] = options.size;
    println!("{width}×{height}, one viewer, {} s of movement", MOVING.as_secs());
    println!(
        "{:<14} {:>12} {:>14} {:>10} {:>10} {:>10} {:>9} {:>9}",
        "scene", "ready ms", "first pic ms", "p50 ms", "p95 ms", "frames/s", "width %", "MB"
    );
    measure("built-in box", None, &options);
    for name in ["cornell-box", "sponza"] {
        if let Some(file) = file(&format!("{name}.glb")) {
            measure(name, Some(file), &options);
        }
    }
    println!("targets: first picture 300 ms, p95 100 ms on cornell-box, 20 frames/s, sponza 400 MB");
    if let Some(file) = file("sponza.glb") {
        let started = Instant::now();
        match load_scene(&file, &AssetLimits::default()) {
            Ok(scene) => {
                let imported = started.elapsed();
                let world = World::prepare(Arc::new(scene));
                let total = started.elapsed();
                drop(world);
                println!(
                    "sponza: import {:.2} s + BVH and lights {:.2} s = {:.2} s (target 1.5 s)",
                    imported.as_secs_f64(),
                    (total - imported).as_secs_f64(),
                    total.as_secs_f64()
                );
            }
            Err(error) => eprintln!("{error}"),
        }
    }
}

fn measure(name: &str, file: Option<PathBuf>, options: &Options) {
    let args: Vec<PathBuf> = file.into_iter().collect();
    let server = Server::start(&args);
    let scenes = server.get("/v1/scenes").json();
    let id = scenes["scenes"][0]["id"].as_str().expect("a scene").to_string();

    let connecting = Instant::now();
    let mut viewer = Viewer::connect(server.address(), &id);
    let camera = viewer.scene.cameras.first().expect("a camera").clone();
    viewer.watch(camera.id.as_str(), options.size);
    viewer.next_frame(connecting + PATIENCE).expect("a first picture");
    let first_picture = connecting.elapsed();

    let rested = Instant::now() + options.rest;
    while Instant::now() < rested {
        if let Some(Event::Frame(header, _)) = viewer.next(rested) {
            viewer.acknowledge(header.frame);
        }
    }
    let Moved { mut latencies, frames, mut widths } =
        moved(&mut viewer, camera.world_from_camera, camera.projection, options.size);
    let memory = server.resident_bytes().map_or(f64::NAN, |bytes| bytes as f64 / 1e6);
    println!(
        "{name:<14} {:>12.0} {:>14.0} {:>10.1} {:>10.1} {:>10.1} {:>9.0} {memory:>9.0}",
        1e3 * server.started_in().as_secs_f64(),
        1e3 * first_picture.as_secs_f64(),
        percentile(&mut latencies, 0.5),
        percentile(&mut latencies, 0.95),
        frames as f64 / MOVING.as_secs_f64(),
        100.0 * percentile(&mut widths, 0.5),
    );
    viewer.close();
}

/// What who moves has seen.
struct Moved {
    /// Milliseconds from camera message to its first picture.
    latencies: Vec<f64>,
    /// Pictures.
    frames: usize,
    /// Of those first pictures, as shares of the width that was asked for.
    widths: Vec<f64>,
}

/// Swings the camera sideways and forth.
fn moved(viewer: &mut Viewer, world_from_camera: [f64; 16], projection: Projection, size: [u16; 2]) -> Moved {
    let (mut latencies, mut widths, mut frames) = (Vec::new(), Vec::new(), 0);
    // Stamps count up by one, so they are places in here.
    let mut sent: Vec<(u64, Instant)> = Vec::new();
    let started = Instant::now();
    let mut next_camera = started;
    while started.elapsed() < MOVING {
        if Instant::now() >= next_camera {
            let sideways = 0.1 * started.elapsed().as_secs_f64().sin();
            let mut pose = CameraPose { world_from_camera, projection };
            // Along its own x axis, which is the first column.
            for (to, x_axis) in pose.world_from_camera[12..15].iter_mut().zip(world_from_camera) {
                *to += sideways * x_axis;
            }
            let at = Instant::now();
            sent.push((viewer.watch_from(pose, size), at));
            next_camera += CAMERA_PERIOD;
        }
        match viewer.next(next_camera) {
            Some(Event::Frame(header, _)) => {
                let now = Instant::now();
                viewer.acknowledge(header.frame);
                frames += 1;
                let of_stamp = sent.iter().rev().find(|(stamp, _)| *stamp == header.camera_stamp);
                if let (true, Some((_, at))) = (header.first_from_stamp, of_stamp) {
                    latencies.push(1e3 * (now - *at).as_secs_f64());
                    widths.push(f64::from(header.size[0]) / f64::from(size[0]));
                }
            }
            Some(Event::Message(lumicast_protocol::ServerMessage::Error { problem, .. })) => {
                panic!("the server says {problem:?}")
            }
            Some(Event::Message(_)) | None => {}
        }
    }
    Moved { latencies, frames, widths }
}
