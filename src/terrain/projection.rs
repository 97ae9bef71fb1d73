//! Longitude and latitude on terrain whose map is a zone of the universal transverse Mercator projection, or web
//! Mercator, which tiles of elevation have.
//!
//! Longitudes and latitudes are those of the map's own datum: none is shifted to another here, where WGS 84, NAD83 and
//! ETRS89 differ by some metres. `proj4rs` projects as PROJ does, to 0.1 mm within ten degrees of a zone's middle; a
//! place that does not come back to where it was is refused.

use std::{cell::RefCell, ops::RangeInclusive};

use proj4rs::{proj::Proj, transform::transform};

/// A projection whose code is known.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Projection {
    /// A zone on the ellipsoid of a datum.
    Utm { number: u32, south: bool, ellipsoid: &'static str },
    /// Latitudes of WGS 84 drawn as if the Earth were a sphere.
    WebMercator,
}

/// Web Mercator's code.
const WEB_MERCATOR: u32 = 3_857;

/// Codes of the EPSG register, the number of zone 0 in each row, the hemisphere, and PROJ's name of the ellipsoid:
/// WGS 84, WGS 72, ETRS89, ED50, NAD83, NAD27, NAD83(NSRS2007), NAD83(2011), GDA94, GDA2020 and SIRGAS 2000.
const ZONES: [(RangeInclusive<u32>, u32, bool, &str); 14] = [
    (32_601..=32_660, 32_600, false, "WGS84"),
    (32_701..=32_760, 32_700, true, "WGS84"),
    (32_201..=32_260, 32_200, false, "WGS72"),
    (32_301..=32_360, 32_300, true, "WGS72"),
    (25_828..=25_838, 25_800, false, "GRS80"),
    (23_028..=23_038, 23_000, false, "intl"),
    (26_901..=26_923, 26_900, false, "GRS80"),
    (26_701..=26_722, 26_700, false, "clrk66"),
    (3_708..=3_726, 3_707, false, "GRS80"),
    (6_330..=6_348, 6_329, false, "GRS80"),
    (28_348..=28_358, 28_300, true, "GRS80"),
    (7_846..=7_859, 7_800, true, "GRS80"),
    (31_965..=31_976, 31_954, false, "GRS80"),
    (31_977..=31_985, 31_960, true, "GRS80"),
];

/// Degrees east or west of a zone's middle within which its map is trusted; the zone itself has three.
const MAX_FROM_MIDDLE_DEG: f64 = 10.0;
/// How far a place may come back from where it was, in degrees: 0.1 mm on the ground.
const MAX_RETURN_DEG: f64 = 1e-9;

thread_local! {
    /// The projection that this thread asked for last: to set one up takes longer than to project.
    static LAST: RefCell<Option<(Projection, Proj, Proj)>> = const { RefCell::new(None) };
}

impl Projection {
    /// What an EPSG code names, if that is known here.
    pub(super) fn of_epsg(code: u32) -> Option<Self> {
        if code == WEB_MERCATOR {
            return Some(Self::WebMercator);
        }
        let (_, zero, south, ellipsoid) = ZONES.iter().find(|(codes, ..)| codes.contains(&code))?;
        Some(Self::Utm { number: code - zero, south: *south, ellipsoid })
    }

    /// The projection and its longitudes and latitudes, in PROJ's words.
    fn definitions(self) -> [String; 2] {
        match self {
            Self::Utm { number, south, ellipsoid } => {
                let south = if south { " +south" } else { "" };
                [
                    format!("+proj=utm +zone={number}{south} +ellps={ellipsoid}"),
                    format!("+proj=longlat +ellps={ellipsoid}"),
                ]
            }
            Self::WebMercator => ["merc", "longlat"].map(|name| format!("+proj={name} +a=6378137 +b=6378137")),
        }
    }

    /// Whether a longitude in degrees is where the map is trusted.
    fn reaches(self, longitude: f64) -> bool {
        let Self::Utm { number, .. } = self else { return longitude.is_finite() };
        let turns = (longitude - (f64::from(number) * 6.0 - 183.0)).rem_euclid(360.0);
        turns.min(360.0 - turns) <= MAX_FROM_MIDDLE_DEG
    }

    /// Metres east and north of longitude and latitude in degrees; `None` beyond where the map is trusted.
    pub(super) fn map_from_geographic(self, degrees: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = self.transformed(degrees.map(f64::to_radians), Way::ToMap)?;
        let back = self.geographic_from_map([x, y])?;
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= MAX_RETURN_DEG;
        let turn = (degrees[0] - back[0]).abs();
        let same = near((&degrees[1], &back[1])) && (turn <= MAX_RETURN_DEG || (turn - 360.0).abs() <= MAX_RETURN_DEG);
        same.then_some([x, y])
    }

    /// Longitude and latitude in degrees of metres east and north; `None` beyond where the map is trusted.
    pub(super) fn geographic_from_map(self, metres: [f64; 2]) -> Option<[f64; 2]> {
        let [longitude, latitude] = self.transformed(metres, Way::FromMap)?.map(f64::to_degrees);
        self.reaches(longitude).then_some([longitude, latitude])
    }

    fn transformed(self, [x, y]: [f64; 2], way: Way) -> Option<[f64; 2]> {
        LAST.with_borrow_mut(|last| {
            if last.as_ref().is_none_or(|(projection, ..)| *projection != self) {
                let [map, plain] = self.definitions();
                *last = Some((self, Proj::from_proj_string(&plain).ok()?, Proj::from_proj_string(&map).ok()?));
            }
            let (_, plain, map) = last.as_ref()?;
            let (from, to) = if way == Way::ToMap { (plain, map) } else { (map, plain) };
            let mut point = (x, y, 0.0);
            transform(from, to, &mut point).ok()?;
            let (x, y, _) = point;
            (x.is_finite() && y.is_finite()).then_some([x, y])
        })
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Way {
    ToMap,
    FromMap,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn zone(number: u32, south: bool, ellipsoid: &'static str) -> Projection {
        Projection::Utm { number, south, ellipsoid }
    }

    fn middle_deg(zone: Projection) -> (f64, bool) {
        let Projection::Utm { number, south, .. } = zone else { panic!("no zone") };
        assert!((1..=60).contains(&number));
        (f64::from(number) * 6.0 - 183.0, south)
    }

    /// The first five are of PROJ's own tests (`builtins.gie`) and introduction, the others what PROJ 9.5 says.
    #[test]
    fn places_are_where_proj_puts_them() {
        let known = [
            (zone(30, false, "GRS80"), [2.0, 1.0], [1_057_002.405_491_298, 110_955.141_175_949]),
            (zone(30, false, "GRS80"), [2.0, -1.0], [1_057_002.405_491_298, -110_955.141_175_949]),
            (zone(30, false, "GRS80"), [-2.0, 1.0], [611_263.812_278_905, 110_547.105_696_804]),
            (zone(30, false, "GRS80"), [-2.0, -1.0], [611_263.812_278_905, -110_547.105_696_804]),
            (zone(32, false, "GRS80"), [12.0, 55.0], [691_875.632_139_661, 6_098_907.825_005_012]),
            (zone(11, false, "WGS84"), [-118.2923, 36.5785], [384_381.795_377_352, 4_048_892.754_522_422]),
            (zone(60, true, "WGS84"), [178.5, -41.3], [625_580.442_708_537, 5_426_854.149_526_981]),
            (Projection::WebMercator, [-118.2923, 36.5785], [-13_168_238.600_765_156, 4_380_516.844_251_226]),
        ];
        for (zone, place, expected) in known {
            let found = zone.map_from_geographic(place).unwrap();
            for k in 0..2 {
                assert!((found[k] - expected[k]).abs() < 1e-4, "{zone:?} {place:?}: {found:?}");
            }
        }
    }

    #[test]
    fn codes_name_their_zones() {
        assert_eq!(Projection::of_epsg(32_611), Some(zone(11, false, "WGS84")));
        assert_eq!(Projection::of_epsg(32_760), Some(zone(60, true, "WGS84")));
        assert_eq!(Projection::of_epsg(26_713), Some(zone(13, false, "clrk66")));
        assert_eq!(Projection::of_epsg(3_717), Some(zone(10, false, "GRS80")));
        assert_eq!(Projection::of_epsg(6_339), Some(zone(10, false, "GRS80")));
        assert_eq!(Projection::of_epsg(7_850), Some(zone(50, true, "GRS80")));
        assert_eq!(Projection::of_epsg(31_983), Some(zone(23, true, "GRS80")));
        assert_eq!(Projection::of_epsg(3_857), Some(Projection::WebMercator));
        for other in [4_326, 2_056, 32_600, 32_661, 3_727] {
            assert_eq!(Projection::of_epsg(other), None);
        }
        for (codes, ..) in ZONES {
            for code in codes {
                let zone = Projection::of_epsg(code).unwrap();
                let (middle, south) = middle_deg(zone);
                let [x, _] = zone.map_from_geographic([middle, if south { -20.0 } else { 20.0 }]).unwrap();
                assert!((x - 500_000.0).abs() < 1e-6, "{code}: {x}");
            }
        }
    }

    #[test]
    fn places_on_the_other_side_of_the_earth_are_refused() {
        let zone = zone(11, false, "WGS84");
        for place in [[-27.0, 36.0], [63.0, 36.0], [-140.0, 36.0], [-117.0, 91.0], [f64::NAN, 1.0], [1e300, 1.0]] {
            assert_eq!(zone.map_from_geographic(place), None, "{place:?}");
        }
        for metres in [[1e9, 0.0], [f64::NAN, 0.0], [500_000.0, 1e300]] {
            assert_eq!(zone.geographic_from_map(metres), None, "{metres:?}");
        }
        // Once around is the same place.
        assert!(zone.map_from_geographic([243.0, 36.0]).is_some());
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_place(number in 1..=60_u32, south: bool, off in -9.0..9.0_f64, latitude in 0.0..84.0_f64) {
            let zone = zone(number, south, "WGS84");
            let place = [middle_deg(zone).0 + off, if south { -latitude } else { latitude }];
            let there = zone.map_from_geographic(place).unwrap();
            let back = zone.geographic_from_map(there).unwrap();
            let turn = (place[0] - back[0]).rem_euclid(360.0);
            prop_assert!(turn.min(360.0 - turn) < 1e-9 && (place[1] - back[1]).abs() < 1e-9, "{place:?} {back:?}");
        }
    }
}
