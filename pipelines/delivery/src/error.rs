//! Errors of a scene: one line each, with the file and the remedy.

use heliosplat_raster::RasterError;
use heliosplat_rpc::RpcError;
use std::path::PathBuf;

/// Reason why a scene cannot be opened. Every message is one line with file and remedy.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// No such file or folder.
    #[error("{}: no such file or folder; give a folder of images or a scene.toml", .0.display())]
    Missing(PathBuf),
    /// A web address instead of a path.
    #[error("{0}: addresses are not read; download the images and give their folder")]
    Address(String),
    /// An image with more bands than a model renders.
    #[error(
        "{}: {bands} bands, and a model renders {most} at most; write the bands that matter to new files, as with `gdal_translate -b 1 -b 2 -b 3 -b 4 {} new.tif`",
        path.display(),
        path.display()
    )]
    TooManyBands {
        /// The first image.
        path: PathBuf,
        /// Its number of bands.
        bands: usize,
        /// Largest number of bands.
        most: usize,
    },
    /// A folder that cannot be listed, or a text that cannot be read. Fields: file or folder, reason, in words.
    #[error("{}: cannot be read ({})", .0.display(), .1)]
    Unreadable(PathBuf, String),
    /// A folder without images.
    #[error("{}: no images found (looked for .tif, .tiff, .jp2, .ntf, .nitf, .img); give a folder of images or a scene.toml", .0.display())]
    Empty(PathBuf),
    /// A folder with several scenes. Fields: the folder, paths of the scenes, in one line.
    #[error("{}: holds several scenes ({}); give one of them", .0.display(), .1)]
    Several(PathBuf, String),
    /// An area that fewer than two training images show. Fields: the scene, the area, in words.
    #[error("{}: fewer than two training images show the area {}; give another --area", .0.display(), .1)]
    NotCovered(PathBuf, String),
    /// A `scene.toml` or another list that cannot be parsed. Fields: the file, reason and remedy.
    #[error("{}: {}", .0.display(), .1)]
    Manifest(PathBuf, String),
    /// A listed image that does not exist. Fields: the image's name as listed, the file that lists it.
    #[error("{}: listed in {} but not found; put it beside that file or in a folder named images", .0, .1.display())]
    MissingImage(String, PathBuf),
    /// A tile that a DIMAP lists and that does not exist. Fields: the tile, the DIMAP.
    #[error("{}: a tile of the image that {} describes, but it is not there; copy it from the delivery, or leave out that image with its other tiles", .0.display(), .1.display())]
    MissingTile(PathBuf, PathBuf),
    /// An image without a camera.
    #[error("{}: no RPC camera found; put its .RPB, _RPC.TXT, RPC_*.XML or .json beside it, or take the image out of the scene", .0.display())]
    NoRpc(PathBuf),
    /// A map-projected image without a camera.
    #[error("{}: is map-projected (it has a geotransform and a coordinate system) and has no RPC; give the original image with its RPC", .0.display())]
    MapProjected(PathBuf),
    /// A failed check of severity error; the text is its message.
    #[error("{0}")]
    Refused(String),
    /// A camera file that cannot be parsed. Fields: the camera file, or the image whose tag it is, reason, in words.
    #[error("{}: its RPC camera cannot be read ({}); replace it or delete it", .0.display(), .1)]
    BadRpc(PathBuf, String),
    /// A camera that cannot be inverted over its image.
    #[error("{}: its RPC camera does not work over this image at {height_m:.0} m ({source}); it may belong to another image, or the altitude range is wrong (--altitude MIN,MAX)", path.display())]
    Camera {
        /// The image.
        path: PathBuf,
        /// Ellipsoidal height tried, metres.
        height_m: f64,
        /// Failed operation.
        source: RpcError,
    },
    /// Bands that differ between images.
    #[error("{}: has {found}, but {} has {expected}; all images of a scene need the same bands, keep one kind per scene", path.display(), other.display())]
    MixedBands {
        /// The image that differs.
        path: PathBuf,
        /// Its bands, in words.
        found: String,
        /// The first image of the scene.
        other: PathBuf,
        /// The bands of the first image, in words.
        expected: String,
    },
    /// Two files that look like the halves of one acquisition and are not.
    #[error("{}: looks like the panchromatic image of {}, but {reason}; keep one of them in the folder", pan.display(), multispectral.display())]
    NotAPair {
        /// The panchromatic image.
        pan: PathBuf,
        /// The multispectral image.
        multispectral: PathBuf,
        /// Reason against a common acquisition.
        reason: String,
    },
    /// An image with a colour table instead of measured values.
    #[error("{}: has a colour table instead of measured values; convert it with gdal_translate -expand rgb, or give the original", .0.display())]
    Palette(PathBuf),
    /// An image whose pixels are all missing or zero.
    #[error("{}: every pixel is missing or zero; take the image out of the scene", .0.display())]
    NoPixels(PathBuf),
    /// Fewer than two views to train on. Fields: the scene, number of training images.
    #[error("{}: {} training image{}; at least two overlapping views are needed", .0.display(), .1, if *.1 == 1 { "" } else { "s" })]
    TooFewViews(PathBuf, usize),
    /// Images whose footprints do not overlap.
    #[error("{}: does not overlap {} at {altitude_m:.0} m altitude; give images of one place, or correct the altitude range (--altitude MIN,MAX)", first.display(), second.display())]
    NoOverlap {
        /// One image.
        first: PathBuf,
        /// Another.
        second: PathBuf,
        /// Altitude at which the footprints were compared, metres.
        altitude_m: f64,
    },
    /// Images of two places.
    #[error("{}: shows another place than {}, {apart_km:.0} km away; give the images of one place, or choose one with --area WEST,SOUTH,EAST,NORTH", second.display(), first.display())]
    OtherPlace {
        /// An image of one place.
        first: PathBuf,
        /// An image of the other.
        second: PathBuf,
        /// Distance, kilometres.
        apart_km: f64,
    },
    /// An altitude range that is empty or outside of the Earth's altitudes.
    #[error(
        "altitude range {low_m} to {high_m} m ({origin}) is not usable; give --altitude MIN,MAX in metres above the ellipsoid, MIN below MAX"
    )]
    AltitudeRange {
        /// Lower end, metres.
        low_m: f64,
        /// Upper end, metres.
        high_m: f64,
        /// Source of the range, in words.
        origin: String,
    },
    /// A raster that cannot be read.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl SceneError {
    /// True if the input is at fault (exit code 2), false if the machine is (exit code 1).
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::Raster(error) => error.is_input_fault(),
            _ => true,
        }
    }
}
