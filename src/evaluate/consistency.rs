//! The comparison: what clients see on their own meshes against the exact verdicts of the finest terrain.
//!
//! For each delivered frame and each line that is VISIBLE or BLOCKED on the terrain at the frame's epoch, the verdict
//! on the client's replica either equals the exact one, or the frame names the line, or it is a *silent disagreement*,
//! of which there must be none. So is a line whose verdict is right but not what it asks beside it, where a client can
//! tell ([`sightline_client::judge`]). A line named although it holds is counted too, as far as that can be told, and so is
//! everything else that must not be: a hash that differs, sight lines that are not those of the epoch, a mesh above its
//! budget, a naive reference that contradicts the exact verdict.

use serde::Serialize;
use sightline_proto::v1;

use super::{
    agreement::Agreement,
    record::{FrameRecord, Kind, on_mesh},
    scenario::Truth,
};

/// Greatest number of disagreements kept as examples.
pub const MAX_EXAMPLES: usize = 20;

/// One client of a test, and what was found in its frames.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct ClientTally {
    /// What the client is called.
    pub name: String,
    /// Its triangle budget.
    pub budget: u32,
    /// Frames delivered and applied, of the view that honours the sight lines.
    pub frames: u64,
    /// Verdicts compared.
    pub comparisons: u64,
    /// Verdicts that differ from the exact one without being named: must be 0.
    pub silent_disagreements: u64,
    /// Times that a line was named as unsatisfied.
    pub named: u64,
    /// Times that a line was named although it holds, as far as a client can tell, or is not registered: must be 0.
    pub named_though_right: u64,
    /// Times that a line of fidelity PROFILE met a triangle above the finest level without being named: must be 0.
    pub silently_coarse: u64,
    /// Times that a line of fidelity OBSTRUCTION was blocked too far from the true place without being named: must be 0.
    pub silently_far: u64,
    /// Times that a line was UNKNOWN on the terrain: not compared.
    pub unknown: u64,
    /// Frames whose hash was not that of the mesh: must be 0.
    pub hash_mismatches: u64,
    /// Frames refused for another reason: must be 0.
    pub refused: u64,
    /// Frames at which the client held other sight lines than those of the epoch: must be 0.
    pub exercise_mismatches: u64,
    /// Frames with more triangles than the budget: must be 0.
    pub over_budget: u64,
    /// Most triangles of a frame.
    pub most_triangles: u32,
    /// Frames of the plain view.
    pub plain_frames: u64,
    /// Verdicts compared on the plain view's mesh.
    pub plain_comparisons: u64,
    /// Verdicts that the plain view's mesh gets wrong.
    pub plain_disagreements: u64,
    /// Bytes received.
    pub bytes: u64,
}

impl ClientTally {
    /// Adds another client's counts.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.comparisons += other.comparisons;
        self.silent_disagreements += other.silent_disagreements;
        self.named += other.named;
        self.named_though_right += other.named_though_right;
        self.silently_coarse += other.silently_coarse;
        self.silently_far += other.silently_far;
        self.unknown += other.unknown;
        self.hash_mismatches += other.hash_mismatches;
        self.refused += other.refused;
        self.exercise_mismatches += other.exercise_mismatches;
        self.over_budget += other.over_budget;
        self.most_triangles = self.most_triangles.max(other.most_triangles);
        self.plain_frames += other.plain_frames;
        self.plain_comparisons += other.plain_comparisons;
        self.plain_disagreements += other.plain_disagreements;
        self.bytes += other.bytes;
    }

    /// How many findings there are that must not be.
    pub fn findings(&self) -> u64 {
        self.silent_disagreements
            + self.named_though_right
            + self.silently_coarse
            + self.silently_far
            + self.hash_mismatches
            + self.refused
            + self.exercise_mismatches
            + self.over_budget
    }
}

/// A disagreement, so that it can be found again.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Example {
    /// The client's name.
    pub client: String,
    /// The frame's number.
    pub sequence: u64,
    /// The pose that it was made for.
    pub pose_sequence: u64,
    /// The epoch.
    pub epoch: u64,
    /// The sight line.
    pub line: u64,
    /// Its ends in the grid frame, by the terrain.
    pub ends: Option<[[f64; 3]; 2]>,
    /// The exact verdict.
    pub exact: String,
    /// The verdict on the client's mesh.
    pub on_mesh: String,
    /// Whether the frame names the line.
    pub named: bool,
}

/// Where a frame comes from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Source {
    /// The client's index.
    pub client: usize,
    /// The index of its server.
    pub server: usize,
    /// Triangles that the client allowed for this frame.
    pub budget: u32,
}

/// The running comparison of all clients.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Comparison {
    /// By client.
    pub clients: Vec<ClientTally>,
    /// The first disagreements and false names.
    pub examples: Vec<Example>,
    /// For each line, how often a plain mesh got it wrong.
    pub plain_wrong_by_line: Vec<u64>,
    /// What clients of different servers say of the same lines at the same epochs.
    pub between_servers: Agreement,
}

impl Comparison {
    /// A comparison of clients, by name and budget, over so many lines.
    pub fn new(clients: impl IntoIterator<Item = (String, u32)>, lines: usize) -> Self {
        let clients = clients.into_iter().map(|(name, budget)| ClientTally { name, budget, ..Default::default() });
        Self { clients: clients.collect(), plain_wrong_by_line: vec![0; lines], ..Self::default() }
    }

    /// Counts a frame of a client against the truth at the frame's epoch, and against its budget at the time.
    pub fn frame(&mut self, from: Source, frame: &FrameRecord, truth: &Truth) {
        let tally = &mut self.clients[from.client];
        tally.over_budget += u64::from(frame.triangles > from.budget);
        match frame.kind {
            Kind::Lines => {
                self.honouring_frame(from.client, frame, truth);
                self.between_servers.frame(from.server, frame, truth);
            }
            Kind::Plain => self.plain_frame(from.client, frame, truth),
        }
    }

    fn honouring_frame(&mut self, client: usize, frame: &FrameRecord, truth: &Truth) {
        let tally = &mut self.clients[client];
        tally.frames += 1;
        tally.named += frame.named.len() as u64;
        tally.exercise_mismatches += u64::from(frame.digest != truth.digest);
        tally.most_triangles = tally.most_triangles.max(frame.triangles);
        tally.named_though_right += frame.named.iter().filter(|&id| !truth.lines.contains_key(id)).count() as u64;
        for (&id, line) in &truth.lines {
            let Some(exact) = on_mesh(line.verdict) else {
                tally.unknown += 1;
                // An UNKNOWN line holds trivially and is never named.
                tally.named_though_right += u64::from(frame.named.contains(&id));
                continue;
            };
            let found = frame.verdict(id);
            let named = frame.named.contains(&id);
            tally.comparisons += 1;
            let silent = found != Some(exact) && !named;
            let short = frame.short.contains(&id);
            if short && !named {
                match line.fidelity {
                    v1::Fidelity::Profile => tally.silently_coarse += 1,
                    _ => tally.silently_far += 1,
                }
            }
            let holds = found == Some(exact) && !short && !frame.untold.contains(&id);
            let false_name = holds && named;
            tally.silent_disagreements += u64::from(silent);
            tally.named_though_right += u64::from(false_name);
            if (silent || false_name) && self.examples.len() < MAX_EXAMPLES {
                self.examples.push(Example {
                    client: tally.name.clone(),
                    sequence: frame.sequence,
                    pose_sequence: frame.pose_sequence,
                    epoch: frame.epoch,
                    line: id,
                    ends: line.ends,
                    exact: format!("{exact:?}"),
                    on_mesh: found.map_or_else(|| "no ends".into(), |v| format!("{v:?}")),
                    named,
                });
            }
        }
    }

    fn plain_frame(&mut self, client: usize, frame: &FrameRecord, truth: &Truth) {
        let tally = &mut self.clients[client];
        tally.plain_frames += 1;
        for (&id, line) in &truth.lines {
            if let (Some(exact), Some(found)) = (on_mesh(line.verdict), frame.verdict(id)) {
                tally.plain_comparisons += 1;
                if exact != found {
                    tally.plain_disagreements += 1;
                    if let Some(count) = self.plain_wrong_by_line.get_mut(id as usize - 1) {
                        *count += 1;
                    }
                }
            }
        }
    }

    /// All clients together.
    pub fn total(&self) -> ClientTally {
        let mut total = ClientTally { name: "all".into(), ..Default::default() };
        for client in &self.clients {
            total.add(client);
        }
        total
    }
}

/// A share in per cent, 0 of nothing.
pub fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sightline_client::scene::StatedLine;
    use sightline_proto::verdict::MeshVerdict;
    use std::collections::BTreeMap;

    fn truth(verdicts: &[v1::Verdict], fidelity: v1::Fidelity) -> Truth {
        let line = |&verdict| StatedLine { ends: Some([[0.0; 3]; 2]), verdict, fidelity, obstruction: None };
        Truth { lines: (1..).zip(verdicts.iter().map(line)).collect::<BTreeMap<_, _>>(), digest: 77 }
    }

    fn frame(verdicts: &[Option<MeshVerdict>], named: &[u64]) -> FrameRecord {
        FrameRecord {
            kind: Kind::Lines,
            sequence: 1,
            pose_sequence: 1,
            epoch: 1,
            triangles: 100,
            hash: 0,
            digest: 77,
            verdicts: verdicts.to_vec(),
            named: named.to_vec(),
            short: Vec::new(),
            untold: Vec::new(),
        }
    }

    const ONE: Source = Source { client: 0, server: 0, budget: 100 };

    const V: Option<MeshVerdict> = Some(MeshVerdict::Visible);
    const B: Option<MeshVerdict> = Some(MeshVerdict::Blocked);

    #[test]
    fn each_kind_of_finding_is_counted_and_nothing_else() {
        use v1::Verdict::{Blocked, Unknown, Visible};
        let truth = truth(&[Visible, Blocked, Unknown, Visible], v1::Fidelity::Verdict);
        let tally = |frame: FrameRecord| {
            let mut comparison = Comparison::new([("one".into(), 100)], 4);
            comparison.frame(ONE, &frame, &truth);
            (comparison.total(), comparison.examples)
        };
        let (good, examples) = tally(frame(&[V, B, B, V], &[]));
        assert_eq!((good.findings(), good.comparisons, good.unknown, examples.len()), (0, 3, 1, 0));
        let (wrong, examples) = tally(frame(&[V, V, B, V], &[]));
        assert_eq!((wrong.findings(), wrong.silent_disagreements, examples[0].line), (1, 1, 2));
        let (named, _) = tally(frame(&[V, V, B, V], &[2]));
        assert_eq!((named.findings(), named.named), (0, 1));
        let (falsely, _) = tally(frame(&[V, B, B, V], &[2]));
        assert_eq!((falsely.findings(), falsely.named_though_right), (1, 1));
        let (unknown_named, _) = tally(frame(&[V, B, B, V], &[3]));
        assert_eq!((unknown_named.findings(), unknown_named.named_though_right), (1, 1));
        let (missing, _) = tally(frame(&[V, None, B], &[]));
        assert_eq!(missing.silent_disagreements, 2);
        let (stale, _) = tally(FrameRecord { digest: 78, ..frame(&[V, B, B, V], &[]) });
        assert_eq!((stale.findings(), stale.exercise_mismatches), (1, 1));
        let (stranger, _) = tally(frame(&[V, B, B, V], &[5]));
        assert_eq!((stranger.findings(), stranger.named_though_right), (1, 1));
        let (large, _) = tally(FrameRecord { triangles: 101, ..frame(&[V, B, B, V], &[]) });
        assert_eq!((large.findings(), large.over_budget), (1, 1));
    }

    #[test]
    fn a_plain_view_is_counted_apart_and_is_no_finding() {
        use v1::Verdict::{Blocked, Visible};
        let mut comparison = Comparison::new([("one".into(), 100)], 2);
        let plain = FrameRecord { kind: Kind::Plain, ..frame(&[B, B], &[]) };
        comparison.frame(ONE, &plain, &truth(&[Visible, Blocked], v1::Fidelity::Verdict));
        let total = comparison.total();
        assert_eq!((total.findings(), total.comparisons), (0, 0));
        assert_eq!((total.plain_comparisons, total.plain_disagreements), (2, 1));
        assert_eq!(comparison.plain_wrong_by_line, [1, 0]);
    }

    #[test]
    fn a_line_that_asks_for_more_than_its_verdict_may_be_named_while_that_is_right() {
        let tally = |fidelity, frame: FrameRecord| {
            let mut comparison = Comparison::new([("one".into(), 100)], 1);
            comparison.frame(ONE, &frame, &truth(&[v1::Verdict::Visible], fidelity));
            comparison.total()
        };
        let untold = FrameRecord { untold: vec![1], ..frame(&[V], &[1]) };
        assert_eq!(tally(v1::Fidelity::Wedgie, untold).findings(), 0);
        let coarse = FrameRecord { short: vec![1], ..frame(&[V], &[1]) };
        let far = FrameRecord { named: Vec::new(), ..coarse.clone() };
        assert_eq!(tally(v1::Fidelity::Obstruction, far).silently_far, 1);
        assert_eq!(tally(v1::Fidelity::Obstruction, frame(&[V], &[1])).named_though_right, 1);
        assert_eq!(tally(v1::Fidelity::Profile, coarse.clone()).findings(), 0);
        let silent = FrameRecord { named: Vec::new(), ..coarse };
        assert_eq!(tally(v1::Fidelity::Profile, silent).silently_coarse, 1);
        assert_eq!(tally(v1::Fidelity::Profile, frame(&[V], &[1])).named_though_right, 1);
    }
}
