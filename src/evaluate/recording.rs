//! Recorded sessions of a view: the bytes received, kept in an envelope, and what can be said of them later.
//!
//! A recording holds the messages of one scene stream as they came, the opening first. Replaying it takes nothing else
//! for the same replica, the same hashes and the same verdicts on it; a truth of its own tells whether the verdicts that
//! the server stated are those of the finest terrain.

use std::collections::BTreeMap;

use prost::Message;
use serde::{Deserialize, Serialize};
use sightline_client::scene::{Event, SceneError, SceneState};
use sightline_proto::v1::{self, stream_scene_response::Response};
use thiserror::Error;

use super::oracle::{Ends, Oracle, OracleError};
use crate::database::{
    envelope::{self, EnvelopeError, Sealed},
    version_digits,
};

/// Greatest size of a recording's value in bytes.
pub const RECORDING_LIMIT: usize = 1 << 30;
/// Bytes of messages at which a recorder stops by itself; overhead of the envelope included, below the limit.
pub const RECORDED_BYTES_LIMIT: usize = 256 << 20;
/// What a message costs beside its bytes.
const OVERHEAD_BYTES: usize = 16;

/// A recorded session.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Recording {
    /// Greatest triangle count that the view asked for.
    pub max_triangles: u32,
    /// Whether the view belongs to an exercise.
    pub lines_expected: bool,
    /// Whether the recorder stopped at its limit before the session ended.
    pub cut: bool,
    /// The messages of the scene stream, encoded, the opening first.
    pub messages: Vec<Vec<u8>>,
}

impl Sealed for Recording {
    const MAGIC: [u8; 8] = *b"SLrec\r\n\x1a";
    const VERSION: u32 = 1;

    fn check(&self) -> Result<(), String> {
        if self.messages.is_empty() { Err("a recording without the opening of its view".into()) } else { Ok(()) }
    }
}

/// Collects a recording.
#[derive(Debug)]
pub struct Recorder {
    recording: Recording,
    bytes: usize,
}

impl Recorder {
    /// A recorder of a view that has just been opened by these bytes.
    pub fn new(max_triangles: u32, lines_expected: bool, opening: Vec<u8>) -> Self {
        let bytes = opening.len();
        let recording = Recording { max_triangles, lines_expected, cut: false, messages: vec![opening] };
        Self { recording, bytes }
    }

    /// Keeps a message, unless the limit is reached: then this and all later ones are left out.
    pub fn push(&mut self, message: Vec<u8>) {
        self.bytes += message.len() + OVERHEAD_BYTES;
        self.recording.cut |= self.bytes > RECORDED_BYTES_LIMIT;
        if !self.recording.cut {
            self.recording.messages.push(message);
        }
    }

    /// The recording.
    pub fn finish(self) -> Recording {
        self.recording
    }
}

/// What replaying a recording found.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Replayed {
    /// Frames applied, their counts and hashes checked.
    pub frames: u64,
    /// Epochs of sight lines.
    pub epochs: u64,
    /// Verdicts on the replica compared with the stated ones.
    pub comparisons: u64,
    /// Verdicts that differ without being named.
    pub silent_disagreements: u64,
    /// Lines whose stated verdict was compared with the truth, each time that they moved.
    pub judged: u64,
    /// Stated verdicts that are not the truth.
    pub wrong_verdicts: u64,
    /// Hash of the last mesh.
    pub last_hash: u64,
}

/// Why a recording cannot be replayed.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum ReplayError {
    /// The envelope.
    #[error(transparent)]
    Envelope(#[from] EnvelopeError),
    /// Bytes that are no message.
    #[error("message {message} of the recording is none: {detail}")]
    Message {
        /// Which, from 0.
        message: usize,
        /// The decoder's words.
        detail: String,
    },
    /// A message that does not fit those before it.
    #[error("message {message} of the recording does not fit those before it: {source}")]
    Scene {
        /// Which, from 0.
        message: usize,
        /// What does not fit.
        source: SceneError,
    },
    /// The first message does not open a view.
    #[error("the recording does not begin with the opening of a view")]
    Opening,
    /// Another terrain than the one that it was recorded on.
    #[error("it was recorded on terrain {recorded}, this is {found}")]
    Terrain {
        /// The terrain version, as hexadecimal digits.
        recorded: String,
        /// That of the terrain given.
        found: String,
    },
    /// The truth cannot be had.
    #[error(transparent)]
    Oracle(#[from] OracleError),
}

/// The bytes of a file that holds the recording.
pub fn seal(recording: &Recording) -> Result<Vec<u8>, EnvelopeError> {
    envelope::seal(recording)
}

/// The recording in the bytes of a file.
pub fn open(bytes: &[u8]) -> Result<Recording, EnvelopeError> {
    envelope::open::<Recording, RECORDING_LIMIT>(bytes)
}

/// Plays a recording through a fresh replica, checking each frame as a client does, and the server's verdicts by `truth`,
/// on the terrain of this version. `passed` is told how many messages have been.
pub fn replay(
    recording: &Recording,
    version: &[u8],
    truth: &mut impl Oracle,
    passed: &mut dyn FnMut(usize),
) -> Result<Replayed, ReplayError> {
    let decode = |n: usize| {
        v1::StreamSceneResponse::decode(&recording.messages[n][..])
            .map_err(|e| ReplayError::Message { message: n, detail: e.to_string() })
    };
    if recording.messages.is_empty() {
        return Err(ReplayError::Opening);
    }
    let Some(Response::Opened(opened)) = decode(0)?.response else { return Err(ReplayError::Opening) };
    let recorded = opened.terrain.as_ref().map_or(&[][..], |terrain| &terrain.version);
    if recorded != version {
        let [recorded, found] = [recorded, version].map(version_digits);
        return Err(ReplayError::Terrain { recorded, found });
    }
    let fits = |message| move |source| ReplayError::Scene { message, source };
    let mut scene = SceneState::new(&opened, recording.max_triangles, recording.lines_expected).map_err(fits(0))?;
    let mut found = Replayed::default();
    let mut judged = BTreeMap::new();
    for n in 1..recording.messages.len() {
        match scene.apply(&decode(n)?).map_err(fits(n))? {
            Event::Exercise => {
                found.epochs += 1;
                judge(&scene, truth, &mut judged, &mut found)?;
            }
            Event::Frame => {
                found.frames += 1;
                let stated = scene.lines().values();
                let known = |line: &&_| known_verdict(line);
                found.comparisons += stated.filter(known).count() as u64;
                found.silent_disagreements += scene.silent_disagreements().len() as u64;
            }
        }
        passed(n + 1);
    }
    found.last_hash = scene.replica().hash();
    Ok(found)
}

/// Asks the truth of each line that is new or has moved. `judged` keeps the ends and verdicts that were looked at.
fn judge(
    scene: &SceneState,
    truth: &mut impl Oracle,
    judged: &mut BTreeMap<u64, (Ends, v1::Verdict)>,
    found: &mut Replayed,
) -> Result<(), ReplayError> {
    judged.retain(|id, _| scene.lines().contains_key(id));
    for (&id, line) in scene.lines() {
        let Some(ends) = line.ends else { continue };
        if judged.insert(id, (ends, line.verdict)) != Some((ends, line.verdict)) {
            found.judged += 1;
            found.wrong_verdicts += u64::from(truth.verdict(ends)? != line.verdict);
        }
    }
    Ok(())
}

fn known_verdict(line: &sightline_client::scene::StatedLine) -> bool {
    matches!(line.verdict, v1::Verdict::Visible | v1::Verdict::Blocked)
}

#[cfg(test)]
mod tests {
    use super::{super::oracle::FieldOracle, *};
    use crate::terrain::MemoryField;
    use sightline_proto::diamond::Post;

    /// Over flat ground with one post of such a height in its middle.
    fn replayed(recording: &Recording, middle: f64) -> Result<Replayed, ReplayError> {
        let height = |i, j| Some(if (i, j) == (2, 2) { middle } else { 0.0 });
        let field = MemoryField::from_fn(5, 5, height).unwrap();
        replay(recording, &[7], &mut FieldOracle(&field), &mut |_| {})
    }

    fn recording() -> Recording {
        let terrain = v1::TerrainDescription {
            nx: 5,
            ny: 5,
            root_exponent: 2,
            metres_per_post_east: 1.0,
            metres_per_post_north: 1.0,
            metres_per_height_unit: 1.0,
            corner_heights: vec![0; 4],
            version: vec![7],
            ..Default::default()
        };
        let opened = v1::ViewOpened { terrain: Some(terrain) };
        let scene = SceneState::new(&opened, 100, true).unwrap();
        let mesh = scene.replica().with_posts([(Post::new(2, 2), 7)], 1).unwrap();
        let position = |x| Some(v1::Position { x, y: 2.0, z: 5.0 });
        let line = v1::SightLineState {
            id: 3,
            resolved: Some(v1::Segment { a: position(0.0), b: position(4.0) }),
            verdict: v1::Verdict::Blocked.into(),
            ..Default::default()
        };
        let update = v1::ExerciseUpdate { epoch: 1, changed: vec![line], removed: Vec::new() };
        let frame = v1::Frame {
            sequence: 1,
            epoch: 1,
            mesh: mesh.encode(None),
            triangle_count: mesh.triangle_count(),
            mesh_hash: mesh.hash(),
            ..Default::default()
        };
        let bytes = |r| v1::StreamSceneResponse { response: Some(r) }.encode_to_vec();
        let mut recorder = Recorder::new(100, true, bytes(Response::Opened(opened)));
        recorder.push(bytes(Response::Exercise(update)));
        recorder.push(bytes(Response::Frame(frame)));
        recorder.finish()
    }

    #[test]
    fn a_recording_replays_from_its_file() {
        let kept = recording();
        let opened = open(&seal(&kept).unwrap()).unwrap();
        assert_eq!(opened, kept);
        let found = replayed(&opened, 7.0).unwrap();
        assert_eq!((found.frames, found.epochs, found.comparisons, found.silent_disagreements), (1, 1, 1, 0));
        assert_eq!((found.judged, found.wrong_verdicts), (1, 0));
        let elsewhere = replayed(&opened, 4.0).unwrap();
        assert_eq!(
            (elsewhere.judged, elsewhere.wrong_verdicts),
            (1, 1),
            "the server's verdict is not taken for the truth"
        );
        let field = MemoryField::from_fn(5, 5, |_, _| Some(0.0)).unwrap();
        let other = replay(&opened, &[8], &mut FieldOracle(&field), &mut |_| {}).unwrap_err();
        assert_eq!(other.to_string(), "it was recorded on terrain 07, this is 08");
    }

    #[test]
    fn damage_inside_a_sealed_recording_is_an_error_that_names_the_message() {
        let mut cut = recording();
        cut.messages[2].truncate(5);
        assert!(matches!(replayed(&cut, 7.0), Err(ReplayError::Message { message: 2, .. })));
        let mut swapped = recording();
        swapped.messages.swap(1, 2);
        assert!(matches!(replayed(&swapped, 7.0), Err(ReplayError::Scene { message: 1, .. })));
        let mut headless = recording();
        headless.messages.remove(0);
        assert_eq!(replayed(&headless, 7.0), Err(ReplayError::Opening));
        assert_eq!(replayed(&Recording::default(), 7.0), Err(ReplayError::Opening));
        assert!(open(&seal(&Recording::default()).unwrap()).is_err());
    }

    #[test]
    fn a_recorder_stops_at_its_limit_and_says_so() {
        let mut recorder = Recorder::new(2, false, vec![0]);
        recorder.push(vec![0; RECORDED_BYTES_LIMIT]);
        recorder.push(vec![1]);
        let recording = recorder.finish();
        assert!(recording.cut);
        assert_eq!(recording.messages.len(), 1);
    }
}
