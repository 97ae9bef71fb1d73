//! Lines of sight by Sightline, by a plain walk over the grid in f64, and by the height field of parry3d: the same
//! queries in one run, in the order in which they were drawn, on one core; answers checked, ratios printed.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml -- [DATABASE] [SIDE]`: a synthetic terrain by default,
//! or the south-western SIDE x SIDE posts (4097) of a database. An answer is wrong when it is not the exact walk's and
//! raising and lowering the line by a millionth of a height unit does not change that one.

mod grid_walk;
mod parry;

use std::{error::Error, path::Path, time::Instant};

use sightline::{
    database::{Database, OpenOptions},
    los::{Lines, Options, Precision, Verdict, on_ground},
    terrain::{HeightField, MemoryField, PAGE_SIDE, PageId, synthetic},
};

use grid_walk::GridWalk;
use parry::Parry;

/// Ends stand this far above the ground, in metres.
const ABOVE_M: f64 = 2.0;
/// Longest short line.
const SHORT_M: f64 = 1000.0;
/// Metres per post and per height unit of the synthetic terrain.
const SYNTHETIC_POST_M: f64 = 30.0;
/// How far a line is moved to see whether it is near a tie, in height units.
const NEAR: f64 = 1e-6;

const EXACT: Options = Options { strict: false, precision: Precision::Exact };
const F64: Options = Options { strict: false, precision: Precision::F64 };
const FAST: Options = Options { strict: false, precision: Precision::Fast };
/// A metre, where that is the height unit.
const TOLERANT: Options = Options { strict: false, precision: Precision::Tolerance(1.0) };

type Line = [[f64; 3]; 2];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let database = arguments.next();
    let side: u32 = arguments.next().map_or(Ok(4097), |side| side.parse())?;
    let (field, post_m, unit_m) = match &database {
        Some(path) => cut(Path::new(path), side)?,
        None => (synthetic::fractal(side, side, 1, 1000)?, [SYNTHETIC_POST_M; 2], 1.0),
    };
    let grid_walk = GridWalk::new(&field)?;
    let parry = Parry::new(&field)?;
    for (name, count, reach_m) in [("long", 20_000, f64::INFINITY), ("short", 200_000, SHORT_M)] {
        let lines = draw(&field, count, reach_m, post_m, ABOVE_M / unit_m)?;
        compare(name, &field, &grid_walk, &parry, &lines)?;
    }
    Ok(())
}

/// The south-west of a database in memory, metres per post, and metres per height unit.
fn cut(path: &Path, side: u32) -> Result<(MemoryField, [f64; 2], f64), Box<dyn Error>> {
    let database = Database::open(path, OpenOptions::default())?;
    let (nx, ny) = (database.grid().nx().min(side), database.grid().ny().min(side));
    let mut posts = sightline::terrain::Posts::new(&database);
    let mut failure = None;
    let field =
        MemoryField::from_fn(nx, ny, |i, j| match posts.page(PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE }) {
            Ok(page) => {
                let post = page.at(i % PAGE_SIDE, j % PAGE_SIDE);
                (!post.void).then_some(post.z)
            }
            Err(error) => {
                failure = Some(error);
                None
            }
        })?;
    let scale = database.scale();
    failure.map_or(Ok((field, [scale.east_m, scale.north_m], scale.up_m)), |error| Err(error.into()))
}

/// Lines with both ends above known ground, the same in every run.
fn draw(
    field: &MemoryField,
    count: u64,
    reach_m: f64,
    post_m: [f64; 2],
    above: f64,
) -> Result<Vec<Line>, Box<dyn Error>> {
    let limits = [f64::from(field.grid().nx() - 1), f64::from(field.grid().ny() - 1)];
    let mut lines = Vec::new();
    for n in 0.. {
        let unit = |k: u64| (synthetic::mix(n * 8 + k) >> 11) as f64 / (1_u64 << 53) as f64;
        let from = [limits[0] * unit(0), limits[1] * unit(1)];
        let to = [0, 1].map(|k| {
            let reach = reach_m / post_m[k];
            if reach.is_finite() {
                from[k] + reach * (2.0 * unit(k as u64 + 2) - 1.0)
            } else {
                limits[k] * unit(k as u64 + 2)
            }
        });
        let apart_m = [0, 1].map(|k| (to[k] - from[k]) * post_m[k]);
        if apart_m[0] * apart_m[0] + apart_m[1] * apart_m[1] > reach_m * reach_m {
            continue;
        }
        let ends = [on_ground(field, from[0], from[1], above)?, on_ground(field, to[0], to[1], above)?];
        if let [Some(a), Some(b)] = ends {
            lines.push([[from[0], from[1], a], [to[0], to[1], b]]);
            if lines.len() as u64 == count {
                break;
            }
        }
    }
    Ok(lines)
}

/// What a way to ask took for all lines, and whether each is blocked.
struct Run {
    name: &'static str,
    seconds: f64,
    blocked: Vec<bool>,
}

fn time(name: &'static str, lines: &[Line], mut ask: impl FnMut(&Line) -> bool) -> Run {
    let started = Instant::now();
    let blocked = lines.iter().map(&mut ask).collect();
    Run { name, seconds: started.elapsed().as_secs_f64(), blocked }
}

fn compare(
    what: &str,
    field: &MemoryField,
    grid_walk: &GridWalk,
    parry: &Parry,
    lines: &[Line],
) -> Result<(), Box<dyn Error>> {
    let blocks = |verdict: Verdict| verdict == Verdict::Blocked;
    let exactly =
        |[a, b]: Line| -> Result<bool, Box<dyn Error>> { Ok(blocks(Lines::plain(field).ask(a, b, EXACT)?.verdict)) };
    let (mut walked, mut skipping) = (Lines::plain(field), Lines::new(field));
    let mut unread = false;
    let runs = [
        time("exact, skipping", lines, |&[a, b]| {
            let answer = skipping.ask(a, b, EXACT);
            unread |= answer.is_err();
            answer.is_ok_and(|answer| blocks(answer.verdict))
        }),
        time("exact, walking", lines, |&[a, b]| walked.ask(a, b, EXACT).is_ok_and(|answer| blocks(answer.verdict))),
        time("f64, skipping", lines, |&[a, b]| skipping.ask(a, b, F64).is_ok_and(|answer| blocks(answer.verdict))),
        time("f32, skipping", lines, |&[a, b]| skipping.ask(a, b, FAST).is_ok_and(|answer| blocks(answer.verdict))),
        time("within 1 unit", lines, |&[a, b]| skipping.ask(a, b, TOLERANT).is_ok_and(|answer| blocks(answer.verdict))),
        time("grid walk, f64", lines, |&line| grid_walk.is_blocked(line)),
        time("parry3d, f64", lines, |&line| parry.is_blocked(line)),
    ];
    let truth = &runs[1].blocked;
    let seen = truth.iter().filter(|blocked| !**blocked).count();
    println!("\n{what}: {} lines, {:.1} % not blocked", lines.len(), 100.0 * seen as f64 / lines.len() as f64);
    println!("{:18} {:>12} {:>9} {:>8} {:>7}", "", "million/s", "us a line", "ratio", "wrong");
    for run in &runs {
        let mut wrong = 0;
        for (n, line) in lines.iter().enumerate().filter(|&(n, _)| run.blocked[n] != truth[n]) {
            let moved = |by: f64| line.map(|[x, y, z]| [x, y, z + by]);
            wrong += usize::from(exactly(moved(NEAR))? == exactly(moved(-NEAR))? && run.blocked[n] != truth[n]);
        }
        let rate = lines.len() as f64 / run.seconds;
        println!(
            "{:18} {:12.3} {:9.2} {:8.2} {wrong:7}",
            run.name,
            rate / 1e6,
            1e6 / rate,
            runs[0].seconds / run.seconds
        );
    }
    if unread { Err("the terrain could not be read".into()) } else { Ok(()) }
}
