//! `sightline replay`: makes the frames of a recorded server anew and compares them.

use std::{fs::File, io::BufReader, path::PathBuf, sync::Arc};

use serde_json::json;

use super::{Context, Failure, info, progress::Progress};
use crate::{
    database::Database,
    service::ServedTerrain,
    session::{
        journal::{JournalError, JournalReader},
        replay::{Replay, Replayed},
    },
};

/// Bytes that are read at a time.
const BUFFER_BYTES: usize = 1 << 20;

/// Make every frame of a recording of `serve --record` anew, and compare it with the one that was sent, bit for bit.
///
/// A recording whose server was killed may end within a record: that is said, and what comes before it is replayed. Exit
/// status 1 when a frame comes out otherwise; 3 when the recording is damaged or belongs to another terrain.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The recording.
    #[arg(value_name = "F")]
    recording: PathBuf,
    /// The database that was served.
    #[arg(long, value_name = "DB")]
    db: PathBuf,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let database = Arc::new(info::open(&self.db)?);
        let name = self.recording.display();
        let input = |why: &dyn std::fmt::Display| Failure::input(&name, why);
        let file = File::open(&self.recording).map_err(|error| input(&error))?;
        let total = file.metadata().map_err(|error| input(&error))?.len();
        let details = database.details().map_err(|error| Failure::input(self.db.display(), error))?;
        let site = ServedTerrain::site(&*database);
        let mut replay = Replay::<Database>::new(database, site, &details)
            .map_err(|error| Failure::input(self.db.display(), error))?;
        let mut reader = JournalReader::new(BufReader::with_capacity(BUFFER_BYTES, file));
        let mut progress = Progress::new(context, "bytes");
        progress.tell("replaying", 0, total);
        let mut records = 0_u64;
        let cut = loop {
            match reader.next_entry() {
                Ok(Some(entry)) => replay.take(entry).map_err(|error| input(&format!("record {records}: {error}")))?,
                Ok(None) if records == 0 => return Err(input(&"it is empty")),
                Ok(None) => break None,
                Err(cut @ JournalError::Cut { .. }) if records > 0 => break Some(cut.to_string()),
                Err(error) => return Err(input(&error)),
            }
            records += 1;
            progress.at(reader.bytes(), total);
        };
        progress.finish();
        self.report(context, records, cut.as_deref(), replay.found())
    }

    fn report(&self, context: &Context, records: u64, cut: Option<&str>, found: &Replayed) -> Result<(), Failure> {
        let name = self.recording.display();
        if context.json {
            let document = json!({
                "recording": self.recording, "records": records, "cut": cut, "replayed": found,
                "identical": found.different_frames == 0,
            });
            outln!("{document:#}");
        } else {
            outln!(
                "{} frames of {} views made anew from {records} records, {} changes of exercises among them",
                found.frames,
                found.views,
                found.exercise_changes
            );
            let same = found.frames - found.different_frames;
            outln!(
                "{same} are what was sent, byte for byte ({} bytes); {} differ",
                found.bytes,
                found.different_frames
            );
            outln!("sum of their hashes {:016x}", found.hash_sum);
        }
        match cut {
            Some(cut) => errln!("{name}: {cut}"),
            None if !found.has_ended => errln!("{name}: it has no end: its server was killed"),
            None if found.is_full => errln!("{name}: it ended at its limit, before its server did"),
            None => {}
        }
        for difference in &found.differences {
            errln!("view {}, frame {}: {}", difference.view, difference.sequence, difference.what);
        }
        match found.different_frames {
            0 => Ok(()),
            differ => Err(Failure::Found(format!("{name}: {differ} of {} frames come out otherwise", found.frames))),
        }
    }
}
