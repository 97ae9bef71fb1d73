//! The command line: one file a verb. Only this module knows exit codes.
//!
//! A verb is a clap `Args` struct with `fn run(self, context: &Context) -> Result<(), Failure>`; results go to standard
//! output, everything else to standard error. Exit status: 0 done, 1 a check found something, 2 usage, 3 bad input,
//! 4 environment. A BLOCKED verdict is 0.

#[macro_use]
mod say;

pub mod args;
mod check;
mod connect;
mod consistency;
mod demo;
mod evaluate;
mod fly;
mod generator;
mod height;
mod info;
mod ingest;
mod load;
mod los;
mod matrix;
mod mesh;
mod output;
mod pictures;
mod plot;
mod profile;
mod progress;
mod relief;
mod replay;
mod serve;
mod statistics;
mod status;
mod table;
mod verify;
mod view;
mod viewshed;

use std::{ffi::OsString, fmt::Display, process::ExitCode};

use clap::{Parser, Subcommand};

/// Exact, consistent lines of sight for multi-client terrain simulation.
///
/// Start with `sightline demo`: it ingests an embedded elevation model, starts a server on it, and flies three
/// independent scene generators whose meshes agree on every sight line.
#[derive(Parser, Debug)]
#[command(name = "sightline", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    context: Context,
}

/// Options of every verb.
#[derive(clap::Args, Clone, Debug)]
pub struct Context {
    /// Print one JSON document on standard output; everything else goes to standard error.
    #[arg(long, global = true)]
    pub json: bool,
    /// Use at most N threads for computation [default: one per core].
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<std::num::NonZeroUsize>,
    /// No progress and no remarks.
    #[arg(long, global = true)]
    pub quiet: bool,
}

#[derive(Subcommand, Debug)]
enum Verb {
    Ingest(ingest::Args),
    Mesh(mesh::Args),
    Info(info::Args),
    Verify(verify::Args),
    Los(los::Args),
    Fly(fly::Args),
    Profile(profile::Args),
    Viewshed(viewshed::Args),
    Height(height::Args),
    Matrix(matrix::Args),
    Serve(serve::Args),
    Status(status::Args),
    Replay(replay::Args),
    Load(load::Args),
    View(view::Args),
    Consistency(consistency::Args),
    Evaluate(evaluate::Args),
    Demo(demo::Args),
    #[command(hide = true)]
    SceneGenerator(consistency::worker::Args),
}

/// Why a verb did not end well: what to tell the user, and the exit status.
#[derive(Debug)]
pub enum Failure {
    /// A check found something: a silent disagreement, damage, a suspicious value. Status 1.
    Found(String),
    /// The command line does not make sense. Status 2.
    Usage(String),
    /// A file or an address does not hold what it should. Status 3.
    Input(String),
    /// The machine does not give what is needed: permissions, ports, disk. Status 4.
    Environment(String),
}

impl Failure {
    /// Bad input, with what was being read.
    pub fn input(what: impl Display, why: impl Display) -> Self {
        Self::Input(format!("{what}: {why}"))
    }

    /// A refusal of the operating system, with what was being done.
    pub fn environment(what: impl Display, why: impl Display) -> Self {
        Self::Environment(format!("{what}: {why}"))
    }

    fn report(&self) -> ExitCode {
        let (text, status) = match self {
            Self::Found(text) => (text, 1),
            Self::Usage(text) => (text, 2),
            Self::Input(text) => (text, 3),
            Self::Environment(text) => (text, 4),
        };
        errln!("sightline: {text}");
        ExitCode::from(status)
    }
}

/// Runs the command line `args`, program name first.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are no errors; clap says which stream and status each has.
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    if let Some(threads) = cli.context.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global()
    {
        return Failure::environment("starting threads", error).report();
    }
    match cli.verb.run(&cli.context) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

impl Verb {
    fn run(self, context: &Context) -> Result<(), Failure> {
        match self {
            Self::Ingest(args) => args.run(context),
            Self::Mesh(args) => args.run(context),
            Self::Info(args) => args.run(context),
            Self::Verify(args) => args.run(context),
            Self::Los(args) => args.run(context),
            Self::Fly(args) => args.run(context),
            Self::Profile(args) => args.run(context),
            Self::Viewshed(args) => args.run(context),
            Self::Height(args) => args.run(context),
            Self::Matrix(args) => args.run(context),
            Self::Serve(args) => args.run(context),
            Self::Status(args) => args.run(context),
            Self::Replay(args) => args.run(context),
            Self::Load(args) => args.run(context),
            Self::View(args) => args.run(context),
            Self::Consistency(args) => args.run(context),
            Self::Evaluate(args) => args.run(context),
            Self::Demo(args) => args.run(context),
            Self::SceneGenerator(args) => args.run(),
        }
    }
}
