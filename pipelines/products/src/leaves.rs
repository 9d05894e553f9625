//! Classification of Gaussians as leaves by the vegetation index of their cell.
//!
//! The albedo of a single Gaussian is a weak indicator: Gaussians of one crown differ, and walls beside it have some of
//! its colour. So the index of the albedo is composited from straight above, as depths are, and averaged over
//! neighbouring cells; a Gaussian is a leaf where its cell is one. Without near infrared the index is excess green, of
//! bands divided by their medians, and counts only where the cell is raised above the ground, since lawns are green
//! too. Ablations are in docs/lab/surface.md.

use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::Table;
use heliosplat::model::shadow_gs::ALBEDO;
use heliosplat_grid::statistics::upper_median;
use heliosplat_grid::{around, in_parallel, opening};
use heliosplat_scene::indices::{VEGETATION_INDEX, VegetationIndex};
use rayon::prelude::*;

/// Excess green above which a cell is green.
const GREEN: f32 = 0.04;
/// Least height above the ground of a green cell of leaves, metres.
const RAISED_M: f32 = 3.0;
/// Half width of the opening that finds the ground, metres: objects narrower than twice this are removed.
const GROUND_REACH_M: f32 = 12.0;

/// Vegetation index of the albedo of Gaussians.
pub(super) struct LeafIndex<'a> {
    index: VegetationIndex,
    gaussians: &'a Table,
    bands: usize,
    /// White reference of each band, which divides its albedo.
    white: Vec<f32>,
}

impl<'a> LeafIndex<'a> {
    /// Index of the Gaussians of a table, whose albedo has `bands` bands.
    pub(super) fn new(index: VegetationIndex, gaussians: &'a Table, bands: usize) -> Self {
        let albedo = gaussians.group(ALBEDO);
        let white = |band: usize| match index {
            VegetationIndex::Infrared(_) => 1.0,
            VegetationIndex::Green(_) => {
                let mut values: Vec<f32> = albedo.iter().skip(band).step_by(bands).copied().collect();
                upper_median(&mut values).filter(|&median| median > 0.0).unwrap_or(1.0)
            }
        };
        Self {
            index,
            gaussians,
            bands,
            white: (0..bands).map(white).collect(),
        }
    }

    /// Vegetation index of a Gaussian, -1 to 1.
    pub(super) fn of(&self, gaussian: usize) -> f32 {
        let albedo = &self.gaussians.group(ALBEDO)[gaussian * self.bands..];
        self.index.of(|band| albedo[band] / self.white[band]).clamp(-1.0, 1.0)
    }

    /// Leaf mask of the Gaussians; `seen` is their image from `nadir`, a camera that looks straight down.
    pub(super) fn leaves(&self, nadir: &ProjectiveCamera, seen: &FromAbove) -> Vec<bool> {
        let cells = self.cells((nadir.width, nadir.height), seen);
        let leaf = |gaussian: usize| {
            let (col, row, _) = nadir.project(self.gaussians.position(gaussian));
            let inside = |at: f32, count: usize| (-0.5..count as f32 - 0.5).contains(&at);
            inside(col, nadir.width)
                && inside(row, nadir.height)
                && cells[row.round() as usize * nadir.width + col.round() as usize]
        };
        in_parallel(self.gaussians.count).map(leaf).collect()
    }

    /// Leaf mask of the cells.
    fn cells(&self, (width, height): (usize, usize), seen: &FromAbove) -> Vec<bool> {
        let reach = (seen.gsd_m / seen.cell_m).round() as usize;
        // NaN, which exceeds no threshold, where nothing is known.
        let mean = |i: usize| {
            let known = around((width, height), i, reach).map(|cell| seen.index[cell]);
            let known = known.filter(|index| index.is_finite());
            let (sum, count) = known.fold((0.0, 0.0), |(sum, count), index| (sum + index, count + 1.0));
            sum / count
        };
        let each = in_parallel(width * height);
        match self.index {
            VegetationIndex::Infrared(_) => each.map(|i| mean(i) > VEGETATION_INDEX).collect(),
            VegetationIndex::Green(_) => {
                let reach = (GROUND_REACH_M / seen.cell_m).round() as usize;
                let ground = opening((width, height), &seen.up_m, [reach; 2]);
                each.map(|i| seen.up_m[i] - ground[i] > RAISED_M && mean(i) > GREEN)
                    .collect()
            }
        }
    }
}

/// Nadir image of the Gaussians; NaN where they do not cover a cell.
pub(super) struct FromAbove {
    /// Vegetation index of each cell, composited.
    pub index: Vec<f32>,
    /// Altitude of each cell, metres above the frame's origin.
    pub up_m: Vec<f32>,
    /// Width of a cell, metres.
    pub cell_m: f32,
    /// Ground sampling distance of the images, metres: the distance to each side over which the index is averaged.
    pub gsd_m: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use heliosplat::gaussians::{GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};
    use heliosplat::render::depths_and;
    use heliosplat::splat::ProjectionOptions;
    use heliosplat_scene::{BandKind, Values};

    const CELLS: usize = 64;
    const GREY: [f32; 4] = [0.3, 0.3, 0.3, 0.35];
    const LEAF: [f32; 4] = [0.1, 0.16, 0.08, 0.5];

    /// Leaf mask of discs a metre apart; `of` gives the altitude and the albedo (red, green, blue, near infrared) of
    /// each column and row.
    fn leaves(bands: &[BandKind], of: impl Fn(usize, usize) -> (f32, [f32; 4])) -> Vec<bool> {
        let mut groups = core_groups();
        groups.push(GroupSpec::new("albedo", bands.len()));
        let mut table = Table::zeros(groups, CELLS * CELLS);
        table.group_mut(OPACITY).fill(logit(0.95));
        table.group_mut(LOG_SCALE).fill(0.6f32.ln());
        for i in 0..CELLS * CELLS {
            let (up_m, albedo) = of(i % CELLS, i / CELLS);
            let place = Vec3::new((i % CELLS) as f32, -((i / CELLS) as f32), up_m);
            table.group_mut(POSITION)[3 * i..][..3].copy_from_slice(&place.to_array());
            table.group_mut(ROTATION)[4 * i..][..4].copy_from_slice(&[0.0, 0.0, 0.0, 1.0]);
            table.group_mut(ALBEDO)[bands.len() * i..][..bands.len()].copy_from_slice(&albedo[..bands.len()]);
        }
        let nadir = ProjectiveCamera::nadir(0.0, 0.0, 1.0, (CELLS, CELLS));
        let index = Values::default().vegetation_index(bands).expect("an index");
        let index = LeafIndex::new(index, &table, bands.len());
        let maps = depths_and(&table, &nadir, &ProjectionOptions::default(), |g| index.of(g));
        let seen = FromAbove {
            index: maps.channels[0]
                .iter()
                .zip(&maps.alpha)
                .map(|(index, alpha)| index / alpha)
                .collect(),
            up_m: maps.median_depth.iter().map(|depth| -depth).collect(),
            cell_m: 1.0,
            gsd_m: 1.0,
        };
        index.leaves(&nadir, &seen)
    }

    const RGB: [BandKind; 3] = [BandKind::Red, BandKind::Green, BandKind::Blue];
    const RGBN: [BandKind; 4] = [BandKind::Red, BandKind::Green, BandKind::Blue, BandKind::NearInfrared];

    /// A square of cells around a middle.
    fn within(col: usize, row: usize, middle: [usize; 2], reach: usize) -> bool {
        col.abs_diff(middle[0]) <= reach && row.abs_diff(middle[1]) <= reach
    }

    #[test]
    fn without_near_infrared_a_crown_is_leaves_and_a_lawn_or_a_roof_is_not() {
        let (crown, lawn, roof) = ([16, 16], [48, 16], [16, 48]);
        let leaf = leaves(&RGB, |col, row| match () {
            () if within(col, row, crown, 4) => (5.0, LEAF),
            () if within(col, row, lawn, 8) => (0.0, LEAF),
            () if within(col, row, roof, 8) => (6.0, GREY),
            () => (0.0, GREY),
        });
        let at = |[col, row]: [usize; 2]| leaf[row * CELLS + col];
        assert!(at(crown) && !at(lawn) && !at(roof) && !at([48, 48]));
        assert!(leaf.iter().filter(|leaf| **leaf).count() >= 49, "most of the crown");
    }

    #[test]
    fn colours_of_the_whole_scene_do_not_matter_without_near_infrared() {
        // Bands in counts: green has half of the gain that blue has.
        let leaf = leaves(&RGB, |col, row| {
            let (up_m, albedo) = if within(col, row, [32, 32], 4) {
                (5.0, LEAF)
            } else {
                (0.0, GREY)
            };
            (up_m, [albedo[0], 0.5 * albedo[1], albedo[2], albedo[3]])
        });
        assert!(leaf[32 * CELLS + 32] && !leaf[10 * CELLS + 10]);
    }

    #[test]
    fn with_near_infrared_neighbours_decide_and_one_odd_gaussian_does_not() {
        let leaf = leaves(&RGBN, |col, row| match () {
            () if within(col, row, [16, 16], 4) && (col, row) != (16, 16) => (5.0, LEAF),
            () if (col, row) == (48, 48) => (5.0, LEAF),
            () => (0.0, GREY),
        });
        assert!(leaf[16 * CELLS + 16], "grey within a crown");
        assert!(!leaf[48 * CELLS + 48], "a leaf by itself on a pavement");
    }
}
