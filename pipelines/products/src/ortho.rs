//! Ortho products on a map grid: albedo, vegetation, hillshade.

use super::surface::ALPHA_KNOWN;
use crate::model::LoadedModel;
use heliosplat::Raster;
use heliosplat::splat::Maps;
use heliosplat_scene::indices::{NormalisedDifference, VEGETATION_INDEX};

/// Albedo seen from straight above, band by band; `NaN` where unknown. Level ground of albedo 1 in full sun is as
/// bright as one unit of the model's colours.
pub fn albedo(model: &LoadedModel, maps: &Maps) -> Raster {
    let bands = model.file.bands.len();
    let mut out = Raster::filled(maps.width, maps.height, bands, f32::NAN);
    for band in 0..bands {
        let values = out.plane_mut(band).iter_mut();
        let cells = values.zip(&maps.channels[band]).zip(&maps.alpha);
        let known = cells.filter(|(_, alpha)| **alpha >= ALPHA_KNOWN);
        known.for_each(|((value, channel), alpha)| *value = channel / alpha);
    }
    out
}

/// Vegetation mask of an albedo: 1 for vegetation, else 0, `NaN` where the albedo is unknown.
pub fn vegetation(albedo: &Raster, index: NormalisedDifference) -> Raster {
    let plane = albedo.plane_len();
    let values = (0..plane).map(|pixel| match index.of(|band| albedo.values[band * plane + pixel]) {
        index if index.is_nan() => f32::NAN,
        index => f32::from(u8::from(index > VEGETATION_INDEX)),
    });
    Raster {
        bands: 1,
        values: values.collect(),
        ..*albedo
    }
}

/// Hillshade of an altitude, metres, lit from the north-west at 45°: shades 1 to 255, `NaN` where the altitude is
/// unknown. Slopes are Horn's 3 × 3 differences (Horn 1981, as `gdaldem hillshade`). Cells are `[width_m, height_m]`
/// metres; unknown neighbours count as level with the cell.
pub fn hillshade(altitude: &Raster, [width_m, height_m]: [f64; 2]) -> Raster {
    let (width, height) = (altitude.width, altitude.height);
    let plane = altitude.plane(0);
    let light = [-0.5f64, 0.5, std::f64::consts::FRAC_1_SQRT_2];
    let mut out = Raster::filled(width, height, 1, f32::NAN);
    for row in 0..height {
        for col in 0..width {
            let centre = plane[row * width + col];
            if !centre.is_finite() {
                continue;
            }
            let at = |dc: isize, dr: isize| {
                let c = col.saturating_add_signed(dc).min(width - 1);
                let r = row.saturating_add_signed(dr).min(height - 1);
                let value = plane[r * width + c];
                f64::from(if value.is_finite() { value } else { centre })
            };
            let to_east =
                (at(1, -1) + 2.0 * at(1, 0) + at(1, 1) - at(-1, -1) - 2.0 * at(-1, 0) - at(-1, 1)) / (8.0 * width_m);
            let to_north =
                (at(-1, -1) + 2.0 * at(0, -1) + at(1, -1) - at(-1, 1) - 2.0 * at(0, 1) - at(1, 1)) / (8.0 * height_m);
            let length = (1.0 + to_east * to_east + to_north * to_north).sqrt();
            let shade = ((light[2] - to_east * light[0] - to_north * light[1]) / length).max(0.0);
            out.values[row * width + col] = (1.0 + 254.0 * shade) as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_scene::{BandKind, Values};

    #[test]
    fn a_plane_is_as_bright_as_its_slope_faces_the_light() {
        // One in one, facing north-west: the light is 45 degrees up there, so it falls straight onto the plane.
        let mut facing = Raster::filled(8, 8, 1, 0.0);
        for row in 0..8 {
            for col in 0..8 {
                facing.values[row * 8 + col] = (col + row) as f32 * 0.5 * std::f32::consts::FRAC_1_SQRT_2;
            }
        }
        let away = Raster {
            values: facing.values.iter().map(|v| -v).collect(),
            ..facing.clone()
        };
        let at = |raster: &Raster| hillshade(raster, [0.5; 2]).at(0, 4, 4);
        assert!((at(&facing) - 255.0).abs() < 0.01, "{}", at(&facing));
        assert!((at(&away) - 1.0).abs() < 0.01, "{}", at(&away));
        let level = hillshade(&Raster::filled(4, 4, 1, 7.0), [0.5; 2]);
        let expected = 1.0 + 254.0 * std::f32::consts::FRAC_1_SQRT_2;
        assert!(level.values.iter().all(|v| (v - expected).abs() < 0.01));
    }

    #[test]
    fn narrow_cells_are_as_steep_as_they_are_narrow() {
        // One in one toward the east, in cells half as wide as high.
        let values = (0..64).map(|cell| (cell % 8) as f32 * 0.5).collect();
        let slope = Raster {
            width: 8,
            height: 8,
            bands: 1,
            values,
        };
        let expected = 1.0 + 254.0 * (0.5 + std::f32::consts::FRAC_1_SQRT_2) * std::f32::consts::FRAC_1_SQRT_2;
        assert!((hillshade(&slope, [0.5, 1.0]).at(0, 4, 4) - expected).abs() < 0.01);
    }

    #[test]
    fn what_is_not_known_has_no_shade_and_no_vegetation() {
        let mut raster = Raster::filled(3, 3, 2, 0.2);
        raster.values[0] = f32::NAN;
        raster.plane_mut(1).fill(0.6);
        let bands = [BandKind::Red, BandKind::NearInfrared];
        let index = Values::default().ndvi(&bands).expect("both bands");
        let (shade, leaves) = (hillshade(&raster, [1.0; 2]), vegetation(&raster, index));
        assert!(shade.values[0].is_nan() && leaves.values[0].is_nan());
        assert!(shade.values[1].is_finite() && leaves.values[1] == 1.0);
    }
}
