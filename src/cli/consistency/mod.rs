//! `sightline consistency`: do independent clients with different meshes agree with the terrain on every sight line?

mod director;
pub(super) mod map;
pub(super) mod plan;
pub(super) mod report;
pub(super) mod run;
pub(super) mod server;
pub(super) mod show;
pub(super) mod worker;

use std::{path::PathBuf, sync::Arc};

use super::{
    Context, Failure,
    args::{fidelity, refuse_existing},
    generator::{runtime, write},
};
use crate::{
    database::{Database, OpenOptions},
    evaluate::{
        agreement::MAX_SERVERS,
        flight::{MAX_FRAMES, PRESETS},
        sabotage::Sabotage,
        scenario::MAX_LINES,
    },
    roam::Fidelity,
};
use plan::{Changes, ClientPlan, Plan};
use run::Outcome;
use server::LocalServer;

/// Greatest number of clients of a test: each is a process.
const MAX_CLIENTS: usize = 64;
/// Vertical fields of view that clients take in turn: tangents of half the angle, 33 to 90 degrees.
const FIELDS_OF_VIEW: [f64; 4] = [0.5, 0.3, 1.0, 0.7];
/// Clients' pictures in pixels.
const VIEWPORT_PX: [u32; 2] = [1280, 720];

/// Compare what independent clients see on their own meshes with the exact terrain.
///
/// Clients are processes that get nothing but the bytes of a server. Exit status 1 when any of them disagrees in
/// silence with the finest terrain, or clients of different servers with each other.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// A database: servers are started on it. With addresses of servers (http://...) beside it, those are tested; the
    /// database must then hold the same terrain, for the exact verdicts. Clients take the servers in turn.
    #[arg(required = true, num_args = 1..=MAX_SERVERS + 1, value_name = "TARGET")]
    targets: Vec<String>,
    /// Servers to start, where no address is given.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = up_to::<MAX_SERVERS>)]
    servers: usize,
    /// Independent clients.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = up_to::<MAX_CLIENTS>)]
    clients: usize,
    /// Registered sight lines.
    #[arg(long, value_name = "M", default_value_t = 100, value_parser = up_to::<MAX_LINES>)]
    sight_lines: usize,
    /// Frames that each client asks for.
    #[arg(long, value_name = "F", default_value_t = 100, value_parser = up_to::<MAX_FRAMES>)]
    frames: usize,
    /// World, sight lines and flights follow from it.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Triangle budgets of the first and the last client; those between are spaced evenly by ratio.
    #[arg(long, value_name = "A..B", default_value = "1000..50000", value_parser = budgets)]
    budgets: [u32; 2],
    /// What every sight line asks of each mesh: verdict, obstruction:M (metres), wedgie or profile.
    #[arg(long, value_name = "F", default_value = "verdict", value_parser = fidelity)]
    fidelity: Fidelity,
    /// What changes while entities move and views fly: budgets, jumps (of views), lines (come and go), or all; with
    /// commas between.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_enum)]
    changes: Vec<ChangeName>,
    /// Draw a map of the last tick to this file: the sight lines, where plain meshes are wrong, and where triangles were
    /// spent so that they are not.
    #[arg(long, value_name = "F.png")]
    map: Option<PathBuf>,
    /// Write everything found as one JSON document ('-' for standard output).
    #[arg(short, value_name = "F.json")]
    output: Option<PathBuf>,
    /// Draw the last frame of each client, from its viewpoint and from above, into this folder.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Replace outputs that exist.
    #[arg(long)]
    force: bool,
    /// Falsify one thing in the last client, to see that the test notices.
    #[arg(long, value_enum, hide = true)]
    sabotage: Option<SabotageName>,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq, Eq, Debug)]
enum ChangeName {
    Budgets,
    Jumps,
    Lines,
    All,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum SabotageName {
    Height,
    Split,
    Epoch,
}

/// A number from 1 to `MOST`.
pub(super) fn up_to<const MOST: usize>(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if (1..=MOST).contains(&n) => Ok(n),
        _ => Err(format!("'{text}' is not a number from 1 to {MOST}")),
    }
}

fn budgets(text: &str) -> Result<[u32; 2], String> {
    let wrong = || format!("'{text}' is not A..B, two numbers of at least 2 in ascending order");
    let (a, b) = text.split_once("..").ok_or_else(wrong)?;
    match (a.parse(), b.parse()) {
        (Ok(a), Ok(b)) if 2 <= a && a <= b => Ok([a, b]),
        _ => Err(wrong()),
    }
}

/// The budget of client `n` of `clients`: evenly spaced by ratio, to two figures.
fn budget_of([first, last]: [u32; 2], n: usize, clients: usize) -> u32 {
    if n == 0 {
        return first;
    }
    if n + 1 == clients {
        return last;
    }
    let share = n as f64 / (clients - 1) as f64;
    let exact = f64::from(first) * (f64::from(last) / f64::from(first)).powf(share);
    let mut step = 1_u32;
    while exact >= 100.0 * f64::from(step) {
        step *= 10;
    }
    // Two figures: the last bits of the power, which differ between machines, do not reach the budget.
    ((exact / f64::from(step)).round() as u32 * step).clamp(first, last)
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let (path, addresses) = self.split_targets()?;
        for path in [&self.map, &self.output].into_iter().flatten().filter(|p| p.as_os_str() != "-") {
            refuse_existing(path, self.force)?;
        }
        if let Some(directory) = &self.pictures {
            std::fs::create_dir_all(directory)
                .map_err(|e| Failure::environment(format!("making {}", directory.display()), e))?;
        }
        // Each server opens the database for itself, as servers on several machines would.
        let open = || {
            let opened = Database::open(&path, OpenOptions::default());
            opened.map(Arc::new).map_err(|e| Failure::input(path.display(), e))
        };
        let (database, runtime) = (open()?, runtime()?);
        let mut servers = Vec::new();
        for _ in 0..if addresses.is_empty() { self.servers } else { 0 } {
            let started = LocalServer::start(&runtime, open()?, None);
            servers.push(started.map_err(|e| Failure::environment("starting a server on loopback", e))?);
        }
        let addresses =
            if addresses.is_empty() { servers.iter().map(LocalServer::address).collect() } else { addresses };
        let plan = self.plan();
        let mut show = show::Show::new(context, &plan);
        let outcome = run::run(&runtime, &database, &addresses, &plan, &mut |happening| show.tell(&happening));
        show.finish();
        let outcome = outcome?;
        self.tell(context, &plan, &outcome, &database)?;
        servers.into_iter().try_for_each(|server| server.stop(&runtime))?;
        verdict(&outcome)
    }

    /// The database and the servers to be tested, if any are given.
    fn split_targets(&self) -> Result<(PathBuf, Vec<String>), Failure> {
        let (servers, databases): (Vec<_>, Vec<_>) = self.targets.iter().cloned().partition(|t| t.contains("://"));
        match (&databases[..], &servers[..]) {
            ([database], servers) if servers.len() <= MAX_SERVERS => Ok((PathBuf::from(database), servers.to_vec())),
            ([], _) => Err(Failure::Usage(
                "the exact verdicts need the terrain: give its database beside the address of the server".into(),
            )),
            _ => Err(Failure::Usage(format!("give one database, and at most {MAX_SERVERS} addresses of servers"))),
        }
    }

    fn plan(&self) -> Plan {
        let client = |n: usize| ClientPlan {
            name: format!("client-{}", n + 1),
            triangles: budget_of(self.budgets, n, self.clients),
            tan_half_fov: FIELDS_OF_VIEW[n % FIELDS_OF_VIEW.len()],
            preset: PRESETS[n % PRESETS.len()],
        };
        Plan {
            exercise: format!("consistency-{}-{}", self.seed, std::process::id()),
            clients: (0..self.clients).map(client).collect(),
            sight_lines: self.sight_lines,
            frames: self.frames,
            seed: self.seed,
            fidelity: self.fidelity,
            viewport_px: VIEWPORT_PX,
            changes: self.changes(),
            wants_meshes: self.map.is_some(),
            sabotage: self.sabotage.map(|kind| {
                let kind = match kind {
                    SabotageName::Height => Sabotage::Height,
                    SabotageName::Split => Sabotage::Split,
                    SabotageName::Epoch => Sabotage::Epoch,
                };
                (self.clients - 1, kind)
            }),
            pictures: self.pictures.clone(),
            keep_exercise: false,
        }
    }

    fn changes(&self) -> Changes {
        let changes = |name| self.changes.contains(&name) || self.changes.contains(&ChangeName::All);
        Changes {
            budgets: changes(ChangeName::Budgets),
            jumps: changes(ChangeName::Jumps),
            lines: changes(ChangeName::Lines),
        }
    }

    fn tell(&self, context: &Context, plan: &Plan, outcome: &Outcome, database: &Database) -> Result<(), Failure> {
        let document = report::document(plan, outcome, database);
        let to_stdout = context.json || self.output.as_ref().is_some_and(|p| p.as_os_str() == "-");
        if to_stdout {
            outln!("{document:#}");
        } else {
            out!("{}", report::table(plan, outcome));
            outln!("{:.1} s", outcome.seconds);
        }
        if let Some(path) = self.output.as_ref().filter(|p| p.as_os_str() != "-") {
            write(path, format!("{document:#}\n").as_bytes())?;
        }
        if let Some(path) = &self.map {
            let picture = map::map(plan, outcome, database)?;
            write(path, &picture.png().map_err(|e| Failure::environment(path.display(), e))?)?;
        }
        Ok(())
    }
}

/// Whether the run found something.
pub(super) fn verdict(outcome: &Outcome) -> Result<(), Failure> {
    let total = outcome.comparison.total();
    match report::findings(outcome) {
        0 if total.frames == 0 => Err(Failure::Found("no frame was delivered: nothing was compared".into())),
        0 => Ok(()),
        findings => Err(Failure::Found(format!(
            "{} silent disagreements, {} other findings",
            total.silent_disagreements,
            findings - total.silent_disagreements
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_parsed_and_spaced_by_ratio() {
        assert_eq!(budgets("1000..50000"), Ok([1000, 50000]));
        for bad in ["1000", "5..3", "1..9", "a..b", "1000..50000..6"] {
            assert!(budgets(bad).is_err(), "{bad}");
        }
        let spaced: Vec<_> = (0..4).map(|n| budget_of([1000, 50_000], n, 4)).collect();
        assert_eq!(spaced, [1000, 3700, 14_000, 50_000]);
        assert_eq!(budget_of([7, 7], 1, 3), 7);
        assert_eq!(budget_of([1000, 50_000], 0, 1), 1000);
    }
}
