//! A scene on a graphics card, with places for the paths of a slice: what is uploaded and compiled, and how a slice is traced.

use std::{
    sync::{Arc, Mutex, atomic::AtomicU32},
    time::Instant,
};

use bytemuck::Zeroable;
use lumicast_shaders::{
    Constant, PATH_BEGIN, PATH_CLOSEST, PATH_OCCLUDED, PATH_SHADE, PATH_SHADE_BY_OCTREE, PATH_TURN,
    Step as Shader,
};

use super::{GpuCounters, GpuPassHeader, GpuPixelSample};
use crate::{
    accel::{GAMMA_5, GAMMA_19},
    gpu::{
        AdapterKind, Batch, BindGroup, Binding, Buffer, Gpu, GpuError, GpuTrees, Layout, Masks, Pipeline,
        Session, locked,
    },
    technique::{
        Counts, GpuOctreeHeader, LIKE_COS, PackedLight, SecondaryLight,
        path::cpu::{ROULETTE_FREE_BOUNCES, SURVIVAL_MAX},
    },
    transport::{TEXTURE_FLAGS, World, WorldBuffers, bsdf::SMOOTH_ALPHA},
};

/// Invocations of a workgroup.
pub(super) const WORKGROUP: u32 = 64;
/// Fewest and most paths of a slice, 288 bytes each: cards run some 10⁵ at once, and every scene that is looked at has places of
/// its own.
pub(super) const SLICE_MIN: u32 = 4096;
pub(super) const SLICE_MAX: u32 = 1 << 18;
/// The same where the adapter is the CPU itself.
pub(super) const SOFTWARE_SLICE_MAX: u32 = 1 << 16;
/// Scatterings of the first batch of a slice, and most of a later one, which has ever fewer paths.
pub(super) const SCATTERINGS_FIRST: u32 = 4;
pub(super) const SCATTERINGS_MAX: u32 = 64;

/// Bytes of a path on the card, by buffer: state, hit, shadow ray, sample, places in three queues.
pub(super) const PATH_BYTES: u64 = 96;
pub(super) const HIT_BYTES: u64 = 20;
pub(super) const SHADOW_BYTES: u64 = 80;
pub(super) const SAMPLE_BYTES: u64 = size_of::<GpuPixelSample>() as u64;
pub(super) const QUEUES_BYTES: u64 = 12;
pub(super) const DISPATCH_BYTES: u64 = 32;
/// Where the sizes of shadow rays begin in the buffer of sizes.
pub(super) const SHADOW_SIZES_AT: u64 = 12;

/// A scene on a card.
#[derive(Debug)]
pub(super) struct GpuWorld {
    /// Kept for as long as the group that binds them.
    pub(super) _trees: GpuTrees,
    pub(super) trees_group: BindGroup,
    pub(super) trees_layout: Arc<Layout>,
    /// Kept for as long as the group that binds them.
    pub(super) _buffers: Vec<Buffer>,
    pub(super) group: BindGroup,
    pub(super) layout: Arc<Layout>,
    pub(super) constants: Vec<(&'static str, Constant)>,
}

impl GpuWorld {
    pub(super) fn new(session: &Arc<Session>, world: &World) -> Result<GpuWorld, GpuError> {
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
    pub(super) fn constants_of_shade(&self, asks: bool) -> Vec<(&'static str, Constant)> {
        let mut constants = self.constants.clone();
        constants.push(("HAS_SECONDARY", Constant::Bool(asks)));
        constants
    }
}

/// What is known of a scene's light, on a card.
#[derive(Debug)]
pub(super) struct LightOnCard {
    /// `None`: nothing is known.
    pub(super) known: Option<Arc<dyn SecondaryLight>>,
    /// Kept for as long as the group that binds them.
    pub(super) _buffers: Vec<Buffer>,
    pub(super) group: BindGroup,
    pub(super) layout: Arc<Layout>,
}

impl LightOnCard {
    pub(super) fn new(
        session: &Arc<Session>,
        known: &Arc<dyn SecondaryLight>,
    ) -> Result<LightOnCard, GpuError> {
        let Some(packed) = known.packed() else {
            let what = format!("the light that {} knows is not packed for graphics cards", known.card().name);
            return Err(GpuError::Failed { what });
        };
        LightOnCard::of(session, Some(Arc::clone(known)), &packed)
    }

    /// No light at all.
    pub(super) fn nothing(session: &Arc<Session>) -> Result<LightOnCard, GpuError> {
        let (words, sets, vdls) = (Vec::new(), Vec::new(), Vec::new());
        let packed = PackedLight { header: GpuOctreeHeader::zeroed(), words, sets, vdls };
        LightOnCard::of(session, None, &packed)
    }

    pub(super) fn of(
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
pub(super) struct Places {
    pub(super) header: Buffer,
    pub(super) samples: Buffer,
    pub(super) counters: Buffer,
    /// Kept for as long as the group that binds them.
    pub(super) _others: Vec<Buffer>,
    pub(super) group: BindGroup,
    pub(super) layout: Arc<Layout>,
    pub(super) capacity: u32,
}

impl Places {
    pub(super) fn new(session: &Session, capacity: u32) -> Result<Places, GpuError> {
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
pub(super) struct Ready {
    pub(super) session: Arc<Session>,
    pub(super) world: GpuWorld,
    pub(super) places: Places,
    pub(super) sizes: Buffer,
    pub(super) sizes_group: BindGroup,
    pub(super) begin: Arc<Pipeline>,
    pub(super) closest: Arc<Pipeline>,
    pub(super) shade: Arc<Pipeline>,
    pub(super) turn: Arc<Pipeline>,
    pub(super) occluded: Arc<Pipeline>,
    /// The same step, where it asks for light; compiled when it first does.
    pub(super) shade_asking: Option<Arc<Pipeline>>,
    /// What that asks.
    pub(super) light: Option<LightOnCard>,
    /// It is the one that runs.
    pub(super) asks: bool,
    /// Seconds of compiling shaders, also as far as the driver compiles them at first use.
    pub(super) shader_seconds: f64,
}

impl Ready {
    pub(super) fn new(session: Arc<Session>, world: &World, capacity: u32) -> Result<Ready, GpuError> {
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
    pub(super) fn make_room(&mut self, capacity: u32) -> Result<(), GpuError> {
        if self.places.capacity < capacity {
            self.places = Places::new(&self.session, capacity)?;
        }
        Ok(())
    }

    /// Some drivers compile at first use: that is waiting for shaders, not drawing.
    pub(super) fn use_first(&mut self) -> Result<(), GpuError> {
        let start = Instant::now();
        self.trace(&GpuPassHeader::zeroed(), 0, 1)?;
        self.shader_seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Asks `known` for light from now on, or nobody. What was known stays on the card until something else is: films that ask
    /// and films that do not take turns.
    pub(super) fn ask(&mut self, known: Option<&Arc<dyn SecondaryLight>>) -> Result<(), GpuError> {
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
    pub(super) fn be_able_to_ask(&mut self) -> Result<(), GpuError> {
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
    pub(super) fn shading<'a>(&'a self, groups: &[&'a BindGroup; 3]) -> (&'a Pipeline, Vec<&'a BindGroup>) {
        match (&self.shade_asking, &self.light) {
            (Some(shade), Some(light)) if self.asks => (shade, [&groups[..], &[&light.group]].concat()),
            _ => (&self.shade, groups.to_vec()),
        }
    }

    /// A batch of the slice that `header` describes: its beginning, if `done` is 0, and so many scatterings. What is left
    /// to do.
    pub(super) fn trace(
        &self,
        header: &GpuPassHeader,
        done: u32,
        scatterings: u32,
    ) -> Result<GpuCounters, GpuError> {
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
    pub(super) fn trace_all(&self, header: &GpuPassHeader) -> Result<Slice, GpuError> {
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
    pub(super) fn turn(&self, batch: &mut Batch, groups: &[&BindGroup; 3]) -> Result<(), GpuError> {
        let [trees, world, state] = *groups;
        batch.dispatch(&self.turn, &[trees, world, state, &self.sizes_group], [1, 1, 1])?;
        batch.dispatch_indirect(&self.occluded, groups, &self.sizes, SHADOW_SIZES_AT)
    }
}

/// What a slice brought.
pub(super) struct Slice {
    /// [`GpuPixelSample`]s.
    pub(super) samples: Vec<u8>,
    pub(super) counts: Counts,
    /// Of its first batch, the longest.
    pub(super) first_seconds: f64,
}

/// A scene on a card, with places for paths: pictures of it share both, one slice at a time.
///
/// Nothing is uploaded before a picture draws, and all is uploaded again where the device was lost.
#[derive(Debug)]
pub struct GpuScene {
    pub(super) gpu: Arc<Gpu>,
    pub(super) world: Arc<World>,
    /// The adapter is the CPU itself.
    pub(super) is_software: bool,
    pub(super) ready: Mutex<Option<Ready>>,
    /// Seconds of compiling shaders for devices that are gone.
    gone_shader_seconds: Mutex<f64>,
    /// Devices lost one after the other without a finished pass, by whichever picture.
    pub(super) losses: AtomicU32,
}

impl GpuScene {
    /// Of a world as it is.
    pub fn new(gpu: Arc<Gpu>, world: Arc<World>) -> GpuScene {
        let is_software = gpu.report().kind == AdapterKind::Software;
        GpuScene {
            gpu,
            world,
            is_software,
            ready: Mutex::default(),
            gone_shader_seconds: Mutex::default(),
            losses: AtomicU32::new(0),
        }
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

    /// Seconds that compiling shaders took so far.
    pub fn shader_seconds(&self) -> f64 {
        let held = locked(&self.ready);
        *locked(&self.gone_shader_seconds) + held.as_ref().map_or(0.0, |ready| ready.shader_seconds)
    }

    /// Lets go of what is on the card, and remembers what compiling took.
    fn let_go(&self, held: &mut Option<Ready>) {
        *locked(&self.gone_shader_seconds) += held.take().map_or(0.0, |ready| ready.shader_seconds);
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

    /// Most paths of a slice.
    pub(super) fn slice_max(&self) -> u32 {
        if self.is_software { SOFTWARE_SLICE_MAX } else { SLICE_MAX }
    }

    /// Runs `work` with all that is needed, on a device that works.
    pub(super) fn with_ready<T>(
        &self,
        pixel_count: usize,
        known: Option<&Arc<dyn SecondaryLight>>,
        work: impl FnOnce(&Ready) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let capacity = u32::try_from(pixel_count).unwrap_or(u32::MAX).clamp(1, self.slice_max());
        let mut held = locked(&self.ready);
        if held.as_ref().is_some_and(|ready| ready.session.check().is_err()) {
            self.let_go(&mut held);
        }
        let ready = match &mut *held {
            Some(ready) => ready,
            nothing => nothing.insert(Ready::new(self.gpu.session()?, &self.world, capacity)?),
        };
        let result = ready.make_room(capacity).and_then(|()| ready.ask(known)).and_then(|()| work(ready));
        if result.is_err() {
            // What was half done is done anew.
            self.let_go(&mut held);
        }
        result
    }

    /// Takes it off the card; whoever draws it again brings it back.
    pub fn withdraw(&self) {
        self.let_go(&mut locked(&self.ready));
    }
}
