//! What can be said of a horizontal reference system without a database of them.

use std::path::Path;

use crate::terrain::Georeference;

use super::DemError;

/// Codes of the EPSG register whose coordinates are longitude and latitude in degrees and that elevation models use:
/// WGS 84, NAD27, NAD83, ETRS89, GDA94, GDA2020, NZGD2000, SIRGAS 2000, CSRS, NSRS2007, NAD83(2011), HARN, CGCS2000,
/// JGD2000, JGD2011, Pulkovo 1942, WGS 72, RGF93, Tokyo, ED50, OSGB36, and WGS 84 and ETRS89 in three dimensions.
const GEOGRAPHIC: [u32; 23] = [
    4326, 4267, 4269, 4258, 4283, 7844, 4167, 4674, 4617, 4759, 6318, 4152, 4490, 4612, 6668, 4284, 4322, 4171, 4301,
    4230, 4277, 4979, 4937,
];

/// Whether `epsg` is known to mean longitude and latitude. Any other code is taken as projected in metres.
pub(super) fn is_geographic(epsg: u32) -> bool {
    GEOGRAPHIC.contains(&epsg)
}

/// Puts the user's code in place of the file's.
pub(super) fn override_epsg(georeference: &mut Georeference, epsg: Option<u32>, notes: &mut Vec<String>) {
    let Some(code) = epsg else { return };
    georeference.epsg = Some(code);
    georeference.geographic = is_geographic(code);
    let kind = if georeference.geographic { "longitude and latitude" } else { "projected, in metres" };
    notes.push(format!("reference system EPSG:{code} is the user's word, taken as {kind}"));
}

/// Largest step, in map units, of a grid that is taken as one in degrees: as metres its posts would lie 5 cm apart.
const MAX_GUESSED_DEGREES: f64 = 0.05;

/// For a file that names no reference system: degrees are recognised by their size. A guess, which a note tells and
/// the user's word replaces.
pub(super) fn guess(georeference: &mut Georeference, why: &str, notes: &mut Vec<String>) {
    let ([x, y], [dx, dy]) = (georeference.origin, georeference.step);
    if x.abs() <= 180.0 && y.abs() <= 90.0 && dx < MAX_GUESSED_DEGREES && dy < MAX_GUESSED_DEGREES {
        georeference.geographic = true;
        notes.push(format!("{why}; by their size the coordinates are taken as longitude and latitude"));
    } else {
        notes.push(format!("{why}; coordinates are taken as metres of an unknown projection"));
    }
}

/// Refuses a place that cannot be: steps that are not positive numbers, degrees beyond the poles or twice around.
pub(super) fn check(path: &Path, georeference: &Georeference, nx: u32, ny: u32) -> Result<(), DemError> {
    let [west, south] = georeference.origin;
    let [east, north] = georeference.map_from_grid(f64::from(nx - 1), f64::from(ny - 1));
    let [dx, dy] = georeference.step;
    let finite = [west, south, east, north].into_iter().all(f64::is_finite);
    if !(finite && dx > 0.0 && dy > 0.0 && dx.is_normal() && dy.is_normal()) {
        let detail = format!("its posts lie {dx} by {dy} map units apart from ({west}, {south}): that is no place");
        return Err(DemError::refused(path, detail));
    }
    if georeference.geographic && (south < -90.1 || north > 90.1 || west < -360.1 || east > 540.1) {
        let detail = format!(
            "its posts reach from ({west}, {south}) to ({east}, {north}), which are not degrees of longitude and \
             latitude; if they are metres, name the reference system with --crs EPSG:N"
        );
        return Err(DemError::refused(path, detail));
    }
    Ok(())
}
