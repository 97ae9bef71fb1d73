//! Which samples stand for "no data".

/// Magnitude beyond which a declared value and a sample of the same sign are one: writers print the greatest number of
/// a type with as many digits as they like, and nothing else is that large.
const HUGE: f64 = 1e30;

/// What signed samples that are void hold in files that declare nothing: SRTM's and USGS's values.
const USUAL: [f64; 2] = [-32_768.0, -32_767.0];
/// And floating-point ones.
const USUAL_FLOAT: f64 = -9999.0;

/// The samples that are void. Those that are not finite always are.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Nodata {
    declared: Option<f64>,
    /// Whether samples are, or may have been, 32-bit: then the declared value is rounded like them.
    single: bool,
    /// Whether [`USUAL`] values, and [`USUAL_FLOAT`], are void though nothing is declared.
    usual: bool,
    usual_float: bool,
}

impl Nodata {
    /// A rule from a declared value; NaN adds nothing. An infinity does: writers that round the greatest f64 to 15 digits
    /// declare a number beyond it.
    pub(super) fn new(declared: Option<f64>, single: bool) -> Self {
        Self { declared: declared.filter(|v| !v.is_nan()), single, usual: false, usual_float: false }
    }

    /// The rule for a file that declares nothing, by the type of its samples: values that writers use for no data and
    /// that no place has. -9999 is one of them among floating-point samples only; a sea trench may be just as deep in
    /// whole metres. A guess, told in a note and replaced by the user's word.
    pub(super) fn undeclared(signed: bool, float: bool) -> Self {
        Self { declared: None, single: false, usual: signed, usual_float: float }
    }

    /// Whether `sample` is void.
    #[inline]
    pub(super) fn is_void(self, sample: f64) -> bool {
        if !sample.is_finite() {
            return true;
        }
        if (self.usual && USUAL.contains(&sample)) || (self.usual_float && sample == USUAL_FLOAT) {
            return true;
        }
        self.declared.is_some_and(|v| {
            sample == v
                || (self.single && sample as f32 == v as f32)
                || (sample.abs() > HUGE && v.abs() > HUGE && (sample < 0.0) == (v < 0.0))
        })
    }
}

/// A declared value in any spelling met in the wild; `Ok(None)` when there is none, the text when it is no number.
pub(super) fn parse(text: &str) -> Result<Option<f64>, String> {
    let word = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    let lower = word.to_ascii_lowercase();
    if lower.is_empty() || lower == "none" || lower == "null" {
        return Ok(None);
    }
    // Microsoft's spellings of NaN and infinity: 1.#QNAN, -1.#IND, 1.#INF.
    if lower.contains("nan") || lower.contains(".#") {
        return Ok(Some(f64::NAN));
    }
    lower.parse().map(Some).map_err(|_| word.chars().take(40).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_of_a_declared_value_finds_its_samples() {
        let void = |text: &str, sample: f64| Nodata::new(parse(text).unwrap(), true).is_void(sample);
        assert!(void("-9999", -9999.0) && void(" -9999.00000 \0", -9999.0) && void("-9.999e3", -9999.0));
        assert!(!void("-9999", -9998.0) && !void("", -9999.0));
        for text in ["nan", "NaN", "-nan", "1.#QNAN", "-1.#IND", "none", ""] {
            assert!(void(text, f64::NAN) && !void(text, 0.0), "{text}");
        }
        for text in ["-3.4028234663852886e+38", "-3.40282346639e+38", "-3.402823e38", "-1.79769313486232e+308"] {
            assert!(void(text, f64::from(f32::MIN)) && !void(text, f64::from(f32::MAX)), "{text}");
        }
        assert!(parse("void").is_err());
    }
}
