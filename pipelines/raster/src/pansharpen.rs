//! A panchromatic and a multispectral image of one acquisition read as one.
//!
//! Images as the sensor took them have no map coordinates: where the pixels of one lie in the other is a scale and an offset along
//! columns and rows, which the caller knows from their cameras. Brightness comes from the panchromatic image, colours from the
//! multispectral pixels around, of which those count most that are as bright as the panchromatic pixel: so colours keep to the edges
//! of the panchromatic image (joint bilateral upsampling, J. Kopf et al., "Joint bilateral upsampling", ACM Transactions on Graphics
//! 26, 2007).

use super::RasterError;
use rayon::prelude::*;
use std::ops::Range;

/// Standard deviation of the weight by distance, multispectral pixels.
const DISTANCE_PX: f64 = 0.6;
/// Standard deviation of the weight by difference of brightness, natural logarithms.
const BRIGHTNESS: f32 = 0.15;
/// Differences of brightness weigh at least this much, so that a pixel unlike all around takes the mean of their colours.
const LEAST_WEIGHT: f32 = 1e-6;
/// Multispectral pixels to each side of the one that a pixel lies in whose colours count.
const REACH: usize = 1;

/// Where the pixels of one image lie in another, along columns and along rows: `other = scale · own + offset`, pixel centres at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRelation {
    /// Pixels of the other image per pixel.
    pub scale: [f64; 2],
    /// Column and row of the other image that the centre of the first pixel lies on.
    pub offset: [f64; 2],
}

/// Columns and rows of both images that a part of the result is made of: first column and row, columns and rows.
pub(super) type Rectangle = [usize; 4];

impl GridRelation {
    /// Values over a window of the panchromatic image, `factor` by `factor` pixels averaged into one; band after band. Of the
    /// multispectral image as many pixels are averaged into one as then are no larger than those of the result. `sizes` are columns and
    /// rows of both images, `types` GDAL's types of the bands that are asked for. `read_pan` reads the panchromatic image, and `read_band`
    /// one of these bands by its place among them, averaged by the number that it is given.
    pub(super) fn fuse(
        &self,
        sizes: [[usize; 2]; 2],
        window: Rectangle,
        factor: usize,
        types: &[&str],
        read_pan: impl Fn(Rectangle) -> Result<Vec<f32>, RasterError>,
        read_band: impl Fn(Rectangle, usize, usize) -> Result<Vec<f32>, RasterError>,
    ) -> Result<Vec<f32>, RasterError> {
        let starts = [window[0], window[1]];
        let lengths = [window[2] / factor, window[3] / factor];
        let finest = self.scale[0].min(self.scale[1]) * factor as f64;
        let merged = (finest.floor() as usize).clamp(1, sizes[1][0].min(sizes[1][1]).max(1));
        let axes: [Axis; 2] = std::array::from_fn(|axis| {
            let before = starts[axis] / factor;
            let first = starts[axis] - before * factor;
            let (scale, offset) = (self.scale[axis], self.offset[axis]);
            // Centres of what is averaged lie between the pixels.
            let [own, other] = [factor, merged].map(|count| 0.5 * (count as f64 - 1.0));
            Axis {
                scale: scale * factor as f64 / merged as f64,
                offset: (scale * (first as f64 + own) + offset - other) / merged as f64,
                first,
                pixels: (sizes[0][axis] - first) / factor,
                others: sizes[1][axis] / merged,
                wanted: before..before + lengths[axis],
            }
        });
        let [across, down] = axes;
        let [cols, rows] = [&across, &down].map(Axis::needed);
        // Nothing of the multispectral image lies near.
        if cols.is_empty() || rows.is_empty() {
            return Ok(vec![f32::NAN; lengths[0] * lengths[1] * types.len()]);
        }
        let [pan_cols, pan_rows] = [(&across, &cols), (&down, &rows)].map(|(axis, others)| axis.under(others));
        let pan_window = [
            across.first + pan_cols.start * factor,
            down.first + pan_rows.start * factor,
            pan_cols.len() * factor,
            pan_rows.len() * factor,
        ];
        let other_window = [
            cols.start * merged,
            rows.start * merged,
            cols.len() * merged,
            rows.len() * merged,
        ];
        let brightness = Part {
            values: read_pan(pan_window)?,
            cols: pan_cols,
            rows: pan_rows,
        };
        let means = brightness.means(&across, &down, &cols, &rows);
        let mut ratios = Vec::with_capacity(types.len() * means.len());
        for place in 0..types.len() {
            let values = read_band(other_window, merged, place)?;
            // Where the panchromatic image is black, all bands are.
            let ratio = |(value, mean): (&f32, &f32)| if *mean > 0.0 { value / mean } else { 0.0 * value * mean };
            ratios.extend(values.iter().zip(&means).map(ratio));
        }
        let coarse = Coarse {
            logarithms: means.iter().map(|mean| mean.ln()).collect(),
            ratios,
            cols,
            rows,
        };
        let limits: Vec<Option<[f32; 2]>> = types.iter().map(|name| integers(name)).collect();
        Ok(fused(&brightness, &coarse, &across, &down, &limits))
    }
}

/// One axis of both grids, in pixels of the result that are counted from the first of the image whose phase they share.
struct Axis {
    /// As of [`GridRelation`].
    scale: f64,
    offset: f64,
    /// Pixel of the file that the first pixel starts at.
    first: usize,
    /// How many panchromatic pixels there are.
    pixels: usize,
    /// How many multispectral pixels there are.
    others: usize,
    /// The panchromatic pixels that are asked for.
    wanted: Range<usize>,
}

impl Axis {
    /// The multispectral pixel that a panchromatic one lies in; it may lie outside of the image.
    fn nearest(&self, pixel: usize) -> i64 {
        (self.scale * pixel as f64 + self.offset).round() as i64
    }

    /// The multispectral pixels whose colours count for those that are asked for.
    fn needed(&self) -> Range<usize> {
        if self.wanted.is_empty() {
            return 0..0;
        }
        let inside = |pixel: i64| pixel.clamp(0, self.others as i64) as usize;
        let first = self.nearest(self.wanted.start) - REACH as i64;
        let last = self.nearest(self.wanted.end - 1) + REACH as i64;
        inside(first)..inside(last + 1)
    }

    /// Where a multispectral pixel starts and ends, in panchromatic pixels from the corner of the first.
    fn extent(&self, other: usize) -> [f64; 2] {
        [-0.5, 0.5].map(|side| (other as f64 + side - self.offset) / self.scale + 0.5)
    }

    /// The panchromatic pixels that lie in a multispectral one, and which share of its side each of them makes.
    fn shares(&self, other: usize) -> impl Iterator<Item = (usize, f64)> {
        let [start, end] = self.extent(other);
        let inside = |corner: f64| corner.clamp(0.0, self.pixels as f64);
        let pixels = inside(start.floor()) as usize..inside(end.ceil()) as usize;
        pixels.map(move |pixel| {
            let overlap = end.min(pixel as f64 + 1.0) - start.max(pixel as f64);
            (pixel, overlap.max(0.0))
        })
    }

    /// The panchromatic pixels that are asked for or lie in any of these multispectral ones.
    fn under(&self, others: &Range<usize>) -> Range<usize> {
        let inside = |corner: f64| corner.clamp(0.0, self.pixels as f64) as usize;
        let start = inside(self.extent(others.start)[0].floor());
        let end = inside(self.extent(others.end - 1)[1].ceil());
        start.min(self.wanted.start)..end.max(self.wanted.end)
    }

    /// The multispectral pixels around a panchromatic one, and their weights by distance.
    fn around(&self, pixel: usize) -> [(i64, f32); 2 * REACH + 1] {
        let place = self.scale * pixel as f64 + self.offset;
        let first = self.nearest(pixel) - REACH as i64;
        std::array::from_fn(|index| {
            let other = first + index as i64;
            let distance = (other as f64 - place) / DISTANCE_PX;
            (other, (-0.5 * distance * distance).exp() as f32)
        })
    }
}

/// A part of the panchromatic image.
struct Part {
    values: Vec<f32>,
    cols: Range<usize>,
    rows: Range<usize>,
}

impl Part {
    fn at(&self, col: usize, row: usize) -> f32 {
        self.values[(row - self.rows.start) * self.cols.len() + col - self.cols.start]
    }

    /// The mean over each of these multispectral pixels of what is known there; `NaN` where that is nothing.
    fn means(&self, across: &Axis, down: &Axis, cols: &Range<usize>, rows: &Range<usize>) -> Vec<f32> {
        let mut means = vec![f32::NAN; cols.len() * rows.len()];
        means
            .par_chunks_mut(cols.len())
            .zip(rows.clone())
            .for_each(|(means, other_row)| {
                for (mean, other_col) in means.iter_mut().zip(cols.clone()) {
                    let (mut sum, mut weight) = (0.0, 0.0);
                    for (row, share_down) in down.shares(other_row) {
                        for (col, share_across) in across.shares(other_col) {
                            let value = f64::from(self.at(col, row));
                            if !value.is_nan() {
                                sum += share_down * share_across * value;
                                weight += share_down * share_across;
                            }
                        }
                    }
                    if weight > 0.0 {
                        *mean = (sum / weight) as f32;
                    }
                }
            });
        means
    }
}

/// A part of the multispectral image.
struct Coarse {
    /// Logarithms of the mean of the panchromatic image over each pixel; `NaN` where it is not known.
    logarithms: Vec<f32>,
    /// Values by that mean, band after band; `NaN` where either is not known.
    ratios: Vec<f32>,
    cols: Range<usize>,
    rows: Range<usize>,
}

impl Coarse {
    fn index(&self, col: i64, row: i64) -> Option<usize> {
        let along = |range: &Range<usize>, place: i64| {
            let place = usize::try_from(place).ok()?;
            range.contains(&place).then(|| place - range.start)
        };
        Some(along(&self.rows, row)? * self.cols.len() + along(&self.cols, col)?)
    }
}

/// The values that are asked for, band after band; `limits` are the least and the greatest value of integer bands.
fn fused(brightness: &Part, coarse: &Coarse, across: &Axis, down: &Axis, limits: &[Option<[f32; 2]>]) -> Vec<f32> {
    let (width, height) = (across.wanted.len(), down.wanted.len());
    let plane = coarse.logarithms.len();
    let columns: Vec<_> = across.wanted.clone().map(|col| across.around(col)).collect();
    let mut rows = vec![f32::NAN; width * height * limits.len()];
    // Row after row, and the bands of a pixel together: their weights are the same.
    rows.par_chunks_mut(width * limits.len())
        .zip(down.wanted.clone())
        .for_each(|(values, row)| {
            let around_row = down.around(row);
            for ((pixel, col), around_col) in values
                .chunks_exact_mut(limits.len())
                .zip(across.wanted.clone())
                .zip(&columns)
            {
                let value = brightness.at(col, row);
                let logarithm = value.ln();
                let mut taken = [(0, 0.0f32); (2 * REACH + 1) * (2 * REACH + 1)];
                let mut count = 0;
                for (other_row, by_row) in around_row {
                    for &(other_col, by_col) in around_col {
                        let Some(index) = coarse.index(other_col, other_row) else {
                            continue;
                        };
                        let difference = (logarithm - coarse.logarithms[index]) / BRIGHTNESS;
                        let weight = by_row * by_col * ((-0.5 * difference * difference).exp() + LEAST_WEIGHT);
                        taken[count] = (index, weight);
                        count += 1;
                    }
                }
                let own = coarse.index(around_col[REACH].0, around_row[REACH].0);
                for (band, (out, limits)) in pixel.iter_mut().zip(limits).enumerate() {
                    let ratios = &coarse.ratios[band * plane..(band + 1) * plane];
                    *out = own.map_or(f32::NAN, |own| colour(value, own, &taken[..count], ratios));
                    if let Some([least, greatest]) = limits {
                        *out = out.round().clamp(*least, *greatest);
                    }
                }
            }
        });
    let mut bands = vec![f32::NAN; rows.len()];
    bands
        .par_chunks_mut((width * height).max(1))
        .enumerate()
        .for_each(|(band, values)| {
            for (value, pixel) in values.iter_mut().zip(rows.chunks_exact(limits.len())) {
                *value = pixel[band];
            }
        });
    bands
}

/// The value `value` of the panchromatic image in the colour of the multispectral pixels around, of which these are `taken`, each with its
/// weight; `own` is the one that it lies in.
fn colour(value: f32, own: usize, taken: &[(usize, f32)], ratios: &[f32]) -> f32 {
    if value.is_nan() || ratios[own].is_nan() {
        return f32::NAN;
    }
    // It has no logarithm.
    if value <= 0.0 {
        return 0.0;
    }
    let known = taken.iter().filter(|(index, _)| !ratios[*index].is_nan());
    let (sum, weights) = known.fold((0.0, 0.0), |(sum, weights), &(index, weight)| {
        (sum + weight * ratios[index], weights + weight)
    });
    value * sum / weights
}

/// The least and the greatest value of one of GDAL's integer types.
fn integers(data_type: &str) -> Option<[f32; 2]> {
    match data_type {
        "Byte" => Some([0.0, f32::from(u8::MAX)]),
        "UInt16" => Some([0.0, f32::from(u16::MAX)]),
        "Int16" => Some([f32::from(i16::MIN), f32::from(i16::MAX)]),
        "UInt32" => Some([0.0, u32::MAX as f32]),
        "Int32" => Some([i32::MIN as f32, i32::MAX as f32]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImageSpec, RasterFile, Sample, Window, write_geotiff};
    use heliosplat::Raster;
    use std::path::Path;

    /// Four panchromatic pixels along the side of a multispectral one, whose first corners coincide.
    const QUARTER: GridRelation = GridRelation {
        scale: [0.25; 2],
        offset: [-0.375; 2],
    };
    /// Ratios that are no whole numbers, and grids that are offset.
    const UNEVEN: GridRelation = GridRelation {
        scale: [0.37, 0.55],
        offset: [0.21, -0.33],
    };

    fn raster(width: usize, height: usize, bands: usize, value: impl Fn(usize, usize, usize) -> f32) -> Raster {
        let mut raster = Raster::filled(width, height, bands, 0.0);
        for (index, out) in raster.values.iter_mut().enumerate() {
            *out = value(index / (width * height), index % width, index / width % height);
        }
        raster
    }

    fn pair(folder: &Path, pan: &Raster, colours: &Raster, relation: &GridRelation) -> RasterFile {
        let [pan, colours] = [("pan.tif", pan), ("colours.tif", colours)].map(|(name, raster)| {
            let path = folder.join(name);
            write_geotiff(&path, &ImageSpec::plain(raster), Sample::U16).expect("written");
            let mut file = RasterFile::open(&path).expect("an image");
            file.bands.iter_mut().for_each(|band| band.nodata = Some(0.0));
            file
        });
        RasterFile::pansharpened(pan, colours, relation).expect("one image")
    }

    /// Values of 100 to 1,100 in no order.
    fn noise(band: usize, col: usize, row: usize) -> f32 {
        (100 + (7919 * (col + 1) * (row + 3) + 104_729 * band * (col + row + 1)) % 1009) as f32
    }

    #[test]
    fn a_step_of_brightness_inside_a_multispectral_pixel_keeps_its_two_colours_apart() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        // Left of column 34 of the panchromatic image, in the middle of a multispectral pixel.
        let sides = [[300.0, 100.0], [400.0, 1600.0]];
        let colours = raster(16, 12, 2, |band, col, _| match col {
            0..8 => sides[0][band],
            8 => 0.5 * (sides[0][band] + sides[1][band]),
            _ => sides[1][band],
        });
        let pan = raster(64, 48, 1, |_, col, _| if col < 34 { 200.0 } else { 1000.0 });
        let whole = pair(folder.path(), &pan, &colours, &QUARTER)
            .read_all()
            .expect("pixels");
        for col in 0..64 {
            for (band, expected) in sides[usize::from(col >= 34)].into_iter().enumerate() {
                let found = whole.at(band, col, 20);
                assert!((found / expected - 1.0).abs() < 0.02, "{col}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn where_the_panchromatic_image_is_flat_values_are_those_of_the_multispectral_one() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let colours = raster(16, 12, 2, |band, _, row| {
            (1 + band) as f32 * (100 * (1 + row / 4)) as f32
        });
        let pan = raster(64, 48, 1, |_, _, row| (70 * (1 + row / 16)) as f32);
        let file = pair(folder.path(), &pan, &colours, &QUARTER);
        assert_eq!((file.size(), file.bands.len()), ((64, 48), 2));
        let whole = file.read_all().expect("pixels");
        for row in (0..48).filter(|row| !(12..20).contains(row) && !(28..36).contains(row)) {
            for band in 0..2 {
                assert_eq!(whole.at(band, 40, row), colours.at(band, 10, row / 4), "{band} {row}");
            }
        }
        let halved = file.read_reduced(file.whole(), 8, &[1]).expect("pixels");
        assert_eq!((halved.at(0, 5, 0), halved.at(0, 5, 5)), (200.0, 600.0));
    }

    #[test]
    fn a_window_is_that_part_of_the_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (relation, (width, height)) in [(QUARTER, (61, 47)), (UNEVEN, (50, 40))] {
            let pan = raster(width, height, 1, noise);
            let colours = raster(16, 20, 3, noise);
            let file = pair(folder.path(), &pan, &colours, &relation);
            let whole = file.read_all().expect("pixels");
            assert!(whole.values.iter().filter(|value| value.is_nan()).count() < whole.values.len() / 3);
            for (col0, row0, columns, rows) in [
                (0, 0, 9, 7),
                (20, 10, 24, 16),
                (width - 5, height - 6, 5, 6),
                (13, 0, 1, 1),
            ] {
                let window = Window {
                    col0,
                    row0,
                    width: columns,
                    height: rows,
                };
                let part = file.read(window, &[2, 0]).expect("pixels");
                for (place, band) in [2, 0].into_iter().enumerate() {
                    for row in 0..rows {
                        for col in 0..columns {
                            let [here, there] = [part.at(place, col, row), whole.at(band, col0 + col, row0 + row)];
                            assert_eq!(here.to_bits(), there.to_bits(), "{window:?} {col} {row}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_pixel_is_missing_where_either_image_is_and_takes_nothing_from_what_is_missing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let pan = raster(
            64,
            48,
            1,
            |_, col, row| if (col, row) == (20, 20) { 0.0 } else { 500.0 },
        );
        let colours = raster(12, 12, 2, |_, col, row| if (col, row) == (3, 3) { 0.0 } else { 700.0 });
        let whole = pair(folder.path(), &pan, &colours, &QUARTER)
            .read_all()
            .expect("pixels");
        for row in 0..48 {
            for col in 0..64 {
                // The multispectral image ends at column 48.
                let missing = (col, row) == (20, 20) || (col / 4, row / 4) == (3, 3) || col >= 48;
                for band in 0..2 {
                    let value = whole.at(band, col, row);
                    assert!(
                        if missing { value.is_nan() } else { value == 700.0 },
                        "{col} {row}: {value}"
                    );
                }
            }
        }
    }
}
