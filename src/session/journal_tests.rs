//! The layout of recordings, held fast by one that is kept.

use super::journal::{Entry, JournalReader, Record};
use crate::{
    database::envelope,
    exercise::{Altitude, Anchor, Change, Disc, Entity, Frame, Place, SightLine},
    roam::Fidelity,
};

/// Two entities and three sight lines with something of everything.
fn things() -> (Vec<Entity>, Vec<SightLine>) {
    let place = |x, frame, altitude| Place { position: [x, -2.5, 1e-3], frame, altitude };
    let entities = vec![
        Entity { id: 7, place: place(1.0, Frame::Grid, Altitude::AboveGround), ground_m: Some(0.5) },
        Entity { id: u64::MAX, place: place(2.0, Frame::Geographic, Altitude::Absolute), ground_m: None },
    ];
    let ends = [Anchor::Entity { id: 7, offset_m: 2.0 }, Anchor::Point(place(3.0, Frame::Map, Altitude::Absolute))];
    let line = |id, fidelity| SightLine {
        id,
        a: ends[0],
        b: ends[1],
        fidelity,
        priority: 3,
        range_m: Some(9_000.0),
        region: Some(Disc { centre: [4.0, 5.0], frame: Frame::Scene, radius_m: 6.0 }),
    };
    let plain = SightLine { range_m: None, region: None, ..line(1, Fidelity::Verdict) };
    let asking = [Fidelity::Obstruction { distance_m: 12.5 }, Fidelity::Wedgie, Fidelity::Profile];
    (entities, [plain].into_iter().chain((2..).zip(asking).map(|(id, fidelity)| line(id, fidelity))).collect())
}

/// One entry of each kind.
fn entries() -> Vec<Entry> {
    let ((entities, sight_lines), name) = (things(), "golden".to_owned());
    let heard = vec![vec![1, 2, 3], Vec::new()];
    let change = Change {
        remove_entities: vec![1, 2],
        remove_sight_lines: vec![3],
        put_entities: entities.clone(),
        put_sight_lines: sight_lines.clone(),
        lease: None,
    };
    vec![
        Entry::Began { terrain: vec![0xab; 16], program: "0.1.0".into() },
        Entry::Restored { name: "kept".into(), epoch: 41, entities, sight_lines },
        Entry::Created { name: name.clone() },
        Entry::Changed { name: name.clone(), change },
        Entry::Deleted { name: name.clone() },
        Entry::Expired { name, entities: vec![7], sight_lines: vec![1, 2] },
        Entry::Opened { view: 0, open: vec![9; 5] },
        Entry::Heard { view: 0, heard: heard.clone() },
        Entry::Followed { view: 0, heard: heard.clone() },
        Entry::Made { view: 0, heard, said: vec![vec![4, 5]] },
        Entry::Closed { view: 0 },
        Entry::Ended { is_full: false },
    ]
}

/// A layout that changes in silence shows here: it needs another version, and this file stays.
#[test]
fn recordings_of_version_1_are_read_and_written_as_they_always_were() {
    let kept: &[u8] = include_bytes!("../../tests/golden/recording-v1.journal");
    let mut reader = JournalReader::new(kept);
    let mut found = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        found.push(entry);
    }
    assert_eq!((found, reader.bytes()), (entries(), kept.len() as u64));
    let written = (0..).zip(entries()).map(|(number, entry)| envelope::seal(&Record { number, entry }).unwrap());
    assert_eq!(written.collect::<Vec<_>>().concat(), kept);
}
