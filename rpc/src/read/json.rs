//! Cameras in JSON: Sat-NeRF (and rpcm), VisSat, and GDAL's own RPC names.

use super::error::ReadError;
use super::fields::{Dialect, Source, camera, customary, number};
use super::statements::without_mark;
use crate::rpc::Rpc;
use serde_json::{Map, Value};

/// The camera of a Sat-NeRF image JSON (`rpc: {row_offset, ..., row_num, ...}`), or of the `rpc` object alone.
///
/// VisSat's names (`rowOff`, ..., `rowNum`, ...) and GDAL's (`LINE_OFF`, ..., `LINE_NUM_COEFF`, ...) are read as well.
///
/// # Errors
/// When the text is not JSON, or a key is missing or is not a number.
pub fn satnerf_json(text: &str) -> Result<Rpc, ReadError> {
    let document: Value = serde_json::from_str(without_mark(text)).map_err(|error| ReadError::Malformed {
        format: "RPC JSON",
        reason: error.to_string(),
    })?;
    let object = document.get("rpc").unwrap_or(&document).as_object();
    let object = object.ok_or_else(|| SATNERF.missing("the object \"rpc\""))?;
    let dialect = [&SATNERF, &VISSAT, &GDAL]
        .into_iter()
        .rev()
        .max_by_key(|dialect| keys_present(dialect, object));
    camera(dialect.unwrap_or(&SATNERF), &JsonSource { object })
}

/// The names of Sat-NeRF.
pub(crate) const SATNERF: Dialect = Dialect {
    format: "Sat-NeRF JSON",
    scalars: [
        "row_offset",
        "col_offset",
        "lat_offset",
        "lon_offset",
        "alt_offset",
        "row_scale",
        "col_scale",
        "lat_scale",
        "lon_scale",
        "alt_scale",
    ],
    polynomials: ["row_num", "row_den", "col_num", "col_den"],
    errors: ["err_bias", "err_rand"],
};

const VISSAT: Dialect = Dialect {
    format: "VisSat JSON",
    scalars: [
        "rowOff", "colOff", "latOff", "lonOff", "altOff", "rowScale", "colScale", "latScale", "lonScale", "altScale",
    ],
    polynomials: ["rowNum", "rowDen", "colNum", "colDen"],
    errors: ["errBias", "errRand"],
};

const GDAL: Dialect = customary("RPC JSON");

fn keys_present(dialect: &Dialect, object: &Map<String, Value>) -> usize {
    dialect
        .scalars
        .iter()
        .chain(&dialect.polynomials)
        .filter(|key| object.contains_key(**key))
        .count()
}

struct JsonSource<'a> {
    object: &'a Map<String, Value>,
}

/// A JSON number, or a string that holds one (`"+50.8"`).
pub(super) fn json_number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_str().and_then(number))
}

impl Source for JsonSource<'_> {
    fn number(&self, dialect: &Dialect, name: &str) -> Result<f64, ReadError> {
        let value = self.object.get(name).ok_or_else(|| dialect.missing(name))?;
        json_number(value).ok_or_else(|| dialect.bad(name, &value.to_string(), "a number"))
    }

    fn polynomial(&self, dialect: &Dialect, name: &str) -> Result<[f64; 20], ReadError> {
        let value = self.object.get(name).ok_or_else(|| dialect.missing(name))?;
        if let Some(list) = value.as_str() {
            return dialect.twenty_in(name, list);
        }
        let bad = || dialect.bad(name, &value.to_string(), "20 numbers");
        let list = value.as_array().filter(|list| list.len() == 20).ok_or_else(bad)?;
        let mut coefficients = [0.0; 20];
        for (slot, value) in coefficients.iter_mut().zip(list) {
            *slot = json_number(value).ok_or_else(bad)?;
        }
        Ok(coefficients)
    }
}
