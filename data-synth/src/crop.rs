//! The window of the sensor's full scene that an image is.

/// The window of an image in the sensor's full scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crop {
    pub(crate) col0: f64,
    pub(crate) row0: f64,
    pub(crate) width: usize,
    pub(crate) height: usize,
}
