//! `sightline ingest`: elevation files into a database.

use std::{path::PathBuf, time::Instant};

use serde_json::json;

use super::{Context, Failure, info::hex, progress::Progress};
use crate::{
    database::{self, IngestError, IngestOptions, Ingested, Stage, VoidPolicy, WriteError},
    dem,
};

/// Inputs that the manifest names; it has a limited length.
const SOURCES_NAMED: usize = 1000;

/// Turn elevation files into a terrain database.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// An elevation file, or several adjoining SRTM tiles.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The database to write.
    #[arg(short, value_name = "DB")]
    output: PathBuf,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
    /// Metres per height unit [default: 1 for integer samples, 1/64 for floating point].
    #[arg(long, value_name = "M")]
    unit: Option<f64>,
    /// What to do about posts without data: keep them void, or reject the input.
    #[arg(long, value_enum, default_value_t = Void::Keep)]
    void: Void,
    /// The sample value that means "no data", in place of the file's own.
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    nodata: Option<f64>,
    /// The horizontal reference system, in place of the file's own.
    #[arg(long, value_name = "EPSG:N", value_parser = parse_epsg)]
    crs: Option<u32>,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Void {
    Keep,
    Reject,
}

fn parse_epsg(text: &str) -> Result<u32, String> {
    let number = match text.split_once(':') {
        Some((authority, number)) if authority.eq_ignore_ascii_case("epsg") => number,
        _ => return Err(format!("'{text}' is not EPSG:N, such as EPSG:4326")),
    };
    number.parse().map_err(|_| format!("'{number}' in '{text}' is not the number of a reference system"))
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let started = Instant::now();
        super::args::refuse_existing(&self.output, self.force)?;
        if let Some(missing) = self.inputs.iter().find(|path| !path.exists()) {
            return Err(Failure::input(missing.display(), "no such file"));
        }
        let mut scan = Progress::new(context, "bytes");
        let dem_options = dem::OpenOptions { nodata: self.nodata, epsg: self.crs };
        let mut raster = dem::open(&self.inputs, &dem_options, &mut |p| scan.tell("scanning", p.done, p.total))
            .map_err(dem_failure)?;
        scan.finish();
        let info = raster.info().clone();
        if !context.quiet {
            eprintln!("{} x {} posts, {}", info.nx, info.ny, info.format);
            info.notes.iter().for_each(|note| eprintln!("note: {note}"));
        }
        let options = IngestOptions {
            unit_m: self.unit,
            voids: match self.void {
                Void::Keep => VoidPolicy::Keep,
                Void::Reject => VoidPolicy::Reject,
            },
            replace: self.force,
            sources: names(&self.inputs),
        };
        let mut progress = Progress::new(context, "posts");
        let done = database::ingest(&mut *raster, &self.output, &options, &mut |p| match p.stage {
            Stage::Reading => progress.tell("reading", p.done, p.total),
            Stage::Filling => progress.tell("filling voids", 0, 0),
            Stage::Measuring => progress.tell("measuring", p.done, p.total),
            Stage::Nesting => progress.tell("nesting", p.done, p.total),
            Stage::Writing => progress.tell("writing", p.done, p.total),
        });
        progress.finish();
        self.report(context, &done.map_err(failure)?, started.elapsed().as_secs_f64());
        Ok(())
    }

    fn report(&self, context: &Context, done: &Ingested, seconds: f64) {
        let bytes_per_post = done.written.file_bytes as f64 / done.posts as f64;
        if context.json {
            let seams = done.seams.map(|s| {
                json!({
                    "tiles": s.tiles, "missing_tiles": s.missing_tiles, "compared_posts": s.compared_posts,
                    "differing_posts": s.differing_posts, "largest_difference_m": s.largest_difference_m,
                    "filled_posts": s.filled_posts,
                })
            });
            let document = json!({
                "database": self.output, "version": hex(&done.written.version), "posts": done.posts,
                "void_posts": done.void_posts, "unit_m": done.unit_m, "bytes": done.written.file_bytes,
                "bytes_per_post": bytes_per_post, "seconds": seconds, "seams": seams,
            });
            println!("{document:#}");
            return;
        }
        if let Some(s) = done.seams {
            println!(
                "{} tiles: {} of {} shared posts differ, by at most {} m (the south-western tile won); {} void in one \
                 tile were known in another",
                s.tiles, s.differing_posts, s.compared_posts, s.largest_difference_m, s.filled_posts
            );
            if s.missing_tiles > 0 {
                println!("{} tiles of the rectangle are missing: void", s.missing_tiles);
            }
        }
        if done.void_posts > 0 {
            let share = 100.0 * done.void_posts as f64 / done.posts as f64;
            println!(
                "{} posts are void ({share:.2} %): filled for drawing, unknown to lines of sight",
                done.void_posts
            );
        }
        println!(
            "{}: {} posts in units of {} m, {} bytes ({bytes_per_post:.3} a post), version {}, {seconds:.1} s",
            self.output.display(),
            done.posts,
            done.unit_m,
            done.written.file_bytes,
            hex(&done.written.version)
        );
    }
}

/// The names of the inputs, without their folders.
fn names(inputs: &[PathBuf]) -> Vec<String> {
    let name = |path: &PathBuf| path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let mut names: Vec<_> = inputs.iter().take(SOURCES_NAMED).map(name).collect();
    if inputs.len() > SOURCES_NAMED {
        names.push(format!("and {} more", inputs.len() - SOURCES_NAMED));
    }
    names
}

fn dem_failure(error: dem::DemError) -> Failure {
    match error {
        dem::DemError::Io { .. } => Failure::Environment(error.to_string()),
        dem::DemError::NoInput => Failure::Usage(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

fn failure(error: IngestError) -> Failure {
    match error {
        IngestError::Dem(error) => dem_failure(error),
        IngestError::Unit(_) => Failure::Usage(error.to_string()),
        IngestError::Write(WriteError::Exists(_) | WriteError::Io { .. }) => Failure::Environment(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_systems_are_named_by_authority_and_number() {
        assert_eq!(parse_epsg("EPSG:32633"), Ok(32633));
        assert_eq!(parse_epsg("epsg:4326"), Ok(4326));
        for bad in ["4326", "EPSG:", "EPSG:-1", "ESRI:54009", ""] {
            assert!(parse_epsg(bad).is_err(), "{bad}");
        }
    }
}
