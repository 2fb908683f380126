//! Error over time, both axes logarithmic: Monte Carlo error falls as 1/√t, a straight line here. Own painter: a
//! hundred lines do what is needed, with decades as the grid.

use super::numbers;
use crate::model::history::{ErrorHistory, Point, Series};
use crate::theme;
use egui::{
    Align2, Color32, FontId, Painter, Pos2, Rect, Role, Sense, Shape, Stroke, Ui, Vec2, WidgetInfo, pos2,
};

const HEIGHT: f32 = 150.0;
/// Room for the labels of the axes.
const MARGIN: Vec2 = Vec2::new(34.0, 16.0);
/// Decades that an axis shows at least: a single point needs surroundings.
const DECADES_MIN: f64 = 1.0;

/// An axis: `[low, high]` as powers of ten.
type Decades = [f64; 2];

struct Axes {
    area: Rect,
    seconds: Decades,
    error: Decades,
}

impl Axes {
    fn at(&self, seconds: f64, error: f64) -> Pos2 {
        let place = |value: f64, [low, high]: Decades| ((value.log10() - low) / (high - low)) as f32;
        let x = self.area.left() + self.area.width() * place(seconds, self.seconds);
        let y = self.area.bottom() - self.area.height() * place(error.max(1e-12), self.error);
        pos2(x, y)
    }
}

/// Draws the curve of the picture now, the one before, and the target, if there is one. Both in fractions.
pub fn show(ui: &mut Ui, errors: &ErrorHistory, target: Option<f64>) {
    let (response, painter) = ui.allocate_painter(Vec2::new(ui.available_width(), HEIGHT), Sense::hover());
    let points = errors.now.points.len();
    response
        .widget_info(|| WidgetInfo::labeled(Role::Image, true, format!("error over time, {points} points")));
    painter.rect_filled(response.rect, 4.0, theme::SUNKEN);
    let all: Vec<Point> =
        errors.before.iter().chain([&errors.now]).flat_map(|s| s.points.iter().copied()).collect();
    if all.is_empty() {
        let text = "the error shows here once it has been measured";
        painter.text(
            response.rect.center(),
            Align2::CENTER_CENTER,
            text,
            FontId::proportional(11.0),
            theme::WEAK,
        );
        return;
    }
    let axes = axes_around(response.rect, &all, target);
    grid(&painter, &axes);
    let clipped = painter.with_clip_rect(axes.area);
    let is_inside = |target: &f64| (axes.error[0] - 1e-6..=axes.error[1] + 1e-6).contains(&target.log10());
    if let Some(target) = target.filter(is_inside) {
        let level =
            [axes.at(10f64.powf(axes.seconds[0]), target), axes.at(10f64.powf(axes.seconds[1]), target)];
        clipped.extend(Shape::dashed_line(&level, Stroke::new(1.0, theme::GOOD), 4.0, 4.0));
    }
    if let Some(before) = &errors.before {
        curve(&clipped, &axes, before, theme::WEAK.gamma_multiply(0.6));
    }
    interval(&clipped, &axes, &errors.now);
    curve(&clipped, &axes, &errors.now, theme::ACCENT);
    if let Some(pointer) = response.hover_pos() {
        tell_nearest(ui, &clipped, &axes, &errors.now, pointer);
    }
}

fn axes_around(rect: Rect, points: &[Point], target: Option<f64>) -> Axes {
    let decades = |values: &mut dyn Iterator<Item = f64>| -> Decades {
        let (low, high) =
            values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        // 0.01 as f32 lies a hair below 0.01: that is not another decade.
        let (low, high) = (low.max(1e-9).log10() + 1e-6, high.clamp(1e-9, 1e12).log10() - 1e-6);
        let (low, high) = (low.floor(), high.ceil());
        [low, high.max(low + DECADES_MIN)]
    };
    // The target belongs into the picture when it is near: a goal far below would press the curve to the ceiling.
    let smallest = points.iter().map(|point| f64::from(point.error)).fold(f64::MAX, f64::min);
    let goal = target.filter(|target| *target > smallest * 0.03);
    Axes {
        area: Rect::from_min_max(rect.min + Vec2::new(MARGIN.x, 6.0), rect.max - Vec2::new(8.0, MARGIN.y)),
        seconds: decades(&mut points.iter().map(|point| point.seconds)),
        error: decades(&mut points.iter().map(|point| f64::from(point.error)).chain(goal)),
    }
}

fn grid(painter: &Painter, axes: &Axes) {
    let font = FontId::proportional(9.5);
    let line = |position: f64| {
        let whole = (position - position.round()).abs() < 1e-6;
        Stroke::new(1.0, if whole { theme::EDGE } else { theme::EDGE.gamma_multiply(0.35) })
    };
    for [decade, factor] in steps(axes.seconds) {
        let x = axes.at(10f64.powf(decade) * factor, 1.0).x;
        painter.vline(x, axes.area.y_range(), line(factor.log10()));
        if factor == 1.0 {
            let text = seconds_label(decade);
            // The outer labels stay inside the plot.
            let align = match decade {
                d if d == axes.seconds[0] => Align2::LEFT_TOP,
                d if d == axes.seconds[1] => Align2::RIGHT_TOP,
                _ => Align2::CENTER_TOP,
            };
            painter.text(pos2(x, axes.area.bottom() + 2.0), align, text, font.clone(), theme::WEAK);
        }
    }
    for [decade, factor] in steps(axes.error) {
        let y = axes.at(1.0, 10f64.powf(decade) * factor).y;
        painter.hline(axes.area.x_range(), y, line(factor.log10()));
        if factor == 1.0 {
            let text = format!("{} %", 10f64.powf(decade + 2.0));
            painter.text(
                pos2(axes.area.left() - 3.0, y),
                Align2::RIGHT_CENTER,
                text,
                font.clone(),
                theme::WEAK,
            );
        }
    }
}

/// Decades of an axis with the 2 and 5 between, as `[decade, factor]`.
fn steps([low, high]: Decades) -> impl Iterator<Item = [f64; 2]> {
    // An axis has at most the 21 decades that `axes_around` lets through.
    (low as i32..=high as i32).flat_map(move |decade| {
        let decade = f64::from(decade);
        let inner = if decade < high { &[1.0, 2.0, 5.0][..] } else { &[1.0][..] };
        inner.iter().map(move |factor| [decade, *factor])
    })
}

fn seconds_label(decade: f64) -> String {
    let seconds = 10f64.powf(decade);
    if decade < 0.0 { format!("{:.0} ms", seconds * 1e3) } else { format!("{seconds:.0} s") }
}

fn curve(painter: &Painter, axes: &Axes, series: &Series, colour: Color32) {
    let line: Vec<Pos2> = series.points.iter().map(|p| axes.at(p.seconds, f64::from(p.error))).collect();
    if let [only] = line.as_slice() {
        painter.circle_filled(*only, 2.0, colour);
    }
    painter.add(Shape::line(line, Stroke::new(1.6, colour)));
}

/// The 95 % interval as a band: one quadrilateral between each two points.
fn interval(painter: &Painter, axes: &Axes, series: &Series) {
    let edge = |point: &Point| {
        let [low, high] = point.error_ci?.map(|bound| axes.at(point.seconds, f64::from(bound)));
        Some([low, high])
    };
    for pair in series.points.windows(2) {
        let (Some([a_low, a_high]), Some([b_low, b_high])) = (edge(&pair[0]), edge(&pair[1])) else {
            continue;
        };
        let band = vec![a_low, a_high, b_high, b_low];
        painter.add(Shape::convex_polygon(band, theme::ACCENT.gamma_multiply(0.16), Stroke::NONE));
    }
}

fn tell_nearest(ui: &Ui, painter: &Painter, axes: &Axes, series: &Series, pointer: Pos2) {
    let distance = |point: &Point| (axes.at(point.seconds, f64::from(point.error)).x - pointer.x).abs();
    let Some(point) = series.points.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { return };
    let at = axes.at(point.seconds, f64::from(point.error));
    painter.circle_filled(at, 3.0, theme::ACCENT);
    let text = format!("{} after {}", numbers::percent(point.error.into()), numbers::duration(point.seconds));
    let (x, anchor) = if at.x > axes.area.center().x {
        (at.x - 6.0, Align2::RIGHT_BOTTOM)
    } else {
        (at.x + 6.0, Align2::LEFT_BOTTOM)
    };
    let y = (at.y - 4.0).max(axes.area.top() + 14.0);
    painter.text(pos2(x, y), anchor, text, FontId::proportional(11.0), ui.visuals().strong_text_color());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(seconds: f64, error: f32) -> Point {
        Point { seconds, error, error_ci: None }
    }

    #[test]
    fn every_point_lies_inside_the_axes_and_falling_error_goes_down() {
        let points = [point(0.013, 1.7), point(0.5, 0.3), point(77.0, 0.021)];
        let rect = Rect::from_min_size(Pos2::ZERO, Vec2::new(300.0, HEIGHT));
        let axes = axes_around(rect, &points, Some(0.01));
        let mut before = Pos2::ZERO;
        for point in points {
            let at = axes.at(point.seconds, f64::from(point.error));
            assert!(axes.area.contains(at), "{at:?}");
            assert!(at.x > before.x && at.y > before.y);
            before = at;
        }
        assert!(axes.error[0] <= -2.0, "the target of 1 % is near and belongs in");
    }

    #[test]
    fn a_single_or_absurd_point_gives_finite_axes() {
        let rect = Rect::from_min_size(Pos2::ZERO, Vec2::new(300.0, HEIGHT));
        for odd in [point(1.0, 1.0), point(1e-300, 1e-38), point(1e300, f32::MAX)] {
            let axes = axes_around(rect, &[odd], Some(0.01));
            for axis in [axes.seconds, axes.error] {
                assert!(axis[1] > axis[0] && steps(axis).count() < 100, "{axis:?}");
            }
            let at = axes.at(odd.seconds, f64::from(odd.error));
            assert!(at.x.is_finite() && at.y.is_finite());
        }
    }
}
