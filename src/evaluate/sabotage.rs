//! Sabotage of the instrument, to see that it notices: a layer between the bytes received and the replica.
//!
//! It keeps the true state of the view and passes each frame on as a snapshot with a correct count and hash, so that
//! nothing but the verdicts can betray it. In one frame only: a height is off by one unit, or a required split is
//! missing; or the sight lines of an epoch are withheld until a frame has been passed on under its number. It waits for
//! a frame in which the change turns a verdict, for a change that alters no verdict is no disagreement.

use std::ops::ControlFlow;

use sightline_client::scene::{Event, SceneError, SceneState};
use sightline_proto::{
    diamond::{Post, RootSquare},
    mesh::Mesh,
    replica::Replica,
    v1::{self, stream_scene_response::Response},
    verdict::{MeshVerdict, for_each_triangle_met, verdict_on_mesh},
};

/// What is to be done once.
#[derive(Clone, Copy, PartialEq, Eq, Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sabotage {
    /// One height off by one unit.
    Height,
    /// One required split dropped.
    Split,
    /// One epoch's sight lines kept from the client.
    Epoch,
}

/// What a message became.
#[derive(Clone, PartialEq, Debug)]
pub struct Passed {
    /// What the client gets instead.
    pub messages: Vec<v1::StreamSceneResponse>,
    /// The lines that the change should betray, and what was done, at the message that carries it.
    pub tampered: Option<(Vec<u64>, String)>,
}

/// The layer.
#[derive(Clone, Debug)]
pub struct Saboteur {
    kind: Sabotage,
    done: bool,
    truth: SceneState,
    /// Sight-line changes kept back, and the state before them.
    withheld: Option<(v1::ExerciseUpdate, Box<SceneState>)>,
}

impl Saboteur {
    /// A layer over a view in the given state, normally just opened.
    pub fn new(kind: Sabotage, state: SceneState) -> Self {
        Self { kind, done: false, truth: state, withheld: None }
    }

    /// Takes a message as received; gives those that reach the client.
    pub fn pass(&mut self, message: v1::StreamSceneResponse) -> Result<Passed, SceneError> {
        let before = self.truth.clone();
        let event = self.truth.apply(&message)?;
        match (event, message.response) {
            (Event::Exercise, Some(Response::Exercise(update))) => Ok(self.pass_update(update, &before)),
            (Event::Frame, Some(Response::Frame(frame))) => Ok(self.pass_frame(&frame)),
            (_, response) => Ok(Passed { messages: vec![v1::StreamSceneResponse { response }], tampered: None }),
        }
    }

    fn pass_update(&mut self, update: v1::ExerciseUpdate, before: &SceneState) -> Passed {
        // The first lines of a view are not stale, they are missing: any client would notice.
        if self.kind != Sabotage::Epoch || self.done || before.lines().is_empty() {
            return Passed { messages: vec![message(Response::Exercise(update))], tampered: None };
        }
        let empty = v1::ExerciseUpdate { epoch: update.epoch, ..Default::default() };
        let stale = Box::new(before.clone());
        let (held, _) = self.withheld.get_or_insert_with(|| (v1::ExerciseUpdate::default(), stale));
        held.epoch = update.epoch;
        held.changed.retain(|line| !update.removed.contains(&line.id));
        held.changed.extend(update.changed);
        held.removed.extend(update.removed);
        Passed { messages: vec![message(Response::Exercise(empty))], tampered: None }
    }

    fn pass_frame(&mut self, frame: &v1::Frame) -> Passed {
        let change = match self.kind {
            _ if self.done => None,
            Sabotage::Height => a_height_that_turns(&self.truth),
            Sabotage::Split => a_split_that_turns(&self.truth),
            Sabotage::Epoch => None,
        };
        let replica = self.truth.replica();
        let changed = change.as_ref().and_then(|change| change.applied_to(replica));
        let snapshot = message(Response::Frame(self.snapshot(frame, changed.as_ref().unwrap_or(replica))));
        if let (Some(change), Some(_)) = (change, changed) {
            self.done = true;
            let tampered = Some((change.betrays.clone(), change.to_string()));
            return Passed { messages: vec![snapshot], tampered };
        }
        let Some((held, stale)) = self.withheld.take() else {
            return Passed { messages: vec![snapshot], tampered: None };
        };
        let detail = format!("sight lines of epoch {} withheld", held.epoch);
        let betrays = self.betrayed_by_stale_lines(&stale);
        let update = message(Response::Exercise(held));
        if betrays.is_empty() {
            return Passed { messages: vec![update, snapshot], tampered: None };
        }
        // The frame goes out among stale lines; what was kept back follows it.
        self.done = true;
        Passed { messages: vec![snapshot, update], tampered: Some((betrays, detail)) }
    }

    /// Lines that a client with the sight lines of `stale` gets wrong on the present mesh.
    fn betrayed_by_stale_lines(&self, stale: &SceneState) -> Vec<u64> {
        let turns = |(id, _, wanted): (u64, [[f64; 3]; 2], MeshVerdict)| {
            let held = stale.lines().get(&id).and_then(|line| line.ends);
            let found = held.map(|[a, b]| verdict_on_mesh(self.truth.replica(), a, b));
            (found != Some(wanted)).then_some(id)
        };
        lines_at_stake(&self.truth).filter_map(turns).collect()
    }

    fn snapshot(&self, frame: &v1::Frame, mesh: &Replica) -> v1::Frame {
        v1::Frame {
            base_sequence: 0,
            mesh: mesh.encode(None),
            triangle_count: mesh.triangle_count(),
            mesh_hash: mesh.hash(),
            now_unsatisfied: self.truth.unsatisfied().values().copied().collect(),
            no_longer_unsatisfied: Vec::new(),
            ..frame.clone()
        }
    }
}

fn message(response: Response) -> v1::StreamSceneResponse {
    v1::StreamSceneResponse { response: Some(response) }
}

/// A change of one post that turns verdicts.
#[derive(Clone, PartialEq, Debug)]
struct Change {
    post: Post,
    /// The new height; `None` to leave the post out.
    height: Option<i32>,
    betrays: Vec<u64>,
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Post { i, j } = self.post;
        match self.height {
            Some(height) => write!(f, "height of post ({i}, {j}) made {height}"),
            None => write!(f, "split at post ({i}, {j}) dropped"),
        }
    }
}

impl Change {
    fn applied_to(&self, replica: &Replica) -> Option<Replica> {
        let posts = replica.posts().into_iter().filter(|(p, _)| *p != self.post && !replica.root().is_corner(*p));
        let changed = self.height.map(|height| (self.post, height));
        replica.with_posts(posts.chain(changed), replica.sequence()).ok()
    }
}

/// A mesh with one post changed.
struct Altered<'a> {
    mesh: &'a Replica,
    post: Post,
    height: Option<f64>,
}

impl Mesh for Altered<'_> {
    fn root(&self) -> RootSquare {
        self.mesh.root()
    }

    fn grid_size(&self) -> (u32, u32) {
        self.mesh.grid_size()
    }

    fn height(&self, p: Post) -> Option<f64> {
        if p == self.post { self.height } else { self.mesh.height(p) }
    }
}

/// The lines that are stated and not named, with ends and the verdict that they should have.
fn lines_at_stake(state: &SceneState) -> impl Iterator<Item = (u64, [[f64; 3]; 2], MeshVerdict)> {
    state.lines().iter().filter(|(id, _)| !state.unsatisfied().contains_key(id)).filter_map(|(&id, line)| {
        let verdict = match line.verdict {
            v1::Verdict::Visible => MeshVerdict::Visible,
            v1::Verdict::Blocked => MeshVerdict::Blocked,
            v1::Verdict::Unknown | v1::Verdict::Unspecified => return None,
        };
        Some((id, line.ends?, verdict))
    })
}

fn first_change(state: &SceneState, options: impl Fn(Post) -> Vec<Option<i32>>) -> Option<Change> {
    let mesh = state.replica();
    for (_, [a, b], verdict) in lines_at_stake(state) {
        let mut posts = Vec::new();
        let _: ControlFlow<()> = for_each_triangle_met(mesh, a, b, |t| {
            posts.extend(t.corners());
            ControlFlow::Continue(())
        });
        posts.sort_unstable();
        posts.dedup();
        for post in posts.into_iter().filter(|&p| !mesh.root().is_corner(p)) {
            for height in options(post) {
                let altered = Altered { mesh, post, height: height.map(f64::from) };
                if verdict_on_mesh(&altered, a, b) != verdict {
                    return Some(Change { post, height, betrays: betrayed(state, &altered) });
                }
            }
        }
    }
    None
}

fn betrayed(state: &SceneState, altered: &Altered) -> Vec<u64> {
    let turns =
        |(id, [a, b], verdict): (u64, [[f64; 3]; 2], _)| (verdict_on_mesh(altered, a, b) != verdict).then_some(id);
    lines_at_stake(state).filter_map(turns).collect()
}

fn a_height_that_turns(state: &SceneState) -> Option<Change> {
    first_change(state, |post| match state.replica().integer_height(post) {
        Some(h) => [h.checked_add(1), h.checked_sub(1)].into_iter().flatten().map(Some).collect(),
        None => Vec::new(),
    })
}

fn a_split_that_turns(state: &SceneState) -> Option<Change> {
    let mesh = state.replica();
    first_change(state, |post| {
        let is_leaf = mesh.root().children(post).all(|child| mesh.integer_height(child).is_none());
        if is_leaf { vec![None] } else { Vec::new() }
    })
}
