//! The GeoTIFF tag and GDAL's `RPC` metadata domain.

use super::ReadError;
use super::fields::{Fields, Polynomial, Scalar, camera, number, shortened, twenty};
use crate::Rpc;
use std::collections::BTreeMap;

/// Values of the GeoTIFF tag RPCCoefficientTag.
const GEOTIFF_TAG_VALUES: usize = 92;

/// The camera of GeoTIFF tag 50844 (RPCCoefficientTag): 92 doubles, errors, offsets, scales and four polynomials.
///
/// # Errors
/// When there are not 92 values, or values are not finite, or a scale is zero.
pub fn geotiff_tag(values: &[f64]) -> Result<Rpc, ReadError> {
    let values = values.try_into().map_err(|_| ReadError::Malformed {
        format: Tag::FORMAT,
        reason: format!("{} values, expected {GEOTIFF_TAG_VALUES}", values.len()),
    })?;
    camera(&Tag { values })
}

struct Tag<'a> {
    values: &'a [f64; GEOTIFF_TAG_VALUES],
}

impl Tag<'_> {
    const FORMAT: &'static str = "GeoTIFF tag 50844 (RPCCoefficientTag)";
}

impl Fields for Tag<'_> {
    fn format(&self) -> &'static str {
        Self::FORMAT
    }
    fn scalar_name(&self, scalar: Scalar) -> String {
        Domain::scalar_key(scalar).to_owned()
    }
    fn polynomial_name(&self, polynomial: Polynomial) -> String {
        Domain::polynomial_key(polynomial).to_owned()
    }
    fn scalar(&self, scalar: Scalar) -> Result<f64, ReadError> {
        Ok(self.values[2 + scalar as usize])
    }
    fn polynomial(&self, polynomial: Polynomial) -> Result<[f64; 20], ReadError> {
        let start = 12 + 20 * polynomial as usize;
        Ok(std::array::from_fn(|i| self.values[start + i]))
    }
    fn errors(&self) -> [Option<f64>; 2] {
        // A negative error is the tag's way to say "unknown".
        [self.values[0], self.values[1]].map(|v| (v >= 0.0).then_some(v))
    }
}

/// The camera of GDAL's `RPC` metadata domain (`LINE_OFF`, ..., `LINE_NUM_COEFF` with 20 numbers, ...); values may carry
/// units.
///
/// # Errors
/// When an item is missing or is not a number.
pub fn gdal_domain(items: &BTreeMap<String, String>) -> Result<Rpc, ReadError> {
    camera(&Domain { items })
}

struct Domain<'a> {
    items: &'a BTreeMap<String, String>,
}

impl Domain<'_> {
    const FORMAT: &'static str = "GDAL RPC domain";

    fn scalar_key(scalar: Scalar) -> &'static str {
        match scalar {
            Scalar::LineOffset => "LINE_OFF",
            Scalar::SampleOffset => "SAMP_OFF",
            Scalar::LatitudeOffset => "LAT_OFF",
            Scalar::LongitudeOffset => "LONG_OFF",
            Scalar::HeightOffset => "HEIGHT_OFF",
            Scalar::LineScale => "LINE_SCALE",
            Scalar::SampleScale => "SAMP_SCALE",
            Scalar::LatitudeScale => "LAT_SCALE",
            Scalar::LongitudeScale => "LONG_SCALE",
            Scalar::HeightScale => "HEIGHT_SCALE",
        }
    }

    fn polynomial_key(polynomial: Polynomial) -> &'static str {
        match polynomial {
            Polynomial::LineNumerator => "LINE_NUM_COEFF",
            Polynomial::LineDenominator => "LINE_DEN_COEFF",
            Polynomial::SampleNumerator => "SAMP_NUM_COEFF",
            Polynomial::SampleDenominator => "SAMP_DEN_COEFF",
        }
    }

    fn text(&self, key: &str) -> Result<&str, ReadError> {
        self.items.get(key).map(String::as_str).ok_or_else(|| ReadError::Missing {
            format: Self::FORMAT,
            field: key.to_owned(),
        })
    }
}

impl Fields for Domain<'_> {
    fn format(&self) -> &'static str {
        Self::FORMAT
    }
    fn scalar_name(&self, scalar: Scalar) -> String {
        Self::scalar_key(scalar).to_owned()
    }
    fn polynomial_name(&self, polynomial: Polynomial) -> String {
        Self::polynomial_key(polynomial).to_owned()
    }
    fn scalar(&self, scalar: Scalar) -> Result<f64, ReadError> {
        let key = Self::scalar_key(scalar);
        let text = self.text(key)?;
        number(text).ok_or_else(|| ReadError::BadValue {
            format: Self::FORMAT,
            field: key.to_owned(),
            value: shortened(text),
            expected: "a number",
        })
    }
    fn polynomial(&self, polynomial: Polynomial) -> Result<[f64; 20], ReadError> {
        let key = Self::polynomial_key(polynomial);
        twenty(Self::FORMAT, key, self.text(key)?)
    }
    fn errors(&self) -> [Option<f64>; 2] {
        ["ERR_BIAS", "ERR_RAND"].map(|key| self.items.get(key).and_then(|text| number(text)).filter(|v| *v >= 0.0))
    }
}
