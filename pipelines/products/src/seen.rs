//! Number of training images that see each cell of a surface.

use crate::model::{ModelFile, ModelImage};
use crate::nadir::NadirGrid;
use crate::views::camera_of;
use glam::Vec3;
use heliosplat::ProjectiveCamera;
use heliosplat_stereo::{AltitudeGrid, Witnesses, views_seeing};

/// Training images that see each cell of `nadir`'s grid at its ellipsoidal `altitude_m` (metres; cells of NaN are seen
/// by none): their number and their base-to-height ratio. Pixels without data and pixels of clouds see nothing.
pub fn views(nadir: &NadirGrid, altitude_m: &[f32], model: &ModelFile) -> Witnesses {
    let (width, height) = (nadir.grid.width, nadir.grid.height);
    let cell_m = nadir.grid.transform.pixel_size().0 * nadir.grid.crs.metres_per_unit();
    let enu = |cell: usize| {
        let height_m = f64::from(altitude_m[cell]);
        let height_m = Some(height_m).filter(|height_m| height_m.is_finite());
        let height_m = height_m.unwrap_or(model.origin.height_m);
        nadir.enu.enu((cell % width) as f64, (cell / width) as f64, height_m)
    };
    // Rays are walked over a grid of the local frame; the map grid is turned against it.
    let corners = [0, width - 1, (height - 1) * width, height * width - 1].map(enu);
    let bound = |axis: usize, sign: f64| sign * corners.iter().map(|c| sign * c[axis]).fold(f64::MIN, f64::max);
    let (west, south) = (bound(0, -1.0) - cell_m, bound(1, -1.0) - cell_m);
    let (east, north) = (bound(0, 1.0) + cell_m, bound(1, 1.0) + cell_m);
    let size = [east - west, north - south].map(|length| (length / cell_m).ceil().max(1.0) as usize);
    let standing: Vec<f32> = (0..size[0] * size[1])
        .map(|i| {
            let x = west + (0.5 + (i % size[0]) as f64) * cell_m;
            let y = north - (0.5 + (i / size[0]) as f64) * cell_m;
            let pixel = nadir.camera.pixel(Vec3::new(x as f32, y as f32, 0.0));
            let cell = pixel.filter(|&(cell, _)| altitude_m[cell].is_finite());
            cell.map_or(f32::NAN, |(cell, _)| enu(cell)[2] as f32)
        })
        .collect();
    let seeing: Vec<&ModelImage> = model.images.iter().filter(|image| image.appearance.is_some()).collect();
    let cameras: Vec<ProjectiveCamera> = seeing.iter().map(|image| camera_of(image)).collect();
    let surface = AltitudeGrid {
        size: (size[0], size[1]),
        west_m: west as f32,
        north_m: north as f32,
        cell_m: cell_m as f32,
        altitude_m: &standing,
        standing_m: &standing,
        resolution_m: cell_m as f32,
    };
    let seen = views_seeing(&surface, &cameras, &|view, pixel| {
        let image = seeing[view];
        let at = (pixel % image.crop.width, pixel / image.crop.width);
        image.known.as_ref().is_none_or(|known| known.at(at))
    });
    let of_cell = |cell: usize| {
        if !altitude_m[cell].is_finite() {
            return (0, 0.0);
        }
        let [x, y, _] = enu(cell);
        let (col, row) = (((x - west) / cell_m) as usize, ((north - y) / cell_m) as usize);
        let at = row.min(size[1] - 1) * size[0] + col.min(size[0] - 1);
        (seen.views[at], seen.base_to_height[at])
    };
    let (views, base_to_height) = (0..width * height).map(of_cell).unzip();
    Witnesses { views, base_to_height }
}
