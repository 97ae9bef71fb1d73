//! `sightline ingest --check`: what is suspicious in elevation files, without writing anything.

use serde_json::json;

use super::{
    Context, Failure,
    ingest::{dem_failure, seams_json, tell_seams},
    progress::Progress,
};
use crate::dem::{
    Raster,
    check::{CheckReport, Extreme, MAX_FINDINGS, SEAM_M, check},
};

/// Reads all of `raster` and reports.
pub(super) fn run(raster: &mut dyn Raster, context: &Context) -> Result<(), Failure> {
    let mut progress = Progress::new(context, "posts");
    let found = check(raster, &mut |p| progress.tell("checking", p.done, p.total));
    progress.finish();
    let found = found.map_err(dem_failure)?;
    if context.json {
        outln!("{:#}", document(&found));
    } else {
        tell(&found, raster);
    }
    if !found.is_suspicious() {
        return Ok(());
    }
    let mut what = Vec::new();
    if found.suspicious_posts() > 0 {
        what.push(format!("{} suspicious posts", found.suspicious_posts()));
    }
    if found.are_seams_suspicious() {
        what.push(format!("tiles that differ by more than {SEAM_M} m where they share posts"));
    }
    if found.extremes.is_none() {
        what.push("no post with data".to_owned());
    }
    Err(Failure::Found(format!("found {}", what.join(" and "))))
}

fn document(found: &CheckReport) -> serde_json::Value {
    let extreme = |e: Extreme| json!({ "i": e.i, "j": e.j, "height_m": e.height_m });
    let findings: Vec<_> = found
        .findings
        .iter()
        .map(|f| json!({ "i": f.i, "j": f.j, "height_m": f.height_m, "suspicion": f.suspicion.words() }))
        .collect();
    json!({
        "posts": found.posts, "void_posts": found.void_posts,
        "lowest": found.extremes.map(|[lowest, _]| extreme(lowest)),
        "highest": found.extremes.map(|[_, highest]| extreme(highest)),
        "spikes": found.spikes, "pits": found.pits, "out_of_range": found.out_of_range, "marks": found.marks,
        "findings": findings, "seams": found.seams.map(seams_json), "suspicious": found.is_suspicious(),
    })
}

fn tell(found: &CheckReport, raster: &dyn Raster) {
    let place = &raster.info().georeference;
    let at = |i: u32, j: u32| {
        let [x, y] = place.map_from_grid(f64::from(i), f64::from(j));
        format!("post ({i}, {j}) at ({x:.6}, {y:.6})")
    };
    let share = 100.0 * found.void_posts as f64 / found.posts as f64;
    outln!("{} posts, {} of them void ({share:.2} %)", found.posts, found.void_posts);
    if let Some([lowest, highest]) = found.extremes {
        outln!("lowest {} m, {}", lowest.height_m, at(lowest.i, lowest.j));
        outln!("highest {} m, {}", highest.height_m, at(highest.i, highest.j));
    }
    if let Some(seams) = found.seams {
        tell_seams(&seams);
    }
    outln!(
        "{} spikes above and {} below their neighbours, {} heights out of the Earth's range, {} of -9999 m",
        found.spikes,
        found.pits,
        found.out_of_range,
        found.marks
    );
    for f in &found.findings {
        outln!("{}: {} m, {}", at(f.i, f.j), f.height_m, f.suspicion.words());
    }
    if found.suspicious_posts() > MAX_FINDINGS as u64 {
        outln!("and {} more", found.suspicious_posts() - MAX_FINDINGS as u64);
    }
}
