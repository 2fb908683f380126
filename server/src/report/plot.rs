//! Plots as inline SVG.
//!
//! The SVG writer puts text down as text, so no font is needed where a report is made.

use plotters::{
    coord::{
        ranged1d::{AsRangedCoord, Ranged, ValueFormatter},
        types::RangedCoordf64,
    },
    prelude::{
        Cartesian2d, ChartBuilder, ChartContext, Circle, IntoDrawingArea, IntoLogRange, LineSeries, LogCoord,
        RGBColor, SVGBackend, ShapeStyle, WHITE,
    },
};

use super::ReportError;

/// Picture size, CSS pixels.
const SIZE: (u32, u32) = (720, 420);
/// Factor from one end of an axis to the other from which on powers of ten label it.
const DECADES_FROM: f64 = 100.0;

/// Colours that people who see few colours can tell apart [Okabe, Ito 2008].
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
];

/// A curve.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    /// Name in the legend.
    pub(super) name: String,
    /// `[n]`, x and y; y above 0.
    pub(super) points: Vec<(f64, f64)>,
    /// Measured by the paper: drawn thin and with hollow points.
    pub(super) by_paper: bool,
    /// Curves of one colour belong together.
    pub(super) colour: usize,
}

/// How x goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axis {
    /// In equal steps.
    Linear,
    /// In equal factors.
    Logarithmic,
}

/// Curves over one axis; y is logarithmic, since machines twenty years apart share it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plot {
    /// What it shows.
    pub(super) title: String,
    /// Name and unit of x.
    pub(super) x: &'static str,
    /// Name and unit of y.
    pub(super) y: &'static str,
    /// How x goes.
    pub(super) x_axis: Axis,
    /// The curves.
    pub(super) curves: Vec<Curve>,
}

impl Plot {
    /// Names and colours of the curves as HTML, to stand below the plot, where it hides no curve.
    pub(super) fn legend(&self) -> String {
        let entries = self.curves.iter().map(|curve| {
            let RGBColor(r, g, b) = COLOURS[curve.colour % COLOURS.len()];
            let mark = if curve.by_paper { "─○─" } else { "━●━" };
            let name = curve.name.replace('&', "&amp;").replace('<', "&lt;");
            format!("<span style=\"color:#{r:02x}{g:02x}{b:02x}\">{mark}</span> {name} ")
        });
        entries.collect()
    }

    /// The plot as an SVG element; `None` when there is nothing to show.
    pub(super) fn svg(&self) -> Result<Option<String>, ReportError> {
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let Some([x, y]) = bounds(points().copied()) else { return Ok(None) };
        let mut text = String::new();
        let drawn = match self.x_axis {
            Axis::Linear => {
                // A single place is in the middle of labels.
                let room = if x[1] > x[0] { 0.05 * (x[1] - x[0]) } else { 0.5 * x[0].abs().max(1e-6) };
                let x: RangedCoordf64 = (x[0] - room..x[1] + room).into();
                self.draw(&mut text, x, by_factors(y, 1.5))
            }
            Axis::Logarithmic => self.draw(&mut text, by_factors(x, 1.2), by_factors(y, 1.5)),
        };
        drawn.map_err(|reason| ReportError::Text { what: "a plot", reason })?;
        // Inside HTML an SVG needs no name of its own; without it the page holds no address at all.
        Ok(Some(text.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "")))
    }

    /// Draws on axes of either kind.
    fn draw<X, Y>(&self, text: &mut String, x: X, y: Y) -> Result<(), String>
    where
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: ValueFormatter<f64> + Ranged<ValueType = f64>,
        Y::CoordDescType: ValueFormatter<f64> + Ranged<ValueType = f64>,
    {
        let area = SVGBackend::with_string(text, SIZE).into_drawing_area();
        let fail = |error: String| error;
        // As many as there are values: depths and counts are whole numbers.
        let mut places: Vec<f64> =
            self.curves.iter().flat_map(|curve| &curve.points).map(|(x, _)| *x).collect();
        places.sort_by(f64::total_cmp);
        places.dedup();
        let x_labels = places.len().clamp(3, 10);
        area.fill(&WHITE).map_err(|error| fail(error.to_string()))?;
        let mut chart = ChartBuilder::on(&area)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(x, y)
            .map_err(|error| fail(error.to_string()))?;
        chart
            .configure_mesh()
            .x_labels(x_labels)
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .x_desc(self.x)
            .y_desc(self.y)
            .x_label_formatter(&|value| short(*value))
            .y_label_formatter(&|value| short(*value))
            .light_line_style(RGBColor(240, 240, 240))
            .draw()
            .map_err(|error| fail(error.to_string()))?;
        for curve in &self.curves {
            add(&mut chart, curve).map_err(fail)?;
        }
        area.present().map_err(|error| fail(error.to_string()))
    }
}

type Chart<'a, 'b, X, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>;

fn add<X, Y>(chart: &mut Chart<'_, '_, X, Y>, curve: &Curve) -> Result<(), String>
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    let colour = COLOURS[curve.colour % COLOURS.len()];
    let width = if curve.by_paper { 1 } else { 3 };
    let line = ShapeStyle { color: colour.into(), filled: false, stroke_width: width };
    let point = ShapeStyle { color: colour.into(), filled: !curve.by_paper, stroke_width: 1 };
    chart
        .draw_series(LineSeries::new(curve.points.iter().copied(), line))
        .map_err(|error| error.to_string())?;
    chart
        .draw_series(curve.points.iter().map(|at| Circle::new(*at, 4, point)))
        .map_err(|error| error.to_string())?;
    Ok(())
}

/// An axis in equal factors, with room at either end, and labels at powers of two where few of ten lie on it: it has none but at powers.
///
/// - `room`: a factor; more around points that are all alike, so that two labels stand there
fn by_factors([least, most]: [f64; 2], room: f64) -> LogCoord<f64> {
    let room = if most / least < 2.0 { room.max(2.0) } else { room };
    let range = least / room..most * room;
    let base = if range.end / range.start < DECADES_FROM { 2.0 } else { 10.0 };
    range.log_scale().base(base).into()
}

/// Least and most of x and y.
fn bounds(points: impl Iterator<Item = (f64, f64)>) -> Option<[[f64; 2]; 2]> {
    points.fold(None, |bounds, (x, y)| {
        let [[x0, x1], [y0, y1]] = bounds.unwrap_or([[x, x], [y, y]]);
        Some([[x0.min(x), x1.max(x)], [y0.min(y), y1.max(y)]])
    })
}

/// A label as short as it can be: no zeros at its end, thousands as k and M.
fn short(value: f64) -> String {
    let (value, unit) = match value.abs() {
        size if size >= 1e6 => (value / 1e6, "M"),
        size if size >= 1e4 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let text = format!("{value:.4}");
    format!("{}{unit}", text.trim_end_matches('0').trim_end_matches('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plot is one SVG element with its words as text and no address of anything; nothing gives no plot.
    #[test]
    fn plots_are_svg_with_text() {
        let curve = |by_paper| Curve {
            name: "boxes & more".into(),
            points: vec![(4.0, 0.1), (5.0, 1.0), (6.0, 30.0)],
            by_paper,
            colour: 0,
        };
        for x_axis in [Axis::Linear, Axis::Logarithmic] {
            let curves = vec![curve(false), curve(true)];
            let plot = Plot { title: "Title".into(), x: "depth", y: "seconds", x_axis, curves };
            let svg = plot.svg().unwrap().unwrap();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
            assert!(!svg.contains("http"), "{svg}");
            assert!(svg.contains("<text") && svg.contains("seconds"), "{svg}");
            assert!(plot.legend().contains("boxes &amp; more"), "{}", plot.legend());
        }
        let empty = Plot { title: "".into(), x: "", y: "", x_axis: Axis::Linear, curves: Vec::new() };
        assert_eq!(empty.svg().unwrap(), None);
    }

    /// However few points there are and wherever they lie, both axes are labelled with more than one number.
    #[test]
    fn axes_are_labelled_whatever_is_on_them() {
        for value in [0.003, 0.07, 0.99, 1.0, 1.01, 3.0, 5.3, 9.99, 47.0, 616_000.0] {
            for x_axis in [Axis::Linear, Axis::Logarithmic] {
                for points in [vec![(value, value)], vec![(value, value), (1.9 * value, 2.1 * value)]] {
                    let curve = Curve { name: "a".into(), points, by_paper: false, colour: 0 };
                    let plot = Plot { title: "t".into(), x: "x", y: "y", x_axis, curves: vec![curve] };
                    let svg = plot.svg().unwrap().unwrap();
                    let words = svg.split("<text").skip(1).filter_map(|text| text.split(['>', '<']).nth(1));
                    let labels =
                        words.filter(|word| word.trim().starts_with(|c: char| c.is_ascii_digit())).count();
                    assert!(labels >= 4, "{labels} labels at {value}, {x_axis:?}: {svg}");
                }
            }
        }
    }

    /// Labels have no more digits than they need.
    #[test]
    fn labels_are_short() {
        for (value, text) in [(0.05, "0.05"), (3.0, "3"), (1000.0, "1000"), (250_000.0, "250k"), (2e6, "2M")]
        {
            assert_eq!(short(value), text);
        }
    }
}
