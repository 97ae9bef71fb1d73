//! Esri's headers: of BIL, BIP and BSQ (Esri, "BIL, BIP, and BSQ raster files"), whose place is the centre of the
//! north-western pixel, and of FLT (Esri, "Float to Raster"), whose place is the south-western corner as in its ASCII
//! grids. A line is a word and its value, in any letter case and order; words that are not known are passed over.
//!
//! Missing words mean what Esri says, with these exceptions: samples of 16 bits without PIXELTYPE are signed, as
//! GTOPO30's are and as GDAL takes them; a missing BYTEORDER is least significant byte first, since headers without it
//! were written on such machines; both with a note. Samples of 32 bits without PIXELTYPE may be either and are refused.

use std::path::Path;

use crate::dem::sample::Sample;
use crate::dem::{DemError, nodata, prj};
use crate::terrain::Georeference;

use super::header::{Header, Interleave, Words, clip};

/// TIFF's codes of kinds of samples.
const UNSIGNED: u16 = 1;
const SIGNED: u16 = 2;
const FLOAT: u16 = 3;
/// What a header of an FLT file without NODATA_value means by it, as in Esri's ASCII grids.
const FLT_NODATA: f64 = -9999.0;

pub(super) fn read(raster: &Path, path: &Path, text: &str) -> Result<Header, DemError> {
    let split = |line: &str| {
        let (key, value) = line.trim().split_once(|c: char| c.is_ascii_whitespace() || c == '=')?;
        Some((key.to_ascii_lowercase(), value.trim_matches(|c: char| c.is_whitespace() || c == '=').to_owned()))
    };
    let words = Words { path, words: text.lines().filter_map(split).collect() };
    let (nx, ny) = (words.side("ncols")?, words.side("nrows")?);
    let mut notes = Vec::new();
    let is_flt = raster.extension().is_some_and(|e| e.eq_ignore_ascii_case("flt"));
    let sample = sample_of(&words, is_flt, &mut notes)?;
    let bands = words.bands("nbands")?;
    let layout = words.get("layout").unwrap_or("bil");
    let Some(interleave) = Interleave::of(layout) else {
        return Err(words.malformed(format!("LAYOUT is {:?}, which is none of BIL, BIP, BSQ", clip(layout))));
    };
    let (pixel_stride, tight) = interleave.strides(nx, bands, sample);
    let row_stride = if interleave == Interleave::Bsq {
        words.count("bandrowbytes")?
    } else {
        let total = words.count("totalrowbytes")?;
        // A padded row of one band, where the whole row is not given.
        total.or(words.count("bandrowbytes")?.filter(|_| bands == 1))
    };
    let row_stride = row_stride.unwrap_or(tight);
    if row_stride < tight {
        return Err(words.malformed(format!("rows of {row_stride} bytes are too short for {nx} samples")));
    }
    let big_endian = match words.get("byteorder").map(str::to_ascii_uppercase).as_deref() {
        Some("I" | "LSBFIRST" | "LSB" | "INTEL" | "VMS_FFLOAT") => false,
        Some("M" | "MSBFIRST" | "MSB" | "MOTOROLA") => true,
        Some(other) => return Err(words.malformed(format!("BYTEORDER is {:?}, which is neither I nor M", clip(other)))),
        None => {
            if sample.bytes() > 1 {
                notes.push("the header does not name the byte order; least significant byte first is taken".to_owned());
            }
            false
        }
    };
    let declared = match words.get("nodata").or(words.get("nodata_value")) {
        Some(word) => nodata::parse(word)
            .map_err(|word| words.malformed(format!("its NODATA value {word:?} is no number; see --nodata")))?,
        None => is_flt.then_some(FLT_NODATA),
    };
    let mut georeference = place(&words, nx, ny)?;
    if georeference.is_placed() {
        prj::read(raster, &mut georeference, &mut notes)?;
    } else {
        notes.push("the header does not say where it lies; posts are taken as 1 m apart".to_owned());
    }
    let format = if is_flt { "Esri FLT" } else { "Esri BIL" };
    let skip = words.count("skipbytes")?.unwrap_or(0);
    Ok(Header {
        format,
        nx,
        ny,
        bands,
        sample,
        big_endian,
        skip,
        pixel_stride,
        row_stride,
        nodata: declared,
        georeference,
        notes,
    })
}

fn sample_of(words: &Words, is_flt: bool, notes: &mut Vec<String>) -> Result<Sample, DemError> {
    let bits = words.count("nbits")?.unwrap_or(if is_flt { 32 } else { 8 });
    let kind = match words.get("pixeltype").map(str::to_ascii_uppercase).as_deref() {
        Some("SIGNEDINT" | "SIGNED") => SIGNED,
        Some("UNSIGNEDINT" | "UNSIGNED") => UNSIGNED,
        Some("FLOAT") => FLOAT,
        Some(other) => {
            let detail = format!("PIXELTYPE is {:?}, which is none of SIGNEDINT, UNSIGNEDINT, FLOAT", clip(other));
            return Err(words.malformed(detail));
        }
        None if is_flt => FLOAT,
        None if bits == 16 => {
            notes.push("the header does not name the type of its 16-bit samples; signed is taken".to_owned());
            SIGNED
        }
        None if bits == 32 => {
            let detail = "it does not say whether its 32-bit samples are integers or floating point; add a line \
                          PIXELTYPE SIGNEDINT or PIXELTYPE FLOAT";
            return Err(words.refused(detail));
        }
        None => UNSIGNED,
    };
    let detail = || {
        words.refused(format!(
            "samples of {bits} bits are not read; integers of 8, 16 and 32 and floats of 32 and 64 are"
        ))
    };
    u16::try_from(bits).ok().and_then(|bits| Sample::from_tiff(kind, bits)).ok_or_else(detail)
}

/// The place of the pixel centres; unit steps from the origin when the header gives none.
fn place(words: &Words, nx: u32, ny: u32) -> Result<Georeference, DemError> {
    let cell = words.number("cellsize")?;
    let step = |key| words.number(key).map(|step| step.or(cell));
    let step = [step("xdim")?, step("ydim")?];
    let upper_left = [words.number("ulxmap")?, words.number("ulymap")?];
    let lower_left = |corner: &str, centre: &str, step: Option<f64>| {
        let corner = words.number(corner)?.zip(step).map(|(at, step)| at + 0.5 * step);
        words.number(centre).map(|centre| centre.or(corner))
    };
    let lower_left = [lower_left("xllcorner", "xllcenter", step[0])?, lower_left("yllcorner", "yllcenter", step[1])?];
    let georeference = |origin, step| Georeference { epsg: None, geographic: false, origin, step };
    match (upper_left, lower_left, step) {
        ([Some(x), Some(y)], _, [Some(dx), Some(dy)]) => Ok(georeference([x, y - f64::from(ny - 1) * dy], [dx, dy])),
        (_, [Some(x), Some(y)], [Some(dx), Some(dy)]) => Ok(georeference([x, y], [dx, dy])),
        ([None, None], [None, None], _) => Ok(georeference([0.0; 2], [1.0; 2])),
        _ => Err(words.malformed(format!("it does not wholly say where its {nx} x {ny} posts lie"))),
    }
}
