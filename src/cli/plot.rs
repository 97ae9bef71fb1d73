//! Plots as SVG: panels one above the other, with the frame number, or whatever else counts, along the bottom. A few
//! values far above all others, as the first frame of a flight has, are cut off and named, so that the others can be read.

use std::fmt::Write;

/// One curve over its own axis.
pub(super) struct Panel<'a> {
    /// What is shown, with its unit.
    pub(super) label: &'a str,
    /// A value a step; what is not finite leaves a gap.
    pub(super) values: &'a [f64],
}

const WIDTH: f64 = 960.0;
const PANEL_HEIGHT: f64 = 120.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 44.0;
const GAP: f64 = 34.0;
/// Values more than so many times the 98th percentile are cut off.
const FAR_ABOVE: f64 = 2.0;
/// How many of them are named.
const NAMED: usize = 3;

/// The panels as one SVG document.
pub(super) fn panels_svg(title: &str, along: &str, panels: &[Panel<'_>]) -> String {
    let height = TOP + panels.len() as f64 * (PANEL_HEIGHT + GAP) + 10.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n<text x=\"{LEFT}\" y=\"20\" \
         font-size=\"15\">{}</text>\n",
        escaped(title)
    );
    for (n, panel) in panels.iter().enumerate() {
        panel.draw(&mut svg, TOP + n as f64 * (PANEL_HEIGHT + GAP), along);
    }
    svg + "</svg>\n"
}

impl Panel<'_> {
    fn draw(&self, svg: &mut String, top: f64, along: &str) {
        let (right, bottom) = (WIDTH - RIGHT, top + PANEL_HEIGHT);
        let Axis { low, high } = self.axis();
        let scale = if high > low { PANEL_HEIGHT / (high - low) } else { 0.0 };
        let last = self.values.len().max(2) - 1;
        let mut add = |text: std::fmt::Arguments<'_>| {
            // Writing to a string does not fail.
            let _ = writeln!(svg, "{text}");
        };
        let label = escaped(self.label) + &self.cut_off(high, along);
        add(format_args!("<text x=\"{LEFT}\" y=\"{:.1}\">{label}</text>", top - 5.0));
        add(format_args!("<path d=\"M{LEFT} {top:.1}V{bottom:.1}H{right:.1}\" fill=\"none\" stroke=\"#888\"/>"));
        let end = LEFT - 6.0;
        add(format_args!("<text x=\"{end}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", top + 10.0, short(high)));
        add(format_args!("<text x=\"{end}\" y=\"{bottom:.1}\" text-anchor=\"end\">{}</text>", short(low)));
        add(format_args!(
            "<text x=\"{right:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#666\">{} 0 to {last}</text>",
            bottom + 14.0,
            escaped(along)
        ));
        let (mut path, mut pen_down) = (String::new(), false);
        for (n, value) in self.values.iter().enumerate() {
            if value.is_finite() {
                let x = LEFT + (right - LEFT) * n as f64 / last as f64;
                let command = if pen_down { 'L' } else { 'M' };
                let _ = write!(path, "{command}{x:.1} {:.1}", bottom - (value.min(high) - low) * scale);
            }
            pen_down = value.is_finite();
        }
        add(format_args!("<path d=\"{path}\" fill=\"none\" stroke=\"#06c\"/>"));
    }

    /// From 0, or from the least value where all are in the upper half, to the greatest value that is not far above
    /// nearly all others.
    fn axis(&self) -> Axis {
        let mut values: Vec<f64> = self.values.iter().copied().filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let (Some(&least), Some(&usual)) = (values.first(), values.get(values.len() * 98 / 100)) else {
            return Axis { low: 0.0, high: 0.0 };
        };
        let far = if usual > 0.0 { usual * FAR_ABOVE } else { f64::INFINITY };
        let high = values.iter().rev().copied().find(|&v| v <= far).unwrap_or(usual);
        Axis { low: if least > 0.5 * high { least } else { least.min(0.0) }, high }
    }

    /// Which values are above the axis.
    fn cut_off(&self, high: f64, along: &str) -> String {
        let above: Vec<_> = self.values.iter().enumerate().filter(|(_, v)| v.is_finite() && **v > high).collect();
        let named = above.iter().take(NAMED).map(|(n, value)| format!("; {} {n}: {}", escaped(along), short(**value)));
        let more =
            if above.len() > NAMED { format!("; and {} more above", above.len() - NAMED) } else { String::new() };
        named.collect::<String>() + &more
    }
}

/// The least and the greatest value of a panel's axis.
struct Axis {
    low: f64,
    high: f64,
}

/// A number of about three figures.
fn short(value: f64) -> String {
    match value {
        v if v >= 100.0 || v == 0.0 => format!("{v:.0}"),
        v if v >= 1.0 => format!("{v:.1}"),
        v => format!("{v:.3}"),
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_far_above_the_others_is_cut_off_and_named() {
        let mut values = [3.0; 100];
        (values[0], values[50]) = (5000.0, 4.0);
        let panel = Panel { label: "splits", values: &values };
        let svg = panels_svg("", "frame", &[panel]);
        assert!(svg.contains(">splits; frame 0: 5000<") && svg.contains(">4.0<") && svg.contains(">3.0<"), "{svg}");
        values[0] = 3.5;
        let svg = panels_svg("", "frame", &[Panel { label: "splits", values: &values }]);
        assert!(svg.contains(">splits<"), "{svg}");
    }

    #[test]
    fn values_that_are_not_finite_leave_gaps() {
        let values = [1.0, f64::INFINITY, 0.5, 2.0];
        let svg = panels_svg("a < b", "frame", &[Panel { label: "bound, px", values: &values }]);
        assert!(svg.contains("a &lt; b") && !svg.contains("inf") && !svg.contains("NaN"));
        let curve = svg.lines().find(|line| line.contains("#06c")).expect("a curve");
        assert_eq!((curve.matches('M').count(), curve.matches('L').count()), (2, 1));
        assert!(panels_svg("", "", &[Panel { label: "", values: &[] }]).ends_with("</svg>\n"));
    }
}
