//! The exercise of a load: entities that go around in circles, and sight lines between them.

use std::{sync::Arc, time::Instant};

use sightline_client::{Client, v1};
use tokio::time::sleep_until;

use super::{
    super::{Failure, connect::failure},
    tally::{Schedule, Tally},
};
use crate::evaluate::dice::Dice;

/// How often all entities move.
const MOVES_HZ: f64 = 5.0;
/// How far an entity goes between two moves, in metres: 20 m/s.
const STEP_M: f64 = 4.0;
/// Radius of an entity's circle in metres.
const RADIUS_M: f64 = 500.0;
/// Greatest distance between the circles of a line's ends.
const APART_M: f64 = 5_000.0;
/// Seconds after which a server forgets the exercise of a load that has vanished.
const LEASE_S: u32 = 60;
/// Height of entities above the ground in metres.
const HEIGHT_M: f64 = 2.0;

/// An exercise and the circles of its entities.
pub(super) struct World {
    pub(super) name: String,
    centres: Arc<[[f64; 2]]>,
    extent_m: [f64; 2],
}

/// Moves the entities.
pub(super) struct Mover {
    client: Client,
    name: String,
    centres: Arc<[[f64; 2]]>,
    extent_m: [f64; 2],
}

fn lease() -> v1::Lease {
    v1::Lease { owner: "load".into(), term_s: LEASE_S }
}

impl World {
    /// Makes an exercise of so many sight lines.
    pub(super) async fn make(client: &Client, extent_m: [f64; 2], lines: u32, seed: u64) -> Result<Self, Failure> {
        let mut dice = Dice::new(seed ^ 0x0045_4e54);
        let mut centres = Vec::new();
        for _ in 0..lines {
            let (from, heading) = (dice.place([[0.0; 2], extent_m], 0.05), dice.heading());
            let apart_m = APART_M * dice.fraction();
            centres.extend([from, [0, 1].map(|k| (from[k] + heading[k] * apart_m).clamp(0.0, extent_m[k]))]);
        }
        let (name, centres) = (format!("load-{}", std::process::id()), Arc::from(centres));
        let world = Self { name, centres, extent_m };
        client.create_exercise_under(&world.name, lease()).await.map_err(failure)?;
        let end = |entity_id| {
            let anchor = v1::anchor::Anchor::Entity(v1::EntityAnchor { entity_id, height_offset_m: 0.0 });
            Some(v1::Anchor { anchor: Some(anchor) })
        };
        let line = |id: u64| v1::SightLine { id, a: end(2 * id), b: end(2 * id + 1), ..Default::default() };
        let put_sight_lines = (0..u64::from(lines)).map(line).collect();
        let change = v1::ChangeExerciseRequest { put_sight_lines, ..world.mover(client.clone()).moved(0) };
        match client.change_exercise(change).await {
            Ok(_) => Ok(world),
            Err(error) => {
                world.delete(client).await?;
                Err(failure(error))
            }
        }
    }

    pub(super) fn mover(&self, client: Client) -> Mover {
        Mover { client, name: self.name.clone(), centres: Arc::clone(&self.centres), extent_m: self.extent_m }
    }

    pub(super) async fn delete(&self, client: &Client) -> Result<(), Failure> {
        client.delete_exercise(&self.name).await.map_err(failure)
    }
}

impl Mover {
    /// The change that brings all entities to their places after `step` moves.
    fn moved(&self, step: u64) -> v1::ChangeExerciseRequest {
        let angle = step as f64 * STEP_M / RADIUS_M;
        let entity = |(id, centre): (u64, &[f64; 2])| {
            // Every entity begins elsewhere on its circle.
            let (sin, cos) = (angle + id as f64).sin_cos();
            let [x, y] =
                [(0, cos), (1, sin)].map(|(k, part)| (centre[k] + RADIUS_M * part).clamp(0.0, self.extent_m[k]));
            v1::Entity {
                id,
                position: Some(v1::Position { x, y, z: HEIGHT_M }),
                frame: v1::CoordinateFrame::Scene.into(),
                altitude: v1::AltitudeReference::AboveGround.into(),
                ground_m: 0.0,
            }
        };
        let put_entities = (0..).zip(&*self.centres).map(entity).collect();
        // Each move renews the lease.
        v1::ChangeExerciseRequest { name: self.name.clone(), put_entities, lease: Some(lease()), ..Default::default() }
    }

    pub(super) async fn run(self, begin: Instant, end: Instant, tally: Arc<Tally>) {
        let mut schedule = Schedule::new(begin, MOVES_HZ, end);
        while let Some(due) = schedule.due() {
            sleep_until(due.into()).await;
            // Moves that are late are one.
            let mut step = schedule.take();
            while schedule.due().is_some_and(|due| due <= Instant::now()) {
                step = schedule.take();
            }
            let changed = self.client.change_exercise(self.moved(step + 1)).await;
            let mut counted = tally.count();
            match changed {
                Ok(_) => counted.changes += 1,
                Err(error) => counted.error(error),
            }
        }
    }
}
