//! Arguments of the verbs that satellite scenes and objects share: `train`, `dsm`, `relight`, `render`.

use crate::args::IngestArgs;
use crate::device::DeviceChoice;
use crate::outcome::{CliError, Outcome};
use crate::parse;
use clap::{Args, ValueEnum};
use heliosplat_fitting::request::{Earlier, TrainRequest};
use heliosplat_fitting::settings::Preset;
use heliosplat_raster::Geoid;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::Split;
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// `train`.
#[derive(Debug, Clone, Args)]
pub struct TrainArgs {
    /// A folder of images, several image files, a scene.toml, a folder of Sat-NeRF or EOGS, or a capture with
    /// transforms.json, a COLMAP model or cameras.csv
    #[arg(value_name = "SCENE", required = true)]
    pub scenes: Vec<PathBuf>,
    /// Path of the scene that `scenes` form.
    #[arg(skip)]
    pub scene: PathBuf,
    /// Folder of the run, made if absent
    #[arg(long, value_name = "RUN")]
    pub out: PathBuf,
    /// Trade-off of time against quality [default: balanced]
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// Take as many steps as fit into this time, products included, such as 90s, 5m, 1h30m
    #[arg(long, value_parser = parse::duration, value_name = "TIME")]
    pub time_budget: Option<Duration>,
    /// Stay below this much memory, such as 4GiB or 500MB
    #[arg(long, value_parser = parse::bytes, value_name = "SIZE")]
    pub memory: Option<u64>,
    /// Seed of all random numbers [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Preset, seed, area, altitudes and settings of a file: the run.toml of an earlier run, or one like it. Options on
    /// the command line come before those of the file
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Change one setting, as in --set train.iterations=2000 (docs/guide/settings.md)
    #[arg(long = "set", value_parser = parse::key_value, value_name = "KEY=VALUE")]
    pub set: Vec<(String, String)>,
    /// Replace an earlier training in RUN, finished or interrupted
    #[arg(long)]
    pub overwrite: bool,
    /// Keep RUN if this training is finished there; an interrupted one continues without this option
    #[arg(long, conflicts_with = "overwrite")]
    pub resume: bool,
    /// Time between two checkpoints; 0 keeps one after every step
    #[arg(long, value_parser = parse::duration, value_name = "TIME", default_value = "60s")]
    pub checkpoint_every: Duration,
    /// Device to train on; with `auto` a GPU where there is one that knows the model (docs/guide/speed.md)
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    /// Scene options
    #[command(flatten)]
    pub ingest: IngestArgs,
}

impl TrainArgs {
    /// Handling of an earlier training in the folder.
    pub(super) fn earlier(&self) -> Earlier {
        match (self.overwrite, self.resume) {
            (true, _) => Earlier::Overwrite,
            (_, true) => Earlier::Resume,
            _ => Earlier::Keep,
        }
    }
}

/// `dsm`.
#[derive(Debug, Clone, Args)]
pub struct DsmArgs {
    /// A finished run; with --from sweep a scene, as for `train`; several image files are swept
    #[arg(value_name = "RUN", required = true)]
    pub runs: Vec<PathBuf>,
    /// Path of the run or scene that `runs` form.
    #[arg(skip)]
    pub run: PathBuf,
    /// The GeoTIFF to write
    #[arg(long, value_name = "FILE.tif")]
    pub out: PathBuf,
    /// Source of the surface [default: model; for image files: sweep]
    #[arg(long, value_enum)]
    pub from: Option<DsmSource>,
    /// Ground sampling distance, metres [default: that of the images]
    #[arg(long, value_parser = parse::positive, value_name = "M")]
    pub gsd: Option<f64>,
    /// Coordinate reference system [default: the local UTM zone]; +5773 or +3855 for heights above EGM96 or EGM2008
    #[arg(long, value_name = "EPSG:N[+M]")]
    pub crs: Option<String>,
    /// Surface of this day, if buildings changed between the images [default: day of the last image]
    #[arg(long, alias = "at", value_parser = parse::date, value_name = "DATE")]
    pub date: Option<jiff::civil::Date>,
    /// Heights above this geoid instead of the ellipsoid; its grid must be among PROJ's data files
    #[arg(long, value_enum, value_name = "NAME")]
    pub geoid: Option<Geoid>,
    /// Close holes with the lower of the altitudes around them; filled cells have coverage 0, views 0 and no standard
    /// deviation
    #[arg(long)]
    pub fill: bool,
    /// With --from sweep: memory limit, such as 4GiB; larger scenes are swept in tiles [default: half of the machine's
    /// memory]
    #[arg(long, value_parser = parse::bytes, value_name = "SIZE")]
    pub memory: Option<u64>,
    /// Scene options
    #[command(flatten)]
    pub ingest: IngestArgs,
}

/// Source of a surface model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DsmSource {
    /// The trained model of a run.
    Model,
    /// The plane sweep of a scene, in seconds and without training.
    Sweep,
}

/// `relight`.
#[derive(Debug, Clone, Args)]
pub struct RelightArgs {
    /// A finished run
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// The GeoTIFF or PNG to write; its shadow mask is written beside it
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Azimuth (clockwise from north) and elevation of the sun, degrees
    #[arg(long, value_parser = parse::sun, allow_hyphen_values = true, value_name = "AZ,EL", conflicts_with = "time")]
    pub sun: Option<SunPosition>,
    /// The sun of this moment, RFC 3339
    #[arg(long, value_parser = parse::time, value_name = "RFC3339")]
    pub time: Option<jiff::Timestamp>,
    /// A point light for an object, in the frame of its cameras; several add up
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", conflicts_with_all = ["sun", "time"])]
    pub light: Vec<[f64; 3]>,
    /// Parallel light for an object: the direction it comes from; several add up
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", conflicts_with_all = ["sun", "time"])]
    pub toward: Vec<[f64; 3]>,
    /// Light from all around an object: an image of all directions (PNG, JPEG or EXR), up at the top, +x in the middle
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sun", "time"])]
    pub surroundings: Option<PathBuf>,
    /// Number of parallel lights drawn from the surroundings
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=65536), requires = "surroundings")]
    pub samples: u32,
    /// From above (nadir), or in the geometry of the image of this name; for objects the default is the first image
    #[arg(long, value_name = "nadir|NAME", default_value = "nadir")]
    pub view: String,
}

/// `render`.
#[derive(Debug, Clone, Args)]
pub struct RenderArgs {
    /// A finished run
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Folder to write to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Images to render
    #[arg(long, value_enum, default_value = "test")]
    pub split: RenderSplit,
    /// Also write the parts of the light that the model has: diffuse, specular, shadow
    #[arg(long)]
    pub components: bool,
}

impl TrainArgs {
    /// Request of a training that began at `begun`.
    ///
    /// # Errors
    /// When the device cannot be had.
    pub(crate) fn request(&self, preset: Preset, begun: Instant) -> Result<TrainRequest, CliError> {
        Ok(TrainRequest {
            out: self.out.clone(),
            preset,
            begun,
            time_budget: self.time_budget,
            memory: self.memory,
            earlier: self.earlier(),
            checkpoint_every: self.checkpoint_every,
            device: self.device.find()?,
        })
    }

    /// Outcome of a training: `summary` of its metrics and its folder, followed by `before`, a remark about an earlier
    /// run.
    pub(crate) fn trained(&self, summary: &str, metrics: Value, before: &str) -> Outcome {
        let text = format!("{summary}\nrun            {}{before}", self.out.display());
        Outcome::new(text, metrics)
    }
}

/// Views to render.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RenderSplit {
    /// Training images.
    Train,
    /// Held-out images.
    Test,
    /// All images.
    All,
}

impl RenderArgs {
    /// The images to render, of which there is at least one.
    pub(crate) fn of_split<'a, T>(&self, images: &'a [T], split: fn(&T) -> Split) -> Result<Vec<&'a T>, CliError> {
        let is_chosen = |image: &&T| match self.split {
            RenderSplit::Train => split(image) == Split::Train,
            RenderSplit::Test => split(image) == Split::Test,
            RenderSplit::All => true,
        };
        let images: Vec<&T> = images.iter().filter(is_chosen).collect();
        let run = self.run.display();
        match images.is_empty() {
            true => Err(CliError::Input(format!(
                "{run}: the run has no image of that split; try --split all"
            ))),
            false => Ok(images),
        }
    }
}
