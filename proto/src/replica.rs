//! A mesh that is kept up to date by frames: what a client draws, and what a server remembers of the last frame sent.
//!
//! Applying a frame is atomic: it succeeds whole, with the announced triangle count and hash, or changes nothing. No
//! bytes make it panic, and none make it hold more than a small multiple of the frame and the mesh before it. A delta
//! costs what it changes, not what is held.

use std::{
    collections::HashMap,
    hash::{BuildHasher, Hasher},
};

use thiserror::Error;

use crate::{
    codec::{self, DecodeError},
    diamond::{Post, RootSquare, Triangle},
    mesh::Mesh,
    sides::{Changes, PostSet},
    v1,
};

/// Active posts by [`Post::key`], with heights.
pub(crate) type PostMap = HashMap<u64, i32, MixHasher>;

/// A hasher for post keys. Its keys come from meshes that were checked to be meshes, and a client that feeds itself
/// collisions only slows itself down. The order of iteration never reaches a result.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct MixHasher(u64);

impl BuildHasher for MixHasher {
    type Hasher = Self;

    fn build_hasher(&self) -> Self {
        Self(0)
    }
}

impl Hasher for MixHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, n: u64) {
        // One wide product folded upon itself: a third of the time of `mix`, and as good for posts on lattices.
        let product = u128::from(self.0 ^ n) * u128::from(0x9e37_79b9_7f4a_7c15_u64);
        self.0 = (product >> 64) as u64 ^ product as u64;
    }
}

/// A 64-bit mix in which each bit of the argument reaches each bit of the result (splitmix64: Steele, Lea, Flood,
/// "Fast splittable pseudorandom number generators", 2014).
const fn mix(n: u64) -> u64 {
    let mut z = n.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// What one active post adds to the hash of a mesh; see `WIRE.md`.
pub const fn post_hash(p: Post, height: i32) -> u64 {
    mix(mix(p.key()) ^ height as u32 as u64)
}

/// Why a terrain description is none that a replica can stand on.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum TerrainError {
    /// The grid, or its root square.
    #[error("a grid of {nx} x {ny} posts with root exponent {root_exponent} is not one")]
    Grid {
        /// Posts from west to east.
        nx: u32,
        /// Posts from south to north.
        ny: u32,
        /// The exponent of the root square.
        root_exponent: u32,
    },
    /// The corner heights.
    #[error("a terrain has 4 corner heights of 32 bits; here they are {0:?}")]
    Corners(Vec<i64>),
    /// A constant of the scene frame.
    #[error("the metres per post and per height unit must be finite and above 0; here they are {0:?}")]
    Scale([f64; 3]),
}

/// Why a frame could not be applied. The replica is as it was.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum ApplyError {
    /// The payload.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The frame changes another mesh than the one held: ask for a snapshot.
    #[error("frame {sequence} changes frame {base}, but the replica holds frame {held}: ask for a snapshot")]
    Base {
        /// The frame's number.
        sequence: u64,
        /// The frame that it changes.
        base: u64,
        /// The frame held; 0 for none.
        held: u64,
    },
    /// The payload is a snapshot and the frame says that it is not, or the reverse.
    #[error("frame {sequence} and its payload disagree on whether it is a snapshot")]
    Kind {
        /// The frame's number.
        sequence: u64,
    },
    /// Another number of triangles than announced.
    #[error("the frame announces {announced} triangles; its mesh has {found}")]
    Triangles {
        /// By the frame.
        announced: u32,
        /// By the mesh.
        found: u32,
    },
    /// Another hash than announced.
    #[error("the frame announces hash {announced:016x}; its mesh has {found:016x}")]
    Hash {
        /// By the frame.
        announced: u64,
        /// By the mesh.
        found: u64,
    },
}

/// Why posts are not a mesh.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum MeshError {
    /// A post outside the root square, or a corner with another height.
    #[error("post ({}, {}) is outside the root square, or a corner with another height", .0.i, .0.j)]
    Outside(Post),
    /// A post without a parent.
    #[error("post ({}, {}) lacks a parent", .0.i, .0.j)]
    Orphan(Post),
    /// A post given twice, with different heights.
    #[error("post ({}, {}) has two heights", .0.i, .0.j)]
    Twice(Post),
    /// More triangles than can be counted in 32 bits.
    #[error("the mesh has more than 2^32 - 1 triangles")]
    TooManyTriangles,
}

/// A mesh kept up to date by frames. Heights are integers in height units.
#[derive(Clone, Debug)]
pub struct Replica {
    root: RootSquare,
    grid: (u32, u32),
    scale_m: [f64; 3],
    posts: PostMap,
    triangles: u32,
    hash: u64,
    sequence: u64,
}

impl Replica {
    /// The coarsest mesh of a terrain, of two triangles; it has applied no frame.
    pub fn new(terrain: &v1::TerrainDescription) -> Result<Self, TerrainError> {
        let (nx, ny, root_exponent) = (terrain.nx, terrain.ny, terrain.root_exponent);
        let root = RootSquare::covering(nx, ny)
            .filter(|root| u32::from(root.exponent()) == root_exponent)
            .ok_or(TerrainError::Grid { nx, ny, root_exponent })?;
        let scale_m = [terrain.metres_per_post_east, terrain.metres_per_post_north, terrain.metres_per_height_unit];
        if !scale_m.iter().all(|&s| s.is_finite() && s > 0.0) {
            return Err(TerrainError::Scale(scale_m));
        }
        let heights: Result<Vec<i32>, _> = terrain.corner_heights.iter().map(|&h| i32::try_from(h)).collect();
        let corners: Option<[i32; 4]> = heights.ok().and_then(|h| h.try_into().ok());
        let corners = corners.ok_or_else(|| TerrainError::Corners(terrain.corner_heights.clone()))?;
        let posts: PostMap = root.corners().into_iter().map(Post::key).zip(corners).collect();
        let (hash, sequence) = (hash_of(&posts), 0);
        Ok(Self { root, grid: (nx, ny), scale_m, posts, triangles: 2, hash, sequence })
    }

    /// The same terrain with `posts` active beside the corners, as frame `sequence`: what a server keeps of a view.
    pub fn with_posts(&self, posts: impl IntoIterator<Item = (Post, i32)>, sequence: u64) -> Result<Self, MeshError> {
        let mut map = self.corners();
        for (p, height) in posts {
            match map.insert(p.key(), height) {
                None if self.root.contains(p) => {}
                Some(before) if before == height => {}
                Some(_) if !self.root.is_corner(p) => return Err(MeshError::Twice(p)),
                _ => return Err(MeshError::Outside(p)),
            }
        }
        if let Some(orphan) = map.keys().map(|&k| Post::from_key(k)).filter(|&p| self.is_orphan(&map, p)).min() {
            return Err(MeshError::Orphan(orphan));
        }
        let triangles = u32::try_from(count_triangles(self.root, &map)).map_err(|_| MeshError::TooManyTriangles)?;
        let hash = hash_of(&map);
        Ok(Self { posts: map, triangles, hash, sequence, ..*self })
    }

    /// Applies a frame with at most `max_triangles` triangles, or changes nothing.
    pub fn apply(&mut self, frame: &v1::Frame, max_triangles: u32) -> Result<(), ApplyError> {
        let accepted = self.accept(frame, max_triangles)?;
        self.take(accepted);
        Ok(())
    }

    /// [`Replica::apply`], and which posts came and went. Costs what changes; after a snapshot, what is held.
    pub fn apply_noting(&mut self, frame: &v1::Frame, max_triangles: u32) -> Result<PostChanges, ApplyError> {
        let accepted = self.accept(frame, max_triangles)?;
        let changes = &accepted.changes;
        let sorted = |keys: &mut dyn Iterator<Item = u64>| {
            let mut posts: Vec<_> = keys.map(Post::from_key).collect();
            posts.sort_unstable();
            posts
        };
        let noted = if accepted.is_snapshot {
            let stays = |k: &u64| changes.added.contains_key(k) || self.root.is_corner(Post::from_key(*k));
            let comes = |k: &u64| !self.posts.contains_key(k);
            PostChanges {
                added: sorted(&mut changes.added.keys().copied().filter(comes)),
                removed: sorted(&mut self.posts.keys().copied().filter(|k| !stays(k))),
            }
        } else {
            PostChanges {
                added: sorted(&mut changes.added.keys().copied()),
                removed: sorted(&mut changes.removed.iter().copied()),
            }
        };
        self.take(accepted);
        Ok(noted)
    }

    /// What a frame makes of this mesh, with all that it announces checked.
    fn accept(&self, frame: &v1::Frame, max_triangles: u32) -> Result<Accepted, ApplyError> {
        let (sequence, base, held) = (frame.sequence, frame.base_sequence, self.sequence);
        let is_snapshot = codec::kind(&frame.mesh)? == codec::Kind::Snapshot;
        if is_snapshot != (base == 0) {
            return Err(ApplyError::Kind { sequence });
        }
        if base != 0 && base != held {
            return Err(ApplyError::Base { sequence, base, held });
        }
        let changes = codec::decode(self.root, &self.posts, &frame.mesh, max_triangles)?;
        let corners = self.corners();
        let (triangles, hash) = if is_snapshot { (2, hash_of(&corners)) } else { (self.triangles, self.hash) };
        let (triangles, hash) = self.after(&changes, triangles, hash);
        if triangles > u64::from(max_triangles) {
            return Err(DecodeError::TooManyTriangles(max_triangles).into());
        }
        let triangles = u32::try_from(triangles).unwrap_or(u32::MAX);
        if triangles != frame.triangle_count {
            return Err(ApplyError::Triangles { announced: frame.triangle_count, found: triangles });
        }
        if hash != frame.mesh_hash {
            return Err(ApplyError::Hash { announced: frame.mesh_hash, found: hash });
        }
        Ok(Accepted { changes, is_snapshot, triangles, hash, sequence })
    }

    fn take(&mut self, accepted: Accepted) {
        let Accepted { changes, is_snapshot, triangles, hash, sequence } = accepted;
        if is_snapshot {
            let corners = self.corners();
            self.posts = changes.added;
            self.posts.extend(corners);
        } else {
            self.change(&changes);
        }
        (self.triangles, self.hash, self.sequence) = (triangles, hash, sequence);
    }

    /// The same mesh, as if no frame had made it: on a new stream, which counts its frames from 1, only a snapshot fits it.
    pub fn begin_anew(&mut self) {
        self.sequence = 0;
    }

    /// The payload that turns `base` (nothing, when absent) into this mesh. Both must be of the same terrain.
    ///
    /// This compares all posts; a server that knows what changed uses [`Replica::advance`].
    pub fn encode(&self, base: Option<&Self>) -> Vec<u8> {
        let Some(base) = base else { return codec::encode_snapshot(self.root, &self.posts) };
        let removed = base.posts.keys().filter(|&k| !self.posts.contains_key(k)).copied().collect();
        let added = self.posts.iter().filter(|&(k, _)| !base.posts.contains_key(k)).map(|(&k, &h)| (k, h)).collect();
        codec::encode_delta(self.root, &base.posts, &removed, &added)
    }

    /// Becomes the mesh that has lost `removed` and has `added`, as frame `sequence`, and gives the payload that says so;
    /// or changes nothing. Posts that are in both lists keep their place and their height. Costs what changes.
    pub fn advance(&mut self, removed: &[Post], added: &[(Post, i32)], sequence: u64) -> Result<Vec<u8>, MeshError> {
        let mut changes = Changes::default();
        for &(p, height) in added {
            match self.posts.get(&p.key()) {
                _ if !self.root.contains(p) => return Err(MeshError::Outside(p)),
                Some(&held) if held != height => return Err(MeshError::Twice(p)),
                Some(_) => {}
                None if changes.added.insert(p.key(), height).is_some_and(|h| h != height) => {
                    return Err(MeshError::Twice(p));
                }
                None => {}
            }
        }
        let kept: PostSet = added.iter().map(|(p, _)| p.key()).collect();
        for &p in removed.iter().filter(|p| !kept.contains(&p.key())) {
            if self.root.is_corner(p) || !self.posts.contains_key(&p.key()) {
                return Err(MeshError::Outside(p));
            }
            changes.removed.insert(p.key());
        }
        self.check(&changes)?;
        let parents = |k: &u64| self.root.parents(Post::from_key(*k)).count() as u64;
        changes.triangles = (changes.added.keys().map(parents).sum(), changes.removed.iter().map(parents).sum());
        let (triangles, hash) = self.after(&changes, self.triangles, self.hash);
        let triangles = u32::try_from(triangles).map_err(|_| MeshError::TooManyTriangles)?;
        let payload = codec::encode_delta(self.root, &self.posts, &changes.removed, &changes.added);
        self.change(&changes);
        (self.triangles, self.hash, self.sequence) = (triangles, hash, sequence);
        Ok(payload)
    }

    /// Whether no post that is added or stays lacks a parent after `changes`.
    fn check(&self, changes: &Changes) -> Result<(), MeshError> {
        let stays = |k: &u64| self.posts.contains_key(k) && !changes.removed.contains(k);
        let is_active = |p: Post| changes.added.contains_key(&p.key()) || stays(&p.key());
        let children = changes.removed.iter().flat_map(|&k| self.root.children(Post::from_key(k)));
        let widowed = children.filter(|c| stays(&c.key()));
        let added = changes.added.keys().map(|&k| Post::from_key(k));
        let orphans = added.filter(|&p| !self.root.parents(p).all(is_active));
        widowed.chain(orphans).min().map_or(Ok(()), |p| Err(MeshError::Orphan(p)))
    }

    /// Triangles and hash after `changes`, from those before.
    fn after(&self, changes: &Changes, triangles: u32, hash: u64) -> (u64, u64) {
        let gone = changes.removed.iter().filter_map(|&k| Some((k, *self.posts.get(&k)?)));
        let gone = gone.fold(0, |sum: u64, (k, h)| sum.wrapping_add(post_hash(Post::from_key(k), h)));
        let hash = hash.wrapping_add(hash_of(&changes.added)).wrapping_sub(gone);
        (u64::from(triangles) + changes.triangles.0 - changes.triangles.1, hash)
    }

    fn change(&mut self, changes: &Changes) {
        for key in &changes.removed {
            self.posts.remove(key);
        }
        self.posts.extend(&changes.added);
    }

    /// The number of the last frame applied; 0 before the first.
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// The hash of the active posts, the corners included; see `WIRE.md`.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Triangles of the mesh.
    pub fn triangle_count(&self) -> u32 {
        self.triangles
    }

    /// The active posts with their heights, ordered by (j, i); the corners are among them.
    pub fn posts(&self) -> Vec<(Post, i32)> {
        let mut posts: Vec<_> = self.posts.iter().map(|(&k, &h)| (Post::from_key(k), h)).collect();
        posts.sort_unstable();
        posts
    }

    /// The height of an active post in height units; `None` when it is not active.
    pub fn integer_height(&self, p: Post) -> Option<i32> {
        self.posts.get(&p.key()).copied()
    }

    /// Metres per post east, per post north and per height unit.
    pub fn scale_m(&self) -> [f64; 3] {
        self.scale_m
    }

    /// The triangles in depth-first order.
    pub fn triangles(&self) -> Vec<Triangle> {
        let mut triangles = Vec::with_capacity(self.triangles as usize);
        self.for_each_triangle(|t| triangles.push(t));
        triangles
    }

    /// Vertices and indices for a renderer: vertices by (j, i), triangles in depth-first order.
    ///
    /// `origin_m` is a point of the scene frame near the viewer: vertices are relative to it, so that 32-bit numbers do.
    pub fn buffers(&self, origin_m: [f64; 3]) -> Buffers {
        let posts = self.posts();
        let vertex = |&(p, h): &(Post, i32)| {
            let grid = [f64::from(p.i), f64::from(p.j), f64::from(h)];
            [0, 1, 2].map(|n| (grid[n] * self.scale_m[n] - origin_m[n]) as f32)
        };
        let index_of: HashMap<u64, u32, MixHasher> = (0..).zip(&posts).map(|(n, (p, _))| (p.key(), n)).collect();
        let mut indices = Vec::with_capacity(3 * self.triangles as usize);
        self.for_each_triangle(|t| indices.extend(t.corners().map(|p| index_of[&p.key()])));
        Buffers { vertices: posts.iter().map(vertex).collect(), indices }
    }

    fn corners(&self) -> PostMap {
        let keys = self.root.corners().map(Post::key);
        keys.into_iter().filter_map(|k| Some((k, *self.posts.get(&k)?))).collect()
    }

    fn is_orphan(&self, posts: &PostMap, p: Post) -> bool {
        self.root.parents(p).any(|parent| !posts.contains_key(&parent.key()))
    }
}

/// A frame that fits, before anything is changed.
struct Accepted {
    changes: Changes,
    is_snapshot: bool,
    triangles: u32,
    hash: u64,
    sequence: u64,
}

/// The posts that a frame brought and took, each list ordered by (j, i).
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct PostChanges {
    /// Active now, and not before.
    pub added: Vec<Post>,
    /// Active before, and not now.
    pub removed: Vec<Post>,
}

/// A mesh for a renderer. Metres east, north and up of an origin that the caller chose.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Buffers {
    /// One vertex for each active post.
    pub vertices: Vec<[f32; 3]>,
    /// Three for each triangle, counter-clockwise seen from above.
    pub indices: Vec<u32>,
}

impl Mesh for Replica {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        self.grid
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.integer_height(p).map(f64::from)
    }
}

fn hash_of(posts: &PostMap) -> u64 {
    posts.iter().fold(0, |sum: u64, (&k, &h)| sum.wrapping_add(post_hash(Post::from_key(k), h)))
}

/// Two, and for each active post that is no corner one more for each triangle of its diamond.
fn count_triangles(root: RootSquare, posts: &PostMap) -> u64 {
    let splits = posts.keys().map(|&k| root.parents(Post::from_key(k)).count() as u64);
    2 + splits.sum::<u64>()
}
