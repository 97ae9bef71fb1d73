//! Heights in PNG pictures: 16-bit grey samples in metres, and the two ways of web tiles to put a height into red,
//! green and blue: Terrarium (Mapzen/Tilezen "Terrain Tiles", formats: `R * 256 + G + B / 256 - 32768`) and Mapbox
//! Terrain-RGB (Mapbox, "Access elevation data": `-10000 + (R * 65536 + G * 256 + B) / 10`).
//!
//! Which of the two a coloured picture is cannot be seen in it. The user says it, or the path does ("terrarium",
//! "mapbox", "terrain-rgb" in the file's name or else in the nearest folder's), which a note repeats; otherwise the
//! picture is refused. A picture lies nowhere unless its path is a tile's, `z/x/y.png`: then it is that square of
//! EPSG:3857 (OGC 17-083r2, annex D.1), pixels being areas. Transparent pixels are void, and so are the black ones of
//! Terrain-RGB, which stand for no data at -10,000 m, and of Terrarium, at -32,768 m.
//!
//! Refused: palettes, 8-bit grey, interlaced pictures. A PNG can only be unpacked from its north edge on, and rows are
//! wanted from the south: pictures larger than the band kept at hand are unpacked once a band. Kept at hand: one band of
//! 4 MiB and twice the file's length, or of as much as may be.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use ::png::{BitDepth, ColorType, Decoder, Limits, Reader};

use crate::terrain::Georeference;

use super::nodata::Nodata;
use super::{DemError, OpenOptions, PngHeights, Raster, RasterInfo, crs};

/// The format's name in messages.
const FORMAT: &str = "PNG picture";
/// Bytes of the band at hand besides twice the file's length.
const BAND_BYTES: u64 = 4 << 20;
/// The longest row, and the most bytes of a whole picture.
const MAX_ROW_BYTES: u64 = 1 << 20;
const MAX_BYTES: u64 = 1 << 31;
/// Deflate packs at most this many bytes into one (RFC 1951: 258 bytes in two bits), and a short picture into nothing.
const MAX_RATIO: u64 = 1032;
const SLACK_BYTES: u64 = 1 << 16;
/// What the decoder may allocate for chunks that are not rows.
const DECODER_BYTES: usize = 6 << 20;
/// Half the side of the square of EPSG:3857: pi times the semi-major axis of WGS84, in metres.
const WEB_MERCATOR_M: f64 = 20_037_508.342_789_244;
/// The deepest level of tiles: beyond it pixels are smaller than a nanometre.
const MAX_ZOOM: u32 = 40;

/// A PNG picture of heights.
pub(super) struct Picture {
    path: PathBuf,
    info: RasterInfo,
    heights: PngHeights,
    nodata: Nodata,
    /// Bytes a pixel.
    pixel: usize,
    /// Most bytes of a band.
    most_bytes: u64,
    band_rows: u32,
    /// The band at hand, counted from the north, and its rows as they are stored.
    held: Option<u32>,
    band: Vec<u8>,
}

impl Picture {
    /// Reads the header.
    pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let bytes = std::fs::metadata(path).map_err(|e| DemError::io(path, &e))?.len();
        let reader = decoder(path)?;
        let picture = reader.info();
        let (nx, ny) = picture.size();
        let mut notes = Vec::new();
        let heights = heights_of(path, picture.color_type, picture.bit_depth, options, &mut notes)?;
        if picture.interlaced {
            return Err(DemError::refused(path, "it is interlaced; write it again without interlacing"));
        }
        let pixel = picture.bytes_per_pixel();
        let row_bytes = u64::from(nx) * pixel as u64;
        let total = row_bytes.saturating_mul(u64::from(ny));
        if nx < 2 || ny < 2 || row_bytes > MAX_ROW_BYTES || total > MAX_BYTES {
            let detail =
                format!("it is {nx} x {ny} pixels; from 2 x 2 pixels to 1 MiB a row and 2 GiB in all are read");
            return Err(DemError::refused(path, detail));
        }
        if total > bytes * MAX_RATIO + SLACK_BYTES {
            let detail = format!("{nx} x {ny} pixels cannot be in {bytes} bytes; it is cut short: fetch it again");
            return Err(DemError::malformed(path, FORMAT, detail));
        }
        let mut georeference = match Tile::of(path) {
            Some(tile) => {
                notes.push(format!("by its path it is tile {}/{}/{} of EPSG:3857", tile.z, tile.x, tile.y));
                tile.georeference(nx, ny)
            }
            None => {
                notes.push("the file does not say where it lies; posts are taken as 1 m apart".to_owned());
                Georeference { epsg: None, geographic: false, origin: [0.0; 2], step: [1.0; 2] }
            }
        };
        crs::override_epsg(&mut georeference, options.epsg, &mut notes);
        crs::check(path, &georeference, nx, ny)?;
        let (name, unit_m) = match heights {
            PngHeights::Gray16 => ("16-bit grey in metres", 1.0),
            PngHeights::Terrarium => ("Terrarium", 1.0 / 256.0),
            PngHeights::Mapbox => ("Mapbox Terrain-RGB", 0.1),
        };
        let nodata = match (options.nodata, heights) {
            (Some(value), _) => Nodata::new(Some(value), false),
            (None, PngHeights::Gray16) => Nodata::new(None, false),
            (None, PngHeights::Terrarium) => Nodata::new(Some(-32_768.0), false),
            (None, PngHeights::Mapbox) => Nodata::new(Some(-10_000.0), false),
        };
        let info = RasterInfo { format: format!("PNG, {name}"), nx, ny, georeference, unit_m, notes };
        let most_bytes = BAND_BYTES + 2 * bytes;
        let mut picture = Self {
            path: path.to_owned(),
            info,
            heights,
            nodata,
            pixel,
            most_bytes,
            band_rows: 1,
            held: None,
            band: Vec::new(),
        };
        picture.limit_memory(options.memory_bytes)?;
        Ok(picture)
    }

    /// Puts band `band` at hand.
    fn hold(&mut self, band: u32) -> Result<(), DemError> {
        if self.held == Some(band) {
            return Ok(());
        }
        self.held = None;
        let row_bytes = self.info.nx as usize * self.pixel;
        let north = band * self.band_rows;
        let south = (north + self.band_rows).min(self.info.ny);
        let mut reader = decoder(&self.path)?;
        if (reader.info().size(), reader.info().bytes_per_pixel()) != ((self.info.nx, self.info.ny), self.pixel) {
            return Err(malformed(&self.path, "it has changed since it was opened"));
        }
        self.band.clear();
        for row in 0..south {
            let found = reader.next_row().map_err(|e| malformed(&self.path, e))?;
            let Some(found) = found.filter(|found| found.data().len() == row_bytes) else {
                return Err(malformed(&self.path, format!("row {row} is missing")));
            };
            if row >= north {
                self.band.extend_from_slice(found.data());
            }
        }
        self.held = Some(band);
        Ok(())
    }
}

impl Raster for Picture {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_row(&mut self, j: u32, out: &mut [f64]) -> Result<(), DemError> {
        let from_north = self.info.ny - 1 - j;
        self.hold(from_north / self.band_rows)?;
        let row_bytes = out.len() * self.pixel;
        let start = (from_north % self.band_rows) as usize * row_bytes;
        for (out, pixel) in out.iter_mut().zip(self.band[start..start + row_bytes].chunks_exact(self.pixel)) {
            let height = height_m(self.heights, pixel);
            *out = if self.nodata.is_void(height) { f64::NAN } else { height };
        }
        Ok(())
    }

    fn release(&mut self) {
        (self.held, self.band) = (None, Vec::new());
    }

    fn limit_memory(&mut self, bytes: usize) -> Result<(), DemError> {
        self.release();
        let row_bytes = u64::from(self.info.nx) * self.pixel as u64;
        let rows = self.most_bytes.min(bytes as u64) / row_bytes;
        self.band_rows = rows.clamp(1, u64::from(self.info.ny)) as u32;
        Ok(())
    }

    fn memory_bytes(&self) -> u64 {
        u64::from(self.band_rows) * u64::from(self.info.nx) * self.pixel as u64
    }
}

/// The height of a pixel, exact for grey and Terrarium and correctly rounded for Terrain-RGB; NaN where transparent.
fn height_m(heights: PngHeights, pixel: &[u8]) -> f64 {
    match (heights, pixel) {
        (PngHeights::Gray16, &[high, low]) => f64::from(u16::from_be_bytes([high, low])),
        (_, &[_, _, _, 0]) => f64::NAN,
        (PngHeights::Terrarium, &[r, g, b, ..]) => f64::from(u32::from_be_bytes([0, r, g, b])) / 256.0 - 32_768.0,
        (PngHeights::Mapbox, &[r, g, b, ..]) => (f64::from(u32::from_be_bytes([0, r, g, b])) - 100_000.0) / 10.0,
        _ => f64::NAN,
    }
}

fn decoder(path: &Path) -> Result<Reader<BufReader<File>>, DemError> {
    let file = File::open(path).map_err(|e| DemError::io(path, &e))?;
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), Limits { bytes: DECODER_BYTES });
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder.read_info().map_err(|e| malformed(path, e))
}

fn malformed(path: &Path, error: impl std::fmt::Display) -> DemError {
    DemError::malformed(path, FORMAT, format!("{error}; it is cut short or damaged: fetch it again"))
}

/// What the samples mean: by the user's word or the path, as far as the picture's kind allows.
fn heights_of(
    path: &Path,
    color: ColorType,
    depth: BitDepth,
    options: &OpenOptions,
    notes: &mut Vec<String>,
) -> Result<PngHeights, DemError> {
    let grey = match (color, depth) {
        (ColorType::Grayscale, BitDepth::Sixteen) => true,
        (ColorType::Rgb | ColorType::Rgba, BitDepth::Eight) => false,
        _ => {
            let detail = format!(
                "it is a PNG of kind {color:?} with {} bits a sample; heights are read from 16-bit grey, and from 8-bit \
                 RGB or RGBA as Terrarium or Mapbox Terrain-RGB",
                depth as u8
            );
            return Err(DemError::refused(path, detail));
        }
    };
    let heights = match options.png.or_else(|| named(path, notes)) {
        Some(heights) => heights,
        None if grey => {
            notes.push("the grey samples are taken as whole metres".to_owned());
            PngHeights::Gray16
        }
        None => {
            let detail = "it is a coloured PNG, whose heights may be written in two ways; say which with --png terrarium \
                          or --png mapbox";
            return Err(DemError::refused(path, detail));
        }
    };
    if grey != (heights == PngHeights::Gray16) {
        let (found, said) = if grey { ("16-bit grey", "coloured") } else { ("coloured", "16-bit grey") };
        let detail = format!("the picture is {found}, but is said to be {said}; see --png");
        return Err(DemError::refused(path, detail));
    }
    Ok(heights)
}

/// What the path says: the file's name, else the nearest folder's.
fn named(path: &Path, notes: &mut Vec<String>) -> Option<PngHeights> {
    for part in path.components().rev() {
        let part = part.as_os_str().to_string_lossy();
        let lower = part.to_ascii_lowercase();
        let terrarium = lower.contains("terrarium");
        let mapbox = ["mapbox", "terrain-rgb", "terrain_rgb", "terrainrgb"].iter().any(|word| lower.contains(word));
        let heights = match (terrarium, mapbox) {
            (true, false) => PngHeights::Terrarium,
            (false, true) => PngHeights::Mapbox,
            (false, false) => continue,
            // Both words say nothing.
            (true, true) => return None,
        };
        notes.push(format!("by the name {part:?} its colours are taken as {heights:?} heights"));
        return Some(heights);
    }
    None
}

/// A tile of the square of EPSG:3857: `2^z` by `2^z` of them, (0, 0) north-west.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Tile {
    z: u32,
    x: u64,
    y: u64,
}

impl Tile {
    /// The tile that a path ending in `z/x/y.png` names; `y@2x.png` is one of twice the pixels.
    fn of(path: &Path) -> Option<Self> {
        let number = |text: &str| text.bytes().all(|c| c.is_ascii_digit()).then(|| text.parse::<u64>().ok()).flatten();
        let stem = path.file_stem()?.to_str()?;
        let mut folders = path.parent()?.components().rev().map(|c| c.as_os_str().to_str());
        let y = number(stem.strip_suffix("@2x").unwrap_or(stem))?;
        let (x, z) = (number(folders.next()??)?, number(folders.next()??)?);
        let z = u32::try_from(z).ok().filter(|z| *z <= MAX_ZOOM)?;
        (x >> z == 0 && y >> z == 0).then_some(Self { z, x, y })
    }

    /// Pixel centres of the tile.
    fn georeference(self, nx: u32, ny: u32) -> Georeference {
        let side = 2.0 * WEB_MERCATOR_M / (1_u64 << self.z) as f64;
        let step = [side / f64::from(nx), side / f64::from(ny)];
        let west = self.x as f64 * side - WEB_MERCATOR_M;
        let south = WEB_MERCATOR_M - (self.y as f64 + 1.0) * side;
        let origin = [west + 0.5 * step[0], south + 0.5 * step[1]];
        Georeference { epsg: Some(3857), geographic: false, origin, step }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_is_named_by_the_end_of_its_path() {
        let tile = |path: &str| Tile::of(Path::new(path)).map(|t| (t.z, t.x, t.y));
        assert_eq!(tile("a/terrarium/10/301/385.png"), Some((10, 301, 385)));
        assert_eq!(tile("0/0/0@2x.png"), Some((0, 0, 0)));
        for path in ["1/2/0.png", "1/0/2.png", "x/1/1.png", "1/1.png", "1.png", "a/+1/1/1.png", "99/0/0.png"] {
            assert_eq!(tile(path), None, "{path}");
        }
        // The worked example of many tile servers: 0/0/0 is the whole square.
        let place = Tile { z: 1, x: 1, y: 0 }.georeference(256, 512);
        assert_eq!(place.step, [WEB_MERCATOR_M / 256.0, WEB_MERCATOR_M / 512.0]);
        assert_eq!(place.origin, [0.5 * place.step[0], 0.5 * place.step[1]]);
    }

    #[test]
    fn colours_are_heights_as_their_publishers_say() {
        let terrarium = |rgb: [u8; 3]| height_m(PngHeights::Terrarium, &rgb);
        assert_eq!([[0, 0, 0], [128, 0, 0], [128, 1, 128]].map(terrarium), [-32_768.0, 0.0, 1.5]);
        let mapbox = |rgb: [u8; 3]| height_m(PngHeights::Mapbox, &rgb);
        assert_eq!([[0, 0, 0], [1, 134, 160], [1, 134, 161]].map(mapbox), [-10_000.0, 0.0, 0.1]);
        assert!(height_m(PngHeights::Mapbox, &[1, 134, 160, 0]).is_nan());
    }
}
