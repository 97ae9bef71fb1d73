//! `sightline fly`: a flight over a terrain without server or window, and what each of its frames takes.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use glam::DQuat;

use super::{
    Context, Failure,
    args::refuse_existing,
    generator::{DEFAULT_POSES, write},
    info,
    plot::{Panel, panels_svg},
};
use crate::{
    database::Database,
    evaluate::flight::{PRESETS, Plan, Preset, Viewpoint},
    lod::{self, Algorithm, Ground, LevelOfDetail, LodView, System},
    los,
    roam::{Options, Target, ViewMesh},
    terrain::ReadError,
    view::{Camera, CameraError, Projection},
};

/// Frames in a second of a preset.
const RATE_HZ: f64 = 60.0;
/// Tangent of half the vertical field of view: 60 degrees.
const TAN_HALF_FOV: f64 = 0.577;
const NEAR_M: f64 = 1.0;
const VIEWPORT_PX: [u32; 2] = [1280, 720];

/// Fly over a database and tell what each frame takes: splits and merges, priorities computed, time, distortion bound.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// terrain-avoidance (250 m/s, low, climbing before ridges), straight (250 m/s, 150 m up), helicopter, orbit, turn
    /// (by 180 degrees), teleport, or a CSV file of viewpoints in metres of the scene frame: eye_x_m,eye_y_m,eye_z_m,look_x_m,look_y_m,look_z_m.
    #[arg(long, value_name = "PRESET|FILE", default_value = "straight")]
    flight: String,
    /// Frames to fly, 60 to the second of a preset [default: 300, or all of a file].
    #[arg(long, value_name = "F")]
    frames: Option<usize>,
    /// Triangle budget; with --pixels the most triangles.
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    triangles: u32,
    /// As few triangles as this distortion in pixels allows.
    #[arg(long, value_name = "PX")]
    pixels: Option<f64>,
    /// What makes the meshes: roam, or for comparison roam that computes all priorities in each frame (naive) or builds
    /// each mesh anew (scratch), or another system.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = Name::Roam)]
    algorithm: Name,
    /// Draw what each frame took to this file.
    #[arg(long, value_name = "F.svg")]
    plot: Option<PathBuf>,
    /// Write a line for each frame to this file ('-' for standard output).
    #[arg(short, value_name = "F.csv")]
    output: Option<PathBuf>,
    /// Where a preset starts and heads.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Replace outputs that exist.
    #[arg(long)]
    force: bool,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq, Eq, Debug)]
enum Name {
    Roam,
    Naive,
    Scratch,
    Quadtree,
    Geomipmap,
    ImprovedGeomipmap,
    TStrip,
    Geomancy,
    SplitOnly,
    NestedSpheres,
    Published,
}

impl Name {
    /// How our own refinement works under this name; the other system for other names.
    fn means(self) -> Result<Options, Algorithm> {
        let options = Options::default();
        Err(match self {
            Self::Roam => return Ok(options),
            Self::Naive => return Ok(Options { deferral: false, ..options }),
            Self::Scratch => return Ok(Options { incremental: false, ..options }),
            Self::Quadtree => Algorithm::Quadtree,
            Self::Geomipmap => Algorithm::GeoMipMap,
            Self::ImprovedGeomipmap => Algorithm::ImprovedGeoMipMap,
            Self::TStrip => Algorithm::TStrip,
            Self::Geomancy => Algorithm::Geomancy,
            Self::SplitOnly => Algorithm::SplitOnly,
            Self::NestedSpheres => Algorithm::NestedSpheres,
            Self::Published => Algorithm::Published,
        })
    }
}

/// What a frame took.
#[derive(Clone, Copy, PartialEq, Debug, serde::Serialize)]
struct Row {
    frame: usize,
    /// Height of the eye in metres.
    eye_m: f64,
    ms: f64,
    splits: u64,
    merges: u64,
    /// Priorities computed; other systems' decisions about level of detail.
    priorities: u64,
    from_scratch: bool,
    triangles: usize,
    triangles_changed: usize,
    /// Absent when the system promises none, or an infinite one.
    bound_px: Option<f64>,
}

/// What makes the meshes.
enum Maker {
    Roam(Box<ViewMesh<Database>>, Target),
    Other(Box<System>, lod::Target, Vec<[u64; 3]>),
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let to_stdout = |path: &&PathBuf| path.as_os_str() != "-";
        for path in self.plot.iter().chain(self.output.iter().filter(to_stdout)) {
            refuse_existing(path, self.force)?;
        }
        let is_piped = self.output.as_ref().is_some_and(|path| path.as_os_str() == "-");
        if is_piped && context.json {
            return Err(Failure::Usage("standard output cannot hold both the frames and --json".into()));
        }
        let database = Arc::new(info::open(&self.database)?);
        let viewpoints = self.viewpoints(&database)?;
        let mut maker = self.maker(&database)?;
        let rows = viewpoints.iter().enumerate().map(|(frame, viewpoint)| self.fly_to(&mut maker, frame, viewpoint));
        let rows: Vec<_> = rows.collect::<Result<_, _>>()?;
        if let Some(path) = &self.plot {
            write(path, self.plot(&rows).as_bytes())?;
        }
        match &self.output {
            Some(_) if is_piped => out!("{}", csv(&rows)),
            Some(path) => write(path, csv(&rows).as_bytes())?,
            None => {}
        }
        if context.json {
            let summary = summary(&rows).map(|(name, values)| (name.to_owned(), serde_json::json!(values)));
            let summary: serde_json::Map<_, _> = summary.into_iter().collect();
            outln!("{:#}", serde_json::json!({ "frames": rows, "summary": summary }));
        } else if !is_piped {
            if self.output.is_none() && !context.quiet {
                out!("{}", table(&rows));
            }
            outln!(
                "{} frames, {} triangles; median, 95th percentile and greatest of a frame:",
                rows.len(),
                self.triangles
            );
            for (name, [median, p95, greatest]) in summary(&rows) {
                outln!("  {name:20} {median:12.3} {p95:12.3} {greatest:12.3}");
            }
        }
        Ok(())
    }

    fn viewpoints(&self, database: &Database) -> Result<Vec<Viewpoint>, Failure> {
        let (grid, scale) = (database.grid(), database.scale());
        let last = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
        let usage = |error: crate::evaluate::flight::FlightError| Failure::Usage(error.to_string());
        let plan = if PRESETS.iter().any(|preset| preset.name() == self.flight) {
            let preset: Preset = self.flight.parse().map_err(usage)?;
            let area_m = [[0.0; 2], [last[0] * scale.east_m, last[1] * scale.north_m]];
            Plan::preset(preset, area_m, self.frames.unwrap_or(DEFAULT_POSES), RATE_HZ, self.seed).map_err(usage)?
        } else {
            let csv = std::fs::read_to_string(&self.flight).map_err(|e| {
                let names = PRESETS.map(Preset::name).join(", ");
                Failure::Input(format!("the flight '{}' is no preset ({names}) and no readable file: {e}", self.flight))
            })?;
            Plan::listed(&csv).map_err(|e| Failure::input(&self.flight, e))?
        };
        let mut ground_m: Vec<f64> = Vec::new();
        for [x, y] in plan.ground_points() {
            let (x, y) = ((x / scale.east_m).clamp(0.0, last[0]), (y / scale.north_m).clamp(0.0, last[1]));
            let ground = los::surface_height(database, x, y).map_err(|e| Failure::input(self.database.display(), e))?;
            // Where the ground is unknown, that of the point before.
            ground_m.push(ground.map_or_else(|| ground_m.last().copied().unwrap_or(0.0), |z| z * scale.up_m));
        }
        let mut viewpoints = plan.fly(&ground_m).map_err(usage)?;
        viewpoints.truncate(self.frames.unwrap_or(usize::MAX));
        if viewpoints.is_empty() {
            Err(Failure::Usage("a flight needs at least one frame".into()))
        } else {
            Ok(viewpoints)
        }
    }

    fn maker(&self, database: &Arc<Database>) -> Result<Maker, Failure> {
        match self.algorithm.means() {
            Ok(options) => {
                let mut mesh = ViewMesh::new(Arc::clone(database), database.scale()).map_err(|e| self.unreadable(e))?;
                mesh.set_options(options);
                let target = Target::TriangleBudget(self.triangles);
                let screen = |px| Target::ScreenError { px, max: self.triangles };
                Ok(Maker::Roam(Box::new(mesh), self.pixels.map_or(target, screen)))
            }
            Err(algorithm) => {
                let ground = Ground::read(&**database, database.scale())
                    .map_err(|e| Failure::input(self.database.display(), e))?;
                if self.pixels.is_some() {
                    return Err(Failure::Usage("--pixels is for our own refinement: roam, naive or scratch".into()));
                }
                let target = lod::Target::Triangles(self.triangles);
                Ok(Maker::Other(Box::new(algorithm.prepare(&ground)), target, Vec::new()))
            }
        }
    }

    fn unreadable(&self, error: ReadError) -> Failure {
        Failure::input(self.database.display(), error)
    }

    fn fly_to(&self, maker: &mut Maker, frame: usize, viewpoint: &Viewpoint) -> Result<Row, Failure> {
        maker.frame(frame, viewpoint).map_err(|error| match error {
            Trouble::Camera(error) => Failure::Input(format!("frame {frame} of the flight: {error}")),
            Trouble::Mesh(crate::roam::MeshError::Read(error)) => self.unreadable(error),
            Trouble::Mesh(error) => Failure::Usage(error.to_string()),
            Trouble::Other(error) => Failure::Usage(error.to_string()),
        })
    }

    fn plot(&self, rows: &[Row]) -> String {
        let name = clap::ValueEnum::to_possible_value(&self.algorithm).map_or(String::new(), |v| v.get_name().into());
        let flight = Path::new(&self.flight).file_name().map_or(String::new(), |f| f.to_string_lossy().into_owned());
        let column = |value: fn(&Row) -> f64| rows.iter().map(value).collect::<Vec<_>>();
        let columns = [
            ("height of the eye, m", column(|row| row.eye_m)),
            ("time, ms", column(|row| row.ms)),
            ("splits and merges", column(|row| (row.splits + row.merges) as f64)),
            ("priorities computed", column(|row| row.priorities as f64)),
            ("triangles changed", column(|row| row.triangles_changed as f64)),
            ("distortion bound, px", column(|row| row.bound_px.unwrap_or(f64::NAN))),
        ];
        let panels = columns.each_ref().map(|(label, values)| Panel { label, values });
        panels_svg(&format!("{flight}, {} triangles, {name}", self.triangles), "frame", &panels)
    }
}

/// Why there is no frame.
enum Trouble {
    Camera(CameraError),
    Mesh(crate::roam::MeshError),
    Other(lod::LodError),
}

impl Maker {
    fn frame(&mut self, frame: usize, viewpoint: &Viewpoint) -> Result<Row, Trouble> {
        let [x, y, z, w] = viewpoint.rotation;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        match self {
            Self::Roam(mesh, target) => {
                let projection = Projection::Perspective { tan_half_fov: TAN_HALF_FOV, near_m: NEAR_M };
                let camera = Camera::new(viewpoint.eye, rotation, projection, VIEWPORT_PX).map_err(Trouble::Camera)?;
                let started = Instant::now();
                let report = mesh.update(&camera, *target, &[]).map_err(Trouble::Mesh)?;
                Ok(Row {
                    frame,
                    eye_m: viewpoint.eye.z,
                    ms: started.elapsed().as_secs_f64() * 1e3,
                    splits: report.work.splits,
                    merges: report.work.merges,
                    priorities: report.work.priorities,
                    from_scratch: report.work.from_scratch,
                    triangles: report.triangles as usize,
                    // A post that comes or goes changes two triangles into four, or back: two of each mesh, about.
                    triangles_changed: 2 * (report.added.len() + report.removed.len()),
                    bound_px: Some(report.bound_px).filter(|px| px.is_finite()),
                })
            }
            Self::Other(system, target, last) => {
                let view = LodView::new(viewpoint.eye, rotation, TAN_HALF_FOV, NEAR_M, VIEWPORT_PX)
                    .map_err(Trouble::Camera)?;
                let started = Instant::now();
                let made = system.update(&view, *target).map_err(Trouble::Other)?;
                let ms = started.elapsed().as_secs_f64() * 1e3;
                let plan = made.mesh.plan();
                let triangles_changed = lod::changed(last, &plan);
                *last = plan;
                Ok(Row {
                    frame,
                    eye_m: viewpoint.eye.z,
                    ms,
                    splits: made.statistics.splits,
                    merges: made.statistics.merges,
                    priorities: made.statistics.decisions,
                    from_scratch: false,
                    triangles: made.mesh.len(),
                    triangles_changed,
                    bound_px: made.bound_px.filter(|px| px.is_finite()),
                })
            }
        }
    }
}

fn csv(rows: &[Row]) -> String {
    let mut text =
        "frame,eye_m,ms,splits,merges,priorities,from_scratch,triangles,triangles_changed,bound_px\n".to_owned();
    for row in rows {
        let Row { frame, eye_m, ms, splits, merges, priorities, from_scratch, triangles, .. } = row;
        let Row { triangles_changed, bound_px, .. } = row;
        let bound = bound_px.map_or(String::new(), |px| px.to_string());
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{frame},{eye_m:.2},{ms:.4},{splits},{merges},{priorities},{from_scratch},{triangles},{triangles_changed},{bound}"
        );
    }
    text
}

/// A line for each frame.
fn table(rows: &[Row]) -> String {
    let mut text = "frame   splits  merges  priorities        ms  triangles  changed    bound px\n".to_owned();
    for row in rows {
        let Row { frame, splits, merges, priorities, ms, triangles, triangles_changed, .. } = row;
        let bound = row.bound_px.map_or("none".into(), |px| format!("{px:.2}"));
        let anew = if row.from_scratch { "  built anew" } else { "" };
        let _ = writeln!(
            text,
            "{frame:5}  {splits:7} {merges:7}  {priorities:10}  {ms:8.3}  {triangles:9}  {triangles_changed:7}  {bound:>10}{anew}"
        );
    }
    text
}

/// Median, 95th percentile and greatest value of each column; frames without a finite bound do not count for it.
fn summary(rows: &[Row]) -> [(&'static str, [f64; 3]); 5] {
    let column = |value: fn(&Row) -> f64| {
        let mut values: Vec<_> = rows.iter().map(value).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        [0.5, 0.95, 1.0].map(|share| {
            let n = (values.len().saturating_sub(1)) as f64 * share;
            values.get(n as usize).copied().unwrap_or(f64::NAN)
        })
    };
    [
        ("ms", column(|row| row.ms)),
        ("operations", column(|row| (row.splits + row.merges) as f64)),
        ("priorities", column(|row| row.priorities as f64)),
        ("triangles_changed", column(|row| row.triangles_changed as f64)),
        ("bound_px", column(|row| row.bound_px.unwrap_or(f64::NAN))),
    ]
}
