//! Edges of structures are placed where the views change.
//!
//! Windows of matching reach over the edge of a roof, so that matched edges are up to a cell off. Along a line across
//! the edge, at the altitude of the roof, every view changes from the roof to its own background at the same place.
//! Shadows and façades change the views at other places, which differ from view to view. So the edge is where the
//! median change of the views is largest, summed along the edge (docs/lab/edges.md).

use super::level::LevelView;
use glam::{Vec2, Vec3};
use heliosplat_grid::Grid;
use heliosplat_grid::statistics::upper_median;
use rayon::prelude::*;

/// Least step of an edge, metres: lower ones are cars, hedges or noise.
const LEAST_STEP_M: f32 = 2.0;
/// Least step, height steps of the plane sweep.
const LEAST_STEPS: f32 = 3.0;
/// Places of a profile on each side of the matched edge.
const PLACES: usize = 16;
/// All places of a profile.
const PROFILE: usize = 2 * PLACES + 1;
/// Distance between two places, cells.
const PITCH_CELLS: f32 = 0.25;
/// Radius of the window in which the direction of an edge is measured, cells.
const WINDOW_CELLS: usize = 5;
/// Standard deviation of the weights in that window, cells.
const WINDOW_SIGMA_CELLS: f32 = 2.0;
/// Largest distance between edges that are combined, cells.
const SAME_EDGE_CELLS: f32 = 4.0;
/// Least cosine between their directions.
const SAME_DIRECTION: f32 = 0.9;
/// Largest difference of their upper altitudes, metres.
const SAME_TOP_M: f32 = 1.0;
/// Standard deviation of true edges about matched ones, cells (docs/lab/edges.md).
const SIGMA_CELLS: f32 = 1.4;
/// Fewest views for an edge: the median of two would be one of them.
const FEWEST_PROFILES: usize = 3;
/// Largest distance of a moved cell from its edge, cells.
const REACH_CELLS: f32 = 3.0;

/// A side that a cell shares with a much lower one.
struct Edge {
    /// Middle of the side: columns from the western and rows from the northern edge of the grid.
    at: Vec2,
    /// Unit vector toward the lower side, in columns and rows.
    outward: Vec2,
    upper_m: f32,
    lower_m: f32,
}

impl Edge {
    fn middle_m(&self) -> f32 {
        (self.upper_m + self.lower_m) / 2.0
    }

    /// True if both belong to one edge, so that their profiles are combined.
    fn same_edge_as(&self, other: &Edge) -> bool {
        self.at.distance_squared(other.at) <= SAME_EDGE_CELLS * SAME_EDGE_CELLS
            && self.outward.dot(other.outward) >= SAME_DIRECTION
            && (self.upper_m - other.upper_m).abs() <= SAME_TOP_M
    }
}

/// Change of the views at each place of a profile, in units of the mean along it.
type Profile = [f32; PROFILE];

/// Moves the edges of a surface to where the views change: cells between the matched and the true edge take the
/// altitude of the other side, metres. `step_m` is the step of the height hypotheses, metres. Moved cells keep the
/// large deviation of their match.
pub(super) fn place(grid: &Grid, views: &[LevelView], altitude: &mut [f32], step_m: f32) {
    if views.len() < FEWEST_PROFILES {
        return;
    }
    let edges = find(grid, altitude, LEAST_STEP_M.max(LEAST_STEPS * step_m));
    let profiles: Vec<Profile> = edges.par_iter().map(|edge| profile(grid, views, edge)).collect();
    let near = Near::new(grid, &edges);
    let offsets: Vec<f32> = (0..edges.len())
        .into_par_iter()
        .map(|number| offset_cells(&edges, &profiles, &near, number))
        .collect();
    let moved: Vec<Option<f32>> = (0..grid.len())
        .into_par_iter()
        .with_min_len(grid.width)
        .map(|cell| other_side(grid, altitude, (&edges, &offsets), &near, cell))
        .collect();
    for (altitude, moved) in altitude.iter_mut().zip(moved) {
        *altitude = moved.unwrap_or(*altitude);
    }
}

/// The sides at which a surface falls by `least_m` metres and more.
fn find(grid: &Grid, altitude: &[f32], least_m: f32) -> Vec<Edge> {
    let sides = |cell: usize| {
        let (col, row) = (cell % grid.width, cell / grid.width);
        [
            (col > 0).then(|| (cell - 1, Vec2::NEG_X)),
            (col + 1 < grid.width).then(|| (cell + 1, Vec2::X)),
            (row > 0).then(|| (cell - grid.width, Vec2::NEG_Y)),
            (row + 1 < grid.height).then(|| (cell + grid.width, Vec2::Y)),
        ]
    };
    let of_cell = |cell: usize| {
        let falls = sides(cell).into_iter().flatten();
        let falls = falls.filter(move |(lower, _)| altitude[cell] - altitude[*lower] >= least_m);
        falls.filter_map(move |(lower, toward)| {
            let at = centre(grid, cell) + 0.5 * toward;
            let (upper_m, lower_m) = (altitude[cell], altitude[lower]);
            let outward = outward(grid, altitude, cell, at, (upper_m + lower_m) / 2.0)?;
            Some(Edge {
                at,
                outward,
                upper_m,
                lower_m,
            })
        })
    };
    (0..grid.len()).into_par_iter().flat_map_iter(of_cell).collect()
}

/// Centre of a cell in columns and rows.
fn centre(grid: &Grid, cell: usize) -> Vec2 {
    Vec2::new((cell % grid.width) as f32 + 0.5, (cell / grid.width) as f32 + 0.5)
}

/// The direction away from the cells above `middle_m` metres around a cell; `None` where they surround it evenly.
fn outward(grid: &Grid, altitude: &[f32], cell: usize, at: Vec2, middle_m: f32) -> Option<Vec2> {
    let above = grid
        .around(cell, WINDOW_CELLS)
        .filter(|near| altitude[*near] > middle_m);
    let weighted = above.map(|near| {
        let from = at - centre(grid, near);
        from * (-from.length_squared() / (2.0 * WINDOW_SIGMA_CELLS * WINDOW_SIGMA_CELLS)).exp()
    });
    weighted.sum::<Vec2>().try_normalize()
}

/// Change of the views along the line across an edge, at the altitude of its upper side: the median over them.
fn profile(grid: &Grid, views: &[LevelView], edge: &Edge) -> Profile {
    let along = |k: usize| {
        let at = edge.at + (k as f32 - (PLACES + 1) as f32) * PITCH_CELLS * edge.outward;
        Vec3::new(
            grid.west_m + at.x * grid.cell_m,
            grid.north_m - at.y * grid.cell_m,
            edge.upper_m,
        )
    };
    let of_view = |view: &LevelView| {
        let values: [f32; PROFILE + 2] = std::array::from_fn(|k| {
            let (col, row, _) = view.camera.project(along(k));
            view.sample_cubic(col, row)
        });
        let changes: Profile = std::array::from_fn(|k| (values[k + 2] - values[k]).abs());
        let mean = changes.iter().sum::<f32>() / PROFILE as f32;
        // A view that shows only a part of the line, or no change along it, is ignored.
        (mean.is_finite() && mean > 0.0).then(|| changes.map(|change| change / mean))
    };
    let changes: Vec<Profile> = views.iter().filter_map(of_view).collect();
    if changes.len() < FEWEST_PROFILES {
        return [0.0; PROFILE];
    }
    std::array::from_fn(|k| {
        let mut of_views: Vec<f32> = changes.iter().map(|changes| changes[k]).collect();
        upper_median(&mut of_views).unwrap_or(0.0)
    })
}

/// Spatial index of the edges, in squares of [`SAME_EDGE_CELLS`] a side.
struct Near {
    squares: Grid,
    edges: Vec<Vec<usize>>,
}

impl Near {
    fn new(grid: &Grid, edges: &[Edge]) -> Self {
        let squares = grid.coarser(SAME_EDGE_CELLS as usize);
        let mut of_square = vec![Vec::new(); squares.len()];
        for (number, edge) in edges.iter().enumerate() {
            of_square[Self::square(&squares, edge.at)].push(number);
        }
        Self {
            squares,
            edges: of_square,
        }
    }

    fn square(squares: &Grid, at: Vec2) -> usize {
        let of = |cells: f32, count: usize| ((cells / SAME_EDGE_CELLS) as usize).min(count - 1);
        of(at.y, squares.height) * squares.width + of(at.x, squares.width)
    }

    /// All edges within [`SAME_EDGE_CELLS`] of a place, and some further ones.
    fn around(&self, at: Vec2) -> impl Iterator<Item = usize> {
        let squares = self.squares.around(Self::square(&self.squares, at), 1);
        squares.flat_map(|square| self.edges[square].iter().copied())
    }
}

/// Outward offset of an edge from its matched position, cells.
fn offset_cells(edges: &[Edge], profiles: &[Profile], near: &Near, number: usize) -> f32 {
    let edge = &edges[number];
    let mut sum = [0.0; PROFILE];
    for other in near.around(edge.at).filter(|other| edge.same_edge_as(&edges[*other])) {
        let further = (edges[other].at - edge.at).dot(edge.outward) / PITCH_CELLS;
        for (k, sum) in sum.iter_mut().enumerate() {
            let place = k as f32 - further;
            let first = place.floor();
            let two = (first >= 0.0).then(|| profiles[other].get(first as usize..first as usize + 2));
            if let Some(Some(&[here, next])) = two.map(|two| two.and_then(|two| two.first_chunk::<2>())) {
                *sum += here + (next - here) * (place - first);
            }
        }
    }
    let away = |k: usize| (k as f32 - PLACES as f32) * PITCH_CELLS;
    let likely = |k: usize| (-away(k).powi(2) / (2.0 * SIGMA_CELLS * SIGMA_CELLS)).exp() * sum[k];
    // The matched place comes first, so that it stays where nothing changes.
    let places = std::iter::once(PLACES).chain(0..PROFILE);
    let best = places.reduce(|best, k| if likely(k) > likely(best) { k } else { best });
    away(best.unwrap_or(PLACES))
}

/// The altitude of the other side of the nearest edge, for a cell on the wrong side; `None` for other cells.
fn other_side(
    grid: &Grid,
    altitude: &[f32],
    (edges, offsets): (&[Edge], &[f32]),
    near: &Near,
    cell: usize,
) -> Option<f32> {
    let at = centre(grid, cell);
    let away = |number: &usize| edges[*number].at.distance_squared(at);
    let within = near
        .around(at)
        .filter(|number| away(number) <= REACH_CELLS * REACH_CELLS);
    let nearest = within.min_by(|a, b| away(a).total_cmp(&away(b)))?;
    let edge = &edges[nearest];
    let beyond = (at - edge.at).dot(edge.outward) > offsets[nearest];
    match (altitude[cell] > edge.middle_m(), beyond) {
        (true, true) => Some(edge.lower_m),
        (false, false) => Some(edge.upper_m),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::views::SweepView;
    use super::*;
    use glam::DVec3;
    use heliosplat::{ProjectiveCamera, Raster};

    const SIDE: usize = 48;
    const ROOF_M: f32 = 8.0;
    /// Column at which the true roof ends.
    const TRUE_EDGE: f32 = 24.0;

    /// Views whose rays move east by so much per metre of altitude, of a bright roof in the west over ground of
    /// stripes.
    fn rasters(contrast: f32) -> Vec<(ProjectiveCamera, Raster)> {
        let half = SIDE as f64 / 2.0;
        let of_lean = |lean: f32| {
            let axis = DVec3::new(f64::from(lean), 0.0, -1.0).normalize();
            let camera = ProjectiveCamera::new(
                [1.0, 0.0, f64::from(lean), half - 0.5],
                [0.0, -1.0, 0.0, half - 0.5],
                [0.0; 3],
                (SIDE, SIDE),
                axis,
            );
            let value = |i: usize| {
                let west = (i % SIDE) as f32;
                // A pixel shows the roof where its rays meet the roof's altitude west of the edge.
                let roof = (TRUE_EDGE + lean * ROOF_M - west).clamp(0.0, 1.0);
                let ground = 0.1 * (0.7 * (west + i as f32 / SIDE as f32)).sin();
                1.0 + contrast * (roof + (1.0 - roof) * ground)
            };
            let values = (0..SIDE * SIDE).map(value).collect();
            let image = Raster {
                width: SIDE,
                height: SIDE,
                bands: 1,
                values,
            };
            (camera, image)
        };
        [-0.3, 0.0, 0.2, 0.4].map(of_lean).to_vec()
    }

    /// The column at which the roof of a surface ends, in the middle row, after a roof matched to column 25 was placed.
    fn placed_edge(contrast: f32, views: usize) -> usize {
        let grid = Grid {
            west_m: -(SIDE as f32) / 2.0,
            north_m: SIDE as f32 / 2.0,
            ..Grid::plain(SIDE, SIDE)
        };
        let mut altitude: Vec<f32> = (0..SIDE * SIDE)
            .map(|cell| if cell % SIDE < 25 { ROOF_M } else { 0.0 })
            .collect();
        let rasters = rasters(contrast);
        let views: Vec<LevelView> = rasters[..views]
            .iter()
            .map(|(camera, image)| {
                let view = SweepView {
                    camera: *camera,
                    image,
                    index: None,
                    date_group: 0,
                    sun: None,
                };
                LevelView::new(&view, 1.0, Vec3::ZERO, false)
            })
            .collect();
        place(&grid, &views, &mut altitude, 0.1);
        let row = &altitude[SIDE / 2 * SIDE..][..SIDE];
        assert!(row.iter().all(|z| *z == 0.0 || *z == ROOF_M));
        row.iter().filter(|z| **z == ROOF_M).count()
    }

    #[test]
    fn a_roof_that_was_matched_too_wide_ends_where_all_views_change() {
        assert_eq!(placed_edge(1.0, 4), TRUE_EDGE as usize);
    }

    #[test]
    fn an_edge_stays_where_no_view_changes_or_too_few_show_it() {
        assert_eq!(placed_edge(0.0, 4), 25);
        assert_eq!(placed_edge(1.0, 2), 25);
    }
}
