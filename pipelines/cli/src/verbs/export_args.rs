//! Arguments of `export`: models for other programs.

use crate::parse;
use clap::{ArgGroup, Args};
use std::path::PathBuf;

/// `export`.
#[derive(Debug, Clone, Args)]
#[command(group = ArgGroup::new("what").args(["ply", "splats", "mesh", "tiles", "asset"]).required(true).multiple(true))]
pub struct ExportArgs {
    /// A finished run, or the folder of a batch's mosaic
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Splats for viewers and editors of splats, as a PLY; of satellites with the place on Earth in FILE.json beside it
    #[arg(long, value_name = "FILE")]
    pub ply: Option<PathBuf>,
    /// Splats as glTF (KHR_gaussian_splatting) for viewers other than CesiumJS, which takes --tiles; satellites only
    #[arg(long, value_name = "FILE.glb")]
    pub splats: Option<PathBuf>,
    /// A triangle mesh: of satellites the surface with its albedo, .glb; of objects closed and with colours, .ply or .glb. With --tiles and
    /// without a name: the tiles hold the mesh, which globes light by their own sun
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub mesh: Option<Option<PathBuf>>,
    /// A folder for 3D Tiles, which globes read: splats in three or more levels of detail, or with --mesh the surface; satellites only
    #[arg(long, value_name = "DIR")]
    pub tiles: Option<PathBuf>,
    /// Azimuth (clockwise from north) and elevation of the sun that splats of satellites are lit by, degrees [default: that of the reference image]
    #[arg(long, value_parser = parse::sun, allow_hyphen_values = true, value_name = "AZ,EL", conflicts_with_all = ["time", "light", "toward"])]
    pub sun: Option<[f64; 2]>,
    /// The sun of this moment, RFC 3339
    #[arg(long, value_parser = parse::time, value_name = "RFC3339", conflicts_with_all = ["light", "toward"])]
    pub time: Option<jiff::Timestamp>,
    /// The point light that the splats of an object are lit by, in the frame of the cameras
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply", conflicts_with = "toward")]
    pub light: Option<[f64; 3]>,
    /// The parallel light that the splats of an object are lit by: the direction it comes from
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply")]
    pub toward: Option<[f64; 3]>,
    /// A folder for the model of an object itself, which `render` and `relight` take like the run: model.ply and model.json, nothing else
    #[arg(long, value_name = "DIR")]
    pub asset: Option<PathBuf>,
    /// Cells along the longest side of the grid that the mesh of an object is found in [default: 192]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..=512), requires = "mesh")]
    pub cells: Option<u32>,
}
