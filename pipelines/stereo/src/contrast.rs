//! The contrast of an image: the median absolute difference between neighbouring pixels, of all of it and around each
//! pixel.
//!
//! Contrast differs within an image by far more than between images: shade has a fraction of that of sunlit ground, sea
//! and snow have next to none. So differences are measured in units of the contrast around them. Pairs of equal pixels
//! do not count, because images of few grey levels (8-bit, compressed, enlarged) are full of them and would have no
//! contrast at all.

use heliosplat::Raster;
use heliosplat_grid::statistics::{upper_median, upper_quantile};
use rayon::prelude::*;

/// Distance between the middles of two tiles, pixels.
const STEP: usize = 16;
/// Half the side of a tile, pixels: neighbouring tiles overlap by half.
const HALF: usize = 16;
/// Tiles on each side of a tile that determine its contrast: 9 × 9 tiles are some 140 pixels across.
const REACH: usize = 4;
/// Quantile of the contrast of the surrounding tiles that a tile takes. Shade has a fraction of the contrast of the
/// ground next to it, and an edge in shade must not pass for the edge of a shadow because it exceeds its surroundings.
const BRIGHTER: f64 = 0.75;
/// Fewest differences for a contrast of the tile's own.
const FEWEST: usize = 64;

/// Median absolute difference between unequal neighbours along rows, in the image's units; 0 where there are none.
pub(super) fn whole(image: &Raster) -> f32 {
    let pairs = image.values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mut differences: Vec<f32> = pairs.filter(|d| counts(*d)).collect();
    upper_median(&mut differences).unwrap_or(0.0)
}

/// Contrast around each pixel, `[row][column]`, in the image's units: the upper quartile of the tiles around,
/// interpolated between the centres of tiles. Tiles with few differences have the contrast of the whole image.
pub(super) fn local(image: &Raster) -> Vec<f32> {
    let tiles = Tiles::new(image);
    (0..image.values.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|i| tiles.at(i % image.width, i / image.width))
        .collect()
}

fn counts(difference: f32) -> bool {
    difference > 0.0 && difference.is_finite()
}

/// The contrast of overlapping tiles, in rows.
struct Tiles {
    columns: usize,
    rows: usize,
    contrast: Vec<f32>,
}

impl Tiles {
    fn new(image: &Raster) -> Self {
        let [columns, rows] = [image.width, image.height].map(|side| side.div_ceil(STEP).max(1));
        let of_all = whole(image);
        let one = |tile: usize| {
            let [col, row] = [tile % columns, tile / columns].map(|place| place * STEP + STEP / 2);
            let columns = col.saturating_sub(HALF)..(col + HALF).min(image.width);
            let mut differences = Vec::with_capacity(4 * HALF * HALF);
            for r in row.saturating_sub(HALF)..(row + HALF).min(image.height) {
                let line = &image.values[r * image.width..][columns.clone()];
                let pairs = line.windows(2).map(|pair| (pair[1] - pair[0]).abs());
                differences.extend(pairs.filter(|d| counts(*d)));
            }
            if differences.len() < FEWEST {
                return of_all;
            }
            upper_median(&mut differences).unwrap_or(of_all)
        };
        let own: Vec<f32> = (0..columns * rows).into_par_iter().map(one).collect();
        let around = |tile: usize| {
            let near = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
            let rows = near(tile / columns, rows);
            let window = rows.flat_map(|row| own[row * columns..][near(tile % columns, columns)].iter().copied());
            upper_quantile(&mut window.collect::<Vec<f32>>(), BRIGHTER).unwrap_or(of_all)
        };
        Self {
            columns,
            rows,
            contrast: (0..columns * rows).into_par_iter().map(around).collect(),
        }
    }

    /// Bilinear between the middles of tiles, constant beyond the outermost.
    fn at(&self, col: usize, row: usize) -> f32 {
        let place = |pixel: usize, tiles: usize| {
            let at = ((pixel as f32 - (STEP / 2) as f32) / STEP as f32).clamp(0.0, (tiles - 1) as f32);
            let first = at as usize;
            (first, (first + 1).min(tiles - 1), at - first as f32)
        };
        let ((c0, c1, fc), (r0, r1, fr)) = (place(col, self.columns), place(row, self.rows));
        let at = |c: usize, r: usize| self.contrast[r * self.columns + c];
        let top = at(c0, r0) + (at(c1, r0) - at(c0, r0)) * fc;
        let bottom = at(c0, r1) + (at(c1, r1) - at(c0, r1)) * fc;
        top + (bottom - top) * fr
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 320;

    /// Noise of a contrast of its own west and east of the middle.
    fn image(west: f32, east: f32) -> Raster {
        let mut image = Raster::filled(SIDE, SIDE, 1, 0.0);
        for (i, value) in image.values.iter_mut().enumerate() {
            let noise = ((i * 7919) % 101) as f32 / 101.0;
            *value = noise * if i % SIDE < SIDE / 2 { west } else { east };
        }
        image
    }

    #[test]
    fn what_lies_far_away_in_the_image_does_not_change_the_contrast_here() {
        let (land, coast) = (local(&image(1.0, 1.0)), local(&image(1.0, 0.001)));
        for row in 0..SIDE {
            let i = row * SIDE + 40;
            assert_eq!(land[i], coast[i]);
        }
        let at = |col: usize| coast[SIDE / 2 * SIDE + col];
        assert!(at(SIDE - 20) < 0.01 * at(40));
        // Shade next to sunlit ground gets the contrast of that ground.
        assert!(at(SIDE / 2 + 4) > 0.9 * at(40));
    }

    #[test]
    fn equal_neighbours_do_not_hide_the_contrast_of_the_others() {
        let mut image = image(1.0, 1.0);
        let sharp = whole(&image);
        // Every second pixel is that before it, as in an enlarged image.
        for i in (1..image.values.len()).step_by(2) {
            image.values[i] = image.values[i - 1];
        }
        assert!(whole(&image) > 0.25 * sharp);
        assert_eq!(whole(&Raster::filled(9, 9, 1, 3.0)), 0.0);
    }
}
