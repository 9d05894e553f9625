//! Errors of the ground by its distance to the nearest wall of the truth: surface models err most near walls, which the
//! overall error hides.
//!
//! A wall is a side of a building's cell at which the true surface drops by `WALL_FROM_M` or more to something that is
//! no building. Without classes the ground is unknown, and there is no result.

use super::metrics::{HeightErrors, statistics};
use heliosplat::Raster;

/// Drop of the true surface from which on the side of a building is a wall, metres.
const WALL_FROM_M: f32 = 2.0;
/// Upper ends of the bands of distance, metres; the last one has no end.
const ENDS_M: [f64; 2] = [1.5, 4.0];

/// LAS classes of the ground: ground and roads.
const GROUND: [f32; 2] = [2.0, 11.0];
/// LAS class of buildings.
const BUILDING: f32 = 6.0;

/// Errors of the ground at some distance from walls.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EdgeErrors {
    /// Least distance to the nearest wall, metres.
    pub from_m: f64,
    /// Distance where the band ends, metres; absent for the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_m: Option<f64>,
    /// Statistics of the errors in the band.
    #[serde(flatten)]
    pub errors: HeightErrors,
    /// Mean error with its sign, metres: above zero where the ground is too high.
    pub mean_m: f64,
    /// Share of the sum of all absolute errors of the surface, ground or not, 0..1.
    pub share_of_error: f64,
}

/// The ground's errors in bands of distance, nearest first; empty bands are left out. Without `classes` there are no
/// bands. `gsd_m` is the width of a cell, metres.
pub(super) fn edges(
    errors: &Raster,
    wanted: &[bool],
    truth: &Raster,
    classes: Option<&Raster>,
    gsd_m: f64,
) -> Vec<EdgeErrors> {
    let Some(classes) = classes else { return Vec::new() };
    let distance_m = distances(truth, classes, gsd_m, ENDS_M[ENDS_M.len() - 1]);
    let measured = |cell: &usize| wanted[*cell] && errors.values[*cell].is_finite();
    let absolute = |cell: usize| f64::from(errors.values[cell].abs());
    let all: f64 = (0..wanted.len()).filter(measured).map(absolute).sum();
    let starts = std::iter::once(0.0).chain(ENDS_M);
    let ends = ENDS_M.into_iter().map(Some).chain([None]);
    let band = |(from_m, to_m): (f64, Option<f64>)| {
        let is_ground = |cell: &usize| wanted[*cell] && GROUND.contains(&classes.values[*cell]);
        let is_near = |cell: &usize| distance_m[*cell] >= from_m && to_m.is_none_or(|to_m| distance_m[*cell] < to_m);
        let cells: Vec<usize> = (0..wanted.len()).filter(is_ground).filter(is_near).collect();
        let statistics = statistics(cells.iter().map(|&cell| errors.values[cell]))?;
        let measured: Vec<usize> = cells.into_iter().filter(measured).collect();
        let sum: f64 = measured.iter().map(|&cell| f64::from(errors.values[cell])).sum();
        Some(EdgeErrors {
            from_m,
            to_m,
            errors: statistics,
            mean_m: sum / measured.len() as f64,
            share_of_error: measured.iter().map(|&cell| absolute(cell)).sum::<f64>() / all.max(f64::MIN_POSITIVE),
        })
    };
    starts.zip(ends).filter_map(band).collect()
}

/// Distance of the centre of each cell to the nearest wall, metres; infinite beyond `reach_m`.
fn distances(truth: &Raster, classes: &Raster, gsd_m: f64, reach_m: f64) -> Vec<f64> {
    let (width, height) = (truth.width, truth.height);
    let mut distance_m = vec![f64::INFINITY; width * height];
    let reach = (reach_m / gsd_m).ceil() as usize + 1;
    for (row, col) in (0..height).flat_map(|row| (0..width).map(move |col| (row, col))) {
        if !is_wall(truth, classes, col, row) {
            continue;
        }
        // Walls are few, so each marks its surroundings.
        for r in row.saturating_sub(reach)..(row + reach + 1).min(height) {
            for c in col.saturating_sub(reach)..(col + reach + 1).min(width) {
                // The wall is the side of the cell, half a cell before its centre.
                let [across, down] = [c.abs_diff(col), r.abs_diff(row)].map(|cells| (cells as f64 - 0.5).max(0.0));
                let away_m = across.hypot(down) * gsd_m;
                let nearest = &mut distance_m[r * width + c];
                *nearest = nearest.min(away_m);
            }
        }
    }
    distance_m
}

fn is_wall(truth: &Raster, classes: &Raster, col: usize, row: usize) -> bool {
    let (width, height) = (truth.width, truth.height);
    let here = row * width + col;
    let beside = [
        (col > 0).then(|| here - 1),
        (col + 1 < width).then(|| here + 1),
        (row > 0).then(|| here - width),
        (row + 1 < height).then(|| here + width),
    ];
    let falls =
        |there: usize| classes.values[there] != BUILDING && truth.values[here] - truth.values[there] >= WALL_FROM_M;
    classes.values[here] == BUILDING && beside.into_iter().flatten().any(falls)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_is_told_apart_by_its_distance_to_walls_and_roofs_do_not_count() {
        // A house in the west, 8 m high, and a kerb in the east that is no wall; cells of half a metre.
        let (width, height) = (40, 3);
        let mut truth = Raster::filled(width, height, 1, 0.0);
        let mut classes = Raster::filled(width, height, 1, 2.0);
        let mut errors = Raster::filled(width, height, 1, 0.0);
        for row in 0..height {
            for col in 0..width {
                let cell = row * width + col;
                match col {
                    0..4 => (truth.values[cell], classes.values[cell], errors.values[cell]) = (8.0, BUILDING, -1.0),
                    4..7 => errors.values[cell] = 4.0,
                    7..12 => errors.values[cell] = -1.0,
                    39 => (truth.values[cell], classes.values[cell]) = (0.3, BUILDING),
                    _ => {}
                }
            }
        }
        errors.values[4] = f32::NAN;
        let wanted = vec![true; width * height];
        let bands = edges(&errors, &wanted, &truth, Some(&classes), 0.5);
        let means: Vec<f64> = bands.iter().map(|band| band.mean_m).collect();
        assert_eq!(means, [4.0, -1.0, 0.0]);
        assert!((bands[0].errors.completeness - 8.0 / 9.0).abs() < 1e-9);
        let all = 8.0 * 4.0 + 15.0 + 12.0;
        assert!((bands[0].share_of_error - 32.0 / all).abs() < 1e-9);
        assert_eq!((bands[2].from_m, bands[2].to_m), (4.0, None));
        assert!(edges(&errors, &wanted, &truth, None, 0.5).is_empty());
    }
}
