//! Clouds, before anything is modelled: what one view shows brighter, in every band and over metres, than the others show the ground
//! in the sun.
//!
//! The views are laid on a coarse sweep's surface, band by band, and brought to one scale (a robust line to the median of all). What
//! the brightest of the others agree on is the ground in the sun: shadows, leaves that fall and haze do not exceed it, a cloud does.
//! The sweep hardly minds clouds, since it compares views in pairs; what training does to explain them spoils colours and heights.
//!
//! Limits: the shadow of a cloud looks like any other shadow, and snow on one date like a cloud.

use super::grid::Grid;
use super::ortho;
use super::search::Search;
use super::settle;
use super::sweep::SweepRequest;
use super::views::{LevelView, SweepView};
use super::visibility::FirstHits;
use heliosplat::Raster;
use heliosplat_rpc::statistics::upper_median;
use rayon::prelude::*;

/// Fewer views cannot say which of them is right.
pub const FEWEST_VIEWS: usize = 5;
/// Cells of the request per cell of the surface that the views are laid on.
const FACTOR: usize = 2;
/// Half of the window over which a cloud must be brighter, metres.
const WINDOW_M: f32 = 2.25;
/// How much brighter than the ground in the sun, as a share of the mean of it and the view's median: bright roofs differ by more.
const BRIGHTER: f32 = 0.4;
/// What is smaller is no cloud but a car, or a roof that the coarse surface has in the wrong place, square metres.
const LEAST_M2: f32 = 64.0;
/// Soft edges around what is found count too, metres.
const EDGE_M: f32 = 4.0;
/// Of so many views besides, one may be clouded as well where the ground in the sun is asked for.
const VIEWS_PER_CLOUD: usize = 8;
/// Standard deviations beyond which a value has no say in the robust line (Beaton and Tukey 1974: 95 % efficient on a bell curve).
const BIWEIGHT: f64 = 4.7;
/// Standard deviation of a normal distribution in units of its median absolute deviation: `SIGMA_PER_MAD` in two decimals. Masks of
/// clouds depend on it.
const DEVIATION_OF_MEDIAN: f64 = 1.48;
/// Rounds of the robust line.
const ROUNDS: usize = 8;

/// The pixels of each view that show a cloud, `[row][column]`; none with fewer than [`FEWEST_VIEWS`] views. Cameras may be off by some
/// pixels.
pub fn find_clouds(views: &[SweepView], request: &SweepRequest) -> Vec<Vec<bool>> {
    let mut masks: Vec<Vec<bool>> = views.iter().map(|view| vec![false; view.image.plane_len()]).collect();
    let search = Search::new(views, request);
    if views.len() < FEWEST_VIEWS {
        return masks;
    }
    let Some(found) = search.descend(FACTOR, &|_| {}) else {
        return masks;
    };
    let grid = found.grid;
    let altitude = ortho::median(&grid, &found.altitude(), 2);
    let excess = excess(views, &search, &grid, &altitude, 2.0 * found.step_m);
    let radius = |metres: f32| (metres / grid.cell_m).round() as usize;
    let cells = (LEAST_M2 / grid.cell_m.powi(2)).ceil() as usize;
    masks
        .par_iter_mut()
        .zip(views)
        .zip(&excess)
        .for_each(|((mask, view), excess)| {
            let brighter = box_mean(&grid, excess, radius(WINDOW_M));
            let brighter: Vec<f32> = brighter
                .iter()
                .map(|&mean| f32::from(u8::from(mean > BRIGHTER)))
                .collect();
            let small = settle::islands(&grid, &brighter, 0.5, cells);
            for cell in (0..grid.len()).filter(|&cell| brighter[cell] > 0.0 && !small[cell]) {
                paint(view, &grid, cell, altitude[cell], mask);
            }
        });
    masks
}

/// How much brighter each view is at each cell than the ground in the sun, in the band where that is least; NaN where it is not seen or
/// too few others see it.
fn excess(views: &[SweepView], search: &Search, grid: &Grid, altitude: &[f32], tolerance_m: f32) -> Vec<Vec<f32>> {
    let bands = views.iter().map(|view| view.image.bands).min().unwrap_or(0);
    let hits: Vec<FirstHits> = search
        .level_views(FACTOR)
        .iter()
        .map(|level| FirstHits::new(level, grid, altitude, tolerance_m.max(1.0)))
        .collect();
    let mut least = vec![vec![f32::INFINITY; grid.len()]; views.len()];
    for band in 0..bands {
        let orthos: Vec<Vec<f32>> = views
            .iter()
            .zip(&hits)
            .map(|(view, hits)| ortho_of_band(view, band, search, grid, altitude, hits))
            .collect();
        let scaled = on_one_scale(&orthos);
        least.par_iter_mut().enumerate().for_each(|(view, least)| {
            let mut others = Vec::new();
            for (cell, least) in least.iter_mut().enumerate() {
                others.clear();
                let besides = (0..scaled.len()).filter(|&other| other != view);
                others.extend(besides.map(|other| scaled[other][cell]).filter(|v| v.is_finite()));
                let above = in_the_sun(&mut others)
                    .map_or(f32::NAN, |sun| 2.0 * (scaled[view][cell] - sun) / (1.0 + sun.max(0.0)));
                // What is not known in one band stays unknown.
                *least = if least.is_nan() || *least < above {
                    *least
                } else {
                    above
                };
            }
        });
    }
    least
}

/// What most agree is the brightest that the ground gets; `None` where too few tell.
fn in_the_sun(others: &mut [f32]) -> Option<f32> {
    let rank = 1 + others.len() / VIEWS_PER_CLOUD;
    if others.len() + 2 < FEWEST_VIEWS {
        return None;
    }
    let at = others.len() - 1 - rank;
    Some(*others.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// One band of a view on the surface, NaN where it sees something else.
fn ortho_of_band(
    view: &SweepView,
    band: usize,
    search: &Search,
    grid: &Grid,
    altitude: &[f32],
    hits: &FirstHits,
) -> Vec<f32> {
    let plane = Raster {
        width: view.image.width,
        height: view.image.height,
        bands: 1,
        values: view.image.plane(band).to_vec(),
    };
    let of_band = SweepView { image: &plane, ..*view };
    let level = LevelView::new(&of_band, grid.cell_m, search.centre, false);
    let mut values = ortho::ortho(grid, &level, altitude);
    values.par_iter_mut().enumerate().for_each(|(cell, value)| {
        let p = grid.point(
            (cell % grid.width) as isize,
            (cell / grid.width) as isize,
            altitude[cell],
        );
        let (col, row, _) = level.camera.project(p);
        // Outside of the image the value is NaN already.
        if value.is_finite() && hits.hides(row.round() as usize * level.width + col.round() as usize, p.z) {
            *value = f32::NAN;
        }
    });
    values
}

/// The views' values in units of their common median, haze and exposure taken out.
fn on_one_scale(orthos: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let relative: Vec<Vec<f32>> = orthos
        .par_iter()
        .map(|values| {
            let mut known: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
            let unit = upper_median(&mut known).filter(|&m| m > 0.0).unwrap_or(1.0);
            values.iter().map(|v| v / unit).collect()
        })
        .collect();
    let cells = orthos.first().map_or(0, Vec::len);
    let common: Vec<f32> = (0..cells)
        .into_par_iter()
        .map(|cell| {
            let mut known: Vec<f32> = relative.iter().map(|v| v[cell]).filter(|v| v.is_finite()).collect();
            upper_median(&mut known).unwrap_or(f32::NAN)
        })
        .collect();
    relative
        .into_par_iter()
        .map(|values| {
            let (gain, offset) = line(&common, &values);
            values.iter().map(|v| (v - offset) / gain).collect()
        })
        .collect()
}

/// Gain and offset of the line that most of `to` lies on over `from`: least squares, from which what lies far off is left out in
/// rounds (Tukey's biweight).
fn line(from: &[f32], to: &[f32]) -> (f32, f32) {
    let pairs: Vec<(f64, f64)> = from
        .iter()
        .zip(to)
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .map(|(&x, &y)| (f64::from(x), f64::from(y)))
        .collect();
    let (mut gain, mut offset) = (1.0, 0.0);
    for _ in 0..ROUNDS {
        let mut off: Vec<f32> = pairs
            .iter()
            .map(|(x, y)| (y - gain * x - offset).abs() as f32)
            .collect();
        let Some(scale) = upper_median(&mut off).map(|m| BIWEIGHT * DEVIATION_OF_MEDIAN * f64::from(m).max(1e-6))
        else {
            break;
        };
        let [mut n, mut sx, mut sy, mut sxx, mut sxy] = [0.0; 5];
        for (x, y) in &pairs {
            let t = (y - gain * x - offset) / scale;
            let w = (1.0 - t * t).max(0.0).powi(2);
            n += w;
            sx += w * x;
            sy += w * y;
            sxx += w * x * x;
            sxy += w * x * y;
        }
        let spread = n * sxx - sx * sx;
        if spread <= 1e-9 * n * n {
            break;
        }
        gain = ((n * sxy - sx * sy) / spread).clamp(0.2, 5.0);
        offset = (sy - gain * sx) / n;
    }
    (gain as f32, offset as f32)
}

/// Means over square windows of what is known; NaN where less than half of one is.
fn box_mean(grid: &Grid, values: &[f32], radius: usize) -> Vec<f32> {
    let whole = (2 * radius + 1).pow(2);
    (0..grid.len())
        .into_par_iter()
        .with_min_len(grid.width)
        .map(|cell| {
            let known = grid
                .around(cell, radius)
                .map(|near| values[near])
                .filter(|v| v.is_finite());
            let (sum, count) = known.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
            if 2 * count >= whole {
                sum / count as f32
            } else {
                f32::NAN
            }
        })
        .collect()
}

/// Marks the pixels within [`EDGE_M`] of where a view shows a cell.
fn paint(view: &SweepView, grid: &Grid, cell: usize, altitude_m: f32, mask: &mut [bool]) {
    let p = grid.point((cell % grid.width) as isize, (cell / grid.width) as isize, altitude_m);
    let (col, row, _) = view.camera.project(p);
    let reach = EDGE_M / view.ground_sampling_m(p);
    let (width, height) = (view.image.width, view.image.height);
    // `as` saturates: what lies before the image begins at its first pixel.
    let span = |at: f32, size: usize| ((at - reach).round() as usize)..((at + reach).round() as usize + 1).min(size);
    for row in span(row, height) {
        for col in span(col, width) {
            mask[row * width + col] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SweepOptions;
    use glam::{DVec3, Vec3};
    use heliosplat::ProjectiveCamera;

    const SIDE_PX: usize = 128;

    /// Level ground in patches of grey, half a metre to a pixel, under a haze of its own; `seen` changes what is seen at a column and
    /// row.
    fn ground(number: usize, seen: impl Fn(usize, usize, f32) -> f32) -> Raster {
        let mut image = Raster::filled(SIDE_PX, SIDE_PX, 2, 0.0);
        for (i, value) in image.values.iter_mut().enumerate() {
            let (band, pixel) = (i / SIDE_PX.pow(2), i % SIDE_PX.pow(2));
            let (col, row) = (pixel % SIDE_PX, pixel / SIDE_PX);
            let patch = ((col / 3) * 7919 + (row / 3) * 104_729 + band * 31) % 101;
            let bright = seen(col, row, 0.2 + 0.2 * patch as f32 / 101.0);
            *value = (1.0 + 0.1 * number as f32) * bright + 0.02 * number as f32;
        }
        image
    }

    /// An image seen along its own slant, so that altitudes can be told.
    fn view(number: usize, image: &Raster) -> SweepView<'_> {
        let (middle, lean) = (SIDE_PX as f64 / 2.0 - 0.5, 0.3 * (number as f64 - 2.0));
        let camera = ProjectiveCamera::new(
            [2.0, 0.0, lean, middle],
            [0.0, -2.0, 0.0, middle],
            [0.0; 3],
            (SIDE_PX, SIDE_PX),
            -DVec3::Z,
        );
        SweepView {
            camera,
            image,
            index: None,
            date_group: number as u32,
            sun: Vec3::new(0.5, 0.0, 0.8).normalize(),
        }
    }

    fn request() -> SweepRequest {
        SweepRequest {
            west_m: -30.0,
            south_m: -30.0,
            east_m: 30.0,
            north_m: 30.0,
            cell_m: 0.5,
            altitude_min_m: -5.0,
            altitude_max_m: 15.0,
            options: SweepOptions::default(),
        }
    }

    fn disc(col: usize, row: usize) -> bool {
        col.abs_diff(60).pow(2) + row.abs_diff(70).pow(2) < 20 * 20
    }

    /// Five images: a shadow falls in the second, a cloud lies over the fourth, a white car stands in the fifth.
    fn five() -> Vec<Raster> {
        (0..5)
            .map(|number| {
                ground(number, |col, row, bright| match number {
                    1 if disc(col, row) => 0.3 * bright,
                    3 if disc(col, row) => 0.2 * bright + 0.6,
                    4 if (20..24).contains(&col) && (30..40).contains(&row) => 0.8,
                    _ => bright,
                })
            })
            .collect()
    }

    #[test]
    fn a_cloud_is_found_with_its_edge_and_neither_a_shadow_nor_a_car_is_one() {
        let images = five();
        let views: Vec<SweepView> = images.iter().enumerate().map(|(n, image)| view(n, image)).collect();
        let masks = find_clouds(&views, &request());
        let count = |mask: &[bool]| mask.iter().filter(|&&m| m).count();
        assert_eq!([0, 1, 2, 4].map(|n| count(&masks[n])), [0; 4]);
        let found = |col: usize, row: usize| masks[3][row * SIDE_PX + col];
        assert!((0..SIDE_PX.pow(2)).all(|i| !disc(i % SIDE_PX, i / SIDE_PX) || found(i % SIDE_PX, i / SIDE_PX)));
        assert!(!found(60, 110) && !found(110, 70), "far from the cloud");
    }

    #[test]
    fn four_views_do_not_say_which_of_them_is_right() {
        let images = five();
        let views: Vec<SweepView> = (1..5).map(|n| view(n, &images[n])).collect();
        assert!(find_clouds(&views, &request()).iter().flatten().all(|cloud| !cloud));
    }

    #[test]
    fn the_line_through_most_values_leaves_out_what_lies_far_off() {
        let from: Vec<f32> = (0..200).map(|i| i as f32 / 100.0).collect();
        let to: Vec<f32> = (0..200)
            .map(|i| if i % 5 == 0 { 9.0 } else { 1.3 * from[i] + 0.2 })
            .collect();
        let (gain, offset) = line(&from, &to);
        assert!(
            (gain - 1.3).abs() < 1e-3 && (offset - 0.2).abs() < 1e-3,
            "{gain} {offset}"
        );
    }
}
