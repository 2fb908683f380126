//! Paths on a card: places for those of a slice, the steps they go through, and how a slice is traced.
//!
//! Paths begin at pixels, or with rays that light is gathered along. Both go through the same steps; what differs is how they
//! begin, what they bring, and that the former see shadows of what is near and the latter look past it. Photons share all but
//! what happens at surfaces, and send no shadow rays.

use std::{ops::Range, sync::Arc, time::Instant};

use bytemuck::{NoUninit, Zeroable};
use lumicast_shaders::{
    GATHER_BEGIN, GATHER_OCCLUDED, GATHER_SHADE, GATHER_SHADE_BY_OCTREE, PATH_BEGIN, PATH_CLOSEST,
    PATH_OCCLUDED, PATH_SHADE, PATH_SHADE_BY_OCTREE, PATH_SHADE_BY_RECORDS, PATH_TURN, PHOTONS_BEGIN,
    PHOTONS_FLY, SHADOWS_ASK, SHADOWS_TURN, Step as Shader,
};

use super::{
    GpuCounters, GpuPassHeader, GpuPixelSample,
    gather::{GpuGatherRay, GpuRaySample},
    handed::{GpuHandedPath, HANDED_AFTER, HandOver, handed_max},
    known::{Asked, KnownOnCard, Shading},
    photons::{GpuKeptPhoton, GpuSentPhoton, KEPT_PER_PHOTON},
    shadow_maps::{ShadowMaps, layout_of_maps},
    world::GpuWorld,
};
use crate::{
    gpu::{Batch, BindGroup, Binding, Buffer, GpuError, Layout, Pipeline, ReadBack, Session},
    technique::Counts,
};

/// Invocations of a workgroup.
pub(super) const WORKGROUP: u32 = 64;
/// Fewest and most paths of a slice, some 400 bytes each, 480 where there is glass, photons 590: cards run some 10⁵ at once, the last of a slice keep them waiting, and
/// every scene that is looked at has places of its own.
pub(super) const SLICE_MIN: u32 = 4096;
const SLICE_MAX: u32 = 1 << 19;
/// The same of rays that light is gathered along, and of photons.
const BESIDE_SLICE_MAX: u32 = 1 << 18;
/// The same where the adapter is the CPU itself.
const SOFTWARE_SLICE_MAX: u32 = 1 << 16;
/// Scatterings of the first two batches of a slice, and most of a later one, which has ever fewer paths.
const SCATTERINGS_FIRST: u32 = 2;
const SCATTERINGS_MAX: u32 = 64;

/// Bytes of a path on the card, by buffer: state, hit, a shadow ray, sample, a place in a queue; and of a ray that it begins
/// with.
pub(super) const PATH_BYTES: u64 = 112;
pub(super) const HIT_BYTES: u64 = 20;
pub(super) const SHADOW_BYTES: u64 = 80;
pub(super) const SAMPLE_BYTES: u64 = size_of::<GpuPixelSample>() as u64;
pub(super) const RAY_SAMPLE_BYTES: u64 = size_of::<GpuRaySample>() as u64;
const RAY_BYTES: u64 = size_of::<GpuGatherRay>() as u64;
const PHOTON_BYTES: u64 = size_of::<GpuSentPhoton>() as u64;
const KEPT_BYTES: u64 = size_of::<GpuKeptPhoton>() as u64;
const QUEUE_BYTES: u64 = 4;
pub(super) const DISPATCH_BYTES: u64 = 32;
/// Where the sizes of shadow rays begin in the buffer of sizes.
pub(super) const SHADOW_SIZES_AT: u64 = 12;

/// Where paths begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PathStart {
    /// At the eye, one through each pixel.
    Pixels,
    /// With rays that light is gathered along.
    Rays,
    /// At lights.
    Photons,
}

impl PathStart {
    /// How many there are.
    pub(super) const COUNT: usize = 3;

    /// Most paths of a slice.
    ///
    /// - `is_software`: the adapter is the CPU itself
    pub(super) fn slice_max(self, is_software: bool) -> u32 {
        match self {
            _ if is_software => SOFTWARE_SLICE_MAX,
            PathStart::Pixels => SLICE_MAX,
            PathStart::Rays | PathStart::Photons => BESIDE_SLICE_MAX,
        }
    }

    fn begin(self) -> &'static Shader {
        match self {
            PathStart::Pixels => &PATH_BEGIN,
            PathStart::Rays => &GATHER_BEGIN,
            PathStart::Photons => &PHOTONS_BEGIN,
        }
    }

    /// `None`: records are not gathered from records, and photons ask nobody.
    fn shade(self, asked: Option<Asked>) -> Option<&'static Shader> {
        match (self, asked) {
            (PathStart::Pixels, None) => Some(&PATH_SHADE),
            (PathStart::Pixels, Some(Asked::Octree)) => Some(&PATH_SHADE_BY_OCTREE),
            (PathStart::Pixels, Some(Asked::Records)) => Some(&PATH_SHADE_BY_RECORDS),
            (PathStart::Rays, None) => Some(&GATHER_SHADE),
            (PathStart::Rays, Some(Asked::Octree)) => Some(&GATHER_SHADE_BY_OCTREE),
            (PathStart::Photons, None) => Some(&PHOTONS_FLY),
            (PathStart::Rays, Some(Asked::Records)) | (PathStart::Photons, Some(_)) => None,
        }
    }

    /// `None`: nothing asks for shadows.
    fn occluded(self) -> Option<&'static Shader> {
        match self {
            PathStart::Pixels => Some(&PATH_OCCLUDED),
            PathStart::Rays => Some(&GATHER_OCCLUDED),
            PathStart::Photons => None,
        }
    }

    /// Shadow rays of a path at once, at most: of its light sample, and for pixels of light that is known.
    fn shadow_rays_max(self) -> u64 {
        match self {
            PathStart::Pixels => 2,
            PathStart::Rays => 1,
            PathStart::Photons => 0,
        }
    }

    /// Places for these, and where there is glass for what the light samples bring by panes.
    fn shadows_max(self, world: &GpuWorld) -> u64 {
        match self {
            PathStart::Photons => 0,
            _ => self.shadow_rays_max() + u64::from(world.has_glass()),
        }
    }

    /// Queues of them: where maps are asked, another of those that these leave.
    fn shadow_queues(self) -> u64 {
        match self {
            PathStart::Pixels => 2,
            PathStart::Rays | PathStart::Photons => 1,
        }
    }

    fn sample_bytes(self) -> u64 {
        match self {
            PathStart::Pixels => SAMPLE_BYTES,
            PathStart::Rays => RAY_SAMPLE_BYTES,
            PathStart::Photons => KEPT_PER_PHOTON * KEPT_BYTES,
        }
    }

    /// Of what paths begin with; `None` at pixels, which the header tells.
    fn start_bytes(self) -> Option<u64> {
        match self {
            PathStart::Pixels => None,
            PathStart::Rays => Some(RAY_BYTES),
            PathStart::Photons => Some(PHOTON_BYTES),
        }
    }
}

/// Places for the paths of a slice.
#[derive(Debug)]
struct Places {
    header: Buffer,
    samples: Buffer,
    counters: Buffer,
    /// What they begin with, and its group.
    starts: Option<(Buffer, BindGroup)>,
    /// Kept for as long as the group that binds them.
    _others: Vec<Buffer>,
    group: BindGroup,
    layout: Arc<Layout>,
    capacity: u32,
}

impl Places {
    fn new(session: &Session, world: &GpuWorld, from: PathStart, capacity: u32) -> Result<Places, GpuError> {
        let count = u64::from(capacity);
        let header = session.buffer_zeroed("pass", size_of::<GpuPassHeader>() as u64)?;
        let paths = session.buffer_zeroed("paths", count * PATH_BYTES)?;
        let hits = session.buffer_zeroed("hits", count * HIT_BYTES)?;
        // Steps see one at least.
        let shadow_count = (count * from.shadows_max(world)).max(1);
        let shadows = session.buffer_zeroed("shadow rays", shadow_count * SHADOW_BYTES)?;
        let samples = session.buffer_zeroed("samples", count * from.sample_bytes())?;
        let queues_of_paths = 2 + from.shadow_queues() * from.shadow_rays_max();
        let queues = session.buffer_zeroed("queues", count * queues_of_paths * QUEUE_BYTES)?;
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
        let starts = match from.start_bytes() {
            None => None,
            Some(bytes) => {
                let starts = session.buffer_zeroed("starts", count * bytes)?;
                let group = session.bind(&*starts_layout(session)?, &[&starts])?;
                Some((starts, group))
            }
        };
        let others = vec![paths, hits, shadows, queues];
        Ok(Places { header, samples, counters, starts, _others: others, group, layout, capacity })
    }
}

fn starts_layout(session: &Session) -> Result<Arc<Layout>, GpuError> {
    session.layout(&[Binding::Read])
}

/// Places for paths, and the steps they go through.
#[derive(Debug)]
pub(super) struct Paths {
    from: PathStart,
    places: Places,
    sizes: Buffer,
    sizes_group: BindGroup,
    begin: Arc<Pipeline>,
    closest: Arc<Pipeline>,
    turn: Arc<Pipeline>,
    occluded: Option<Arc<Pipeline>>,
    /// Asking maps of shadows, and how many shadow rays those leave; once somebody wanted that.
    ask_maps: Option<[Arc<Pipeline>; 2]>,
    /// `None`: the card takes each to its end.
    hand_over: Option<HandOver>,
    /// By [`Shading::index`]; each compiled when it is first needed.
    shades: [Option<Arc<Pipeline>>; Shading::COUNT],
}

impl Paths {
    pub(super) fn new(
        session: &Arc<Session>,
        world: &GpuWorld,
        from: PathStart,
        capacity: u32,
    ) -> Result<Paths, GpuError> {
        let places = Places::new(session, world, from, capacity)?;
        let sizes = session.buffer_zeroed("sizes", DISPATCH_BYTES)?;
        let sizes_layout = session.layout(&[Binding::Write])?;
        let sizes_group = session.bind(&sizes_layout, &[&sizes])?;
        let layouts = [&*world.trees_layout, &*world.layout, &*places.layout];
        let pipeline = |step: &'static Shader| session.pipeline(step, &world.constants, &layouts);
        let turn_layouts = [&*world.trees_layout, &*world.layout, &*places.layout, &*sizes_layout];
        let begin = match from.start_bytes() {
            None => pipeline(from.begin())?,
            Some(_) => {
                let starts = starts_layout(session)?;
                let layouts = [&layouts[..], &[&*starts]].concat();
                session.pipeline(from.begin(), &world.constants, &layouts)?
            }
        };
        let hand_over = match from {
            PathStart::Pixels | PathStart::Rays => Some(HandOver::new(session, layouts, &world.constants)?),
            PathStart::Photons => None,
        };
        Ok(Paths {
            begin,
            hand_over,
            closest: pipeline(&PATH_CLOSEST)?,
            occluded: from.occluded().map(pipeline).transpose()?,
            ask_maps: None,
            turn: session.pipeline(&PATH_TURN, &world.constants, &turn_layouts)?,
            from,
            places,
            sizes,
            sizes_group,
            shades: Default::default(),
        })
    }

    /// Room for slices of so many paths, if there is less.
    pub(super) fn make_room(
        &mut self,
        session: &Session,
        world: &GpuWorld,
        capacity: u32,
    ) -> Result<(), GpuError> {
        if self.places.capacity < capacity {
            self.places = Places::new(session, world, self.from, capacity)?;
        }
        Ok(())
    }

    /// Shadows of pixels can be asked of maps from now on.
    pub(super) fn be_able_to_ask_maps(
        &mut self,
        session: &Arc<Session>,
        world: &GpuWorld,
    ) -> Result<(), GpuError> {
        if self.ask_maps.is_none() {
            let (maps, sizes) = (layout_of_maps(session)?, session.layout(&[Binding::Write])?);
            let pipeline = |step: &'static Shader, layout: &Layout| {
                let layouts = [&*world.trees_layout, &*world.layout, &*self.places.layout, layout];
                session.pipeline(step, &world.constants, &layouts)
            };
            self.ask_maps = Some([pipeline(&SHADOWS_ASK, &maps)?, pipeline(&SHADOWS_TURN, &sizes)?]);
        }
        Ok(())
    }

    /// Paths can be shaded so from now on. True if that was compiled for it.
    pub(super) fn be_able_to(
        &mut self,
        session: &Session,
        world: &GpuWorld,
        known: &KnownOnCard,
        shading: Shading,
    ) -> Result<bool, GpuError> {
        let shade = &mut self.shades[shading.index()];
        if shade.is_some() {
            return Ok(false);
        }
        let layouts = [&*world.trees_layout, &*world.layout, &*self.places.layout, &*known.layout];
        let constants = world.constants_of_shade(self.from, shading);
        let no_such = || GpuError::Failed { what: "such paths do not ask for that light".into() };
        let shader = self.from.shade(shading.asked).ok_or_else(no_such)?;
        *shade = Some(session.pipeline(shader, &constants, &layouts)?);
        Ok(true)
    }
}

/// Everything that traces paths now.
#[derive(Clone, Copy)]
pub(super) struct Tracing<'a> {
    pub(super) session: &'a Arc<Session>,
    pub(super) world: &'a GpuWorld,
    pub(super) paths: &'a Paths,
    /// What they ask for light.
    pub(super) known: &'a KnownOnCard,
    pub(super) shading: Shading,
    /// What tells which lights without extent are hidden; `None`: rays do.
    pub(super) maps: Option<&'a ShadowMaps>,
}

impl<'a> Tracing<'a> {
    /// Paths of a slice at most.
    pub(super) fn capacity(self) -> u32 {
        self.paths.places.capacity
    }

    /// What steps read of the trees, the scene and the paths.
    pub(super) fn groups(self) -> [&'a BindGroup; 3] {
        [&self.world.trees_group, &self.world.group, &self.paths.places.group]
    }

    /// Some drivers compile at first use: that is waiting for shaders, not drawing. Returns the seconds.
    pub(super) fn use_first(self) -> Result<f64, GpuError> {
        let start = Instant::now();
        self.trace(&GpuPassHeader::zeroed(), 0..1, true)?;
        Ok(start.elapsed().as_secs_f64())
    }

    /// Hands over what the next slice begins with.
    pub(super) fn write_starts<T: NoUninit>(self, starts: &[T]) -> Result<(), GpuError> {
        match &self.paths.places.starts {
            Some((buffer, _)) => self.session.write(buffer, 0, bytemuck::cast_slice(starts)),
            None => Ok(()),
        }
    }

    pub(super) fn write_header(self, header: &GpuPassHeader) -> Result<(), GpuError> {
        self.session.write(&self.paths.places.header, 0, bytemuck::bytes_of(header))
    }

    /// The first step of a slice.
    pub(super) fn begin(self, batch: &mut Batch, workgroups: [u32; 3]) -> Result<(), GpuError> {
        let mut groups = self.groups().to_vec();
        groups.extend(self.paths.places.starts.as_ref().map(|(_, group)| group));
        batch.dispatch(&self.paths.begin, &groups, workgroups)
    }

    /// What rays meet.
    ///
    /// - `first`: workgroups of the first scattering, whose size `turn` has not written
    pub(super) fn closest(self, batch: &mut Batch, first: Option<[u32; 3]>) -> Result<(), GpuError> {
        self.run(batch, &self.paths.closest, &self.groups(), first)
    }

    /// What paths find there; as [`Tracing::closest`].
    pub(super) fn shade(self, batch: &mut Batch, first: Option<[u32; 3]>) -> Result<(), GpuError> {
        let unprepared = || GpuError::Failed { what: "this shading was not prepared".into() };
        let shade = self.paths.shades[self.shading.index()].as_ref().ok_or_else(unprepared)?;
        let [trees, world, state] = self.groups();
        self.run(batch, shade, &[trees, world, state, &self.known.group], first)
    }

    fn run(
        self,
        batch: &mut Batch,
        pipeline: &Pipeline,
        groups: &[&BindGroup],
        first: Option<[u32; 3]>,
    ) -> Result<(), GpuError> {
        match first {
            Some(workgroups) => batch.dispatch(pipeline, groups, workgroups),
            None => batch.dispatch_indirect(pipeline, groups, &self.paths.sizes, 0),
        }
    }

    /// Sizes of the steps to come.
    pub(super) fn turn(self, batch: &mut Batch) -> Result<(), GpuError> {
        let [trees, world, state] = self.groups();
        batch.dispatch(&self.paths.turn, &[trees, world, state, &self.paths.sizes_group], [1, 1, 1])
    }

    /// The shadow rays of a scattering, once it is known how many there are.
    pub(super) fn occluded(self, batch: &mut Batch) -> Result<(), GpuError> {
        let Some(occluded) = &self.paths.occluded else { return Ok(()) };
        let [trees, world, state] = self.groups();
        let sizes = &self.paths.sizes;
        if let (Some([ask, turn]), Some(maps)) = (&self.paths.ask_maps, self.maps) {
            batch.dispatch_indirect(ask, &[trees, world, state, &maps.group], sizes, SHADOW_SIZES_AT)?;
            batch.dispatch(turn, &[trees, world, state, &self.paths.sizes_group], [1, 1, 1])?;
        }
        batch.dispatch_indirect(occluded, &[trees, world, state], sizes, SHADOW_SIZES_AT)
    }

    fn scatter(self, batch: &mut Batch, first: Option<[u32; 3]>) -> Result<(), GpuError> {
        self.closest(batch, first)?;
        self.shade(batch, first)?;
        self.turn(batch)?;
        self.occluded(batch)
    }

    /// A batch of the slice that `header` describes: so many scatterings, with its beginning before the first. What is left to do.
    ///
    /// - `hands_over`: the last paths come back after it
    fn trace(
        self,
        header: &GpuPassHeader,
        scatterings: Range<u32>,
        hands_over: bool,
    ) -> Result<Left, GpuError> {
        let mut batch = self.session.batch("paths")?;
        for scattering in scatterings {
            let all = (scattering == 0).then(|| workgroups_of(header));
            if let Some(all) = all {
                self.write_header(header)?;
                self.begin(&mut batch, all)?;
            }
            self.scatter(&mut batch, all)?;
        }
        let hand_over = self.paths.hand_over.as_ref().filter(|_| hands_over);
        let handed = hand_over.map(|step| step.record(&mut batch, self.groups())).transpose()?;
        let counters = batch.read_back(&self.paths.places.counters, 0..size_of::<GpuCounters>() as u64)?;
        batch.submit()?;
        let counters: GpuCounters = counters.read(bytemuck::pod_read_unaligned)?;
        let handed = match handed {
            Some(handed) => {
                let has_room = counters.ray_count <= handed_max(header.path_count);
                let count = if has_room { counters.ray_count as usize } else { 0 };
                // Also where there are none: the memory is kept for the next then.
                handed.read(|all| bytemuck::pod_collect_to_vec(&all[..count * size_of::<GpuHandedPath>()]))?
            }
            None => Vec::new(),
        };
        Ok(Left { counters, handed })
    }

    /// Rays of paths that go on.
    pub(super) fn rays_left(self) -> Result<u32, GpuError> {
        let bytes = 0..size_of::<GpuCounters>() as u64;
        let counters = self.session.read(&self.paths.places.counters, bytes)?;
        Ok(bytemuck::pod_read_unaligned::<GpuCounters>(&counters).ray_count)
    }

    /// A slice until its last path has ended, or comes back.
    ///
    /// - `hands_over`: the last ones may
    pub(super) fn trace_all(self, header: &GpuPassHeader, hands_over: bool) -> Result<Slice, GpuError> {
        let start = Instant::now();
        let (mut scatterings, mut done) = (SCATTERINGS_FIRST, SCATTERINGS_FIRST);
        let mut left = self.trace(header, 0..done, false)?;
        let first_seconds = start.elapsed().as_secs_f64();
        let sample_bytes = self.paths.from.sample_bytes();
        let bytes_max = u64::from(self.capacity()) * sample_bytes;
        let bytes_of = |counters: &GpuCounters| match self.paths.from {
            PathStart::Pixels | PathStart::Rays => u64::from(header.path_count) * sample_bytes,
            PathStart::Photons => u64::from(counters.kept) * KEPT_BYTES,
        };
        // What has no room now has none at the end.
        while left.goes_on() && bytes_of(&left.counters) <= bytes_max {
            let end = done + scatterings;
            left = self.trace(header, done..end, hands_over && end >= HANDED_AFTER)?;
            (done, scatterings) = (end, (scatterings * 2).min(SCATTERINGS_MAX));
        }
        let Left { counters, handed } = left;
        let counts = Counts {
            rays: u64::from(counters.rays) + u64::from(counters.pane_rays),
            shadow_rays: u64::from(counters.shadow_rays),
            paths: u64::from(header.path_count),
        };
        let bytes = bytes_of(&counters);
        let is_whole = bytes <= bytes_max;
        Ok(Slice { byte_count: if is_whole { bytes } else { 0 }, is_whole, counts, first_seconds, handed })
    }

    /// Copies the samples of pixels that a slice left to where those of a whole picture are.
    ///
    /// - `first`: of its pixels, among all
    pub(super) fn copy_samples(self, to: &Buffer, first: u32, count: u32) -> Result<(), GpuError> {
        let [first, count] = [first, count].map(|pixels| u64::from(pixels) * SAMPLE_BYTES);
        let mut batch = self.session.batch("samples of a slice")?;
        batch.copy(&self.paths.places.samples, 0..count, to, first)?;
        batch.submit().map(|_| ())
    }

    /// Sends for what a slice left: [`GpuPixelSample`]s, [`GpuRaySample`]s, or [`GpuKeptPhoton`]s in no order. The next slice may
    /// begin before they are read.
    pub(super) fn bring(self, slice: &Slice) -> Result<ReadBack, GpuError> {
        self.session.fetch(&self.paths.places.samples, 0..slice.byte_count)
    }
}

/// Workgroups for all paths of a slice; one at least, which says so where there are none.
pub(super) fn workgroups_of(header: &GpuPassHeader) -> [u32; 3] {
    [header.path_count.div_ceil(WORKGROUP).max(1), 1, 1]
}

/// What a batch leaves of a slice.
struct Left {
    counters: GpuCounters,
    /// The last paths, if they came back.
    handed: Vec<GpuHandedPath>,
}

impl Left {
    fn goes_on(&self) -> bool {
        self.counters.ray_count > 0 && self.handed.is_empty()
    }
}

/// A slice that was traced.
pub(super) struct Slice {
    /// Of what it left, for [`Tracing::bring`].
    byte_count: u64,
    /// There was room for all of that; else it brings nothing.
    pub(super) is_whole: bool,
    pub(super) counts: Counts,
    /// Of its first batch, the longest.
    pub(super) first_seconds: f64,
    /// Paths that have not ended: somebody else is to [follow](super::handed::follow) them.
    pub(super) handed: Vec<GpuHandedPath>,
}
