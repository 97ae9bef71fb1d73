//! The map of a consistency test: the sight lines as they stand at the end, where the clients' plain meshes have them wrong,
//! and where triangles were spent so that their other meshes have not.

use std::{collections::BTreeMap, sync::Arc};

use sightline_client::{
    judge::first_below,
    raster::{self, Mark, MarkKind, Picture, Style, Surface, Voids},
};
use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
    v1,
    verdict::{MeshVerdict, verdict_on_mesh},
};

use super::{super::Failure, plan::Plan, run::Outcome};
use crate::{
    database::Database,
    evaluate::{consistency::percent, oracle::Ends},
    los::{self, Options},
    terrain::{DrawnPost, HeightField, Posts, ReadError},
};

/// Samples along the side of a map's ground.
const SAMPLES: u32 = 400;
/// Width of a map in pixels.
const WIDTH_PX: u32 = 1200;
/// Height of the panel of text, of the map's width.
const PANEL: f64 = 0.14;

/// Draws the theatre from above, north up.
pub(in super::super) fn map(plan: &Plan, outcome: &Outcome, database: &Database) -> Result<Picture, Failure> {
    let surface = ground(outcome.scenario.theatre, database).map_err(|e| Failure::input("the database", e))?;
    let splits = splits(outcome, database);
    let lines = lines(outcome, database);
    let (wrong, places) = mistakes(outcome, database)?;
    let count = |kind| lines.iter().filter(|mark| mark.kind == kind).count();
    let mut legend = vec![
        (MarkKind::Visible, format!("visible on the terrain: {} lines", count(MarkKind::Visible))),
        (MarkKind::Blocked, format!("blocked on the terrain: {} lines", count(MarkKind::Blocked))),
        (MarkKind::Unknown, format!("unknown, over ground without data: {} lines", count(MarkKind::Unknown))),
    ];
    legend.retain(|&(kind, _)| kind != MarkKind::Unknown || count(kind) > 0);
    let told = outcome.meshes.iter().filter(|meshes| meshes.lines.is_some() && meshes.plain.is_some()).count();
    if told > 0 {
        let mistakes = format!("rings: where plain meshes of {told} clients have {wrong} lines wrong");
        legend.push((MarkKind::Mistake, mistakes));
        let spent = format!("dots: {} posts that were split for the lines in meshes of these clients", splits.len());
        legend.push((MarkKind::Split, spent));
    }
    let marks = [splits, lines, places].concat();
    let style = Style { muted: true, caption: caption(plan, outcome, &surface), legend, ..Style::default() };
    // The panel of text stands on paper north of the terrain.
    let [low, high] = surface.extent;
    let window = [low, [high[0], high[1] + PANEL * (high[0] - low[0])]];
    Ok(raster::draw_map(&surface, Some(window), WIDTH_PX, &marks, &style))
}

fn caption(plan: &Plan, outcome: &Outcome, surface: &Surface) -> Vec<String> {
    let [[west, south], [east, north]] = surface.extent;
    let total = outcome.comparison.total();
    let budgets = plan.clients.iter().map(|client| client.triangles);
    let (least, most) = (budgets.clone().min().unwrap_or(0), budgets.max().unwrap_or(0));
    vec![
        format!(
            "sight lines after {} ticks, {:.1} x {:.1} km, north up",
            plan.frames,
            (east - west) / 1e3,
            (north - south) / 1e3
        ),
        format!("{} clients of {least} to {most} triangles, servers: {}", plan.clients.len(), outcome.servers),
        format!(
            "wrong in silence: {} of {} verdicts, on plain meshes {:.1} %",
            total.silent_disagreements,
            total.comparisons,
            percent(total.plain_disagreements, total.plain_comparisons)
        ),
    ]
}

fn lines(outcome: &Outcome, database: &Database) -> Vec<Mark> {
    let mark = |line: &sightline_client::scene::StatedLine| {
        let kind = match line.verdict {
            v1::Verdict::Visible => MarkKind::Visible,
            v1::Verdict::Blocked => MarkKind::Blocked,
            v1::Verdict::Unknown | v1::Verdict::Unspecified => MarkKind::Unknown,
        };
        let [a, b] = line.ends?.map(|p| in_scene(database, p));
        Some(Mark { a, b, kind })
    };
    outcome.last.lines.values().filter_map(mark).collect()
}

/// The posts of the theatre that a client's mesh has for its sight lines: those that its plain mesh lacks.
fn splits(outcome: &Outcome, database: &Database) -> Vec<Mark> {
    let mut marks = Vec::new();
    for meshes in &outcome.meshes {
        let (Some(lines), Some(plain)) = (&meshes.lines, &meshes.plain) else { continue };
        let plain: BTreeMap<_, _> = plain.iter().copied().collect();
        let [low, high] = outcome.scenario.theatre;
        let is_on_map = |p: Post| {
            let (x, y) = (f64::from(p.i), f64::from(p.j));
            (low[0]..=high[0]).contains(&x) && (low[1]..=high[1]).contains(&y)
        };
        for (p, height) in lines.iter().filter(|(p, _)| is_on_map(*p) && !plain.contains_key(p)) {
            let at = in_scene(database, [f64::from(p.i), f64::from(p.j), f64::from(*height)]);
            marks.push(Mark { a: at, b: at, kind: MarkKind::Split });
        }
    }
    marks
}

/// How many lines are wrong on some client's plain mesh, and where each is: where the mesh has a hill that is none, or
/// lacks the one that blocks the line.
fn mistakes(outcome: &Outcome, database: &Database) -> Result<(usize, Vec<Mark>), Failure> {
    let failed = |e: &dyn std::fmt::Display| Failure::input("the database", e);
    let mut plains = Vec::new();
    for posts in outcome.meshes.iter().filter_map(|meshes| meshes.plain.as_ref()) {
        plains.push(Told::new(posts, database).map_err(|e| failed(&e))?);
    }
    let (mut wrong, mut marks) = (0, Vec::new());
    for line in outcome.last.lines.values() {
        let Some(ends) = line.ends else { continue };
        let mut places = Vec::new();
        for plain in &plains {
            match (line.verdict, verdict_on_mesh(plain, ends[0], ends[1])) {
                (v1::Verdict::Visible, MeshVerdict::Blocked) => places.extend(first_below(plain, ends[0], ends[1])),
                (v1::Verdict::Blocked, MeshVerdict::Visible) => {
                    let derived =
                        los::derive(database, ends[0], ends[1], Options::default()).map_err(|e| failed(&e))?;
                    places.extend(derived.first_from_a.map(|first| first.place.t));
                }
                _ => {}
            }
        }
        wrong += usize::from(!places.is_empty());
        marks.extend(places.into_iter().map(|t| ring(database, ends, t)));
    }
    Ok((wrong, marks))
}

fn ring(database: &Database, [a, b]: Ends, t: f64) -> Mark {
    let at = in_scene(database, [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k])));
    Mark { a: at, b: at, kind: MarkKind::Mistake }
}

fn in_scene(database: &Database, p: [f64; 3]) -> [f64; 3] {
    database.scale().scene_from_grid(p.into()).to_array()
}

/// A mesh as a client told it.
struct Told {
    root: RootSquare,
    grid: (u32, u32),
    heights: BTreeMap<Post, f64>,
}

impl Told {
    fn new(posts: &[(Post, i32)], database: &Database) -> Result<Self, ReadError> {
        let grid = HeightField::grid(database);
        let mut heights: BTreeMap<_, _> = posts.iter().map(|&(p, height)| (p, f64::from(height))).collect();
        let mut field = Posts::new(database);
        for corner in grid.root().corners() {
            heights.insert(corner, field.at(corner)?.z);
        }
        Ok(Self { root: grid.root(), grid: (grid.nx(), grid.ny()), heights })
    }
}

impl Mesh for Told {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        self.grid
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.heights.get(&p).copied()
    }
}

/// The drawn heights of the theatre, at most [`SAMPLES`] a side.
fn ground(theatre: [[f64; 2]; 2], database: &Database) -> Result<Surface, ReadError> {
    let mut posts = Posts::new(database);
    let grid = HeightField::grid(database);
    let axis = |k: usize, last: u32| -> Vec<u32> {
        let (low, high) = (theatre[0][k] as u32, (theatre[1][k].ceil() as u32).min(last));
        let steps = (high - low).clamp(1, SAMPLES);
        (0..=steps).map(|n| low + ((u64::from(high - low) * u64::from(n)) / u64::from(steps)) as u32).collect()
    };
    let (columns, rows) = (axis(0, grid.nx() - 1), axis(1, grid.ny() - 1));
    let mut surface = Surface::default();
    let mut voids = Vec::new();
    for &j in &rows {
        for &i in &columns {
            let DrawnPost { z, void } = posts.at(Post::new(i, j))?;
            surface.vertices.push(in_scene(database, [f64::from(i), f64::from(j), z]));
            voids.push(void);
        }
    }
    surface.voids = Voids::new(columns.len(), rows.len(), voids).map(Arc::new);
    let width = columns.len() as u32;
    for row in 0..rows.len() as u32 - 1 {
        for column in 0..width - 1 {
            let south_west = row * width + column;
            let (south_east, north_west) = (south_west + 1, south_west + width);
            surface.triangles.push([south_west, south_east, north_west]);
            surface.triangles.push([south_east, north_west + 1, north_west]);
        }
    }
    if let (Some(first), Some(last)) = (surface.vertices.first(), surface.vertices.last()) {
        surface.extent = [[first[0], first[1]], [last[0], last[1]]];
    }
    Ok(surface)
}
