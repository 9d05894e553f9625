//! Scenes of the generator: streets, trees and houses, made once per process.

use super::delivery::{Image, Scene, Truth};
use heliosplat::Raster;
use heliosplat_raster::{CrsTransform, GeoRaster, RasterFile};
use heliosplat_rpc::read::gdal_domain;
use heliosplat_synth::{BandSet, SatelliteRequest, Site, write_satellite};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg32;
use serde_json::{Map, Value};
use std::path::Path;
use std::sync::OnceLock;

/// Number of scenes.
const SCENES: usize = 12;
/// Seed of the first.
const FIRST_SEED: u64 = 401;
/// Ground sampling distances, metres. Sites are 48 m wide, so that coarser ones have too few pixels.
const GSD_M: [f64; 4] = [0.6, 0.7, 0.8, 1.0];
/// Sets of bands.
const BANDS: [BandSet; 3] = [BandSet::Pan, BandSet::Rgb, BandSet::RgbNir];
/// Most images of a scene.
const MOST_VIEWS: usize = 5;

/// One scene as made.
struct Made {
    images: Vec<Image>,
    truth: GeoRaster,
    classes: Raster,
    altitude_m: (f64, f64),
    gsd_m: f64,
}

impl Made {
    fn new(number: usize) -> Self {
        let home = tempfile::tempdir().expect("a temporary folder");
        let gsd_m = GSD_M[number % GSD_M.len()];
        let request = SatelliteRequest {
            site: Site::Tiny,
            seed: FIRST_SEED + number as u64,
            gsd_m: Some(gsd_m),
            bands: BANDS[number % BANDS.len()],
            pointing_bias_px: 0.15,
            ..SatelliteRequest::default()
        };
        let summary = write_satellite(&request, home.path(), &|_, _| {}).expect("a scene");
        let names = summary.images.iter().map(|image| image.name.as_str());
        let [low_m, high_m] = summary.altitude_range_m;
        Self {
            images: names.map(|name| image(home.path(), name)).collect(),
            truth: GeoRaster::read(&home.path().join("truth/dsm.tif")).expect("the truth"),
            classes: GeoRaster::read(&home.path().join("truth/classes.tif"))
                .expect("the truth")
                .raster,
            altitude_m: (low_m, high_m),
            gsd_m,
        }
    }
}

fn image(folder: &Path, name: &str) -> Image {
    let path = folder.join(format!("{name}.tif"));
    let file = RasterFile::open(&path).expect("an image");
    let rpc = gdal_domain(&file.domain("RPC")).expect("a camera");
    let text = std::fs::read(path.with_extension("json")).expect("the JSON");
    let mut said: Map<String, Value> = serde_json::from_slice(&text).expect("JSON");
    let date = said.remove("acquisition_date").expect("a date");
    let pixels = file.read_all().expect("pixels");
    Image {
        band_names: file.bands.iter().map(|band| band.description.clone()).collect(),
        ..Image::new(name.to_owned(), pixels, rpc, date.as_str().expect("a text"))
    }
}

/// Some images of one of the scenes.
pub(super) fn scene(rng: &mut Pcg32) -> Scene {
    static MADE: [OnceLock<Made>; SCENES] = [const { OnceLock::new() }; SCENES];
    let number = rng.random_range(0..SCENES);
    let made = MADE[number].get_or_init(|| Made::new(number));
    let mut images = made.images.clone();
    images.shuffle(rng);
    images.truncate(rng.random_range(3..=MOST_VIEWS));
    let GeoRaster {
        raster, transform, crs, ..
    } = &made.truth;
    let crs = crs.as_ref().expect("a coordinate system");
    let (low, high) = made.altitude_m;
    Scene {
        images,
        truth: Truth::Raster {
            heights: raster.clone(),
            transform: *transform,
            from_lon_lat: CrsTransform::from_lon_lat(crs).expect("a coordinate system"),
            classes: made.classes.clone(),
        },
        gsd_m: made.gsd_m,
        altitude_m: made.altitude_m,
        stated_m: Some((low - rng.random_range(5.0..40.0), high + rng.random_range(5.0..40.0))),
        crs: None,
        datum_px: 0.0,
    }
}
