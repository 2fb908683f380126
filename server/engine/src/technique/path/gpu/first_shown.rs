//! First passes that a card shows as it has drawn them (`gpu/frame.rs`), before the film has their samples.

use std::sync::{Arc, MutexGuard, atomic::Ordering};

use super::{Begun, GpuPathTracer, GpuPixelSample, GpuScene, SAMPLE_BYTES, Shadows};
use crate::{
    film::{Display, Film, PictureSize, ToneMap},
    gpu::{FRAME_SAMPLE_BYTES, FrameOnCard, FrameShown, GpuError, Session},
    transport::PathClasses,
};

const _: () = assert!(FRAME_SAMPLE_BYTES == SAMPLE_BYTES);

/// Passes of any pictures one after the other, none of them shown so, after which nobody moves: what shows those who do gives its memory back.
const FRAME_KEPT_PASSES: u32 = 16;

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
        if size.pixel_count() >= self.frames_refused_from.load(Ordering::Relaxed) {
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
                    self.refuse_frames(size, &error);
                    return None;
                }
            }
        }
        Some(frame)
    }

    /// Leaves pictures of that size and larger ones to the CPU, until the scene leaves the card; devices that are lost while something is made
    /// ready are another's business.
    pub(super) fn refuse_frames(&self, size: PictureSize, error: &GpuError) {
        if *error != GpuError::Lost {
            self.frames_refused_from.fetch_min(size.pixel_count(), Ordering::Relaxed);
        }
    }

    /// Gives its memory back, unless a pass is drawn for it: then it stays, and who asked goes without. True if it had any.
    pub(super) fn let_frame_go(&self) -> bool {
        self.frame.try_lock().is_ok_and(|mut frame| frame.take().is_some())
    }

    /// Does a piece of work, and once more without what shows pictures where there is no room beside that.
    pub(super) fn or_without_frame<T>(&self, work: impl Fn() -> Result<T, GpuError>) -> Result<T, GpuError> {
        let done = work();
        let is_too_much = matches!(done, Err(GpuError::OutOfMemory { .. } | GpuError::LightTooLarge { .. }));
        if is_too_much && self.let_frame_go() { work() } else { done }
    }
}

impl GpuScene {
    /// Compiles what shows first passes, so that none waits for it. A card that cannot leaves that to the CPU.
    ///
    /// Errors: [`GpuError::Lost`].
    pub fn make_ready_to_show(&self) -> Result<(), GpuError> {
        let Ok(pixel) = PictureSize::new(1, 1) else { return Ok(()) };
        let shown = self.gpu.session().and_then(|session| {
            let frame = FrameOnCard::new(&session, pixel)?;
            let display = Display::new(ToneMap::default(), 0.0);
            // Some drivers compile at first use.
            frame.show(pixel, PathClasses::ALL.bits(), (&display, true), Session::batch)?.collect()
        });
        if self.first_shadows() == Shadows::ByMaps {
            self.make_ready_to_map()?;
        }
        match shown {
            Err(GpuError::Lost) => Err(GpuError::Lost),
            Err(error) => {
                self.refuse_frames(pixel, &error);
                Ok(())
            }
            Ok(_) => Ok(()),
        }
    }
}

impl GpuPathTracer {
    /// Lets the card show the first passes that it draws from now on; `None`: no more.
    pub fn show_first_as(&mut self, shown_as: Option<ShownAs>) {
        self.shown_as = shown_as;
    }

    /// Who tells the shadows of first passes of looked-up light that the card shows: where nobody says maps as far as they do, and rays where the
    /// adapter is the CPU itself.
    pub fn tell_first_shadows(&mut self, shadows: Shadows) {
        self.first_shadows = shadows;
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

    /// What shows the pass that begins now, if that is to be shown: all of it is drawn here.
    pub(super) fn frame_of<'a>(&self, scene: &'a GpuScene, film: &Film, begun: &Begun) -> Option<Frame<'a>> {
        let is_first = film.passes_max() == 0 && begun.taken == 0;
        if self.shown_as.is_some() && is_first {
            scene.passes_unshown.store(0, Ordering::Relaxed);
            return scene.frame_for(film.size());
        }
        if scene.passes_unshown.fetch_add(1, Ordering::Relaxed) == FRAME_KEPT_PASSES {
            scene.let_frame_go();
        }
        None
    }

    /// Shows a pass that is there; `None` where nobody asks for that. What goes wrong leaves the picture to the CPU.
    pub(super) fn show(
        &self,
        frame: &FrameOnCard,
        size: PictureSize,
    ) -> Option<Result<FrameShown, GpuError>> {
        let ShownAs { display, denoises } = self.shown_as.as_ref()?;
        let shown = self.settings.shown.bits();
        let completed = self.scene.gpu.session().and_then(|session| self.complete(frame, &session));
        Some(completed.and_then(|()| frame.show(size, shown, (display, *denoises), Session::batch)))
    }

    /// Keeps what the card has shown. Where that failed it is not tried again for such pictures: a device that was lost over it would be lost
    /// with every picture. Returns whether it was.
    pub(super) fn keep_shown(
        &mut self,
        shown: Option<Result<FrameShown, GpuError>>,
        size: PictureSize,
    ) -> bool {
        let collected = shown.map(|shown| shown.and_then(FrameShown::collect)).transpose();
        match collected {
            Ok(shown) => {
                if shown.is_some() {
                    self.scene.first_shown.fetch_add(1, Ordering::Relaxed);
                }
                self.shown = shown;
                false
            }
            Err(error) => {
                self.scene.frames_refused_from.fetch_min(size.pixel_count(), Ordering::Relaxed);
                error == GpuError::Lost
            }
        }
    }

    /// Brings to the card what the CPU has added to samples.
    fn complete(&self, frame: &FrameOnCard, session: &Session) -> Result<(), GpuError> {
        self.completed.iter().try_for_each(|pixel| {
            let sample: &GpuPixelSample = &self.samples[*pixel];
            session.write(frame.samples(), *pixel as u64 * SAMPLE_BYTES, bytemuck::bytes_of(sample))
        })
    }
}
