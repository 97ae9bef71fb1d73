//! A table as CSV (RFC 4180): numbers in full.

use crate::evaluate::trade::document::{Cell, Table};

/// The table, its columns' names first.
pub(super) fn text(table: &Table) -> String {
    let mut text = line(table.columns.iter().map(|column| column.name.to_owned()));
    for row in &table.rows {
        text += &line(row.iter().map(field));
    }
    text
}

fn line(fields: impl Iterator<Item = String>) -> String {
    fields.map(|field| quoted(&field)).collect::<Vec<_>>().join(",") + "\n"
}

fn field(cell: &Cell) -> String {
    match cell {
        Cell::Text(text) => text.clone(),
        Cell::Number(value) => value.to_string(),
        Cell::Mark(mark) => mark.to_string(),
        Cell::Nothing => String::new(),
    }
}

fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::trade::document::exact;

    #[test]
    fn fields_with_commas_and_quotes_are_quoted() {
        let row = vec![Cell::from("a \"b\", c"), Cell::Number(0.1), Cell::Nothing, Cell::Mark(true)];
        let columns = ["name, unit", "x", "y", "z"].map(exact).to_vec();
        let table = Table { file: "t", title: String::new(), note: String::new(), columns, rows: vec![row] };
        assert_eq!(text(&table), "\"name, unit\",x,y,z\n\"a \"\"b\"\", c\",0.1,,true\n");
    }
}
