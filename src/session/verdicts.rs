//! The verdicts of an exercise for a reader who wants to hear of changes only. Without I/O, threads or clocks.
//!
//! What was told last is all that is kept, one verdict a line; so whoever reads slowly is told the newest state, and how
//! much was passed over costs nothing.

use std::collections::{BTreeMap, BTreeSet};

use sightline_proto::v1;

use super::{MAX_SUBSCRIBED_IDS, stated_verdict};
use crate::exercise::Exercise;

/// A reader of verdicts.
#[derive(Debug)]
pub struct VerdictWatch {
    /// The lines that are watched; `None`: all.
    watched: Option<BTreeSet<u64>>,
    told: BTreeMap<u64, (v1::Verdict, v1::UnknownReason)>,
    /// The epoch of the last news; `None` before the first.
    epoch: Option<u64>,
}

impl VerdictWatch {
    /// Watches some lines, or all when there are none in the list. `None`: more than [`MAX_SUBSCRIBED_IDS`].
    pub fn new(sight_lines: &[u64]) -> Option<Self> {
        let watched = (!sight_lines.is_empty()).then(|| sight_lines.iter().copied().collect());
        let is_sound = sight_lines.len() <= MAX_SUBSCRIBED_IDS;
        is_sound.then(|| Self { watched, told: BTreeMap::new(), epoch: None })
    }

    /// What is new in the exercise since the last news; `None` when nothing is. The first news is never `None`.
    pub fn news(&mut self, exercise: &Exercise) -> Option<v1::WatchExerciseResponse> {
        let mut news = v1::WatchExerciseResponse { epoch: exercise.epoch(), ..Default::default() };
        let is_watched = |id: u64| self.watched.as_ref().is_none_or(|watched| watched.contains(&id));
        let mut gone = self.told.keys().copied().peekable();
        for state in exercise.sight_lines().filter(|state| is_watched(state.line.id)) {
            let id = state.line.id;
            news.removed.extend(std::iter::from_fn(|| gone.next_if(|told| *told < id)));
            gone.next_if_eq(&id);
            let (verdict, reason) = stated_verdict(state);
            if self.told.get(&id) != Some(&(verdict, reason)) {
                let (verdict, unknown_reason) = (verdict.into(), reason.into());
                news.changed.push(v1::LineVerdict { id, verdict, unknown_reason });
            }
        }
        news.removed.extend(gone);
        for line in &news.changed {
            self.told.insert(line.id, (line.verdict(), line.unknown_reason()));
        }
        for id in &news.removed {
            self.told.remove(id);
        }
        if let Some(before) = self.epoch {
            let expired = exercise.expirations().iter().filter(|expiration| expiration.epoch > before);
            news.expired_owners = expired.map(|expiration| expiration.owner.to_string()).collect();
        }
        let is_first = self.epoch.replace(exercise.epoch()).is_none();
        let is_news = !(news.changed.is_empty() && news.removed.is_empty() && news.expired_owners.is_empty());
        (is_first || is_news).then_some(news)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        exercise::{Altitude, Anchor, Change, Entity, Frame, Lease, Place, SightLine, Site},
        roam::Fidelity,
        terrain::{MemoryField, SceneScale, synthetic},
    };

    const SITE: Site = Site { scale: SceneScale { east_m: 10.0, north_m: 10.0, up_m: 1.0 }, georeference: None };

    fn change(n: u64, before: &Exercise) -> Change {
        let draw = |k: u64, of: u64| synthetic::mix(100 * n + k) % of;
        // Some stand outside of the grid: there is no ground.
        let position = |k| [draw(k, 430) as f64 / 10.0, draw(k + 50, 200) as f64 / 10.0, 1.0];
        let place = |k| Place { position: position(k), frame: Frame::Grid, altitude: Altitude::AboveGround };
        // Under a lease stand lines only, so that no entity goes with it.
        let is_brief = n % 10 == 9;
        let moved: Vec<u64> =
            if n == 0 { (0..8).collect() } else { (draw(1, 8)..8).take(1 - usize::from(is_brief)).collect() };
        let end = |id| Anchor::Entity { id, offset_m: 0.0 };
        let (a, b) = (draw(2, 8), draw(3, 8));
        let fidelity = Fidelity::Verdict;
        let id = draw(4, 30);
        let line = SightLine { id, a: end(a), b: end(b), fidelity, priority: 0, range_m: None, region: None };
        Change {
            put_entities: moved.into_iter().map(|id| Entity { id, place: place(10 + id), ground_m: None }).collect(),
            put_sight_lines: vec![line],
            remove_sight_lines: before.sight_lines().map(|l| l.line.id).filter(|id| id % 7 == n % 19).collect(),
            lease: is_brief.then(|| Lease::new("brief", 5).unwrap()),
            ..Change::default()
        }
    }

    /// Readers who look at all epochs, at every fifth, and at some lines: each knows the truth of the epoch that it was told
    /// last, and hears of nothing that it knew.
    #[test]
    fn readers_of_any_pace_know_all_verdicts_and_hear_only_news() {
        let field: MemoryField = synthetic::fractal(43, 20, 3, 900).unwrap();
        let some = [1, 5, 9, 77];
        let mut watches = [&[][..], &[], &some].map(|lines| VerdictWatch::new(lines).unwrap());
        let mut known: [BTreeMap<u64, (i32, i32)>; 3] = Default::default();
        let (mut heard, mut expired) = ([0; 3], [0; 3]);
        let mut exercise = Exercise::new("test").unwrap();
        for n in 0..300 {
            exercise = exercise.changed(&change(n, &exercise), &SITE, &field).unwrap();
            if n % 20 == 12 {
                exercise = exercise.expired("brief").unwrap_or(exercise);
            }
            for reader in 0..3 {
                if reader == 1 && n % 5 > 0 {
                    continue;
                }
                let Some(news) = watches[reader].news(&exercise) else { continue };
                heard[reader] += 1;
                expired[reader] += news.expired_owners.len();
                assert_eq!(news.epoch, exercise.epoch());
                for line in news.changed {
                    let verdict = (line.verdict, line.unknown_reason);
                    assert_ne!(known[reader].insert(line.id, verdict), Some(verdict), "line {} was known", line.id);
                }
                for id in news.removed {
                    assert!(known[reader].remove(&id).is_some());
                }
                let truth: BTreeMap<u64, (i32, i32)> = exercise
                    .sight_lines()
                    .filter(|state| reader < 2 || some.contains(&state.line.id))
                    .map(|state| {
                        let wire = super::super::line_to_wire(state);
                        (state.line.id, (wire.verdict, wire.unknown_reason))
                    })
                    .collect();
                assert_eq!(known[reader], truth, "reader {reader} at epoch {}", news.epoch);
            }
        }
        assert!(heard[1] < heard[0] && heard[2] < heard[0] && heard[0] < 300, "{heard:?}");
        assert!(expired[0] > 3 && expired[0] == expired[1] && expired[0] == expired[2], "{expired:?}");
    }

    #[test]
    fn the_first_news_comes_even_of_nothing_and_lists_are_limited() {
        let empty = Exercise::new("test").unwrap();
        let mut watch = VerdictWatch::new(&[]).unwrap();
        assert_eq!(watch.news(&empty), Some(v1::WatchExerciseResponse::default()));
        assert_eq!(watch.news(&empty), None);
        assert!(VerdictWatch::new(&vec![1; MAX_SUBSCRIBED_IDS + 1]).is_none());
    }
}
