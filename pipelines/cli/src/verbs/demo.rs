//! `heliosplat demo`: synthesises a site, trains on it, and writes its surface model.

use super::synth;
use crate::outcome::{CliError, Outcome};
use clap::Args;
use heliosplat_fitting::request::{Earlier, TrainOutcome, TrainRequest};
use heliosplat_fitting::run_folder::create_folder;
use heliosplat_fitting::settings::Preset;
use heliosplat_pages::report;
use heliosplat_products::relight;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::measure;
use heliosplat_satellite::training::train;
use heliosplat_scene::{IngestOptions, Scene};
use heliosplat_session::Session;
use std::path::PathBuf;
use std::time::Instant;

/// `demo`.
#[derive(Debug, Clone, Args)]
pub struct DemoArgs {
    /// Folder to write to
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Seed of the site and of the training
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Synthesises a site, trains on it and writes its products.
///
/// # Errors
/// When the folder cannot be written, or a stage fails.
pub(crate) fn demo(args: &DemoArgs, session: &Session) -> Result<Outcome, CliError> {
    let scene_folder = args.out.join("scene");
    create_folder(&args.out)?;
    let request = heliosplat_synth::SatelliteRequest {
        site: heliosplat_synth::Site::Block,
        seed: args.seed,
        ..Default::default()
    };
    synth::synthesise(&request, &scene_folder, session)?;
    let begun = Instant::now();
    let ingest = IngestOptions::default();
    let scene = Scene::open(&scene_folder, &ingest)?;
    let config = SatelliteConfig::resolve(Preset::Fast, &[], args.seed)?;
    let run_folder = args.out.join("run");
    let request = TrainRequest {
        begun,
        earlier: Earlier::Overwrite,
        ..TrainRequest::new(run_folder.clone(), Preset::Fast)
    };
    let TrainOutcome::Trained(run) = train(&scene, &ingest, &config, &request, session)? else {
        return Err(CliError::Failed(format!("{}: trained before", run_folder.display())));
    };
    report::write(&run_folder)?;
    run.ending.check(&run_folder)?;
    let metrics = run.metrics;
    let evening = SunPosition::from_degrees(250.0, 20.0);
    let relit = relight::Viewpoint::new(&run.model, "nadir")?.relit(&evening)?;
    relit.write(&args.out.join("evening.png"))?;
    let mae = metrics["dsm"]["mae_m"].as_f64().unwrap_or(f64::NAN);
    let folder = args.out.display();
    let text = format!(
        "{}\nreport         {folder}/run/report.html   (open it in a browser)\nDSM            {folder}/run/dsm.tif   (open it in QGIS)\npicture        {folder}/run/dsm.png\nerrors         {folder}/run/error.png\nanother sun    {folder}/evening.png\nany sun        {folder}/run/sun.html   (open it in a browser)\nmean absolute error against truth: {mae:.3} m (protocol raw)",
        measure::summary(&metrics)
    );
    Ok(Outcome::new(text, metrics))
}
