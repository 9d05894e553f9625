//! Reading of a raster file: its description, and its pixels as `f32` with `NaN` where they are missing.

use super::{
    BandInfo, Colour, Crs, GeoTransform, GridSpec, RasterError, Result, Window, bounded, drivers, masks, messages,
    siblings,
};
use gdal::raster::{ColorInterpretation, GdalDataType};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, Metadata};
use heliosplat::Raster;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest number of samples of one read.
const SAMPLES_MAX: u128 = 1 << 33;
/// Number of samples that are read from a file of any size: an image on an empty canvas has next to no bytes for most
/// of its pixels, and a sparse file none. A gigabyte in memory: 16,384 × 16,384 of one band.
const SAMPLES_FREE: u128 = 1 << 28;
/// Data type of samples that the crate gdal does not support: complex numbers.
const UNKNOWN_TYPE: &str = "unknown";
/// Formats of uncompressed pixels. GDAL reads zeros where such a file ends early.
const RAW: [&str; 3] = ["ENVI", "EHdr", "GTX"];
/// Pixels of a block that are read from a file of any size: 8,192 × 8,192.
const BLOCK_FREE: u128 = 1 << 26;
/// Largest number of samples per byte of a file: deflate expands a byte to at most a thousand.
const SAMPLES_PER_BYTE: u128 = 1000;
/// Samples of all bands that are read before the next rows: blocks that contain all bands stay in GDAL's cache for the
/// next band.
const SAMPLES_AT_ONCE: usize = 1 << 22;

/// True if a file that GDAL did not open is a virtual raster (VRT).
fn names_other_files(path: &Path) -> bool {
    let start = bounded::read_start(path, 256);
    String::from_utf8_lossy(&start).contains("<VRTDataset")
}

/// An open raster file, or several that are one image.
pub struct RasterFile {
    path: PathBuf,
    size: (usize, usize),
    pixels: Pixels,
    /// The other files of its pixels.
    others: Vec<PathBuf>,
    /// The band of opacity, 0-based: pixels of other bands are missing where it is zero.
    opacity: Option<usize>,
    /// Bands in file order.
    pub bands: Vec<BandInfo>,
}

/// Source of the pixels of an image.
enum Pixels {
    /// One file.
    File(Dataset),
    /// Several files.
    Several(Box<dyn Composite>),
}

/// Several files that are one image.
pub(super) trait Composite: Send {
    /// The file whose metadata are those of the image.
    fn first(&self) -> &RasterFile;

    /// The values of the given bands of a window, one band after the other; `NaN` where nothing is known.
    fn read(&self, window: Window, bands: &[usize]) -> Result<Vec<f32>>;

    /// Sets the band of opacity of its files, where they have one.
    fn set_opacity(&mut self, band: Option<usize>);
}

/// True if a path is on one of GDAL's virtual file systems, such as `/vsizip/` and `/vsis3/`.
pub fn is_virtual(path: &Path) -> bool {
    path.to_string_lossy().starts_with("/vsi")
}

/// GDAL's file systems that lie on the network.
pub const REMOTE: [&str; 9] = [
    "/vsicurl",
    "/vsis3",
    "/vsigs",
    "/vsiaz",
    "/vsiadls",
    "/vsioss",
    "/vsiswift",
    "/vsiwebhdfs",
    "/vsihdfs",
];

/// True if a path leads to the network, also from within another virtual file system (`/vsizip//vsicurl/…`).
pub fn is_remote(path: &Path) -> bool {
    let text = path.to_string_lossy();
    is_virtual(path) && (REMOTE.iter().any(|system| text.contains(system)) || text.contains("://"))
}

impl RasterFile {
    /// Opens a file for reading. Files beside it that GDAL may read are checked first.
    ///
    /// # Errors
    /// [`RasterError::Missing`], [`RasterError::Unreadable`], [`RasterError::NotAnImage`] or [`RasterError::Damaged`].
    pub fn open(path: &Path) -> Result<Self> {
        let not_an_image = |reason| RasterError::NotAnImage(path.to_owned(), reason);
        if path.to_str().is_none() {
            let reason = "its name is not UTF-8; rename the file".to_owned();
            return Err(RasterError::Unreadable(path.to_owned(), reason));
        }
        let siblings = if is_virtual(path) { None } else { siblings::check(path)? };
        let siblings = siblings.as_ref();
        let siblings: Option<Vec<&str>> = siblings.map(|names| names.iter().map(String::as_str).collect());
        let open = |drivers: &[&str]| {
            let options = DatasetOptions {
                open_flags: GdalOpenFlags::GDAL_OF_READONLY | GdalOpenFlags::GDAL_OF_RASTER,
                allowed_drivers: Some(drivers),
                sibling_files: siblings.as_deref(),
                ..DatasetOptions::default()
            };
            messages::collect(|| Dataset::open_ex(path, options))
        };
        let hfa = || {
            if !is_virtual(path) {
                siblings::check_pixels(path)?;
            }
            let open = open(&[drivers::HFA]);
            open.map_err(|_| {
                let reason = match names_other_files(path) {
                    true => "a virtual raster names other files; make a GeoTIFF of it with gdal_translate",
                    false => "its format is not recognised",
                };
                not_an_image(reason.to_owned())
            })
        };
        let dataset = open(&drivers::DRIVERS).or_else(|_| hfa())?;
        if dataset.raster_count() == 0 {
            return Err(not_an_image("it has no bands".to_owned()));
        }
        let bands = messages::collect(|| band_infos(&dataset)).map_err(not_an_image)?;
        if bands.iter().any(|band| band.data_type == UNKNOWN_TYPE) {
            let reason = "its pixels are complex numbers, or of a type that is not read; give their amplitude";
            return Err(not_an_image(reason.to_owned()));
        }
        let size = dataset.raster_size();
        let file = Self {
            path: path.to_owned(),
            size,
            pixels: Pixels::File(dataset),
            others: Vec::new(),
            opacity: opacity_of(&bands),
            bands,
        };
        file.check_bytes()?;
        masks::check(path, file.dataset())?;
        Ok(file)
    }

    /// One image of several files, of which `path` is the first.
    pub(super) fn composed(
        path: PathBuf,
        others: Vec<PathBuf>,
        size: (usize, usize),
        bands: Vec<BandInfo>,
        composite: impl Composite + 'static,
    ) -> Self {
        Self {
            path,
            size,
            pixels: Pixels::Several(Box::new(composite)),
            others,
            opacity: opacity_of(&bands),
            bands,
        }
    }

    /// Sets the band of opacity (0-based), or none, in place of the declared one: a fourth band may be declared as
    /// opacity wrongly.
    pub fn set_opacity(&mut self, band: Option<usize>) {
        self.opacity = band;
        if let Pixels::Several(composite) = &mut self.pixels {
            composite.set_opacity(band);
        }
    }

    /// The files of its pixels besides [`RasterFile::path`].
    pub fn others(&self) -> &[PathBuf] {
        &self.others
    }

    /// All files of its pixels.
    pub(super) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        std::iter::once(&self.path).chain(&self.others)
    }

    /// The file of its metadata; the first of several.
    pub(super) fn dataset(&self) -> &Dataset {
        match &self.pixels {
            Pixels::File(dataset) => dataset,
            Pixels::Several(composite) => composite.first().dataset(),
        }
    }

    /// Path of the file; the first of several.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Columns and rows of the image.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Window of the whole image.
    pub fn whole(&self) -> Window {
        Window::whole(self.size)
    }

    /// Items of one metadata domain; the default domain is `""`, an absent domain is empty.
    pub fn domain(&self, name: &str) -> BTreeMap<String, String> {
        items(self.dataset(), name)
    }

    /// A metadata domain of the file itself, without the files beside it.
    pub fn own_domain(&self, name: &str) -> BTreeMap<String, String> {
        let file_name = self.path.file_name().and_then(|name| name.to_str());
        let (false, Some(file_name)) = (is_virtual(&self.path), file_name) else {
            return self.domain(name);
        };
        let options = DatasetOptions {
            open_flags: GdalOpenFlags::GDAL_OF_READONLY | GdalOpenFlags::GDAL_OF_RASTER,
            sibling_files: Some(&[file_name]),
            ..DatasetOptions::default()
        };
        let alone = messages::collect(|| Dataset::open_ex(&self.path, options));
        alone.map_or_else(|_| BTreeMap::new(), |alone| items(&alone, name))
    }

    /// Geotransform of the pixels; `None` without georeferencing. An identity without a coordinate system counts as
    /// none, because some writers store it in images without georeferencing.
    pub fn geo_transform(&self) -> Option<GeoTransform> {
        let six = messages::collect(|| self.dataset().geo_transform()).ok()?;
        let is_identity = six[..5] == [0.0, 1.0, 0.0, 0.0, 0.0] && six[5].abs() == 1.0;
        (!is_identity || self.crs().is_some()).then(|| GeoTransform::from_gdal(six))
    }

    /// The coordinate reference system; `None` without one, or with one that is not recognised.
    pub fn crs(&self) -> Option<Crs> {
        let wkt = self.dataset().projection();
        if wkt.is_empty() {
            return None;
        }
        Crs::from_definition(&wkt).ok()
    }

    /// Reads a window of the given bands (0-based) as `f32`: nodata values, infinities, and pixels that a mask or a
    /// band of opacity declares missing become `NaN`.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read(&self, window: Window, bands: &[usize]) -> Result<Raster> {
        self.check_size(window, bands.len())?;
        let mut raster = Raster::filled(window.width, window.height, bands.len(), f32::NAN);
        let rows = (SAMPLES_AT_ONCE / (window.width * bands.len()).max(1)).max(1);
        for first in (0..window.height).step_by(rows) {
            let (row0, height) = (window.row0 + first, rows.min(window.height - first));
            let values = self.read_part(Window { row0, height, ..window }, bands)?;
            let length = height * window.width;
            for (band, values) in values.chunks_exact(length.max(1)).enumerate() {
                raster.plane_mut(band)[first * window.width..][..length].copy_from_slice(values);
            }
        }
        Ok(raster)
    }

    /// Reads a window of the given bands (0-based) averaged down: each pixel of the result is the mean of the known
    /// ones among `factor` by `factor` pixels of the file, `NaN` where none is. Columns and rows of the window beyond a
    /// multiple of `factor` are left out. Overviews of the file are not used: they may show other pixels, or be in any
    /// file that this one names.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read_reduced(&self, window: Window, factor: usize, bands: &[usize]) -> Result<Raster> {
        let factor = factor.max(1);
        let (width, height) = (window.width / factor, window.height / factor);
        let reduced = Window::new((window.col0, window.row0), (width, height));
        self.check_size(reduced, bands.len())?;
        let mut raster = Raster::filled(width, height, bands.len(), f32::NAN);
        if width == 0 {
            return Ok(raster);
        }
        let columns = width * factor;
        let rows = (SAMPLES_AT_ONCE / (columns * factor * bands.len()).max(1)).max(1);
        for first in (0..height).step_by(rows) {
            let count = rows.min(height - first);
            let start = (window.col0, window.row0 + first * factor);
            let part = Window::new(start, (columns, count * factor));
            let values = self.read_part(part, bands)?;
            for (band, plane) in values.chunks_exact(columns * part.height).enumerate() {
                let out = &mut raster.plane_mut(band)[first * width..][..count * width];
                let rows = out.par_chunks_mut(width).zip(plane.par_chunks(columns * factor));
                rows.for_each(|(out, rows)| average_rows(out, rows, factor));
            }
        }
        Ok(raster)
    }

    /// Refuses a window that would fill the memory, unless the file is long enough to hold its samples.
    fn check_size(&self, window: Window, bands: usize) -> Result<()> {
        let claimed = window.width as u128 * window.height as u128 * bands as u128;
        let beside = ["ige", "dat"].map(|extension| self.path.with_extension(extension));
        let bytes = |path: &PathBuf| std::fs::metadata(path).map_or(0, |known| u128::from(known.len()));
        let held: u128 = self.files().chain(&beside).map(bytes).sum();
        // The size of a file in an archive or an object store is not known.
        let known = !is_virtual(&self.path);
        if claimed > SAMPLES_MAX || (known && claimed > SAMPLES_FREE.max(held * SAMPLES_PER_BYTE)) {
            let reason = format!("it claims {} x {} pixels in {held} bytes", window.width, window.height);
            return Err(damaged(&self.path, reason));
        }
        Ok(())
    }

    /// Reads all bands of the whole image.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read, as [`RasterFile::read`].
    pub fn read_all(&self) -> Result<Raster> {
        let bands: Vec<usize> = (0..self.bands.len()).collect();
        self.read(self.whole(), &bands)
    }

    /// Reads a whole band (0-based) as `f64`, nodata values included: dates as YYYYMMDD have more digits than `f32`
    /// holds.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read_doubles(&self, band: usize) -> Result<Vec<f64>> {
        self.check_size(self.whole(), 1)?;
        let size = self.size();
        let read = || (self.dataset().rasterband(band + 1)?).read_as::<f64>((0, 0), size, size, None);
        let found = messages::collect(read).map_err(|reason| damaged(&self.path, reason))?;
        Ok(found.into_shape_and_vec().1)
    }

    /// Refuses a file with a block that would fill the memory, unless the file is long enough to hold it (pixels are
    /// read by whole blocks), and a truncated raw file.
    fn check_bytes(&self) -> Result<()> {
        let dataset = self.dataset();
        let held = std::fs::metadata(&self.path).map_or(u64::MAX, |known| known.len());
        let mut claimed = 0u128;
        for number in 1..=self.bands.len() {
            let band = dataset.rasterband(number);
            let band = band.map_err(|error| damaged(&self.path, error.to_string()))?;
            let mask = messages::collect(|| masks::of_band(dataset, number - 1, |mask| Ok(mask.block_size())));
            let mask = mask.map_err(|reason| damaged(&self.path, reason))?;
            for (width, height) in std::iter::once(band.block_size()).chain(mask) {
                if width as u128 * height as u128 > BLOCK_FREE.max(u128::from(held) * SAMPLES_PER_BYTE) {
                    let reason = format!("it claims {width} x {height} pixels in one block, and has {held} bytes");
                    return Err(damaged(&self.path, reason));
                }
            }
            // Fewer bits than a byte, where samples are packed.
            let packed = band.metadata_item("NBITS", "IMAGE_STRUCTURE");
            let packed = packed.and_then(|bits| bits.parse().ok());
            let bits = packed.unwrap_or_else(|| band.band_type().bits());
            claimed += u128::from(bits) * self.size.0 as u128 * self.size.1 as u128 / 8;
        }
        let is_packed_whole = || bounded::read_start(&self.path, 2) == [0x1f, 0x8b];
        if RAW.contains(&dataset.driver().short_name().as_str()) && claimed > u128::from(held) && !is_packed_whole() {
            let reason = format!("it claims {claimed} bytes and has {held}");
            return Err(damaged(&self.path, reason));
        }
        Ok(())
    }

    /// The values of the given bands of a window, one band after the other; `NaN` where nothing is known.
    pub(super) fn read_part(&self, window: Window, bands: &[usize]) -> Result<Vec<f32>> {
        match &self.pixels {
            Pixels::File(dataset) => {
                let mut values = Vec::with_capacity(window.width * window.height * bands.len());
                for &band in bands {
                    values.extend(self.read_band(dataset, window, band)?);
                }
                Ok(values)
            }
            Pixels::Several(composite) => composite.read(window, bands),
        }
    }

    fn read_band(&self, dataset: &Dataset, window: Window, band: usize) -> Result<Vec<f32>> {
        let (origin, size) = (
            (window.col0 as isize, window.row0 as isize),
            (window.width, window.height),
        );
        let read = || dataset.rasterband(band + 1)?.read_as::<f32>(origin, size, size, None);
        let read = messages::collect(read).map_err(|reason| damaged(&self.path, reason))?;
        let (_, mut values) = read.into_shape_and_vec();
        let nodata = self.bands[band].nodata.map(|value| value as f32);
        for value in &mut values {
            if !value.is_finite() || nodata == Some(*value) {
                *value = f32::NAN;
            }
        }
        messages::collect(|| masks::blank(dataset, band, self.opacity, window, &mut values))
            .map_err(|reason| damaged(&self.path, format!("its mask: {reason}")))?;
        Ok(values)
    }
}

/// Index of the band that a file declares as opacity.
fn opacity_of(bands: &[BandInfo]) -> Option<usize> {
    bands.iter().position(|band| band.colour == Colour::Alpha)
}

fn items(dataset: &Dataset, domain: &str) -> BTreeMap<String, String> {
    let items = dataset.metadata_domain(domain).unwrap_or_default();
    let pairs = items.iter().filter_map(|item| item.split_once('='));
    pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).collect()
}

/// Means of the known pixels in blocks of `factor` columns and of all of `rows`.
fn average_rows(out: &mut [f32], rows: &[f32], factor: usize) {
    let columns = out.len() * factor;
    for (col, mean) in out.iter_mut().enumerate() {
        let (mut sum, mut count) = (0.0, 0u32);
        for row in rows.chunks_exact(columns) {
            for value in row[col * factor..][..factor].iter().filter(|value| !value.is_nan()) {
                sum += f64::from(*value);
                count += 1;
            }
        }
        *mean = (sum / f64::from(count)) as f32;
    }
}

fn damaged(path: &Path, reason: String) -> RasterError {
    RasterError::Damaged(path.to_owned(), reason)
}

fn band_infos(dataset: &Dataset) -> gdal::errors::Result<Vec<BandInfo>> {
    (1..=dataset.raster_count())
        .map(|index| {
            let band = dataset.rasterband(index)?;
            let data_type = match band.band_type() {
                GdalDataType::Unknown => UNKNOWN_TYPE.to_owned(),
                known => known.name(),
            };
            Ok(BandInfo {
                description: band.description().unwrap_or_default(),
                colour: colour(band.color_interpretation()),
                data_type,
                unit: band.unit(),
                nodata: band.no_data_value(),
                scale: band.scale(),
                offset: band.offset(),
            })
        })
        .collect()
}

fn colour(interpretation: ColorInterpretation) -> Colour {
    match interpretation {
        ColorInterpretation::GrayIndex => Colour::Grey,
        ColorInterpretation::RedBand => Colour::Red,
        ColorInterpretation::GreenBand => Colour::Green,
        ColorInterpretation::BlueBand => Colour::Blue,
        ColorInterpretation::AlphaBand => Colour::Alpha,
        ColorInterpretation::PaletteIndex => Colour::Palette,
        _ => Colour::Undefined,
    }
}

/// A georeferenced raster.
#[derive(Debug, Clone)]
pub struct GeoRaster {
    /// Values; `NaN` where nothing is known.
    pub raster: Raster,
    /// Map coordinates of the pixels.
    pub transform: GeoTransform,
    /// Coordinate system of the map; `None` where the file states none.
    pub crs: Option<Crs>,
    /// Descriptions of the bands, empty where the file has none.
    pub band_names: Vec<String>,
}

impl GeoRaster {
    /// Reads all bands of a georeferenced file. The coordinate system may be absent, the geotransform may not.
    ///
    /// # Errors
    /// [`RasterError::NotGeoreferenced`], and the errors of [`RasterFile::open`] and [`RasterFile::read`].
    pub fn read(path: &Path) -> Result<Self> {
        let file = RasterFile::open(path)?;
        let transform = file.geo_transform();
        Ok(Self {
            transform: transform.ok_or_else(|| RasterError::NotGeoreferenced(path.to_owned()))?,
            raster: file.read_all()?,
            crs: file.crs(),
            band_names: file.bands.iter().map(|band| band.description.clone()).collect(),
        })
    }

    /// Grid of the cells; `None` without a coordinate reference system.
    pub fn grid(&self) -> Option<GridSpec> {
        Some(GridSpec {
            width: self.raster.width,
            height: self.raster.height,
            transform: self.transform,
            crs: self.crs.clone()?,
        })
    }

    /// Index of the band with this description, counted from zero.
    pub fn band(&self, name: &str) -> Option<usize> {
        self.band_names.iter().position(|description| description == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_are_of_full_resolution_and_of_known_pixels_only() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.tif");
        let mut raster = Raster::filled(11, 7, 2, 0.0);
        for (index, value) in raster.values.iter_mut().enumerate() {
            *value = if index % 7 == 3 { f32::NAN } else { (index % 23) as f32 };
        }
        // The first block of three by three of the window has no known pixel.
        for row in 1..4 {
            raster.values[row * 11 + 1..row * 11 + 4].fill(f32::NAN);
        }
        crate::write_cog(&path, &crate::ImageSpec::plain(&raster)).expect("written");
        let window = Window {
            col0: 1,
            row0: 1,
            width: 8,
            height: 6,
        };
        let reduced = RasterFile::open(&path).and_then(|file| file.read_reduced(window, 3, &[1, 0]));
        let reduced = reduced.expect("pixels");
        assert_eq!((reduced.width, reduced.height, reduced.bands), (2, 2, 2));
        for (plane, band) in [1, 0].into_iter().enumerate() {
            for (col, row) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let block = (0..9).map(|i| raster.at(band, 1 + 3 * col + i % 3, 1 + 3 * row + i / 3));
                let known: Vec<f32> = block.filter(|value| value.is_finite()).collect();
                let mean = known.iter().sum::<f32>() / known.len() as f32;
                let found = reduced.at(plane, col, row);
                assert!(
                    (found - mean).abs() < 1e-5 || (found.is_nan() && mean.is_nan()),
                    "{found} {mean}"
                );
            }
        }
        assert!(reduced.at(1, 0, 0).is_nan());
    }

    #[test]
    fn only_paths_that_lead_to_the_network_open_it() {
        for path in [
            "/vsis3/bucket/scene",
            "/vsicurl/http://host/a.tif",
            "/vsizip//vsigs/bucket/a.zip",
        ] {
            assert!(is_remote(Path::new(path)), "{path}");
        }
        for path in [
            "/vsizip/home/scene.zip",
            "/vsitar//data/a.tar",
            "/home/vsis3/a.tif",
            "http://host/a.tif",
        ] {
            assert!(!is_remote(Path::new(path)), "{path}");
        }
    }
}
