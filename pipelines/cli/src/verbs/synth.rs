//! `heliosplat synth`: scenes with known truth.

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

/// What to make.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Kind of scene
    #[arg(value_enum, value_name = "KIND")]
    kind: Kind,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size and make-up of the site
    #[arg(long, value_enum, default_value = "block")]
    site: SiteName,
    /// Everything random follows from it
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// See the site through the cameras of real images, on their dates and under their suns (JSON, as VisSat writes it)
    #[arg(long, value_name = "FILE", conflicts_with = "dates")]
    cameras: Option<PathBuf>,
    /// Images [default: as the site has them, or all of --cameras]
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Acquisition dates [default: as the site has them]
    #[arg(long, value_name = "N")]
    dates: Option<usize>,
    /// Ground sampling distance, metres [default: 0.5]
    #[arg(long, value_parser = parse::positive, value_name = "M")]
    gsd: Option<f64>,
    /// Width and height of every image, pixels [default: what covers the site; 200 for objects]
    #[arg(long, value_name = "PX")]
    size: Option<usize>,
    /// What an object's middle is made of
    #[arg(long, value_enum, default_value = "matte")]
    look: LookName,
    /// Paths per pixel of an object's images; a power of two is best
    #[arg(long, default_value_t = 64, value_name = "N")]
    paths: usize,
    /// Bands
    #[arg(long, value_enum, default_value = "rgb-nir")]
    bands: BandName,
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
    faults: Vec<FaultName>,
    /// What covers one half of a satellite scene
    #[arg(long, value_enum)]
    cover: Option<CoverName>,
    /// How the images of a satellite scene are packed
    #[arg(long, value_enum, default_value = "whole")]
    delivery: DeliveryName,
    /// Also render a satellite scene from straight above under N suns of no image, 10 to 70 degrees high, as truth for `evaluate`
    #[arg(long, default_value_t = 0, value_name = "N")]
    relight: usize,
    /// Share of the buildings of a satellite scene that are built or torn down between two dates, as truth for `evaluate`
    #[arg(long, default_value_t = 0.0, value_name = "SHARE")]
    change: f64,
}

/// Faults of real images.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum FaultName {
    /// A gain of its own for each band, within some per cent the same in all images: counts that are not calibrated
    BandGains,
    /// A layer of haze, another on each date: bluish airlight, less contrast
    Haze,
    /// Light that surfaces reflect reaches other surfaces, for one bounce
    Interreflection,
    /// Metal roofs, membranes, cars and solar panels that are not Lambertian
    Glossy,
    /// Clouds over a third of an image, and a veil over the rest; in --clouds images, or a quarter of those to train with
    LargeClouds,
    /// 8-bit display images, each band stretched between percentiles of the image, with a gamma that no file tells
    Stretch,
}

/// What covers one half of a scene.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum CoverName {
    /// Sea at one altitude, with other waves in every image
    Sea,
    /// Snow: bright, hardly any texture, clipped in the sun
    Snow,
    /// Nothing: the land of `sea` alone, pixels that see the sea are missing
    Nodata,
}

/// Kinds of scenes.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Satellite images of several dates, with RPC cameras
    Satellite,
    /// An object under light that stays (PNG, as NeRF-synthetic)
    Object,
    /// An object under one lamp at a time (EXR, as GS3 and NRHints)
    Olat,
    /// An object in bright surroundings (PNG, as Shiny Blender)
    Reflective,
}

/// What an object is made of.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum LookName {
    /// Nothing glossy
    Matte,
    /// Metal with a grain
    Brushed,
    /// A colour under a clear coat
    Glossy,
    /// Wax: light enters and comes out elsewhere
    Translucent,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum SiteName {
    /// 48 m x 48 m, for tests
    Tiny,
    /// 128 m x 128 m: a few city blocks
    Block,
    /// 256 m x 256 m: a neighbourhood
    City,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum BandName {
    /// Panchromatic
    Pan,
    /// Red, green, blue
    Rgb,
    /// Red, green, blue, near infrared
    RgbNir,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum DeliveryName {
    /// One file for each image
    Whole,
    /// A panchromatic file and a multispectral one of a quarter of its resolution
    PanMs,
}

impl SynthArgs {
    fn request(&self) -> SatelliteRequest {
        SatelliteRequest {
            site: match self.site {
                SiteName::Tiny => Site::Tiny,
                SiteName::Block => Site::Block,
                SiteName::City => Site::City,
            },
            seed: self.seed,
            cameras: self.cameras.clone(),
            views: self.views,
            dates: self.dates,
            gsd_m: self.gsd,
            size_px: self.size,
            bands: match self.bands {
                BandName::Pan => BandSet::Pan,
                BandName::Rgb => BandSet::Rgb,
                BandName::RgbNir => BandSet::RgbNir,
            },
            bits: self.bits,
            pointing_bias_px: self.pointing_bias,
            noise: self.noise,
            clouds: self.clouds,
            faults: self.faults.iter().map(|fault| Fault::from(*fault)).collect(),
            cover: self.cover.map(Cover::from),
            delivery: match self.delivery {
                DeliveryName::Whole => Delivery::Whole,
                DeliveryName::PanMs => Delivery::PanMs,
            },
            relight: self.relight,
            change: self.change,
        }
    }
}

impl From<FaultName> for Fault {
    fn from(name: FaultName) -> Self {
        match name {
            FaultName::BandGains => Self::BandGains,
            FaultName::Haze => Self::Haze,
            FaultName::Interreflection => Self::Interreflection,
            FaultName::Glossy => Self::Glossy,
            FaultName::LargeClouds => Self::LargeClouds,
            FaultName::Stretch => Self::Stretch,
        }
    }
}

impl From<CoverName> for Cover {
    fn from(name: CoverName) -> Self {
        match name {
            CoverName::Sea => Self::Sea,
            CoverName::Snow => Self::Snow,
            CoverName::Nodata => Self::Nodata,
        }
    }
}

impl SynthArgs {
    fn object(&self, capture: Capture) -> ObjectRequest {
        ObjectRequest {
            capture,
            look: match self.look {
                LookName::Matte => Look::Matte,
                LookName::Brushed => Look::Brushed,
                LookName::Glossy => Look::Glossy,
                LookName::Translucent => Look::Translucent,
            },
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
        match &error {
            SynthError::BadRequest(_) | SynthError::Cameras { .. } => Self::Input(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

/// Makes the scene.
pub(crate) fn run(args: &SynthArgs, session: &Session) -> Result<Outcome, CliError> {
    let summary = match args.kind {
        Kind::Satellite => synthesise(&args.request(), &args.out, session)?,
        Kind::Object => return object(&args.object(Capture::Object), &args.out, session),
        Kind::Olat => return object(&args.object(Capture::Olat), &args.out, session),
        Kind::Reflective => return object(&args.object(Capture::Reflective), &args.out, session),
    };
    let json = serde_json::to_value(&summary)
        .map_err(|error| CliError::Failed(format!("the summary cannot be written: {error}")))?;
    Ok(Outcome {
        json,
        text: table(&summary, &args.out),
    })
}

/// Makes a satellite scene, with a progress bar.
///
/// # Errors
/// [`CliError::Input`] for a request that cannot be met, [`CliError::Failed`] when it cannot be written.
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
    Ok(Outcome {
        text: format!(
            "{}: {} images to train with, {} held out ({} under lamps far from those of training), {} pixels wide, {:.0} % covered, noise of the held-out images {:.1} dB",
            out.display(),
            summary.train,
            summary.test,
            summary.far,
            summary.size_px,
            100.0 * summary.coverage,
            summary.noise_floor_db
        ),
        json: serde_json::json!(summary),
    })
}

fn table(summary: &Summary, out: &Path) -> String {
    let mut text = format!(
        "{}: {} images of {}, altitudes {:.1} to {:.1} m, truth in {}\n",
        out.display(),
        summary.images.len(),
        crate::args::place_in_words(summary.origin),
        summary.altitude_range_m[0],
        summary.altitude_range_m[1],
        out.join("truth").display()
    );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_and_covers_have_the_same_names_on_the_command_line_and_in_the_manifest() {
        let said = |name: Option<clap::builder::PossibleValue>| name.map(|name| name.get_name().to_owned());
        for name in FaultName::value_variants() {
            let written = serde_json::to_value(Fault::from(*name)).expect("a name");
            assert_eq!(written.as_str(), said(name.to_possible_value()).as_deref());
        }
        for name in CoverName::value_variants() {
            let written = serde_json::to_value(Cover::from(*name)).expect("a name");
            assert_eq!(written.as_str(), said(name.to_possible_value()).as_deref());
        }
    }
}
