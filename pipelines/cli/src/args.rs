//! Arguments that several verbs share.

use crate::outcome::CliError;
use crate::parse;
use clap::Args;
use heliosplat_raster::temporary::TemporaryFolder;
use heliosplat_raster::{Crs, Geoid, RasterError, is_virtual, write_atomically};
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::{SunPosition, sun_position};
use heliosplat_scene::{AreaRequest, IngestOptions, RpcPreference};
use std::path::{Path, PathBuf};

/// Heading of the options about a scene.
const SCENE: &str = "Scene options";

/// Facts of a scene that its files do not state.
#[derive(Debug, Clone, Args)]
pub struct IngestArgs {
    /// Lowest and highest altitude of the surface, metres above the ellipsoid [default: from tie points]
    #[arg(long, help_heading = SCENE, value_name = "MIN,MAX", value_parser = parse::pair, allow_hyphen_values = true)]
    pub altitude: Option<[f64; 2]>,
    /// Limits of the ground: longitudes and latitudes, or coordinates of EPSG:N
    #[arg(long, help_heading = SCENE, value_name = "WEST,SOUTH,EAST,NORTH[,EPSG:N]", value_parser = parse::area, allow_hyphen_values = true)]
    pub area: Option<AreaRequest>,
    /// Preferred source of an image's camera
    #[arg(long, help_heading = SCENE, value_name = "SOURCE", default_value = "json")]
    pub rpc: RpcPreference,
}

impl IngestArgs {
    /// Options of the scene reader.
    pub fn options(&self) -> IngestOptions {
        IngestOptions {
            altitude_range_m: self.altitude.map(|[low, high]| (low, high)),
            altitude_from_ties_m: None,
            rpc: self.rpc,
            area: self.area.clone(),
        }
    }
}

/// Path of the scene in arguments: a single folder or file as it is; several image files are listed in a `scene.toml`
/// in `folder`.
///
/// # Errors
/// When one of several paths is a folder or missing, or the list cannot be written.
pub fn scene_of(named: &[PathBuf], folder: &Path) -> Result<PathBuf, CliError> {
    if let [scene] = named {
        return Ok(scene.clone());
    }
    let mut text = "# The images that were given on the command line.\n".to_owned();
    for path in named {
        if path.is_dir() {
            let text = "a folder among several images; give one folder, or image files alone";
            return Err(CliError::Input(format!("{}: {text}", path.display())));
        }
        let whole = match is_virtual(path) {
            true => path.clone(),
            false => std::fs::canonicalize(path).map_err(|_| RasterError::Missing(path.clone()))?,
        };
        // A JSON string is a valid TOML string.
        let quoted = serde_json::json!(whole.to_string_lossy());
        text += &format!("[[images]]\npath = {quoted}\n");
    }
    let scene = folder.join("scene.toml");
    write_atomically(&scene, text.as_bytes())?;
    Ok(scene)
}

/// Horizontal coordinate reference system of `--crs`, and geoid of `--geoid` or of the vertical part of `--crs`; `verb`
/// is for error messages.
///
/// # Errors
/// When the system cannot be used, or the two options name different geoids.
pub fn map_of(verb: &str, crs: Option<&str>, geoid: Option<Geoid>) -> Result<(Option<Crs>, Option<Geoid>), CliError> {
    let target = crs.map(Geoid::of_definition).transpose()?;
    let (crs, stated) = target.map_or((None, None), |(crs, geoid)| (Some(crs), geoid));
    if let (Some(stated), Some(asked)) = (stated, geoid)
        && stated != asked
    {
        let (stated, asked) = (stated.name(), asked.name());
        return Err(CliError::Input(format!(
            "{verb}: --crs asks for heights above {stated}, --geoid for heights above {asked}; leave one out"
        )));
    }
    Ok((crs, geoid.or(stated)))
}

/// Scene in arguments, while it is read. The list of several images lies in a temporary folder, deleted on drop.
pub struct NamedScene {
    /// Path of the scene.
    pub path: PathBuf,
    _listed: Option<TemporaryFolder>,
}

impl NamedScene {
    /// Scene of one folder or file, or of several image files.
    ///
    /// # Errors
    /// Errors of [`scene_of`], and an error if the temporary folder cannot be made.
    pub fn new(named: &[PathBuf]) -> Result<Self, CliError> {
        let listed = (named.len() > 1).then(|| TemporaryFolder::inside(&std::env::temp_dir()));
        let listed = listed.transpose()?;
        let path = scene_of(named, listed.as_ref().map_or(Path::new("."), TemporaryFolder::path))?;
        Ok(Self { path, _listed: listed })
    }
}

/// The sun that a verb is given, or that of a time at `origin`.
pub fn sun_of(sun: Option<SunPosition>, time: Option<jiff::Timestamp>, origin: GeoPoint) -> Option<SunPosition> {
    sun.or(time.map(|time| sun_position(time, origin)))
}

/// Latitude and longitude in degrees with their letters, as in `22.890968 S 47.027328 W`.
pub fn place_in_words(place: GeoPoint) -> String {
    let north = if place.lat_deg >= 0.0 { 'N' } else { 'S' };
    let east = if place.lon_deg >= 0.0 { 'E' } else { 'W' };
    format!("{:.6} {north} {:.6} {east}", place.lat_deg.abs(), place.lon_deg.abs())
}
