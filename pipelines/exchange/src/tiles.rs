//! 3D Tiles 1.1 (OGC 22-025r4): the tree of tiles, `tileset.json`, and the division of splats into tiles.
//!
//! Volumes are boxes in the frame of the tiles: metres east, north and up of the site. The root's transform brings them
//! to Earth-centred, Earth-fixed metres. A tile is replaced by its children, which show the same ground with finer
//! splats. The tree has at least three levels, and enough levels that the coarsest tile has a few hundred splats:
//! viewers omit small splats.

use crate::glb::TooLarge;
use crate::merge::merged;
use crate::splats::{GAUSSIAN_SPLATTING, Splat};
use crate::spz;
use glam::Vec3;
use serde_json::{Value, json};

/// Most splats of a tile; parts with more are cut into quarters.
const TILE_MOST: usize = 1 << 16;
/// Levels of merged splats above the ones of the model, at least.
const LEVELS_LEAST: usize = 2;
/// Approximate number of splats of the coarsest tile: a site is visible until they are too small to be drawn.
const ROOT_SPLATS: usize = 256;
/// Depth below which tiles are no longer cut, as where more splats than a tile may have share one position.
const DEPTH_MOST: usize = 16;
/// Extent of a splat on either side of its centre, standard deviations.
const REACH: f32 = 3.0;
/// Metres of geometric error for each metre of a cell of a mesh. Viewers replace a tile whose error is 16 pixels wide
/// on the screen, so that a cell is at most two pixels wide.
pub const ERROR_OF_CELL: f64 = 8.0;
/// Metres of geometric error for each metre of a cell of merged splats: a cell is then 1.6 to 3.2 pixels wide. Merged
/// splats have standard deviations of a third of a cell at least, and CesiumJS omits splats whose standard deviations
/// are both below 0.35 pixels, so that all are drawn.
const ERROR_OF_SPLATS: f64 = 5.0;

/// Tile of a tileset, with the tiles below it.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// Name of the tile's file, relative to `tileset.json`.
    pub file: String,
    /// Lowest corner of the contents of the tile and of its children, metres east, north and up.
    pub low: [f64; 3],
    /// Highest corner of these contents, metres east, north and up.
    pub high: [f64; 3],
    /// Geometric error of the tile where it is shown without its children, metres.
    pub error_m: f64,
    /// Finer tiles of the same ground.
    pub children: Vec<Tile>,
}

impl Tile {
    /// Number of tiles, this one included.
    pub fn count(&self) -> usize {
        1 + self.children.iter().map(Self::count).sum::<usize>()
    }

    /// Number of levels, this one included.
    pub fn depth(&self) -> usize {
        1 + self.children.iter().map(Self::depth).max().unwrap_or(0)
    }

    /// Entry of the tile in a `tileset.json`, with its volume again for a projected system: the boxes
    /// of both are in the frame of the tiles.
    /// Adds a child, and grows by it.
    pub fn add(&mut self, child: Self) {
        self.include(child.low, child.high);
        self.children.push(child);
    }

    fn include(&mut self, low: [f64; 3], high: [f64; 3]) {
        for k in 0..3 {
            self.low[k] = self.low[k].min(low[k]);
            self.high[k] = self.high[k].max(high[k]);
        }
    }

    fn value(&self) -> Value {
        let middle = |k: usize| 0.5 * (self.low[k] + self.high[k]);
        // No box is flat.
        let half = |k: usize| (0.5 * (self.high[k] - self.low[k])).max(0.01);
        let ([x, y, z], [dx, dy, dz]) = ([0, 1, 2].map(middle), [0, 1, 2].map(half));
        let volume = [x, y, z, dx, 0.0, 0.0, 0.0, dy, 0.0, 0.0, 0.0, dz];
        let mut value = json!({
            "boundingVolume": {"box": volume}, "geometricError": self.error_m, "content": {"uri": self.file},
            "extensions": {ESRI_CRS: {"boundingVolume": {"box": volume}}},
        });
        if !self.children.is_empty() {
            value["children"] = self.children.iter().map(Self::value).collect();
        }
        value
    }
}

/// Generator of a tileset, its `asset.generator`.
pub const GENERATOR: &str = concat!("heliosplat ", env!("CARGO_PKG_VERSION"));

/// Kind of the tiles' contents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contents {
    /// Packed splats: CesiumJS reads glTF as splats only where `tileset.json` declares it.
    Splats,
    /// Triangle meshes.
    Meshes,
}

/// Extension of tilesets with a projected coordinate system, which ArcGIS Pro 3.6 reads (Esri, 3D-tiles-layer,
/// `Esri_crs_extension.md`).
pub const ESRI_CRS: &str = "ESRI_crs";
/// Heights above the ellipsoid of WGS 84, as ArcGIS numbers vertical systems.
const ELLIPSOIDAL: u32 = 115_700;

/// Place of a tileset's frame on Earth. Matrices are column after column.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Transform to Earth-centred, Earth-fixed metres.
    pub ecef: [f64; 16],
    /// EPSG code of a projected system in metres.
    pub epsg: u32,
    /// Transform to that system and heights above the ellipsoid, exact at the origin of the frame.
    pub projected: [f64; 16],
}

/// Value of [`ESRI_CRS`] at the top of a tileset.
pub fn esri_crs(epsg: u32) -> Value {
    json!({"wkid": epsg, "vcsWkid": ELLIPSOIDAL})
}

/// Content of `tileset.json`: the tree below `root`, the place of its frame, and `extras`, metadata of the asset.
pub fn tileset(root: &Tile, placement: &Placement, contents: Contents, extras: Value) -> Value {
    let mut top = root.value();
    top["transform"] = json!(placement.ecef);
    top["extensions"][ESRI_CRS]["transform"] = json!(placement.projected);
    top["refine"] = "REPLACE".into();
    let sides = (0..3).map(|k| (root.high[k] - root.low[k]).powi(2)).sum::<f64>();
    let mut tileset = json!({
        "asset": {"version": "1.1", "generator": GENERATOR, "extras": extras}, "geometricError": sides.sqrt().max(root.error_m), "root": top,
        "extensionsUsed": [ESRI_CRS], "extensions": {ESRI_CRS: esri_crs(placement.epsg)},
    });
    if contents == Contents::Splats {
        let names = json!([GAUSSIAN_SPLATTING, spz::COMPRESSION]);
        tileset["extensionsUsed"] = json!(["3DTILES_content_gltf", ESRI_CRS]);
        tileset["extensions"]["3DTILES_content_gltf"] = json!({"extensionsUsed": names, "extensionsRequired": names});
    }
    tileset
}

/// Receiver of the files of a tileset: the name and the bytes of each.
pub type WriteFile<'w, E> = dyn FnMut(&str, Vec<u8>) -> Result<(), E> + 'w;

/// Cuts splats into a tree of tiles, coarse ones above fine ones, and passes each file to `write`; returns the root.
///
/// # Errors
/// Errors of `write`, and [`TooLarge`] for a tile of more than 4 GiB.
pub fn of_splats<E: From<TooLarge>>(splats: Vec<Splat>, write: &mut WriteFile<E>) -> Result<Tile, E> {
    let (low, high) = extent(&splats);
    let ground = (high - low).truncate().element_product().max(f32::MIN_POSITIVE);
    let spacing_m = (ground / splats.len().max(1) as f32).sqrt();
    let levels = levels_above(splats.len(), ROOT_SPLATS).max(LEVELS_LEAST);
    Tree { spacing_m, write }.grow(splats, "tile".into(), levels, 0)
}

struct Tree<'w, E> {
    /// Side of the square of ground for each splat of the model, metres.
    spacing_m: f32,
    write: &'w mut WriteFile<'w, E>,
}

impl<E: From<TooLarge>> Tree<'_, E> {
    fn grow(&mut self, splats: Vec<Splat>, name: String, levels: usize, depth: usize) -> Result<Tile, E> {
        let levels = match depth < DEPTH_MOST {
            true => levels.max(levels_above(splats.len(), TILE_MOST)),
            false => 0,
        };
        let (low, high) = extent(&splats);
        let mut tile = Tile {
            file: format!("{name}.glb"),
            low: low.as_dvec3().to_array(),
            high: high.as_dvec3().to_array(),
            error_m: 0.0,
            children: Vec::new(),
        };
        if levels == 0 {
            (self.write)(&tile.file, spz::glb(&splats)?)?;
            return Ok(tile);
        }
        let mut cell_m = self.spacing_m * (1u32 << levels) as f32;
        let mut coarse = merged(&splats, cell_m);
        while coarse.len() > TILE_MOST && cell_m < f32::MAX / 4.0 {
            cell_m *= 2.0;
            coarse = merged(&coarse, cell_m);
        }
        (self.write)(&tile.file, spz::glb(&coarse)?)?;
        tile.error_m = ERROR_OF_SPLATS * f64::from(cell_m);
        let (low, high) = extent(&coarse);
        tile.include(low.as_dvec3().to_array(), high.as_dvec3().to_array());
        drop(coarse);
        for (quarter, part) in parts(splats).into_iter().enumerate() {
            if !part.is_empty() {
                let child = self.grow(part, format!("{name}-{quarter}"), levels - 1, depth + 1)?;
                tile.add(child);
            }
        }
        // Cells below may have been widened: no child has a larger error than its parent.
        let below = tile.children.iter().map(|child| child.error_m).fold(0.0, f64::max);
        tile.error_m = tile.error_m.max(below);
        Ok(tile)
    }
}

/// Number of divisions into quarters until the tiles are small enough.
fn levels_above(count: usize, most: usize) -> usize {
    match count > most {
        true => 1 + levels_above(count.div_ceil(4), most),
        false => 0,
    }
}

/// Splats as one part, or as quarters where they are too many: south-west, south-east, north-west, north-east.
fn parts(splats: Vec<Splat>) -> Vec<Vec<Splat>> {
    if splats.len() <= TILE_MOST {
        return vec![splats];
    }
    let places = |fold: fn(Vec3, Vec3) -> Vec3| splats.iter().map(|s| s.position).reduce(fold);
    let ends = places(Vec3::min).zip(places(Vec3::max));
    let middle = ends.map_or(Vec3::ZERO, |(low, high)| 0.5 * (low + high));
    let mut quarters = vec![Vec::new(); 4];
    for splat in splats {
        let (east, north) = (splat.position.x >= middle.x, splat.position.y >= middle.y);
        quarters[usize::from(east) + 2 * usize::from(north)].push(splat);
    }
    quarters
}

/// Lowest and highest corner of the extent of splats.
fn extent(splats: &[Splat]) -> (Vec3, Vec3) {
    let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    splats.iter().fold(start, |(low, high), splat| {
        let covariance = splat.covariance();
        let reach = Vec3::new(covariance.x_axis.x, covariance.y_axis.y, covariance.z_axis.z);
        let reach = REACH * Vec3::from(reach.to_array().map(f32::sqrt));
        (low.min(splat.position - reach), high.max(splat.position + reach))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;
    use std::collections::BTreeMap;

    fn ground(side: usize) -> Vec<Splat> {
        let splat = |i: usize| Splat {
            position: Vec3::new((i % side) as f32, (i / side) as f32, ((i * 7919) % 13) as f32 * 0.1),
            scale: Vec3::new(0.6, 0.6, 0.1),
            rotation: Quat::IDENTITY,
            opacity: 0.9,
            colour: [0.5; 3],
        };
        (0..side * side).map(splat).collect()
    }

    fn grown(splats: Vec<Splat>) -> (Tile, BTreeMap<String, usize>) {
        let mut files = BTreeMap::new();
        let mut write = |name: &str, bytes: Vec<u8>| {
            let (document, _) = crate::glb::chunks(&bytes);
            let count = document["accessors"][0]["count"].as_u64().expect("a count") as usize;
            assert!(files.insert(name.to_owned(), count).is_none(), "{name} twice");
            Ok::<(), TooLarge>(())
        };
        let tile = of_splats(splats, &mut write).expect("small");
        (tile, files)
    }

    fn check(tile: &Tile, files: &BTreeMap<String, usize>, leaves: &mut usize) {
        assert!(files[&tile.file] <= TILE_MOST);
        if tile.children.is_empty() {
            assert_eq!(tile.error_m, 0.0);
            *leaves += files[&tile.file];
        }
        for child in &tile.children {
            assert!(child.error_m < tile.error_m, "{tile:?}");
            assert!((0..3).all(|k| child.low[k] >= tile.low[k] && child.high[k] <= tile.high[k]));
            check(child, files, leaves);
        }
    }

    #[test]
    fn a_small_site_has_three_levels_of_the_same_ground() {
        let (tile, files) = grown(ground(40));
        assert_eq!((tile.count(), tile.depth()), (3, 3));
        let mut leaves = 0;
        check(&tile, &files, &mut leaves);
        assert_eq!(leaves, 1600);
        let coarsest = files[&tile.file];
        assert!((60..2 * ROOT_SPLATS).contains(&coarsest), "{coarsest}");
    }

    #[test]
    fn a_large_site_is_cut_and_nothing_is_lost_or_twice() {
        let (tile, files) = grown(ground(700));
        assert_eq!(tile.depth(), 7);
        assert!(tile.children.len() == 4 && tile.count() == files.len());
        let mut leaves = 0;
        check(&tile, &files, &mut leaves);
        assert_eq!(leaves, 490_000);
    }

    #[test]
    fn the_tileset_says_that_its_files_are_splats() {
        let (tile, _) = grown(ground(10));
        let names = json!(["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]);
        let placement = Placement {
            ecef: [0.0; 16],
            epsg: 32637,
            projected: [1.0; 16],
        };
        let tileset = tileset(&tile, &placement, Contents::Splats, json!({}));
        assert_eq!(tileset["extensions"][ESRI_CRS]["wkid"], 32637);
        let of_root = &tileset["root"]["extensions"][ESRI_CRS];
        assert_eq!(of_root["boundingVolume"], tileset["root"]["boundingVolume"]);
        assert_eq!(of_root["transform"].as_array().map(Vec::len), Some(16));
        let extension = &tileset["extensions"]["3DTILES_content_gltf"];
        assert_eq!(
            (&extension["extensionsUsed"], &extension["extensionsRequired"]),
            (&names, &names)
        );
        assert_eq!(tileset["root"]["refine"], "REPLACE");
        assert_eq!(
            tileset["root"]["boundingVolume"]["box"].as_array().map(Vec::len),
            Some(12)
        );
        assert_eq!(tileset["root"]["children"][0]["children"][0]["geometricError"], 0.0);
    }
}
