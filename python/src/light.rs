//! Positions of the sun; shadows, horizons and hours of sun of a surface of heights.

use crate::error::raised;
use heliosplat_grid::relief::{Relief, Toward};
use heliosplat_rpc::{GeoPoint, sun_position};
use jiff::Timestamp;
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Value in a mask of a cell of unknown height.
const UNKNOWN: u8 = 255;

/// One array for each of two angles.
type Pair<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// Azimuths (clockwise from north) and elevations of the sun, degrees, at times in microseconds since 1970 and at
/// places in degrees and metres above the ellipsoid. Arrays of different lengths raise `Error`.
#[pyfunction]
pub(crate) fn sun_positions<'py>(
    py: Python<'py>,
    time_us: PyReadonlyArray1<'py, i64>,
    lat_deg: PyReadonlyArray1<'py, f64>,
    lon_deg: PyReadonlyArray1<'py, f64>,
    height_m: PyReadonlyArray1<'py, f64>,
) -> PyResult<Pair<'py>> {
    let times = time_us.as_slice()?;
    let (lat, lon, height) = (lat_deg.as_slice()?, lon_deg.as_slice()?, height_m.as_slice()?);
    if [lat, lon, height].iter().any(|array| array.len() != times.len()) {
        return Err(raised("the arrays of times and places have different lengths"));
    }
    let sun = |i: usize| {
        let at = GeoPoint::new(lon[i], lat[i], height[i]);
        Ok::<_, jiff::Error>(sun_position(Timestamp::from_microsecond(times[i])?, at).degrees())
    };
    let found: Result<Vec<[f64; 2]>, _> = py.detach(|| (0..times.len()).into_par_iter().map(sun).collect());
    let (azimuths, elevations): (Vec<f64>, Vec<f64>) = found.map_err(raised)?.into_iter().map(|[a, e]| (a, e)).unzip();
    Ok((azimuths.into_pyarray(py), elevations.into_pyarray(py)))
}

/// Mask of the shadows of a sun on a surface, rows by columns: 1 in shadow, 0 in the sun, 255 where the height is
/// unknown. `cell_m` is the side of a cell, metres; the elevation is between 0 and 90 degrees.
#[pyfunction]
pub(crate) fn shadows<'py>(
    py: Python<'py>,
    height_m: PyReadonlyArray2<'py, f32>,
    cell_m: f64,
    azimuth_deg: f64,
    elevation_deg: f64,
) -> PyResult<Bound<'py, PyArray2<u8>>> {
    let surface = Surface::new(&height_m, cell_m)?;
    check_sun(azimuth_deg, elevation_deg)?;
    let mask = py.detach(|| {
        let relief = surface.relief();
        let shaded = relief.shadows(azimuth_deg, elevation_deg);
        let value = |(cell, &shaded): (usize, &bool)| match relief.is_known(cell) {
            true => u8::from(shaded),
            false => UNKNOWN,
        };
        shaded.iter().enumerate().map(value).collect()
    });
    shaped(py, surface.shape, mask)
}

/// Elevation of the horizon toward an azimuth, degrees, rows by columns, at least `lowest_deg`; NaN where the height is
/// unknown. `lowest_deg` is between 0 and 90.
#[pyfunction]
pub(crate) fn horizons<'py>(
    py: Python<'py>,
    height_m: PyReadonlyArray2<'py, f32>,
    cell_m: f64,
    azimuth_deg: f64,
    lowest_deg: f64,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let surface = Surface::new(&height_m, cell_m)?;
    check_sun(azimuth_deg, lowest_deg)?;
    let found = py.detach(|| {
        let relief = surface.relief();
        let toward = Toward::new(azimuth_deg, lowest_deg);
        let elevation = |cell| match relief.is_known(cell) {
            true => relief.horizon(cell, &toward).atan().to_degrees(),
            false => f32::NAN,
        };
        (0..surface.heights.len()).into_par_iter().map(elevation).collect()
    });
    shaped(py, surface.shape, found)
}

/// Sum of `hours`, the time of each sun, over the suns that reach a cell, rows by columns; NaN where its height is
/// unknown. Suns below `lowest_deg`, between 0 and 90, are left out.
#[pyfunction]
pub(crate) fn sun_hours<'py>(
    py: Python<'py>,
    height_m: PyReadonlyArray2<'py, f32>,
    cell_m: f64,
    azimuths_deg: PyReadonlyArray1<'py, f64>,
    elevations_deg: PyReadonlyArray1<'py, f64>,
    hours: f64,
    lowest_deg: f64,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let surface = Surface::new(&height_m, cell_m)?;
    check_sun(0.0, lowest_deg)?;
    let suns = azimuths_deg.as_slice()?.iter().zip(elevations_deg.as_slice()?);
    let relief = py.detach(|| surface.relief());
    let mut lit = vec![0u32; surface.heights.len()];
    for (&azimuth, &elevation) in suns.filter(|(_, elevation)| **elevation >= lowest_deg) {
        check_sun(azimuth, elevation)?;
        // Between two suns, so that the user can interrupt.
        py.check_signals()?;
        py.detach(|| {
            let shaded = relief.shadows(azimuth, elevation);
            for (count, shaded) in lit.iter_mut().zip(shaded) {
                *count += u32::from(!shaded);
            }
        });
    }
    let value = |(cell, count): (usize, &u32)| match relief.is_known(cell) {
        true => (f64::from(*count) * hours) as f32,
        false => f32::NAN,
    };
    let total = lit.iter().enumerate().map(value).collect();
    shaped(py, surface.shape, total)
}

/// Heights of a surface, metres, row by row.
struct Surface<'a> {
    heights: &'a [f32],
    shape: [usize; 2],
    cell_m: f32,
}

impl<'a> Surface<'a> {
    fn new(height_m: &'a PyReadonlyArray2<f32>, cell_m: f64) -> PyResult<Self> {
        if !(cell_m > 0.0 && cell_m.is_finite()) {
            let text = format!("the side of a cell is {cell_m} m; it must be above zero");
            return Err(raised(text));
        }
        let view = height_m.as_array();
        Ok(Self {
            heights: height_m.as_slice()?,
            shape: [view.nrows(), view.ncols()],
            cell_m: cell_m as f32,
        })
    }

    fn relief(&self) -> Relief {
        let [rows, cols] = self.shape;
        Relief::new((cols, rows), self.cell_m, self.heights.to_vec())
    }
}

fn check_sun(azimuth_deg: f64, elevation_deg: f64) -> PyResult<()> {
    if !(azimuth_deg.is_finite() && elevation_deg > 0.0 && elevation_deg < 90.0) {
        return Err(raised(format!(
            "a sun at azimuth {azimuth_deg}, elevation {elevation_deg} degrees casts no shadow; the elevation must be between 0 and 90"
        )));
    }
    Ok(())
}

fn shaped<T: numpy::Element>(py: Python<'_>, shape: [usize; 2], values: Vec<T>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let array = Array2::from_shape_vec(shape, values).map_err(raised)?;
    Ok(array.into_pyarray(py))
}
