//! A profile as a plot: range across, height up, both in metres.

use super::{
    Profile, Row,
    canvas::{Anchor, Canvas, Colour},
};
use crate::los::{GroundState, LineState};

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 440.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 22.0;
const TOP: f64 = 52.0;
const BOTTOM: f64 = 52.0;

const INK: Colour = [45, 50, 56];
const GRID: Colour = [226, 229, 232];
const GROUND: Colour = [214, 203, 184];
const SEEN: Colour = [190, 140, 20];
const HIDDEN: Colour = [92, 100, 110];
const UNKNOWN: Colour = [205, 218, 232];
const CLEAR: Colour = [20, 130, 60];
const BELOW: Colour = [200, 30, 45];
const DOUBT: Colour = [120, 140, 165];

/// The window of a plot.
struct Axes {
    range_m: f64,
    low: f64,
    high: f64,
}

impl Axes {
    fn new(profile: &Profile) -> Self {
        let grounds = profile.rows.iter().filter_map(|row| row.ground_m);
        let heights = grounds.chain(profile.sight.parts(0.0, 1.0).map(|t| profile.sight.height_m(t)));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        let margin = (0.08 * (high - low)).max(1.0);
        Self { range_m: profile.range_m.max(1e-9), low: low - margin, high: high + margin }
    }

    fn at(&self, range_m: f64, z: f64) -> [f64; 2] {
        let up = (z - self.low) / (self.high - self.low);
        [LEFT + range_m / self.range_m * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM)]
    }
}

/// Draws a profile.
pub(super) fn draw(profile: &Profile) -> Canvas {
    let axes = Axes::new(profile);
    let mut canvas = Canvas::new(WIDTH, HEIGHT);
    unknown(&mut canvas, &axes, profile);
    scales(&mut canvas, &axes);
    ground(&mut canvas, &axes, profile);
    line(&mut canvas, &axes, profile);
    title(&mut canvas, &axes, profile);
    canvas
}

/// Shades where no ground is known.
fn unknown(canvas: &mut Canvas, axes: &Axes, profile: &Profile) {
    let mut shade = |from: f64, to: f64| {
        if to > from {
            let ([x, bottom], [u, top]) = (axes.at(from, axes.low), axes.at(to, axes.high));
            canvas.polygon(vec![[x, bottom], [u, bottom], [u, top], [x, top]], UNKNOWN);
        }
    };
    let (Some(first), Some(last)) = (profile.rows.first(), profile.rows.last()) else {
        return shade(0.0, profile.range_m);
    };
    shade(0.0, first.range_m);
    for pair in profile.rows.windows(2).filter(|pair| !pair[0].known_after) {
        shade(pair[0].range_m, pair[1].range_m);
    }
    shade(last.range_m, profile.range_m);
}

fn scales(canvas: &mut Canvas, axes: &Axes) {
    for z in ticks(axes.low, axes.high, 6.0) {
        let ([x, y], [u, _]) = (axes.at(0.0, z), axes.at(axes.range_m, z));
        canvas.line(vec![[x, y], [u, y]], GRID, 1.0);
        canvas.text([x - 8.0, y + 4.0], Anchor::End, INK, label(z));
    }
    let (unit, metres) = if axes.range_m > 5000.0 { ("km", 1000.0) } else { ("m", 1.0) };
    for at in ticks(0.0, axes.range_m / metres, 9.0) {
        let [x, y] = axes.at(at * metres, axes.low);
        canvas.line(vec![[x, y], [x, y + 5.0]], INK, 1.0);
        canvas.text([x, y + 20.0], Anchor::Middle, INK, label(at));
    }
    let ([x, y], [u, _]) = (axes.at(0.0, axes.low), axes.at(axes.range_m, axes.low));
    canvas.line(vec![[x, y], [u, y]], INK, 1.0);
    canvas.text([0.5 * (x + u), y + 40.0], Anchor::Middle, INK, format!("range ({unit})"));
    canvas.text([8.0, TOP - 14.0], Anchor::Start, INK, "height (m)");
}

/// Fills the ground and draws its surface by whether it is seen.
fn ground(canvas: &mut Canvas, axes: &Axes, profile: &Profile) {
    let at = |row: &Row| row.ground_m.map(|z| axes.at(row.range_m, z));
    for run in profile.rows.chunk_by(|row, _| row.known_after).filter(|run| run.len() > 1) {
        let mut outline: Vec<_> = run.iter().filter_map(at).collect();
        let (first, last) = (run[0].range_m, run[run.len() - 1].range_m);
        outline.extend([axes.at(last, axes.low), axes.at(first, axes.low)]);
        canvas.polygon(outline, GROUND);
    }
    for stretch in &profile.ground {
        let colour = match stretch.state {
            GroundState::Seen => SEEN,
            GroundState::Hidden => HIDDEN,
            GroundState::Unknown => DOUBT,
        };
        for pair in part(&profile.rows, stretch.from, stretch.to) {
            canvas.line(pair.map(|[range_m, z]| axes.at(range_m, z)).to_vec(), colour, 2.0);
        }
    }
}

/// The known pieces of the ground between two parts of the line, as range and height of their ends.
fn part(rows: &[Row], from: f64, to: f64) -> Vec<[[f64; 2]; 2]> {
    let mut pieces = Vec::new();
    let start = rows.partition_point(|row| row.t <= from).saturating_sub(1);
    for pair in rows[start.min(rows.len())..].windows(2) {
        let [p, q] = [pair[0], pair[1]];
        if p.t >= to {
            break;
        }
        let (Some(low), Some(high), true) = (p.ground_m, q.ground_m, p.known_after && q.t > p.t) else { continue };
        let at = |t: f64| {
            let share = ((t - p.t) / (q.t - p.t)).clamp(0.0, 1.0);
            [p.range_m + share * (q.range_m - p.range_m), low + share * (high - low)]
        };
        pieces.push([at(from.max(p.t)), at(to.min(q.t))]);
    }
    pieces
}

fn line(canvas: &mut Canvas, axes: &Axes, profile: &Profile) {
    let at = |t: f64| axes.at(t * profile.range_m, profile.sight.height_m(t));
    for stretch in &profile.line {
        let colour = match stretch.state {
            LineState::Above => CLEAR,
            LineState::Below => BELOW,
            LineState::Unknown => DOUBT,
        };
        canvas.line(profile.sight.parts(stretch.from, stretch.to).map(at).collect(), colour, 2.5);
    }
    for (t, name) in [(0.0, "A"), (1.0, "B")] {
        let [x, y] = at(t);
        canvas.dot([x, y], 4.5, INK);
        canvas.text([x, y - 9.0], if t == 0.0 { Anchor::Start } else { Anchor::End }, INK, name);
    }
    if let Some(t) = profile.obstruction() {
        let [x, y] = at(t);
        canvas.dot([x, y], 5.5, [255; 3]);
        canvas.dot([x, y], 4.0, BELOW);
        let side = if x < 0.5 * WIDTH { (x + 10.0, Anchor::Start) } else { (x - 10.0, Anchor::End) };
        canvas.text([side.0, y - 8.0], side.1, BELOW, format!("obstructed at {:.0} m", t * profile.range_m));
    }
}

fn title(canvas: &mut Canvas, axes: &Axes, profile: &Profile) {
    let per_px = |m: f64, px: f64| m / px;
    let wide = per_px(axes.range_m, WIDTH - LEFT - RIGHT);
    let steeper = wide / per_px(axes.high - axes.low, HEIGHT - TOP - BOTTOM);
    let text = format!("{}  {:.0} m  heights x {steeper:.1}", profile.verdict.name(), profile.range_m);
    canvas.text([LEFT, 20.0], Anchor::Start, INK, text);
    let mut x = WIDTH - RIGHT;
    for (name, colour) in [("hidden", HIDDEN), ("seen ground", SEEN), ("line below", BELOW), ("line of sight", CLEAR)] {
        canvas.text([x, 20.0], Anchor::End, INK, name);
        x -= 8.0 * name.len() as f64 + 8.0;
        canvas.line(vec![[x - 18.0, 16.0], [x, 16.0]], colour, 3.0);
        x -= 34.0;
    }
}

/// Round numbers between two, about so many.
fn ticks(low: f64, high: f64, count: f64) -> Vec<f64> {
    let rough = (high - low) / count;
    let mut step = 1e-9;
    'found: while step < 1e300 {
        for by in [1.0, 2.0, 5.0] {
            if step * by >= rough {
                step *= by;
                break 'found;
            }
        }
        step *= 10.0;
    }
    let first = (low / step).ceil();
    (0..100).map(|n| (first + f64::from(n)) * step).take_while(|&v| v <= high).collect()
}

fn label(v: f64) -> String {
    // Without the dust of a product.
    let rounded = (v * 1e6).round() / 1e6;
    if rounded == 0.0 { "0".into() } else { rounded.to_string() }
}
