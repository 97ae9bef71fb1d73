//! The mesh payload of `WIRE.md`: its vectors, and what must hold of any bytes.

use std::collections::BTreeMap;

use proptest::prelude::*;
use sightline_proto::{
    codec::{DELTA_BIT, DecodeError, PAYLOAD_VERSION},
    diamond::{Post, RootSquare},
    mesh::Mesh,
    replica::{ApplyError, MeshError, Replica, post_hash},
    v1,
};

const MAX_TRIANGLES: u32 = 1 << 20;

fn terrain(nx: u32, ny: u32, corner_heights: Vec<i64>) -> v1::TerrainDescription {
    v1::TerrainDescription {
        nx,
        ny,
        root_exponent: RootSquare::covering(nx, ny).map_or(0, |root| root.exponent().into()),
        metres_per_post_east: 30.0,
        metres_per_post_north: 20.0,
        metres_per_height_unit: 0.5,
        corner_heights,
        ..Default::default()
    }
}

fn frame(mesh: Vec<u8>, base: Option<&Replica>, result: &Replica) -> v1::Frame {
    v1::Frame {
        sequence: result.sequence(),
        base_sequence: base.map_or(0, Replica::sequence),
        mesh,
        triangle_count: result.triangle_count(),
        mesh_hash: result.hash(),
        ..Default::default()
    }
}

#[derive(Default, Debug)]
struct Vector {
    name: String,
    fields: BTreeMap<String, String>,
}

fn vectors() -> Vec<Vector> {
    let mut vectors: Vec<Vector> = Vec::new();
    for line in include_str!("../vectors/mesh.txt").lines().filter(|l| !l.starts_with('#') && !l.is_empty()) {
        let (key, value) = line.split_once(' ').unwrap_or((line, ""));
        if key == "vector" {
            vectors.push(Vector { name: value.into(), fields: BTreeMap::new() });
        } else {
            vectors.last_mut().unwrap().fields.insert(key.into(), value.into());
        }
    }
    vectors
}

impl Vector {
    fn numbers(&self, key: &str) -> Vec<i64> {
        self.fields[key].split_whitespace().map(|n| n.parse().unwrap()).collect()
    }

    fn posts(&self, key: &str) -> Option<Vec<(Post, i32)>> {
        let post = |text: &str| {
            let [i, j, h]: [i64; 3] =
                text.split(',').map(|n| n.parse().unwrap()).collect::<Vec<_>>().try_into().unwrap();
            (Post::new(i as u32, j as u32), h as i32)
        };
        Some(self.fields.get(key)?.split_whitespace().map(post).collect())
    }

    fn payload(&self) -> Vec<u8> {
        let hex = &self.fields["payload"];
        (0..hex.len()).step_by(2).map(|n| u8::from_str_radix(&hex[n..n + 2], 16).unwrap()).collect()
    }
}

#[test]
fn conformance_of_the_payload_vectors() {
    let vectors = vectors();
    assert!(vectors.len() >= 9);
    for vector in vectors {
        let name = &vector.name;
        let [nx, ny] = vector.numbers("grid")[..] else { panic!("{name}") };
        let coarsest = Replica::new(&terrain(nx as u32, ny as u32, vector.numbers("corners"))).unwrap();
        let base = vector.posts("base").map(|posts| coarsest.with_posts(posts, 6).unwrap());
        let expected = coarsest.with_posts(vector.posts("posts").unwrap(), 7).unwrap();
        assert_eq!(i64::from(expected.triangle_count()), vector.numbers("triangles")[0], "{name}");
        assert_eq!(format!("{:016x}", expected.hash()), vector.fields["hash"], "{name}");

        assert_eq!(expected.encode(base.as_ref()), vector.payload(), "{name}: encoding");
        let mut replica = base.clone().unwrap_or(coarsest);
        replica.apply(&frame(vector.payload(), base.as_ref(), &expected), MAX_TRIANGLES).unwrap();
        assert_eq!(replica.posts(), expected.posts(), "{name}: decoding");
        assert_eq!((replica.hash(), replica.sequence()), (expected.hash(), 7), "{name}");
    }
}

#[test]
fn conformance_of_the_hash_examples() {
    let examples = [
        ((0, 0, -1), 0xdb3c_c8b8_df11_67a2),
        ((1, 0, -32_768), 0xb3a6_4f69_df09_9e08),
        ((0, 1, i32::MAX), 0xc100_64bc_887c_3785),
        ((1, 1, i32::MIN), 0xf169_b38d_a54d_088f),
        ((2, 2, 40), 0x5ed5_532a_2782_0ae4),
    ];
    for ((i, j, h), hash) in examples {
        assert_eq!(post_hash(Post::new(i, j), h), hash, "({i}, {j}) at {h}");
    }
}

/// A mesh of a terrain of `nx` by `ny` posts: each seed activates a post with its ancestors.
fn mesh_of(coarsest: &Replica, seeds: &[(u32, u32, i32)], sequence: u64) -> Replica {
    let root = coarsest.root();
    let mut posts = BTreeMap::new();
    for &(i, j, height) in seeds {
        let p = Post::new(i % (root.side() + 1), j % (root.side() + 1));
        let mut open = vec![p];
        while let Some(p) = open.pop() {
            if coarsest.integer_height(p).is_none() && posts.insert(p, height ^ (p.i * 3 + p.j) as i32).is_none() {
                open.extend(root.parents(p));
            }
        }
    }
    coarsest.with_posts(posts, sequence).unwrap()
}

/// Heights of all sizes: near zero, 16-bit, any.
fn heights() -> impl Strategy<Value = i32> {
    prop_oneof![4 => -20..20_i32, 4 => -32_768..32_768_i32, 1 => any::<i32>()]
}

fn seeds(n: usize) -> impl Strategy<Value = Vec<(u32, u32, i32)>> {
    prop::collection::vec((any::<u32>(), any::<u32>(), heights()), 0..n)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_replica_equals_its_source_after_any_frames(
        (nx, ny) in prop_oneof![(2..40_u32, 2..40_u32), (1000..1100_u32, 2..2000_u32)],
        corners in prop::collection::vec(heights().prop_map(i64::from), 4),
        states in prop::collection::vec((seeds(30), any::<bool>()), 1..6),
    ) {
        let coarsest = Replica::new(&terrain(nx, ny, corners)).unwrap();
        let mut replica = coarsest.clone();
        let mut sent: Option<Replica> = None;
        for (n, (seeds, snapshot)) in states.iter().enumerate() {
            let state = mesh_of(&coarsest, seeds, n as u64 + 1);
            let base = sent.as_ref().filter(|_| !snapshot);
            // The heights of a terrain never change, but a delta cannot say so: posts that stay keep theirs.
            let kept = base.map_or(state.posts(), |base| {
                let keep = |(p, h)| (p, base.integer_height(p).unwrap_or(h));
                state.posts().into_iter().map(keep).collect()
            });
            let state = coarsest.with_posts(kept, n as u64 + 1).unwrap();
            let payload = state.encode(base);
            replica.apply(&frame(payload.clone(), base, &state), MAX_TRIANGLES).unwrap();
            prop_assert_eq!(replica.posts(), state.posts());
            prop_assert_eq!(replica.hash(), state.hash());
            prop_assert_eq!(replica.triangles().len(), state.triangle_count() as usize);
            prop_assert_eq!(replica.encode(base), payload);
            sent = Some(state);
        }
    }

    #[test]
    fn any_bytes_are_refused_or_make_a_mesh(
        seeds in seeds(12),
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        kind in 1..3_u8,
    ) {
        let coarsest = Replica::new(&terrain(33, 20, vec![0; 4])).unwrap();
        let base = mesh_of(&coarsest, &seeds, 1);
        let mut payload = vec![if kind == 2 { PAYLOAD_VERSION | DELTA_BIT } else { PAYLOAD_VERSION }];
        payload.extend(&bytes);
        // The hash cannot be right, so a payload that decodes shows its mesh in the error.
        let mut replica = base.clone();
        let mut announced = frame(payload, (kind == 2).then_some(&base), &base);
        if let Err(ApplyError::Triangles { found, .. }) = replica.apply(&announced, MAX_TRIANGLES) {
            announced.triangle_count = found;
        }
        match replica.apply(&announced, MAX_TRIANGLES) {
            Err(ApplyError::Hash { found, .. }) => {
                announced.mesh_hash = found;
                replica.apply(&announced, MAX_TRIANGLES).unwrap();
                coarsest.with_posts(replica.posts(), 1).unwrap();
                let again = replica.encode((kind == 2).then_some(&base));
                prop_assert_eq!(again, announced.mesh);
            }
            Err(_) => prop_assert_eq!(replica.posts(), base.posts()),
            Ok(()) => prop_assert_eq!(replica.posts(), base.posts()),
        }
    }
}

/// A snapshot and a delta of some hundred posts.
fn samples() -> (Replica, [(v1::Frame, Replica); 2]) {
    let coarsest = Replica::new(&terrain(60, 44, vec![100, 140, 90, 120])).unwrap();
    let seeds = |salt: u32| -> Vec<_> {
        let at = |n: u32| (n * n * 7 + salt, n * 13 + salt * n, 100 + (n % 17) as i32);
        (0..40).map(at).collect()
    };
    let first = mesh_of(&coarsest, &seeds(1), 1);
    let keep = |(p, h)| (p, first.integer_height(p).unwrap_or(h));
    let second = coarsest.with_posts(mesh_of(&coarsest, &seeds(2), 2).posts().into_iter().map(keep), 2).unwrap();
    let snapshot = frame(first.encode(None), None, &first);
    let delta = frame(second.encode(Some(&first)), Some(&first), &second);
    (coarsest.clone(), [(snapshot, coarsest), (delta, first)])
}

#[test]
fn each_truncation_and_each_flipped_bit_is_refused() {
    let (_, samples) = samples();
    for (good, base) in samples {
        let refused = |mesh: Vec<u8>| {
            let mut replica = base.clone();
            let result = replica.apply(&v1::Frame { mesh, ..good.clone() }, MAX_TRIANGLES);
            assert_eq!(replica.posts(), base.posts(), "a refused frame changed the replica");
            assert_eq!(replica.sequence(), base.sequence());
            result.unwrap_err()
        };
        for length in 0..good.mesh.len() {
            refused(good.mesh[..length].to_vec());
        }
        for bit in 0..8 * good.mesh.len() {
            let mut mesh = good.mesh.clone();
            mesh[bit / 8] ^= 1 << (bit % 8);
            refused(mesh);
        }
        refused([&good.mesh[..], &[0]].concat());
        let mut replica = base.clone();
        replica.apply(&good, MAX_TRIANGLES).unwrap();
    }
}

#[test]
fn other_versions_and_reserved_bits_are_refused() {
    let (_, [(snapshot, coarsest), _]) = samples();
    let refusal = |first: u8| {
        let mesh = [&[first], &snapshot.mesh[1..]].concat();
        coarsest.clone().apply(&v1::Frame { mesh, ..snapshot.clone() }, MAX_TRIANGLES)
    };
    assert_eq!(refusal(0x01), Err(DecodeError::Version(1).into()));
    assert_eq!(refusal(0x03), Err(DecodeError::Version(3).into()));
    assert_eq!(refusal(0x82), Err(DecodeError::Reserved(0x82).into()));
    assert_eq!(refusal(0xc2), Err(DecodeError::Reserved(0xc2).into()));
    assert_eq!(refusal(0x42), Err(ApplyError::Kind { sequence: 1 }));
    let empty = v1::Frame { mesh: Vec::new(), ..snapshot.clone() };
    assert_eq!(coarsest.clone().apply(&empty, MAX_TRIANGLES), Err(DecodeError::Truncated.into()));
}

/// Found by fuzzing: the centre is told as changed and not removed, but nothing can hang on it in a square this small.
#[test]
fn a_change_that_is_told_must_come() {
    let coarsest = Replica::new(&terrain(3, 3, vec![0, 10, 20, 40])).unwrap();
    let mut base = coarsest.with_posts([(Post::new(1, 1), 25), (Post::new(1, 0), 4)], 6).unwrap();
    let announced = v1::Frame { sequence: 7, ..frame(vec![0x42, 0x02, 0xb9], Some(&base), &base) };
    assert_eq!(base.apply(&announced, MAX_TRIANGLES), Err(DecodeError::NotCanonical.into()));
    let untouched = v1::Frame { mesh: vec![0x42, 0x8a], ..announced };
    assert_eq!(base.apply(&untouched, MAX_TRIANGLES), Ok(()));
}

#[test]
fn advancing_gives_the_mesh_and_the_payload_of_the_difference() {
    let (coarsest, [(_, _), (delta, first)]) = samples();
    let mut second = first.clone();
    second.apply(&delta, MAX_TRIANGLES).unwrap();
    let lost: Vec<Post> =
        first.posts().iter().map(|&(p, _)| p).filter(|&p| second.integer_height(p).is_none()).collect();
    let won: Vec<(Post, i32)> =
        second.posts().into_iter().filter(|&(p, _)| first.integer_height(p).is_none()).collect();
    assert!(!lost.is_empty() && !won.is_empty());
    let mut advanced = first.clone();
    assert_eq!(advanced.advance(&lost, &won, 2).unwrap(), delta.mesh);
    assert_eq!((advanced.posts(), advanced.hash()), (second.posts(), second.hash()));
    assert_eq!((advanced.triangle_count(), advanced.sequence()), (second.triangle_count(), 2));

    let mut refuses = |lost: &[Post], won: &[(Post, i32)], error| {
        assert_eq!(advanced.advance(lost, won, 3), Err(error));
        assert_eq!((advanced.posts(), advanced.sequence()), (second.posts(), 2));
    };
    let centre = Post::new(32, 32);
    let orphan = coarsest.root().children(centre).filter(|&p| second.integer_height(p).is_some()).min().unwrap();
    refuses(&[centre], &[], MeshError::Orphan(orphan));
    refuses(&[Post::new(0, 0)], &[], MeshError::Outside(Post::new(0, 0)));
    refuses(&[], &[(Post::new(65, 1), 0)], MeshError::Outside(Post::new(65, 1)));
    refuses(&[], &[(centre, i32::MIN)], MeshError::Twice(centre));
}

#[test]
fn a_frame_must_fit_the_replica_and_the_limit() {
    let (_, [(snapshot, coarsest), (delta, first)]) = samples();
    let mut fresh = coarsest.clone();
    assert!(matches!(fresh.apply(&delta, MAX_TRIANGLES), Err(ApplyError::Base { held: 0, base: 1, .. })));
    assert!(matches!(fresh.apply(&snapshot, snapshot.triangle_count - 1), Err(ApplyError::Decode(_))));
    fresh.apply(&snapshot, snapshot.triangle_count).unwrap();
    assert_eq!(fresh.hash(), first.hash());
    let lying = v1::Frame { base_sequence: 0, ..delta.clone() };
    assert!(matches!(fresh.apply(&lying, MAX_TRIANGLES), Err(ApplyError::Kind { .. })));
    let off_by_one = v1::Frame { triangle_count: delta.triangle_count + 1, ..delta.clone() };
    assert!(matches!(fresh.apply(&off_by_one, MAX_TRIANGLES), Err(ApplyError::Triangles { .. })));
    fresh.apply(&delta, MAX_TRIANGLES).unwrap();
}

#[test]
fn posts_that_are_no_mesh_are_refused() {
    let coarsest = Replica::new(&terrain(9, 9, vec![0; 4])).unwrap();
    let with = |posts: &[(u32, u32, i32)]| {
        coarsest.with_posts(posts.iter().map(|&(i, j, h)| (Post::new(i, j), h)), 1).map(|_| ())
    };
    assert_eq!(with(&[(4, 4, 1), (4, 0, 1)]), Ok(()));
    assert_eq!(with(&[(4, 0, 1)]), Err(MeshError::Orphan(Post::new(4, 0))));
    assert_eq!(with(&[(9, 4, 1)]), Err(MeshError::Outside(Post::new(9, 4))));
    assert_eq!(with(&[(8, 8, 1)]), Err(MeshError::Outside(Post::new(8, 8))));
    assert_eq!(with(&[(4, 4, 1), (4, 4, 2)]), Err(MeshError::Twice(Post::new(4, 4))));
}

#[test]
fn a_terrain_description_that_makes_no_sense_is_refused() {
    let good = terrain(5, 9, vec![0; 4]);
    assert!(Replica::new(&good).is_ok());
    let bad = [
        v1::TerrainDescription { nx: 1, ..good.clone() },
        v1::TerrainDescription { ny: u32::MAX, ..good.clone() },
        v1::TerrainDescription { root_exponent: 4, ..good.clone() },
        v1::TerrainDescription { corner_heights: vec![0; 3], ..good.clone() },
        v1::TerrainDescription { corner_heights: vec![1 << 31, 0, 0, 0], ..good.clone() },
        v1::TerrainDescription { metres_per_post_east: 0.0, ..good.clone() },
        v1::TerrainDescription { metres_per_height_unit: f64::NAN, ..good },
    ];
    for description in bad {
        Replica::new(&description).unwrap_err();
    }
}

#[test]
fn buffers_are_local_and_counter_clockwise() {
    let coarsest = Replica::new(&terrain(9, 9, vec![0; 4])).unwrap();
    let mesh = mesh_of(&coarsest, &[(3, 3, 7), (1, 6, 2)], 1);
    let buffers = mesh.buffers([30.0, 20.0, 1.0]);
    assert_eq!(buffers.vertices.len(), mesh.posts().len());
    assert_eq!(buffers.indices.len(), 3 * mesh.triangle_count() as usize);
    assert_eq!(buffers.vertices[0], [-30.0, -20.0, -1.0]);
    let mut area = 0.0;
    for t in buffers.indices.chunks(3) {
        let [p, q, r] = [0, 1, 2].map(|n| buffers.vertices[t[n] as usize]);
        let twice = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
        assert!(twice > 0.0);
        area += twice / 2.0;
    }
    assert_eq!(area, 8.0 * 30.0 * 8.0 * 20.0);
}
