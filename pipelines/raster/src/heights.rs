//! Heights in metres, from scaled integers and from other units.

use super::dsm_bands::STANDARD_DEVIATION;
use super::{GeoRaster, RasterError, RasterFile, Result};
use heliosplat::Raster;
use std::path::Path;

/// Metres of an international foot and of a US survey foot.
const FEET_M: [f64; 2] = [0.3048, 1200.0 / 3937.0];

impl RasterFile {
    /// Reads a whole band (0-based) of heights as metres; `NaN` where pixels are missing.
    ///
    /// # Errors
    /// [`RasterError::HeightUnit`] for a unit that is no known length, [`RasterError::Damaged`] when the pixels cannot
    /// be read.
    pub fn read_heights(&self, band: usize) -> Result<Raster> {
        let mut heights = self.read(self.whole(), &[band])?;
        let unit_m = self.metres_per_height(band)?;
        self.scale(band, unit_m, &mut heights.values);
        Ok(heights)
    }

    /// Metres per unit of a band of heights: of its own unit, else of the vertical coordinate system, else 1.
    fn metres_per_height(&self, band: usize) -> Result<f64> {
        let unit = self.bands.get(band).map_or("", |band| band.unit.trim());
        if unit.is_empty() {
            return Ok(self.crs().and_then(|crs| crs.metres_per_height()).unwrap_or(1.0));
        }
        metres_per_unit(unit).ok_or_else(|| RasterError::HeightUnit(self.path().to_owned(), unit.to_owned()))
    }

    /// Applies scale and offset of a band, and metres per unit, to its values.
    fn scale(&self, band: usize, unit_m: f64, values: &mut [f32]) {
        let stated = self.bands.get(band).map(|band| (band.scale, band.offset));
        let (scale, offset) = stated.unwrap_or_default();
        let scale = scale.filter(|&scale| scale != 0.0).unwrap_or(1.0);
        let offset = offset.unwrap_or(0.0);
        if (scale, offset, unit_m) == (1.0, 0.0, 1.0) {
            return;
        }
        for value in values {
            *value = ((f64::from(*value) * scale + offset) * unit_m) as f32;
        }
    }
}

impl GeoRaster {
    /// Reads a georeferenced file with heights in its first band: heights and their standard deviations in metres, the
    /// other bands with their scale and offset applied.
    ///
    /// # Errors
    /// A file that cannot be opened or read or has no georeferencing, as [`GeoRaster::read`];
    /// [`RasterError::HeightUnit`] for a unit that is no known length.
    pub fn read_heights(path: &Path) -> Result<Self> {
        let mut found = Self::read(path)?;
        let file = RasterFile::open(path)?;
        let unit_m = file.metres_per_height(0)?;
        for band in 0..found.raster.bands {
            let is_height = band == 0 || found.band_names[band] == STANDARD_DEVIATION;
            file.scale(band, if is_height { unit_m } else { 1.0 }, found.raster.plane_mut(band));
        }
        Ok(found)
    }
}

/// Metres per unit of length, by the names in use; `None` for any other text.
fn metres_per_unit(unit: &str) -> Option<f64> {
    let lower = unit.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphanumeric()).collect();
    let has = |names: &[&str]| words.iter().any(|word| names.contains(word));
    let survey = has(&["us", "survey", "usft", "ftus", "sft"]);
    if has(&["ft", "feet", "foot", "usft", "ftus", "sft"]) {
        return Some(FEET_M[usize::from(survey)]);
    }
    let metric = [
        (1.0, ["m", "metre", "metres", "meter", "meters"].as_slice()),
        (0.1, &["dm", "decimetre", "decimetres", "decimeter", "decimeters"]),
        (0.01, &["cm", "centimetre", "centimetres", "centimeter", "centimeters"]),
        (0.001, &["mm", "millimetre", "millimetres", "millimeter", "millimeters"]),
        (1000.0, &["km", "kilometre", "kilometres", "kilometer", "kilometers"]),
    ];
    metric.iter().find(|(_, names)| has(names)).map(|(metres, _)| *metres)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_length_are_known_by_the_names_that_programs_give_them() {
        for (unit, metres) in [
            ("m", 1.0),
            ("metre", 1.0),
            ("Meters (ellipsoidal)", 1.0),
            ("ft", 0.3048),
            ("foot", 0.3048),
            ("US survey foot", 1200.0 / 3937.0),
            ("us-ft", 1200.0 / 3937.0),
            ("ft(us)", 1200.0 / 3937.0),
            ("cm", 0.01),
        ] {
            assert_eq!(metres_per_unit(unit), Some(metres), "{unit}");
        }
        assert_eq!(metres_per_unit("degree"), None);
    }
}
