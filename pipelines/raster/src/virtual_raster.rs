//! Virtual rasters (VRT) that join files of one grid. GIS programs open them as one raster; this program writes them,
//! and does not read them, since they name other files.

use super::{BandInfo, Colour, GridSpec};
use std::fmt::Write;

/// Text with the characters that XML reserves replaced.
pub fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    text.replace('"', "&quot;")
}

fn colour_name(colour: Colour) -> &'static str {
    match colour {
        Colour::Grey => "Gray",
        Colour::Red => "Red",
        Colour::Green => "Green",
        Colour::Blue => "Blue",
        Colour::Alpha => "Alpha",
        Colour::Palette => "Palette",
        Colour::Undefined => "Undefined",
    }
}

/// File of a part of a raster.
pub struct Part {
    /// Path of the file, relative to the virtual raster.
    pub path: String,
    /// Column and row of the whole raster at which the part begins.
    pub at: [usize; 2],
    /// Columns and rows of the part.
    pub size: (usize, usize),
}

/// Text of a virtual raster on `grid`, with bands as in each of the parts. Cells without a part are missing.
pub fn virtual_raster(grid: &GridSpec, bands: &[BandInfo], metadata: &[(String, String)], parts: &[Part]) -> String {
    let mut text = format!(
        "<VRTDataset rasterXSize=\"{}\" rasterYSize=\"{}\">\n  <SRS>{}</SRS>\n  <GeoTransform>{}</GeoTransform>\n",
        grid.width,
        grid.height,
        escaped(grid.crs.wkt()),
        grid.transform.to_gdal().map(|value| value.to_string()).join(", "),
    );
    // Writing to a String cannot fail.
    let _ = writeln!(text, "  <Metadata>");
    for (key, value) in metadata {
        let _ = writeln!(text, "    <MDI key=\"{}\">{}</MDI>", escaped(key), escaped(value));
    }
    let _ = writeln!(text, "  </Metadata>");
    for (band, place) in bands.iter().zip(1..) {
        let data_type = escaped(&band.data_type);
        let _ = writeln!(text, "  <VRTRasterBand dataType=\"{data_type}\" band=\"{place}\">");
        let _ = writeln!(text, "    <Description>{}</Description>", escaped(&band.description));
        if !band.unit.is_empty() {
            let _ = writeln!(text, "    <UnitType>{}</UnitType>", escaped(&band.unit));
        }
        if let Some(nodata) = band.nodata {
            let _ = writeln!(text, "    <NoDataValue>{nodata}</NoDataValue>");
        }
        let colour = colour_name(band.colour);
        let _ = writeln!(text, "    <ColorInterp>{colour}</ColorInterp>");
        for Part { path, at, size } in parts {
            let (width, height) = size;
            let _ = writeln!(
                text,
                "    <SimpleSource>\n      <SourceFilename relativeToVRT=\"1\">{}</SourceFilename>\n      <SourceBand>{place}</SourceBand>\n      \
                 <SourceProperties RasterXSize=\"{width}\" RasterYSize=\"{height}\" DataType=\"{}\" BlockXSize=\"512\" BlockYSize=\"512\" />\n      \
                 <SrcRect xOff=\"0\" yOff=\"0\" xSize=\"{width}\" ySize=\"{height}\" />\n      \
                 <DstRect xOff=\"{}\" yOff=\"{}\" xSize=\"{width}\" ySize=\"{height}\" />\n    </SimpleSource>",
                escaped(path),
                data_type,
                at[0],
                at[1],
            );
        }
        let _ = writeln!(text, "  </VRTRasterBand>");
    }
    text.push_str("</VRTDataset>\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Crs, GeoTransform};

    #[test]
    fn a_virtual_raster_names_its_files_and_their_places() {
        let grid = GridSpec {
            width: 700,
            height: 300,
            transform: GeoTransform::north_up(312_000.0, 4_160_500.0, 0.5),
            crs: Crs::from_epsg(32637).expect("UTM 37N"),
        };
        let band = BandInfo {
            description: "a < b & c".into(),
            colour: Colour::Grey,
            data_type: "Float32".into(),
            unit: "metre".into(),
            nodata: Some(-9999.0),
            scale: None,
            offset: None,
        };
        let part = |path: &str, at| Part {
            path: path.into(),
            at,
            size: (350, 300),
        };
        let parts = [part("../a/dsm.tif", [0, 0]), part("../b/dsm.tif", [350, 0])];
        let text = virtual_raster(&grid, &[band], &[("UNIT".into(), "metre".into())], &parts);
        assert!(text.contains("<Description>a &lt; b &amp; c</Description>"));
        assert!(text.contains("<GeoTransform>312000, 0.5, 0, 4160500, 0, -0.5</GeoTransform>"));
        assert!(text.contains("<DstRect xOff=\"350\" yOff=\"0\" xSize=\"350\" ySize=\"300\" />"));
        assert_eq!(text.matches("<SimpleSource>").count(), 2);
    }
}
