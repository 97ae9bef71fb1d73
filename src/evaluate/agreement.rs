//! Whether clients of different servers agree: at one epoch, on every line that is VISIBLE or BLOCKED on the terrain and that
//! neither frame names. The truth is not asked here, so this finds servers that are wrong in the same way, too.

use std::collections::BTreeMap;

use sightline_proto::verdict::MeshVerdict;

use super::{
    record::{FrameRecord, on_mesh},
    scenario::Truth,
};

/// Greatest number of servers.
pub const MAX_SERVERS: usize = 8;
/// Epochs that are remembered, the last ones.
const MAX_EPOCHS: usize = 64;

/// Which servers' clients have seen a line so: a bit for each server.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
struct Seen {
    visible: u8,
    blocked: u8,
}

/// The running comparison.
#[derive(Clone, PartialEq, Eq, Default, Debug)]
pub struct Agreement {
    /// Verdicts that were compared with those of another server's clients, once for each such server.
    pub comparisons: u64,
    /// Those that are another: must be 0.
    pub disagreements: u64,
    epochs: BTreeMap<u64, BTreeMap<u64, Seen>>,
}

impl Agreement {
    /// Counts a frame of a client of `server`, one of the first [`MAX_SERVERS`].
    pub fn frame(&mut self, server: usize, frame: &FrameRecord, truth: &Truth) {
        let own = 1_u8 << (server % MAX_SERVERS);
        let seen = self.epochs.entry(frame.epoch).or_default();
        for (&id, line) in &truth.lines {
            let Some(found) = frame.verdict(id).filter(|_| on_mesh(line.verdict).is_some()) else { continue };
            if frame.named.contains(&id) {
                continue;
            }
            let seen = seen.entry(id).or_default();
            let (same, other) = match found {
                MeshVerdict::Visible => (&mut seen.visible, seen.blocked),
                MeshVerdict::Blocked => (&mut seen.blocked, seen.visible),
            };
            let differing = (other & !own).count_ones();
            self.comparisons += u64::from((*same & !own).count_ones() + differing);
            self.disagreements += u64::from(differing);
            *same |= own;
        }
        while self.epochs.len() > MAX_EPOCHS {
            self.epochs.pop_first();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::record::Kind;
    use sightline_client::scene::StatedLine;
    use sightline_proto::v1;

    fn frame(epoch: u64, verdicts: &[MeshVerdict], named: &[u64]) -> FrameRecord {
        FrameRecord {
            kind: Kind::Lines,
            sequence: 1,
            pose_sequence: 1,
            epoch,
            triangles: 2,
            hash: 0,
            digest: 0,
            verdicts: verdicts.iter().map(|&v| Some(v)).collect(),
            named: named.to_vec(),
            short: Vec::new(),
            untold: Vec::new(),
        }
    }

    #[test]
    fn servers_are_compared_at_the_same_epoch_on_lines_that_neither_names() {
        use MeshVerdict::{Blocked, Visible};
        let line = |verdict| StatedLine {
            ends: Some([[0.0; 3]; 2]),
            verdict,
            fidelity: v1::Fidelity::Verdict,
            obstruction: None,
        };
        let verdicts = [v1::Verdict::Visible, v1::Verdict::Blocked, v1::Verdict::Unknown];
        let truth = Truth { lines: (1..).zip(verdicts.map(line)).collect(), digest: 0 };
        let mut all = Agreement::default();
        let mut count = |server, frame: FrameRecord| {
            all.frame(server, &frame, &truth);
            (all.comparisons, all.disagreements)
        };
        assert_eq!(count(0, frame(1, &[Visible, Blocked, Visible], &[])), (0, 0));
        assert_eq!(count(0, frame(1, &[Visible, Blocked, Visible], &[])), (0, 0), "one server alone");
        assert_eq!(count(1, frame(1, &[Visible, Blocked, Blocked], &[])), (2, 0), "UNKNOWN is not compared");
        assert_eq!(count(1, frame(2, &[Blocked, Blocked, Visible], &[])), (2, 0), "another epoch");
        assert_eq!(count(0, frame(2, &[Visible, Blocked, Visible], &[2])), (3, 1));
        assert_eq!(count(2, frame(1, &[Visible, Visible, Visible], &[])), (7, 3), "both others, on both lines");
    }
}
