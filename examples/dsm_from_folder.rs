//! A surface model from a folder of satellite images by the plane sweep, without training.
//!
//! Usage: `dsm_from_folder SCENE OUT.tif [LOW,HIGH]` (lowest and highest altitude of the surface, metres above the WGS
//! 84 ellipsoid; by default from the files of the scene, or from tie points between its images)
//!
//! Writes a cloud-optimised GeoTIFF in the local UTM zone, with the cell size of the images.

use heliosplat_fitting::settings::Preset;
use heliosplat_products::dsm::of_surface;
use heliosplat_products::nadir::GroundExtent;
use heliosplat_satellite::altitude;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::preprocess::sweep_only;
use heliosplat_scene::{Index, IngestOptions};
use heliosplat_session::Session;
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
    let (folder, out, altitude_range_m) = match arguments.as_slice() {
        [folder, out] => (folder, out, None),
        [folder, out, range] => (folder, out, Some(parse(range)?)),
        _ => return Err("usage: dsm_from_folder SCENE OUT.tif [LOW,HIGH]".into()),
    };
    let options = IngestOptions {
        altitude_range_m,
        ..Default::default()
    };
    let scene = altitude::open(&Index::open(Path::new(folder), options.rpc)?, &options)?;
    for warning in &scene.warnings {
        eprintln!("warning: {warning}");
    }
    let config = SatelliteConfig::resolve(Preset::Balanced, &[], 1)?;
    let surface = sweep_only(&scene, &config, &Session::quiet())?;
    let dsm = of_surface(&GroundExtent::from(&scene), &surface, scene.gsd_m, None)?;
    dsm.write(Path::new(out))?;
    let known_percent = 100.0 * dsm.completeness();
    println!("{out}: cells of {:.2} m, {known_percent:.1} % known", scene.gsd_m);
    Ok(())
}

fn parse(text: &str) -> Result<(f64, f64), Box<dyn Error>> {
    let numbers = text
        .split_once(',')
        .and_then(|(low, high)| Some((low.parse().ok()?, high.parse().ok()?)));
    numbers.ok_or_else(|| format!("{text}: expected LOW,HIGH in metres").into())
}
