//! What a server records of itself: every frame can be made anew from it, and damage is never taken for truth.

use std::{
    io::{self, Write},
    sync::Mutex,
};

use sightline::{
    database::envelope::{self, EnvelopeError},
    service::{Clock, Recording},
    session::{
        journal::{Entry, JournalError, JournalReader, MIN_JOURNAL_BYTES, RECORD_LIMIT, Record},
        replay::{Replay, ReplayError, Replayed},
    },
};

use super::{port::get, *};

/// A sink that tests can look into.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<u8>>>);

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A server that records, a session on it, and the bytes of the journal.
async fn recorded(limit_bytes: u64) -> Vec<u8> {
    let kept = Kept::default();
    let recording = Some(Recording { sink: Box::new(kept.clone()), limit_bytes });
    let clock = Clock::standing();
    let options = ServeOptions { recording, clock: clock.clone(), ..ServeOptions::default() };
    let running = Running::start_with(TestTerrain::new(None), options).await;
    let client = running.client().await;
    session(&client, &clock).await;
    let state = client.status().await.unwrap().recording.expect("a recording");
    assert_eq!(state.ended.contains("limit"), limit_bytes < 1 << 20, "{state:?}");
    assert!((1..=limit_bytes).contains(&state.bytes) && state.limit_bytes == limit_bytes, "{state:?}");
    let running_gauge = format!("sightline_recording {}\n", u32::from(state.ended.is_empty()));
    assert!(get(&running.address, "/metrics").await.1.contains(&running_gauge));
    running.stop.send(()).unwrap();
    running.done.await.unwrap().unwrap();
    let bytes = kept.0.lock().unwrap();
    bytes.clone()
}

/// Two views of an exercise and a plain one: entities move, lines come and go, some with their lease, a budget changes, a
/// snapshot is asked for.
async fn session(client: &Client, clock: &Clock) {
    exercise(client, "kept", 12).await;
    client.create_exercise("brief").await.unwrap();
    let mut views = [
        client.open_view("kept", settings(150), pose(300.0, 500.0)).await.unwrap(),
        client.open_view("kept", settings(900), pose(2_000.0, 900.0)).await.unwrap(),
        client.open_view("", settings(400), pose(900.0, 900.0)).await.unwrap(),
    ];
    client.delete_exercise("brief").await.unwrap();
    let mut pose_sequence = 0;
    let leased = v1::ChangeExerciseRequest {
        name: "kept".into(),
        put_entities: vec![entity(100, 10.0, 10.0)],
        put_sight_lines: vec![between(100, 100, 1)],
        lease: Some(v1::Lease { owner: "host".into(), term_s: 60 }),
        ..Default::default()
    };
    client.change_exercise(leased).await.unwrap();
    frame(&mut views[0]).await;
    clock.advance(Duration::from_secs(61));
    let gone = async {
        while client.exercise("kept").await.unwrap().sight_lines.len() > 12 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, gone).await.expect("the lease runs out");
    for step in 1..8_u32 {
        let x = f64::from(step);
        let remove_sight_lines = if step == 5 { vec![3, 4] } else { Vec::new() };
        let change = v1::ChangeExerciseRequest {
            name: "kept".into(),
            put_entities: vec![entity(0, 7.0 * x, 40.0), entity(9, 30.0, 5.0 * x)],
            remove_sight_lines,
            ..Default::default()
        };
        let epoch = client.change_exercise(change).await.unwrap();
        for (n, view) in views.iter_mut().enumerate() {
            if step == 3 {
                view.change_settings(settings(300)).await.unwrap();
                view.request_snapshot().await.unwrap();
            }
            pose_sequence = view.steer(pose(200.0 * x + 50.0 * n as f64, 100.0 * x)).await.unwrap();
            let mut last = frame(view).await;
            while last.pose_sequence != pose_sequence || (n < 2 && last.epoch != epoch) {
                last = frame(view).await;
            }
        }
    }
    assert_eq!(pose_sequence, 7);
}

/// What replaying finds, and why it ended before the end of the bytes.
fn replayed(bytes: &[u8], terrain: Arc<TestTerrain>) -> (Replayed, Option<JournalError>, Option<ReplayError>) {
    let (site, details) = (terrain.site(), terrain.details().unwrap());
    let mut replay = Replay::new(terrain, site, &details).unwrap();
    let mut reader = JournalReader::new(bytes);
    loop {
        match reader.next_entry() {
            Ok(Some(entry)) => {
                if let Err(error) = replay.take(entry) {
                    return (replay.found().clone(), None, Some(error));
                }
            }
            Ok(None) => return (replay.found().clone(), None, None),
            Err(error) => return (replay.found().clone(), Some(error), None),
        }
    }
}

/// Where each record of a sound journal begins, and its end.
fn borders(bytes: &[u8]) -> Vec<usize> {
    let mut reader = JournalReader::new(bytes);
    let mut borders = vec![0];
    while reader.next_entry().unwrap().is_some() {
        borders.push(reader.bytes() as usize);
    }
    borders
}

#[tokio::test]
async fn every_frame_is_made_anew_from_what_was_recorded() {
    let bytes = recorded(1 << 30).await;
    let (found, cut, error) = replayed(&bytes, TestTerrain::new(None));
    assert!(cut.is_none() && error.is_none(), "{cut:?} {error:?}");
    assert_eq!((found.different_frames, found.views), (0, 3), "{:?}", found.differences);
    assert!(found.frames >= 3 * 7 && found.has_ended && !found.is_full, "{found:?}");
    // Two made, one filled, one deleted, a lease given and run out, seven changes.
    assert_eq!(found.exercise_changes, 13);

    // It can fail: on another terrain of the same name other frames come out, and one byte of one frame is seen.
    let other = MemoryTerrain::new(synthetic::fractal(90, 70, 12, 1500).unwrap(), SCALE).unwrap();
    let other = TestTerrain { memory: other, ..Arc::into_inner(TestTerrain::new(None)).unwrap() };
    let (found, _, error) = replayed(&bytes, Arc::new(other));
    assert!(found.different_frames > 0 || error.is_some(), "{found:?}");
    let (found, ..) = replayed(&forged(&bytes), TestTerrain::new(None));
    assert_eq!(found.different_frames, 1);
    assert_eq!(found.differences[0].what, "the distortion bound");
    let named = TestTerrain::new(None);
    let mut replay = Replay::new(Arc::clone(&named), named.site(), &Details::default()).unwrap();
    let first = JournalReader::new(&bytes[..]).next_entry().unwrap().unwrap();
    assert!(matches!(replay.take(first), Err(ReplayError::Terrain { .. })));
}

/// The journal with another bound in one frame, and everything sealed anew.
fn forged(bytes: &[u8]) -> Vec<u8> {
    let (mut reader, mut out, mut number, mut is_forged) = (JournalReader::new(bytes), Vec::new(), 0, false);
    while let Some(mut entry) = reader.next_entry().unwrap() {
        if let (Entry::Made { said, .. }, false) = (&mut entry, is_forged) {
            let last = said.last_mut().unwrap();
            let mut message = <v1::StreamSceneResponse as prost::Message>::decode(&last[..]).unwrap();
            let Some(Word::Frame(frame)) = &mut message.response else { panic!("{message:?}") };
            frame.distortion_bound_px += 1.0;
            *last = prost::Message::encode_to_vec(&message);
            is_forged = true;
        }
        out.extend(envelope::seal(&Record { number, entry }).unwrap());
        number += 1;
    }
    out
}

#[tokio::test]
async fn what_a_killed_server_leaves_is_replayed_up_to_its_cut() {
    let bytes = recorded(1 << 30).await;
    let borders = borders(&bytes);
    let mut frames = Vec::new();
    for length in (0..bytes.len()).step_by(1 + bytes.len() / 40).chain(borders.iter().copied()) {
        let (found, cut, error) = replayed(&bytes[..length], TestTerrain::new(None));
        assert!(error.is_none() && found.different_frames == 0, "{length}: {error:?}");
        assert_eq!(found.has_ended, length == bytes.len());
        let is_border = borders.contains(&length);
        assert!(if is_border { cut.is_none() } else { matches!(cut, Some(JournalError::Cut { .. })) }, "{cut:?}");
        frames.push((length, found.frames));
    }
    frames.sort_unstable();
    assert!(frames.is_sorted_by_key(|(_, frames)| frames) && frames.last().unwrap().1 >= 21);
}

#[tokio::test]
async fn damage_is_named_and_never_taken_for_a_cut() {
    let bytes = recorded(1 << 30).await;
    let borders = borders(&bytes);
    // Every byte of a header in the middle, its length among them, and places all over.
    let middle = borders[borders.len() / 2];
    let last = borders[borders.len() - 2];
    for at in (middle..middle + 33).chain((0..last).step_by(1 + last / 150)) {
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (at % 8);
        let mut reader = JournalReader::new(&bad[..]);
        let error = loop {
            match reader.next_entry() {
                Ok(Some(_)) => {}
                Ok(None) => panic!("byte {at}: nothing was noticed"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error, JournalError::Damaged { .. }), "byte {at}: {error}");
        assert!(reader.bytes() as usize <= at, "byte {at}: {error}");
    }
    // A record that is missing, and one of another version.
    let without = [&bytes[..borders[3]], &bytes[borders[4]..]].concat();
    let (_, error, _) = replayed(&without, TestTerrain::new(None));
    assert!(matches!(error, Some(JournalError::Gap { number: 3, found: 4, .. })), "{error:?}");
    let mut later = bytes;
    later[8] = 2;
    let (_, error, _) = replayed(&later, TestTerrain::new(None));
    assert!(
        matches!(&error, Some(JournalError::Damaged { source: EnvelopeError::Version { found: 2, .. }, .. })),
        "{error:?}"
    );
}

#[tokio::test]
async fn a_recording_ends_at_its_limit_and_the_server_goes_on() {
    let limit = 2 * MIN_JOURNAL_BYTES;
    let bytes = recorded(limit).await;
    assert!(bytes.len() as u64 <= limit && bytes.len() < RECORD_LIMIT);
    let (found, cut, error) = replayed(&bytes, TestTerrain::new(None));
    assert!(cut.is_none() && error.is_none(), "{cut:?} {error:?}");
    assert!(found.has_ended && found.is_full && found.different_frames == 0, "{found:?}");
    assert!(found.frames > 0);
}
