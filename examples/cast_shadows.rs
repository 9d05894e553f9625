//! The shadows that a surface model casts on itself.
//!
//! Usage: `cast_shadows DSM.tif AZIMUTH ELEVATION OUT.tif` (of the sun, degrees; azimuth clockwise from the north of
//! the grid)
//!
//! Writes an 8-bit GeoTIFF on the grid of the surface model, whose cells are taken to be square: 1 in shadow, 0 in the
//! sun, 255 where the height is unknown. A cell is in shadow when a height on the way toward the sun reaches above the
//! ray to the sun.

use heliosplat::Raster;
use heliosplat_grid::relief::Relief;
use heliosplat_raster::{Bytes, GeoRaster, ImageSpec, dsm_bands, write_byte_cog};
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    if let Err(error) = run() {
        eprintln!("error: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
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
    let heights = dsm.raster.plane(band).to_vec();
    let cell_m = dsm.transform.pixel_size().0 * crs.metres_per_unit();
    let relief = Relief::new((dsm.raster.width, dsm.raster.height), cell_m as f32, heights);
    let shaded = relief.shadows(azimuth, elevation);
    let value = |cell: usize| match relief.is_known(cell) {
        true => f32::from(u8::from(shaded[cell])),
        false => f32::NAN,
    };
    let mask = Raster {
        width: relief.width,
        height: relief.height,
        bands: 1,
        values: (0..shaded.len()).map(value).collect(),
    };
    let spec = ImageSpec {
        band_descriptions: &["shadow"],
        georeference: Some((&dsm.transform, crs)),
        ..ImageSpec::plain(&mask)
    };
    write_byte_cog(Path::new(out), &spec, Bytes::Mask)?;
    Ok(())
}
