//! The least height of a target at which a line to it is not blocked.
//!
//! Raising B raises every point of AB but A. So the heights at which AB is not blocked are all those from some number
//! on, and the least f64 among them is well defined. A rounded crest line says where to begin; then the verdict itself
//! is asked, upwards or downwards in steps that double, and between the last two by halves. The answer is therefore
//! exact, whatever the rounding of the first guess, and nearly always takes two to four questions.

use sightline_proto::predicates::{are_equal, plan};

use super::crest::view;
use crate::{
    los::{Lines, LosError, Options, Verdict, check_finite, earth::Line, walk::Walk},
    terrain::HeightField,
};

/// The least height z at which the line from `a` to (x, y, z) of `b` is not BLOCKED. It may be lower than `b` is, when
/// that is visible. Over unknown ground the line is then UNKNOWN, elsewhere VISIBLE.
///
/// `None` when A is below ground, when the line is vertical, when nothing known lies under it that could block it, and
/// when no finite height is enough. `strict` and `earth` count.
pub fn least_target_height<H>(field: &H, a: [f64; 3], b: [f64; 2], options: Options) -> Result<Option<f64>, LosError>
where
    H: HeightField + ?Sized,
{
    check_finite(a, ["ax", "ay", "az"])?;
    check_finite([b[0], b[1], 0.0], ["bx", "by", "bz"])?;
    if are_equal(plan(a), b) {
        return Ok(None);
    }
    let mut lines = Lines::new(field);
    let options = Options { strict: options.strict, earth: options.earth, ..Options::default() };
    if lines.ask(a, a, options)?.verdict == Verdict::Blocked {
        return Ok(None);
    }
    let level = Line::new(a, [b[0], b[1], a[2]], options.earth);
    // A crossing too close to A for a slope has no crest; where to begin decides no answer.
    let rise = view(&mut Walk::new(field, a, level.b), level)?.crest.map_or(0.0, |crest| crest.rise);
    let mut blocked =
        |z: f64| -> Result<bool, LosError> { Ok(lines.ask(a, [b[0], b[1], z], options)?.verdict == Verdict::Blocked) };
    least(a[2] + rise, &mut blocked)
}

/// The least f64 that is not blocked, near a guess; `None` when none is.
fn least(guess: f64, blocked: &mut impl FnMut(f64) -> Result<bool, LosError>) -> Result<Option<f64>, LosError> {
    let (lowest, highest) = (number(-f64::MAX), number(f64::MAX));
    let guess = if guess.is_nan() { 0 } else { number(guess.clamp(-f64::MAX, f64::MAX)) };
    let (mut low, mut high);
    let mut step = 1_i64;
    if blocked(of_number(guess))? {
        low = guess;
        loop {
            high = low.saturating_add(step).min(highest);
            if !blocked(of_number(high))? {
                break;
            }
            if high == highest {
                return Ok(None);
            }
            (low, step) = (high, step.saturating_mul(2));
        }
    } else {
        high = guess;
        loop {
            low = high.saturating_sub(step).max(lowest);
            if blocked(of_number(low))? {
                break;
            }
            if low == lowest {
                return Ok(None);
            }
            (high, step) = (low, step.saturating_mul(2));
        }
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if blocked(of_number(middle))? {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(Some(of_number(high)))
}

/// The place of a finite f64 among all of them: neighbours differ by 1, both zeros are 0.
fn number(v: f64) -> i64 {
    let magnitude = (v.to_bits() & (u64::MAX >> 1)) as i64;
    if v.is_sign_negative() { -magnitude } else { magnitude }
}

fn of_number(n: i64) -> f64 {
    let magnitude = f64::from_bits(n.unsigned_abs());
    if n < 0 { -magnitude } else { magnitude }
}
