//! Arguments of `export`: models for other programs.

use crate::parse;
use clap::Args;
use std::path::PathBuf;

/// `export`.
#[derive(Debug, Clone, Args)]
pub struct ExportArgs {
    /// A finished run on an object
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Splats for viewers: display colours as harmonics of degree three, positions in the frame of the cameras
    #[arg(long, value_name = "FILE", required_unless_present_any = ["asset", "mesh"])]
    pub ply: Option<PathBuf>,
    /// The point light that colours are baked for, in the frame of the cameras
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply", conflicts_with = "toward")]
    pub light: Option<[f64; 3]>,
    /// The parallel light that colours are baked for: the direction it comes from
    #[arg(long, value_parser = parse::triple, allow_hyphen_values = true, value_name = "X,Y,Z", requires = "ply")]
    pub toward: Option<[f64; 3]>,
    /// A folder for the model itself, which `render` and `relight` take like the run: model.ply and model.json, nothing else
    #[arg(long, value_name = "DIR")]
    pub asset: Option<PathBuf>,
    /// A closed triangle mesh with colours, .ply or .glb, in the frame of the cameras
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Cells along the longest side of the grid that the mesh is found in
    #[arg(long, value_name = "N", default_value_t = 192, value_parser = clap::value_parser!(u32).range(16..=512), requires = "mesh")]
    pub cells: u32,
}
