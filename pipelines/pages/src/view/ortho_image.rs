//! Image of a run on the page's grid: its picture in the run's `views` folder, projected onto the surface.

use heliosplat::Raster;
use heliosplat_products::model::{LoadedModel, ModelImage};
use heliosplat_products::views::camera_of;
use heliosplat_raster::{EnuGrid, GridSpec, RasterError};
use image::RgbImage;
use rayon::prelude::*;

/// A cell is occluded if another cell on the same pixel is nearer to the camera by more than this depth, metres.
const HIDDEN_M: f32 = 1.5;

/// Red, green and blue, 0 to 255, on the cells of `grid`, interpolated bilinearly in the left panel of `picture`, which
/// shows `image`. NaN where the surface is unknown, outside the image, or occluded in it.
///
/// # Errors
/// When the grid lies outside its coordinate reference system.
pub(super) fn project(
    model: &LoadedModel,
    image: &ModelImage,
    picture: &RgbImage,
    (grid, altitude): (&GridSpec, &Raster),
) -> Result<Raster, RasterError> {
    let enu = EnuGrid::new(&model.frame, grid, model.file.altitude_range_m)?;
    let camera = camera_of(image);
    let (width, height) = (camera.width, camera.height);
    let cells = grid.width * grid.height;
    // Column, row and depth (metres) of each cell in the image.
    let place = |i: usize| {
        let (col, row) = (i % grid.width, i / grid.width);
        let z = altitude.plane(0)[i];
        let point = enu.enu(col as f64, row as f64, f64::from(z)).map(|v| v as f32).into();
        let (x, y, _) = camera.project(point);
        let inside = x >= 0.0 && y >= 0.0 && x <= (width - 1) as f32 && y <= (height - 1) as f32;
        (z.is_finite() && inside).then(|| ([x, y], camera.depth(point)))
    };
    let cells_of_grid = (0..cells).into_par_iter().with_min_len(1024);
    let seen: Vec<Option<([f32; 2], f32)>> = cells_of_grid.map(place).collect();
    let pixel = |[x, y]: [f32; 2]| y.round() as usize * width + x.round() as usize;
    let mut nearest = vec![f32::INFINITY; width * height];
    for &(at, depth) in seen.iter().flatten() {
        let slot = &mut nearest[pixel(at)];
        *slot = slot.min(depth);
    }
    let mut out = Raster::filled(grid.width, grid.height, 3, f32::NAN);
    for (i, found) in seen.iter().enumerate() {
        let Some(([x, y], depth)) = *found else { continue };
        if depth > nearest[pixel([x, y])] + HIDDEN_M {
            continue;
        }
        let (fx, fy) = (x.fract(), y.fract());
        for band in 0..3 {
            let at = |dx: u32, dy: u32| {
                let col = (x as u32 + dx).min(width as u32 - 1);
                let row = (y as u32 + dy).min(height as u32 - 1);
                f32::from(picture.get_pixel(col, row).0[band])
            };
            let top = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
            let bottom = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
            out.values[band * cells + i] = top * (1.0 - fy) + bottom * fy;
        }
    }
    Ok(out)
}
