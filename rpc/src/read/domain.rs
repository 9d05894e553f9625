//! The GeoTIFF tag and GDAL's `RPC` metadata domain.

use super::error::ReadError;
use super::fields::{OrderedSource, TextSource, camera, customary};
use crate::rpc::Rpc;
use std::collections::BTreeMap;

/// The camera of GeoTIFF tag 50844 (RPCCoefficientTag): 92 doubles, errors, offsets, scales and four polynomials.
///
/// # Errors
/// When there are not 92 values, a value is not finite, or a scale or a denominator is zero.
pub fn geotiff_tag(values: &[f64]) -> Result<Rpc, ReadError> {
    let dialect = customary("GeoTIFF tag 50844 (RPCCoefficientTag)");
    let values = values.try_into().map_err(|_| ReadError::Malformed {
        format: dialect.format,
        reason: format!("{} values, expected 92", values.len()),
    })?;
    camera(&dialect, &OrderedSource { values })
}

/// The camera of GDAL's `RPC` metadata domain (`LINE_OFF`, ..., `LINE_NUM_COEFF` with 20 numbers, ...); values may
/// carry units.
///
/// # Errors
/// When an item is missing or is not a number, or a scale or a denominator is zero.
pub fn gdal_domain(items: &BTreeMap<String, String>) -> Result<Rpc, ReadError> {
    let source = TextSource {
        lookup: |name: &str| items.get(name).map(String::as_str),
        numbered: None,
    };
    camera(&customary("GDAL RPC domain"), &source)
}
