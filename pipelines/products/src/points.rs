//! The Gaussians as a point cloud: LAZ 1.4, points of format 7 with colours, and the classes of ground and, where it is
//! known, of vegetation.

use crate::model::LoadedModel;
use heliosplat::Raster;
use heliosplat::gaussians::POSITION;
use heliosplat::model::shadow_gs::ALBEDO;
use heliosplat_raster::geoid::{GeoidGrid, Undulation};
use heliosplat_raster::{Crs, CrsTransform, Geoid, GridSpec, RasterError, Result, preview, write_atomically};
use heliosplat_scene::indices::VEGETATION_INDEX;
use las::point::{Classification, Format};
use las::{Builder, Color, Point, Reader, Transform, Vector, Writer};
use nalgebra::Vector3;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Least opacity of a Gaussian that is a surface.
const OPACITY_KNOWN: f32 = 0.5;

/// Height above the ground from which vegetation is high, and below which other points are ground, metres.
const HIGH_M: f64 = 2.0;
const LOW_M: f64 = 0.5;

/// Step of the coordinates, metres; in other units the nearest power of ten.
const STEP_M: f64 = 0.001;

/// Writes the Gaussians of `model` that are opaque and within its area as a point cloud in the coordinates of `grid`;
/// returns their number. Their heights and those of `ground`, which lies on the grid, are metres above `geoid`, or the
/// ellipsoid.
///
/// # Errors
/// When the coordinate system does not cover the place, a geoid's grid is missing, or the file cannot be written.
pub fn write(
    path: &Path,
    model: &LoadedModel,
    (grid, ground): (&GridSpec, &Raster),
    geoid: Option<Geoid>,
) -> Result<usize> {
    let failed = |error: las::Error| RasterError::Write(path.to_owned(), error.to_string());
    let height_m = |point: &Point| {
        let cell = cell_of(grid, point);
        point.z - f64::from(ground.values[cell])
    };
    let points = points(model, &grid.crs, geoid, height_m)?;
    let bytes = encode(&points, &above(&grid.crs, geoid)?).map_err(failed)?;
    write_atomically(path, &bytes)?;
    Ok(points.len())
}

/// A coordinate system with its vertical part.
fn above(crs: &Crs, geoid: Option<Geoid>) -> Result<Crs> {
    geoid.map_or_else(|| Ok(crs.clone()), |geoid| geoid.compound(crs))
}

fn encode(points: &[Point], crs: &Crs) -> Result<Vec<u8>, las::Error> {
    let low = |pick: fn(&Point) -> f64| points.iter().map(pick).fold(f64::INFINITY, f64::min);
    let mut writer = writer(crs, [low(|p| p.x), low(|p| p.y), low(|p| p.z)])?;
    for point in points {
        writer.write_point(point.clone())?;
    }
    Ok(writer.into_inner()?.into_inner())
}

/// A writer into memory of points that begin at `low`.
fn writer(crs: &Crs, low: [f64; 3]) -> Result<Writer<Cursor<Vec<u8>>>, las::Error> {
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(7)?;
    builder.point_format.is_compressed = true;
    builder.generating_software = concat!("heliosplat ", env!("CARGO_PKG_VERSION")).into();
    builder.system_identifier = "MODELLED".into();
    // Without a date the same model gives the same bytes on any day.
    builder.date = None;
    // A power of ten, so that coordinates have no spurious digits.
    let step = 10f64.powf((STEP_M / crs.metres_per_unit()).log10().round());
    let axis = |low: f64, scale: f64| {
        let offset = if low.is_finite() { low.floor() } else { 0.0 };
        Transform { scale, offset }
    };
    let (x, y, z) = (axis(low[0], step), axis(low[1], step), axis(low[2], STEP_M));
    builder.transforms = Vector { x, y, z };
    let mut header = builder.into_header()?;
    let mut wkt = crs.wkt().as_bytes().to_vec();
    wkt.push(0);
    header.set_wkt_crs(wkt)?;
    Writer::new(Cursor::new(Vec::new()), header)
}

/// File of a point cloud, and the ground on which its points are taken: west, south, east, north, units of the map.
pub type Part = (PathBuf, [f64; 4]);

/// Merges point clouds over ellipsoidal heights into one file, the points of each on its own ground, so that none
/// occurs twice; returns the number of points. Heights in the file are metres above `geoid`, or the ellipsoid.
///
/// # Errors
/// When a cloud cannot be read, a geoid's grid is missing, or the file cannot be written.
pub fn merge(path: &Path, parts: &[Part], grid: &GridSpec, geoid: Option<Geoid>) -> Result<usize> {
    let failed = |error: las::Error| RasterError::Write(path.to_owned(), error.to_string());
    let crs = above(&grid.crs, geoid)?;
    let table = geoid.map(|geoid| GeoidGrid::new(geoid, grid)).transpose()?;
    let below = |point: &Point| {
        let cell = cell_of(grid, point);
        (table.as_ref()).map_or(0.0, |table| table.at(cell % grid.width, cell / grid.width))
    };
    let corner = grid.transform.map_from_pixel(-0.5, grid.height as f64 - 0.5);
    // Heights have the offset zero: the lowest is unknown until all are read.
    let mut writer = writer(&crs, [corner[0], corner[1], 0.0]).map_err(failed)?;
    let mut count = 0;
    for (part, [west, south, east, north]) in parts {
        let damaged = |error: las::Error| RasterError::Damaged(part.clone(), error.to_string());
        let mut reader = Reader::from_path(part).map_err(damaged)?;
        let all = reader.read_all().map_err(damaged)?;
        for point in all.points() {
            let mut point = point.map_err(damaged)?;
            if point.x >= *west && point.x < *east && point.y >= *south && point.y < *north {
                point.z -= below(&point);
                writer.write_point(point).map_err(failed)?;
                count += 1;
            }
        }
    }
    let bytes = writer.into_inner().map_err(failed)?.into_inner();
    write_atomically(path, &bytes)?;
    Ok(count)
}

/// Index of the cell of a grid in which a point lies; of the nearest cell for points beside the grid.
fn cell_of(grid: &GridSpec, point: &Point) -> usize {
    let [col, row] = grid.transform.pixel_from_map(point.x, point.y);
    let cell = |at: f64, cells: usize| (at.round().max(0.0) as usize).min(cells.saturating_sub(1));
    cell(row, grid.height) * grid.width + cell(col, grid.width)
}

/// Class of a point by its height above the ground, NaN where that is unknown, and whether it is green.
fn class(height_m: f64, is_green: bool) -> Classification {
    match is_green {
        true if height_m > HIGH_M => Classification::HighVegetation,
        true if height_m <= HIGH_M => Classification::LowVegetation,
        false if height_m <= LOW_M => Classification::Ground,
        _ => Classification::Unclassified,
    }
}

/// Points of a model; `height_m` is the height of a point above the ground.
fn points(
    model: &LoadedModel,
    crs: &Crs,
    geoid: Option<Geoid>,
    height_m: impl Fn(&Point) -> f64,
) -> Result<Vec<Point>> {
    let gaussians = &model.parameters.gaussians;
    let bands = model.file.bands.len();
    let albedo = gaussians.group(ALBEDO);
    let shown = if bands < 3 { [0, 0, 0] } else { [0, 1, 2] };
    let brightest = preview::percentiles(albedo, 0.0, 0.99).map_or(1.0, |(_, high)| high.max(1e-6));
    let index = model.file.ndvi();
    let area = model.file.area;
    let transform = CrsTransform::from_lon_lat(crs)?;
    let undulation = geoid.map(Undulation::new).transpose()?;
    let mut points = Vec::new();
    for i in 0..gaussians.count {
        let at = &gaussians.group(POSITION)[3 * i..3 * i + 3];
        let [east, north, up] = [at[0], at[1], at[2]].map(f64::from);
        let inside = (area.west_m..=area.east_m).contains(&east) && (area.south_m..=area.north_m).contains(&north);
        if !inside || gaussians.opacity(i) < OPACITY_KNOWN {
            continue;
        }
        let geo = model.frame.geo_from_enu(Vector3::new(east, north, up));
        let (x, y) = transform.apply(geo.lon_deg, geo.lat_deg)?;
        let below = match &undulation {
            Some(undulation) => undulation.at(geo.lon_deg, geo.lat_deg)?,
            None => 0.0,
        };
        let colour = &albedo[bands * i..bands * (i + 1)];
        let green = index.is_some_and(|index| index.of(|band| colour[band]) > VEGETATION_INDEX);
        let count = |band: usize| (colour[band] / brightest).clamp(0.0, 1.0).powf(1.0 / 2.2) * f32::from(u16::MAX);
        let [red, g, blue] = shown.map(|band| count(band).round() as u16);
        let mut point = Point {
            x,
            y,
            z: geo.height_m - below,
            return_number: 1,
            number_of_returns: 1,
            is_synthetic: true,
            gps_time: Some(0.0),
            color: Some(Color::new(red, g, blue)),
            ..Point::default()
        };
        point.classification = class(height_m(&point), green);
        points.push(point);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lawns_are_low_vegetation_trees_high_and_roofs_no_ground() {
        assert_eq!(class(0.1, true), Classification::LowVegetation);
        assert_eq!(class(8.0, true), Classification::HighVegetation);
        assert_eq!(class(-0.1, false), Classification::Ground);
        assert_eq!(class(8.0, false), Classification::Unclassified);
        assert_eq!(class(f64::NAN, true), Classification::Unclassified);
        assert_eq!(class(f64::NAN, false), Classification::Unclassified);
    }
}
