//! The verbs of the command line as a user meets them: words, exit statuses, files.

mod contract;
mod database;
mod evaluate;
mod fly;
mod killed;
mod load;
mod los;
mod maps;
mod mesh;
mod pipe;
mod replay;
mod serve;

use std::process::{Command, Output};

/// The program, with its arguments still to be given.
fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_sightline"))
}

fn sightline(args: &[&str]) -> Output {
    program().args(args).output().expect("the program starts")
}

fn status(output: &Output) -> i32 {
    output.status.code().expect("the program ends by itself")
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).expect("output is UTF-8")
}
