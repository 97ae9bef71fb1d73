//! Lines of sight at the extremes: named cases, each compared with the naive reference, which shares no code with the
//! product. Every case is asked with and without skipping and without filters, strict and not, from both ends, and on
//! the terrain transposed, mirrored and turned as far as the parity of the diagonals lets it be the same surface.

mod degenerate;
mod far;
mod flushed;
mod numbers;
mod random;
mod symmetry;

use sightline::{
    los::{self, Answer, Lines, Options, Verdict, naive},
    terrain::{HeightField, MemoryField, synthetic::mix},
};
use sightline_proto::predicates::ExactOnly;

type End = [f64; 3];

/// Heights by column and row.
struct Terrain {
    nx: u32,
    ny: u32,
    height: Box<dyn Fn(u32, u32) -> Option<f64>>,
}

impl Terrain {
    fn new(nx: u32, ny: u32, height: impl Fn(u32, u32) -> Option<f64> + 'static) -> Self {
        Self { nx, ny, height: Box::new(height) }
    }

    /// Small whole heights, so that lines often touch.
    fn rough(nx: u32, ny: u32, seed: u64) -> Self {
        Self::new(nx, ny, move |i, j| Some((mix(seed ^ u64::from(i * 1000 + j)) % 4) as f64))
    }
}

/// A motion of the plane that takes posts to posts.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Motion {
    Stay,
    Transpose,
    MirrorEast,
    MirrorNorth,
    HalfTurn,
}

impl Motion {
    /// Those after which a grid of this size has its diagonals where they were: parity counts from post (0, 0).
    fn keeping_diagonals(nx: u32, ny: u32) -> Vec<Self> {
        let mut motions = vec![Self::Stay, Self::Transpose];
        motions.extend((nx % 2 == 1).then_some(Self::MirrorEast));
        motions.extend((ny % 2 == 1).then_some(Self::MirrorNorth));
        motions.extend((nx + ny).is_multiple_of(2).then_some(Self::HalfTurn));
        motions
    }

    fn field(self, Terrain { nx, ny, height }: &Terrain) -> MemoryField {
        let (east, north) = (nx - 1, ny - 1);
        match self {
            Self::Stay => MemoryField::from_fn(*nx, *ny, height),
            Self::Transpose => MemoryField::from_fn(*ny, *nx, |i, j| height(j, i)),
            Self::MirrorEast => MemoryField::from_fn(*nx, *ny, |i, j| height(east - i, j)),
            Self::MirrorNorth => MemoryField::from_fn(*nx, *ny, |i, j| height(i, north - j)),
            Self::HalfTurn => MemoryField::from_fn(*nx, *ny, |i, j| height(east - i, north - j)),
        }
        .unwrap()
    }

    /// Where an end goes, if no bit of it is lost on the way.
    fn end(self, [x, y, z]: End, nx: u32, ny: u32) -> Option<End> {
        let mirrored = |v: f64, posts: u32| {
            let last = f64::from(posts - 1);
            let to = last - v;
            // The error of the difference (Knuth); NaN where it overflows.
            let of_v = last - to;
            (((last - (to + of_v)) + (of_v - v)) == 0.0).then_some(to)
        };
        Some(match self {
            Self::Stay => [x, y, z],
            Self::Transpose => [y, x, z],
            Self::MirrorEast => [mirrored(x, nx)?, y, z],
            Self::MirrorNorth => [x, mirrored(y, ny)?, z],
            Self::HalfTurn => [mirrored(x, nx)?, mirrored(y, ny)?, z],
        })
    }
}

/// All ways to ask one field: with stretches skipped, at every crossing, and at every crossing without filters.
fn ask_all_ways(field: &MemoryField, a: End, b: End, options: Options) -> [(&'static str, Answer); 3] {
    [
        ("skipping", Lines::new(field).ask(a, b, options).unwrap()),
        ("walking", Lines::plain(field).ask(a, b, options).unwrap()),
        ("without filters", without_filters(field, a, b, options)),
    ]
}

/// The plain exact walk: no filter, no skipping.
fn without_filters<H: HeightField>(field: &H, a: End, b: End, options: Options) -> Answer {
    los::line_of_sight_with::<ExactOnly, _>(field, a, b, options).unwrap()
}

/// A terrain in all the ways in which it is the same.
struct Asked {
    nx: u32,
    ny: u32,
    fields: Vec<(Motion, MemoryField)>,
}

impl Asked {
    fn new(terrain: &Terrain) -> Self {
        let moved = |motion: Motion| (motion, motion.field(terrain));
        let motions = Motion::keeping_diagonals(terrain.nx, terrain.ny);
        Self { nx: terrain.nx, ny: terrain.ny, fields: motions.into_iter().map(moved).collect() }
    }

    /// The answer to a question that is not strict, which all ways to ask must give.
    fn answer(&self, a: End, b: End) -> Answer {
        let [answer, _] = [false, true].map(|strict| {
            let options = Options { strict, ..Options::default() };
            let expected = naive::line_of_sight(&self.fields[0].1, a, b, options).unwrap();
            for (motion, field) in &self.fields {
                let end = |end| motion.end(end, self.nx, self.ny);
                let (Some(a), Some(b)) = (end(a), end(b)) else { continue };
                for (from, to) in [(a, b), (b, a)] {
                    for (way, answer) in ask_all_ways(field, from, to, options) {
                        assert_eq!(answer, expected, "{from:?} to {to:?}, strict {strict}, {motion:?}, {way}");
                    }
                }
            }
            expected
        });
        answer
    }

    fn ask(&self, a: End, b: End) -> Verdict {
        self.answer(a, b).verdict
    }

    /// The line and its neighbours: each height a unit in the last place and 1e-13 up and down. Tells how many of them
    /// are blocked.
    fn ask_beside(&self, a: End, b: End) -> usize {
        let moves: [fn(f64) -> f64; 5] = [|z| z, f64::next_up, f64::next_down, |z| z + 1e-13, |z| z - 1e-13];
        let moved = |by: fn(f64) -> f64, [x, y, z]: End| [x, y, by(z)];
        moves.iter().filter(|&&by| self.ask(moved(by, a), moved(by, b)) == Verdict::Blocked).count()
    }
}
