//! A scene on a graphics card, with places for paths: what is uploaded, and kept for pictures to share.

use std::sync::{
    Arc, Mutex, MutexGuard,
    atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering},
};

use lumicast_shaders::SHADOW_MAP;

use super::{
    BATCH_SECONDS, SOFTWARE_BATCH_SECONDS,
    known::{Asked, KnownOnCard, Lacking, LightBeside, PackedBeside, Shading},
    lookouts::SceneRaster,
    shadow_maps::{MapSides, Shadowing, Shadows},
    splats::Splatting,
    tracing::{PathStart, Paths, SLICE_MIN, Tracing},
    world::{GpuWorld, PackedScene},
};
use crate::{
    gpu::{AdapterKind, FrameOnCard, Gpu, GpuError, ReadBack, Session, locked},
    transport::{GpuLight, World},
};

/// Everything on one device that paths need.
#[derive(Debug)]
pub(super) struct Ready {
    pub(super) session: Arc<Session>,
    pub(super) world: GpuWorld,
    /// By [`PathStart`], each once they were asked for.
    paths: [Option<Paths>; PathStart::COUNT],
    pub(super) known: KnownOnCard,
    /// What is drawn, once that was asked for.
    pub(super) lookouts: Option<SceneRaster>,
    /// What splats, the same.
    pub(super) splatting: Option<Splatting>,
    /// Maps of shadows, where there are to be any.
    pub(super) shadowing: Option<Shadowing>,
    /// Where there are to be any, whatever lights there are by now: there were some when all was compiled, and there is room.
    pub(super) draws_maps: bool,
    /// What draws them, once that was asked for.
    pub(super) map_raster: Option<SceneRaster>,
    /// Seconds of compiling shaders, also as far as the driver compiles them at first use.
    pub(super) shader_seconds: f64,
}

impl Ready {
    fn new(
        session: Arc<Session>,
        (world, packed): (&World, &PackedScene),
        shadow_map_bytes_max: u64,
    ) -> Result<Ready, GpuError> {
        let shadowing = Ready::shadowing(&session, (world, packed.lights()), shadow_map_bytes_max);
        let world = GpuWorld::new(&session, packed)?;
        let known = KnownOnCard::nothing(&session)?;
        Ok(Ready {
            session,
            world,
            paths: Default::default(),
            known,
            lookouts: None,
            splatting: None,
            draws_maps: shadowing.is_some(),
            shadowing,
            map_raster: None,
            shader_seconds: 0.0,
        })
    }

    /// Maps of shadows that there are to be, if any.
    pub(super) fn shadowing(
        session: &Session,
        (world, lights): (&World, &[GpuLight]),
        bytes_max: u64,
    ) -> Option<Shadowing> {
        let bytes_max = bytes_max.min(session.binding_bytes_max());
        Shadowing::of(world, lights, MapSides::default(), bytes_max)
    }

    /// Has places for so many paths of a slice. Where there is no room for them, maps of shadows go first, then light of single passes, then
    /// all.
    fn make_room(&mut self, from: PathStart, capacity: u32) -> Result<(), GpuError> {
        let forgets: [Forget; 3] = [
            |ready| {
                ready.let_maps_go();
                Ok(())
            },
            |ready| ready.known.forget_focused(&ready.session),
            |ready| ready.known.forget(&ready.session),
        ];
        for forget in forgets {
            match self.add_places(from, capacity) {
                Err(GpuError::OutOfMemory { .. }) => forget(self)?,
                done => return done,
            }
        }
        self.add_places(from, capacity)
    }

    fn add_places(&mut self, from: PathStart, capacity: u32) -> Result<(), GpuError> {
        let (session, world) = (&self.session, &self.world);
        let compiled = session.shader_seconds();
        let paths = match &mut self.paths[from as usize] {
            Some(paths) => paths,
            nothing => nothing.insert(Paths::new(session, world, from, capacity)?),
        };
        paths.make_room(session, world, capacity)?;
        self.shader_seconds += session.shader_seconds() - compiled;
        Ok(())
    }

    /// Has the steps that shade so; after [`Ready::make_room`].
    fn prepare(&mut self, from: PathStart, shading: Shading) -> Result<(), GpuError> {
        let (session, world) = (&self.session, &self.world);
        let compiled = session.shader_seconds();
        let Some(paths) = &mut self.paths[from as usize] else { return Err(unprepared()) };
        let mut first_seconds = 0.0;
        if paths.be_able_to(session, world, &self.known, shading)? {
            let tracing = Tracing { session, world, paths, known: &self.known, shading, maps: None };
            first_seconds = tracing.use_first()?;
        }
        self.shader_seconds += session.shader_seconds() - compiled + first_seconds;
        Ok(())
    }

    /// Has what draws maps of shadows, where there are to be any, and what asks them.
    pub(super) fn be_able_to_map(&mut self) -> Result<(), GpuError> {
        self.make_room(PathStart::Pixels, SLICE_MIN)?;
        let (session, world) = (&self.session, &self.world);
        let compiled = session.shader_seconds();
        let Some(paths) = &mut self.paths[PathStart::Pixels as usize] else { return Err(unprepared()) };
        if self.shadowing.is_some() {
            if self.map_raster.is_none() {
                self.map_raster = Some(SceneRaster::new(session, world, &SHADOW_MAP)?);
            }
            paths.be_able_to_ask_maps(session, world)?;
        }
        self.shader_seconds += session.shader_seconds() - compiled;
        Ok(())
    }

    /// Has maps of shadows, where there are to be any.
    pub(super) fn draw_maps(&mut self, world: &World) -> Result<(), GpuError> {
        self.be_able_to_map()?;
        match (&mut self.shadowing, &self.map_raster) {
            (Some(shadowing), Some(raster)) => {
                shadowing.draw((&self.session, raster), world, &self.world.triangle_counts)
            }
            _ => Ok(()),
        }
    }

    /// Gives the memory of maps of shadows back, and draws none before the scene is brought again. True if there were any.
    pub(super) fn let_maps_go(&mut self) -> bool {
        (self.draws_maps, self.map_raster) = (false, None);
        self.shadowing.take().is_some_and(|shadowing| shadowing.maps().is_some())
    }

    /// What traces such paths; after [`Ready::prepare`].
    fn tracing(&self, from: PathStart, shading: Shading, shadows: Shadows) -> Result<Tracing<'_>, GpuError> {
        let paths = self.paths[from as usize].as_ref().ok_or_else(unprepared)?;
        let maps = match shadows {
            Shadows::ByRays => None,
            Shadows::ByMaps => self.shadowing.as_ref().and_then(Shadowing::maps),
        };
        Ok(Tracing { session: &self.session, world: &self.world, paths, known: &self.known, shading, maps })
    }
}

/// Gives something's memory back.
type Forget = fn(&mut Ready) -> Result<(), GpuError>;

pub(super) fn unprepared() -> GpuError {
    GpuError::Failed { what: "steps were not prepared".into() }
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
    pub(super) gone_shader_seconds: Mutex<f64>,
    /// What shows pictures as soon as they are drawn, once that was asked for. Locked before what is [ready](GpuScene::ready), never after it.
    pub(super) frame: Mutex<Option<FrameOnCard>>,
    /// Pixels from which on pictures are not shown so: it had no room, or failed.
    pub(super) frames_refused_from: AtomicUsize,
    /// First passes that it has shown.
    pub(super) first_shown: AtomicU32,
    /// First passes to be shown before maps of shadows are asked.
    pub(super) maps_from: u32,
    /// A device was lost over maps of shadows: no other is to be.
    pub(super) has_lost_by_maps: AtomicBool,
    /// Passes since one was shown so.
    pub(super) passes_unshown: AtomicU32,
    /// Paths of the next slice of a picture that begins: as many as the last one came to.
    pub(super) pixels_at_once: AtomicU32,
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
            frame: Mutex::default(),
            frames_refused_from: AtomicUsize::new(usize::MAX),
            first_shown: AtomicU32::new(0),
            maps_from: 1,
            has_lost_by_maps: AtomicBool::new(false),
            passes_unshown: AtomicU32::new(0),
            pixels_at_once: AtomicU32::new(SLICE_MIN),
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

    /// Bytes on the card, of all scenes; 0 where this one is not there.
    pub fn bytes(&self) -> u64 {
        locked(&self.ready).as_ref().map_or(0, |ready| ready.session.bytes_held())
    }

    /// Seconds that compiling shaders took so far.
    pub fn shader_seconds(&self) -> f64 {
        let held = locked(&self.ready);
        *locked(&self.gone_shader_seconds) + held.as_ref().map_or(0.0, |ready| ready.shader_seconds)
    }

    /// Lets go of what is on the card, and remembers what compiling took.
    pub(super) fn let_go(&self, held: &mut Option<Ready>) {
        *locked(&self.gone_shader_seconds) += held.take().map_or(0.0, |ready| ready.shader_seconds);
    }

    /// Uploads all and compiles what pictures need that are shaded so, so that their first pass waits for neither.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready(&self, shading: Shading) -> Result<(), GpuError> {
        self.prepare(PathStart::Pixels, shading)
    }

    /// The same for gathering light along rays.
    ///
    /// - `asks`: the octree is asked for the light of what they meet
    ///
    /// Errors: what the card does not do.
    pub fn make_ready_to_gather(&self, asks: bool) -> Result<(), GpuError> {
        let asked = asks.then_some(Asked::Octree);
        self.prepare(PathStart::Rays, Shading { asked, is_focused: false })
    }

    /// The same for carrying photons.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready_for_photons(&self) -> Result<(), GpuError> {
        self.prepare(PathStart::Photons, Shading { asked: None, is_focused: false })
    }

    fn prepare(&self, from: PathStart, shading: Shading) -> Result<(), GpuError> {
        self.run(&mut *self.ready()?, |ready| {
            ready.make_room(from, SLICE_MIN)?;
            ready.prepare(from, shading)
        })
    }

    /// Paths of the slice after one of so many, of which `traced` were there, by the seconds that its first batch took.
    pub(super) fn slice_after(&self, from: PathStart, slice: u32, traced: u32, first_seconds: f64) -> u32 {
        let seconds_max = if self.is_software { SOFTWARE_BATCH_SECONDS } else { BATCH_SECONDS };
        if first_seconds > seconds_max {
            (slice / 2).max(SLICE_MIN)
        } else if first_seconds < seconds_max / 3.0 && traced == slice {
            (slice * 2).min(from.slice_max(self.is_software))
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
        light: LightBeside<'_>,
        work: impl Fn(Tracing<'_>) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        self.or_without_frame(|| self.try_to_trace(from, path_count, light, &work))
    }

    fn try_to_trace<T>(
        &self,
        from: PathStart,
        path_count: usize,
        light: LightBeside<'_>,
        work: impl Fn(Tracing<'_>) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let capacity =
            u32::try_from(path_count).unwrap_or(u32::MAX).clamp(1, from.slice_max(self.is_software));
        // Room first, since light may have to go for it.
        let (mut held, packed) = self.packed_for(light, |ready| ready.make_room(from, capacity))?;
        self.run(&mut held, |ready| {
            if light.shadows == Shadows::ByMaps {
                self.draw_maps(ready)?;
            }
            let trace = |ready: &mut Ready| {
                let shading = ready.known.bring(&ready.session, light, &packed)?;
                ready.prepare(from, shading)?;
                work(ready.tracing(from, shading, light.shadows)?)
            };
            let traced = match trace(ready) {
                // Rays need no room.
                Err(GpuError::OutOfMemory { .. }) if ready.let_maps_go() => trace(ready),
                traced => traced,
            };
            match traced {
                // With less light there is room for what paths bring.
                Err(error @ GpuError::OutOfMemory { .. }) if light.is_any() => {
                    Err(ready.known.too_large(&ready.session, light, error)?)
                }
                traced => traced,
            }
        })
    }

    /// What is on a device that works, and light as far as it is to be brought there.
    ///
    /// - `first`: done before, as often as it takes
    pub(super) fn packed_for(
        &self,
        light: LightBeside<'_>,
        first: impl Fn(&mut Ready) -> Result<(), GpuError>,
    ) -> Result<(MutexGuard<'_, Option<Ready>>, PackedBeside), GpuError> {
        let mut packed = PackedBeside::default();
        loop {
            let mut held = self.ready()?;
            self.run(&mut held, &first)?;
            let lacking =
                held.as_ref().map_or_else(Lacking::default, |ready| ready.known.lacking(light, &packed));
            if lacking == Lacking::default() {
                return Ok((held, packed));
            }
            drop(held);
            packed.pack(light, lacking)?;
        }
    }

    /// What is on a device that works: never `None`.
    pub(super) fn ready(&self) -> Result<MutexGuard<'_, Option<Ready>>, GpuError> {
        let mut packed: Option<PackedScene> = None;
        loop {
            let mut held = locked(&self.ready);
            if held.as_ref().is_some_and(|ready| ready.session.check().is_err()) {
                self.let_go(&mut held);
            }
            if held.is_none() {
                let Some(packed) = &packed else {
                    // Not with the lock held: a thread that waits for others may begin what waits for the lock.
                    drop(held);
                    packed = Some(PackedScene::of(&self.world));
                    continue;
                };
                let of_scene = (&*self.world, packed);
                let shadow_map_bytes_max = self.gpu.options().shadow_map_bytes_max;
                *held = Some(Ready::new(self.gpu.session()?, of_scene, shadow_map_bytes_max)?);
            }
            return Ok(held);
        }
    }

    /// Runs `work` with it.
    pub(super) fn run<T>(
        &self,
        held: &mut Option<Ready>,
        work: impl FnOnce(&mut Ready) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let result = held.as_mut().ok_or_else(unprepared).and_then(work);
        // What was half done is done anew; light that has no room is gone already.
        if !matches!(result, Ok(_) | Err(GpuError::LightTooLarge { .. })) {
            self.let_go(held);
        }
        result
    }

    /// What a slice brought, read where it is. For whoever holds nothing of the card: then `take` may use all threads, of which
    /// some may wait for the card.
    pub(super) fn take<T>(&self, brought: ReadBack, take: impl FnOnce(&[u8]) -> T) -> Result<T, GpuError> {
        // As for what fails in [`GpuScene::run`].
        brought.read(take).inspect_err(|_| self.withdraw())
    }

    /// Takes it off the card; whoever draws it again brings it back. What shows a first pass that is drawn now stays until another withdrawal.
    pub fn withdraw(&self) {
        self.let_go(&mut locked(&self.ready));
        self.let_frame_go();
        self.frames_refused_from.store(usize::MAX, Ordering::Relaxed);
        self.first_shown.store(0, Ordering::Relaxed);
    }
}
