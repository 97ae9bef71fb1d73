//! Small samples of each format, and every way to damage them.

use crate::encoders::{Codec, Dted, Samples, Tiff};

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
