//! What a scene generator knows from the bytes of one view: the mesh, the sight lines and their verdicts.
//!
//! [`SceneState`] takes the messages of a scene stream in order and nothing else, so that a recorded stream replays to
//! the same state. It checks what it is told: the hash and the count of each frame, that lines are named against the
//! frame before, that the sight lines of an epoch come before its first frame.

use std::collections::{BTreeMap, BTreeSet};

use sightline_proto::{
    EYE_LINE_ID,
    replica::{ApplyError, PostChanges, Replica, TerrainError},
    v1,
    verdict::{MeshVerdict, verdict_on_mesh},
};
use thiserror::Error;

use crate::judge::{Judgement, judge};

/// A sight line as the stream states it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StatedLine {
    /// Its ends in the grid frame; `None` when an end has no ground below it.
    pub ends: Option<[[f64; 3]; 2]>,
    /// The server's exact verdict.
    pub verdict: v1::Verdict,
    /// What the line asks of each mesh.
    pub fidelity: v1::Fidelity,
    /// Of a blocked line of fidelity OBSTRUCTION that passes no unknown point before: where it is obstructed.
    pub obstruction: Option<StatedObstruction>,
}

/// The first obstruction of a line on the finest terrain, seen from A.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StatedObstruction {
    /// Where, as a part of AB; rounded.
    pub first: f64,
    /// How far from it the first obstruction on a mesh may be, in metres along AB.
    pub distance_m: f64,
}

/// Why a message cannot be right. The state is as before it.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SceneError {
    /// A terrain that no replica can stand on.
    #[error(transparent)]
    Terrain(#[from] TerrainError),
    /// A frame that cannot be applied.
    #[error(transparent)]
    Frame(#[from] ApplyError),
    /// A second answer to the opening, or an empty message.
    #[error("a message that has no place in an open stream")]
    OutOfPlace,
    /// A frame before the sight lines of its epoch.
    #[error("frame {sequence} belongs to epoch {epoch}, but the last update of the sight lines is of epoch {held}")]
    Epoch {
        /// The frame's number.
        sequence: u64,
        /// Its epoch.
        epoch: u64,
        /// The epoch held.
        held: u64,
    },
    /// An update for an epoch that is past.
    #[error("an update for epoch {epoch} after epoch {held}")]
    EpochBack {
        /// Of the update.
        epoch: u64,
        /// The epoch held.
        held: u64,
    },
    /// A line that is no longer unsatisfied and never was, or is not known.
    #[error("frame {sequence} names sight line {id}, which {what}")]
    Naming {
        /// The frame's number.
        sequence: u64,
        /// The line.
        id: u64,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A line whose state makes no sense: a verdict without ends, a number that is not finite.
    #[error("sight line {0} is stated without a verdict, or with ends or an obstruction that are not finite")]
    Line(u64),
    /// A view that is opened anew, on another terrain.
    #[error("the server now holds another terrain: open a new view")]
    OtherTerrain,
    /// More sight lines than a client keeps.
    #[error("more than {MAX_LINES} sight lines")]
    TooManyLines,
}

/// Greatest number of sight lines that a client keeps of one view.
pub const MAX_LINES: usize = 1 << 20;

/// What a message brought.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Event {
    /// The sight lines of an epoch.
    Exercise,
    /// A mesh.
    Frame,
}

/// One view as its client knows it.
#[derive(Clone, Debug)]
pub struct SceneState {
    terrain: v1::TerrainDescription,
    replica: Replica,
    max_triangles: u32,
    /// Whether frames must follow the updates of their epochs: not for a view without sight lines.
    lines_expected: bool,
    epoch: u64,
    lines: BTreeMap<u64, StatedLine>,
    unsatisfied: BTreeMap<u64, v1::UnsatisfiedLine>,
    off_ground: BTreeSet<u64>,
    last: LastFrame,
    changes: PostChanges,
}

/// What the last frame said beside its mesh.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct LastFrame {
    /// Its number on its stream; 0 before the first.
    pub sequence: u64,
    /// How many frames have been applied, over all streams of a view that was resumed.
    pub applied: u64,
    /// The pose that it was made for.
    pub pose_sequence: u64,
    /// The epoch whose sight lines it honours.
    pub epoch: u64,
    /// No point in the picture is drawn further off than this, in pixels.
    pub bound_px: f64,
    /// Bytes of the mesh payload.
    pub payload_bytes: usize,
}

impl SceneState {
    /// A view that has just been opened. Frames of more than `max_triangles` are refused. `lines_expected` is false
    /// for a view without an exercise or without a subscription: then frames come without updates.
    pub fn new(opened: &v1::ViewOpened, max_triangles: u32, lines_expected: bool) -> Result<Self, SceneError> {
        let terrain = opened.terrain.clone().unwrap_or_default();
        Ok(Self {
            replica: Replica::new(&terrain)?,
            terrain,
            max_triangles,
            lines_expected,
            epoch: 0,
            lines: BTreeMap::new(),
            unsatisfied: BTreeMap::new(),
            off_ground: BTreeSet::new(),
            last: LastFrame::default(),
            changes: PostChanges::default(),
        })
    }

    /// Takes the next message of the stream, or changes nothing.
    pub fn apply(&mut self, message: &v1::StreamSceneResponse) -> Result<Event, SceneError> {
        use v1::stream_scene_response::Response;
        match &message.response {
            Some(Response::Exercise(update)) => self.update_lines(update).map(|()| Event::Exercise),
            Some(Response::Frame(frame)) => self.apply_frame(frame).map(|()| Event::Frame),
            Some(Response::Opened(_)) | None => Err(SceneError::OutOfPlace),
        }
    }

    /// The same view, opened anew after its stream was lost. The mesh stays until the first frame, which is a snapshot; sight
    /// lines and names come again before it.
    pub fn reopen(&mut self, opened: &v1::ViewOpened, max_triangles: u32) -> Result<(), SceneError> {
        let mut anew = Self::new(opened, max_triangles, self.lines_expected)?;
        if anew.terrain != self.terrain {
            return Err(SceneError::OtherTerrain);
        }
        std::mem::swap(&mut anew.replica, &mut self.replica);
        anew.replica.begin_anew();
        anew.last.applied = self.last.applied;
        *self = anew;
        Ok(())
    }

    fn update_lines(&mut self, update: &v1::ExerciseUpdate) -> Result<(), SceneError> {
        if update.epoch < self.epoch {
            return Err(SceneError::EpochBack { epoch: update.epoch, held: self.epoch });
        }
        if self.lines.len() + update.changed.len() > MAX_LINES {
            return Err(SceneError::TooManyLines);
        }
        let changed: Vec<_> = update.changed.iter().map(stated).collect::<Result<_, _>>()?;
        for id in &update.removed {
            self.lines.remove(id);
        }
        self.lines.extend(changed);
        self.epoch = update.epoch;
        Ok(())
    }

    fn apply_frame(&mut self, frame: &v1::Frame) -> Result<(), SceneError> {
        if self.lines_expected && frame.epoch != self.epoch {
            let (sequence, epoch, held) = (frame.sequence, frame.epoch, self.epoch);
            return Err(SceneError::Epoch { sequence, epoch, held });
        }
        let unsatisfied = self.renamed(frame)?;
        self.changes = self.replica.apply_noting(frame, self.max_triangles)?;
        self.unsatisfied = unsatisfied;
        if frame.base_sequence == 0 {
            self.off_ground.clear();
        }
        for id in &frame.no_longer_off_ground {
            self.off_ground.remove(id);
        }
        self.off_ground.extend(&frame.now_off_ground);
        self.last = LastFrame {
            sequence: frame.sequence,
            applied: self.last.applied + 1,
            pose_sequence: frame.pose_sequence,
            epoch: frame.epoch,
            bound_px: frame.distortion_bound_px,
            payload_bytes: frame.mesh.len(),
        };
        Ok(())
    }

    /// The unsatisfied lines after a frame.
    fn renamed(&self, frame: &v1::Frame) -> Result<BTreeMap<u64, v1::UnsatisfiedLine>, SceneError> {
        let error = |id, what| Err(SceneError::Naming { sequence: frame.sequence, id, what });
        let mut names = if frame.base_sequence == 0 { BTreeMap::new() } else { self.unsatisfied.clone() };
        for &id in &frame.no_longer_unsatisfied {
            if names.remove(&id).is_none() {
                return error(id, "was not named before");
            }
        }
        for line in &frame.now_unsatisfied {
            if line.id != EYE_LINE_ID && !self.lines.contains_key(&line.id) {
                return error(line.id, "is not known");
            }
            names.insert(line.id, *line);
        }
        Ok(names)
    }

    /// Allows frames of up to `max_triangles`, and still those that were allowed before: some may be under way.
    pub fn allow_triangles(&mut self, max_triangles: u32) {
        self.max_triangles = self.max_triangles.max(max_triangles);
    }

    /// The terrain.
    pub fn terrain(&self) -> &v1::TerrainDescription {
        &self.terrain
    }

    /// The mesh of the last frame.
    pub fn replica(&self) -> &Replica {
        &self.replica
    }

    /// What the last frame said beside its mesh.
    pub fn last_frame(&self) -> LastFrame {
        self.last
    }

    /// The posts that the last frame brought and took, against the mesh held before it.
    pub fn last_changes(&self) -> &PostChanges {
        &self.changes
    }

    /// The epoch of the sight lines held.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// The sight lines by id.
    pub fn lines(&self) -> &BTreeMap<u64, StatedLine> {
        &self.lines
    }

    /// The lines that the last frame names as unsatisfied, by id, with the reason and the triangles that they asked for;
    /// [`EYE_LINE_ID`] stands for the viewer's eye.
    pub fn unsatisfied(&self) -> &BTreeMap<u64, v1::UnsatisfiedLine> {
        &self.unsatisfied
    }

    /// The entities from whose ground the last frame's mesh is further off than they ask.
    pub fn off_ground(&self) -> &BTreeSet<u64> {
        &self.off_ground
    }

    /// The verdict of every line with ends on this view's own mesh, by id.
    pub fn verdicts(&self) -> impl Iterator<Item = (u64, MeshVerdict)> {
        self.lines
            .iter()
            .filter_map(|(&id, line)| Some((id, verdict_on_mesh(&self.replica, line.ends?[0], line.ends?[1]))))
    }

    /// What every line asks, as far as it can be told on this view's own mesh, by id ([`judge`]).
    pub fn judgements(&self) -> impl Iterator<Item = (u64, Judgement)> {
        let metres = self.replica.scale_m();
        self.lines.iter().map(move |(&id, line)| (id, judge(&self.replica, metres, line)))
    }

    /// The lines whose verdict on this mesh differs from the one stated, in silence: not named, not UNKNOWN.
    pub fn silent_disagreements(&self) -> Vec<u64> {
        let differs = |(id, found): &(u64, MeshVerdict)| {
            let wanted = match self.lines[id].verdict {
                v1::Verdict::Visible => MeshVerdict::Visible,
                v1::Verdict::Blocked => MeshVerdict::Blocked,
                v1::Verdict::Unknown | v1::Verdict::Unspecified => return false,
            };
            wanted != *found && !self.unsatisfied.contains_key(id)
        };
        self.verdicts().filter(differs).map(|(id, _)| id).collect()
    }
}

fn stated(state: &v1::SightLineState) -> Result<(u64, StatedLine), SceneError> {
    let point = |p: &v1::Position| [p.x, p.y, p.z];
    let ends = match &state.resolved {
        Some(v1::Segment { a: Some(a), b: Some(b) }) => Some([point(a), point(b)]),
        _ => None,
    };
    let verdict = state.verdict();
    let finite = ends.is_none_or(|e| e.iter().flatten().all(|c| c.is_finite()));
    let told = match verdict {
        v1::Verdict::Visible | v1::Verdict::Blocked => ends.is_some(),
        v1::Verdict::Unknown => true,
        v1::Verdict::Unspecified => false,
    };
    let obstruction =
        state.first_obstruction.map(|first| StatedObstruction { first, distance_m: state.obstruction_distance_m });
    let finite = finite && obstruction.is_none_or(|o| o.first.is_finite() && o.distance_m.is_finite());
    if !finite || !told {
        return Err(SceneError::Line(state.id));
    }
    let fidelity = match state.fidelity() {
        v1::Fidelity::Unspecified => v1::Fidelity::Verdict,
        given => given,
    };
    Ok((state.id, StatedLine { ends, verdict, fidelity, obstruction }))
}

/// A digest of sight lines: ids, bits of the ends, verdicts, fidelities, obstructions. Two sides with the same digest hold the same
/// lines. `lines` come in the order of their ids.
pub fn digest_of_lines<'a>(lines: impl IntoIterator<Item = (u64, &'a StatedLine)>) -> u64 {
    let mut hash = 0_u64;
    let mut add = |n: u64| {
        // FNV-1a over 64-bit words, with a shift to bring high bits down.
        hash = (hash ^ n).wrapping_mul(0x0000_0100_0000_01b3);
        hash ^= hash >> 29;
    };
    for (id, line) in lines {
        add(id);
        add(line.verdict as u64 | (line.fidelity as u64) << 8 | u64::from(line.ends.is_some()) << 16);
        for c in line.ends.iter().flatten().flatten() {
            add(c.to_bits());
        }
        if let Some(obstruction) = line.obstruction {
            add(obstruction.first.to_bits());
            add(obstruction.distance_m.to_bits());
        }
    }
    hash
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use sightline_proto::diamond::Post;
    use v1::stream_scene_response::Response;

    /// A flat grid of 9 x 9 posts, 10 m apart.
    pub(crate) fn flat() -> v1::TerrainDescription {
        v1::TerrainDescription {
            nx: 9,
            ny: 9,
            root_exponent: 3,
            metres_per_post_east: 10.0,
            metres_per_post_north: 10.0,
            metres_per_height_unit: 1.0,
            corner_heights: vec![0; 4],
            ..Default::default()
        }
    }

    fn opened() -> v1::ViewOpened {
        v1::ViewOpened { terrain: Some(flat()) }
    }

    fn message(response: Response) -> v1::StreamSceneResponse {
        v1::StreamSceneResponse { response: Some(response) }
    }

    /// The frame that replaces whatever is held by the centre post at a height.
    fn frame(state: &SceneState, sequence: u64, epoch: u64, centre: i32) -> v1::Frame {
        let mesh = state.replica().with_posts([(Post::new(4, 4), centre)], sequence).unwrap();
        v1::Frame {
            sequence,
            epoch,
            mesh: mesh.encode(None),
            triangle_count: mesh.triangle_count(),
            mesh_hash: mesh.hash(),
            ..Default::default()
        }
    }

    fn line(id: u64, z: f64, verdict: v1::Verdict) -> v1::SightLineState {
        let end = |x| Some(v1::Position { x, y: 4.0, z });
        let resolved = Some(v1::Segment { a: end(1.0), b: end(7.0) });
        v1::SightLineState { id, resolved, verdict: verdict.into(), ..Default::default() }
    }

    fn update(epoch: u64, changed: Vec<v1::SightLineState>) -> v1::StreamSceneResponse {
        message(Response::Exercise(v1::ExerciseUpdate { epoch, changed, removed: Vec::new() }))
    }

    #[test]
    fn a_view_checks_its_own_mesh_against_the_stated_verdicts() {
        let mut state = SceneState::new(&opened(), 100, true).unwrap();
        state.apply(&update(1, vec![line(7, 5.0, v1::Verdict::Blocked), line(9, 50.0, v1::Verdict::Visible)])).unwrap();
        state.apply(&message(Response::Frame(frame(&state, 1, 1, 10)))).unwrap();
        assert_eq!(state.verdicts().collect::<Vec<_>>(), [(7, MeshVerdict::Blocked), (9, MeshVerdict::Visible)]);
        assert!(state.silent_disagreements().is_empty());
        // A centre too low opens line 7; naming it ends the silence.
        let mut low = frame(&state, 2, 1, 4);
        state.apply(&message(Response::Frame(low.clone()))).unwrap();
        assert_eq!(state.silent_disagreements(), [7]);
        low.sequence = 3;
        low.now_unsatisfied =
            vec![v1::UnsatisfiedLine { id: 7, reason: v1::UnsatisfiedReason::Budget.into(), lacking_triangles: 4 }];
        state.apply(&message(Response::Frame(low))).unwrap();
        assert!(state.silent_disagreements().is_empty());
        let named: Vec<_> = state.unsatisfied().values().map(|line| (line.id, line.lacking_triangles)).collect();
        assert_eq!(named, [(7, 4)]);
    }

    #[test]
    fn what_cannot_be_right_changes_nothing() {
        let mut state = SceneState::new(&opened(), 100, true).unwrap();
        state.apply(&update(2, vec![line(7, 5.0, v1::Verdict::Blocked)])).unwrap();
        let good = frame(&state, 1, 2, 10);
        let early = v1::Frame { epoch: 3, ..good.clone() };
        let unknown = v1::UnsatisfiedLine { id: 8, reason: 1, lacking_triangles: 0 };
        let stranger = v1::Frame { now_unsatisfied: vec![unknown], ..good.clone() };
        let never = v1::Frame { no_longer_unsatisfied: vec![7], ..good.clone() };
        let tampered = v1::Frame { mesh_hash: good.mesh_hash ^ 1, ..good.clone() };
        for bad in [early, stranger, never, tampered] {
            assert!(state.apply(&message(Response::Frame(bad))).is_err());
            assert_eq!((state.last_frame(), state.unsatisfied().len()), (LastFrame::default(), 0));
        }
        let nan = v1::SightLineState { id: 1, ..line(1, f64::NAN, v1::Verdict::Visible) };
        assert_eq!(state.apply(&update(3, vec![nan])), Err(SceneError::Line(1)));
        assert_eq!(state.apply(&update(1, vec![])), Err(SceneError::EpochBack { epoch: 1, held: 2 }));
        assert_eq!(state.apply(&message(Response::Opened(opened()))), Err(SceneError::OutOfPlace));
        assert_eq!((state.epoch(), state.lines().len()), (2, 1));
        state.apply(&message(Response::Frame(good))).unwrap();
    }

    #[test]
    fn a_view_opened_anew_keeps_its_mesh_until_a_snapshot() {
        let mut state = SceneState::new(&opened(), 100, true).unwrap();
        state.apply(&update(5, vec![line(7, 5.0, v1::Verdict::Blocked)])).unwrap();
        state.apply(&message(Response::Frame(frame(&state, 1, 5, 10)))).unwrap();
        let held = state.replica().hash();
        let hill = v1::TerrainDescription { version: vec![1], ..flat() };
        let other = state.reopen(&v1::ViewOpened { terrain: Some(hill) }, 100);
        assert_eq!((other, state.epoch()), (Err(SceneError::OtherTerrain), 5));

        state.reopen(&opened(), 100).unwrap();
        assert_eq!((state.replica().hash(), state.epoch(), state.lines().len()), (held, 0, 0));
        // The server has started anew, and with it its epochs and sequences.
        state.apply(&update(1, vec![line(7, 5.0, v1::Verdict::Blocked)])).unwrap();
        let next = frame(&state, 1, 1, 10);
        let unchanged = state.replica().encode(Some(state.replica()));
        let stale = v1::Frame { sequence: 2, base_sequence: 1, mesh: unchanged, ..next.clone() };
        assert!(state.apply(&message(Response::Frame(stale))).is_err(), "a change of a frame of the stream before");
        state.apply(&message(Response::Frame(next))).unwrap();
        let last = state.last_frame();
        assert_eq!((last.sequence, last.applied), (1, 2));
        assert_eq!(*state.last_changes(), PostChanges::default(), "the snapshot is the mesh that was held");
    }

    #[test]
    fn the_digest_feels_one_bit_of_one_end() {
        let mut state = SceneState::new(&opened(), 100, true).unwrap();
        state.apply(&update(1, vec![line(7, 5.0, v1::Verdict::Blocked), line(9, 50.0, v1::Verdict::Visible)])).unwrap();
        let digest = |state: &SceneState| digest_of_lines(state.lines().iter().map(|(&id, l)| (id, l)));
        let before = digest(&state);
        state.apply(&update(2, vec![line(7, 5.0_f64.next_up(), v1::Verdict::Blocked)])).unwrap();
        assert_ne!(digest(&state), before);
        state.apply(&update(3, vec![line(7, 5.0, v1::Verdict::Blocked)])).unwrap();
        assert_eq!(digest(&state), before);
    }
}
