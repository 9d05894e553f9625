//! RPC cameras over arrays.

use crate::error::raised;
use heliosplat_rpc::read::rpc_from_text;
use heliosplat_rpc::write::{rpc_txt, satnerf_json_rpc};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Points that one thread takes at a time: a multiple of the eight that are computed side by side.
const CHUNK: usize = 8192;

/// Numbers of points, one for each.
type Numbers<'py> = PyReadonlyArray1<'py, f64>;

/// One array for each of two coordinates.
type Pair<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// An RPC camera.
#[pyclass(module = "heliosplat", frozen)]
pub(crate) struct Camera {
    rpc: Rpc,
}

#[pymethods]
impl Camera {
    /// Reads the camera from a text of any known format; `name` appears in error messages only.
    #[staticmethod]
    fn from_text(name: &str, text: &str) -> PyResult<Self> {
        let rpc = rpc_from_text(name, text).map_err(|error| raised(format!("{name}: {error}")))?;
        Ok(Self { rpc })
    }

    /// The camera as the JSON object of rpcm and Sat-NeRF.
    fn json(&self) -> String {
        satnerf_json_rpc(&self.rpc).to_string()
    }

    /// The text of an `_RPC.TXT` file.
    fn rpc_txt(&self) -> String {
        rpc_txt(&self.rpc)
    }

    /// Columns and rows, pixels, of ground points given in degrees and metres above the ellipsoid. Arrays of different
    /// lengths raise `Error`.
    fn project<'py>(
        &self,
        py: Python<'py>,
        lon_deg: Numbers,
        lat_deg: Numbers,
        height_m: Numbers,
    ) -> PyResult<Pair<'py>> {
        let (lon, lat, height) = (lon_deg.as_slice()?, lat_deg.as_slice()?, height_m.as_slice()?);
        same_length(&[lon, lat, height])?;
        let (cols, rows) = py.detach(|| {
            in_chunks(lon.len(), |range| {
                let points: Vec<GeoPoint> = range.map(|i| GeoPoint::new(lon[i], lat[i], height[i])).collect();
                let found = project_all(&self.rpc, &points).into_iter();
                found.map(|point| [point.col, point.row]).collect()
            })
        });
        Ok((cols.into_pyarray(py), rows.into_pyarray(py)))
    }

    /// Longitudes and latitudes, degrees, of image points (pixels) at heights (metres above the ellipsoid); NaN where
    /// an image point sees no ground. Arrays of different lengths raise `Error`.
    fn localise<'py>(&self, py: Python<'py>, col: Numbers, row: Numbers, height_m: Numbers) -> PyResult<Pair<'py>> {
        let (col, row, height) = (col.as_slice()?, row.as_slice()?, height_m.as_slice()?);
        same_length(&[col, row, height])?;
        let (lons, lats) = py.detach(|| {
            in_chunks(col.len(), |range| {
                let points: Vec<ImagePoint> = range.clone().map(|i| ImagePoint::new(col[i], row[i])).collect();
                let found = self.rpc.localise_all(&points, &height[range]).into_iter();
                let place = |point: GeoPoint| [point.lon_deg, point.lat_deg];
                found.map(|point| point.map_or([f64::NAN; 2], place)).collect()
            })
        });
        Ok((lons.into_pyarray(py), lats.into_pyarray(py)))
    }
}

heliosplat::vectorised! {
    /// Image positions of `points`; the bits do not depend on the instruction set.
    fn project_all(rpc: &Rpc, points: &[GeoPoint]) -> Vec<ImagePoint> {
        rpc.project_all(points)
    }
}

fn same_length(arrays: &[&[f64]]) -> PyResult<()> {
    match arrays.iter().all(|array| array.len() == arrays[0].len()) {
        true => Ok(()),
        false => Err(raised("the arrays of coordinates have different lengths")),
    }
}

/// Pairs of numbers of `count` points, by threads that each write to a place of their own.
fn in_chunks(count: usize, work: impl Fn(std::ops::Range<usize>) -> Vec<[f64; 2]> + Sync) -> (Vec<f64>, Vec<f64>) {
    let (mut first, mut second) = (vec![0.0; count], vec![0.0; count]);
    let chunks = first.par_chunks_mut(CHUNK);
    let chunks = chunks.zip(second.par_chunks_mut(CHUNK)).enumerate();
    chunks.for_each(|(chunk, (first, second))| {
        let begin = chunk * CHUNK;
        for (place, [a, b]) in work(begin..begin + first.len()).into_iter().enumerate() {
            (first[place], second[place]) = (a, b);
        }
    });
    (first, second)
}
