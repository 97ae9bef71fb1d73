//! The numbers that Inam's "Evaluation of Terrain Rendering Algorithms" (2005) prints: tables 3.15 to 3.28 and 4.1.

/// What a table prints of one algorithm.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Printed {
    /// The column called "Tris/s", which is a number of triangles: three times it is the number of vertices.
    pub(super) triangles: u32,
    pub(super) accuracy: f64,
}

const fn printed(triangles: u32, accuracy: f64) -> Printed {
    Printed { triangles, accuracy }
}

/// A data set of the first test case.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct DataSet {
    pub(super) name: &'static str,
    pub(super) posts: u32,
    /// ROAM, quadtree, GeoMipMap.
    pub(super) results: [Printed; 3],
    /// Vertices of ROAM, which draws triangle by triangle.
    pub(super) roam_vertices: u32,
    /// Frames a second and milliseconds of rendering of ROAM.
    pub(super) roam_rate: [f64; 2],
}

const fn set(
    name: &'static str,
    posts: u32,
    results: [Printed; 3],
    roam_vertices: u32,
    roam_rate: [f64; 2],
) -> DataSet {
    DataSet { name, posts, results, roam_vertices, roam_rate }
}

/// Tables 3.15 to 3.26: maximum accuracy.
pub(super) const SETS: [DataSet; 12] = [
    set(
        "subdivide and displace",
        257,
        [printed(19_939, 98.65), printed(34_621, 99.36), printed(21_860, 98.78)],
        58_017,
        [15.0, 95.0],
    ),
    set("Perlin", 513, [printed(16_735, 97.60), printed(62_659, 98.89), printed(60_776, 98.79)], 50_205, [10.0, 78.0]),
    set(
        "multi-Perlin",
        513,
        [printed(17_869, 97.53), printed(80_854, 99.17), printed(71_820, 98.93)],
        53_607,
        [11.0, 78.0],
    ),
    set("ridged", 513, [printed(17_705, 95.94), printed(143_262, 98.92), printed(65_584, 98.04)], 53_115, [10.0, 78.0]),
    set(
        "ridged multi",
        513,
        [printed(18_017, 96.73), printed(113_499, 98.97), printed(75_972, 98.62)],
        54_051,
        [10.0, 80.0],
    ),
    set(
        "N37E029",
        1025,
        [printed(11_341, 96.15), printed(105_536, 98.48), printed(149_476, 98.97)],
        34_023,
        [6.0, 51.0],
    ),
    set(
        "N37E034",
        1025,
        [printed(11_595, 95.70), printed(106_884, 98.80), printed(170_700, 98.93)],
        34_785,
        [6.0, 51.0],
    ),
    set(
        "N38E027",
        1025,
        [printed(10_527, 92.22), printed(113_180, 96.80), printed(118_212, 97.62)],
        31_581,
        [6.0, 50.0],
    ),
    set("N38E032", 1025, [printed(11_008, 93.87), printed(71_193, 97.57), printed(142_892, 98.6)], 33_024, [6.0, 49.0]),
    set(
        "N39E041",
        1025,
        [printed(10_836, 96.24), printed(108_106, 98.61), printed(151_380, 98.92)],
        32_508,
        [6.0, 48.0],
    ),
    set(
        "N39E044",
        1025,
        [printed(10_626, 95.67), printed(71_313, 97.85), printed(143_860, 98.42)],
        31_878,
        [6.0, 62.0],
    ),
    set(
        "N41E026",
        1025,
        [printed(9_565, 90.10), printed(135_621, 96.71), printed(129_276, 97.44)],
        28_695,
        [7.0, 50.0],
    ),
];

/// Tables 3.27 and 3.28, at about 10,000 triangles: ROAM, quadtree.
pub(super) const AT_10_000: [[Printed; 2]; 2] =
    [[printed(9_822, 94.29), printed(9_871, 93.68)], [printed(9_855, 96.00), printed(9_904, 95.42)]];

/// Table 4.1: averages of ROAM, quadtree, GeoMipMap.
pub(super) const AVERAGES: [Printed; 3] = [printed(13_814, 95.53), printed(95_560, 98.34), printed(108_484, 98.50)];

/// Triangles below which the thesis could not get its GeoMipMap at 1025 x 1025 posts with tiles of 33 x 33.
pub(super) const LEAST_GEOMIPMAP: u32 = 40_000;
