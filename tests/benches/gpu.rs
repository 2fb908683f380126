//! What a graphics card does beside this machine's CPU: bare rays, what planes see, path-traced passes, passes that ask the light octree,
//! records splatted, pictures shown, noise taken off, density estimates, and what bringing a scene to the card costs.
//!
//! `cargo bench -p lumicast-tests --bench gpu [-- [--software] [--size WxH] [--rounds N] [SCENE[:CAMERA] …]]`; without scenes
//! the built-in box and, where they are found, four of the shared ones. Prints one Markdown table; `LUMICAST_GPU_JSON=FILE` also
//! writes all of it. `--software` lets a driver that computes on the CPU stand for a card. Everything is run once to warm up
//! and then some rounds, of which the median counts; card and CPU take turns in one run, the CPU with all its threads. Before
//! what counts a card does the same for a while, as it does where pictures are drawn: while the CPU has its turn its clock goes down.
//! Two more words are for `tests/gpu.sh`: `adapter` names the card and does no more, `compare NAME A.exr B.exr` holds one
//! picture against another and prints JSON.

#[path = "gpu/bare_rays.rs"]
mod bare_rays;
#[path = "gpu/denoised.rs"]
mod denoised;
#[path = "gpu/density.rs"]
mod density;
#[path = "gpu/figures.rs"]
mod figures;
#[path = "gpu/frame.rs"]
mod frame;
#[path = "gpu/options.rs"]
mod options;
#[path = "gpu/passes.rs"]
mod passes;
#[path = "gpu/pictures.rs"]
mod pictures;
#[path = "gpu/planes.rs"]
mod planes;
#[path = "rays/ray_set.rs"]
#[expect(dead_code, reason = "benches/rays asks for more of it")]
mod ray_set;
#[path = "gpu/shadow_maps.rs"]
mod shadow_maps;
#[path = "gpu/shown.rs"]
mod shown;
#[path = "gpu/splats.rs"]
mod splats;
#[path = "gpu/subject.rs"]
mod subject;
#[path = "gpu/upload.rs"]
mod upload;

use std::{
    error::Error,
    process::ExitCode,
    sync::Arc,
    time::{Duration, Instant},
};

use figures::Figures;
use lumicast_engine::{
    film::PictureSize,
    gpu::{AdapterChoice, AdapterKind, AdapterReport, Gpu},
};
use options::{Mode, Options};
use subject::Subject;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let options = Options::read(std::env::args().skip(1))?;
    match &options.mode {
        Mode::Compare { name, pictures: [ours, theirs] } => pictures::compare(name, ours, theirs),
        Mode::Adapter => {
            println!("{}", described(&open(&options)?.report()));
            Ok(())
        }
        Mode::Measure { scenes } => measure(&options, scenes),
    }
}

fn measure(options: &Options, scenes: &[String]) -> Result<(), Box<dyn Error>> {
    let report = open(options)?.report();
    let size = options.size.map_or_else(|| size_for(report.kind), Ok)?;
    println!("{}\n", described(&report));
    let mut figures = Figures::new(&report, size, options.rounds);
    for subject in subject::wanted(scenes) {
        measure_subject(&subject?, options, size, &mut figures)?;
    }
    figures.print();
    if let Some(file) = std::env::var_os("LUMICAST_GPU_JSON") {
        std::fs::write(&file, figures.json()?).map_err(|error| format!("{}: {error}", file.display()))?;
    }
    Ok(())
}

fn measure_subject(
    subject: &Subject,
    options: &Options,
    size: PictureSize,
    figures: &mut Figures,
) -> Result<(), Box<dyn Error>> {
    eprintln!("{}: {} triangles", subject.name, subject.world.scene().instanced_triangle_count());
    // A device of its own for every scene: one that has compiled a shader does not compile it again.
    let gpu = Arc::new(open(options)?);
    let mut figures = figures.of(&subject.name);
    upload::measure(subject, &gpu, options.rounds, &mut figures)?;
    bare_rays::measure(subject, &gpu, size, options.rounds, &mut figures)?;
    shown::measure(&gpu, size, options.rounds, &mut figures)?;
    denoised::measure(&gpu, size, options.rounds, &mut figures)?;
    density::measure(subject, &gpu, options.rounds, &mut figures)?;
    planes::measure(subject, &gpu, size, options.rounds, &mut figures)?;
    passes::measure(subject, &gpu, size, options.rounds, &mut figures)
}

fn open(options: &Options) -> Result<Gpu, Box<dyn Error>> {
    let choice = if options.is_software_allowed { AdapterChoice::Any } else { AdapterChoice::Hardware };
    Ok(Gpu::open(choice).map_err(|error| match choice {
        AdapterChoice::Hardware => format!("{error} (--software lets a driver on the CPU stand for one)"),
        AdapterChoice::Any => error.to_string(),
    })?)
}

/// What a card draws in no time takes a driver on the CPU seconds.
fn size_for(kind: AdapterKind) -> Result<PictureSize, Box<dyn Error>> {
    let [width, height] = if kind == AdapterKind::Software { [640, 360] } else { [1920, 1080] };
    Ok(PictureSize::new(width, height)?)
}

fn described(report: &AdapterReport) -> String {
    let AdapterReport { name, driver, api, kind, .. } = report;
    format!("{name} ({kind}, {api}, {driver})")
}

/// How long a card is kept busy before what counts: that of an H200 idles at a sixth of its clock, and takes a tenth of a second to get up.
const WARM_UP: Duration = Duration::from_millis(300);

/// Does the work over and over until the card is warm, and then once more, which is what comes out.
fn warmed<T>(gpu: &Gpu, mut work: impl FnMut() -> Result<T, Box<dyn Error>>) -> Result<T, Box<dyn Error>> {
    let start = Instant::now();
    // A software adapter has no clock of its own.
    while gpu.report().kind != AdapterKind::Software && start.elapsed() < WARM_UP {
        work()?;
    }
    work()
}

/// The middle one; of an even number the upper.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
