//! An image on its way into a scene: its file is open, its metadata are read, its pixels are not.

use super::bands::{self, BandPlan};
use super::entry::ImageEntry;
use super::footprint::Footprint;
use super::layout::Layout;
use super::tiles::ImageFiles;
use super::{BandKind, IngestOptions, SceneError, acquisition, altitude, camera, pairs, satnerf};
use heliosplat::splat::rasterise::MOST_CHANNELS;
use heliosplat_raster::{RasterFile, Window};
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, ImagePoint, ImageWindow, LocalFrame, Rpc};
use nalgebra::Vector3;
use std::path::PathBuf;

/// Most bands of an image: the rasteriser renders them beside the sun visibility and a normal.
const MOST_BANDS: usize = MOST_CHANNELS - 1 - 3;

/// An image whose file is open and whose metadata are read.
pub(super) struct Draft {
    pub(super) entry: ImageEntry,
    pub(super) file: RasterFile,
    pub(super) plan: BandPlan,
    pub(super) rpc: Rpc,
    pub(super) rpc_source: String,
    pub(super) acquisition: Acquisition,
    /// The multispectral image it is pansharpened with.
    pub(super) multispectral: Option<PathBuf>,
    /// What of the file is read.
    pub(super) window: Window,
}

impl Draft {
    /// The same image, panchromatic until now, pansharpened with its multispectral half.
    pub(super) fn sharpened_with(
        mut self,
        multispectral: &ImageFiles,
        declared: Option<&[BandKind]>,
    ) -> Result<Self, SceneError> {
        let both = pairs::sharpened(self.file, &self.rpc, multispectral, declared)?;
        self.file = both.file;
        self.plan = both.plan;
        self.acquisition = self.acquisition.merge(both.acquisition);
        self.multispectral = Some(multispectral.path.clone());
        Ok(self)
    }

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

/// Opens every image and reads what its files say about it.
pub(super) fn read_all(
    layout: &Layout,
    options: &IngestOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<Draft>, SceneError> {
    let mut drafts = Vec::with_capacity(layout.images.len());
    let declared = layout.bands.as_deref();
    for entry in &layout.images {
        let file = entry.tiles.open()?;
        let found = camera::find(&file, entry, options.rpc, warnings)?;
        let plan = match &entry.multispectral {
            // Its bands will be those of its other half.
            Some(_) => bands::plan(&file, None)?,
            None => bands::plan(&file, declared)?,
        };
        let acquisition = acquisition::find(&file, entry)?;
        let window = file.whole();
        let draft = Draft {
            entry: entry.clone(),
            file,
            plan,
            rpc: found.rpc,
            rpc_source: found.source,
            acquisition,
            multispectral: None,
            window,
        };
        drafts.push(match &entry.multispectral {
            Some(multispectral) => draft.sharpened_with(multispectral, declared)?,
            None => draft,
        });
    }
    let drafts = pairs::by_time(drafts, declared)?;
    warnings.extend(pairs::told(&drafts));
    // The same assumption about every image is one warning.
    if let Some(assumption) = drafts.iter().find_map(|draft| draft.plan.assumption.as_ref()) {
        warnings.push(format!(
            "{}: {assumption}; say otherwise with bands = [...] in a scene.toml",
            layout.images[0].path.display()
        ));
    }
    Ok(drafts)
}

/// Refuses images of different bands, and more bands than a model renders.
pub(super) fn check_bands(drafts: &[Draft]) -> Result<(), SceneError> {
    let Some(first) = drafts.first() else {
        return Ok(());
    };
    let bands = first.plan.kinds.len();
    if bands > MOST_BANDS {
        return Err(SceneError::TooManyBands {
            path: first.file.path().to_owned(),
            bands,
            most: MOST_BANDS,
        });
    }
    match drafts.iter().find(|draft| draft.plan.kinds != first.plan.kinds) {
        None => Ok(()),
        Some(differing) => Err(SceneError::MixedBands {
            path: differing.file.path().to_owned(),
            found: bands::in_words(&differing.plan.kinds),
            other: first.file.path().to_owned(),
            expected: bands::in_words(&first.plan.kinds),
        }),
    }
}
