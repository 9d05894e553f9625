//! Visibility of a surface: the views that see each cell at its altitude, and their base-to-height ratio.
//!
//! One image alone does not determine an altitude, so a cell visible in fewer than [`FEWEST_VIEWS`] is unknown, even
//! where an altitude was matched. Views without parallax between them, such as an image and its copy, count as one.
//! Beyond the edge of an image's data, views overlap at some altitudes only, and the sweep finds one of those
//! regardless of the ground. So a view counts only where it would also show the place at the altitude of the ground
//! around. Pits of such mismatches do not count as ground. The caller marks the cells that occlude others, so that
//! towers of mismatches hide nothing.

use super::views::parallax;
use super::visibility::{FirstHits, Standing};
use glam::{Vec2, Vec3};
use heliosplat::ProjectiveCamera;
use heliosplat_grid::Grid;
use heliosplat_grid::statistics::{quantile, upper_median};
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
use rayon::prelude::*;

/// Views that must see a cell for its altitude to be known.
pub const FEWEST_VIEWS: u8 = 2;
/// A cell is hidden when it is at least this far below its occluder, metres: a kerb or a hedge hides nothing.
const HIDDEN_M: f32 = 1.0;

/// Side of the squares for the first median of the altitudes, cells.
const SQUARE: usize = 32;
/// Least share of a square's cells with an occluder for its median to count, where any square has as many: fewer may be
/// a single mismatch.
const LEAST_STANDING: f32 = 0.25;
/// Squares each way whose lowest altitude is that of the ground around: 256 cells.
const REACH: usize = 8;
/// Share of these squares that may be lower: pits outside the common ground, where the search has run to the lowest
/// altitude.
const PITS: f64 = 0.05;

/// Altitudes on a ground grid whose row 0 is the northern one.
#[derive(Debug, Clone, Copy)]
pub struct AltitudeGrid<'a> {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Western edge, metres.
    pub west_m: f32,
    /// Northern edge, metres.
    pub north_m: f32,
    /// Width of a cell, metres.
    pub cell_m: f32,
    /// Altitude of each cell, metres; NaN where none is known: such a cell is seen by no view.
    pub altitude_m: &'a [f32],
    /// Altitude of occluders, metres; NaN elsewhere.
    pub standing_m: &'a [f32],
    /// Error of the altitudes, metres: a cell less than this below another is not hidden by it.
    pub resolution_m: f32,
}

/// The views that see each cell of a surface.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Witnesses {
    /// Number of views; those without parallax between them count as one.
    pub views: Vec<u8>,
    /// Their base-to-height ratio: that of a pair of views with the altitude precision of all of them together; 0 for
    /// fewer than two.
    pub base_to_height: Vec<f32>,
}

/// The views that see each cell. Its centre projects into the image, onto a pixel with data by `is_known` (view, pixel
/// in row order); nothing higher is in front of it; and the image also has data at the place at the altitude of the
/// lowest ground around.
pub fn views_seeing(
    surface: &AltitudeGrid,
    cameras: &[ProjectiveCamera],
    is_known: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Witnesses {
    let grid = Grid {
        width: surface.size.0,
        height: surface.size.1,
        west_m: surface.west_m,
        north_m: surface.north_m,
        cell_m: surface.cell_m,
    };
    let standing: Vec<f32> = surface
        .standing_m
        .iter()
        .map(|z| if z.is_nan() { f32::MIN } else { *z })
        .collect();
    let standing = Standing::new(&grid, &standing, surface.resolution_m.max(HIDDEN_M));
    let ground = LowestGround::new(&grid, surface.standing_m);
    let mut parallaxes = ParallaxSums::new(grid.len());
    for station in stations(cameras, &grid, surface.altitude_m) {
        let mut seen = vec![false; grid.len()];
        // View by view: the hits of one image are in memory at a time.
        for view in station.views {
            let camera = &cameras[view];
            let hits = FirstHits::new(camera, &standing);
            let cells = seen.par_iter_mut().enumerate().with_min_len(1024);
            cells.filter(|(_, seen)| !**seen).for_each(|(cell, seen)| {
                let altitude_m = surface.altitude_m[cell];
                let (col, row) = (cell % grid.width, cell / grid.width);
                let at = |altitude_m: f32| {
                    let pixel = pixel_of(camera, grid.point(col as isize, row as isize, altitude_m));
                    pixel.filter(|&pixel| is_known(view, pixel))
                };
                *seen = at(altitude_m).is_some_and(|pixel| !hits.hides(pixel, altitude_m))
                    && at(ground.at(col, row)).is_some();
            });
        }
        parallaxes.add(station.parallax, &seen);
    }
    parallaxes.witnesses()
}

/// Views without parallax between them.
struct Station {
    views: Vec<usize>,
    /// Ground metres per metre of altitude: east, north.
    parallax: Vec2,
}

/// Groups of views without parallax between them, at the middle of a surface.
fn stations(cameras: &[ProjectiveCamera], grid: &Grid, altitude_m: &[f32]) -> Vec<Station> {
    let (mut sum, mut count) = (0.0f64, 0usize);
    for z in altitude_m.iter().filter(|z| z.is_finite()) {
        (sum, count) = (sum + f64::from(*z), count + 1);
    }
    let middle_m = (sum / count.max(1) as f64) as f32;
    let middle = grid.point((grid.width / 2) as isize, (grid.height / 2) as isize, middle_m);
    let mut stations: Vec<Station> = Vec::new();
    for (view, camera) in cameras.iter().enumerate() {
        let parallax = parallax(camera, middle);
        let same = |station: &&mut Station| (station.parallax - parallax).length() < LEAST_BASE_TO_HEIGHT as f32;
        match stations.iter_mut().find(same) {
            Some(station) => station.views.push(view),
            None => stations.push(Station {
                views: vec![view],
                parallax,
            }),
        }
    }
    stations
}

/// Sums over the viewpoints that see each cell. An altitude from n views whose parallaxes are p has the information Σ
/// |p - mean|² (least squares, equal errors of position in each image), and that of a pair is half its squared base.
struct ParallaxSums {
    views: Vec<u8>,
    sum: Vec<Vec2>,
    squares: Vec<f32>,
}

impl ParallaxSums {
    fn new(cells: usize) -> Self {
        Self {
            views: vec![0; cells],
            sum: vec![Vec2::ZERO; cells],
            squares: vec![0.0; cells],
        }
    }

    fn add(&mut self, parallax: Vec2, seen: &[bool]) {
        for cell in (0..seen.len()).filter(|&cell| seen[cell]) {
            self.views[cell] = self.views[cell].saturating_add(1);
            self.sum[cell] += parallax;
            self.squares[cell] += parallax.length_squared();
        }
    }

    fn witnesses(self) -> Witnesses {
        let sums = self.views.iter().zip(&self.sum).zip(&self.squares);
        let base = |((&views, sum), squares): ((&u8, &Vec2), &f32)| match views {
            0 | 1 => 0.0,
            views => (2.0 * (squares - sum.length_squared() / f32::from(views)).max(0.0)).sqrt(),
        };
        Witnesses {
            base_to_height: sums.map(base).collect(),
            views: self.views,
        }
    }
}

/// The altitude of the lowest ground around each place, coarsely.
struct LowestGround {
    columns: usize,
    lowest_m: Vec<f32>,
}

impl LowestGround {
    fn new(grid: &Grid, standing_m: &[f32]) -> Self {
        let squares = grid.coarser(SQUARE);
        let of_square = |square: usize| {
            let (col0, row0) = (square % squares.width * SQUARE, square / squares.width * SQUARE);
            let cols = col0..(col0 + SQUARE).min(grid.width);
            let rows = row0..(row0 + SQUARE).min(grid.height);
            let all = cols.len() * rows.len();
            let cells = rows.flat_map(|row| cols.clone().map(move |col| row * grid.width + col));
            let mut standing: Vec<f32> = cells.map(|cell| standing_m[cell]).filter(|z| z.is_finite()).collect();
            let share = standing.len() as f32 / all as f32;
            Some((upper_median(&mut standing)?, share))
        };
        let medians: Vec<Option<(f32, f32)>> = (0..squares.len()).into_par_iter().map(of_square).collect();
        let best = medians.iter().flatten().map(|(_, share)| *share).fold(0.0, f32::max);
        let needed = LEAST_STANDING.min(best);
        let around = |square: usize| {
            let medians = squares.around(square, REACH).filter_map(|near| medians[near]);
            let mut enough: Vec<f32> = medians
                .filter(|(_, share)| *share >= needed)
                .map(|(median, _)| median)
                .collect();
            quantile(&mut enough, PITS).unwrap_or(f32::MAX)
        };
        Self {
            columns: squares.width,
            lowest_m: (0..squares.len()).into_par_iter().map(around).collect(),
        }
    }

    fn at(&self, col: usize, row: usize) -> f32 {
        self.lowest_m[row / SQUARE * self.columns + col / SQUARE]
    }
}

/// The pixel, in row order, that a point (metres) projects into; `None` outside the image.
pub(super) fn pixel_of(camera: &ProjectiveCamera, at: Vec3) -> Option<usize> {
    let (col, row, _) = camera.project(at);
    let (col, row) = (col.round(), row.round());
    // Written so that a NaN position is outside too.
    let inside = col >= 0.0 && row >= 0.0 && col < camera.width as f32 && row < camera.height as f32;
    inside.then(|| row as usize * camera.width + col as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// A camera far away whose rays move `lean` metres east per metre of altitude, with pixels of a metre over `size`
    /// metres.
    fn camera(lean: f64, size: usize) -> ProjectiveCamera {
        let axis = DVec3::new(lean, 0.0, -1.0).normalize();
        let half = size as f64 / 2.0;
        ProjectiveCamera::new(
            [1.0, 0.0, lean, half - 0.5],
            [0.0, -1.0, 0.0, half - 0.5],
            [0.0; 3],
            (size, size),
            axis,
        )
    }

    fn surface(altitude_m: &[f32], side: usize) -> AltitudeGrid<'_> {
        AltitudeGrid {
            size: (side, side),
            west_m: -(side as f32) / 2.0,
            north_m: side as f32 / 2.0,
            cell_m: 1.0,
            altitude_m,
            standing_m: altitude_m,
            resolution_m: 0.1,
        }
    }

    #[test]
    fn ground_behind_a_tower_is_seen_by_the_views_from_the_other_side_alone() {
        const SIDE: usize = 60;
        let tower = |i: usize| (25..35).contains(&(i % SIDE)) && (25..35).contains(&(i / SIDE));
        let altitude: Vec<f32> = (0..SIDE * SIDE).map(|i| if tower(i) { 10.0 } else { 0.0 }).collect();
        let cameras = [camera(0.0, SIDE), camera(-1.0, SIDE), camera(1.0, SIDE)];
        let seen = views_seeing(&surface(&altitude, SIDE), &cameras, &|_, _| true).views;
        let at = |col: usize| seen[30 * SIDE + col];
        assert_eq!((at(30), at(5)), (3, 3), "the roof and open ground");
        // Beside the tower each oblique view misses one side, well within the length of its lean.
        assert_eq!((at(21), at(38)), (2, 2));
    }

    #[test]
    fn where_views_meet_above_the_ground_alone_nothing_is_known() {
        const SIDE: usize = 60;
        // Their common ground ends at the images' borders; further out they meet high above the ground only.
        let cameras = [camera(-1.0, SIDE), camera(1.0, SIDE)];
        let altitude: Vec<f32> = (0..SIDE * SIDE)
            .map(|i| if i % SIDE >= 50 { 0.0 } else { -20.0 })
            .collect();
        let seen = views_seeing(&surface(&altitude, SIDE), &cameras, &|_, _| true).views;
        let on_the_ground = |col: usize| {
            let p = Vec3::new(col as f32 + 0.5 - SIDE as f32 / 2.0, 0.0, -20.0);
            cameras.iter().filter(|camera| pixel_of(camera, p).is_some()).count()
        };
        assert_eq!((on_the_ground(30), on_the_ground(55)), (2, 1));
        assert_eq!((seen[30 * SIDE + 30], seen[30 * SIDE + 55]), (2, 1));
    }

    #[test]
    fn a_pit_of_mismatches_takes_no_view_from_the_ground_around() {
        const SIDE: usize = 96;
        let pit = |i: usize| i % SIDE < 12 && i / SIDE < 12;
        let altitude: Vec<f32> = (0..SIDE * SIDE).map(|i| if pit(i) { -60.0 } else { 0.0 }).collect();
        let cameras = [camera(-1.0, SIDE), camera(1.0, SIDE)];
        let seen = views_seeing(&surface(&altitude, SIDE), &cameras, &|_, _| true).views;
        assert_eq!((seen[50 * SIDE + 20], seen[50 * SIDE + 75]), (2, 2));
    }

    #[test]
    fn what_does_not_stand_hides_nothing() {
        const SIDE: usize = 60;
        let tower = |i: usize| (25..35).contains(&(i % SIDE));
        let altitude: Vec<f32> = (0..SIDE * SIDE).map(|i| if tower(i) { 10.0 } else { 0.0 }).collect();
        let standing: Vec<f32> = (0..SIDE * SIDE)
            .map(|i| if tower(i) { f32::NAN } else { 0.0 })
            .collect();
        let grid = AltitudeGrid {
            standing_m: &standing,
            ..surface(&altitude, SIDE)
        };
        let seen = views_seeing(&grid, &[camera(-1.0, SIDE), camera(1.0, SIDE)], &|_, _| true).views;
        assert_eq!((seen[30 * SIDE + 21], seen[30 * SIDE + 38]), (2, 2));
    }

    #[test]
    fn pixels_without_data_and_cells_without_altitude_count_for_nothing() {
        const SIDE: usize = 8;
        let mut altitude = vec![0.0; SIDE * SIDE];
        altitude[9] = f32::NAN;
        // Oblique: a ray over the unknown cell continues down to the lowest known altitude, and no further.
        let cameras = [camera(0.0, SIDE), camera(0.3, SIDE)];
        let seen = views_seeing(&surface(&altitude, SIDE), &cameras, &|view, pixel| {
            view == 0 || pixel != 20
        })
        .views;
        assert_eq!((seen[9], seen[20], seen[0]), (0, 1, 2));
        altitude.fill(f32::NAN);
        let nothing = views_seeing(&surface(&altitude, SIDE), &cameras, &|_, _| true).views;
        assert!(nothing.iter().all(|&seen| seen == 0));
    }

    #[test]
    fn where_data_meet_above_the_ground_alone_nothing_is_known() {
        const SIDE: usize = 60;
        // As at the borders of images, the east of both is missing.
        let cameras = [camera(-1.0, SIDE), camera(1.0, SIDE)];
        let altitude: Vec<f32> = (0..SIDE * SIDE)
            .map(|i| if i % SIDE >= 30 { 0.0 } else { -10.0 })
            .collect();
        let is_known = |_: usize, pixel: usize| pixel % SIDE < 40;
        let seen = views_seeing(&surface(&altitude, SIDE), &cameras, &is_known).views;
        assert_eq!((seen[30 * SIDE + 15], seen[30 * SIDE + 35]), (2, 1));
    }

    #[test]
    fn a_copy_is_no_second_view_and_three_views_are_as_good_as_their_least_squares() {
        const SIDE: usize = 24;
        let flat = vec![0.0; SIDE * SIDE];
        let witnesses = |leans: &[f64]| {
            let cameras: Vec<ProjectiveCamera> = leans.iter().map(|&lean| camera(lean, SIDE)).collect();
            let found = views_seeing(&surface(&flat, SIDE), &cameras, &|_, _| true);
            let middle = SIDE / 2 * SIDE + SIDE / 2;
            (found.views[middle], found.base_to_height[middle])
        };
        assert_eq!(witnesses(&[0.1, 0.1]), (1, 0.0));
        assert_eq!(witnesses(&[0.1, 0.11]), (1, 0.0));
        let near = |(views, base): (u8, f32), expected: (u8, f32)| {
            assert!(
                views == expected.0 && (base - expected.1).abs() < 1e-4,
                "{views} {base}"
            );
        };
        near(witnesses(&[0.1, 0.1, 0.5]), (2, 0.4));
        near(witnesses(&[-0.3, 0.0, 0.3]), (3, 0.6));
    }
}
