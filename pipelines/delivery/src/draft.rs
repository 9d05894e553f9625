//! An image on its way into the index: its file is open, its metadata are read.

use super::bands::BandPlan;
use super::calibration::FoundRadiometry;
use super::camera::Cameras;
use super::entry::ImageEntry;
use heliosplat_raster::RasterFile;
use heliosplat_rpc::Rpc;
use heliosplat_rpc::read::acquisition::Acquisition;
use std::path::PathBuf;

/// An image whose file is open and whose metadata are read.
pub(super) struct Draft {
    pub(super) entry: ImageEntry,
    pub(super) file: RasterFile,
    pub(super) plan: BandPlan,
    pub(super) rpc: Rpc,
    /// All cameras that were found; `rpc` is the one in use.
    pub(super) cameras: Cameras,
    /// Columns and rows that the cameras are for.
    pub(super) camera_size: (usize, usize),
    pub(super) acquisition: Acquisition,
    /// Whether its time is that of a TIFF date tag, whose time zone is unknown.
    pub(super) time_of_tag: bool,
    /// Calibration of its bands.
    pub(super) radiometry: Option<FoundRadiometry>,
    /// The multispectral image it is pansharpened with.
    pub(super) multispectral: Option<PathBuf>,
}
