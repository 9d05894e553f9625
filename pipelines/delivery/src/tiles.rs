//! Images delivered in tiles: `…_R1C1.TIF`, `…_R1C2.TIF` … of Airbus, `…_R1C1-…` with a `.TIL` of Maxar.

use super::files::Folders;
use super::names::{folder_of, has_extension, stem};
use super::{Result, SceneError};
use heliosplat_raster::{RasterFile, Tile};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// An image in one file or in several tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ImageFiles {
    /// The file, or the first tile.
    pub(super) path: PathBuf,
    /// Tiles by row and column, as counted in their names or in the DIMAP that lists them; empty for a single file.
    pub(super) tiles: BTreeMap<[u32; 2], PathBuf>,
    /// Columns and rows from one tile to the next, where a DIMAP states them; else the sizes of the tiles or a `.TIL`
    /// decide.
    pub(super) step_px: Option<[usize; 2]>,
    /// Files of the same pixels with further bands.
    pub(super) more: Vec<Self>,
    /// Names of the bands of this file; empty if the image is a single file.
    pub(super) bands: &'static [&'static str],
}

impl ImageFiles {
    /// An image in one file.
    pub(super) fn one(path: PathBuf) -> Self {
        Self::of_tiles(path, BTreeMap::new())
    }

    /// An image of tiles, of which the first lies at `path`.
    fn of_tiles(path: PathBuf, tiles: BTreeMap<[u32; 2], PathBuf>) -> Self {
        Self {
            path,
            tiles,
            step_px: None,
            more: Vec::new(),
            bands: &[],
        }
    }

    /// Opens the file, the tiles, or the files of all bands as one image.
    pub(super) fn open(&self, folders: &Folders) -> Result<RasterFile> {
        if self.more.is_empty() {
            return self.open_bands(folders);
        }
        let mut files = Vec::with_capacity(1 + self.more.len());
        for image in std::iter::once(self).chain(&self.more) {
            let mut file = image.open_bands(folders)?;
            if image.bands.len() == file.bands.len() {
                let named = file.bands.iter_mut().zip(image.bands);
                named.for_each(|(band, name)| band.description = (*name).to_owned());
            }
            files.push(file);
        }
        Ok(RasterFile::stacked(files)?)
    }

    fn open_bands(&self, folders: &Folders) -> Result<RasterFile> {
        if self.tiles.is_empty() {
            return Ok(RasterFile::open(&self.path)?);
        }
        Ok(RasterFile::tiled(&self.placed(folders)?)?)
    }

    /// Positions of the tiles: from their DIMAP or a `.TIL` beside them, else side by side in the order of their
    /// counting.
    fn placed(&self, folders: &Folders) -> Result<Vec<Tile>> {
        if let Some(step_px) = self.step_px {
            return Ok(self.at_steps(step_px));
        }
        let folder = self.path.parent().unwrap_or_else(|| Path::new("."));
        for til in folders
            .files(folder)?
            .iter()
            .filter(|path| has_extension(path, &["til"]))
        {
            let text = folders.text(til)?;
            let places = places_in_til(&text);
            let place = |path: &PathBuf| {
                let name = path.file_name()?.to_string_lossy().to_lowercase();
                let (first, path) = (*places.get(&name)?, path.clone());
                Some(Tile { first, path })
            };
            if let Some(tiles) = self.tiles.values().map(place).collect::<Option<Vec<_>>>() {
                return Ok(tiles);
            }
        }
        self.side_by_side()
    }

    /// Positions of the tiles at equal distances.
    fn at_steps(&self, [columns, rows]: [usize; 2]) -> Vec<Tile> {
        let tile = |([row, col], path): (&[u32; 2], &PathBuf)| Tile {
            path: path.clone(),
            first: [before(*col).saturating_mul(columns), before(*row).saturating_mul(rows)],
        };
        self.tiles.iter().map(tile).collect()
    }

    fn side_by_side(&self) -> Result<Vec<Tile>> {
        let fault = |path: &Path, reason: String| SceneError::Unreadable(path.to_owned(), reason);
        // Width of each column of tiles, and height of each row.
        let (mut widths, mut heights) = (BTreeMap::new(), BTreeMap::new());
        for ([row, col], path) in &self.tiles {
            let (width, height) = RasterFile::open(path)?.size();
            let fits =
                *widths.entry(*col).or_insert(width) == width && *heights.entry(*row).or_insert(height) == height;
            if !fits {
                let reason = format!("as a tile it has another size than those beside it, {width} x {height} pixels");
                return Err(fault(path, reason));
            }
        }
        for row in heights.keys() {
            for col in widths.keys() {
                if !self.tiles.contains_key(&[*row, *col]) {
                    return Err(fault(&self.path, format!("its tile R{row}C{col} is not there")));
                }
            }
        }
        let until = |sizes: &BTreeMap<u32, usize>, at: u32| sizes.range(..at).map(|(_, size)| size).sum();
        let tiles = self.tiles.iter().map(|([row, col], path)| Tile {
            path: path.clone(),
            first: [until(&widths, *col), until(&heights, *row)],
        });
        Ok(tiles.collect())
    }
}

/// Number of tiles before the tile of a number; the first number is one.
fn before(number: u32) -> usize {
    number.saturating_sub(1) as usize
}

/// Row and column in a tile's name, and the rest of the name.
fn tile_of(name: &str) -> Option<([u32; 2], String)> {
    let is_edge = |c: char| c == '_' || c == '-';
    let mut start = 0;
    for part in name.split(is_edge) {
        let end = start + part.len();
        if let Some(place) = place_of(part) {
            // The separator before row and column is dropped with them.
            let rest = format!("{}{}", &name[..start.saturating_sub(1)], &name[end..]);
            return Some((place, rest));
        }
        start = end + 1;
    }
    None
}

/// `[2, 1]` of `R2C1`.
fn place_of(part: &str) -> Option<[u32; 2]> {
    let (row, col) = part.strip_prefix(['R', 'r'])?.split_once(['C', 'c'])?;
    let number = |digits: &str| {
        let plain = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        plain.then(|| digits.parse().ok()).flatten()
    };
    Some([number(row)?, number(col)?])
}

/// Name of the image that a tile belongs to; `None` where `name` is not that of a tile.
pub(super) fn product_name(name: &str) -> Option<String> {
    tile_of(name).map(|(_, rest)| rest)
}

/// Groups files into images: the tiles of an image become one, by the DIMAP beside them, else by their names.
///
/// # Errors
/// [`SceneError::MissingTile`] when a DIMAP lists a tile that does not exist.
pub(super) fn joined(files: Vec<PathBuf>, folders: &Folders) -> Result<Vec<ImageFiles>> {
    let mut images = Vec::new();
    let mut taken: BTreeSet<PathBuf> = BTreeSet::new();
    let wanted: BTreeSet<&PathBuf> = files.iter().collect();
    let parents: BTreeSet<&Path> = files.iter().map(|path| folder_of(path)).collect();
    let mut listed = Vec::new();
    for folder in parents {
        listed.extend(folders.dimaps(folder)?.tiled(folder, &wanted)?);
    }
    for listed in listed {
        let Some(first) = listed.tiles.values().next() else {
            continue;
        };
        taken.extend(listed.tiles.values().cloned());
        images.push(ImageFiles {
            step_px: listed.step_px,
            ..ImageFiles::of_tiles(first.clone(), listed.tiles)
        });
    }
    let places: BTreeMap<PathBuf, usize> = files.iter().cloned().zip(0..).collect();
    let others = files.into_iter().filter(|path| !taken.contains(path));
    images.extend(by_names(others.collect()));
    images.sort_by_key(|image| places.get(&image.path).copied());
    Ok(images)
}

/// Groups tiles into images by their names.
fn by_names(files: Vec<PathBuf>) -> Vec<ImageFiles> {
    let mut products: BTreeMap<(PathBuf, String), BTreeMap<[u32; 2], PathBuf>> = BTreeMap::new();
    for path in &files {
        if let Some((place, rest)) = tile_of(&stem(path)) {
            let folder = path.parent().unwrap_or_else(|| Path::new("")).to_owned();
            products.entry((folder, rest)).or_default().insert(place, path.clone());
        }
    }
    products.retain(|_, tiles| tiles.len() > 1);
    let grids = products.values();
    let product_of = grids.flat_map(|tiles| tiles.values().map(move |tile| (tile, tiles)));
    let product_of: BTreeMap<&PathBuf, _> = product_of.collect();
    let mut images = Vec::with_capacity(files.len());
    for path in files {
        match product_of.get(&path) {
            None => images.push(ImageFiles::one(path)),
            Some(tiles) if tiles.values().next() == Some(&path) => {
                images.push(ImageFiles::of_tiles(path, (*tiles).clone()));
            }
            Some(_) => {}
        }
    }
    images
}

/// Column and row of the first pixel of each tile in the text of a Maxar `.TIL`; keys are file names in lower case.
pub fn places_in_til(text: &str) -> BTreeMap<String, [usize; 2]> {
    let mut places = BTreeMap::new();
    let (mut name, mut col) = (None, None);
    for statement in text.split(';') {
        // Groups begin and end without a semicolon: the last assignment of a statement counts.
        let Some((key, value)) = statement.rsplit_once('=') else {
            continue;
        };
        let key = key.split_whitespace().last().unwrap_or("");
        let value = value.trim().trim_matches('"');
        match key {
            "filename" => (name, col) = (Some(value.to_lowercase()), None),
            "ULColOffset" => col = value.parse::<usize>().ok(),
            "ULRowOffset" => {
                if let (Some(name), Some(col), Ok(row)) = (name.take(), col.take(), value.parse()) {
                    places.insert(name, [col, row]);
                }
            }
            _ => {}
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_of_one_image_are_one_image() {
        let names = [
            "a/IMG_PHR1A_P_001_R1C1.TIF",
            "a/IMG_PHR1A_P_001_R1C2.TIF",
            "a/18JAN-P1BS_R1C1-055_P001.TIF",
            "a/18JAN-P1BS_R2C1-055_P001.TIF",
            "a/alone_R1C1.TIF",
            "a/other.TIF",
        ];
        let images = by_names(names.map(PathBuf::from).to_vec());
        let paths: Vec<String> = images.iter().map(|image| image.path.display().to_string()).collect();
        assert_eq!(paths, [names[0], names[2], names[4], names[5]]);
        assert_eq!(
            images.iter().map(|image| image.tiles.len()).collect::<Vec<_>>(),
            [2, 2, 0, 0]
        );
        assert_eq!(
            product_name("18JAN-P1BS_R1C1-055_P001").as_deref(),
            Some("18JAN-P1BS-055_P001")
        );
        assert_eq!(product_name("RC_R1_C1"), None);
    }

    #[test]
    fn a_til_says_where_tiles_lie() {
        let text = "bandId = \"P\";\nnumTiles = 2;\nBEGIN_GROUP = TILE_1\n\tfilename = \"A_R1C1.TIF\";\n\tULColOffset = 0;\n\
            \tULRowOffset = 0;\nEND_GROUP = TILE_1\nBEGIN_GROUP = TILE_2\n\tfilename = \"A_R1C2.TIF\";\n\tULColOffset = 16384;\n\
            \tULRowOffset = 7;\nEND_GROUP = TILE_2\nEND;\n";
        let places = places_in_til(text);
        assert_eq!(places.get("a_r1c2.tif"), Some(&[16384, 7]));
        assert_eq!(places.len(), 2);
    }
}
