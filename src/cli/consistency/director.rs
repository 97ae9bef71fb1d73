//! The simulation host of a test: registers a scenario as an exercise and moves its entities, one epoch a tick.

use sightline_client::{Client, v1};

use super::super::{Failure, connect::failure};
use crate::{
    evaluate::scenario::{Anchor, Scenario},
    session::fidelity_to_wire,
};

/// Directs one exercise.
pub(super) struct Director {
    client: Client,
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
    pub(super) async fn begin(client: Client, name: &str, scenario: Scenario) -> Result<Self, Failure> {
        client.create_exercise(name).await.map_err(failure)?;
        let director = Self { client, name: name.into(), scenario, tick: 0 };
        let (fidelity, obstruction_distance_m) = fidelity_to_wire(director.scenario.fidelity);
        let lines = (1..).zip(&director.scenario.lines).map(|(id, line)| v1::SightLine {
            id,
            a: Some(director.anchor(line.a)),
            b: Some(director.anchor(line.b)),
            fidelity: fidelity.into(),
            priority: 0,
            obstruction_distance_m,
            ..Default::default()
        });
        let change = v1::ChangeExerciseRequest {
            name: name.into(),
            put_entities: director.entities(0, |_| true),
            put_sight_lines: lines.collect(),
            ..Default::default()
        };
        director.change(change, 0).await?;
        Ok(director)
    }

    /// The tick that the exercise stands at.
    pub(super) fn tick(&self) -> u64 {
        self.tick
    }

    /// Moves what moves.
    pub(super) async fn advance(&mut self) -> Result<(), Failure> {
        let tick = self.tick + 1;
        let change = v1::ChangeExerciseRequest {
            name: self.name.clone(),
            put_entities: self.entities(tick, |n| self.scenario.entities[n].step != [0.0; 2]),
            ..Default::default()
        };
        self.change(change, tick).await?;
        self.tick = tick;
        Ok(())
    }

    /// Ends the exercise.
    pub(super) async fn end(self) -> Result<(), Failure> {
        self.client.delete_exercise(&self.name).await.map_err(failure)
    }

    async fn change(&self, change: v1::ChangeExerciseRequest, tick: u64) -> Result<(), Failure> {
        let epoch = self.client.change_exercise(change).await.map_err(failure)?;
        if epoch == epoch_of(tick) {
            return Ok(());
        }
        let (name, wanted) = (&self.name, epoch_of(tick));
        Err(Failure::Found(format!(
            "exercise '{name}' went to epoch {epoch} where {wanted} follows: is another host at it?"
        )))
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
