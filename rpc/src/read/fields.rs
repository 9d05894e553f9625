//! Checked camera from named values: the last step of every reader.

use super::error::ReadError;
use crate::rpc::Rpc;

/// Names of a camera's values in a format; scalars and polynomials in the order of the GeoTIFF tag.
pub(crate) struct Dialect {
    /// Name of the format in errors.
    pub(super) format: &'static str,
    /// Offsets of line, sample, latitude, longitude and height, then their scales.
    pub(crate) scalars: [&'static str; 10],
    /// Line numerator and denominator, sample numerator and denominator.
    pub(crate) polynomials: [&'static str; 4],
    /// Stated bias and random errors, metres.
    pub(crate) errors: [&'static str; 2],
}

/// The names of GDAL, `_RPC.TXT`, DIMAP and NITF.
pub(crate) const fn customary(format: &'static str) -> Dialect {
    Dialect {
        format,
        scalars: [
            "LINE_OFF",
            "SAMP_OFF",
            "LAT_OFF",
            "LONG_OFF",
            "HEIGHT_OFF",
            "LINE_SCALE",
            "SAMP_SCALE",
            "LAT_SCALE",
            "LONG_SCALE",
            "HEIGHT_SCALE",
        ],
        polynomials: ["LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF"],
        errors: ["ERR_BIAS", "ERR_RAND"],
    }
}

/// Access to the values of a format by name.
pub(super) trait Source {
    /// The number called `name`.
    fn number(&self, dialect: &Dialect, name: &str) -> Result<f64, ReadError>;
    /// The twenty coefficients called `name`.
    fn polynomial(&self, dialect: &Dialect, name: &str) -> Result<[f64; 20], ReadError>;
}

/// The camera of a source; an error unless all values are finite, and scales and denominators are not zero.
pub(super) fn camera(dialect: &Dialect, source: &impl Source) -> Result<Rpc, ReadError> {
    let bad = |field: &str, value: f64, expected| dialect.bad(field, &value.to_string(), expected);
    let offset = |index: usize| {
        let name = dialect.scalars[index];
        let value = source.number(dialect, name)?;
        value
            .is_finite()
            .then_some(value)
            .ok_or_else(|| bad(name, value, "a finite number"))
    };
    let scale = |index: usize| {
        let name = dialect.scalars[index];
        let value = source.number(dialect, name)?;
        let ok = value.is_finite() && value != 0.0;
        ok.then_some(value)
            .ok_or_else(|| bad(name, value, "a finite number that is not zero"))
    };
    let polynomial = |index: usize| {
        let name = dialect.polynomials[index];
        let values = source.polynomial(dialect, name)?;
        if let Some(&value) = values.iter().find(|value| !value.is_finite()) {
            return Err(bad(name, value, "finite coefficients"));
        }
        let is_denominator = index % 2 == 1;
        if is_denominator && values.iter().all(|&value| value == 0.0) {
            return Err(bad(name, 0.0, "a denominator that is not zero"));
        }
        Ok(values)
    };
    // Absent or negative errors are unknown: the GeoTIFF tag writes -1 for them.
    let error = |index: usize| {
        source
            .number(dialect, dialect.errors[index])
            .ok()
            .filter(|v| v.is_finite() && *v >= 0.0)
    };
    Ok(Rpc {
        line_offset: offset(0)?,
        sample_offset: offset(1)?,
        latitude_offset_deg: offset(2)?,
        longitude_offset_deg: offset(3)?,
        height_offset_m: offset(4)?,
        line_scale: scale(5)?,
        sample_scale: scale(6)?,
        latitude_scale_deg: scale(7)?,
        longitude_scale_deg: scale(8)?,
        height_scale_m: scale(9)?,
        line_numerator: polynomial(0)?,
        line_denominator: polynomial(1)?,
        sample_numerator: polynomial(2)?,
        sample_denominator: polynomial(3)?,
        error_bias_m: error(0),
        error_random_m: error(1),
    })
}

impl Dialect {
    /// Error of an absent value.
    pub(super) fn missing(&self, field: &str) -> ReadError {
        ReadError::Missing {
            format: self.format,
            field: field.to_owned(),
        }
    }

    /// Error of a value other than `expected`.
    pub(super) fn bad(&self, field: &str, value: &str, expected: &'static str) -> ReadError {
        ReadError::BadValue {
            format: self.format,
            field: field.to_owned(),
            value: shortened(value),
            expected,
        }
    }

    /// The number in `text`; an error that names `field` where there is none.
    pub(super) fn number_in(&self, field: &str, text: &str) -> Result<f64, ReadError> {
        number(text).ok_or_else(|| self.bad(field, text, "a number"))
    }

    /// Exactly twenty numbers between white space, commas, semicolons or brackets.
    pub(super) fn twenty_in(&self, field: &str, text: &str) -> Result<[f64; 20], ReadError> {
        let is_separator = |c: char| c.is_whitespace() || matches!(c, ',' | ';' | '(' | ')' | '[' | ']');
        let mut values = [0.0; 20];
        let mut count = 0;
        for token in text.split(is_separator).filter(|token| !token.is_empty()) {
            let value = number(token).ok_or_else(|| self.bad(field, token, "20 numbers"))?;
            let slot = values
                .get_mut(count)
                .ok_or_else(|| self.bad(field, text, "20 numbers and no more"))?;
            *slot = value;
            count += 1;
        }
        if count == 20 {
            Ok(values)
        } else {
            Err(self.bad(field, text, "20 numbers"))
        }
    }
}

/// Values by name as text: `LINE_NUM_COEFF` as a list of twenty, or as twenty values with a number behind the name.
pub(super) struct TextSource<F> {
    /// The value of a name, where there is one.
    pub(super) lookup: F,
    /// The name of coefficient `index` (from 0), for formats that number them.
    pub(super) numbered: Option<fn(name: &str, index: usize) -> String>,
}

impl<'a, F: Fn(&str) -> Option<&'a str>> Source for TextSource<F> {
    fn number(&self, dialect: &Dialect, name: &str) -> Result<f64, ReadError> {
        let text = (self.lookup)(name).ok_or_else(|| dialect.missing(name))?;
        dialect.number_in(name, text)
    }

    fn polynomial(&self, dialect: &Dialect, name: &str) -> Result<[f64; 20], ReadError> {
        if let Some(list) = (self.lookup)(name) {
            return dialect.twenty_in(name, list);
        }
        let numbered = self.numbered.ok_or_else(|| dialect.missing(name))?;
        let mut values = [0.0; 20];
        for (index, slot) in values.iter_mut().enumerate() {
            *slot = self.number(dialect, &numbered(name, index))?;
        }
        Ok(values)
    }
}

/// `LINE_NUM_COEFF_1` to `_20`.
pub(super) fn numbered_from_one(name: &str, index: usize) -> String {
    format!("{name}_{}", index + 1)
}

/// Ninety-two numbers in the order of the GeoTIFF tag: errors, scalars, polynomials.
pub(super) struct OrderedSource<'a> {
    /// Values in the order of the tag.
    pub(super) values: &'a [f64; 92],
}

impl Source for OrderedSource<'_> {
    fn number(&self, dialect: &Dialect, name: &str) -> Result<f64, ReadError> {
        let mut names = dialect.errors.iter().chain(&dialect.scalars);
        let index = names
            .position(|known| *known == name)
            .ok_or_else(|| dialect.missing(name))?;
        Ok(self.values[index])
    }

    fn polynomial(&self, dialect: &Dialect, name: &str) -> Result<[f64; 20], ReadError> {
        let index = dialect.polynomials.iter().position(|known| *known == name);
        let index = index.ok_or_else(|| dialect.missing(name))?;
        Ok(std::array::from_fn(|i| self.values[12 + 20 * index + i]))
    }
}

/// A number that may carry a unit (`+013741.00 pixels`), a sign, a three-digit or Fortran exponent, quotes, a trailing
/// semicolon or comma.
pub(super) fn number(text: &str) -> Option<f64> {
    let first = text.trim().trim_matches(['"', '\'']).split_whitespace().next()?;
    let first = first.trim_end_matches([';', ',', '"', '\'']);
    // Rust's parser takes "inf" and "nan" too; a number has a digit.
    if !first.bytes().any(|b| b.is_ascii_digit()) {
        return None;
    }
    first
        .parse()
        .ok()
        .or_else(|| first.replace(['D', 'd'], "e").parse().ok())
}

/// The first 48 characters of a value, for an error.
pub(super) fn shortened(value: &str) -> String {
    const LONGEST: usize = 48;
    match value.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_with_units_signs_and_odd_exponents() {
        for (text, value) in [
            ("+013741.00 pixels", 13_741.0),
            ("\t 1937.50 pixels\r", 1_937.5),
            ("2.094646315995084e-004", 2.094_646_315_995_084e-4),
            ("-0.00", 0.0),
            ("1.5D-03", 1.5e-3),
            ("\"+50.8\"", 50.8),
            ("812;", 812.0),
        ] {
            assert_eq!(number(text), Some(value), "{text:?}");
        }
        for text in ["", " ", "nan", "inf", "LINE_OFF", "--1", "1e", "pixels 3"] {
            assert_eq!(number(text), None, "{text:?}");
        }
    }

    #[test]
    fn long_values_are_shortened_between_characters() {
        assert_eq!(shortened("short"), "short");
        assert_eq!(shortened(&"é".repeat(100)).chars().count(), 49);
    }
}
