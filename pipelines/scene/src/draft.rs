//! An image on its way into a scene: its file is open, its metadata are read, its pixels are not.

use super::bands::BandPlan;
use super::calibration::FoundRadiometry;
use super::entry::ImageEntry;
use super::footprint::Footprint;
use super::{SceneError, altitude, satnerf};
use heliosplat_raster::{RasterFile, Window};
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, ImagePoint, ImageWindow, LocalFrame, Rpc};
use nalgebra::Vector3;
use std::path::PathBuf;

/// An image whose file is open and whose metadata are read.
pub(super) struct Draft {
    pub(super) entry: ImageEntry,
    pub(super) file: RasterFile,
    pub(super) plan: BandPlan,
    pub(super) rpc: Rpc,
    pub(super) rpc_source: String,
    pub(super) acquisition: Acquisition,
    /// What metadata say of the values of its bands.
    pub(super) radiometry: Option<FoundRadiometry>,
    /// The multispectral image it is pansharpened with.
    pub(super) multispectral: Option<PathBuf>,
    /// What of the file is read.
    pub(super) window: Window,
}

impl Draft {
    /// The window that is read, as camera fits take it.
    pub(super) fn image_window(&self) -> ImageWindow {
        image_window(&self.window)
    }

    pub(super) fn stated_altitude(&self) -> altitude::Stated {
        altitude::Stated {
            json_m: self.entry.json.as_deref().and_then(satnerf::altitude_range),
            rpc_m: (
                self.rpc.height_offset_m - self.rpc.height_scale_m.abs(),
                self.rpc.height_offset_m + self.rpc.height_scale_m.abs(),
            ),
        }
    }

    pub(super) fn localise(&self, col: f64, row: f64, height_m: f64) -> Result<GeoPoint, SceneError> {
        self.rpc
            .localise(ImagePoint { col, row }, height_m)
            .map_err(|source| self.camera_fault(height_m, source))
    }

    pub(super) fn camera_fault(&self, height_m: f64, source: heliosplat_rpc::RpcError) -> SceneError {
        SceneError::Camera {
            path: self.file.path().to_owned(),
            height_m,
            source,
        }
    }

    /// Outer corners of the image on the ground, in a local frame.
    pub(super) fn footprint(&self, frame: &LocalFrame, height_m: f64) -> Result<Footprint, SceneError> {
        let (width, height) = self.file.size();
        let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)];
        let on_ground = |&(col, row): &(f64, f64)| {
            let enu = frame.enu_from_geo(self.localise(col, row, height_m)?);
            Ok([enu.x, enu.y])
        };
        Ok(Footprint::new(
            corners.iter().map(on_ground).collect::<Result<_, SceneError>>()?,
        ))
    }

    /// Square root of the ground area of the pixel in the middle of what is read, metres.
    pub(super) fn gsd_m(&self, frame: &LocalFrame, height_m: f64) -> Result<f64, SceneError> {
        let Window {
            col0,
            row0,
            width,
            height,
        } = self.window;
        let (col, row) = (
            col0 as f64 + (width as f64 - 1.0) / 2.0,
            row0 as f64 + (height as f64 - 1.0) / 2.0,
        );
        let ground = |col, row| -> Result<Vector3<f64>, SceneError> {
            Ok(frame.enu_from_geo(self.localise(col, row, height_m)?))
        };
        let centre = ground(col, row)?;
        let (along, down) = (ground(col + 1.0, row)? - centre, ground(col, row + 1.0)? - centre);
        Ok((along.x * down.y - along.y * down.x).abs().sqrt())
    }
}

pub(super) fn image_window(window: &Window) -> ImageWindow {
    ImageWindow {
        col0: window.col0 as f64,
        row0: window.row0 as f64,
        width: window.width,
        height: window.height,
    }
}
