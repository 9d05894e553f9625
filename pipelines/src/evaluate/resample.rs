//! Bringing a raster onto another's grid.

use crate::raster::{CrsTransform, GeoRaster, RasterError};
use heliosplat::Raster;

/// Altitude (first band) of `source` at the cell centres of `target`, bilinear; `NaN` where nothing is known. Where one
/// of the two does not say its coordinate system, both are taken to be in the same.
///
/// # Errors
/// When a coordinate system cannot be used.
pub fn onto(source: &GeoRaster, target: &GeoRaster) -> Result<Raster, RasterError> {
    let transform = match (&target.crs, &source.crs) {
        (Some(from), Some(to)) if from.wkt() != to.wkt() => Some(CrsTransform::new(from, to)?),
        _ => None,
    };
    let mut out = Raster::filled(target.raster.width, target.raster.height, 1, f32::NAN);
    for row in 0..out.height {
        for col in 0..out.width {
            let [x, y] = target.transform.map_from_pixel(col as f64, row as f64);
            let (x, y) = match &transform {
                // A cell outside the source's coordinate system has no altitude there.
                Some(transform) => match transform.apply(x, y) {
                    Ok(point) => point,
                    Err(_) => continue,
                },
                None => (x, y),
            };
            let [from_col, from_row] = source.transform.pixel_from_map(x, y);
            out.values[row * target.raster.width + col] = bilinear(&source.raster, from_col, from_row);
        }
    }
    Ok(out)
}

/// First band at a fractional pixel position. Missing neighbours make the value missing, except those whose weight is
/// next to nothing; positions up to half a pixel outside take the edge's value.
pub fn bilinear(raster: &Raster, col: f64, row: f64) -> f32 {
    /// Grids that agree up to rounding must not lose the cells beside missing ones.
    const NEGLIGIBLE: f64 = 1e-6;
    let (width, height) = (raster.width as f64, raster.height as f64);
    let inside = col >= -0.5 && row >= -0.5 && col <= width - 0.5 && row <= height - 0.5;
    if !inside {
        return f32::NAN;
    }
    let (col, row) = (col.clamp(0.0, width - 1.0), row.clamp(0.0, height - 1.0));
    let (c0, r0) = (col.floor(), row.floor());
    let (fc, fr) = (col - c0, row - r0);
    let mut sum = 0.0;
    for (dc, dr, weight) in [
        (0.0, 0.0, (1.0 - fc) * (1.0 - fr)),
        (1.0, 0.0, fc * (1.0 - fr)),
        (0.0, 1.0, (1.0 - fc) * fr),
        (1.0, 1.0, fc * fr),
    ] {
        if weight > NEGLIGIBLE {
            let (c, r) = ((c0 + dc).min(width - 1.0), (r0 + dr).min(height - 1.0));
            sum += weight * f64::from(raster.at(0, c as usize, r as usize));
        }
    }
    sum as f32
}
