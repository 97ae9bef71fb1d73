//! A mesh as bytes, and back: the payload of a frame. `WIRE.md` beside this crate specifies it byte by byte.
//!
//! Both sides walk the mesh level by level and meet the same *candidates* in the same order: a candidate is a diamond
//! whose parents are all active. A snapshot says of each candidate whether it is active; a delta says which candidates
//! changed against the base mesh, by the lengths of the runs between them. So a set of posts that is no mesh cannot be
//! expressed, a post that loses its parent goes without a word, and a payload has exactly one form: decoding and
//! encoding again gives the same bytes.
//!
//! DESIGN planned a depth-first walk. Level order was taken because all parents lie one level up: they are decided
//! before a diamond is met, and most bits of a depth-first walk that could only say "no" are not there.
//!
//! Numbers are Rice codes whose parameter follows the running mean (as in Weinberger, Seroussi, Sapiro, "The LOCO-I
//! lossless image compression algorithm", 2000, section III-C, without its contexts): integers only, so the same bits
//! everywhere.

use thiserror::Error;

use crate::{
    bits::{BitReader, BitWriter},
    diamond::{Post, RootSquare},
    replica::PostMap,
};

/// The version of the payload that this code writes and reads.
pub const PAYLOAD_VERSION: u8 = 1;
/// The kind byte of a payload that is based on nothing.
pub const KIND_SNAPSHOT: u8 = 1;
/// The kind byte of a payload that changes another mesh.
pub const KIND_DELTA: u8 = 2;

/// Ones before an escaped number; no Rice code has as many.
const ESCAPE_ONES: u32 = 24;
/// Width of an escaped number: a height residual folded to unsigned needs 34 bits.
const ESCAPE_BITS: u32 = 34;
/// The count of a running mean at which count and sum are halved, so that it follows the data.
const MEAN_WINDOW: u64 = 32;
/// Sum with which the mean of height residuals starts (count 1).
const HEIGHT_MEAN_START: u64 = 16;
/// Sum with which the mean of runs starts (count 1).
const RUN_MEAN_START: u64 = 256;

/// Why bytes are not a mesh payload.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum DecodeError {
    /// Another version of the payload.
    #[error("mesh payload of version {0}; this side reads version {PAYLOAD_VERSION}")]
    Version(u8),
    /// Neither a snapshot nor a delta.
    #[error("mesh payload of unknown kind {0}")]
    Kind(u8),
    /// The bytes end too early.
    #[error("mesh payload ends before the mesh does")]
    Truncated,
    /// There is more than the mesh needs.
    #[error("mesh payload goes on after the mesh, or its last bits are not zero")]
    Trailing,
    /// A number is written in a longer form than it needs.
    #[error("mesh payload has a number in a form that no encoder writes")]
    NotCanonical,
    /// The count does not fit what follows.
    #[error("mesh payload announces {announced} posts and holds {found}")]
    Count {
        /// Posts or changes announced.
        announced: u64,
        /// Posts or changes found.
        found: u64,
    },
    /// More triangles than the caller allows.
    #[error("mesh payload makes more than {0} triangles")]
    TooManyTriangles(u32),
    /// A height that no frame can carry.
    #[error("height {height} of post ({i}, {j}) does not fit 32 bits", i = post.i, j = post.j)]
    Height {
        /// The post.
        post: Post,
        /// The height decoded.
        height: i64,
    },
}

/// A running mean that chooses the parameter of a Rice code.
struct Mean {
    sum: u64,
    count: u64,
}

impl Mean {
    fn starting_at(sum: u64) -> Self {
        Self { sum, count: 1 }
    }

    /// The least k with count * 2^(k + 1) > sum: 2^k lies between half the mean and the mean.
    fn parameter(&self) -> u32 {
        let mut k = 0;
        while self.count << (k + 1) <= self.sum {
            k += 1;
        }
        k
    }

    fn add(&mut self, value: u64) {
        self.sum += value;
        self.count += 1;
        if self.count == MEAN_WINDOW {
            self.sum /= 2;
            self.count /= 2;
        }
    }

    fn write(&mut self, out: &mut BitWriter, value: u64) {
        let k = self.parameter();
        let ones = value >> k;
        if ones < u64::from(ESCAPE_ONES) {
            out.ones(ones as u32);
            out.bits(0, 1);
            out.bits(value, k);
        } else {
            out.ones(ESCAPE_ONES);
            out.bits(value, ESCAPE_BITS);
        }
        self.add(value);
    }

    fn read(&mut self, from: &mut BitReader) -> Result<u64, DecodeError> {
        let k = self.parameter();
        let mut ones = 0;
        while ones < ESCAPE_ONES && from.bits(1)? == 1 {
            ones += 1;
        }
        let value = if ones < ESCAPE_ONES {
            u64::from(ones) << k | from.bits(k)?
        } else {
            let value = from.bits(ESCAPE_BITS)?;
            if value >> k < u64::from(ESCAPE_ONES) {
                return Err(DecodeError::NotCanonical);
            }
            value
        };
        self.add(value);
        Ok(value)
    }
}

/// Folds a signed number to an unsigned one: 0, -1, 1, -2, 2 become 0, 1, 2, 3, 4.
fn fold(v: i64) -> u64 {
    ((v << 1) ^ (v >> 63)) as u64
}

fn unfold(v: u64) -> i64 {
    (v >> 1) as i64 ^ -((v & 1) as i64)
}

/// Walks the candidates of the mesh that `active` is making, level by level.
///
/// `active(p)` is asked once for each candidate, and answers whether it is active; `is_active` asks for those that have
/// been answered. The order: the centre of the square; then, for each active post of a level in the order of the walk,
/// its children by (j, i), each at the greatest of its parents by (j, i).
fn walk<S, E>(
    root: RootSquare,
    state: &mut S,
    mut active: impl FnMut(&mut S, Post) -> Result<bool, E>,
    is_active: impl Fn(&S, Post) -> bool,
) -> Result<(), E> {
    let mut level = Vec::new();
    if root.exponent() > 0 {
        let centre = Post::new(root.side() / 2, root.side() / 2);
        if active(state, centre)? {
            level.push(centre);
        }
    }
    while !level.is_empty() {
        let mut next = Vec::new();
        for &p in &level {
            for child in root.children(p) {
                let mut parents = root.parents(child);
                let (first, last) = (parents.next(), parents.next());
                let met_here = last.or(first) == Some(p);
                if met_here && first.is_none_or(|q| q == p || is_active(state, q)) && active(state, child)? {
                    next.push(child);
                }
            }
        }
        level = next;
    }
    Ok(())
}

/// The height that is expected at `p`: halfway between the ends of its diamond's base, rounded down.
fn expected_height(root: RootSquare, p: Post, height: impl Fn(Post) -> Option<i32>) -> i64 {
    let [e0, e1] = root.base_ends(p).unwrap_or([p; 2]);
    let at = |p| i64::from(height(p).unwrap_or(0));
    (at(e0) + at(e1)) >> 1
}

/// Encodes the mesh with posts `new` (the corners included), based on `base` or on nothing.
pub(crate) fn encode(root: RootSquare, base: Option<&PostMap>, new: &PostMap) -> Vec<u8> {
    let mut body = Body {
        root,
        base,
        new,
        out: BitWriter::default(),
        changes: 0,
        run: 0,
        runs: Mean::starting_at(RUN_MEAN_START),
        heights: Mean::starting_at(HEIGHT_MEAN_START),
    };
    let walked: Result<(), std::convert::Infallible> =
        walk(root, &mut body, |body, p| Ok(body.candidate(p)), |body, p| body.new.contains_key(&p.key()));
    let Ok(()) = walked;
    let mut bytes = vec![PAYLOAD_VERSION, if base.is_some() { KIND_DELTA } else { KIND_SNAPSHOT }];
    write_varint(&mut bytes, body.changes);
    bytes.extend(body.out.finish());
    bytes
}

struct Body<'a> {
    root: RootSquare,
    base: Option<&'a PostMap>,
    new: &'a PostMap,
    out: BitWriter,
    changes: u64,
    /// Candidates since the last change.
    run: u64,
    runs: Mean,
    heights: Mean,
}

impl Body<'_> {
    fn candidate(&mut self, p: Post) -> bool {
        let height = self.new.get(&p.key()).copied();
        let changed = match self.base {
            None => {
                self.out.bits(u64::from(height.is_some()), 1);
                height.is_some()
            }
            Some(base) if base.contains_key(&p.key()) == height.is_some() => {
                self.run += 1;
                false
            }
            Some(_) => {
                self.runs.write(&mut self.out, self.run);
                self.run = 0;
                true
            }
        };
        self.changes += u64::from(changed);
        if let (true, Some(h)) = (changed, height) {
            let expected = expected_height(self.root, p, |q| self.new.get(&q.key()).copied());
            self.heights.write(&mut self.out, fold(i64::from(h) - expected));
        }
        height.is_some()
    }
}

/// What a payload is based on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// On nothing.
    Snapshot,
    /// On an earlier mesh.
    Delta,
}

/// The kind that a payload says it has.
pub fn kind(payload: &[u8]) -> Result<Kind, DecodeError> {
    match payload {
        [PAYLOAD_VERSION, KIND_SNAPSHOT, ..] => Ok(Kind::Snapshot),
        [PAYLOAD_VERSION, KIND_DELTA, ..] => Ok(Kind::Delta),
        [PAYLOAD_VERSION, other, ..] => Err(DecodeError::Kind(*other)),
        [PAYLOAD_VERSION] | [] => Err(DecodeError::Truncated),
        [other, ..] => Err(DecodeError::Version(*other)),
    }
}

/// Decodes a payload into a new set of posts with the corners of `base`; a delta changes `base`.
///
/// Memory is proportional to the payload and `base`: each post of the result is one of `base` or took bits.
pub(crate) fn decode(
    root: RootSquare,
    base: &PostMap,
    payload: &[u8],
    max_triangles: u32,
) -> Result<PostMap, DecodeError> {
    let kind = kind(payload)?;
    let (announced, rest) = read_varint(&payload[2..])?;
    let corners = root.corners().into_iter().filter_map(|p| base.get_key_value(&p.key()));
    let mut reader = Reader {
        root,
        base: (kind == Kind::Delta).then_some(base),
        new: corners.map(|(&k, &h)| (k, h)).collect(),
        from: BitReader::new(rest),
        announced,
        changes: 0,
        run: None,
        runs: Mean::starting_at(RUN_MEAN_START),
        heights: Mean::starting_at(HEIGHT_MEAN_START),
        triangles: 2,
        max_triangles,
    };
    walk(root, &mut reader, Reader::candidate, |reader, p| reader.new.contains_key(&p.key()))?;
    if reader.changes != announced {
        return Err(DecodeError::Count { announced, found: reader.changes });
    }
    reader.from.finish()?;
    Ok(reader.new)
}

struct Reader<'a> {
    root: RootSquare,
    base: Option<&'a PostMap>,
    new: PostMap,
    from: BitReader<'a>,
    announced: u64,
    changes: u64,
    /// Candidates before the next change, once read.
    run: Option<u64>,
    runs: Mean,
    heights: Mean,
    triangles: u64,
    max_triangles: u32,
}

impl Reader<'_> {
    fn candidate(&mut self, p: Post) -> Result<bool, DecodeError> {
        let held = self.base.and_then(|base| base.get(&p.key())).copied();
        let changed = match self.base {
            None => self.from.bits(1)? == 1,
            Some(_) => self.change_is_here()?,
        };
        if changed && self.changes == self.announced {
            return Err(DecodeError::Count { announced: self.announced, found: self.changes + 1 });
        }
        self.changes += u64::from(changed);
        let height = match (changed, held) {
            (false, held) => held,
            (true, Some(_)) => None,
            (true, None) => Some(self.height(p)?),
        };
        if let Some(h) = height {
            self.triangles += self.root.parents(p).count() as u64;
            if self.triangles > u64::from(self.max_triangles) {
                return Err(DecodeError::TooManyTriangles(self.max_triangles));
            }
            self.new.insert(p.key(), h);
        }
        Ok(height.is_some())
    }

    /// Of a delta: whether the run before the next change ends at this candidate.
    fn change_is_here(&mut self) -> Result<bool, DecodeError> {
        if self.changes == self.announced {
            return Ok(false);
        }
        let run = match self.run {
            Some(run) => run,
            None => self.runs.read(&mut self.from)?,
        };
        self.run = run.checked_sub(1);
        Ok(run == 0)
    }

    fn height(&mut self, p: Post) -> Result<i32, DecodeError> {
        let expected = expected_height(self.root, p, |q| self.new.get(&q.key()).copied());
        let height = expected + unfold(self.heights.read(&mut self.from)?);
        i32::try_from(height).map_err(|_| DecodeError::Height { post: p, height })
    }
}

/// Seven bits a byte, low ones first, the top bit set on all bytes but the last.
fn write_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn read_varint(bytes: &[u8]) -> Result<(u64, &[u8]), DecodeError> {
    /// Enough for 35 bits; a root square has fewer than 2^62 posts but no frame has more than 2^32 triangles.
    const LONGEST: usize = 5;
    let mut value = 0;
    for (n, &byte) in bytes.iter().enumerate().take(LONGEST) {
        value |= u64::from(byte & 0x7f) << (7 * n);
        if byte < 0x80 {
            let overlong = n > 0 && byte == 0;
            return if overlong { Err(DecodeError::NotCanonical) } else { Ok((value, &bytes[n + 1..])) };
        }
    }
    Err(if bytes.len() < LONGEST { DecodeError::Truncated } else { DecodeError::NotCanonical })
}
