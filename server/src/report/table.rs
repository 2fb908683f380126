//! Tables of figures and how they look as Markdown.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Figures of a row by the key of their column.
pub(super) type Cells = BTreeMap<String, Cell>;

/// One figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A finite number.
    Number(f64),
    /// A name.
    Text(String),
    /// Not measured, or not given by the paper.
    Empty,
}

impl From<f64> for Cell {
    /// What is not finite is no figure. Nine digits are kept: more is noise, and numbers so short are read back from JSON
    /// as they were written, so that rows of an earlier run do not change.
    fn from(value: f64) -> Cell {
        match format!("{value:.8e}").parse::<f64>() {
            Ok(value) if value.is_finite() => Cell::Number(value),
            _ => Cell::Empty,
        }
    }
}

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Cell {
        value.map_or(Cell::Empty, Cell::from)
    }
}

impl From<&str> for Cell {
    fn from(value: &str) -> Cell {
        Cell::Text(value.into())
    }
}

impl Cell {
    /// As people read it: three digits, or all of a whole number.
    pub(super) fn shown(&self) -> String {
        match self {
            Cell::Number(value) => number(*value),
            Cell::Text(text) => text.clone(),
            Cell::Empty => "–".into(),
        }
    }

    /// The number, if it is one.
    pub(super) fn value(&self) -> Option<f64> {
        match self {
            Cell::Number(value) => Some(*value),
            _ => None,
        }
    }
}

/// Who measured a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Measured {
    /// What was asked for, no measurement.
    Given,
    /// This machine.
    Here,
    /// The paper, on its machine.
    Paper,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Column {
    /// Name in JSON and CSV.
    pub key: &'static str,
    /// Name for people.
    pub title: &'static str,
    /// Unit; empty for counts and names.
    pub unit: &'static str,
    /// Who measured it.
    pub by: Measured,
}

impl Column {
    /// Something asked for.
    pub(super) const fn given(key: &'static str, title: &'static str) -> Column {
        Column { key, title, unit: "", by: Measured::Given }
    }

    /// Something measured here.
    pub(super) const fn here(key: &'static str, title: &'static str, unit: &'static str) -> Column {
        Column { key, title, unit, by: Measured::Here }
    }

    /// Something that the paper says.
    pub(super) const fn paper(key: &'static str, title: &'static str, unit: &'static str) -> Column {
        Column { key, title, unit, by: Measured::Paper }
    }

    /// A figure as people read it: the paper's with the digits that it gives.
    pub(super) fn shown(&self, cell: &Cell) -> String {
        match cell {
            Cell::Number(value) if self.by == Measured::Paper => value.to_string(),
            _ => cell.shown(),
        }
    }

    /// Title with unit.
    pub(super) fn heading(&self) -> String {
        if self.unit.is_empty() { self.title.into() } else { format!("{}, {}", self.title, self.unit) }
    }
}

/// A row of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Names it within its table.
    pub key: String,
    /// Its figures.
    pub cells: BTreeMap<String, Cell>,
}

/// A table: a figure or table of the paper, measured again.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Name in JSON and CSV.
    pub id: &'static str,
    /// Title for people.
    pub title: &'static str,
    /// How it was measured.
    pub about: String,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Its rows so far.
    pub rows: Vec<Row>,
}

impl Table {
    /// No rows yet.
    pub(super) fn new(id: &'static str, title: &'static str, about: String, columns: &[Column]) -> Table {
        Table { id, title, about, columns: columns.to_vec(), rows: Vec::new() }
    }

    /// The figure of a row, if it has one.
    pub(super) fn cell<'a>(&self, row: &'a Row, key: &str) -> &'a Cell {
        row.cells.get(key).unwrap_or(&Cell::Empty)
    }

    /// As Markdown, columns aligned.
    pub(super) fn markdown(&self) -> String {
        let mut lines: Vec<Vec<String>> = vec![self.columns.iter().map(Column::heading).collect()];
        lines.extend(
            self.rows.iter().map(|row| {
                self.columns.iter().map(|column| column.shown(self.cell(row, column.key))).collect()
            }),
        );
        // A bar in a name would end its cell.
        let lines: Vec<Vec<String>> = lines
            .into_iter()
            .map(|line| line.into_iter().map(|text| text.replace('|', "\\|")).collect())
            .collect();
        let widths: Vec<usize> = (0..self.columns.len())
            .map(|at| lines.iter().map(|line| line[at].chars().count()).max().unwrap_or(0).max(3))
            .collect();
        let mut text = format!("## {}\n\n{}\n\n", self.title, self.about);
        for (index, line) in lines.iter().enumerate() {
            let cells = line.iter().zip(&widths).map(|(cell, width)| format!(" {cell:>width$} |"));
            text += &format!("|{}\n", cells.collect::<String>());
            if index == 0 {
                let rule = widths.iter().map(|width| format!(" {}: |", "-".repeat(width - 1)));
                text += &format!("|{}\n", rule.collect::<String>());
            }
        }
        text
    }
}

/// Three digits; from 100 on the whole number with its thousands set apart.
fn number(value: f64) -> String {
    let size = value.abs();
    if size >= 99.95 || (size.fract() == 0.0 && size < 1e15) {
        return grouped(value.round());
    }
    // Digits after the point that leave three in all; 0.000123 keeps 0.000123.
    let decimals = (2 - size.log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

fn grouped(whole: f64) -> String {
    let digits = format!("{:.0}", whole.abs());
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if whole < 0.0 { format!("-{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers show three digits, whole ones all of theirs.
    #[test]
    fn numbers_show_three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (4.0, "4"),
            (0.012345, "0.0123"),
            (1.2345, "1.23"),
            (-12.345, "-12.3"),
            (99.96, "100"),
            (123.456, "123"),
            (1_234_567.0, "1,234,567"),
            (-600_000.0, "-600,000"),
        ] {
            assert_eq!(Cell::from(value).shown(), text);
        }
        assert_eq!(Cell::from(f64::NAN), Cell::Empty);
        assert_eq!(Cell::Empty.shown(), "–");
    }

    /// Every line of the Markdown has the same columns, at the same places.
    #[test]
    fn markdown_is_aligned() {
        let columns = [Column::given("scene", "scene"), Column::here("s", "build", "s")];
        // The paper's figures keep their digits.
        assert_eq!(Column::paper("p", "paper", "s").shown(&Cell::from(0.08)), "0.08");
        let mut table = Table::new("t", "Title", "About.".into(), &columns);
        for (name, value) in [("a|b", Cell::from(1.5)), ("longer name", Cell::Empty)] {
            let cells = [("scene".to_string(), Cell::from(name)), ("s".to_string(), value)];
            table.rows.push(Row { key: name.into(), cells: cells.into() });
        }
        let text = table.markdown();
        let lines: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(lines.len(), 4);
        assert!(lines.iter().all(|line| line.chars().count() == lines[0].chars().count()), "{text}");
        assert_eq!(lines[2], r"|        a\|b |     1.50 |");
        assert!(text.starts_with("## Title\n\nAbout.\n\n|"));
    }

    /// What is written as JSON is read back as it was.
    #[test]
    fn cells_survive_json() {
        let numbers = (1..200).map(|n| Cell::from(1.234_567_891_234_567 * f64::from(n).powi(3) / 1e4));
        for cell in numbers.chain([Cell::Text("x".into()), Cell::Empty]) {
            let json = serde_json::to_string(&cell).unwrap();
            assert_eq!(serde_json::from_str::<Cell>(&json).unwrap(), cell);
        }
    }
}
