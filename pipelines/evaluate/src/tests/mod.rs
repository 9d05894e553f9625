//! Constructed rasters with known shifts and errors.

use super::*;
use heliosplat_raster::{Crs, GeoTransform, ImageSpec, write_cog};

/// Registers a prediction on the truth's grid and subtracts.
fn compare(
    prediction: &Raster,
    truth: &Raster,
    classes: Option<&Raster>,
    protocol: Protocol,
) -> Option<(Raster, Shift)> {
    let moved = |columns: f64, rows: f64| align::moved(prediction, columns, rows);
    register(&moved, truth, classes, protocol)
}

/// A town: blocks of different heights on a slope, which has one best alignment.
fn town(width: usize, height: usize, col0: f64, row0: f64) -> Raster {
    let mut raster = Raster::filled(width, height, 1, 0.0);
    for row in 0..height {
        for col in 0..width {
            let (x, y) = (col as f64 + col0, row as f64 + row0);
            let (block_x, block_y) = ((x / 17.0).floor(), (y / 23.0).floor());
            let street = (x - block_x * 17.0) < 5.0 || (y - block_y * 23.0) < 6.0;
            let seed = (block_x * 12.9898 + block_y * 78.233).sin() * 43758.5453;
            let roof = if street {
                0.0
            } else {
                4.0 + 12.0 * (seed - seed.floor())
            };
            raster.values[row * width + col] = (700.0 + 0.02 * x + 0.05 * y + roof) as f32;
        }
    }
    raster
}

#[test]
fn an_integer_shift_and_a_height_offset_are_found_exactly() {
    let truth = town(300, 260, 100.0, 100.0);
    // The prediction at (col, row) is the truth at (col + 7, row - 4), 2.5 m too high.
    let mut prediction = town(300, 260, 107.0, 96.0);
    prediction.values.iter_mut().for_each(|value| *value += 2.5);
    let (errors, shift) = compare(&prediction, &truth, None, Protocol::Aligned).expect("they overlap");
    assert_eq!((shift.columns, shift.rows), (7.0, -4.0));
    assert!((shift.height_m + 2.5).abs() < 1e-3);
    assert!(errors.values.iter().filter(|e| e.is_finite()).all(|e| e.abs() < 1e-3));
    let (raw, none) = compare(&prediction, &truth, None, Protocol::Raw).expect("they overlap");
    assert_eq!(none, Shift::default());
    assert!(raw.values.iter().any(|e| e.abs() > 5.0));
}

#[test]
fn a_sub_pixel_shift_is_found_by_the_sub_pixel_protocol() {
    // Smooth hills, so that resampling itself makes no error.
    let hills = |col0: f64, row0: f64| {
        let mut raster = Raster::filled(160, 150, 1, 0.0);
        for (index, value) in raster.values.iter_mut().enumerate() {
            let (x, y) = ((index % 160) as f64 + col0, (index / 160) as f64 + row0);
            *value = (10.0 * (x / 9.0).sin() * (y / 11.0).cos() + 5.0 * ((x + y) / 23.0).sin()) as f32;
        }
        raster
    };
    let truth = hills(50.0, 50.0);
    let shift = align::subpixel(&truth, &|columns, rows| {
        align::moved(&hills(51.375, 49.25), columns, rows)
    });
    assert!(
        (shift.columns - 1.375).abs() < 0.05 && (shift.rows + 0.75).abs() < 0.05,
        "{shift:?}"
    );
}

#[test]
fn water_counts_in_raw_and_not_in_aligned() {
    let truth = town(120, 110, 0.0, 0.0);
    let mut prediction = truth.clone();
    let mut classes = Raster::filled(120, 110, 1, 2.0);
    for index in 0..40 * 120 {
        classes.values[index] = WATER;
        prediction.values[index] += 30.0;
    }
    let mae = |protocol| {
        let (errors, shift) = compare(&prediction, &truth, Some(&classes), protocol).expect("they overlap");
        let wanted = wanted_cells(&truth, Some(&classes), protocol);
        DsmMetrics::new(&errors, &wanted, Some(&classes), protocol, [0.0, 0.0, shift.height_m])
    };
    let raw = mae(Protocol::Raw);
    assert!((raw.all.mae_m - 30.0 * 40.0 / 110.0).abs() < 1e-3);
    assert!((raw.by_class["water"].mae_m - 30.0).abs() < 1e-3);
    let aligned = mae(Protocol::Aligned);
    assert!(aligned.all.mae_m < 1e-6 && (aligned.all.completeness - 1.0).abs() < 1e-12);
    assert!(!aligned.by_class.contains_key("water"));
}

#[test]
fn statistics_follow_their_definitions() {
    let errors = [-2.0, -0.5, 0.0, 0.5, 3.0, f32::NAN];
    let got = metrics::statistics(errors.into_iter()).expect("values");
    assert!((got.mae_m - 1.2).abs() < 1e-9);
    assert!((got.rmse_m - ((4.0 + 0.25 + 0.25 + 9.0) / 5.0_f64).sqrt()).abs() < 1e-9);
    assert_eq!(got.median_m, 0.5);
    assert!((got.nmad_m - 1.4826 * 0.5).abs() < 1e-9);
    assert!((got.within_1m - 0.6).abs() < 1e-12 && (got.completeness - 5.0 / 6.0).abs() < 1e-12);
    let even = metrics::statistics([1.0_f32, 2.0, 4.0, 8.0].into_iter()).expect("values");
    assert_eq!(even.median_m, 3.0);
}

#[test]
fn bilinear_resampling_meets_the_edge_and_missing_cells_with_care() {
    let mut raster = Raster::filled(3, 3, 1, 1.0);
    raster.values[4] = f32::NAN;
    assert!(resample::bilinear(&raster, 0.5, 0.5).is_nan());
    assert_eq!(resample::bilinear(&raster, 0.0, 0.5), 1.0);
    assert_eq!(resample::bilinear(&raster, 1e-9, 1.0 - 1e-9), 1.0);
    assert_eq!(resample::bilinear(&raster, -0.5, 2.5), 1.0);
    assert!(resample::bilinear(&raster, -0.51, 0.0).is_nan());
}

fn write(path: &Path, raster: &Raster, transform: &GeoTransform, epsg: u32) {
    let crs = Crs::from_epsg(epsg).expect("a known code");
    let spec = ImageSpec {
        georeference: Some((transform, &crs)),
        ..ImageSpec::plain(raster)
    };
    write_cog(path, &spec).expect("written");
}

#[test]
fn grids_of_another_spacing_and_coordinate_system_are_brought_together() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (truth_path, prediction_path) = (folder.path().join("t.tif"), folder.path().join("p.tif"));
    // One plane in UTM 37N, sampled at 0.5 m and, in UTM 36N, at 0.8 m.
    let plane = |x: f64, y: f64| (0.03 * (x - 312_000.0) - 0.02 * (y - 4_160_000.0)) as f32;
    let truth_at = GeoTransform::north_up(312_000.0, 4_160_060.0, 0.5);
    let mut truth = Raster::filled(120, 120, 1, 0.0);
    for (index, value) in truth.values.iter_mut().enumerate() {
        let [x, y] = truth_at.map_from_pixel((index % 120) as f64, (index / 120) as f64);
        *value = plane(x, y);
    }
    let (home, away) = (Crs::from_epsg(32637).expect("37N"), Crs::from_epsg(32636).expect("36N"));
    let to_home = heliosplat_raster::CrsTransform::new(&away, &home).expect("PROJ");
    let to_away = heliosplat_raster::CrsTransform::new(&home, &away).expect("PROJ");
    let (x, y) = to_away.apply(311_990.0, 4_160_075.0).expect("inside");
    let prediction_at = GeoTransform::north_up(x - 5.0, y + 5.0, 0.8);
    let mut prediction = Raster::filled(140, 140, 1, 0.0);
    for (index, value) in prediction.values.iter_mut().enumerate() {
        let [x, y] = prediction_at.map_from_pixel((index % 140) as f64, (index / 140) as f64);
        let (x, y) = to_home.apply(x, y).expect("inside");
        *value = plane(x, y) + 0.25;
    }
    write(&truth_path, &truth, &truth_at, 32637);
    write(&prediction_path, &prediction, &prediction_at, 32636);
    let outcome = evaluate_dsm(&prediction_path, &truth_path, None, Protocol::Raw).expect("comparable");
    assert_eq!(outcome.metrics.all.completeness, 1.0);
    assert!((outcome.metrics.all.mae_m - 0.25).abs() < 1e-3, "{:?}", outcome.metrics);
    assert!(outcome.metrics.all.nmad_m < 1e-3);
}

#[test]
fn a_prediction_on_a_grid_of_its_own_loses_nothing_to_sub_pixel_registration() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (truth_path, prediction_path) = (folder.path().join("t.tif"), folder.path().join("p.tif"));
    let town = town(150, 140, 0.0, 0.0);
    write(
        &truth_path,
        &town,
        &GeoTransform::north_up(312_000.0, 4_160_000.0, 0.5),
        32637,
    );
    // The same cells, 1.3 m to the east and 0.7 m to the south: 2.6 and 1.4 cells.
    write(
        &prediction_path,
        &town,
        &GeoTransform::north_up(312_001.3, 4_159_999.3, 0.5),
        32637,
    );
    let evaluate = |protocol| {
        evaluate_dsm(&prediction_path, &truth_path, None, protocol)
            .expect("comparable")
            .metrics
    };
    let (aligned, subpixel) = (evaluate(Protocol::Aligned), evaluate(Protocol::Subpixel));
    // The finest step is 1/32 of a cell, 16 mm.
    assert!(
        (subpixel.shift_m[0] + 1.3).abs() < 0.02 && (subpixel.shift_m[1] - 0.7).abs() < 0.02,
        "{subpixel:?}"
    );
    assert!(subpixel.all.mae_m < 0.1 * aligned.all.mae_m, "{subpixel:?} {aligned:?}");
}

#[test]
fn a_dfc_truth_is_placed_by_its_text() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let truth_path = folder.path().join("JAX_001_DSM.tif");
    let town = town(120, 120, 0.0, 0.0);
    heliosplat_raster::write_geotiff(
        &truth_path,
        &ImageSpec::plain(&town),
        heliosplat_raster::SampleType::F32,
    )
    .expect("written");
    std::fs::write(folder.path().join("JAX_001_DSM.txt"), "433000.0\n3358000.0\n120\n0.5\n").expect("written");
    let prediction_path = folder.path().join("p.tif");
    write(
        &prediction_path,
        &town,
        &GeoTransform::north_up(433_000.0, 3_358_060.0, 0.5),
        32617,
    );
    let outcome = evaluate_dsm(&prediction_path, &truth_path, None, Protocol::Raw).expect("comparable");
    assert!(outcome.metrics.all.mae_m < 1e-6 && outcome.metrics.all.completeness == 1.0);
    // The text of the truth has no zone, and means UTM.
    assert!(outcome.warnings.is_empty(), "{:?}", outcome.warnings);
}

#[test]
fn rasters_of_different_places_are_an_error_that_names_both() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (a, b) = (folder.path().join("a.tif"), folder.path().join("b.tif"));
    let town = town(30, 30, 0.0, 0.0);
    write(&a, &town, &GeoTransform::north_up(433_000.0, 3_358_060.0, 0.5), 32617);
    write(&b, &town, &GeoTransform::north_up(533_000.0, 3_358_060.0, 0.5), 32617);
    let error = evaluate_dsm(&a, &b, None, Protocol::Raw).expect_err("no common ground");
    let line = error.to_string();
    assert!(
        line.contains("a.tif") && line.contains("b.tif") && !line.contains('\n'),
        "{line}"
    );
}

#[test]
fn the_json_has_the_keys_of_the_conventions() {
    let truth = town(40, 40, 0.0, 0.0);
    let classes = Raster::filled(40, 40, 1, 6.0);
    let (errors, _) = compare(&truth, &truth, Some(&classes), Protocol::Raw).expect("the same");
    let wanted = wanted_cells(&truth, Some(&classes), Protocol::Raw);
    let metrics = DsmMetrics::new(&errors, &wanted, Some(&classes), Protocol::Raw, [0.0; 3]);
    let json = serde_json::to_value(metrics).expect("serialisable");
    for key in [
        "mae_m",
        "rmse_m",
        "median_m",
        "nmad_m",
        "within_1m",
        "completeness",
        "shift_m",
        "protocol",
    ] {
        assert!(json.get(key).is_some(), "{key}");
    }
    assert_eq!(json["protocol"], "raw");
    assert_eq!(json["by_class"]["building"]["mae_m"], 0.0);
}
