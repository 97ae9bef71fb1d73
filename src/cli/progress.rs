//! Progress on standard error: a bar with rate and time left on a terminal, a plain line every few seconds elsewhere,
//! nothing when quiet.
//!
//! Work may have parts that come one after the other, each with its share of the time; then the time left is that of all
//! of them. Shares are measured, not promised: they only let the bar run evenly.

use std::{
    io::IsTerminal,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{HumanCount, HumanDuration, ProgressBar, ProgressStyle};

use super::Context;

/// Time between plain lines.
const LINE_PERIOD: Duration = Duration::from_secs(5);
/// Steps that end sooner leave no plain line.
const FIRST_LINE: Duration = Duration::from_secs(2);
/// Time between changes of a bar.
const BAR_PERIOD: Duration = Duration::from_millis(100);
/// Steps of a bar from end to end.
const BAR_STEPS: u64 = 1000;

/// A part of work: its name, and how long it takes beside the others.
pub(super) type Part = (&'static str, u32);

/// The progress of one step after another.
pub(super) struct Progress {
    output: Output,
    /// What the steps count, such as "posts".
    unit: &'static str,
    /// The parts of the whole; none where each step is for itself.
    parts: &'static [Part],
    began: Instant,
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
    /// What was done when it started.
    first: u64,
    next: Instant,
}

impl Progress {
    /// Progress that counts `unit`.
    pub(super) fn new(context: &Context, unit: &'static str) -> Self {
        Self::of_parts(context, unit, &[])
    }

    /// Progress of work that has these parts, in this order; a step is the part of its name.
    pub(super) fn of_parts(context: &Context, unit: &'static str, parts: &'static [Part]) -> Self {
        let output = match (context.quiet, std::io::stderr().is_terminal()) {
            (true, _) => Output::Nothing,
            (false, true) => Output::Bar(ProgressBar::hidden()),
            (false, false) => Output::Lines,
        };
        let now = Instant::now();
        let step = Mutex::new(Step { name: String::new(), started: now, first: 0, next: now });
        Self { output, unit, parts, began: now, step }
    }

    /// Tells that step `name` has done `done` of `total`; a total of 0 means that it is not known.
    pub(super) fn tell(&mut self, name: &str, done: u64, total: u64) {
        let step = self.step.get_mut().unwrap_or_else(PoisonError::into_inner);
        if step.name != name {
            let now = Instant::now();
            let wait = if matches!(self.output, Output::Bar(_)) { Duration::ZERO } else { FIRST_LINE };
            let is_first = step.name.is_empty();
            *step = Step { name: name.into(), started: now, first: done, next: now + wait };
            match &mut self.output {
                // Parts share one bar.
                Output::Bar(bar) if is_first || self.parts.is_empty() => {
                    bar.finish_and_clear();
                    *bar = new_bar(total);
                    bar.set_message(name.to_owned());
                }
                Output::Lines if total == 0 => errln!("{name}"),
                Output::Bar(_) | Output::Lines | Output::Nothing => {}
            }
        }
        self.at(done, total);
    }

    /// The same for the step that was told of last, from any thread.
    pub(super) fn at(&self, done: u64, total: u64) {
        if matches!(self.output, Output::Nothing) || total == 0 {
            return;
        }
        let mut step = self.step.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        if now < step.next {
            return;
        }
        let figures = Figures::of(self, &step, now, done, total);
        match &self.output {
            Output::Bar(bar) => {
                step.next = now + BAR_PERIOD;
                bar.set_position((figures.share * BAR_STEPS as f64) as u64);
                bar.set_message(figures.words(&step.name, self.unit));
            }
            Output::Lines if done > 0 => {
                step.next = now + LINE_PERIOD;
                errln!("{}", figures.words(&step.name, self.unit));
            }
            Output::Lines | Output::Nothing => {}
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        if let Output::Bar(bar) = &self.output {
            bar.finish_and_clear();
        }
    }
}

/// How far work has come.
#[derive(Clone, Copy, PartialEq, Debug)]
struct Figures {
    /// Of the step, from 0 to 1.
    of_step: f64,
    /// Of all.
    share: f64,
    /// A second.
    rate: Option<u64>,
    /// Until the end of all.
    left: Option<Duration>,
}

impl Figures {
    fn of(progress: &Progress, step: &Step, now: Instant, done: u64, total: u64) -> Self {
        let of_step = (done as f64 / total as f64).min(1.0);
        let seconds = (now - step.started).as_secs_f64();
        let rate = (done > step.first && seconds > 0.0).then(|| (done - step.first) as f64 / seconds);
        let left = match share_of_all(progress.parts, &step.name, of_step) {
            Some(share) => (share > 0.0).then(|| (now - progress.began).as_secs_f64() * (1.0 / share - 1.0)),
            None => rate.map(|rate| total.saturating_sub(done) as f64 / rate),
        };
        Self {
            of_step,
            share: share_of_all(progress.parts, &step.name, of_step).unwrap_or(of_step),
            rate: rate.map(|rate| rate as u64),
            left: left.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()),
        }
    }

    fn words(&self, name: &str, unit: &str) -> String {
        let percent = |share: f64| (share * 100.0) as u32;
        let mut words = format!("{name}: {} %", percent(self.of_step));
        if self.share != self.of_step {
            words += &format!(" ({} % of all)", percent(self.share));
        }
        if let Some(rate) = self.rate {
            words += &format!(", {} {unit} a second", HumanCount(rate));
        }
        if let Some(left) = self.left {
            words += &format!(", {} left", HumanDuration(left));
        }
        words
    }
}

/// How much of all parts is done when so much of the part `name` is; `None` when it is no part.
fn share_of_all(parts: &[Part], name: &str, of_part: f64) -> Option<f64> {
    let at = parts.iter().position(|(part, _)| *part == name)?;
    let sum = |parts: &[Part]| f64::from(parts.iter().map(|(_, share)| share).sum::<u32>());
    Some((sum(&parts[..at]) + f64::from(parts[at].1) * of_part) / sum(parts))
}

fn new_bar(total: u64) -> ProgressBar {
    let (bar, template) = if total == 0 {
        (ProgressBar::new_spinner(), "{spinner} {elapsed} {msg}")
    } else {
        (ProgressBar::new(BAR_STEPS), "{bar:30} {percent:>3} % {msg}")
    };
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: [Part; 3] = [("reading", 50), ("filling voids", 10), ("writing", 40)];

    #[test]
    fn parts_follow_one_another() {
        assert_eq!(share_of_all(&PARTS, "reading", 0.0), Some(0.0));
        assert_eq!(share_of_all(&PARTS, "reading", 1.0), share_of_all(&PARTS, "filling voids", 0.0));
        assert_eq!(share_of_all(&PARTS, "writing", 0.5), Some(0.8));
        assert_eq!(share_of_all(&PARTS, "writing", 1.0), Some(1.0));
        assert_eq!(share_of_all(&PARTS, "pages", 0.5), None);
    }

    #[test]
    fn the_time_left_is_that_of_all_parts_and_the_rate_that_of_the_step() {
        let context = Context { json: false, threads: None, quiet: true };
        let mut progress = Progress::of_parts(&context, "posts", &PARTS);
        let now = progress.began + Duration::from_secs(80);
        let step = Step { name: "writing".into(), started: now - Duration::from_secs(10), first: 0, next: now };
        let words = |progress: &Progress| Figures::of(progress, &step, now, 500, 1000).words("writing", "posts");
        assert_eq!(words(&progress), "writing: 50 % (80 % of all), 50 posts a second, 20 seconds left");
        progress.parts = &[];
        assert_eq!(words(&progress), "writing: 50 %, 50 posts a second, 10 seconds left");
        let begun = Figures::of(&progress, &Step { first: 500, ..step }, now, 500, 1000);
        assert_eq!(begun.words("writing", "posts"), "writing: 50 %");
    }
}
