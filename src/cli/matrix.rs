//! `sightline matrix`: which of a set of points see which.

use std::{fmt::Write, path::PathBuf};

use serde_json::json;

use super::{
    Context, Failure,
    args::{EarthShape, Positions},
    info,
    los::ask::place_failure,
    output::Output,
    table::{Points, quoted},
};
use crate::{
    exercise::{Place, Site},
    los::{Matrix, Options, Verdict, matrix},
};

/// Most points: eight million pairs.
const MAX_POINTS: usize = 4096;

/// Ask which of a set of points see which, exactly: each pair once.
///
/// Example: sightline matrix area.sightline --points posts.csv --altitude agl -o sees.csv
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// A CSV file with columns x, y, z and maybe name, found by their header; - is standard input.
    #[arg(long, value_name = "F.csv")]
    points: PathBuf,
    /// Where the matrix goes: .csv, a row and a column a point, or .json. - is standard output, as CSV.
    #[arg(short, value_name = "F.csv|json", default_value = "-")]
    output: PathBuf,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    positions: Positions,
    /// Whether touching the ground between two points blocks, too.
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    earth: EarthShape,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let output = Output::new(context, &self.output, self.force)?;
        let as_json = match output.extension().as_deref() {
            Some("json") => true,
            Some("csv") | None => false,
            Some(other) => return Err(Failure::Usage(format!("-o: '.{other}' is neither .csv nor .json"))),
        };
        let points = Points::read(&self.points, false)?;
        if points.rows.len() > MAX_POINTS {
            let (count, name) = (points.rows.len(), self.points.display());
            return Err(Failure::Input(format!("{name}: {count} points; at most {MAX_POINTS}, so split the file")));
        }
        let database = info::open(&self.database)?;
        let site = Site { scale: database.scale(), georeference: database.georeference() };
        let mut resolved = Vec::with_capacity(points.rows.len());
        for (&([x, y], z), line) in points.points.iter().zip(&points.numbers) {
            let position = [x, y, z.unwrap_or(0.0)];
            let place = Place { position, frame: self.positions.frame(), altitude: self.positions.altitude() };
            let point = site.grid_from_place(&database, &place, 0.0).map_err(place_failure);
            resolved.push(point.map_err(|failure| match failure {
                Failure::Input(why) => Failure::input(format!("{}: line {line}", self.points.display()), why),
                failure => failure,
            })?);
        }
        let options = Options { strict: self.strict, earth: self.earth.earth(site.scale)?, ..Options::default() };
        let found = matrix(&database, &resolved, options);
        let found = found.map_err(|error| place_failure(error.into()))?;
        let count = |verdict| found.count(verdict);
        let summary = json!({
            "points": found.len(), "pairs": found.len() * (found.len() - 1) / 2,
            "visible": count(Verdict::Visible), "blocked": count(Verdict::Blocked), "unknown": count(Verdict::Unknown),
        });
        if as_json {
            let document = json!({ "summary": summary, "points": points.names, "resolved": resolved,
                "verdicts": rows(&found).collect::<Vec<_>>() });
            output.text(&format!("{document}\n"))?;
        } else {
            output.text(&csv(&points.names, &found))?;
        }
        if context.json {
            outln!("{:#}", json!({ "summary": summary, "output": self.output }));
        } else if !context.quiet {
            errln!(
                "{} points: of {} pairs {} see each other, {} do not, {} unknown",
                summary["points"],
                summary["pairs"],
                summary["visible"],
                summary["blocked"],
                summary["unknown"]
            );
        }
        Ok(())
    }
}

fn rows(found: &Matrix) -> impl Iterator<Item = Vec<&'static str>> {
    (0..found.len()).map(|m| (0..found.len()).map(|n| found.between(m, n).name()).collect())
}

fn csv(names: &[String], found: &Matrix) -> String {
    let mut out = "name".to_owned();
    for name in names {
        // Writing to a String cannot fail.
        let _ = write!(out, ",{}", quoted(name));
    }
    out.push('\n');
    for (name, row) in names.iter().zip(rows(found)) {
        let _ = writeln!(out, "{},{}", quoted(name), row.join(","));
    }
    out
}
