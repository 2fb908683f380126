//! A report as one HTML page that needs nothing beside itself.

use std::path::Path;

use base64::Engine;

use super::{
    Report, ReportError,
    plot::{Axis, Curve, Plot},
    table::{Cell, Measured, Row, Table},
};

const STYLE: &str = "\
body{font:15px/1.5 sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}\
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.5rem}.wide{overflow-x:auto}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd}th{vertical-align:bottom}\
.given{text-align:left;white-space:nowrap}.paper{color:#777}figure{margin:1.5rem 0}svg,img{max-width:100%;height:auto}\
.pictures{display:flex;flex-wrap:wrap;gap:1rem}.pictures figure{margin:0;max-width:20rem}";

/// The column of scenes in every table.
const SCENE: &str = "scene";

/// What a plot of a table shows.
struct Picture {
    table: &'static str,
    title: &'static str,
    x: (&'static str, &'static str, Axis),
    y: (&'static str, &'static str),
    /// The paper's column on the same axis.
    paper: Option<&'static str>,
    /// The column whose values are curves; `None`: one curve.
    curves: Option<&'static str>,
    /// A plot for each scene.
    is_of_scene: bool,
}

const PICTURES: [Picture; 22] = [
    picture(
        super::cost::CURVES,
        "Error over time",
        ("elapsed", "s"),
        ("clean_error_percent", "√relMSE, %"),
        None,
    )
    .by("curve")
    .by_scene()
    .logarithmic(),
    picture(
        super::cost::CURVES,
        "Systematic error over time",
        ("elapsed", "s"),
        ("systematic_percent", "√relMSE, %"),
        None,
    )
    .by("curve")
    .by_scene()
    .logarithmic(),
    picture(super::cost::CURVES, "Noise over time", ("elapsed", "s"), ("noise_percent", "√relMSE, %"), None)
        .by("curve")
        .by_scene()
        .logarithmic(),
    picture(
        super::cost::CURVES,
        "Systematic error by noise",
        ("noise_percent", "noise, √relMSE, %"),
        ("systematic_percent", "systematic, √relMSE, %"),
        None,
    )
    .by("curve")
    .by_scene()
    .logarithmic(),
    picture(
        super::cost::FRONT,
        "The least error for a time",
        ("elapsed", "s"),
        ("clean_error_percent", "√relMSE, %"),
        None,
    )
    .by("scene")
    .logarithmic(),
    picture(
        "figure-13",
        "Preprocessing by depth",
        ("depth", "depth"),
        ("seconds", "s"),
        Some("paper_seconds"),
    )
    .by("scene"),
    picture("figure-13", "Error by depth", ("depth", "depth"), ("error_percent", "√relMSE, %"), None)
        .by("scene"),
    picture(
        "figure-14",
        "Preprocessing by neighbours",
        ("neighbours", "k"),
        ("seconds", "s"),
        Some("paper_seconds"),
    )
    .by("photons_asked")
    .logarithmic(),
    picture("figure-14", "Error by neighbours", ("neighbours", "k"), ("error_percent", "√relMSE, %"), None)
        .by("photons_asked")
        .logarithmic(),
    picture(
        "figure-17",
        "Preprocessing by clusters",
        ("vdls", "VDLs"),
        ("seconds", "s"),
        Some("paper_seconds"),
    ),
    picture(
        "figure-17",
        "Spread by clusters",
        ("vdls", "VDLs"),
        ("spread_deg", "degrees"),
        Some("paper_spread_deg"),
    ),
    picture("figure-17", "Error by clusters", ("vdls", "VDLs"), ("error_percent", "√relMSE, %"), None),
    picture(
        "table-8.2-cache",
        "Seconds by accuracy",
        ("accuracy", "a"),
        ("seconds", "s"),
        Some("paper_seconds"),
    )
    .by("scene"),
    picture(
        "figure-8.11",
        "Error while the cache fills",
        ("elapsed", "s"),
        ("error_percent", "√relMSE, %"),
        None,
    )
    .logarithmic(),
    picture("figure-8.11", "Records while the cache fills", ("elapsed", "s"), ("records", "records"), None)
        .logarithmic(),
    picture(
        "cache-options",
        "Error by time, by scene",
        ("seconds", "s"),
        ("error_percent", "√relMSE, %"),
        None,
    )
    .by("scene")
    .logarithmic(),
    picture(
        "table-8.1-hemisphere",
        "Error by pixels of the plane",
        ("pixels_across", "pixels across"),
        ("rms_error_percent", "RMS error, %"),
        Some("paper_rms_error_percent"),
    )
    .by(super::hemisphere::SAMPLING.key)
    .by_scene(),
    picture("caustic-frames", "Photons and map", ("photons", "photons"), ("prepare_ms", "ms"), None)
        .by("scene")
        .logarithmic(),
    picture("caustic-error", "Error over time", ("elapsed", "s"), ("error_percent", "√relMSE, %"), None)
        .by(super::caustics::CURVE)
        .logarithmic(),
    picture(
        "table-8.1",
        "500 nearest of a million photons",
        ("maps", "maps"),
        ("look_up_us", "µs"),
        Some("paper_look_up_us"),
    )
    .logarithmic(),
    picture(
        "table-8.1",
        "Building trees over a million photons",
        ("maps", "maps"),
        ("build_seconds", "s"),
        Some("paper_build_seconds"),
    )
    .logarithmic(),
    picture(
        "table-14.1",
        "Building small trees",
        ("photons", "photons"),
        ("build_ms", "ms"),
        Some("paper_build_ms"),
    )
    .logarithmic(),
];

const fn picture(
    table: &'static str,
    title: &'static str,
    x: (&'static str, &'static str),
    y: (&'static str, &'static str),
    paper: Option<&'static str>,
) -> Picture {
    Picture { table, title, x: (x.0, x.1, Axis::Linear), y, paper, curves: None, is_of_scene: false }
}

impl Picture {
    const fn by(self, curves: &'static str) -> Picture {
        Picture { curves: Some(curves), ..self }
    }

    const fn by_scene(self) -> Picture {
        Picture { is_of_scene: true, ..self }
    }

    const fn logarithmic(self) -> Picture {
        Picture { x: (self.x.0, self.x.1, Axis::Logarithmic), ..self }
    }

    /// - `scene`: of the rows; `None`: all rows
    fn plot(&self, table: &Table, scene: Option<&Cell>) -> Plot {
        let mut curves: Vec<Curve> = Vec::new();
        let mut names: Vec<String> = Vec::new();
        let is_of = |row: &&Row| scene.is_none_or(|scene| table.cell(row, SCENE) == scene);
        for row in table.rows.iter().filter(is_of) {
            let name = self.curves.map_or("Lumicast".into(), |key| table.cell(row, key).shown());
            // Ours and the paper's of one name share their colour.
            let colour = names.iter().position(|known| *known == name).unwrap_or(names.len());
            let curve =
                |name: &str, by_paper| Curve { name: name.into(), points: Vec::new(), by_paper, colour };
            let is_other = table.cell(row, super::cost::BACKEND.key) == &Cell::from(super::cost::PEER);
            self.add(&mut curves, table, row, self.y.0, curve(&name, is_other));
            if let Some(paper) = self.paper {
                self.add(&mut curves, table, row, paper, curve(&format!("{name}, paper"), true));
            }
            if colour == names.len() {
                names.push(name);
            }
        }
        let (_, x, x_axis) = self.x;
        let title = scene.map_or(self.title.into(), |scene| format!("{}: {}", self.title, scene.shown()));
        Plot { title, x, y: self.y.1, x_axis, curves }
    }

    /// One for all rows, or one for each scene.
    fn plots(&self, table: &Table) -> Vec<Plot> {
        if !self.is_of_scene {
            return vec![self.plot(table, None)];
        }
        let mut scenes: Vec<&Cell> = table.rows.iter().map(|row| table.cell(row, SCENE)).collect();
        scenes.dedup();
        scenes.into_iter().map(|scene| self.plot(table, Some(scene))).collect()
    }

    /// Adds the point of a row to its curve, which is `curve` if there is none of its name yet.
    fn add(&self, curves: &mut Vec<Curve>, table: &Table, row: &Row, key: &str, mut curve: Curve) {
        let value = |key: &str| table.cell(row, key).value();
        // Logarithms want numbers above zero.
        let Some(point) = value(self.x.0).zip(value(key)).filter(|(_, y)| *y > 0.0) else { return };
        match curves.iter_mut().find(|known| known.name == curve.name) {
            Some(known) => known.points.push(point),
            None => {
                curve.points.push(point);
                curves.push(curve);
            }
        }
    }
}

/// The page.
///
/// - `folder`: of the report's pictures
pub(super) fn html(report: &Report, folder: &Path) -> Result<String, ReportError> {
    let mut body = format!(
        "<h1>{}</h1>\n<p>Lumicast {} on {}.</p>\n<p class=\"paper\">{}</p>\n",
        escaped(report.title),
        report.version,
        escaped(&report.machine.to_string()),
        escaped(report.paper_source)
    );
    for table in &report.tables {
        body += &html_table(table);
        for picture in PICTURES.iter().filter(|picture| picture.table == table.id) {
            for plot in picture.plots(table) {
                if let Some(svg) = plot.svg()? {
                    body += &format!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", plot.legend());
                }
            }
        }
    }
    if !report.pictures.is_empty() {
        body += "<h2>Pictures</h2>\n<div class=\"pictures\">\n";
    }
    for figure in &report.pictures {
        let path = folder.join(&figure.file);
        let jpeg = std::fs::read(&path).map_err(|error| ReportError::Text {
            what: "a picture of report.html",
            reason: format!("{}: {error}", path.display()),
        })?;
        let (jpeg, title) = (base64::engine::general_purpose::STANDARD.encode(jpeg), escaped(&figure.title));
        body += &format!(
            "<figure><img alt=\"{title}\" src=\"data:image/jpeg;base64,{jpeg}\"><figcaption>{title}</figcaption></figure>\n"
        );
    }
    if !report.pictures.is_empty() {
        body += "</div>\n";
    }
    let notes: String = report.notes.iter().map(|note| format!("<li>{}</li>\n", escaped(note))).collect();
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{}</title><style>{STYLE}</style></head>\n\
         <body>\n{body}<h2>Notes</h2>\n<ul>\n{notes}</ul>\n</body></html>\n",
        escaped(report.title)
    ))
}

fn html_table(table: &Table) -> String {
    let class = |by: Measured| match by {
        Measured::Given => "given",
        Measured::Here => "here",
        Measured::Paper => "paper",
    };
    let heads = table
        .columns
        .iter()
        .map(|column| format!("<th class=\"{}\">{}</th>", class(column.by), escaped(&column.heading())));
    let rows = table.rows.iter().map(|row| {
        let cells = table.columns.iter().map(|column| {
            let cell: &Cell = table.cell(row, column.key);
            format!("<td class=\"{}\">{}</td>", class(column.by), escaped(&column.shown(cell)))
        });
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    });
    format!(
        "<h2>{}</h2>\n<p>{}</p>\n<div class=\"wide\"><table><thead><tr>{}</tr></thead><tbody>\n{}</tbody></table></div>\n",
        escaped(table.title),
        escaped(&table.about),
        heads.collect::<String>(),
        rows.collect::<String>()
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
