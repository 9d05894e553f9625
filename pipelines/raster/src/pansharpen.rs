//! A panchromatic and a multispectral image of one acquisition read as one.
//!
//! Images in sensor geometry have no map coordinates. The relation between their pixels is a scale and an offset along
//! columns and rows, which the caller derives from their cameras.

use super::file::{Composite, RasterFile};
use super::{Result, Window};
use heliosplat::Raster;
use rayon::prelude::*;

/// Position of the pixels of one image in another, along columns and along rows: `other = scale · own + offset`, pixel
/// centres at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRelation {
    /// Pixels of the other image per pixel.
    pub scale: [f64; 2],
    /// Column and row in the other image of the centre of the first pixel.
    pub offset: [f64; 2],
}

impl RasterFile {
    /// A panchromatic image together with the multispectral one of the same acquisition: bands and their order are
    /// those of `multispectral`, size and metadata those of `panchromatic`. `relation` maps pixels of the panchromatic
    /// image to those of the multispectral one. The multispectral image is resampled by cubic convolution; each of its
    /// bands is then multiplied by the ratio of the panchromatic image to the mean of all bands (Brovey transform, A.
    /// R. Gillespie et al., "Color enhancement of highly correlated images II", Remote Sensing of Environment 22,
    /// 1987), which leaves ratios between bands as they are.
    #[must_use]
    pub fn pansharpened(panchromatic: Self, multispectral: Self, relation: &GridRelation) -> Self {
        let mut files = panchromatic.files().chain(multispectral.files()).cloned();
        let path = files.next().unwrap_or_default();
        let (others, size, bands) = (files.collect(), panchromatic.size(), multispectral.bands.clone());
        let pair = Pansharpening {
            panchromatic,
            multispectral,
            relation: *relation,
        };
        Self::composed(path, others, size, bands, pair)
    }
}

/// A panchromatic image and the multispectral one of its colours.
struct Pansharpening {
    /// Image that gives size, metadata and detail.
    panchromatic: RasterFile,
    /// Image that gives bands and their ratios.
    multispectral: RasterFile,
    relation: GridRelation,
}

impl Composite for Pansharpening {
    fn first(&self) -> &RasterFile {
        &self.panchromatic
    }

    fn set_opacity(&mut self, band: Option<usize>) {
        self.multispectral.set_opacity(band);
    }

    /// `NaN` where either image has none.
    fn read(&self, window: Window, bands: &[usize]) -> Result<Vec<f32>> {
        let pan = self.panchromatic.read(window, &[0])?;
        let size = self.multispectral.size();
        let across = Taps::along(self.relation, 0, window.col0..window.col0 + window.width, size.0);
        let down = Taps::along(self.relation, 1, window.row0..window.row0 + window.height, size.1);
        let all: Vec<usize> = (0..self.multispectral.bands.len()).collect();
        let part = Window::new((across.first, down.first), (across.count, down.count));
        let colours = self.multispectral.read(part, &all)?;
        let mut resampled = resample(&colours, &across, &down);
        let plane = pan.plane_len();
        for (pixel, pan) in pan.values.iter().enumerate() {
            let sum: f32 = all.iter().map(|band| resampled[band * plane + pixel]).sum();
            let mean = sum / all.len() as f32;
            let ratio = if mean == 0.0 { 0.0 } else { pan / mean };
            all.iter().for_each(|band| resampled[band * plane + pixel] *= ratio);
        }
        let plane_of = |band: &usize| &resampled[band * plane..][..plane];
        Ok(bands.iter().flat_map(plane_of).copied().collect())
    }
}

/// Source pixels and weights along one axis of another image.
struct Taps {
    /// First pixel of the other image that is read, and their number.
    first: usize,
    count: usize,
    /// For each pixel the first of its four neighbours, counted from `first`, and their weights.
    neighbours: Vec<(isize, [f32; 4])>,
}

impl Taps {
    fn along(relation: GridRelation, axis: usize, pixels: std::ops::Range<usize>, size: usize) -> Self {
        let place = |pixel: usize| relation.scale[axis] * pixel as f64 + relation.offset[axis];
        let within = |at: f64| at.clamp(0.0, size as f64) as usize;
        let ends = [place(pixels.start), place(pixels.end.saturating_sub(1))];
        let first = within(ends[0].min(ends[1]).floor() - 1.0);
        let count = within(ends[0].max(ends[1]).floor() + 3.0).saturating_sub(first);
        let neighbours = pixels.map(|pixel| {
            let at = place(pixel);
            let before = at.floor();
            (before as isize - 1 - first as isize, cubic((at - before) as f32))
        });
        Self {
            first,
            count,
            neighbours: neighbours.collect(),
        }
    }
}

/// Weights of the four neighbours of a position `t` (0..1) after the second: cubic convolution with a = -1/2 (R. Keys,
/// "Cubic convolution interpolation for digital image processing", IEEE Trans. ASSP 29, 1981).
fn cubic(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        -0.5 * t3 + t2 - 0.5 * t,
        1.5 * t3 - 2.5 * t2 + 1.0,
        -1.5 * t3 + 2.0 * t2 + 0.5 * t,
        0.5 * t3 - 0.5 * t2,
    ]
}

/// Weighted mean of the known ones of four neighbours; `NaN` where the nearest is unknown.
fn interpolate(weights: [f32; 4], neighbour: impl Fn(usize) -> f32) -> f32 {
    let values: [f32; 4] = std::array::from_fn(neighbour);
    if values[if weights[1] >= weights[2] { 1 } else { 2 }].is_nan() {
        return f32::NAN;
    }
    let known = weights.iter().zip(values).filter(|(_, value)| !value.is_nan());
    let add = |(sum, total), (weight, value)| (sum + weight * value, total + weight);
    let (sum, total) = known.fold((0.0, 0.0), add);
    sum / total
}

/// All bands of an image on another grid, one after the other: along rows first, then along columns.
fn resample(image: &Raster, across: &Taps, down: &Taps) -> Vec<f32> {
    let (width, height) = (across.neighbours.len(), down.neighbours.len());
    let mut values = vec![0.0; width * height * image.bands];
    if values.is_empty() {
        return values;
    }
    for (band, out) in values.chunks_exact_mut(width * height).enumerate() {
        let mut rows = vec![f32::NAN; width * image.height];
        let source = image.plane(band).par_chunks(image.width.max(1));
        rows.par_chunks_mut(width).zip(source).for_each(|(out, row)| {
            for (value, &(first, weights)) in out.iter_mut().zip(&across.neighbours) {
                let at = |k: usize| usize::try_from(first + k as isize).ok().and_then(|col| row.get(col));
                *value = interpolate(weights, |k| at(k).copied().unwrap_or(f32::NAN));
            }
        });
        let lines = out.par_chunks_mut(width).zip(&down.neighbours);
        lines.for_each(|(out, &(first, weights))| {
            for (col, value) in out.iter_mut().enumerate() {
                let at = |k: usize| rows.get(usize::try_from(first + k as isize).ok()? * width + col);
                *value = interpolate(weights, |k| at(k).copied().unwrap_or(f32::NAN));
            }
        });
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImageSpec, SampleType, write_geotiff};
    use std::path::Path;

    /// A pan image of 64 x 48 pixels of 100 to 227, and colours of a quarter of its size whose first band is the pan
    /// image's mean and whose second is twice that.
    fn pair(folder: &Path) -> [std::path::PathBuf; 2] {
        let (width, height) = (64, 48);
        let mut pan = Raster::filled(width, height, 1, 0.0);
        for (index, value) in pan.values.iter_mut().enumerate() {
            *value = 100.0 + 2.0 * (index % width) as f32;
        }
        let mut colours = Raster::filled(16, 12, 2, 0.0);
        for row in 0..12 {
            for col in 0..16 {
                let mean = 103.0 + 8.0 * col as f32;
                colours.values[row * 16 + col] = mean;
                colours.values[(12 + row) * 16 + col] = 2.0 * mean;
            }
        }
        let paths = ["pan & more.tif", "colours.tif"].map(|name| folder.join(name));
        for (path, raster) in paths.iter().zip([&pan, &colours]) {
            write_geotiff(path, &ImageSpec::plain(raster), SampleType::U16).expect("written");
        }
        paths
    }

    fn open_pair(pan: &Path, colours: &Path) -> Result<RasterFile> {
        Ok(RasterFile::pansharpened(
            RasterFile::open(pan)?,
            RasterFile::open(colours)?,
            &QUARTER,
        ))
    }

    const QUARTER: GridRelation = GridRelation {
        scale: [0.25; 2],
        // Four pixels share the centre of one.
        offset: [-0.375; 2],
    };

    #[test]
    fn detail_is_that_of_the_pan_image_and_ratios_are_those_of_the_colours() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let [pan, colours] = pair(folder.path());
        let file = open_pair(&pan, &colours).expect("one image");
        assert_eq!(
            (file.size(), file.bands.len(), file.path()),
            ((64, 48), 2, pan.as_path())
        );
        let whole = file.read_all().expect("pixels");
        for col in 8..56 {
            let [first, second] = [0, 1].map(|band| whole.at(band, col, 20));
            let truth = 100.0 + 2.0 * col as f32;
            // The mean of both bands is the pan image.
            assert!(
                (0.5 * (first + second) - truth).abs() <= 1e-2,
                "{col}: {first} {second}"
            );
            assert!((second / first - 2.0).abs() < 0.02, "{col}: {first} {second}");
        }
        let window = Window {
            col0: 20,
            row0: 10,
            width: 24,
            height: 16,
        };
        let part = file.read(window, &[1]).expect("pixels");
        for row in 0..16 {
            for col in 0..24 {
                assert_eq!(part.at(0, col, row), whole.at(1, col + 20, row + 10), "{col} {row}");
            }
        }
    }
}
