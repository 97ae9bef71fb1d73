//! ENVI's headers (L3Harris, "ENVI Header Files"): `key = value`, values in braces over several lines.
//!
//! The reference pixel of `map info` counts from 1 at the north-western corner of the north-western pixel, so that 1.5
//! is its centre. Of reference systems, UTM on WGS 84 and NAD83, longitude and latitude, and what `coordinate system
//! string` says as a `.prj` file would, are recognised; other names are kept as a note.

use std::path::Path;

use crate::dem::sample::Sample;
use crate::dem::{DemError, nodata, prj};
use crate::terrain::Georeference;

use super::header::{Header, Interleave, Words, clip};

pub(super) fn read(path: &Path, text: &str) -> Result<Header, DemError> {
    let words = Words { path, words: pairs(text) };
    let (nx, ny, bands) = (words.side("samples")?, words.side("lines")?, words.bands("bands")?);
    let sample = sample_of(&words)?;
    let layout = words.get("interleave").unwrap_or("bsq");
    let Some(interleave) = Interleave::of(layout) else {
        return Err(words.malformed(format!("interleave is {:?}, which is none of bsq, bil, bip", clip(layout))));
    };
    let (pixel_stride, row_stride) = interleave.strides(nx, bands, sample);
    let big_endian = match words.count("byte order")? {
        Some(0) => false,
        Some(1) => true,
        None if sample.bytes() == 1 => false,
        None => return Err(words.malformed("byte order is missing")),
        Some(other) => return Err(words.malformed(format!("byte order is {other}, which is neither 0 nor 1"))),
    };
    if words.count("file compression")?.is_some_and(|n| n != 0) {
        return Err(words.refused("the raster is compressed; unpack it and delete the line `file compression`"));
    }
    for (key, neutral) in [("data gain values", 1.0), ("data offset values", 0.0)] {
        let first = words.get(key).map(|v| v.split(',').next().unwrap_or_default().trim().parse::<f64>());
        if first.is_some_and(|v| v != Ok(neutral)) {
            let detail = "its samples are scaled or offset; write it out in metres first, for example with \
                          gdal_translate -unscale";
            return Err(words.refused(detail));
        }
    }
    let declared = match words.get("data ignore value") {
        Some(word) => nodata::parse(word)
            .map_err(|word| words.malformed(format!("its data ignore value {word:?} is no number; see --nodata")))?,
        None => None,
    };
    let mut notes = Vec::new();
    let georeference = place(&words, ny, &mut notes)?;
    let skip = words.count("header offset")?.unwrap_or(0);
    Ok(Header {
        format: "ENVI",
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

/// The pairs of a header, keys in lower case, values without their braces.
fn pairs(text: &str) -> Vec<(String, String)> {
    let mut pairs = Vec::new();
    let mut rest = text;
    while let Some((line, after)) = rest.split_once('=') {
        let key = line.lines().last().unwrap_or_default().trim().to_ascii_lowercase();
        let after = after.trim_start_matches([' ', '\t']);
        let (value, left) = match after.strip_prefix('{') {
            Some(inner) => inner.split_once('}').unwrap_or((inner, "")),
            None => after.split_once('\n').unwrap_or((after, "")),
        };
        pairs.push((key, value.trim().to_owned()));
        rest = left;
    }
    pairs
}

fn sample_of(words: &Words) -> Result<Sample, DemError> {
    match words.count("data type")? {
        Some(1) => Ok(Sample::U8),
        Some(2) => Ok(Sample::I16),
        Some(3) => Ok(Sample::I32),
        Some(4) => Ok(Sample::F32),
        Some(5) => Ok(Sample::F64),
        Some(12) => Ok(Sample::U16),
        Some(13) => Ok(Sample::U32),
        Some(other) => Err(words.refused(format!("samples of data type {other} are not read; write float32 or int16"))),
        None => Err(words.malformed("data type is missing")),
    }
}

fn place(words: &Words, ny: u32, notes: &mut Vec<String>) -> Result<Georeference, DemError> {
    let mut georeference = Georeference { epsg: None, geographic: false, origin: [0.0; 2], step: [1.0; 2] };
    let Some(info) = words.get("map info") else {
        notes.push("the header does not say where it lies; posts are taken as 1 m apart".to_owned());
        return Ok(georeference);
    };
    let parts: Vec<_> = info.split(',').map(str::trim).collect();
    let number = |n: usize| parts.get(n).and_then(|p| p.parse::<f64>().ok()).filter(|v| v.is_finite());
    let [Some(i), Some(row), Some(x), Some(y), Some(dx), Some(dy)] = [1, 2, 3, 4, 5, 6].map(number) else {
        return Err(words.malformed(format!("map info is {:?}, which gives no place and step", clip(info))));
    };
    for part in &parts[7..] {
        let Some((key, value)) = part.split_once('=') else { continue };
        let value = value.trim();
        match key.trim().to_ascii_lowercase().as_str() {
            "rotation" if value.parse() != Ok(0.0) => {
                return Err(words.refused("its grid is rotated; warp it to north-up first, for example with gdalwarp"));
            }
            "units"
                if !["meters", "metres", "meter", "metre", "degrees"]
                    .contains(&value.to_ascii_lowercase().as_str()) =>
            {
                return Err(words.refused(format!(
                    "its map unit is {:?}; only metres and degrees are read: project it again, in metres",
                    clip(value)
                )));
            }
            _ => {}
        }
    }
    georeference.step = [dx, dy];
    georeference.origin = [x - (i - 1.5) * dx, y + (row - 1.5) * dy - f64::from(ny - 1) * dy];
    if let Some(text) = words.get("coordinate system string").filter(|text| !text.is_empty()) {
        prj::apply(text, &mut georeference, notes).map_err(|detail| words.refused(detail))?;
        return Ok(georeference);
    }
    let lower = info.to_ascii_lowercase();
    let datum = ["wgs-84", "wgs84", "wgs 84"].iter().any(|d| lower.contains(d)).then_some((4326, 32_600, 32_700));
    let datum = datum.or(lower.contains("north america 1983").then_some((4269, 26_900, 0)));
    if lower.starts_with("geographic") {
        georeference.geographic = true;
        georeference.epsg = datum.map(|(code, ..)| code);
    } else if lower.starts_with("utm") {
        let zone = parts.get(7).and_then(|z| z.parse::<u32>().ok()).filter(|z| (1..=60).contains(z));
        let south = parts.get(8).is_some_and(|half| half.eq_ignore_ascii_case("south"));
        let base = datum.map(|(_, north, southern)| if south { southern } else { north }).filter(|base| *base > 0);
        georeference.epsg = base.zip(zone).map(|(base, zone)| base + zone);
    }
    if georeference.epsg.is_none() {
        let name = clip(parts.first().copied().unwrap_or_default());
        let kind = if georeference.geographic { "degrees" } else { "metres" };
        notes.push(format!("reference system of the header: {name}, in {kind}"));
    }
    Ok(georeference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_may_span_lines_in_braces() {
        let found = pairs("ENVI\ndescription = {\n a = b,\n c}\nsamples = 3\r\nmap info = {UTM, 1}\nband names = {x");
        let expected = [("description", "a = b,\n c"), ("samples", "3"), ("map info", "UTM, 1"), ("band names", "x")];
        assert_eq!(found, expected.map(|(k, v)| (k.to_owned(), v.to_owned())));
    }
}
