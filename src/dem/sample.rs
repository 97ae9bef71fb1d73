//! Sample types, and their bytes as heights.

/// The type of a sample.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Sample {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl Sample {
    /// From TIFF's SampleFormat (1 unsigned, 2 signed, 3 floating point) and BitsPerSample.
    pub(super) fn from_tiff(format: u16, bits: u16) -> Option<Self> {
        Some(match (format, bits) {
            (1, 8) => Self::U8,
            (2, 8) => Self::I8,
            (1, 16) => Self::U16,
            (2, 16) => Self::I16,
            (1, 32) => Self::U32,
            (2, 32) => Self::I32,
            (3, 32) => Self::F32,
            (3, 64) => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    pub(super) fn is_signed(self) -> bool {
        !matches!(self, Self::U8 | Self::U16 | Self::U32)
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// Samples in the machine's byte order as f64, which holds each of these types exactly.
    pub(super) fn decode(self, bytes: &[u8], out: &mut [f64]) {
        fn each<const N: usize>(bytes: &[u8], out: &mut [f64], value: impl Fn([u8; N]) -> f64) {
            for (height, sample) in out.iter_mut().zip(bytes.as_chunks::<N>().0) {
                *height = value(*sample);
            }
        }
        match self {
            Self::U8 => each(bytes, out, |b| u8::from_ne_bytes(b).into()),
            Self::I8 => each(bytes, out, |b| i8::from_ne_bytes(b).into()),
            Self::U16 => each(bytes, out, |b| u16::from_ne_bytes(b).into()),
            Self::I16 => each(bytes, out, |b| i16::from_ne_bytes(b).into()),
            Self::U32 => each(bytes, out, |b| u32::from_ne_bytes(b).into()),
            Self::I32 => each(bytes, out, |b| i32::from_ne_bytes(b).into()),
            Self::F32 => each(bytes, out, |b| f32::from_ne_bytes(b).into()),
            Self::F64 => each(bytes, out, f64::from_ne_bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_come_out_exactly() {
        let mut out = [0.0; 2];
        let bytes: Vec<_> = [-32_768_i16, 32_767].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::I16.decode(&bytes, &mut out);
        assert_eq!(out, [-32_768.0, 32_767.0]);
        let bytes: Vec<_> = [u32::MAX, 1].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::U32.decode(&bytes, &mut out);
        assert_eq!(out, [4_294_967_295.0, 1.0]);
        let bytes: Vec<_> = [0.1_f32, f32::NAN].iter().flat_map(|v| v.to_ne_bytes()).collect();
        Sample::F32.decode(&bytes, &mut out);
        assert!(out[0] == f64::from(0.1_f32) && out[1].is_nan());
    }
}
