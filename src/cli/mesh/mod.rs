//! `sightline mesh`: one mesh of a database as a file.

mod export;
mod glb;

use std::{
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::PathBuf,
    str::FromStr,
    sync::Arc,
};

use glam::{DQuat, DVec3};
use serde_json::json;

use self::export::{Format, Surface};
use super::{
    Context, Failure,
    args::{self, Point, Positions},
    info,
    los::batch,
};
use crate::{
    database::Database,
    evaluate::flight,
    exercise::{Place, Site},
    los::{self, Options},
    roam::{Fidelity, MeshError, MeshReport, RequiredLine, Target, ViewMesh},
    view::{Camera, Projection},
};

/// Most triangles that a mesh may have which aims for an error: some 10 GB of memory.
const MAX_TRIANGLES: u32 = 50_000_000;
/// Distance of the near plane. Nothing nearer can be seen, and what is near it is never good enough.
const NEAR_M: f64 = 1.0;

/// Write one mesh of the terrain to a file: the best for a triangle count, or the smallest for an error.
///
/// Coordinates are metres east, north and up of the south-west post, as the scene frame has them. With an eye, the
/// mesh is refined for what it sees; without one, for the vertical error anywhere. Voids have filled-in heights.
#[derive(clap::Args, Debug)]
#[command(group(clap::ArgGroup::new("target").required(true)))]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// Where the mesh goes; the name ends in .ply (binary), .obj (text) or .glb (glTF binary, y up). - is standard
    /// output, as .ply.
    #[arg(short, value_name = "F.ply|obj|glb")]
    output: PathBuf,
    /// Greatest number of triangles, at least 2.
    #[arg(long, value_name = "N", group = "target")]
    triangles: Option<u32>,
    /// Greatest distortion on the screen, in pixels. Needs an eye.
    #[arg(long, value_name = "PX", group = "target", requires = "eye")]
    pixels: Option<f64>,
    /// Greatest vertical error, in metres.
    #[arg(long, value_name = "M", group = "target", conflicts_with = "eye")]
    error: Option<f64>,
    /// The eye, in the frame of --coords.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "look")]
    eye: Option<Point>,
    /// A point that the eye looks at, in the frame of --coords.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "eye")]
    look: Option<Point>,
    /// Vertical field of view.
    #[arg(long, value_name = "DEG", default_value_t = 60.0, requires = "eye")]
    fov: f64,
    /// Size of the picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", requires = "eye")]
    viewport: Viewport,
    /// Sight lines that the mesh must get right: a CSV file with columns ax, ay, az, bx, by, bz, found by their header,
    /// in the frame of --coords. A line that comes first counts more when not all fit.
    #[arg(long, value_name = "F.csv")]
    lines: Option<PathBuf>,
    /// What is asked of the lines: verdict (the right answer), obstruction:M (and blocked within M metres of the true
    /// place), wedgie (no unsplit triangle whose wedgie they meet) or profile (full detail below).
    #[arg(long, value_name = "F", default_value = "verdict", value_parser = args::fidelity, requires = "lines")]
    fidelity: Fidelity,
    #[command(flatten)]
    positions: Positions,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
}

/// `WxH` on the command line.
#[derive(Clone, Copy, Debug)]
struct Viewport([u32; 2]);

impl FromStr for Viewport {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
        size.map(Self).ok_or(format!("'{text}' is not WxH: two whole numbers with an x between them"))
    }
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let format = self.format(context)?;
        if !self.to_standard_output() {
            args::refuse_existing(&self.output, self.force)?;
        }
        let database = Arc::new(info::open(&self.database)?);
        let camera = self.camera(&database)?;
        let lines = self.required_lines(&database)?;
        let unreadable = |error| Failure::input(self.database.display(), error);
        let mut mesh = ViewMesh::new(Arc::clone(&database), database.scale()).map_err(unreadable)?;
        let report = mesh.update(&camera, self.target(), &lines).map_err(|error| match error {
            MeshError::Read(error) => unreadable(error),
            error => Failure::Usage(error.to_string()),
        })?;
        let stolen = if lines.is_empty() { 0 } else { self.stolen(&mesh, &camera)? };
        let surface = Surface::of(&mesh, database.scale());
        self.write(&surface, format)?;
        self.tell(context, &report, &surface, lines.len(), stolen);
        Ok(())
    }

    /// The triangles that lines took from the plain mesh.
    fn stolen(&self, mesh: &ViewMesh<Database>, camera: &Camera) -> Result<u64, Failure> {
        let plain = ViewMesh::new(Arc::clone(mesh.terrain()), mesh.scale()).map_err(MeshError::from);
        let plain = plain.and_then(|mut plain| plain.update(camera, self.target(), &[]).map(|_| plain));
        Ok(mesh.stolen_from(&plain.map_err(|error| Failure::input(self.database.display(), error))?))
    }

    fn to_standard_output(&self) -> bool {
        self.output.as_os_str() == "-"
    }

    fn format(&self, context: &Context) -> Result<Format, Failure> {
        if self.to_standard_output() {
            if context.json {
                return Err(Failure::Usage("standard output cannot hold both the mesh and --json".into()));
            }
            return Ok(Format::Ply);
        }
        let extension = self.output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("ply") => Ok(Format::Ply),
            Some("obj") => Ok(Format::Obj),
            Some("glb") => Ok(Format::Glb),
            _ => Err(Failure::Usage(format!("{} must end in .ply, .obj or .glb", self.output.display()))),
        }
    }

    fn target(&self) -> Target {
        match (self.triangles, self.pixels.or(self.error)) {
            (Some(n), _) => Target::TriangleBudget(n),
            (None, px) => Target::ScreenError { px: px.unwrap_or(f64::NAN), max: MAX_TRIANGLES },
        }
    }

    /// A point of the command line or a file in the grid frame; `None` over unknown ground.
    fn grid_from_point(&self, database: &Database, position: [f64; 3]) -> Result<Option<[f64; 3]>, Failure> {
        let (frame, altitude) = (self.positions.frame(), self.positions.altitude());
        let site = Site { scale: database.scale(), georeference: database.georeference() };
        let place = Place { position, frame, altitude };
        site.grid_from_place(database, &place, 0.0).map_err(|error| Failure::Input(error.to_string()))
    }

    fn camera(&self, database: &Database) -> Result<Camera, Failure> {
        let (Some(Point(eye)), Some(Point(look))) = (self.eye, self.look) else { return Ok(Camera::everywhere()) };
        let scene = |what: &str, position| match self.grid_from_point(database, position)? {
            Some(p) => Ok(database.scale().scene_from_grid(DVec3::from_array(p))),
            None => Err(Failure::Input(format!("there is no known ground below {what}: give --altitude absolute"))),
        };
        if !(self.fov > 0.0 && self.fov < 180.0) {
            return Err(Failure::Usage(format!("--fov {} is not between 0 and 180 degrees", self.fov)));
        }
        let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
        let (eye, look) = (scene("the eye", eye)?, scene("what it looks at", look)?);
        let viewpoint = flight::viewpoint(eye, look).map_err(|error| usage(&error))?;
        // One place where degrees become a tangent; the mesh depends on the f64 that comes out.
        let projection = Projection::Perspective { tan_half_fov: (0.5 * self.fov).to_radians().tan(), near_m: NEAR_M };
        Camera::new(viewpoint.eye, DQuat::from_array(viewpoint.rotation), projection, self.viewport.0)
            .map_err(|error| usage(&error))
    }

    fn required_lines(&self, database: &Database) -> Result<Vec<RequiredLine>, Failure> {
        let Some(path) = &self.lines else { return Ok(Vec::new()) };
        let fidelity = self.fidelity;
        let mut required = Vec::new();
        let text = fs::read_to_string(path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::InvalidData => Failure::input(path.display(), error),
            _ => Failure::environment(path.display(), error),
        })?;
        let table = batch::parse(&text).map_err(|why| Failure::input(path.display(), why))?;
        for (&number, &ends) in table.numbers.iter().zip(&table.ends) {
            // An end without ground makes the line unknown: it asks nothing.
            let (Some(a), Some(b)) =
                (self.grid_from_point(database, ends[0])?, self.grid_from_point(database, ends[1])?)
            else {
                continue;
            };
            let answer = los::line_of_sight(database, a, b, Options::default())
                .map_err(|error| Failure::input(format!("{}: line {number}", path.display()), error))?;
            let verdict = answer.verdict.on_mesh();
            required.push(RequiredLine { id: number as u64, a, b, verdict, fidelity, priority: 0 });
        }
        Ok(required)
    }

    fn write(&self, surface: &Surface, format: Format) -> Result<(), Failure> {
        let written = if self.to_standard_output() {
            surface.write(format, &mut BufWriter::new(io::stdout().lock()))
        } else {
            File::create(&self.output).and_then(|file| {
                let mut out = BufWriter::new(file);
                surface.write(format, &mut out)?;
                out.flush()
            })
        };
        written.map_err(|error| Failure::environment(format!("writing {}", self.output.display()), error))
    }

    fn tell(&self, context: &Context, report: &MeshReport, surface: &Surface, lines: usize, stolen: u64) {
        let unit = if self.eye.is_some() { "px" } else { "m" };
        if context.json {
            // An infinite bound has no number in JSON: it becomes null.
            let document = json!({
                "output": self.output, "triangles": report.triangles, "drawn_triangles": surface.triangles(),
                "vertices": surface.vertices(), "bound": report.bound_px, "bound_unit": unit,
                "sight_lines": lines, "stolen_triangles": stolen,
                "unsatisfied_lines": report.unsatisfied,
            });
            outln!("{document:#}");
        } else if !context.quiet {
            errln!(
                "{} triangles ({} over the grid), {} vertices; nothing is off by more than {:.3} {unit}",
                report.triangles,
                surface.triangles(),
                surface.vertices(),
                report.bound_px
            );
            if lines > 0 {
                errln!("{lines} sight lines took {stolen} triangles");
            }
        }
        if !context.quiet && report.triangles == MAX_TRIANGLES {
            errln!("warning: stopped at {MAX_TRIANGLES} triangles; the error aimed for is not reached");
        }
        if !context.quiet && !report.unsatisfied.is_empty() {
            let named: Vec<_> = report.unsatisfied.iter().map(u64::to_string).collect();
            errln!("warning: wrong on this mesh, for want of triangles: the sight lines of rows {}", named.join(", "));
        }
    }
}
