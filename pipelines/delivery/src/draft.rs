//! An image on its way into the index: its file is open, its metadata are read.

use super::bands::BandPlan;
use super::calibration::FoundRadiometry;
use super::camera::Cameras;
use super::entry::ImageEntry;
use heliosplat_raster::RasterFile;
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
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
    /// True if its time is that of a TIFF date tag, whose time zone is unknown.
    pub(super) time_of_tag: bool,
    /// Calibration of its bands.
    pub(super) radiometry: Option<FoundRadiometry>,
    /// The multispectral image it is pansharpened with.
    pub(super) multispectral: Option<PathBuf>,
}

impl Draft {
    /// The ground at the middle of the image, at the height offset of its RPC.
    pub(super) fn middle(&self) -> Option<GeoPoint> {
        let (width, height) = self.file.size();
        let (col, row) = (width as f64 / 2.0, height as f64 / 2.0);
        let at = ImagePoint { col, row };
        self.rpc.localise(at, self.rpc.height_offset_m).ok()
    }
}
