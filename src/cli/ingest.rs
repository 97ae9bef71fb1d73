//! `sightline ingest`: elevation files into a database.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use serde_json::json;

use super::{
    Context, Failure,
    progress::{Part, Progress},
};
use crate::{
    database::{self, IngestError, IngestOptions, Ingested, Stage, VoidPolicy, WriteError},
    dem,
};

/// Inputs that the manifest names; it has a limited length.
const SOURCES_NAMED: usize = 1000;

/// Which part of the memory the input's readers may keep at hand: one in so many.
const READERS_SHARE: usize = 4;

/// What an ingest does, and how long each takes beside the others: as profiled on an SRTM mosaic, with more for the disk.
const STAGES: [Part; 4] = [("reading", 15), ("filling voids", 8), ("measuring", 65), ("writing", 12)];

/// Turn elevation files into a terrain database.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// An elevation file, or several on one lattice of posts.
    ///
    /// Read are SRTM .hgt (also zipped or gzipped), GeoTIFF and COG, DTED levels 0 to 2, Esri ASCII grids, raw rasters
    /// with a header (BIL, BIP, BSQ, FLT, ENVI), USGS ASCII DEM, and PNG (16-bit grey, Terrarium, Mapbox Terrain-RGB).
    /// Several files must have one spacing, or are resampled on request, and adjoin or overlap: where two know a post, the
    /// south-western one wins, and a known post beats one without data.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The database to write.
    #[arg(short, value_name = "DB", required_unless_present = "check")]
    output: Option<PathBuf>,
    /// Write nothing; report spikes, suspicious values and how far tiles disagree. Exit status 1 if there are any.
    ///
    /// A spike is a post that lies above (or below) all its neighbours, at least 5 of them known, by more than 50 m and
    /// more than twice the difference between the highest and the lowest of them. Suspicious values are those below
    /// -11,000 m or above 9,000 m, and -9999; suspicious seams are those where tiles differ by more than 16 m. None is
    /// ever changed.
    #[arg(long, conflicts_with = "output")]
    check: bool,
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
    /// How much memory to take at most: a number of KiB, MiB or GiB.
    ///
    /// What does not fit waits beside the output, in a file that takes as much room as the output does. Readers of the input
    /// keep at most a quarter of it at hand; what of a file of one strip or of profiles does not fit waits in the folder for
    /// temporary files (TMPDIR), which should not be in memory itself.
    #[arg(long, value_name = "SIZE", default_value = "512MiB", value_parser = parse_bytes)]
    memory: usize,
    /// How a PNG holds heights, in place of what its path says ("terrarium", "mapbox" or "terrain-rgb" in its name).
    #[arg(long, value_enum, value_name = "KIND")]
    png: Option<Png>,
    /// Bring files that are not on the lattice of the finest one to it; without this they are refused.
    #[arg(long, value_enum, value_name = "METHOD")]
    resample: Option<Resample>,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Resample {
    /// The height of the nearest post.
    Nearest,
    /// The bilinear mean of the four posts around; void where one of them is.
    Bilinear,
}

impl From<Resample> for dem::Resampling {
    fn from(method: Resample) -> Self {
        match method {
            Resample::Nearest => Self::Nearest,
            Resample::Bilinear => Self::Bilinear,
        }
    }
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Png {
    /// R * 256 + G + B / 256 - 32768 metres.
    Terrarium,
    /// -10000 + (R * 65536 + G * 256 + B) / 10 metres.
    Mapbox,
    /// 16-bit grey samples in metres.
    Gray16,
}

impl From<Png> for dem::PngHeights {
    fn from(png: Png) -> Self {
        match png {
            Png::Terrarium => Self::Terrarium,
            Png::Mapbox => Self::Mapbox,
            Png::Gray16 => Self::Gray16,
        }
    }
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

/// Bytes of a size such as 512MiB.
fn parse_bytes(text: &str) -> Result<usize, String> {
    let wrong = || format!("'{text}' is not a size such as 512MiB or 2GiB");
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let unit = match &text[digits..] {
        "KiB" => 1 << 10,
        "MiB" => 1 << 20,
        "GiB" => 1 << 30,
        _ => return Err(wrong()),
    };
    text[..digits].parse::<usize>().ok().and_then(|number| number.checked_mul(unit)).ok_or_else(wrong)
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let started = Instant::now();
        if let Some(output) = &self.output {
            super::args::refuse_existing(output, self.force)?;
        }
        if let Some(missing) = self.inputs.iter().find(|path| !path.exists()) {
            return Err(Failure::input(missing.display(), "no such file"));
        }
        let mut scan = Progress::new(context, "bytes");
        let dem_options = dem::OpenOptions {
            nodata: self.nodata,
            epsg: self.crs,
            png: self.png.map(Into::into),
            resample: self.resample.map(Into::into),
            memory_bytes: self.memory / READERS_SHARE,
        };
        let mut raster = dem::open(&self.inputs, &dem_options, &mut |p| scan.tell("scanning", p.done, p.total))
            .map_err(dem_failure)?;
        scan.finish();
        let info = raster.info().clone();
        if !context.quiet {
            errln!("{} x {} posts, {}", info.nx, info.ny, info.format);
            info.notes.iter().for_each(|note| errln!("note: {note}"));
        }
        let Some(output) = &self.output else { return super::check::run(&mut *raster, context) };
        let options = IngestOptions {
            unit_m: self.unit,
            voids: match self.void {
                Void::Keep => VoidPolicy::Keep,
                Void::Reject => VoidPolicy::Reject,
            },
            replace: self.force,
            sources: names(&self.inputs),
            memory_bytes: self.memory,
        };
        let mut progress = Progress::of_parts(context, "posts", &STAGES);
        let done = database::ingest(&mut *raster, output, &options, &mut |p| {
            let (name, _) = STAGES[match p.stage {
                Stage::Reading => 0,
                Stage::Filling => 1,
                Stage::Measuring => 2,
                Stage::Writing => 3,
            }];
            progress.tell(name, p.done, p.total);
        });
        progress.finish();
        report(context, output, &done.map_err(failure)?, started.elapsed().as_secs_f64());
        Ok(())
    }
}

fn report(context: &Context, output: &Path, done: &Ingested, seconds: f64) {
    let bytes_per_post = done.written.file_bytes as f64 / done.posts as f64;
    if context.json {
        let seams = done.seams.map(seams_json);
        let document = json!({
            "database": output, "version": database::version_digits(&done.written.version), "posts": done.posts,
            "void_posts": done.void_posts, "unit_m": done.unit_m, "bytes": done.written.file_bytes,
            "bytes_per_post": bytes_per_post, "seconds": seconds, "seams": seams,
        });
        outln!("{document:#}");
        return;
    }
    if let Some(seams) = done.seams {
        tell_seams(&seams);
    }
    if done.void_posts > 0 {
        let share = 100.0 * done.void_posts as f64 / done.posts as f64;
        outln!("{} posts are void ({share:.2} %): filled for drawing, unknown to lines of sight", done.void_posts);
    }
    outln!(
        "{}: {} posts in units of {} m, {} bytes ({bytes_per_post:.3} a post), version {}, {seconds:.1} s",
        output.display(),
        done.posts,
        done.unit_m,
        done.written.file_bytes,
        database::version_digits(&done.written.version)
    );
}

/// What the overlaps of a mosaic showed, as JSON.
pub(super) fn seams_json(s: dem::SeamReport) -> serde_json::Value {
    json!({
        "tiles": s.tiles, "missing_tiles": s.missing_tiles, "compared_posts": s.compared_posts,
        "differing_posts": s.differing_posts, "largest_difference_m": s.largest_difference_m,
        "filled_posts": s.filled_posts, "uncovered_posts": s.uncovered_posts,
    })
}

/// What the overlaps of a mosaic showed, in words.
pub(super) fn tell_seams(s: &dem::SeamReport) {
    outln!(
        "{} tiles: {} of {} shared posts differ, by at most {} m (the south-western tile won); {} void in one tile were \
         known in another",
        s.tiles,
        s.differing_posts,
        s.compared_posts,
        s.largest_difference_m,
        s.filled_posts
    );
    if s.missing_tiles > 0 {
        outln!("{} tiles of the rectangle are missing", s.missing_tiles);
    }
    if s.uncovered_posts > 0 {
        outln!("{} posts of the rectangle are in no tile: void", s.uncovered_posts);
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

pub(super) fn dem_failure(error: dem::DemError) -> Failure {
    match error {
        dem::DemError::Io { .. } => Failure::Environment(error.to_string()),
        dem::DemError::NoInput => Failure::Usage(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

fn failure(error: IngestError) -> Failure {
    match error {
        IngestError::Dem(error) => dem_failure(error),
        IngestError::Unit(_) | IngestError::Write(WriteError::Memory { .. }) => Failure::Usage(error.to_string()),
        IngestError::Write(WriteError::Exists(_) | WriteError::Io { .. }) => Failure::Environment(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_a_unit() {
        assert_eq!(parse_bytes("512MiB"), Ok(512 << 20));
        assert_eq!((parse_bytes("7KiB"), parse_bytes("2GiB")), (Ok(7 << 10), Ok(2 << 30)));
        for bad in
            ["", "512", "MiB", "-1MiB", "1.5GiB", "1 GiB", "1mib", "99999999999999999999MiB", "9999999999999999GiB"]
        {
            assert!(parse_bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn reference_systems_are_named_by_authority_and_number() {
        assert_eq!(parse_epsg("EPSG:32633"), Ok(32633));
        assert_eq!(parse_epsg("epsg:4326"), Ok(4326));
        for bad in ["4326", "EPSG:", "EPSG:-1", "ESRI:54009", ""] {
            assert!(parse_epsg(bad).is_err(), "{bad}");
        }
    }
}
