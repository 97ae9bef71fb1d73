//! Plots as SVG: panels one above the other, with the frame number, or whatever else counts, along the bottom.

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
        let greatest = self.values.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
        let scale = if greatest > 0.0 { PANEL_HEIGHT / greatest } else { 0.0 };
        let last = self.values.len().max(2) - 1;
        let mut add = |text: std::fmt::Arguments<'_>| {
            // Writing to a string does not fail.
            let _ = writeln!(svg, "{text}");
        };
        add(format_args!("<text x=\"{LEFT}\" y=\"{:.1}\">{}</text>", top - 5.0, escaped(self.label)));
        add(format_args!("<path d=\"M{LEFT} {top:.1}V{bottom:.1}H{right:.1}\" fill=\"none\" stroke=\"#888\"/>"));
        let end = LEFT - 6.0;
        add(format_args!("<text x=\"{end}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>", top + 10.0, short(greatest)));
        add(format_args!("<text x=\"{end}\" y=\"{bottom:.1}\" text-anchor=\"end\">0</text>"));
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
                let _ = write!(path, "{command}{x:.1} {:.1}", bottom - value * scale);
            }
            pen_down = value.is_finite();
        }
        add(format_args!("<path d=\"{path}\" fill=\"none\" stroke=\"#06c\"/>"));
    }
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
    fn values_that_are_not_finite_leave_gaps() {
        let values = [1.0, f64::INFINITY, 0.5, 2.0];
        let svg = panels_svg("a < b", "frame", &[Panel { label: "bound, px", values: &values }]);
        assert!(svg.contains("a &lt; b") && !svg.contains("inf") && !svg.contains("NaN"));
        let curve = svg.lines().find(|line| line.contains("#06c")).expect("a curve");
        assert_eq!((curve.matches('M').count(), curve.matches('L').count()), (2, 1));
        assert!(panels_svg("", "", &[Panel { label: "", values: &[] }]).ends_with("</svg>\n"));
    }
}
