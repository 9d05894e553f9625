//! A batch's mosaic for other programs: the splats of all its tiles in one frame, and its merged surface.
//!
//! Tiles overlap: each contributes the splats on its core, ground that belongs to no other core. The colours of a tile
//! are known up to a gain for each band; they get the gains with which the mosaic's albedo was merged.

use super::ExportError;
use super::lit::{Lit, Look};
use super::textured::{TexturedGround, white_of};
use super::tile::MosaicTile;
use crate::dsm::Dsm;
use crate::model::load_file;
use crate::nadir::NadirGrid;
use heliosplat::Raster;
use heliosplat_rpc::LocalFrame;
use heliosplat_rpc::sun::SunPosition;
use std::path::{Path, PathBuf};

/// Look of a mosaic's files, which the blocks of one area share.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Reference {
    /// Light and display of the splats.
    pub look: Look,
    /// Albedo that the textured surface shows white.
    pub white: f32,
}

/// A mosaic: its merged surface and the runs of its tiles.
pub struct Mosaic {
    /// Folder of the mosaic.
    pub(super) folder: PathBuf,
    dsm: Dsm,
    albedo: Raster,
    tiles: Vec<MosaicTile>,
    reference: Option<Reference>,
    nadir: NadirGrid,
    /// Local frame of the mosaic.
    pub(super) frame: LocalFrame,
}

impl Mosaic {
    /// Mosaic in `folder`: its surface, with altitudes above the ellipsoid, its albedo on the same grid, its tiles, and
    /// the look of its files, `None` for its own.
    ///
    /// # Errors
    /// When there is no tile, or the grid lies outside its coordinate system.
    pub fn new(
        folder: &Path,
        dsm: Dsm,
        albedo: Raster,
        tiles: Vec<MosaicTile>,
        reference: Option<Reference>,
    ) -> Result<Self, ExportError> {
        if tiles.is_empty() {
            return Err(ExportError::NoSurface(folder.to_owned()));
        }
        let (nadir, frame) = NadirGrid::of_surface(dsm.grid.clone(), dsm.raster.plane(0))?;
        Ok(Self {
            folder: folder.to_owned(),
            dsm,
            albedo,
            tiles,
            reference,
            nadir,
            frame,
        })
    }

    /// Splats of all tiles under `sun`, or under the sun of the first tile's reference image.
    ///
    /// # Errors
    /// When a tile cannot be read, or the sun cannot be used.
    pub(super) fn lit(&self, sun: Option<&SunPosition>) -> Result<Lit, ExportError> {
        let look = match &self.reference {
            Some(reference) => reference.look,
            None => Look::of(&self.tiles, sun)?,
        };
        Ok(Lit::of_tiles(&self.tiles, (&self.nadir, &self.frame), &look)?)
    }

    /// Textured surface of the mosaic.
    ///
    /// # Errors
    /// When the first tile, which names the bands, cannot be read.
    pub(super) fn ground(&self) -> Result<TexturedGround, ExportError> {
        let bands = load_file(&self.tiles[0].run)?.bands;
        let own = || white_of(&self.albedo, &bands);
        let white = self.reference.map_or_else(own, |reference| reference.white);
        let (rasters, look) = ((&self.dsm, &self.albedo), (bands.as_slice(), white));
        Ok(TexturedGround::new(rasters, look, &self.nadir.enu))
    }
}
