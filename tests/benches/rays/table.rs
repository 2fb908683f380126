//! The table of one subject, as Markdown that a README can take.

/// One figure.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Cell {
    #[default]
    Empty,
    /// A value and how many decimals to show.
    Number(f64, usize),
}

impl Cell {
    pub(crate) fn number(value: Option<f64>, decimals: usize) -> Cell {
        value.map_or(Cell::Empty, |value| Cell::Number(value, decimals))
    }

    pub(crate) fn ratio(value: f64) -> Cell {
        Cell::Number(value, 2)
    }

    fn text(self) -> String {
        match self {
            Cell::Empty => "–".into(),
            Cell::Number(value, decimals) => format!("{value:.decimals$}"),
        }
    }
}

/// One kind of ray or one property; pairs are with one and with two threads.
#[derive(Clone, Debug, Default)]
pub(crate) struct Row {
    pub(crate) label: String,
    pub(crate) ours: [Cell; 2],
    /// How many times faster two threads are than one.
    pub(crate) scaling: Cell,
    pub(crate) obvhs: Cell,
    pub(crate) embree_1: [Cell; 2],
    pub(crate) embree_8: [Cell; 2],
    /// How many times better ours is.
    pub(crate) to_embree_1: [Cell; 2],
    pub(crate) to_embree_8: [Cell; 2],
}

/// A row's name: the parts that say something.
pub(crate) fn label(what: &str, tree: &str, variant: &str) -> String {
    let parts: Vec<&str> = [what, tree, variant].into_iter().filter(|part| !part.is_empty()).collect();
    parts.join(", ")
}

/// Rows that line up.
#[derive(Default)]
pub(crate) struct Table {
    rows: Vec<Row>,
}

const HEAD: [&str; 11] = [
    "",
    "ours 1T",
    "ours 2T",
    "×threads",
    "obvhs 1T",
    "Embree-1 1T",
    "Embree-1 2T",
    "Embree-8 1T",
    "Embree-8 2T",
    "ours/Embree-1",
    "ours/Embree-8",
];

impl Table {
    pub(crate) fn push(&mut self, row: Row) {
        self.rows.push(row);
    }

    pub(crate) fn print(&self) {
        let rows: Vec<Vec<String>> = self.rows.iter().map(Row::texts).collect();
        print_markdown(&HEAD, &rows);
    }
}

impl Row {
    fn texts(&self) -> Vec<String> {
        let pair = |cells: [Cell; 2]| match cells {
            [Cell::Empty, Cell::Empty] => Cell::Empty.text(),
            [one, Cell::Empty] => one.text(),
            [one, two] => format!("{} / {}", one.text(), two.text()),
        };
        let mut texts = vec![self.label.clone()];
        let single =
            [self.ours.as_slice(), &[self.scaling, self.obvhs], &self.embree_1, &self.embree_8].concat();
        texts.extend(single.into_iter().map(Cell::text));
        texts.extend([self.to_embree_1, self.to_embree_8].map(pair));
        texts
    }
}

/// Prints a table whose first column is text and whose others are numbers, padded so that it reads as it is, too.
pub(crate) fn print_markdown(head: &[&str], rows: &[Vec<String>]) {
    let width = |column: usize| {
        let texts = rows.iter().filter_map(|row| row.get(column)).map(|text| text.chars().count());
        texts.chain([head[column].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |texts: Vec<String>| {
        let padded = texts.iter().zip(&widths).enumerate().map(|(column, (text, width))| match column {
            0 => format!(" {text:<width$} |"),
            _ => format!(" {text:>width$} |"),
        });
        println!("|{}", padded.collect::<String>());
    };
    line(head.iter().map(ToString::to_string).collect());
    let rule = |(column, width): (usize, &usize)| match column {
        0 => "-".repeat(*width),
        _ => format!("{}:", "-".repeat(width - 1)),
    };
    line(widths.iter().enumerate().map(rule).collect());
    rows.iter().cloned().for_each(line);
}
