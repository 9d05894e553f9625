//! Raster files: the only crate that links GDAL and PROJ.
//!
//! Everything else sees [`Raster`](heliosplat::Raster) values, a [`GeoTransform`] and a [`Crs`]. Two conventions are
//! turned here and nowhere else: missing values become `NaN`, and GDAL's pixel corners become our pixel centres at
//! integers (the items of GDAL's `RPC` metadata domain are RPC00B's own and already count from pixel centres).

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
mod siblings;
mod stacked;
pub mod streamed;
pub mod temporary;
pub mod tiled;
pub mod write;

pub use band::{BandInfo, Colour, Window};
pub use crs::{Crs, CrsTransform};
pub use file::{GeoRaster, RasterFile, is_virtual, list_virtual};
pub use geoid::Geoid;
pub use grid::{EnuGrid, GeoTransform, GridSpec};
pub use pansharpen::GridRelation;
pub use streamed::StreamedCog;
pub use tiled::Tile;
pub use write::{
    Bytes, ImageSpec, SampleType, copy_with_rpc, write_atomically, write_byte_cog, write_cog, write_geotiff,
};

use std::path::{Path, PathBuf};

/// Errors of raster files. Every message names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// No such file.
    #[error("{}: no such file", .0.display())]
    Missing(PathBuf),
    /// A file, or one beside it that GDAL would read with it, that cannot be read.
    #[error("{}: cannot be read ({reason})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// Something GDAL does not recognise as an image.
    #[error("{}: not an image GDAL can read ({reason}); give a GeoTIFF, JPEG 2000, NITF or another raster format", path.display())]
    NotAnImage {
        /// The file.
        path: PathBuf,
        /// Message of GDAL.
        reason: String,
    },
    /// A recognised image whose pixels cannot be read.
    #[error("{}: its pixels cannot be read ({reason}); the file is truncated or damaged, fetch it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Message of GDAL.
        reason: String,
    },
    /// Heights in a unit that is no known length.
    #[error("{}: its heights are in '{unit}', which is no known length; convert it to metres, or set the unit of its band", path.display())]
    HeightUnit {
        /// The file.
        path: PathBuf,
        /// The unit.
        unit: String,
    },
    /// A raster that has to lie on the map, and does not.
    #[error("{}: it has no georeferencing; it needs a geotransform and a coordinate system", .0.display())]
    NotGeoreferenced(PathBuf),
    /// A coordinate reference system PROJ does not know.
    #[error("coordinate reference system '{definition}' is not usable ({reason}); give a projected one as EPSG:N")]
    UnknownCrs {
        /// The request.
        definition: String,
        /// Message of PROJ.
        reason: String,
    },
    /// PROJ's database of coordinate systems is missing or not one.
    #[error(
        "PROJ's database cannot be used ({0}); install proj-data, and unset PROJ_LIB and PROJ_DATA where another program set them"
    )]
    ProjDatabase(String),
    /// A coordinate that cannot be transformed.
    #[error("a coordinate cannot be transformed to {crs} ({reason}); choose a coordinate system that covers the scene")]
    Transform {
        /// The target.
        crs: String,
        /// Message of PROJ.
        reason: String,
    },
    /// A geoid whose grid PROJ does not find.
    #[error(
        "geoid {name}: PROJ finds none of its grids ({grids}); install one into PROJ's data folder, as with `projsync --file {first}`, or leave --geoid out for heights above the ellipsoid"
    )]
    MissingGrid {
        /// The geoid.
        name: &'static str,
        /// All grids that would do.
        grids: String,
        /// The one to fetch.
        first: &'static str,
    },
    /// A folder holds something else than what is to be written there.
    #[error("{}: there is something else here already ({name} is absent or not ours); choose another folder", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// The file that says so.
        name: String,
    },
    /// The disk is full.
    #[error("{}: the disk is full, nothing was written; free some space or choose another folder", .0.display())]
    DiskFull(PathBuf),
    /// Writing was refused.
    #[error("{}: no permission to write here; choose another folder", .0.display())]
    Permission(PathBuf),
    /// Any other failure to write.
    #[error("{}: cannot be written ({reason})", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A failure inside GDAL that is no fault of a file.
    #[error("GDAL: {0}")]
    Gdal(String),
}

impl RasterError {
    /// True if the input is at fault, false if the machine's disk or rights are.
    pub fn is_input_fault(&self) -> bool {
        !matches!(
            self,
            Self::DiskFull(_) | Self::Permission(_) | Self::Write { .. } | Self::Gdal(_)
        )
    }

    /// The error for a failed write of `path`.
    pub fn from_io(path: &Path, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => Self::DiskFull(path.to_owned()),
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => Self::Permission(path.to_owned()),
            _ => Self::Write {
                path: path.to_owned(),
                reason: error.to_string(),
            },
        }
    }
}

/// Versions of GDAL and PROJ in this process, for `--version` and reports.
pub fn library_versions() -> (String, String) {
    let gdal = gdal::version::VersionInfo::release_name();
    let proj = proj::ProjBuilder::new()
        .lib_info()
        .map_or_else(|_| "unknown".to_owned(), |info| info.version);
    (gdal, proj)
}
