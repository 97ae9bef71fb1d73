//! All error bounds of a terrain: time by number of threads, and some of them against every post below.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin bounds -- [DATABASE] [SIDE] [ROUNDS]`: a synthetic
//! terrain by default, or the north-eastern SIDE x SIDE posts (4097) of a database, held in memory. Under callgrind, one
//! round of a small side counts the instructions of a post.

use std::{error::Error, path::Path, time::Instant};

use sightline::{
    database::{Database, OpenOptions},
    terrain::{HeightField, MemoryField, Posts, SceneScale, synthetic},
    wedgie::BoundsPyramid,
};
use sightline_proto::diamond::{Post, Triangle};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const SCALE: SceneScale = SceneScale { east_m: 74.0, north_m: 92.5, up_m: 1.0 };
/// Diamonds compared with all posts below them, and the greatest exponent of their half-length.
const CHECKED: u32 = 400;
const CHECKED_EXPONENT: u32 = 6;
/// Bounds have 17 significant bits, rounded up.
const ROUNDED_UP: f64 = 1.0 + 1.0 / 65_536.0;

fn main() -> Result<()> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let number = |n: usize, default: u32| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (side, rounds) = (number(1, 4097)?, number(2, 5)?);
    let field = match arguments.first() {
        Some(path) => sightline_bench::north_east(&Database::open(Path::new(path), OpenOptions::default())?, side)?,
        None => synthetic::fractal(side, side, 1, 1000)?,
    };
    let posts = f64::from(field.grid().nx()) * f64::from(field.grid().ny());
    let mut found = None;
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let mut times_s = Vec::new();
        for _ in 0..rounds {
            let start = Instant::now();
            let pyramid = pool.install(|| BoundsPyramid::compute(&field, SCALE))?;
            times_s.push(start.elapsed().as_secs_f64());
            if *found.get_or_insert_with(|| pyramid.clone()) != pyramid {
                return Err("the bounds depend on the number of threads".into());
            }
        }
        times_s.sort_by(f64::total_cmp);
        let (least, median) = (times_s[0], times_s[times_s.len() / 2]);
        println!(
            "{threads} threads: {least:.2} s at least, {median:.2} s median, {:.0} ns a post",
            1e9 * median / posts
        );
    }
    if let Some(pyramid) = found {
        check(&field, &pyramid)?;
    }
    Ok(())
}

/// Some diamonds, each against the posts of the grid below it.
fn check(field: &MemoryField, pyramid: &BoundsPyramid) -> Result<()> {
    let grid = field.grid();
    let mut posts = Posts::new(field);
    for n in 0..CHECKED {
        let random = |k: u64, below: u32| (synthetic::mix(u64::from(n) * 4 + k) % u64::from(below)) as u32;
        let step = 1 << (1 + random(0, CHECKED_EXPONENT));
        let p = Post::new(random(1, grid.nx()) / step * step, random(2, grid.ny()) / step * step);
        let Some(bounds) = pyramid.get(p).filter(|_| (p.i | p.j).trailing_zeros() <= CHECKED_EXPONENT) else {
            continue;
        };
        let mut greatest = 0.0_f64;
        for triangle in grid.root().triangles(p) {
            let corners = triangle.corners();
            let z: Vec<f64> =
                corners.iter().map(|&p| posts.at(p).map(|post| post.z)).collect::<std::result::Result<_, _>>()?;
            let [low, high] = [0, 1].map(|end| {
                let pick = |of: fn(&Post) -> u32| {
                    let all = corners.iter().map(of);
                    if end == 0 { all.min() } else { all.max() }.unwrap_or(0)
                };
                Post::new(pick(|p| p.i), pick(|p| p.j))
            });
            for j in low.j..=high.j.min(grid.ny() - 1) {
                for i in low.i..=high.i.min(grid.nx() - 1) {
                    if let Some(plane) = plane_height(&triangle, &z, Post::new(i, j)) {
                        greatest = greatest.max((posts.at(Post::new(i, j))?.z - plane).abs());
                    }
                }
            }
        }
        let tight = f64::from(bounds.tight);
        if tight < greatest || tight > greatest * ROUNDED_UP + 1e-9 || bounds.nested < bounds.tight {
            return Err(format!("{bounds:?} at {p:?}, where the greatest deviation is {greatest}").into());
        }
    }
    println!("{CHECKED} diamonds drawn at random have the greatest deviation of all posts below them");
    Ok(())
}

/// The height of the plane over a post in the closed triangle, by weights of the corners.
fn plane_height(triangle: &Triangle, z: &[f64], p: Post) -> Option<f64> {
    let area = |a: Post, b: Post, c: Post| {
        let [a, b, c] = [a, b, c].map(|p| (i64::from(p.i), i64::from(p.j)));
        (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)
    };
    let [a, b, c] = triangle.corners();
    let weights = [area(b, c, p), area(c, a, p), area(a, b, p)];
    let total: i64 = weights.iter().sum();
    (weights.iter().all(|&w| w >= 0))
        .then(|| z.iter().zip(weights).map(|(z, w)| z * w as f64).sum::<f64>() / total as f64)
}
