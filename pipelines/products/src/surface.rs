//! Altitude of the surface of Gaussians in the cells of a grid, seen from straight above.
//!
//! A single ray through the middle of every cell errs beside walls, for two reasons:
//! * Gaussians let light through independently of each other, but those of a wall stand one below the other. Ten of
//!   them, each of which shows a fifth of itself in the cell beside the wall, would cover nine tenths of that cell, and
//!   its altitude would be somewhere in the wall. So upright Gaussians count as far as they face up; but leaves
//!   (`leaves.rs`), which have no sides, count whole.
//! * Altitudes differ within a cell, and the altitude of a cell is their median. So every cell is sampled at 3 x 3
//!   places.
//!
//! Cells whose rays meet surfaces at many altitudes are uncertain, and take the altitude of the certain cells around
//! them ([`smooth_by_deviation`]); crowns keep their roughness.
//!
//! Ablations are in docs/lab/surface.md.

use crate::leaves::{FromAbove, LeafIndex};
use crate::model::LoadedModel;
use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{OPACITY, Table, logit};
use heliosplat::render::{depths, depths_and};
use heliosplat::splat::{Maps, ProjectionOptions};
use heliosplat_grid::statistics::upper_median;
use heliosplat_grid::{in_parallel, smooth_by_deviation};
use heliosplat_scene::indices::VegetationIndex;
use rayon::prelude::*;

/// Alpha below which a pixel has no altitude.
pub(super) const ALPHA_KNOWN: f32 = 0.5;

/// Sampled places along each side of a cell.
const PLACES: usize = 3;
/// Share of a cell's uncertainty that is left where leaves are the surface by excess green alone: lawns have it too,
/// and uncertain altitudes above them are no crown (docs/lab/surface.md, by ablation).
const GREEN_DOUBT: f32 = 0.5;
/// Leaves within this distance of the surface are the surface, metres.
const ONE_CROWN_M: f32 = 1.0;

/// Gaussians of a satellite model, with the properties from which their surface follows.
#[derive(Clone, Copy)]
pub struct SurfaceGaussians<'a> {
    /// Table of the Gaussians.
    pub gaussians: &'a Table,
    /// Number of bands of their albedo.
    pub bands: usize,
    /// Vegetation index that separates leaves by these bands, if there is one.
    pub leaves: Option<VegetationIndex>,
    /// Options of their projection to splats.
    pub projection: ProjectionOptions,
    /// Ground sampling distance of the images that they were trained on, metres.
    pub gsd_m: f32,
}

impl SurfaceGaussians<'_> {
    /// Share of a cell's uncertainty that is left where leaves are the surface.
    fn doubt_of_leaves(&self) -> f32 {
        match self.leaves {
            Some(VegetationIndex::Green(_)) => GREEN_DOUBT,
            _ => 0.0,
        }
    }
}

impl<'a> From<&'a LoadedModel> for SurfaceGaussians<'a> {
    fn from(model: &'a LoadedModel) -> Self {
        Self {
            gaussians: &model.parameters.gaussians,
            bands: model.file.bands.len(),
            leaves: model.file.vegetation_index(),
            projection: model.file.projection,
            gsd_m: model.file.gsd_m as f32,
        }
    }
}

/// Coverage, altitude and spread of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    /// Accumulated alpha, 0 to 1.
    pub coverage: f32,
    /// Altitude above the frame's origin, metres; NaN where unknown.
    pub up_m: f32,
    /// Mean squared distance between that altitude and the Gaussians along a ray, metres².
    pub spread_m2: f32,
}

/// Cells of a surface: the pixels, `cell_m` metres wide, of `nadir`, a camera that looks straight down.
pub(super) fn cells(input: &SurfaceGaussians, nadir: &ProjectiveCamera, cell_m: f32) -> Vec<Cell> {
    let leaves = input.leaves;
    let index = leaves.map(|index| LeafIndex::new(index, input.gaussians, input.bands));
    let of_leaf = |g: usize| index.as_ref().map_or(0.0, |index| index.of(g));
    let all = depths_and(input.gaussians, nadir, &input.projection, of_leaf);
    let is_leaf = index.map(|index| {
        let known = |value: fn(&Maps, usize) -> f32| -> Vec<f32> {
            let mut values: Vec<f32> = (0..all.alpha.len()).map(|i| value(&all, i)).collect();
            forget_thin(&mut values, &all.alpha);
            values
        };
        let seen = FromAbove {
            index: known(|all, i| all.channels[0][i] / all.alpha[i]),
            up_m: known(|all, i| -all.median_depth[i]),
            cell_m,
            gsd_m: input.gsd_m,
        };
        index.leaves(nadir, &seen)
    });
    let looks = looks(input, is_leaf.as_deref(), nadir);
    let count = all.alpha.len();
    // Cliffs have no upward face: there the depths of all Gaussians along one ray serve.
    let or = |depth: Option<f32>, of_all: f32| depth.unwrap_or(of_all);
    let depths = |i: usize| {
        [
            or(median_of(&looks, |look| look.near_depth[i]), all.near_depth[i]),
            or(median_of(&looks, |look| look.median_depth[i]), all.median_depth[i]),
            or(median_of(&looks, |look| look.far_depth[i]), all.far_depth[i]),
        ]
    };
    let range: Vec<[f32; 3]> = in_parallel(count).map(depths).collect();
    let leaves = is_leaf.map_or(Vec::new(), |is_leaf| leaf_depths(input, &is_leaf, nadir));
    let known = |i: usize| all.alpha[i] >= ALPHA_KNOWN;
    let up = |i: usize| if known(i) { -range[i][1] } else { f32::NAN };
    let mut up_m: Vec<f32> = (0..count).map(up).collect();
    let doubt = |i: usize| {
        let doubt_m = 0.5 * (range[i][2] - range[i][0]);
        match leaves.get(i) {
            Some(&leaf) if (leaf - range[i][1]).abs() < ONE_CROWN_M => input.doubt_of_leaves() * doubt_m,
            _ => doubt_m,
        }
    };
    let doubt_m: Vec<f32> = (0..count).map(doubt).collect();
    smooth_by_deviation(nadir.width, cell_m, &mut up_m, &doubt_m);
    in_parallel(count)
        .map(|i| {
            let coverage = all.alpha[i];
            let mean = all.depth[i] / coverage;
            let variance = (all.depth_square[i] / coverage - mean * mean).max(0.0);
            Cell {
                coverage,
                up_m: up_m[i],
                spread_m2: variance + (up_m[i] + mean).powi(2),
            }
        })
        .collect()
}

/// Median of a depth over the sampled places that have one.
fn median_of(looks: &[Maps], depth: impl Fn(&Maps) -> f32) -> Option<f32> {
    let mut known: Vec<f32> = looks.iter().map(depth).filter(|z| z.is_finite()).collect();
    upper_median(&mut known)
}

/// Median depths of leaves alone, metres; NaN where their coverage is low.
fn leaf_depths(input: &SurfaceGaussians, is_leaf: &[bool], nadir: &ProjectiveCamera) -> Vec<f32> {
    let mut alone = input.gaussians.clone();
    for (opacity, &is_leaf) in alone.group_mut(OPACITY).iter_mut().zip(is_leaf) {
        if !is_leaf {
            *opacity = logit(f32::MIN_POSITIVE);
        }
    }
    let mut seen = depths(&alone, nadir, &input.projection);
    forget_thin(&mut seen.median_depth, &seen.alpha);
    seen.median_depth
}

/// Depths of upward faces at each of the sampled places of the cells.
fn looks(input: &SurfaceGaussians, is_leaf: Option<&[bool]>, nadir: &ProjectiveCamera) -> Vec<Maps> {
    let facing = facing_up(input.gaussians, is_leaf);
    // The filter of a pixel as wide as a sampled place.
    let projection = ProjectionOptions {
        filter_px2: input.projection.filter_px2 / (PLACES * PLACES) as f32,
        ..input.projection
    };
    let aside = |k: usize| (k as f32 - (PLACES - 1) as f32 / 2.0) / PLACES as f32;
    let look = |place: usize| {
        let camera = nadir.shifted(aside(place % PLACES), aside(place / PLACES));
        let mut seen = depths(&facing, &camera, &projection);
        for plane in [&mut seen.near_depth, &mut seen.median_depth, &mut seen.far_depth] {
            forget_thin(plane, &seen.alpha);
        }
        // The other planes would stay in memory for each place.
        Maps {
            near_depth: seen.near_depth,
            median_depth: seen.median_depth,
            far_depth: seen.far_depth,
            ..Maps::default()
        }
    };
    (0..PLACES * PLACES).map(look).collect()
}

/// Sets depths to NaN where the coverage is low.
pub(crate) fn forget_thin(depth: &mut [f32], alpha: &[f32]) {
    for (depth, &alpha) in depth.iter_mut().zip(alpha) {
        if alpha < ALPHA_KNOWN {
            *depth = f32::NAN;
        }
    }
}

/// The Gaussians with opacities reduced by their slope: unchanged up to 45 degrees, times `2 cos²` of the slope beyond.
/// Leaves stay as they are.
fn facing_up(gaussians: &Table, is_leaf: Option<&[bool]>) -> Table {
    let mut out = gaussians.clone();
    let opacities = out.group_mut(OPACITY).par_iter_mut().with_min_len(1024);
    opacities.enumerate().for_each(|(g, opacity)| {
        let scale = gaussians.scale(g);
        let thinnest = (0..3).min_by(|&a, &b| scale[a].total_cmp(&scale[b])).unwrap_or(2);
        let up = gaussians.rotation(g).col(thinnest).z;
        let share = 2.0 * up * up;
        if share < 1.0 && !is_leaf.is_some_and(|is_leaf| is_leaf[g]) {
            *opacity = logit((gaussians.opacity(g) * share).max(f32::MIN_POSITIVE));
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};
    use heliosplat::gaussians::{GroupSpec, LOG_SCALE, POSITION, ROTATION, core_groups};
    use heliosplat::model::shadow_gs::ALBEDO;
    use heliosplat_scene::{BandKind, Values};

    const CELL_M: f32 = 0.5;
    const BANDS: [BandKind; 2] = [BandKind::Red, BandKind::NearInfrared];

    /// Discs of 0.65 cells, 0.3 thick, given by their places, how they are turned, and their near infrared where red is
    /// 0.2.
    fn discs(of: &[(Vec3, Quat, f32)]) -> Table {
        let mut groups = core_groups();
        groups.push(GroupSpec::new("albedo", BANDS.len()));
        let mut table = Table::zeros(groups, of.len());
        let across = (0.65 * CELL_M).ln();
        for (i, (place, turn, infrared)) in of.iter().enumerate() {
            table.group_mut(POSITION)[3 * i..3 * i + 3].copy_from_slice(&place.to_array());
            table.group_mut(ROTATION)[4 * i..4 * i + 4].copy_from_slice(&turn.to_array());
            table.group_mut(LOG_SCALE)[3 * i..3 * i + 3].copy_from_slice(&[across, across, (0.3 * CELL_M).ln()]);
            table.group_mut(OPACITY)[i] = logit(0.9);
            table.group_mut(ALBEDO)[2 * i..2 * i + 2].copy_from_slice(&[0.2, *infrared]);
        }
        table
    }

    /// Level ground of 16 x 16 cells, one disc in the middle of each.
    fn ground() -> Vec<(Vec3, Quat, f32)> {
        let place = |i: usize| Vec3::new((i % 16) as f32 + 0.5, -((i / 16) as f32 + 0.5), 0.0) * CELL_M;
        (0..256).map(|i| (place(i), Quat::IDENTITY, 0.2)).collect()
    }

    fn look(of: &[(Vec3, Quat, f32)]) -> Vec<Cell> {
        let table = discs(of);
        let input = SurfaceGaussians {
            gaussians: &table,
            bands: BANDS.len(),
            leaves: Values::default().vegetation_index(&BANDS),
            projection: ProjectionOptions::default(),
            gsd_m: CELL_M,
        };
        cells(&input, &above(1), CELL_M)
    }

    /// A camera above the ground that cuts each side of a cell into `places`.
    fn above(places: usize) -> ProjectiveCamera {
        let pixel_m = f64::from(CELL_M) / places as f64;
        ProjectiveCamera::nadir(0.5 * pixel_m, -0.5 * pixel_m, pixel_m, (16 * places, 16 * places))
    }

    /// Upright discs one below the other over the boundary of columns 7 and 8, as walls are.
    fn wall(infrared: f32) -> Vec<(Vec3, Quat, f32)> {
        let upright = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let stack = |i: usize| Vec3::new(8.0, -((i / 40) as f32 + 0.5), (i % 40) as f32 * 0.5 + 0.5) * CELL_M;
        (0..640).map(|i| (stack(i), upright, infrared)).collect()
    }

    #[test]
    fn a_wall_is_no_surface_and_leaves_are() {
        let of = |infrared: f32| look(&[ground(), wall(infrared)].concat());
        let beside = 8 * 16 + 8;
        assert!(of(0.2)[beside].up_m.abs() < 0.05, "{:?}", of(0.2)[beside]);
        assert!(of(0.8)[beside].up_m > 2.0, "{:?}", of(0.8)[beside]);
        assert!(of(0.2)[beside].spread_m2 > 1.0, "in doubt: {:?}", of(0.2)[beside]);
    }

    #[test]
    fn a_cliff_has_an_altitude() {
        let cells = look(&wall(0.2));
        let cell = cells[8 * 16 + 8];
        assert!(cell.coverage > 0.5 && cell.up_m > 2.0, "{cell:?}");
    }

    #[test]
    fn a_steep_roof_stays_where_it_is() {
        // 60 degrees up to the east: twice as many discs per cell, since it has twice the area.
        let turn = Quat::from_rotation_y(-std::f32::consts::FRAC_PI_3);
        let place = |i: usize| {
            let (column, row) = ((i % 32) as f32 / 2.0 + 0.25, (i / 32) as f32 + 0.5);
            Vec3::new(column, -row, column * 3f32.sqrt()) * CELL_M
        };
        let roof: Vec<_> = (0..512).map(|i| (place(i), turn, 0.2)).collect();
        let (table, middle) = (discs(&roof), 8 * 16 + 8);
        let all = depths(&table, &above(1), &ProjectionOptions::default()).median_depth[middle];
        let cell = look(&roof)[middle];
        assert!((cell.up_m - 8.5 * 3f32.sqrt() * CELL_M).abs() < 0.3, "{cell:?}");
        assert!(
            (cell.up_m + all).abs() < 0.1,
            "{cell:?}, all that stands is at {}",
            -all
        );
    }

    #[test]
    fn a_cell_is_as_high_as_most_of_it() {
        let beside = |end: f32| {
            let place = move |i: usize| Vec3::new(end - (i % 8) as f32, -((i / 8) as f32 + 0.5), 8.0) * CELL_M;
            let roof = (0..128).map(move |i| (place(i), Quat::IDENTITY, 0.2));
            ground().into_iter().chain(roof).collect::<Vec<_>>()
        };
        let mut seen = [0, 0];
        for tenth in 65..90 {
            let scene = beside(tenth as f32 / 10.0);
            let depths = depths(&discs(&scene), &above(30), &ProjectionOptions::default()).median_depth;
            let places = (0..900).map(|i| depths[(8 * 30 + i / 30) * 480 + 8 * 30 + i % 30]);
            let roofed = places.filter(|&depth| depth < -2.0).count();
            let up_m = look(&scene)[8 * 16 + 8].up_m;
            match roofed {
                0..=300 => assert!(up_m.abs() < 0.05, "{roofed} of 900 places: {up_m}"),
                600..=900 => assert!((up_m - 4.0).abs() < 0.05, "{roofed} of 900 places: {up_m}"),
                _ => {}
            }
            seen[usize::from(roofed > 450)] += usize::from(roofed > 0 && roofed < 900);
        }
        assert!(seen.iter().all(|&cells| cells > 0), "cells of either kind: {seen:?}");
    }
}
