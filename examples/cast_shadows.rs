//! The shadows that a surface model casts on itself.
//!
//! Usage: `cast_shadows DSM.tif AZIMUTH ELEVATION OUT.tif` (of the sun, degrees; azimuth clockwise from the north of the grid)
//!
//! Writes an 8-bit GeoTIFF on the grid of the surface model: 1 in shadow, 0 in the sun, 255 where the height is unknown. A cell is in
//! shadow when a height on the way toward the sun reaches above the ray to the sun.

use heliosplat::Raster;
use heliosplat_raster::{Bytes, GeoRaster, ImageSpec, dsm_bands, write_byte_cog};
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, azimuth, elevation, out] = arguments.as_slice() else {
        return Err("usage: cast_shadows DSM.tif AZIMUTH ELEVATION OUT.tif".into());
    };
    let (azimuth, elevation): (f64, f64) = (azimuth.parse()?, elevation.parse()?);
    if !(azimuth.is_finite() && elevation > 0.0 && elevation < 90.0) {
        return Err("the sun's elevation must be between 0 and 90 degrees".into());
    }
    let dsm = GeoRaster::read(Path::new(path))?;
    let crs = dsm.crs.as_ref().ok_or("the surface model has no coordinate system")?;
    let band = dsm.band(dsm_bands::ALTITUDE).unwrap_or(0);
    let step = dsm.transform.pixel_size().0 / 4.0;
    let (east, north) = azimuth.to_radians().sin_cos();
    let [col0, row0] = dsm.transform.pixel_from_map(0.0, 0.0);
    let [col1, row1] = dsm.transform.pixel_from_map(east * step, north * step);
    let rise_m = step * crs.metres_per_unit() * elevation.to_radians().tan();
    let mask = shadows(&dsm.raster, band, [col1 - col0, row1 - row0], rise_m as f32);
    let spec = ImageSpec {
        band_descriptions: &["shadow"],
        georeference: Some((&dsm.transform, crs)),
        ..ImageSpec::plain(&mask)
    };
    write_byte_cog(Path::new(out), &spec, Bytes::Mask)?;
    let dark = mask.values.iter().filter(|&&value| value == 1.0).count();
    println!(
        "{out}: {:.1} % in shadow",
        100.0 * dark as f64 / mask.values.len() as f64
    );
    Ok(())
}

/// Walks from every cell toward the sun by `step` (columns, rows), each of which lifts the ray by `rise_m`.
fn shadows(heights: &Raster, band: usize, step: [f64; 2], rise_m: f32) -> Raster {
    let highest = heights.plane(band).iter().copied().fold(f32::MIN, f32::max);
    let (width, height) = (heights.width, heights.height);
    let mut mask = Raster::filled(width, height, 1, f32::NAN);
    for (index, shadow) in mask.values.iter_mut().enumerate() {
        let (col, row) = (index % width, index / width);
        let start = heights.at(band, col, row);
        if start.is_nan() {
            continue;
        }
        let (mut x, mut y, mut ray) = (col as f64, row as f64, start);
        *shadow = 0.0;
        // Until the ray is above all heights or leaves the grid; unknown heights cast no shadow.
        while ray < highest && *shadow == 0.0 {
            (x, y, ray) = (x + step[0], y + step[1], ray + rise_m);
            let (c, r) = (x.round(), y.round());
            if c < 0.0 || r < 0.0 || c >= width as f64 || r >= height as f64 {
                break;
            }
            *shadow = f32::from(heights.at(band, c as usize, r as usize) > ray);
        }
    }
    mask
}
