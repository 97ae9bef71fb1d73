//! Viewsheds of a million posts: time a cell on one core, how many cells had to be asked, and how many are not what a
//! query of their own says.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin viewshed -- DATABASE [--export FOLDER]`, or without
//! a database over a synthetic terrain. With `--export` the heights around each observer (16 bits, for GDAL's EHdr
//! driver) and the cells are written for `gdal.py`, which asks gdal_viewshed for the same. With `--only` one viewshed
//! without comparison is all that is asked, in the function [`measured`], for `instructions.sh` to count.

use std::{error::Error, fmt::Write, fs, ops::ControlFlow, path::Path, time::Instant};

use sightline::{
    database::{Database, OpenOptions},
    los::{Earth, Lines, Options, Region, Summary, Tile, Verdict, View, on_ground, viewshed},
    terrain::{HeightField, PAGE_SIDE, PageId, Posts, synthetic},
};

/// Posts from the observer to the border of its region.
const REACH: u32 = 500;
/// Heights of the observer and of the targets above ground, in height units.
const ABOVE: [[f64; 2]; 3] = [[2.0, 2.0], [2.0, 0.0], [300.0, 0.0]];
/// Observers of each of them.
const PLACES: u64 = 2;
/// Each viewshed is timed so often.
const ROUNDS: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut database, mut folder, mut only) = (None, None, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--export" => folder = Some(arguments.next().ok_or("--export needs a folder")?),
            "--only" => only = true,
            _ => database = Some(argument),
        }
    }
    match database {
        Some(path) => run(&Database::open(Path::new(&path), OpenOptions::default())?, folder.as_deref(), only),
        None => run(&synthetic::fractal(2 * REACH + 200, 2 * REACH + 200, 1, 1000)?, folder.as_deref(), only),
    }
}

fn run<H: HeightField>(field: &H, folder: Option<&str>, only: bool) -> Result<(), Box<dyn Error>> {
    let places = if only { 1 } else { PLACES };
    for (n, [above, target]) in (0..).zip(ABOVE.iter().copied().cycle().take(places as usize * ABOVE.len())) {
        let at = |posts: u32, k: u64| REACH + (synthetic::mix(2 * n + k) % u64::from(posts - 2 * REACH)) as u32;
        let (i, j) = (at(field.grid().nx(), 0), at(field.grid().ny(), 1));
        let Some(z) = on_ground(field, i.into(), j.into(), above)? else { continue };
        let around = |v: u32| [v - REACH, v + REACH - 1];
        let view = View {
            observer: [i.into(), j.into(), z],
            target_height: target,
            region: Region::Rectangle { i: around(i), j: around(j) },
            strict: false,
            earth: Earth::Flat,
        };
        let (ns, summary, tiles) = time(field, &view, if only { 1 } else { ROUNDS })?;
        if only {
            println!("{} cells", cells(&summary));
            return Ok(());
        }
        let wrong = wrong(field, &view, &tiles)?;
        let share = |part: u64| 100.0 * part as f64 / cells(&summary) as f64;
        println!(
            "{n}: post ({i}, {j}), {above} above ground, targets {target}: {ns:.1} ns a cell, {:.2} % asked, {:.1} % \
             visible, {wrong} of {} cells wrong",
            share(summary.asked),
            share(summary.visible),
            cells(&summary)
        );
        if let Some(folder) = folder {
            export(field, &view, &tiles, &Path::new(folder).join(n.to_string()))?;
        }
    }
    Ok(())
}

fn cells(summary: &Summary) -> u64 {
    summary.visible + summary.blocked + summary.unknown
}

/// All that `instructions.sh` counts.
#[inline(never)]
fn measured<H: HeightField>(field: &H, view: &View) -> Result<(Summary, Vec<Tile>), Box<dyn Error>> {
    let mut tiles = Vec::new();
    let summary = viewshed(field, view, |tile, _| {
        tiles.push(tile);
        ControlFlow::Continue(())
    })?;
    Ok((summary, tiles))
}

/// The least time of so many rounds on one core, in nanoseconds a cell.
fn time<H: HeightField>(field: &H, view: &View, rounds: usize) -> Result<(f64, Summary, Vec<Tile>), Box<dyn Error>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut least = f64::INFINITY;
    let mut found = None;
    for _ in 0..rounds {
        let started = Instant::now();
        let result = pool.install(|| measured(field, view).map_err(|error| error.to_string()))?;
        least = least.min(started.elapsed().as_nanos() as f64);
        found = Some(result);
    }
    let (summary, tiles) = found.ok_or("no rounds")?;
    Ok((least / cells(&summary) as f64, summary, tiles))
}

/// The cells of tiles, by post.
fn posts(tiles: &[Tile]) -> impl Iterator<Item = ([u32; 2], Verdict)> {
    tiles.iter().flat_map(|tile| {
        (0..).zip(&tile.cells).filter_map(|(n, cell)| {
            let post = [tile.page.pi * PAGE_SIDE + n % PAGE_SIDE, tile.page.pj * PAGE_SIDE + n / PAGE_SIDE];
            cell.map(|verdict| (post, verdict))
        })
    })
}

/// Cells that differ from a query of their own.
fn wrong<H: HeightField>(field: &H, view: &View, tiles: &[Tile]) -> Result<u64, Box<dyn Error>> {
    let mut lines = Lines::new(field);
    let mut wrong = 0;
    for (post, verdict) in posts(tiles) {
        let [x, y] = post.map(f64::from);
        let own = match on_ground(field, x, y, view.target_height)? {
            Some(z) => lines.ask(view.observer, [x, y, z], Options::default())?.verdict,
            None => Verdict::Unknown,
        };
        wrong += u64::from(own != verdict);
    }
    Ok(wrong)
}

/// Heights and cells of the region, row by row from the north, and what says how they lie.
fn export<H: HeightField>(field: &H, view: &View, tiles: &[Tile], to: &Path) -> Result<(), Box<dyn Error>> {
    let Region::Rectangle { i: [west, east], j: [south, north] } = view.region else { return Ok(()) };
    let (columns, rows) = (east - west + 1, north - south + 1);
    let mut heights = Vec::new();
    let mut reader = Posts::new(field);
    for j in (south..=north).rev() {
        for i in west..=east {
            let page = reader.page(PageId { pi: i / PAGE_SIDE, pj: j / PAGE_SIDE })?;
            heights.extend((page.at(i % PAGE_SIDE, j % PAGE_SIDE).z as i16).to_le_bytes());
        }
    }
    let mut seen = vec![0_u8; columns as usize * rows as usize];
    for ([i, j], verdict) in posts(tiles) {
        seen[(north - j) as usize * columns as usize + (i - west) as usize] = u8::from(verdict == Verdict::Visible);
    }
    let [x, y, z] = view.observer;
    let ground = on_ground(field, x, y, 0.0)?.ok_or("an observer over void ground")?;
    let mut words = String::new();
    writeln!(words, "NROWS {rows}\nNCOLS {columns}\nNBANDS 1\nNBITS 16\nPIXELTYPE SIGNEDINT\nBYTEORDER I\nLAYOUT BIL")?;
    writeln!(words, "ULXMAP {west}\nULYMAP {north}\nXDIM 1\nYDIM 1")?;
    fs::write(to.with_extension("bil"), heights)?;
    fs::write(to.with_extension("hdr"), words)?;
    fs::write(to.with_extension("cells"), seen)?;
    Ok(fs::write(to.with_extension("view"), format!("{x} {y} {} {}\n", z - ground, view.target_height))?)
}
