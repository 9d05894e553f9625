//! Units of the joint products of an area's tiles: one mosaic, or colours, blocks and their union.

use super::{
    ColoursWork, Combination, JoinedWork, LEAST_BYTES, LEAST_S, MosaicTile, MosaicWork, Unit, Work, mebibytes,
};
use crate::blocks::{self, Block};
use crate::tiles::Tiling;
use heliosplat_fitting::checkpoint::digest;
use heliosplat_fitting::program::identity_of_program;
use heliosplat_scene::survey::Survey;

/// Memory of a mosaic for each cell while its surface model is made, bytes: three bands of tiles and of the mosaic,
/// weights, the file in memory.
const BYTES_PER_CELL: f64 = 120.0;
/// Memory of a mosaic for each cell and band of its albedo, bytes.
const BYTES_PER_CELL_AND_BAND: f64 = 24.0;
/// Seconds per cell of each raster of a mosaic.
const S_PER_CELL: f64 = 2e-6;
/// Seconds per cell of each raster of a mosaic that is read from its blocks.
const JOINED_S_PER_CELL: f64 = 2e-7;

impl Combination<'_> {
    /// Units that merge the tiles of `units`, which they wait for.
    pub(super) fn joint(&self, home: &str, tiling: &Tiling, survey: &Survey, units: &[Unit]) -> Vec<Unit> {
        let tiles: Vec<MosaicTile> = tiling
            .tiles
            .iter()
            .map(|tile| MosaicTile {
                unit: format!("{home}/{}", tile.name()),
                core: tile.core,
                bounds: tile.area.bounds,
            })
            .collect();
        let images = tiling.tiles.iter().map(|tile| tile.survey.images).max().unwrap_or(0);
        let (bands, rasters) = match self.products.dsm_only {
            true => (0.0, 1.0),
            // In the worst case each image has its own date, with a raster of shadows.
            false => (survey.bands as f64, (4 + survey.bands + images) as f64),
        };
        let bytes_per_cell = BYTES_PER_CELL + BYTES_PER_CELL_AND_BAND * bands;
        let memory = self.tiles.memory_bytes().map_or(f64::INFINITY, |bytes| bytes as f64);
        let side = blocks::side(self.tiles.block, memory - LEAST_BYTES, bytes_per_cell);
        let blocks = blocks::cut(tiling.bounds, tiling.gsd_m, side);
        let cells =
            |[west, south, east, north]: [f64; 4]| (east - west) * (north - south) / (tiling.gsd_m * tiling.gsd_m);
        let work = |block: &Block, colours: Option<&Unit>| MosaicWork {
            tiles: tiles.iter().filter(|tile| block.sees(&tile.bounds)).cloned().collect(),
            colours: colours.map(|unit| unit.id.clone()),
            crs: tiling.crs.clone(),
            gsd_m: tiling.gsd_m,
            bounds: block.bounds,
            around: block.around,
            truth: survey.truth.dsm.clone(),
            classes: survey.truth.classes.clone(),
            products: self.products.clone(),
        };
        let of_block = |block: &Block| {
            let bytes = LEAST_BYTES + bytes_per_cell * cells(block.bounds);
            (bytes, LEAST_S + S_PER_CELL * rasters * cells(block.bounds))
        };
        let all: Vec<&Unit> = units.iter().collect();
        if let [one] = blocks.as_slice() {
            let work = Work::Mosaic(work(one, None));
            return vec![self.unit(format!("{home}/mosaic"), &all, of_block(one), work)];
        }
        let mut joint = Vec::new();
        if !self.products.dsm_only {
            let work = Work::Colours(ColoursWork {
                tiles: tiles.clone(),
                gsd_m: tiling.gsd_m,
                relit: self.products.sun.is_some(),
            });
            let seconds = LEAST_S + JOINED_S_PER_CELL * cells(tiling.bounds);
            joint.push(self.unit(format!("{home}/colours"), &all, (LEAST_BYTES, seconds), work));
        }
        let colours = joint.first().cloned();
        let mut merged: Vec<(String, [f64; 4])> = Vec::new();
        for block in &blocks {
            let work = work(block, colours.as_ref());
            let seen = units.iter().zip(&tiles).filter(|(_, tile)| block.sees(&tile.bounds));
            let after: Vec<&Unit> = seen.map(|(unit, _)| unit).chain(&colours).collect();
            if !work.tiles.is_empty() {
                let id = format!("{home}/{}", block.name());
                merged.push((id.clone(), block.bounds));
                joint.push(self.unit(id, &after, of_block(block), Work::Block(work)));
            }
        }
        let after: Vec<&Unit> = joint.iter().skip(usize::from(colours.is_some())).collect();
        let largest = (side * side) as f64;
        let work = Work::Joined(JoinedWork {
            blocks: merged,
            tiles,
            crs: tiling.crs.clone(),
            gsd_m: tiling.gsd_m,
            bounds: tiling.bounds,
            geoid: self.products.geoid,
        });
        let seconds = LEAST_S + JOINED_S_PER_CELL * rasters * cells(tiling.bounds);
        let bytes = LEAST_BYTES + BYTES_PER_CELL_AND_BAND * bands.max(1.0) * largest;
        let joined = self.unit(format!("{home}/mosaic"), &after, (bytes, seconds), work);
        joint.push(joined);
        joint
    }

    /// Joint unit with its key: that of the units that it waits for, and its own work.
    fn unit(&self, id: String, after: &[&Unit], (bytes, seconds): (f64, f64), work: Work) -> Unit {
        let keys: Vec<&str> = after.iter().map(|unit| unit.key.as_str()).collect();
        let said = format!(
            "{}joint\n{}\n{:?} {:?}",
            identity_of_program(),
            keys.join("\n"),
            work,
            self.deliver
        );
        Unit {
            id,
            after: after.iter().map(|unit| unit.id.clone()).collect(),
            mem_mb: mebibytes(bytes),
            runtime_s: seconds.ceil() as u64,
            key: digest(&said),
            deliver: self.deliver.cloned(),
            work,
        }
    }
}
