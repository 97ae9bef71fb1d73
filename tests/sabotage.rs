//! The consistency test is itself tested: what is falsified between the bytes received and the replica must be counted.
//!
//! The scene is as tight as can be: a line that grazes a post (one height unit more blocks it), a line that only this
//! post blocks, and a line whose verdict turns from one epoch to the next. The falsified frames carry a correct count
//! and hash, so nothing but the comparison of verdicts can notice.

use std::collections::BTreeMap;

use sightline::evaluate::{
    consistency::{ClientTally, Comparison, Source},
    record::{FrameRecord, Kind},
    sabotage::{Sabotage, Saboteur},
    scenario::Truth,
};
use sightline_client::scene::{Event, SceneState, StatedLine, digest_of_lines};
use sightline_proto::{
    diamond::Post,
    v1::{self, stream_scene_response::Response},
};

const BUDGET: u32 = 100;

fn opened() -> v1::ViewOpened {
    let terrain = v1::TerrainDescription {
        nx: 9,
        ny: 9,
        root_exponent: 3,
        metres_per_post_east: 30.0,
        metres_per_post_north: 30.0,
        metres_per_height_unit: 1.0,
        corner_heights: vec![0; 4],
        ..Default::default()
    };
    v1::ViewOpened { terrain: Some(terrain) }
}

/// Lines across the post (4, 4), which is 10 units high on otherwise flat ground: 1 grazes it, 2 is blocked by it
/// alone, 3 passes above it from epoch 2 on.
fn lines(epoch: u64) -> BTreeMap<u64, StatedLine> {
    let line = |z: f64, verdict| StatedLine {
        ends: Some([[1.0, 4.0, z], [7.0, 4.0, z]]),
        verdict,
        fidelity: v1::Fidelity::Verdict,
        obstruction: None,
    };
    let third = if epoch < 2 { line(4.0, v1::Verdict::Blocked) } else { line(40.0, v1::Verdict::Visible) };
    BTreeMap::from([(1, line(10.0, v1::Verdict::Visible)), (2, line(5.0, v1::Verdict::Blocked)), (3, third)])
}

fn truth(epoch: u64) -> Truth {
    let lines = lines(epoch);
    let digest = digest_of_lines(lines.iter().map(|(&id, line)| (id, line)));
    Truth { lines, digest }
}

fn message(response: Response) -> v1::StreamSceneResponse {
    v1::StreamSceneResponse { response: Some(response) }
}

fn update(epoch: u64) -> v1::StreamSceneResponse {
    let position = |p: [f64; 3]| Some(v1::Position { x: p[0], y: p[1], z: p[2] });
    let state = |(id, line): (u64, StatedLine)| v1::SightLineState {
        id,
        resolved: line.ends.map(|[a, b]| v1::Segment { a: position(a), b: position(b) }),
        verdict: line.verdict.into(),
        fidelity: line.fidelity.into(),
        ..Default::default()
    };
    let changed = lines(epoch).into_iter().map(state).collect();
    message(Response::Exercise(v1::ExerciseUpdate { epoch, changed, removed: Vec::new() }))
}

/// What an honest server sends: a snapshot, then empty deltas, two frames an epoch.
fn honest_stream() -> Vec<v1::StreamSceneResponse> {
    let flat = SceneState::new(&opened(), BUDGET, true).unwrap();
    let mesh = flat.replica().with_posts([(Post::new(4, 4), 10)], 0).unwrap();
    let mut out = Vec::new();
    for sequence in 1..=6_u64 {
        let epoch = sequence.div_ceil(2);
        if sequence % 2 == 1 {
            out.push(update(epoch));
        }
        let base = (sequence > 1).then_some(&mesh);
        out.push(message(Response::Frame(v1::Frame {
            sequence,
            base_sequence: sequence - 1,
            epoch,
            mesh: mesh.encode(base),
            triangle_count: mesh.triangle_count(),
            mesh_hash: mesh.hash(),
            ..Default::default()
        })));
    }
    out
}

/// Feeds a client; gives what the comparison found and the lines that the sabotage meant to betray.
fn compare(sabotage: Option<Sabotage>) -> (ClientTally, Vec<u64>) {
    let mut client = SceneState::new(&opened(), BUDGET, true).unwrap();
    let mut saboteur = sabotage.map(|kind| Saboteur::new(kind, client.clone()));
    let mut comparison = Comparison::new([("victim".into(), BUDGET)], 3);
    let victim = Source { client: 0, server: 0, budget: BUDGET };
    let mut betrayed = Vec::new();
    for received in honest_stream() {
        let messages = match &mut saboteur {
            None => vec![received],
            Some(saboteur) => {
                let passed = saboteur.pass(received).unwrap();
                betrayed.extend(passed.tampered.into_iter().flat_map(|(ids, _)| ids));
                passed.messages
            }
        };
        for message in messages {
            if client.apply(&message).unwrap() == Event::Frame {
                let record = FrameRecord::of(Kind::Lines, &client, &client, 3);
                comparison.frame(victim, &record, &truth(client.last_frame().epoch));
            }
        }
    }
    (comparison.total(), betrayed)
}

#[test]
fn an_honest_stream_has_no_findings() {
    let (tally, _) = compare(None);
    assert_eq!((tally.frames, tally.comparisons, tally.findings()), (6, 18, 0));
}

#[test]
fn one_height_off_by_one_is_counted() {
    let (tally, betrayed) = compare(Some(Sabotage::Height));
    assert_eq!(betrayed, [1]);
    assert_eq!((tally.frames, tally.silent_disagreements, tally.findings()), (6, 1, 1));
}

#[test]
fn one_required_split_dropped_is_counted() {
    let (tally, betrayed) = compare(Some(Sabotage::Split));
    assert_eq!(betrayed, [2, 3]);
    assert_eq!((tally.frames, tally.silent_disagreements, tally.findings()), (6, 2, 2));
}

#[test]
fn one_stale_epoch_is_counted() {
    let (tally, betrayed) = compare(Some(Sabotage::Epoch));
    assert_eq!(betrayed, [3]);
    assert_eq!((tally.frames, tally.silent_disagreements, tally.exercise_mismatches, tally.findings()), (6, 1, 1, 2));
}
