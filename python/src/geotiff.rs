//! GeoTIFF without GDAL: the pixels of a file, what places them on the Earth, and its RPC tag.
//!
//! Limits: the full resolution of the first image only; bands side by side in each pixel, as cloud-optimised GeoTIFFs have them;
//! coordinate systems by their EPSG code.

use crate::camera::Camera;
use crate::error::of_file;
use heliosplat_rpc::read;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::fs::File;
use std::io::BufReader;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{TiffError, TiffResult};

const MODEL_PIXEL_SCALE: u16 = 33_550;
const MODEL_TIEPOINT: u16 = 33_922;
const MODEL_TRANSFORMATION: u16 = 34_264;
const GEO_KEYS: u16 = 34_735;
const GDAL_METADATA: u16 = 42_112;
const GDAL_NODATA: u16 = 42_113;
const RPC_COEFFICIENTS: u16 = 50_844;

/// Keys of the directory of geographic keys.
const RASTER_TYPE: u64 = 1025;
const GEODETIC_CRS: u64 = 2048;
const PROJECTED_CRS: u64 = 3072;
/// Coordinates of tie points are those of pixels' centres.
const PIXEL_IS_POINT: u64 = 2;
/// Codes from here on say that a system has none.
const USER_DEFINED: u64 = 32_767;

/// Most bytes of pixels that are read at once.
const BYTES_MAX: usize = 1 << 34;

type Image = Decoder<BufReader<File>>;

fn open(path: &str) -> PyResult<Image> {
    let file = File::open(path).map_err(|error| of_file(path, error))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = BYTES_MAX;
    let decoder = Decoder::new(BufReader::new(file)).map_err(|error| of_file(path, error))?;
    Ok(decoder.with_limits(limits))
}

/// The camera in the RPC tag of a GeoTIFF; `None` where it has none.
#[pyfunction]
pub(crate) fn geotiff_rpc(path: &str) -> PyResult<Option<Camera>> {
    let values = numbers(&mut open(path)?, RPC_COEFFICIENTS).map_err(|error| of_file(path, error))?;
    let camera = values.map(|values| read::geotiff_tag(&values).map(|rpc| Camera { rpc }));
    camera.transpose().map_err(|error| of_file(path, error))
}

/// Pixels of a GeoTIFF, `[row, column, band]` in one line, with `shape`, `transform` (as GDAL has it), `epsg`, `nodata` and `metadata`
/// (GDAL's XML), where they are there.
#[pyfunction]
pub(crate) fn read_geotiff<'py>(py: Python<'py>, path: &str) -> PyResult<Bound<'py, PyDict>> {
    let mut image = open(path)?;
    let found = py
        .detach(|| Pixels::read(&mut image))
        .map_err(|error| of_file(path, error))?;
    let out = PyDict::new(py);
    let [rows, cols] = found.size;
    let values = match found.values {
        DecodingResult::U8(v) => v.into_pyarray(py).into_any(),
        DecodingResult::U16(v) => v.into_pyarray(py).into_any(),
        DecodingResult::U32(v) => v.into_pyarray(py).into_any(),
        DecodingResult::I8(v) => v.into_pyarray(py).into_any(),
        DecodingResult::I16(v) => v.into_pyarray(py).into_any(),
        DecodingResult::I32(v) => v.into_pyarray(py).into_any(),
        DecodingResult::F32(v) => v.into_pyarray(py).into_any(),
        DecodingResult::F64(v) => v.into_pyarray(py).into_any(),
        _ => return Err(of_file(path, "its pixels are numbers of a kind that is not read")),
    };
    let total = values.len()?;
    if rows == 0 || cols == 0 || total % (rows * cols) != 0 {
        return Err(of_file(path, Unread::Planes));
    }
    out.set_item("values", values)?;
    out.set_item("shape", (rows, cols, total / (rows * cols)))?;
    out.set_item("transform", found.transform)?;
    out.set_item("epsg", found.epsg)?;
    out.set_item("nodata", found.nodata)?;
    out.set_item("metadata", found.metadata)?;
    Ok(out)
}

/// An image as it was read.
struct Pixels {
    size: [usize; 2],
    values: DecodingResult,
    transform: Option<[f64; 6]>,
    epsg: Option<u64>,
    nodata: Option<String>,
    metadata: Option<String>,
}

/// Why an image is not read.
enum Unread {
    Planes,
    Tiff(TiffError),
}

impl From<TiffError> for Unread {
    fn from(error: TiffError) -> Self {
        Self::Tiff(error)
    }
}

impl std::fmt::Display for Unread {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Planes => f.write_str(
                "its bands lie in planes of their own, which is not read; write it again with gdal_translate -co INTERLEAVE=PIXEL",
            ),
            Self::Tiff(error) => error.fmt(f),
        }
    }
}

impl Pixels {
    fn read(image: &mut Image) -> Result<Self, Unread> {
        let (cols, rows) = image.dimensions()?;
        let planes = image
            .find_tag(Tag::PlanarConfiguration)?
            .map(|v| v.into_u16())
            .transpose()?;
        let samples = image
            .find_tag(Tag::SamplesPerPixel)?
            .map(|v| v.into_u16())
            .transpose()?;
        if planes == Some(2) && samples.is_some_and(|samples| samples > 1) {
            return Err(Unread::Planes);
        }
        let keys = GeoKeys::read(image)?;
        Ok(Self {
            size: [rows as usize, cols as usize],
            transform: transform(image, keys.point)?,
            epsg: keys.epsg,
            nodata: text(image, GDAL_NODATA)?,
            metadata: text(image, GDAL_METADATA)?,
            values: image.read_image()?,
        })
    }
}

/// What the geographic keys say.
#[derive(Default)]
struct GeoKeys {
    epsg: Option<u64>,
    point: bool,
}

impl GeoKeys {
    fn read(image: &mut Image) -> TiffResult<Self> {
        let Some(value) = image.find_tag(Tag::from_u16_exhaustive(GEO_KEYS))? else {
            return Ok(Self::default());
        };
        let entries = value.into_u64_vec()?;
        // Four numbers each, after a header of four: key, place of the value, count, value.
        let of = |key: u64| {
            let entry = entries
                .chunks_exact(4)
                .skip(1)
                .find(|entry| entry[0] == key && entry[1] == 0);
            entry.map(|entry| entry[3])
        };
        let code = |key| of(key).filter(|&code| code > 0 && code < USER_DEFINED);
        Ok(Self {
            epsg: code(PROJECTED_CRS).or_else(|| code(GEODETIC_CRS)),
            point: of(RASTER_TYPE) == Some(PIXEL_IS_POINT),
        })
    }
}

/// From pixel corners to map coordinates, in GDAL's order.
fn transform(image: &mut Image, point: bool) -> TiffResult<Option<[f64; 6]>> {
    let scale = numbers(image, MODEL_PIXEL_SCALE)?;
    let tie = numbers(image, MODEL_TIEPOINT)?;
    let matrix = numbers(image, MODEL_TRANSFORMATION)?;
    let shift = if point { 0.5 } else { 0.0 };
    let found = match (scale.as_deref(), tie.as_deref(), matrix.as_deref()) {
        (Some([sx, sy, ..]), Some([col, row, _, x, y, _, ..]), _) => {
            Some([x - (col + shift) * sx, *sx, 0.0, y + (row + shift) * sy, 0.0, -sy])
        }
        (_, _, Some([a, b, _, x, c, d, _, y, ..])) => Some([x - shift * (a + b), *a, *b, y - shift * (c + d), *c, *d]),
        _ => None,
    };
    Ok(found)
}

fn numbers(image: &mut Image, tag: u16) -> TiffResult<Option<Vec<f64>>> {
    image
        .find_tag(Tag::from_u16_exhaustive(tag))?
        .map(|value| value.into_f64_vec())
        .transpose()
}

fn text(image: &mut Image, tag: u16) -> TiffResult<Option<String>> {
    let value = image.find_tag(Tag::from_u16_exhaustive(tag))?;
    let text = value.map(|value| value.into_string()).transpose()?;
    Ok(text.map(|text| text.trim_end_matches('\0').trim().to_owned()))
}
