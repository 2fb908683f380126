//! A sketch of caustics counted in the pixels of a picture on a card: the twin of `technique/caustics/screen`.
//!
//! Steps (`shaders/caustics`): `place` finds the pixel of each photon and counts it there, `sum_rows` adds up along rows, `choose` gives each
//! photon the narrowest window that holds enough of them and counts it in the cells that it reaches into, `allot` gives cells room, `fill` puts
//! photons there, `order` sorts them, an entry an invocation. Which photon shows in which pixel is a matter of rounding; all else is counted,
//! and the CPU's to the last one. Paths that are shaded then ask one cell for each width (`look_up.wgsl`), in the CPU's order.
//!
//! The windows come back, 4 bytes a photon: by them it is judged whether the sketch is fit for that camera, as on the CPU.
//!
//! Memory, all within the session's bounds: 72 bytes a photon and 4 for each of the cells, 25 at most, that a window may reach into; some 2 bytes a
//! pixel. While it is counted 4 bytes more a photon, entry of a cell and pixel. What is drawn without a sketch has 256 bytes of zeros in
//! its place; for a scene without caustics none of these steps is compiled.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{
    CAUSTICS_ALLOT, CAUSTICS_CHOOSE, CAUSTICS_FILL, CAUSTICS_ORDER, CAUSTICS_PLACE, CAUSTICS_SUM_ROWS,
    Constant, Step,
};

use super::{known::LightBeside, scene::GpuScene, tracing::WORKGROUP};
use crate::{
    gpu::{Binding, Buffer, GpuError, Layout, Pipeline, Session},
    technique::{FocusedLight, PackedSketch, SKETCH_WIDTHS},
};

/// Bytes of a word.
const WORD_BYTES: u64 = 4;
/// How many entries there are comes first.
const WEIGHTS_AT: u32 = 1;
/// Column and row of a photon.
pub(super) const PLACE_WORDS: u32 = 2;
/// Entries of a cell, and where they end.
pub(super) const CELL_WORDS: u32 = 2;

/// `Windows` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuWindows {
    pub(super) half_px: i32,
    pub(super) cell_log2: u32,
    pub(super) columns: u32,
    pub(super) weights_at: u32,
    pub(super) cells_at: u32,
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
    pub(super) padding_2: u32,
}

/// `Sketch` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuSketch {
    pub(super) origin: [f32; 3],
    pub(super) half_width: f32,
    pub(super) right: [f32; 3],
    pub(super) half_height: f32,
    pub(super) up: [f32; 3],
    pub(super) is_perspective: u32,
    pub(super) back: [f32; 3],
    pub(super) width_count: u32,
    pub(super) width: i32,
    pub(super) height: i32,
    pub(super) margin: i32,
    pub(super) photon_count: u32,
    pub(super) places_at: u32,
    pub(super) cell_count: u32,
    pub(super) entries_at: u32,
    pub(super) padding_0: u32,
    pub(super) windows: [GpuWindows; SKETCH_WIDTHS],
}

/// What lies where of a sketch.
struct Plan {
    header: GpuSketch,
    /// Words that the CPU writes.
    words: Vec<u32>,
    /// Entries at most.
    entries_max: u64,
    /// Words of rows with the margin.
    row_words: u64,
}

impl Plan {
    fn of(packed: &PackedSketch) -> Plan {
        let PackedSketch { photons, view, windows, .. } = packed;
        let size = view.size();
        let photon_count = photons.len() as u32;
        let mut words = vec![0; WEIGHTS_AT as usize];
        let weights_at = windows.each_ref().map(|of| {
            let at = words.len() as u32;
            words.extend(of.weights.iter().map(|weight| weight.to_bits()));
            at
        });
        let places_at = words.len() as u32;
        let first_cell_at = places_at + PLACE_WORDS * photon_count;
        let mut cell_count = 0;
        let (mut margin, mut reached_max) = (0, 0);
        let windows = std::array::from_fn(|width| {
            let of = &windows[width];
            let [columns, rows] =
                [size.width(), size.height()].map(|count| ((count - 1) >> of.cell_log2) + 1);
            let cells_at = first_cell_at + CELL_WORDS * cell_count;
            cell_count += columns * rows;
            margin = margin.max(of.half_px);
            // Where it begins at the last pixel of a cell.
            let along = ((2 * of.half_px + (1 << of.cell_log2) - 1) >> of.cell_log2) + 1;
            reached_max = reached_max.max(u64::from(along).pow(2));
            let weights_at = weights_at[width];
            let (half_px, cell_log2) = (of.half_px as i32, of.cell_log2);
            GpuWindows { half_px, cell_log2, columns, weights_at, cells_at, ..GpuWindows::zeroed() }
        });
        let header = GpuSketch {
            origin: view.origin.into(),
            half_width: view.half_size[0],
            right: view.right.into(),
            half_height: view.half_size[1],
            up: view.up.into(),
            is_perspective: u32::from(view.is_perspective),
            back: view.back.into(),
            width_count: SKETCH_WIDTHS as u32,
            width: size.width() as i32,
            height: size.height() as i32,
            margin: margin as i32,
            photon_count,
            places_at,
            cell_count,
            entries_at: first_cell_at + CELL_WORDS * cell_count,
            padding_0: 0,
            windows,
        };
        let extent = [size.width(), size.height()].map(|count| u64::from(count + 2 * margin));
        Plan {
            header,
            words,
            entries_max: u64::from(photon_count) * reached_max,
            row_words: (extent[0] + 1) * extent[1],
        }
    }

    fn row_count(&self) -> u64 {
        (self.header.height + 2 * self.header.margin) as u64
    }
}

/// The steps, in their order.
pub(super) struct Counting {
    layout: Arc<Layout>,
    steps: [Arc<Pipeline>; 6],
}

impl Counting {
    pub(super) fn new(session: &Session) -> Result<Counting, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let layout = session.layout(&[uniform, read, write, write, write, write])?;
        let constants = [("WORKGROUP", Constant::U32(WORKGROUP))];
        let step = |step: &Step| session.pipeline(step, &constants, &[&*layout]);
        let steps = [
            step(&CAUSTICS_PLACE)?,
            step(&CAUSTICS_SUM_ROWS)?,
            step(&CAUSTICS_CHOOSE)?,
            step(&CAUSTICS_ALLOT)?,
            step(&CAUSTICS_FILL)?,
            step(&CAUSTICS_ORDER)?,
        ];
        Ok(Counting { layout, steps })
    }
}

/// A sketch as a camera sees it, on a card.
#[derive(Debug)]
pub(super) struct SketchOnCard {
    /// Photons, words, and what says how they are read.
    pub(super) buffers: [Buffer; 3],
    /// Photons on the screen are a fit estimate.
    pub(super) is_fit: bool,
    /// What windows they have.
    #[cfg(test)]
    pub(super) chosen: Vec<u32>,
}

impl SketchOnCard {
    /// Counts it, and waits for that.
    ///
    /// Errors: what the card does not do; [`GpuError::OutOfMemory`] where it has no room.
    pub(super) fn new(session: &Arc<Session>, packed: &PackedSketch) -> Result<SketchOnCard, GpuError> {
        let Counting { layout, steps } = Counting::new(session)?;
        let plan = Plan::of(packed);
        let photons = session.buffer_of("photons of a sketch", &packed.photons)?;
        let header = session.buffer_of("sketch", &[plan.header])?;
        let word_count = u64::from(plan.header.entries_at) + plan.entries_max;
        let words = session.buffer_zeroed("words of a sketch", WORD_BYTES * word_count)?;
        session.write(&words, 0, bytemuck::cast_slice(&plan.words))?;
        // These go when it is counted.
        let rows = session.buffer_zeroed("photons in rows", WORD_BYTES * plan.row_words)?;
        let photon_count = packed.photons.len() as u64;
        let chosen = session.buffer_zeroed("windows of photons", WORD_BYTES * photon_count)?;
        let unsorted = session.buffer_zeroed("photons in cells", WORD_BYTES * plan.entries_max)?;
        let group = session.bind(&layout, &[&header, &photons, &words, &rows, &chosen, &unsorted])?;
        let cell_count = u64::from(plan.header.cell_count);
        let counts =
            [photon_count, plan.row_count(), photon_count, cell_count, photon_count, plan.entries_max];
        let mut batch = session.batch("sketch of caustics")?;
        for (step, count) in steps.iter().zip(counts) {
            batch.dispatch(step, &[&group], step.workgroups(count))?;
        }
        let read_back = batch.read_back(&chosen, 0..chosen.byte_count())?;
        batch.submit()?;
        let chosen: Vec<u32> = bytemuck::pod_collect_to_vec(&read_back.collect()?);
        Ok(SketchOnCard {
            buffers: [photons, words, header],
            is_fit: packed.is_fit(&chosen),
            #[cfg(test)]
            chosen,
        })
    }
}

impl GpuScene {
    /// Counts a sketch of caustics in the pixels of its picture, which is drawn with it then, and says whether it is fit for that: seen from near,
    /// single photons would stand alone.
    ///
    /// - `sketch`: of a picture
    ///
    /// Errors: what the card does not do; [`GpuError::LightTooLarge`] where the sketch has no room beside what others look up, which stays,
    /// and [`GpuError::OutOfMemory`] where the scene has none.
    pub fn is_fit(&self, sketch: &Arc<dyn FocusedLight>) -> Result<bool, GpuError> {
        let light = LightBeside { focused: Some(sketch), ..LightBeside::default() };
        let count = || {
            let (mut held, packed) = self.packed_for(light, |_| Ok(()))?;
            self.run(&mut held, |ready| {
                let compiled = ready.session.shader_seconds();
                let is_fit = ready.known.count(&ready.session, sketch, &packed)?;
                ready.shader_seconds += ready.session.shader_seconds() - compiled;
                Ok(is_fit)
            })
        };
        self.through_counted_losses(|| self.or_without_frame(count))
    }

    /// Compiles what counts sketches, so that no first picture waits for it.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready_to_sketch(&self) -> Result<(), GpuError> {
        self.run(&mut *self.ready()?, |ready| {
            let compiled = ready.session.shader_seconds();
            Counting::new(&ready.session)?;
            ready.shader_seconds += ready.session.shader_seconds() - compiled;
            Ok(())
        })
    }
}
