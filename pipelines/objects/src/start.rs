//! Initial positions of Gaussians: on the visual hull where coverage is known, else anywhere in view.
//!
//! The visual hull (Laurentini 1994) is the intersection of all silhouettes: cells of a grid covered in every image
//! that shows them. Its outermost cells get a Gaussian each.

use super::capture::Frame;
use super::config::StartOptions;
use glam::{DVec3, Vec3};
use heliosplat::gaussians::{GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_grid::statistics::upper_median;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rayon::prelude::*;

/// Coverage from which on a pixel shows the object.
const COVERED: f32 = 0.3;
/// Cells along a side of the grid that is tried first.
const FIRST_GRID: usize = 64;
/// Fewest and most cells along a side.
const GRID: (usize, usize) = (16, 192);
/// Radius in cells over which the outward direction is estimated.
const REACH: i64 = 2;
/// Standard deviation of a Gaussian, cells.
const SPREAD: f64 = 0.6;

/// A seed of a Gaussian: its centre in the frame of the model, and the colour of the images there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seed {
    /// Centre in the frame of the model, in the capture's units.
    pub position: Vec3,
    /// Median colour over the images that show the centre; 0.5 where none does.
    pub colour: [f32; 3],
    /// Unit vector out of the hull; zero where there is none.
    pub normal: Vec3,
}

/// Initial Gaussians of a training.
#[derive(Debug, Clone)]
pub struct Start {
    /// Centres, colours and normals of the Gaussians.
    pub seeds: Vec<Seed>,
    /// Standard deviation of each Gaussian along all axes, in the capture's units.
    pub spread: f32,
    /// Place of the Gaussians, in words.
    pub how: &'static str,
}

struct Sight<'a> {
    camera: ProjectiveCamera,
    frame: &'a Frame,
}

impl Sight<'_> {
    /// The pixel that shows a point, if any does.
    fn pixel(&self, point: Vec3) -> Option<usize> {
        let (col, row, ahead) = self.camera.project(point);
        let (col, row) = (col.round(), row.round());
        let inside = col >= 0.0 && row >= 0.0 && col < self.camera.width as f32 && row < self.camera.height as f32;
        (ahead > 1e-6 && inside).then(|| row as usize * self.camera.width + col as usize)
    }

    fn covers(&self, pixel: usize) -> bool {
        self.frame.picture.coverage.as_ref().is_none_or(|c| c[pixel] > COVERED)
    }
}

/// Places Gaussians in the cube of half side `half_size` around `centre`, in the capture's units: on the visual hull
/// where all frames have coverage, else at random.
pub fn start(frames: &[&Frame], centre: DVec3, half_size: f64, options: &StartOptions, seed: u64) -> Start {
    let sights: Vec<Sight> = frames
        .iter()
        .filter_map(|&frame| {
            Some(Sight {
                camera: frame.camera.projective(centre)?,
                frame,
            })
        })
        .collect();
    let known = frames.iter().all(|f| f.picture.coverage.is_some());
    let mut random = Pcg32::seed_from_u64(seed);
    let mut seeds_at = |points: Vec<(DVec3, Vec3)>, jitter: f64| -> Vec<Seed> {
        let mut shaken: Vec<(Vec3, Vec3)> = Vec::with_capacity(points.len());
        for (point, normal) in points {
            let mut aside = || jitter * (random.random::<f64>() - 0.5);
            shaken.push(((point + DVec3::new(aside(), aside(), aside())).as_vec3(), normal));
        }
        let seed = |&(position, normal): &(Vec3, Vec3)| Seed {
            position,
            colour: colour_at(&sights, position),
            normal,
        };
        shaken.par_iter().with_min_len(256).map(seed).collect()
    };
    if known && sights.len() > 1 {
        let hull = Hull::about(&sights, half_size, options.gaussians);
        if !hull.shell.is_empty() {
            return Start {
                seeds: seeds_at(hull.shell, 0.5 * hull.cell),
                spread: (SPREAD * hull.cell) as f32,
                how: "on the visual hull",
            };
        }
    }
    let side = (options.gaussians.max(1) as f64).cbrt();
    let spots = vec![(DVec3::ZERO, Vec3::ZERO); options.gaussians.max(1)];
    Start {
        seeds: seeds_at(spots, 2.0 * half_size),
        spread: (half_size / side) as f32,
        how: "anywhere in sight",
    }
}

struct Hull {
    cell: f64,
    /// Centres of the outermost cells, and unit vectors out of the hull.
    shell: Vec<(DVec3, Vec3)>,
}

impl Hull {
    /// A hull whose shell has about `wanted` cells.
    fn about(sights: &[Sight], half_size: f64, wanted: usize) -> Self {
        let first = Self::new(sights, half_size, FIRST_GRID);
        if first.shell.is_empty() {
            return first;
        }
        // A surface: cells grow with the square of the grid.
        let scale = (wanted as f64 / first.shell.len() as f64).sqrt();
        let side = ((FIRST_GRID as f64 * scale).round() as usize).clamp(GRID.0, GRID.1);
        if side == FIRST_GRID {
            first
        } else {
            Self::new(sights, half_size, side)
        }
    }

    fn new(sights: &[Sight], half_size: f64, side: usize) -> Self {
        let cell = 2.0 * half_size / side as f64;
        let centre = |i: usize| (i as f64 + 0.5) * cell - half_size;
        let place = |i: usize| DVec3::new(centre(i % side), centre(i / side % side), centre(i / side / side));
        let inside = |i: usize| {
            let (mut shown, point) = (0, place(i).as_vec3());
            for sight in sights {
                if let Some(pixel) = sight.pixel(point) {
                    shown += 1;
                    if !sight.covers(pixel) {
                        return false;
                    }
                }
            }
            shown > 1
        };
        let filled: Vec<bool> = (0..side * side * side)
            .into_par_iter()
            .with_min_len(4096)
            .map(inside)
            .collect();
        let is_shell = |&i: &usize| {
            let (x, y, z) = (i % side, i / side % side, i / side / side);
            let edge = [x, y, z].iter().any(|&c| c == 0 || c + 1 == side);
            let strides = [1, side, side * side];
            filled[i] && (edge || strides.iter().any(|s| !filled[i - s] || !filled[i + s]))
        };
        let open = |x: i64, y: i64, z: i64| {
            let inside = [x, y, z].iter().all(|c| (0..side as i64).contains(c));
            !inside || !filled[(x as usize) + side * (y as usize + side * z as usize)]
        };
        // Away from the mass of the cells around.
        let normal = |i: usize| {
            let (x, y, z) = ((i % side) as i64, (i / side % side) as i64, (i / side / side) as i64);
            let mut out = Vec3::ZERO;
            for dz in -REACH..=REACH {
                for dy in -REACH..=REACH {
                    for dx in -REACH..=REACH {
                        if open(x + dx, y + dy, z + dz) {
                            out += Vec3::new(dx as f32, dy as f32, dz as f32);
                        }
                    }
                }
            }
            out.normalize_or_zero()
        };
        let cells: Vec<usize> = (0..filled.len()).filter(is_shell).collect();
        let shell = cells
            .into_par_iter()
            .with_min_len(256)
            .map(|i| (place(i), normal(i)))
            .collect();
        Self { cell, shell }
    }
}

/// Median colour of the images where they show a point.
fn colour_at(sights: &[Sight], point: Vec3) -> [f32; 3] {
    let mut seen: [Vec<f32>; 3] = Default::default();
    for sight in sights {
        let Some(pixel) = sight.pixel(point).filter(|&pixel| sight.covers(pixel)) else {
            continue;
        };
        let colour: &Raster = &sight.frame.picture.colour;
        let values: [f32; 3] = std::array::from_fn(|k| colour.plane(k)[pixel]);
        if values.iter().all(|v| v.is_finite()) {
            seen.iter_mut().zip(values).for_each(|(list, value)| list.push(value));
        }
    }
    seen.map(|mut values| upper_median(&mut values).unwrap_or(0.5))
}

/// Table of round Gaussians at the seeds with one `opacity`, limited to 0.01..0.99. The groups `features` of a model
/// are added, all zero.
pub fn gaussians(start: &Start, opacity: f32, features: Vec<GroupSpec>) -> Table {
    let mut groups = core_groups();
    groups.extend(features);
    let mut table = Table::zeros(groups, start.seeds.len());
    for (i, seed) in start.seeds.iter().enumerate() {
        table.group_mut(POSITION)[i * 3..i * 3 + 3].copy_from_slice(&seed.position.to_array());
        table.group_mut(ROTATION)[i * 4 + 3] = 1.0;
    }
    table.group_mut(LOG_SCALE).fill(start.spread.max(1e-9).ln());
    table.group_mut(OPACITY).fill(logit(opacity.clamp(0.01, 0.99)));
    table
}
