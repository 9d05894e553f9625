//! The error of the surface model against the time of training, for several presets.
//!
//! Usage: `compare_presets SCENE OUT PRESET...` (a satellite scene with truth; presets as of `heliosplat train`)
//!
//! Trains into OUT/PRESET and prints a line for each preset: steps, seconds, mean absolute error in metres.

use heliosplat_fitting::request::{Earlier, TrainOutcome, TrainRequest};
use heliosplat_fitting::settings::Preset;
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
    let [scene, out, presets @ ..] = arguments.as_slice() else {
        return Err("usage: compare_presets SCENE OUT PRESET...".into());
    };
    let presets: Vec<Preset> = presets.iter().map(|name| name.parse()).collect::<Result<_, _>>()?;
    let options = IngestOptions::default();
    let scene = altitude::open(&Index::open(Path::new(scene), options.rpc)?, &options)?;
    println!("preset     steps  seconds  error_m");
    for preset in presets {
        let config = SatelliteConfig::resolve(preset, &[], 1)?;
        let request = TrainRequest {
            earlier: Earlier::Update,
            ..TrainRequest::new(Path::new(out).join(preset.name()), preset)
        };
        let metrics = match training::train(&scene, &options, &config, &request, &Session::quiet())? {
            TrainOutcome::FinishedBefore { metrics } => metrics,
            TrainOutcome::Trained(run) => run.metrics,
        };
        let number = |key: &str| {
            metrics
                .pointer(key)
                .and_then(|value| value.as_f64())
                .unwrap_or(f64::NAN)
        };
        println!(
            "{:<10} {:>5} {:>8.1} {:>8.3}",
            preset.name(),
            number("/iterations"),
            number("/seconds"),
            number("/dsm/mae_m")
        );
    }
    Ok(())
}
