//! `sightline los`: exact lines of sight, one or a file of them, on a database or by a server.

pub(super) mod ask;
pub(super) mod batch;
mod more;

use std::path::PathBuf;

use serde_json::{Value, json};

use self::{
    ask::{Asker, Manner, Obstruction, Reply},
    more::More,
};
use super::{
    Context, Failure,
    args::{EarthShape, Point, Positions},
};
use crate::los::{Options, Precision};

/// A sagitta above which the flat frame deserves a warning, in metres.
const WARN_SAGITTA_M: f64 = 1.0;

/// Ask whether points see each other over the finest terrain, exactly.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// A database, or the address of a server, such as http://127.0.0.1:7410.
    #[arg(value_name = "TARGET")]
    target: String,
    /// The observer's end.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "to", required_unless_present = "batch")]
    from: Option<Point>,
    /// The target's end.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "from")]
    to: Option<Point>,
    /// A CSV file with columns ax, ay, az, bx, by, bz, found by their header; other columns are kept.
    #[arg(long, value_name = "F.csv", conflicts_with_all = ["from", "to"])]
    batch: Option<PathBuf>,
    /// Where the lines of a batch go, with their answers appended; - is standard output.
    #[arg(short, value_name = "F", default_value = "-", requires = "batch")]
    output: PathBuf,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    positions: Positions,
    /// Whether touching the ground between the ends blocks, too.
    #[arg(long)]
    strict: bool,
    /// Add what takes longer: the triangles entered, the deepest place, the least target height that would be seen, the
    /// stretches of the line above and below ground, and those of the ground that are seen from 'from'.
    #[arg(long)]
    derive: bool,
    #[command(flatten)]
    earth: EarthShape,
    /// How certain verdicts are: exact; f64 or fast (f32), wrong near ties; tolerance:H, which answers from bounds of
    /// blocks what cannot be wrong by more than H height units. All but exact derive nothing.
    #[arg(long, value_name = "PRECISION", default_value_t = Precision::Exact)]
    precision: Precision,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        if self.derive && self.precision != Precision::Exact {
            return Err(Failure::Usage("--derive needs --precision exact".into()));
        }
        let asker = Asker::open(&self.target)?;
        let earth = asker.earth(self.earth)?;
        if self.derive && asker.is_server() && self.batch.is_some() {
            return Err(Failure::Usage("--derive with --batch needs a database".into()));
        }
        let manner = Manner {
            frame: self.positions.frame(),
            altitude: self.positions.altitude(),
            options: Options { strict: self.strict, precision: self.precision, earth },
            earth: self.earth,
            derive: self.derive,
        };
        match (self.from, self.to, &self.batch) {
            (Some(Point(a)), Some(Point(b)), None) => {
                let reply = asker.ask(manner, [a, b])?;
                if self.earth.sphere().is_none() {
                    warn_of_curvature(context, &reply);
                }
                if context.json {
                    outln!("{:#}", document(&reply));
                } else {
                    out!("{}", text(&reply));
                }
                Ok(())
            }
            (None, None, Some(input)) => batch::run(context, &asker, manner, input, &self.output, self.force),
            _ => Err(Failure::Usage("give either --from and --to, or --batch".into())),
        }
    }
}

fn warn_of_curvature(context: &Context, reply: &Reply) {
    if reply.sagitta_m > WARN_SAGITTA_M && !context.quiet {
        errln!(
            "warning: the Earth bulges by {:.1} m under a line of {:.1} km; the answer is for a flat one",
            reply.sagitta_m,
            reply.range_m / 1000.0
        );
    }
}

fn document(reply: &Reply) -> Value {
    let obstruction = |o: &Option<Obstruction>| o.map(|o| json!({ "position": o.position, "range_m": o.range_m }));
    let mut document = json!({
        "verdict": reply.verdict,
        "reason": reply.reason,
        "grazes": reply.grazes,
        "certain": reply.certain,
        "resolved": reply.resolved.map(|[a, b]| json!({ "a": a, "b": b })),
        "range_m": reply.range_m,
        "sagitta_m": reply.sagitta_m,
        "first_from_a": obstruction(&reply.first_from_a),
        "first_from_b": obstruction(&reply.first_from_b),
        "least_clearance": reply.least_clearance,
    });
    if let Some(more) = &reply.more {
        document["derived"] = more.document();
    }
    document
}

fn text(reply: &Reply) -> String {
    let mut lines = vec![match (reply.grazes, reply.reason) {
        (true, _) => format!("{}, grazing the ground", reply.verdict),
        (_, Some(reason)) => format!("{}: {reason}", reply.verdict),
        _ => reply.verdict.to_owned(),
    }];
    if !reply.certain {
        lines.push("not certain: see --precision".into());
    }
    if let Some([a, b]) = reply.resolved {
        lines.push(format!("from      {} in the grid frame", triple(a)));
        lines.push(format!("to        {}", triple(b)));
        lines.push(format!("range     {:.2} m in plan; sagitta {:.3} m", reply.range_m, reply.sagitta_m));
    }
    for (name, end, obstruction) in [("first", "from", reply.first_from_a), ("last", "to", reply.first_from_b)] {
        if let Some(Obstruction { position, range_m }) = obstruction {
            lines.push(format!("{name:9} below ground at {}, {range_m:.2} m from '{end}'", triple(position)));
        }
    }
    if let Some(clearance) = reply.least_clearance {
        lines.push(format!("clearance {clearance} height units at least"));
    }
    lines.extend(reply.more.iter().flat_map(More::text));
    lines.join("\n") + "\n"
}

fn triple([x, y, z]: [f64; 3]) -> String {
    format!("({x}, {y}, {z})")
}
