//! What a report says, without its form: tables, figures and claims in sections. `cli` turns it into HTML, SVG and CSV.

/// A report.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Document {
    /// Its title.
    pub title: String,
    /// Its parts, in order.
    pub sections: Vec<Section>,
}

impl Document {
    /// All tables, in order.
    pub fn tables(&self) -> impl Iterator<Item = &Table> {
        self.sections.iter().flat_map(|section| &section.blocks).filter_map(|block| match block {
            Block::Table(table) => Some(table),
            _ => None,
        })
    }
}

/// A part of a report.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// What it consists of, in order.
    pub blocks: Vec<Block>,
}

/// A piece of a section.
#[derive(Clone, PartialEq, Debug)]
pub enum Block {
    /// A paragraph.
    Text(String),
    /// A table.
    Table(Table),
    /// A figure.
    Figure(Figure),
    /// Claims of the papers, each with its verdict.
    Claims(Vec<Claim>),
}

/// What stands in a table.
#[derive(Clone, PartialEq, Debug)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A finite number, or +infinity.
    Number(f64),
    /// Yes or no.
    Mark(bool),
    /// There is no such value.
    Nothing,
}

impl Cell {
    /// A number; nothing for NaN, -infinity and a value that is not there.
    pub fn number(value: impl Into<Option<f64>>) -> Self {
        match value.into() {
            Some(v) if v.is_finite() || v == f64::INFINITY => Self::Number(v),
            _ => Self::Nothing,
        }
    }

    /// A count.
    pub fn count(value: usize) -> Self {
        Self::Number(value as f64)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// A column of a table.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Column {
    /// What stands in it; the last words may be its unit, after a comma.
    pub name: &'static str,
    /// Whether it was taken from a clock, so that it differs from run to run.
    pub is_timed: bool,
}

/// A column whose values are the same in every run.
pub const fn exact(name: &'static str) -> Column {
    Column { name, is_timed: false }
}

/// A column of times.
pub const fn timed(name: &'static str) -> Column {
    Column { name, is_timed: true }
}

/// A table.
#[derive(Clone, PartialEq, Debug)]
pub struct Table {
    /// Its name as a file, without an ending; unique in a report.
    pub file: &'static str,
    /// What it shows.
    pub title: String,
    /// How to read it.
    pub note: String,
    /// Its columns.
    pub columns: Vec<Column>,
    /// A cell for each column.
    pub rows: Vec<Vec<Cell>>,
}

/// An axis of a figure.
#[derive(Clone, PartialEq, Debug)]
pub struct Axis {
    /// What is along it, and its unit.
    pub label: &'static str,
    /// Whether it is logarithmic; values that are not above 0 then have no place.
    pub is_log: bool,
}

/// A named curve.
#[derive(Clone, PartialEq, Debug)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// Its points, in order.
    pub points: Vec<[f64; 2]>,
    /// Whether it is this project's.
    pub is_own: bool,
}

/// Curves over common axes.
#[derive(Clone, PartialEq, Debug)]
pub struct Figure {
    /// What it shows.
    pub title: String,
    /// From left to right.
    pub across: Axis,
    /// Upwards.
    pub up: Axis,
    /// The curves.
    pub series: Vec<Series>,
    /// Whether the points of a curve are joined.
    pub is_joined: bool,
}

/// What a measurement says about a claim.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Ruling {
    /// It holds here.
    Confirmed,
    /// It does not hold here.
    Refuted,
    /// It cannot be measured again: what it rests on is not known.
    NotReproducible,
    /// It is about something that is not here.
    Untestable,
}

impl Ruling {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Confirmed => "confirmed",
            Self::Refuted => "refuted",
            Self::NotReproducible => "not reproducible",
            Self::Untestable => "untestable here",
        }
    }

    /// Confirmed or refuted.
    pub fn of(holds: bool) -> Self {
        if holds { Self::Confirmed } else { Self::Refuted }
    }
}

/// A claim of a paper.
#[derive(Clone, PartialEq, Debug)]
pub struct Claim {
    /// Whose it is.
    pub source: &'static str,
    /// What it says.
    pub claim: &'static str,
    /// Whether it holds.
    pub ruling: Ruling,
    /// What was measured.
    pub found: String,
}
