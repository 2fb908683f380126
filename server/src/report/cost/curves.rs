//! Error over time: pictures drawn twice, and those of other renderers, against one reference.

use std::time::Duration;

use lumicast_engine::{
    film::compare,
    math::Rgb,
    render::{Illumination, RenderSettings},
};

use super::{
    super::{
        Cost, ReportError,
        drawing::Drawing,
        notebook::Notebook,
        peers, pictures,
        subject::{Prepared, read},
        table::{Cell, Cells},
    },
    BACKEND, BIAS, CLEAN, CURVE, ELAPSED, ERROR, HIGH, LOW, MEASURED, MEMORY, NOISE, PEER, SAMPLES, SCENE,
    SETTINGS, SYSTEMATIC, TECHNIQUE, TRIMMED, Way, file_name, percent, shown_size,
    target::Target,
    times,
};

/// Seeds of the two pictures.
const SEEDS: [u64; 2] = [1, 2];

/// Draws a picture twice and looks at both on the way.
///
/// - `prepared`: its scene, once it is read
pub(super) fn curve(
    notebook: &mut Notebook,
    (target, prepared): (&Target<'_>, &mut Option<Prepared>),
    way: &Way,
    cost: &Cost,
) -> Result<(), ReportError> {
    let (scene, technique) = (target.subject.name.as_str(), way.technique.name());
    let mut pair: Option<[Drawing; 2]> = None;
    for seconds in times(cost) {
        notebook.row(&format!("{scene} {technique} {} after {seconds} s", way.settings), || {
            let pair = match &mut pair {
                Some(pair) => pair,
                None => pair.insert(begin(target, once(prepared, target)?, way)),
            };
            pair.iter_mut().for_each(|drawing| drawing.advance(Duration::from_secs_f64(seconds)));
            cells(target, way, pair)
        })?;
    }
    let name = format!("{}-{technique}{}", file_name(scene), way.suffix);
    let [picture, difference] = [format!("{name}.jpg"), format!("{name}-difference.jpg")];
    if let Some([drawing, _]) = &pair {
        let radiance = drawing.rendering.picture().radiance();
        let reference: &[Rgb] = &target.reference.picture;
        let path = |file: &str| notebook.folder().join(file);
        pictures::write_picture(&path(&picture), target.reference.size, &radiance, target.mean)?;
        let both = [&radiance, reference];
        pictures::write_difference(&path(&difference), target.reference.size, both, target.mean)?;
    }
    let end = cost.time.as_secs_f64();
    notebook.show(format!("{scene}, {technique}, {}, after {end} s", way.settings), picture);
    notebook.show(format!("{scene}, {technique}, {}: difference", way.settings), difference);
    Ok(())
}

/// The scene, read when it is first asked for.
fn once<'a>(prepared: &'a mut Option<Prepared>, target: &Target<'_>) -> Result<&'a Prepared, ReportError> {
    Ok(match prepared {
        Some(prepared) => prepared,
        None => prepared.insert(target.subject.prepare()?),
    })
}

fn begin(target: &Target<'_>, prepared: &Prepared, way: &Way) -> [Drawing; 2] {
    SEEDS.map(|seed| {
        let settings = RenderSettings { indirect: way.technique, seed, ..RenderSettings::default() };
        let mut illumination = way.illumination;
        (illumination.photons.seed, illumination.irradiance.seed) = (seed, seed);
        Drawing::learning_by(prepared.again(target.reference.size), settings, illumination)
    })
}

fn cells(target: &Target<'_>, way: &Way, pair: &[Drawing; 2]) -> Result<Cells, ReportError> {
    let reference = &target.reference.picture;
    let pictures = pair.each_ref().map(|drawing| drawing.rendering.picture());
    let radiances = pictures.each_ref().map(|picture| picture.radiance());
    let [first, second] = radiances.each_ref().map(|radiance| compare(radiance, reference));
    let fail = |error: lumicast_engine::film::CompareError| ReportError::Text {
        what: "the comparison with a reference",
        reason: format!("{}: {error}", target.subject.name),
    };
    let (first, second) = (first.map_err(fail)?, second.map_err(fail)?);
    let mean = |a: f64, b: f64| 0.5 * (a + b);
    let (systematic, noise) = split(&radiances, reference, target.mean);
    let rendering = &pair[0].rendering;
    let measured = rendering.measured_error_of(&pictures[0]);
    let interval = measured.map(|measured| measured.error_interval_95());
    let light = rendering.illumination().map(Illumination::report).unwrap_or_default();
    let bytes = rendering.film_bytes()
        + rendering.records().bytes
        + rendering.caustics().bytes
        + light.photon_bytes
        + light.octree_bytes;
    let mut cells = names(target, way.technique.name(), way.settings, "cpu");
    cells.extend(
        [
            (ELAPSED, Cell::from(mean(pair[0].seconds(), pair[1].seconds()))),
            (SAMPLES, f64::from(rendering.passes()).into()),
            (ERROR, percent(Some(mean(first.rel_mse, second.rel_mse).sqrt()))),
            (CLEAN, percent(Some(target.clean(mean(first.rel_mse, second.rel_mse)).sqrt()))),
            (TRIMMED, percent(Some(mean(first.trimmed, second.trimmed).sqrt()))),
            (BIAS, percent(Some(mean(first.bias, second.bias)))),
            (SYSTEMATIC, percent(target.clean_systematic(systematic).map(f64::sqrt))),
            (NOISE, percent(Some(noise.sqrt()))),
            (MEASURED, percent(measured.map(|measured| measured.error()))),
            (LOW, percent(interval.map(|interval| interval[0]))),
            (HIGH, percent(interval.map(|interval| interval[1]))),
            (MEMORY, (bytes as f64 * 1e-6).into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell)),
    );
    Ok(cells)
}

fn names(target: &Target<'_>, technique: &str, settings: &str, backend: &str) -> Cells {
    let scene = target.subject.name.as_str();
    let curve = match settings {
        "" => format!("{scene}, {technique} (not ours)"),
        "usual" => format!("{scene}, {technique}"),
        _ => format!("{scene}, {technique}, {settings}"),
    };
    let names =
        [(SCENE.key, scene), (TECHNIQUE.key, technique), (SETTINGS.key, settings), (BACKEND.key, backend)];
    let names = names.into_iter().chain([(CURVE, curve.as_str())]);
    names.map(|(key, name)| (key.to_string(), Cell::from(name))).collect()
}

/// relMSE of what two pictures have in common, `None` where that may be chance, and of what they do not.
fn split([first, second]: &[Vec<Rgb>; 2], reference: &[Rgb], mean: f64) -> (Option<f64>, f64) {
    let floor = 0.01 * mean * mean;
    let count = reference.len().max(1) as f64;
    let (mut common, mut squares, mut noise) = (0.0, 0.0, 0.0);
    for ((a, b), r) in first.iter().zip(second).zip(reference) {
        let mut of_pixel = 0.0;
        for at in 0..3 {
            let [a, b, r] = [a[at], b[at], r[at]].map(f64::from);
            let scale = 1.0 / (3.0 * (r * r + floor));
            of_pixel += (a - r) * (b - r) * scale;
            noise += 0.5 * (a - b) * (a - b) * scale;
        }
        common += of_pixel;
        squares += of_pixel * of_pixel;
    }
    let common = common / count;
    let deviation = ((squares / count - common * common).max(0.0) / count).sqrt();
    ((common > 2.0 * deviation).then_some(common), noise / count)
}

/// What another renderer drew, compared with the same reference.
pub(super) fn peer_curve(
    notebook: &mut Notebook,
    target: &Target<'_>,
    series: &peers::Series,
) -> Result<(), ReportError> {
    for point in &series.points {
        let broken = |reason: String| ReportError::Peer { path: point.exr.clone(), reason };
        let (size, picture) = read(&point.exr)?;
        if size != target.reference.size {
            let [size, wanted] = [size, target.reference.size].map(shown_size);
            return Err(broken(format!("it has {size} pixels, the reference {wanted}")));
        }
        let error =
            compare(&picture, &target.reference.picture).map_err(|error| broken(error.to_string()))?;
        let mut cells = names(target, &series.peer, "", PEER);
        cells.extend(
            [
                (ELAPSED, Cell::from(point.seconds)),
                (ERROR, percent(Some(error.error()))),
                (CLEAN, percent(Some(target.clean(error.rel_mse).sqrt()))),
                (TRIMMED, percent(Some(error.trimmed.sqrt()))),
                (BIAS, percent(Some(error.bias))),
            ]
            .map(|(column, cell)| (column.key.to_string(), cell)),
        );
        notebook.derive(&format!("{} {} after {} s", series.scene, series.peer, point.seconds), cells)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What two pictures share is systematic, what they differ by is noise; together they are the error.
    #[test]
    fn errors_are_split_into_what_stays_and_what_goes() {
        let reference = vec![Rgb::splat(1.0); 2];
        let pictures = [vec![Rgb::splat(1.3), Rgb::splat(1.1)], vec![Rgb::splat(1.1), Rgb::splat(1.3)]];
        let (systematic, noise) = split(&pictures, &reference, 1.0);
        let systematic = systematic.unwrap();
        assert!((systematic * 1.01 - 0.03).abs() < 1e-6 && (noise * 1.01 - 0.02).abs() < 1e-6);
        let error = compare(&pictures[0], &reference).unwrap().rel_mse;
        assert!((systematic + noise - error).abs() < 1e-6);
        // What may be chance is not told.
        let pictures = [vec![Rgb::splat(1.3), Rgb::splat(0.7)], vec![Rgb::splat(1.1), Rgb::splat(1.3)]];
        assert_eq!(split(&pictures, &reference, 1.0).0, None);
    }
}
