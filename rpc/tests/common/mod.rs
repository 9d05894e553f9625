//! Shared material of the tests, and cameras from golden files.
#![allow(dead_code, unreachable_pub)] // Each test binary uses its own part.

pub mod push_broom;
pub mod texts;

use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The shared folder, or `None` (with a message) where it is absent and not required.
pub fn shared() -> Option<PathBuf> {
    let root = std::env::var_os("HELIOSPLAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
        PathBuf::from,
    );
    if root.join("golden").is_dir() {
        return Some(root);
    }
    assert!(
        std::env::var("HELIOSPLAT_REQUIRE_SHARED").as_deref() != Ok("1"),
        "shared data is required but {} is not there",
        root.display()
    );
    println!("skipped: no shared data");
    None
}

pub fn read_text(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    String::from_utf8_lossy(&bytes).into_owned()
}

pub fn read_json(path: &Path) -> Value {
    serde_json::from_str(&read_text(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Names (without extension) and contents of the golden RPC files that hold an RPC.
pub fn golden_rpcs(shared: &Path) -> Vec<(String, Value)> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(shared.join("golden/rpc"))
        .expect("golden/rpc is readable")
        .map(|entry| entry.expect("entry").path())
        .collect();
    files.sort();
    files
        .iter()
        .map(|path| {
            (
                path.file_stem().expect("stem").to_string_lossy().into_owned(),
                read_json(path),
            )
        })
        .filter(|(_, value)| value.get("rpc").is_some() && value.get("projection").is_some())
        .collect()
}

pub fn golden(shared: &Path, name: &str) -> Value {
    read_json(&shared.join("golden/rpc").join(format!("{name}.json")))
}

/// The camera of a golden file, by its own keys and none of the readers under test.
pub fn golden_camera(golden: &Value) -> Rpc {
    let rpc = &golden["rpc"];
    let number = |key: &str| rpc[key].as_f64().unwrap_or_else(|| panic!("{key}"));
    let list = |key: &str| -> [f64; 20] {
        let values: Vec<f64> = rpc[key]
            .as_array()
            .expect(key)
            .iter()
            .map(|v| v.as_f64().expect("number"))
            .collect();
        values.try_into().expect("20 coefficients")
    };
    Rpc {
        line_offset: number("LINE_OFF"),
        sample_offset: number("SAMP_OFF"),
        latitude_offset_deg: number("LAT_OFF"),
        longitude_offset_deg: number("LONG_OFF"),
        height_offset_m: number("HEIGHT_OFF"),
        line_scale: number("LINE_SCALE"),
        sample_scale: number("SAMP_SCALE"),
        latitude_scale_deg: number("LAT_SCALE"),
        longitude_scale_deg: number("LONG_SCALE"),
        height_scale_m: number("HEIGHT_SCALE"),
        line_numerator: list("LINE_NUM_COEFF"),
        line_denominator: list("LINE_DEN_COEFF"),
        sample_numerator: list("SAMP_NUM_COEFF"),
        sample_denominator: list("SAMP_DEN_COEFF"),
        error_bias_m: None,
        error_random_m: None,
    }
}

pub fn row<const N: usize>(value: &Value) -> [f64; N] {
    std::array::from_fn(|i| value[i].as_f64().expect("number"))
}

/// (ground point, image point) pairs of a golden file's projection table.
pub fn projection_table(golden: &Value) -> Vec<(GeoPoint, ImagePoint)> {
    let ground = golden["projection"]["lon_lat_alt"].as_array().expect("lon_lat_alt");
    let image = golden["projection"]["col_row"].as_array().expect("col_row");
    assert_eq!(ground.len(), image.len());
    let pair = |(g, i): (&Value, &Value)| {
        let [lon_deg, lat_deg, height_m] = row(g);
        let [col, row] = row(i);
        (GeoPoint::new(lon_deg, lat_deg, height_m), ImagePoint { col, row })
    };
    ground.iter().zip(image).map(pair).collect()
}

/// (image point, ground point) pairs of a golden file's localisation table.
pub fn localisation_table(golden: &Value) -> Vec<(ImagePoint, GeoPoint)> {
    let image = golden["localisation"]["col_row_alt"].as_array().expect("col_row_alt");
    let ground = golden["localisation"]["lon_lat"].as_array().expect("lon_lat");
    assert_eq!(ground.len(), image.len());
    let pair = |(i, g): (&Value, &Value)| {
        let [col, row_px, height_m] = row(i);
        let [lon_deg, lat_deg] = row(g);
        (
            ImagePoint { col, row: row_px },
            GeoPoint::new(lon_deg, lat_deg, height_m),
        )
    };
    image.iter().zip(ground).map(pair).collect()
}

pub fn distance_px(a: ImagePoint, b: ImagePoint) -> f64 {
    (a.col - b.col).hypot(a.row - b.row)
}
