//! A figure as SVG: curves over linear or logarithmic axes, told apart by colour, mark and legend.

use std::fmt::Write;

use super::html::{escaped, short};
use crate::evaluate::trade::document::{Axis, Figure, Series};

const WIDTH: f64 = 560.0;
const PLOT_HEIGHT: f64 = 260.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 26.0;
const TOP: f64 = 34.0;
/// Below the plot: numbers and the name of the axis.
const BOTTOM: f64 = 44.0;
const LEGEND_ROW: f64 = 17.0;
const LEGEND_COLUMNS: usize = 2;
const LEGEND_LEFT: f64 = 16.0;
const MARK: f64 = 3.6;

/// Colours that the colour-blind tell apart (after Tol, "Colour schemes", 2021, "bright"), visible on white and on black.
/// This project's own curves have the colour of the text.
const COLOURS: [&str; 8] = ["#4477aa", "#ee6677", "#228833", "#ccbb44", "#56b4d9", "#aa3377", "#888888", "#e08030"];

/// The range of an axis.
struct Range {
    low: f64,
    high: f64,
    is_log: bool,
}

impl Range {
    /// What holds all values; round numbers at both ends.
    fn of(values: impl Iterator<Item = f64>, axis: &Axis) -> Self {
        let usable = values.filter(|v| v.is_finite() && (!axis.is_log || *v > 0.0));
        let [low, high] = usable.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]);
        let is_log = axis.is_log;
        if low > high {
            return Self { low: 0.1, high: 1.0, is_log };
        }
        if is_log {
            let (low, high) = (round_down(low), round_up(high));
            return Self { low, high: if high > low { high } else { low * 10.0 }, is_log };
        }
        let step = step(high.max(1e-12));
        Self { low: 0.0, high: (high / step).ceil().max(1.0) * step, is_log }
    }

    /// Where a value lies, from 0 to 1; nothing where it has no place.
    fn place(&self, value: f64) -> Option<f64> {
        if !value.is_finite() || (self.is_log && value <= 0.0) {
            return None;
        }
        let share = if self.is_log {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        Some(share.clamp(0.0, 1.0))
    }

    /// The values that are named.
    fn ticks(&self) -> Vec<f64> {
        if !self.is_log {
            let step = step(self.high);
            return (0..).map(|n| f64::from(n) * step).take_while(|v| *v <= self.high * 1.001).collect();
        }
        let decades = (self.high / self.low).log10();
        let parts: &[f64] = if decades > 3.5 { &[1.0] } else { &[1.0, 3.0] };
        let first = self.low.log10().floor() as i32;
        let all = (first..first + 20).flat_map(|n| parts.iter().map(move |part| part * 10_f64.powi(n)));
        all.filter(|v| (self.low * 0.999..=self.high * 1.001).contains(v)).collect()
    }
}

/// The greatest of 1 and 3 times a power of ten that is not above a value.
fn round_down(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    if value >= 3.0 * decade { 3.0 * decade } else { decade }
}

/// The least of 1 and 3 times a power of ten that is not below a value.
fn round_up(value: f64) -> f64 {
    let down = round_down(value);
    let decade = 10_f64.powf(down.log10().floor());
    match value {
        v if v <= down => down,
        v if v <= 3.0 * decade => 3.0 * decade,
        _ => 10.0 * decade,
    }
}

/// A round step that cuts 0 to `high` into five or so.
fn step(high: f64) -> f64 {
    let decade = 10_f64.powf((high / 5.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|part| part * decade).find(|step| high / step <= 6.0).unwrap_or(decade * 10.0)
}

/// A figure as an SVG element that stands within a page.
pub(super) fn element(figure: &Figure) -> String {
    let rows = figure.series.len().div_ceil(LEGEND_COLUMNS) as f64;
    let height = TOP + PLOT_HEIGHT + BOTTOM + rows * LEGEND_ROW + 6.0;
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{0}\"><title>{0}</title>\n\
         <text x=\"{LEGEND_LEFT}\" y=\"18\" class=\"title\">{0}</text>\n",
        escaped(&figure.title)
    );
    let points = || figure.series.iter().flat_map(|series| &series.points);
    let across = Range::of(points().map(|p| p[0]), &figure.across);
    let up = Range::of(points().map(|p| p[1]), &figure.up);
    axes(&mut svg, figure, &across, &up);
    for (n, series) in figure.series.iter().enumerate() {
        // Of this project's own curves, the last is drawn through.
        let is_dashed = series.is_own && figure.series[n + 1..].iter().any(|later| later.is_own);
        let style = Style::of(n, series.is_own, is_dashed);
        curve(&mut svg, series, &style, figure.is_joined, [&across, &up]);
        legend(&mut svg, series, &style, n);
    }
    svg + "</svg>\n"
}

/// Writing to a string does not fail.
macro_rules! put {
    ($svg:expr, $($text:tt)*) => { { let _ = writeln!($svg, $($text)*); } };
}

fn axes(svg: &mut String, figure: &Figure, across: &Range, up: &Range) {
    let (right, bottom) = (WIDTH - RIGHT, TOP + PLOT_HEIGHT);
    for value in up.ticks() {
        let y = bottom - up.place(value).unwrap_or(0.0) * PLOT_HEIGHT;
        put!(svg, "<path d=\"M{LEFT} {y:.1}H{right}\" class=\"grid\"/>");
        put!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" class=\"end\">{}</text>", LEFT - 6.0, y + 4.0, short(value));
    }
    for value in across.ticks() {
        let x = LEFT + across.place(value).unwrap_or(0.0) * (right - LEFT);
        put!(svg, "<path d=\"M{x:.1} {TOP}V{bottom}\" class=\"grid\"/>");
        put!(svg, "<text x=\"{x:.1}\" y=\"{:.1}\" class=\"middle\">{}</text>", bottom + 15.0, short(value));
    }
    put!(svg, "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" class=\"axis\"/>");
    let (x, y) = ((LEFT + right) / 2.0, bottom + 33.0);
    put!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" class=\"middle\">{}</text>", escaped(figure.across.label));
    let y = TOP + PLOT_HEIGHT / 2.0;
    put!(svg, "<text transform=\"translate(14 {y}) rotate(-90)\" class=\"middle\">{}</text>", escaped(figure.up.label));
}

/// How a curve is drawn.
struct Style {
    colour: &'static str,
    width: f64,
    dash: &'static str,
    mark: usize,
}

impl Style {
    fn of(n: usize, is_own: bool, is_dashed: bool) -> Self {
        let dash = if is_dashed { "5 3" } else { "none" };
        let colour = if is_own { "currentColor" } else { COLOURS[n % COLOURS.len()] };
        Self { colour, width: if is_own { 2.2 } else { 1.5 }, dash, mark: n % 4 }
    }

    /// A mark at a place.
    fn draw(&self, svg: &mut String, x: f64, y: f64) {
        let (colour, m) = (self.colour, MARK);
        match self.mark {
            0 => put!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{m}\" fill=\"{colour}\"/>"),
            1 => {
                let (left, top, side) = (x - m, y - m, 2.0 * m);
                put!(
                    svg,
                    "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{side}\" height=\"{side}\" fill=\"{colour}\"/>"
                );
            }
            2 => put!(svg, "<path d=\"M{x:.1} {:.1}l{m} {}h-{}z\" fill=\"{colour}\"/>", y - m, 1.8 * m, 2.0 * m),
            _ => put!(svg, "<path d=\"M{x:.1} {:.1}l{m} {m}l-{m} {m}l-{m} -{m}z\" fill=\"{colour}\"/>", y - m),
        }
    }
}

fn curve(svg: &mut String, series: &Series, style: &Style, is_joined: bool, [across, up]: [&Range; 2]) {
    let (right, bottom) = (WIDTH - RIGHT, TOP + PLOT_HEIGHT);
    let place = |p: &[f64; 2]| {
        let (x, y) = (across.place(p[0])?, up.place(p[1])?);
        Some((LEFT + x * (right - LEFT), bottom - y * PLOT_HEIGHT))
    };
    let placed: Vec<_> = series.points.iter().filter_map(place).collect();
    let path: Vec<_> = placed.iter().map(|(x, y)| format!("{x:.1} {y:.1}")).collect();
    if is_joined && path.len() > 1 {
        put!(
            svg,
            "<path d=\"M{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-dasharray=\"{}\"/>",
            path.join("L"),
            style.colour,
            style.width,
            style.dash
        );
    }
    for (x, y) in placed {
        style.draw(svg, x, y);
    }
}

fn legend(svg: &mut String, series: &Series, style: &Style, n: usize) {
    let (column, row) = ((n % LEGEND_COLUMNS) as f64, (n / LEGEND_COLUMNS) as f64);
    let x = LEGEND_LEFT + column * (WIDTH - LEGEND_LEFT) / LEGEND_COLUMNS as f64;
    let y = TOP + PLOT_HEIGHT + BOTTOM + row * LEGEND_ROW + 6.0;
    put!(
        svg,
        "<path d=\"M{x:.1} {y:.1}h22\" stroke=\"{}\" stroke-width=\"{}\" stroke-dasharray=\"{}\"/>",
        style.colour,
        style.width,
        style.dash
    );
    style.draw(svg, x + 11.0, y);
    put!(svg, "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>", x + 28.0, y + 4.0, escaped(&series.name));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_axes_end_at_round_numbers_and_leave_out_what_has_no_place() {
        let axis = Axis { label: "m", is_log: true };
        let range = Range::of([0.0, 0.02, 250.0, f64::INFINITY].into_iter(), &axis);
        assert!((range.low - 0.01).abs() < 1e-12 && (range.high - 300.0).abs() < 1e-9, "{} {}", range.low, range.high);
        assert_eq!(range.place(0.0), None);
        assert_eq!(range.place(f64::INFINITY), None);
        assert!(range.place(range.high).is_some_and(|p| (p - 1.0).abs() < 1e-12));
        let linear = Range::of([3.0, 37.0].into_iter(), &Axis { label: "%", is_log: false });
        assert_eq!((linear.low, linear.high, linear.ticks().len()), (0.0, 40.0, 5));
    }
}
