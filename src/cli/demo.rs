//! `sightline demo`: everything at once, on real ground, from one command.
//!
//! The elevation model is built in (see `demo/PROVENANCE.md`). It is ingested, served on loopback, and flown over by
//! three scene generators, processes of their own, with 50 sight lines between them: a small consistency test.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use super::{
    Context, Failure,
    consistency::{
        map,
        plan::{Changes, ClientPlan, Plan},
        report,
        run::{self, Outcome},
        server::LocalServer,
        show::Show,
        up_to, verdict,
    },
    generator::{runtime, write},
};
use crate::{
    database::{self, Database, IngestOptions, OpenOptions},
    dem,
    evaluate::flight::{MAX_FRAMES, Preset},
    roam::Fidelity,
};

/// Elevation around the Jacksboro Fault, Tennessee.
pub(super) const ELEVATION: &[u8] = include_bytes!("demo/jacksboro.tif");
/// Where the server listens unless that is taken.
const PORT: u16 = 7410;
/// Name of the exercise on the server.
const EXERCISE: &str = "demo";
/// Sight lines.
const SIGHT_LINES: usize = 50;
/// Frames of each scene generator.
const FRAMES: usize = 120;

/// See it work: real terrain, a server, three scene generators, and sight lines on which all of them agree.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// Stop when the results are there, instead of serving until Ctrl-C.
    #[arg(long)]
    exit: bool,
    /// Where the server listens [default: 127.0.0.1:7410, or any free port if that is taken].
    #[arg(long, value_name = "ADDR")]
    listen: Option<SocketAddr>,
    /// Folder for the database and the pictures.
    #[arg(short, value_name = "DIR", default_value = "sightline-demo")]
    output: PathBuf,
    /// Frames of each scene generator.
    #[arg(long, hide = true, value_name = "F", default_value_t = FRAMES, value_parser = up_to::<MAX_FRAMES>)]
    frames: usize,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let started = Instant::now();
        let remark = |text: String| {
            if !context.quiet {
                errln!("{text}");
            }
        };
        std::fs::create_dir_all(&self.output)
            .map_err(|e| Failure::environment(format!("making {}", self.output.display()), e))?;
        let database = ingest(&self.output)?;
        let grid = database.grid();
        remark(format!("ingested {} x {} posts around the Jacksboro Fault, Tennessee", grid.nx(), grid.ny()));
        let runtime = runtime()?;
        let server = self.serve(&runtime, &database, &remark)?;
        remark(format!("serving at {}", server.address()));
        let plan = plan(&self.output, self.frames);
        let mut show = Show::new(context, &plan);
        let outcome = run::run(&runtime, &database, &[server.address()], &plan, &mut |h| show.tell(&h));
        show.finish();
        let outcome = outcome?;
        let map = self.output.join("sight-lines.png");
        let picture = map::map(&plan, &outcome, &database)?;
        write(&map, &picture.png().map_err(|e| Failure::environment(map.display(), e))?)?;
        self.tell(context, &plan, &outcome, &database, &server.address(), started.elapsed().as_secs_f64());
        if !self.exit {
            remark(format!("serving until Ctrl-C: open {}/?exercise={EXERCISE} in a browser", server.address()));
            runtime.block_on(tokio::signal::ctrl_c()).map_err(|e| Failure::environment("waiting for Ctrl-C", e))?;
        }
        server.stop(&runtime)?;
        verdict(&outcome)
    }

    /// Starts the server; a taken default port means another one.
    fn serve(
        &self,
        runtime: &tokio::runtime::Runtime,
        database: &Arc<Database>,
        remark: &dyn Fn(String),
    ) -> Result<LocalServer, Failure> {
        let wanted = self.listen.unwrap_or(SocketAddr::from((Ipv4Addr::LOCALHOST, PORT)));
        match LocalServer::start(runtime, Arc::clone(database), Some(wanted)) {
            Ok(server) => return Ok(server),
            Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
                remark(format!("{wanted} is taken: another port is used"));
            }
            Err(error) => return Err(Failure::environment(format!("listening on {wanted}"), error)),
        }
        let any = SocketAddr::new(wanted.ip(), 0);
        LocalServer::start(runtime, Arc::clone(database), Some(any))
            .map_err(|e| Failure::environment(format!("listening on {any}"), e))
    }

    fn tell(
        &self,
        context: &Context,
        plan: &Plan,
        outcome: &Outcome,
        database: &Database,
        address: &str,
        seconds: f64,
    ) {
        if context.json {
            let mut document = report::document(plan, outcome, database);
            document["address"] = address.into();
            document["pictures"] = self.output.display().to_string().into();
            outln!("{document:#}");
            return;
        }
        out!("{}", report::table(plan, outcome));
        outln!("{seconds:.1} s from start to result; pictures are in {}:", self.output.display());
        for client in &plan.clients {
            let last = plan.frames - 1;
            outln!("  {0}-{last:04}-view.png, {0}-{last:04}-above.png", client.name);
        }
        outln!("  sight-lines.png");
        outln!(
            "try: sightline view {address} -o {} --exercise {EXERCISE} --flight orbit",
            self.output.join("mine").display()
        );
    }
}

/// Ingests the built-in elevation into a database in `folder`, replacing an earlier one.
fn ingest(folder: &Path) -> Result<Arc<Database>, Failure> {
    let (source, target) = (folder.join("jacksboro.tif"), folder.join("jacksboro.sightline"));
    write(&source, ELEVATION)?;
    let failed = |e: &dyn std::fmt::Display| Failure::environment("ingesting the built-in elevation model", e);
    let mut raster =
        dem::open(std::slice::from_ref(&source), &dem::OpenOptions::default(), &mut |_| {}).map_err(|e| failed(&e))?;
    let options = IngestOptions { replace: true, sources: vec!["jacksboro.tif".into()], ..IngestOptions::default() };
    database::ingest(&mut *raster, &target, &options, &mut |_| {}).map_err(|e| failed(&e))?;
    Ok(Arc::new(Database::open(&target, OpenOptions::default()).map_err(|e| failed(&e))?))
}

fn plan(folder: &Path, frames: usize) -> Plan {
    let client =
        |name: &str, triangles, tan_half_fov, preset| ClientPlan { name: name.into(), triangles, tan_half_fov, preset };
    Plan {
        exercise: EXERCISE.into(),
        clients: vec![
            client("jet", 2_000, 0.5, Preset::Straight),
            client("drone", 5_000, 0.4, Preset::Orbit),
            client("helicopter", 15_000, 0.7, Preset::Helicopter),
        ],
        sight_lines: SIGHT_LINES,
        frames,
        seed: 1,
        fidelity: Fidelity::Verdict,
        viewport_px: [1280, 720],
        changes: Changes::default(),
        wants_meshes: true,
        sabotage: None,
        pictures: Some(folder.into()),
        keep_exercise: true,
    }
}
