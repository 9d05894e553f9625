//! A scene in memory, before and after faults: its images with cameras and dates, and the true heights.

use crate::terrain::Terrain;
use gdal::raster::{Buffer, ColorInterpretation};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, config};
use heliosplat::Raster;
use heliosplat_raster::{Crs, CrsTransform, GeoRaster, GeoTransform, ImageSpec, SampleType, write_geotiff};
use heliosplat_rpc::{Rpc, write};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::{Map, Value, json};
use std::path::Path;

/// How a file declares missing pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Declared {
    /// Zeros, with zero as nodata value.
    Nodata,
    /// Floats that are not a number.
    Nan,
    /// A band of opacity, over noise.
    Alpha,
    /// A `.msk` beside the file, over noise.
    MaskFile,
    /// Planet's mask of usable pixels, over noise.
    Udm2,
    /// Zeros without a nodata value.
    Zeros,
    /// The largest value of the samples, without a nodata value.
    Brightest,
    /// Noise like the image, not declared at all.
    Noise,
}

impl Declared {
    /// All of them but noise.
    pub const USUAL: [Self; 7] = [
        Self::Nodata,
        Self::Nan,
        Self::Alpha,
        Self::MaskFile,
        Self::Udm2,
        Self::Zeros,
        Self::Brightest,
    ];
}

/// One image of a scene.
#[derive(Debug, Clone)]
pub struct Image {
    /// File name without extension.
    pub name: String,
    /// Pixels, counts.
    pub pixels: Raster,
    /// Type of the samples.
    pub sample: SampleType,
    /// Names of the bands, or none.
    pub band_names: Vec<String>,
    /// The camera in the file.
    pub rpc: Rpc,
    /// Items of the JSON beside the file.
    pub items: Map<String, Value>,
    /// Missing pixels, or empty.
    pub missing: Vec<bool>,
    /// How the file declares them.
    pub declared: Declared,
}

impl Image {
    /// An image of 16 bits with a date as Sat-NeRF writes it.
    pub fn new(name: String, pixels: Raster, rpc: Rpc, date: &str) -> Self {
        let mut items = Map::new();
        items.insert("acquisition_date".into(), json!(date));
        Self {
            name,
            pixels,
            sample: SampleType::U16,
            band_names: Vec::new(),
            rpc,
            items,
            missing: Vec::new(),
            declared: Declared::Nodata,
        }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.pixels.plane_len()
    }

    /// True without pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Replaces each pixel by that of `source`, an index of a pixel; the size becomes `width` by `height`.
    pub fn rearrange(&mut self, (width, height): (usize, usize), source: impl Fn(usize, usize) -> usize) {
        let mut out = Raster::filled(width, height, self.pixels.bands, 0.0);
        for band in 0..out.bands {
            let plane = self.pixels.plane(band);
            for (index, value) in out.plane_mut(band).iter_mut().enumerate() {
                *value = plane[source(index % width, index / width)];
            }
        }
        self.pixels = out;
        self.missing.clear();
    }

    /// Writes the image, its masks, and the JSON beside it.
    ///
    /// # Panics
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) {
        let path = folder.join(format!("{}.tif", self.name));
        let mut pixels = self.pixels.clone();
        let (missing, plane) = (&self.missing, pixels.plane_len());
        let brightest = match self.sample {
            SampleType::U8 => 255.0,
            _ => 65_535.0,
        };
        let seed = self
            .name
            .bytes()
            .fold(0u64, |seed, byte| 31 * seed % 1_000_003 + u64::from(byte));
        let mut rng = Pcg32::seed_from_u64(seed);
        for index in (0..missing.len()).filter(|&index| missing[index]) {
            for band in 0..pixels.bands {
                pixels.values[band * plane + index] = match self.declared {
                    Declared::Nodata | Declared::Zeros => 0.0,
                    Declared::Nan => f32::NAN,
                    Declared::Brightest => brightest,
                    // Pixels from elsewhere in the image, in another order in each image.
                    _ => self.pixels.values[band * plane + rng.random_range(0..plane)],
                };
            }
        }
        let with_opacity = !missing.is_empty() && self.declared == Declared::Alpha;
        let usable = |yes: f32| {
            missing
                .iter()
                .map(|gone| if *gone { 0.0 } else { yes })
                .collect::<Vec<f32>>()
        };
        let mut names: Vec<&str> = self.band_names.iter().map(String::as_str).collect();
        if with_opacity {
            pixels.values.extend(usable(brightest));
            pixels.bands += 1;
            if !names.is_empty() {
                names.push("opacity");
            }
        }
        let rpc: Vec<(String, String)> = write::gdal_domain(&self.rpc).into_iter().collect();
        let spec = ImageSpec {
            rpc: &rpc,
            band_descriptions: &names,
            ..ImageSpec::plain(&pixels)
        };
        let sample = match self.declared {
            Declared::Nan if !missing.is_empty() => SampleType::F32,
            _ => self.sample,
        };
        write_geotiff(&path, &spec, sample).expect("the image is written");
        if !missing.is_empty() {
            match self.declared {
                Declared::Alpha => declare(&path, |dataset| {
                    let mut band = dataset.rasterband(dataset.raster_count()).expect("a band");
                    band.set_color_interpretation(ColorInterpretation::AlphaBand)
                        .expect("opacity");
                }),
                Declared::Nodata => declare(&path, |dataset| {
                    for band in 1..=dataset.raster_count() {
                        let mut band = dataset.rasterband(band).expect("a band");
                        band.set_no_data_value(Some(0.0)).expect("a nodata value");
                    }
                }),
                Declared::Nan => declare(&path, |dataset| {
                    let size = (pixels.width, pixels.height);
                    for number in 0..pixels.bands {
                        let mut band = dataset.rasterband(number + 1).expect("a band");
                        band.set_no_data_value(None).expect("no nodata value");
                        let mut values = Buffer::new(size, pixels.plane(number).to_vec());
                        band.write((0, 0), size, &mut values).expect("written");
                    }
                }),
                Declared::MaskFile => {
                    let size = (pixels.width, pixels.height);
                    let bytes: Vec<u8> = usable(255.0).into_iter().map(|value| value as u8).collect();
                    let mut mask = Buffer::new(size, bytes);
                    config::set_thread_local_config_option("GDAL_TIFF_INTERNAL_MASK", "NO").expect("an option");
                    declare(&path, |dataset| {
                        let mut band = dataset.rasterband(1).expect("a band");
                        band.create_mask_band(true).expect("a mask");
                        let mut band = band.open_mask_band().expect("a mask");
                        band.write((0, 0), size, &mut mask).expect("written");
                    });
                    config::clear_thread_local_config_option("GDAL_TIFF_INTERNAL_MASK").expect("an option");
                }
                Declared::Udm2 => {
                    let none = vec![0.0; plane];
                    let mut bands = vec![none; 8];
                    bands[0] = usable(1.0);
                    write_mask(&folder.join(format!("{}_udm2.tif", self.name)), &pixels, &bands);
                }
                _ => {}
            }
        }
        let mut items = self.items.clone();
        items.insert("img".into(), json!(format!("{}.tif", self.name)));
        std::fs::write(path.with_extension("json"), Value::Object(items).to_string()).expect("the JSON is written");
    }
}

fn declare(path: &Path, change: impl FnOnce(&mut Dataset)) {
    let options = DatasetOptions {
        open_flags: GdalOpenFlags::GDAL_OF_UPDATE | GdalOpenFlags::GDAL_OF_RASTER,
        ..DatasetOptions::default()
    };
    change(&mut Dataset::open_ex(path, options).expect("the image"));
}

fn write_mask(path: &Path, like: &Raster, bands: &[Vec<f32>]) {
    let mut mask = Raster::filled(like.width, like.height, bands.len(), 0.0);
    mask.values = bands.concat();
    let written = path.with_extension("written.tif");
    write_geotiff(&written, &ImageSpec::plain(&mask), SampleType::U8).expect("the mask is written");
    std::fs::rename(written, path).expect("renamed");
}

/// Codes of the generator's classes.
const CLASSES: [(usize, &str); 6] = [
    (2, "ground"),
    (5, "vegetation"),
    (6, "building"),
    (9, "water"),
    (11, "road"),
    (64, "car"),
];

/// True heights.
pub enum Truth {
    /// Terrains, each of which was true at some of the dates: few images do not determine the latest one.
    Terrains(Vec<Terrain>),
    /// A raster of heights.
    Raster {
        /// Heights, metres; NaN where unknown.
        heights: Raster,
        /// Map coordinates of its cells.
        transform: GeoTransform,
        /// To its coordinate system.
        from_lon_lat: CrsTransform,
        /// Classes of the cells.
        classes: Raster,
    },
}

impl Truth {
    /// Error of a height at a longitude and latitude, metres: its distance from the interval of the true heights within
    /// some pixels; `None` where no height is known.
    pub fn error_m(&self, [longitude_deg, latitude_deg]: [f64; 2], height_m: f32, reach_px: usize) -> Option<f32> {
        let error = |(low, high): (f32, f32)| height_m - height_m.clamp(low, high);
        match self {
            Self::Terrains(terrains) => terrains
                .iter()
                .map(|terrain| error(terrain.heights_around(longitude_deg, latitude_deg, reach_px)))
                .min_by(|a, b| a.abs().total_cmp(&b.abs())),
            Self::Raster {
                heights,
                transform,
                from_lon_lat,
                ..
            } => {
                let (x, y) = from_lon_lat.apply(longitude_deg, latitude_deg).ok()?;
                let [col, row] = transform.pixel_from_map(x, y).map(|at| at.round() as isize);
                let (mut low, mut high) = (f32::MAX, f32::MIN);
                let reach = reach_px as isize;
                for (col, row) in
                    (row - reach..=row + reach).flat_map(|r| (col - reach..=col + reach).map(move |c| (c, r)))
                {
                    let inside =
                        (0..heights.width as isize).contains(&col) && (0..heights.height as isize).contains(&row);
                    if !inside {
                        return None;
                    }
                    let height = heights.at(0, col as usize, row as usize);
                    (low, high) = (low.min(height), high.max(height));
                }
                (low <= high).then(|| error((low, high)))
            }
        }
    }
}

impl Truth {
    /// Writes a raster of heights in US survey feet, and reads it as `evaluate` does.
    pub fn in_survey_feet(&mut self) {
        let Self::Raster { heights, transform, .. } = self else {
            return;
        };
        let mut feet = heights.clone();
        feet.values.iter_mut().for_each(|height| *height *= 3937.0 / 1200.0);
        let home = tempfile::tempdir().expect("a temporary folder");
        let path = home.path().join("truth.tif");
        let crs = Crs::from_definition("EPSG:32637").expect("a coordinate system");
        let spec = ImageSpec {
            band_units: &["US survey foot"],
            georeference: Some((transform, &crs)),
            ..ImageSpec::plain(&feet)
        };
        write_geotiff(&path, &spec, SampleType::F32).expect("the truth is written");
        *heights = GeoRaster::read_heights(&path).expect("heights").raster;
    }

    /// The ground around a place in words: its class, where there is one, and the largest step of the heights there.
    pub fn describe(&self, longitude_deg: f64, latitude_deg: f64) -> String {
        match self {
            Self::Terrains(terrains) => {
                let (low, high) = terrains[0].heights_around(longitude_deg, latitude_deg, 1);
                format!("true {low:.1} to {high:.1}")
            }
            Self::Raster {
                heights,
                transform,
                from_lon_lat,
                classes,
            } => {
                let (x, y) = from_lon_lat.apply(longitude_deg, latitude_deg).unwrap_or_default();
                let [col, row] = transform.pixel_from_map(x, y).map(|at| at.round() as usize);
                let inside = |reach: usize| {
                    let rows = row.saturating_sub(reach)..(row + reach + 1).min(heights.height);
                    rows.flat_map(move |row| {
                        (col.saturating_sub(reach)..(col + reach + 1).min(heights.width)).map(move |col| (col, row))
                    })
                };
                let range = |reach: usize| {
                    let of = inside(reach).map(|(col, row)| heights.at(0, col, row));
                    of.fold((f32::MAX, f32::MIN), |(low, high), height| {
                        (low.min(height), high.max(height))
                    })
                };
                let ((low, high), (lower, higher)) = (range(1), range(3));
                let mut around: Vec<usize> = inside(1).map(|(col, row)| classes.at(0, col, row) as usize).collect();
                around.sort_unstable();
                around.dedup();
                let names: Vec<&str> = around
                    .iter()
                    .map(|class| {
                        CLASSES
                            .iter()
                            .find(|(code, _)| code == class)
                            .map_or("?", |(_, name)| name)
                    })
                    .collect();
                format!(
                    "true {low:.1} to {high:.1}, {lower:.1} to {higher:.1} within 3, {}",
                    names.join(" and ")
                )
            }
        }
    }
}

/// A scene with known heights.
pub struct Scene {
    /// Its images.
    pub images: Vec<Image>,
    /// True heights.
    pub truth: Truth,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Lowest and highest true height, metres.
    pub altitude_m: (f64, f64),
    /// The range of altitudes that is given to the program, metres; `None`: it finds them by ties.
    pub stated_m: Option<(f64, f64)>,
    /// Coordinate system of the surface; `None`: the local zone, and heights above the ellipsoid.
    pub crs: Option<String>,
    /// Length by which faults may have moved all cameras in common, pixels: no program can see it.
    pub datum_px: f64,
}

impl Scene {
    /// Writes all images into a folder.
    pub fn write(&self, folder: &Path) {
        self.images.iter().for_each(|image| image.write(folder));
    }
}
