//! Flies a view of a running server and writes what it receives as a session of the conformance suite:
//!
//! ```sh
//! sightline serve tests/golden/terrain-20x13-v1.sldb --listen 127.0.0.1:7410 &
//! cargo run -p sightline-client --example record_session -- 127.0.0.1:7410 clients/conformance/voids.jsonl 150
//! ```
//!
//! The flight makes an exercise of its own, some of whose entities ask for the ground that they stand on; it moves
//! entities, changes budget and subscription, and asks for a snapshot. Each
//! step waits for its frame, so the same server gives the same session.

#[path = "../tests/session/mod.rs"]
mod session;

use std::{error::Error, fs};

use serde_json::json;
use sightline_client::{Client, Event, View, v1};

const EXERCISE: &str = "recorded";
const ENTITIES: u64 = 14;
const POSES: u32 = 12;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, path, triangles] = &arguments[..] else {
        return Err("usage: record_session ADDRESS FILE.jsonl TRIANGLES".into());
    };
    let triangles = triangles.parse()?;
    let client = Client::connect(address).await?;
    let terrain = client.terrain().await?;
    client.create_exercise(EXERCISE).await?;
    client.change_exercise(exercise(&terrain)).await?;
    let view = client.open_view(EXERCISE, settings(triangles, None), pose(&terrain, 0)).await?;
    let header = json!({ "max_triangles": triangles, "lines_expected": true });
    let opening = json!({ "message": session::hex(&view.opening_bytes()) });
    let mut flight = Flight { client, view, terrain, triangles, lines: vec![header.to_string(), opening.to_string()] };
    flight.fly().await?;
    flight.client.delete_exercise(EXERCISE).await?;
    fs::write(path, flight.lines.join("\n") + "\n")?;
    println!("{} messages in {path}", flight.lines.len() - 1);
    Ok(())
}

struct Flight {
    client: Client,
    view: View,
    terrain: v1::TerrainDescription,
    triangles: u32,
    lines: Vec<String>,
}

impl Flight {
    async fn fly(&mut self) -> Result<(), Box<dyn Error>> {
        self.frame().await?;
        for n in 1..=POSES {
            self.view.steer(pose(&self.terrain, n)).await?;
            self.frame().await?;
            match n {
                3 => {
                    self.client.change_exercise(moves(&self.terrain)).await?;
                }
                5 => self.view.request_snapshot().await?,
                6 => self.view.change_settings(settings(self.triangles / 8, None)).await?,
                8 => self.view.change_settings(settings(self.triangles, Some(vec![1, 4, 9]))).await?,
                10 => self.view.change_settings(settings(self.triangles / 2, None)).await?,
                _ => continue,
            }
            self.frame().await?;
        }
        Ok(())
    }

    /// Receives up to the next frame.
    async fn frame(&mut self) -> Result<(), Box<dyn Error>> {
        loop {
            let event = self.view.next().await?.ok_or("the server has closed the view")?;
            let message = session::hex(&self.view.last_bytes().unwrap_or_default());
            match event {
                Event::Exercise(_) => self.lines.push(json!({ "message": message }).to_string()),
                Event::Frame(_) => {
                    let held = session::held(self.view.scene());
                    self.lines.push(json!({ "message": message, "held": held }).to_string());
                    return Ok(());
                }
                Event::Lost(error) => return Err(error.into()),
                Event::Skipped => return Err("a frame was passed over".into()),
            }
        }
    }
}

/// Entities all over the grid, some near the ground and some high above it, and lines between them.
fn exercise(terrain: &v1::TerrainDescription) -> v1::ChangeExerciseRequest {
    let lines = (0..2 * ENTITIES).map(|n| line(n + 1, n % ENTITIES, (n * 5 + 3) % ENTITIES));
    v1::ChangeExerciseRequest {
        name: EXERCISE.into(),
        put_entities: (0..ENTITIES).map(|id| entity(terrain, id, id * 29)).collect(),
        put_sight_lines: lines.collect(),
        ..Default::default()
    }
}

/// Two entities move, a line goes, a line comes.
fn moves(terrain: &v1::TerrainDescription) -> v1::ChangeExerciseRequest {
    v1::ChangeExerciseRequest {
        name: EXERCISE.into(),
        remove_sight_lines: vec![2],
        put_entities: vec![entity(terrain, 0, 17), entity(terrain, 5, 61)],
        put_sight_lines: vec![line(100, 1, 7)],
        ..Default::default()
    }
}

fn entity(terrain: &v1::TerrainDescription, id: u64, place: u64) -> v1::Entity {
    let share = |n: u64, posts: u32| (n % 101) as f64 / 101.0 * f64::from(posts - 1);
    let relief_m = (terrain.max_height - terrain.min_height) * terrain.metres_per_height_unit;
    let z = 2.0 + relief_m * [0.0, 0.3, 0.1, 0.6][id as usize % 4];
    let position = v1::Position { x: share(place * 37, terrain.nx), y: share(place * 53 + 11, terrain.ny), z };
    v1::Entity {
        id,
        position: Some(position),
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        ground_m: if id % 3 == 1 { 0.2 } else { 0.0 },
    }
}

fn line(id: u64, a: u64, b: u64) -> v1::SightLine {
    let end = |entity_id| {
        let entity = v1::EntityAnchor { entity_id, height_offset_m: 1.5 };
        Some(v1::Anchor { anchor: Some(v1::anchor::Anchor::Entity(entity)) })
    };
    v1::SightLine { id, a: end(a), b: end(b), ..Default::default() }
}

fn settings(triangles: u32, lines: Option<Vec<u64>>) -> v1::ViewSettings {
    use v1::{subscription::Lines, view_settings};
    let camera = v1::Perspective { tan_half_fov: 0.5, near_m: 1.0 };
    v1::ViewSettings {
        projection: Some(view_settings::Projection::Perspective(camera)),
        viewport_width_px: 1280,
        viewport_height_px: 720,
        target: Some(view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: lines.map(|ids| v1::Subscription { lines: Some(Lines::List(v1::LineList { ids })) }),
        regions: Vec::new(),
    }
}

/// Along the diagonal of the grid, 30 degrees downward, turning by a twelfth of a turn in each of the poses.
fn pose(terrain: &v1::TerrainDescription, n: u32) -> v1::Pose {
    let share = 0.2 + 0.6 * f64::from(n) / f64::from(POSES);
    let up = terrain.max_height * terrain.metres_per_height_unit;
    let eye = v1::Position {
        x: share * f64::from(terrain.nx - 1) * terrain.metres_per_post_east,
        y: share * f64::from(terrain.ny - 1) * terrain.metres_per_post_north,
        z: up + 200.0,
    };
    // Straight down tilted up by 60 degrees about the east axis, then turned about the upward one.
    let ((sin_tilt, cos_tilt), (sin, cos)) =
        (30_f64.to_radians().sin_cos(), (15.0 * f64::from(n)).to_radians().sin_cos());
    let rotation = v1::Quaternion { x: cos * sin_tilt, y: sin * sin_tilt, z: sin * cos_tilt, w: cos * cos_tilt };
    v1::Pose { eye: Some(eye), rotation: Some(rotation) }
}
