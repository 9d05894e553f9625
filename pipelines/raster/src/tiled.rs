//! An image of several tiles, read as one.

use super::file::{Composite, RasterFile};
use super::{BandInfo, RasterError, Result, Window};
use std::path::PathBuf;

/// The last column and row that a tile may begin at: images have no more.
const FARTHEST: usize = i32::MAX as usize;

/// One tile of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    /// Path of its file.
    pub path: PathBuf,
    /// Column and row of its first pixel in the image.
    pub first: [usize; 2],
}

impl RasterFile {
    /// Opens the tiles of one image as one: path and metadata are those of the first tile, and pixels outside of all
    /// tiles are missing.
    ///
    /// # Errors
    /// As [`RasterFile::open`], for any tile; [`RasterError::NotAnImage`] when tiles have different bands or begin
    /// beyond the largest column or row; `RasterError::Gdal` without tiles.
    pub fn tiled(tiles: &[Tile]) -> Result<Self> {
        let files = tiles.iter().map(|tile| Self::open(&tile.path));
        let files = files.collect::<Result<Vec<_>, _>>()?;
        let Some(first) = files.first() else {
            return Err(RasterError::Gdal("an image of no tiles".to_owned()));
        };
        let kinds = |file: &Self| -> Vec<(String, Option<u64>)> {
            let kind = |band: &BandInfo| (band.data_type.clone(), band.nodata.map(f64::to_bits));
            file.bands.iter().map(kind).collect()
        };
        if let Some(other) = files.iter().find(|file| kinds(file) != kinds(first)) {
            let reason = format!(
                "its bands are not those of {}, of which it is a tile",
                first.path().display()
            );
            return Err(RasterError::NotAnImage(other.path().to_owned(), reason));
        }
        if let Some(far) = tiles.iter().find(|tile| tile.first.iter().any(|&at| at > FARTHEST)) {
            let reason = format!("as a tile it begins at column and row {:?}", far.first);
            return Err(RasterError::NotAnImage(far.path.clone(), reason));
        }
        let end = |axis: usize| {
            let ends = tiles.iter().zip(&files);
            let ends = ends.map(|(tile, file)| tile.first[axis] + <[usize; 2]>::from(file.size())[axis]);
            ends.max().unwrap_or(0)
        };
        let (path, bands, size) = (first.path().to_owned(), first.bands.clone(), (end(0), end(1)));
        let others = files[1..].iter().flat_map(Self::files).cloned().collect();
        let placed = tiles.iter().map(|tile| tile.first).zip(files).collect();
        Ok(Self::composed(path, others, size, bands, Mosaic(placed)))
    }
}

/// Tiles of one image, at least one, each with the column and row of its first pixel in the image.
struct Mosaic(Vec<([usize; 2], RasterFile)>);

impl Composite for Mosaic {
    fn first(&self) -> &RasterFile {
        &self.0[0].1
    }

    fn set_opacity(&mut self, band: Option<usize>) {
        self.0.iter_mut().for_each(|(_, file)| file.set_opacity(band));
    }

    /// The last tile counts in an overlap.
    fn read(&self, window: Window, bands: &[usize]) -> Result<Vec<f32>> {
        let plane = window.width * window.height;
        let mut values = vec![f32::NAN; plane * bands.len()];
        for ([col0, row0], file) in &self.0 {
            let (width, height) = file.size();
            let (left, top) = (window.col0.max(*col0), window.row0.max(*row0));
            let right = (window.col0 + window.width).min(col0 + width);
            let bottom = (window.row0 + window.height).min(row0 + height);
            if left >= right || top >= bottom {
                continue;
            }
            let common = Window::new((left - col0, top - row0), (right - left, bottom - top));
            let part = file.read(common, bands)?;
            let first = (top - window.row0) * window.width + left - window.col0;
            for (band, out) in values.chunks_exact_mut(plane).enumerate() {
                let rows = part.plane(band).chunks_exact(part.width);
                for (out, row) in out[first..].chunks_mut(window.width).zip(rows) {
                    out[..part.width].copy_from_slice(row);
                }
            }
        }
        Ok(values)
    }
}
