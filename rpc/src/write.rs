//! Cameras in the formats of other tools. Every number is written so that it reads back bit for bit (17 significant
//! digits).

use crate::rpc::Rpc;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// GeoTIFF tag 50844 (RPCCoefficientTag); unknown errors are written as -1, as the tag defines.
pub fn geotiff_tag(rpc: &Rpc) -> [f64; 92] {
    let mut tag = [0.0; 92];
    tag[0] = rpc.error_bias_m.unwrap_or(-1.0);
    tag[1] = rpc.error_random_m.unwrap_or(-1.0);
    for (slot, (_, value)) in tag[2..12].iter_mut().zip(scalars(rpc)) {
        *slot = value;
    }
    for (slots, (_, values)) in tag[12..].chunks_exact_mut(20).zip(polynomials(rpc)) {
        slots.copy_from_slice(values);
    }
    tag
}

/// An `_RPC.TXT` sidecar: one `NAME: value` per line, which GDAL and most photogrammetric tools read.
pub fn rpc_txt(rpc: &Rpc) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: f64| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{name}: {}", seventeen_digits(value));
    };
    for (name, value) in errors(rpc) {
        if let Some(value) = value {
            line(name, value);
        }
    }
    for (name, value) in scalars(rpc) {
        line(name, value);
    }
    for (name, values) in polynomials(rpc) {
        for (index, value) in values.iter().enumerate() {
            line(&format!("{name}_{}", index + 1), *value);
        }
    }
    text
}

/// The `rpc` object of a Sat-NeRF JSON.
pub fn satnerf_json_rpc(rpc: &Rpc) -> Value {
    json!({
        "row_offset": rpc.line_offset,
        "col_offset": rpc.sample_offset,
        "lat_offset": rpc.latitude_offset_deg,
        "lon_offset": rpc.longitude_offset_deg,
        "alt_offset": rpc.height_offset_m,
        "row_scale": rpc.line_scale,
        "col_scale": rpc.sample_scale,
        "lat_scale": rpc.latitude_scale_deg,
        "lon_scale": rpc.longitude_scale_deg,
        "alt_scale": rpc.height_scale_m,
        "row_num": rpc.line_numerator,
        "row_den": rpc.line_denominator,
        "col_num": rpc.sample_numerator,
        "col_den": rpc.sample_denominator,
    })
}

/// The items of GDAL's `RPC` metadata domain.
pub fn gdal_domain(rpc: &Rpc) -> BTreeMap<String, String> {
    let errors = errors(rpc)
        .into_iter()
        .filter_map(|(name, value)| Some((name, seventeen_digits(value?))));
    let scalars = scalars(rpc)
        .into_iter()
        .map(|(name, value)| (name, seventeen_digits(value)));
    let polynomials = polynomials(rpc).into_iter().map(|(name, values)| {
        let texts: Vec<String> = values.iter().map(|value| seventeen_digits(*value)).collect();
        (name, texts.join(" "))
    });
    errors
        .chain(scalars)
        .chain(polynomials)
        .map(|(name, text)| (name.to_owned(), text))
        .collect()
}

fn seventeen_digits(value: f64) -> String {
    format!("{value:.16e}")
}

fn errors(rpc: &Rpc) -> [(&'static str, Option<f64>); 2] {
    [("ERR_BIAS", rpc.error_bias_m), ("ERR_RAND", rpc.error_random_m)]
}

/// Scalars by their customary names, in the order of the GeoTIFF tag.
fn scalars(rpc: &Rpc) -> [(&'static str, f64); 10] {
    [
        ("LINE_OFF", rpc.line_offset),
        ("SAMP_OFF", rpc.sample_offset),
        ("LAT_OFF", rpc.latitude_offset_deg),
        ("LONG_OFF", rpc.longitude_offset_deg),
        ("HEIGHT_OFF", rpc.height_offset_m),
        ("LINE_SCALE", rpc.line_scale),
        ("SAMP_SCALE", rpc.sample_scale),
        ("LAT_SCALE", rpc.latitude_scale_deg),
        ("LONG_SCALE", rpc.longitude_scale_deg),
        ("HEIGHT_SCALE", rpc.height_scale_m),
    ]
}

fn polynomials(rpc: &Rpc) -> [(&'static str, &[f64; 20]); 4] {
    [
        ("LINE_NUM_COEFF", &rpc.line_numerator),
        ("LINE_DEN_COEFF", &rpc.line_denominator),
        ("SAMP_NUM_COEFF", &rpc.sample_numerator),
        ("SAMP_DEN_COEFF", &rpc.sample_denominator),
    ]
}
