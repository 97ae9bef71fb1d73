//! The bounds of the finest square diamonds row by row, as [`super::finest`] has them one by one. A tilted diamond is the
//! child of two square ones and is computed once for both; even and odd columns lie apart, so that the compiler keeps
//! several diamonds abreast.

use sightline_proto::diamond::Post;

use super::{
    BALL_MARGIN, DiamondBounds,
    band::Band,
    finest::{Cross, Deviate, Steps, deviation, finest_bounds_with},
    round_up,
};
use crate::terrain::{ReadError, SceneScale};

/// The square diamonds of half-length 1 in the two rows around one of the lattice of step 2.
pub(super) struct FinestRows<'a> {
    band: &'a Band,
    scale: SceneScale,
    exact: bool,
    /// Diamonds of a row.
    count: u32,
    /// The rows of the band.
    halves: Vec<Halves>,
    /// Which row, an odd one, and its bounds.
    squares: [(u32, Vec<DiamondBounds>); 2],
    /// The tilted diamonds of odd columns in the two even rows around an odd one.
    tilted: [(u32, Tilted); 2],
}

/// Heights of a row of the grid by the parity of their columns.
#[derive(Default)]
struct Halves {
    even: Vec<f64>,
    odd: Vec<f64>,
}

/// The bounds of a row of tilted diamonds; both thicknesses are the same.
#[derive(Default)]
struct Tilted {
    tight: Vec<f32>,
    radius_m: Vec<f32>,
}

impl<'a> FinestRows<'a> {
    /// Over the rows of `band`; `exact` is what [`super::deviation::arithmetic_is_exact`] says of the field.
    pub(super) fn new(band: &'a Band, scale: SceneScale, exact: bool, count: u32) -> Self {
        let halves = if band.is_level() { Vec::new() } else { band.rows().map(Halves::of).collect() };
        Self { band, scale, exact, count, halves, squares: Default::default(), tilted: Default::default() }
    }

    /// Has rows `j` - 1 and `j` + 1 ready, as far as there are any; `j` is even.
    pub(super) fn around(&mut self, j: u32) -> Result<(), ReadError> {
        for row in [j.wrapping_sub(1), j + 1].into_iter().filter(|&row| row < self.band.grid().root().side()) {
            if self.squares[slot(row)].0 != row {
                let bounds =
                    if self.exact { self.square_row(exact_deviation, row) } else { self.square_row(deviation, row) }?;
                self.squares[slot(row)] = (row, bounds);
            }
        }
        Ok(())
    }

    /// The bounds of one of the rows at hand: those of the posts (2a + 1, j).
    pub(super) fn row(&self, j: u32) -> &[DiamondBounds] {
        &self.squares[slot(j)].1
    }

    /// The bounds of a diamond of the rows at hand; zero beyond them.
    pub(super) fn get(&self, p: Post) -> DiamondBounds {
        self.row(p.j).get((p.i / 2) as usize).copied().unwrap_or_default()
    }

    fn square_row(&mut self, deviate: impl Deviate, j: u32) -> Result<Vec<DiamondBounds>, ReadError> {
        let (grid, band, scale) = (self.band.grid(), self.band, self.scale);
        // Of the diamonds with all the heights that they follow from in the grid.
        let inner =
            if j >= 2 && j + 2 < grid.ny() { 1..(grid.nx().saturating_sub(2) / 2).min(self.count) } else { 0..0 };
        let one = |a| finest_bounds_with(grid, scale, Post::new(2 * a + 1, j), |q| Ok(band.height(q)));
        let mut bounds = (0..inner.start).map(one).collect::<Result<Vec<_>, _>>()?;
        bounds.reserve(self.count as usize);
        if !inner.is_empty() && band.is_level() {
            bounds.resize(inner.end as usize, one(inner.start)?);
        } else if !inner.is_empty() {
            self.squares(deviate, j, inner.len(), &mut bounds);
        }
        for a in bounds.len() as u32..self.count {
            bounds.push(one(a)?);
        }
        Ok(bounds)
    }

    /// Appends the bounds of diamonds 1 to `len` of row `j`.
    fn squares(&mut self, deviate: impl Deviate, j: u32, len: usize, out: &mut Vec<DiamondBounds>) {
        for row in [j - 1, j + 1] {
            if self.tilted[slot(row)].0 != row {
                self.tilted[slot(row)] = (row, self.tilted_of_odd_columns(deviate, row, len));
            }
        }
        let beside = self.tilted_of_even_columns(deviate, j, len + 1);
        let [below, above] = [j - 1, j + 1].map(|row| &self.tilted[slot(row)].1);
        let steps = Steps::new(self.scale, 1);
        let [south, row, north] = [j - 1, j, j + 1].map(|j| self.halves(j));
        let both2 = steps.east2 + steps.north2;
        let z = &row.odd[1..][..len];
        let [west, east] = [1, 2].map(|a| &row.even[a..][..len]);
        let [south_west, south_east] = [1, 2].map(|a| &south.even[a..][..len]);
        let [north_west, north_east] = [1, 2].map(|a| &north.even[a..][..len]);
        let [south, north] = [south, north].map(|row| &row.odd[1..][..len]);
        let children = [(&beside, 0), (&beside, 1), (below, 0), (above, 0)];
        let [west_child, east_child, south_child, north_child] =
            children.map(|(child, from)| (&child.tight[from..][..len], &child.radius_m[from..][..len]));
        // The numbers of several diamonds lie side by side, and become bounds when all are there.
        let (mut tight, mut radius_m) = (vec![0.0; len], vec![0.0; len]);
        for n in 0..len {
            let to = |height: f64| steps.rise2(z[n], height);
            let corners = [south_west[n], south_east[n], north_west[n], north_east[n]].map(to);
            let reach = (both2 + corners.into_iter().fold(0.0, f64::max)).sqrt();
            let reach = reach.max((steps.east2 + to(west[n])).sqrt() + f64::from(west_child.1[n]));
            let reach = reach.max((steps.east2 + to(east[n])).sqrt() + f64::from(east_child.1[n]));
            let reach = reach.max((steps.north2 + to(south[n])).sqrt() + f64::from(south_child.1[n]));
            let reach = reach.max((steps.north2 + to(north[n])).sqrt() + f64::from(north_child.1[n]));
            radius_m[n] = round_up(reach * BALL_MARGIN);
            // Bases run from south-west to north-east in every other diamond.
            let rises = (n as u32 + 1 + j / 2).is_multiple_of(2);
            let rising = deviate(z[n], [south_west[n], north_east[n]]);
            let falling = deviate(z[n], [south_east[n], north_west[n]]);
            let own = round_up(if rises { rising } else { falling });
            let [a, b, c, d] = [west_child, east_child, south_child, north_child].map(|child| child.0[n]);
            tight[n] = own.max(a.max(b)).max(c.max(d));
        }
        out.extend(tight.into_iter().zip(radius_m).map(|(tight, radius_m)| DiamondBounds {
            tight,
            nested: tight,
            radius_m,
        }));
    }

    /// The tilted diamonds of posts (2a + 1, j), j even, for a from 1.
    fn tilted_of_odd_columns(&self, deviate: impl Deviate, j: u32, len: usize) -> Tilted {
        let [south, row, north] = [j - 1, j, j + 1].map(|j| self.halves(j));
        let [west, east] = [1, 2].map(|a| &row.even[a..][..len]);
        let [south, z, north] = [south, row, north].map(|row| &row.odd[1..][..len]);
        Tilted::new(deviate, &Steps::new(self.scale, 1), z, [west, east], [south, north], true)
    }

    /// The tilted diamonds of posts (2a, j), j odd, for a from 1.
    fn tilted_of_even_columns(&self, deviate: impl Deviate, j: u32, len: usize) -> Tilted {
        let [south, row, north] = [j - 1, j, j + 1].map(|j| self.halves(j));
        let [west, east] = [0, 1].map(|a| &row.odd[a..][..len]);
        let [south, z, north] = [south, row, north].map(|row| &row.even[1..][..len]);
        Tilted::new(deviate, &Steps::new(self.scale, 1), z, [west, east], [south, north], false)
    }

    fn halves(&self, j: u32) -> &Halves {
        &self.halves[(j - self.band.first()) as usize]
    }
}

/// Which of two rows a row of either parity is kept in.
fn slot(j: u32) -> usize {
    (j / 2 % 2) as usize
}

impl Halves {
    fn of(row: &[f64]) -> Self {
        Self { even: row.iter().step_by(2).copied().collect(), odd: row.iter().skip(1).step_by(2).copied().collect() }
    }
}

impl Tilted {
    /// Of diamonds at heights `z` between those beside, and those before and behind.
    fn new(
        deviate: impl Deviate,
        steps: &Steps,
        z: &[f64],
        [west, east]: [&[f64]; 2],
        [south, north]: [&[f64]; 2],
        base_runs_east: bool,
    ) -> Self {
        let len = z.len();
        let [west, east, south, north] = [west, east, south, north].map(|row| &row[..len]);
        let (mut tight, mut radius_m) = (vec![0.0; len], vec![0.0; len]);
        for n in 0..len {
            let cross = Cross { z: z[n], west: west[n], east: east[n], south: south[n], north: north[n] };
            let bounds = cross.bounds(steps, deviate, base_runs_east);
            (tight[n], radius_m[n]) = (bounds.tight, bounds.radius_m);
        }
        Self { tight, radius_m }
    }
}

/// |z - (end0 + end1) / 2| where f64 arithmetic makes no error: what [`deviation`] says, too.
#[inline]
fn exact_deviation(z: f64, [from, to]: [f64; 2]) -> f64 {
    (z - (from * 0.5 + to * 0.5)).abs()
}
