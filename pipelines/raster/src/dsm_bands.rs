//! The files of a surface model: one GeoTIFF of one band for the altitude, and one for each companion beside it, such
//! as `dsm.tif`, `dsm_stddev.tif`, `dsm_coverage.tif` and `dsm_views.tif`. Products write these files, and all other
//! code reads them here.

use crate::{GeoRaster, Result, is_virtual};
use std::path::{Path, PathBuf};

/// Altitude, metres above the ellipsoid or a geoid.
pub const ALTITUDE: &str = "altitude";
/// Standard deviation of the altitude, metres.
pub const STANDARD_DEVIATION: &str = "standard_deviation";
/// Accumulated alpha, or confidence of the plane sweep, 0 to 1.
pub const COVERAGE: &str = "coverage";
/// Number of images that see the cell at its altitude.
pub const VIEWS: &str = "views";

/// Bands of a surface model besides the altitude, with the suffixes of their files.
pub const COMPANIONS: [(&str, &str); 3] = [(STANDARD_DEVIATION, "stddev"), (COVERAGE, "coverage"), (VIEWS, "views")];

/// The file beside `path` whose name ends in `suffix`: `dsm_views.tif` beside `dsm.tif`.
pub fn companion(path: &Path, suffix: &str) -> PathBuf {
    // Joined by hand: `with_extension` would cut `dsm_0.5m_views` at its dot.
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push("_");
    name.push(suffix);
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

impl GeoRaster {
    /// Reads a surface model: its altitude, and the companions beside it as further bands. A file that contains all
    /// bands itself is read alone. A companion on another grid is left out with a warning.
    ///
    /// # Errors
    /// A file that cannot be opened or read, has no georeferencing, or states heights in no known length, as
    /// [`GeoRaster::read_heights`].
    pub fn read_surface(path: &Path) -> Result<Self> {
        let mut surface = Self::read_heights(path)?;
        if surface.raster.bands > 1 || is_virtual(path) {
            return Ok(surface);
        }
        surface.band_names = vec![ALTITUDE.to_owned()];
        for (band, suffix) in COMPANIONS {
            let path = companion(path, suffix);
            if !path.is_file() {
                continue;
            }
            let read = match band {
                STANDARD_DEVIATION => Self::read_heights,
                _ => Self::read,
            };
            let other = read(&path)?;
            let place = |file: &Self| (file.raster.width, file.raster.height, file.transform);
            if place(&other) != place(&surface) {
                let path = path.display();
                tracing::warn!("{path}: left out, it is not on the grid of its surface model");
                continue;
            }
            surface.raster.values.extend_from_slice(other.raster.plane(0));
            surface.raster.bands += 1;
            surface.band_names.push(band.to_owned());
        }
        Ok(surface)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn companions_of_names_with_dots_keep_the_whole_name() {
        let of = |path: &str| companion(Path::new(path), "views");
        assert_eq!(of("out/dsm.tif"), Path::new("out/dsm_views.tif"));
        assert_eq!(of("out/dsm_0.5m.tif"), Path::new("out/dsm_0.5m_views.tif"));
        assert_eq!(of("v1.2/site.2024-05.tiff"), Path::new("v1.2/site.2024-05_views.tiff"));
        assert_eq!(of("dsm"), Path::new("dsm_views"));
    }
}
