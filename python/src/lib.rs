//! Functions of the Python module: arrays in, arrays out, with the interpreter's lock released during computation.
//!
//! The module is private to the Python package beside it (`heliosplat/`), which passes contiguous arrays of one or two
//! dimensions. It does not link GDAL.

mod camera;
mod error;
mod light;

use pyo3::prelude::*;

#[pymodule]
mod _heliosplat {
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::error::Error;
    #[pymodule_export]
    use super::light::{horizons, shadows, sun_hours, sun_positions};
}
