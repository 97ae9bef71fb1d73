//! A file of lines of sight: read by header, answered in order, written back with the answers appended.

use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

use serde_json::{Value, json};

use super::{
    WARN_SAGITTA_M,
    ask::{Asker, Brief, Manner, Obstruction, Reply},
    document,
};
use crate::cli::{Context, Failure, args};

/// The columns that a file must have.
const COLUMNS: [&str; 6] = ["ax", "ay", "az", "bx", "by", "bz"];
/// The columns appended to a file of lines by a database. Positions are in the grid frame; the clearance is in height
/// units.
const ANSWERS: &str = "verdict,grazes,range_m,sagitta_m,\
    first_from_a_x,first_from_a_y,first_from_a_z,first_from_a_range_m,\
    first_from_b_x,first_from_b_y,first_from_b_z,first_from_b_range_m,least_clearance,certain";
/// What `--derive` adds, in height units.
const MORE_ANSWERS: &str = "deepest,least_target_height";
/// Those appended by a server, which answers batches in brief.
const BRIEF_ANSWERS: &str = "verdict,grazes";

/// The lines of a file, as text and as numbers.
pub(in crate::cli) struct Table {
    header: String,
    rows: Vec<String>,
    /// Where each row stands in the file, from 1.
    pub(in crate::cli) numbers: Vec<usize>,
    pub(in crate::cli) ends: Vec<[[f64; 3]; 2]>,
}

/// Answers all lines of `input` and writes them to `output`.
pub(super) fn run(
    context: &Context,
    asker: &Asker,
    manner: Manner,
    input: &Path,
    output: &PathBuf,
    force: bool,
) -> Result<(), Failure> {
    let to_standard_output = output.as_os_str() == "-";
    if !to_standard_output {
        args::refuse_existing(output, force)?;
    }
    let bytes = fs::read(input).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Failure::input(input.display(), error),
        _ => Failure::environment(input.display(), error),
    })?;
    let text = String::from_utf8(bytes).map_err(|_| Failure::input(input.display(), "it is not UTF-8 text"))?;
    let table = parse(&text).map_err(|why| Failure::input(input.display(), why))?;
    let named = |(n, failure): (usize, Failure)| match failure {
        Failure::Input(why) => Failure::input(format!("{}: line {}", input.display(), table.numbers[n]), why),
        failure => failure,
    };
    let (csv, verdicts, answers) = match asker.ask_all(manner, &table.ends) {
        Some(replies) => {
            let replies = replies.map_err(named)?;
            if manner.earth.sphere().is_none() {
                warn_of_curvature(context, &replies);
            }
            let verdicts: Vec<Brief> = replies.iter().map(|r| (r.verdict, r.grazes)).collect();
            let documents: Vec<Value> = replies.iter().map(document).collect();
            let names = if manner.derive { format!("{ANSWERS},{MORE_ANSWERS}") } else { ANSWERS.to_owned() };
            (written(&table, &names, replies.iter().map(|reply| columns(reply, manner))), verdicts, documents)
        }
        None => {
            let briefs = asker.ask_server(manner, &table.ends)?;
            let documents = briefs.iter().map(|(verdict, grazes)| json!({ "verdict": verdict, "grazes": grazes }));
            let csv = written(&table, BRIEF_ANSWERS, briefs.iter().map(|(v, g)| format!("{v},{g}")));
            (csv, briefs.clone(), documents.collect())
        }
    };
    let summary = summary(&verdicts);
    if !to_standard_output {
        write_file(output, &csv)?;
    }
    if context.json {
        // Standard output holds one document: the answers are in it unless they went to a file.
        let answers = if to_standard_output { Value::from(answers) } else { Value::Null };
        outln!("{:#}", json!({ "summary": summary, "answers": answers, "output": output }));
    } else if to_standard_output {
        let written = std::io::stdout().lock().write_all(csv.as_bytes());
        written.map_err(|error| Failure::environment("standard output", error))?;
    }
    if !context.quiet && !context.json {
        errln!(
            "{} lines: {} visible ({} grazing), {} unknown, {} blocked",
            summary["lines"],
            summary["visible"],
            summary["grazing"],
            summary["unknown"],
            summary["blocked"]
        );
    }
    Ok(())
}

fn write_file(path: &Path, text: &str) -> Result<(), Failure> {
    fs::write(path, text).map_err(|error| Failure::environment(format!("writing {}", path.display()), error))
}

fn summary(verdicts: &[Brief]) -> Value {
    let count = |name: &str| verdicts.iter().filter(|(verdict, _)| *verdict == name).count();
    json!({
        "lines": verdicts.len(), "visible": count("VISIBLE"), "unknown": count("UNKNOWN"),
        "blocked": count("BLOCKED"), "grazing": verdicts.iter().filter(|(_, grazes)| *grazes).count(),
    })
}

fn warn_of_curvature(context: &Context, replies: &[Reply]) {
    let bent = replies.iter().filter(|r| r.sagitta_m > WARN_SAGITTA_M).count();
    let worst = replies.iter().map(|r| r.sagitta_m).fold(0.0, f64::max);
    if bent > 0 && !context.quiet {
        errln!("warning: the Earth bulges by up to {worst:.1} m under {bent} of the lines; answers are for a flat one");
    }
}

/// Reads a table of lines; an error names the line of the file.
pub(in crate::cli) fn parse(text: &str) -> Result<Table, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, header) = lines.next().ok_or("it is empty: the first line names the columns ax,ay,az,bx,by,bz")?;
    let names = fields(header);
    let mut places = [0; 6];
    for (place, column) in places.iter_mut().zip(COLUMNS) {
        let mut found = names.iter().enumerate().filter(|(_, name)| name.trim().eq_ignore_ascii_case(column));
        *place = found.next().ok_or_else(|| format!("line 1 names no column {column}; it reads '{header}'"))?.0;
        if found.next().is_some() {
            return Err(format!("line 1 names column {column} twice"));
        }
    }
    let mut table = Table { header: header.into(), rows: Vec::new(), numbers: Vec::new(), ends: Vec::new() };
    for (n, line) in lines {
        let row = fields(line);
        let at_line = |why: String| format!("line {}: {why}", n + 1);
        if row.len() != names.len() {
            return Err(at_line(format!("{} fields where the header has {}", row.len(), names.len())));
        }
        let mut numbers = [0.0; 6];
        for ((number, place), column) in numbers.iter_mut().zip(places).zip(COLUMNS) {
            *number = match row[place].trim().parse::<f64>() {
                Ok(v) if v.is_finite() => v,
                _ => return Err(at_line(format!("{column} is '{}', not a finite number", row[place].trim()))),
            };
        }
        let [ax, ay, az, bx, by, bz] = numbers;
        table.ends.push([[ax, ay, az], [bx, by, bz]]);
        table.rows.push(line.into());
        table.numbers.push(n + 1);
    }
    if table.rows.is_empty() {
        return Err("it names columns but has no lines of sight".into());
    }
    Ok(table)
}

/// The fields of a line of CSV: separated by commas outside double quotes, quotes taken off.
pub(in crate::cli) fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match (c, fields.last_mut()) {
            ('"', _) => quoted = !quoted,
            (',', _) if !quoted => fields.push(String::new()),
            (c, Some(field)) => field.push(c),
            (_, None) => {}
        }
    }
    fields
}

fn written(table: &Table, names: &str, answers: impl Iterator<Item = String>) -> String {
    let mut out = format!("{},{names}\n", table.header);
    for (row, answer) in table.rows.iter().zip(answers) {
        out += &format!("{row},{answer}\n");
    }
    out
}

/// The values of [`ANSWERS`]; what a line does not have is left empty.
fn columns(reply: &Reply, manner: Manner) -> String {
    let obstruction = |o: Option<Obstruction>| {
        o.map_or(",,,".to_owned(), |Obstruction { position: [x, y, z], range_m }| format!("{x},{y},{z},{range_m}"))
    };
    let resolved = |v: f64| reply.resolved.map_or(String::new(), |_| v.to_string());
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let more = reply.more.as_ref();
    let derived = [
        number(more.and_then(|more| more.deepest).map(|place| place.clearance)),
        number(more.and_then(|more| more.least_target_height)),
    ];
    let mut columns = vec![
        reply.verdict.to_owned(),
        reply.grazes.to_string(),
        resolved(reply.range_m),
        resolved(reply.sagitta_m),
        obstruction(reply.first_from_a),
        obstruction(reply.first_from_b),
        number(reply.least_clearance),
        reply.certain.to_string(),
    ];
    if manner.derive {
        columns.extend(derived);
    }
    columns.join(",")
}
