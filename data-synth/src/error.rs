//! Errors of making a scene.

use std::path::PathBuf;

/// Reason why a scene could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// A request that cannot be met.
    #[error("cannot make this scene: {0}")]
    BadRequest(String),
    /// A file or folder that cannot be written.
    #[error("cannot write {path}: {source}; check the folder's permissions and the space left on the disk")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// A TIFF that cannot be encoded.
    #[error("cannot write {path} as TIFF: {source}")]
    Tiff {
        /// The file.
        path: PathBuf,
        /// Error of the encoder.
        source: tiff::TiffError,
    },
    /// A file of cameras that cannot be used.
    #[error("{path}: {reason}; expected a JSON object of images, each with rpc, width, height and capTime")]
    Cameras {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// A picture that cannot be encoded or written.
    #[error("cannot write {path}: {source}; check the folder's permissions and the space left on the disk")]
    Image {
        /// The file.
        path: PathBuf,
        /// Error of the encoder.
        source: image::ImageError,
    },
    /// The synthetic sensor's rational camera cannot be fitted.
    #[error("no rational camera fits the sensor of {image}: {source}")]
    Camera {
        /// Name of the image.
        image: String,
        /// Error of the fit.
        source: heliosplat_rpc::RpcError,
    },
}
