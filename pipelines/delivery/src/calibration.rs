//! Calibration of pixel values in the metadata: gains or a display curve.

use super::Result;
use super::entry::ImageEntry;
use super::files::Folders;
use super::names::file_name;
use super::sidecars::describing_texts;
use heliosplat_raster::RasterFile;
use heliosplat_rpc::read::calibration::{self, Calibration, Radiometry};

/// Calibration of an image, with its source.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct FoundRadiometry {
    /// Gains of the bands, or a display curve.
    #[serde(skip)]
    pub radiometry: Radiometry,
    /// Name of the file with the calibration, or `image` for the image file itself and the metadata that GDAL found
    /// beside it.
    pub source: String,
}

/// Calibration of an image from the first source that contains one: texts that describe the image, then the image file.
pub(super) fn find(file: &RasterFile, entry: &ImageEntry, folders: &Folders) -> Result<Option<FoundRadiometry>> {
    for path in describing_texts(entry, file.path(), folders)? {
        if let Some(radiometry) = calibration::from_text(&folders.text(&path)?) {
            let source = file_name(&path);
            return Ok(Some(FoundRadiometry { radiometry, source }));
        }
    }
    Ok(in_image(file).map(|radiometry| FoundRadiometry {
        radiometry,
        source: "image".to_owned(),
    }))
}

/// Calibration in the image file: in its description, in GDAL's `IMD` domain, or as scale and unit of every band.
fn in_image(file: &RasterFile) -> Option<Radiometry> {
    let described = || calibration::from_text(file.domain("").get("TIFFTAG_IMAGEDESCRIPTION")?);
    let scales = || {
        let bands = file.bands.iter();
        let said = bands.map(|band| (band.scale, band.offset, band.unit.as_str()));
        let said: Vec<_> = said.collect();
        Calibration::of_bands(&said)
    };
    let found = described().or_else(|| calibration::gdal_domain(&file.domain("IMD")));
    found.or_else(scales)
}
