//! Any bytes as a mesh payload: refused without a trace, or a mesh whose encoding is those bytes. The target of libFuzzer
//! and the mutations of `proto/tests/fuzz.rs` ask the same of the same corpus.
//!
//! The first byte of the input chooses the root square and whether there is a base mesh; the rest is the payload. The
//! hash of the frame is made to fit, so that what decodes is applied.

use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
    replica::{ApplyError, Replica},
    v1,
};

/// Most triangles of a mesh that is applied.
pub(crate) const MAX_TRIANGLES: u32 = 20_000;

fn coarsest(exponent: u8) -> Replica {
    let posts = (1_u32 << exponent) + 1;
    let terrain = v1::TerrainDescription {
        nx: posts,
        ny: posts,
        root_exponent: exponent.into(),
        metres_per_post_east: 1.0,
        metres_per_post_north: 1.0,
        metres_per_height_unit: 1.0,
        corner_heights: vec![0, 100, -300, i64::from(i32::MAX)],
        ..Default::default()
    };
    Replica::new(&terrain).expect("a square grid is a terrain")
}

/// Some tens of posts, refined towards a corner and along a line.
fn base(coarsest: &Replica, root: RootSquare) -> Replica {
    let mut posts = std::collections::BTreeMap::new();
    for n in 0..12_u32 {
        let mut open = vec![Post::new((n * 7) & (root.side() - 1), (n * 2) & (root.side() - 1))];
        while let Some(p) = open.pop() {
            if coarsest.integer_height(p).is_none()
                && posts.insert(p, (p.i % 97 * 5 + p.j % 89 * 3) as i32 - 400).is_none()
            {
                open.extend(root.parents(p));
            }
        }
    }
    coarsest.with_posts(posts, 1).expect("posts with their ancestors are a mesh")
}

/// Panics where a promise is broken. What came of it: the refusal, or the number of triangles.
pub(crate) fn check(bytes: &[u8]) -> Result<u32, Option<ApplyError>> {
    let Some((&choice, payload)) = bytes.split_first() else { return Err(None) };
    let coarsest = coarsest([3, 0, 1, 5, 13, 30, 2, 8][usize::from(choice & 7)]);
    let held = if choice & 8 == 0 { coarsest.clone() } else { base(&coarsest, coarsest.root()) };
    let is_delta = payload.first().is_some_and(|first| first & 0x40 != 0);
    let before = if is_delta { held.with_posts(held.posts(), 1).expect("a mesh") } else { held };
    let mut replica = before.clone();
    let mut frame =
        v1::Frame { sequence: 2, base_sequence: is_delta.into(), mesh: payload.to_vec(), ..Default::default() };
    if let Err(ApplyError::Triangles { found, .. }) = replica.apply(&frame, MAX_TRIANGLES) {
        frame.triangle_count = found;
    }
    if let Err(ApplyError::Hash { found, .. }) = replica.apply(&frame, MAX_TRIANGLES) {
        frame.mesh_hash = found;
    }
    assert_eq!(replica.hash(), before.hash());
    assert_eq!(replica.sequence(), before.sequence());
    if let Err(refusal) = replica.apply(&frame, MAX_TRIANGLES) {
        assert_eq!(replica.posts(), before.posts());
        return Err(Some(refusal));
    }
    assert!(replica.triangle_count() <= MAX_TRIANGLES);
    let again = coarsest.with_posts(replica.posts(), 2).expect("what decodes is a mesh");
    assert_eq!((again.hash(), again.triangle_count()), (replica.hash(), replica.triangle_count()));
    assert_eq!(replica.encode(is_delta.then_some(&before)), payload);
    Ok(replica.triangle_count())
}
