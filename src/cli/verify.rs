//! `sightline verify`: reads every page of a database and names those that are damaged.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicU64, Ordering},
};

use serde_json::json;

use super::{Context, Failure, info::open_failure, progress::Progress};
use crate::database;

/// Damage named in full; beyond it only counted.
const NAMED: usize = 100;

/// Check every page of a database. Status 1 when damage is found.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let mut progress = Progress::new(context, "pages");
        progress.tell("verifying", 0, 1);
        let done = AtomicU64::new(0);
        let found = database::verify(&self.database, &|more, total| {
            progress.at(done.fetch_add(more, Ordering::Relaxed) + more, total);
        });
        progress.finish();
        let name = self.database.display();
        let found = match found {
            Ok(found) => found,
            Err(error) if error.is_damage() => return Err(Failure::Found(format!("{name}: {error}"))),
            Err(error) => return Err(open_failure(&self.database, error)),
        };
        if context.json {
            let document = json!({
                "database": self.database, "bytes": found.bytes, "pages": found.pages, "good_pages": found.good_pages,
                "damage": found.damage, "unknown_sections": found.unknown_sections,
            });
            outln!("{document:#}");
        }
        for unknown in &found.unknown_sections {
            errln!("{name}: {unknown} is not checked");
        }
        if found.damage.is_empty() {
            if !context.json {
                outln!("{name}: sound, {} pages in {} bytes", found.pages, found.bytes);
            }
            return Ok(());
        }
        found.damage.iter().take(NAMED).for_each(|damage| errln!("{name}: {damage}"));
        if found.damage.len() > NAMED {
            errln!("{name}: and {} more", found.damage.len() - NAMED);
        }
        let bad = found.pages - found.good_pages;
        Err(Failure::Found(format!(
            "{name} is damaged: {bad} of {} pages cannot be read; ingest it again",
            found.pages
        )))
    }
}
