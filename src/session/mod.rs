//! A view's life: events in, messages out. Without I/O, threads or clocks, so that a list of events replays it.
//!
//! A [`View`] holds the newest of what it was told: pose, settings, exercise. When a frame is due and fewer than
//! [`MAX_UNACKNOWLEDGED`] are unacknowledged, [`View::produce`] makes it from that state, as a change against the last
//! frame sent. So a slow client never makes a queue; it gets fewer frames, each of the newest state.

mod course;
mod describe;
mod frame_time;
pub mod journal;
#[cfg(test)]
mod journal_tests;
mod pace;
pub mod replay;
mod settings;
#[cfg(test)]
mod tests;
mod verdicts;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use sightline_proto::{
    diamond::Post,
    mesh::Mesh,
    replica::{MeshError as ReplicaError, Replica, TerrainError},
    v1::{self, stream_scene_response::Response},
};
use thiserror::Error;

pub use course::Course;
pub use describe::{Details, describe};
pub use frame_time::FrameTime;
pub use pace::{MAX_RATE_HZ, MIN_BYTES_PER_S, Pacer};
pub use settings::{MAX_SUBSCRIBED_IDS, MAX_TRIANGLES, MIN_TRIANGLES, Pose, Settings, SettingsError, Subscription};
pub use verdicts::VerdictWatch;

use crate::{
    exercise::{EYE_LINE_ID, Exercise, LineState},
    los::{LosError, Verdict},
    roam::{Fidelity, MeshError, Preview, RequiredLine, Target, Terrain, ViewMesh, Work},
    terrain::{ReadError, SceneScale},
    view::Camera,
};

/// Frames of a view that may be unacknowledged.
pub const MAX_UNACKNOWLEDGED: u64 = 3;

/// What a view is told.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one at a time, and most are the large one")]
pub enum Event {
    /// A pose, an acknowledgement, new settings, or some of these.
    Steer(v1::SteerView),
    /// The client lost its place.
    Snapshot(v1::RequestSnapshot),
    /// The exercise has a new epoch.
    Exercise(Arc<Exercise>),
}

/// Why an event was refused: the client's defect. The view is as it was.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum EventError {
    /// Settings or pose.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The acknowledgement of a frame that was never sent.
    #[error("frame {acknowledged} is acknowledged, but the last frame sent is {sent}")]
    Acknowledged {
        /// The frame.
        acknowledged: u64,
        /// The last frame sent.
        sent: u64,
    },
    /// A pose whose number is not greater than the last one's.
    #[error("pose {found} comes after pose {last}: numbers of poses must grow")]
    PoseSequence {
        /// The pose's number.
        found: u64,
        /// The number of the pose before.
        last: u64,
    },
}

/// Why a frame could not be made: the server's defect or its terrain's.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum FrameError {
    /// The refinement.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The requirement of the eye.
    #[error("the line of sight at the eye: {0}")]
    Eye(#[from] LosError),
    /// A height that no frame can carry.
    #[error("height {height} of post ({i}, {j}) is not an integer of 32 bits: ingest the terrain first", i = post.i, j = post.j)]
    Height {
        /// The post.
        post: Post,
        /// Its height.
        height: f64,
    },
    /// What was refined is no mesh.
    #[error("the refined mesh is none: {0}")]
    Replica(#[from] ReplicaError),
}

/// What a frame is made from.
struct Wanted {
    settings: Settings,
    pose: Pose,
    camera: Camera,
    pose_sequence: u64,
    exercise: Option<Arc<Exercise>>,
}

/// One view of a terrain.
pub struct View<T: Terrain> {
    terrain: Arc<T>,
    scale: SceneScale,
    mesh: ViewMesh<T>,
    wanted: Wanted,
    /// Steers the budget where the target is a frame time.
    frame_time: Option<FrameTime>,
    frame_due: bool,
    snapshot_due: bool,
    /// The mesh of the last frame sent; before the first, that of two triangles.
    sent: Replica,
    unsatisfied: BTreeSet<u64>,
    off_ground: BTreeSet<u64>,
    work: Work,
    acknowledged: u64,
    /// The epoch of the last update sent, and of each line in it the epoch since which it is so.
    announced: Option<u64>,
    announced_lines: BTreeMap<u64, u64>,
}

impl<T: Terrain> View<T> {
    /// Opens a view of `terrain`, which `description` describes, with the exercise as it is now.
    pub fn open(
        terrain: Arc<T>,
        scale: SceneScale,
        description: &v1::TerrainDescription,
        settings: Settings,
        pose: Pose,
        exercise: Option<Arc<Exercise>>,
    ) -> Result<Self, OpenError> {
        let sent = Replica::new(description)?;
        let camera = settings.camera(&pose)?;
        let mut mesh = ViewMesh::new(Arc::clone(&terrain), scale)?;
        mesh.set_options(settings.options());
        let frame_time = settings.controller(None);
        let wanted = Wanted { settings, pose, camera, pose_sequence: 0, exercise };
        Ok(Self {
            terrain,
            scale,
            mesh,
            wanted,
            frame_time,
            frame_due: true,
            snapshot_due: true,
            sent,
            unsatisfied: BTreeSet::new(),
            off_ground: BTreeSet::new(),
            work: Work::default(),
            acknowledged: 0,
            announced: None,
            announced_lines: BTreeMap::new(),
        })
    }

    /// Takes an event, or refuses it and stays as it was.
    pub fn handle(&mut self, event: Event) -> Result<(), EventError> {
        match event {
            Event::Steer(steer) => self.steer(&steer),
            Event::Snapshot(request) => {
                self.acknowledge(request.received_sequence)?;
                (self.snapshot_due, self.frame_due) = (true, true);
                Ok(())
            }
            Event::Exercise(exercise) => {
                self.wanted.exercise = Some(exercise);
                self.frame_due = true;
                Ok(())
            }
        }
    }

    fn steer(&mut self, steer: &v1::SteerView) -> Result<(), EventError> {
        let pose = steer.pose.as_ref().map(Pose::from_wire).transpose()?;
        let settings = steer.settings.as_ref().map(Settings::from_wire).transpose()?;
        let took_ms = steer.frame_time_ms;
        if !(took_ms.is_finite() && took_ms >= 0.0) {
            return Err(SettingsError::Milliseconds("frame_time_ms", took_ms).into());
        }
        let (found, last) = (steer.pose_sequence, self.wanted.pose_sequence);
        if pose.is_some() && found <= last {
            return Err(EventError::PoseSequence { found, last });
        }
        let camera =
            settings.as_ref().unwrap_or(&self.wanted.settings).camera(pose.as_ref().unwrap_or(&self.wanted.pose))?;
        self.acknowledge(steer.applied_sequence)?;
        self.frame_due |= pose.is_some() || settings.is_some();
        self.wanted.camera = camera;
        if let Some(pose) = pose {
            (self.wanted.pose, self.wanted.pose_sequence) = (pose, found);
        }
        if let Some(settings) = settings {
            self.frame_time = settings.controller(self.frame_time);
            self.mesh.set_options(settings.options());
            self.wanted.settings = settings;
        }
        if let Some(control) = &mut self.frame_time
            && took_ms > 0.0
        {
            self.frame_due |= control.report(took_ms);
        }
        Ok(())
    }

    fn acknowledge(&mut self, acknowledged: u64) -> Result<(), EventError> {
        let sent = self.sent.sequence();
        if acknowledged > sent {
            return Err(EventError::Acknowledged { acknowledged, sent });
        }
        self.acknowledged = self.acknowledged.max(acknowledged);
        Ok(())
    }

    /// Whether [`View::produce`] would make a frame now.
    pub fn is_due(&self) -> bool {
        self.frame_due && self.sent.sequence() - self.acknowledged < MAX_UNACKNOWLEDGED
    }

    /// The messages of the next frame in the order in which they must be sent; none when it is not due.
    pub fn produce(&mut self) -> Result<Vec<Response>, FrameError> {
        if !self.is_due() {
            return Ok(Vec::new());
        }
        let required = self.required()?;
        let budget = self.frame_time.map(|control| Target::TriangleBudget(control.budget()));
        let target = budget.unwrap_or(self.wanted.settings.target);
        let report = self.mesh.update(&self.wanted.camera, target, &required)?;
        let (base_sequence, sequence) = (self.sent.sequence(), self.sent.sequence() + 1);
        let delta = self.sent.advance(&report.removed, &integer_posts(&self.mesh, &report.added)?, sequence)?;
        let (base_sequence, mesh) =
            if self.snapshot_due { (0, self.sent.encode(None)) } else { (base_sequence, delta) };
        let unsatisfied: BTreeSet<u64> = report.unsatisfied.iter().copied().collect();
        let off_ground: BTreeSet<u64> = report.off_ground.iter().copied().collect();
        if self.snapshot_due {
            (self.unsatisfied, self.off_ground) = Default::default();
        }
        let newly = |(id, _): &(&u64, &u32)| !self.unsatisfied.contains(*id);
        let now_unsatisfied = report.unsatisfied.iter().zip(&report.lacking).filter(newly).map(unsatisfied_line);
        let frame = v1::Frame {
            sequence,
            base_sequence,
            pose_sequence: self.wanted.pose_sequence,
            epoch: self.wanted.exercise.as_ref().map_or(0, |exercise| exercise.epoch()),
            mesh,
            triangle_count: self.sent.triangle_count(),
            distortion_bound_px: report.bound_px,
            mesh_hash: self.sent.hash(),
            now_unsatisfied: now_unsatisfied.collect(),
            no_longer_unsatisfied: self.unsatisfied.difference(&unsatisfied).copied().collect(),
            now_off_ground: off_ground.difference(&self.off_ground).copied().collect(),
            no_longer_off_ground: self.off_ground.difference(&off_ground).copied().collect(),
            // Told by whoever sends it.
            held_back_ms: 0,
        };
        let update = self.exercise_update();
        (self.unsatisfied, self.off_ground) = (unsatisfied, off_ground);
        self.work = report.work;
        (self.frame_due, self.snapshot_due) = (false, false);
        Ok(update.map(Response::Exercise).into_iter().chain([Response::Frame(frame)]).collect())
    }

    /// What making the last frame took.
    pub fn work(&self) -> Work {
        self.work
    }

    /// The pose that it was told last.
    pub fn pose(&self) -> &Pose {
        &self.wanted.pose
    }

    /// A look at what the next frame would read from another pose, lines of sight apart; `None` where no camera can be.
    pub fn preview(&self, pose: &Pose) -> Option<Preview<T>> {
        Some(self.mesh.preview(self.wanted.settings.camera(pose).ok()?))
    }

    /// The mesh of the last frame.
    pub fn sent(&self) -> &Replica {
        &self.sent
    }

    /// The lines that the view is subscribed to.
    fn lines(&self) -> impl Iterator<Item = &LineState> {
        let subscription = &self.wanted.settings.subscription;
        let lines = self.wanted.exercise.iter().flat_map(|exercise| exercise.sight_lines());
        lines.filter(|state| subscription.contains(state.line.id))
    }

    /// What entities ask, as far as the view is subscribed to it: of all lines, or of those that follow the entity.
    fn grounds(&self) -> Vec<RequiredLine> {
        let Some(exercise) = &self.wanted.exercise else { return Vec::new() };
        let grounds = exercise.grounds().map(|ground| RequiredLine::of_ground(ground.entity, ground.band));
        match self.wanted.settings.subscription {
            Subscription::All => grounds.collect(),
            Subscription::None => Vec::new(),
            Subscription::List(_) => {
                let followed: BTreeSet<u64> = self.lines().flat_map(|state| state.line.entities()).collect();
                grounds.filter(|ground| followed.contains(&ground.id)).collect()
            }
        }
    }

    /// What the mesh must honour: the lines that have ends, the ground of entities, and the eye.
    fn required(&self) -> Result<Vec<RequiredLine>, LosError> {
        let mut required: Vec<_> = self.lines().filter_map(required_line).collect();
        required.extend(self.grounds());
        if self.wanted.settings.subscription != Subscription::None {
            let eye = self.scale.grid_from_scene(self.wanted.pose.eye_m).to_array();
            required.extend(RequiredLine::of_eye(&*self.terrain, EYE_LINE_ID, eye)?);
        }
        Ok(required)
    }

    /// What the client does not know of its lines, if anything.
    fn exercise_update(&mut self) -> Option<v1::ExerciseUpdate> {
        let epoch = self.wanted.exercise.as_ref()?.epoch();
        let now: BTreeMap<u64, u64> = self.lines().map(|state| (state.line.id, state.since_epoch)).collect();
        let known = &self.announced_lines;
        let changed: Vec<_> = self
            .lines()
            .filter(|state| known.get(&state.line.id) != Some(&state.since_epoch))
            .map(line_to_wire)
            .collect();
        let removed: Vec<_> = known.keys().filter(|id| !now.contains_key(id)).copied().collect();
        if self.announced == Some(epoch) && changed.is_empty() && removed.is_empty() {
            return None;
        }
        (self.announced, self.announced_lines) = (Some(epoch), now);
        Some(v1::ExerciseUpdate { epoch, changed, removed })
    }
}

/// Why a view could not be opened.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum OpenError {
    /// What the client asked for.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A terrain that no frame can carry.
    #[error(transparent)]
    Terrain(#[from] TerrainError),
    /// The terrain could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// Active posts with the heights that a frame carries.
fn integer_posts<T: Terrain>(mesh: &ViewMesh<T>, posts: &[Post]) -> Result<Vec<(Post, i32)>, FrameError> {
    let exact = |&post: &Post| {
        let height = mesh.height(post).unwrap_or(f64::NAN);
        // Saturates and rounds; what does not come back was no integer of 32 bits.
        let integer = height as i32;
        if f64::from(integer) == height { Ok((post, integer)) } else { Err(FrameError::Height { post, height }) }
    };
    posts.iter().map(exact).collect()
}

fn unsatisfied_line((&id, &lacking_triangles): (&u64, &u32)) -> v1::UnsatisfiedLine {
    v1::UnsatisfiedLine { id, reason: v1::UnsatisfiedReason::Budget.into(), lacking_triangles }
}

fn required_line(state: &LineState) -> Option<RequiredLine> {
    let [a, b] = state.resolved?;
    let verdict = state.verdict.on_mesh();
    let (id, fidelity, priority) = (state.line.id, state.line.fidelity, state.line.priority);
    Some(RequiredLine { id, a, b, verdict, fidelity, priority })
}

/// A fidelity of a sight line as a message has it: with the distance of an obstruction in metres, 0 otherwise.
pub fn fidelity_to_wire(fidelity: Fidelity) -> (v1::Fidelity, f64) {
    match fidelity {
        Fidelity::Verdict => (v1::Fidelity::Verdict, 0.0),
        Fidelity::Obstruction { distance_m } => (v1::Fidelity::Obstruction, distance_m),
        Fidelity::Wedgie => (v1::Fidelity::Wedgie, 0.0),
        Fidelity::Profile => (v1::Fidelity::Profile, 0.0),
        // What an entity asks; no sight line does.
        Fidelity::Ground => (v1::Fidelity::Unspecified, 0.0),
    }
}

/// What is stated of a sight line: its verdict, and why it is UNKNOWN where it is.
fn stated_verdict(state: &LineState) -> (v1::Verdict, v1::UnknownReason) {
    match (state.verdict, state.resolved) {
        _ if !state.active => (v1::Verdict::Unknown, v1::UnknownReason::Inactive),
        (Verdict::Visible, _) => (v1::Verdict::Visible, v1::UnknownReason::Unspecified),
        (Verdict::Blocked, _) => (v1::Verdict::Blocked, v1::UnknownReason::Unspecified),
        (Verdict::Unknown, Some(_)) => (v1::Verdict::Unknown, v1::UnknownReason::UnknownGround),
        (Verdict::Unknown, None) => (v1::Verdict::Unknown, v1::UnknownReason::NoGround),
    }
}

/// A sight line at its epoch as a message.
pub fn line_to_wire(state: &LineState) -> v1::SightLineState {
    let position = |[x, y, z]: [f64; 3]| Some(v1::Position { x, y, z });
    let (verdict, unknown_reason) = stated_verdict(state);
    let (fidelity, obstruction_distance_m) = fidelity_to_wire(state.line.fidelity);
    v1::SightLineState {
        id: state.line.id,
        resolved: state.resolved.map(|[a, b]| v1::Segment { a: position(a), b: position(b) }),
        verdict: verdict.into(),
        unknown_reason: unknown_reason.into(),
        fidelity: fidelity.into(),
        obstruction_distance_m,
        first_obstruction: state.first_obstruction,
    }
}
