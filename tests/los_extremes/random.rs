//! Random lines: the rational reference against the plain exact walk (no filter, no skipping), and that walk, which is
//! a thousand times as fast, against the product.
//!
//! `SIGHTLINE_QUERIES` sets the number of lines that the reference is asked, `SIGHTLINE_PRODUCT_QUERIES` that of those
//! where the plain walk stands for it, `SIGHTLINE_SEED` their seed; all are printed. For 10^6 and 10^8:
//!
//! ```text
//! SIGHTLINE_QUERIES=1000000 SIGHTLINE_PRODUCT_QUERIES=100000000 \
//!     cargo test --release --test los_extremes -- random --nocapture
//! ```

use std::cell::Cell;

use rayon::prelude::*;
use sightline::{
    database::{Database, OpenOptions},
    los::{Answer, Lines, Options, line_of_sight_with, naive},
    terrain::{HeightField, MemoryField},
};
use sightline_proto::predicates::{Kernel, Sign};

use super::{End, mix, without_filters};

fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a whole number")))
}

thread_local! {
    /// Signs that a filter settled, and that were left to exact arithmetic.
    static SIGNS: Cell<[u64; 2]> = const { Cell::new([0; 2]) };
}

/// The product's rungs, counted.
struct Counting;

impl Kernel for Counting {
    fn settled() {
        SIGNS.set([SIGNS.get()[0] + 1, SIGNS.get()[1]]);
    }

    fn unsettled(_estimate: Sign, exact: impl FnOnce() -> Sign) -> Sign {
        SIGNS.set([SIGNS.get()[0], SIGNS.get()[1] + 1]);
        exact()
    }
}

/// What a run found.
#[derive(Clone, Copy, Default, Debug)]
struct Tally {
    /// Visible, unknown and blocked.
    verdicts: [u64; 3],
    grazing: u64,
    wrong: u64,
    /// Of the lines that were counted: how many, how many needed the exact rung, and the signs by rung.
    counted: u64,
    exact_lines: u64,
    signs: [u64; 2],
}

impl Tally {
    fn answer(&mut self, expected: Answer) {
        self.verdicts[expected.verdict as usize] += 1;
        self.grazing += u64::from(expected.grazes);
    }

    /// Asks once more and counts.
    fn count<H: HeightField + ?Sized>(&mut self, field: &H, [a, b]: [End; 2], options: Options) {
        SIGNS.set([0; 2]);
        line_of_sight_with::<Counting, _>(field, a, b, options).unwrap();
        let signs = SIGNS.get();
        self.counted += 1;
        self.exact_lines += u64::from(signs[1] > 0);
        self.signs = [self.signs[0] + signs[0], self.signs[1] + signs[1]];
    }

    fn and(self, other: Self) -> Self {
        let sum = |a: [u64; 2], b: [u64; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            verdicts: [0, 1, 2].map(|k| self.verdicts[k] + other.verdicts[k]),
            grazing: self.grazing + other.grazing,
            wrong: self.wrong + other.wrong,
            counted: self.counted + other.counted,
            exact_lines: self.exact_lines + other.exact_lines,
            signs: sum(self.signs, other.signs),
        }
    }
}

/// A small terrain and draws of lines over it.
struct Scene {
    salt: u64,
    nx: u32,
    ny: u32,
    field: MemoryField,
}

impl Scene {
    fn new(salt: u64, largest: u64) -> Self {
        let (nx, ny) = (2 + (salt % largest) as u32, 2 + ((salt >> 8) % largest) as u32);
        let voids = [0, 0, 3, 20][(salt >> 16) as usize % 4];
        let field = MemoryField::from_fn(nx, ny, |i, j| {
            let post = mix(salt ^ u64::from(i * 1000 + j));
            (post % 1000 >= voids).then_some((post >> 20) as f64 % 5.0)
        });
        Self { salt, nx, ny, field: field.unwrap() }
    }

    /// Ends on posts, beside them, at eighths, or anywhere: of those, one line in `rarity`.
    fn line(&self, k: u64, rarity: u64) -> ([End; 2], Options) {
        let draw = |m: u64| mix(self.salt ^ ((k * 16 + m + 1) << 24));
        let anywhere = draw(15).is_multiple_of(rarity);
        let place = |m: u64, size: u32| match draw(m) % 4 {
            0 => (draw(m + 7) % u64::from(size)) as f64,
            1 if anywhere => ((draw(m + 7) % u64::from(size)) as f64).next_up(),
            2 | 3 if anywhere => (draw(m + 7) >> 11) as f64 / (1_u64 << 53) as f64 * f64::from(size),
            _ => (draw(m + 7) % (8 * u64::from(size))) as f64 / 8.0,
        };
        let end = |m| [place(m, self.nx), place(m + 1, self.ny), place(m + 2, 8)];
        ([end(0), end(3)], Options { strict: draw(14).is_multiple_of(8), ..Options::default() })
    }
}

/// Both stages print at most a few of what is wrong.
fn wrong(field: &Scene, line: [End; 2], options: Options, answer: Answer, expected: Answer) -> u64 {
    if answer == expected {
        return 0;
    }
    eprintln!("terrain {:#x}: {line:?} {options:?}: {answer:?}, not {expected:?}", field.salt);
    1
}

fn run(queries: u64, lines_per_scene: u64, stage: impl Fn(u64) -> Tally + Send + Sync) -> Tally {
    (0..queries.div_ceil(lines_per_scene)).into_par_iter().map(stage).reduce(Tally::default, Tally::and)
}

#[test]
fn random_lines_of_the_plain_walk_are_the_naive_ones() {
    let (queries, seed) = (setting("SIGHTLINE_QUERIES", 2_000), setting("SIGHTLINE_SEED", 1));
    println!("SIGHTLINE_QUERIES={queries} SIGHTLINE_SEED={seed}");
    let tally = run(queries, 20, |n| {
        let scene = Scene::new(mix(seed ^ mix(n)), 30);
        let mut tally = Tally::default();
        for k in 0..20 {
            let ([a, b], options) = scene.line(k, 1);
            let expected = naive::line_of_sight(&scene.field, a, b, options).unwrap();
            tally.answer(expected);
            for (from, to) in [(a, b), (b, a)] {
                let answer = without_filters(&scene.field, from, to, options);
                tally.wrong += wrong(&scene, [from, to], options, answer, expected);
            }
        }
        tally
    });
    println!("{tally:?}");
    assert_eq!(tally.wrong, 0);
    assert!(queries < 2_000 || tally.verdicts.iter().all(|&count| count > 60), "{tally:?}");
}

#[test]
fn random_lines_of_the_product_are_those_of_the_plain_walk() {
    let (queries, seed) = (setting("SIGHTLINE_PRODUCT_QUERIES", 40_000), setting("SIGHTLINE_SEED", 1));
    println!("SIGHTLINE_PRODUCT_QUERIES={queries} SIGHTLINE_SEED={seed}");
    let tally = run(queries, 1_000, |n| {
        let scene = Scene::new(mix(seed ^ mix(n) ^ 1 << 60), 200);
        let mut product = Lines::new(&scene.field);
        let mut tally = Tally::default();
        for k in 0..1_000 {
            let ([a, b], options) = scene.line(k, 50);
            let expected = without_filters(&scene.field, a, b, options);
            tally.answer(expected);
            let answer = product.ask(a, b, options).unwrap();
            tally.wrong += wrong(&scene, [a, b], options, answer, expected);
            if k % 16 == 0 {
                tally.count(&scene.field, [a, b], options);
            }
        }
        tally
    });
    println!("{tally:?}");
    assert_eq!(tally.wrong, 0);
    assert!(tally.signs[0] > 0 && tally.signs[1] > 0, "a rung that was never needed proves nothing: {tally:?}");
}

/// Real ground: `SIGHTLINE_DATABASE` names a database.
#[test]
#[ignore = "needs a database, named by SIGHTLINE_DATABASE"]
fn random_lines_over_real_ground_are_those_of_the_plain_walk() {
    let path = std::env::var("SIGHTLINE_DATABASE").expect("SIGHTLINE_DATABASE names a database");
    let (queries, seed) = (setting("SIGHTLINE_PRODUCT_QUERIES", 40_000), setting("SIGHTLINE_SEED", 1));
    println!("SIGHTLINE_PRODUCT_QUERIES={queries} SIGHTLINE_SEED={seed}");
    let field = Database::open(path.as_ref(), OpenOptions::default()).unwrap();
    let grid = field.grid();
    let tally = run(queries, 1_000, |n| {
        let mut product = Lines::new(&field);
        let mut tally = Tally::default();
        for k in 0..1_000 {
            let draw = |m: u64| mix(seed ^ mix(n * 1_000 + k) ^ m << 40);
            let length = [3, 30, 300][draw(9) as usize % 3];
            let along = |m: u64, posts: u32| {
                let from = draw(m) % u64::from(posts);
                let to = (from + draw(m + 1) % (2 * length)).saturating_sub(length).min(u64::from(posts) - 1);
                [from as f64, to as f64]
            };
            let ([ax, bx], [ay, by]) = (along(1, grid.nx()), along(3, grid.ny()));
            let up = [0.0, 2.0, 50.0][draw(5) as usize % 3];
            let end =
                |x: f64, y: f64| sightline::los::on_ground(&field, x, y, up).unwrap().map_or([x, y, up], |z| [x, y, z]);
            let (a, b, options) = (end(ax, ay), end(bx, by), Options::default());
            let expected = without_filters(&field, a, b, options);
            tally.answer(expected);
            let answer = product.ask(a, b, options).unwrap();
            if answer != expected {
                tally.wrong += 1;
                eprintln!("{a:?} {b:?}: {answer:?}, not {expected:?}");
            }
            if k % 16 == 0 {
                tally.count(&field, [a, b], options);
            }
        }
        tally
    });
    println!("{tally:?}");
    assert_eq!(tally.wrong, 0);
}

/// The same in debug and release builds, and on every machine: run with the other conformance tests by both.
#[test]
fn conformance_of_some_thousand_answers_to_a_golden_hash() {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for n in 0..60 {
        let scene = Scene::new(mix(n), 60);
        let mut lines = Lines::new(&scene.field);
        for k in 0..100 {
            let ([a, b], options) = scene.line(k, 2);
            let Answer { verdict, grazes, .. } = lines.ask(a, b, options).unwrap();
            hash = (hash ^ (verdict as u64 * 2 + u64::from(grazes))).wrapping_mul(0x100_0000_01b3).rotate_left(17);
        }
    }
    assert_eq!(hash, 0x72e2_9dda_ec0c_f0f0, "{hash:#018x}");
}
