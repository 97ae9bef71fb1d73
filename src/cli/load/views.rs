//! The views of a load: each a connection and a flight of its own.

use std::{collections::VecDeque, sync::Arc, time::Instant};

use prost::Message;
use sightline_client::{Client, Event, View, v1};
use tokio::time::{sleep_until, timeout_at};

use super::{
    super::{
        Failure, connect,
        generator::{NEAR_M, over_ground, pose},
        progress::Progress,
    },
    Args, GRACE,
    tally::{Schedule, Tally, since_us},
};
use crate::evaluate::flight::{Plan, Preset, Viewpoint};

/// What views fly, in turn.
const PRESETS: [Preset; 5] =
    [Preset::Straight, Preset::Orbit, Preset::Helicopter, Preset::Turn, Preset::TerrainAvoidance];
/// Longest flight in seconds; then the way back begins.
const LONGEST_FLIGHT_S: f64 = 60.0;
/// Most viewpoints of a flight.
const MAX_VIEWPOINTS: usize = 6_000;
/// Tangent of half the field of view.
const TAN_HALF_FOV: f64 = 0.577;
/// Width and height of the pictures that are not drawn.
const VIEWPORT_PX: [u32; 2] = [1_280, 720];

/// A view that is open, and where it is to fly.
pub(super) struct Flight {
    view: View,
    viewpoints: Vec<Viewpoint>,
    hz: f64,
}

/// Opens all views, one connection each.
pub(super) async fn open_all(
    args: &Args,
    client: &Client,
    extent_m: [f64; 2],
    exercise: &str,
    progress: &mut Progress,
) -> Result<Vec<Flight>, Failure> {
    let mut flights = Vec::new();
    for n in 0..args.views {
        progress.tell("opening", n.into(), args.views.into());
        let preset = PRESETS[n as usize % PRESETS.len()];
        let poses = (args.seconds.min(LONGEST_FLIGHT_S) * args.rate).ceil().max(2.0) as usize;
        let poses = poses.min(MAX_VIEWPOINTS);
        let seed = args.seed.wrapping_mul(1_000_003).wrapping_add(n.into());
        let plan = Plan::preset(preset, [[0.0; 2], extent_m], poses, args.rate, seed);
        let plan = plan.map_err(|error| Failure::Usage(error.to_string()))?;
        let viewpoints = over_ground(client, extent_m, &plan).await?;
        let own = connect::connect(&args.address).await?;
        let first = viewpoints.first().ok_or_else(|| Failure::Usage("a flight without viewpoints".into()))?;
        let view = own.open_view(exercise, settings(args.triangles), pose(first)).await.map_err(connect::failure)?;
        flights.push(Flight { view, viewpoints, hz: args.rate });
    }
    Ok(flights)
}

fn settings(triangles: u32) -> v1::ViewSettings {
    use v1::view_settings::{Projection, Target};
    v1::ViewSettings {
        projection: Some(Projection::Perspective(v1::Perspective { tan_half_fov: TAN_HALF_FOV, near_m: NEAR_M })),
        viewport_width_px: VIEWPORT_PX[0],
        viewport_height_px: VIEWPORT_PX[1],
        target: Some(Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: None,
        regions: Vec::new(),
    }
}

/// Viewpoint `k` of a flight of `n` that goes there and back again.
fn there_and_back(k: u64, n: usize) -> usize {
    let turn = 2 * (n as u64 - 1);
    let at = k % turn.max(1);
    at.min(turn - at) as usize
}

impl Flight {
    /// Flies until `end`, and waits for what is under way then.
    pub(super) async fn fly(mut self, begin: Instant, end: Instant, tally: Arc<Tally>) {
        if let Err(why) = self.try_fly(begin, end, &tally).await {
            tally.count().error(why);
        }
    }

    async fn try_fly(&mut self, begin: Instant, end: Instant, tally: &Tally) -> Result<(), String> {
        let mut schedule = Schedule::new(begin, self.hz, end);
        // Numbers of the poses that have no frame yet, and when they were due.
        let mut waiting = VecDeque::new();
        loop {
            let due = schedule.due();
            if due.is_none() && waiting.is_empty() {
                return Ok(());
            }
            let alarm = due.unwrap_or(end + GRACE);
            tokio::select! {
                event = self.view.next() => {
                    let event = event.map_err(|error| error.to_string())?.ok_or("the server has closed the view")?;
                    self.take(&event, &mut waiting, tally);
                }
                () = sleep_until(alarm.into()) => {
                    let Some(due) = due else {
                        return Err(format!("{} poses never got a frame", waiting.len()));
                    };
                    let viewpoint = &self.viewpoints[there_and_back(schedule.take(), self.viewpoints.len())];
                    let steered = timeout_at((end + GRACE).into(), self.view.steer(pose(viewpoint))).await;
                    let number = steered.map_err(|_| "the server takes no poses")?.map_err(|error| error.to_string())?;
                    waiting.push_back((number, due));
                    tally.count().poses += 1;
                }
            }
        }
    }

    fn take(&self, event: &Event, waiting: &mut VecDeque<(u64, Instant)>, tally: &Tally) {
        let frame = match event {
            Event::Frame(frame) => frame,
            Event::Lost(error) => return tally.count().error(error),
            Event::Exercise(_) | Event::Skipped => return,
        };
        let scene = self.view.scene();
        let (comparisons, silent) =
            if scene.lines().is_empty() { (0, 0) } else { (scene.lines().len(), scene.silent_disagreements().len()) };
        let mut counted = tally.count();
        counted.frames += 1;
        counted.bytes += frame.encoded_len() as u64;
        counted.frame_bytes.saturating_record(frame.encoded_len() as u64);
        counted.comparisons += comparisons as u64;
        counted.silent_disagreements += silent as u64;
        counted.named += scene.unsatisfied().len() as u64;
        while let Some(&(number, due)) = waiting.front().filter(|(number, _)| *number <= frame.pose_sequence) {
            counted.overtaken += u64::from(number < frame.pose_sequence);
            counted.frame_us.saturating_record(since_us(due));
            waiting.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_goes_there_and_back_without_a_jump() {
        let path: Vec<_> = (0..9).map(|k| there_and_back(k, 4)).collect();
        assert_eq!(path, [0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!((0..5).map(|k| there_and_back(k, 2)).collect::<Vec<_>>(), [0, 1, 0, 1, 0]);
        assert_eq!((0..3).map(|k| there_and_back(k, 1)).collect::<Vec<_>>(), [0, 0, 0]);
    }
}
