//! Lines of sight asked one by one, each when it is due.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use sightline_client::{Client, v1};
use tokio::{
    sync::Semaphore,
    time::{sleep_until, timeout},
};

use super::{
    GRACE,
    tally::{Schedule, Tally, since_us},
};
use crate::evaluate::dice::Dice;

/// Questions under way at the same time; one more waits, and its latency counts all the same.
const MAX_UNDER_WAY: u32 = 1_000;
/// Longest line in metres.
const LONGEST_M: f64 = 10_000.0;
/// Height of both ends above the ground in metres.
const HEIGHT_M: f64 = 2.0;
/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(30);

/// Asks `hz` lines a second from `begin` to `end`.
pub(super) async fn ask(
    client: Client,
    extent_m: [f64; 2],
    hz: f64,
    seed: u64,
    begin: Instant,
    end: Instant,
    tally: Arc<Tally>,
) {
    let mut dice = Dice::new(seed ^ 0x004c_4f53);
    let mut schedule = Schedule::new(begin, hz, end);
    let places = Arc::new(Semaphore::new(MAX_UNDER_WAY as usize));
    while let Some(due) = schedule.due() {
        sleep_until(due.into()).await;
        schedule.take();
        let line = line(&mut dice, extent_m);
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        let (client, tally) = (client.clone(), Arc::clone(&tally));
        tokio::spawn(async move {
            let answer = timeout(PATIENCE, client.query(line)).await;
            let took_us = since_us(due);
            drop(place);
            let mut counted = tally.count();
            match answer {
                Ok(Ok(answer)) if answer.verdict() != v1::Verdict::Unspecified => {
                    counted.queries += 1;
                    counted.query_us.saturating_record(took_us);
                }
                Ok(Ok(_)) => counted.error("an answer without a verdict"),
                Ok(Err(error)) => counted.error(error),
                Err(_) => counted.error("a line of sight was not answered"),
            }
        });
    }
    // All places are free when all are answered; each has its own patience.
    let _ = timeout(PATIENCE + GRACE, places.acquire_many(MAX_UNDER_WAY)).await;
}

/// A line of up to [`LONGEST_M`] somewhere on the terrain.
fn line(dice: &mut Dice, extent_m: [f64; 2]) -> v1::QueryLineOfSightRequest {
    let from = dice.place([[0.0; 2], extent_m], 0.0);
    let (heading, length_m) = (dice.heading(), LONGEST_M * dice.fraction());
    let to = [0, 1].map(|k| (from[k] + heading[k] * length_m).clamp(0.0, extent_m[k]));
    let end = |[x, y]: [f64; 2]| {
        let position = Some(v1::Position { x, y, z: HEIGHT_M });
        let (frame, altitude) = (v1::CoordinateFrame::Scene.into(), v1::AltitudeReference::AboveGround.into());
        Some(v1::SightLineEnd { position, frame, altitude })
    };
    v1::QueryLineOfSightRequest { a: end(from), b: end(to), ..Default::default() }
}
