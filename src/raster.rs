//! A small planar image, the engine's only image type.

/// `bands` planes of `height × width` values, band after band, row after row. `NaN` marks a missing value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Planes.
    pub bands: usize,
    /// Values, `[band][row][column]`.
    pub values: Vec<f32>,
}

impl Raster {
    /// A raster whose pixels all have `value`.
    pub fn filled(width: usize, height: usize, bands: usize, value: f32) -> Self {
        Self {
            width,
            height,
            bands,
            values: vec![value; width * height * bands],
        }
    }

    /// Raster of the values of `value` by band, column and row.
    pub fn from_fn(
        width: usize,
        height: usize,
        bands: usize,
        mut value: impl FnMut(usize, usize, usize) -> f32,
    ) -> Self {
        let mut out = Self::filled(width, height, bands, f32::NAN);
        for (line, slots) in out.values.chunks_exact_mut(width.max(1)).enumerate() {
            for (col, slot) in slots.iter_mut().enumerate() {
                *slot = value(line / height, col, line % height);
            }
        }
        out
    }

    /// A raster of one band.
    pub fn of_plane(width: usize, height: usize, values: Vec<f32>) -> Self {
        let bands = 1;
        Self {
            width,
            height,
            bands,
            values,
        }
    }

    /// Makes all bands `NaN` where `known`, one value a pixel, is `NaN`.
    pub fn blank_unknown(&mut self, known: &[f32]) {
        for band in 0..self.bands {
            let values = self.plane_mut(band).iter_mut();
            let unknown = values.zip(known).filter(|(_, known)| known.is_nan());
            unknown.for_each(|(value, _)| *value = f32::NAN);
        }
    }

    /// Number of pixels of one plane.
    pub fn plane_len(&self) -> usize {
        self.width * self.height
    }

    /// Plane `band`, row after row.
    pub fn plane(&self, band: usize) -> &[f32] {
        &self.values[band * self.plane_len()..(band + 1) * self.plane_len()]
    }

    /// Plane `band` as a raster of one band.
    pub fn band(&self, band: usize) -> Self {
        Self::of_plane(self.width, self.height, self.plane(band).to_vec())
    }

    /// Plane `band`, row after row, to write.
    pub fn plane_mut(&mut self, band: usize) -> &mut [f32] {
        let len = self.plane_len();
        &mut self.values[band * len..(band + 1) * len]
    }

    /// Value of band `band` at a pixel.
    #[inline]
    pub fn at(&self, band: usize, col: usize, row: usize) -> f32 {
        self.values[(band * self.height + row) * self.width + col]
    }

    /// Part of `width` by `height` pixels that begins at a column and a row, all of it within the raster.
    #[must_use]
    pub fn part(&self, (col0, row0): (usize, usize), (width, height): (usize, usize)) -> Self {
        let mut values = Vec::with_capacity(width * height * self.bands);
        for band in 0..self.bands {
            for row in row0..row0 + height {
                let first = (band * self.height + row) * self.width + col0;
                values.extend_from_slice(&self.values[first..first + width]);
            }
        }
        Self {
            width,
            height,
            bands: self.bands,
            values,
        }
    }

    /// Copies another raster with as many bands to a column and a row; what lies beyond the edges is left out.
    pub fn put(&mut self, part: &Self, (col0, row0): (usize, usize)) {
        let width = part.width.min(self.width.saturating_sub(col0));
        for band in 0..self.bands.min(part.bands) {
            for row in 0..part.height.min(self.height.saturating_sub(row0)) {
                let to = (band * self.height + row0 + row) * self.width + col0;
                let from = (band * part.height + row) * part.width;
                self.values[to..to + width].copy_from_slice(&part.values[from..from + width]);
            }
        }
    }

    /// Means over blocks of `factor × factor` pixels, of the finite values; NaN where a block has none. Pixels at the
    /// right and lower edge that fill no block are dropped.
    pub fn downscaled(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        Self::from_fn(width, height, self.bands, |band, col, row| {
            let (mut sum, mut count) = (0.0, 0);
            for r in row * factor..(row + 1) * factor {
                for c in col * factor..(col + 1) * factor {
                    let value = self.at(band, c, r);
                    if value.is_finite() {
                        sum += value;
                        count += 1;
                    }
                }
            }
            if count > 0 { sum / count as f32 } else { f32::NAN }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raster_of_a_function_has_its_values_by_band_column_and_row() {
        let raster = Raster::from_fn(3, 2, 2, |band, col, row| (100 * band + 10 * col + row) as f32);
        for (band, col, row) in [(0, 0, 0), (0, 2, 1), (1, 1, 0), (1, 2, 1)] {
            assert_eq!(raster.at(band, col, row), (100 * band + 10 * col + row) as f32);
        }
    }
}
