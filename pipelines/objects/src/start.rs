//! Initial positions of Gaussians: on the visual hull where coverage is known, else on the points of the
//! reconstruction, else anywhere in view.
//!
//! The visual hull (Laurentini 1994) is the intersection of all silhouettes: cells of a grid covered in every image
//! that shows them. Its outermost cells get a Gaussian each.

use super::capture::Frame;
use super::config::StartOptions;
use super::points::Point;
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
const FIRST_GRID: f64 = 128.0;
/// Most cells of a grid.
const MOST_CELLS: f64 = 8e6;
/// Radius in cells over which the outward direction is estimated.
const REACH: i64 = 2;
/// Standard deviation of a Gaussian, cells.
const SPREAD: f64 = 0.6;
/// Fewest points of a reconstruction to start from.
const LEAST_POINTS: usize = 100;
/// Neighbours of a point that determine its Gaussian's standard deviation (Kerbl et al. 2023).
const NEAREST: usize = 3;

/// A seed of a Gaussian: its centre in the frame of the model, and the colour of the images there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seed {
    /// Centre in the frame of the model, in the capture's units.
    pub position: Vec3,
    /// Median colour over the images that show the centre; 0.5 where none does.
    pub colour: [f32; 3],
    /// Unit vector out of the hull; zero where there is none.
    pub normal: Vec3,
    /// Standard deviation along all axes, in the capture's units.
    pub spread: f32,
}

/// Initial Gaussians of a training.
#[derive(Debug, Clone)]
pub struct Start {
    /// Centres, colours and normals of the Gaussians.
    pub seeds: Vec<Seed>,
    /// True if the Gaussians are on the visual hull.
    pub on_hull: bool,
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
        let (pixel, ahead) = self.camera.pixel(point)?;
        (ahead > 1e-6).then_some(pixel)
    }

    fn covers(&self, pixel: usize) -> bool {
        self.frame.picture.coverage.as_ref().is_none_or(|c| c[pixel] > COVERED)
    }
}

/// Places Gaussians in the cube of half side `half_size` around `centre`, in the capture's units: on the visual hull
/// where all frames have coverage, else on `points`, else at random.
pub fn start(
    frames: &[&Frame],
    points: &[Point],
    centre: DVec3,
    half_size: f64,
    options: &StartOptions,
    seed: u64,
) -> Start {
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
    let mut seeds_at = |points: Vec<(DVec3, Vec3)>, jitter: f64, spread: f64| -> Vec<Seed> {
        let mut shaken: Vec<(Vec3, Vec3)> = Vec::with_capacity(points.len());
        for (point, normal) in points {
            let mut aside = || jitter * (random.random::<f64>() - 0.5);
            shaken.push(((point + DVec3::new(aside(), aside(), aside())).as_vec3(), normal));
        }
        let seed = |&(position, normal): &(Vec3, Vec3)| Seed {
            position,
            colour: colour_at(&sights, position),
            normal,
            spread: spread as f32,
        };
        shaken.par_iter().with_min_len(256).map(seed).collect()
    };
    let hull = (known && sights.len() > 1).then(|| Hull::about(&sights, half_size, options.gaussians));
    let hull = hull.filter(|hull| !hull.shell.is_empty());
    let on_hull = hull.is_some();
    let (seeds, how) = if let Some(Hull { cell, shell }) = hull {
        (seeds_at(shell, 0.5 * cell, SPREAD * cell), "on the visual hull")
    } else {
        let seeds = seeds_of(points, centre, half_size, options.gaussians);
        let count = options.gaussians.max(1);
        let anywhere = vec![(DVec3::ZERO, Vec3::ZERO); count];
        let spread = half_size / (count as f64).cbrt();
        match seeds.len() >= LEAST_POINTS {
            true => (seeds, "on the points of the reconstruction"),
            false => (seeds_at(anywhere, 2.0 * half_size, spread), "anywhere in sight"),
        }
    };
    Start { seeds, on_hull, how }
}

/// Seeds on the points inside the cube of half side `half_size` around `centre`, evenly thinned to `most`.
fn seeds_of(points: &[Point], centre: DVec3, half_size: f64, most: usize) -> Vec<Seed> {
    let inside = |point: &&Point| (point.position - centre).abs().max_element() < half_size;
    let inside: Vec<&Point> = points.iter().filter(inside).collect();
    let count = inside.len().min(most);
    let mut seeds: Vec<Seed> = (0..count)
        .map(|n| {
            let point = inside[n * inside.len() / count];
            Seed {
                position: (point.position - centre).as_vec3(),
                colour: point.colour,
                normal: Vec3::ZERO,
                spread: 0.0,
            }
        })
        .collect();
    seeds.sort_by(|a, b| a.position.x.total_cmp(&b.position.x));
    let widest = (half_size / (count.max(1) as f64).cbrt()) as f32;
    let spreads: Vec<f32> = (0..count)
        .into_par_iter()
        .with_min_len(256)
        .map(|n| spread_at(&seeds, n).min(widest))
        .collect();
    seeds
        .iter_mut()
        .zip(spreads)
        .for_each(|(seed, spread)| seed.spread = spread);
    seeds
}

/// Root mean square distance of seed `n` to its [`NEAREST`] neighbours; the seeds are in the order of their x.
fn spread_at(seeds: &[Seed], n: usize) -> f32 {
    let here = seeds[n].position;
    let mut nearest = [f32::INFINITY; NEAREST];
    let mut visit = |seed: &Seed| {
        let away = seed.position - here;
        let squared = away.length_squared();
        if squared < nearest[NEAREST - 1] {
            nearest[NEAREST - 1] = squared;
            nearest.sort_by(f32::total_cmp);
        }
        away.x * away.x < nearest[NEAREST - 1]
    };
    let _ = seeds[..n].iter().rev().all(&mut visit) | seeds[n + 1..].iter().all(&mut visit);
    (nearest.iter().sum::<f32>() / NEAREST as f32).sqrt()
}

struct Hull {
    cell: f64,
    /// Centres of the outermost cells, and unit vectors out of the hull.
    shell: Vec<(DVec3, Vec3)>,
}

/// A grid of cubic cells.
#[derive(Clone, Copy)]
struct Grid {
    /// Lowest corner.
    low: DVec3,
    cell: f64,
    size: [usize; 3],
}

impl Grid {
    /// A grid of cells of about the side `cell`, at most [`MOST_CELLS`], over a box.
    fn over(low: DVec3, high: DVec3, cell: f64) -> Self {
        let extent = high - low;
        let least = (extent.element_product() / MOST_CELLS).cbrt();
        let cell = cell.max(least);
        Self {
            low,
            cell,
            size: extent.to_array().map(|side| ((side / cell).ceil() as usize).max(1)),
        }
    }

    fn cells(&self) -> usize {
        self.size.iter().product()
    }

    fn at(&self, i: usize) -> [usize; 3] {
        let [x, y, _] = self.size;
        [i % x, i / x % y, i / x / y]
    }

    fn centre(&self, i: usize) -> DVec3 {
        self.low + (DVec3::from(self.at(i).map(|n| n as f64)) + 0.5) * self.cell
    }
}

impl Hull {
    /// A hull in the cube of half side `half_size` whose shell has about `wanted` cells.
    fn about(sights: &[Sight], half_size: f64, wanted: usize) -> Self {
        let cube = DVec3::splat(half_size);
        let first = Self::new(sights, &Grid::over(-cube, cube, 2.0 * half_size / FIRST_GRID));
        if first.shell.is_empty() {
            return first;
        }
        // The shell is a surface: the number of its cells grows with the square of the resolution.
        let cell = first.cell * (first.shell.len() as f64 / wanted as f64).sqrt();
        let centres = || first.shell.iter().map(|(centre, _)| *centre);
        let margin = DVec3::splat(2.0 * first.cell);
        let low = centres().fold(cube, DVec3::min) - margin;
        let high = centres().fold(-cube, DVec3::max) + margin;
        Self::new(sights, &Grid::over(low, high, cell.min(half_size / 8.0)))
    }

    fn new(sights: &[Sight], grid: &Grid) -> Self {
        let inside = |i: usize| {
            let (mut shown, point) = (0, grid.centre(i).as_vec3());
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
        let filled: Vec<bool> = (0..grid.cells())
            .into_par_iter()
            .with_min_len(4096)
            .map(inside)
            .collect();
        let [width, height, depth] = grid.size;
        let is_shell = |&i: &usize| {
            let edge = (0..3).any(|k| grid.at(i)[k] == 0 || grid.at(i)[k] + 1 == grid.size[k]);
            let strides = [1, width, width * height];
            filled[i] && (edge || strides.iter().any(|s| !filled[i - s] || !filled[i + s]))
        };
        let open = |[x, y, z]: [i64; 3]| {
            let inside =
                (0..width as i64).contains(&x) && (0..height as i64).contains(&y) && (0..depth as i64).contains(&z);
            !inside || !filled[(x as usize) + width * (y as usize + height * z as usize)]
        };
        // Away from the mass of the cells around.
        let normal = |i: usize| {
            let [x, y, z] = grid.at(i).map(|n| n as i64);
            let mut out = Vec3::ZERO;
            for dz in -REACH..=REACH {
                for dy in -REACH..=REACH {
                    for dx in -REACH..=REACH {
                        if open([x + dx, y + dy, z + dz]) {
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
            .map(|i| (grid.centre(i), normal(i)))
            .collect();
        Self { cell: grid.cell, shell }
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
        table.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].fill(seed.spread.max(1e-9).ln());
    }
    table.group_mut(OPACITY).fill(logit(opacity.clamp(0.01, 0.99)));
    table
}
