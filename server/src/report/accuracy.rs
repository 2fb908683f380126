//! How far pictures drawn with a cache of light are from a reference.

use std::sync::{Arc, atomic::AtomicBool};

use lumicast_engine::{
    film::compare,
    math::Rgb,
    render::{Indirect, RenderSettings, Rendering},
    technique::SecondaryLight,
    transport::PathClass,
};

use super::{
    ReportError,
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Cell, Cells, Column},
};

/// The columns that [`add`] fills.
pub(super) const COLUMNS: [Column; 4] = [
    Column::here("error_percent", "error", "%"),
    Column::here("error_trimmed_percent", "trimmed", "%"),
    Column::here("bias_percent", "bias", "%"),
    Column::here("reference_noise_percent", "noise of the reference", "%"),
];

/// Compares a picture drawn with `light` with the reference, if there is one, and adds what is found to a row.
pub(super) fn add(
    cells: &mut Cells,
    subject: &Subject,
    prepared: &Prepared,
    light: Arc<dyn SecondaryLight>,
    passes: u32,
) -> Result<(), ReportError> {
    let Some(reference) = &prepared.reference else { return Ok(()) };
    let settings = RenderSettings { indirect: Indirect::Octree, ..RenderSettings::default() };
    let scene = (prepared.world.clone(), &prepared.plan);
    let mut rendering = Rendering::with(scene, prepared.view, prepared.size, settings, Some(light));
    rendering.look_caustics_up();
    let never = AtomicBool::new(false);
    while rendering.passes() < passes {
        rendering.step(&never);
    }
    let drawn = rendering.picture();
    let picture: Vec<Rgb> = if prepared.is_diffuse {
        // The reference's own direct light, so that the difference is that of the cache alone.
        let cached = drawn.layer(PathClass::Indirect).into_iter().zip(drawn.layer(PathClass::Caustic));
        cached
            .zip(&reference.direct)
            .map(|((indirect, caustic), direct)| indirect + caustic + *direct)
            .collect()
    } else {
        drawn.radiance()
    };
    let error = compare(&picture, &reference.full).map_err(|error| ReportError::Text {
        what: "the comparison with a reference",
        reason: format!("{}: {error}", subject.name),
    })?;
    let figures = [
        Cell::from(100.0 * error.error()),
        Cell::from(100.0 * error.trimmed.sqrt()),
        Cell::from(100.0 * error.bias),
        Cell::from(reference.noise.map(|noise| 100.0 * noise)),
    ];
    cells.extend(COLUMNS.iter().zip(figures).map(|(column, cell)| (column.key.to_string(), cell)));
    Ok(())
}

/// Says once what the columns mean, and of every scene what its errors leave out.
pub(super) fn explain(notebook: &mut Notebook, subject: &Subject, prepared: &Prepared) {
    notebook.note(
        "Error: √relMSE in percent, relMSE = mean over pixels and channels of (t − r)² / (r² + 0.01 m²), r the full \
         reference picture, m its mean. t is the reference's own direct light plus our indirect light and caustics, so \
         the figure is the error that the cache adds to the whole picture. Trimmed: the same without the worst 0.1 % of \
         pixels. Bias: (mean t − mean r) / mean r. The noise of the reference (both of its pictures together) is part of \
         the error: below twice that, errors tell nothing.",
    );
    let name = &subject.name;
    if prepared.reference.is_none() {
        notebook.note(format!(
            "{name} has no reference, so its errors are empty: --references names the folder of NAME-CAMERA.exr and \
             NAME-CAMERA-direct.exr"
        ));
    } else if !prepared.is_diffuse {
        notebook.note(format!(
            "{name} has surfaces that are not Lambertian: its whole picture is compared, and the noise of our direct \
             light is part of the error"
        ));
    }
}
