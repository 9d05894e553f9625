//! Tie points: points of the ground seen in several images, to hundredths of a pixel and without a learned matcher.
//!
//! A coarse search gives an approximate surface. Every view is sampled on its tangent plane at a ground point; there
//! all views show the same patch up to small shifts: parallax of a wrong altitude along the epipolar line, pointing
//! bias in any direction. One view is the reference of a point; in each other view the shift is found by normalised
//! cross-correlation and checked by searching back (`patch`), then refined by least squares (`refine`; A. W. Gruen,
//! *Adaptive least squares correlation*, 1985, with shifts only: the tangent plane replaces the affine warp). Points
//! are corners of the reference's texture, one in each tile of the ground (`corners`), and the views take turns as the
//! reference.
//!
//! Limits: shifts beyond `REACH` cells of the level are not found, so biases of many pixels need a coarse alignment
//! first ([`super::align::coarse_shifts`]). The edge of a shadow that moved between dates matches well at a wrong
//! place; the robust adjustment has to reject such sightings.

mod corners;
pub mod epipolar;
mod patch;
mod refine;

use crate::level::LevelView;
use crate::ortho;
use crate::pyramid::Search;
use crate::request::PlaneSweepRequest;
use crate::views::SweepView;
use corners::Corner;
use glam::{Vec2, Vec3};
use heliosplat_grid::Grid;
use patch::{Match, Region};
use rayon::prelude::*;

/// Farthest shift searched each way, cells.
pub(super) const REACH: isize = 4;
/// Half a patch, cells: 15 cells across.
pub(super) const HALF: isize = 7;
/// Cells of the patches per cell of their surface: patches are many cells wide, so a coarser surface suffices.
const SURFACE_FACTOR: usize = 2;
/// Radius of the median filter of that surface, its cells.
const MEDIAN_RADIUS: usize = 2;
/// Radius of the window that a tangent plane is fitted to, cells of the surface: about half a patch.
const TANGENT_RADIUS: isize = 3;
/// Steepest tangent plane, metres per metre: steeper ones are walls, where views show different sides.
const STEEPEST: f32 = 1.0;
/// Cells whose altitudes differ by less than this many height steps belong to the tangent plane's surface.
const SAME_SURFACE_STEPS: f32 = 2.0;
/// Largest difference of altitudes on the tangent plane's surface, cells.
const SAME_SURFACE_CELLS: f32 = 1.5;
/// Added to the diagonal of the tangent plane's normal equations (square metres for the slopes, a count of cells for
/// the altitude): keeps them solvable where few cells take part.
const STIFFNESS: Vec3 = Vec3::new(1e-3, 1e-3, 1e-6);
/// Least correlation of a sighting with its reference.
const LEAST_SCORE: f32 = 0.75;

/// Position of a tie point in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Index of the view.
    pub view: usize,
    /// Column in the view's image, pixels.
    pub col: f32,
    /// Row in the view's image, pixels.
    pub row: f32,
    /// Normalised cross-correlation with the reference, 1 for the reference itself.
    pub score: f32,
}

/// A tie point: a point of the ground that several views show.
#[derive(Debug, Clone, PartialEq)]
pub struct Tie {
    /// Approximate position of the point, metres in the frame of the cameras.
    pub near: Vec3,
    /// Positions of the point in two or more views; the reference comes first.
    pub sightings: Vec<Sighting>,
}

/// Options of the search for tie points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TieOptions {
    /// Cells of the request per cell of the patches: 2 covers shifts of twice the size at half the precision.
    pub factor: usize,
    /// Approximate number of tiles of the ground: at most one tie point is found in each.
    pub tiles: usize,
}

/// Finds tie points between the views, whose cameras must agree to about `REACH` cells of the patches. The result is
/// the same for any number of threads.
pub fn find_ties(views: &[SweepView], request: &PlaneSweepRequest, options: TieOptions) -> Vec<Tie> {
    let search = Search::new(views, request);
    let Some(found) = search.descend(SURFACE_FACTOR * options.factor, &|_| {}) else {
        return Vec::new();
    };
    let altitude = ortho::median(&found.grid, &found.altitude(), MEDIAN_RADIUS);
    let surface = ApproximateSurface {
        grid: found.grid,
        altitude: &altitude,
        step_m: found.step_m,
    };
    let grid = search.grid.coarser(options.factor);
    let levels = search.level_views(options.factor);
    let matcher = Matcher {
        views,
        levels: &levels,
        surface: &surface,
        cell_m: grid.cell_m,
    };
    let fine = surface.on(&grid);
    let orthos: Vec<Vec<f32>> = levels.iter().map(|level| ortho::ortho(&grid, level, &fine)).collect();
    let corners = corners::choose(&grid, &orthos, options.tiles);
    corners
        .par_iter()
        .filter_map(|corner| matcher.tie(&grid, corner))
        .collect()
}

/// The approximate surface of the patches.
struct ApproximateSurface<'a> {
    grid: Grid,
    altitude: &'a [f32],
    step_m: f32,
}

impl ApproximateSurface<'_> {
    /// Altitudes at the cells of another grid over the same ground.
    fn on(&self, grid: &Grid) -> Vec<f32> {
        (0..grid.len())
            .map(|i| {
                let p = grid.point((i % grid.width) as isize, (i / grid.width) as isize, 0.0);
                self.altitude[self.grid.nearest(p.x, p.y)]
            })
            .collect()
    }

    /// The tangent plane at a ground position: altitude there and slopes east and north, from the cells around that
    /// belong to the same surface.
    fn tangent_plane(&self, x_m: f32, y_m: f32) -> TangentPlane {
        let cell = self.grid.nearest(x_m, y_m);
        let (col, row) = ((cell % self.grid.width) as isize, (cell / self.grid.width) as isize);
        let middle = self.altitude[cell];
        let tolerance_m = (SAME_SURFACE_STEPS * self.step_m).max(SAME_SURFACE_CELLS * self.grid.cell_m);
        // Least squares over offsets from the position.
        let mut normal = glam::Mat3::from_diagonal(STIFFNESS);
        let mut right = Vec3::ZERO;
        for r in row - TANGENT_RADIUS..=row + TANGENT_RADIUS {
            for c in col - TANGENT_RADIUS..=col + TANGENT_RADIUS {
                if r < 0 || c < 0 || r >= self.grid.height as isize || c >= self.grid.width as isize {
                    continue;
                }
                let z = self.altitude[r as usize * self.grid.width + c as usize] - middle;
                if z.abs() > tolerance_m {
                    continue;
                }
                let p = self.grid.point(c, r, 0.0);
                let x = Vec3::new(p.x - x_m, p.y - y_m, 1.0);
                normal += glam::Mat3::from_cols(x * x.x, x * x.y, x * x.z);
                right += x * z;
            }
        }
        let solved = normal.inverse() * right;
        let slope = Vec2::new(solved.x, solved.y).clamp_length_max(STEEPEST);
        TangentPlane {
            origin: Vec3::new(x_m, y_m, middle + solved.z),
            slope,
        }
    }
}

/// A plane through a ground point.
#[derive(Debug, Clone, Copy)]
struct TangentPlane {
    origin: Vec3,
    slope: Vec2,
}

impl TangentPlane {
    /// The point of the plane `east_m`, `north_m` of its origin.
    fn point(&self, east_m: f32, north_m: f32) -> Vec3 {
        let rise = self.slope.x * east_m + self.slope.y * north_m;
        self.origin + Vec3::new(east_m, north_m, rise)
    }
}

/// Input of the matching of tie points.
struct Matcher<'a> {
    views: &'a [SweepView<'a>],
    levels: &'a [LevelView],
    surface: &'a ApproximateSurface<'a>,
    cell_m: f32,
}

impl Matcher<'_> {
    /// The value of a view at `cols` east and `rows` south of a plane's origin, in cells.
    fn sample(&self, view: usize, plane: &TangentPlane, cols: f32, rows: f32) -> f32 {
        let p = plane.point(cols * self.cell_m, -rows * self.cell_m);
        let level = &self.levels[view];
        let (col, row, _) = level.camera.project(p);
        level.sample_cubic(col, row)
    }

    fn region(&self, view: usize, plane: &TangentPlane) -> Region {
        Region::new(|cols, rows| self.sample(view, plane, cols as f32, rows as f32))
    }

    fn tie(&self, grid: &Grid, corner: &Corner) -> Option<Tie> {
        let at = grid.point(corner.col as isize, corner.row as isize, 0.0);
        let plane = self.surface.tangent_plane(at.x, at.y);
        let reference = self.region(corner.view, &plane);
        let template = reference.template(0, 0)?;
        let mut sightings = vec![self.sighting(corner.view, &plane, [0.0; 2], 1.0)];
        for view in (0..self.views.len()).filter(|&view| view != corner.view) {
            let region = self.region(view, &plane);
            let Some(coarse) = patch::find(&reference, &template, &region) else {
                continue;
            };
            let sample = |cols: f32, rows: f32| self.sample(view, &plane, cols, rows);
            let Some(Match { shift, score }) = refine::refine(&reference, &template, coarse, &sample) else {
                continue;
            };
            if score >= LEAST_SCORE {
                sightings.push(self.sighting(view, &plane, shift, score));
            }
        }
        (sightings.len() > 1).then_some(Tie {
            near: plane.origin,
            sightings,
        })
    }

    fn sighting(&self, view: usize, plane: &TangentPlane, shift: [f32; 2], score: f32) -> Sighting {
        let p = plane.point(shift[0] * self.cell_m, -shift[1] * self.cell_m);
        let (col, row, _) = self.views[view].camera.project(p);
        Sighting { view, col, row, score }
    }
}
