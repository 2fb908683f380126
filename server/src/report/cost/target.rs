//! What pictures of a scene are compared with: another renderer's picture, or one that is drawn here first.

use std::path::Path;

use lumicast_engine::{
    effects::EffectKind,
    render::{IlluminationSettings, Indirect, RenderSettings},
};

use super::{
    super::{
        Cost, ReportError,
        drawing::Drawing,
        notebook::Notebook,
        subject::{FullReference, Prepared, Subject, read},
        table::Cell,
    },
    PREPARE, REFERENCE, REFERENCE_NOISE, SCENE, SIZE, file_name, percent, shown_size,
};
use crate::images::{ExrLayers, PictureFacts, encode_exr, write_file};

/// A reference of our own is drawn so many times as long as a picture.
const REFERENCE_TIMES: f64 = 8.0;
/// Seed of such a reference.
const REFERENCE_SEED: u64 = 0x7265_6665;

/// A scene with what its pictures are compared with.
pub(super) struct Target<'a> {
    pub(super) subject: &'a Subject,
    pub(super) reference: FullReference,
    /// Mean of the reference.
    pub(super) mean: f64,
    /// Nobody gave one.
    is_drawn_here: bool,
}

impl<'a> Target<'a> {
    /// The reference of a scene, drawn now if there is none.
    pub(super) fn of(
        notebook: &mut Notebook,
        subject: &'a Subject,
        cost: &Cost,
    ) -> Result<Option<Target<'a>>, ReportError> {
        let own = notebook.folder().join(format!("{}-reference.exr", file_name(&subject.name)));
        let start = std::time::Instant::now();
        let prepared = subject.prepare()?;
        let seconds = start.elapsed().as_secs_f64();
        let given = match &prepared.camera {
            Some(camera) => subject.full_reference(camera)?,
            None => None,
        };
        let camera = prepared.camera.clone();
        let mut size = prepared.size;
        if let Some(given) = &given {
            size = given.size;
        }
        if given.is_none() && !own.is_file() {
            notebook.forget(&subject.name);
        }
        if let Some(path) = prepared.camera.as_deref().and_then(|camera| subject.namesake(camera)) {
            notebook.warn(format!(
                "{}: the scene is built in, and {} is of a file of that name: a reference is drawn here instead",
                subject.name,
                path.display()
            ));
        }
        let hides = hides_light(&prepared);
        if given.is_none() && hides {
            notebook.note(format!(
                "{}: no path finds its light of lamps without size by way of mirrors and clear glass. Its reference is drawn by \
                 auto, which blurs that a little; `path` lacks it.",
                subject.name
            ));
        }
        notebook.row(&subject.name, || {
            let (name, noise) = match (&given, camera) {
                (Some(given), Some(camera)) => (format!("{}-{camera}.exr", subject.name), given.noise),
                _ => draw_reference(prepared, cost, &own)?,
            };
            Ok([
                (SCENE, Cell::from(subject.name.as_str())),
                (REFERENCE, name.as_str().into()),
                (SIZE, shown_size(size).as_str().into()),
                (REFERENCE_NOISE, percent(noise)),
                (PREPARE, seconds.into()),
            ]
            .map(|(column, cell)| (column.key.to_string(), cell))
            .into())
        })?;
        let is_drawn_here = given.is_none();
        let reference = match given {
            Some(given) => given,
            None => {
                let (size, picture) = read(&own)?;
                FullReference {
                    size,
                    picture,
                    noise: notebook.last(REFERENCE_NOISE).map(|noise| 0.01 * noise),
                }
            }
        };
        let pixels = &reference.picture;
        let mean = pixels.iter().map(|pixel| f64::from(pixel.mean())).sum::<f64>() / pixels.len() as f64;
        let is_lit = mean > 0.0 && mean.is_finite();
        Ok(is_lit.then_some(Target { subject, reference, mean, is_drawn_here }))
    }

    /// √relMSE of the noise of a reference that was drawn here.
    pub(super) fn own_noise_percent(&self) -> Option<f64> {
        self.reference.noise.filter(|_| self.is_drawn_here).map(|noise| 100.0 * noise)
    }

    /// relMSE of the reference's own noise; nothing where nobody has measured it.
    fn noise(&self) -> f64 {
        self.reference.noise.unwrap_or(0.0).powi(2)
    }

    /// A relMSE less that of the reference's own noise, which it holds, and no less than can be told beside that.
    pub(super) fn clean(&self, rel_mse: f64) -> f64 {
        (rel_mse - self.noise()).max(TOLD_APART * self.noise())
    }

    /// √relMSE of the least that [`Target::clean`] tells.
    pub(super) fn least_told(&self) -> f64 {
        (TOLD_APART * self.noise()).sqrt()
    }

    /// The same of what two pictures have in common; `None` where that is no more than the noise of the reference.
    pub(super) fn clean_systematic(&self, systematic: Option<f64>) -> Option<f64> {
        systematic
            .map(|systematic| systematic - self.noise())
            .filter(|left| *left > TOLD_APART * self.noise())
    }
}

/// No path from the eye finds all of its light.
fn hides_light(prepared: &Prepared) -> bool {
    prepared.plan.is_on(EffectKind::Caustics) && prepared.plan.facts.hides_light()
}

/// What of a relMSE must be left beside that of the reference's noise to be told apart from it, a share of that noise.
const TOLD_APART: f64 = 0.1;

/// Draws a reference and keeps it; returns what it is and how noisy.
fn draw_reference(
    prepared: Prepared,
    cost: &Cost,
    path: &Path,
) -> Result<(String, Option<f64>), ReportError> {
    // What no path finds is brought by photons.
    let indirect = if hides_light(&prepared) { Indirect::Auto } else { Indirect::Path };
    let settings = RenderSettings { indirect, seed: REFERENCE_SEED, ..RenderSettings::default() };
    let mut drawing = Drawing::learning_by(prepared, settings, IlluminationSettings::of(&settings));
    drawing.advance(cost.time.mul_f64(REFERENCE_TIMES));
    let rendering = &drawing.rendering;
    let picture = rendering.picture();
    let noise = rendering.measured_error_of(&picture).map(|measured| measured.error());
    let facts = PictureFacts {
        revision: 1,
        seed: REFERENCE_SEED,
        samples_per_pixel: rendering.passes(),
        technique: indirect.name(),
        error: noise,
        error_ci: None,
        seconds: Some(cost.time.as_secs_f64() * REFERENCE_TIMES),
    };
    let exr = encode_exr(&picture, ExrLayers::Plain, &facts)
        .map_err(|error| ReportError::Text { what: "a reference", reason: error.to_string() })?;
    write_file(path, &exr)?;
    Ok((format!("ours, {}, {} samples", indirect.name(), rendering.passes()), noise))
}
