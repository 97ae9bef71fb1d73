//! A report as one HTML page that needs nothing else: no script, no font, no picture from elsewhere.

use super::svg;
use crate::evaluate::trade::document::{Block, Cell, Claim, Document, Ruling, Section, Table};

/// Light or dark, as the reader's system has it; black on white on paper.
const STYLE: &str = "
:root{color-scheme:light dark;--ink:#1a1a1a;--paper:#fff;--line:#d4d4d4;--soft:#f4f4f4;--grey:#666}
@media(prefers-color-scheme:dark){:root{--ink:#e6e6e6;--paper:#161616;--line:#444;--soft:#222;--grey:#aaa}}
@media print{:root{--ink:#000;--paper:#fff;--line:#bbb;--soft:#f4f4f4;--grey:#555}body{font-size:9pt}}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1180px;margin:2em auto;
padding:0 1.2em}
h1{font-size:1.7em;line-height:1.2}h2{font-size:1.3em;border-bottom:1px solid var(--line);margin-top:2.2em}
h3{font-size:1.02em;margin:1.6em 0 .2em}p{max-width:78ch}.note{color:var(--grey);font-size:.88em;margin:.2em 0 .6em}
nav a{margin-right:1.2em;color:inherit}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:1.2em}
svg{width:100%;height:auto;break-inside:avoid}svg text{font:12px system-ui,sans-serif;fill:currentColor}
svg .title{font-size:13.5px;font-weight:600}svg .end{text-anchor:end}svg .middle{text-anchor:middle}
svg .grid{stroke:var(--line);stroke-width:.7}svg .axis{stroke:currentColor;fill:none;stroke-width:.9}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:12.5px;line-height:1.3;font-variant-numeric:tabular-nums}
th,td{padding:.16em .5em;text-align:right;vertical-align:top}th{vertical-align:bottom;font-weight:600;max-width:7.5em}
thead th{border-bottom:1.5px solid var(--ink)}td.text,th.text{text-align:left}td.one{white-space:nowrap}
tr.first td{border-top:1px solid var(--line)}tbody tr:hover{background:var(--soft)}
.claims td{font-size:13.5px;line-height:1.4;text-align:left;border-top:1px solid var(--line);padding:.4em .6em}
.claims tr{break-inside:avoid}.ruling{font-weight:600;white-space:nowrap}
summary{cursor:pointer;font-weight:600;margin-top:1.4em}
";

/// The page.
pub(super) fn page(document: &Document) -> String {
    let title = escaped(&document.title);
    let links: String = document
        .sections
        .iter()
        .enumerate()
        .map(|(n, section)| format!("<a href=\"#part-{n}\">{}</a>\n", escaped(&section.title)))
        .collect();
    let sections: String = document.sections.iter().enumerate().map(|(n, s)| part(n, s)).collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title><style>{STYLE}</style></head>\n\
         <body><h1>{title}</h1>\n<nav>{links}</nav>\n{sections}</body></html>\n"
    )
}

fn part(n: usize, section: &Section) -> String {
    let mut html = format!("<h2 id=\"part-{n}\">{}</h2>\n", escaped(&section.title));
    let mut in_figures = false;
    for block in &section.blocks {
        let is_figure = matches!(block, Block::Figure(_));
        if is_figure != in_figures {
            html += if is_figure { "<div class=\"figures\">\n" } else { "</div>\n" };
            in_figures = is_figure;
        }
        html += &match block {
            Block::Text(text) => format!("<p>{}</p>\n", escaped(text)),
            Block::Table(table) => of_table(table),
            Block::Figure(figure) => svg::element(figure),
            Block::Claims(claims) => of_claims(claims),
        };
    }
    html + if in_figures { "</div>\n" } else { "" }
}

/// Words of so many characters are kept on one line.
const ONE_LINE: usize = 34;
/// Tables of more rows are folded up.
const LONG: usize = 40;

fn of_table(table: &Table) -> String {
    let (title, file) = (escaped(&table.title), table.file);
    let note = format!("<p class=\"note\">{} <i>{file}.csv</i></p>\n", escaped(&table.note));
    let body = format!("<div class=\"wide\"><table>\n{}{}</table></div>\n", head(table), rows(table));
    if table.rows.len() > LONG {
        let rows = table.rows.len();
        return format!("<details><summary>{title} ({rows} rows)</summary>\n{note}{body}</details>\n");
    }
    format!("<h3>{title}</h3>\n{note}{body}")
}

/// Whether a column holds words.
fn is_text(table: &Table, column: usize) -> bool {
    table.rows.iter().any(|row| matches!(row.get(column), Some(Cell::Text(_))))
}

fn head(table: &Table) -> String {
    let cell = |(n, column): (usize, &crate::evaluate::trade::document::Column)| {
        let class = if is_text(table, n) { " class=\"text\"" } else { "" };
        format!("<th{class}>{}</th>", escaped(column.name))
    };
    format!("<thead><tr>{}</tr></thead>\n", table.columns.iter().enumerate().map(cell).collect::<String>())
}

fn rows(table: &Table) -> String {
    let is_whole = |n: usize| {
        table.rows.iter().all(|row| match row.get(n) {
            Some(Cell::Number(v)) => !v.is_finite() || v.fract() == 0.0,
            _ => true,
        })
    };
    let whole: Vec<bool> = (0..table.columns.len()).map(is_whole).collect();
    let mut html = String::from("<tbody>\n");
    let mut last: Option<&[Cell]> = None;
    for row in &table.rows {
        // Words that repeat those of the row before are left out, from the left.
        let same = last
            .map_or(0, |last| row.iter().zip(last).take_while(|(a, b)| a == b && matches!(a, Cell::Text(_))).count());
        let first = if same == 0 { " class=\"first\"" } else { "" };
        let cells: String = row
            .iter()
            .enumerate()
            .map(|(n, cell)| match cell {
                Cell::Text(_) if n < same => "<td class=\"text\"></td>".into(),
                Cell::Text(text) => {
                    let class = if text.chars().count() <= ONE_LINE { "text one" } else { "text" };
                    format!("<td class=\"{class}\">{}</td>", escaped(text))
                }
                Cell::Number(v) if whole[n] => format!("<td>{}</td>", whole_number(*v)),
                Cell::Number(v) => format!("<td>{}</td>", short(*v)),
                Cell::Mark(mark) => format!("<td>{}</td>", if *mark { "yes" } else { "no" }),
                Cell::Nothing => "<td>–</td>".into(),
            })
            .collect();
        html += &format!("<tr{first}>{cells}</tr>\n");
        last = Some(row);
    }
    html + "</tbody>"
}

fn of_claims(claims: &[Claim]) -> String {
    let row = |claim: &Claim| {
        let mark = match claim.ruling {
            Ruling::Confirmed => "✓",
            Ruling::Refuted => "✗",
            Ruling::NotReproducible => "?",
            Ruling::Untestable => "–",
        };
        let (text, source) = (escaped(claim.claim), escaped(claim.source));
        let (ruling, found) = (claim.ruling.name(), escaped(&claim.found));
        format!(
            "<tr><td>{text}<br><small>{source}</small></td><td class=\"ruling\">{mark} {ruling}</td><td>{found}</td></tr>\n"
        )
    };
    let rows: String = claims.iter().map(row).collect();
    format!(
        "<table class=\"claims\"><thead><tr><th class=\"text\">claim</th><th class=\"text\">verdict</th>\
         <th class=\"text\">measured in this run</th></tr></thead><tbody>\n{rows}</tbody></table>\n"
    )
}

/// A number of three figures or so.
pub(super) fn short(value: f64) -> String {
    match value.abs() {
        _ if value == f64::INFINITY => "∞".into(),
        0.0 => "0".into(),
        v if v >= 1000.0 => whole_number(value.round()),
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 10.0 => trimmed(format!("{value:.1}")),
        v if v >= 1.0 => trimmed(format!("{value:.2}")),
        v if v >= 0.01 => trimmed(format!("{value:.3}")),
        v if v >= 0.001 => trimmed(format!("{value:.4}")),
        _ => format!("{value:.0e}"),
    }
}

/// Without zeros at its end.
fn trimmed(text: String) -> String {
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A whole number, its thousands apart.
fn whole_number(value: f64) -> String {
    if value == f64::INFINITY {
        return "∞".into();
    }
    let digits = format!("{:.0}", value.abs());
    let mut text = String::from(if value < 0.0 { "-" } else { "" });
    for (n, digit) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n) % 3 == 0 && digits.len() > 4 {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// Text as it stands in HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::trade::document::{Axis, Figure, Series, exact};

    fn document() -> Document {
        let row = |name: &str, value| vec![Cell::from(name), Cell::Number(value), Cell::Mark(true), Cell::Nothing];
        let table = |file, rows: usize| Table {
            file,
            title: "a < b".into(),
            note: "\"quoted\"".into(),
            columns: ["terrain", "x, m", "kept", "none"].map(exact).to_vec(),
            rows: (0..rows).map(|n| row("hills & dales", n as f64 + 0.5)).collect(),
        };
        let series = |name: &str, is_own| Series { name: name.into(), points: vec![[10.0, 1.0], [100.0, 0.0]], is_own };
        let axis = |label| Axis { label, is_log: true };
        let figure = Figure {
            title: "error".into(),
            across: axis("triangles"),
            up: axis("metres"),
            series: vec![series("<other>", false), series("own", true)],
            is_joined: true,
        };
        let claim = Claim { source: "X", claim: "c", ruling: Ruling::Refuted, found: "1 < 2".into() };
        let blocks = vec![
            Block::Text("one".into()),
            Block::Figure(figure.clone()),
            Block::Figure(figure),
            Block::Table(table("short", 2)),
            Block::Table(table("long", LONG + 1)),
            Block::Claims(vec![claim]),
        ];
        Document { title: "t".into(), sections: vec![Section { title: "s".into(), blocks }] }
    }

    #[test]
    fn a_page_is_whole_and_needs_nothing_else() {
        let page = page(&document());
        for tag in ["html", "body", "div", "table", "tr", "td", "th", "svg", "text", "details", "p", "a", "style"] {
            let opened = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
            assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
        for outside in ["http", "<script", "src=", "<link", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert!(
            page.contains("hills &amp; dales") && page.contains("&lt;other&gt;") && page.contains("&quot;quoted&quot;")
        );
        // Words that repeat are said once; both tables say them once.
        assert_eq!(page.matches("hills &amp; dales").count(), 2);
        assert_eq!(page.matches("<div class=\"figures\">").count(), 1, "figures that follow each other stand together");
    }

    #[test]
    fn numbers_have_three_figures() {
        let all = [0.0, 12_345.6, 123.4, 12.34, 1.5, 0.1234, 0.00042, f64::INFINITY, -2.0].map(short);
        assert_eq!(all, ["0", "12\u{202f}346", "123", "12.3", "1.5", "0.123", "4e-4", "∞", "-2"]);
        assert_eq!(whole_number(1024.0), "1024");
    }
}
