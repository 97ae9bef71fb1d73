//! Where a GeoTIFF's posts lie, after OGC 19-008r4, "GeoTIFF standard 1.1", sections 6 to 8 and annex B.

use std::path::Path;

use geotiff_reader::GeoTiffFile;
use geotiff_reader::crs::ModelType;
use geotiff_reader::geokeys;

use crate::dem::{DemError, crs};
use crate::terrain::Georeference;

/// Codes of the EPSG register for units: metre, degree, and the two feet that heights come in.
const METRE: u16 = 9001;
const FOOT: u16 = 9002;
const US_SURVEY_FOOT: u16 = 9003;
const DEGREE: [u16; 2] = [9102, 9122];
/// GeoKey values that stand for "undefined" and "user-defined".
const NO_CODE: [u16; 2] = [0, 32_767];

/// Unit steps from the origin, for a file that does not say where it lies.
pub(super) fn none(notes: &mut Vec<String>) -> Georeference {
    notes.push("the file does not say where it lies; posts are taken as 1 m apart".to_owned());
    Georeference { epsg: None, geographic: false, origin: [0.0, 0.0], step: [1.0, 1.0] }
}

/// The georeference of the posts, which are pixel centres, and metres per unit of the samples.
pub(super) fn of(
    path: &Path,
    file: &GeoTiffFile,
    ny: u32,
    notes: &mut Vec<String>,
) -> Result<(Georeference, f64), DemError> {
    let sample_m = vertical(path, file, notes)?;
    // The crate's transform is of pixel corners, for both PixelIsArea and PixelIsPoint.
    let Some(t) = file.transform() else {
        return Ok((none(notes), sample_m));
    };
    if t.skew_x != 0.0 || t.skew_y != 0.0 {
        return Err(DemError::refused(
            path,
            "its grid is rotated; warp it to north-up first, for example with gdalwarp",
        ));
    }
    if t.pixel_width < 0.0 || t.pixel_height > 0.0 {
        let detail = "its columns run west or its rows north; write it out north-up first, for example with gdalwarp";
        return Err(DemError::refused(path, detail));
    }
    let origin = [t.origin_x + 0.5 * t.pixel_width, t.origin_y + (f64::from(ny) - 0.5) * t.pixel_height];
    let step = [t.pixel_width, -t.pixel_height];
    let mut georeference = Georeference { epsg: None, geographic: false, origin, step };
    horizontal(path, file, &mut georeference, notes)?;
    Ok((georeference, sample_m))
}

fn horizontal(
    path: &Path,
    file: &GeoTiffFile,
    georeference: &mut Georeference,
    notes: &mut Vec<String>,
) -> Result<(), DemError> {
    let crs = file.crs();
    let code = |key| file.geokeys().get_short(key).filter(|c| !NO_CODE.contains(c));
    let (projected, geodetic) = (code(geokeys::PROJECTED_CRS_TYPE), code(geokeys::GEODETIC_CRS_TYPE));
    let geographic = match crs.model_type_enum() {
        ModelType::Projected => false,
        ModelType::Geographic => true,
        ModelType::Geocentric => {
            return Err(DemError::refused(path, "its coordinates are geocentric; project it first"));
        }
        ModelType::Unknown(_) if projected.is_some() => false,
        ModelType::Unknown(_) if geodetic.is_some() => true,
        ModelType::Unknown(_) => {
            crs::guess(georeference, "no reference system is named", notes);
            return Ok(());
        }
    };
    georeference.geographic = geographic;
    georeference.epsg = if geographic { geodetic } else { projected }.map(u32::from);
    let unit = code(if geographic { geokeys::GEOG_ANGULAR_UNITS } else { geokeys::PROJ_LINEAR_UNITS });
    let fits = |u: u16| if geographic { DEGREE.contains(&u) } else { u == METRE };
    if let Some(unit) = unit.filter(|u| !fits(*u)) {
        let detail =
            format!("its map unit is EPSG:{unit}; only metres and degrees are read: project it again, in metres");
        return Err(DemError::refused(path, detail));
    }
    let citation =
        file.geokeys().get_ascii(geokeys::GT_CITATION).or(crs.projection_citation()).or(crs.geodetic_citation());
    if let Some(name) = citation.map(|name| name.trim_matches(['|', '\0', ' '])).filter(|name| !name.is_empty()) {
        notes.push(format!("reference system of the file: {}", name.chars().take(80).collect::<String>()));
    }
    Ok(())
}

/// Metres per unit of the samples; the datum is kept as a note.
fn vertical(path: &Path, file: &GeoTiffFile, notes: &mut Vec<String>) -> Result<f64, DemError> {
    let code = |key| file.geokeys().get_short(key).filter(|c| !NO_CODE.contains(c));
    match (code(geokeys::VERTICAL_CS_TYPE), file.crs().vertical_citation()) {
        (Some(epsg), _) => notes.push(format!("vertical reference system EPSG:{epsg}")),
        (None, Some(name)) => {
            notes.push(format!("vertical reference system: {}", name.chars().take(80).collect::<String>()))
        }
        (None, None) => notes.push("the file does not name a vertical datum".to_owned()),
    }
    let foot = match code(geokeys::VERTICAL_UNITS) {
        None | Some(METRE) => return Ok(1.0),
        Some(FOOT) => 0.3048,
        Some(US_SURVEY_FOOT) => 1200.0 / 3937.0,
        Some(other) => {
            let detail = format!("its heights are in the unit EPSG:{other}; write them out in metres first");
            return Err(DemError::refused(path, detail));
        }
    };
    notes.push("heights are in feet in the file, and were turned into metres".to_owned());
    Ok(foot)
}
