//! Progress on standard error: a bar with rate and time left on a terminal, a plain line every few seconds elsewhere,
//! nothing when quiet.

use std::{
    io::IsTerminal,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{HumanCount, HumanDuration, ProgressBar, ProgressStyle};

use super::Context;

/// Seconds between plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(5);
/// Steps that end sooner leave no plain line.
const FIRST_LINE: Duration = Duration::from_secs(2);

/// The progress of one step after another.
pub(super) struct Progress {
    output: Output,
    /// What the steps count, such as "posts".
    unit: &'static str,
    step: Mutex<Step>,
}

enum Output {
    Bar(ProgressBar),
    Lines,
    Nothing,
}

struct Step {
    name: String,
    started: Instant,
    next_line: Instant,
}

impl Progress {
    /// Progress that counts `unit`.
    pub(super) fn new(context: &Context, unit: &'static str) -> Self {
        let output = match (context.quiet, std::io::stderr().is_terminal()) {
            (true, _) => Output::Nothing,
            (false, true) => Output::Bar(ProgressBar::hidden()),
            (false, false) => Output::Lines,
        };
        let now = Instant::now();
        Self { output, unit, step: Mutex::new(Step { name: String::new(), started: now, next_line: now }) }
    }

    /// Tells that step `name` has done `done` of `total`; a total of 0 means that it is not known.
    pub(super) fn tell(&mut self, name: &str, done: u64, total: u64) {
        let step = self.step.get_mut().unwrap_or_else(PoisonError::into_inner);
        if step.name != name {
            let now = Instant::now();
            *step = Step { name: name.into(), started: now, next_line: now + FIRST_LINE };
            match &mut self.output {
                Output::Bar(bar) => {
                    bar.finish_and_clear();
                    *bar = new_bar(name, self.unit, total);
                }
                Output::Lines if total == 0 => errln!("{name}"),
                Output::Lines | Output::Nothing => {}
            }
        }
        self.at(done, total);
    }

    /// The same for the step that was told of last, from any thread.
    pub(super) fn at(&self, done: u64, total: u64) {
        match &self.output {
            Output::Bar(bar) => bar.set_position(done),
            Output::Lines => self.line(done, total),
            Output::Nothing => {}
        }
    }

    fn line(&self, done: u64, total: u64) {
        let mut step = self.step.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if now < step.next_line || done == 0 || total == 0 {
            return;
        }
        step.next_line = now + LINE_PERIOD;
        let elapsed = now - step.started;
        let rate = done as f64 / elapsed.as_secs_f64();
        let left = Duration::from_secs_f64(total.saturating_sub(done) as f64 / rate);
        let (percent, rate, left) = (done * 100 / total, HumanCount(rate as u64), HumanDuration(left));
        errln!("{}: {percent} %, {rate} {} a second, {left} left", step.name, self.unit);
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        if let Output::Bar(bar) = &self.output {
            bar.finish_and_clear();
        }
    }
}

fn new_bar(name: &str, unit: &str, total: u64) -> ProgressBar {
    let (bar, template) = if total == 0 {
        (ProgressBar::new_spinner(), "{msg} {spinner} {elapsed}".to_owned())
    } else {
        let template =
            format!("{{msg:10}} {{bar:30}} {{percent:>3}} %  {{human_pos}} {unit}, {{per_sec}}, {{eta}} left");
        (ProgressBar::new(total), template)
    };
    bar.enable_steady_tick(Duration::from_millis(200));
    let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message(name.to_owned())
}
