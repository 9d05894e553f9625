//! `heliosplat synth`: scenes with known truth.

use crate::args::place_in_words;
use crate::outcome::{CliError, Outcome};
use crate::parse;
use clap::{Args, ValueEnum};
use heliosplat_session::Session;
use heliosplat_synth::{
    BandSet, Capture, Cover, Delivery, Fault, Look, ObjectRequest, SatelliteRequest, Site, Summary, SynthError,
    write_object, write_satellite,
};
use std::cell::RefCell;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Scene to make.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Kind of scene
    #[arg(value_enum, value_name = "KIND")]
    kind: Kind,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size of the site
    #[arg(long, value_enum, default_value = "block")]
    site: Site,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// Cameras, dates and suns of real images (JSON, as VisSat writes it)
    #[arg(long, value_name = "FILE", conflicts_with = "dates")]
    cameras: Option<PathBuf>,
    /// Number of images [default: that of the site, or all of --cameras]
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Number of acquisition dates [default: that of the site]
    #[arg(long, value_name = "N")]
    dates: Option<usize>,
    /// Ground sampling distance, metres [default: 0.5]
    #[arg(long, value_parser = parse::positive, value_name = "M")]
    gsd: Option<f64>,
    /// Width and height of every image, pixels [default: enough for the site; 200 for objects]
    #[arg(long, value_name = "PX")]
    size: Option<usize>,
    /// Put each satellite image at an offset into a sparse file this wide and high, pixels [default: no larger file]
    #[arg(long, value_name = "PX")]
    canvas: Option<usize>,
    /// Material of the object in the middle
    #[arg(long, value_enum, default_value = "matte")]
    look: Look,
    /// Paths per pixel of an object's images; a power of two is best
    #[arg(long, default_value_t = 64, value_name = "N")]
    paths: usize,
    /// Bands
    #[arg(long, value_enum, default_value = "rgb-nir")]
    bands: BandSet,
    /// 16: linear counts; 8: display images
    #[arg(long, default_value_t = 16, value_name = "8|16")]
    bits: u8,
    /// Constant error of each image's RPC, root mean square, pixels
    #[arg(long, default_value_t = 0.0, value_name = "PX")]
    pointing_bias: f64,
    /// Sensor noise relative to a good sensor's
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR")]
    noise: f64,
    /// Training images of a satellite scene that have clouds in view
    #[arg(long, default_value_t = 0, value_name = "N")]
    clouds: usize,
    /// Faults of real images, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    faults: Vec<Fault>,
    /// Cover of one half of a satellite scene
    #[arg(long, value_enum)]
    cover: Option<Cover>,
    /// Packaging of the images of a satellite scene
    #[arg(long, value_enum, default_value = "whole")]
    delivery: Delivery,
    /// Also render a satellite scene from straight above under N suns of no image, 10 to 70 degrees high, as truth for
    /// `evaluate`
    #[arg(long, default_value_t = 0, value_name = "N")]
    relight: usize,
    /// Share of the buildings of a satellite scene that are built or torn down between two dates, as truth for `evaluate`
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    change: f64,
}

/// Kinds of scenes.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Satellite images of several dates, with RPC cameras
    Satellite,
    /// An object under constant light (PNG, as NeRF-synthetic)
    Object,
    /// An object under one lamp at a time (EXR, as GS3 and NRHints)
    Olat,
    /// An object in bright surroundings (PNG, as Shiny Blender)
    Reflective,
}

impl SynthArgs {
    fn satellite(&self) -> SatelliteRequest {
        SatelliteRequest {
            site: self.site,
            seed: self.seed,
            cameras: self.cameras.clone(),
            views: self.views,
            dates: self.dates,
            gsd_m: self.gsd,
            size_px: self.size,
            canvas_px: self.canvas,
            bands: self.bands,
            bits: self.bits,
            pointing_bias_px: self.pointing_bias,
            noise: self.noise,
            clouds: self.clouds,
            faults: self.faults.iter().copied().collect(),
            cover: self.cover,
            delivery: self.delivery,
            relight: self.relight,
            change: self.change,
        }
    }

    fn object(&self, capture: Capture) -> ObjectRequest {
        ObjectRequest {
            capture,
            look: self.look,
            seed: self.seed,
            views: self.views,
            held_out: None,
            size_px: self.size.unwrap_or(ObjectRequest::default().size_px),
            paths: self.paths,
        }
    }
}

impl From<SynthError> for CliError {
    fn from(error: SynthError) -> Self {
        Self::sorted(matches!(error, SynthError::BadRequest(_)), error.to_string())
    }
}

/// Makes a satellite scene or a capture of an object.
///
/// # Errors
/// When the request is invalid, or a file cannot be written.
pub(crate) fn run(args: &SynthArgs, session: &Session) -> Result<Outcome, CliError> {
    let summary = match args.kind {
        Kind::Satellite => synthesise(&args.satellite(), &args.out, session)?,
        Kind::Object => return object(&args.object(Capture::Object), &args.out, session),
        Kind::Olat => return object(&args.object(Capture::Olat), &args.out, session),
        Kind::Reflective => return object(&args.object(Capture::Reflective), &args.out, session),
    };
    Ok(Outcome::new(table(&summary, &args.out), serde_json::json!(summary)))
}

/// Makes a satellite scene, with a progress bar.
///
/// # Errors
/// [`CliError::Input`] for an invalid request, [`CliError::Failed`] when a file cannot be written.
pub fn synthesise(request: &SatelliteRequest, out: &Path, session: &Session) -> Result<Summary, CliError> {
    let bar = RefCell::new(None);
    let progress = |done: usize, total: usize| {
        let mut bar = bar.borrow_mut();
        let bar = bar.get_or_insert_with(|| session.progress("synthesise", total as u64));
        bar.set(done as u64);
    };
    Ok(write_satellite(request, out, &progress)?)
}

/// Makes a capture of an object, with a progress bar.
fn object(request: &ObjectRequest, out: &Path, session: &Session) -> Result<Outcome, CliError> {
    let bar = session.progress("synthesise", (request.training() + request.testing()) as u64);
    let summary = write_object(request, out, &|done, _| bar.set(done as u64))?;
    let text = format!(
        "{}: {} images to train with, {} held out ({} under lamps far from those of training), {} pixels wide, {:.0} % covered, noise of the held-out images {:.1} dB",
        out.display(),
        summary.train,
        summary.test,
        summary.far,
        summary.size_px,
        100.0 * summary.coverage,
        summary.noise_floor_db
    );
    Ok(Outcome::new(text, serde_json::json!(summary)))
}

fn table(summary: &Summary, out: &Path) -> String {
    let (place, [low, high]) = (place_in_words(summary.origin), summary.altitude_range_m);
    let (images, folder) = (summary.images.len(), out.display());
    let mut text = format!("{folder}: {images} images of {place}, altitudes {low:.1} to {high:.1} m, ");
    text += &format!("truth in {}\n", out.join("truth").display());
    for image in &summary.images {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "{:<16} {:<5} {}  sun {:>5.1} / {:>4.1}  off-nadir {:>4.1}  shadow {:>4.1} %",
            image.name,
            if image.held_out { "test" } else { "train" },
            image.time,
            image.sun_azimuth_deg,
            image.sun_elevation_deg,
            image.off_nadir_deg,
            100.0 * image.shadow_share
        );
        if let Some(haze) = &image.haze {
            let _ = write!(text, "  haze {:.2}", haze.depth);
        }
        if image.cloud_share > 0.0 {
            let _ = write!(text, "  cloud {:>4.1} %", 100.0 * image.cloud_share);
        }
        text.push('\n');
    }
    text
}
