//! The Gaussians as a point cloud: LAZ 1.4, points of format 7 with colours, and the class of vegetation where it is
//! known.

use crate::model::LoadedModel;
use heliosplat::gaussians::POSITION;
use heliosplat::model::shadow_gs::ALBEDO;
use heliosplat_raster::geoid::{GeoidGrid, Undulation};
use heliosplat_raster::{Crs, CrsTransform, Geoid, GridSpec, RasterError, Result, preview, write_atomically};
use heliosplat_scene::indices::VEGETATION_INDEX;
use las::point::{Classification, Format};
use las::{Builder, Color, Point, Reader, Transform, Vector, Writer};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Least opacity of a Gaussian that is a surface.
const OPACITY_KNOWN: f32 = 0.5;

/// Height above which vegetation is high, metres, and width of the cells in which the ground is sought, metres.
const HIGH_M: f64 = 2.0;
const CELL_M: f64 = 5.0;

/// Step of the coordinates, metres; in other units the nearest power of ten.
const STEP_M: f64 = 0.001;

/// Writes the Gaussians of `model` that are opaque and within its area as a point cloud in `crs`; returns their number.
/// Heights are metres above `geoid`, or the ellipsoid.
///
/// # Errors
/// When the coordinate system does not cover the place, a geoid's grid is missing, or the file cannot be written.
pub fn write(path: &Path, model: &LoadedModel, crs: &Crs, geoid: Option<Geoid>) -> Result<usize> {
    let failed = |error: las::Error| RasterError::Write(path.to_owned(), error.to_string());
    let points = points(model, crs, geoid)?;
    let bytes = encode(&points, &above(crs, geoid)?).map_err(failed)?;
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
    let below = |x: f64, y: f64| {
        let [col, row] = grid.transform.pixel_from_map(x, y);
        let cell = |at: f64, cells: usize| (at.round().max(0.0) as usize).min(cells.saturating_sub(1));
        let (col, row) = (cell(col, grid.width), cell(row, grid.height));
        table.as_ref().map_or(0.0, |table| table.at(col, row))
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
                point.z -= below(point.x, point.y);
                writer.write_point(point).map_err(failed)?;
                count += 1;
            }
        }
    }
    let bytes = writer.into_inner().map_err(failed)?.into_inner();
    write_atomically(path, &bytes)?;
    Ok(count)
}

fn points(model: &LoadedModel, crs: &Crs, geoid: Option<Geoid>) -> Result<Vec<Point>> {
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
        let class = match green {
            true => Classification::HighVegetation,
            false => Classification::Unclassified,
        };
        points.push(Point {
            x,
            y,
            z: geo.height_m - below,
            return_number: 1,
            number_of_returns: 1,
            is_synthetic: true,
            // Vegetation height is classified later, when all points are known.
            classification: class,
            gps_time: Some(0.0),
            color: Some(Color::new(red, g, blue)),
            ..Point::default()
        });
    }
    tell_high_from_low(&mut points, CELL_M / crs.metres_per_unit());
    Ok(points)
}

/// Classifies vegetation as low where it stands less than [`HIGH_M`] above the lowest point of its own cell and of
/// those around it.
fn tell_high_from_low(points: &mut [Point], cell: f64) {
    let place = |p: &Point| ((p.x / cell).floor() as i64, (p.y / cell).floor() as i64);
    let mut lowest: BTreeMap<(i64, i64), f64> = BTreeMap::new();
    for point in points.iter() {
        let floor = lowest.entry(place(point)).or_insert(f64::INFINITY);
        *floor = floor.min(point.z);
    }
    let is_high = |point: &&mut Point| point.classification == Classification::HighVegetation;
    for point in points.iter_mut().filter(is_high) {
        let (col, row) = place(point);
        let around = (-1..=1).flat_map(|dc| (-1..=1).map(move |dr| (col + dc, row + dr)));
        let floors = around.filter_map(|cell| lowest.get(&cell)).copied();
        let floor = floors.fold(f64::INFINITY, f64::min);
        if point.z - floor < HIGH_M {
            point.classification = Classification::LowVegetation;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lawn_is_low_and_a_tree_on_it_is_high() {
        let leaf = |x: f64, z: f64| Point {
            x,
            z,
            classification: Classification::HighVegetation,
            ..Point::default()
        };
        let mut points: Vec<Point> = (0..40).map(|i| leaf(f64::from(i), 0.05 * f64::from(i))).collect();
        points.push(leaf(20.0, 8.0));
        points.push(Point {
            classification: Classification::Unclassified,
            ..leaf(21.0, 9.0)
        });
        tell_high_from_low(&mut points, CELL_M);
        let classes: Vec<Classification> = points.iter().map(|p| p.classification).collect();
        assert!(classes[..40].iter().all(|c| *c == Classification::LowVegetation));
        assert_eq!(
            classes[40..],
            [Classification::HighVegetation, Classification::Unclassified]
        );
    }
}
