//! Windows of images in the full scene of a sensor.

/// The window of an image in the sensor's full scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crop {
    /// Column of the full scene at the centre of the image's first pixel.
    pub(crate) col0: f64,
    /// Row of the full scene at the centre of the image's first pixel.
    pub(crate) row0: f64,
    /// Columns of the image.
    pub(crate) width: usize,
    /// Rows of the image.
    pub(crate) height: usize,
}
