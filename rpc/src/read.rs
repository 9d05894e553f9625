//! Cameras from what vendors deliver: text and tags in, [`Rpc`] out. No files, no GDAL.
//!
//! Coordinates come out in one convention whatever the file's own: pixel centres at integers, the upper-left one (0, 0).
//! Input is taken to be hostile: nothing here panics, recurses without bound or allocates more than a few times the
//! text it was given, and errors name what is missing.

mod domain;
mod fields;
mod json;

pub use domain::{gdal_domain, geotiff_tag};
pub use json::satnerf_json;

/// What can be wrong with a file that should hold a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// A value that must be there is not.
    #[error("{format}: {field} is missing")]
    Missing {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
    },
    /// A value that is not a number, not finite, or not allowed.
    #[error("{format}: {field} is {value:?}, expected {expected}")]
    BadValue {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
        /// What stands there, shortened.
        value: String,
        /// What should.
        expected: &'static str,
    },
    /// Text that is not of the format at all.
    #[error("{format}: {reason}")]
    Malformed {
        /// The format read.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Text that is no known format.
    #[error(
        "{file}: no camera recognised; known are RPB, _RPC.TXT, DIMAP RPC XML, Maxar XML, GDAL VRT, Sat-NeRF and VisSat \
         JSON, ALOS RPC text and OSSIM .geom"
    )]
    Unrecognised {
        /// The name given to the text.
        file: String,
    },
}
