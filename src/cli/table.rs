//! A file of points: CSV whose columns are found by their header; other columns are kept.

use std::path::Path;

use super::{Failure, los::batch::fields, output::read_text};

/// The points of a file.
pub(super) struct Points {
    pub(super) header: String,
    /// The rows as they stand in the file.
    pub(super) rows: Vec<String>,
    /// Where each row stands in the file, from 1.
    pub(super) numbers: Vec<usize>,
    /// x, y and, where there is such a column, z of each.
    pub(super) points: Vec<([f64; 2], Option<f64>)>,
    /// The `name` of each, or its number from 1.
    pub(super) names: Vec<String>,
}

impl Points {
    /// Reads columns x, y and maybe z and name; without `optional_z` there must be a z. An error names the line.
    pub(super) fn read(path: &Path, optional_z: bool) -> Result<Self, Failure> {
        let text = read_text(path)?;
        Self::parse(&text, optional_z).map_err(|why| Failure::input(path.display(), why))
    }

    fn parse(text: &str, optional_z: bool) -> Result<Self, String> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let (_, header) = lines.next().ok_or("it is empty: the first line names columns x, y and z")?;
        let names: Vec<_> = fields(header).iter().map(|name| name.trim().to_ascii_lowercase()).collect();
        let column = |wanted: &str| {
            let mut found = names.iter().enumerate().filter(|(_, name)| *name == wanted);
            let first = found.next().map(|(n, _)| n);
            match found.next() {
                Some(_) => Err(format!("line 1 names column {wanted} twice")),
                None => Ok(first),
            }
        };
        let required = |wanted: &str| {
            column(wanted)?.ok_or_else(|| format!("line 1 names no column '{wanted}': it must be a header like x,y,z"))
        };
        let (x, y) = (required("x")?, required("y")?);
        let z = if optional_z { column("z")? } else { Some(required("z")?) };
        let name = column("name")?;
        let mut table = Self { header: header.into(), rows: vec![], numbers: vec![], points: vec![], names: vec![] };
        for (n, line) in lines {
            let row = fields(line);
            let at_line = |why: String| format!("line {}: {why}", n + 1);
            if row.len() != names.len() {
                return Err(at_line(format!("{} fields where the header has {}", row.len(), names.len())));
            }
            let number = |place: usize| match row[place].trim().parse::<f64>() {
                Ok(v) if v.is_finite() => Ok(v),
                _ => Err(at_line(format!("{} is '{}', not a finite number", names[place], row[place].trim()))),
            };
            table.points.push(([number(x)?, number(y)?], z.map(number).transpose()?));
            table.names.push(name.map_or_else(|| (table.rows.len() + 1).to_string(), |k| row[k].trim().to_owned()));
            table.rows.push(line.into());
            table.numbers.push(n + 1);
        }
        if table.rows.is_empty() {
            return Err("it names columns but has no points".into());
        }
        Ok(table)
    }
}

/// A field of CSV, in quotes where it needs them.
pub(super) fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_errors_name_the_line() {
        let table = Points::parse("name,Z,extra,y,x\n\"a, b\",3,q,2,1\n\nc,6,,5,4\n", false).unwrap();
        assert_eq!(table.points, [([1.0, 2.0], Some(3.0)), ([4.0, 5.0], Some(6.0))]);
        assert_eq!(
            (table.names.as_slice(), table.numbers.as_slice()),
            (&["a, b".to_owned(), "c".into()][..], &[2, 4][..])
        );
        assert_eq!(Points::parse("x,y\n1,2\n", true).unwrap().points, [([1.0, 2.0], None)]);
        for (text, why) in [
            ("", "empty"),
            ("x,y\n1,2\n", "'z'"),
            ("x,y,z,x\n", "twice"),
            ("x,y,z\n", "no points"),
            ("x,y,z\n1,2,3\n1,2\n", "line 3: 2 fields"),
            ("x,y,z\n1,NaN,3\n", "line 2: y is 'NaN'"),
        ] {
            let error = Points::parse(text, false).err().unwrap_or_default();
            assert!(error.contains(why), "{text:?}: {error}");
        }
        assert_eq!(quoted("a, \"b\""), "\"a, \"\"b\"\"\"");
    }
}
