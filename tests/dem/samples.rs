//! Small samples of each format, and every way to damage them.

use crate::encoders::{Codec, Dted, Samples, Tiff, Usgs, png};

/// An Esri ASCII grid with every kind of number.
pub(crate) fn asc() -> String {
    "ncols 5\nnrows 4\nxllcorner 100.5\nyllcorner -2e2\ncellsize 10\nNODATA_value -9999\n\
     1 2 3 4 5\n-9999 7.25 8e1 9 +10\n11 12 13 14 15\n16 17 18 19 20\n"
        .to_owned()
}

/// A DTED cell with a negative height and a void.
pub(crate) fn dted() -> Vec<u8> {
    Dted::default().encode(|i, j| ((i, j) != (3, 2)).then_some(20 - 15 * i as i16 + j as i16))
}

/// A USGS ASCII DEM with irregular edges and a void.
pub(crate) fn usgs() -> Vec<u8> {
    let profiles = [(1, vec![900, 901]), (0, vec![910, -32_767, 912, 913]), (2, vec![920])];
    Usgs::default().encode_lines(&profiles)
}

/// PNG pictures of each kind, by file name.
pub(crate) fn pngs() -> Vec<(&'static str, Vec<u8>)> {
    use png::{BitDepth::Eight, BitDepth::Sixteen, ColorType};
    let bytes: Vec<_> = (0..80).map(|n| n * 3).collect();
    vec![
        ("grey.png", png(5, ColorType::Grayscale, Sixteen, &bytes[..40])),
        ("terrarium.png", png(5, ColorType::Rgb, Eight, &bytes[..60])),
        ("mapbox.png", png(5, ColorType::Rgba, Eight, &bytes)),
    ]
}

/// A header and the samples of a raw raster of each kind: names of both, then contents.
pub(crate) fn raws() -> Vec<([&'static str; 2], [Vec<u8>; 2])> {
    let bil = "NROWS 4\nNCOLS 5\nNBANDS 1\nNBITS 16\nPIXELTYPE SIGNEDINT\nBYTEORDER M\nLAYOUT BIL\nSKIPBYTES 2\n\
               TOTALROWBYTES 12\nULXMAP 100\nULYMAP 200\nXDIM 10\nYDIM 20\nNODATA -9999\n";
    let flt = "ncols 5\nnrows 4\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\nbyteorder LSBFIRST\n";
    let envi = "ENVI\nsamples = 5\nlines = 4\nbands = 2\nheader offset = 0\ndata type = 3\ninterleave = bip\n\
                byte order = 0\nmap info = {UTM, 1, 1, 1000, 2000, 10, 10, 33, North, WGS-84}\ndata ignore value = -1\n";
    let floats = (0..20).flat_map(|n| (100.0 + n as f32).to_le_bytes()).collect();
    vec![
        (["grid.hdr", "grid.bil"], [bil.into(), (0..50).collect()]),
        (["grid.hdr", "grid.flt"], [flt.into(), floats]),
        (["grid.dat.hdr", "grid.dat"], [envi.into(), (0..160).map(|n| if n % 4 > 1 { 0 } else { n }).collect()]),
    ]
}

/// A TIFF for each codec, and for each layout.
pub(crate) fn tiffs() -> Vec<(&'static str, Vec<u8>)> {
    let height = |i: usize, row: usize| (100 + 3 * i + 7 * row) as f64;
    let plain = || Tiff { nodata: Some("-9999"), ..Tiff::default() };
    let with = |codec| Tiff { codec, ..plain() };
    let tiled = |codec| Tiff { codec, tile: Some(16), ..plain() };
    let cases = [
        ("none.tif", plain()),
        ("big_endian.tif", Tiff { big_endian: true, ..plain() }),
        ("big.tif", Tiff { big: true, samples: Samples::I32, ..plain() }),
        ("lzw.tif", with(Codec::Lzw)),
        ("deflate.tif", Tiff { predictor: 2, ..tiled(Codec::Deflate) }),
        ("packbits.tif", tiled(Codec::PackBits)),
        ("zstd.tif", with(Codec::Zstd)),
        ("lerc.tif", Tiff { codec: Codec::Lerc, samples: Samples::F32, ..plain() }),
        ("floats.tif", Tiff { predictor: 3, samples: Samples::F32, ..tiled(Codec::Deflate) }),
        ("doubles.tif", Tiff { samples: Samples::F64, ..plain() }),
        ("sparse.tif", Tiff { missing: vec![0], ..plain() }),
    ];
    cases.map(|(name, tiff)| (name, tiff.encode(height))).into()
}

/// Calls `each` with the sample cut to every length, and with every byte changed in a few ways, and what was done.
pub(crate) fn for_each_mutation(sample: &[u8], mut each: impl FnMut(&[u8], &str)) {
    for length in 0..sample.len() {
        each(&sample[..length], &format!("cut to {length} bytes"));
    }
    let mut content = sample.to_vec();
    for at in 0..sample.len() {
        for mask in [0xff, 0x01, 0x80] {
            content[at] ^= mask;
            each(&content, &format!("byte {at} changed by {mask:#x}"));
            content[at] = sample[at];
        }
    }
}
