//! Records in the pixels where they may count.
//!
//! A record counts within a sphere; what of a picture shows that sphere is a rectangle of pixels [Mara2013], and every sample of those
//! adds the record's weight and what it says there: Σ w E and Σ w [Gautron2008, 8.3]. A look-up asks the index of all records for each
//! sample; here each record is brought to its pixels once a pass, and records are sorted into tiles once a camera. What no record
//! reaches, and what is seen in mirrors, is looked up.
//!
//! The sums are those of [`IrradianceCache::irradiance`], in the order of the records: the same bytes on any number of threads.
//! `shaders/irradiance/splat.wgsl` and `splat_tiles.wgsl` add up the same on a graphics card, at the middles of pixels.

#[cfg(test)]
mod tests;

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use glam::{UVec2, Vec3};
use rayon::prelude::*;

use super::{Facing, IrradianceCache, Record, record::WeighedSum};
use crate::{
    film::TILE_SIDE,
    math::Rgb,
    technique::{FirstSight, ScreenLight, View},
};

/// Records in tiles for each pixel of a picture, at most. Where there are more, so many lie one over the other in every pixel that
/// looking them up takes no longer.
const PLACED_PER_PIXEL: usize = 2;
/// Records for each pixel, at most: beyond, sorting them takes longer than looking up what the picture shows.
const RECORDS_PER_PIXEL: usize = 2;

/// Records of a cache, and of the rougher ones that answer after it, as a camera sees them.
#[derive(Debug)]
pub(super) struct Splats {
    /// Tiles in a row of the picture.
    columns: u32,
    /// The finest first.
    caches: Vec<Placed>,
    /// Of all threads; sorting counts as one's.
    nanoseconds: AtomicU64,
}

/// Records of one cache, by tiles.
#[derive(Debug)]
struct Placed {
    cache: Arc<IrradianceCache>,
    /// Where the records of each tile begin, and an end.
    starts: Vec<u32>,
    /// Ascending within a tile.
    records: Vec<PlacedRecord>,
}

/// A record and the pixels that its sphere shows in.
#[derive(Clone, Copy, Debug, Default)]
struct PlacedRecord {
    record: u32,
    pixels: PixelRect,
}

/// Pixels from a first to a last one, by axis.
#[derive(Clone, Copy, Debug, Default)]
struct PixelRect {
    first: [u16; 2],
    last: [u16; 2],
}

/// A point that a pixel of a tile sees.
struct SeenPoint {
    position: Vec3,
    facing: Facing,
    sum: WeighedSum,
}

impl Splats {
    /// Memory for each pixel of a picture, at most: of records in tiles, and of all while they are sorted.
    pub(super) const BYTES_PER_PIXEL: usize =
        PLACED_PER_PIXEL * size_of::<PlacedRecord>() + RECORDS_PER_PIXEL * size_of::<Option<PixelRect>>();

    /// `None` where looking records up takes less time, or less memory.
    pub(super) fn of(cache: Arc<IrradianceCache>, view: &View) -> Option<Splats> {
        let start = Instant::now();
        let pixel_count = view.size().pixel_count();
        let mut room = PLACED_PER_PIXEL * pixel_count;
        let mut caches = Vec::new();
        let mut next = Some(cache);
        while let Some(cache) = next {
            next = cache.rougher.clone();
            if cache.records.len() > RECORDS_PER_PIXEL * pixel_count {
                return None;
            }
            let placed = Placed::of(cache, view, room)?;
            room -= placed.records.len();
            caches.push(placed);
        }
        let splats =
            Splats { columns: view.size().width().div_ceil(TILE_SIDE), caches, nanoseconds: 0.into() };
        splats.take_time(start);
        Some(splats)
    }

    fn take_time(&self, start: Instant) {
        self.nanoseconds.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
    }
}

impl Placed {
    fn of(cache: Arc<IrradianceCache>, view: &View, room: usize) -> Option<Placed> {
        let accuracy = cache.settings.weighing.accuracy;
        let pixels_of = |record: &Record| {
            let [first, last] = view.pixels_of_sphere(record.position, record.reach_m(accuracy))?;
            let narrow = |[x, y]: [u32; 2]| [x as u16, y as u16];
            Some(PixelRect { first: narrow(first), last: narrow(last) })
        };
        let pixels: Vec<Option<PixelRect>> =
            cache.records.par_iter().with_min_len(512).map(pixels_of).collect();
        let size = view.size();
        let [columns, rows] = [size.width(), size.height()].map(|pixels| pixels.div_ceil(TILE_SIDE) as usize);
        let tiles_of = |pixels: &PixelRect| {
            let [first, last] =
                [pixels.first, pixels.last].map(|at| at.map(|at| at as usize / TILE_SIDE as usize));
            (first[1]..=last[1])
                .flat_map(move |row| (first[0]..=last[0]).map(move |column| row * columns + column))
        };
        // One more than there are tiles, and one that is not used.
        let mut starts = vec![0_u32; columns * rows + 2];
        let mut count = 0;
        for pixels in pixels.iter().flatten() {
            for tile in tiles_of(pixels) {
                starts[tile + 2] += 1;
                count += 1;
            }
            if count > room {
                return None;
            }
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += *start;
            *start = sum;
        }
        let mut records = vec![PlacedRecord::default(); count];
        // The start of the next tile is where the next record of this one goes, until it has all of them.
        for (record, pixels) in (0..).zip(&pixels) {
            let Some(pixels) = pixels else { continue };
            for tile in tiles_of(pixels) {
                records[starts[tile + 1] as usize] = PlacedRecord { record, pixels: *pixels };
                starts[tile + 1] += 1;
            }
        }
        Some(Placed { cache, starts, records })
    }

    /// Adds what the records of a tile say to the points that its pixels see.
    ///
    /// - `points`: row by row
    fn splat(&self, tile: usize, origin: UVec2, size: UVec2, points: &mut [Option<SeenPoint>]) {
        let weighing = &self.cache.settings.weighing;
        let end = origin + size - 1;
        for placed in &self.records[self.starts[tile] as usize..self.starts[tile + 1] as usize] {
            let record = &self.cache.records[placed.record as usize];
            let reach_m = record.reach_m(weighing.accuracy);
            let reach_m2 = reach_m * reach_m;
            let [first, last] =
                [placed.pixels.first, placed.pixels.last].map(|at| UVec2::from(at.map(u32::from)));
            let (first, last) = (first.max(origin) - origin, last.min(end) - origin);
            for y in first.y..=last.y {
                let row = (y * size.x) as usize;
                for point in points[row + first.x as usize..=row + last.x as usize].iter_mut().flatten() {
                    if point.position.distance_squared(record.position) > reach_m2 {
                        continue;
                    }
                    let weight = record.weight(point.position, &point.facing, weighing);
                    if weight > 0.0 {
                        let irradiance = record.irradiance_at(point.position, point.facing.normal, weighing);
                        point.sum.add(record, irradiance, weight);
                    }
                }
            }
        }
    }
}

impl ScreenLight for Splats {
    fn scattered_over(&self, origin: UVec2, size: UVec2, seen: &[Option<FirstSight>]) -> Vec<Option<Rgb>> {
        let start = Instant::now();
        let point_of = |sight: &FirstSight| SeenPoint {
            position: sight.surface.point.position,
            facing: Facing::of(&sight.surface, sight.wo),
            sum: WeighedSum::default(),
        };
        let is_diffuse = |sight: &&FirstSight| sight.surface.bsdf.has_diffuse();
        let mut points: Vec<Option<SeenPoint>> =
            seen.iter().map(|sight| sight.as_ref().filter(is_diffuse).map(point_of)).collect();
        let mut scattered = vec![None; seen.len()];
        let tile = (origin.y / TILE_SIDE * self.columns + origin.x / TILE_SIDE) as usize;
        for placed in &self.caches {
            placed.splat(tile, origin, size, &mut points);
            for ((point, sight), scattered) in points.iter_mut().zip(seen).zip(&mut scattered) {
                // What was answered for is not asked of rougher records.
                let light = point.as_ref().and_then(|point| point.sum.light());
                if let (Some(light), Some(FirstSight { surface, wo })) = (light, sight) {
                    *point = None;
                    *scattered = Some(light.scattered(surface, *wo));
                }
            }
        }
        self.take_time(start);
        scattered
    }

    fn thread_seconds(&self) -> f64 {
        self.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9
    }
}
