//! `sightline evaluate`: the trade report, from terrains to files.

mod csv;
mod html;
mod svg;
mod terrains;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
    time::Instant,
};

use serde_json::json;

use super::{Context, Failure, args::refuse_existing, generator::write, progress::Progress};
use crate::evaluate::trade::{self, Instrument, Plan, Step, TradeError};

/// The report's file.
const REPORT: &str = "report.html";

/// Measure what each level-of-detail system and each precision costs and gives, and write the trade report.
///
/// Terrains are a synthetic one and the demo's real one, and those of --dem. The report is one HTML file that needs no
/// other; beside it, each of its tables as CSV. All figures but times are the same in every run.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// Folder for the report and its tables.
    #[arg(short, value_name = "DIR")]
    output: PathBuf,
    /// Measure less: half a minute instead of several.
    #[arg(long)]
    quick: bool,
    /// Databases or elevation files; the middle of each is taken, up to 1025 posts a side (513 with --quick).
    #[arg(long, value_name = "FILE", num_args = 1..)]
    dem: Vec<PathBuf>,
    /// Replace the report if it exists.
    #[arg(long)]
    force: bool,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let report = self.output.join(REPORT);
        refuse_existing(&report, self.force)?;
        if let Some(missing) = self.dem.iter().find(|path| !path.exists()) {
            return Err(Failure::input(missing.display(), "no such file"));
        }
        let making = |error| Failure::environment(format!("making {}", self.output.display()), error);
        fs::create_dir_all(&self.output).map_err(making)?;
        let started = Instant::now();
        let progress = Mutex::new(Progress::new(context, "steps"));
        let tell = |step: Step<'_>| {
            if let Ok(mut progress) = progress.lock() {
                progress.tell(step.name, step.done as u64, step.total as u64);
            }
        };
        let instrument = Instrument { clock: &|| started.elapsed(), tell: &tell };
        let plan = if self.quick { Plan::quick() } else { Plan::full() };
        let worlds = terrains::load(&self.dem, &self.output, &plan, &instrument)?;
        let document = trade::run(&plan, &worlds, &instrument).map_err(failure)?;
        if let Ok(progress) = progress.into_inner() {
            progress.finish();
        }
        let mut files = vec![report.clone()];
        write(&report, html::page(&document).as_bytes())?;
        for table in document.tables() {
            let path = self.output.join(table.file).with_extension("csv");
            write(&path, csv::text(table).as_bytes())?;
            files.push(path);
        }
        tell_result(context, &report, &files, started.elapsed().as_secs_f64());
        Ok(())
    }
}

fn tell_result(context: &Context, report: &Path, files: &[PathBuf], seconds: f64) {
    if context.json {
        outln!("{:#}", json!({ "report": report, "files": files, "seconds": seconds }));
    } else {
        outln!("{}: {} tables beside it, {seconds:.0} s", report.display(), files.len() - 1);
    }
}

fn failure(error: TradeError) -> Failure {
    Failure::Input(format!("measuring: {error}"))
}
