//! What a user should choose when: for each need, who serves it best by the numbers of this run, and which numbers those are.

use super::{
    contender::Contender,
    document::{Block, Cell, Section, Table, exact, timed},
    findings::Findings,
    greatest, mean, median,
    meshes::Row,
    queries::Way,
};
use crate::los::Precision;

/// Exact answers are advised where they cost no more than so many times the rounded ones.
const WORTH_IT: f64 = 1.5;

/// What is needed, the unit in which it is measured, and the measure: less is better.
type Need = (&'static str, &'static str, fn(&Row) -> f64);

/// The page.
pub(super) fn section(found: &Findings<'_>) -> Section {
    let mut rows = vec![consistent(found)];
    let needs: [Need; 7] = [
        ("the picture nearest to the finest terrain", "px RMS", |row| row.still.distortion_rms_px),
        ("the least vertical error over the whole terrain", "m RMS", |row| row.still.rms_m),
        ("the fewest wrong sight lines between others, none registered", "% wrong", |row| {
            row.still.others.silent_percent()
        }),
        ("the least time for a frame", "ms", |row| 1e3 * row.flown.frame_s),
        ("the smallest jumps, without morphing", "px at most", |row| row.flown.pops.largest_px),
        ("the least memory besides the heights", "MB", |row| 1e-6 * row.flown.memory_bytes as f64),
        ("the least change from frame to frame", "% of triangles", |row| 100.0 * mean(&row.flown.changed_shares)),
    ];
    rows.extend(needs.into_iter().map(|(need, unit, value)| best(found, need, unit, value)));
    rows.extend([edits(found), precision(found), fidelity(found)]);
    let table = Table {
        file: "choose",
        title: format!("Who needs what, at {} triangles", found.usual_count),
        note: "Of all systems, the one whose values are least beside the median of each terrain, on average, and the \
               next. Sightline with lines registered is left out where it only repeats Sightline."
            .into(),
        columns: vec![exact("who needs"), timed("should choose"), timed("because")],
        rows,
    };
    Section { title: "What to choose when".into(), blocks: vec![Block::Table(table), Block::Table(main_table(found))] }
}

fn row(need: &str, choice: impl Into<Cell>, because: String) -> Vec<Cell> {
    vec![need.into(), choice.into(), because.into()]
}

fn consistent(found: &Findings<'_>) -> Vec<Cell> {
    let at_usual = |contender: Contender| found.meshes.iter().filter(move |row| row.contender == contender);
    let silent: usize = at_usual(Contender::Kept).map(|row| row.still.viewer.silent + row.still.others.silent).sum();
    let named: usize = at_usual(Contender::Kept).map(|row| row.still.viewer.named + row.still.others.named).sum();
    let lines: usize = at_usual(Contender::Kept).map(|row| row.still.viewer.lines + row.still.others.lines).sum();
    let others = found.meshes.iter().filter(|row| row.contender != Contender::Kept);
    let shares: Vec<_> = others.map(|row| row.still.others.silent_percent()).collect();
    let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
    let because = format!(
        "{silent} of {lines} lines wrong in silence, {named} named; on meshes that do not know of the lines {least:.1} to \
         {:.1} % of those between others are wrong",
        greatest(&shares)
    );
    let choice = if silent == 0 { Contender::Kept.name() } else { "none of these" };
    row("the right answer for given sight lines on every mesh", choice, because)
}

/// The contender whose values are the least beside the median of all, on average over the terrains, and the next.
fn best(found: &Findings<'_>, need: &str, unit: &str, value: fn(&Row) -> f64) -> Vec<Cell> {
    let contenders: Vec<_> = Contender::all().filter(|c| *c != Contender::Kept).collect();
    let of = |contender: Contender| -> Vec<f64> {
        (0..found.worlds.len()).filter_map(|world| found.usual(world, contender).map(value)).collect()
    };
    let values: Vec<_> = contenders.iter().map(|&c| of(c)).collect();
    // Beside the median, since the least value may be 0.
    let usual = |world: usize| {
        let of_world: Vec<_> = values.iter().filter_map(|v| v.get(world)).copied().collect();
        median(&of_world).max(f64::MIN_POSITIVE)
    };
    let score = |v: &[f64]| mean(&v.iter().enumerate().map(|(world, v)| v / usual(world)).collect::<Vec<_>>());
    let mut order: Vec<_> = values.iter().zip(&contenders).map(|(v, c)| (score(v), v, c)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let text = |v: &[f64]| v.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ");
    let [Some((_, first, winner)), second] = [order.first(), order.get(1)] else {
        return row(need, "–", String::new());
    };
    let next = second.map_or(String::new(), |(_, v, c)| format!("; next {}: {}", c.name(), text(v)));
    row(need, winner.name(), format!("{} {unit} on the terrains in turn{next}", text(first)))
}

fn edits(found: &Findings<'_>) -> Vec<Cell> {
    let mut order: Vec<_> = found.criteria.iter().map(|row| (row.edit_s, row.contender)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let name = |n: usize| order.get(n).map_or("–", |(_, contender)| contender.name());
    let ms = |n: usize| order.get(n).map_or(f64::NAN, |(seconds, _)| 1e3 * seconds);
    let because = format!("{:.3} ms to take up an edit of 16 x 16 posts; next {}: {:.2} ms", ms(0), name(1), ms(1));
    row("terrain that changes", name(0), because)
}

fn precision(found: &Findings<'_>) -> Vec<Cell> {
    let rate = |way: Way| {
        let rows = found.queries.iter().filter(|row| row.way == way);
        mean(&rows.map(|row| row.per_second).collect::<Vec<_>>())
    };
    let wrong = |is: fn(Way) -> bool| {
        let rows: Vec<_> = found.queries.iter().filter(|row| is(row.way)).collect();
        let (wrong, lines) = rows.iter().fold((0, 0), |(w, n), row| (w + row.wrong, n + row.lines));
        100.0 * wrong as f64 / lines.max(1) as f64
    };
    let factor = rate(Way::Precision(Precision::F64)) / rate(Way::Precision(Precision::Exact));
    // Without a clock nothing speaks against the exact answer.
    let choice = if factor > WORTH_IT { "EXACT, and F64 where ties do not matter" } else { "EXACT" };
    let factor = if factor.is_finite() { format!("F64 is {factor:.2} times as fast") } else { "not timed".into() };
    let because = format!(
        "{factor} and wrong for {:.3} % of all lines asked, FAST for {:.3} %, sampling every post for {:.2} %, T-Strip's walk \
         for {:.3} %",
        wrong(|way| way == Way::Precision(Precision::F64)),
        wrong(|way| way == Way::Precision(Precision::Fast)),
        wrong(|way| way == Way::Sampling),
        wrong(|way| way == Way::LineTo)
    );
    row("verdicts of lines of sight", choice, because)
}

fn fidelity(found: &Findings<'_>) -> Vec<Cell> {
    // Where all lines are held, so that what is named does not flatter.
    let held = |asked: &str| {
        let rows = found.fidelity.iter().filter(|row| row.asked.starts_with(asked) && row.named == 0);
        let all: Vec<_> = rows.collect();
        let (stolen, lines) = all.iter().fold((0, 0), |(s, n), row| (s + row.stolen, n + row.lines));
        if lines == 0 { "none held".into() } else { format!("{:.1}", stolen as f64 / lines as f64) }
    };
    let because = format!(
        "triangles stolen by a line where all are held: VERDICT {}, OBSTRUCTION {}, WEDGIE {}, PROFILE {}",
        held("VERDICT"),
        held("OBSTRUCTION"),
        held("WEDGIE"),
        held("PROFILE")
    );
    row("sight lines on a mesh", "VERDICT, and more only where the place or the profile counts", because)
}

/// The contenders at the usual number, in few columns.
fn main_table(found: &Findings<'_>) -> Table {
    let rows = found.meshes.iter().filter(|row| row.wanted == found.usual_count);
    let cells = |row: &Row| {
        vec![
            found.name(row.world).into(),
            row.contender.name().into(),
            Cell::number(row.still.triangles.round()),
            Cell::number(row.still.max_m),
            Cell::number(row.still.rms_m),
            Cell::number(row.still.distortion_px),
            Cell::number(row.still.distortion_rms_px),
            Cell::number(row.still.viewer.silent_percent()),
            Cell::number(row.still.others.silent_percent()),
            Cell::number(row.flown.pops.largest_px),
            Cell::number(100.0 * mean(&row.flown.changed_shares)),
            Cell::number(1e3 * row.flown.frame_s),
            Cell::number(1e3 * row.flown.preparation_s),
            Cell::number(1e-6 * row.flown.memory_bytes as f64),
        ]
    };
    Table {
        file: "main",
        title: format!("All systems at {} triangles", found.usual_count),
        note: "The same for other numbers of triangles, and what each column means, under \"Meshes\".".into(),
        columns: vec![
            exact("terrain"),
            exact("system"),
            exact("triangles"),
            exact("error max, m"),
            exact("error RMS, m"),
            exact("distortion max, px"),
            exact("distortion RMS, px"),
            exact("wrong from viewer, %"),
            exact("wrong between others, %"),
            exact("jump max, px"),
            exact("changed a frame, %"),
            timed("frame, ms"),
            timed("prepare, ms"),
            exact("memory, MB"),
        ],
        rows: rows.map(cells).collect(),
    }
}
