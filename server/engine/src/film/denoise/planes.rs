//! Numbers of pixels, laid out so that eight pixels of a row, and eight others as far from each, are read at once.

use fearless_simd::{Level, Simd, SimdBase, dispatch, f32x8};
use rayon::prelude::*;

/// Pixels that are computed together.
const EIGHT: usize = 8;

/// What makes numbers of eight pixels that begin at a row and column.
pub(super) trait OfEight<const COUNT: usize>: Sync {
    /// The numbers, plane by plane.
    fn of<S: Simd>(&self, simd: S, y: usize, x: usize) -> [f32x8<S>; COUNT];
}

/// Columns on either side of a picture that can be read as others are: no step is longer.
pub(crate) const MARGIN: usize = 8;

/// Numbers from one plane of a row to the next, in pictures of a width.
pub(crate) fn stride_of(width: usize) -> usize {
    MARGIN + width.next_multiple_of(EIGHT) + MARGIN
}

/// Numbers of every pixel: rows top to bottom, in each one plane after the other, in each of them the pixels of the row between margins.
/// The margin on the right is wider where the width is no multiple of eight.
#[derive(Clone, Debug)]
pub(crate) struct Planes {
    width: usize,
    rows: usize,
    count: usize,
    stride: usize,
    numbers: Vec<f32>,
}

impl Planes {
    /// Nothing but zeros, which cost nothing before something is written.
    fn zeros(width: usize, rows: usize, count: usize) -> Planes {
        let stride = stride_of(width);
        Planes { width, rows, count, stride, numbers: vec![0.0; rows * count * stride] }
    }

    /// Of the pixels' numbers, row by row; the margins hold others.
    pub(crate) fn of<T: Sync, const COUNT: usize>(
        width: usize,
        pixels: &[T],
        margins: f32,
        at: impl Fn(usize, &T) -> [f32; COUNT] + Sync,
    ) -> Planes {
        let mut planes = Planes::zeros(width, pixels.len() / width, COUNT);
        let stride = planes.stride;
        planes.numbers.par_chunks_mut(COUNT * stride).zip(pixels.par_chunks(width)).enumerate().for_each(
            |(y, (numbers, row))| {
                for plane in numbers.chunks_exact_mut(stride) {
                    plane[..MARGIN].fill(margins);
                    plane[MARGIN + width..].fill(margins);
                }
                for (x, pixel) in row.iter().enumerate() {
                    for (plane, number) in at(y * width + x, pixel).into_iter().enumerate() {
                        numbers[plane * stride + MARGIN + x] = number;
                    }
                }
            },
        );
        planes
    }

    /// Others of as many pixels.
    pub(super) fn made<const COUNT: usize>(&self, by: &impl OfEight<COUNT>) -> Planes {
        self.made_in(None, by)
    }

    /// The same.
    ///
    /// - `room`: others of as many pixels, with as many numbers of each, which nobody needs any more
    pub(super) fn made_in<const COUNT: usize>(
        &self,
        room: Option<Planes>,
        by: &impl OfEight<COUNT>,
    ) -> Planes {
        let is_as_large =
            |room: &Planes| [room.width, room.rows, room.count] == [self.width, self.rows, COUNT];
        let room = room.filter(is_as_large);
        let mut planes = room.unwrap_or_else(|| Planes::zeros(self.width, self.rows, COUNT));
        let (stride, level) = (planes.stride, Level::new());
        // The same operations with all instructions, and none of them fuses: the same bytes.
        planes.numbers.par_chunks_mut(COUNT * stride).enumerate().for_each(|(y, numbers)| {
            dispatch!(level, simd => {
                for x in (0..self.width).step_by(EIGHT) {
                    for (plane, eight) in by.of(simd, y, x).into_iter().enumerate() {
                        let eight: [f32; EIGHT] = eight.into();
                        numbers[plane * stride + MARGIN + x..][..EIGHT].copy_from_slice(&eight);
                    }
                }
            });
        });
        planes
    }

    /// The numbers of eight pixels that begin at a column, which may lie in the margins, plus [`MARGIN`].
    #[inline(always)]
    pub(super) fn eight<S: Simd>(&self, simd: S, y: usize, plane: usize, column: usize) -> f32x8<S> {
        let from = &self.numbers[(y * self.count + plane) * self.stride + column..];
        // Every column that is asked for is there.
        f32x8::load_array_ref(simd, from.first_chunk().unwrap_or(&[0.0; EIGHT]))
    }

    /// Where the numbers of a pixel are.
    #[inline]
    pub(crate) fn place(&self, index: usize) -> Place<'_> {
        let (y, x) = (index / self.width, index % self.width);
        Place { planes: self, first: y * self.count * self.stride + MARGIN + x }
    }

    /// Others of the same pixels and as many numbers of each, read from what lies as they do.
    ///
    /// - `numbers`: of all rows, as [`Planes::of_rows`] has them
    #[cfg(feature = "gpu")]
    pub(crate) fn of_numbers(&self, numbers: Vec<f32>) -> Planes {
        assert_eq!(numbers.len(), self.numbers.len(), "numbers of all pixels");
        Planes { numbers, ..*self }
    }

    /// The numbers of some rows as they lie: `[rows × count × stride]`.
    #[cfg(feature = "gpu")]
    pub(crate) fn of_rows(&self, rows: std::ops::Range<usize>) -> &[f32] {
        let of_row = self.count * self.stride;
        &self.numbers[rows.start * of_row..rows.end * of_row]
    }

    /// Numbers from the beginning of one plane of a row to that of the next.
    #[cfg(feature = "gpu")]
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Pixels of a row.
    #[cfg(feature = "gpu")]
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Numbers of a pixel.
    pub(crate) fn count(&self) -> usize {
        self.count
    }
}

/// The numbers of a pixel.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    planes: &'a Planes,
    first: usize,
}

impl Place<'_> {
    /// That of a plane.
    #[inline]
    pub(crate) fn at(self, plane: usize) -> f32 {
        self.planes.numbers[self.first + plane * self.planes.stride]
    }
}
