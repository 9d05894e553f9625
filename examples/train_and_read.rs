//! Trains a model of a scene, and reads it again from the folder of the run.
//!
//! Usage: `train_and_read SCENE RUN [PRESET]` (preset: `preview`, `fast`, `balanced`, `accurate` or `best`)
//!
//! Prints the number of Gaussians, their altitudes, and the error of the surface model if the scene has truth. An
//! interrupted training continues; a finished one is only read.

use heliosplat_fitting::request::{Earlier, TrainOutcome, TrainRequest};
use heliosplat_fitting::settings::Preset;
use heliosplat_products::{dsm, model};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::{altitude, training};
use heliosplat_scene::{Index, IngestOptions};
use heliosplat_session::Session;
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
    let (scene, folder, preset) = match arguments.as_slice() {
        [scene, folder] => (scene, folder, Preset::Fast),
        [scene, folder, preset] => (scene, folder, preset.parse()?),
        _ => return Err("usage: train_and_read SCENE RUN [PRESET]".into()),
    };
    let options = IngestOptions::default();
    let scene = altitude::open(&Index::open(Path::new(scene), options.rpc)?, &options)?;
    let config = SatelliteConfig::resolve(preset, &[], 1)?;
    let request = TrainRequest {
        earlier: Earlier::Resume,
        ..TrainRequest::new(folder.into(), preset)
    };
    let metrics = match training::train(&scene, &options, &config, &request, &Session::quiet())? {
        TrainOutcome::FinishedBefore { metrics } => metrics,
        TrainOutcome::Trained(run) => run.metrics,
    };
    // From here on only the folder is needed.
    let model = model::load(Path::new(folder))?;
    let facts = dsm::dsm(&model, model.file.gsd_m, None)?.facts(model.file.gsd_m);
    println!("{} Gaussians", model.parameters.gaussians.count);
    println!("{}", facts.in_words(Path::new(folder).join("dsm.tif").as_path()));
    if let Some(error_m) = metrics["dsm"]["mae_m"].as_f64() {
        println!("mean absolute error {error_m:.3} m");
    }
    Ok(())
}
