//! Windows of images in the full scene of a sensor, and their places on a canvas.

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

/// A square file that is larger than the image in it. The rest of the file is missing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Canvas {
    /// Columns and rows of the file.
    pub(crate) size: usize,
    /// Column of the file that holds the first column of the image.
    pub(crate) col: usize,
    /// Row of the file that holds the first row of the image.
    pub(crate) row: usize,
}

impl Canvas {
    /// Offsets of images are multiples of this many pixels, so that averages of 2, 4, 8, ... pixels stay the same.
    const STEP: usize = 64;

    /// The canvas of an image, with the centre of the full scene (sample, line) in its middle, as far as the image then
    /// lies on it. `None` if the image is larger than the canvas.
    pub(crate) fn around(crop: &Crop, scene_centre_px: [f64; 2], size: usize) -> Option<Self> {
        let place = |first: f64, centre: f64, length: usize| {
            let last = size.checked_sub(length)?;
            let wanted = (first - centre + 0.5 * size as f64).clamp(0.0, last as f64);
            Some(wanted as usize / Self::STEP * Self::STEP)
        };
        Some(Self {
            size,
            col: place(crop.col0, scene_centre_px[0], crop.width)?,
            row: place(crop.row0, scene_centre_px[1], crop.height)?,
        })
    }

    /// The canvas of the same image in pixels `ratio` times as wide; `ratio` must divide 64.
    pub(crate) fn coarser(&self, ratio: usize) -> Self {
        Self {
            size: self.size.div_ceil(ratio),
            col: self.col / ratio,
            row: self.row / ratio,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_lies_on_its_canvas_where_it_lies_in_the_scene() {
        let crop = Crop {
            col0: 700.0,
            row0: 1500.0,
            width: 200,
            height: 150,
        };
        let canvas = |size: usize| Canvas::around(&crop, [1000.0, 1000.0], size);
        let at = |col: usize, row: usize, size: usize| Some(Canvas { size, col, row });
        assert_eq!(canvas(4000), at(1664, 2496, 4000));
        assert_eq!(canvas(400), at(0, 192, 400), "all of the image lies on it");
        assert_eq!(canvas(199), None);
        assert_eq!(canvas(4000).map(|canvas| canvas.coarser(4)), at(416, 624, 1000));
    }
}
