//! Reports from end to end, on the built-in boxes and with little effort.

use std::{num::NonZeroUsize, path::Path, time::Duration};

use lumicast_engine::render::Indirect;

use super::{Cost, Effort, Paper, Question, Report, ReportJob, measure_with, table::Cell};
use crate::assets::BuiltinScene;
use crate::cli::scene_source::SceneSource;

const LITTLE: Effort = Effort {
    photon_share: 0.004,
    levels_less: 2,
    passes: 1,
    map_passes: 1,
    repeats: 2,
    octree_builds: 1,
    cache_side: 32,
    one_bounce_passes: 4,
    cache_passes: 2,
    fill_steps: 1,
    hemispheres: 64,
    hemisphere_rays: 32,
    record_rays: NonZeroUsize::new(100),
};

fn job(paper: Paper, out: &Path) -> ReportJob {
    let missing = out.join("there is no such folder");
    ReportJob {
        question: Question::Paper(paper),
        scenes: vec![SceneSource::Builtin(BuiltinScene::Boxes)],
        scenes_folder: missing.clone(),
        references_folder: missing,
        out: out.into(),
    }
}

/// Files are there, hold every row, are valid, and ask for nothing from elsewhere.
fn check_files(report: &Report, out: &Path) {
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let json: serde_json::Value = serde_json::from_str(&read("report.json")).unwrap();
    assert!(json == serde_json::to_value(report).unwrap(), "report.json is not the report");
    let csv = read("report.csv");
    let figures: usize = report
        .tables
        .iter()
        .flat_map(|table| &table.rows)
        .map(|row| row.cells.values().filter(|cell| **cell != Cell::Empty).count())
        .sum();
    // Only figures that have a column are written, and every figure of the report has at most one.
    assert!(csv.lines().count() > 10 && csv.lines().count() <= figures + 1, "{csv}");
    assert!(csv.lines().all(|line| line.split(',').count() >= 6), "{csv}");
    let html = read("report.html");
    // Pictures are part of the page.
    let html: String = html
        .split("src=\"data:image/jpeg;base64,")
        .map(|part| part.split_once('"').map_or(part, |(_, rest)| rest))
        .collect();
    for reference in ["http", "src=", "href=", "url(", "@import", "<script", "<link"] {
        assert!(!html.contains(reference), "{reference} in {html}");
    }
    assert!(html.contains("<svg") && html.matches("<table>").count() == report.tables.len());
}

/// Every figure is a finite number, none below zero but biases; what is measured by the clock is above zero.
fn check_figures(report: &Report) {
    for table in &report.tables {
        assert!(!table.rows.is_empty(), "{}", table.id);
        for (row, column) in table.rows.iter().flat_map(|row| table.columns.iter().map(move |c| (row, c))) {
            let cell = table.cell(row, column.key);
            if let Cell::Number(value) = cell {
                assert!(value.is_finite() && *value >= 0.0, "{} {} {value}", row.key, column.key);
            }
            let is_timed = ["seconds", "build_ms", "look_up_us", "look_up_ms", "look_ups_per_second"];
            if is_timed.contains(&column.key) {
                assert!(cell.value().is_some_and(|value| value > 0.0), "{} {}", row.key, column.key);
            }
        }
    }
    let markdown = report.markdown();
    assert!(report.tables.iter().all(|table| markdown.contains(table.title)), "{markdown}");
}

/// Measured once, the rows of a report are taken over by the next run of the same settings, and by no other.
#[test]
fn an_octree_report_is_whole_and_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(Paper::Octree, folder.path());
    let report = measure_with(&job, LITTLE).unwrap();
    check_files(&report, folder.path());
    check_figures(&report);
    let rows: Vec<usize> = report.tables.iter().map(|table| table.rows.len()).collect();
    assert_eq!(rows, [3, 16, 6]);
    assert!(report.notes.iter().any(|note| note.contains("boxes has no reference")));
    // Times never repeat to the last digit: equal rows were not measured again.
    let again = measure_with(&job, LITTLE).unwrap();
    assert!(again.tables == report.tables, "rows were measured again");
    let other = measure_with(&job, Effort { photon_share: 0.003, ..LITTLE }).unwrap();
    assert!(other.tables != report.tables, "rows of other settings were taken over");
}

/// All three tables, on a scene without a reference.
#[test]
fn a_larsen_report_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let report = measure_with(&job(Paper::LarsenMaps, folder.path()), LITTLE).unwrap();
    check_files(&report, folder.path());
    check_figures(&report);
    let rows: Vec<usize> = report.tables.iter().map(|table| table.rows.len()).collect();
    assert_eq!(rows, [4, 3, 4]);
}

/// Table, figure and options; without a reference no errors but those against the path tracer.
#[test]
fn an_irradiance_report_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let job = ReportJob {
        scenes: vec![SceneSource::Builtin(BuiltinScene::CornellBox)],
        ..job(Paper::Irradiance, folder.path())
    };
    let report = measure_with(&job, LITTLE).unwrap();
    check_files(&report, folder.path());
    check_figures(&report);
    let rows: Vec<usize> = report.tables.iter().map(|table| table.rows.len()).collect();
    assert_eq!(rows, [2, 1, 8]);
    let errors =
        report.tables[0].rows.iter().map(|row| report.tables[0].cell(row, "one_bounce_error_percent"));
    assert!(errors.clone().count() == 2);
    // Four samples of a small box in means of 4 × 4 pixels are off by a few percent, records by less; a picture without
    // its indirect light by 60.
    errors.for_each(|error| assert!(error.value().is_some_and(|error| error < 25.0), "{error:?}"));
}

/// Errors of all variants by all sizes, in the order that the paper has them; along rays and, where there is a card, drawn there.
#[test]
fn a_report_of_hemispheres_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let report = measure_with(&job(Paper::Hemisphere, folder.path()), LITTLE).unwrap();
    check_files(&report, folder.path());
    let [errors, costs] = &report.tables[..] else { panic!("{} tables", report.tables.len()) };
    assert!(errors.rows.len() == 16 && (1..=2).contains(&costs.rows.len()));
    let error = |key: &str| {
        let row = errors.rows.iter().find(|row| row.key == format!("boxes 32 {key}")).unwrap();
        errors.cell(row, "rms_error_percent").value().unwrap()
    };
    let [alone, divided, stretched, rays] =
        ["plane alone", "divided by coverage", "borders stretched", "as many rays"].map(error);
    // Planes miss a sixth of an even hemisphere's light; what they are compared with has a few percent of noise.
    assert!(alone > 10.0 && alone < 40.0, "{alone}");
    assert!(stretched < 0.7 * alone && divided < alone, "{alone} {divided} {stretched}");
    assert!(rays < alone, "{rays}");
    for row in &costs.rows {
        let of = |key: &str| costs.cell(row, key).value();
        assert!(of("seeing_us").unwrap() > 0.0 && of("light_us").unwrap() > 0.0);
        assert!(of("alike_percent").is_none_or(|alike| alike > 99.0), "{:?}", of("alike_percent"));
    }
}

/// Frames and curves; a scene without mirrors and glass is refused by name.
#[test]
fn a_report_of_caustics_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let of = |scene| ReportJob { scenes: vec![scene], ..job(Paper::Caustics, folder.path()) };
    let report = measure_with(&of(SceneSource::Builtin(BuiltinScene::CornellBox)), LITTLE).unwrap();
    check_files(&report, folder.path());
    check_figures(&report);
    let rows: Vec<usize> = report.tables.iter().map(|table| table.rows.len()).collect();
    assert_eq!(rows, [3, 5]);
    let stored = report.tables[0].rows.iter().map(|row| report.tables[0].cell(row, "stored").value());
    assert!(stored.clone().all(|stored| stored.is_some_and(|stored| stored > 0.0)));
    let error = measure_with(&of(SceneSource::Builtin(BuiltinScene::Boxes)), LITTLE).unwrap_err();
    assert!(error.to_string().contains("mirrors or glass"), "{error}");
}

/// Curves of every technique with all its settings, the front and the prices that follow, what effects take, and pictures; a
/// run that goes on measures nothing again; pictures of another renderer are compared with the same reference.
#[test]
fn a_report_of_cost_is_whole_and_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let cost = |peers| Cost {
        techniques: vec![Indirect::Octree, Indirect::Auto, Indirect::Path],
        time: Duration::from_millis(500),
        peers,
    };
    let job = |peers| ReportJob {
        question: Question::Cost(cost(peers)),
        scenes: vec![SceneSource::Builtin(BuiltinScene::CornellBox)],
        ..job(Paper::Octree, folder.path())
    };
    let report = measure_with(&job(vec![]), LITTLE).unwrap();
    check_files(&report, folder.path());
    let of = |id: &str| report.tables.iter().find(|table| table.id == id).unwrap();
    let curves = of("curves");
    // Two looks at four ways; effects that the built-in box has.
    assert_eq!((of("references").rows.len(), curves.rows.len(), of("effects").rows.len()), (1, 8, 2));
    for row in &curves.rows {
        let figure = |key: &str| curves.cell(row, key).value();
        let (error, noise) = (figure("error_percent").unwrap(), figure("noise_percent").unwrap());
        assert!(error > 0.1 && error < 1000.0, "{} {error}", row.key);
        // The mean of both errors is what they share and what they do not.
        if let Some(systematic) = figure("systematic_percent") {
            let clean = figure("clean_error_percent").unwrap();
            assert!((noise.hypot(systematic) / clean - 1.0).abs() < 1e-3, "{} {noise} {systematic}", row.key);
            assert!(clean <= error, "{} {clean} {error}", row.key);
        }
        assert!(figure("megabytes").unwrap() > 0.0 && figure("samples").unwrap() >= 1.0, "{}", row.key);
        assert!(figure("elapsed").unwrap() >= 0.25, "{}", row.key);
    }
    let front = of("front");
    let [errors, clean] = ["error_percent", "clean_error_percent"]
        .map(|key| front.rows.iter().filter_map(|row| front.cell(row, key).value()).collect::<Vec<f64>>());
    assert!(!errors.is_empty() && errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    // Below what can be told beside the noise of the reference all are told as that much.
    assert!(clean.len() == errors.len() && clean.is_sorted_by(|a, b| a >= b), "{clean:?}");
    assert_eq!(of("prices").rows.len(), 5);
    // Four pictures with their differences, in the page and beside it.
    assert_eq!(report.pictures.len(), 8);
    let again = measure_with(&job(vec![]), LITTLE).unwrap();
    assert!(again.tables == report.tables && again.pictures == report.pictures, "rows were measured again");
    let series = folder.path().join("series.json");
    let exr = folder.path().join("cornell-box-reference.exr");
    let write = |exr: &Path| {
        let json =
            serde_json::json!({"peer": "other", "scene": "cornell-box", "points": [{"t": 0.3, "exr": exr}]});
        std::fs::write(&series, json.to_string()).unwrap();
    };
    // A run that fails keeps what it has not come to.
    let broken = folder.path().join("broken.exr");
    std::fs::write(&broken, "no picture").unwrap();
    write(&broken);
    let error = measure_with(&job(vec![series.clone()]), LITTLE).unwrap_err();
    assert!(error.to_string().contains("broken.exr"), "{error}");
    write(&exr);
    let with_peer = measure_with(&job(vec![series.clone()]), LITTLE).unwrap();
    let table = |id: &str| with_peer.tables.iter().find(|table| table.id == id).unwrap();
    let row = table("curves").rows.iter().find(|row| row.key.contains("other")).unwrap();
    assert_eq!(table("curves").cell(row, "error_percent"), &Cell::Number(0.0));
    assert!(
        table("curves").rows.len() == 9
            && table("effects") == of("effects")
            && table("prices") == of("prices")
    );
    let twice = ReportJob {
        scenes: vec![
            SceneSource::Builtin(BuiltinScene::CornellBox),
            SceneSource::Builtin(BuiltinScene::CornellBox),
        ],
        ..job(vec![])
    };
    assert!(measure_with(&twice, LITTLE).unwrap_err().to_string().contains("two scenes"));
}

/// Missing scenes are named with the place they belong to, and the built-in ones stand in.
#[test]
fn missing_scenes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let job = ReportJob { scenes: Vec::new(), ..job(Paper::Octree, folder.path()) };
    let (subjects, left_out) = super::subject::find(&job, &super::octree::SCENES, None);
    assert_eq!(subjects.len(), 1);
    assert_eq!(left_out.len(), 3);
    assert!(left_out.iter().any(|line| line.contains("bunny-room.glb")), "{left_out:?}");
    let (subjects, left_out) = super::subject::find(
        &job,
        &super::crease::SCENES,
        Some(SceneSource::Builtin(BuiltinScene::CornellBox)),
    );
    assert_eq!((subjects.len(), left_out.len()), (1, 2));
}

/// Another report in the same folder replaces none; one that is broken is kept too; what cannot be measured leaves no folder.
#[test]
fn an_earlier_report_of_something_else_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let open = |paper, settings: i32| {
        super::Notebook::open(&job(paper, &out), settings.into()).unwrap().finish().unwrap()
    };
    let names = || {
        let entries = std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = entries.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    };
    let files = ["report.csv", "report.html", "report.json"].map(String::from);
    open(Paper::Octree, 1);
    open(Paper::Octree, 1);
    assert_eq!(names(), files, "the same report goes on where it was");
    let first = std::fs::read(out.join("report.json")).unwrap();
    open(Paper::Octree, 2);
    assert_eq!(std::fs::read(out.join("report-1.json")).unwrap(), first);
    std::fs::write(out.join("report.json"), "{").unwrap();
    open(Paper::Caustics, 2);
    assert_eq!(std::fs::read_to_string(out.join("report-2.json")).unwrap(), "{");
    assert_eq!(names().len(), 9, "{:?}", names());

    let missing = ReportJob {
        scenes: vec![SceneSource::File(folder.path().join("none.glb"))],
        ..job(Paper::Octree, &folder.path().join("other"))
    };
    let error = measure_with(&missing, LITTLE).unwrap_err();
    assert!(error.to_string().contains("none"), "{error}");
    assert!(!missing.out.exists());
}
