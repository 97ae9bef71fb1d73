//! `sightline replay`: makes the frames of a recorded server anew and compares them, or checks those of a recorded view.

use std::{
    fs::File,
    io::{BufReader, Read, Seek},
    path::PathBuf,
    sync::Arc,
};

use serde_json::json;

use super::{Context, Failure, info, progress::Progress};
use crate::{
    database::{
        Database,
        envelope::{HEADER_BYTES, Sealed},
    },
    evaluate::{
        oracle::FieldOracle,
        recording::{self, RECORDING_LIMIT, Recording},
    },
    service::ServedTerrain,
    session::{
        journal::{JournalError, JournalReader},
        replay::{Replay, Replayed},
    },
};

/// Bytes that are read at a time.
const BUFFER_BYTES: usize = 1 << 20;

/// Make every frame of a recording of `serve --record` anew, and compare it with the one that was sent, bit for bit; or
/// check a recording of `view --record`: every frame's hash, the verdicts on its mesh, and those that the server stated
/// against the finest terrain.
///
/// A recording whose server was killed may end within a record: that is said, and what comes before it is replayed. Exit
/// status 1 when a frame comes out otherwise or a verdict is wrong; 3 when the recording is damaged or belongs to another terrain.
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
        let mut file = File::open(&self.recording).map_err(|error| input(&error))?;
        let total = file.metadata().map_err(|error| input(&error))?.len();
        let mut magic = Vec::new();
        file.by_ref().take(8).read_to_end(&mut magic).map_err(|error| input(&error))?;
        file.rewind().map_err(|error| input(&error))?;
        if magic == Recording::MAGIC {
            return self.check_view(context, &database, file, total);
        }
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

    /// A recording of one view, as its client heard it.
    fn check_view(&self, context: &Context, database: &Database, file: File, total: u64) -> Result<(), Failure> {
        let name = self.recording.display();
        let input = |why: &dyn std::fmt::Display| Failure::input(&name, why);
        let limit = (RECORDING_LIMIT + HEADER_BYTES) as u64;
        if total > limit {
            return Err(input(&format!("{total} bytes; no recording of a view has more than {limit}")));
        }
        let mut bytes = Vec::new();
        file.take(limit).read_to_end(&mut bytes).map_err(|error| input(&error))?;
        let recorded = recording::open(&bytes).map_err(|error| input(&error))?;
        let mut progress = Progress::new(context, "messages");
        let messages = recorded.messages.len() as u64;
        progress.tell("checking", 0, messages);
        let mut truth = FieldOracle(database);
        let passed = &mut |n| progress.at(n as u64, messages);
        let found =
            recording::replay(&recorded, &database.version(), &mut truth, passed).map_err(|error| input(&error))?;
        progress.finish();
        if context.json {
            outln!("{:#}", json!({ "recording": self.recording, "cut": recorded.cut, "replayed": found }));
        } else {
            outln!("{} frames, each with the hash that it announces; the last {:016x}", found.frames, found.last_hash);
            outln!(
                "{} verdicts on their meshes, {} silent disagreements with the server's",
                found.comparisons,
                found.silent_disagreements
            );
            outln!(
                "{} verdicts of the server's asked anew on the finest terrain, {} of them wrong",
                found.judged,
                found.wrong_verdicts
            );
        }
        if recorded.cut {
            errln!("{name}: it ended at the limit of a recording, before its view did");
        }
        match (found.silent_disagreements, found.wrong_verdicts) {
            (0, 0) => Ok(()),
            (silent, wrong) => {
                Err(Failure::Found(format!("{name}: {silent} silent disagreements, {wrong} wrong verdicts")))
            }
        }
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
