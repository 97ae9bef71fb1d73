//! What a file is: by its content where that says so, else by its name.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::hgt::{self, Packing};
use super::{DemError, raw};

/// Bytes looked at.
const HEAD_BYTES: u64 = 512;

/// A format that is read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Format {
    /// SRTM tile.
    Hgt(Packing),
    /// TIFF or BigTIFF.
    Tiff,
    /// Esri ASCII grid.
    Ascii,
    /// DTED cell.
    Dted,
    /// Raw samples beside a header.
    Raw,
    /// USGS ASCII DEM.
    Usgs,
    /// PNG picture.
    Png,
}

/// Tells the format of `path`, or why it has none.
pub(super) fn format_of(path: &Path) -> Result<Format, DemError> {
    let io = |e: std::io::Error| DemError::io(path, &e);
    let metadata = std::fs::metadata(path).map_err(io)?;
    if metadata.is_dir() {
        return Err(DemError::Directory { path: path.to_owned() });
    }
    if metadata.len() == 0 {
        return Err(DemError::Empty { path: path.to_owned() });
    }
    let mut head = Vec::new();
    File::open(path).map_err(io)?.take(HEAD_BYTES).read_to_end(&mut head).map_err(io)?;
    if head.starts_with(b"version https://git-lfs") {
        return Err(DemError::PointerFile { path: path.to_owned() });
    }
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    // A raw tile has no mark of its own, and its first heights could look like another's.
    if extension == "hgt" && hgt::side_of(metadata.len()).is_some() {
        return Ok(Format::Hgt(Packing::Raw));
    }
    // Nor has a raw raster, but its header is beside it.
    let has_header = raw::beside(path).is_some();
    if has_header && ["bil", "bip", "bsq", "flt"].contains(&extension.as_str()) {
        return Ok(Format::Raw);
    }
    by_content(&head)
        .unwrap_or_else(|| match extension.as_str() {
            "hgt" => Ok(Format::Hgt(Packing::Raw)),
            "asc" => Ok(Format::Ascii),
            "dt0" | "dt1" | "dt2" => Ok(Format::Dted),
            "tif" | "tiff" => Err("a file named .tif without TIFF's first bytes".to_owned()),
            "hdr" => Err("the header file of a raw raster (name the raster itself)".to_owned()),
            _ if has_header => Ok(Format::Raw),
            "bil" | "bip" | "bsq" | "flt" => Err("a raw raster without its header file (.hdr)".to_owned()),
            "dem" if is_text(&head) => Ok(Format::Usgs),
            "dem" => Err("a .dem file that is no USGS ASCII DEM and has no header file".to_owned()),
            "" => Err("a file of unknown content without an extension".to_owned()),
            other => Err(format!("a file of unknown content named .{other}")),
        })
        .map_err(|found| DemError::Unsupported { path: path.to_owned(), found })
}

/// The format, or what else it is in words; `None` when the first bytes do not say.
fn by_content(head: &[u8]) -> Option<Result<Format, String>> {
    let other = |what: &str| Some(Err(what.to_owned()));
    match head {
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(Ok(Format::Tiff)),
        [b'P', b'K', 3, 4, ..] | [b'P', b'K', 5, 6, ..] => Some(Ok(Format::Hgt(Packing::Zip))),
        [0x1f, 0x8b, ..] => Some(Ok(Format::Hgt(Packing::Gzip))),
        [0x89, b'P', b'N', b'G', ..] => Some(Ok(Format::Png)),
        [b'E', b'H', b'F', b'A', ..] => other("an Erdas Imagine file"),
        [0xff, 0xd8, 0xff, ..] => other("a JPEG picture"),
        [b'U', b'H', b'L', b'1', ..] | [b'V', b'O', b'L', b'1', ..] | [b'H', b'D', b'R', b'1', ..] => {
            Some(Ok(Format::Dted))
        }
        [0x89, b'H', b'D', b'F', ..] => other("an HDF5 or NetCDF file"),
        [b'C', b'D', b'F', 1 | 2 | 5, ..] => other("a NetCDF file"),
        _ => {
            let text = head.trim_ascii_start();
            let word = text.split(u8::is_ascii_whitespace).next().unwrap_or_default();
            let keyword =
                [&b"ncols"[..], b"nrows", b"xllcorner", b"xllcenter"].iter().any(|k| word.eq_ignore_ascii_case(k));
            keyword.then_some(Ok(Format::Ascii))
        }
    }
}

fn is_text(head: &[u8]) -> bool {
    head.iter().all(|c| matches!(c, b' '..=b'~' | b'\t' | b'\r' | b'\n'))
}
