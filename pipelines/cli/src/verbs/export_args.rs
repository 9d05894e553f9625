//! Arguments of `export`.

use crate::parse;
use clap::{ArgGroup, Args};
use heliosplat_rpc::sun::SunPosition;
use std::path::PathBuf;

/// `export`.
#[derive(Debug, Clone, Args)]
#[command(group = ArgGroup::new("what").args(["ply", "splats", "mesh", "tiles", "asset"]).required(true).multiple(true))]
pub struct ExportArgs {
    /// A finished run, or the folder of a batch's mosaic
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Splats as PLY, for splat viewers and editors; of satellite scenes with the position on Earth in FILE.json
    #[arg(long, value_name = "FILE")]
    pub ply: Option<PathBuf>,
    /// Splats as glTF (KHR_gaussian_splatting) for viewers other than CesiumJS, which takes --tiles; satellites only
    #[arg(long, value_name = "FILE.glb")]
    pub splats: Option<PathBuf>,
    /// Triangle mesh: of satellite scenes the surface with its albedo (.glb), of objects closed with colours (.ply or .glb). With --tiles and
    /// without FILE: tiles of the mesh
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub mesh: Option<Option<PathBuf>>,
    /// Folder for 3D Tiles: splats in levels of detail, or with --mesh the surface; satellites only
    #[arg(long, value_name = "DIR")]
    pub tiles: Option<PathBuf>,
    /// Sun that lights the splats of a satellite scene: azimuth (clockwise from north) and elevation, degrees [default: that of the reference image]
    #[arg(long, value_parser = parse::sun, allow_hyphen_values = true, value_name = "AZ,EL", conflicts_with_all = ["time", "light", "toward"])]
    pub sun: Option<SunPosition>,
    /// The sun of this moment, RFC 3339
    #[arg(long, value_parser = parse::time, value_name = "RFC3339", conflicts_with_all = ["light", "toward"])]
    pub time: Option<jiff::Timestamp>,
    /// Point light on the splats of an object, in the frame of the cameras
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply", conflicts_with = "toward")]
    pub light: Option<[f64; 3]>,
    /// Parallel light on the splats of an object: the direction it comes from
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply")]
    pub toward: Option<[f64; 3]>,
    /// Folder for the model of an object (model.ply, model.json), which `render` and `relight` take like a run
    #[arg(long, value_name = "DIR")]
    pub asset: Option<PathBuf>,
    /// Grid cells along the longest side of an object's mesh [default: 192]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..=512), requires = "mesh")]
    pub cells: Option<u32>,
}
