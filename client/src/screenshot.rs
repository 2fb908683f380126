//! `--screenshot`: waits for a picture that is good enough, saves the window, ends the program. For tests and documents.

use egui::{ColorImage, Context, ViewportCommand};
use lumicast_protocol::FrameHeader;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// How it ended; `None` until then.
pub type Outcome = Arc<Mutex<Option<Result<(), String>>>>;

/// What is wanted.
#[derive(Debug, Clone)]
pub struct Order {
    /// PNG to write.
    pub file: PathBuf,
    /// Samples per pixel that the picture on show must have; a converged picture is good enough in any case.
    pub samples: u32,
    /// Give up after so many seconds.
    pub patience_s: f64,
}

/// An order on its way.
pub struct Screenshot {
    order: Order,
    outcome: Outcome,
    is_requested: bool,
    started_s: Option<f64>,
}

impl Screenshot {
    /// The outcome is for who asked, to be read when the window has closed.
    pub fn new(order: Order) -> (Self, Outcome) {
        let outcome = Outcome::default();
        let screenshot = Self { order, outcome: outcome.clone(), is_requested: false, started_s: None };
        (screenshot, outcome)
    }

    /// To be called in every frame, with the picture on show.
    pub fn step(&mut self, ctx: &Context, frame: Option<&FrameHeader>, now_s: f64) {
        let started_s = *self.started_s.get_or_insert(now_s);
        let is_over = self.outcome.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        if is_over {
            ctx.send_viewport_cmd(ViewportCommand::Close);
            return;
        }
        if now_s - started_s > self.order.patience_s {
            let samples = frame.map_or(0, |frame| frame.samples);
            let reason = format!(
                "no picture of {} samples within {} s, only {samples}",
                self.order.samples, self.order.patience_s
            );
            *self.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(Err(reason));
        }
        let is_good = frame.is_some_and(|frame| frame.converged || frame.samples >= self.order.samples);
        if is_good && !std::mem::replace(&mut self.is_requested, true) {
            let (file, outcome, again) = (self.order.file.clone(), self.outcome.clone(), ctx.clone());
            ctx.request_screenshot(move |image| {
                let saved = save(&file, &image);
                *outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(saved);
                again.request_repaint();
            });
        }
        // Patience needs frames to run out in.
        ctx.request_repaint_after(std::time::Duration::from_millis(200));
    }
}

fn save(file: &std::path::Path, image: &ColorImage) -> Result<(), String> {
    let [width, height] = image.size.map(|side| side as u32);
    let rgb: Vec<u8> = image.pixels.iter().flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b()]).collect();
    let picture = image::RgbImage::from_raw(width, height, rgb).ok_or("the window has no pixels")?;
    picture
        .save_with_format(file, image::ImageFormat::Png)
        .map_err(|error| format!("{}: {error}", file.display()))
}
