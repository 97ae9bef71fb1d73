//! The simulation host of a test: registers a scenario as an exercise, moves its entities and lets lines come and go, one
//! epoch a tick; the same on every server.

use sightline_client::{Client, v1};

use super::super::{Failure, connect::failure};
use crate::{
    evaluate::scenario::{Anchor, Scenario},
    session::fidelity_to_wire,
};

/// Directs one exercise, on all servers.
pub(super) struct Director {
    clients: Vec<Client>,
    name: String,
    scenario: Scenario,
    tick: u64,
}

/// The epoch of a tick, when an exercise has been made and filled by one request.
pub(super) fn epoch_of(tick: u64) -> u64 {
    tick + 1
}

/// The tick of an epoch; `None` for the empty exercise before tick 0.
pub(super) fn tick_of(epoch: u64) -> Option<u64> {
    epoch.checked_sub(1)
}

impl Director {
    /// Makes the exercise and registers the scenario as it stands at tick 0.
    pub(super) async fn begin(clients: Vec<Client>, name: &str, scenario: Scenario) -> Result<Self, Failure> {
        for client in &clients {
            client.create_exercise(name).await.map_err(failure)?;
        }
        let director = Self { clients, name: name.into(), scenario, tick: 0 };
        let change = v1::ChangeExerciseRequest {
            name: name.into(),
            put_entities: director.entities(0, |_| true),
            put_sight_lines: director.lines(|n| director.scenario.is_registered(n, 0)),
            ..Default::default()
        };
        director.change(change, 0).await?;
        Ok(director)
    }

    /// The tick that the exercise stands at.
    pub(super) fn tick(&self) -> u64 {
        self.tick
    }

    /// Moves what moves; registers lines that come and removes those that go.
    pub(super) async fn advance(&mut self) -> Result<(), Failure> {
        let tick = self.tick + 1;
        let is_there = |n: usize, tick| self.scenario.is_registered(n, tick);
        let gone = |&n: &usize| is_there(n, tick - 1) && !is_there(n, tick);
        let change = v1::ChangeExerciseRequest {
            name: self.name.clone(),
            remove_sight_lines: (0..self.scenario.lines.len()).filter(gone).map(|n| n as u64 + 1).collect(),
            put_entities: self.entities(tick, |n| self.scenario.entities[n].step != [0.0; 2]),
            put_sight_lines: self.lines(|n| is_there(n, tick) && !is_there(n, tick - 1)),
            ..Default::default()
        };
        self.change(change, tick).await?;
        self.tick = tick;
        Ok(())
    }

    /// Ends the exercise.
    pub(super) async fn end(self) -> Result<(), Failure> {
        for client in &self.clients {
            client.delete_exercise(&self.name).await.map_err(failure)?;
        }
        Ok(())
    }

    async fn change(&self, change: v1::ChangeExerciseRequest, tick: u64) -> Result<(), Failure> {
        let (name, wanted) = (&self.name, epoch_of(tick));
        for client in &self.clients {
            let epoch = client.change_exercise(change.clone()).await.map_err(failure)?;
            if epoch != wanted {
                return Err(Failure::Found(format!(
                    "exercise '{name}' went to epoch {epoch} where {wanted} follows: is another host at it?"
                )));
            }
        }
        Ok(())
    }

    fn lines(&self, which: impl Fn(usize) -> bool) -> Vec<v1::SightLine> {
        let (fidelity, obstruction_distance_m) = fidelity_to_wire(self.scenario.fidelity);
        let line = |n: usize| v1::SightLine {
            id: n as u64 + 1,
            a: Some(self.anchor(self.scenario.lines[n].a)),
            b: Some(self.anchor(self.scenario.lines[n].b)),
            fidelity: fidelity.into(),
            priority: 0,
            obstruction_distance_m,
            ..Default::default()
        };
        (0..self.scenario.lines.len()).filter(|&n| which(n)).map(line).collect()
    }

    fn entities(&self, tick: u64, which: impl Fn(usize) -> bool) -> Vec<v1::Entity> {
        let entity = |n: usize| {
            let [x, y] = self.scenario.place(Anchor::Entity(n), tick);
            v1::Entity {
                id: n as u64 + 1,
                position: Some(v1::Position { x, y, z: self.scenario.above }),
                frame: v1::CoordinateFrame::Grid.into(),
                altitude: v1::AltitudeReference::AboveGround.into(),
                ground_m: 0.0,
            }
        };
        (0..self.scenario.entities.len()).filter(|&n| which(n)).map(entity).collect()
    }

    fn anchor(&self, anchor: Anchor) -> v1::Anchor {
        let anchor = match anchor {
            Anchor::Entity(n) => {
                v1::anchor::Anchor::Entity(v1::EntityAnchor { entity_id: n as u64 + 1, height_offset_m: 0.0 })
            }
            Anchor::Point([x, y]) => v1::anchor::Anchor::Point(v1::PointAnchor {
                position: Some(v1::Position { x, y, z: self.scenario.above }),
                frame: v1::CoordinateFrame::Grid.into(),
                altitude: v1::AltitudeReference::AboveGround.into(),
            }),
        };
        v1::Anchor { anchor: Some(anchor) }
    }
}
