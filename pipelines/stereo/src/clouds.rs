//! Clouds: pixels of one view that are brighter than the ground in the sun, in every band and over metres.
//!
//! The views are orthorectified on the surface of a coarse search, band by band, and brought to one scale
//! (`brightness`). The brightest of the other views give the sunlit ground: shadows, fallen leaves and haze are darker,
//! a cloud is brighter. The plane sweep needs no such masks, since it compares views in pairs; but a model trained on
//! clouded pixels has wrong colours and heights there.
//!
//! Limits: the shadow of a cloud looks like any other shadow, and snow on one date like a cloud. The thresholds were
//! chosen on synthetic clouds of 15 to 60 m over cells of half a metre.

mod brightness;

use super::evidence::{LevelSurface, is_match};
use super::ortho::{self, box_mean};
use super::postprocess;
use super::pyramid::Search;
use super::request::PlaneSweepRequest;
use super::views::SweepView;
use heliosplat_grid::Grid;
use rayon::prelude::*;

/// Least number of views for the search: with fewer, the outlier cannot be identified.
pub const FEWEST_VIEWS: usize = 5;
/// Cells of the request per cell of the surface for orthorectification: clouds need no more detail.
const FACTOR: usize = 2;
/// Radius of the median filter of that surface, cells.
const MEDIAN_RADIUS: usize = 2;
/// Half of the window over which a cloud must be brighter, metres: wider than a car.
const WINDOW_M: f32 = 2.25;
/// Least excess brightness of a cloud over the sunlit ground, relative to the mean of that ground and the view's
/// median; bright roofs differ by less.
const BRIGHTER: f32 = 0.4;
/// Least area of a cloud, square metres: smaller patches are cars, or roofs displaced on the coarse surface.
const LEAST_M2: f32 = 64.0;
/// Margin around a cloud, metres: its soft edge is masked too.
const EDGE_M: f32 = 4.0;
/// A point counts as hidden when it is this many height steps below the surface first seen by its view.
const HIDDEN_STEPS: f32 = 2.0;

/// Cloud mask of each view, `[row][column]` of its image, true for a cloud; all false with fewer than [`FEWEST_VIEWS`]
/// views. Cameras may be off by some pixels.
pub fn find_clouds(views: &[SweepView], request: &PlaneSweepRequest) -> Vec<Vec<bool>> {
    let mut masks: Vec<Vec<bool>> = views.iter().map(|view| vec![false; view.image.plane_len()]).collect();
    let search = Search::new(views, request);
    if views.len() < FEWEST_VIEWS {
        return masks;
    }
    let Some(found) = search.descend(FACTOR, &|_| {}) else {
        return masks;
    };
    let grid = found.grid;
    let altitude = ortho::median(&grid, &found.altitude(), MEDIAN_RADIUS);
    let mut excess = brightness::excess(views, &search, &grid, &altitude, HIDDEN_STEPS * found.step_m);
    // Glitter on water exceeds the other views like a cloud, so cells without a match are excluded.
    let judged = LevelSurface {
        search: &search,
        factor: FACTOR,
        grid,
        altitude_m: &altitude,
        tolerance_m: HIDDEN_STEPS * found.step_m,
    };
    let evidence = judged.evidence().around.into_iter();
    let matched: Vec<bool> = evidence
        .map(|evidence| is_match(evidence, views.len() as f32))
        .collect();
    for cell in (0..grid.len()).filter(|&cell| !matched[cell]) {
        excess.iter_mut().for_each(|view| view[cell] = f32::NAN);
    }
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
            // The mask is 0 or 1: any step between the two separates patches.
            let small = postprocess::speckles(&grid, &brighter, 0.5, cells);
            for cell in (0..grid.len()).filter(|&cell| brighter[cell] > 0.0 && !small[cell]) {
                paint(view, &grid, cell, altitude[cell], mask);
            }
        });
    masks
}

/// Marks the pixels within [`EDGE_M`] of where a view shows a cell.
fn paint(view: &SweepView, grid: &Grid, cell: usize, altitude_m: f32, mask: &mut [bool]) {
    let p = grid.point((cell % grid.width) as isize, (cell / grid.width) as isize, altitude_m);
    let (col, row, _) = view.camera.project(p);
    let reach = EDGE_M / view.geometry().ground_sampling_m(p);
    let (width, height) = (view.image.width, view.image.height);
    // `as` saturates: a range that begins before the image is cut at its first pixel.
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
    use crate::{MatchingFacts, MatchingParameters, SearchVolume};
    use glam::{DVec3, Vec3};
    use heliosplat::{ProjectiveCamera, Raster};

    const SIDE_PX: usize = 128;

    /// Level ground in patches of grey, half a metre to a pixel, with its own haze; `seen` changes the value at a
    /// column and row.
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

    /// An image with its own viewing angle, so that altitudes can be matched.
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
            sun: Some(Vec3::new(0.5, 0.0, 0.8).normalize()),
        }
    }

    fn request(views: &[SweepView]) -> PlaneSweepRequest {
        let volume = SearchVolume {
            west_m: -30.0,
            south_m: -30.0,
            east_m: 30.0,
            north_m: 30.0,
            cell_m: 0.5,
            altitude_min_m: -5.0,
            altitude_max_m: 15.0,
        };
        let geometries: Vec<_> = views.iter().map(SweepView::geometry).collect();
        let facts = MatchingFacts::new(&geometries, &volume, false);
        PlaneSweepRequest {
            volume,
            centre: volume.centre(),
            parameters: MatchingParameters::choose(&facts),
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
        let masks = find_clouds(&views, &request(&views));
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
        assert!(
            find_clouds(&views, &request(&views))
                .iter()
                .flatten()
                .all(|cloud| !cloud)
        );
    }
}
