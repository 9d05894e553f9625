//! Raster files: the only crate that links GDAL and PROJ.
//!
//! Everything else sees [`Raster`](heliosplat::Raster) values, a [`GeoTransform`] and a [`Crs`]. Two conventions are
//! converted here and nowhere else: missing values become `NaN`, and GDAL's pixel corners become pixel centres at
//! integers. The items of GDAL's `RPC` metadata domain already count from pixel centres, as RPC00B does.

mod band;
pub mod bounded;
pub mod crs;
mod drivers;
pub mod dsm_bands;
pub mod file;
pub mod geoid;
pub mod grid;
mod heights;
mod masks;
pub mod messages;
pub mod pansharpen;
pub mod preview;
pub mod sha256;
mod siblings;
mod stacked;
pub mod streamed;
pub mod temporary;
pub mod tiled;
pub mod virtual_files;
pub mod virtual_raster;
pub mod write;

pub use band::{BandInfo, Colour, Window};
pub use crs::{Crs, CrsTransform};
pub use file::{GeoRaster, RasterFile, is_remote, is_virtual};
pub use geoid::Geoid;
pub use grid::{EnuGrid, GeoTransform, GridSpec};
pub use pansharpen::GridRelation;
pub use streamed::StreamedCog;
pub use tiled::Tile;
pub use virtual_files::list_virtual;
pub use write::{
    Bytes, ImageSpec, SampleType, copy_with_rpc, write_atomically, write_byte_cog, write_cog, write_geotiff,
};

use std::path::{Path, PathBuf};

/// Result of work on rasters.
pub type Result<T, E = RasterError> = std::result::Result<T, E>;

/// Errors of raster files. Every message names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// No such file.
    #[error("{}: no such file", .0.display())]
    Missing(PathBuf),
    /// A file, or one beside it that GDAL would read with it, that cannot be read. Fields: the file, reason.
    #[error("{}: cannot be read ({})", .0.display(), .1)]
    Unreadable(PathBuf, String),
    /// A file that GDAL does not recognise as an image. Fields: the file, message of GDAL.
    #[error("{}: not an image GDAL can read ({}); give a GeoTIFF, JPEG 2000, NITF or another raster format", .0.display(), .1)]
    NotAnImage(PathBuf, String),
    /// A recognised image whose pixels cannot be read. Fields: the file, message of GDAL.
    #[error("{}: its pixels cannot be read ({}); the file is truncated or damaged, fetch it again", .0.display(), .1)]
    Damaged(PathBuf, String),
    /// Heights in a unit that is no known length. Fields: the file, the unit.
    #[error("{}: its heights are in '{}', which is no known length; convert it to metres, or set the unit of its band", .0.display(), .1)]
    HeightUnit(PathBuf, String),
    /// A raster without the georeferencing that it needs.
    #[error("{}: it has no georeferencing; it needs a geotransform and a coordinate system", .0.display())]
    NotGeoreferenced(PathBuf),
    /// A coordinate reference system that PROJ does not recognise, or that is not supported here.
    /// Fields: definition or name of the system, message of PROJ.
    #[error("coordinate reference system '{0}' is not usable ({1}); give a projected one as EPSG:N")]
    UnknownCrs(String, String),
    /// PROJ's database of coordinate systems is missing or unusable.
    #[error(
        "PROJ's database cannot be used ({0}); install proj-data, and unset PROJ_LIB and PROJ_DATA where another program set them"
    )]
    ProjDatabase(String),
    /// A coordinate that cannot be transformed. Fields: name of the target system, message of PROJ.
    #[error("a coordinate cannot be transformed to {0} ({1}); choose a coordinate system that covers the scene")]
    Transform(String, String),
    /// A geoid without an installed grid.
    #[error(
        "geoid {name}: PROJ finds none of its grids ({grids}); install one into PROJ's data folder, as with `projsync --file {first}`, or leave --geoid out for heights above the ellipsoid"
    )]
    MissingGrid {
        /// Name of the geoid.
        name: &'static str,
        /// Files of the grid, of which one is enough.
        grids: String,
        /// The file to install.
        first: &'static str,
    },
    /// A folder that contains other files than this output.
    /// Fields: the folder, name of the file that is absent or not ours.
    #[error("{}: there is something else here already ({} is absent or not ours); choose another folder", .0.display(), .1)]
    Occupied(PathBuf, String),
    /// The disk is full.
    #[error("{}: the disk is full, nothing was written; free some space or choose another folder", .0.display())]
    DiskFull(PathBuf),
    /// Writing was refused.
    #[error("{}: no permission to write here; choose another folder", .0.display())]
    Permission(PathBuf),
    /// Any other failure to write. Fields: the file, reason.
    #[error("{}: cannot be written ({})", .0.display(), .1)]
    Write(PathBuf, String),
    /// A failure inside GDAL that is no fault of a file.
    #[error("GDAL: {0}")]
    Gdal(String),
}

impl RasterError {
    /// True for a fault of the input, false for a failed write or a failure inside GDAL.
    pub fn is_input_fault(&self) -> bool {
        !matches!(
            self,
            Self::DiskFull(_) | Self::Permission(_) | Self::Write(..) | Self::Gdal(_)
        )
    }

    /// The error for a failed write of `path`.
    pub fn from_io(path: &Path, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => Self::DiskFull(path.to_owned()),
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => Self::Permission(path.to_owned()),
            _ => Self::Write(path.to_owned(), error.to_string()),
        }
    }
}

/// Versions of GDAL and PROJ in this process, for `--version` and reports.
pub fn library_versions() -> (String, String) {
    let gdal = gdal::version::VersionInfo::release_name();
    let (mut major, mut minor, mut patch) = (0, 0, 0);
    // SAFETY: the function writes three integers, to places that live here.
    #[allow(unsafe_code, reason = "the crate gdal has no name for this function")]
    unsafe {
        gdal_sys::OSRGetPROJVersion(&raw mut major, &raw mut minor, &raw mut patch)
    };
    (gdal, format!("{major}.{minor}.{patch}"))
}
