//! The walk that encoder and decoder take together, from the centre of the root square down, level by level.
//!
//! Each diamond below the first two levels hangs on one other, two levels up: the finer end of its base. Seen from
//! there it lies halfway to one of the four corners, between two of the four children:
//!
//! ```text
//!        corner 3 ──── child 2 ──── corner 2       place k lies halfway between the post a and corner k; its
//!           │ ╲           │           ╱ │          diamond has base a, corner k and apexes child k-1, child k;
//!           │   (3)       │       (2)   │          so it may be active when those two are. Its own corners, in
//!        child 3 ──────── a ──────── child 1       the same sense: child k-1, a, child k, corner k.
//!           │   (0)       │       (1)   │
//!           │ ╱           │           ╲ │
//!        corner 0 ──── child 0 ──── corner 1
//! ```
//!
//! A snapshot visits all posts of the mesh and says of each place whether it is active. A delta visits only posts with a
//! change among what hangs on them, directly or further down, and whatever is new. So its cost follows the changes.

use crate::{
    codec::DecodeError,
    context::Context,
    diamond::{Post, RootSquare},
    heights::{Corners, Heights, bit_length},
    range_coder::Coder,
};

/// The mesh as one side of the walk knows it. Asked of posts whose place the walk has passed, unless it says otherwise.
pub(crate) trait State {
    /// Height of a corner of the square.
    fn corner(&self, p: Post) -> i32;

    /// Height of a post of the base; a snapshot has none. Asked of any post.
    fn held(&self, p: Post) -> Option<i32>;

    /// Height of an active post, and whether it is new: not active in the base.
    fn now(&self, p: Post) -> Option<(i32, bool)>;

    /// Of the encoder: the height of `p` if it is to be active. Asked where the walk stands.
    fn wanted(&self, p: Post) -> Option<i32>;

    /// Of a delta's encoder: whether something that hangs on `p`, directly or further down, is named as changed.
    fn is_changed_below(&self, p: Post) -> bool;

    /// `p` becomes active, with so many triangles.
    fn add(&mut self, p: Post, height: i32, triangles: u64) -> Result<(), DecodeError>;

    /// `p` and all its descendants cease to be active.
    fn remove(&mut self, p: Post);
}

/// The expected bit length of height differences in the first two levels of a delta.
const FIRST_LENGTH: u32 = 6;
/// The corner that is missing when the border cuts a diamond: its second apex.
const SECOND_APEX: usize = 2;
/// The children that are missing then, bit k for child k: those between it and the ends of the base.
const BESIDE_SECOND_APEX: u32 = 0b0110;

/// A post and its height.
#[derive(Clone, Copy)]
struct Known {
    post: Post,
    height: i32,
}

/// A diamond that is, or may be, active.
#[derive(Clone, Copy)]
struct Diamond {
    post: Post,
    /// Apex, base end, apex, base end.
    corners: [Known; 4],
    /// The second apex is beyond the border; what `corners` says of it means nothing.
    is_cut: bool,
}

/// An active post that is visited for what hangs on it.
#[derive(Clone, Copy)]
struct Visit {
    diamond: Diamond,
    height: i32,
    /// Not active in the base.
    new: bool,
}

/// The four children of the post visited: child k lies between corners k and k + 1, and bit k of a set stands for it.
struct Children {
    /// What is known of the active ones; of others it means nothing.
    at: [Known; 4],
    active: u32,
    new: u32,
}

/// What has been said of the places of one visit.
#[derive(Clone, Copy)]
struct Said {
    /// Active children of the post visited.
    children: usize,
    /// A one, and a bit for each place so far.
    bits: usize,
    /// Something must change among the places, nothing has, and this place is the last.
    must_change: bool,
    /// Whether a parent or the post that the place hangs on is new.
    fresh: bool,
}

/// Posts of the base that are counted below a post of the base: its children and, if there are four, its places.
const FULL_SIZE: usize = 8;
/// Rows for sizes below the full one, and for that one by level, four levels a row.
const SIZES: usize = FULL_SIZE + 6;
/// The places of a visit that may come first to be touched, and the state in which one has been.
const TURNS: usize = 5;

/// Of 256, how often a post of the base is touched: by its size, and by how many places of the visit have been passed
/// without a change (the last column: one has changed). Measured on flights over California.
const TOUCHED: [[u8; TURNS]; SIZES] = [
    [112, 112, 160, 160, 6],
    [3, 3, 3, 3, 3],
    [50, 42, 68, 68, 3],
    [50, 72, 104, 104, 4],
    [108, 120, 160, 160, 6],
    [98, 125, 160, 160, 6],
    [65, 71, 127, 127, 6],
    [66, 87, 130, 130, 9],
    [210, 240, 250, 250, 12],
    [145, 152, 212, 212, 62],
    [147, 119, 170, 170, 62],
    [104, 132, 180, 180, 61],
    [95, 120, 161, 161, 25],
    [70, 81, 127, 127, 12],
];
/// Of 256, how often a post that could have been active in the base becomes so: by the active children beside it.
const ADDED: [u8; 5] = [17, 17, 17, 74, 49];
/// Of 256, how often a post that is touched is removed: by its children in the base.
const REMOVED: [u8; 5] = [255, 205, 1, 1, 1];
/// Of 256, how often a diamond that could not be active in the base is.
const ACTIVE: u8 = 128;

impl Said {
    /// Places that have passed without a change; the last state is for when one has not.
    fn turn(self) -> usize {
        if self.bits.is_power_of_two() { self.bits.trailing_zeros() as usize } else { TURNS - 1 }
    }
}

struct Model {
    active: [Context; 64],
    added: [Context; 5],
    touched: [[Context; TURNS]; SIZES],
    removed: [Context; 5],
    heights: Heights,
}

impl Model {
    fn new() -> Self {
        let firmly = |one| Context::expecting(one, 8);
        Self {
            active: [Context::expecting(ACTIVE, 2); 64],
            added: ADDED.map(firmly),
            touched: TOUCHED.map(|row| row.map(firmly)),
            removed: REMOVED.map(firmly),
            heights: Heights::new(),
        }
    }
}

/// A walk under way.
struct Walk<'a, C, S> {
    root: RootSquare,
    is_delta: bool,
    state: &'a mut S,
    coder: &'a mut C,
    model: Model,
}

/// Takes the whole walk of a delta, or of a snapshot.
pub(crate) fn walk(
    root: RootSquare,
    is_delta: bool,
    state: &mut impl State,
    coder: &mut impl Coder,
) -> Result<(), DecodeError> {
    let mut walk = Walk { root, is_delta, state, coder, model: Model::new() };
    let mut levels = [Vec::new(), Vec::new(), Vec::new()];
    if root.exponent() > 0 {
        walk.first_levels(&mut levels)?;
    }
    for _ in 2..root.levels() {
        let [visits, next, found] = &mut levels;
        if visits.is_empty() && next.is_empty() {
            break;
        }
        for visit in visits.iter() {
            walk.visit(visit, found)?;
        }
        visits.clear();
        levels.rotate_left(1);
    }
    walk.coder.check()?;
    // Nothing hangs on the posts of the last two levels, so none of the base can have been touched but to be removed.
    let is_touched_in_vain = levels.iter().flatten().any(|visit| !visit.new);
    if is_touched_in_vain { Err(DecodeError::NotCanonical) } else { Ok(()) }
}

impl<C: Coder, S: State> Walk<'_, C, S> {
    /// The centre, and its four children on the border, which hang on nothing.
    fn first_levels(&mut self, levels: &mut [Vec<Visit>; 3]) -> Result<(), DecodeError> {
        let mut free = Said { children: 1, bits: 1, must_change: false, fresh: !self.is_delta };
        let [south_west, south_east, north_west, north_east] = self.root.corners();
        let corners = [south_east, south_west, north_west, north_east]
            .map(|post| Known { post, height: self.state.corner(post) });
        let post = midpoint(south_west, north_east);
        self.place(Diamond { post, corners, is_cut: false }, FIRST_LENGTH, free, &mut levels[0])?;
        let Some((height, new)) = self.state.now(post) else { return Ok(()) };
        free.fresh = new;
        let centre = Known { post, height };
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let diamond = Diamond { post: midpoint(a.post, b.post), corners: [centre, a, centre, b], is_cut: true };
            self.place(diamond, FIRST_LENGTH, free, &mut levels[1])?;
        }
        Ok(())
    }

    fn visit(&mut self, visit: &Visit, found: &mut Vec<Visit>) -> Result<(), DecodeError> {
        let children = self.children(&visit.diamond);
        let mut places = places(&visit.diamond, &children);
        let active = children.active.count_ones() as usize;
        let (mut bits, mut changed) = (1, visit.new);
        while places != 0 {
            let k = places.trailing_zeros();
            places &= places - 1;
            let said = Said {
                children: active,
                bits,
                must_change: !changed && places == 0,
                fresh: visit.new || children.new & (1 << before(k) | 1 << k) != 0,
            };
            let length = if self.is_delta { expected_length(visit, &children, k) } else { 0 };
            let bit = self.place(diamond_at(visit, &children, k), length, said, found)?;
            bits = bits << 1 | usize::from(bit);
            changed |= bit;
        }
        self.coder.check()?;
        if changed { Ok(()) } else { Err(DecodeError::NotCanonical) }
    }

    fn children(&self, diamond: &Diamond) -> Children {
        let corners = &diamond.corners;
        let mut children = Children { at: *corners, active: 0, new: 0 };
        let missing = u32::from(diamond.is_cut) * BESIDE_SECOND_APEX;
        for k in (0..4).filter(|k| missing >> k & 1 == 0) {
            let post = midpoint(corners[k].post, corners[(k + 1) % 4].post);
            if let Some((height, new)) = self.state.now(post) {
                children.at[k] = Known { post, height };
                children.active |= 1 << k;
                children.new |= u32::from(new) << k;
            }
        }
        children
    }

    /// Says what becomes of a place, and whether that is a change; if it is to be visited, it is `found`. A height's
    /// difference is expected to have `length` bits in a delta.
    fn place(
        &mut self,
        diamond: Diamond,
        length: u32,
        said: Said,
        found: &mut Vec<Visit>,
    ) -> Result<bool, DecodeError> {
        let p = diamond.post;
        let wanted = self.state.wanted(p);
        let Some(height) = self.state.held(p) else {
            let context = match said.fresh {
                true => &mut self.model.active[16 * (said.children - 1) + said.bits],
                false => &mut self.model.added[said.children],
            };
            if !said.must_change && !self.coder.bit(context, wanted.is_some()) {
                return Ok(false);
            }
            let height = self.height(&diamond, length, wanted.unwrap_or(0))?;
            self.state.add(p, height, if diamond.is_cut { 1 } else { 2 })?;
            found.push(Visit { diamond, height, new: true });
            return Ok(true);
        };
        let (children, size) = self.below(&diamond);
        let touched = &mut self.model.touched[size][said.turn()];
        let is_touched = wanted.is_none() || self.state.is_changed_below(p);
        if !said.must_change && !self.coder.bit(touched, is_touched) {
            return Ok(false);
        }
        if self.coder.bit(&mut self.model.removed[children], wanted.is_none()) {
            self.state.remove(p);
        } else {
            found.push(Visit { diamond, height, new: false });
        }
        Ok(true)
    }

    /// The children that a post of the base has there, and the row of its size.
    fn below(&self, diamond: &Diamond) -> (usize, usize) {
        let is_held = |p: Post| self.state.held(p).is_some();
        let children = self.root.children(diamond.post).filter(|&c| is_held(c)).count();
        if children < 4 {
            return (children, children);
        }
        let size = 4 + diamond.corners.iter().filter(|c| is_held(midpoint(diamond.post, c.post))).count();
        let level = usize::from(self.root.level(diamond.post).unwrap_or(0));
        (children, if size < FULL_SIZE { size } else { (FULL_SIZE + level / 4).min(SIZES - 1) })
    }

    fn height(&mut self, diamond: &Diamond, length: u32, said: i32) -> Result<i32, DecodeError> {
        let [apex, end, other, far] = diamond.corners.map(|c| c.height);
        let corners = Corners { base: [end, far], apexes: [apex, if diamond.is_cut { apex } else { other }] };
        let heights = &mut self.model.heights;
        let length = if self.is_delta { length } else { heights.usual_length() };
        heights.code(self.coder, diamond.post, &corners, length, said)
    }
}

/// The number before `k`, going round.
fn before(k: u32) -> u32 {
    (k + 3) % 4
}

/// Towards which corners there is a place: where the children on both sides are active, as far as they exist.
fn places(diamond: &Diamond, children: &Children) -> u32 {
    let cut = u32::from(diamond.is_cut);
    let open = children.active | (cut * BESIDE_SECOND_APEX);
    // Bit k of the turned ones is that of child k - 1.
    let turned = (open << 1 | open >> 3) & 0b1111;
    open & turned & !(cut << SECOND_APEX)
}

/// The diamond at the place towards corner `k`, between child k - 1 and child k, of which the border may have cut one.
fn diamond_at(visit: &Visit, children: &Children, k: u32) -> Diamond {
    let on = Known { post: visit.diamond.post, height: visit.height };
    let corner = visit.diamond.corners[k as usize % 4];
    let is_there = |child: u32| children.active >> child & 1 == 1;
    let (first, second) = (before(k), k);
    let child = |child: u32, other: u32| children.at[if is_there(child) { child } else { other } as usize % 4];
    Diamond {
        post: midpoint(on.post, corner.post),
        corners: [child(first, second), on, child(second, first), corner],
        is_cut: !(is_there(first) && is_there(second)),
    }
}

fn midpoint(a: Post, b: Post) -> Post {
    Post::new((a.i + b.i) / 2, (a.j + b.j) / 2)
}

/// The bit length of the mean of what the split of the post visited, and of those of the apexes of place `k`, changed:
/// their heights above the midpoints of their bases.
fn expected_length(visit: &Visit, children: &Children, k: u32) -> u32 {
    let c = &visit.diamond.corners;
    let above = |height: i32, a: Known, b: Known| {
        (i64::from(height) - ((i64::from(a.height) + i64::from(b.height)) >> 1)).abs()
    };
    let (mut sum, mut count) = (above(visit.height, c[1], c[3]), 1);
    for k in [before(k), k].into_iter().filter(|k| children.active >> k & 1 == 1).map(|k| k as usize) {
        sum += above(children.at[k].height, c[k], c[(k + 1) % 4]);
        count += 1;
    }
    bit_length(sum / count)
}
