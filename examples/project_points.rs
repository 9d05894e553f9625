//! Projects points of the ground into an image, and localises them again from there.
//!
//! Usage: `project_points IMAGE|RPCFILE LON,LAT,ALT...` (degrees, and metres above the WGS 84 ellipsoid)
//!
//! Prints a line for each point: lon lat alt, col row, and the lon lat that the camera localises from col, row and alt.
//! Pixel centres are at whole numbers.

use heliosplat_rpc::{GeoPoint, Rpc};
use heliosplat_scene::{RpcPreference, camera_of};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    if let Err(error) = run() {
        eprintln!("error: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, points @ ..] = arguments.as_slice() else {
        return Err("usage: project_points IMAGE|RPCFILE LON,LAT,ALT...".into());
    };
    let camera = camera_of(Path::new(file), RpcPreference::default())?;
    for text in points {
        println!("{} {}", text.replace(',', " "), there_and_back(&camera, parse(text)?)?);
    }
    Ok(())
}

/// Formats the pixel of a point, and the longitude and latitude localised from that pixel at the point's height.
fn there_and_back(camera: &Rpc, point: GeoPoint) -> Result<String, Box<dyn Error>> {
    let pixel = camera.project(point);
    if !(pixel.col.is_finite() && pixel.row.is_finite()) {
        return Err("a point has no place in the image".into());
    }
    let back = camera.localise(pixel, point.height_m)?;
    let (lon_deg, lat_deg) = (back.lon_deg, back.lat_deg);
    Ok(format!("{:.3} {:.3} {lon_deg:.9} {lat_deg:.9}", pixel.col, pixel.row))
}

fn parse(text: &str) -> Result<GeoPoint, Box<dyn Error>> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
    let Ok(&[lon_deg, lat_deg, height_m]) = numbers.as_deref() else {
        return Err(format!("{text}: expected LON,LAT,ALT").into());
    };
    Ok(GeoPoint::new(lon_deg, lat_deg, height_m))
}
