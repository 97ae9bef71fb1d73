//! `sightline profile`: the ground under a line of sight, break by break, as a table or a plot.

mod canvas;
mod plot;

use std::{fmt::Write, path::PathBuf};

use serde_json::json;

use super::{
    Context, Failure,
    args::{EarthShape, Point, Positions},
    info,
    los::ask::place_failure,
    output::Output,
};
use crate::{
    database::Database,
    exercise::{Place, Site},
    los::{self, Derived, Earth, GroundState, LineState, Lines, LosError, Options, Stretch, Verdict},
};

/// Most breaks of a profile: a line across some 300,000 posts.
const MAX_BREAKS: usize = 1_000_000;
/// Straight pieces in which a stretch of a curved line is drawn.
const CURVED_PIECES: u32 = 48;
/// The columns of a table: the part of the line, metres from its beginning in plan, map (or grid) coordinates, metres
/// above the vertical datum, whether the line is there above or below the ground, and whether the ground is seen.
const COLUMNS: &str = "t,range_m,x,y,ground,line,clearance,state,ground_state";

/// Write the terrain's profile under a line of sight: all breaks of the ground, exactly, as a table or a plot.
///
/// A plot shows the ground, which parts of it are seen and hidden from the first end, the line of sight above and below
/// ground, and where it is first obstructed.
///
/// Example: sightline profile area.sightline --from -118.30,36.50,2 --to -118.29,36.58,2 --altitude agl -o p.svg
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// Where the profile goes: .csv, .json, .png or .svg. - is standard output, as CSV.
    #[arg(short, value_name = "F.csv|json|png|svg")]
    output: PathBuf,
    /// The observer's end.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    from: Point,
    /// The target's end.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    to: Point,
    #[command(flatten)]
    positions: Positions,
    #[command(flatten)]
    earth: EarthShape,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Format {
    Csv,
    Json,
    Png,
    Svg,
}

/// A break of the ground, in metres.
#[derive(Clone, Copy, Debug)]
struct Row {
    t: f64,
    range_m: f64,
    at: [f64; 2],
    ground_m: Option<f64>,
    line_m: f64,
    known_after: bool,
}

/// How high a line of sight passes: straight, or lowered by the bulge of a curved Earth.
#[derive(Clone, Copy, Debug)]
struct Sight {
    ends_m: [f64; 2],
    /// Four times the bulge in the middle.
    bend_m: f64,
}

impl Sight {
    /// At t, as a part of the line.
    fn height_m(self, t: f64) -> f64 {
        let [from, to] = self.ends_m;
        from + t * (to - from) - self.bend_m * (t * (1.0 - t))
    }

    /// Parts of the line between which it is drawn straight.
    fn parts(self, from: f64, to: f64) -> impl Iterator<Item = f64> {
        let pieces = if self.bend_m == 0.0 { 1 } else { CURVED_PIECES };
        (0..=pieces).map(move |n| from + f64::from(n) / f64::from(pieces) * (to - from))
    }
}

/// A line of sight and the ground under it, in metres.
struct Profile {
    ends: [[f64; 3]; 2],
    verdict: Verdict,
    range_m: f64,
    sight: Sight,
    rows: Vec<Row>,
    line: Vec<Stretch<LineState>>,
    ground: Vec<Stretch<GroundState>>,
    derived: Derived,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let output = Output::new(context, &self.output, self.force)?;
        let format = match output.extension().as_deref() {
            Some("csv") => Format::Csv,
            Some("json") => Format::Json,
            Some("png") => Format::Png,
            Some("svg") => Format::Svg,
            None if output.is_standard() => Format::Csv,
            _ => {
                return Err(Failure::Usage(format!("-o {}: name it .csv, .json, .png or .svg", self.output.display())));
            }
        };
        let database = info::open(&self.database)?;
        let profile = self.profile(&database)?;
        match format {
            Format::Csv => output.text(&profile.csv())?,
            Format::Json => output.text(&format!("{:#}\n", profile.document(true)))?,
            Format::Svg => output.text(&plot::draw(&profile).svg())?,
            Format::Png => {
                let png = plot::draw(&profile).picture().png();
                output.bytes(&png.map_err(|error| Failure::environment(self.output.display(), error))?)?;
            }
        }
        if context.json {
            outln!("{:#}", profile.document(false));
        } else if !context.quiet {
            let (verdict, range, breaks) = (profile.verdict.name(), profile.range_m, profile.rows.len());
            errln!("{verdict}; {breaks} breaks of the ground in {range:.1} m");
        }
        Ok(())
    }

    fn profile(&self, database: &Database) -> Result<Profile, Failure> {
        let site = Site { scale: database.scale(), georeference: database.georeference() };
        let mut ends = [[0.0; 3]; 2];
        for (end, (name, point)) in ends.iter_mut().zip([("--from", self.from), ("--to", self.to)]) {
            let place = Place { position: point.0, frame: self.positions.frame(), altitude: self.positions.altitude() };
            *end = site.grid_from_place(database, &place, 0.0).map_err(place_failure)?.ok_or_else(|| {
                Failure::Input(format!(
                    "{name} is given above ground where no ground is known: try --altitude absolute"
                ))
            })?;
        }
        let earth = self.earth.earth(site.scale)?;
        Profile::new(database, &site, ends, earth).map_err(|error| place_failure(error.into()))
    }
}

impl Profile {
    fn new(database: &Database, site: &Site, ends: [[f64; 3]; 2], earth: Earth) -> Result<Self, LosError> {
        let [a, b] = ends;
        let scale = site.scale;
        let options = Options { earth, ..Options::default() };
        let plan = |[x, y, _]: [f64; 3]| [x, y];
        let sight = Sight {
            ends_m: [a[2] * scale.up_m, b[2] * scale.up_m],
            bend_m: 4.0 * earth.bulge(plan(a), plan(b), 0.5) * scale.up_m,
        };
        let (east, north) = ((b[0] - a[0]) * scale.east_m, (b[1] - a[1]) * scale.north_m);
        let range_m = (east * east + north * north).sqrt();
        let breaks = los::profile(database, plan(a), plan(b), MAX_BREAKS)?;
        let rows = breaks.iter().map(|found| {
            let [x, y] = found.point;
            Row {
                t: found.t,
                range_m: found.t * range_m,
                at: site.georeference.map_or([x, y], |place| place.map_from_grid(x, y)),
                ground_m: found.ground.map(|z| z * scale.up_m),
                line_m: sight.height_m(found.t),
                known_after: found.known_after,
            }
        });
        Ok(Self {
            ends,
            verdict: Lines::new(database).ask(a, b, options)?.verdict,
            range_m,
            sight,
            rows: rows.collect(),
            line: los::line_stretches(database, a, b, earth)?,
            ground: los::ground_stretches(database, a, plan(b), earth)?,
            derived: los::derive(database, a, b, options)?,
        })
    }

    /// Where the line is first below ground, as a part of it.
    fn obstruction(&self) -> Option<f64> {
        self.derived.first_from_a.map(|first| first.place.t)
    }

    fn csv(&self) -> String {
        let mut out = format!("{COLUMNS}\n");
        for row in &self.rows {
            let Row { t, range_m, at: [x, y], ground_m, line_m, .. } = row;
            let ground = ground_m.map_or(String::new(), |z| z.to_string());
            let clearance = ground_m.map_or(String::new(), |z| (line_m - z).to_string());
            let line = self.line_at(*t).unwrap_or(LineState::Unknown).name();
            let seen = ground_at(&self.ground, *t).unwrap_or(GroundState::Unknown).name();
            // Writing to a String cannot fail.
            let _ = writeln!(out, "{t},{range_m},{x},{y},{ground},{line_m},{clearance},{line},{seen}");
        }
        out
    }

    /// How the line stands to the ground at a break: at a boundary of stretches it is on the ground, not below it.
    fn line_at(&self, t: f64) -> Option<LineState> {
        let at = || self.line.iter().filter(|s| s.from <= t && t <= s.to).map(|s| s.state);
        at().find(|&state| state == LineState::Above).or_else(|| at().next())
    }

    fn document(&self, whole: bool) -> serde_json::Value {
        let stretch = |from: f64, to: f64, state: &str| json!({ "from": from, "to": to, "state": state });
        let line: Vec<_> = self.line.iter().map(|s| stretch(s.from, s.to, s.state.name())).collect();
        let ground: Vec<_> = self.ground.iter().map(|s| stretch(s.from, s.to, s.state.name())).collect();
        let row = |row: &Row| {
            json!({
                "t": row.t, "range_m": row.range_m, "x": row.at[0], "y": row.at[1], "ground": row.ground_m,
                "line": row.line_m, "clearance": row.ground_m.map(|z| row.line_m - z), "known_after": row.known_after,
            })
        };
        let mut document = json!({
            "verdict": self.verdict.name(), "a": self.ends[0], "b": self.ends[1], "range_m": self.range_m,
            "obstructed_at": self.obstruction(), "line": line, "ground": ground, "breaks": self.rows.len(),
        });
        if whole {
            document["breaks"] = self.rows.iter().map(row).collect();
        }
        document
    }
}

/// Whether the ground at t is seen; a boundary, such as a crest, is.
fn ground_at(stretches: &[Stretch<GroundState>], t: f64) -> Option<GroundState> {
    let at = || stretches.iter().filter(|s| s.from <= t && t <= s.to).map(|s| s.state);
    [GroundState::Seen, GroundState::Hidden].into_iter().find(|&state| at().any(|s| s == state)).or_else(|| at().next())
}
