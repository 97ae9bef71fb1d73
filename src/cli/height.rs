//! `sightline height`: the ground at points.

use std::{path::PathBuf, str::FromStr};

use serde_json::{Value, json};

use super::{Context, Failure, args::Plan, info, los::ask::place_failure, output::Output, table::Points};
use crate::{
    exercise::Site,
    los::{GroundPoint, ground_batch},
};

/// The columns appended to a file of points. Heights are in metres above the vertical datum; the normal of the ground
/// is a unit vector east, north and up.
const ANSWERS: &str = "ground_m,normal_east,normal_north,normal_up";
/// One more for points with a z.
const ABOVE: &str = "above_ground_m";

/// `X,Y` or `X,Y,Z`.
#[derive(Clone, Copy, PartialEq, Debug)]
struct At([f64; 2], Option<f64>);

impl FromStr for At {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |part: &str| match part.trim().parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(format!("'{part}' in '{text}' is not a finite number")),
        };
        match text.split(',').collect::<Vec<_>>()[..] {
            [x, y] => Ok(Self([number(x)?, number(y)?], None)),
            [x, y, z] => Ok(Self([number(x)?, number(y)?], Some(number(z)?))),
            _ => Err(format!("'{text}' is not X,Y or X,Y,Z: numbers with commas between them")),
        }
    }
}

/// Show how high the ground is at a point, or at many, and which way it faces.
///
/// With a third number, also how far that is above the ground (below, when negative). Where the ground is unknown,
/// values are missing.
///
/// Example: sightline height area.sightline --at -118.292,36.5785
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// A point, with a height to compare with the ground's if there are three numbers.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, required_unless_present = "batch")]
    at: Option<At>,
    /// A CSV file with columns x, y and maybe z, found by their header; other columns are kept. - is standard input.
    #[arg(long, value_name = "F.csv", conflicts_with = "at")]
    batch: Option<PathBuf>,
    /// Where the points of a batch go, with their answers appended; - is standard output.
    #[arg(short, value_name = "F.csv", default_value = "-", requires = "batch")]
    output: PathBuf,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    plan: Plan,
}

/// An answer in metres.
struct Found {
    ground: GroundPoint,
    ground_m: f64,
    above_m: Option<f64>,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        match (&self.at, &self.batch) {
            (Some(At(plan, z)), None) => {
                let found = self.ask(&[(*plan, *z)])?;
                let document = document(found.first().and_then(Option::as_ref));
                if context.json {
                    outln!("{document:#}");
                } else {
                    out!("{}", text(found.first().and_then(Option::as_ref)));
                }
                Ok(())
            }
            (None, Some(input)) => {
                // A batch on standard output is a document in itself.
                let quiet = Context { json: false, ..context.clone() };
                let output = Output::new(&quiet, &self.output, self.force)?;
                let points = Points::read(input, true)?;
                let found = self.ask(&points.points)?;
                if context.json && output.is_standard() {
                    let answers: Vec<_> = found.iter().map(|found| document(found.as_ref())).collect();
                    outln!("{:#}", json!({ "answers": answers }));
                    return Ok(());
                }
                output.text(&csv(&points, &found))?;
                let known = found.iter().flatten().count();
                if context.json {
                    outln!("{:#}", json!({ "points": found.len(), "known": known, "output": self.output }));
                } else if !context.quiet {
                    errln!("{} points, {} of them over known ground", found.len(), known);
                }
                Ok(())
            }
            _ => Err(Failure::Usage("give either --at or --batch".into())),
        }
    }

    fn ask(&self, points: &[([f64; 2], Option<f64>)]) -> Result<Vec<Option<Found>>, Failure> {
        let database = info::open(&self.database)?;
        let site = Site { scale: database.scale(), georeference: database.georeference() };
        let frame = self.plan.frame();
        let plans: Result<Vec<_>, _> = points.iter().map(|&([x, y], _)| site.grid_from_plan(frame, x, y)).collect();
        let plans = plans.map_err(place_failure)?;
        let grounds = ground_batch(&database, site.scale, &plans).map_err(|error| place_failure(error.into()))?;
        let up_m = site.scale.up_m;
        let found = grounds.into_iter().zip(points).map(|(ground, &(_, z))| {
            let ground = ground?;
            let ground_m = ground.height * up_m;
            let above_m = z.map(|z| z * site.units_up(frame) * up_m - ground_m);
            Some(Found { ground, ground_m, above_m })
        });
        Ok(found.collect())
    }
}

fn document(found: Option<&Found>) -> Value {
    match found {
        None => json!({ "known": false }),
        Some(found) => json!({
            "known": true, "ground_m": found.ground_m, "height_units": found.ground.height,
            "normal": found.ground.normal, "above_ground_m": found.above_m,
        }),
    }
}

fn text(found: Option<&Found>) -> String {
    let Some(found) = found else { return "unknown: a void post, or outside the terrain\n".into() };
    let mut text = format!("ground    {} m\n", found.ground_m);
    if let Some([east, north, up]) = found.ground.normal {
        text += &format!("normal    {east:.4} east, {north:.4} north, {up:.4} up\n");
    }
    if let Some(above) = found.above_m {
        text += &format!("above     {above} m\n");
    }
    text
}

fn csv(points: &Points, found: &[Option<Found>]) -> String {
    let with_z = points.points.iter().any(|(_, z)| z.is_some());
    let mut out = format!("{},{ANSWERS}{}\n", points.header, if with_z { format!(",{ABOVE}") } else { String::new() });
    for (row, found) in points.rows.iter().zip(found) {
        let value = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        let normal = found.as_ref().and_then(|f| f.ground.normal);
        let mut fields = vec![row.clone(), value(found.as_ref().map(|f| f.ground_m))];
        fields.extend((0..3).map(|k| value(normal.map(|n| n[k]))));
        if with_z {
            fields.push(value(found.as_ref().and_then(|f| f.above_m)));
        }
        out += &(fields.join(",") + "\n");
    }
    out
}
