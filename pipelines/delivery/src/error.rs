//! Errors of a scene: one line each, with the file and the remedy.

use heliosplat_raster::RasterError;
use heliosplat_rpc::RpcError;
use std::path::PathBuf;

/// Result of reading scenes.
pub type Result<T, E = SceneError> = std::result::Result<T, E>;

/// Reason why a scene cannot be opened. Every message is one line with file and remedy.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// No such file or folder.
    #[error("{}: no such file or folder; give a folder of images or a scene.toml", .0.display())]
    Missing(PathBuf),
    /// A web address instead of a path.
    #[error("{0}: addresses are not read; download the images and give their folder")]
    Address(String),
    /// An image with more bands than a model renders. Fields: the first image, its number of bands, the largest number.
    #[error("{}: {} bands, and a model renders {} at most; write the bands that matter to new files, as with `gdal_translate -b 1 -b 2 -b 3 -b 4 {} new.tif`", .0.display(), .1, .2, .0.display())]
    TooManyBands(PathBuf, usize, usize),
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
    /// A camera that cannot be inverted over its image. Fields: the image, ellipsoidal height tried (metres), failed
    /// operation.
    #[error("{}: its RPC camera does not work over this image at {:.0} m ({}); it may belong to another image, or the altitude range is wrong (--altitude MIN,MAX)", .0.display(), .1, .2)]
    Camera(PathBuf, f64, #[source] RpcError),
    /// Bands that differ between images. Fields: the image that differs, its bands in words; the first image, its bands.
    #[error("{}: has {}, but {} has {}; all images of a scene need the same bands, keep one kind per scene", .0.display(), .1, .2.display(), .3)]
    MixedBands(PathBuf, String, PathBuf, String),
    /// Two files that look like the halves of one acquisition and are not. Fields: the panchromatic image, the
    /// multispectral image, the reason.
    #[error("{}: looks like the panchromatic image of {}, but {}; keep one of them in the folder", .0.display(), .1.display(), .2)]
    NotAPair(PathBuf, PathBuf, String),
    /// An image with a colour table instead of measured values.
    #[error("{}: has a colour table instead of measured values; convert it with gdal_translate -expand rgb, or give the original", .0.display())]
    Palette(PathBuf),
    /// An image whose pixels are all missing or zero.
    #[error("{}: every pixel is missing or zero; take the image out of the scene", .0.display())]
    NoPixels(PathBuf),
    /// Fewer than two views to train on. Fields: the scene, number of training images.
    #[error("{}: {} training image{}; at least two overlapping views are needed", .0.display(), .1, if *.1 == 1 { "" } else { "s" })]
    TooFewViews(PathBuf, usize),
    /// Images whose footprints do not overlap. Fields: two images, the altitude of the footprints (metres).
    #[error("{}: does not overlap {} at {:.0} m altitude; give images of one place, or correct the altitude range (--altitude MIN,MAX)", .0.display(), .1.display(), .2)]
    NoOverlap(PathBuf, PathBuf, f64),
    /// Images of two places. Fields: an image of the second place, one of the first, their distance (kilometres).
    #[error("{}: shows another place than {}, {:.0} km away; give the images of one place, or choose one with --area WEST,SOUTH,EAST,NORTH", .0.display(), .1.display(), .2)]
    OtherPlace(PathBuf, PathBuf, f64),
    /// An altitude range that is empty or outside of the Earth's altitudes. Fields: lower and upper end (metres), source
    /// in words.
    #[error(
        "altitude range {0} to {1} m ({2}) is not usable; give --altitude MIN,MAX in metres above the ellipsoid, MIN below MAX"
    )]
    AltitudeRange(f64, f64, String),
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
