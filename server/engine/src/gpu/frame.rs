//! Pictures of one pass that a card shows as soon as it has drawn them: what somebody sees who moves.
//!
//! The samples of the pass stay on the card (`shaders/film`): `find_brightest` and `lay_out` make numbers of them as `film/denoise` does of a
//! film, the steps of `denoise.rs` take the noise off, `add_up` puts it back, and `show.rs` exposes, maps tones and encodes. Three bytes a pixel
//! come back, in place of the 80 that the film takes for what comes after. It is the twin of [`Picture::of`](crate::film::Picture::of) a film
//! of one pass, without its noise or with it, and of [`Display::show_all`].
//!
//! **Watchdogs**: steps are those of `denoise.rs`, of a band of two million pixels; larger pictures are shown by the CPU.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use lumicast_shaders::{Constant, FILM_BRIGHTEST, FILM_FIRST_SHOWN, FILM_UNJOINED};

use super::{
    Batch, Binding, Buffer, DenoiseOnCard, GpuError, Layout, Pipeline, ReadBack, Session, ShowOnCard,
    batch::Begin,
    denoise::{BandBuffers, pixels_at_once},
};
use crate::film::{
    Display, PictureSize,
    denoise::{ALBEDO_LEAST, DEPTH_APART, stride_of},
};

/// Bytes of a sample of a pixel.
pub(crate) const FRAME_SAMPLE_BYTES: u64 = 112;
/// Of radiance that is shown.
const RADIANCE_BYTES: u64 = 12;

/// `FirstPass` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuFirstPass {
    width: u32,
    rows: u32,
    stride: u32,
    shown: u32,
}

/// What the card has of a picture.
#[derive(Debug)]
struct FrameBuffers {
    samples: Buffer,
    brightest: Buffer,
    band: BandBuffers,
    radiance: Buffer,
    /// Pixels that there is room for, alone and with their margins.
    room: [usize; 2],
}

impl FrameBuffers {
    fn new(session: &Session, room: [usize; 2]) -> Result<FrameBuffers, GpuError> {
        let [alone, with_margins] = room;
        Ok(FrameBuffers {
            samples: session.buffer_zeroed("samples of a picture", alone as u64 * FRAME_SAMPLE_BYTES)?,
            brightest: session.buffer_zeroed("the brightest", size_of::<u32>() as u64)?,
            band: BandBuffers::zeroed(session, with_margins)?,
            radiance: session.buffer_zeroed("radiance of a picture", alone as u64 * RADIANCE_BYTES)?,
            room,
        })
    }
}

/// Pixels of a picture, alone and with the margins that their planes have.
fn pixels_of(size: PictureSize) -> [usize; 2] {
    [size.pixel_count(), size.height() as usize * stride_of(size.width() as usize)]
}

/// A picture that is shown: its bytes are on their way.
#[derive(Debug)]
pub(crate) struct FrameShown {
    codes: ReadBack,
    byte_count: usize,
    /// What the steps took on the device's clock, where that was asked.
    pub(crate) seconds: Option<f64>,
}

impl FrameShown {
    /// Waits for the bytes: `[h × w × 3]` sRGB, rows top to bottom.
    ///
    /// Errors: as [`ReadBack::read`].
    pub(crate) fn collect(self) -> Result<Vec<u8>, GpuError> {
        self.codes.read(|bytes| bytes[..self.byte_count].to_vec())
    }
}

/// Shows pictures of one pass. Kept by whoever draws them; the next [`Session`] needs another.
#[derive(Debug)]
pub(crate) struct FrameOnCard {
    session: Arc<Session>,
    denoise: DenoiseOnCard,
    show: ShowOnCard,
    brightest: Arc<Pipeline>,
    unjoined: Arc<Pipeline>,
    first_shown: Arc<Pipeline>,
    layouts: [Arc<Layout>; 3],
    buffers: FrameBuffers,
}

impl FrameOnCard {
    /// What the steps are compiled with, beside what [`DenoiseOnCard::constants`] has.
    pub(crate) fn constants() -> Vec<(&'static str, Constant)> {
        let ours = [
            ("FLOAT_MAX", Constant::F32(f32::MAX)),
            ("ALBEDO_LEAST", Constant::F32(ALBEDO_LEAST)),
            ("DEPTH_APART", Constant::F32(DEPTH_APART)),
        ];
        DenoiseOnCard::constants().into_iter().chain(ours).collect()
    }

    /// Pictures that are shown so: such that their noise is taken off in one piece.
    pub(crate) fn takes(session: &Session, size: PictureSize) -> bool {
        let [alone, with_margins] = pixels_of(size);
        let bytes = alone as u64 * FRAME_SAMPLE_BYTES;
        let limits = &session.limits;
        with_margins <= pixels_at_once(session)
            && bytes <= limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Compiles the steps, which a session does once, and makes room: some 206 bytes a pixel, for pictures of that size and smaller ones.
    ///
    /// - `size`: of one that it [takes](FrameOnCard::takes)
    ///
    /// Errors: [`GpuError::Shader`], [`GpuError::OutOfMemory`], [`GpuError::Lost`], [`GpuError::Failed`].
    pub(crate) fn new(session: &Arc<Session>, size: PictureSize) -> Result<FrameOnCard, GpuError> {
        let [uniform, read, write] = [Binding::Uniform, Binding::Read, Binding::Write];
        let of_brightest = session.layout(&[uniform, read, write])?;
        let of_unjoined = session.layout(&[uniform, read, read, write, write])?;
        let of_shown = session.layout(&[uniform, read, read, read, write])?;
        let constants = FrameOnCard::constants();
        Ok(FrameOnCard {
            denoise: DenoiseOnCard::new(session)?,
            show: ShowOnCard::new(session)?,
            brightest: session.pipeline(&FILM_BRIGHTEST, &constants, &[&of_brightest])?,
            unjoined: session.pipeline(&FILM_UNJOINED, &constants, &[&of_unjoined])?,
            first_shown: session.pipeline(&FILM_FIRST_SHOWN, &constants, &[&of_shown])?,
            layouts: [of_brightest, of_unjoined, of_shown],
            buffers: FrameBuffers::new(session, pixels_of(size))?,
            session: Arc::clone(session),
        })
    }

    /// It is of this device, and has room for pictures of that size.
    pub(crate) fn is_for(&self, session: &Session, size: PictureSize) -> bool {
        let has_room = self.buffers.room.iter().zip(pixels_of(size)).all(|(room, pixels)| *room >= pixels);
        has_room && self.session.generation() == session.generation()
    }

    /// Where the samples go, row by row, [`FRAME_SAMPLE_BYTES`] each.
    pub(crate) fn samples(&self) -> &Buffer {
        &self.buffers.samples
    }

    /// Shows the samples that are there.
    ///
    /// - `size`: of a picture that it [is for](FrameOnCard::is_for)
    /// - `shown`: bit c: light of paths of class c is
    /// - `denoises`: their noise is taken off
    ///
    /// Errors: as [`ShowOnCard::show`].
    pub(crate) fn show(
        &self,
        size: PictureSize,
        shown: u32,
        (display, denoises): (&Display, bool),
        begin: Begin,
    ) -> Result<FrameShown, GpuError> {
        let FrameBuffers { samples, brightest, band, radiance, .. } = &self.buffers;
        let [width, rows] = [size.width() as usize, size.height() as usize];
        let session = &self.session;
        let header =
            GpuFirstPass { width: size.width(), rows: size.height(), stride: stride_of(width) as u32, shown };
        let header = session.buffer_of("first pass", &[header])?;
        let count = size.pixel_count() as u64;
        let mut seconds = Some(0.0);
        let submit = |batch: Batch, seconds: &mut Option<f64>| {
            let submission = batch.submit()?;
            if let Some(before) = *seconds {
                *seconds = submission.gpu_seconds_if_timed()?.map(|more| before + more);
            }
            Ok::<(), GpuError>(())
        };
        let [of_brightest, of_unjoined, of_shown] = &self.layouts;
        let mut batch = begin(session, "pixels of a first pass")?;
        batch.clear(brightest)?;
        let group = session.bind(of_brightest, &[&header, samples, brightest])?;
        batch.dispatch(&self.brightest, &[&group], self.brightest.workgroups(count))?;
        let [surfaces, light] = [band.surfaces(), band.light()];
        let group = session.bind(of_unjoined, &[&header, samples, brightest, surfaces, light])?;
        batch.dispatch(&self.unjoined, &[&group], self.unjoined.workgroups(count))?;
        submit(batch, &mut seconds)?;
        let joined = if denoises {
            let (joined, of_joining) = self.denoise.join_first(band, [width, rows], begin)?;
            seconds = seconds.zip(of_joining).map(|(before, more)| before + more);
            joined
        } else {
            light
        };
        let mut batch = begin(session, "picture of a first pass")?;
        let group = session.bind(of_shown, &[&header, samples, brightest, joined, radiance])?;
        batch.dispatch(&self.first_shown, &[&group], self.first_shown.workgroups(count))?;
        let codes = self.show.record(&mut batch, display, size, radiance)?;
        submit(batch, &mut seconds)?;
        Ok(FrameShown { codes, byte_count: 3 * size.pixel_count(), seconds })
    }
}
