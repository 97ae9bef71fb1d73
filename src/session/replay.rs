//! Replays a journal: makes every frame anew from what was recorded of its view, and compares it with what was sent.
//!
//! Exercises are changed as they were, verdicts and all; views are opened, told and asked for frames as they were. What
//! comes out must be the same messages, byte for byte: mesh, hash, lines named, bound. Only how long a frame was held
//! back is taken from the message itself, since no frame follows from a clock.

use std::{
    collections::{BTreeMap, btree_map},
    sync::Arc,
};

use prost::Message;
use serde::Serialize;
use sightline_proto::v1::{self, stream_scene_request::Request, stream_scene_response::Response};
use thiserror::Error;

use super::{Details, Event, Pose, Settings, View, describe, journal::Entry};
use crate::{
    database::version_digits,
    exercise::{Exercise, Site},
    roam::Terrain,
    terrain::ReadError,
};

/// Differences that are described; beyond it they are counted.
pub const MAX_DIFFERENCES: usize = 20;

/// What replaying found.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct Replayed {
    /// Changes of exercises, with those that were there from the beginning, were made, and ended.
    pub exercise_changes: u64,
    /// Views opened.
    pub views: u64,
    /// Frames made anew and compared.
    pub frames: u64,
    /// Bytes of their messages.
    pub bytes: u64,
    /// Frames that came out otherwise.
    pub different_frames: u64,
    /// The first of them.
    pub differences: Vec<Difference>,
    /// Order-free sum of the hashes of all frames made anew.
    pub hash_sum: u64,
    /// Whether the journal says where it ends.
    pub has_ended: bool,
    /// Whether it ended at its limit.
    pub is_full: bool,
}

/// A frame that came out otherwise.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Difference {
    /// The view.
    pub view: u64,
    /// The frame's number, as it was sent; 0 where no frame was.
    pub sequence: u64,
    /// What differs.
    pub what: String,
}

/// Why a journal makes no sense on this terrain. Nothing after it can be replayed.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum ReplayError {
    /// It was recorded on another terrain.
    #[error("it was recorded on terrain {recorded}, and this is terrain {here}")]
    Terrain {
        /// The recorded version, in hexadecimal digits.
        recorded: String,
        /// The version of this terrain.
        here: String,
    },
    /// An exercise that cannot be as it is stated.
    #[error("exercise '{name}': {why}")]
    Exercise {
        /// Its name.
        name: String,
        /// Why.
        why: String,
    },
    /// A view that cannot be as it is stated.
    #[error("view {view}: {why}")]
    View {
        /// Its number.
        view: u64,
        /// Why.
        why: String,
    },
}

/// The state of a server as a journal tells it.
pub struct Replay<T: Terrain> {
    terrain: Arc<T>,
    site: Site,
    version: Vec<u8>,
    description: v1::TerrainDescription,
    exercises: BTreeMap<String, Arc<Exercise>>,
    views: BTreeMap<u64, Followed<T>>,
    found: Replayed,
}

struct Followed<T: Terrain> {
    view: View<T>,
    /// The exercise that it follows; empty for none.
    exercise: String,
}

impl<T: Terrain> Replay<T> {
    /// A server on `terrain` to which nothing has happened.
    pub fn new(terrain: Arc<T>, site: Site, details: &Details) -> Result<Self, ReadError> {
        let description = describe(&*terrain, &site, details)?;
        let (exercises, views, found) = Default::default();
        Ok(Self { terrain, site, version: details.version.clone(), description, exercises, views, found })
    }

    /// What was found so far.
    pub fn found(&self) -> &Replayed {
        &self.found
    }

    /// Does what an entry says, and compares what comes out.
    pub fn take(&mut self, entry: Entry) -> Result<(), ReplayError> {
        match entry {
            Entry::Began { terrain, .. } if terrain != self.version => {
                let [recorded, here] = [&terrain, &self.version].map(|version| version_digits(version));
                return Err(ReplayError::Terrain { recorded, here });
            }
            Entry::Began { .. } => {}
            Entry::Ended { is_full } => (self.found.has_ended, self.found.is_full) = (true, is_full),
            Entry::Opened { view, open } => return self.open(view, &open).map_err(|why| of_view(view, why)),
            Entry::Heard { view, heard } => return self.hear(view, &heard),
            Entry::Followed { view, heard } => {
                self.hear(view, &heard)?;
                return self.follow(view).map_err(|why| of_view(view, why));
            }
            Entry::Made { view, heard, said } => {
                self.hear(view, &heard)?;
                return self.make(view, &said).map_err(|why| of_view(view, why));
            }
            Entry::Closed { view } => {
                self.views.remove(&view).ok_or_else(|| of_view(view, NOT_OPEN.into()))?;
            }
            entry => self.change(entry)?,
        }
        Ok(())
    }

    /// What happens to exercises.
    fn change(&mut self, entry: Entry) -> Result<(), ReplayError> {
        let unknown = || "it is not there".to_owned();
        let changed = match entry {
            Entry::Restored { name, epoch, entities, sight_lines } => {
                let made = Exercise::restored(&name, epoch, &entities, &sight_lines, &self.site, &*self.terrain);
                (name, made.map(Some).map_err(|error| error.to_string()))
            }
            Entry::Created { name } => {
                let made = Exercise::new(&name).map_err(|error| error.to_string());
                let is_new = !self.exercises.contains_key(&name);
                (name, made.and_then(|made| if is_new { Ok(Some(made)) } else { Err("it is there already".into()) }))
            }
            Entry::Changed { name, change } => {
                let before = self.exercises.get(&name).ok_or_else(unknown);
                let after = |before: &Arc<Exercise>| before.changed(&change, &self.site, &*self.terrain);
                let after = before.and_then(|before| after(before).map_err(|error| error.to_string()));
                (name, after.map(Some))
            }
            Entry::Expired { name, entities, sight_lines } => {
                let before = self.exercises.get(&name).ok_or_else(unknown);
                (name, before.map(|before| Some(before.without(&entities, &sight_lines))))
            }
            Entry::Deleted { name } => {
                let is_there = self.exercises.contains_key(&name);
                (name, if is_there { Ok(None) } else { Err(unknown()) })
            }
            _ => return Ok(()),
        };
        let (name, after) = changed;
        match after.map_err(|why| ReplayError::Exercise { name: name.clone(), why })? {
            Some(exercise) => self.exercises.insert(name, Arc::new(exercise)),
            None => self.exercises.remove(&name),
        };
        self.found.exercise_changes += 1;
        Ok(())
    }

    fn exercise(&self, name: &str) -> Result<Option<Arc<Exercise>>, String> {
        if name.is_empty() {
            return Ok(None);
        }
        self.exercises.get(name).cloned().map(Some).ok_or_else(|| format!("there is no exercise '{name}'"))
    }

    fn open(&mut self, number: u64, open: &[u8]) -> Result<(), String> {
        let open = v1::OpenView::decode(open).map_err(|error| error.to_string())?;
        let settings = open.settings.as_ref().ok_or("it has no settings")?;
        let settings = Settings::from_wire(settings).map_err(|error| error.to_string())?;
        let pose = Pose::from_wire(open.pose.as_ref().ok_or("it has no pose")?).map_err(|error| error.to_string())?;
        let exercise = self.exercise(&open.exercise)?;
        let (terrain, scale) = (Arc::clone(&self.terrain), self.site.scale);
        let view = View::open(terrain, scale, &self.description, settings, pose, exercise);
        let view = view.map_err(|error| error.to_string())?;
        let btree_map::Entry::Vacant(place) = self.views.entry(number) else {
            return Err("it is open already".into());
        };
        place.insert(Followed { view, exercise: open.exercise });
        self.found.views += 1;
        Ok(())
    }

    fn hear(&mut self, number: u64, heard: &[Vec<u8>]) -> Result<(), ReplayError> {
        let view = &mut self.views.get_mut(&number).ok_or_else(|| of_view(number, NOT_OPEN.into()))?.view;
        for message in heard {
            let message = v1::StreamSceneRequest::decode(&message[..]);
            let event = match message.map_err(|error| of_view(number, error.to_string()))?.request {
                Some(Request::Steer(steer)) => Event::Steer(steer),
                Some(Request::Snapshot(request)) => Event::Snapshot(request),
                Some(Request::Open(_)) | None => return Err(of_view(number, "it heard what says nothing".into())),
            };
            view.handle(event).map_err(|error| of_view(number, error.to_string()))?;
        }
        Ok(())
    }

    fn follow(&mut self, number: u64) -> Result<(), String> {
        let name = self.views.get(&number).ok_or(NOT_OPEN)?.exercise.clone();
        let exercise = self.exercise(&name)?.ok_or("it follows no exercise")?;
        let followed = self.views.get_mut(&number).ok_or(NOT_OPEN)?;
        followed.view.handle(Event::Exercise(exercise)).map_err(|error| error.to_string())
    }

    fn make(&mut self, number: u64, said: &[Vec<u8>]) -> Result<(), String> {
        let view = &mut self.views.get_mut(&number).ok_or(NOT_OPEN)?.view;
        let decode = |bytes: &Vec<u8>| v1::StreamSceneResponse::decode(&bytes[..]).map_err(|error| error.to_string());
        let sent = said.iter().map(decode).collect::<Result<Vec<_>, _>>()?;
        let sent_frame = sent.iter().find_map(frame_in);
        let mut made = view.produce().map_err(|error| error.to_string())?;
        for word in &mut made {
            if let (Response::Frame(frame), Some(sent)) = (word, sent_frame) {
                frame.held_back_ms = sent.held_back_ms;
            }
        }
        let made: Vec<_> = made.into_iter().map(|word| v1::StreamSceneResponse { response: Some(word) }).collect();
        self.found.frames += 1;
        self.found.bytes += said.iter().map(|bytes| bytes.len() as u64).sum::<u64>();
        let hash = view.sent().hash();
        self.found.hash_sum = self.found.hash_sum.wrapping_add(hash);
        let is_same =
            made.len() == said.len() && made.iter().zip(said).all(|(made, said)| made.encode_to_vec() == *said);
        if !is_same {
            self.found.different_frames += 1;
            if self.found.differences.len() < MAX_DIFFERENCES {
                let what = difference(&made, &sent);
                let sequence = sent_frame.map_or(0, |frame| frame.sequence);
                self.found.differences.push(Difference { view: number, sequence, what });
            }
        }
        Ok(())
    }
}

const NOT_OPEN: &str = "it is not open";

fn of_view(view: u64, why: String) -> ReplayError {
    ReplayError::View { view, why }
}

fn frame_in(message: &v1::StreamSceneResponse) -> Option<&v1::Frame> {
    match &message.response {
        Some(Response::Frame(frame)) => Some(frame),
        _ => None,
    }
}

/// The first thing in which two lists of messages differ, in words.
fn difference(made: &[v1::StreamSceneResponse], sent: &[v1::StreamSceneResponse]) -> String {
    if made.len() != sent.len() {
        return format!("{} messages were sent, {} are made", sent.len(), made.len());
    }
    let (Some(made), Some(sent)) = (made.iter().find_map(frame_in), sent.iter().find_map(frame_in)) else {
        return "no frame".into();
    };
    if made.mesh_hash != sent.mesh_hash {
        return format!("the mesh: hash {:016x} was sent, {:016x} is made", sent.mesh_hash, made.mesh_hash);
    }
    if made.mesh != sent.mesh {
        return "the bytes of the mesh".into();
    }
    let parts = [
        ("its numbers or its epoch", numbers(made) == numbers(sent)),
        ("the distortion bound", made.distortion_bound_px.to_bits() == sent.distortion_bound_px.to_bits()),
        ("the lines named", names(made) == names(sent)),
    ];
    let part = parts.iter().find(|(_, is_same)| !is_same).map_or("the sight lines stated before it", |(what, _)| what);
    part.to_owned()
}

fn numbers(frame: &v1::Frame) -> [u64; 5] {
    [frame.sequence, frame.base_sequence, frame.pose_sequence, frame.epoch, frame.triangle_count.into()]
}

type Names<'a> = (&'a [v1::UnsatisfiedLine], &'a [u64], &'a [u64], &'a [u64]);

fn names(frame: &v1::Frame) -> Names<'_> {
    (&frame.now_unsatisfied, &frame.no_longer_unsatisfied, &frame.now_off_ground, &frame.no_longer_off_ground)
}
