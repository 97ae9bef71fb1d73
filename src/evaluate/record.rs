//! What a scene generator says of the frames it got: one line of text a frame, for a pipe between processes.
//!
//! ```text
//! frame lines 12 5 6 2999 41d2... 9f03... VVB.B 3,7 -     kind sequence pose epoch triangles hash digest verdicts names
//!                                                         coarse
//! refused 13 hash the frame announces ...                 a frame that could not be applied
//! tampered 3,9 ...                                        a sabotaged frame, and the lines that it should betray
//! done 300 81234                                          poses flown and bytes received
//! ```
//!
//! Verdict k is of line k + 1: `V`isible or `B`locked on the client's own mesh, `.` where it has no ends for the line.

use std::{fmt, ops::ControlFlow};

use sightline_client::scene::{SceneState, digest_of_lines};
use sightline_proto::{
    EYE_LINE_ID, v1,
    verdict::{MeshVerdict, for_each_triangle_met, verdict_on_mesh},
};
use thiserror::Error;

/// Longest line of text that a reader accepts, in bytes.
pub const MAX_RECORD_BYTES: usize = 4 << 20;

/// Which of a client's two views a frame belongs to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// The view that honours the sight lines.
    Lines,
    /// The plain view from the same viewpoint, for contrast.
    Plain,
}

/// One frame as its client found it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FrameRecord {
    /// Which view.
    pub kind: Kind,
    /// The frame's number.
    pub sequence: u64,
    /// The pose that it was made for.
    pub pose_sequence: u64,
    /// The epoch whose ends the verdicts are for.
    pub epoch: u64,
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Hash of the mesh.
    pub hash: u64,
    /// Digest of the sight lines that the client holds.
    pub digest: u64,
    /// Verdict of line k + 1 on the client's own mesh.
    pub verdicts: Vec<Option<MeshVerdict>>,
    /// Lines of the exercise that the frame names as unsatisfied; the viewer's own eye is not among them.
    pub named: Vec<u64>,
    /// Lines of fidelity PROFILE, not UNKNOWN, that meet a triangle above the finest level.
    pub coarse: Vec<u64>,
}

/// What a scene generator says.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Record {
    /// A frame applied.
    Frame(FrameRecord),
    /// A frame that could not be applied.
    Refused {
        /// The frame's number.
        sequence: u64,
        /// Whether its hash was the reason.
        hash: bool,
        /// The reason in words.
        detail: String,
    },
    /// The instrument was sabotaged here, on purpose.
    Tampered {
        /// Lines whose verdict the change turns.
        betrays: Vec<u64>,
        /// What was done.
        detail: String,
    },
    /// The flight is over.
    Done {
        /// Poses flown.
        poses: u64,
        /// Bytes of messages received.
        bytes: u64,
    },
}

/// Why a line of text is no record.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
#[error("'{}' is not a record of a scene generator", .0.chars().take(80).collect::<String>())]
pub struct RecordError(pub String);

impl FrameRecord {
    /// The record of a view after a frame: `meshed` has the mesh, `told` the sight lines (of the same view, or for a
    /// plain view those of the view beside it).
    pub fn of(kind: Kind, meshed: &SceneState, told: &SceneState, lines: usize) -> Self {
        let mut verdicts = vec![None; lines];
        let mut coarse = Vec::new();
        for (&id, line) in told.lines() {
            let slot = usize::try_from(id).ok().and_then(|id| verdicts.get_mut(id.checked_sub(1)?));
            if let (Some(slot), Some([a, b])) = (slot, line.ends) {
                *slot = Some(verdict_on_mesh(meshed.replica(), a, b));
                let profile = line.fidelity == v1::Fidelity::Profile && line.verdict != v1::Verdict::Unknown;
                if profile && meets_coarse_triangle(meshed, a, b) {
                    coarse.push(id);
                }
            }
        }
        Self {
            kind,
            sequence: meshed.last_frame().sequence,
            pose_sequence: meshed.last_frame().pose_sequence,
            epoch: told.epoch(),
            triangles: meshed.replica().triangle_count(),
            hash: meshed.replica().hash(),
            digest: digest_of_lines(told.lines().iter().map(|(&id, line)| (id, line))),
            verdicts,
            named: meshed.unsatisfied().keys().copied().filter(|&id| id != EYE_LINE_ID).collect(),
            coarse,
        }
    }
}

fn meets_coarse_triangle(meshed: &SceneState, a: [f64; 3], b: [f64; 3]) -> bool {
    let met = for_each_triangle_met(meshed.replica(), a, b, |triangle| match triangle.base_midpoint() {
        Some(_) => ControlFlow::Break(()),
        None => ControlFlow::Continue(()),
    });
    met.is_break()
}

fn list(ids: &[u64]) -> String {
    if ids.is_empty() { "-".into() } else { ids.iter().map(u64::to_string).collect::<Vec<_>>().join(",") }
}

fn parse_list(text: &str) -> Option<Vec<u64>> {
    if text == "-" { Some(Vec::new()) } else { text.split(',').map(|id| id.parse().ok()).collect() }
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame(frame) => {
                let kind = if frame.kind == Kind::Lines { "lines" } else { "plain" };
                let verdict = |v: &Option<MeshVerdict>| match v {
                    Some(MeshVerdict::Visible) => 'V',
                    Some(MeshVerdict::Blocked) => 'B',
                    None => '.',
                };
                let verdicts: String = frame.verdicts.iter().map(verdict).collect();
                let FrameRecord { sequence, pose_sequence, epoch, triangles, hash, digest, named, coarse, .. } = frame;
                let verdicts = if verdicts.is_empty() { "-" } else { &verdicts };
                write!(
                    f,
                    "frame {kind} {sequence} {pose_sequence} {epoch} {triangles} {hash:x} {digest:x} {verdicts} "
                )?;
                write!(f, "{} {}", list(named), list(coarse))
            }
            Self::Refused { sequence, hash, detail } => {
                let why = if *hash { "hash" } else { "other" };
                write!(f, "refused {sequence} {why} {}", detail.replace('\n', " "))
            }
            Self::Tampered { betrays, detail } => write!(f, "tampered {} {}", list(betrays), detail.replace('\n', " ")),
            Self::Done { poses, bytes } => write!(f, "done {poses} {bytes}"),
        }
    }
}

impl std::str::FromStr for Record {
    type Err = RecordError;

    fn from_str(line: &str) -> Result<Self, RecordError> {
        parse(line).ok_or_else(|| RecordError(line.into()))
    }
}

fn parse(line: &str) -> Option<Record> {
    let (word, rest) = line.split_once(' ')?;
    match word {
        "frame" => parse_frame(rest).map(Record::Frame),
        "refused" => {
            let mut parts = rest.splitn(3, ' ');
            let sequence = parts.next()?.parse().ok()?;
            let hash = match parts.next()? {
                "hash" => true,
                "other" => false,
                _ => return None,
            };
            Some(Record::Refused { sequence, hash, detail: parts.next()?.into() })
        }
        "tampered" => {
            let (ids, detail) = rest.split_once(' ')?;
            Some(Record::Tampered { betrays: parse_list(ids)?, detail: detail.into() })
        }
        "done" => {
            let (poses, bytes) = rest.split_once(' ')?;
            Some(Record::Done { poses: poses.parse().ok()?, bytes: bytes.parse().ok()? })
        }
        _ => None,
    }
}

fn parse_frame(text: &str) -> Option<FrameRecord> {
    let parts: Vec<&str> = text.split(' ').collect();
    let [kind, sequence, pose, epoch, triangles, hash, digest, verdicts, named, coarse] = parts[..] else {
        return None;
    };
    let kind = match kind {
        "lines" => Kind::Lines,
        "plain" => Kind::Plain,
        _ => return None,
    };
    let verdict = |c| match c {
        'V' => Some(Some(MeshVerdict::Visible)),
        'B' => Some(Some(MeshVerdict::Blocked)),
        '.' => Some(None),
        _ => None,
    };
    let verdicts = if verdicts == "-" { "" } else { verdicts };
    Some(FrameRecord {
        kind,
        sequence: sequence.parse().ok()?,
        pose_sequence: pose.parse().ok()?,
        epoch: epoch.parse().ok()?,
        triangles: triangles.parse().ok()?,
        hash: u64::from_str_radix(hash, 16).ok()?,
        digest: u64::from_str_radix(digest, 16).ok()?,
        verdicts: verdicts.chars().map(verdict).collect::<Option<_>>()?,
        named: parse_list(named)?,
        coarse: parse_list(coarse)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_comes_out_of_the_pipe_as_it_went_in() {
        let frame = FrameRecord {
            kind: Kind::Plain,
            sequence: 12,
            pose_sequence: 5,
            epoch: 6,
            triangles: 2_999,
            hash: u64::MAX,
            digest: 3,
            verdicts: vec![Some(MeshVerdict::Visible), None, Some(MeshVerdict::Blocked)],
            named: vec![1, 300],
            coarse: vec![300],
        };
        let empty = FrameRecord { kind: Kind::Lines, verdicts: Vec::new(), named: Vec::new(), ..frame.clone() };
        for record in [
            Record::Frame(frame),
            Record::Frame(empty),
            Record::Refused { sequence: 3, hash: true, detail: "the hash is another".into() },
            Record::Tampered { betrays: vec![4], detail: "post (1, 2) raised".into() },
            Record::Done { poses: 300, bytes: 1 << 40 },
        ] {
            assert_eq!(record.to_string().parse(), Ok(record));
        }
    }

    #[test]
    fn anything_else_is_refused() {
        for text in ["", "frame", "frame lines 1 2 3", "frame lines 1 1 1 2 0 0 VX - -", "done 3", "hello world"] {
            assert!(text.parse::<Record>().is_err(), "{text}");
        }
    }
}
