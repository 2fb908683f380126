//! `lumicast render`: one picture, no server, the same engine.
//!
//! Facts go to standard output, diagnostics and the progress bar to standard error. Pictures are built in memory
//! and written whole: whatever ends the command, no half file is left.

mod alarm;
mod arguments;
mod backend;
mod exposure;
mod forecast;
mod interrupt;
mod progress;
mod snapshots;
mod statistics;
mod stop;

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use lumicast_engine::{
    effects::EffectPlan,
    film::{Display, Picture, PictureSize},
    render::{self, Illumination, IlluminationSettings, Indirect, Learning, RenderSettings, Rendering},
    scene::Scene,
    transport::World,
};

use lumicast_protocol::Accuracy;

use super::{CliError, output::print_line, scene_source::LoadedScene};
use crate::images::{ExrLayers, JpegQuality, PictureFacts, encode_exr, jpeg, png_small, write_file};
use alarm::Alarm;
pub(super) use arguments::parse_indirect;
pub use arguments::{OutputFormat, RenderArgs, default_size, find_camera};
use backend::DrawnOn;
use forecast::Outlook;
use interrupt::Interrupt;
use progress::Progress;
use snapshots::Snapshots;
use statistics::{Bytes, Counts, Seconds, Statistics, not_run};
use stop::{StopReason, StopRule};

/// Renders the picture that `args` ask for.
pub fn run(args: RenderArgs) -> Result<(), CliError> {
    let start = Instant::now();
    let format = OutputFormat::of(&args.out)?;
    check_arguments(&args, format)?;
    let loaded = args.scene.load()?;
    for warning in args.scene.warnings_of(&loaded.scene) {
        eprintln!("warning: {warning}");
    }
    let job = Job::prepare(&args, &loaded, start)?;
    let mut rendering = job.rendering()?;
    // All of it keeps to the threads that were asked for: pictures are made of films by several.
    let (outcome, picture, hint, statistics) = job.pool.install(|| {
        let outcome = job.render(&mut rendering)?;
        let facts = job.facts(&rendering, outcome.stopped_by, outcome.seconds);
        let shown = rendering.picture();
        let picture = encode(&args, format, &shown, &facts)?;
        let hint = match format {
            OutputFormat::Exr => None,
            OutputFormat::Png | OutputFormat::Jpeg => exposure::hint(&shown.radiance(), args.exposure),
        };
        let statistics = job.statistics(&rendering, &outcome);
        Ok::<_, CliError>((outcome, picture, hint, statistics))
    })?;
    outcome.interrupt.undisturbed(|| write_file(&args.out, &picture))?;
    let is_confirmed = args.error.is_some_and(|target| rendering.confirms(target));
    let measured = rendering.measured_error();
    if let Some(missed) = statistics::missed(outcome.stopped_by, args.error, measured, is_confirmed) {
        eprintln!("warning: {missed}");
    }
    if let Some(overran) = statistics::overran(args.time, outcome.seconds, rendering.passes()) {
        eprintln!("warning: {overran}");
    }
    if let Some(hint) = hint {
        eprintln!("hint: {hint}");
    }
    report(&args, &statistics, outcome.stopped_by, &EffectPlan::of(job.world.scene()))?;
    match outcome.interrupt.came().filter(|_| outcome.stopped_by == StopReason::Signal) {
        Some(signal) => {
            let left = format!("{} is the picture as it was by then", args.out.display());
            Err(job.stopped(signal, &rendering, left, outcome.snapshot_count))
        }
        None => Ok(()),
    }
}

/// What can be known to be wrong before any work is done.
fn check_arguments(args: &RenderArgs, format: OutputFormat) -> Result<(), CliError> {
    if args.layers && format != OutputFormat::Exr {
        let message = format!("--layers: only EXR files hold layers, and --out is {}", args.out.display());
        return Err(CliError::Usage(message));
    }
    if format == OutputFormat::Exr && args.exposure != 0.0 {
        eprintln!("warning: --exposure does not apply to EXR, which holds linear radiance");
    }
    let technique = args.technique();
    // A number of samples takes paths where nothing else is asked for.
    let samples = if technique == args.indirect { "" } else { " and --samples" };
    for option in without_effect(args) {
        eprintln!("warning: {option} changes nothing with --indirect {}{samples}", args.indirect.name());
    }
    for (option, path) in [("--out", Some(&args.out)), ("--stats", args.stats.as_ref())] {
        let Some(path) = path else { continue };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let message = format!("{option} {}: there is no folder {}", path.display(), folder.display());
            return Err(CliError::Usage(message));
        }
        if path.is_dir() {
            return Err(CliError::Usage(format!("{option} {}: this is a folder", path.display())));
        }
    }
    Ok(())
}

/// Options that the technique has no use for.
fn without_effect(args: &RenderArgs) -> impl Iterator<Item = &'static str> {
    let technique = args.technique();
    let has_records = matches!(technique, Indirect::Auto | Indirect::Irradiance);
    let has_accuracy = args.irradiance_accuracy != Accuracy::default().irradiance_accuracy;
    let is_filtered = !matches!(technique, Indirect::Path | Indirect::None);
    let options = [
        ("--irradiance-accuracy", has_accuracy && !has_records),
        ("--keep-noise", args.keep_noise && !is_filtered),
    ];
    options.into_iter().filter(|(_, is_idle)| *is_idle).map(|(option, _)| option)
}

/// Share of the time of a picture in which more may be learnt of its light; the rest is for seeing what is known.
const LEARNING_UNTIL: f64 = 0.9;

/// A rendering as asked for, everything but its samples.
struct Job<'a> {
    args: &'a RenderArgs,
    camera: Option<String>,
    view: lumicast_engine::scene::CameraView,
    size: PictureSize,
    world: Arc<World>,
    bvh_seconds: f64,
    rule: StopRule,
    pool: rayon::ThreadPool,
    drawn_on: DrawnOn,
    start: Instant,
    load_seconds: f64,
}

/// How a rendering ended.
struct Outcome {
    stopped_by: StopReason,
    /// Since the start, less loading.
    seconds: f64,
    frame_seconds: f64,
    snapshot_count: usize,
    outlook: Outlook,
    interrupt: Interrupt,
}

impl<'a> Job<'a> {
    fn prepare(args: &'a RenderArgs, loaded: &LoadedScene, start: Instant) -> Result<Job<'a>, CliError> {
        let scene = &loaded.scene;
        let camera = find_camera(scene, args.camera.as_deref())?;
        let size = args.size.unwrap_or_else(|| default_size(camera.map(|(_, camera)| camera)));
        check_memory(size, args, scene)?;
        let view = camera.and_then(|(name, _)| scene.camera_view(Some(name)));
        if view.is_none() {
            eprintln!("note: the scene has no camera; showing all of it from the front");
        }
        let threads = args.threads.filter(|threads| *threads > 0).map_or_else(core_count, usize::from);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("render {index}"))
            .build()
            .map_err(|error| CliError::System {
                doing: format!("starting {threads} threads"),
                source: std::io::Error::other(error),
            })?;
        let bvh_start = Instant::now();
        let world = Arc::new(pool.install(|| World::prepare(scene.clone())));
        let bvh_seconds = bvh_start.elapsed().as_secs_f64();
        let view = view.unwrap_or_else(|| scene.default_view());
        let settings = settings_of(args);
        let drawn_on = pool.install(|| DrawnOn::choose(args.backend, &world, (&view, size), &settings))?;
        Ok(Job {
            args,
            camera: camera.map(|(name, _)| name.to_string()),
            view,
            size,
            world,
            bvh_seconds,
            drawn_on,
            rule: StopRule::new(args.samples, args.time, args.error),
            pool,
            start,
            load_seconds: loaded.load_seconds,
        })
    }

    fn rendering(&self) -> Result<Rendering, CliError> {
        let learning = match self.rule {
            // Bounded by time the picture depends on the clock in any case, and shows what it knows as soon as it can.
            StopRule { time: Some(time), .. } => {
                Learning::Alongside { until: self.moment(LEARNING_UNTIL * time.as_secs_f64()) }
            }
            // Samples of what can be known.
            StopRule { samples: Some(_), .. } => Learning::First,
            StopRule { .. } => Learning::InStep,
        };
        let settings =
            RenderSettings { learning, backend: self.drawn_on.backend(), ..settings_of(self.args) };
        let mut illumination = IlluminationSettings::of(&settings);
        illumination.irradiance.weighing.accuracy = self.args.irradiance_accuracy;
        illumination.irradiance.visits = self.rule.visits(illumination.irradiance.visits);
        let scene = (self.world.clone(), illumination);
        let mut rendering = Rendering::learning_by(scene, self.view, self.size, settings);
        self.drawn_on.take(&mut rendering);
        rendering.aim_at(self.rule.error);
        Ok(rendering)
    }

    /// Seconds of work: everything since the start but loading the scene and compiling shaders.
    fn seconds(&self) -> f64 {
        self.start.elapsed().as_secs_f64() - self.beside_seconds()
    }

    /// Seconds of what is reported beside the work.
    fn beside_seconds(&self) -> f64 {
        self.load_seconds + self.drawn_on.shader_seconds()
    }

    /// The moment at which [`Job::seconds`] will be `seconds`.
    fn moment(&self, seconds: f64) -> Option<Instant> {
        self.start.checked_add(Duration::try_from_secs_f64(seconds + self.beside_seconds()).ok()?)
    }

    fn render(&self, rendering: &mut Rendering) -> Result<Outcome, CliError> {
        let mut snapshots = self.args.snapshots.as_deref().map(Snapshots::new).transpose()?;
        let cancel = Arc::new(AtomicBool::new(false));
        let alarm = Alarm::new(cancel.clone())?;
        let interrupt = Interrupt::watch(cancel.clone())?;
        let mut progress = Progress::new(self.rule);
        let mut outlook = Outlook::new(&self.rule);
        self.announce();
        let mut frame_seconds = 0.0;
        let stopped_by = loop {
            cancel.store(false, Ordering::SeqCst);
            // The first pass always ends: a picture with holes serves nobody.
            if rendering.passes() > 0 {
                self.set_alarm(&alarm, snapshots.as_ref());
            }
            // Looked at after the flag was cleared: a signal in between is seen here, a later one sets the flag.
            if let Some(signal) = interrupt.came() {
                if rendering.passes() > 0 {
                    break StopReason::Signal;
                }
                progress.finish();
                let left = format!("{} was not written", self.args.out.display());
                return Err(self.stopped(signal, rendering, left, 0));
            }
            let step_start = Instant::now();
            rendering.step(&cancel);
            if let Some(error) = rendering.take_gpu_failure() {
                progress.finish();
                // Who asked for the card by name is told that it does not do it; there may be a reason for the wish.
                if self.args.backend == arguments::Backend::Gpu {
                    return Err(backend::unusable(&error));
                }
                eprintln!("warning: going on by the CPU: {error}");
            }
            frame_seconds += step_start.elapsed().as_secs_f64();
            let seconds = self.seconds();
            outlook.look_if_due(rendering, seconds);
            progress.show(rendering, &outlook, seconds);
            if rendering.passes() == 0 || interrupt.came().is_some() {
                continue;
            }
            if let Some(snapshots) = &mut snapshots
                && seconds >= snapshots.next_seconds()
            {
                let facts = self.facts_now(rendering);
                interrupt.undisturbed(|| snapshots.take_if_due(rendering, &facts, seconds))?;
            }
            if let Some(reason) = self.is_done(rendering, seconds) {
                break reason;
            }
        };
        if stopped_by == StopReason::Samples && rendering.passes() == 1 {
            cancel.store(false, Ordering::SeqCst);
            rendering.measure_first(&cancel);
        }
        progress.finish();
        let seconds = self.seconds();
        outlook.end(rendering, seconds);
        if let Some(snapshots) = &mut snapshots {
            let facts = self.facts_now(rendering);
            interrupt.undisturbed(|| snapshots.take(rendering, &facts, seconds))?;
        }
        let snapshot_count = snapshots.map_or(0, |snapshots| snapshots.count());
        Ok(Outcome { stopped_by, seconds, frame_seconds, snapshot_count, outlook, interrupt })
    }

    /// Sample and error bounds are looked at after whole passes only, so that no alarm decides about them.
    fn is_done(&self, rendering: &Rendering, seconds: f64) -> Option<StopReason> {
        let by_picture = rendering.is_whole().then(|| self.rule.is_done_with(rendering)).flatten();
        by_picture
            .or_else(|| self.rule.time.filter(|time| seconds >= time.as_secs_f64()).map(|_| StopReason::Time))
    }

    fn set_alarm(&self, alarm: &Alarm, snapshots: Option<&Snapshots>) {
        let limit = self.rule.time.map(|time| time.as_secs_f64());
        // Without a limit of time no clock may decide where a pass is cut: snapshots then wait for its end.
        let due = snapshots.filter(|_| limit.is_some()).map(Snapshots::next_seconds);
        let earliest = limit.into_iter().chain(due).reduce(f64::min);
        if let Some(moment) = earliest.and_then(|seconds| self.moment(seconds)) {
            alarm.set(moment);
        }
    }

    fn announce(&self) {
        eprintln!(
            "rendering {} from {}, {}×{}, on the {}, {} thread{}",
            self.args.scene,
            self.camera.as_deref().unwrap_or("the front"),
            self.size.width(),
            self.size.height(),
            if self.drawn_on.adapter().is_some() { "GPU backend" } else { "CPU" },
            self.pool.current_num_threads(),
            if self.pool.current_num_threads() == 1 { "" } else { "s" },
        );
    }

    fn facts_now(&self, rendering: &Rendering) -> PictureFacts {
        let picture = rendering.picture();
        let (error, error_ci, _) = statistics::shown_errors(rendering.measured_error_of(&picture));
        PictureFacts {
            // A file is a scene before its first edit.
            revision: 1,
            seed: self.args.seed,
            samples_per_pixel: rendering.passes(),
            technique: rendering.technique_name(&picture),
            error,
            error_ci,
            seconds: None,
        }
    }

    fn facts(&self, rendering: &Rendering, stopped_by: StopReason, seconds: f64) -> PictureFacts {
        let is_by_clock = matches!(stopped_by, StopReason::Time | StopReason::Signal);
        let seconds = is_by_clock.then_some(seconds);
        PictureFacts { seconds, ..self.facts_now(rendering) }
    }

    fn stopped(
        &self,
        (name, number): (&'static str, u8),
        rendering: &Rendering,
        mut left: String,
        snapshot_count: usize,
    ) -> CliError {
        let done = format!("{} samples per pixel in {:.1} s", rendering.passes(), self.seconds());
        if let Some(folder) = &self.args.snapshots {
            left += &format!("; {snapshot_count} snapshots are in {}", folder.display());
        }
        CliError::Signal { name, number, done, left }
    }

    fn statistics(&self, rendering: &Rendering, outcome: &Outcome) -> Statistics {
        let (counts, report) = (rendering.counts(), self.world.report());
        let picture = rendering.picture();
        let (error, error_ci, error_trimmed) =
            statistics::shown_errors(rendering.measured_error_of(&picture));
        let plan = EffectPlan::of(self.world.scene()).chosen(self.args.effects);
        let light = rendering.illumination().map(Illumination::report).unwrap_or_default();
        let records = rendering.records();
        let caustics = rendering.caustics();
        let learning = light.photon_seconds + light.octree_seconds + records.seconds;
        let splat = rendering.splat_seconds() / self.pool.current_num_threads() as f64;
        Statistics {
            version: env!("CARGO_PKG_VERSION"),
            scene: self.args.scene.to_string(),
            camera: self.camera.clone(),
            size: [self.size.width(), self.size.height()],
            out: self.args.out.display().to_string(),
            indirect: self.args.indirect.name(),
            technique: rendering.technique_name(&picture),
            path_traced: rendering.path_traced_share(&picture),
            backend: if rendering.gpu_work() > 0 { "gpu" } else { "cpu" },
            adapter: self.drawn_on.adapter().map(|report| report.name),
            threads: self.pool.current_num_threads(),
            seed: self.args.seed,
            samples_per_pixel: rendering.passes(),
            stopped_by: outcome.stopped_by.name(),
            error,
            error_ci,
            error_trimmed,
            forecast: outcome.outlook.facts(),
            forecast_record: outcome.outlook.record(),
            seconds: Seconds {
                load: self.load_seconds,
                bvh: self.bvh_seconds,
                photons: light.photon_seconds,
                octree: light.octree_seconds,
                gather: records.seconds,
                caustics: caustics.seconds,
                splat,
                frame: outcome.frame_seconds - learning - caustics.seconds - splat,
                shaders: self.drawn_on.shader_seconds(),
                total: outcome.seconds + self.beside_seconds(),
            },
            counts: Counts {
                rays: counts.all_rays(),
                shadow_rays: counts.shadow_rays,
                paths: counts.paths,
                dropped_samples: rendering.dropped_samples(),
                photons_stored: light.photons_stored,
                voxels: light.voxels,
                vdls: light.vdls,
                records: records.count,
                caustic_photons: caustics.photons_emitted,
                caustic_photons_stored: caustics.photons_stored,
                ..Counts::default()
            },
            bytes: Bytes {
                meshes: report.mesh_bytes,
                textures: report.texture_bytes,
                bvh: report.accel.bytes,
                lights: report.light_bytes,
                photons: light.photon_bytes,
                octree: light.octree_bytes,
                records: records.bytes,
                caustics: caustics.bytes,
                film: rendering.film_bytes(),
                gpu: self.drawn_on.bytes(),
            },
            effects: statistics::effects(&plan, self.args.technique(), self.args.bounces),
            not_run: not_run(
                rendering.illumination().is_some(),
                records.seconds > 0.0,
                splat > 0.0,
                caustics.photons_emitted > 0,
                rendering.is_on_gpu(),
            ),
        }
    }
}

/// Settings that the arguments ask for, but for when it is drawn.
fn settings_of(args: &RenderArgs) -> RenderSettings {
    let is_on_gpu = args.backend == arguments::Backend::Gpu;
    RenderSettings {
        backend: if is_on_gpu { render::Backend::Gpu } else { render::Backend::Cpu },
        indirect: args.technique(),
        bounces_max: args.bounces,
        seed: args.seed,
        effects: args.effects,
        measuring: args.measuring,
        keeps_noise: args.keep_noise,
        ..RenderSettings::default()
    }
}

fn core_count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Refuses a film that the machine cannot hold, instead of being killed half way.
fn check_memory(size: PictureSize, args: &RenderArgs, scene: &Scene) -> Result<(), CliError> {
    let settings = settings_of(args);
    // Up to 112 bytes a pixel for pictures and layers on their way into a file.
    let on_the_way = 112 * size.pixel_count();
    let needed = (settings.picture_bytes(&EffectPlan::of(scene), size.pixel_count()) + on_the_way) as u64;
    match available_bytes() {
        Some(available) if needed > available => Err(CliError::Usage(format!(
            "--size {}x{}: needs {} MB, and {} MB of memory are free",
            size.width(),
            size.height(),
            needed / 1_000_000,
            available / 1_000_000
        ))),
        _ => Ok(()),
    }
}

/// Memory that can be had without swapping, where the system says so.
fn available_bytes() -> Option<u64> {
    let facts = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = facts.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? * 1024)
}

fn encode(
    args: &RenderArgs,
    format: OutputFormat,
    picture: &Picture<'_>,
    facts: &PictureFacts,
) -> Result<Vec<u8>, CliError> {
    let rgb8 = || Display::new(args.tone_map, args.exposure).show_all(&picture.radiance());
    let layers = if args.layers { ExrLayers::All } else { ExrLayers::Plain };
    Ok(match format {
        OutputFormat::Exr => encode_exr(picture, layers, facts)?,
        OutputFormat::Png => png_small(&rgb8(), picture.size())?,
        OutputFormat::Jpeg => jpeg(&rgb8(), picture.size(), JpegQuality::FILE)?,
    })
}

fn report(
    args: &RenderArgs,
    statistics: &Statistics,
    stopped_by: StopReason,
    plan: &EffectPlan,
) -> Result<(), CliError> {
    if args.technique() == Indirect::Path && plan.facts.hides_light() {
        eprintln!(
            "warning: path tracing cannot find the light of point, spot and directional lamps by way of mirrors and clear \
             glass, but for that of suns straight through panes: it is neither in the picture nor in its error; --indirect auto (without --samples), irradiance and octree \
             show it"
        );
    }
    if stopped_by == StopReason::Best {
        eprintln!(
            "warning: stopped above the error asked for: what is left is not noise but {}'s own error, which more time \
             does not lower; --indirect auto goes on with path tracing",
            statistics.technique
        );
    }
    let dropped = statistics.counts.dropped_samples;
    if dropped > 0 {
        eprintln!("warning: {dropped} samples were not finite or negative and count as black");
    }
    let broken = |error: serde_json::Error| CliError::System {
        doing: "writing the statistics as JSON".into(),
        source: error.into(),
    };
    if let Some(path) = &args.stats {
        let mut json = serde_json::to_vec_pretty(statistics).map_err(broken)?;
        json.push(b'\n');
        write_file(path, &json)?;
    }
    if args.json {
        print_line(&serde_json::to_string_pretty(statistics).map_err(broken)?)
    } else {
        print_line(&statistics.summary())
    }
}

#[cfg(test)]
mod tests;
