//! A bintree of triangles with neighbour links, as the papers' own systems keep it: Duchaineau et al., "Good terrain
//! geometry, cheap!", section 4, in the form of Turner's and McNally's tutorials.
//!
//! Each triangle knows the neighbours across its left edge, its right edge and its base. A split is forced along bases
//! until a diamond is found; a diamond whose four children are whole can be merged. This is not the hierarchy of
//! `roam`, which has no links and forces no splits; it serves split-only ROAM and ROAM as published.
//!
//! ```text
//!          apex             ends: left and right of the base, seen with the apex above;
//!         ╱ │ ╲             corners counter-clockwise: left, right, apex.
//!   left ╱  │  ╲ right      children: (middle; apex, left) and (middle; right, apex),
//!       ╱ L │ R ╲           as (apex; left, right).
//!      left─┴─right
//! ```

use sightline_proto::diamond::Post;

/// No triangle.
pub(super) const NONE: u32 = u32::MAX;

/// A triangle of the tree.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Tri {
    /// Number of the triangle in an implicit tree: 1 for a root, 2k and 2k + 1 for the children of k.
    pub(super) number: u32,
    /// Which root it descends from.
    pub(super) root: u8,
    /// Apex, left end, right end.
    pub(super) corners: [Post; 3],
    /// The triangle above; `NONE` for a root.
    pub(super) parent: u32,
    /// The left child; the right one follows it. `NONE` for a leaf.
    pub(super) child: u32,
    left: u32,
    right: u32,
    pub(super) base: u32,
}

/// What happened to the mesh, in order.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Change {
    /// A leaf was replaced by its children.
    Split(u32),
    /// Two leaves were replaced by the triangle above; their slots (child, child + 1) are free.
    Merge {
        /// The triangle above.
        parent: u32,
        /// The slot of the left child.
        child: u32,
    },
}

/// A mesh as the leaves of two trees over one square.
#[derive(Clone, Debug)]
pub(super) struct Bintree {
    tris: Vec<Tri>,
    /// Slots of pairs of children that were merged away.
    free: Vec<u32>,
    leaves: usize,
    /// Changes since they were last taken.
    pub(super) changes: Vec<Change>,
}

impl Bintree {
    /// The two roots of a square of `side` cells, cut from south-west to north-east.
    pub(super) fn new(side: u32) -> Self {
        let [sw, se] = [Post::new(0, 0), Post::new(side, 0)];
        let [nw, ne] = [Post::new(0, side), Post::new(side, side)];
        let root = |root, corners, base| Tri {
            number: 1,
            root,
            corners,
            parent: NONE,
            child: NONE,
            left: NONE,
            right: NONE,
            base,
        };
        let tris = vec![root(0, [se, ne, sw], 1), root(1, [nw, sw, ne], 0)];
        Self { tris, free: Vec::new(), leaves: 2, changes: Vec::new() }
    }

    /// Back to the two roots.
    pub(super) fn reset(&mut self) {
        self.tris.truncate(2);
        for tri in &mut self.tris {
            tri.child = NONE;
        }
        self.free.clear();
        self.changes.clear();
        self.leaves = 2;
    }

    pub(super) fn get(&self, t: u32) -> &Tri {
        &self.tris[t as usize]
    }

    /// Number of triangles in the mesh.
    pub(super) fn leaves(&self) -> usize {
        self.leaves
    }

    pub(super) fn is_leaf(&self, t: u32) -> bool {
        self.get(t).child == NONE
    }

    /// Whether a triangle is a leaf that is not one of the finest.
    pub(super) fn can_split(&self, t: u32) -> bool {
        self.is_leaf(t) && middle(self.get(t)).is_some()
    }

    /// Splits a leaf and what it forces to be split. Nothing happens to one of the finest.
    pub(super) fn split(&mut self, t: u32) {
        if !self.can_split(t) {
            return;
        }
        let base = self.get(t).base;
        if base == NONE {
            self.halve(t);
            return;
        }
        if self.get(base).base != t {
            // Base to edge: the neighbour is one level coarser. Its split gives `t` a new base neighbour.
            self.split(base);
        }
        let base = self.get(t).base;
        self.halve(t);
        self.halve(base);
        let (mine, other) = (self.get(t).child, self.get(base).child);
        // My left child's right edge is half of the base, beyond which lies the other's right child; and so on.
        self.tris[mine as usize].right = other + 1;
        self.tris[mine as usize + 1].left = other;
        self.tris[other as usize].right = mine + 1;
        self.tris[other as usize + 1].left = mine;
    }

    fn halve(&mut self, t: u32) {
        let tri = *self.get(t);
        let Some(m) = middle(&tri) else { return };
        let child = self.free.pop().unwrap_or_else(|| {
            self.tris.extend([tri, tri]);
            self.tris.len() as u32 - 2
        });
        let [apex, left, right] = tri.corners;
        let half = |number, corners, base| Tri {
            number,
            root: tri.root,
            corners,
            parent: t,
            child: NONE,
            left: NONE,
            right: NONE,
            base,
        };
        self.tris[child as usize] = half(2 * tri.number, [m, apex, left], tri.left);
        self.tris[child as usize + 1] = half(2 * tri.number + 1, [m, right, apex], tri.right);
        self.tris[child as usize].left = child + 1;
        self.tris[child as usize + 1].right = child;
        self.relink(tri.left, t, child);
        self.relink(tri.right, t, child + 1);
        self.tris[t as usize].child = child;
        self.leaves += 1;
        self.changes.push(Change::Split(t));
    }

    /// Makes the neighbour `n` of `from` the neighbour of `to` instead.
    fn relink(&mut self, n: u32, from: u32, to: u32) {
        if n == NONE {
            return;
        }
        let tri = &mut self.tris[n as usize];
        for link in [&mut tri.base, &mut tri.left, &mut tri.right] {
            if *link == from {
                *link = to;
            }
        }
    }

    /// Whether `t` is split and its diamond can be merged: its children, and those of the triangle across its base,
    /// are all leaves.
    pub(super) fn can_merge(&self, t: u32) -> bool {
        let whole = |t: u32| {
            let child = self.get(t).child;
            child != NONE && self.is_leaf(child) && self.is_leaf(child + 1)
        };
        let base = self.get(t).base;
        whole(t) && (base == NONE || (self.get(base).base == t && whole(base)))
    }

    /// Merges the diamond of `t`, which must be one that can be.
    pub(super) fn merge(&mut self, t: u32) {
        let base = self.get(t).base;
        self.join(t);
        if base != NONE {
            self.join(base);
        }
    }

    fn join(&mut self, t: u32) {
        let child = self.get(t).child;
        let (left, right) = (self.get(child).base, self.get(child + 1).base);
        self.tris[t as usize].left = left;
        self.tris[t as usize].right = right;
        self.relink(left, child, t);
        self.relink(right, child + 1, t);
        self.tris[t as usize].child = NONE;
        self.free.push(child);
        self.leaves -= 1;
        self.changes.push(Change::Merge { parent: t, child });
    }

    /// The neighbours of a leaf across its left edge, its right edge and its base; `NONE` beyond the border.
    pub(super) fn neighbours(&self, t: u32) -> [u32; 3] {
        let tri = self.get(t);
        [tri.left, tri.right, tri.base]
    }

    /// All leaves, depth first.
    pub(super) fn for_each_leaf(&self, mut visit: impl FnMut(u32, &Tri)) {
        let mut stack = vec![1, 0];
        while let Some(t) = stack.pop() {
            let tri = self.get(t);
            if tri.child == NONE {
                visit(t, tri);
            } else {
                stack.extend([tri.child + 1, tri.child]);
            }
        }
    }

    /// The triangles of the mesh, counter-clockwise.
    pub(super) fn triangles(&self) -> Vec<[Post; 3]> {
        let mut out = Vec::with_capacity(self.leaves);
        self.for_each_leaf(|_, tri| {
            let [apex, left, right] = tri.corners;
            out.push([left, right, apex]);
        });
        out
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.tris.as_slice())
    }
}

/// The middle of a triangle's base; `None` for one of the finest.
pub(super) fn middle(tri: &Tri) -> Option<Post> {
    let [_, l, r] = tri.corners;
    let (i, j) = (l.i + r.i, l.j + r.j);
    (i % 2 == 0 && j % 2 == 0).then(|| Post::new(i / 2, j / 2))
}

/// A number for every triangle of the two full trees of a square, found from children upwards.
#[derive(Clone, Debug)]
pub(super) struct ImplicitTree {
    /// By [`Tri::number`], for both roots.
    values: [Vec<f32>; 2],
}

impl ImplicitTree {
    /// `own(triangle, children)` gives a triangle's value from its corners and its children's values; the finest
    /// triangles have 0.
    pub(super) fn new(side: u32, mut own: impl FnMut(&Tri, Post, [f32; 2]) -> f32) -> Self {
        let levels = 2 * side.trailing_zeros();
        let roots = Bintree::new(side);
        let values = [0, 1].map(|root| {
            let mut values = vec![0.0; 1 << (levels + 1)];
            fill(&mut values, *roots.get(root), &mut own);
            values
        });
        Self { values }
    }

    pub(super) fn get(&self, tri: &Tri) -> f32 {
        self.values[usize::from(tri.root)][tri.number as usize]
    }

    pub(super) fn bytes(&self) -> usize {
        self.values.iter().map(|v| size_of_val(v.as_slice())).sum()
    }
}

fn fill(values: &mut [f32], tri: Tri, own: &mut impl FnMut(&Tri, Post, [f32; 2]) -> f32) -> f32 {
    let Some(m) = middle(&tri) else { return 0.0 };
    let [apex, left, right] = tri.corners;
    let children = [(0, [m, apex, left]), (1, [m, right, apex])]
        .map(|(n, corners)| fill(values, Tri { number: 2 * tri.number + n, corners, ..tri }, own));
    let value = own(&tri, m, children);
    values[tri.number as usize] = value;
    value
}

#[cfg(test)]
mod tests {
    use super::super::{IndexedMesh, Vertex, conformity};
    use super::*;
    use crate::terrain::synthetic::mix;

    fn check(tree: &Bintree, side: u32) {
        let triangles = tree.triangles();
        assert_eq!(triangles.len(), tree.leaves());
        let vertices = triangles.iter().flatten().map(|&post| Vertex { post, z: 0.0 }).collect();
        let triangles = (0..triangles.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
        let mesh = IndexedMesh { extent: [side; 2], vertices, triangles };
        let found = conformity::check(&mesh).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(found.t_junctions, 0);
        // Links hold between leaves, both ways, and across the edges that they name.
        tree.for_each_leaf(|t, tri| {
            let [apex, left, right] = tri.corners;
            for (n, edge) in tree.neighbours(t).into_iter().zip([[apex, left], [right, apex], [left, right]]) {
                let on_border = |f: fn(Post) -> u32, v: u32| edge.iter().all(|&p| f(p) == v);
                let border = [0, side].iter().any(|&v| on_border(|p| p.i, v) || on_border(|p| p.j, v));
                assert_eq!(n == NONE, border, "triangle {t}");
                if n != NONE {
                    assert!(tree.is_leaf(n), "triangle {t} has a neighbour that is not in the mesh");
                    assert!(tree.neighbours(n).contains(&t) && edge.iter().all(|p| tree.get(n).corners.contains(p)));
                }
            }
        });
    }

    #[test]
    fn random_splits_and_merges_keep_the_mesh_and_its_links() {
        for seed in 0..20 {
            let mut tree = Bintree::new(16);
            for n in 0..400 {
                let mut leaves = Vec::new();
                tree.for_each_leaf(|t, _| leaves.push(t));
                let t = leaves[mix(seed ^ mix(n)) as usize % leaves.len()];
                let parent = tree.get(t).parent;
                if (n / 100) % 2 == 0 || parent == NONE {
                    tree.split(t);
                } else if tree.can_merge(parent) {
                    tree.merge(parent);
                }
                if n % 20 == 0 {
                    check(&tree, 16);
                }
            }
            check(&tree, 16);
        }
    }

    #[test]
    fn a_split_is_forced_along_bases() {
        let mut tree = Bintree::new(8);
        // Down one corner: each split of the newest triangle forces coarser ones.
        let mut t = 0;
        for _ in 0..5 {
            tree.split(t);
            t = tree.get(t).child;
        }
        assert!(tree.leaves() > 2 + 2 * 5, "{}", tree.leaves());
        check(&tree, 8);
    }
}
