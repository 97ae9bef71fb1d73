//! Why an elevation file could not be read: what is wrong, where, and what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// The formats that [`super::open`] reads, for messages.
pub(super) const SUPPORTED: &str = "SRTM .hgt (also .hgt.zip and .hgt.gz), GeoTIFF (.tif, .tiff), DTED (.dt0, .dt1, .dt2), Esri ASCII \
     grid (.asc), raw rasters with a header (.bil, .bip, .bsq, .flt, ENVI), USGS ASCII DEM (.dem) and PNG (16-bit grey, \
     Terrarium, Mapbox Terrain-RGB)";

/// Why an elevation file could not be read.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum DemError {
    /// No file was named.
    #[error("no elevation file was named; name one file, or several adjoining ones")]
    NoInput,
    /// The operating system refused.
    #[error("{}: {detail}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        detail: String,
    },
    /// A directory where a file is wanted.
    #[error("{} is a directory; name the elevation files in it", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
    },
    /// A file without content.
    #[error("{} is empty; fetch it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A Git LFS pointer where the data should be.
    #[error("{} is a Git LFS pointer, not the data itself; run `git lfs pull` where it came from", path.display())]
    PointerFile {
        /// The file.
        path: PathBuf,
    },
    /// A format that no reader knows.
    #[error("{}: {found} is not read; supported are {SUPPORTED}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it seems to be.
        found: String,
    },
    /// The content breaks the rules of its format, or is cut short.
    #[error("{}: not a well-formed {format}: {detail}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format that it claims.
        format: &'static str,
        /// What is wrong and where.
        detail: String,
    },
    /// Well formed, but something that this reader does not do.
    #[error("{}: {detail}", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// What it needs, and what to do instead.
        detail: String,
    },
    /// A height that no place has: as a rule a NODATA value that the file does not declare.
    #[error(
        "{}: the height at post ({i}, {j}) is {height}, which no place has; if it stands for no data, say so with --nodata={height}",
        path.display()
    )]
    ImpossibleHeight {
        /// The file.
        path: PathBuf,
        /// Column of the post, eastward.
        i: u32,
        /// Row of the post, northward.
        j: u32,
        /// The sample.
        height: f64,
    },
    /// Several files that do not make one raster.
    #[error("these files do not make one mosaic: {detail}")]
    Mosaic {
        /// Which, and why.
        detail: String,
    },
}

impl DemError {
    /// A failure of the operating system on `path`.
    pub(super) fn io(path: &Path, error: &std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), detail: error.to_string() }
    }

    /// Content of `path` that breaks the rules of `format`.
    pub(super) fn malformed(path: &Path, format: &'static str, detail: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), format, detail: detail.into() }
    }

    /// Content of `path` that this reader does not do.
    pub(super) fn refused(path: &Path, detail: impl Into<String>) -> Self {
        Self::Refused { path: path.to_owned(), detail: detail.into() }
    }
}
