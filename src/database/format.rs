//! The header and the table of sections, byte by byte as `FORMAT.md` says, and their checks.
//!
//! Every offset is computed from the one before. Sections lie end to end from behind the table to the end of the file,
//! so every byte belongs to exactly one, and each is under a checksum.

use xxhash_rust::xxh3::xxh3_64;

use super::error::OpenError;

/// The first bytes of every database. The high bit, the line ends and the control-Z show what a text-mode copy did.
pub(super) const MAGIC: [u8; 8] = *b"\x8bSLDB\r\n\x1a";
/// Version of the format that is written. Those before are still read: the first one without constant pages, the second
/// without heights beside bounds.
pub(super) const VERSION: u32 = 3;

const VERSION_AT: usize = MAGIC.len();
const SECTIONS_AT: usize = VERSION_AT + 4;
const LENGTH_AT: usize = SECTIONS_AT + 4;
const TABLE_CHECKSUM_AT: usize = LENGTH_AT + 8;
const HEADER_CHECKSUM_AT: usize = TABLE_CHECKSUM_AT + 8;
/// Bytes of the header.
pub(super) const HEADER_BYTES: usize = HEADER_CHECKSUM_AT + 8;
/// Bytes of an entry of the table.
pub(super) const SECTION_BYTES: usize = 56;
/// Greatest number of sections: a manifest, heights, 29 lattices of bounds, corners, 5 levels of extremes, and nearly as many
/// again for later kinds.
pub(super) const MAX_SECTIONS: u32 = 64;

/// The bit of a section's flags that says that a reader which does not know its kind must refuse the file.
pub(super) const REQUIRED: u32 = 1;

/// What a section holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// One envelope.
    Manifest,
    /// Pages of heights.
    Heights,
    /// Pages of bounds on the lattice of step 2^level.
    Bounds,
    /// Pages of the least and greatest heights of blocks of posts. Optional.
    Extremes,
    /// Heights of the corners of the root square. Optional.
    Corners,
    /// Something that this version does not know and need not.
    Other(u32),
}

impl Kind {
    fn from_number(n: u32) -> Self {
        match n {
            1 => Self::Manifest,
            2 => Self::Heights,
            3 => Self::Bounds,
            4 => Self::Extremes,
            5 => Self::Corners,
            n => Self::Other(n),
        }
    }

    pub(super) fn number(self) -> u32 {
        match self {
            Self::Manifest => 1,
            Self::Heights => 2,
            Self::Bounds => 3,
            Self::Extremes => 4,
            Self::Corners => 5,
            Self::Other(n) => n,
        }
    }
}

/// What one element of a section is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Element {
    /// A byte of an envelope.
    Byte,
    /// A 16-bit height.
    I16,
    /// A 32-bit height.
    I32,
    /// Three f32: tight, nested, radius. Read, but no longer written.
    Bounds,
    /// The same in 24 bits each: an f32 that is not negative without its sign and its last seven bits. Read, but no longer
    /// written.
    ShortBounds,
    /// Short bounds, and the height of their post in 16 bits.
    BoundsI16,
    /// Short bounds, and the height of their post in 32 bits.
    BoundsI32,
    /// A least and a greatest height, of 16 bits each.
    PairI16,
    /// The same of 32 bits each.
    PairI32,
    /// Of a section that is skipped.
    Other(u32),
}

impl Element {
    fn from_number(n: u32) -> Self {
        match n {
            0 => Self::Byte,
            1 => Self::I16,
            2 => Self::I32,
            3 => Self::Bounds,
            4 => Self::ShortBounds,
            5 => Self::PairI16,
            6 => Self::PairI32,
            7 => Self::BoundsI16,
            8 => Self::BoundsI32,
            n => Self::Other(n),
        }
    }

    /// Whether its cells are quads of bounds.
    pub(super) fn is_of_bounds(self) -> bool {
        matches!(self, Self::Bounds | Self::ShortBounds | Self::BoundsI16 | Self::BoundsI32)
    }

    /// Whether heights stand beside bounds, which format versions before the third do not have.
    pub(super) fn has_heights_beside(self) -> bool {
        matches!(self, Self::BoundsI16 | Self::BoundsI32)
    }

    pub(super) fn number(self) -> u32 {
        match self {
            Self::Byte => 0,
            Self::I16 => 1,
            Self::I32 => 2,
            Self::Bounds => 3,
            Self::ShortBounds => 4,
            Self::PairI16 => 5,
            Self::PairI32 => 6,
            Self::BoundsI16 => 7,
            Self::BoundsI32 => 8,
            Self::Other(n) => n,
        }
    }
}

/// An entry of the table of sections.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Section {
    pub(super) kind: Kind,
    pub(super) flags: u32,
    pub(super) element: Element,
    /// For bounds: the exponent of the lattice's step. For extremes: their level.
    pub(super) level: u32,
    /// Elements from west to east and from south to north: posts of the grid, or of the lattice, or blocks.
    pub(super) columns: u32,
    pub(super) rows: u32,
    pub(super) pages: u64,
    /// First byte in the file.
    pub(super) offset: u64,
    /// Bytes, directory included.
    pub(super) length: u64,
}

impl Section {
    fn encode(&self) -> [u8; SECTION_BYTES] {
        let mut out = [0; SECTION_BYTES];
        let words = [self.kind.number(), self.flags, self.element.number(), self.level, self.columns, self.rows];
        for (chunk, word) in out.chunks_exact_mut(4).zip(words) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        for (chunk, word) in out[24..].chunks_exact_mut(8).zip([self.pages, self.offset, self.length, 0]) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        out
    }

    fn decode(bytes: &[u8; SECTION_BYTES]) -> Result<Self, OpenError> {
        let word = |n: usize| u32_at(bytes, 4 * n);
        let long = |n: usize| u64_at(bytes, 24 + 8 * n);
        let section = Self {
            kind: Kind::from_number(word(0)),
            flags: word(1),
            element: Element::from_number(word(2)),
            level: word(3),
            columns: word(4),
            rows: word(5),
            pages: long(0),
            offset: long(1),
            length: long(2),
        };
        if long(3) != 0 || section.flags & !REQUIRED != 0 {
            return Err(OpenError::damaged("table of sections", "a reserved field is not zero"));
        }
        match section.kind {
            Kind::Other(n) if section.flags & REQUIRED != 0 => {
                Err(OpenError::Unsupported(format!("sections of kind {n}")))
            }
            _ => Ok(section),
        }
    }

    /// Its name for people.
    pub(super) fn name(&self) -> String {
        match self.kind {
            Kind::Manifest => "manifest".into(),
            Kind::Heights => "heights".into(),
            Kind::Bounds => format!("bounds of step {}", 1_u64 << self.level.min(63)),
            Kind::Extremes => format!("extremes of level {}", self.level),
            Kind::Corners => "corners".into(),
            Kind::Other(n) => format!("section of unknown kind {n}"),
        }
    }
}

/// The header's numbers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Header {
    pub(super) version: u32,
    pub(super) sections: u32,
    pub(super) file_bytes: u64,
    table_checksum: u64,
}

impl Header {
    /// Bytes of header and table.
    pub(super) fn front_bytes(&self) -> u64 {
        front_bytes(self.sections as usize)
    }
}

/// Bytes of a header and a table of `sections` entries.
pub(super) fn front_bytes(sections: usize) -> u64 {
    (HEADER_BYTES + sections * SECTION_BYTES) as u64
}

/// The header and the table of a file of `sections`.
pub(super) fn encode_front(sections: &[Section], file_bytes: u64) -> Vec<u8> {
    let table: Vec<u8> = sections.iter().flat_map(Section::encode).collect();
    let mut out = MAGIC.to_vec();
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(sections.len() as u32).to_le_bytes());
    out.extend_from_slice(&file_bytes.to_le_bytes());
    out.extend_from_slice(&xxh3_64(&table).to_le_bytes());
    let checksum = xxh3_64(&out);
    out.extend_from_slice(&checksum.to_le_bytes());
    out.extend_from_slice(&table);
    out
}

/// Reads the header from the first bytes of a file, fewer than [`HEADER_BYTES`] only where the file ends.
pub(super) fn decode_header(bytes: &[u8]) -> Result<Header, OpenError> {
    let there = bytes.len().min(MAGIC.len());
    if there == 0 || bytes[..there] != MAGIC[..there] {
        return Err(OpenError::NotADatabase);
    }
    let Some(bytes) = bytes.first_chunk::<HEADER_BYTES>() else {
        return Err(OpenError::damaged("header", format!("the file ends after {} bytes", bytes.len())));
    };
    if u64_at(bytes, HEADER_CHECKSUM_AT) != xxh3_64(&bytes[..HEADER_CHECKSUM_AT]) {
        return Err(OpenError::damaged("header", "its checksum does not fit its bytes"));
    }
    let version = u32_at(bytes, VERSION_AT);
    if !(1..=VERSION).contains(&version) {
        return Err(OpenError::Unsupported(format!("format version {version} (this program reads 1 to {VERSION})")));
    }
    let sections = u32_at(bytes, SECTIONS_AT);
    if sections > MAX_SECTIONS {
        return Err(OpenError::damaged("header", format!("{sections} sections, more than {MAX_SECTIONS}")));
    }
    let table_checksum = u64_at(bytes, TABLE_CHECKSUM_AT);
    Ok(Header { version, sections, file_bytes: u64_at(bytes, LENGTH_AT), table_checksum })
}

/// Reads the table that follows `header`, and checks that the sections lie end to end to the end of the file.
pub(super) fn decode_table(header: &Header, table: &[u8]) -> Result<Vec<Section>, OpenError> {
    let damaged = |detail: &str| OpenError::damaged("table of sections", detail);
    if table.len() != header.sections as usize * SECTION_BYTES || xxh3_64(table) != header.table_checksum {
        return Err(damaged("its checksum does not fit its bytes"));
    }
    let (entries, _) = table.as_chunks::<SECTION_BYTES>();
    let sections: Vec<_> = entries.iter().map(Section::decode).collect::<Result<_, _>>()?;
    let mut end = header.front_bytes();
    for section in &sections {
        if section.offset != end {
            return Err(damaged("the sections do not lie end to end"));
        }
        end = end.checked_add(section.length).ok_or_else(|| damaged("a section is longer than any file"))?;
    }
    if end != header.file_bytes {
        return Err(damaged("the sections do not fill the file"));
    }
    Ok(sections)
}

/// The little-endian u32 at byte `at`.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|n| bytes[at + n]))
}

/// The little-endian u64 at byte `at`.
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|n| bytes[at + n]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sections(kind: Kind, flags: u32) -> Vec<Section> {
        let first = Section {
            kind,
            flags,
            element: Element::I32,
            level: 7,
            columns: 70,
            rows: 90,
            pages: 4,
            offset: front_bytes(1),
            length: 1000,
        };
        vec![first]
    }

    fn decode(bytes: &[u8]) -> Result<Vec<Section>, OpenError> {
        let header = decode_header(bytes)?;
        decode_table(&header, &bytes[HEADER_BYTES..])
    }

    #[test]
    fn front_matter_round_trips_and_every_flipped_bit_is_refused() {
        let front = encode_front(&sections(Kind::Heights, REQUIRED), front_bytes(1) + 1000);
        assert_eq!(front.len() as u64, front_bytes(1));
        assert_eq!(decode(&front).unwrap(), sections(Kind::Heights, REQUIRED));
        for bit in 0..8 * front.len() {
            let mut bad = front.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&bad).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn unknown_sections_are_skipped_unless_required() {
        let optional = encode_front(&sections(Kind::Other(99), 0), front_bytes(1) + 1000);
        assert_eq!(decode(&optional).unwrap()[0].kind, Kind::Other(99));
        let required = encode_front(&sections(Kind::Other(99), REQUIRED), front_bytes(1) + 1000);
        assert!(matches!(decode(&required), Err(OpenError::Unsupported(_))));
        let reserved = encode_front(&sections(Kind::Other(99), 4), front_bytes(1) + 1000);
        assert!(matches!(decode(&reserved), Err(OpenError::Damaged { .. })));
    }

    #[test]
    fn gaps_and_overflows_are_refused() {
        for (offset, length, file) in [(1, 1000, 1000), (0, 1000, 1001), (0, u64::MAX, 1000)] {
            let mut list = sections(Kind::Heights, REQUIRED);
            list[0].offset += offset;
            list[0].length = length;
            let front = encode_front(&list, front_bytes(1) + file);
            assert!(matches!(decode(&front), Err(OpenError::Damaged { .. })), "{offset} {length} {file}");
        }
    }
}
