//! What follows from curves: the least error for a time, and what an error costs.

use super::{
    super::{
        ReportError,
        notebook::Notebook,
        subject::Subject,
        table::{Cell, Cells, Column, Row, Table},
    },
    BACKEND, CLEAN, CURVE, CURVES, ELAPSED, ERROR, FRONT, PEER, SCENE, SETTINGS, SYSTEMATIC, TECHNIQUE,
};

/// Errors whose price is said, percent.
const TARGETS_PERCENT: [f64; 5] = [20.0, 10.0, 5.0, 2.0, 1.0];
/// Systematic error of all techniques from which on the reference is doubted: none is so wrong, and path tracing is not wrong at all.
const DOUBTED_PERCENT: f64 = 20.0;
const TARGET: Column = Column::given("target_percent", "error, %");
const SECONDS: Column = Column::here("seconds", "after", "s");

/// Rows of our own curves of a scene.
fn rows_of<'a>(notebook: &'a Notebook, scene: &str) -> Vec<&'a Row> {
    let is_ours = |row: &&Row| row.cells.get(BACKEND.key) != Some(&Cell::from(PEER));
    let is_of = |row: &&Row| row.cells.get(SCENE.key) == Some(&Cell::from(scene));
    notebook.table(CURVES).iter().flat_map(|table| &table.rows).filter(is_of).filter(is_ours).collect()
}

fn number(row: &Row, column: Column) -> f64 {
    row.cells.get(column.key).and_then(Cell::value).unwrap_or(f64::INFINITY)
}

fn copied(row: &Row, columns: &[Column]) -> Cells {
    let of = |column: &Column| Some((column.key.to_string(), row.cells.get(column.key)?.clone()));
    columns.iter().filter_map(of).collect()
}

/// Of every scene what has the least error for its time: no other is as good as soon.
pub(super) fn front(notebook: &mut Notebook, subjects: &[Subject]) -> Result<(), ReportError> {
    let columns = [SCENE, ELAPSED, TECHNIQUE, SETTINGS, ERROR, CLEAN];
    let about = "The Pareto front: nothing else had as little error as soon.";
    let rows: Vec<Cells> = subjects
        .iter()
        .flat_map(|subject| {
            let rows = on_front(rows_of(notebook, &subject.name));
            rows.into_iter().map(|row| copied(row, &columns)).collect::<Vec<_>>()
        })
        .collect();
    notebook.begin(Table::new(FRONT, "The least error for a time", about.into(), &columns));
    for cells in rows {
        let key = format!("{} after {}", shown(&cells, SCENE), shown(&cells, ELAPSED));
        notebook.derive(&key, cells)?;
    }
    Ok(())
}

/// Rows that no other was as good as as soon, by time. Compared by errors with the reference's noise, which all of a scene share: without it
/// those that cannot be told beside it are all the same.
fn on_front(mut rows: Vec<&Row>) -> Vec<&Row> {
    rows.sort_by(|a, b| {
        let by = |row: &Row| (number(row, ELAPSED), number(row, ERROR));
        by(a).0.total_cmp(&by(b).0).then(by(a).1.total_cmp(&by(b).1))
    });
    let mut least = f64::INFINITY;
    rows.retain(|row| {
        let is_better = number(row, ERROR) < least;
        least = least.min(number(row, ERROR));
        is_better
    });
    rows
}

/// Says so where errors of a scene cannot be told beside the noise of its reference.
///
/// - `least_percent`: that can
pub(super) fn tell_what_cannot_be_told(notebook: &mut Notebook, scene: &str, least_percent: f64) {
    // Both went through text on their way.
    let is_hidden = |row: &&Row| number(row, CLEAN) <= least_percent * (1.0 + 1e-6);
    let hidden = rows_of(notebook, scene).into_iter().filter(is_hidden).count();
    if hidden > 0 {
        notebook.note(format!(
            "{scene}: beside the noise of its reference no error below {least_percent:.2} % can be told. Rows that stand there as that \
             much, and may be less: {hidden}. A better reference, or a longer --time for one drawn here, tells them apart.",
        ));
    }
}

/// Says so where what a scene is compared with can hardly be a picture of it: nothing that was drawn came near, and what is left
/// is no noise. One that was drawn here is a picture of it, and too noisy to say more.
///
/// - `own_noise_percent`: of a reference that was drawn here
pub(super) fn doubt_reference(notebook: &mut Notebook, scene: &str, own_noise_percent: Option<f64>) {
    if let Some(percent) = least_in_common(&rows_of(notebook, scene)).filter(|least| *least > DOUBTED_PERCENT)
    {
        notebook.warn(match own_noise_percent {
            Some(noise) => format!(
                "{scene}: all pictures differ from the reference that was drawn here by {percent:.0} % or more. It has {noise:.0} % of noise \
                 itself, which hides what they are off by: a longer --time draws a better one."
            ),
            None => format!(
                "{scene}: all pictures differ from the reference by {percent:.0} % or more that no other seed would remove. Is it a \
                 picture of this scene, as it is now, from its first camera?"
            ),
        });
    }
}

/// The least systematic error of some rows, percent; `None` where that of one may be chance.
fn least_in_common(rows: &[&Row]) -> Option<f64> {
    let of = |row: &&Row| row.cells.get(SYSTEMATIC.key).and_then(Cell::value);
    rows.iter().map(of).try_fold(None, |least: Option<f64>, of| {
        let of = of?;
        Some(Some(least.map_or(of, |least| least.min(of))))
    })?
}

fn shown(cells: &Cells, column: Column) -> String {
    cells.get(column.key).unwrap_or(&Cell::Empty).shown()
}

/// Of every scene what each error costs, by the way that gets there first.
pub(super) fn prices(notebook: &mut Notebook, subjects: &[Subject]) -> Result<(), ReportError> {
    let columns = [SCENE, TARGET, TECHNIQUE, SETTINGS, SECONDS];
    let about = "What first had so little error, and when; empty where nothing had within the time. Between two looks times are \
                 interpolated along the curve; what is there at the first look may have been there before.";
    let mut all = Vec::new();
    for subject in subjects {
        let rows = rows_of(notebook, &subject.name);
        for target in TARGETS_PERCENT {
            let reached = first_below(&rows, target);
            let mut cells: Cells =
                reached.map(|(_, row)| copied(row, &[TECHNIQUE, SETTINGS])).unwrap_or_default();
            cells.extend([
                (SCENE.key.to_string(), Cell::from(subject.name.as_str())),
                (TARGET.key.to_string(), target.into()),
                (SECONDS.key.to_string(), reached.map(|(seconds, _)| seconds).into()),
            ]);
            all.push((format!("{} {target} %", subject.name), cells));
        }
    }
    notebook.begin(Table::new("prices", "What an error costs", about.into(), &columns));
    all.into_iter().try_for_each(|(key, cells)| notebook.derive(&key, cells))
}

/// When the first of some curves came down to an error, and the row where it had.
fn first_below<'a>(rows: &[&'a Row], target: f64) -> Option<(f64, &'a Row)> {
    let mut first: Option<(f64, &Row)> = None;
    for (index, row) in rows.iter().enumerate() {
        if number(row, CLEAN) > target {
            continue;
        }
        // The row before is of the same curve, or this is its first.
        let before = index.checked_sub(1).map(|before| rows[before]);
        let before = before.filter(|before| before.cells.get(CURVE) == row.cells.get(CURVE));
        let seconds = match before {
            Some(before) if number(before, CLEAN) > target => {
                let [x0, x1] = [before, row].map(|row| number(row, ELAPSED).ln());
                let [y0, y1] = [before, row].map(|row| number(row, CLEAN).max(1e-9).ln());
                (x0 + (x1 - x0) * (target.ln() - y0) / (y1 - y0)).exp()
            }
            // Below already: an earlier row says when.
            Some(_) => continue,
            None => number(row, ELAPSED),
        };
        if first.is_none_or(|(least, _)| seconds < least) {
            first = Some((seconds, row));
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(curve: &str, elapsed: f64, error: f64) -> Row {
        let cells = [(CURVE, Cell::from(curve)), (ELAPSED.key, elapsed.into()), (CLEAN.key, error.into())];
        Row { key: String::new(), cells: cells.map(|(key, cell)| (key.to_string(), cell)).into() }
    }

    /// Of rows that all stand at what can be told, those with less error are on the front, and only they.
    #[test]
    fn the_front_tells_errors_below_the_floor_apart() {
        let with = |elapsed: f64, error: f64| {
            let mut row = row("a", elapsed, 8.2);
            row.cells.insert(ERROR.key.into(), error.into());
            row
        };
        let rows = [with(0.526, 27.1), with(0.53, 23.6), with(1.0, 24.0), with(2.0, 23.5), with(4.0, 23.5)];
        let front = on_front(rows.iter().collect());
        let times: Vec<f64> = front.iter().map(|row| number(row, ELAPSED)).collect();
        assert_eq!(times, [0.526, 0.53, 2.0]);
    }

    /// A reference is doubted by what all pictures have in common that is not in it, and by nothing that may be chance.
    #[test]
    fn what_all_pictures_lack_is_least_of_all_rows() {
        let with = |systematic: Option<f64>| {
            let mut row = row("a", 1.0, 50.0);
            row.cells.insert(SYSTEMATIC.key.into(), systematic.into());
            row
        };
        let of = |all: &[Option<f64>]| {
            let rows: Vec<Row> = all.iter().map(|systematic| with(*systematic)).collect();
            least_in_common(&rows.iter().collect::<Vec<_>>())
        };
        assert_eq!(of(&[Some(45.0), Some(44.0), Some(60.0)]), Some(44.0));
        assert_eq!(of(&[Some(45.0), None]), None);
        assert_eq!(of(&[]), None);
    }

    /// A price is where a curve first comes down to the error, along the curve, and the least of all curves.
    #[test]
    fn prices_are_of_the_first_curve_to_get_there() {
        let rows = [
            row("a", 1.0, 40.0),
            row("a", 4.0, 10.0),
            row("a", 16.0, 2.5),
            row("b", 1.0, 16.0),
            row("b", 9.0, 15.0),
        ];
        let rows: Vec<&Row> = rows.iter().collect();
        let seconds = |target: f64| first_below(&rows, target).map(|(seconds, _)| seconds);
        assert_eq!(seconds(20.0), Some(1.0));
        assert!(seconds(5.0).is_some_and(|seconds| (seconds - 8.0).abs() < 1e-9), "{:?}", seconds(5.0));
        assert_eq!(seconds(1.0), None);
    }
}
