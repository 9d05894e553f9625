//! A draft: an image whose file is open and whose metadata are read, before it enters the index.

use super::bands::BandPlan;
use super::calibration::FoundRadiometry;
use super::camera::Cameras;
use super::entry::ImageEntry;
use heliosplat_raster::RasterFile;
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use std::path::PathBuf;

/// An image with its open file and its metadata.
pub(super) struct Draft {
    /// The image's entry in the layout of the scene.
    pub(super) entry: ImageEntry,
    /// The open file.
    pub(super) file: RasterFile,
    /// Bands to read, with their kinds.
    pub(super) plan: BandPlan,
    /// The camera in use, in pixels of the file.
    pub(super) rpc: Rpc,
    /// All cameras of the image; `rpc` is the one in use.
    pub(super) cameras: Cameras,
    /// Size of the image that the cameras describe, columns and rows.
    pub(super) camera_size: (usize, usize),
    /// Acquisition time, and sun angles from the metadata.
    pub(super) acquisition: Acquisition,
    /// True if the time is from a TIFF date tag, whose time zone is unknown.
    pub(super) time_of_tag: bool,
    /// Calibration of the bands, where the metadata contain it.
    pub(super) radiometry: Option<FoundRadiometry>,
    /// The multispectral file that the image is pansharpened with.
    pub(super) multispectral: Option<PathBuf>,
}

impl Draft {
    /// Ground point of the image's centre, at the height offset of its RPC; `None` where the camera cannot be
    /// localised.
    pub(super) fn middle(&self) -> Option<GeoPoint> {
        let (width, height) = self.file.size();
        let (col, row) = (width as f64 / 2.0, height as f64 / 2.0);
        let at = ImagePoint { col, row };
        self.rpc.localise(at, self.rpc.height_offset_m).ok()
    }
}
