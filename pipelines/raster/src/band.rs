//! Description of the bands of a raster file, and windows of its pixels.

use heliosplat::Raster;
use std::sync::Arc;

/// Colour interpretation of a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// Grey.
    Grey,
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Opacity.
    Alpha,
    /// Indices into a colour table.
    Palette,
    /// Not stated, or any other colour.
    Undefined,
}

/// One band of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct BandInfo {
    /// Description, empty where the file has none.
    pub description: String,
    /// Colour interpretation.
    pub colour: Colour,
    /// GDAL's name of the data type, such as `UInt16`.
    pub data_type: String,
    /// Unit of its values, empty where the file states none.
    pub unit: String,
    /// Value of missing pixels, if the file states one.
    pub nodata: Option<f64>,
    /// Factor from counts to the unit, if the file states it.
    pub scale: Option<f64>,
    /// Offset, in the unit, added after the factor, if the file states it.
    pub offset: Option<f64>,
}

/// A pixel window: first column and row, columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Window {
    /// First column.
    pub col0: usize,
    /// First row.
    pub row0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// Pixels from a column and a row on, this many columns and rows of them.
    pub fn new((col0, row0): (usize, usize), (width, height): (usize, usize)) -> Self {
        Self {
            col0,
            row0,
            width,
            height,
        }
    }

    /// All pixels of an image of this many columns and rows.
    pub fn whole(size: (usize, usize)) -> Self {
        Self::new((0, 0), size)
    }

    /// Pixels of the window; `NaN` outside of the raster.
    pub fn cut(&self, raster: &Raster) -> Raster {
        let mut out = Raster::filled(self.width, self.height, raster.bands, f32::NAN);
        for band in 0..raster.bands {
            let width = self.width.min(raster.width.saturating_sub(self.col0));
            for row in 0..self.height.min(raster.height.saturating_sub(self.row0)) {
                let from = (band * raster.height + self.row0 + row) * raster.width + self.col0;
                let to = (band * self.height + row) * self.width;
                out.values[to..to + width].copy_from_slice(&raster.values[from..from + width]);
            }
        }
        out
    }

    /// Pixels of the window, without a copy where it is the whole raster.
    pub fn shared(&self, raster: &Arc<Raster>) -> Arc<Raster> {
        match *self == Self::whole((raster.width, raster.height)) {
            true => raster.clone(),
            false => self.cut(raster).into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_beyond_its_raster_is_unknown_there() {
        let raster = Raster::filled(4, 3, 2, 1.0);
        let window = Window {
            col0: 3,
            row0: 2,
            width: 2,
            height: 2,
        };
        let cut = window.cut(&raster);
        let known: Vec<bool> = cut.values.iter().map(|value| value.is_finite()).collect();
        assert_eq!(known, [true, false, false, false, true, false, false, false]);
    }
}
