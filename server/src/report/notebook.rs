//! A report in the making: rows are kept on disk as they come, and those of an earlier run are taken over.

use std::{collections::HashMap, path::Path, path::PathBuf, time::Instant};

use serde::Serialize;
use serde_json::Value;

use super::{
    Paper, ReportError, ReportJob, csv, html,
    machine::Machine,
    table::{Cells, Column, Row, Table},
};
use crate::images::write_file;

/// A report: tables with what they were measured on and how.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Ours.
    pub version: &'static str,
    /// The paper, where one is measured again.
    pub paper: Option<Paper>,
    /// Title for people.
    pub title: &'static str,
    /// The paper and its machine.
    pub paper_source: &'static str,
    /// What our figures were measured on.
    pub machine: Machine,
    /// What they depend on beside.
    pub settings: Value,
    /// What a reader must know: how errors are defined, what was left out and why.
    pub notes: Vec<String>,
    /// The tables.
    pub tables: Vec<Table>,
    /// Pictures beside the report.
    pub pictures: Vec<Figure>,
}

/// A picture in a file of its own, which the page holds as well.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Title for people.
    pub title: String,
    /// Name of the JPEG file beside the report.
    pub file: String,
}

impl Report {
    /// As Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\nLumicast {} on {}.\n\n", self.title, self.version, self.machine);
        if !self.paper_source.is_empty() {
            text += &format!("{}\n\n", self.paper_source);
        }
        for table in &self.tables {
            text += &table.markdown();
            text.push('\n');
        }
        for note in &self.notes {
            text += &format!("- {note}\n");
        }
        text
    }
}

/// Kinds of the files of a report; the last is what makes it one.
const FILES: [&str; 3] = ["csv", "html", "json"];

/// Where report.json keeps rows of an earlier run until they are taken over.
const EARLIER: &str = "earlier";

fn not_json(error: serde_json::Error) -> ReportError {
    ReportError::Text { what: "report.json", reason: error.to_string() }
}

/// A report and the folder it goes to.
#[derive(Debug)]
pub(super) struct Notebook {
    report: Report,
    out: PathBuf,
    /// Rows of an earlier run, by table and key.
    earlier: HashMap<(String, String), Row>,
    taken_over: usize,
}

impl Notebook {
    /// An empty report of `settings` in the folder of `job`, which is made; says on standard error what is taken over from an earlier
    /// run, and what becomes of another report that is there.
    pub(super) fn open(job: &ReportJob, settings: Value) -> Result<Notebook, ReportError> {
        std::fs::create_dir_all(&job.out)
            .map_err(|source| ReportError::Folder { path: job.out.clone(), source })?;
        let report = Report {
            version: env!("CARGO_PKG_VERSION"),
            paper: job.question.paper(),
            title: job.question.title(),
            paper_source: job.question.source(),
            machine: Machine::this(),
            settings,
            notes: Vec::new(),
            tables: Vec::new(),
            pictures: Vec::new(),
        };
        let path = job.out.join("report.json");
        let same = rows_of(&path, &report);
        if same.is_none() && path.exists() {
            set_aside(&job.out)?;
        }
        let earlier = same.unwrap_or_default();
        if !earlier.is_empty() {
            eprintln!(
                "{}: {} rows of the same version and settings are taken over; delete it to measure them again",
                path.display(),
                earlier.len()
            );
        }
        eprintln!("A run that is stopped goes on where it was when it is started again with the same --out.");
        Ok(Notebook { report, out: job.out.clone(), earlier, taken_over: 0 })
    }

    /// Adds what a reader must know, once.
    pub(super) fn note(&mut self, note: impl Into<String>) {
        let note = note.into();
        if !self.report.notes.contains(&note) {
            self.report.notes.push(note);
        }
    }

    /// The same, said at once as well: what would be cause to stop.
    pub(super) fn warn(&mut self, note: impl Into<String>) {
        let note = note.into();
        eprintln!("{note}");
        self.note(note);
    }

    /// The folder of the report.
    pub(super) fn folder(&self) -> &Path {
        &self.out
    }

    /// A number of the newest row.
    pub(super) fn last(&self, column: Column) -> Option<f64> {
        self.report.tables.last()?.rows.last()?.cells.get(column.key)?.value()
    }

    /// A table that was begun.
    pub(super) fn table(&self, id: &str) -> Option<&Table> {
        self.report.tables.iter().find(|table| table.id == id)
    }

    /// Shows a picture that lies beside the report, if it does.
    pub(super) fn show(&mut self, title: String, file: String) {
        if self.out.join(&file).is_file() {
            self.report.pictures.push(Figure { title, file });
        }
    }

    /// Opens the next table; rows go to it from now on.
    pub(super) fn begin(&mut self, table: Table) {
        eprintln!("{}", table.title);
        self.report.tables.push(table);
    }

    /// A row of the newest table is to be measured, whether an earlier run has it or not.
    pub(super) fn forget(&mut self, key: &str) {
        if let Some(table) = self.report.tables.last() {
            self.earlier.remove(&(table.id.to_string(), key.to_string()));
        }
    }

    /// Adds a row to the newest table, from an earlier run or by measuring it, and keeps it.
    pub(super) fn row(
        &mut self,
        key: &str,
        measure: impl FnOnce() -> Result<Cells, ReportError>,
    ) -> Result<(), ReportError> {
        let Some(table) = self.report.tables.last() else { return Ok(()) };
        let start = Instant::now();
        let (row, how) = match self.earlier.remove(&(table.id.to_string(), key.to_string())) {
            Some(row) => {
                self.taken_over += 1;
                (row, "taken over".to_string())
            }
            None => {
                let row = Row { key: key.into(), cells: measure()? };
                (row, format!("{:.1} s", start.elapsed().as_secs_f64()))
            }
        };
        eprintln!("  {key}: {how}");
        if let Some(table) = self.report.tables.last_mut() {
            table.rows.push(row);
        }
        self.save()
    }

    /// Adds a row to the newest table that follows from others.
    pub(super) fn derive(&mut self, key: &str, cells: Cells) -> Result<(), ReportError> {
        if let Some(table) = self.report.tables.last_mut() {
            table.rows.push(Row { key: key.into(), cells });
        }
        self.save()
    }

    /// Writes what there is, so that a run that is stopped loses no row: neither those it has, nor those of an earlier run that
    /// it has not come to yet.
    fn save(&self) -> Result<(), ReportError> {
        let mut json = serde_json::to_value(&self.report).map_err(not_json)?;
        if !self.earlier.is_empty() {
            let mut kept: Vec<(&(String, String), &Row)> = self.earlier.iter().collect();
            kept.sort_by_key(|(name, _)| *name);
            let kept =
                kept.into_iter().map(|((table, _), row)| serde_json::json!({"table": table, "row": row}));
            json[EARLIER] = kept.collect();
        }
        let mut bytes = serde_json::to_vec_pretty(&json).map_err(not_json)?;
        bytes.push(b'\n');
        Ok(write_file(&self.out.join("report.json"), &bytes)?)
    }

    /// Writes all files.
    pub(super) fn finish(mut self) -> Result<Report, ReportError> {
        // Rows that no one asked for any more.
        self.earlier.clear();
        self.save()?;
        write_file(&self.out.join("report.csv"), csv::csv(&self.report).as_bytes())?;
        write_file(&self.out.join("report.html"), html::html(&self.report, &self.out)?.as_bytes())?;
        eprintln!(
            "report.html, report.csv and report.json are in {}; {} rows were taken over",
            self.out.display(),
            self.taken_over
        );
        Ok(self.report)
    }
}

/// Gives the report of a folder a name that none has: what it says was measured, and is not lost to another.
fn set_aside(folder: &Path) -> Result<(), ReportError> {
    let named = |number: u32, kind: &str| folder.join(format!("report-{number}.{kind}"));
    let is_free = |number: &u32| !FILES.iter().any(|kind| named(*number, kind).exists());
    let number = (1..u32::MAX).find(is_free).unwrap_or(u32::MAX);
    for kind in FILES {
        let path = folder.join(format!("report.{kind}"));
        if path.exists() {
            std::fs::rename(&path, named(number, kind))
                .map_err(|source| ReportError::Aside { path, source })?;
        }
    }
    eprintln!(
        "the report that was in {} is of other scenes, settings, version or machine: it is kept as report-{number}",
        folder.display()
    );
    Ok(())
}

/// Rows of an earlier report that would be measured the same way again. What cannot be read is measured anew.
fn rows_of(path: &Path, now: &Report) -> Option<HashMap<(String, String), Row>> {
    let earlier: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let same = |key: &str, value: Value| earlier.get(key) == Some(&value);
    let is_same = same("version", now.version.into())
        && same("paper", serde_json::to_value(now.paper).ok()?)
        && same("machine", serde_json::to_value(&now.machine).ok()?)
        && same("settings", now.settings.clone());
    if !is_same {
        return None;
    }
    let mut rows = HashMap::new();
    for table in earlier.get("tables")?.as_array()? {
        let id = table.get("id")?.as_str()?;
        for row in table.get("rows")?.as_array()? {
            let row: Row = serde_json::from_value(row.clone()).ok()?;
            rows.insert((id.to_string(), row.key.clone()), row);
        }
    }
    for kept in earlier.get(EARLIER).and_then(Value::as_array).into_iter().flatten() {
        let row: Row = serde_json::from_value(kept.get("row")?.clone()).ok()?;
        rows.insert((kept.get("table")?.as_str()?.to_string(), row.key.clone()), row);
    }
    Some(rows)
}
