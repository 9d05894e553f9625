//! Cameras in the formats of other tools. Every number is written so that it reads back bit for bit (17 significant
//! digits).

use crate::read::{Dialect, SATNERF, customary};
use crate::rpc::Rpc;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

const CUSTOMARY: Dialect = customary("RPC");

/// GeoTIFF tag 50844 (RPCCoefficientTag); unknown errors are written as -1, as the tag defines.
pub fn geotiff_tag(rpc: &Rpc) -> [f64; 92] {
    let mut tag = [0.0; 92];
    tag[0] = rpc.error_bias_m.unwrap_or(-1.0);
    tag[1] = rpc.error_random_m.unwrap_or(-1.0);
    for (slot, (_, value)) in tag[2..12].iter_mut().zip(scalars(rpc, &CUSTOMARY)) {
        *slot = value;
    }
    for (slots, (_, values)) in tag[12..].chunks_exact_mut(20).zip(polynomials(rpc, &CUSTOMARY)) {
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
    for (name, value) in errors(rpc).chain(scalars(rpc, &CUSTOMARY)) {
        line(name, value);
    }
    for (name, values) in polynomials(rpc, &CUSTOMARY) {
        for (index, value) in values.iter().enumerate() {
            line(&format!("{name}_{}", index + 1), *value);
        }
    }
    text
}

/// The `rpc` object of a Sat-NeRF JSON.
pub fn satnerf_json_rpc(rpc: &Rpc) -> Value {
    let scalars = scalars(rpc, &SATNERF).map(|(name, value)| (name, json!(value)));
    let polynomials = polynomials(rpc, &SATNERF).map(|(name, values)| (name, json!(values)));
    scalars.chain(polynomials).collect()
}

/// The items of GDAL's `RPC` metadata domain.
pub fn gdal_domain(rpc: &Rpc) -> BTreeMap<String, String> {
    let numbers = errors(rpc).chain(scalars(rpc, &CUSTOMARY));
    let numbers = numbers.map(|(name, value)| (name, seventeen_digits(value)));
    let polynomials = polynomials(rpc, &CUSTOMARY).map(|(name, values)| {
        let texts: Vec<String> = values.iter().map(|value| seventeen_digits(*value)).collect();
        (name, texts.join(" "))
    });
    let items = numbers.chain(polynomials);
    items.map(|(name, text)| (name.to_owned(), text)).collect()
}

fn seventeen_digits(value: f64) -> String {
    format!("{value:.16e}")
}

fn errors(rpc: &Rpc) -> impl Iterator<Item = (&'static str, f64)> {
    let values = [rpc.error_bias_m, rpc.error_random_m];
    let named = CUSTOMARY.errors.into_iter().zip(values);
    named.filter_map(|(name, value)| Some((name, value?)))
}

fn scalars(rpc: &Rpc, dialect: &Dialect) -> impl Iterator<Item = (&'static str, f64)> {
    let values = [
        rpc.line_offset,
        rpc.sample_offset,
        rpc.latitude_offset_deg,
        rpc.longitude_offset_deg,
        rpc.height_offset_m,
        rpc.line_scale,
        rpc.sample_scale,
        rpc.latitude_scale_deg,
        rpc.longitude_scale_deg,
        rpc.height_scale_m,
    ];
    dialect.scalars.into_iter().zip(values)
}

fn polynomials<'a>(rpc: &'a Rpc, dialect: &Dialect) -> impl Iterator<Item = (&'static str, &'a [f64; 20])> {
    let values = [
        &rpc.line_numerator,
        &rpc.line_denominator,
        &rpc.sample_numerator,
        &rpc.sample_denominator,
    ];
    dialect.polynomials.into_iter().zip(values)
}
