//! Tiles: the pieces of a picture that threads work on.

use glam::UVec2;

use super::{Beyond, BeyondSums, Held, Outdated, PictureSize, Pixel, PixelSample, SCATTERED};
use crate::transport::PathClass;

/// Side of a tile in pixels. 16 × 16 pixels × 184 bytes = 47 KB stay in a core's second cache, and a
/// 256 × 256 picture still has 256 tiles to share among threads.
pub const TILE_SIDE: u32 = 16;

/// What rough light counts for beside better one, in passes: where a pixel's samples differ much, as at edges, the
/// mean of many outdated ones is nearer to the truth than one or two of the best, and soon it weighs next to nothing.
const KEPT_PASSES: u32 = 2;

/// A rectangle of a picture with its own sums and its own number of passes.
#[derive(Clone, Debug)]
pub struct Tile {
    origin: UVec2,
    size: UVec2,
    passes: u32,
    /// Passes whose light is forgotten, by class: as many fewer do its sums stand for.
    forgotten: [u32; SCATTERED.len()],
    /// Passes before the halves were begun anew.
    before_halves: u32,
    /// Passes before all scattered light was forgotten at once, and with it how much samples spread.
    before_spread: u32,
    /// The next pass brings better light, by class; what is there counts for so many passes at most from then on.
    outdated: [Option<u32>; SCATTERED.len()],
    dropped_samples: u64,
    pub(super) pixels: Vec<Pixel>,
    /// Pixel by pixel; none until some sample notes what is beyond a mirror or glass. `None`: nobody will ask.
    beyond: Option<Vec<BeyondSums>>,
}

impl Tile {
    /// The tile whose top left pixel is (`x`, `y`), cut off at the border of the picture.
    pub(super) fn new(picture: PictureSize, x: u32, y: u32) -> Tile {
        let origin = UVec2::new(x, y);
        let size = (UVec2::new(picture.width(), picture.height()) - origin).min(UVec2::splat(TILE_SIDE));
        let pixels = vec![Pixel::default(); (size.x * size.y) as usize];
        Tile {
            origin,
            size,
            passes: 0,
            forgotten: [0; SCATTERED.len()],
            before_halves: 0,
            before_spread: 0,
            outdated: [None; SCATTERED.len()],
            dropped_samples: 0,
            pixels,
            beyond: Some(Vec::new()),
        }
    }

    /// Top left pixel in the picture.
    pub fn origin(&self) -> UVec2 {
        self.origin
    }

    /// Width and height: [`TILE_SIDE`], or less at the right and lower border.
    pub fn size(&self) -> UVec2 {
        self.size
    }

    /// Samples that every pixel of the tile has; the index of the pass that comes next.
    pub fn passes(&self) -> u32 {
        self.passes
    }

    /// How many passes the sums of each kind of light hold.
    pub(super) fn held(&self) -> Held {
        let Tile { passes, forgotten, before_halves, before_spread, .. } = *self;
        Held { passes, forgotten, before_halves, before_spread }
    }

    /// Marks light of some classes for replacement by that of the passes to come: until the next it stays as it is.
    pub(super) fn outdate(&mut self, classes: &[PathClass], outdated: Outdated) {
        let kept = match outdated {
            Outdated::Rough => KEPT_PASSES,
            Outdated::Wrong => 0,
        };
        for (class, of_class) in SCATTERED.iter().zip(&mut self.outdated) {
            if classes.contains(class) {
                *of_class = Some(of_class.map_or(kept, |before| before.min(kept)));
            }
        }
    }

    fn forget_outdated(&mut self) {
        for (index, class) in SCATTERED.iter().enumerate() {
            let held = self.passes - self.forgotten[index];
            if let Some(kept) = self.outdated[index].take().filter(|kept| held > *kept) {
                let share = f64::from(kept) / f64::from(held);
                self.pixels.iter_mut().for_each(|pixel| pixel.scale(*class, share));
                self.forgotten[index] = self.passes - kept;
                self.before_halves = self.passes;
            }
        }
        if self.passes > self.before_spread && self.forgotten == [self.passes; SCATTERED.len()] {
            self.pixels.iter_mut().for_each(Pixel::forget_spread);
            self.before_spread = self.passes;
        }
    }

    /// Leaves out what is beyond mirrors and glass from now on.
    pub(super) fn ignore_beyond(&mut self) {
        self.beyond = None;
    }

    /// What half of a pixel's samples or more see beyond mirrors and clear glass.
    ///
    /// - `pixel_index`: row by row
    pub(super) fn beyond(&self, pixel_index: usize) -> Option<Beyond> {
        self.beyond.as_ref()?.get(pixel_index)?.mean(self.passes)
    }

    /// Memory of what is beyond.
    pub(super) fn beyond_bytes(&self) -> usize {
        self.beyond.as_ref().map_or(0, Vec::len) * size_of::<BeyondSums>()
    }

    /// Samples that were not finite or negative, and count as black.
    pub fn dropped_samples(&self) -> u64 {
        self.dropped_samples
    }

    /// Adds one sample to every pixel, row by row; `sample` gets the pixel's x and y in the picture.
    ///
    /// Pass p belongs to half `p & 1`. For the measured error to be right the two halves must be
    /// independent: scramble the sample points of each half by itself.
    pub fn add_pass(&mut self, mut sample: impl FnMut(u32, u32) -> PixelSample) {
        self.forget_outdated();
        let held = self.held();
        let pixel_count = self.pixels.len();
        let mut pixels = self.pixels.iter_mut().enumerate();
        for y in self.origin.y..self.origin.y + self.size.y {
            for (x, (index, pixel)) in (self.origin.x..self.origin.x + self.size.x).zip(&mut pixels) {
                let mut taken = sample(x, y);
                if !taken.is_sound() {
                    self.dropped_samples += 1;
                    taken = PixelSample::BLACK;
                }
                pixel.add(&taken, held);
                if let (Some(beyond), Some(sums)) = (taken.beyond, &mut self.beyond) {
                    if sums.is_empty() {
                        sums.resize(pixel_count, BeyondSums::default());
                    }
                    sums[index].add(beyond);
                }
            }
        }
        self.passes += 1;
    }
}
