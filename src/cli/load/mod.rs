//! `sightline load`: many clients at once against a server, and how long each of them waits.
//!
//! The load is open: every pose and every question is due at a time that was fixed before, and its latency counts from
//! then, whether or not those before it were answered. So a server that falls behind cannot make its numbers better by
//! being asked less (no coordinated omission). What goes wrong is an error and never a frame.

mod queries;
mod tally;
mod views;
mod world;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use serde_json::json;

use self::tally::{Counted, Spread, Tally};
use super::{
    Context, Failure, connect,
    generator::{extent_m, runtime},
    progress::Progress,
};

/// How long what is under way at the end may take.
const GRACE: Duration = Duration::from_secs(5);
/// How long after its beginning everything is due: all have connected by then.
const LEAD: Duration = Duration::from_millis(200);

/// Put a server under load: views on flights of their own, each checking every frame, and queries beside them.
///
/// Each view has its own connection and flies there and back over up to a minute of its flight. A frame's latency is the
/// time from when its pose was due until it was decoded and its hash checked; a pose that a newer one overtook waits for
/// the newer one's frame. Exit status 1 when anything went wrong.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct Args {
    /// Address of the server.
    #[arg(value_name = "ADDR")]
    address: String,
    /// Number of views.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    views: u32,
    /// Triangle budget of each.
    #[arg(long, value_name = "N", default_value_t = 3_000)]
    triangles: u32,
    /// Poses a second of each view.
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = rate)]
    rate: f64,
    /// How long, in seconds.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Lines of sight asked one by one in a second, beside the views.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    los: Option<f64>,
    /// Sight lines of an exercise whose entities move five times a second, and which all views follow.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=20_000))]
    sight_lines: u32,
    /// Chooses flights, entities and lines.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hz) if hz > 0.0 && hz <= 1e5 => Ok(hz),
        _ => Err(format!("'{text}' is not a number of times a second, above 0 and up to 100000")),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if s > 0.0 && s <= 1e6 => Ok(s),
        _ => Err(format!("'{text}' is not a number of seconds, above 0 and up to 1000000")),
    }
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let mut progress = Progress::new(context, "poses");
        let counted = runtime()?.block_on(self.drive(&mut progress));
        progress.finish();
        let counted = counted?;
        let report = self.report(&counted);
        if context.json {
            outln!("{:#}", self.document(&report, &counted))
        } else {
            self.tell(&report, &counted)
        }
        for error in &counted.first_errors {
            errln!("{error}");
        }
        match counted.errors + counted.silent_disagreements {
            0 => Ok(()),
            _ => Err(Failure::Found(format!(
                "{} errors, {} silent disagreements on sight lines",
                counted.errors, counted.silent_disagreements
            ))),
        }
    }

    async fn drive(&self, progress: &mut Progress) -> Result<Counted, Failure> {
        let client = connect::connect(&self.address).await?;
        let terrain = client.terrain().await.map_err(connect::failure)?;
        let world = match self.sight_lines {
            0 => None,
            lines => Some(world::World::make(&client, extent_m(&terrain), lines, self.seed).await?),
        };
        let driven = self.drive_in(&client, extent_m(&terrain), world.as_ref(), progress).await;
        // Whatever came of it: nothing is left behind.
        if let Some(world) = world {
            world.delete(&client).await?;
        }
        driven
    }

    async fn drive_in(
        &self,
        client: &sightline_client::Client,
        extent_m: [f64; 2],
        world: Option<&world::World>,
        progress: &mut Progress,
    ) -> Result<Counted, Failure> {
        let exercise = world.map_or("", |world| &world.name);
        let flights = views::open_all(self, client, extent_m, exercise, progress).await?;
        let tally = Arc::new(Tally::default());
        let begin = Instant::now() + LEAD;
        let end = begin + Duration::from_secs_f64(self.seconds);
        let mut tasks = tokio::task::JoinSet::new();
        for (n, flight) in flights.into_iter().enumerate() {
            // Clients do not beat in time: their poses are spread over the period.
            let late = n as f64 / f64::from(self.views.max(1)) / self.rate;
            tasks.spawn(flight.fly(begin + Duration::from_secs_f64(late), end, Arc::clone(&tally)));
        }
        if let Some(hz) = self.los {
            tasks.spawn(queries::ask(client.clone(), extent_m, hz, self.seed, begin, end, Arc::clone(&tally)));
        }
        if let Some(world) = world {
            tasks.spawn(world.mover(client.clone()).run(begin, end, Arc::clone(&tally)));
        }
        let total = (f64::from(self.views) * self.rate * self.seconds) as u64;
        progress.tell("flying", 0, total);
        let mut clock = tokio::time::interval(Duration::from_millis(500));
        loop {
            tokio::select! {
                ended = tasks.join_next() => match ended {
                    None => return Ok(tally.take()),
                    Some(Ok(())) => {}
                    Some(Err(error)) => return Err(Failure::Environment(format!("a client ended: {error}"))),
                },
                _ = clock.tick() => progress.at(tally.poses(), total),
            }
        }
    }

    fn report(&self, counted: &Counted) -> Report {
        Report {
            frames: Spread::of(&counted.frame_us),
            queries: Spread::of(&counted.query_us),
            frames_per_s: counted.frames as f64 / self.seconds,
            late: counted.frame_us.count_between((1e6 / self.rate) as u64 + 1, u64::MAX),
        }
    }

    fn document(&self, report: &Report, counted: &Counted) -> serde_json::Value {
        json!({
            "views": self.views, "triangles": self.triangles, "rate_hz": self.rate, "seconds": self.seconds,
            "sight_lines": self.sight_lines, "los_hz": self.los, "seed": self.seed,
            "poses": counted.poses, "frames": counted.frames, "frames_per_s": report.frames_per_s,
            "overtaken_poses": counted.overtaken, "late_poses": report.late, "frame_latency_ms": report.frames,
            "bytes": counted.bytes, "median_frame_bytes": counted.frame_bytes.value_at_quantile(0.5),
            "queries": counted.queries, "query_latency_ms": report.queries, "changes": counted.changes,
            "comparisons": counted.comparisons, "named": counted.named,
            "silent_disagreements": counted.silent_disagreements,
            "errors": counted.errors, "first_errors": counted.first_errors,
        })
    }

    fn tell(&self, report: &Report, counted: &Counted) {
        outln!("{} views of {} triangles at {} Hz for {} s", self.views, self.triangles, self.rate, self.seconds);
        outln!("                p50      p90      p99    p99.9      max  ms");
        outln!("frame      {}", report.frames);
        if self.los.is_some() {
            outln!("query      {}", report.queries);
        }
        outln!(
            "{} poses, {} frames ({:.1} a second), {} poses overtaken by newer ones, {} later than a period",
            counted.poses,
            counted.frames,
            report.frames_per_s,
            counted.overtaken,
            report.late
        );
        outln!("{} bytes of frames, {} in the median frame", counted.bytes, counted.frame_bytes.value_at_quantile(0.5));
        if self.los.is_some() {
            outln!("{} queries answered", counted.queries);
        }
        if self.sight_lines > 0 {
            outln!(
                "{} changes of the exercise, {} verdicts compared, {} times a line was named, {} silent disagreements",
                counted.changes,
                counted.comparisons,
                counted.named,
                counted.silent_disagreements
            );
        }
        outln!("{} errors", counted.errors);
    }
}

/// What the counts come to.
struct Report {
    frames: Spread,
    queries: Spread,
    frames_per_s: f64,
    /// Poses whose frame came later than the next pose was due.
    late: u64,
}
