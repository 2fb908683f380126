//! Records of irradiance splatted onto a picture on a card, and the pixels that lack one: the twin of `technique/irradiance/splat.rs`.
//!
//! [Gautron2008, 8.3] in steps (`shaders/irradiance`). What the middles of pixels see is rasterised as for `lookouts.rs`; `seen` makes
//! points of it. Records add up in the pixels in which the spheres of their reach show: weight times irradiance, and weight; drawn as the
//! paper does (`quads.rs`), or tile by tile in one step (`tiles.rs`). Sums are divided, and the pixels that see a diffuse surface and that
//! no record of the finest cache covers are appended to a list: their numbers come back, and nothing else. What finer caches have answered
//! for is not asked of rougher ones.
//!
//! Sums are those of look-ups but for rounding, in the order of the records: cards blend in the order in which things are drawn.
//!
//! **Watchdogs**: so many records are drawn at once, or so many tiles are gone through, as take about as long as a batch may; the first
//! ones as if each record showed in every pixel.

mod quads;
mod tiles;

use std::{ops::Range, sync::Arc};

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::IRRADIANCE_SEEN;

#[cfg(test)]
pub(super) use self::tiles::GpuTileSlice;
use self::{
    quads::{Drawing, QuadSteps},
    tiles::{TileSteps, Tiling},
};
use super::{
    BATCH_SECONDS, SOFTWARE_BATCH_SECONDS,
    known::{LightBeside, RecordsOnCard},
    scene::{GpuScene, Ready, unprepared},
    world::GpuWorld,
};
use crate::{
    gpu::{Begin, Binding, Buffer, GpuError, Layout, Pipeline, Session},
    math::Rgb,
    technique::{SecondaryLight, View},
    transport::World,
};

/// Pixels that the first records may cover together: a card of the last ten years weighs some 10⁹ a second.
const COVERED_FIRST: usize = 1 << 23;
/// Records that are drawn at once at most, or that a pixel weighs, on a card and on a software adapter: the next drawn may cover far more than
/// the last, which lay behind the eye; and Mesa's driver on the CPU ends the loops of an invocation after 65,535 rounds together.
const AT_ONCE_MAX: u32 = 1 << 14;
const SOFTWARE_AT_ONCE_MAX: u32 = 1 << 12;
/// Bytes of an answer: irradiance and weight.
const ANSWER_BYTES: u64 = 16;
/// Of the number of a pixel, and of how many there are.
const NUMBER_BYTES: u64 = 4;

/// `Picture` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPicture {
    pub(super) origin: [f32; 3],
    pub(super) half_width: f32,
    pub(super) right: [f32; 3],
    pub(super) half_height: f32,
    pub(super) up: [f32; 3],
    pub(super) width: u32,
    pub(super) back: [f32; 3],
    pub(super) height: u32,
    pub(super) row: u32,
    pub(super) cache: u32,
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
}

impl GpuPicture {
    /// - `row`: pixels of a row of targets
    fn new(view: &View, row: u32) -> GpuPicture {
        GpuPicture {
            origin: view.origin.into(),
            half_width: view.half_size[0],
            right: view.right.into(),
            half_height: view.half_size[1],
            up: view.up.into(),
            width: view.size().width(),
            back: view.back.into(),
            height: view.size().height(),
            row,
            ..GpuPicture::zeroed()
        }
    }
}

/// `SeenPoint` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuSeenPoint {
    pub(super) position: [f32; 3],
    pub(super) sees: u32,
    pub(super) normal: [f32; 3],
    pub(super) padding_0: u32,
    pub(super) n_geo: [f32; 3],
    pub(super) padding_1: u32,
}

/// How records get onto pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplatBy {
    /// Drawn as quads, which raster units add up: the way of [Gautron2008, 8.3]. Not every adapter adds floats up so.
    Quads,
    /// Gone through by tiles of the picture, in one step.
    #[default]
    Tiles,
}

/// What splats.
#[derive(Debug)]
pub(super) struct Splatting {
    seen: Arc<Pipeline>,
    seen_layout: Arc<Layout>,
    /// Either once it was asked for.
    quads: Option<QuadSteps>,
    tiles: Option<TileSteps>,
}

impl Splatting {
    fn new(session: &Session, world: &GpuWorld) -> Result<Splatting, GpuError> {
        let seen_layout = session.layout(&[Binding::Uniform, Binding::Read, Binding::Write])?;
        let seen_layouts = [&*world.trees_layout, &*world.layout, &*seen_layout];
        let seen = session.pipeline(&IRRADIANCE_SEEN, &world.constants, &seen_layouts)?;
        Ok(Splatting { seen, seen_layout, quads: None, tiles: None })
    }

    fn prepare(&mut self, session: &Session, world: &GpuWorld, by: SplatBy) -> Result<(), GpuError> {
        match by {
            SplatBy::Quads if self.quads.is_none() => self.quads = Some(QuadSteps::new(session, world)?),
            SplatBy::Tiles if self.tiles.is_none() => self.tiles = Some(TileSteps::new(session, world)?),
            SplatBy::Quads | SplatBy::Tiles => {}
        }
        Ok(())
    }
}

/// How much is done at once.
#[derive(Clone, Copy)]
pub(super) struct Pace {
    /// Pixels that the first records may cover together.
    pub(super) covered_first: usize,
    /// Longest time that a batch is to take.
    pub(super) seconds_max: f64,
    /// Records drawn, or weighed by a pixel, at once, at most.
    pub(super) at_once_max: u32,
    /// With a clock or without.
    pub(super) begin: Begin,
}

/// What is known of a picture's pixels, and what is done now.
#[derive(Debug)]
struct Pixels {
    picture: GpuPicture,
    header: Buffer,
    /// Copied from targets, row by row; sums of tiles once points are made of it.
    drawn: Buffer,
    points: Buffer,
    answers: Buffer,
    missing: Buffer,
}

impl Pixels {
    /// - `target`: what is drawn onto
    fn new(session: &Session, view: &View, row: u32, target_bytes: u64) -> Result<Pixels, GpuError> {
        let picture = GpuPicture::new(view, row);
        let count = view.size().pixel_count() as u64;
        Ok(Pixels {
            header: session.buffer_of("picture", &[picture])?,
            picture,
            drawn: session.buffer_zeroed("what is drawn", target_bytes)?,
            points: session.buffer_zeroed("points seen", count * size_of::<GpuSeenPoint>() as u64)?,
            answers: session.buffer_zeroed("irradiance in pixels", count * ANSWER_BYTES)?,
            missing: session.buffer_zeroed("pixels without a record", (1 + count) * NUMBER_BYTES)?,
        })
    }

    fn count(&self) -> usize {
        self.picture.width as usize * self.picture.height as usize
    }

    /// Names the cache whose records are added up from now on.
    fn turn_to(&self, session: &Session, cache: u32) -> Result<(), GpuError> {
        session.write(&self.header, 0, bytemuck::bytes_of(&GpuPicture { cache, ..self.picture }))
    }
}

/// Records on their way onto pixels.
enum Adding<'a> {
    Quads(Drawing<'a>),
    Tiles(Tiling<'a>),
}

impl Adding<'_> {
    /// Adds the records of a cache up, and answers by their sums.
    ///
    /// - `records`: of all
    ///
    /// Returns the seconds that it took on the device's clock, where that is asked.
    fn add_cache(&mut self, session: &Arc<Session>, records: Range<u32>) -> Result<Option<f64>, GpuError> {
        match self {
            Adding::Quads(drawing) => drawing.add_cache(session, records),
            Adding::Tiles(tiling) => tiling.add_cache(session, records),
        }
    }
}

impl Ready {
    fn prepare_splatting(&mut self, by: SplatBy) -> Result<(), GpuError> {
        let compiled = self.session.shader_seconds();
        let splatting = match &mut self.splatting {
            Some(splatting) => splatting,
            nothing => nothing.insert(Splatting::new(&self.session, &self.world)?),
        };
        let prepared = splatting.prepare(&self.session, &self.world, by);
        self.shader_seconds += self.session.shader_seconds() - compiled;
        prepared
    }

    /// What a picture sees.
    fn see(&mut self, world: &World, view: &View, begin: Begin) -> Result<(Pixels, Option<f64>), GpuError> {
        let session = Arc::clone(&self.session);
        let mut batch = begin(&session, "what a picture sees")?;
        let (target, _named) = self.record_picture(world, view, &mut batch)?;
        let pixels = Pixels::new(&session, view, target.size()[0], target.byte_count())?;
        let Splatting { seen, seen_layout, .. } = self.splatting.as_ref().ok_or_else(unprepared)?;
        let group = session.bind(seen_layout, &[&pixels.header, &pixels.drawn, &pixels.points])?;
        batch.copy_target(&target, &pixels.drawn, 0)?;
        let groups = [&self.world.trees_group, &self.world.group, &group];
        batch.dispatch(seen, &groups, seen.workgroups(pixels.count() as u64))?;
        // Waited for: only then the target has left the card, and what is drawn next has its room.
        let seconds = batch.submit()?.gpu_seconds()?;
        Ok((pixels, seconds))
    }

    /// Splats the records of the light that is there, cache by cache.
    fn splat(&mut self, world: &World, view: &View, by: SplatBy, pace: Pace) -> Result<Splatted, GpuError> {
        self.prepare_splatting(by)?;
        let (pixels, mut seconds) = self.see(world, view, pace.begin)?;
        let seen_seconds = seconds;
        let session = &self.session;
        let splatting = self.splatting.as_ref().ok_or_else(unprepared)?;
        let records = self.known.records().ok_or_else(no_records)?;
        let mut adding = match by {
            SplatBy::Quads => {
                let steps = splatting.quads.as_ref().ok_or_else(unprepared)?;
                Adding::Quads(Drawing::new(session, steps, &pixels, records, pace)?)
            }
            SplatBy::Tiles => {
                let steps = splatting.tiles.as_ref().ok_or_else(unprepared)?;
                Adding::Tiles(Tiling::new(session, steps, &pixels, records, pace)?)
            }
        };
        let mut first = 0;
        for (cache, count) in (0..).zip(&records.counts) {
            let end = first + count;
            // The finest says what is missing, whatever it has.
            if cache == 0 || *count > 0 {
                pixels.turn_to(session, cache)?;
                let of_cache = adding.add_cache(session, first..end)?;
                seconds = seconds.zip(of_cache).map(|(before, of_cache)| before + of_cache);
            }
            first = end;
        }
        let session = Arc::clone(session);
        let pixel_count = view.size().pixel_count();
        #[cfg(test)]
        let points = pixels.points;
        let Pixels { answers, missing, .. } = pixels;
        Ok(Splatted {
            session,
            pixel_count,
            #[cfg(test)]
            points,
            answers,
            missing,
            seconds: seen_seconds.zip(seconds).map(|(seen, all)| SplatSeconds { seen, splats: all - seen }),
        })
    }
}

/// What records say of the irradiance in a picture's pixels, on the card. Its memory there is given back when it is dropped.
#[derive(Debug)]
pub struct Splatted {
    session: Arc<Session>,
    pixel_count: usize,
    #[cfg(test)]
    points: Buffer,
    answers: Buffer,
    missing: Buffer,
    seconds: Option<SplatSeconds>,
}

/// Seconds on the device's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatSeconds {
    /// Of finding out what pixels see.
    pub seen: f64,
    /// Of splatting records onto it and finding pixels without one.
    pub splats: f64,
}

impl Splatted {
    /// What [`GpuScene::splatted_timed`] took; `None` for others and on devices without a clock.
    pub fn seconds(&self) -> Option<SplatSeconds> {
        self.seconds
    }

    /// Irradiance at what the middles of pixels see, row by row, W/m²: by the finest cache that knows it; `None` where no record counts,
    /// and where nothing is seen that scatters diffusely.
    ///
    /// Errors: what the card does not do; [`GpuError::Lost`] where it is gone with the card.
    pub fn irradiances(&self) -> Result<Vec<Option<Rgb>>, GpuError> {
        let bytes = self.session.read(&self.answers, 0..self.answers.byte_count())?;
        let answer_of = |bytes: &[u8]| {
            let [r, g, b, weight]: [f32; 4] = bytemuck::pod_read_unaligned(bytes);
            (weight > 0.0).then(|| Rgb::new(r, g, b))
        };
        Ok(bytes.chunks_exact(ANSWER_BYTES as usize).map(answer_of).collect())
    }

    /// Numbers of the pixels, counted row by row, whose middle sees a diffuse surface and that no record of the finest cache covers;
    /// ascending. Of what the card has found nothing else comes back for it.
    ///
    /// Errors: as [`Splatted::irradiances`].
    pub fn missing(&self) -> Result<Vec<u32>, GpuError> {
        let count = self.session.read(&self.missing, 0..NUMBER_BYTES)?;
        let count = bytemuck::pod_read_unaligned::<u32>(&count).min(self.pixel_count as u32);
        if count == 0 {
            return Ok(Vec::new());
        }
        let end = (1 + u64::from(count)) * NUMBER_BYTES;
        let bytes = self.session.read(&self.missing, NUMBER_BYTES..end)?;
        let mut pixels: Vec<u32> =
            bytes.chunks_exact(NUMBER_BYTES as usize).map(bytemuck::pod_read_unaligned).collect();
        // The card appends them in the order in which it comes by.
        pixels.sort_unstable();
        Ok(pixels)
    }

    /// What the middles of pixels see.
    #[cfg(test)]
    pub(super) fn points(&self) -> Vec<GpuSeenPoint> {
        let bytes = self.session.read(&self.points, 0..self.points.byte_count()).expect("points");
        bytes.chunks_exact(size_of::<GpuSeenPoint>()).map(bytemuck::pod_read_unaligned).collect()
    }
}

impl GpuScene {
    /// Irradiance by records, splatted onto what a camera sees. Takes some 100 bytes a pixel on the card, of which 20 stay with what is
    /// returned.
    ///
    /// - `view`: with perspective
    /// - `known`: has records
    ///
    /// Errors: what the card does not do; [`GpuError::OutOfMemory`] or [`GpuError::LightTooLarge`] where a picture of that size or the
    /// light has no room.
    pub fn splatted(&self, view: &View, known: &Arc<dyn SecondaryLight>) -> Result<Splatted, GpuError> {
        self.splatted_by(view, known, SplatBy::default())
    }

    /// The same by either way, to the same sums but for rounding.
    ///
    /// Errors: as [`GpuScene::splatted`]; [`GpuError::Insufficient`] where quads are asked for and the card cannot add up floats.
    pub fn splatted_by(
        &self,
        view: &View,
        known: &Arc<dyn SecondaryLight>,
        by: SplatBy,
    ) -> Result<Splatted, GpuError> {
        let splat = || self.splat_once(view, known, by, self.pace(Session::batch));
        self.through_losses(|| self.or_without_frame(splat))
    }

    /// The same by the device's clock: [`Splatted::seconds`].
    ///
    /// Errors: as [`GpuScene::splatted_by`].
    pub fn splatted_timed(
        &self,
        view: &View,
        known: &Arc<dyn SecondaryLight>,
        by: SplatBy,
    ) -> Result<Splatted, GpuError> {
        let splat = || self.splat_once(view, known, by, self.pace(Session::timed_batch));
        self.through_losses(|| self.or_without_frame(splat))
    }

    /// [`Splatted::missing`] of [`GpuScene::splatted`], also where the device is lost in between.
    ///
    /// Errors: as [`GpuScene::splatted`].
    pub fn missing(&self, view: &View, known: &Arc<dyn SecondaryLight>) -> Result<Vec<u32>, GpuError> {
        let pace = self.pace(Session::batch);
        let missing = || self.splat_once(view, known, SplatBy::default(), pace)?.missing();
        self.through_losses(|| self.or_without_frame(missing))
    }

    pub(super) fn pace(&self, begin: Begin) -> Pace {
        let (seconds_max, at_once_max) = match self.is_software {
            true => (SOFTWARE_BATCH_SECONDS, SOFTWARE_AT_ONCE_MAX),
            false => (BATCH_SECONDS, AT_ONCE_MAX),
        };
        Pace { covered_first: COVERED_FIRST, seconds_max, at_once_max, begin }
    }

    pub(super) fn splat_once(
        &self,
        view: &View,
        known: &Arc<dyn SecondaryLight>,
        by: SplatBy,
        pace: Pace,
    ) -> Result<Splatted, GpuError> {
        if !view.is_perspective {
            return Err(GpuError::Failed { what: "only perspective views are drawn".into() });
        }
        if !known.has_records() {
            return Err(no_records());
        }
        let light = LightBeside { known: Some(known), ..LightBeside::default() };
        // Before light goes for a picture that cannot be.
        self.run(&mut *self.ready()?, |ready| {
            let able = ready.prepare_splatting(by).and_then(|()| check_size(&ready.session, view));
            match able {
                Err(error @ (GpuError::OutOfMemory { .. } | GpuError::Insufficient { .. })) => Ok(Err(error)),
                able => able.map(Ok),
            }
        })??;
        // Held to the end, batch by batch: the light must not go in between.
        let (mut held, packed) = self.packed_for(light, |_| Ok(()))?;
        let splatted = self.run(&mut held, |ready| {
            ready.known.bring(&ready.session, light, &packed)?;
            let splatted = match ready.splat(self.world(), view, by, pace) {
                Err(GpuError::OutOfMemory { .. }) => {
                    ready.known.forget_others();
                    ready.splat(self.world(), view, by, pace)
                }
                splatted => splatted,
            };
            match splatted {
                // Nothing is half done then: what is on the card may stay.
                Err(error @ GpuError::OutOfMemory { .. }) => Ok(Err(error)),
                splatted => splatted.map(Ok),
            }
        });
        splatted.flatten()
    }
}

/// Errors where no adapter's memory would do: the largest buffer of a picture, its points, is beyond what shaders may see at once.
fn check_size(session: &Session, view: &View) -> Result<(), GpuError> {
    let byte_count = view.size().pixel_count() as u64 * size_of::<GpuSeenPoint>() as u64;
    session.check_binding("points seen", byte_count)
}

fn no_records() -> GpuError {
    GpuError::Failed { what: "light without records is not splatted".into() }
}
