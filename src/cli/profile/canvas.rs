//! A drawing of polygons, lines, dots and words, as SVG or as a picture. Units are pixels, y down.

use std::fmt::Write;

use sightline_client::raster::Picture;

/// Rows of samples in a pixel of a picture; across, coverage is exact.
const ROWS: usize = 4;
/// Pixels of a picture in a unit of the drawing.
const PICTURE_SCALE: f64 = 1.5;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// Where a text stands relative to its point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

enum Shape {
    Polygon(Vec<[f64; 2]>, Colour),
    Line(Vec<[f64; 2]>, Colour, f64),
    Dot([f64; 2], f64, Colour),
    Text([f64; 2], Anchor, Colour, String),
}

/// A drawing in the making.
pub(super) struct Canvas {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Canvas {
    pub(super) fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    pub(super) fn polygon(&mut self, points: Vec<[f64; 2]>, colour: Colour) {
        self.shapes.push(Shape::Polygon(points, colour));
    }

    pub(super) fn line(&mut self, points: Vec<[f64; 2]>, colour: Colour, width: f64) {
        self.shapes.push(Shape::Line(points, colour, width));
    }

    pub(super) fn dot(&mut self, at: [f64; 2], radius: f64, colour: Colour) {
        self.shapes.push(Shape::Dot(at, radius, colour));
    }

    /// One line of text of 12 pixels on the base line of `at`.
    pub(super) fn text(&mut self, at: [f64; 2], anchor: Anchor, colour: Colour, text: impl Into<String>) {
        self.shapes.push(Shape::Text(at, anchor, colour, text.into()));
    }

    /// The drawing as SVG.
    pub(super) fn svg(&self) -> String {
        let (width, height) = (self.width, self.height);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
        );
        for shape in &self.shapes {
            // Writing to a String cannot fail.
            let _ = match shape {
                Shape::Polygon(points, colour) => {
                    writeln!(out, "<polygon points=\"{}\" fill=\"{}\"/>", svg_points(points), svg_colour(*colour))
                }
                Shape::Line(points, colour, width) => writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" \
                     stroke-linejoin=\"round\"/>",
                    svg_points(points),
                    svg_colour(*colour)
                ),
                Shape::Dot([x, y], radius, colour) => writeln!(
                    out,
                    "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"{}\"/>",
                    svg_colour(*colour)
                ),
                Shape::Text([x, y], anchor, colour, text) => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
                    writeln!(
                        out,
                        "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\" fill=\"{}\">{text}</text>",
                        svg_colour(*colour)
                    )
                }
            };
        }
        out + "</svg>\n"
    }

    /// The drawing as pixels.
    pub(super) fn picture(&self) -> Picture {
        let size = |v: f64| (v * PICTURE_SCALE).ceil() as u32;
        let mut picture = Picture::blank(size(self.width), size(self.height), [255; 3]);
        for shape in &self.shapes {
            match shape {
                Shape::Polygon(points, colour) => fill(&mut picture, points, *colour),
                Shape::Line(points, colour, width) => stroke(&mut picture, points, *colour, *width),
                Shape::Dot(at, radius, colour) => fill(&mut picture, &circle(*at, *radius), *colour),
                Shape::Text([x, y], anchor, colour, text) => {
                    // 12 dots a character at size 2, 14 high.
                    let wide = 12.0 * text.chars().count() as f64;
                    let back = match anchor {
                        Anchor::Start => 0.0,
                        Anchor::Middle => wide / 2.0,
                        Anchor::End => wide,
                    };
                    let at = [x * PICTURE_SCALE - back, y * PICTURE_SCALE - 14.0].map(|v| v.max(0.0) as u32);
                    picture.write(text, at, 2, *colour);
                }
            }
        }
        picture
    }
}

fn svg_points(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

fn svg_colour([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn circle([x, y]: [f64; 2], radius: f64) -> Vec<[f64; 2]> {
    const CORNERS: u32 = 24;
    let turn = std::f64::consts::TAU / f64::from(CORNERS);
    (0..CORNERS)
        .map(|n| (f64::from(n) * turn).sin_cos())
        .map(|(sin, cos)| [x + radius * cos, y + radius * sin])
        .collect()
}

/// Each piece of a line is a rectangle, with a dot at each bend of a wide one.
fn stroke(picture: &mut Picture, points: &[[f64; 2]], colour: Colour, width: f64) {
    for pair in points.windows(2) {
        let [[x, y], [u, v]] = [pair[0], pair[1]];
        let length = ((u - x) * (u - x) + (v - y) * (v - y)).sqrt();
        if length > 0.0 {
            let (dx, dy) = ((u - x) / length * width / 2.0, (v - y) / length * width / 2.0);
            fill(picture, &[[x - dy, y + dx], [x + dy, y - dx], [u + dy, v - dx], [u - dy, v + dx]], colour);
        }
    }
    if width > 1.5 && points.len() > 2 {
        for &bend in &points[1..points.len() - 1] {
            fill(picture, &circle(bend, width / 2.0), colour);
        }
    }
}

/// Fills a polygon (even and odd), with soft edges.
fn fill(picture: &mut Picture, points: &[[f64; 2]], colour: Colour) {
    let points: Vec<_> = points.iter().map(|p| p.map(|v| v * PICTURE_SCALE)).collect();
    let edges = || points.iter().zip(points.iter().cycle().skip(1));
    let lowest = points.iter().fold(f64::INFINITY, |m, p| m.min(p[1])).max(0.0);
    let highest = points.iter().fold(0.0_f64, |m, p| m.max(p[1])).min(f64::from(picture.height_px));
    let width = picture.width_px as usize;
    // Edges by the first row that they can meet, so that a long outline costs no more than it is high.
    let mut waiting: Vec<_> = edges().map(|(p, q)| if p[1] < q[1] { (*p, *q) } else { (*q, *p) }).collect();
    waiting.sort_by(|(p, _), (q, _)| q[1].total_cmp(&p[1]));
    let mut active: Vec<([f64; 2], [f64; 2])> = Vec::new();
    for row in lowest as u32..highest.ceil() as u32 {
        while let Some(edge) = waiting.pop_if(|(p, _)| p[1] < f64::from(row + 1)) {
            active.push(edge);
        }
        active.retain(|(_, q)| q[1] >= f64::from(row));
        let mut coverage = vec![0.0; width];
        for sample in 0..ROWS {
            let y = f64::from(row) + (sample as f64 + 0.5) / ROWS as f64;
            let met = active.iter().filter(|(p, q)| p[1] <= y && y < q[1]);
            let mut at: Vec<f64> = met.map(|(p, q)| p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0])).collect();
            at.sort_by(f64::total_cmp);
            for span in at.chunks_exact(2) {
                let (from, to) = (span[0].clamp(0.0, width as f64), span[1].clamp(0.0, width as f64));
                for (x, covered) in coverage.iter_mut().enumerate().take(to.ceil() as usize).skip(from as usize) {
                    *covered += (to.min(x as f64 + 1.0) - from.max(x as f64)).max(0.0) / ROWS as f64;
                }
            }
        }
        for (x, &covered) in (0_u32..).zip(&coverage) {
            if covered > 0.0 {
                picture.blend(x, row, colour, (covered.min(1.0) * 255.0).round() as u32);
            }
        }
    }
}
