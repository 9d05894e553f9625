//! A batch's mosaic for other programs: the splats of all its tiles in one frame, and its merged surface.
//!
//! Tiles overlap; of each only what stands on its core is taken, the ground that is its alone. Tiles know their colours up to a gain for each
//! band: they get the gains with which the mosaic's albedo was merged.

use super::ExportError;
use super::lit::Lit;
use super::textured::TexturedGround;
use super::tile::MosaicTile;
use crate::dsm::Dsm;
use crate::model::load_file;
use crate::nadir::NadirGrid;
use heliosplat::Raster;
use heliosplat_rpc::LocalFrame;
use heliosplat_rpc::sun::SunPosition;
use std::path::{Path, PathBuf};

/// A mosaic: its merged surface and the runs of its tiles.
pub struct Mosaic {
    folder: PathBuf,
    dsm: Dsm,
    albedo: Raster,
    tiles: Vec<MosaicTile>,
    nadir: NadirGrid,
    frame: LocalFrame,
}

impl Mosaic {
    /// The mosaic in `folder`: its surface, whose altitudes are above the ellipsoid, its albedo on the same grid, and its tiles.
    ///
    /// # Errors
    /// When it has no tile, or its grid lies outside its coordinate system.
    pub fn new(folder: &Path, dsm: Dsm, albedo: Raster, tiles: Vec<MosaicTile>) -> Result<Self, ExportError> {
        if tiles.is_empty() {
            return Err(ExportError::NoSurface(folder.to_owned()));
        }
        let (nadir, frame) = NadirGrid::of_surface(dsm.grid.clone(), dsm.raster.plane(0))?;
        Ok(Self {
            folder: folder.to_owned(),
            dsm,
            albedo,
            tiles,
            nadir,
            frame,
        })
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn frame(&self) -> &LocalFrame {
        &self.frame
    }

    pub(super) fn lit(&self, sun: Option<&SunPosition>) -> Result<Lit, ExportError> {
        Ok(Lit::of_tiles(&self.tiles, (&self.nadir, &self.frame), sun)?)
    }

    pub(super) fn ground(&self) -> Result<TexturedGround, ExportError> {
        let bands = load_file(&self.tiles[0].run)?.bands;
        Ok(TexturedGround::new(&self.dsm, &self.albedo, &bands, &self.nadir.enu))
    }
}
