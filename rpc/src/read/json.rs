//! Cameras in JSON: Sat-NeRF (and rpcm), VisSat, and GDAL's own RPC names.

use super::ReadError;
use super::fields::{Fields, Polynomial, Scalar, camera, number, shortened};
use crate::Rpc;
use serde_json::{Map, Value};

/// The camera of a Sat-NeRF image JSON (`rpc: {row_offset, ..., row_num, ...}`), or of the `rpc` object alone.
///
/// VisSat's names (`rowOff`, ..., `rowNum`, ...) and GDAL's (`LINE_OFF`, ..., `LINE_NUM_COEFF`, ...) are read as well.
///
/// # Errors
/// When the text is not JSON, or a key is missing or is not a number.
pub fn satnerf_json(text: &str) -> Result<Rpc, ReadError> {
    let document: Value = serde_json::from_str(text).map_err(|error| ReadError::Malformed {
        format: "RPC JSON",
        reason: error.to_string(),
    })?;
    let object = document.get("rpc").unwrap_or(&document).as_object();
    let object = object.ok_or_else(|| ReadError::Missing {
        format: "RPC JSON",
        field: "the object \"rpc\"".into(),
    })?;
    let dialect = [&SATNERF, &VISSAT, &GDAL]
        .into_iter()
        .max_by_key(|dialect| dialect.keys_present(object))
        .filter(|dialect| dialect.keys_present(object) > 0)
        .unwrap_or(&SATNERF);
    camera(&Json { object, dialect })
}

/// The names one kind of JSON uses: scalars in the order of [`Scalar`], polynomials in that of [`Polynomial`].
struct Dialect {
    format: &'static str,
    scalars: [&'static str; 10],
    polynomials: [&'static str; 4],
}

const SATNERF: Dialect = Dialect {
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
};

const VISSAT: Dialect = Dialect {
    format: "VisSat JSON",
    scalars: [
        "rowOff", "colOff", "latOff", "lonOff", "altOff", "rowScale", "colScale", "latScale", "lonScale", "altScale",
    ],
    polynomials: ["rowNum", "rowDen", "colNum", "colDen"],
};

const GDAL: Dialect = Dialect {
    format: "RPC JSON",
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
};

impl Dialect {
    fn keys_present(&self, object: &Map<String, Value>) -> usize {
        self.scalars.iter().chain(&self.polynomials).filter(|key| object.contains_key(**key)).count()
    }
}

struct Json<'a> {
    object: &'a Map<String, Value>,
    dialect: &'static Dialect,
}

impl Json<'_> {
    fn value(&self, key: &str) -> Result<&Value, ReadError> {
        self.object.get(key).ok_or_else(|| ReadError::Missing {
            format: self.dialect.format,
            field: key.to_owned(),
        })
    }

    fn bad(&self, key: &str, value: &Value, expected: &'static str) -> ReadError {
        ReadError::BadValue {
            format: self.dialect.format,
            field: key.to_owned(),
            value: shortened(&value.to_string()),
            expected,
        }
    }
}

/// A JSON number, or a string that holds one (`"+50.8"`).
pub(super) fn json_number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_str().and_then(number))
}

impl Fields for Json<'_> {
    fn format(&self) -> &'static str {
        self.dialect.format
    }
    fn scalar_name(&self, scalar: Scalar) -> String {
        self.dialect.scalars[scalar as usize].to_owned()
    }
    fn polynomial_name(&self, polynomial: Polynomial) -> String {
        self.dialect.polynomials[polynomial as usize].to_owned()
    }
    fn scalar(&self, scalar: Scalar) -> Result<f64, ReadError> {
        let key = self.dialect.scalars[scalar as usize];
        let value = self.value(key)?;
        json_number(value).ok_or_else(|| self.bad(key, value, "a number"))
    }
    fn polynomial(&self, polynomial: Polynomial) -> Result<[f64; 20], ReadError> {
        let key = self.dialect.polynomials[polynomial as usize];
        let value = self.value(key)?;
        let bad = || self.bad(key, value, "20 numbers");
        let list = value.as_array().filter(|list| list.len() == 20).ok_or_else(bad)?;
        let mut coefficients = [0.0; 20];
        for (slot, value) in coefficients.iter_mut().zip(list) {
            *slot = json_number(value).ok_or_else(bad)?;
        }
        Ok(coefficients)
    }
}
