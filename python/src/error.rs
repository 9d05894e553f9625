//! The one exception of the package.

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

pyo3::create_exception!(
    heliosplat,
    Error,
    PyValueError,
    "What was given cannot be used; the message says why."
);

/// The exception of the package with a message.
pub(crate) fn raised(message: impl std::fmt::Display) -> PyErr {
    Error::new_err(message.to_string())
}
