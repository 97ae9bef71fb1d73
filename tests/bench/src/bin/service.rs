//! Lines of sight over loopback gRPC beside the same lines asked in this process: the share of the batch rate that is
//! left, and how long single questions wait at half the greatest rate. All verdicts are compared.
//!
//! A server at half its peak has no room for a machine that slows down: shared machines have spans of 10 to 100 ms in which
//! the same loads take five times as long on all cores, and questions pile up. So a fixed piece of work is timed beside the
//! questions, and the waits of the tenths of a second in which it took longer than usual, and of those after them, are told
//! apart.
//!
//! `service DATABASE ADDR [--seconds S]`: the server runs on the same database with one compute thread, best on a core of
//! its own: `taskset -c 0 sightline serve DATABASE --threads 1`, then `taskset -c 1 service DATABASE 127.0.0.1:7410`.
//! Without ADDR a server is started in this process, which has one compute thread for all then.

use std::{
    error::Error,
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use hdrhistogram::Histogram;
use sightline::{
    database::{Database, OpenOptions},
    los::{self, Options, Verdict},
    service,
    terrain::{HeightField, synthetic},
};
use sightline_client::{Client, v1};
use tokio::{
    net::TcpListener,
    runtime::Runtime,
    sync::{Semaphore, mpsc},
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;
type Line = [[f64; 3]; 2];

const BATCH_LINES: usize = 1_000;
const IN_FLIGHT: usize = 8;
/// Single questions under way when the greatest rate is sought.
const SINGLE_IN_FLIGHT: usize = 64;
/// Waits are told apart by windows of this length.
const WINDOW_S: f64 = 0.1;
/// How often the fixed piece of work is timed, what it is, and how much longer than in the median window it takes in one
/// that is slowed.
const PROBE_EVERY: Duration = Duration::from_millis(1);
const PROBE_LOADS: u32 = 64;
const PROBE_CELLS: u64 = 4 << 20;
const SLOWED: f64 = 1.3;
/// Ends stand so many metres above the ground.
const ABOVE_M: f64 = 2.0;
/// Lines that are drawn of each kind.
const LINES: usize = 64_000;
/// Each rate is the best of so many rounds, the two ways in turn.
const ROUNDS: usize = 5;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("the path of a database, please")?;
    let (mut address, mut seconds) = (None, 5.0);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--seconds" => seconds = arguments.next().ok_or("--seconds needs a value")?.parse()?,
            _ => address = Some(argument),
        }
    }
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let database = Arc::new(Database::open(Path::new(&path), OpenOptions::default())?);
    let runtime = Runtime::new()?;
    let address = match address {
        Some(address) => address,
        None => runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await?;
            let address = listener.local_addr()?.to_string();
            tokio::spawn(service::serve(listener, Arc::clone(&database), std::future::pending()));
            Ok::<_, std::io::Error>(address)
        })?,
    };
    let client = runtime.block_on(Client::connect(&address))?;
    for (name, reach_m) in [("up to 1 km", 1e3), ("up to 10 km", 1e4), ("across the map", f64::INFINITY)] {
        let lines = draw(&database, reach_m)?;
        let mut best = [0.0_f64; 2];
        for _ in 0..ROUNDS {
            let (own, own_rate) = in_process(&database, &lines)?;
            let (told, told_rate) = runtime.block_on(over_grpc(&client, &lines))?;
            assert_eq!(own, told, "the same verdicts");
            best = [best[0].max(own_rate), best[1].max(told_rate)];
        }
        let [own, told] = best;
        println!(
            "batches of {BATCH_LINES}, {name}: in process {:.3} M lines/s, over gRPC {:.3}, {:.1} %",
            1e-6 * own,
            1e-6 * told,
            100.0 * told / own
        );
    }
    let lines: Arc<[Line]> = draw(&database, 1e4)?.into();
    let peak = runtime.block_on(peak(&client, &lines, seconds))?;
    println!(
        "single questions up to 10 km: {peak:.0} a second at most ({SINGLE_IN_FLIGHT} under way); at half of that,"
    );
    let windows = runtime.block_on(at_rate(&client, &lines, 0.5 * peak, seconds))?;
    let slowed = slowed(&windows);
    let share = |wanted| slowed.iter().filter(|&&is| is == wanted).count() as f64 / slowed.len() as f64;
    for (name, wanted) in [("all the time", None), ("at the usual speed", Some(false)), ("slowed", Some(true))] {
        let mut waits = Histogram::<u64>::new(3)?;
        for (window, _) in windows.iter().zip(&slowed).filter(|(_, is)| wanted.is_none_or(|wanted| wanted == **is)) {
            waits.add(&window.waits)?;
        }
        let ms = |quantile| waits.value_at_quantile(quantile) as f64 * 1e-3;
        println!(
            "  {name} ({:.0} % of it): p50 {:.3} ms, p99 {:.3}, p99.9 {:.3} from when each was due",
            100.0 * wanted.map_or(1.0, share),
            ms(0.5),
            ms(0.99),
            ms(0.999)
        );
    }
    Ok(())
}

/// Lines between points above known ground, in the grid frame.
fn draw(field: &Database, reach_m: f64) -> Result<Vec<Line>> {
    let (grid, scale) = (HeightField::grid(field), field.scale());
    let far = [f64::from(grid.nx() - 1), f64::from(grid.ny() - 1)];
    let unit = |n: u64| (synthetic::mix(n) >> 11) as f64 / (1_u64 << 53) as f64;
    let mut lines = Vec::new();
    for n in 0.. {
        if lines.len() == LINES {
            break;
        }
        let from = [unit(4 * n) * far[0], unit(4 * n + 1) * far[1]];
        let at = [unit(4 * n + 2), unit(4 * n + 3)];
        let reach = [reach_m / scale.east_m, reach_m / scale.north_m];
        let to = [0, 1]
            .map(|k| if reach[k].is_finite() { from[k] + reach[k] * (2.0 * at[k] - 1.0) } else { at[k] * far[k] });
        let end = |[x, y]: [f64; 2]| {
            Ok::<_, los::LosError>(los::on_ground(field, x, y, ABOVE_M / scale.up_m)?.map(|z| [x, y, z]))
        };
        if let (Some(a), Some(b)) = (end(from)?, end(to)?) {
            lines.push([a, b]);
        }
    }
    Ok(lines)
}

/// Verdicts and lines a second, by batches of the library.
fn in_process(database: &Database, lines: &[Line]) -> Result<(Vec<v1::Verdict>, f64)> {
    let (mut verdicts, began) = (Vec::new(), Instant::now());
    for batch in lines.chunks(BATCH_LINES) {
        let answers = los::line_of_sight_batch(database, batch, Options::default())?;
        verdicts.extend(answers.iter().map(|answer| match answer.verdict {
            Verdict::Visible => v1::Verdict::Visible,
            Verdict::Blocked => v1::Verdict::Blocked,
            Verdict::Unknown => v1::Verdict::Unknown,
        }));
    }
    Ok((verdicts, lines.len() as f64 / began.elapsed().as_secs_f64()))
}

fn request(batch: &[Line]) -> v1::QueryLineOfSightBatchRequest {
    let column = |end: usize, axis: usize| batch.iter().map(|line| line[end][axis]).collect();
    v1::QueryLineOfSightBatchRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        ax: column(0, 0),
        ay: column(0, 1),
        az: column(0, 2),
        bx: column(1, 0),
        by: column(1, 1),
        bz: column(1, 2),
        ..Default::default()
    }
}

/// The same over gRPC, so many batches under way.
async fn over_grpc(client: &Client, lines: &[Line]) -> Result<(Vec<v1::Verdict>, f64)> {
    let requests: Vec<_> = lines.chunks(BATCH_LINES).map(request).collect();
    let places = Arc::new(Semaphore::new(IN_FLIGHT));
    let (mut tasks, began) = (Vec::new(), Instant::now());
    for request in requests {
        let place = Arc::clone(&places).acquire_owned().await?;
        let client = client.clone();
        tasks.push(tokio::spawn(async move {
            let answers = client.query_batch(request).await;
            drop(place);
            answers
        }));
    }
    let mut verdicts = Vec::new();
    for task in tasks {
        verdicts.extend(task.await??.verdicts);
    }
    Ok((verdicts, lines.len() as f64 / began.elapsed().as_secs_f64()))
}

fn question([a, b]: Line) -> v1::QueryLineOfSightRequest {
    let end = |[x, y, z]: [f64; 3]| {
        let (frame, altitude) = (v1::CoordinateFrame::Grid.into(), v1::AltitudeReference::Absolute.into());
        Some(v1::SightLineEnd { position: Some(v1::Position { x, y, z }), frame, altitude })
    };
    v1::QueryLineOfSightRequest { a: end(a), b: end(b), ..Default::default() }
}

/// Single questions a second with always the same number under way.
async fn peak(client: &Client, lines: &Arc<[Line]>, seconds: f64) -> Result<f64> {
    let began = Instant::now();
    let until = began + Duration::from_secs_f64(seconds);
    let mut tasks = Vec::new();
    for n in 0..SINGLE_IN_FLIGHT {
        let (client, lines) = (client.clone(), Arc::clone(lines));
        tasks.push(tokio::spawn(async move {
            let mut asked = 0_u64;
            for line in lines.iter().cycle().skip(n * 997) {
                if Instant::now() >= until {
                    break;
                }
                client.query(question(*line)).await?;
                asked += 1;
            }
            Ok::<_, sightline_client::ClientError>(asked)
        }));
    }
    let mut asked = 0;
    for task in tasks {
        asked += task.await??;
    }
    Ok(asked as f64 / began.elapsed().as_secs_f64())
}

/// A tenth of a second of questions.
struct Window {
    /// How long answers took, in microseconds from when each question was due.
    waits: Histogram<u64>,
    /// How long the fixed piece of work took, all times together.
    probes: Duration,
    /// How many times it was done.
    probed: u32,
}

/// The windows in which the machine was slower than usual, and those after them, when what piled up is answered.
fn slowed(windows: &[Window]) -> Vec<bool> {
    let took: Vec<_> = windows.iter().map(|w| w.probes.as_secs_f64() / f64::from(w.probed.max(1))).collect();
    let mut sorted = took.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[sorted.len() / 2];
    let is_slow = |n: usize| took[n] > SLOWED * usual || windows[n].probed == 0;
    (0..windows.len()).map(|n| is_slow(n) || n > 0 && is_slow(n - 1)).collect()
}

/// A fixed piece of work: loads that wait for one another, over more memory than a core's own caches hold.
struct Probe {
    cells: Vec<u32>,
    at: u64,
}

impl Probe {
    fn new() -> Self {
        Self { cells: (0..PROBE_CELLS).map(|n| synthetic::mix(n) as u32).collect(), at: 1 }
    }

    fn took(&mut self) -> Duration {
        let began = Instant::now();
        for _ in 0..PROBE_LOADS {
            self.at = synthetic::mix(self.at + u64::from(self.cells[(self.at % PROBE_CELLS) as usize]));
        }
        began.elapsed()
    }
}

/// Asks at a steady rate, for whole windows. A question that has been answered is kept nowhere: ten thousand a second of
/// them would fill memory, and its pages would be what is measured.
async fn at_rate(client: &Client, lines: &Arc<[Line]>, hz: f64, seconds: f64) -> Result<Vec<Window>> {
    // What is left over from before, here and in the scheduler, has ended then.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (client, lines) = (client.clone(), Arc::clone(lines));
    let in_window = (hz * WINDOW_S).ceil() as usize;
    let count = (seconds / WINDOW_S).ceil().max(1.0) as usize;
    let (teller, mut told) = mpsc::unbounded_channel();
    let asking = tokio::spawn(async move {
        let mut probe = Probe::new();
        let mut probes = vec![(Duration::ZERO, 0_u32); count];
        let (began, mut next_probe) = (Instant::now(), Instant::now());
        for n in 0..in_window * count {
            let due = began + Duration::from_secs_f64(n as f64 / hz);
            // A timer's millisecond is too coarse.
            while Instant::now() < due {
                tokio::task::yield_now().await;
            }
            let (client, line, teller) = (client.clone(), lines[n % lines.len()], teller.clone());
            tokio::spawn(async move {
                let answer = client.query(question(line)).await.map(|_| due.elapsed());
                let _ = teller.send((n / in_window, answer));
            });
            if Instant::now() >= next_probe {
                let (sum, times) = &mut probes[n / in_window];
                (*sum, *times) = (*sum + probe.took(), *times + 1);
                next_probe = Instant::now() + PROBE_EVERY;
            }
        }
        probes
    });
    let mut waits = vec![Histogram::new(3)?; count];
    while let Some((window, wait)) = told.recv().await {
        waits[window].record(wait?.as_micros() as u64)?;
    }
    if waits.iter().any(|waits| waits.len() != in_window as u64) {
        return Err("questions without an answer".into());
    }
    let windows = waits.into_iter().zip(asking.await?);
    Ok(windows.map(|(waits, (probes, probed))| Window { waits, probes, probed }).collect())
}
