//! The one seam to `bincode`: small structured values on disk, and nothing else.
//!
//! bincode is no longer maintained, so only this module names it. Before the value stand a magic number, the version
//! of what is inside, its length and its checksum; the length must be that of the rest of the input, so every byte
//! belongs to one of them. Decoding never allocates more than the limit that the caller states, must consume the
//! whole value, and asks the value itself whether it makes sense (finite numbers, lengths in range).
//!
//! ```text
//!  0  magic     8 bytes
//!  8  version   u32
//! 12  reserved  u32, zero
//! 16  length    u64, bytes of the value
//! 24  checksum  u64, xxh3 64 of the value with the seed `version`
//! 32  the value, bincode 2 `legacy` layout: little-endian, integers of fixed width
//! ```

use serde::{Serialize, de::DeserializeOwned};
use thiserror::Error;
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// Bytes before the value.
pub const HEADER_BYTES: usize = 32;

/// Why an envelope could not be opened, or a value not be sealed.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum EnvelopeError {
    /// Another kind of data.
    #[error("it does not start with the magic number of this kind of data")]
    Magic,
    /// Written by another version of this program.
    #[error("its version is {found}, this program reads version {supported}")]
    Version {
        /// The version found.
        found: u32,
        /// The version that the caller understands.
        supported: u32,
    },
    /// Fewer or more bytes than the envelope says.
    #[error("it has {found} bytes where {expected} are stated")]
    Length {
        /// Bytes stated.
        expected: u64,
        /// Bytes there.
        found: u64,
    },
    /// The value is longer than the caller's limit.
    #[error("its value of {length} bytes is longer than the limit of {limit}")]
    TooLong {
        /// Bytes of the value.
        length: u64,
        /// The caller's limit.
        limit: u64,
    },
    /// The bytes are not those that were written.
    #[error("its checksum does not fit its bytes")]
    Checksum,
    /// The bytes do not spell a value, or one that makes no sense.
    #[error("its value makes no sense: {0}")]
    Value(String),
}

/// A value that can be kept in an envelope.
pub trait Sealed: Serialize + DeserializeOwned {
    /// The magic number of this kind of value.
    const MAGIC: [u8; 8];
    /// The version of its layout.
    const VERSION: u32;

    /// Says what is wrong with a value that decoded: numbers that are not finite, sizes out of range.
    fn check(&self) -> Result<(), String>;
}

/// The bytes of `value` alone, as an envelope holds them: for hashes.
pub fn encode(value: &impl Serialize) -> Result<Vec<u8>, EnvelopeError> {
    bincode::serde::encode_to_vec(value, bincode::config::legacy()).map_err(|e| EnvelopeError::Value(e.to_string()))
}

/// The bytes of an envelope around `value`.
pub fn seal<T: Sealed>(value: &T) -> Result<Vec<u8>, EnvelopeError> {
    let inside = encode(value)?;
    let mut out = Vec::with_capacity(HEADER_BYTES + inside.len());
    out.extend_from_slice(&T::MAGIC);
    out.extend_from_slice(&T::VERSION.to_le_bytes());
    out.extend_from_slice(&0_u32.to_le_bytes());
    out.extend_from_slice(&(inside.len() as u64).to_le_bytes());
    out.extend_from_slice(&xxh3_64_with_seed(&inside, u64::from(T::VERSION)).to_le_bytes());
    out.extend_from_slice(&inside);
    Ok(out)
}

/// The bytes of the value that follows a header, as the header states it: for envelopes in a row. Nothing is checked.
pub fn stated_length(header: &[u8; HEADER_BYTES]) -> u64 {
    word(header, 16)
}

fn word(header: &[u8; HEADER_BYTES], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|n| header[at + n]))
}

/// The value in an envelope of at most `LIMIT` bytes. `bytes` must be the envelope and nothing more.
pub fn open<T: Sealed, const LIMIT: usize>(bytes: &[u8]) -> Result<T, EnvelopeError> {
    let short = EnvelopeError::Length { expected: HEADER_BYTES as u64, found: bytes.len() as u64 };
    let (header, inside) = bytes.split_first_chunk::<HEADER_BYTES>().ok_or(short)?;
    if header[..8] != T::MAGIC {
        return Err(EnvelopeError::Magic);
    }
    let (version, reserved) = (word(header, 8) as u32, (word(header, 8) >> 32) as u32);
    if version != T::VERSION {
        return Err(EnvelopeError::Version { found: version, supported: T::VERSION });
    }
    if reserved != 0 {
        return Err(EnvelopeError::Value("a reserved field is not zero".into()));
    }
    let (length, found) = (stated_length(header), inside.len() as u64);
    if length != found {
        return Err(EnvelopeError::Length { expected: length, found });
    }
    if inside.len() > LIMIT {
        return Err(EnvelopeError::TooLong { length, limit: LIMIT as u64 });
    }
    if word(header, 24) != xxh3_64_with_seed(inside, u64::from(version)) {
        return Err(EnvelopeError::Checksum);
    }
    let config = bincode::config::legacy().with_limit::<LIMIT>();
    let (value, used): (T, usize) =
        bincode::serde::decode_from_slice(inside, config).map_err(|e| EnvelopeError::Value(e.to_string()))?;
    if used != inside.len() {
        return Err(EnvelopeError::Value(format!("{} bytes are left over", inside.len() - used)));
    }
    value.check().map_err(EnvelopeError::Value)?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Serialize, Deserialize, PartialEq, Clone, Debug)]
    struct Sample {
        names: Vec<String>,
        number: f64,
    }

    impl Sealed for Sample {
        const MAGIC: [u8; 8] = *b"sample\r\n";
        const VERSION: u32 = 3;

        fn check(&self) -> Result<(), String> {
            if self.number.is_finite() { Ok(()) } else { Err("number is not finite".into()) }
        }
    }

    fn sample() -> Sample {
        Sample { names: vec!["a".into(), "bc".into()], number: -0.5 }
    }

    #[test]
    fn what_is_sealed_is_opened() {
        let bytes = seal(&sample()).unwrap();
        assert_eq!(open::<Sample, 1024>(&bytes).unwrap(), sample());
    }

    #[test]
    fn every_flipped_bit_and_every_length_is_refused() {
        let bytes = seal(&sample()).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut bad = bytes.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(open::<Sample, 1024>(&bad).is_err(), "bit {bit}");
        }
        for length in 0..bytes.len() {
            assert!(open::<Sample, 1024>(&bytes[..length]).is_err(), "length {length}");
        }
        let longer = [&bytes[..], &[0]].concat();
        assert!(matches!(open::<Sample, 1024>(&longer), Err(EnvelopeError::Length { .. })));
    }

    #[test]
    fn limits_and_senseless_values_are_refused() {
        let bytes = seal(&sample()).unwrap();
        assert!(matches!(open::<Sample, 16>(&bytes), Err(EnvelopeError::TooLong { limit: 16, .. })));
        let bytes = seal(&Sample { number: f64::NAN, ..sample() }).unwrap();
        assert_eq!(open::<Sample, 1024>(&bytes), Err(EnvelopeError::Value("number is not finite".into())));
    }

    /// A value that states 2^60 names must not make the reader allocate for them.
    #[test]
    fn a_lying_length_inside_is_refused() {
        let mut inside = (1_u64 << 60).to_le_bytes().to_vec();
        inside.extend_from_slice(&[0; 24]);
        let mut bytes = Sample::MAGIC.to_vec();
        bytes.extend_from_slice(&u64::from(Sample::VERSION).to_le_bytes());
        bytes.extend_from_slice(&(inside.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&xxh3_64_with_seed(&inside, 3).to_le_bytes());
        bytes.extend_from_slice(&inside);
        assert!(matches!(open::<Sample, 1024>(&bytes), Err(EnvelopeError::Value(_))));
    }
}
