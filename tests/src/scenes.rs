//! Small satellite scenes for tests of faults: textured images over flat ground with simple, exact RPC cameras.

use heliosplat::Raster;
use heliosplat_raster::{Crs, GeoTransform, ImageSpec, SampleType, write_geotiff};
use heliosplat_rpc::{Rpc, write};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Width and height of the images, pixels.
pub const SIZE_PX: usize = 64;
/// Ground sampling distance, metres.
pub const GSD_M: f64 = 0.5;
/// Metres of a degree of latitude in these scenes.
pub const METRES_PER_DEGREE: f64 = 111_320.0;

/// One image to write.
#[derive(Debug, Clone)]
pub struct View {
    /// File name without extension.
    pub name: String,
    /// Displacement of the image east and north per metre of height, metres.
    pub tilt: [f64; 2],
    /// Centre of the image east and north of the scene's centre, metres.
    pub centre_m: [f64; 2],
    /// Number of bands.
    pub bands: usize,
    /// Acquisition time as Sat-NeRF writes it, if any.
    pub date: Option<&'static str>,
    /// Azimuth and elevation of the sun in the JSON, degrees, if any.
    pub sun_deg: Option<[f64; 2]>,
    /// True if the GeoTIFF has an RPC.
    pub has_rpc: bool,
    /// Content of the image.
    pub shows: Shows,
}

/// Content of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// Waves of brightness in columns and rows.
    Waves,
    /// One value in all pixels and bands.
    Nothing,
    /// Waves, and one pixel of the largest value of sixteen bits.
    OneGlint,
    /// Waves in the upper half, zeros below.
    Half,
}

impl View {
    /// A panchromatic view without faults, whose tilt follows from its number.
    pub fn new(number: usize) -> Self {
        let tilts = [[0.0, 0.0], [0.2, 0.05], [-0.1, 0.15], [0.05, -0.2]];
        Self {
            name: format!("view_{number}"),
            tilt: tilts[number % tilts.len()],
            centre_m: [0.0, 0.0],
            bands: 1,
            date: Some("20160423083400"),
            sun_deg: None,
            has_rpc: true,
            shows: Shows::Waves,
        }
    }

    /// The camera: a parallel projection, columns to the east, rows to the south, over 36.91 E 37.58 N at 700 m.
    pub fn rpc(&self) -> Rpc {
        let latitude = 37.58_f64;
        let longitude_per_m = 1.0 / METRES_PER_DEGREE / latitude.to_radians().cos();
        parallel_camera(
            SIZE_PX,
            GSD_M,
            [
                36.91 + self.centre_m[0] * longitude_per_m,
                latitude + self.centre_m[1] / METRES_PER_DEGREE,
            ],
            self.tilt,
        )
    }

    /// Writes the GeoTIFF, and beside it a JSON with altitudes, camera, date and sun if the view has a date or a sun.
    /// Returns the path of the GeoTIFF.
    pub fn write(&self, folder: &Path) -> PathBuf {
        let path = folder.join(format!("{}.tif", self.name));
        let rpc: Vec<(String, String)> = if self.has_rpc {
            write::gdal_domain(&self.rpc()).into_iter().collect()
        } else {
            Vec::new()
        };
        let raster = texture(self.bands, self.shows, self.tilt);
        // Four bands have names, because nothing is made of bands whose names are a guess.
        let names: &[&str] = match self.bands {
            4 => &["red", "green", "blue", "near_infrared"],
            _ => &[],
        };
        let spec = ImageSpec {
            rpc: &rpc,
            band_descriptions: names,
            ..ImageSpec::plain(&raster)
        };
        write_geotiff(&path, &spec, SampleType::U16).expect("the image is written");
        if self.date.is_some() || self.sun_deg.is_some() {
            let text = self.metadata().to_string();
            std::fs::write(path.with_extension("json"), text).expect("the JSON is written");
        }
        path
    }

    fn metadata(&self) -> Value {
        let mut metadata = json!({ "img": format!("{}.tif", self.name), "min_alt": 690, "max_alt": 720 });
        if let Some(date) = self.date {
            metadata["acquisition_date"] = json!(date);
        }
        if let Some([azimuth, elevation]) = self.sun_deg {
            metadata["sun_azimuth"] = json!(azimuth.to_string());
            metadata["sun_elevation"] = json!(format!("{elevation:+}"));
        }
        if self.has_rpc {
            metadata["rpc"] = write::satnerf_json_rpc(&self.rpc());
        }
        metadata
    }
}

/// A camera over a longitude and latitude (degrees) at 700 m: a parallel projection, columns to the east, rows to the
/// south, `size_px` each way, whose image moves by `tilt` metres east and north per metre of height.
pub fn parallel_camera(size_px: usize, gsd_m: f64, [longitude_deg, latitude_deg]: [f64; 2], tilt: [f64; 2]) -> Rpc {
    let half_m = size_px as f64 / 2.0 * gsd_m;
    let height_scale_m = 100.0;
    let latitude_scale_deg = half_m / METRES_PER_DEGREE;
    let numerator = |longitude: f64, latitude: f64, height: f64| {
        let mut coefficients = [0.0; 20];
        coefficients[1..4].copy_from_slice(&[longitude, latitude, height]);
        coefficients
    };
    let mut one = [0.0; 20];
    one[0] = 1.0;
    let per_height = |tilt: f64| tilt * height_scale_m / half_m;
    Rpc {
        line_offset: (size_px as f64 - 1.0) / 2.0,
        sample_offset: (size_px as f64 - 1.0) / 2.0,
        latitude_offset_deg: latitude_deg,
        longitude_offset_deg: longitude_deg,
        height_offset_m: 700.0,
        line_scale: size_px as f64 / 2.0,
        sample_scale: size_px as f64 / 2.0,
        latitude_scale_deg,
        longitude_scale_deg: latitude_scale_deg / latitude_deg.to_radians().cos(),
        height_scale_m,
        line_numerator: numerator(0.0, -1.0, -per_height(tilt[1])),
        line_denominator: one,
        sample_numerator: numerator(1.0, 0.0, per_height(tilt[0])),
        sample_denominator: one,
        error_bias_m: None,
        error_random_m: None,
    }
}

/// Pixels of a view. Brightness and grain depend on its direction: no two cameras have the same picture.
fn texture(bands: usize, shows: Shows, tilt: [f64; 2]) -> Raster {
    let mut raster = Raster::filled(SIZE_PX, SIZE_PX, bands, 500.0);
    if shows == Shows::Nothing {
        return raster;
    }
    let brighter = (100.0 * tilt[0] + 40.0 * tilt[1]).round() as f32;
    let mut rng = Pcg32::seed_from_u64(tilt[0].to_bits() ^ tilt[1].to_bits().rotate_left(32));
    let grain: Vec<f32> = (0..SIZE_PX * SIZE_PX)
        .map(|_| rng.random_range(-100.0..100.0))
        .collect();
    for (index, value) in raster.values.iter_mut().enumerate() {
        let (col, row) = (index % SIZE_PX, index / SIZE_PX % SIZE_PX);
        *value = brighter + 500.0 + 200.0 * ((col as f32 * 0.7).sin() + (row as f32 * 0.4).cos());
        *value += grain[index % grain.len()];
        if shows == Shows::Half && row >= SIZE_PX / 2 {
            *value = 0.0;
        }
    }
    if shows == Shows::OneGlint {
        raster.values[SIZE_PX * 20 + 30] = 65_535.0;
    }
    raster
}

/// Writes the images and JSON files of views into a folder.
pub fn write_scene(folder: &Path, views: &[View]) {
    for view in views {
        view.write(folder);
    }
}

/// Writes a single-band altitude raster in UTM 37N with 0.5 m cells, whose upper left corner is at `west_m` and
/// `north_m`.
pub fn write_altitudes(path: &Path, raster: &Raster, west_m: f64, north_m: f64) {
    let crs = Crs::from_epsg(32637).expect("UTM 37N");
    let transform = GeoTransform::north_up(west_m, north_m, 0.5);
    let spec = ImageSpec {
        georeference: Some((&transform, &crs)),
        ..ImageSpec::plain(raster)
    };
    heliosplat_raster::write_cog(path, &spec).expect("the raster is written");
}
