//! Pixels that a file declares missing by a mask: one inside the file, that of `X.tif.msk` beside `X.tif`, or a band of
//! opacity.
//!
//! GDAL looks for a mask under the file's own name only, and opens it with the registered formats.

use super::{RasterError, Window, bounded};
use gdal::Dataset;
use gdal::errors::Result;
use gdal::raster::RasterBand;
use std::path::{Path, PathBuf};

/// The mask that GDAL reads beside a file.
pub(super) fn mask_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".msk");
    name.into()
}

/// Applies `read` to the mask of a band (0-based); `None` where the band has no mask, or one derived from its nodata
/// value or from a band of opacity.
pub(super) fn of_band<T>(
    dataset: &Dataset,
    band: usize,
    read: impl FnOnce(&RasterBand) -> Result<T>,
) -> Result<Option<T>> {
    let band = dataset.rasterband(band + 1)?;
    let flags = band.mask_flags()?;
    // Nodata values that hold for all bands together (`NODATA_VALUES`) are a mask, that of one band is not.
    let is_stated = !flags.is_all_valid() && !flags.is_alpha() && (!flags.is_nodata() || flags.is_per_dataset());
    if !is_stated {
        return Ok(None);
    }
    let mask = band.open_mask_band()?;
    read(&mask).map(Some)
}

/// Sets pixels of `values`, a window of one band, to `NaN` where the mask of the band or the band of opacity is zero.
pub(super) fn blank(
    dataset: &Dataset,
    band: usize,
    opacity: Option<usize>,
    window: Window,
    values: &mut [f32],
) -> Result<()> {
    let origin = (window.col0 as isize, window.row0 as isize);
    let size = (window.width, window.height);
    let mut apply = |mask: &RasterBand| {
        let (_, valid) = mask.read_as::<f32>(origin, size, size, None)?.into_shape_and_vec();
        for (value, valid) in values.iter_mut().zip(valid) {
            if valid.is_nan() || valid == 0.0 {
                *value = f32::NAN;
            }
        }
        Ok(())
    };
    of_band(dataset, band, &mut apply)?;
    match opacity.filter(|&opacity| opacity != band) {
        Some(opacity) => apply(&dataset.rasterband(opacity + 1)?),
        None => Ok(()),
    }
}

/// Refuses a mask beside a file that GDAL does not read, or that has another size.
pub(super) fn check(path: &Path, dataset: &Dataset) -> std::result::Result<(), RasterError> {
    let unreadable = |path: PathBuf, reason: String| RasterError::Unreadable(path, reason);
    let mask =
        of_band(dataset, 0, |mask| Ok(mask.size())).map_err(|error| unreadable(path.to_owned(), error.to_string()))?;
    let beside = mask_path(path);
    let Some(size) = mask else {
        let reason = "it is no mask of the image beside it; move it away, or make it again".to_owned();
        return match beside.is_file() && bounded::read_start(&beside, 1).len() == 1 {
            true => Err(unreadable(beside, reason)),
            false => Ok(()),
        };
    };
    let own = dataset.raster_size();
    if size != own {
        let reason = format!("a mask of {} x {} pixels for {} x {}", size.0, size.1, own.0, own.1);
        let path = if beside.is_file() { beside } else { path.to_owned() };
        return Err(unreadable(path, reason));
    }
    Ok(())
}
