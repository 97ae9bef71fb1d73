//! Lines of sight by Sightline, by a plain walk over the grid in f64, and by the height field of parry3d: the same
//! queries in one run, in the order in which they were drawn, on one core (a batch on two as well, its sorting timed);
//! answers checked, ratios printed, each the best of some rounds.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml -- [DATABASE] [--side N]`: a synthetic terrain by default,
//! or the south-western N x N posts (4097) of a database.
//!
//! With `--only exact|batch|grid --lines long|short [--count N]` nothing else is asked, and all in the function
//! [`measured`], for `instructions.sh` to count. With `--export FOLDER` the heights (f32, row by row from the south) and
//! the lines (f64, six each) are written for `embree.py`. An answer is wrong when it is not the exact walk's and raising
//! and lowering the line by a millionth of a height unit does not change that one.

mod grid_walk;
mod parry;

use std::{error::Error, fs, path::Path, time::Instant};

use sightline::{
    database::{Database, OpenOptions},
    los::{Answer, Earth, Lines, Options, Precision, Verdict, line_of_sight_batch, on_ground},
    terrain::{HeightField, MemoryField, synthetic},
};

use sightline_bench::cut;

use grid_walk::GridWalk;
use parry::Parry;

/// Ends stand this far above the ground, in metres.
const ABOVE_M: f64 = 2.0;
/// Longest short line.
const SHORT_M: f64 = 1000.0;
/// Metres per post and per height unit of the synthetic terrain.
const SYNTHETIC_POST_M: f64 = 30.0;
/// Each way is timed so often, in turn with the others.
const ROUNDS: usize = 5;
/// How far a line is moved to see whether it is near a tie, in height units.
const NEAR: f64 = 1e-6;

const EXACT: Options = Options { strict: false, precision: Precision::Exact, earth: Earth::Flat };
const F64: Options = Options { strict: false, precision: Precision::F64, earth: Earth::Flat };
const FAST: Options = Options { strict: false, precision: Precision::Fast, earth: Earth::Flat };
/// A metre, where that is the height unit.
const TOLERANT: Options = Options { strict: false, precision: Precision::Tolerance(1.0), earth: Earth::Flat };

type Line = [[f64; 3]; 2];

/// What the command line asks for.
#[derive(Default)]
struct Asked {
    database: Option<String>,
    side: Option<u32>,
    only: Option<String>,
    lines: Option<String>,
    count: Option<u64>,
    export: Option<String>,
}

impl Asked {
    fn parse() -> Result<Self, Box<dyn Error>> {
        let mut asked = Self::default();
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
            match argument.as_str() {
                "--side" => asked.side = Some(value()?.parse()?),
                "--only" => asked.only = Some(value()?),
                "--lines" => asked.lines = Some(value()?),
                "--count" => asked.count = Some(value()?.parse()?),
                "--export" => asked.export = Some(value()?),
                _ => asked.database = Some(argument),
            }
        }
        Ok(asked)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let asked = Asked::parse()?;
    let side = asked.side.unwrap_or(4097);
    let database = match &asked.database {
        Some(path) => Some(Database::open(Path::new(path), OpenOptions::default())?),
        None => None,
    };
    let (field, post_m, unit_m) = match &database {
        Some(database) => {
            let scale = database.scale();
            let field = cut(database, [0, 0], side, |post| (!post.void).then_some(post.z))?;
            (field, [scale.east_m, scale.north_m], scale.up_m)
        }
        None => (synthetic::fractal(side, side, 1, 1000)?, [SYNTHETIC_POST_M; 2], 1.0),
    };
    let grid_walk = GridWalk::new(&field)?;
    let mut parry = None;
    for (name, count, reach_m) in [("long", 20_000, f64::INFINITY), ("short", 200_000, SHORT_M)] {
        if asked.lines.as_ref().is_some_and(|only| only != name) {
            continue;
        }
        let count = asked.count.unwrap_or(count);
        let lines = draw(&field, count, reach_m, post_m, ABOVE_M / unit_m)?;
        if let Some(folder) = &asked.export {
            export(Path::new(folder), name, &grid_walk, &lines)?;
        } else if let Some(only) = &asked.only {
            let mut way = match only.as_str() {
                "grid" => one_by_one("grid", &lines, |&line| grid_walk.is_blocked(line)),
                "batch" => batch("batch", 1, &field, &lines)?,
                _ => by("exact", &field, &lines, EXACT),
            };
            let blocked = if only == "batch" { (way.ask)() } else { measured(|| (way.ask)()) };
            let blocked = blocked.into_iter().filter(|blocked| *blocked).count();
            println!("{name}, {only}: {blocked} of {} blocked", lines.len());
        } else {
            let parry = match &parry {
                Some(parry) => parry,
                None => parry.insert(Parry::new(&field)?),
            };
            compare(name, &field, database.as_ref(), &grid_walk, parry, &lines)?;
        }
    }
    Ok(())
}

/// Writes what others need to ask the same.
fn export(folder: &Path, name: &str, grid_walk: &GridWalk, lines: &[Line]) -> Result<(), Box<dyn Error>> {
    let heights: Vec<u8> = grid_walk.heights().iter().flat_map(|z| z.to_le_bytes()).collect();
    fs::write(folder.join("heights.f32"), heights)?;
    let numbers: Vec<u8> = lines.iter().flatten().flatten().flat_map(|v| v.to_le_bytes()).collect();
    Ok(fs::write(folder.join(format!("{name}.f64")), numbers)?)
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

/// A way to ask all lines: whether each is blocked.
struct Way<'a> {
    name: &'static str,
    ask: Box<dyn FnMut() -> Vec<bool> + 'a>,
}

/// A way that asks one line after the other.
fn one_by_one<'a>(name: &'static str, lines: &'a [Line], mut ask: impl FnMut(&Line) -> bool + 'a) -> Way<'a> {
    Way { name, ask: Box::new(move || lines.iter().map(&mut ask).collect()) }
}

fn is_blocked<E>(answer: Result<Answer, E>) -> bool {
    answer.is_ok_and(|answer| answer.verdict == Verdict::Blocked)
}

/// All that `instructions.sh` counts.
#[inline(never)]
fn measured<T>(ask: impl FnOnce() -> T) -> T {
    ask()
}

/// The product, one line after the other.
fn by<'a, H: HeightField>(name: &'static str, field: &'a H, lines: &'a [Line], options: Options) -> Way<'a> {
    let mut own = Lines::new(field);
    one_by_one(name, lines, move |&[a, b]| is_blocked(own.ask(a, b, options)))
}

/// Batches on so many cores.
fn batch<'a>(
    name: &'static str,
    cores: usize,
    field: &'a MemoryField,
    lines: &'a [Line],
) -> Result<Way<'a>, Box<dyn Error>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cores).build()?;
    let ask = move || {
        let answers = pool.install(|| measured(|| line_of_sight_batch(field, lines, EXACT))).unwrap_or_default();
        answers.iter().map(|answer| answer.verdict == Verdict::Blocked).collect()
    };
    Ok(Way { name, ask: Box::new(ask) })
}

fn compare(
    what: &str,
    field: &MemoryField,
    database: Option<&Database>,
    grid_walk: &GridWalk,
    parry: &Parry,
    lines: &[Line],
) -> Result<(), Box<dyn Error>> {
    let exactly = |[a, b]: Line| is_blocked(Lines::plain(field).ask(a, b, EXACT));
    let mut plain = Lines::plain(field);
    let mut ways = vec![
        one_by_one("plain exact walk", lines, move |&[a, b]| is_blocked(plain.ask(a, b, EXACT))),
        one_by_one("grid walk, f64", lines, |&line| grid_walk.is_blocked(line)),
        one_by_one("parry3d, f64", lines, |&line| parry.is_blocked(line)),
        batch("exact, batch", 1, field, lines)?,
        batch("exact, two cores", 2, field, lines)?,
        by("exact", field, lines, EXACT),
        by("f64", field, lines, F64),
        by("fast", field, lines, FAST),
        by("within 1 unit", field, lines, TOLERANT),
    ];
    ways.extend(database.map(|database| by("exact, from a file", database, lines, EXACT)));
    let mut seconds = vec![f64::INFINITY; ways.len()];
    let mut blocked = vec![Vec::new(); ways.len()];
    for _ in 0..ROUNDS {
        for (n, way) in ways.iter_mut().enumerate() {
            let started = Instant::now();
            blocked[n] = (way.ask)();
            seconds[n] = seconds[n].min(started.elapsed().as_secs_f64());
        }
    }
    let truth = &blocked[0];
    let seen = truth.iter().filter(|blocked| !**blocked).count();
    println!("\n{what}: {} lines, {:.1} % not blocked", lines.len(), 100.0 * seen as f64 / lines.len() as f64);
    println!("{:18} {:>10} {:>10} {:>10} {:>10} {:>6}", "", "million/s", "us a line", "x grid", "x parry3d", "wrong");
    for (n, way) in ways.iter().enumerate() {
        let wrong =
            (0..lines.len()).filter(|&k| blocked[n].get(k) != Some(&truth[k]) && !is_near_tie(lines[k], exactly));
        let (wrong, each) = (wrong.count(), seconds[n] / lines.len() as f64);
        let (grid, parry) = (seconds[1] / seconds[n], seconds[2] / seconds[n]);
        println!("{:18} {:10.3} {:10.3} {grid:10.2} {parry:10.2} {wrong:6}", way.name, 1e-6 / each, 1e6 * each);
    }
    Ok(())
}

/// Whether raising or lowering the line by very little changes its verdict.
fn is_near_tie(line: Line, exactly: impl Fn(Line) -> bool) -> bool {
    let moved = |by: f64| exactly(line.map(|[x, y, z]| [x, y, z + by]));
    moved(NEAR) != moved(-NEAR)
}
