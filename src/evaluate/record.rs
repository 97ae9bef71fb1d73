//! What a scene generator says of the frames it got: one line of text a frame, for a pipe between processes.
//!
//! ```text
//! frame lines 12 5 6 2999 41d2... 9f03... VVB.B 3,7 - 9   kind sequence pose epoch triangles hash digest verdicts names
//!                                                         short untold
//! mesh plain 3,4,120 8,4,-7                               the posts of a view's last mesh: i, j, height
//! refused 13 hash the frame announces ...                 a frame that could not be applied
//! tampered 3,9 ...                                        a sabotaged frame, and the lines that it should betray
//! done 300 81234                                          poses flown and bytes received
//! ```
//!
//! Verdict k is of line k + 1: `V`isible or `B`locked on the client's own mesh, `.` where it has no ends for the line.

use std::fmt;

use sightline_client::{
    judge::{Judgement, judge},
    scene::{SceneState, digest_of_lines},
};
use sightline_proto::{
    EYE_LINE_ID,
    diamond::Post,
    mesh::Mesh,
    v1,
    verdict::{MeshVerdict, verdict_on_mesh},
};
use thiserror::Error;

/// Longest line of text that a reader accepts, in bytes.
pub const MAX_RECORD_BYTES: usize = 4 << 20;
/// Most posts of a mesh that is told: each takes at most 35 bytes.
pub const MAX_MESH_POSTS: usize = MAX_RECORD_BYTES / 35 - 1;

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
    /// Lines whose verdict is right, but not what they ask beside it, as far as the client can tell.
    pub short: Vec<u64>,
    /// Lines whose verdict is right and of which the client cannot tell the rest.
    pub untold: Vec<u64>,
}

/// What a scene generator says.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Record {
    /// A frame applied.
    Frame(FrameRecord),
    /// The last mesh of a view.
    Mesh {
        /// Which view.
        kind: Kind,
        /// Its active posts but for the corners, with their heights.
        posts: Vec<(Post, i32)>,
    },
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
        let (mut short, mut untold) = (Vec::new(), Vec::new());
        for (&id, line) in told.lines() {
            let slot = usize::try_from(id).ok().and_then(|id| verdicts.get_mut(id.checked_sub(1)?));
            if let (Some(slot), Some([a, b])) = (slot, line.ends) {
                let found = verdict_on_mesh(meshed.replica(), a, b);
                *slot = Some(found);
                match judge(meshed.replica(), meshed.replica().scale_m(), line) {
                    Judgement::Fails if on_mesh(line.verdict) == Some(found) => short.push(id),
                    Judgement::Untold => untold.push(id),
                    Judgement::Holds | Judgement::Fails => {}
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
            short,
            untold,
        }
    }
}

impl FrameRecord {
    /// The verdict on a line.
    pub fn verdict(&self, id: u64) -> Option<MeshVerdict> {
        self.verdicts.get(usize::try_from(id).ok()?.checked_sub(1)?).copied().flatten()
    }
}

impl Record {
    /// The mesh that a view has; `None` of one with more than [`MAX_MESH_POSTS`].
    pub fn of_mesh(kind: Kind, meshed: &SceneState) -> Option<Self> {
        let root = meshed.replica().root();
        let posts: Vec<_> = meshed.replica().posts().into_iter().filter(|&(p, _)| !root.is_corner(p)).collect();
        (posts.len() <= MAX_MESH_POSTS).then_some(Self::Mesh { kind, posts })
    }
}

/// What a mesh must say of a line with this verdict on the terrain; `None` of one that is not compared.
pub(super) fn on_mesh(verdict: v1::Verdict) -> Option<MeshVerdict> {
    match verdict {
        v1::Verdict::Visible => Some(MeshVerdict::Visible),
        v1::Verdict::Blocked => Some(MeshVerdict::Blocked),
        v1::Verdict::Unknown | v1::Verdict::Unspecified => None,
    }
}

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Lines => "lines",
        Kind::Plain => "plain",
    }
}

fn parse_kind(text: &str) -> Option<Kind> {
    [Kind::Lines, Kind::Plain].into_iter().find(|&kind| kind_name(kind) == text)
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
                let kind = kind_name(frame.kind);
                let verdict = |v: &Option<MeshVerdict>| match v {
                    Some(MeshVerdict::Visible) => 'V',
                    Some(MeshVerdict::Blocked) => 'B',
                    None => '.',
                };
                let verdicts: String = frame.verdicts.iter().map(verdict).collect();
                let FrameRecord {
                    sequence, pose_sequence, epoch, triangles, hash, digest, named, short, untold, ..
                } = frame;
                let verdicts = if verdicts.is_empty() { "-" } else { &verdicts };
                write!(
                    f,
                    "frame {kind} {sequence} {pose_sequence} {epoch} {triangles} {hash:x} {digest:x} {verdicts} "
                )?;
                write!(f, "{} {} {}", list(named), list(short), list(untold))
            }
            Self::Mesh { kind, posts } => {
                write!(f, "mesh {}", kind_name(*kind))?;
                posts.iter().try_for_each(|(p, height)| write!(f, " {},{},{height}", p.i, p.j))
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
        "mesh" => {
            let mut parts = rest.split(' ');
            let kind = parse_kind(parts.next()?)?;
            Some(Record::Mesh { kind, posts: parts.map(parse_post).collect::<Option<_>>()? })
        }
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
    let [kind, sequence, pose, epoch, triangles, hash, digest, verdicts, named, short, untold] = parts[..] else {
        return None;
    };
    let kind = parse_kind(kind)?;
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
        short: parse_list(short)?,
        untold: parse_list(untold)?,
    })
}

fn parse_post(text: &str) -> Option<(Post, i32)> {
    let mut parts = text.splitn(3, ',');
    let (i, j) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    Some((Post::new(i, j), parts.next()?.parse().ok()?))
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
            short: vec![300],
            untold: vec![1, 2],
        };
        let empty = FrameRecord { kind: Kind::Lines, verdicts: Vec::new(), named: Vec::new(), ..frame.clone() };
        for record in [
            Record::Frame(frame),
            Record::Frame(empty),
            Record::Mesh { kind: Kind::Lines, posts: vec![(Post::new(3, 4), -7), (Post::new(0, 1 << 20), i32::MIN)] },
            Record::Mesh { kind: Kind::Plain, posts: Vec::new() },
            Record::Refused { sequence: 3, hash: true, detail: "the hash is another".into() },
            Record::Tampered { betrays: vec![4], detail: "post (1, 2) raised".into() },
            Record::Done { poses: 300, bytes: 1 << 40 },
        ] {
            assert_eq!(record.to_string().parse(), Ok(record));
        }
    }

    #[test]
    fn anything_else_is_refused() {
        for text in [
            "",
            "frame",
            "frame lines 1 2 3",
            "frame lines 1 1 1 2 0 0 VX - - -",
            "mesh x",
            "mesh lines 1,2",
            "done 3",
            "hello world",
        ] {
            assert!(text.parse::<Record>().is_err(), "{text}");
        }
    }
}
