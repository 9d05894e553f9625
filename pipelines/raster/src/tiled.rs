//! An image that its vendor cut into tiles, read as one through a virtual raster of our own making, which names these tiles and
//! nothing else.

use super::RasterError;
use super::file::RasterFile;
use super::pansharpen::escaped;
use std::path::PathBuf;

/// One tile of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    /// Its file.
    pub path: PathBuf,
    /// Column and row of the image that its first pixel is.
    pub first: [usize; 2],
}

impl RasterFile {
    /// Opens the tiles of one image as one: path and metadata are those of the first tile, pixels that no tile has are missing.
    ///
    /// # Errors
    /// As [`RasterFile::open`], for any tile; [`RasterError::NotAnImage`] when tiles have different bands.
    pub fn tiled(tiles: &[Tile]) -> Result<Self, RasterError> {
        let files = tiles
            .iter()
            .map(|tile| Self::open(&tile.path))
            .collect::<Result<Vec<_>, _>>()?;
        let Some(first) = files.first() else {
            return Err(no_tiles());
        };
        let kinds = |file: &Self| -> Vec<(String, Option<u64>)> {
            let bands = file.bands.iter();
            bands
                .map(|band| (band.data_type.clone(), band.nodata.map(f64::to_bits)))
                .collect()
        };
        if let Some(other) = files.iter().find(|file| kinds(file) != kinds(first)) {
            return Err(RasterError::NotAnImage {
                path: other.path().to_owned(),
                reason: format!(
                    "its bands are not those of {}, of which it is a tile",
                    first.path().display()
                ),
            });
        }
        let description = mosaic_xml(tiles, &files);
        let path = first.path().to_owned();
        let mut files = files.into_iter();
        let Some(first) = files.next() else {
            return Err(no_tiles());
        };
        Self::composed(first, description, files.as_slice()).map_err(|reason| RasterError::NotAnImage {
            path,
            reason: format!("its tiles cannot be read as one: {reason}"),
        })
    }
}

fn no_tiles() -> RasterError {
    RasterError::Gdal("an image of no tiles".to_owned())
}

fn mosaic_xml(tiles: &[Tile], files: &[RasterFile]) -> String {
    let end = |axis: usize| {
        let ends = tiles.iter().zip(files).map(|(tile, file)| {
            let (width, height) = file.size();
            tile.first[axis] + [width, height][axis]
        });
        ends.max().unwrap_or(0)
    };
    let mut xml = format!("<VRTDataset rasterXSize=\"{}\" rasterYSize=\"{}\">", end(0), end(1));
    for (index, band) in files[0].bands.iter().enumerate() {
        xml += &format!("<VRTRasterBand dataType=\"{}\" band=\"{}\">", band.data_type, index + 1);
        if let Some(value) = band.nodata {
            xml += &format!("<NoDataValue>{value}</NoDataValue>");
        }
        for (tile, file) in tiles.iter().zip(files) {
            let (width, height) = file.size();
            let [col0, row0] = tile.first;
            xml += &format!(
                "<SimpleSource><SourceFilename relativeToVRT=\"0\">{}</SourceFilename><SourceBand>{}</SourceBand>\
                 <SrcRect xOff=\"0\" yOff=\"0\" xSize=\"{width}\" ySize=\"{height}\"/>\
                 <DstRect xOff=\"{col0}\" yOff=\"{row0}\" xSize=\"{width}\" ySize=\"{height}\"/></SimpleSource>",
                escaped(&tile.path.to_string_lossy()),
                index + 1,
            );
        }
        xml += "</VRTRasterBand>";
    }
    xml + "</VRTDataset>"
}
