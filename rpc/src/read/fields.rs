//! From named values to a checked camera: every reader ends here.

use super::ReadError;
use crate::Rpc;

/// The scalars of a camera, in the order of the GeoTIFF tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    LineOffset,
    SampleOffset,
    LatitudeOffset,
    LongitudeOffset,
    HeightOffset,
    LineScale,
    SampleScale,
    LatitudeScale,
    LongitudeScale,
    HeightScale,
}

/// The four polynomials of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Polynomial {
    LineNumerator,
    LineDenominator,
    SampleNumerator,
    SampleDenominator,
}

/// A format's way to a value: its own name for it, and the value where it is there.
pub(super) trait Fields {
    /// The format, for errors.
    fn format(&self) -> &'static str;
    /// The format's name for a scalar.
    fn scalar_name(&self, scalar: Scalar) -> String;
    /// The format's name for a polynomial.
    fn polynomial_name(&self, polynomial: Polynomial) -> String;
    /// A scalar's value.
    fn scalar(&self, scalar: Scalar) -> Result<f64, ReadError>;
    /// A polynomial's coefficients.
    fn polynomial(&self, polynomial: Polynomial) -> Result<[f64; 20], ReadError>;
    /// Stated bias and random errors, metres, where they are there.
    fn errors(&self) -> [Option<f64>; 2] {
        [None, None]
    }
}

/// The checked camera.
pub(super) fn camera(fields: &impl Fields) -> Result<Rpc, ReadError> {
    let bad = |field: String, value: f64, expected| ReadError::BadValue {
        format: fields.format(),
        field,
        value: value.to_string(),
        expected,
    };
    let offset = |scalar| {
        let value = fields.scalar(scalar)?;
        let ok = value.is_finite();
        ok.then_some(value).ok_or_else(|| bad(fields.scalar_name(scalar), value, "a finite number"))
    };
    let scale = |scalar| {
        let value = fields.scalar(scalar)?;
        let ok = value.is_finite() && value != 0.0;
        ok.then_some(value).ok_or_else(|| bad(fields.scalar_name(scalar), value, "a finite number that is not zero"))
    };
    let polynomial = |polynomial, is_denominator: bool| {
        let values = fields.polynomial(polynomial)?;
        if let Some(&value) = values.iter().find(|value| !value.is_finite()) {
            return Err(bad(fields.polynomial_name(polynomial), value, "finite coefficients"));
        }
        if is_denominator && values.iter().all(|&value| value == 0.0) {
            return Err(bad(fields.polynomial_name(polynomial), 0.0, "a denominator that is not zero"));
        }
        Ok(values)
    };
    let [error_bias_m, error_random_m] = fields.errors().map(|e| e.filter(|v| v.is_finite()));
    Ok(Rpc {
        line_offset: offset(Scalar::LineOffset)?,
        sample_offset: offset(Scalar::SampleOffset)?,
        latitude_offset_deg: offset(Scalar::LatitudeOffset)?,
        longitude_offset_deg: offset(Scalar::LongitudeOffset)?,
        height_offset_m: offset(Scalar::HeightOffset)?,
        line_scale: scale(Scalar::LineScale)?,
        sample_scale: scale(Scalar::SampleScale)?,
        latitude_scale_deg: scale(Scalar::LatitudeScale)?,
        longitude_scale_deg: scale(Scalar::LongitudeScale)?,
        height_scale_m: scale(Scalar::HeightScale)?,
        line_numerator: polynomial(Polynomial::LineNumerator, false)?,
        line_denominator: polynomial(Polynomial::LineDenominator, true)?,
        sample_numerator: polynomial(Polynomial::SampleNumerator, false)?,
        sample_denominator: polynomial(Polynomial::SampleDenominator, true)?,
        error_bias_m,
        error_random_m,
    })
}

/// A number that may carry a unit (`+013741.00 pixels`), a sign, a three-digit or Fortran exponent, quotes, a trailing
/// semicolon or comma.
pub(super) fn number(text: &str) -> Option<f64> {
    let first = text.trim().trim_matches(['"', '\'']).split_whitespace().next()?;
    let first = first.trim_end_matches([';', ',']).trim_matches('"');
    // Rust's parser takes "inf" and "nan" too; a number has a digit.
    if !first.bytes().any(|b| b.is_ascii_digit()) {
        return None;
    }
    first.parse().ok().or_else(|| first.replace(['D', 'd'], "e").parse().ok())
}

/// At most a few dozen characters of a value, for an error.
pub(super) fn shortened(value: &str) -> String {
    const LONGEST: usize = 48;
    match value.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value.to_owned(),
    }
}

/// Exactly twenty numbers between white space, commas, semicolons or parentheses.
pub(super) fn twenty(format: &'static str, field: &str, text: &str) -> Result<[f64; 20], ReadError> {
    let bad = |value: &str| ReadError::BadValue {
        format,
        field: field.to_owned(),
        value: shortened(value),
        expected: "20 numbers",
    };
    let mut values = [0.0; 20];
    let mut count = 0;
    let is_separator = |c: char| c.is_whitespace() || matches!(c, ',' | ';' | '(' | ')' | '[' | ']');
    for token in text.split(is_separator).filter(|token| !token.is_empty()) {
        let value = number(token).ok_or_else(|| bad(token))?;
        *values.get_mut(count).ok_or_else(|| bad(text))? = value;
        count += 1;
    }
    if count == 20 { Ok(values) } else { Err(bad(text)) }
}
