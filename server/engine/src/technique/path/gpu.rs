//! The path tracer on a graphics card: a slice of the picture at a time, one scattering of all its paths after the other.
//!
//! Twin of `cpu.rs`: it draws the same numbers for the same pixel and pass and takes the same decisions, so that both
//! backends add to one film. What differs is rounding (a card may fuse and reorder), which moves a few paths in ten thousand
//! to another side of a decision.
//!
//! Steps (`shaders/path`), for a slice: `begin`; then as long as paths go on `closest`, `shade`, `turn`, `occluded`. Paths
//! keep their place, one a pixel; queues hold the places of those that go on, so that later scatterings cost by what is
//! left of them. How many are left is read now and then only: steps take their size from a buffer that `turn` writes.
//!
//! **Watchdogs** end whatever keeps a card busy for long. A slice is as large as its first batch of commands takes
//! [`BATCH_SECONDS`], and is halved and doubled as that changes.

mod step_clock;
#[cfg(test)]
mod tests;

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    time::Instant,
};

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use lumicast_shaders::{
    Constant, PATH_BEGIN, PATH_CLOSEST, PATH_OCCLUDED, PATH_SHADE, PATH_SHADE_BY_OCTREE, PATH_TURN,
    Step as Shader,
};
use rayon::prelude::*;

pub use step_clock::StepSeconds;

use super::{
    CARD, PathSettings, PathTracer, View,
    cpu::{BOUNCES_END, ROULETTE_FREE_BOUNCES, SURVIVAL_MAX},
};
use crate::{
    accel::{GAMMA_5, GAMMA_19},
    film::{Film, PictureSize, PixelSample},
    gpu::{
        AdapterKind, Batch, BindGroup, Binding, Buffer, Gpu, GpuError, GpuTrees, Layout, Masks, Pipeline,
        Session,
    },
    math::{Rgb, sobol::PixelSampler},
    technique::{
        Canvas, Card, Counts, Edit, GpuOctreeHeader, LIKE_COS, PackedLight, Progress, SecondaryLight, Step,
        Technique,
    },
    transport::{PathClass, TEXTURE_FLAGS, World, WorldBuffers, bsdf::SMOOTH_ALPHA},
};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;
/// Longest time that a batch of commands is to take: watchdogs bark after a second or two, and a cancelled picture waits for
/// the batch that runs.
const BATCH_SECONDS: f64 = 0.01;
/// The same where the adapter is the CPU itself: no watchdog there, and small batches cost as much to begin as to run.
const SOFTWARE_BATCH_SECONDS: f64 = 0.1;
/// Fewest and most paths of a slice, 288 bytes each: cards run some 10⁵ at once, and every scene that is looked at has places of
/// its own.
const SLICE_MIN: u32 = 4096;
const SLICE_MAX: u32 = 1 << 18;
/// The same where the adapter is the CPU itself.
const SOFTWARE_SLICE_MAX: u32 = 1 << 16;
/// Scatterings of the first batch of a slice, and most of a later one, which has ever fewer paths.
const SCATTERINGS_FIRST: u32 = 4;
const SCATTERINGS_MAX: u32 = 64;
/// Devices that may be lost one after the other without a finished pass before it is given up.
const LOSSES_MAX: u32 = 3;

/// `PassHeader` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPassHeader {
    origin: [f32; 3],
    half_width: f32,
    right: [f32; 3],
    half_height: f32,
    up: [f32; 3],
    is_perspective: u32,
    back: [f32; 3],
    width: u32,
    seed_key: [u32; 2],
    sequence: u32,
    index: u32,
    height: u32,
    first_pixel: u32,
    path_count: u32,
    capacity: u32,
    traced: u32,
    bounces_end: u32,
    padding_0: u32,
    padding_1: u32,
}

/// `PixelSample` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPixelSample {
    emitted: [f32; 3],
    depth_m: f32,
    direct: [f32; 3],
    albedo_red: f32,
    caustic: [f32; 3],
    albedo_green: f32,
    indirect: [f32; 3],
    albedo_blue: f32,
    normal: [f32; 3],
    padding_0: u32,
}

/// `Counters` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuCounters {
    parity: u32,
    ray_count: u32,
    next_ray_count: u32,
    shadow_count: u32,
    next_shadow_count: u32,
    rays: u32,
    shadow_rays: u32,
    padding_0: u32,
}

/// Bytes of a path on the card, by buffer: state, hit, shadow ray, sample, places in three queues.
const PATH_BYTES: u64 = 96;
const HIT_BYTES: u64 = 20;
const SHADOW_BYTES: u64 = 80;
const SAMPLE_BYTES: u64 = size_of::<GpuPixelSample>() as u64;
const QUEUES_BYTES: u64 = 12;
const DISPATCH_BYTES: u64 = 32;
/// Where the sizes of shadow rays begin in the buffer of sizes.
const SHADOW_SIZES_AT: u64 = 12;

/// A scene on a card.
#[derive(Debug)]
struct GpuWorld {
    /// Kept for as long as the group that binds them.
    _trees: GpuTrees,
    trees_group: BindGroup,
    trees_layout: Arc<Layout>,
    /// Kept for as long as the group that binds them.
    _buffers: Vec<Buffer>,
    group: BindGroup,
    layout: Arc<Layout>,
    constants: Vec<(&'static str, Constant)>,
}

impl GpuWorld {
    fn new(session: &Arc<Session>, world: &World) -> Result<GpuWorld, GpuError> {
        let trees = GpuTrees::new(session, &world.accel().upload())?;
        let packed: WorldBuffers = world.upload();
        let buffers = vec![
            session.buffer_of("scene header", &[packed.header])?,
            session.buffer_of("placements", &packed.placements)?,
            session.buffer_of("geometry", &packed.geometry)?,
            session.buffer_of("materials", &packed.materials)?,
            session.buffer_of("texels", &packed.texels)?,
            session.buffer_of("tables", &packed.tables)?,
            session.buffer_of("lights", &packed.lights)?,
            session.buffer_of("light nodes", &packed.light_nodes)?,
        ];
        let layout = session.layout(&[
            Binding::Uniform,
            Binding::Read,
            Binding::Read,
            Binding::Read,
            Binding::Read,
            Binding::Read,
            Binding::Read,
            Binding::Read,
        ])?;
        let group = session.bind(&layout, &buffers.iter().collect::<Vec<_>>())?;
        let features = packed.features;
        let mut constants = vec![
            ("HAS_TEXTURES", Constant::Bool(features.has_textures)),
            ("HAS_GLASS", Constant::Bool(features.has_glass)),
            ("HAS_GLTF", Constant::Bool(features.has_gltf)),
            ("HAS_SKY_PICTURE", Constant::Bool(features.has_sky_picture)),
            ("WORKGROUP", Constant::U32(WORKGROUP)),
            ("SMOOTH_ALPHA", Constant::F32(SMOOTH_ALPHA)),
            ("FLOAT_MAX", Constant::F32(f32::MAX)),
            ("GAMMA_5", Constant::F32(GAMMA_5)),
            ("GAMMA_19", Constant::F32(GAMMA_19)),
            ("ROULETTE_FREE_BOUNCES", Constant::U32(ROULETTE_FREE_BOUNCES)),
            ("SURVIVAL_MAX", Constant::F32(SURVIVAL_MAX)),
            ("LIKE_COS", Constant::F32(LIKE_COS)),
        ];
        constants.extend(TEXTURE_FLAGS.map(|(name, value)| (name, Constant::U32(value))));
        constants.extend(trees.constants(if features.has_masks { Masks::Asked } else { Masks::None }));
        let (trees_group, trees_layout) = (trees.bind(session)?, GpuTrees::layout(session)?);
        Ok(GpuWorld { _trees: trees, trees_group, trees_layout, _buffers: buffers, group, layout, constants })
    }
}

impl GpuWorld {
    fn constants_of_shade(&self, asks: bool) -> Vec<(&'static str, Constant)> {
        let mut constants = self.constants.clone();
        constants.push(("HAS_SECONDARY", Constant::Bool(asks)));
        constants
    }
}

/// What is known of a scene's light, on a card.
#[derive(Debug)]
struct LightOnCard {
    /// `None`: nothing is known.
    known: Option<Arc<dyn SecondaryLight>>,
    /// Kept for as long as the group that binds them.
    _buffers: Vec<Buffer>,
    group: BindGroup,
    layout: Arc<Layout>,
}

impl LightOnCard {
    fn new(session: &Arc<Session>, known: &Arc<dyn SecondaryLight>) -> Result<LightOnCard, GpuError> {
        let Some(packed) = known.packed() else {
            let what = format!("the light that {} knows is not packed for graphics cards", known.card().name);
            return Err(GpuError::Failed { what });
        };
        LightOnCard::of(session, Some(Arc::clone(known)), &packed)
    }

    /// No light at all.
    fn nothing(session: &Arc<Session>) -> Result<LightOnCard, GpuError> {
        let (words, sets, vdls) = (Vec::new(), Vec::new(), Vec::new());
        let packed = PackedLight { header: GpuOctreeHeader::zeroed(), words, sets, vdls };
        LightOnCard::of(session, None, &packed)
    }

    fn of(
        session: &Arc<Session>,
        known: Option<Arc<dyn SecondaryLight>>,
        packed: &PackedLight,
    ) -> Result<LightOnCard, GpuError> {
        let buffers = vec![
            session.buffer_of("octree header", &[packed.header])?,
            session.buffer_of("octree", &packed.words)?,
            session.buffer_of("light sets", &packed.sets)?,
            session.buffer_of("virtual lights", &packed.vdls)?,
        ];
        let layout = session.layout(&[Binding::Uniform, Binding::Read, Binding::Read, Binding::Read])?;
        let group = session.bind(&layout, &buffers.iter().collect::<Vec<_>>())?;
        Ok(LightOnCard { known, _buffers: buffers, group, layout })
    }
}

/// Places for the paths of a slice.
#[derive(Debug)]
struct Places {
    header: Buffer,
    samples: Buffer,
    counters: Buffer,
    /// Kept for as long as the group that binds them.
    _others: Vec<Buffer>,
    group: BindGroup,
    layout: Arc<Layout>,
    capacity: u32,
}

impl Places {
    fn new(session: &Session, capacity: u32) -> Result<Places, GpuError> {
        let count = u64::from(capacity);
        let header = session.buffer_zeroed("pass", size_of::<GpuPassHeader>() as u64)?;
        let paths = session.buffer_zeroed("paths", count * PATH_BYTES)?;
        let hits = session.buffer_zeroed("hits", count * HIT_BYTES)?;
        let shadows = session.buffer_zeroed("shadow rays", count * SHADOW_BYTES)?;
        let samples = session.buffer_zeroed("samples", count * SAMPLE_BYTES)?;
        let queues = session.buffer_zeroed("queues", count * QUEUES_BYTES)?;
        let counters = session.buffer_zeroed("counters", size_of::<GpuCounters>() as u64)?;
        let layout = session.layout(&[
            Binding::Uniform,
            Binding::Write,
            Binding::Write,
            Binding::Write,
            Binding::Write,
            Binding::Write,
            Binding::Write,
        ])?;
        let group =
            session.bind(&layout, &[&header, &paths, &hits, &shadows, &samples, &queues, &counters])?;
        let others = vec![paths, hits, shadows, queues];
        Ok(Places { header, samples, counters, _others: others, group, layout, capacity })
    }
}

/// Everything on one device that paths need.
#[derive(Debug)]
struct Ready {
    session: Arc<Session>,
    world: GpuWorld,
    places: Places,
    sizes: Buffer,
    sizes_group: BindGroup,
    begin: Arc<Pipeline>,
    closest: Arc<Pipeline>,
    shade: Arc<Pipeline>,
    turn: Arc<Pipeline>,
    occluded: Arc<Pipeline>,
    /// The same step, where it asks for light; compiled when it first does.
    shade_asking: Option<Arc<Pipeline>>,
    /// What that asks.
    light: Option<LightOnCard>,
    /// It is the one that runs.
    asks: bool,
    /// Seconds of compiling shaders, also as far as the driver compiles them at first use.
    shader_seconds: f64,
}

impl Ready {
    fn new(session: Arc<Session>, world: &World, capacity: u32) -> Result<Ready, GpuError> {
        let compiled = session.shader_seconds();
        let world = GpuWorld::new(&session, world)?;
        let places = Places::new(&session, capacity)?;
        let sizes = session.buffer_zeroed("sizes", DISPATCH_BYTES)?;
        let sizes_layout = session.layout(&[Binding::Write])?;
        let sizes_group = session.bind(&sizes_layout, &[&sizes])?;
        let layouts = [&*world.trees_layout, &*world.layout, &*places.layout];
        let pipeline = |step: &'static Shader| session.pipeline(step, &world.constants, &layouts);
        let shade = session.pipeline(&PATH_SHADE, &world.constants_of_shade(false), &layouts)?;
        let turn_layouts = [&*world.trees_layout, &*world.layout, &*places.layout, &*sizes_layout];
        let mut ready = Ready {
            begin: pipeline(&PATH_BEGIN)?,
            closest: pipeline(&PATH_CLOSEST)?,
            shade,
            occluded: pipeline(&PATH_OCCLUDED)?,
            turn: session.pipeline(&PATH_TURN, &world.constants, &turn_layouts)?,
            places,
            sizes,
            sizes_group,
            shade_asking: None,
            light: None,
            asks: false,
            world,
            shader_seconds: session.shader_seconds() - compiled,
            session,
        };
        ready.use_first()?;
        Ok(ready)
    }

    /// Room for slices of so many paths, if there is less.
    fn make_room(&mut self, capacity: u32) -> Result<(), GpuError> {
        if self.places.capacity < capacity {
            self.places = Places::new(&self.session, capacity)?;
        }
        Ok(())
    }

    /// Some drivers compile at first use: that is waiting for shaders, not drawing.
    fn use_first(&mut self) -> Result<(), GpuError> {
        let start = Instant::now();
        self.trace(&GpuPassHeader::zeroed(), 0, 1)?;
        self.shader_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Asks `known` for light from now on, or nobody. What was known stays on the card until something else is: films that ask
    /// and films that do not take turns.
    fn ask(&mut self, known: Option<&Arc<dyn SecondaryLight>>) -> Result<(), GpuError> {
        let Some(known) = known else {
            self.asks = false;
            return Ok(());
        };
        let before = self.light.as_ref().and_then(|light| light.known.as_ref());
        if !before.is_some_and(|before| Arc::ptr_eq(before, known)) {
            // The old light makes room first.
            self.light = None;
            self.light = Some(LightOnCard::new(&self.session, known)?);
        }
        self.be_able_to_ask()
    }

    /// Goes on with the step that asks for light, which is compiled first where that was not done.
    fn be_able_to_ask(&mut self) -> Result<(), GpuError> {
        if self.light.is_none() {
            self.light = Some(LightOnCard::nothing(&self.session)?);
        }
        self.asks = true;
        if let (None, Some(light)) = (&self.shade_asking, &self.light) {
            let compiled = self.session.shader_seconds();
            let world = &self.world;
            let layouts = [&*world.trees_layout, &*world.layout, &*self.places.layout, &*light.layout];
            let constants = world.constants_of_shade(true);
            self.shade_asking = Some(self.session.pipeline(&PATH_SHADE_BY_OCTREE, &constants, &layouts)?);
            self.shader_seconds += self.session.shader_seconds() - compiled;
            self.use_first()?;
        }
        Ok(())
    }

    /// The step that shades, and the groups that it reads.
    fn shading<'a>(&'a self, groups: &[&'a BindGroup; 3]) -> (&'a Pipeline, Vec<&'a BindGroup>) {
        match (&self.shade_asking, &self.light) {
            (Some(shade), Some(light)) if self.asks => (shade, [&groups[..], &[&light.group]].concat()),
            _ => (&self.shade, groups.to_vec()),
        }
    }

    /// A batch of the slice that `header` describes: its beginning, if `done` is 0, and so many scatterings. What is left
    /// to do.
    fn trace(&self, header: &GpuPassHeader, done: u32, scatterings: u32) -> Result<GpuCounters, GpuError> {
        let mut batch = self.session.batch("paths")?;
        let groups = [&self.world.trees_group, &self.world.group, &self.places.group];
        let (shade, shade_groups) = self.shading(&groups);
        if done == 0 {
            self.session.write(&self.places.header, 0, bytemuck::bytes_of(header))?;
            let all = [header.path_count.div_ceil(WORKGROUP).max(1), 1, 1];
            batch.dispatch(&self.begin, &groups, all)?;
            batch.dispatch(&self.closest, &groups, all)?;
            batch.dispatch(shade, &shade_groups, all)?;
            self.turn(&mut batch, &groups)?;
        }
        for _ in u32::from(done == 0)..scatterings {
            batch.dispatch_indirect(&self.closest, &groups, &self.sizes, 0)?;
            batch.dispatch_indirect(shade, &shade_groups, &self.sizes, 0)?;
            self.turn(&mut batch, &groups)?;
        }
        let counters = batch.read_back(&self.places.counters, 0..size_of::<GpuCounters>() as u64)?;
        batch.submit()?;
        Ok(bytemuck::pod_read_unaligned(&counters.collect()?))
    }

    /// A slice until its last path has ended.
    fn trace_all(&self, header: &GpuPassHeader) -> Result<Slice, GpuError> {
        let start = Instant::now();
        let mut scatterings = SCATTERINGS_FIRST;
        let mut counters = self.trace(header, 0, scatterings)?;
        let first_seconds = start.elapsed().as_secs_f64();
        while counters.ray_count > 0 {
            scatterings = (scatterings * 2).min(SCATTERINGS_MAX);
            counters = self.trace(header, 1, scatterings)?;
        }
        let counts = Counts {
            rays: u64::from(counters.rays),
            shadow_rays: u64::from(counters.shadow_rays),
            paths: u64::from(header.path_count),
        };
        let bytes = 0..u64::from(header.path_count) * SAMPLE_BYTES;
        Ok(Slice { samples: self.session.read(&self.places.samples, bytes)?, counts, first_seconds })
    }

    /// The shadow rays of a scattering, once it is known how many there are.
    fn turn(&self, batch: &mut Batch, groups: &[&BindGroup; 3]) -> Result<(), GpuError> {
        let [trees, world, state] = *groups;
        batch.dispatch(&self.turn, &[trees, world, state, &self.sizes_group], [1, 1, 1])?;
        batch.dispatch_indirect(&self.occluded, groups, &self.sizes, SHADOW_SIZES_AT)
    }
}

/// What a slice brought.
struct Slice {
    /// [`GpuPixelSample`]s.
    samples: Vec<u8>,
    counts: Counts,
    /// Of its first batch, the longest.
    first_seconds: f64,
}

/// A scene on a card, with places for paths: pictures of it share both, one slice at a time.
///
/// Nothing is uploaded before a picture draws, and all is uploaded again where the device was lost.
#[derive(Debug)]
pub struct GpuScene {
    gpu: Arc<Gpu>,
    world: Arc<World>,
    /// The adapter is the CPU itself.
    is_software: bool,
    ready: Mutex<Option<Ready>>,
    /// Devices lost one after the other without a finished pass, by whichever picture.
    losses: AtomicU32,
}

impl GpuScene {
    /// Of a world as it is.
    pub fn new(gpu: Arc<Gpu>, world: Arc<World>) -> GpuScene {
        let is_software = gpu.report().kind == AdapterKind::Software;
        GpuScene { gpu, world, is_software, ready: Mutex::default(), losses: AtomicU32::new(0) }
    }

    /// The world.
    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// The card.
    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// Bytes on the card, of all scenes.
    pub fn bytes(&self) -> u64 {
        locked(&self.ready).as_ref().map_or(0, |ready| ready.session.bytes_held())
    }

    /// Seconds that compiling shaders took, for pictures that are drawn by now.
    pub fn shader_seconds(&self) -> f64 {
        locked(&self.ready).as_ref().map_or(0.0, |ready| ready.shader_seconds)
    }

    /// Uploads all and compiles what pictures need, so that their first pass waits for neither.
    ///
    /// - `asks`: some ask a [`SecondaryLight`]
    ///
    /// Errors: what the card does not do.
    pub fn make_ready(&self, asks: bool) -> Result<(), GpuError> {
        let mut held = locked(&self.ready);
        let ready = match &mut *held {
            Some(ready) => ready,
            nothing => nothing.insert(Ready::new(self.gpu.session()?, &self.world, SLICE_MIN)?),
        };
        if asks { ready.be_able_to_ask() } else { Ok(()) }
    }

    /// Runs `work` with all that is needed, on a device that works.
    fn with_ready<T>(
        &self,
        pixel_count: usize,
        known: Option<&Arc<dyn SecondaryLight>>,
        work: impl FnOnce(&Ready) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let most = if self.is_software { SOFTWARE_SLICE_MAX } else { SLICE_MAX };
        let capacity = u32::try_from(pixel_count).unwrap_or(u32::MAX).clamp(1, most);
        let mut held = locked(&self.ready);
        if held.as_ref().is_some_and(|ready| ready.session.check().is_err()) {
            *held = None;
        }
        let ready = match &mut *held {
            Some(ready) => ready,
            nothing => nothing.insert(Ready::new(self.gpu.session()?, &self.world, capacity)?),
        };
        let result = ready.make_room(capacity).and_then(|()| ready.ask(known)).and_then(|()| work(ready));
        if result.is_err() {
            // What was half done is done anew.
            *held = None;
        }
        result
    }

    /// Takes it off the card; whoever draws it again brings it back.
    pub fn withdraw(&self) {
        *locked(&self.ready) = None;
    }
}

/// What a lock holds: whole values, whatever became of the thread that held it.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A pass that was begun.
#[derive(Debug)]
struct Begun {
    header: GpuPassHeader,
    pass: u32,
    /// Of the pixels so far, in rows.
    samples: Vec<GpuPixelSample>,
}

/// Path tracing on a graphics card, by itself or asking a [`SecondaryLight`] that is [packed](SecondaryLight::packed) for it.
///
/// After an error it draws nothing more and says why: [`GpuPathTracer::failure`]. The film is then as valid as before, and the
/// CPU goes on with the same samples.
#[derive(Debug)]
pub struct GpuPathTracer {
    scene: Arc<GpuScene>,
    settings: PathSettings,
    secondary: Option<Arc<dyn SecondaryLight>>,
    begun: Option<Begun>,
    /// Paths of the next slice.
    slice: u32,
    failure: Option<GpuError>,
}

impl GpuPathTracer {
    /// Memory of a pass that was begun, beside the card's.
    pub const BYTES_PER_PIXEL: usize = SAMPLE_BYTES as usize;

    /// Pictures of a scene; steps are to be of the same world.
    pub fn new(scene: Arc<GpuScene>, settings: PathSettings) -> GpuPathTracer {
        GpuPathTracer { scene, settings, secondary: None, begun: None, slice: SLICE_MIN, failure: None }
    }

    /// Draws what `tracer` would from now on; maps of caustics excepted.
    pub fn draw_as(&mut self, tracer: &PathTracer) {
        let is_same = match (&self.secondary, &tracer.secondary) {
            (None, None) => true,
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        if self.settings != tracer.settings || !is_same {
            self.settings = tracer.settings;
            self.secondary.clone_from(&tracer.secondary);
            self.begun = None;
        }
    }

    /// Why it draws nothing more.
    pub fn failure(&self) -> Option<&GpuError> {
        self.failure.as_ref()
    }

    /// The scene that it draws.
    pub fn scene(&self) -> &Arc<GpuScene> {
        &self.scene
    }

    /// Samples of the next slice of a pass, and the work they took.
    fn trace_slice(&mut self, begun: &mut Begun, pixel_count: usize) -> Result<Counts, GpuError> {
        let first_pixel = begun.samples.len() as u32;
        let wanted = self.slice.min(pixel_count as u32 - first_pixel);
        let slice = self.scene.with_ready(pixel_count, self.secondary.as_ref(), |ready| {
            let capacity = ready.places.capacity;
            let path_count = wanted.min(capacity);
            ready.trace_all(&GpuPassHeader { first_pixel, path_count, capacity, ..begun.header })
        })?;
        begun.samples.extend(
            slice
                .samples
                .chunks_exact(SAMPLE_BYTES as usize)
                .map(bytemuck::pod_read_unaligned::<GpuPixelSample>),
        );
        let is_software = self.scene.is_software;
        let seconds_max = if is_software { SOFTWARE_BATCH_SECONDS } else { BATCH_SECONDS };
        let most = if is_software { SOFTWARE_SLICE_MAX } else { SLICE_MAX };
        if slice.first_seconds > seconds_max {
            self.slice = (self.slice / 2).max(SLICE_MIN);
        } else if slice.first_seconds < seconds_max / 3.0 && wanted == self.slice {
            self.slice = (self.slice * 2).min(most);
        }
        Ok(slice.counts)
    }

    /// The whole pass, or as far as it came.
    fn trace_pass(&mut self, step: &mut Step<'_>) -> Result<Progress, GpuError> {
        let mut progress = Progress { complete: true, ..Progress::default() };
        let Some(Canvas { view, film }) = &mut step.canvas else { return Ok(progress) };
        let pass = film.passes_min();
        let pixel_count = film.size().pixel_count();
        let header = self.header_of(view, film, pass);
        let of_this = |begun: &Begun| begun.header == header && begun.pass == pass;
        let mut begun = match self.begun.take().filter(of_this) {
            Some(begun) => begun,
            None => Begun { header, pass, samples: room_for(pixel_count)? },
        };
        while begun.samples.len() < pixel_count {
            if step.cancel.load(Ordering::Relaxed) {
                self.begun = Some(begun);
                return Ok(Progress { complete: false, ..progress });
            }
            progress.counts += self.trace_slice(&mut begun, pixel_count)?;
        }
        self.add_to(film, &begun.samples);
        self.scene.losses.store(0, Ordering::Relaxed);
        Ok(progress)
    }

    fn header_of(&self, view: &View, film: &Film, pass: u32) -> GpuPassHeader {
        let seed_key = PixelSampler::seed_key(self.settings.seed);
        GpuPassHeader {
            origin: view.origin.into(),
            half_width: view.half_size[0],
            right: view.right.into(),
            half_height: view.half_size[1],
            up: view.up.into(),
            is_perspective: u32::from(view.is_perspective),
            back: view.back.into(),
            width: film.size().width(),
            seed_key: [seed_key as u32, (seed_key >> 32) as u32],
            // As on the CPU: even and odd passes draw from sequences of their own.
            sequence: pass & 1,
            index: pass >> 1,
            height: film.size().height(),
            traced: self.settings.traced.bits(),
            bounces_end: self.settings.bounces_max.unwrap_or(BOUNCES_END),
            ..GpuPassHeader::zeroed()
        }
    }

    fn add_to(&self, film: &mut Film, samples: &[GpuPixelSample]) {
        let width = film.size().width() as usize;
        let [least, most] = [film.passes_min(), film.passes_max()];
        let shown = self.settings.shown;
        film.tiles_mut().par_iter_mut().filter(|tile| least == most || tile.passes() < most).for_each(
            |tile| {
                tile.add_pass(|x, y| {
                    let mut sample = sample_of(&samples[y as usize * width + x as usize]);
                    for class in PathClass::ALL.into_iter().filter(|class| !shown.contains(*class)) {
                        sample.radiance[class as usize] = Rgb::BLACK;
                    }
                    sample
                });
            },
        );
    }
}

/// Room for the samples of a pass.
fn room_for(pixel_count: usize) -> Result<Vec<GpuPixelSample>, GpuError> {
    let mut samples = Vec::new();
    let refused = |_| GpuError::OutOfMemory {
        name: "samples of a pass".into(),
        byte_count: pixel_count as u64 * SAMPLE_BYTES,
        bytes_allowed: 0,
        limit: "this machine's memory",
    };
    samples.try_reserve_exact(pixel_count).map_err(refused)?;
    Ok(samples)
}

fn sample_of(packed: &GpuPixelSample) -> PixelSample {
    PixelSample {
        radiance: [packed.emitted, packed.direct, packed.caustic, packed.indirect].map(Rgb::from),
        albedo: Rgb::new(packed.albedo_red, packed.albedo_green, packed.albedo_blue),
        normal: Vec3::from(packed.normal),
        depth_m: packed.depth_m,
    }
}

impl Technique for GpuPathTracer {
    fn card(&self) -> &'static Card {
        self.secondary.as_ref().map_or(&CARD, |secondary| secondary.card())
    }

    fn step(&mut self, step: &mut Step<'_>) -> Progress {
        if self.failure.is_some() {
            return Progress::default();
        }
        match self.trace_pass(step) {
            Ok(progress) => progress,
            // The next step opens another device and uploads again.
            Err(GpuError::Lost) if self.scene.losses.fetch_add(1, Ordering::Relaxed) < LOSSES_MAX => {
                Progress::default()
            }
            Err(error) => {
                self.failure = Some(error);
                Progress::default()
            }
        }
    }

    fn apply(&mut self, _edit: &Edit<'_>) {
        // Another world is another scene on the card.
        self.begun = None;
    }
}
