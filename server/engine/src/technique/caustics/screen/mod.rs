//! Caustics of the first picture after a camera or a scene has moved: some photons, counted on the screen.
//!
//! Larsen's way [Larsen2004, 12]: a few thousand photons are followed once for a scene, drawn into the pixels they lie behind,
//! and every pixel takes what lies in a window of pixels around it. Another camera only draws them anew. The window covers on
//! a surface at the depth d, under the angle θ, the area (2k+1)² · A(d) / cos θ, and flux over area is irradiance.
//!
//! Larsen's window is the same everywhere, and counts photons that nothing hides. Here each photon has a
//! window of its own, about as wide as it takes to hold some others: so it is narrow in a focus, and no flux is counted twice
//! where wide ones meet narrow ones. What lies on other surfaces is told by where it lies. A pixel asks one cell for the photons of
//! each width. Tiles that no window reaches into, which are most, are skipped.
//!
//! **Biased**: blurs by pixels, darkens at borders, and knows nothing of what is not on the screen. What is seen in a mirror
//! shows its caustics only where it is itself on the screen. Seen from so near that few photons lie in the widest window, it is
//! no use, and not used. It is for one pass, and leaves the film with the next.
//!
//! A graphics card counts and filters them by the same rules (`for_card.rs`).

mod for_card;
#[cfg(test)]
mod tests;

use std::{f32::consts::SQRT_2, ops::Range, sync::Arc, time::Instant};

use glam::Vec3;
use rayon::prelude::*;

use super::{
    CausticLight, CausticPhoton, CausticReport, CausticSettings,
    map::{FLATNESS, Lit},
};
use crate::{
    technique::{FocusedLight, FocusedScatter, GpuPhoton, LeftToSampling, SKETCH_WIDTHS, View},
    transport::{Surface, World},
};

/// Pixels on each side of the middle one of a window, in a picture of 512 × 512: 3 everywhere by [Larsen2004, 12.1]; here less in
/// a focus, more where few photons fall.
const HALVES_PX: [f32; SKETCH_WIDTHS] = [0.0, 1.0, 2.0, 4.0, 8.0];
const HALVES_OF_PX: f32 = 512.0;
/// In the small pictures that are drawn while a camera moves no less than half of that: single photons would stand out as squares.
const TIMES_MIN: f32 = 0.5;
/// Photons in a window for it not to be widened.
const ENOUGH: u32 = 8;
/// Binary logarithm of the width of tiles of the picture, px: those that no photon's window reaches into are skipped.
const TILE_LOG2: u32 = 3;
/// Binary logarithm of the least width of cells, px: each pixel a cell would cost more than it saves.
const CELL_LOG2_MIN: u32 = 2;
/// Memory for every pixel of a picture, at most: what counts photons in windows.
const BYTES_PER_PIXEL: usize = 5;
/// The same for every photon: the sketch, which a picture keeps until its first pass is drawn, and what is packed of it for a card.
const BYTES_PER_PHOTON: usize = size_of::<CausticPhoton>() + size_of::<GpuPhoton>();
/// Photons so far from the origin of render space are dropped, m: a thousand times as far as scenes reach, and near enough for squares of
/// what lies between them to be numbers on whatever card.
const FAR_M: f32 = 1e12;
/// Share of the flux in windows that hold few photons, in a picture of which photons on the screen are no fit estimate: seen from
/// near, one would stand alone.
const SPARSE_SHARE: f32 = 0.5;
/// Least cosine at which all of a window counts. Seen at less, photons far away on the same surface do not: windows are as long
/// as at this one, and cover what that leaves.
const COS_MIN: f32 = 0.1;
/// A window that covers less shows nothing: one over its area is no number, m.
const ACROSS_MIN_M: f32 = 1e-18;

/// Photons of a scene's caustics, for whatever camera.
#[derive(Debug)]
pub struct CausticSketch {
    photons: Arc<[CausticPhoton]>,
    /// Of what photons there may be.
    light: CausticLight,
    report: CausticReport,
    rays: u64,
}

impl CausticSketch {
    /// Follows them. Takes some milliseconds, and more where photons bounce on and on.
    ///
    /// - `settings`: with as many photons as there are to be, [`CausticSettings::for_sketch`]
    pub fn of(world: &World, settings: &CausticSettings) -> CausticSketch {
        let start = Instant::now();
        let (photons, traced) = super::first_pass(world, settings);
        let photons = near(photons);
        let report = CausticReport {
            seconds: start.elapsed().as_secs_f64(),
            photons_emitted: traced.photons,
            photons_stored: photons.len() as u64,
            bytes: photons.len() * size_of::<CausticPhoton>(),
        };
        CausticSketch { photons: photons.into(), light: settings.light, report, rays: traced.rays }
    }

    /// Rays that it took.
    pub fn rays(&self) -> u64 {
        self.rays
    }

    /// Memory of a picture of so many pixels that is drawn with one of as many photons as a card takes.
    pub fn bytes_max(pixel_count: usize) -> usize {
        pixel_count * BYTES_PER_PIXEL + for_card::PHOTONS_MAX * BYTES_PER_PHOTON
    }

    /// What it took and holds.
    pub fn report(&self) -> CausticReport {
        self.report
    }

    /// As a camera sees them; `None` where it sees too few of them from too near.
    pub fn seen_by(&self, view: &View) -> Option<Arc<dyn FocusedLight>> {
        let chosen = Chosen::of(&self.photons, &places_of(&self.photons, view), view);
        chosen.is_fit.then(|| {
            let levels = (0..SKETCH_WIDTHS).into_par_iter().map(|width| chosen.level(width, view)).collect();
            Arc::new(ScreenCaustics::of(self, &chosen, levels, view)) as _
        })
    }
}

/// Photons that lie nearer than [`FAR_M`] along each axis.
fn near(mut photons: Vec<CausticPhoton>) -> Vec<CausticPhoton> {
    photons.retain(|photon| photon.position.to_array().iter().all(|along| along.abs() < FAR_M));
    photons
}

/// Photons in their pixels.
#[derive(Debug)]
struct ScreenCaustics {
    view: View,
    photons: Arc<[CausticPhoton]>,
    light: CausticLight,
    /// By the widths of windows.
    levels: Vec<Level>,
    /// Tiles in a row, and of each whether any photon's window reaches into it.
    tile_columns: usize,
    tiles: Vec<bool>,
}

/// Photons with windows of one width, by cells of about half that width, or a few pixels.
#[derive(Debug)]
struct Level {
    /// Pixels on each side of the middle one.
    half_px: i32,
    /// What a photon counts in pixels so many columns and rows away, `[half + 1, half + 1]`, relative to the mean over its window:
    /// less and less away from the middle.
    weights: Vec<f32>,
    /// Binary logarithm of the width of a cell, px.
    cell_log2: u32,
    /// Cells in a row.
    columns: i32,
    /// Where the photons of each cell begin; one more than there are cells, and one that is not used.
    starts: Vec<u32>,
    /// In every cell that their windows reach into.
    placed: Vec<Placed>,
}

/// A photon in its pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Placed {
    pixel: [i32; 2],
    position: Vec3,
    /// Place among all.
    photon: u32,
}

/// Pixels on each side of the middle one of the windows of a picture, the narrowest first.
fn halves_px(view: &View) -> [i32; SKETCH_WIDTHS] {
    let times = ((view.size().pixel_count() as f32).sqrt() / HALVES_OF_PX).max(TIMES_MIN);
    HALVES_PX.map(|half| (half * times).round() as i32)
}

/// Windows of photons so many pixels beyond the borders reach into the picture.
fn margin_of(halves_px: [i32; SKETCH_WIDTHS]) -> i32 {
    halves_px.into_iter().max().unwrap_or(0)
}

fn extent_of(view: &View) -> [i32; 2] {
    [view.size().width(), view.size().height()].map(|count| count as i32)
}

/// The pixel that each photon shows in; `None` where no window of it reaches into the picture.
fn places_of(photons: &[CausticPhoton], view: &View) -> Vec<Option<[i32; 2]>> {
    let (margin, extent) = (margin_of(halves_px(view)), extent_of(view));
    let is_near = |pixel: &[i32; 2]| {
        let along = |axis: usize| (-margin..extent[axis] + margin).contains(&pixel[axis]);
        along(0) && along(1)
    };
    photons.iter().map(|photon| pixel_of(view, photon.position).filter(is_near)).collect()
}

/// Photons that show somewhere, by the widths of their windows.
struct Chosen {
    by_level: [Vec<Placed>; SKETCH_WIDTHS],
    /// Enough of their flux lies in windows that hold enough of them.
    is_fit: bool,
}

impl Chosen {
    fn of(photons: &[CausticPhoton], places: &[Option<[i32; 2]>], view: &View) -> Chosen {
        let halves_px = halves_px(view);
        let counts = Counts::of(places.iter().flatten(), extent_of(view), margin_of(halves_px));
        let mut by_level = HALVES_PX.map(|_| Vec::new());
        let (mut flux_w, mut sparse_w) = (0.0, 0.0);
        for ((photon, of_photon), pixel) in (0..).zip(photons).zip(places) {
            let Some(pixel) = *pixel else { continue };
            let level = counts.level_of(pixel, halves_px);
            let luminance_w = of_photon.flux_w.luminance();
            flux_w += luminance_w;
            sparse_w += if level.is_none() { luminance_w } else { 0.0 };
            let placed = Placed { pixel, position: of_photon.position, photon };
            by_level[level.unwrap_or(halves_px.len() - 1)].push(placed);
        }
        Chosen { by_level, is_fit: !(sparse_w > SPARSE_SHARE * flux_w) }
    }

    /// Those with windows of one width.
    fn level(&self, width: usize, view: &View) -> Level {
        Level::of(halves_px(view)[width], extent_of(view), &self.by_level[width])
    }
}

impl ScreenCaustics {
    /// - `levels`: of all widths
    fn of(sketch: &CausticSketch, chosen: &Chosen, levels: Vec<Level>, view: &View) -> ScreenCaustics {
        let (extent, halves_px) = (extent_of(view), halves_px(view));
        let [tile_columns, tile_rows] = extent.map(|count| ((count - 1) >> TILE_LOG2) as usize + 1);
        let mut tiles = vec![false; tile_columns * tile_rows];
        for (placed, half_px) in chosen.by_level.iter().zip(halves_px) {
            for [across, down] in
                placed.iter().map(|placed| reached(placed.pixel, half_px, extent, TILE_LOG2))
            {
                down.for_each(|row| {
                    let row = row as usize * tile_columns;
                    tiles[row + across.start as usize..row + across.end as usize].fill(true);
                });
            }
        }
        let (photons, light) = (Arc::clone(&sketch.photons), sketch.light);
        ScreenCaustics { view: *view, photons, light, levels, tile_columns, tiles }
    }
}

/// The pixel where a point shows; far outside it may be any that is outside.
fn pixel_of(view: &View, p: Vec3) -> Option<[i32; 2]> {
    // At no distance to speak of from the eye there may be no number.
    let at = view.project(p).filter(|at| at.iter().all(|at| at.is_finite()))?;
    Some(at.map(|at| at.floor() as i32))
}

impl Level {
    fn of(half_px: i32, extent: [i32; 2], all: &[Placed]) -> Level {
        let cell_log2 = cell_log2_of(half_px);
        let [columns, rows] = extent.map(|count| ((count - 1) >> cell_log2) + 1);
        let (mut starts, mut placed) = (vec![0; columns as usize * rows as usize + 2], Vec::new());
        let cells = |placed: &Placed| {
            let [across, down] = reached(placed.pixel, half_px, extent, cell_log2);
            down.flat_map(move |row| across.clone().map(move |column| (row * columns + column) as usize))
        };
        for photon in all {
            cells(photon).for_each(|cell| starts[cell + 2] += 1);
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += *start;
            *start = sum;
        }
        placed.resize(sum as usize, Placed::default());
        // The start of the next cell is where the next photon of this one goes, until it has all of them.
        for photon in all {
            for cell in cells(photon) {
                placed[starts[cell + 1] as usize] = *photon;
                starts[cell + 1] += 1;
            }
        }
        Level { half_px, weights: weights_of(half_px), cell_log2, columns, starts, placed }
    }

    /// Photons whose windows may hold a pixel of the picture.
    fn in_cell_of(&self, [x, y]: [i32; 2]) -> &[Placed] {
        let cell = ((y >> self.cell_log2) * self.columns + (x >> self.cell_log2)) as usize;
        &self.placed[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

/// Binary logarithm of the width of cells for windows of a width, px.
fn cell_log2_of(half_px: i32) -> u32 {
    (half_px.max(1) as u32).ilog2().max(CELL_LOG2_MIN)
}

/// The kernel of [Silverman1986, 4.2] on pixels, with a mean of 1 over the window.
fn weights_of(half_px: i32) -> Vec<f32> {
    let end2 = ((half_px + 1) * (half_px + 1)) as f32;
    let weight = |x: i32, y: i32| (1.0 - (x * x + y * y) as f32 / end2).max(0.0);
    let window = || -half_px..=half_px;
    let sum: f32 = window().flat_map(|y| window().map(move |x| weight(x, y))).sum();
    let scale = ((2 * half_px + 1) * (2 * half_px + 1)) as f32 / sum;
    (0..=half_px).flat_map(|y| (0..=half_px).map(move |x| scale * weight(x, y))).collect()
}

/// Columns and rows of squares in a picture that a window around a pixel reaches into.
fn reached(pixel: [i32; 2], half_px: i32, extent: [i32; 2], square_log2: u32) -> [Range<i32>; 2] {
    [0, 1].map(|axis| {
        let (first, last) = ((pixel[axis] - half_px).max(0), (pixel[axis] + half_px).min(extent[axis] - 1));
        // Before the picture's first pixel there is no square.
        if last < first { 0..0 } else { first >> square_log2..(last >> square_log2) + 1 }
    })
}

/// How many photons there are in any window: a summed-area table [Crow1984].
struct Counts {
    margin: i32,
    /// Pixels with the margin.
    extent: [i32; 2],
    /// Photons above and left of every pixel's corner: one more column and row than pixels.
    above_left: Vec<u32>,
}

impl Counts {
    fn of<'a>(pixels: impl Iterator<Item = &'a [i32; 2]>, extent: [i32; 2], margin: i32) -> Counts {
        let extent = extent.map(|count| count + 2 * margin);
        let [columns, rows] = extent.map(|count| count as usize + 1);
        let mut above_left = vec![0; columns * rows];
        for [x, y] in pixels {
            above_left[(y + margin + 1) as usize * columns + (x + margin + 1) as usize] += 1;
        }
        for row in 1..rows {
            let mut of_row = 0;
            for column in 1..columns {
                of_row += above_left[row * columns + column];
                above_left[row * columns + column] = above_left[(row - 1) * columns + column] + of_row;
            }
        }
        Counts { margin, extent, above_left }
    }

    /// The narrowest of some windows around a pixel that holds enough photons.
    fn level_of(&self, pixel: [i32; 2], halves_px: [i32; SKETCH_WIDTHS]) -> Option<usize> {
        halves_px.into_iter().position(|half_px| self.within(pixel, half_px) >= ENOUGH)
    }

    /// Photons in a window around a pixel.
    fn within(&self, pixel: [i32; 2], half_px: i32) -> u32 {
        let [width, height] = self.extent;
        let [x, y] = pixel.map(|at| at + self.margin);
        let [left, right] = [(x - half_px).max(0), (x + half_px + 1).min(width)];
        let [top, bottom] = [(y - half_px).max(0), (y + half_px + 1).min(height)];
        let at = |x: i32, y: i32| self.above_left[y as usize * (width as usize + 1) + x as usize];
        at(right, bottom) + at(left, top) - at(right, top) - at(left, bottom)
    }
}

impl FocusedLight for ScreenCaustics {
    fn scattered(&self, surface: &Surface, wo: Vec3, scatterings_max: u32) -> FocusedScatter {
        let p = surface.point.position;
        let size = self.view.size();
        let is_inside =
            |[x, y]: [i32; 2]| x >= 0 && y >= 0 && (x as u32) < size.width() && (y as u32) < size.height();
        let is_lit = |[x, y]: [i32; 2]| {
            self.tiles[(y >> TILE_LOG2) as usize * self.tile_columns + (x >> TILE_LOG2) as usize]
        };
        let pixel = pixel_of(&self.view, p).filter(|pixel| is_inside(*pixel));
        let Some(pixel) = pixel.filter(|pixel| is_lit(*pixel)) else {
            return FocusedScatter::default();
        };
        let n = surface.point.n_geo;
        let (towards_eye, pixel_m2) = self.view.pixel_at(p);
        let (cos, pixel_m) = (towards_eye.dot(n).abs(), pixel_m2.sqrt());
        let mut lit = Lit::new(surface, wo, scatterings_max);
        for level in &self.levels {
            let in_cell = level.in_cell_of(pixel);
            if in_cell.is_empty() {
                continue;
            }
            let width = (2 * level.half_px + 1) as f32;
            let across_m = width * pixel_m;
            if !(across_m > ACROSS_MIN_M) {
                continue;
            }
            // What shows there lies on the same sheet of the same surface, not behind it: no further than corner to corner.
            let above_end_m = (level.half_px + 1) as f32 * pixel_m / FLATNESS;
            let along_end_m = SQRT_2 * across_m / cos.max(COS_MIN);
            // Of a window that is longer, what is twice as long as that.
            let per_m2 = (cos / across_m).max(0.5 / along_end_m) / across_m;
            for placed in in_cell {
                let [right, down] = [0, 1].map(|axis| (placed.pixel[axis] - pixel[axis]).abs());
                if right.max(down) > level.half_px {
                    continue;
                }
                let weight = level.weights[(down * (level.half_px + 1) + right) as usize];
                let away = placed.position - p;
                if away.dot(n).abs() < above_end_m && away.length_squared() < along_end_m * along_end_m {
                    lit.add(&self.photons[placed.photon as usize], weight * per_m2);
                }
            }
        }
        lit.scatter()
    }

    fn leaves(&self) -> LeftToSampling {
        self.light.left()
    }

    fn is_sketch(&self) -> bool {
        true
    }
}
