//! A scene on a graphics card, with places for paths: what is uploaded, and kept for pictures to share.

use std::sync::{Arc, Mutex, atomic::AtomicU32};

use bytemuck::Zeroable;
use lumicast_shaders::Constant;

use super::{
    BATCH_SECONDS, SOFTWARE_BATCH_SECONDS,
    tracing::{PathStart, Paths, SLICE_MAX, SLICE_MIN, SOFTWARE_SLICE_MAX, Tracing, WORKGROUP},
};
use crate::{
    accel::{GAMMA_5, GAMMA_19},
    gpu::{AdapterKind, BindGroup, Binding, Buffer, Gpu, GpuError, GpuTrees, Layout, Masks, Session, locked},
    technique::{
        GpuOctreeHeader, LIKE_COS, PackedLight, SecondaryLight,
        path::cpu::{BOUNCES_END, FROM_DIMENSION, NEAR_BLURS, NEAR_MAX, ROULETTE_FREE_BOUNCES, SURVIVAL_MAX},
    },
    transport::{TEXTURE_FLAGS, World, WorldBuffers, bsdf::SMOOTH_ALPHA},
};

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
            ("BOUNCES_END", Constant::U32(BOUNCES_END)),
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
    pub(super) fn constants_of_shade(&self, from: PathStart, asks: bool) -> Vec<(&'static str, Constant)> {
        let mut constants = self.constants.clone();
        constants.push(("HAS_SECONDARY", Constant::Bool(asks)));
        constants.push(("LOOKS_PAST", Constant::Bool(asks && from == PathStart::Rays)));
        constants.push(("NEAR_BLURS", Constant::F32(NEAR_BLURS)));
        constants.push(("NEAR_MAX", Constant::U32(NEAR_MAX)));
        constants.push(("SHADOWS_KNOWN", Constant::Bool(asks && from == PathStart::Pixels)));
        constants.push(("FROM_DIMENSION", Constant::U32(FROM_DIMENSION)));
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

/// Everything on one device that paths need.
#[derive(Debug)]
struct Ready {
    session: Arc<Session>,
    world: GpuWorld,
    /// Paths of pixels and of rays, each once they were asked for.
    pixels: Option<Paths>,
    rays: Option<Paths>,
    /// What was last asked for light. It stays on the card until something else is: films that ask and films that do not take
    /// turns.
    light: Option<LightOnCard>,
    /// Seconds of compiling shaders, also as far as the driver compiles them at first use.
    shader_seconds: f64,
}

impl Ready {
    fn new(session: Arc<Session>, world: &World) -> Result<Ready, GpuError> {
        let world = GpuWorld::new(&session, world)?;
        Ok(Ready { session, world, pixels: None, rays: None, light: None, shader_seconds: 0.0 })
    }

    /// Has places for so many paths of a slice and the steps they go through, also those that ask for light.
    fn prepare(&mut self, from: PathStart, capacity: u32, asks: bool) -> Result<(), GpuError> {
        let (session, world) = (&self.session, &self.world);
        let compiled = session.shader_seconds();
        if asks && self.light.is_none() {
            self.light = Some(LightOnCard::nothing(session)?);
        }
        let paths = match from {
            PathStart::Pixels => &mut self.pixels,
            PathStart::Rays => &mut self.rays,
        };
        let is_new = paths.is_none();
        let paths = match paths {
            Some(paths) => paths,
            nothing => nothing.insert(Paths::new(session, world, from, capacity)?),
        };
        paths.make_room(session, capacity)?;
        let mut first_seconds = 0.0;
        if is_new {
            first_seconds += Tracing { session, world, paths, light: None }.use_first()?;
        }
        if let Some(light) = self.light.as_ref().filter(|_| asks)
            && paths.be_able_to_ask(session, world, light)?
        {
            first_seconds += Tracing { session, world, paths, light: Some(light) }.use_first()?;
        }
        self.shader_seconds += session.shader_seconds() - compiled + first_seconds;
        Ok(())
    }

    /// Brings what `known` knows to the card.
    fn bring(&mut self, known: &Arc<dyn SecondaryLight>) -> Result<(), GpuError> {
        let before = self.light.as_ref().and_then(|light| light.known.as_ref());
        if !before.is_some_and(|before| Arc::ptr_eq(before, known)) {
            // The old light makes room first.
            self.light = None;
            self.light = Some(LightOnCard::new(&self.session, known)?);
        }
        Ok(())
    }

    /// What traces paths that ask for light, or nobody; after [`Ready::prepare`].
    fn tracing(&self, from: PathStart, asks: bool) -> Result<Tracing<'_>, GpuError> {
        let paths = match from {
            PathStart::Pixels => &self.pixels,
            PathStart::Rays => &self.rays,
        };
        let unprepared = || GpuError::Failed { what: "paths were not prepared".into() };
        let paths = paths.as_ref().ok_or_else(unprepared)?;
        let light = self.light.as_ref().filter(|_| asks);
        Ok(Tracing { session: &self.session, world: &self.world, paths, light })
    }
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
    ready: Mutex<Option<Ready>>,
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
        self.prepare(PathStart::Pixels, asks)
    }

    /// The same for gathering light along rays.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready_to_gather(&self, asks: bool) -> Result<(), GpuError> {
        self.prepare(PathStart::Rays, asks)
    }

    fn prepare(&self, from: PathStart, asks: bool) -> Result<(), GpuError> {
        self.with_ready(&mut locked(&self.ready), |ready| ready.prepare(from, SLICE_MIN, asks))
    }

    /// Most paths of a slice.
    fn slice_max(&self) -> u32 {
        if self.is_software { SOFTWARE_SLICE_MAX } else { SLICE_MAX }
    }

    /// Paths of the slice after one of so many, of which `traced` were there, by the seconds that its first batch took.
    pub(super) fn slice_after(&self, slice: u32, traced: u32, first_seconds: f64) -> u32 {
        let seconds_max = if self.is_software { SOFTWARE_BATCH_SECONDS } else { BATCH_SECONDS };
        if first_seconds > seconds_max {
            (slice / 2).max(SLICE_MIN)
        } else if first_seconds < seconds_max / 3.0 && traced == slice {
            (slice * 2).min(self.slice_max())
        } else {
            slice
        }
    }

    /// Runs `work` with all that is needed for paths of one kind, on a device that works.
    ///
    /// - `path_count`: most paths of a slice, as far as there is room for them
    pub(super) fn trace_with<T>(
        &self,
        from: PathStart,
        path_count: usize,
        known: Option<&Arc<dyn SecondaryLight>>,
        work: impl FnOnce(Tracing<'_>) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let capacity = u32::try_from(path_count).unwrap_or(u32::MAX).clamp(1, self.slice_max());
        self.with_ready(&mut locked(&self.ready), |ready| {
            if let Some(known) = known {
                ready.bring(known)?;
            }
            ready.prepare(from, capacity, known.is_some())?;
            work(ready.tracing(from, known.is_some())?)
        })
    }

    /// Runs `work` with what is on a device that works.
    fn with_ready<T>(
        &self,
        held: &mut Option<Ready>,
        work: impl FnOnce(&mut Ready) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        if held.as_ref().is_some_and(|ready| ready.session.check().is_err()) {
            self.let_go(held);
        }
        let ready = match &mut *held {
            Some(ready) => ready,
            nothing => nothing.insert(Ready::new(self.gpu.session()?, &self.world)?),
        };
        let result = work(ready);
        if result.is_err() {
            // What was half done is done anew.
            self.let_go(held);
        }
        result
    }

    /// Takes it off the card; whoever draws it again brings it back.
    pub fn withdraw(&self) {
        self.let_go(&mut locked(&self.ready));
    }
}
