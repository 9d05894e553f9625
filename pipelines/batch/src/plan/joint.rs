//! Units of the joint products of an area's tiles: one mosaic, or colours, blocks and their union.

use super::{ColoursWork, Combination, JoinedWork, LEAST_BYTES, MosaicTile, MosaicWork, Unit, Work};
use crate::blocks::{self, Block};
use crate::tiles::{Tile, Tiling};
use heliosplat_scene::survey::Survey;

/// Memory of a mosaic for each cell while its surface model is made, bytes: three bands of tiles and of the mosaic,
/// weights, the file in memory.
const BYTES_PER_CELL: f64 = 120.0;
/// Memory of a mosaic for each cell and band of its albedo, bytes.
const BYTES_PER_CELL_AND_BAND: f64 = 24.0;
/// Memory of the hours of sun for each cell of a mosaic and the ground around it, bytes.
const BYTES_PER_CELL_OF_SUN: f64 = 170.0;
/// Seconds of the hours of sun for each of these cells.
const S_PER_CELL_OF_SUN: f64 = 4e-5;
/// Seconds per cell of each raster of a mosaic.
const S_PER_CELL: f64 = 2e-6;
/// Seconds per cell of each raster of a mosaic that is read from its blocks.
const JOINED_S_PER_CELL: f64 = 2e-7;

/// Memory and time of merging cells.
struct Cost {
    /// Bands of the albedo; 0 for surface models alone.
    bands: f64,
    /// Rasters that are merged.
    rasters: f64,
    /// 1 with hours of sun, else 0.
    sun: f64,
}

impl Cost {
    /// Peak memory, bytes, of a block of `cells`, `around` with the ground around it.
    fn bytes(&self, cells: f64, around: f64) -> f64 {
        let merging = (BYTES_PER_CELL + BYTES_PER_CELL_AND_BAND * self.bands) * cells;
        LEAST_BYTES + merging.max(self.sun * BYTES_PER_CELL_OF_SUN * around)
    }

    fn seconds(&self, cells: f64, around: f64) -> f64 {
        S_PER_CELL * self.rasters * cells + self.sun * S_PER_CELL_OF_SUN * around
    }
}

impl Combination<'_> {
    /// Units that merge the tiles of `units`, which they wait for.
    pub(super) fn joint(&self, home: &str, tiling: &Tiling, survey: &Survey, units: &[Unit]) -> Vec<Unit> {
        let tile = |tile: &Tile| MosaicTile {
            unit: format!("{home}/{}", tile.name()),
            core: tile.core,
            bounds: tile.area.bounds,
        };
        let tiles: Vec<MosaicTile> = tiling.tiles.iter().map(tile).collect();
        let cost = self.cost(tiling, survey);
        let memory = self.tiles.memory_bytes().map_or(f64::INFINITY, |bytes| bytes as f64);
        let gsd_m = tiling.gsd_m;
        let fits = |cells: f64, around: f64| cost.bytes(cells, around) <= memory;
        let side = blocks::side(self.tiles.block, gsd_m, fits);
        let blocks = blocks::cut(tiling.bounds, gsd_m, side);
        let cells = |[west, south, east, north]: [f64; 4]| (east - west) * (north - south) / (gsd_m * gsd_m);
        let cost_of = |block: &Block| {
            let [cells, around] = [block.bounds, block.around].map(cells);
            (cost.bytes(cells, around), cost.seconds(cells, around))
        };
        let work = |block: &Block, colours: Option<&Unit>| MosaicWork {
            tiles: tiles.iter().filter(|tile| block.sees(&tile.bounds)).cloned().collect(),
            colours: colours.map(|unit| unit.id.clone()),
            crs: tiling.crs.clone(),
            gsd_m,
            bounds: block.bounds,
            around: block.around,
            truth: survey.truth.dsm.clone(),
            classes: survey.truth.classes.clone(),
            products: self.products.clone(),
        };
        let all: Vec<&Unit> = units.iter().collect();
        if let [one] = blocks.as_slice() {
            let work = Work::Mosaic(work(one, None));
            return vec![self.joint_unit(format!("{home}/mosaic"), &all, cost_of(one), work)];
        }
        let colours = (!self.products.dsm_only).then(|| {
            let work = Work::Colours(ColoursWork {
                tiles: tiles.clone(),
                gsd_m,
                products: self.products.clone(),
            });
            let seconds = JOINED_S_PER_CELL * cells(tiling.bounds);
            self.joint_unit(format!("{home}/colours"), &all, (LEAST_BYTES, seconds), work)
        });
        let mut merged: Vec<Unit> = Vec::new();
        let mut places = Vec::new();
        for block in &blocks {
            let work = work(block, colours.as_ref());
            if !work.tiles.is_empty() {
                let seen = units.iter().zip(&tiles).filter(|(_, tile)| block.sees(&tile.bounds));
                let after: Vec<&Unit> = seen.map(|(unit, _)| unit).chain(&colours).collect();
                let id = format!("{home}/{}", block.name());
                places.push((id.clone(), block.bounds));
                merged.push(self.joint_unit(id, &after, cost_of(block), Work::Block(work)));
            }
        }
        let seconds = JOINED_S_PER_CELL * cost.rasters * cells(tiling.bounds);
        let bytes = LEAST_BYTES + BYTES_PER_CELL_AND_BAND * cost.bands.max(1.0) * (side * side) as f64;
        let work = Work::Joined(JoinedWork {
            blocks: places,
            tiles,
            crs: tiling.crs.clone(),
            gsd_m,
            bounds: tiling.bounds,
            geoid: self.products.geoid,
        });
        // The light of the page is that of the first tile.
        let after: Vec<&Unit> = units.iter().take(1).chain(&merged).collect();
        let joined = self.joint_unit(format!("{home}/mosaic"), &after, (bytes, seconds), work);
        colours.into_iter().chain(merged).chain([joined]).collect()
    }

    fn cost(&self, tiling: &Tiling, survey: &Survey) -> Cost {
        let images = tiling.tiles.iter().map(|tile| tile.survey.images).max().unwrap_or(0);
        let (bands, rasters) = match self.products.dsm_only {
            true => (0.0, 1.0),
            // In the worst case each image has its own date, with a raster of shadows.
            false => (survey.bands as f64, (4 + survey.bands + images) as f64),
        };
        let sun = f64::from(u8::from(self.products.sun_hours.is_some()));
        Cost { bands, rasters, sun }
    }

    fn joint_unit(&self, id: String, after: &[&Unit], cost: (f64, f64), work: Work) -> Unit {
        self.unit(id, after, cost, &format!("joint {work:?}"), work)
    }
}
