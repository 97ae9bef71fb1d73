//! Live progress of a run: a bar for each client on a terminal, plain lines elsewhere, nothing when quiet.

use std::io::IsTerminal;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::{super::Context, plan::Plan, run::Happening};
use crate::evaluate::consistency::percent;

/// Shows what happens.
pub(in super::super) enum Show {
    /// On a terminal.
    Bars { all: MultiProgress, bars: Vec<ProgressBar> },
    /// A line for each client at each tenth of its flight.
    Lines { names: Vec<String>, poses: u64, told: Vec<u64> },
    /// Nothing.
    Quiet,
}

impl Show {
    /// A display for a plan.
    pub(in super::super) fn new(context: &Context, plan: &Plan) -> Self {
        let poses = plan.frames as u64;
        if context.quiet {
            return Self::Quiet;
        }
        if !std::io::stderr().is_terminal() {
            let names = plan.clients.iter().map(|c| c.name.clone()).collect();
            return Self::Lines { names, poses, told: vec![0; plan.clients.len()] };
        }
        let all = MultiProgress::new();
        let style = ProgressStyle::with_template("{prefix:>14} {bar:30} {pos}/{len} {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = |name: &str| all.add(ProgressBar::new(poses).with_style(style.clone()).with_prefix(name.to_owned()));
        let bars = plan.clients.iter().map(|c| bar(&c.name)).collect();
        Self::Bars { all, bars }
    }

    /// Shows one happening.
    pub(in super::super) fn tell(&mut self, happening: &Happening) {
        match (self, happening) {
            (Self::Quiet, _) => {}
            (Self::Bars { all, .. }, Happening::Step(what)) => drop(all.println(format!("{what} ..."))),
            (Self::Bars { all, .. }, Happening::Remark(what)) => drop(all.println(what)),
            (Self::Lines { .. }, Happening::Step(what)) => errln!("{what} ..."),
            (Self::Lines { .. }, Happening::Remark(what)) => errln!("{what}"),
            (Self::Bars { bars, .. }, Happening::Poses { client, poses, .. }) => {
                bars[*client].set_position(*poses);
                bars[*client].set_message(message(happening));
            }
            (Self::Lines { names, poses: all, told }, Happening::Poses { client, poses, .. }) => {
                let tenth = poses * 10 / (*all).max(1);
                if tenth > told[*client] {
                    told[*client] = tenth;
                    errln!("{:>14} {poses}/{all} {}", names[*client], message(happening));
                }
            }
        }
    }

    /// Leaves the last state standing.
    pub(in super::super) fn finish(self) {
        if let Self::Bars { bars, .. } = self {
            bars.iter().for_each(ProgressBar::abandon);
        }
    }
}

fn message(happening: &Happening) -> String {
    let Happening::Poses { client, comparison, .. } = happening else { return String::new() };
    let tally = &comparison.clients[*client];
    format!(
        "{} verdicts, {} silent, {} named; plain {:.1} % wrong",
        tally.comparisons,
        tally.silent_disagreements,
        tally.named,
        percent(tally.plain_disagreements, tally.plain_comparisons)
    )
}
