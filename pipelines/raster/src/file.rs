//! Reading: what a raster file is, and its pixels as `f32` with `NaN` where nothing is known.

use super::{Crs, GeoTransform, RasterError, messages};
use gdal::raster::{ColorInterpretation, GdalDataType, ResampleAlg};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, Metadata};
use heliosplat::Raster;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The formats that are read: each is complete in its own file and a header beside it. Formats that name other files or addresses
/// (VRT, WMS, DIMAP, PDF …) are not among them, so that what somebody else wrote opens nothing but itself.
const DRIVERS: [&str; 22] = [
    "GTiff",
    "LIBERTIFF",
    "JP2OpenJPEG",
    "JP2KAK",
    "JP2ECW",
    "JP2MrSID",
    "JP2Lura",
    "NITF",
    "HFA",
    "ENVI",
    "EHdr",
    "PNG",
    "JPEG",
    "WEBP",
    "BMP",
    "PNM",
    "AAIGrid",
    "DTED",
    "SRTMHGT",
    "USGSDEM",
    "PCIDSK",
    "GTX",
];

/// Most samples that are ever read at once.
const SAMPLES_MAX: u128 = 1 << 33;
/// Windows of fewer samples are read from however small a file: an image on an empty canvas has next to no bytes for most of its pixels, and
/// a sparse file none. A gigabyte in memory: 16,384 × 16,384 of one band.
const SAMPLES_FREE: u128 = 1 << 28;
/// Deflate makes at most a thousand bytes of one.
const SAMPLES_PER_BYTE: u128 = 1000;
/// Samples of all bands that are read before the next rows are: blocks of files whose pixels hold all bands together stay in GDAL's cache for
/// the next band.
const SAMPLES_AT_ONCE: usize = 1 << 22;

/// Whether a file that was not opened is one of GDAL's virtual rasters.
fn names_other_files(path: &Path) -> bool {
    let start = crate::bounded::read_start(path, 256);
    String::from_utf8_lossy(&start).contains("<VRTDataset")
}

/// What a band's colour interpretation says it shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Grey, or nothing said.
    Grey,
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Opacity.
    Alpha,
    /// Indices into a colour table.
    Palette,
    /// Nothing said.
    Undefined,
}

/// One band of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct BandInfo {
    /// Its description, empty where the file has none.
    pub description: String,
    /// Its colour interpretation.
    pub colour: Colour,
    /// GDAL's name of the data type, such as `UInt16`.
    pub data_type: String,
    /// The unit of its values, empty where the file says none.
    pub unit: String,
    /// The value that means "nothing here".
    pub nodata: Option<f64>,
    /// What a count is multiplied with to get to the unit, where the file says so.
    pub scale: Option<f64>,
    /// What is added then, where the file says so.
    pub offset: Option<f64>,
}

/// A pixel window: first column and row, columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub col0: usize,
    /// First row.
    pub row0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// An open raster file.
pub struct RasterFile {
    path: PathBuf,
    /// What GDAL opens to read its pixels: the path, or the description of a virtual raster of ours.
    source: String,
    /// Its pixels.
    dataset: Dataset,
    /// What its metadata are read from, where the pixels come from several files.
    described_by: Option<Dataset>,
    /// The other files that its pixels come from.
    others: Vec<PathBuf>,
    /// Its bands, in file order.
    pub bands: Vec<BandInfo>,
}

/// Whether a path is on one of GDAL's virtual file systems, such as `/vsizip/` and `/vsis3/`.
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

/// Whether a path leads to the network, also from within another virtual file system (`/vsizip//vsicurl/…`).
pub fn is_remote(path: &Path) -> bool {
    let text = path.to_string_lossy();
    is_virtual(path) && (REMOTE.iter().any(|system| text.contains(system)) || text.contains("://"))
}

/// Files in a folder of a virtual file system that the user names, sorted; where it is remote, such file systems may reach the network
/// from here on.
///
/// # Errors
/// [`RasterError::Missing`] when there is no such folder, or it cannot be reached.
pub fn list_virtual(folder: &Path) -> Result<Vec<PathBuf>, RasterError> {
    if is_remote(folder) {
        messages::allow_network();
    }
    let names = messages::collect(|| gdal::vsi::read_dir(folder, false));
    let mut names = names.map_err(|_| RasterError::Missing(folder.to_owned()))?;
    names.sort();
    Ok(names.into_iter().map(|name| folder.join(name)).collect())
}

impl RasterFile {
    /// Opens a file for reading.
    ///
    /// # Errors
    /// [`RasterError::Missing`] or [`RasterError::NotAnImage`].
    pub fn open(path: &Path) -> Result<Self, RasterError> {
        if !is_virtual(path) && !path.exists() {
            return Err(RasterError::Missing(path.to_owned()));
        }
        let not_an_image = |reason| RasterError::NotAnImage {
            path: path.to_owned(),
            reason,
        };
        // Opening a pipe would wait for ever.
        if !is_virtual(path) && !path.is_file() {
            return Err(not_an_image("it is a folder, a device or a pipe".to_owned()));
        }
        let dataset = messages::collect(|| {
            Dataset::open_ex(
                path,
                DatasetOptions {
                    open_flags: GdalOpenFlags::GDAL_OF_READONLY | GdalOpenFlags::GDAL_OF_RASTER,
                    allowed_drivers: Some(&DRIVERS),
                    ..DatasetOptions::default()
                },
            )
        })
        .map_err(|_| {
            let reason = if names_other_files(path) {
                "a virtual raster names other files; make a GeoTIFF of it with gdal_translate"
            } else {
                "its format is not recognised"
            };
            not_an_image(reason.to_owned())
        })?;
        if dataset.raster_count() == 0 {
            return Err(not_an_image("it has no bands".to_owned()));
        }
        let bands = messages::collect(|| band_infos(&dataset)).map_err(not_an_image)?;
        Ok(Self {
            path: path.to_owned(),
            source: path.to_string_lossy().into_owned(),
            dataset,
            described_by: None,
            others: Vec::new(),
            bands,
        })
    }

    /// An image made of several files: pixels and bands of the virtual raster that `description` says, path and metadata of `first`.
    pub(super) fn composed(first: Self, description: String, others: &[Self]) -> Result<Self, String> {
        let dataset = messages::collect(|| open_virtual(&description))?;
        let bands = messages::collect(|| band_infos(&dataset))?;
        let mut paths = first.others;
        for other in others {
            paths.push(other.path.clone());
            paths.extend_from_slice(&other.others);
        }
        Ok(Self {
            path: first.path,
            source: description,
            dataset,
            others: paths,
            described_by: Some(first.described_by.unwrap_or(first.dataset)),
            bands,
        })
    }

    pub(super) fn source(&self) -> &str {
        &self.source
    }

    /// The files beside [`RasterFile::path`] that its pixels come from.
    pub fn others(&self) -> &[PathBuf] {
        &self.others
    }

    fn metadata(&self) -> &Dataset {
        self.described_by.as_ref().unwrap_or(&self.dataset)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn dataset(&self) -> &Dataset {
        &self.dataset
    }

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        self.dataset.raster_size()
    }

    /// The whole image.
    pub fn whole(&self) -> Window {
        let (width, height) = self.size();
        Window {
            col0: 0,
            row0: 0,
            width,
            height,
        }
    }

    /// Items of one metadata domain; the default domain is `""`, an absent domain is empty.
    pub fn domain(&self, name: &str) -> BTreeMap<String, String> {
        let items = self.metadata().metadata_domain(name).unwrap_or_default();
        items
            .iter()
            .filter_map(|item| item.split_once('='))
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .collect()
    }

    /// Where the pixels lie in map coordinates; `None` without georeferencing. Some writers store the identity where they know nothing:
    /// without a coordinate system it is no georeferencing either.
    pub fn geo_transform(&self) -> Option<GeoTransform> {
        let six = messages::collect(|| self.metadata().geo_transform()).ok()?;
        let is_identity = six[..5] == [0.0, 1.0, 0.0, 0.0, 0.0] && six[5].abs() == 1.0;
        (!is_identity || self.crs().is_some()).then(|| GeoTransform::from_gdal(six))
    }

    /// The coordinate reference system; `None` without one.
    pub fn crs(&self) -> Option<Crs> {
        let wkt = self.metadata().projection();
        if wkt.is_empty() {
            return None;
        }
        Crs::from_definition(&wkt).ok()
    }

    /// Reads a window of the given bands (0-based) as `f32`: nodata values and infinities become `NaN`.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read(&self, window: Window, bands: &[usize]) -> Result<Raster, RasterError> {
        self.check_size(window, bands.len())?;
        let mut raster = Raster::filled(window.width, window.height, bands.len(), f32::NAN);
        let plane = raster.plane_len();
        let rows = (SAMPLES_AT_ONCE / (window.width * bands.len()).max(1)).max(1);
        for first in (0..window.height).step_by(rows) {
            let part = Window {
                row0: window.row0 + first,
                height: rows.min(window.height - first),
                ..window
            };
            for (index, &band) in bands.iter().enumerate() {
                let values = self.read_band(part, 1, band)?;
                let start = index * plane + first * window.width;
                raster.values[start..start + values.len()].copy_from_slice(&values);
            }
        }
        Ok(raster)
    }

    /// Reads a window of the given bands (0-based) averaged down: each pixel of the result is the mean of `factor` by `factor` pixels of the
    /// file, from an overview where the file has one. Columns and rows of the window beyond a multiple of `factor` are left out.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read_reduced(&self, window: Window, factor: usize, bands: &[usize]) -> Result<Raster, RasterError> {
        let factor = factor.max(1);
        let (width, height) = (window.width / factor, window.height / factor);
        let reduced = Window {
            width,
            height,
            ..window
        };
        self.check_size(reduced, bands.len())?;
        let mut values = Vec::with_capacity(width * height * bands.len());
        for &band in bands {
            values.extend(self.read_band(window, factor, band)?);
        }
        Ok(Raster {
            width,
            height,
            bands: bands.len(),
            values,
        })
    }

    /// Refuses to decode so many samples of a window that they would only fill the memory, unless the file is long enough to hold them.
    fn check_size(&self, window: Window, bands: usize) -> Result<(), RasterError> {
        let claimed = window.width as u128 * window.height as u128 * bands as u128;
        let mut siblings = ["ige", "dat"]
            .map(|extension| self.path.with_extension(extension))
            .to_vec();
        siblings.extend_from_slice(&self.others);
        let bytes = |path: &Path| std::fs::metadata(path).map_or(0, |known| u128::from(known.len()));
        let held = bytes(&self.path) + siblings.iter().map(|path| bytes(path)).sum::<u128>();
        // How many bytes an archive or an object store holds of it is not known.
        let known = !is_virtual(&self.path);
        if claimed > SAMPLES_MAX || (known && claimed > SAMPLES_FREE.max(held * SAMPLES_PER_BYTE)) {
            return Err(RasterError::Damaged {
                path: self.path.clone(),
                reason: format!("it claims {} x {} pixels in {held} bytes", window.width, window.height),
            });
        }
        Ok(())
    }

    /// Reads all bands of the whole image.
    ///
    /// # Errors
    /// As [`RasterFile::read`].
    pub fn read_all(&self) -> Result<Raster, RasterError> {
        let bands: Vec<usize> = (0..self.bands.len()).collect();
        self.read(self.whole(), &bands)
    }

    /// Reads a whole band (0-based) as the file has it: dates as YYYYMMDD have more digits than `f32` holds.
    ///
    /// # Errors
    /// [`RasterError::Damaged`] when the pixels cannot be read.
    pub fn read_doubles(&self, band: usize) -> Result<Vec<f64>, RasterError> {
        let (whole, size) = (self.whole(), self.size());
        self.check_size(whole, 1)?;
        let read = || {
            self.dataset
                .rasterband(band + 1)?
                .read_as::<f64>((0, 0), size, size, None)
        };
        let found = messages::collect(read).map_err(|reason| RasterError::Damaged {
            path: self.path.clone(),
            reason,
        })?;
        Ok(found.into_shape_and_vec().1)
    }

    /// The values of a window, `factor` pixels each way averaged into one.
    fn read_band(&self, window: Window, factor: usize, band: usize) -> Result<Vec<f32>, RasterError> {
        let size = (window.width / factor, window.height / factor);
        let from = (size.0 * factor, size.1 * factor);
        let (_, mut values) = messages::collect(|| {
            let origin = (window.col0 as isize, window.row0 as isize);
            let average = (factor > 1).then_some(ResampleAlg::Average);
            self.dataset
                .rasterband(band + 1)?
                .read_as::<f32>(origin, from, size, average)
        })
        .map_err(|reason| RasterError::Damaged {
            path: self.path.clone(),
            reason,
        })?
        .into_shape_and_vec();
        let nodata = self.bands[band].nodata.map(|value| value as f32);
        for value in &mut values {
            if !value.is_finite() || nodata == Some(*value) {
                *value = f32::NAN;
            }
        }
        Ok(values)
    }
}

/// Opens a virtual raster that this crate described, in XML; it must name only files that were opened before.
fn open_virtual(description: &str) -> gdal::errors::Result<Dataset> {
    Dataset::open_ex(
        description,
        DatasetOptions {
            open_flags: GdalOpenFlags::GDAL_OF_READONLY | GdalOpenFlags::GDAL_OF_RASTER,
            allowed_drivers: Some(&["VRT"]),
            ..DatasetOptions::default()
        },
    )
}

fn band_infos(dataset: &Dataset) -> gdal::errors::Result<Vec<BandInfo>> {
    (1..=dataset.raster_count())
        .map(|index| {
            let band = dataset.rasterband(index)?;
            let data_type = match band.band_type() {
                GdalDataType::Unknown => "unknown".to_owned(),
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

/// A raster that lies on the map.
#[derive(Debug, Clone)]
pub struct GeoRaster {
    /// Values; `NaN` where nothing is known.
    pub raster: Raster,
    /// Where the pixels lie.
    pub transform: GeoTransform,
    /// In which coordinates; `None` where the file does not say.
    pub crs: Option<Crs>,
    /// Descriptions of the bands, empty where the file has none.
    pub band_names: Vec<String>,
}

impl GeoRaster {
    /// Reads all bands of a georeferenced file. The coordinate system may be absent, the geotransform may not.
    ///
    /// # Errors
    /// [`RasterError::NotGeoreferenced`] and what opening and reading may give.
    pub fn read(path: &Path) -> Result<Self, RasterError> {
        let file = RasterFile::open(path)?;
        let transform = file
            .geo_transform()
            .ok_or_else(|| RasterError::NotGeoreferenced(path.to_owned()))?;
        Ok(Self {
            raster: file.read_all()?,
            transform,
            crs: file.crs(),
            band_names: file.bands.iter().map(|band| band.description.clone()).collect(),
        })
    }

    /// Number of the band of this description, counted from zero.
    pub fn band(&self, name: &str) -> Option<usize> {
        self.band_names.iter().position(|description| description == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
