//! First passes that a card shows as it has drawn them (`gpu/frame.rs`), before the film has their samples.

use std::sync::{Arc, MutexGuard, atomic::Ordering};

use super::{GpuPathTracer, GpuPixelSample, GpuScene, SAMPLE_BYTES};
use crate::{
    film::{Display, PictureSize, ToneMap},
    gpu::{FRAME_SAMPLE_BYTES, FrameOnCard, FrameShown, GpuError, Session},
    transport::PathClasses,
};

const _: () = assert!(FRAME_SAMPLE_BYTES == SAMPLE_BYTES);

/// What somebody sees of a picture.
#[derive(Clone, Debug)]
pub struct ShownAs {
    /// Exposed and mapped so.
    pub display: Arc<Display>,
    /// Noise is taken off what is looked up.
    pub denoises: bool,
}

/// What shows a pass that is drawn. Nobody else's does meanwhile.
pub(super) type Frame<'a> = MutexGuard<'a, Option<FrameOnCard>>;

impl GpuScene {
    /// What shows pictures of a size; `None` where that has no room, and while another picture is shown.
    pub(super) fn frame_for(&self, size: PictureSize) -> Option<Frame<'_>> {
        if self.refuses_frames.load(Ordering::Relaxed) {
            return None;
        }
        let mut frame = self.frame.try_lock().ok()?;
        let session = self.gpu.session().ok()?;
        if !FrameOnCard::takes(&session, size) {
            return None;
        }
        if !frame.as_ref().is_some_and(|frame| frame.is_for(&session, size)) {
            // Not both at once.
            *frame = None;
            match FrameOnCard::new(&session, size) {
                Ok(made) => *frame = Some(made),
                Err(error) => {
                    self.refuses_frames.store(!matches!(error, GpuError::Lost), Ordering::Relaxed);
                    return None;
                }
            }
        }
        Some(frame)
    }

    /// Gives its memory back, unless a pass is drawn for it. True if it had any.
    pub(super) fn let_frame_go(&self) -> bool {
        self.frame.try_lock().is_ok_and(|mut frame| frame.take().is_some())
    }
}

impl GpuScene {
    /// Compiles what shows first passes, so that none waits for it.
    ///
    /// Errors: what the card does not do.
    pub fn make_ready_to_show(&self) -> Result<(), GpuError> {
        let Ok(pixel) = PictureSize::new(1, 1) else { return Ok(()) };
        let frame = FrameOnCard::new(&self.gpu.session()?, pixel)?;
        let display = Display::new(ToneMap::default(), 0.0);
        // Some drivers compile at first use.
        frame.show(pixel, PathClasses::ALL.bits(), (&display, true), Session::batch)?.collect().map(|_| ())
    }
}

impl GpuPathTracer {
    /// Lets the card show the first passes that it draws from now on; `None`: no more.
    pub fn show_first_as(&mut self, shown_as: Option<ShownAs>) {
        self.shown_as = shown_as;
    }

    /// sRGB bytes of the last pass, rows top to bottom, if that was a first one and the card has shown it. Once.
    pub fn take_shown(&mut self) -> Option<Vec<u8>> {
        self.shown.take()
    }

    /// What showing the last pass takes on the device's clock, s; `None` on a device without one, and where the card shows no such pictures.
    ///
    /// Errors: what the card does not do.
    pub fn show_seconds(&self, size: PictureSize) -> Result<Option<f64>, GpuError> {
        let (Some(ShownAs { display, denoises }), Some(frame)) = (&self.shown_as, self.scene.frame_for(size))
        else {
            return Ok(None);
        };
        let Some(frame) = frame.as_ref() else { return Ok(None) };
        let shown = self.settings.shown.bits();
        let shown = frame.show(size, shown, (display, *denoises), Session::timed_batch)?;
        let seconds = shown.seconds;
        shown.collect().map(|_| seconds)
    }

    /// What shows the pass that begins now, if that is to be shown.
    pub(super) fn frame_of<'a>(
        &self,
        scene: &'a GpuScene,
        size: PictureSize,
        pass: u32,
    ) -> Option<Frame<'a>> {
        self.shown_as.as_ref().filter(|_| pass == 0)?;
        scene.frame_for(size)
    }

    /// Shows a pass that is there. What goes wrong leaves the picture to the CPU, which shows it later.
    pub(super) fn show(&self, frame: &FrameOnCard, size: PictureSize) -> Option<FrameShown> {
        let ShownAs { display, denoises } = self.shown_as.as_ref()?;
        let session = self.scene.gpu.session().ok()?;
        self.complete(frame, &session).ok()?;
        let shown = self.settings.shown.bits();
        frame.show(size, shown, (display, *denoises), Session::batch).ok()
    }

    /// Brings to the card what the CPU has added to samples.
    fn complete(&self, frame: &FrameOnCard, session: &Session) -> Result<(), GpuError> {
        self.completed.iter().try_for_each(|pixel| {
            let sample: &GpuPixelSample = &self.samples[*pixel];
            session.write(frame.samples(), *pixel as u64 * SAMPLE_BYTES, bytemuck::bytes_of(sample))
        })
    }
}
