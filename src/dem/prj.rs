//! The `.prj` file beside an Esri grid, or the same text in an ENVI header: what its well-known text says simply, and no more.
//!
//! Recognised: whether coordinates are geographic or projected; an EPSG code that the text states for the whole
//! system; WGS 84, NAD83 and ETRS89 in degrees; UTM on WGS 84. Everything else keeps its name as a note. Projected
//! systems that are not in metres are refused, since lengths would be wrong.

use std::io::Read;
use std::path::Path;

use crate::terrain::Georeference;

use super::{DemError, crs};

/// The longest text that is taken.
const MAX_BYTES: u64 = 65_536;

/// Reads the `.prj` file beside `grid`, if there is one, into `georeference`; without one, degrees are recognised by
/// their size, with a note.
pub(super) fn read(grid: &Path, georeference: &mut Georeference, notes: &mut Vec<String>) -> Result<(), DemError> {
    let beside = ["prj", "PRJ", "Prj"].map(|extension| grid.with_extension(extension));
    let Some(path) = beside.iter().find(|p| p.is_file()) else {
        crs::guess(georeference, "no .prj file", notes);
        return Ok(());
    };
    let mut text = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| DemError::io(path, &e))?;
    file.take(MAX_BYTES).read_to_end(&mut text).map_err(|e| DemError::io(path, &e))?;
    let text = String::from_utf8_lossy(&text);
    apply(&text, georeference, notes).map_err(|detail| DemError::refused(path, detail))
}

/// Puts what a well-known text says into `georeference`; an error says why it cannot be.
pub(super) fn apply(text: &str, georeference: &mut Georeference, notes: &mut Vec<String>) -> Result<(), String> {
    let system = parse(text)?;
    (georeference.epsg, georeference.geographic) = (system.epsg, system.geographic);
    if let Some(name) = system.name {
        notes.push(format!("reference system by its well-known text: {name}"));
    }
    Ok(())
}

#[derive(Debug, PartialEq)]
struct System {
    epsg: Option<u32>,
    geographic: bool,
    name: Option<String>,
}

fn parse(text: &str) -> Result<System, String> {
    let upper = text.trim().to_ascii_uppercase();
    // A compound system is its horizontal part and a vertical one.
    let start = ["PROJCS[", "PROJCRS[", "GEOGCS[", "GEOGCRS[", "GEODCRS["].iter().filter_map(|k| upper.find(k)).min();
    let Some(start) = start else { return parse_old(&upper) };
    let wkt = &upper[start..];
    let wkt = &wkt[..end_of_system(wkt)];
    let geographic = wkt.starts_with("GEO");
    if !geographic {
        check_metres(wkt)?;
    }
    let name = wkt.split('"').nth(1).map(|name| name.chars().take(80).collect::<String>());
    let words = name.as_deref().unwrap_or_default().replace([' ', '/'], "_");
    let epsg = authority(wkt).or_else(|| if geographic { geographic_code(&words) } else { utm_code(&words) });
    Ok(System { epsg, geographic, name })
}

/// The old form of Arc/Info: lines of words, "Projection GEOGRAPHIC" first.
fn parse_old(upper: &str) -> Result<System, String> {
    let words: Vec<_> = upper.split_ascii_whitespace().collect();
    let value = |key: &str| words.windows(2).find(|w| w[0] == key).map(|w| w[1]);
    let Some(projection) = value("PROJECTION") else {
        return Err("it is no well-known text; delete it and name the reference system with --crs EPSG:N".to_owned());
    };
    let geographic = projection == "GEOGRAPHIC";
    if !geographic && value("UNITS").is_some_and(|u| !u.starts_with("METER") && !u.starts_with("METRE")) {
        return Err(not_metres(value("UNITS").unwrap_or_default()));
    }
    let wgs84 = value("DATUM").is_some_and(|d| d == "WGS84" || d == "WGS_84");
    Ok(System { epsg: (geographic && wgs84).then_some(4326), geographic, name: Some(projection.to_owned()) })
}

/// Where the bracket that opens a system closes.
fn end_of_system(wkt: &str) -> usize {
    let mut depth = 0;
    for (at, c) in wkt.char_indices() {
        match c {
            '[' => depth += 1,
            ']' if depth <= 1 => return at,
            ']' => depth -= 1,
            _ => {}
        }
    }
    wkt.len()
}

/// The code that the last element of the system gives for the whole of it.
fn authority(wkt: &str) -> Option<u32> {
    let at = wkt.rfind("AUTHORITY[\"EPSG\"").or_else(|| wkt.rfind("ID[\"EPSG\""))?;
    let tail = &wkt[at..];
    let close = tail.find(']')?;
    if !tail[close + 1..].trim().is_empty() {
        return None;
    }
    tail[..close].rsplit(',').next()?.trim().trim_matches('"').parse().ok()
}

fn geographic_code(name: &str) -> Option<u32> {
    match name.trim_start_matches("GCS_") {
        "WGS_1984" | "WGS_84" | "WGS84" => Some(4326),
        "NORTH_AMERICAN_1983" | "NAD83" => Some(4269),
        "ETRS_1989" | "ETRS89" => Some(4258),
        _ => None,
    }
}

fn utm_code(name: &str) -> Option<u32> {
    let zone = ["WGS_1984_UTM_ZONE_", "WGS_84___UTM_ZONE_"].iter().find_map(|start| name.strip_prefix(start))?;
    let (number, half) = zone.split_at_checked(zone.len().checked_sub(1)?)?;
    let number = number.parse::<u32>().ok().filter(|n| (1..=60).contains(n))?;
    match half {
        "N" => Some(32_600 + number),
        "S" => Some(32_700 + number),
        _ => None,
    }
}

/// The unit of a projected system is the last one that its text names: those before are angles.
fn check_metres(wkt: &str) -> Result<(), String> {
    let Some(at) = wkt.rfind("UNIT[") else { return Ok(()) };
    let mut parts = wkt[at + 5..].split([',', ']']);
    let name = parts.next().unwrap_or_default().trim_matches('"');
    let factor = parts.next().and_then(|f| f.trim().parse::<f64>().ok());
    if factor == Some(1.0) { Ok(()) } else { Err(not_metres(name)) }
}

fn not_metres(unit: &str) -> String {
    let unit: String = unit.chars().take(40).collect();
    format!("its map unit is {unit:?}; only metres and degrees are read: project it again, in metres")
}

#[cfg(test)]
mod tests {
    use super::*;

    const ESRI: &str = r#"GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]]"#;

    fn utm(unit: &str, tail: &str) -> String {
        format!(r#"PROJCS["WGS_1984_UTM_Zone_19N",{ESRI},PROJECTION["Transverse_Mercator"],UNIT[{unit}]{tail}]"#)
    }

    #[test]
    fn simple_systems_are_recognised() {
        let system = parse(ESRI).unwrap();
        assert_eq!((system.epsg, system.geographic), (Some(4326), true));
        let system = parse(&utm(r#""Meter",1.0"#, "")).unwrap();
        assert_eq!((system.epsg, system.geographic), (Some(32_619), false));
        let system = parse(&utm(r#""metre",1"#, r#",AUTHORITY["EPSG","2154"]"#)).unwrap();
        assert_eq!((system.epsg, system.geographic), (Some(2154), false));
        let system = parse("Projection    GEOGRAPHIC\nDatum WGS84\nUnits DD\n").unwrap();
        assert_eq!((system.epsg, system.geographic), (Some(4326), true));
    }

    #[test]
    fn an_inner_code_is_not_the_systems() {
        let inner = ESRI.replace("]]", r#",AUTHORITY["EPSG","4326"]]]"#);
        let text = format!(r#"PROJCS["Mine",{inner},UNIT["Meter",1.0]]"#);
        assert_eq!(parse(&text).unwrap().epsg, None);
    }

    #[test]
    fn feet_and_nonsense_are_refused() {
        assert!(parse(&utm(r#""Foot_US",0.3048006096012192"#, "")).unwrap_err().contains("FOOT_US"));
        assert!(parse("hello").is_err());
    }
}
