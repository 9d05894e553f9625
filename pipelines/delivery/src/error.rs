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
    /// A folder that cannot be listed, or a text that cannot be read.
    #[error("{}: cannot be read ({reason})", path.display())]
    Unreadable {
        /// File or folder.
        path: PathBuf,
        /// Reason, in words.
        reason: String,
    },
    /// A folder without images.
    #[error("{}: no images found (looked for .tif, .tiff, .jp2, .ntf, .nitf, .img); give a folder of images or a scene.toml", .0.display())]
    Empty(PathBuf),
    /// A folder with several scenes.
    #[error("{}: holds several scenes ({candidates}); give one of them", path.display())]
    Several {
        /// The folder.
        path: PathBuf,
        /// Paths of the scenes, in one line.
        candidates: String,
    },
    /// An area that fewer than two training images show.
    #[error("{}: fewer than two training images show the area {area}; give another --area", path.display())]
    NotCovered {
        /// The scene.
        path: PathBuf,
        /// The area, in words.
        area: String,
    },
    /// A `scene.toml` or another list that cannot be parsed.
    #[error("{}: {reason}", path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Reason and remedy.
        reason: String,
    },
    /// A listed image that does not exist.
    #[error("{image}: listed in {} but not found; put it beside that file or in a folder named images", listed_in.display())]
    MissingImage {
        /// The image's name as listed.
        image: String,
        /// The file that lists it.
        listed_in: PathBuf,
    },
    /// A tile that a DIMAP lists and that does not exist.
    #[error("{}: a tile of the image that {} describes, but it is not there; copy it from the delivery, or leave out that image with its other tiles", tile.display(), dimap.display())]
    MissingTile {
        /// The tile.
        tile: PathBuf,
        /// The DIMAP.
        dimap: PathBuf,
    },
    /// An image without a camera.
    #[error("{}: no RPC camera found; put its .RPB, _RPC.TXT, RPC_*.XML or .json beside it, or take the image out of the scene", .0.display())]
    NoRpc(PathBuf),
    /// A map-projected image without a camera.
    #[error("{}: is map-projected (it has a geotransform and a coordinate system) and has no RPC; give the original image with its RPC", .0.display())]
    MapProjected(PathBuf),
    /// A failed check of severity error; the text is its message.
    #[error("{0}")]
    Refused(String),
    /// A camera file that cannot be parsed.
    #[error("{}: its RPC camera cannot be read ({reason}); replace it or delete it", path.display())]
    BadRpc {
        /// The camera file, or the image whose tag it is.
        path: PathBuf,
        /// Reason, in words.
        reason: String,
    },
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
    /// Fewer than two views to train on.
    #[error("{}: {count} training image{}; at least two overlapping views are needed", path.display(), if *count == 1 { "" } else { "s" })]
    TooFewViews {
        /// The scene.
        path: PathBuf,
        /// Number of training images.
        count: usize,
    },
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
