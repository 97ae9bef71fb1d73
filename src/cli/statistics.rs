//! `sightline info --statistics`, in words and as JSON.

use std::sync::atomic::{AtomicU64, Ordering};

use serde_json::json;

use super::{Context, progress::Progress};
use crate::{
    database::{self, DEVIATION_PERCENTS, Database, HEIGHT_BANDS, HEIGHT_PERCENTS, LevelStatistics, Statistics},
    terrain::ReadError,
};

/// Characters of the longest bar of a histogram.
const BAR: u64 = 40;

/// Looks at all of a database, with progress.
pub(super) fn of(database: &Database, context: &Context) -> Result<Statistics, ReadError> {
    let total = database.grid().posts();
    let mut progress = Progress::new(context, "posts");
    progress.tell("looking at all posts", 0, total);
    let done = AtomicU64::new(0);
    let found = database::statistics(database, &|more| {
        progress.at(done.fetch_add(more, Ordering::Relaxed) + more, total);
    });
    progress.finish();
    found
}

/// From the least to the greatest height of band `n`, in metres.
fn band_m(database: &Database, n: usize) -> [f64; 2] {
    let (lowest, highest) = database.height_range();
    let heights = i64::from(highest) - i64::from(lowest) + 1;
    let start = |n: usize| i64::from(lowest) + (heights * n as i64 + HEIGHT_BANDS as i64 - 1) / HEIGHT_BANDS as i64;
    [start(n), start(n + 1) - 1].map(|z| z as f64 * database.scale().up_m)
}

pub(super) fn document(database: &Database, found: &Statistics) -> serde_json::Value {
    let scale = database.scale();
    let heights = &found.heights;
    let quantiles: Vec<_> = HEIGHT_PERCENTS
        .iter()
        .zip(heights.quantiles)
        .map(|(percent, z)| json!({ "percent": percent, "height_m": z as f64 * scale.up_m }))
        .collect();
    let bands: Vec<_> = (0..)
        .zip(heights.bands)
        .map(|(n, posts)| {
            let [from_m, to_m] = band_m(database, n);
            json!({ "from_m": from_m, "to_m": to_m, "posts": posts })
        })
        .collect();
    let levels: Vec<_> = found.levels.iter().map(|level| level_document(level, database)).collect();
    json!({
        "heights": {
            "known_posts": heights.known_posts, "mean_m": heights.mean * scale.up_m,
            "standard_deviation_m": heights.standard_deviation * scale.up_m,
            "quantiles": quantiles, "bands": bands,
            "pages": heights.pages, "pages_with_voids": heights.pages_with_voids, "void_pages": heights.void_pages,
        },
        "levels": levels,
    })
}

fn level_document(level: &LevelStatistics, database: &Database) -> serde_json::Value {
    let scale = database.scale();
    let half_length = f64::from(level.half_length);
    let quantiles: Vec<_> = DEVIATION_PERCENTS
        .iter()
        .zip(level.quantiles)
        .map(|(percent, deviation)| json!({ "percent": percent, "deviation_m": f64::from(deviation) * scale.up_m }))
        .collect();
    json!({
        "level": level.level, "half_length_posts": level.half_length,
        "half_length_m": { "east": half_length * scale.east_m, "north": half_length * scale.north_m },
        "diamonds": level.diamonds, "flat": level.flat, "mean_deviation_m": level.mean * scale.up_m,
        "quantiles": quantiles, "greatest_deviation_m": f64::from(level.greatest) * scale.up_m,
    })
}

pub(super) fn lines(database: &Database, found: &Statistics) -> Vec<String> {
    let up_m = database.scale().up_m;
    let heights = &found.heights;
    let share = |posts: u64| 100.0 * posts as f64 / heights.known_posts.max(1) as f64;
    let mut lines = vec![format!(
        "known         {} posts, {:.1} m in the mean, standard deviation {:.1} m",
        heights.known_posts,
        heights.mean * up_m,
        heights.standard_deviation * up_m
    )];
    let quantiles: Vec<_> = HEIGHT_PERCENTS
        .iter()
        .zip(heights.quantiles)
        .map(|(percent, z)| format!("{percent} % up to {} m", z as f64 * up_m))
        .collect();
    lines.push(format!("              {}", quantiles.join(", ")));
    let most = heights.bands.into_iter().max().unwrap_or_default().max(1);
    for (n, posts) in (0..).zip(heights.bands) {
        let [from_m, to_m] = band_m(database, n);
        // A band between two heights holds none.
        if from_m <= to_m {
            let bar = "#".repeat((u128::from(posts) * u128::from(BAR)).div_ceil(u128::from(most)) as usize);
            lines.push(format!("  {from_m:>10} to {to_m:>10} m {posts:>12} posts {:6.2} % {bar}", share(posts)));
        }
    }
    lines.push(format!(
        "void pages    {} of {} pages of 64 x 64 posts have voids, {} are nothing else",
        heights.pages_with_voids, heights.pages, heights.void_pages
    ));
    lines.push("levels        how far the surface, voids as drawn, strays from the triangles of each level".to_owned());
    let percents = DEVIATION_PERCENTS.map(|percent| format!("{:>10}", format!("{percent} %, m"))).concat();
    lines.push(format!("  level half-length    diamonds      flat   mean, m{percents} greatest, m"));
    lines.extend(found.levels.iter().map(|level| level_line(level, up_m)));
    lines
}

fn level_line(level: &LevelStatistics, up_m: f64) -> String {
    let flat = 100.0 * level.flat as f64 / level.diamonds.max(1) as f64;
    let quantiles = level.quantiles.map(|deviation| format!("{:10.2}", f64::from(deviation) * up_m)).concat();
    format!(
        "  {:5} {:11} {:11} {flat:7.2} % {:9.3}{quantiles} {:11.2}",
        level.level,
        level.half_length,
        level.diamonds,
        level.mean * up_m,
        f64::from(level.greatest) * up_m
    )
}
