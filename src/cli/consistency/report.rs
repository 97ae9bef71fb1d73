//! What a consistency test tells: a table, a document.

use super::{
    plan::{Changes, Plan},
    run::Outcome,
};
use crate::{
    database::{Database, version_digits},
    evaluate::consistency::{ClientTally, percent},
    session::fidelity_to_wire,
};

/// How many findings there are that must not be, those of the instrument itself included.
pub(in super::super) fn findings(outcome: &Outcome) -> u64 {
    outcome.comparison.total().findings()
        + outcome.comparison.between_servers.disagreements
        + outcome.checks.naive_differs
}

/// The table and the sums, as lines of text.
pub(in super::super) fn table(plan: &Plan, outcome: &Outcome) -> String {
    let mut out = String::from(
        "client          flight      budget  frames  comparisons  silent  named  unknown  mismatches  plain wrong\n",
    );
    let total = outcome.comparison.total();
    let flights = plan.clients.iter().map(|c| c.preset.name()).chain([""]);
    for (tally, flight) in outcome.comparison.clients.iter().chain([&total]).zip(flights) {
        out += &row(tally, flight);
    }
    let checks = outcome.checks;
    let answered = checks.visible + checks.blocked;
    out += &format!(
        "\n{} sight lines at {} epochs: {:.1} % of the exact verdicts are VISIBLE, {} UNKNOWN; {} redone by the naive \
         reference, {} differ\n",
        outcome.scenario.lines.len(),
        checks.epochs,
        percent(checks.visible, answered),
        checks.unknown,
        checks.naive,
        checks.naive_differs,
    );
    out += &format!(
        "silent disagreements: {} with sight lines; without them the same clients got {:.1} % of {} verdicts wrong\n",
        total.silent_disagreements,
        percent(total.plain_disagreements, total.plain_comparisons),
        total.plain_comparisons,
    );
    if outcome.servers > 1 {
        let between = &outcome.comparison.between_servers;
        out += &format!(
            "{} servers: of {} verdicts compared with those of another server's clients at the same epoch, {} differ\n",
            outcome.servers, between.comparisons, between.disagreements,
        );
    }
    for e in &outcome.comparison.examples {
        out += &format!(
            "  {}: frame {} (pose {}, epoch {}): line {} is {} and comes out {}{}, ends {:?}\n",
            e.client,
            e.sequence,
            e.pose_sequence,
            e.epoch,
            e.line,
            e.exact,
            e.on_mesh,
            if e.named { ", but is named" } else { "" },
            e.ends,
        );
    }
    out
}

fn row(tally: &ClientTally, flight: &str) -> String {
    let budget = if tally.budget == 0 { String::new() } else { tally.budget.to_string() };
    let mismatches = tally.findings() - tally.silent_disagreements;
    format!(
        "{:<15} {:<10} {:>7} {:>7} {:>12} {:>7} {:>6} {:>8} {:>11} {:>10.1} %\n",
        tally.name,
        flight,
        budget,
        tally.frames,
        tally.comparisons,
        tally.silent_disagreements,
        tally.named,
        tally.unknown,
        mismatches,
        percent(tally.plain_disagreements, tally.plain_comparisons),
    )
}

/// Everything as one JSON document.
pub(in super::super) fn document(plan: &Plan, outcome: &Outcome, database: &Database) -> serde_json::Value {
    let total = outcome.comparison.total();
    let checks = outcome.checks;
    let clients: Vec<_> = outcome
        .comparison
        .clients
        .iter()
        .zip(&plan.clients)
        .map(|(tally, client)| {
            serde_json::json!({
                "flight": client.preset.name(), "tan_half_fov": client.tan_half_fov, "found": tally,
                "plain_wrong_percent": percent(tally.plain_disagreements, tally.plain_comparisons),
            })
        })
        .collect();
    serde_json::json!({
        "terrain_version": version_digits(&database.version()), "seed": plan.seed, "fidelity": fidelity_to_wire(plan.fidelity).0.as_str_name(),
        "sight_lines": outcome.scenario.lines.len(), "entities": outcome.scenario.entities.len(),
        "changes": changes(plan.changes), "servers": outcome.servers,
        "between_servers": {
            "comparisons": outcome.comparison.between_servers.comparisons,
            "disagreements": outcome.comparison.between_servers.disagreements,
        },
        "frames": plan.frames, "clients": clients, "all": total, "checks": checks,
        "visible_percent": percent(checks.visible, checks.visible + checks.blocked),
        "plain_wrong_percent": percent(total.plain_disagreements, total.plain_comparisons),
        "findings": findings(outcome), "examples": outcome.comparison.examples, "seconds": outcome.seconds,
    })
}

fn changes(changes: Changes) -> Vec<&'static str> {
    let all = [("budgets", changes.budgets), ("jumps", changes.jumps), ("lines", changes.lines)];
    all.into_iter().filter(|(_, wanted)| *wanted).map(|(name, _)| name).collect()
}
