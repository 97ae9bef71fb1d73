//! Geomorphing: a new post slides from the surface that was drawn there to its height, and one that leaves slides back.
//!
//! Morphing is drawing only. The replica, its hash and all verdicts are of the frame's mesh; a [`Morph`] holds what is
//! drawn between frames, over a time that the client chose. All that it needs is in the frames: the posts that came and
//! went, with heights; where a post slides from is halfway between the ends of its base (as in Hoppe, "Smooth
//! view-dependent level-of-detail control", with the base midpoint in place of the vertex split's parent).
//!
//! **Sight lines stand still.** No vertex of a triangle that a registered line meets in plan, on the frame before, on
//! the frame itself or on what is drawn, ever slides: it jumps. So each line has the same verdict on what is drawn as
//! on the frame, at every moment.
//!
//! Posts that leave are drawn until they are done, so what is drawn may have more triangles than the frame:
//! [`Drawn::triangles`] and [`Drawn::frame_triangles`] tell both.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    ops::ControlFlow,
};

use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::{Mesh, triangle_count},
    replica::Replica,
    verdict::for_each_triangle_met,
};

/// A line in the grid frame, from end to end.
pub type Line = [[f64; 3]; 2];

/// What is drawn of one view, from frame to frame.
#[derive(Clone, Debug)]
pub struct Morph {
    duration_s: f64,
    frame: Drawn,
    sliding: BTreeMap<Post, Slide>,
}

/// A post on its way.
#[derive(Clone, Copy, Debug)]
struct Slide {
    /// Where it has its own height, in height units.
    height: f64,
    /// Whether it comes.
    comes: bool,
    /// How much of it is there: 0 where its base is, 1 at its own height. At `since_s`.
    weight: f64,
    since_s: f64,
}

impl Slide {
    fn weight(&self, duration_s: f64, now_s: f64) -> f64 {
        let share = ((now_s - self.since_s) / duration_s).max(0.0);
        if self.comes { (self.weight + share).min(1.0) } else { (self.weight - share).max(0.0) }
    }

    fn is_done(&self, duration_s: f64, now_s: f64) -> bool {
        self.weight(duration_s, now_s) == if self.comes { 1.0 } else { 0.0 }
    }
}

impl Morph {
    /// Nothing slides yet: what is drawn is the mesh of `replica`. Each slide takes `duration_s` seconds; one that is
    /// not above 0, or not a number, lets every post jump.
    pub fn new(replica: &Replica, duration_s: f64) -> Self {
        let duration_s = if duration_s > 0.0 { duration_s } else { 0.0 };
        Self { duration_s, frame: Drawn::of(replica), sliding: BTreeMap::new() }
    }

    /// Takes the mesh of the next frame at time `now_s`, in seconds of any clock that does not go back. `lines` are the
    /// registered sight lines whose triangles must not slide.
    pub fn advance(&mut self, replica: &Replica, lines: &[Line], now_s: f64) {
        self.settle(now_s);
        let after = Drawn::of(replica);
        let still: BTreeSet<Post> = [&self.frame, &after].into_iter().flat_map(|mesh| met(mesh, lines)).collect();
        let before = std::mem::replace(&mut self.frame, after);
        if self.duration_s == 0.0 {
            return;
        }
        let came = self.frame.heights.iter().filter(|(key, _)| !before.heights.contains_key(key));
        let went = before.heights.iter().filter(|(key, _)| !self.frame.heights.contains_key(key));
        let changes = came.map(|change| (change, true)).chain(went.map(|change| (change, false)));
        for ((&key, &height), comes) in changes {
            let p = Post::from_key(key);
            let unmoved = if comes { 0.0 } else { 1.0 };
            let weight = self.sliding.get(&p).map_or(unmoved, |slide| slide.weight(self.duration_s, now_s));
            self.sliding.insert(p, Slide { height, comes, weight, since_s: now_s });
        }
        for p in still {
            self.jump(p);
        }
        // What has not jumped may still subdivide the triangles under a line.
        loop {
            let sliding: Vec<_> =
                met(&self.drawn(now_s), lines).into_iter().filter(|p| self.sliding.contains_key(p)).collect();
            if sliding.is_empty() {
                return;
            }
            for p in sliding {
                self.jump(p);
            }
        }
    }

    /// What is to be drawn at time `now_s`.
    pub fn drawn(&self, now_s: f64) -> Drawn {
        let mut drawn = self.frame.clone();
        // Coarse posts first: where a post slides from depends on them.
        let mut sliding: Vec<_> = self.sliding.iter().collect();
        sliding.sort_by_key(|&(&p, _)| (drawn.root.level(p), p));
        for (&p, slide) in sliding {
            let Some(ends) = drawn.root.base_ends(p) else { continue };
            let [from, to] = ends.map(|end| drawn.height(end).unwrap_or(slide.height));
            let base = 0.5 * from + 0.5 * to;
            let weight = slide.weight(self.duration_s, now_s);
            let height = if weight == 1.0 { slide.height } else { base + weight * (slide.height - base) };
            drawn.heights.insert(p.key(), height);
        }
        let posts: Vec<_> = drawn.heights.keys().map(|&key| Post::from_key(key)).collect();
        drawn.triangles = triangle_count(drawn.root, &posts);
        drawn
    }

    /// Whether nothing slides any more at time `now_s`: what is drawn is the frame.
    pub fn is_still(&self, now_s: f64) -> bool {
        self.sliding.values().all(|slide| slide.is_done(self.duration_s, now_s))
    }

    /// Forgets the slides that are done. A post that left is kept as long as one that hangs on it is on its way.
    fn settle(&mut self, now_s: f64) {
        let root = self.frame.root;
        let mut done: Vec<_> = self.sliding.iter().filter(|(_, s)| s.is_done(self.duration_s, now_s)).collect();
        done.sort_by_key(|&(&p, _)| std::cmp::Reverse(root.level(p)));
        for p in done.into_iter().map(|(&p, _)| p).collect::<Vec<_>>() {
            if self.sliding[&p].comes || !root.children(p).any(|child| self.sliding.contains_key(&child)) {
                self.sliding.remove(&p);
            }
        }
    }

    /// Ends a slide at once, and with a post that leaves those of the posts that hang on it.
    fn jump(&mut self, p: Post) {
        let Some(slide) = self.sliding.remove(&p) else { return };
        if !slide.comes {
            for child in self.frame.root.children(p) {
                self.jump(child);
            }
        }
    }
}

/// The vertices of the triangles that any of `lines` meets.
fn met(mesh: &Drawn, lines: &[Line]) -> BTreeSet<Post> {
    let mut posts = BTreeSet::new();
    for &[a, b] in lines {
        let _ = for_each_triangle_met(mesh, a, b, |triangle| {
            posts.extend(triangle.corners());
            ControlFlow::Continue(())
        });
    }
    posts
}

/// A mesh with the heights at which it is drawn.
#[derive(Clone, Debug)]
pub struct Drawn {
    root: RootSquare,
    grid: (u32, u32),
    /// By [`Post::key`], in height units.
    heights: HashMap<u64, f64>,
    triangles: u64,
    frame_triangles: u32,
}

impl Drawn {
    fn of(replica: &Replica) -> Self {
        let heights = replica.posts().into_iter().map(|(p, height)| (p.key(), f64::from(height))).collect();
        let triangles = replica.triangle_count();
        let (root, grid) = (replica.root(), replica.grid_size());
        Self { root, grid, heights, triangles: u64::from(triangles), frame_triangles: triangles }
    }

    /// Triangles drawn: those of the frame, and those of posts that are leaving.
    pub fn triangles(&self) -> u64 {
        self.triangles
    }

    /// Triangles of the frame.
    pub fn frame_triangles(&self) -> u32 {
        self.frame_triangles
    }
}

impl Mesh for Drawn {
    fn root(&self) -> RootSquare {
        self.root
    }

    fn grid_size(&self) -> (u32, u32) {
        self.grid
    }

    fn height(&self, p: Post) -> Option<f64> {
        self.heights.get(&p.key()).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use sightline_proto::{mesh::closure, v1, verdict::verdict_on_mesh};

    const SIDE: u32 = 16;
    const DURATION_S: f64 = 2.0;

    fn height(p: Post) -> i32 {
        (p.key().wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 58) as i32
    }

    fn flat() -> Replica {
        let corners = [(0, 0), (SIDE, 0), (0, SIDE), (SIDE, SIDE)].map(|(i, j)| i64::from(height(Post::new(i, j))));
        let terrain = v1::TerrainDescription {
            nx: SIDE + 1,
            ny: SIDE + 1,
            root_exponent: SIDE.trailing_zeros(),
            metres_per_post_east: 10.0,
            metres_per_post_north: 10.0,
            metres_per_height_unit: 1.0,
            corner_heights: corners.to_vec(),
            ..Default::default()
        };
        Replica::new(&terrain).unwrap()
    }

    fn mesh(posts: &[(u32, u32)]) -> Replica {
        let flat = flat();
        let posts = closure(flat.root(), posts.iter().map(|&(i, j)| Post::new(i, j)));
        flat.with_posts(posts.into_iter().map(|p| (p, height(p))), 1).unwrap()
    }

    /// The drawn height over every post of the square.
    fn surface(mesh: &Drawn) -> Vec<f64> {
        let mut heights = vec![f64::NAN; ((SIDE + 1) * (SIDE + 1)) as usize];
        mesh.for_each_triangle(|t| {
            let c = t.corners().map(|p| (f64::from(p.i), f64::from(p.j), mesh.height(p).unwrap()));
            let area = |a: (f64, f64, f64), b: (f64, f64, f64), x: f64, y: f64| {
                (b.0 - a.0) * (y - a.1) - (b.1 - a.1) * (x - a.0)
            };
            for (n, slot) in heights.iter_mut().enumerate() {
                let (x, y) = ((n as u32 % (SIDE + 1)) as f64, (n as u32 / (SIDE + 1)) as f64);
                let w = [area(c[1], c[2], x, y), area(c[2], c[0], x, y), area(c[0], c[1], x, y)];
                if w.iter().all(|&w| w >= 0.0) {
                    *slot = (w[0] * c[0].2 + w[1] * c[1].2 + w[2] * c[2].2) / (w[0] + w[1] + w[2]);
                }
            }
        });
        heights
    }

    fn seeds() -> impl Strategy<Value = Vec<(u32, u32)>> {
        prop::collection::vec((0..=SIDE, 0..=SIDE), 0..12)
    }

    fn line() -> impl Strategy<Value = Line> {
        let end = || [0.0..f64::from(SIDE), 0.0..f64::from(SIDE), 0.0..64.0_f64];
        [end(), end()]
    }

    proptest! {
        #[test]
        fn what_is_drawn_moves_without_a_jump_and_ends_at_the_frame(
            frames in prop::collection::vec((seeds(), 0.0..3.0_f64), 1..6),
        ) {
            let mut morph = Morph::new(&flat(), DURATION_S);
            let mut now_s = 0.0;
            for (seeds, pause_s) in frames {
                let replica = mesh(&seeds);
                let before = surface(&morph.drawn(now_s));
                morph.advance(&replica, &[], now_s);
                let after = surface(&morph.drawn(now_s));
                for (b, a) in before.iter().zip(&after) {
                    prop_assert!((a - b).abs() < 1e-9, "{b} became {a}");
                }
                let drawn = morph.drawn(now_s + DURATION_S * 0.5);
                prop_assert_eq!(drawn.frame_triangles(), replica.triangle_count());
                prop_assert!(drawn.triangles() >= u64::from(drawn.frame_triangles()));
                let end_s = now_s + DURATION_S * 1.001;
                prop_assert!(morph.is_still(end_s));
                let mut settled = morph.clone();
                settled.settle(end_s);
                let (drawn, frame) = (settled.drawn(end_s), Drawn::of(&replica));
                prop_assert_eq!(drawn.heights, frame.heights);
                now_s += pause_s;
            }
        }

        #[test]
        fn sight_lines_have_the_verdicts_of_the_frame_at_every_moment(
            frames in prop::collection::vec((seeds(), 0.0..3.0_f64), 1..6),
            lines in prop::collection::vec(line(), 1..4),
        ) {
            let mut morph = Morph::new(&flat(), DURATION_S);
            let mut now_s = 0.0;
            for (seeds, pause_s) in frames {
                let replica = mesh(&seeds);
                morph.advance(&replica, &lines, now_s);
                for part in [0.0, 0.3, 0.9, 1.5] {
                    let drawn = morph.drawn(now_s + part * pause_s);
                    for p in met(&drawn, &lines) {
                        prop_assert_eq!(drawn.height(p), replica.height(p), "{:?} slides", p);
                    }
                    for [a, b] in &lines {
                        prop_assert_eq!(verdict_on_mesh(&drawn, *a, *b), verdict_on_mesh(&replica, *a, *b));
                    }
                }
                now_s += pause_s;
            }
        }
    }

    #[test]
    fn without_a_duration_posts_jump() {
        for duration_s in [0.0, -1.0, f64::NAN] {
            let mut morph = Morph::new(&flat(), duration_s);
            let replica = mesh(&[(5, 7)]);
            morph.advance(&replica, &[], 1.0);
            assert!(morph.is_still(1.0));
            assert_eq!(morph.drawn(1.0).heights, Drawn::of(&replica).heights);
        }
    }
}
