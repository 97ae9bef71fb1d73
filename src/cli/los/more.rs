//! What `los --derive` adds to an answer.

use serde_json::{Value, json};
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
    /// `None` on a curved Earth.
    ground: Option<Vec<Stretch<GroundState>>>,
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
        let flat = options.earth.is_flat();
        Ok(Self {
            triangles: [derived.first_from_a, derived.first_from_b].map(|first| first?.triangle),
            deepest: derived.deepest,
            least_target_height: los::least_target_height(database, a, target, options)?,
            line: los::line_stretches(database, a, b, options.earth)?,
            ground: flat.then(|| los::ground_stretches(database, a, target)).transpose()?,
        })
    }

    pub(super) fn document(&self) -> Value {
        let [from_a, from_b] = self.triangles.map(|t| t.map(|posts| posts.map(|p| [p.i, p.j])));
        json!({
            "triangle_from_a": from_a,
            "triangle_from_b": from_b,
            "deepest": self.deepest.map(|d| json!({ "position": d.point, "t": d.t, "clearance": d.clearance })),
            "least_target_height": self.least_target_height,
            "line": stretches(&self.line, line_state),
            "ground": self.ground.as_ref().map(|ground| stretches(ground, ground_state)),
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
        lines.extend(self.line.iter().map(|s| stretch("line", s.from, s.to, line_state(s.state))));
        lines.extend(self.ground.iter().flatten().map(|s| stretch("ground", s.from, s.to, ground_state(s.state))));
        lines
    }
}

fn stretches<S: Copy>(stretches: &[Stretch<S>], name: fn(S) -> &'static str) -> Vec<Value> {
    stretches.iter().map(|s| json!({ "from": s.from, "to": s.to, "state": name(s.state) })).collect()
}

fn line_state(state: LineState) -> &'static str {
    match state {
        LineState::Above => "ABOVE",
        LineState::Below => "BELOW",
        LineState::Unknown => "UNKNOWN",
    }
}

fn ground_state(state: GroundState) -> &'static str {
    match state {
        GroundState::Seen => "SEEN",
        GroundState::Hidden => "HIDDEN",
        GroundState::Unknown => "UNKNOWN",
    }
}
