//! Film: what the samples of a picture add up to, and how far the sum still is from the truth.
//!
//! A film is a row of [`Tile`]s that techniques fill in parallel, one pass (one sample per pixel) at a time.
//! Out of it come the picture, its layers by path class, the first hit's albedo, normal and depth, the
//! variance per pixel and the measured error: of its noise in `measured.rs`, bias included in `gauged.rs`, relative to what
//! `standing.rs` and `weights.rs` say of the truth. `denoise.rs` takes noise off a film of looked-up light, `picture.rs` blends a film of looked-up light with one that is path-traced,
//! `error.rs` is the metric of the contract against a reference, `tone_map.rs` turns radiance into what a screen shows.
//! Imports `math`, `scene` and `transport` only. The tiling and the separation of sums from display follow
//! pbrt's film; the two independent halves are those of [Rousselle2012].

pub(crate) mod denoise;
mod error;
mod gauged;
mod measured;
mod picture;
mod pixel;
mod standing;
mod tile;
mod tone_map;
mod weights;

use crate::math::Rgb;
use crate::transport::PathClass;
use glam::Vec3;
use rayon::prelude::*;

pub use denoise::Denoising;
pub use error::{CompareError, ImageError, compare};
pub use gauged::{GAUGED_GROUPS, GaugedPixel, Lacking, lacking, measure_at};
pub use measured::{BLACK_PASSES, MeasuredError};
#[cfg(all(test, feature = "gpu"))]
pub(crate) use picture::TracedPart;
#[cfg(feature = "gpu")]
pub(crate) use picture::Weights;
pub use picture::{Picture, PictureParts};
pub use pixel::{Beyond, PixelSample};
pub use tile::{TILE_SIDE, Tile};
pub use tone_map::{Display, ToneMap, UnknownToneMap};
#[cfg(feature = "gpu")]
pub(crate) use tone_map::{Fit, RADIANCE_MAX};

use pixel::{BeyondSums, Held, Pixel, SCATTERED};

/// Width and height of a picture in pixels, each in 1 ..= [`PictureSize::SIDE_MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PictureSize {
    width: u32,
    height: u32,
}

/// A picture size outside the allowed range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {width}×{height} pixels: each side must be 1 to {}", PictureSize::SIDE_MAX)]
pub struct BadPictureSize {
    /// Width asked for.
    pub width: u32,
    /// Height asked for.
    pub height: u32,
}

impl PictureSize {
    /// Longest side: the largest texture that common GPUs hold.
    pub const SIDE_MAX: u32 = 16_384;

    /// A checked size.
    pub fn new(width: u32, height: u32) -> Result<PictureSize, BadPictureSize> {
        let side = 1..=Self::SIDE_MAX;
        if side.contains(&width) && side.contains(&height) {
            Ok(PictureSize { width, height })
        } else {
            Err(BadPictureSize { width, height })
        }
    }

    /// Pixels in a row.
    pub fn width(self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(self) -> u32 {
        self.height
    }

    /// Width / height.
    pub fn aspect(self) -> f64 {
        f64::from(self.width) / f64::from(self.height)
    }

    /// Width × height.
    pub fn pixel_count(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// What light that is to be replaced is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outdated {
    /// It is of the same scene, only less well known: it counts for two passes at most beside what comes.
    Rough,
    /// It is of the scene before an edit, or was good enough only while somebody moved: it goes with the next pass.
    Wrong,
}

/// Sums of samples for every pixel of a picture; see the module's head.
///
/// Every image that it returns is `[h × w]`, rows top to bottom.
#[derive(Clone, Debug)]
pub struct Film {
    size: PictureSize,
    tiles: Vec<Tile>,
}

impl Film {
    /// Memory of one pixel. Radiance is summed in double precision (152 of the 184 bytes): in single
    /// precision a constant 0.1 is 1 % off after 10⁶ passes, and after one bright sample of 10⁶ every
    /// sample below 0.03 is lost for good, which is a bias. Albedo, normal and depth guide filters and
    /// are summed in single precision: they are bounded or all of one size within a pixel, and 10⁵
    /// passes leave them right to 1 ‰ (tested).
    pub const BYTES_PER_PIXEL: usize = size_of::<Pixel>();
    /// Memory of one pixel more, in tiles where something is seen in mirrors or through clear glass, of films that are
    /// [filtered](Film::unfiltered).
    pub const BYTES_BEYOND: usize = size_of::<BeyondSums>();

    /// A film without samples.
    pub fn new(size: PictureSize) -> Film {
        let columns = size.width.div_ceil(TILE_SIDE);
        let rows = size.height.div_ceil(TILE_SIDE);
        // By one thread: tiles that many made lie apart, and take two thirds longer to read (1920 × 1080, 12 ms for 20 as they are).
        let tile_at = |row: u32, column: u32| Tile::new(size, column * TILE_SIDE, row * TILE_SIDE);
        let tiles = (0..rows).flat_map(|row| (0..columns).map(move |column| tile_at(row, column))).collect();
        Film { size, tiles }
    }

    /// The same, for what no noise is taken off: it does not keep what is beyond mirrors and glass.
    pub fn unfiltered(size: PictureSize) -> Film {
        let mut film = Film::new(size);
        film.tiles.iter_mut().for_each(Tile::ignore_beyond);
        film
    }

    /// Size of the picture.
    pub fn size(&self) -> PictureSize {
        self.size
    }

    /// The tiles, in row order.
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// The tiles, in row order, to be filled. Each counts its own passes, so a pass that was cancelled
    /// between two tiles leaves every pixel an unbiased mean.
    pub fn tiles_mut(&mut self) -> &mut [Tile] {
        &mut self.tiles
    }

    /// Lets the passes to come replace light of `classes`, of those that diffuse surfaces scatter on their way (all but [`PathClass::SEEN`]), since more is known
    /// of it now. What was sampled of the others stays.
    pub fn outdate(&mut self, classes: &[PathClass], outdated: Outdated) {
        self.tiles.iter_mut().for_each(|tile| tile.outdate(classes, outdated));
    }

    /// Passes that every pixel has.
    pub fn passes_min(&self) -> u32 {
        self.tiles.iter().map(Tile::passes).min().unwrap_or(0)
    }

    /// Passes that the pixel with the most has: more than [`Film::passes_min`] after a pass that was cancelled.
    pub fn passes_max(&self) -> u32 {
        self.tiles.iter().map(Tile::passes).max().unwrap_or(0)
    }

    /// Samples of all pixels together.
    pub fn sample_count(&self) -> u64 {
        self.tiles.iter().map(|tile| u64::from(tile.passes()) * tile.pixels.len() as u64).sum()
    }

    /// Samples that held a NaN, an infinity or a negative value. They count as black, which is a bias
    /// when there are any: show the number.
    pub fn dropped_samples(&self) -> u64 {
        self.tiles.iter().map(Tile::dropped_samples).sum()
    }

    /// Memory of the film.
    pub fn bytes(&self) -> usize {
        let beyond: usize = self.tiles.iter().map(Tile::beyond_bytes).sum();
        self.size.pixel_count() * Self::BYTES_PER_PIXEL + self.tiles.len() * size_of::<Tile>() + beyond
    }

    /// Radiance of all path classes together, W/(m² sr); black where no pass has run.
    pub fn radiance(&self) -> Vec<Rgb> {
        self.image(Rgb::BLACK, |pixel, held| rgb_from(pixel.total_mean(held)))
    }

    /// Radiance of one path class, W/(m² sr). The layers add up to [`Film::radiance`].
    pub fn layer(&self, class: PathClass) -> Vec<Rgb> {
        self.image(Rgb::BLACK, |pixel, held| rgb_from(pixel.class_mean(class, held)))
    }

    /// Mean albedo of the first hit; samples that hit nothing count as black.
    pub fn albedo(&self) -> Vec<Rgb> {
        self.image(Rgb::BLACK, |pixel, held| pixel.albedo_sum / held.passes as f32)
    }

    /// Mean direction of the first hits' normals in the world, unit length; zero where nothing was hit.
    pub fn normal(&self) -> Vec<Vec3> {
        self.image(Vec3::ZERO, |pixel, _| pixel.normal_sum.normalize_or_zero())
    }

    /// Mean depth of the samples that hit, metres along the camera's axis; 0 where none did.
    pub fn depth(&self) -> Vec<f32> {
        self.image(0.0, |pixel, _| pixel.depth_mean_m())
    }

    /// Variance of each pixel's mean luminance, (W/(m² sr))², from the spread of its samples; zero below
    /// two passes, at most `f32::MAX`.
    ///
    /// Unbiased for independent samples; for the stratified samples of a pixel it is an upper estimate,
    /// because it does not see that they avoid each other. [`Film::measured_error`] does.
    pub fn variance(&self) -> Vec<f32> {
        self.image(0.0, |pixel, held| pixel.variance_of_mean(held).min(f64::from(f32::MAX)) as f32)
    }

    /// The error of the picture shown now, measured from its two independent halves; `None` below two
    /// passes anywhere and below 64 of a picture that is black all over. Takes some 0.3 µs a pixel:
    /// ask a few times a second, not for every frame.
    pub fn measured_error(&self) -> Option<MeasuredError> {
        if self.tiles.iter().any(|tile| tile.held().before_halves > 0) {
            // The picture holds what its halves do not.
            return None;
        }
        measured::measure(self)
    }

    /// The noise of what was sampled since scattered light was last replaced, as relMSE, and over how many passes; `None` below two. For
    /// deciding by it: fine detail is measured by what is around it.
    pub fn noise(&self) -> Option<(MeasuredError, u32)> {
        Some((measured::measure_roughly(self)?, self.halves_passes_min()))
    }

    /// Passes that the sums of a class of light hold, where those are fewest: since it was replaced, and those that it counts for from before.
    pub(crate) fn passes_held(&self, class: PathClass) -> u32 {
        self.tiles.iter().map(|tile| tile.held().of(class)).min().unwrap_or(0)
    }

    /// Passes whose samples tell how much they spread, where those are fewest.
    fn spread_passes_min(&self) -> u32 {
        self.tiles.iter().map(|tile| tile.held().spread()).min().unwrap_or(0)
    }

    fn halves_passes_min(&self) -> u32 {
        let of_tile = |tile: &Tile| tile.held().passes - tile.held().before_halves;
        self.tiles.iter().map(of_tile).min().unwrap_or(0)
    }

    /// One value per pixel, from tiles to rows; `empty` where no pass has run.
    fn image<T: Copy + Send>(&self, empty: T, value: impl Fn(&Pixel, Held) -> T + Sync) -> Vec<T> {
        self.image_by_tiles(empty, |tile, index| value(&tile.pixels[index], tile.held()))
    }

    /// The same, by tiles and indices of pixels in them.
    fn image_by_tiles<T: Copy + Send>(&self, empty: T, value: impl Fn(&Tile, usize) -> T + Sync) -> Vec<T> {
        let width = self.size.width as usize;
        let mut image = vec![empty; self.size.pixel_count()];
        let columns = self.size.width.div_ceil(TILE_SIDE) as usize;
        let rows = image.par_chunks_mut(width * TILE_SIDE as usize);
        rows.zip(self.tiles.par_chunks(columns)).for_each(|(rows, tiles)| {
            for tile in tiles.iter().filter(|tile| tile.passes() > 0) {
                let (left, columns) = (tile.origin().x as usize, tile.size().x as usize);
                let firsts = (0..tile.pixels.len()).step_by(columns);
                for (to, first) in rows.chunks_exact_mut(width).zip(firsts) {
                    for (to, index) in to[left..].iter_mut().zip(first..first + columns) {
                        *to = value(tile, index);
                    }
                }
            }
        });
        image
    }

    /// Some pixel that has a pass is so.
    fn has_any(&self, is_so: impl Fn(&Pixel, Held) -> bool + Sync) -> bool {
        let of_tile =
            |tile: &Tile| tile.passes() > 0 && tile.pixels.iter().any(|pixel| is_so(pixel, tile.held()));
        self.tiles.par_iter().any(of_tile)
    }
}

fn rgb_from(channels: [f64; 3]) -> Rgb {
    channels.map(|channel| channel as f32).into()
}

#[cfg(test)]
mod tests;
