//! A thread whose processor flushes subnormal numbers to zero, as a host that was built for speed leaves it: verdicts
//! must not notice, on a flat Earth and on curved ones, of single lines and of viewsheds; nor must what is exact of
//! derived answers: which of them exist, in which order of states a line and the ground under it are (that on a flat
//! Earth: on a curved one a stretch may begin where a quotient of subnormal heights is rounded, and be lost with it),
//! between which faces a place lies, and the least target height to the last bit. Verdicts are compared with what the naive reference
//! said in the ordinary mode, the rest with what the library said in it, on terrains and lines made of subnormal
//! numbers, small ones, ordinary ones and huge ones.

#![allow(unsafe_code)] // the processor's mode can be changed in no other way

use std::{hint::black_box, ops::ControlFlow, thread};

use sightline::{
    los::{self, Answer, Earth, GroundState, LineState, Lines, Options, Region, Verdict, View, naive},
    terrain::{MemoryField, synthetic::mix},
};
use sightline_proto::predicates::{Sign, orient2d, orient3d};

/// More of everything where the optimiser is on.
const TERRAINS: u64 = if cfg!(debug_assertions) { 32 } else { 400 };
const LINES: u64 = 60;
const TRIPLES: u64 = if cfg!(debug_assertions) { 4_000 } else { 40_000 };
/// Of the lines of every eighth terrain, those from which everything is derived, and those whose A looks around.
const DERIVED: usize = 6;
const VIEWS: usize = 1;
const EIGHTH: u64 = 8;

/// Replaces subnormal results by zero, and reads subnormal operands as zero, in this thread and those that it starts.
#[cfg(target_arch = "x86_64")]
fn flush_subnormals() {
    let mut control = 0_u32;
    // SAFETY: reads and writes MXCSR through a valid place; bits 15 (FTZ) and 6 (DAZ) exist on all x86-64 processors.
    unsafe {
        std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut control);
        control |= 1 << 15 | 1 << 6;
        std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const control);
    }
}

/// The same on 64-bit ARM: FPCR bit 24 (FZ) does both.
#[cfg(target_arch = "aarch64")]
fn flush_subnormals() {
    let mut control: u64;
    // SAFETY: reads and writes the floating-point control register of this thread.
    unsafe {
        std::arch::asm!("mrs {}, fpcr", out(reg) control);
        control |= 1 << 24;
        std::arch::asm!("msr fpcr, {}", in(reg) control);
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn flush_subnormals() {}

/// Whether subnormal results, and operands, are lost.
fn is_flushing() -> [bool; 2] {
    let half = black_box(f64::MIN_POSITIVE) * black_box(0.5);
    let doubled = black_box(f64::from_bits(1 << 51)) * black_box(2.0);
    [half.to_bits() == 0, doubled.to_bits() == 0]
}

/// A number that is often subnormal, small or whole.
fn number(salt: u64) -> f64 {
    let k = (mix(salt) % 7) as f64;
    let sign = if mix(salt ^ 77).is_multiple_of(2) { 1.0 } else { -1.0 };
    let magnitude = match mix(salt ^ 99) % 12 {
        0..=2 => f64::from_bits(mix(salt) % 7),
        3 => f64::from_bits((1 << 50) * (mix(salt) % 7)),
        4 => k * f64::MIN_POSITIVE,
        5 => k * 1e-300,
        6 => k * 1e-160,
        7 => k * 1e-40,
        8 => k * 1e300,
        _ => return k,
    };
    sign * magnitude
}

type Line = [[f64; 3]; 2];

struct Case {
    field: MemoryField,
    lines: Vec<(Line, Options, Answer)>,
    /// What the library derived from each line before the mode was changed.
    derived: Vec<Derived>,
    views: Vec<View>,
    /// The cells of each view, before too.
    cells: Vec<Vec<Option<Verdict>>>,
}

/// What is exact of the answers derived from a line.
#[derive(Clone, PartialEq, Debug)]
struct Derived {
    /// The first obstructions from both ends, the deepest place, the least clearance.
    exist: [bool; 4],
    triangles: [Option<[[u32; 2]; 3]>; 2],
    line: Vec<LineState>,
    ground: Vec<GroundState>,
    breaks: Vec<(los::Face, bool)>,
    least_target: Option<u64>,
}

impl Derived {
    fn new(field: &MemoryField, [a, b]: Line, options: Options) -> Self {
        let derived = los::derive(field, a, b, options).expect("derived values");
        let firsts = [derived.first_from_a, derived.first_from_b];
        let target = [b[0], b[1]];
        let breaks = los::profile(field, [a[0], a[1]], target, usize::MAX).expect("a profile");
        let least = los::least_target_height(field, a, target, options).expect("a height");
        Self {
            exist: [
                firsts[0].is_some(),
                firsts[1].is_some(),
                derived.deepest.is_some(),
                derived.least_clearance.is_some(),
            ],
            triangles: firsts.map(|first| first?.triangle.map(|posts| posts.map(|p| [p.i, p.j]))),
            line: states(los::line_stretches(field, a, b, options.earth)),
            ground: states(los::ground_stretches(field, a, target, Earth::Flat)),
            breaks: breaks.iter().map(|found| (found.face, found.ground.is_some())).collect(),
            least_target: least.map(f64::to_bits),
        }
    }
}

fn states<S: Copy>(stretches: Result<Vec<los::Stretch<S>>, los::LosError>) -> Vec<S> {
    stretches.expect("stretches").iter().map(|stretch| stretch.state).collect()
}

/// The cells of a viewshed, tile by tile; in threads that have the mode of this one.
fn cells(field: &MemoryField, view: &View) -> Vec<Option<Verdict>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut cells = Vec::new();
    let tile = |tile: los::Tile, _| {
        cells.extend_from_slice(&tile.cells);
        ControlFlow::Continue(())
    };
    pool.install(|| los::viewshed(field, view, tile)).expect("a viewshed");
    cells
}

fn case(salt: u64) -> Case {
    let (nx, ny) = (2 + (mix(salt) % 20) as u32, 2 + (mix(salt ^ 1) % 20) as u32);
    // Whole terrains of tiny heights, and mixed ones.
    let height = |i: u32, j: u32| {
        let post = mix(salt ^ u64::from(i * 1000 + j + 7));
        match salt % 3 {
            0 => Some(f64::from_bits(post % 5)),
            1 => Some(number(post)),
            _ => (!post.is_multiple_of(50)).then_some((post % 4) as f64 * 1e-310),
        }
    };
    let field = MemoryField::from_fn(nx, ny, height).expect("a terrain");
    let line = |n: u64| {
        let draw = |k: u64| mix(salt ^ (n * 16 + k + 1) << 32);
        let place = |k: u64, posts: u32| {
            let whole = (draw(k) % u64::from(posts)) as f64;
            if draw(k + 8).is_multiple_of(3) { number(draw(k)) } else { whole }
        };
        let height = |k: u64| if salt.is_multiple_of(3) { f64::from_bits(draw(k) % 5) } else { number(draw(k)) };
        let ends = [[place(0, nx), place(1, ny), height(2)], [place(3, nx), place(4, ny), height(5)]];
        // The reference's fractions take seconds where huge numbers are squared.
        let is_tame = ends.iter().flatten().all(|v| v.abs() < 1e9) && salt % 3 != 1;
        let is_curved = salt.is_multiple_of(EIGHTH) && n < DERIVED as u64 && is_tame;
        let earth = if is_curved { earth(draw(7)) } else { Earth::Flat };
        let options = Options { strict: draw(6).is_multiple_of(2), earth, ..Options::default() };
        let answer = naive::line_of_sight(&field, ends[0], ends[1], options).expect("a verdict");
        (ends, options, answer)
    };
    let lines: Vec<_> = (0..LINES).map(line).collect();
    let few = |count: usize| if salt.is_multiple_of(EIGHTH) { count } else { 0 };
    let derived =
        lines.iter().take(few(DERIVED)).map(|(line, options, _)| Derived::new(&field, *line, *options)).collect();
    let views = lines.iter().take(few(VIEWS)).map(|([observer, target], options, _)| View {
        observer: *observer,
        target_height: target[2].abs(),
        region: Region::Rectangle { i: [0, nx - 1], j: [0, ny - 1] },
        strict: options.strict,
        earth: options.earth,
    });
    let views: Vec<_> = views.collect();
    let cells = views.iter().map(|view| cells(&field, view)).collect();
    Case { field, lines, derived, views, cells }
}

/// An Earth with coefficients of any size.
fn earth(draw: u64) -> Earth {
    let coefficient = |salt: u64| [0.0, 1e-310, 1e-160, 1e-3, 0.5][(mix(draw ^ salt) % 5) as usize];
    Earth::curved(coefficient(1), coefficient(2)).expect("coefficients of a curvature")
}

/// Derived answers, and cells of viewsheds, that differ from those before.
fn changed(cases: &[Case]) -> [usize; 2] {
    let mut changed = [0; 2];
    for Case { field, lines, derived, views, cells: before } in cases {
        for ((line, options, _), expected) in lines.iter().zip(derived) {
            let found = Derived::new(field, *line, *options);
            if found != *expected {
                changed[0] += 1;
                if changed[0] < 5 {
                    eprintln!("{line:?} {options:?}: {found:?}, not {expected:?}");
                }
            }
        }
        for (view, before) in views.iter().zip(before) {
            let differ = cells(field, view).iter().zip(before).filter(|(a, b)| a != b).count();
            if differ > 0 && changed[1] < 5 {
                eprintln!("{differ} cells of {view:?}");
            }
            changed[1] += differ;
        }
    }
    changed
}

/// Answers that differ from the reference's.
fn wrong(cases: &[Case]) -> usize {
    let mut wrong = 0;
    for Case { field, lines, .. } in cases {
        for ([a, b], options, expected) in lines {
            for mut lines in [Lines::plain(field), Lines::new(field)] {
                for (from, to) in [(*a, *b), (*b, *a)] {
                    let answer = lines.ask(from, to, *options).expect("an answer");
                    if answer != *expected {
                        wrong += 1;
                        if wrong < 5 {
                            eprintln!("{from:?} {to:?} {options:?}: {answer:?}, not {expected:?}");
                        }
                    }
                }
            }
        }
    }
    wrong
}

/// Signs of orientations of points made of such numbers.
fn signs() -> Vec<Sign> {
    let point = |n: u64, k: u64| [0, 1, 2].map(|axis| number(n * 16 + k * 3 + axis));
    let of = |n: u64| {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| point(n, k));
        [orient2d([a[0], a[1]], [b[0], b[1]], [c[0], c[1]]), orient3d(a, b, c, d)]
    };
    (0..TRIPLES).flat_map(of).collect()
}

#[test]
fn conformance_holds_where_subnormals_are_flushed() {
    assert_eq!(is_flushing(), [false; 2], "the test began with subnormals flushed");
    let cases: Vec<Case> = (0..TERRAINS).map(case).collect();
    let before = (wrong(&cases), signs());
    let flushed = || {
        flush_subnormals();
        let inherited = thread::scope(|scope| scope.spawn(|| (is_flushing(), wrong(&cases))).join()).expect("a thread");
        (is_flushing(), wrong(&cases), signs(), changed(&cases), inherited)
    };
    // The mode is the thread's: it ends with it.
    let (flushing, wrong, signs, changed, inherited) =
        thread::scope(|scope| scope.spawn(flushed).join()).expect("a thread");
    let known = cfg!(any(target_arch = "x86_64", target_arch = "aarch64"));
    assert_eq!((flushing, inherited.0), ([known; 2], [known; 2]), "subnormal results, operands flushed");
    assert_eq!([before.0, wrong, inherited.1], [0; 3], "lines wrong before, flushed, and in a thread started then");
    assert_eq!(changed, [0; 2], "derived answers and cells of viewsheds that differ");
    assert!(before.1 == signs, "signs differ");
    let tested = [
        cases.iter().map(|case| case.lines.len()).sum::<usize>(),
        cases.iter().map(|case| case.derived.len()).sum(),
        cases.iter().flat_map(|case| &case.cells).map(Vec::len).sum(),
        signs.len(),
    ];
    println!("{tested:?} lines, derived, cells, signs");
    assert!(tested.iter().all(|&count| count > 20));
}
