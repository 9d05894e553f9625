//! Errors of scene generation.

use std::fmt::Display;
use std::path::Path;

/// Reason why a scene could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// A request that cannot be met, or a file of cameras that cannot be used.
    #[error("cannot make this scene: {0}")]
    BadRequest(String),
    /// A file that cannot be written, or a sensor without a rational camera.
    #[error("{0}")]
    Failed(String),
}

impl SynthError {
    /// Error for an image, named `image`, that no rational camera fits.
    pub(crate) fn camera(image: &str) -> impl Fn(heliosplat_rpc::RpcError) -> Self {
        move |source| Self::Failed(format!("no rational camera fits the sensor of {image}: {source}"))
    }

    /// Error for a file or folder that cannot be written, from its cause.
    pub(crate) fn unwritable<E: Display>(path: &Path) -> impl Fn(E) -> Self {
        let (path, remedy) = (
            path.display(),
            "check the folder's permissions and the space left on the disk",
        );
        move |source| Self::Failed(format!("cannot write {path}: {source}; {remedy}"))
    }
}
