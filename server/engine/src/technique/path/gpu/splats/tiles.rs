//! Records added up by a step over tiles of the picture, a workgroup each: the sums of [`quads`](super::quads), in the same order, for cards
//! that blend floats slowly or not at all.
//!
//! Tiles look through all records for those whose spheres reach into the box around what their pixels see, so that each pixel weighs few
//! that do not count there. Sums stay with the pixels, which answer at once; through memory they go only where a cache has more records than
//! one dispatch may take.

use std::{ops::Range, sync::Arc, time::Instant};

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{IRRADIANCE_REACH, IRRADIANCE_SPLAT_TILES};

use super::{GpuWorld, Pace, Pixels, RecordsOnCard};
use crate::gpu::{BindGroup, Binding, Buffer, GpuError, Layout, Pipeline, Session};

/// Pixels of a tile, or invocations of a workgroup.
const TILE: [u32; 2] = [IRRADIANCE_SPLAT_TILES.workgroup_size[0], IRRADIANCE_SPLAT_TILES.workgroup_size[1]];
const TILE_PIXELS: u64 = TILE[0] as u64 * TILE[1] as u64;
/// Of a sphere: its middle and radius.
const SPHERE_BYTES: u64 = 16;
/// How many times as much the next batch may have: enough for a picture to be done in few batches. It is to take half the time that one may
/// where records lie as they did, and its pixels may have a hundred times as many before watchdogs bark.
const GROWTH_MAX: f64 = 16.0;

/// `TileSlice` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in super::super) struct GpuTileSlice {
    pub(in super::super) first_tile: u32,
    pub(in super::super) end_tile: u32,
    pub(in super::super) first_record: u32,
    pub(in super::super) end_record: u32,
    pub(in super::super) begins: u32,
    pub(in super::super) ends: u32,
    pub(in super::super) padding_0: u32,
    pub(in super::super) padding_1: u32,
}

/// What finds out how far records reach, and adds them up.
#[derive(Debug)]
pub(super) struct TileSteps {
    reach: Arc<Pipeline>,
    reach_layout: Arc<Layout>,
    splat: Arc<Pipeline>,
    splat_layout: Arc<Layout>,
}

impl TileSteps {
    pub(super) fn new(session: &Session, world: &GpuWorld) -> Result<TileSteps, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let reach_layout = session.layout(&[read, read, write])?;
        let reach = session.pipeline(&IRRADIANCE_REACH, &world.constants, &[&*reach_layout])?;
        let bindings = [uniform, uniform, read, read, read, read, write, write, write];
        let splat_layout = session.layout(&bindings)?;
        let splat = session.pipeline(&IRRADIANCE_SPLAT_TILES, &world.constants, &[&*splat_layout])?;
        Ok(TileSteps { reach, reach_layout, splat, splat_layout })
    }
}

/// Records of caches, and how much of the picture they are added up in at once.
pub(super) struct Tiling<'a> {
    steps: &'a TileSteps,
    slice: Buffer,
    spheres: Buffer,
    /// Until it is known how far records reach.
    reach_group: Option<BindGroup>,
    splat_group: BindGroup,
    tile_count: u32,
    /// Pixels of the next batch times records, as if each were weighed in every pixel.
    covered: u64,
    pace: Pace,
}

impl<'a> Tiling<'a> {
    pub(super) fn new(
        session: &Session,
        steps: &'a TileSteps,
        pixels: &Pixels,
        RecordsOnCard { buffers: [records, words], counts }: &RecordsOnCard,
        pace: Pace,
    ) -> Result<Tiling<'a>, GpuError> {
        let Pixels { picture, header, drawn, points, answers, missing } = pixels;
        // One at least, as there are records for bindings.
        let sphere_bytes = u64::from(counts.iter().sum::<u32>().max(1)) * SPHERE_BYTES;
        let spheres = session.buffer_zeroed("spheres of records", sphere_bytes)?;
        let slice = session.buffer_of("tiles of a picture", &[GpuTileSlice::zeroed()])?;
        let splat = [header, &slice, points, &spheres, records, words, drawn, answers, missing];
        Ok(Tiling {
            reach_group: Some(session.bind(&steps.reach_layout, &[records, words, &spheres])?),
            splat_group: session.bind(&steps.splat_layout, &splat)?,
            steps,
            slice,
            spheres,
            tile_count: picture.width.div_ceil(TILE[0]) * picture.height.div_ceil(TILE[1]),
            covered: pace.covered_first as u64,
            pace,
        })
    }

    /// Adds the records of a cache up, in as many tiles at once as take no longer than they may, and answers by their sums.
    ///
    /// - `records`: of all
    ///
    /// Returns the seconds that it took on the device's clock, where that is asked.
    pub(super) fn add_cache(
        &mut self,
        session: &Arc<Session>,
        records: Range<u32>,
    ) -> Result<Option<f64>, GpuError> {
        let mut gpu_seconds = Some(0.0);
        let mut next = 0;
        while next < self.tile_count {
            let at_once = u64::from((records.end - records.start).clamp(1, self.pace.at_once_max));
            let tile_count = u32::try_from(self.covered / (TILE_PIXELS * at_once)).unwrap_or(u32::MAX);
            let tiles = next..self.tile_count.min(next.saturating_add(tile_count.max(1)));
            next = tiles.end;
            let of_tiles = self.add_to_tiles(session, tiles, &records)?;
            gpu_seconds = gpu_seconds.zip(of_tiles).map(|(before, of_tiles)| before + of_tiles);
        }
        Ok(gpu_seconds)
    }

    /// Adds all records of a cache up in some tiles.
    fn add_to_tiles(
        &mut self,
        session: &Arc<Session>,
        tiles: Range<u32>,
        records: &Range<u32>,
    ) -> Result<Option<f64>, GpuError> {
        let mut gpu_seconds = Some(0.0);
        let mut next = records.start;
        loop {
            let start = Instant::now();
            let first = next;
            next = records.end.min(first.saturating_add(self.pace.at_once_max));
            let slice = GpuTileSlice {
                first_tile: tiles.start,
                end_tile: tiles.end,
                first_record: first,
                end_record: next,
                begins: u32::from(first == records.start),
                ends: u32::from(next == records.end),
                ..GpuTileSlice::zeroed()
            };
            let of_batch = self.add_slice(session, slice)?;
            gpu_seconds = gpu_seconds.zip(of_batch).map(|(before, of_batch)| before + of_batch);
            let pixel_count = u64::from(tiles.end - tiles.start) * TILE_PIXELS;
            // A tile costs something without records, too.
            let covered = pixel_count * u64::from((next - first).max(1));
            self.keep_pace(covered, start.elapsed().as_secs_f64());
            if next == records.end {
                return Ok(gpu_seconds);
            }
        }
    }

    fn add_slice(&mut self, session: &Arc<Session>, slice: GpuTileSlice) -> Result<Option<f64>, GpuError> {
        session.write(&self.slice, 0, bytemuck::bytes_of(&slice))?;
        let mut batch = (self.pace.begin)(session, "records of a picture")?;
        let TileSteps { reach, splat, .. } = self.steps;
        if let Some(group) = self.reach_group.take() {
            batch.dispatch(reach, &[&group], reach.workgroups(self.spheres.byte_count() / SPHERE_BYTES))?;
        }
        let invocations = u64::from(slice.end_tile - slice.first_tile) * TILE_PIXELS;
        batch.dispatch(splat, &[&self.splat_group], splat.workgroups(invocations))?;
        batch.submit()?.gpu_seconds()
    }

    /// - `covered`: pixels of the last batch times records
    /// - `seconds`: that it took
    fn keep_pace(&mut self, covered: u64, seconds: f64) {
        if seconds > self.pace.seconds_max {
            self.covered = covered / 2;
        } else {
            // A small rest says nothing about larger batches.
            let growth = (0.5 * self.pace.seconds_max / seconds).clamp(1.0, GROWTH_MAX);
            self.covered = self.covered.max((covered as f64 * growth) as u64);
        }
    }
}
