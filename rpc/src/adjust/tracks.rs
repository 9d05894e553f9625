//! Input of an adjustment: images with their cameras, and tracks, the positions of one ground point in several images.

use crate::rpc::{GeoPoint, ImagePoint, Rpc};

/// Fewest sightings of an image for it to be corrected.
pub const FEWEST_SIGHTINGS: usize = 6;

/// An image: its camera as delivered, and its size, pixels.
#[derive(Debug, Clone, Copy)]
pub struct AdjustImage<'a> {
    /// The camera.
    pub rpc: &'a Rpc,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
}

/// Position of a track's point in an image.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sighting {
    /// Index of the image.
    pub image: usize,
    /// Position, pixels.
    pub at: ImagePoint,
    /// Relative weight, 0 to 1: matches with a lower similarity are less precise.
    pub weight: f64,
}

/// One ground point seen in several images.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Track {
    /// Approximate position: an error of a few hundred metres is allowed.
    pub near: GeoPoint,
    /// Its positions in images; each image at most once.
    pub sightings: Vec<Sighting>,
}
