//! A panchromatic and a multispectral image of one acquisition read as one, by GDAL's own pansharpening.
//!
//! Images as the sensor took them have no map coordinates: where the pixels of one lie in the other is a scale and an offset along
//! columns and rows, which the caller knows from their cameras. GDAL is given both files in virtual rasters of our own making; they
//! name these two files and nothing else.

use super::RasterError;
use super::file::RasterFile;

/// Where the pixels of one image lie in another, along columns and along rows: `other = scale · own + offset`, pixel centres at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRelation {
    /// Pixels of the other image per pixel.
    pub scale: [f64; 2],
    /// Column and row of the other image that the centre of the first pixel lies on.
    pub offset: [f64; 2],
}

impl GridRelation {
    /// The rectangle of the other image that this one covers, in GDAL's corners: first column and row, columns and rows.
    fn source_rectangle(&self, (width, height): (usize, usize)) -> [f64; 4] {
        let first = |axis: usize| self.offset[axis] - 0.5 * self.scale[axis] + 0.5;
        [
            first(0),
            first(1),
            self.scale[0] * width as f64,
            self.scale[1] * height as f64,
        ]
    }
}

impl RasterFile {
    /// A panchromatic image together with the multispectral one of the same acquisition: bands and their order are those of
    /// `multispectral`, size and metadata those of `panchromatic`. `relation` leads from pixels of the panchromatic image to those of the
    /// other. The multispectral image is resampled by cubic convolution; each of its bands is then multiplied by the ratio of the
    /// panchromatic image to the mean of all bands (weighted Brovey transform, A. R. Gillespie et al., "Color enhancement of highly
    /// correlated images II", Remote Sensing of Environment 22, 1987), which leaves ratios between bands as they are.
    ///
    /// # Errors
    /// [`RasterError::NotAnImage`] when GDAL cannot pansharpen them.
    pub fn pansharpened(panchromatic: Self, multispectral: Self, relation: &GridRelation) -> Result<Self, RasterError> {
        let colours = resampled_xml(&multispectral, panchromatic.size(), relation);
        let description = pansharpened_xml(&panchromatic, &colours);
        let [path, other] = [panchromatic.path().to_owned(), multispectral.path().to_owned()];
        Self::composed(panchromatic, description, &[multispectral]).map_err(|reason| RasterError::NotAnImage {
            path,
            reason: format!("it cannot be pansharpened with {}: {reason}", other.display()),
        })
    }
}

/// The multispectral image on the grid of the panchromatic one.
fn resampled_xml(colours: &RasterFile, (width, height): (usize, usize), relation: &GridRelation) -> String {
    let [col0, row0, columns, rows] = relation.source_rectangle((width, height));
    let mut xml = format!("<VRTDataset rasterXSize=\"{width}\" rasterYSize=\"{height}\">");
    for (index, band) in colours.bands.iter().enumerate() {
        xml += &format!("<VRTRasterBand dataType=\"{}\" band=\"{}\">", band.data_type, index + 1);
        let nodata = band.nodata.map(|value| format!("<NODATA>{value}</NODATA>"));
        if let Some(value) = band.nodata {
            xml += &format!("<NoDataValue>{value}</NoDataValue>");
        }
        // A simple source would mix missing values into their neighbours.
        let kind = if nodata.is_some() {
            "ComplexSource"
        } else {
            "SimpleSource"
        };
        xml += &format!(
            "<{kind} resampling=\"cubic\"><SourceFilename relativeToVRT=\"0\">{}</SourceFilename><SourceBand>{}</SourceBand>\
             <SrcRect xOff=\"{col0}\" yOff=\"{row0}\" xSize=\"{columns}\" ySize=\"{rows}\"/>\
             <DstRect xOff=\"0\" yOff=\"0\" xSize=\"{width}\" ySize=\"{height}\"/>{}</{kind}></VRTRasterBand>",
            escaped(colours.source()),
            index + 1,
            nodata.unwrap_or_default(),
        );
    }
    xml + "</VRTDataset>"
}

fn pansharpened_xml(pan: &RasterFile, colours: &str) -> String {
    let bands = colours.matches("<VRTRasterBand ").count();
    let weights = vec![(1.0 / bands as f64).to_string(); bands].join(",");
    let mut xml = format!(
        "<VRTDataset subClass=\"VRTPansharpenedDataset\"><PansharpeningOptions><Algorithm>WeightedBrovey</Algorithm>\
         <AlgorithmOptions><Weights>{weights}</Weights></AlgorithmOptions><Resampling>Cubic</Resampling>\
         <SpatialExtentAdjustment>None</SpatialExtentAdjustment>"
    );
    if let Some(nodata) = pan.bands[0].nodata {
        xml += &format!("<NoData>{nodata}</NoData>");
    }
    xml += &format!(
        "<PanchroBand><SourceFilename relativeToVRT=\"0\">{}</SourceFilename><SourceBand>1</SourceBand></PanchroBand>",
        escaped(pan.source())
    );
    for band in 1..=bands {
        xml += &format!(
            "<SpectralBand dstBand=\"{band}\"><SourceFilename relativeToVRT=\"0\">{}</SourceFilename><SourceBand>{band}</SourceBand>\
             </SpectralBand>",
            escaped(colours)
        );
    }
    xml + "</PansharpeningOptions></VRTDataset>"
}

/// Text as it stands in XML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImageSpec, Sample, Window, write_geotiff};
    use heliosplat::Raster;
    use std::path::Path;

    /// A pan image of 64 x 48 pixels of 100 to 227, and colours of a quarter of its size whose first band is the pan image's mean
    /// and whose second is twice that.
    fn pair(folder: &Path) -> [std::path::PathBuf; 2] {
        let (width, height) = (64, 48);
        let mut pan = Raster::filled(width, height, 1, 0.0);
        for (index, value) in pan.values.iter_mut().enumerate() {
            *value = 100.0 + 2.0 * (index % width) as f32;
        }
        let mut colours = Raster::filled(16, 12, 2, 0.0);
        for row in 0..12 {
            for col in 0..16 {
                let mean = 103.0 + 8.0 * col as f32;
                colours.values[row * 16 + col] = mean;
                colours.values[(12 + row) * 16 + col] = 2.0 * mean;
            }
        }
        let paths = ["pan & more.tif", "colours.tif"].map(|name| folder.join(name));
        for (path, raster) in paths.iter().zip([&pan, &colours]) {
            write_geotiff(path, &ImageSpec::plain(raster), Sample::U16).expect("written");
        }
        paths
    }

    fn open_pair(pan: &Path, colours: &Path) -> Result<RasterFile, RasterError> {
        RasterFile::pansharpened(RasterFile::open(pan)?, RasterFile::open(colours)?, &QUARTER)
    }

    const QUARTER: GridRelation = GridRelation {
        scale: [0.25; 2],
        // Four pixels share the centre of one.
        offset: [-0.375; 2],
    };

    #[test]
    fn detail_is_that_of_the_pan_image_and_ratios_are_those_of_the_colours() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let [pan, colours] = pair(folder.path());
        let file = open_pair(&pan, &colours).expect("one image");
        assert_eq!(
            (file.size(), file.bands.len(), file.path()),
            ((64, 48), 2, pan.as_path())
        );
        let whole = file.read_all().expect("pixels");
        for col in 8..56 {
            let [first, second] = [0, 1].map(|band| whole.at(band, col, 20));
            let truth = 100.0 + 2.0 * col as f32;
            // The mean of both bands is the pan image, rounded to counts.
            assert!((0.5 * (first + second) - truth).abs() <= 1.0, "{col}: {first} {second}");
            assert!((second / first - 2.0).abs() < 0.02, "{col}: {first} {second}");
        }
        let window = Window {
            col0: 20,
            row0: 10,
            width: 24,
            height: 16,
        };
        let part = file.read(window, &[1]).expect("pixels");
        for row in 0..16 {
            for col in 0..24 {
                assert_eq!(part.at(0, col, row), whole.at(1, col + 20, row + 10), "{col} {row}");
            }
        }
    }

    #[test]
    fn the_rectangle_counts_from_corners() {
        assert_eq!(QUARTER.source_rectangle((64, 48)), [0.0, 0.0, 16.0, 12.0]);
    }
}
