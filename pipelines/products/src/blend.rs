//! Surface models of overlapping tiles, blended into one.
//!
//! In an overlap the weight of every tile is `1 / (σ² + σ₀²)` times a taper that falls from its core to its edge, so
//! that no tile begins or ends with a step. An unknown σ counts as two cells. Altitudes more than two cells apart
//! belong to two surfaces, such as a roof and the ground beside it: the tile with the largest weight counts there
//! alone, since the mean would be a surface that does not exist.

use heliosplat::Raster;
use rayon::prelude::*;

/// Standard deviation that is added to every tile's own, cells: the least uncertainty of a cell.
const LEAST_SIGMA_CELLS: f32 = 0.25;
/// Altitudes further apart than this many cells are two surfaces.
const ONE_SURFACE_CELLS: f32 = 2.0;
/// Number of bands of a surface model: altitude, standard deviation, coverage, views.
pub const BANDS: usize = 4;

/// A tile's surface model on the mosaic's grid.
pub struct Piece {
    /// Name of the tile.
    pub unit: String,
    /// Bands of the surface model, or of a window of it: altitude, standard deviation, coverage, views.
    pub raster: Raster,
    /// Column and row of the mosaic at which the raster begins.
    pub at: [isize; 2],
    /// Core of the tile, columns and rows of the mosaic: first and one past the last of each.
    pub core: [[isize; 2]; 2],
    /// Bounds of the whole tile, columns and rows of the mosaic: first and one past the last of each.
    pub bounds: [[isize; 2]; 2],
}

impl Piece {
    /// Value of a band at a cell of the mosaic; NaN outside the piece.
    pub fn value(&self, band: usize, col: isize, row: isize) -> f32 {
        self.value_of(&self.raster, band, col, row)
    }

    /// Value of a band of another raster on the grid of the piece, at a cell of the mosaic; NaN outside the piece.
    pub fn value_of(&self, raster: &Raster, band: usize, col: isize, row: isize) -> f32 {
        let [columns, rows] = self.bounds;
        let inside = col >= columns[0] && col < columns[1] && row >= rows[0] && row < rows[1];
        let (c, r) = (col - self.at[0], row - self.at[1]);
        let there = c >= 0 && r >= 0 && c < raster.width as isize && r < raster.height as isize;
        match inside && there {
            true => raster.at(band, c as usize, r as usize),
            false => f32::NAN,
        }
    }

    /// Weight of a cell by its position: 1 in the core, 0 at the edge, one half on the line between two cores.
    fn taper(&self, col: isize, row: isize) -> f32 {
        let along = |axis: usize, at: isize| {
            let ([first, end], [core_first, core_end]) = (self.bounds[axis], self.core[axis]);
            // At the rim of the mosaic there is no neighbour to give way to.
            let rise = |shared: isize, inside: isize| {
                if shared == 0 {
                    return 1.0;
                }
                let t = ((inside as f32 + 0.5) / (2 * shared) as f32).clamp(0.0, 1.0);
                t * t * (3.0 - 2.0 * t)
            };
            rise(core_first - first, at - first) * rise(end - core_end, end - 1 - at)
        };
        along(0, col) * along(1, row)
    }
}

/// Blended surface model of all pieces on the mosaic's grid of `(width, height)` cells of `gsd_m` metres; NaN in cells
/// that no piece covers.
pub fn blend(pieces: &[Piece], (width, height): (usize, usize), gsd_m: f32) -> Raster {
    let of_row = |row: isize| {
        let here = in_row(pieces, row);
        let mut said = Vec::with_capacity(4);
        let cell = move |col: isize| {
            one_surface(&mut said, (pieces, &here), (col, row), gsd_m);
            together(&said)
        };
        (0..width as isize).map(cell)
    };
    let cells: Vec<[f32; BANDS]> = (0..height as isize).into_par_iter().flat_map_iter(of_row).collect();
    let mut raster = Raster::filled(width, height, BANDS, f32::NAN);
    for band in 0..BANDS {
        let values = raster.plane_mut(band).iter_mut().zip(&cells);
        values.for_each(|(value, cell)| *value = cell[band]);
    }
    raster
}

/// Values of a cell in one tile, with their weight.
#[derive(Debug, Clone, Copy)]
pub struct CellValue {
    /// Index of the tile among the pieces.
    pub piece: usize,
    /// Altitude, standard deviation, coverage, views.
    values: [f32; BANDS],
    /// Blending weight: taper over variance, 1/m².
    pub weight: f32,
}

fn cell_value(index: usize, piece: &Piece, col: isize, row: isize, gsd_m: f32) -> Option<CellValue> {
    let [altitude, sigma, coverage, views] = [0, 1, 2, 3].map(|band| piece.value(band, col, row));
    // Within this distance altitudes count as one surface: the deviation of a cell without one.
    let taken = Some(sigma).filter(|sigma| sigma.is_finite());
    let taken = taken.unwrap_or(ONE_SURFACE_CELLS * gsd_m);
    let least = LEAST_SIGMA_CELLS * gsd_m;
    let weight = piece.taper(col, row) / (taken * taken + least * least);
    let known = altitude.is_finite() && weight > 0.0;
    known.then_some(CellValue {
        piece: index,
        values: [altitude, sigma, coverage, views],
        weight,
    })
}

/// Indices of the pieces whose bounds contain a row of the mosaic.
pub fn in_row(pieces: &[Piece], row: isize) -> Vec<usize> {
    let shows = |piece: &Piece| (piece.bounds[1][0]..piece.bounds[1][1]).contains(&row);
    (0..pieces.len()).filter(|&i| shows(&pieces[i])).collect()
}

/// Fills `said` with the values of the tiles at a cell of the mosaic that lie on one surface, that of the tile with the
/// largest weight, which comes first; empty where no tile has a value. `here` are the indices of the pieces in
/// question, and cells are `gsd_m` metres wide.
pub fn one_surface(
    said: &mut Vec<CellValue>,
    (pieces, here): (&[Piece], &[usize]),
    (col, row): (isize, isize),
    gsd_m: f32,
) {
    said.clear();
    said.extend(here.iter().filter_map(|&i| cell_value(i, &pieces[i], col, row, gsd_m)));
    // Of equal weights the first one wins.
    let stronger = |best: usize, next: usize| {
        if said[next].weight > said[best].weight {
            next
        } else {
            best
        }
    };
    let Some(strongest) = (0..said.len()).reduce(stronger) else {
        return;
    };
    let altitude = said[strongest].values[0];
    said.swap(0, strongest);
    said.retain(|one| (one.values[0] - altitude).abs() <= ONE_SURFACE_CELLS * gsd_m);
}

/// Bands of one surface: weighted means over its tiles.
fn together(said: &[CellValue]) -> [f32; BANDS] {
    let Some(strongest) = said.first() else {
        return [f32::NAN; BANDS];
    };
    // Over the tiles with a finite value; NaN where there is none.
    let mean = |value: &dyn Fn(&[f32; BANDS]) -> f32| {
        let known = said.iter().map(|one| (one.weight, value(&one.values)));
        let known = known.filter(|(_, value)| value.is_finite());
        let add = |(all, sum), (weight, value): (f32, f32)| (all + weight, sum + weight * value);
        let (weight, sum) = known.fold((0.0, 0.0), add);
        sum / weight
    };
    // Relative to the tile with the largest weight, so that no digits are lost at high altitudes.
    let altitude = strongest.values[0] + mean(&|v| v[0] - strongest.values[0]);
    let variance = mean(&|v| v[1] * v[1] + (v[0] - altitude) * (v[0] - altitude));
    // The largest count is the best one: other tiles may contain fewer of the images.
    let views = said.iter().map(|one| one.values[3]).fold(0.0, f32::max);
    [altitude, variance.sqrt(), mean(&|v| v[2]), views]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two tiles of 30 x 10 cells whose cores meet at column 20, each reaching 10 beyond.
    fn pair(left: f32, right: f32, sigma: [f32; 2]) -> Vec<Piece> {
        let piece = |value: f32, sigma: f32, at: isize, core: [isize; 2], bounds: [isize; 2]| {
            let mut raster = Raster::filled(30, 10, BANDS, value);
            raster.plane_mut(1).fill(sigma);
            raster.plane_mut(2).fill(1.0);
            raster.plane_mut(3).fill(6.0);
            Piece {
                unit: format!("t{at}"),
                raster,
                at: [at, 0],
                core: [core, [0, 10]],
                bounds: [bounds, [0, 10]],
            }
        };
        vec![
            piece(left, sigma[0], 0, [0, 20], [0, 30]),
            piece(right, sigma[1], 10, [20, 40], [10, 40]),
        ]
    }

    #[test]
    fn two_tiles_of_one_surface_meet_without_a_step() {
        let raster = blend(&pair(100.0, 100.6, [0.2, 0.2]), (40, 10), 0.5);
        let line = &raster.plane(0)[5 * 40..6 * 40];
        assert!((line[9] - 100.0).abs() < 1e-3 && (line[30] - 100.6).abs() < 1e-3);
        let largest = line.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f32::max);
        // The whole difference over twenty cells, at the steepest of the taper one and a half times the mean.
        assert!(largest < 0.6 / 20.0 * 1.6, "{largest}");
        assert!(
            (0.5 * (line[19] + line[20]) - 100.3).abs() < 1e-3,
            "half and half on the line"
        );
    }

    #[test]
    fn the_surer_tile_counts_more() {
        let raster = blend(&pair(100.0, 100.6, [2.0, 0.1]), (40, 10), 0.5);
        assert!(raster.at(0, 19, 5) > 100.5, "{}", raster.at(0, 19, 5));
        // Its deviation includes the distance between the two.
        assert!(raster.at(1, 15, 5) > 0.1);
    }

    #[test]
    fn a_tile_of_unknown_deviation_is_not_the_surest() {
        let raster = blend(&pair(100.0, 100.6, [f32::NAN, 0.2]), (40, 10), 0.5);
        assert!(raster.at(0, 19, 5) > 100.5, "{}", raster.at(0, 19, 5));
        assert!(raster.at(1, 3, 5).is_nan() && (raster.at(1, 19, 5) - 0.2).abs() < 0.1);
        let raster = blend(&pair(100.0, 100.6, [f32::NAN; 2]), (40, 10), 0.5);
        assert!((raster.at(0, 19, 5) - 100.3).abs() < 0.03, "{}", raster.at(0, 19, 5));
    }

    #[test]
    fn a_roof_and_the_ground_are_not_averaged() {
        let raster = blend(&pair(100.0, 110.0, [0.2, 0.2]), (40, 10), 0.5);
        for &value in raster.plane(0) {
            assert!(value == 100.0 || value == 110.0, "{value}");
        }
    }

    #[test]
    fn what_one_tile_does_not_know_the_other_says_and_what_none_knows_stays_unknown() {
        let mut pieces = pair(100.0, 100.0, [0.2, 0.2]);
        pieces[0].raster.plane_mut(0)[5 * 30 + 25] = f32::NAN;
        pieces[0].raster.plane_mut(0)[5 * 30 + 3] = f32::NAN;
        let raster = blend(&pieces, (40, 10), 0.5);
        assert!((raster.at(0, 25, 5) - 100.0).abs() < 1e-4);
        assert!((0..BANDS).all(|band| raster.at(band, 3, 5).is_nan()));
    }
}
