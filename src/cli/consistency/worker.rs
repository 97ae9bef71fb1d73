//! Scene generators as processes: the hidden verb that is one, and the parent's end of the pipes.

use std::{
    io::{self, Read, Write},
    process::Stdio,
};

use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    process::{Child, ChildStdout, Command},
    sync::mpsc,
};

use super::super::{
    Failure,
    generator::{self, Order},
};
use crate::evaluate::record::{MAX_RECORD_BYTES, Record};

/// Name of the hidden verb.
pub(super) const VERB: &str = "scene-generator";
/// Longest order in bytes.
const MAX_ORDER_BYTES: u64 = 64 << 20;

/// Be a scene generator: an order comes as JSON on standard input, a record of each frame goes to standard output.
#[derive(clap::Args, Debug)]
pub(in super::super) struct Args {}

impl Args {
    pub(in super::super) fn run(self) -> Result<(), Failure> {
        let mut text = String::new();
        io::stdin()
            .take(MAX_ORDER_BYTES)
            .read_to_string(&mut text)
            .map_err(|e| Failure::environment("reading the order", e))?;
        let order: Order = serde_json::from_str(&text).map_err(|e| Failure::input("the order", e))?;
        let mut out = io::BufWriter::new(io::stdout().lock());
        let mut tell = |record: Record| {
            writeln!(out, "{record}").and_then(|()| out.flush()).map_err(|e| Failure::environment("telling", e))
        };
        generator::runtime()?.block_on(generator::fly(&order, &mut tell)).map(|_| ())
    }
}

/// What comes from a worker.
#[derive(Debug)]
pub(super) enum Word {
    /// A record.
    Record(Record),
    /// A line that is none, or one that is too long.
    Nonsense(String),
    /// The process has ended; whether it did so well.
    Ended(bool),
}

/// Starts a generator; what it says goes to `words` under its number.
pub(super) fn start(number: usize, order: &Order, words: mpsc::Sender<(usize, Word)>) -> Result<(), Failure> {
    let failed = |e: io::Error| Failure::environment("starting a scene generator", e);
    let program = std::env::current_exe().map_err(failed)?;
    let order = serde_json::to_vec(order).map_err(|e| Failure::environment("writing an order", e))?;
    let mut child = Command::new(program)
        .arg(VERB)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .map_err(failed)?;
    let (stdin, stdout) = (child.stdin.take(), child.stdout.take());
    tokio::spawn(async move {
        if let Some(mut stdin) = stdin {
            // A worker that does not read its order ends by itself and says why.
            let _ = stdin.write_all(&order).await;
        }
    });
    tokio::spawn(listen(number, child, stdout, words));
    Ok(())
}

async fn listen(number: usize, mut child: Child, stdout: Option<ChildStdout>, words: mpsc::Sender<(usize, Word)>) {
    if let Some(stdout) = stdout {
        let mut reader = BufReader::new(stdout);
        while let Some(word) = read_word(&mut reader).await {
            // Nobody listens any more: the run is over.
            if words.send((number, word)).await.is_err() {
                return;
            }
        }
    }
    let well = child.wait().await.is_ok_and(|status| status.success());
    let _ = words.send((number, Word::Ended(well))).await;
}

async fn read_word(reader: &mut BufReader<ChildStdout>) -> Option<Word> {
    let mut line = Vec::new();
    let read = reader.take(MAX_RECORD_BYTES as u64).read_until(b'\n', &mut line).await;
    match read {
        Ok(0) | Err(_) => None,
        Ok(_) => {
            let text = String::from_utf8_lossy(&line);
            Some(
                text.trim_end().parse().map_or_else(|_| Word::Nonsense(text.chars().take(200).collect()), Word::Record),
            )
        }
    }
}
