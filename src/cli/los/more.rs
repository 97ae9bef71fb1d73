//! What `los --derive` adds to an answer.

use serde_json::{Value, json};
use sightline_client::v1;
use sightline_proto::diamond::Post;

use crate::{
    database::Database,
    los::{self, Derived, GroundState, LineState, LosError, Options, Place, Stretch},
};

/// What takes longer than a verdict.
#[derive(Clone, Debug)]
pub(super) struct More {
    triangles: [Option<[Post; 3]>; 2],
    pub(super) deepest: Option<Place>,
    /// In height units.
    pub(super) least_target_height: Option<f64>,
    line: Vec<Stretch<LineState>>,
    ground: Vec<Stretch<GroundState>>,
}

impl More {
    pub(super) fn new(
        database: &Database,
        a: [f64; 3],
        b: [f64; 3],
        options: Options,
        derived: &Derived,
    ) -> Result<Self, LosError> {
        let target = [b[0], b[1]];
        Ok(Self {
            triangles: [derived.first_from_a, derived.first_from_b].map(|first| first?.triangle),
            deepest: derived.deepest,
            least_target_height: los::least_target_height(database, a, target, options)?,
            line: los::line_stretches(database, a, b, options.earth)?,
            ground: los::ground_stretches(database, a, target, options.earth)?,
        })
    }

    /// As a server tells it.
    pub(super) fn from_wire(response: &v1::QueryLineOfSightResponse) -> Self {
        let triangle = |first: &Option<v1::Obstruction>| match first.as_ref()?.triangle[..] {
            [ai, aj, bi, bj, ci, cj] => Some([Post::new(ai, aj), Post::new(bi, bj), Post::new(ci, cj)]),
            _ => None,
        };
        let deepest = response.deepest.zip(response.deepest_at).map(|(depth, at)| Place {
            point: [at.x, at.y, at.z],
            t: part_of_line(response.resolved.as_ref(), [at.x, at.y, at.z]),
            clearance: -depth,
        });
        let line = response.line.iter().map(|s| {
            let state = match s.state() {
                v1::LineState::Above => LineState::Above,
                v1::LineState::Below => LineState::Below,
                v1::LineState::Unknown | v1::LineState::Unspecified => LineState::Unknown,
            };
            Stretch { from: s.from, to: s.to, state }
        });
        let ground = response.ground.iter().map(|s| {
            let state = match s.state() {
                v1::GroundState::Seen => GroundState::Seen,
                v1::GroundState::Hidden => GroundState::Hidden,
                v1::GroundState::Unknown | v1::GroundState::Unspecified => GroundState::Unknown,
            };
            Stretch { from: s.from, to: s.to, state }
        });
        Self {
            triangles: [triangle(&response.first_from_a), triangle(&response.first_from_b)],
            deepest,
            least_target_height: response.least_target_z,
            line: line.collect(),
            ground: ground.collect(),
        }
    }

    pub(super) fn document(&self) -> Value {
        let [from_a, from_b] = self.triangles.map(|t| t.map(|posts| posts.map(|p| [p.i, p.j])));
        json!({
            "triangle_from_a": from_a,
            "triangle_from_b": from_b,
            "deepest": self.deepest.map(|d| json!({ "position": d.point, "t": d.t, "clearance": d.clearance })),
            "least_target_height": self.least_target_height,
            "line": stretches(&self.line, LineState::name),
            "ground": stretches(&self.ground, GroundState::name),
        })
    }

    pub(super) fn text(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(Place { point: [x, y, z], clearance, .. }) = self.deepest {
            lines.push(format!("deepest   {} height units below ground at ({x}, {y}, {z})", -clearance));
        }
        if let Some(height) = self.least_target_height {
            lines.push(format!("target    is seen from a height of {height} height units"));
        }
        let stretch = |name: &str, from: f64, to: f64, state: &str| {
            format!("{name:9} {:.4} to {:.4} {}", from, to, state.to_lowercase())
        };
        lines.extend(self.line.iter().map(|s| stretch("line", s.from, s.to, s.state.name())));
        lines.extend(self.ground.iter().map(|s| stretch("ground", s.from, s.to, s.state.name())));
        lines
    }
}

/// Where a point of a line is, as a part of it, by the coordinate that changes most.
fn part_of_line(resolved: Option<&v1::Segment>, at: [f64; 3]) -> f64 {
    let Some(v1::Segment { a: Some(a), b: Some(b) }) = resolved else { return 0.0 };
    let along = [(a.x, b.x, at[0]), (a.y, b.y, at[1]), (a.z, b.z, at[2])];
    let most = along.into_iter().max_by(|p, q| (p.1 - p.0).abs().total_cmp(&(q.1 - q.0).abs()));
    most.filter(|(from, to, _)| from != to).map_or(0.0, |(from, to, at)| (at - from) / (to - from))
}

fn stretches<S: Copy>(stretches: &[Stretch<S>], name: fn(S) -> &'static str) -> Vec<Value> {
    stretches.iter().map(|s| json!({ "from": s.from, "to": s.to, "state": name(s.state) })).collect()
}
