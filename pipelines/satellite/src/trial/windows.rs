//! Where components are tried: squares of ground where images have most contrast, which shadows give them; the Gaussians there and the
//! pixels that show them.

use glam::Vec3;
use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::model::{Parameters, View};
use heliosplat::render::depths;
use heliosplat::splat::ProjectionOptions;
use heliosplat_scene::Area;
use heliosplat_scene::crop::Crop;
use std::collections::BTreeSet;

/// Side of a window, metres, about.
const WINDOW_M: f64 = 32.0;
/// Pieces of ground along a side of a window: of some 8 m, as wide as a road or the shadow of a house.
const PIECES: usize = 4;
/// Metres around a window whose Gaussians belong to it.
const MARGIN_M: f32 = 8.0;
/// Metres around a window beyond which nothing is looked for that may throw a shadow into it.
const SHADOW_M: f32 = 64.0;
/// Places along a ray of the sun at which it is asked whether it reaches the window.
const RAY_PLACES: usize = 12;
/// Side of a tile of pixels that is kept aside.
const TILE_PX: usize = 20;
/// Pixels at the edge of such a tile that do not count: their surroundings, which the structural loss looks at, are learnt from.
const RIM_PX: usize = 3;
/// Share of tiles that are kept aside.
const ASIDE: f64 = 0.25;
/// Pixels around what a view shows of a window.
const BORDER_PX: usize = 8;
/// Fewest pixels of a view that show a window.
const FEWEST_PIXELS: usize = 256;
/// Place of a pixel that shows no square.
const NOWHERE: u32 = u32::MAX;

/// What one view shows of a window.
pub(super) struct Cut {
    /// The crop; pixels that show something else, or are kept aside, have no weight.
    pub(super) view: View,
    /// The pixels kept aside that count, and the piece of ground each of them shows.
    pub(super) aside: Vec<(usize, usize)>,
}

/// A square of ground.
pub(super) struct Window {
    /// Its Gaussians, and those that may throw shadows into it.
    pub(super) gaussians: Vec<u32>,
    /// What views show of it.
    pub(super) cuts: Vec<Cut>,
    /// Number of its pieces of ground.
    pub(super) pieces: usize,
    /// Box that holds its Gaussians, metres.
    pub(super) bounds: (Vec3, Vec3),
}

impl Window {
    pub(super) fn training_views(&self) -> Vec<View> {
        self.cuts.iter().map(|cut| cut.view.clone()).collect()
    }
}

/// The grid of squares, and of pieces in them.
struct Grid {
    west_m: f64,
    south_m: f64,
    /// Squares, east and north.
    count: [usize; 2],
    /// Their sides, metres.
    side_m: [f64; 2],
}

impl Grid {
    fn new(area: &Area) -> Self {
        let extent = [area.east_m - area.west_m, area.north_m - area.south_m];
        let count = extent.map(|m| ((m / WINDOW_M).round() as usize).max(1));
        Self {
            west_m: area.west_m,
            south_m: area.south_m,
            count,
            side_m: [extent[0] / count[0] as f64, extent[1] / count[1] as f64],
        }
    }

    /// The piece of ground at a place: square times pieces per square, plus the piece within it.
    fn piece(&self, at: Vec3) -> Option<u32> {
        let along = [
            (f64::from(at.x) - self.west_m) / self.side_m[0],
            (f64::from(at.y) - self.south_m) / self.side_m[1],
        ];
        let inside = (0..2).all(|axis| along[axis] >= 0.0 && along[axis] < self.count[axis] as f64);
        inside.then(|| {
            let square = along[1] as usize * self.count[0] + along[0] as usize;
            let part = along.map(|a| ((a.fract() * PIECES as f64) as usize).min(PIECES - 1));
            (square * PIECES * PIECES + part[1] * PIECES + part[0]) as u32
        })
    }

    /// South-west and north-east corner of a square, metres.
    fn corners(&self, square: usize) -> [[f32; 2]; 2] {
        let (column, row) = (square % self.count[0], square / self.count[0]);
        let west = self.west_m + column as f64 * self.side_m[0];
        let south = self.south_m + row as f64 * self.side_m[1];
        [
            [west as f32, south as f32],
            [(west + self.side_m[0]) as f32, (south + self.side_m[1]) as f32],
        ]
    }
}

/// The piece of ground that every pixel of a view shows; [`NOWHERE`] where it shows none or has no weight.
fn pieces_shown(gaussians: &Table, view: &View, grid: &Grid) -> Vec<u32> {
    let camera = &view.camera;
    let maps = depths(gaussians, camera, &ProjectionOptions::default());
    let shown = |pixel: usize| {
        let (col, row) = ((pixel % camera.width) as f32, (pixel / camera.width) as f32);
        let depth = maps.median_depth[pixel];
        if view.weight[pixel] <= 0.0 || !depth.is_finite() {
            return None;
        }
        let foot = camera.point_at_altitude(col, row, 0.0)?;
        let ray = camera.ray_direction(col, row);
        let further = (depth - camera.depth(foot)) / ray.dot(camera.depth_axis);
        grid.piece(foot + ray * further)
    };
    (0..view.weight.len())
        .map(|pixel| shown(pixel).unwrap_or(NOWHERE))
        .collect()
}

/// How much contrast the views show of each square: the standard deviation of brightness within a view, summed over views.
fn contrasts(views: &[View], shown: &[Vec<u32>], squares: usize) -> Vec<f64> {
    let mut contrasts = vec![0.0; squares];
    for (view, shown) in views.iter().zip(shown) {
        // Count, sum, sum of squares.
        let mut sums = vec![[0.0f64; 3]; squares];
        for (pixel, &piece) in shown.iter().enumerate().filter(|(_, piece)| **piece != NOWHERE) {
            let bands = (0..view.image.bands).map(|band| f64::from(view.image.plane(band)[pixel]));
            let value = bands.sum::<f64>() / view.image.bands as f64;
            let sum = &mut sums[piece as usize / (PIECES * PIECES)];
            *sum = [sum[0] + 1.0, sum[1] + value, sum[2] + value * value];
        }
        for (contrast, [count, sum, squared]) in contrasts.iter_mut().zip(sums) {
            if count >= FEWEST_PIXELS as f64 {
                *contrast += (squared / count - (sum / count).powi(2)).max(0.0).sqrt();
            }
        }
    }
    contrasts
}

/// Up to `most` squares of the ground, those of most contrast first.
pub(super) fn windows(parameters: &Parameters, views: &[View], area: &Area, seed: u64, most: usize) -> Vec<Window> {
    let gaussians = &parameters.gaussians;
    let grid = Grid::new(area);
    let shown: Vec<Vec<u32>> = views.iter().map(|view| pieces_shown(gaussians, view, &grid)).collect();
    let contrasts = contrasts(views, &shown, grid.count[0] * grid.count[1]);
    let mut squares: Vec<usize> = (0..contrasts.len()).filter(|&square| contrasts[square] > 0.0).collect();
    squares.sort_by(|&a, &b| contrasts[b].total_cmp(&contrasts[a]).then(a.cmp(&b)));
    let found = squares.into_iter().filter_map(|square| {
        let cuts: Vec<Cut> = views
            .iter()
            .zip(&shown)
            .enumerate()
            .filter_map(|(place, (view, shown))| cut(view, shown, square, seed ^ (place as u64) << 32))
            .collect();
        let gaussians = around(gaussians, grid.corners(square), &suns(views));
        // One view alone is not predicted by others.
        (cuts.len() > 1 && !gaussians.0.is_empty()).then_some(Window {
            gaussians: gaussians.0,
            bounds: gaussians.1,
            cuts,
            pieces: PIECES * PIECES,
        })
    });
    found.take(most).collect()
}

/// A number from 0 to 1 that depends on the tile alone (the finaliser of SplitMix64; Steele et al. 2014).
fn draw(seed: u64, square: usize, tile: (usize, usize)) -> f64 {
    let mut h = seed ^ (square as u64) << 44 ^ (tile.0 as u64) << 16 ^ tile.1 as u64;
    h = h.wrapping_add(0x9e37_79b9_7f4a_7c15);
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((h ^ (h >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// What `view`, whose pixels show the pieces `shown`, shows of a square.
fn cut(view: &View, shown: &[u32], square: usize, seed: u64) -> Option<Cut> {
    let width = view.camera.width;
    let own = |pixel: usize| {
        let piece = shown[pixel];
        (piece != NOWHERE && piece as usize / (PIECES * PIECES) == square).then_some(piece as usize % (PIECES * PIECES))
    };
    let pixels: Vec<usize> = (0..shown.len()).filter(|&pixel| own(pixel).is_some()).collect();
    if pixels.len() < FEWEST_PIXELS {
        return None;
    }
    let columns = pixels.iter().map(|pixel| pixel % width);
    let (first, last) = columns.fold((width, 0), |(first, last), c| (first.min(c), last.max(c)));
    let (top, bottom) = (pixels[0] / width, pixels[pixels.len() - 1] / width);
    let (col0, row0) = (first.saturating_sub(BORDER_PX), top.saturating_sub(BORDER_PX));
    let crop = Crop {
        col0,
        row0,
        width: (last + BORDER_PX + 1).min(width) - col0,
        height: (bottom + BORDER_PX + 1).min(view.camera.height) - row0,
    };
    let mut camera = view.camera.shifted(-(col0 as f32), -(row0 as f32));
    (camera.width, camera.height) = (crop.width, crop.height);
    let place = |pixel: usize| (row0 + pixel / crop.width) * width + col0 + pixel % crop.width;
    let mut weight = vec![0.0; crop.width * crop.height];
    let mut aside = Vec::new();
    for (pixel, weight) in weight.iter_mut().enumerate() {
        let Some(piece) = own(place(pixel)) else { continue };
        let (col, row) = (pixel % crop.width, pixel / crop.width);
        if draw(seed, square, (col / TILE_PX, row / TILE_PX)) >= ASIDE {
            *weight = view.weight[place(pixel)];
            continue;
        }
        let inside = |at: usize| (RIM_PX..TILE_PX - RIM_PX).contains(&(at % TILE_PX));
        if inside(col) && inside(row) {
            aside.push((pixel, piece));
        }
    }
    let prior = view.visibility_prior.as_ref();
    Some(Cut {
        view: View {
            name: view.name.clone(),
            camera,
            image: crop.cut(&view.image).into(),
            light: view.light,
            appearance: view.appearance,
            visibility_prior: prior.map(|prior| (0..weight.len()).map(|pixel| prior[place(pixel)]).collect()),
            ceiling: view.ceiling.clone(),
            weight,
        },
        aside,
    })
}

/// Directions toward the suns of views, each once.
fn suns(views: &[View]) -> Vec<Vec3> {
    let suns = views.iter().filter_map(|view| match view.light {
        Some(Light::Directional(sun)) if sun.z > 0.05 => Some(sun.to_array().map(f32::to_bits)),
        _ => None,
    });
    let distinct: BTreeSet<[u32; 3]> = suns.collect();
    distinct
        .into_iter()
        .map(|sun| Vec3::from(sun.map(f32::from_bits)))
        .collect()
}

/// The Gaussians in and around a square, with those that may throw a shadow into it, and the box that holds them.
fn around(gaussians: &Table, corners: [[f32; 2]; 2], suns: &[Vec3]) -> (Vec<u32>, (Vec3, Vec3)) {
    let [[west, south], [east, north]] = corners;
    let within = |at: Vec3, margin: f32| {
        at.x >= west - margin && at.x < east + margin && at.y >= south - margin && at.y < north + margin
    };
    let near: Vec<u32> = (0..gaussians.count as u32)
        .filter(|&g| within(gaussians.position(g as usize), SHADOW_M))
        .collect();
    let own = near
        .iter()
        .map(|&g| gaussians.position(g as usize))
        .filter(|&at| within(at, 0.0));
    let ground_m = own.fold(f32::INFINITY, |low, at| low.min(at.z));
    let shades = |at: Vec3, sun: Vec3| {
        let whole = (at.z - ground_m).max(0.0) / sun.z;
        (1..=RAY_PLACES).any(|n| within(at - sun * (whole * n as f32 / RAY_PLACES as f32), 0.0))
    };
    let kept: Vec<u32> = near
        .into_iter()
        .filter(|&g| {
            let at = gaussians.position(g as usize);
            within(at, MARGIN_M) || suns.iter().any(|&sun| shades(at, sun))
        })
        .collect();
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for &g in &kept {
        let at = gaussians.position(g as usize);
        (low, high) = (low.min(at), high.max(at));
    }
    let slack = Vec3::splat(MARGIN_M);
    (kept, (low - slack, high + slack))
}
