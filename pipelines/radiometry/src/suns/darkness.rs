//! Darkness of the cells in each view relative to the views of other dates.

use super::horizon::toward;
use glam::Vec3;
use heliosplat::Raster;
use heliosplat_grid::relief::Relief;
use heliosplat_grid::statistics::{upper_median, upper_quantile};
use heliosplat_stereo::Surface;
use heliosplat_stereo::SweepView;
use rayon::prelude::*;

/// Largest darkness, natural logarithm of brightness: darker ground is no stronger evidence of a shadow.
const MOST: f32 = 1.5;
/// Fewest views of other dates for the brightness of a cell.
const FEWEST_OTHERS: usize = 2;
/// Quantile of the brightness of other dates that is taken as that in the sun: cells wrongly counted as lit are darker.
const LIT_QUANTILE: f64 = 0.75;
/// Half of the window whose mean replaces the other dates where there are none, metres.
const WINDOW_M: f32 = 20.0;

/// Natural logarithms of the brightness of the sampled cells in each view, less the view's median; NaN for cells hidden
/// from the view.
pub(crate) struct Darkness {
    brightness: Vec<Vec<f32>>,
    /// Columns and rows of the sampled cells in windows, for local means.
    places: Vec<(usize, usize)>,
    window_cells: usize,
}

impl Darkness {
    /// Brightness of the sampled `cells` of `surface` in `views`; `relief` hides cells from them.
    pub(crate) fn new(views: &[SweepView], surface: &Surface, relief: &Relief, cells: &[usize]) -> Self {
        let brightness = views
            .par_iter()
            .map(|view| {
                let mut values = seen(view, surface, relief, cells);
                let mut known: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
                let median = upper_median(&mut known).unwrap_or(0.0);
                values.iter_mut().for_each(|v| *v -= median);
                values
            })
            .collect();
        Self {
            brightness,
            places: cells
                .iter()
                .map(|cell| (cell % relief.width, cell / relief.width))
                .collect(),
            window_cells: (2.0 * WINDOW_M / relief.cell_m).ceil().max(1.0) as usize,
        }
    }

    /// Darkness of each sampled cell in the views of a date, natural logarithm of brightness, within ±`MOST`, relative
    /// to the views of other dates that show it lit. `lit` is the mask of each view, `None` where its sun is unknown.
    /// NaN where the cell is hidden, or no other view shows it lit. With fewer than two views of other dates in all,
    /// the darkness is relative to the ground around.
    pub(crate) fn of_date(&self, views: &[SweepView], date: u32, lit: &[Option<Vec<bool>>]) -> Vec<f32> {
        let is_own = |view: usize| views[view].date_group == date;
        let (own, others): (Vec<usize>, Vec<usize>) = (0..views.len()).partition(|&view| is_own(view));
        let mut darker: Vec<f32> = (0..self.places.len())
            .map(|cell| {
                let seen = own
                    .iter()
                    .map(|&view| self.brightness[view][cell])
                    .filter(|v| v.is_finite());
                let (sum, count) = seen.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
                sum / count as f32
            })
            .collect();
        if others.len() < FEWEST_OTHERS {
            self.less_local_mean(&mut darker);
        } else {
            let (mut known, mut unsure) = (Vec::new(), Vec::new());
            for (cell, value) in darker.iter_mut().enumerate() {
                known.clear();
                unsure.clear();
                for &view in others.iter().filter(|&&view| self.brightness[view][cell].is_finite()) {
                    match &lit[view] {
                        Some(lit) if lit[cell] => known.push(self.brightness[view][cell]),
                        Some(_) => {}
                        None => unsure.push(self.brightness[view][cell]),
                    }
                }
                let in_the_sun =
                    upper_quantile(&mut known, LIT_QUANTILE).or_else(|| upper_quantile(&mut unsure, LIT_QUANTILE));
                *value -= in_the_sun.unwrap_or(f32::NAN);
            }
        }
        let mut finite: Vec<f32> = darker.iter().copied().filter(|v| v.is_finite()).collect();
        let middle = upper_median(&mut finite).unwrap_or(0.0);
        darker.iter().map(|v| (middle - v).clamp(-MOST, MOST)).collect()
    }

    /// Subtracts from each value the mean of those in its window of a regular tiling.
    fn less_local_mean(&self, values: &mut [f32]) {
        let tile = |&(col, row): &(usize, usize)| (col / self.window_cells, row / self.window_cells);
        let columns = self.places.iter().map(|p| tile(p).0 + 1).max().unwrap_or(1);
        let rows = self.places.iter().map(|p| tile(p).1 + 1).max().unwrap_or(1);
        let index = |place: &(usize, usize)| tile(place).1 * columns + tile(place).0;
        let mut sums = vec![(0.0f64, 0usize); columns * rows];
        for (place, value) in self.places.iter().zip(values.iter()).filter(|(_, v)| v.is_finite()) {
            let (sum, count) = &mut sums[index(place)];
            *sum += f64::from(*value);
            *count += 1;
        }
        for (place, value) in self.places.iter().zip(values.iter_mut()) {
            let (sum, count) = sums[index(place)];
            *value -= (sum / count.max(1) as f64) as f32;
        }
    }
}

/// Natural logarithm of the brightness of each cell in a view; NaN where it is hidden or outside the image.
fn seen(view: &SweepView, surface: &Surface, relief: &Relief, cells: &[usize]) -> Vec<f32> {
    let middle = surface.point(surface.width / 2, surface.height / 2);
    let (col, row, _) = view.camera.project(middle);
    let camera: Vec3 = -view.camera.ray_direction(col, row);
    let across = camera.truncate().length();
    let azimuth_deg = f64::from(camera.x).atan2(f64::from(camera.y)).to_degrees();
    // A camera straight above sees every cell.
    let rise = (across > 1e-3).then(|| camera.z / across);
    let toward = rise.map(|rise| toward(azimuth_deg, f64::from(rise).atan().to_degrees()));
    cells
        .iter()
        .map(|&cell| {
            let point = surface.point(cell % surface.width, cell / surface.width);
            let hidden = match (&toward, rise) {
                (Some(toward), Some(rise)) => relief.horizon(cell, toward) > rise * 1.001,
                _ => false,
            };
            if hidden {
                return f32::NAN;
            }
            let (col, row, _) = view.camera.project(point);
            let value = bilinear(view.image, col, row);
            if value > 0.0 { value.ln() } else { f32::NAN }
        })
        .collect()
}

/// Mean of the bands at a pixel position, bilinear; NaN outside the image and next to missing pixels.
pub(crate) fn bilinear(image: &Raster, col: f32, row: f32) -> f32 {
    let size = (image.width, image.height);
    let sum: f32 = (0..image.bands)
        .map(|band| heliosplat_grid::bilinear(image.plane(band), size, col, row))
        .sum();
    sum / image.bands as f32
}
