//! Input of an adjustment: images with their cameras, and tracks, the positions of one ground point in several images.

use crate::rpc::{GeoPoint, ImagePoint, Rpc};

/// Fewest sightings of an image for it to be corrected.
pub const FEWEST_SIGHTINGS: usize = 6;

/// An image: its camera as delivered, and its size, pixels.
#[derive(Debug, Clone, Copy)]
pub struct AdjustImage<'a> {
    /// The camera.
    pub rpc: &'a Rpc,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Where an image shows the point of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Which image.
    pub image: usize,
    /// Where in it, pixels.
    pub at: ImagePoint,
    /// Relative weight, 0 to 1: matches with a lower similarity are less precise.
    pub weight: f64,
}

/// One ground point seen in several images.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// About where it is: a few hundred metres off is near enough.
    pub near: GeoPoint,
    /// Where it is seen; each image at most once.
    pub sightings: Vec<Sighting>,
}
