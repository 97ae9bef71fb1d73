//! A process whose processor flushes subnormal numbers to zero, as a host that was built for speed leaves it: verdicts
//! must not notice. They are compared with what the naive reference said before the mode was changed, on terrains and
//! lines made of subnormal numbers, small ones, ordinary ones and huge ones.

use std::{hint::black_box, process::ExitCode, thread, time::Instant};

use sightline::{
    los::{self, Answer, Lines, Options, naive},
    terrain::{MemoryField, synthetic::mix},
};
use sightline_proto::predicates::{Sign, orient2d, orient3d};

const TERRAINS: u64 = 400;
const LINES: u64 = 60;
const TRIPLES: u64 = 40_000;

/// Replaces subnormal results by zero, and reads subnormal operands as zero, in this thread and those it starts.
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
}

fn case(salt: u64) -> Case {
    let (nx, ny) = (2 + (mix(salt) % 20) as u32, 2 + (mix(salt ^ 1) % 20) as u32);
    // Whole terrains of tiny heights, and mixed ones.
    let height = |i: u32, j: u32| {
        let post = mix(salt ^ u64::from(i * 1000 + j + 7));
        match salt % 3 {
            0 => Some(f64::from_bits(post % 5)),
            1 => Some(number(post)),
            _ => (post % 50 > 0).then_some((post % 4) as f64 * 1e-310),
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
        let options = Options { strict: draw(6).is_multiple_of(2), ..Options::default() };
        let answer = naive::line_of_sight(&field, ends[0], ends[1], options).expect("a verdict");
        (ends, options, answer)
    };
    let lines = (0..LINES).map(line).collect();
    Case { field, lines }
}

/// Answers that differ from the reference's.
fn wrong(cases: &[Case]) -> usize {
    let mut wrong = 0;
    for Case { field, lines } in cases {
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

fn main() -> ExitCode {
    assert_eq!(is_flushing(), [false; 2], "the process began with subnormals flushed");
    let cases: Vec<Case> = (0..TERRAINS).map(case).collect();
    let before = (wrong(&cases), signs());
    flush_subnormals();
    let flushing = is_flushing();
    let started = Instant::now();
    let after = (wrong(&cases), signs());
    let in_a_thread = thread::scope(|scope| scope.spawn(|| (is_flushing(), wrong(&cases))).join()).expect("a thread");
    let differing = before.1.iter().zip(&after.1).filter(|(a, b)| a != b).count();
    let ground = los::on_ground(&cases[0].field, 0.5, 0.25, 1e-310).expect("a height");
    println!(
        "subnormal results, operands flushed: {flushing:?}; in a thread started after: {:?}\n\
         {} lines asked four ways: {} wrong before, {} after, {} in that thread\n\
         {} signs: {differing} differ; ground and a subnormal height: {ground:?}; {:.1?}",
        in_a_thread.0,
        TERRAINS * LINES,
        before.0,
        after.0,
        in_a_thread.1,
        before.1.len(),
        started.elapsed()
    );
    let known = cfg!(any(target_arch = "x86_64", target_arch = "aarch64"));
    if known && flushing != [true; 2] || (before.0, after.0, in_a_thread.1, differing) != (0, 0, 0, 0) {
        eprintln!("wrong where subnormal numbers are flushed to zero");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
