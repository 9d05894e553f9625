//! Missing pixels are missing, and heights are in the units that their file states, in every file that is read.

use gdal::raster::{Buffer, ColorInterpretation, GdalType};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DriverManager, config};
use heliosplat::Raster;
use heliosplat_evaluate::{Protocol, evaluate_dsm};
use heliosplat_raster::geoid::Undulation;
use heliosplat_raster::{
    Crs, GeoRaster, GeoTransform, Geoid, ImageSpec, RasterFile, SampleType, messages, write_geotiff,
};
use heliosplat_tests::program::{fault, json};
use heliosplat_tests::scenes::write_altitudes;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

const SIDE: usize = 24;
/// Columns that are missing.
const MISSING: usize = 8;
/// Error of the predictions, metres.
const ERROR_M: f64 = 0.5;

fn is_missing(index: usize) -> bool {
    index % SIDE < MISSING
}

fn written<T: Copy + GdalType>(dataset: &Dataset, band: usize, values: &[T]) {
    let mut band = dataset.rasterband(band).expect("a band");
    let mut buffer = Buffer::new((SIDE, SIDE), values.to_vec());
    band.write((0, 0), (SIDE, SIDE), &mut buffer).expect("written");
}

/// A GeoTIFF of one type where the rasters of `write_altitudes` lie.
fn create<T: GdalType>(path: &Path, bands: usize) -> Dataset {
    messages::install();
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GeoTIFF");
    let mut dataset = driver
        .create_with_band_type::<T, _>(path, SIDE, SIDE, bands)
        .expect("created");
    dataset
        .set_geo_transform(&[320_000.0, 0.5, 0.0, 4_160_000.0, 0.0, -0.5])
        .expect("placed");
    dataset
        .set_spatial_ref(&SpatialRef::from_epsg(32637).expect("UTM 37N"))
        .expect("a coordinate system");
    dataset
}

/// Writes `values` with a mask over the missing pixels, inside the file or beside it.
fn write_masked(path: &Path, values: &[f32], inside: bool) {
    let dataset = create::<f32>(path, 1);
    written(&dataset, 1, values);
    let word = if inside { "YES" } else { "NO" };
    config::set_thread_local_config_option("GDAL_TIFF_INTERNAL_MASK", word).expect("an option");
    let mut band = dataset.rasterband(1).expect("a band");
    band.create_mask_band(true).expect("a mask");
    let valid = (0..SIDE * SIDE)
        .map(|index| if is_missing(index) { 0 } else { 255 })
        .collect();
    let mut mask = band.open_mask_band().expect("a mask");
    mask.write((0, 0), (SIDE, SIDE), &mut Buffer::<u8>::new((SIDE, SIDE), valid))
        .expect("written");
    config::clear_thread_local_config_option("GDAL_TIFF_INTERNAL_MASK").expect("an option");
}

/// Writes `values` with a band of opacity over the missing pixels.
fn write_with_opacity(path: &Path, values: &[f32]) {
    let dataset = create::<f32>(path, 2);
    let mut opacity = dataset.rasterband(2).expect("a band");
    opacity
        .set_color_interpretation(ColorInterpretation::AlphaBand)
        .expect("opacity");
    written(&dataset, 1, values);
    let valid: Vec<f32> = (0..SIDE * SIDE)
        .map(|index| if is_missing(index) { 0.0 } else { 255.0 })
        .collect();
    written(&dataset, 2, &valid);
}

/// A surface of 700 m, and of 0 m where it is missing.
fn holed() -> Vec<f32> {
    (0..SIDE * SIDE)
        .map(|index| if is_missing(index) { 0.0 } else { 700.0 })
        .collect()
}

/// A prediction that is half a metre too high.
fn write_prediction(path: &Path) {
    write_altitudes(
        path,
        &Raster::filled(SIDE, SIDE, 1, 700.0 + ERROR_M as f32),
        320_000.0,
        4_160_000.0,
    );
}

/// Mean absolute error of a prediction.
fn mae_m(prediction: &Path, truth: &Path, protocol: Protocol) -> f64 {
    let found = evaluate_dsm(prediction, truth, None, protocol).expect("compared");
    found.metrics.all.mae_m
}

#[test]
fn masked_pixels_are_missing_in_images_truth_and_surfaces() {
    let home = tempdir().expect("a temporary folder");
    let at = |name: &str| home.path().join(name);
    write_masked(&at("inside.tif"), &holed(), true);
    write_masked(&at("beside.tif"), &holed(), false);
    write_with_opacity(&at("opacity.tif"), &holed());
    assert!(at("beside.tif.msk").is_file() && !at("inside.tif.msk").exists());
    write_prediction(&at("prediction.tif"));
    for name in ["inside.tif", "beside.tif", "opacity.tif"] {
        let file = RasterFile::open(&at(name)).expect("an image");
        let whole = file.read(file.whole(), &[0]).expect("pixels");
        for (index, value) in whole.values.iter().enumerate() {
            assert_eq!(value.is_nan(), is_missing(index), "{name}: {index}");
        }
        // Averages are of the pixels that are there.
        let averaged = file.read_reduced(file.whole(), 3, &[0]).expect("pixels");
        assert!(averaged.at(0, 0, 0).is_nan() && averaged.at(0, 2, 0) == 700.0, "{name}");
        let error = mae_m(&at("prediction.tif"), &at(name), Protocol::Raw);
        assert!((error - ERROR_M).abs() < 1e-3, "{name}: {error}");
        let error = mae_m(&at(name), &at("prediction.tif"), Protocol::Raw);
        assert!((error - ERROR_M).abs() < 1e-3, "{name}: {error}");
    }
}

#[test]
fn a_mask_that_cannot_be_applied_is_named() {
    let home = tempdir().expect("a temporary folder");
    let (image, mask) = (home.path().join("a.tif"), home.path().join("a.tif.msk"));
    write_prediction(&image);
    fs::write(&mask, "no image").expect("written");
    let refused = || RasterFile::open(&image).err().expect("refused").to_string();
    assert!(refused().contains("a.tif.msk"), "{}", refused());
    write_altitudes(&mask.with_extension("tif"), &Raster::filled(9, 9, 1, 1.0), 0.0, 0.0);
    fs::rename(mask.with_extension("tif"), &mask).expect("renamed");
    assert!(refused().contains("a.tif.msk"), "{}", refused());
}

/// Writes heights as integers of a hundredth of a metre above 600 m.
fn write_scaled(path: &Path) {
    let dataset = create::<i16>(path, 1);
    let mut band = dataset.rasterband(1).expect("a band");
    band.set_scale(0.01).expect("a scale");
    band.set_offset(600.0).expect("an offset");
    band.set_no_data_value(Some(-32_768.0)).expect("a nodata value");
    let counts: Vec<i16> = (0..SIDE * SIDE)
        .map(|index| if is_missing(index) { -32_768 } else { 10_000 })
        .collect();
    written(&dataset, 1, &counts);
}

/// Writes heights of 700 m as multiples of `metres`, in a unit or a coordinate system that says so.
fn write_in(path: &Path, metres: f64, unit: &str, crs: &str) {
    let crs = Crs::from_definition(crs).expect("a coordinate system");
    let transform = GeoTransform::north_up(320_000.0, 4_160_000.0, 0.5);
    let raster = Raster::filled(SIDE, SIDE, 1, (700.0 / metres) as f32);
    let spec = ImageSpec {
        band_units: if unit.is_empty() { &[] } else { &[unit] },
        georeference: Some((&transform, &crs)),
        ..ImageSpec::plain(&raster)
    };
    write_geotiff(path, &spec, SampleType::F32).expect("written");
}

#[test]
fn heights_are_read_in_the_units_that_their_file_states() {
    const FOOT_M: f64 = 0.3048;
    const SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
    let home = tempdir().expect("a temporary folder");
    let at = |name: &str| home.path().join(name);
    write_prediction(&at("prediction.tif"));
    write_scaled(&at("scaled.tif"));
    write_in(&at("feet.tif"), FOOT_M, "ft", "EPSG:32637");
    write_in(&at("survey.tif"), SURVEY_FOOT_M, "US survey foot", "EPSG:32637");
    write_in(&at("centimetres.tif"), 0.01, "cm", "EPSG:32637");
    for name in ["scaled.tif", "feet.tif", "survey.tif", "centimetres.tif"] {
        for (prediction, truth) in [("prediction.tif", name), (name, "prediction.tif")] {
            let error = mae_m(&at(prediction), &at(truth), Protocol::Raw);
            assert!((error - ERROR_M).abs() < 1e-3, "{prediction} {truth}: {error}");
        }
    }
    // Feet of the vertical coordinate system alone; its datum is not the ellipsoid.
    write_in(&at("navd.tif"), SURVEY_FOOT_M, "", "EPSG:32637+6360");
    let heights = GeoRaster::read_heights(&at("navd.tif")).expect("heights").raster;
    assert!(
        heights.values.iter().all(|height| (height - 700.0).abs() < 1e-3),
        "{}",
        heights.values[0]
    );
    let refused = evaluate_dsm(&at("prediction.tif"), &at("navd.tif"), None, Protocol::Raw);
    let refused = refused.expect_err("refused").to_string();
    assert!(refused.contains("not ellipsoidal"), "{refused}");
    write_in(&at("fathoms.tif"), 1.8288, "fathom", "EPSG:32637");
    let refused = evaluate_dsm(&at("prediction.tif"), &at("fathoms.tif"), None, Protocol::Raw);
    let refused = refused.expect_err("refused").to_string();
    assert!(refused.contains("fathom"), "{refused}");
}

#[test]
fn heights_of_a_compound_coordinate_system_are_above_its_geoid() {
    let home = tempdir().expect("a temporary folder");
    let word = |name: &str| home.path().join(name).display().to_string();
    // A site in Sydney.
    let synth = "synth satellite --site tiny --seed 3 --views 3 --bands pan --out";
    json(&synth.split(' ').chain([word("scene").as_str()]).collect::<Vec<_>>());
    let sweep = |out: &str, crs: &str, more: &[&str]| {
        let (scene, out) = (word("scene"), word(out));
        let words = ["dsm", &scene, "--from", "sweep", "--crs", crs, "--out", &out];
        words
            .iter()
            .chain(more)
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    // Feet above NAVD 88 are not converted.
    let refused = fault(&sweep("a.tif", "EPSG:32756+6360", &[]), 2);
    assert!(refused.contains("EPSG:N+5773"), "{refused}");
    if Undulation::new(Geoid::Egm96).is_err() {
        println!("skipped: PROJ has no grid of EGM96 here");
        return;
    }
    json(&sweep("ellipsoid.tif", "EPSG:32756", &[]));
    json(&sweep("geoid.tif", "EPSG:32756+5773", &[]));
    let read = |name: &str| GeoRaster::read(&home.path().join(name)).expect("a surface");
    let (ellipsoid, geoid) = (read("ellipsoid.tif"), read("geoid.tif"));
    let pairs = ellipsoid.raster.plane(0).iter().zip(geoid.raster.plane(0));
    let apart: Vec<f32> = pairs.map(|(a, b)| a - b).filter(|apart| apart.is_finite()).collect();
    // `echo "150.9573 -33.8329 96.568" | gdaltransform -s_srs EPSG:4979 -t_srs EPSG:4326+5773` says 73.713.
    assert!(
        apart.len() > 1000 && apart.iter().all(|apart| (apart - 22.855).abs() < 0.02),
        "{:?}",
        apart.first()
    );
    assert!(geoid.crs.expect("a coordinate system").name().contains("EGM96"));
    let file = RasterFile::open(&home.path().join("geoid.tif")).expect("a surface");
    assert_eq!(file.domain("").get("VERTICAL_DATUM").map(String::as_str), Some("EGM96"));
}
